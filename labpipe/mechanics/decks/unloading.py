"""Compute residual curvature and dissipated work after unloading, for decks and wires.

The hardening of copper is partly isotropic, which most programs cannot represent. A deck therefore
states the residual curvature and the dissipated work of the law of the deck and of the wire, for a
few bends that are released to zero moment. The values of the wire are intervals, because its
isotropic share is an interval.
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

BEND_CURVATURES = (5.0, 12.0, 23.5)
"""Curvatures from which decks are released, 1/m, within the range of the table."""

_N_BRANCH_POINTS = 201
"""Number of curvatures at which a bending or unloading branch is integrated."""


@dataclass(frozen=True, slots=True, eq=False)
class Release:
    """Residual curvature and dissipated work of bends that are released to zero moment.

    Parameters
    ----------
    residual_curvature : shape (bends,), or (bends, 2) for intervals, residual curvature relative to
        the curvature from which the bend is released
    dissipated_work : same shape, dissipated work relative to the work of bending
    """

    residual_curvature: Floats
    dissipated_work: Floats


def get_isotropic_share_interval(table: WireTable) -> tuple[float, float]:
    """Return the interval of the isotropic share; a share that the sheet states is both ends."""
    stated_share = table.spec.isotropic_share
    return DEFAULT_SHARE_RANGE if stated_share is None else (stated_share, stated_share)


@lru_cache(maxsize=8)  # tables are hashed by identity
def make_table_strand_slider(table: WireTable) -> GrowingSlider:
    """Build the growing slider for the bending of the strands about their own axes.

    Parameters
    ----------
    table : table of the wire

    Raises
    ------
    ValueError
        If sliders cannot be fitted to the law (`fit_wire_sliders`).
    """
    law = fit_wire_sliders(table)
    breakpoints = np.append(law.slip_curvatures, law.max_curvature)
    layers, chord_ratio = make_layers(table.spec), compute_chord_ratio(law, table)
    return make_strand_slider(layers, breakpoints, factor=chord_ratio)


@lru_cache(maxsize=8)
def compute_releases(table: WireTable) -> tuple[Release, Release]:
    """Compute the release of a wire from the bends of `choose_bend_curvatures`.

    Parameters
    ----------
    table : table of the wire

    Returns
    -------
    wire_release : release for both ends of the interval of the isotropic share
    masing_release : release by Masing's rule

    Raises
    ------
    ValueError
        If sliders cannot be fitted to the law (`fit_wire_sliders`).
    """
    law, strand_slider = fit_wire_sliders(table), make_table_strand_slider(table)
    curvatures = choose_bend_curvatures(table)
    releases = [
        compute_release(split_hardening(law, strand_slider, share), curvatures)
        for share in get_isotropic_share_interval(table)
    ]
    residual_curvature = np.column_stack([release.residual_curvature for release in releases])
    dissipated_work = np.column_stack([release.dissipated_work for release in releases])
    return Release(residual_curvature, dissipated_work), compute_release(law, curvatures)


def choose_bend_curvatures(table: WireTable) -> Floats:
    """Return the `BEND_CURVATURES` within the range of a table, 1/m, or the end of the range."""
    curvatures = [curvature for curvature in BEND_CURVATURES if curvature <= table.curvature[-1]]
    return np.array(curvatures or table.curvature[-1:])


def compute_release(law: SliderLaw, curvatures: Floats) -> Release:
    """Compute the release of a wire that was straight before the bend.

    Parameters
    ----------
    law : law of the wire
    curvatures : shape (n,), 1/m, curvatures from which the wire is released, positive
    """
    n_bends = len(curvatures)
    bent_history = slide(law, curvatures, make_unbent_history(law, n_bends)).history
    residual_curvature, _ = bend_to_moment(law, np.zeros(n_bends), curvatures, bent_history)

    def compute_work(branch: Floats, history: Floats) -> Floats:
        """Compute the work of curvatures of shape (points, bends) after a history."""
        moment = slide(law, branch.ravel(), history).moment.reshape(branch.shape)
        return np.asarray(np.trapezoid(moment, branch, axis=0))

    fractions = np.linspace(0.0, 1.0, _N_BRANCH_POINTS)[:, None]
    loading = fractions * curvatures
    loading_work = compute_work(loading, make_unbent_history(law, loading.size))
    unloading = curvatures + fractions * (residual_curvature - curvatures)
    unloading_work = compute_work(unloading, np.tile(bent_history, (_N_BRANCH_POINTS, 1)))
    return Release(residual_curvature / curvatures, 1.0 + unloading_work / loading_work)


def compute_linear_release(table: WireTable, stiffness: float) -> Release:
    """Compute the release of a law that unloads along a straight line.

    Parameters
    ----------
    table : table of the wire, with the moments of first loading
    stiffness : bending stiffness on unloading, N m^2
    """
    curvature = np.linspace(0.0, choose_bend_curvatures(table), _N_BRANCH_POINTS)
    moment = np.interp(curvature, table.curvature, table.moment)
    springback = moment[-1] / stiffness
    work = np.trapezoid(moment, curvature, axis=0)
    return Release(1.0 - springback / curvature[-1], 1.0 - 0.5 * moment[-1] * springback / work)


def make_elastic_release(table: WireTable) -> Release:
    """Return the release of an elastic law: zero residual curvature and zero dissipated work."""
    return Release(*np.zeros((2, len(choose_bend_curvatures(table)))))


def make_growing_slider_entry(table: WireTable) -> dict[str, object] | None:
    """Return the entry ``growing`` of a JSON deck: growing slider, parallel spring and sliders.

    Parameters
    ----------
    table : table of the wire

    Returns
    -------
    Values for the isotropic share that the sheet states, or for the middle of the default interval.
    None for a share of 0.

    Raises
    ------
    ValueError
        If sliders cannot be fitted to the law (`fit_wire_sliders`).
    """
    share_interval = get_isotropic_share_interval(table)
    isotropic_share = 0.5 * sum(share_interval)
    if isotropic_share == 0.0:
        return None
    law = split_hardening(fit_wire_sliders(table), make_table_strand_slider(table), isotropic_share)
    (slider,) = law.growing_sliders
    return {
        "isotropic_share": isotropic_share,
        "share_interval": list(share_interval),
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
    """Return a sentence on the release of a deck and of the wire.

    Parameters
    ----------
    table : table of the wire
    unloading_rule : name of the unloading rule of the deck
    deck_release : release of the law of the deck; None for the release by Masing's rule

    Raises
    ------
    ValueError
        If sliders cannot be fitted to the law (`fit_wire_sliders`).
    """
    wire_release, masing_release = compute_releases(table)
    deck_release = masing_release if deck_release is None else deck_release
    low_share, high_share = get_isotropic_share_interval(table)
    share_text = f"{low_share:g}" if low_share == high_share else f"{low_share:g} to {high_share:g}"
    return format_sentence(
        "mechanics.decks.unloading",
        bends=", ".join(f"{curvature:.3g}" for curvature in choose_bend_curvatures(table)),
        rule=unloading_rule,
        kept=_join_percents(deck_release.residual_curvature),
        lost=_join_percents(deck_release.dissipated_work),
        wire_kept=_join_percents(wire_release.residual_curvature),
        wire_lost=_join_percents(wire_release.dissipated_work),
        share=f"isotropic share {share_text}",
    )


def _join_percents(ratios: Floats) -> str:
    """Format the rows of ratios in whole per cents, separated by commas; a pair as an interval."""
    rows = [dict.fromkeys(row) for row in ratios.reshape(len(ratios), -1).tolist()]
    return ", ".join(" to ".join(f"{100.0 * ratio + 0.0:.0f}" for ratio in row) for row in rows)


def make_unloading_entry(table: WireTable) -> dict[str, object]:
    """Return the entry ``unloading`` of a loss card: the release of the wire and of simpler laws.

    Parameters
    ----------
    table : table of the wire

    Raises
    ------
    ValueError
        If sliders cannot be fitted to the law (`fit_wire_sliders`).
    """
    wire_release, masing_release = compute_releases(table)
    isotropic_release = compute_linear_release(table, float(table.moment[1] / table.curvature[1]))
    releases = {"wire": wire_release, "masing": masing_release, "isotropic": isotropic_release}
    return {
        "released_from": choose_bend_curvatures(table).tolist(),
        "isotropic_share": list(get_isotropic_share_interval(table)),
        **{
            name: {
                "kept": release.residual_curvature.tolist(),
                "lost": release.dissipated_work.tolist(),
            }
            for name, release in releases.items()
        },
    }
