"""Rows of numbers of a text export: read fast by a library, every loss noticed and placed."""

from __future__ import annotations

import io
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from labpipe.errors import ReadError, error_text
from labpipe.readers.raw_files import is_blank
from labpipe.readers.table_body import (
    Body,
    Shape,
    chosen_cells,
    whole_lines,
    without_closing,
    words_shown,
)
from labpipe.readers.text_cells import (
    AGAIN,
    INFINITE,
    LOST,
    PLAIN,
    SIGNS,
    describe_cell,
    is_grouped,
    is_missing,
    lost_signs,
    quoted,
    split_line,
    thousandfold_jump,
)
from labpipe.records.arrays import Floats
from labpipe.records.quality import QualityNote, Severity

if TYPE_CHECKING:
    import pandas as pd

_HEAD = 20000
"""Bytes in which the decimal sign is looked for."""
_NAN_WORDS = ("NAN", "NaN", "nan")
_WORTH = 4_000_000
"""Bytes from which on pandas reads faster from the file than from memory."""
_COMMAS = (
    "If commas stand in the numbers, too, export the test again with decimal points, or with"
    " semicolons or tabs between the cells; if not, the file may have been edited."
)
_SHOWN = 40


def read_columns(body: Body, path: Path) -> tuple[dict[int, Floats], list[QualityNote]]:
    """Read columns of numbers; a blank cell is NaN, as is a word for a missing value.

    Parameters
    ----------
    body : the rows
    path : named in errors

    Returns
    -------
    columns : by their number, all of shape (rows,)
    notes : ``summary_rows_left_out`` (rows at the end that begin with words), ``truncated`` (an
        incomplete last line was left out), ``missing_words`` (words that count as missing, by
        column), ``lines_short`` (what a line lacks counts as blank), ``rows_differ`` (from the
        number that the header states)

    Raises
    ------
    ReadError
        If a cell is no number with the decimal sign of the others or too large a one, a line has
        more cells than there are names, or a column lost its decimal signs.
    """
    body, closing = without_closing(body)
    end, notes = whole_lines(body)
    notes = [*closing, *notes]
    head = body.data[body.start : min(end, body.start + _HEAD)]
    if not head.strip() and is_blank(body.data[body.start : end]):
        return {column: np.empty(0) for column in body.columns}, notes + rows_note(
            body.stated_rows, 0
        )
    decimal = _decimal_sign(body, head) if body.decimal == "auto" else body.decimal
    first = split_line(head[: head.find(b"\n") + 1 or None].decode("latin-1"), body.separator)
    shape = Shape(body, end, decimal, max(len(body.names), len(first)))
    parsed, words = _parsed(shape, path)
    notes += words
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
        rows = thousandfold_jump(values)
        message = None if rows is None else jump_fault(shape, column, rows, path)
        if message is not None:
            raise ReadError(message)


def words_note(column: str, words: Mapping[str, int], place: str) -> QualityNote:
    """Note the words in a column of numbers that count as missing.

    Parameters
    ----------
    column : its name
    words : how many cells hold which word
    place : of the first one
    """
    count = sum(words.values())
    held = words_shown(list(words))
    message = f"{count} cells hold {held}, the first in {place}: they count as missing"
    return QualityNote("missing_words", Severity.INFO, column, message)


def _parsed(shape: Shape, path: Path) -> tuple[dict[int, Floats], list[QualityNote]]:
    body = shape.body
    extra = range(len(body.names), shape.width)  # blank cells behind the last separator
    wanted = [*body.columns, *extra]
    if _can_read_straight(shape):
        with suppress(ValueError, OverflowError):  # perhaps in a column that is not asked for
            return _numbers(_table(shape, path, body.first_line - 1, None)), []
    try:
        columns, notes = _from_memory(shape, wanted)
    except (ValueError, OverflowError) as error:
        raise ReadError(first_fault(shape, path)) from error
    if any(not np.isnan(columns[column]).all() for column in extra):
        raise ReadError(first_fault(shape, path))
    return columns, notes


def _from_memory(shape: Shape, wanted: list[int]) -> tuple[dict[int, Floats], list[QualityNote]]:
    """Read the rows, and refuse those with more cells: pandas leaves out the others."""
    data = shape.data
    starts, counts = shape.separators
    for i in np.flatnonzero(counts >= shape.width):
        line = str(data[starts[i] : starts[i + 1]], "utf-8", errors="replace")
        if any(cell.strip() for cell in split_line(line, shape.body.separator)[shape.width :]):
            message = "a line has more cells than the first one"
            raise ValueError(message)
    try:
        return _numbers(_table(shape, io.BytesIO(data), 0, wanted)), []
    except (ValueError, OverflowError):
        words, notes = _missing_words(shape)
        if not words:
            raise
        return _numbers(_table(shape, io.BytesIO(data), 0, wanted, words)), notes


def _missing_words(shape: Shape) -> tuple[list[str], list[QualityNote]]:
    """Find the words for missing values in the columns, as they are written there."""
    body = shape.body
    texts = _table(shape, io.BytesIO(shape.data), 0, list(body.columns), None)
    found, notes = list[str](), []
    for column in body.columns:
        counts = texts[column].value_counts()
        words = {str(word): int(counts[word]) for word in counts.index if is_missing(str(word))}
        if words:
            first = body.first_line + int(np.flatnonzero(texts[column].isin(list(words)))[0])
            found += words
            notes.append(words_note(body.names[column], words, f"line {first}"))
    return found, notes


def _numbers(table: pd.DataFrame) -> dict[int, Floats]:
    return {int(column): table[column].to_numpy() for column in table.columns}


def _table(
    shape: Shape,
    source: Path | io.BytesIO,
    skip: int,
    wanted: list[int] | None,
    words: Sequence[str] | None = (),
) -> pd.DataFrame:
    """Read cells as numbers, with these words for missing values; as text if they are None."""
    import pandas as pd

    return pd.read_csv(
        source,
        skiprows=skip,
        sep=r"\s+" if shape.body.separator == " " else shape.body.separator,
        decimal=shape.decimal,
        header=None,
        names=list(range(shape.width)),
        usecols=wanted,
        dtype=str if words is None else np.float64,
        na_values=["", *(words or ()), *(_NAN_WORDS if shape.body.as_exported else ())],
        keep_default_na=False,
        skip_blank_lines=False,
        skipinitialspace=not shape.body.as_exported,
        encoding_errors="replace",
    )


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
            return _too_many(row, body, number, path)
        for column in body.columns:
            cell = row[column].strip() if column < len(row) else ""
            if cell and not _is_finite(cell, shape):
                return _bad_cell(shape, cell, column, number, path)
    place = f"from line {body.first_line} on"
    return error_text(path, place, expected="rows of numbers", found="others", remedy=AGAIN)


def _too_many(row: Sequence[str], body: Body, line: int, path: Path) -> str:
    """Word the error for a line with more cells than names: decimal commas may have cut it."""
    found, remedy = f"{len(row)}", AGAIN
    if body.separator == "," and all(cell.strip("+-").isdigit() for cell in row if cell):
        found += f" in '{','.join(row)[:_SHOWN]}'"
        remedy = _COMMAS
    expected = f"{len(body.names)} cells as in the header"
    return error_text(path, f"line {line}", expected=expected, found=found, remedy=remedy)


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
        is_infinite = cell.strip("+-").casefold() in INFINITE
        return is_missing(cell) or (shape.body.as_exported and is_infinite)
    return bool(np.isfinite(float(cell.replace(shape.decimal, "."))))


def _bad_cell(shape: Shape, cell: str, column: int, line: int, path: Path) -> str:
    expected, found, remedy = describe_cell(cell, shape.decimal)
    grouped = _regrouped(shape, column)
    if grouped is not None and not re.search("[^-+0-9.,]", cell):
        found = quoted([cell])
        found += f" (and '{grouped[1]}' in line {grouped[0]})" if grouped[1] != cell else ""
        remedy = LOST
    place = f"line {line}, column '{shape.body.names[column]}'"
    return error_text(path, place, expected=expected, found=found, remedy=remedy)


def _regrouped(shape: Shape, column: int) -> tuple[int, str] | None:
    """Line and text of the first cell of a column with two signs between thousands."""
    for number, row in enumerate(shape.rows(), start=shape.body.first_line):
        cell = row[column].strip() if column < len(row) else ""
        if is_grouped(cell):
            return number, cell
    return None
