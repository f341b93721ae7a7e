"""Write a load-frame record as MTS TestSuite writes its ``(Timed)`` text exports.

The layout is that of real exports: UTF-8 with byte order mark, CRLF, four lines of preamble and two
blank ones, names with a trailing blank, numbers that are 32-bit SI numbers turned into the unit of
the column. Several acquisition steps give several files whose numbers are not in the order of
time, and a step without samples leaves a byte order mark alone. The preamble says that the test is
synthetic.
"""

from __future__ import annotations

from datetime import datetime
from pathlib import Path

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.virtual_lab.tensile_record import FrameRecord
from labpipe.virtual_lab.tensile_scenario import ExportLayout

ACTIVITY = "DAQ- Crosshead, … - (Timed)"
NEWTONS = {"N": 1.0, "kN": 1e3}
_LOST_BETWEEN_PARTS = 2
_FOLDER = "C:\\MTS Data\\SYNTHETIC labpipe virtual lab"


def write_test_suite(
    folder: Path,
    record: FrameRecord,
    layout: ExportLayout,
    *,
    name: str,
    started: datetime,
    seed: int,
    kind: str = "tensile test",
) -> tuple[str, ...]:
    """Write a record.

    Parameters
    ----------
    folder : gets the files
    record : what the controller measured
    layout : unit of force and parts
    name : of the test run
    started : time for the preamble
    seed : for the note that the test is synthetic
    kind : of the test, for the same note

    Returns
    -------
    Names of the files, in the order of their numbers.

    Raises
    ------
    ValueError
        If the unit is neither N nor kN, or a part would hold no samples.
    """
    if layout.force_unit not in NEWTONS:
        message = f"force_unit={layout.force_unit!r}: allowed are {', '.join(NEWTONS)}"
        raise ValueError(message)
    files = {}
    for number, part in enumerate(_parts(record, layout)):
        file = f"{ACTIVITY}{number or ''}.txt"
        head = _head(
            file, layout.force_unit, name, started, f"{kind}, labpipe virtual lab, seed {seed}"
        )
        files[file] = "" if part is None else "".join([*head, _rows(part, layout.force_unit)])
    for file, text in files.items():
        (folder / file).write_bytes(text.encode("utf-8-sig"))
    return tuple(files)


def _parts(record: FrameRecord, layout: ExportLayout) -> list[FrameRecord | None]:
    """By number of file: the whole, or the later step, the earlier one, and one without samples."""
    if not layout.in_parts:
        return [record]
    first = int(np.searchsorted(record.time, layout.part_at))
    later = first + _LOST_BETWEEN_PARTS
    if first < 1 or later >= len(record.time):
        message = f"part_at={layout.part_at} s: outside the record"
        raise ValueError(message)
    return [_piece(record, slice(later, None)), _piece(record, slice(first)), None]


def _piece(record: FrameRecord, piece: slice) -> FrameRecord:
    return FrameRecord(record.time[piece], record.displacement[piece], record.force[piece])


def _head(file: str, force_unit: str, name: str, started: datetime, note: str) -> list[str]:
    clock = f"{(started.hour - 1) % 12 + 1}:{started:%M:%S %p}"
    lines = (
        f"File Path: {_FOLDER}\\{name}\\{file}   ",
        f"Test: SYNTHETIC {note}",
        f"Test Run: {name}",
        f"Date: {started.month}/{started.day}/{started.year} {clock}",
        "",
        "",
        "Crosshead \tLoad \tTime ",
        f"mm\t{force_unit}\tsec",
    )
    return [line + "\r\n" for line in lines]


def _rows(record: FrameRecord, force_unit: str) -> str:
    columns = (
        1e3 * _single(record.displacement),
        _single(record.force) / NEWTONS[force_unit],
        _single(record.time),
    )
    rows = np.column_stack(columns).tolist()
    return "".join("\t".join(f"{value:.15G}" for value in row) + "\r\n" for row in rows)


def _single(values: Floats) -> Floats:
    """As the controller keeps them, in 32 bits; no negative zeros."""
    return values.astype(np.float32).astype(np.float64) + 0.0
