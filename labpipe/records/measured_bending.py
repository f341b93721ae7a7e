"""Measured moment-curvature: what frames of a bending test say, and the law through them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labpipe.records.arrays import Flags, Floats, Ints, frozen
from labpipe.records.quality import Reason


@dataclass(frozen=True, slots=True, eq=False)
class BendingCloud:
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

    time: Floats
    branch: Ints
    cycle: Ints
    force: Floats
    arc_length: Floats
    curvature: Floats
    curvature_error: Floats
    curvature_systematic: Floats
    moment: Floats
    moment_error: Floats
    moment_at_rest: Floats
    frames_per_mean: int

    def __post_init__(self) -> None:
        object.__setattr__(self, "time", frozen(self.time, shape=(None,)))
        object.__setattr__(self, "arc_length", frozen(self.arc_length, shape=(None,)))
        count, stations = len(self.time), len(self.arc_length)
        object.__setattr__(self, "force", frozen(self.force, shape=(count,)))
        at_rest = frozen(self.moment_at_rest, shape=(stations,))
        object.__setattr__(self, "moment_at_rest", at_rest)
        for name in ("branch", "cycle"):
            object.__setattr__(self, name, _numbers(getattr(self, name), name, count))
        for name in (
            *("curvature", "curvature_error", "curvature_systematic"),
            *("moment", "moment_error"),
        ):
            values = frozen(getattr(self, name), shape=(count, stations))
            object.__setattr__(self, name, values)

    @property
    def noise(self) -> Floats:
        """Standard error of each curvature, noise and shape together, shape (n, stations), 1/m.

        The shape counts as a rectangle of the half width that one coefficient more makes.
        """
        other = np.nan_to_num(self.curvature_systematic) / np.sqrt(3.0)
        return np.asarray(np.hypot(self.curvature_error, other), dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredLaw:
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

    curvature: Floats
    moment: Floats
    moment_lower: Floats
    moment_upper: Floats
    secant: Floats
    secant_lower: Floats
    secant_upper: Floats
    tangent: Floats
    tangent_lower: Floats
    tangent_upper: Floats
    is_known: Flags
    reason: Reason | None
    floor: float
    scale_error: float
    residual: float
    noise: float
    n_frames: int
    knots: Floats
    compliance: Floats
    compliance_covariance: Floats

    def __post_init__(self) -> None:
        object.__setattr__(self, "curvature", frozen(self.curvature, shape=(None,)))
        count = len(self.curvature)
        for name in (
            *("moment", "moment_lower", "moment_upper", "secant", "secant_lower", "secant_upper"),
            *("tangent", "tangent_lower", "tangent_upper"),
        ):
            object.__setattr__(self, name, frozen(getattr(self, name), shape=(count,)))
        known = np.asarray(self.is_known, dtype=np.bool_).view()
        if known.shape != (count,):
            message = f"expected is_known of shape {(count,)}, found {known.shape}"
            raise ValueError(message)
        known.flags.writeable = False
        object.__setattr__(self, "is_known", known)
        object.__setattr__(self, "knots", frozen(self.knots, shape=(None,)))
        knots = len(self.knots)
        object.__setattr__(self, "compliance", frozen(self.compliance, shape=(knots,)))
        covariance = frozen(self.compliance_covariance, shape=(knots, knots))
        object.__setattr__(self, "compliance_covariance", covariance)


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


def _numbers(values: Ints, name: str, count: int) -> Ints:
    numbers: Ints = np.asarray(values, dtype=np.int64).view()
    if numbers.shape != (count,):
        message = f"expected {name} of shape {(count,)}, found {numbers.shape}"
        raise ValueError(message)
    numbers.flags.writeable = False
    return numbers
