"""Tests by wire and length, and what a calibrated model foretells of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from labpipe.pipeline.first_loadings import FirstLoading
from labpipe.records.agreement import CurveErrors, Prediction
from labpipe.records.arrays import Floats
from labpipe.records.calibration import Calibration
from labpipe.records.group import Band, SampleCurve
from labpipe.records.quality import Reason
from labpipe.report.calibration_shown import ValidationGroup
from labpipe.statistics.bands import common_curves, mean_band
from labpipe.statistics.block_means import block_means
from labpipe.wire.calibrating.agreement import curve_errors
from labpipe.wire.calibrating.data import MeasuredCurve
from labpipe.wire.calibrating.prediction import predict
from labpipe.wire.calibration import Wire

_GRID = np.linspace(0.0, 1.0, 200) ** 1.5
"""Deflections of a prediction, over the deepest: closer where the curve begins, and is bent."""
_BLOCKS = 50
"""Means of each curve, at least, that the mean curve is made of: of single points its band would
show how they scatter by their noise, and not how the samples do."""


def compare(
    calibration: Calibration, wires: Mapping[str, Wire], loadings: Sequence[FirstLoading]
) -> tuple[ValidationGroup, ...]:
    """Hold a calibration against tests, those that it rests on and others.

    Parameters
    ----------
    calibration : what was found
    wires : by name
    loadings : all tests

    Returns
    -------
    A group per wire and length, those of the calibrated wire first.
    """
    groups: dict[tuple[bool, str, float], list[FirstLoading]] = {}
    for each in loadings:
        key = (each.curve.wire != calibration.wire, each.curve.wire, round(each.curve.length, 6))
        groups.setdefault(key, []).append(each)
    return tuple(
        _compared(calibration, wires[wire], groups[other, wire, length])
        for other, wire, length in sorted(groups)
    )


def _compared(
    calibration: Calibration, wire: Wire, loadings: Sequence[FirstLoading]
) -> ValidationGroup:
    curves = [each.curve for each in loadings]
    deepest = max(float(np.nanmax(curve.deflection)) for curve in curves)
    noise = float(np.mean([curve.read_error for curve in curves]))
    first = curves[0]
    prediction, errors, reason = None, None, None
    try:
        prediction = predict(
            calibration,
            wire,
            first.length,
            deepest * _GRID,
            rig=first.rig,
            noise=noise,
        )
    except ValueError as error:
        reason = Reason("no_prediction", str(error))
    else:
        errors = _errors(curves, prediction)
    return ValidationGroup(
        wire=first.wire,
        length=first.length,
        is_calibrated=first.wire == calibration.wire,
        samples={c.test: SampleCurve(c.deflection, c.force, c.force) for c in curves},
        band=_band(curves, prediction),
        prediction=prediction,
        errors=errors,
        reason=reason,
    )


def _band(curves: Sequence[MeasuredCurve], prediction: Prediction | None) -> Band:
    """Mean of some curves, each of block means.

    A block mean of a curve that is bent lies beside it, near the start by 8 % of the force. So the
    model is taken off first and put back last; where there is none, the curve is taken as it is.
    """

    def shape(deflection: Floats) -> Floats:
        if prediction is None:
            return np.zeros_like(deflection)
        return np.interp(deflection, prediction.deflection, prediction.force)

    means = [
        (block_means(c.deflection, _BLOCKS), block_means(c.force - shape(c.deflection), _BLOCKS))
        for c in curves
    ]
    common = common_curves(means, [curve.test for curve in curves])
    return mean_band(replace(common, force=common.force + shape(common.displacement)))


def _errors(curves: Sequence[MeasuredCurve], prediction: Prediction) -> CurveErrors:
    """Errors of all points of some curves, and the share of them inside the band."""
    deflection = np.concatenate([curve.deflection for curve in curves])
    model, lower, upper = (
        np.interp(deflection, prediction.deflection, values)
        for values in (prediction.force, prediction.lower, prediction.upper)
    )
    return curve_errors(np.concatenate([curve.force for curve in curves]), model, lower, upper)
