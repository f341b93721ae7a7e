"""Measured loading curves made ready: checked, grouped by rig, whitened."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from labpipe.records.arrays import Floats, frozen
from labpipe.records.calibration import CalibrationFailure
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
    return np.stack([zero, curve.place_error * slope, curve.scale_error * curve.deflection * slope])


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
