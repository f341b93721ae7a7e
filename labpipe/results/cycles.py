"""Results of every cycle: peak force and displacement, energy, residual displacement."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import ClassVar, Literal

import numpy as np

from labpipe.records.arrays import Flags, Floats, Ints, as_slice, divide
from labpipe.records.curve import Branch, Curve, Direction
from labpipe.records.declarations import CURVE_QUANTITIES, Force, Output
from labpipe.records.estimates import UnavailableError, return_failure
from labpipe.records.quality import Reason
from labpipe.records.signals import Stretch
from labpipe.results import curves, kinds
from labpipe.results.kinds import Kind, Part, ReducedTest
from labpipe.uncertainty.autocorrelation import estimate_fast_noise, scale_limit_by_noise
from labpipe.uncertainty.replicates import Reading, Trace, read_part


def integrate_energy(displacement: Floats, force: Floats) -> Floats:
    """Integrate force over displacement by trapezoids, J, shape (...).

    Parameters
    ----------
    displacement, force : shape (..., n), m, N; either may be shape (n,), the same for all rows

    Examples
    --------
    >>> integrate_energy(np.array([0.0, 1.0, 3.0]), np.array([[0.0, 2.0, 2.0], [1.0, 1.0, 1.0]]))
    array([5., 3.])
    """
    steps = np.empty_like(displacement)
    np.subtract(displacement[..., 2:], displacement[..., :-2], out=steps[..., 1:-1])
    steps[..., 0] = displacement[..., 1] - displacement[..., 0]
    steps[..., -1] = displacement[..., -1] - displacement[..., -2]
    work: Floats = 0.5 * np.vecdot(steps, force)
    return work


FOOT_LIMIT_FACTOR = 5.0
"""Multiple of the limit of zero force up to which the foot of the force is assumed straight."""


_TIME_BEFORE_ZERO = 1.0
"""s before zero force, over which a line is fitted to the displacement."""


_MIN_CROSSING_SAMPLES = 8
"""Fewest samples of a fit to the force or the displacement at zero force."""


_MIN_ZERO_FOOT_SAMPLES = 4


@dataclass(frozen=True, slots=True, eq=False)
class UnloadingEnd:
    """The end of an unloading, and the samples that give its residual displacement.

    Parameters
    ----------
    kind : the force continues below zero; the string is slack and the displacement at rest; or the
        foot of the force is extrapolated to zero
    limit : N, up to which a force counts as zero
    n : samples used for the displacement
    compute : returns the displacement at zero force, m, shape (...), from displacements and forces
        of the branch, shape (..., n); NaN for a curve whose force does not return to zero
    """

    kind: Literal["through zero", "at rest", "followed"]
    limit: float
    n: int
    compute: Callable[[Floats, Floats], Floats]


def find_unloading_end(
    time: Floats,
    displacement: Floats,
    force: Floats,
    *,
    force_below: float,
    measured_end: UnloadingEnd | None = None,
) -> UnloadingEnd:
    """Choose the samples for the displacement at zero force after unloading.

    Parameters
    ----------
    time, displacement, force : shape (n,), s, m, N; one unloading branch; NaN are ignored
    force_below : N; a force within this limit counts as zero. It is reduced to a fiftieth of the
        largest force, then raised to four standard deviations of the noise, where needed
    measured_end : the end of the measured branch, if this branch has no noise; else None

    Returns
    -------
    The end and its samples.

    Raises
    ------
    UnavailableError
        ``force_not_zero`` if the branch ends before the force is zero, ``too_few_samples``.

    Notes
    -----
    There are three cases. If the force continues below zero, parabolas through force and
    displacement, over a tenth of the branch on each side, give the time of zero force and the
    displacement there. If the string becomes slack and the displacement rests, its mean is used;
    this is so if the line through the foot of the force would fall to three limits below zero by
    the end of the branch, while, from 0.2 s after zero force, the force stays within two limits of
    zero and the displacement within its noise. Otherwise the line through
    the foot is extrapolated to zero, and so is the displacement, along a line through the second
    before, since it may have a kink at zero force. The foot is chosen for each curve.
    """
    max_zero_share = 0.02  # of the largest force, up to which a force may count as zero
    noise_deviations = 4.0  # standard deviations of noise above which a force is not zero
    finite = curves.find_finite_samples(displacement, force)
    t, d, f = (values[finite] for values in (time, displacement, force))
    curves.require_samples(len(f), 2 * _MIN_CROSSING_SAMPLES, "")
    lowest_limit = min(force_below, max_zero_share * float(f.max()))
    limit = max(noise_deviations * float(estimate_fast_noise(f)), lowest_limit)
    limit = limit if measured_end is None else measured_end.limit
    above = np.flatnonzero(f > limit)
    if len(above) == 0:
        raise UnavailableError.of("results.none_above_limit", count=len(f), limit=limit)
    if above[-1] >= len(f) - 3:
        raise UnavailableError.of("results.force_not_zero", end=f[-3:].mean(), limit=limit)
    kind = None if measured_end is None else measured_end.kind
    if kind is None and np.median(f[-_MIN_CROSSING_SAMPLES:]) < -limit:
        kind = "through zero"
    if kind == "through zero":
        return _fit_zero_crossing(finite, t, f, limit)
    end = float(t[above[-1]])
    zeros, slopes, _ = _extrapolate_foot(t - end, f[np.newaxis], np.array([[limit]]))
    zero = end + float(zeros[0])
    is_after_zero = t > zero + 0.2
    has_reached_zero = slopes[0] * (t[-1] - zero) < -3.0 * limit
    if kind is None and has_reached_zero and _is_resting(t, d, f, is_after_zero, limit):
        kind = "at rest"
    if kind == "at rest" and is_after_zero.any():
        samples = as_slice(finite[is_after_zero])
        count = int(is_after_zero.sum())
        return UnloadingEnd(
            kind, limit, count, lambda d, _: np.asarray(d[..., samples].mean(axis=-1))
        )
    count = int(((t >= zero - _TIME_BEFORE_ZERO) & (t <= zero)).sum())
    if count < _MIN_CROSSING_SAMPLES:
        raise UnavailableError.of("results.few_before_zero", count=count, zero=zero)
    compute = partial(_extrapolate_to_zero, finite, t - end, (limit, lowest_limit))
    return UnloadingEnd("followed", limit, count, compute)


def _extrapolate_foot(time: Floats, force: Floats, limits: Floats) -> tuple[Floats, Floats, Ints]:
    """Extrapolate the foot of the force of each row to zero.

    Parameters
    ----------
    time, force, limits : shape (n,), (rows, n) and (rows, 1), s, N, N

    Returns
    -------
    Each of shape (rows,): time of zero force, slope of the foot in N/s, and last sample above the
    limit, or -1. If the force does not fall there, the time of that sample and the slope 0.
    """
    begin, end = (find_last_flagged(force > x) for x in (FOOT_LIMIT_FACTOR * limits, limits))
    stretch = slice(max(int(begin.min()), 0), max(int(end.max()), 0) + 1)
    numbers = np.arange(stretch.start, stretch.stop)
    foot = (numbers >= begin[:, np.newaxis]) & (numbers <= end[:, np.newaxis])
    middle, level, slope = curves.fit_chosen_lines(foot, time[stretch], force[:, stretch])
    is_falling = (slope < 0.0) & (foot.sum(axis=1) >= _MIN_ZERO_FOOT_SAMPLES)
    zeros = np.where(is_falling, middle - divide(level, slope), time[end])
    return zeros, np.where(is_falling, slope, 0.0), end


def _fit_zero_crossing(finite: Ints, time: Floats, force: Floats, limit: float) -> UnloadingEnd:
    """Choose the samples around the zero of a force that continues below it."""
    middle = time[min(int((force > 0.0).sum()), len(time) - 1)]
    is_near_crossing = np.abs(time - middle) <= 0.1 * (time[-1] - time[0])
    curves.require_samples(int(is_near_crossing.sum()), _MIN_CROSSING_SAMPLES, " near zero force")
    samples, centred = as_slice(finite[is_near_crossing]), time[is_near_crossing] - middle
    weights = curves.compute_polynomial_weights(centred, degree=2).T

    def compute(displacement: Floats, force: Floats) -> Floats:
        level, slope, bend = np.moveaxis(force[..., samples] @ weights, -1, 0)
        zero = np.zeros_like(level)
        for _ in range(4):  # Newton steps, from near the root
            step = divide(level + zero * (slope + zero * bend), slope + 2.0 * zero * bend)
            zero = np.clip(zero - step, centred[0], centred[-1])
        place, speed, curve = np.moveaxis(displacement[..., samples] @ weights, -1, 0)
        value: Floats = place + zero * (speed + zero * curve)
        return value

    return UnloadingEnd("through zero", limit, len(centred), compute)


def _is_resting(t: Floats, d: Floats, f: Floats, is_rest: Flags, limit: float) -> bool:
    """Check whether the force is within two limits of zero, and the displacement has no slope."""
    if is_rest.sum() < _MIN_CROSSING_SAMPLES or np.abs(f[is_rest]).max() > 2.0 * limit:
        return False
    centred_time, values = t[is_rest] - t[is_rest].mean(), d[is_rest]
    slope = float(curves.compute_slope(centred_time, values))
    noise = values - values.mean() - slope * centred_time
    noise_limit = 3.0 * float(noise.std()) + 1e-9 * float(np.ptp(d))
    return abs(slope) * float(np.ptp(centred_time)) <= noise_limit


def _extrapolate_to_zero(
    finite: Ints,
    time: Floats,
    given_limits: tuple[float, float],
    displacement: Floats,
    force: Floats,
) -> Floats:
    """Return the displacement at which the foot of each curve, extrapolated, is zero.

    NaN if the force does not return to zero, or too few samples are before it. `given_limits` are
    those of zero force, with noise and without.
    """
    samples, (limit, lowest_limit) = as_slice(finite), given_limits
    d, f = np.broadcast_arrays(displacement[..., samples], force[..., samples])
    shape, (d, f) = f.shape[:-1], (values.reshape(-1, len(time)) for values in (d, f))
    limits = np.full((len(f), 1), limit)
    if limit > lowest_limit:
        limits = np.maximum(scale_limit_by_noise(limit, f), lowest_limit)[:, np.newaxis]
    zeros, _, end = _extrapolate_foot(time, f, limits)
    ends = [zeros.min() - _TIME_BEFORE_ZERO, zeros.max() + _TIME_BEFORE_ZERO]
    part = slice(*np.searchsorted(time, ends))
    t, start = time[part], zeros[:, np.newaxis] - _TIME_BEFORE_ZERO
    is_before_zero = (t >= start) & (t <= zeros[:, np.newaxis])
    middle, level, slope = curves.fit_chosen_lines(is_before_zero, t, d[:, part])
    ended = (end >= 0) & (end < len(time) - 3)
    ended &= is_before_zero.sum(axis=1) >= _MIN_CROSSING_SAMPLES
    return np.where(ended, level + slope * (zeros - middle), np.nan).reshape(shape)


def find_last_flagged(flags: Flags) -> Ints:
    """Return the last flagged sample of each row, or -1.

    Parameters
    ----------
    flags : shape (..., n), n not 0
    """
    last: Ints = flags.shape[-1] - 1 - np.argmax(flags[..., ::-1], axis=-1)
    return np.where(flags.any(axis=-1), last, -1)


@dataclass(frozen=True, slots=True, kw_only=True)
class PerCycle(Kind):
    """A kind of result with one number per cycle of the curve."""

    complete_branches: ClassVar[int] = 0
    """Branches of a cycle that must be complete."""
    reads: ClassVar[tuple[float, float]] = (0.0, 2.0)
    """Part of a cycle that the number depends on, counted in branches: 0.9 is nine tenths of the
    loading, 1 its end, 2 the end of unloading."""
    peak_of: ClassVar[curves.Quantity | None] = None
    """Quantity whose largest sample the number depends on."""

    @abstractmethod
    def choose(self, test: ReducedTest, trace: Trace, number: int) -> Reading:
        """Choose the samples of a cycle on a curve.

        Parameters
        ----------
        test : reduced test, for facts that do not depend on the curve
        trace : one curve
        number : number of the cycle, from 1
        """

    def list_doubts(self, test: ReducedTest, branches: list[Branch]) -> tuple[Reason, ...]:
        """Return further doubts about the number of a cycle: a sample missing at its peak."""
        return () if self.peak_of is None else _find_gap_at_peak(test, branches, self.peak_of)

    def measure(self, test: ReducedTest) -> Iterator[Part]:
        """Measure a number per cycle."""
        for branches in test.require(test.cycles or None):
            number, complete = branches[0].cycle, branches[: self.complete_branches]
            decide = partial(self.choose, test, number=number)
            outcome = return_failure(test.measure_one)(decide)
            doubts = find_cut_cycle(test, complete, self.outputs[0].depends_on)
            doubts += self.list_doubts(test, branches)
            period, suffix = _find_period(branches, self.reads), f".{number}"
            yield self.make_result(test, outcome, period=period, doubts=doubts, suffix=suffix)


def _find_gap_at_peak(
    test: ReducedTest, branches: list[Branch], quantity: curves.Quantity
) -> tuple[Reason, ...]:
    """Return a doubt if a sample next to the largest one of a cycle is missing."""
    curve = test.required_curve
    values: Floats = getattr(curve, quantity)
    part = values[find_cycle_samples(curve, branches[0].cycle)]
    if np.isnan(part).all():
        return ()
    top = int(np.nanargmax(find_loading_sign(curve, values) * part))
    if not np.isnan(part[max(top - 1, 0) : top + 2]).any():
        return ()
    return (Reason.of("results.gap_at_peak", quantity=quantity),)


def _find_period(branches: list[Branch], reads: tuple[float, float]) -> Stretch | None:
    """Return the interval of a part of a cycle in the curve's time unit; None without a branch."""
    if reads[0] >= len(branches):
        return None
    ends = []
    for position, number in ((reads[0], int(reads[0])), (reads[1], math.ceil(reads[1]) - 1)):
        part = branches[min(number, len(branches) - 1)]
        share = position - number if number < len(branches) else 1.0
        ends.append(part.start_time + share * (part.stop_time - part.start_time))
    return ends[0], ends[1]


def find_cut_cycle(
    test: ReducedTest, branches: list[Branch], quantities: tuple[str, ...] = ("force",)
) -> tuple[Reason, ...]:
    """Return a doubt if the record ends before the branches of a number, or in the last branch.

    No doubt if the record does not end early, if the specimen fails in the last of the branches, or
    if only the force counts and has fallen below 90 % of its peak there.

    Parameters
    ----------
    test : reduced test with the ends of its records
    branches : that must be complete
    quantities : that the number depends on
    """
    ends = min((test.cut_at.get(quantity, np.inf) for quantity in quantities), default=np.inf)
    if not branches or ends == np.inf:
        return ()
    part, failure, curve = branches[-1], test.failure, test.required_curve
    if ends >= part.stop_time and part is not curve.branches[-1]:
        return ()
    if isinstance(failure, kinds.FailurePoint) and part.start <= failure.sample < part.stop:
        return ()  # it broke, so the record is complete
    if quantities == ("force",) and _is_past_peak(test, part):
        return ()
    end_text = f"{ends:.3f} s" if curve.time_unit == "s" else f"sample {round(ends) + 1}"
    return (Reason.of("results.partial_cycle", end=end_text, direction=part.direction),)


def _is_past_peak(test: ReducedTest, part: Branch) -> bool:
    """Check whether the force has fallen below 90 % of its peak where the record ends."""
    curve = test.required_curve
    values = (find_loading_sign(curve, curve.force) * curve.force)[part.start : part.stop]
    values = values[~np.isnan(values)]
    return len(values) > 0 and bool(values[-3:].max() < 0.9 * values.max())


def find_cycle_samples(curve: Curve | Trace, number: int) -> slice:
    """Return the samples of a cycle from its first turn to its last one, both included.

    A rest between two cycles is divided at its extreme displacement. A last loading without
    unloading includes the hold after it, up to the last sample with a force.
    """
    places = [place for place, part in enumerate(curve.branches) if part.cycle == number]
    first, last = places[0], curve.branches[places[-1]]
    start = _find_turn_before(curve, first) if first else curve.branches[first].start
    if places[-1] + 1 < len(curve.branches):
        return slice(start, _find_turn_before(curve, places[-1] + 1) + 1)
    if last.direction is Direction.UNLOADING:
        return slice(start, last.stop)
    force_stop = int(np.flatnonzero(~np.isnan(curve.force)).max(initial=0)) + 1
    return slice(start, max(force_stop, last.stop))


def _find_turn_before(curve: Curve | Trace, number: int) -> int:
    """Return the sample of the turn before a branch that is not the first one."""
    previous, branch = curve.branches[number - 1 : number + 1]
    d = curve.displacement[previous.stop : branch.start + 1]
    d = find_loading_sign(curve, curve.displacement) * d
    if np.isnan(d).all():
        return branch.start
    is_top = previous.direction is Direction.LOADING
    return previous.stop + int(np.nanargmax(d) if is_top else np.nanargmin(d))


def find_loading_sign(curve: Curve | Trace, values: Floats) -> float:
    """Return the sign of a quantity of a curve during the first loading.

    Parameters
    ----------
    curve : one curve
    values : shape (n,), of the quantity
    """
    branch = curve.branches[0]
    return kinds.compute_loading_sign(values[branch.start : branch.stop])


def select_cycle(trace: Trace, number: int) -> list[Branch]:
    """Return the branches of a cycle of a curve, in order.

    Parameters
    ----------
    trace : one or many curves
    number : number of the cycle, from 1
    """
    return [branch for branch in trace.branches if branch.cycle == number]


@dataclass(frozen=True, slots=True, kw_only=True)
class Energy(PerCycle):
    """``energy.<cycle>`` (J): dissipated over one cycle."""

    result: ClassVar = "energy"
    outputs: ClassVar = (
        Output(
            "energy",
            "J",
            "Energy dissipated",
            (*CURVE_QUANTITIES, "start"),
            first=1,
            is_raised_by_slips=True,
        ),
    )
    complete_branches: ClassVar = 2
    method: ClassVar = "integral of force, trapezoids"

    def choose(self, test: ReducedTest, trace: Trace, number: int) -> Reading:
        """Choose the samples for the integral of the force over a cycle."""
        del test
        require_unloading(select_cycle(trace, number))
        return choose_work_samples(trace, find_cycle_samples(trace, number))


def require_unloading(branches: list[Branch]) -> Branch:
    """Return the unloading branch of a cycle.

    Raises
    ------
    UnavailableError
        ``partial_cycle`` without one.
    """
    if len(branches) < 2:
        raise UnavailableError.of("results.no_unloading")
    return branches[1]


def choose_work_samples(trace: Trace, stretch: slice) -> Reading:
    """Choose the samples for the work over a part of a curve, J: trapezoids.

    Parameters
    ----------
    trace : one curve
    stretch : first and last time of its samples

    Raises
    ------
    UnavailableError
        ``gap`` if samples are missing, ``too_few_samples``.
    """
    min_loop_samples = 3
    force, displacement = trace.force[stretch], trace.displacement[stretch]
    if missing := int((np.isnan(displacement) | np.isnan(force)).sum()):
        raise UnavailableError.of("results.gap_in_cycle", count=missing)
    curves.require_samples(len(force), min_loop_samples, " in the cycle")
    # The error of trapezoids grows with the square of their width (Richardson).
    halves = np.append(np.arange(0, len(force) - 1, 2), len(force) - 1)
    coarse = integrate_energy(displacement[halves], force[halves])
    correction = (float(integrate_energy(displacement, force) - coarse) / 3.0,)
    return Reading(read_part(integrate_energy, stretch), len(force), sampling_correction=correction)


@dataclass(frozen=True, slots=True, kw_only=True)
class ResidualDisplacement(PerCycle):
    """``residual_displacement.<cycle>`` (m): displacement at zero force after unloading."""

    result: ClassVar = "residual-displacement"
    outputs: ClassVar = (
        Output(
            "residual_displacement", "m", "Residual displacement", first=1, can_be_negative=True
        ),
    )
    force_below: Force
    reads: ClassVar = (1.0, 2.0)

    method: ClassVar = (
        "displacement once the force is back at zero, within {force_below:g} N or less"
    )

    def choose(self, test: ReducedTest, trace: Trace, number: int) -> Reading:
        """Choose the samples at the end of unloading; on a smooth curve, as on the measured one."""
        measured_end = self._find_end(curves.make_trace(test), number) if trace.is_smooth else None
        ending, part = self._find_end(trace, number, measured_end), select_cycle(trace, number)[1]
        return Reading(read_part(ending.compute, slice(part.start, part.stop)), ending.n)

    def _find_end(
        self, trace: Trace, number: int, measured_end: UnloadingEnd | None = None
    ) -> UnloadingEnd:
        parts = cut_branch(trace, require_unloading(select_cycle(trace, number)))
        return find_unloading_end(*parts, force_below=self.force_below, measured_end=measured_end)


def cut_branch(trace: Trace, part: Branch) -> tuple[Floats, Floats, Floats]:
    """Return time (s), displacement (m) and force (N) of a branch.

    Parameters
    ----------
    trace : one curve
    part : branches of the cycle
    """
    branch = slice(part.start, part.stop)
    return trace.time[branch], trace.displacement[branch], trace.force[branch]


def estimate_rise_beyond_top(values: Floats, travel: Floats) -> float:
    """Estimate how far a curve may rise between its largest sample and the next one.

    At a turn of the motion, it rises up to the crossing of the lines through two samples on each
    side, and by at most half the smaller step beside the largest sample, because the corner is
    closer to this sample than to the next. If the motion continues and the fall exceeds three times
    the rise before it, the specimen breaks, and the curve may rise by as much once more. 0 at the
    ends of the samples and after a NaN.

    Parameters
    ----------
    values : shape (n,), of the quantity, positive in the direction of loading
    travel : shape (n,), displacement in the direction of loading
    """
    break_ratio = 3.0  # of the fall after the largest sample to the rise before it
    top = int(np.nanargmax(values))
    if not 0 < top < len(values) - 1:
        return 0.0
    step_before, step_after = values[top] - values[top - 1], values[top] - values[top + 1]
    is_break = travel[top + 1] > travel[top] and step_after > break_ratio * step_before
    beyond_top = step_before if is_break else 0.5 * min(step_before, step_after)
    if travel[top + 1] < travel[top] and 1 < top < len(values) - 2:
        rise, fall = values[top - 1] - values[top - 2], values[top + 1] - values[top + 2]
        if rise + fall > 0.0:
            steps = (values[top + 1] - values[top - 1] + fall - rise) / (rise + fall)
            crossing = values[top - 1] + rise * (1.0 + steps) - values[top]
            beyond_top = min(beyond_top, max(crossing, 0.0))
    return float(beyond_top) if np.isfinite(beyond_top) else 0.0


def choose_peak_sample(
    test: ReducedTest, trace: Trace, number: int, quantity: curves.Quantity = "force"
) -> Reading:
    """Choose the largest sample of a cycle in the direction of loading.

    Parameters
    ----------
    test : reduced test with all samples of the quantity
    trace, number : one curve, and a cycle of it
    quantity : whose largest sample

    Raises
    ------
    UnavailableError
        ``no_sample`` if all samples are NaN.
    """
    values: Floats = getattr(trace, quantity)
    sense, stretch = find_loading_sign(trace, values), find_cycle_samples(trace, number)
    signed_values = sense * values[stretch]
    if np.isnan(signed_values).all():
        raise UnavailableError.of("results.no_sample")
    travel = find_loading_sign(trace, trace.displacement) * trace.displacement[stretch]
    steps = 1.0  # sampling steps of the signal per sample of the curve
    if quantity == "force":
        curve_step, force_step = map(curves.compute_mean_step, (trace.time, test.force.time))
        steps = max(steps, curve_step / force_step)
    reach = estimate_rise_beyond_top(signed_values, travel) / steps

    def numbers(trace: Trace) -> tuple[Floats]:
        signed = sense * getattr(trace, quantity)[..., stretch]
        return (sense * (np.fmax.reduce(signed, axis=-1) + trace.steps_beyond * reach),)

    @cache
    def samples() -> curves.SampleNoise | None:
        peak = stretch.start + int(np.nanargmax(signed_values))
        return curves.SampleNoise.around(test, trace, quantity, stretch, peak)

    def in_noise(noisy_trace: Trace) -> tuple[Floats]:
        peak_samples = samples()
        if peak_samples is None:
            return numbers(noisy_trace)
        noise = getattr(noisy_trace, quantity) - values
        return (numbers(trace)[0] + peak_samples.compute_peak_effect(noise, sense),)

    return Reading(numbers, int((~np.isnan(signed_values)).sum()), in_noise)


@dataclass(frozen=True, slots=True, kw_only=True)
class PeakForce(PerCycle):
    """``peak_force.<cycle>`` (N): the largest force of a cycle."""

    result: ClassVar = "peak-force"
    outputs: ClassVar = (
        Output("peak_force", "N", "Peak force", ("force",), first=1, is_raised_by_slips=True),
    )
    complete_branches: ClassVar = 1
    reads: ClassVar = (0.0, 1.25)
    peak_of: ClassVar = "force"
    method: ClassVar = "largest force of the cycle after the filter, in the sense of loading"

    def choose(self, test: ReducedTest, trace: Trace, number: int) -> Reading:
        """Choose the largest sample of the force, of its own signal if that has another clock."""
        reading, signal = choose_peak_sample(test, trace, number), test.force
        if signal.clock == test.clocks.curve or trace.is_smooth:
            return reading
        stretch = find_cycle_samples(trace, number)
        ends = trace.time[[stretch.start, min(stretch.stop, len(trace.time)) - 1]]
        part = np.searchsorted(signal.time, test.clocks.from_curve(ends, signal.clock))
        sense = find_loading_sign(trace, trace.force)
        largest = np.fmax.reduce(sense * signal.values[slice(*part)], initial=-np.inf)
        return replace(reading, values=(sense * float(largest),))


@dataclass(frozen=True, slots=True, kw_only=True)
class PeakDisplacement(PerCycle):
    """``peak_displacement.<cycle>`` (m): the largest displacement of a cycle."""

    result: ClassVar = "peak-displacement"
    outputs: ClassVar = (
        Output(
            *("peak_displacement", "m", "Displacement at the peak", ("displacement",)),
            first=1,
            is_set_by_stroke=True,
        ),
    )
    complete_branches: ClassVar = 1
    reads: ClassVar = (0.9, 1.1)
    peak_of: ClassVar = "displacement"
    method: ClassVar = "largest displacement of the cycle, in the sense of loading"

    def choose(self, test: ReducedTest, trace: Trace, number: int) -> Reading:
        """Choose the largest sample of the displacement."""
        return choose_peak_sample(test, trace, number, "displacement")
