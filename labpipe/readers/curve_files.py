"""Reader of external force-displacement curves: two columns of a text file or a workbook.

Writes these files: a finite-element program, a program that digitises figures, another lab.

Units: in the heading (``deflection / mm``, ``force [N]``, ``deflection_mm``), in a row of units
below it, or stated by the caller. Contradicting units are refused.

Missing data: a row in which both cells are blank is skipped, as in files with curves of different
lengths side by side. One blank cell is refused.

File structure: cells separated by tabulator, semicolon, comma or blanks, whichever splits the first
rows into numbers; decimal point or comma, the same in the whole file. Rows above the names are
skipped. A file without names is read if its columns are numbered. Of a workbook, the first sheet.
An incomplete last line without line end (`table_body.whole_lines`) is refused: a curve has no
notes, and its last point is often its largest force.

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
from dataclasses import dataclass
from itertools import islice, pairwise
from pathlib import Path

import numpy as np

from labpipe.errors import ReadError, nearest
from labpipe.readers.raw_files import (
    decode,
    is_binary,
    line_start,
    lines_of,
    read_content,
    unreadable,
)
from labpipe.readers.sheet_cells import Cell, Row, workbook_cells
from labpipe.readers.table_body import Body, whole_lines
from labpipe.readers.text_cells import (
    NUMERAL,
    are_units,
    is_grouped,
    is_number,
    is_unit,
    name_and_unit,
    split_line,
    without_brackets,
)
from labpipe.readers.workbooks import is_workbook
from labpipe.records.arrays import Floats
from labpipe.units import si_factor, whole_number

__all__ = ["CurveColumn", "read_curve"]

_SEPARATORS = ("\t", ";", ",", " ")
_ENCODINGS = ("utf-8", "latin-1")
_NOT_FINITE = frozenset({"nan", "inf", "infinity"})
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
    table = _table(path)
    wanted = (deflection, force)
    columns = [find_column(table, column) for column in wanted]
    if columns[0] == columns[1]:
        place = f"column {columns[0] + 1} for both"
        raise unreadable(
            path, head_of(table), "two columns", place, "Name another one for the force."
        )
    factors = [
        unit_factor(table, index, column) for index, column in zip(columns, wanted, strict=True)
    ]
    points = _points(table, columns)
    across, up = (
        column.sign * factor * np.array([_number(point[i], path) for point in points])
        for i, (column, factor) in enumerate(zip(wanted, factors, strict=True))
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
    """Return a heading without a comment mark before it."""
    bare = Cell(row[0].text.lstrip("# "), row[0].place)
    return (bare, *row[1:]) if bare.text else tuple(row[1:])


def _text_cells(path: Path) -> list[list[Cell]]:
    # Lines in which the first row of numbers is searched.
    head_lines = 400
    content = read_content(path)
    if is_binary(content):
        remedy = "Save the curve as csv or xlsx."
        raise unreadable(path, "", "a table as text, or an xlsx workbook", "other bytes", remedy)
    lines = lines_of(decode(content.data, content, _ENCODINGS, path))
    if is_calculix(lines):
        return tip_rows(lines, path)
    for separator in _SEPARATORS:
        rows = (_cells(split_line(line, separator), i) for i, line in enumerate(lines, start=1))
        head = list(islice(rows, head_lines))
        first = next((i for i, row in enumerate(head) if _is_sample(row)), None)
        if first is not None:
            names, start = [cell.text for cell in head[first]], line_start(content.data, first)
            columns = range(len(names))
            body = Body(content.data, names, columns, first + 1, separator, start=start)
            if whole_lines(body)[1]:
                expected = "a complete last line; the numbers above it are longer"
                remedy = "Export the curve again; if the line is complete, add a line end."
                found = repr(lines[-1][-60:])
                raise unreadable(path, f"line {len(lines)}", expected, found, remedy)
            return [*head, *rows]
    return []


def _cells(cells: Sequence[str], line: int) -> list[Cell]:
    return [Cell(text.strip(), f"line {line}, column {i}") for i, text in enumerate(cells, start=1)]


def _is_sample(row: Sequence[Cell]) -> bool:
    filled = [cell.text for cell in row if cell.text]
    return len(filled) > 1 and all(is_number(text) or _is_not_finite(text) for text in filled)


def _is_not_finite(text: str) -> bool:
    return text.lstrip("+-").casefold() in _NOT_FINITE


def _points(table: CurveTable, columns: Sequence[int]) -> list[list[Cell]]:
    """Return the two cells of each row with values, with one decimal sign."""
    min_curve_points = 3  # points of a curve
    points = []
    for row in table.rows:
        blank = Cell("", row[0].place.partition(",")[0])
        point = [row[index] if index < len(row) else blank for index in columns]
        if any(cell.text for cell in point):
            points.append(point)
    if len(points) < min_curve_points:
        expected, remedy = f"at least {min_curve_points} points", "Give more points of the curve."
        raise unreadable(table.path, "", expected, f"{len(points)}", remedy)
    texts = [cell for point in points for cell in point]
    if any("." in cell.text for cell in texts):
        for cell in texts:
            if "," in cell.text:
                remedy = "Write the file again with one decimal sign and no thousands separator."
                expected, found = "a decimal point, as elsewhere in the file", repr(cell.text)
                raise unreadable(table.path, cell.place, expected, found, remedy)
    return points


def _number(cell: Cell, path: Path) -> float:
    sign = "," if "," in cell.text else "."
    if NUMERAL[sign].fullmatch(cell.text) and math.isfinite(float(cell.text.replace(",", "."))):
        return float(cell.text.replace(",", "."))
    found = repr(cell.text) if cell.text else "a blank cell"
    remedy = "Correct the row, or remove it."
    if is_grouped(cell.text):
        remedy = "Write the file again without thousands separators."
    raise unreadable(path, cell.place, "a finite number", found, remedy)


def _check_order(path: Path, points: Sequence[Sequence[Cell]], deflection: Floats) -> None:
    """Refuse a curve that turns back or has two forces at one deflection."""
    for number, (previous, current) in enumerate(pairwise(deflection.tolist()), start=1):
        if current <= previous:
            remedy = "Keep the first loading only, its points in order, each deflection once."
            if deflection[-1] < deflection[0]:
                remedy = "If the file counts downwards, write 'sign: -1' for the deflection."
            expected = f"a deflection above the one before ({1e3 * previous:.6g} mm)"
            found = f"{1e3 * current:.6g} mm"
            raise unreadable(path, points[number][0].place, expected, found, remedy)


def _check_sign(path: Path, points: Sequence[Sequence[Cell]], force: Floats) -> None:
    """Refuse a curve whose largest force is negative."""
    peak = int(np.argmax(np.abs(force)))
    if force[peak] <= 0.0:
        expected, found = "a largest force above zero", f"{force[peak]:.6g} N"
        remedy = "If the file counts downwards, write 'sign: -1' for the force."
        raise unreadable(path, points[peak][1].place, expected, found, remedy)


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


@dataclass(frozen=True, slots=True)
class CurveTable:
    """Cells below their headings.

    Parameters
    ----------
    path : of the file
    names : of the columns, with their units; empty without any
    units : of the row of units; empty texts without one
    rows : rows of samples and those among them
    """

    path: Path
    names: Row
    units: tuple[str, ...]
    rows: Sequence[Sequence[Cell]]


def head_of(table: CurveTable) -> str:
    """Return the place of the names, or of the first row."""
    row = table.names or table.rows[0]
    return row[0].place.partition(",")[0]


def find_column(table: CurveTable, wanted: CurveColumn) -> int:
    """Find a column by its name, or by its number if none has that name.

    Parameters
    ----------
    table : cells of the file
    wanted : the column

    Returns
    -------
    Its number, counted from 0.

    Raises
    ------
    ReadError
        If there is none, or several have the name.
    """
    names = _USUAL_NAMES[wanted.what] if wanted.column is None else (wanted.column,)
    spellings = {name.strip().casefold() for name in names}
    matches = [
        i
        for i, cell in enumerate(table.names)
        if spellings & {cell.text.casefold(), _split_unit(cell.text, wanted.si_unit)[0].casefold()}
    ]
    if len(matches) == 1:
        return matches[0]
    if matches:
        text = f"{len(matches)}: columns {', '.join(str(i + 1) for i in matches)}"
        remedy = "Give the number of the right one."
        raise unreadable(table.path, head_of(table), f"one column {names[0]!r}", text, remedy)
    width = len(table.units)
    number = whole_number(wanted.column or "")
    if number is not None and 1 <= number <= width:
        return number - 1
    raise _no_column(table, wanted, names[0])


def _no_column(table: CurveTable, wanted: CurveColumn, name: str) -> ReadError:
    place = head_of(table)
    example = f"{wanted.what}: {{column: U2, unit: {_example(wanted)}}}"
    remedy = f"Name it in the plan, such as {example}."
    if not table.names:
        remedy = f"Number it in the plan, such as {wanted.what}: {{column: 1, unit: mm}}."
        expected = f"a row of names above the numbers, with a column {name!r}"
        return unreadable(table.path, place, expected, "numbers alone", remedy)
    column_names = [cell.text for cell in table.names if cell.text]
    nearest_names = ", ".join(repr(name) for name in nearest(name, column_names))
    return unreadable(table.path, place, f"a column {name!r}", nearest_names, remedy)


def _example(wanted: CurveColumn) -> str:
    return "mm" if wanted.si_unit == "m" else "N"


def _split_unit(text: str, si_unit: str) -> tuple[str, str]:
    """Return name and unit of a heading; the unit is empty if there is none.

    After an underscore only a unit of the wanted dimension counts: ``deflection_mm``, but not
    ``force_m``.
    """
    pair = name_and_unit(text)
    if pair is not None and is_unit(pair[1]):
        return pair
    name, _, tail = text.rpartition("_")
    return (name, tail) if name and _is_convertible(tail, si_unit) else (text, "")


def _is_convertible(unit: str, si_unit: str) -> bool:
    try:
        si_factor(unit, si_unit)
    except ValueError:
        return False
    return bool(unit)


def unit_factor(table: CurveTable, index: int, wanted: CurveColumn) -> float:
    """Return the factor from the unit of a column to SI.

    Parameters
    ----------
    table : cells of the file
    index : number of the column, counted from 0
    wanted : the column, with its unit if the plan states it

    Raises
    ------
    ReadError
        If the unit is not stated, is of another dimension, or plan and heading differ.
    """
    head = table.names[index].text if index < len(table.names) else ""
    stated = _split_unit(head, wanted.si_unit)[1] or table.units[index]
    place = f"{head_of(table)}, column {index + 1}"
    unit = wanted.unit or stated
    if not unit:
        expected = f"a unit of the {wanted.what}"
        remedy = f"Write it in the heading ({wanted.what} / {_example(wanted)}) or in the plan."
        raise unreadable(table.path, place, expected, f"none in {head!r}", remedy)
    for text in {unit, stated or unit}:
        if not _is_convertible(text, wanted.si_unit):
            expected = f"a unit of the {wanted.what}, such as {_example(wanted)}"
            raise unreadable(table.path, place, expected, f"{text!r}", "Correct the heading.")
    factor = si_factor(unit, wanted.si_unit)
    if stated and not math.isclose(si_factor(stated, wanted.si_unit), factor):
        remedy = "Correct the one that is wrong."
        raise unreadable(table.path, place, f"{unit!r}, as in the plan", f"{stated!r}", remedy)
    return factor


@dataclass(frozen=True, slots=True)
class _Block:
    """The values below one heading, of the second component."""

    quantity: str
    set_name: str
    time: str
    line: int
    values: tuple[float, ...]


def is_calculix(lines: Sequence[str]) -> bool:
    """Return whether the first non-blank line is a heading of CalculiX.

    Parameters
    ----------
    lines : of the file
    """
    return _HEADING.fullmatch(next((line for line in lines if line.strip()), "")) is not None


def tip_rows(lines: Sequence[str], path: Path) -> list[list[Cell]]:
    """Return deflection and force of the tip.

    Parameters
    ----------
    lines : of the file
    path : named in errors

    Returns
    -------
    A row of headings with their units, and one row per increment.

    Raises
    ------
    ReadError
        If one of the two is missing, their times differ, there is more than one set of nodes, or a
        line under a heading is not numeric.
    """
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
            others = ", ".join(sorted({block.quantity for block in blocks}))
            raise unreadable(path, "", f"blocks '{quantity}'", f"only {others}", _PRINT_REMEDY)
    _require_pairs(path, deflections, forces)
    times = 2.0 if names[0].upper().endswith(HALF_MODEL_SUFFIX) else 1.0
    heading = [Cell(name, "line 1") for name in ("deflection / m", "force / N")]
    rows = [
        [_cell(sum(u.values) / len(u.values), u), _cell(times * f.values[0], f)]
        for u, f in zip(deflections, forces, strict=True)
    ]
    return [heading, *rows]


def _cell(value: float, block: _Block) -> Cell:
    return Cell(f"{value:.9g}", f"line {block.line}")


def _blocks(lines: Sequence[str], path: Path) -> Iterator[_Block]:
    """Yield the blocks, each with at least one line of numbers."""
    headings = [(i, match) for i, line in enumerate(lines) if (match := _HEADING.fullmatch(line))]
    ends = [*(i for i, _ in headings[1:]), len(lines)]
    for (start, match), end in zip(headings, ends, strict=True):
        quantity, _, set_name, time = (group.strip() for group in match.groups())
        at_second = 2 if quantity != _FORCE else 1
        filled = [i for i in range(start + 1, end) if lines[i].strip()]
        values = tuple(
            _second_component(lines[i], at_second, f"line {i + 1}", path) for i in filled
        )
        if not values:
            expected = f"numbers under '{quantity}'"
            raise unreadable(path, f"line {start + 1}", expected, "none", _RUN_AGAIN)
        yield _Block(quantity, set_name, time, filled[0] + 1, values)


def _second_component(line: str, index: int, place: str, path: Path) -> float:
    """Return the second component. Exponents of very small ones may lack the letter."""
    cells = line.split()
    try:
        if len(cells) == index + 2:
            return float(cells[index])
    except ValueError:
        pass
    expected = f"{index + 2} numbers"
    raise unreadable(path, place, expected, repr(line.strip()[:60]), _RUN_AGAIN)


def _require_pairs(path: Path, deflections: Sequence[_Block], forces: Sequence[_Block]) -> None:
    """Refuse deflections without forces, and vice versa."""
    deflection_times = [block.time for block in deflections]
    force_times = [block.time for block in forces]
    unpaired = next((block for block in deflections if block.time not in force_times), None)
    unpaired = unpaired or next(
        (block for block in forces if block.time not in deflection_times), None
    )
    if unpaired is not None:
        expected = f"displacements and total force at time {unpaired.time}"
        raise unreadable(
            path, f"line {unpaired.line}", expected, f"only {unpaired.quantity}", _RUN_AGAIN
        )
    if deflection_times != force_times:
        found = f"{len(deflection_times)} and {len(force_times)} in another order"
        raise unreadable(path, "", "displacements and total force in turn", found, _RUN_AGAIN)
