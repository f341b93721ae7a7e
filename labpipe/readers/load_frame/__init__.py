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
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from labpipe.errors import ReadError, sort_by_likeness
from labpipe.readers.channels import ChannelChoice, find_in_parts, make_channel_notes, unique_names
from labpipe.readers.load_frame.cards import Card, lab_cards, shipped_cards
from labpipe.readers.load_frame.column_titles import (
    Header,
    find_header,
    parse_header_rows,
    time_column,
)
from labpipe.readers.load_frame.tables import (
    MIN_TEST_ROWS,
    Export,
    Table,
    format_head,
    read_sheets,
    read_text,
)
from labpipe.readers.number_table import compare_row_counts
from labpipe.readers.raw_files import (
    as_content,
    decode,
    is_binary,
    is_blank,
    read_content,
    read_head,
)
from labpipe.readers.recording_checks import make_clock_notes
from labpipe.readers.workbooks import clear_sheet_cache, is_workbook, open_sheets
from labpipe.records.quality import QualityNote
from labpipe.records.recording import Channel, Clock, Recording
from labpipe.units import find_si_factor, parse_count

__all__ = ["assemble", "choose_card", "read", "recognise", "recognise_card"]

_SEPARATOR_LINE = re.compile(r"\A\"?sep=.\"?\n")
"""A first line that states the separator to a spreadsheet."""
CardNames = str | Sequence[str] | None


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
            clear_sheet_cache()
    return assemble(export, card, path, channels, part)


def assemble(
    export: Export,
    card: Card,
    path: object,
    channels: Sequence[ChannelChoice] | None = None,
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
    tables = [_drop_mark_row(_blank_codes(table, card), card) for table in export.tables]
    tables = _choose_part(tables, part, path)
    notes = [*export.notes]
    if len(export.tables) == 1 and tables:
        notes += _compare_counts(export, tables[0], card)
    if card.fallback:
        notes.append(QualityNote.of("readers.dialect_generic", "file"))
    parts = [_convert_table(table, card, path, is_alone=len(tables) == 1) for table in tables]
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
        program=" ".join((card.program, _find_group(card.model, export.head))).strip(),
        program_version=_find_group(card.version, export.head),
        clocks=tuple(its.clock for its in parts),
        channels=tuple(chosen),
        metadata={
            "dialect": card.name,
            **export.about,
            "clocks": {its.clock.name: its.about for its in parts},
        },
        notes=(*notes, *_make_missing_notes(chosen, card), *make_channel_notes(chosen)),
    )


def _find_group(pattern: re.Pattern[str] | None, head: str) -> str:
    match = pattern.search(head) if pattern is not None else None
    return match[1].strip() if match else ""


def _blank_codes(table: Table, card: Card) -> Table:
    """Replace the codes of missing values by NaN."""
    columns = {
        i: np.where(np.isin(values, card.missing), np.nan, values) if card.missing else values
        for i, values in table.columns.items()
    }
    return replace(table, columns=columns)


def _drop_mark_row(table: Table, card: Card) -> Table:
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
    close = ", ".join(f"'{name}'" for name in sort_by_likeness(part, names))
    raise ReadError.about(
        "readers.no_such_part" if close else "readers.no_parts",
        path,
        f"part '{part}'",
        count=len(tables),
        nearest=close,
    )


def _compare_counts(export: Export, table: Table, card: Card) -> list[QualityNote]:
    """Compare the stated numbers of samples and of columns with the actual ones."""
    rows, columns = (
        parse_count(str(export.about.get(key, ""))) if key else None
        for key in (card.stated_rows, card.stated_columns)
    )
    notes, n_columns = compare_row_counts(rows, table.rows), len(table.names)
    if columns not in {None, n_columns}:
        notes.append(
            QualityNote.of("readers.columns_differ", "file", stated=columns, held=n_columns)
        )
    return notes


class _Part(NamedTuple):
    """One table as part of the recording: its clock, what is known of it, channels, notes."""

    clock: Clock
    about: dict[str, object]
    channels: list[Channel]
    notes: list[QualityNote]


def _convert_table(table: Table, card: Card, path: object, *, is_alone: bool) -> _Part:
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
        factor, time = _find_time_factor(unit, table.names[column], path), table.columns[column]
        clock = Clock(name, time if factor == 1.0 else factor * time)
        about |= {"time": table.names[column], "unit_in_file": unit}
        notes += make_clock_notes(clock, is_variable=card.variable_rate)
    if 0 < table.rows < MIN_TEST_ROWS:
        notes.append(QualityNote.of("readers.few_samples", f"clock {name}", rows=table.rows))
    if table.part or table.also:
        about["part"] = table.part or table.also
    return _Part(clock, about, channels, notes)


def _find_time_factor(unit: str, name: str, path: object) -> float:
    for spelling in (unit, unit.casefold()):
        try:
            return find_si_factor(spelling or "none", "s")
        except ValueError:
            continue
    raise ReadError.about(
        "readers.no_unit_of_time" if unit else "readers.time_without_unit",
        path,
        f"column '{name}'",
        unit=unit,
    )


def _make_missing_notes(channels: Sequence[Channel], card: Card) -> list[QualityNote]:
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


def recognise_card(path: Path) -> Card | None:
    """Find the card of an export; a lab's own cards have priority, fallbacks come last.

    Parameters
    ----------
    path : the export

    Returns
    -------
    The card; None if none fits.

    Raises
    ------
    ReadError
        If the file cannot be read, two cards of the same rank fit, or a lab's card is wrong.
    """
    kind = "workbook" if is_workbook(path) else "text"
    fits = _build_sheet_test(path) if kind == "workbook" else _build_text_test(path)
    shipped = shipped_cards().values()
    ranks = (
        lab_cards().values(),
        [card for card in shipped if not card.fallback],
        [card for card in shipped if card.fallback],
    )
    for cards in ranks:
        fitting = [card for card in cards if card.kind == kind and fits(card)]
        if len(fitting) > 1:
            names = " and ".join(card.name for card in fitting)
            raise ReadError.about("readers.several_cards", path, cards=names)
        if fitting:
            return fitting[0]
    return None


def choose_card(path: Path, dialect: CardNames) -> Card:
    """Choose the card for reading an export.

    Parameters
    ----------
    path : the export
    dialect : card or cards that must fit, None for any

    Returns
    -------
    The card. An export that no vendor's card recognises is read with the requested one; its
    structure is checked on reading.

    Raises
    ------
    ReadError
        If there is no such card, or the export fits another one or none.
    """
    cards: Mapping[str, Card] = {**shipped_cards(), **lab_cards()}
    allowed = [dialect] if isinstance(dialect, str) else list(dialect or ())
    for name in allowed:
        if name not in cards:
            close, place = (
                ", ".join(sort_by_likeness(name, list(cards), limit=3)),
                f"dialect '{name}'",
            )
            raise ReadError.about(
                "readers.no_such_card", path, place, count=len(cards), nearest=close
            )
    card = recognise_card(path)
    if card is not None and (not allowed or card.name in allowed):
        return card
    if len(allowed) == 1 and (card is None or card.fallback):
        return cards[allowed[0]]
    dialects = " or ".join(allowed or cards)
    if card is None:
        raise ReadError.about("readers.no_card_fits", path, dialects=dialects)
    raise ReadError.about("readers.other_card_fits", path, dialects=dialects, card=card.name)


def _build_text_test(path: Path) -> Callable[[Card], bool]:
    """Return the test of whether a card fits a text."""
    # Characters searched for the patterns of a card; the longest real header has 3300.
    head_length = 16384
    content = as_content(read_head(path))
    if is_blank(content.data):
        return lambda card: card.blank and bool(content.written_in)
    if is_binary(content):
        return lambda _: False

    @cache
    def text_in(encodings: tuple[str, ...]) -> str:
        try:
            text = decode(content.data, content, encodings, path)
        except ReadError:
            return ""
        return _SEPARATOR_LINE.sub("", text.replace("\r\n", "\n"))[:head_length]

    def fits(card: Card) -> bool:
        text = text_in(card.encodings)
        return card.fits(text) and (
            not card.fallback
            or _is_test_header(partial(find_header, text.split("\n"), card, path), card)
        )

    return fits


def _build_sheet_test(path: Path) -> Callable[[Card], bool]:
    """Return the test of whether a card fits one of the sheets of a workbook."""
    try:
        heads = [format_head(rows) for rows in open_sheets(path).values()]
    except ReadError:
        return lambda _: False

    def fits(card: Card) -> bool:
        fitting = (head for head in heads if card.fits("\n".join(map("\t".join, head))))
        if not card.fallback:
            return any(True for _ in fitting)
        headers = (partial(parse_header_rows, head, card, path, "row 1") for head in fitting)
        return any(_is_test_header(find, card) for find in headers)

    return fits


def _is_test_header(find: Callable[[], Header], card: Card) -> bool:
    """Return whether there is time, and another unit or a name of force or travel."""
    try:
        header = find()
    except ReadError:
        return False
    time = time_column(header.names, header.units, card)
    if time is None:
        return False
    has_units = any(unit for i, unit in enumerate(header.units) if i != time)
    return has_units or card.fits("\t".join(header.names))
