"""Read marker tracks from Motive's row-style exports (1.0, 1.1): each line states its type."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from labpipe.errors import ReadError
from labpipe.readers.motive_takes import derive_rate, make_names_unique, make_recording
from labpipe.records.arrays import Ints
from labpipe.records.quality import QualityNote
from labpipe.records.recording import MarkerTracks, Recording, RigidBody
from labpipe.units import parse_count


@dataclass(slots=True)
class _Body:
    """Data of one rigid body, by number of the frame line.

    A state is: whether it is tracked, its mean error, and its measured markers.
    """

    name: str
    id: str
    n_markers: int
    poses: dict[int, list[float]] = field(default_factory=dict)
    states: dict[int, tuple[bool, float, list[list[float]]]] = field(default_factory=dict)


@dataclass(slots=True)
class _Take:
    """State of the take while its lines are read.

    Parameters
    ----------
    version, title, handedness, info : of the header
    bodies : by name
    frames : number, time (s), number of bodies and number of points of each frame line
    named : positions of labelled points, by label and id, and by number of the frame line
    """

    version: str = "1.0"
    title: str = ""
    handedness: str = ""
    info: dict[str, str] = field(default_factory=dict)
    bodies: dict[str, _Body] = field(default_factory=dict)
    frames: list[tuple[float, float, int, int]] = field(default_factory=list)
    named: dict[tuple[str, str], dict[int, list[float]]] = field(default_factory=dict)


def parse_rows(text: str, path: Path) -> Recording:
    """Read a row-style export.

    Parameters
    ----------
    text : the whole file
    path : named in errors

    Returns
    -------
    The recording. A body's measured markers are named ``<body>-Marker <n>``, as version 1.1 names
    them; positions are taken as metres, as the file states no unit.

    Raises
    ------
    ReadError
        If a line does not have as many cells as it states, or there are no frames.

    Notes
    -----
    A lost body repeats its last pose. Its poses count only in frames in which the counter of
    frames since it was last tracked is 0. An incomplete last line is omitted.
    """
    take, notes = _Take(), []
    lines = text.splitlines()
    for number, line in enumerate(lines, start=1):
        try:
            if cells := next(csv.reader([line]), []):
                _read_line(take, cells)
        except (ValueError, IndexError, KeyError, csv.Error) as error:
            if number < len(lines):
                place, start = f"line {number}", line[:20]
                raise ReadError.about(
                    "readers.line_of_take", path, place, line=start, reason=error
                ) from error
            notes.append(QualityNote.of("readers.truncated", "file", line=number))
    if not take.version.startswith("1."):
        raise ReadError.about("readers.take_version", path, "info", version=take.version)
    if not take.frames:
        raise ReadError.about("readers.no_frames", path, f"lines 1 to {len(lines)}")
    n_bodies, n_points = np.array(take.frames)[:, 2:].astype(int).T
    points = {"least": int(n_points.min()), "most": int(n_points.max())}
    about: dict[str, object] = {
        "title": take.title,
        "handedness": take.handedness,
        "info": take.info,
        "rigid_bodies": {
            x.name: {"id": x.id, "markers": x.n_markers} for x in take.bodies.values()
        },
        "visible_markers": points,
        "frames_without_body": int((n_bodies == 0).sum()),
    }
    notes += _make_notes(take, n_bodies, n_points)
    return make_recording("motive-csv", take.version, _make_tracks(take), about, notes)


def _read_line(take: _Take, cells: list[str]) -> None:
    match cells[0]:
        case "comment":
            take.title = take.title or cells[1]
        case "info":
            take.info[cells[1]] = cells[2]
            take.version = take.info.get("version", take.version)
        case "righthanded" | "lefthanded" as handedness:
            take.handedness = handedness
        case "frame":
            _read_frame(take, cells)
        case "trackable" | "rigidbody":
            if parse_count(cells[1]) is not None and cells[3] in take.bodies:
                _read_body(take, cells)
            else:
                take.bodies[cells[1]] = _Body(cells[1], cells[2], int(cells[3]))
        case _:
            message = "unknown row type"
            raise ValueError(message)


def _check_length(cells: Sequence[str], length: int) -> None:
    if len(cells) != length:
        message = f"{len(cells)} instead of {length} cells"
        raise ValueError(message)


def _read_frame(take: _Take, cells: list[str]) -> None:
    """Read a frame line: number, time, bodies with their poses, then the visible points."""
    # Cells per body: id, x y z, qx qy qz qw, yaw pitch roll.
    pose_cells = 11
    count = int(cells[3])
    start = 4 + pose_cells * count
    n_points, width = int(cells[start]), 5 if take.version != "1.0" else 4
    _check_length(cells, start + 1 + width * n_points)
    frame = float(cells[1]), float(cells[2]), count, n_points
    bodies = {body.id: body for body in take.bodies.values()}
    poses = [(bodies[cells[i]], _floats(cells[i + 1 : i + 8])) for i in range(4, start, pose_cells)]
    points = [
        (cells[i + 3 : i + width], _floats(cells[i : i + 3]))
        for i in range(start + 1, len(cells), width)
    ]
    row = len(take.frames)  # all cells are valid here: nothing of a bad line is kept
    take.frames.append(frame)
    for body, pose in poses:
        body.poses[row] = pose
    for label, place in points:
        if len(label) == 2:
            take.named.setdefault((label[1], label[0]), {})[row] = place


def _read_body(take: _Take, cells: list[str]) -> None:
    """Read a body line: counter, model and measured markers, flags, mean error."""
    count, model_cells = int(cells[6]), 4 if take.version != "1.0" else 3
    _check_length(cells, 7 + (model_cells + 5) * count + 1)
    start = 7 + model_cells * count
    places = [_floats(cells[i : i + 3]) for i in range(start, start + 3 * count, 3)]
    error = float(cells[-1])
    if not take.frames or float(cells[1]) != take.frames[-1][0]:
        message = f"frame {cells[1]} has no frame line before it"
        raise ValueError(message)
    take.bodies[cells[3]].states[len(take.frames) - 1] = (int(cells[5]) == 0, error, places)


def _floats(cells: Sequence[str]) -> list[float]:
    return [float(cell) for cell in cells]


def _make_tracks(take: _Take) -> MarkerTracks:
    """Return the measured markers of the bodies, then points with another name (1.1)."""
    numbers, time = np.array(take.frames)[:, :2].T
    columns = {
        (f"{body.name}-Marker {i + 1}", body.id): {
            row: points[i] for row, (_, _, points) in body.states.items() if i < len(points)
        }
        for body in take.bodies.values()
        for i in range(body.n_markers)
    }
    body_markers = {name for name, _ in columns}
    columns |= {
        label: points for label, points in take.named.items() if label[0] not in body_markers
    }
    positions = np.full((len(time), len(columns), 3), np.nan)
    for i, column in enumerate(columns.values()):
        positions[list(column), i] = [*column.values()] or np.empty((0, 3))
    return MarkerTracks(
        time=time,
        frames=numbers,
        rate=derive_rate(time),
        names=make_names_unique([*columns]),
        positions=positions,
        bodies=tuple(_make_rigid_body(body, len(time)) for body in take.bodies.values()),
    )


def _make_rigid_body(body: _Body, frames: int) -> RigidBody:
    # The mean error is in mm per marker, positions are in metres.
    millimetre = 1e-3
    pose, error = np.full((frames, 7), np.nan), np.full(frames, np.nan)
    lost = {row for row, (is_tracked, _, _) in body.states.items() if not is_tracked}
    for row in body.poses.keys() - lost:
        pose[row] = body.poses[row]
    for row in body.states.keys() - lost:
        error[row] = body.states[row][1] * millimetre
    return RigidBody(body.name, pose[:, :3], pose[:, 3:], error)


def _make_notes(take: _Take, n_bodies: Ints, n_points: Ints) -> Iterator[QualityNote]:
    total, without_body = len(take.frames), int((n_bodies == 0).sum())
    yield QualityNote.of("readers.unit_assumed", "take")
    stated = parse_count(take.info.get("framecount", ""))
    if stated not in {None, total}:
        yield QualityNote.of("readers.rows_differ", "file", stated=stated, held=total)
    if without_body:
        yield QualityNote.of("readers.frames_without_body", "take", count=without_body, total=total)
    least, most = int(n_points.min()), int(n_points.max())
    yield QualityNote.of("readers.visible_markers", "markers", least=least, most=most)
    points_without_body = n_points.copy()
    for body in take.bodies.values():
        for row, (_, _, points) in body.states.items():
            points_without_body[row] -= sum(not np.isnan(point[0]) for point in points)
    if (
        count := points_without_body[points_without_body > 0].sum()
    ) and not take.named:  # 1.0: without identity
        yield QualityNote.of("readers.anonymous_markers", "markers", count=count)
