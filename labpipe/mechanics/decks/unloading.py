"""Unloading of decks: what remains of a bend that is released, against the wire itself.

Copper hardens isotropically in part (PHYSICS 13), which most programs cannot represent. A deck
states for a few bends the curvature that it keeps and the work that it loses when it is released to
zero moment, and both of the wire, as intervals over its isotropic share.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from labpipe.mechanics.law.loss_card import SLIDERS, fit_wire_sliders
from labpipe.mechanics.law.sliders import (
    GrowingSlider,
    SliderLaw,
    bend_to_moment,
    make_unbent_rests,
    share_hardening,
    slide,
)
from labpipe.mechanics.wire.wire_table import (
    UNKNOWN_SHARE,
    build_wire,
    find_chord_factor,
    make_strand_slider,
)
from labpipe.messages import format_sentence
from labpipe.records.arrays import Floats
from labpipe.records.wire import WireTable

BENDS = (5.0, 12.0, 23.5)
"""Curvatures from which decks are released, 1/m, as far as the table reaches."""

_POINTS = 201


@dataclass(frozen=True, slots=True, eq=False)
class Release:
    """What remains of bends that are released to zero moment.

    Parameters
    ----------
    kept : shape (bends,), curvature that remains, as a share of the bend
    lost : shape (bends,), work that is lost, as a share of the work of bending
    """

    kept: Floats
    lost: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Unloading:
    """Release of a wire, and of its sliders by Masing's rule.

    Parameters
    ----------
    bends : shape (bends,), 1/m
    shares : ends of the interval of the isotropic share; equal if it is stated
    wire : release with each of these shares
    masing : release by Masing's rule, an isotropic share of 0
    """

    bends: Floats
    shares: tuple[float, float]
    wire: tuple[Release, Release]
    masing: Release


def find_shares(table: WireTable) -> tuple[float, float]:
    """Return the interval of the isotropic share of a wire; its ends are equal if it is stated."""
    share = table.spec.isotropic_share
    return UNKNOWN_SHARE if share is None else (share, share)


@lru_cache(maxsize=8)  # tables are hashed by identity
def make_table_strands(table: WireTable, sliders: int = SLIDERS) -> GrowingSlider:
    """Make the growing slider of the strands' own bending for the sliders of a wire.

    Parameters
    ----------
    table : law of the wire
    sliders : at most, as of `fit_wire_sliders`

    Raises
    ------
    ValueError
        As `fit_sliders`.
    """
    law = fit_wire_sliders(table, sliders)
    section = build_wire(table.spec).section
    return make_strand_slider(section, law, find_chord_factor(law, table))


@lru_cache(maxsize=8)
def compute_unloading(table: WireTable) -> Unloading:
    """Compute the release of a wire from `BENDS` within its table, or from its end.

    Parameters
    ----------
    table : law of the wire

    Raises
    ------
    ValueError
        As `fit_sliders`.
    """
    law, strands = fit_wire_sliders(table), make_table_strands(table)
    bends = find_bends(table)
    shares = find_shares(table)
    low, high = (release(share_hardening(law, strands, share), bends) for share in shares)
    return Unloading(bends, shares, (low, high), release(law, bends))


def find_bends(table: WireTable) -> Floats:
    """Return `BENDS` within a table, 1/m; its end if there is none."""
    end = float(table.curvature[-1])
    return np.array([bend for bend in BENDS if bend <= end] or [end])


def release(law: SliderLaw, bends: Floats) -> Release:
    """Compute what remains of bends of a wire that was never bent before.

    Parameters
    ----------
    law : of the wire
    bends : shape (n,), 1/m, positive
    """
    bent = slide(law, bends, make_unbent_rests(law, len(bends)))
    kept, _ = bend_to_moment(law, np.zeros(len(bends)), bends, bent.rests)
    parts = np.linspace(0.0, 1.0, _POINTS)[:, None]
    rests = np.tile(bent.rests, (_POINTS, 1))
    done, returned = parts * bends, bends + parts * (kept - bends)
    unbent = make_unbent_rests(law, done.size)
    work = np.trapezoid(slide(law, done.ravel(), unbent).moment.reshape(done.shape), done, axis=0)
    back = slide(law, returned.ravel(), rests).moment.reshape(done.shape)
    returns = np.asarray(np.trapezoid(back, returned, axis=0))
    return Release(kept / bends, 1.0 + returns / work)


def release_elastically(table: WireTable, stiffness: float) -> Release:
    """Compute what remains of bends within the table of a form that unloads linearly.

    Parameters
    ----------
    table : law of the wire, as first loading
    stiffness : of unloading, N m^2
    """
    kept, lost = [], []
    for bend in find_bends(table):
        done = np.linspace(0.0, bend, _POINTS)
        moment = np.interp(done, table.curvature, table.moment)
        kept.append(1.0 - moment[-1] / (stiffness * bend))
        lost.append(1.0 - 0.5 * moment[-1] ** 2 / stiffness / np.trapezoid(moment, done))
    return Release(np.array(kept), np.array(lost))


def release_without_memory(table: WireTable) -> Release:
    """Return the release of a form that keeps and loses nothing."""
    nothing = np.zeros(len(find_bends(table)))
    return Release(nothing, nothing)


def collect_growing_numbers(table: WireTable) -> dict[str, object] | None:
    """Return the growing slider of a wire for a JSON deck, with the sliders beside it.

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


def describe_unloading(table: WireTable, rule: str, form: Release | None = None) -> str:
    """Describe in one line what a deck and the wire keep of a bend.

    Parameters
    ----------
    table : law of the wire
    rule : of the deck on unloading
    form : release of the deck; by Masing's rule if None

    Raises
    ------
    ValueError
        As `fit_sliders`.
    """
    unloading = compute_unloading(table)
    form = unloading.masing if form is None else form
    low, high = unloading.wire
    first, last = unloading.shares
    share = f"{first:g}" if first == last else f"{first:g} to {last:g}"
    return format_sentence(
        "mechanics.decks.unloading",
        bends=", ".join(f"{bend:.3g}" for bend in unloading.bends),
        rule=rule,
        kept=_join_percents(form.kept),
        lost=_join_percents(form.lost),
        wire_kept=_join_intervals(low.kept, high.kept),
        wire_lost=_join_intervals(low.lost, high.lost),
        share=f"isotropic share {share}",
    )


def _join_percents(shares: Sequence[float] | Floats) -> str:
    return ", ".join(f"{100.0 * share + 0.0:.0f}" for share in shares)


def _join_intervals(low: Floats, high: Floats) -> str:
    return ", ".join(
        f"{100.0 * least:.0f}" if least == most else f"{100.0 * least:.0f} to {100.0 * most:.0f}"
        for least, most in zip(low, high, strict=True)
    )


def collect_unloading_numbers(table: WireTable) -> dict[str, object]:
    """Return the release of the wire and of forms of decks for a JSON deck.

    Parameters
    ----------
    table : law of the wire

    Raises
    ------
    ValueError
        As `fit_sliders`.
    """
    unloading = compute_unloading(table)
    first_slope = float(table.moment[1] / table.curvature[1])
    low, high = unloading.wire
    forms = {"masing": unloading.masing, "isotropic": release_elastically(table, first_slope)}
    return {
        "released_from": unloading.bends.tolist(),
        "isotropic_share": list(unloading.shares),
        "wire": {
            "kept": np.column_stack([low.kept, high.kept]).tolist(),
            "lost": np.column_stack([low.lost, high.lost]).tolist(),
        },
    } | {name: {"kept": f.kept.tolist(), "lost": f.lost.tolist()} for name, f in forms.items()}
