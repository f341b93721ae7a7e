"""The rows of samples in a text export: where they begin and end."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from labpipe.readers.text_cells import is_closing, is_missing, is_number, quoted, split_line
from labpipe.records.arrays import Ints
from labpipe.records.quality import QualityNote, Severity

_COMPARED = 200
"""Lines above the last one in which a number as short as its last one is looked for."""
_WORDS_SHOWN = 3


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


def without_closing(body: Body) -> tuple[Body, list[QualityNote]]:
    """Leave out the rows at the end that begin with words: statistics and remarks.

    Parameters
    ----------
    body : the rows

    Returns
    -------
    body : without them; as it was where no row begins otherwise
    notes : ``summary_rows_left_out``
    """
    data, at, cut = body.data, len(body.data), len(body.data)
    holding = range(len(body.names)) if body.some_only else body.columns
    firsts: list[str] = []
    while at > body.start:
        begin = max(data.rfind(b"\n", body.start, at - 1) + 1, body.start)
        row = split_line(data[begin:at].decode("utf-8", errors="replace"), body.separator)
        if any(cell.strip() for cell in row):
            cells = list(chosen_cells(row, holding))
            if not is_closing(cells):
                break
            firsts.insert(0, next(filter(None, cells)))
            cut = begin
        at = begin
    if not firsts or at <= body.start:  # nothing but words: said where numbers are looked for
        return body, []
    line = body.first_line + data.count(b"\n", body.start, cut)
    note = closing_note(firsts, f"line {line}")
    return replace(body, data=data[:cut], as_in_file=False), [note]


def closing_note(firsts: Sequence[str], place: str) -> QualityNote:
    """Note the rows below the samples that begin with words.

    Parameters
    ----------
    firsts : first cell of each row
    place : of the first row
    """
    message = f"{len(firsts)} rows from {place} on begin with words and were left out:"
    message += f" {words_shown(firsts)}"
    return QualityNote("summary_rows_left_out", Severity.INFO, "file", message)


def words_shown(words: Sequence[str]) -> str:
    """List words in a message, the first few of many."""
    more = f" and {len(words) - _WORDS_SHOWN} more" if len(words) > _WORDS_SHOWN else ""
    return ", ".join(quoted([word.strip()]) for word in words[:_WORDS_SHOWN]) + more


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
    cells = [cell for cell in chosen_cells(last, body.columns) if cell]
    if not all(is_number(cell) or is_missing(cell) for cell in cells):
        return False
    cut = last[-1].strip()
    if is_missing(cut):
        return cut in above
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
