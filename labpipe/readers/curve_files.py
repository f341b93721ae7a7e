"""Reader of external force-displacement curves: two columns of a text file or a workbook.

Writes these files: a finite-element program, a program that digitises figures, another lab.

Units: in the heading (``deflection / mm``, ``force [N]``, ``deflection_mm``), in a row of units
below it, or stated by the caller. Contradicting units are refused.

Missing data: a row in which both cells are blank is skipped, as in files with curves of different
lengths side by side. One blank cell is refused.

File structure: cells separated by tabulator, semicolon, comma or blanks, whichever splits the first
rows into numbers; decimal point or comma, the same in the whole file. Rows above the names are
skipped. A file without names is read if its columns are numbered. Of a workbook, the first sheet.
An incomplete last line without line end (`number_table.whole_lines`) is refused, as are words among
the numbers: a curve has no notes, and its last point is often its largest force.

A file that CalculiX CrunchiX (``ccx``, ending ``.dat``, known version 2.20) printed is read
directly: deflection and force of a pushed tip at each increment, from ``*NODE PRINT`` of ``U``
and, with ``TOTALS=ONLY``, of ``RF``, as in the deck that `labpipe model` writes. Its units are
those of the deck, which the file does not state; decks of labpipe are in m and N. It contains
blocks, each under a heading with the quantity, the set of nodes and the time, such
as ``displacements (vx,vy,vz) for set TIPHALF and time  0.1250000E-01``. Displacements
have one line per node, its number first; the total force has one line. The deflection is the mean
of the second component, along y; the force is its second component. The force of a set whose name
ends in HALF counts twice: it is that of a half model.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from labpipe.errors import nearest
from labpipe.readers.number_table import Body, read_columns, sheet_text
from labpipe.readers.raw_files import decode, is_binary, lines_of, read_content, unreadable
from labpipe.readers.sheet_cells import workbook_cells
from labpipe.readers.text_cells import (
    NUMERAL,
    are_units,
    has_dimension_of,
    is_sample,
    is_unit,
    name_and_unit,
    split_line,
    without_brackets,
)
from labpipe.readers.workbooks import is_workbook, open_sheets
from labpipe.records.arrays import Floats
from labpipe.units import si_factor, whole_number

__all__ = ["CurveColumn", "read_curve"]

MIN_CURVE_POINTS = 3
"""Points of a curve."""
_ENCODINGS = ("utf-8", "latin-1")
_USUAL_NAMES = {
    "deflection": ("deflection", "tip deflection", "displacement", "tip displacement"),
    "force": ("force", "tip force"),
}
"""Usual names of the columns."""
HALF_MODEL_SUFFIX = "HALF"
"""Suffix of the name of a set whose force is that of a half model."""
_HEADING = re.compile(r"\s*+([^\s(][^(]*)\((\w+,\w+,\w+)\) for set (\S+) and time\s++(\S+)\s*+")
_DEFLECTION, _FORCE = "displacements", "total force"
_RUN_AGAIN = "Run ccx again; the file may have been cut off."
_PRINT_REMEDY = (
    "Print U, and RF with TOTALS=ONLY, of one set of nodes, as the deck of labpipe does."
)


@dataclass(frozen=True, slots=True)
class CurveColumn:
    """A wanted column.

    Parameters
    ----------
    what : ``deflection`` or ``force``
    si_unit : unit of the result
    column : its name, or its number counted from 1; None for the usual name
    unit : unit in the file; None for that in the heading
    sign : -1 if the file counts against the direction of bending
    """

    what: str
    si_unit: str
    column: str | None = None
    unit: str | None = None
    sign: int = 1

    @property
    def example(self) -> str:
        """Return a usual unit."""
        return "mm" if self.si_unit == "m" else "N"


@dataclass(frozen=True, slots=True)
class _Table:
    """The columns of a file.

    Parameters
    ----------
    path : of the file
    names : of the columns, with their units; empty without any
    units : of the row of units; empty texts without one
    head : place of the names, or of the first row
    body : the rows of samples
    """

    path: Path
    names: Sequence[str]
    units: Sequence[str]
    head: str
    body: Body


def read_curve(path: Path, deflection: CurveColumn, force: CurveColumn) -> tuple[Floats, Floats]:
    """Read a loading curve.

    Parameters
    ----------
    path : text or xlsx
    deflection, force : the columns

    Returns
    -------
    Deflection (m), increasing from row to row, and force (N), both of shape (n,).

    Raises
    ------
    ReadError
        If the file, a column or a unit is missing, a cell contains no finite number, a deflection
        is not above the one before, the largest force is negative, or there are fewer than 3
        points.
    """
    table = _sheet_table(path) if is_workbook(path) else _text_table(path)
    wanted = (deflection, force)
    columns = [_find_column(table, column) for column in wanted]
    if columns[0] == columns[1]:
        found, remedy = f"column {columns[0] + 1} for both", "Name another one for the force."
        raise unreadable(path, table.head, "two columns", found, remedy)
    factors = [_unit_factor(table, i, column) for i, column in zip(columns, wanted, strict=True)]
    rows, points = _points(table, columns)
    places = [[f"{table.body.place(row)}, column {i + 1}" for i in columns] for row in rows]
    across, up = (
        column.sign * factor * values
        for column, factor, values in zip(wanted, factors, points, strict=True)
    )
    turns = np.flatnonzero(np.diff(across) <= 0.0)
    if len(turns):
        remedy = "Keep the first loading only, its points in order, each deflection once."
        if across[-1] < across[0]:
            remedy = "If the file counts downwards, write 'sign: -1' for the deflection."
        before, here = (1e3 * across[turns[0] + i] for i in (0, 1))
        expected = f"a deflection above the one before ({before:.6g} mm)"
        raise unreadable(path, places[turns[0] + 1][0], expected, f"{here:.6g} mm", remedy)
    top = int(np.argmax(np.abs(up)))
    if up[top] <= 0.0:
        remedy = "If the file counts downwards, write 'sign: -1' for the force."
        expected, found = "a largest force above zero", f"{up[top]:.6g} N"
        raise unreadable(path, places[top][1], expected, found, remedy)
    return across, up


def _sheet_table(path: Path) -> _Table:
    unread = next((cell for row in workbook_cells(path) for cell in row if cell.unread), None)
    if unread is not None:
        remedy = "Correct the cell, and save the workbook in the spreadsheet program."
        raise unreadable(path, unread.place, "a value", unread.unread, remedy)
    name, rows = next(iter(open_sheets(path).items()))
    return _table(lines_of(sheet_text(rows)), "\t", path, f"sheet '{name}'")


def _text_table(path: Path) -> _Table:
    content = read_content(path)
    if is_binary(content):
        remedy = "Save the curve as csv or xlsx."
        raise unreadable(path, "", "a table as text, or an xlsx workbook", "other bytes", remedy)
    lines = lines_of(decode(content.data, content, _ENCODINGS, path))
    if is_calculix(lines):
        lines = _tip_lines(lines, path)
    return _table(lines, "\t;, ", path)


def _table(lines: Sequence[str], separators: str, path: Path, sheet: str = "") -> _Table:
    # Lines in which the first row of numbers is searched.
    head_lines = 400
    for separator in separators:
        rows = [
            [cell.strip() for cell in split_line(line, separator)] for line in lines[:head_lines]
        ]
        first = next(
            (i for i, row in enumerate(rows) if sum(map(bool, row)) > 1 and is_sample(row)), None
        )
        if first is not None:
            break
    else:
        remedy = "Give deflection and force in two columns, one row per point."
        raise unreadable(path, "", "rows of numbers", "none", remedy)
    above = [i for i, row in enumerate(rows[:first]) if any(row)]
    units: list[str] = []
    if len(above) > 1 and are_units(rows[above[-1]]):
        units = [without_brackets(cell) for cell in rows[above.pop()]]
    names = rows[above[-1]] if above else []
    if names:  # a comment mark may stand before them
        names[:1] = [names[0].lstrip("# ")] if names[0].lstrip("# ") else []
    width = max(len(rows[first]), len(names))
    body = Body(
        data="\n".join(lines[first:]).encode(),
        names=[*names, *[""] * (width - len(names))],
        columns=(),
        first_line=first + 1,
        separator=separator,
        sheet=sheet,
    )
    head = body.place((above[-1] if above else first) - first)
    return _Table(path, names, [*units, *[""] * (width - len(units))], head, body)


def _points(table: _Table, columns: Sequence[int]) -> tuple[list[int], list[Floats]]:
    """Return the rows with values, and both columns."""
    body = replace(table.body, columns=sorted(columns))
    arrays, notes = read_columns(body, table.path)
    for note in notes:
        if note.code == "truncated":
            remedy = "Export the curve again; if the line is complete, add a line end."
            expected = "a complete last line; the numbers above it are longer"
            place = body.place(body.data.count(b"\n"))
            found = repr(body.data[body.data.rfind(b"\n") + 1 :].decode()[-60:])
            raise unreadable(table.path, place, expected, found, remedy)
        if note.code != "lines_short":
            remedy = "Correct the rows, or remove them."
            raise unreadable(table.path, "", "rows of finite numbers", note.message, remedy)
    points = [arrays[i] for i in columns]
    blank = np.isnan(points)
    half = np.flatnonzero(blank[0] != blank[1])
    if len(half):
        place = f"{body.place(int(half[0]))}, column {columns[int(blank[1, half[0]])] + 1}"
        remedy = "Correct the row, or remove it."
        raise unreadable(table.path, place, "a finite number", "a blank cell", remedy)
    rows = np.flatnonzero(~blank[0])
    if len(rows) < MIN_CURVE_POINTS:
        expected, remedy = f"at least {MIN_CURVE_POINTS} points", "Give more points of the curve."
        raise unreadable(table.path, "", expected, f"{len(rows)}", remedy)
    return rows.tolist(), [values[rows] for values in points]


def _find_column(table: _Table, wanted: CurveColumn) -> int:
    """Return the index of a column by its name, or by its number if none has that name."""
    names = _USUAL_NAMES[wanted.what] if wanted.column is None else (wanted.column,)
    spellings = {name.strip().casefold() for name in names}
    matches = [
        i
        for i, name in enumerate(table.names)
        if spellings & {name.casefold(), _split_unit(name, wanted.si_unit)[0].casefold()}
    ]
    if len(matches) == 1:
        return matches[0]
    if matches:
        text = f"{len(matches)}: columns {', '.join(str(i + 1) for i in matches)}"
        remedy = "Give the number of the right one."
        raise unreadable(table.path, table.head, f"one column {names[0]!r}", text, remedy)
    width = len(table.units)
    number = whole_number(wanted.column or "")
    if number is not None and 1 <= number <= width:
        return number - 1
    if not table.names:
        remedy = f"Number it in the plan, such as {wanted.what}: {{column: 1, unit: mm}}."
        expected = f"a row of names above the numbers, with a column {names[0]!r}"
        raise unreadable(table.path, table.head, expected, "numbers alone", remedy)
    remedy = f"Name it in the plan, such as {wanted.what}: {{column: U2, unit: {wanted.example}}}."
    found = ", ".join(repr(name) for name in nearest(names[0], [*filter(None, table.names)]))
    raise unreadable(table.path, table.head, f"a column {names[0]!r}", found, remedy)


def _split_unit(text: str, si_unit: str) -> tuple[str, str]:
    """Return name and unit of a heading; the unit is empty if there is none.

    After an underscore only a unit of the wanted dimension counts: ``deflection_mm``, but not
    ``force_m``.
    """
    pair = name_and_unit(text)
    if pair is not None and is_unit(pair[1]):
        return pair
    name, _, tail = text.rpartition("_")
    return (name, tail) if name and tail and has_dimension_of(tail, si_unit) else (text, "")


def _unit_factor(table: _Table, at: int, wanted: CurveColumn) -> float:
    """Return the factor from the unit of a column to SI; refuse units that contradict."""
    head = table.names[at] if at < len(table.names) else ""
    stated = _split_unit(head, wanted.si_unit)[1] or table.units[at]
    place = f"{table.head}, column {at + 1}"
    unit = wanted.unit or stated
    if not unit:
        expected = f"a unit of the {wanted.what}"
        remedy = f"Write it in the heading ({wanted.what} / {wanted.example}) or in the plan."
        raise unreadable(table.path, place, expected, f"none in {head!r}", remedy)
    for text in {unit, stated or unit}:
        if not has_dimension_of(text, wanted.si_unit):
            expected = f"a unit of the {wanted.what}, such as {wanted.example}"
            raise unreadable(table.path, place, expected, f"{text!r}", "Correct the heading.")
    factor = si_factor(unit, wanted.si_unit)
    if stated and not math.isclose(si_factor(stated, wanted.si_unit), factor):
        remedy = "Correct the one that is wrong."
        raise unreadable(table.path, place, f"{unit!r}, as in the plan", f"{stated!r}", remedy)
    return factor


class _Block(NamedTuple):
    """The mean of the second component below one heading."""

    quantity: str
    set_name: str
    time: str
    line: int
    value: float


def is_calculix(lines: Sequence[str]) -> bool:
    """Return whether the first non-blank line is a heading of CalculiX.

    Parameters
    ----------
    lines : of the file
    """
    return _HEADING.fullmatch(next((line for line in lines if line.strip()), "")) is not None


def _tip_lines(lines: Sequence[str], path: Path) -> list[str]:
    """Return lines of deflection and force of the tip, with units and line numbers of the file."""
    blocks = list(_blocks(lines, path))
    names = sorted({block.set_name for block in blocks})
    if len(names) > 1:
        raise unreadable(path, "", "one set of nodes", ", ".join(names), _PRINT_REMEDY)
    deflections, forces = (
        [block for block in blocks if block.quantity == quantity]
        for quantity in (_DEFLECTION, _FORCE)
    )
    for quantity, printed in ((_DEFLECTION, deflections), (_FORCE, forces)):
        if not printed:
            found = f"only {', '.join(sorted({block.quantity for block in blocks}))}"
            raise unreadable(path, "", f"blocks '{quantity}'", found, _PRINT_REMEDY)
    times = [[block.time for block in printed] for printed in (deflections, forces)]
    for block in (*deflections, *forces):
        if not all(block.time in others for others in times):
            expected = f"displacements and total force at time {block.time}"
            found = f"only {block.quantity}"
            raise unreadable(path, f"line {block.line}", expected, found, _RUN_AGAIN)
    if times[0] != times[1]:
        found = f"{len(deflections)} and {len(forces)} in another order"
        raise unreadable(path, "", "displacements and total force in turn", found, _RUN_AGAIN)
    share = 2.0 if names[0].upper().endswith(HALF_MODEL_SUFFIX) else 1.0
    table = [""] * (len(lines) + 1)
    table[0] = "deflection / m\tforce / N"
    for u, f in zip(deflections, forces, strict=True):
        table[u.line - 1] = f"{u.value:.9g}\t{share * f.value:.9g}"
    return table


def _blocks(lines: Sequence[str], path: Path) -> Iterator[_Block]:
    """Yield the blocks, each with at least one line of numbers."""
    headings = [(i, match) for i, line in enumerate(lines) if (match := _HEADING.fullmatch(line))]
    ends = [*(i for i, _ in headings[1:]), len(lines)]
    for (start, match), end in zip(headings, ends, strict=True):
        quantity, _, set_name, time = (group.strip() for group in match.groups())
        second = 2 if quantity != _FORCE else 1  # behind the number of the node
        values, filled = [], [i for i in range(start + 1, end) if lines[i].strip()]
        if not filled:
            expected = f"numbers under '{quantity}'"
            raise unreadable(path, f"line {start + 1}", expected, "none", _RUN_AGAIN)
        for i in filled:
            cells = lines[i].split()
            # Exponents of very small numbers beside it may lack the letter.
            if len(cells) != second + 2 or not NUMERAL["."].fullmatch(cells[second]):
                found = repr(lines[i].strip()[:60])
                raise unreadable(path, f"line {i + 1}", f"{second + 2} numbers", found, _RUN_AGAIN)
            values.append(float(cells[second]))
        yield _Block(quantity, set_name, time, filled[0] + 1, sum(values) / len(values))
