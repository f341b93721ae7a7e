"""Results of a tensile test: lines over windows, two segments, slack, slips, failure, modulus.

Each function gives the results of one entry of a protocol's list. They are read from the first
loading branch up to the failure; the failure itself and its energy from the last one.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from labpipe.fitting.compliance import fit_compliance
from labpipe.fitting.estimates import Estimate, Failure, widened
from labpipe.fitting.failure import FailurePoint, energy_to_break
from labpipe.fitting.lines import fit_line
from labpipe.fitting.moduli import (
    annulus_area,
    modulus,
    rectangle_area,
    stiffness_per_peak_force,
    thin_wall_area,
)
from labpipe.fitting.segments import TwoSegments, fit_two_segments
from labpipe.pipeline.bench import Bench
from labpipe.pipeline.corrections import loading_branch, loading_stretch
from labpipe.pipeline.cycle_numbers import curve_of
from labpipe.pipeline.cycle_results import broken_off
from labpipe.pipeline.outcomes import Asked, blocked_or, to_result
from labpipe.pipeline.sharp_turns import repaired_peak_force
from labpipe.protocol.results import Modulus
from labpipe.protocol.rig import SpecimenBlock
from labpipe.records.arrays import Floats
from labpipe.records.curve import FittedLine
from labpipe.records.result import Result
from labpipe.records.slips import SlipDecision

_CURVE = ("force", "displacement", "clock")
_NO_BRANCH = Failure("no_cycle", "the motion has no loading branch")


def line_stiffness(bench: Bench, *, name: str, low: float, high: float) -> list[Result]:
    """Stiffness (N/m) by a straight line over a window of the first loading branch."""
    method = f"straight line from {1e3 * low:g} mm to {1e3 * high:g} mm of the first loading"
    asked = Asked(name, "N/m", _CURVE, f"{method}, interval for correlated noise")
    if not bench.cycles():
        return [to_result(bench, asked, blocked_or(bench, _NO_BRANCH))]
    curve, stretch = curve_of(bench), loading_stretch(bench)
    displacement, force = curve.displacement[stretch], curve.force[stretch]
    window = _window(displacement, low, high)
    if isinstance(window, Failure):
        return [to_result(bench, asked, window)]
    line = fit_line(displacement[window], force[window])
    if isinstance(line, Failure):
        return [to_result(bench, asked, line)]
    slope = _with_other_displacement(bench, stretch, window, line.slope)
    level = line.intercept.value + line.slope.value * line.start
    bench.lines.append(FittedLine(name, slope.value, level, line.start, line.stop))
    bench.stiffnesses[name] = slope
    fall = "negative_slope: the force falls where the frame pulls" if slope.value <= 0.0 else ""
    doubt = "; ".join(filter(None, [fall, _marked_slip(bench, line.start, line.stop)]))
    return [to_result(bench, asked, _scaled(bench, slope), doubt=doubt)]


def two_segments(bench: Bench, *, low: float, high: float) -> list[Result]:
    """Slopes (N/m) and break point (m) of the best two segments over a window."""
    method = f"two segments that meet, from {1e3 * low:g} mm to {1e3 * high:g} mm, all breaks tried"
    names = ("segment_stiffness_first", "segment_stiffness_second", "break_point")
    asked = [
        Asked(name, unit, _CURVE, method)
        for name, unit in zip(names, ("N/m", "N/m", "m"), strict=True)
    ]
    fit = _segments(bench, low, high)
    if isinstance(fit, Failure):
        return [to_result(bench, each, fit) for each in asked]
    first, second, at = fit.first, fit.second, fit.break_point
    bench.stiffnesses |= {names[0]: first, names[1]: second}
    left = fit.level - first.value * (at.value - fit.start)
    bench.lines += [
        FittedLine(names[0], first.value, left, fit.start, at.value),
        FittedLine(names[1], second.value, fit.level, at.value, fit.stop),
    ]
    zero = bench.signals[bench.displacement].zero_error
    doubt = _marked_slip(bench, fit.start, fit.stop)
    return [
        to_result(bench, asked[0], _scaled(bench, first), doubt=doubt),
        to_result(bench, asked[1], _scaled(bench, second), doubt=doubt),
        to_result(bench, asked[2], widened(at, zero, _slack_error(bench)), doubt=doubt),
    ]


def _segments(bench: Bench, low: float, high: float) -> TwoSegments | Failure:
    if not bench.cycles():
        return blocked_or(bench, _NO_BRANCH)
    curve, stretch = curve_of(bench), loading_stretch(bench)
    displacement, force = curve.displacement[stretch], curve.force[stretch]
    window = _window(displacement, low, high)
    if isinstance(window, Failure):
        return window
    return fit_two_segments(displacement[window], force[window])


def normalised_stiffness(bench: Bench, *, of: str) -> list[Result]:
    """A stiffness over the largest force of all cycles (1/m); a gain error cancels."""
    method = f"{of} / peak force of the same sample, errors independent, scale error cancelled"
    asked = Asked(f"{of}_per_peak_force", "1/m", _CURVE, method)
    doubts = [_doubt_of(bench, of), *(broken_off(bench, each[:1]) for each in bench.cycles()[-1:])]
    doubt = "; ".join(filter(None, doubts))
    return [to_result(bench, asked, _normalised(bench, of), doubt=doubt)]


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
    peaks = [repaired_peak_force(bench, branches) for branches in bench.cycles()]
    known = [peak for peak in peaks if isinstance(peak, Estimate)]
    if not known:
        return next(peak for peak in peaks if isinstance(peak, Failure))
    return widened(max(known, key=lambda peak: peak.value), bench.raw[bench.force].zero_error)


def modulus_result(bench: Bench, entry: Modulus, specimen: SpecimenBlock) -> list[Result]:
    """A modulus (Pa): stiffness x gauge length / area, the area named."""
    method = f"{entry.of} x specimen.length / area ({entry.area}); sizes taken as exact"
    asked = Asked(entry.name, "Pa", _CURVE, method)
    stiffness, area = bench.stiffnesses.get(entry.of), _area(entry.area, specimen)
    outcome: Estimate | Failure
    if stiffness is None:
        outcome = blocked_or(bench, Failure("no_stiffness", f"{entry.of} could not be had"))
    elif specimen.length is None:
        outcome = Failure("no_length", "specimen.length, the gauge length, is not given")
    elif isinstance(area, Failure):
        outcome = area
    else:
        outcome = modulus(_scaled(bench, stiffness), gauge_length=specimen.length, area=area)
    return [to_result(bench, asked, outcome, doubt=_doubt_of(bench, entry.of))]


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


def failure_results(bench: Bench) -> list[Result]:
    """``failure_displacement`` (m) and ``failure_force`` (N): the last point before the loss."""
    method = "last sample before the force is lost; lopsided by the step to the next"
    asked = Asked("failure_displacement", "m", ("displacement",), method)
    by_force = Asked(
        "failure_force", "N", ("force",), "parabola to half a step beyond the last sample"
    )
    failure = _failure(bench)
    if isinstance(failure, Failure):
        return [to_result(bench, each, failure) for each in (asked, by_force)]
    zero = bench.signals[bench.displacement].zero_error
    place = widened(failure.displacement, zero, _slack_error(bench))
    force = widened(failure.force, bench.raw[bench.force].zero_error)
    doubt = _in_steps(failure)
    return [
        to_result(bench, asked, place, doubt=doubt),
        to_result(bench, by_force, _scaled(bench, force), doubt=doubt),
    ]


def _in_steps(failure: FailurePoint) -> str:
    """Why a failure is doubtful that was not the first sudden loss of force."""
    if failure.lost_before == 0.0:
        return ""
    return (
        "lost_in_steps: some of the force was suddenly lost before, and it never came back to where"
        " it had been"
    )


def energy_to_break_result(bench: Bench) -> list[Result]:
    """``energy_to_break`` (J): work done on the specimen up to its failure."""
    asked = Asked("energy_to_break", "J", _CURVE, "integral of force up to the failure, trapezoids")
    failure, branch = _failure(bench), loading_branch(bench, last=True)
    if isinstance(failure, Failure) or branch is None:
        why = failure if isinstance(failure, Failure) else _NO_BRANCH
        return [to_result(bench, asked, why)]
    curve, stretch = curve_of(bench), slice(branch.start, branch.stop)
    point = replace(failure, sample=failure.sample - branch.start)
    found = energy_to_break(curve.displacement[stretch], curve.force[stretch], point)
    if isinstance(found, Failure):
        return [to_result(bench, asked, found)]
    way = curve.displacement[failure.sample] - curve.displacement[branch.start]
    zero = bench.raw[bench.force].zero_error * float(way)
    added = _repaired_work(bench, curve.displacement, failure.sample)
    energy = _scaled(bench, widened(found, zero, added))
    return [to_result(bench, asked, energy, doubt=_in_steps(failure))]


def _repaired_work(bench: Bench, displacement: Floats, last: int) -> float:
    """Standard error of the work, J, that drops added back have done up to a sample."""
    ways = [
        slip.drop_interval.standard_error * float(displacement[last] - slip.position)
        for slip in bench.slips
        if slip.decision is SlipDecision.REPAIRED and slip.start < last
    ]
    return float(np.linalg.norm(ways))


def _failure(bench: Bench) -> FailurePoint | Failure:
    return bench.failure or blocked_or(bench, _NO_BRANCH)


def slip_results(bench: Bench) -> list[Result]:
    """``slip_position.<n>`` (m) and ``slip_drop.<n>`` (N) of the slip ledger."""
    results: list[Result] = []
    for number, slip in enumerate(bench.slips, start=1):
        method = "two parallel lines around a sudden fall of the force"
        at = Asked("slip_position", "m", ("displacement",), f"{method}; {slip.decision}")
        drop = Asked("slip_drop", "N", ("force",), f"{method}; {slip.decision}")
        interval = slip.position_interval
        place = Estimate(slip.position, interval.standard_error, 1, interval)
        lost = Estimate(slip.drop, slip.drop_interval.standard_error, 1, slip.drop_interval)
        place = widened(place, _slack_error(bench))
        results += [
            to_result(bench, at, place, part=f".{number}"),
            to_result(bench, drop, _scaled(bench, lost), part=f".{number}"),
        ]
    return results


def slack_result(bench: Bench) -> list[Result]:
    """``slack`` (m): displacement at which the line of the linear region meets zero force."""
    asked = Asked("slack", "m", ("displacement",), "toe compensation, ASTM D638 annex A1")
    slack = bench.slack or blocked_or(bench, _NO_BRANCH)
    if isinstance(slack, Estimate):
        slack = widened(slack, bench.signals[bench.displacement].zero_error)
    return [to_result(bench, asked, slack)]


def compliance_result(bench: Bench, *, low: float, high: float) -> list[Result]:
    """``compliance`` (m/N) of frame and grips, the bar taken for rigid."""
    method = f"displacement against force from {low:g} N to {high:g} N, the bar taken for rigid"
    asked = Asked("compliance", "m/N", _CURVE, method)
    if not bench.cycles():
        return [to_result(bench, asked, blocked_or(bench, _NO_BRANCH))]
    curve, stretch = curve_of(bench), loading_stretch(bench)
    found = fit_compliance(curve.displacement[stretch], curve.force[stretch], start=low, stop=high)
    return [to_result(bench, asked, found if isinstance(found, Failure) else _scaled(bench, found))]


def _window(displacement: Floats, low: float, high: float) -> slice | Failure:
    """Samples from the first one at `low` to the last one before `high`, in order of time."""
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


def _scaled(bench: Bench, estimate: Estimate) -> Estimate:
    """Add the uncertainty of the scale of the force."""
    return widened(estimate, bench.raw[bench.force].relative_error * abs(estimate.value))


def _slack_error(bench: Bench) -> float:
    return bench.slack.error if isinstance(bench.slack, Estimate) else 0.0


def _doubt_of(bench: Bench, stiffness: str) -> str:
    """Why a number is doubtful that is made of a stiffness: for the reason that this one is."""
    segments = stiffness.startswith("segment_stiffness_")  # one slip bends both
    lines = [
        line
        for line in bench.lines
        if line.result == stiffness or (segments and line.result.startswith("segment_stiffness_"))
    ]
    if not lines:
        return ""
    return _marked_slip(bench, min(line.start for line in lines), max(line.stop for line in lines))


def _marked_slip(bench: Bench, start: float, stop: float) -> str:
    """Why a number over a stretch is doubtful in which a slip was only marked."""
    inside = [
        slip
        for slip in bench.slips
        if slip.decision is SlipDecision.MARKED and start <= slip.position <= stop
    ]
    if not inside:
        return ""
    at = ", ".join(f"{1e3 * slip.position:.4g} mm" for slip in inside)
    return f"slip_in_window: slipped in the grips at {at}, and the curve stays as measured"
