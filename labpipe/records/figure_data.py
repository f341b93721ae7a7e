"""What a report draws of shapes and measured bending: few points of much data."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from labpipe.records.arrays import ArrayRecord, Floats, Vector


@dataclass(frozen=True, slots=True, eq=False)
class DrawnShapes(ArrayRecord):
    """Shapes of a specimen at equal steps of its first loading.

    Parameters
    ----------
    deflection : shape (steps,), m, of the curve
    positions : shape (steps, points, 2), m, in the specimen frame: along it, and in the plane of
        bending; NaN where no camera saw the point
    """

    deflection: Annotated[Floats, "steps"]
    positions: Annotated[Floats, "steps", "points", 2]


@dataclass(frozen=True, slots=True, eq=False)
class DrawnLaw(ArrayRecord):
    """The measured moment-curvature law of a first loading, with its 95 % interval.

    Parameters
    ----------
    curvature : shape (n,), 1/m, increasing
    moment, moment_lower, moment_upper : shape (n,), N m
    """

    curvature: Vector
    moment: Vector
    moment_lower: Vector
    moment_upper: Vector
