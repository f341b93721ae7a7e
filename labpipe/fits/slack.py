"""Slack: the travel before a specimen is taut, by toe compensation or from a loading branch."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labpipe.fits.least_squares import line_in, zero_of_line
from labpipe.records.arrays import Floats, Ints, Samples, samples_of
from labpipe.records.estimates import Failure
from labpipe.uncertainty.autocorrelation import fast_noise, limits_by_noise

_LEAST = 8
_CLEAR = 4.0
"""Standard deviations of noise above which a force is not zero."""
_FOOT = 5.0
"""Limits up to which the foot of the force is taken for straight."""
_LEAST_AT_FOOT = 8


def toe_line(
    displacement: Floats, force: Floats, *, start_share: float, stop_share: float
) -> Samples | Failure:
    """Samples of the linear region whose line says where the specimen is taut.

    Parameters
    ----------
    displacement, force : shape (n,), m, N; the loading branch in order of time, force zeroed;
        NaN in either are left out
    start_share, stop_share : of the largest force; the samples between the first rise to one and
        the first rise to the other

    Returns
    -------
    The samples, or a failure: ``too_few_samples`` (fewer than 8 in the region), ``not_rising`` when
    the force does not rise there, ``not_reached`` when the branch begins above the lower share. The
    slack is where the line through them is zero: `labpipe.fits.least_squares.zero_of_line`.

    Notes
    -----
    Toe compensation of ASTM D638, annex A1 (also D882): the tangent to the linear region is carried
    to zero force, and its foot is the corrected zero of displacement. A rise is where the force
    crosses a share: halfway between the first sample above and the last one below before the peak,
    so that single noisy samples do not choose the region.

    Examples
    --------
    >>> d = np.linspace(0.0, 0.02, 401)
    >>> force = 5000.0 * np.maximum(d - 0.002, 0.0)
    >>> region = toe_line(d, force, start_share=0.1, stop_share=0.3)
    >>> round(1e3 * float(zero_of_line(d[region], force[region])), 9)
    2.0
    """
    finite = np.flatnonzero(~np.isnan(displacement) & ~np.isnan(force))
    d, f = displacement[finite], force[finite]
    if len(d) < _LEAST:
        return Failure("too_few_samples", f"{len(d)} samples, {_LEAST} are needed")
    top = int(np.argmax(f))
    first, last = (
        _rise(f[: top + 1], share * float(f[top])) for share in (start_share, stop_share)
    )
    if first == 0:
        message = f"the branch begins at {f[0]:.4g} N, above {start_share:.0%} of {f[top]:.4g} N"
        return Failure("not_reached", message)
    if last - first < _LEAST:
        message = f"{max(last - first, 0)} samples in the linear region, {_LEAST} are needed"
        return Failure("too_few_samples", message)
    region = slice(first, last)
    if np.isnan(zero_of_line(d[region], f[region])):
        return Failure("not_rising", "the force does not rise in the linear region")
    return samples_of(finite[region])


def _rise(force: Floats, height: float) -> int:
    """Sample at which a rising force crosses a height."""
    above = np.flatnonzero(force >= height)
    below = np.flatnonzero(force < height)
    if len(above) == 0 or len(below) == 0:
        return 0
    return (int(above[0]) + int(below[-1]) + 1) // 2


@dataclass(frozen=True, slots=True, eq=False)
class TakeUp:
    """From which samples of a loading branch it is read where the force begins.

    Parameters
    ----------
    known : samples of the branch with a force and a displacement
    top : number among them of the largest force
    sample : first one of the branch whose force is not zero
    foot : of the force
    is_line : whether the place is where a line through the foot is zero; else it is that of the
        foot's first sample, as no line rises there
    limit : N, up to which a force passes for zero
    """

    known: Samples
    top: int
    sample: int
    foot: Samples
    is_line: bool
    limit: float

    def of(self, displacement: Floats, force: Floats) -> Floats:
        """Displacement at zero force, m, shape (...); NaN where the line does not rise.

        Parameters
        ----------
        displacement, force : shape (..., n), m, N, of the branch
        """
        d = displacement[..., self.foot]
        return zero_of_line(d, force[..., self.foot]) if self.is_line else d[..., 0]

    def of_each(self, displacement: Floats, force: Floats) -> tuple[Floats, Ints]:
        """Displacement at zero force, and the first sample that is not zero, decided for each row.

        Parameters
        ----------
        displacement, force : shape (rows, n), m, N, of the branch with noise: how far it hides the
            foot is part of the number; NaN in the same samples as the branch decided on

        Returns
        -------
        Shapes (rows,), m and samples.
        """
        displacement, force = displacement[:, self.known], force[:, self.known]
        limit = limits_by_noise(self.limit, force)[:, np.newaxis]
        within = force[:, : self.top] <= limit
        first = np.where(within.any(1), self.top - np.argmax(within[:, ::-1], 1), 0)
        low, count = int(first.min()), force.shape[1]
        numbers = np.arange(low, count)
        beyond = (force[:, low:] > _FOOT * limit) & (numbers >= first[:, np.newaxis])
        last = np.where(beyond.any(1), low + np.argmax(beyond, 1), count)
        last = np.maximum(last, first + _LEAST_AT_FOOT)
        part = slice(low, min(int(last.max()), count))
        d, f = displacement[:, part], force[:, part]
        numbers = numbers[: part.stop - low]
        foot = (numbers >= first[:, np.newaxis]) & (numbers < last[:, np.newaxis])
        middle, level, slope = line_in(foot, d, f)
        at = middle - level / np.where(slope > 0.0, slope, np.nan)
        begins: Floats = np.take_along_axis(displacement, first[:, np.newaxis], axis=1)[:, 0]
        finite = self.known
        samples = first + finite.start if isinstance(finite, slice) else finite[first]
        return np.where(np.isnan(at), begins, at), samples


def take_up(
    displacement: Floats, force: Floats, *, limit: float | None = None, steps: int = 1
) -> TakeUp | Failure:
    """Decide from which samples of a loading branch it is read where the force begins.

    Parameters
    ----------
    displacement, force : shape (n,), m, N; one loading branch in order of time, evenly sampled; NaN
        in either are passed over
    limit : N, up to which a force passes for zero; None for what the noise of the force says, which
        a curve without noise does not show
    steps : that each sampling step has been divided into: the foot holds as many times more samples

    Returns
    -------
    The samples, or a failure: ``too_few_samples`` (16 are needed), ``not_unloaded`` when the branch
    begins under a force that it cannot be followed back from, ``no_force`` when its force is
    nowhere above its noise.

    Notes
    -----
    Zero is a force within its noise: four standard deviations of the fast noise of the force. The
    foot of the force begins behind the last sample within that limit before the largest force, and
    ends at five limits; a straight line through it (eight samples at least) is followed back to
    zero force. Where the force comes from below zero, as after bending to the other side, the
    place is where it passes zero.

    Examples
    --------
    >>> d = np.linspace(0.0, 0.01, 400)
    >>> force = 500.0 * np.maximum(d - 0.002, 0.0)
    >>> found = take_up(d, force)
    >>> round(1e3 * float(found.of(d, force)), 6)
    2.0
    """
    # The line through the foot is extrapolated back by at most this share of the branch.
    max_extrapolation = 0.02
    finite = np.flatnonzero(~np.isnan(displacement) & ~np.isnan(force))
    if len(finite) < 2 * _LEAST_AT_FOOT:
        return Failure("too_few_samples", f"{len(finite)} samples, {2 * _LEAST_AT_FOOT} are needed")
    d, f = displacement[finite], force[finite]
    limit = _CLEAR * float(fast_noise(f)) if limit is None else limit
    top = int(np.argmax(f))
    if f[top] <= limit:
        message = f"the force reaches {f[top]:.4g} N, its noise is {limit:.4g} N"
        return Failure("no_force", message)
    within = np.flatnonzero(f[:top] <= limit)
    first = int(within[-1]) + 1 if len(within) else 0
    beyond = np.flatnonzero(f[first:] > _FOOT * limit)
    least = steps * _LEAST_AT_FOOT
    last = first + max(least, int(beyond[0]) if len(beyond) else len(f) - first)
    at = float(zero_of_line(d[first:last], f[first:last]))
    is_line = not np.isnan(at)
    if not len(within) and not (is_line and at >= d[0] - max_extrapolation * float(np.ptp(d))):
        message = f"the branch begins at {f[0]:.4g} N, its noise is {limit:.4g} N"
        return Failure("not_unloaded", message)
    foot = samples_of(finite[first:last])
    return TakeUp(samples_of(finite), top, int(finite[first]), foot, is_line, limit)
