"""Cells of tables kept in a spreadsheet: text, each with its place for messages.

Writes these files: a person, with a spreadsheet program (xlsx) or a text editor (csv separated by
comma, semicolon or tab, UTF-8).
"""

from __future__ import annotations

import csv
import io
import re
import warnings
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias
from zipfile import ZipFile, is_zipfile

from labpipe.errors import ReadError, error_text
from labpipe.readers.raw_files import reading, unreadable
from labpipe.readers.workbooks import column_letters, is_workbook, open_sheets

_SEPARATORS = ",;\t"
_NUMBER_STARTS = re.compile(r"[-+]?\.?\d")
_NAMED_SEPARATOR = re.compile(r'"?sep=(.)"?', flags=re.IGNORECASE)  # as some programs write


@dataclass(frozen=True, slots=True)
class Cell:
    """One cell.

    Parameters
    ----------
    text : the text without surrounding blanks; dates as 2026-03-04
    place : such as ``cell C4``, or ``line 4, column 3`` in a csv
    unread : why its value cannot be read, such as ``the error #DIV/0!``; empty otherwise
    """

    text: str
    place: str
    unread: str = ""


Row: TypeAlias = tuple[Cell, ...]


@dataclass(frozen=True, slots=True)
class Table:
    """A table with a heading.

    Parameters
    ----------
    heading : the cells of the first non-blank row
    rows : the non-blank rows below, each as long as the heading
    """

    heading: Row
    rows: tuple[Row, ...]


def read_campaign_sheet(path: Path) -> Table:
    """Read the table of a campaign: one row per test.

    Parameters
    ----------
    path : an xlsx workbook (its first sheet is read), or a csv

    Raises
    ------
    ReadError
        If the file is neither, is damaged, has no row below a heading, or has cells beyond it.
    """
    cells = workbook_cells(path) if is_workbook(path) else csv_cells(path)
    return as_table(cells, path, rows_of="one row per test")


def sheets_of(path: Path) -> dict[str, bool]:
    """Return the names of the sheets of a workbook, and whether they are visible.

    Raises
    ------
    ReadError
        If the workbook is damaged.
    """
    from python_calamine import CalamineError, CalamineWorkbook, SheetVisibleEnum

    open_sheets(path)  # raises if it cannot be opened safely
    with (
        reading(path, "a whole workbook", also=(CalamineError,)),
        CalamineWorkbook.from_path(path) as book,
    ):
        return {
            sheet.name: sheet.visible == SheetVisibleEnum.Visible for sheet in book.sheets_metadata
        }


def workbook_cells(path: Path, sheet: str = "", where: str = "") -> list[list[Cell]]:
    """Return the filled rows of a sheet; an additional last one has cells that cannot be read.

    Parameters
    ----------
    path : the workbook, xlsx
    sheet : its name; the first one if empty
    where : prefix of the places of its cells

    Raises
    ------
    ReadError
        If the workbook is damaged.
    """
    sheets = open_sheets(path)
    if not is_zipfile(path):
        remedy = "Save it as xlsx in the spreadsheet program."
        raise unreadable(path, "", "an xlsx workbook", "an old workbook (xls)", remedy)
    name = sheet or next(iter(sheets))
    before = f"{where}, " if where else ""
    with reading(path, "a whole workbook"):
        unread = _unread_cells(path, name, before)
    shown = [
        [
            Cell(_cell_text(value), f"{before}cell {column_letters(column)}{line}")
            for column, value in enumerate(row, start=1)
        ]
        for line, row in enumerate(sheets[name], start=1)
        if any(value != "" for value in row)
    ]
    return [*shown, unread] if unread else shown


def _unread_cells(path: Path, name: str, before: str) -> list[Cell]:
    """Return cells that calamine reads as blank: errors, and formulas without values."""
    from openpyxl import load_workbook

    if not _has_formulas(path):  # most sheets: avoids reading them twice more
        return []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about styles and extensions, which are not read
        books = [load_workbook(path, read_only=True, data_only=only) for only in (False, True)]
        pages = [book[name] for book in books]
        for page in pages:
            page.reset_dimensions()  # the stated size may be wrong
        cells = [
            Cell("", f"{before}cell {column_letters(column)}{line}", unread=why)
            for line, rows in enumerate(zip(*(page.iter_rows() for page in pages), strict=True), 1)
            for column, (formula, value) in enumerate(zip(*rows, strict=True), 1)
            if (why := _why_unread(formula, value))
        ]
        for book in books:
            book.close()
    return cells


def _has_formulas(path: Path) -> bool:
    with ZipFile(path) as parts:
        names = [name for name in parts.namelist() if name.startswith("xl/worksheets/")]
        texts = [parts.read(name) for name in names]
    return any(b"<f" in text or b't="e"' in text for text in texts)


def _why_unread(formula: Any, value: Any) -> str:
    """Return why a cell cannot be read, by its formula and stored value; empty if it can."""
    if value.data_type == "e" and value.value is not None:
        return f"the error {value.value}"
    # A formula that returns an empty text is stored as text ("str"): an intended blank.
    if formula.data_type == "f" and value.value is None and value.data_type != "str":
        return "a formula without a stored value"
    return ""


def csv_cells(path: Path) -> list[list[Cell]]:
    """Return all cells of a csv; the separator is the most frequent one of line 1, or ``sep=;``.

    Raises
    ------
    ReadError
        If it is not UTF-8 text.
    """
    with reading(path, "a table as UTF-8 text", remedy="Save it as 'CSV UTF-8'."):
        with path.open(encoding="utf-8-sig", newline="") as stream:
            text = stream.read()
        first = next((line for line in _lines(text) if line.strip()), "")
        separator = max(_SEPARATORS, key=first.count)
        if named := _NAMED_SEPARATOR.fullmatch(first.rstrip("\r\n")):
            separator = named[1]
            text = text.replace(first, "\n", 1)  # blank, so that line numbers stay right
        reader = csv.reader(_lines(text), delimiter=separator, strict=True)
        return [_csv_row(row, reader.line_num) for row in reader]


def _lines(text: str) -> io.StringIO:
    """Split lines as csv does; str.splitlines also splits at U+0085 and U+2028."""
    return io.StringIO(text, newline="")


def as_table(cells: list[list[Cell]], path: Path, *, rows_of: str, place: str = "") -> Table:
    """Split cells into a heading and the rows below it.

    Parameters
    ----------
    cells : of the whole sheet
    path : named in errors
    rows_of : meaning of a row, such as ``one row per test``
    place : of the table in the file, for messages; empty for the whole file

    Raises
    ------
    ReadError
        If there is no row below a heading, a cell beyond it, or cells that cannot be read, which
        are all in one message.
    """
    unread = [cell for row in cells for cell in row if cell.unread]
    if unread:
        raise ReadError("\n".join(_unread_error(cell, path) for cell in unread))
    filled = [row for row in cells if any(cell.text for cell in row)]
    if len(filled) < 2:
        expected, remedy = f"a heading and {rows_of}", "Fill in the table."
        found = f"{len(filled)} rows"
        raise unreadable(path, place, expected, found, remedy)
    width = max(i for i, cell in enumerate(filled[0], start=1) if cell.text)
    heading = tuple(filled[0][:width])
    return Table(heading, tuple(_fit_row(row, len(heading), path) for row in filled[1:]))


def _unread_error(cell: Cell, path: Path) -> str:
    remedy = "Open the workbook in the spreadsheet program and save it."
    if cell.unread.startswith("the error"):
        remedy = "Correct the cell."
    expected = "a value"
    return error_text(path, cell.place, expected=expected, found=cell.unread, remedy=remedy)


def _csv_row(row: Iterable[str], line: int) -> list[Cell]:
    return [
        Cell(text.strip(), f"line {line}, column {column}")
        for column, text in enumerate(row, start=1)
    ]


def _cell_text(value: object) -> str:
    """Return the value of a cell as displayed: 1 for 1.0."""
    if isinstance(value, float) and value.is_integer():
        return str(int(value))
    return str(value).strip()


def _fit_row(row: list[Cell], width: int, path: Path) -> Row:
    """Return a row with the length of the heading."""
    for cell in row[width:]:
        if cell.text:
            expected, found = "a cell below a heading", f"'{cell.text}'"
            remedy = "Give its column a name in the first row, or empty the cell."
            if cell.place.startswith("line") and _NUMBER_STARTS.match(cell.text):
                remedy += ' Put a list in quotes, "12;-15", and write a decimal point, no comma.'
            raise unreadable(path, cell.place, expected, found, remedy)
    return (*row[:width], *(Cell("", row[0].place) for _ in range(width - len(row))))
