"""Header of an export: first row of samples, names and units of the columns."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

from labpipe.errors import ReadError
from labpipe.readers.load_frame.cards import Card
from labpipe.readers.raw_files import unreadable
from labpipe.readers.text_cells import (
    are_units,
    bare_unit,
    hold_units,
    is_number,
    is_sample,
    name_and_unit,
    quoted,
    split_line,
    without_brackets,
)

_REMEDY = "Export the test again with names and units, or name another dialect."
_CARD_REMEDY = (
    "Say in a card of your own how names begin (name_starts); see docs/how-to/new-dialect.md."
)
Rows = Sequence[Sequence[str]]
Fault = Callable[[int, str, str], ReadError]
"""Error of a row: its index, expected and found."""


def find_header(lines: Sequence[str], card: Card, path: object, first_line: int = 1) -> Header:
    """Find names and units in the lines of a text export.

    Parameters
    ----------
    lines : its head, without line ends
    card : rules for the header
    path : named in errors
    first_line : line number of the first of the lines

    Returns
    -------
    The header; the separator is the first one of the card that gives numbers.

    Raises
    ------
    ReadError
        If there is no row of names, no required row of units, or no numbers.
    """
    max_header_lines = 400  # lines searched for the header; the longest real one has 56
    head = lines[:max_header_lines]
    if card.names == "listed":
        return _listed_titles(head, card, path)
    for separator in card.separators:
        rows = _rows_of(head, separator, card)
        if _first_sample_row(rows, card) is not None:
            return header_of_rows(rows, card, path, first_line, separator=separator)
    place = f"lines {first_line} to {first_line + len(head) - 1}"
    raise unreadable(path, place, "a row of names and rows of numbers below it", "none", _REMEDY)


def _rows_of(lines: Sequence[str], separator: str, card: Card) -> list[list[str]]:
    """Return the cells of the lines up to the first one with samples."""
    rows: list[list[str]] = []
    for line in lines:
        is_plain = separator not in line and '"' not in line  # fast for hundreds of lines
        rows.append([line] if is_plain else split_line(line, separator))
        if card.names != "alone" and len(rows[-1]) > 1 and is_sample(rows[-1]):
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
    place : name of a row in messages: ``line``, or a sheet and ``row``
    separator : separator of the cells
    """
    first = _first_sample_row(rows, card)
    if first is None:
        where = f"{place} {first_line}"
        raise unreadable(
            path, where, "a row of names and rows of numbers below it", "none", _REMEDY
        )

    filled = [i for i, row in enumerate(rows[:first]) if any(cell.strip() for cell in row)]

    def fault_with(remedy: str) -> Fault:
        def fault(row: int, expected: str, found: str) -> ReadError:
            index = filled[max(row, 0)] if filled else 0
            return unreadable(path, f"{place} {first_line + index}", expected, found, remedy)

        return fault

    # Blank rows between title, names, units and numbers are ignored.
    rows = [*(rows[i] for i in filled), *rows[first:]]
    if separator == " ":
        rows = join_names(rows, len(filled), card, fault_with(_CARD_REMEDY))
    header = parse_titles(rows, len(filled), card, fault_with(_REMEDY))
    return replace(header, separator=separator, first=first)


def _first_sample_row(rows: Rows, card: Card) -> int | None:
    """Return the index of the first row of samples; None if there is none."""
    if card.names == "alone":
        for i, row in enumerate(rows):
            if tuple(cell.strip() for cell in row[: len(card.header_words)]) == card.header_words:
                return i + 1
        return None
    return next((i for i, row in enumerate(rows) if len(row) > 1 and is_sample(row)), None)


def _listed_titles(lines: Sequence[str], card: Card, path: object) -> Header:
    """Read names on separate lines, with the samples after a start line."""
    if card.listed is None or card.start is None:  # a card without them is refused earlier
        raise unreadable(path, "", "a card with `listed` and `start`", card.name, _REMEDY)
    start = next((i for i, line in enumerate(lines) if card.start.search(line)), None)
    if start is None:
        found = f"none in {len(lines)} lines"
        raise unreadable(
            path, "", f"a line '{card.start.pattern}' before the numbers", found, _REMEDY
        )
    named = [match[1].strip() for line in lines[:start] if (match := card.listed.search(line))]
    if not named:
        expected = f"names in lines '{card.listed.pattern}'"
        raise unreadable(path, f"lines 1 to {start}", expected, "none", _REMEDY)
    above = [split_line(line, "\t") for line in lines[:start]]
    names, units = zip(*(name_and_unit(cell) or (cell, "") for cell in named), strict=True)
    return Header(names, units, start + 1, above, card.separators[0])


@dataclass(frozen=True, slots=True)
class Header:
    """The rows above the samples.

    Parameters
    ----------
    names : of the columns, without surrounding blanks
    units : of the columns, without brackets; empty if not stated
    first : index of the first row of samples
    above : the rows above the names
    separator : between cells
    specimens : the row above the names if it contains specimens, else empty
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    first: int
    above: Rows
    separator: str = ""
    specimens: tuple[str, ...] = ()


def parse_titles(rows: Rows, first: int, card: Card, fault: Fault) -> Header:
    """Read names and units at the location stated in the card.

    Parameters
    ----------
    rows : cells of the first rows of the export
    first : index of the first row of samples
    card : rules for the header
    fault : creates the error

    Raises
    ------
    ReadError
        If there is no row of names, or required units are missing.
    """
    if card.names == "alone":
        names = _stripped(rows[first - 1])
        units = tuple(card.units.get(name, "") for name in names)
        return Header(names, units, first, rows[: first - 1])
    if card.names == "any":
        return _any_titles(rows, first, fault)
    if card.names == "with units":
        return _titles_with_units(rows, first, card.brackets, fault)
    return _titles_above_units(rows, first, card, fault)


def join_names(rows: Rows, first: int, card: Card, fault: Fault) -> Rows:
    """Join the parts of names that contain blanks, by the pattern of their beginnings.

    Parameters
    ----------
    rows, first, card, fault : as in `parse_titles`

    Raises
    ------
    ReadError
        If the number of names differs from that of columns.
    """
    index = first - 2
    if card.name_starts is None or index < 0:
        return rows
    text = " ".join(rows[index])
    starts = [match.start() for match in card.name_starts.finditer(text)]
    cuts = [0, *(start for start in starts if start), len(text)] if text else []
    names = [text[a:b].strip() for a, b in pairwise(cuts)]
    width = len(rows[first])
    if len(names) != width:
        found = f"{len(names)} in {quoted([text])}" if text else "none"
        raise fault(index, f"{width} names, one per column", found)
    return [*rows[:index], names, *rows[index + 1 :]]


def _stripped(row: Sequence[str]) -> tuple[str, ...]:
    """Return cells without surrounding blanks, and without blank cells at the end."""
    cells = [cell.strip() for cell in row]
    while cells and not cells[-1]:
        cells.pop()
    return tuple(cells)


def _padded(cells: tuple[str, ...], width: int) -> tuple[str, ...]:
    return cells + ("",) * (width - len(cells))


def _titles_with_units(rows: Rows, first: int, brackets: str, fault: Fault) -> Header:
    cells = _stripped(rows[first - 1]) if first else ()
    pairs = [name_and_unit(cell, brackets) for cell in cells]
    if not any(pairs):
        expected = f"names with their units in {brackets} above the numbers"
        raise fault(first - 1, expected, quoted(cells))
    names = [pair[0] if pair else cell for pair, cell in zip(pairs, cells, strict=True)]
    units = [pair[1] if pair else "" for pair in pairs]
    return Header(tuple(names), tuple(units), first, rows[: first - 1])


def _titles_above_units(rows: Rows, first: int, card: Card, fault: Fault) -> Header:
    units = _stripped(rows[first - 1]) if first else ()
    kind = f"a row of units{f' in {card.brackets}' if card.brackets else ''} above the numbers"
    names = _stripped(rows[first - 2]) if first > 1 else ()
    bare = [bare_unit(cell, card.brackets) for cell in units if cell]
    are_known = bool(card.brackets) or hold_units(_without_names(units, names))
    if not bare or None in bare or not are_known or any(is_number(cell) for cell in units):
        raise fault(first - 1, kind, quoted(units))
    if _lacks_names(names, units):
        expected = "a row of names, then a row of units, above the numbers"
        raise fault(first - 1, expected, f"{quoted(names)} above {quoted(units)}")
    width = max(len(names), len(units))
    stated = tuple(
        bare_unit(cell, card.brackets) or ""
        for cell in _without_names(_padded(units, width), names)
    )
    specimens, above = _specimens(rows, first - 2, card)
    return Header(_padded(names, width), stated, first, above, specimens=specimens)


def _without_names(units: tuple[str, ...], names: tuple[str, ...]) -> tuple[str, ...]:
    """Return units without those that repeat the name above, as for a counter."""
    above = _padded(names, max(len(names), len(units)))
    return tuple("" if unit == name else unit for unit, name in zip(units, above, strict=False))


def _lacks_names(names: tuple[str, ...], units: tuple[str, ...]) -> bool:
    """Return whether a unit has no name, or all names are equal."""
    beside = zip(_padded(names, len(units)), units, strict=False)
    unnamed = any(unit and not name for name, unit in beside)
    same = len(names) > 1 and len(set(names)) == 1
    return unnamed or same or any(is_number(name) for name in names[:1])


def _specimens(rows: Rows, names: int, card: Card) -> tuple[tuple[str, ...], Rows]:
    """Return the row of specimens above the names, if the card has one, and the rows above."""
    if card.layout not in {"side by side", "specimen above"} or names < 1:
        return (), rows[:names]
    return tuple(cell.strip() for cell in rows[names - 1]), rows[: names - 1]


def _any_titles(rows: Rows, first: int, fault: Fault) -> Header:
    """Read names with units in their cells, above units, or without units."""
    cells = _stripped(rows[first - 1]) if first else ()
    if not any(cells) or any(is_number(cell) for cell in cells):
        raise fault(first - 1, "a row of names above the numbers", quoted(cells))
    has_both = any(_is_name_with_unit(cell) for cell in cells)
    above = _stripped(rows[first - 2]) if first > 1 else ()
    stated = _without_names(cells, above)
    if not has_both and are_units(stated) and not _lacks_names(above, cells):
        width = max(len(above), len(cells))
        units = tuple(without_brackets(cell) for cell in _padded(stated, width))
        return Header(_padded(above, width), units, first, rows[: first - 2])
    pairs = [name_and_unit(cell) or (cell, "") for cell in cells]
    names, stated = zip(*pairs, strict=True)
    return Header(names, stated, first, rows[: first - 1])


def _is_name_with_unit(cell: str) -> bool:
    """Return whether a cell is a name followed by a unit in brackets."""
    pairs = (name_and_unit(cell, brackets) for brackets in ("()", "[]"))
    return any(pair is not None and pair[0] for pair in pairs)
