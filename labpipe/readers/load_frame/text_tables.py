"""Text exports as tables: one, specimens side by side, or blocks one below the other."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from labpipe.readers.body import read_columns
from labpipe.readers.cells import split_line
from labpipe.readers.channels import unique_names
from labpipe.readers.content import HEAD, Content, decode, is_blank, line_start, lines_of
from labpipe.readers.load_frame.blocks import Place, decimal_of, no_samples, read_blocks
from labpipe.readers.load_frame.card import Card
from labpipe.readers.load_frame.header import find_header
from labpipe.readers.load_frame.table import (
    Export,
    Table,
    preamble,
    wanted_columns,
    word_columns,
)
from labpipe.readers.load_frame.titles import Header
from labpipe.readers.rows import Body


def read_tables(content: Content, place: Place) -> Export:
    """Read all tables of a text export.

    Parameters
    ----------
    content : its bytes
    place : file, card and wanted channels

    Returns
    -------
    The tables; none if there is nothing but a byte order mark.

    Raises
    ------
    ReadError
        If names, units or numbers are not where the card says.
    """
    head = decode(content.data[:HEAD], content, place.card.encodings, place.path)
    if is_blank(content.data):
        message = "a byte order mark and nothing else: a step of the test that took no samples"
        return Export((), notes=(no_samples(message),), head=head)
    if place.card.layout == "blocks":
        text = decode(content.data, content, place.card.encodings, place.path)
        return read_blocks(text, place)
    header = find_header(lines_of(head), place.card, place.path)
    return _read_one(content, header, head, place)


def _read_one(content: Content, header: Header, head: str, place: Place) -> Export:
    card = place.card
    groups = _groups(header) if card.layout == "side by side" else [range(len(header.names))]
    asked = place.channels if len(groups) == 1 else None
    columns_read = wanted_columns(header, card, asked, place.path)
    start = line_start(content.data, header.first)
    body = Body(
        data=content.data,
        start=start,
        as_in_file=content.as_in_file,
        some_only=not word_columns(header.names, card),
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
        own = {i - group[0]: columns[i] for i in group if i in columns and _is_column(header, i)}
        if several:
            own = _without_padding(own)
        names = tuple(header.names[i] for i in group)
        units = tuple(header.units[i] for i in group)
        tables.append(Table(part, names, units, own))
    about = preamble(header.above) | _words(content.data, start, header, card)
    return Export(tuple(tables), about, tuple(notes), head)


def _is_column(header: Header, i: int) -> bool:
    """Tell a column from the blank one that parts two specimens."""
    return bool(header.names[i] or header.units[i])


def _groups(header: Header) -> list[range]:
    """Columns of each specimen: a new one begins where the row of specimens is filled."""
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
    """Columns up to the last row that is filled in one of them."""
    filled = np.logical_or.reduce([~np.isnan(values) for values in columns.values()])
    rows = int(np.flatnonzero(filled)[-1]) + 1 if filled.any() else 0
    return {i: values[:rows] for i, values in columns.items()}


def _words(data: bytes, start: int, header: Header, card: Card) -> dict[str, object]:
    """What the columns of words hold, each text once."""
    columns = word_columns(header.names, card)
    if not columns:
        return {}
    found: dict[str, dict[str, None]] = {header.names[column]: {} for column in columns}
    for line in lines_of(data[start:].decode("utf-8", errors="replace")):
        cells = split_line(line, header.separator)
        for column in columns:
            if column < len(cells):
                found[header.names[column]].setdefault(cells[column].strip())
    return {name: list(texts)[:20] for name, texts in found.items()}
