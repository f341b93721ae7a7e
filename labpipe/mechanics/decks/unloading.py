"""Compute residual curvature and dissipated work after unloading, for a deck and for its wire.

The hardening of copper is partly isotropic, which most programs cannot represent. A deck therefore
states the residual curvature and the dissipated work of its law and of the wire, for a few bends
that are released to zero moment. Those of the wire are intervals over its isotropic share.
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
    make_unbent_history,
    slide,
    split_hardening,
)
from labpipe.mechanics.wire.bending_law import make_strand_slider
from labpipe.mechanics.wire.wire_table import (
    DEFAULT_SHARE_RANGE,
    compute_chord_ratio,
    make_layers,
)
from labpipe.messages import format_sentence
from labpipe.records.arrays import Floats
from labpipe.records.wire import WireTable

BENDS = (5.0, 12.0, 23.5)
"""Curvatures from which decks are released, 1/m, within the range of the table."""

_BRANCH_POINTS = 201
"""Number of curvatures of a bending or releasing branch."""


@dataclass(frozen=True, slots=True, eq=False)
class Release:
    """Residual curvature and dissipated work of bends that are released to zero moment.

    Parameters
    ----------
    residual_curvature : shape (bends,), or (bends, 2) for intervals, relative to the bend
    dissipated_work : same shape, relative to the work of bending
    """

    residual_curvature: Floats
    dissipated_work: Floats


def get_share_interval(table: WireTable) -> tuple[float, float]:
    """Return the interval of the isotropic share of a wire; its ends are equal if it is stated."""
    share = table.spec.isotropic_share
    return DEFAULT_SHARE_RANGE if share is None else (share, share)


@lru_cache(maxsize=8)  # tables are hashed by identity
def make_table_strands(table: WireTable) -> GrowingSlider:
    """Build the growing slider of the strands' bending about their own axes, from a wire's table.

    Parameters
    ----------
    table : table of the wire

    Raises
    ------
    ValueError
        As `fit_sliders`.
    """
    law = fit_wire_sliders(table)
    corners = np.append(law.slip_curvatures, law.max_curvature)
    factor = compute_chord_ratio(law, table)
    return make_strand_slider(make_layers(table.spec), corners, factor=factor)


@lru_cache(maxsize=8)
def compute_releases(table: WireTable) -> tuple[Release, Release]:
    """Compute the release of a wire from the bends of `choose_bends`.

    Parameters
    ----------
    table : table of the wire

    Returns
    -------
    Release for both ends of the interval of the isotropic share, and release by Masing's rule.

    Raises
    ------
    ValueError
        As `fit_sliders`.
    """
    law, strands, bends = fit_wire_sliders(table), make_table_strands(table), choose_bends(table)
    ends = [
        compute_release(split_hardening(law, strands, share), bends)
        for share in get_share_interval(table)
    ]
    residual = np.column_stack([end.residual_curvature for end in ends])
    dissipated = np.column_stack([end.dissipated_work for end in ends])
    return Release(residual, dissipated), compute_release(law, bends)


def choose_bends(table: WireTable) -> Floats:
    """Return the `BENDS` within the range of a table, 1/m; if there is none, its end."""
    return np.array([bend for bend in BENDS if bend <= table.curvature[-1]] or table.curvature[-1:])


def compute_release(law: SliderLaw, bends: Floats) -> Release:
    """Compute the release of a wire from its first bend.

    Parameters
    ----------
    law : law of the wire
    bends : shape (n,), 1/m, curvatures before the release, positive
    """
    rests = slide(law, bends, make_unbent_history(law, len(bends))).history
    residual, _ = bend_to_moment(law, np.zeros(len(bends)), bends, rests)
    fractions = np.linspace(0.0, 1.0, _BRANCH_POINTS)[:, None]
    loading, unloading = fractions * bends, bends + fractions * (residual - bends)
    unbent_rests = make_unbent_history(law, loading.size)
    loading_moment = slide(law, loading.ravel(), unbent_rests).moment.reshape(loading.shape)
    bent_rests = np.tile(rests, (_BRANCH_POINTS, 1))
    unloading_moment = slide(law, unloading.ravel(), bent_rests).moment.reshape(loading.shape)
    loading_work = np.trapezoid(loading_moment, loading, axis=0)
    unloading_work = np.asarray(np.trapezoid(unloading_moment, unloading, axis=0))
    return Release(residual / bends, 1.0 + unloading_work / loading_work)


def compute_elastic_release(table: WireTable, stiffness: float) -> Release:
    """Compute the release of a law that unloads linearly.

    Parameters
    ----------
    table : table of the wire, which states first loading
    stiffness : N m^2, bending stiffness in unloading
    """
    curvature = np.linspace(0.0, choose_bends(table), _BRANCH_POINTS)
    moment = np.interp(curvature, table.curvature, table.moment)
    springback = moment[-1] / stiffness
    work = np.trapezoid(moment, curvature, axis=0)
    return Release(1.0 - springback / curvature[-1], 1.0 - 0.5 * moment[-1] * springback / work)


def make_zero_release(table: WireTable) -> Release:
    """Return the release of an elastic law: zero residual curvature and zero dissipated work."""
    return Release(*np.zeros((2, len(choose_bends(table)))))


def collect_growing_numbers(table: WireTable) -> dict[str, object] | None:
    """Return the growing slider of a wire for a JSON deck, with the parallel spring and sliders.

    Parameters
    ----------
    table : table of the wire

    Returns
    -------
    Numbers for the isotropic share of the sheet, or for the middle of its interval; None for a
    share of zero.

    Raises
    ------
    ValueError
        As `fit_sliders`.
    """
    shares = get_share_interval(table)
    share = 0.5 * (shares[0] + shares[1])
    if share == 0.0:
        return None
    law = split_hardening(fit_wire_sliders(table), make_table_strands(table), share)
    (slider,) = law.growing_sliders
    return {
        "isotropic_share": share,
        "share_interval": list(shares),
        "use": format_sentence("mechanics.decks.growing_use"),
        "stiffness": slider.stiffness,
        "slid": slider.slid_curvatures.tolist(),
        "limits": slider.limits.tolist(),
        "spring_beside": law.spring_stiffness,
        "sliders_beside": law.slider_stiffnesses.tolist(),
    }


def describe_unloading(
    table: WireTable, unloading_rule: str, deck_release: Release | None = None
) -> str:
    """Describe in one line the release of a deck and of its wire.

    Parameters
    ----------
    table : table of the wire
    unloading_rule : name of the unloading rule of the deck
    deck_release : release of the law of the deck; None for that by Masing's rule

    Raises
    ------
    ValueError
        As `fit_sliders`.
    """
    wire, masing = compute_releases(table)
    deck_release = masing if deck_release is None else deck_release
    first, last = get_share_interval(table)
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


def _join_percents(ratios: Floats) -> str:
    """Format ratios in per cent without decimals, separated by commas; a pair as an interval."""
    rows = [dict.fromkeys(row) for row in ratios.reshape(len(ratios), -1).tolist()]
    return ", ".join(" to ".join(f"{100.0 * ratio + 0.0:.0f}" for ratio in row) for row in rows)


def collect_unloading_numbers(table: WireTable) -> dict[str, object]:
    """Return the release of the wire and of the laws of decks for a JSON deck.

    Parameters
    ----------
    table : table of the wire

    Raises
    ------
    ValueError
        As `fit_sliders`.
    """
    wire, masing = compute_releases(table)
    isotropic = compute_elastic_release(table, float(table.moment[1] / table.curvature[1]))
    releases = {"wire": wire, "masing": masing, "isotropic": isotropic}
    return {
        "released_from": choose_bends(table).tolist(),
        "isotropic_share": list(get_share_interval(table)),
        **{
            name: {
                "kept": numbers.residual_curvature.tolist(),
                "lost": numbers.dissipated_work.tolist(),
            }
            for name, numbers in releases.items()
        },
    }
