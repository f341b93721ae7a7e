"""Slack: the travel before a specimen is taut, by toe compensation or from a loading branch."""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot

import numpy as np

from labpipe.fits.least_squares import line_in, slope_of_line, zero_of_line
from labpipe.records.arrays import Floats, Ints, Samples, samples_of
from labpipe.records.curve import Interval
from labpipe.records.estimates import Estimate, Failure
from labpipe.uncertainty.linear_fits import LinearFit, fit_linear
from labpipe.uncertainty.noise import fast_noise, long_run_variance

_LEAST = 8
_CLEAR = 4.0
"""Standard deviations of noise above which a force is not zero."""
_FOOT = 5.0
"""Limits up to which the foot of the force is taken for straight."""
_LEAST_AT_FOOT = 8
_BACK = 0.02
"""Share of the branch that a line through its foot may be followed back beyond its beginning."""


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
    slack is where the line through them is zero: `labpipe.fits.straight_lines.zero_of_line`.
    """
    known = np.flatnonzero(~np.isnan(displacement) & ~np.isnan(force))
    d, f = displacement[known], force[known]
    if len(d) < _LEAST:
        return Failure("too_few_samples", f"{len(d)} samples, {_LEAST} are needed")
    top = int(np.argmax(f))
    first, last = (
        _rise(f[: top + 1], share * float(f[top])) for share in (start_share, stop_share)
    )
    if first == 0:
        found = f"the branch begins at {f[0]:.4g} N, above {start_share:.0%} of {f[top]:.4g} N"
        return Failure("not_reached", found)
    if last - first < _LEAST:
        found = f"{max(last - first, 0)} samples in the linear region, {_LEAST} are needed"
        return Failure("too_few_samples", found)
    region = slice(first, last)
    if np.isnan(zero_of_line(d[region], f[region])):
        return Failure("not_rising", "the force does not rise in the linear region")
    return samples_of(known[region])


def fit_slack(
    displacement: Floats, force: Floats, *, start_share: float, stop_share: float
) -> Estimate | Failure:
    """Displacement at which the line through the linear region meets zero force.

    Parameters
    ----------
    displacement, force : shape (n,), m, N; the loading branch in order of time, force zeroed;
        NaN in either are left out
    start_share, stop_share : of the largest force; the line goes through the samples between the
        first rise to one and the first rise to the other

    Returns
    -------
    m, with an interval that may be asymmetric, or a failure: ``too_few_samples`` (fewer than 8 in
    the region), ``not_rising`` when the force does not rise there, ``not_reached`` when the branch
    begins above the lower share.

    Notes
    -----
    Toe compensation of ASTM D638, annex A1 (also D882): the tangent to the linear region is carried
    to zero force, and its foot is the corrected zero of displacement. The interval is Fieller's
    (J. R. Stat. Soc. B 16 (1954) 175) with the covariance of the line for correlated noise. A rise
    is where the force crosses a share: halfway between the first sample above and the last one
    below before the peak, so that single noisy samples do not choose the region.
    """
    region = toe_line(displacement, force, start_share=start_share, stop_share=stop_share)
    if isinstance(region, Failure):
        return region
    return _foot(displacement[region], force[region])


def _rise(force: Floats, height: float) -> int:
    """Sample at which a rising force crosses a height."""
    above = np.flatnonzero(force >= height)
    below = np.flatnonzero(force < height)
    if len(above) == 0 or len(below) == 0:
        return 0
    return (int(above[0]) + int(below[-1]) + 1) // 2


def _foot(d: Floats, f: Floats) -> Estimate | Failure:
    middle = float(d.mean())
    fit = fit_linear(np.column_stack([np.ones_like(d), d - middle]), f)
    level, slope = (float(value) for value in fit.coefficients)
    if slope - float(fit.half_widths[1]) <= 0.0:
        found = f"slope {slope:.4g} -+ {fit.half_widths[1]:.2g} N/m in the linear region"
        return Failure("not_rising", found)
    lower, upper = _fieller(fit)
    at = -level / slope
    gradient = np.array([-1.0 / slope, level / slope**2])
    error = float(np.sqrt(gradient @ fit.covariance @ gradient))
    return Estimate(middle + at, error, fit.n, Interval(middle + lower, middle + upper))


def _fieller(fit: LinearFit) -> tuple[float, float]:
    """Roots of (level + slope x)^2 = q^2 var(level + slope x); slope is known to be positive."""
    level, slope = fit.coefficients
    spread = fit.quantile**2 * fit.covariance
    a, b, c = slope**2 - spread[1, 1], level * slope - spread[0, 1], level**2 - spread[0, 0]
    root = float(np.sqrt(max(b * b - a * c, 0.0)))
    return float((-b - root) / a), float((-b + root) / a)


@dataclass(frozen=True, slots=True, eq=False)
class BranchSlack:
    """Where the force begins.

    Parameters
    ----------
    displacement : m, at zero force
    sample : first one of the branch whose force is not zero
    """

    displacement: Estimate
    sample: int


def find_branch_slack(
    displacement: Floats, force: Floats, *, zero_error: float = 0.0
) -> BranchSlack | Failure:
    """Displacement at which a loading branch takes up force.

    Parameters
    ----------
    displacement, force : shape (n,), m, N; one loading branch in order of time, evenly sampled; NaN
        in either are passed over
    zero_error : N, standard error of the force's zero

    Returns
    -------
    The place, or a failure: ``too_few_samples`` (16 are needed), ``not_unloaded`` when the branch
    begins under a force that it cannot be followed back from, ``no_force`` when its force is
    nowhere above its noise.

    Notes
    -----
    Zero is a force within its noise: four standard deviations of the fast noise of the force. The
    foot of the force begins behind the last sample within that limit before the largest force, and
    ends at five limits; a straight line through it (eight samples at least) is followed back to
    zero force. Where the force comes from below zero, as after bending to the other side, the
    place is where it passes zero. The error is that of the line, and of the force's zero.

    Examples
    --------
    >>> d = np.linspace(0.0, 0.01, 400)
    >>> found = find_branch_slack(d, 500.0 * np.maximum(d - 0.002, 0.0))
    >>> round(1e3 * found.displacement.value, 6)
    2.0
    """
    found = take_up(displacement, force)
    if isinstance(found, Failure):
        return found
    d, f = displacement[found.foot], force[found.foot]
    if not found.is_line:
        return BranchSlack(Estimate(float(d[0]), float(np.ptp(d)), len(d)), found.sample)
    lever, slope, at = d - d.mean(), float(slope_of_line(d, f)), float(zero_of_line(d, f))
    variance = long_run_variance(f - f.mean() - slope * lever, parameters=2)
    back = at - float(d.mean())
    at_zero = float(np.sqrt(variance * (1.0 / len(d) + back**2 / (lever @ lever))))
    error = hypot(at_zero, zero_error) / slope
    return BranchSlack(Estimate(at, error, len(d)), found.sample)


@dataclass(frozen=True, slots=True, eq=False)
class TakeUp:
    """From which samples of a loading branch it is read where the force begins.

    Parameters
    ----------
    sample : first one of the branch whose force is not zero
    top : sample of the largest force
    foot : of the force
    is_line : whether the place is where a line through the foot is zero; else it is that of the
        foot's first sample, as no line rises there
    limit : N, up to which a force passes for zero
    """

    sample: int
    top: int
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
            foot is part of the number

        Returns
        -------
        Shapes (rows,), m and samples.
        """
        within = force[:, : self.top] <= self.limit
        first = np.where(within.any(1), self.top - np.argmax(within[:, ::-1], 1), 0)
        low, count = int(first.min()), force.shape[1]
        numbers = np.arange(low, count)
        beyond = (force[:, low:] > _FOOT * self.limit) & (numbers >= first[:, np.newaxis])
        last = np.where(beyond.any(1), low + np.argmax(beyond, 1), count)
        last = np.maximum(last, first + _LEAST_AT_FOOT)
        part = slice(low, min(int(last.max()), count))
        d, f = displacement[:, part], force[:, part]
        numbers = numbers[: part.stop - low]
        foot = (numbers >= first[:, np.newaxis]) & (numbers < last[:, np.newaxis])
        foot &= ~np.isnan(d) & ~np.isnan(f)
        middle, level, slope = line_in(foot, d, f)
        at = middle - level / np.where(slope > 0.0, slope, np.nan)
        begins: Floats = np.take_along_axis(displacement, first[:, np.newaxis], axis=1)[:, 0]
        return np.where(np.isnan(at), begins, at), first


def take_up(displacement: Floats, force: Floats, *, limit: float | None = None) -> TakeUp | Failure:
    """Decide from which samples of a loading branch it is read where the force begins.

    Parameters
    ----------
    displacement, force : shape (n,), m, N; one loading branch in order of time, evenly sampled; NaN
        in either are passed over
    limit : N, up to which a force passes for zero; None for what the noise of the force says, which
        a curve without noise does not show

    Returns
    -------
    The samples, or a failure as `find_branch_slack` has it; its notes say how.
    """
    known = np.flatnonzero(~np.isnan(displacement) & ~np.isnan(force))
    if len(known) < 2 * _LEAST_AT_FOOT:
        return Failure("too_few_samples", f"{len(known)} samples, {2 * _LEAST_AT_FOOT} are needed")
    d, f = displacement[known], force[known]
    limit = _CLEAR * fast_noise(f) if limit is None else limit
    top = int(np.argmax(f))
    if f[top] <= limit:
        found = f"the force reaches {f[top]:.4g} N, its noise is {limit:.4g} N"
        return Failure("no_force", found)
    within = np.flatnonzero(f[:top] <= limit)
    first = int(within[-1]) + 1 if len(within) else 0
    beyond = np.flatnonzero(f[first:] > _FOOT * limit)
    last = first + max(_LEAST_AT_FOOT, int(beyond[0]) if len(beyond) else len(f) - first)
    at = float(zero_of_line(d[first:last], f[first:last]))
    is_line = not np.isnan(at)
    if not len(within) and not (is_line and at >= d[0] - _BACK * float(np.ptp(d))):
        found = f"the branch begins at {f[0]:.4g} N, its noise is {limit:.4g} N"
        return Failure("not_unloaded", found)
    foot = samples_of(known[first:last])
    return TakeUp(int(known[first]), int(known[top]), foot, is_line, limit)
