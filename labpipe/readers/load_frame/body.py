"""Rows of numbers of a text export: read fast by a library, every loss noticed."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from labpipe.errors import ReadError, complaint
from labpipe.readers.load_frame.content import is_blank
from labpipe.readers.load_frame.header import is_number, split_line
from labpipe.records.arrays import Floats, Ints
from labpipe.records.quality import QualityNote, Severity

_HEAD = 20000
"""Bytes in which the decimal sign is looked for."""
_WORTH = 4_000_000
"""Bytes from which on pandas reads faster from the file than from memory."""

_AGAIN = "Export the test again; the file may have been cut off or edited."
_REGROUPED = re.compile(r"[+-]?\d{1,3}(,\d{3}){2,}|[+-]?\d{1,3}(\.\d{3}){2,}")
_LOST = (
    "A spreadsheet took the decimal sign for a sign between thousands and the digits are lost:"
    " export the test again and do not save it from a spreadsheet."
)
_SIGN = {".": "a decimal point", ",": "a decimal comma"}
_PLAIN = {sign: re.compile(rf"[+-]?(\d+(\{sign}\d*)?|\{sign}\d+)([eE][+-]?\d+)?") for sign in _SIGN}


@dataclass(frozen=True, slots=True)
class Body:
    """The rows of samples of a text export.

    Parameters
    ----------
    data : bytes of the export, below 128 as in ASCII
    names : of the columns, for messages
    columns : numbers of the columns that hold numbers, ascending
    first_line : line number of the first row
    start : where in `data` the first row begins
    as_in_file : whether the file holds just these bytes (but for a byte order mark)
    some_only : whether the other columns hold numbers too, but nobody asked for them
    separator : between cells, a blank for any number of blanks
    decimal : decimal sign, or ``auto``
    """

    data: bytes
    names: Sequence[str]
    columns: Sequence[int]
    first_line: int
    separator: str
    decimal: str = "auto"
    start: int = 0
    as_in_file: bool = False
    some_only: bool = False


@dataclass(frozen=True, slots=True)
class _Shape:
    body: Body
    end: int
    decimal: str
    width: int

    @property
    def data(self) -> bytes:
        return self.body.data[self.body.start : self.end]

    @property
    def mark(self) -> bytes:
        return self.body.separator.encode()


def read_columns(body: Body, path: Path) -> tuple[dict[int, Floats], list[QualityNote]]:
    """Read columns of numbers; a blank cell is NaN.

    Parameters
    ----------
    body : the rows
    path : named in errors

    Returns
    -------
    columns : by their number, all of shape (rows,); infinities stay
    notes : ``truncated`` (an incomplete last line was left out), ``lines_short`` (what a line
        lacks counts as blank)

    Raises
    ------
    ReadError
        If a cell is no number with the decimal sign of the others, or a line has more cells than
        there are names.
    """
    end, notes = _whole_lines(body)
    head = body.data[body.start : min(end, body.start + _HEAD)]
    if not head.strip() and is_blank(body.data[body.start : end]):
        return {column: np.empty(0) for column in body.columns}, notes
    decimal = _decimal_sign(body, head) if body.decimal == "auto" else body.decimal
    first = split_line(head[: head.find(b"\n") + 1 or None].decode("latin-1"), body.separator)
    shape = _Shape(body, end, decimal, max(len(body.names), len(first)))
    parsed = _parsed(shape, path)
    columns = {column: parsed[column] for column in body.columns}
    rows = _filled(columns)
    if any(np.isnan(values).any() for values in columns.values()):  # else no line can be short
        notes += _short_lines(shape, rows)
    return {column: columns[column][:rows] for column in body.columns}, notes


def _parsed(shape: _Shape, path: Path) -> dict[int, Floats]:
    body = shape.body
    extra = range(len(body.names), shape.width)  # blank cells behind the last separator
    wanted = [*body.columns, *extra]
    try:
        table = _straight(shape, path) if _can_read_straight(shape) else None
    except (ValueError, OverflowError):  # perhaps in a column that nobody asked for
        table = None
    try:
        columns = _from_memory(shape, wanted) if table is None else table
    except (ValueError, OverflowError) as error:
        raise ReadError(_first_fault(shape, path)) from error
    if any(not np.isnan(columns[column]).all() for column in extra):
        raise ReadError(_first_fault(shape, path))
    return columns


def _from_memory(shape: _Shape, wanted: list[int]) -> dict[int, Floats]:
    """Read the rows, and refuse those with more cells: pandas leaves out what nobody asked for."""
    data = shape.data
    starts, counts = _separators(shape, data)
    for i in np.flatnonzero(counts >= shape.width):
        line = data[starts[i] : starts[i + 1]].decode("utf-8", errors="replace")
        if any(cell.strip() for cell in split_line(line, shape.body.separator)[shape.width :]):
            message = "a line has more cells than the first one"
            raise ValueError(message)
    return _table(shape, io.BytesIO(data), 0, wanted)


def _straight(shape: _Shape, path: Path) -> dict[int, Floats]:
    return _table(shape, path, shape.body.first_line - 1, None)


def _table(
    shape: _Shape, source: Path | io.BytesIO, skip: int, wanted: list[int] | None
) -> dict[int, Floats]:
    import pandas as pd

    table = pd.read_csv(
        source,
        skiprows=skip,
        sep=r"\s+" if shape.body.separator == " " else shape.body.separator,
        decimal=shape.decimal,
        header=None,
        names=list(range(shape.width)),
        usecols=wanted,
        dtype=np.float64,
        na_values=[""],
        keep_default_na=False,
        skip_blank_lines=False,
        skipinitialspace=True,
        encoding_errors="replace",
    )
    read = range(shape.width) if wanted is None else wanted
    return {column: table[column].to_numpy() for column in read}


def _can_read_straight(shape: _Shape) -> bool:
    """Tell whether pandas may read the file itself, which it does on several cores.

    Not if some column holds words, the last line was left out, or quotes above the samples could
    keep pandas from counting lines as we do. Small files gain nothing.
    """
    body = shape.body
    is_whole = not body.data[shape.end :].strip()
    known = len(body.columns) == len(body.names) or body.some_only
    worth = shape.end - body.start > _WORTH
    return body.as_in_file and is_whole and known and worth and not _odd_quotes(body)


def _odd_quotes(body: Body) -> bool:
    above = body.data[: body.start].split(b"\n")
    return any(line.count(b'"') % 2 for line in above)


def _filled(columns: dict[int, Floats]) -> int:
    """Number of rows up to the last one that holds anything."""
    rows = max((len(values) for values in columns.values()), default=0)
    while rows and all(np.isnan(values[rows - 1]) for values in columns.values()):
        rows -= 1
    return rows


def _decimal_sign(body: Body, data: bytes) -> str:
    """Decimal sign of the first cells that have one; a point if none has."""
    lines = data.decode("latin-1").split("\n")
    for line in lines[:-1] or lines:
        for cell in _cells(split_line(line, body.separator), body.columns):
            for sign in _SIGN:
                if sign in cell and _PLAIN[sign].fullmatch(cell):
                    return sign
    return "."


def _cells(row: Sequence[str], columns: Sequence[int]) -> Iterator[str]:
    return (row[column].strip() for column in columns if column < len(row))


def _whole_lines(body: Body) -> tuple[int, list[QualityNote]]:
    """Where the last whole line ends: one that stops in the middle is left out.

    A last line without line end is whole if it has all its cells and its last number has as many
    decimals, or as many digits in all, as the one above it.
    """
    data, start = body.data, body.start
    end = max(data.rfind(b"\n", start) + 1, start)
    last = data[end:].decode("latin-1")
    if not last.strip("\r\0\x1a "):
        return end, []
    above = data[max(data.rfind(b"\n", start, max(end - 1, start)) + 1, start) : end]
    cells = split_line(last, body.separator)
    if _is_whole(cells, split_line(above.decode("latin-1"), body.separator), body):
        return len(data), []
    line = body.first_line + data.count(b"\n", start)
    message = f"the last line ({line}) is incomplete and was left out"
    return end, [QualityNote("truncated", Severity.WARNING, "file", message)]


def _is_whole(last: Sequence[str], above: Sequence[str], body: Body) -> bool:
    if len(last) < len(body.names) or not any(cell.strip() for cell in last):
        return False
    if len(last) > len(body.names) or not above:  # it ends behind its last separator
        return True
    cut, full = last[-1].strip(), above[-1].strip()
    if not all(is_number(cell) for cell in _cells(last, body.columns) if cell):
        return False
    return _decimals(cut) >= _decimals(full) or _digits(cut) >= _digits(full)


def _decimals(cell: str) -> int:
    return len(re.split(r"[.,]", re.split("[eE]", cell)[0])[-1]) if re.search("[.,]", cell) else 0


def _digits(cell: str) -> int:
    return len(re.sub(r"\D", "", re.split("[eE]", cell)[0]).lstrip("0"))


def _short_lines(shape: _Shape, rows: int) -> list[QualityNote]:
    """Lines with fewer cells than names; those behind the last filled row do not count."""
    data = shape.data
    starts, counts = _separators(shape, data)
    short = [int(i) for i in np.flatnonzero(counts[:rows] < len(shape.body.names) - 1)]
    short = [i for i in short if data[starts[i] : starts[i + 1]].strip()]
    if not short:
        return []
    message = (
        f"{len(short)} lines have too few cells, first line {shape.body.first_line + short[0]}:"
    )
    message += " what they lack counts as blank"
    return [QualityNote("lines_short", Severity.WARNING, "file", message)]


def _separators(shape: _Shape, data: bytes) -> tuple[Ints, Ints]:
    """Where each line starts (and the last one ends), and how many separators each line has."""
    letters = np.frombuffer(data, dtype=np.uint8)
    ends = np.append(np.flatnonzero(letters == ord("\n")) + 1, len(letters)).astype(np.int64)
    starts = np.concatenate(([0], ends))
    if shape.body.separator == " ":
        lines = (data[a:b] for a, b in pairwise(starts.tolist()))
        return starts, np.array([len(line.split()) - 1 for line in lines])
    before = np.searchsorted(np.flatnonzero(letters == shape.mark[0]), ends)
    return starts, np.diff(before, prepend=0)


def _first_fault(shape: _Shape, path: Path) -> str:
    """Word the error for the first cell that is no number: the slow way, once it is needed."""
    body = shape.body
    for number, row in enumerate(_rows(shape), start=body.first_line):
        if any(cell.strip() for cell in row[len(body.names) :]):
            expected = f"{len(body.names)} cells as in the header"
            return complaint(
                path, f"line {number}", expected=expected, found=f"{len(row)}", remedy=_AGAIN
            )
        for column in body.columns:
            cell = row[column].strip() if column < len(row) else ""
            if cell and not _PLAIN[shape.decimal].fullmatch(cell):
                return _bad_cell(shape, cell, column, number, path)
    place = f"from line {body.first_line} on"
    return complaint(path, place, expected="rows of numbers", found="others", remedy=_AGAIN)


def _bad_cell(shape: _Shape, cell: str, column: int, line: int, path: Path) -> str:
    other = "," if shape.decimal == "." else "."
    expected, found, remedy = f"a number with {_SIGN[shape.decimal]}", f"'{cell[:40]}'", _AGAIN
    grouped = _regrouped(shape, column)
    if grouped is not None and not re.search("[^-+0-9.,]", cell):
        found += f" (and '{grouped[1]}' in line {grouped[0]})" if grouped[1] != cell else ""
        remedy = _LOST
    elif _PLAIN[other].fullmatch(cell):
        found += f", with {_SIGN[other]}"
        remedy = "Both signs stand in this file: export the test again with one of them."
    place = f"line {line}, column '{shape.body.names[column]}'"
    return complaint(path, place, expected=expected, found=found, remedy=remedy)


def _regrouped(shape: _Shape, column: int) -> tuple[int, str] | None:
    """Line and text of the first cell of a column with two signs between thousands."""
    for number, row in enumerate(_rows(shape), start=shape.body.first_line):
        cell = row[column].strip() if column < len(row) else ""
        if _REGROUPED.fullmatch(cell):
            return number, cell
    return None


def _rows(shape: _Shape) -> Iterator[list[str]]:
    lines = shape.data.decode("utf-8", errors="replace").split("\n")
    return (split_line(line, shape.body.separator) for line in lines)
