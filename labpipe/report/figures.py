"""Make the figures of a test that its protocol names, such as curve, shapes and timeline."""

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
from labpipe.records.curve import (
    Branch,
    ClockFit,
    Direction,
    MeasuredLaw,
    PointFlag,
    Shape,
)  # fmt: skip
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
    note : start of the footnote
    settings : fields of `Page` for size and layout; a page that shows nothing is small
    """
    if not any(panel.lines for panel in panels):
        settings = {"height": 40.0}
    specimen, counts = result.specimen, Counter(entry.status for entry in result.results)
    title = (
        f"{result.test}  \u00b7  {specimen.type}, spool {specimen.spool}, sample {specimen.sample}"
        f"  \u00b7  {result.protocol}"
    )
    problems = [f"{counts[s]} {s}" for s in (Status.DOUBTFUL, Status.FAILED) if counts[s]]
    count_text = f"Of {len(result.results)} results: {', '.join(problems)}." if problems else ""
    return Page(name, title, panels, " ".join(filter(None, [note, count_text])), **settings)


def _explain_missing(result: TestResult, content: str) -> str:
    """Explain why a test has no data to draw: name the missing data and the first error."""
    errors = (note.message for note in result.quality if note.severity is Severity.ERROR)
    return " ".join([f"There is no {content} to draw.", *list(errors)[:1]])


def _read_protocol(result: TestResult) -> Protocol | None:
    """Read the protocol of a test; None if it is not valid, as one of an earlier grammar."""
    try:
        return parse_protocol(result.protocol_yaml, result.test)
    except ProtocolError:
        return None


_MAX_CYCLE_KEYS = 6
"""Largest number of cycles in the key, and of cycles with the colours of the style.

More cycles have the colours of a colour map.
"""
_LINE_STYLES: dict[Direction, Any] = {Direction.LOADING: "-", Direction.UNLOADING: DASHED}


def make_force_displacement_page(result: TestResult) -> Page:
    """Make the page of force against displacement: the curve, and the recorded samples in grey."""
    lines, aligned = list(_plot_curve(result)), result.aligned
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
    """Make the axes of two quantities, or of displacement and force, in the units of a test."""
    x, y = quantities or ("Displacement", "Force")
    names = [quantity.lower().replace(" ", "_") for quantity in (x, y)]
    x_scale, y_scale = wording.get_scales(result.display, *names)
    return Axis(x, x_scale), Axis(y, y_scale)


def _plot_curve(result: TestResult) -> Iterator[Line]:
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
    key_cycles = np.unique(np.linspace(1, n_cycles, min(n_cycles, _MAX_CYCLE_KEYS)).round())
    for branch in branches:
        # one more sample makes the lines of neighbouring branches meet
        rows = slice(branch.start, branch.stop + 1)
        label = f"cycle {branch.cycle}" if n_cycles > 1 and branch.cycle in key_cycles else ""
        settings = {"color": colours[branch.cycle - 1], "linestyle": _LINE_STYLES[branch.direction]}
        yield make_thinned_line("branch", x[rows], y[rows], label=label, **settings)
    key_colour = GREY if n_cycles > 1 else colours[0]
    directions = {branch.direction for branch in branches}
    for direction, style in _LINE_STYLES.items() if n_cycles > 1 or len(directions) > 1 else ():
        if direction in directions:
            settings = {"color": key_colour, "linestyle": style}
            yield plots.make_key_entry("branch", label=str(direction), **settings)
    _, cycle_numbers = curve.assign_samples()
    for cycle, colour in enumerate(colours, start=1):
        samples = np.flatnonzero((cycle_numbers == cycle) & ~np.isnan(y))
        if len(samples):
            peak = samples[np.argmax(y[samples])]
            yield make_line("peak", x[peak], y[peak], color=colour)
    yield plots.make_key_entry("peak", label="peak", color=key_colour)


def _get_branches(result: TestResult) -> tuple[Branch, ...]:
    return result.curve.branches if result.curve is not None else ()


def choose_cycle_colours(count: int) -> list[str]:
    """Choose a colour per cycle: from the style for up to six cycles, else from a colour map."""
    if count > _MAX_CYCLE_KEYS:
        return figure_page.sample_colour_map(count, 0.92)
    return [f"C{index}" for index in range(count)]


def make_stiffness_lines_page(result: TestResult) -> Page:
    """Make the page of the first loading with the lines fitted for stiffness, slips and failure.

    The loading is also drawn as measured if slips were repaired.
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
        lines += [*_plot_fits(result), *_plot_events(result)]
    reason = _explain_missing(result, "loading branch")
    panels = [Plot(*_make_axes(result), lines, reason=reason)]
    return make_test_page(result, "stiffness-lines", panels, height=92)


def _plot_fits(result: TestResult) -> Iterator[Line]:
    """Yield each fitted line over its window, broad and pale; lines of segments are dotted."""
    names = list(dict.fromkeys(fit.result for fit in result.lines))
    window_names = [name for name in names if not name.startswith("segment")]
    for fit in result.lines:
        x = np.array([fit.start, fit.stop])
        settings: dict[str, Any] = {"look": "fitted_segment"}
        if fit.result in window_names:  # the first colour is that of the curve
            colour = f"C{window_names.index(fit.result) % (N_COLOURS - 1) + 1}"
            settings = {"look": "fit_window", "color": colour}
        y, number = fit.level + fit.slope * (x - fit.start), find_result(result.results, fit.result)
        if number is None or number.value is None:
            number = Result(fit.result, fit.slope, "N/m")
        label = f"{wording.format_label(fit.result)}: {_describe_number(result, number)}"
        yield make_line(x=x, y=y, label=label, **settings)


def _describe_number(result: TestResult, number: Result) -> str:
    """Write the value of a number with its interval and unit."""
    scale = wording.choose_scale(number.name, number.unit, result.display)
    value = np.nan if number.value is None else number.value
    text = wording.format_number(value, number.interval, scale.factor).text
    return f"{text} {scale.unit}"


def _plot_events(result: TestResult) -> Iterator[Line]:
    """Yield break point, kink, onset of a plateau, slips and failure."""
    values = {number.name: number.value for number in result.results}
    for name in ("break_point", "kink_displacement", "plateau_displacement"):
        position = values.get(name)
        if position is not None:
            yield plots.make_vertical_line(name, position)
    for slip in result.slips:
        label = f"slip, {result.slips[0].decision}"
        yield plots.make_vertical_line("slip_position", slip.position, label=label)
    displacement, force = values.get("failure_displacement"), values.get("failure_force")
    if displacement is not None and force is not None:
        yield make_line("failure_point", displacement, force)


class _Tension(NamedTuple):
    """The curve of a tension test in stress and strain; the elastic line starts at zero strain.

    Parameters
    ----------
    strain, stress : shape (n,), strain and stress (Pa) of all branches
    modulus : slope of the elastic line, Pa; NaN without an elastic line
    window : shape (2,), strains between which the line was fitted; empty without an elastic line
    offsets : plastic strain of each proof stress, keyed by its name
    """

    strain: Floats
    stress: Floats
    modulus: float
    window: Floats
    offsets: Mapping[str, float]


def _compute_tension(result: TestResult) -> _Tension | None:
    """Compute stress and strain; None without branches, area, gauge length or valid protocol."""
    curve, branches, protocol = result.curve, _get_branches(result), _read_protocol(result)
    if curve is None or not branches or protocol is None:
        return None
    specimen = protocol.specimen
    dimensions = {} if specimen.section is None else dict(vars(specimen.section))
    dimensions |= {"length": specimen.length, "gauge_length": specimen.gauge_length}
    sizes = {name: size for name, size in dimensions.items() if size is not None}
    try:
        area, length = compute_area(sizes), get_gauge_length(sizes)
    except UnavailableError:
        return None
    rows = slice(branches[0].start, branches[-1].stop)
    x, force = curve.displacement[rows], curve.force[rows]
    x, force = compute_loading_sign(x) * x, compute_loading_sign(force) * force
    modulus, toe, window = np.nan, float(x[np.isfinite(x)][:1].sum()), np.zeros(0)
    for fit in result.lines:
        if fit.result == "elastic_modulus":
            window = np.sort(np.abs([fit.start, fit.stop]))
            modulus, toe = fit.slope * length / area, window[0] - fit.level / fit.slope
    proofs = (entry for entry in protocol.results if isinstance(entry, ProofStress))
    offsets = {proof.name: proof.offset for proof in proofs}
    strain, window = (x - toe) / length, (window - toe) / length
    return _Tension(strain, force / area, modulus, window, offsets)


def make_stress_strain_page(result: TestResult) -> Page:
    """Make the page of (a) stress against strain with its numbers, (b) the elastic line."""
    name, tension = "stress-strain", _compute_tension(result)
    if tension is None:
        empty_plot = Plot(reason=_explain_missing(result, "stress-strain curve"))
        return make_test_page(result, name, [empty_plot])
    x, y = _make_axes(result, "Strain", "Pressure")
    y = replace(y, name="Stress")
    curve = make_thinned_line("stress", tension.strain, tension.stress, n_bins=1500)
    lines = [curve, *_plot_tension_numbers(result, tension)]
    whole_plot = Plot(x, y, lines, "Whole curve")
    initial_plot = Plot(x, y, heading="Beginning", reason="There is no elastic line to draw.")
    if len(tension.window):  # the panel ends well above the elastic line and the first offset line
        high = 1.6 * (tension.window[1] + min(tension.offsets.values(), default=tension.window[1]))
        top = 1.1 * float(np.nanmax(tension.stress[tension.strain <= high]))
        x = replace(x, low=-0.05 * high, high=high)
        y = replace(y, low=-0.02 * top, high=top)
        elastic_lines = _plot_elastic_lines(result, tension, top)
        initial_plot = Plot(x, y, [*lines, *elastic_lines], "Beginning")
    return make_test_page(result, name, [whole_plot, initial_plot], height=92)


def _plot_tension_numbers(result: TestResult, tension: _Tension) -> Iterator[Line]:
    """Yield the points of proof stress, yield stress, strength and break, and the elongation."""
    numbers = {number.name: number for number in result.results if number.value is not None}
    values = {name: number.value or 0.0 for name, number in numbers.items()}
    points, sample = [], 0
    for name, offset in tension.offsets.items():
        if name in values:
            strain = offset + values[name] / tension.modulus
            points.append((name, f"Rp{100.0 * offset:g}", strain, values[name]))
    for name, symbol, array in (
        ("upper_yield_stress", "ReH", tension.stress),
        ("lower_yield_stress", "ReL", tension.stress),
        ("tensile_strength", "Rm", tension.stress),
        ("elongation_at_break", "At", tension.strain),
    ):
        # the points follow one another along the curve
        if name in values and np.isfinite(array[sample:]).any():
            sample += int(np.nanargmin(np.abs(array[sample:] - values[name])))
            points.append((name, symbol, tension.strain[sample], tension.stress[sample]))
    for index, (name, symbol, strain, stress) in enumerate(points, start=1):
        label = f"{symbol} {_describe_number(result, numbers[name])}"
        colour = f"C{index % N_COLOURS}"
        yield make_line("tension_number", strain, stress, label=label, color=colour)
    name = "elongation_at_maximum_force"
    if name in values:
        label = f"Agt {_describe_number(result, numbers[name])}"
        yield plots.make_vertical_line("elongation", values[name], label=label)


def _plot_elastic_lines(result: TestResult, tension: _Tension, top: float) -> Iterator[Line]:
    """Yield the elastic line over its window and up to the stress `top`, and its offset lines."""
    window, strain_at_top = tension.window, top / tension.modulus
    number = Result("elastic_modulus", tension.modulus, "Pa")
    label = f"E {_describe_number(result, find_result(result.results, number.name) or number)}"
    yield make_line("fit_window", window, tension.modulus * window, label=label, color="C0")
    yield make_line("elastic_line", [0.0, strain_at_top], [0.0, top])
    for offset in tension.offsets.values():
        yield make_line("offset_line", [offset, offset + strain_at_top], [0.0, top])


def make_moment_curvature_page(result: TestResult) -> Page:
    """Make the page of (a) the moments of all branches with the law, (b) the stiffness."""
    bending = result.bending
    if bending is None:
        empty_plot = Plot(reason=_explain_missing(result, "measured moment-curvature"))
        return make_test_page(result, "moment-curvature", [empty_plot])
    x, moment = _make_axes(result, "Curvature", "Moment")
    moment_axis, lines = replace(moment, name="Bending moment"), list(_plot_cloud(result))
    heading = "Stiffness of the first loading"
    stiffness_plot = Plot(x, moment, heading=heading, reason=str(bending.reason or ""))
    if bending.law is not None:
        stiffness_plot = _make_stiffness_plot(result, bending.law, heading)
    panels = [Plot(x, moment_axis, lines, "Moment"), stiffness_plot]
    return make_test_page(result, "moment-curvature", panels, height=92, key_columns=5)


def _plot_cloud(result: TestResult) -> Iterator[Line]:
    """Yield the points of all branches, and the law with its 95 % interval.

    Points are dots in loading and open circles in unloading, in the colours of the cycles. If there
    is a law, the points are shifted so that the origin is the straight, unloaded state. A grey
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
        face = colour if is_loading else "none"
        yield make_line("cloud", *points, color=colour, markerfacecolor=face)
    for cycle, colour in enumerate(colours if len(colours) <= _MAX_CYCLE_KEYS else (), 1):
        yield plots.make_key_entry("cloud_key", label=f"cycle {cycle}", color=colour)
    for label, face in (("loading", GREY), ("unloading", "none")):
        yield plots.make_key_entry("cloud_key", label=label, color=GREY, markerfacecolor=face)
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
    low = np.fmin(law.tangent_lower[knot_rows], tangent)
    high = np.fmax(law.tangent_upper[knot_rows], tangent)
    bars = plots.join_with_gaps(curvature, curvature), plots.join_with_gaps(low, high)
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
    """Make the page of force and motion against time, and the residuals of the clocks, if any."""
    aligned, curve = result.aligned, result.curve
    forces, motions = list[Line](), _plot_motion(result)
    fit = None if aligned is None else aligned.clock_fit
    if aligned is not None and "force" in aligned.series:
        recorded = aligned.series["force"].values
        forces.append(make_thinned_line("recorded", aligned.time, recorded, n_bins=900))
    if curve is not None:
        forces.append(make_thinned_line("force", curve.time, curve.force, n_bins=900))
    motion_name = "Travel" if aligned and "travel" in aligned.series else "Displacement"
    scale = wording.get_scale(result.display, "time")
    times = [line.x for line in (*forces, *motions)]
    time = plots.make_axis("Time", scale, times, margin=0.01)
    force, motion = wording.get_scales(result.display, "force", "displacement")
    panels = [
        Plot(time, Axis("Force", force), forces, reason=_explain_missing(result, "force")),
        Plot(time, Axis(motion_name, motion), motions, reason=_explain_missing(result, "motion")),
    ]
    if fit is not None:
        panels.append(_make_residual_plot(fit, time))
    layout: dict[str, Any] = {"columns": 1, "heights": [3, 3, 2][: len(panels)]}
    layout |= {"height": 110 if fit else 80, "shared_axes": "x"}
    return make_test_page(result, "timeline", panels, **layout)


def _plot_motion(result: TestResult) -> list[Line]:
    """Plot the travel, or the displacement if there is none, with the turning points."""
    aligned, curve = result.aligned, result.curve
    names = [name for name in ("travel", "displacement") if aligned and name in aligned.series]
    if aligned is not None and names:
        time, values = aligned.time, aligned.series[names[0]].values
    elif curve is not None:
        time, values = curve.time, curve.displacement
    else:
        return []
    branches = _get_branches(result)
    turns = np.unique([end for branch in branches for end in (branch.start_time, branch.stop_time)])
    heights = np.interp(turns, time, values, left=np.nan, right=np.nan)
    motion = make_thinned_line("motion", time, values, n_bins=900)
    return [motion, *([make_line("turning_point", turns, heights)] if len(turns) else [])]


def _make_residual_plot(fit: ClockFit, time: Axis) -> Plot:
    """Make the panel of the residual of the clock fit at each event, with its 95 % interval.

    A label gives offset and drift, each with half its interval, and the residual, if any.
    """
    normal_quantile, n_parameters = 1.96, 2  # offset and drift
    event_times, errors = fit.event_times_motion, normal_quantile * fit.event_errors
    residuals, n_events = fit.event_times_force - fit.to_force_time(event_times), len(event_times)
    bars = plots.join_with_gaps(residuals - errors, residuals + errors)
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
"""Name of the distance of the tip from its first position, used without a loading branch."""


class FrameSelection(NamedTuple):
    """Frames whose shapes are drawn.

    Parameters
    ----------
    frames : shape (n,), numbers of the frames, in order
    deflections : shape (n,), nominal deflection of the tip in each frame, m
    deflection_name : name of the deflection in the key
    """

    frames: Ints
    deflections: Floats
    deflection_name: str


def make_wire_shapes_page(result: TestResult) -> Page:
    """Make the page of shapes in the plane of bending; in two planes without a loading branch."""
    panel_width_mm, frame_mm, gap_mm = 144.0, 17.0, 14.0
    shape = result.shape
    if shape is None or not len(shape.time):
        empty_plot = Plot(reason=_explain_missing(result, "shape"))
        return make_test_page(result, "wire-shapes", [empty_plot])
    selection = choose_shape_frames(result, shape)
    scale = wording.get_scale(result.display, "displacement")
    names = "xyz" if selection.deflection_name == _EXCURSION else "xy"
    curves = [_compute_fitted_curve(shape, int(frame)).T for frame in selection.frames]
    points = np.concatenate([shape.positions[selection.frames].reshape(-1, 3), *curves])
    points = points[:, : len(names)]
    x_axis, *side_axes = plots.make_axes_to_scale(names, scale, points, min_aspect=0.1)
    panels, heights = [], []
    for side_axis in side_axes:
        lines = list(draw_shapes(shape, selection, scale, axis="xyz".index(side_axis.name)))
        heading = f"x-{side_axis.name} view" if len(side_axes) > 1 else ""
        panels.append(Plot(x_axis, side_axis, lines, heading, is_to_scale=True))
        aspect = (side_axis.high - side_axis.low) / (x_axis.high - x_axis.low)
        heights.append(panel_width_mm * aspect)
    height = sum(heights) + frame_mm + gap_mm * (len(side_axes) - 1)
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
    deflection = find_loading_deflection(result, shape.time)
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
    deflection : shape (n_frames,), m; NaN in frames that are left out
    factor : factor from m to the unit in which the steps are round

    Returns
    -------
    frames : shape (n,), first frame at or beyond each step, because later frames may belong to
        another motion
    deflections : shape (n,), deflection of each step, m; at most seven, from zero upwards
    """
    max_steps = 6
    largest = factor * float(np.max(deflection, initial=0.0, where=~np.isnan(deflection)))
    decade = 10.0 ** floor(log10(largest / max_steps)) if largest > 0.0 else 1.0
    step = next(n * decade for n in (1.0, 2.0, 5.0, 10.0) if n * decade * max_steps >= largest)
    deflections = np.linspace(0.0, max_steps * step / factor, max_steps + 1)
    frames_beyond = [np.flatnonzero(deflection >= level - 1e-12) for level in deflections]
    frames = np.array([beyond[0] for beyond in frames_beyond if len(beyond)], dtype=np.int64)
    return frames, deflections[: len(frames)]


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


def find_loading_deflection(result: TestResult, time: Floats) -> Floats | None:
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
    """State the offset of the markers from the axis of a clamped specimen; empty if negligible."""
    min_offset = 1e-5  # m; a smaller offset is not visible in the figure
    has_curve = bool(shape.coefficients.shape[2])
    protocol = _read_protocol(result)
    markers = None if protocol is None else protocol.markers
    centre_offset = 0.0 if markers is None else abs(markers.centre_offset)
    if not _is_clamped(shape) or centre_offset < min_offset or not has_curve:
        return ""
    scale = wording.get_scale(result.display, "displacement")
    offset = centre_offset * scale.factor
    return format_sentence("report.markers_beside_axis", offset=offset, unit=scale.unit)


def draw_shapes(
    shape: Shape, selection: FrameSelection, scale: wording.Scale, *, axis: int
) -> Iterator[Line]:
    """Yield the points and fitted curves of selected frames, and their entries in the key.

    Parameters
    ----------
    shape : points and fitted curves of all frames
    selection : frames that are drawn
    scale : display unit of displacements, for the key
    axis : vertical axis: 1 for y, in the plane of bending; 2 for z, out of plane
    """
    colours, frames = sample_colour_map(len(selection.frames)), selection.frames.tolist()
    for frame, deflection, colour in zip(frames, selection.deflections, colours, strict=True):
        curve = _compute_fitted_curve(shape, frame)[[0, axis]]
        yield make_line("fitted_curve", *curve, color=colour)
        for flag, mark in _FLAG_MARKS.items():
            rows = shape.flags[frame] == flag
            if rows.any():
                x, y = shape.positions[frame][rows][:, [0, axis]].T
                yield make_line("marker", x, y, color=colour, **mark)
        text = f"{deflection * scale.factor:g} {scale.unit}"
        label = f"{selection.deflection_name} {text}" if frame == frames[0] else text
        yield plots.make_key_entry("fitted_curve", label=label, color=colour, linewidth=1.6)
    drawn_flags = set(np.unique(shape.flags[frames]))
    for flag, mark in _FLAG_MARKS.items():
        if flag in drawn_flags:
            yield plots.make_key_entry("marker", label=flag.name.lower(), **mark)
    if shape.coefficients.shape[2]:
        yield plots.make_key_entry("fitted_curve", label="fitted curve")


def _compute_fitted_curve(shape: Shape, frame: int) -> Floats:
    """Compute points on the fitted curve, shape (3, n_points), m; no points without a curve."""
    n_terms = shape.coefficients.shape[2]
    parameter = np.linspace(0, 1, 81 if n_terms else 0)  # arc length over the total length
    curve: Floats = shape.coefficients[frame] @ parameter[None, :] ** np.arange(n_terms)[:, None]
    return curve


FLAG_COLOURS = {
    PointFlag.MEASURED: "#c3d3e0",
    PointFlag.RELABELLED: "#0072b2",
    PointFlag.FILLED: "#e69f00",
    PointFlag.MISSING: "#1a1a1a",
}
_FLAGS_BY_RANK = (
    PointFlag.CONSTRUCTED, PointFlag.MEASURED, PointFlag.RELABELLED, PointFlag.FILLED,
    PointFlag.MISSING,
)  # fmt: skip
"""Flags of points in order of severity; the worst is last."""
_TIME_BINS = 900
"""Largest number of bins in time, about one per pixel."""


def make_marker_quality_page(result: TestResult) -> Page:
    """Make the page of the flags of each marker and of the error of each body against time."""
    row_mm, min_panel_mm, frame_mm = 4.2, 25.0, 30.0
    times = [take.markers.time for take in result.recordings.values() if take.markers]
    times = times if result.shape is None else [result.shape.time, *times]
    time = plots.make_axis("Time", wording.get_scale(result.display, "time"), times, margin=0.01)
    flags, tracking = make_flag_plot(result, time), _make_tracking_plot(result, time)
    heights = [max(row_mm * len(flags.y.row_names), min_panel_mm), min_panel_mm]
    return make_test_page(
        result, "marker-quality", [flags, tracking], columns=1, shared_axes="x",
        height=sum(heights) + frame_mm, heights=heights,
    )  # fmt: skip


def make_flag_plot(result: TestResult, time: Axis) -> Plot:
    """Make the panel with a row for each marker, coloured by the origin of its position.

    Parameters
    ----------
    result : result of the test; constructed points have no row. Without a shape, the panel states
        the reason
    time : horizontal axis

    Notes
    -----
    Each bin in time shows the worst flag of its frames, so that short gaps are visible.
    """
    shape = result.shape
    if shape is None or not len(shape.time):
        return Plot(time, reason=_explain_missing(result, "shape"))
    is_marker = ~(shape.flags == PointFlag.CONSTRUCTED).all(axis=0)
    names = tuple(name for name, drawn in zip(shape.names, is_marker, strict=True) if drawn)
    flags = plots.thin_flags(shape.flags[:, is_marker], _FLAGS_BY_RANK, n_bins=_TIME_BINS)
    edges = np.linspace(shape.time[0], shape.time[-1], len(flags) + 1)
    bars = []
    for flag, colour in FLAG_COLOURS.items():
        is_flagged = (flags == flag).T.astype(np.int8)
        # along a row, each run of flagged bins has one change where it begins and one where it ends
        rows, bins = np.nonzero(np.diff(is_flagged, axis=1, prepend=0, append=0))
        if len(rows):
            ends = edges[bins[::2]], edges[bins[1::2]]
            look: dict[str, Any] = {"height": 0.72, "label": flag.name.lower(), "color": colour}
            bars.append(plots.make_bars("flag", *ends, rows[::2], **look))
    return Plot(time, Axis(low=0.5 - len(names), high=0.5, row_names=names), bars)


def _make_tracking_plot(result: TestResult, time: Axis) -> Plot:
    """Make the panel of the mean marker error of each body, or of the number of visible markers.

    The first recording with marker tracks is drawn; without any, the panel states the reason.
    """
    takes = (recording.markers for recording in result.recordings.values())
    tracks = next(filter(None, takes), None)
    if tracks is None or not len(tracks.time):
        return Plot(time, reason=_explain_missing(result, "take"))
    errors = []
    for index, body in enumerate(tracks.bodies):
        if np.isfinite(body.error).any():
            settings = {"label": body.name, "color": f"C{index}"}
            error = plots.make_thinned_line(
                "body_error", tracks.time, body.error, n_bins=_TIME_BINS, **settings
            )
            errors.append(error)
    if errors:
        scale = wording.get_scale(result.display, "displacement")
        return Plot(time, Axis("Body error", scale, low=0.0), errors)
    counts = (~np.isnan(tracks.positions).any(axis=2)).sum(axis=1).astype(np.float64)
    line = plots.make_thinned_line("visible_markers", tracks.time, counts, n_bins=_TIME_BINS)
    return Plot(time, Axis("Visible markers", low=0.0, high=len(tracks.names) + 0.5), [line])


def make_budget_page(result: TestResult) -> Page:
    """Make the page of the uncertainty budgets of a test: a bar of shares for each number.

    Parameters
    ----------
    result : result of the test. The first `budgets.MAX_BARS` numbers with a budget have a bar,
        except those of later cycles, of single slips, of the clocks and of the force limit

    Returns
    -------
    A page; without any bar, a page that gives the reason.
    """
    row_mm, frame_mm = 6.0, 26.0
    results = (entry for entry in result.results if budgets.has_budget_bar(entry.name))
    numbers = [number for number in results if number.largest_cause is not None][: budgets.MAX_BARS]
    bars = []
    for number in numbers:
        causes = [contribution.cause for contribution in number.budget]
        shares = dict(zip(causes, number.fractions, strict=True))
        bars.append(budgets.make_budget_bar(number, shares, number.interval, result.display))
    panel, height = budgets.make_budget_plot(bars), frame_mm + row_mm * len(bars)
    has_cycles = any("." in number.name for number in numbers)
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
    """Write the figures that the protocol of a test names as SVG.

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

    False for a protocol that is not valid, such as one of an earlier grammar.
    """
    if "style: journal" not in result.protocol_yaml:  # parsing takes longer
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
