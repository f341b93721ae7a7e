"""Shapes of a bent sample beside those of the calibrated model, at steps of its first loading."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.records.curve import PointFlag, Shape
from labpipe.report.calibration_shown import BentShape
from labpipe.store.read import read_result
from labpipe.wire.calibration import Wire
from labpipe.wire.cantilever import StringRig, bend_to_deflection, bend_to_travel, straight
from labpipe.wire.wire_law import play_law

STEPS = 6
"""Deflections that are shown."""
_CLOSE = 1e-6  # m, between the tip of the model and that of the sample
_MOST_TRIES = 8
_POINTS = 60


def bent_shapes(
    file: Path, wire: Wire, length: float, rig: StringRig | None, deepest: float
) -> tuple[BentShape, ...]:
    """Take a sample's shapes at even steps of deflection, and bend the model as far.

    Parameters
    ----------
    file : result.h5 of a test with a shape
    wire : with the calibrated numbers
    length : free length, m
    rig : the string; None for an end load normal to the axis
    deepest : m, deflection up to which the first loading was taken

    Returns
    -------
    `STEPS` shapes in the frame of the clamp; none for a test without a fitted shape. Markers stand
    where they were seen, on the surface; fit and model are the axis.

    Raises
    ------
    ValueError
        If the model has no equilibrium at one of the deflections.
    """
    shape = read_result(file).shape
    if shape is None or not shape.coefficients.size:
        return ()
    lift = shape.positions[:, -1, 1] - shape.positions[:, 0, 1]
    rise = lift - lift[np.flatnonzero(np.isfinite(lift))[0]]
    found = []
    for wanted in deepest * np.arange(1, STEPS + 1) / STEPS:
        reached = np.flatnonzero(rise >= wanted)
        if len(reached):
            frame = int(reached[0])
            model = _model_shape(wire, length, rig, float(rise[frame]))
            found.append(
                BentShape(float(rise[frame]), _markers(shape, frame), _fit(shape, frame), model)
            )
    return tuple(found)


def _markers(shape: Shape, frame: int) -> Floats:
    seen = np.isin(shape.flags[frame], (PointFlag.MEASURED, PointFlag.RELABELLED))
    return shape.positions[frame, seen, :2]


def _fit(shape: Shape, frame: int) -> Floats:
    powers = np.vander(np.linspace(0.0, 1.0, _POINTS), shape.coefficients.shape[2], increasing=True)
    return np.asarray(powers @ shape.coefficients[frame, :2].T, dtype=np.float64)


def _model_shape(wire: Wire, length: float, rig: StringRig | None, deflection: float) -> Floats:
    """Axis of the model with its tip at a deflection, from straight."""
    share = min(deflection / length, 0.9)
    law = play_law(
        wire.section,
        wire.contacts,
        largest_curvature=8.0 * share / (1.0 - share**2) / length,
        orientation=wire.orientation,
    )
    if rig is None:
        bent = bend_to_deflection(law, straight(law), length, deflection)
        return np.column_stack([bent.x, bent.y])
    travel = deflection
    for _ in range(_MOST_TRIES):  # the string leans, so that the tip follows the clamp not quite
        bent = bend_to_travel(law, straight(law), length, rig, travel)
        missing = deflection - float(bent.y[-1])
        if abs(missing) < _CLOSE:
            break
        travel += missing
    return np.column_stack([bent.x, bent.y])
