"""Rows of numbers of a text export: read fast by a library, every loss noticed."""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from labpipe.errors import ReadError
from labpipe.readers.bad_cells import first_fault, jump_fault
from labpipe.readers.cells import split_line
from labpipe.readers.content import is_blank
from labpipe.readers.last_line import whole_lines
from labpipe.readers.regrouped import regrouped_at
from labpipe.readers.rows import PLAIN, SIGNS, Body, Shape, chosen_cells
from labpipe.records.arrays import Floats
from labpipe.records.quality import QualityNote, Severity

_HEAD = 20000
"""Bytes in which the decimal sign is looked for."""
_NAN_WORDS = ("NAN", "NaN", "nan")
_WORTH = 4_000_000
"""Bytes from which on pandas reads faster from the file than from memory."""


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
        table = _straight(shape, path) if _can_read_straight(shape) else None
    except (ValueError, OverflowError):  # perhaps in a column that nobody asked for
        table = None
    try:
        columns = _from_memory(shape, wanted) if table is None else table
    except (ValueError, OverflowError) as error:
        raise ReadError(first_fault(shape, path)) from error
    if any(not np.isnan(columns[column]).all() for column in extra):
        raise ReadError(first_fault(shape, path))
    return columns


def _from_memory(shape: Shape, wanted: list[int]) -> dict[int, Floats]:
    """Read the rows, and refuse those with more cells: pandas leaves out what nobody asked for."""
    data = shape.data
    starts, counts = shape.separators()
    for i in np.flatnonzero(counts >= shape.width):
        line = data[starts[i] : starts[i + 1]].decode("utf-8", errors="replace")
        if any(cell.strip() for cell in split_line(line, shape.body.separator)[shape.width :]):
            message = "a line has more cells than the first one"
            raise ValueError(message)
    return _table(shape, io.BytesIO(data), 0, wanted)


def _straight(shape: Shape, path: Path) -> dict[int, Floats]:
    return _table(shape, path, shape.body.first_line - 1, None)


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
        skipinitialspace=True,
        encoding_errors="replace",
    )
    read = range(shape.width) if wanted is None else wanted
    return {column: table[column].to_numpy() for column in read}


def _can_read_straight(shape: Shape) -> bool:
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
    starts, counts = shape.separators()
    short = [int(i) for i in np.flatnonzero(counts[:rows] < len(shape.body.names) - 1)]
    short = [i for i in short if data[starts[i] : starts[i + 1]].strip()]
    if not short:
        return []
    message = (
        f"{len(short)} lines have too few cells, first line {shape.body.first_line + short[0]}:"
    )
    message += " what they lack counts as blank"
    return [QualityNote("lines_short", Severity.WARNING, "file", message)]
