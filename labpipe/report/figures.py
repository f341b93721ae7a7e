"""Make the figures of a test that its protocol names, such as curve, measured law and timeline."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from labpipe.errors import ProtocolError
from labpipe.protocol.load import parse_protocol
from labpipe.records.arrays import Floats
from labpipe.records.curve import Branch, ClockFit, Curve, Direction, MeasuredLaw
from labpipe.records.estimates import UnavailableError
from labpipe.records.result import Result, TestResult, find_result
from labpipe.report import figure_page, quality_figures, wording
from labpipe.report import plot_records as plots
from labpipe.report.figure_page import DASHED, GREY, N_COLOURS
from labpipe.report.plot_records import Axis, Line, Page, Plot, make_line, make_thinned_line
from labpipe.results.kinds import compute_loading_sign
from labpipe.results.stiffness import compute_area
from labpipe.results.tension import ProofStress, get_gauge_length
from labpipe.statistics.lots import FORCE_LIMIT

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Figure  # noqa: PLC0414 - the API imports it from here


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
    reason = "" if lines else wording.explain_missing(result, "curve")
    limit = find_result(result.results, FORCE_LIMIT)
    if limit is not None and limit.value is not None:
        label = "smallest force allowed"
        lines.append(plots.make_horizontal_line("limit", limit.value, label=label))
    panels = [Plot(*_make_axes(result), lines, reason=reason)]
    return plots.make_test_page(result, "force-displacement", panels, height=92)


def _make_axes(result: TestResult, *quantities: str) -> tuple[Axis, Axis]:
    """Make the axes of two quantities, or of displacement and force, in the units of a test."""
    x, y = quantities or ("Displacement", "Force")
    names = [quantity.lower().replace(" ", "_") for quantity in (x, y)]
    x_scale, y_scale = wording.find_units(result.display, *names)
    return Axis(x, x_scale), Axis(y, y_scale)


def _plot_curve(result: TestResult) -> Iterator[Line]:
    """Yield the branches of the curve in the colours of their cycles, with marks at the peaks.

    Lines are solid in loading and dashed in unloading. A curve without branches is grey.
    """
    curve, branches = result.curve, _find_branches(result)
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
    for number, colour in enumerate(colours, start=1):
        samples = np.flatnonzero((cycle_numbers == number) & ~np.isnan(y))
        if len(samples):
            peak = samples[np.argmax(y[samples])]
            yield make_line("peak", x[peak], y[peak], color=colour)
    yield plots.make_key_entry("peak", label="peak", color=key_colour)


def _find_branches(result: TestResult) -> tuple[Branch, ...]:
    return result.curve.branches if result.curve is not None else ()


def choose_cycle_colours(count: int) -> list[str]:
    """Choose a colour per cycle: from the style for up to six cycles, else from a colour map."""
    if count > _MAX_CYCLE_KEYS:
        return figure_page.sample_colour_map(count, 0.92)
    return [f"C{number}" for number in range(count)]


def make_stiffness_lines_page(result: TestResult) -> Page:
    """Make the page of the first loading with the lines fitted for stiffness, slips and failure."""
    loading = None if result.curve is None else result.curve.first_loading
    lines: list[Line] = []
    if result.curve is not None and loading is not None:
        rows = slice(loading.start, loading.stop)
        lines = [*_plot_loading(result, result.curve, rows)]
        lines += [*_plot_fits(result), *_plot_events(result)]
    reason = "" if lines else wording.explain_missing(result, "loading branch")
    panels = [Plot(*_make_axes(result), lines, reason=reason)]
    return plots.make_test_page(result, "stiffness-lines", panels, height=92)


def _plot_loading(result: TestResult, curve: Curve, rows: slice) -> Iterator[Line]:
    """Yield a loading branch, also as measured if slips were repaired."""
    x, n_bins = curve.displacement[rows], 1500
    if result.aligned is not None and any(slip.decision == "repaired" for slip in result.slips):
        measured_force = result.aligned.series["force"].values[rows]
        yield make_thinned_line("as_measured", x, measured_force, n_bins=n_bins)
    yield make_thinned_line("loading", x, curve.force[rows], n_bins=n_bins)


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
        label = f"{wording.write_label(fit.result)}: {_describe_number(result, number)}"
        yield make_line(x=x, y=y, label=label, **settings)


def _describe_number(result: TestResult, number: Result) -> str:
    """Write the value of a number with its interval and unit."""
    scale = wording.find_scale(number.name, number.unit, result.display)
    value = np.nan if number.value is None else number.value
    text = wording.write_number(value, number.interval, scale.factor).text
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
    curve, branches = result.curve, _find_branches(result)
    if curve is None or not branches:
        return None
    try:
        protocol = parse_protocol(result.protocol_yaml, result.test)
        specimen = protocol.specimen
        dimensions = {} if specimen.section is None else dict(vars(specimen.section))
        dimensions |= {"length": specimen.length, "gauge_length": specimen.gauge_length}
        sizes = {name: size for name, size in dimensions.items() if size is not None}
        area, length = compute_area(sizes), get_gauge_length(sizes)
    except (ProtocolError, UnavailableError):
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
        reason = wording.explain_missing(result, "stress-strain curve")
        return plots.make_test_page(result, name, [plots.make_empty_plot(reason)])
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
    return plots.make_test_page(result, name, [whole_plot, initial_plot], height=92)


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
    for number, (name, symbol, strain, stress) in enumerate(points, start=1):
        label = f"{symbol} {_describe_number(result, numbers[name])}"
        colour = f"C{number % N_COLOURS}"
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
        reason = wording.explain_missing(result, "measured moment-curvature")
        panels = [plots.make_empty_plot(reason)]
        return plots.make_test_page(result, "moment-curvature", panels)
    x, moment = _make_axes(result, "Curvature", "Moment")
    moment_axis, lines = replace(moment, name="Bending moment"), list(_plot_cloud(result))
    heading = "Stiffness of the first loading"
    stiffness_plot = Plot(x, moment, heading=heading, reason=str(bending.reason or ""))
    if bending.law is not None:
        stiffness_plot = _make_stiffness_plot(result, bending.law, heading)
    panels = [Plot(x, moment_axis, lines, "Moment"), stiffness_plot]
    return plots.make_test_page(result, "moment-curvature", panels, height=92, key_columns=5)


def _plot_cloud(result: TestResult) -> Iterator[Line]:
    """Yield the points of all branches, and the law with its 95 % interval.

    Points are dots in loading and open circles in unloading, in the colours of the cycles. If there
    is a law, the points are shifted so that the origin is the straight, unloaded state. A grey
    stripe marks the curvatures below the noise of the curvature.
    """
    max_points = 2500
    if result.bending is None:
        return
    cloud, law, branches = result.bending.cloud, result.bending.law, _find_branches(result)
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
    for number, colour in enumerate(colours if len(colours) <= _MAX_CYCLE_KEYS else (), 1):
        yield plots.make_key_entry("cloud_key", label=f"cycle {number}", color=colour)
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
    fit = result.aligned.clock_fit if result.aligned is not None else None
    forces, motions = list(_plot_force(result)), list(_plot_motion(result))
    scale, motion_name = wording.find_unit(result.display, "time"), "Displacement"
    if result.aligned is not None and "travel" in result.aligned.series:
        motion_name = "Travel"
    force_reason = "" if forces else wording.explain_missing(result, "force")
    motion_reason = "" if motions else wording.explain_missing(result, "motion")
    times = [line.x for line in (*forces, *motions)]
    time = plots.make_axis("Time", scale, times, margin=0.01)
    force, motion = wording.find_units(result.display, "force", "displacement")
    panels = [
        Plot(time, Axis("Force", force), forces, reason=force_reason),
        Plot(time, Axis(motion_name, motion), motions, reason=motion_reason),
    ]
    if fit is not None:
        panels.append(_make_residual_plot(fit, time))
    layout: dict[str, Any] = {"columns": 1, "heights": [3, 3, 2][: len(panels)]}
    layout |= {"height": 110 if fit else 80, "shared_axes": "x"}
    return plots.make_test_page(result, "timeline", panels, **layout)


def _plot_force(result: TestResult) -> Iterator[Line]:
    """Yield the recorded force in grey, and the force of the curve above it."""
    aligned, curve = result.aligned, result.curve
    if aligned is not None and "force" in aligned.series:
        recorded = aligned.series["force"].values
        yield make_thinned_line("recorded", aligned.time, recorded, n_bins=900)
    if curve is not None:
        yield make_thinned_line("force", curve.time, curve.force, n_bins=900)


def _plot_motion(result: TestResult) -> Iterator[Line]:
    """Yield the travel, or the displacement if there is none, with the turning points."""
    aligned, curve = result.aligned, result.curve
    names = [name for name in ("travel", "displacement") if aligned and name in aligned.series]
    if aligned is not None and names:
        time, values = aligned.time, aligned.series[names[0]].values
    elif curve is not None:
        time, values = curve.time, curve.displacement
    else:
        return
    yield make_thinned_line("motion", time, values, n_bins=900)
    branches = _find_branches(result)
    ends = [end for branch in branches for end in (branch.start_time, branch.stop_time)]
    if ends:
        turns = np.unique(np.array(ends, dtype=np.float64))
        heights = np.interp(turns, time, values, left=np.nan, right=np.nan)
        yield make_line("turning_point", turns, heights)


def _make_residual_plot(fit: ClockFit, time: Axis) -> Plot:
    """Make the panel of the residual of the clock fit at each event, with its 95 % interval."""
    normal_quantile = 1.96
    event_times, errors = fit.event_times_motion, normal_quantile * fit.event_errors
    residuals = fit.event_times_force - fit.to_force_time(event_times)
    bars = plots.join_with_gaps(residuals - errors, residuals + errors)
    lines = [
        plots.make_horizontal_line("zero", 0.0),
        make_line("clock_interval", plots.join_with_gaps(event_times, event_times), bars),
        make_line("clock_residual", event_times, residuals),
    ]
    settings = {"ha": "right", "va": "bottom", "color": GREY}
    label = plots.Label(_describe_clock_fit(fit), np.inf, np.inf, (0.0, 3.0), settings)
    return Plot(time, Axis("Residual", wording.Scale(1e3, "ms")), lines, labels=[label])


def _describe_clock_fit(fit: ClockFit) -> str:
    """Write offset and drift, each with half its interval, and the residual, if any."""
    n_parameters = 2  # offset and drift
    n_events = len(fit.event_times_motion)
    residual_text = f"residual {1e3 * fit.residual:.2g} ms (rms of {n_events})"
    if n_events <= n_parameters:
        residual_text = f"{wording.write_count(n_events, 'event')} for two unknowns: no residual"
    offset = wording.write_with_interval(fit.offset, fit.offset_interval)
    drift = wording.write_with_interval(fit.drift, fit.drift_interval, 1e6)
    clock_text = f"offset {offset} s,  drift {drift} ppm".replace("-", "\u2212")
    return f"{clock_text},  {residual_text};  bars: 95 % of each event"


FIGURES: dict[str, Callable[[TestResult], Page]] = {
    "force-displacement": make_force_displacement_page,
    "stiffness-lines": make_stiffness_lines_page,
    "stress-strain": make_stress_strain_page,
    "wire-shapes": quality_figures.make_wire_shapes_page,
    "moment-curvature": make_moment_curvature_page,
    "timeline": make_timeline_page,
    "marker-quality": quality_figures.make_marker_quality_page,
    "uncertainty-budget": quality_figures.make_budget_page,
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
    try:
        return parse_protocol(result.protocol_yaml, result.test).report.style == "journal"
    except ProtocolError:
        return False


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
