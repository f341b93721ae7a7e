"""Rows of numbers of a text export, parsed by pandas; all losses are reported."""

from __future__ import annotations

import io
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from labpipe.errors import ReadError, error_text
from labpipe.readers.raw_files import is_blank
from labpipe.readers.table_body import (
    Body,
    Extent,
    cells_of_columns,
    quote_words,
    whole_lines,
    without_summary,
)
from labpipe.readers.text_cells import (
    DECIMAL_SIGNS,
    EXPORT_AGAIN,
    INFINITE_WORDS,
    LOST_DECIMALS,
    NUMERAL,
    describe_cell,
    is_grouped,
    is_missing,
    lost_decimals_text,
    quoted,
    split_line,
    thousandfold_jump,
)
from labpipe.records.arrays import Floats
from labpipe.records.quality import QualityNote, Severity

if TYPE_CHECKING:
    import pandas as pd

_NAN_WORDS = ("NAN", "NaN", "nan")
_COMMA_REMEDY = (
    "If commas stand in the numbers, too, export the test again with decimal points, or with"
    " semicolons or tabs between the cells; if not, the file may have been edited."
)


def read_columns(body: Body, path: Path) -> tuple[dict[int, Floats], list[QualityNote]]:
    """Read columns of numbers; blank cells and words for missing values are NaN.

    Parameters
    ----------
    body : the rows
    path : named in errors

    Returns
    -------
    columns : by their number, all of shape (rows,)
    notes : ``summary_rows_left_out`` (rows of text at the end), ``truncated`` (an incomplete last
        line was omitted), ``missing_words`` (words for missing values, by column),
        ``lines_short`` (missing cells count as blank), ``rows_differ`` (from the number stated in
        the header)

    Raises
    ------
    ReadError
        If a cell is not a number with the decimal sign of the others, or is too large, a line has
        more cells than there are names, or a column lost its decimal signs.
    """
    # In which the decimal sign is searched.
    head_bytes = 20000
    body, closing = without_summary(body)
    end, notes = whole_lines(body)
    notes = [*closing, *notes]
    head = body.data[body.start : min(end, body.start + head_bytes)]
    if not head.strip() and is_blank(body.data[body.start : end]):
        return {column: np.empty(0) for column in body.columns}, notes + rows_note(
            body.stated_rows, 0
        )
    decimal = _decimal_sign(body, head) if body.decimal == "auto" else body.decimal
    first = split_line(head[: head.find(b"\n") + 1 or None].decode("latin-1"), body.separator)
    extent = Extent(body, end, decimal, max(len(body.names), len(first)))
    parsed, missing_notes = _parse_columns(extent, path)
    notes += missing_notes
    columns = {column: parsed[column] for column in body.columns}
    rows = filled_rows(columns)
    if not all(np.isfinite(values).all() for values in columns.values()):
        infinite = any(np.isinf(values).any() for values in columns.values())
        if infinite and not body.as_exported:
            raise ReadError(first_error(extent, path))
        notes += _short_lines(extent, rows)  # no line can be short if all cells are numbers
    if not body.as_exported:
        _refuse_lost_decimals(extent, columns, path)
    notes += rows_note(body.stated_rows, rows)
    return {column: columns[column][:rows] for column in body.columns}, notes


def rows_note(stated: int | None, held: int) -> list[QualityNote]:
    """Return a note if the number of rows differs from the stated one."""
    if stated in {None, held}:
        return []
    message = f"the header states {stated} rows, the file holds {held}"
    return [QualityNote("rows_differ", Severity.WARNING, "file", message)]


def _refuse_lost_decimals(extent: Extent, columns: Mapping[int, Floats], path: Path) -> None:
    for column, values in columns.items():
        rows = thousandfold_jump(values)
        message = None if rows is None else jump_error(extent, column, rows, path)
        if message is not None:
            raise ReadError(message)


def words_note(column: str, missing: Mapping[str, int], place: str) -> QualityNote:
    """Return a note on words for missing values in a column.

    Parameters
    ----------
    column : its name
    missing : number of cells with each word
    place : of the first one
    """
    count = sum(missing.values())
    held = quote_words(list(missing))
    message = f"{count} cells hold {held}, the first in {place}: they count as missing"
    return QualityNote("missing_words", Severity.INFO, column, message)


def _parse_columns(extent: Extent, path: Path) -> tuple[dict[int, Floats], list[QualityNote]]:
    body = extent.body
    extra = range(len(body.names), extent.width)  # blank cells after the last separator
    wanted = [*body.columns, *extra]
    try:
        columns, notes = _parse_rows(extent, wanted)
    except (ValueError, OverflowError) as error:
        raise ReadError(first_error(extent, path)) from error
    if any(not np.isnan(columns[column]).all() for column in extra):
        raise ReadError(first_error(extent, path))
    return columns, notes


def _parse_rows(extent: Extent, wanted: list[int]) -> tuple[dict[int, Floats], list[QualityNote]]:
    """Read the rows; refuse rows with more cells, which pandas would omit."""
    data = extent.data
    starts, counts = extent.separators
    for i in np.flatnonzero(counts >= extent.width):
        line = str(data[starts[i] : starts[i + 1]], "utf-8", errors="replace")
        if any(cell.strip() for cell in split_line(line, extent.body.separator)[extent.width :]):
            message = "a line has more cells than the first one"
            raise ValueError(message)
    try:
        return _to_arrays(_read_csv(extent, wanted)), []
    except (ValueError, OverflowError):
        missing, notes = _missing_words(extent)
        if not missing:
            raise
        return _to_arrays(_read_csv(extent, wanted, missing)), notes


def _missing_words(extent: Extent) -> tuple[list[str], list[QualityNote]]:
    """Return the words for missing values in the columns, as written."""
    body = extent.body
    texts = _read_csv(extent, body.columns, None)
    all_missing, notes = list[str](), []
    for column in body.columns:
        counts = texts[column].value_counts()
        missing = {str(word): int(counts[word]) for word in counts.index if is_missing(str(word))}
        if missing:
            first = body.first_line + int(np.flatnonzero(texts[column].isin(list(missing)))[0])
            all_missing += missing
            notes.append(words_note(body.names[column], missing, f"line {first}"))
    return all_missing, notes


def _to_arrays(table: pd.DataFrame) -> dict[int, Floats]:
    return {int(column): table[column].to_numpy() for column in table.columns}


def _read_csv(
    extent: Extent, wanted: Sequence[int], missing: Sequence[str] | None = ()
) -> pd.DataFrame:
    """Read cells as numbers, with these words for missing values; as text if None."""
    import pandas as pd

    return pd.read_csv(
        io.BytesIO(extent.data),
        sep=r"\s+" if extent.body.separator == " " else extent.body.separator,
        decimal=extent.decimal,
        header=None,
        names=list(range(extent.width)),
        usecols=list(wanted),
        dtype=str if missing is None else np.float64,
        na_values=["", *(missing or ()), *(_NAN_WORDS if extent.body.as_exported else ())],
        keep_default_na=False,
        skip_blank_lines=False,
        skipinitialspace=not extent.body.as_exported,
        encoding_errors="replace",
    )


def filled_rows(columns: Mapping[int, Floats]) -> int:
    """Return the number of rows up to the last filled one."""
    rows = max((len(values) for values in columns.values()), default=0)
    while rows and all(np.isnan(values[rows - 1]) for values in columns.values()):
        rows -= 1
    return rows


def _decimal_sign(body: Body, data: bytes) -> str:
    """Return the decimal sign of the first cells with one; a point if there are none."""
    lines = data.decode("latin-1").split("\n")
    for line in lines[:-1] or lines:
        for cell in cells_of_columns(split_line(line, body.separator), body.columns):
            for sign in DECIMAL_SIGNS:
                if sign in cell and NUMERAL[sign].fullmatch(cell):
                    return sign
    return "."


def _short_lines(extent: Extent, rows: int) -> list[QualityNote]:
    """Return a note on lines with fewer cells than names, up to the last filled row."""
    data = extent.data
    starts, counts = extent.separators
    short = [int(i) for i in np.flatnonzero(counts[:rows] < len(extent.body.names) - 1)]
    short = [i for i in short if bytes(data[starts[i] : starts[i + 1]]).strip()]
    if not short:
        return []
    message = (
        f"{len(short)} lines have too few cells, first line {extent.body.first_line + short[0]}:"
    )
    message += " missing cells count as blank"
    return [QualityNote("lines_short", Severity.WARNING, "file", message)]


def first_error(extent: Extent, path: Path) -> str:
    """Return the message on the first cell that is not a number, or line with too many cells.

    Parameters
    ----------
    extent : the rows
    path : named in the message

    Returns
    -------
    The message.
    """
    body = extent.body
    for number, row in enumerate(extent.rows(), start=body.first_line):
        if any(cell.strip() for cell in row[len(body.names) :]):
            return _extra_cells_error(row, body, number, path)
        for column in body.columns:
            cell = row[column].strip() if column < len(row) else ""
            if cell and not _is_finite(cell, extent):
                return _bad_cell_error(extent, cell, column, number, path)
    place = f"from line {body.first_line} on"
    return error_text(path, place, expected="rows of numbers", found="others", remedy=EXPORT_AGAIN)


def _extra_cells_error(row: Sequence[str], body: Body, line: int, path: Path) -> str:
    """Return the message on a line with more cells than names, perhaps due to decimal commas."""
    max_length = 40
    found, remedy = f"{len(row)}", EXPORT_AGAIN
    if body.separator == "," and all(cell.strip("+-").isdigit() for cell in row if cell):
        found += f" in '{','.join(row)[:max_length]}'"
        remedy = _COMMA_REMEDY
    expected = f"{len(body.names)} cells as in the header"
    return error_text(path, f"line {line}", expected=expected, found=found, remedy=remedy)


def jump_error(extent: Extent, column: int, rows: tuple[int, int], path: Path) -> str | None:
    """Return the message on a column of whole numbers that jumps by a thousand and back.

    Parameters
    ----------
    extent : the rows
    column : its number
    rows : numbers of those before and after a jump, counted from 0
    path : named in the message

    Returns
    -------
    The message; None if the numbers have a decimal sign or an exponent.
    """
    before, after = (row[column].strip() for i, row in enumerate(extent.rows()) if i in rows)
    if not all(re.fullmatch(r"[+-]?\d+", cell) for cell in (before, after)):
        return None
    place = f"line {extent.body.first_line + rows[1]}, column '{extent.body.names[column]}'"
    return lost_decimals_text(path, place, before, after)


def _is_finite(cell: str, extent: Extent) -> bool:
    if NUMERAL[extent.decimal].fullmatch(cell) is None:
        is_infinite = cell.strip("+-").casefold() in INFINITE_WORDS
        return is_missing(cell) or (extent.body.as_exported and is_infinite)
    return bool(np.isfinite(float(cell.replace(extent.decimal, "."))))


def _bad_cell_error(extent: Extent, cell: str, column: int, line: int, path: Path) -> str:
    expected, found, remedy = describe_cell(cell, extent.decimal)
    grouped = _find_grouped_cell(extent, column)
    if grouped is not None and not re.search("[^-+0-9.,]", cell):
        found = quoted([cell])
        found += f" (and '{grouped[1]}' in line {grouped[0]})" if grouped[1] != cell else ""
        remedy = LOST_DECIMALS
    place = f"line {line}, column '{extent.body.names[column]}'"
    return error_text(path, place, expected=expected, found=found, remedy=remedy)


def _find_grouped_cell(extent: Extent, column: int) -> tuple[int, str] | None:
    """Return line and text of the first cell of a column with two thousands separators."""
    for number, row in enumerate(extent.rows(), start=extent.body.first_line):
        cell = row[column].strip() if column < len(row) else ""
        if is_grouped(cell):
            return number, cell
    return None
