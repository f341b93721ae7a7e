"""Make the figures of a test that protocols name: its curve, its measured law, its clocks."""

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
from labpipe.results.tension import ProofStress, find_gauge_length
from labpipe.statistics.lots import FORCE_LIMIT

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Figure  # noqa: PLC0414 - the API imports it from here


_MAX_CYCLE_KEYS = 6
"""Largest number of cycles in the key, and of cycles with the colours of the style.

More cycles have the colours of a colour map.
"""
_STYLES: dict[Direction, Any] = {Direction.LOADING: "-", Direction.UNLOADING: DASHED}


def make_force_displacement_page(result: TestResult) -> Page:
    """Make the page of the curve over the samples as recorded, which are grey."""
    lines = [*_plot_recorded(result), *_plot_curve(result)]
    reason = "" if lines else wording.explain_missing(result, "curve")
    limit = find_result(result.results, FORCE_LIMIT)
    if limit is not None and limit.value is not None:
        lines.append(
            plots.make_horizontal_line("limit", limit.value, label="smallest force allowed")
        )
    panels = [Plot(*_make_axes(result), lines, reason=reason)]
    return plots.make_test_page(result, "force-displacement", panels, height=92)


def _make_axes(result: TestResult, *quantities: str) -> tuple[Axis, Axis]:
    x, y = quantities or ("Displacement", "Force")
    names = [quantity.lower().replace(" ", "_") for quantity in (x, y)]
    x_scale, y_scale = wording.find_units(result.display, *names)
    return Axis(x, x_scale), Axis(y, y_scale)


def _plot_recorded(result: TestResult) -> Iterator[Line]:
    """Yield the aligned force against the aligned displacement."""
    aligned = result.aligned
    if aligned is not None and {"force", "displacement"} <= set(aligned.series):
        x, y = aligned.series["displacement"].values, aligned.series["force"].values
        yield make_thinned_line("recorded", x, y, n_bins=4000)


def _plot_curve(result: TestResult) -> Iterator[Line]:
    """Yield the branches of the curve in the colours of their cycles, with marks at their peaks.

    Loading is solid, unloading dashed. A curve without branches is grey.
    """
    curve, branches = result.curve, _find_branches(result)
    if curve is None:
        return
    x, y = curve.displacement, curve.force
    if not branches:
        yield make_thinned_line("branch", x, y, n_bins=4000, color=GREY, linewidth=0.5)
        return
    count = max(branch.cycle for branch in branches)
    colours = choose_cycle_colours(count)
    listed = np.unique(np.linspace(1, count, min(count, _MAX_CYCLE_KEYS)).round())
    for branch in branches:
        # with one sample more, the lines of neighbouring branches meet
        part = slice(branch.start, branch.stop + 1)
        label = f"cycle {branch.cycle}" if count > 1 and branch.cycle in listed else ""
        settings = {"color": colours[branch.cycle - 1], "linestyle": _STYLES[branch.direction]}
        yield make_thinned_line("branch", x[part], y[part], label=label, **settings)
    key_colour = GREY if count > 1 else colours[0]
    directions = {branch.direction for branch in branches}
    for direction in _STYLES if count > 1 or len(directions) > 1 else ():
        if direction in directions:
            yield plots.make_key_entry(
                "branch", label=str(direction), color=key_colour, linestyle=_STYLES[direction]
            )
    _, cycle = curve.number_samples()
    for number, colour in enumerate(colours, start=1):
        inside = np.flatnonzero((cycle == number) & ~np.isnan(y))
        if len(inside):
            top = inside[np.argmax(y[inside])]
            yield make_line("peak", x[top], y[top], color=colour)
    yield plots.make_key_entry("peak", label="peak", color=key_colour)


def _find_branches(result: TestResult) -> tuple[Branch, ...]:
    return result.curve.branches if result.curve is not None else ()


def choose_cycle_colours(count: int) -> list[str]:
    """Return a colour per cycle: from the style for up to six cycles, else from a colour map."""
    if count > _MAX_CYCLE_KEYS:
        return figure_page.sample_colour_map(count, 0.92)
    return [f"C{number}" for number in range(count)]


def make_stiffness_lines_page(result: TestResult) -> Page:
    """Make the page of the first loading with the lines fitted for stiffness, slips and failure."""
    first = None if result.curve is None else result.curve.first_loading
    lines: list[Line] = []
    if result.curve is not None and first is not None:
        part = slice(first.start, first.stop)
        lines = [*_plot_loading(result, result.curve, part)]
        lines += [*_plot_fits(result), *_plot_events(result)]
    reason = "" if lines else wording.explain_missing(result, "loading branch")
    panels = [Plot(*_make_axes(result), lines, reason=reason)]
    return plots.make_test_page(result, "stiffness-lines", panels, height=92)


def _plot_loading(result: TestResult, curve: Curve, part: slice) -> Iterator[Line]:
    """Yield a loading branch, and the measured one if slips were repaired."""
    x, n_bins = curve.displacement[part], 1500
    if result.aligned is not None and any(slip.decision == "repaired" for slip in result.slips):
        measured_force = result.aligned.series["force"].values[part]
        yield make_thinned_line("as_measured", x, measured_force, n_bins=n_bins)
    yield make_thinned_line("loading", x, curve.force[part], n_bins=n_bins)


def _plot_fits(result: TestResult) -> Iterator[Line]:
    """Yield each fitted line over its window, broad and pale; lines of segments are dotted."""
    names = list(dict.fromkeys(fit.result for fit in result.lines))
    windows = [name for name in names if not name.startswith("segment")]
    for fit in result.lines:
        x = np.array([fit.start, fit.stop])
        settings: dict[str, Any] = {"look": "fitted_segment"}
        if fit.result in windows:  # the first colour is that of the curve
            settings = {"look": "fit_window", "color": f"C{windows.index(fit.result) % 7 + 1}"}
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
        place = values.get(name)
        if place is not None:
            yield plots.make_vertical_line(name, place)
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
    strain, stress : shape (n,), 1 and Pa, of all branches
    modulus : slope of the elastic line, Pa; NaN without one
    window : shape (2,), strains between which the line was fitted; empty without one
    offsets : plastic strain by the name of each proof stress
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
        stated = {} if specimen.section is None else dict(vars(specimen.section))
        stated |= {"length": specimen.length, "gauge_length": specimen.gauge_length}
        sizes = {name: size for name, size in stated.items() if size is not None}
        area, length = compute_area(sizes), find_gauge_length(sizes)
    except (ProtocolError, UnavailableError):
        return None
    part = slice(branches[0].start, branches[-1].stop)
    x, force = curve.displacement[part], curve.force[part]
    x, force = compute_loading_sign(x) * x, compute_loading_sign(force) * force
    modulus, toe, window = np.nan, float(x[np.isfinite(x)][:1].sum()), np.zeros(0)
    for fit in result.lines:
        if fit.result == "elastic_modulus":
            window = np.sort(np.abs([fit.start, fit.stop]))
            modulus, toe = fit.slope * length / area, window[0] - fit.level / fit.slope
    offsets = {
        entry.name: entry.offset for entry in protocol.results if isinstance(entry, ProofStress)
    }
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
    whole = Plot(x, y, lines, "Whole curve")
    beginning = Plot(x, y, heading="Beginning", reason="There is no elastic line to draw.")
    if len(tension.window):
        high = 1.6 * (tension.window[1] + min(tension.offsets.values(), default=tension.window[1]))
        top = 1.1 * float(np.nanmax(tension.stress[tension.strain <= high]))
        x = replace(x, low=-0.05 * high, high=high)
        y = replace(y, low=-0.02 * top, high=top)
        fits = _plot_elastic_lines(result, tension, top)
        beginning = Plot(x, y, [*lines, *fits], "Beginning")
    return plots.make_test_page(result, name, [whole, beginning], height=92)


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
        # each value is that of a sample after the samples of the values before it
        if name in values and np.isfinite(array[sample:]).any():
            sample += int(np.nanargmin(np.abs(array[sample:] - values[name])))
            points.append((name, symbol, tension.strain[sample], tension.stress[sample]))
    for number, (name, symbol, strain, stress) in enumerate(points, start=1):
        label = f"{symbol} {_describe_number(result, numbers[name])}"
        yield make_line(
            "tension_number", strain, stress, label=label, color=f"C{number % N_COLOURS}"
        )
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
    """Make the page of (a) the moments of all branches with the law, (b) its stiffness."""
    bending = result.bending
    if bending is None:
        reason = wording.explain_missing(result, "measured moment-curvature")
        panels = [plots.make_empty_plot(reason)]
        return plots.make_test_page(result, "moment-curvature", panels)
    x, moment = _make_axes(result, "Curvature", "Moment")
    lines = list(_plot_cloud(result))
    cloud = Plot(x, replace(moment, name="Bending moment"), lines, "Moment")
    heading = "Stiffness of the first loading"
    stiffness = Plot(x, moment, heading=heading, reason=str(bending.reason or ""))
    if bending.law is not None:
        stiffness = _make_stiffness_plot(result, bending.law, heading)
    return plots.make_test_page(
        result, "moment-curvature", [cloud, stiffness], height=92, key_columns=5
    )


def _plot_cloud(result: TestResult) -> Iterator[Line]:
    """Yield the points of all branches, and the law with its 95 % interval.

    Loading has dots and unloading has open circles, in the colours of the cycles. If the law is
    known, the points are shifted so that the origin is the straight, unloaded state. A grey stripe
    marks the curvatures below the noise of the curvature.
    """
    max_cloud_points = 2500
    if result.bending is None:
        return
    cloud, law, branches = result.bending.cloud, result.bending.law, _find_branches(result)
    x, y = cloud.curvature, cloud.moment
    if law is not None:
        size = np.interp(np.abs(cloud.moment_at_rest), law.moment, law.curvature)
        x, y = x + np.sign(cloud.moment_at_rest) * size, y + cloud.moment_at_rest
    stride = -(-x.size // max_cloud_points)
    colours = choose_cycle_colours(int(cloud.cycle.max(initial=1)))
    for branch in np.unique(cloud.branch)[::-1].tolist():  # the first loading on top
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
        label = "95 % of the law"
        yield plots.make_area(
            "band_of_law", law.curvature, law.moment_lower, law.moment_upper, label=label, zorder=3
        )
        yield plots.make_span("below_noise", -law.floor, law.floor, label="below noise")


def _make_stiffness_plot(result: TestResult, law: MeasuredLaw, heading: str) -> Plot:
    """Make the panel of the secant and the tangent stiffness of a law, with their intervals.

    Tangents are drawn at the knots of the law. A grey stripe marks the curvatures below the noise
    of the curvature.
    """
    min_curvature_share = 1e-3  # start of the axis over the largest curvature
    start = max(0.5 * law.floor, min_curvature_share * law.curvature[-1])
    x, y = _make_axes(result, "Curvature", "Bending stiffness")
    knot_rows = np.unique(np.searchsorted(law.moment, law.knots).clip(1, len(law.moment) - 1))
    knot_rows = knot_rows[np.isfinite(law.tangent[knot_rows])]
    curvature, tangent = law.curvature[knot_rows], law.tangent[knot_rows]
    low = np.fmin(law.tangent_lower[knot_rows], tangent)
    high = np.fmax(law.tangent_upper[knot_rows], tangent)
    bars = plots.join_with_gaps(curvature, curvature), plots.join_with_gaps(low, high)
    lines = [
        plots.make_area(
            "band_of_law", law.curvature[1:], law.secant_lower[1:], law.secant_upper[1:]
        ),
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
    times = [drawn.x for drawn in (*forces, *motions)]
    time = plots.make_axis("Time", scale, times, margin=0.01)
    force, motion = wording.find_units(result.display, "force", "displacement")
    panels = [
        Plot(time, Axis("Force", force), forces, reason=force_reason),
        Plot(time, Axis(motion_name, motion), motions, reason=motion_reason),
    ]
    if fit is not None:
        panels.append(_make_residual_plot(fit, time))
    heights = [3, 3, 2][: len(panels)]
    height = 110 if fit else 80
    return plots.make_test_page(
        result, "timeline", panels, columns=1, height=height, heights=heights, shared_axes="x"
    )


def _plot_force(result: TestResult) -> Iterator[Line]:
    """Yield the force as recorded, in grey, and over it the force of the curve."""
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
    ends = [
        end for branch in _find_branches(result) for end in (branch.start_time, branch.stop_time)
    ]
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
    place = {"ha": "right", "va": "bottom", "color": GREY}
    label = plots.Label(_describe_clock_fit(fit), np.inf, np.inf, (0.0, 3.0), place)
    return Plot(time, Axis("Residual", wording.Scale(1e3, "ms")), lines, labels=[label])


def _describe_clock_fit(fit: ClockFit) -> str:
    """Write offset and drift, each with half its interval, and the residual, if any."""
    clock_parameters = 2  # offset and drift
    events = len(fit.event_times_motion)
    residual_text = f"residual {1e3 * fit.residual:.2g} ms (rms of {events})"
    if events <= clock_parameters:
        residual_text = f"{wording.write_count(events, 'event')} for two unknowns: no residual"
    offset = wording.write_with_interval(fit.offset, fit.offset_interval)
    drift = wording.write_with_interval(fit.drift, fit.drift_interval, 1e6)
    clocks = f"offset {offset} s,  drift {drift} ppm".replace("-", "\u2212")
    return f"{clocks},  {residual_text};  bars: 95 % of each event"


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
    result : a processed test; a figure without data states the reason
    folder : created if it does not exist
    png : whether each figure is also written as PNG

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
    pages = (FIGURES[name](result) for name in result.figures)
    is_journal = is_for_journal(result)
    return figure_page.save_pages(pages, folder, run=result.run, png=png, is_journal=is_journal)


def is_for_journal(result: TestResult) -> bool:
    """Return whether the protocol of a test sets ``style: journal`` for its figures.

    False for a protocol that is not valid, such as one of an earlier grammar.
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
    The figure with labpipe's style and layout, which do not depend on the style of the notebook.
    """
    with figure_page.style(is_journal=is_for_journal(result)):
        return figure_page.draw_for_notebook(FIGURES[name](result))
