"""Measure results of each cycle: peak force and displacement, energy, residual displacement."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache, lru_cache, partial
from itertools import pairwise
from typing import ClassVar, Literal

import numpy as np

from labpipe.records.arrays import Flags, Floats, Ints, convert_to_slice, divide, drop_missing
from labpipe.records.curve import Branch, Curve, Direction
from labpipe.records.declarations import CURVE_QUANTITIES, Force, Output
from labpipe.records.estimates import UnavailableError, return_failure
from labpipe.records.quality import Reason
from labpipe.records.signals import Stretch
from labpipe.results import curves, kinds
from labpipe.results.kinds import Kind, MeasuredItem, ReducedTest
from labpipe.uncertainty.autocorrelation import estimate_fast_noise, scale_limit_by_noise
from labpipe.uncertainty.replicates import Extractor, Trace, restrict


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
    return np.asarray(0.5 * np.vecdot(steps, force))


FOOT_LIMIT_FACTOR = 5.0
"""Multiple of the limit of zero force up to which the foot of the force is assumed straight."""
_FIT_TIME_BEFORE_ZERO = 1.0
"""Time before zero force over which a line is fitted to the displacement, s."""
_MIN_CROSSING_SAMPLES = 8
"""Smallest number of samples of a fit to the force or the displacement at zero force."""
_MIN_FORCE_FOOT_SAMPLES = 4
"""Smallest number of samples of the foot of the force."""


@dataclass(frozen=True, slots=True, eq=False)
class UnloadingEnd:
    """The end of an unloading, with the samples for its residual displacement.

    Parameters
    ----------
    kind : ``through zero``: the force continues below zero; ``at rest``: the string is slack and
        the displacement constant; ``extrapolated``: the foot of the force is extrapolated to zero
    limit : N, limit of zero force: a force up to it counts as zero
    n : number of samples from which the displacement is computed
    compute : function of displacements and forces of the branch, shape (..., n), that returns the
        displacement at zero force, m, shape (...); NaN for a curve whose force does not return to
        zero
    """

    kind: Literal["through zero", "at rest", "extrapolated"]
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
    """Find the end of an unloading, and the samples for the displacement at zero force.

    Parameters
    ----------
    time, displacement, force : one unloading branch, shape (n,), s, m, N; NaN are ignored
    force_below : N, limit of zero force. It is reduced to a fiftieth of the largest force, then
        raised to four standard deviations of the noise, if necessary
    measured_end : end of the measured branch, for a smooth branch without noise; else None

    Returns
    -------
    The end, with the function that computes the displacement.

    Raises
    ------
    UnavailableError
        ``force_not_zero`` if the branch ends before the force is zero; ``too_few_samples`` if a fit
        has too few samples.

    Notes
    -----
    There are three cases.

    1. The force continues below zero. Parabolas through force and displacement, over a tenth of the
       branch on each side, give the time of zero force and the displacement at that time.
    2. The string becomes slack and the displacement is constant. The mean of the displacement is
       used. This case has two conditions. By the end of the branch, the line through the foot of
       the force falls below zero by more than three times the limit. From 0.2 s after zero force
       on, the force stays within twice the limit and the displacement within its noise.
    3. In all other cases, the line through the foot of the force is extrapolated to zero. The
       displacement is extrapolated along a line through the last second before zero force, because
       it may have a kink there. The foot is chosen for each curve.
    """
    max_limit_fraction = 0.02  # of the largest force
    noise_deviations = 4.0  # standard deviations of noise above which a force is not zero
    finite_samples = curves.find_finite_samples(displacement, force)
    t, d, f = (values[finite_samples] for values in (time, displacement, force))
    curves.require_samples(len(f), 2 * _MIN_CROSSING_SAMPLES, "")
    lowest_limit = min(force_below, max_limit_fraction * float(f.max()))
    limit = max(noise_deviations * float(estimate_fast_noise(f)), lowest_limit)
    limit = limit if measured_end is None else measured_end.limit
    samples_above = np.flatnonzero(f > limit)
    if len(samples_above) == 0:
        raise UnavailableError.of("results.none_above_limit", count=len(f), limit=limit)
    if samples_above[-1] >= len(f) - 3:
        raise UnavailableError.of("results.force_not_zero", end=f[-3:].mean(), limit=limit)
    kind = None if measured_end is None else measured_end.kind
    if kind is None and np.median(f[-_MIN_CROSSING_SAMPLES:]) < -limit:
        kind = "through zero"
    if kind == "through zero":
        return _choose_zero_crossing(finite_samples, t, f, limit)
    last_time = float(t[samples_above[-1]])
    zero_times, slopes, _ = _extrapolate_foot(t - last_time, f[np.newaxis], np.array([[limit]]))
    zero_time = last_time + float(zero_times[0])
    is_after_zero = t > zero_time + 0.2
    has_fallen_through = slopes[0] * (t[-1] - zero_time) < -3.0 * limit
    if kind is None and has_fallen_through and _is_resting(t, d, f, is_after_zero, limit):
        kind = "at rest"
    if kind == "at rest" and is_after_zero.any():
        rest, n_samples = convert_to_slice(finite_samples[is_after_zero]), int(is_after_zero.sum())
        return UnloadingEnd(kind, limit, n_samples, lambda d, _: np.mean(d[..., rest], axis=-1))
    n_samples = int(((t >= zero_time - _FIT_TIME_BEFORE_ZERO) & (t <= zero_time)).sum())
    if n_samples < _MIN_CROSSING_SAMPLES:
        raise UnavailableError.of("results.few_before_zero", count=n_samples, zero=zero_time)
    compute = partial(_extrapolate_to_zero, finite_samples, t - last_time, (limit, lowest_limit))
    return UnloadingEnd("extrapolated", limit, n_samples, compute)


def _extrapolate_foot(time: Floats, force: Floats, limits: Floats) -> tuple[Floats, Floats, Ints]:
    """Extrapolate the foot of the force of each row to zero.

    Parameters
    ----------
    time : shape (n,), s
    force : shape (rows, n), N
    limits : shape (rows, 1), N, limit of zero force of each row

    Returns
    -------
    zero_times : shape (rows,), s, time of zero force
    slopes : shape (rows,), N/s, slope of the foot. For a foot that does not fall, or has fewer than
        four samples, the slope is 0 and the time is that of the last sample above the limit
    last : shape (rows,), index of the last sample above the limit, or -1
    """
    first, last = (find_last_flagged(force > x) for x in (FOOT_LIMIT_FACTOR * limits, limits))
    columns = slice(max(int(first.min()), 0), max(int(last.max()), 0) + 1)
    indices = np.arange(columns.start, columns.stop)
    is_foot = (indices >= first[:, np.newaxis]) & (indices <= last[:, np.newaxis])
    mean_t, mean_f, slope = curves.fit_chosen_lines(is_foot, time[columns], force[:, columns])
    is_falling = (slope < 0.0) & (is_foot.sum(axis=1) >= _MIN_FORCE_FOOT_SAMPLES)
    zero_times = np.where(is_falling, mean_t - divide(mean_f, slope), time[last])
    return zero_times, np.where(is_falling, slope, 0.0), last


def _choose_zero_crossing(indices: Ints, time: Floats, force: Floats, limit: float) -> UnloadingEnd:
    """Choose the samples around the zero crossing of a force that continues below zero.

    `time` and `force` are those of the samples of the branch with these indices.
    """
    crossing_time = time[min(int((force > 0.0).sum()), len(time) - 1)]
    is_near_crossing = np.abs(time - crossing_time) <= 0.1 * (time[-1] - time[0])
    curves.require_samples(int(is_near_crossing.sum()), _MIN_CROSSING_SAMPLES, " near zero force")
    samples = convert_to_slice(indices[is_near_crossing])
    near_time = time[is_near_crossing] - crossing_time
    weights = curves.compute_polynomial_weights(near_time, degree=2).T

    def compute(displacement: Floats, force: Floats) -> Floats:
        level, slope, curvature = np.moveaxis(force[..., samples] @ weights, -1, 0)
        zero_time = np.zeros_like(level)
        for _ in range(4):  # Newton steps, from near the root
            rate = slope + 2.0 * zero_time * curvature
            step = divide(level + zero_time * (slope + zero_time * curvature), rate)
            zero_time = np.clip(zero_time - step, near_time[0], near_time[-1])
        position, speed, acceleration = np.moveaxis(displacement[..., samples] @ weights, -1, 0)
        return np.asarray(position + zero_time * (speed + zero_time * acceleration))

    return UnloadingEnd("through zero", limit, len(near_time), compute)


def _is_resting(t: Floats, d: Floats, f: Floats, is_after_zero: Flags, limit: float) -> bool:
    """Return whether the force stays within twice the limit and the displacement within noise."""
    if is_after_zero.sum() < _MIN_CROSSING_SAMPLES or np.abs(f[is_after_zero]).max() > 2.0 * limit:
        return False
    centred_time, values = t[is_after_zero] - t[is_after_zero].mean(), d[is_after_zero]
    slope = float(curves.compute_slope(centred_time, values))
    noise = values - values.mean() - slope * centred_time
    noise_limit = 3.0 * float(noise.std()) + 1e-9 * float(np.ptp(d))
    return abs(slope) * float(np.ptp(centred_time)) <= noise_limit


def _extrapolate_to_zero(
    finite_samples: Ints,
    time: Floats,
    limits_of_zero: tuple[float, float],
    displacement: Floats,
    force: Floats,
) -> Floats:
    """Compute the displacement at which the extrapolated foot of each curve is zero.

    The displacement is NaN if the force does not return to zero, or if too few samples precede zero
    force. `time` has the values at the finite samples, and `limits_of_zero` are the limits of zero
    force (N) with and without noise.
    """
    samples, (limit, lowest_limit) = convert_to_slice(finite_samples), limits_of_zero
    d, f = np.broadcast_arrays(displacement[..., samples], force[..., samples])
    shape, (d, f) = f.shape[:-1], (values.reshape(-1, len(time)) for values in (d, f))
    limits = np.full((len(f), 1), limit)
    if limit > lowest_limit:
        limits = np.maximum(scale_limit_by_noise(limit, f), lowest_limit)[:, np.newaxis]
    zero_times, _, last = _extrapolate_foot(time, f, limits)
    ends = [zero_times.min() - _FIT_TIME_BEFORE_ZERO, zero_times.max() + _FIT_TIME_BEFORE_ZERO]
    columns = slice(*np.searchsorted(time, ends))
    t, start = time[columns], zero_times[:, np.newaxis] - _FIT_TIME_BEFORE_ZERO
    is_before_zero = (t >= start) & (t <= zero_times[:, np.newaxis])
    mean_t, mean_d, slope = curves.fit_chosen_lines(is_before_zero, t, d[:, columns])
    has_reached_zero = (last >= 0) & (last < len(time) - 3)
    has_reached_zero &= is_before_zero.sum(axis=1) >= _MIN_CROSSING_SAMPLES
    return np.where(has_reached_zero, mean_d + slope * (zero_times - mean_t), np.nan).reshape(shape)


def find_last_flagged(flags: Flags) -> Ints:
    """Find the index of the last flagged sample of each row; -1 for a row without a flag.

    Parameters
    ----------
    flags : shape (..., n), n >= 1
    """
    last: Ints = flags.shape[-1] - 1 - np.argmax(flags[..., ::-1], axis=-1)
    return np.where(flags.any(axis=-1), last, -1)


class CycleKind(Kind):
    """A kind of result with one number for each cycle of the curve."""

    n_complete_branches: ClassVar[int] = 0
    """Number of branches of a cycle, from the first, that must be complete."""
    branch_range: ClassVar[tuple[float, float]] = (0.0, 2.0)
    """Part of a cycle on which the number depends, counted in branches: 0.9 is nine tenths of the
    loading, 1 the end of loading, 2 the end of unloading."""
    peak_quantity: ClassVar[curves.Quantity | None] = None
    """Quantity on whose largest sample the number depends."""

    @abstractmethod
    def choose_samples(self, test: ReducedTest, trace: Trace, cycle: int) -> Extractor:
        """Choose the samples of a cycle on a curve.

        Parameters
        ----------
        test : reduced test, for facts that do not depend on the curve
        trace : one curve
        cycle : number of the cycle, from 1
        """

    def list_doubts(self, test: ReducedTest, branches: list[Branch]) -> tuple[Reason, ...]:
        """List further doubts: noise or a gap at a peak, or a force that leads the displacement."""
        curve, doubts = test.required_curve, tuple[Reason, ...]()
        if "displacement" in self.outputs[0].depends_on:
            doubts = find_lead_doubts(curve)
        if self.peak_quantity is None:
            return doubts
        values = getattr(curve, self.peak_quantity)
        cycle_values = values[find_cycle_samples(curve, branches[0].cycle)]
        signed_values = find_loading_sign(curve, values) * cycle_values
        doubts += find_noise_doubts(signed_values, self.peak_quantity)
        peak = int(np.argmax(np.nan_to_num(signed_values, nan=-np.inf)))
        is_missing = np.isnan(cycle_values[max(peak - 1, 0) : peak + 2])
        if is_missing.all() or not is_missing.any():
            return doubts
        return (*doubts, Reason.of("results.gap_at_peak", quantity=self.peak_quantity))

    def measure(self, test: ReducedTest) -> Iterator[MeasuredItem]:
        """Measure the number of each cycle."""
        for branches in test.require(test.cycles or None):
            cycle, complete_branches = branches[0].cycle, branches[: self.n_complete_branches]
            choose_samples = partial(self.choose_samples, test, cycle=cycle)
            outcome = return_failure(test.measure_number)(choose_samples)
            doubts = find_truncation_doubts(test, complete_branches, self.outputs[0].depends_on)
            doubts += self.list_doubts(test, branches)
            period, suffix = _find_period(branches, *self.branch_range), f".{cycle}"
            yield self.make_result(test, outcome, period=period, doubts=doubts, suffix=suffix)


def find_noise_doubts(values: Floats, quantity: str) -> tuple[Reason, ...]:
    """Find a doubt ``noise_at_peak`` if a signal is much noisier beside its peak than elsewhere.

    Parameters
    ----------
    values : shape (n,), positive in the direction of loading; NaN are ignored
    quantity : name of the quantity

    Notes
    -----
    The noise of ten samples is the median magnitude of their third differences, on which smooth
    bends and single steps have little effect. The noise beside the peak is that of the noisier
    side; after a break, a specimen vibrates, and only the side before the peak counts. It is
    compared with the noise that nine tenths of the stretches farther than 30 samples from the peak
    do not exceed, so that serrated flow over a large part of a curve causes no doubt.
    """
    width, min_distance, min_stretches, max_ratio, min_fraction = 10, 30, 5, 8.0, 0.01
    values = drop_missing(values)
    bends = np.abs(np.diff(values, 3))
    stretches = bends[: len(bends) // width * width].reshape(-1, width)
    peak = int(np.argmax(values)) if len(values) else 0
    distances = np.abs(width * (np.arange(len(stretches)) + 0.5) - peak)
    usual_bends = np.median(stretches, axis=1)[distances > min_distance]
    sides = [bends[max(peak - width, 0) : max(peak - 2, 0)], bends[peak : peak + width - 2]]
    is_broken = len(values) > 0 and values[peak : peak + width].min() < 0.5 * values[peak]
    nearby = [np.median(side) for side in sides[: 1 if is_broken else 2] if len(side) >= width // 2]
    if len(usual_bends) < min_stretches or not nearby or not bends.any():
        return ()
    # The steps of a converter are at least as large as its smallest bends.
    usual = max(float(np.quantile(usual_bends, 0.9)), float(np.median(bends[bends > 0.0])))
    if not max(nearby) > max(max_ratio * usual, min_fraction * float(values[peak])):
        return ()
    return (Reason.of("results.noise_at_peak", quantity=quantity, ratio=max(nearby) / usual),)


@lru_cache(maxsize=1)  # the kinds of results and the cycles of a test ask for the same curve
def find_lead_doubts(curve: Curve) -> tuple[Reason, ...]:
    """Find a doubt ``force_leads`` if the force turns before the displacement, and more sharply.

    Parameters
    ----------
    curve : one curve

    Notes
    -----
    A specimen in which the force relaxes or falls may turn first at the end of loading, but not at
    both ends of a loop. A viscous specimen in a sinusoidal motion does, but its force turns as
    smoothly as the motion. The sharpness of a turn is the change of the rate within three samples
    over that within a tenth of a branch: 1 for a corner, and at most 1/2 for a sine.
    """
    reach, min_lead, min_sharpness, min_difference, min_noise_ratio = 3, 2, 0.7, 0.4, 8.0
    force, d = (find_loading_sign(curve, x) * x for x in (curve.force, curve.displacement))
    leads, min_samples = dict[Direction, list[int]](), 30
    branch_samples = [branch.stop - branch.start for branch in curve.branches]
    if min(branch_samples) < min_samples or len(drop_missing(force)) < min_samples:
        return ()
    noise = float(estimate_fast_noise(drop_missing(force)))
    for branch, next_branch in pairwise(curve.branches):
        sign = 1.0 if branch.direction is Direction.LOADING else -1.0
        shorter = min(branch.stop - branch.start, next_branch.stop - next_branch.start)
        width, search = max(shorter // 10, 2 * reach), shorter // 5
        start = max(next_branch.start - search - width, 0)
        samples = slice(start, next_branch.start + search + width + 1)
        f, x = sign * force[samples], sign * d[samples]
        force_turn, turn = (width + int(np.argmax(values[width:-width])) for values in (f, x))
        # Changes of the rates within the reach, and within the width.
        bend, travel_bend, whole_bend, whole_travel_bend = (
            float(2.0 * values[i] - values[i - step] - values[i + step]) / step
            for values, i, step in (
                *((f, force_turn, reach), (x, force_turn, reach)),
                *((f, force_turn, width), (x, turn, width)),
            )
        )
        is_clear = bend * reach > min_noise_ratio * noise and min(whole_bend, whole_travel_bend) > 0
        if not is_clear:
            return ()
        sharpness, travel_sharpness = bend / whole_bend, travel_bend / whole_travel_bend
        is_sharp = sharpness > max(min_sharpness, travel_sharpness + min_difference)
        leads.setdefault(branch.direction, []).append((turn - force_turn) * is_sharp)
    if len(leads) < 2 or min(map(min, leads.values())) < min_lead:
        return ()
    return (Reason.of("results.force_leads", lead=np.median(np.concatenate([*leads.values()]))),)


def _find_period(branches: list[Branch], start: float, stop: float) -> Stretch | None:
    """Find the times at which a part of a cycle starts and stops.

    `start` and `stop` are counted in branches, as in `CycleKind.branch_range`. The period is None
    for a part that starts after the last branch of the cycle.
    """
    if start >= len(branches):
        return None
    times = []
    for position, index in ((start, int(start)), (stop, math.ceil(stop) - 1)):
        branch = branches[min(index, len(branches) - 1)]
        fraction = position - index if index < len(branches) else 1.0
        times.append(branch.start_time + fraction * (branch.stop_time - branch.start_time))
    return times[0], times[1]


def find_truncation_doubts(
    test: ReducedTest, branches: list[Branch], quantities: tuple[str, ...] = ("force",)
) -> tuple[Reason, ...]:
    """Find a doubt if the record ends before the branches of a result are complete.

    There is no doubt if the specimen fails in the last of these branches. There is also none for a
    number that depends only on the force, if the force has already fallen below 90 % of its peak in
    that branch.

    Parameters
    ----------
    test : reduced test with the ends of its records
    branches : branches that must be complete
    quantities : quantities on which the number depends
    """
    cut_time = min((test.cut_times.get(name, np.inf) for name in quantities), default=np.inf)
    if not branches or cut_time == np.inf:
        return ()
    last, failure, curve = branches[-1], test.failure, test.required_curve
    if cut_time >= last.stop_time and last is not curve.branches[-1]:
        return ()
    if isinstance(failure, kinds.FailurePoint) and last.start <= failure.sample < last.stop:
        return ()  # the specimen broke, so the record is complete
    if quantities == ("force",):
        force = find_loading_sign(curve, curve.force) * curve.force[last.start : last.stop]
        force = drop_missing(force)
        if len(force) and force[-3:].max() < 0.9 * force.max():
            return ()
    end_text = f"{cut_time:.3f} s" if curve.time_unit == "s" else f"sample {round(cut_time) + 1}"
    return (Reason.of("results.partial_cycle", end=end_text, direction=last.direction),)


def find_cycle_samples(curve: Curve | Trace, cycle: int) -> slice:
    """Find the samples of a cycle from its first turn to its last turn, both included.

    A rest between two cycles is divided at its extreme displacement. If the last loading has no
    unloading, the cycle includes the hold after the loading, up to the last sample with a force.

    Parameters
    ----------
    curve : one curve
    cycle : number of the cycle, from 1
    """
    indices = [index for index, branch in enumerate(curve.branches) if branch.cycle == cycle]
    first, last_branch = indices[0], curve.branches[indices[-1]]
    start = _find_turn_before(curve, first) if first else curve.branches[first].start
    if indices[-1] + 1 < len(curve.branches):
        return slice(start, _find_turn_before(curve, indices[-1] + 1) + 1)
    if last_branch.direction is Direction.UNLOADING:
        return slice(start, last_branch.stop)
    force_stop = int(np.flatnonzero(~np.isnan(curve.force)).max(initial=0)) + 1
    return slice(start, max(force_stop, last_branch.stop))


def _find_turn_before(curve: Curve | Trace, branch_index: int) -> int:
    """Find the sample of the turn before a branch that is not the first one."""
    previous, branch = curve.branches[branch_index - 1 : branch_index + 1]
    rest = curve.displacement[previous.stop : branch.start + 1]
    rest = find_loading_sign(curve, curve.displacement) * rest
    if np.isnan(rest).all():
        return branch.start
    is_after_loading = previous.direction is Direction.LOADING
    return previous.stop + int(np.nanargmax(rest) if is_after_loading else np.nanargmin(rest))


def find_loading_sign(curve: Curve | Trace, values: Floats) -> float:
    """Find the sign of the change of a quantity in the first branch of a curve.

    Parameters
    ----------
    curve : one curve
    values : shape (n,), values of the quantity
    """
    branch = curve.branches[0]
    return kinds.compute_loading_sign(values[branch.start : branch.stop])


def select_branches(trace: Trace, cycle: int) -> list[Branch]:
    """Select the branches of a cycle of a curve, in order of time.

    Parameters
    ----------
    trace : one or many curves
    cycle : number of the cycle, from 1
    """
    return [branch for branch in trace.branches if branch.cycle == cycle]


WORK_QUANTITIES = (*CURVE_QUANTITIES, "start")
"""Quantities on which the work up to a point of the curve depends."""


class Energy(CycleKind):
    """``energy.<cycle>`` (J): energy dissipated in one cycle."""

    result: ClassVar = "energy"
    outputs: ClassVar = (
        Output("energy", "J", "Energy dissipated", WORK_QUANTITIES, 1, is_raised_by_slips=True),
    )
    n_complete_branches: ClassVar = 2
    method: ClassVar = "integral of force, trapezoids"

    def choose_samples(self, test: ReducedTest, trace: Trace, cycle: int) -> Extractor:
        """Choose the samples for the integral of the force over a cycle."""
        del test
        require_unloading(select_branches(trace, cycle))
        return choose_work_samples(trace, find_cycle_samples(trace, cycle))


def require_unloading(branches: list[Branch]) -> Branch:
    """Return the unloading branch of a cycle.

    Parameters
    ----------
    branches : branches of the cycle

    Raises
    ------
    UnavailableError
        ``partial_cycle`` if the cycle has no unloading branch.
    """
    if len(branches) < 2:
        raise UnavailableError.of("results.no_unloading")
    return branches[1]


def choose_work_samples(trace: Trace, samples: slice) -> Extractor:
    """Choose the samples for the work over a part of a curve, J, by trapezoids.

    Parameters
    ----------
    trace : one curve
    samples : samples of the part

    Raises
    ------
    UnavailableError
        ``gap`` if samples are missing; ``too_few_samples`` if the part has fewer than three.
    """
    min_loop_samples = 3
    force, displacement = trace.force[samples], trace.displacement[samples]
    if missing := int((np.isnan(displacement) | np.isnan(force)).sum()):
        raise UnavailableError.of("results.gap_in_cycle", count=missing)
    curves.require_samples(len(force), min_loop_samples, " in the cycle")
    # The error of trapezoids is in proportion to the square of their width (Richardson).
    coarse_samples = np.append(np.arange(0, len(force) - 1, 2), len(force) - 1)
    coarse_work = integrate_energy(displacement[coarse_samples], force[coarse_samples])
    correction = (float(integrate_energy(displacement, force) - coarse_work) / 3.0,)
    compute = restrict(integrate_energy, samples)
    return Extractor(compute, len(force), sampling_correction=correction)


class ResidualDisplacement(CycleKind):
    """``residual_displacement.<cycle>`` (m): displacement at zero force after unloading."""

    result: ClassVar = "residual-displacement"
    outputs: ClassVar = (
        Output(
            "residual_displacement", "m", "Residual displacement", first=1, can_be_negative=True
        ),
    )
    force_below: Force
    branch_range: ClassVar = (1.0, 2.0)

    method: ClassVar = (
        "displacement at zero force after unloading, within {force_below:g} N or less"
    )

    def choose_samples(self, test: ReducedTest, trace: Trace, cycle: int) -> Extractor:
        """Choose the samples at the end of unloading; the measured curve sets the kind of end."""
        measured_end = self._find_end(curves.make_trace(test), cycle) if trace.is_smooth else None
        end, branch = self._find_end(trace, cycle, measured_end), select_branches(trace, cycle)[1]
        return Extractor(restrict(end.compute, slice(branch.start, branch.stop)), end.n)

    def _find_end(
        self, trace: Trace, cycle: int, measured_end: UnloadingEnd | None = None
    ) -> UnloadingEnd:
        """Find the end of the unloading of a cycle on a curve."""
        record = cut_branch(trace, require_unloading(select_branches(trace, cycle)))
        return find_unloading_end(*record, force_below=self.force_below, measured_end=measured_end)


def cut_branch(trace: Trace, branch: Branch) -> tuple[Floats, Floats, Floats]:
    """Cut time (s), displacement (m) and force (N) of a branch from a curve.

    Parameters
    ----------
    trace : one curve
    branch : branch of the curve
    """
    samples = slice(branch.start, branch.stop)
    return trace.time[samples], trace.displacement[samples], trace.force[samples]


def estimate_rise_beyond_peak(values: Floats, travel: Floats) -> float:
    """Estimate how far a curve may rise between its largest sample and the next one.

    Parameters
    ----------
    values : shape (n,), values of the quantity, positive in the direction of loading
    travel : shape (n,), m, displacement in the direction of loading

    Returns
    -------
    The rise, in the unit of the quantity; 0 if the largest sample is at an end of the samples, or
    if a sample beside it is NaN.

    Notes
    -----
    At a turn of the motion, the curve rises to the intersection of the lines through two samples on
    each side. It rises by at most half the smaller change beside the largest sample, because the
    corner is closer to this sample than to the next. If the motion continues and the fall after the
    largest sample exceeds three times the rise before it, the specimen breaks. The curve may then
    rise by as much as in the step before.
    """
    min_break_ratio = 3.0  # fall after the largest sample over the rise before it
    peak = int(np.nanargmax(values))
    if not 0 < peak < len(values) - 1:
        return 0.0
    rise_before, fall_after = values[peak] - values[peak - 1], values[peak] - values[peak + 1]
    is_break = travel[peak + 1] > travel[peak] and fall_after > min_break_ratio * rise_before
    max_rise = rise_before if is_break else 0.5 * min(rise_before, fall_after)
    if travel[peak + 1] < travel[peak] and 1 < peak < len(values) - 2:
        rise, fall = values[peak - 1] - values[peak - 2], values[peak + 1] - values[peak + 2]
        if rise + fall > 0.0:
            n_steps = (values[peak + 1] - values[peak - 1] + fall - rise) / (rise + fall)
            corner_rise = values[peak - 1] + rise * (1.0 + n_steps) - values[peak]
            max_rise = min(max_rise, max(corner_rise, 0.0))
    return float(max_rise) if np.isfinite(max_rise) else 0.0


def choose_peak_sample(
    test: ReducedTest, trace: Trace, cycle: int, quantity: curves.Quantity = "force"
) -> Extractor:
    """Choose the largest sample of a cycle in the direction of loading.

    Parameters
    ----------
    test : reduced test with all samples of the quantity
    trace : one curve
    cycle : number of the cycle, from 1
    quantity : quantity whose largest sample is chosen

    Raises
    ------
    UnavailableError
        ``no_sample`` if all samples are NaN.
    """
    values: Floats = getattr(trace, quantity)
    sign, samples = find_loading_sign(trace, values), find_cycle_samples(trace, cycle)
    signed_values = sign * values[samples]
    if np.isnan(signed_values).all():
        raise UnavailableError.of("results.no_sample")
    travel = find_loading_sign(trace, trace.displacement) * trace.displacement[samples]
    steps_per_sample = 1.0  # sampling steps of the signal per sample of the curve
    if quantity == "force":
        curve_step, force_step = map(curves.compute_mean_step, (trace.time, test.force.time))
        steps_per_sample = max(steps_per_sample, curve_step / force_step)
    rise_beyond = estimate_rise_beyond_peak(signed_values, travel) / steps_per_sample

    def compute_peak(trace: Trace) -> tuple[Floats]:
        signed_curves = sign * getattr(trace, quantity)[..., samples]
        rise = trace.steps_to_event * rise_beyond
        return (sign * (np.fmax.reduce(signed_curves, axis=-1) + rise),)

    @cache
    def select_noise() -> curves.SampleNoise | None:
        peak = samples.start + int(np.nanargmax(signed_values))
        return curves.SampleNoise.select(test, trace, quantity, samples, peak)

    def compute_with_noise(noisy_trace: Trace) -> tuple[Floats]:
        sample_noise = select_noise()
        if sample_noise is None:
            return compute_peak(noisy_trace)
        noise = getattr(noisy_trace, quantity) - values
        return (compute_peak(trace)[0] + sample_noise.draw_peak_effect(noise, sign),)

    return Extractor(compute_peak, int((~np.isnan(signed_values)).sum()), compute_with_noise)


class PeakForce(CycleKind):
    """``peak_force.<cycle>`` (N): the largest force of a cycle."""

    result: ClassVar = "peak-force"
    outputs: ClassVar = (
        Output("peak_force", "N", "Peak force", ("force",), first=1, is_raised_by_slips=True),
    )
    n_complete_branches: ClassVar = 1
    branch_range: ClassVar = (0.0, 1.25)
    peak_quantity: ClassVar = "force"
    method: ClassVar = "largest force of the cycle after the filter, in the sense of loading"

    def choose_samples(self, test: ReducedTest, trace: Trace, cycle: int) -> Extractor:
        """Choose the largest sample of the force, from its own signal if that has another clock."""
        extractor, signal = choose_peak_sample(test, trace, cycle), test.force
        if signal.clock == test.clocks.curve_clock or trace.is_smooth:
            return extractor
        samples = find_cycle_samples(trace, cycle)
        ends = trace.time[[samples.start, min(samples.stop, len(trace.time)) - 1]]
        signal_ends = np.searchsorted(signal.time, test.clocks.from_curve(ends, signal.clock))
        sign = find_loading_sign(trace, trace.force)
        largest = np.fmax.reduce(sign * signal.values[slice(*signal_ends)], initial=-np.inf)
        return replace(extractor, values=(sign * float(largest),))


class PeakDisplacement(CycleKind):
    """``peak_displacement.<cycle>`` (m): the largest displacement of a cycle."""

    result: ClassVar = "peak-displacement"
    outputs: ClassVar = (
        Output(
            *("peak_displacement", "m", "Displacement at the peak", ("displacement",), 1),
            is_set_by_stroke=True,
        ),
    )
    n_complete_branches: ClassVar = 1
    branch_range: ClassVar = (0.9, 1.1)
    peak_quantity: ClassVar = "displacement"
    method: ClassVar = "largest displacement of the cycle, in the sense of loading"

    def choose_samples(self, test: ReducedTest, trace: Trace, cycle: int) -> Extractor:
        """Choose the largest sample of the displacement."""
        return choose_peak_sample(test, trace, cycle, "displacement")
