"""Curvature range of the tests of a calibration; beyond, the law is extrapolated."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.wire.calibration.fit import Wire
from labpipe.wire.calibration.law_components import loading_curve, split_wire
from labpipe.wire.calibration.measured_curves import MeasuredCurve


def tested_curvature(wire: Wire, values: Floats, curves: Sequence[MeasuredCurve]) -> float:
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
    parts = split_wire(wire.section, wire.contacts, orientation=wire.orientation)
    parameters = np.where(np.isnan(values), parts.given, values)
    curvatures = []
    for curve in curves:
        deepest = float(np.nanmax(np.abs(curve.deflection)))
        loading = loading_curve(
            *(parts, parameters, curve.length, curve.rig, deepest), self_weight=wire.self_weight
        )
        curvatures.append(float(np.interp(deepest, loading.deflection, loading.clamp_curvature)))
    return max(curvatures)
