"""Figures of one test by their names in protocols: its curve, its measured law, its clocks."""

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
from labpipe.records.result import TestResult
from labpipe.report.budget_figures import draw_budget
from labpipe.report.figure_page import (
    DOUBLE_COLUMN,
    GREY,
    FigureToSave,
    add_key,
    add_title,
    finish_layout,
    fix_fonts,
    list_style_colours,
    make_page,
    make_reason_page,
    read_look,
    sample_colour_map,
    save_pages,
    style,
    write_reason,
)
from labpipe.report.marker_figures import draw_marker_quality, draw_wire_shapes
from labpipe.report.plot_records import find_extremes
from labpipe.report.wording import (
    explain_missing,
    find_last_place,
    find_unit,
    find_units,
    round_to_place,
    write_count,
    write_footnote,
    write_label,
    write_number,
    write_title,
)
from labpipe.statistics.lots import FORCE_LIMIT, find_result

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Figure  # noqa: PLC0414 - the API imports it from here


def is_as_recorded(result: TestResult, *names: str) -> bool:
    """Return whether the curve of a test equals its aligned series sample by sample.

    Parameters
    ----------
    result : with a curve and aligned series
    names : of the signals to compare, ``force`` or ``displacement``

    Returns
    -------
    False also if the curve or one of the series is missing, or the curve is NaN throughout.
    Samples that are NaN in one of them are not compared.
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
"""Cycles that the key lists; more cycles have a colour bar."""
_STYLES: dict[Direction, Any] = {Direction.LOADING: "-", Direction.UNLOADING: (0, (4, 1.6))}


def draw_force_displacement(result: TestResult) -> Figure:
    """Draw the aligned samples and the curve beside them, or one panel if they are equal."""
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
    limit = find_result(result.results, FORCE_LIMIT)
    if limit is None or limit.value is None:
        return
    for axes in panels:
        axes.axhline(limit.value * find_unit(result.display, "force").factor, **read_look("limit"))
        add_key(axes, "smallest force allowed", **read_look("limit"))


def plot_raw(result: TestResult, axes: Axes) -> None:
    """Draw the aligned force against the aligned displacement, unloading dashed.

    Parameters
    ----------
    result : its series are coloured by cycle between the turning points of the curve; without a
        curve they are grey
    axes : to draw on; without these series, a sentence says so
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
    """Draw the curve: loading solid, unloading dashed, with a mark at the peak of each cycle.

    Parameters
    ----------
    result : with a curve
    axes : to draw on; without a curve, a sentence says so
    """
    curve = result.curve
    if curve is None:
        write_reason(axes, explain_missing(result, "curve"))
        return
    # with one sample more, the lines of neighbouring branches meet
    parts = [slice(branch.start, branch.stop + 1) for branch in curve.branches]
    _plot_branches(result, axes, curve.displacement, curve.force, parts)
    _mark_peaks(result, axes, curve)


def _plot_branches(
    result: TestResult, axes: Axes, x: Floats, y: Floats, parts: list[slice], **look: Any
) -> None:
    """Draw the branches of a test in the colours of their cycles; without branches, a grey line."""
    max_grey_bins = 4000
    branches = _branches(result)
    count = max((branch.cycle for branch in branches), default=0)
    colours, has_names = choose_cycle_colours(count), 1 < count <= _MAX_CYCLE_COLOURS
    if not branches:
        _plot(result, axes, x, y, bins=max_grey_bins, color=GREY, linewidth=0.5)
    for branch, part in zip(branches, parts, strict=True):
        label = f"cycle {branch.cycle}" if has_names else None
        dash = _STYLES[branch.direction]
        colour = colours[branch.cycle - 1]
        _plot(result, axes, x[part], y[part], color=colour, linestyle=dash, label=label, **look)
    directions = {branch.direction for branch in branches}
    for direction in _STYLES if count > 1 or len(directions) > 1 else ():
        if direction in directions:
            colour = GREY if count > 1 else colours[0]
            add_key(axes, str(direction), color=colour, linestyle=_STYLES[direction])
    _label_axes(result, axes)


def _branches(result: TestResult) -> tuple[Branch, ...]:
    return result.curve.branches if result.curve is not None else ()


def _plot(
    result: TestResult, axes: Axes, x: Floats, y: Floats, *, bins: int = 350, **look: Any
) -> None:
    """Draw a thinned line of force against displacement, in SI, in the display units."""
    rows = find_extremes(y, n_bins=bins)
    x_unit, y_unit = find_units(result.display, "displacement", "force")
    axes.plot(x[rows] * x_unit.factor, y[rows] * y_unit.factor, **look)


def _label_axes(result: TestResult, axes: Axes) -> None:
    x_unit, y_unit = find_units(result.display, "displacement", "force")
    axes.set(xlabel=x_unit.label("Displacement"), ylabel=y_unit.label("Force"))
    axes.locator_params(axis="x", nbins=7)


def _mark_peaks(result: TestResult, axes: Axes, curve: Curve) -> None:
    """Mark the highest force of each cycle with an open triangle."""
    x_unit, y_unit = find_units(result.display, "displacement", "force")
    colours = choose_cycle_colours(int(curve.cycle.max(initial=0)))
    for number, colour in enumerate(colours, start=1):
        inside = np.flatnonzero((curve.cycle == number) & ~np.isnan(curve.force))
        if len(inside):
            top = inside[np.argmax(curve.force[inside])]
            x, y = curve.displacement[top] * x_unit.factor, curve.force[top] * y_unit.factor
            axes.plot(x, y, **read_look("peak", color=colour))
    if curve.branches:
        colour = GREY if len(colours) > 1 else colours[0]
        add_key(axes, "peak", **read_look("peak", color=colour))


def choose_cycle_colours(count: int) -> list[str]:
    """Return a colour per cycle: those of the style for up to six cycles, else of a colour map."""
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
    """Draw the first loading branch with the lines fitted for stiffness, slips and failure."""
    branches = _branches(result)
    first = next((branch for branch in branches if branch.direction is Direction.LOADING), None)
    if result.curve is None or first is None:
        return make_reason_page(result, explain_missing(result, "loading branch"))
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
    if result.aligned is not None and any(slip.decision == "repaired" for slip in result.slips):
        before = result.aligned.series["force"].values[part]
        _plot(result, axes, x, before, bins=loading_bins, **read_look("as_measured"))
    _plot(result, axes, x, force, bins=loading_bins, **read_look("loading"))


def _plot_lines(result: TestResult, axes: Axes) -> None:
    """Draw each fitted line over its window: a broad pale line, or a dotted one for a segment."""
    x_unit, y_unit = find_units(result.display, "displacement", "force")
    names = list(dict.fromkeys(line.result for line in result.lines))
    windows = [name for name in names if not name.startswith("segment")]
    colours = list_style_colours()[1:]  # the first is that of the curve
    for line in result.lines:
        x = np.array([line.start, line.stop])
        y = line.level + line.slope * (x - line.start)
        look = read_look("fitted_segment")
        if line.result in windows:
            colour = colours[windows.index(line.result) % len(colours)]
            look = read_look("fit_window", color=colour)
        label = _describe_slope(result, line)
        axes.plot(x * x_unit.factor, y * y_unit.factor, label=label, **look)


def _describe_slope(result: TestResult, line: FittedLine) -> str:
    """Write the name and the slope of a line, with the interval of the result, if any."""
    stiffness = find_unit(result.display, "stiffness")
    fitted = next((number for number in result.results if number.name == line.result), None)
    slope, ends = line.slope, None
    if fitted is not None and fitted.unit == "N/m" and fitted.value is not None:
        slope, ends = fitted.value, fitted.interval
    number = write_number(slope, ends, stiffness.factor).text
    return f"{write_label(line.result)}: {number} {stiffness.unit}"


def _mark_points(result: TestResult, axes: Axes) -> None:
    """Mark break point, kink, onset of a plateau, slips and failure."""
    x_unit, y_unit = find_units(result.display, "displacement", "force")
    values = {number.name: number.value for number in result.results}
    for name in ("break_point", "kink_displacement", "plateau_displacement"):
        position = values.get(name)
        if position is not None:
            axes.axvline(position * x_unit.factor, **read_look(name))
    for slip in result.slips:
        look = read_look("slip_position", label=f"slip, {result.slips[0].decision}")
        axes.axvline(slip.position * x_unit.factor, **look)
    displacement, force = values.get("failure_displacement"), values.get("failure_force")
    if displacement is not None and force is not None:
        x, y = displacement * x_unit.factor, force * y_unit.factor
        axes.plot(x, y, **read_look("failure_point"))


def draw_moment_curvature(result: TestResult) -> Figure:
    """Draw (a) the moments of all branches with the law and (b) the stiffness of the law."""
    bending = result.bending
    if bending is None:
        return make_reason_page(result, explain_missing(result, "measured moment-curvature"))
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
    """Draw the points of all branches, and the law with its 95 % interval.

    Loading is drawn as dots and unloading as open circles, in the colours of the cycles. A grey
    stripe shows the curvatures below their noise.
    """
    max_cloud_points = 2500
    x_unit, y_unit = find_units(result.display, "curvature", "moment")
    cloud, branches = bending.cloud, _branches(result)
    x, y = _points_from_rest(bending)
    stride, look = -(-x.size // max_cloud_points), read_look("cloud")
    colours = choose_cycle_colours(int(cloud.cycle.max(initial=1)))
    for branch in np.unique(cloud.branch)[::-1].tolist():  # the first loading on top
        rows = cloud.branch == branch
        colour = colours[int(cloud.cycle[rows][0]) - 1]
        is_loading = branch < len(branches) and branches[branch].direction is Direction.LOADING
        face = colour if is_loading else "none"
        points = (
            x[rows].ravel()[::stride] * x_unit.factor,
            y[rows].ravel()[::stride] * y_unit.factor,
        )
        axes.plot(*points, markersize=1.8, color=colour, markerfacecolor=face, alpha=0.6, **look)
    for number, colour in enumerate(colours if len(colours) <= _MAX_CYCLE_COLOURS else (), 1):
        add_key(axes, f"cycle {number}", markersize=3, color=colour, **look)
    for label, face in (("loading", GREY), ("unloading", "none")):
        add_key(axes, label, markersize=3, color=GREY, markerfacecolor=face, **look)
    if bending.law is not None:
        law, floor = bending.law, bending.law.floor * x_unit.factor
        ends = law.moment_lower * y_unit.factor, law.moment_upper * y_unit.factor
        curvature = law.curvature * x_unit.factor
        axes.plot(curvature, law.moment * y_unit.factor, **read_look("law"))
        look = read_look("band_of_law", label="95 % of the law", zorder=3)
        axes.fill_between(curvature, *ends, **look)
        axes.axvspan(-floor, floor, **read_look("below_noise", label="below noise"))
    axes.set(xlabel=x_unit.label("Curvature"), ylabel=y_unit.label("Bending moment"))


def _points_from_rest(bending: Bending) -> tuple[Floats, Floats]:
    """Return curvatures and moments from the straight, unloaded state; without a law from rest."""
    cloud, law = bending.cloud, bending.law
    if law is None:
        return cloud.curvature, cloud.moment
    size = np.interp(np.abs(cloud.moment_at_rest), law.moment, law.curvature)
    curvature_at_rest = np.sign(cloud.moment_at_rest) * size
    return cloud.curvature + curvature_at_rest, cloud.moment + cloud.moment_at_rest


def _plot_stiffness(result: TestResult, law: MeasuredLaw, axes: Axes) -> None:
    """Draw the secant and the tangent stiffness of the law against curvature, logarithmic.

    Tangents with their intervals are drawn at the knots of the law. A grey stripe shows the
    curvatures below their noise.
    """
    min_curvature_share = 1e-3  # start of the axis, of the largest curvature
    from matplotlib.ticker import LogFormatter

    x_unit, y_unit = find_units(result.display, "curvature", "bending_stiffness")
    x = law.curvature[1:] * x_unit.factor
    lower, middle, upper = (
        getattr(law, f"secant{end}")[1:] * y_unit.factor for end in ("_lower", "", "_upper")
    )
    axes.fill_between(x, lower, upper, **read_look("band_of_law"))
    axes.plot(x, middle, color="black")
    at = np.unique(np.searchsorted(law.moment, law.knots).clip(1, len(law.moment) - 1))
    at = at[np.isfinite(law.tangent[at])]
    tangent = law.tangent[at]
    ends = np.stack([tangent - law.tangent_lower[at], law.tangent_upper[at] - tangent])
    curvature, errors = law.curvature[at] * x_unit.factor, ends.clip(0.0) * y_unit.factor
    look = read_look("measured_tangent")
    axes.errorbar(curvature, tangent * y_unit.factor, yerr=errors, **look)
    start = max(0.5 * law.floor, min_curvature_share * law.curvature[-1]) * x_unit.factor
    axes.axvspan(start, max(law.floor * x_unit.factor, start), **read_look("below_noise"))
    axes.set_xscale("log")
    axes.set_xlim(start, float(x[-1]))
    axes.set_ylim(bottom=0.0)
    axes.xaxis.set_major_formatter("{x:g}")
    axes.xaxis.set_minor_formatter(LogFormatter(labelOnlyBase=False))
    axes.set(xlabel=x_unit.label("Curvature"), ylabel=y_unit.label("Bending stiffness"))


def draw_timeline(result: TestResult) -> Figure:
    """Draw force and motion against time, and the residuals of clock alignment, if any."""
    fit = result.aligned.clock_fit if result.aligned is not None else None
    page = make_page(height_mm=110 if fit else 80, width_mm=DOUBLE_COLUMN)
    ratios = [3, 3, 2] if fit else [1, 1]
    panels = page.subplots(len(ratios), 1, sharex=True, height_ratios=ratios)
    _plot_force(result, panels[0])
    _plot_motion(result, panels[1])
    if fit is not None:
        _plot_residuals(fit, find_unit(result.display, "time").factor, panels[2])
    panels[-1].set_xlabel(find_unit(result.display, "time").label("Time"))
    for axes in panels:
        axes.locator_params(axis="y", nbins=5)
    page.align_ylabels(list(panels))
    return add_title(page, write_title(result), write_footnote(result))


def _plot_force(result: TestResult, axes: Axes) -> None:
    """Draw the force of the curve against time; the force as recorded is grey if it differs."""
    y_unit = find_unit(result.display, "force")
    aligned, curve = result.aligned, result.curve
    is_untouched = is_as_recorded(result, "force")
    if aligned is not None and "force" in aligned.series and not is_untouched:
        force = y_unit.factor * aligned.series["force"].values
        _plot_over_time(result, axes, aligned.time, force, **read_look("force_as_recorded"))
    if curve is not None:
        label = "force as recorded" if is_untouched else "force as processed"
        look = read_look("force", label=label)
        _plot_over_time(result, axes, curve.time, y_unit.factor * curve.force, **look)
    if not axes.lines:
        write_reason(axes, explain_missing(result, "force"))
        return
    axes.set_ylabel(y_unit.label("Force"))


def _plot_motion(result: TestResult, axes: Axes) -> None:
    """Draw travel, or displacement if it was not recorded, with the turning points of the curve."""
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
    y_unit, along = find_units(result.display, "displacement", "time")
    _plot_over_time(result, axes, time, values * y_unit.factor, color="C0")
    ends = [end for branch in _branches(result) for end in (branch.start_time, branch.stop_time)]
    if ends:
        turns = np.unique(np.array(ends, dtype=np.float64))
        heights = np.interp(turns, time, values, left=np.nan, right=np.nan) * y_unit.factor
        axes.plot(turns * along.factor, heights, **read_look("turning_point"))
    axes.set_ylabel(y_unit.label(word))


def _plot_residuals(fit: ClockFit, along: float, axes: Axes) -> None:
    """Draw the residual of the clock fit at each event, with its 95 % interval."""
    normal_quantile = 1.96
    residuals = (fit.event_times_force - fit.to_force_time(fit.event_times_motion)) * 1e3
    errors = normal_quantile * fit.event_errors * 1e3
    axes.axhline(0.0, color=GREY, linewidth=0.6)
    times = fit.event_times_motion * along
    axes.errorbar(times, residuals, yerr=errors, **read_look("clock_residual"))
    axes.set_ylabel("Residual (ms)")
    axes.set_title(_describe_clock_fit(fit), loc="right", color=GREY)


def _describe_clock_fit(fit: ClockFit) -> str:
    """Write offset and drift, each with half its interval, and the residual, if any."""
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
    rows = find_extremes(values, n_bins=900)
    axes.plot(time[rows] * find_unit(result.display, "time").factor, values[rows], **look)
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
    """Write the figures that the protocol names as SVG.

    Parameters
    ----------
    result : a processed test; a figure without data says why it is empty
    folder : made if it does not exist
    png : write each as PNG, too

    Returns
    -------
    The files, in the order of the protocol.

    Raises
    ------
    ValueError
        If the protocol names a figure that does not exist.
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
    """Return whether the protocol of a test sets ``style: journal`` for its figures.

    A protocol of an earlier grammar, which is no longer valid, does not.
    """
    if "style: journal" not in result.protocol_yaml:  # saves parsing, which takes longer
        return False
    try:
        return parse_protocol(result.protocol_yaml, result.test).report.style == "journal"
    except ProtocolError:
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
