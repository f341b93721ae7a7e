"""Reads the stress table that a wire sheet names: strain and stress_mpa, one row per point."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from labpipe.errors import ReadError, nearest
from labpipe.readers.sheet_cells import (
    Cell,
    Table,
    as_table,
    csv_cells,
    is_workbook,
    sheet_names,
    workbook_cells,
)
from labpipe.readers.wire_columns import (
    NOT_NEGATIVE,
    Column,
    Faults,
    allowed_in,
    column_name,
    numbers_in,
)

STRAIN = Column("strain", "strain", "", 1.0, NOT_NEGATIVE)
STRESS = Column("stress_mpa", "stress", "MPa", 1e6, NOT_NEGATIVE)
MOST_STRAIN = 0.6
FIRST_SLOPES = (1e9, 1e12)
"""Slopes (Pa) between which the first one is: a wrong unit of strain or stress is outside."""
_ROUNDING = 1e-6  # of the first slope


@dataclass(frozen=True, slots=True)
class _Point:
    strain: float
    stress: float
    place: str


def read_stress_table(
    name: Cell, place: str, faults: Faults
) -> tuple[tuple[float, ...], tuple[float, ...]] | None:
    """Read the stress table that a cell names.

    Parameters
    ----------
    name : cell with the name of another sheet of the workbook; for a csv, of a csv beside it
    place : of the cell, for messages
    faults : where to tell what is wrong; its path is that of the wire sheet

    Returns
    -------
    Strains and stresses (Pa) beyond zero; none if anything is wrong. The strains grow, the stresses
    never fall, and no slope is above the first.
    """
    before = len(faults.told)
    try:
        table, own = _table(name.text, place, faults)
    except ReadError as error:
        faults.told.append(str(error))
        return None
    if table is None:
        return None
    so_far, points = len(own.told), _points(table, own)
    _check_order(points, table.heading[0].place, own)
    if len(own.told) == so_far:
        _check_units(points, own)
    if own is not faults:
        faults.told.extend(own.told)
    if len(faults.told) > before:
        return None
    beyond = [point for point in points if point.strain > 0.0]
    return tuple(each.strain for each in beyond), tuple(each.stress for each in beyond)


def _table(name: str, place: str, faults: Faults) -> tuple[Table | None, Faults]:
    """The table, and where to tell its faults: those of its own file."""
    rows_of = "one row per point of the curve"
    if not is_workbook(faults.path):
        if Path(name).name != name:
            expected = "the name of a csv in the folder of the wire sheet"
            remedy = "Put the table beside the sheet and give its name."
            faults.add(place, expected=expected, found=repr(name), remedy=remedy)
            return None, faults
        beside = faults.path.with_name(name)
        return as_table(csv_cells(beside), beside, rows_of=rows_of), Faults(beside)
    known = sheet_names(faults.path)
    same = [each for each in known if each.casefold() == name.casefold()]
    if not same:
        listed = ", ".join(repr(each) for each in nearest(name, known))
        expected, remedy = f"the name of a sheet ({listed})", "Add the sheet or correct its name."
        faults.add(place, expected=expected, found=repr(name), remedy=remedy)
        return None, faults
    name = name if name in same else same[0]
    where = f"sheet '{name}'"
    cells = [
        [replace(cell, place=f"{where}, {cell.place}") for cell in row]
        for row in workbook_cells(faults.path, name)
    ]
    return as_table(cells, faults.path, rows_of=rows_of, place=where), faults


def _points(table: Table, faults: Faults) -> list[_Point]:
    """Points of the curve, but those with a fault."""
    names = [column_name(cell) for cell in table.heading]
    missing = [column.name for column in (STRAIN, STRESS) if column.name not in names]
    for column in missing:
        found = ", ".join(repr(cell.text) for cell in table.heading)
        expected, remedy = f"a column {column!r}", "Name the columns strain and stress_mpa."
        faults.add(table.heading[0].place, expected=expected, found=found, remedy=remedy)
    if missing:
        return []
    rows = [dict(zip(names, row, strict=True)) for row in table.rows]
    read = [(row, _number(row[c.name], c, faults)) for row in rows for c in (STRAIN, STRESS)]
    pairs = zip(read[::2], read[1::2], strict=True)
    return [
        _Point(strain, stress, row[STRAIN.name].place)
        for (row, strain), (_, stress) in pairs
        if strain is not None and stress is not None
    ]


def _number(cell: Cell, column: Column, faults: Faults) -> float | None:
    if not cell.text:
        place, remedy = f"{cell.place} ({column.name})", "Fill it in."
        faults.add(place, expected=allowed_in(column), found="a blank cell", remedy=remedy)
        return None
    found = numbers_in(cell, column, faults)
    return found[0] if found else None


def _check_units(points: Sequence[_Point], faults: Faults) -> None:
    """Tell strains in per cent and stresses in another unit than MPa."""
    first = next((point for point in points if point.strain > 0.0), None)
    if first is None:
        return  # told already, as a table without a point beyond zero
    low, high = FIRST_SLOPES
    slope = first.stress / first.strain
    largest = points[-1]
    if largest.strain > MOST_STRAIN:
        expected, found = f"a strain up to {MOST_STRAIN:g}", f"{largest.strain:g}"
        remedy = "Give the strain as a plain number, not in per cent."
        faults.add(largest.place, expected=expected, found=found, remedy=remedy)
    elif not low <= slope <= high:
        expected = f"a first slope of {low / 1e9:g} to {high / 1e9:g} GPa"
        remedy = "Give the strain as a plain number, not in per cent, and the stress in MPa."
        found = f"{slope / 1e9:.4g} GPa"
        faults.add(first.place, expected=expected, found=found, remedy=remedy)


def _check_order(points: Sequence[_Point], place: str, faults: Faults) -> None:
    """Tell points out of order: strains grow, stresses never fall, the first slope is steepest."""
    last, first_slope = _Point(0.0, 0.0, ""), None
    for number, point in enumerate(points):
        if number == 0 and point.strain == point.stress == 0.0:
            continue
        step, rise = point.strain - last.strain, point.stress - last.stress
        if step <= 0.0:
            expected, found = f"a strain above {last.strain:g}", f"{point.strain:g}"
            _tell(point, expected, found, faults)
            return
        if rise < 0.0 or (first_slope is None and rise == 0.0):
            expected = f"a stress of {last.stress / 1e6:g} MPa or more, and more than zero"
            _tell(point, expected, f"{point.stress / 1e6:g} MPa", faults)
            return
        slope = rise / step
        first_slope = slope if first_slope is None else first_slope
        if slope > first_slope * (1.0 + _ROUNDING):
            expected = f"a slope up to the first, {first_slope / 1e9:.4g} GPa"
            _tell(point, expected, f"{slope / 1e9:.4g} GPa", faults)
            return
        last = point
    if first_slope is None and not faults.told:
        remedy = "Fill in the table."
        faults.add(place, expected="a point beyond zero", found="none", remedy=remedy)


def _tell(point: _Point, expected: str, found: str, faults: Faults) -> None:
    remedy = "Put the rows in order and correct them."
    faults.add(point.place, expected=expected, found=found, remedy=remedy)
