"""Reader of load-frame exports: one reader, and a card of data per vendor's program.

**Writes this file**: the programs of the cards in ``dialects``: MTS TestSuite and 793, Instron
Bluehill and 8800, ZwickRoell testXpert, Lloyd Nexygen, Shimadzu Trapezium, Walter+Bai Dion, HBM
catman, Deben Microtest, TA Instruments DMA Q800, TestResources; a lab adds its own.

**Recording**: the channels of one test; with several specimens, each on its own clock.

**Units**: `unit_in_file` as in the export, values in that unit; time in seconds.

**Missing data**: blank cells and the codes of the card become NaN, noted per channel.

**Clock and frame**: the time column as written, in seconds; row numbers if there is none.

**File structure**: as in the card; see docs/how-to/new-dialect.md.

**Known versions**: as in the cards.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from labpipe.errors import nearest
from labpipe.readers.channels import ReportOptions, channel_notes, find_in_parts, unique_names
from labpipe.readers.load_frame.cards import Card
from labpipe.readers.load_frame.column_titles import time_column
from labpipe.readers.load_frame.recognition import CardNames, choose_card, recognise_card
from labpipe.readers.load_frame.tables import (
    MIN_SAMPLES,
    Export,
    Table,
    file_note,
    read_sheets,
    read_text,
)
from labpipe.readers.raw_files import read_content, unreadable
from labpipe.readers.time_axes import clock_notes
from labpipe.readers.workbooks import forget_sheets, open_sheets
from labpipe.records.quality import QualityNote, Severity
from labpipe.records.recording import Channel, Clock, Recording
from labpipe.units import si_factor, whole_number

__all__ = ["assemble", "read", "recognise"]

_STATE_UNIT = (
    "Write it in a row below the names, or in brackets as in 'Time (s)', or state it in a card of"
    " your own (time_unit); see docs/how-to/new-dialect.md."
)


def recognise(path: Path) -> bool:
    """Return whether the content of a file fits a card of a load frame."""
    return recognise_card(path) is not None


def read(
    path: Path,
    *,
    channels: Sequence[ReportOptions] | None = None,
    dialect: CardNames = None,
    part: str | None = None,
) -> Recording:
    """Read a load-frame export.

    Parameters
    ----------
    path : the export
    channels : names or paths wanted, None for all
    dialect : name of the card, or cards, that must fit; None for any
    part : wanted specimen or sheet of an export with several, None for all

    Returns
    -------
    The recording. A file with only a byte order mark gives a recording without clocks and
    channels, and the note ``no_samples``.

    Raises
    ------
    ReadError
        If no allowed card fits, names, units or numbers are not where the card states, a cell is
        not a number, or a wanted channel or part does not exist.
    """
    card = choose_card(path, dialect)
    if card.kind == "text":
        export = read_text(read_content(path), card, path, channels if part is None else None)
    else:
        try:
            export = read_sheets(open_sheets(path), card, path)
        finally:
            forget_sheets()
    return assemble(export, card, path, channels, part)


def assemble(
    export: Export,
    card: Card,
    path: object,
    channels: Sequence[ReportOptions] | None = None,
    part: str | None = None,
) -> Recording:
    """Convert the tables of an export to a recording.

    Parameters
    ----------
    export : its tables
    card : its card
    path : named in errors
    channels : wanted names or paths, None for all
    part : wanted specimen or sheet, None for all

    Returns
    -------
    The recording: one clock per table; values in the units of the file, time in seconds.

    Raises
    ------
    ReadError
        If a channel or part does not exist, or the unit of time is missing or wrong.
    """
    tables = [_without_codes(_without_mark(table, card), card) for table in export.tables]
    tables = _choose_part(tables, part, path)
    notes = [*export.notes]
    if len(export.tables) == 1 and tables:
        notes += _count_notes(export, tables[0], card)
    if card.fallback:
        message = "no vendor's card fits: names and units were detected by their text, check them"
        notes.append(file_note("dialect_generic", message))
    several = len(tables) > 1
    clocks, about_clocks, all_channels = [], {}, list[Channel]()
    clock_notes_by_name = {}
    for table in tables:
        name = table.part if several else "time"
        column = time_column(table.names, table.units, card)
        clock, about, its_notes = _clock(table, column, name, card, path)
        clocks.append(clock)
        about_clocks[name] = about
        clock_notes_by_name[name] = [*table.notes, *its_notes]
        all_channels += _channels(table, column, name, f"{table.part}/" if several else "")
    chosen, kept = all_channels, {clock.name for clock in clocks}
    if channels is not None:
        if all_channels:
            indices = sorted(set(find_in_parts(channels, all_channels, path)))
            chosen = [all_channels[i] for i in indices]
        kept = {channel.clock for channel in chosen}
    notes += [
        note for name in clock_notes_by_name if name in kept for note in clock_notes_by_name[name]
    ]
    return Recording(
        reader="load-frame",
        program=" ".join((card.program, _match_group(card.model, export.head))).strip(),
        program_version=_match_group(card.version, export.head),
        clocks=tuple(clock for clock in clocks if clock.name in kept),
        channels=tuple(chosen),
        metadata={
            "dialect": card.name,
            **export.about,
            "clocks": {name: about for name, about in about_clocks.items() if name in kept},
        },
        notes=(*notes, *_missing_notes(chosen, card), *channel_notes(chosen)),
    )


def _match_group(pattern: re.Pattern[str] | None, head: str) -> str:
    match = pattern.search(head) if pattern is not None else None
    return match[1].strip() if match else ""


def _without_mark(table: Table, card: Card) -> Table:
    """Omit a last row of zeros that is a mark, not a sample, according to the card."""
    if not card.last_zeros or not table.rows:
        return table
    last = {table.names[i]: values[-1] for i, values in table.columns.items()}
    mark = {**dict.fromkeys(card.last_zeros, 0.0), **card.last_code}
    if any(last.get(name) != value for name, value in mark.items()):
        return table
    values_text = ", ".join(f"{name} {value:g}" for name, value in mark.items())
    message = f"the last row ({table.rows}) is a mark, not a sample ({values_text}): left out"
    note = file_note("last_row_left_out", message)
    columns = {i: values[:-1] for i, values in table.columns.items()}
    return replace(table, columns=columns, notes=(*table.notes, note))


def _without_codes(table: Table, card: Card) -> Table:
    """Replace the codes of missing values by NaN."""
    if not card.missing:
        return table
    columns = {
        i: np.where(np.isin(values, card.missing), np.nan, values)
        for i, values in table.columns.items()
    }
    return replace(table, columns=columns)


def _choose_part(tables: list[Table], part: str | None, path: object) -> list[Table]:
    if part is None or not tables:
        return tables
    chosen = [table for table in tables if part in {table.part, table.also} - {""}]
    if chosen:
        return chosen
    names = [table.part or table.also for table in tables if table.part or table.also]
    close = ", ".join(f"'{name}'" for name in nearest(part, names))
    remedy = f"Nearest: {close}." if close else "Leave `part` out: the export does not name parts."
    expected = f"one of the {len(tables)} specimens or sheets of the file"
    raise unreadable(path, f"part '{part}'", expected, "no such part", remedy)


def _count_notes(export: Export, table: Table, card: Card) -> list[QualityNote]:
    """Compare the stated numbers of samples and of columns with the actual ones."""
    notes = []
    for what, key, count in (
        ("rows", card.stated_rows, table.rows),
        ("columns", card.stated_columns, len(table.names)),
    ):
        stated = whole_number(str(export.about.get(key, ""))) if key else None
        if stated not in {None, count}:
            message = f"the header states {stated} {what}, the file holds {count}"
            notes.append(file_note(f"{what}_differ", message, Severity.WARNING))
    return notes


def _channels(table: Table, time: int | None, clock: str, prefix: str) -> list[Channel]:
    paths = unique_names(table.names)
    return [
        Channel(
            name=table.names[i] or paths[i],
            path=prefix + paths[i],
            values=values,
            clock=clock,
            unit_in_file=table.units[i],
        )
        for i, values in table.columns.items()
        if i != time
    ]


def _clock(
    table: Table, column: int | None, name: str, card: Card, path: object
) -> tuple[Clock, dict[str, object], list[QualityNote]]:
    where, about = f"clock {name}", dict[str, object]()
    if column is None:
        message = f"the export has no time: its {table.rows} rows are counted from 0"
        clock = Clock(name, np.arange(table.rows, dtype=np.float64), unit="1")
        notes = [file_note("no_time", message, where=where)]
    else:
        unit = table.units[column] or card.time_unit
        factor, time = _seconds(unit, table.names[column], path), table.columns[column]
        clock = Clock(name, time if factor == 1.0 else factor * time)
        about = {"time": table.names[column], "unit_in_file": unit}
        notes = clock_notes(clock, is_variable=card.variable_rate)
    if 0 < table.rows < MIN_SAMPLES:
        message = f"only {table.rows} samples: the test was not completed, or not exported"
        message += " completely"
        notes.append(file_note("few_samples", message, Severity.WARNING, where))
    if table.part or table.also:
        about["part"] = table.part or table.also
    return clock, about, notes


def _seconds(unit: str, name: str, path: object) -> float:
    for spelling in (unit, unit.casefold()):
        try:
            return si_factor(spelling or "none", "s")
        except ValueError:
            continue
    found, remedy = (f"'{unit}'", "Correct the row of units.") if unit else ("none", _STATE_UNIT)
    raise unreadable(path, f"column '{name}'", "a unit of time such as s", found, remedy)


def _missing_notes(channels: Sequence[Channel], card: Card) -> list[QualityNote]:
    codes = " or ".join(f"{code:.0f}" for code in card.missing)
    notes = []
    for channel in channels:
        blank = np.flatnonzero(np.isnan(channel.values))
        if len(blank):
            message = f"{len(blank)} of {len(channel.values)} values are missing"
            message += f" (blank or {codes})" * bool(codes) + f", the first in row {blank[0] + 1}"
            notes.append(file_note("missing_values", message, Severity.WARNING, channel.path))
    return notes
