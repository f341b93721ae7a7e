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

MAX_DEFLECTION = 0.65
"""Largest deflection relative to the length; stations may unload beyond it, see
`wire.first_loading`."""


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredCurve(ArrayRecord):
    """The first loading of one sample.

    Parameters
    ----------
    wire : name of the wire
    test : name of the test
    sample : name of the sample; all tests of a sample share its factor
    length : m, free length
    deflection : shape (n,), m, deflection of the tip from rest
    force : shape (n,), N, force of the load cell, zeroed at rest; `select_usable_curves` leaves out
        points at which force or deflection is NaN
    noise : N, standard deviation of the force, one number or shape (n,). It includes the noise of
        the deflection times the slope of the curve
    rig : string and counterweight; None for an end load normal to the undeformed axis
    zero_error : N, standard error of the zero of the force
    offset_error : m, standard error of the offset of all deflections, due to zero and clock
    scale_error : relative standard error of the deflection's scale, common to all curves of a
        calibration
    own_scale_error : relative standard error of the deflection's scale in this curve
    self_weight : N/m, weight per length of the wire, which lies level at rest
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
    own_scale_error: float = 0.0
    self_weight: float = 0.0

    def __post_init__(self) -> None:
        ArrayRecord.__post_init__(self)
        noise = np.broadcast_to(np.asarray(self.noise, np.float64), self.deflection.shape)
        object.__setattr__(self, "noise", noise)

    @property
    def setup(self) -> tuple[float, ...]:
        """Inputs of the model's loading curve; curves with equal inputs share it."""
        wire = self.length, self.self_weight
        return wire if self.rig is None else (*wire, *astuple(self.rig))

    @property
    def peak(self) -> float:
        """Largest magnitude of the force, N."""
        return float(np.nanmax(np.abs(self.force)))

    @property
    def point_error(self) -> float:
        """Standard deviation of a point, N, as root mean square over the curve.

        Errors of the deflection are converted with the secant from rest to the peak.
        """
        slope = self.peak / float(np.nanmax(np.abs(self.deflection)))
        shared = compute_shared_errors(self, np.full(len(self.force), slope))
        return float(np.sqrt(np.nanmean(np.asarray(self.noise) ** 2 + np.sum(shared**2, axis=0))))


def compute_shared_errors(curve: MeasuredCurve, slope: Floats) -> Floats:
    """Compute the change of force for one standard deviation of each error that all points share.

    Parameters
    ----------
    curve : measured curve
    slope : shape (n,), N/m, derivative of the force with respect to deflection

    Returns
    -------
    Shape (3, n), N, for the zero of the force, and for offset and scale of the deflection.
    """
    zero = np.full(len(slope), curve.zero_error)
    scale = float(np.hypot(curve.scale_error, curve.own_scale_error))
    return np.stack([zero, curve.offset_error * slope, scale * curve.deflection * slope])


def select_usable_curves(
    curves: tuple[MeasuredCurve, ...],
) -> tuple[MeasuredCurve, ...] | CalibrationFailure:
    """Leave out NaN points and empty curves; refuse curves that cannot be fitted.

    Returns
    -------
    The curves, with the common error of the scale multiplied by n^(1/2) so that it can be treated
    as an error of each curve; or a failure ``no_sample_usable``, ``wires_mixed``,
    ``noise_not_positive`` or ``deflection_too_large``.

    Notes
    -----
    A common error e of n curves shifts their mean by e, as do n independent errors of n^(1/2) e.
    Only the differences between curves then have less weight than they could have.
    """
    usable = tuple(_select_finite_points(curve) for curve in curves)
    usable = tuple(curve for curve in usable if len(curve.force))
    root_n = np.sqrt(len(usable))
    usable = tuple(replace(curve, scale_error=root_n * curve.scale_error) for curve in usable)
    if not usable:
        return CalibrationFailure.of("mechanics.wire.no_sample_usable", number=len(curves))
    wires = sorted({curve.wire for curve in usable})
    if len(wires) > 1:
        names, number = ", ".join(wires), len(wires)
        return CalibrationFailure.of("mechanics.wire.wires_mixed", number=number, names=names)
    for curve in usable:
        if not np.all(np.asarray(curve.noise) > 0.0):
            test, noise = curve.test, 1e3 * np.min(curve.noise)
            return CalibrationFailure.of(
                "mechanics.wire.noise_not_positive", test=test, noise=noise
            )
        deflection = float(np.max(np.abs(curve.deflection)))
        if deflection > MAX_DEFLECTION * curve.length:
            return CalibrationFailure.of(
                "mechanics.wire.deflection_too_large",
                test=curve.test,
                deflection=1e3 * deflection,
                length=1e3 * curve.length,
                limit=MAX_DEFLECTION,
            )
    return usable


def _select_finite_points(curve: MeasuredCurve) -> MeasuredCurve:
    """Select the curve without the points at which force or deflection is not finite."""
    is_finite = np.isfinite(curve.deflection) & np.isfinite(curve.force)
    deflection, force = curve.deflection[is_finite], curve.force[is_finite]
    noise = np.asarray(curve.noise)[is_finite]
    return replace(curve, deflection=deflection, force=force, noise=noise)


def whiten(values: Floats, correlation: float) -> Floats:
    """Whiten first-order autoregressive noise of variance 1.

    Parameters
    ----------
    values : shape (n, ...), values in order of time, relative to the standard deviation of noise
    correlation : correlation of neighbouring values, at least 0 and below 1

    Returns
    -------
    Values of the same shape; noise in them is uncorrelated.
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
    """Compute the errors of a model at the points of a curve; leave out NaN.

    Parameters
    ----------
    force, model : shape (n,), N, measured and modelled force
    lower, upper : shape (n,), N, ends of a band; None without a band

    Returns
    -------
    SSE, RMSE, RMSE relative to the largest force, and fraction of the points inside the band, which
    is NaN without a band.

    Raises
    ------
    ValueError
        If no point has both forces.

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
    inside = np.nan
    if lower is not None and upper is not None:
        inside = float(np.mean(((lower <= force) & (force <= upper))[is_valid]))
    rmse_share = rmse / float(np.max(np.abs(force[is_valid])))
    return CurveErrors(len(residuals), sse, rmse, rmse_share, inside)


def compare_with_model(curve: MeasuredCurve, model: Floats, factor: float) -> CurveAgreement:
    """Compare one curve with the model.

    Parameters
    ----------
    curve : measured curve
    model : shape (n,), N, force of the model without the sample's factor
    factor : factor of the sample, including that of the load cell

    Returns
    -------
    Errors of the model without the factor; correlation and runs test of the residuals with the
    factor.
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
    """Compute the correlation of neighbouring residuals about zero; 0 if all are zero."""
    squares = float(residuals @ residuals)
    return float(residuals[1:] @ residuals[:-1]) / squares if squares > 0.0 else 0.0


def compute_runs_p(residuals: Floats) -> float:
    """Compute the two-sided p-value of Wald and Wolfowitz's runs test of the residuals' signs.

    Notes
    -----
    The distribution is approximated as normal (Ann. Math. Stat. 11 (1940) 147). The value is 0 if
    all residuals have one sign. Zeros count as negative.
    """
    is_above = residuals > 0.0
    n_above, n_below = int(is_above.sum()), int((~is_above).sum())
    n = n_above + n_below
    if n_above == 0 or n_below == 0:
        return 0.0
    runs = 1 + int(np.sum(is_above[1:] != is_above[:-1]))
    mean = 1.0 + 2.0 * n_above * n_below / n
    variance = (mean - 1.0) * (mean - 2.0) / (n - 1.0)
    if variance <= 0.0:
        return 1.0
    return float(2.0 * ndtr(-abs(runs - mean) / np.sqrt(variance)))


MIN_COMPARED_POINTS = 3
"""Smallest number of points to compare two curves."""


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
    band : lower and upper ends of its 95 % band, shape (m,), N, which may be NaN; None without a
        band
    label : name of the reference curve in messages: ``the tests``, ``the model``

    Returns
    -------
    Errors at the points of the external curve that lie within the range of the reference curve. The
    reference is interpolated linearly, and all points have the same weight. The errors are None for
    fewer than 3 points.

    Notes
    -----
    RMSE is that of equation (3.29) of [1]_. It is divided by the largest force of the reference
    curve at these points.
    """
    points, n_points = curve.deflection, len(curve.deflection)
    no_values = np.full(n_points, np.nan)
    if not len(deflection):
        text = f"no point was compared: there is no curve of {label}"
        return CurveMatch(no_values, None, n_points, text)
    is_shared = (deflection[0] <= points) & (points <= deflection[-1])
    n_shared, text = int(is_shared.sum()), ""
    span = f"{1e3 * deflection[0]:.3g} to {1e3 * deflection[-1]:.4g} mm, the range of {label}"
    if n_shared < MIN_COMPARED_POINTS:
        text = (
            f"{n_shared} of {n_points} points, from {1e3 * points[0]:.4g} to "
            f"{1e3 * points[-1]:.4g} mm, lie within {span}: expected at least {MIN_COMPARED_POINTS}"
        )
        return CurveMatch(no_values, None, n_points, text)
    if n_shared < n_points:
        text = f"{n_points - n_shared} of {n_points} points left out, outside of {span}"
    lower = upper = no_values
    if band is not None:
        lower, upper = (np.interp(points, deflection, end) for end in band)
    reference = np.where(is_shared, np.interp(points, deflection, force), np.nan)
    errors = compute_curve_errors(curve.force, reference, lower, upper)
    if not np.isfinite(lower[is_shared]).all():
        errors = replace(errors, coverage=np.nan)
    rmse_share = errors.rmse / float(np.nanmax(np.abs(reference)))
    return CurveMatch(reference, replace(errors, rmse_share=rmse_share), n_points - n_shared, text)
