"""Simulate instruments: settings, schedule of a test, records of recorder, frame and cameras.

In the cantilever rig, marker centres are offset from the axis of the wire along its local normal,
towards the pull. The orientation of the body of the clamp is the identity for any pose of the rig,
because Motive defines a new body in this way. Then mishaps are applied to the markers on the wire:
gaps, a renamed marker, swapped labels.

In three-point bending, markers form lines along a cylinder that bends and twists. There is no body,
and there are no mishaps.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from labpipe.records.arrays import Floats
from labpipe.records.recording import RigidBody

FORCE_PATH = "Model Root/Load Cell"
"""Path of the output of the load cell in the model of the force recorder."""
PORT = "Out1"
"""Name of the port of the model to which each channel of the force recorder belongs."""


class Setting(NamedTuple):
    """Setting of the virtual rig. The test sheet states it if the protocol has another value.

    Parameters
    ----------
    key : dotted key of the protocol
    value : value as in the protocol; a float is a length, m
    reason : reason why the test sheet overrides the protocol
    """

    key: str
    value: object
    reason: str = "setting of the virtual rig"


@dataclass(frozen=True, slots=True)
class LoadCell:
    """Load cell, amplifier and converter.

    Parameters
    ----------
    gain : nominal gain of the calibration sheet, N/V
    gain_uncertainty : relative standard uncertainty of the gain
    gain_error : relative error of the true gain, common to several tests; None to draw it from
        `gain_uncertainty`
    offset : output without load, V
    noise : rms white noise, N
    bits : resolution of the converter
    full_scale : range of the converter, from -`full_scale` to +`full_scale`, V
    """

    gain: float = 0.5
    gain_uncertainty: float = 0.002
    gain_error: float | None = None
    offset: float = 0.013
    noise: float = 4e-3
    bits: int = 16
    full_scale: float = 10.0

    def read(self, force: Floats, random: np.random.Generator) -> tuple[Floats, float]:
        """Simulate the output of the load cell, with quantisation and saturation.

        Parameters
        ----------
        force : shape (n,), N, true force
        random : random generator of gain error and noise

        Returns
        -------
        Output, shape (n,), V, and true gain, N/V.
        """
        random_error = self.gain_uncertainty * random.standard_normal()
        gain_error = random_error if self.gain_error is None else self.gain_error
        true_gain = float(self.gain * (1.0 + gain_error))
        noisy_force = force + self.noise * random.standard_normal(len(force))
        resolution = 2.0 * self.full_scale / 2**self.bits
        min_count, max_count = -(2 ** (self.bits - 1)), 2 ** (self.bits - 1) - 1
        counts = np.rint((noisy_force / true_gain + self.offset) / resolution)
        return np.clip(counts, min_count, max_count) * resolution, true_gain

    def list_settings(self) -> list[Setting]:
        """List the nominal gain and its uncertainty, as on the calibration sheet."""
        uncertainty = f"{100 * self.gain_uncertainty:.10g} %"
        return [
            Setting("sources.force.calibration.gain", f"{self.gain:.10g} N/V"),
            Setting("sources.force.calibration.gain_uncertainty", uncertainty),
        ]


@dataclass(frozen=True, slots=True)
class Pose:
    """Pose of the rig in the frame of the motion-capture system (Y up).

    Parameters
    ----------
    yaw, pitch, roll : rotations about Y, X and Z, rad; roll is applied first, yaw last
    origin : position of the origin of the specimen frame, at zero travel of the clamp, m
    """

    yaw: float = 0.65
    pitch: float = 0.04
    roll: float = -0.03
    origin: tuple[float, float, float] = (0.215, 1.031, -0.442)

    def compute_rotation(self) -> Floats:
        """Compute the matrix from the specimen frame to the motion-capture frame, shape (3, 3)."""
        return Rotation.from_euler("YXZ", [self.yaw, self.pitch, self.roll]).as_matrix()

    def transform_to_lab(self, positions: Floats) -> Floats:
        """Transform positions, shape (..., 3), m, to the motion-capture frame."""
        return np.asarray(positions @ self.compute_rotation().T + np.asarray(self.origin))


@dataclass(frozen=True, slots=True)
class MarkerInterval:
    """Interval of a take in which a mishap affects a marker.

    Parameters
    ----------
    marker : index of the marker, from 0 at the clamp
    start, stop : start and end of the interval, as fractions of the frames of the take
    """

    marker: int
    start: float
    stop: float


@dataclass(frozen=True, slots=True)
class Mishaps:
    """Mishaps of the markers of a take; `NO_MISHAPS` has none.

    Parameters
    ----------
    n_gaps : number of short gaps, of 2 to 15 frames, at random times during the motion, on random
        markers
    long_gap : duration of one long gap on a random marker, s; 0 for no such gap
    switch : interval in which the marker and the next marker swap labels; None for no swap
    unlabelled : interval in which the marker is named ``Unlabeled 1234``; None for no interval
    """

    n_gaps: int = 8
    long_gap: float = 1.2
    switch: MarkerInterval | None = MarkerInterval(3, 0.40, 0.55)
    unlabelled: MarkerInterval | None = MarkerInterval(5, 0.70, 0.72)


NO_MISHAPS = Mishaps(n_gaps=0, long_gap=0.0, switch=None, unlabelled=None)
MISHAPS = (
    Mishaps(),
    Mishaps(n_gaps=4, long_gap=0.0, switch=MarkerInterval(1, 0.62, 1.0), unlabelled=None),
    Mishaps(n_gaps=12, long_gap=0.8, switch=None, unlabelled=MarkerInterval(2, 0.3, 0.33)),
)
"""Mishaps in the tests of successive samples of a type; the sequence repeats."""


@dataclass(frozen=True, slots=True, eq=False)
class Schedule:
    """Motion of clamp or crosshead, and times of the samples of both recorders, in true time.

    Parameters
    ----------
    corner_times : shape (n,), s, times at which the motion starts or stops
    progress : shape (n,), m, total travel up and down until these times
    turning_times : shape (2 cycles + 1,), s, start of the motion, and arrival at full stroke and at
        zero in each cycle
    end_time : end of all records, s
    frame_clock : shape (frames,), s, times of the frames on the clock of the cameras
    frame_times : shape (frames,), s, the same times in true time
    force_clock : shape (samples,), s, times of the samples on the clock of the force recorder
    force_times : shape (samples,), s, the same times in true time
    """

    corner_times: Floats
    progress: Floats
    turning_times: Floats
    end_time: float
    frame_clock: Floats
    frame_times: Floats
    force_clock: Floats
    force_times: Floats

    def compute_progress(self, times: Floats) -> Floats:
        """Compute the progress, m, at true times, s; it is constant before and after the motion."""
        return np.interp(times, self.corner_times, self.progress)


@dataclass(frozen=True, slots=True, eq=False)
class ForceRecord:
    """Samples of the force recorder.

    Parameters
    ----------
    clock_times : shape (samples,), s, times on the clock of the recorder
    signals : signals of shape (samples,), keyed by path. One is the output of the load cell, V. A
        cantilever test adds the direction, which is 1 while the clamp moves down and 0 otherwise,
        and the frequency of the pulses of the motor, Hz. A three-point test adds the trigger that
        started the recorder, which is always 1
    true_gain : true gain of the load cell, N/V
    """

    clock_times: Floats
    signals: Mapping[str, Floats]
    true_gain: float


@dataclass(frozen=True, slots=True)
class ExportLayout:
    """Layout of the export of a load frame.

    Parameters
    ----------
    force_unit : ``N`` or ``kN`` for MTS TestSuite, ``lbf`` for TestResources R-Controller
    part_at : time at which TestSuite begins a second acquisition step, s. It then writes three
        files: one for each step, not numbered in the order of time, and one without samples. None
        for a single step in one file
    """

    force_unit: str = "kN"
    part_at: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class FrameRecord:
    """Samples of the controller of the load frame, all of shape (n,).

    Parameters
    ----------
    time : time since the start of the load frame, s
    displacement : displacement with tare, noise and resolution, m
    force : force with tare, gain error, noise and resolution, N
    layout : layout of the export
    test_type : type of test, for the header of the export
    """

    time: Floats
    displacement: Floats
    force: Floats
    layout: ExportLayout = ExportLayout()
    test_type: str = "tensile test"


def round_to_single(values: Floats) -> Floats:
    """Round values to 32-bit floating-point numbers, as a controller stores them.

    Parameters
    ----------
    values : array of any shape, in SI units

    Returns
    -------
    Rounded values as 64-bit numbers, without negative zeros.
    """
    return values.astype(np.float32).astype(np.float64) + 0.0


_BODY_NAME = "Clamp"
"""Name of the rigid body of the clamp."""
BODY_MARKERS = np.array(
    [[0.021, 0.014, 0.009], [-0.024, 0.011, -0.008], [0.004, -0.019, 0.017], [0.003, 0.022, -0.019]]
)
"""Positions of the markers of the clamp relative to its pivot, m, shape (4, 3)."""


@dataclass(frozen=True, slots=True)
class MishapEvent:
    """Mishap in a take.

    Parameters
    ----------
    kind : kind of the mishap: ``gap``, ``switch`` or ``unlabelled``
    markers : indices of the affected markers, from 0 at the clamp, regardless of labels
    start, stop : indices of the first affected frame, and of the first frame after the mishap
    """

    kind: str
    markers: tuple[int, ...]
    start: int
    stop: int


@dataclass(frozen=True, slots=True, eq=False)
class Take:
    """Motion-capture take.

    Parameters
    ----------
    time : shape (frames,), s, times of the frames on the clock of the cameras
    rate : frames per second
    labels : labels of all measured markers; those of the markers of the body are first
    positions : shape (frames, markers, 3), m; NaN for untracked markers
    bodies : body of the clamp; empty in three-point bending
    fitted_positions : shape (frames, 4, 3), m, positions of the markers of the body in its fitted
        pose; (frames, 0, 3) without a body
    marker_quality : shape (frames, 4), Marker Quality of Motive, up to 1; (frames, 0) without a
        body
    specimen_labels : labels of the markers along the specimen, in the order of their arc lengths,
        without mishaps
    mishap_events : mishaps, in the order in which they are applied
    length_unit : unit of length in the export: m, cm or mm
    """

    time: Floats
    rate: float
    labels: tuple[str, ...]
    positions: Floats
    bodies: tuple[RigidBody, ...]
    fitted_positions: Floats
    marker_quality: Floats
    specimen_labels: tuple[str, ...]
    mishap_events: tuple[MishapEvent, ...]
    length_unit: str


def simulate_take(
    group: str,
    positions: Floats,
    schedule: Schedule,
    random: np.random.Generator,
    *,
    pose: Pose,
    fps: float,
    length_unit: str,
    noise: float,
    clamp: tuple[Floats, float, float] | None = None,
    mishaps: Mishaps = NO_MISHAPS,
) -> Take:
    """Simulate a motion-capture take.

    Parameters
    ----------
    group : name of the group of markers along the specimen
    positions : shape (frames, markers, 3), m, centres of the markers in the specimen frame
    schedule : schedule of the motion and the recordings
    random : random generator for noise, labels and mishaps
    pose : pose of the rig
    fps : frames per second
    length_unit : unit of length in the export: m, cm or mm
    noise : rms noise of a marker per axis, m
    clamp : positions of the pivot of the clamp in the specimen frame, shape (frames, 3), m, rms
        noise of the pivot per axis, m, and rms noise of the rotation about each axis, rad; None
        without a clamp
    mishaps : mishaps of the markers along the specimen
    """
    n_frames, n_markers = positions.shape[:2]
    measured = pose.transform_to_lab(positions)
    labels: tuple[str, ...] = ()
    bodies: tuple[RigidBody, ...] = ()
    fitted_positions = np.zeros((n_frames, 0, 3))
    if clamp is not None:
        pivot = pose.transform_to_lab(clamp[0])
        body, fitted_positions = _simulate_body(pivot, *clamp[1:], noise, random)
        bodies = (body,)
        labels = tuple(f"{_BODY_NAME}:Marker{n + 1}" for n in range(len(BODY_MARKERS)))
        measured = np.concatenate([pivot[:, None, :] + BODY_MARKERS, measured], axis=1)
    measured += noise * random.standard_normal(measured.shape)
    specimen_labels = tuple(f"{group}:Marker{n + 1}" for n in random.permutation(n_markers))
    events = _draw_mishaps(mishaps, schedule, n_markers, random)
    labels, measured = _apply_mishaps((*labels, *specimen_labels), measured, events, n_markers)
    columns = sorted(range(len(labels)), key=lambda column: _rank_label(labels[column]))
    quality = 1.0 - np.abs(0.01 * random.standard_normal(fitted_positions.shape[:2]))
    return Take(
        time=schedule.frame_clock,
        rate=fps,
        labels=tuple(labels[column] for column in columns),
        positions=measured[:, columns],
        bodies=bodies,
        fitted_positions=fitted_positions,
        marker_quality=np.clip(quality, 0.0, 1.0),
        specimen_labels=specimen_labels,
        mishap_events=events,
        length_unit=length_unit,
    )


def _simulate_body(
    pivot: Floats, pivot_noise: float, turn_noise: float, noise: float, random: np.random.Generator
) -> tuple[RigidBody, Floats]:
    """Simulate the pose of the clamp with noise, and the positions of its markers in this pose."""
    n_frames = len(pivot)
    position = pivot + pivot_noise * random.standard_normal((n_frames, 3))
    rotations = turn_noise * random.standard_normal((n_frames, 3))
    # The vector part of the quaternion of a small rotation is half the rotation vector.
    quaternion = np.column_stack([0.5 * rotations, np.ones(n_frames)])
    quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
    marker_shifts = np.cross(rotations[:, None, :], BODY_MARKERS[None])
    error = noise * (1.5 + 0.2 * random.standard_normal(n_frames))
    body = RigidBody(_BODY_NAME, position, quaternion, np.abs(error))
    return body, position[:, None, :] + BODY_MARKERS + marker_shifts


def _rank_label(label: str) -> tuple[int, int]:
    """Rank a label as Motive does: the body first, then markers by number, unlabelled ones last."""
    group, _, marker_number = label.partition(":Marker")
    return (int(group != _BODY_NAME), int(marker_number)) if marker_number else (2, 0)


def _draw_mishaps(
    mishaps: Mishaps, schedule: Schedule, n_markers: int, random: np.random.Generator
) -> tuple[MishapEvent, ...]:
    """Draw the gaps, and list all mishaps: gaps first, swapped labels last."""
    time = schedule.frame_times
    first_frame, last_frame = np.searchsorted(time, schedule.turning_times[[0, -1]])
    gap_lengths = list(random.integers(2, 16, mishaps.n_gaps))
    if mishaps.long_gap > 0.0:
        gap_lengths.append(round(mishaps.long_gap / (time[1] - time[0])))
    events: list[MishapEvent] = []
    for n_frames in gap_lengths:
        start = int(random.integers(first_frame, max(first_frame + 1, last_frame - n_frames)))
        marker = int(random.integers(n_markers))
        events.append(MishapEvent("gap", (marker,), start, start + int(n_frames)))
    intervals_by_kind = (("unlabelled", mishaps.unlabelled, 1), ("switch", mishaps.switch, 2))
    for kind, interval, n_affected in intervals_by_kind:
        if interval is not None:
            markers = tuple(range(interval.marker, interval.marker + n_affected))
            start, stop = int(interval.start * len(time)), int(interval.stop * len(time))
            events.append(MishapEvent(kind, markers, start, stop))
    return tuple(events)


def _apply_mishaps(
    labels: tuple[str, ...], positions: Floats, events: tuple[MishapEvent, ...], n_markers: int
) -> tuple[tuple[str, ...], Floats]:
    """Apply mishaps to the markers along the specimen, which are the last `n_markers`.

    A gap affects a marker, not a label. While labels are swapped, the gap is under the other label.
    """
    first_column = len(labels) - n_markers
    unlabelled_marker = np.full((len(positions), 1, 3), np.nan)
    for event in events:
        frames = slice(event.start, event.stop)
        columns = [first_column + marker for marker in event.markers]
        if event.kind == "switch":
            positions[frames, columns] = positions[frames, columns[::-1]]
            continue
        if event.kind == "unlabelled":
            unlabelled_marker[frames] = positions[frames, columns]
        positions[frames, columns] = np.nan
    if any(event.kind == "unlabelled" for event in events):
        return (*labels, "Unlabeled 1234"), np.concatenate([positions, unlabelled_marker], axis=1)
    return labels, positions


def list_markers(labels: tuple[str, ...], arc_lengths: Floats) -> list[dict[str, object]]:
    """List label and arc length, m, of each marker along a specimen for ``truth.json``."""
    pairs = zip(labels, arc_lengths.round(12).tolist(), strict=True)
    return [{"label": label, "arc_length": arc_length} for label, arc_length in pairs]


@dataclass(frozen=True, slots=True, eq=False)
class TensionRecord:
    """Samples of a testing machine with an extensometer, all of shape (n,).

    Parameters
    ----------
    time : times of the samples, s
    force : force on the specimen, N
    travel : travel of the crosshead, m
    extension : change of the gauge length, m; NaN after the removal of the extensometer
    """

    time: Floats
    force: Floats
    travel: Floats
    extension: Floats
