"""Force against displacement, raw and as processed, the cycles told apart."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.records.curve import Branch, Curve, Direction
from labpipe.records.result import TestResult
from labpipe.report.page import DOUBLE_COLUMN, GREY, new_page, panel_letter, put_key, say
from labpipe.report.thinning import extremes
from labpipe.report.treatment import treatment
from labpipe.report.wording import scale, why_missing

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOST_COLOURS = 6
"""Cycles that a legend tells apart; more of them get a colour bar."""

_BRANCH_BINS = 350
_BINS_WHOLE = 4000
"""Stretches that a branch is thinned to, and a curve that was not split into branches."""
_STYLES: dict[Direction, Literal["-"] | tuple[float, tuple[float, float]]] = {
    Direction.LOADING: "-",
    Direction.UNLOADING: (0, (4, 1.6)),
}


def draw_force_displacement(result: TestResult) -> Figure:
    """Draw (a) the calibrated samples as recorded and (b) the curve that numbers come from."""
    page = new_page(result, width_mm=DOUBLE_COLUMN, height_mm=82, has_key=True)
    raw, filtered = page.subplots(1, 2, sharex=True, sharey=True)
    plot_raw(result, raw)
    plot_filtered(result, filtered)
    filtered.set_ylabel("")
    panel_letter(raw, "a", "Raw")
    panel_letter(filtered, "b", treatment(result).value.capitalize())
    if result.curve is not None and result.curve.branches:
        _explain(page, [raw, filtered], result.curve)
    return page


def plot_raw(result: TestResult, axes: Axes) -> None:
    """Draw the unfiltered force against the unfiltered displacement.

    Parameters
    ----------
    result : its aligned series ``force`` and ``displacement`` are drawn; the turning points of the
        curve say which sample belongs to which cycle, without a curve all are one colour
    axes : to draw on; an explaining sentence if there are no such series
    """
    series = result.aligned.series if result.aligned is not None else {}
    if result.aligned is None or not {"force", "displacement"} <= set(series):
        say(axes, why_missing(result, "unfiltered force and displacement"))
        return
    pair = series["displacement"].values, series["force"].values
    branches = result.curve.branches if result.curve is not None else ()
    if not branches:
        _plot_thinned(result, axes, *pair, bins=_BINS_WHOLE, color=GREY, linewidth=0.5)
    for branch, colour in zip(branches, _branch_colours(branches), strict=True):
        ends = np.searchsorted(result.aligned.time, [branch.start_time, branch.stop_time])
        part = slice(ends[0], ends[1] + 1)
        _plot_thinned(result, axes, pair[0][part], pair[1][part], color=colour, linewidth=0.5)
    _label(result, axes)


def plot_filtered(result: TestResult, axes: Axes) -> None:
    """Draw the curve: loading solid, unloading dashed, the peak of each cycle marked.

    Parameters
    ----------
    result : its curve is drawn
    axes : to draw on; an explaining sentence if there is no curve
    """
    curve = result.curve
    if curve is None:
        say(axes, why_missing(result, "curve"))
        return
    if not curve.branches:
        _plot_thinned(result, axes, curve.displacement, curve.force, bins=_BINS_WHOLE, color=GREY)
    for branch, colour in zip(curve.branches, _branch_colours(curve.branches), strict=True):
        # one sample more: the line of a branch reaches the line of the next
        part = slice(branch.start, branch.stop + 1)
        pair = curve.displacement[part], curve.force[part]
        _plot_thinned(result, axes, *pair, color=colour, linestyle=_STYLES[branch.direction])
    _mark_peaks(result, axes, curve)
    _label(result, axes)


def _plot_thinned(
    result: TestResult, axes: Axes, x: Floats, y: Floats, *, bins: int = _BRANCH_BINS, **look: Any
) -> None:
    kept = extremes(y, bins=bins)
    across, up = scale(result, "displacement", "m"), scale(result, "force", "N")
    axes.plot(x[kept] * across.factor, y[kept] * up.factor, **look)


def _label(result: TestResult, axes: Axes) -> None:
    axes.set_xlabel(scale(result, "displacement", "m").label("Displacement"))
    axes.set_ylabel(scale(result, "force", "N").label("Force"))


def _mark_peaks(result: TestResult, axes: Axes, curve: Curve) -> None:
    """Put an open triangle on the highest force of each cycle."""
    across, up = scale(result, "displacement", "m"), scale(result, "force", "N")
    colours = cycle_colours(int(curve.cycle.max(initial=0)))
    for number, colour in enumerate(colours, start=1):
        inside = np.flatnonzero((curve.cycle == number) & ~np.isnan(curve.force))
        if len(inside):
            top = inside[np.argmax(curve.force[inside])]
            x, y = curve.displacement[top] * across.factor, curve.force[top] * up.factor
            axes.plot(x, y, "v", color=colour, markerfacecolor="white", label=f"peak {number}")


def cycle_colours(count: int) -> list[str]:
    """Colour of each cycle: the style's own for a few, a colour map for many."""
    import matplotlib as mpl
    from matplotlib.colors import to_hex

    if count <= MOST_COLOURS:
        own = mpl.rcParams["axes.prop_cycle"].by_key()["color"]
        return [to_hex(own[number % len(own)]) for number in range(count)]
    colour_map = mpl.colormaps[mpl.rcParams["image.cmap"]]
    return [to_hex(colour_map(0.92 * place)) for place in np.linspace(0, 1, count)]


def _branch_colours(branches: tuple[Branch, ...]) -> list[str]:
    colours = cycle_colours(max((branch.cycle for branch in branches), default=0))
    return [colours[branch.cycle - 1] for branch in branches]


def _explain(page: Figure, panels: list[Axes], curve: Curve) -> None:
    """Name cycles, directions and peaks above the panels, where no data can be."""
    from matplotlib.lines import Line2D

    count = max(branch.cycle for branch in curve.branches)
    few = count <= MOST_COLOURS
    cycles = [
        Line2D([], [], color=colour, label=f"cycle {number}")
        for number, colour in enumerate(cycle_colours(count) if few else (), start=1)
    ]
    others = [
        Line2D([], [], color=GREY, linestyle=look, label=str(direction))
        for direction, look in _STYLES.items()
        if any(branch.direction is direction for branch in curve.branches)
    ]
    peak = Line2D(
        [], [], color=GREY, marker="v", markerfacecolor="white", linestyle="", label="peak"
    )
    handles = [*cycles, *others, peak]
    put_key(page, handles)
    if not few:
        _colour_bar(page, panels, count)


def _colour_bar(page: Figure, panels: list[Axes], count: int) -> None:
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import ListedColormap, Normalize

    colours = ListedColormap(cycle_colours(count))
    key = ScalarMappable(Normalize(0.5, count + 0.5), colours)
    bar = page.colorbar(key, ax=panels, pad=0.01, aspect=30, label="Cycle")
    ticks = np.unique(np.linspace(1, count, min(count, 6)).round())
    bar.set_ticks([float(tick) for tick in ticks])
    bar.outline.set_linewidth(0.4)
