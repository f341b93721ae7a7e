"""Rows of numbers of a text export: read fast by a library, every loss noticed and placed."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path

import numpy as np

from labpipe.errors import ReadError, complaint
from labpipe.readers.raw_files import is_blank
from labpipe.readers.text_cells import (
    LOST,
    is_grouped,
    is_number,
    lost_signs,
    regrouped_at,
    split_line,
)
from labpipe.records.arrays import Floats, Ints
from labpipe.records.quality import QualityNote, Severity

SIGNS = {".": "a decimal point", ",": "a decimal comma"}
PLAIN = {sign: re.compile(rf"[+-]?(\d+(\{sign}\d*)?|\{sign}\d+)([eE][+-]?\d+)?") for sign in SIGNS}
"""A number by its decimal sign."""
_HEAD = 20000
"""Bytes in which the decimal sign is looked for."""
_NAN_WORDS = ("NAN", "NaN", "nan")
_WORTH = 4_000_000
"""Bytes from which on pandas reads faster from the file than from memory."""
_COMPARED = 200
"""Lines above the last one in which a number as short as its last one is looked for."""
_AGAIN = "Export the test again; the file may have been cut off or edited."
_SHOWN = 40
_WORDS_FOR_NUMBERS = frozenset({"nan", "inf", "infinity"})


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
    some_only : whether the other columns hold numbers too, but are not asked for
    separator : between cells, a blank for any number of blanks
    decimal : decimal sign, or ``auto``
    stated_rows : number of rows that the header promises, None if it does not
    as_exported : whether it is as a program writes it that records, not saved from a spreadsheet:
        NAN and Infinity are numbers, columns may hold any code, no number lacks its last zeros
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
    stated_rows: int | None = None
    as_exported: bool = False


@dataclass(frozen=True)
class Shape:
    """A body whose extent is known.

    Parameters
    ----------
    body : the rows
    end : where in the data of the body the last whole row ends
    decimal : decimal sign
    width : number of cells of a row, at least as many as names
    """

    body: Body
    end: int
    decimal: str
    width: int

    @property
    def data(self) -> memoryview:
        """The bytes of the whole rows, not copied."""
        return memoryview(self.body.data)[self.body.start : self.end]

    def rows(self) -> Iterator[list[str]]:
        """Give the cells of each row."""
        lines = str(self.data, "utf-8", errors="replace").split("\n")
        return (split_line(line, self.body.separator) for line in lines)

    @cached_property
    def separators(self) -> tuple[Ints, Ints]:
        """Where lines start, and how many separators they have.

        Returns
        -------
        starts : where each line starts, and the last one ends, shape (lines + 1,)
        counts : how many separators each line has, shape (lines,)
        """
        data = self.data
        letters = np.frombuffer(data, dtype=np.uint8)
        ends = np.append(np.flatnonzero(letters == ord("\n")) + 1, len(letters)).astype(np.int64)
        starts = np.concatenate(([0], ends))
        if self.body.separator == " ":
            lines = (bytes(data[a:b]) for a, b in pairwise(starts.tolist()))
            return starts, np.array([len(line.split()) - 1 for line in lines])
        before = np.searchsorted(np.flatnonzero(letters == ord(self.body.separator)), ends)
        return starts, np.diff(before, prepend=0)


def chosen_cells(row: Sequence[str], columns: Sequence[int]) -> Iterator[str]:
    """Give the cells of some columns, as far as the row has them."""
    return (row[column].strip() for column in columns if column < len(row))


def read_columns(body: Body, path: Path) -> tuple[dict[int, Floats], list[QualityNote]]:
    """Read columns of numbers; a blank cell is NaN.

    Parameters
    ----------
    body : the rows
    path : named in errors

    Returns
    -------
    columns : by their number, all of shape (rows,)
    notes : ``truncated`` (an incomplete last line was left out), ``lines_short`` (what a line
        lacks counts as blank), ``rows_differ`` (from the number that the header states)

    Raises
    ------
    ReadError
        If a cell is no number with the decimal sign of the others or too large a one, a line has
        more cells than there are names, or a column lost its decimal signs.
    """
    end, notes = whole_lines(body)
    head = body.data[body.start : min(end, body.start + _HEAD)]
    if not head.strip() and is_blank(body.data[body.start : end]):
        return {column: np.empty(0) for column in body.columns}, notes + rows_note(
            body.stated_rows, 0
        )
    decimal = _decimal_sign(body, head) if body.decimal == "auto" else body.decimal
    first = split_line(head[: head.find(b"\n") + 1 or None].decode("latin-1"), body.separator)
    shape = Shape(body, end, decimal, max(len(body.names), len(first)))
    parsed = _parsed(shape, path)
    columns = {column: parsed[column] for column in body.columns}
    rows = filled_rows(columns)
    if not all(np.isfinite(values).all() for values in columns.values()):
        infinite = any(np.isinf(values).any() for values in columns.values())
        if infinite and not body.as_exported:
            raise ReadError(first_fault(shape, path))
        notes += _short_lines(shape, rows)  # where all cells are numbers, no line can be short
    if not body.as_exported:
        _refuse_lost_signs(shape, columns, path)
    notes += rows_note(body.stated_rows, rows)
    return {column: columns[column][:rows] for column in body.columns}, notes


def rows_note(stated: int | None, held: int) -> list[QualityNote]:
    """Note that a file holds another number of rows than its header states; if it states one."""
    if stated in {None, held}:
        return []
    message = f"the header states {stated} rows, the file holds {held}"
    return [QualityNote("rows_differ", Severity.WARNING, "file", message)]


def _refuse_lost_signs(shape: Shape, columns: Mapping[int, Floats], path: Path) -> None:
    for column, values in columns.items():
        rows = regrouped_at(values)
        message = None if rows is None else jump_fault(shape, column, rows, path)
        if message is not None:
            raise ReadError(message)


def _parsed(shape: Shape, path: Path) -> dict[int, Floats]:
    body = shape.body
    extra = range(len(body.names), shape.width)  # blank cells behind the last separator
    wanted = [*body.columns, *extra]
    try:
        table = (
            _table(shape, path, shape.body.first_line - 1, None)
            if _can_read_straight(shape)
            else None
        )
    except (ValueError, OverflowError):  # perhaps in a column that is not asked for
        table = None
    try:
        columns = _from_memory(shape, wanted) if table is None else table
    except (ValueError, OverflowError) as error:
        raise ReadError(first_fault(shape, path)) from error
    if any(not np.isnan(columns[column]).all() for column in extra):
        raise ReadError(first_fault(shape, path))
    return columns


def _from_memory(shape: Shape, wanted: list[int]) -> dict[int, Floats]:
    """Read the rows, and refuse those with more cells: pandas leaves out the others."""
    data = shape.data
    starts, counts = shape.separators
    for i in np.flatnonzero(counts >= shape.width):
        line = str(data[starts[i] : starts[i + 1]], "utf-8", errors="replace")
        if any(cell.strip() for cell in split_line(line, shape.body.separator)[shape.width :]):
            message = "a line has more cells than the first one"
            raise ValueError(message)
    return _table(shape, io.BytesIO(data), 0, wanted)


def _table(
    shape: Shape, source: Path | io.BytesIO, skip: int, wanted: list[int] | None
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
        na_values=["", *_NAN_WORDS] if shape.body.as_exported else [""],
        keep_default_na=False,
        skip_blank_lines=False,
        skipinitialspace=not shape.body.as_exported,
        encoding_errors="replace",
    )
    read = range(shape.width) if wanted is None else wanted
    return {column: table[column].to_numpy() for column in read}


def _can_read_straight(shape: Shape) -> bool:
    """Check whether pandas may read the file itself, which it does on several cores.

    Not if some column holds words, the last line was left out, or quotes above the samples could
    keep pandas from counting lines as we do. Small files gain nothing.
    """
    body = shape.body
    is_whole = not body.data[shape.end :].strip()
    known = len(body.columns) == len(body.names) or body.some_only
    worth = shape.end - body.start > _WORTH
    if not (body.as_in_file and is_whole and known and worth):
        return False
    return not any(line.count(b'"') % 2 for line in body.data[: body.start].split(b"\n"))


def filled_rows(columns: Mapping[int, Floats]) -> int:
    """Number of rows up to the last one that holds anything."""
    rows = max((len(values) for values in columns.values()), default=0)
    while rows and all(np.isnan(values[rows - 1]) for values in columns.values()):
        rows -= 1
    return rows


def _decimal_sign(body: Body, data: bytes) -> str:
    """Decimal sign of the first cells that have one; a point if none has."""
    lines = data.decode("latin-1").split("\n")
    for line in lines[:-1] or lines:
        for cell in chosen_cells(split_line(line, body.separator), body.columns):
            for sign in SIGNS:
                if sign in cell and PLAIN[sign].fullmatch(cell):
                    return sign
    return "."


def _short_lines(shape: Shape, rows: int) -> list[QualityNote]:
    """Lines with fewer cells than names; those behind the last filled row do not count."""
    data = shape.data
    starts, counts = shape.separators
    short = [int(i) for i in np.flatnonzero(counts[:rows] < len(shape.body.names) - 1)]
    short = [i for i in short if bytes(data[starts[i] : starts[i + 1]]).strip()]
    if not short:
        return []
    message = (
        f"{len(short)} lines have too few cells, first line {shape.body.first_line + short[0]}:"
    )
    message += " what they lack counts as blank"
    return [QualityNote("lines_short", Severity.WARNING, "file", message)]


def whole_lines(body: Body) -> tuple[int, list[QualityNote]]:
    """Find where the last whole line ends: one that stops in the middle is left out.

    A last line without line end is whole if it has all its cells, and its last number has as many
    decimals, or as many digits in all, as the one above it, and as long an exponent. Where zeros at
    the end of numbers are not written, it is whole if some line above has a last number with no
    more of all three. None is whole where the header promises more rows.

    Parameters
    ----------
    body : the rows

    Returns
    -------
    end : where in the data of the body
    notes : ``truncated`` if a line was left out
    """
    data, start = body.data, body.start
    end = max(data.rfind(b"\n", start) + 1, start)
    last = data[end:].decode("latin-1")
    if not last.strip("\r\0\x1a "):
        return end, []
    cells, rows = split_line(last, body.separator), data.count(b"\n", start)
    is_promised = rows + 1 >= (body.stated_rows or 0)
    if is_promised and _is_whole(cells, _last_numbers(body, end), body):
        return len(data), []
    line = body.first_line + rows
    message = f"the last line ({line}) is incomplete and was left out"
    return end, [QualityNote("truncated", Severity.WARNING, "file", message)]


def _last_numbers(body: Body, end: int) -> list[str]:
    """The last cells of the lines above the last one, the nearest first."""
    lines = body.data[body.start : end].rsplit(b"\n", _COMPARED + 1)
    near = lines[max(len(lines) - 1 - _COMPARED, 0) : -1]
    rows = (split_line(line.decode("latin-1"), body.separator) for line in reversed(near))
    return [row[-1].strip() for row in rows if row]


def _is_whole(last: Sequence[str], above: Sequence[str], body: Body) -> bool:
    if len(last) < len(body.names) or not any(cell.strip() for cell in last):
        return False
    if len(last) > len(body.names) or not above:  # it ends behind its last separator
        return True
    if not all(is_number(cell) for cell in chosen_cells(last, body.columns) if cell):
        return False
    cut = last[-1].strip()
    decimals, digits, exponent = _lengths(cut)
    its_decimals, its_digits, its_exponent = _lengths(above[0])
    by_digits = digits >= its_digits and not body.as_exported
    is_as_long = exponent >= its_exponent and (decimals >= its_decimals or by_digits)
    if is_as_long or body.as_exported:
        return is_as_long
    return cut[-1:].isdigit() and any(_is_as_short(cell, cut) for cell in above if cell)


def _is_as_short(cell: str, cut: str) -> bool:
    return all(a <= b for a, b in zip(_lengths(cell), _lengths(cut), strict=True))


def _lengths(cell: str) -> tuple[int, int, int]:
    """Number of decimals, of digits but for zeros in front, and of digits of the exponent."""
    number, _, exponent = cell.casefold().partition("e")
    parts = re.split(r"[.,]", number)
    decimals = len(parts[-1]) if len(parts) > 1 else 0
    return decimals, len(re.sub(r"\D", "", number).lstrip("0")), len(exponent.lstrip("+-"))


def first_fault(shape: Shape, path: Path) -> str:
    """Word the error for the first cell that is no number, or line with too many cells.

    Parameters
    ----------
    shape : the rows
    path : named in the message

    Returns
    -------
    The message.
    """
    body = shape.body
    for number, row in enumerate(shape.rows(), start=body.first_line):
        if any(cell.strip() for cell in row[len(body.names) :]):
            expected = f"{len(body.names)} cells as in the header"
            return complaint(
                path, f"line {number}", expected=expected, found=f"{len(row)}", remedy=_AGAIN
            )
        for column in body.columns:
            cell = row[column].strip() if column < len(row) else ""
            if cell and not _is_finite(cell, shape):
                return _bad_cell(shape, cell, column, number, path)
    place = f"from line {body.first_line} on"
    return complaint(path, place, expected="rows of numbers", found="others", remedy=_AGAIN)


def jump_fault(shape: Shape, column: int, rows: tuple[int, int], path: Path) -> str | None:
    """Word the error for a column of whole numbers that jumps a thousandfold and back.

    Parameters
    ----------
    shape : the rows
    column : its number
    rows : numbers of those before and behind a jump, counted from 0
    path : named in the message

    Returns
    -------
    The message; None if the numbers are written with a decimal sign or an exponent after all.
    """
    before, after = (row[column].strip() for i, row in enumerate(shape.rows()) if i in rows)
    if not all(re.fullmatch(r"[+-]?\d+", cell) for cell in (before, after)):
        return None
    place = f"line {shape.body.first_line + rows[1]}, column '{shape.body.names[column]}'"
    return lost_signs(path, place, before, after)


def _is_finite(cell: str, shape: Shape) -> bool:
    if PLAIN[shape.decimal].fullmatch(cell) is None:
        return shape.body.as_exported and cell.strip("+-").casefold() in _WORDS_FOR_NUMBERS
    return bool(np.isfinite(float(cell.replace(shape.decimal, "."))))


def _bad_cell(shape: Shape, cell: str, column: int, line: int, path: Path) -> str:
    other = "," if shape.decimal == "." else "."
    expected, found = f"a number with {SIGNS[shape.decimal]}", f"'{cell[:_SHOWN]}'"
    remedy = _AGAIN
    grouped = _regrouped(shape, column)
    if grouped is not None and not re.search("[^-+0-9.,]", cell):
        found += f" (and '{grouped[1]}' in line {grouped[0]})" if grouped[1] != cell else ""
        remedy = LOST
    elif PLAIN[shape.decimal].fullmatch(cell):
        expected, found = "a number below 1.8e308", f"'{cell[:_SHOWN]}', which is too large"
    elif PLAIN[other].fullmatch(cell):
        found += f", with {SIGNS[other]}"
        remedy = "Both signs stand in this file: export the test again with one of them."
    place = f"line {line}, column '{shape.body.names[column]}'"
    return complaint(path, place, expected=expected, found=found, remedy=remedy)


def _regrouped(shape: Shape, column: int) -> tuple[int, str] | None:
    """Line and text of the first cell of a column with two signs between thousands."""
    for number, row in enumerate(shape.rows(), start=shape.body.first_line):
        cell = row[column].strip() if column < len(row) else ""
        if is_grouped(cell):
            return number, cell
    return None
