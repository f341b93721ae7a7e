"""Where the samples of an export begin; above them stands what the columns are called."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from labpipe.errors import ReadError
from labpipe.readers.cells import is_number, name_and_unit, split_line
from labpipe.readers.files import unreadable
from labpipe.readers.load_frame.card import Card
from labpipe.readers.load_frame.titles import Fault, Header, Rows, find_titles, put_names_together

MOST_LINES = 400
"""The header is looked for in this many lines; the longest real one has 56."""

_AGAIN = "Export the test again with names and units, or name another dialect."
_CARD = "Say in a card of your own how names begin (name_starts); see docs/how-to/new-dialect.md."


def find_header(lines: Sequence[str], card: Card, path: object, first_line: int = 1) -> Header:
    """Find names and units in the lines of a text export.

    Parameters
    ----------
    lines : its head, without line ends
    card : how the header is found
    path : named in errors
    first_line : line number of the first of the lines

    Returns
    -------
    The header; the separator is the first one of the card with which numbers are found.

    Raises
    ------
    ReadError
        If there is no row of names, no row of units where there must be one, or no numbers.
    """
    head = lines[:MOST_LINES]
    if card.names == "listed":
        return _listed(head, card, path)
    for separator in card.separators:
        rows = _rows_of(head, separator, card)
        if _first(rows, card) is not None:
            return header_of_rows(rows, card, path, first_line, separator=separator)
    place = f"lines {first_line} to {first_line + len(head) - 1}"
    raise unreadable(path, place, "a row of names and rows of numbers below it", "none", _AGAIN)


def _rows_of(lines: Sequence[str], separator: str, card: Card) -> list[list[str]]:
    """Cells of the lines up to the first one with samples."""
    rows: list[list[str]] = []
    for line in lines:
        is_plain = separator not in line and '"' not in line  # quickly told of hundreds of lines
        rows.append([line] if is_plain else split_line(line, separator))
        if card.names != "alone" and _is_sample(rows[-1]):
            break
    return rows


def header_of_rows(
    rows: Rows,
    card: Card,
    path: object,
    first_line: int = 1,
    *,
    place: str = "line",
    separator: str = "",
) -> Header:
    """Find names and units in rows of cells; parameters as in `find_header`.

    Parameters
    ----------
    place : word for a row in messages: ``line``, or a sheet and ``row``
    separator : that the rows were cut at
    """
    first = _first(rows, card)
    if first is None:
        where = f"{place} {first_line}"
        raise unreadable(path, where, "a row of names and rows of numbers below it", "none", _AGAIN)

    filled = [i for i, row in enumerate(rows[:first]) if any(cell.strip() for cell in row)]

    def telling(remedy: str) -> Fault:
        def fault(row: int, expected: str, found: str) -> ReadError:
            at = filled[max(row, 0)] if filled else 0
            return unreadable(path, f"{place} {first_line + at}", expected, found, remedy)

        return fault

    # A blank row between title, names, units and numbers says nothing.
    rows = [*(rows[i] for i in filled), *rows[first:]]
    if separator == " ":
        rows = put_names_together(rows, len(filled), card, telling(_CARD))
    header = find_titles(rows, len(filled), card, telling(_AGAIN))
    return replace(header, separator=separator, first=first)


def _first(rows: Rows, card: Card) -> int | None:
    """Row with the first samples, None if there is none."""
    if card.names == "alone":
        for i, row in enumerate(rows):
            if tuple(cell.strip() for cell in row[: len(card.header_words)]) == card.header_words:
                return i + 1
        return None
    return next((i for i, row in enumerate(rows) if _is_sample(row)), None)


def _is_sample(row: Sequence[str]) -> bool:
    filled = [cell for cell in row if cell.strip()]
    return len(row) > 1 and bool(filled) and all(is_number(cell) for cell in filled)


def _listed(lines: Sequence[str], card: Card, path: object) -> Header:
    """Names in lines of their own, samples after a line that says so."""
    if card.listed is None or card.start is None:  # a card without them is refused earlier
        raise unreadable(path, "", "a card with `listed` and `start`", card.name, _AGAIN)
    start = next((i for i, line in enumerate(lines) if card.start.search(line)), None)
    if start is None:
        found = f"none in {len(lines)} lines"
        raise unreadable(
            path, "", f"a line '{card.start.pattern}' before the numbers", found, _AGAIN
        )
    named = [match[1].strip() for line in lines[:start] if (match := card.listed.search(line))]
    if not named:
        expected = f"names in lines '{card.listed.pattern}'"
        raise unreadable(path, f"lines 1 to {start}", expected, "none", _AGAIN)
    above = [split_line(line, "\t") for line in lines[:start]]
    names, units = zip(*(name_and_unit(cell) or (cell, "") for cell in named), strict=True)
    return Header(names, units, start + 1, above, card.separators[0])
