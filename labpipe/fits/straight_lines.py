"""Straight lines over a stretch of a curve, and what follows: machine compliance, moduli."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labpipe.records.arrays import Floats, Samples, samples_of
from labpipe.records.estimates import Estimate, Failure, scaled
from labpipe.uncertainty.linear_fits import LinearFit, fit_linear

LEAST_OF_LINE = 8
"""Samples that a line is drawn through."""


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
    Intervals from `labpipe.uncertainty.linear_fits.fit_linear`: they hold for noise correlated over
    up to a tenth of the stretch, and grow where the stretch is not straight. The displacement
    counts as exact, as that of a crosshead encoder nearly is: noise of standard deviation s on it
    lowers the slope by the share s^2 / var(displacement) (Fuller, Measurement Error Models, 1987,
    sec. 1.1). For a displacement seen by cameras see `labpipe.fits.loops.secant_stiffness`.

    Examples
    --------
    >>> d = np.linspace(0.002, 0.008, 61)
    >>> line = fit_line(d, 1.5 + 4000.0 * d)
    >>> round(line.slope.value, 6), round(line.intercept.value, 9)
    (4000.0, 1.5)
    """
    known = ~np.isnan(displacement) & ~np.isnan(force)
    d, f = displacement[known], force[known]
    if len(d) < LEAST_OF_LINE:
        return Failure(
            "too_few_samples", f"{len(d)} samples in the stretch, {LEAST_OF_LINE} are needed"
        )
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


def compliance_window(
    displacement: Floats, force: Floats, *, start: float, stop: float
) -> Samples | Failure:
    """Samples between which the force first rises from one value to another.

    Parameters
    ----------
    displacement, force : shape (n,), m, N; the loading branch of a stiff-bar test; NaN in either
        are left out
    start, stop : N, force window; below it grips and joints settle

    Returns
    -------
    The samples, or a failure: ``too_few_samples``, ``no_travel`` when the force stands still,
    ``not_reached`` when it does not reach `stop`.
    """
    known = np.flatnonzero(~np.isnan(displacement) & ~np.isnan(force))
    f = force[known]
    if len(f) == 0 or float(f.max()) < stop:
        most = float(f.max()) if len(f) else 0.0
        return Failure(
            "not_reached", f"the force reaches {most:.4g} N, the window ends at {stop:.4g} N"
        )
    last = int(np.argmax(f >= stop))
    below = np.flatnonzero(f[:last] < start)
    inside = known[int(below[-1]) + 1 if len(below) else 0 : last + 1]
    if len(inside) < LEAST_OF_LINE:
        message = f"{len(inside)} samples in the stretch, {LEAST_OF_LINE} are needed"
        return Failure("too_few_samples", message)
    if np.ptp(force[inside]) == 0.0:
        return Failure("no_travel", "the force does not change over the stretch")
    return samples_of(inside)


def fit_compliance(
    displacement: Floats, force: Floats, *, start: float, stop: float
) -> Estimate | Failure:
    """Compliance of frame, load cell and grips: displacement per force with a stiff bar gripped.

    Parameters
    ----------
    displacement, force : shape (n,), m, N; the loading branch of the stiff-bar test; NaN in either
        are left out
    start, stop : N, force window; below it grips and joints settle

    Returns
    -------
    m/N, or a failure: ``too_few_samples``, ``no_travel``, ``not_reached`` when the force does not
    reach `stop`, ``not_positive`` when the displacement does not grow with the force.

    Notes
    -----
    The slope of displacement against force of ASTM D3379 (sec. on system compliance) with one bar
    whose own compliance does not matter. The window is cut where the force first rises through its
    ends. Interval as in `labpipe.fits.straight_lines.fit_line`.
    """
    inside = compliance_window(displacement, force, start=start, stop=stop)
    if isinstance(inside, Failure):
        return inside
    line = fit_line(force[inside], displacement[inside])
    if isinstance(line, Failure):
        return line
    if line.slope.value <= 0.0:
        return Failure("not_positive", f"slope {line.slope.value:.4g} m/N")
    return line.slope


def correct_displacement(displacement: Floats, force: Floats, *, compliance: float) -> Floats:
    """Displacement of the specimen alone: d - C F.

    Parameters
    ----------
    displacement, force : shape (n,), m, N; NaN where either is NaN
    compliance : m/N, of frame and grips

    Returns
    -------
    shape (n,), m
    """
    corrected: Floats = displacement - compliance * force
    return corrected


def rectangle_area(width: float, thickness: float) -> float:
    """Area of a rectangle, m^2: width x thickness, both in m."""
    return width * thickness


def annulus_area(outer_diameter: float, inner_diameter: float) -> float:
    """Area of a ring, m^2: pi (OD^2 - ID^2) / 4, diameters in m."""
    return 0.25 * float(np.pi) * (outer_diameter**2 - inner_diameter**2)


def thin_wall_area(outer_diameter: float, wall: float) -> float:
    """Area of a tube of stated wall, m^2: pi (OD - t) t, both in m.

    For a corrugated tube, whose outer and inner diameter hold the height of the folds, this is
    another area than `annulus_area`: a modulus has to say which one it refers to.
    """
    return float(np.pi) * (outer_diameter - wall) * wall


def modulus(
    stiffness: Estimate,
    *,
    gauge_length: float,
    area: float,
    length_uncertainty: float = 0.0,
    area_uncertainty: float = 0.0,
) -> Estimate:
    """Modulus of a bar: stiffness x gauge length / area.

    Parameters
    ----------
    stiffness : N/m
    gauge_length : m
    area : m^2, such as `annulus_area` gives
    length_uncertainty, area_uncertainty : standard uncertainties as shares of the values

    Returns
    -------
    Pa; relative variances of independent factors are added (GUM, JCGM 100:2008, eq. 12).

    Examples
    --------
    >>> area = rectangle_area(0.01879, 0.28e-3)
    >>> tape = modulus(Estimate(70e3, 700.0, 200), gauge_length=0.3, area=area)
    >>> round(tape.value / 1e9, 3), round(tape.error / tape.value, 4)
    (3.991, 0.01)
    """
    factor = gauge_length / area
    others = abs(stiffness.value) * float(np.hypot(length_uncertainty, area_uncertainty))
    return scaled(stiffness, factor, more=others)


def stiffness_per_peak_force(stiffness: Estimate, peak_force: Estimate) -> Estimate:
    """Stiffness over the largest force of the same sample, 1/m.

    Parameters
    ----------
    stiffness : N/m
    peak_force : N, positive

    Returns
    -------
    1/m. The errors of both are taken for independent, which noise is: the peak lies outside the
    window of the line. A gain error of the load cell cancels and must not be in either.

    Examples
    --------
    >>> found = stiffness_per_peak_force(Estimate(5000.0, 25.0, 300), Estimate(100.0, 0.5, 40))
    >>> found.value, round(found.error, 6)
    (50.0, 0.353553)
    """
    share = peak_force.error / peak_force.value
    return scaled(stiffness, 1.0 / peak_force.value, more=abs(stiffness.value) * share)
