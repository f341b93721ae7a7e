"""What a calibration predicts of another wire, or another length."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.special import ndtri

from labpipe.records.arrays import Floats
from labpipe.records.quality import QualityNote, Severity
from labpipe.records.wire_calibration import PARAMETERS, Calibration, Prediction
from labpipe.wire.calibration.fit import Wire
from labpipe.wire.calibration.scatter_mixture import quantiles
from labpipe.wire.calibration.wire_parts import loading_curve, take_apart
from labpipe.wire.cantilever import StringRig
from labpipe.wire.first_loading import force_at

_NORMAL = float(ndtri(0.975))


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
    """Predict the loading curve of a wire, with 95 % bands.

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
    Point by point; quantiles of t averaged over what the scatter of samples may be. What is known
    (noise, another gain) is added as 1.96 s in quadrature.
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
    mixture, directions = calibration.mixture, slopes.T
    lower_mean, upper_mean = quantiles(mixture, directions)
    lower, upper = quantiles(mixture, directions, force / np.sqrt(n_samples))
    gain, read = _NORMAL * other * force, _NORMAL * noise / np.sqrt(n_samples)
    both = np.hypot(gain, read)
    notes = tuple(_notes(calibration))
    return Prediction(
        deflection,
        force,
        force - np.hypot(lower, both),
        force + np.hypot(upper, both),
        force - np.hypot(lower_mean, gain),
        force + np.hypot(upper_mean, gain),
        notes,
    )


def _notes(calibration: Calibration) -> Iterator[QualityNote]:
    if calibration.levels.scatter_freedom == 0.0:
        message = "the scatter of samples is not known from one sample: the bands leave it out"
        yield QualityNote("one_sample", Severity.WARNING, calibration.wire, message)
    for name in PARAMETERS:
        parameter = calibration.parameter(name)
        if parameter.is_open_below or parameter.is_open_above:
            message = f"{parameter.words}; the bands take its error for that of a normal one"
            yield QualityNote("not_identified", Severity.WARNING, name, message)
