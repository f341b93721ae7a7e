"""Read the tables of load-frame exports, whether side by side, in blocks or on sheets.

The `Card` of a dialect describes the names, the units and the arrangement of an export.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from labpipe.readers.channels import (
    ChannelChoice,
    find_alternatives,
    find_channel,
    make_names_unique,
    normalise_name,
)
from labpipe.readers.load_frame.cards import Card
from labpipe.readers.number_table import (
    DECIMAL_SIGNS,
    Body,
    are_units,
    count_filled_rows,
    has_dimension_of,
    is_number,
    is_unit,
    quote_cells,
    read_columns,
    split_head,
    split_line,
    split_name_and_unit,
    strip_brackets,
)
from labpipe.readers.raw_files import (
    HEAD_BYTES,
    Content,
    ContentError,
    decode,
    is_blank,
    split_lines,
)
from labpipe.readers.workbooks import Sheets, format_head, format_rows
from labpipe.records.arrays import Floats
from labpipe.records.quality import QualityNote

_TIME_WORD = re.compile(r"(?i)time|zeit|temps|tempo|tiempo|czas|tijd|时间|時間")
"""Pattern of a word for time in the name of a column."""
Rows = Sequence[Sequence[str]]
"""Cells of each row."""
_Cells = tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Header:
    """Contents of the rows above the samples of a table.

    Parameters
    ----------
    names : names of the columns, without surrounding blanks
    units : units of the columns, without brackets; empty if not stated
    first_row : index of the first row of samples, counted from the first line of the head
    preamble : cells of each row above the names and the specimens
    separator : character between cells
    specimens : names of specimens in the cells of the row above the names; empty without such a row
    first_line : number of the first line of the head in the file, counted from 1
    sheet_label : sheet in messages, such as ``sheet 'a'``; empty for a text
    """

    names: _Cells
    units: _Cells
    first_row: int
    preamble: Rows
    separator: str = ""
    specimens: _Cells = ()
    first_line: int = 1
    sheet_label: str = ""


def find_header(
    lines: Sequence[str], card: Card, first_line: int = 1, *, sheet: str = ""
) -> Header:
    """Find the names and the units of columns in the head of a text or a sheet.

    Parameters
    ----------
    lines : lines of the head, without line ends; tabs separate the cells of a sheet
    card : card that describes the header
    first_line : number of the first line of the head in the file, counted from 1
    sheet : name of the sheet; empty for a text

    Returns
    -------
    The header, without blank rows. Its separator is the first one of the card with which a row of
    numbers is found. If `Card.names` is "alone", the row of names is found instead.

    Raises
    ------
    ContentError
        If there is no row of names, no required row of units, or no numbers.
    """
    max_head_lines = 400  # the longest known header has 56 lines
    head = lines[:max_head_lines]
    if card.names == "listed":
        return _parse_listed_names(head, card)
    separators = ("\t",) if sheet else card.separators
    if card.names == "alone":
        titles = card.header_words
        split_rows = split_head(
            head, separators, lambda row: tuple(map(str.strip, row[: len(titles)])) == titles
        )
    else:
        split_rows = split_head(head, separators)
    if split_rows is None:
        last_line = first_line + len(head) - 1
        place = f"sheet '{sheet}', row 1" if sheet else f"lines {first_line} to {last_line}"
        raise ContentError.of("readers.no_table", place)
    separator, rows = split_rows
    if card.names == "alone":
        rows.append([])  # the last row is that of the names, so add one for the first sample
    first_row = len(rows) - 1
    filled_rows = [i for i, row in enumerate(rows[:first_row]) if any(cell.strip() for cell in row)]
    cells = [tuple(map(str.strip, rows[i])) for i in filled_rows]
    header_rows = [row[: 1 + max(i for i, cell in enumerate(row) if cell)] for row in cells]
    sheet_label = f"sheet '{sheet}'" if sheet else ""

    def describe_row_above(n: int) -> str:
        """Describe the place of the n-th filled row above the samples, for a message."""
        row = filled_rows[max(len(filled_rows) - n, 0)] if filled_rows else 0
        return f"{sheet_label}, row {first_line + row}" if sheet else f"line {first_line + row}"

    if separator == " " and card.name_starts is not None and len(header_rows) > 1:
        text, n_columns = " ".join(rows[filled_rows[-2]]), len(rows[-1])
        # A name may contain blanks, and begins where the pattern of the card matches.
        starts = [match.start() for match in card.name_starts.finditer(text)]
        bounds = [0, *filter(None, starts), len(text)]
        header_rows[-2] = tuple(text[start:stop].strip() for start, stop in pairwise(bounds))
        if (n_names := len(header_rows[-2])) != n_columns:
            facts = {"wanted": n_columns, "count": n_names, "text": quote_cells([text])}
            raise ContentError.of("readers.names_with_blanks", describe_row_above(2), **facts)
    last_rows = [(), (), *header_rows][-2:]  # rows that do not exist are empty
    names, units, n_rows = _find_names(last_rows, card, describe_row_above(1))
    preamble = header_rows[:-n_rows]
    has_specimens = card.names == "above units" and card.layout in _SPECIMEN_LAYOUTS
    return Header(
        names=names,
        units=units,
        first_row=first_row,
        specimens=preamble.pop() if preamble and has_specimens else (),
        preamble=preamble,
        separator=separator,
        first_line=first_line,
        sheet_label=sheet_label,
    )


def _parse_listed_names(lines: Sequence[str], card: Card) -> Header:
    """Parse a header that lists one name per line and ends with the start line of the card."""
    assert card.listed is not None  # a card of listed names without these patterns is refused
    assert card.start is not None
    start = next((i for i, line in enumerate(lines) if card.start.search(line)), None)
    if start is None:
        pattern = card.start.pattern
        raise ContentError.of("readers.no_start_line", pattern=pattern, lines=len(lines))
    cells = [match[1].strip() for line in lines[:start] if (match := card.listed.search(line))]
    if not cells:
        pattern = card.listed.pattern
        raise ContentError.of("readers.no_listed_names", f"lines 1 to {start}", pattern=pattern)
    preamble = [split_line(line, "\t") for line in lines[:start]]
    names, units = zip(*(split_name_and_unit(cell) or (cell, "") for cell in cells), strict=True)
    separator = card.separators[0]
    return Header(names, units, first_row=start + 1, preamble=preamble, separator=separator)


def _find_names(rows: Sequence[_Cells], card: Card, place: str) -> tuple[_Cells, _Cells, int]:
    """Find the names and the units of the columns in the last two rows above the samples.

    The units are in the row below the names, in the cells of the names, or not stated.

    Returns
    -------
    names, units : names and units of the columns
    n_rows : number of rows that contain them
    """
    row_above, last_row = rows
    if card.names == "alone":
        return last_row, tuple(card.units.get(name, "") for name in last_row), 1
    width = max(map(len, rows))
    names, unit_cells = (row + ("",) * (width - len(row)) for row in rows)
    # The unit cell of a counter may repeat the name above it.
    units = tuple("" if x == name else x for name, x in zip(names, unit_cells, strict=True))
    pairs = [split_name_and_unit(cell, card.brackets) for cell in last_row]
    has_numbers = any(map(is_number, last_row))
    has_names_with_units = card.names != "above units" and any(pair and pair[0] for pair in pairs)
    is_unit_row = not has_numbers and not has_names_with_units and _are_units(units, card)
    if is_unit_row and _are_names(names, unit_cells):
        return names, tuple(map(strip_brackets, units)), 2
    has_names = any(last_row) if card.names == "any" else any(pairs)
    if card.names == "above units" or has_numbers or not has_names:
        wanted = _HEADER_TEXTS[card.names].format(f" in {card.brackets}" if card.brackets else "")
        texts = " below ".join(map(quote_cells, filter(any, (last_row, row_above)))) or "nothing"
        raise ContentError.of("readers.no_titles", place, wanted=wanted, rows=texts)
    pairs = [pair or (cell, "") for pair, cell in zip(pairs, last_row, strict=True)]
    names, units = zip(*filter(None, pairs), strict=True)
    return names, units, 1


def _are_units(cells: _Cells, card: Card) -> bool:
    """Return whether cells are units, either in the brackets of the card, or known ones."""
    if card.names == "any":
        return are_units(cells)
    filled_cells = [cell for cell in cells if cell]
    if not card.brackets:
        return any(map(is_unit, filled_cells))
    return bool(filled_cells) and all(x[0] + x[-1] == card.brackets for x in filled_cells)


def _are_names(names: _Cells, units: _Cells) -> bool:
    """Return whether units have names, names are not all equal, and the first is not a number."""
    has_unnamed_unit = any(unit and not name for name, unit in zip(names, units, strict=True))
    filled_names = [name for name in names if name]
    are_equal = len(set(filled_names)) == 1 < len(filled_names)
    return not (has_unnamed_unit or are_equal or any(map(is_number, names[:1])))


def find_time_column(names: Sequence[str], units: Sequence[str], card: Card) -> int | None:
    """Find the column of time among columns of numbers.

    Parameters
    ----------
    names, units : names and units of the columns
    card : card with patterns of the name of the column of time, in order of preference

    Returns
    -------
    Index of the column; None if it is not found.

    Notes
    -----
    The patterns are tried in their order on all names as written, and then on all names without the
    prefix of a channel number or an underscore (``_Time``). The first column whose whole name
    matches is chosen. If no name matches, the column is the only one that has a unit of time and a
    word for time in its name. Columns of text are ignored.
    """
    names = ["" if name in card.words else name for name in names]
    for spellings in (names, [normalise_name(name) for name in names]):
        for pattern in card.time:
            for i, name in enumerate(spellings):
                if pattern.fullmatch(name):
                    return i
    candidates = [
        i
        for i, (name, unit) in enumerate(zip(names, units, strict=False))
        if _TIME_WORD.search(name) and has_dimension_of(unit, "s")
    ]
    return candidates[0] if len(candidates) == 1 else None


MIN_TEST_ROWS = 10
"""Smallest number of samples of a complete test."""
_BLANK_LINES = re.compile(r"(?<=\n)((?:[ \t\r]*\n)+)")
_SEPARATOR_CELL = re.compile(r"sep=.?")
"""Pattern of a line ``sep=;``, which tells a spreadsheet the separator."""
_SPECIMEN_LAYOUTS = ("side by side", "specimen above")
_HEADER_TEXTS = {
    "above units": "a row of names, then a row of units{}, above the numbers",
    "with units": "names with their units{} above the numbers",
    "any": "a row of names above the numbers",
}
"""Rows that a card requires above the numbers, for messages, keyed by `Card.names`."""
ChannelChoices = Sequence[ChannelChoice] | None
"""Names or paths of the channels to read; None for all."""


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """Numeric columns with a common time base.

    Parameters
    ----------
    part : name of the specimen, sheet or block; empty if the export has only one
    names, units : names and units of all columns
    columns : values of the columns that were read, each of shape (n_rows,) in the unit of its
        column, keyed by index of the column
    sheet_name : name of the sheet if `part` may be the specimen on it, otherwise empty
    notes : quality notes on the rows
    first_line : number of the line of the first row in the file, counted from 1
    """

    part: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    columns: Mapping[int, Floats]
    sheet_name: str = ""
    notes: tuple[QualityNote, ...] = ()
    first_line: int = 1

    @property
    def n_rows(self) -> int:
        """Number of rows."""
        return max(map(len, self.columns.values()), default=0)


@dataclass(frozen=True, slots=True, eq=False)
class Export:
    """All tables of one export.

    Parameters
    ----------
    tables : tables in the order of the file
    properties : properties of the export, keyed as in its preamble
    notes : quality notes on the export as a whole
    head : beginning of the export as text, for the patterns of the card
    """

    tables: tuple[Table, ...]
    properties: Mapping[str, object] = field(default_factory=dict)
    notes: tuple[QualityNote, ...] = ()
    head: str = ""


def read_text(content: Content, card: Card, path: Path, channels: ChannelChoices = None) -> Export:
    """Read all tables of a text export.

    Parameters
    ----------
    content : bytes of the export
    card : card that describes the arrangement, the names and the units of the export
    path : path of the export, for the error on a channel
    channels : channels to read; None for all. If the export consists of blocks or has several
        specimens, all channels are read.

    Returns
    -------
    The export. It has no tables if the file contains only a byte order mark or white space.

    Raises
    ------
    ContentError
        If names, units or numbers are not where the card states.
    NoChannelError
        If a channel to read does not exist, or its name is ambiguous.
    """
    head = decode(content.data[:HEAD_BYTES], content, card.encodings)
    if is_blank(content.data):
        return Export((), notes=(QualityNote.of("readers.blank_export", "file"),), head=head)
    decimal: str = card.decimal
    if card.decimal_pattern is not None:
        match = card.decimal_pattern.search(head)
        if match is None or match[1] not in DECIMAL_SIGNS:
            line = head[:60].splitlines()[0]
            raise ContentError.of("readers.no_decimal_sign", "line 1", line=line)
        decimal = match[1]
    if card.layout == "blocks":
        text = decode(content.data, content, card.encodings)
        return _read_blocks(text, decimal, card)
    header = find_header(split_lines(head), card)
    specimens = _find_specimens(header, card)
    subset = None  # indices of the columns to read
    if channels is not None and len(specimens) == 1:
        subset = _select_columns(header, card, channels, path)
    body, columns, notes = _read_rows(content.data, header, card, columns=subset, decimal=decimal)
    tables = []
    for part, indices in specimens:
        names, units = (row[indices.start : indices.stop] for row in (header.names, header.units))
        # A column without a name and a unit separates two specimens.
        titled_columns = (i for i in indices if header.names[i] or header.units[i])
        padded_columns = {i - indices.start: columns[i] for i in titled_columns if i in columns}
        n_rows = count_filled_rows(padded_columns)  # blank rows pad a shorter specimen
        tables.append(Table(part, names, units, {i: x[:n_rows] for i, x in padded_columns.items()}))
    properties = _parse_preamble(header.preamble) | _list_texts(body, header, card)
    return Export(tuple(tables), properties, tuple(notes), head)


def _read_rows(
    data: bytes,
    header: Header,
    card: Card,
    *,
    columns: Sequence[int] | None = None,
    decimal: str = ".",
) -> tuple[Body, dict[int, Floats], list[QualityNote]]:
    """Read the rows below a header.

    Parameters
    ----------
    data : bytes of a text, a sheet or a block, which begin with the first line of the head
    header : header of the table
    card : card that describes the export
    columns : indices of the columns to read; None for all columns of numbers
    decimal : decimal sign

    Returns
    -------
    body : rows below the header, which are not yet split into cells
    values : values of each column that was read, shape (n_rows,), keyed by index of the column
    notes : quality notes on the rows
    """
    head_and_rows = data.split(b"\n", header.first_row)
    body = Body(
        data=head_and_rows[-1] if len(head_and_rows) > header.first_row else b"",
        names=make_names_unique(header.names),
        columns=_list_number_columns(header, card) if columns is None else columns,
        first_line=header.first_line + header.first_row,
        separator=header.separator,
        decimal=decimal,
        others_numeric=not card.words,
        sheet=header.sheet_label,
    )
    return body, *read_columns(body)


def _list_number_columns(header: Header, card: Card) -> list[int]:
    """List the indices of the columns of numbers, which the card does not declare as text."""
    return [i for i, name in enumerate(header.names) if name not in card.words]


def _select_columns(
    header: Header, card: Card, channels: Sequence[ChannelChoice], path: object
) -> list[int]:
    """Select the columns of channels and their alternatives, of time, and of end markers."""
    names, unique_names = header.names, make_names_unique(header.names)
    time_column = find_time_column(names, header.units, card)
    candidates = [i for i in _list_number_columns(header, card) if i != time_column]
    pairs = [(names[i], unique_names[i]) for i in candidates]
    columns = set[int]() if time_column is None else {time_column}
    for channel in channels:
        index = find_channel(channel, pairs, path)
        columns |= {candidates[i] for i in (index, *find_alternatives(channel, pairs, index))}
    end_markers = {*card.last_zeros, *card.last_code}
    return sorted(columns | {i for i, name in enumerate(names) if name in end_markers})


def _find_specimens(header: Header, card: Card) -> list[tuple[str, range]]:
    """Find the name and the indices of the columns of each specimen.

    The columns of a specimen begin below a filled cell of the row of specimens. If that row is
    incomplete, the columns of a specimen begin at each repetition of the name of the first column.
    """
    n_columns = len(header.names)
    if card.layout != "side by side":
        return [("", range(n_columns))]
    specimen_names = dict(enumerate(header.specimens))
    starts = [i for i in range(n_columns) if specimen_names.get(i)]
    repeats = [i for i, name in enumerate(header.names) if name == header.names[0]]
    if starts[:1] != [0] or len(starts) < len(repeats):
        starts = repeats
    names = [specimen_names.get(start, "") for start in starts]
    if len(starts) > 1:
        names = [name or f"specimen {i}" for i, name in enumerate(names, start=1)]
        names = [*make_names_unique(names)]
    return list(zip(names, map(range, starts, [*starts[1:], n_columns]), strict=True))


def _list_texts(body: Body, header: Header, card: Card) -> dict[str, object]:
    """List up to `max_texts` distinct texts of each column that the card declares as text."""
    max_texts = 20
    columns = {i: name for i, name in enumerate(header.names) if name in card.words}
    texts: dict[str, dict[str, None]] = {name: {} for name in columns.values()}
    for row in body.split_rows() if columns else ():
        for i, name in columns.items():
            if i < len(row):
                texts[name].setdefault(row[i].strip())
    return {name: list(distinct)[:max_texts] for name, distinct in texts.items()}


def _parse_preamble(rows: Rows) -> dict[str, object]:
    """Parse rows of the form ``key, value, unit``, or ``key: value`` in one cell.

    A key that occurs several times has a list of values. The key ``lines`` has the list of rows
    without a key. A line ``sep=;`` is omitted.
    """
    entries: dict[str, list[str]] = {}
    for row in rows:
        cells = [cell.strip() for cell in row if cell.strip()]
        if cells and not _SEPARATOR_CELL.fullmatch(cells[0]):
            key, value = _parse_key_and_value(cells)
            entries.setdefault(key, []).append(value)
    return {key: x[0] if len(x) == 1 and key != "lines" else x for key, x in entries.items()}


def _parse_key_and_value(cells: Sequence[str]) -> tuple[str, str]:
    """Parse the key and the value of a row; the key of a row without one is ``lines``."""
    if len(cells) > 1:
        return cells[0].rstrip(" :"), " ".join(cells[1:])
    key, colon, value = cells[0].partition(": ")
    if colon and 0 < len(key) < 60:  # a longer text before a colon is a sentence
        return key.strip(), value.strip()
    return ("lines", cells[0]) if not cells[0].endswith(":") else (cells[0].rstrip(" :"), "")


def _read_blocks(text: str, decimal: str, card: Card) -> Export:
    """Read blocks separated by blank lines.

    Blocks of samples with the same columns form one table. Summaries and blocks of text become
    metadata. An export of summaries only has no table and the note ``no_samples``.
    """
    blocks, notes, line_number = list[Table](), list[QualityNote](), 1
    preamble = list[Sequence[str]]()
    for block in _BLANK_LINES.split(text):
        lines = split_lines(block[:HEAD_BYTES])
        if split_head(lines, card.separators) is not None:
            header = find_header(lines, card, line_number)
            # If blanks separate the numbers, they separate words and not cells in the preamble.
            preamble += [[" ".join(x)] if header.separator == " " else x for x in header.preamble]
            body, columns, block_notes = _read_rows(block.encode(), header, card, decimal=decimal)
            notes += block_notes
            table = Table("", header.names, header.units, columns, first_line=body.first_line)
            blocks.append(table)
        else:
            preamble += [split_line(line, "\t") for line in split_lines(block)]
        line_number += block.count("\n")
    if not blocks:
        raise ContentError.of("readers.no_blocks", f"lines 1 to {line_number}")
    summaries = _find_summaries(blocks, card)
    samples = [block for block in blocks if block not in summaries]  # compared by identity
    notes += [
        QualityNote.of("readers.summary_blocks", "file", rows=table.n_rows, line=table.first_line)
        for table in summaries
    ]
    if not samples:
        notes.append(QualityNote.of("readers.no_samples", "file"))
    tables, joined_notes = _join_blocks(samples)
    metadata = _parse_preamble(preamble)
    if summaries:
        metadata["summaries"] = [
            {table.names[i]: values.tolist() for i, values in table.columns.items()}
            for table in summaries
        ]
    return Export(tuple(tables), metadata, (*notes, *joined_notes), text[:HEAD_BYTES])


def _join_blocks(blocks: Sequence[Table]) -> tuple[list[Table], list[QualityNote]]:
    """Join the blocks that have the same columns into one table; number several tables."""
    groups: dict[object, list[Table]] = {}
    for block in blocks:
        groups.setdefault((block.names, block.units), []).append(block)
    tables, notes = [], []
    for number, group in enumerate(groups.values(), start=1):
        columns = {i: np.concatenate([x.columns[i] for x in group]) for i in group[0].columns}
        part = f"block {number}" if len(groups) > 1 else ""
        tables.append(replace(group[0], part=part, columns=columns))
        if (count := len(group)) > 1:
            lines = ", ".join(str(block.first_line) for block in group)
            notes.append(QualityNote.of("readers.blocks_joined", "file", count=count, lines=lines))
    return tables, notes


def _find_summaries(blocks: Sequence[Table], card: Card) -> list[Table]:
    """Find the blocks that are summaries.

    If some blocks have a column of time, the others are summaries. If none has, the summaries are
    the blocks of two rows, maximum and minimum, between which all values of the longest block lie.
    """
    untimed_blocks = [block for block in blocks if not _has_time(block, card)]
    if len(untimed_blocks) < len(blocks):
        return untimed_blocks
    longest = max(blocks, key=lambda block: block.n_rows).columns
    return [
        block
        for block in blocks
        if all(
            len(x) == 2 and not np.any((longest.get(i, x) > x[0]) | (longest.get(i, x) < x[1]))
            for i, x in block.columns.items()
        )
    ]


def _has_time(table: Table, card: Card) -> bool:
    """Return whether a table has a column of time."""
    return find_time_column(table.names, table.units, card) is not None


def read_sheets(sheets: Sheets, card: Card) -> Export:
    """Read the sheets of a workbook that contain samples.

    Parameters
    ----------
    sheets : rows of each sheet, from `labpipe.readers.workbooks.open_sheets`
    card : card that describes the names and the units

    Returns
    -------
    The export, with one table for each sheet with samples. Its properties contain the first rows of
    the other sheets.

    Raises
    ------
    ContentError
        If no sheet has names, units and numbers where the card requires them.
    """
    max_listed_rows = 50
    tables, errors, properties = dict[str, Table](), list[ContentError](), dict[str, object]()
    heads = {name: split_lines(format_head(rows)) for name, rows in sheets.items()}
    for name, lines in heads.items():
        try:
            header = _find_sheet_header(lines, name, card)
        except ContentError as error:
            errors.append(error)
            continue
        width = len(header.names)
        table_rows = [row[:width] for row in sheets[name]]  # remarks beside the table are omitted
        _, columns, notes = _read_rows(format_rows(table_rows).encode(), header, card)
        specimen = next((cell for cell in header.specimens if cell), name)
        tables[name] = Table(specimen, header.names, header.units, columns, name, tuple(notes))
        properties |= _parse_preamble(header.preamble)
    if not tables:
        no_sheets_error = ContentError.of("readers.no_sheets", count=len(errors))
        raise next((x for x in errors if x.args[0] != "readers.no_table"), no_sheets_error)
    omitted = [name for name in sheets if name not in tables or _is_summary(name, tables, card)]
    notes = []
    if omitted:
        rows = {name: [split_line(line, "\t") for line in heads[name]] for name in omitted}
        properties["sheets"] = {
            name: [row for row in rows[name][:max_listed_rows] if any(row)] for name in rows
        }
        names, count = ", ".join(f"'{name}'" for name in omitted), len(omitted)
        notes.append(QualityNote.of("readers.sheets_left_out", "file", count=count, names=names))
    sample_tables = tuple(table for name, table in tables.items() if name not in omitted)
    head = "\n".join(line for lines in heads.values() for line in lines)
    return Export(sample_tables, properties, tuple(notes), head)


def _find_sheet_header(lines: Sequence[str], sheet: str, card: Card) -> Header:
    """Find the header of a sheet, and require one specimen above the names if the card does.

    If a sheet has a column of time, the rows above the names may have been edited. The sheet then
    needs no specimen above the names, because its own name is used.
    """
    header = find_header(lines, card, sheet=sheet)
    if card.layout != "specimen above" or len({cell for cell in header.specimens if cell}) == 1:
        return header
    if find_time_column(header.names, header.units, card) is not None:
        return replace(header, specimens=())
    place = f"sheet '{sheet}', row {max(header.first_row - 2, 1)}"
    raise ContentError.of("readers.no_specimen_above", place)


def _is_summary(name: str, tables: Mapping[str, Table], card: Card) -> bool:
    """Return whether a sheet is a summary, with results instead of samples.

    The columns of a summary differ from those of the longest table. In addition, the summary has
    fewer rows than a complete test, or no column of time although another sheet has one.
    """
    table, longest_table = tables[name], max(tables.values(), key=lambda table: table.n_rows)
    lacks_time = any(_has_time(x, card) for x in tables.values()) and not _has_time(table, card)
    is_incomplete = table.n_rows < MIN_TEST_ROWS or lacks_time
    return table.names != longest_table.names and is_incomplete
