"""Simulate cantilever tests: settings, quasi-static path, records, and true values.

All numbers are in SI units. The origin of the specimen frame is the clamped end, with which it
moves; x is along the undeformed axis, y is in the plane of bending towards the pull (up), and z is
normal to both. Deflection is y of the pull point minus y at the initial rest. Force is the tension
of the string minus the tension at the initial rest. Travel is the distance by which the clamp is
below its initial position. The clock of the cameras is the true time base; force time = offset +
(1 + drift) x camera time.

The path is a function of *progress*, the total distance that the clamp has moved up and down.
Events are turning points, and points at which the string becomes taut or slack. Between events the
path is smooth and is interpolated by cubic splines through the solved positions.

True values are computed from curves without noise, by algorithms other than those of the
processing. The kink is the best break point of a fine grid, refined by a parabola. The search for
the start of the plateau begins at the end of the curve.

References
----------
.. [1] *Modeling and characterization of wire harnesses for digital manufacturing applications*,
       dissertation.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass, field, replace
from functools import lru_cache
from itertools import pairwise
from typing import Any, TypeAlias

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
from labpipe.virtual_lab.instruments import (
    FORCE_PATH,
    NO_MISHAPS,
    ForceRecord,
    LoadCell,
    Mishaps,
    Pose,
    Schedule,
    Setting,
    list_markers,
    simulate_take,
)
from labpipe.virtual_lab.specimens import TAPED_TYPES, BundleModel, StrandedWire, WireModel

Truth: TypeAlias = dict[str, Any]
"""True values of a test as in ``truth.json``: numbers, arrays, and tables of them."""

VirtualWire: TypeAlias = WireModel | StrandedWire | BundleModel
"""Wire that is defined by its law or by its strands, or a bundle of wires."""


@dataclass(frozen=True, slots=True)
class MechanicalTest:
    """Inputs of the quasi-static path of a test; equal tests share one solution.

    Parameters
    ----------
    wire : wire with its law
    length : length of the wire from the clamped end to the pull point, m
    string_length : length of the string, m
    counterweight : mass of the counterweight at the pull point, kg
    slack : travel of the clamp until the string is taut, while the wire hangs under the
        counterweight, m; None if the string is taut from the start, holds the wire straight and
        carries the counterweight
    stroke : stroke of the clamp, m
    cycles : number of cycles, each with a loading and an unloading branch
    steps_per_branch : number of solved positions of the clamp in a branch
    crowding : exponent of the positions in a branch. With 1, they are evenly spaced. Above 1, they
        are denser at the start of the branch, where the stiffness changes most
    n_stations : number of stations along the wire
    gravity : acceleration of gravity on wire and counterweight, m/s^2
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
    gravity: float = GRAVITY


@dataclass(frozen=True, slots=True)
class Clocks:
    """Time bases of force recorder and cameras.

    Parameters
    ----------
    rate : nominal sampling rate of the force recorder, Hz
    fps : frames per second of the cameras
    offset : force time at camera time zero, s
    drift : rate of drift; force time = offset + (1 + drift) x camera time
    step_ratio : ratio of the step of the recorder's time axis to its nominal step
    """

    rate: float = 10_000.0
    fps: float = 50.0
    offset: float = 1.37
    drift: float = 40e-6
    step_ratio: float = 0.99985


WIRE_CELL = LoadCell(gain=0.05, gain_uncertainty=0.002, noise=0.5e-3)
"""Load cell of 0.5 N for forces of 20 to 250 mN, with a noise of 0.5 mN at any sampling rate. All
tests of a campaign have the same gain error."""

TAPED_CELL = LoadCell(gain=0.89, gain_uncertainty=0.002, noise=3e-3)
"""Load cell of 2 lb (8.9 N at 10 V). All tests of a campaign have the same gain error."""


@dataclass(frozen=True, slots=True)
class MarkerLayout:
    """Positions of the markers and noise of the cameras.

    Parameters
    ----------
    n_markers : number of markers along the wire
    first : distance from the clamped end to the first marker along the wire, m
    pull_offset : distance from the last marker to the pull point along the wire, m
    centre_offset : distance from the axis of the wire to the centre of a marker, towards the pull
        along the local normal, m
    pivot : position of the pivot of the clamp in the specimen frame, m
    noise : rms noise of a marker per axis, m
    pivot_noise : rms noise of the pivot of the clamp per axis, m
    turn_noise : rms noise of the rotation of the clamp about each axis, rad
    """

    n_markers: int = 8
    first: float = 0.008
    pull_offset: float = 0.004
    centre_offset: float = 0.0008
    pivot: tuple[float, float, float] = (-0.006, -0.009, 0.012)
    noise: float = 3e-5
    pivot_noise: float = 1e-5
    turn_noise: float = 3e-4

    def list_arc_lengths(self, length: float) -> Floats:
        """List the evenly spaced arc lengths, m, of the markers on a wire of a length, m."""
        return np.linspace(self.first, length - self.pull_offset, self.n_markers)


@dataclass(frozen=True, slots=True)
class CantileverScenario:
    """Virtual cantilever test: specimen, rig, instruments, and entries of the test sheet.

    Parameters
    ----------
    name : name of the test and of its folder
    specimen_type, spool, sample : specimen type, spool, and number of the sample in the test sheet
    date : ISO date for the test sheet and the exports
    mechanics : wire and rig, as inputs of the quasi-static path
    speed : speed of the clamp, m/s
    dwell : duration of the rest at every turning point within the motion, s
    rest : shortest rest in both records before and after the motion, s
    clocks : time bases of force recorder and cameras
    load_cell : load cell of the string
    markers : positions of the markers, and noise of the cameras
    pose : pose of the rig in the motion-capture frame
    mishaps : mishaps of the markers
    length_unit : length unit of the motion-capture export: m, cm or mm
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
    load_cell: LoadCell = field(default_factory=LoadCell)
    markers: MarkerLayout = MarkerLayout()
    pose: Pose = field(default_factory=Pose)
    mishaps: Mishaps = field(default_factory=Mishaps)
    length_unit: str = "m"

    @property
    def protocol(self) -> str:
        """Return the name of the shipped protocol."""
        return "taped-bundle" if isinstance(self.mechanics.wire, BundleModel) else "wire-cantilever"

    def plan_schedule(self) -> Schedule:
        """Plan motion and recordings, with rest at both ends of both records.

        Both records begin at zero on their own clock. The clock of the cameras gives the true time.
        """
        clocks, stroke = self.clocks, self.mechanics.stroke
        force_start_time = -clocks.offset / (1.0 + clocks.drift)
        motion_start_time = max(0.0, force_start_time) + self.rest
        stroke_indices = np.arange(2 * self.mechanics.cycles + 1)
        earlier_dwell = np.maximum(stroke_indices - 1, 0) * self.dwell
        arrival_times = motion_start_time + stroke_indices * (stroke / self.speed) + earlier_dwell
        departure_times = arrival_times.copy()
        departure_times[1:-1] += self.dwell
        end_time = float(arrival_times[-1] + self.rest)
        frame_times = np.arange(int(np.ceil(end_time * clocks.fps)) + 1) / clocks.fps
        step = clocks.step_ratio / clocks.rate
        n_samples = int(np.ceil((end_time - force_start_time) * (1.0 + clocks.drift) / step)) + 1
        force_clock: Floats = step * np.arange(n_samples, dtype=np.float64)
        return Schedule(
            corner_times=np.ravel(np.column_stack([arrival_times, departure_times])),
            progress=np.repeat(stroke_indices * stroke, 2),
            turning_times=arrival_times,
            end_time=end_time,
            frame_clock=frame_times,
            frame_times=frame_times,
            force_clock=force_clock,
            force_times=(force_clock - clocks.offset) / (1.0 + clocks.drift),
        )

    def record(self, seed: int) -> tuple[dict[str, Any], Truth]:
        """Simulate the records ``force`` and ``markers``, and list the true values.

        Parameters
        ----------
        seed : seed of gain error, noise, labels and mishaps

        Returns
        -------
        Record of each role, and true values, keyed as in ``truth.json``.
        """
        path, schedule = solve_path(self.mechanics), self.plan_schedule()
        force_random, camera_random = np.random.default_rng(seed).spawn(2)
        force_record = self._record_force(path, schedule, force_random)
        layout = self.markers
        progress = schedule.compute_progress(schedule.frame_times)
        clamp_positions = np.zeros((len(progress), 3))
        clamp_positions[:, 1] = -path.compute_travel(progress)
        arc_lengths = layout.list_arc_lengths(self.mechanics.length)
        x, y, angle = path.compute_points(progress, arc_lengths)
        marker_x = x - layout.centre_offset * np.sin(angle)
        marker_y = y + layout.centre_offset * np.cos(angle)
        marker_positions = np.stack([marker_x, marker_y, np.zeros_like(x)], axis=2)
        pivots = clamp_positions + np.asarray(layout.pivot)
        take = simulate_take(
            "Wire",
            marker_positions + clamp_positions[:, None, :],
            schedule,
            camera_random,
            pose=self.pose,
            fps=self.clocks.fps,
            length_unit=self.length_unit,
            noise=layout.noise,
            clamp=(pivots, layout.pivot_noise, layout.turn_noise),
            mishaps=self.mishaps,
        )
        truth = {
            "clock": {"offset": self.clocks.offset, "drift": self.clocks.drift},
            "true_gain": force_record.true_gain,
            "rotation_specimen_to_lab": self.pose.compute_rotation(),
            **_list_specimen_facts(path),
            "markers": list_markers(take.specimen_labels, arc_lengths),
            "mishaps": [asdict(event) for event in take.mishap_events],
            **_list_true_values(path, schedule),
        }
        return {"force": force_record, "markers": take}, truth

    def _record_force(
        self, path: MechanicalPath, schedule: Schedule, random: np.random.Generator
    ) -> ForceRecord:
        """Record the tension of the string, and direction and pulses of the motor."""
        pulses_per_metre = 8e6
        progress = schedule.compute_progress(schedule.force_times)
        volts, gain = self.load_cell.read(path.compute_tension(progress), random)
        is_moving = np.diff(progress, append=progress[-1]) > 0.0
        is_moving_down = is_moving & (np.floor_divide(progress, self.mechanics.stroke) % 2 == 0)
        signals = {
            FORCE_PATH: volts,
            "Model Root/Motor/Direction": is_moving_down.astype(np.float64),
            "Model Root/Motor/Frequency": is_moving * round(pulses_per_metre * self.speed, 6),
        }
        return ForceRecord(schedule.force_clock, signals, gain)

    def describe_specimen(self) -> dict[str, object]:
        """Describe the specimen as block ``specimen`` of the test sheet; a float is a length, m."""
        entries: dict[str, object] = {"length": self.mechanics.length}
        wire = self.mechanics.wire
        if wire.mass_per_length:
            entries["mass_per_length"] = f"{1e3 * wire.mass_per_length:.6g} g/m"
        if isinstance(wire, BundleModel):
            entries["bundle"] = wire.describe()
        return entries

    def list_settings(self) -> list[Setting]:
        """List the settings of load cell, rig and markers."""
        mechanics, markers = self.mechanics, self.markers
        return [
            *self.load_cell.list_settings(),
            Setting("rig.crosshead_speed", f"{1e3 * self.speed:.10g} mm/s"),
            Setting("rig.stroke", mechanics.stroke),
            Setting("rig.cycles", mechanics.cycles),
            Setting("rig.string.length", mechanics.string_length),
            Setting("rig.string.counterweight", f"{1e3 * mechanics.counterweight:.10g} g"),
            Setting("markers.grip_offset", -markers.pivot[0]),
            Setting("markers.pull_offset", markers.pull_offset),
            Setting("markers.centre_offset", markers.centre_offset),
        ]


WIRE_TEST = MechanicalTest(slack=None, steps_per_branch=80, crowding=2.5, n_stations=32)
"""Rig of [1]_ for a stranded wire, which the string holds straight. Solved positions are denser
where the strands begin to slip: the error of the interpolated force is 0.06 mN, and would be 5 mN
with evenly spaced positions. The error from the number of stations is 0.02 mN."""

TAPED_TEST = replace(WIRE_TEST, length=0.1143, steps_per_branch=60, crowding=2.0)
"""The same rig for a taped bundle. The error of the interpolated force is 3 mN, and 12 mN where the
tape begins to slide; the noise of the load cell is 3 mN. Exports and true values use the same
interpolated path."""


def build_wire_scenario(
    wire: StrandedWire, length: float, *, cycles: int = 3
) -> CantileverScenario:
    """Build a test of a stranded wire, without mishaps.

    Parameters
    ----------
    wire : sample of the wire
    length : length of the wire, m
    cycles : number of cycles, each with a loading and an unloading branch
    """
    return CantileverScenario(
        specimen_type=wire.name,
        spool=f"{wire.name}-s1",
        mechanics=replace(WIRE_TEST, wire=wire, length=length, cycles=cycles),
        load_cell=WIRE_CELL,
        markers=MarkerLayout(centre_offset=wire.diameter / 2.0),
        mishaps=NO_MISHAPS,
    )


def build_taped_scenario(name: str, *, cycles: int = 3, factor: float = 1.0) -> CantileverScenario:
    """Build a test of a taped bundle of Table 4.1 of [1]_, without mishaps.

    Parameters
    ----------
    name : key of `TAPED_TYPES`
    cycles : number of cycles, each with a loading and an unloading branch
    factor : factor of the sample on all moments at given curvatures

    Returns
    -------
    Scenario in which the string is taut from the start and carries the counterweight. Nine markers
    are at the centres of intervals of half an inch.

    Raises
    ------
    KeyError
        If the name is unknown.
    """
    half_interval = 0.5 * 0.0127
    bundle = replace(TAPED_TYPES[name], factor=factor)
    markers = MarkerLayout(
        n_markers=9, first=half_interval, pull_offset=half_interval, centre_offset=bundle.radius
    )
    return CantileverScenario(
        specimen_type=name,
        spool=f"{name}-s1",
        mechanics=replace(TAPED_TEST, wire=bundle, cycles=cycles),
        load_cell=TAPED_CELL,
        markers=markers,
        mishaps=NO_MISHAPS,
        date="2026-03-11",
    )


_MIN_TRAVEL_STEP = 1e-9
"""Smallest step of the travel for which a shape is solved, m."""


@dataclass(frozen=True, slots=True, eq=False)
class Segment:
    """Segment of the path between two events, with arrays over its solved positions.

    Parameters
    ----------
    cycle : number of the cycle, from 1
    is_loading : whether the clamp moves down
    progress : shape (n,), m, increasing, total distance that the clamp has moved up and down
    travel : shape (n,), m, travel of the clamp
    tension : shape (n,), N, tension of the string
    x, y : shape (n, stations), m, positions of the axis of the wire
    angle : shape (n, stations), rad, angle of the tangent of the axis
    """

    cycle: int
    is_loading: bool
    progress: Floats
    travel: Floats
    tension: Floats
    x: Floats
    y: Floats
    angle: Floats

    @property
    def is_slack(self) -> bool:
        """Return whether the string is slack, so that the wire moves with the clamp."""
        return len(self.progress) == 2 and not np.any(self.tension > 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class MechanicalPath:
    """Solved path of a test.

    Parameters
    ----------
    test : inputs of the path
    rig : string with its length and counterweight
    rest_shape : shape before the motion
    segments : contiguous segments, in the order of the motion
    """

    test: MechanicalTest
    rig: StringRig
    rest_shape: CantileverShape
    segments: tuple[Segment, ...]

    def compute_travel(self, progress: Floats) -> Floats:
        """Compute the travel of the clamp, a triangle wave of progress, shape (n,), m."""
        stroke = self.test.stroke
        progress_in_test = np.clip(progress, 0.0, 2.0 * stroke * self.test.cycles)
        return stroke - np.abs(progress_in_test % (2.0 * stroke) - stroke)

    def compute_tension(self, progress: Floats) -> Floats:
        """Compute the tension of the string at nondecreasing progress, shape (n,), N."""
        return self._interpolate(progress, [s.tension[:, None] for s in self.segments])[:, 0]

    def compute_points(
        self, progress: Floats, arc_lengths: Floats
    ) -> tuple[Floats, Floats, Floats]:
        """Compute points of the axis of the wire, and the angle of its tangent.

        Parameters
        ----------
        progress : shape (n,), m, nondecreasing
        arc_lengths : shape (m,), m, arc lengths from the clamped end

        Returns
        -------
        x, y, angle, each of shape (n, m), in m, m and rad in the specimen frame.
        """
        n_stations = self.segments[0].x.shape[1]
        matrix = make_interpolation_matrix(n_stations, arc_lengths / self.test.length).T
        tables = [np.hstack([s.x @ matrix, s.y @ matrix, s.angle @ matrix]) for s in self.segments]
        x, y, angle = np.split(self._interpolate(progress, tables), 3, axis=1)
        return x, y, angle

    def compute_deflection(self, progress: Floats) -> Floats:
        """Compute the deflection of the pull point at nondecreasing progress, shape (n,), m."""
        y = self._interpolate(progress, [s.y[:, -1:] for s in self.segments])[:, 0]
        return np.asarray(y - self.rest_shape.y[-1])

    def compute_curve(self, progress: Floats) -> tuple[Floats, Floats]:
        """Compute deflection, m, and force, N, at nondecreasing progress, shape (n,) each."""
        force = self.compute_tension(progress) - self.rest_shape.tension
        return self.compute_deflection(progress), force

    def _interpolate(self, progress: Floats, tables: list[Floats]) -> Floats:
        """Interpolate tables, one of shape (positions, columns) per segment, at progress, m."""
        interpolated = np.empty((len(progress), tables[0].shape[1]))
        starts = [segment.progress[0] for segment in self.segments[1:]]
        row_limits = [0, *np.searchsorted(progress, starts), len(progress)]
        row_slices = [slice(first, stop) for first, stop in pairwise(row_limits)]
        for segment, table, rows in zip(self.segments, tables, row_slices, strict=True):
            if segment.is_slack:
                interpolated[rows] = table[0]
            elif rows.stop > rows.start:
                positions = np.clip(progress[rows], segment.progress[0], segment.progress[-1])
                interpolated[rows] = CubicSpline(segment.progress, table)(positions)
        return interpolated


@lru_cache(maxsize=32)
def solve_path(test: MechanicalTest) -> MechanicalPath:
    """Solve the path of a test; equal tests are solved once.

    Parameters
    ----------
    test : wire and rig

    Raises
    ------
    ValueError
        If an equilibrium does not exist.
    """
    rig, rest_shape = _attach_string(test)
    cycles: list[list[Segment]] = []
    state, max_curvature, start_states = rest_shape.state, 0.0, []
    for cycle in range(1, test.cycles + 1):
        start_states.append(state)
        # The law does not depend on the rate: two cycles that start in equal states are equal.
        if cycle > 2 and _is_same_state(state, start_states[-2]):
            shift, last_cycle = 2.0 * test.stroke, cycles[-1]
            cycles.append(
                [replace(s, cycle=cycle, progress=s.progress + shift) for s in last_cycle]
            )
            continue
        cycles.append([])
        start_progress = 2.0 * test.stroke * (cycle - 1)
        for end_travel in (test.stroke, 0.0):
            solver = _BranchSolver(test, rig, cycle, max_curvature)
            for shapes in solver.solve(state, end_travel):
                travel = np.array([shape.state.travel for shape in shapes])
                progress = start_progress + np.abs(travel - travel[0])
                arrays = {
                    name: np.array([getattr(shape, name) for shape in shapes])
                    for name in ("tension", "x", "y", "angle")
                }
                cycles[-1].append(Segment(cycle, end_travel > 0.0, progress, travel, **arrays))
                state, start_progress = shapes[-1].state, float(progress[-1])
                max_curvature = _compute_max_curvature(shapes, max_curvature)
    return MechanicalPath(test, rig, rest_shape, tuple(s for cycle in cycles for s in cycle))


def _attach_string(test: MechanicalTest) -> tuple[StringRig, CantileverShape]:
    """Attach the string to the wire; return the rig, and the shape before the motion."""
    law, weight = test.wire.build_law(), test.gravity * test.counterweight
    self_weight = test.gravity * test.wire.mass_per_length
    undeformed_state = make_straight(law, test.n_stations, self_weight=self_weight)
    level_rig = StringRig(test.string_length, weight, test.length, test.string_length)
    if test.slack is None:
        return level_rig, bend_to_travel(law, undeformed_state, test.length, level_rig, 0.0)
    shape = bend_under_force(law, undeformed_state, test.length, np.array([0.0, -weight]))
    taut_travel = level_rig.compute_taut_travel(float(shape.x[-1]), float(shape.y[-1]))
    anchor_height = test.string_length - (test.slack - taut_travel)
    rig = StringRig(test.string_length, weight, test.length, anchor_height)
    return rig, bend_to_travel(law, shape.state, test.length, rig, 0.0)


@dataclass(slots=True)
class _BranchSolver:
    """Solver of a branch of a cycle, position by position.

    Parameters
    ----------
    test : inputs of the path
    rig : string with its length and counterweight
    cycle : number of the cycle, from 1
    max_curvature : largest absolute curvature so far, 1/m, on which the law of a bundle depends
    """

    test: MechanicalTest
    rig: StringRig
    cycle: int
    max_curvature: float
    _law: PlayLaw = field(init=False)

    def solve(self, state: WireState, end_travel: float) -> Iterator[list[CantileverShape]]:
        """Solve up to a travel, m; yield the shapes of each segment, including those at events."""
        self._update_law()
        shape = self._bend(state, state.travel)
        if shape.tension <= 0.0:  # the wire does not bend until the string is taut
            start_shape, slack_end = shape, end_travel
            if end_travel > state.travel:
                slack_end = min(self._compute_event_travel(shape), end_travel)
            if abs(slack_end - state.travel) > _MIN_TRAVEL_STEP:
                shape = self._bend(start_shape.state, slack_end)
                yield [start_shape, shape]
        if abs(end_travel - shape.state.travel) > _MIN_TRAVEL_STEP:
            yield from self._solve_taut(shape, end_travel)

    def _solve_taut(
        self, start_shape: CantileverShape, end_travel: float
    ) -> Iterator[list[CantileverShape]]:
        """Solve while the string is taut; after it becomes slack, the wire moves with the clamp."""
        shapes, test, start_travel = [start_shape], self.test, start_shape.state.travel
        fractions = np.linspace(0.0, 1.0, test.steps_per_branch + 1)[1:] ** test.crowding
        for travel in (start_travel + fractions * (end_travel - start_travel)).tolist():
            shape = self._solve_step(shapes[-1].state, travel)
            if shape.tension > 0.0:
                shapes.append(shape)
                continue
            event_travel = self._compute_event_travel(shapes[-1])
            shape = self._bend(shapes[-1].state, event_travel)
            slack_shape = replace(shape, state=replace(shape.state, load=0.0))
            if abs(event_travel - shapes[-1].state.travel) > _MIN_TRAVEL_STEP:
                shapes.append(slack_shape)
            yield shapes
            if abs(end_travel - event_travel) > _MIN_TRAVEL_STEP:
                yield [slack_shape, self._bend(slack_shape.state, end_travel)]
            return
        yield shapes

    def _solve_step(self, state: WireState, travel: float) -> CantileverShape:
        """Solve at a travel, m, with the law for the largest curvature up to this travel."""
        max_iterations = 20
        tolerance = 1e-5  # change of the slip factor at convergence
        wire = self.test.wire
        for _ in range(max_iterations):
            self._update_law()
            shape = self._bend(state, travel)
            max_curvature = _compute_max_curvature([shape], self.max_curvature)
            if not isinstance(wire, BundleModel) or max_curvature == self.max_curvature:
                break
            previous_factor = wire.compute_slip_factor(self.max_curvature)
            self.max_curvature = max_curvature
            if abs(wire.compute_slip_factor(max_curvature) - previous_factor) < tolerance:
                break
        return shape

    def _update_law(self) -> None:
        """Build the law for `max_curvature`, on which only the law of a bundle depends."""
        wire = self.test.wire
        if isinstance(wire, BundleModel):
            self._law = wire.build_law(self.cycle, self.max_curvature)
        else:
            self._law = wire.build_law()

    def _bend(self, state: WireState, travel: float) -> CantileverShape:
        """Bend the wire from a state to a travel of the clamp, m."""
        return bend_to_travel(self._law, state, self.test.length, self.rig, travel)

    def _compute_event_travel(self, shape: CantileverShape) -> float:
        """Compute the travel, m, at which the string becomes taut or slack, from a near shape."""
        weight = np.array([0.0, -self.rig.weight])
        hanging_shape = bend_under_force(self._law, shape.state, self.test.length, weight)
        return self.rig.compute_taut_travel(float(hanging_shape.x[-1]), float(hanging_shape.y[-1]))


def _compute_max_curvature(shapes: list[CantileverShape], max_curvature: float) -> float:
    """Return the largest of an earlier maximum and the absolute curvatures of shapes, 1/m."""
    return max(max_curvature, *(float(np.max(np.abs(shape.curvature))) for shape in shapes))


def _is_same_state(first: WireState, second: WireState) -> bool:
    """Return whether the plays of two states differ by at most 1e-9 of the largest play."""
    largest_play = float(np.max(np.abs(second.history), initial=1e-12))
    return bool(np.max(np.abs(first.history - second.history), initial=0.0) <= 1e-9 * largest_play)


KINK_WINDOW = (0.2e-3, 5e-3)
"""First and last displacement of the search for the kink, and of ``windowed_stiffness``, m."""
N_TRUTH_POINTS = 20_001
"""Number of points of a branch, or of a cycle, from which true values are computed."""
_FIT_LENGTH = 5e-3
"""Range of displacement of a line that is fitted at the start or at the end of a branch, m."""
_N_FIT_POINTS = 800
"""Number of points of the curve to which a line is fitted."""
_RESIDUAL_WEIGHTS = np.sqrt(np.pad(np.ones(_N_FIT_POINTS - 2), 1, constant_values=0.5))
"""Factors on the residuals of these points: square roots of the trapezoidal weights."""


def fit_slope(displacement: Floats, force: Floats, start: float, stop: float) -> float:
    """Fit a line between two displacements, m, by least squares; return its slope, N/m."""
    grid = np.linspace(start, stop, _N_FIT_POINTS)
    return float(np.polyfit(grid, np.interp(grid, displacement, force), 1, w=_RESIDUAL_WEIGHTS)[0])


def evaluate_loading(displacement: Floats, force: Floats) -> Truth:
    """Compute the true results of a first loading.

    Parameters
    ----------
    displacement : shape (n,), m, displacements from zero, dense enough for linear interpolation
    force : shape (n,), N, forces without noise

    Returns
    -------
    tangent_at_zero : slope of the chord from zero to 0.02 mm, N/m
    stiffness, windowed_stiffness : slopes of the least-squares lines over the first 5 mm and over
        `KINK_WINDOW`, N/m
    kink : values of the kink, see `find_kink`
    end_slope : slope of the line over the last 5 mm, divided by ``windowed_stiffness``
    plateau_displacement, plateau_force : displacement, m, and force, N, after which the slope of
        the chord over 1 mm stays below a tenth of ``windowed_stiffness``. None if ``end_slope`` is
        0.1 or more, if the chord is nowhere as steep as this tenth, or if it still is at the end
    """
    plateau_ratio = 0.1  # largest slope of a plateau, relative to the slope over the window
    chord_length = 0.02e-3
    windowed_stiffness = fit_slope(displacement, force, *KINK_WINDOW)
    stroke = float(displacement[-1])
    end_stiffness = fit_slope(displacement, force, stroke - _FIT_LENGTH, stroke)
    max_slope, onset = plateau_ratio * windowed_stiffness, None
    if end_stiffness < max_slope:
        onset = _find_plateau_onset(displacement, force, max_slope)
    return {
        "tangent_at_zero": float(np.interp(chord_length, displacement, force)) / chord_length,
        "stiffness": fit_slope(displacement, force, 0.0, _FIT_LENGTH),
        "windowed_stiffness": windowed_stiffness,
        "kink": find_kink(displacement, force, *KINK_WINDOW),
        "end_slope": end_stiffness / windowed_stiffness,
        "plateau_displacement": onset,
        "plateau_force": None if onset is None else float(np.interp(onset, displacement, force)),
    }


def _find_plateau_onset(displacement: Floats, force: Floats, max_slope: float) -> float | None:
    """Find the last displacement, m, at which the slope over 1 mm falls below a value, N/m."""
    chord_length, n_chords = 1e-3, 2001
    half_chord = 0.5 * chord_length
    grid = np.linspace(half_chord, displacement[-1] - half_chord, n_chords)
    end_forces = np.interp([grid - half_chord, grid + half_chord], displacement, force)
    slope = np.diff(end_forces, axis=0)[0] / chord_length
    steep_indices = np.flatnonzero(slope >= max_slope)
    if len(steep_indices) == 0 or steep_indices[-1] == len(grid) - 1:
        return None
    crossing = slice(steep_indices[-1], steep_indices[-1] + 2)
    return float(np.interp(-max_slope, -slope[crossing], grid[crossing]))


def find_kink(displacement: Floats, force: Floats, start: float, stop: float) -> Truth:
    """Find the kink, at which the two connected lines of the best least-squares fit intersect.

    Parameters
    ----------
    displacement, force : shape (n,), displacements, m, and forces, N, without noise
    start, stop : displacements between which the lines are fitted, m

    Returns
    -------
    displacement, force : displacement, m, and force, N, at the intersection of the lines
    stiffness_before, stiffness_after : slopes of the lines, N/m

    Notes
    -----
    The break point is refined by a parabola through the best point of the grid and its neighbours.
    """
    grid, weights = np.linspace(start, stop, _N_FIT_POINTS), _RESIDUAL_WEIGHTS
    forces = np.interp(grid, displacement, force)

    def fit_two_lines(break_point: float) -> tuple[Floats, float]:
        """Fit force at zero, slope and change of slope; return them, and the sum of squares."""
        basis = np.column_stack([np.ones_like(grid), grid, np.maximum(grid - break_point, 0.0)])
        coefficients = np.linalg.lstsq(weights[:, None] * basis, weights * forces, rcond=None)[0]
        return coefficients, float(np.sum((weights * (basis @ coefficients - forces)) ** 2))

    break_points = grid[10:-10]  # each line is fitted to at least 10 points
    misfits = np.array([fit_two_lines(break_point)[1] for break_point in break_points.tolist()])
    index = int(np.clip(np.argmin(misfits), 1, len(misfits) - 2))
    misfit_before, misfit, misfit_after = misfits[index - 1 : index + 2]
    shift = 0.5 * (misfit_before - misfit_after) / (misfit_before - 2.0 * misfit + misfit_after)
    step = break_points[1] - break_points[0]
    break_point = float(break_points[index] + np.clip(shift, -1.0, 1.0) * step)
    force_at_zero, slope, slope_change = fit_two_lines(break_point)[0].tolist()
    return {
        "displacement": break_point,
        "force": force_at_zero + slope * break_point,
        "stiffness_before": slope,
        "stiffness_after": slope + slope_change,
    }


@lru_cache(maxsize=32)
def evaluate_bundle(path: MechanicalPath) -> Truth:
    """Compute the true results of a bundle in the cantilever rig.

    Parameters
    ----------
    path : solved path. Displacement is the deflection of the pull point, and force is the tension
        of the string minus the tension at rest

    Returns
    -------
    loading : values of the first loading, see `evaluate_loading`
    bending_stiffness : K L^3 / 3 with the slope K over `KINK_WINDOW`, without corrections, N m^2
    loading_stiffness : slope of each cycle over 5 mm after the last zero of the force on loading,
        N/m
    hardening : loading stiffness of each cycle, divided by that of the first
    """
    fractions, cycles = np.linspace(0.0, 1.0, N_TRUTH_POINTS), range(path.test.cycles)
    loadings = [path.compute_curve(path.test.stroke * (2.0 * n + fractions)) for n in cycles]
    loading = evaluate_loading(*loadings[0])
    slopes = [_fit_slope_after_slack(*curve) for curve in loadings]
    return {
        "loading": loading,
        "bending_stiffness": loading["windowed_stiffness"] * path.test.length**3 / 3.0,
        "loading_stiffness": slopes,
        "hardening": [slope / slopes[0] for slope in slopes],
    }


def _fit_slope_after_slack(displacement: Floats, force: Floats) -> float:
    """Fit the slope over 5 mm after the last zero of the force, N/m."""
    slack_indices = np.flatnonzero(force <= 0.0)
    last_slack = 0 if len(slack_indices) == 0 else int(slack_indices[-1])
    crossing = slice(last_slack, last_slack + 2)
    start = float(np.interp(0.0, force[crossing], displacement[crossing]))
    return fit_slope(displacement[last_slack:], force[last_slack:], start, start + _FIT_LENGTH)


def _list_specimen_facts(path: MechanicalPath) -> Truth:
    """List law and parameters of the specimen, and the corners of its law for first loading."""
    wire, parameters, bundle = path.test.wire, None, None
    if isinstance(wire, StrandedWire):
        parameters = {**wire.parameters, "sample_factor": wire.factor}
    if isinstance(wire, BundleModel):
        bundle = {"stiffnesses": wire.stiffnesses, "factor": wire.factor, **evaluate_bundle(path)}
    law = wire.build_law()
    moment = np.append(0.0, law.half_widths)
    curvature = law.respond(moment, law.make_unbent_history(len(moment))).curvature
    return {
        "law": asdict(wire),
        "wire": parameters,
        "bundle": bundle,
        "first_loading": {"moment": moment.tolist(), "curvature": curvature.tolist()},
    }


def _list_true_values(path: MechanicalPath, schedule: Schedule) -> Truth:
    """List the true values of every cycle and of every camera frame, on the clock of the cameras.

    ``time``, ``travel``, ``deflection`` and ``force`` are arrays over the frames. ``shapes`` are
    shapes of the axis of the wire in the specimen frame, at six times of each branch.
    """
    times, turning_times = schedule.frame_times, schedule.turning_times
    progress = schedule.compute_progress(times)
    arc_length = np.linspace(0.0, path.test.length, 41)
    shape_times = [np.linspace(start, stop, 6) for start, stop in pairwise(turning_times)]
    frames = np.unique(np.searchsorted(times, np.concatenate(shape_times)))
    x, y, _ = path.compute_points(schedule.compute_progress(times[frames]), arc_length)
    deflection, force = path.compute_curve(progress)
    cycles = range(1, path.test.cycles + 1)
    return {
        "cycles": [_list_true_cycle_values(path, turning_times, cycle) for cycle in cycles],
        "time": times,
        "travel": path.compute_travel(progress),
        "deflection": deflection,
        "force": force,
        "shapes": [
            {"frame": frame, "arc_length": arc_length, "x": x[row], "y": y[row]}
            for row, frame in enumerate(frames.tolist())
        ],
    }


def _list_true_cycle_values(path: MechanicalPath, turning_times: Floats, cycle: int) -> Truth:
    """List times, s, peaks, N and m, residual deflection, m, and energy, J, of a cycle."""
    start_time, top_time, stop_time = turning_times[2 * cycle - 2 : 2 * cycle + 1].tolist()
    cycle_progress = 2.0 * path.test.stroke
    progress = cycle_progress * (cycle - 1) + np.linspace(0.0, cycle_progress, N_TRUTH_POINTS)
    deflection, force = path.compute_curve(progress)
    return {
        "cycle": cycle,
        "start_time": start_time,
        "top_time": top_time,
        "stop_time": stop_time,
        "peak_force": float(np.max(force)),
        "peak_deflection": float(np.max(deflection)),
        "residual_deflection": _find_residual_deflection(path, cycle),
        "energy": float(np.trapezoid(force, deflection)),
    }


def _find_residual_deflection(path: MechanicalPath, cycle: int) -> float | None:
    """Find the deflection, m, at the first zero force on unloading; None if there is none."""
    force_tolerance = 1e-9  # largest force that counts as zero, N
    for segment in path.segments:
        if segment.cycle != cycle or segment.is_loading or segment.is_slack:
            continue
        force = segment.tension - path.rest_shape.tension
        if force[-1] > force_tolerance:
            return None
        progress = float(segment.progress[-1])
        if force[-1] < -force_tolerance:
            progress = float(CubicSpline(segment.progress, force).roots(extrapolate=False)[0])
        return float(path.compute_deflection(np.array([progress]))[0])
    return None
