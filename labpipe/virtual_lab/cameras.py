"""The motion-capture system: the clamp's rigid body and the markers on the specimen.

Cantilever: marker centres are offset from the wire's axis along its local normal, towards the pull.
The body's initial orientation is the identity for any pose of the rig, as Motive defines a new
body. Then mishaps are applied to the markers: gaps, swapped labels, a renamed marker, a frozen one.

Three-point bending: markers form lines along a cylinder that bends and twists; no body, no mishaps.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.records.recording import MarkerTracks, Recording, RigidBody
from labpipe.virtual_lab.cantilever_path import MechanicalPath
from labpipe.virtual_lab.cantilever_scenarios import (
    CantileverScenario,
    MarkerLayout,
    Mishaps,
    Pose,
)
from labpipe.virtual_lab.conduit_scenarios import ConduitScenario, CylinderMarkers
from labpipe.virtual_lab.recorders import Schedule
from labpipe.virtual_lab.three_point_path import ThreePointPath

BODY = "Clamp"
BODY_MARKERS = np.array(
    [[0.021, 0.014, 0.009], [-0.024, 0.011, -0.008], [0.004, -0.019, 0.017], [0.003, 0.022, -0.019]]
)
"""The clamp's markers relative to its pivot, m, shape (4, 3)."""
UNLABELLED = "Unlabeled 1234"


@dataclass(frozen=True, slots=True)
class MishapEvent:
    """One mishap: affected markers (counted from 0 at the clamp) and frames.

    Parameters
    ----------
    kind : gap, switch, unlabelled or frozen
    markers : by position, not by label
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
    names : of all measured markers, the body's first
    positions : shape (frames, markers, 3), m, NaN where not tracked
    bodies : the clamp, if any
    fitted : shape (frames, 4, 3), m, fitted places of the body's markers; (frames, 0, 3) without a
        body
    quality : shape (frames, 4), Motive's figure for each of them, up to 1; (frames, 0) without
    labels : label of each marker along the specimen, in order
    arc_lengths : shape (markers along the specimen,), m
    log : mishaps
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

    @property
    def body(self) -> RigidBody:
        """Return the clamp."""
        return self.bodies[0]

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
    """Film a cantilever test.

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
    pivot = _in_lab(drop + np.asarray(layout.pivot), pose)
    body, fitted = _film_body(pivot, layout, random)
    arc_lengths = np.array(layout.arc_lengths(scenario.mechanics.length))
    wire = wire_markers(path, progress, arc_lengths, layout.centre_offset) + drop[:, None, :]
    seen = np.concatenate([pivot[:, None, :] + BODY_MARKERS, _in_lab(wire, pose)], axis=1)
    seen += layout.noise * random.standard_normal(seen.shape)
    labels = _labels("Wire", layout.n_markers, layout.scrambled, random)
    names = tuple(f"{BODY}:Marker{n + 1}" for n in range(len(BODY_MARKERS))) + labels
    names, seen, log = apply_mishaps(
        names, seen, scenario.mishaps, schedule, n_body=len(BODY_MARKERS), random=random
    )
    names, seen = _in_order_of_labels(names, seen)
    return Take(
        time=schedule.frame_clock,
        rate=scenario.clocks.fps,
        names=names,
        positions=seen,
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
    """Film a three-point test.

    Parameters
    ----------
    path : the solved test
    scenario : markers, pose and clocks
    schedule : of the motion and the recordings
    random : source of the noise and of the labels' order

    Returns
    -------
    The take: no body; labels in the order of `marker_places`.
    """
    markers = scenario.markers
    progress = schedule.progress_at(schedule.frame_times)
    seen = _in_lab(cylinder_markers(path, markers, progress), scenario.pose)
    seen += markers.noise * random.standard_normal(seen.shape)
    labels = _labels("Bundle", seen.shape[1], markers.scrambled, random)
    names, seen = _in_order_of_labels(labels, seen)
    return Take(
        time=schedule.frame_clock,
        rate=scenario.clocks.fps,
        names=names,
        positions=seen,
        bodies=(),
        fitted=np.zeros((len(progress), 0, 3)),
        quality=np.zeros((len(progress), 0)),
        labels=labels,
        arc_lengths=marker_places(markers)[0],
        log=(),
    )


def _in_lab(positions: Floats, pose: Pose) -> Floats:
    """Transform positions from the specimen frame to the motion-capture frame, m."""
    turned: Floats = positions @ pose.rotation().T + np.asarray(pose.origin)
    return turned


def _labels(
    group: str, number: int, scrambled: bool, random: np.random.Generator
) -> tuple[str, ...]:
    numbers = np.arange(number)
    if scrambled:
        numbers = random.permutation(numbers)
    return tuple(f"{group}:Marker{number + 1}" for number in numbers)


def _in_order_of_labels(names: tuple[str, ...], seen: Floats) -> tuple[tuple[str, ...], Floats]:
    """Sort columns as Motive does: bodies first, numbers in order, unlabelled points last."""

    def rank(column: int) -> tuple[int, int]:
        group, _, number = names[column].partition(":Marker")
        return (2, 0) if not number else (int(group != BODY), int(number))

    order = sorted(range(len(names)), key=rank)
    return tuple(names[column] for column in order), seen[:, order]


def wire_markers(
    path: MechanicalPath, progress: Floats, arc_lengths: Floats, centre_offset: float
) -> Floats:
    """Return marker centres in the specimen frame, m, shape (n, markers, 3), without noise."""
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
    swung = np.cross(turns[:, None, :], BODY_MARKERS[None])
    error = layout.noise * (1.5 + 0.2 * random.standard_normal(frames))
    body = RigidBody(BODY, position, quaternion, np.abs(error))
    return body, position[:, None, :] + BODY_MARKERS + swung


def marker_places(markers: CylinderMarkers) -> tuple[Floats, Floats]:
    """Return arc length from mid-span, m, and angle at rest, rad, of all markers, line by line."""
    half = markers.n_sections // 2
    sections = markers.spacing * np.arange(-half, half + 1)
    angles = np.repeat(markers.angles, len(sections))
    return np.tile(sections, len(markers.angles)), angles


def twist_at(path: ThreePointPath, markers: CylinderMarkers, progress: Floats) -> Floats:
    """Return the twist of the sample, rad, right-handed about x, shape (n,)."""
    travel, _, _ = path.middle(progress)
    turned: Floats = markers.twist * travel / path.test.stroke
    return turned


def cylinder_markers(path: ThreePointPath, markers: CylinderMarkers, progress: Floats) -> Floats:
    """Return marker centres in the specimen frame, m, shape (n, markers, 3), without noise."""
    sections, angles = marker_places(markers)
    x, y, turn = path.points(progress, sections)
    rolled_angles = angles - twist_at(path, markers, progress)[:, None]
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
    names : of the markers, the body's first, the wire's from the clamp on after them
    positions : shape (frames, markers, 3), m
    mishaps : to apply
    schedule : gaps occur while the clamp moves
    n_body : number of the body's markers
    random : source of the gaps

    Returns
    -------
    Names and positions with the mishaps, and their list. Gaps belong to markers, not to labels: a
    gap during a switch appears under the other label.
    """
    frames, n_wire = len(positions), positions.shape[1] - n_body
    log = _events(mishaps, schedule, n_wire, random)
    seen = positions.copy()
    extra = np.full((frames, 1, 3), np.nan)
    for event in log:
        during, columns = slice(event.start, event.stop), [m + n_body for m in event.markers]
        match event.kind:
            case "gap":
                seen[during, columns] = np.nan
            case "frozen":
                seen[during, columns] = seen[event.start, columns]
            case "unlabelled":
                extra[during, 0] = seen[during, columns[0]]
                seen[during, columns] = np.nan
            case _:
                seen[during, columns] = seen[during, columns[::-1]]
    if any(event.kind == "unlabelled" for event in log):
        return (*names, UNLABELLED), np.concatenate([seen, extra], axis=1), log
    return names, seen, log


def _events(
    mishaps: Mishaps, schedule: Schedule, n_wire: int, random: np.random.Generator
) -> tuple[MishapEvent, ...]:
    """Draw frames and markers: mishaps of markers first, of labels last."""
    time = schedule.frame_times
    first, last = np.searchsorted(time, schedule.turning_times[[0, -1]])
    lengths = list(random.integers(2, 16, mishaps.n_gaps))
    if mishaps.long_gap > 0.0:
        lengths.append(round(mishaps.long_gap / (time[1] - time[0])))
    log: list[MishapEvent] = []
    for length in lengths:
        start = int(random.integers(first, max(first + 1, last - length)))
        log.append(MishapEvent("gap", (int(random.integers(n_wire)),), start, start + int(length)))
    stretches = (("frozen", mishaps.frozen, 1), ("unlabelled", mishaps.unlabelled, 1))
    for kind, stretch, n_markers in (*stretches, ("switch", mishaps.switch, 2)):
        if stretch is not None:
            markers = tuple(range(stretch.marker, stretch.marker + n_markers))
            start, stop = (int(share * len(time)) for share in (stretch.start, stretch.stop))
            log.append(MishapEvent(kind, markers, start, stop))
    return tuple(log)
