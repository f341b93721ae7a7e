"""Slack: travel before a specimen is taut, by toe compensation or from a loading branch."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labpipe.fits.common_path import finite_samples
from labpipe.fits.least_squares import line_in, zero_of_line
from labpipe.records.arrays import Floats, Ints, Samples, samples_of
from labpipe.records.estimates import Failure
from labpipe.uncertainty.autocorrelation import fast_noise, limits_by_noise

_MIN_REGION_SAMPLES = 8
_NOISE_DEVIATIONS = 4.0
"""Standard deviations of noise above which a force is not zero."""
_FOOT_LIMITS = 5.0
"""The foot of the force, below this multiple of the limit, is taken as straight."""
_MIN_FOOT_SAMPLES = 8


def toe_line(
    displacement: Floats, force: Floats, *, start_share: float, stop_share: float
) -> Samples | Failure:
    """Find the samples of the linear region for toe compensation.

    Parameters
    ----------
    displacement, force : shape (n,), m, N; the loading branch in order of time, force zeroed;
        NaN are ignored
    start_share, stop_share : shares of the largest force between which the region lies

    Returns
    -------
    The samples, or a failure: ``too_few_samples`` (fewer than 8 in the region), ``not_rising`` if
    the force does not rise there, ``not_reached`` if the branch begins above the lower share. The
    slack is the zero of the line through them: `labpipe.fits.least_squares.zero_of_line`.

    Notes
    -----
    Toe compensation of ASTM D638, annex A1 (also D882): the tangent to the linear region is
    extrapolated to zero force, the corrected zero of displacement. The force crosses a share
    halfway between the first sample above and the last one below before the peak, so that single
    noisy samples do not determine the region.

    Examples
    --------
    >>> d = np.linspace(0.0, 0.02, 401)
    >>> force = 5000.0 * np.maximum(d - 0.002, 0.0)
    >>> region = toe_line(d, force, start_share=0.1, stop_share=0.3)
    >>> round(1e3 * float(zero_of_line(d[region], force[region])), 9)
    2.0
    """
    finite = finite_samples(displacement, force)
    d, f = displacement[finite], force[finite]
    if len(d) < _MIN_REGION_SAMPLES:
        return Failure("too_few_samples", f"{len(d)} samples, {_MIN_REGION_SAMPLES} are needed")
    top = int(np.argmax(f))
    first, last = (
        _rise(f[: top + 1], share * float(f[top])) for share in (start_share, stop_share)
    )
    if first == 0:
        message = f"the branch begins at {f[0]:.4g} N, above {start_share:.0%} of {f[top]:.4g} N"
        return Failure("not_reached", message)
    if last - first < _MIN_REGION_SAMPLES:
        message = (
            f"{max(last - first, 0)} samples in the linear region, {_MIN_REGION_SAMPLES} are needed"
        )
        return Failure("too_few_samples", message)
    region = slice(first, last)
    if np.isnan(zero_of_line(d[region], f[region])):
        return Failure("not_rising", "the force does not rise in the linear region")
    return samples_of(finite[region])


def _rise(force: Floats, height: float) -> int:
    """Return the sample at which a rising force crosses a height."""
    above = np.flatnonzero(force >= height)
    below = np.flatnonzero(force < height)
    if len(above) == 0 or len(below) == 0:
        return 0
    return (int(above[0]) + int(below[-1]) + 1) // 2


@dataclass(frozen=True, slots=True, eq=False)
class TakeUp:
    """Samples of a loading branch for the start of its force.

    Parameters
    ----------
    samples : of the branch, with a force and a displacement
    top : number among them of the largest force
    sample : first one of the branch whose force is not zero
    foot : samples of the foot of the force
    is_line : whether the start is the zero of a line through the foot; else it is the first sample
        of the foot, as no line rises there
    limit : N, up to which a force counts as zero
    """

    samples: Samples
    top: int
    sample: int
    foot: Samples
    is_line: bool
    limit: float

    def of(self, displacement: Floats, force: Floats) -> Floats:
        """Return the displacement at zero force, m, shape (...); NaN if the line does not rise.

        Parameters
        ----------
        displacement, force : shape (..., n), m, N, of the branch
        """
        d = displacement[..., self.foot]
        return zero_of_line(d, force[..., self.foot]) if self.is_line else d[..., 0]

    def of_each(self, displacement: Floats, force: Floats) -> tuple[Floats, Ints]:
        """Return displacement at zero force and first sample above zero, chosen for each row.

        Parameters
        ----------
        displacement, force : shape (rows, n), m, N, of the branch with noise, which hides a
            part of the foot; NaN in the same samples as the reference branch

        Returns
        -------
        Shapes (rows,), m and samples.
        """
        displacement, force = displacement[:, self.samples], force[:, self.samples]
        limit = limits_by_noise(self.limit, force)[:, np.newaxis]
        within = force[:, : self.top] <= limit
        first = np.where(within.any(1), self.top - np.argmax(within[:, ::-1], 1), 0)
        low, count = int(first.min()), force.shape[1]
        numbers = np.arange(low, count)
        beyond = (force[:, low:] > _FOOT_LIMITS * limit) & (numbers >= first[:, np.newaxis])
        last = np.where(beyond.any(1), low + np.argmax(beyond, 1), count)
        last = np.maximum(last, first + _MIN_FOOT_SAMPLES)
        part = slice(low, min(int(last.max()), count))
        d, f = displacement[:, part], force[:, part]
        numbers = numbers[: part.stop - low]
        foot = (numbers >= first[:, np.newaxis]) & (numbers < last[:, np.newaxis])
        middle, level, slope = line_in(foot, d, f)
        at = middle - level / np.where(slope > 0.0, slope, np.nan)
        begins: Floats = np.take_along_axis(displacement, first[:, np.newaxis], axis=1)[:, 0]
        finite = self.samples
        numbers = first + finite.start if isinstance(finite, slice) else finite[first]
        return np.where(np.isnan(at), begins, at), numbers


def take_up(
    displacement: Floats, force: Floats, *, limit: float | None = None, steps: int = 1
) -> TakeUp | Failure:
    """Choose the samples of a loading branch for the start of its force.

    Parameters
    ----------
    displacement, force : shape (n,), m, N; one loading branch in order of time, evenly sampled; NaN
        are ignored
    limit : N, up to which a force counts as zero, for a curve without noise; None for a limit from
        the noise of the force
    steps : parts that each sampling step has been divided into

    Returns
    -------
    The samples, or a failure: ``too_few_samples`` (16 are needed), ``not_unloaded`` if the branch
    begins under a force too large for extrapolation, ``no_force`` if its force is never above its
    noise.

    Notes
    -----
    A force within four standard deviations of its fast noise counts as zero. The foot of the force
    begins after the last sample within that limit before the largest force, and ends at five
    limits; a straight line through it (at least eight samples) is extrapolated to zero force. If
    the force comes from below zero, as after bending to the other side, this is its crossing.

    Examples
    --------
    >>> d = np.linspace(0.0, 0.01, 400)
    >>> force = 500.0 * np.maximum(d - 0.002, 0.0)
    >>> found = take_up(d, force)
    >>> round(1e3 * float(found.of(d, force)), 6)
    2.0
    """
    max_extrapolation = 0.02  # share of the branch
    finite = finite_samples(displacement, force)
    if len(finite) < 2 * _MIN_FOOT_SAMPLES:
        return Failure(
            "too_few_samples", f"{len(finite)} samples, {2 * _MIN_FOOT_SAMPLES} are needed"
        )
    d, f = displacement[finite], force[finite]
    limit = _NOISE_DEVIATIONS * float(fast_noise(f)) if limit is None else limit
    top = int(np.argmax(f))
    if f[top] <= limit:
        message = f"the force reaches {f[top]:.4g} N, its noise is {limit:.4g} N"
        return Failure("no_force", message)
    within = np.flatnonzero(f[:top] <= limit)
    first = int(within[-1]) + 1 if len(within) else 0
    beyond = np.flatnonzero(f[first:] > _FOOT_LIMITS * limit)
    least = steps * _MIN_FOOT_SAMPLES
    last = first + max(least, int(beyond[0]) if len(beyond) else len(f) - first)
    at = float(zero_of_line(d[first:last], f[first:last]))
    is_line = not np.isnan(at)
    if not len(within) and not (is_line and at >= d[0] - max_extrapolation * float(np.ptp(d))):
        message = f"the branch begins at {f[0]:.4g} N, its noise is {limit:.4g} N"
        return Failure("not_unloaded", message)
    foot = samples_of(finite[first:last])
    return TakeUp(samples_of(finite), top, int(finite[first]), foot, is_line, limit)
