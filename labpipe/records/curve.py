"""Define the records of stages of processing: clocks, aligned signals, curve, shape, bending."""

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
"""A time, or an array of times."""

AT_REST = -1
"""Index of a branch for samples before, between and after all branches."""

NORMAL_95 = 1.959963984540054
"""Two-sided 95 % quantile of the normal distribution."""


@dataclass(frozen=True, slots=True)
class Interval:
    """Range that contains the true value with a stated probability.

    Parameters
    ----------
    lower, upper : ends of the range, in the unit of the value
    level : probability; 0.95, except in corrected comparisons of groups
    """

    lower: float
    upper: float
    level: float = 0.95

    @classmethod
    def make_normal(cls, value: float, error: float) -> Interval:
        """Make the 95 % interval of a normal distribution, value -+ 1.96 error.

        Parameters
        ----------
        value, error : value and its standard error, in the same unit
        """
        half_width = NORMAL_95 * error
        return cls(value - half_width, value + half_width)

    @property
    def standard_error(self) -> float:
        """Standard error for which this is the normal 95 % interval, in the unit of the ends."""
        return (self.upper - self.lower) / (2.0 * NORMAL_95)


class Direction(StrEnum):
    """Direction of a branch."""

    LOADING = "loading"
    UNLOADING = "unloading"


@dataclass(frozen=True, slots=True)
class Branch:
    """One loading or unloading branch of a curve.

    Parameters
    ----------
    start, stop : indices of the first sample of the branch and of the first sample after it
    cycle : number of the cycle, counted from 1; a loading branch and the unloading branch after it
        form a cycle
    direction : direction of the branch, loading or unloading
    start_time, stop_time : times of the turning points at the ends of the branch, between samples,
        in the time unit of the curve
    """

    start: Annotated[int, Unit("sample")]
    stop: Annotated[int, Unit("sample")]
    cycle: int
    direction: Direction
    start_time: Annotated[float, Unit(unit_field="time_unit")]
    stop_time: Annotated[float, Unit(unit_field="time_unit")]


@dataclass(frozen=True, slots=True, eq=False)
class ClockFit(ArrayRecord):
    """Relation of two clocks: force time = offset + (1 + drift) x marker time.

    Parameters
    ----------
    offset : force time at marker time zero, s
    drift : relative excess of the rate of the force clock over that of the marker clock
    offset_interval, drift_interval : 95 % intervals of offset, s, and drift
    residual : root mean square residual of the straight line at the events, s
    event_times_motion, event_times_force : shape (events,), s, times of the same events on the
        marker clock and on the force clock
    event_errors : shape (events,), s, standard errors of the differences of these times
    method : description of the alignment for the report
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
        """Convert times on the marker clock to times on the force clock, s."""
        return self.offset + (1.0 + self.drift) * marker_time

    def to_marker_time(self, force_time: Time) -> Time:
        """Convert times on the force clock to times on the marker clock, s."""
        return (force_time - self.offset) / (1.0 + self.drift)


@dataclass(frozen=True, slots=True, eq=False)
class Series(ArrayRecord):
    """Samples of one quantity, on the clock of the record that contains them.

    Parameters
    ----------
    values : shape (n,), in `unit`; NaN where there is no measurement
    unit : SI unit of the values
    """

    values: Annotated[Floats, "sample", Unit(unit_field="unit")]
    unit: str


@dataclass(frozen=True, slots=True, eq=False)
class Aligned(ArrayRecord):
    """Calibrated quantities on one clock, without filters.

    Parameters
    ----------
    time : shape (n,), in `time_unit`, times on the clock of the curve
    series : series of shape (n,), keyed by name (``force``, ``travel``, ``displacement``)
    clock_fit : relation of the clocks; None for a single clock
    time_unit : ``s``; ``1`` if the export has no time, and `time` counts its rows
    """

    time: Annotated[Floats, "sample", Unit(unit_field="time_unit")]
    series: Mapping[str, Series]
    clock_fit: ClockFit | None = None
    time_unit: str = "s"


@dataclass(frozen=True, slots=True, eq=False)
class Curve(ArrayRecord):
    """Force against displacement, filtered and zeroed, with its branches.

    Parameters
    ----------
    time : shape (n,), in `time_unit`, times of the samples
    displacement : shape (n,), m; NaN where there is no measurement
    force : shape (n,), N; NaN where there is no measurement
    branches : branches in order of time
    time_unit : ``s``; ``1`` if the export has no time, and `time` counts its rows
    """

    time: Annotated[Floats, "sample", Unit(unit_field="time_unit")]
    displacement: Annotated[Floats, "sample", Unit("m")]
    force: Annotated[Floats, "sample", Unit("N")]
    branches: tuple[Branch, ...]
    time_unit: str = "s"

    @property
    def first_loading(self) -> Branch | None:
        """First loading branch; None if the curve has no loading branch."""
        loadings = (branch for branch in self.branches if branch.direction is Direction.LOADING)
        return next(loadings, None)

    def assign_samples(self) -> tuple[Ints, Ints]:
        """Assign each sample to its branch and its cycle.

        Returns
        -------
        branch_indices : shape (n,), index of the branch in `branches`; `AT_REST` outside branches
        cycle_numbers : shape (n,), number of the cycle, counted from 1; 0 outside branches
        """
        branch_indices = np.full(len(self.time), AT_REST, dtype=np.int64)
        cycle_numbers = np.zeros(len(self.time), dtype=np.int64)
        for index, branch in enumerate(self.branches):
            branch_indices[branch.start : branch.stop] = index
            cycle_numbers[branch.start : branch.stop] = branch.cycle
        return branch_indices, cycle_numbers


@dataclass(frozen=True, slots=True)
class FittedLine:
    """Straight line whose slope is a result, as figures show it.

    Parameters
    ----------
    result : name of the result
    slope : slope of force against displacement, N/m
    level : force of the line at `start`, N
    start, stop : displacements between which the line was fitted, m
    """

    result: str
    slope: Annotated[float, Unit("N/m")]
    level: Annotated[float, Unit("N")]
    start: Annotated[float, Unit("m")]
    stop: Annotated[float, Unit("m")]


class PointFlag(IntEnum):
    """Origin of the position of one point in one frame."""

    MISSING = 0
    """The point has no position: NaN."""
    MEASURED = 1
    """The marker was measured under its own label."""
    RELABELLED = 2
    """The marker was measured under another label."""
    FILLED = 3
    """The position was not measured, but interpolated as the protocol states."""
    CONSTRUCTED = 4
    """The point is no marker, but a clamped end or a pull point, computed from the markers."""


@dataclass(frozen=True, slots=True, eq=False)
class Shape(ArrayRecord):
    """Points along the specimen in every frame of the recording, in the frame of the specimen.

    The x axis of the specimen runs along the undeformed axis, from the clamped end or, between two
    supports, from the middle of the span. The y axis lies in the plane of bending towards the pull,
    and the z axis is normal to that plane.

    Parameters
    ----------
    time : shape (frames,), s, times on the clock of the curve
    positions : shape (frames, points, 3), m; the first point is the clamped end and the last one
        the pull point, if the specimen has them
    names : name of each point, in order along the specimen
    flags : shape (frames, points), origins of the positions, values of `PointFlag`
    arc_length : shape (points,), m, arc length of each point from the first one
    coefficients : shape (frames, 3, terms), m, coefficients of the fitted smooth curve: x, y and z
        are power series in arc length / `length`. Without a fitted curve there are no terms
    length : arc length from the first point to the last, m
    rotation_lab_to_specimen : shape (3, 3), rotation from the frame of the lab to that of the
        specimen
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
    """The slip is noted, and the curve is unchanged."""
    REPAIRED = "repaired"
    """The lost force is added to all later samples; drops of several slips accumulate."""
    CUT = "cut"
    """The curve ends before the slip."""


@dataclass(frozen=True, slots=True)
class Slip:
    """Sudden and lasting loss of force at constant speed.

    Parameters
    ----------
    position : displacement at which the force falls, m
    drop : lost force, N, positive
    position_interval, drop_interval : 95 % intervals of position, m, and drop, N
    decision : treatment of the slip
    start, stop : indices of the last sample before the force falls, and of the first sample after
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
    time : shape (n,), s, middle of the averaged frames on the marker clock
    branch : shape (n,), index of the branch of the curve
    cycle : shape (n,), number of the cycle, counted from 1
    force : shape (n,), N, force of the curve
    arc_length : shape (stations,), m, arc length from the clamped end
    curvature : shape (n, stations), 1/m, change of the curvature from rest
    curvature_error : shape (n, stations), 1/m, standard error from the noise of the markers
    curvature_systematic : shape (n, stations), 1/m, absolute change of the curvature with one more
        coefficient of the shape; NaN where the markers do not allow one more
    moment : shape (n, stations), N m, change of the bending moment from rest
    moment_at_rest : shape (stations,), N m, bending moment at rest
    moment_error : shape (n, stations), N m, standard error of the moment from the noise, scale and
        zero of the force, and from the positions
    frames_per_mean : number of consecutive frames that are averaged in each mean
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
    def total_error(self) -> Floats:
        """Standard errors of the curvature from noise and shape, shape (n, stations), 1/m.

        The error of the shape has a rectangular distribution of half-width `curvature_systematic`.
        Only the noise counts where `curvature_systematic` is NaN.
        """
        shape_error = np.nan_to_num(self.curvature_systematic) / np.sqrt(3.0)
        return np.asarray(np.hypot(self.curvature_error, shape_error), dtype=np.float64)


_Moments: TypeAlias = Annotated[Floats, "point", Unit("N*m")]
_Stiffnesses: TypeAlias = Annotated[Floats, "point", Unit("N*m^2")]


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredLaw(ArrayRecord):
    """Monotone moment-curvature law of the first loading, with 95 % intervals.

    Arrays have the shape (n,) unless stated otherwise. Stiffnesses are NaN where `is_known` is
    False.

    Parameters
    ----------
    curvature : curvatures, 1/m, increasing from 0
    moment : bending moment at each curvature, N m
    moment_lower, moment_upper : ends of the interval of the moment, N m
    secant : secant stiffness, moment / curvature, N m^2
    secant_lower, secant_upper : ends of the interval of the secant stiffness, N m^2
    tangent : tangent stiffness, slope of moment against curvature, N m^2
    tangent_lower, tangent_upper : ends of the interval of the tangent stiffness, N m^2
    is_known : whether the curvature is above `floor` and the interval of the moment is above zero
    reason : reason why points other than the first one, at zero, are not known; None if all points
        are known
    floor : smallest curvature that is distinguished from its noise, 1/m
    scale_error : relative standard uncertainty of the scale of the force, which the intervals
        include
    residual : root mean square distance per coordinate, m, between the markers and the shapes that
        follow from the law; the markers are averaged over consecutive frames
    noise : contribution of the noise of the markers to `residual`, m
    n_frames : number of frames to which the law was fitted
    knots : shape (knots,), N m, moments at which `compliance` is given
    compliance : shape (knots,), 1/(N m^2), derivative of curvature with respect to moment at the
        knots; linear between them
    compliance_covariance : shape (knots, knots), 1/(N m^2)^2, covariance of `compliance` from noise
        and from errors common to the test, without the scale of the force
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
    cloud : curvatures and moments of all branches
    law : law of the first loading; None if it is not available
    reason : reason why there is no law; None if there is one
    """

    cloud: BendingCloud
    law: MeasuredLaw | None
    reason: Reason | None = None


@dataclass(frozen=True, slots=True, eq=False)
class FigureShapes(ArrayRecord):
    """Shapes of a specimen at equal steps of the first loading, for figures.

    Parameters
    ----------
    deflection : shape (steps,), m, deflection of the curve at each step
    positions : shape (steps, points, 2), m, x and y of each point in the frame of the specimen; NaN
        if the point was not measured
    """

    deflection: Annotated[Floats, "steps"]
    positions: Annotated[Floats, "steps", "points", 2]


@dataclass(frozen=True, slots=True, eq=False)
class FigureLaw(ArrayRecord):
    """Measured moment-curvature law of a first loading with its 95 % interval, for figures.

    Parameters
    ----------
    curvature : shape (n,), 1/m, increasing curvatures
    moment : shape (n,), N m, bending moment at each curvature
    moment_lower, moment_upper : shape (n,), N m, ends of the interval of the moment
    """

    curvature: Vector
    moment: Vector
    moment_lower: Vector
    moment_upper: Vector
