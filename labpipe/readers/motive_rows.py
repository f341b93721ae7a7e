"""Marker tracks from Motive's row-style exports (1.0, 1.1): each line has its own type."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from labpipe.readers.motive_takes import derived_rate, unique_names
from labpipe.readers.raw_files import unreadable
from labpipe.records.quality import QualityNote, Severity
from labpipe.records.recording import MarkerTracks, RigidBody
from labpipe.units import whole_number

_EXPORT_AGAIN = "Export the take from Motive again; the file may have been cut off or edited."

_BODY_WORDS = ("trackable", "rigidbody")
_Point = tuple[float, float, float]


@dataclass(slots=True)
class _Body:
    """Data of one rigid body, by number of the frame line."""

    name: str
    id: str
    n_markers: int
    poses: dict[int, list[float]] = field(default_factory=dict)
    tracked: dict[int, bool] = field(default_factory=dict)
    errors: dict[int, float] = field(default_factory=dict)
    measured: dict[int, list[_Point]] = field(default_factory=dict)


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
    named: dict[tuple[str, str], dict[int, _Point]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class RowExport:
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
        cells = [line]
        try:
            cells = next(csv.reader([line]), [])
            if cells:
                _read_line(take, cells)
        except (ValueError, IndexError, KeyError, csv.Error) as error:
            if number < len(lines):
                expected = "one of the row types of a Motive export with all its cells"
                found = f"'{cells[0][:20]}' with {len(cells)} cells ({error})"
                raise unreadable(path, f"line {number}", expected, found, _EXPORT_AGAIN) from error
            message = f"the last line ({number}) is incomplete and was left out"
            notes.append(QualityNote("truncated", Severity.WARNING, "file", message))
    if not take.version.startswith("1."):
        remedy = "Export the take with Format Version 1.2x (Motive 2 or 3)."
        expected, found = "info,version,1.0 or 1.1", f"'{take.version}'"
        raise unreadable(path, "info", expected, found, remedy)
    if not take.numbers:
        place, expected = f"lines 1 to {len(lines)}", "lines that begin with frame"
        raise unreadable(path, place, expected, "none", _EXPORT_AGAIN)
    return RowExport(take.version, _tracks(take), _about(take), notes + _notes(take))


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
    elif first_cell in _BODY_WORDS and _is_integer(cells[1]) and not _is_integer(cells[3]):
        _read_body(take, cells)
    elif first_cell in _BODY_WORDS:
        take.bodies[cells[1]] = _Body(cells[1], cells[2], int(cells[3]))
    else:
        message = "unknown row type"
        raise ValueError(message)


def _is_integer(cell: str) -> bool:
    return cell.strip().lstrip("-").isdecimal()


def _read_frame(take: _Take, cells: list[str]) -> None:
    """Read a frame line: number, time, bodies with their poses, then the visible points."""
    # Cells per body: id, x y z, qx qy qz qw, yaw pitch roll.
    pose_cells = 11
    count = int(cells[3])
    start = 4 + pose_cells * count
    n_points = int(cells[start])
    width = 5 if take.version != "1.0" else 4
    if len(cells) != start + 1 + width * n_points:
        message = f"expected {start + 1 + width * n_points} cells"
        raise ValueError(message)
    number, time = float(cells[1]), float(cells[2])
    poses = [cells[4 + pose_cells * i : 4 + pose_cells * (i + 1)] for i in range(count)]
    points = [cells[i : i + width] for i in range(start + 1, len(cells), width)]
    bodies = {body.id: body for body in take.bodies.values()}
    values = [(bodies[pose[0]], [float(cell) for cell in pose[1:8]]) for pose in poses]
    places = [(tuple(point[3:]), _point(point)) for point in points]
    row = len(take.numbers)  # all cells are valid here: nothing of a bad line is kept
    take.numbers.append(number)
    take.times.append(time)
    take.n_bodies.append(count)
    take.n_points.append(n_points)
    for body, pose_ in values:
        body.poses[row] = pose_
    for label, place in places:
        if len(label) == 2:
            take.named.setdefault((label[1], label[0]), {})[row] = place


def _read_body(take: _Take, cells: list[str]) -> None:
    """Read a body line: counter, model and measured markers, flags, mean error."""
    body, count = take.bodies[cells[3]], int(cells[6])
    model = 4 if take.version != "1.0" else 3
    if len(cells) != 7 + (model + 5) * count + 1:
        message = f"expected {7 + (model + 5) * count + 1} cells"
        raise ValueError(message)
    start = 7 + model * count
    places = [_point(cells[i : i + 3]) for i in range(start, start + 3 * count, 3)]
    error = float(cells[-1])
    row = len(take.numbers) - 1
    if row < 0 or float(cells[1]) != take.numbers[row]:
        message = f"frame {cells[1]} has no frame line before it"
        raise ValueError(message)
    body.tracked[row] = int(cells[5]) == 0
    body.measured[row] = places
    body.errors[row] = error


def _point(cells: Sequence[str]) -> _Point:
    return float(cells[0]), float(cells[1]), float(cells[2])


def _tracks(take: _Take) -> MarkerTracks:
    """Return the measured markers of the bodies, then points with another name (1.1)."""
    time = np.array(take.times)
    objects = [
        (f"{body.name}-Marker {i + 1}", body.id)
        for body in take.bodies.values()
        for i in range(body.n_markers)
    ]
    columns = [
        {row: points[i] for row, points in body.measured.items() if i < len(points)}
        for body in take.bodies.values()
        for i in range(body.n_markers)
    ]
    body_markers = {name for name, _ in objects}
    others = {label: points for label, points in take.named.items() if label[0] not in body_markers}
    positions = np.full((len(time), len(objects) + len(others), 3), np.nan)
    for i, column in enumerate([*columns, *others.values()]):
        for row, place in column.items():
            positions[row, i] = place
    return MarkerTracks(
        time=time,
        frames=np.array(take.numbers),
        rate=derived_rate(time),
        names=unique_names([*objects, *others]),
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


def _notes(take: _Take) -> list[QualityNote]:
    frames, without_body = len(take.numbers), take.n_bodies.count(0)
    message = "no unit is stated: positions are taken as metres, mean errors as millimetres"
    notes = [QualityNote("unit_assumed", Severity.WARNING, "take", message)]
    stated = whole_number(take.info.get("framecount", ""))
    if stated not in {None, frames}:
        message = f"the header states {stated} rows, the file holds {frames} frames"
        notes.append(QualityNote("rows_differ", Severity.WARNING, "file", message))
    if without_body:
        message = f"{without_body} of {frames} frames hold no rigid body"
        notes.append(QualityNote("frames_without_body", Severity.INFO, "take", message))
    message = f"{min(take.n_points)} to {max(take.n_points)} markers are seen in a frame"
    notes.append(QualityNote("visible_markers", Severity.INFO, "markers", message))
    of_no_body = np.array(take.n_points)
    for body in take.bodies.values():
        for row, points in body.measured.items():
            of_no_body[row] -= sum(not np.isnan(point[0]) for point in points)
    of_no_body = of_no_body[of_no_body > 0]
    if len(of_no_body) and not take.named:  # in version 1.0 they have no identity
        message = f"{of_no_body.sum()} points in {len(of_no_body)} frames belong to no body and"
        message += " have no identity: left out"
        notes.append(QualityNote("anonymous_markers", Severity.INFO, "markers", message))
    return notes
