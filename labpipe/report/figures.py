"""Figures of one test by their names in protocols; those of its curve, its law and its clocks."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from labpipe.errors import ProtocolError
from labpipe.protocol.load import parse_protocol
from labpipe.records.arrays import Floats
from labpipe.records.curve import (
    Bending,
    Branch,
    ClockFit,
    Curve,
    Direction,
    FittedLine,
    Interval,
    MeasuredLaw,
)
from labpipe.records.result import Result, TestResult
from labpipe.report.budget_figures import draw_budget
from labpipe.report.figure_page import (
    DASHED,
    DOUBLE_COLUMN,
    GREY,
    RED,
    FigureToSave,
    add_key,
    add_title,
    finish_layout,
    fix_fonts,
    list_style_colours,
    make_empty_page,
    make_page,
    sample_colour_map,
    save_pages,
    style,
    write_reason,
)
from labpipe.report.marker_figures import draw_marker_quality, draw_wire_shapes
from labpipe.report.plot_records import find_extremes
from labpipe.report.wording import (
    Scale,
    choose_unit,
    explain_missing,
    find_last_place,
    round_to_place,
    typeset_unit,
    write_count,
    write_footnote,
    write_label,
    write_number,
    write_title,
)
from labpipe.statistics.lots import FORCE_LIMIT

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Figure  # noqa: PLC0414 - the API imports it from here


def is_as_recorded(result: TestResult, *names: str) -> bool:
    """Return whether the curve of a test has the samples that were recorded.

    Parameters
    ----------
    result : its curve is compared with its aligned series
    names : ``force``, ``displacement``; without aligned series to compare with, they are not
    """
    rounding_share = 1e-9  # of the range of the signal
    series = result.aligned.series if result.aligned is not None else {}
    for name in names:
        after = None if result.curve is None else getattr(result.curve, name)
        if after is None or name not in series or len(series[name].values) != len(after):
            return False
        if np.isnan(after).all():
            return False
        change = np.nanmax(np.abs(after - series[name].values))
        if change > rounding_share * float(np.nanmax(after) - np.nanmin(after)):
            return False
    return True


_MAX_CYCLE_COLOURS = 6
"""Cycles in a key; more cycles get a colour bar."""
_STYLES: dict[Direction, Any] = {Direction.LOADING: "-", Direction.UNLOADING: (0, (4, 1.6))}


def draw_force_displacement(result: TestResult) -> Figure:
    """Draw (a) the calibrated samples as recorded and (b) the curve, in one panel if equal."""
    if is_as_recorded(result, "force", "displacement"):
        page = make_page(height_mm=82)
        panels = [page.subplots()]
        panels[0].set_title("As recorded", loc="left")
    else:
        page = make_page(height_mm=82, width_mm=DOUBLE_COLUMN)
        panels = list(page.subplots(1, 2, sharex=True, sharey=True))
        plot_raw(result, panels[0])
        panels[0].set_title("As recorded", loc="left")
        panels[1].set_title("As processed", loc="left")
    plot_filtered(result, panels[-1])
    _draw_limit(result, panels)
    if len(panels) > 1:
        panels[-1].set_ylabel("")
    count = max((branch.cycle for branch in _branches(result)), default=0)
    if count > _MAX_CYCLE_COLOURS:
        _draw_colour_bar(page, panels, count)
    return add_title(page, write_title(result), write_footnote(result))


def _draw_limit(result: TestResult, panels: list[Axes]) -> None:
    """Draw the smallest force allowed, if the protocol asks for one."""
    limit = _value(result, FORCE_LIMIT)
    look: dict[str, Any] = {"color": RED, "linewidth": 0.9, "linestyle": DASHED}
    for axes in panels if limit is not None else ():
        axes.axhline((limit or 0.0) * _scales(result)[1].factor, **look)
        add_key(axes, "smallest force allowed", **look)


def plot_raw(result: TestResult, axes: Axes) -> None:
    """Draw the unfiltered force against the unfiltered displacement, unloading dashed.

    Parameters
    ----------
    result : its aligned series ``force`` and ``displacement`` are drawn, coloured by cycle between
        the turning points of the curve, or in one colour without a curve
    axes : to draw on; an explaining sentence if there are no such series
    """
    aligned = result.aligned
    if aligned is None or not {"force", "displacement"} <= set(aligned.series):
        write_reason(axes, explain_missing(result, "unfiltered force and displacement"))
        return
    x, y = aligned.series["displacement"].values, aligned.series["force"].values
    parts = [
        slice(start, stop + 1)
        for branch in _branches(result)
        for start, stop in [
            np.searchsorted(aligned.time, [branch.start_time, branch.stop_time]).tolist()
        ]
    ]
    _plot_branches(result, axes, x, y, parts, linewidth=0.5)


def plot_filtered(result: TestResult, axes: Axes) -> None:
    """Draw the curve: loading solid, unloading dashed, the peak of each cycle marked.

    Parameters
    ----------
    result : its curve is drawn
    axes : to draw on; an explaining sentence if there is no curve
    """
    curve = result.curve
    if curve is None:
        write_reason(axes, explain_missing(result, "curve"))
        return
    # one sample more: the lines of two branches meet
    parts = [slice(branch.start, branch.stop + 1) for branch in curve.branches]
    _plot_branches(result, axes, curve.displacement, curve.force, parts)
    _mark_peaks(result, axes, curve)


def _plot_branches(
    result: TestResult, axes: Axes, x: Floats, y: Floats, parts: list[slice], **look: Any
) -> None:
    """Draw the branches of a test in the colours of their cycles; without branches all in grey."""
    max_grey_bins = 4000
    branches = _branches(result)
    count = max((branch.cycle for branch in branches), default=0)
    colours, has_names = choose_cycle_colours(count), 1 < count <= _MAX_CYCLE_COLOURS
    if not branches:
        _plot(result, axes, x, y, bins=max_grey_bins, color=GREY, linewidth=0.5)
    for branch, part in zip(branches, parts, strict=True):
        named: dict[str, Any] = {"label": f"cycle {branch.cycle}"} if has_names else {}
        dash = _STYLES[branch.direction]
        colour = colours[branch.cycle - 1]
        _plot(result, axes, x[part], y[part], color=colour, linestyle=dash, **named, **look)
    ways = {branch.direction for branch in branches}
    for direction in _STYLES if count > 1 or len(ways) > 1 else ():
        if direction in ways:
            colour = GREY if count > 1 else colours[0]
            add_key(axes, str(direction), color=colour, linestyle=_STYLES[direction])
    _label_axes(result, axes)


def _branches(result: TestResult) -> tuple[Branch, ...]:
    return result.curve.branches if result.curve is not None else ()


def _plot(
    result: TestResult, axes: Axes, x: Floats, y: Floats, *, bins: int = 350, **look: Any
) -> None:
    """Draw a thinned line of force against displacement, in SI, in the display units."""
    rows = find_extremes(y, bins=bins)
    across, up = _scales(result)
    axes.plot(x[rows] * across.factor, y[rows] * up.factor, **look)


def _label_axes(result: TestResult, axes: Axes) -> None:
    across, up = _scales(result)
    axes.set(xlabel=across.label("Displacement"), ylabel=up.label("Force"))
    axes.locator_params(axis="x", nbins=7)


def _mark_peaks(result: TestResult, axes: Axes, curve: Curve) -> None:
    """Mark the highest force of each cycle with an open triangle."""
    across, up = _scales(result)
    look: dict[str, Any] = {"marker": "v", "markerfacecolor": "white", "linestyle": ""}
    colours = choose_cycle_colours(int(curve.cycle.max(initial=0)))
    for number, colour in enumerate(colours, start=1):
        inside = np.flatnonzero((curve.cycle == number) & ~np.isnan(curve.force))
        if len(inside):
            top = inside[np.argmax(curve.force[inside])]
            x, y = curve.displacement[top] * across.factor, curve.force[top] * up.factor
            axes.plot(x, y, color=colour, **look)
    if curve.branches:
        add_key(axes, "peak", color=GREY if len(colours) > 1 else colours[0], **look)


def choose_cycle_colours(count: int) -> list[str]:
    """Return the colour of each cycle: of the style for a few, of a colour map for many."""
    return (
        list_style_colours()[:count]
        if count <= _MAX_CYCLE_COLOURS
        else sample_colour_map(count, 0.92)
    )


def _draw_colour_bar(page: Figure, panels: list[Axes], count: int) -> None:
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import ListedColormap, Normalize

    colours = ListedColormap(choose_cycle_colours(count))
    key = ScalarMappable(Normalize(0.5, count + 0.5), colours)
    bar = page.colorbar(key, ax=panels, pad=0.01, aspect=30, label="Cycle")
    bar.set_ticks(np.unique(np.linspace(1, count, min(count, 6)).round()).tolist())
    bar.outline.set_linewidth(0.4)


def draw_stiffness_lines(result: TestResult) -> Figure:
    """Draw the first loading branch with the lines fitted for stiffness."""
    branches = _branches(result)
    first = next((branch for branch in branches if branch.direction is Direction.LOADING), None)
    if result.curve is None or first is None:
        reason = explain_missing(result, "loading branch")
        return make_empty_page(
            write_title(result), reason, write_footnote(result), width_mm=DOUBLE_COLUMN
        )
    page = make_page(height_mm=92, width_mm=DOUBLE_COLUMN)
    axes = page.subplots()
    _plot_loading(result, result.curve, slice(first.start, first.stop), axes)
    _plot_lines(result, axes)
    _mark_points(result, axes)
    _label_axes(result, axes)
    return add_title(page, write_title(result), write_footnote(result))


def _plot_loading(result: TestResult, curve: Curve, part: slice, axes: Axes) -> None:
    """Draw a loading branch, and the measured one if slips were repaired."""
    loading_bins = 1500
    x, force = curve.displacement[part], curve.force[part]
    measured: dict[str, Any] = {"color": GREY, "linestyle": DASHED, "linewidth": 0.6}
    if result.aligned is not None and any(slip.decision == "repaired" for slip in result.slips):
        before = result.aligned.series["force"].values[part]
        _plot(result, axes, x, before, bins=loading_bins, label="as measured", **measured)
    _plot(result, axes, x, force, bins=loading_bins, label="loading", color="C0", linewidth=0.9)


def _plot_lines(result: TestResult, axes: Axes) -> None:
    """Draw each fitted line over its window: broad and pale, dotted for segments."""
    across, up = _scales(result)
    names = list(dict.fromkeys(line.result for line in result.lines))
    windows = [name for name in names if not name.startswith("segment")]
    colours = list_style_colours()[1:]  # the first is that of the curve
    for line in result.lines:
        x = np.array([line.start, line.stop])
        y = line.level + line.slope * (x - line.start)
        look: dict[str, Any] = {"color": "black", "linewidth": 0.8, "linestyle": (0, (1, 1.6))}
        if line.result in windows:
            colour = colours[windows.index(line.result) % len(colours)]
            look = {"color": colour, "linewidth": 4.0, "alpha": 0.4, "solid_capstyle": "butt"}
        label = _describe_slope(result, line)
        axes.plot(x * across.factor, y * up.factor, label=label, zorder=4, **look)


def _describe_slope(result: TestResult, line: FittedLine) -> str:
    """Write the name and the slope of a line, with the interval of the result, if any."""
    stiffness = choose_unit(result, "stiffness", "N/m")
    fitted = _result(result, line.result)
    slope, ends = line.slope, None
    if fitted is not None and fitted.unit == "N/m" and fitted.value is not None:
        slope, ends = fitted.value, fitted.interval
    number = write_number(slope, ends, stiffness.factor).text
    return f"{write_label(line.result)}: {number} {typeset_unit(stiffness.unit)}"


def _mark_points(result: TestResult, axes: Axes) -> None:
    """Mark break point, kink, onset of a plateau, slips and failure."""
    across, up = _scales(result)
    for name, label, dashes in (
        ("break_point", "break point", ":"),
        ("kink_displacement", "kink", ":"),
        ("plateau_displacement", "onset of plateau", (0, (8, 2))),
    ):
        place = _value(result, name)
        if place is not None:
            look: dict[str, Any] = {"color": GREY, "linewidth": 0.6, "linestyle": dashes}
            axes.axvline(place * across.factor, label=label, **look)
    slip_look: dict[str, Any] = {"color": RED, "linewidth": 0.6, "linestyle": (0, (5, 2))}
    for slip in result.slips:
        label = f"slip, {result.slips[0].decision}"
        axes.axvline(slip.position * across.factor, label=label, **slip_look)
    at, force = _value(result, "failure_displacement"), _value(result, "failure_force")
    if at is not None and force is not None:
        x, y = at * across.factor, force * up.factor
        axes.plot(x, y, color=RED, marker="x", linestyle="", label="failure")


def _result(result: TestResult, name: str) -> Result | None:
    return next((entry for entry in result.results if entry.name == name), None)


def _value(result: TestResult, name: str) -> float | None:
    entry = _result(result, name)
    return None if entry is None else entry.value


def _scales(result: TestResult) -> tuple[Scale, Scale]:
    return choose_unit(result, "displacement", "m"), choose_unit(result, "force", "N")


_BAND: dict[str, Any] = {"color": "black", "alpha": 0.18, "lw": 0}
_NOISE: dict[str, Any] = {"color": "#e6e6e6", "lw": 0, "zorder": 0}


def draw_moment_curvature(result: TestResult) -> Figure:
    """Draw (a) the cloud of all branches with the law and (b) the law's stiffnesses."""
    bending = result.bending
    if bending is None:
        reason = explain_missing(result, "measured moment-curvature")
        return make_empty_page(
            write_title(result), reason, write_footnote(result), width_mm=DOUBLE_COLUMN
        )
    page = make_page(height_mm=92, width_mm=DOUBLE_COLUMN)
    cloud, stiffness = page.subplots(1, 2)
    _plot_cloud(result, bending, cloud)
    cloud.set_title("Moment", loc="left")
    if bending.law is None:
        write_reason(stiffness, str(bending.reason or ""))
    else:
        _plot_stiffness(result, bending.law, stiffness)
    stiffness.set_title("Stiffness of the first loading", loc="left")
    return add_title(page, write_title(result), write_footnote(result), columns=5)


def _plot_cloud(result: TestResult, bending: Bending, axes: Axes) -> None:
    """Draw the points of all branches and the law with its band.

    Loading is drawn as dots, unloading as open circles, one colour per cycle, starting where the
    law puts the specimen at rest; the band is the 95 % interval of the law, the grey stripe the
    curvatures within noise.
    """
    max_cloud_points = 2500
    across, up = _bending_scale(result, "curvature"), _bending_scale(result, "moment")
    cloud, branches = bending.cloud, _branches(result)
    x, y = _points_from_rest(bending)
    every = -(-x.size // max_cloud_points)
    look: dict[str, Any] = {"linestyle": "", "marker": "o", "markeredgewidth": 0.4}
    colours = choose_cycle_colours(int(cloud.cycle.max(initial=1)))
    for branch in np.unique(cloud.branch)[::-1].tolist():  # the first loading on top
        rows = cloud.branch == branch
        colour = colours[int(cloud.cycle[rows][0]) - 1]
        is_loading = branch < len(branches) and branches[branch].direction is Direction.LOADING
        face = colour if is_loading else "none"
        points = (x[rows].ravel()[::every] * across.factor, y[rows].ravel()[::every] * up.factor)
        axes.plot(*points, markersize=1.8, color=colour, markerfacecolor=face, alpha=0.6, **look)
    for number, colour in enumerate(colours if len(colours) <= _MAX_CYCLE_COLOURS else (), 1):
        add_key(axes, f"cycle {number}", markersize=3, color=colour, **look)
    for word, face in (("loading", GREY), ("unloading", "none")):
        add_key(axes, word, markersize=3, color=GREY, markerfacecolor=face, **look)
    if bending.law is not None:
        law, floor = bending.law, bending.law.floor * across.factor
        ends = law.moment_lower * up.factor, law.moment_upper * up.factor
        curvature = law.curvature * across.factor
        axes.plot(curvature, law.moment * up.factor, "k", zorder=4, label="law, secant")
        # the points show through
        axes.fill_between(curvature, *ends, zorder=3, label="95 % of the law", **_BAND)
        axes.axvspan(-floor, floor, label="below noise", **_NOISE)
    axes.set(xlabel=across.label("Curvature"), ylabel=up.label("Bending moment"))


def _points_from_rest(bending: Bending) -> tuple[Floats, Floats]:
    """Return curvatures and moments from the straight, unloaded state; without a law from rest."""
    cloud, law = bending.cloud, bending.law
    if law is None:
        return cloud.curvature, cloud.moment
    size = np.interp(np.abs(cloud.moment_at_rest), law.moment, law.curvature)
    begin = np.sign(cloud.moment_at_rest) * size
    return cloud.curvature + begin, cloud.moment + cloud.moment_at_rest


def _plot_stiffness(result: TestResult, law: MeasuredLaw, axes: Axes) -> None:
    """Draw secant and tangent stiffness of the law against the logarithm of curvature.

    The law is drawn where curvature is above its noise; the grey stripe is where it is not;
    tangents are drawn at the knots of the law, where it is measured, with their intervals.
    """
    min_curvature_share = 1e-3  # start of the axis, of the largest curvature
    from matplotlib.ticker import LogFormatter

    across, up = _bending_scale(result, "curvature"), _bending_scale(result, "bending_stiffness")
    x = law.curvature[1:] * across.factor
    lower, middle, upper = (
        getattr(law, f"secant{end}")[1:] * up.factor for end in ("_lower", "", "_upper")
    )
    axes.fill_between(x, lower, upper, **_BAND)
    axes.plot(x, middle, color="black")
    at = np.unique(np.searchsorted(law.moment, law.knots).clip(1, len(law.moment) - 1))
    at = at[np.isfinite(law.tangent[at])]
    tangent = law.tangent[at]
    ends = np.stack([tangent - law.tangent_lower[at], law.tangent_upper[at] - tangent])
    axes.errorbar(
        law.curvature[at] * across.factor, tangent * up.factor, yerr=ends.clip(0.0) * up.factor,
        color="#D55E00", linestyle="", marker="o", markersize=3.2, capsize=1.5, elinewidth=0.7,
        markerfacecolor="white", label="tangent, 95 %",
    )  # fmt: skip
    start = max(0.5 * law.floor, min_curvature_share * law.curvature[-1]) * across.factor
    axes.axvspan(start, max(law.floor * across.factor, start), **_NOISE)
    axes.set_xscale("log")
    axes.set_xlim(start, float(x[-1]))
    axes.set_ylim(bottom=0.0)
    axes.xaxis.set_major_formatter("{x:g}")
    axes.xaxis.set_minor_formatter(LogFormatter(labelOnlyBase=False))
    axes.set(xlabel=across.label("Curvature"), ylabel=up.label("Bending stiffness"))


def _bending_scale(result: TestResult, quantity: str) -> Scale:
    """Return the display unit of curvature, moment or stiffness, typeset."""
    si_units = {"curvature": "1/m", "moment": "N*m", "bending_stiffness": "N*m^2"}
    unit = choose_unit(result, quantity, si_units[quantity])
    return Scale(unit.factor, typeset_unit(unit.unit))


def draw_timeline(result: TestResult) -> Figure:
    """Draw force and motion on one time axis, and the residuals of clock alignment, if any."""
    fit = result.aligned.clock_fit if result.aligned is not None else None
    page = make_page(height_mm=110 if fit else 80, width_mm=DOUBLE_COLUMN)
    ratios = [3, 3, 2] if fit else [1, 1]
    panels = page.subplots(len(ratios), 1, sharex=True, height_ratios=ratios)
    _plot_force(result, panels[0])
    _plot_motion(result, panels[1])
    if fit is not None:
        _plot_residuals(fit, choose_unit(result, "time", "s").factor, panels[2])
    panels[-1].set_xlabel(choose_unit(result, "time", "s").label("Time"))
    for axes in panels:
        axes.locator_params(axis="y", nbins=5)
    page.align_ylabels(list(panels))
    return add_title(page, write_title(result), write_footnote(result))


def _plot_force(result: TestResult, axes: Axes) -> None:
    """Draw the force against time: as recorded in grey, and the curve over it if it differs."""
    up = choose_unit(result, "force", "N")
    aligned, curve = result.aligned, result.curve
    is_untouched = is_as_recorded(result, "force")
    if aligned is not None and "force" in aligned.series and not is_untouched:
        force = up.factor * aligned.series["force"].values
        look: dict[str, Any] = {"color": "#9a9a9a", "linewidth": 0.6, "label": "force as recorded"}
        _plot_over_time(result, axes, aligned.time, force, **look)
    if curve is not None:
        label = "force as recorded" if is_untouched else "force as processed"
        look = {"color": "C0", "linewidth": 0.8, "label": label}
        _plot_over_time(result, axes, curve.time, up.factor * curve.force, **look)
    if not axes.lines:
        write_reason(axes, explain_missing(result, "force"))
        return
    axes.set_ylabel(up.label("Force"))


def _plot_motion(result: TestResult, axes: Axes) -> None:
    """Draw travel, or else displacement, with the turning points."""
    aligned, curve = result.aligned, result.curve
    motions = [
        (word, aligned.time, aligned.series[name].values)
        for name, word in (("travel", "Travel"), ("displacement", "Displacement"))
        if aligned is not None and name in aligned.series
    ]
    if curve is not None:
        motions.append(("Displacement", curve.time, curve.displacement))
    if not motions:
        write_reason(axes, explain_missing(result, "motion"))
        return
    word, time, values = motions[0]
    up, along = choose_unit(result, "displacement", "m"), choose_unit(result, "time", "s")
    _plot_over_time(result, axes, time, values * up.factor, color="C0")
    ends = [end for branch in _branches(result) for end in (branch.start_time, branch.stop_time)]
    if ends:
        turns = np.unique(np.array(ends, dtype=np.float64))
        heights = np.interp(turns, time, values, left=np.nan, right=np.nan) * up.factor
        look: dict[str, Any] = {"color": "C1", "markerfacecolor": "white"}
        axes.plot(turns * along.factor, heights, "o", label="turning point", **look)
    axes.set_ylabel(up.label(word))


def _plot_residuals(fit: ClockFit, along: float, axes: Axes) -> None:
    """Draw the residuals of the clock fit at each event, with 95 % of the error of each."""
    normal_quantile = 1.96
    over = (fit.event_times_force - fit.to_force_time(fit.event_times_motion)) * 1e3
    axes.axhline(0.0, color=GREY, linewidth=0.6)
    axes.errorbar(
        fit.event_times_motion * along, over, yerr=normal_quantile * fit.event_errors * 1e3,
        fmt="o", color="C1", markerfacecolor="white", elinewidth=0.7, capsize=1.5,
    )  # fmt: skip
    axes.set_ylabel("Residual (ms)")
    axes.set_title(_describe_clock_fit(fit), loc="right", color=GREY)


def _describe_clock_fit(fit: ClockFit) -> str:
    """Write offset and drift with half the width of their intervals, and the residual, if any."""
    clock_parameters = 2  # offset and drift
    events = len(fit.event_times_motion)
    left = f"residual {1e3 * fit.residual:.2g} ms (rms of {events})"
    if events <= clock_parameters:
        left = f"{write_count(events, 'event')} for two unknowns: no residual"
    offset = _with_half(fit.offset, fit.offset_interval, 1.0)
    drift = _with_half(fit.drift, fit.drift_interval, 1e6)
    return f"offset {offset} s,  drift {drift} ppm,  {left};  bars: 95 % of each event"


def _with_half(value: float, interval: Interval, factor: float) -> str:
    """Write a number and half the width of its interval, to the second digit of that half."""
    place = find_last_place(value, interval, factor)
    half = 0.5 * (interval.upper - interval.lower)
    text = f"{round_to_place(factor * value, place)} ± {round_to_place(factor * half, place)}"
    return text.replace("-", "\u2212")


def _plot_over_time(
    result: TestResult, axes: Axes, time: Floats, values: Floats, **look: Any
) -> None:
    rows = find_extremes(values, bins=900)
    axes.plot(time[rows] * choose_unit(result, "time", "s").factor, values[rows], **look)
    axes.margins(x=0.01)


FIGURES: dict[str, Callable[[TestResult], Figure]] = {
    "force-displacement": draw_force_displacement,
    "stiffness-lines": draw_stiffness_lines,
    "wire-shapes": draw_wire_shapes,
    "moment-curvature": draw_moment_curvature,
    "timeline": draw_timeline,
    "marker-quality": draw_marker_quality,
    "uncertainty-budget": draw_budget,
}


def save_figures(result: TestResult, folder: Path, *, png: bool = False) -> list[Path]:
    """Draw the figures that the protocol asks for as SVG.

    Parameters
    ----------
    result : a processed test; a figure without data says why it is empty
    folder : made if it is not there
    png : each as PNG, too

    Returns
    -------
    The files, in the order of the protocol.

    Raises
    ------
    ValueError
        If the protocol asks for a figure that does not exist.
    StoreError
        If a file cannot be written.

    Notes
    -----
    The same result gives the same bytes with the same version of matplotlib.
    """
    unknown = [name for name in result.figures if name not in FIGURES]
    if unknown:
        message = f"figures: expected names of {list(FIGURES)}, found {unknown}"
        raise ValueError(message)
    pages = [FigureToSave(name, partial(FIGURES[name], result)) for name in result.figures]
    return save_pages(pages, folder, run=result.run, png=png, is_journal=is_for_journal(result))


def is_for_journal(result: TestResult) -> bool:
    """Return whether the protocol of a test asks for figures in the style of a journal."""
    if "style: journal" not in result.protocol_yaml:  # parsing takes longer than a line is drawn
        return False
    try:
        return parse_protocol(result.protocol_yaml, result.test).report.style == "journal"
    except ProtocolError:  # of an earlier grammar
        return False


def draw_figure(result: TestResult, name: str) -> Figure:
    """Draw one figure for a notebook or a script.

    Parameters
    ----------
    result : a processed test
    name : one of `FIGURES`

    Returns
    -------
    The figure, laid out in labpipe's style, which it keeps wherever it is drawn.
    """
    with style(is_journal=is_for_journal(result)):
        page = FIGURES[name](result)
        finish_layout(page)
        return fix_fonts(page)
