"""Define the stages of processing: clocks, aligned signals, curve, slips, shape, bending."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum, StrEnum
from typing import Annotated, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from labpipe.records.arrays import ArrayRecord, Flags, Floats, Ints, Unit, Vector
from labpipe.records.quality import Reason

Time = TypeVar("Time", float, Floats)
"""One time, or many."""

AT_REST = -1
"""Branch number of samples before, between and after the branches."""

NORMAL_95 = 1.959963984540054
"""Two-sided 95 % quantile of the normal distribution."""


@dataclass(frozen=True, slots=True)
class Interval:
    """A range that contains the true value with probability `level`.

    Parameters
    ----------
    lower, upper : ends, in the unit of the number
    level : probability, 0.95 except in corrected comparisons of groups
    """

    lower: float
    upper: float
    level: float = 0.95

    @classmethod
    def normal_95(cls, value: float, error: float) -> Interval:
        """Make the normal 95 % interval, value -+ 1.96 error, from a standard error."""
        half_width = NORMAL_95 * error
        return cls(value - half_width, value + half_width)

    @property
    def standard_error(self) -> float:
        """Return the standard error of a normal 95 % interval, in the unit of its ends."""
        return (self.upper - self.lower) / (2.0 * NORMAL_95)


class Direction(StrEnum):
    """Direction of a branch."""

    LOADING = "loading"
    UNLOADING = "unloading"


@dataclass(frozen=True, slots=True)
class Branch:
    """One loading or unloading stretch of a curve: samples `start` to `stop`, `stop` excluded.

    Parameters
    ----------
    start, stop : sample numbers
    cycle : counted from 1; a loading branch and the unloading branch after it share it
    direction : loading or unloading
    start_time, stop_time : times of the turning points between the samples, in the time unit of
        the curve
    """

    start: Annotated[int, Unit("sample")]
    stop: Annotated[int, Unit("sample")]
    cycle: int
    direction: Direction
    start_time: Annotated[float, Unit(stated_in="time_unit")]
    stop_time: Annotated[float, Unit(stated_in="time_unit")]


@dataclass(frozen=True, slots=True, eq=False)
class ClockFit(ArrayRecord):
    """Relation of two clocks: force time = offset + (1 + drift) x marker time.

    Parameters
    ----------
    offset : s, force time at marker time zero
    drift : dimensionless, 1e-6 is one part per million
    offset_interval, drift_interval : 95 % intervals
    residual : s, root mean square residual of the straight line at the events
    event_times_motion, event_times_force : shape (events,), s, of the same events on both clocks
    event_errors : shape (events,), s, standard error of the difference at each event
    method : description for the report
    """

    offset: Annotated[float, Unit("s")]
    drift: Annotated[float, Unit("1")]
    offset_interval: Interval
    drift_interval: Interval
    residual: Annotated[float, Unit("s")]
    event_times_motion: Annotated[Floats, "event", Unit("s")]
    event_times_force: Annotated[Floats, "event", Unit("s")]
    event_errors: Annotated[Floats, "event", Unit("s")]
    method: str

    def to_force_time(self, marker_time: Time) -> Time:
        """Return the force-clock time of marker-clock times, s."""
        return self.offset + (1.0 + self.drift) * marker_time

    def to_marker_time(self, force_time: Time) -> Time:
        """Return the marker-clock time of force-clock times, s."""
        return (force_time - self.offset) / (1.0 + self.drift)


@dataclass(frozen=True, slots=True, eq=False)
class Series(ArrayRecord):
    """One quantity on the clock of the record that contains it.

    Parameters
    ----------
    values : shape (n,), in `unit`; NaN where there is no measurement
    unit : SI unit
    """

    values: Annotated[Floats, "sample", Unit(stated_in="unit")]
    unit: str


@dataclass(frozen=True, slots=True, eq=False)
class Aligned(ArrayRecord):
    """Calibrated, unfiltered quantities on one clock.

    Parameters
    ----------
    time : shape (n,), in `time_unit`, the clock of the curve
    series : series by name (``force``, ``travel``, ``displacement``), each of shape (n,)
    clock_fit : relation of the clocks; None for a single clock
    time_unit : ``s``; ``1`` where the export has no time and its rows were counted
    """

    time: Annotated[Floats, "sample", Unit(stated_in="time_unit")]
    series: Mapping[str, Series]
    clock_fit: ClockFit | None = None
    time_unit: str = "s"


@dataclass(frozen=True, slots=True, eq=False)
class Curve(ArrayRecord):
    """Force against displacement, filtered and zeroed, split into branches.

    Parameters
    ----------
    time : shape (n,), in `time_unit`
    displacement : shape (n,), m; NaN where there is no measurement
    force : shape (n,), N; NaN where there is no measurement
    branches : branches in order of travel
    time_unit : ``s``; ``1`` where the export has no time and its rows were counted
    """

    time: Annotated[Floats, "sample", Unit(stated_in="time_unit")]
    displacement: Annotated[Floats, "sample", Unit("m")]
    force: Annotated[Floats, "sample", Unit("N")]
    branches: tuple[Branch, ...]
    time_unit: str = "s"

    @property
    def first_loading(self) -> Branch | None:
        """Return the first loading branch, or None."""
        loadings = (branch for branch in self.branches if branch.direction is Direction.LOADING)
        return next(loadings, None)

    def number_samples(self) -> tuple[Ints, Ints]:
        """Return the branch and the cycle of each sample.

        Returns
        -------
        branch : shape (n,), counted from 0 in order of travel; `AT_REST` outside every branch
        cycle : shape (n,), counted from 1; 0 outside every branch
        """
        branch = np.full(len(self.time), AT_REST, dtype=np.int64)
        cycle = np.zeros(len(self.time), dtype=np.int64)
        for number, item in enumerate(self.branches):
            branch[item.start : item.stop] = number
            cycle[item.start : item.stop] = item.cycle
        return branch, cycle


@dataclass(frozen=True, slots=True)
class FittedLine:
    """A straight line whose slope is a result, for figures.

    Parameters
    ----------
    result : name of the result
    slope : N/m
    level : N, force of the line at `start`
    start, stop : m, displacements between which it was fitted
    """

    result: str
    slope: Annotated[float, Unit("N/m")]
    level: Annotated[float, Unit("N")]
    start: Annotated[float, Unit("m")]
    stop: Annotated[float, Unit("m")]


class PointFlag(IntEnum):
    """Origin of the position of one point in one frame."""

    MISSING = 0
    """No position: NaN."""
    MEASURED = 1
    """Measured under its own label."""
    RELABELLED = 2
    """Measured under another label, and assigned to its marker."""
    FILLED = 3
    """Not measured; filled by the rule of the protocol."""
    CONSTRUCTED = 4
    """No marker: clamped end or pull point, computed from the markers."""


@dataclass(frozen=True, slots=True, eq=False)
class Shape(ArrayRecord):
    """Points along the specimen in every frame, in the specimen frame.

    The frame: x along the undeformed axis, from the clamped end or, between two supports, from the
    middle of the span; y in the plane of bending towards the pull, z out of it.

    Parameters
    ----------
    time : shape (frames,), s, on the clock of the curve
    positions : shape (frames, points, 3), m; the first point is the clamped end and the last one
        the pull point, if the specimen has them
    names : one per point, in order along the specimen
    flags : shape (frames, points), values of `PointFlag`
    arc_length : shape (points,), m, along the specimen from its first point
    coefficients : shape (frames, 3, terms), of the fitted smooth curve: x, y and z are power series
        in arc length / `length`; empty (no terms) when no curve was fitted
    length : m, arc length from the first point to the last
    rotation_lab_to_specimen : shape (3, 3)
    """

    time: Annotated[Floats, "frame", Unit("s")]
    positions: Annotated[Floats, "frame", "point", "xyz", Unit("m")]
    names: Annotated[tuple[str, ...], "point"]
    flags: Annotated[NDArray[np.uint8], "frame", "point", Unit("1")]
    arc_length: Annotated[Floats, "point", Unit("m")]
    coefficients: Annotated[Floats, "frame", "xyz", "term", Unit("m")]
    length: Annotated[float, Unit("m")]
    rotation_lab_to_specimen: Annotated[Floats, "specimen", "lab", Unit("1")]


class SlipDecision(StrEnum):
    """Treatment of a slip."""

    MARKED = "marked"
    """Only noted; the curve is unchanged."""
    REPAIRED = "repaired"
    """The lost force is added to all later samples; drops of several slips accumulate."""
    CUT = "cut"
    """The curve ends before it."""


@dataclass(frozen=True, slots=True)
class Slip:
    """One sudden lasting loss of force at constant speed.

    Parameters
    ----------
    position : m, displacement at which the force falls
    drop : N, force lost, positive
    position_interval, drop_interval : 95 %
    decision : treatment
    start, stop : samples of the curve between which the force falls; `stop` is the first one after
        the fall
    """

    position: Annotated[float, Unit("m")]
    drop: Annotated[float, Unit("N")]
    position_interval: Annotated[Interval, Unit("m")]
    drop_interval: Annotated[Interval, Unit("N")]
    decision: SlipDecision
    start: Annotated[int, Unit("sample")]
    stop: Annotated[int, Unit("sample")]


_CurvatureGrid: TypeAlias = Annotated[Floats, "mean", "place", Unit("1/m")]
_MomentGrid: TypeAlias = Annotated[Floats, "mean", "place", Unit("N*m")]


@dataclass(frozen=True, slots=True, eq=False)
class BendingCloud(ArrayRecord):
    """Curvature and bending moment along the specimen, as means over consecutive frames.

    Parameters
    ----------
    time : shape (n,), s, on the marker clock, middle of the averaged frames
    branch : shape (n,), of the curve, counted from 0
    cycle : shape (n,), counted from 1
    force : shape (n,), N, of the curve
    arc_length : shape (stations,), m, from the clamped end
    curvature : shape (n, stations), 1/m, minus the curvature at rest
    curvature_error : shape (n, stations), 1/m, standard error from the noise of the markers
    curvature_systematic : shape (n, stations), 1/m, absolute change of the curvature with one more
        coefficient of the shape; NaN where the markers do not allow one more
    moment : shape (n, stations), N m, minus the moment at rest
    moment_at_rest : shape (stations,), N m
    moment_error : shape (n, stations), N m, standard error from force, its scale and zero, and the
        positions
    frames_per_mean : consecutive frames that are averaged in each row
    """

    time: Annotated[Floats, "mean", Unit("s")]
    branch: Annotated[Ints, "mean", Unit("1")]
    cycle: Annotated[Ints, "mean", Unit("1")]
    force: Annotated[Floats, "mean", Unit("N")]
    arc_length: Annotated[Floats, "place", Unit("m")]
    curvature: _CurvatureGrid
    curvature_error: _CurvatureGrid
    curvature_systematic: _CurvatureGrid
    moment: _MomentGrid
    moment_error: _MomentGrid
    moment_at_rest: Annotated[Floats, "place", Unit("N*m")]
    frames_per_mean: int

    @property
    def noise(self) -> Floats:
        """Return the combined standard errors of noise and shape, shape (n, stations), 1/m.

        The error of the shape has a rectangular distribution of half-width `curvature_systematic`;
        it is zero where that is NaN.
        """
        shape_error = np.nan_to_num(self.curvature_systematic) / np.sqrt(3.0)
        return np.asarray(np.hypot(self.curvature_error, shape_error), dtype=np.float64)


_Moments: TypeAlias = Annotated[Floats, "point", Unit("N*m")]
_Stiffnesses: TypeAlias = Annotated[Floats, "point", Unit("N*m^2")]


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredLaw(ArrayRecord):
    """The monotone moment-curvature law of the first loading, with 95 % intervals.

    Arrays of shape (n,) unless stated otherwise; stiffnesses are NaN where `is_known` is False.

    Parameters
    ----------
    curvature : 1/m, increasing from 0
    moment : N m
    moment_lower, moment_upper : N m
    secant, secant_lower, secant_upper : N m^2, moment / curvature
    tangent, tangent_lower, tangent_upper : N m^2, slope of moment against curvature
    is_known : whether the curvature is above `floor`, and the interval of the moment above zero
    reason : why points other than the first, at zero, are not known; None if they are
    floor : 1/m, smallest curvature that is distinguished from its noise
    scale_error : relative standard uncertainty of the scale of the force; included in the intervals
    residual : m, root mean square distance per coordinate between the markers, averaged over
        consecutive frames, and the shapes that follow from the law
    noise : m, part of `residual` that the noise of the markers explains
    n_frames : number of frames used
    knots : shape (knots,), N m, moments of `compliance`
    compliance : shape (knots,), 1/(N m^2), slope of curvature against moment at the knots, linear
        between them
    compliance_covariance : shape (knots, knots), of noise and of errors common to the test, without
        the scale of the force
    """

    curvature: Annotated[Floats, "point", Unit("1/m")]
    moment: _Moments
    moment_lower: _Moments
    moment_upper: _Moments
    secant: _Stiffnesses
    secant_lower: _Stiffnesses
    secant_upper: _Stiffnesses
    tangent: _Stiffnesses
    tangent_lower: _Stiffnesses
    tangent_upper: _Stiffnesses
    is_known: Annotated[Flags, "point", Unit("1")]
    reason: Reason | None
    floor: Annotated[float, Unit("1/m")]
    scale_error: Annotated[float, Unit("1")]
    residual: Annotated[float, Unit("m")]
    noise: Annotated[float, Unit("m")]
    n_frames: int
    knots: Annotated[Floats, "knot", Unit("N*m")]
    compliance: Annotated[Floats, "knot", Unit("1/(N*m^2)")]
    compliance_covariance: Annotated[Floats, "knot", "knot", Unit("1/(N*m^2)^2")]


@dataclass(frozen=True, slots=True, eq=False)
class Bending:
    """Measured moment against curvature of a test.

    Parameters
    ----------
    cloud : cloud of all branches
    law : law of the first loading; None if it is not available
    reason : why there is no law; None if there is one
    """

    cloud: BendingCloud
    law: MeasuredLaw | None
    reason: Reason | None = None


@dataclass(frozen=True, slots=True, eq=False)
class DrawnShapes(ArrayRecord):
    """Shapes of a specimen at equal steps of its first loading, for figures.

    Parameters
    ----------
    deflection : shape (steps,), m, of the curve
    positions : shape (steps, points, 2), m, x and y in the specimen frame; NaN where the point was
        not measured
    """

    deflection: Annotated[Floats, "steps"]
    positions: Annotated[Floats, "steps", "points", 2]


@dataclass(frozen=True, slots=True, eq=False)
class DrawnLaw(ArrayRecord):
    """The measured moment-curvature law of a first loading with its 95 % interval, for figures.

    Parameters
    ----------
    curvature : shape (n,), 1/m, increasing
    moment, moment_lower, moment_upper : shape (n,), N m
    """

    curvature: Vector
    moment: Vector
    moment_lower: Vector
    moment_upper: Vector
