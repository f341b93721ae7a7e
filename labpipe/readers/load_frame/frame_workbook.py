"""Tables of workbooks (xlsx, xls): one sheet per specimen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from labpipe.errors import ReadError
from labpipe.readers.channels import unique_names
from labpipe.readers.load_frame.cards import Card
from labpipe.readers.load_frame.column_titles import Header, header_of_rows
from labpipe.readers.load_frame.frame_recording import (
    MIN_SAMPLES,
    Export,
    Table,
    preamble,
    time_column,
    word_columns,
)
from labpipe.readers.number_table import sheet_columns
from labpipe.readers.raw_files import unreadable
from labpipe.readers.text_cells import as_text
from labpipe.readers.workbooks import Sheets
from labpipe.records.quality import QualityNote, Severity

_HEAD_ROWS = 60


def sheet_head(rows: Sequence[Sequence[object]]) -> str:
    """Return the first rows of a sheet as text, cells separated by tabs."""
    return "\n".join("\t".join(as_text(cell) for cell in row) for row in rows[:_HEAD_ROWS])


def read_sheets(sheets: Sheets, card: Card, path: Path) -> Export:
    """Read all sheets of a workbook with samples.

    Parameters
    ----------
    sheets : from `open_sheets`
    card : rules for names and units
    path : named in errors

    Returns
    -------
    One table per sheet with samples; the first rows of the others as metadata.

    Raises
    ------
    ReadError
        If no sheet has names, units and numbers where the card states.
    """
    tables: dict[str, Table] = {}
    faults: dict[str, ReadError] = {}
    about: dict[str, object] = {}
    for name, rows in sheets.items():
        try:
            header = _header(rows, name, card, path)
        except ReadError as fault:
            faults[name] = fault
            continue
        tables[name] = _table(rows, header, name, card, path)
        about |= preamble(header.above)
    if not tables:
        raise _no_table(faults, path)
    results = _without_samples(tables, card)
    left_out = [name for name in sheets if name in faults or name in results]
    others = {name: _rows_as_text(sheets[name]) for name in left_out}
    metadata = about | ({"sheets": others} if others else {})
    head = "\n".join(sheet_head(rows) for rows in sheets.values())
    kept = tuple(table for name, table in tables.items() if name not in results)
    return Export(kept, metadata, tuple(_left_out_notes(left_out)), head)


def _without_samples(tables: Mapping[str, Table], card: Card) -> set[str]:
    """Find sheets of results among sheets of samples: other columns, and no time or few rows."""
    rows = {
        name: max(map(len, table.columns.values()), default=0) for name, table in tables.items()
    }
    longest = tables[max(rows, key=lambda name: rows[name])]
    has_time = {
        name: time_column(table.names, table.units, card) is not None
        for name, table in tables.items()
    }
    needs_time = any(has_time.values())
    return {
        name
        for name, table in tables.items()
        if table.names != longest.names
        and (rows[name] < MIN_SAMPLES or (needs_time and not has_time[name]))
    }


def _header(rows: Sequence[Sequence[object]], sheet: str, card: Card, path: Path) -> Header:
    text = [[as_text(cell) for cell in row] for row in rows[:_HEAD_ROWS]]
    header = header_of_rows(text, card, path, place=f"sheet '{sheet}', row")
    if card.layout != "specimen above" or len({cell for cell in header.specimens if cell}) == 1:
        return header
    if time_column(header.names, header.units, card) is not None:
        return replace(header, specimens=())  # the row was edited; the sheet has a name as well
    raise unreadable(
        path,
        f"sheet '{sheet}', row {max(header.first - 2, 1)}",
        "the specimen above the row of names",
        "none",
        "Export the test again, or name another dialect.",
    )


def _no_table(faults: Mapping[str, ReadError], path: Path) -> ReadError:
    """Return the most specific fault of a sheet, or that no sheet has samples."""
    for fault in faults.values():
        if "numbers below it" not in str(fault):
            return fault
    return unreadable(
        path,
        "",
        "a sheet with names, units and numbers",
        f"{len(faults)} sheets without",
        "Export the test again, or name another dialect.",
    )


def _left_out_notes(sheets: Sequence[str]) -> list[QualityNote]:
    if not sheets:
        return []
    named = ", ".join(f"'{name}'" for name in sheets)
    message = f"{len(sheets)} sheets without samples were omitted: {named}"
    return [QualityNote("sheets_left_out", Severity.INFO, "file", message)]


def _rows_as_text(rows: Sequence[Sequence[object]]) -> list[list[str]]:
    texts = [[as_text(cell) for cell in row] for row in rows[:50]]
    return [row for row in texts if any(row)]


def _table(
    rows: Sequence[Sequence[object]], header: Header, sheet: str, card: Card, path: Path
) -> Table:
    text_columns = word_columns(header.names, card)
    wanted = [i for i in range(len(header.names)) if i not in text_columns]
    place = f"sheet '{sheet}'"
    names = unique_names(header.names)
    called = {i: names[i] for i in wanted}
    columns, notes = sheet_columns(rows, header.first, called, (path, place))
    specimen = next((cell for cell in header.specimens if cell), "")
    return Table(specimen or sheet, header.names, header.units, columns, sheet, tuple(notes))
