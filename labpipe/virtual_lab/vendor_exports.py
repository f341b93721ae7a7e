"""Writers of exports in the vendors' file formats, one function for each program.

**ControlDesk** (force recorder): a .mat file, MAT v5, file format revision 2.1. It holds one struct
with Info, X, Y and Description. Channels are identified by Path and Name, units are empty, data are
rows, and whole numbers are stored as small integers. The text header states the time of saving.

**Motive** (cameras): a table CSV, Format Version 1.23, with CRLF line ends. A line of keys and
values and a blank line are followed by rows of types, names, ids, quantities and axes, and by the
data with six decimals; cells of untracked markers are blank. The fitted markers of the body (Rigid
Body Marker, quoted names) stand beside the measured markers of the same names (Marker, bare names).

**MTS TestSuite** (load frame): ``(Timed)`` text, UTF-8 with byte order mark, CRLF line ends. Four
lines of preamble and two blank lines are followed by names with a trailing blank. Numbers are
32-bit SI numbers, converted to the unit of the column. Several acquisition steps give several
files, not numbered in the order of time; the file of a step without samples has only a byte order
mark.

**TestResources R-Controller** (load frame): a workbook with time s, force lbf, travel in. No real
export was available: the three quantities and their units are from the dissertation; the name of
the sheet, the names of the columns and the rows above them are assumed.

Every file states that it is synthetic.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.io import savemat
from xlsxwriter import Workbook

from labpipe.records.arrays import Floats
from labpipe.virtual_lab.instruments import (
    BODY_MARKERS,
    PORT,
    ForceRecord,
    FrameRecord,
    Take,
    round_to_single,
)
from labpipe.virtual_lab.tensile import ExportLayout

CONTROL_DESK_VERSION = "7.4"
_RASTER = "HostService"
_NO_LIMIT = np.finfo(np.float64).max

UNITS = {"m": ("Meters", 1.0), "cm": ("Centimeters", 100.0), "mm": ("Millimeters", 1000.0)}
_PLACE = (("Position", "X"), ("Position", "Y"), ("Position", "Z"))
_TURN = (("Rotation", "X"), ("Rotation", "Y"), ("Rotation", "Z"), ("Rotation", "W"))

ACTIVITY = "DAQ- Crosshead, … - (Timed)"
NEWTONS = {"N": 1.0, "kN": 1e3}
_FOLDER = "C:\\MTS Data\\SYNTHETIC labpipe virtual lab"

NEWTONS_PER_POUND, METRES_PER_INCH = 4.4482216152605, 0.0254
HEADER = ("Time (s)", "Force (lbf)", "Displacement (in)")
SHEET = "Test Data"


@dataclass(frozen=True, slots=True)
class Run:
    """Name, time and seed of a virtual test, for the headers of its exports.

    Parameters
    ----------
    name : of the test
    started : time of the test
    seed : for the notes that the test is synthetic
    """

    name: str
    started: datetime
    seed: int


def write_control_desk(path: Path, record: ForceRecord, run: Run) -> None:
    """Write a force record as ControlDesk does; the time of saving is that of its last sample.

    Parameters
    ----------
    path : the file; its stem becomes the name of the struct
    record : of the recorder
    run : for the header and the description
    """
    saved = run.started + timedelta(seconds=round(float(record.clock[-1])))
    axis = {
        "Name": "",
        "Type": np.int32(4),
        "Data": record.clock[None, :],
        "Unit": "",
        "Raster": _RASTER,
    }
    info = {
        "RevisionMajor": np.int32(2),
        "RevisionMinor": np.int32(1),
        "MeasurementID": np.int32(1),
    }
    channels = [_build_channel(*signal) for signal in sorted(record.signals.items())]
    fields = [(name, object) for name in channels[0]]
    content = {
        "Info": info,
        "X": axis,
        "Y": np.array([[tuple(channel.values()) for channel in channels]], dtype=fields),
        "Description": _build_description(record.clock, saved, run.seed),
    }
    savemat(path, {path.stem: content}, oned_as="row", long_field_names=True)
    _set_header_date(path, saved)


def _build_channel(where: str, values: Floats) -> dict[str, object]:
    return {
        "Name": PORT,
        "Type": np.int32(4),
        "Data": _compact_integers(values)[None, :],
        "Unit": "",
        "Raster": _RASTER,
        "Device": "Platform",
        "XIndex": np.int32(1),
        "DownSampling": np.int32(1),
        "Description": "",
        "DisplayIdentifier": "",
        "Path": where,
        "Flags": np.int32(2),
        "Min": -_NO_LIMIT,
        "Max": _NO_LIMIT,
        "MinWeak": -_NO_LIMIT,
        "MaxWeak": _NO_LIMIT,
    }


def _compact_integers(values: Floats) -> NDArray[np.generic]:
    """Convert whole numbers to the smallest unsigned integers, as ControlDesk does."""
    is_whole = bool(np.all(values == np.floor(values)) and np.all(values >= 0.0))
    if not is_whole or np.max(values) > np.iinfo(np.uint16).max:
        return values
    small = np.max(values) <= np.iinfo(np.uint8).max
    return values.astype(np.uint8 if small else np.uint16)


def _build_description(clock: Floats, saved: datetime, seed: int) -> dict[str, object]:
    origin = (
        f"Software revision: virtual_lab.sdf\r\n"
        f"Variable description: virtual_lab.sdf\r\n"
        f"    Platform / Device: Platform [SYNTHETIC: made by labpipe's virtual lab, seed {seed}, "
        f"not a measurement]\r\n"
        f"ControlDesk version: {CONTROL_DESK_VERSION}"
    )
    return {
        "General": {
            "User": "labpipe virtual lab",
            "DateTime": f"{saved:%Y/%m/%d %H:%M:%S}",
            "Origin": origin,
            "Description": "synthetic",
        },
        "Recording": {"StartCondition": "None (Immediate Recording)", "StopCondition": "None"},
        "Measurement": {
            "XAxisOffset": np.uint8(0),
            "Length": float(clock[-1]),
            "StartTimestamp": float(clock[0]),
            "StopTimestamp": float(clock[-1]),
        },
    }


def _set_header_date(path: Path, saved: datetime) -> None:
    """Write a date to the text header, so that equal tests give equal files."""
    text = f"MATLAB 5.0 MAT-file, Platform: PCWIN, Created on: {saved:%a %b %d %H:%M:%S %Y}"
    with path.open("r+b") as file:
        file.write(text.encode("ascii").ljust(116))


def write_motive(path: Path, take: Take, run: Run, *, unit: str) -> None:
    """Write a take as Motive does.

    Parameters
    ----------
    path : the file
    take : of the cameras
    run : for the header; its seed is also that of the ids
    unit : m, cm or mm
    """
    rows_at_a_time = 2000
    word, factor = UNITS[unit]
    labels, table = _build_motive_columns(take, factor, np.random.default_rng([run.seed, 77]))
    head = [
        _format_first_line(take, word, run),
        "",
        *(",".join(row) for row in zip(*labels, strict=True)),
    ]
    row = "%d" + ",%.6f" * table.shape[1] + "\r\n"
    with path.open("w", encoding="ascii", newline="") as file:
        file.write("".join(line + "\r\n" for line in head))
        for first in range(0, len(table), rows_at_a_time):
            block = table[first : first + rows_at_a_time].tolist()
            lines = (row % (first + number, *values) for number, values in enumerate(block))
            file.write("".join(lines).replace("nan", ""))


def _format_first_line(take: Take, word: str, run: Run) -> str:
    frames = str(len(take.time))
    pairs = {
        "Format Version": "1.23",
        "Take Name": run.name,
        "Take Notes": f"synthetic: made by labpipe's virtual lab with seed {run.seed}",
        "Capture Frame Rate": f"{take.rate:.6f}",
        "Export Frame Rate": f"{take.rate:.6f}",
        "Capture Start Time": f"{run.started:%Y-%m-%d %I.%M.%S}.000 {run.started:%p}",
        "Total Frames in Take": frames,
        "Total Exported Frames": frames,
        "Rotation Type": "Quaternion",
        "Length Units": word,
        "Coordinate Space": "Global",
    }
    return ",".join(f"{key},{value}" for key, value in pairs.items())


def _build_motive_columns(
    take: Take, factor: float, random: np.random.Generator
) -> tuple[list[tuple[str, ...]], Floats]:
    """Return type, name, id, quantity and axis of every column, and the data after the frame."""
    labels: list[tuple[str, ...]] = [
        ("", "", "", "", "Frame"),
        ("Type", "Name", "ID", "", "Time (Seconds)"),
    ]
    data = [take.time[:, None]]

    def add(kind: str, name: str, identity: str, *columns: tuple[str, str]) -> None:
        labels.extend((kind, name, identity, *column) for column in columns)

    for body in take.bodies:
        identity = f'"{random.bytes(16).hex().upper()}"'
        add("Rigid Body", body.name, identity, *_TURN, *_PLACE, ("Mean Marker Error", ""))
        data += [body.rotation, body.position * factor, body.error[:, None] * factor]
        for number in range(1, len(BODY_MARKERS) + 1):
            marker = f'"{body.name}:Marker{number}"'
            add("Rigid Body Marker", marker, identity, *_PLACE, ("Marker Quality", ""))
    for name in take.names:
        add("Marker", name, f'"{random.bytes(3).hex().upper()}"', *_PLACE)
    fitted = np.concatenate([take.fitted * factor, take.quality[:, :, None]], axis=2)
    data += [blocks.reshape(len(take.time), -1) for blocks in (fitted, take.positions * factor)]
    return labels, np.hstack(data)


def write_test_suite(
    folder: Path,
    record: FrameRecord,
    layout: ExportLayout,
    run: Run,
    *,
    test_type: str = "tensile test",
) -> tuple[str, ...]:
    """Write a record as MTS TestSuite does.

    Parameters
    ----------
    folder : of the files
    record : of the controller
    layout : unit of force, and time at which the record is divided
    run : for the headers
    test_type : for the note that the test is synthetic

    Returns
    -------
    Names of the files, in the order of their numbers.
    """
    names = []
    for number, part in enumerate(_split_parts(record, layout)):
        file = f"{ACTIVITY}{number or ''}.txt"
        head = _format_preamble(file, layout.force_unit, run, test_type)
        text = "" if part is None else head + _format_rows(part, layout.force_unit)
        (folder / file).write_bytes(text.encode("utf-8-sig"))
        names.append(file)
    return tuple(names)


def _split_parts(record: FrameRecord, layout: ExportLayout) -> list[FrameRecord | None]:
    """Return the parts by number of file: later step, earlier step, and a step without samples."""
    lost_rows = 2
    if layout.part_at is None:
        return [record]
    first = int(np.searchsorted(record.time, layout.part_at))
    return [
        _slice_record(record, slice(first + lost_rows, None)),
        _slice_record(record, slice(first)),
        None,
    ]


def _slice_record(record: FrameRecord, piece: slice) -> FrameRecord:
    return FrameRecord(record.time[piece], record.displacement[piece], record.force[piece])


def _format_preamble(file: str, force_unit: str, run: Run, test_type: str) -> str:
    started = run.started
    clock = f"{(started.hour - 1) % 12 + 1}:{started:%M:%S %p}"
    lines = (
        f"File Path: {_FOLDER}\\{run.name}\\{file}   ",
        f"Test: SYNTHETIC {test_type}, labpipe virtual lab, seed {run.seed}",
        f"Test Run: {run.name}",
        f"Date: {started.month}/{started.day}/{started.year} {clock}",
        "",
        "",
        "Crosshead \tLoad \tTime ",
        f"mm\t{force_unit}\tsec",
    )
    return "".join(line + "\r\n" for line in lines)


def _format_rows(record: FrameRecord, force_unit: str) -> str:
    columns = (
        1e3 * round_to_single(record.displacement),
        round_to_single(record.force) / NEWTONS[force_unit],
        round_to_single(record.time),
    )
    rows = np.column_stack(columns).tolist()
    return "".join("\t".join(f"{value:.15G}" for value in row) + "\r\n" for row in rows)


def write_r_controller(folder: Path, record: FrameRecord, run: Run) -> tuple[str, ...]:
    """Write a record as a workbook of TestResources; equal records give equal bytes.

    Parameters
    ----------
    folder : of the file
    record : of the controller
    run : for the header of the sheet and the properties of the workbook

    Returns
    -------
    Name of the file.
    """
    path = folder / f"{run.name}.xlsx"
    note = f"SYNTHETIC: made by labpipe's virtual lab, seed {run.seed}, not a measurement"
    rows = np.column_stack(
        [
            record.time,
            record.force / NEWTONS_PER_POUND,
            record.displacement / METRES_PER_INCH,
        ]
    )
    head = ((note,), ("Test", run.name), ("Date", f"{run.started:%m/%d/%Y %H:%M:%S}"), (), HEADER)
    with Workbook(path, {"in_memory": True}) as book:
        book.set_properties(
            {
                "title": run.name,
                "comments": note,
                "author": "labpipe virtual lab",
                "created": run.started,
            }
        )
        sheet = book.add_worksheet(SHEET)
        for number, cells in enumerate([*head, *(rows.round(6) + 0.0).tolist()]):
            sheet.write_row(number, 0, cells)
    return (path.name,)
