"""What the instruments of a three-point test record: volts, the frame's travel, markers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.virtual_lab.cameras import Take
from labpipe.virtual_lab.conduit_bundle import ConduitScenario, CylinderMarkers
from labpipe.virtual_lab.load_cell import TriggeredRecord, convert
from labpipe.virtual_lab.tensile_record import FrameRecord
from labpipe.virtual_lab.three_point import ThreePointPath


@dataclass(frozen=True, slots=True, eq=False)
class ConduitSchedule:
    """The motion of the crosshead, in true time.

    Parameters
    ----------
    start, top, stop : s, when it leaves, turns and is back
    stroke : m
    end : s, of all records
    """

    start: float
    top: float
    stop: float
    stroke: float
    end: float

    def progress_at(self, times: Floats) -> Floats:
        """Its way down and up added, m, at true times, s, shape (n,)."""
        corners = [self.start, self.stop]
        return np.interp(times, corners, [0.0, 2.0 * self.stroke])


def plan_conduit(scenario: ConduitScenario) -> ConduitSchedule:
    """Lay out the motion: at rest, down, up at once, at rest."""
    branch = scenario.test.stroke / scenario.speed
    start, top = scenario.rest, scenario.rest + branch
    return ConduitSchedule(
        start, top, top + branch, scenario.test.stroke, top + branch + scenario.rest
    )


def record_force(
    path: ThreePointPath,
    scenario: ConduitScenario,
    schedule: ConduitSchedule,
    random: np.random.Generator,
) -> TriggeredRecord:
    """Measure the force in volts.

    Parameters
    ----------
    path : the solved test
    scenario : factor of the sample, load cell, clocks
    schedule : when what happens
    random : source of the true gain and of the noise

    Returns
    -------
    The record; its clock is zero at its first sample.
    """
    cell, clocks = scenario.load_cell, scenario.clocks
    drawn = cell.gain_uncertainty * float(random.standard_normal())
    gain = cell.gain * (1.0 + (drawn if cell.gain_error is None else cell.gain_error))
    samples = int((schedule.end - clocks.trigger_lag) * clocks.rate)
    clock: Floats = np.arange(samples, dtype=np.float64) / clocks.rate
    times = clocks.trigger_lag + clock / (1.0 + clocks.recorder_drift)
    sensed = scenario.factor * path.force(schedule.progress_at(times))
    sensed = sensed + cell.noise * random.standard_normal(samples)
    return TriggeredRecord(
        clock=clock,
        volts=convert(sensed / gain + cell.offset, cell),
        trigger=np.ones(samples),
        true_gain=float(gain),
    )


def record_travel(
    path: ThreePointPath,
    scenario: ConduitScenario,
    schedule: ConduitSchedule,
    random: np.random.Generator,
) -> FrameRecord:
    """What the load frame's program writes: the crosshead's way, and a force that is too coarse.

    Parameters
    ----------
    path, scenario, schedule : as for `record_force`
    random : source of the noise

    Returns
    -------
    The record, from its first sample on.
    """
    step = 1.0 / scenario.clocks.frame_rate
    time: Floats = np.arange(0.5 * step, schedule.end, step)
    progress = schedule.progress_at(time)
    cell, noise = scenario.frame, random.standard_normal((2, len(time)))
    return FrameRecord(
        time=time,
        displacement=path.displacement(progress) + cell.displacement_noise * noise[0],
        force=scenario.factor * path.force(progress)
        + cell.force_tare
        + cell.force_noise * noise[1],
    )


def film(
    path: ThreePointPath,
    scenario: ConduitScenario,
    schedule: ConduitSchedule,
    random: np.random.Generator,
) -> Take:
    """Film the markers.

    Parameters
    ----------
    path : the solved test
    scenario : markers, pose and clocks
    schedule : when what happens
    random : source of the noise and of the labels' order

    Returns
    -------
    The take: no body; labels in the order of `marker_places`.
    """
    clocks, markers = scenario.clocks, scenario.markers
    frames = int((schedule.end + clocks.camera_lead) * clocks.fps)
    time: Floats = np.arange(frames, dtype=np.float64) / clocks.fps
    progress = schedule.progress_at(time - clocks.camera_lead)
    seen = cylinder_markers(path, markers, progress) @ scenario.pose.rotation().T
    seen += np.asarray(scenario.pose.origin)
    seen += markers.noise * random.standard_normal(seen.shape)
    numbers = np.arange(seen.shape[1])
    if markers.scrambled:
        numbers = random.permutation(numbers)
    order = np.argsort(numbers)
    sections, _ = marker_places(markers)
    return Take(
        time=time,
        rate=clocks.fps,
        names=tuple(f"Bundle:Marker{number + 1}" for number in numbers[order]),
        positions=seen[:, order],
        bodies=(),
        fitted=np.zeros((frames, 0, 3)),
        quality=np.zeros((frames, 0)),
        labels=tuple(f"Bundle:Marker{number + 1}" for number in numbers),
        arc_lengths=sections,
        log=(),
    )


def marker_places(markers: CylinderMarkers) -> tuple[Floats, Floats]:
    """Arc length from mid-span, m, and angle at rest, rad, of all markers, line by line."""
    half = markers.n_sections // 2
    sections = markers.spacing * np.arange(-half, half + 1)
    angles = np.repeat(markers.angles, len(sections))
    return np.tile(sections, len(markers.angles)), angles


def twist_at(path: ThreePointPath, markers: CylinderMarkers, progress: Floats) -> Floats:
    """Twist of the sample, rad, right-handed about x, shape (n,)."""
    way, _, _ = path.middle(progress)
    turned: Floats = markers.twist * way / path.test.stroke
    return turned


def cylinder_markers(path: ThreePointPath, markers: CylinderMarkers, progress: Floats) -> Floats:
    """Marker centres in the specimen frame, m, shape (n, markers, 3), without noise."""
    sections, angles = marker_places(markers)
    x, y, turn = path.points(progress, sections)
    around = angles - twist_at(path, markers, progress)[:, None]
    up = markers.centre_offset * np.sin(around)
    out = markers.centre_offset * np.cos(around)
    centres: Floats = np.stack([x - up * np.sin(turn), y + up * np.cos(turn), out], axis=2)
    return centres
