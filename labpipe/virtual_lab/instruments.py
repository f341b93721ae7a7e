"""Virtual instruments: schedule of a test, and records of force recorder, load frame and cameras.

In the cantilever rig, marker centres are offset from the axis of the wire along its local normal,
towards the pull. The initial orientation of the clamp's body is the identity for any pose of the
rig, as Motive defines a new body. Mishaps are then applied to the markers: gaps, swapped labels, a
renamed marker.

In three-point bending, markers form lines along a cylinder that bends and twists. There is no body,
and there are no mishaps.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from labpipe.messages import format_sentence
from labpipe.records.arrays import Floats
from labpipe.records.recording import Channel, Clock, MarkerTracks, Recording, RigidBody
from labpipe.virtual_lab.cantilever_scenarios import (
    CantileverScenario,
    LoadCell,
    MarkerLayout,
    MechanicalPath,
    Mishaps,
    Pose,
)
from labpipe.virtual_lab.tensile import FrameInstruments, TensilePath
from labpipe.virtual_lab.three_point import ConduitScenario, CylinderMarkers, ThreePointPath

FORCE_PATH = "Model Root/Load Cell"
DIRECTION_PATH, FREQUENCY_PATH = "Model Root/Motor/Direction", "Model Root/Motor/Frequency"
TRIGGER_PATH = "Model Root/Trigger"
PORT = "Out1"


@dataclass(frozen=True, slots=True, eq=False)
class Schedule:
    """The motion of clamp or crosshead and the two recordings around it, in true time.

    Parameters
    ----------
    corner_times : shape (n,), s, at which the motion starts or stops
    progress : shape (n,), m, total travel up and down until those times
    turning_times : shape (2 cycles + 1,), s: start, first top, first return, ... last return; each
        is the beginning of its dwell
    end : s, of all records
    frame_clock : shape (frames,), s, the cameras' own time axis
    frame_times : shape (frames,), s, the same instants in true time
    force_clock : shape (samples,), s, the force recorder's own time axis
    force_times : shape (samples,), s, the same instants in true time
    """

    corner_times: Floats
    progress: Floats
    turning_times: Floats
    end: float
    frame_clock: Floats
    frame_times: Floats
    force_clock: Floats
    force_times: Floats

    def progress_at(self, times: Floats) -> Floats:
        """Return the travel, m, at true times, s; constant before and after the motion."""
        return np.interp(times, self.corner_times, self.progress)


def plan_cantilever(scenario: CantileverScenario) -> Schedule:
    """Plan a cantilever test: motion and recordings, with rest at both ends of both records.

    Parameters
    ----------
    scenario : speed, dwell, rest, clocks and stroke are used

    Returns
    -------
    The schedule. Both records begin at zero on their own clock; that of the cameras is true time.
    """
    clocks, stroke = scenario.clocks, scenario.mechanics.stroke
    force_begins = -clocks.offset / (1.0 + clocks.drift)
    start = max(0.0, force_begins) + scenario.rest
    stroke_numbers = np.arange(2 * scenario.mechanics.cycles + 1)
    stroke_time = stroke / scenario.speed
    arrivals = (
        start + stroke_numbers * stroke_time + np.maximum(stroke_numbers - 1, 0) * scenario.dwell
    )
    departures = arrivals + scenario.dwell * (
        (stroke_numbers > 0) & (stroke_numbers < stroke_numbers[-1])
    )
    end = float(arrivals[-1] + scenario.rest)
    frame_times = np.arange(int(np.ceil(end * clocks.fps)) + 1) / clocks.fps
    step = clocks.step_ratio / clocks.rate
    samples = int(np.ceil((end - force_begins) * (1.0 + clocks.drift) / step)) + 1
    force_clock: Floats = step * np.arange(samples, dtype=np.float64)
    return Schedule(
        corner_times=np.ravel(np.column_stack([arrivals, departures])),
        progress=np.repeat(stroke_numbers * stroke, 2),
        turning_times=arrivals,
        end=end,
        frame_clock=frame_times,
        frame_times=frame_times,
        force_clock=force_clock,
        force_times=(force_clock - clocks.offset) / (1.0 + clocks.drift),
    )


def plan_conduit(scenario: ConduitScenario) -> Schedule:
    """Plan a three-point test: rest, motion down and up without dwell, rest.

    Parameters
    ----------
    scenario : speed, rest, clocks and stroke are used

    Returns
    -------
    The schedule; true time begins when the load frame starts.
    """
    clocks, stroke = scenario.clocks, scenario.test.stroke
    stroke_time = stroke / scenario.speed
    top = scenario.rest + stroke_time
    stop = top + stroke_time
    end = stop + scenario.rest
    frames = int((end + clocks.camera_lead) * clocks.fps)
    frame_clock: Floats = np.arange(frames, dtype=np.float64) / clocks.fps
    samples = int((end - clocks.trigger_lag) * clocks.rate)
    force_clock: Floats = np.arange(samples, dtype=np.float64) / clocks.rate
    return Schedule(
        corner_times=np.array([scenario.rest, stop]),
        progress=np.array([0.0, 2.0 * stroke]),
        turning_times=np.array([scenario.rest, top, stop]),
        end=end,
        frame_clock=frame_clock,
        frame_times=frame_clock - clocks.camera_lead,
        force_clock=force_clock,
        force_times=clocks.trigger_lag + force_clock / (1.0 + clocks.recorder_drift),
    )


@dataclass(frozen=True, slots=True, eq=False)
class ForceRecord:
    """Samples of the force recorder.

    Parameters
    ----------
    clock : shape (samples,), s, the recorder's time axis
    signals : by path, shape (samples,): output of the load cell, V. A cantilever test adds the
        direction, 1 while the clamp moves down and 0 otherwise, and the frequency of the pulses of
        the motor, Hz. A three-point test adds the trigger that started the recorder, always 1
    true_gain : N/V, of the load cell
    """

    clock: Floats
    signals: Mapping[str, Floats]
    true_gain: float

    @property
    def volts(self) -> Floats:
        """Return the output of the load cell, V, shape (samples,)."""
        return self.signals[FORCE_PATH]

    def recording(self) -> Recording:
        """Return the record as read from its export, without unit."""
        channels = tuple(
            Channel(name=PORT, path=f"{path}/{PORT}", values=column, clock="HostService")
            for path, column in self.signals.items()
        )
        clock = Clock("HostService", self.clock)
        return Recording(reader="dspace-mat", clocks=(clock,), channels=channels)


def record_cantilever_force(
    path: MechanicalPath,
    scenario: CantileverScenario,
    schedule: Schedule,
    random: np.random.Generator,
) -> ForceRecord:
    """Simulate the force recorder of a cantilever test, which measures the tension of the string.

    Parameters
    ----------
    path : the solved test
    scenario : load cell and motor
    schedule : of the motion and the recordings
    random : source of the true gain and of the noise

    Returns
    -------
    The record.
    """
    pulses_per_metre = 8e6
    progress = schedule.progress_at(schedule.force_times)
    volts, gain = _read_volts(path.tension(progress), scenario.load_cell, random)
    moving = np.diff(progress, append=progress[-1]) > 0.0
    down = moving & (np.floor_divide(progress, scenario.mechanics.stroke) % 2 == 0)
    pulses = np.where(moving, round(pulses_per_metre * scenario.speed, 6), 0.0)
    signals = {FORCE_PATH: volts, DIRECTION_PATH: down.astype(np.float64), FREQUENCY_PATH: pulses}
    return ForceRecord(schedule.force_clock, signals, gain)


def record_conduit_force(
    path: ThreePointPath, scenario: ConduitScenario, schedule: Schedule, random: np.random.Generator
) -> ForceRecord:
    """Simulate the force recorder of a three-point test; see `record_cantilever_force`."""
    force = scenario.factor * path.force(schedule.progress_at(schedule.force_times))
    volts, gain = _read_volts(force, scenario.load_cell, random)
    signals = {FORCE_PATH: volts, TRIGGER_PATH: np.ones(len(volts))}
    return ForceRecord(schedule.force_clock, signals, gain)


def _read_volts(force: Floats, cell: LoadCell, random: np.random.Generator) -> tuple[Floats, float]:
    """Return the output of a load cell, V, quantised and saturated, and its true gain, N/V."""
    drawn = cell.gain_uncertainty * random.standard_normal()
    gain = float(cell.gain * (1.0 + (drawn if cell.gain_error is None else cell.gain_error)))
    sensed = force + cell.noise * random.standard_normal(len(force))
    step = 2.0 * cell.full_scale / 2**cell.bits
    lowest, highest = -(2 ** (cell.bits - 1)), 2 ** (cell.bits - 1) - 1
    counts: Floats = np.clip(np.rint((sensed / gain + cell.offset) / step), lowest, highest)
    return counts * step, gain


@dataclass(frozen=True, slots=True, eq=False)
class FrameRecord:
    """Samples of the controller of the load frame, all of shape (n,).

    Parameters
    ----------
    time : s, since the load frame started
    displacement : m, with tare, noise and resolution
    force : N, with tare, gain error, noise and resolution
    """

    time: Floats
    displacement: Floats
    force: Floats

    def recording(self) -> Recording:
        """Return the record as read from its export, in SI."""
        travel, force = round_to_single(self.displacement), round_to_single(self.force)
        channels = (
            Channel("Crosshead", "Crosshead", travel, unit="m", unit_in_file="mm"),
            Channel("Load", "Load", force, unit="N", unit_in_file="N"),
        )
        return Recording("load-frame", clocks=(Clock("time", self.time),), channels=channels)


def round_to_single(values: Floats) -> Floats:
    """Round values to 32 bits, as a controller stores them, without negative zeros.

    Parameters
    ----------
    values : any shape, in SI
    """
    return values.astype(np.float32).astype(np.float64) + 0.0


def record_crosshead(
    path: ThreePointPath, scenario: ConduitScenario, schedule: Schedule, random: np.random.Generator
) -> FrameRecord:
    """Simulate the load frame of a three-point test, with a coarse force.

    Parameters
    ----------
    path, scenario, schedule : as for `record_conduit_force`
    random : source of the noise

    Returns
    -------
    The record; its first sample is half a sampling interval after the start.
    """
    step = 1.0 / scenario.clocks.frame_rate
    time: Floats = np.arange(0.5 * step, schedule.end, step)
    progress = schedule.progress_at(time)
    frame, noise = scenario.frame, random.standard_normal((2, len(time)))
    force = scenario.factor * path.force(progress)
    return FrameRecord(
        time=time,
        displacement=path.displacement(progress) + frame.displacement_noise * noise[0],
        force=force + frame.force_tare + frame.force_noise * noise[1],
    )


def record_frame(path: TensilePath, random: np.random.Generator) -> FrameRecord:
    """Simulate the load frame of a tensile test.

    Parameters
    ----------
    path : the test
    random : source of the noise

    Returns
    -------
    The record.

    Raises
    ------
    ValueError
        If the test has fewer than three samples.
    """
    instruments = path.scenario.instruments
    time = plan_samples(instruments, path.end)
    force = (1.0 + instruments.gain_error) * path.force(time) + instruments.tare
    force += instruments.white_noise * random.standard_normal(len(time))
    force += draw_slow_noise(instruments, time, random)
    displacement = path.displacement(time) + instruments.displacement_tare
    displacement += instruments.displacement_noise * random.standard_normal(len(time))
    return FrameRecord(
        time=time,
        displacement=_quantise(displacement, instruments.displacement_step),
        force=_quantise(force, instruments.force_step),
    )


def plan_samples(instruments: FrameInstruments, end: float) -> Floats:
    """Return the sample times, s: an even grid, and a last sample off the grid, not after `end`."""
    step = 1.0 / instruments.rate
    last = instruments.last_step * step
    count = int(np.floor((end - last - instruments.first_sample) / step)) + 1
    if count < 2:
        message = format_sentence(
            "virtual_lab.few_samples", rate=instruments.rate, count=count + 1, end=end
        )
        raise ValueError(message)
    grid = instruments.first_sample + step * np.arange(count)
    return np.append(grid, grid[-1] + last)


def draw_slow_noise(
    instruments: FrameInstruments, time: Floats, random: np.random.Generator
) -> Floats:
    """Draw correlated noise at given times, N.

    Parameters
    ----------
    instruments : rms and correlation time
    time : shape (n,), s, increasing, not necessarily even
    random : source of the noise

    Returns
    -------
    shape (n,): stationary first-order autoregressive noise with the correlation
    exp(-lag / correlation time).
    """
    correlation = np.exp(-np.diff(time, prepend=-np.inf) / instruments.correlation_time)
    shocks = np.sqrt(1.0 - correlation**2) * random.standard_normal(len(time))
    noise = np.empty(len(time))
    level = 0.0
    for sample, (share, shock) in enumerate(zip(correlation, shocks, strict=True)):
        level = share * level + shock
        noise[sample] = level
    return instruments.slow_noise * noise


def _quantise(values: Floats, step: float) -> Floats:
    if step == 0.0:
        return values
    rounded: Floats = step * np.rint(values / step)
    return rounded


BODY = "Clamp"
BODY_MARKERS = np.array(
    [[0.021, 0.014, 0.009], [-0.024, 0.011, -0.008], [0.004, -0.019, 0.017], [0.003, 0.022, -0.019]]
)
"""The clamp's markers relative to its pivot, m, shape (4, 3)."""
UNLABELLED = "Unlabeled 1234"


@dataclass(frozen=True, slots=True)
class MishapEvent:
    """A mishap that occurred: its markers and its frames.

    Parameters
    ----------
    kind : gap, switch or unlabelled
    markers : counted from 0 at the clamp, regardless of labels
    start, stop : frames, `stop` excluded
    """

    kind: str
    markers: tuple[int, ...]
    start: int
    stop: int


@dataclass(frozen=True, slots=True, eq=False)
class Take:
    """A motion-capture take.

    Parameters
    ----------
    time : shape (frames,), s
    rate : frames per second
    names : of all measured markers; those of the body come first
    positions : shape (frames, markers, 3), m, NaN where not tracked
    bodies : the clamp; empty in three-point bending
    fitted : shape (frames, 4, 3), m, fitted positions of the markers of the body; (frames, 0, 3)
        without a body
    quality : shape (frames, 4), Marker Quality of Motive, up to 1; (frames, 0) without a body
    labels : of the markers along the specimen, in order
    arc_lengths : shape (markers along the specimen,), m
    log : mishaps, in the order in which they are applied
    """

    time: Floats
    rate: float
    names: tuple[str, ...]
    positions: Floats
    bodies: tuple[RigidBody, ...]
    fitted: Floats
    quality: Floats
    labels: tuple[str, ...]
    arc_lengths: Floats
    log: tuple[MishapEvent, ...]

    def recording(self) -> Recording:
        """Return the take as read from an export in metres with six decimals."""
        tracks = MarkerTracks(
            time=self.time,
            frames=np.arange(len(self.time), dtype=np.float64),
            rate=self.rate,
            names=self.names,
            positions=self.positions.round(6),
            bodies=tuple(
                replace(
                    body,
                    position=body.position.round(6),
                    rotation=body.rotation.round(6),
                    error=body.error.round(6),
                )
                for body in self.bodies
            ),
        )
        return Recording(reader="motive-csv", markers=tracks)


def film_cantilever(
    path: MechanicalPath,
    scenario: CantileverScenario,
    schedule: Schedule,
    random: np.random.Generator,
) -> Take:
    """Simulate the cameras in a cantilever test.

    Parameters
    ----------
    path : the solved test
    scenario : marker layout, pose and mishaps
    schedule : of the motion and the recordings
    random : source of noise and mishaps

    Returns
    -------
    The take.
    """
    layout, pose = scenario.markers, scenario.pose
    progress = schedule.progress_at(schedule.frame_times)
    drop = np.zeros((len(progress), 3))
    drop[:, 1] = -path.travel(progress)
    pivot = _transform_to_lab(drop + np.asarray(layout.pivot), pose)
    body, fitted = _film_body(pivot, layout, random)
    arc_lengths = np.array(layout.arc_lengths(scenario.mechanics.length))
    wire = place_wire_markers(path, progress, arc_lengths, layout.centre_offset) + drop[:, None, :]
    observed = np.concatenate(
        [pivot[:, None, :] + BODY_MARKERS, _transform_to_lab(wire, pose)], axis=1
    )
    observed += layout.noise * random.standard_normal(observed.shape)
    labels = _draw_labels("Wire", layout.n_markers, layout.scrambled, random)
    names = tuple(f"{BODY}:Marker{n + 1}" for n in range(len(BODY_MARKERS))) + labels
    names, observed, log = apply_mishaps(
        names, observed, scenario.mishaps, schedule, n_body=len(BODY_MARKERS), random=random
    )
    names, observed = _sort_columns(names, observed)
    return Take(
        time=schedule.frame_clock,
        rate=scenario.clocks.fps,
        names=names,
        positions=observed,
        bodies=(body,),
        fitted=fitted,
        quality=np.clip(1.0 - np.abs(0.01 * random.standard_normal(fitted.shape[:2])), 0.0, 1.0),
        labels=labels,
        arc_lengths=arc_lengths,
        log=log,
    )


def film_conduit(
    path: ThreePointPath, scenario: ConduitScenario, schedule: Schedule, random: np.random.Generator
) -> Take:
    """Simulate the cameras in a three-point test.

    Parameters
    ----------
    path : the solved test
    scenario : markers, pose and clocks
    schedule : of the motion and the recordings
    random : source of the noise and of the order of the labels

    Returns
    -------
    The take, without a body; its labels are in the order of `list_marker_places`.
    """
    markers = scenario.markers
    progress = schedule.progress_at(schedule.frame_times)
    observed = _transform_to_lab(place_cylinder_markers(path, markers, progress), scenario.pose)
    observed += markers.noise * random.standard_normal(observed.shape)
    labels = _draw_labels("Bundle", observed.shape[1], markers.scrambled, random)
    names, observed = _sort_columns(labels, observed)
    return Take(
        time=schedule.frame_clock,
        rate=scenario.clocks.fps,
        names=names,
        positions=observed,
        bodies=(),
        fitted=np.zeros((len(progress), 0, 3)),
        quality=np.zeros((len(progress), 0)),
        labels=labels,
        arc_lengths=list_marker_places(markers)[0],
        log=(),
    )


def _transform_to_lab(positions: Floats, pose: Pose) -> Floats:
    """Transform positions from the specimen frame to the motion-capture frame, m."""
    turned: Floats = positions @ pose.rotation().T + np.asarray(pose.origin)
    return turned


def _draw_labels(
    group: str, number: int, scrambled: bool, random: np.random.Generator
) -> tuple[str, ...]:
    numbers = np.arange(number)
    if scrambled:
        numbers = random.permutation(numbers)
    return tuple(f"{group}:Marker{number + 1}" for number in numbers)


def _sort_columns(names: tuple[str, ...], observed: Floats) -> tuple[tuple[str, ...], Floats]:
    """Sort columns as Motive does: bodies first, then numbers, unlabelled markers last."""

    def rank(column: int) -> tuple[int, int]:
        group, _, number = names[column].partition(":Marker")
        return (2, 0) if not number else (int(group != BODY), int(number))

    order = sorted(range(len(names)), key=rank)
    return tuple(names[column] for column in order), observed[:, order]


def place_wire_markers(
    path: MechanicalPath, progress: Floats, arc_lengths: Floats, centre_offset: float
) -> Floats:
    """Compute marker centres in the specimen frame, m, shape (n, markers, 3), without noise."""
    x, y, angle = path.points(progress, arc_lengths)
    centres = [x - centre_offset * np.sin(angle), y + centre_offset * np.cos(angle)]
    return np.stack([*centres, np.zeros_like(x)], axis=2)


def _film_body(
    pivot: Floats, layout: MarkerLayout, random: np.random.Generator
) -> tuple[RigidBody, Floats]:
    """Return the noisy pose of the clamp and its markers in that pose."""
    frames = len(pivot)
    position = pivot + layout.pivot_noise * random.standard_normal((frames, 3))
    turns = layout.turn_noise * random.standard_normal((frames, 3))
    quaternion = np.column_stack([0.5 * turns, np.ones(frames)])  # small turns about x, y, z
    quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
    turned = np.cross(turns[:, None, :], BODY_MARKERS[None])
    error = layout.noise * (1.5 + 0.2 * random.standard_normal(frames))
    body = RigidBody(BODY, position, quaternion, np.abs(error))
    return body, position[:, None, :] + BODY_MARKERS + turned


def list_marker_places(markers: CylinderMarkers) -> tuple[Floats, Floats]:
    """Return arc length from mid-span, m, and angle at rest, rad, of the markers of all lines."""
    half = markers.n_sections // 2
    sections = markers.spacing * np.arange(-half, half + 1)
    angles = np.repeat(markers.angles, len(sections))
    return np.tile(sections, len(markers.angles)), angles


def compute_twist(path: ThreePointPath, markers: CylinderMarkers, progress: Floats) -> Floats:
    """Return the twist of the sample, rad, right-handed about x, shape (n,)."""
    travel, _, _ = path.middle(progress)
    turned: Floats = markers.twist * travel / path.test.stroke
    return turned


def place_cylinder_markers(
    path: ThreePointPath, markers: CylinderMarkers, progress: Floats
) -> Floats:
    """Compute marker centres in the specimen frame, m, shape (n, markers, 3), without noise."""
    sections, angles = list_marker_places(markers)
    x, y, turn = path.points(progress, sections)
    rolled_angles = angles - compute_twist(path, markers, progress)[:, None]
    up = markers.centre_offset * np.sin(rolled_angles)
    out = markers.centre_offset * np.cos(rolled_angles)
    centres: Floats = np.stack([x - up * np.sin(turn), y + up * np.cos(turn), out], axis=2)
    return centres


def apply_mishaps(
    names: tuple[str, ...],
    positions: Floats,
    mishaps: Mishaps,
    schedule: Schedule,
    *,
    n_body: int,
    random: np.random.Generator,
) -> tuple[tuple[str, ...], Floats, tuple[MishapEvent, ...]]:
    """Apply mishaps to the markers along the wire.

    Parameters
    ----------
    names : of the markers of the body, then of those of the wire from the clamp on
    positions : shape (frames, markers, 3), m
    mishaps : to apply
    schedule : gaps occur while the clamp moves
    n_body : number of markers of the body
    random : source of the gaps

    Returns
    -------
    Names and positions with the mishaps, and the list of mishaps. A gap belongs to a marker, not to
    a label: during a switch it appears under the other label.
    """
    frames, n_wire = len(positions), positions.shape[1] - n_body
    log = _draw_events(mishaps, schedule, n_wire, random)
    observed = positions.copy()
    extra = np.full((frames, 1, 3), np.nan)
    for event in log:
        during, columns = slice(event.start, event.stop), [m + n_body for m in event.markers]
        match event.kind:
            case "gap":
                observed[during, columns] = np.nan
            case "unlabelled":
                extra[during, 0] = observed[during, columns[0]]
                observed[during, columns] = np.nan
            case _:
                observed[during, columns] = observed[during, columns[::-1]]
    if any(event.kind == "unlabelled" for event in log):
        return (*names, UNLABELLED), np.concatenate([observed, extra], axis=1), log
    return names, observed, log


def _draw_events(
    mishaps: Mishaps, schedule: Schedule, n_wire: int, random: np.random.Generator
) -> tuple[MishapEvent, ...]:
    """Draw frames and markers of all mishaps: gaps first, swapped labels last."""
    time = schedule.frame_times
    first, last = np.searchsorted(time, schedule.turning_times[[0, -1]])
    lengths = list(random.integers(2, 16, mishaps.n_gaps))
    if mishaps.long_gap > 0.0:
        lengths.append(round(mishaps.long_gap / (time[1] - time[0])))
    log: list[MishapEvent] = []
    for length in lengths:
        start = int(random.integers(first, max(first + 1, last - length)))
        log.append(MishapEvent("gap", (int(random.integers(n_wire)),), start, start + int(length)))
    stretches = (("unlabelled", mishaps.unlabelled, 1), ("switch", mishaps.switch, 2))
    for kind, stretch, n_markers in stretches:
        if stretch is not None:
            markers = tuple(range(stretch.marker, stretch.marker + n_markers))
            start, stop = (int(share * len(time)) for share in (stretch.start, stretch.stop))
            log.append(MishapEvent(kind, markers, start, stop))
    return tuple(log)
