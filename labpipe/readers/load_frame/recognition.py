"""Recognition of the card of an export, by its content, never by its suffix."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from labpipe.errors import ReadError, error_text, nearest
from labpipe.readers.load_frame.cards import Card, lab_cards, shipped_cards, shipped_names
from labpipe.readers.load_frame.column_titles import Header, find_header, header_of_rows
from labpipe.readers.load_frame.frame_recording import time_column
from labpipe.readers.load_frame.frame_workbook import sheet_head
from labpipe.readers.raw_files import (
    HEAD_BYTES,
    Content,
    decode,
    is_binary,
    is_blank,
    read_beginning,
    unreadable,
)
from labpipe.readers.sheet_cells import as_text
from labpipe.readers.workbooks import is_workbook, open_sheets

_SEPARATOR_LINE = re.compile(r"\A\"?sep=.\"?\n")
"""A first line that states the separator to a spreadsheet."""

CardNames = str | Sequence[str] | None


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
    heads = _Heads(path)
    lab, shipped = lab_cards(), shipped_cards("workbook" if heads.is_workbook else "text")
    ranks = (
        list(lab.values()),
        [card for card in shipped.values() if not card.fallback],
        [card for card in shipped.values() if card.fallback],
    )
    for cards in ranks:
        fitting = [card for card in cards if heads.fit(card)]
        if len(fitting) > 1:
            raise ReadError(_ambiguous([card.name for card in fitting], path))
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
    lab = lab_cards()
    card_names = [*shipped_names(), *lab]
    allowed = [dialect] if isinstance(dialect, str) else list(dialect or ())
    _refuse_unknown(allowed, card_names, path)
    card = recognise_card(path)
    if card is not None and (not allowed or card.name in allowed):
        return card
    if len(allowed) == 1 and (card is None or card.fallback):
        return lab.get(allowed[0]) or shipped_cards()[allowed[0]]
    expected = f"an export of the dialect {' or '.join(allowed or card_names)}"
    what = "one that no card recognises" if card is None else f"one of the dialect {card.name}"
    remedy = "Name the right file, or change `dialect` in the protocol."
    raise unreadable(path, "", expected, what, remedy)


def _refuse_unknown(allowed: Sequence[str], card_names: Sequence[str], path: Path) -> None:
    for name in allowed:
        if name not in card_names:
            close = ", ".join(nearest(name, list(card_names), limit=3))
            raise unreadable(
                path,
                f"dialect '{name}'",
                f"one of the {len(card_names)} cards",
                "no such card",
                f"Nearest: {close}. A lab's own cards are in the folder dialects.",
            )


def _ambiguous(names: Sequence[str], path: Path) -> str:
    return error_text(
        path,
        "",
        expected="an export that one card recognises",
        found=f"one that fits {' and '.join(names)}",
        remedy="Name the `dialect` in the protocol.",
    )


class _Heads:
    """The head of a file, decoded for each card."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.is_workbook = is_workbook(path)
        self.content = Content(b"") if self.is_workbook else read_beginning(path)
        self.decoded: dict[tuple[str, ...], str] = {}

    def fit(self, card: Card) -> bool:
        """Return whether the head fits a card."""
        if (card.kind == "workbook") is not self.is_workbook:
            return False
        if self.is_workbook:
            return self._fit_sheets(card)
        if is_blank(self.content.data):
            return card.blank and bool(self.content.written_in)
        if is_binary(self.content) or not card.recognise:
            return False
        text = self._text(card)
        return _matches(card, text) and (not card.fallback or self._finds_header(card, text))

    def _text(self, card: Card) -> str:
        # Characters searched for the patterns of a card; the longest real header has 3300.
        head_length = 16384
        if card.encodings not in self.decoded:
            try:
                data = self.content.data[:HEAD_BYTES]
                text = decode(data, self.content, card.encodings, self.path)
            except ReadError:
                text = ""
            text = _SEPARATOR_LINE.sub("", text.replace("\r\n", "\n"))
            self.decoded[card.encodings] = text[:head_length]
        return self.decoded[card.encodings]

    def _finds_header(self, card: Card, text: str) -> bool:
        """Return whether a fallback card finds names and units, not only matching text."""
        try:
            header = find_header(text.split("\n"), card, self.path)
        except ReadError:
            return False
        return _is_test_header(header, card)

    def _fit_sheets(self, card: Card) -> bool:
        try:
            sheets = open_sheets(self.path)
        except ReadError:
            return False
        return any(
            _matches(card, sheet_head(rows))
            and (not card.fallback or self._reads_sheet(card, rows))
            for rows in sheets.values()
        )

    def _reads_sheet(self, card: Card, rows: Sequence[Sequence[object]]) -> bool:
        text = [[as_text(cell) for cell in row] for row in rows[:60]]
        try:
            header = header_of_rows(text, card, self.path)
        except ReadError:
            return False
        return _is_test_header(header, card)


def _is_test_header(header: Header, card: Card) -> bool:
    """Return whether there is time, and another unit or a name of force or travel."""
    time = time_column(header.names, header.units, card)
    if time is None:
        return False
    has_units = any(unit for i, unit in enumerate(header.units) if i != time)
    return has_units or _matches(card, "\t".join(header.names))


def _matches(card: Card, text: str) -> bool:
    return bool(card.recognise) and all(pattern.search(text) for pattern in card.recognise)
