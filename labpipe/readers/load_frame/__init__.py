"""Reader of load-frame exports, with a card of data for each vendor's program.

**Writes this file**: the programs of the cards in ``dialects``, which are MTS TestSuite and 793,
Instron Bluehill and 8800, ZwickRoell testXpert, Lloyd Nexygen, Shimadzu Trapezium, Walter+Bai Dion,
HBM catman, Deben Microtest, TA Instruments DMA Q800 and TestResources. A lab can add cards.

**Recording**: the channels of one test, or of several specimens, each with its own clock.

**Units**: those of the export, except for time, which is in seconds.

**Missing data**: blank cells and the codes of the card become NaN, with a note for each channel.

**Clock and frame**: the time column, converted to seconds; row numbers if there is none.

**File structure**: as the card states; see docs/how-to/new-dialect.md.

**Known versions**: as in the cards.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import numpy as np

from labpipe.errors import ReadError, sort_by_likeness
from labpipe.readers.channels import (
    ChannelChoice,
    find_channels,
    make_alternative_notes,
    make_channel_notes,
    make_names_unique,
)
from labpipe.readers.load_frame.cards import Card, load_lab_cards, load_shipped_cards
from labpipe.readers.load_frame.tables import (
    MIN_TEST_ROWS,
    Export,
    Table,
    find_header,
    find_time_column,
    read_sheets,
    read_text,
)
from labpipe.readers.number_table import is_unit, make_row_count_notes, split_name_and_unit
from labpipe.readers.raw_files import (
    ContentError,
    add_file_name,
    decode,
    is_binary,
    is_blank,
    normalise_content,
    read_content,
    read_head,
)
from labpipe.readers.recording_checks import get_time_factor, make_clock_notes
from labpipe.readers.workbooks import clear_sheet_cache, format_head, is_workbook, open_sheets
from labpipe.records.quality import QualityNote
from labpipe.records.recording import Channel, Clock, Recording
from labpipe.units import get_conversion_factor, parse_count

__all__ = ["assemble_recording", "choose_card", "read", "recognise", "recognise_card"]

_SEPARATOR_LINE = re.compile(r"\A\"?sep=.\"?\n")
"""Pattern of a first line that states the separator to a spreadsheet."""
CardNames = str | Sequence[str] | None
"""Name of the card that must fit, or names of the cards of which one must fit; None for any."""


def recognise(path: Path) -> bool:
    """Return whether the content of a file fits a card of a load frame."""
    return recognise_card(path) is not None


def read(
    path: Path,
    *,
    channels: Sequence[ChannelChoice] | None = None,
    dialect: CardNames = None,
    part: str | None = None,
) -> Recording:
    """Read a load-frame export.

    Parameters
    ----------
    path : the export
    channels : names or paths of the wanted channels, None for all
    dialect : name of the card that must fit, or names of the cards of which one must fit; None for
        any
    part : name of the wanted specimen or sheet of an export with several, None for all

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
    with add_file_name(path):
        if card.kind == "text":
            export = read_text(read_content(path), card, path, channels if part is None else None)
        else:
            try:
                export = read_sheets(open_sheets(path), card)
            finally:
                clear_sheet_cache()
        return assemble_recording(export, card, path, channels, part)


def assemble_recording(
    export: Export,
    card: Card,
    path: object,
    channels: Sequence[ChannelChoice] | None = None,
    part: str | None = None,
) -> Recording:
    """Convert the tables of an export to a recording.

    Parameters
    ----------
    export : tables of the export
    card : card that describes the export
    path : path of the export, for the error on a channel
    channels : names or paths of the wanted channels, None for all
    part : name of the wanted specimen or sheet, None for all

    Returns
    -------
    The recording, with one clock for each table, values in the units of the file, and time in
    seconds.

    Raises
    ------
    ContentError, NoChannelError
        If a channel or part does not exist, or the unit of time is missing or wrong.
    """
    tables = [_drop_distant_rows(_clean_table(table, card), card) for table in export.tables]
    if part is not None and tables:
        tables = _choose_part(tables, part)
    notes = [*export.notes]
    if len(export.tables) == 1 and tables:
        notes += _make_count_notes(export, tables[0], card)
    if card.fallback:
        notes.append(QualityNote.of("readers.dialect_generic", "file"))
    recordings = [_convert_table(table, card, is_only_table=len(tables) == 1) for table in tables]
    selection = all_channels = [channel for x in recordings for channel in x.channels]
    if channels is not None:
        indices = sorted(set(find_channels(channels, selection, path))) if selection else []
        selection = [selection[i] for i in indices]
        clock_names = {channel.clock for channel in selection}
        if len(clock_names) == 1:
            candidates = [channel for channel in all_channels if channel.clock in clock_names]
            notes += make_alternative_notes(channels, candidates)
        recordings = [x for x in recordings if x.clocks[0].name in clock_names]
    model, version = (
        match[1].strip() if pattern is not None and (match := pattern.search(export.head)) else ""
        for pattern in (card.model, card.version)
    )
    clocks = {recording.clocks[0].name: recording.metadata for recording in recordings}
    notes += [note for recording in recordings for note in recording.notes]
    return Recording(
        reader="load-frame",
        program=f"{card.program} {model}".strip(),
        program_version=version,
        clocks=tuple(recording.clocks[0] for recording in recordings),
        channels=tuple(selection),
        metadata={"dialect": card.name, **export.properties, "clocks": clocks},
        notes=(*notes, *_make_missing_notes(selection, card), *make_channel_notes(selection)),
    )


def _clean_table(table: Table, card: Card) -> Table:
    """Replace the codes of missing values by NaN, and omit a last row that is not a sample."""
    columns = {
        i: np.where(np.isin(values, card.missing), np.nan, values) if card.missing else values
        for i, values in table.columns.items()
    }
    last_row = {table.names[i]: values[-1] for i, values in columns.items() if len(values)}
    marker = {**dict.fromkeys(card.last_zeros, 0.0), **card.last_code}
    if not card.last_zeros or any(last_row.get(name) != value for name, value in marker.items()):
        return replace(table, columns=columns)
    text = ", ".join(f"{name} {value:g}" for name, value in marker.items())
    note = QualityNote.of("readers.last_row_left_out", "file", row=table.n_rows, values=text)
    columns = {i: values[:-1] for i, values in columns.items()}
    return replace(table, columns=columns, notes=(*table.notes, note))


def _drop_distant_rows(table: Table, card: Card) -> Table:
    """Omit up to `max_rows` last rows far from the samples, such as statistics without a label.

    In the first omitted row, two or more columns jump, which are all columns or include the time. A
    jump is larger than `jump_factor` times the largest earlier step of the column.
    """
    max_rows, jump_factor = 3, 10.0
    steps = {i: np.abs(np.diff(values)) for i, values in table.columns.items()}
    time = find_time_column(table.names, table.units, card)
    for first in range(max(table.n_rows - max_rows, MIN_TEST_ROWS), table.n_rows):
        jumping_columns = {
            i
            for i, step in steps.items()
            if step[first - 1] > jump_factor * np.nanmax(step[: first - 1], initial=0.0)
        }
        is_all = jumping_columns == steps.keys()
        if len(jumping_columns) > 1 and (time in jumping_columns or is_all):
            columns = {i: values[:first] for i, values in table.columns.items()}
            text = ", ".join(f"{table.names[i]} {table.columns[i][first]:g}" for i in steps)
            note = QualityNote.of("readers.rows_apart", "file", row=first + 1, values=text)
            return replace(table, columns=columns, notes=(*table.notes, note))
    return table


def _choose_part(tables: list[Table], part: str) -> list[Table]:
    """Choose the tables of a specimen or sheet, or raise ContentError if there are none."""
    if matches := [table for table in tables if part in {table.part, table.sheet_name} - {""}]:
        return matches
    names = [table.part or table.sheet_name for table in tables if table.part or table.sheet_name]
    nearest_names = ", ".join(f"'{name}'" for name in sort_by_likeness(part, names))
    facts = {"count": len(tables), "nearest": nearest_names}
    raise ContentError.of(
        "readers.no_such_part" if nearest_names else "readers.no_parts", f"part '{part}'", **facts
    )


def _make_count_notes(export: Export, table: Table, card: Card) -> list[QualityNote]:
    """Make notes if the export states other numbers of samples or columns than the table has."""
    stated_rows, stated_columns = (
        parse_count(str(export.properties.get(key, "")))
        for key in (card.stated_rows, card.stated_columns)
    )
    notes = make_row_count_notes(stated_rows, table.n_rows)
    facts = {"stated": stated_columns, "held": len(table.names)}
    if stated_columns not in {None, len(table.names)}:
        notes.append(QualityNote.of("readers.columns_differ", "file", **facts))
    return notes


def _convert_table(table: Table, card: Card, *, is_only_table: bool) -> Recording:
    """Convert one table to a recording with one clock; the metadata describe this clock."""
    clock_name, prefix = ("time", "") if is_only_table else (table.part, f"{table.part}/")
    time_column = find_time_column(table.names, table.units, card)
    if time_column is not None and np.isnan(table.columns[time_column]).any():
        # Blank rows can be omitted, because the times of the other rows show lost samples.
        is_blank = np.isnan([*table.columns.values()]).all(axis=0)
        if is_blank.any():
            columns = {i: values[~is_blank] for i, values in table.columns.items()}
            note = QualityNote.of("readers.blank_rows", "file", count=is_blank.sum())
            table = replace(table, columns=columns, notes=(*table.notes, note))
    for i in table.columns:
        _check_unit(table.names[i], table.units[i])
    paths = make_names_unique(table.names)
    names = [name or path for name, path in zip(table.names, paths, strict=True)]
    channels = [
        Channel(names[i], prefix + paths[i], values, clock_name, unit_in_file=table.units[i])
        for i, values in table.columns.items()
        if i != time_column
    ]
    metadata, notes, place = dict[str, object](), [*table.notes], f"clock {clock_name}"
    if time_column is None:
        clock = Clock(clock_name, np.arange(table.n_rows, dtype=np.float64), unit="1")
        notes.append(QualityNote.of("readers.no_time", place, rows=table.n_rows))
    else:
        unit, time = table.units[time_column] or card.time_unit, table.columns[time_column]
        factor = get_time_factor(unit, f"column '{table.names[time_column]}'")
        clock = Clock(clock_name, time if factor == 1.0 else factor * time)
        metadata |= {"time": table.names[time_column], "unit_in_file": unit}
        notes += make_clock_notes(clock, is_variable=card.variable_rate)
    if 0 < table.n_rows < MIN_TEST_ROWS:
        notes.append(QualityNote.of("readers.few_samples", place, rows=table.n_rows))
    if part := table.part or table.sheet_name:
        metadata["part"] = part
    return Recording("", "", "", (clock,), tuple(channels), metadata=metadata, notes=tuple(notes))


def _check_unit(name: str, unit: str) -> None:
    """Refuse a name with a unit other than that of the column, such as ``Force (kN)`` for N."""
    _, unit_in_name = split_name_and_unit(name) or ("", unit)
    if unit and unit != unit_in_name and is_unit(unit) and is_unit(unit_in_name):
        with suppress(ValueError):  # the units differ in dimension
            if get_conversion_factor(unit, unit_in_name) == 1.0:
                return
        raise ContentError.of("readers.units_contradict", f"column '{name}'", unit=unit)


def _make_missing_notes(channels: Sequence[Channel], card: Card) -> Iterator[QualityNote]:
    """Make a note on each channel in which values are missing."""
    codes = " or ".join(f"{code:.0f}" for code in card.missing)
    codes_text = f" (blank or {codes})" if codes else ""
    for channel in channels:
        if len(rows := np.flatnonzero(np.isnan(channel.values))):
            facts = {"count": len(rows), "total": len(channel.values), "first": rows[0] + 1}
            yield QualityNote.of("readers.missing_values", channel.path, **facts, codes=codes_text)


def recognise_card(path: Path) -> Card | None:
    """Find the card that fits an export.

    Parameters
    ----------
    path : the export

    Returns
    -------
    The card; None if none fits. A lab's own card has priority over a card of labpipe, and fallback
    cards of labpipe are tried last.

    Raises
    ------
    ReadError
        If the file cannot be read, two cards of equal priority fit, or a lab's card is invalid.
    """
    kind = "workbook" if is_workbook(path) else "text"
    read_head(path, 1)  # raises an error if the file cannot be read
    read_heads = cache(partial(_read_heads, path))
    shipped_cards = load_shipped_cards().values()
    cards_by_priority = (
        load_lab_cards().values(),
        [card for card in shipped_cards if not card.fallback],
        [card for card in shipped_cards if card.fallback],
    )
    for cards in cards_by_priority:
        matches = [
            card
            for card in cards
            if card.kind == kind
            and any(_fits_card(card, head, sheet) for sheet, head in read_heads(card.encodings))
        ]
        if len(matches) > 1:
            names = " and ".join(card.name for card in matches)
            raise ReadError.about("readers.several_cards", path, cards=names)
        if matches:
            return matches[0]
    return None


def choose_card(path: Path, dialect: CardNames) -> Card:
    """Choose the card for reading an export.

    Parameters
    ----------
    path : the export
    dialect : name of the card that must fit, or names of the cards of which one must fit; None for
        any

    Returns
    -------
    The card that fits the export. If no card or only a fallback card fits, the single named card is
    returned, and the structure of the export is checked on reading.

    Raises
    ------
    ReadError
        If there is no card of a given name, or only another card or no card fits the export.
    """
    cards = {**load_shipped_cards(), **load_lab_cards()}
    named_dialects = [dialect] if isinstance(dialect, str) else list(dialect or ())
    for name in named_dialects:
        if name not in cards:
            nearest, count = ", ".join(sort_by_likeness(name, list(cards), limit=3)), len(cards)
            place = f"dialect '{name}'"
            raise ReadError.about("readers.no_such_card", path, place, count=count, nearest=nearest)
    card = recognise_card(path)
    if card is not None and (not named_dialects or card.name in named_dialects):
        return card
    if len(named_dialects) == 1 and (card is None or card.fallback):
        return cards[named_dialects[0]]
    dialects = " or ".join(named_dialects or cards)
    description = (
        "an export that no card recognises" if card is None else f"one of the dialect {card.name}"
    )
    raise ReadError.about("readers.other_card_fits", path, dialects=dialects, found=description)


def _read_heads(path: Path, encodings: tuple[str, ...]) -> list[tuple[str, str]]:
    """Read the names and the heads of the sheets of an export.

    A text has one head, with an empty name; a text with only a byte order mark has an empty head.
    """
    head_length = 16384  # characters; the longest known header has 3300
    with suppress(ContentError, ReadError):
        if is_workbook(path):
            return [(name, format_head(rows)) for name, rows in open_sheets(path).items()]
        content = normalise_content(read_head(path))
        if is_blank(content.data):
            return [("", "")] if content.file_encoding else []
        if not is_binary(content):
            text = decode(content.data, content, encodings).replace("\r\n", "\n")
            return [("", _SEPARATOR_LINE.sub("", text)[:head_length])]
    return []


def _fits_card(card: Card, head: str, sheet: str) -> bool:
    """Return whether a head fits a card.

    For a fallback card, the head must also be that of a test, with a column of time, and with a
    unit of another column or names that fit the card.
    """
    if not head:  # the file has only a byte order mark, or the sheet is empty
        return card.blank
    if not card.fits(head) or not card.fallback:
        return card.fits(head)
    try:
        header = find_header(head.split("\n"), card, sheet=sheet)
    except ContentError:
        return False
    time_column = find_time_column(header.names, header.units, card)
    has_units = any(unit for i, unit in enumerate(header.units) if i != time_column)
    return time_column is not None and (has_units or card.fits("\t".join(header.names)))
