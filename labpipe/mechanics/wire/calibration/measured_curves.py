"""Define measured loading curves, and compare them with models and with other curves.

References
----------
.. [1] *Modeling and characterization of wire harnesses for digital manufacturing applications*,
       dissertation.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass, replace

import numpy as np
from scipy.special import ndtr

from labpipe.mechanics.wire.cantilever import StringRig
from labpipe.records.arrays import ArrayRecord, Floats, Vector
from labpipe.records.wire import (
    CalibrationFailure,
    CurveAgreement,
    CurveErrors,
    CurveMatch,
    ExternalCurve,
)

MAX_DEFLECTION_RATIO = 0.65
"""Largest deflection of a measured curve, relative to the length.

At larger deflections, stations may unload (`wire.first_loading`).
"""


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredCurve(ArrayRecord):
    """Measured curve of first loading of one sample.

    Parameters
    ----------
    wire : name of the wire
    test : name of the test
    sample : name of the sample; all tests of a sample have the same factor on the force
    length : m, free length of the wire
    deflection : shape (n,), m, deflection of the tip from rest
    force : shape (n,), N, force of the load cell, zeroed at rest; `select_usable_curves` leaves out
        points at which force or deflection is NaN, or the deflection is negative
    noise : N, standard deviation of the force, one value or shape (n,). It includes the noise of
        the deflection times the slope of the curve
    rig : string and counterweight; None for an end load normal to the undeformed axis
    zero_error : N, standard error of the zero of the force
    offset_error : m, standard error of the common offset of the deflections, due to zero and clock
    scale_error : relative standard error of the scale of the deflection, common to all curves of a
        calibration
    curve_scale_error : relative standard error of the scale of the deflection in this curve alone
    self_weight : N/m, weight per length of the wire, which is level at rest
    """

    wire: str
    test: str
    sample: str
    length: float
    deflection: Vector
    force: Vector
    noise: float | Floats
    rig: StringRig | None = None
    zero_error: float = 0.0
    offset_error: float = 0.0
    scale_error: float = 0.0
    curve_scale_error: float = 0.0
    self_weight: float = 0.0

    def __post_init__(self) -> None:
        ArrayRecord.__post_init__(self)
        noise = np.broadcast_to(np.asarray(self.noise, np.float64), self.deflection.shape)
        object.__setattr__(self, "noise", noise)

    @property
    def setup(self) -> tuple[float, ...]:
        """Length, weight and rig; curves with the same values have the same model curve."""
        rig = () if self.rig is None else astuple(self.rig)
        return self.length, self.self_weight, *rig

    @property
    def peak(self) -> float:
        """Largest magnitude of the force, N."""
        return float(np.nanmax(np.abs(self.force)))

    @property
    def point_error(self) -> float:
        """Standard deviation of a force, N, as root mean square over the curve.

        Errors of the deflection are multiplied by the secant stiffness from rest to the peak.
        """
        slope = self.peak / float(np.nanmax(self.deflection))
        shared = compute_shared_errors(self, np.full(len(self.force), slope))
        return float(np.sqrt(np.nanmean(np.asarray(self.noise) ** 2 + np.sum(shared**2, axis=0))))


def compute_shared_errors(curve: MeasuredCurve, slope: Floats) -> Floats:
    """Compute the change of force for one standard error of each error that all points share.

    Parameters
    ----------
    curve : measured curve
    slope : shape (n,), N/m, derivative of the force with respect to deflection

    Returns
    -------
    Shape (3, n), N, for the zero of the force, and for offset and scale of the deflection.
    """
    zero = np.full(len(slope), curve.zero_error)
    scale = float(np.hypot(curve.scale_error, curve.curve_scale_error))
    return np.stack([zero, curve.offset_error * slope, scale * curve.deflection * slope])


def select_usable_curves(
    curves: tuple[MeasuredCurve, ...],
) -> tuple[MeasuredCurve, ...] | CalibrationFailure:
    """Select the finite points of curves on the side of the pull, and the curves with such points.

    Returns
    -------
    The curves, or a failure if a calibration cannot use them: ``no_sample_usable``,
    ``wires_mixed``, ``noise_not_positive`` or ``deflection_too_large``. The common error of the
    scale is multiplied by n^(1/2). It can then be treated as an independent error of each of the n
    curves.

    Notes
    -----
    A common error e of n curves shifts their mean by e. Independent errors of n^(1/2) e have the
    same effect on the mean, but reduce the weight of the differences between curves.
    """
    usable = tuple(_select_usable_points(curve) for curve in curves)
    usable = tuple(curve for curve in usable if len(curve.force))
    factor = np.sqrt(len(usable))
    usable = tuple(replace(curve, scale_error=factor * curve.scale_error) for curve in usable)
    if not usable:
        return CalibrationFailure.of("mechanics.wire.no_sample_usable", count=len(curves))
    wires = sorted({curve.wire for curve in usable})
    if len(wires) > 1:
        names, count = ", ".join(wires), len(wires)
        return CalibrationFailure.of("mechanics.wire.wires_mixed", count=count, names=names)
    for curve in usable:
        if not np.all(np.asarray(curve.noise) > 0.0):
            test, noise = curve.test, 1e3 * np.min(curve.noise)
            return CalibrationFailure.of(
                "mechanics.wire.noise_not_positive", test=test, noise=noise
            )
        deflection = float(np.max(curve.deflection))
        if deflection > MAX_DEFLECTION_RATIO * curve.length:
            return CalibrationFailure.of(
                "mechanics.wire.deflection_too_large",
                test=curve.test,
                deflection=1e3 * deflection,
                length=1e3 * curve.length,
                limit=MAX_DEFLECTION_RATIO,
            )
    return usable


def _select_usable_points(curve: MeasuredCurve) -> MeasuredCurve:
    """Return the curve without non-finite forces and deflections, and negative deflections."""
    is_usable = np.isfinite(curve.deflection) & np.isfinite(curve.force) & (curve.deflection >= 0.0)
    deflection, force = curve.deflection[is_usable], curve.force[is_usable]
    noise = np.asarray(curve.noise)[is_usable]
    return replace(curve, deflection=deflection, force=force, noise=noise)


def whiten(values: Floats, correlation: float) -> Floats:
    """Whiten first-order autoregressive noise of variance 1.

    Parameters
    ----------
    values : shape (n, ...), values in order of time, relative to the standard deviation of noise
    correlation : correlation of the noise of neighbouring values, at least 0 and below 1

    Returns
    -------
    Values with uncorrelated noise of variance 1, of the same shape.
    """
    if correlation == 0.0:
        return values
    white = values.copy()
    white[1:] -= correlation * values[:-1]
    white[1:] /= np.sqrt(1.0 - correlation**2)
    return white


def compute_curve_errors(
    force: Floats, model: Floats, lower: Floats | None = None, upper: Floats | None = None
) -> CurveErrors:
    """Compute the errors of a model at the points of a curve; NaNs are left out.

    Parameters
    ----------
    force, model : shape (n,), N, measured and modelled force
    lower, upper : shape (n,), N, limits of a band; None without a band

    Returns
    -------
    Number of points, SSE, RMSE, RMSE relative to the largest force, and fraction of the points
    inside the band, which is NaN without a band.

    Raises
    ------
    ValueError
        If no point has a measured and a modelled force.

    Notes
    -----
    SSE and RMSE are those of equations (3.28) and (3.29) of [1]_. SSE increases with the number of
    points.
    """
    is_valid = np.isfinite(force) & np.isfinite(model)
    if not is_valid.any():
        message = "no point has both a measured and a modelled force"
        raise ValueError(message)
    residuals = force[is_valid] - model[is_valid]
    sse = float(residuals @ residuals)
    rmse = float(np.sqrt(sse / len(residuals)))
    coverage = np.nan
    if lower is not None and upper is not None:
        coverage = float(np.mean(((lower <= force) & (force <= upper))[is_valid]))
    rmse_share = rmse / float(np.max(np.abs(force[is_valid])))
    return CurveErrors(len(residuals), sse, rmse, rmse_share, coverage)


def compare_with_model(curve: MeasuredCurve, model: Floats, factor: float) -> CurveAgreement:
    """Compare one curve with the model.

    Parameters
    ----------
    curve : measured curve
    model : shape (n,), N, force of the model without the factor of the sample
    factor : product of the factors of the sample and of the load cell

    Returns
    -------
    Errors of the model without the factor; correlation and runs test of the residuals from the
    model with the factor.
    """
    errors = compute_curve_errors(curve.force, model)
    residuals = (curve.force - factor * model) / np.asarray(curve.noise)
    return CurveAgreement(
        test=curve.test,
        sample=curve.sample,
        length=curve.length,
        deflection=curve.deflection,
        force=curve.force,
        model=model,
        sample_factor=factor,
        sse=errors.sse,
        rmse=errors.rmse,
        rmse_share=errors.rmse_share,
        lag_one_correlation=compute_lag_one_correlation(residuals),
        runs_p=compute_runs_p(residuals),
    )


def compute_lag_one_correlation(residuals: Floats) -> float:
    """Compute the correlation of neighbouring residuals about zero; 0 if all residuals are zero."""
    squares = float(residuals @ residuals)
    return float(residuals[1:] @ residuals[:-1]) / squares if squares > 0.0 else 0.0


def compute_runs_p(residuals: Floats) -> float:
    """Compute the two-sided p-value of the Wald-Wolfowitz runs test on the signs of residuals.

    Notes
    -----
    The distribution is approximated as normal (Ann. Math. Stat. 11 (1940) 147). If all n residuals
    have the same sign, the p-value is that of the sign test, 2^(1 - n). Zeros count as negative.
    """
    is_above = residuals > 0.0
    n_above, n_below = int(is_above.sum()), int((~is_above).sum())
    n = n_above + n_below
    if n_above == 0 or n_below == 0:
        return float(2.0 ** (1 - n))
    n_runs = 1 + int(np.sum(is_above[1:] != is_above[:-1]))
    mean = 1.0 + 2.0 * n_above * n_below / n
    variance = (mean - 1.0) * (mean - 2.0) / (n - 1.0)
    if variance <= 0.0:
        return 1.0
    return float(2.0 * ndtr(-abs(n_runs - mean) / np.sqrt(variance)))


MIN_COMPARED_POINTS = 3
"""Smallest number of points at which two curves are compared."""


def compare_curves(
    curve: ExternalCurve,
    deflection: Floats,
    force: Floats,
    band: tuple[Floats, Floats] | None,
    label: str,
) -> CurveMatch:
    """Compare an external curve with a reference curve.

    Parameters
    ----------
    curve : external curve
    deflection : shape (m,), m, deflections of the reference curve, increasing
    force : shape (m,), N, forces of the reference curve
    band : lower and upper limits of the 95 % band of the reference curve, shape (m,), N, may be
        NaN; None without a band
    label : name of the reference curve in messages: ``the tests``, ``the model``

    Returns
    -------
    Errors at the points of the external curve that are within the range of the reference curve. The
    reference curve is interpolated linearly, and all points have the same weight. The errors are
    None for fewer than 3 points.

    Notes
    -----
    RMSE is that of equation (3.29) of [1]_. It is divided by the largest force of the reference
    curve at these points.
    """
    points, n_points = curve.deflection, len(curve.deflection)
    all_missing = np.full(n_points, np.nan)
    if not len(deflection):
        text = f"no point was compared: there is no curve of {label}"
        return CurveMatch(all_missing, None, n_points, text)
    is_shared = (deflection[0] <= points) & (points <= deflection[-1])
    n_shared, text = int(is_shared.sum()), ""
    span = f"{1e3 * deflection[0]:.3g} to {1e3 * deflection[-1]:.4g} mm, the range of {label}"
    if n_shared < MIN_COMPARED_POINTS:
        text = (
            f"{n_shared} of {n_points} points, from {1e3 * points[0]:.4g} to "
            f"{1e3 * points[-1]:.4g} mm, lie within {span}: expected at least {MIN_COMPARED_POINTS}"
        )
        return CurveMatch(all_missing, None, n_points, text)
    if n_shared < n_points:
        text = f"{n_points - n_shared} of {n_points} points left out, outside of {span}"
    lower = upper = all_missing
    if band is not None:
        lower, upper = (np.interp(points, deflection, limit) for limit in band)
    reference = np.where(is_shared, np.interp(points, deflection, force), np.nan)
    errors = compute_curve_errors(curve.force, reference, lower, upper)
    if not np.isfinite(lower[is_shared]).all():
        errors = replace(errors, coverage=np.nan)
    rmse_share = errors.rmse / float(np.nanmax(np.abs(reference)))
    return CurveMatch(reference, replace(errors, rmse_share=rmse_share), n_points - n_shared, text)
