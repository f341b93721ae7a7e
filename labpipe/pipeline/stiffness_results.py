"""Stiffnesses of a tensile test and what is made of them: lines, segments, per force, moduli.

Each function gives the results of one entry of a protocol's list. They are read from the first
loading branch up to the failure.
"""

from __future__ import annotations

import numpy as np

from labpipe.fits.straight_lines import (
    annulus_area,
    fit_line,
    modulus,
    rectangle_area,
    stiffness_per_peak_force,
    thin_wall_area,
)
from labpipe.fits.two_segments import TwoSegments, fit_two_segments
from labpipe.pipeline.bench import Bench
from labpipe.pipeline.corrections import loading_stretch
from labpipe.pipeline.cycle_numbers import curve_of, unscaled_peak
from labpipe.pipeline.cycle_results import broken_off
from labpipe.pipeline.outcomes import (
    CURVE,
    NO_BRANCH,
    Asked,
    blocked_or,
    slack_error,
    to_result,
    while_loading,
    with_force_scale,
)
from labpipe.protocol.results import Modulus
from labpipe.protocol.schema import SpecimenBlock
from labpipe.records.arrays import Floats
from labpipe.records.curve import FittedLine, SlipDecision
from labpipe.records.estimates import Estimate, Failure, widened
from labpipe.records.quality import Reason
from labpipe.records.result import Result


def line_stiffness(bench: Bench, *, name: str, low: float, high: float) -> list[Result]:
    """Stiffness (N/m) by a straight line over a window of the first loading branch."""
    method = f"straight line from {1e3 * low:g} mm to {1e3 * high:g} mm of the first loading"
    asked = Asked(name, "N/m", CURVE, f"{method}, interval for correlated noise")
    if not bench.cycles():
        return [to_result(bench, asked, blocked_or(bench, NO_BRANCH))]
    curve, stretch = curve_of(bench), loading_stretch(bench)
    displacement, force = curve.displacement[stretch], curve.force[stretch]
    window = window_of(displacement, low, high)
    if isinstance(window, Failure):
        return [to_result(bench, asked, window)]
    line = fit_line(displacement[window], force[window])
    if isinstance(line, Failure):
        return [to_result(bench, asked, line)]
    slope = _with_other_displacement(bench, stretch, window, line.slope)
    level = line.intercept.value + line.slope.value * line.start
    bench.lines.append(FittedLine(name, slope.value, level, line.start, line.stop))
    bench.stiffnesses[name] = slope
    bench.windows[name] = during = while_loading(bench, line.start, line.stop)
    fall = Reason("negative_slope", "the force falls where the frame pulls")
    doubts = [
        fall if slope.value <= 0.0 else None,
        marked_slip(bench, line.start, line.stop),
    ]
    return [to_result(bench, asked, with_force_scale(bench, slope), doubts=doubts, during=during)]


def two_segments(bench: Bench, *, low: float, high: float) -> list[Result]:
    """Slopes (N/m) and break point (m) of the best two segments over a window."""
    method = f"two segments that meet, from {1e3 * low:g} mm to {1e3 * high:g} mm, all breaks tried"
    names = ("segment_stiffness_first", "segment_stiffness_second", "break_point")
    asked = [
        Asked(name, unit, CURVE, method)
        for name, unit in zip(names, ("N/m", "N/m", "m"), strict=True)
    ]
    fit = _segments(bench, low, high)
    if isinstance(fit, Failure):
        return [to_result(bench, each, fit) for each in asked]
    first, second, at = fit.first, fit.second, fit.break_point
    bench.stiffnesses |= {names[0]: first, names[1]: second}
    during = while_loading(bench, fit.start, fit.stop)  # one break bends both
    bench.windows |= dict.fromkeys(names[:2], during)
    left = fit.level - first.value * (at.value - fit.start)
    bench.lines += [
        FittedLine(names[0], first.value, left, fit.start, at.value),
        FittedLine(names[1], second.value, fit.level, at.value, fit.stop),
    ]
    zero = bench.signals[bench.displacement].zero_error
    doubts = [marked_slip(bench, fit.start, fit.stop)]
    outcomes = (
        with_force_scale(bench, first),
        with_force_scale(bench, second),
        widened(at, zero, slack_error(bench)),
    )
    return [
        to_result(bench, each, outcome, doubts=doubts, during=during)
        for each, outcome in zip(asked, outcomes, strict=True)
    ]


def _segments(bench: Bench, low: float, high: float) -> TwoSegments | Failure:
    if not bench.cycles():
        return blocked_or(bench, NO_BRANCH)
    curve, stretch = curve_of(bench), loading_stretch(bench)
    displacement, force = curve.displacement[stretch], curve.force[stretch]
    window = window_of(displacement, low, high)
    if isinstance(window, Failure):
        return window
    return fit_two_segments(displacement[window], force[window])


def normalised_stiffness(bench: Bench, *, of: str) -> list[Result]:
    """A stiffness over the largest force of all cycles (1/m); a gain error cancels."""
    method = f"{of} / peak force of the same sample, errors independent, scale error cancelled"
    asked = Asked(f"{of}_per_peak_force", "1/m", CURVE, method, made_of=of)
    doubts = [doubt_of(bench, of), *(broken_off(bench, each[:1]) for each in bench.cycles()[-1:])]
    window, cycles = bench.windows.get(of), bench.cycles()
    during = (window[0], max(window[1], cycles[-1][0].stop_time)) if window and cycles else None
    return [to_result(bench, asked, _normalised(bench, of), doubts=doubts, during=during)]


def _normalised(bench: Bench, of: str) -> Estimate | Failure:
    stiffness = bench.stiffnesses.get(of)
    if stiffness is None:
        return blocked_or(bench, Failure("no_stiffness", f"{of} could not be had"))
    peak = _largest_peak(bench)
    if isinstance(peak, Failure):
        return peak
    if peak.value <= 3.0 * peak.error:
        return Failure("no_peak_force", f"a peak of {peak.value:.3g} N is no more than its noise")
    return stiffness_per_peak_force(stiffness, peak)


def _largest_peak(bench: Bench) -> Estimate | Failure:
    """Largest force of all cycles, N, with the uncertainty of its zero but not of its scale."""
    peaks = [unscaled_peak(bench, branches) for branches in bench.cycles()]
    known = [peak for peak in peaks if isinstance(peak, Estimate)]
    if not known:
        return next(peak for peak in peaks if isinstance(peak, Failure))
    return widened(max(known, key=lambda peak: peak.value), bench.raw[bench.force].zero_error)


def modulus_result(bench: Bench, entry: Modulus, specimen: SpecimenBlock) -> list[Result]:
    """A modulus (Pa): stiffness x gauge length / area, the area named."""
    method = f"{entry.of} x specimen.length / area ({entry.area}); sizes taken as exact"
    asked = Asked(entry.name, "Pa", CURVE, method, made_of=entry.of)
    stiffness, area = bench.stiffnesses.get(entry.of), _area(entry.area, specimen)
    outcome: Estimate | Failure
    if stiffness is None:
        outcome = blocked_or(bench, Failure("no_stiffness", f"{entry.of} could not be had"))
    elif specimen.length is None:
        outcome = Failure("no_length", "specimen.length, the gauge length, is not given")
    elif isinstance(area, Failure):
        outcome = area
    else:
        outcome = modulus(
            with_force_scale(bench, stiffness), gauge_length=specimen.length, area=area
        )
    doubts, during = [doubt_of(bench, entry.of)], bench.windows.get(entry.of)
    return [to_result(bench, asked, outcome, doubts=doubts, during=during)]


def _area(kind: str, specimen: SpecimenBlock) -> float | Failure:
    """Area of a name from the sizes that it takes."""
    section = specimen.section
    needs = {
        "stated": ("area",),
        "rectangle": ("width", "thickness"),
        "annulus": ("outer_diameter", "inner_diameter"),
        "thin-wall": ("outer_diameter", "wall"),
    }[kind]
    said = [getattr(section, name) for name in needs] if section is not None else []
    sizes = [float(size) for size in said if size is not None]
    if len(sizes) < len(needs):
        wanted = " and ".join(f"specimen.section.{name}" for name in needs)
        return Failure("no_area", f"{wanted} not given")
    areas = {"rectangle": rectangle_area, "annulus": annulus_area, "thin-wall": thin_wall_area}
    area = sizes[0] if kind == "stated" else areas[kind](*sizes)
    if not area > 0.0:
        return Failure("no_area", f"the {kind} area comes out as {area:.4g} m^2")
    return area


def window_of(displacement: Floats, low: float, high: float) -> slice | Failure:
    """Samples from the first one at `low` to the last one before `high`, in order of time.

    Parameters
    ----------
    displacement : shape (n,), m, of a loading branch
    low, high : m

    Returns
    -------
    Where they are, or a failure ``not_reached``.
    """
    known = displacement[~np.isnan(displacement)]
    if not len(known) or known.max() < high:
        reached = float(known.max()) if len(known) else float("nan")
        found = f"the branch reaches {1e3 * reached:.4g} mm, {1e3 * high:.4g} mm is asked"
        return Failure("not_reached", found)
    if known[0] > low + 0.02 * (high - low):
        found = f"the branch begins at {1e3 * known[0]:.4g} mm, {1e3 * low:.4g} mm is asked"
        return Failure("not_reached", found)
    return slice(int(np.argmax(displacement >= low)), int(np.argmax(displacement > high)) or None)


def _with_other_displacement(
    bench: Bench, stretch: slice, window: slice, slope: Estimate
) -> Estimate:
    """Widened by what a displacement under another assumption changes."""
    other = bench.signals[bench.displacement].alternative
    if other is None:
        return slope
    line = fit_line(other[stretch][window], curve_of(bench).force[stretch][window])
    if isinstance(line, Failure):
        return slope
    return widened(slope, abs(line.slope.value - slope.value) / np.sqrt(3.0))


def doubt_of(bench: Bench, stiffness: str) -> Reason | None:
    """Why a number is doubtful that is made of a stiffness: for the reason that this one is.

    Parameters
    ----------
    bench : with slips and lines
    stiffness : name of the result

    Returns
    -------
    The reason; None where it is not.
    """
    segments = stiffness.startswith("segment_stiffness_")  # one slip bends both
    lines = [
        line
        for line in bench.lines
        if line.result == stiffness or (segments and line.result.startswith("segment_stiffness_"))
    ]
    if not lines:
        return None
    return marked_slip(bench, min(line.start for line in lines), max(line.stop for line in lines))


def marked_slip(bench: Bench, start: float, stop: float) -> Reason | None:
    """Why a number over a stretch is doubtful in which a slip was only marked.

    Parameters
    ----------
    bench : with its slip ledger
    start, stop : m, ends of the stretch

    Returns
    -------
    The reason; None where none slipped there.
    """
    inside = [
        slip
        for slip in bench.slips
        if slip.decision is SlipDecision.MARKED and start <= slip.position <= stop
    ]
    if not inside:
        return None
    at = ", ".join(f"{1e3 * slip.position:.4g} mm" for slip in inside)
    message = f"slipped in the grips at {at}, and the curve stays as measured"
    return Reason("slip_in_window", message)
