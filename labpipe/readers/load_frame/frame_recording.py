"""Conversion of the tables of an export to a recording."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from labpipe.errors import nearest
from labpipe.readers.channels import (
    ReportOptions,
    channel_notes,
    find_channel,
    find_in_parts,
    plain_name,
    unique_names,
)
from labpipe.readers.load_frame.cards import Card
from labpipe.readers.load_frame.column_titles import Header, Rows
from labpipe.readers.raw_files import unreadable
from labpipe.readers.text_cells import has_dimension_of
from labpipe.readers.time_axes import clock_notes
from labpipe.records.arrays import Floats
from labpipe.records.quality import QualityNote, Severity
from labpipe.records.recording import Channel, Clock, Recording
from labpipe.units import si_factor

_STATE_UNIT = (
    "Write it in a row below the names, or in brackets as in 'Time (s)', or state it in a card of"
    " your own (time_unit); see docs/how-to/new-dialect.md."
)
MIN_SAMPLES = 10
"""Fewer samples are not a complete test."""
_TIME_WORDS = re.compile(r"(?i)time|zeit|temps|tempo|tiempo|czas|tijd|时间|時間")
_SEPARATOR_CELL = re.compile(r"sep=.?")


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    clock: Clock
    channels: list[Channel]
    about: dict[str, object]
    notes: list[QualityNote]


def assemble(
    export: Export, card: Card, path: object, channels: Sequence[ReportOptions] | None = None
) -> Recording:
    """Convert the tables of an export to a recording.

    Parameters
    ----------
    export : its tables, without rows that are not samples
    card : its card
    path : named in errors
    channels : wanted names or paths, None for all

    Returns
    -------
    The recording: one clock per table; values in the units of the file, time in seconds.

    Raises
    ------
    ReadError
        If a channel does not exist, or the unit of time is missing or wrong.
    """
    several = len(export.tables) > 1
    parts = [_part(table, card, path, several=several) for table in export.tables]
    all_channels = [channel for part in parts for channel in part.channels]
    chosen = all_channels
    if channels is not None and all_channels:
        indices = sorted(set(find_in_parts(channels, all_channels, path)))
        chosen = [all_channels[i] for i in indices]
    clocks = {channel.clock for channel in chosen} if channels is not None else None
    kept = [part for part in parts if clocks is None or part.clock.name in clocks]
    notes = [note for part in kept for note in part.notes]
    return Recording(
        reader="load-frame",
        program=" ".join((card.program, _match_group(card.model, export.head))).strip(),
        program_version=_match_group(card.version, export.head),
        clocks=tuple(part.clock for part in kept),
        channels=tuple(chosen),
        metadata={
            "dialect": card.name,
            **export.about,
            "clocks": {part.clock.name: part.about for part in kept},
        },
        notes=(*export.notes, *notes, *_channel_notes(chosen, card)),
    )


def _match_group(pattern: re.Pattern[str] | None, head: str) -> str:
    match = pattern.search(head) if pattern is not None else None
    return match[1].strip() if match else ""


def _part(table: Table, card: Card, path: object, *, several: bool) -> _Part:
    column = time_column(table.names, table.units, card)
    clock_name = table.part if several else "time"
    clock, about, notes = _clock(table, column, clock_name, card, path)
    prefix = f"{table.part}/" if several else ""
    paths = unique_names(table.names)
    channels = [
        Channel(
            name=table.names[i] or paths[i],
            path=prefix + paths[i],
            values=values,
            clock=clock_name,
            unit_in_file=table.units[i],
        )
        for i, values in table.columns.items()
        if i != column
    ]
    if table.part or table.also:
        about |= {"part": table.part or table.also}
    return _Part(clock, channels, about, [*table.notes, *notes])


def _clock(
    table: Table, column: int | None, name: str, card: Card, path: object
) -> tuple[Clock, dict[str, object], list[QualityNote]]:
    rows = max((len(values) for values in table.columns.values()), default=0)
    if column is None:
        message = f"the export has no time: its {rows} rows are counted from 0"
        note = QualityNote("no_time", Severity.INFO, f"clock {name}", message)
        few = _few_note(rows, name)
        return Clock(name, np.arange(rows, dtype=np.float64), unit="1"), {}, [note, *few]
    unit = table.units[column] or card.time_unit
    factor = _seconds(unit, table.names[column], path)
    time: Floats = table.columns[column]
    clock = Clock(name, time if factor == 1.0 else factor * time)
    about: dict[str, object] = {"time": table.names[column], "unit_in_file": unit}
    return (
        clock,
        about,
        [*clock_notes(clock, is_variable=card.variable_rate), *_few_note(rows, name)],
    )


def _seconds(unit: str, name: str, path: object) -> float:
    try:
        return si_factor(unit or "none", "s")
    except ValueError:
        pass
    try:
        return si_factor(unit.casefold() or "none", "s")
    except ValueError as error:
        raise unreadable(
            path,
            f"column '{name}'",
            "a unit of time such as s",
            f"'{unit}'" if unit else "none",
            "Correct the row of units." if unit else _STATE_UNIT,
        ) from error


def _few_note(rows: int, name: str) -> list[QualityNote]:
    if rows >= MIN_SAMPLES or not rows:
        return []
    message = f"only {rows} samples: the test was not completed, or not exported completely"
    return [QualityNote("few_samples", Severity.WARNING, f"clock {name}", message)]


def _channel_notes(channels: Sequence[Channel], card: Card) -> list[QualityNote]:
    blank = [(channel, int(np.isnan(channel.values).sum())) for channel in channels]
    missing = [_missing_note(channel, count, card) for channel, count in blank if count]
    return [*missing, *channel_notes(channels)]


def _missing_note(channel: Channel, count: int, card: Card) -> QualityNote:
    codes = " or ".join(f"{code:.0f}" for code in card.missing)
    first = int(np.flatnonzero(np.isnan(channel.values))[0]) + 1
    message = f"{count} of {len(channel.values)} values are missing"
    message += f" (blank or {codes})" * bool(codes) + f", the first in row {first}"
    return QualityNote("missing_values", Severity.WARNING, channel.path, message)


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """Columns of numbers on one clock.

    Parameters
    ----------
    part : specimen or sheet, empty if the export has only one
    names, units : of the columns
    columns : by index of the column, all of shape (rows,); only wanted ones
    also : another name of the part, such as that of the sheet
    notes : quality notes
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
    about : its properties
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
    card : has patterns of the name, preferred first

    Returns
    -------
    Its index: the column whose whole name matches the first pattern, with or without the prefix of
    a channel number or an underscore (``_Time``); else the only column in a unit of time whose name
    contains a word for time. None if there is no such column, or several. Columns of text are
    ignored.
    """
    names = ["" if name in card.words else name for name in names]
    for called in (names, [plain_name(name) for name in names]):
        for pattern in card.time:
            for i, name in enumerate(called):
                if pattern.fullmatch(name):
                    return i
    timed = [
        i
        for i, (name, unit) in enumerate(zip(names, units, strict=False))
        if _TIME_WORDS.search(name) and has_dimension_of(unit, "s")
    ]
    return timed[0] if len(timed) == 1 else None


def word_columns(names: Sequence[str], card: Card) -> list[int]:
    """Return the columns of text according to the card."""
    return [i for i, name in enumerate(names) if name in card.words]


def wanted_columns(
    header: Header, card: Card, channels: Sequence[ReportOptions] | None, path: object
) -> list[int]:
    """Choose the columns to read: the wanted ones and time.

    Parameters
    ----------
    header : names and units of all columns
    card : determines the time column and the columns of text
    channels : wanted ones, None for all; a name may have its specimen before a slash
    path : named in errors

    Returns
    -------
    Indices of the columns, ascending.

    Raises
    ------
    ReadError
        If a wanted channel does not exist.
    """
    names = header.names
    time = time_column(names, header.units, card)
    text_columns = word_columns(names, card)
    numbers = [i for i in range(len(names)) if i not in text_columns]
    if channels is None:
        return numbers
    paths = unique_names(names)
    offered = [i for i in numbers if i != time]
    pairs = [(names[i], paths[i]) for i in offered]
    chosen = {offered[find_channel(wanted, pairs, path)] for wanted in channels}
    always = {i for i, name in enumerate(names) if name in (*card.last_zeros, *card.last_code)}
    return sorted(chosen | always | ({time} if time is not None else set()))


def preamble(rows: Rows) -> dict[str, object]:
    """Return keys and values of the rows above the names.

    Parameters
    ----------
    rows : cells; ``key, value, unit`` or ``key: value`` in one cell

    Returns
    -------
    Values by key, a list if a key occurs several times; rows without a key under ``lines``. A line
    ``sep=;``, which states the separator to a spreadsheet, is omitted.
    """
    entries: dict[str, list[str]] = {}
    for row in rows:
        cells = [cell.strip() for cell in row if cell.strip()]
        if cells and not _SEPARATOR_CELL.fullmatch(cells[0]):
            key, value = _pair(cells)
            entries.setdefault(key, []).append(value)
    return {
        key: values[0] if len(values) == 1 and key != "lines" else values
        for key, values in entries.items()
    }


def _pair(cells: Sequence[str]) -> tuple[str, str]:
    if len(cells) > 1:
        return cells[0].rstrip(" :"), " ".join(cells[1:])
    key, colon, value = cells[0].partition(": ")
    if colon and 0 < len(key) < 60:
        return key.strip(), value.strip()
    return ("lines", cells[0]) if not cells[0].endswith(":") else (cells[0].rstrip(" :"), "")


def without_last_row(table: Table, card: Card) -> Table:
    """Omit a last row of zeros that is not a sample according to the card."""
    by_name = {table.names[i]: values for i, values in table.columns.items()}
    rows = max((len(values) for values in table.columns.values()), default=0)
    if not card.last_zeros or not rows:
        return table
    expected = {**dict.fromkeys(card.last_zeros, 0.0), **card.last_code}
    if any(name not in by_name or by_name[name][-1] != value for name, value in expected.items()):
        return table
    values_text = ", ".join(f"{name} {value:g}" for name, value in expected.items())
    message = f"the last row ({rows}) is a mark, not a sample ({values_text}): left out"
    note = QualityNote("last_row_left_out", Severity.INFO, "file", message)
    columns = {i: values[:-1] for i, values in table.columns.items()}
    return _with_columns(table, columns, note)


def without_codes(table: Table, card: Card) -> Table:
    """Replace the codes of missing values by NaN."""
    if not card.missing:
        return table
    columns: dict[int, Floats] = {}
    for i, values in table.columns.items():
        gone = np.isin(values, card.missing)
        columns[i] = np.where(gone, np.nan, values) if gone.any() else values
    return _with_columns(table, columns)


def _with_columns(table: Table, columns: Mapping[int, Floats], *notes: QualityNote) -> Table:
    return Table(table.part, table.names, table.units, columns, table.also, (*table.notes, *notes))


def choose_part(tables: Sequence[Table], part: str | None, path: object) -> tuple[Table, ...]:
    """Choose one part of an export.

    Parameters
    ----------
    tables : all of them
    part : wanted specimen or sheet, None for all
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
    part_names = [table.part or table.also for table in tables if table.part or table.also]
    close = ", ".join(f"'{name}'" for name in nearest(part, part_names))
    remedy = f"Nearest: {close}." if close else "Leave `part` out: the export does not name parts."
    raise unreadable(
        path,
        f"part '{part}'",
        f"one of the {len(tables)} specimens or sheets of the file",
        "no such part",
        remedy,
    )
