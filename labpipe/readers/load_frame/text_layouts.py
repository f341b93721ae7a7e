"""Tables of text exports: a single one, specimens side by side, or successive blocks."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from labpipe.readers.channels import ReportOptions, unique_names
from labpipe.readers.load_frame.cards import Card
from labpipe.readers.load_frame.column_titles import Header, find_header
from labpipe.readers.load_frame.frame_recording import (
    Export,
    Table,
    preamble,
    time_column,
    wanted_columns,
    word_columns,
)
from labpipe.readers.number_rows import read_columns
from labpipe.readers.raw_files import (
    HEAD_BYTES,
    Content,
    decode,
    is_blank,
    line_start,
    lines_of,
    unreadable,
)
from labpipe.readers.table_body import Body
from labpipe.readers.text_cells import is_sample, split_line
from labpipe.records.quality import QualityNote, Severity

_BLANK_LINE = re.compile(r"\n(?:[ \t\r]*\n)+")


def read_tables(content: Content, place: Place) -> Export:
    """Read all tables of a text export.

    Parameters
    ----------
    content : its bytes
    place : file, card and wanted channels

    Returns
    -------
    The tables; none if there is only a byte order mark.

    Raises
    ------
    ReadError
        If names, units or numbers are not where the card states.
    """
    head = decode(content.data[:HEAD_BYTES], content, place.card.encodings, place.path)
    if is_blank(content.data):
        message = "only a byte order mark: a step of the test without samples"
        return Export((), notes=(no_samples(message),), head=head)
    if place.card.layout == "blocks":
        text = decode(content.data, content, place.card.encodings, place.path)
        return read_blocks(text, place)
    header = find_header(lines_of(head), place.card, place.path)
    return _read_one(content, header, head, place)


def _read_one(content: Content, header: Header, head: str, place: Place) -> Export:
    card = place.card
    groups = _groups(header) if card.layout == "side by side" else [range(len(header.names))]
    wanted = place.channels if len(groups) == 1 else None
    columns_read = wanted_columns(header, card, wanted, place.path)
    start = line_start(content.data, header.first)
    body = Body(
        data=content.data,
        start=start,
        others_numeric=not word_columns(header.names, card),
        names=unique_names(header.names),
        columns=columns_read,
        first_line=header.first + 1,
        separator=header.separator,
        decimal=decimal_of(head, place),
    )
    columns, notes = read_columns(body, place.path)
    several = len(groups) > 1
    tables = []
    for group, part in zip(groups, _parts(header, groups), strict=True):
        filled = (i for i in group if header.names[i] or header.units[i])  # a blank one separates
        chosen = {i - group[0]: columns[i] for i in filled if i in columns}
        if several:
            chosen = _without_padding(chosen)
        names = tuple(header.names[i] for i in group)
        units = tuple(header.units[i] for i in group)
        tables.append(Table(part, names, units, chosen))
    about = preamble(header.above) | _word_values(content.data, start, header, card)
    return Export(tuple(tables), about, tuple(notes), head)


def _groups(header: Header) -> list[range]:
    """Return the columns of each specimen, which begins where the row of specimens is filled."""
    width = len(header.names)
    starts = [i for i, cell in enumerate(header.specimens[:width]) if cell]
    first = header.names[0]
    repeats = [i for i, name in enumerate(header.names) if name == first]
    if not starts or starts[0] != 0 or len(starts) < len(repeats):
        starts = repeats
    return [range(a, b) for a, b in zip(starts, [*starts[1:], width], strict=True)]


def _parts(header: Header, groups: Sequence[range]) -> list[str]:
    named = [
        header.specimens[group[0]] if group[0] < len(header.specimens) else "" for group in groups
    ]
    if len(groups) == 1:
        return named
    called = [name or f"specimen {i + 1}" for i, name in enumerate(named)]
    return unique_names(called)


def _without_padding(columns: dict[int, np.ndarray]) -> dict[int, np.ndarray]:
    """Return columns up to the last row that is filled in one of them."""
    filled = np.logical_or.reduce([~np.isnan(values) for values in columns.values()])
    rows = int(np.flatnonzero(filled)[-1]) + 1 if filled.any() else 0
    return {i: values[:rows] for i, values in columns.items()}


def _word_values(data: bytes, start: int, header: Header, card: Card) -> dict[str, object]:
    """Return the distinct texts in columns of text."""
    columns = word_columns(header.names, card)
    if not columns:
        return {}
    texts_by_name: dict[str, dict[str, None]] = {header.names[column]: {} for column in columns}
    for line in lines_of(data[start:].decode("utf-8", errors="replace")):
        cells = split_line(line, header.separator)
        for column in columns:
            if column < len(cells):
                texts_by_name[header.names[column]].setdefault(cells[column].strip())
    return {name: list(texts)[:20] for name, texts in texts_by_name.items()}


@dataclass(frozen=True, slots=True)
class Place:
    """File, card and wanted channels of a text export.

    Parameters
    ----------
    path : of the file, for messages
    card : its card
    channels : wanted ones, None for all
    """

    path: Path
    card: Card
    channels: Sequence[ReportOptions] | None = None


def no_samples(message: str) -> QualityNote:
    """Return a note on a complete export without samples."""
    return QualityNote("no_samples", Severity.WARNING, "file", message)


def decimal_of(head: str, place: Place) -> str:
    """Return the decimal sign: that of the card, or the one stated in the export.

    Parameters
    ----------
    head : beginning of the export
    place : file and card

    Returns
    -------
    The sign, or ``auto``.

    Raises
    ------
    ReadError
        If the export should state it but does not.
    """
    pattern = place.card.decimal_pattern
    if pattern is None:
        return place.card.decimal
    match = pattern.search(head)
    if match is not None and match[1] in {".", ","}:
        return match[1]
    raise unreadable(
        place.path,
        "line 1",
        "the decimal sign that this program states",
        f"'{head[:60].splitlines()[0] if head else ''}'",
        "Export the test again, or name another dialect.",
    )


def read_blocks(text: str, place: Place) -> Export:
    """Read the blocks of a text export.

    Parameters
    ----------
    text : all of it
    place : file and card

    Returns
    -------
    Blocks of samples with the same columns as one table; the other blocks and the summaries as
    metadata. No table, and the note ``no_samples``, if there are only summaries.

    Raises
    ------
    ReadError
        If no block contains names, units and numbers.
    """
    decimal = decimal_of(text[:HEAD_BYTES], place)
    samples: list[Table] = []
    lines: list[int] = []
    notes: list[QualityNote] = []
    about: list[Sequence[str]] = []
    for first_line, block in _blocks(text):
        header = _header_of_block(block, first_line, place)
        if header is None:
            about += [split_line(line, "\t") for line in lines_of(block)]
            continue
        blanks = header.separator == " "  # parts of one key, not cells
        about += [[" ".join(row)] for row in header.above] if blanks else header.above
        table, block_notes = _table_of_block(block, header, first_line, decimal, place)
        samples.append(table)
        lines.append(first_line + header.first)
        notes += block_notes
    _require_samples(samples, text, place)
    samples, lines, summaries, left_out = _without_summaries(samples, lines, place.card)
    if not samples:
        left_out.append(no_samples("all rows are a summary: the test took no samples"))
    joined, together = _joined(samples, lines)
    metadata = preamble(about) | ({"summaries": summaries} if summaries else {})
    return Export(tuple(joined), metadata, (*notes, *left_out, *together), text[:HEAD_BYTES])


def _blocks(text: str) -> Iterator[tuple[int, str]]:
    """Yield blocks with the number of their first line."""
    offset = 0
    for gap in _BLANK_LINE.finditer(text):
        yield text.count("\n", 0, offset) + 1, text[offset : gap.start() + 1]
        offset = gap.end()
    if text[offset:].strip():
        yield text.count("\n", 0, offset) + 1, text[offset:]


def _header_of_block(block: str, first_line: int, place: Place) -> Header | None:
    """Return the header of a block with samples, None for other blocks."""
    head = lines_of(block[:HEAD_BYTES])
    for separator in place.card.separators:
        rows = [[cell for cell in split_line(line, separator) if cell] for line in head]
        if any(len(row) > 1 and is_sample(row) for row in rows):
            return find_header(head, place.card, place.path, first_line)
    return None


def _table_of_block(
    block: str, header: Header, first_line: int, decimal: str, place: Place
) -> tuple[Table, list[QualityNote]]:
    data = block.encode("utf-8")
    body = Body(
        data=data[line_start(data, header.first) :],
        names=unique_names(header.names),
        columns=wanted_columns(header, place.card, None, place.path),
        first_line=first_line + header.first,
        separator=header.separator,
        decimal=decimal,
    )
    columns, notes = read_columns(body, place.path)
    return Table("", header.names, header.units, columns), notes


def _require_samples(samples: Sequence[Table], text: str, place: Place) -> None:
    if samples:
        return
    lines = text.count("\n") + 1
    raise unreadable(
        place.path,
        f"lines 1 to {lines}",
        "a block of names, units and numbers",
        "none",
        "Export the test again, or name another dialect.",
    )


def _without_summaries(
    tables: list[Table], lines: list[int], card: Card
) -> tuple[list[Table], list[int], list[dict[str, list[float]]], list[QualityNote]]:
    """Omit blocks of extremes: blocks without time if others have time, or pairs of rows."""
    are_summaries = _are_summaries(tables, card)
    summaries, notes = [], []
    for table, line, is_summary in zip(tables, lines, are_summaries, strict=True):
        if is_summary:
            rows = max(len(values) for values in table.columns.values())
            message = f"{rows} rows from line {line} have no time: a summary, not samples"
            notes.append(QualityNote("summary_rows_left_out", Severity.INFO, "file", message))
            summaries.append({table.names[i]: v.tolist() for i, v in table.columns.items()})
    kept = [i for i, is_summary in enumerate(are_summaries) if not is_summary]
    return [tables[i] for i in kept], [lines[i] for i in kept], summaries, notes


def _are_summaries(tables: Sequence[Table], card: Card) -> list[bool]:
    """Return which blocks are summaries; if none has time, those of extremes.

    Extremes are two rows, of which the first one is never the smaller one.
    """
    timed = [time_column(table.names, table.units, card) is not None for table in tables]
    if any(timed):
        return [not has_time for has_time in timed]
    return [
        all(len(values) == 2 and values[0] >= values[1] for values in table.columns.values())
        for table in tables
    ]


def _joined(tables: list[Table], lines: list[int]) -> tuple[list[Table], list[QualityNote]]:
    """Join blocks with the same columns; other blocks become separate parts."""
    groups: dict[tuple[tuple[str, ...], tuple[str, ...]], list[int]] = {}
    for i, table in enumerate(tables):
        groups.setdefault((table.names, table.units), []).append(i)
    joined, notes = [], []
    for number, ((names, units), members) in enumerate(groups.items(), start=1):
        columns = {
            column: np.concatenate([tables[i].columns[column] for i in members])
            for column in tables[members[0]].columns
        }
        part = f"block {number}" if len(groups) > 1 else ""
        joined.append(Table(part, names, units, columns))
        if len(members) > 1:
            places = ", ".join(str(lines[i]) for i in members)
            message = f"{len(members)} blocks of samples (from lines {places} on) are one recording"
            notes.append(QualityNote("blocks_joined", Severity.INFO, "file", message))
    return joined, notes
