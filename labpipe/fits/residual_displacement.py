"""Residual displacement: the displacement at zero force after unloading."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from labpipe.fits.common_path import finite_samples
from labpipe.fits.least_squares import line_in, polynomial_weights, slope_of_line, zero_of_line
from labpipe.records.arrays import Flags, Floats, Ints, Samples, ratio, samples_of
from labpipe.records.estimates import Failure
from labpipe.uncertainty.autocorrelation import fast_noise, limits_by_noise

_FOOT_LIMITS = 5.0
"""The foot of the force, below this multiple of the limit, is taken as straight."""
_TIME_BEFORE_ZERO = 1.0
"""s before zero force, for the line through the displacement."""
_MIN_SAMPLES = 8
_MIN_FOOT_SAMPLES = 4


@dataclass(frozen=True, slots=True, eq=False)
class ThroughZero:
    """The force continues below zero: parabolas through force and displacement there.

    Parameters
    ----------
    near : samples of the branch
    time : shape (near,), s, from about when the force is zero
    limit : N, up to which a force counts as zero
    """

    near: Samples
    time: Floats
    limit: float

    @property
    def n(self) -> int:
        """Number of samples used for the displacement."""
        return len(self.time)

    def of(self, displacement: Floats, force: Floats) -> Floats:
        """Return the displacement at zero force, m, shape (...), from curves (..., n)."""
        weights = polynomial_weights(self.time, degree=2).T
        level, slope, bend = np.moveaxis(force[..., self.near] @ weights, -1, 0)
        at = np.zeros_like(level)
        for _ in range(4):  # Newton steps, from near the root
            step = ratio(level + at * (slope + at * bend), slope + 2.0 * at * bend)
            at = np.clip(at - step, self.time[0], self.time[-1])
        place, speed, curve = np.moveaxis(displacement[..., self.near] @ weights, -1, 0)
        value: Floats = place + at * (speed + at * curve)
        return value


@dataclass(frozen=True, slots=True, eq=False)
class AtRest:
    """The string is slack and the displacement at rest: its mean.

    Parameters
    ----------
    rest, n : samples of the branch, and their number
    limit : N, up to which a force counts as zero
    """

    rest: Samples
    n: int
    limit: float

    def of(self, displacement: Floats, force: Floats) -> Floats:
        """Return the mean displacement, m, shape (...), from curves (..., n)."""
        del force
        value: Floats = displacement[..., self.rest].mean(axis=-1)
        return value


@dataclass(frozen=True, slots=True, eq=False)
class FollowedToZero:
    """The foot of the force is extrapolated to zero, with the displacement of the last second.

    Parameters
    ----------
    samples, foot, near : samples of the branch: all without NaN, and two parts
    time, foot_time, near_time : shape (samples,), (foot,), (near,), s, from the end of the foot
    is_line : whether a line through the foot falls to zero; else zero is at its end
    limit, least : N, up to which a force counts as zero, and that limit without noise
    """

    samples: Samples
    foot: Samples
    near: Samples
    time: Floats
    foot_time: Floats
    near_time: Floats
    is_line: bool
    limit: float
    least: float

    @property
    def n(self) -> int:
        """Number of samples used for the displacement."""
        return len(self.near_time)

    def of(self, displacement: Floats, force: Floats) -> Floats:
        """Return the displacement at zero force, m, shape (...); NaN if a line does not fall.

        Parameters
        ----------
        displacement, force : shape (..., n), m, N, of the branch
        """
        at = _zero_time(self.foot_time, force[..., self.foot]) if self.is_line else np.zeros(())
        d = displacement[..., self.near]
        ahead = at - self.near_time.mean()
        value: Floats = d.mean(axis=-1) + slope_of_line(self.near_time, d) * ahead
        return value

    def of_each(self, displacement: Floats, force: Floats) -> Floats:
        """Return the displacement at zero force of branches with noise, each with its own foot.

        Parameters
        ----------
        displacement, force : shape (rows, n), m, N, of the branch

        Returns
        -------
        Shape (rows,), m; NaN if the force does not return to zero.
        """
        d, f, time = displacement[:, self.samples], force[:, self.samples], self.time
        limit = np.full((len(f), 1), self.limit)
        if self.limit > self.least:
            limit = np.maximum(limits_by_noise(self.limit, f), self.least)[:, np.newaxis]
        begin, end = _last_flagged(f > _FOOT_LIMITS * limit), _last_flagged(f > limit)
        stretch = slice(max(int(begin.min()), 0), max(int(end.max()), 0) + 1)
        numbers = np.arange(stretch.start, stretch.stop)
        foot = (numbers >= begin[:, np.newaxis]) & (numbers <= end[:, np.newaxis])
        middle, level, slope = line_in(foot, time[stretch], f[:, stretch])
        falls = (slope < 0.0) & (end - np.maximum(begin, 0) + 1 >= _MIN_FOOT_SAMPLES)
        at = np.where(falls, middle - ratio(level, slope), time[end])
        part = slice(
            *np.searchsorted(time, [at.min() - _TIME_BEFORE_ZERO, at.max() + _TIME_BEFORE_ZERO])
        )
        t, start = time[part], at[:, np.newaxis] - _TIME_BEFORE_ZERO
        near = (t >= start) & (t <= at[:, np.newaxis])
        middle, level, slope = line_in(near, t, d[:, part])
        ended = (end >= 0) & (end < len(time) - 3) & (near.sum(axis=1) >= _MIN_SAMPLES)
        return np.where(ended, level + slope * (at - middle), np.nan)


Unloaded: TypeAlias = ThroughZero | AtRest | FollowedToZero
"""How an unloading ends, with the samples for its residual displacement."""


def unloaded(
    time: Floats,
    displacement: Floats,
    force: Floats,
    *,
    force_below: float,
    like: Unloaded | None = None,
) -> Unloaded | Failure:
    """Choose the samples for the displacement at zero force after unloading.

    Parameters
    ----------
    time, displacement, force : shape (n,), s, m, N; one unloading branch; NaN are ignored
    force_below : N; a force within this counts as zero. For weak specimens at most a fiftieth of
        the largest force, unless its noise (four standard deviations) is more
    like : how the measured branch ends, with its limit, for a curve without noise

    Returns
    -------
    The end and its samples, or a failure: ``force_not_zero`` if the branch ends before the force is
    zero, ``too_few_samples``.

    Notes
    -----
    There are three cases. The force continues below zero: parabolas through force and displacement,
    over a tenth of the branch on each side, give the time of zero force and the displacement. The
    string becomes slack (the line through the force between five limits and one would have fallen
    by three limits more, and the force stays within two) and the displacement rests: its mean.
    Otherwise the line is extrapolated to zero, and the displacement along a line through the second
    before, since it may have a kink there.
    """
    # Largest share of the largest force of a branch that counts as zero.
    max_zero_share = 0.02
    # Standard deviations of noise above which a force is not zero.
    noise_deviations = 4.0
    finite = finite_samples(displacement, force)
    branch = _Branch(finite, time[finite], displacement[finite], force[finite])
    f = branch.force
    if len(f) < 2 * _MIN_SAMPLES:
        return Failure("too_few_samples", f"{len(f)} samples, {2 * _MIN_SAMPLES} are needed")
    least = min(force_below, max_zero_share * float(f.max()))
    limit = max(noise_deviations * float(fast_noise(f)), least) if like is None else like.limit
    above = np.flatnonzero(f > limit)
    if len(above) == 0:
        return Failure("too_few_samples", f"{len(f)} samples, none above {limit:.4g} N")
    if above[-1] >= len(f) - 3:
        message = f"the force ends at {f[-3:].mean():.4g} N, above the limit of {limit:.4g} N"
        return Failure("force_not_zero", message)
    goes_on = bool(np.median(f[-_MIN_SAMPLES:]) < -limit)
    if goes_on if like is None else isinstance(like, ThroughZero):
        return branch.through_zero(limit)
    return branch.slack_or_followed(limit, least, like)


@dataclass(frozen=True, slots=True, eq=False)
class _Branch:
    """An unloading branch without NaN.

    Parameters
    ----------
    numbers : shape (n,), samples of the branch
    time, displacement, force : shape (n,), s, m, N
    """

    numbers: Ints
    time: Floats
    displacement: Floats
    force: Floats

    def samples(self, chosen: Flags | slice) -> Samples:
        """Return the numbers of chosen samples in the branch."""
        return samples_of(self.numbers[chosen])

    def through_zero(self, limit: float) -> ThroughZero | Failure:
        """Choose the samples around the zero of the force."""
        time = self.time
        middle = time[min(int((self.force > 0.0).sum()), len(time) - 1)]
        near = np.abs(time - middle) <= 0.1 * (time[-1] - time[0])
        if near.sum() < _MIN_SAMPLES:
            message = f"{int(near.sum())} samples near zero force, {_MIN_SAMPLES} are needed"
            return Failure("too_few_samples", message)
        return ThroughZero(self.samples(near), time[near] - middle, limit)

    def slack_or_followed(
        self, limit: float, least: float, like: Unloaded | None
    ) -> Unloaded | Failure:
        """Choose the samples for a force that stays near zero."""
        last = int(np.flatnonzero(self.force > limit)[-1])
        far = np.flatnonzero(self.force > _FOOT_LIMITS * limit)
        foot = slice(int(far[-1]) if len(far) else 0, last + 1)
        end = float(self.time[last])
        from_end = self.time - end
        at, slope = np.nan, 0.0
        if foot.stop - foot.start >= _MIN_FOOT_SAMPLES:
            at = float(_zero_time(from_end[foot], self.force[foot]))
            slope = float(slope_of_line(from_end[foot], self.force[foot]))
        falls = not np.isnan(at)
        zero = end + at if falls else end
        rest = self.time > zero + 0.2
        has_stopped = falls and slope * (self.time[-1] - zero) < -3.0 * limit
        rests = has_stopped and self._is_slack(rest, limit)
        if rests if like is None else isinstance(like, AtRest) and rest.any():
            return AtRest(self.samples(rest), int(rest.sum()), limit)
        near = (self.time >= zero - _TIME_BEFORE_ZERO) & (self.time <= zero)
        if near.sum() < _MIN_SAMPLES:
            message = f"{int(near.sum())} samples in the 1 s to {zero:.3f} s"
            return Failure("too_few_samples", message)
        places = samples_of(self.numbers), self.samples(foot), self.samples(near)
        times = from_end, from_end[foot], from_end[near]
        return FollowedToZero(*places, *times, falls, limit, least)

    def _is_slack(self, rest: Flags, limit: float) -> bool:
        """Return whether force and displacement rest within their noise."""
        if rest.sum() < _MIN_SAMPLES or np.abs(self.force[rest]).max() > 2.0 * limit:
            return False
        at, values = self.time[rest] - self.time[rest].mean(), self.displacement[rest]
        slope = float(slope_of_line(at, values))
        noise = values - values.mean() - slope * at
        still = 3.0 * float(noise.std()) + 1e-9 * float(np.ptp(self.displacement))
        return abs(slope) * float(np.ptp(at)) <= still


def _last_flagged(flags: Flags) -> Ints:
    """Return the last flagged sample of each row, or -1."""
    count: int = flags.shape[1]
    last: Ints = np.where(flags.any(axis=1), count - 1 - np.argmax(flags[:, ::-1], axis=1), -1)
    return last


def _zero_time(time: Floats, force: Floats) -> Floats:
    """Return when a falling line is zero, s, shape (...), or NaN."""
    return zero_of_line(time, -force)
