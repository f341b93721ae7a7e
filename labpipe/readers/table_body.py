"""The rows of samples in a text export: their beginning and end."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from operator import le

import numpy as np

from labpipe.readers.text_cells import is_missing, is_number, is_summary_row, quoted, split_line
from labpipe.records.arrays import Ints
from labpipe.records.quality import QualityNote, Severity


@dataclass(frozen=True, slots=True)
class Body:
    """The rows of samples of a text export.

    Parameters
    ----------
    data : bytes of the export, compatible with ASCII
    names : of the columns, for messages
    columns : indices of the columns of numbers, ascending
    first_line : line number of the first row
    start : offset of the first row in `data`
    others_numeric : whether the other columns also contain numbers, but are not wanted
    separator : between cells, a blank for any number of blanks
    decimal : decimal sign, or ``auto``
    stated_rows : number of rows stated in the header, or None
    as_exported : whether a recording program wrote it, rather than a spreadsheet: NAN and Infinity
        are numbers, columns may contain any code, trailing zeros are written
    """

    data: bytes
    names: Sequence[str]
    columns: Sequence[int]
    first_line: int
    separator: str
    decimal: str = "auto"
    start: int = 0
    others_numeric: bool = False
    stated_rows: int | None = None
    as_exported: bool = False


@dataclass(frozen=True)
class Extent:
    """A body with known end, decimal sign and width.

    Parameters
    ----------
    body : the rows
    end : offset of the end of the last complete row in the data of the body
    decimal : decimal sign
    width : number of cells of a row, at least as many as names
    """

    body: Body
    end: int
    decimal: str
    width: int

    @property
    def data(self) -> memoryview:
        """Return the bytes of the complete rows, not copied."""
        return memoryview(self.body.data)[self.body.start : self.end]

    def rows(self) -> Iterator[list[str]]:
        """Yield the cells of each row."""
        lines = str(self.data, "utf-8", errors="replace").split("\n")
        return (split_line(line, self.body.separator) for line in lines)

    @cached_property
    def separators(self) -> tuple[Ints, Ints]:
        """Return the offsets of lines and their numbers of separators.

        Returns
        -------
        starts : start of each line, and end of the last one, shape (lines + 1,)
        counts : separators in each line, shape (lines,)
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


def cells_of_columns(row: Sequence[str], columns: Sequence[int]) -> Iterator[str]:
    """Yield the cells of some columns, as far as the row has them."""
    return (row[column].strip() for column in columns if column < len(row))


def without_summary(body: Body) -> tuple[Body, list[QualityNote]]:
    """Omit rows of text at the end: statistics and remarks.

    Parameters
    ----------
    body : the rows

    Returns
    -------
    body : without them; unchanged if all rows are text
    notes : ``summary_rows_left_out``
    """
    data, line_start, cut = body.data, len(body.data), len(body.data)
    holding = range(len(body.names)) if body.others_numeric else body.columns
    firsts: list[str] = []
    while line_start > body.start:
        begin = max(data.rfind(b"\n", body.start, line_start - 1) + 1, body.start)
        row = split_line(data[begin:line_start].decode("utf-8", errors="replace"), body.separator)
        if any(cell.strip() for cell in row):
            cells = list(cells_of_columns(row, holding))
            if not is_summary_row(cells):
                break
            firsts.insert(0, next(filter(None, cells)))
            cut = begin
        line_start = begin
    # If all rows are text, this is reported when numbers are parsed.
    if not firsts or line_start <= body.start:
        return body, []
    line = body.first_line + data.count(b"\n", body.start, cut)
    note = summary_note(firsts, f"line {line}")
    return replace(body, data=data[:cut]), [note]


def summary_note(firsts: Sequence[str], place: str) -> QualityNote:
    """Return a note on rows of text below the samples.

    Parameters
    ----------
    firsts : first cell of each row
    place : of the first row
    """
    message = f"{len(firsts)} rows from {place} on begin with words and were left out:"
    message += f" {quote_words(firsts)}"
    return QualityNote("summary_rows_left_out", Severity.INFO, "file", message)


def quote_words(texts: Sequence[str]) -> str:
    """Quote texts in a message, at most three."""
    more = f" and {len(texts) - 3} more" if len(texts) > 3 else ""
    return ", ".join(quoted([text.strip()]) for text in texts[:3]) + more


def whole_lines(body: Body) -> tuple[int, list[QualityNote]]:
    """Find the end of the last complete line; an incomplete last line is omitted.

    A last line without line end is complete if it has all its cells, and its last number has as
    many decimals, or as many digits, as the one above, and as long an exponent. If trailing zeros
    are not written, it is complete if some line above has a last number with no more of all three.
    It is incomplete if the header states more rows.

    Parameters
    ----------
    body : the rows

    Returns
    -------
    end : offset in the data of the body
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
    """Return the last cells of the lines above the last one, nearest first."""
    # Lines above the last one that are compared with it.
    max_lines = 200
    lines = body.data[body.start : end].rsplit(b"\n", max_lines + 1)
    near = lines[max(len(lines) - 1 - max_lines, 0) : -1]
    rows = (split_line(line.decode("latin-1"), body.separator) for line in reversed(near))
    return [row[-1].strip() for row in rows if row]


def _is_whole(last: Sequence[str], above: Sequence[str], body: Body) -> bool:
    if len(last) < len(body.names) or not any(cell.strip() for cell in last):
        return False
    if len(last) > len(body.names) or not above:  # it ends after its last separator
        return True
    cells = [cell for cell in cells_of_columns(last, body.columns) if cell]
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
    others = (_number_lengths(cell) for cell in above if cell)
    return cut[-1:].isdigit() and any(all(map(le, other, lengths)) for other in others)


def _number_lengths(cell: str) -> tuple[int, int, int]:
    """Return the numbers of decimals, of digits without leading zeros, and of exponent digits."""
    number, _, exponent = cell.casefold().partition("e")
    parts = re.split(r"[.,]", number)
    decimals = len(parts[-1]) if len(parts) > 1 else 0
    return decimals, len(re.sub(r"\D", "", number).lstrip("0")), len(exponent.lstrip("+-"))
