"""What the motion-capture system sees: the clamp's rigid body and the markers along the wire.

Marker centres stand off the wire's axis along its local normal, towards the pull. The body's
orientation is the identity at the beginning, as Motive defines a new body, whatever way the rig
stands: it does not know where the wire points.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.records.recording import MarkerTracks, Recording, RigidBody
from labpipe.virtual_lab.mechanics import MechanicalPath
from labpipe.virtual_lab.mishaps import Log, befall
from labpipe.virtual_lab.scenario import CantileverScenario, MarkerLayout
from labpipe.virtual_lab.schedule import Schedule

BODY = "Clamp"
BODY_MARKERS = np.array(
    [[0.021, 0.014, 0.009], [-0.024, 0.011, -0.008], [0.004, -0.019, 0.017], [0.003, 0.022, -0.019]]
)
"""The clamp's markers relative to its pivot, m, shape (4, 3)."""


@dataclass(frozen=True, slots=True, eq=False)
class Take:
    """A motion-capture take.

    Parameters
    ----------
    time : shape (frames,), s
    rate : frames per second
    names : of all measured markers, the body's first
    positions : shape (frames, markers, 3), m, NaN where not seen
    bodies : the clamp, where there is one
    fitted : shape (frames, 4, 3), m, where the fit of the body puts its markers; (frames, 0, 3)
        without a body
    quality : shape (frames, 4), Motive's figure for each of them, up to 1; (frames, 0) without
    labels : label of each marker along the specimen, in order
    arc_lengths : shape (markers along the specimen,), m
    log : what went wrong
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
    log: Log

    @property
    def body(self) -> RigidBody:
        """The clamp."""
        return self.bodies[0]

    def recording(self) -> Recording:
        """The take as a reader of the export would give it."""
        tracks = MarkerTracks(
            time=self.time,
            frames=np.arange(len(self.time), dtype=np.float64),
            rate=self.rate,
            names=self.names,
            positions=self.positions,
            bodies=self.bodies,
        )
        return Recording(reader="motive-csv", markers=tracks)


def record_take(
    path: MechanicalPath,
    scenario: CantileverScenario,
    schedule: Schedule,
    random: np.random.Generator,
) -> Take:
    """Film the test.

    Parameters
    ----------
    path : the solved test
    scenario : marker layout, pose and mishaps
    schedule : when what happens
    random : source of noise and mishaps

    Returns
    -------
    The take.
    """
    layout, time = scenario.markers, schedule.frame_times
    progress = schedule.progress_at(time)
    drop = np.zeros((len(time), 3))
    drop[:, 1] = -path.travel(progress)
    turn, origin = scenario.pose.rotation(), np.asarray(scenario.pose.origin)
    pivot = (drop + np.asarray(layout.pivot)) @ turn.T + origin
    body, fitted = _film_body(pivot, layout, random)
    seen_body = pivot[:, None, :] + BODY_MARKERS
    arc_lengths = np.array(layout.arc_lengths(scenario.mechanics.length))
    wire = wire_markers(path, progress, arc_lengths, layout.centre_offset)
    wire = (wire + drop[:, None, :]) @ turn.T + origin
    seen = np.concatenate([seen_body, wire], axis=1)
    seen += layout.noise * random.standard_normal(seen.shape)
    labels = _labels(layout, random)
    names = tuple(f"{BODY}:Marker{n + 1}" for n in range(len(BODY_MARKERS))) + labels
    names, seen, log = befall(
        names, seen, scenario.mishaps, schedule, n_body=len(BODY_MARKERS), random=random
    )
    names, seen = _in_order_of_labels(names, seen)
    return Take(
        time=time,
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


def wire_markers(
    path: MechanicalPath, progress: Floats, arc_lengths: Floats, centre_offset: float
) -> Floats:
    """Marker centres in the specimen frame, m, shape (n, markers, 3), without noise."""
    x, y, angle = path.points(progress, arc_lengths)
    centres = [x - centre_offset * np.sin(angle), y + centre_offset * np.cos(angle)]
    return np.stack([*centres, np.zeros_like(x)], axis=2)


def _film_body(
    pivot: Floats, layout: MarkerLayout, random: np.random.Generator
) -> tuple[RigidBody, Floats]:
    """Pose of the clamp with its noise, and its markers where that pose puts them."""
    frames = len(pivot)
    position = pivot + layout.pivot_noise * random.standard_normal((frames, 3))
    turns = layout.turn_noise * random.standard_normal((frames, 3))
    quaternion = np.column_stack([0.5 * turns, np.ones(frames)])  # small turns about x, y, z
    quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
    swung = np.cross(turns[:, None, :], BODY_MARKERS[None])
    error = layout.noise * (1.5 + 0.2 * random.standard_normal(frames))
    body = RigidBody(BODY, position, quaternion, np.abs(error))
    return body, position[:, None, :] + BODY_MARKERS + swung


def _labels(layout: MarkerLayout, random: np.random.Generator) -> tuple[str, ...]:
    numbers = np.arange(layout.n_markers)
    if layout.scrambled:
        numbers = random.permutation(numbers)
    return tuple(f"Wire:Marker{number + 1}" for number in numbers)


def _in_order_of_labels(names: tuple[str, ...], seen: Floats) -> tuple[tuple[str, ...], Floats]:
    """Columns as Motive writes them: bodies first, numbers in order, unlabelled points last."""

    def rank(column: int) -> tuple[int, int]:
        group, _, number = names[column].partition(":Marker")
        return (BODY, "Wire").index(group) if number else 2, int(number or 0)

    order = sorted(range(len(names)), key=rank)
    return tuple(names[column] for column in order), seen[:, order]
