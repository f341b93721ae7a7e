"""From the bench to results: every number with interval, status and reason.

Each function gives the results of one entry of a protocol's list. The numbers themselves come from
`labpipe.fitting`; here they get their names, their uncertainty from calibration, zero and shape,
and their status.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from labpipe.fitting.corners import fit_corner, value_at_turn
from labpipe.fitting.estimates import Estimate, Failure
from labpipe.fitting.loops import (
    loop_energy,
    residual_after_unloading,
    secant_stiffness,
    smooth_peak,
)
from labpipe.pipeline.bench import Bench, Signal
from labpipe.pipeline.marker_steps import tip_travel
from labpipe.processing.filtering import moving_average
from labpipe.records.arrays import Floats
from labpipe.records.curve import Branch, Curve, Interval
from labpipe.records.result import Result, Status

_PEAK_WINDOW = 2.0
"""s on each side of a turning point that a peak is read from."""


@dataclass(frozen=True, slots=True)
class _Asked:
    """What is said of a result whether or not it can be had."""

    name: str
    unit: str
    quantities: tuple[str, ...]
    method: str
    needs: int = 0
    """Branches of a cycle that must have been recorded to their end."""


_ALL = ("force", "displacement", "clock")


def clock_results(bench: Bench) -> list[Result]:
    """``clock_offset`` (s) and ``clock_drift`` (1): force time against marker time."""
    method = "weighted straight line through turning points seen on both clocks"
    fit = bench.clock_fit
    offset: Estimate | Failure = _blocked(bench, Failure("one_clock", "there is only one clock"))
    drift = offset
    if fit is not None:
        events = len(fit.event_times_motion)
        offset = Estimate(fit.offset, fit.offset_interval.standard_error, events)
        drift = Estimate(fit.drift, fit.drift_interval.standard_error, events)
        if events < 2:
            drift = Failure("one_event", "one turning point gives an offset but no drift")
    return [
        _result(bench, _Asked("clock_offset", "s", ("clock",), method), offset),
        _result(bench, _Asked("clock_drift", "1", ("clock",), method), drift),
    ]


def peak_force(bench: Bench) -> list[Result]:
    """``peak_force.<cycle>`` (N): the force where the motion turns from loading to unloading."""
    method = "parabolas on both sides of the corner, unsmoothed force; else vertex of a parabola"
    return _per_cycle(bench, _Asked("peak_force", "N", ("force",), method, needs=1), _peak_force)


def peak_displacement(bench: Bench) -> list[Result]:
    """``peak_displacement.<cycle>`` (m): the displacement where the motion turns."""
    method = "parabolas on both sides of the turning point; else vertex of a parabola"
    asked = _Asked("peak_displacement", "m", ("displacement",), method, needs=1)
    return _per_cycle(bench, asked, _peak_displacement)


def energy(bench: Bench) -> list[Result]:
    """``energy.<cycle>`` (J): work dissipated over one cycle."""
    asked = _Asked("energy", "J", _ALL, "integral of force, trapezoids", needs=2)
    return _per_cycle(bench, asked, _energy)


def residual_displacement(bench: Bench, *, force_below: float) -> list[Result]:
    """``residual_displacement.<cycle>`` (m): displacement left at zero force after unloading."""
    method = f"displacement once the force is back at zero, within {force_below:g} N"
    asked = _Asked("residual_displacement", "m", _ALL, method)
    return _per_cycle(bench, asked, partial(_residual, force_below=force_below))


def loading_stiffness(bench: Bench, *, name: str, low: float, high: float) -> list[Result]:
    """Stiffness (N/m) between two displacements of the first loading branch."""
    method = f"line from {low:g} m to {high:g} m of the first loading, time as instrument"
    number = partial(_in_window, low=low, high=high)
    asked, first = _Asked(name, "N/m", _ALL, method), bench.cycles()[:1]
    outcome: Estimate | Failure = _blocked(bench, Failure("no_cycle", "the motion has no branch"))
    if first:
        outcome = _with_shape_error(bench, first[0], number)
    return [_result(bench, asked, outcome)]


def tip_travel_result(bench: Bench) -> list[Result]:
    """``tip_travel`` (m): the largest distance of the last point from where it began."""
    method = "largest distance of the last point of the shape from its mean over five frames"
    return [_result(bench, _Asked("tip_travel", "m", ("displacement",), method), tip_travel(bench))]


def unloading_stiffness(bench: Bench, *, over: float) -> list[Result]:
    """``unloading_stiffness.<cycle>`` (N/m) over the first stretch of the unloading branch."""
    method = f"line from {0.1 * over:g} m to {over:g} m off the peak, time as instrument"
    asked = _Asked("unloading_stiffness", "N/m", _ALL, method)
    return _per_cycle(bench, asked, partial(_unloading, low=0.1 * over, high=over))


_Numbers = Callable[[Bench, list[Branch], Floats], Estimate | Failure]
"""A number of one cycle, from the bench, the branches of the cycle and a displacement."""


def _per_cycle(bench: Bench, asked: _Asked, of_cycle: _Numbers) -> list[Result]:
    cycles = bench.cycles()
    if not cycles:
        failure = _blocked(bench, Failure("no_cycle", "the motion has no branch"))
        return [_result(bench, asked, failure, part=".1")]
    return [
        _result(
            bench,
            asked,
            _with_shape_error(bench, branches, of_cycle),
            part=f".{branches[0].cycle}",
            doubt=_broken_off(bench, branches[: asked.needs]),
        )
        for branches in cycles
    ]


def _broken_off(bench: Bench, branches: list[Branch]) -> str:
    """Why a number is doubtful whose branches the record does not hold to their end."""
    if not branches or branches[-1].stop < len(_curve(bench).time):
        return ""
    part = branches[-1]
    return f"partial_cycle: the record ends at {part.stop_time:.3f} s, while still {part.direction}"


def _with_shape_error(
    bench: Bench, branches: list[Branch], of_cycle: _Numbers
) -> Estimate | Failure:
    """Estimate, its error widened by what another shape would have given."""
    displacement = bench.signals[bench.displacement]
    estimate = of_cycle(bench, branches, displacement.values)
    if displacement.alternative is None or isinstance(estimate, Failure):
        return estimate
    other = of_cycle(bench, branches, displacement.alternative)
    if isinstance(other, Failure):
        return estimate
    change = abs(other.value - estimate.value) / np.sqrt(3.0)  # a rectangle of that half width
    return Estimate(estimate.value, float(np.hypot(estimate.error, change)), estimate.n)


def _peak_force(bench: Bench, branches: list[Branch], displacement: Floats) -> Estimate | Failure:
    del displacement
    force = bench.raw[bench.force]
    if _is_sharp(bench, branches):
        at = branches[0].stop_time
        at = bench.clock_fit.to_force_seconds(at) if bench.clock_fit else at
        near = slice(*np.searchsorted(force.time, [at - 2 * _PEAK_WINDOW, at + 2 * _PEAK_WINDOW]))
        corner = fit_corner(
            force.time[near], force.values[near], near=at, window=_window(branches), degree=2
        )
        if corner is None:
            return Failure("no_corner", f"the force has no corner near {at:.3f} s of its clock")
        estimate = Estimate(corner.value, corner.value_error, corner.n)
    else:
        curve, stretch = _curve(bench), _cycle(branches)
        # One sense for all cycles: the force may run ahead of the motion by a quarter of a cycle.
        sense = _sense(curve.force, slice(curve.branches[0].start, None))
        found = smooth_peak(curve.time[stretch], sense * curve.force[stretch], share=0.05)
        if isinstance(found, Failure):
            return found
        estimate = Estimate(sense * found.value, found.error, found.n)
    return _scaled(estimate, force)


def _peak_displacement(
    bench: Bench, branches: list[Branch], displacement: Floats
) -> Estimate | Failure:
    signal = bench.signals[bench.displacement]
    if _is_sharp(bench, branches):
        found = value_at_turn(
            signal.time,
            displacement,
            at=branches[0].stop_time,
            window=_window(branches),
            degree=2,
        )
    else:
        stretch, sense = _cycle(branches), _sense(displacement, bench.within(branches[0]))
        found = smooth_peak(signal.time[stretch], sense * displacement[stretch], share=0.05)
        if isinstance(found, Estimate):
            found = Estimate(sense * found.value, found.error, found.n)
    return found if isinstance(found, Failure) else _scaled(found, signal)


def _energy(bench: Bench, branches: list[Branch], displacement: Floats) -> Estimate | Failure:
    if len(branches) < 2:
        return Failure("partial_cycle", "the cycle has no unloading branch")
    curve, stretch = _curve(bench), _cycle(branches)
    found = loop_energy(
        curve.time[stretch],
        displacement[stretch],
        curve.force[stretch],
        clock_error=_clock_error(bench),
    )
    if isinstance(found, Failure):
        return found
    opened = displacement[stretch][-1] - displacement[stretch][0]
    zero = bench.raw[bench.force].zero_error * opened
    scale = bench.raw[bench.force].relative_error * found.value
    return Estimate(found.value, float(np.hypot(np.hypot(found.error, zero), scale)), found.n)


def _residual(
    bench: Bench, branches: list[Branch], displacement: Floats, force_below: float
) -> Estimate | Failure:
    if len(branches) < 2:
        return Failure("partial_cycle", "the cycle has no unloading branch")
    curve, unloading = _curve(bench), bench.within(branches[1])
    found = residual_after_unloading(
        curve.time[unloading],
        displacement[unloading],
        curve.force[unloading],
        force_below=force_below,
    )
    zero = bench.signals[bench.displacement].zero_error
    if isinstance(found, Failure):
        return found
    return Estimate(found.value, float(np.hypot(found.error, zero)), found.n)


def _in_window(
    bench: Bench, branches: list[Branch], displacement: Floats, low: float, high: float
) -> Estimate | Failure:
    """Stiffness of the loading branch between two displacements."""
    return _stiffness(bench, branches[0], displacement, low, high)


def _unloading(
    bench: Bench, branches: list[Branch], displacement: Floats, low: float, high: float
) -> Estimate | Failure:
    """Stiffness of the unloading branch between two distances from where it begins."""
    if len(branches) < 2:
        return Failure("partial_cycle", "the cycle has no unloading branch")
    turn = _value_at_start(_curve(bench).time, displacement, branches[1])
    found = _stiffness(bench, branches[1], turn - displacement, low, high)
    if isinstance(found, Failure):
        return found
    return Estimate(-found.value, found.error, found.n)


def _value_at_start(time: Floats, values: Floats, part: Branch) -> float:
    """Value at the turning point a branch starts from, by a parabola through its beginning."""
    begin = slice(part.start, min(part.stop, part.start + 50))
    known = ~np.isnan(values[begin])
    t, y = time[begin][known] - part.start_time, values[begin][known]
    if len(y) < 8:
        return float(values[part.start])
    return float(np.polynomial.Polynomial.fit(t, y, 2)(0.0))


def _stiffness(
    bench: Bench, part: Branch, path_of_all: Floats, low: float, high: float
) -> Estimate | Failure:
    """Stiffness over the part of a branch whose path lies between two lengths."""
    curve = _curve(bench)
    branch = bench.within(part)
    time, force, path = curve.time[branch], curve.force[branch], path_of_all[branch]
    travelled = moving_average(path, window=min(11, len(path) - 1 + len(path) % 2))
    inside = (travelled >= low) & (travelled <= high)
    if not (travelled > high).any():
        reached = float(np.nanmax(travelled))
        return Failure("not_reached", f"the branch reaches {reached:.4g} m, {high:.4g} m is asked")
    inside[int(np.argmax(travelled > high)) :] = False
    found = secant_stiffness(time, path, force, inside)
    if isinstance(found, Failure):
        return found
    scale = bench.raw[bench.force].relative_error * found.value
    return Estimate(found.value, float(np.hypot(found.error, scale)), found.n)


def _curve(bench: Bench) -> Curve:
    if bench.curve is None:  # cycles() is empty then, so no number of a cycle is asked for
        message = "a number of a cycle was asked for before there is a curve"
        raise ValueError(message)
    return bench.curve


def _is_sharp(bench: Bench, branches: list[Branch]) -> bool:
    """Whether loading ends in a corner, as it does where clocks are joined at corners."""
    return len(branches) > 1 and bench.clock_fit is not None


def _sense(values: Floats, stretch: slice) -> float:
    """-1.0 where a quantity goes further down than up from where it begins, else 1.0."""
    known = values[stretch][~np.isnan(values[stretch])]
    if not len(known):
        return 1.0
    start = known[: max(1, len(known) // 100)].mean()
    return -1.0 if known.max() - start < start - known.min() else 1.0


def _cycle(branches: list[Branch]) -> slice:
    return slice(branches[0].start, branches[-1].stop)


def _window(branches: list[Branch]) -> float:
    """Seconds on each side of the end of loading that hold no other corner."""
    shortest = min(branch.stop_time - branch.start_time for branch in branches)
    window = min(_PEAK_WINDOW, 0.4 * shortest)
    dwell = branches[1].start_time - branches[0].stop_time if len(branches) > 1 else 0.0
    return min(window, 0.9 * dwell) if dwell > 0 else window


def _clock_error(bench: Bench) -> float:
    fit = bench.clock_fit
    if fit is None:
        return 0.0
    return float(np.sqrt(1.0 / np.sum(fit.event_errors**-2.0)))


def _scaled(estimate: Estimate, signal: Signal) -> Estimate:
    """Add the uncertainty of scale and zero."""
    error = np.sqrt(
        estimate.error**2 + signal.zero_error**2 + (signal.relative_error * estimate.value) ** 2
    )
    return Estimate(estimate.value, float(error), estimate.n)


def _blocked(bench: Bench, otherwise: Failure) -> Failure:
    if not bench.blocked:
        return otherwise
    code, _, message = bench.blocked.partition(": ")
    return Failure(code, message)


def _result(
    bench: Bench, asked: _Asked, outcome: Estimate | Failure, *, part: str = "", doubt: str = ""
) -> Result:
    name = asked.name + part
    if isinstance(outcome, Estimate) and not np.isfinite([outcome.value, outcome.error]).all():
        outcome = Failure("not_finite", f"value {outcome.value}, standard error {outcome.error}")
    if isinstance(outcome, Failure):
        reason = f"{outcome.code}: {outcome.message}"
        return Result(name, None, asked.unit, None, Status.FAILED, reason, asked.method, 0)
    doubts = [bench.doubts[quantity] for quantity in asked.quantities if quantity in bench.doubts]
    doubts += [doubt] if doubt else []
    return Result(
        name=name,
        value=outcome.value,
        unit=asked.unit,
        interval=Interval.normal_95(outcome.value, outcome.error),
        status=Status.DOUBTFUL if doubts else Status.OK,
        reason="; ".join(dict.fromkeys(doubts)),
        method=asked.method,
        n=outcome.n,
    )
