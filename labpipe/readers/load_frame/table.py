"""Tables: what one export, one sheet or one specimen holds, before it becomes a recording."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from labpipe.errors import nearest
from labpipe.readers.cells import is_like
from labpipe.readers.channels import Wanted, find_channel, plain_name, unique_names
from labpipe.readers.files import unreadable
from labpipe.readers.load_frame.card import Card
from labpipe.readers.load_frame.titles import Header, Rows
from labpipe.records.arrays import Floats
from labpipe.records.quality import QualityNote, Severity

FEW = 10
"""Fewer samples than this are no test that was carried through."""

_OF_TIME = re.compile(r"(?i)time|zeit|temps|tempo|tiempo|czas|tijd|时间|時間")
_SEPARATOR = re.compile(r"sep=.?")


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """Columns of numbers on one clock.

    Parameters
    ----------
    part : specimen or sheet, empty where the export holds one
    names, units : of the columns
    columns : by number of the column, all of shape (rows,); what nobody asked for is absent
    also : another name of the part, such as that of the sheet
    notes : what reading them brought up
    """

    part: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    columns: Mapping[int, Floats]
    also: str = ""
    notes: tuple[QualityNote, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Export:
    """All tables of one export.

    Parameters
    ----------
    tables : in the order of the file
    about : what the export says of itself
    notes : on the export as a whole
    head : its beginning as text, for the patterns of the card
    """

    tables: tuple[Table, ...]
    about: Mapping[str, object] = field(default_factory=dict)
    notes: tuple[QualityNote, ...] = ()
    head: str = ""


def time_column(names: Sequence[str], units: Sequence[str], card: Card) -> int | None:
    """Find the column of time.

    Parameters
    ----------
    names, units : of the columns
    card : has patterns of the name, most wanted first

    Returns
    -------
    Its number: the first pattern that is the whole name of a column, or of what is left of one
    without the number of a channel or an underscore before it (``_Time``); else the one column in
    a unit of time whose name speaks of time. None where there is no such column, or several.
    """
    for called in (list(names), [plain_name(name) for name in names]):
        for pattern in card.time:
            for i, name in enumerate(called):
                if pattern.fullmatch(name):
                    return i
    timed = [
        i
        for i, (name, unit) in enumerate(zip(names, units, strict=False))
        if _OF_TIME.search(name) and is_like(unit, "s")
    ]
    return timed[0] if len(timed) == 1 else None


def word_columns(names: Sequence[str], card: Card) -> list[int]:
    """Find the columns that hold words by the card."""
    return [i for i, name in enumerate(names) if name in card.words]


def wanted_columns(
    header: Header, card: Card, channels: Sequence[Wanted] | None, path: object
) -> list[int]:
    """Choose the columns to read: those asked for, and time.

    Parameters
    ----------
    header : names and units of all columns
    card : says which one is time and which hold words
    channels : asked for, None for all; a name may carry its specimen before a slash
    path : named in errors

    Returns
    -------
    Numbers of the columns, ascending.

    Raises
    ------
    ReadError
        If a channel that is asked for does not exist.
    """
    names = header.names
    time = time_column(names, header.units, card)
    words = word_columns(names, card)
    numbers = [i for i in range(len(names)) if i not in words]
    if channels is None:
        return numbers
    paths = unique_names(names)
    offered = [i for i in numbers if i != time]
    pairs = [(names[i], paths[i]) for i in offered]
    chosen = {offered[find_channel(wanted, pairs, path)] for wanted in channels}
    always = {i for i, name in enumerate(names) if name in (*card.last_zeros, *card.last_code)}
    return sorted(chosen | always | ({time} if time is not None else set()))


def preamble(rows: Rows) -> dict[str, object]:
    """Keys and values of the rows above the names.

    Parameters
    ----------
    rows : cells; ``key, value, unit`` or ``key: value`` in one cell

    Returns
    -------
    Values by key, a list where a key stands several times; rows without a key under ``lines``. A
    line ``sep=;``, by which a spreadsheet is told the separator, says nothing and is left out.
    """
    found: dict[str, list[str]] = {}
    for row in rows:
        cells = [cell.strip() for cell in row if cell.strip()]
        if cells and not _SEPARATOR.fullmatch(cells[0]):
            key, value = _pair(cells)
            found.setdefault(key, []).append(value)
    return {
        key: values[0] if len(values) == 1 and key != "lines" else values
        for key, values in found.items()
    }


def _pair(cells: Sequence[str]) -> tuple[str, str]:
    if len(cells) > 1:
        return cells[0].rstrip(" :"), " ".join(cells[1:])
    key, colon, value = cells[0].partition(": ")
    if colon and 0 < len(key) < 60:
        return key.strip(), value.strip()
    return ("lines", cells[0]) if not cells[0].endswith(":") else (cells[0].rstrip(" :"), "")


def without_last_row(table: Table, card: Card) -> Table:
    """Leave out a last row of zeros that the card says is no sample."""
    by_name = {table.names[i]: values for i, values in table.columns.items()}
    rows = max((len(values) for values in table.columns.values()), default=0)
    if not card.last_zeros or not rows:
        return table
    expected = {**dict.fromkeys(card.last_zeros, 0.0), **card.last_code}
    if any(name not in by_name or by_name[name][-1] != value for name, value in expected.items()):
        return table
    said = ", ".join(f"{name} {value:g}" for name, value in expected.items())
    message = f"the last row ({rows}) is a mark and no sample ({said}): left out"
    note = QualityNote("last_row_left_out", Severity.INFO, "file", message)
    columns = {i: values[:-1] for i, values in table.columns.items()}
    return _replaced(table, columns, note)


def without_codes(table: Table, card: Card) -> Table:
    """Make the numbers that stand for missing values NaN."""
    if not card.missing:
        return table
    columns: dict[int, Floats] = {}
    for i, values in table.columns.items():
        gone = np.isin(values, card.missing)
        columns[i] = np.where(gone, np.nan, values) if gone.any() else values
    return _replaced(table, columns)


def _replaced(table: Table, columns: Mapping[int, Floats], *notes: QualityNote) -> Table:
    return Table(table.part, table.names, table.units, columns, table.also, (*table.notes, *notes))


def choose_part(tables: Sequence[Table], part: str | None, path: object) -> tuple[Table, ...]:
    """Choose one part of an export.

    Parameters
    ----------
    tables : all of them
    part : specimen or sheet wanted, None for all
    path : named in errors

    Raises
    ------
    ReadError
        If there is no such part; the nearest ones are listed.
    """
    if part is None or not tables:
        return tuple(tables)
    chosen = tuple(table for table in tables if part in {table.part, table.also} - {""})
    if chosen:
        return chosen
    known = [table.part or table.also for table in tables if table.part or table.also]
    close = ", ".join(f"'{name}'" for name in nearest(part, known))
    remedy = f"Nearest: {close}." if close else "Leave `part` out: the export does not name parts."
    raise unreadable(
        path,
        f"part '{part}'",
        f"one of the {len(tables)} specimens or sheets of the file",
        "no such part",
        remedy,
    )
