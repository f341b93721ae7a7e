"""Columns of numbers from the rows of a text or of a sheet, parsed by pandas; losses are noted."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from labpipe.errors import ReadError
from labpipe.readers.raw_files import is_blank, unreadable
from labpipe.readers.text_cells import (
    DECIMAL_SIGNS,
    EXPORT_AGAIN,
    INFINITE_WORDS,
    LOST_DECIMALS,
    NUMERAL,
    as_text,
    describe_cell,
    is_missing,
    is_number,
    is_summary_row,
    quoted,
    split_line,
)
from labpipe.records.arrays import Flags, Floats, Ints
from labpipe.records.quality import QualityNote, Severity

if TYPE_CHECKING:
    import pandas as pd

_NAN_WORDS = ("NAN", "NaN", "nan")
_COMMA_REMEDY = (
    "If commas stand in the numbers, too, export the test again with decimal points, or with"
    " semicolons or tabs between the cells; if not, the file may have been edited."
)


@dataclass(frozen=True, slots=True)
class Body:
    """The rows of samples of a text export, or of a sheet.

    Parameters
    ----------
    data : bytes of the rows, compatible with ASCII
    names : of the columns, for messages
    columns : indices of the columns of numbers, ascending
    first_line : line number of the first row
    separator : between cells, a blank for any number of blanks
    decimal : decimal sign, or ``auto``
    others_numeric : whether the other columns also contain numbers, but are not wanted
    stated_rows : number of rows stated in the header, or None
    as_exported : whether a recording program wrote it, rather than a spreadsheet: NAN and Infinity
        are numbers, columns may contain any code, trailing zeros are written
    sheet : name of the sheet in messages, such as ``sheet 'a'``; empty for a text
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

    def place(self, row: int) -> str:
        """Return the place of a row counted from 0, for messages."""
        prefix = f"{self.sheet}, row" if self.sheet else "line"
        return f"{prefix} {self.first_line + row}"

    def cells(self, line: bytes) -> list[str]:
        """Split a row into its cells."""
        return split_line(str(line, "utf-8", errors="replace"), self.separator)

    def rows(self) -> Iterator[list[str]]:
        """Yield the cells of each row."""
        return map(self.cells, self.data.split(b"\n"))


def sheet_columns(
    rows: Sequence[Sequence[object]], first: int, names: Mapping[int, str], where: tuple[Path, str]
) -> tuple[dict[int, Floats], list[QualityNote]]:
    """Read columns of numbers of a sheet, converted to text for `read_columns`.

    Parameters
    ----------
    rows : cells of the whole sheet, from `labpipe.readers.workbooks.open_sheets`
    first : index of the first row of numbers
    names : names of the wanted columns, by their index
    where : file and sheet, for messages

    Returns
    -------
    As `read_columns`.
    """
    wanted = ([row[i] if i < len(row) else "" for i in names] for row in rows[first:])
    body = Body(
        data=sheet_text(wanted).encode(),
        names=[*names.values()],
        columns=range(len(names)),
        first_line=first + 1,
        separator="\t",
        decimal=".",
        sheet=where[1],
    )
    columns, notes = read_columns(body, where[0])
    return dict(zip(names, columns.values(), strict=True)), notes


def sheet_text(rows: Iterable[Sequence[object]]) -> str:
    """Return rows of a sheet as lines of cells separated by tabs, with all digits of numbers."""
    text = io.StringIO()
    lines = csv.writer(text, delimiter="\t", lineterminator="\n")
    for row in rows:  # csv writes all digits of a float
        lines.writerow([cell if type(cell) is float else _one_line(cell) for cell in row])
    return text.getvalue()


def _one_line(cell: object) -> str:
    return " ".join(as_text(cell).split())


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
    body, summary_notes = _without_summary(body)
    body, cut_notes = whole_lines(body)
    notes = summary_notes + cut_notes
    if is_blank(body.data):
        return dict.fromkeys(body.columns, np.empty(0)), notes + rows_note(body.stated_rows, 0)
    if body.decimal == "auto":
        body = replace(body, decimal=_decimal_sign(body))
    try:
        table, word_notes = _parse(body)
    except (ValueError, OverflowError) as error:
        raise _first_error(body, path) from error
    notes += word_notes
    columns = {column: table[column].to_numpy() for column in body.columns}
    rows = _filled_rows(columns)
    if not all(np.isfinite(values).all() for values in columns.values()):
        if not body.as_exported and any(np.isinf(values).any() for values in columns.values()):
            raise _first_error(body, path)
        notes += _short_lines(body, rows)  # no line can be short if all cells are numbers
    if not body.as_exported:
        for column, values in columns.items():
            _refuse_lost_decimals(body, column, values, path)
    notes += rows_note(body.stated_rows, rows)
    return {column: values[:rows] for column, values in columns.items()}, notes


def rows_note(stated: int | None, held: int) -> list[QualityNote]:
    """Return a note if the number of rows differs from the stated one."""
    if stated in {None, held}:
        return []
    message = f"the header states {stated} rows, the file holds {held}"
    return [QualityNote("rows_differ", Severity.WARNING, "file", message)]


def _without_summary(body: Body) -> tuple[Body, list[QualityNote]]:
    """Omit rows of text at the end, statistics and remarks; not if all rows are text."""
    data, at, cut = body.data, len(body.data), len(body.data)
    holding = range(len(body.names)) if body.others_numeric else body.columns
    firsts: list[str] = []
    while at:
        begin = data.rfind(b"\n", 0, at - 1) + 1
        row = body.cells(data[begin:at])
        if any(cell.strip() for cell in row):
            cells = _cells_of(row, holding)
            if not is_summary_row(cells):
                break
            firsts.insert(0, next(filter(None, cells)))
            cut = begin
        at = begin
    if not firsts or not at:
        return body, []
    place = body.place(data.count(b"\n", 0, cut))
    message = f"{len(firsts)} rows from {place} on begin with words and were left out:"
    message += f" {_quoted(firsts)}"
    note = QualityNote("summary_rows_left_out", Severity.INFO, "file", message)
    return replace(body, data=data[:cut]), [note]


def _cells_of(row: Sequence[str], columns: Sequence[int]) -> list[str]:
    """Return the cells of some columns, as far as the row has them."""
    return [row[column].strip() for column in columns if column < len(row)]


def _quoted(texts: Sequence[str]) -> str:
    more = f" and {len(texts) - 3} more" if len(texts) > 3 else ""
    return ", ".join(quoted([text.strip()]) for text in texts[:3]) + more


def whole_lines(body: Body) -> tuple[Body, list[QualityNote]]:
    """Omit an incomplete last line, with the note ``truncated``.

    A last line without line end is complete if it has all its cells, and its last number has as
    many decimals, or as many digits, as the one above, and as long an exponent. If trailing zeros
    are not written, it is complete if some line above has a last number with no more of all three.
    It is incomplete if the header states more rows.
    """
    # Lines above the last one that are compared with it.
    max_lines = 200
    end = body.data.rfind(b"\n") + 1
    last = body.data[end:]
    if not last.strip(b"\r\0\x1a "):
        return replace(body, data=body.data[:end]), []
    count = body.data.count(b"\n")
    near = body.data[:end].rsplit(b"\n", max_lines + 1)[-max_lines - 1 : -1]
    above = [cells[-1].strip() for line in reversed(near) if (cells := body.cells(line))]
    if count + 1 >= (body.stated_rows or 0) and _is_whole(body.cells(last), above, body):
        return body, []
    message = f"the last line ({body.first_line + count}) is incomplete and was left out"
    note = QualityNote("truncated", Severity.WARNING, "file", message)
    return replace(body, data=body.data[:end]), [note]


def _is_whole(last: Sequence[str], above: Sequence[str], body: Body) -> bool:
    if len(last) < len(body.names) or not any(cell.strip() for cell in last):
        return False
    if len(last) > len(body.names) or not above:  # it ends after its last separator
        return True
    cells = [cell for cell in _cells_of(last, body.columns) if cell]
    if not all(is_number(cell) or is_missing(cell) for cell in cells):
        return False
    cut = last[-1].strip()
    if is_missing(cut):
        return cut in above
    lengths = decimals, digits, exponent = _number_lengths(cut)
    its_decimals, its_digits, its_exponent = _number_lengths(above[0])
    by_digits = digits >= its_digits and not body.as_exported
    is_as_long = exponent >= its_exponent and (decimals >= its_decimals or by_digits)
    if is_as_long or body.as_exported:
        return is_as_long
    others = (zip(lengths, _number_lengths(cell), strict=True) for cell in above if cell)
    return cut[-1:].isdigit() and any(all(a >= b for a, b in pairs) for pairs in others)


def _number_lengths(cell: str) -> tuple[int, int, int]:
    """Return the numbers of decimals, of digits without leading zeros, and of exponent digits."""
    number, _, exponent = cell.casefold().partition("e")
    parts = re.split(r"[.,]", number)
    decimals = len(parts[-1]) if len(parts) > 1 else 0
    return decimals, len(re.sub(r"\D", "", number).lstrip("0")), len(exponent.lstrip("+-"))


def _decimal_sign(body: Body) -> str:
    """Return the decimal sign of the first cells with one; a point if there are none."""
    # In which the decimal sign is searched.
    head_bytes = 20000
    lines = body.data[:head_bytes].split(b"\n")
    for line in lines[:-1] or lines:
        for cell in _cells_of(body.cells(line), body.columns):
            for sign in DECIMAL_SIGNS:
                if sign in cell and NUMERAL[sign].fullmatch(cell):
                    return sign
    return "."


def _parse(body: Body) -> tuple[pd.DataFrame, list[QualityNote]]:
    """Parse the wanted columns; refuse rows with more cells, which pandas would omit."""
    first = body.cells(body.data[: body.data.find(b"\n") + 1 or None])
    width = max(len(body.names), len(first))
    extra = [*range(len(body.names), width)]  # blank cells after the last separator
    wanted, notes = [*body.columns, *extra], list[QualityNote]()
    starts, counts = _separators(body)
    lines = (body.data[starts[i] : starts[i + 1]] for i in np.flatnonzero(counts >= width))
    has_more = any(any(cell.strip() for cell in body.cells(line)[width:]) for line in lines)
    try:
        table = _read_csv(body, width, wanted)
    except (ValueError, OverflowError):
        missing, notes = _missing_words(body, width)
        if not missing:
            raise
        table = _read_csv(body, width, wanted, missing)
    if has_more or table[extra].notna().any(axis=None):
        message = "a line has more cells than the header"
        raise ValueError(message)
    return table, notes


def _separators(body: Body) -> tuple[Ints, Ints]:
    """Return the offsets of the lines and of the end, and the number of separators of each line."""
    letters, end_of_line = np.frombuffer(body.data, dtype=np.uint8), ord("\n")
    marks = np.flatnonzero((letters == ord(body.separator)) | (letters == end_of_line))
    ends = np.flatnonzero(letters[marks] == end_of_line)
    starts = np.concatenate(([0], marks[ends] + 1, [len(letters)])).astype(np.int64)
    if body.separator == " ":
        return starts, np.array([len(line.split()) - 1 for line in body.data.split(b"\n")])
    return starts, np.diff(np.concatenate(([-1], ends, [len(marks)]))) - 1


def _missing_words(body: Body, width: int) -> tuple[list[str], list[QualityNote]]:
    """Return the words for missing values in the columns, as written."""
    texts = _read_csv(body, width, body.columns, None)
    all_missing, notes = list[str](), []
    for column in body.columns:
        counts = texts[column].value_counts()
        missing = [str(word) for word in counts.index if is_missing(str(word))]
        if missing:
            first = int(np.flatnonzero(texts[column].isin(missing))[0])
            message = f"{counts[missing].sum()} cells hold {_quoted(missing)}, the first in"
            message += f" {body.place(first)}: they count as missing"
            all_missing += missing
            notes.append(QualityNote("missing_words", Severity.INFO, body.names[column], message))
    return all_missing, notes


def _read_csv(
    body: Body, width: int, wanted: Sequence[int], missing: Sequence[str] | None = ()
) -> pd.DataFrame:
    """Read cells as numbers, with these words for missing values; as text if None."""
    import pandas as pd

    return pd.read_csv(
        io.BytesIO(body.data),
        sep=r"\s+" if body.separator == " " else body.separator,
        decimal=body.decimal,
        header=None,
        names=list(range(width)),
        usecols=list(wanted),
        dtype=str if missing is None else np.float64,
        na_values=["", *(missing or ()), *(_NAN_WORDS if body.as_exported else ())],
        keep_default_na=False,
        skip_blank_lines=False,
        skipinitialspace=not body.as_exported,
        encoding_errors="replace",
    )


def _filled_rows(columns: Mapping[int, Floats]) -> int:
    """Return the number of rows up to the last filled one."""
    rows = max((len(values) for values in columns.values()), default=0)
    while rows and all(np.isnan(values[rows - 1]) for values in columns.values()):
        rows -= 1
    return rows


def _short_lines(body: Body, rows: int) -> list[QualityNote]:
    """Return a note on lines with fewer cells than names, up to the last filled row."""
    starts, counts = _separators(body)
    short = [int(i) for i in np.flatnonzero(counts[:rows] < len(body.names) - 1)]
    short = [i for i in short if body.data[starts[i] : starts[i + 1]].strip()]
    if not short:
        return []
    message = f"{len(short)} lines have too few cells, first {body.place(short[0])}:"
    message += " missing cells count as blank"
    return [QualityNote("lines_short", Severity.WARNING, "file", message)]


def _first_error(body: Body, path: Path) -> ReadError:
    """Return the error on the first cell that is not a number, or line with too many cells."""
    for i, row in enumerate(body.rows()):
        if any(cell.strip() for cell in row[len(body.names) :]):
            return _extra_cells_error(row, body, body.place(i), path)
        for column in body.columns:
            cell = row[column].strip() if column < len(row) else ""
            if cell and not _is_finite(cell, body):
                place = f"{body.place(i)}, column '{body.names[column]}'"
                return unreadable(path, place, *describe_cell(cell, body.decimal))
    place = f"from {body.place(0)} on"
    return unreadable(path, place, "rows of numbers", "others", EXPORT_AGAIN)


def _extra_cells_error(row: Sequence[str], body: Body, place: str, path: Path) -> ReadError:
    """Return the error on a line with more cells than names, perhaps due to decimal commas."""
    max_length = 40
    found, remedy = f"{len(row)}", EXPORT_AGAIN
    if body.separator == "," and all(cell.strip("+-").isdigit() for cell in row if cell):
        found += f" in '{','.join(row)[:max_length]}'"
        remedy = _COMMA_REMEDY
    return unreadable(path, place, f"{len(body.names)} cells as in the header", found, remedy)


def _is_finite(cell: str, body: Body) -> bool:
    if NUMERAL[body.decimal].fullmatch(cell):
        return bool(np.isfinite(float(cell.replace(body.decimal, "."))))
    is_infinite = cell.strip("+-").casefold() in INFINITE_WORDS
    return is_missing(cell) or (body.as_exported and is_infinite)


def _refuse_lost_decimals(body: Body, column: int, values: Floats, path: Path) -> None:
    """Refuse a column of numbers without decimal signs that jumps by a thousand and back."""
    rows = thousandfold_jump(values)
    if rows is None:
        return
    before, after = (row[column].strip() for i, row in enumerate(body.rows()) if i in rows)
    if body.sheet:  # all its numbers have a decimal point
        before, after = before.removesuffix(".0"), after.removesuffix(".0")
    if all(re.fullmatch(r"[+-]?\d+", cell) for cell in (before, after)):
        expected = "numbers that do not jump by a factor of a thousand and back"
        place = f"{body.place(rows[1])}, column '{body.names[column]}'"
        raise unreadable(path, place, expected, f"'{after}' after '{before}'", LOST_DECIMALS)


def thousandfold_jump(values: Floats) -> tuple[int, int] | None:
    """Find the first jump by a thousand and back in a column of whole numbers.

    Parameters
    ----------
    values : shape (rows,)

    Returns
    -------
    The numbers of the rows before and after it, counted from 0; None if there is none, or most of
    the numbers have decimals.

    Notes
    -----
    A spreadsheet may read the decimal sign as a thousands separator and remove it: 1.063, 1.110797
    and 1.162 become 1063, 1110797 and 1162. The original numbers cannot be restored. A jump counts
    if the numbers up to the return, divided (or multiplied) by a thousand, lie between the two
    neighbours, as in such a curve. A spike or the overflow of a counter has any value, and a
    multiple of a thousand lost no sign. Numbers with decimals are ignored: 0.5 and 1.25 have no
    group of three digits, so that a spreadsheet keeps them.
    """
    factors = (1e3, 1e6)
    head_rows = 1000
    if not _are_mostly_whole(values[:head_rows]) or not _are_mostly_whole(values):
        return None
    rows = np.flatnonzero(values == np.rint(values))
    jumps = (_first_jump(values[rows], factor) for factor in factors)
    firsts = [at for at in jumps if at is not None]
    return (int(rows[min(firsts)]), int(rows[min(firsts) + 1])) if firsts else None


def _are_mostly_whole(values: Floats) -> bool:
    whole = int(np.count_nonzero(values == np.rint(values)))
    return whole > 0 and 2 * whole >= int(np.count_nonzero(~np.isnan(values)))


def _first_jump(values: Floats, factor: float) -> int | None:
    # Factor by which the ratio may differ from a thousand.
    tolerance = 1.5
    # Between the jump and the return.
    max_samples = 10
    # Smaller whole numbers are counters and codes.
    min_size = 100.0
    size = np.abs(values)
    smaller, larger = np.minimum(size[:-1], size[1:]), np.maximum(size[:-1], size[1:])
    ratio = larger / np.maximum(smaller, min_size)
    near: Flags = (ratio > factor / tolerance) & (ratio < factor * tolerance)
    near &= (smaller >= min_size) & (values[:-1] * values[1:] > 0.0)
    jumps = np.flatnonzero(near & (larger % 1000.0 != 0.0))
    for up, down in pairwise(jumps):
        if down - up <= max_samples and _is_scaled_between(size[up : down + 2], factor):
            return int(up)
    return None


def _is_scaled_between(run: Floats, factor: float) -> bool:
    """Return whether the scaled inner numbers lie between the first and the last one."""
    relative_margin = 0.01
    ends, inner = run[[0, -1]], run[1:-1]
    scaled = inner / factor if inner[0] > ends[0] else inner * factor
    spread = abs(ends[1] - ends[0]) + relative_margin * ends.max()
    return bool(np.all((scaled >= ends.min() - spread) & (scaled <= ends.max() + spread)))
