"""Recognition of the card of an export, by its content, never by its suffix."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from functools import cache, partial
from pathlib import Path

from labpipe.errors import ReadError, nearest
from labpipe.readers.load_frame.cards import Card, lab_cards, shipped_cards
from labpipe.readers.load_frame.column_titles import (
    Header,
    find_header,
    header_of_rows,
    time_column,
)
from labpipe.readers.load_frame.tables import sheet_head
from labpipe.readers.raw_files import as_content, decode, is_binary, is_blank, read_head
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
    kind = "workbook" if is_workbook(path) else "text"
    fits = _sheet_test(path) if kind == "workbook" else _text_test(path)
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
            close, place = ", ".join(nearest(name, list(cards), limit=3)), f"dialect '{name}'"
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


def _text_test(path: Path) -> Callable[[Card], bool]:
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


def _sheet_test(path: Path) -> Callable[[Card], bool]:
    """Return the test of whether a card fits one of the sheets of a workbook."""
    try:
        heads = [sheet_head(rows) for rows in open_sheets(path).values()]
    except ReadError:
        return lambda _: False

    def fits(card: Card) -> bool:
        fitting = (head for head in heads if card.fits("\n".join(map("\t".join, head))))
        if not card.fallback:
            return any(True for _ in fitting)
        headers = (partial(header_of_rows, head, card, path, "row 1") for head in fitting)
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
