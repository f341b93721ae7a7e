"""A test's curve: force against displacement, with its fitted lines, and both against time."""

from __future__ import annotations

from enum import Enum
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.records.curve import Branch, ClockFit, Curve, Direction
from labpipe.records.result import Result, TestResult
from labpipe.report.drawn_points import extremes
from labpipe.report.figure_page import (
    DOUBLE_COLUMN,
    GREY,
    line_key,
    new_page,
    panel_letter,
    put_key,
    say,
    side_key,
    titled_page,
)
from labpipe.report.wording import Scale, footnote, scale, title, why_missing

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_EXACT = 1e-9
"""Share of a signal's range that is rounding."""


class Treatment(Enum):
    """How the curve differs from the samples; the value is what a figure calls it."""

    NONE = "not filtered"
    CORRECTED = "corrected, not filtered"
    FILTERED = "filtered"


def treatment_of_force(result: TestResult) -> Treatment:
    """Tell what was done to the force of a test.

    Parameters
    ----------
    result : its curve is compared with its aligned series ``force``

    Returns
    -------
    Filtered too where there is nothing to compare with: then nothing says that it was not.

    Notes
    -----
    A correction (a slip added back, a stray sample bridged) moves whole stretches or a few samples:
    from sample to sample the median change of what was added is zero. A filter changes every
    sample by an amount of its own.
    """
    return _of(result, "force", result.curve.force if result.curve is not None else None)


def treatment(result: TestResult) -> Treatment:
    """Tell what was done to force and displacement of a test.

    Parameters
    ----------
    result : its curve is compared with its aligned series

    Returns
    -------
    The greater of both. What frame and grips give is taken off the displacement sample by sample;
    where that was done (note ``compliance_removed``), the displacement counts as corrected.
    """
    force = treatment_of_force(result)
    curve = result.curve
    travel = _of(result, "displacement", curve.displacement if curve is not None else None)
    if any(note.code == "compliance_removed" for note in result.quality):
        travel = Treatment.CORRECTED
    return max(force, travel, key=list(Treatment).index)


def _of(result: TestResult, name: str, after: Floats | None) -> Treatment:
    series = result.aligned.series if result.aligned is not None else {}
    if after is None or name not in series or len(series[name].values) != len(after):
        return Treatment.FILTERED
    change = after - series[name].values
    change = change[~np.isnan(change)]
    if not len(change):
        return Treatment.FILTERED
    least = _EXACT * float(np.nanmax(after) - np.nanmin(after))
    if np.abs(change).max() <= least:
        return Treatment.NONE
    steps = np.abs(np.diff(change))
    return Treatment.CORRECTED if np.median(steps) <= least else Treatment.FILTERED


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
    across, up = _scales(result)
    axes.plot(x[kept] * across.factor, y[kept] * up.factor, **look)


def _label(result: TestResult, axes: Axes) -> None:
    across, up = _scales(result)
    axes.set_xlabel(across.label("Displacement"))
    axes.set_ylabel(up.label("Force"))


def _mark_peaks(result: TestResult, axes: Axes, curve: Curve) -> None:
    """Put an open triangle on the highest force of each cycle."""
    across, up = _scales(result)
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
    count = max(branch.cycle for branch in curve.branches)
    few = count <= MOST_COLOURS
    cycles = [
        line_key(f"cycle {number}", color=colour)
        for number, colour in enumerate(cycle_colours(count) if few else (), start=1)
    ]
    others = [
        line_key(str(direction), color=GREY, linestyle=look)
        for direction, look in _STYLES.items()
        if any(branch.direction is direction for branch in curve.branches)
    ]
    peak = line_key("peak", color=GREY, marker="v", markerfacecolor="white", linestyle="")
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


_LOADING_BINS = 1500
_COLUMNS = 3
_MOST_OTHERS = 4
"""Entries of the key beside the lines: loading, as measured, break point or slip, failure."""
_PLACES = {
    "break_point": ("break point", ":"),
    "kink_displacement": ("kink", ":"),
    "plateau_displacement": ("onset of the plateau", (0, (8, 2))),
}
"""Results that are places on the axis of displacement: words for the key, and style of the line."""


def draw_stiffness_lines(result: TestResult) -> Figure:
    """Draw the first loading branch with the lines that stiffnesses were read from."""
    bundle = [
        name for name in _PLACES if name != "break_point" and _value(result, name) is not None
    ]
    rows = -(-(_MOST_OTHERS + len(bundle) + len(result.lines)) // _COLUMNS)
    page = titled_page(
        title(result),
        footnote(result),
        width_mm=DOUBLE_COLUMN,
        height_mm=92 + 4 * rows,
        key_rows=rows,
    )
    axes = page.subplots()
    branches = result.curve.branches if result.curve is not None else ()
    if not any(each.direction is Direction.LOADING for each in branches):
        say(axes, why_missing(result, "loading branch"))
        return page
    plot_branch(result, axes)
    plot_lines(result, axes)
    mark_points(result, axes)
    _label(result, axes)
    put_key(page, axes.get_legend_handles_labels()[0], columns=_COLUMNS)
    return page


def plot_branch(result: TestResult, axes: Axes) -> None:
    """Draw the first loading branch, and as it was measured where slips were repaired.

    Parameters
    ----------
    result : a test with a curve
    axes : to draw on
    """
    curve = result.curve
    if curve is None:
        return
    first = next(each for each in curve.branches if each.direction is Direction.LOADING)
    part = slice(first.start, first.stop)
    across, up = _scales(result)
    if result.aligned is not None and any(slip.decision == "repaired" for slip in result.slips):
        measured = result.aligned.series["force"].values[part]
        kept = extremes(measured, bins=_LOADING_BINS)
        x, y = curve.displacement[part][kept] * across.factor, measured[kept] * up.factor
        axes.plot(x, y, color=GREY, linestyle=(0, (4, 1.6)), linewidth=0.6, label="as measured")
    force = curve.force[part]
    kept = extremes(force, bins=_LOADING_BINS)
    x, y = curve.displacement[part][kept] * across.factor, force[kept] * up.factor
    axes.plot(x, y, linewidth=0.8, label="loading")


def plot_lines(result: TestResult, axes: Axes) -> None:
    """Draw each fitted line over its window, with its slope in the key.

    Parameters
    ----------
    result : its lines and the results of their names are drawn
    axes : to draw on
    """
    across, up = _scales(result)
    stiffness = scale(result, "stiffness", "N/m")
    for line in result.lines:
        x = np.array([line.start, line.stop])
        y = line.level + line.slope * (x - line.start)
        style = (0, (1, 1)) if line.result.startswith("segment") else "-"
        name = line.result.replace("_", " ")
        words = f"{name} {line.slope * stiffness.factor:.4g} {stiffness.unit}"
        axes.plot(
            x * across.factor, y * up.factor, linestyle=style, linewidth=1.8, alpha=0.8, label=words
        )


def mark_points(result: TestResult, axes: Axes) -> None:
    """Mark break point, kink, onset of a plateau, slips and failure.

    Parameters
    ----------
    result : its results and its slip ledger are drawn
    axes : to draw on
    """
    across, up = _scales(result)
    for name, (words, dashes) in _PLACES.items():
        place = _value(result, name)
        if place is not None:
            x = place * across.factor
            axes.axvline(x, color=GREY, linewidth=0.6, linestyle=dashes, label=words)
    for number, slip in enumerate(result.slips):
        axes.axvline(
            slip.position * across.factor,
            color="#b2182b",
            linewidth=0.6,
            linestyle=(0, (5, 2)),
            label=f"slip, {slip.decision}" if number == 0 else None,
        )
    at, force = _value(result, "failure_displacement"), _value(result, "failure_force")
    if at is not None and force is not None:
        axes.plot(at * across.factor, force * up.factor, "x", color="#b2182b", label="failure")


def _value(result: TestResult, name: str) -> float | None:
    found: list[Result] = [each for each in result.results if each.name == name]
    return found[0].value if found else None


def _scales(result: TestResult) -> tuple[Scale, Scale]:
    return scale(result, "displacement", "m"), scale(result, "force", "N")


_TIME_BINS = 900
_MOTIONS = {"travel": "Travel", "displacement": "Displacement"}
"""Series that show the motion, the better one first, and the word on the axis."""
_AS_RECORDED: dict[str, Any] = {"color": "#9a9a9a", "linewidth": 0.6}
_CURVE: dict[str, Any] = {"color": "C0", "linewidth": 0.8}
_TWO_SIDED_95 = 1.96


def draw_timeline(result: TestResult) -> Figure:
    """Draw force and motion on one time axis, and the alignment residuals where there are any."""
    fit = result.aligned.clock_fit if result.aligned is not None else None
    page = new_page(result, width_mm=DOUBLE_COLUMN, height_mm=110 if fit else 80)
    ratios = [3, 3, 2] if fit else [1, 1]
    panels = page.subplots(len(ratios), 1, sharex=True, height_ratios=ratios)
    plot_force(result, panels[0])
    plot_motion(result, panels[1])
    if fit is not None:
        plot_residuals(result, panels[2])
    panels[-1].set_xlabel(scale(result, "time", "s").label("Time"))
    for axes in panels:
        axes.locator_params(axis="y", nbins=5)
    page.align_ylabels(list(panels))
    return page


def plot_force(result: TestResult, axes: Axes) -> None:
    """Draw the force against time: samples as recorded in grey, the curve over them."""
    up = scale(result, "force", "N")
    aligned, curve = result.aligned, result.curve
    if aligned is not None and "force" in aligned.series:
        shown = up.factor * aligned.series["force"].values
        _plot_over_time(result, axes, aligned.time, shown, label="raw", **_AS_RECORDED)
    if curve is not None:
        words = treatment_of_force(result).value
        _plot_over_time(result, axes, curve.time, up.factor * curve.force, label=words, **_CURVE)
    if not axes.lines:
        say(axes, why_missing(result, "force"))
        return
    axes.set_ylabel(up.label("Force"))
    side_key(axes, axes.lines)


def plot_motion(result: TestResult, axes: Axes) -> None:
    """Draw travel, or displacement where there is no travel, with the turning points on it."""
    found = motion(result)
    if found is None:
        say(axes, why_missing(result, "motion"))
        return
    word, time, values = found
    up, along = scale(result, "displacement", "m"), scale(result, "time", "s")
    _plot_over_time(result, axes, time, values * up.factor, color="C0", label="motion")
    turns = turning_points(result)
    if len(turns):
        heights = np.interp(turns, time, values, left=np.nan, right=np.nan) * up.factor
        axes.plot(
            turns * along.factor, heights, "o", color="C1", mfc="white", label="turning point"
        )
        side_key(axes, axes.lines[-1:])
    axes.set_ylabel(up.label(word))


def motion(result: TestResult) -> tuple[str, Floats, Floats] | None:
    """Find the motion of a test: the word for it, its time in s, its values in m."""
    aligned, curve = result.aligned, result.curve
    for name, word in _MOTIONS.items():
        if aligned is not None and name in aligned.series:
            return word, aligned.time, aligned.series[name].values
    return None if curve is None else ("Displacement", curve.time, curve.displacement)


def turning_points(result: TestResult) -> Floats:
    """Times at which branches begin or end, s, each once."""
    branches = result.curve.branches if result.curve is not None else ()
    times = [time for branch in branches for time in (branch.start_time, branch.stop_time)]
    return np.unique(np.array(times, dtype=np.float64))


def plot_residuals(result: TestResult, axes: Axes) -> None:
    """Draw what the straight line between the clocks leaves over at each event.

    Parameters
    ----------
    result : its clock fit is drawn; bars are 95 % of the error of each event
    axes : to draw on; an explaining sentence if there is no clock fit
    """
    fit = result.aligned.clock_fit if result.aligned is not None else None
    if fit is None:
        say(axes, why_missing(result, "clock fit"))
        return
    along = scale(result, "time", "s").factor
    over = (fit.event_times_force - fit.to_force_time(fit.event_times_motion)) * 1e3
    axes.axhline(0.0, color=GREY, linewidth=0.6)
    axes.errorbar(
        fit.event_times_motion * along,
        over,
        yerr=_TWO_SIDED_95 * fit.event_errors * 1e3,
        fmt="o",
        color="C1",
        markerfacecolor="white",
        elinewidth=0.7,
        capsize=1.5,
        label="95 %",
    )
    axes.set_ylabel("Residual (ms)")
    axes.set_title(_words(fit), loc="right", size=8, color=GREY)


def _words(fit: ClockFit) -> str:
    """Offset and drift with half the width of their intervals, and the residual."""
    ends = fit.offset_interval, fit.drift_interval
    half_offset, half_drift = ((end.upper - end.lower) / 2 for end in ends)
    return (
        f"offset {fit.offset:.4f} ± {half_offset:.4f} s,  "
        f"drift {fit.drift * 1e6:.1f} ± {half_drift * 1e6:.1f} ppm,  "
        f"residual {fit.residual * 1e3:.2f} ms (rms); bars: 95 %"
    )


def _plot_over_time(
    result: TestResult, axes: Axes, time: Floats, shown: Floats, **look: Any
) -> None:
    kept = extremes(shown, bins=_TIME_BINS)
    along = scale(result, "time", "s").factor
    axes.plot(time[kept] * along, shown[kept], **look)
    axes.margins(x=0.01)
