"""Tables of load-frame exports: a single one, specimens side by side, blocks, or sheets."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from labpipe.errors import ReadError
from labpipe.readers.channels import ChannelChoice, find_channel, unique_names
from labpipe.readers.load_frame.cards import Card
from labpipe.readers.load_frame.column_titles import Header, Rows, find_header, time_column
from labpipe.readers.number_table import Body, count_filled_rows, read_columns
from labpipe.readers.raw_files import HEAD_BYTES, Content, decode, is_blank, skip_lines, split_lines
from labpipe.readers.text_cells import DECIMAL_SIGNS, is_sample, split_line
from labpipe.readers.workbooks import Sheets, format_head, format_rows
from labpipe.records.arrays import Floats
from labpipe.records.quality import QualityNote

MIN_TEST_ROWS = 10
"""Fewer samples are not a complete test."""
_BLANK_LINES = re.compile(r"(?<=\n)((?:[ \t\r]*\n)+)")
_SEPARATOR_CELL = re.compile(r"sep=.?")
Channels = Sequence[ChannelChoice] | None


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
    line : of the first row
    """

    part: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    columns: Mapping[int, Floats]
    also: str = ""
    notes: tuple[QualityNote, ...] = ()
    line: int = 1

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


def read_text(content: Content, card: Card, path: Path, channels: Channels = None) -> Export:
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
    decimal: str = card.decimal
    if card.decimal_pattern is not None:
        match = card.decimal_pattern.search(head)
        if match is None or match[1] not in DECIMAL_SIGNS:
            line = head[:60].splitlines()[0]
            raise ReadError.about("readers.no_decimal_sign", path, "line 1", line=line)
        decimal = match[1]
    if card.layout == "blocks":
        text = decode(content.data, content, card.encodings, path)
        return _read_blocks(text, decimal, card, path)
    header = find_header(split_lines(head), card, path)
    specimens = _find_specimens(header, card)
    wanted = _wanted_columns(header, card, channels if len(specimens) == 1 else None, path)
    body = _build_body(content.data, header, card, wanted, decimal)
    columns, notes = read_columns(body, path)
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
    data: bytes, header: Header, card: Card, columns: Sequence[int], decimal: str
) -> Body:
    names = unique_names(header.names)
    return Body(
        skip_lines(data, header.first),
        [*names, *[""] * (header.width - len(names))],
        columns,
        header.first_line + header.first,
        header.separator,
        decimal,
        others_numeric=not card.words,
        sheet=header.sheet,
    )


def _wanted_columns(header: Header, card: Card, channels: Channels, path: object) -> list[int]:
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


def _read_blocks(text: str, decimal: str, card: Card, path: Path) -> Export:
    """Read blocks separated by blank lines.

    Blocks of samples with the same columns are one table; the other blocks and the summaries are
    metadata. If there are only summaries, there is no table, and the note ``no_samples``.
    """
    blocks, notes, line = list[Table](), list[QualityNote](), 1
    rows = list[Sequence[str]]()
    for block in _BLANK_LINES.split(text):
        lines = split_lines(block[:HEAD_BYTES])
        if any(_holds_samples(lines, separator) for separator in card.separators):
            header = find_header(lines, card, path, line)
            blanks = header.separator == " "  # parts of one key, not cells
            rows += [[" ".join(row)] for row in header.above] if blanks else header.above
            wanted = _wanted_columns(header, card, None, path)
            body = _build_body(block.encode(), header, card, wanted, decimal)
            columns, block_notes = read_columns(body, path)
            notes += block_notes
            blocks.append(Table("", header.names, header.units, columns, line=body.first_line))
        else:
            rows += [split_line(row, "\t") for row in split_lines(block)]
        line += block.count("\n")
    if not blocks:
        raise ReadError.about("readers.no_blocks", path, f"lines 1 to {line}")
    summaries = _find_summaries(blocks, card)
    samples = [block for block in blocks if block not in summaries]  # compared by identity
    notes += [
        QualityNote.of("readers.summary_blocks", "file", rows=table.rows, line=table.line)
        for table in summaries
    ]
    if not samples:
        notes.append(QualityNote.of("readers.no_samples", "file"))
    tables, joined_notes = _join_blocks(samples)
    metadata = _parse_preamble(rows)
    if summaries:
        metadata["summaries"] = [
            {table.names[i]: values.tolist() for i, values in table.columns.items()}
            for table in summaries
        ]
    return Export(tuple(tables), metadata, (*notes, *joined_notes), text[:HEAD_BYTES])


def _join_blocks(blocks: Sequence[Table]) -> tuple[list[Table], list[QualityNote]]:
    """Join blocks with the same columns; other blocks become separate parts."""
    groups: dict[object, list[Table]] = {}
    for block in blocks:
        groups.setdefault((block.names, block.units), []).append(block)
    tables, notes = [], []
    for number, members in enumerate(groups.values(), start=1):
        joined = {i: np.concatenate([x.columns[i] for x in members]) for i in members[0].columns}
        part = f"block {number}" if len(groups) > 1 else ""
        tables.append(replace(members[0], part=part, columns=joined))
        if (count := len(members)) > 1:
            lines = ", ".join(str(table.line) for table in members)
            notes.append(QualityNote.of("readers.blocks_joined", "file", count=count, lines=lines))
    return tables, notes


def _holds_samples(lines: Sequence[str], separator: str) -> bool:
    rows = ([cell for cell in split_line(line, separator) if cell] for line in lines)
    return any(len(row) > 1 and is_sample(row) for row in rows)


def _find_summaries(blocks: Sequence[Table], card: Card) -> list[Table]:
    """Find summaries: blocks without time; if none has time, extremes.

    Extremes are two rows, of which the first one is never the smaller one.
    """
    without_time = [block for block in blocks if not _has_time(block, card)]
    if len(without_time) < len(blocks):
        return without_time
    return [
        block
        for block in blocks
        if all(len(column) == 2 and column[0] >= column[1] for column in block.columns.values())
    ]


def _has_time(table: Table, card: Card) -> bool:
    return time_column(table.names, table.units, card) is not None


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
    tables, faults, about = dict[str, Table](), list[ReadError](), dict[str, object]()
    heads = {name: split_lines(format_head(rows)) for name, rows in sheets.items()}
    for name, lines in heads.items():
        try:
            header = _find_sheet_header(lines, name, card, path)
        except ReadError as fault:
            faults.append(fault)
            continue
        data, wanted = format_rows(sheets[name]).encode(), _wanted_columns(header, card, None, path)
        columns, notes = read_columns(_build_body(data, header, card, wanted, "."), path)
        specimen = next((cell for cell in header.specimens if cell), name)
        tables[name] = Table(specimen, header.names, header.units, columns, name, tuple(notes))
        about |= _parse_preamble(header.above)
    if not tables:
        general = ReadError.about("readers.no_sheets", path, count=len(faults))
        raise next((fault for fault in faults if "numbers below it" not in str(fault)), general)
    left_out = [name for name in sheets if name not in tables or _holds_results(name, tables, card)]
    notes = []
    if left_out:
        rows = {name: [split_line(line, "\t") for line in heads[name]] for name in left_out}
        about["sheets"] = {
            name: [x for x in rows[name][:max_shown_rows] if any(x)] for name in rows
        }
        names, count = ", ".join(f"'{name}'" for name in left_out), len(left_out)
        notes.append(QualityNote.of("readers.sheets_left_out", "file", count=count, names=names))
    kept = tuple(table for name, table in tables.items() if name not in left_out)
    return Export(
        kept, about, tuple(notes), "\n".join(x for lines in heads.values() for x in lines)
    )


def _find_sheet_header(lines: Sequence[str], sheet: str, card: Card, path: Path) -> Header:
    header = find_header(lines, card, path, sheet=sheet)
    if card.layout != "specimen above" or len({cell for cell in header.specimens if cell}) == 1:
        return header
    if time_column(header.names, header.units, card) is not None:
        return replace(header, specimens=())  # the row was edited; the sheet has a name as well
    place = f"sheet '{sheet}', row {max(header.first - 2, 1)}"
    raise ReadError.about("readers.no_specimen_above", path, place)


def _holds_results(name: str, tables: Mapping[str, Table], card: Card) -> bool:
    """Return whether a sheet holds results: other columns than the longest, no time or few rows."""
    table, longest = tables[name], max(tables.values(), key=lambda table: table.rows)
    any_time = any(_has_time(other, card) for other in tables.values())
    is_odd = table.rows < MIN_TEST_ROWS or (any_time and not _has_time(table, card))
    return table.names != longest.names and is_odd
