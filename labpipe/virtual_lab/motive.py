"""Write a take as Motive writes a table CSV (Format Version 1.23).

The layout is that of real exports: one line of keys and values, a blank line, rows of types, names,
ids and quantities, then a row of axes and the data with six decimals and blanks for what was not
seen; CRLF line ends; the body's fitted markers (Rigid Body Marker, quoted names) beside the
measured ones of the same name (Marker, bare names). Take Notes says that the take is synthetic.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.virtual_lab.cameras import BODY_MARKERS, Take

UNITS = {"m": ("Meters", 1.0), "cm": ("Centimeters", 100.0), "mm": ("Millimeters", 1000.0)}
_AXES = ("X", "Y", "Z")
_ROWS_AT_A_TIME = 2000


@dataclass(frozen=True, slots=True)
class _Group:
    """The columns of one object: type, name and id as written, and (quantity, axis) of each."""

    kind: str
    name: str
    identity: str
    columns: tuple[tuple[str, str], ...]


def write_motive(
    path: Path, take: Take, *, unit: str, started: datetime, take_name: str, seed: int
) -> None:
    """Write a take.

    Parameters
    ----------
    path : the file
    take : what the cameras saw
    unit : m, cm or mm
    started : capture start
    take_name : as the operator called it
    seed : of the ids, and for the note that the take is synthetic

    Raises
    ------
    ValueError
        If the unit is none of the three.
    """
    if unit not in UNITS:
        message = f"unit={unit!r}: allowed are {', '.join(UNITS)}"
        raise ValueError(message)
    word, factor = UNITS[unit]
    head = [_first_line(take, word, started, take_name, seed), "", *_label_rows(take, seed)]
    with path.open("w", encoding="ascii", newline="") as file:
        file.write("".join(line + "\r\n" for line in head))
        file.writelines(_data_lines(take, factor))


def _first_line(take: Take, word: str, started: datetime, take_name: str, seed: int) -> str:
    frames = str(len(take.time))
    pairs = [
        ("Format Version", "1.23"),
        ("Take Name", take_name),
        ("Take Notes", f"synthetic: made by labpipe's virtual lab with seed {seed}"),
        ("Capture Frame Rate", f"{take.rate:.6f}"),
        ("Export Frame Rate", f"{take.rate:.6f}"),
        ("Capture Start Time", f"{started:%Y-%m-%d %I.%M.%S}.000 {started:%p}"),
        ("Total Frames in Take", frames),
        ("Total Exported Frames", frames),
        ("Rotation Type", "Quaternion"),
        ("Length Units", word),
        ("Coordinate Space", "Global"),
    ]
    return ",".join(f"{key},{value}" for key, value in pairs)


def _groups(take: Take, seed: int) -> list[_Group]:
    random = np.random.default_rng([seed, 77])
    groups = [group for body in take.bodies for group in _body_groups(body.name, random)]
    place = tuple(("Position", axis) for axis in _AXES)
    for name in take.names:
        groups.append(_Group("Marker", name, f'"{random.bytes(3).hex().upper()}"', place))
    return groups


def _body_groups(body: str, random: np.random.Generator) -> list[_Group]:
    body_id = f'"{random.bytes(16).hex().upper()}"'
    place = tuple(("Position", axis) for axis in _AXES)
    turn = tuple(("Rotation", axis) for axis in (*_AXES, "W"))
    groups = [_Group("Rigid Body", body, body_id, (*turn, *place, ("Mean Marker Error", "")))]
    for number in range(len(BODY_MARKERS)):
        columns = (*place, ("Marker Quality", ""))
        name = f'"{body}:Marker{number + 1}"'
        groups.append(_Group("Rigid Body Marker", name, body_id, columns))
    return groups


def _label_rows(take: Take, seed: int) -> list[str]:
    groups = _groups(take, seed)
    kinds = [group.kind for group in groups for _ in group.columns]
    names = [group.name for group in groups for _ in group.columns]
    ids = [group.identity for group in groups for _ in group.columns]
    quantities = [quantity for group in groups for quantity, _ in group.columns]
    axes = [axis for group in groups for _, axis in group.columns]
    rows = (
        ["", "Type", *kinds],
        ["", "Name", *names],
        ["", "ID", *ids],
        ["", "", *quantities],
        ["Frame", "Time (Seconds)", *axes],
    )
    return [",".join(row) for row in rows]


def _table(take: Take, factor: float) -> Floats:
    """All data columns after the frame number, in the file's unit."""
    frames = len(take.time)
    fitted = np.concatenate([take.fitted * factor, take.quality[:, :, None]], axis=2)
    poses = [
        column
        for body in take.bodies
        for column in (body.rotation, body.position * factor, body.error[:, None] * factor)
    ]
    seen = (take.positions * factor).reshape(frames, -1)
    return np.hstack([take.time[:, None], *poses, fitted.reshape(frames, -1), seen])


def _data_lines(take: Take, factor: float) -> Iterator[str]:
    table = _table(take, factor)
    row = "%d" + ",%.6f" * table.shape[1] + "\r\n"
    for first in range(0, len(table), _ROWS_AT_A_TIME):
        block = table[first : first + _ROWS_AT_A_TIME].tolist()
        lines = (row % (first + number, *values) for number, values in enumerate(block))
        yield "".join(lines).replace("nan", "")
