"""Virtual three-point bending of a bundle in a conduit: settings, types, and quasi-static path.

Everything is SI. In the specimen frame x is along the bundle, to the right as seen by the cameras,
y is up, z is towards the cameras, and the origin is at mid-span at rest. Displacement is that of
the upper roller, positive downwards; force is the force of that roller. True time begins when the
load frame starts; recorder and cameras have their own clocks.

One half of the bundle is solved; the other half is its mirror image. s is the arc length from
mid-span, where the tangent is horizontal. The history belongs to the material point, which may
slide over the roller. The bundle touches the roller at s = l. Its axis is then at the distance rho,
the sum of both radii, from the centre of the roller:

    theta(s) = integral of kappa(M),   x(s), y(s) = integrals of cos theta, sin theta
    x(l) = a - rho sin theta(l)                 the centre of the roller at half the span a
    d = y(l) + rho (1 - cos theta(l))           displacement of mid-span relative to the supports
    M(s) = (place of contact - place of s) x F,   F = N (normal + mu tangent),   P = 2 F_y

so that the span shrinks and the force inclines as the bundle rotates. Friction acts on the surface,
at the distance r below the axis, and therefore adds a moment mu N r. It opposes sliding: the bundle
is drawn inwards on loading and slides back on unloading. After a start or a reversal, friction
builds up over a short travel u of the crosshead as 1 - exp(-u / u0), which models sticking. Weight
is neglected. When the force returns to zero, the upper roller leaves the bundle.

The problem is linear in the moments: a factor on all moments at given curvatures is the same factor
on all forces at the same positions. Therefore one solution serves all samples of a type.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import ClassVar, TypeAlias

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq

from labpipe.mechanics.law.plays import PlayLaw
from labpipe.messages import format_sentence
from labpipe.records.arrays import Floats
from labpipe.records.harness_bundle import NONE
from labpipe.virtual_lab.cantilever_scenarios import LoadCell, Pose
from labpipe.virtual_lab.specimens import BundleModel, ElasticModel, WireModel

GAIN, OFFSET = -0.21082, 0.002846
"""Calibration of the load cell, N/V and N: force is gain x volts + offset."""

CONDUIT_CELL = LoadCell(
    gain=GAIN, gain_uncertainty=0.002, offset=-OFFSET / GAIN, noise=10e-3, full_scale=100.0
)
"""A cell of 500 lb; the recorder writes the volts of its amplifier, up to 100 V."""


OUTER_DIAMETER = {"corrugated-tube": 10.2e-3, "twist-tube": 8.0e-3}
"""Outer diameter of the conduits, m."""

TAPING_EFFECT = {"coarse": 1.01, "half-lap": 1.02}
"""Factor on all moments for a taped conduit; the tape has almost no effect."""

_INSIDE = BundleModel(friction_share=0.05, glue_share=0.008, tape=NONE, taping=NONE)
"""Wires in a tube are taped only at their ends, so that friction and glue hold them less."""


_TUBE = replace(_INSIDE, conduit="corrugated-tube", conduit_bore=7.4e-3, conduit_stiffness=2e-3)
_TWIST = replace(_INSIDE, conduit="twist-tube", conduit_bore=7.0e-3, conduit_stiffness=1e-3)
_B1, _B2 = (("B1", 19),), (("B2", 19),)


def _tape_conduit(bundle: BundleModel, taping: str) -> BundleModel:
    """Return a bundle whose conduit is taped."""
    return replace(bundle, tape="PVC", taping=taping).scaled(TAPING_EFFECT[taping])


CONDUIT_TYPES = {
    "CWB-1": replace(_TUBE, wires=_B1),
    "CWB-2a": replace(_TUBE, wires=_B2),
    "CWB-2b": _tape_conduit(replace(_TUBE, wires=_B2), "coarse"),
    "CWB-2c": _tape_conduit(replace(_TUBE, wires=_B2), "half-lap"),
    "CWB-3": replace(_TUBE, wires=(("B2", 12),)),
    "CWB-4": replace(_TUBE, wires=(("B1", 10), ("B2", 9)), arrangement="symmetric"),
    "CWB-5": replace(_TWIST, wires=_B1),
    "CWB-6": replace(_TWIST, wires=_B2),
}
"""Bundles in conduits of the dissertation's Table 4.2, by type."""


BentModel: TypeAlias = BundleModel | WireModel | ElasticModel


@dataclass(frozen=True, slots=True)
class ThreePointTest:
    """Inputs of the quasi-static path of a test; equal tests share one solution.

    Parameters
    ----------
    bundle : whose law is solved
    span : m, between the centres of the lower rollers
    overhang : m, of the bundle beyond each lower roller
    roller_radius : m
    outer_radius : m, of the specimen on the rollers
    friction : mu, between specimen and lower rollers
    build_up : u0, m, over which friction builds up or reverses
    stroke : m, of the upper roller, which moves down and up once
    steps_per_branch, crowding : as for `cantilever_scenarios.MechanicalTest`
    n_stations : of one half, evenly spaced
    """

    bundle: BentModel
    span: float = 0.1524
    overhang: float = 0.0254
    roller_radius: float = 5e-3
    outer_radius: float = 5.1e-3
    friction: float = 0.1
    build_up: float = 0.3e-3
    stroke: float = 0.0294
    steps_per_branch: int = 60
    crowding: float = 1.8
    n_stations: int = 97

    @property
    def reach(self) -> float:
        """Return the distance from the centre of a roller to the axis of the bundle, m."""
        return self.roller_radius + self.outer_radius


@dataclass(frozen=True, slots=True)
class ConduitClocks:
    """Three time bases; times are counted from the start of the load frame.

    Parameters
    ----------
    rate : Hz, of the force recorder
    fps : frames per second of the cameras
    frame_rate : Hz, of the load frame's own record
    trigger_lag : s, from the start of the frame to the first sample of the recorder
    recorder_drift : recorder's time = (1 + drift) x (true time - lag)
    camera_lead : s, from the start of the cameras to the start of the frame
    """

    rate: float = 500.0
    fps: float = 25.0
    frame_rate: float = 10.0
    trigger_lag: float = 6e-3
    recorder_drift: float = 20e-6
    camera_lead: float = 1.9


@dataclass(frozen=True, slots=True)
class CylinderMarkers:
    """Spherical markers in lines along a cylinder.

    Parameters
    ----------
    n_sections : odd, one at mid-span
    spacing : m, along the bundle
    angles : rad, of the lines, from the side of the cameras upwards
    centre_offset : m, axis of the bundle to marker centre
    twist : rad, rotation of the sample about its axis at full stroke, right-handed about x. It is
        uniform along the bundle, proportional to the displacement, and constant after the roller
        leaves the bundle
    noise : m, rms per axis
    scrambled : whether the numbers of the labels are in random order
    """

    n_sections: int = 11
    spacing: float = 12.7e-3
    angles: tuple[float, ...] = (0.6108652381980153, -0.6108652381980153)
    centre_offset: float = 6.6e-3
    twist: float = 0.06
    noise: float = 3e-5
    scrambled: bool = True


@dataclass(frozen=True, slots=True)
class FrameCell:
    """Noise and tare of the load frame's own record.

    Parameters
    ----------
    displacement_noise : m, rms
    force_noise : N, rms, of its 50 kN load cell, which is too coarse for these forces
    force_tare : N
    """

    displacement_noise: float = 1e-6
    force_noise: float = 1.5
    force_tare: float = 4.0


@dataclass(frozen=True, slots=True)
class ConduitScenario:
    """A complete virtual test of a conduit bundle.

    Parameters
    ----------
    name : of the test and of its folder
    specimen_type, spool, sample, date : for the test sheet and the exports
    test : bundle and rig; the bundle's own factor is that of its type
    factor : of this sample on all moments and forces
    speed : m/s, of the crosshead
    rest : s, before and after the motion of the crosshead
    clocks, load_cell, markers, frame, pose : the instruments
    has_frame_export : whether the load frame writes an export
    length_unit : of the motion-capture export
    """

    test: ThreePointTest
    name: str = "CWB-1-1"
    specimen_type: str = "CWB-1"
    spool: str = "CWB-1-s1"
    sample: int = 1
    date: str = "2026-03-12"
    factor: float = 1.0
    speed: float = 0.5e-3
    rest: float = 4.0
    clocks: ConduitClocks = ConduitClocks()
    load_cell: LoadCell = CONDUIT_CELL
    markers: CylinderMarkers = CylinderMarkers()
    frame: FrameCell = FrameCell()
    pose: Pose = field(default_factory=Pose)
    has_frame_export: bool = True
    length_unit: str = "m"
    protocol: ClassVar[str] = "conduit-bundle"

    @property
    def bundle(self) -> BundleModel:
        """Return the bundle with the factor of the sample.

        Raises
        ------
        TypeError
            If the specimen is not a bundle.
        """
        if not isinstance(self.test.bundle, BundleModel):
            found = type(self.test.bundle).__name__
            raise TypeError(format_sentence("virtual_lab.no_bundle", found=found))
        return self.test.bundle.scaled(self.factor)


def build_conduit_scenario(name: str) -> ConduitScenario:
    """Build a test of a type of Table 4.2.

    Parameters
    ----------
    name : key of `CONDUIT_TYPES`

    Raises
    ------
    KeyError
        If the type is unknown.
    """
    marker_radius = 1.5e-3
    bundle = CONDUIT_TYPES[name]
    radius = 0.5 * OUTER_DIAMETER[bundle.conduit]
    return ConduitScenario(
        test=ThreePointTest(bundle, outer_radius=radius),
        name=f"{name}-1",
        specimen_type=name,
        spool=f"{name}-s1",
        markers=CylinderMarkers(centre_offset=radius + marker_radius),
    )


_MIN_DISPLACEMENT_STEP = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class ThreePointPath:
    """A solved test.

    Parameters
    ----------
    test : solved test
    arc_length : shape (stations,), m, from mid-span
    loading : shapes from rest to full stroke
    unloading : shapes from full stroke back to rest, or to zero force
    """

    test: ThreePointTest
    arc_length: Floats
    loading: tuple[HalfShape, ...]
    unloading: tuple[HalfShape, ...]

    @property
    def residual(self) -> float:
        """Return the displacement at which unloading reaches zero force, m, or 0."""
        return self.unloading[-1].displacement

    def displacement(self, progress: Floats) -> Floats:
        """Return the position of the upper roller at progress (total travel), m, shape (n,)."""
        inside = np.clip(progress, 0.0, 2.0 * self.test.stroke)
        travel: Floats = self.test.stroke - np.abs(self.test.stroke - inside)
        return travel

    def force(self, progress: Floats) -> Floats:
        """Return the force at progress, N, shape (n,)."""
        return self._look_up(progress, [[half.force] for half in self._halves])[:, 0]

    def middle(self, progress: Floats) -> tuple[Floats, Floats, Floats]:
        """Return displacement, moment and curvature of mid-span, m, N m, 1/m; shape (n,) each."""
        rows = [[h.displacement, h.moment[0], h.curvature[0]] for h in self._halves]
        values = self._look_up(progress, rows)
        return values[:, 0], values[:, 1], values[:, 2]

    def points(self, progress: Floats, arc_length: Floats) -> tuple[Floats, Floats, Floats]:
        """Return places on the axis, and the angle of its tangent.

        Parameters
        ----------
        progress : shape (n,), m
        arc_length : shape (m,), m, from mid-span, negative to the left

        Returns
        -------
        x, y, angle, each of shape (n, m): x to the right from mid-span, y upwards from the
        axis at rest, m, rad.
        """
        side, where = np.sign(arc_length), np.abs(arc_length)
        halves = np.array([np.concatenate([h.x, h.y, h.angle]) for h in self._halves])
        along = halves.reshape(len(halves), 3, -1)
        rows = CubicSpline(self.arc_length, along, axis=2)(where).reshape(len(halves), -1)
        x, y, angle = np.split(self._look_up(progress, rows), 3, axis=1)
        travel, _, _ = self.middle(progress)
        return side * x, y - travel[:, None], side * angle

    @property
    def _halves(self) -> tuple[HalfShape, ...]:
        return self.loading + self.unloading

    def _look_up(self, progress: Floats, rows: object) -> Floats:
        """Interpolate along both branches; the shape is constant after the force is zero."""
        columns = np.asarray(rows, dtype=np.float64)
        n, stroke = len(self.loading), self.test.stroke
        down = CubicSpline([h.displacement for h in self.loading], columns[:n])
        up = CubicSpline([2.0 * stroke - h.displacement for h in self.unloading], columns[n:])
        until = 2.0 * stroke - self.residual
        is_down = (progress <= stroke)[:, None]
        values: Floats = np.where(
            is_down,
            down(np.clip(progress, 0.0, stroke)),
            up(np.clip(progress, stroke, until)),
        )
        return values


@lru_cache(maxsize=64)
def solve_three_point(test: ThreePointTest) -> ThreePointPath:
    """Solve a test; equal tests are solved once.

    Parameters
    ----------
    test : bundle and rig

    Returns
    -------
    The path.

    Raises
    ------
    ValueError
        If an equilibrium does not exist, or the bundle slides off its rollers.
    """
    arc_length = np.linspace(0.0, 0.5 * test.span + test.overhang, test.n_stations)
    half = HalfBundle(test, test.bundle.law(), arc_length)
    state_at_rest = half.release(half.law.make_unbent_history(test.n_stations))
    loading = [state_at_rest, *_solve_branch(half, state_at_rest, test.stroke, is_unloading=False)]
    unloading = [loading[-1], *_solve_branch(half, loading[-1], 0.0, is_unloading=True)]
    return ThreePointPath(test, half.arc_length, tuple(loading), tuple(unloading))


def _solve_branch(
    half: HalfBundle, begin: HalfShape, goal: float, *, is_unloading: bool
) -> Iterator[HalfShape]:
    """Solve up to a displacement; on unloading stop at zero force."""
    test, state = half.test, begin
    share = np.linspace(0.0, 1.0, test.steps_per_branch + 1)[1:] ** test.crowding
    for goal_displacement in (begin.displacement + share * (goal - begin.displacement)).tolist():
        if is_unloading:
            released = half.release(state.plays)
            if released.displacement >= goal_displacement - _MIN_DISPLACEMENT_STEP:
                yield released
                return
        state = _solve_displacement(
            half, state, goal_displacement, begin.displacement, is_unloading=is_unloading
        )
        yield state


def _solve_displacement(
    half: HalfBundle,
    state: HalfShape,
    goal_displacement: float,
    turned_at: float,
    *,
    is_unloading: bool,
) -> HalfShape:
    """Solve at a displacement, with halved steps where Newton's method fails."""
    while True:
        ahead = goal_displacement
        while (
            solved := half.settle(state, ahead, half.friction(ahead - turned_at, is_unloading))
        ) is None:
            ahead = 0.5 * (state.displacement + ahead)
            if abs(ahead - state.displacement) < _MIN_DISPLACEMENT_STEP:
                last = state.displacement
                raise ValueError(
                    format_sentence(
                        "virtual_lab.no_equilibrium", displacement=goal_displacement, last=last
                    )
                )
        if ahead == goal_displacement:
            return solved
        state = solved


@dataclass(frozen=True, slots=True, eq=False)
class HalfShape:
    """Solved shape of one half; arrays of shape (stations,) from mid-span outwards.

    Parameters
    ----------
    displacement : d, m
    force : P, N, of the upper roller
    contact : l, m
    x, y : m, from mid-span, y upwards
    angle : rad
    moment, curvature : N m, 1/m
    plays : shape (stations, plays), N m, the history
    """

    displacement: float
    force: float
    contact: float
    x: Floats
    y: Floats
    angle: Floats
    moment: Floats
    curvature: Floats
    plays: Floats


@dataclass(frozen=True, slots=True, eq=False)
class HalfBundle:
    """Equilibrium of half a bundle on its roller.

    The Jacobian is computed by complex steps: the imaginary part of the residuals at unknowns with
    a tiny imaginary step is the exact derivative (Squire and Trapp 1998).

    Parameters
    ----------
    test : bundle and rig
    law : of every station
    arc_length : shape (stations,), m, from mid-span
    """

    test: ThreePointTest
    law: PlayLaw
    arc_length: Floats

    def friction(self, travel: float, is_unloading: bool) -> float:
        """Return the signed coefficient of friction at a travel after the start or the reversal."""
        built = 1.0 - float(np.exp(-abs(travel) / self.test.build_up))
        return self.test.friction * (1.0 - 2.0 * built if is_unloading else built)

    def release(self, plays: Floats) -> HalfShape:
        """Return the shape without force of a bundle with this history."""
        nothing = np.zeros(self.test.n_stations)
        answer = self.law.respond(nothing, plays)
        shape = self._compute_shape(answer.curvature)

        def gaps(contact: float) -> Floats:
            return self._compute_gaps(self._interpolate(shape, np.float64(contact)))

        last = float(self.arc_length[-1])
        contact = float(brentq(lambda length: gaps(length)[0], 0.0, last, xtol=1e-14))
        travel = float(gaps(contact)[1])
        x, y, angle = shape
        return HalfShape(travel, 0.0, contact, x, y, angle, nothing, answer.curvature, answer.plays)

    def settle(
        self, state: HalfShape, goal_displacement: float, friction: float
    ) -> HalfShape | None:
        """Solve for moments, roller force and contact by Newton's method; None if it fails."""
        max_iterations = 40
        tolerance = 1e-9
        max_turn = 0.3
        unknowns = np.append(state.moment, [0.5 * state.force, state.contact])
        steps = 1e-30j * np.eye(len(unknowns))
        for _ in range(max_iterations):
            answer = self.law.respond(unknowns[:-2], state.plays)
            curvatures = answer.curvature + answer.compliance * steps[:, :-2]
            equations = self._compute_residuals(
                unknowns + steps, curvatures, goal_displacement, friction
            )
            change = -np.linalg.solve(equations.imag.T / 1e-30, equations[-1].real)
            largest = float(np.max(np.abs(self._integrate(answer.compliance * change[:-2]))))
            change *= min(1.0, max_turn / largest) if largest > 0.0 else 1.0
            unknowns = unknowns + change
            if not (0.0 < unknowns[-1] < self.arc_length[-1]) or not np.isfinite(largest):
                return None
            moment = unknowns[:-2]
            if np.max(np.abs(change[:-2])) <= tolerance * (np.max(np.abs(moment)) + 1e-12):
                return self._build_shape(unknowns, state.plays, goal_displacement, friction)
        return None

    def _build_shape(
        self, unknowns: Floats, plays: Floats, goal_displacement: float, friction: float
    ) -> HalfShape:
        moment, normal, contact = unknowns[:-2], float(unknowns[-2]), float(unknowns[-1])
        answer = self.law.respond(moment, plays)
        shape = self._compute_shape(answer.curvature)
        x, y, angle = shape
        _, fy = _compute_direction(self._interpolate(shape, unknowns[-1])[2], friction)
        force = 2.0 * normal * float(fy)
        curvature, after = answer.curvature, answer.plays
        return HalfShape(goal_displacement, force, contact, x, y, angle, moment, curvature, after)

    def _integrate(self, values: Floats) -> Floats:
        """Integrate values at the stations from mid-span to each, by the trapezoidal rule."""
        step = float(self.arc_length[1])
        integral: Floats = cumulative_trapezoid(values, dx=step, axis=-1, initial=0)
        return integral

    def _compute_shape(self, curvature: Floats) -> Floats:
        """Return x, y and angle, shape (3, ..., stations)."""
        angle = self._integrate(curvature)
        return np.stack([self._integrate(np.cos(angle)), self._integrate(np.sin(angle)), angle])

    def _interpolate(self, shape: Floats, contact: Floats | np.float64) -> Floats:
        """Interpolate a shape at contacts between the same two stations, shape (3, ...)."""
        stations = contact / self.arc_length[1]
        below = min(int(stations.real.flat[0]), self.test.n_stations - 2)
        here: Floats = shape[..., below] + (stations - below) * (
            shape[..., below + 1] - shape[..., below]
        )
        return here

    def _compute_gaps(self, touch: Floats) -> Floats:
        """Return the distance of the roller from its place, and the displacement, m, (2, ...)."""
        x, y, angle = touch
        reach = self.test.reach
        gap = x + reach * np.sin(angle) - 0.5 * self.test.span
        return np.stack([gap, y + reach * (1.0 - np.cos(angle))])

    def _compute_residuals(
        self, unknowns: Floats, curvature: Floats, goal_displacement: float, friction: float
    ) -> Floats:
        """Compute the residuals of equilibrium and of both geometric conditions.

        Parameters
        ----------
        unknowns : shape (n, stations + 2), complex: moments, normal force, contact
        curvature : shape (n, stations), 1/m, complex, of these moments
        goal_displacement, friction : displacement, m, and signed coefficient

        Returns
        -------
        shape (n, stations + 2), complex: moments, N m, and both conditions, m.
        """
        moment, normal, contact = unknowns[:, :-2], unknowns[:, -2], unknowns[:, -1]
        shape = self._compute_shape(curvature)
        touch = self._interpolate(shape, contact)
        fx, fy = _compute_direction(touch[2], friction)
        lever_x, lever_y, _ = touch[:, :, None] - shape
        lever = lever_x * fy[:, None] - lever_y * fx[:, None]
        inside = (contact[:, None] - self.arc_length) / self.arc_length[1]
        unit = np.where(inside.real > 0.0, lever, 0.0)
        unit += self.test.outer_radius * friction * np.clip(inside, 0.0, 1.0)
        gap, displacement = self._compute_gaps(touch)
        lacks = [
            moment - normal[:, None] * unit,
            gap[:, None],
            displacement[:, None] - goal_displacement,
        ]
        return np.concatenate(lacks, axis=1)


def _compute_direction(angle: Floats, friction: float) -> tuple[Floats, Floats]:
    """Return the force of the roller per unit of normal force: x and y components."""
    return friction * np.cos(angle) - np.sin(angle), np.cos(angle) + friction * np.sin(angle)
