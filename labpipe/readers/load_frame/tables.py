"""Tables of load-frame exports: a single one, specimens side by side, blocks, or sheets."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from labpipe.errors import ReadError
from labpipe.readers.channels import ChannelChoice, find_channel, unique_names
from labpipe.readers.load_frame.cards import Card
from labpipe.readers.load_frame.column_titles import (
    Header,
    Rows,
    find_header,
    parse_header_rows,
    time_column,
)
from labpipe.readers.number_table import Body, count_filled_rows, read_columns, read_sheet_columns
from labpipe.readers.raw_files import HEAD_BYTES, Content, decode, is_blank, skip_lines, split_lines
from labpipe.readers.text_cells import as_text, is_sample, split_line
from labpipe.readers.workbooks import Sheets
from labpipe.records.arrays import Floats
from labpipe.records.quality import QualityNote

MIN_TEST_ROWS = 10
"""Fewer samples are not a complete test."""
HEAD_ROWS = 60
"""Rows of a sheet in which names and units are searched."""
_BLANK_LINES = re.compile(r"(?<=\n)((?:[ \t\r]*\n)+)")
_SEPARATOR_CELL = re.compile(r"sep=.?")


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

    @property
    def rows(self) -> int:
        """Return the number of rows."""
        return max(map(len, self.columns.values()), default=0)


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


def read_text(
    content: Content, card: Card, path: Path, channels: Sequence[ChannelChoice] | None = None
) -> Export:
    """Read all tables of a text export.

    Parameters
    ----------
    content : its bytes
    card : rules for names and units
    path : named in errors
    channels : wanted ones, None for all

    Returns
    -------
    The tables; none if there is only a byte order mark.

    Raises
    ------
    ReadError
        If names, units or numbers are not where the card states, or a wanted channel does not
        exist.
    """
    head = decode(content.data[:HEAD_BYTES], content, card.encodings, path)
    if is_blank(content.data):
        return Export((), notes=(QualityNote.of("readers.blank_export", "file"),), head=head)
    decimal = _find_decimal_sign(head, card, path)
    if card.layout == "blocks":
        text = decode(content.data, content, card.encodings, path)
        return _read_blocks(text, decimal, card, path)
    header = find_header(split_lines(head), card, path)
    specimens = _find_specimens(header, card)
    wanted_columns = _wanted_columns(header, card, channels if len(specimens) == 1 else None, path)
    body = _build_body(
        skip_lines(content.data, header.first), header, wanted_columns, header.first + 1, decimal
    )
    columns, notes = read_columns(replace(body, others_numeric=not card.words), path)
    tables = []
    for part, group in specimens:
        names, units = (tuple(row[i] for i in group) for row in (header.names, header.units))
        titled = (i for i in group if header.names[i] or header.units[i])  # a blank one separates
        chosen = {i - group[0]: columns[i] for i in titled if i in columns}
        rows = count_filled_rows(chosen)  # a shorter specimen is padded
        tables.append(Table(part, names, units, {i: chosen[i][:rows] for i in chosen}))
    about = _parse_preamble(header.above) | _list_texts(body, header, card)
    return Export(tuple(tables), about, tuple(notes), head)


def _build_body(
    data: bytes, header: Header, columns: list[int], first_line: int, decimal: str
) -> Body:
    names = unique_names(header.names)
    return Body(data, names, columns, first_line, header.separator, decimal)


def _wanted_columns(
    header: Header, card: Card, channels: Sequence[ChannelChoice] | None, path: object
) -> list[int]:
    """Return the columns of the wanted channels, of time, and of marks, ascending."""
    names = header.names
    time = time_column(names, header.units, card)
    numbers = [i for i in range(len(names)) if names[i] not in card.words]
    if channels is None:
        return numbers
    paths = unique_names(names)
    offered = [i for i in numbers if i != time]
    pairs = [(names[i], paths[i]) for i in offered]
    chosen = {offered[find_channel(channel, pairs, path)] for channel in channels}
    always = {i for i, name in enumerate(names) if name in (*card.last_zeros, *card.last_code)}
    return sorted(chosen | always | ({time} if time is not None else set()))


def _find_decimal_sign(head: str, card: Card, path: Path) -> str:
    """Return the decimal sign of the card, or the one stated in the export."""
    if card.decimal_pattern is None:
        return card.decimal
    match = card.decimal_pattern.search(head)
    if match is not None and match[1] in {".", ","}:
        return match[1]
    raise ReadError.about("readers.no_decimal_sign", path, "line 1", line=head[:60].splitlines()[0])


def _find_specimens(header: Header, card: Card) -> list[tuple[str, range]]:
    """Return names and columns of the specimens; each begins where the row of them is filled."""
    width = len(header.names)
    if card.layout != "side by side":
        return [("", range(width))]
    titles = dict(enumerate(header.specimens))
    starts = [i for i in range(width) if titles.get(i)]
    repeats = [i for i, name in enumerate(header.names) if name == header.names[0]]
    if starts[:1] != [0] or len(starts) < len(repeats):
        starts = repeats
    names = [titles.get(start, "") for start in starts]
    if len(starts) > 1:
        names = unique_names([name or f"specimen {i}" for i, name in enumerate(names, start=1)])
    return list(zip(names, map(range, starts, [*starts[1:], width]), strict=True))


def _list_texts(body: Body, header: Header, card: Card) -> dict[str, object]:
    """Return the distinct texts in columns of text according to the card."""
    max_texts = 20
    columns = {i: name for i, name in enumerate(header.names) if name in card.words}
    texts: dict[str, dict[str, None]] = {name: {} for name in columns.values()}
    for row in body.rows() if columns else ():
        for i, name in columns.items():
            if i < len(row):
                texts[name].setdefault(row[i].strip())
    return {name: list(distinct)[:max_texts] for name, distinct in texts.items()}


def _parse_preamble(rows: Rows) -> dict[str, object]:
    """Return keys and values of rows ``key, value, unit``, or ``key: value`` in one cell.

    A key that occurs several times has a list; rows without a key are under ``lines``. A line
    ``sep=;``, which states the separator to a spreadsheet, is omitted.
    """
    entries: dict[str, list[str]] = {}
    for row in rows:
        cells = [cell.strip() for cell in row if cell.strip()]
        if cells and not _SEPARATOR_CELL.fullmatch(cells[0]):
            key, value = _parse_key_and_value(cells)
            entries.setdefault(key, []).append(value)
    return {
        key: values[0] if len(values) == 1 and key != "lines" else values
        for key, values in entries.items()
    }


def _parse_key_and_value(cells: Sequence[str]) -> tuple[str, str]:
    if len(cells) > 1:
        return cells[0].rstrip(" :"), " ".join(cells[1:])
    key, colon, value = cells[0].partition(": ")
    if colon and 0 < len(key) < 60:
        return key.strip(), value.strip()
    return ("lines", cells[0]) if not cells[0].endswith(":") else (cells[0].rstrip(" :"), "")


class _Block(NamedTuple):
    """A block of samples and the line of its first one."""

    line: int
    table: Table


def _read_blocks(text: str, decimal: str, card: Card, path: Path) -> Export:
    """Read blocks separated by blank lines.

    Blocks of samples with the same columns are one table; the other blocks and the summaries are
    metadata. If there are only summaries, there is no table, and the note ``no_samples``.
    """
    blocks: list[_Block] = []
    notes: list[QualityNote] = []
    about: list[Sequence[str]] = []
    line = 1
    for block in _BLANK_LINES.split(text):
        header = _find_block_header(block, line, card, path) if block.strip() else None
        if header is None:
            about += [split_line(row, "\t") for row in split_lines(block)]
        else:
            blanks = header.separator == " "  # parts of one key, not cells
            about += [[" ".join(row)] for row in header.above] if blanks else header.above
            data, first = skip_lines(block.encode(), header.first), line + header.first
            wanted_columns = _wanted_columns(header, card, None, path)
            columns, its_notes = read_columns(
                _build_body(data, header, wanted_columns, first, decimal), path
            )
            blocks.append(_Block(first, Table("", header.names, header.units, columns)))
            notes += its_notes
        line += block.count("\n")
    if not blocks:
        raise ReadError.about("readers.no_blocks", path, f"lines 1 to {line}")
    samples, summaries = _separate_summaries(blocks, card)
    notes += [
        QualityNote.of("readers.summary_blocks", "file", rows=table.rows, line=first)
        for first, table in summaries
    ]
    if not samples:
        notes.append(QualityNote.of("readers.no_samples", "file"))
    tables, joined_notes = _join_blocks(samples)
    metadata = _parse_preamble(about)
    if summaries:
        metadata["summaries"] = [
            {table.names[i]: values.tolist() for i, values in table.columns.items()}
            for _, table in summaries
        ]
    return Export(tuple(tables), metadata, (*notes, *joined_notes), text[:HEAD_BYTES])


def _find_block_header(block: str, first_line: int, card: Card, path: Path) -> Header | None:
    """Return the header of a block with samples, None for other blocks."""
    head = split_lines(block[:HEAD_BYTES])
    for separator in card.separators:
        rows = [[cell for cell in split_line(line, separator) if cell] for line in head]
        if any(len(row) > 1 and is_sample(row) for row in rows):
            return find_header(head, card, path, first_line)
    return None


def _separate_summaries(blocks: Sequence[_Block], card: Card) -> tuple[list[_Block], list[_Block]]:
    """Separate summaries from samples: blocks without time; if none has time, extremes.

    Extremes are two rows, of which the first one is never the smaller one.
    """
    timed = [_has_time(block.table, card) for block in blocks]
    if not any(timed):
        columns = [block.table.columns.values() for block in blocks]
        timed = [any(len(c) != 2 or not c[0] >= c[1] for c in group) for group in columns]
    of_time = list(zip(blocks, timed, strict=True))
    return [block for block, yes in of_time if yes], [block for block, yes in of_time if not yes]


def _has_time(table: Table, card: Card) -> bool:
    return time_column(table.names, table.units, card) is not None


def _join_blocks(blocks: Sequence[_Block]) -> tuple[list[Table], list[QualityNote]]:
    """Join blocks with the same columns; other blocks become separate parts."""
    groups: dict[object, list[_Block]] = {}
    for block in blocks:
        groups.setdefault((block.table.names, block.table.units), []).append(block)
    tables, notes = [], []
    for number, members in enumerate(groups.values(), start=1):
        first = members[0].table
        columns = {
            i: np.concatenate([table.columns[i] for _, table in members]) for i in first.columns
        }
        part = f"block {number}" if len(groups) > 1 else ""
        tables.append(replace(first, part=part, columns=columns))
        if len(members) > 1:
            lines = ", ".join(str(line) for line, _ in members)
            count = len(members)
            notes.append(QualityNote.of("readers.blocks_joined", "file", count=count, lines=lines))
    return tables, notes


def format_head(rows: Sequence[Sequence[object]]) -> list[list[str]]:
    """Return the first rows of a sheet as text."""
    return [[as_text(cell) for cell in row] for row in rows[:HEAD_ROWS]]


def read_sheets(sheets: Sheets, card: Card, path: Path) -> Export:
    """Read all sheets of a workbook with samples.

    Parameters
    ----------
    sheets : from `labpipe.readers.workbooks.open_sheets`
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
    max_shown_rows = 50
    tables: dict[str, Table] = {}
    faults: list[ReadError] = []
    about: dict[str, object] = {}
    heads = {name: format_head(rows) for name, rows in sheets.items()}
    for name, head in heads.items():
        try:
            header = _find_sheet_header(head, name, card, path)
        except ReadError as fault:
            faults.append(fault)
            continue
        tables[name] = _read_sheet_table(sheets[name], header, name, card, path)
        about |= _parse_preamble(header.above)
    if not tables:
        general = ReadError.about("readers.no_sheets", path, count=len(faults))
        raise next((fault for fault in faults if "numbers below it" not in str(fault)), general)
    left_out = [name for name in sheets if name not in tables or _holds_results(name, tables, card)]
    notes = []
    if left_out:
        about["sheets"] = {
            name: [row for row in heads[name][:max_shown_rows] if any(row)] for name in left_out
        }
        names, count = ", ".join(f"'{name}'" for name in left_out), len(left_out)
        notes.append(QualityNote.of("readers.sheets_left_out", "file", count=count, names=names))
    text = "\n".join("\t".join(row) for head in heads.values() for row in head)
    kept = tuple(table for name, table in tables.items() if name not in left_out)
    return Export(kept, about, tuple(notes), text)


def _find_sheet_header(head: Rows, sheet: str, card: Card, path: Path) -> Header:
    header = parse_header_rows(head, card, path, f"sheet '{sheet}', row 1")
    if card.layout != "specimen above" or len({cell for cell in header.specimens if cell}) == 1:
        return header
    if time_column(header.names, header.units, card) is not None:
        return replace(header, specimens=())  # the row was edited; the sheet has a name as well
    place = f"sheet '{sheet}', row {max(header.first - 2, 1)}"
    raise ReadError.about("readers.no_specimen_above", path, place)


def _read_sheet_table(
    rows: Sequence[Sequence[object]], header: Header, sheet: str, card: Card, path: Path
) -> Table:
    names = unique_names(header.names)
    wanted_columns = {i: names[i] for i in _wanted_columns(header, card, None, path)}
    columns, notes = read_sheet_columns(
        rows, header.first, wanted_columns, (path, f"sheet '{sheet}'")
    )
    specimen = next((cell for cell in header.specimens if cell), "")
    return Table(specimen or sheet, header.names, header.units, columns, sheet, tuple(notes))


def _holds_results(name: str, tables: Mapping[str, Table], card: Card) -> bool:
    """Return whether a sheet holds results: other columns than the longest, no time or few rows."""
    table, longest = tables[name], max(tables.values(), key=lambda table: table.rows)
    any_time = any(_has_time(other, card) for other in tables.values())
    is_odd = table.rows < MIN_TEST_ROWS or (any_time and not _has_time(table, card))
    return table.names != longest.names and is_odd
