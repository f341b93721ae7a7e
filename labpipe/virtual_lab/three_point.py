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
    M(s) = (point of contact - point at s) x F,   F = N (normal + mu tangent),   P = 2 F_y

The span thus becomes shorter, and the force inclines, as the bundle rotates. Friction acts on the
surface, at the distance r below the axis, and therefore adds a moment mu N r. Friction opposes
sliding: the bundle slides inwards on loading and back on unloading. After a start or a reversal,
friction changes to its full value over a short travel u of the crosshead as 1 - exp(-u / u0), which
models sticking. Weight is neglected. When the force returns to zero, the upper roller leaves the
bundle.

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
from numpy.typing import ArrayLike
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq

from labpipe.mechanics.law.plays import PlayLaw
from labpipe.messages import format_sentence
from labpipe.records.arrays import Floats
from labpipe.virtual_lab.cantilever_scenarios import (
    N_TRUTH_POINTS,
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
"""Load cell of 500 lb, calibrated as -0.21082 N/V x volts + 0.002846 N. The recorder stores the
voltage of the amplifier, up to 100 V."""


class BendingSpecimen(Protocol):
    """Specimen with a bending law. Tests of equal specimens share one solution."""

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
    steps_per_branch, crowding : number and spacing of the solved displacements in a branch, as in
        `cantilever_scenarios.MechanicalTest`
    n_stations : number of evenly spaced stations of one half
    """

    bundle: BendingSpecimen
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


@dataclass(frozen=True, slots=True)
class ConduitClocks:
    """Time bases of recorder, cameras and load frame. True time is zero when the frame starts.

    Parameters
    ----------
    rate : sampling rate of the force recorder, Hz
    fps : frames per second of the cameras
    frame_rate : sampling rate of the record of the load frame, Hz
    trigger_lag : time from the start of the load frame to the first sample of the recorder, s
    recorder_drift : rate of drift; time of the recorder = (1 + drift) x (true time - trigger lag)
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
    spacing : distance between neighbouring markers of a line, m
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
        """List arc length from mid-span, m, and angle at rest, rad, of each marker, by line."""
        n_per_side = self.n_sections // 2
        line = self.spacing * np.arange(-n_per_side, n_per_side + 1)
        return np.tile(line, len(self.angles)), np.repeat(self.angles, len(line))


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
    """Virtual three-point test of a bundle in a conduit, with rig, instruments and sheet entries.

    Parameters
    ----------
    test : bundle with the factor of its type, and rig
    name : name of the test and of its folder
    specimen_type, spool, sample : specimen type, spool, and number of the sample in the test sheet
    date : ISO date for the test sheet and the exports
    factor : factor of this sample on all moments and forces
    speed : speed of the crosshead, m/s
    rest : duration of the rest before and after the motion of the crosshead, s
    clocks : time bases of the instruments
    load_cell : load cell of the upper roller
    markers : positions of the markers, and noise of the cameras
    frame : noise and tare of the load frame
    pose : pose of the rig in the motion-capture frame
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
        assert isinstance(bundle, BundleModel)  # every scenario has a bundle
        return replace(bundle, factor=bundle.factor * self.factor)

    def plan_schedule(self) -> Schedule:
        """Plan a motion down and up without dwell, between two rests.

        True time begins when the load frame starts.
        """
        clocks = self.clocks
        stroke_time = self.test.stroke / self.speed
        turning_times: Floats = self.rest + stroke_time * np.arange(3.0)
        end_time = float(turning_times[-1] + self.rest)
        n_frames = int((end_time + clocks.camera_lead) * clocks.fps)
        frame_clock: Floats = np.arange(n_frames, dtype=np.float64) / clocks.fps
        n_samples = int((end_time - clocks.trigger_lag) * clocks.rate)
        force_clock: Floats = np.arange(n_samples, dtype=np.float64) / clocks.rate
        return Schedule(
            corner_times=turning_times[[0, -1]],
            progress=np.array([0.0, 2.0 * self.test.stroke]),
            turning_times=turning_times,
            end_time=end_time,
            frame_clock=frame_clock,
            frame_times=frame_clock - clocks.camera_lead,
            force_clock=force_clock,
            force_times=clocks.trigger_lag + force_clock / (1.0 + clocks.recorder_drift),
        )

    def record(self, seed: int) -> tuple[dict[str, Any], Truth]:
        """Simulate the records ``force``, ``markers`` and ``frame``, and list the true values.

        Parameters
        ----------
        seed : seed of gain error, noise and labels

        Returns
        -------
        Record of each role, without ``frame`` if the load frame writes no export, and true values,
        keyed as in ``truth.json``.
        """
        path, schedule = solve_three_point(self.test), self.plan_schedule()
        force_random, frame_random, camera_random = np.random.default_rng(seed).spawn(3)
        force = self.factor * path.compute_force(schedule.compute_progress(schedule.force_times))
        volts, gain = self.load_cell.read(force, force_random)
        signals = {FORCE_PATH: volts, "Model Root/Trigger": np.ones(len(volts))}
        take = self._record_markers(path, schedule, camera_random)
        records = {"force": ForceRecord(schedule.force_clock, signals, gain), "markers": take}
        if self.has_frame_export:
            records["frame"] = self._record_frame(path, schedule, frame_random)
        truth = {
            "stiffnesses": self.bundle.stiffnesses,
            "true_gain": gain,
            "markers": list_markers(take.specimen_labels, self.markers.list_positions()[0]),
            **self._list_true_values(path, schedule),
        }
        return records, truth

    def _record_markers(
        self, path: ThreePointPath, schedule: Schedule, random: np.random.Generator
    ) -> Take:
        """Simulate the take of marker lines on a cylinder that bends and twists."""
        layout, progress = self.markers, schedule.compute_progress(schedule.frame_times)
        arc_lengths, angles_at_rest = layout.list_positions()
        x, y, axis_angle = path.compute_points(progress, arc_lengths)
        marker_angles = angles_at_rest - self._compute_twist(path, progress)[:, None]
        height = layout.centre_offset * np.sin(marker_angles)
        z = layout.centre_offset * np.cos(marker_angles)
        return simulate_take(
            "Bundle",
            np.stack([x - height * np.sin(axis_angle), y + height * np.cos(axis_angle), z], axis=2),
            schedule,
            random,
            pose=self.pose,
            fps=self.clocks.fps,
            length_unit=self.length_unit,
            noise=layout.noise,
        )

    def _compute_twist(self, path: ThreePointPath, progress: Floats) -> Floats:
        """Compute the twist of the sample, right-handed about x, shape (n,), rad."""
        return self.markers.twist * path.compute_mid_span(progress)[0] / path.test.stroke

    def _record_frame(
        self, path: ThreePointPath, schedule: Schedule, random: np.random.Generator
    ) -> FrameRecord:
        """Simulate the record of the load frame, which begins after half a sampling interval."""
        step, frame = 1.0 / self.clocks.frame_rate, self.frame
        time: Floats = np.arange(0.5 * step, schedule.end_time, step)
        progress = schedule.compute_progress(time)
        noise = random.standard_normal((2, len(time)))
        force = self.factor * path.compute_force(progress)
        return FrameRecord(
            time=time,
            displacement=path.compute_displacement(progress) + frame.displacement_noise * noise[0],
            force=force + frame.force_tare + frame.force_noise * noise[1],
            layout=ExportLayout("N"),
            test_type="three-point bending test",
        )

    def _list_true_values(self, path: ThreePointPath, schedule: Schedule) -> Truth:
        """List the true values of a test.

        ``loading`` has the values of the first loading, see `evaluate_loading`. Bending
        stiffnesses, N m^2: ``initial_bending_stiffness`` is that of the law before any slip, and
        ``bending_stiffness`` is K L^3 / 48 with ``windowed_stiffness`` as K, without corrections.
        On unloading, the roller leaves the bundle at ``residual_displacement``, m. ``energy``, J,
        is that of the cycle. ``clocks`` has offsets, s, and drift: force time = ``force_offset`` +
        (1 + ``drift``) x frame time, and camera time = ``marker_offset`` + frame time. Arrays are
        evenly spaced in ``time``, s, on the clock of the cameras.
        """
        rate = 5.0  # sampling rate of the arrays, Hz
        stroke, clocks = self.test.stroke, self.clocks
        loading_travel = stroke * np.linspace(0.0, 1.0, N_TRUTH_POINTS)
        cycle_progress = 2.0 * stroke * np.linspace(0.0, 1.0, 2 * N_TRUTH_POINTS - 1)
        loading = evaluate_loading(loading_travel, self.factor * path.compute_force(loading_travel))
        displacement = path.compute_displacement(cycle_progress)
        force = self.factor * path.compute_force(cycle_progress)
        peak_index = int(np.argmax(force))
        time: Floats = np.arange(0.0, schedule.end_time + clocks.camera_lead, 1.0 / rate)
        progress = schedule.compute_progress(time - clocks.camera_lead)
        _, moment, curvature = path.compute_mid_span(progress)
        start_time, top_time, stop_time = schedule.turning_times.tolist()
        return {
            "loading": loading,
            "initial_bending_stiffness": self.bundle.build_law().stiffness,
            "bending_stiffness": loading["windowed_stiffness"] * self.test.span**3 / 48.0,
            "peak_force": float(force[peak_index]),
            "peak_displacement": float(displacement[peak_index]),
            "residual_displacement": path.residual_displacement,
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
        _, moment, curvature = path.compute_mid_span(np.linspace(1e-3, 10e-3, N_TRUTH_POINTS))
        slope = fit_slope(curvature, moment, float(curvature[0]), float(curvature[-1]))
        _, full_moment, full_curvature = path.compute_mid_span(np.array([self.test.stroke]))
        return {
            "curvature": float(full_curvature[0]),
            "moment": self.factor * float(full_moment[0]),
            "bending_stiffness": self.factor * slope,
            "twist": self.markers.twist,
        }

    def describe_specimen(self) -> dict[str, object]:
        """Describe the specimen as block ``specimen`` of the test sheet; a float is a length, m."""
        return {"span": self.test.span, "bundle": self.bundle.describe()}

    def list_settings(self) -> list[Setting]:
        """List the settings of load cell, rig, specimen and markers."""
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
        If the name is unknown.
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
"""Smallest step of the displacement for which a shape is solved, m."""


@dataclass(frozen=True, slots=True, eq=False)
class ThreePointPath:
    """Solved path of a test, as a function of progress: the total travel of the upper roller, m.

    Parameters
    ----------
    test : inputs of the path
    arc_length : shape (stations,), m, arc length from mid-span
    loading_shapes : shapes from rest to full stroke
    unloading_shapes : shapes from full stroke to zero force, or to zero displacement
    """

    test: ThreePointTest
    arc_length: Floats
    loading_shapes: tuple[HalfShape, ...]
    unloading_shapes: tuple[HalfShape, ...]

    @property
    def residual_displacement(self) -> float:
        """Return the displacement at the end of unloading, m."""
        return self.unloading_shapes[-1].displacement

    def compute_displacement(self, progress: Floats) -> Floats:
        """Compute the displacement of the upper roller at progress, shape (n,), m."""
        progress_in_test = np.clip(progress, 0.0, 2.0 * self.test.stroke)
        return self.test.stroke - np.abs(self.test.stroke - progress_in_test)

    def compute_force(self, progress: Floats) -> Floats:
        """Compute the force of the upper roller at progress, shape (n,), N."""
        return self._interpolate(progress, [[shape.force] for shape in self._shapes])[:, 0]

    def compute_mid_span(self, progress: Floats) -> tuple[Floats, Floats, Floats]:
        """Compute displacement, moment and curvature at mid-span, m, N m, 1/m, shape (n,) each."""
        rows = [[s.displacement, s.moment[0], s.curvature[0]] for s in self._shapes]
        values = self._interpolate(progress, rows)
        return values[:, 0], values[:, 1], values[:, 2]

    def compute_points(self, progress: Floats, arc_length: Floats) -> tuple[Floats, Floats, Floats]:
        """Compute points of the axis, and the angle of its tangent.

        Parameters
        ----------
        progress : shape (n,), m, total travel of the upper roller
        arc_length : shape (m,), m, arc length from mid-span, negative to the left

        Returns
        -------
        x, y, angle, each of shape (n, m): x to the right from mid-span and y upwards from the axis
        at rest, m; angle, rad.
        """
        side, distance = np.sign(arc_length), np.abs(arc_length)
        axes = np.array([shape.axis for shape in self._shapes])
        rows = CubicSpline(self.arc_length, axes, axis=2)(distance).reshape(len(axes), -1)
        x, y, angle = np.split(self._interpolate(progress, rows), 3, axis=1)
        displacement, _, _ = self.compute_mid_span(progress)
        return side * x, y - displacement[:, None], side * angle

    @property
    def _shapes(self) -> tuple[HalfShape, ...]:
        """Return the shapes of loading, then those of unloading."""
        return self.loading_shapes + self.unloading_shapes

    def _interpolate(self, progress: Floats, rows: ArrayLike) -> Floats:
        """Interpolate a row per shape at progress, m; rows are constant after unloading."""
        table = np.asarray(rows, dtype=np.float64)
        n_loading, stroke = len(self.loading_shapes), self.test.stroke
        loading_spline = CubicSpline(
            [s.displacement for s in self.loading_shapes], table[:n_loading]
        )
        unloading_progress = [2.0 * stroke - s.displacement for s in self.unloading_shapes]
        unloading_spline = CubicSpline(unloading_progress, table[n_loading:])
        is_loading = (progress <= stroke)[:, None]
        loading_values = loading_spline(np.clip(progress, 0.0, stroke))
        unloading_values = unloading_spline(np.clip(progress, stroke, unloading_progress[-1]))
        return np.where(is_loading, loading_values, unloading_values)


@lru_cache(maxsize=64)
def solve_three_point(test: ThreePointTest) -> ThreePointPath:
    """Solve the path of a test; equal tests are solved once.

    Parameters
    ----------
    test : bundle and rig

    Raises
    ------
    ValueError
        If an equilibrium does not exist, or the bundle slides off its rollers.
    """
    arc_length = np.linspace(0.0, 0.5 * test.span + test.overhang, test.n_stations)
    half = HalfBundle(test, test.bundle.build_law(), arc_length)
    rest_shape = half.unload(half.law.make_unbent_history(test.n_stations))
    loading = [rest_shape, *_solve_branch(half, rest_shape, test.stroke, is_unloading=False)]
    unloading = [loading[-1], *_solve_branch(half, loading[-1], 0.0, is_unloading=True)]
    return ThreePointPath(test, half.arc_length, tuple(loading), tuple(unloading))


def _solve_branch(
    half: HalfBundle, start_shape: HalfShape, end_displacement: float, *, is_unloading: bool
) -> Iterator[HalfShape]:
    """Solve up to a displacement, m; unloading stops at zero force."""
    test, shape, start = half.test, start_shape, start_shape.displacement
    fractions = np.linspace(0.0, 1.0, test.steps_per_branch + 1)[1:] ** test.crowding
    for displacement in (start + fractions * (end_displacement - start)).tolist():
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
            target = 0.5 * (shape.displacement + target)
            if abs(target - shape.displacement) < _MIN_DISPLACEMENT_STEP:
                facts = {"displacement": displacement, "last_displacement": shape.displacement}
                raise ValueError(format_sentence("virtual_lab.no_equilibrium", **facts))
        yield shape


@dataclass(frozen=True, slots=True, eq=False)
class HalfShape:
    """Solved shape of one half; stations are counted from mid-span outwards.

    Parameters
    ----------
    displacement : displacement d of mid-span, m
    force : force P of the upper roller, N
    contact : arc length l of the contact with the lower roller, m
    axis : shape (3, stations), coordinates x and y relative to mid-span, m, and angle, rad
    moment : shape (stations,), N m
    curvature : shape (stations,), 1/m
    plays : shape (stations, plays), N m, history of the law
    """

    displacement: float
    force: float
    contact: float
    axis: Floats
    moment: Floats
    curvature: Floats
    plays: Floats


@dataclass(frozen=True, slots=True, eq=False)
class HalfBundle:
    """Half of a bundle on its roller, with its equations of equilibrium.

    The Jacobian is computed by complex steps: the imaginary part of the residuals at unknowns with
    a tiny imaginary step, divided by the step, is the derivative without cancellation (Squire and
    Trapp, SIAM Rev. 40 (1998) 110).

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
        """Compute the signed coefficient of friction after a travel, m, since start or reversal."""
        build_up_fraction = 1.0 - float(np.exp(-abs(travel) / self.test.build_up))
        relative_friction = 1.0 - 2.0 * build_up_fraction if is_unloading else build_up_fraction
        return self.test.friction * relative_friction

    def unload(self, plays: Floats) -> HalfShape:
        """Compute the shape without forces after a history of plays, shape (stations, plays)."""
        moment = np.zeros(self.test.n_stations)
        response = self.law.respond(moment, plays)
        axis = self._compute_axis(response.curvature)

        def compute_roller_offset(contact: float) -> float:
            """Compute the horizontal offset of the roller, m, if it touches at an arc length."""
            return float(self._compute_roller_position(self._interpolate(axis, contact))[0])

        contact = float(brentq(compute_roller_offset, 0.0, self.arc_length[-1], xtol=1e-14))
        _, displacement = self._compute_roller_position(self._interpolate(axis, contact)).tolist()
        state = {"moment": moment, "curvature": response.curvature, "plays": response.history}
        return HalfShape(displacement, 0.0, contact, axis, **state)

    def solve_equilibrium(
        self, start_shape: HalfShape, displacement: float, friction: float
    ) -> HalfShape | None:
        """Solve for moments, normal force and contact by Newton's method; None if it fails.

        Parameters
        ----------
        start_shape : shape from which the bundle is bent
        displacement : displacement of mid-span in equilibrium, m
        friction : signed coefficient of friction
        """
        max_iterations = 40
        tolerance = 1e-9  # change of the moments at convergence, relative to the largest moment
        max_rotation = 0.3  # largest rotation of a section in one iteration, rad
        complex_step = 1e-30
        unknowns = np.append(start_shape.moment, [0.5 * start_shape.force, start_shape.contact])
        steps = 1j * complex_step * np.eye(len(unknowns))
        for _ in range(max_iterations):
            response = self.law.respond(unknowns[:-2], start_shape.plays)
            curvatures = response.curvature + response.compliance * steps[:, :-2]
            residuals = self._compute_residuals(
                unknowns + steps, curvatures, displacement, friction
            )
            correction = -np.linalg.solve(residuals.imag.T / complex_step, residuals[-1].real)
            rotations = self._integrate(response.compliance * correction[:-2])
            rotation = float(np.max(np.abs(rotations)))
            correction *= min(1.0, max_rotation / rotation) if rotation > 0.0 else 1.0
            unknowns = unknowns + correction
            if not (0.0 < unknowns[-1] < self.arc_length[-1]) or not np.isfinite(rotation):
                return None
            moment, contact = unknowns[:-2], float(unknowns[-1])
            if np.max(np.abs(correction[:-2])) <= tolerance * (np.max(np.abs(moment)) + 1e-12):
                bent = self.law.respond(moment, start_shape.plays)
                axis = self._compute_axis(bent.curvature)
                _, fy = _compute_direction(self._interpolate(axis, contact)[2], friction)
                force = 2.0 * float(unknowns[-2]) * float(fy)
                state = {"moment": moment, "curvature": bent.curvature, "plays": bent.history}
                return HalfShape(displacement, force, contact, axis, **state)
        return None

    def _integrate(self, values: Floats) -> Floats:
        """Integrate from mid-span to each station by the trapezoidal rule."""
        return cumulative_trapezoid(values, dx=float(self.arc_length[1]), axis=-1, initial=0)

    def _compute_axis(self, curvature: Floats) -> Floats:
        """Compute x, m, y, m, and angle of the axis, rad, shape (3, ..., stations)."""
        angle = self._integrate(curvature)
        return np.stack([self._integrate(np.cos(angle)), self._integrate(np.sin(angle)), angle])

    def _interpolate(self, axis: Floats, contact: Floats | float) -> Floats:
        """Interpolate an axis at contacts between the same two stations, shape (3, ...)."""
        contact_in_steps = np.asarray(contact / self.arc_length[1])
        station = min(int(contact_in_steps.real.flat[0]), self.test.n_stations - 2)
        difference = axis[..., station + 1] - axis[..., station]
        return np.asarray(axis[..., station] + (contact_in_steps - station) * difference)

    def _compute_roller_position(self, contact_point: Floats) -> Floats:
        """Compute where the roller must be to touch the bundle at a point, shape (2, ...), m.

        The rows are the horizontal offset of this position from that in the rig, and the
        displacement of mid-span.
        """
        x, y, angle = contact_point
        axis_distance = self.test.roller_radius + self.test.outer_radius
        offset = x + axis_distance * np.sin(angle) - 0.5 * self.test.span
        return np.stack([offset, y + axis_distance * (1.0 - np.cos(angle))])

    def _compute_residuals(
        self, unknowns: Floats, curvature: Floats, displacement: float, friction: float
    ) -> Floats:
        """Compute the residuals of equilibrium and of both geometric conditions.

        Parameters
        ----------
        unknowns : shape (n, stations + 2), complex: moments, N m, normal force, N, and arc length
            of the contact, m
        curvature : shape (n, stations), 1/m, complex, curvatures under these moments
        displacement : displacement of mid-span in equilibrium, m
        friction : signed coefficient of friction

        Returns
        -------
        Shape (n, stations + 2), complex: residuals of the moments, N m, and of both conditions, m.
        """
        moment, normal_force, contact = unknowns[:, :-2], unknowns[:, -2], unknowns[:, -1]
        axis = self._compute_axis(curvature)
        contact_point = self._interpolate(axis, contact)
        fx, fy = _compute_direction(contact_point[2], friction)
        lever_x, lever_y, _ = contact_point[:, :, None] - axis
        contact_moment = lever_x * fy[:, None] - lever_y * fx[:, None]
        steps_to_contact = (contact[:, None] - self.arc_length) / self.arc_length[1]
        unit_moment = np.where(steps_to_contact.real > 0.0, contact_moment, 0.0)
        unit_moment += self.test.outer_radius * friction * np.clip(steps_to_contact, 0.0, 1.0)
        roller_offset, roller_displacement = self._compute_roller_position(contact_point)
        residuals = [
            moment - normal_force[:, None] * unit_moment,
            roller_offset[:, None],
            roller_displacement[:, None] - displacement,
        ]
        return np.concatenate(residuals, axis=1)


def _compute_direction(angle: Floats, friction: float) -> tuple[Floats, Floats]:
    """Compute the x and y components of the roller force, relative to the normal force."""
    return friction * np.cos(angle) - np.sin(angle), np.cos(angle) + friction * np.sin(angle)
