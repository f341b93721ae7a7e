"""Rows of numbers of a text export: what is known of them before they are read."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from labpipe.readers.cells import split_line
from labpipe.records.arrays import Ints

SIGNS = {".": "a decimal point", ",": "a decimal comma"}
PLAIN = {sign: re.compile(rf"[+-]?(\d+(\{sign}\d*)?|\{sign}\d+)([eE][+-]?\d+)?") for sign in SIGNS}
"""A number by its decimal sign."""


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


@dataclass(frozen=True, slots=True)
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
    def data(self) -> bytes:
        """The bytes of the whole rows."""
        return self.body.data[self.body.start : self.end]

    def rows(self) -> Iterator[list[str]]:
        """Give the cells of each row."""
        lines = self.data.decode("utf-8", errors="replace").split("\n")
        return (split_line(line, self.body.separator) for line in lines)

    def separators(self) -> tuple[Ints, Ints]:
        """Count separators.

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
            lines = (data[a:b] for a, b in pairwise(starts.tolist()))
            return starts, np.array([len(line.split()) - 1 for line in lines])
        before = np.searchsorted(np.flatnonzero(letters == ord(self.body.separator)), ends)
        return starts, np.diff(before, prepend=0)


def chosen_cells(row: Sequence[str], columns: Sequence[int]) -> Iterator[str]:
    """Give the cells of some columns, as far as the row has them."""
    return (row[column].strip() for column in columns if column < len(row))
