"""Marker tracks from Motive's row-style exports (1.0, 1.1): each line has its own type."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from labpipe.errors import ReadError
from labpipe.readers.motive_takes import derive_rate, unique_names
from labpipe.records.quality import QualityNote
from labpipe.records.recording import MarkerTracks, RigidBody
from labpipe.units import parse_count

_BODY_WORDS = ("trackable", "rigidbody")


@dataclass(slots=True)
class _Body:
    """Data of one rigid body, by number of the frame line."""

    name: str
    id: str
    n_markers: int
    poses: dict[int, list[float]] = field(default_factory=dict)
    tracked: dict[int, bool] = field(default_factory=dict)
    errors: dict[int, float] = field(default_factory=dict)
    measured: dict[int, list[list[float]]] = field(default_factory=dict)


@dataclass(slots=True)
class _Take:
    """State of the take while its lines are read."""

    version: str = "1.0"
    title: str = ""
    handedness: str = ""
    info: dict[str, str] = field(default_factory=dict)
    bodies: dict[str, _Body] = field(default_factory=dict)
    numbers: list[float] = field(default_factory=list)
    times: list[float] = field(default_factory=list)
    n_bodies: list[int] = field(default_factory=list)
    n_points: list[int] = field(default_factory=list)
    named: dict[tuple[str, str], dict[int, list[float]]] = field(default_factory=dict)


class RowExport(NamedTuple):
    """A row-style export.

    Parameters
    ----------
    version : ``1.1`` as in the file, ``1.0`` if not stated
    tracks : the take in SI
    about : properties of the export
    notes : quality notes
    """

    version: str
    tracks: MarkerTracks
    about: dict[str, object]
    notes: list[QualityNote]


def parse_rows(text: str, path: Path) -> RowExport:
    """Read a row-style export.

    Parameters
    ----------
    text : the whole file
    path : named in errors

    Returns
    -------
    The take. A body's measured markers are named ``<body>-Marker <n>``, as version 1.1 names
    them; positions are taken as metres, as the file states no unit.

    Raises
    ------
    ReadError
        If a line does not have as many cells as it states, or there are no frames.

    Notes
    -----
    A lost body repeats its last pose: only frames count in which its counter of frames since it
    was last tracked is 0. An incomplete last line is omitted.
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
    if not take.numbers:
        raise ReadError.about("readers.no_frames", path, f"lines 1 to {len(lines)}")
    return RowExport(take.version, _tracks(take), _about(take), [*notes, *_notes(take)])


def _read_line(take: _Take, cells: list[str]) -> None:
    first_cell = cells[0]
    if first_cell == "comment":
        take.title = take.title or cells[1]
    elif first_cell == "info":
        take.info[cells[1]] = cells[2]
        take.version = take.info.get("version", take.version)
    elif first_cell in {"righthanded", "lefthanded"}:
        take.handedness = first_cell
    elif first_cell == "frame":
        _read_frame(take, cells)
    elif (
        first_cell in _BODY_WORDS and parse_count(cells[1]) is not None and cells[3] in take.bodies
    ):
        _read_body(take, cells)
    elif first_cell in _BODY_WORDS:
        take.bodies[cells[1]] = _Body(cells[1], cells[2], int(cells[3]))
    else:
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
    number, time = float(cells[1]), float(cells[2])
    bodies = {body.id: body for body in take.bodies.values()}
    poses = [(bodies[cells[i]], _floats(cells[i + 1 : i + 8])) for i in range(4, start, pose_cells)]
    points = [
        (cells[i + 3 : i + width], _floats(cells[i : i + 3]))
        for i in range(start + 1, len(cells), width)
    ]
    row = len(take.numbers)  # all cells are valid here: nothing of a bad line is kept
    take.numbers.append(number)
    take.times.append(time)
    take.n_bodies.append(count)
    take.n_points.append(n_points)
    for body, pose in poses:
        body.poses[row] = pose
    for label, place in points:
        if len(label) == 2:
            take.named.setdefault((label[1], label[0]), {})[row] = place


def _read_body(take: _Take, cells: list[str]) -> None:
    """Read a body line: counter, model and measured markers, flags, mean error."""
    body, count = take.bodies[cells[3]], int(cells[6])
    model = 4 if take.version != "1.0" else 3
    _check_length(cells, 7 + (model + 5) * count + 1)
    start = 7 + model * count
    places = [_floats(cells[i : i + 3]) for i in range(start, start + 3 * count, 3)]
    row, error = len(take.numbers) - 1, float(cells[-1])
    if row < 0 or float(cells[1]) != take.numbers[row]:
        message = f"frame {cells[1]} has no frame line before it"
        raise ValueError(message)
    body.tracked[row] = int(cells[5]) == 0
    body.measured[row] = places
    body.errors[row] = error


def _floats(cells: Sequence[str]) -> list[float]:
    return [float(cell) for cell in cells]


def _tracks(take: _Take) -> MarkerTracks:
    """Return the measured markers of the bodies, then points with another name (1.1)."""
    time = np.array(take.times)
    columns = {
        (f"{body.name}-Marker {i + 1}", body.id): {
            row: points[i] for row, points in body.measured.items() if i < len(points)
        }
        for body in take.bodies.values()
        for i in range(body.n_markers)
    }
    of_bodies = {name for name, _ in columns}
    columns |= {label: points for label, points in take.named.items() if label[0] not in of_bodies}
    positions = np.full((len(time), len(columns), 3), np.nan)
    for i, column in enumerate(columns.values()):
        positions[list(column), i] = [*column.values()] or np.empty((0, 3))
    return MarkerTracks(
        time=time,
        frames=np.array(take.numbers),
        rate=derive_rate(time),
        names=unique_names([*columns]),
        positions=positions,
        bodies=tuple(_rigid_body(body, len(time)) for body in take.bodies.values()),
    )


def _rigid_body(body: _Body, frames: int) -> RigidBody:
    # The mean error is in mm per marker, positions are in metres.
    millimetre = 1e-3
    pose, error = np.full((frames, 7), np.nan), np.full(frames, np.nan)
    for row, values in body.poses.items():
        if body.tracked.get(row, True):
            pose[row] = values
    for row, value in body.errors.items():
        if body.tracked[row]:
            error[row] = value * millimetre
    return RigidBody(body.name, pose[:, :3], pose[:, 3:], error)


def _about(take: _Take) -> dict[str, object]:
    return {
        "title": take.title,
        "handedness": take.handedness,
        "info": take.info,
        "rigid_bodies": {
            b.name: {"id": b.id, "markers": b.n_markers} for b in take.bodies.values()
        },
        "visible_markers": {"least": min(take.n_points), "most": max(take.n_points)},
        "frames_without_body": take.n_bodies.count(0),
    }


def _notes(take: _Take) -> Iterator[QualityNote]:
    frames, without_body = len(take.numbers), take.n_bodies.count(0)
    yield QualityNote.of("readers.unit_assumed", "take")
    stated = parse_count(take.info.get("framecount", ""))
    if stated not in {None, frames}:
        yield QualityNote.of("readers.rows_differ", "file", stated=stated, held=frames)
    if without_body:
        yield QualityNote.of(
            "readers.frames_without_body", "take", count=without_body, total=frames
        )
    least, most = min(take.n_points), max(take.n_points)
    yield QualityNote.of("readers.visible_markers", "markers", least=least, most=most)
    of_no_body = np.array(take.n_points)
    for body in take.bodies.values():
        for row, points in body.measured.items():
            of_no_body[row] -= sum(not np.isnan(point[0]) for point in points)
    of_no_body = of_no_body[of_no_body > 0]
    if len(of_no_body) and not take.named:  # in version 1.0 they have no identity
        count = of_no_body.sum()
        yield QualityNote.of("readers.anonymous_markers", "markers", count=count)
