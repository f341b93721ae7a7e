"""Read cells of workbooks (xlsx, xls) and csv files, and tables with a heading in them.

The library calamine allocates a table from the first to the last cell of a sheet: one stray cell
needs hundreds of gigabytes. Therefore an xlsx with cells far apart is refused before parsing.
"""

from __future__ import annotations

import csv
import io
import re
import warnings
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeAlias

from labpipe.errors import ReadError
from labpipe.readers.number_table import format_value
from labpipe.readers.raw_files import map_read_errors, read_head

Sheets = Mapping[str, Sequence[Sequence[object]]]
_XLSX, _XLS = b"PK\x03\x04", b"\xd0\xcf\x11\xe0"
_MAX_CELLS = 10_000_000
"""Allowed number of cells of any sheet; they need about 400 MB."""
_MAX_SPARSITY = 20
"""Allowed number of cells per filled cell in larger sheets."""
_FILLED_CELL = re.compile(rb'<c r="([A-Z]{1,3})(\d+)"[^>/]*>(?!</c>)')
"""Column and row of a filled cell in the XML of a sheet."""
_PASSWORD_PART = "EncryptedPackage".encode("utf-16-le")
"""Name of a part that only encrypted workbooks have."""
_WHOLE_NUMBER = re.compile(r"(\d)\.0(?=[\t\n])")
_HEAD_ROWS = 60
_SEPARATORS = ",;\t"
_NAMED_SEPARATOR = re.compile(r'"?sep=(.)"?', flags=re.IGNORECASE)  # as some programs write


def is_workbook(path: Path) -> bool:
    """Return whether a file is a zip archive or an old binary document, by its first bytes."""
    return read_head(path, 8).startswith((_XLSX, _XLS))


def is_locked(path: Path) -> bool:
    """Return whether a file is an xlsx workbook with a password."""
    return read_head(path, 8).startswith(_XLS) and _PASSWORD_PART in path.read_bytes()


def open_sheets(path: Path) -> Sheets:
    """Read the cells of all sheets.

    Parameters
    ----------
    path : the workbook

    Returns
    -------
    Rows of cells by sheet, row and column 1 first.

    Raises
    ------
    ReadError
        If it is not a complete workbook, or its cells are far apart.

    Notes
    -----
    Recognition and reading parse the same workbook, which is slow: the last workbook is cached
    until `clear_sheet_cache`.
    """
    about = path.stat()
    sheets = _parse_cached(path, about.st_mtime_ns, about.st_size)
    if isinstance(sheets, ReadError):
        raise sheets
    return sheets


def format_rows(rows: Sequence[Sequence[object]]) -> str:
    """Format rows of a sheet as lines with tabs between the cells, and all digits of numbers."""
    text = io.StringIO()
    lines = csv.writer(text, delimiter="\t", lineterminator="\n")
    for row in rows:  # csv writes all digits of a float
        lines.writerow([x if type(x) is float else " ".join(format_value(x).split()) for x in row])
    return text.getvalue()


def format_head(rows: Sequence[Sequence[object]]) -> str:
    """Format the head of a sheet as `format_rows`, but whole numbers without a decimal point."""
    return _WHOLE_NUMBER.sub(r"\1", format_rows(rows[:_HEAD_ROWS]))


def clear_sheet_cache() -> None:
    """Clear the cached workbook."""
    _parse_cached.cache_clear()


@lru_cache(maxsize=1)
def _parse_cached(path: Path, mtime: int, size: int) -> Sheets | ReadError:  # noqa: ARG001  versions
    """Parse a workbook; the error is returned, so that it is cached as well."""
    try:
        with map_read_errors(path, "a whole workbook"):
            return _parse_sheets(path)
    except ReadError as error:
        return error


def _parse_sheets(path: Path) -> Sheets:
    from python_calamine import CalamineWorkbook, PasswordError

    if read_head(path, 8).startswith(_XLSX):
        _check_archive(path)
    try:
        with CalamineWorkbook.from_path(path) as book:
            return {
                name: book.get_sheet_by_name(name).to_python(skip_empty_area=False)
                for name in book.sheet_names
            }
    except PasswordError as error:
        raise ReadError.about("readers.locked_workbook", path) from error


def _check_archive(path: Path) -> None:
    """Refuse an archive that is no xlsx, and sheets with cells far apart."""
    with zipfile.ZipFile(path) as parts:
        names = parts.namelist()
        if "xl/workbook.bin" in names or not any(name.startswith("xl/") for name in names):
            raise ReadError.about("readers.no_xlsx", path)
        for name in names:
            if name.startswith("xl/worksheets/"):
                _check_places(parts.read(name), path, Path(name).stem)


def _check_places(text: bytes, path: Path, sheet: str) -> None:
    """Refuse a sheet with far more cells up to the last filled one than filled cells."""
    places: list[tuple[bytes, bytes]] = _FILLED_CELL.findall(text)
    if not places:
        return
    letters = max({letters for letters, _ in places}, key=lambda letters: (len(letters), letters))
    column = sum((letter - 64) * 26**i for i, letter in enumerate(reversed(letters)))  # A is 65
    row = max(int(number) for _, number in places)
    if row * column > max(_MAX_CELLS, _MAX_SPARSITY * len(places)):
        place = f"{sheet}, cell {format_column(column)}{row}"
        raise ReadError.about("readers.cells_far_apart", path, place, filled=len(places))


def format_column(number: int) -> str:
    """Return the letters of a column counted from 1: AB for 28."""
    letters = ""
    while number:
        number, letter = divmod(number - 1, 26)
        letters = chr(ord("A") + letter) + letters
    return letters


@dataclass(frozen=True, slots=True)
class Cell:
    """One cell of a table.

    Parameters
    ----------
    text : the text without surrounding blanks; dates as 2026-03-04
    place : such as ``cell C4``, or ``line 4, column 3`` in a csv
    unread : reason why its value cannot be read, such as ``the error #DIV/0!``; else empty
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
        If the file is neither, is damaged, has no row below a heading, has cells beyond it, or
        cells that cannot be read.
    """
    cells = read_workbook_cells(path) if is_workbook(path) else read_csv_cells(path)
    return split_table(cells, path, rows_of="one row per test")


def list_sheets(path: Path) -> dict[str, bool]:
    """Return whether each sheet of a workbook is visible, by name.

    Raises
    ------
    ReadError
        If the workbook is damaged.
    """
    from python_calamine import CalamineWorkbook, SheetVisibleEnum

    open_sheets(path)  # raises if it cannot be opened safely
    with map_read_errors(path, "a whole workbook"), CalamineWorkbook.from_path(path) as book:
        return {
            sheet.name: sheet.visible == SheetVisibleEnum.Visible for sheet in book.sheets_metadata
        }


def read_workbook_cells(path: Path, sheet: str = "", where: str = "") -> list[list[Cell]]:
    """Read the filled rows of a sheet; a further row contains the cells that cannot be read.

    Parameters
    ----------
    path : the workbook, xlsx
    sheet : its name; the first one if empty
    where : prefix of the places of its cells

    Raises
    ------
    ReadError
        If the workbook is damaged, or an xls.
    """
    sheets = open_sheets(path)
    if not zipfile.is_zipfile(path):
        raise ReadError.about("readers.old_workbook", path)
    name = sheet or next(iter(sheets))
    place_prefix = f"{where}, cell " if where else "cell "
    with map_read_errors(path, "a whole workbook"):
        unread = [
            Cell("", f"{place_prefix}{place}", reason)
            for place, reason in _find_unread_cells(path, name).items()
        ]
    filled_rows = [
        [
            Cell(_format_cell(value), f"{place_prefix}{format_column(column)}{line}")
            for column, value in enumerate(row, start=1)
        ]
        for line, row in enumerate(sheets[name], start=1)
        if any(value != "" for value in row)
    ]
    return [*filled_rows, unread] if unread else filled_rows


def _find_unread_cells(path: Path, name: str) -> dict[str, str]:
    """Find cells that calamine reads as blank: errors, and formulas without a stored value."""
    from openpyxl import load_workbook

    with zipfile.ZipFile(path) as parts:
        texts = [parts.read(part) for part in parts.namelist() if "xl/worksheets/" in part]
    if not any(b"<f" in text or b't="e"' in text for text in texts):
        return {}  # most sheets; openpyxl is slow
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about styles and extensions, which are not read
        formulas, values = (load_workbook(path, data_only=only)[name] for only in (False, True))
    reasons = {
        cell.coordinate: _describe_unread(cell, values[cell.coordinate])
        for row in formulas.iter_rows()
        for cell in row
    }
    return {place: reason for place, reason in reasons.items() if reason}


def _describe_unread(formula: Any, value: Any) -> str:
    """Return why a cell cannot be read, by its formula and stored value; empty if it can."""
    if value.data_type == "e" and value.value is not None:
        return f"the error {value.value}"
    # A formula that returns an empty text is stored as text ("str"): an intended blank.
    if formula.data_type == "f" and value.value is None and value.data_type != "str":
        return "a formula without a stored value"
    return ""


def _format_cell(value: object) -> str:
    """Format the value of a cell; a whole number has no decimal point."""
    if isinstance(value, float) and value.is_integer():
        return str(int(value))
    return str(value).strip()


def read_csv_cells(path: Path) -> list[list[Cell]]:
    """Read all cells of a csv; the separator is stated (``sep=;``) or the most frequent of line 1.

    Raises
    ------
    ReadError
        If it is not UTF-8 text, or its quotes are wrong.
    """
    with map_read_errors(path, "a table as UTF-8 text", remedy="Save it as 'CSV UTF-8'."):
        with path.open(encoding="utf-8-sig", newline="") as stream:
            text = stream.read()
        # csv splits lines; str.splitlines also splits at U+0085 and U+2028
        first = next((line for line in io.StringIO(text, newline="") if line.strip()), "")
        separator = max(_SEPARATORS, key=first.count)
        if match := _NAMED_SEPARATOR.fullmatch(first.rstrip("\r\n")):
            separator = match[1]
            text = text.replace(first, "\n", 1)  # blank, so that line numbers stay correct
        reader = csv.reader(io.StringIO(text, newline=""), delimiter=separator, strict=True)
        return [
            [
                Cell(cell.strip(), f"line {reader.line_num}, column {column}")
                for column, cell in enumerate(row, start=1)
            ]
            for row in reader
        ]


def split_table(cells: list[list[Cell]], path: Path, *, rows_of: str, place: str = "") -> Table:
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
    faults = [
        str(ReadError.about("readers.cell_without_value", path, cell.place, why=cell.unread))
        for row in cells
        for cell in row
        if cell.unread
    ]
    if faults:
        raise ReadError("\n".join(faults))
    filled = [row for row in cells if any(cell.text for cell in row)]
    if len(filled) < 2:
        count = len(filled)
        raise ReadError.about("readers.no_rows", path, place, rows_of=rows_of, count=count)
    width = max(i for i, cell in enumerate(filled[0], start=1) if cell.text)
    return Table(tuple(filled[0][:width]), tuple(_fit_row(row, width, path) for row in filled[1:]))


def _fit_row(row: list[Cell], width: int, path: Path) -> Row:
    """Cut or extend a row to the width of the heading; filled cells beyond it are refused."""
    for cell in row[width:]:
        if cell.text:
            raise ReadError.about("readers.no_heading", path, cell.place, text=cell.text)
    return (*row[:width], *(Cell("", row[0].place) for _ in range(width - len(row))))
