"""Quasi-static path of a cantilever test: solved once, then interpolated.

The path is a function of *progress*, the total distance that the clamp has been driven up and down,
which increases monotonically. Between events (turning points, the string going taut or slack) the
path is smooth and is interpolated by cubic splines through the solved positions.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.interpolate import CubicSpline

from labpipe.law.plays import MomentLaw
from labpipe.records.arrays import Floats
from labpipe.virtual_lab.bundles import BundleModel
from labpipe.virtual_lab.cantilever_scenarios import MechanicalTest
from labpipe.wire.cantilever import (
    CantileverShape,
    StringRig,
    WireState,
    bend_to_travel,
    bend_under_force,
    straight,
)
from labpipe.wire.newton import interpolation_matrix

_MIN_TRAVEL_STEP = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Segment:
    """A part of the path without events; arrays over its solved positions.

    Parameters
    ----------
    cycle : counted from 1
    loading : whether the clamp goes down
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
    """A solved test.

    Parameters
    ----------
    test : solved test
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
        onto = interpolation_matrix(nodes, arc_lengths / self.test.length).T
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
    rig, rest = _set_up(test)
    cycles: list[list[Segment]] = []
    state, bent, starts = rest.state, 0.0, []
    for number in range(1, test.cycles + 1):
        starts.append(state)
        # loops of a rate-independent law close
        if number > 2 and _is_same_state(state, starts[-2]):
            cycles.append([_shift_segment(segment, 2.0 * test.stroke) for segment in cycles[-1]])
            continue
        segments, state, bent = _Cycle(test, rig, number).walk(state, bent)
        cycles.append(segments)
    return MechanicalPath(test, rig, rest, tuple(s for cycle in cycles for s in cycle))


def _set_up(test: MechanicalTest) -> tuple[StringRig, CantileverShape]:
    """Attach the string and find the shape at rest before the motion."""
    law, weight = test.wire.law(), test.gravity * test.counterweight
    unbent = straight(law, test.n_stations, self_weight=test.self_weight)
    level = StringRig(test.string_length, weight, test.length, test.string_length)
    if test.slack is None:
        return level, bend_to_travel(law, unbent, test.length, level, 0.0)
    hanging = bend_under_force(law, unbent, test.length, np.array([0.0, -weight]))
    surplus = test.slack - level.travel_to_taut_string(float(hanging.x[-1]), float(hanging.y[-1]))
    rig = StringRig(test.string_length, weight, test.length, test.string_length - surplus)
    return rig, bend_to_travel(law, hanging.state, test.length, rig, 0.0)


@dataclass(frozen=True, slots=True)
class _Cycle:
    """One cycle of a test, solved position by position; `bent` is the largest curvature so far."""

    test: MechanicalTest
    rig: StringRig
    number: int

    def walk(self, state: WireState, bent: float) -> tuple[list[Segment], WireState, float]:
        """Load and unload: the segments, the state at the end, the largest curvature so far."""
        segments: list[Segment] = []
        progress = 2.0 * self.test.stroke * (self.number - 1)
        for goal in (self.test.stroke, 0.0):
            for shapes in self._branch(state, goal, bent):
                segments.append(_segment(shapes, self.number, goal > 0.0, progress))
                state, progress = shapes[-1].state, float(segments[-1].progress[-1])
                bent = _largest_curvature(shapes, bent)
        return segments, state, bent

    def _branch(
        self, state: WireState, goal: float, bent: float
    ) -> Iterator[list[CantileverShape]]:
        """Solve up to `goal` and yield the shapes of each segment between events, ends included."""
        law = self._law(bent)
        shape = self._shape(law, state, state.travel)
        event = self._taut_travel(law, shape)
        if shape.tension <= 0.0:  # slack: no bending until the string is taut
            stop = min(event, goal) if goal > state.travel else goal
            if abs(stop - state.travel) > _MIN_TRAVEL_STEP:
                end_shape = self._shape(law, shape.state, stop)
                yield [shape, end_shape]
                shape = end_shape
        if abs(goal - shape.state.travel) > _MIN_TRAVEL_STEP:
            yield from self._taut(shape, goal, bent)

    def _taut(
        self, shape: CantileverShape, goal: float, bent: float
    ) -> Iterator[list[CantileverShape]]:
        shapes, test = [shape], self.test
        share = np.linspace(0.0, 1.0, test.steps_per_branch + 1)[1:] ** test.crowding
        for travel in shape.state.travel + share * (goal - shape.state.travel):
            law, ahead, bent = self._step(shapes[-1], float(travel), bent)
            if ahead.tension > 0.0:
                shapes.append(ahead)
                continue
            event = self._taut_travel(law, shapes[-1])
            slackened = _at_zero_tension(self._shape(law, shapes[-1].state, event))
            if abs(event - shapes[-1].state.travel) > _MIN_TRAVEL_STEP:
                shapes.append(slackened)
            yield shapes
            if abs(goal - event) > _MIN_TRAVEL_STEP:
                yield [slackened, self._shape(law, slackened.state, goal)]
            return
        yield shapes

    def _step(
        self, shape: CantileverShape, travel: float, bent: float
    ) -> tuple[MomentLaw, CantileverShape, float]:
        """Solve at a travel with the law for the largest curvature reached there."""
        max_iterations = 20
        force_tolerance = 1e-5
        wire = self.test.wire
        for _ in range(max_iterations):
            law = self._law(bent)
            ahead = self._shape(law, shape.state, travel)
            reached = _largest_curvature([ahead], bent)
            if not isinstance(wire, BundleModel) or reached == bent:
                break
            settled = abs(wire.held(reached) - wire.held(bent)) < force_tolerance
            bent = reached
            if settled:
                break
        return law, ahead, bent

    def _law(self, bent: float) -> MomentLaw:
        """Return the law after a largest curvature, on which only bundles depend."""
        wire = self.test.wire
        return wire.law(self.number, bent) if isinstance(wire, BundleModel) else wire.law()

    def _shape(self, law: MomentLaw, state: WireState, travel: float) -> CantileverShape:
        return bend_to_travel(law, state, self.test.length, self.rig, travel)

    def _taut_travel(self, law: MomentLaw, shape: CantileverShape) -> float:
        """Return the travel at which the string goes taut or slack, m."""
        weight = np.array([0.0, -self.rig.weight])
        hanging = bend_under_force(law, shape.state, self.test.length, weight)
        return self.rig.travel_to_taut_string(float(hanging.x[-1]), float(hanging.y[-1]))


def _at_zero_tension(shape: CantileverShape) -> CantileverShape:
    """Return the shape at which the string goes slack, with exactly zero tension."""
    return replace(shape, state=replace(shape.state, load=0.0))


def _largest_curvature(shapes: list[CantileverShape], bent: float) -> float:
    return max(bent, *(float(np.max(np.abs(shape.curvature))) for shape in shapes))


def _is_same_state(one: WireState, other: WireState) -> bool:
    """Return whether two states have the same history within the accuracy of the solver."""
    largest = float(np.max(np.abs(other.plays), initial=1e-12))
    return bool(np.max(np.abs(one.plays - other.plays), initial=0.0) <= 1e-9 * largest)


def _shift_segment(segment: Segment, progress: float) -> Segment:
    return replace(segment, cycle=segment.cycle + 1, progress=segment.progress + progress)


def _segment(shapes: list[CantileverShape], cycle: int, loading: bool, progress: float) -> Segment:
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
