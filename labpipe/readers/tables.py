"""Bodies of CSV exports: numbers with blanks, read fast, every loss noticed."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from labpipe.errors import ReadError, complaint
from labpipe.readers.files import reading
from labpipe.records.arrays import Floats, Ints
from labpipe.records.quality import QualityNote, Severity

_AGAIN = "Export the recording again; the file may have been cut off or edited."


@dataclass(frozen=True, slots=True)
class Body:
    """The data lines of a CSV export.

    Parameters
    ----------
    text : the bytes, from the first data line on
    width : number of cells that a whole line has
    first_line : line number of the first data line in the file, counted from 1
    stated_rows : number of rows that the header promises, None if it does not
    """

    text: bytes
    width: int
    first_line: int
    stated_rows: int | None = None


def read_numbers(
    body: Body, columns: Sequence[int], path: Path
) -> tuple[Floats, list[QualityNote]]:
    """Read columns of numbers; a blank cell is NaN.

    Parameters
    ----------
    body : the data lines
    columns : which cells of each line, counted from 0, ascending
    path : named in errors

    Returns
    -------
    Array of shape (rows, columns), and the notes ``truncated`` (an incomplete last line was left
    out), ``lines_short`` and ``rows_differ`` (from the number that the header states).

    Raises
    ------
    ReadError
        If a cell is no number, or a line has more cells than the header.
    """
    text, notes = _without_cut_line(body)
    notes += _ragged(text, body, path)
    numbers = _parsed(text, body, columns, path)
    numbers = numbers[: _filled(numbers)]
    if body.stated_rows is not None and body.stated_rows != len(numbers):
        message = f"the header states {body.stated_rows} rows, the file holds {len(numbers)}"
        notes.append(QualityNote("rows_differ", Severity.WARNING, "file", message))
    return numbers, notes


def _without_cut_line(body: Body) -> tuple[bytes, list[QualityNote]]:
    """Leave out a last line that stops in the middle.

    A last line without line end is whole only if it has all its cells, the header promises no
    further row, and its last number has as many decimals as the one above it.
    """
    text = body.text
    end = text.rfind(b"\n") + 1
    last = text[end:]
    if not last.strip(b"\r\0 "):
        return text, []
    rows = text.count(b"\n") + 1
    above = text[text.rfind(b"\n", 0, end - 1) + 1 : max(end - 1, 0)]
    is_whole = last.count(b",") >= body.width - 1 and _decimals(last) >= _decimals(above)
    if is_whole and rows >= (body.stated_rows or 0):
        return text, []
    message = f"the last line ({body.first_line + rows - 1}) is incomplete and was left out"
    return text[:end], [QualityNote("truncated", Severity.WARNING, "file", message)]


def _decimals(line: bytes) -> int:
    """Number of digits that the last cell of a line has after its decimal point."""
    cell = line.rstrip(b"\r").rpartition(b",")[2]
    return len(cell.partition(b".")[2])


def _ragged(text: bytes, body: Body, path: Path) -> list[QualityNote]:
    """Find lines with too few cells (noted) or too many (refused); blank ones more are padding."""
    commas = body.width - 1
    starts, counts = _commas(text)
    short: list[int] = []
    for i in np.flatnonzero(counts != commas):
        line = text[starts[i] : starts[i + 1]].rstrip(b"\r\n")
        if line and counts[i] < commas:
            short.append(body.first_line + int(i))
        elif line.rstrip(b",").count(b",") > commas:
            place, found = f"line {body.first_line + i}", f"{counts[i] + 1}"
            expected = f"{body.width} cells as in the header"
            raise ReadError(complaint(path, place, expected=expected, found=found, remedy=_AGAIN))
    if not short:
        return []
    message = f"{len(short)} lines have too few cells, first line {short[0]}:"
    message += " what they lack counts as blank"
    return [QualityNote("lines_short", Severity.WARNING, "file", message)]


def _commas(text: bytes) -> tuple[Ints, Ints]:
    """Where each line starts (and the last one ends), and how many commas each line has."""
    letters = np.frombuffer(text, dtype=np.uint8)
    ends = np.append(np.flatnonzero(letters == ord("\n")) + 1, len(letters)).astype(np.int64)
    before = np.searchsorted(np.flatnonzero(letters == ord(",")), ends)
    return np.concatenate(([0], ends)), np.diff(before, prepend=0)


def _parsed(text: bytes, body: Body, columns: Sequence[int], path: Path) -> Floats:
    import pandas as pd

    if not text.strip():
        return np.empty((0, len(columns)))
    padded = text[: text.find(b"\n") + 1 or None].count(b",") + 1
    try:
        table = pd.read_csv(
            io.BytesIO(text),
            header=None,
            names=list(range(max(body.width, padded))),
            usecols=list(columns),
            dtype=np.float64,
            na_values=["NAN"],
            skip_blank_lines=False,
            encoding_errors="replace",
        )
    except (ValueError, OverflowError) as error:
        raise ReadError(_bad_cell(text, body, columns, path)) from error
    return table.to_numpy()


def _bad_cell(text: bytes, body: Body, columns: Sequence[int], path: Path) -> str:
    """Word the error for the first cell that is no number: the slow way, once it is needed."""
    lines = io.StringIO(text.decode("utf-8", errors="replace"))
    with reading(path, "lines of numbers parted by commas"):
        for number, cells in enumerate(csv.reader(lines), start=body.first_line):
            for column in columns:
                cell = cells[column].strip() if column < len(cells) else ""
                if not _is_number(cell):
                    place = f"line {number}, cell {column + 1}"
                    found = f"'{cell[:40]}'"
                    return complaint(
                        path, place, expected="a number or a blank", found=found, remedy=_AGAIN
                    )
    place = f"from line {body.first_line} on"
    return complaint(
        path, place, expected="lines of numbers parted by commas", found="others", remedy=_AGAIN
    )


def _is_number(cell: str) -> bool:
    try:
        float(cell or "nan")
    except ValueError:
        return False
    return True


def _filled(numbers: Floats) -> int:
    """Number of rows up to the last one that holds anything: spreadsheets append blank lines."""
    filled = len(numbers)
    while filled and np.isnan(numbers[filled - 1]).all():
        filled -= 1
    return filled
