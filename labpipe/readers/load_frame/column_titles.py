"""Header of an export: first row of samples, names and units of the columns."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

from labpipe.errors import ReadError
from labpipe.readers.channels import plain_name
from labpipe.readers.load_frame.cards import Card
from labpipe.readers.text_cells import (
    are_units,
    has_dimension_of,
    hold_units,
    is_number,
    is_sample,
    quoted,
    split_line,
    split_name_and_unit,
    strip_brackets,
)

_TIME_WORDS = re.compile(r"(?i)time|zeit|temps|tempo|tiempo|czas|tijd|时间|時間")
Rows = Sequence[Sequence[str]]
_Cells = tuple[str, ...]


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
    first_line : number of the first line
    sheet : name of the sheet in messages, such as ``sheet 'a'``; empty for a text
    width : number of cells of a row of a sheet; remarks may stand beside the table
    """

    names: _Cells
    units: _Cells
    first: int
    above: Rows
    separator: str = ""
    specimens: _Cells = ()
    first_line: int = 1
    sheet: str = ""
    width: int = 0


def find_header(
    lines: Sequence[str], card: Card, path: object, first_line: int = 1, *, sheet: str = ""
) -> Header:
    """Find names and units in the head of a text or a sheet; blank rows among them are ignored.

    Parameters
    ----------
    lines : of the head, without line ends; cells of a sheet are separated by tabs
    card : rules for the header
    path : named in errors
    first_line : number of the first of the lines
    sheet : its name; empty for a text

    Returns
    -------
    The header; the separator is the first one of the card that gives numbers.

    Raises
    ------
    ReadError
        If there is no row of names, no required row of units, or no numbers.
    """
    # The longest real header has 56 lines.
    head = lines[:400]
    if card.names == "listed":
        return _read_listed_titles(head, card, path)
    for separator in ("\t",) if sheet else card.separators:
        rows, first = _split_rows(head, separator, card)
        if first is not None:
            break
    else:
        last_line = first_line + len(head) - 1
        place = f"sheet '{sheet}', row 1" if sheet else f"lines {first_line} to {last_line}"
        raise ReadError.about("readers.no_table", path, place)
    filled = [i for i, row in enumerate(rows[:first]) if any(cell.strip() for cell in row)]
    above = [tuple(cell.strip() for cell in row) for row in map(rows.__getitem__, filled)]
    above = [row[: 1 + max(i for i, cell in enumerate(row) if cell)] for row in above]

    def place_above(row: int) -> str:
        number = first_line + (filled[max(len(filled) - row, 0)] if filled else 0)
        return f"sheet '{sheet}', row {number}" if sheet else f"line {number}"

    if separator == " " and card.name_starts is not None and len(above) > 1:
        text, wanted = " ".join(rows[filled[-2]]), len(rows[-1])
        cuts = [match.start() for match in card.name_starts.finditer(text)]
        above[-2] = tuple(
            text[a:b].strip() for a, b in pairwise([0, *filter(None, cuts), len(text)])
        )
        if (count := len(above[-2])) != wanted:
            place, text = place_above(2), quoted([text])
            raise ReadError.about(
                "readers.names_with_blanks", path, place, wanted=wanted, count=count, text=text
            )
    names, units, n_rows = _find_titles([(), (), *above][-2:], card, path, place_above)
    above = above[:-n_rows]
    has_specimens = card.names == "above units" and card.layout in (
        "side by side",
        "specimen above",
    )
    specimens = above.pop() if above and has_specimens else ()
    return Header(
        names,
        units,
        first,
        above,
        separator,
        specimens,
        first_line,
        sheet=f"sheet '{sheet}'" if sheet else "",
        width=len(rows[-1]) if sheet else 0,
    )


def _split_rows(
    lines: Sequence[str], separator: str, card: Card
) -> tuple[list[list[str]], int | None]:
    """Split the lines up to the first sample; return its index as well, None if there is none."""
    rows: list[list[str]] = []
    for line in lines:
        is_plain = separator not in line and '"' not in line  # fast for hundreds of lines
        row = [line] if is_plain else split_line(line, separator)
        rows.append(row)
        if card.names == "alone":
            if tuple(cell.strip() for cell in row[: len(card.header_words)]) == card.header_words:
                return rows, len(rows)
        elif len(row) > 1 and is_sample(row):
            return rows, len(rows) - 1
    return rows, None


def _read_listed_titles(lines: Sequence[str], card: Card, path: object) -> Header:
    """Read names on separate lines, with the samples after a start line."""
    assert card.listed is not None  # a card without them is refused
    assert card.start is not None
    start = next((i for i, line in enumerate(lines) if card.start.search(line)), None)
    if start is None:
        pattern = card.start.pattern
        raise ReadError.about("readers.no_start_line", path, pattern=pattern, lines=len(lines))
    cells = [match[1].strip() for line in lines[:start] if (match := card.listed.search(line))]
    if not cells:
        pattern = card.listed.pattern
        raise ReadError.about(
            "readers.no_listed_names", path, f"lines 1 to {start}", pattern=pattern
        )
    above = [split_line(line, "\t") for line in lines[:start]]
    names, units = zip(*(split_name_and_unit(cell) or (cell, "") for cell in cells), strict=True)
    return Header(names, units, start + 1, above, card.separators[0])


def _find_titles(
    rows: Sequence[_Cells], card: Card, path: object, place: Callable[[int], str]
) -> tuple[_Cells, _Cells, int]:
    """Return names, units, and the number of rows that hold them, above the samples.

    Names stand alone, with their units in the same cells, or above a row of units.
    """
    above, last = rows
    if card.names == "alone":
        return last, tuple(card.units.get(name, "") for name in last), 1
    width = max(map(len, rows))
    names, cells = (row + ("",) * (width - len(row)) for row in rows)
    # A unit cell may repeat the name above it, as for a counter.
    stated = ["" if cell == name else cell for name, cell in zip(names, cells, strict=True)]
    pairs = [split_name_and_unit(cell, card.brackets) for cell in last]
    if card.names == "above units":
        _check_row_of_units(stated, card.brackets, last, path, place(1))
        if _lacks_names(names, cells):
            raise ReadError.about(
                "readers.no_names_above_units",
                path,
                place(1),
                names=quoted(above),
                units=quoted(last),
            )
        return names, tuple(map(strip_brackets, stated)), 2
    if card.names == "with units" and not any(pairs):
        brackets, row = card.brackets, quoted(last)
        raise ReadError.about(
            "readers.no_names_with_units", path, place(1), brackets=brackets, row=row
        )
    if card.names == "any":
        if not any(last) or any(map(is_number, last)):
            raise ReadError.about("readers.no_names", path, place(1), row=quoted(last))
        has_both = any(pair is not None and pair[0] for pair in pairs)
        if not has_both and are_units(stated) and not _lacks_names(names, cells):
            return names, tuple(map(strip_brackets, stated)), 2
    names, units = zip(*(pair or (c, "") for pair, c in zip(pairs, last, strict=True)), strict=True)
    return names, units, 1


def _check_row_of_units(
    stated: Sequence[str], brackets: str, row: _Cells, path: object, place: str
) -> None:
    """Refuse a row of which no cell is a unit, or one is not in the brackets of the card."""
    in_brackets = [cell[0] + cell[-1] == brackets for cell in stated if cell]
    are_known = all(in_brackets) if brackets else hold_units(stated)
    if not in_brackets or not are_known or any(map(is_number, row)):
        where = f" in {brackets}" if brackets else ""
        raise ReadError.about(
            "readers.no_row_of_units", path, place, brackets=where, row=quoted(row)
        )


def _lacks_names(names: _Cells, cells: _Cells) -> bool:
    """Return whether a unit has no name, or all names are equal."""
    unnamed = any(unit and not name for name, unit in zip(names, cells, strict=True))
    filled = [name for name in names if name]
    return unnamed or (len(filled) > 1 and len(set(filled)) == 1) or is_number(names[0])


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
