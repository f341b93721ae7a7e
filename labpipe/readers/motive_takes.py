"""Reader of OptiTrack Motive takes exported as CSV, or saved as xlsx by a spreadsheet.

**Writes this file**: Motive (and Tracking Tools before it), "export tracking data".

**Recording**: measured markers and rigid bodies; fitted Rigid Body Markers are left out.

**Units**: from the key Length Units; row style states none and is taken as metres.

**Missing data**: blank cells (table), NAN or a counter above 0 (row style) become NaN.

**Clock and frame**: frame / export rate where the column of times agrees within 0.6 ms, else the
column; positions stay in the frame of the motion-capture system.

**File structure**: table style (line 1 keys and values, rows of labels, ``Frame``, data), or row
style (every line begins with its type). Everything is found by labels, not by line numbers.

**Known versions**: table style 1.21, 1.23, 1.24, 1.25; row style 1.0, 1.1.
"""

from __future__ import annotations

import csv
import zipfile
from codecs import BOM_UTF8
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from labpipe.readers.channels import ReportOptions
from labpipe.readers.motive_table import (
    Columns,
    Header,
    header_notes,
    marker_tracks,
    needed_columns,
    parse_header,
)
from labpipe.readers.number_table import Body, read_columns, rows_note, sheet_columns
from labpipe.readers.raw_files import DAMAGE_ERRORS, read_head, reading, unreadable
from labpipe.readers.text_cells import as_text
from labpipe.readers.time_axes import clock_notes
from labpipe.readers.tracking import track_notes
from labpipe.readers.workbooks import forget_sheets, is_workbook, open_sheets
from labpipe.records.quality import QualityNote, Severity
from labpipe.records.recording import Clock, MarkerTracks, Recording

_TABLE_STARTS = (b"Format Version", b'"Format Version')
_ROW_STARTS = (b"comment,", b'"comment",')
_SHEETS = ("xl/sharedStrings.xml", "xl/worksheets/sheet1.xml")
_HEADER_LINES = 40
"""Lines searched for header rows; the longest real header has 8."""


def recognise(path: Path) -> bool:
    """Return whether a file is a Motive export of either style, or a workbook with one."""
    if is_workbook(path):
        return _is_saved_take(path)
    return read_head(path, 64).removeprefix(BOM_UTF8).startswith(_TABLE_STARTS + _ROW_STARTS)


def _is_saved_take(path: Path) -> bool:
    """Return whether a workbook contains a take, by a fast search for its first cell."""
    head_bytes = 200_000
    try:
        with zipfile.ZipFile(path) as parts:
            inside = [name for name in _SHEETS if name in parts.namelist()]
            heads = (parts.open(name).read(head_bytes) for name in inside)
            return any(b"Format Version" in head for head in heads)
    except DAMAGE_ERRORS:
        return False


def read(path: Path, *, channels: Sequence[ReportOptions] | None = None) -> Recording:  # noqa: ARG001
    """Read a Motive export.

    Parameters
    ----------
    path : the export of Motive, or a workbook saved from it; of a workbook the first sheet with a
        Motive header is read
    channels : not used; takes are read completely

    Returns
    -------
    The recording: marker tracks, no channels.

    Raises
    ------
    ReadError
        If the workbook, the header or a cell is damaged, or the version is unknown.
    """
    if is_workbook(path):
        return _read_workbook(path)
    with reading(path, "a readable file"):
        content = path.read_bytes().removeprefix(BOM_UTF8)
    if content.startswith(_ROW_STARTS):
        return _read_row_style(content.decode("utf-8", errors="replace"), path)
    return _read_table_style(content, path)


def _read_table_style(content: bytes, path: Path) -> Recording:
    lines = content.split(b"\n", _HEADER_LINES)[:_HEADER_LINES]
    with reading(path, "header rows of cells separated by commas"):
        text = b"\n".join(lines).decode("utf-8", errors="replace")
        rows = [next(csv.reader([line]), []) for line in text.split("\n")]
    header = parse_header(rows, path)
    offset = sum(len(line) + 1 for line in lines[: header.rows])
    body = Body(
        data=content[offset:],
        names=header.names,
        columns=needed_columns(header),
        first_line=header.rows + 1,
        separator=",",
        decimal=".",
        stated_rows=header.stated_rows,
        as_exported=True,
    )
    columns, notes = read_columns(body, path)
    return _recording("motive-csv", header, columns, notes, path)


def _read_workbook(path: Path) -> Recording:
    name, rows = _find_sheet(path)
    header = parse_header([[as_text(cell) for cell in row] for row in rows[:_HEADER_LINES]], path)
    wanted = {column: header.names[column] for column in needed_columns(header)}
    columns, notes = sheet_columns(rows, header.rows, wanted, (path, f"sheet '{name}'"))
    notes += rows_note(header.stated_rows, len(columns[0]))
    return _recording("motive-xlsx", header, columns, notes, path)


def _recording(
    reader: str, header: Header, columns: Columns, notes: list[QualityNote], path: Path
) -> Recording:
    values, infinite = _without_infinities(columns)
    tracks, timing = marker_tracks(header, values, path)
    objects = [{"type": g.type, "name": g.name, "id": g.id} for g in header.groups]
    return Recording(
        reader=reader,
        program="Motive",
        program_version=header.version,
        markers=tracks,
        metadata={**header.about, "objects": objects},
        notes=(
            *header_notes(header, path),
            *notes,
            *infinite,
            *timing,
            *_take_notes(tracks),
        ),
    )


def _read_row_style(text: str, path: Path) -> Recording:
    from labpipe.readers.motive_rows import parse_rows

    with reading(path, "lines of a row-style export"):
        export = parse_rows(text, path)
    return Recording(
        reader="motive-csv",
        program="Motive",
        program_version=export.version,
        markers=export.tracks,
        metadata=export.about,
        notes=(*export.notes, *_take_notes(export.tracks)),
    )


def _take_notes(tracks: MarkerTracks) -> list[QualityNote]:
    return clock_notes(Clock("frames", tracks.time)) + track_notes(tracks)


def _without_infinities(columns: Columns) -> tuple[Columns, list[QualityNote]]:
    infinite = np.array([np.isinf(values) for values in columns.values()])
    if not infinite.any():
        return columns, []
    row = int(np.flatnonzero(infinite.any(axis=0))[0]) + 1
    message = f"{int(infinite.sum())} infinite numbers count as blank, the first in data row {row}"
    note = QualityNote("not_finite", Severity.WARNING, "take", message)
    return {i: np.where(np.isinf(column), np.nan, column) for i, column in columns.items()}, [note]


def _find_sheet(path: Path) -> tuple[str, Sequence[Sequence[object]]]:
    """Return name and cells of the first sheet that begins with a Motive header."""
    for name, rows in open_sheets(path).items():
        if rows and rows[0] and rows[0][0] == "Format Version":
            forget_sheets()
            return name, rows
    remedy = "Save the sheet of the take alone as xlsx."
    expected = "a sheet whose first cell is Format Version"
    raise unreadable(path, "", expected, "none", remedy)
