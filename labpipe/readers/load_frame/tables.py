"""Tables of load-frame exports: a single one, specimens side by side, blocks, or sheets."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from labpipe.errors import ReadError
from labpipe.readers.channels import ReportOptions, find_channel, unique_names
from labpipe.readers.load_frame.cards import Card
from labpipe.readers.load_frame.column_titles import (
    Header,
    Rows,
    find_header,
    header_of_rows,
    time_column,
)
from labpipe.readers.number_table import Body, read_columns, sheet_columns
from labpipe.readers.raw_files import (
    HEAD_BYTES,
    Content,
    decode,
    is_blank,
    line_start,
    lines_of,
    unreadable,
)
from labpipe.readers.text_cells import as_text, is_sample, split_line
from labpipe.readers.workbooks import Sheets
from labpipe.records.arrays import Floats
from labpipe.records.quality import QualityNote, Severity

MIN_SAMPLES = 10
"""Fewer samples are not a complete test."""
HEAD_ROWS = 60
"""Rows of a sheet in which names and units are searched."""
_REMEDY = "Export the test again, or name another dialect."
_BLANK_LINE = re.compile(r"\n(?:[ \t\r]*\n)+")
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


def file_note(
    code: str, message: str, severity: Severity = Severity.INFO, where: str = "file"
) -> QualityNote:
    """Return a note on an export."""
    return QualityNote(code, severity, where, message)


def read_text(
    content: Content, card: Card, path: Path, channels: Sequence[ReportOptions] | None = None
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
        message = "only a byte order mark: a step of the test without samples"
        return Export((), notes=(_no_samples(message),), head=head)
    decimal = _decimal_of(head, card, path)
    if card.layout == "blocks":
        text = decode(content.data, content, card.encodings, path)
        return _read_blocks(text, decimal, card, path)
    header = find_header(lines_of(head), card, path)
    data = content.data[line_start(content.data, header.first) :]
    groups = _groups(header) if card.layout == "side by side" else [range(len(header.names))]
    several = len(groups) > 1
    wanted = _wanted_columns(header, card, None if several else channels, path)
    body = _body(data, header, wanted, header.first + 1, decimal)
    columns, notes = read_columns(replace(body, others_numeric=not card.words), path)
    tables = []
    for group, part in zip(groups, _parts(header, groups), strict=True):
        names, units = (tuple(row[i] for i in group) for row in (header.names, header.units))
        titled = (i for i in group if header.names[i] or header.units[i])  # a blank one separates
        chosen = {i - group[0]: columns[i] for i in titled if i in columns}
        tables.append(Table(part, names, units, _without_padding(chosen) if several else chosen))
    about = _preamble(header.above) | _word_values(data, header, card)
    return Export(tuple(tables), about, tuple(notes), head)


def _body(data: bytes, header: Header, columns: list[int], first_line: int, decimal: str) -> Body:
    names = unique_names(header.names)
    return Body(data, names, columns, first_line, header.separator, decimal)


def _word_columns(names: Sequence[str], card: Card) -> list[int]:
    """Return the columns of text according to the card."""
    return [i for i, name in enumerate(names) if name in card.words]


def _wanted_columns(
    header: Header, card: Card, channels: Sequence[ReportOptions] | None, path: object
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
    chosen = {offered[find_channel(wanted, pairs, path)] for wanted in channels}
    always = {i for i, name in enumerate(names) if name in (*card.last_zeros, *card.last_code)}
    return sorted(chosen | always | ({time} if time is not None else set()))


def _no_samples(message: str) -> QualityNote:
    return file_note("no_samples", message, Severity.WARNING)


def _decimal_of(head: str, card: Card, path: Path) -> str:
    """Return the decimal sign of the card, or the one stated in the export."""
    if card.decimal_pattern is None:
        return card.decimal
    match = card.decimal_pattern.search(head)
    if match is not None and match[1] in {".", ","}:
        return match[1]
    expected = "the decimal sign that this program states"
    found = f"'{head[:60].splitlines()[0] if head else ''}'"
    remedy = "Export the test again, or name another dialect."
    raise unreadable(path, "line 1", expected, found, remedy)


def _groups(header: Header) -> list[range]:
    """Return the columns of each specimen, which begins where the row of specimens is filled."""
    width = len(header.names)
    starts = [i for i, cell in enumerate(header.specimens[:width]) if cell]
    repeats = [i for i, name in enumerate(header.names) if name == header.names[0]]
    if not starts or starts[0] != 0 or len(starts) < len(repeats):
        starts = repeats
    return [range(a, b) for a, b in zip(starts, [*starts[1:], width], strict=True)]


def _parts(header: Header, groups: Sequence[range]) -> list[str]:
    """Return the names of the specimens."""
    titles = dict(enumerate(header.specimens))
    names = [titles.get(group[0], "") for group in groups]
    if len(groups) == 1:
        return names
    return unique_names([name or f"specimen {i}" for i, name in enumerate(names, start=1)])


def _without_padding(columns: dict[int, Floats]) -> dict[int, Floats]:
    """Return columns up to the last row that is filled in one of them."""
    filled = np.logical_or.reduce([~np.isnan(values) for values in columns.values()])
    rows = int(np.flatnonzero(filled)[-1]) + 1 if filled.any() else 0
    return {i: values[:rows] for i, values in columns.items()}


def _word_values(data: bytes, header: Header, card: Card) -> dict[str, object]:
    """Return the distinct texts in columns of text."""
    max_texts = 20
    columns = _word_columns(header.names, card)
    texts: dict[str, dict[str, None]] = {header.names[column]: {} for column in columns}
    for line in lines_of(data.decode("utf-8", errors="replace")) if columns else ():
        cells = dict(enumerate(split_line(line, header.separator)))
        for column in columns:
            if column in cells:
                texts[header.names[column]].setdefault(cells[column].strip())
    return {name: list(distinct)[:max_texts] for name, distinct in texts.items()}


def _preamble(rows: Rows) -> dict[str, object]:
    """Return keys and values of rows ``key, value, unit``, or ``key: value`` in one cell.

    A key that occurs several times has a list; rows without a key are under ``lines``. A line
    ``sep=;``, which states the separator to a spreadsheet, is omitted.
    """
    entries: dict[str, list[str]] = {}
    for row in rows:
        cells = [cell.strip() for cell in row if cell.strip()]
        if cells and not _SEPARATOR_CELL.fullmatch(cells[0]):
            key, value = _key_and_value(cells)
            entries.setdefault(key, []).append(value)
    return {
        key: values[0] if len(values) == 1 and key != "lines" else values
        for key, values in entries.items()
    }


def _key_and_value(cells: Sequence[str]) -> tuple[str, str]:
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
    first_line = 1
    for lines, gap in zip(
        *(_BLANK_LINE.split(text), [*_BLANK_LINE.findall(text), ""]), strict=True
    ):
        header = _header_of_block(lines, first_line, card, path) if lines.strip() else None
        if header is None:
            about += [split_line(line, "\t") for line in lines_of(lines)]
        else:
            blanks = header.separator == " "  # parts of one key, not cells
            about += [[" ".join(row)] for row in header.above] if blanks else header.above
            data = (lines + "\n" if gap else lines).encode()
            data, first = data[line_start(data, header.first) :], first_line + header.first
            wanted = _wanted_columns(header, card, None, path)
            body = _body(data, header, wanted, first, decimal)
            columns, its_notes = read_columns(body, path)
            blocks.append(_Block(first, Table("", header.names, header.units, columns)))
            notes += its_notes
        first_line += (lines + gap).count("\n")
    if not blocks:
        expected = "a block of names, units and numbers"
        raise unreadable(path, f"lines 1 to {first_line}", expected, "none", _REMEDY)
    are_summaries = _are_summaries([block.table for block in blocks], card)
    samples = [block for block, left_out in zip(blocks, are_summaries, strict=True) if not left_out]
    summaries = [block for block, left_out in zip(blocks, are_summaries, strict=True) if left_out]
    for line, table in summaries:
        message = f"{table.rows} rows from line {line} have no time: a summary, not samples"
        notes.append(file_note("summary_rows_left_out", message))
    if not samples:
        notes.append(_no_samples("all rows are a summary: the test took no samples"))
    tables, joined_notes = _joined(samples)
    metadata = _preamble(about)
    if summaries:
        metadata["summaries"] = [
            {table.names[i]: values.tolist() for i, values in table.columns.items()}
            for _, table in summaries
        ]
    return Export(tuple(tables), metadata, (*notes, *joined_notes), text[:HEAD_BYTES])


def _header_of_block(block: str, first_line: int, card: Card, path: Path) -> Header | None:
    """Return the header of a block with samples, None for other blocks."""
    head = lines_of(block[:HEAD_BYTES])
    for separator in card.separators:
        rows = [[cell for cell in split_line(line, separator) if cell] for line in head]
        if any(len(row) > 1 and is_sample(row) for row in rows):
            return find_header(head, card, path, first_line)
    return None


def _are_summaries(tables: Sequence[Table], card: Card) -> list[bool]:
    """Return which blocks are summaries: those without time; if none has time, extremes.

    Extremes are two rows, of which the first one is never the smaller one.
    """
    timed = [time_column(table.names, table.units, card) is not None for table in tables]
    if any(timed):
        return [not has_time for has_time in timed]
    return [
        all(len(values) == 2 and values[0] >= values[1] for values in table.columns.values())
        for table in tables
    ]


def _joined(blocks: Sequence[_Block]) -> tuple[list[Table], list[QualityNote]]:
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
            places = ", ".join(str(line) for line, _ in members)
            message = f"{len(members)} blocks of samples (from lines {places} on) are one recording"
            notes.append(file_note("blocks_joined", message))
    return tables, notes


def sheet_head(rows: Sequence[Sequence[object]]) -> list[list[str]]:
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
    heads = {name: sheet_head(rows) for name, rows in sheets.items()}
    for name, head in heads.items():
        try:
            header = _header_of_sheet(head, name, card, path)
        except ReadError as fault:
            faults.append(fault)
            continue
        tables[name] = _table_of_sheet(sheets[name], header, name, card, path)
        about |= _preamble(header.above)
    if not tables:
        found = f"{len(faults)} sheets without"
        general = unreadable(path, "", "a sheet with names, units and numbers", found, _REMEDY)
        specific = (fault for fault in faults if "numbers below it" not in str(fault))
        raise next(specific, general)
    results = _sheets_of_results(tables, card)
    left_out = [name for name in sheets if name not in tables or name in results]
    notes = []
    if left_out:
        rows_of = {
            name: [row for row in heads[name][:max_shown_rows] if any(row)] for name in left_out
        }
        about["sheets"] = rows_of
        names = ", ".join(f"'{name}'" for name in left_out)
        message = f"{len(left_out)} sheets without samples were omitted: {names}"
        notes.append(file_note("sheets_left_out", message))
    text = "\n".join("\t".join(row) for head in heads.values() for row in head)
    kept = tuple(table for name, table in tables.items() if name not in results)
    return Export(kept, about, tuple(notes), text)


def _header_of_sheet(head: Rows, sheet: str, card: Card, path: Path) -> Header:
    header = header_of_rows(head, card, path, f"sheet '{sheet}', row 1")
    if card.layout != "specimen above" or len({cell for cell in header.specimens if cell}) == 1:
        return header
    if time_column(header.names, header.units, card) is not None:
        return replace(header, specimens=())  # the row was edited; the sheet has a name as well
    place = f"sheet '{sheet}', row {max(header.first - 2, 1)}"
    raise unreadable(path, place, "the specimen above the row of names", "none", _REMEDY)


def _table_of_sheet(
    rows: Sequence[Sequence[object]], header: Header, sheet: str, card: Card, path: Path
) -> Table:
    names = dict(enumerate(unique_names(header.names)))
    wanted = {i: names[i] for i in _wanted_columns(header, card, None, path)}
    columns, notes = sheet_columns(rows, header.first, wanted, (path, f"sheet '{sheet}'"))
    specimen = next((cell for cell in header.specimens if cell), "")
    return Table(specimen or sheet, header.names, header.units, columns, sheet, tuple(notes))


def _sheets_of_results(tables: Mapping[str, Table], card: Card) -> set[str]:
    """Find sheets of results among sheets of samples: other columns, and no time or few rows."""
    longest = max(tables.values(), key=lambda table: table.rows)
    has_time = {
        name: time_column(table.names, table.units, card) is not None
        for name, table in tables.items()
    }
    return {
        name
        for name, table in tables.items()
        if table.names != longest.names
        and (table.rows < MIN_SAMPLES or (any(has_time.values()) and not has_time[name]))
    }
