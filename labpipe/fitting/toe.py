"""Slack: the travel before a specimen is taut, by toe compensation."""

from __future__ import annotations

import numpy as np

from labpipe.fitting.correlated import LinearFit, fit_linear
from labpipe.fitting.estimates import Estimate, Failure
from labpipe.records.arrays import Floats
from labpipe.records.curve import Interval

_LEAST = 8


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
    m, with an interval that may be lopsided, or a failure: ``too_few_samples`` (fewer than 8 in
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
    known = ~np.isnan(displacement) & ~np.isnan(force)
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
    return _foot(d[first:last], f[first:last])


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
