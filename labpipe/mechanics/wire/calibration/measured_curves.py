"""Define measured loading curves, and compare them with models and with other curves."""

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

DEEPEST = 0.65
"""Largest deflection over length; beyond it, parts may unload (see `wire.first_loading`)."""


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredCurve(ArrayRecord):
    """The first loading of one sample.

    Parameters
    ----------
    wire : name of the wire
    test, sample : names; tests of one sample share its factor
    length : free length, m
    deflection : shape (n,), m, of the tip from rest
    force : shape (n,), N, of the load cell, zeroed at rest; `select_usable` leaves out points at
        which force or deflection is NaN
    noise : standard deviation of the force, N, one number or shape (n,); including
        the noise of the deflection times the slope of the curve
    rig : string and counterweight; None for an end load normal to the undeformed axis
    zero_error : N, standard error of the zero of the force
    place_error : m, standard error of the offset of all deflections, by their zero and by the clock
    scale_error : standard error of the deflection's scale, as a ratio, common to all curves of a
        calibration
    own_scale_error : standard error of the deflection's scale, as a ratio, of this curve alone
    self_weight : N/m, of the wire, which lies level at rest
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
    place_error: float = 0.0
    scale_error: float = 0.0
    own_scale_error: float = 0.0
    self_weight: float = 0.0

    def __post_init__(self) -> None:
        ArrayRecord.__post_init__(self)
        noise = np.broadcast_to(np.asarray(self.noise, np.float64), self.deflection.shape)
        object.__setattr__(self, "noise", noise)

    @property
    def setup(self) -> tuple[float, ...]:
        """Return the inputs of the model's curve."""
        place = self.length, self.self_weight
        return place if self.rig is None else (*place, *astuple(self.rig))

    @property
    def peak(self) -> float:
        """Return the largest magnitude of the force, N."""
        return float(np.nanmax(np.abs(self.force)))

    @property
    def read_error(self) -> float:
        """Estimate the standard deviation of a point, N, rms over the curve.

        Errors of the deflection are converted with the slope from rest to the peak.
        """
        slope = self.peak / float(np.nanmax(np.abs(self.deflection)))
        shared = compute_shared_errors(self, np.full(len(self.force), slope))
        return float(np.sqrt(np.nanmean(np.asarray(self.noise) ** 2 + np.sum(shared**2, axis=0))))


def compute_shared_errors(curve: MeasuredCurve, slope: Floats) -> Floats:
    """Return the force error by one standard deviation of each error that all points share.

    Parameters
    ----------
    curve : measured curve
    slope : shape (n,), N/m, of the force over the deflection

    Returns
    -------
    Shape (3, n), N: zero of the force, place and scale of the deflection.
    """
    zero = np.full(len(slope), curve.zero_error)
    scale = float(np.hypot(curve.scale_error, curve.own_scale_error))
    return np.stack([zero, curve.place_error * slope, scale * curve.deflection * slope])


def select_usable(
    curves: tuple[MeasuredCurve, ...],
) -> tuple[MeasuredCurve, ...] | CalibrationFailure:
    """Leave out NaN points and empty curves; refuse curves that cannot be fitted.

    Returns
    -------
    The curves, with the common error of the scale multiplied by n^(1/2) so that it can be treated
    as each curve's own; or a failure ``no_sample_usable``, ``wires_mixed``, ``noise_not_positive``
    or ``deflection_too_large``.

    Notes
    -----
    A common error e of n curves shifts their mean by e, as do n independent errors of n^(1/2) e;
    only the differences between curves then have less weight than they could have.
    """
    finite = tuple(_finite_points(curve) for curve in curves)
    finite = tuple(curve for curve in finite if len(curve.force))
    root_n = np.sqrt(len(finite))
    finite = tuple(replace(curve, scale_error=root_n * curve.scale_error) for curve in finite)
    if not finite:
        return CalibrationFailure.of("mechanics.wire.no_sample_usable", number=len(curves))
    wires = sorted({curve.wire for curve in finite})
    if len(wires) > 1:
        names, number = ", ".join(wires), len(wires)
        return CalibrationFailure.of("mechanics.wire.wires_mixed", number=number, names=names)
    for curve in finite:
        if not np.all(np.asarray(curve.noise) > 0.0):
            test, noise = curve.test, 1e3 * np.min(curve.noise)
            return CalibrationFailure.of(
                "mechanics.wire.noise_not_positive", test=test, noise=noise
            )
        deepest = float(np.max(np.abs(curve.deflection)))
        if deepest > DEEPEST * curve.length:
            return CalibrationFailure.of(
                "mechanics.wire.deflection_too_large",
                test=curve.test,
                deflection=1e3 * deepest,
                length=1e3 * curve.length,
                limit=DEEPEST,
            )
    return finite


def _finite_points(curve: MeasuredCurve) -> MeasuredCurve:
    valid = np.isfinite(curve.deflection) & np.isfinite(curve.force)
    return replace(
        curve,
        deflection=curve.deflection[valid],
        force=curve.force[valid],
        noise=np.asarray(curve.noise)[valid],
    )


def whiten(values: Floats, correlation: float) -> Floats:
    """Whiten first-order autoregressive noise of variance 1.

    Parameters
    ----------
    values : shape (n, ...), in order of time, over their noise
    correlation : correlation of neighbours, at least 0 and below 1

    Returns
    -------
    Same shape, uncorrelated for such noise.
    """
    if correlation == 0.0:
        return values
    out = values.copy()
    out[1:] -= correlation * values[:-1]
    out[1:] /= np.sqrt(1.0 - correlation**2)
    return out


def compute_curve_errors(
    force: Floats, model: Floats, lower: Floats | None = None, upper: Floats | None = None
) -> CurveErrors:
    """Compute SSE, RMSE, RMSE over the largest force and the share inside a band, without NaN.

    Parameters
    ----------
    force, model : shape (n,), N
    lower, upper : shape (n,), N, ends of a band; None for a share of NaN

    Raises
    ------
    ValueError
        If no point has both forces.

    Notes
    -----
    Eqs. (3.28) and (3.29) of the dissertation. SSE grows with the number of points.
    """
    valid = np.isfinite(force) & np.isfinite(model)
    if not valid.any():
        message = "no point has both a measured and a modelled force"
        raise ValueError(message)
    residuals = force[valid] - model[valid]
    sse = float(residuals @ residuals)
    rmse = float(np.sqrt(sse / len(residuals)))
    inside = np.nan
    if lower is not None and upper is not None:
        inside = float(np.mean((lower[valid] <= force[valid]) & (force[valid] <= upper[valid])))
    return CurveErrors(
        len(residuals), sse, rmse, rmse / float(np.max(np.abs(force[valid]))), inside
    )


def compare_with_model(curve: MeasuredCurve, model: Floats, factor: float) -> CurveAgreement:
    """Compare one curve with the model.

    Parameters
    ----------
    curve : measured curve
    model : shape (n,), N, without the sample's factor
    factor : factor of the sample, including that of the load cell

    Returns
    -------
    Errors of the model without the factor; correlation and runs test of its residuals with it.
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
    """Return the correlation of neighbours about zero; 0 for residuals that are all zero."""
    power = float(residuals @ residuals)
    return float(residuals[1:] @ residuals[:-1]) / power if power > 0.0 else 0.0


def compute_runs_p(residuals: Floats) -> float:
    """Return the two-sided p-value of Wald and Wolfowitz's runs test of the residuals' signs.

    Notes
    -----
    Normal approximation (Ann. Math. Stat. 11 (1940) 147). 0 if all have one sign; zeros count as
    negative.
    """
    above = residuals > 0.0
    n_above, n_below = int(above.sum()), int((~above).sum())
    n = n_above + n_below
    if n_above == 0 or n_below == 0:
        return 0.0
    runs = 1 + int(np.sum(above[1:] != above[:-1]))
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
    """Compare an external curve with another one.

    Parameters
    ----------
    curve : external curve
    deflection, force : shape (m,), m and N, of the other curve, deflections rising
    band : lower and upper end of its 95 % band, shape (m,), N; None or NaN for no band
    label : name of the other curve in messages: ``the tests``, ``the model``

    Returns
    -------
    Errors at those points of the external curve that lie within the deflections of the other, which
    is interpolated linearly; all points have the same weight. Its errors are None for fewer than 3
    points.

    Notes
    -----
    RMSE is Eq. (3.29) of the dissertation; it is divided by the largest force of the other curve at
    the points compared.
    """
    at, n_points = curve.deflection, len(curve.deflection)
    no_values = np.full(n_points, np.nan)
    if not len(deflection):
        text = f"no point was compared: there is no curve of {label}"
        return CurveMatch(no_values, None, n_points, text)
    is_shared = (deflection[0] <= at) & (at <= deflection[-1])
    n_shared, text = int(is_shared.sum()), ""
    span = f"{1e3 * deflection[0]:.3g} to {1e3 * deflection[-1]:.4g} mm, the range of {label}"
    if n_shared < MIN_COMPARED_POINTS:
        text = (
            f"{n_shared} of {n_points} points, from {1e3 * at[0]:.4g} to {1e3 * at[-1]:.4g} mm, "
            f"lie within {span}: expected at least {MIN_COMPARED_POINTS}"
        )
        return CurveMatch(no_values, None, n_points, text)
    if n_shared < n_points:
        text = f"{n_points - n_shared} of {n_points} points left out, outside of {span}"
    lower, upper = (
        no_values if band is None else np.interp(at, deflection, side) for side in band or (0, 0)
    )
    reference = np.where(is_shared, np.interp(at, deflection, force), np.nan)
    errors = compute_curve_errors(curve.force, reference, lower, upper)
    if not np.isfinite(lower[is_shared]).all():
        errors = replace(errors, inside=np.nan)
    share = errors.rmse / float(np.nanmax(np.abs(reference)))
    return CurveMatch(reference, replace(errors, rmse_share=share), n_points - n_shared, text)
