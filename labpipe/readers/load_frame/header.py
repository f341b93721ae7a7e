"""Where the numbers of an export begin, and what its columns are called."""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from labpipe.errors import ReadError, complaint
from labpipe.readers.load_frame.card import Card
from labpipe.units import si_factor

Rows = Sequence[Sequence[str]]
_Fault = Callable[[int, str, str], ReadError]

MOST_LINES = 400
"""The header is looked for in this many lines; the longest real one has 56."""

_NUMBER = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+|\d{1,3}([.,]\d{3})+)([eE][+-]?\d+)?")
_IN_CELL = {
    "()": re.compile(r"(.*?)\s*\(([^()]*(?:\([^()]*\))?[^()]*)\)"),
    "[]": re.compile(r"(.*?)\s*\[([^\[\]]*)\]"),
}
_AGAIN = "Export the test again with names and units, or name another dialect."
_SI = ("s", "m", "N", "Pa", "1", "V", "N*m", "rad", "K", "Hz", "m/s", "kg")
_NO_DIMENSION = frozenset({"-", "count", "°C"})


@dataclass(frozen=True, slots=True)
class Header:
    """What stands above the samples.

    Parameters
    ----------
    names : of the columns, as in the file but for blanks around them
    units : of the columns, without brackets; empty where none is stated
    first : number of the first row of samples, counted from 0
    above : the rows above the names
    separator : between cells
    specimens : the row above the names where it holds specimens, else empty
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    first: int
    above: Rows
    separator: str = ""
    specimens: tuple[str, ...] = ()


def is_number(cell: str) -> bool:
    """Tell whether a cell holds a number, whatever its decimal sign."""
    return _NUMBER.fullmatch(cell.strip()) is not None


def split_line(line: str, separator: str) -> list[str]:
    """Cut a line into its cells."""
    line = line.rstrip("\r\n")
    if separator == " ":
        return line.split()
    try:
        return next(csv.reader([line], delimiter=separator), [])
    except csv.Error:
        return line.split(separator)


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
    raise _fault(path, place, "a row of names and rows of numbers below it", "none")


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
        raise _fault(path, where, "a row of names and rows of numbers below it", "none")

    def fault(row: int, expected: str, found: str) -> ReadError:
        return _fault(path, f"{place} {first_line + max(row, 0)}", expected, found)

    if separator == " ":
        rows = _with_whole_names(rows, first, card)
    return replace(_named(rows, first, card, fault), separator=separator)


def _named(rows: Rows, first: int, card: Card, fault: _Fault) -> Header:
    if card.names == "alone":
        return _names_alone(rows, first, card)
    if card.names == "any":
        return _names_anyhow(rows, first, fault)
    if card.names == "with units":
        return _names_with_units(rows, first, card.brackets, fault)
    return _names_above_units(rows, first, card, fault)


def _with_whole_names(rows: Rows, first: int, card: Card) -> Rows:
    """Put names together that blanks part and that hold blanks, by how names begin.

    Names that cannot be told apart are called by the number of their column.
    """
    at = first - 2
    if card.name_starts is None or at < 0:
        return rows
    text = " ".join(rows[at])
    starts = [match.start() for match in card.name_starts.finditer(text)]
    ends = [*starts[1:], len(text)][: len(starts)]
    names = [text[a:b].strip() for a, b in zip(starts, ends, strict=True)]
    width = len(rows[first])
    whole = names if len(names) == width else [f"column {i + 1}" for i in range(width)]
    return [*rows[:at], whole, *rows[at + 1 :]]


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


def _stripped(row: Sequence[str]) -> tuple[str, ...]:
    """Cells without blanks around them, and without blank cells at the end."""
    cells = [cell.strip() for cell in row]
    while cells and not cells[-1]:
        cells.pop()
    return tuple(cells)


def _padded(cells: tuple[str, ...], width: int) -> tuple[str, ...]:
    return cells + ("",) * (width - len(cells))


def _names_alone(rows: Rows, first: int, card: Card) -> Header:
    names = _stripped(rows[first - 1])
    units = tuple(card.units.get(name, "") for name in names)
    return Header(names, units, first, rows[: first - 1])


def _names_with_units(rows: Rows, first: int, brackets: str, fault: _Fault) -> Header:
    cells = _stripped(rows[first - 1]) if first else ()
    pairs = [_IN_CELL[brackets].fullmatch(cell) for cell in cells]
    if not any(pairs):
        expected = f"names with their units in {brackets} above the numbers"
        raise fault(first - 1, expected, _told(cells))
    names = [pair[1].strip() if pair else cell for pair, cell in zip(pairs, cells, strict=True)]
    units = [pair[2].strip() if pair else "" for pair in pairs]
    return Header(tuple(names), tuple(units), first, rows[: first - 1])


def _names_above_units(rows: Rows, first: int, card: Card, fault: _Fault) -> Header:
    units = _stripped(rows[first - 1]) if first else ()
    kind = f"a row of units{f' in {card.brackets}' if card.brackets else ''} above the numbers"
    if not any(units) or any(is_number(cell) for cell in units):
        raise fault(first - 1, kind, _told(units))
    if card.brackets and not all(_bare(cell, card.brackets) is not None for cell in units if cell):
        raise fault(first - 1, kind, _told(units))
    names = _stripped(rows[first - 2]) if first > 1 else ()
    if _lacks_names(names, units):
        expected = "a row of names, then a row of units, above the numbers"
        raise fault(first - 1, expected, f"{_told(names)} above {_told(units)}")
    width = max(len(names), len(units))
    bare = [_bare(cell, card.brackets) or "" for cell in _padded(units, width)]
    specimens, above = _specimens(rows, first - 2, card)
    return Header(_padded(names, width), tuple(bare), first, above, specimens=specimens)


def _lacks_names(names: tuple[str, ...], units: tuple[str, ...]) -> bool:
    """Tell whether some unit has no name, or one word stands in the place of all names."""
    beside = zip(_padded(names, len(units)), units, strict=False)
    unnamed = any(unit and not name for name, unit in beside)
    same = len(names) > 1 and len(set(names)) == 1
    return unnamed or same or any(is_number(name) for name in names[:1])


def _specimens(rows: Rows, names: int, card: Card) -> tuple[tuple[str, ...], Rows]:
    """The row of specimens above the names, where the card says there is one, and what is above."""
    if card.layout not in {"side by side", "specimen above"} or names < 1:
        return (), rows[:names]
    return tuple(cell.strip() for cell in rows[names - 1]), rows[: names - 1]


def _bare(cell: str, brackets: str) -> str | None:
    """A unit without its brackets; None if it should have some and has none."""
    if not brackets:
        return cell
    whole = len(cell) > 1 and cell[0] == brackets[0] and cell[-1] == brackets[1]
    return cell[1:-1].strip() if whole else None


def _names_anyhow(rows: Rows, first: int, fault: _Fault) -> Header:
    """Names with units in their cells, or above units, or without any."""
    cells = _stripped(rows[first - 1]) if first else ()
    if not any(cells) or any(is_number(cell) for cell in cells):
        raise fault(first - 1, "a row of names above the numbers", _told(cells))
    above = _stripped(rows[first - 2]) if first > 1 else ()
    if _are_units(cells) and not _lacks_names(above, cells):
        width = max(len(above), len(cells))
        units = tuple(_unbracketed(cell) for cell in _padded(cells, width))
        return Header(_padded(above, width), units, first, rows[: first - 2])
    pairs = [_with_unit(cell) for cell in cells]
    return Header(
        tuple(name for name, _ in pairs), tuple(unit for _, unit in pairs), first, rows[: first - 1]
    )


def _unbracketed(cell: str) -> str:
    bare = (_bare(cell, brackets) for brackets in _IN_CELL)
    return next((text for text in bare if text is not None), cell)


def _with_unit(cell: str) -> tuple[str, str]:
    for pattern in _IN_CELL.values():
        match = pattern.fullmatch(cell)
        if match:
            return match[1].strip(), match[2].strip()
    return cell, ""


def _are_units(cells: Sequence[str]) -> bool:
    bare = [_unbracketed(cell) for cell in cells if cell]
    return bool(bare) and all(is_unit(cell) for cell in bare)


def is_unit(text: str) -> bool:
    """Tell whether labpipe knows a text as a unit."""
    return text in _NO_DIMENSION or any(_is_like(text, unit) for unit in _SI)


def _is_like(text: str, unit: str) -> bool:
    try:
        si_factor(text, unit)
    except ValueError:
        return False
    return True


def _listed(lines: Sequence[str], card: Card, path: object) -> Header:
    """Names in lines of their own, samples after a line that says so."""
    if card.listed is None or card.start is None:  # a card without them is refused earlier
        raise _fault(path, "", "a card with `listed` and `start`", card.name)
    start = next((i for i, line in enumerate(lines) if card.start.search(line)), None)
    if start is None:
        found = f"none in {len(lines)} lines"
        raise _fault(path, "", f"a line '{card.start.pattern}' before the numbers", found)
    named = [match[1] for line in lines[:start] if (match := card.listed.search(line))]
    if not named:
        expected = f"names in lines '{card.listed.pattern}'"
        raise _fault(path, f"lines 1 to {start}", expected, "none")
    pairs = [_with_unit(cell.strip()) for cell in named]
    above = [split_line(line, "\t") for line in lines[:start]]
    names, units = zip(*pairs, strict=True)
    return Header(names, units, start + 1, above, card.separators[0])


def _told(cells: Sequence[str]) -> str:
    text = ", ".join(cell for cell in cells if cell)
    return f"'{text[:60]}'" if text else "nothing"


def _fault(path: object, place: str, expected: str, found: str) -> ReadError:
    return ReadError(complaint(path, place, expected=expected, found=found, remedy=_AGAIN))
