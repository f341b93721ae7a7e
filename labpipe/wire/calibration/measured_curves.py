"""Measured loading curves made ready, and how well others agree with them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtr

from labpipe.records.arrays import Flags, Floats, frozen
from labpipe.records.wire_calibration import (
    CalibrationFailure,
    CurveAgreement,
    CurveErrors,
    CurveMatch,
    ExternalCurve,
)
from labpipe.wire.cantilever import StringRig

DEEPEST = 0.65
"""Largest deflection over length: beyond, a first loading may end (see `wire.first_loading`)."""


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredCurve:
    """The first loading of one sample.

    Parameters
    ----------
    wire : name of the wire
    test, sample : names; tests of one sample share its factor
    length : free length, m
    deflection : shape (n,), m, of the tip from its place at rest
    force : shape (n,), N, of the load cell, zeroed at rest. Points where either is NaN are left out
    noise : standard deviation of the force, N, one number or shape (n,); noise of the deflection
        is to be in it, as the slope of the curve times that noise
    rig : the string and what hangs on it; None for an end load normal to the undeformed axis
    zero_error : N, standard error of the zero of the force
    place_error : m, standard error of what all deflections are off by: their zero, and a clock
        that runs late or early
    scale_error : standard error of the deflection's scale, as a ratio; all curves of a calibration
        are off alike
    own_scale_error : the same of this curve alone
    self_weight : N/m, of the wire, which lies level at rest
    """

    wire: str
    test: str
    sample: str
    length: float
    deflection: Floats
    force: Floats
    noise: float | Floats
    rig: StringRig | None = None
    zero_error: float = 0.0
    place_error: float = 0.0
    scale_error: float = 0.0
    own_scale_error: float = 0.0
    self_weight: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "deflection", frozen(self.deflection, shape=(None,)))
        shape = (len(self.deflection),)
        object.__setattr__(self, "force", frozen(self.force, shape=shape))
        object.__setattr__(self, "noise", frozen(np.broadcast_to(self.noise, shape), shape=shape))

    @property
    def peak(self) -> float:
        """The largest force, N."""
        return float(np.nanmax(np.abs(self.force)))

    @property
    def read_error(self) -> float:
        """Standard deviation, N, of what one point is off by, rms over the curve, about.

        The slope that makes a force of what a deflection is off by is that from rest to the peak.
        """
        slope = self.peak / float(np.nanmax(np.abs(self.deflection)))
        shared = shared_errors(self, np.full(len(self.force), slope))
        return float(np.sqrt(np.nanmean(np.asarray(self.noise) ** 2 + np.sum(shared**2, axis=0))))


def shared_errors(curve: MeasuredCurve, slope: Floats) -> Floats:
    """What one standard deviation of each error that all points share makes of the force.

    Parameters
    ----------
    curve : measured
    slope : shape (n,), N/m, of the force over the deflection

    Returns
    -------
    Shape (3, n), N: zero of the force, place and scale of the deflection.
    """
    zero = np.full(len(slope), curve.zero_error)
    scale = float(np.hypot(curve.scale_error, curve.own_scale_error))
    return np.stack([zero, curve.place_error * slope, scale * curve.deflection * slope])


def usable(curves: tuple[MeasuredCurve, ...]) -> tuple[MeasuredCurve, ...] | CalibrationFailure:
    """Leave out points without a number, and curves without points; refuse what cannot be fitted.

    Returns
    -------
    The curves, errors of the scale counted as each curve's own; or a failure ``no_sample_usable``,
    ``wires_mixed``, ``noise_not_positive`` or ``deflection_too_large``.

    Notes
    -----
    Of n curves that are all off by the same e, the mean is off by e. As n independent errors of
    n^(1/2) e it is, too; only what curves differ by then counts for less than it might.
    """
    known = tuple(_known(curve) for curve in curves)
    known = tuple(curve for curve in known if len(curve.force))
    each = np.sqrt(len(known))
    known = tuple(replace(curve, scale_error=each * curve.scale_error) for curve in known)
    if not known:
        message = f"none of {len(curves)} curves has a point with deflection and force"
        return CalibrationFailure("no_sample_usable", message)
    wires = sorted({curve.wire for curve in known})
    if len(wires) > 1:
        message = f"curves of {len(wires)} wires: {', '.join(wires)}; one wire is calibrated"
        return CalibrationFailure("wires_mixed", message)
    for curve in known:
        if not np.all(np.asarray(curve.noise) > 0.0):
            message = (
                f"{curve.test}: a noise of {1e3 * np.min(curve.noise):.4g} mN; it must be positive"
            )
            return CalibrationFailure("noise_not_positive", message)
        deepest = float(np.max(np.abs(curve.deflection)))
        if deepest > DEEPEST * curve.length:
            message = (
                f"{curve.test}: a deflection of {1e3 * deepest:.4g} mm on "
                f"{1e3 * curve.length:.4g} mm; the first loading is followed to {DEEPEST:g} of the "
                "length"
            )
            return CalibrationFailure("deflection_too_large", message)
    return known


def _known(curve: MeasuredCurve) -> MeasuredCurve:
    known = np.isfinite(curve.deflection) & np.isfinite(curve.force)
    return replace(
        curve,
        deflection=curve.deflection[known],
        force=curve.force[known],
        noise=np.asarray(curve.noise)[known],
    )


def whiten(values: Floats, correlation: float) -> Floats:
    """Take out of neighbours what they share, for first-order autoregressive noise of variance 1.

    Parameters
    ----------
    values : shape (n, ...), in order of time, over their noise
    correlation : of neighbours, at least 0 and below 1

    Returns
    -------
    Same shape, uncorrelated where the noise is such.
    """
    if correlation == 0.0:
        return values
    out = values.copy()
    out[1:] -= correlation * values[:-1]
    out[1:] /= np.sqrt(1.0 - correlation**2)
    return out


def curve_errors(
    force: Floats, model: Floats, lower: Floats | None = None, upper: Floats | None = None
) -> CurveErrors:
    """SSE, RMSE and RMSE over the largest force; points without a number are left out.

    Parameters
    ----------
    force, model : shape (n,), N
    lower, upper : shape (n,), N, of a band

    Raises
    ------
    ValueError
        If no point is left.

    Notes
    -----
    Eqs. (3.28) and (3.29) of the source. SSE grows with the number of points.
    """
    known = np.isfinite(force) & np.isfinite(model)
    if not known.any():
        message = "no point has both a measured and a modelled force"
        raise ValueError(message)
    left = force[known] - model[known]
    sse = float(left @ left)
    rmse = float(np.sqrt(sse / len(left)))
    inside = np.nan
    if lower is not None and upper is not None:
        inside = float(np.mean((lower[known] <= force[known]) & (force[known] <= upper[known])))
    return CurveErrors(len(left), sse, rmse, rmse / float(np.max(np.abs(force[known]))), inside)


def agreement(curve: MeasuredCurve, model: Floats, factor: float) -> CurveAgreement:
    """One curve against the model.

    Parameters
    ----------
    curve : measured
    model : shape (n,), N, without the sample's factor
    factor : of the sample, load cell included
    """
    errors = curve_errors(curve.force, model)
    left = (curve.force - factor * model) / np.asarray(curve.noise)
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
        lag_one_correlation=lag_one_correlation(left),
        runs_p=runs_p(left),
    )


def lag_one_correlation(residuals: Floats) -> float:
    """Correlation of neighbours about zero; 0 for residuals that are all zero."""
    power = float(residuals @ residuals)
    return float(residuals[1:] @ residuals[:-1]) / power if power > 0.0 else 0.0


def runs_p(residuals: Floats) -> float:
    """Two-sided p-value of Wald and Wolfowitz's runs test of the residuals' signs.

    Notes
    -----
    Normal approximation (Ann. Math. Stat. 11 (1940) 147). 0 where all have one sign.
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
"""Points with which two curves are compared."""


def match(
    curve: ExternalCurve,
    deflection: Floats,
    force: Floats,
    band: tuple[Floats, Floats] | None,
    of: str,
) -> CurveMatch:
    """Hold a external curve against another one.

    Parameters
    ----------
    curve : from elsewhere
    deflection, force : shape (m,), m and N, of the other curve, deflections rising
    band : lower and upper end of its 95 % band, shape (m,), N; None or NaN for no band
    of : what the other curve is, for the words: ``the tests``, ``the model``

    Returns
    -------
    Errors at those points of the external curve that lie within the deflections of the other, which
    is interpolated linearly there; each point weighs the same. None for fewer than 3 points.

    Notes
    -----
    RMSE is Eq. (3.29) of the source; it is divided by the largest force of the other curve at the
    points compared.
    """
    shared = _shared(curve, deflection)
    words = _words(curve, shared, deflection, of)
    left_out = int(np.sum(~shared))
    nothing = np.full(len(shared), np.nan)
    if shared.sum() < MIN_COMPARED_POINTS:
        return CurveMatch(nothing, None, len(shared), words)
    lower, upper = (nothing, nothing) if band is None else (_at(curve, deflection, b) for b in band)
    reference = np.where(shared, _at(curve, deflection, force), np.nan)
    errors = curve_errors(curve.force, reference, lower, upper)
    if not np.isfinite(lower[shared]).all():
        errors = replace(errors, inside=np.nan)
    share = errors.rmse / float(np.nanmax(np.abs(reference)))
    return CurveMatch(reference, replace(errors, rmse_share=share), left_out, words)


def _shared(curve: ExternalCurve, deflection: Floats) -> Flags:
    if not len(deflection):
        return np.zeros(len(curve.deflection), dtype=np.bool_)
    shared: Flags = (deflection[0] <= curve.deflection) & (curve.deflection <= deflection[-1])
    return shared


def _at(curve: ExternalCurve, deflection: Floats, values: Floats) -> Floats:
    found: Floats = np.interp(curve.deflection, deflection, values)
    return found


def _words(curve: ExternalCurve, shared: Flags, deflection: Floats, of: str) -> str:
    """Which points were left out."""
    total, kept = len(shared), int(shared.sum())
    if not len(deflection):
        return f"no point was compared: there is no curve of {of}"
    low, high = 1e3 * deflection[0], 1e3 * deflection[-1]
    span = f"{low:.3g} to {high:.4g} mm, the range of {of}"
    if kept == total:
        return ""
    if kept < MIN_COMPARED_POINTS:
        first, last = 1e3 * curve.deflection[0], 1e3 * curve.deflection[-1]
        return (
            f"{kept} of {total} points, from {first:.4g} to {last:.4g} mm, lie within {span}; "
            f"{MIN_COMPARED_POINTS} at least are needed"
        )
    return f"{total - kept} of {total} points left out, outside of {span}"
