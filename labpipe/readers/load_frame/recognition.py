"""Which card an export fits: by its content, never by its suffix."""

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
    HEAD,
    Content,
    decode,
    is_binary,
    is_blank,
    read_beginning,
    unreadable,
)
from labpipe.readers.sheet_cells import as_text
from labpipe.readers.workbooks import is_workbook, open_sheets

_LOOKED_AT = 16384
"""Signs in which the patterns of a card are looked for; the longest real header has 3300."""

_SEPARATOR = re.compile(r"\A\"?sep=.\"?\n")
"""A first line by which a spreadsheet learns the separator."""

Named = str | Sequence[str] | None


def recognised(path: Path) -> Card | None:
    """Find the card of an export; a lab's own cards come first, cards of last resort last.

    Parameters
    ----------
    path : the export

    Returns
    -------
    The card, None if none fits.

    Raises
    ------
    ReadError
        If the file cannot be read, two cards of the same rank fit, or a lab's card is wrong.
    """
    heads = _Heads(path)
    own, ours = lab_cards(), shipped_cards("workbook" if heads.is_workbook else "text")
    ranks = (
        list(own.values()),
        [card for card in ours.values() if not card.fallback],
        [card for card in ours.values() if card.fallback],
    )
    for cards in ranks:
        fitting = [card for card in cards if heads.fit(card)]
        if len(fitting) > 1:
            raise ReadError(_ambiguous([card.name for card in fitting], path))
        if fitting:
            return fitting[0]
    return None


def chosen_card(path: Path, dialect: Named) -> Card:
    """Find the card to read an export by.

    Parameters
    ----------
    path : the export
    dialect : card or cards that it must fit, None for any

    Returns
    -------
    The card. An export that no vendor's card recognises is read by the one that was asked for:
    what reads it then checks its structure.

    Raises
    ------
    ReadError
        If there is no such card, or the export fits another one, or none.
    """
    own = lab_cards()
    known = [*shipped_names(), *own]
    allowed = [dialect] if isinstance(dialect, str) else list(dialect or ())
    _refuse_unknown(allowed, known, path)
    found = recognised(path)
    if found is not None and (not allowed or found.name in allowed):
        return found
    if len(allowed) == 1 and (found is None or found.fallback):
        return own.get(allowed[0]) or shipped_cards()[allowed[0]]
    expected = f"an export of the dialect {' or '.join(allowed or known)}"
    what = "one that no card recognises" if found is None else f"one of the dialect {found.name}"
    remedy = "Name the right file, or change `dialect` in the protocol."
    raise unreadable(path, "", expected, what, remedy)


def _refuse_unknown(allowed: Sequence[str], known: Sequence[str], path: Path) -> None:
    for name in allowed:
        if name not in known:
            close = ", ".join(nearest(name, list(known), most=3))
            raise unreadable(
                path,
                f"dialect '{name}'",
                f"one of the {len(known)} cards",
                "no such card",
                f"Nearest: {close}. A lab's own cards lie in the folder dialects.",
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
    """The head of a file as each card would read it."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.is_workbook = is_workbook(path)
        self.content = Content(b"") if self.is_workbook else read_beginning(path)
        self.decoded: dict[tuple[str, ...], str] = {}

    def fit(self, card: Card) -> bool:
        """Check whether the head fits a card."""
        if (card.kind == "workbook") is not self.is_workbook:
            return False
        if self.is_workbook:
            return self._fit_sheets(card)
        if is_blank(self.content.data):
            return card.blank and bool(self.content.written_in)
        if is_binary(self.content) or not card.recognise:
            return False
        text = self._text(card)
        return _found(card, text) and (not card.fallback or self._reads(card, text))

    def _text(self, card: Card) -> str:
        if card.encodings not in self.decoded:
            try:
                data = self.content.data[:HEAD]
                text = decode(data, self.content, card.encodings, self.path)
            except ReadError:
                text = ""
            text = _SEPARATOR.sub("", text.replace("\r\n", "\n"))
            self.decoded[card.encodings] = text[:_LOOKED_AT]
        return self.decoded[card.encodings]

    def _reads(self, card: Card, text: str) -> bool:
        """Check whether a card of last resort finds names: words somewhere do not do."""
        try:
            header = find_header(text.split("\n"), card, self.path)
        except ReadError:
            return False
        return _are_of_a_test(header, card)

    def _fit_sheets(self, card: Card) -> bool:
        try:
            sheets = open_sheets(self.path)
        except ReadError:
            return False
        return any(
            _found(card, sheet_head(rows)) and (not card.fallback or self._reads_sheet(card, rows))
            for rows in sheets.values()
        )

    def _reads_sheet(self, card: Card, rows: Sequence[Sequence[object]]) -> bool:
        text = [[as_text(cell) for cell in row] for row in rows[:60]]
        try:
            header = header_of_rows(text, card, self.path)
        except ReadError:
            return False
        return _are_of_a_test(header, card)


def _are_of_a_test(header: Header, card: Card) -> bool:
    """Check whether there is time, and a unit beside that of time or a name of force or travel."""
    time = time_column(header.names, header.units, card)
    if time is None:
        return False
    has_units = any(unit for i, unit in enumerate(header.units) if i != time)
    return has_units or _found(card, "\t".join(header.names))


def _found(card: Card, text: str) -> bool:
    return bool(card.recognise) and all(pattern.search(text) for pattern in card.recognise)
