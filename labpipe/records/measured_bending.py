"""Measured moment-curvature: what frames of a bending test say, and the law through them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, TypeAlias

import numpy as np

from labpipe.records.arrays import ArrayRecord, Flags, Floats, Ints, Vector
from labpipe.records.quality import Reason

_Grid: TypeAlias = Annotated[Floats, "n", "stations"]


@dataclass(frozen=True, slots=True, eq=False)
class BendingCloud(ArrayRecord):
    """Curvature and bending moment along the specimen; means over consecutive frames.

    Parameters
    ----------
    time : shape (n,), s, the marker clock, middle of each mean
    branch : shape (n,), of the curve, counted from 0
    cycle : shape (n,), counted from 1
    force : shape (n,), N, of the curve
    arc_length : shape (stations,), m, from the clamped end
    curvature : shape (n, stations), 1/m, less that at rest
    curvature_error : shape (n, stations), 1/m, standard error from the noise of the markers
    curvature_systematic : shape (n, stations), 1/m, what one coefficient more of the shape makes of
        it; NaN where the markers do not carry one more
    moment : shape (n, stations), N m, less that at rest
    moment_at_rest : shape (stations,), N m
    moment_error : shape (n, stations), N m, standard error: force, its scale and its zero, places
    frames_per_mean : consecutive frames that each row is the mean of
    """

    time: Vector
    branch: Annotated[Ints, "n"]
    cycle: Annotated[Ints, "n"]
    force: Vector
    arc_length: Annotated[Floats, "stations"]
    curvature: _Grid
    curvature_error: _Grid
    curvature_systematic: _Grid
    moment: _Grid
    moment_error: _Grid
    moment_at_rest: Annotated[Floats, "stations"]
    frames_per_mean: int

    @property
    def noise(self) -> Floats:
        """Standard error of each curvature, noise and shape together, shape (n, stations), 1/m.

        The shape counts as a rectangle of the half width that one coefficient more makes.
        """
        other = np.nan_to_num(self.curvature_systematic) / np.sqrt(3.0)
        return np.asarray(np.hypot(self.curvature_error, other), dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredLaw(ArrayRecord):
    """The monotone moment-curvature law of the first loading, with 95 % intervals.

    Arrays of shape (n,) unless said otherwise; NaN in the stiffnesses where `is_known` is not.

    Parameters
    ----------
    curvature : 1/m, increasing from 0
    moment : N m, at these curvatures
    moment_lower, moment_upper : N m
    secant, secant_lower, secant_upper : N m^2, moment / curvature
    tangent, tangent_lower, tangent_upper : N m^2, slope of moment against curvature
    is_known : whether the curvature is above its noise
    reason : why points are not known; None where all are
    floor : 1/m, below it curvature is not told from its noise
    scale_error : standard uncertainty of the scale of the force, as a share; in the intervals
    residual : m, root mean square distance per coordinate between markers, as means over
        consecutive frames, and the shapes that the law makes
    noise : m, what the noise of the markers alone makes of that
    n_frames : frames that it was found from
    knots : shape (knots,), N m, where the compliance of the law is given
    compliance : shape (knots,), 1/(N m^2), slope of curvature against moment at the knots, linear
        between them
    compliance_covariance : shape (knots, knots), of what scatters and what is common to the test,
        without the scale of the force
    """

    curvature: Vector
    moment: Vector
    moment_lower: Vector
    moment_upper: Vector
    secant: Vector
    secant_lower: Vector
    secant_upper: Vector
    tangent: Vector
    tangent_lower: Vector
    tangent_upper: Vector
    is_known: Annotated[Flags, "n"]
    reason: Reason | None
    floor: float
    scale_error: float
    residual: float
    noise: float
    n_frames: int
    knots: Annotated[Floats, "knots"]
    compliance: Annotated[Floats, "knots"]
    compliance_covariance: Annotated[Floats, "knots", "knots"]


@dataclass(frozen=True, slots=True, eq=False)
class Bending:
    """Moment against curvature as a test shows it.

    Parameters
    ----------
    cloud : all branches
    law : through the first loading; None where there is none
    reason : why there is no law; None where there is one
    """

    cloud: BendingCloud
    law: MeasuredLaw | None
    reason: Reason | None = None
