"""Prediction of a calibration for another wire or length."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.special import ndtri

from labpipe.mechanics.wire.calibration.law_components import compute_loading_curve
from labpipe.mechanics.wire.calibration.measured_curves import MeasuredCurve
from labpipe.mechanics.wire.calibration.objective import Wire
from labpipe.mechanics.wire.calibration.variances import compute_quantiles
from labpipe.mechanics.wire.cantilever import StringRig
from labpipe.mechanics.wire.first_loading import LoadingCurve, interpolate_force
from labpipe.records.arrays import Floats
from labpipe.records.quality import QualityNote
from labpipe.records.wire_calibration import PARAMETERS, Calibration, Prediction, Solution

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
    wire : its geometry, materials, friction coefficients and weight; phi, the modulus of the
        insulation and the copper scale are those of the calibration, if any
    length : m
    deflection : shape (n,), m
    rig : the string; None for an end load normal to the axis
    noise : standard deviation of a measured force, N
    n_samples : of which the measured curve is the mean
    other_gain : standard uncertainty of the gain of another load cell; None for the load cell
        of the calibration, whose estimated gain then applies

    Returns
    -------
    The curve of the best solution, and bands of all: uncertainty of the parameters (linear in their
    logarithms), gain, and, for the band of a measured curve, scatter of samples and noise. With
    several solutions a band extends from the lowest to the highest of theirs, each narrower by its
    likelihood. Differences between the two wires (dimensions, lots of copper and insulation) are
    not included.

    Raises
    ------
    ValueError
        If the first loading ends before the largest deflection.

    Notes
    -----
    Point by point; quantiles of t averaged over the possible scatter of samples. Known errors
    (noise, another gain) are added as 1.96 s in quadrature.
    """
    deepest = float(np.nanmax(np.abs(deflection)))
    gain = _NORMAL * (other_gain or 0.0)
    read = _NORMAL * noise / np.sqrt(n_samples)
    forces, bands = [], []
    for solution in (solution for solution in calibration.solutions if solution.is_allowed):
        curve = compute_calibrated_curve(wire, solution.values, length, rig, deepest)
        force, change = interpolate_force(curve, deflection)
        gain_slope = force if other_gain is None else np.zeros_like(force)
        slopes = np.vstack([change, gain_slope]).T
        forces.append(force)
        wide = calibration.widening * np.sqrt(1.0 - solution.rise / solution.limit)
        mean_error, sample_error = _reach(solution, slopes, force / np.sqrt(n_samples), wide)
        sample_error, mean_error = (
            np.hypot(sample_error, np.hypot(gain * force, read)),
            np.hypot(mean_error, gain * force),
        )
        bands.append(
            [
                force - sample_error[0],
                force + sample_error[1],
                force - mean_error[0],
                force + mean_error[1],
            ]
        )
    low, high = np.min(bands, axis=0), np.max(bands, axis=0)
    notes = tuple(_notes(calibration))
    return Prediction(deflection, forces[0], low[0], high[1], low[2], high[3], notes)


def _reach(
    solution: Solution, slopes: Floats, one_more: Floats, wide: float
) -> tuple[Floats, Floats]:
    """Return the width of a band down and up, shape (2, n), N: of the mean sample, and of one more.

    The part of the parameters is `wide` times as wide as in the linear model.
    """
    mean = np.abs(compute_quantiles(solution.mixture, slopes))
    sample_quantiles = np.abs(compute_quantiles(solution.mixture, slopes, one_more))
    scatter = np.sqrt(np.maximum(sample_quantiles**2 - mean**2, 0.0))
    mean *= wide
    return mean, np.hypot(mean, scatter)


def _notes(calibration: Calibration) -> Iterator[QualityNote]:
    if calibration.levels.scatter_freedom == 0.0:
        yield QualityNote.of("mechanics.wire.predicted_sample", calibration.wire)
    allowed = sum(solution.is_allowed for solution in calibration.solutions)
    if allowed > 1:
        yield QualityNote.of("mechanics.wire.predicted_solutions", calibration.wire, number=allowed)
    for name in PARAMETERS:
        parameter = calibration.parameter(name)
        if parameter.is_open_below or parameter.is_open_above:
            text = parameter.explanation
            yield QualityNote.of("mechanics.wire.predicted_open", name, explanation=text)


def find_tested_curvature(wire: Wire, values: Floats, curves: Sequence[MeasuredCurve]) -> float:
    """Return the largest curvature at the clamp at the ends of the curves, 1/m.

    Parameters
    ----------
    wire : calibrated
    values : shape (3,), calibrated, of `PARAMETERS`; NaN where the wire has no such part
    curves : measured, of this wire

    Raises
    ------
    ValueError
        If there is no curve, or first loading ends before one does.
    """
    if not curves:
        message = "curves: expected at least one"
        raise ValueError(message)
    curvatures = []
    for curve in curves:
        deepest = float(np.nanmax(np.abs(curve.deflection)))
        loading = compute_calibrated_curve(wire, values, curve.length, curve.rig, deepest)
        curvatures.append(float(np.interp(deepest, loading.deflection, loading.clamp_curvature)))
    return max(curvatures)


def compute_calibrated_curve(
    wire: Wire, values: Floats, length: float, rig: StringRig | None, deflection: float
) -> LoadingCurve:
    """Compute the loading curve of a wire with calibrated values, up to a deflection.

    Parameters
    ----------
    wire : calibrated, or another of the same make
    values : shape (3,), of `PARAMETERS`; NaN for those of the wire's sheet
    length, rig, deflection : as for `compute_loading_curve`

    Raises
    ------
    ValueError
        If a material's curve ends before.
    """
    parts = wire.parts
    filled = np.where(np.isnan(values), parts.given, values)
    return compute_loading_curve(
        parts, filled, length, rig, deflection, self_weight=wire.self_weight
    )
