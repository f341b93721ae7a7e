"""Make the figures of a single test, such as its curve, its shapes and its timeline."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from math import floor, log10
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from labpipe.errors import ProtocolError
from labpipe.messages import format_sentence
from labpipe.protocol.load import parse_protocol
from labpipe.protocol.schema import Protocol
from labpipe.records.arrays import Flags, Floats, Ints
from labpipe.records.curve import Branch, ClockFit, Direction, MeasuredLaw, PointFlag, Shape
from labpipe.records.estimates import UnavailableError
from labpipe.records.quality import Severity
from labpipe.records.result import Result, Status, TestResult, find_result
from labpipe.report import budgets, figure_page, wording
from labpipe.report import plot_records as plots
from labpipe.report.figure_page import DASHED, GREY, N_COLOURS, sample_colour_map
from labpipe.report.plot_records import Axis, Label, Line, Page, Plot, make_line, make_thinned_line
from labpipe.results.kinds import compute_loading_sign
from labpipe.results.stiffness import compute_area
from labpipe.results.tension import ProofStress, get_gauge_length
from labpipe.statistics.lots import FORCE_LIMIT

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Figure  # noqa: PLC0414 - the API imports it from here


def make_test_page(
    result: TestResult, name: str, panels: Sequence[Plot], note: str = "", **settings: Any
) -> Page:
    """Make a page of a test, with counts of the doubtful and failed results in its footnote.

    Parameters
    ----------
    result : result of the test
    name : name of the files of the page
    panels : panels of the page
    note : first sentences of the footnote; may be empty
    settings : fields of `Page` for size and layout; they do not apply if no panel has a line
    """
    if not any(panel.lines for panel in panels):
        settings = {"height": 40.0}
    specimen, counts = result.specimen, Counter(entry.status for entry in result.results)
    title = (
        f"{result.test}  \u00b7  {specimen.type}, spool {specimen.spool}, sample {specimen.sample}"
        f"  \u00b7  {result.protocol}"
    )
    statuses = (status for status in (Status.DOUBTFUL, Status.FAILED) if counts[status])
    problems = ", ".join(f"{counts[status]} {status}" for status in statuses)
    count_text = f"Of {len(result.results)} results: {problems}." if problems else ""
    return Page(name, title, panels, " ".join(filter(None, [note, count_text])), **settings)


def _explain_missing(result: TestResult, content: str) -> str:
    """Explain why a test has no data to draw: name the missing data and the first error."""
    errors = (note.message for note in result.quality if note.severity is Severity.ERROR)
    return " ".join([f"There is no {content} to draw.", *list(errors)[:1]])


def _read_protocol(result: TestResult) -> Protocol | None:
    """Read the protocol of a test; None if it is invalid, for example of an earlier grammar."""
    try:
        return parse_protocol(result.protocol_yaml, result.test)
    except ProtocolError:
        return None


_MAX_LEGEND_CYCLES = 6
"""Largest number of cycles in the legend of a figure.

The cycles of a test have the colours of the style up to this number, and colours of a colour map
beyond it.
"""
_BRANCH_DASHES: dict[Direction, Any] = {Direction.LOADING: "-", Direction.UNLOADING: DASHED}
"""Dash of the line of a branch, keyed by the direction of the branch."""


def make_force_displacement_page(result: TestResult) -> Page:
    """Make the page of force against displacement: the curve, and the recorded samples in grey."""
    lines, aligned = list(_make_curve_lines(result)), result.aligned
    if aligned is not None and {"force", "displacement"} <= set(aligned.series):
        x, y = (aligned.series[name].values for name in ("displacement", "force"))
        lines.insert(0, make_thinned_line("recorded", x, y, n_bins=4000))
    limit = find_result(result.results, FORCE_LIMIT)
    if lines and limit is not None and limit.value is not None:
        label = "smallest force allowed"
        lines.append(plots.make_horizontal_line("limit", limit.value, label=label))
    panels = [Plot(*_make_axes(result), lines, reason=_explain_missing(result, "curve"))]
    return make_test_page(result, "force-displacement", panels, height=92)


def _make_axes(result: TestResult, *quantities: str) -> tuple[Axis, Axis]:
    """Make the axes of two quantities, displacement and force if none are given."""
    x_name, y_name = quantities or ("Displacement", "Force")
    quantity_keys = [name.lower().replace(" ", "_") for name in (x_name, y_name)]
    x_scale, y_scale = wording.get_scales(result.display, *quantity_keys)
    return Axis(x_name, x_scale), Axis(y_name, y_scale)


def _make_curve_lines(result: TestResult) -> Iterator[Line]:
    """Yield the branches of the curve in the colours of their cycles, with marks at the peaks.

    Lines are solid in loading and dashed in unloading. A curve without branches is grey.
    """
    curve, branches = result.curve, _get_branches(result)
    if curve is None:
        return
    x, y = curve.displacement, curve.force
    if not branches:
        yield make_thinned_line("branch", x, y, n_bins=4000, color=GREY, linewidth=0.5)
        return
    n_cycles = max(branch.cycle for branch in branches)
    colours = choose_cycle_colours(n_cycles)
    legend_cycles = np.unique(np.linspace(1, n_cycles, min(n_cycles, _MAX_LEGEND_CYCLES)).round())
    for branch in branches:
        # one more sample makes the lines of neighbouring branches meet
        rows = slice(branch.start, branch.stop + 1)
        label = f"cycle {branch.cycle}" if n_cycles > 1 and branch.cycle in legend_cycles else ""
        settings = {
            "color": colours[branch.cycle - 1],
            "linestyle": _BRANCH_DASHES[branch.direction],
        }
        yield make_thinned_line("branch", x[rows], y[rows], label=label, **settings)
    legend_colour = GREY if n_cycles > 1 else colours[0]
    directions = {branch.direction for branch in branches}
    for direction, dash in _BRANCH_DASHES.items() if n_cycles > 1 or len(directions) > 1 else ():
        if direction in directions:
            settings = {"color": legend_colour, "linestyle": dash}
            yield plots.make_legend_line("branch", label=str(direction), **settings)
    _, cycle_numbers = curve.assign_samples()
    for cycle, colour in enumerate(colours, start=1):
        indices = np.flatnonzero((cycle_numbers == cycle) & ~np.isnan(y))
        if len(indices):
            peak_index = indices[np.argmax(y[indices])]
            yield make_line("peak", x[peak_index], y[peak_index], color=colour)
    yield plots.make_legend_line("peak", label="peak", color=legend_colour)


def _get_branches(result: TestResult) -> tuple[Branch, ...]:
    """Get the branches of the curve of a test; none without a curve."""
    return result.curve.branches if result.curve is not None else ()


def choose_cycle_colours(count: int) -> list[str]:
    """Choose a colour for each of `count` cycles, from the style or from a colour map."""
    if count > _MAX_LEGEND_CYCLES:
        return figure_page.sample_colour_map(count, 0.92)
    return [f"C{index}" for index in range(count)]


def make_stiffness_lines_page(result: TestResult) -> Page:
    """Make the page of the first loading with the fitted lines of stiffness, slips and failure.

    The loading before the repair of slips is also drawn if any slip was repaired.
    """
    curve, lines, n_bins = result.curve, list[Line](), 1500
    loading = None if curve is None else curve.first_loading
    if curve is not None and loading is not None:
        rows = slice(loading.start, loading.stop)
        x = curve.displacement[rows]
        if result.aligned is not None and any(slip.decision == "repaired" for slip in result.slips):
            measured_force = result.aligned.series["force"].values[rows]
            lines.append(make_thinned_line("as_measured", x, measured_force, n_bins=n_bins))
        lines.append(make_thinned_line("loading", x, curve.force[rows], n_bins=n_bins))
        lines += [*_make_fit_lines(result), *_make_event_lines(result)]
    reason = _explain_missing(result, "loading branch")
    panels = [Plot(*_make_axes(result), lines, reason=reason)]
    return make_test_page(result, "stiffness-lines", panels, height=92)


def _make_fit_lines(result: TestResult) -> Iterator[Line]:
    """Yield each fitted line over its window, broad and pale; lines of segments are dotted."""
    result_names = dict.fromkeys(fit.result for fit in result.lines)
    window_names = [name for name in result_names if not name.startswith("segment")]
    for fit in result.lines:
        x = np.array([fit.start, fit.stop])
        y = fit.level + fit.slope * (x - fit.start)
        settings: dict[str, Any] = {"look": "fitted_segment"}
        if fit.result in window_names:  # the first colour is that of the curve
            colour = f"C{window_names.index(fit.result) % (N_COLOURS - 1) + 1}"
            settings = {"look": "fit_window", "color": colour}
        entry = find_result(result.results, fit.result)
        if entry is None or entry.value is None:
            entry = Result(fit.result, fit.slope, "N/m")
        label = f"{wording.format_label(fit.result)}: {_describe_entry(result, entry)}"
        yield make_line(x=x, y=y, label=label, **settings)


def _describe_entry(result: TestResult, entry: Result) -> str:
    """Describe one result of a test by its value, its interval and its unit."""
    scale = wording.choose_scale(entry.name, entry.unit, result.display)
    value = np.nan if entry.value is None else entry.value
    return f"{wording.format_number(value, entry.interval, scale.factor).text} {scale.unit}"


def _make_event_lines(result: TestResult) -> Iterator[Line]:
    """Yield lines at break point, kink, onset of a plateau and slips, and the point of failure."""
    values = {entry.name: entry.value for entry in result.results}
    for name in ("break_point", "kink_displacement", "plateau_displacement"):
        position = values.get(name)
        if position is not None:
            yield plots.make_vertical_line(name, position)
    for slip in result.slips:
        label = f"slip, {slip.decision}"
        yield plots.make_vertical_line("slip_position", slip.position, label=label)
    displacement, force = values.get("failure_displacement"), values.get("failure_force")
    if displacement is not None and force is not None:
        yield make_line("failure_point", displacement, force)


class _StressStrainCurve(NamedTuple):
    """Stress-strain curve of a tension test; its elastic line starts at zero strain.

    Parameters
    ----------
    strain, stress : shape (n,), strain and stress (Pa) of all branches
    modulus : slope of the elastic line, Pa; NaN without an elastic line
    window : shape (2,), strains between which the line was fitted; empty without an elastic line
    offsets : plastic strain of each proof stress, keyed by the name of the proof stress
    """

    strain: Floats
    stress: Floats
    modulus: float
    window: Floats
    offsets: Mapping[str, float]


def _compute_stress_strain(result: TestResult) -> _StressStrainCurve | None:
    """Compute stress and strain; None without branches, area, gauge length or valid protocol."""
    curve, branches, protocol = result.curve, _get_branches(result), _read_protocol(result)
    if curve is None or not branches or protocol is None:
        return None
    specimen = protocol.specimen
    dimensions = {} if specimen.section is None else dict(vars(specimen.section))
    dimensions |= {"length": specimen.length, "gauge_length": specimen.gauge_length}
    stated_dimensions = {name: size for name, size in dimensions.items() if size is not None}
    try:
        area, length = compute_area(stated_dimensions), get_gauge_length(stated_dimensions)
    except UnavailableError:
        return None
    rows = slice(branches[0].start, branches[-1].stop)
    x, force = curve.displacement[rows], curve.force[rows]
    x, force = compute_loading_sign(x) * x, compute_loading_sign(force) * force
    first_displacement = float(x[np.isfinite(x)][:1].sum())  # 0 if no displacement is finite
    modulus, toe, window_ends = np.nan, first_displacement, np.zeros(0)
    for fit in result.lines:
        if fit.result == "elastic_modulus":
            window_ends = np.sort(np.abs([fit.start, fit.stop]))
            modulus, toe = fit.slope * length / area, window_ends[0] - fit.level / fit.slope
    requests = protocol.results
    offsets = {proof.name: proof.offset for proof in requests if isinstance(proof, ProofStress)}
    strain, window = (x - toe) / length, (window_ends - toe) / length
    return _StressStrainCurve(strain, force / area, modulus, window=window, offsets=offsets)


def make_stress_strain_page(result: TestResult) -> Page:
    """Make the page of (a) stress against strain with the results, (b) the elastic line."""
    strain_headroom, stress_headroom = 1.6, 1.1  # ratios that show all of the elastic line in (b)
    name, curve = "stress-strain", _compute_stress_strain(result)
    if curve is None:
        empty_plot = Plot(reason=_explain_missing(result, "stress-strain curve"))
        return make_test_page(result, name, [empty_plot])
    x, y = _make_axes(result, "Strain", "Pressure")
    y = replace(y, name="Stress")
    line = make_thinned_line("stress", curve.strain, curve.stress, n_bins=1500)
    lines = [line, *_make_tension_lines(result, curve)]
    whole_plot = Plot(x, y, lines, "Whole curve")
    initial_plot = Plot(x, y, heading="Beginning", reason="There is no elastic line to draw.")
    if len(curve.window):
        elastic_strain, offsets = curve.window[1], curve.offsets.values()
        max_strain = strain_headroom * (elastic_strain + min(offsets, default=elastic_strain))
        max_stress = stress_headroom * float(np.nanmax(curve.stress[curve.strain <= max_strain]))
        x = replace(x, low=-0.05 * max_strain, high=max_strain)
        y = replace(y, low=-0.02 * max_stress, high=max_stress)
        elastic_lines = _make_elastic_lines(result, curve, max_stress)
        initial_plot = Plot(x, y, [*lines, *elastic_lines], "Beginning")
    return make_test_page(result, name, [whole_plot, initial_plot], height=92)


def _make_tension_lines(result: TestResult, curve: _StressStrainCurve) -> Iterator[Line]:
    """Yield the points of proof stress, yield stress, strength and break, and the elongation."""
    entries = {entry.name: entry for entry in result.results if entry.value is not None}
    values = {name: entry.value or 0.0 for name, entry in entries.items()}
    points, curve_index = [], 0
    for name, offset in curve.offsets.items():
        if name in values:
            strain = offset + values[name] / curve.modulus
            points.append((name, f"Rp{100.0 * offset:g}", strain, values[name]))
    for name, symbol, curve_values in (
        ("upper_yield_stress", "ReH", curve.stress),
        ("lower_yield_stress", "ReL", curve.stress),
        ("tensile_strength", "Rm", curve.stress),
        ("elongation_at_break", "At", curve.strain),
    ):
        # these points follow each other along the curve: each is sought after the previous one
        if name in values and np.isfinite(curve_values[curve_index:]).any():
            deviations = np.abs(curve_values[curve_index:] - values[name])
            curve_index += int(np.nanargmin(deviations))
            points.append((name, symbol, curve.strain[curve_index], curve.stress[curve_index]))
    for colour_number, (name, symbol, strain, stress) in enumerate(points, start=1):
        label = f"{symbol} {_describe_entry(result, entries[name])}"
        colour = f"C{colour_number % N_COLOURS}"
        yield make_line("tension_number", strain, stress, label=label, color=colour)
    if elongation := entries.get("elongation_at_maximum_force"):
        label = f"Agt {_describe_entry(result, elongation)}"
        yield plots.make_vertical_line("elongation", values[elongation.name], label=label)


def _make_elastic_lines(
    result: TestResult, curve: _StressStrainCurve, max_stress: float
) -> Iterator[Line]:
    """Yield the elastic line over its window and up to a stress, and its offset lines."""
    window, end_strain = curve.window, max_stress / curve.modulus
    entry = find_result(result.results, "elastic_modulus")
    label = f"E {_describe_entry(result, entry or Result('elastic_modulus', curve.modulus, 'Pa'))}"
    yield make_line("fit_window", window, curve.modulus * window, label=label, color="C0")
    yield make_line("elastic_line", [0.0, end_strain], [0.0, max_stress])
    for offset in curve.offsets.values():
        yield make_line("offset_line", [offset, offset + end_strain], [0.0, max_stress])


def make_moment_curvature_page(result: TestResult) -> Page:
    """Make the page of (a) the moments of all branches with the law, (b) its stiffness."""
    bending = result.bending
    if bending is None:
        empty_plot = Plot(reason=_explain_missing(result, "measured moment-curvature"))
        return make_test_page(result, "moment-curvature", [empty_plot])
    x, moment = _make_axes(result, "Curvature", "Moment")
    moment_axis, lines = replace(moment, name="Bending moment"), list(_make_cloud_lines(result))
    heading = "Stiffness of the first loading"
    stiffness_plot = Plot(x, moment, heading=heading, reason=str(bending.reason or ""))
    if bending.law is not None:
        stiffness_plot = _make_stiffness_plot(result, bending.law, heading)
    panels = [Plot(x, moment_axis, lines, "Moment"), stiffness_plot]
    return make_test_page(result, "moment-curvature", panels, height=92, legend_columns=5)


def _make_cloud_lines(result: TestResult) -> Iterator[Line]:
    """Yield the points of all branches, and the law with its 95 % interval.

    Points are dots in loading and open circles in unloading, in the colours of the cycles. If there
    is a law, the points are shifted so that the origin is the straight, unloaded state, and a grey
    stripe marks the curvatures below the noise of the curvature.
    """
    max_points = 2500
    if result.bending is None:
        return
    cloud, law, branches = result.bending.cloud, result.bending.law, _get_branches(result)
    x, y = cloud.curvature, cloud.moment
    if law is not None:
        rest_curvature = np.interp(np.abs(cloud.moment_at_rest), law.moment, law.curvature)
        x, y = x + np.sign(cloud.moment_at_rest) * rest_curvature, y + cloud.moment_at_rest
    stride = -(-x.size // max_points)
    colours = choose_cycle_colours(int(cloud.cycle.max(initial=1)))
    for branch in np.unique(cloud.branch)[::-1].tolist():  # the first loading is on top
        rows = cloud.branch == branch
        colour = colours[int(cloud.cycle[rows][0]) - 1]
        is_loading = branch < len(branches) and branches[branch].direction is Direction.LOADING
        points = (values[rows].ravel()[::stride] for values in (x, y))
        fill = colour if is_loading else "none"
        yield make_line("cloud", *points, color=colour, markerfacecolor=fill)
    legend_colours = colours if len(colours) <= _MAX_LEGEND_CYCLES else ()
    for cycle, colour in enumerate(legend_colours, start=1):
        yield plots.make_legend_line("cloud_key", label=f"cycle {cycle}", color=colour)
    for label, fill in (("loading", GREY), ("unloading", "none")):
        yield plots.make_legend_line("cloud_key", label=label, color=GREY, markerfacecolor=fill)
    if law is not None:
        yield make_line("law", law.curvature, law.moment)
        band = law.curvature, law.moment_lower, law.moment_upper
        yield plots.make_area("band_of_law", *band, label="95 % of the law", zorder=3)
        yield plots.make_span("below_noise", -law.floor, law.floor, label="below noise")


def _make_stiffness_plot(result: TestResult, law: MeasuredLaw, heading: str) -> Plot:
    """Make the panel of the secant and the tangent stiffness of a law, with their intervals.

    Tangents are drawn at the knots of the law. A grey stripe marks the curvatures below the noise
    of the curvature.
    """
    min_curvature_ratio = 1e-3  # smallest start of the axis, relative to the largest curvature
    start = max(0.5 * law.floor, min_curvature_ratio * law.curvature[-1])
    x, y = _make_axes(result, "Curvature", "Bending stiffness")
    knot_rows = np.unique(np.searchsorted(law.moment, law.knots).clip(1, len(law.moment) - 1))
    knot_rows = knot_rows[np.isfinite(law.tangent[knot_rows])]
    curvature, tangent = law.curvature[knot_rows], law.tangent[knot_rows]
    lower = np.fmin(law.tangent_lower[knot_rows], tangent)
    upper = np.fmax(law.tangent_upper[knot_rows], tangent)
    bars = plots.join_with_gaps(curvature, curvature), plots.join_with_gaps(lower, upper)
    secant_edges = law.secant_lower[1:], law.secant_upper[1:]
    lines = [
        plots.make_area("band_of_law", law.curvature[1:], *secant_edges),
        make_line("law", law.curvature[1:], law.secant[1:]),
        make_line("interval_of_tangent", *bars),
        make_line("measured_tangent", curvature, tangent),
        plots.make_span("below_noise", start, max(law.floor, start)),
    ]
    x = replace(x, low=start, high=float(law.curvature[-1]), is_log=True)
    return Plot(x, replace(y, low=0.0), lines, heading)


def make_timeline_page(result: TestResult) -> Page:
    """Make the page of force, motion and, if clocks were fitted, their residuals against time."""
    aligned, curve = result.aligned, result.curve
    force_lines, motion_lines = list[Line](), _make_motion_lines(result)
    fit = None if aligned is None else aligned.clock_fit
    if aligned is not None and "force" in aligned.series:
        force = aligned.series["force"].values
        force_lines.append(make_thinned_line("recorded", aligned.time, force, n_bins=900))
    if curve is not None:
        force_lines.append(make_thinned_line("force", curve.time, curve.force, n_bins=900))
    motion_name = "Travel" if aligned and "travel" in aligned.series else "Displacement"
    quantities = ("time", "force", "displacement")
    time_scale, force_scale, motion_scale = wording.get_scales(result.display, *quantities)
    times = [line.x for line in (*force_lines, *motion_lines)]
    time = plots.make_axis("Time", time_scale, times, margin=0.01)
    force_axis, motion_axis = Axis("Force", force_scale), Axis(motion_name, motion_scale)
    panels = [
        Plot(time, force_axis, force_lines, reason=_explain_missing(result, "force")),
        Plot(time, motion_axis, motion_lines, reason=_explain_missing(result, "motion")),
    ]
    if fit is not None:
        panels.append(_make_residual_plot(fit, time))
    layout: dict[str, Any] = {"columns": 1, "heights": [3, 3, 2][: len(panels)]}
    layout |= {"height": 110 if fit else 80, "shared_axes": "x"}
    return make_test_page(result, "timeline", panels, **layout)


def _make_motion_lines(result: TestResult) -> list[Line]:
    """Make the line of the travel, or of the displacement without it, and the turning points."""
    aligned, curve = result.aligned, result.curve
    names = [name for name in ("travel", "displacement") if aligned and name in aligned.series]
    if aligned is not None and names:
        time, values = aligned.time, aligned.series[names[0]].values
    elif curve is not None:
        time, values = curve.time, curve.displacement
    else:
        return []
    branches = _get_branches(result)
    ends = (end for branch in branches for end in (branch.start_time, branch.stop_time))
    turning_times = np.unique(list(ends))
    turning_points = np.interp(turning_times, time, values, left=np.nan, right=np.nan)
    lines = [make_thinned_line("motion", time, values, n_bins=900)]
    lines += [make_line("turning_point", turning_times, turning_points)] if branches else []
    return lines


def _make_residual_plot(fit: ClockFit, time: Axis) -> Plot:
    """Make the panel of the residual of the clock fit at each event, with its 95 % interval.

    A label gives offset and drift with their intervals, and the residual of more than two events.
    """
    normal_quantile, n_parameters = 1.96, 2  # for 95 %; offset and drift
    event_times, half_widths = fit.event_times_motion, normal_quantile * fit.event_errors
    residuals, n_events = fit.event_times_force - fit.to_force_time(event_times), len(event_times)
    bars = plots.join_with_gaps(residuals - half_widths, residuals + half_widths)
    lines = [
        plots.make_horizontal_line("zero", 0.0),
        make_line("clock_interval", plots.join_with_gaps(event_times, event_times), bars),
        make_line("clock_residual", event_times, residuals),
    ]
    residual_text = f"residual {1e3 * fit.residual:.2g} ms (rms of {n_events})"
    if n_events <= n_parameters:
        residual_text = f"{wording.format_count(n_events, 'event')} for two unknowns: no residual"
    offset = wording.format_with_interval(fit.offset, fit.offset_interval)
    drift = wording.format_with_interval(fit.drift, fit.drift_interval, 1e6)
    clock_text = f"offset {offset} s,  drift {drift} ppm".replace("-", "\u2212")
    text = f"{clock_text},  {residual_text};  bars: 95 % of each event"
    settings = {"ha": "right", "va": "bottom", "color": GREY}
    label = Label(text, np.inf, np.inf, (0.0, 3.0), settings)
    return Plot(time, Axis("Residual", wording.Scale(1e3, "ms")), lines, labels=[label])


_FLAG_MARKS: dict[PointFlag, Any] = {
    PointFlag.MEASURED: {"marker": "o"},
    PointFlag.RELABELLED: {"marker": "s"},
    PointFlag.FILLED: {"marker": "o", "markerfacecolor": "white"},
    PointFlag.CONSTRUCTED: {"marker": "D", "markerfacecolor": "white"},
}
"""Symbol of a marker, keyed by the origin of its position."""

_EXCURSION = "tip excursion"
"""Name of the distance of the tip from its first position, for tests without a loading branch."""


class FrameSelection(NamedTuple):
    """Frames whose shapes are drawn.

    Parameters
    ----------
    frames : shape (n,), indices of the frames, in the order of the deflections
    deflections : shape (n,), nominal deflection of the tip in each frame, m
    deflection_name : name of the deflection in the legend
    """

    frames: Ints
    deflections: Floats
    deflection_name: str


def make_wire_shapes_page(result: TestResult) -> Page:
    """Make the page of the shapes in the plane of bending, or in two planes without a loading."""
    panel_width_mm, margins_mm, gap_mm = 144.0, 17.0, 14.0
    shape = result.shape
    if shape is None or not len(shape.time):
        empty_plot = Plot(reason=_explain_missing(result, "shape"))
        return make_test_page(result, "wire-shapes", [empty_plot])
    selection = choose_shape_frames(result, shape)
    scale = wording.get_scale(result.display, "displacement")
    axis_names = "xyz" if selection.deflection_name == _EXCURSION else "xy"
    curves = [_compute_fitted_curve(shape, int(frame)).T for frame in selection.frames]
    points = np.concatenate([shape.positions[selection.frames].reshape(-1, 3), *curves])
    points = points[:, : len(axis_names)]
    x_axis, *side_axes = plots.make_axes_to_scale(axis_names, scale, points, min_aspect=0.1)
    panels, heights = [], []
    for axis_index, side_axis in enumerate(side_axes, start=1):
        lines = list(make_shape_lines(shape, selection, scale, axis_index=axis_index))
        heading = f"x-{side_axis.name} view" if len(side_axes) > 1 else ""
        panels.append(Plot(x_axis, side_axis, lines, heading, is_to_scale=True))
        aspect = (side_axis.high - side_axis.low) / (x_axis.high - x_axis.low)
        heights.append(panel_width_mm * aspect)
    height = sum(heights) + margins_mm + gap_mm * (len(side_axes) - 1)
    layout: dict[str, Any] = {"height": height, "heights": heights, "columns": 1}
    note = _describe_offset(result, shape)
    return make_test_page(result, "wire-shapes", panels, note, **layout)


def choose_shape_frames(result: TestResult, shape: Shape) -> FrameSelection:
    """Choose frames at equal, round steps of the deflection of the tip.

    Parameters
    ----------
    result : result of the test. The deflection is that of its first loading branch; without a
        loading branch, it is the distance of the tip from its first position
    shape : shape of at least one frame

    Returns
    -------
    At most seven frames from deflection zero upwards. If no deflection is known, only the first
    frame is chosen.
    """
    deflection = interpolate_loading_deflection(result, shape.time)
    name = "tip deflection" if _is_clamped(shape) else "deflection"
    if deflection is None:
        deflection, name = _compute_tip_excursion(shape.positions), _EXCURSION
    if np.isnan(deflection).all():
        return FrameSelection(np.zeros(1, dtype=np.int64), np.zeros(1), name)
    scale = wording.get_scale(result.display, "displacement")
    return FrameSelection(*choose_frames_at_steps(deflection, scale.factor), name)


def choose_frames_at_steps(deflection: Floats, factor: float = 1.0) -> tuple[Ints, Floats]:
    """Choose frames at equal, round steps of a deflection.

    Parameters
    ----------
    deflection : shape (n_frames,), m; frames with NaN are not chosen
    factor : factor from m to the unit in which the steps are round

    Returns
    -------
    frames : shape (n,), index of the first frame at or beyond each step, because later frames may
        belong to another motion
    deflections : shape (n,), deflection of each step, m; at most seven, from zero upwards
    """
    max_steps, tolerance = 6, 1e-12  # tolerance of a deflection, m
    max_deflection = factor * float(np.max(deflection, initial=0.0, where=~np.isnan(deflection)))
    decade = 10.0 ** floor(log10(max_deflection / max_steps)) if max_deflection > 0.0 else 1.0
    steps = (n * decade for n in (1.0, 2.0, 5.0, 10.0))
    step = next(step for step in steps if step * max_steps >= max_deflection)
    nominal = np.linspace(0.0, max_steps * step / factor, max_steps + 1)
    frames_beyond = [np.flatnonzero(deflection >= value - tolerance) for value in nominal]
    first_frames = [frames[0] for frames in frames_beyond if len(frames)]
    return np.array(first_frames, dtype=np.int64), nominal[: len(first_frames)]


def _compute_tip_excursion(positions: Floats) -> Floats:
    """Compute the distance of the tip from its first position, m; NaN where it is not tracked.

    The tip is the last point that has a position in at least one frame.
    """
    is_tracked: Flags = np.asarray(np.isfinite(positions).all(axis=2))
    if not is_tracked.any():
        return np.full(len(positions), np.nan)
    tip_index = np.flatnonzero(is_tracked.any(axis=0))[-1:]
    tip = positions[:, tip_index[0]]
    distance: Floats = np.linalg.norm(tip - tip[is_tracked[:, tip_index[0]]][0], axis=1)
    return distance


def interpolate_loading_deflection(result: TestResult, time: Floats) -> Floats | None:
    """Interpolate the displacement of the curve at the frames of its first loading branch.

    Parameters
    ----------
    result : result of the test, with or without a curve
    time : shape (n_frames,), time of the frames on the clock of the curve, s

    Returns
    -------
    Displacement, shape (n_frames,), m; NaN outside the branch. None without a loading branch.
    """
    curve = result.curve
    loading = None if curve is None else curve.first_loading
    if curve is None or loading is None:
        return None
    deflection: Floats = np.interp(time, curve.time, curve.displacement)
    deflection[(time < loading.start_time) | (time > loading.stop_time)] = np.nan
    return deflection


def _is_clamped(shape: Shape) -> bool:
    """Return whether the first point of a shape is constructed: the specimen is then clamped."""
    return bool((shape.flags[:, 0] == PointFlag.CONSTRUCTED).any())


def _describe_offset(result: TestResult, shape: Shape) -> str:
    """Describe the offset of the markers from the axis of a clamped specimen; empty if negligible.

    The text is also empty for a shape without fitted curves.
    """
    min_offset = 1e-5  # m; a smaller offset is not visible in the figure
    n_terms, protocol = shape.coefficients.shape[2], _read_protocol(result)
    markers = None if protocol is None else protocol.markers
    centre_offset = 0.0 if markers is None else abs(markers.centre_offset)
    if not _is_clamped(shape) or centre_offset < min_offset or not n_terms:
        return ""
    scale = wording.get_scale(result.display, "displacement")
    facts = {"offset": centre_offset * scale.factor, "unit": scale.unit}
    return format_sentence("report.markers_beside_axis", **facts)


def make_shape_lines(
    shape: Shape, selection: FrameSelection, scale: wording.Scale, *, axis_index: int
) -> Iterator[Line]:
    """Yield the points and fitted curves of selected frames, and their entries in the legend.

    Parameters
    ----------
    shape : points and fitted curves of all frames
    selection : frames that are drawn
    scale : display unit of displacements, for the legend
    axis_index : vertical axis: 1 for y, in the plane of bending; 2 for z, out of plane
    """
    colours, frames = sample_colour_map(len(selection.frames)), selection.frames.tolist()
    for frame, deflection, colour in zip(frames, selection.deflections, colours, strict=True):
        curve = _compute_fitted_curve(shape, frame)[[0, axis_index]]
        yield make_line("fitted_curve", *curve, color=colour)
        for flag, mark in _FLAG_MARKS.items():
            rows = shape.flags[frame] == flag
            if rows.any():
                x, y = shape.positions[frame][rows][:, [0, axis_index]].T
                yield make_line("marker", x, y, color=colour, **mark)
        text = f"{deflection * scale.factor:g} {scale.unit}"
        label = f"{selection.deflection_name} {text}" if frame == frames[0] else text
        yield plots.make_legend_line("fitted_curve", label=label, color=colour, linewidth=1.6)
    drawn_flags = set(np.unique(shape.flags[frames]))
    for flag, mark in _FLAG_MARKS.items():
        if flag in drawn_flags:
            yield plots.make_legend_line("marker", label=flag.name.lower(), **mark)
    if shape.coefficients.shape[2]:
        yield plots.make_legend_line("fitted_curve", label="fitted curve")


def _compute_fitted_curve(shape: Shape, frame: int) -> Floats:
    """Compute points on the fitted curve, shape (3, n_points), m; no points without a curve."""
    n_terms = shape.coefficients.shape[2]
    n_points = 81 if n_terms else 0
    parameter = np.linspace(0, 1, n_points)  # arc length divided by the total length
    curve: Floats = shape.coefficients[frame] @ parameter[None, :] ** np.arange(n_terms)[:, None]
    return curve


FLAG_COLOURS = {
    PointFlag.MEASURED: "#c3d3e0",
    PointFlag.RELABELLED: "#0072b2",
    PointFlag.FILLED: "#e69f00",
    PointFlag.MISSING: "#1a1a1a",
}
"""Colour of a flag in the figure of the flags, keyed by flag."""
_FLAGS_BY_SEVERITY = (
    PointFlag.CONSTRUCTED, PointFlag.MEASURED, PointFlag.RELABELLED, PointFlag.FILLED,
    PointFlag.MISSING,
)  # fmt: skip
"""Flags of points in order of severity; the worst is last."""
_MAX_TIME_BINS = 900
"""Largest number of bins in time, about one bin per pixel."""


def make_marker_quality_page(result: TestResult) -> Page:
    """Make the page of the flags of each marker and of the error of each body against time."""
    row_mm, min_panel_mm, margins_mm = 4.2, 25.0, 30.0
    recordings = result.recordings.values()
    times = [recording.markers.time for recording in recordings if recording.markers]
    times = times if result.shape is None else [result.shape.time, *times]
    time = plots.make_axis("Time", wording.get_scale(result.display, "time"), times, margin=0.01)
    panels = [make_flag_plot(result, time), _make_tracking_plot(result, time)]
    heights = [max(row_mm * len(panels[0].y.row_names), min_panel_mm), min_panel_mm]
    return make_test_page(
        result, "marker-quality", panels, columns=1, shared_axes="x",
        height=sum(heights) + margins_mm, heights=heights,
    )  # fmt: skip


def make_flag_plot(result: TestResult, time: Axis) -> Plot:
    """Make the panel with a row for each marker, coloured by the origin of its position.

    Parameters
    ----------
    result : result of the test. Points that are constructed in all frames have no row. Without a
        shape, the panel states the reason
    time : horizontal axis, of the time

    Notes
    -----
    Each bin in time shows the worst flag of its frames, so that short gaps are visible.
    """
    shape = result.shape
    if shape is None or not len(shape.time):
        return Plot(time, reason=_explain_missing(result, "shape"))
    is_marker = ~(shape.flags == PointFlag.CONSTRUCTED).all(axis=0)
    names = tuple(name for name, has_row in zip(shape.names, is_marker, strict=True) if has_row)
    flags = plots.thin_flags(shape.flags[:, is_marker], _FLAGS_BY_SEVERITY, n_bins=_MAX_TIME_BINS)
    edges = np.linspace(shape.time[0], shape.time[-1], len(flags) + 1)
    bars = []
    for flag, colour in FLAG_COLOURS.items():
        is_flagged = (flags == flag).T.astype(np.int8)
        # along a row, each run of flagged bins has one change where it begins and one where it ends
        rows, bins = np.nonzero(np.diff(is_flagged, axis=1, prepend=0, append=0))
        if len(rows):
            ends = edges[bins[::2]], edges[bins[1::2]]
            settings: dict[str, Any] = {"label": flag.name.lower(), "color": colour}
            bars.append(plots.make_bars("flag", *ends, rows[::2], height=0.72, **settings))
    return Plot(time, Axis(low=0.5 - len(names), high=0.5, row_names=names), bars)


def _make_tracking_plot(result: TestResult, time: Axis) -> Plot:
    """Make the panel of the mean marker error of each body, or of the number of visible markers.

    The first recording with marker tracks is drawn. If there is none, the panel states the reason.
    """
    recorded_tracks = (recording.markers for recording in result.recordings.values())
    tracks = next(filter(None, recorded_tracks), None)
    if tracks is None or not len(tracks.time):
        return Plot(time, reason=_explain_missing(result, "take"))
    error_lines = []
    for index, body in enumerate(tracks.bodies):
        if np.isfinite(body.error).any():
            line = make_thinned_line(
                "body_error", tracks.time, body.error,
                n_bins=_MAX_TIME_BINS, label=body.name, color=f"C{index}",
            )  # fmt: skip
            error_lines.append(line)
    if error_lines:
        scale = wording.get_scale(result.display, "displacement")
        return Plot(time, Axis("Body error", scale, low=0.0), error_lines)
    counts = (~np.isnan(tracks.positions).any(axis=2)).sum(axis=1).astype(np.float64)
    line = make_thinned_line("visible_markers", tracks.time, counts, n_bins=_MAX_TIME_BINS)
    return Plot(time, Axis("Visible markers", low=0.0, high=len(tracks.names) + 0.5), [line])


def make_budget_page(result: TestResult) -> Page:
    """Make the page of the uncertainty budgets of a test, with a bar of shares for each result.

    Parameters
    ----------
    result : result of the test. The first `budgets.MAX_BARS` results with a budget have a bar,
        except those of later cycles, of single slips, of the clocks and of the force limit

    Returns
    -------
    The page. If there is no bar, it gives the reason.
    """
    row_mm, margins_mm = 6.0, 26.0
    candidates = (entry for entry in result.results if budgets.has_budget_bar(entry.name))
    entries = [entry for entry in candidates if entry.largest_cause is not None][: budgets.MAX_BARS]
    bars = []
    for entry in entries:
        pairs = zip(entry.budget, entry.fractions, strict=True)
        shares = {contribution.cause: share for contribution, share in pairs}
        bars.append(budgets.make_budget_bar(entry, shares, entry.interval, result.display))
    panel, height = budgets.make_budget_plot(bars), margins_mm + row_mm * len(bars)
    has_cycles = any("." in entry.name for entry in entries)
    note = "Numbers per cycle: first cycle only." if has_cycles else ""
    return make_test_page(result, "uncertainty-budget", [panel], note, height=height)


FIGURES: dict[str, Callable[[TestResult], Page]] = {
    "force-displacement": make_force_displacement_page,
    "stiffness-lines": make_stiffness_lines_page,
    "stress-strain": make_stress_strain_page,
    "wire-shapes": make_wire_shapes_page,
    "moment-curvature": make_moment_curvature_page,
    "timeline": make_timeline_page,
    "marker-quality": make_marker_quality_page,
    "uncertainty-budget": make_budget_page,
}


def save_figures(result: TestResult, folder: Path, *, png: bool = False) -> list[Path]:
    """Write the figures that the protocol of a test names as SVG files.

    Parameters
    ----------
    result : result of the test; a figure without data states the reason
    folder : folder of the files; it is created if it does not exist
    png : whether each figure is also written as PNG

    Returns
    -------
    Paths of the files, in the order of the protocol.

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
    pages = (FIGURES[name](result) for name in result.figures)
    is_journal = is_for_journal(result)
    return figure_page.save_pages(pages, folder, run=result.run, png=png, is_journal=is_journal)


def is_for_journal(result: TestResult) -> bool:
    """Return whether the protocol of a test sets ``style: journal`` for its figures.

    The answer is False if the protocol is not valid, for example of an earlier grammar.
    """
    if "style: journal" not in result.protocol_yaml:  # a search is faster than parsing
        return False
    protocol = _read_protocol(result)
    return protocol is not None and protocol.report.style == "journal"


def draw_figure(result: TestResult, name: str) -> Figure:
    """Draw one figure for a notebook or a script.

    Parameters
    ----------
    result : result of the test
    name : name of the figure in `FIGURES`

    Returns
    -------
    The figure with labpipe's style and layout, which do not depend on the style of the notebook.
    """
    with figure_page.use_style(is_journal=is_for_journal(result)):
        return figure_page.draw_for_notebook(FIGURES[name](result))
