"""Simulate three-point bending of a bundle in a conduit: settings, path, records, true values.

All numbers are in SI units. In the specimen frame x is along the bundle, to the right as seen by
the cameras, y is up, z is towards the cameras, and the origin is at mid-span at rest. Displacement
is the displacement of the upper roller, positive downwards; force is the force of that roller. True
time begins when the load frame starts; recorder and cameras have their own clocks.

One half of the bundle is solved; the other half is its mirror image. s is the arc length from
mid-span, where the tangent is horizontal. The history belongs to the material point, which may
slide over the roller. The bundle touches the roller at s = l. Its axis is then at the distance rho,
the sum of both radii, from the centre of the roller:

    theta(s) = integral of kappa(M),   x(s), y(s) = integrals of cos theta, sin theta
    x(l) = a - rho sin theta(l)                 the centre of the roller at half the span a
    d = y(l) + rho (1 - cos theta(l))           displacement of mid-span relative to the supports
    M(s) = (place of contact - place of s) x F,   F = N (normal + mu tangent),   P = 2 F_y

The span thus becomes shorter, and the force inclines, as the bundle rotates. Friction acts on the
surface, at the distance r below the axis, and therefore adds a moment mu N r. It opposes sliding:
the bundle slides inwards on loading and back on unloading. After a start or a reversal, friction
increases over a short travel u of the crosshead as 1 - exp(-u / u0), which models sticking. Weight
is neglected. When the force returns to zero, the upper roller leaves the bundle.

The problem is linear in the moments: a factor on all moments at given curvatures is the same factor
on all forces at the same positions. One solution is therefore valid for all samples of a type.

References
----------
.. [1] *Modeling and characterization of wire harnesses for digital manufacturing applications*,
       dissertation.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any, ClassVar, Protocol

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq

from labpipe.mechanics.law.plays import PlayLaw
from labpipe.messages import format_sentence
from labpipe.records.arrays import Floats
from labpipe.virtual_lab.cantilever_scenarios import (
    TRUTH_POINTS,
    Truth,
    evaluate_loading,
    fit_slope,
)
from labpipe.virtual_lab.instruments import (
    FORCE_PATH,
    ExportLayout,
    ForceRecord,
    FrameRecord,
    LoadCell,
    Pose,
    Schedule,
    Setting,
    Take,
    list_markers,
    simulate_take,
)
from labpipe.virtual_lab.specimens import CONDUIT_TYPES, BundleModel

CONDUIT_CELL = LoadCell(
    gain=-0.21082, gain_uncertainty=0.002, offset=0.002846 / 0.21082, noise=10e-3, full_scale=100.0
)
"""Load cell of 500 lb, calibrated as -0.21082 N/V x volts + 0.002846 N; the recorder writes the
voltage of its amplifier, up to 100 V."""


class BentModel(Protocol):
    """Specimen that a rig bends. Equal specimens share one solution."""

    def build_law(self) -> PlayLaw:
        """Build the law of moment against curvature."""


@dataclass(frozen=True, slots=True)
class ThreePointTest:
    """Inputs of the quasi-static path of a test; equal tests share one solution.

    Parameters
    ----------
    bundle : specimen with its law
    span : distance between the centres of the lower rollers, m
    overhang : length of the bundle beyond each lower roller, m
    roller_radius : radius of the rollers, m
    outer_radius : outer radius of the specimen on the rollers, m
    friction : coefficient of friction mu between specimen and lower rollers
    build_up : travel u0 over which friction builds up or reverses, m
    stroke : stroke of the upper roller, which moves down and up once, m
    steps_per_branch, crowding : see `cantilever_scenarios.MechanicalTest`
    n_stations : number of evenly spaced stations of one half
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
    rate : sampling rate of the force recorder, Hz
    fps : frames per second of the cameras
    frame_rate : sampling rate of the record of the load frame, Hz
    trigger_lag : time from the start of the load frame to the first sample of the recorder, s
    recorder_drift : rate of drift; time of the recorder = (1 + drift) x (true time - lag)
    camera_lead : time from the start of the cameras to the start of the load frame, s
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
    n_sections : odd number of markers of a line, one of them at mid-span
    spacing : distance of the markers of a line, m
    angles : angle of each line, from the side of the cameras upwards, rad
    centre_offset : distance from the axis of the bundle to the centre of a marker, m
    twist : rotation of the sample about its axis at full stroke, right-handed about x, rad. It is
        uniform along the bundle, proportional to the displacement, and constant after the roller
        leaves the bundle
    noise : rms noise of a marker per axis, m
    """

    n_sections: int = 11
    spacing: float = 12.7e-3
    angles: tuple[float, ...] = (0.6108652381980153, -0.6108652381980153)
    centre_offset: float = 6.6e-3
    twist: float = 0.06
    noise: float = 3e-5

    def list_positions(self) -> tuple[Floats, Floats]:
        """List arc lengths from mid-span, m, and angles at rest, rad, of the markers, by line."""
        n_per_side = self.n_sections // 2
        sections = self.spacing * np.arange(-n_per_side, n_per_side + 1)
        return np.tile(sections, len(self.angles)), np.repeat(self.angles, len(sections))


@dataclass(frozen=True, slots=True)
class FrameCell:
    """Noise and tare of the record of the load frame.

    Parameters
    ----------
    displacement_noise : rms noise of the displacement, m
    force_noise : rms noise of the 50 kN load cell, which is too coarse for these forces, N
    force_tare : force without load, N
    """

    displacement_noise: float = 1e-6
    force_noise: float = 1.5
    force_tare: float = 4.0


@dataclass(frozen=True, slots=True)
class ConduitScenario:
    """Complete virtual test of a bundle in a conduit.

    Parameters
    ----------
    name : name of the test and of its folder
    specimen_type, spool, sample, date : texts for the test sheet and the exports
    test : bundle with the factor of its type, and rig
    factor : factor of this sample on all moments and forces
    speed : speed of the crosshead, m/s
    rest : rest before and after the motion of the crosshead, s
    clocks, load_cell, markers, frame, pose : the instruments
    has_frame_export : whether the load frame writes an export
    length_unit : unit of the motion-capture export: m, cm or mm
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
        """Return the bundle with the factor of the sample."""
        bundle = self.test.bundle
        assert isinstance(bundle, BundleModel)  # the specimen of every scenario
        return replace(bundle, factor=bundle.factor * self.factor)

    def plan_schedule(self) -> Schedule:
        """Plan rest, motion down and up without dwell, and rest.

        True time begins when the load frame starts.
        """
        clocks = self.clocks
        stroke_time = self.test.stroke / self.speed
        turning_times: Floats = self.rest + stroke_time * np.arange(3.0)
        end = float(turning_times[-1] + self.rest)
        frames = int((end + clocks.camera_lead) * clocks.fps)
        frame_clock: Floats = np.arange(frames, dtype=np.float64) / clocks.fps
        samples = int((end - clocks.trigger_lag) * clocks.rate)
        force_clock: Floats = np.arange(samples, dtype=np.float64) / clocks.rate
        return Schedule(
            corner_times=turning_times[[0, -1]],
            progress=np.array([0.0, 2.0 * self.test.stroke]),
            turning_times=turning_times,
            end=end,
            frame_clock=frame_clock,
            frame_times=frame_clock - clocks.camera_lead,
            force_clock=force_clock,
            force_times=clocks.trigger_lag + force_clock / (1.0 + clocks.recorder_drift),
        )

    def record(self, seed: int) -> tuple[dict[str, Any], Truth]:
        """Simulate the records of recorder, cameras and frame, and list the true values."""
        path, plan = solve_three_point(self.test), self.plan_schedule()
        force_random, frame_random, camera_random = np.random.default_rng(seed).spawn(3)
        force = self.factor * path.compute_force(plan.compute_progress(plan.force_times))
        volts, gain = self.load_cell.read(force, force_random)
        signals = {FORCE_PATH: volts, "Model Root/Trigger": np.ones(len(volts))}
        take = self._film(path, plan, camera_random)
        records = {"force": ForceRecord(plan.force_clock, signals, gain), "markers": take}
        if self.has_frame_export:
            records["frame"] = self._record_crosshead(path, plan, frame_random)
        truth = {
            "stiffnesses": dict(self.bundle.stiffnesses),
            "true_gain": gain,
            "markers": list_markers(take.labels, self.markers.list_positions()[0]),
            **self._list_true_values(path, plan),
        }
        return records, truth

    def _film(self, path: ThreePointPath, plan: Schedule, random: np.random.Generator) -> Take:
        """Simulate the take of marker lines on a cylinder that bends and twists."""
        layout, progress = self.markers, plan.compute_progress(plan.frame_times)
        sections, angles = layout.list_positions()
        x, y, angle = path.compute_points(progress, sections)
        rolled_angles = angles - self._compute_twist(path, progress)[:, None]
        height = layout.centre_offset * np.sin(rolled_angles)
        depth = layout.centre_offset * np.cos(rolled_angles)
        return simulate_take(
            "Bundle",
            np.stack([x - height * np.sin(angle), y + height * np.cos(angle), depth], axis=2),
            plan,
            random,
            pose=self.pose,
            fps=self.clocks.fps,
            unit=self.length_unit,
            noise=layout.noise,
        )

    def _compute_twist(self, path: ThreePointPath, progress: Floats) -> Floats:
        """Compute the twist of the sample, right-handed about x, shape (n,), rad."""
        return self.markers.twist * path.compute_mid_span(progress)[0] / path.test.stroke

    def _record_crosshead(
        self, path: ThreePointPath, plan: Schedule, random: np.random.Generator
    ) -> FrameRecord:
        """Simulate the record of the load frame, which begins after half a sampling interval."""
        step, frame = 1.0 / self.clocks.frame_rate, self.frame
        time: Floats = np.arange(0.5 * step, plan.end, step)
        progress = plan.compute_progress(time)
        noise = random.standard_normal((2, len(time)))
        force = self.factor * path.compute_force(progress)
        return FrameRecord(
            time=time,
            displacement=path.compute_displacement(progress) + frame.displacement_noise * noise[0],
            force=force + frame.force_tare + frame.force_noise * noise[1],
            layout=ExportLayout("N"),
            test_type="three-point bending test",
        )

    def _list_true_values(self, path: ThreePointPath, plan: Schedule) -> Truth:
        """List the true values of a test.

        ``loading`` is that of the crosshead, see `evaluate_loading`. Bending stiffnesses, N m^2:
        ``initial_bending_stiffness`` is that of the law before any slip, ``bending_stiffness`` is
        K L^3 / 48 with the slope K over `KINK_WINDOW`, without corrections. On unloading the roller
        leaves the bundle at ``residual_displacement``, m. ``energy``, J, is that of the cycle.
        ``clocks`` are the offsets of all clocks, s: ``force = force_offset + (1 + drift) x frame``
        and ``markers = marker_offset + frame``. Arrays are evenly spaced on the clock of the
        cameras, ``time``.
        """
        rate = 5.0  # sampling rate of the arrays, Hz
        stroke, clocks = self.test.stroke, self.clocks
        descent = stroke * np.linspace(0.0, 1.0, TRUTH_POINTS)
        cycle_progress = 2.0 * stroke * np.linspace(0.0, 1.0, 2 * TRUTH_POINTS - 1)
        loading = evaluate_loading(descent, self.factor * path.compute_force(descent))
        displacement = path.compute_displacement(cycle_progress)
        force = self.factor * path.compute_force(cycle_progress)
        peak = int(np.argmax(force))
        time: Floats = np.arange(0.0, plan.end + clocks.camera_lead, 1.0 / rate)
        progress = plan.compute_progress(time - clocks.camera_lead)
        _, moment, curvature = path.compute_mid_span(progress)
        start_time, top_time, stop_time = plan.turning_times.tolist()
        return {
            "loading": loading,
            "initial_bending_stiffness": self.bundle.build_law().stiffness,
            "bending_stiffness": loading["windowed_stiffness"] * self.test.span**3 / 48.0,
            "peak_force": float(force[peak]),
            "peak_displacement": float(displacement[peak]),
            "residual_displacement": path.residual,
            "energy": float(np.trapezoid(force, displacement)),
            "middle": self._list_mid_span_values(path),
            "start_time": start_time,
            "top_time": top_time,
            "stop_time": stop_time,
            "clocks": {
                "force_offset": -clocks.trigger_lag * (1.0 + clocks.recorder_drift),
                "drift": clocks.recorder_drift,
                "marker_offset": clocks.camera_lead,
            },
            "time": time,
            "displacement": path.compute_displacement(progress),
            "force": self.factor * path.compute_force(progress),
            "twist": self._compute_twist(path, progress),
            "curvature": curvature,
            "moment": self.factor * moment,
        }

    def _list_mid_span_values(self, path: ThreePointPath) -> Truth:
        """List curvature, moment and twist at full stroke, and the bending stiffness at mid-span.

        The stiffness is the least-squares slope of moment against curvature for displacements of 1
        to 10 mm, over evenly spaced curvatures.
        """
        _, moment, curvature = path.compute_mid_span(np.linspace(1e-3, 10e-3, TRUTH_POINTS))
        slope = fit_slope(curvature, moment, float(curvature[0]), float(curvature[-1]))
        _, full_moment, full_curvature = path.compute_mid_span(np.array([self.test.stroke]))
        return {
            "curvature": float(full_curvature[0]),
            "moment": self.factor * float(full_moment[0]),
            "bending_stiffness": self.factor * slope,
            "twist": self.markers.twist,
        }

    def describe_specimen(self) -> dict[str, object]:
        """Describe the specimen as entries of the block ``specimen`` of the test sheet, in m."""
        return {"span": self.test.span, "bundle": self.bundle.describe()}

    def list_settings(self) -> list[Setting]:
        """List the settings of the rig."""
        return [
            *self.load_cell.list_settings(),
            Setting("rig.crosshead_speed", f"{1e3 * self.speed:.10g} mm/s"),
            Setting("rig.stroke", self.test.stroke),
            Setting("specimen.section.outer_diameter", 2.0 * self.test.outer_radius),
            Setting("markers.centre_offset", self.markers.centre_offset),
        ]


def build_conduit_scenario(name: str) -> ConduitScenario:
    """Build a test of a bundle in a conduit of Table 4.2 of [1]_.

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
    radius = {"corrugated-tube": 5.1e-3, "twist-tube": 4.0e-3}[bundle.conduit]
    return ConduitScenario(
        test=ThreePointTest(bundle, outer_radius=radius),
        name=f"{name}-1",
        specimen_type=name,
        spool=f"{name}-s1",
        markers=CylinderMarkers(centre_offset=radius + marker_radius),
    )


_MIN_DISPLACEMENT_STEP = 1e-9
"""Smallest step of the displacement that is solved, m."""


@dataclass(frozen=True, slots=True, eq=False)
class ThreePointPath:
    """Solved path of a test.

    Parameters
    ----------
    test : inputs of the path
    arc_length : shape (stations,), m, arc length from mid-span
    loading : shapes from rest to full stroke
    unloading : shapes from full stroke to rest, or to zero force
    """

    test: ThreePointTest
    arc_length: Floats
    loading: tuple[HalfShape, ...]
    unloading: tuple[HalfShape, ...]

    @property
    def residual(self) -> float:
        """Return the displacement at the end of unloading, where the force is zero, or 0, m."""
        return self.unloading[-1].displacement

    def compute_displacement(self, progress: Floats) -> Floats:
        """Compute the displacement of the upper roller at progress (total travel), (n,), m."""
        progress_in_test = np.clip(progress, 0.0, 2.0 * self.test.stroke)
        return self.test.stroke - np.abs(self.test.stroke - progress_in_test)

    def compute_force(self, progress: Floats) -> Floats:
        """Compute the force at progress, shape (n,), N."""
        return self._look_up(progress, [[half.force] for half in self._halves])[:, 0]

    def compute_mid_span(self, progress: Floats) -> tuple[Floats, Floats, Floats]:
        """Compute displacement, moment and curvature at mid-span, m, N m, 1/m, shape (n,) each."""
        rows = [[h.displacement, h.moment[0], h.curvature[0]] for h in self._halves]
        values = self._look_up(progress, rows)
        return values[:, 0], values[:, 1], values[:, 2]

    def compute_points(self, progress: Floats, arc_length: Floats) -> tuple[Floats, Floats, Floats]:
        """Compute points of the axis, and the angle of its tangent.

        Parameters
        ----------
        progress : shape (n,), m
        arc_length : shape (m,), m, arc length from mid-span, negative to the left

        Returns
        -------
        x, y, angle, each of shape (n, m): x to the right from mid-span and y upwards from the axis
        at rest, m; angle, rad.
        """
        side, distance = np.sign(arc_length), np.abs(arc_length)
        shapes = np.array([half.shape for half in self._halves])
        rows = CubicSpline(self.arc_length, shapes, axis=2)(distance).reshape(len(shapes), -1)
        x, y, angle = np.split(self._look_up(progress, rows), 3, axis=1)
        travel, _, _ = self.compute_mid_span(progress)
        return side * x, y - travel[:, None], side * angle

    @property
    def _halves(self) -> tuple[HalfShape, ...]:
        """Return the shapes of loading, then those of unloading."""
        return self.loading + self.unloading

    def _look_up(self, progress: Floats, rows: object) -> Floats:
        """Interpolate along both branches; the values are constant after the end of unloading."""
        columns = np.asarray(rows, dtype=np.float64)
        n, stroke = len(self.loading), self.test.stroke
        loading = CubicSpline([h.displacement for h in self.loading], columns[:n])
        unloading_progress = [2.0 * stroke - h.displacement for h in self.unloading]
        unloading = CubicSpline(unloading_progress, columns[n:])
        release_progress = 2.0 * stroke - self.residual
        is_loading = (progress <= stroke)[:, None]
        loading_values = loading(np.clip(progress, 0.0, stroke))
        unloading_values = unloading(np.clip(progress, stroke, release_progress))
        return np.where(is_loading, loading_values, unloading_values)


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
    half = HalfBundle(test, test.bundle.build_law(), arc_length)
    state_at_rest = half.unload(half.law.make_unbent_history(test.n_stations))
    loading = [state_at_rest, *_solve_branch(half, state_at_rest, test.stroke, is_unloading=False)]
    unloading = [loading[-1], *_solve_branch(half, loading[-1], 0.0, is_unloading=True)]
    return ThreePointPath(test, half.arc_length, tuple(loading), tuple(unloading))


def _solve_branch(
    half: HalfBundle, start_shape: HalfShape, goal: float, *, is_unloading: bool
) -> Iterator[HalfShape]:
    """Solve up to a displacement; unloading stops at zero force."""
    test, shape, start = half.test, start_shape, start_shape.displacement
    steps = np.linspace(0.0, 1.0, test.steps_per_branch + 1)[1:] ** test.crowding
    for displacement in (start + steps * (goal - start)).tolist():
        if is_unloading:
            unloaded_shape = half.unload(shape.plays)
            if unloaded_shape.displacement >= displacement - _MIN_DISPLACEMENT_STEP:
                yield unloaded_shape
                return
        target = displacement
        while shape.displacement != displacement:  # a step is halved if Newton's method fails
            friction = half.compute_friction(target - start, is_unloading)
            solved_shape = half.solve_equilibrium(shape, target, friction)
            if solved_shape is not None:
                shape, target = solved_shape, displacement
                continue
            target, last = 0.5 * (shape.displacement + target), shape.displacement
            if abs(target - last) < _MIN_DISPLACEMENT_STEP:
                message = format_sentence(
                    "virtual_lab.no_equilibrium", displacement=displacement, last=last
                )
                raise ValueError(message)
        yield shape


@dataclass(frozen=True, slots=True, eq=False)
class HalfShape:
    """Solved shape of one half; arrays of shape (stations,) from mid-span outwards.

    Parameters
    ----------
    displacement : displacement d of mid-span, m
    force : force P of the upper roller, N
    contact : arc length l of the contact with the lower roller, m
    shape : shape (3, stations): x and y from mid-span, y upwards, m; angle, rad
    moment, curvature : moment, N m, and curvature, 1/m
    plays : shape (stations, plays), N m, history of the law
    """

    displacement: float
    force: float
    contact: float
    shape: Floats
    moment: Floats
    curvature: Floats
    plays: Floats


@dataclass(frozen=True, slots=True, eq=False)
class HalfBundle:
    """Equilibrium of half a bundle on its roller.

    The Jacobian is computed by complex steps: the imaginary part of the residuals at unknowns with
    a tiny imaginary step is the exact derivative (Squire and Trapp, SIAM Rev. 40 (1998) 110).

    Parameters
    ----------
    test : bundle and rig
    law : law of every station
    arc_length : shape (stations,), m, arc length from mid-span
    """

    test: ThreePointTest
    law: PlayLaw
    arc_length: Floats

    def compute_friction(self, travel: float, is_unloading: bool) -> float:
        """Compute the signed coefficient of friction at a travel since the start or reversal."""
        build_up_fraction = 1.0 - float(np.exp(-abs(travel) / self.test.build_up))
        return self.test.friction * (
            1.0 - 2.0 * build_up_fraction if is_unloading else build_up_fraction
        )

    def unload(self, plays: Floats) -> HalfShape:
        """Unload the bundle: compute its shape without forces, with a history of plays."""
        zero_moment = np.zeros(self.test.n_stations)
        response = self.law.respond(zero_moment, plays)
        shape = self._compute_shape(response.curvature)

        def compute_gaps(contact: float) -> Floats:
            return self._compute_gaps(self._interpolate(shape, np.float64(contact)))

        end = float(self.arc_length[-1])
        contact = float(brentq(lambda length: compute_gaps(length)[0], 0.0, end, xtol=1e-14))
        travel = float(compute_gaps(contact)[1])
        history = response.history
        return HalfShape(travel, 0.0, contact, shape, zero_moment, response.curvature, history)

    def solve_equilibrium(
        self, state: HalfShape, goal_displacement: float, friction: float
    ) -> HalfShape | None:
        """Solve for moments, roller force and contact by Newton's method; None if it fails."""
        max_iterations = 40
        tolerance = 1e-9  # change of the moments at convergence, relative to the largest moment
        max_turn = 0.3  # largest rotation of a section in one iteration, rad
        unknowns = np.append(state.moment, [0.5 * state.force, state.contact])
        steps = 1e-30j * np.eye(len(unknowns))
        for _ in range(max_iterations):
            response = self.law.respond(unknowns[:-2], state.plays)
            curvatures = response.curvature + response.compliance * steps[:, :-2]
            equations = self._compute_residuals(
                unknowns + steps, curvatures, goal_displacement, friction
            )
            correction = -np.linalg.solve(equations.imag.T / 1e-30, equations[-1].real)
            largest = float(np.max(np.abs(self._integrate(response.compliance * correction[:-2]))))
            correction *= min(1.0, max_turn / largest) if largest > 0.0 else 1.0
            unknowns = unknowns + correction
            if not (0.0 < unknowns[-1] < self.arc_length[-1]) or not np.isfinite(largest):
                return None
            moment = unknowns[:-2]
            if np.max(np.abs(correction[:-2])) <= tolerance * (np.max(np.abs(moment)) + 1e-12):
                response = self.law.respond(moment, state.plays)
                shape = self._compute_shape(response.curvature)
                _, fy = _compute_direction(self._interpolate(shape, unknowns[-1])[2], friction)
                force, contact = 2.0 * float(unknowns[-2]) * float(fy), float(unknowns[-1])
                history = response.curvature, response.history
                return HalfShape(goal_displacement, force, contact, shape, moment, *history)
        return None

    def _integrate(self, values: Floats) -> Floats:
        """Integrate from mid-span to each station by the trapezoidal rule."""
        step = float(self.arc_length[1])
        return cumulative_trapezoid(values, dx=step, axis=-1, initial=0)

    def _compute_shape(self, curvature: Floats) -> Floats:
        """Compute x, y and angle, shape (3, ..., stations)."""
        angle = self._integrate(curvature)
        return np.stack([self._integrate(np.cos(angle)), self._integrate(np.sin(angle)), angle])

    def _interpolate(self, shape: Floats, contact: Floats | np.float64) -> Floats:
        """Interpolate a shape at contacts between the same two stations, shape (3, ...)."""
        stations = contact / self.arc_length[1]
        station = min(int(stations.real.flat[0]), self.test.n_stations - 2)
        step = shape[..., station + 1] - shape[..., station]
        return np.asarray(shape[..., station] + (stations - station) * step)

    def _compute_gaps(self, contact_point: Floats) -> Floats:
        """Compute the horizontal offset of the roller and the displacement, shape (2, ...), m."""
        x, y, angle = contact_point
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
        curvature : shape (n, stations), 1/m, complex, curvatures under these moments
        goal_displacement : displacement of mid-span, m
        friction : signed coefficient of friction

        Returns
        -------
        Shape (n, stations + 2), complex: residuals of the moments, N m, and of both conditions, m.
        """
        moment, normal, contact = unknowns[:, :-2], unknowns[:, -2], unknowns[:, -1]
        shape = self._compute_shape(curvature)
        contact_point = self._interpolate(shape, contact)
        fx, fy = _compute_direction(contact_point[2], friction)
        lever_x, lever_y, _ = contact_point[:, :, None] - shape
        lever = lever_x * fy[:, None] - lever_y * fx[:, None]
        stations_to_contact = (contact[:, None] - self.arc_length) / self.arc_length[1]
        unit_moment = np.where(stations_to_contact.real > 0.0, lever, 0.0)
        unit_moment += self.test.outer_radius * friction * np.clip(stations_to_contact, 0.0, 1.0)
        gap, displacement = self._compute_gaps(contact_point)
        residuals = [
            moment - normal[:, None] * unit_moment,
            gap[:, None],
            displacement[:, None] - goal_displacement,
        ]
        return np.concatenate(residuals, axis=1)


def _compute_direction(angle: Floats, friction: float) -> tuple[Floats, Floats]:
    """Compute the x and y components of the force of the roller per unit of normal force."""
    return friction * np.cos(angle) - np.sin(angle), np.cos(angle) + friction * np.sin(angle)
