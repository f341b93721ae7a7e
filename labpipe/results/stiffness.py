"""Stiffnesses of the first loading and of cycles, results from them, and machine compliance."""

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
    Snake,
    StiffnessName,
)
from labpipe.records.estimates import Failure, UnavailableError, return_failure
from labpipe.records.quality import Reason
from labpipe.results import curves, cycles, kinds
from labpipe.results.cycles import PerCycle
from labpipe.results.kinds import Kind, Part, ReducedTest, Stiffness
from labpipe.signal.filters import compute_moving_average
from labpipe.uncertainty.autocorrelation import estimate_fast_noise, scale_limit_by_noise
from labpipe.uncertainty.intervals import Measured
from labpipe.uncertainty.replicates import Reading, Trace, combine_numbers, read_part

_MIN_FOOT_SAMPLES = 8


@dataclass(frozen=True, slots=True, eq=False)
class ForceOnset:
    """Where the force of a loading branch begins, for curves with the samples of one branch.

    Parameters
    ----------
    samples : samples of the branch that have a force and a displacement
    top : number among them of the largest force
    limit : N, up to which a force counts as zero
    min_samples : smallest number of samples of the foot of the force
    """

    samples: Samples
    top: int
    limit: float
    min_samples: int = _MIN_FOOT_SAMPLES

    def find(self, values: Floats, force: Floats) -> tuple[Floats, Ints]:
        """Find the zero of the line through the foot of each curve, and the foot's first sample.

        Parameters
        ----------
        values, force : shape (..., n), m or s, and N, of the branch; noise hides a part of the
            foot of each curve. NaN in the same samples as the reference branch

        Returns
        -------
        Zero, shape (...), in the unit of `values`, NaN if the line does not rise; and number of the
        sample among `samples`, same shape.
        """
        x, f = np.broadcast_arrays(values[..., self.samples], force[..., self.samples])
        shape, (x, f) = f.shape[:-1], (rows.reshape(-1, f.shape[-1]) for rows in (x, f))
        limit = scale_limit_by_noise(self.limit, f)[:, np.newaxis]
        numbers, count = np.arange(f.shape[1]), f.shape[1]
        first = cycles.find_last_flagged((f <= limit) & (numbers < self.top)) + 1
        low = int(first.min())
        numbers = numbers[low:]
        beyond = (f[:, low:] > cycles.FOOT_LIMIT_FACTOR * limit) & (numbers >= first[:, np.newaxis])
        last = np.where(beyond.any(1), low + np.argmax(beyond, 1), count)
        last = np.maximum(last, first + self.min_samples)
        part = slice(low, min(int(last.max()), count))
        numbers = numbers[: part.stop - low]
        foot = (numbers >= first[:, np.newaxis]) & (numbers < last[:, np.newaxis])
        middle, level, slope = curves.fit_chosen_lines(foot, x[:, part], f[:, part])
        zero = middle - level / np.where(slope > 0.0, slope, np.nan)
        return zero.reshape(shape), first.reshape(shape)

    def compute(self, displacement: Floats, force: Floats) -> tuple[Floats, Ints]:
        """Return the displacement at zero force, and the first sample of the branch above zero.

        Parameters
        ----------
        displacement, force : shape (..., n), m, N, of the branch

        Returns
        -------
        Displacement, m, and number of the sample in the branch, shape (...) each. If the line does
        not rise, the displacement is that of the sample.
        """
        zero, first = self.find(displacement, force)
        samples = self.samples
        sample = first + samples.start if isinstance(samples, slice) else samples[first]
        paths = np.broadcast_to(displacement, (*sample.shape, displacement.shape[-1]))
        begins = np.take_along_axis(paths, sample[..., np.newaxis], axis=-1)[..., 0]
        return np.where(np.isnan(zero), begins, zero), sample


def find_force_onset(
    displacement: Floats, force: Floats, *, limit: float | None = None, steps: int = 1
) -> ForceOnset:
    """Find the samples of a loading branch that determine where its force begins.

    Parameters
    ----------
    displacement, force : shape (n,), m, N; one loading branch in order of time, evenly sampled; NaN
        are ignored
    limit : N, up to which a force counts as zero, for a curve without noise; None for a limit from
        the noise of the force
    steps : number of parts into which each sampling step has been divided

    Returns
    -------
    The samples.

    Raises
    ------
    UnavailableError
        ``too_few_samples`` (16 are needed), ``not_unloaded`` if the branch begins under a force
        too large for extrapolation, ``no_force`` if its force is never above the limit.

    Notes
    -----
    Without `limit`, a force up to four standard deviations of its fast noise counts as zero. The
    foot of the force begins after the last sample within the limit before the largest force, and
    ends at five times the limit. A straight line through the foot (at least eight samples per part
    of a sampling step) is extrapolated to zero force. If the force comes from below zero, as after
    bending to the other side, the line interpolates the crossing of zero. Each curve has its own
    foot, and a limit by its own noise.

    Examples
    --------
    >>> d = np.linspace(0.0, 0.01, 400)
    >>> force = 500.0 * np.maximum(d - 0.002, 0.0)
    >>> zero, _ = find_force_onset(d, force).find(d, force)
    >>> round(1e3 * float(zero), 6)
    2.0
    """
    noise_deviations = 4.0  # standard deviations of noise above which a force is not zero
    max_extrapolation = 0.02  # share of the branch
    finite = curves.find_finite_samples(displacement, force)
    curves.require_samples(len(finite), 2 * _MIN_FOOT_SAMPLES, "")
    d, f = displacement[finite], force[finite]
    limit = noise_deviations * float(estimate_fast_noise(f)) if limit is None else limit
    top = int(np.argmax(f))
    if f[top] <= limit:
        raise UnavailableError.of("results.no_force", largest=f[top], limit=limit)
    onset = ForceOnset(convert_to_slice(finite), top, limit, steps * _MIN_FOOT_SAMPLES)
    zero, first = onset.find(displacement, force)
    if not first and not zero >= d[0] - max_extrapolation * float(np.ptp(d)):
        raise UnavailableError.of("results.not_unloaded", begin=f[0], limit=limit)
    return onset


_MIN_WINDOW_SAMPLES = 8


_START_SHARE, _STEADY_SHARE = 0.02, 0.1
"""Shares of a window: up to the first is its start; from there to the second, speed is constant."""


@dataclass(frozen=True, slots=True, eq=False)
class WindowSlope:
    """Slope of force against displacement over a window of a path; time is the instrument.

    Parameters
    ----------
    samples : shape (m,), of the branch, with a force and a displacement
    time : shape (m,), s
    path, furthest : shape (m,), m, averaged path along the branch, and its largest value so far
    low, high : m, ends of the window
    """

    samples: Ints
    time: Floats
    path: Floats
    furthest: Floats
    low: float
    high: float

    def inside(self, shift: Floats | float = 0.0, since: Ints | int = 0) -> tuple[slice, Flags]:
        """Return the samples of the window, up to where the path first leaves it.

        Parameters
        ----------
        shift : m, shape (...), of the window along the path
        since : shape (...), first sample of the branch that it may contain

        Returns
        -------
        Range of the samples that contains all windows, and a mask of each window in it, shape (...,
        range).
        """
        low, high = (np.asarray(end + shift) for end in (self.low, self.high))
        start = np.searchsorted(self.furthest, low)
        stop = np.searchsorted(self.furthest, high, side="right")
        stretch = slice(int(start.min()), max(int(stop.max()), int(start.min())))
        is_in: Flags = self.path[stretch] >= low[..., np.newaxis]
        is_in &= np.arange(stretch.start, stretch.stop) < stop[..., np.newaxis]
        return stretch, is_in & (self.samples[stretch] >= np.asarray(since)[..., np.newaxis])

    @property
    def window(self) -> Samples:
        """Return the samples of the branch within the window."""
        stretch, is_in_window = self.inside()
        return convert_to_slice(self.samples[stretch][is_in_window])

    @property
    def n(self) -> int:
        """Return the number of samples of the window."""
        return int(self.inside()[1].sum())

    def compute(
        self,
        displacement: Floats,
        force: Floats,
        shift: Floats | float = 0.0,
        since: Ints | int = 0,
    ) -> Floats:
        """Return the slope, N/m, shape (...); NaN for fewer than 8 samples, or without travel.

        Parameters
        ----------
        displacement, force : shape (..., n), m, N, of the branch
        shift, since : shape (...), as for `inside`
        """
        stretch, is_in_window = self.inside(shift, since)
        samples, time = convert_to_slice(self.samples[stretch]), self.time[stretch]
        count = is_in_window.sum(axis=-1)
        enough = np.where(count < _MIN_WINDOW_SAMPLES, 0, count)
        middle = divide(np.asarray(is_in_window @ time), enough)
        weight = np.where(is_in_window, time - middle[..., np.newaxis], 0.0)
        rise, run = (np.vecdot(weight, values[..., samples]) for values in (force, displacement))
        return divide(rise, run)


def choose_window(
    time: Floats, displacement: Floats, force: Floats, path: Floats, *, low: float, high: float
) -> WindowSlope:
    """Choose the samples of a branch for a stiffness.

    Parameters
    ----------
    time, displacement, force : shape (n,), s, m, N, of the branch; NaN where unknown
    path : shape (n,), m, along the branch
    low, high : m, of the path

    Returns
    -------
    The window.

    Raises
    ------
    UnavailableError
        ``not_reached``, ``too_few_samples`` or ``no_travel``.

    Notes
    -----
    The window is cut from the path averaged over at most 11 samples, and ends where the path first
    leaves it, so that noise moves its ends little. k = sum (t - mean t) F / sum (t - mean t) d:
    time is the instrument, because ordinary least squares of F on a noisy displacement is too small
    (by the ratio of noise variance to variance; Fuller, Measurement Error Models, 1987, sec. 1.4).
    """
    travelled = compute_moving_average(path, window=min(11, len(path) - 1 + len(path) % 2))
    if not (travelled > high).any():
        reached = float(np.max(travelled, where=~np.isnan(travelled), initial=-np.inf))
        raise UnavailableError.of("results.path_not_reached", reached=reached, needed=high)
    furthest = np.maximum.accumulate(np.where(np.isnan(travelled), -np.inf, travelled))
    samples = curves.find_finite_samples(displacement, force)
    fit = WindowSlope(samples, time[samples], travelled[samples], furthest[samples], low, high)
    curves.require_samples(fit.n, _MIN_WINDOW_SAMPLES)
    curves.require_travel(displacement[fit.window])
    return fit


def choose_turn_samples(trace: Trace, part: Branch) -> Callable[[Floats], Floats]:
    """Choose the samples for values at the turn at which a branch starts.

    Parameters
    ----------
    trace : one curve; NaN of its displacement are ignored
    part : the branch, which may contain a part of the wait before the turn

    Returns
    -------
    A function of values of shape (..., n) that returns those at the turn, shape (...): of the
    parabola through the first tenth of the branch after the turn, at most 50 samples. If fewer
    than 8 of them are known, the value of the first sample of the branch.
    """
    start = max(part.start, int(np.searchsorted(trace.time, part.start_time)))
    begin = np.arange(start, start + min(50, (part.stop - start) // 10))
    begin = begin[~np.isnan(trace.displacement[begin])]
    if len(begin) < _MIN_WINDOW_SAMPLES:
        return lambda values: np.asarray(values[..., part.start])
    samples = convert_to_slice(begin)
    weights = curves.compute_polynomial_weights(trace.time[begin] - part.start_time, degree=2)[0]
    return lambda values: np.asarray(np.vecdot(values[..., samples], weights))


@dataclass(frozen=True, slots=True, eq=False)
class LoadingSlope:
    """Stiffness over a length after the onset of the force.

    Parameters
    ----------
    onset : onset of the force in the branch
    first : first sample of the branch in which the specimen counts as taut
    slope : slope of the branch from that sample on
    lead : m, from the onset to the mean displacement in the window
    """

    onset: ForceOnset
    first: int
    slope: WindowSlope
    lead: float

    def compute(self, displacement: Floats, force: Floats, *, has_noise: bool = False) -> Floats:
        """Return the stiffness of branches, N/m, shape (...), or NaN.

        Parameters
        ----------
        displacement, force : shape (..., n), m, N; the window of each row begins at the onset of
            its force
        has_noise : whether noise hides a part of the foot: a curve is taut from its first sample
            above zero on
        """
        taut = displacement[..., self.first :]
        begins, first = self.onset.compute(displacement, force)
        since = np.maximum(first - self.first, 0) if has_noise else 0
        travel_from_turn = begins + self.lead - taut[..., self.slope.window].mean(axis=-1)
        return self.slope.compute(taut, force[..., self.first :], travel_from_turn, since)

    @property
    def share_of_start(self) -> float:
        """Return the share of the samples of the window in its first fiftieth.

        It is large if the motion rests there while the force is above its noise.
        """
        stretch, is_in_window = self.slope.inside()
        path = self.slope.path[stretch][is_in_window]
        is_near_start = path <= path.min() + _START_SHARE * (self.slope.high - self.slope.low)
        return float(is_near_start.mean())


def choose_loading_window(
    time: Floats,
    displacement: Floats,
    force: Floats,
    *,
    length: float,
    limit: float | None = None,
    steps: int = 1,
) -> LoadingSlope:
    """Choose the samples for the stiffness of a loading branch.

    Parameters
    ----------
    time, displacement, force : shape (n,), s, m, N, of the branch; NaN where unknown
    length : m, the length after the onset of the force
    limit : N, up to which a force counts as zero, for a curve without noise; None for a limit from
        the noise of the force
    steps : number of parts into which each sampling step has been divided

    Returns
    -------
    The samples.

    Raises
    ------
    UnavailableError
        As `find_force_onset` or `choose_window`.

    Notes
    -----
    A branch counts as taut from the first sample whose force is above its noise; a branch without
    noise, from the zero of the line through the foot of the force. The difference is an effect of
    noise. If steps are divided, the branch does not count as taut before the machine moves, because
    samples at rest with a force above the noise would shift the line.
    """
    onset = find_force_onset(displacement, force, limit=limit, steps=steps)
    begins, first_sample = onset.compute(displacement, force)
    start, first = float(begins), int(first_sample)
    if limit is not None and not np.isnan(onset.find(displacement, force)[0]):
        zero_time = float(onset.find(time, force)[0])
        first = min(int(np.searchsorted(time, zero_time)), first)
    if steps > 1:
        first = max(first, _find_start_of_motion(time, displacement, start, length))
    taut = slice(first, None)
    path = displacement[taut]
    slope = choose_window(time[taut], path, force[taut], path, low=start, high=start + length)
    return LoadingSlope(onset, first, slope, float(path[slope.window].mean()) - start)


def _find_start_of_motion(time: Floats, displacement: Floats, start: float, length: float) -> int:
    """Find the sample at which a machine of constant speed passes `start`; 0 if unknown."""
    lead = displacement - start
    part = np.flatnonzero((lead >= _START_SHARE * length) & (lead <= _STEADY_SHARE * length))
    if len(part) < 2:
        return 0
    start_time = float(curves.compute_zero_crossing(time[part], lead[part]))
    return 0 if np.isnan(start_time) else int(np.searchsorted(time, start_time))


def choose_unloading_window(
    trace: Trace, part: Branch, *, length: float, sense: float
) -> tuple[Callable[[Floats, Floats], Floats], int]:
    """Choose the samples for the stiffness after a turn.

    Parameters
    ----------
    trace : one curve
    part : the branch that begins with the turn
    length : m, the length after the turn; its first tenth, where the motion turns, is excluded
    sense : 1 if loading increases the displacement, else -1

    Returns
    -------
    A function of displacement and force of curves, shape (..., n), m, N, that returns the
    stiffness, N/m, shape (...), or NaN; and the number of samples. In each curve the window has the
    same distance from the turn.

    Raises
    ------
    UnavailableError
        As `choose_window`.
    """
    at_turn, branch = choose_turn_samples(trace, part), slice(part.start, part.stop)
    start = float(at_turn(trace.displacement))
    time, d, f = cycles.cut_branch(trace, part)
    slope = choose_window(time, d, f, sense * (start - d), low=0.1 * length, high=length)
    lead = float(d[slope.window].mean()) - start

    def compute_stiffness(displacement: Floats, force: Floats) -> Floats:
        d, f = displacement[..., branch], force[..., branch]
        travel = sense * (d[..., slope.window].mean(axis=-1) - at_turn(displacement) - lead)
        return slope.compute(d, f, travel)

    return compute_stiffness, slope.n


MIN_LINE_SAMPLES = 5


def find_compliance_window(
    displacement: Floats, force: Floats, *, start: float, stop: float
) -> Samples:
    """Find the samples over which the force first rises from one value to another.

    Parameters
    ----------
    displacement, force : shape (n,), m, N; the loading branch of a stiff-bar test; NaN
        are ignored
    start, stop : N, of the force window; grips and joints settle below it

    Raises
    ------
    UnavailableError
        ``too_few_samples``, ``no_travel`` if the force is constant, ``not_reached`` if it does not
        reach `stop`.
    """
    finite = curves.find_finite_samples(displacement, force)
    f = force[finite]
    if len(f) == 0 or float(f.max()) < stop:
        largest = float(f.max()) if len(f) else 0.0
        raise UnavailableError.of("results.force_not_reached", largest=largest, stop=stop)
    last = int(np.argmax(f >= stop))
    below = np.flatnonzero(f[:last] < start)
    window_samples = finite[int(below[-1]) + 1 if len(below) else 0 : last + 1]
    curves.require_samples(len(window_samples), MIN_LINE_SAMPLES)
    curves.require_travel(force[window_samples], "force")
    return convert_to_slice(window_samples)


@dataclass(frozen=True, slots=True, kw_only=True)
class UnloadingStiffness(PerCycle):
    """``unloading_stiffness.<cycle>`` (N/m): slope just after each turn."""

    result: ClassVar = "unloading-stiffness"
    outputs: ClassVar = (
        Output("unloading_stiffness", "N/m", "Unloading stiffness", first=1, is_slope=True),
    )
    over: Length
    read_range: ClassVar = (1.0, 2.0)

    method: ClassVar = (
        "line over {over_mm:g} mm off the peak without its first tenth, time as instrument"
    )

    def choose(self, test: ReducedTest, trace: Trace, number: int) -> Reading:
        """Choose the samples in the length `over` after the turn, without its first tenth."""
        del test
        part = cycles.require_unloading(cycles.select_cycle(trace, number))
        sense = cycles.find_loading_sign(trace, trace.displacement)
        slope, n = choose_unloading_window(trace, part, length=self.over, sense=sense)
        return Reading(read_part(slope, slice(None)), n)


@dataclass(frozen=True, slots=True, kw_only=True)
class LoadingStiffness(PerCycle):
    """``loading_stiffness.<cycle>`` (N/m): slope just after the onset of the force."""

    result: ClassVar = "loading-stiffness"
    outputs: ClassVar = (
        Output("loading_stiffness", "N/m", "Loading stiffness", first=1, is_slope=True),
    )
    over: Length
    read_range: ClassVar = (0.0, 1.0)

    method: ClassVar = "line over {over_mm:g} mm from the onset of the force, time as instrument"

    def choose(self, test: ReducedTest, trace: Trace, number: int) -> Reading:
        """Choose the samples after the onset; a smooth curve has the limit of the measured one."""
        part = cycles.select_cycle(trace, number)[0]
        parts, branch = cycles.cut_branch(trace, part), slice(part.start, part.stop)
        limit = self._fit_measured(test, number).onset.limit if trace.is_smooth else None
        steps = trace.parts_per_step
        fit = choose_loading_window(*parts, length=self.over, limit=limit, steps=steps)
        in_noise = read_part(partial(fit.compute, has_noise=True), branch)
        return Reading(read_part(fit.compute, branch), fit.slope.n, in_noise, ends_at_samples=True)

    def list_doubts(self, test: ReducedTest, branches: list[Branch]) -> tuple[Reason, ...]:
        """Return a doubt if over 10 % of the samples of the window are in its first fiftieth."""
        fit = return_failure(self._fit_measured)(test, branches[0].cycle)
        if isinstance(fit, Failure) or fit.share_of_start <= 0.1:
            return ()
        share, limit = fit.share_of_start, fit.onset.limit
        return (Reason.of("results.rest_in_window", share=share, limit=limit),)

    def _fit_measured(self, test: ReducedTest, number: int) -> LoadingSlope:
        curve = curves.make_trace(test)
        parts = cycles.cut_branch(curve, cycles.select_cycle(curve, number)[0])
        return choose_loading_window(*parts, length=self.over)


@dataclass(frozen=True, slots=True, kw_only=True)
class Hardening(Kind):
    """``hardening.<cycle>`` (1): ``loading_stiffness`` of a later cycle over that of the first."""

    result: ClassVar = "hardening"
    outputs: ClassVar = (Output("hardening", "1", "Hardening", first=2),)
    over: Length

    method: ClassVar = (
        "slope over {over_mm:g} mm from the onset of the force / that of cycle 1, scale cancelled"
    )

    def measure(self, test: ReducedTest) -> Iterator[Part]:
        """Measure the ratio of each later cycle to the first one; the scale cancels."""
        first, *later_cycles = test.require(test.cycles or None)
        stiffness = LoadingStiffness(over=self.over)
        base = return_failure(test.measure_one)(partial(stiffness.choose, test, number=1))
        doubts = stiffness.list_doubts(test, first)

        def choose_first(trace: Trace) -> Reading:
            reading = return_failure(stiffness.choose)(test, trace, 1)
            if isinstance(reading, Failure):
                raise UnavailableError.of("results.no_first_stiffness", why=reading.message)
            return reading

        @return_failure
        def measure_ratio(number: int) -> Measured:
            choose = partial(stiffness.choose, test, number=number)
            ratio = combine_numbers(lambda _, x, first: divide(x, first), choose, choose_first)
            hardening, first_stiffness = test.measure_one(ratio), test.require(base)
            if first_stiffness.value <= 3.0 * first_stiffness.error:
                value = first_stiffness.value
                raise UnavailableError.of("results.first_stiffness_is_noise", value=value)
            return hardening

        for later_cycle in later_cycles:
            yield self.make_result(
                test,
                measure_ratio(later_cycle[0].cycle),
                doubts=doubts + stiffness.list_doubts(test, later_cycle),
                period=(first[0].start_time, later_cycle[0].stop_time),
                suffix=f".{later_cycle[0].cycle}",
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class Window(Kind):
    """A kind of result that is measured over a range of displacement."""

    start: Annotated[Distance, Key("from")]
    stop: Annotated[Distance, Key("to"), LargerThan("start", "from")]

    def select_samples(self, trace: Trace) -> slice:
        """Return the samples of the first loading from `start` until it first exceeds `stop`.

        Parameters
        ----------
        trace : one curve

        Raises
        ------
        UnavailableError
            ``not_reached`` if the loading ends before `stop`, or begins beyond `start` by more than
            2 % of the range.
        """
        loading, low, high = curves.select_first_loading(trace), self.start, self.stop
        displacement = trace.displacement[loading]
        finite = displacement[~np.isnan(displacement)]
        if not len(finite) or finite.max() < high:
            reached = 1e3 * float(finite.max()) if len(finite) else float("nan")
            raise UnavailableError.of("results.not_reached", reached=reached, needed=1e3 * high)
        if finite[0] > low + 0.02 * (high - low):
            begin = 1e3 * finite[0]
            raise UnavailableError.of("results.begins_later", begin=begin, needed=1e3 * low)
        start, beyond = int(np.argmax(displacement >= low)), int(np.argmax(displacement > high))
        return slice(loading.start + start, loading.start + (beyond or len(displacement)))


def _choose_secant_window(trace: Trace, low: float, high: float) -> Reading:
    """Choose the samples for the stiffness between two displacements of the first loading."""
    part = trace.branches[0]
    branch, (time, path, force) = slice(part.start, part.stop), cycles.cut_branch(trace, part)
    fit = choose_window(time, path, force, path, low=low, high=high)
    middle = path[fit.window].mean()

    def with_own_window(path: Floats, force: Floats) -> Floats:
        return fit.compute(path, force, middle - path[..., fit.window].mean(axis=-1))

    numbers, in_noise = read_part(fit.compute, branch), read_part(with_own_window, branch)
    return Reading(numbers, fit.n, in_noise, ends_at_samples=True)


@dataclass(frozen=True, slots=True, kw_only=True)
class InitialStiffness(Window):
    """``initial_stiffness`` (N/m): slope at the start of the first loading."""

    result: ClassVar = "initial-stiffness"
    outputs: ClassVar = (Output("initial_stiffness", "N/m", "Initial stiffness", is_slope=True),)
    method: ClassVar = (
        "line from {start_mm:g} mm to {stop_mm:g} mm of the first loading, time as instrument"
    )

    def measure(self, test: ReducedTest) -> Iterator[Part]:
        """Measure the slope, time as instrument; yield it, and the stiffness for later entries."""
        window = self.start, self.stop
        decide = partial(_choose_secant_window, low=self.start, high=self.stop)
        outcome, period = test.measure_one(decide), test.find_loading_interval(*window)
        number = self.make_result(test, outcome, period=period)
        yield number
        yield Stiffness(number.name, decide, outcome.value, period, window)


@dataclass(frozen=True, slots=True, kw_only=True)
class LineStiffness(InitialStiffness):
    """``<name>`` (N/m): straight line over a window of the first loading."""

    result: ClassVar = "stiffness"
    outputs: ClassVar = (Output("{name}", "N/m", is_slope=True),)
    method: ClassVar = (
        "straight line from {start_mm:g} mm to {stop_mm:g} mm of the first loading, "
        "interval for correlated noise"
    )
    name: Annotated[Snake, "Such as stiffness_first"] = "stiffness"

    def list_methods(self, test: ReducedTest) -> tuple[str]:
        """Return the method: time is the instrument if the test has a shape."""
        return (self.method if test.shape is None else InitialStiffness.method,)

    def measure(self, test: ReducedTest) -> Iterator[Part]:
        """Fit a least-squares line; for a test with a shape, a line with time as instrument."""
        if test.shape is not None:
            yield from super(LineStiffness, self).measure(test)
            return
        slope, curve = test.measure_one(self.decide), curves.make_trace(test)
        d, f = (values[self.samples(curve)] for values in (curve.displacement, curve.force))
        low, high = float(d.min()), float(d.max())
        level = float(f.mean()) + slope.value * (low - float(d.mean()))
        period = test.find_loading_interval(low, high)
        doubts = kinds.find_marked_slips(test, (low, high))
        if slope.value <= 0.0:
            doubts = (Reason.of("results.negative_slope"), *doubts)
        yield self.make_result(test, slope, period=period, doubts=doubts)
        ends = max(low, 0.0), high
        yield Stiffness(self.name, self.decide, slope.value, period, ends, (low, high))
        yield FittedLine(self.name, slope.value, level, low, high)

    def samples(self, trace: Trace) -> Ints:
        """Return the samples in the window of the first loading, up to the failure.

        Parameters
        ----------
        trace : one curve
        """
        part = self.select_samples(trace)
        finite = curves.find_finite_samples(trace.displacement[part], trace.force[part])
        return np.asarray(part.start + finite)

    def decide(self, trace: Trace) -> Reading:
        """Choose the samples for the slope of the line over the window.

        Parameters
        ----------
        trace : one curve
        """
        samples = self.samples(trace)
        curves.require_samples(len(samples), MIN_LINE_SAMPLES)
        curves.require_travel(trace.displacement[samples])
        slope = read_part(curves.compute_slope, convert_to_slice(samples))
        return Reading(slope, len(samples), ends_at_samples=True)


@dataclass(frozen=True, slots=True, kw_only=True)
class FromStiffness(Kind):
    """A kind of result that is computed from a stiffness above it in the list."""

    of: Annotated[StiffnessName, "Name of a stiffness above, such as stiffness_first"]

    @abstractmethod
    def measure_number(self, test: ReducedTest, stiffness: Stiffness) -> kinds.Outcome:
        """Measure the number of a test from its stiffness."""

    def find_context(self, test: ReducedTest, stiffness: Stiffness) -> dict[str, Any]:
        """Return further arguments of `Kind.make_result`: time interval, doubts, remark."""
        del test, stiffness
        return {}

    def measure(self, test: ReducedTest) -> Iterator[Part]:
        """Measure the number from the stiffness."""
        missing = Failure.of("results.no_stiffness", name=self.of)
        stiffness = test.require(test.stiffnesses.get(self.of), missing)
        outcome = return_failure(self.measure_number)(test, stiffness)
        context = {"period": stiffness.period, **self.find_context(test, stiffness)}
        slips = kinds.find_marked_slips(test, stiffness.slip_range)
        context["doubts"] = slips + stiffness.doubts + context.get("doubts", ())
        yield self.make_result(test, outcome, **context)


@dataclass(frozen=True, slots=True, kw_only=True)
class NormalisedStiffness(FromStiffness):
    """``<of>_per_peak_force`` (1/m): a stiffness over the largest force of the same sample."""

    result: ClassVar = "normalised-stiffness"
    outputs: ClassVar = (Output("{of}_per_peak_force", "1/m"),)
    needs: ClassVar = Needs()
    method: ClassVar = (
        "{of} / peak force of the same sample, errors independent, scale error cancelled"
    )

    def find_context(self, test: ReducedTest, stiffness: Stiffness) -> dict[str, Any]:
        """Return the time up to the last peak, and a doubt if the record ends before it."""
        loading, period = test.cycles[-1][:1], stiffness.period
        period = period and (period[0], max(period[1], loading[0].stop_time))
        return {"period": period, "doubts": cycles.find_truncation(test, loading)}

    def measure_number(self, test: ReducedTest, stiffness: Stiffness) -> kinds.Outcome:
        """Measure a stiffness over the largest force of all cycles, in which a gain cancels."""
        trace, largest = curves.make_trace(test), dict[int, float]()
        for number in range(1, len(test.cycles) + 1):
            peak = return_failure(cycles.choose_peak_sample)(test, trace, number)
            value = peak.numbers(trace)[0] if isinstance(peak, Reading) else -np.inf
            largest[number] = float(value)
        cycle = max(largest, key=lambda number: (largest[number], number))

        def choose_peak(trace: Trace) -> Reading:
            return cycles.choose_peak_sample(test, trace, cycle)

        measured = test.measure_one(choose_peak)
        if measured.value <= 3.0 * measured.error:
            raise UnavailableError.of("results.no_peak_force", peak=measured.value)
        quotient = combine_numbers(lambda _, x, peak: x / peak, stiffness.decide, choose_peak)
        return test.measure_one(quotient)


@dataclass(frozen=True, slots=True, kw_only=True)
class Modulus(FromStiffness):
    """``<name>`` (Pa): stiffness x gauge length / area."""

    result: ClassVar = "modulus"
    outputs: ClassVar = (Output("{name}", "Pa", is_slope=True),)
    needs: ClassVar = Needs()
    method: ClassVar = "{of} x specimen.length / area ({area})"
    area: Annotated[
        Literal["stated", "rectangle", "annulus", "thin-wall"],
        "The area of specimen.section that the modulus refers to",
    ]
    name: Annotated[Snake, "Such as modulus_annulus"] = "modulus"

    def measure_number(self, test: ReducedTest, stiffness: Stiffness) -> kinds.Outcome:
        """Measure the modulus with the uncertainties of stiffness, gauge length and area."""
        if "length" not in test.setup.sizes:
            raise UnavailableError.of("results.no_gauge_length")
        compute_area(test.setup.sizes, self.area)
        return test.measure_one(combine_numbers(self._compute_modulus, stiffness.decide))

    def _compute_modulus(self, trace: Trace, stiffness: Floats) -> Floats:
        area = return_failure(compute_area)(trace.sizes, self.area)
        area = np.nan if isinstance(area, Failure) else area
        return np.asarray(stiffness * trace.sizes["length"] / area, dtype=np.float64)

    def find_context(self, test: ReducedTest, stiffness: Stiffness) -> dict[str, Any]:
        """Return a doubt if the displacement may be that of frame and grips."""
        return {"doubts": kinds.find_machine_compliance(test, stiffness.value)}


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
"""Kinds of area of a section: keys of the sizes in the protocol, and the area, m^2, from these, m.

The diameters of a corrugated tube include the height of its folds, so that annulus and thin wall
differ: a modulus has to state which one it refers to.
"""


def compute_area(sizes: Mapping[str, float], section: str = "") -> float:
    """Return the area of a section from its sizes, m^2.

    Parameters
    ----------
    sizes : m (the area m^2), by the keys of the protocol
    section : a key of `_AREAS`; empty for the first one whose sizes are all given

    Raises
    ------
    UnavailableError
        ``no_area`` without a complete set of sizes, or if they give no area.
    """
    for kind in [section] if section else _AREAS:
        names, area_of = _AREAS[kind]
        if not all(name in sizes for name in names):
            continue
        area = area_of(*(sizes[name] for name in names))
        if not area > 0.0:
            raise UnavailableError.of("results.bad_area", kind=kind, area=area)
        return area
    missing = "specimen.section.area, or its width and thickness, or outer_diameter"
    if section:
        missing = " and ".join(f"specimen.section.{name}" for name in _AREAS[section][0])
    raise UnavailableError.of("results.no_area", missing=missing)


@dataclass(frozen=True, slots=True, kw_only=True)
class ComplianceResult(Kind):
    """``compliance`` (m/N): of frame and grips, from a test of a stiff bar."""

    result: ClassVar = "compliance"
    outputs: ClassVar = (Output("compliance", "m/N", "Compliance of frame and grips"),)
    start: Annotated[Force, Key("from")]
    stop: Annotated[Force, Key("to"), LargerThan("start", "from")]
    method: ClassVar = (
        "displacement against force from {start:g} N to {stop:g} N, the bar assumed rigid"
    )

    def measure(self, test: ReducedTest) -> Iterator[Part]:
        """Fit displacement against force, with a rigid bar."""
        compliance = test.measure_one(self.decide)
        yield self.make_result(test, compliance, period=test.find_loading_interval())

    def decide(self, trace: Trace) -> Reading:
        """Choose the samples for the slope of displacement against force over the window.

        Parameters
        ----------
        trace : one curve
        """
        stretch = curves.select_first_loading(trace)
        d, f = trace.displacement[stretch], trace.force[stretch]
        window = find_compliance_window(d, f, start=self.start, stop=self.stop)
        compliance = read_part(lambda d, f: curves.compute_slope(f, d), (stretch, window))
        if (slope := float(compliance(trace)[0])) <= 0.0:
            raise UnavailableError.of("results.not_positive", slope=slope)
        return Reading(compliance, len(d[window]), ends_at_samples=True)
