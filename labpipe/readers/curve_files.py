"""Read external force-displacement curves: two columns of a text file or a workbook.

Sources of these files: a finite-element program, a program that digitises figures, another lab.

Units: in the heading (``deflection / mm``, ``force [N]``, ``deflection_mm``), in a row of units
below it, or stated by the caller. Contradicting units are refused.

Missing data: a row in which both cells are blank is skipped, as in files with curves of different
lengths side by side. One blank cell is refused.

File structure: cells separated by tab, semicolon, comma or blanks, whichever splits the first rows
into numbers. The decimal sign is a point or a comma in the whole file. Rows above the names are
skipped. A file without names is read if the caller states the numbers of the columns. The first
sheet of a workbook is read.
An incomplete last line without line end and text among the numbers are refused. A curve has no
notes to report them, and the last point often has the largest force.

A file that CalculiX CrunchiX (``ccx``, ending ``.dat``, known version 2.20) printed is read
directly: deflection and force of a pushed tip at each increment, from ``*NODE PRINT`` of ``U``
and, with ``TOTALS=ONLY``, of ``RF``, as in the deck that `labpipe model` writes. The file does not
state units. Decks of labpipe are in m and N, and other units are refused as contradicting. The file
contains blocks, each under a heading with the quantity, the set of nodes and the time, such
as ``displacements (vx,vy,vz) for set TIPHALF and time  0.1250000E-01``. A block of displacements
has one line for each node, which begins with the number of the node. A block of the total force has
one line. The deflection is the mean of the second component (y) of the displacements, and the force
is the second component of the total force. If the name of the set ends in HALF, the model is a half
model, and its force is doubled.
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
"""Usual names of the columns, keyed by quantity."""
HALF_MODEL_SUFFIX = "HALF"
"""Suffix of the name of a node set in a half model."""
_HEADING = re.compile(r"\s*+([^\s(][^(]*)\((\w+,\w+,\w+)\) for set (\S+) and time\s++(\S+)\s*+")
_DEFLECTION, _FORCE = "displacements", "total force"


@dataclass(frozen=True, slots=True)
class CurveColumn:
    """Choice of the column of a quantity.

    Parameters
    ----------
    quantity : ``deflection`` or ``force``
    si_unit : SI unit of the quantity
    column : name of the column, or its number counted from 1; None for the usual name
    unit : unit of the values in the file; None for the unit in the heading
    sign : -1 if the values of the file are negative in the direction of bending
    """

    quantity: str
    si_unit: str
    column: str | None = None
    unit: str | None = None
    sign: int = 1

    @property
    def usual_unit(self) -> str:
        """Usual unit of the quantity, for messages."""
        return "mm" if self.si_unit == "m" else "N"


@dataclass(frozen=True, slots=True)
class _Table:
    """The rows of numbers of a file, with names and units of the columns.

    Parameters
    ----------
    units : unit of each column in the row of units; empty texts without such a row
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
    path : path of a text file or an xlsx workbook
    deflection, force : choice of the column of deflections, and of that of forces

    Returns
    -------
    Deflection (m), increasing from row to row, and force (N), both of shape (n,).

    Raises
    ------
    ReadError
        If the file, a column or a unit is missing, a cell contains no finite number, a deflection
        is not larger than the preceding one, the force of largest magnitude is not positive, or
        there are fewer than `MIN_CURVE_POINTS` points.
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


def _convert_points(table: _Table, choices: Sequence[CurveColumn]) -> tuple[Floats, Floats]:
    """Convert the chosen columns to deflection and force in SI, and check the order of points."""
    columns = [_get_column(table, choice) for choice in choices]
    if columns[0] == columns[1]:
        raise ContentError.of("readers.one_column_twice", table.head_place, number=columns[0] + 1)
    pairs = zip(columns, choices, strict=True)
    factors = [_compute_unit_factor(table, column, choice) for column, choice in pairs]
    rows, file_values = _read_points(table, columns)
    deflections, forces = (
        choice.sign * factor * values
        for choice, factor, values in zip(choices, factors, file_values, strict=True)
    )

    def describe_place(point: int, column: int) -> str:
        """Describe the cell of a point in one of the two columns, for a message."""
        return f"{table.body.describe_place(rows[point])}, column {columns[column] + 1}"

    if len(turns := np.flatnonzero(np.diff(deflections) <= 0.0)):
        counts_down, place = deflections[-1] < deflections[0], describe_place(turns[0] + 1, 0)
        turn_mm, next_mm = 1e3 * deflections[turns[0] :][:2]
        raise ContentError.of(
            "readers.deflection_counts_down" if counts_down else "readers.deflection_turns",
            place,
            before=turn_mm,
            here=next_mm,
        )
    peak = int(np.argmax(np.abs(forces)))
    if forces[peak] <= 0.0:
        place = describe_place(peak, 1)
        raise ContentError.of("readers.force_counts_down", place, force=forces[peak])
    return deflections, forces


def _find_table(lines: Sequence[str], separators: str, sheet: str = "") -> _Table:
    """Find names, units and rows of numbers in the lines of a text or sheet."""
    max_head_lines = 400  # lines in which the first row of numbers is searched
    head_split = split_head(lines[:max_head_lines], separators)
    if head_split is None:
        raise ContentError.of("readers.no_curve")
    separator, rows = head_split[0], [[cell.strip() for cell in row] for row in head_split[1]]
    first_row = len(rows) - 1
    head_rows = [i for i, row in enumerate(rows[:first_row]) if any(row)]
    units: list[str] = []
    if len(head_rows) > 1 and are_units(rows[head_rows[-1]]):
        units = [strip_brackets(cell) for cell in rows[head_rows.pop()]]
    names = rows[head_rows[-1]] if head_rows else []
    if names:  # a comment mark may precede the first name, or have its own cell
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
    head_place = body.describe_place((head_rows[-1] if head_rows else first_row) - first_row)
    return _Table([*units, *[""] * (width - len(units))], head_place, body)


def _read_points(table: _Table, columns: Sequence[int]) -> tuple[list[int], list[Floats]]:
    """Return the indices of filled rows, and the values of both columns in these rows."""
    body = replace(table.body, columns=sorted(columns))
    arrays, notes = read_columns(body)
    if notes:
        raise ContentError.of("readers.rows_of_curve", note=notes[0].message)
    column_values = [arrays[i] for i in columns]
    is_blank = np.isnan(column_values)
    if len(incomplete_rows := np.flatnonzero(is_blank[0] != is_blank[1])):
        row = int(incomplete_rows[0])
        place = f"{body.describe_place(row)}, column {columns[int(is_blank[1, row])] + 1}"
        raise ContentError.of("readers.half_a_point", place)
    rows = np.flatnonzero(~is_blank[0])
    if len(rows) < MIN_CURVE_POINTS:
        facts = {"least": MIN_CURVE_POINTS, "count": len(rows)}
        raise ContentError.of("readers.few_points", **facts)
    return rows.tolist(), [values[rows] for values in column_values]


def _get_column(table: _Table, choice: CurveColumn) -> int:
    """Get the index of a column by its name, or by its number if no column has that name.

    Raise ContentError if there is no such column, or several.
    """
    names = _USUAL_NAMES[choice.quantity] if choice.column is None else (choice.column,)
    spellings = {name.strip().casefold() for name in names}
    matches = [
        i
        for i, name in enumerate(table.body.names)
        if spellings & {name.casefold(), _split_heading(name, choice.si_unit)[0].casefold()}
    ]
    if len(matches) == 1:
        return matches[0]
    number = parse_count(choice.column or "")
    if not matches and number is not None and 1 <= number <= len(table.units):
        return number - 1
    nearest_names = sort_by_likeness(names[0], [*filter(None, table.body.names)])
    numbers = ", ".join(str(i + 1) for i in matches)
    raise ContentError.of(
        "readers.several_columns" if matches else "readers.no_column",
        table.head_place,
        name=names[0],
        found=numbers or ", ".join(map(repr, nearest_names)) or "numbers alone",
        entry=f"{choice.quantity}: {{column: 1, unit: {choice.usual_unit}}}",
    )


def _split_heading(text: str, si_unit: str) -> tuple[str, str]:
    """Split a heading into name and unit, which is empty if there is none.

    After an underscore, only a unit with the dimension of `si_unit` is accepted: for a length,
    ``deflection_mm`` has a unit and ``deflection_N`` has none.
    """
    pair = split_name_and_unit(text)
    if pair is not None and is_unit(pair[1]):
        return pair
    name, _, tail = text.rpartition("_")
    return (name, tail) if name and tail and has_dimension_of(tail, si_unit) else (text, "")


def _compute_unit_factor(table: _Table, column: int, choice: CurveColumn) -> float:
    """Compute the factor from the unit of a column to SI, and refuse contradicting units."""
    heading = table.body.names[column]
    stated_unit = _split_heading(heading, choice.si_unit)[1] or table.units[column]
    place = f"{table.head_place}, column {column + 1}"
    unit = choice.unit or stated_unit
    for text in {unit, stated_unit or unit}:
        if not has_dimension_of(text, choice.si_unit):
            facts = {"quantity": choice.quantity, "example": choice.usual_unit, "unit": text}
            raise ContentError.of("readers.unit_of_column", place, **facts)
    factor = get_conversion_factor(unit, choice.si_unit)
    if stated_unit and not math.isclose(get_conversion_factor(stated_unit, choice.si_unit), factor):
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
    """Convert the blocks of CalculiX to a table of deflection and force.

    The row of an increment has the line number of the first displacement of this increment.
    """
    headings = [(i, match) for i, line in enumerate(lines) if (match := _HEADING.fullmatch(line))]
    ends = [*(i for i, _ in headings[1:]), len(lines)]
    blocks: dict[str, list[tuple[str, int, float]]] = {_DEFLECTION: [], _FORCE: []}
    set_names = set[str]()
    for (start, match), end in zip(headings, ends, strict=True):
        quantity, _, set_name, time = (group.strip() for group in match.groups())
        y_column = 2 if quantity != _FORCE else 1  # displacements follow the number of the node
        set_names.add(set_name)
        first_line, mean = _average_block(lines, range(start, end), y_column)
        blocks.setdefault(quantity, []).append((time, first_line, mean))
    sets, deflections, forces = ", ".join(sorted(set_names)), blocks[_DEFLECTION], blocks[_FORCE]
    if len(set_names) > 1 or [time for time, *_ in deflections] != [time for time, *_ in forces]:
        found = f"{len(deflections)} and {len(forces)} of the sets {sets}"
        raise ContentError.of("readers.calculix_blocks", found=found)
    model_factor = 2.0 if sets.upper().endswith(HALF_MODEL_SUFFIX) else 1.0
    table_lines = ["deflection / m\tforce / N", *[""] * len(lines)]
    for (_, line, deflection), (*_, force) in zip(deflections, forces, strict=True):
        table_lines[line] = f"{deflection:.9g}\t{model_factor * force:.9g}"
    return table_lines


def _average_block(lines: Sequence[str], block: range, column: int) -> tuple[int, float]:
    """Return the index of the first line of numbers of a block, and the mean of a column."""
    values, filled_lines = [], [i for i in block[1:] if lines[i].strip()]
    for i in filled_lines or block[:1]:
        cells = lines[i].split()
        # Other cells may be very small numbers, whose exponents lack the letter.
        if (
            not filled_lines
            or len(cells) != column + 2
            or not NUMERAL["."].fullmatch(cells[column])
        ):
            facts = {"count": column + 2, "line": lines[i].strip()[:60]}
            raise ContentError.of("readers.calculix_line", f"line {i + 1}", **facts)
        values.append(float(cells[column]))
    return filled_lines[0], sum(values) / len(values)
