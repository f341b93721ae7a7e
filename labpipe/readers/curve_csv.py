"""Reads a force-displacement curve from elsewhere: two columns of a text file or of a workbook.

Writes these files: a finite-element program, a program that digitises figures, another lab.

Units: in the heading (``deflection / mm``, ``force [N]``, ``deflection_mm``), in a row of units
below it, or told by whoever asks. Two that differ are refused.

Missing data: a row in which both cells are blank is passed over, as in files that hold curves of
different lengths side by side. One blank cell is refused.

File structure: cells parted by tabulator, semicolon, comma or blanks, whichever parts the first
rows into numbers; decimal point or comma, one of them in a file. Rows above the names are passed
over. A file without names is read where its columns are numbered. Of a workbook, the first sheet.
A file that CalculiX printed is read as it is, see `readers.calculix_dat`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import islice, pairwise
from pathlib import Path

import numpy as np

from labpipe.readers.calculix_dat import is_calculix, tip_rows
from labpipe.readers.cells import (
    are_units,
    is_number,
    split_line,
    without_brackets,
)
from labpipe.readers.content import decode, is_binary, lines_of, read_content
from labpipe.readers.curve_columns import (
    CurveColumn,
    CurveTable,
    find_column,
    head_of,
    unit_factor,
)
from labpipe.readers.files import unreadable
from labpipe.readers.regrouped import is_grouped
from labpipe.readers.rows import PLAIN
from labpipe.readers.sheet_cells import Cell, Row, workbook_cells
from labpipe.readers.workbooks import is_workbook
from labpipe.records.arrays import Floats

__all__ = ["FEWEST", "CurveColumn", "read_curve"]

FEWEST = 3
"""Points that make a curve."""
_SEPARATORS = ("\t", ";", ",", " ")
_HEAD = 400
"""Lines in which the first row of numbers is looked for."""
_ENCODINGS = ("utf-8", "latin-1")
_NOT_FINITE = frozenset({"nan", "inf", "infinity"})


def read_curve(path: Path, deflection: CurveColumn, force: CurveColumn) -> tuple[Floats, Floats]:
    """Read a loading curve.

    Parameters
    ----------
    path : text or xlsx
    deflection, force : where they stand

    Returns
    -------
    Deflection (m), rising from row to row, and force (N), shape (n,) both.

    Raises
    ------
    ReadError
        If the file, a column or a unit is missing, a cell holds no finite number, a deflection is
        not above the one before, the largest force is negative, or there are fewer than 3 points.
    """
    table = _table(path)
    asked = (deflection, force)
    columns = [find_column(table, each) for each in asked]
    if columns[0] == columns[1]:
        found = f"column {columns[0] + 1} for both"
        raise unreadable(
            path, head_of(table), "two columns", found, "Name another one for the force."
        )
    factors = [unit_factor(table, at, each) for at, each in zip(columns, asked, strict=True)]
    points = _points(table, columns)
    across, up = (
        each.sign * factor * np.array([_number(point[i], path) for point in points])
        for i, (each, factor) in enumerate(zip(asked, factors, strict=True))
    )
    _check_order(path, points, across)
    _check_sign(path, points, up)
    return across, up


def _table(path: Path) -> CurveTable:
    cells = workbook_cells(path) if is_workbook(path) else _text_cells(path)
    unread = next((cell for row in cells for cell in row if cell.unread), None)
    if unread is not None:
        remedy = "Correct the cell, and save the workbook in the spreadsheet program."
        raise unreadable(path, unread.place, "a value", unread.unread, remedy)
    filled = [row for row in cells if any(cell.text for cell in row)]
    first = next((i for i, row in enumerate(filled) if _is_sample(row)), None)
    if first is None:
        remedy = "Give deflection and force in two columns, one row per point."
        raise unreadable(path, "", "rows of numbers", "none", remedy)
    above = filled[:first]
    units: tuple[str, ...] = ()
    if len(above) > 1 and are_units([cell.text for cell in above[-1]]):
        units = tuple(without_brackets(cell.text) for cell in above.pop())
    names = _without_mark(above[-1]) if above else ()
    width = max(len(row) for row in filled[first:])
    return CurveTable(path, names, (*units, *[""] * max(width, len(names))), filled[first:])


def _without_mark(row: Sequence[Cell]) -> Row:
    """A heading without the mark of a comment before it."""
    bare = Cell(row[0].text.lstrip("# "), row[0].place)
    return (bare, *row[1:]) if bare.text else tuple(row[1:])


def _text_cells(path: Path) -> list[list[Cell]]:
    content = read_content(path)
    if is_binary(content):
        remedy = "Save the curve as csv or xlsx."
        raise unreadable(path, "", "a table as text, or an xlsx workbook", "other bytes", remedy)
    lines = lines_of(decode(content.data, content, _ENCODINGS, path))
    if is_calculix(lines):
        return tip_rows(lines, path)
    for separator in _SEPARATORS:
        rows = (_placed(split_line(line, separator), i) for i, line in enumerate(lines, start=1))
        head = list(islice(rows, _HEAD))
        if any(_is_sample(row) for row in head):
            return [*head, *rows]
    return []


def _placed(cells: Sequence[str], line: int) -> list[Cell]:
    return [Cell(text.strip(), f"line {line}, column {i}") for i, text in enumerate(cells, start=1)]


def _is_sample(row: Sequence[Cell]) -> bool:
    filled = [cell.text for cell in row if cell.text]
    return len(filled) > 1 and all(is_number(text) or _is_not_finite(text) for text in filled)


def _is_not_finite(text: str) -> bool:
    return text.lstrip("+-").casefold() in _NOT_FINITE


def _points(table: CurveTable, columns: Sequence[int]) -> list[list[Cell]]:
    """Two cells for each row that has some, numbers of one decimal sign."""
    points = []
    for row in table.rows:
        blank = Cell("", row[0].place.partition(",")[0])
        point = [row[at] if at < len(row) else blank for at in columns]
        if any(cell.text for cell in point):
            points.append(point)
    if len(points) < FEWEST:
        expected, remedy = f"{FEWEST} points at least", "Give more points of the curve."
        raise unreadable(table.path, "", expected, f"{len(points)}", remedy)
    texts = [cell for point in points for cell in point]
    if any("." in cell.text for cell in texts):
        for cell in texts:
            if "," in cell.text:
                remedy = "Write the file anew with one decimal sign and no sign for thousands."
                expected, found = "a decimal point, as elsewhere in the file", repr(cell.text)
                raise unreadable(table.path, cell.place, expected, found, remedy)
    return points


def _number(cell: Cell, path: Path) -> float:
    sign = "," if "," in cell.text else "."
    if PLAIN[sign].fullmatch(cell.text) and math.isfinite(float(cell.text.replace(",", "."))):
        return float(cell.text.replace(",", "."))
    found = repr(cell.text) if cell.text else "a blank cell"
    remedy = "Correct the row, or take it out."
    if is_grouped(cell.text):
        remedy = "Write the file anew without signs between thousands."
    raise unreadable(path, cell.place, "a finite number", found, remedy)


def _check_order(path: Path, points: Sequence[Sequence[Cell]], deflection: Floats) -> None:
    """Refuse a curve that turns back or has two forces at one deflection."""
    for number, (before, here) in enumerate(pairwise(deflection.tolist()), start=1):
        if here <= before:
            remedy = "Keep the first loading alone, its points in order, each deflection once."
            if deflection[-1] < deflection[0]:
                remedy = "If the file counts downwards, write 'sign: -1' for the deflection."
            expected = f"a deflection above the one before ({1e3 * before:.6g} mm)"
            found = f"{1e3 * here:.6g} mm"
            raise unreadable(path, points[number][0].place, expected, found, remedy)


def _check_sign(path: Path, points: Sequence[Sequence[Cell]], force: Floats) -> None:
    """Refuse a curve whose largest force pushes back."""
    at = int(np.argmax(np.abs(force)))
    if force[at] <= 0.0:
        expected, found = "a largest force above zero", f"{force[at]:.6g} N"
        remedy = "If the file counts downwards, write 'sign: -1' for the force."
        raise unreadable(path, points[at][1].place, expected, found, remedy)
