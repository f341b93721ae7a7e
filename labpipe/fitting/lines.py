"""Straight lines over a stretch of a curve."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labpipe.fitting.correlated import LinearFit, fit_linear
from labpipe.fitting.estimates import Estimate, Failure
from labpipe.records.arrays import Floats

_LEAST = 8


@dataclass(frozen=True, slots=True, eq=False)
class StraightLine:
    """F = intercept + slope x d over a stretch.

    Parameters
    ----------
    slope : N/m
    intercept : N, at displacement zero
    classical_slope_error, classical_intercept_error : standard errors that textbooks give, right
        only for independent residuals
    residual_deviation : N, with n - 2 degrees of freedom
    start, stop : m, least and greatest displacement that entered
    n : number of samples
    """

    slope: Estimate
    intercept: Estimate
    classical_slope_error: float
    classical_intercept_error: float
    residual_deviation: float
    start: float
    stop: float
    n: int


def fit_line(displacement: Floats, force: Floats) -> StraightLine | Failure:
    """Straight line by ordinary least squares, with intervals that hold in correlated noise.

    Parameters
    ----------
    displacement, force : shape (n,), m, N; the samples of the stretch in order of time, evenly
        sampled; NaN in either are left out

    Returns
    -------
    The line, or a failure: ``too_few_samples`` (fewer than 8), ``no_travel``.

    Notes
    -----
    Intervals from `labpipe.fitting.correlated.fit_linear`: they hold for noise that is correlated
    over up to a tenth of the stretch, and grow where the stretch is not straight. The displacement
    counts as exact, as that of a crosshead encoder nearly is: noise of standard deviation s on it
    lowers the slope by the share s^2 / var(displacement) (Fuller, Measurement Error Models, 1987,
    sec. 1.1). For a displacement seen by cameras see `labpipe.fitting.loops.secant_stiffness`.

    Examples
    --------
    >>> d = np.linspace(0.002, 0.008, 61)
    >>> line = fit_line(d, 1.5 + 4000.0 * d)
    >>> round(line.slope.value, 6), round(line.intercept.value, 9)
    (4000.0, 1.5)
    """
    known = ~np.isnan(displacement) & ~np.isnan(force)
    d, f = displacement[known], force[known]
    if len(d) < _LEAST:
        return Failure("too_few_samples", f"{len(d)} samples in the stretch, {_LEAST} are needed")
    if np.ptp(d) == 0.0:
        return Failure("no_travel", "the displacement does not change over the stretch")
    middle = float(d.mean())
    fit = fit_linear(np.column_stack([np.ones_like(d), d - middle]), f)
    return _straight_line(fit, d, middle)


def _straight_line(fit: LinearFit, d: Floats, middle: float) -> StraightLine:
    level_error, slope_error = fit.classical_errors
    return StraightLine(
        slope=fit.estimate(1),
        intercept=fit.along(np.array([1.0, -middle])),
        classical_slope_error=float(slope_error),
        classical_intercept_error=float(np.hypot(level_error, middle * slope_error)),
        residual_deviation=fit.residual_deviation,
        start=float(d.min()),
        stop=float(d.max()),
        n=fit.n,
    )
