"""Read external force-displacement curves: two columns of a text file or a workbook.

Writes these files: a finite-element program, a program that digitises figures, another lab.

Units: in the heading (``deflection / mm``, ``force [N]``, ``deflection_mm``), in a row of units
below it, or stated by the caller. Contradicting units are refused.

Missing data: a row in which both cells are blank is skipped, as in files with curves of different
lengths side by side. One blank cell is refused.

File structure: cells separated by tabulator, semicolon, comma or blanks, whichever splits the first
rows into numbers; decimal point or comma, the same in the whole file. Rows above the names are
skipped. A file without names is read if the caller states the numbers of the columns. Of a
workbook, the first sheet is read.
An incomplete last line without line end is refused, and so is text among the numbers: a curve has
no notes, and its last point often has the largest force.

A file that CalculiX CrunchiX (``ccx``, ending ``.dat``, known version 2.20) printed is read
directly: deflection and force of a pushed tip at each increment, from ``*NODE PRINT`` of ``U``
and, with ``TOTALS=ONLY``, of ``RF``, as in the deck that `labpipe model` writes. Its units are
those of the deck, which the file does not state; decks of labpipe are in m and N. The file
contains blocks, each under a heading with the quantity, the set of nodes and the time, such
as ``displacements (vx,vy,vz) for set TIPHALF and time  0.1250000E-01``. Displacements
have one line per node, its number first; the total force has one line. The deflection is the mean
of the second component, along y; the force is its second component. If the name of the set ends in
HALF, the force counts twice: it is that of a half model.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from labpipe.errors import sort_by_likeness
from labpipe.readers.number_table import (
    NUMERAL,
    Body,
    are_units,
    has_dimension_of,
    is_unit,
    read_columns,
    split_head,
    split_name_and_unit,
    strip_brackets,
)
from labpipe.readers.raw_files import (
    ContentError,
    add_file_name,
    decode,
    is_binary,
    read_content,
    split_lines,
)
from labpipe.readers.workbooks import format_rows, is_workbook, open_sheets, read_workbook_cells
from labpipe.records.arrays import Floats
from labpipe.units import get_conversion_factor, parse_count

__all__ = ["CurveColumn", "read_curve"]

MIN_CURVE_POINTS = 3
"""Smallest number of points of a curve."""
_USUAL_NAMES = {
    "deflection": ("deflection", "tip deflection", "displacement", "tip displacement"),
    "force": ("force", "tip force"),
}
"""Usual names of the columns."""
HALF_MODEL_SUFFIX = "HALF"
"""Suffix of the name of a set with the force of a half model."""
_HEADING = re.compile(r"\s*+([^\s(][^(]*)\((\w+,\w+,\w+)\) for set (\S+) and time\s++(\S+)\s*+")
_DEFLECTION, _FORCE = "displacements", "total force"


@dataclass(frozen=True, slots=True)
class CurveColumn:
    """A wanted column.

    Parameters
    ----------
    quantity : ``deflection`` or ``force``
    si_unit : SI unit of the quantity
    column : name of the column, or its number counted from 1; None for the usual name
    unit : unit in the file; None for that in the heading
    sign : -1 if the values of the file are negative in the direction of bending
    """

    quantity: str
    si_unit: str
    column: str | None = None
    unit: str | None = None
    sign: int = 1

    @property
    def example(self) -> str:
        """Usual unit of the quantity, for messages."""
        return "mm" if self.si_unit == "m" else "N"


@dataclass(frozen=True, slots=True)
class _Table:
    """The columns of a file.

    Parameters
    ----------
    units : cells of the row of units, one for each column; empty without such a row
    head_place : place of the row of names or, without names, of the first row, for messages
    body : rows of samples, with the names of the columns
    """

    units: Sequence[str]
    head_place: str
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
        is not above the one before, the force of largest magnitude is not positive, or there are
        fewer than 3 points.
    """
    with add_file_name(path):
        if is_workbook(path):
            cells = (cell for row in read_workbook_cells(path) for cell in row)
            if faulty_cell := next((cell for cell in cells if cell.fault), None):
                place, fault = faulty_cell.place, faulty_cell.fault
                raise ContentError.of("readers.cell_without_value", place, why=fault)
            name, rows = next(iter(open_sheets(path).items()))
            table = _find_table(split_lines(format_rows(rows)), "\t", f"sheet '{name}'")
        else:
            content = read_content(path)
            if is_binary(content):
                raise ContentError.of("readers.binary_curve")
            lines = split_lines(decode(content.data, content, ("utf-8", "latin-1")))
            table = _find_table(_format_tip_lines(lines) if is_calculix(lines) else lines, "\t;, ")
        return _convert_points(table, (deflection, force))


def _convert_points(table: _Table, curve_columns: Sequence[CurveColumn]) -> tuple[Floats, Floats]:
    """Convert the wanted columns to deflection and force in SI, and check their order."""
    columns = [_find_column(table, column) for column in curve_columns]
    if columns[0] == columns[1]:
        raise ContentError.of("readers.one_column_twice", table.head_place, number=columns[0] + 1)
    factors = [
        _compute_unit_factor(table, i, column)
        for i, column in zip(columns, curve_columns, strict=True)
    ]
    rows, points = _read_points(table, columns)
    deflections, forces = (
        column.sign * factor * values
        for column, factor, values in zip(curve_columns, factors, points, strict=True)
    )

    def describe_place(point: int, column: int) -> str:
        return f"{table.body.describe_place(rows[point])}, column {columns[column] + 1}"

    if len(turns := np.flatnonzero(np.diff(deflections) <= 0.0)):
        turn_mm, next_mm = 1e3 * deflections[turns[0] :][:2]
        raise ContentError.of(
            "readers.deflection_counts_down"
            if deflections[-1] < deflections[0]
            else "readers.deflection_turns",
            describe_place(turns[0] + 1, 0),
            before=turn_mm,
            here=next_mm,
        )
    largest = int(np.argmax(np.abs(forces)))
    if forces[largest] <= 0.0:
        place = describe_place(largest, 1)
        raise ContentError.of("readers.force_counts_down", place, force=forces[largest])
    return deflections, forces


def _find_table(lines: Sequence[str], separators: str, sheet: str = "") -> _Table:
    """Find names, units and rows of numbers in the lines of a text or sheet."""
    max_head_lines = 400  # lines in which the first row of numbers is searched
    head_split = split_head(lines[:max_head_lines], separators)
    if head_split is None:
        raise ContentError.of("readers.no_curve")
    separator, rows = head_split[0], [[cell.strip() for cell in row] for row in head_split[1]]
    first_row = len(rows) - 1
    above = [i for i, row in enumerate(rows[:first_row]) if any(row)]
    units: list[str] = []
    if len(above) > 1 and are_units(rows[above[-1]]):
        units = [strip_brackets(cell) for cell in rows[above.pop()]]
    names = rows[above[-1]] if above else []
    if names:  # a comment mark may precede them
        names[:1] = [names[0].lstrip("# ")] if names[0].lstrip("# ") else []
    width = max(len(rows[first_row]), len(names))
    body = Body(
        data="\n".join(lines[first_row:]).encode(),
        names=[*names, *[""] * (width - len(names))],
        columns=(),
        first_line=first_row + 1,
        separator=separator,
        sheet=sheet,
    )
    head = body.describe_place((above[-1] if above else first_row) - first_row)
    return _Table([*units, *[""] * (width - len(units))], head, body)


def _read_points(table: _Table, columns: Sequence[int]) -> tuple[list[int], list[Floats]]:
    """Read the indices of filled rows, and the values of both columns in these rows."""
    body = replace(table.body, columns=sorted(columns))
    arrays, notes = read_columns(body)
    if notes:
        raise ContentError.of("readers.rows_of_curve", note=notes[0].message)
    points = [arrays[i] for i in columns]
    is_blank = np.isnan(points)
    if len(half_points := np.flatnonzero(is_blank[0] != is_blank[1])):
        row = int(half_points[0])
        place = f"{body.describe_place(row)}, column {columns[int(is_blank[1, row])] + 1}"
        raise ContentError.of("readers.half_a_point", place)
    rows = np.flatnonzero(~is_blank[0])
    if len(rows) < MIN_CURVE_POINTS:
        least, count = MIN_CURVE_POINTS, len(rows)
        raise ContentError.of("readers.few_points", least=least, count=count)
    return rows.tolist(), [values[rows] for values in points]


def _find_column(table: _Table, column: CurveColumn) -> int:
    """Find the index of a column by its name, or by its number if no column has that name."""
    names = _USUAL_NAMES[column.quantity] if column.column is None else (column.column,)
    spellings = {name.strip().casefold() for name in names}
    matches = [
        i
        for i, name in enumerate(table.body.names)
        if spellings & {name.casefold(), _split_heading(name, column.si_unit)[0].casefold()}
    ]
    if len(matches) == 1:
        return matches[0]
    number = parse_count(column.column or "")
    if not matches and number is not None and 1 <= number <= len(table.units):
        return number - 1
    found_names = sort_by_likeness(names[0], [*filter(None, table.body.names)])
    raise ContentError.of(
        "readers.several_columns" if matches else "readers.no_column",
        table.head_place,
        name=names[0],
        found=", ".join(str(i + 1) for i in matches)
        or ", ".join(map(repr, found_names))
        or "numbers alone",
        entry=f"{column.quantity}: {{column: 1, unit: {column.example}}}",
    )


def _split_heading(text: str, si_unit: str) -> tuple[str, str]:
    """Split a heading into name and unit, which is empty if there is none.

    After an underscore, only a unit of the wanted dimension counts, such as ``deflection_mm`` but
    not ``force_m``.
    """
    pair = split_name_and_unit(text)
    if pair is not None and is_unit(pair[1]):
        return pair
    name, _, tail = text.rpartition("_")
    return (name, tail) if name and tail and has_dimension_of(tail, si_unit) else (text, "")


def _compute_unit_factor(table: _Table, index: int, column: CurveColumn) -> float:
    """Compute the factor from the unit of a column to SI, and refuse contradicting units."""
    heading = table.body.names[index]
    stated_unit = _split_heading(heading, column.si_unit)[1] or table.units[index]
    place = f"{table.head_place}, column {index + 1}"
    unit = column.unit or stated_unit
    for text in {unit, stated_unit or unit}:
        if not has_dimension_of(text, column.si_unit):
            quantity, example = column.quantity, column.example
            raise ContentError.of(
                "readers.unit_of_column", place, quantity=quantity, example=example, unit=text
            )
    factor = get_conversion_factor(unit, column.si_unit)
    if stated_unit and not math.isclose(get_conversion_factor(stated_unit, column.si_unit), factor):
        raise ContentError.of("readers.other_unit", place, unit=unit, stated=stated_unit)
    return factor


def is_calculix(lines: Sequence[str]) -> bool:
    """Return whether the first non-blank line is a heading of CalculiX.

    Parameters
    ----------
    lines : lines of the file
    """
    return _HEADING.fullmatch(next((line for line in lines if line.strip()), "")) is not None


def _format_tip_lines(lines: Sequence[str]) -> list[str]:
    """Convert the blocks to lines of deflection and force, each at the line of its block."""
    headings = [(i, match) for i, line in enumerate(lines) if (match := _HEADING.fullmatch(line))]
    ends = [*(i for i, _ in headings[1:]), len(lines)]
    blocks: dict[str, list[tuple[str, int, float]]] = {_DEFLECTION: [], _FORCE: []}
    names = set[str]()
    for (start, match), end in zip(headings, ends, strict=True):
        quantity, _, name, time = (group.strip() for group in match.groups())
        y_column = 2 if quantity != _FORCE else 1  # displacements follow the number of the node
        names.add(name)
        mean = _average_block(lines, range(start, end), y_column)
        blocks.setdefault(quantity, []).append((time, *mean))
    set_names, deflections, forces = ", ".join(sorted(names)), blocks[_DEFLECTION], blocks[_FORCE]
    if len(names) > 1 or [time for time, *_ in deflections] != [time for time, *_ in forces]:
        found = f"{len(deflections)} and {len(forces)} of the sets {set_names}"
        raise ContentError.of("readers.calculix_blocks", found=found)
    model_factor = 2.0 if set_names.upper().endswith(HALF_MODEL_SUFFIX) else 1.0
    table = ["deflection / m\tforce / N", *[""] * len(lines)]
    for (_, line, deflection), (*_, force) in zip(deflections, forces, strict=True):
        table[line] = f"{deflection:.9g}\t{model_factor * force:.9g}"
    return table


def _average_block(lines: Sequence[str], block: range, column: int) -> tuple[int, float]:
    """Average a column of a block, and return the index of its first line of numbers as well."""
    values, filled_lines = [], [i for i in block[1:] if lines[i].strip()]
    for i in filled_lines or block[:1]:
        cells = lines[i].split()
        # Other cells may be very small numbers, whose exponents lack the letter.
        if (
            not filled_lines
            or len(cells) != column + 2
            or not NUMERAL["."].fullmatch(cells[column])
        ):
            place, count, line = f"line {i + 1}", column + 2, lines[i].strip()[:60]
            raise ContentError.of("readers.calculix_line", place, count=count, line=line)
        values.append(float(cells[column]))
    return filled_lines[0], sum(values) / len(values)
