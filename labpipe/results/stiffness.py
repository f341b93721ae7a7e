"""Measure stiffnesses, results that are computed from stiffnesses, and machine compliance."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any, ClassVar, Literal

import numpy as np

from labpipe.records.arrays import Flags, Floats, Ints, Samples, convert_to_slice, divide
from labpipe.records.curve import Branch, FittedLine
from labpipe.records.declarations import (
    Distance,
    Force,
    Key,
    LargerThan,
    Length,
    Needs,
    Output,
    SnakeName,
    StiffnessName,
)
from labpipe.records.estimates import Failure, UnavailableError, return_failure
from labpipe.records.quality import Reason
from labpipe.results import curves, cycles, kinds
from labpipe.results.cycles import CycleKind
from labpipe.results.kinds import Kind, MeasuredItem, ReducedTest, Stiffness
from labpipe.signal.filters import compute_moving_average
from labpipe.uncertainty.autocorrelation import estimate_fast_noise, scale_limit_by_noise
from labpipe.uncertainty.intervals import MeasuredNumber
from labpipe.uncertainty.replicates import Extractor, Trace, combine_numbers, restrict

_MIN_FOOT_SAMPLES = 8
"""Smallest number of samples of the foot of the force."""
_MIN_DIVISOR_ERRORS = 3.0
"""Number of standard errors above which a divisor is distinguished from its noise."""


@dataclass(frozen=True, slots=True, eq=False)
class ForceOnset:
    """Rule that finds the onset of the force in a loading branch and in its replicates.

    Parameters
    ----------
    samples : samples of the branch that have a force and a displacement
    peak_index : index in `samples` of the largest force
    limit : N, limit of zero force: a force up to it counts as zero
    min_foot_samples : smallest number of samples of the foot of the force
    """

    samples: Samples
    peak_index: int
    limit: float
    min_foot_samples: int = _MIN_FOOT_SAMPLES

    def extrapolate_to_zero(self, values: Floats, force: Floats) -> tuple[Floats, Ints]:
        """Extrapolate the line through the foot of each curve to zero force.

        Parameters
        ----------
        values : shape (..., n), m or s, displacement or time of the branch
        force : shape (..., n), N; NaN in the same samples as the reference branch

        Returns
        -------
        zero : shape (...), value at zero force, in the unit of `values`; NaN if the line does not
            rise
        first : shape (...), index in `samples` of the first sample of the foot
        """
        x, f = np.broadcast_arrays(values[..., self.samples], force[..., self.samples])
        shape, (x, f) = f.shape[:-1], (rows.reshape(-1, f.shape[-1]) for rows in (x, f))
        limits = scale_limit_by_noise(self.limit, f)[:, np.newaxis]
        indices, n_samples = np.arange(f.shape[1]), f.shape[1]
        first = cycles.find_last_flagged((f <= limits) & (indices < self.peak_index)) + 1
        min_first = int(first.min())
        indices = indices[min_first:]
        is_beyond_foot = f[:, min_first:] > cycles.FOOT_LIMIT_FACTOR * limits
        is_beyond_foot &= indices >= first[:, None]
        stop = np.where(is_beyond_foot.any(1), min_first + np.argmax(is_beyond_foot, 1), n_samples)
        stop = np.maximum(stop, first + self.min_foot_samples)
        columns = slice(min_first, min(int(stop.max()), n_samples))
        indices = indices[: columns.stop - min_first]
        is_foot = (indices >= first[:, np.newaxis]) & (indices < stop[:, np.newaxis])
        mean_x, mean_f, slope = curves.fit_chosen_lines(is_foot, x[:, columns], f[:, columns])
        zero = mean_x - mean_f / np.where(slope > 0.0, slope, np.nan)
        return zero.reshape(shape), first.reshape(shape)

    def find_start(self, displacement: Floats, force: Floats) -> tuple[Floats, Ints]:
        """Find the displacement at zero force, and the first sample above zero.

        Parameters
        ----------
        displacement, force : shape (..., n), m, N, of the branch

        Returns
        -------
        start : shape (...), m, displacement at zero force; that of the first sample above zero if
            the line through the foot does not rise
        first_sample : shape (...), index of the first sample above zero in the branch
        """
        zero, first = self.extrapolate_to_zero(displacement, force)
        samples = self.samples
        first_sample = first + samples.start if isinstance(samples, slice) else samples[first]
        d = np.broadcast_to(displacement, (*first_sample.shape, displacement.shape[-1]))
        d_at_sample = np.take_along_axis(d, first_sample[..., np.newaxis], axis=-1)[..., 0]
        return np.where(np.isnan(zero), d_at_sample, zero), first_sample


def find_force_onset(
    displacement: Floats, force: Floats, *, limit: float | None = None, parts: int = 1
) -> ForceOnset:
    """Make the rule that finds the onset of the force in a loading branch.

    Parameters
    ----------
    displacement, force : shape (n,), m, N; one loading branch in order of time, evenly sampled; NaN
        are ignored
    limit : N, limit of zero force, for a curve without noise; None for a limit from the noise of
        the force
    parts : number of parts into which each sampling step is divided

    Returns
    -------
    The rule, with the samples and the limit of zero force of the branch.

    Raises
    ------
    UnavailableError
        ``too_few_samples`` (16 are needed), ``not_unloaded`` if the branch begins under a force
        too large for extrapolation, ``no_force`` if its force is never above the limit.

    Notes
    -----
    Without `limit`, a force up to four standard deviations of its fast noise counts as zero. The
    foot of the force begins after the last sample within the limit before the largest force, and
    ends at five times the limit. The foot has at least eight samples for each part of a sampling
    step. A straight line through the foot is extrapolated to zero force. For a force that rises
    from below zero, as after bending to the other side, the line interpolates the crossing of zero.
    Each curve has its own foot, and its own limit from its noise.

    Examples
    --------
    >>> d = np.linspace(0.0, 0.01, 400)
    >>> force = 500.0 * np.maximum(d - 0.002, 0.0)
    >>> zero, _ = find_force_onset(d, force).extrapolate_to_zero(d, force)
    >>> round(1e3 * float(zero), 6)
    2.0
    """
    noise_deviations = 4.0  # standard deviations of noise above which a force is not zero
    max_extrapolation_fraction = 0.02  # of the displacement of the branch
    finite_samples = curves.find_finite_samples(displacement, force)
    curves.require_samples(len(finite_samples), 2 * _MIN_FOOT_SAMPLES, "")
    d, f = displacement[finite_samples], force[finite_samples]
    limit = noise_deviations * float(estimate_fast_noise(f)) if limit is None else limit
    peak_index = int(np.argmax(f))
    if f[peak_index] <= limit:
        raise UnavailableError.of("results.no_force", largest=f[peak_index], limit=limit)
    samples, min_samples = convert_to_slice(finite_samples), parts * _MIN_FOOT_SAMPLES
    onset = ForceOnset(samples, peak_index, limit, min_samples)
    zero, first = onset.extrapolate_to_zero(displacement, force)
    if not first and not zero >= d[0] - max_extrapolation_fraction * float(np.ptp(d)):
        raise UnavailableError.of("results.not_unloaded", begin=f[0], limit=limit)
    return onset


_MIN_WINDOW_SAMPLES = 8
"""Smallest number of samples of a window."""
_START_FRACTION = 0.02
"""Fraction of the length of a window that is the start of the window."""
_STEADY_FRACTION = 0.1
"""Fraction of the length of a window up to which, from the start of the window on, the machine is
assumed to move at constant speed."""


@dataclass(frozen=True, slots=True, eq=False)
class WindowSlope:
    """Slope of force against displacement over a window of a path, with time as the instrument.

    Parameters
    ----------
    samples : shape (m,), samples of the branch that have a force and a displacement
    time : shape (m,), s, times of these samples
    path : shape (m,), m, moving average of the distance along the branch
    path_so_far : shape (m,), m, largest moving average up to each sample
    start, stop : m, ends of the window on the path
    """

    samples: Ints
    time: Floats
    path: Floats
    path_so_far: Floats
    start: float
    stop: float

    def select_window(
        self, shift: Floats | float = 0.0, first_sample: Ints | int = 0
    ) -> tuple[slice, Flags]:
        """Select the samples of the window, up to the first point at which the path leaves it.

        Parameters
        ----------
        shift : shape (...), m, shift of the window along the path
        first_sample : shape (...), first sample of the branch that the window may contain

        Returns
        -------
        index_range : range of indices in `samples` that contains all windows
        is_in_window : shape (..., indices in the range), whether the sample is in each window
        """
        start, stop = (np.add(end, shift) for end in (self.start, self.stop))
        first = np.searchsorted(self.path_so_far, start)
        last = np.searchsorted(self.path_so_far, stop, side="right")
        index_range = slice(int(first.min()), max(int(last.max()), int(first.min())))
        is_in_window: Flags = self.path[index_range] >= start[..., np.newaxis]
        is_in_window &= np.arange(index_range.start, index_range.stop) < last[..., np.newaxis]
        is_in_window &= self.samples[index_range] >= np.asarray(first_sample)[..., np.newaxis]
        return index_range, is_in_window

    @property
    def window_samples(self) -> Samples:
        """Samples of the branch within the window."""
        index_range, is_in_window = self.select_window()
        return convert_to_slice(self.samples[index_range][is_in_window])

    @property
    def n_samples(self) -> int:
        """Number of samples of the window."""
        return int(self.select_window()[1].sum())

    def compute_slope(
        self,
        displacement: Floats,
        force: Floats,
        shift: Floats | float = 0.0,
        first_sample: Ints | int = 0,
    ) -> Floats:
        """Compute the slope in the window of each curve, N/m, shape (...).

        The slope is NaN if the window has fewer than 8 samples, or if the displacement is constant.

        Parameters
        ----------
        displacement, force : shape (..., n), m, N, of the branch
        shift : shape (...), m, shift of the window along the path
        first_sample : shape (...), first sample of the branch that the window may contain
        """
        index_range, is_in_window = self.select_window(shift, first_sample)
        samples, time = convert_to_slice(self.samples[index_range]), self.time[index_range]
        n_samples = is_in_window.sum(axis=-1)
        n_samples = np.where(n_samples < _MIN_WINDOW_SAMPLES, 0, n_samples)
        mean_time = divide(np.asarray(is_in_window @ time), n_samples)
        weight = np.where(is_in_window, time - mean_time[..., np.newaxis], 0.0)
        rise, run = (np.vecdot(weight, values[..., samples]) for values in (force, displacement))
        return divide(rise, run)


def choose_window(
    time: Floats, displacement: Floats, force: Floats, path: Floats, *, start: float, stop: float
) -> WindowSlope:
    """Choose the samples of a branch for a stiffness.

    Parameters
    ----------
    time, displacement, force : shape (n,), s, m, N, of the branch; NaN where unknown
    path : shape (n,), m, distance along the branch that defines the window
    start, stop : m, ends of the window on the path

    Returns
    -------
    The slope over the window, for curves with the samples of this branch.

    Raises
    ------
    UnavailableError
        ``not_reached``, ``too_few_samples`` or ``no_travel``.

    Notes
    -----
    The window is cut from the path averaged over at most 11 samples, and ends where this average
    first exceeds `stop`, so that noise moves its ends little. With time as the instrument, the
    slope is k = sum (t - mean t) F / sum (t - mean t) d. The slope by ordinary least squares of F
    on a noisy displacement would be too small, by the fraction of the variance of the displacement
    that is noise (Fuller, Measurement Error Models, 1987, sec. 1.4).
    """
    smooth_path = compute_moving_average(path, window=min(11, len(path) - 1 + len(path) % 2))
    if not (smooth_path > stop).any():
        reached = float(np.max(smooth_path, where=~np.isnan(smooth_path), initial=-np.inf))
        raise UnavailableError.of("results.path_not_reached", reached=reached, needed=stop)
    path_so_far = np.maximum.accumulate(np.where(np.isnan(smooth_path), -np.inf, smooth_path))
    samples = curves.find_finite_samples(displacement, force)
    paths = smooth_path[samples], path_so_far[samples]
    slope = WindowSlope(samples, time[samples], *paths, start, stop)
    curves.require_samples(slope.n_samples, _MIN_WINDOW_SAMPLES)
    curves.require_travel(displacement[slope.window_samples])
    return slope


def choose_turn_samples(trace: Trace, branch: Branch) -> Callable[[Floats], Floats]:
    """Choose the samples for values at the turn at which a branch starts.

    Parameters
    ----------
    trace : one curve; NaN of its displacement are ignored
    branch : the branch, which may include a part of the rest before the turn

    Returns
    -------
    A function that computes the values at the turn, shape (...), from values of shape (..., n). A
    parabola is fitted to the first tenth of the branch after the turn, at most 50 samples. If fewer
    than 8 of these have a displacement, the function returns the values of the first sample of the
    branch.
    """
    start = max(branch.start, int(np.searchsorted(trace.time, branch.start_time)))
    first_tenth = np.arange(start, start + min(50, (branch.stop - start) // 10))
    first_tenth = first_tenth[~np.isnan(trace.displacement[first_tenth])]
    if len(first_tenth) < _MIN_WINDOW_SAMPLES:
        return lambda values: np.asarray(values[..., branch.start])
    samples, time = convert_to_slice(first_tenth), trace.time[first_tenth] - branch.start_time
    weights = curves.compute_polynomial_weights(time, degree=2)[0]
    return lambda values: np.asarray(np.vecdot(values[..., samples], weights))


@dataclass(frozen=True, slots=True, eq=False)
class LoadingSlope:
    """Stiffness over a length after the onset of the force.

    Parameters
    ----------
    onset : rule that finds the onset of the force in the branch
    first_taut_sample : first sample of the branch in which the specimen counts as taut
    slope : slope over the window, for the branch from the first taut sample on
    window_distance : m, mean displacement in the window, less the displacement at the onset
    """

    onset: ForceOnset
    first_taut_sample: int
    slope: WindowSlope
    window_distance: float

    def compute_slope(self, displacement: Floats, force: Floats, has_noise: bool = False) -> Floats:
        """Compute the stiffness of each curve, N/m, shape (...), or NaN.

        Parameters
        ----------
        displacement, force : shape (..., n), m, N; the window of each curve begins at the onset of
            its force
        has_noise : whether noise hides a part of the foot. A curve then counts as taut from its
            first sample above zero
        """
        start, first_sample = self.onset.find_start(displacement, force)
        first = np.maximum(first_sample - self.first_taut_sample, 0) if has_noise else 0
        d, f = (values[..., self.first_taut_sample :] for values in (displacement, force))
        shift = start + self.window_distance - d[..., self.slope.window_samples].mean(axis=-1)
        return self.slope.compute_slope(d, f, shift, first)

    @property
    def start_sample_fraction(self) -> float:
        """Fraction of the samples of the window that are in the first fiftieth of its length.

        The fraction is large if the motion rests there while the force is above its noise.
        """
        index_range, is_in_window = self.slope.select_window()
        path = self.slope.path[index_range][is_in_window]
        start_length = _START_FRACTION * (self.slope.stop - self.slope.start)
        return float((path <= path.min() + start_length).mean())


def choose_loading_window(
    time: Floats,
    displacement: Floats,
    force: Floats,
    *,
    length: float,
    limit: float | None = None,
    parts: int = 1,
) -> LoadingSlope:
    """Choose the samples for the stiffness of a loading branch.

    Parameters
    ----------
    time, displacement, force : shape (n,), s, m, N, of the branch; NaN where unknown
    length : m, length of the window after the onset of the force
    limit : N, limit of zero force, for a curve without noise; None for a limit from the noise of
        the force
    parts : number of parts into which each sampling step is divided

    Returns
    -------
    The onset of the force, and the samples of the window.

    Raises
    ------
    UnavailableError
        As `find_force_onset` or `choose_window`.

    Notes
    -----
    A branch counts as taut from the first sample whose force is above its noise. A branch without
    noise counts as taut from the zero of the line through the foot of the force. The difference is
    an effect of noise. If sampling steps are divided, the branch counts as taut only after the
    machine has begun to move, because samples at rest with a force above the noise would shift the
    line.
    """
    onset = find_force_onset(displacement, force, limit=limit, parts=parts)
    zero, first_sample = onset.find_start(displacement, force)
    start, first = float(zero), int(first_sample)
    if limit is not None and not np.isnan(onset.extrapolate_to_zero(displacement, force)[0]):
        zero_time = float(onset.extrapolate_to_zero(time, force)[0])
        first = min(int(np.searchsorted(time, zero_time)), first)
    travel = displacement - start
    is_steady = (travel >= _START_FRACTION * length) & (travel <= _STEADY_FRACTION * length)
    if parts > 1 and is_steady.sum() > 1:
        # A machine of constant speed passes the onset at this time.
        start_time = float(curves.compute_zero_crossing(time[is_steady], travel[is_steady]))
        first = max(first, 0 if np.isnan(start_time) else int(np.searchsorted(time, start_time)))
    path, stop = displacement[first:], start + length
    slope = choose_window(time[first:], path, force[first:], path, start=start, stop=stop)
    return LoadingSlope(onset, first, slope, float(path[slope.window_samples].mean()) - start)


def choose_unloading_window(
    trace: Trace, branch: Branch, *, length: float, sense: float
) -> tuple[Callable[[Floats, Floats], Floats], int]:
    """Choose the samples for the stiffness after a turn.

    Parameters
    ----------
    trace : one curve
    branch : the branch that begins with the turn
    length : m, length of the window after the turn; its first tenth, where the motion turns, is
        excluded
    sense : 1 if loading increases the displacement, else -1

    Returns
    -------
    compute_stiffness : function of displacement and force of curves, shape (..., n), m, N, that
        returns the stiffness, shape (...), N/m, or NaN. The distance of the window from the turn is
        the same in all curves
    n_samples : number of samples of the window

    Raises
    ------
    UnavailableError
        As `choose_window`.
    """
    compute_at_turn, samples = choose_turn_samples(trace, branch), slice(branch.start, branch.stop)
    start = float(compute_at_turn(trace.displacement))
    time, d, f = cycles.cut_branch(trace, branch)
    slope = choose_window(time, d, f, sense * (start - d), start=0.1 * length, stop=length)
    window_distance = float(d[slope.window_samples].mean()) - start

    def compute_stiffness(displacement: Floats, force: Floats) -> Floats:
        d, f = displacement[..., samples], force[..., samples]
        distance = d[..., slope.window_samples].mean(axis=-1) - compute_at_turn(displacement)
        return slope.compute_slope(d, f, sense * (distance - window_distance))

    return compute_stiffness, slope.n_samples


MIN_LINE_SAMPLES = 5
"""Smallest number of samples of a straight line."""


def find_compliance_window(
    displacement: Floats, force: Floats, *, start: float, stop: float
) -> Samples:
    """Find the samples over which the force first rises from one value to another.

    Parameters
    ----------
    displacement, force : shape (n,), m, N; the loading branch of a stiff-bar test; NaN
        are ignored
    start, stop : N, ends of the range of force; below it, grips and joints settle

    Returns
    -------
    The samples of the window.

    Raises
    ------
    UnavailableError
        ``too_few_samples``, ``no_travel`` if the force is constant, ``not_reached`` if it does not
        reach `stop`.
    """
    finite_samples = curves.find_finite_samples(displacement, force)
    f = force[finite_samples]
    if len(f) == 0 or float(f.max()) < stop:
        largest = float(f.max()) if len(f) else 0.0
        raise UnavailableError.of("results.force_not_reached", largest=largest, stop=stop)
    last = int(np.argmax(f >= stop))
    low_samples = np.flatnonzero(f[:last] < start)
    window_samples = finite_samples[int(low_samples[-1]) + 1 if len(low_samples) else 0 : last + 1]
    curves.require_samples(len(window_samples), MIN_LINE_SAMPLES)
    curves.require_travel(force[window_samples], "force")
    return convert_to_slice(window_samples)


class UnloadingStiffness(CycleKind):
    """``unloading_stiffness.<cycle>`` (N/m): slope just after each turn."""

    result: ClassVar = "unloading-stiffness"
    outputs: ClassVar = (
        Output("unloading_stiffness", "N/m", "Unloading stiffness", first=1, is_slope=True),
    )
    over: Length
    branch_range: ClassVar = (1.0, 2.0)

    method: ClassVar = (
        "line over {over_mm:g} mm off the peak without its first tenth, time as instrument"
    )

    def choose_samples(self, test: ReducedTest, trace: Trace, cycle: int) -> Extractor:
        """Choose the samples in the length `over` after the turn, without its first tenth."""
        del test
        branch = cycles.require_unloading(cycles.select_branches(trace, cycle))
        sense = cycles.find_loading_sign(trace, trace.displacement)
        compute, n_samples = choose_unloading_window(trace, branch, length=self.over, sense=sense)
        return Extractor(restrict(compute, slice(None)), n_samples)


class LoadingStiffness(CycleKind):
    """``loading_stiffness.<cycle>`` (N/m): slope just after the onset of the force."""

    result: ClassVar = "loading-stiffness"
    outputs: ClassVar = (
        Output("loading_stiffness", "N/m", "Loading stiffness", first=1, is_slope=True),
    )
    over: Length
    branch_range: ClassVar = (0.0, 1.0)

    method: ClassVar = "line over {over_mm:g} mm from the onset of the force, time as instrument"

    def choose_samples(self, test: ReducedTest, trace: Trace, cycle: int) -> Extractor:
        """Choose the samples after the onset, with the force limit of the measured curve."""
        measured = curves.make_trace(test)
        limit = self._choose_window(measured, cycle).onset.limit if trace.is_smooth else None
        window = self._choose_window(trace, cycle, limit)
        branch = cycles.select_branches(trace, cycle)[0]
        samples = slice(branch.start, branch.stop)
        compute = restrict(window.compute_slope, samples)
        compute_noisy = restrict(partial(window.compute_slope, has_noise=True), samples)
        return Extractor(compute, window.slope.n_samples, compute_noisy, ends_at_samples=True)

    def list_doubts(self, test: ReducedTest, branches: list[Branch]) -> tuple[Reason, ...]:
        """List further doubts, one if over 10 % of the samples are in a fiftieth of the window."""
        # At constant speed, a fiftieth of the samples is there; the limit is five times as many.
        window = return_failure(self._choose_window)(curves.make_trace(test), branches[0].cycle)
        doubts = super().list_doubts(test, branches)
        if isinstance(window, Failure) or window.start_sample_fraction <= 0.1:
            return doubts
        fraction, limit = window.start_sample_fraction, window.onset.limit
        return (*doubts, Reason.of("results.rest_in_window", share=fraction, limit=limit))

    def _choose_window(self, trace: Trace, cycle: int, limit: float | None = None) -> LoadingSlope:
        """Choose the samples for the stiffness of a cycle on a curve."""
        columns = cycles.cut_branch(trace, cycles.select_branches(trace, cycle)[0])
        parts = trace.parts_per_step
        return choose_loading_window(*columns, length=self.over, limit=limit, parts=parts)


class Hardening(Kind):
    """``hardening.<cycle>`` (1): ``loading_stiffness`` of a later cycle over that of the first."""

    result: ClassVar = "hardening"
    outputs: ClassVar = (Output("hardening", "1", "Hardening", first=2),)
    over: Length

    method: ClassVar = (
        "slope over {over_mm:g} mm from the onset of the force / that of cycle 1, scale cancelled"
    )

    def measure(self, test: ReducedTest) -> Iterator[MeasuredItem]:
        """Measure the ratio of each later cycle to the first one, in which the scale cancels."""
        first_cycle, *later_cycles = test.require(test.cycles or None)
        stiffness = LoadingStiffness(over=self.over)
        choose_first = partial(stiffness.choose_samples, test, cycle=1)
        first = return_failure(test.measure_number)(choose_first)
        first_doubts = stiffness.list_doubts(test, first_cycle)

        @return_failure
        def measure_ratio(cycle: int) -> MeasuredNumber:
            if isinstance(first, Failure):
                raise UnavailableError.of("results.no_first_stiffness", why=first.message)
            if first.value <= _MIN_DIVISOR_ERRORS * first.error:
                raise UnavailableError.of("results.first_stiffness_is_noise", value=first.value)
            choose = partial(stiffness.choose_samples, test, cycle=cycle)
            ratio = combine_numbers(lambda _, x, first: divide(x, first), choose, choose_first)
            return test.measure_number(ratio)

        for later_cycle in later_cycles:
            loading = later_cycle[0]
            doubts = first_doubts + stiffness.list_doubts(test, later_cycle)
            period, suffix = (first_cycle[0].start_time, loading.stop_time), f".{loading.cycle}"
            hardening = measure_ratio(loading.cycle)
            yield self.make_result(test, hardening, doubts=doubts, period=period, suffix=suffix)


class RangeKind(Kind):
    """A kind of result that is measured over a range of displacement of the first loading."""

    start: Annotated[Distance, Key("from")]
    stop: Annotated[Distance, Key("to"), LargerThan("start", "from")]

    def select_samples(self, trace: Trace) -> slice:
        """Select the samples of the first loading from `start` until it first exceeds `stop`.

        Parameters
        ----------
        trace : one curve

        Raises
        ------
        UnavailableError
            ``not_reached`` if the loading ends before `stop`, or begins beyond `start` by more than
            2 % of the range.
        """
        loading, start, stop = curves.select_first_loading(trace), self.start, self.stop
        displacement = trace.displacement[loading]
        d = displacement[~np.isnan(displacement)]
        if not len(d) or d.max() < stop:
            reached = 1e3 * float(d.max()) if len(d) else float("nan")
            raise UnavailableError.of("results.not_reached", reached=reached, needed=1e3 * stop)
        if d[0] > start + 0.02 * (stop - start):
            begin = 1e3 * d[0]
            raise UnavailableError.of("results.begins_later", begin=begin, needed=1e3 * start)
        first, last = int(np.argmax(displacement >= start)), int(np.argmax(displacement > stop))
        return slice(loading.start + first, loading.start + (last or len(displacement)))


def _choose_secant_window(trace: Trace, start: float, stop: float) -> Extractor:
    """Choose the samples for the stiffness between two displacements of the first loading."""
    branch = trace.branches[0]
    time, displacement, force = cycles.cut_branch(trace, branch)
    slope = choose_window(time, displacement, force, displacement, start=start, stop=stop)
    window, samples = slope.window_samples, slice(branch.start, branch.stop)
    mean_displacement = displacement[window].mean()

    def compute_noisy_stiffness(d: Floats, f: Floats) -> Floats:
        return slope.compute_slope(d, f, mean_displacement - d[..., window].mean(axis=-1))

    compute = restrict(slope.compute_slope, samples)
    compute_noisy = restrict(compute_noisy_stiffness, samples)
    return Extractor(compute, slope.n_samples, compute_noisy, ends_at_samples=True)


class InitialStiffness(RangeKind):
    """``initial_stiffness`` (N/m): slope at the start of the first loading."""

    result: ClassVar = "initial-stiffness"
    outputs: ClassVar = (Output("initial_stiffness", "N/m", "Initial stiffness", is_slope=True),)
    method: ClassVar = (
        "line from {start_mm:g} mm to {stop_mm:g} mm of the first loading, time as instrument"
    )

    def measure(self, test: ReducedTest) -> Iterator[MeasuredItem]:
        """Measure the slope of force against displacement, with time as the instrument."""
        window = self.start, self.stop
        choose_samples = partial(_choose_secant_window, start=self.start, stop=self.stop)
        outcome, period = test.measure_number(choose_samples), test.find_loading_period(*window)
        doubts, method = kinds.find_pause_doubts(test, window), InitialStiffness.method
        result = self.make_result(test, outcome, method=method, period=period, doubts=doubts)
        yield result
        yield Stiffness(result.name, choose_samples, outcome.value, period, window, doubts=doubts)


class LineStiffness(InitialStiffness):
    """``<name>`` (N/m): straight line over a window of the first loading."""

    result: ClassVar = "stiffness"
    outputs: ClassVar = (Output("{name}", "N/m", is_slope=True),)
    method: ClassVar = (
        "straight line from {start_mm:g} mm to {stop_mm:g} mm of the first loading, "
        "interval for correlated noise"
    )
    name: Annotated[SnakeName, "Such as stiffness_first"] = "stiffness"

    def measure(self, test: ReducedTest) -> Iterator[MeasuredItem]:
        """Fit a least-squares line or, for a test with a shape, a line with time as instrument."""
        if test.shape is not None:
            yield from super().measure(test)
            return
        slope, curve = test.measure_number(self.choose_samples), curves.make_trace(test)
        samples = self.select_finite_samples(curve)
        d, f = curve.displacement[samples], curve.force[samples]
        slip_range = start, stop = float(d.min()), float(d.max())
        start_force = float(f.mean()) + slope.value * (start - float(d.mean()))
        period = test.find_loading_period(start, stop)
        pause_doubts = kinds.find_pause_doubts(test, slip_range)
        doubts = kinds.find_slip_doubts(test, slip_range) + pause_doubts
        if slope.value <= 0.0:
            doubts = (Reason.of("results.negative_slope"), *doubts)
        yield self.make_result(test, slope, period=period, doubts=doubts)
        window = max(start, 0.0), stop
        yield Stiffness(
            self.name, self.choose_samples, slope.value, period, window, slip_range, pause_doubts
        )
        yield FittedLine(self.name, slope.value, start_force, start, stop)

    def select_finite_samples(self, trace: Trace) -> Ints:
        """Select the samples in the window that have a force and a displacement.

        Parameters
        ----------
        trace : one curve
        """
        window = self.select_samples(trace)
        finite_samples = curves.find_finite_samples(trace.displacement[window], trace.force[window])
        return np.asarray(window.start + finite_samples)

    def choose_samples(self, trace: Trace) -> Extractor:
        """Choose the samples for the slope of the line over the window.

        Parameters
        ----------
        trace : one curve
        """
        samples = self.select_finite_samples(trace)
        curves.require_samples(len(samples), MIN_LINE_SAMPLES)
        curves.require_travel(trace.displacement[samples])
        slope = restrict(curves.compute_slope, convert_to_slice(samples))
        return Extractor(slope, len(samples), ends_at_samples=True)


class DerivedKind(Kind):
    """A kind of result that is computed from a stiffness above it in the list."""

    of: Annotated[StiffnessName, "Name of a stiffness above, such as stiffness_first"]

    @abstractmethod
    def measure_outcome(self, test: ReducedTest, stiffness: Stiffness) -> kinds.Outcome:
        """Measure the value of a test from a stiffness.

        Parameters
        ----------
        test : reduced test
        stiffness : the stiffness with the name `of`
        """

    def collect_context(self, test: ReducedTest, stiffness: Stiffness) -> dict[str, Any]:
        """Collect further arguments of `Kind.make_result`: period, doubts, remark."""
        del test, stiffness
        return {}

    def measure(self, test: ReducedTest) -> Iterator[MeasuredItem]:
        """Measure the value from the stiffness."""
        missing = Failure.of("results.no_stiffness", name=self.of)
        stiffness = test.require(test.stiffnesses.get(self.of), missing)
        outcome = return_failure(self.measure_outcome)(test, stiffness)
        context = {"period": stiffness.period, **self.collect_context(test, stiffness)}
        slip_doubts = kinds.find_slip_doubts(test, stiffness.slip_range)
        context["doubts"] = slip_doubts + stiffness.doubts + context.get("doubts", ())
        yield self.make_result(test, outcome, **context)


class NormalisedStiffness(DerivedKind):
    """``<of>_per_peak_force`` (1/m): a stiffness over the largest force of the same test."""

    result: ClassVar = "normalised-stiffness"
    outputs: ClassVar = (Output("{of}_per_peak_force", "1/m"),)
    needs: ClassVar = Needs()
    method: ClassVar = (
        "{of} / peak force of the same sample, errors independent, scale error cancelled"
    )

    def collect_context(self, test: ReducedTest, stiffness: Stiffness) -> dict[str, Any]:
        """Return the period up to the last peak, and a doubt if the record ends earlier."""
        last_loading, period = test.cycles[-1][:1], stiffness.period
        period = period and (period[0], max(period[1], last_loading[0].stop_time))
        return {"period": period, "doubts": cycles.find_truncation_doubts(test, last_loading)}

    def measure_outcome(self, test: ReducedTest, stiffness: Stiffness) -> kinds.Outcome:
        """Measure a stiffness over the largest force of all cycles; the scale of force cancels."""
        trace = curves.make_trace(test)
        peaks = []
        for cycle in range(1, len(test.cycles) + 1):
            force = trace.force[cycles.find_cycle_samples(trace, cycle)]
            peaks.append((float(np.fmax.reduce(force, initial=-np.inf)), cycle))
        _, peak_cycle = max(peaks)  # the last one of equal peaks
        choose_peak = partial(cycles.choose_peak_sample, test, cycle=peak_cycle)
        peak_force = test.measure_number(choose_peak)
        if peak_force.value <= _MIN_DIVISOR_ERRORS * peak_force.error:
            raise UnavailableError.of("results.no_peak_force", peak=peak_force.value)
        choices = stiffness.choose_samples, choose_peak
        return test.measure_number(combine_numbers(lambda _, x, peak: x / peak, *choices))


class Modulus(DerivedKind):
    """``<name>`` (Pa): stiffness x gauge length / area."""

    result: ClassVar = "modulus"
    outputs: ClassVar = (Output("{name}", "Pa", is_slope=True),)
    needs: ClassVar = Needs()
    method: ClassVar = "{of} x specimen.length / area ({area})"
    area: Annotated[
        Literal["stated", "rectangle", "annulus", "thin-wall"],
        "The area of specimen.section that the modulus refers to",
    ]
    name: Annotated[SnakeName, "Such as modulus_annulus"] = "modulus"

    def measure_outcome(self, test: ReducedTest, stiffness: Stiffness) -> kinds.Outcome:
        """Measure the modulus with the uncertainties of stiffness, gauge length and area."""
        if "length" not in test.setup.sizes:
            raise UnavailableError.of("results.no_gauge_length")
        compute_area(test.setup.sizes, self.area)
        return test.measure_number(combine_numbers(self._compute_modulus, stiffness.choose_samples))

    def _compute_modulus(self, trace: Trace, stiffness: Floats) -> Floats:
        """Compute the modulus, Pa; NaN if the area of a replicate is not positive."""
        area = return_failure(compute_area)(trace.sizes, self.area)
        area = np.nan if isinstance(area, Failure) else area
        return np.asarray(stiffness * trace.sizes["length"] / area, dtype=np.float64)

    def collect_context(self, test: ReducedTest, stiffness: Stiffness) -> dict[str, Any]:
        """Return a doubt if a part of the displacement may be that of frame and grips."""
        return {"doubts": kinds.find_compliance_doubts(test, stiffness.value)}


_AREAS: Mapping[str, tuple[tuple[str, ...], Callable[..., float]]] = {
    "stated": (("area",), lambda area: area),
    "rectangle": (("width", "thickness"), lambda width, thickness: width * thickness),
    "annulus": (
        ("outer_diameter", "inner_diameter"),
        lambda outer, inner: 0.25 * np.pi * (outer**2 - inner**2),
    ),
    "thin-wall": (("outer_diameter", "wall"), lambda outer, wall: np.pi * (outer - wall) * wall),
    "circle": (("outer_diameter",), lambda outer: 0.25 * np.pi * outer**2),
}
"""Keys of the sizes in the protocol, and the function that computes the area of a section from
these sizes, by the kind of area.

The diameters of a corrugated tube include the height of its folds, so the areas of annulus and thin
wall differ. A modulus must therefore state to which area it refers.
"""


def compute_area(sizes: Mapping[str, float], kind: str = "") -> float:
    """Compute the area of a section, m^2, from its sizes.

    Parameters
    ----------
    sizes : sizes of the specimen, m (area: m^2), by the keys of the protocol
    kind : kind of area, a key of `_AREAS`; empty for the first one whose sizes are all stated

    Raises
    ------
    UnavailableError
        ``no_area`` without a complete set of sizes, or if the area is not positive.
    """
    for area_kind in [kind] if kind else _AREAS:
        names, compute = _AREAS[area_kind]
        if not all(name in sizes for name in names):
            continue
        area = compute(*(sizes[name] for name in names))
        if not area > 0.0:
            raise UnavailableError.of("results.bad_area", kind=area_kind, area=area)
        return area
    missing = "specimen.section.area, or its width and thickness, or outer_diameter"
    if kind:
        missing = " and ".join(f"specimen.section.{name}" for name in _AREAS[kind][0])
    raise UnavailableError.of("results.no_area", missing=missing)


class ComplianceResult(Kind):
    """``compliance`` (m/N): compliance of frame and grips, from a test of a stiff bar."""

    result: ClassVar = "compliance"
    outputs: ClassVar = (Output("compliance", "m/N", "Compliance of frame and grips"),)
    start: Annotated[Force, Key("from")]
    stop: Annotated[Force, Key("to"), LargerThan("start", "from")]
    method: ClassVar = (
        "displacement against force from {start:g} N to {stop:g} N, the bar assumed rigid"
    )

    def measure(self, test: ReducedTest) -> Iterator[MeasuredItem]:
        """Measure the slope of displacement against force; the bar is assumed rigid."""
        compliance = test.measure_number(self.choose_samples)
        yield self.make_result(test, compliance, period=test.find_loading_period())

    def choose_samples(self, trace: Trace) -> Extractor:
        """Choose the samples for the slope of displacement against force over the window.

        Parameters
        ----------
        trace : one curve
        """
        loading = curves.select_first_loading(trace)
        d, f = trace.displacement[loading], trace.force[loading]
        window = find_compliance_window(d, f, start=self.start, stop=self.stop)
        samples = np.arange(loading.start, loading.stop)[window]
        compute = restrict(lambda d, f: curves.compute_slope(f, d), convert_to_slice(samples))
        if (compliance := float(compute(trace)[0])) <= 0.0:
            raise UnavailableError.of("results.not_positive", slope=compliance)
        return Extractor(compute, len(samples), ends_at_samples=True)
