"""Reader of wire sheets: checked cells, faults with their places."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

from labpipe.errors import Fault, ReadError, error_text
from labpipe.protocol.wire_rows import (
    COLUMNS,
    FIRST_SLOPES,
    WireRow,
    column_name,
    heading_faults,
    parse_row,
    wire_spec,
)
from labpipe.readers.sheet_cells import Cell, as_table, csv_cells, sheets_of, workbook_cells
from labpipe.readers.workbooks import is_workbook
from labpipe.records.wire import WireSpec
from labpipe.studies.stress_tables import (
    PlacedFault,
    StatedCurve,
    fault_messages,
    place_faults,
    raise_faults,
    read_stress_table,
    texts,
)

_UNITS = {column.unit.casefold() for column in COLUMNS.values() if column.unit}
_UNITS |= {"mm2", "mm\u00b2", "\u00b0", "-", "m^-1", "n/mm2", "n/mm^2", "n/mm\u00b2"}


@dataclass(frozen=True, slots=True)
class WireSheet:
    """A wire sheet with its stress tables.

    Parameters
    ----------
    specs : the wires, in the order of the rows
    curves : wire -> column of the sheet -> stress table, if there is one
    """

    specs: tuple[WireSpec, ...]
    curves: Mapping[str, Mapping[str, StatedCurve]]


def read_wire_sheet(path: Path) -> tuple[WireSpec, ...]:
    """Read the wires of a sheet: one row per wire, its dimensions and materials.

    Parameters
    ----------
    path : an xlsx workbook (the sheet named ``wires``, else the first visible one), or a csv

    Returns
    -------
    The wires, in the order of the rows.

    Raises
    ------
    ReadError
        If the file is damaged, has no wires, or has faults: all in one message, each with its cell.
    """
    return read_wires(path).specs


def read_wires(path: Path) -> WireSheet:
    """Read the wires of a sheet as `read_wire_sheet`, with their stress tables."""
    cells, where = _cells(path)
    raise_faults(path, _first_row_faults(cells))
    table = as_table(cells, path, rows_of="one row per wire", place=where)
    wrong = heading_faults([cell.text for cell in table.heading])
    raise_faults(path, ((table.heading[number].place, fault) for number, fault in wrong))
    names = [column_name(cell.text) for cell in table.heading]
    rows = [dict(zip(names, row, strict=True)) for row in table.rows]
    messages = fault_messages(path, _repeated_name_faults([row["wire"] for row in rows]))
    curves: dict[tuple[str, str], StatedCurve] = {}
    specs = [_read_spec(row, path, curves, messages) for row in rows]
    if messages:
        raise ReadError("\n".join(dict.fromkeys(messages)))
    return WireSheet(
        tuple(spec for spec in specs if spec is not None),
        {row["wire"].text: _stress_tables(row, curves) for row in rows},
    )


def _cells(path: Path) -> tuple[list[list[Cell]], str]:
    """Read the cells of the sheet; return them with its place in the file, empty for a csv."""
    if not is_workbook(path):
        return csv_cells(path), ""
    sheets = sheets_of(path)
    if not sheets:
        actual, remedy = "a workbook without sheets", "Name the wire sheet."
        raise ReadError(error_text(path, "", expected="a wire sheet", found=actual, remedy=remedy))
    visible = [name for name, is_shown in sheets.items() if is_shown]
    usual = [name for name in sheets if name.casefold() == "wires"]
    name = [*usual, *visible, *sheets][0]
    where = f"sheet '{name}'" if sheets[name] else f"hidden sheet '{name}'"
    return workbook_cells(path, name, where), where


def _first_row_faults(cells: Sequence[Sequence[Cell]]) -> Iterator[PlacedFault]:
    """Find a title or a comment above the heading, and a row of units below it."""
    filled = [row for row in cells if any(cell.text for cell in row)]
    counts = [sum(column_name(cell.text) in WireRow.model_fields for cell in row) for row in filled]
    heading = next((number for number, count in enumerate(counts) if count > 1), None)
    if heading is None:
        return
    if counts[0] == 0:
        title = next(cell for cell in filled[0] if cell.text)
        expected = "the heading in the first row that is not blank"
        remedy = f"Remove the lines above the heading at {filled[heading][0].place}."
        yield title.place, Fault((), expected, repr(title.text), remedy)
    below = [cell for cell in chain(*filled[heading + 1 : heading + 2]) if cell.text]
    units = [cell for cell in below if cell.text.casefold().strip("[]() ") in _UNITS]
    if len(units) > 1 and len(units) >= len(below) - 1:
        actual = f"a row of units ({', '.join(cell.text for cell in units[:3])}, ...)"
        remedy = "Remove it: the unit is part of a column's name."
        yield units[0].place, Fault((), "a wire", actual, remedy)


def _repeated_name_faults(names: Sequence[Cell]) -> Iterator[PlacedFault]:
    """Find repeated names, and names that are the same in files or labels."""
    seen: dict[str, Cell] = {}
    for cell in names:
        # some systems ignore case and the encoding of accents, Abaqus ignores case
        bare = unicodedata.normalize("NFC", unicodedata.normalize("NFC", cell.text).casefold())
        first = seen.setdefault(bare, cell)
        if first is not cell and cell.text:
            expected, actual = "each wire once", f"{cell.text!r} again, as in {first.place}"
            if cell.text != first.text:
                expected = "names that differ in more than the case of letters"
                actual = f"{cell.text!r}, and {first.text!r} in {first.place}"
            fault = Fault((), expected, actual, "Give each wire a name of its own.")
            yield f"{cell.place} (wire)", fault


def _read_spec(
    row: Mapping[str, Cell],
    path: Path,
    curves: dict[tuple[str, str], StatedCurve],
    messages: list[str],
) -> WireSpec | None:
    """Read one wire; return None for one with faults, which are added to the messages."""
    before = len(messages)
    read = parse_row(WireRow, texts(row))
    messages += fault_messages(path, place_faults(read, row)) if isinstance(read, list) else []
    for column in FIRST_SLOPES:
        table = row.get(column)
        if table is not None and table.text and (column, table.text) not in curves:
            try:
                curves[column, table.text] = read_stress_table(column, table, path)
            except ReadError as error:
                messages.append(str(error))
    if isinstance(read, list) or len(messages) > before:
        return None
    blank = [name for name, cell in row.items() if not cell.text]
    place = re.sub(r", column \d+$", "", row["wire"].place)
    place = re.sub(r"cell [A-Z]+(\d+)$", r"row \1", place)
    named = _stress_tables(row, curves)
    tables = [
        named[first_slope].curve if first_slope in named else None for first_slope in FIRST_SLOPES
    ]
    return wire_spec(read, blank, place, *tables)


def _stress_tables(
    row: Mapping[str, Cell], curves: Mapping[tuple[str, str], StatedCurve]
) -> dict[str, StatedCurve]:
    """Return the stress tables of a row, by column."""
    curves_by_column = {
        column: curves.get((column, row[column].text)) for column in FIRST_SLOPES if column in row
    }
    return {column: curve for column, curve in curves_by_column.items() if curve is not None}
