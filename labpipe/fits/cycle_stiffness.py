"""Stiffnesses of the branches of a cycle, with time as instrument: after take-up, after a turn."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labpipe.fits.common_path import finite_samples
from labpipe.fits.least_squares import polynomial_weights, zero_of_line
from labpipe.fits.slack import TakeUp, take_up
from labpipe.records.arrays import Flags, Floats, Ints, Samples, part_of, ratio, samples_of
from labpipe.records.curve import Branch
from labpipe.records.estimates import Failure
from labpipe.signal.filters import moving_average

_MIN_WINDOW_SAMPLES = 8
_START_SHARE, _STEADY_SHARE = 0.02, 0.1
"""Share of a window that is its start; share up to which the speed of the machine is constant."""


@dataclass(frozen=True, slots=True, eq=False)
class WindowSlope:
    """Slope of force against displacement over a window of a path, time as instrument.

    Parameters
    ----------
    samples : of the branch, with a force and a displacement, m of them
    time : shape (m,), s
    path, furthest : shape (m,), m, path along the branch, with little noise, and its largest value
    so far
    low, high : m, ends of the window
    """

    samples: Samples
    time: Floats
    path: Floats
    furthest: Floats
    low: float
    high: float

    def inside(self, later: Floats | float = 0.0, since: Ints | int = 0) -> tuple[slice, Flags]:
        """Return the samples of the window, up to where the path first leaves it.

        Parameters
        ----------
        later : m, shape (...), shift of the window along the path
        since : shape (...), first sample of the branch that it may contain

        Returns
        -------
        Range of the samples that contains all windows, and a mask of each window in it, shape (...,
        range).
        """
        low, high = (np.asarray(end + later) for end in (self.low, self.high))
        start = np.searchsorted(self.furthest, low)
        stop = np.searchsorted(self.furthest, high, side="right")
        stretch = slice(int(start.min()), max(int(stop.max()), int(start.min())))
        numbers = np.arange(stretch.start, stretch.stop)
        is_in: Flags = self.path[stretch] >= low[..., np.newaxis]
        is_in &= numbers < stop[..., np.newaxis]
        if np.any(since):
            is_in &= self._numbers(stretch) >= np.asarray(since)[..., np.newaxis]
        return stretch, is_in

    def _numbers(self, stretch: slice) -> Ints:
        """Return numbers in the branch of a range of the samples."""
        samples = part_of(self.samples, stretch)
        return np.arange(samples.start, samples.stop) if isinstance(samples, slice) else samples

    @property
    def window(self) -> Samples:
        """Samples of the branch within the window."""
        stretch, inside = self.inside()
        return samples_of(self._numbers(stretch)[inside])

    @property
    def n(self) -> int:
        """Samples of the window."""
        return int(self.inside()[1].sum())

    def of(
        self,
        displacement: Floats,
        force: Floats,
        later: Floats | float = 0.0,
        since: Ints | int = 0,
    ) -> Floats:
        """Return the slope, N/m, shape (...); NaN for fewer than 8 samples, or without travel.

        Parameters
        ----------
        displacement, force : shape (..., n), m, N, of the branch
        later, since : shape (...), as for `inside`
        """
        stretch, inside = self.inside(later, since)
        samples, time = part_of(self.samples, stretch), self.time[stretch]
        count = inside.sum(axis=-1)
        enough = np.where(count < _MIN_WINDOW_SAMPLES, 0, count)
        middle = ratio(np.asarray(inside @ time), enough)
        weight = np.where(inside, time - middle[..., np.newaxis], 0.0)
        return ratio(
            np.vecdot(weight, force[..., samples]), np.vecdot(weight, displacement[..., samples])
        )


def window_slope(
    time: Floats, displacement: Floats, force: Floats, path: Floats, *, low: float, high: float
) -> WindowSlope | Failure:
    """Choose the samples of a branch for a stiffness.

    Parameters
    ----------
    time, displacement, force : shape (n,), s, m, N, of the branch; NaN where unknown
    path : shape (n,), m, along the branch
    low, high : m, of the path

    Returns
    -------
    The window, or a failure ``not_reached``, ``too_few_samples`` or ``no_travel``.

    Notes
    -----
    The window is cut from the path averaged over 11 samples, and ends where it is first left, so
    that noise moves its ends little. k = sum (t - mean t) F / sum (t - mean t) d: time is the
    instrument, because ordinary least squares of F on a noisy displacement is too small (by the
    ratio of noise variance to variance; Fuller, Measurement Error Models, 1987, sec. 1.4).
    """
    travelled = moving_average(path, window=min(11, len(path) - 1 + len(path) % 2))
    if not (travelled > high).any():
        reached = float(np.max(travelled, where=~np.isnan(travelled), initial=-np.inf))
        return Failure("not_reached", f"the branch reaches {reached:.4g} m, {high:.4g} m is needed")
    furthest = np.maximum.accumulate(np.where(np.isnan(travelled), -np.inf, travelled))
    samples = samples_of(finite_samples(displacement, force))
    fit = WindowSlope(samples, time[samples], travelled[samples], furthest[samples], low, high)
    if fit.n < _MIN_WINDOW_SAMPLES:
        message = f"{fit.n} samples in the stretch, {_MIN_WINDOW_SAMPLES} are needed"
        return Failure("too_few_samples", message)
    if np.ptp(displacement[fit.window]) == 0.0:
        return Failure("no_travel", "the displacement does not change over the stretch")
    return fit


@dataclass(frozen=True, slots=True, eq=False)
class Turn:
    """Value of a signal at the start of a branch, from a parabola.

    Parameters
    ----------
    samples : of the signal
    weights : shape (samples,), of the samples in the value
    """

    samples: Samples
    weights: Floats

    def of(self, values: Floats) -> Floats:
        """Return the value at the turn, shape (...), of a signal of shape (..., n)."""
        value: Floats = np.vecdot(values[..., self.samples], self.weights)
        return value


def turn_at(time: Floats, values: Floats, *, at: float, first: int, stop: int) -> Turn:
    """Choose the samples for the value at the turn at the start of a branch.

    Parameters
    ----------
    time, values : shape (n,), s, and any unit; NaN are ignored
    at : s, of the turn: a branch may contain a part of the wait before it
    first, stop : samples of the branch

    Returns
    -------
    A parabola through the first tenth of the branch after the turn, at most 50 samples; the first
    sample of the branch if that has fewer than 8.
    """
    start = max(first, int(np.searchsorted(time, at)))
    begin = np.arange(start, start + min(50, (stop - start) // 10))
    begin = begin[~np.isnan(values[begin])]
    if len(begin) < _MIN_WINDOW_SAMPLES:
        return Turn(samples_of(np.array([first])), np.ones(1))
    return Turn(samples_of(begin), polynomial_weights(time[begin] - at, degree=2)[0])


@dataclass(frozen=True, slots=True, eq=False)
class LoadingSlope:
    """Stiffness over a length after the force takes up.

    Parameters
    ----------
    take_up : of the branch
    first : first sample of the branch that counts as taut
    slope : of the branch from that sample
    ahead : m, from the take-up to the middle of the window
    """

    take_up: TakeUp
    first: int
    slope: WindowSlope
    ahead: float

    def of(self, displacement: Floats, force: Floats) -> Floats:
        """Return the stiffness, N/m, shape (...), of a branch of shape (..., n), m, N, or NaN.

        The window begins where the force of each row takes up.
        """
        taut = displacement[..., self.first :]
        begins = self.take_up.of(displacement, force) + self.ahead
        later = begins - taut[..., self.slope.window].mean(axis=-1)
        return self.slope.of(taut, force[..., self.first :], later)

    @property
    def share_at_rest(self) -> float:
        """Share of the samples of the window in its first fiftieth.

        It is large if the motion rests there, with a force above its noise.
        """
        stretch, inside = self.slope.inside()
        path = self.slope.path[stretch][inside]
        near = path <= path.min() + _START_SHARE * (self.slope.high - self.slope.low)
        return float(near.mean())

    def of_each(self, displacement: Floats, force: Floats) -> Floats:
        """Return the stiffness of branches with noise, each with its own take-up.

        Parameters
        ----------
        displacement, force : shape (rows, n), m, N

        Returns
        -------
        Shape (rows,), N/m, or NaN.
        """
        taut = displacement[:, self.first :]
        begins, first = self.take_up.of_each(displacement, force)
        later = begins + self.ahead - taut[:, self.slope.window].mean(axis=-1)
        since = np.maximum(first - self.first, 0)
        return self.slope.of(taut, force[:, self.first :], later, since)


def loading_slope(
    time: Floats,
    displacement: Floats,
    force: Floats,
    *,
    over: float,
    like: LoadingSlope | None = None,
    steps: int = 1,
) -> LoadingSlope | Failure:
    """Choose the samples for the stiffness of a loading branch.

    Parameters
    ----------
    time, displacement, force : shape (n,), s, m, N, of the branch; NaN where unknown
    over : m, the length after the take-up
    like : the choice on the measured branch, for a curve without noise
    steps : parts that each sampling step has been divided into

    Returns
    -------
    The samples, or a failure as `labpipe.fits.slack.take_up` or `window_slope` has it.

    Notes
    -----
    A branch counts as taut from the first sample whose force is above its noise; without noise,
    from the zero of the line through the foot of the force. The difference is an effect of noise.
    Between samples it is not before the machine moves: samples at rest with a force above its noise
    would shift the line.
    """
    limit = None if like is None else like.take_up.limit
    begin = take_up(displacement, force, limit=limit, steps=steps)
    if isinstance(begin, Failure):
        return begin
    start, first = float(begin.of(displacement, force)), begin.sample
    if like is not None and begin.is_line:
        at = float(zero_of_line(time[begin.foot], force[begin.foot]))
        first = min(int(np.searchsorted(time, at)), first)
    if steps > 1:
        first = max(first, _start_of_motion(time, displacement, start, over))
    taut = slice(first, None)
    path = displacement[taut]
    slope = window_slope(time[taut], path, force[taut], path, low=start, high=start + over)
    if isinstance(slope, Failure):
        return slope
    return LoadingSlope(begin, first, slope, float(path[slope.window].mean()) - start)


def _start_of_motion(time: Floats, displacement: Floats, start: float, over: float) -> int:
    """Return the sample at which a machine of constant speed passed a place; 0 if unknown."""
    ahead = displacement - start
    part = np.flatnonzero((ahead >= _START_SHARE * over) & (ahead <= _STEADY_SHARE * over))
    at = float(zero_of_line(time[part], ahead[part])) if len(part) > 1 else np.nan
    return 0 if np.isnan(at) else int(np.searchsorted(time, at))


@dataclass(frozen=True, slots=True, eq=False)
class UnloadingSlope:
    """Stiffness over a length after a turn.

    Parameters
    ----------
    turn : of the curve
    branch : samples of the curve
    slope : of the branch
    sense : 1 if loading increases the displacement, else -1
    ahead : m, from the displacement at the turn to that in the middle of the window
    """

    turn: Turn
    branch: slice
    slope: WindowSlope
    sense: float
    ahead: float

    def of(self, displacement: Floats, force: Floats) -> Floats:
        """Return the stiffness, N/m, shape (...), of a curve of shape (..., n), m, N, or NaN.

        The window has the same distance from the turn of each row.
        """
        d, f = displacement[..., self.branch], force[..., self.branch]
        middle = d[..., self.slope.window].mean(axis=-1)
        later = self.sense * (middle - self.turn.of(displacement) - self.ahead)
        return self.slope.of(d, f, later)


def unloading_slope(
    time: Floats, displacement: Floats, force: Floats, part: Branch, *, over: float, sense: float
) -> UnloadingSlope | Failure:
    """Choose the samples for the stiffness after a turn.

    Parameters
    ----------
    time, displacement, force : shape (n,), s, m, N, of the curve; NaN where unknown
    part : the branch that begins with the turn
    over : m, the length after the turn; its first tenth, where the motion turns, is excluded
    sense : 1 if loading increases the displacement, else -1

    Returns
    -------
    The samples, or a failure as `window_slope` has it.
    """
    turn = turn_at(time, displacement, at=part.start_time, first=part.start, stop=part.stop)
    start, branch = float(turn.of(displacement)), slice(part.start, part.stop)
    off = sense * (start - displacement[branch])
    slope = window_slope(
        time[branch], displacement[branch], force[branch], off, low=0.1 * over, high=over
    )
    if isinstance(slope, Failure):
        return slope
    ahead = float(displacement[branch][slope.window].mean()) - start
    return UnloadingSlope(turn, branch, slope, sense, ahead)
