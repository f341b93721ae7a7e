"""Header of an export: first row of samples, names and units of the columns."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

from labpipe.errors import ReadError
from labpipe.readers.channels import plain_name
from labpipe.readers.load_frame.cards import Card
from labpipe.readers.raw_files import unreadable
from labpipe.readers.text_cells import (
    are_units,
    bare_unit,
    has_dimension_of,
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
_TIME_WORDS = re.compile(r"(?i)time|zeit|temps|tempo|tiempo|czas|tijd|时间|時間")
Rows = Sequence[Sequence[str]]
_Cells = tuple[str, ...]
_Titles = tuple[_Cells, _Cells, int]
"""Names, units, and the number of rows that hold them."""
_Fault = Callable[[int, str, str], ReadError]
"""Error of a row, counted upwards from 1 above the samples: expected and found."""


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

    names: _Cells
    units: _Cells
    first: int
    above: Rows
    separator: str = ""
    specimens: _Cells = ()


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
    # The longest real header has 56 lines.
    max_lines = 400
    head = lines[:max_lines]
    if card.names == "listed":
        return _listed_titles(head, card, path)
    for separator in card.separators:
        rows = _rows_of(head, separator, card)
        if _first_sample_row(rows, card) is not None:
            return header_of_rows(rows, card, path, f"line {first_line}", separator=separator)
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


def _first_sample_row(rows: Rows, card: Card) -> int | None:
    """Return the index of the first row of samples; None if there is none."""
    if card.names != "alone":
        return next((i for i, row in enumerate(rows) if len(row) > 1 and is_sample(row)), None)
    heads = (tuple(cell.strip() for cell in row[: len(card.header_words)]) for row in rows)
    return next((i + 1 for i, head in enumerate(heads) if head == card.header_words), None)


def _listed_titles(lines: Sequence[str], card: Card, path: object) -> Header:
    """Read names on separate lines, with the samples after a start line."""
    if card.listed is None or card.start is None:  # a card without them is refused earlier
        raise unreadable(path, "", "a card with `listed` and `start`", card.name, _REMEDY)
    start = next((i for i, line in enumerate(lines) if card.start.search(line)), None)
    if start is None:
        expected = f"a line '{card.start.pattern}' before the numbers"
        raise unreadable(path, "", expected, f"none in {len(lines)} lines", _REMEDY)
    cells = [match[1].strip() for line in lines[:start] if (match := card.listed.search(line))]
    if not cells:
        expected = f"names in lines '{card.listed.pattern}'"
        raise unreadable(path, f"lines 1 to {start}", expected, "none", _REMEDY)
    above = [split_line(line, "\t") for line in lines[:start]]
    names, units = zip(*(name_and_unit(cell) or (cell, "") for cell in cells), strict=True)
    return Header(names, units, start + 1, above, card.separators[0])


def header_of_rows(
    rows: Rows, card: Card, path: object, place: str, *, separator: str = ""
) -> Header:
    """Find names and units in rows of cells; blank rows among them are ignored.

    Parameters
    ----------
    rows : of the head of the export
    card : rules for the header
    path : named in errors
    place : of the first row, such as ``line 1``
    separator : separator of the cells

    Raises
    ------
    ReadError
        As `find_header`.
    """
    first = _first_sample_row(rows, card)
    if first is None:
        expected = "a row of names and rows of numbers below it"
        raise unreadable(path, place, expected, "none", _REMEDY)
    filled = [i for i, row in enumerate(rows[:first]) if any(cell.strip() for cell in row)]
    above = [_stripped(rows[i]) for i in filled]

    def fault(row: int, expected: str, found: str, remedy: str = _REMEDY) -> ReadError:
        at = filled[max(len(filled) - row, 0)] if filled else 0
        word, number = place.rsplit(" ", 1)
        return unreadable(path, f"{word} {int(number) + at}", expected, found, remedy)

    if separator == " " and card.name_starts is not None and len(above) > 1:
        above[-2] = _joined_names(" ".join(rows[filled[-2]]), card.name_starts)
        if len(above[-2]) != len(rows[first]):
            text = " ".join(rows[filled[-2]])
            found = f"{len(above[-2])} in {quoted([text])}" if text else "none"
            raise fault(2, f"{len(rows[first])} names, one per column", found, _CARD_REMEDY)
    names, units, n_rows = _titles([(), (), *above][-2:], card, fault)
    above = above[:-n_rows]
    specimens: _Cells = ()
    has_specimens = card.names == "above units" and card.layout in {
        "side by side",
        "specimen above",
    }
    if above and has_specimens:
        specimens = above.pop()
    return Header(names, units, first, above, separator, specimens)


def _titles(rows: Sequence[_Cells], card: Card, fault: _Fault) -> _Titles:
    """Read names and units from the two rows above the samples."""
    above, last = rows
    match card.names:
        case "alone":
            return last, tuple(card.units.get(name, "") for name in last), 1
        case "any":
            return _any_titles(last, above, fault)
        case "with units":
            return _titles_with_units(last, card.brackets, fault)
        case _:
            return _titles_above_units(last, above, card, fault)


def _joined_names(text: str, starts: re.Pattern[str]) -> _Cells:
    """Split a line into names that contain blanks, by the pattern of their beginnings."""
    cuts = [0, *(match.start() for match in starts.finditer(text) if match.start()), len(text)]
    return tuple(text[a:b].strip() for a, b in pairwise(cuts)) if text else ()


def _stripped(row: Sequence[str]) -> _Cells:
    """Return cells without surrounding blanks, and without blank cells at the end."""
    cells = [cell.strip() for cell in row]
    while cells and not cells[-1]:
        cells.pop()
    return tuple(cells)


def _padded(cells: _Cells, width: int) -> _Cells:
    return cells + ("",) * (width - len(cells))


def _titles_with_units(cells: _Cells, brackets: str, fault: _Fault) -> _Titles:
    if not any(name_and_unit(cell, brackets) for cell in cells):
        expected = f"names with their units in {brackets} above the numbers"
        raise fault(1, expected, quoted(cells))
    names, units = zip(
        *(name_and_unit(cell, brackets) or (cell, "") for cell in cells), strict=True
    )
    return names, units, 1


def _titles_above_units(units: _Cells, names: _Cells, card: Card, fault: _Fault) -> _Titles:
    bare = [bare_unit(cell, card.brackets) for cell in units if cell]
    are_known = bool(card.brackets) or hold_units(_without_names(units, names))
    if not bare or None in bare or not are_known or any(is_number(cell) for cell in units):
        brackets = f" in {card.brackets}" if card.brackets else ""
        raise fault(1, f"a row of units{brackets} above the numbers", quoted(units))
    if _lacks_names(names, units):
        expected = "a row of names, then a row of units, above the numbers"
        raise fault(1, expected, f"{quoted(names)} above {quoted(units)}")
    width = max(len(names), len(units))
    stated = _without_names(_padded(units, width), names)
    bare_units = tuple(bare_unit(cell, card.brackets) or "" for cell in stated)
    return _padded(names, width), bare_units, 2


def _without_names(units: _Cells, names: _Cells) -> _Cells:
    """Return units without those that repeat the name above, as for a counter."""
    above = _padded(names, len(units))
    return tuple("" if unit == name else unit for unit, name in zip(units, above, strict=False))


def _lacks_names(names: _Cells, units: _Cells) -> bool:
    """Return whether a unit has no name, or all names are equal."""
    unnamed = any(
        unit and not name for name, unit in zip(_padded(names, len(units)), units, strict=False)
    )
    same = len(names) > 1 and len(set(names)) == 1
    return unnamed or same or any(is_number(name) for name in names[:1])


def _any_titles(cells: _Cells, above: _Cells, fault: _Fault) -> _Titles:
    """Read names with units in their cells, above units, or without units."""
    if not any(cells) or any(is_number(cell) for cell in cells):
        raise fault(1, "a row of names above the numbers", quoted(cells))
    bracketed = [name_and_unit(cell, kind) for cell in cells for kind in ("()", "[]")]
    has_both = any(pair is not None and pair[0] for pair in bracketed)
    stated = _without_names(cells, above)
    if not has_both and are_units(stated) and not _lacks_names(above, cells):
        width = max(len(above), len(cells))
        units = tuple(without_brackets(cell) for cell in _padded(stated, width))
        return _padded(above, width), units, 2
    names, units = zip(*(name_and_unit(cell) or (cell, "") for cell in cells), strict=True)
    return names, units, 1


def time_column(names: Sequence[str], units: Sequence[str], card: Card) -> int | None:
    """Find the column of time.

    Parameters
    ----------
    names, units : of the columns
    card : has patterns of the name, preferred first

    Returns
    -------
    Its index: the column whose whole name matches the first pattern, with or without the prefix of
    a channel number or an underscore (``_Time``); else the only column in a unit of time whose name
    contains a word for time. None if there is no such column, or several. Columns of text are
    ignored.
    """
    names = ["" if name in card.words else name for name in names]
    for called in (names, [plain_name(name) for name in names]):
        for pattern in card.time:
            for i, name in enumerate(called):
                if pattern.fullmatch(name):
                    return i
    timed = [
        i
        for i, (name, unit) in enumerate(zip(names, units, strict=False))
        if _TIME_WORDS.search(name) and has_dimension_of(unit, "s")
    ]
    return timed[0] if len(timed) == 1 else None
