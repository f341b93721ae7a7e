"""Read columns of numbers from the rows of a text or a sheet, and omit rows without samples."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import date, time, timedelta
from typing import TYPE_CHECKING

import numpy as np

from labpipe.readers.raw_files import ContentError, is_blank
from labpipe.records.arrays import Floats
from labpipe.records.quality import QualityNote
from labpipe.units import get_conversion_factor

if TYPE_CHECKING:
    import pandas as pd


_NUMBER = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+|\d{1,3}([.,]\d{3})+)([eE][+-]?\d+)?", re.ASCII)
MISSING_WORDS = frozenset(
    (
        *("nan", "na", "n/a", "n.a.", "null", "none", "nil", "-", "--", "---"),
        *("#n/a", "#na", "#nv", "#div/0!", "#value!", "#num!", "#ref!", "#null!"),
        *("-nan", "nan(ind)", "-nan(ind)", "1.#qnan", "-1.#qnan", "1.#ind", "-1.#ind"),
    )
)
"""Words for a missing value, in lower case."""
_TIME_STAMP = re.compile(
    r"(?=\d)(\d{1,4}([-./ ])(\d{1,2}|[a-z]{3})\2\d{1,4}[T ,]*)?"  # day
    r"(\d{1,2}:\d{2}(:\d{2})?([.,:]\d+)?)?(\s*[ap]\.?\s?m\.?)?(Z|[+-]\d{2}:?\d{2})?",
    re.IGNORECASE,
)
_THOUSANDS = re.compile(r"[+-]?\d{1,3}(?:([,.' \u2019\u00a0\u202f])\d{3})(?:\1\d{3})*([.,]\d+)?")
_WORD = re.compile(r"\W*[^\W\d_]{2}")
_BRACKETED_UNIT = {
    "()": re.compile(r"(.*?)\(([^()]*(?:\([^()]*\)[^()]*)?)\)"),
    "[]": re.compile(r"(.*?)\[([^\[\]]*)\]"),
}
"""Pattern of a name and a unit in brackets, keyed by the brackets."""
_UNIT_AFTER_MARK = re.compile(r"(.*\S)(?:\s*,\s*|\s+/\s+)([^\W\d]\S*|%|°\S*)")
"""Pattern of a unit after a comma, ``Force, N``, or a slash as in ISO 80000, ``Force / N``."""
_READABLE_DIMENSIONS = ("s", "m", "N", "Pa", "1", "V", "N*m", "rad", "K", "Hz", "m/s", "kg")
"""One unit of each dimension that the unit of a column may have."""
_OTHER_UNITS = frozenset({"-", "count", "°C"})
DECIMAL_SIGNS = {".": "a decimal point", ",": "a decimal comma"}
"""Decimal signs, with their names for messages."""
NUMERAL = {
    sign: re.compile(rf"[+-]?(\d+(\{sign}\d*)?|\{sign}\d+)([eE][+-]?\d+)?", re.ASCII)
    for sign in DECIMAL_SIGNS
}
"""Patterns of a number, keyed by its decimal sign."""
INFINITE_WORDS = frozenset({"inf", "infinity"})
_GROUPED_NUMBER = re.compile(r"[+-]?\d{1,3}(,\d{3}){2,}|[+-]?\d{1,3}(\.\d{3}){2,}")


def format_value(cell: object) -> str:
    """Format the value of a cell of a sheet as text, a duration in seconds."""
    if isinstance(cell, timedelta):
        cell = cell.total_seconds()
    if isinstance(cell, float):
        return f"{cell:.15g}"
    if isinstance(cell, date | time):
        return cell.isoformat()
    return str(cell).strip()


def is_number(cell: str) -> bool:
    """Return whether a cell is a number, with any decimal sign."""
    return _NUMBER.fullmatch(cell.strip()) is not None


def is_missing(cell: str) -> bool:
    """Return whether a cell is a word for a missing value, such as ``nan``, ``N/A`` or ``-``."""
    return cell.strip().casefold() in MISSING_WORDS


def is_sample(row: Sequence[str]) -> bool:
    """Return whether a row is a sample.

    A sample has at least one number. The other cells are words for missing values, time stamps or
    numbers with thousands separators. `read_columns` reports those that it cannot parse.
    """
    filled_cells = [cell.strip() for cell in row if cell.strip()]
    numbers = [cell for cell in filled_cells if is_number(cell)]
    other_cells = (cell for cell in filled_cells if cell not in numbers)
    return bool(numbers) and all(
        is_missing(cell) or _TIME_STAMP.fullmatch(cell) or _THOUSANDS.fullmatch(cell)
        for cell in other_cells
    )


def is_summary_row(row: Sequence[str]) -> bool:
    """Return whether a row begins with a word, like statistics and remarks below the samples."""
    first_text = next((cell.strip() for cell in row if cell.strip()), "")
    is_infinite = first_text.strip("+-").casefold() in INFINITE_WORDS
    return bool(_WORD.match(first_text)) and not is_infinite and not is_missing(first_text)


def build_cell_error(cell: str, decimal: str, place: str) -> ContentError:
    """Build the error on a cell that is not a finite number in the decimal format of the file.

    Parameters
    ----------
    cell : text of the cell, without surrounding blanks
    decimal : decimal sign of the file
    place : line or row of the cell, and its column

    Examples
    --------
    >>> build_cell_error("10:00:00.5", ".", "line 3").args[:2]
    ('readers.time_stamp', 'line 3')
    """
    other_numeral = NUMERAL["," if decimal == "." else "."]
    return ContentError.of(
        "readers.number_too_large"
        if NUMERAL[decimal].fullmatch(cell)
        else "readers.lost_decimals"
        if _GROUPED_NUMBER.fullmatch(cell)
        else "readers.time_stamp"
        if _TIME_STAMP.fullmatch(cell)
        else "readers.other_signs"
        if other_numeral.fullmatch(cell) or _THOUSANDS.fullmatch(cell)
        else "readers.word_among_numbers"
        if is_summary_row([cell])
        else "readers.no_number",
        place,
        sign=DECIMAL_SIGNS[decimal],
        cell=cell[:40],
    )


def split_line(line: str, separator: str) -> list[str]:
    """Split a line into its cells."""
    line = line.rstrip("\r\n")
    if separator == " ":
        return line.split()
    try:
        return next(csv.reader([line], delimiter=separator), [])
    except csv.Error:
        return line.split(separator)


def split_head(
    lines: Sequence[str],
    separators: Iterable[str],
    is_last: Callable[[Sequence[str]], bool] = lambda row: len(row) > 1 and is_sample(row),
) -> tuple[str, list[list[str]]] | None:
    """Split the lines of a head into cells, up to the row that `is_last` accepts.

    Parameters
    ----------
    lines : lines of the head
    separators : candidate separators, in the order of trial
    is_last : function that returns whether a row is the last one; by default whether it is a sample
        of two or more cells

    Returns
    -------
    The first separator that yields the last row, and the rows up to it; None if no separator does.
    """
    for separator in separators:
        rows: list[list[str]] = []
        for line in lines:
            is_plain = separator not in line and '"' not in line  # fast for hundreds of lines
            rows.append([line] if is_plain else split_line(line, separator))
            if is_last(rows[-1]):
                return separator, rows
    return None


def is_unit(text: str) -> bool:
    """Return whether a text is a known unit."""
    return text in _OTHER_UNITS or any(has_dimension_of(text, x) for x in _READABLE_DIMENSIONS)


def has_dimension_of(text: str, unit: str) -> bool:
    """Return whether a text is a unit with the dimension of a given unit."""
    try:
        get_conversion_factor(text, unit)
    except ValueError:
        return False
    return True


def are_units(cells: Sequence[str]) -> bool:
    """Return whether all filled cells are units, with or without brackets, and one is filled."""
    units = [strip_brackets(cell) for cell in cells if cell]
    return bool(units) and all(map(is_unit, units))


def strip_brackets(cell: str) -> str:
    """Remove the brackets of a unit, if any."""
    return cell[1:-1].strip() if len(cell) > 1 and cell[0] + cell[-1] in _BRACKETED_UNIT else cell


def split_name_and_unit(cell: str, brackets: str = "") -> tuple[str, str] | None:
    """Split a cell into a name and a unit.

    Parameters
    ----------
    cell : text such as ``Force (N)``
    brackets : required brackets around the unit. If empty, any brackets are allowed, and instead of
        brackets a comma or slash before a known unit

    Returns
    -------
    Name and unit; None if there is no unit.
    """
    patterns = (
        [_BRACKETED_UNIT[brackets]] if brackets else [*_BRACKETED_UNIT.values(), _UNIT_AFTER_MARK]
    )
    for pattern in patterns:
        match = pattern.fullmatch(cell)
        if match and (pattern is not _UNIT_AFTER_MARK or is_unit(match[2])):
            return match[1].strip(), match[2].strip()
    return None


def quote_cells(cells: Sequence[str]) -> str:
    """Quote the filled cells of a row for a message, with at most 60 characters."""
    text = ", ".join(cell for cell in cells if cell)
    return f"'{text[:60]}'" if text else "nothing"


_EXPORTED_NAN_WORDS = ("NAN", "NaN", "nan")


@dataclass(frozen=True, slots=True)
class Body:
    """The rows of samples of a text export, or of a sheet.

    Parameters
    ----------
    data : bytes of the rows, in an encoding compatible with ASCII
    names : names of all columns, for messages
    columns : indices of the wanted columns of numbers, ascending
    first_line : line number of the first row
    separator : character between cells; a blank represents any number of blanks
    decimal : decimal sign, or ``auto``
    others_numeric : whether all columns that are not in `columns` contain numbers as well
    stated_rows : number of rows stated in the header, or None
    as_exported : whether a recording program wrote the rows, and not a spreadsheet. NAN and
        Infinity are then numbers, and the program writes trailing zeros
    sheet : sheet in messages, such as ``sheet 'a'``; empty for a text
    """

    data: bytes
    names: Sequence[str]
    columns: Sequence[int]
    first_line: int
    separator: str
    decimal: str = "auto"
    others_numeric: bool = False
    stated_rows: int | None = None
    as_exported: bool = False
    sheet: str = ""

    def describe_place(self, row: int, column: int | None = None) -> str:
        """Describe the place of a row, counted from 0, or of a cell in it, for a message."""
        prefix = f"{self.sheet}, row" if self.sheet else "line"
        cell = "" if column is None else f", column '{self.names[column]}'"
        return f"{prefix} {self.first_line + row}{cell}"

    def split_row(self, line: bytes) -> list[str]:
        """Split a row into its cells."""
        return split_line(str(line, "utf-8", errors="replace"), self.separator)

    def split_rows(self) -> Iterator[list[str]]:
        """Yield the cells of each row."""
        return map(self.split_row, self.data.split(b"\n"))


def read_columns(body: Body) -> tuple[dict[int, Floats], list[QualityNote]]:
    """Read columns of numbers, with NaN for blank cells and words for missing values.

    Parameters
    ----------
    body : rows of samples, and their format

    Returns
    -------
    columns : values of each column, shape (rows,), keyed by index of the column
    notes : ``summary_rows_left_out`` (rows of text at the end), ``truncated`` (an incomplete last
        line was omitted), ``rows_differ`` (the header states another number of rows)

    Raises
    ------
    ContentError
        If a cell is not a number with the decimal sign of the other cells, is too large, or has a
        thousands separator. If a line has more cells than there are names or, in a table of numbers
        only, fewer cells than a line below it.
    """
    body, notes = _drop_summary(body)
    body, line_notes = drop_incomplete_line(body)
    notes += line_notes
    if is_blank(body.data):
        notes += make_row_count_notes(body.stated_rows, 0)
        return dict.fromkeys(body.columns, np.empty(0)), notes
    if body.decimal == "auto":
        body = replace(body, decimal=_detect_decimal_sign(body))
    try:
        table = _parse_table(body)
    except (ValueError, OverflowError) as error:
        raise _build_first_error(body) from error
    _check_row_lengths(body, len(table))
    columns = {column: table[column].to_numpy() for column in body.columns}
    if not body.as_exported:
        if any(np.isinf(values).any() for values in columns.values()):
            raise _build_first_error(body)
        for column, values in columns.items():
            if (row := _find_thousands(values)) is not None:
                cell = f"{values[row]:.3f}".replace(".", body.decimal)
                facts = {"sign": DECIMAL_SIGNS[body.decimal], "cell": cell}
                raise ContentError.of(
                    "readers.other_signs", body.describe_place(row, column), **facts
                )
    n_rows = count_filled_rows(columns)
    notes += make_row_count_notes(body.stated_rows, n_rows)
    return {column: values[:n_rows] for column, values in columns.items()}, notes


def make_row_count_notes(stated_rows: int | None, n_rows: int) -> list[QualityNote]:
    """Make a note if the number of rows differs from the stated number, unless that is None."""
    if stated_rows in {None, n_rows}:
        return []
    return [QualityNote.of("readers.rows_differ", "file", stated=stated_rows, held=n_rows)]


def _drop_summary(body: Body) -> tuple[Body, list[QualityNote]]:
    """Omit rows of text (statistics, remarks) at the end, unless all rows are text."""
    data, row_end, data_end = body.data, len(body.data), len(body.data)
    sample_columns = range(len(body.names)) if body.others_numeric else body.columns
    first_words: list[str] = []
    while row_end:
        row_start = data.rfind(b"\n", 0, row_end - 1) + 1
        row = body.split_row(data[row_start:row_end])
        if any(cell.strip() for cell in row):
            cells = _pick_cells(row, sample_columns)
            if not is_summary_row(cells):
                break
            first_words.insert(0, quote_cells([next(filter(None, cells))]))
            data_end = row_start
        row_end = row_start
    if not first_words or not row_end:
        return body, []
    place, names = body.describe_place(data.count(b"\n", 0, data_end)), ", ".join(first_words[:3])
    rows = f"{len(first_words)} rows from {place} on"
    note = QualityNote.of("readers.summary_rows_left_out", "file", rows=rows, names=names)
    return replace(body, data=data[:data_end]), [note]


def _pick_cells(row: Sequence[str], columns: Sequence[int]) -> list[str]:
    """Pick the cells of the given columns, without columns beyond the end of the row."""
    return [row[column].strip() for column in columns if column < len(row)]


def drop_incomplete_line(body: Body) -> tuple[Body, list[QualityNote]]:
    """Omit an incomplete last line, with the note ``truncated``.

    A last line without line end is complete if it has all cells, and its last number has at least
    as many decimals and exponent digits as the number above. A spreadsheet omits trailing zeros. A
    line that it wrote is also complete if the last number has at least as many digits and exponent
    digits as the number above, or at least as many decimals, digits and exponent digits as the
    number in any line above. A line is incomplete if the header states more rows.
    """
    max_lines = 200  # lines above the last line that are compared with it
    start = body.data.rfind(b"\n") + 1  # of the last line
    complete_lines, last_line = body.data[:start], body.data[start:]
    if not last_line.strip(b"\r\0\x1a "):
        return replace(body, data=complete_lines), []
    n_lines = body.data.count(b"\n")
    preceding_lines = complete_lines.rsplit(b"\n", max_lines + 1)[-max_lines - 1 : -1]
    rows_above = map(body.split_row, reversed(preceding_lines))
    cells_above = [row[-1].strip() for row in rows_above if row]
    has_stated_rows = n_lines + 1 >= (body.stated_rows or 0)
    if has_stated_rows and _is_complete(body.split_row(last_line), cells_above, body):
        return body, []
    note = QualityNote.of("readers.truncated", "file", line=body.first_line + n_lines)
    return replace(body, data=complete_lines), [note]


def _is_complete(row: Sequence[str], cells_above: Sequence[str], body: Body) -> bool:
    """Return whether the last row is complete, compared with the last cells of the rows above."""
    # A row that ends with a separator has one more cell.
    if len(row) != len(body.names) or not cells_above:
        return len(row) >= len(body.names) and any(cell.strip() for cell in row)
    cells, last_cell = [cell for cell in _pick_cells(row, body.columns) if cell], row[-1].strip()
    if is_missing(last_cell) or not all(is_number(cell) or is_missing(cell) for cell in cells):
        return is_missing(last_cell) and last_cell in cells_above
    decimals, digits, exponent = _count_digits(last_cell)
    decimals_above, digits_above, exponent_above = _count_digits(cells_above[0])
    if exponent >= exponent_above and decimals >= decimals_above:
        return True
    if body.as_exported or not last_cell[-1:].isdigit():
        return False
    digit_counts = (_count_digits(cell) for cell in cells_above if cell)
    return (exponent >= exponent_above and digits >= digits_above) or any(
        decimals >= d and digits >= n and exponent >= e for d, n, e in digit_counts
    )


def _count_digits(cell: str) -> tuple[int, int, int]:
    """Count the decimals, the digits without leading zeros, and the exponent digits."""
    number, _, exponent = cell.casefold().partition("e")
    _, *decimals = re.split(r"[.,]", number)
    digits = re.sub(r"\D", "", number).lstrip("0")
    return len(decimals[-1]) if decimals else 0, len(digits), len(exponent.lstrip("+-"))


def _detect_decimal_sign(body: Body) -> str:
    """Detect the decimal sign from the first number that has one; a point if no number has one."""
    max_bytes = 20000  # bytes in which the decimal sign is searched
    lines = body.data[:max_bytes].split(b"\n")
    for line in lines[:-1] or lines:
        for cell in _pick_cells(body.split_row(line), body.columns):
            for sign in DECIMAL_SIGNS:
                if sign in cell and NUMERAL[sign].fullmatch(cell):
                    return sign
    return "."


def _parse_table(body: Body) -> pd.DataFrame:
    """Parse the wanted columns, or raise ValueError if a row has a wrong number of cells."""
    n_columns = len(body.names)
    try:
        table = _read_csv(body, _EXPORTED_NAN_WORDS if body.as_exported else ())
    except (ValueError, OverflowError):
        texts = _read_csv(body, (), dtype=str)
        cells = {str(word) for column in body.columns for word in texts[column].unique()}
        if not (missing_words := [word for word in cells if is_missing(word)]):
            raise
        table = _read_csv(body, missing_words)
    lines = body.data.split(b"\n") if body.separator == " " else ()
    if table[n_columns].notna().any() or any(0 < len(line.split()) < n_columns for line in lines):
        message = "a line has more cells than the header, or fewer between blanks"
        raise ValueError(message)
    return table


def _read_csv(body: Body, missing_words: Sequence[str], dtype: type = float) -> pd.DataFrame:
    """Read the wanted columns, and a column of the cells beyond the last name."""
    import pandas as pd

    width = len(body.names) + 1
    first_row = body.separator.join("0" * width) + "\n"  # pandas counts the columns in this row
    return pd.read_csv(
        io.BytesIO(first_row.encode() + body.data),
        sep=r"\s+" if body.separator == " " else body.separator,
        decimal=body.decimal,
        header=None,
        names=list(range(width)),
        usecols=[*body.columns, width - 1],
        dtype=dtype,
        na_values=["", *missing_words],
        keep_default_na=False,
        skip_blank_lines=False,
        skipinitialspace=not body.as_exported,
        encoding_errors="replace",
    ).iloc[1:]


def _check_row_lengths(body: Body, n_lines: int) -> None:
    """Refuse a row of a table of numbers with fewer cells than the next row that is not blank.

    Its cells may be in the wrong columns. All rows after a row may be short, because a spreadsheet
    may omit separators after the last filled cell.
    """
    separator = body.separator.encode()
    n_separators = body.data.partition(b"\n")[0].count(separator)
    is_even = body.data.count(separator) == n_lines * n_separators  # fast for most files
    if is_even or body.separator == " " or not (body.others_numeric or body.as_exported):
        return
    previous_row, previous_length, previous_line = 0, 0, b""
    for row, line in enumerate(body.data.split(b"\n")):
        if not line.strip(b"\r " + separator):
            continue
        length = len(body.split_row(line)) if b'"' in line else line.count(separator) + 1
        if length > previous_length > 0:
            text = previous_line.decode(errors="replace").strip()[:40]
            facts = {"wanted": length, "cells": previous_length, "row": text}
            raise ContentError.of("readers.short_row", body.describe_place(previous_row), **facts)
        previous_row, previous_length, previous_line = row, length, line


def _find_thousands(values: Floats) -> int | None:
    """Find the first of the numbers whose thousands separator was read as a decimal sign.

    Such a column has whole numbers up to 999, and numbers from 1.000 to 999.999 with at most three
    decimals. If these are taken as thousands, the largest step between successive numbers is
    smaller. Return None for any other column.
    """
    magnitudes = np.abs(values)
    n_below_one, n_zeros = np.count_nonzero(magnitudes < 1.0), np.count_nonzero(values == 0.0)
    if n_below_one > n_zeros or np.nanmax(magnitudes, initial=0.0) >= 1e3:
        return None
    values = np.nan_to_num(values)
    is_whole = values == np.rint(values)
    thousands = np.where(is_whole, values, 1e3 * values)
    if (
        is_whole.all()
        or np.abs(thousands - np.rint(thousands)).max() > 1e-6
        or len(values) < 2
        or np.abs(np.diff(thousands)).max() >= np.abs(np.diff(values)).max()
    ):
        return None
    return int(np.argmin(is_whole))


def count_filled_rows(columns: Mapping[int, Floats]) -> int:
    """Count the rows up to the last row with a number."""
    n_rows = max((len(values) for values in columns.values()), default=0)
    while n_rows and all(np.isnan(values[n_rows - 1]) for values in columns.values()):
        n_rows -= 1
    return n_rows


def _build_first_error(body: Body) -> ContentError:
    """Build the error on the first cell that is not a number, or first row of a wrong length."""
    for i, row in enumerate(body.split_rows()):
        # Between blanks, any cell of a line with fewer cells may be the missing one.
        is_short = body.separator == " " and 0 < len(row) < len(body.names)
        if is_short or any(cell.strip() for cell in row[len(body.names) :]):
            has_commas = body.separator == "," and all(c.strip("+-").isdigit() for c in row if c)
            facts = {"names": len(body.names), "cells": len(row), "row": ",".join(row)[:40]}
            return ContentError.of(
                "readers.cells_of_decimal_commas"
                if has_commas
                else "readers.extra_cells"
                if len(row) > len(body.names)
                else "readers.blank_between_blanks",
                body.describe_place(i),
                **facts,
            )
        for column in body.columns:
            cell = row[column].strip(" \t\r") if column < len(row) else ""
            if NUMERAL[body.decimal].fullmatch(cell):
                is_valid = bool(np.isfinite(float(cell.replace(body.decimal, "."))))
            else:
                is_infinite = cell.strip("+-").casefold() in INFINITE_WORDS
                is_valid = not cell or is_missing(cell) or (body.as_exported and is_infinite)
            if not is_valid:
                return build_cell_error(cell, body.decimal, body.describe_place(i, column))
    return ContentError.of("readers.no_rows_of_numbers", f"from {body.describe_place(0)} on")
