"""Compute residual curvature and dissipated work after unloading, for a deck and for its wire.

The hardening of copper is partly isotropic, which most programs cannot represent. For
a few bends that are released to zero moment, a deck states the residual curvature and the
dissipated work of its own law and of the wire; those of the wire are intervals over its isotropic
share.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from labpipe.mechanics.law.loss_card import fit_wire_sliders
from labpipe.mechanics.law.sliders import (
    GrowingSlider,
    SliderLaw,
    bend_to_moment,
    make_unbent_rests,
    share_hardening,
    slide,
)
from labpipe.mechanics.wire.wire_table import (
    DEFAULT_SHARE_RANGE,
    build_wire,
    compute_chord_ratio,
    make_strand_slider,
)
from labpipe.messages import format_sentence
from labpipe.records.arrays import Floats
from labpipe.records.wire import WireTable

BENDS = (5.0, 12.0, 23.5)
"""Curvatures from which decks are released, 1/m, within the range of the table."""

_BRANCH_POINTS = 201
"""Number of curvatures on a branch of bending or of release."""


@dataclass(frozen=True, slots=True, eq=False)
class Release:
    """Result of releasing bends to zero moment.

    Parameters
    ----------
    residual_curvature : shape (bends,), or (bends, 2) for an interval; as a share of the bend
    dissipated_work : same shape, as a share of the work of bending
    """

    residual_curvature: Floats
    dissipated_work: Floats


def find_shares(table: WireTable) -> tuple[float, float]:
    """Return the interval of the isotropic share of a wire; its ends are equal if it is stated."""
    share = table.spec.isotropic_share
    return DEFAULT_SHARE_RANGE if share is None else (share, share)


@lru_cache(maxsize=8)  # tables are hashed by identity
def make_table_strands(table: WireTable) -> GrowingSlider:
    """Make the growing slider of the strands' own bending for the sliders of a wire.

    Parameters
    ----------
    table : law of the wire

    Raises
    ------
    ValueError
        As `fit_sliders`.
    """
    law = fit_wire_sliders(table)
    section = build_wire(table.spec).section
    return make_strand_slider(section, law, compute_chord_ratio(law, table))


@lru_cache(maxsize=8)
def compute_releases(table: WireTable) -> tuple[Release, Release]:
    """Compute the release of a wire from the bends that `choose_bends` returns.

    Parameters
    ----------
    table : law of the wire

    Returns
    -------
    Release of the wire with both ends of the interval of its isotropic share, and of its sliders
    by Masing's rule.

    Raises
    ------
    ValueError
        As `fit_sliders`.
    """
    law, strands, bends = fit_wire_sliders(table), make_table_strands(table), choose_bends(table)
    ends = [release(share_hardening(law, strands, share), bends) for share in find_shares(table)]
    residual = np.column_stack([end.residual_curvature for end in ends])
    dissipated = np.column_stack([end.dissipated_work for end in ends])
    return Release(residual, dissipated), release(law, bends)


def choose_bends(table: WireTable) -> Floats:
    """Return the `BENDS` within the range of a table, 1/m; its end if there is none."""
    end = float(table.curvature[-1])
    return np.array([bend for bend in BENDS if bend <= end] or [end])


def release(law: SliderLaw, bends: Floats) -> Release:
    """Compute the release of a wire from its first bend.

    Parameters
    ----------
    law : sliders of the wire
    bends : shape (n,), 1/m, positive
    """
    bent = slide(law, bends, make_unbent_rests(law, len(bends)))
    residual, _ = bend_to_moment(law, np.zeros(len(bends)), bends, bent.rests)
    shares = np.linspace(0.0, 1.0, _BRANCH_POINTS)[:, None]
    loading, unloading = shares * bends, bends + shares * (residual - bends)
    unbent = make_unbent_rests(law, loading.size)
    loading_moment = slide(law, loading.ravel(), unbent).moment.reshape(loading.shape)
    bent_rests = np.tile(bent.rests, (_BRANCH_POINTS, 1))
    unloading_moment = slide(law, unloading.ravel(), bent_rests).moment.reshape(loading.shape)
    loading_work = np.trapezoid(loading_moment, loading, axis=0)
    unloading_work = np.asarray(np.trapezoid(unloading_moment, unloading, axis=0))
    return Release(residual / bends, 1.0 + unloading_work / loading_work)


def release_elastically(table: WireTable, stiffness: float) -> Release:
    """Compute the release of a law that unloads linearly.

    Parameters
    ----------
    table : law of the wire, as first loading
    stiffness : of unloading, N m^2
    """
    curvature = np.linspace(0.0, choose_bends(table), _BRANCH_POINTS)
    moment = np.interp(curvature, table.curvature, table.moment)
    released = moment[-1] / stiffness  # curvature
    work = np.trapezoid(moment, curvature, axis=0)
    return Release(1.0 - released / curvature[-1], 1.0 - 0.5 * moment[-1] * released / work)


def release_without_memory(table: WireTable) -> Release:
    """Return the release of an elastic law: zero residual curvature and zero dissipated work."""
    zeros = np.zeros(len(choose_bends(table)))
    return Release(zeros, zeros)


def collect_growing_numbers(table: WireTable) -> dict[str, object] | None:
    """Return the growing slider of a wire for a JSON deck, with the spring and sliders beside it.

    Parameters
    ----------
    table : law of the wire

    Returns
    -------
    Numbers for the share that the sheet states, or the middle of the interval; None for a share of
    zero.

    Raises
    ------
    ValueError
        As `fit_sliders`.
    """
    shares = find_shares(table)
    share = 0.5 * (shares[0] + shares[1])
    if share == 0.0:
        return None
    law = share_hardening(fit_wire_sliders(table), make_table_strands(table), share)
    (slider,) = law.growing
    return {
        "isotropic_share": share,
        "share_interval": list(shares),
        "use": format_sentence("mechanics.decks.growing_use"),
        "stiffness": slider.stiffness,
        "slid": slider.slid.tolist(),
        "limits": slider.limits.tolist(),
        "spring_beside": law.stiffness,
        "sliders_beside": law.stiffnesses.tolist(),
    }


def describe_unloading(
    table: WireTable, unloading_rule: str, deck_release: Release | None = None
) -> str:
    """Describe in one line the release of a deck and of its wire.

    Parameters
    ----------
    table : law of the wire
    unloading_rule : that of the deck, in a few words
    deck_release : None for that of Masing's rule

    Raises
    ------
    ValueError
        As `fit_sliders`.
    """
    wire, masing = compute_releases(table)
    deck_release = masing if deck_release is None else deck_release
    first, last = find_shares(table)
    share = f"{first:g}" if first == last else f"{first:g} to {last:g}"
    return format_sentence(
        "mechanics.decks.unloading",
        bends=", ".join(f"{bend:.3g}" for bend in choose_bends(table)),
        rule=unloading_rule,
        kept=_join_percents(deck_release.residual_curvature),
        lost=_join_percents(deck_release.dissipated_work),
        wire_kept=_join_percents(wire.residual_curvature),
        wire_lost=_join_percents(wire.dissipated_work),
        share=f"isotropic share {share}",
    )


def _join_percents(shares: Floats) -> str:
    """Write shares in per cent without digits, separated by commas; a pair as an interval."""
    rows = [dict.fromkeys(row) for row in shares.reshape(len(shares), -1).tolist()]
    return ", ".join(" to ".join(f"{100.0 * share + 0.0:.0f}" for share in row) for row in rows)


def collect_unloading_numbers(table: WireTable) -> dict[str, object]:
    """Return the release of the wire and of the laws of decks for a JSON deck.

    Parameters
    ----------
    table : law of the wire

    Raises
    ------
    ValueError
        As `fit_sliders`.
    """
    wire, masing = compute_releases(table)
    isotropic = release_elastically(table, float(table.moment[1] / table.curvature[1]))
    releases = {"wire": wire, "masing": masing, "isotropic": isotropic}
    return {
        "released_from": choose_bends(table).tolist(),
        "isotropic_share": list(find_shares(table)),
        **{
            name: {
                "kept": numbers.residual_curvature.tolist(),
                "lost": numbers.dissipated_work.tolist(),
            }
            for name, numbers in releases.items()
        },
    }
