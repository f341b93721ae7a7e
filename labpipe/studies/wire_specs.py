"""The wires of a wire sheet: cells from the reader, checked by the grammar, faults placed."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import TypeAlias

from labpipe.errors import Fault, ReadError, complaint, nearest
from labpipe.protocol.stress_curve import FIRST_SLOPES, StressPoint, curve_fault, curve_of
from labpipe.protocol.wire_rows import (
    COLUMNS,
    Curve,
    WireRow,
    column_name,
    heading_faults,
    parse_row,
    wire_spec,
)
from labpipe.readers.sheet_cells import Cell, Table, as_table, csv_cells, sheets_of, workbook_cells
from labpipe.readers.workbooks import is_workbook
from labpipe.records.wire import WireSpec

WIRES_SHEET = "wires"
_UNITS = {column.unit.casefold() for column in COLUMNS.values() if column.unit}
_UNITS |= {"mm2", "mm\u00b2", "\u00b0", "-", "m^-1", "n/mm2", "n/mm^2", "n/mm\u00b2"}
_NAME_COLUMNS = "Name the columns strain and stress_mpa."
Placed: TypeAlias = tuple[str, Fault]
"""A fault and the place of its cell."""


def read_wire_sheet(path: Path) -> tuple[WireSpec, ...]:
    """Read the wires of a sheet: one row per wire, its dimensions and materials.

    Parameters
    ----------
    path : an xlsx workbook (the sheet named ``wires``, else the first that is shown), or a csv

    Returns
    -------
    The wires, in the order of the rows.

    Raises
    ------
    ReadError
        If the file is damaged or holds no wires, or anything in it is wrong: all faults are in one
        message, each with its cell.
    """
    cells, where = _cells(path)
    _refuse(path, _first_row_faults(cells))
    table = as_table(cells, path, rows_of="one row per wire", place=where)
    wrong = heading_faults([cell.text for cell in table.heading])
    _refuse(path, ((table.heading[number].place, fault) for number, fault in wrong))
    names = [column_name(cell.text) for cell in table.heading]
    rows = [dict(zip(names, row, strict=True)) for row in table.rows]
    messages = _worded(path, _repeated([row["wire"] for row in rows]))
    curves: dict[tuple[str, str], Curve] = {}
    specs = [_spec(row, path, curves, messages) for row in rows]
    if messages:
        raise ReadError("\n".join(dict.fromkeys(messages)))
    return tuple(spec for spec in specs if spec is not None)


def _worded(path: Path, faults: Iterable[Placed]) -> list[str]:
    return [
        complaint(path, place, expected=fault.expected, found=fault.found, remedy=fault.remedy)
        for place, fault in faults
    ]


def _refuse(path: Path, faults: Iterable[Placed]) -> None:
    if messages := _worded(path, faults):
        raise ReadError("\n".join(messages))


def _cells(path: Path) -> tuple[list[list[Cell]], str]:
    """Cells of the sheet, and its place in the file: empty for a csv."""
    if not is_workbook(path):
        return csv_cells(path), ""
    sheets = sheets_of(path)
    if not sheets:
        found, remedy = "a workbook without sheets", "Name the wire sheet."
        raise ReadError(complaint(path, "", expected="a wire sheet", found=found, remedy=remedy))
    shown = [name for name, is_shown in sheets.items() if is_shown]
    usual = [name for name in sheets if name.casefold() == WIRES_SHEET]
    name = [*usual, *shown, *sheets][0]
    where = f"sheet '{name}'" if sheets[name] else f"hidden sheet '{name}'"
    return workbook_cells(path, name, where), where


def _first_row_faults(cells: Sequence[Sequence[Cell]]) -> Iterator[Placed]:
    """Find a title or a comment above the heading, and a row of units below it."""
    filled = [row for row in cells if any(cell.text for cell in row)]
    known = [sum(column_name(cell.text) in WireRow.model_fields for cell in row) for row in filled]
    heading = next((number for number, count in enumerate(known) if count > 1), None)
    if heading is None:
        return
    if known[0] == 0:
        title = next(cell for cell in filled[0] if cell.text)
        expected = "the heading in the first row that is not blank"
        remedy = f"Remove the lines above the heading at {filled[heading][0].place}."
        yield title.place, Fault((), expected, repr(title.text), remedy)
    below = [cell for cell in chain(*filled[heading + 1 : heading + 2]) if cell.text]
    units = [cell for cell in below if cell.text.casefold().strip("[]() ") in _UNITS]
    if len(units) > 1 and len(units) >= len(below) - 1:
        found = f"a row of units ({', '.join(cell.text for cell in units[:3])}, ...)"
        remedy = "Remove it: the unit is part of a column's name."
        yield units[0].place, Fault((), "a wire", found, remedy)


def _repeated(names: Sequence[Cell]) -> Iterator[Placed]:
    """Find names that come again, or that files and labels take for the same."""
    seen: dict[str, Cell] = {}
    for cell in names:
        # Some systems ignore the case of letters and how an accent is written, Abaqus the case.
        bare = unicodedata.normalize("NFC", unicodedata.normalize("NFC", cell.text).casefold())
        first = seen.setdefault(bare, cell)
        if first is not cell and cell.text:
            expected, found = "each wire once", f"{cell.text!r} again, as in {first.place}"
            if cell.text != first.text:
                expected = "names that differ in more than the case of letters"
                found = f"{cell.text!r}, and {first.text!r} in {first.place}"
            fault = Fault((), expected, found, "Give each wire a name of its own.")
            yield f"{cell.place} (wire)", fault


def _spec(
    row: Mapping[str, Cell],
    path: Path,
    curves: dict[tuple[str, str], Curve],
    messages: list[str],
) -> WireSpec | None:
    """One wire; none where anything is wrong, which is added to the messages."""
    before = len(messages)
    read = parse_row(WireRow, _texts(row))
    messages += _worded(path, _placed(read, row)) if isinstance(read, list) else []
    for column in FIRST_SLOPES:
        table = row.get(column)
        if table is not None and table.text and (column, table.text) not in curves:
            try:
                curves[column, table.text] = _curve(column, table, path)
            except ReadError as error:
                messages.append(str(error))
    if isinstance(read, list) or len(messages) > before:
        return None
    blank = [name for name, cell in row.items() if not cell.text]
    place = re.sub(r", column \d+$", "", row["wire"].place)
    place = re.sub(r"cell [A-Z]+(\d+)$", r"row \1", place)
    named = (("stress_table", read.stress_table), ("insulation_table", read.insulation_table))
    return wire_spec(read, blank, place, *(curves.get(each) for each in named))


def _texts(row: Mapping[str, Cell]) -> dict[str, str]:
    return {name: cell.text for name, cell in row.items()}


def _placed(faults: Iterable[Fault], row: Mapping[str, Cell]) -> Iterator[Placed]:
    """Each fault with the cell that it comes from; the first one if its column is not there."""
    first, cell = next(iter(row.items()))
    for fault in faults:
        column = str(fault.path[0]) if fault.path else first
        yield f"{row.get(column, cell).place} ({column})", fault


def _curve(column: str, name: Cell, path: Path) -> Curve:
    """The stress table that a cell names: strain and stress_mpa, one row per point."""
    table, file = _curve_table(column, name, path)
    names = [column_name(cell.text) for cell in table.heading]
    columns = list(StressPoint.model_fields)
    missing = [column for column in columns if column not in names]
    found, remedy = ", ".join(repr(cell.text) for cell in table.heading), _NAME_COLUMNS
    above = table.heading[0].place
    _refuse(file, ((above, Fault((), f"a column {c!r}", found, remedy)) for c in missing))
    places = [names.index(column) for column in columns]
    rows = [{names[at]: row[at] for at in places} for row in table.rows]
    read = [parse_row(StressPoint, _texts(row)) for row in rows]
    wrong = ((row, each) for row, each in zip(rows, read, strict=True) if isinstance(each, list))
    _refuse(file, chain.from_iterable(_placed(each, row) for row, each in wrong))
    points = [each for each in read if not isinstance(each, list)]
    if fault := curve_fault(points, column):
        _refuse(file, [(rows[fault[0]]["strain"].place, fault[1])])
    return curve_of(points)


def _curve_table(column: str, name: Cell, path: Path) -> tuple[Table, Path]:
    """The table, and its file: another sheet of the workbook, or a csv beside the csv."""
    rows_of, place = "one row per point of the curve", f"{name.place} ({column})"
    if not is_workbook(path):
        if Path(name.text).name != name.text:
            expected = "the name of a csv in the folder of the wire sheet"
            remedy = "Put the table beside the sheet and give its name."
            _refuse(path, [(place, Fault((), expected, repr(name.text), remedy))])
        beside = path.with_name(name.text)
        return as_table(csv_cells(beside), beside, rows_of=rows_of), beside
    known = list(sheets_of(path))
    same = [each for each in known if each.casefold() == name.text.casefold()]
    if not same:
        expected = f"the name of a sheet ({', '.join(map(repr, nearest(name.text, known)))})"
        remedy = "Add the sheet or correct its name."
        _refuse(path, [(place, Fault((), expected, repr(name.text), remedy))])
    sheet = name.text if name.text in same else same[0]
    where = f"sheet '{sheet}'"
    cells = workbook_cells(path, sheet, where)
    return as_table(cells, path, rows_of=rows_of, place=where), path
