"""Virtual cantilever tests: settings, and quasi-static path.

Everything is SI. The origin of the specimen frame is the clamped end, with which it moves; x is
along the undeformed axis, y is in the plane of bending towards the pull (up), z is normal to both.
Deflection is y of the pull point minus y at the initial rest. Force is the tension of the string
minus that at the initial rest. Travel is the distance by which the clamp is below its start. The
clock of the cameras is the true time base; force time = offset + (1 + drift) x camera time.

The path is a function of *progress*, the total distance that the clamp has moved up and down.
Events are turning points, and points at which the string becomes taut or slack. Between events the
path is smooth and interpolated by cubic splines through the solved positions.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import TypeAlias

import numpy as np
from scipy.interpolate import CubicSpline

from labpipe.mechanics.law.plays import PlayLaw
from labpipe.mechanics.wire.cantilever import (
    CantileverShape,
    StringRig,
    WireState,
    bend_to_travel,
    bend_under_force,
    make_interpolation_matrix,
    make_straight,
)
from labpipe.records.arrays import Floats
from labpipe.units import GRAVITY
from labpipe.virtual_lab.specimens import TAPED_TYPES, BundleModel, StrandedWire, WireModel

TAPED_LENGTH = 0.1143

VirtualWire: TypeAlias = WireModel | StrandedWire | BundleModel
"""A wire given by its law or by its strands, or a bundle of wires."""


@dataclass(frozen=True, slots=True)
class MechanicalTest:
    """Inputs of the quasi-static path of a test; equal tests share one solution.

    Parameters
    ----------
    wire : whose law is solved
    length : m, clamped end to pull point
    string_length : m
    counterweight : kg, at the pull point
    slack : m, travel of the clamp until the string is taut, while the wire hangs under the
        counterweight; None if the string is taut from the start, holds the wire straight and
        carries the counterweight
    stroke : m
    cycles : number, each with a loading and an unloading branch
    steps_per_branch : number of solved positions of the clamp in a branch
    crowding : exponent of the positions in a branch: they are even with 1; above 1 they are denser
        at its start, where the stiffness changes most
    n_stations : along the wire
    weighs : whether the weight of the wire bends it
    gravity : m/s^2, on wire and counterweight
    """

    wire: VirtualWire = field(default_factory=WireModel)
    length: float = 0.085
    string_length: float = 0.760
    counterweight: float = 0.0027
    slack: float | None = 0.0015
    stroke: float = 0.053
    cycles: int = 3
    steps_per_branch: int = 150
    crowding: float = 1.0
    n_stations: int = 64
    weighs: bool = True
    gravity: float = GRAVITY

    @property
    def mass_per_length(self) -> float:
        """Return the acting mass per length of the wire, kg/m."""
        return self.wire.mass_per_length if self.weighs else 0.0

    @property
    def self_weight(self) -> float:
        """Return the acting weight per length of the wire, N/m."""
        return self.gravity * self.mass_per_length


@dataclass(frozen=True, slots=True)
class Clocks:
    """The two time bases.

    Parameters
    ----------
    rate : Hz, nominal, of the force recorder
    fps : frames per second of the cameras
    offset : s, force time at marker time zero
    drift : dimensionless; force time = offset + (1 + drift) x marker time
    step_ratio : true over nominal step of the recorder, as in its time axis
    """

    rate: float = 10_000.0
    fps: float = 50.0
    offset: float = 1.37
    drift: float = 40e-6
    step_ratio: float = 0.99985


@dataclass(frozen=True, slots=True)
class LoadCell:
    """Load cell, amplifier and converter.

    Parameters
    ----------
    gain : N/V, nominal, as on the calibration sheet
    gain_uncertainty : relative standard uncertainty from which the true gain is drawn
    gain_error : relative error of the true gain, shared by tests; None to draw it
    offset : V, output at no load
    noise : N, rms, white
    bits, full_scale : of the converter, +- `full_scale` in V
    """

    gain: float = 0.5
    gain_uncertainty: float = 0.002
    gain_error: float | None = None
    offset: float = 0.013
    noise: float = 4e-3
    bits: int = 16
    full_scale: float = 10.0


WIRE_CELL = LoadCell(gain=0.05, gain_uncertainty=0.002, noise=0.5e-3)
"""A cell of 0.5 N for forces of 20 to 250 mN, with a noise of 0.5 mN at any rate. All tests of a
campaign share its gain error."""

TAPED_CELL = LoadCell(gain=0.89, gain_uncertainty=0.002, noise=3e-3)
"""A cell of 2 lb (8.9 N at 10 V). All tests of a campaign share its gain error."""


@dataclass(frozen=True, slots=True)
class MarkerLayout:
    """Places of the markers and noise of the cameras.

    Parameters
    ----------
    n_markers : along the wire
    first : m, clamped end to the first marker, along the wire
    pull_offset : m, last marker to pull point, along the wire
    centre_offset : m, wire axis to marker centre along the local normal, towards the pull
    pivot : m, the clamp's pivot in the specimen frame
    noise : m, rms per axis, of a marker
    pivot_noise : m, rms per axis, of the clamp's pivot
    turn_noise : rad, rms per axis, of the clamp's orientation
    scrambled : whether the numbers of the labels are in random order along the wire
    """

    n_markers: int = 8
    first: float = 0.008
    pull_offset: float = 0.004
    centre_offset: float = 0.0008
    pivot: tuple[float, float, float] = (-0.006, -0.009, 0.012)
    noise: float = 3e-5
    pivot_noise: float = 1e-5
    turn_noise: float = 3e-4
    scrambled: bool = True

    def arc_lengths(self, length: float) -> tuple[float, ...]:
        """Return the arc length of each marker from the clamped end, m, evenly spaced."""
        last = length - self.pull_offset
        return tuple(float(s) for s in np.linspace(self.first, last, self.n_markers))


@dataclass(frozen=True, slots=True)
class Pose:
    """Pose of the rig in the frame of the motion-capture system (Y up).

    Parameters
    ----------
    yaw, pitch, roll : rad, about Y, X and Z; roll is applied first, yaw last
    origin : m, the clamped end at zero travel
    """

    yaw: float = 0.65
    pitch: float = 0.04
    roll: float = -0.03
    origin: tuple[float, float, float] = (0.215, 1.031, -0.442)

    def rotation(self) -> Floats:
        """Return the rotation from specimen to lab, shape (3, 3)."""
        cos, sin = np.cos, np.sin
        a, b, c = self.yaw, self.pitch, self.roll
        about_y = np.array([[cos(a), 0, sin(a)], [0, 1, 0], [-sin(a), 0, cos(a)]])
        about_x = np.array([[1, 0, 0], [0, cos(b), -sin(b)], [0, sin(b), cos(b)]])
        about_z = np.array([[cos(c), -sin(c), 0], [sin(c), cos(c), 0], [0, 0, 1]])
        turned: Floats = about_y @ about_x @ about_z
        return turned


@dataclass(frozen=True, slots=True)
class Stretch:
    """Part of a take in which a mishap affects a marker.

    Parameters
    ----------
    marker : counted from 0 at the clamp
    start, stop : shares of the frames of the take, 0 to 1
    """

    marker: int
    start: float
    stop: float


@dataclass(frozen=True, slots=True)
class Mishaps:
    """Mishaps of the markers of a take; `NO_MISHAPS` for a clean one.

    Parameters
    ----------
    n_gaps : short gaps, of 2 to 15 frames, at random times on random markers while the clamp moves
    long_gap : s, length of one long gap on a random marker; 0 for none
    switch : where the marker and the next one swap labels; None for nowhere
    unlabelled : where the marker is renamed ``Unlabeled 1234``; None for nowhere
    """

    n_gaps: int = 8
    long_gap: float = 1.2
    switch: Stretch | None = Stretch(3, 0.40, 0.55)
    unlabelled: Stretch | None = Stretch(5, 0.70, 0.72)


NO_MISHAPS = Mishaps(n_gaps=0, long_gap=0.0, switch=None, unlabelled=None)
MISHAPS = (
    Mishaps(),
    Mishaps(n_gaps=4, long_gap=0.0, switch=Stretch(1, 0.62, 1.0), unlabelled=None),
    Mishaps(n_gaps=12, long_gap=0.8, switch=None, unlabelled=Stretch(2, 0.3, 0.33)),
)
"""Mishaps in the tests of a campaign, in turn."""


@dataclass(frozen=True, slots=True)
class CantileverScenario:
    """A complete virtual test, from wire to test sheet.

    Parameters
    ----------
    name : of the test and of its folder
    specimen_type, spool, sample : for the test sheet
    date : ISO date for the test sheet and the exports
    mechanics : wire and rig
    speed : m/s, of the clamp
    dwell : s, at every turning point
    rest : s, minimum in both records before and after the motion
    clocks, load_cell, markers, pose, mishaps : the instruments
    length_unit : of the motion-capture export: m, cm or mm
    """

    name: str = "A2-085-1"
    specimen_type: str = "A2"
    spool: str = "A2-s1"
    sample: int = 1
    date: str = "2026-03-04"
    mechanics: MechanicalTest = MechanicalTest()
    speed: float = 1e-3
    dwell: float = 0.0
    rest: float = 5.0
    clocks: Clocks = Clocks()
    load_cell: LoadCell = LoadCell()
    markers: MarkerLayout = MarkerLayout()
    pose: Pose = Pose()
    mishaps: Mishaps = field(default_factory=Mishaps)
    length_unit: str = "m"

    @property
    def protocol(self) -> str:
        """Return the name of the shipped protocol."""
        is_bundle = isinstance(self.mechanics.wire, BundleModel)
        return "taped-bundle" if is_bundle else "wire-cantilever"


WIRE_TEST = MechanicalTest(slack=None, steps_per_branch=80, crowding=2.5, n_stations=32)
"""Rig of the dissertation for a stranded wire, held straight by the string. Positions are denser
where the strands begin to slip: the error of the interpolated force is 0.06 mN, and would be 5 mN
with evenly spaced positions. The error from the number of stations is 0.02 mN."""

TAPED_TEST = replace(WIRE_TEST, length=TAPED_LENGTH, steps_per_branch=60, crowding=2.0)
"""The same rig for a taped bundle. The error of the interpolated force is 3 mN, and 12 mN where the
tape begins to slide; the noise is 3 mN. Exports and true values use the same interpolated path."""


def build_wire_scenario(
    wire: StrandedWire, length: float, *, cycles: int = 3
) -> CantileverScenario:
    """Build a test of a stranded wire, without mishaps.

    Parameters
    ----------
    wire : the sample
    length : m
    cycles : number, each with a loading and an unloading branch
    """
    return CantileverScenario(
        specimen_type=wire.name,
        spool=f"{wire.name}-s1",
        mechanics=replace(WIRE_TEST, wire=wire, length=length, cycles=cycles),
        load_cell=WIRE_CELL,
        markers=MarkerLayout(centre_offset=wire.diameter / 2.0),
        mishaps=NO_MISHAPS,
    )


def build_taped_scenario(name: str, *, cycles: int = 3) -> CantileverScenario:
    """Build a test of a taped bundle of the dissertation's Table 4.1, without mishaps.

    Parameters
    ----------
    name : key of `TAPED_TYPES`
    cycles : number, each with a loading and an unloading branch

    Returns
    -------
    The scenario. The string is taut from the start and carries the counterweight. Nine markers are
    at the centres of intervals of half an inch.

    Raises
    ------
    KeyError
        If the type is unknown.
    """
    marker_spacing = 0.0127
    bundle = TAPED_TYPES[name]
    half = 0.5 * marker_spacing
    return CantileverScenario(
        specimen_type=name,
        spool=f"{name}-s1",
        mechanics=replace(TAPED_TEST, wire=bundle, cycles=cycles),
        load_cell=TAPED_CELL,
        markers=MarkerLayout(
            n_markers=9, first=half, pull_offset=half, centre_offset=bundle.radius
        ),
        mishaps=NO_MISHAPS,
        date="2026-03-11",
    )


_MIN_TRAVEL_STEP = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Segment:
    """Part of the path between two events; arrays over its solved positions.

    Parameters
    ----------
    cycle : counted from 1
    loading : whether the clamp moves down
    progress : shape (n,), m, increasing
    travel : shape (n,), m
    tension : shape (n,), N
    x, y, angle : shape (n, stations), m, m, rad
    """

    cycle: int
    loading: bool
    progress: Floats
    travel: Floats
    tension: Floats
    x: Floats
    y: Floats
    angle: Floats

    @property
    def is_still(self) -> bool:
        """Return whether the string is slack and the wire moves with the clamp."""
        return len(self.progress) == 2


@dataclass(frozen=True, slots=True, eq=False)
class MechanicalPath:
    """Solved path of a test.

    Parameters
    ----------
    test : inputs of the path
    rig : the string
    rest : shape before the motion
    segments : in order and contiguous
    """

    test: MechanicalTest
    rig: StringRig
    rest: CantileverShape
    segments: tuple[Segment, ...]

    def travel(self, progress: Floats) -> Floats:
        """Return the travel of the clamp, m, shape (n,); a triangle wave."""
        stroke = self.test.stroke
        inside = np.clip(progress, 0.0, 2.0 * stroke * self.test.cycles)
        saw: Floats = stroke - np.abs(inside % (2.0 * stroke) - stroke)
        return saw

    def tension(self, progress: Floats) -> Floats:
        """Return the tension of the string, N, at nondecreasing progress, shape (n,)."""
        columns = [segment.tension[:, None] for segment in self.segments]
        tension: Floats = self._look_up(progress, columns)[:, 0]
        return tension

    def points(self, progress: Floats, arc_lengths: Floats) -> tuple[Floats, Floats, Floats]:
        """Return places on the wire's axis, and the angle of its tangent.

        Parameters
        ----------
        progress : shape (n,), m, nondecreasing
        arc_lengths : shape (m,), m, from the clamped end

        Returns
        -------
        x, y, angle, each of shape (n, m), in the specimen frame.
        """
        nodes = self.segments[0].x.shape[1]
        onto = make_interpolation_matrix(nodes, arc_lengths / self.test.length).T
        columns = [np.hstack([s.x @ onto, s.y @ onto, s.angle @ onto]) for s in self.segments]
        x, y, angle = np.split(self._look_up(progress, columns), 3, axis=1)
        return x, y, angle

    def deflection(self, progress: Floats) -> Floats:
        """Return the deflection of the pull point, m, at nondecreasing progress, shape (n,)."""
        columns = [segment.y[:, -1:] for segment in self.segments]
        deflection: Floats = self._look_up(progress, columns)[:, 0] - self.rest.y[-1]
        return deflection

    def _look_up(self, progress: Floats, columns: list[Floats]) -> Floats:
        out = np.empty((len(progress), columns[0].shape[1]))
        starts = [segment.progress[0] for segment in self.segments[1:]]
        edges = [0, *np.searchsorted(progress, starts), len(progress)]
        for segment, values, first, last in zip(
            self.segments, columns, edges[:-1], edges[1:], strict=True
        ):
            if last > first:
                out[first:last] = _interpolate(segment, values, progress[first:last])
        return out


def _interpolate(segment: Segment, values: Floats, progress: Floats) -> Floats:
    if segment.is_still:
        return np.tile(values[0], (len(progress), 1))
    inside = np.clip(progress, segment.progress[0], segment.progress[-1])
    values_at: Floats = CubicSpline(segment.progress, values)(inside)
    return values_at


@lru_cache(maxsize=32)
def solve_path(test: MechanicalTest) -> MechanicalPath:
    """Solve a test; equal tests are solved once.

    Parameters
    ----------
    test : wire and rig

    Returns
    -------
    The path.

    Raises
    ------
    ValueError
        If an equilibrium does not exist.
    """
    rig, state_at_rest = _attach_string(test)
    cycles: list[list[Segment]] = []
    state, max_curvature, starts = state_at_rest.state, 0.0, []
    for number in range(1, test.cycles + 1):
        starts.append(state)
        # loops of a rate-independent law close
        if number > 2 and _is_same_state(state, starts[-2]):
            cycles.append([_shift_segment(segment, 2.0 * test.stroke) for segment in cycles[-1]])
            continue
        segments, state, max_curvature = _Cycle(test, rig, number).walk(state, max_curvature)
        cycles.append(segments)
    return MechanicalPath(test, rig, state_at_rest, tuple(s for cycle in cycles for s in cycle))


def _attach_string(test: MechanicalTest) -> tuple[StringRig, CantileverShape]:
    """Return the string, and the shape at rest before the motion."""
    law, weight = test.wire.law(), test.gravity * test.counterweight
    undeformed = make_straight(law, test.n_stations, self_weight=test.self_weight)
    level = StringRig(test.string_length, weight, test.length, test.string_length)
    if test.slack is None:
        return level, bend_to_travel(law, undeformed, test.length, level, 0.0)
    hanging = bend_under_force(law, undeformed, test.length, np.array([0.0, -weight]))
    surplus = test.slack - level.travel_to_taut_string(float(hanging.x[-1]), float(hanging.y[-1]))
    rig = StringRig(test.string_length, weight, test.length, test.string_length - surplus)
    return rig, bend_to_travel(law, hanging.state, test.length, rig, 0.0)


@dataclass(frozen=True, slots=True)
class _Cycle:
    """Solver of a cycle, position by position; `max_curvature` is the largest curvature so far."""

    test: MechanicalTest
    rig: StringRig
    number: int

    def walk(
        self, state: WireState, max_curvature: float
    ) -> tuple[list[Segment], WireState, float]:
        """Load and unload; return segments, final state, and the largest curvature so far."""
        segments: list[Segment] = []
        progress = 2.0 * self.test.stroke * (self.number - 1)
        for target in (self.test.stroke, 0.0):
            for shapes in self._solve_branch(state, target, max_curvature):
                segments.append(_build_segment(shapes, self.number, target > 0.0, progress))
                state, progress = shapes[-1].state, float(segments[-1].progress[-1])
                max_curvature = _find_largest_curvature(shapes, max_curvature)
        return segments, state, max_curvature

    def _solve_branch(
        self, state: WireState, goal: float, max_curvature: float
    ) -> Iterator[list[CantileverShape]]:
        """Solve up to `goal` and yield the shapes of each segment between events, ends included."""
        law = self._find_law(max_curvature)
        shape = self._bend(law, state, state.travel)
        event = self._find_event(law, shape)
        if shape.tension <= 0.0:  # slack: no bending until the string is taut
            stop = min(event, goal) if goal > state.travel else goal
            if abs(stop - state.travel) > _MIN_TRAVEL_STEP:
                end_shape = self._bend(law, shape.state, stop)
                yield [shape, end_shape]
                shape = end_shape
        if abs(goal - shape.state.travel) > _MIN_TRAVEL_STEP:
            yield from self._solve_taut(shape, goal, max_curvature)

    def _solve_taut(
        self, shape: CantileverShape, goal: float, max_curvature: float
    ) -> Iterator[list[CantileverShape]]:
        shapes, test = [shape], self.test
        share = np.linspace(0.0, 1.0, test.steps_per_branch + 1)[1:] ** test.crowding
        for travel in shape.state.travel + share * (goal - shape.state.travel):
            law, ahead, max_curvature = self._solve_step(shapes[-1], float(travel), max_curvature)
            if ahead.tension > 0.0:
                shapes.append(ahead)
                continue
            event = self._find_event(law, shapes[-1])
            slackened = _slacken(self._bend(law, shapes[-1].state, event))
            if abs(event - shapes[-1].state.travel) > _MIN_TRAVEL_STEP:
                shapes.append(slackened)
            yield shapes
            if abs(goal - event) > _MIN_TRAVEL_STEP:
                yield [slackened, self._bend(law, slackened.state, goal)]
            return
        yield shapes

    def _solve_step(
        self, shape: CantileverShape, travel: float, max_curvature: float
    ) -> tuple[PlayLaw, CantileverShape, float]:
        """Solve at a travel with the law for the largest curvature reached there."""
        max_iterations = 20
        force_tolerance = 1e-5
        wire = self.test.wire
        for _ in range(max_iterations):
            law = self._find_law(max_curvature)
            ahead = self._bend(law, shape.state, travel)
            reached = _find_largest_curvature([ahead], max_curvature)
            if not isinstance(wire, BundleModel) or reached == max_curvature:
                break
            settled = abs(wire.held(reached) - wire.held(max_curvature)) < force_tolerance
            max_curvature = reached
            if settled:
                break
        return law, ahead, max_curvature

    def _find_law(self, max_curvature: float) -> PlayLaw:
        """Return the law after a largest curvature, on which only bundles depend."""
        wire = self.test.wire
        return wire.law(self.number, max_curvature) if isinstance(wire, BundleModel) else wire.law()

    def _bend(self, law: PlayLaw, state: WireState, travel: float) -> CantileverShape:
        return bend_to_travel(law, state, self.test.length, self.rig, travel)

    def _find_event(self, law: PlayLaw, shape: CantileverShape) -> float:
        """Return the travel at which the string becomes taut or slack, m."""
        weight = np.array([0.0, -self.rig.weight])
        hanging = bend_under_force(law, shape.state, self.test.length, weight)
        return self.rig.travel_to_taut_string(float(hanging.x[-1]), float(hanging.y[-1]))


def _slacken(shape: CantileverShape) -> CantileverShape:
    """Set the tension of a shape to exactly zero."""
    return replace(shape, state=replace(shape.state, load=0.0))


def _find_largest_curvature(shapes: list[CantileverShape], max_curvature: float) -> float:
    return max(max_curvature, *(float(np.max(np.abs(shape.curvature))) for shape in shapes))


def _is_same_state(one: WireState, other: WireState) -> bool:
    """Return whether two states have the same history within the accuracy of the solver."""
    largest = float(np.max(np.abs(other.plays), initial=1e-12))
    return bool(np.max(np.abs(one.plays - other.plays), initial=0.0) <= 1e-9 * largest)


def _shift_segment(segment: Segment, progress: float) -> Segment:
    return replace(segment, cycle=segment.cycle + 1, progress=segment.progress + progress)


def _build_segment(
    shapes: list[CantileverShape], cycle: int, loading: bool, progress: float
) -> Segment:
    travel = np.array([shape.state.travel for shape in shapes])
    return Segment(
        cycle=cycle,
        loading=loading,
        progress=progress + np.abs(travel - travel[0]),
        travel=travel,
        tension=np.array([shape.tension for shape in shapes]),
        x=np.array([shape.x for shape in shapes]),
        y=np.array([shape.y for shape in shapes]),
        angle=np.array([shape.angle for shape in shapes]),
    )
