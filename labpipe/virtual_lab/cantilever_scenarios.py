"""Simulate cantilever tests: settings, quasi-static path, records, and true values.

All numbers are in SI units. The origin of the specimen frame is the clamped end, with which it
moves; x is along the undeformed axis, y is in the plane of bending towards the pull (up), and z is
normal to both. Deflection is y of the pull point minus y at the initial rest. Force is the tension
of the string minus the tension at the initial rest. Travel is the distance by which the clamp is
below its start. The clock of the cameras is the true time base; force time = offset + (1 + drift) x
camera time.

The path is a function of *progress*, the total distance that the clamp has moved up and down.
Events are turning points, and points at which the string becomes taut or slack. Between events the
path is smooth and is interpolated by cubic splines through the solved positions.

True values are computed from curves without noise, with other algorithms than in the processing:
the kink is the best point of a fine grid, refined by a parabola, and the search for the start of
the plateau begins at the end of the curve.

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
    crowding : exponent of the positions in a branch: with 1 they are evenly spaced; above 1 they
        are denser at its start, where the stiffness changes most
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

    @property
    def self_weight(self) -> float:
        """Return the weight per length of the wire, N/m."""
        return self.gravity * self.wire.mass_per_length


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
"""Load cell of 0.5 N for forces of 20 to 250 mN, with a noise of 0.5 mN at any rate. All tests of a
campaign have its gain error in common."""

TAPED_CELL = LoadCell(gain=0.89, gain_uncertainty=0.002, noise=3e-3)
"""Load cell of 2 lb (8.9 N at 10 V). All tests of a campaign have its gain error in common."""


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
    turn_noise : rms noise of the orientation of the clamp per axis, rad
    """

    n_markers: int = 8
    first: float = 0.008
    pull_offset: float = 0.004
    centre_offset: float = 0.0008
    pivot: tuple[float, float, float] = (-0.006, -0.009, 0.012)
    noise: float = 3e-5
    pivot_noise: float = 1e-5
    turn_noise: float = 3e-4

    def list_arc_lengths(self, length: float) -> tuple[float, ...]:
        """List the evenly spaced arc lengths of the markers from the clamped end, m."""
        last = length - self.pull_offset
        return tuple(float(s) for s in np.linspace(self.first, last, self.n_markers))


@dataclass(frozen=True, slots=True)
class CantileverScenario:
    """Complete virtual cantilever test, from wire to test sheet.

    Parameters
    ----------
    name : name of the test and of its folder
    specimen_type, spool, sample : specimen type, spool and sample for the test sheet
    date : ISO date for the test sheet and the exports
    mechanics : wire and rig
    speed : speed of the clamp, m/s
    dwell : dwell at every turning point, s
    rest : shortest rest in both records before and after the motion, s
    clocks, load_cell, markers, pose, mishaps : the instruments and their mishaps
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
        is_bundle = isinstance(self.mechanics.wire, BundleModel)
        return "taped-bundle" if is_bundle else "wire-cantilever"

    def plan_schedule(self) -> Schedule:
        """Plan motion and recordings, with rest at both ends of both records.

        Both records begin at zero on their own clock; the clock of the cameras is the true time.
        """
        clocks, stroke = self.clocks, self.mechanics.stroke
        force_begins = -clocks.offset / (1.0 + clocks.drift)
        start = max(0.0, force_begins) + self.rest
        n_strokes = 2 * self.mechanics.cycles
        strokes = np.arange(n_strokes + 1)
        dwells = np.maximum(strokes - 1, 0) * self.dwell
        arrivals = start + strokes * (stroke / self.speed) + dwells
        departures = arrivals + self.dwell * ((strokes > 0) & (strokes < n_strokes))
        end = float(arrivals[-1] + self.rest)
        frame_times = np.arange(int(np.ceil(end * clocks.fps)) + 1) / clocks.fps
        step = clocks.step_ratio / clocks.rate
        samples = int(np.ceil((end - force_begins) * (1.0 + clocks.drift) / step)) + 1
        force_clock: Floats = step * np.arange(samples, dtype=np.float64)
        return Schedule(
            corner_times=np.ravel(np.column_stack([arrivals, departures])),
            progress=np.repeat(strokes * stroke, 2),
            turning_times=arrivals,
            end=end,
            frame_clock=frame_times,
            frame_times=frame_times,
            force_clock=force_clock,
            force_times=(force_clock - clocks.offset) / (1.0 + clocks.drift),
        )

    def record(self, seed: int) -> tuple[dict[str, Any], Truth]:
        """Simulate the records of force recorder and cameras, and list the true values."""
        path, plan = solve_path(self.mechanics), self.plan_schedule()
        force_random, camera_random = np.random.default_rng(seed).spawn(2)
        force = self._record_force(path, plan, force_random)
        layout = self.markers
        progress = plan.compute_progress(plan.frame_times)
        clamp_offsets = np.zeros((len(progress), 3))
        clamp_offsets[:, 1] = -path.compute_travel(progress)
        arc_lengths = np.array(layout.list_arc_lengths(self.mechanics.length))
        x, y, angle = path.compute_points(progress, arc_lengths)
        offset_x = -layout.centre_offset * np.sin(angle)
        offset_y = layout.centre_offset * np.cos(angle)
        take = simulate_take(
            "Wire",
            np.stack([x + offset_x, y + offset_y, np.zeros_like(x)], axis=2)
            + clamp_offsets[:, None, :],
            plan,
            camera_random,
            pose=self.pose,
            fps=self.clocks.fps,
            unit=self.length_unit,
            noise=layout.noise,
            clamp=(clamp_offsets + np.asarray(layout.pivot), layout.pivot_noise, layout.turn_noise),
            mishaps=self.mishaps,
        )
        truth = {
            "clock": {"offset": self.clocks.offset, "drift": self.clocks.drift},
            "true_gain": force.true_gain,
            "rotation_specimen_to_lab": self.pose.compute_rotation(),
            **_list_specimen_facts(path),
            "markers": list_markers(take.labels, arc_lengths),
            "mishaps": [asdict(event) for event in take.log],
            **_list_true_values(path, plan),
        }
        return {"force": force, "markers": take}, truth

    def _record_force(
        self, path: MechanicalPath, plan: Schedule, random: np.random.Generator
    ) -> ForceRecord:
        """Record the tension of the string, and direction and pulses of the motor."""
        pulses_per_metre = 8e6
        progress = plan.compute_progress(plan.force_times)
        volts, gain = self.load_cell.read(path.compute_tension(progress), random)
        is_moving = np.diff(progress, append=progress[-1]) > 0.0
        is_down = is_moving & (np.floor_divide(progress, self.mechanics.stroke) % 2 == 0)
        signals = {
            FORCE_PATH: volts,
            "Model Root/Motor/Direction": is_down.astype(np.float64),
            "Model Root/Motor/Frequency": is_moving * round(pulses_per_metre * self.speed, 6),
        }
        return ForceRecord(plan.force_clock, signals, gain)

    def describe_specimen(self) -> dict[str, object]:
        """Describe the specimen as entries of the block ``specimen`` of the test sheet, in m."""
        entries: dict[str, object] = {"length": self.mechanics.length}
        wire = self.mechanics.wire
        if wire.mass_per_length:
            entries["mass_per_length"] = f"{1e3 * wire.mass_per_length:.6g} g/m"
        if isinstance(wire, BundleModel):
            entries["bundle"] = wire.describe()
        return entries

    def list_settings(self) -> list[Setting]:
        """List the settings of the rig."""
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
"""Rig of [1]_ for a stranded wire, which the string holds straight. Positions are denser where the
strands begin to slip: the error of the interpolated force is 0.06 mN, and would be 5 mN with evenly
spaced positions. The error from the number of stations is 0.02 mN."""

TAPED_TEST = replace(WIRE_TEST, length=0.1143, steps_per_branch=60, crowding=2.0)
"""The same rig for a taped bundle. The error of the interpolated force is 3 mN, and 12 mN where the
tape begins to slide; the noise is 3 mN. Exports and true values use the same interpolated path."""


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
    factor : factor of the sample on all moments

    Returns
    -------
    The scenario. The string is taut from the start and carries the counterweight. Nine markers are
    at the centres of intervals of half an inch.

    Raises
    ------
    KeyError
        If the type is unknown.
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
"""Smallest step of the travel that is solved, m."""


@dataclass(frozen=True, slots=True, eq=False)
class Segment:
    """Segment of the path between two events, with arrays over its solved positions.

    Parameters
    ----------
    cycle : number of the cycle, from 1
    is_loading : whether the clamp moves down
    progress : shape (n,), m, total distance that the clamp has moved, increasing
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
    rest : shape before the motion
    segments : contiguous segments, in order
    """

    test: MechanicalTest
    rig: StringRig
    rest: CantileverShape
    segments: tuple[Segment, ...]

    def compute_travel(self, progress: Floats) -> Floats:
        """Compute the travel of the clamp, a triangle wave, shape (n,), m."""
        stroke = self.test.stroke
        progress_in_test = np.clip(progress, 0.0, 2.0 * stroke * self.test.cycles)
        return stroke - np.abs(progress_in_test % (2.0 * stroke) - stroke)

    def compute_tension(self, progress: Floats) -> Floats:
        """Compute the tension of the string at nondecreasing progress, shape (n,), N."""
        return self._look_up(progress, [s.tension[:, None] for s in self.segments])[:, 0]

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
        nodes = self.segments[0].x.shape[1]
        interpolation = make_interpolation_matrix(nodes, arc_lengths / self.test.length).T
        columns = [
            np.hstack([s.x @ interpolation, s.y @ interpolation, s.angle @ interpolation])
            for s in self.segments
        ]
        x, y, angle = np.split(self._look_up(progress, columns), 3, axis=1)
        return x, y, angle

    def compute_deflection(self, progress: Floats) -> Floats:
        """Compute the deflection of the pull point at nondecreasing progress, shape (n,), m."""
        height = self._look_up(progress, [s.y[:, -1:] for s in self.segments])[:, 0]
        return np.asarray(height - self.rest.y[-1])

    def compute_curve(self, progress: Floats) -> tuple[Floats, Floats]:
        """Compute deflection, m, and force, N, at nondecreasing progress, shape (n,) each."""
        force = self.compute_tension(progress) - self.rest.tension
        return self.compute_deflection(progress), force

    def _look_up(self, progress: Floats, columns: list[Floats]) -> Floats:
        """Interpolate columns of the segments at nondecreasing progress, shape (n, columns)."""
        interpolated = np.empty((len(progress), columns[0].shape[1]))
        starts = [segment.progress[0] for segment in self.segments[1:]]
        edges = [0, *np.searchsorted(progress, starts), len(progress)]
        stretches = [slice(first, last) for first, last in pairwise(edges)]
        for segment, values, rows in zip(self.segments, columns, stretches, strict=True):
            if segment.is_slack:
                interpolated[rows] = values[0]
            elif rows.stop > rows.start:
                inside = np.clip(progress[rows], segment.progress[0], segment.progress[-1])
                interpolated[rows] = CubicSpline(segment.progress, values)(inside)
        return interpolated


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
    rig, rest = _attach_string(test)
    cycles: list[list[Segment]] = []
    state, max_curvature, starts = rest.state, 0.0, []
    for cycle in range(1, test.cycles + 1):
        starts.append(state)
        # The loops of a rate-independent law are closed: an equal start gives an equal cycle.
        if cycle > 2 and _is_same_state(state, starts[-2]):
            shift, previous = 2.0 * test.stroke, cycles[-1]
            cycles.append([replace(s, cycle=cycle, progress=s.progress + shift) for s in previous])
            continue
        cycles.append([])
        progress = 2.0 * test.stroke * (cycle - 1)
        for goal in (test.stroke, 0.0):
            branch = _Branch(test, rig, cycle, max_curvature)
            for shapes in branch.solve(state, goal):
                travel = np.array([shape.state.travel for shape in shapes])
                distance = progress + np.abs(travel - travel[0])
                arrays = {
                    name: np.array([getattr(shape, name) for shape in shapes])
                    for name in ("tension", "x", "y", "angle")
                }
                cycles[-1].append(Segment(cycle, goal > 0.0, distance, travel, **arrays))
                state, progress = shapes[-1].state, float(distance[-1])
                max_curvature = _find_largest_curvature(shapes, max_curvature)
    return MechanicalPath(test, rig, rest, tuple(s for segments in cycles for s in segments))


def _attach_string(test: MechanicalTest) -> tuple[StringRig, CantileverShape]:
    """Attach the string; return it, and the shape at rest before the motion."""
    law, weight = test.wire.build_law(), test.gravity * test.counterweight
    undeformed = make_straight(law, test.n_stations, self_weight=test.self_weight)
    level_rig = StringRig(test.string_length, weight, test.length, test.string_length)
    if test.slack is None:
        return level_rig, bend_to_travel(law, undeformed, test.length, level_rig, 0.0)
    hanging = bend_under_force(law, undeformed, test.length, np.array([0.0, -weight]))
    surplus = test.slack - level_rig.compute_taut_travel(float(hanging.x[-1]), float(hanging.y[-1]))
    rig = StringRig(test.string_length, weight, test.length, test.string_length - surplus)
    return rig, bend_to_travel(law, hanging.state, test.length, rig, 0.0)


@dataclass(slots=True)
class _Branch:
    """Solver of a branch of a cycle, position by position.

    Parameters
    ----------
    test, rig : wire and string
    cycle : number of the cycle, from 1
    max_curvature : largest curvature so far, on which the law of a bundle depends, 1/m
    """

    test: MechanicalTest
    rig: StringRig
    cycle: int
    max_curvature: float
    _law: PlayLaw = field(init=False)

    def solve(self, state: WireState, goal: float) -> Iterator[list[CantileverShape]]:
        """Solve up to a travel; yield the shapes of each segment, including those at events."""
        self._update_law()
        shape = self._bend(state, state.travel)
        if shape.tension <= 0.0:  # the wire does not bend until the string is taut
            stop = min(self._find_event(shape), goal) if goal > state.travel else goal
            if abs(stop - state.travel) > _MIN_TRAVEL_STEP:
                yield [shape, shape := self._bend(shape.state, stop)]
        if abs(goal - shape.state.travel) > _MIN_TRAVEL_STEP:
            yield from self._solve_taut(shape, goal)

    def _solve_taut(self, shape: CantileverShape, goal: float) -> Iterator[list[CantileverShape]]:
        """Solve with a taut string. When it becomes slack, the wire moves with the clamp."""
        shapes, test = [shape], self.test
        steps = np.linspace(0.0, 1.0, test.steps_per_branch + 1)[1:] ** test.crowding
        for travel in (shape.state.travel + steps * (goal - shape.state.travel)).tolist():
            bent = self._solve_step(shapes[-1].state, travel)
            if bent.tension > 0.0:
                shapes.append(bent)
                continue
            event = self._find_event(shapes[-1])
            bent = self._bend(shapes[-1].state, event)
            slack = replace(bent, state=replace(bent.state, load=0.0))
            if abs(event - shapes[-1].state.travel) > _MIN_TRAVEL_STEP:
                shapes.append(slack)
            yield shapes
            if abs(goal - event) > _MIN_TRAVEL_STEP:
                yield [slack, self._bend(slack.state, goal)]
            return
        yield shapes

    def _solve_step(self, state: WireState, travel: float) -> CantileverShape:
        """Solve at a travel with the law for the largest curvature reached there."""
        max_iterations = 20
        tolerance = 1e-5  # change of the slip factor at convergence
        wire = self.test.wire
        for _ in range(max_iterations):
            self._update_law()
            shape = self._bend(state, travel)
            largest_curvature = _find_largest_curvature([shape], self.max_curvature)
            if not isinstance(wire, BundleModel) or largest_curvature == self.max_curvature:
                break
            previous_factor = wire.compute_slip_factor(self.max_curvature)
            self.max_curvature = largest_curvature
            if abs(wire.compute_slip_factor(largest_curvature) - previous_factor) < tolerance:
                break
        return shape

    def _update_law(self) -> None:
        """Set the law for the largest curvature so far; only the law of a bundle depends on it."""
        wire = self.test.wire
        if isinstance(wire, BundleModel):
            self._law = wire.build_law(self.cycle, self.max_curvature)
        else:
            self._law = wire.build_law()

    def _bend(self, state: WireState, travel: float) -> CantileverShape:
        """Bend the wire from a state to a travel of the clamp, m."""
        return bend_to_travel(self._law, state, self.test.length, self.rig, travel)

    def _find_event(self, shape: CantileverShape) -> float:
        """Find the travel at which the string becomes taut or slack, m."""
        weight = np.array([0.0, -self.rig.weight])
        hanging = bend_under_force(self._law, shape.state, self.test.length, weight)
        return self.rig.compute_taut_travel(float(hanging.x[-1]), float(hanging.y[-1]))


def _find_largest_curvature(shapes: list[CantileverShape], max_curvature: float) -> float:
    """Return the largest curvature of shapes, 1/m, but at least an earlier one."""
    return max(max_curvature, *(float(np.max(np.abs(shape.curvature))) for shape in shapes))


def _is_same_state(first: WireState, second: WireState) -> bool:
    """Return whether the histories of two states differ by at most 1e-9 of their size."""
    largest = float(np.max(np.abs(second.plays), initial=1e-12))
    return bool(np.max(np.abs(first.plays - second.plays), initial=0.0) <= 1e-9 * largest)


KINK_WINDOW = (0.2e-3, 5e-3)
"""Range of displacement of the kink and of the initial stiffness, m."""
TRUTH_POINTS = 20_001
"""Number of points of a branch from which true values are computed."""
_INITIAL_RANGE = 5e-3
"""Range of displacement of the stiffness after zero force, m."""
_FIT_POINTS = 800
"""Number of points of the curve to which lines are fitted."""
_WEIGHT_ROOTS = np.sqrt(np.pad(np.ones(_FIT_POINTS - 2), 1, constant_values=0.5))
"""Square roots of the trapezoidal weights of these points."""


def fit_slope(displacement: Floats, force: Floats, start: float, stop: float) -> float:
    """Fit a line between two displacements by least squares; return its slope, N/m."""
    grid = np.linspace(start, stop, _FIT_POINTS)
    return float(np.polyfit(grid, np.interp(grid, displacement, force), 1, w=_WEIGHT_ROOTS)[0])


def evaluate_loading(displacement: Floats, force: Floats) -> Truth:
    """Compute the true results of a first loading.

    Parameters
    ----------
    displacement : shape (n,), m, displacements from zero, dense enough for linear interpolation
    force : shape (n,), N, forces without noise

    Returns
    -------
    tangent_at_zero : slope of the chord over the first 0.02 mm, N/m
    stiffness, windowed_stiffness : slopes of the least-squares lines over the first 5 mm and over
        `KINK_WINDOW`, N/m
    kink : see `find_kink`
    end_slope : slope of the line over the last 5 mm, divided by ``windowed_stiffness``
    plateau_displacement, plateau_force : displacement and force, m, N, from which on the tangent
        over 1 mm is below a tenth of ``windowed_stiffness``. None if ``end_slope`` is 0.1 or more,
        or if the tangent is never above this limit, or above it at the end
    """
    plateau_ratio = 0.1  # ratio of the slope of a plateau to the slope over the window
    zero_distance = 0.02e-3
    windowed = fit_slope(displacement, force, *KINK_WINDOW)
    last = float(displacement[-1])
    end = fit_slope(displacement, force, last - _INITIAL_RANGE, last)
    limit = plateau_ratio * windowed
    onset = _find_plateau(displacement, force, limit) if end < limit else None
    return {
        "tangent_at_zero": float(np.interp(zero_distance, displacement, force)) / zero_distance,
        "stiffness": fit_slope(displacement, force, 0.0, _INITIAL_RANGE),
        "windowed_stiffness": windowed,
        "kink": find_kink(displacement, force, *KINK_WINDOW),
        "end_slope": end / windowed,
        "plateau_displacement": onset,
        "plateau_force": None if onset is None else float(np.interp(onset, displacement, force)),
    }


def _find_plateau(displacement: Floats, force: Floats, limit: float) -> float | None:
    """Find the displacement, m, at which the tangent over 1 mm last falls below a limit, N/m."""
    step = 1e-3
    grid = np.linspace(0.5 * step, displacement[-1] - 0.5 * step, 2001)
    ends = np.interp([grid - 0.5 * step, grid + 0.5 * step], displacement, force)
    tangent = np.diff(ends, axis=0)[0] / step
    steep_samples = np.flatnonzero(tangent >= limit)
    if len(steep_samples) == 0 or steep_samples[-1] == len(grid) - 1:
        return None
    crossing = slice(steep_samples[-1], steep_samples[-1] + 2)
    return float(np.interp(-limit, -tangent[crossing], grid[crossing]))


def find_kink(displacement: Floats, force: Floats, start: float, stop: float) -> Truth:
    """Find the kink: the break point of the best two connected lines between two displacements.

    Parameters
    ----------
    displacement, force : shape (n,), displacements, m, and forces, N, without noise
    start, stop : displacements between which the lines are fitted, m

    Returns
    -------
    displacement, force : intersection of the best pair of lines by least squares, m, N
    stiffness_before, stiffness_after : slopes of the lines, N/m

    Notes
    -----
    The break point is refined by a parabola through the best point of the grid and its neighbours.
    """
    grid, roots = np.linspace(start, stop, _FIT_POINTS), _WEIGHT_ROOTS
    forces = np.interp(grid, displacement, force)

    def fit(break_point: float) -> tuple[Floats, float]:
        """Fit level, slope and change of slope; return them, and the sum of squares."""
        basis = np.column_stack([np.ones_like(grid), grid, np.maximum(grid - break_point, 0.0)])
        lines = np.linalg.lstsq(roots[:, None] * basis, roots * forces, rcond=None)[0]
        return lines, float(np.sum((roots * (basis @ lines - forces)) ** 2))

    break_points = grid[10:-10]
    misfits = np.array([fit(break_point)[1] for break_point in break_points.tolist()])
    index = int(np.clip(np.argmin(misfits), 1, len(misfits) - 2))
    left, middle, right = misfits[index - 1 : index + 2]
    shift = 0.5 * (left - right) / (left - 2.0 * middle + right)
    step = break_points[1] - break_points[0]
    break_point = float(break_points[index] + np.clip(shift, -1.0, 1.0) * step)
    level, slope, slope_change = fit(break_point)[0].tolist()
    return {
        "displacement": break_point,
        "force": level + slope * break_point,
        "stiffness_before": slope,
        "stiffness_after": slope + slope_change,
    }


@lru_cache(maxsize=32)
def evaluate_taped(path: MechanicalPath) -> Truth:
    """Compute the true results of a bundle in the cantilever rig.

    Parameters
    ----------
    path : solved test, whose displacement is the deflection of the pull point, and whose force is
        the tension of the string minus the tension at rest

    Returns
    -------
    loading : values of the first cycle, see `evaluate_loading`
    bending_stiffness : K L^3 / 3 with the slope K over `KINK_WINDOW`, without corrections, N m^2
    loading_stiffness : slope of each cycle over 5 mm from where the force exceeds its rest value,
        N/m
    hardening : loading stiffness of each cycle, divided by that of the first
    """
    strokes = np.linspace(0.0, 1.0, TRUTH_POINTS)
    starts = [2.0 * cycle for cycle in range(path.test.cycles)]
    branches = [path.compute_curve(path.test.stroke * (start + strokes)) for start in starts]
    loading = evaluate_loading(*branches[0])
    slopes = [_fit_slope_after_slack(*branch) for branch in branches]
    return {
        "loading": loading,
        "bending_stiffness": loading["windowed_stiffness"] * path.test.length**3 / 3.0,
        "loading_stiffness": slopes,
        "hardening": [slope / slopes[0] for slope in slopes],
    }


def _fit_slope_after_slack(displacement: Floats, force: Floats) -> float:
    """Fit the slope over the first 5 mm from where the force exceeds zero, N/m."""
    slack_samples = np.flatnonzero(force <= 0.0)
    last_slack = 0 if len(slack_samples) == 0 else int(slack_samples[-1])
    crossing = slice(last_slack, last_slack + 2)
    start = float(np.interp(0.0, force[crossing], displacement[crossing]))
    return fit_slope(displacement[last_slack:], force[last_slack:], start, start + _INITIAL_RANGE)


def _list_specimen_facts(path: MechanicalPath) -> Truth:
    """List the law of the specimen, its corners for first loading, and its parameters."""
    wire, parameters, bundle = path.test.wire, None, None
    if isinstance(wire, StrandedWire):
        parameters = {**wire.parameters, "sample_factor": wire.factor}
    if isinstance(wire, BundleModel):
        stiffnesses = dict(wire.stiffnesses)
        bundle = {"stiffnesses": stiffnesses, "factor": wire.factor, **evaluate_taped(path)}
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

    ``time``, ``travel``, ``deflection`` and ``force`` are arrays over the frames; ``shapes`` is the
    axis of the wire in the specimen frame at six frames of each branch.
    """
    times, turns = schedule.frame_times, schedule.turning_times
    progress = schedule.compute_progress(times)
    arc_length = np.linspace(0.0, path.test.length, 41)
    shape_times = [np.linspace(start, stop, 6) for start, stop in pairwise(turns)]
    frames = np.unique(np.searchsorted(times, np.concatenate(shape_times)))
    x, y, _ = path.compute_points(schedule.compute_progress(times[frames]), arc_length)
    deflection, force = path.compute_curve(progress)
    return {
        "cycles": [_list_true_cycle_values(path, turns, n) for n in range(1, path.test.cycles + 1)],
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
    """List times, s, peaks, residual deflection at zero force on unloading, and energy, J."""
    start, top, stop = turning_times[2 * cycle - 2 : 2 * cycle + 1].tolist()
    cycle_progress = 2.0 * path.test.stroke
    progress = cycle_progress * (cycle - 1) + np.linspace(0.0, cycle_progress, TRUTH_POINTS)
    deflection, force = path.compute_curve(progress)
    return {
        "cycle": cycle,
        "start_time": start,
        "top_time": top,
        "stop_time": stop,
        "peak_force": float(np.max(force)),
        "peak_deflection": float(np.max(deflection)),
        "residual_deflection": _find_residual(path, cycle),
        "energy": float(np.trapezoid(force, deflection)),
    }


def _find_residual(path: MechanicalPath, cycle: int) -> float | None:
    """Find the deflection, m, at which unloading first reaches zero force; None if it does not."""
    zero_force = 1e-9  # N
    for segment in path.segments:
        if segment.cycle != cycle or segment.is_loading or segment.is_slack:
            continue
        force = segment.tension - path.rest.tension
        if force[-1] > zero_force:
            return None
        progress = float(segment.progress[-1])
        if force[-1] < -zero_force:
            progress = float(CubicSpline(segment.progress, force).roots(extrapolate=False)[0])
        return float(path.compute_deflection(np.array([progress]))[0])
    return None
