"""Write synthetic Motive takes: table style, row style, xlsx. No camera saw them."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Column:
    type: str
    name: str
    id: str
    quantity: str
    axis: str
    values: Array


@dataclass(frozen=True, slots=True)
class Layout:
    """How an export is written down; the default is a 1.23 of Motive itself."""

    version: str = "1.23"
    rate: float = 120.0
    unit: str = "Meters"
    rotation: str = "Quaternion"
    first_frame: int = 0
    stated: int | None = None
    take: str = "synthetic"
    start: str = "2026-03-04 09.58.00.000 AM"
    line_end: str = "\r\n"
    milliseconds: bool = False
    time_shift: float = 0.0
    time_code: bool = False
    padding: int = 0
    bom: bool = False
    lower_w: bool = False
    about: dict[str, str] = field(default_factory=dict)


def marker(name: str, positions: Array, *, id_: str = "A1", kind: str = "Marker") -> list[Column]:
    return [
        Column(kind, name, id_, "Position", axis, positions[:, i]) for i, axis in enumerate("XYZ")
    ]


def fitted_marker(name: str, positions: Array) -> list[Column]:
    columns = marker(name, positions, id_="B1", kind="Rigid Body Marker")
    quality = np.ones(len(positions))
    return [*columns, Column("Rigid Body Marker", name, "B1", "Marker Quality", "", quality)]


def rigid_body(
    name: str, positions: Array, rotation: Array, *, error: Array | None = None
) -> list[Column]:
    columns = [
        Column("Rigid Body", name, "C1", "Rotation", axis, rotation[:, i])
        for i, axis in enumerate("XYZW"[: rotation.shape[1]])
    ]
    columns += marker(name, positions, id_="C1", kind="Rigid Body")
    if error is not None:
        columns.append(Column("Rigid Body", name, "C1", "Mean Marker Error", "", error))
    return columns


def write_table(path: Path, columns: Sequence[Column], frames: int, layout: Layout) -> Path:
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator=layout.line_end)
    writer.writerows(_rows(columns, frames, layout))
    mark = b"\xef\xbb\xbf" if layout.bom else b""
    path.write_bytes(mark + stream.getvalue().encode())
    return path


def write_xlsx(path: Path, columns: Sequence[Column], frames: int, layout: Layout) -> Path:
    """As a spreadsheet saves the opened CSV: what looks like a number becomes one."""
    from openpyxl import Workbook

    book = Workbook()
    sheet = book.active
    assert sheet is not None
    for row in _rows(columns, frames, layout):
        sheet.append([_number(cell) for cell in row])
    book.save(path)
    return path


def _number(cell: str) -> object:
    try:
        return float(cell)
    except ValueError:
        return cell or None


def _rows(columns: Sequence[Column], frames: int, layout: Layout) -> list[list[str]]:
    numbers = np.arange(frames) + layout.first_frame
    digits = 3 if layout.milliseconds else 6
    times = [f"{round(n / layout.rate + layout.time_shift, digits):.6f}" for n in numbers]
    code = ["00:00:00:00.00"] if layout.time_code else []
    data = [
        [str(n), times[i], *code, *(_cell(column.values[i]) for column in columns)]
        for i, n in enumerate(numbers)
    ]
    rows = [_first_line(frames, layout), [], *_labels(columns, layout), *data]
    return [[*row, *[""] * layout.padding] for row in rows]


def _first_line(frames: int, layout: Layout) -> list[str]:
    stated = frames if layout.stated is None else layout.stated
    pairs = {
        "Format Version": layout.version,
        "Take Name": layout.take,
        "Take Notes": "",
        "Capture Frame Rate": f"{layout.rate:.6f}",
        "Export Frame Rate": f"{layout.rate:.6f}",
        "Capture Start Time": layout.start,
        "Total Frames in Take": str(stated),
        "Total Exported Frames": str(stated),
        "Rotation Type": layout.rotation,
        "Length Units": layout.unit,
        "Coordinate Space": "Global",
        **layout.about,
    }
    return [cell for pair in pairs.items() for cell in pair]


def _labels(columns: Sequence[Column], layout: Layout) -> list[list[str]]:
    front = [""] * (1 + layout.time_code)
    labels = {"Type": [c.type for c in columns], "Name": [c.name for c in columns]}
    labels["ID"] = [c.id for c in columns]
    if layout.version == "1.25":
        labels["Parent"] = ["" for _ in columns]
    wordless = layout.version == "1.21"
    rows = [[*front, "" if wordless else word, *cells] for word, cells in labels.items()]
    quantities = [*front, "", *(c.quantity for c in columns)]
    axes = [c.axis.lower() if layout.lower_w and c.axis == "W" else c.axis for c in columns]
    time = ["Time" if wordless else "Time (Seconds)", *(["TimeCode"] if layout.time_code else [])]
    return [*rows, quantities, ["Frame", *time, *axes]]


def _cell(value: float) -> str:
    return "" if np.isnan(value) else f"{value:.6f}"


@dataclass(frozen=True, slots=True, eq=False)
class RowBody:
    """A rigid body of a row-style take; where not `tracked` it is written as a lost one."""

    name: str
    id: int
    position: Array
    rotation: Array
    measured: Array
    tracked: NDArray[np.bool_]
    keeps_pose: bool = False


def write_row_style(
    path: Path,
    times: Array,
    bodies: Sequence[RowBody],
    *,
    version: str = "1.1",
    stray: Array | None = None,
    stated: int | None = None,
) -> Path:
    """Write a row-style take; `stray` (frames, 3) is one point that belongs to no body."""
    word = "rigidbody" if version == "1.1" else "trackable"
    lines = ['comment,"Synthetic Export Data"', 'comment,"== "', "righthanded"]
    lines += [f"info,version,{version}"] if version != "1.0" else []
    lines += [f"info,framecount,{len(times) if stated is None else stated}"]
    lines += [f"info,{word}count,{len(bodies)}"]
    for body in bodies:
        model = ",".join("0.01,0.02,0.03" for _ in range(body.measured.shape[1]))
        lines.append(f'{word},"{body.name}",{body.id},{body.measured.shape[1]},{model}')
    for i, time in enumerate(times):
        lines.append(_frame_line(i, time, bodies, version, stray))
        lines += [_body_line(word, i, time, body, version) for body in bodies]
    path.write_bytes(("\r\n".join(lines) + "\r\n").encode())
    return path


def _frame_line(
    i: int, time: float, bodies: Sequence[RowBody], version: str, stray: Array | None
) -> str:
    present = [body for body in bodies if body.tracked[i] or body.keeps_pose]
    cells = ["frame", str(i), f"{time:.8f}", str(len(present))]
    for body in present:
        cells += [str(body.id), *_eight([*body.position[i], *body.rotation[i], 0.0, 0.0, 0.0])]
    points: list[str] = []
    count = 0
    for body in present:
        for k, place in enumerate(body.measured[i]):
            if body.tracked[i] and not np.isnan(place[0]):
                count += 1
                name = ["7", f"{body.name}-Marker {k + 1}"] if version == "1.1" else ["0"]
                points += [*_eight(place), *name]
    if stray is not None and not np.isnan(stray[i, 0]):
        count += 1
        points += [*_eight(stray[i]), *(["99", "Marker-99"] if version == "1.1" else ["0"])]
    return ",".join([*cells, str(count), *points])


def _body_line(word: str, i: int, time: float, body: RowBody, version: str) -> str:
    count = body.measured.shape[1]
    lost = "0" if body.tracked[i] else "17"
    cells = [word, str(i), f"{time:.8f}", f'"{body.name}"', str(body.id), lost, str(count)]
    for _ in range(count):
        cells += ["0.01", "0.02", "0.03", *(["5"] if version == "1.1" else [])]
    for place in body.measured[i]:
        cells += _eight(place) if body.tracked[i] else ["NAN"] * 3
    return ",".join([*cells, *["1"] * count, *["0.5"] * count, "0.25"])


def _eight(values: Sequence[float] | Array) -> list[str]:
    return ["NAN" if np.isnan(value) else f"{value:.8f}" for value in values]
