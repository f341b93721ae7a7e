"""Tables as the sheets of a workbook: their names, their look, and how they are written."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

from labpipe.errors import StoreError, complaint
from labpipe.records.arrays import Floats
from labpipe.report.wording import Scale, printable

if TYPE_CHECKING:
    from openpyxl.cell import Cell
    from openpyxl.styles import NamedStyle
    from openpyxl.workbook import Workbook

_HEADING = "heading of a column"
_NARROWEST, _WIDEST = 11, 60
_SHEET_NAME = 31
_NOT_IN_A_NAME = re.compile(r"[\\/*?:\[\]\x00-\x1f']")
_RESERVED = "history"
"""Excel's own sheet of tracked changes, in any case of letters."""

Value: TypeAlias = str | float | None
Column: TypeAlias = tuple[str, Iterable[Any]]
FREE: Column = ("", ())
"""A column that is left free."""


class Sheet(NamedTuple):
    """A sheet before it is written.

    Parameters
    ----------
    name : free of what a sheet's name may not hold, and no other sheet's
    heads : headings
    rows : below them
    frozen : cell above and left of which all stays in view
    links : text of the first column -> name of the sheet that it leads to
    """

    name: str
    heads: Sequence[str]
    rows: Sequence[Sequence[Value]]
    frozen: str = "A2"
    links: Mapping[str, str] = {}


def save_sheets(sheets: Iterable[Sheet], path: Path, *, again: str, active: int = 0) -> None:
    """Write sheets as an xlsx file.

    Parameters
    ----------
    sheets : in their order; each is written and let go before the next
    path : of the file
    again : how to make the file again, for a message
    active : number of the sheet that is seen first, from 0

    Raises
    ------
    StoreError
        If the file cannot be written.

    Notes
    -----
    Text stays text: a sample that is called ``=1+1`` is not a formula. Numbers that are not finite
    are empty cells. Characters that a workbook cannot hold are shown as U+FFFD.
    """
    from openpyxl import Workbook

    try:
        with path.open("wb") as file:  # first: a book that was begun has to be saved
            # cells go to disk as they come: hundreds of sheets take less time and memory
            book = Workbook(write_only=True)
            book.add_named_style(_heading())
            for sheet in sheets:
                _add(book, sheet)
            book.active = active
            book.save(file)
    except OSError as error:
        message = complaint(
            path,
            "",
            expected="a workbook that can be written",
            found=str(error),
            remedy=f"Make room, change the permissions, or close it where it is open, and {again}"
            " again.",
        )
        raise StoreError(message) from error


def sheet_of_columns(name: str, columns: Iterable[Column]) -> Sheet:
    """Put columns of any lengths beside each other.

    Parameters
    ----------
    name : of the sheet
    columns : heading and values of each; `FREE` for one without anything
    """
    heads, values = zip(*columns, strict=True)
    return Sheet(name, heads, list(zip_longest(*values)))


def column(words: str, scale: Scale, values: Floats) -> Column:
    """Column of numbers in a display unit, below a heading with that unit."""
    return scale.label(words), (scale.factor * values).tolist()


def sheet_name(wanted: str, taken: Sequence[str]) -> str:
    """Turn any text into a name that a sheet may have and that no other sheet has.

    Parameters
    ----------
    wanted : text
    taken : names of the other sheets

    Returns
    -------
    At most 31 characters, none of which is forbidden, and not ``History``, which Excel keeps for
    itself.

    Examples
    --------
    >>> sheet_name("curve a/b", ["read me"])
    'curve a-b'
    >>> sheet_name("read me", ["Read me"])
    'read me 2'
    """
    plain = _begin(_NOT_IN_A_NAME.sub("-", printable(wanted)), _SHEET_NAME).strip() or "sheet"
    known = {_RESERVED, *(name.casefold() for name in taken)}
    name, number = plain, 1
    while name.casefold() in known:
        number += 1
        tail = f" {number}"
        name = _begin(plain, _SHEET_NAME - len(tail)) + tail
    return name


def _begin(text: str, most: int) -> str:
    """Take as much of a text as there is room for, as Excel counts: in units of UTF-16."""
    return text.encode("utf-16-le")[: 2 * most].decode("utf-16-le", "ignore")


def _add(book: Workbook, sheet: Sheet) -> None:
    """Write a sheet: bold headings that stay in view, columns as wide as their text."""
    from openpyxl.utils import get_column_letter

    page: Any = book.create_sheet(sheet.name)
    page.freeze_panes = sheet.frozen
    for number, width in enumerate(_widths(sheet), start=1):
        page.column_dimensions[get_column_letter(number)].width = width
    heads = [_text(page, head) for head in sheet.heads]
    for cell in heads:
        cell.style = _HEADING
    page.append(heads)
    for first, *others in sheet.rows:
        link = sheet.links.get(str(first), "")
        page.append([_cell(page, first, link), *(_cell(page, value) for value in others)])


def _heading() -> NamedStyle:
    from openpyxl.styles import Alignment, Font, NamedStyle

    wrapped = Alignment(wrap_text=True, vertical="top")
    return NamedStyle(_HEADING, font=Font(bold=True), alignment=wrapped)


def _widths(sheet: Sheet) -> list[int]:
    """Width of each column: of its longest text; headings are broken into lines."""
    widths = [max(_NARROWEST, *map(len, head.split(" "))) for head in sheet.heads]
    for row in sheet.rows:
        for at, value in enumerate(row):
            if isinstance(value, str):
                widths[at] = max(widths[at], len(value))
    return [min(width + 2, _WIDEST) for width in widths]


def _cell(page: Any, value: Value, link: str = "") -> Cell | float | None:
    if isinstance(value, str):
        return _text(page, value, link)
    return None if value is None or not math.isfinite(value) else value


def _text(page: Any, text: str, link: str = "") -> Cell:
    from openpyxl.cell import WriteOnlyCell
    from openpyxl.worksheet.hyperlink import Hyperlink

    cell: Cell = WriteOnlyCell(page, printable(text))
    if cell.data_type != "s":  # begins like a formula, or is called like an error
        cell.data_type = "s"
        cell.quotePrefix = True
    if link:
        cell.hyperlink = Hyperlink(ref="A1", location=f"'{link}'!A1")
        cell.style = "Hyperlink"
    return cell
