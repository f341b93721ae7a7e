"""The columns of a curve from elsewhere: found by name or number, their units told or stated."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from labpipe.errors import ReadError, nearest
from labpipe.readers.cells import is_unit, name_and_unit
from labpipe.readers.files import unreadable
from labpipe.readers.sheet_cells import Cell, Row
from labpipe.units import si_factor, whole_number

_USUAL = {
    "deflection": ("deflection", "tip deflection", "displacement", "tip displacement"),
    "force": ("force", "tip force"),
}
"""What a column is called that nobody has to name."""


@dataclass(frozen=True, slots=True)
class CurveColumn:
    """A column that is asked for.

    Parameters
    ----------
    what : ``deflection`` or ``force``
    si_unit : of the answer
    column : its name, or its number counted from 1; None for one that is called by its usual name
    unit : in the file; None for what the heading says
    sign : -1 where the file counts against the direction of bending
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
    names : of the columns, units taken off by those who look for them; empty without any
    units : of the row of units; empty texts without one
    rows : of numbers, and what is among them
    """

    path: Path
    names: Row
    units: tuple[str, ...]
    rows: Sequence[Sequence[Cell]]


def head_of(table: CurveTable) -> str:
    """Place of the names, or of the first row."""
    row = table.names or table.rows[0]
    return row[0].place.partition(",")[0]


def find_column(table: CurveTable, asked: CurveColumn) -> int:
    """Find a column by its name, or by its number where none has that name.

    Parameters
    ----------
    table : cells of the file
    asked : what is wanted

    Returns
    -------
    Its number, counted from 0.

    Raises
    ------
    ReadError
        If there is none, or several have the name.
    """
    words = _USUAL[asked.what] if asked.column is None else (asked.column,)
    wanted = {word.strip().casefold() for word in words}
    found = [
        i
        for i, cell in enumerate(table.names)
        if wanted & {cell.text.casefold(), _parted(cell.text, asked.si_unit)[0].casefold()}
    ]
    if len(found) == 1:
        return found[0]
    if found:
        said = f"{len(found)}: columns {', '.join(str(i + 1) for i in found)}"
        remedy = "Give the number of the one that is meant."
        raise unreadable(table.path, head_of(table), f"one column {words[0]!r}", said, remedy)
    width = len(table.units)
    number = whole_number(asked.column or "")
    if number is not None and 1 <= number <= width:
        return number - 1
    raise _no_column(table, asked, words[0])


def _no_column(table: CurveTable, asked: CurveColumn, word: str) -> ReadError:
    place = head_of(table)
    remedy = f"Name it in the plan, such as {asked.what}: {{column: U2, unit: {_example(asked)}}}."
    if not table.names:
        remedy = f"Number it in the plan, such as {asked.what}: {{column: 1, unit: mm}}."
        expected = f"a row of names above the numbers, with a column {word!r}"
        return unreadable(table.path, place, expected, "numbers alone", remedy)
    known = [cell.text for cell in table.names if cell.text]
    found = ", ".join(repr(name) for name in nearest(word, known))
    return unreadable(table.path, place, f"a column {word!r}", found, remedy)


def _example(asked: CurveColumn) -> str:
    return "mm" if asked.si_unit == "m" else "N"


def _parted(text: str, si_unit: str) -> tuple[str, str]:
    """Name and unit of a heading; the unit is empty where there is none.

    Behind an underscore only a unit of the dimension wanted is one: ``deflection_mm``, but not
    ``force_m``.
    """
    pair = name_and_unit(text)
    if pair is not None and is_unit(pair[1]):
        return pair
    name, _, tail = text.rpartition("_")
    return (name, tail) if name and _converts(tail, si_unit) else (text, "")


def _converts(unit: str, si_unit: str) -> bool:
    try:
        si_factor(unit, si_unit)
    except ValueError:
        return False
    return bool(unit)


def unit_factor(table: CurveTable, at: int, asked: CurveColumn) -> float:
    """Factor from the unit of a column to SI.

    Parameters
    ----------
    table : cells of the file
    at : number of the column, counted from 0
    asked : what is wanted, with its unit where the plan says it

    Raises
    ------
    ReadError
        If nobody says the unit, it is of another dimension, or plan and heading differ.
    """
    head = table.names[at].text if at < len(table.names) else ""
    said = _parted(head, asked.si_unit)[1] or table.units[at]
    place = f"{head_of(table)}, column {at + 1}"
    unit = asked.unit or said
    if not unit:
        expected = f"a unit of the {asked.what}"
        remedy = f"Write it in the heading ({asked.what} / {_example(asked)}) or in the plan."
        raise unreadable(table.path, place, expected, f"none in {head!r}", remedy)
    for each in {unit, said or unit}:
        if not _converts(each, asked.si_unit):
            expected = f"a unit of the {asked.what}, such as {_example(asked)}"
            raise unreadable(table.path, place, expected, f"{each!r}", "Correct the heading.")
    factor = si_factor(unit, asked.si_unit)
    if said and not math.isclose(si_factor(said, asked.si_unit), factor):
        remedy = "Correct the one that is wrong."
        raise unreadable(table.path, place, f"{unit!r}, as in the plan", f"{said!r}", remedy)
    return factor
