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
from typing import NamedTuple

import numpy as np

from labpipe.errors import ReadError, nearest
from labpipe.readers.channels import ReportOptions, channel_notes, find_in_parts, unique_names
from labpipe.readers.load_frame.cards import Card
from labpipe.readers.load_frame.column_titles import time_column
from labpipe.readers.load_frame.recognition import CardNames, choose_card, recognise_card
from labpipe.readers.load_frame.tables import MIN_SAMPLES, Export, Table, read_sheets, read_text
from labpipe.readers.number_table import rows_note
from labpipe.readers.raw_files import read_content
from labpipe.readers.recording_checks import clock_notes
from labpipe.readers.workbooks import forget_sheets, open_sheets
from labpipe.records.quality import QualityNote
from labpipe.records.recording import Channel, Clock, Recording
from labpipe.units import si_factor, whole_number

__all__ = ["assemble", "read", "recognise"]


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
    tables = [_without_mark(_without_codes(table, card), card) for table in export.tables]
    tables = _choose_part(tables, part, path)
    notes = [*export.notes]
    if len(export.tables) == 1 and tables:
        notes += _count_notes(export, tables[0], card)
    if card.fallback:
        notes.append(QualityNote.of("readers.dialect_generic", "file"))
    parts = [_part(table, card, path, is_alone=len(tables) == 1) for table in tables]
    chosen = [channel for its in parts for channel in its.channels]
    if channels is not None:
        if chosen:
            indices = sorted(set(find_in_parts(channels, chosen, path)))
            chosen = [chosen[i] for i in indices]
        used = {channel.clock for channel in chosen}
        parts = [its for its in parts if its.clock.name in used]
    notes += [note for its in parts for note in its.notes]
    return Recording(
        reader="load-frame",
        program=" ".join((card.program, _match_group(card.model, export.head))).strip(),
        program_version=_match_group(card.version, export.head),
        clocks=tuple(its.clock for its in parts),
        channels=tuple(chosen),
        metadata={
            "dialect": card.name,
            **export.about,
            "clocks": {its.clock.name: its.about for its in parts},
        },
        notes=(*notes, *_missing_notes(chosen, card), *channel_notes(chosen)),
    )


def _match_group(pattern: re.Pattern[str] | None, head: str) -> str:
    match = pattern.search(head) if pattern is not None else None
    return match[1].strip() if match else ""


def _without_codes(table: Table, card: Card) -> Table:
    """Replace the codes of missing values by NaN."""
    columns = {
        i: np.where(np.isin(values, card.missing), np.nan, values) if card.missing else values
        for i, values in table.columns.items()
    }
    return replace(table, columns=columns)


def _without_mark(table: Table, card: Card) -> Table:
    """Omit a last row of zeros that is a mark, not a sample, according to the card."""
    if not card.last_zeros or not table.rows:
        return table
    last = {table.names[i]: values[-1] for i, values in table.columns.items()}
    mark = {**dict.fromkeys(card.last_zeros, 0.0), **card.last_code}
    if any(last.get(name) != value for name, value in mark.items()):
        return table
    values_text = ", ".join(f"{name} {value:g}" for name, value in mark.items())
    note = QualityNote.of("readers.last_row_left_out", "file", row=table.rows, values=values_text)
    columns = {i: values[:-1] for i, values in table.columns.items()}
    return replace(table, columns=columns, notes=(*table.notes, note))


def _choose_part(tables: list[Table], part: str | None, path: object) -> list[Table]:
    if part is None or not tables:
        return tables
    chosen = [table for table in tables if part in {table.part, table.also} - {""}]
    if chosen:
        return chosen
    names = [table.part or table.also for table in tables if table.part or table.also]
    close = ", ".join(f"'{name}'" for name in nearest(part, names))
    raise ReadError.about(
        "readers.no_such_part" if close else "readers.no_parts",
        path,
        f"part '{part}'",
        count=len(tables),
        nearest=close,
    )


def _count_notes(export: Export, table: Table, card: Card) -> list[QualityNote]:
    """Compare the stated numbers of samples and of columns with the actual ones."""
    rows, columns = (
        whole_number(str(export.about.get(key, ""))) if key else None
        for key in (card.stated_rows, card.stated_columns)
    )
    notes, held = rows_note(rows, table.rows), len(table.names)
    if columns not in {None, held}:
        notes.append(QualityNote.of("readers.columns_differ", "file", stated=columns, held=held))
    return notes


class _Part(NamedTuple):
    """One table as part of the recording: its clock, what is known of it, channels, notes."""

    clock: Clock
    about: dict[str, object]
    channels: list[Channel]
    notes: list[QualityNote]


def _part(table: Table, card: Card, path: object, *, is_alone: bool) -> _Part:
    name, prefix = ("time", "") if is_alone else (table.part, f"{table.part}/")
    column = time_column(table.names, table.units, card)
    paths = unique_names(table.names)
    channels = [
        Channel(table.names[i] or paths[i], prefix + paths[i], values, name, None, table.units[i])
        for i, values in table.columns.items()
        if i != column
    ]
    about, notes = dict[str, object](), [*table.notes]
    if column is None:
        clock = Clock(name, np.arange(table.rows, dtype=np.float64), unit="1")
        notes.append(QualityNote.of("readers.no_time", f"clock {name}", rows=table.rows))
    else:
        unit = table.units[column] or card.time_unit
        factor, time = _seconds(unit, table.names[column], path), table.columns[column]
        clock = Clock(name, time if factor == 1.0 else factor * time)
        about |= {"time": table.names[column], "unit_in_file": unit}
        notes += clock_notes(clock, is_variable=card.variable_rate)
    if 0 < table.rows < MIN_SAMPLES:
        notes.append(QualityNote.of("readers.few_samples", f"clock {name}", rows=table.rows))
    if table.part or table.also:
        about["part"] = table.part or table.also
    return _Part(clock, about, channels, notes)


def _seconds(unit: str, name: str, path: object) -> float:
    for spelling in (unit, unit.casefold()):
        try:
            return si_factor(spelling or "none", "s")
        except ValueError:
            continue
    raise ReadError.about(
        "readers.no_unit_of_time" if unit else "readers.time_without_unit",
        path,
        f"column '{name}'",
        unit=unit,
    )


def _missing_notes(channels: Sequence[Channel], card: Card) -> list[QualityNote]:
    codes = " or ".join(f"{code:.0f}" for code in card.missing)
    shown = f" (blank or {codes})" if codes else ""
    missing = [(channel, np.flatnonzero(np.isnan(channel.values))) for channel in channels]
    return [
        QualityNote.of(
            "readers.missing_values",
            channel.path,
            count=len(rows),
            total=len(channel.values),
            codes=shown,
            first=rows[0] + 1,
        )
        for channel, rows in missing
        if len(rows)
    ]
