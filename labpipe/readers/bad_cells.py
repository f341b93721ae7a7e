"""The first cell that is no number, in words: the slow way, once it is needed."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from labpipe.errors import complaint
from labpipe.readers.regrouped import LOST, is_grouped, lost_signs
from labpipe.readers.rows import PLAIN, SIGNS, Shape

_AGAIN = "Export the test again; the file may have been cut off or edited."
_SHOWN = 40
_WORDS_FOR_NUMBERS = frozenset({"nan", "inf", "infinity"})


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
