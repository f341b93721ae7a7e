"""Moment against curvature as measured, branch by branch, and the law of the first loading."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.records.curve import Bending, BendingCloud, Direction, MeasuredLaw
from labpipe.records.result import TestResult
from labpipe.report.curve_figures import MAX_CYCLE_COLOURS, cycle_colours
from labpipe.report.figure_page import (
    DOUBLE_COLUMN,
    GREY,
    area_key,
    line_key,
    new_page,
    panel_letter,
    put_key,
    titled_page,
    write_reason,
)
from labpipe.report.wording import Scale, footnote, scale, title, unit_words, why_missing

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_LAW, _NOISE = "black", "#e6e6e6"
_BAND: dict[str, Any] = {"color": "black", "alpha": 0.18, "lw": 0}
_TANGENT: dict[str, Any] = {
    "color": "#D55E00", "linestyle": "", "marker": "o", "markersize": 3.2, "capsize": 1.5,
    "markerfacecolor": "white", "linewidth": 0.7, "elinewidth": 0.7,
}  # fmt: skip


def draw_moment_curvature(result: TestResult) -> Figure:
    """Draw (a) the cloud of all branches with the law and (b) the law's stiffnesses."""
    if result.bending is None:
        page = new_page(result, width_mm=DOUBLE_COLUMN, height_mm=60)
        write_reason(page.subplots(), why_missing(result, "measured moment-curvature"))
        return page
    page = titled_page(
        title(result), footnote(result), width_mm=DOUBLE_COLUMN, height_mm=92, key_rows=2
    )
    cloud, stiffness = page.subplots(1, 2)
    plot_cloud(result, cloud)
    plot_stiffness(result, stiffness)
    panel_letter(cloud, "a", "Moment")
    panel_letter(stiffness, "b", "Stiffness of the first loading")
    put_key(page, _handles(result.bending), columns=5)
    return page


def plot_cloud(result: TestResult, axes: Axes) -> None:
    """Draw the points of all branches and the law with its band.

    Parameters
    ----------
    result : its measured bending is drawn: loading as dots, unloading as open circles, one colour
        per cycle, starting where the law puts the specimen at rest; the band is the 95 % interval
        of the law, the grey stripe the curvatures within noise
    axes : to draw on
    """
    max_cloud_points = 4000
    bending = result.bending
    if bending is None:
        return
    across, up = _curvature(result), _with_typeset_unit(scale(result, "moment", "N*m"))
    x, y = _points(bending)
    every = -(-x.size // max_cloud_points)
    for branch, look in _branch_styles(result, bending.cloud).items():
        rows = bending.cloud.branch == branch
        points = (x[rows].ravel()[::every], y[rows].ravel()[::every])
        axes.plot(points[0] * across.factor, points[1] * up.factor, **look)
    if bending.law is not None:
        _draw_law(axes, bending.law, across, up)
    axes.set_xlabel(across.label("Curvature"))
    axes.set_ylabel(up.label("Bending moment"))


def _points(bending: Bending) -> tuple[Floats, Floats]:
    """Return curvatures and moments from the straight, unloaded state; without a law from rest."""
    cloud, law = bending.cloud, bending.law
    if law is None:
        return cloud.curvature, cloud.moment
    size = np.interp(np.abs(cloud.moment_at_rest), law.moment, law.curvature)
    begin = np.sign(cloud.moment_at_rest) * size
    return cloud.curvature + begin, cloud.moment + cloud.moment_at_rest


def _draw_law(axes: Axes, law: MeasuredLaw, across: Scale, up: Scale) -> None:
    x = law.curvature * across.factor
    axes.axvspan(
        -law.floor * across.factor, law.floor * across.factor, color=_NOISE, lw=0, zorder=0
    )
    ends = [end * up.factor for end in (law.moment_lower, law.moment_upper)]
    axes.fill_between(x, ends[0], ends[1], zorder=3, **_BAND)  # the points show through
    axes.plot(x, law.moment * up.factor, color=_LAW, zorder=4)


def plot_stiffness(result: TestResult, axes: Axes) -> None:
    """Draw secant and tangent stiffness of the law against curvature.

    Parameters
    ----------
    result : its law is drawn where curvature is above its noise; the grey stripe is where it
        is not; tangents are drawn at the knots of the law, with their intervals
    axes : to draw on, curvature on a logarithmic axis; a sentence if there is no law
    """
    min_curvature_share = 1e-3  # start of the axis, of the largest curvature
    law = result.bending.law if result.bending is not None else None
    if law is None:
        write_reason(axes, str(result.bending.reason or "") if result.bending is not None else "")
        return
    from matplotlib.ticker import LogFormatter

    across, up = _curvature(result), _with_typeset_unit(scale(result, "bending_stiffness", "N*m^2"))
    x = law.curvature[1:] * across.factor
    lower, middle, upper = (
        getattr(law, f"secant{end}")[1:] * up.factor for end in ("_lower", "", "_upper")
    )
    axes.fill_between(x, lower, upper, **_BAND)
    axes.plot(x, middle, color=_LAW)
    _draw_tangents(axes, law, across, up)
    start = max(0.5 * law.floor, min_curvature_share * law.curvature[-1]) * across.factor
    axes.axvspan(start, max(law.floor * across.factor, start), color=_NOISE, lw=0)
    axes.set_xscale("log")
    axes.set_xlim(start, float(x[-1]))
    axes.set_ylim(bottom=0.0)
    axes.xaxis.set_major_formatter("{x:g}")
    axes.xaxis.set_minor_formatter(LogFormatter(labelOnlyBase=False))
    axes.set_xlabel(across.label("Curvature"))
    axes.set_ylabel(up.label("Bending stiffness"))


def _draw_tangents(axes: Axes, law: MeasuredLaw, across: Scale, up: Scale) -> None:
    """Draw the slope of the law at its knots, where it is measured, with its interval."""
    at_knots = np.unique(np.searchsorted(law.moment, law.knots).clip(1, len(law.moment) - 1))
    at_knots = at_knots[np.isfinite(law.tangent[at_knots])]
    middle = law.tangent[at_knots]
    ends = np.stack([middle - law.tangent_lower[at_knots], law.tangent_upper[at_knots] - middle])
    axes.errorbar(
        law.curvature[at_knots] * across.factor, middle * up.factor,
        yerr=ends.clip(0.0) * up.factor,
        **_TANGENT,
    )  # fmt: skip


def _branch_styles(result: TestResult, cloud: BendingCloud) -> dict[int, dict[str, Any]]:
    """Return the style of the points of each branch."""
    colours = cycle_colours(int(cloud.cycle.max(initial=1)))
    styles: dict[int, dict[str, Any]] = {}
    for branch in np.unique(cloud.branch)[::-1].tolist():  # the first loading on top
        colour = colours[int(cloud.cycle[cloud.branch == branch][0]) - 1]
        filled = colour if _is_loading(result, branch) else "none"
        styles[branch] = {
            "linestyle": "",
            "marker": "o",
            "markersize": 1.8,
            "markeredgewidth": 0.4,
            "color": colour,
            "markerfacecolor": filled,
            "alpha": 0.6,
        }
    return styles


def _is_loading(result: TestResult, branch: int) -> bool:
    branches = result.curve.branches if result.curve is not None else ()
    return branch < len(branches) and branches[branch].direction is Direction.LOADING


def _handles(bending: Bending) -> list[Any]:
    """Name cycles, directions, law and noise."""
    last = int(bending.cloud.cycle.max(initial=1))
    cycles = [
        line_key(f"cycle {number}", linestyle="", marker="o", markersize=3, color=colour)
        for number, colour in enumerate(cycle_colours(last) if last <= MAX_CYCLE_COLOURS else (), 1)
    ]
    ways = [
        line_key(word, linestyle="", marker="o", markersize=3, color=GREY, markerfacecolor=face)
        for word, face in (("loading", GREY), ("unloading", "none"))
    ]
    if bending.law is None:
        return [*cycles, *ways]
    return [
        *cycles,
        *ways,
        line_key("law, secant", color=_LAW),
        line_key("tangent, 95 %", **{k: v for k, v in _TANGENT.items() if k in _OF_LINES}),
        area_key("95 % of the law", **_BAND),
        area_key("below noise", color=_NOISE, lw=0),
    ]


_OF_LINES = {"color", "linestyle", "marker", "markersize", "markerfacecolor"}


def _curvature(result: TestResult) -> Scale:
    return _with_typeset_unit(scale(result, "curvature", "1/m"))


def _with_typeset_unit(unit: Scale) -> Scale:
    """Write a unit with a dot for a product and raised powers."""
    return Scale(unit.factor, unit_words(unit.unit))
