"""How far the tests of a calibration bent the wire: beyond, its law is the model's alone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.wire.calibration.fit import Wire
from labpipe.wire.calibration.law_components import loading_curve, take_apart
from labpipe.wire.calibration.measured_curves import MeasuredCurve


def tested_curvature(wire: Wire, values: Floats, curves: Sequence[MeasuredCurve]) -> float:
    """Largest curvature at the clamp at the ends of the curves, 1/m.

    Parameters
    ----------
    wire : as it was calibrated
    values : shape (3,), calibrated, of `PARAMETERS`; NaN where the wire has no such thing
    curves : measured, of this wire

    Raises
    ------
    ValueError
        If there is no curve, or first loading ends before one does.
    """
    if not curves:
        message = "curves: allowed is at least one"
        raise ValueError(message)
    parts = take_apart(wire.section, wire.contacts, orientation=wire.orientation)
    known = np.where(np.isnan(values), parts.given, values)
    found = []
    for curve in curves:
        deepest = float(np.nanmax(np.abs(curve.deflection)))
        bent = loading_curve(
            *(parts, known, curve.length, curve.rig, deepest), self_weight=wire.self_weight
        )
        found.append(float(np.interp(deepest, bent.deflection, bent.clamp_curvature)))
    return max(found)
