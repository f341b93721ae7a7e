"""What a calibration foretells of another wire, or another length."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.special import stdtrit

from labpipe.records.arrays import Floats
from labpipe.records.calibration import PARAMETERS, Calibration, Prediction
from labpipe.records.quality import QualityNote, Severity
from labpipe.wire.calibrating.finding import Wire
from labpipe.wire.calibrating.model import loading_curve
from labpipe.wire.calibrating.parts import take_apart
from labpipe.wire.cantilever import StringRig
from labpipe.wire.first_loading import force_at


def predict(
    calibration: Calibration,
    wire: Wire,
    length: float,
    deflection: Floats,
    *,
    rig: StringRig | None = None,
    noise: float = 0.0,
    n_samples: int = 1,
    other_gain: float | None = None,
) -> Prediction:
    """Foretell the loading curve of a wire, with 95 % bands.

    Parameters
    ----------
    calibration : of this wire or another
    wire : its geometry, materials and friction coefficients; phi, the modulus of the insulation
        and the copper scale are those of the calibration, where it has them
    length : m
    deflection : shape (n,), m
    rig : the string; None for an end load normal to the axis
    noise : standard deviation of a measured force, N
    n_samples : of which the measured curve is the mean
    other_gain : standard uncertainty of the gain of another load cell; None where the forces are
        read from the one of the calibration, whose gain then is what the calibration found

    Returns
    -------
    The curve and its bands: uncertainty of the parameters (linear in their logarithms), gain, and,
    for the band of a measured curve, scatter of samples and noise. What the two wires do not share
    (dimensions, lots of copper and insulation) is not in it.

    Raises
    ------
    ValueError
        If the first loading ends before the largest deflection.

    Notes
    -----
    Point by point: value -+ t s with Satterthwaite's degrees of freedom of s^2, which sums levels.
    """
    parts = take_apart(wire.section, wire.contacts, orientation=wire.orientation)
    values = np.array([parameter.value for parameter in calibration.parameters])
    values = np.where(np.isnan(values), parts.given, values)
    deepest = float(np.nanmax(np.abs(deflection)))
    curve = loading_curve(parts, values, length, rig, deepest)
    force, change = force_at(curve, deflection)
    gain_slope = force if other_gain is None else np.zeros_like(force)
    slopes = np.vstack([change, gain_slope])
    other = 0.0 if other_gain is None else other_gain
    variance, by_level = _spread(calibration, slopes)
    variance += (other * force) ** 2
    mean = _half_width(variance, by_level, calibration)
    scatter = (calibration.levels.scatter * force) ** 2 / n_samples
    own_noise = np.full_like(force, noise**2 / n_samples)
    by_level = by_level + np.stack([np.zeros_like(force), scatter])
    one = _half_width(variance + scatter + own_noise, by_level, calibration)
    notes = tuple(_notes(calibration))
    return Prediction(
        deflection, force, force - one, force + one, force - mean, force + mean, notes
    )


def _spread(calibration: Calibration, slopes: Floats) -> tuple[Floats, Floats]:
    """Variance of the force at each point, shape (n,), and its slopes by the levels, (2, n)."""
    variance = np.einsum("in,ij,jn->n", slopes, calibration.covariance, slopes)
    by_level = np.einsum("in,lij,jn->ln", slopes, calibration.covariance_by_level, slopes)
    return np.asarray(variance), np.asarray(by_level)


def _half_width(variance: Floats, by_level: Floats, calibration: Calibration) -> Floats:
    spread = np.einsum("in,ij,jn->n", by_level, calibration.level_covariance, by_level)
    with np.errstate(divide="ignore", invalid="ignore"):
        freedom = np.where(spread > 0.0, 2.0 * variance**2 / spread, np.inf)
    return np.asarray(stdtrit(np.clip(freedom, 1.0, 1e9), 0.975) * np.sqrt(variance))


def _notes(calibration: Calibration) -> Iterator[QualityNote]:
    if calibration.levels.scatter_freedom == 0.0:
        message = "the scatter of samples is not known from one sample: the bands leave it out"
        yield QualityNote("one_sample", Severity.WARNING, calibration.wire, message)
    for name in PARAMETERS:
        parameter = calibration.parameter(name)
        if parameter.is_open_below or parameter.is_open_above:
            message = f"{parameter.words}; the bands take its error for that of a normal one"
            yield QualityNote("not_identified", Severity.WARNING, name, message)
