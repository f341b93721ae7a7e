"""Read cells of workbooks (xlsx, xls) and csv files, and tables with a heading in them.

The library calamine allocates a table from the first to the last cell of a sheet. One stray cell
may therefore need hundreds of gigabytes. An xlsx with cells far apart is refused before parsing.
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
"""Rows of cells of each sheet, keyed by its name."""
_XLSX, _XLS = b"PK\x03\x04", b"\xd0\xcf\x11\xe0"
_MAX_CELLS = 10_000_000
"""Number of cells, filled or not, that any sheet may have; they need about 400 MB."""
_MAX_SPARSITY = 20
"""Number of cells for each filled cell that a larger sheet may have."""
_FILLED_CELL = re.compile(rb'<c r="([A-Z]{1,3})(\d+)"[^>/]*>(?!</c>)')
"""Column and row of a filled cell in the XML of a sheet."""
_PASSWORD_PART = "EncryptedPackage".encode("utf-16-le")
"""Name of a part that only encrypted workbooks have."""
_WHOLE_NUMBER = re.compile(r"(\d)\.0(?=[\t\n])")
_HEAD_ROWS = 60
"""Number of rows in which the header of an export is searched."""
_CSV_SEPARATORS = ",;\t"
_SEPARATOR_LINE = re.compile(r'"?sep=(.)"?', flags=re.IGNORECASE)
"""Pattern of the first line that states the separator, which some programs write."""


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
    Rows of cells of each sheet, keyed by its name, from row 1 and column 1.

    Raises
    ------
    ReadError
        If the file is not a complete workbook, or its cells are far apart.

    Notes
    -----
    Parsing is slow, and recognition and reading parse the same workbook. The last workbook is
    therefore cached until `clear_sheet_cache`.
    """
    status = path.stat()
    sheets = _parse_cached(path, status.st_mtime_ns, status.st_size)
    if isinstance(sheets, ReadError):
        raise sheets
    return sheets


def format_rows(rows: Sequence[Sequence[object]]) -> str:
    """Format rows of a sheet as lines, with tabs between cells and with all digits of numbers."""
    text = io.StringIO()
    writer = csv.writer(text, delimiter="\t", lineterminator="\n")
    for row in rows:  # csv writes all digits of a float
        writer.writerow([x if type(x) is float else " ".join(format_value(x).split()) for x in row])
    return text.getvalue()


def format_head(rows: Sequence[Sequence[object]]) -> str:
    """Format the first rows of a sheet as `format_rows`, but whole numbers without decimals."""
    return _WHOLE_NUMBER.sub(r"\1", format_rows(rows[:_HEAD_ROWS]))


def clear_sheet_cache() -> None:
    """Clear the cached workbook."""
    _parse_cached.cache_clear()


@lru_cache(maxsize=1)
def _parse_cached(path: Path, mtime_ns: int, size: int) -> Sheets | ReadError:  # noqa: ARG001
    """Parse a workbook; the time of change and the size are in the key of the cache.

    An error is returned, so that it is cached too.
    """
    from python_calamine import CalamineWorkbook, PasswordError

    try:
        with map_read_errors(path, "a whole workbook"):
            if read_head(path, 8).startswith(_XLSX):
                _check_archive(path)
            with CalamineWorkbook.from_path(path) as book:
                return {
                    name: book.get_sheet_by_name(name).to_python(skip_empty_area=False)
                    for name in book.sheet_names
                }
    except ReadError as error:
        if isinstance(error.__cause__, PasswordError):
            return ReadError.about("readers.locked_workbook", path)
        return error


def _check_archive(path: Path) -> None:
    """Refuse an archive that is not an xlsx, or has sheets with cells far apart."""
    with zipfile.ZipFile(path) as parts:
        names = parts.namelist()
        if "xl/workbook.bin" in names or not any(name.startswith("xl/") for name in names):
            raise ReadError.about("readers.no_xlsx", path)
        for name in names:
            if name.startswith("xl/worksheets/"):
                _check_sparsity(parts.read(name), path, Path(name).stem)


def _check_sparsity(xml: bytes, path: Path, sheet: str) -> None:
    """Refuse a sheet that has far more cells up to the last filled row and column than filled ones.

    The XML is that of the sheet.
    """
    filled_cells: list[tuple[bytes, bytes]] = _FILLED_CELL.findall(xml)
    if not filled_cells:
        return
    columns = {letters for letters, _ in filled_cells}
    last_column = max(columns, key=lambda letters: (len(letters), letters))
    column = sum((letter - 64) * 26**i for i, letter in enumerate(reversed(last_column)))  # A is 65
    row = max(int(number) for _, number in filled_cells)
    if row * column > max(_MAX_CELLS, _MAX_SPARSITY * len(filled_cells)):
        place = f"{sheet}, cell {format_column(column)}{row}"
        raise ReadError.about("readers.cells_far_apart", path, place, filled=len(filled_cells))


def format_column(number: int) -> str:
    """Format the number of a column, counted from 1, as letters, such as AB for 28."""
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
    text : text without surrounding blanks; dates as 2026-03-04
    place : place of the cell, such as ``cell C4``, or ``line 4, column 3`` in a csv
    fault : reason why the value cannot be read, such as ``the error #DIV/0!``; else empty
    """

    text: str
    place: str
    fault: str = ""


Row: TypeAlias = tuple[Cell, ...]


@dataclass(frozen=True, slots=True)
class Table:
    """A table with a heading.

    Parameters
    ----------
    heading : cells of the first non-blank row
    rows : non-blank rows below it, each as long as the heading
    """

    heading: Row
    rows: tuple[Row, ...]


def read_campaign_sheet(path: Path) -> Table:
    """Read the table of a campaign, which has one row for each test.

    Parameters
    ----------
    path : an xlsx workbook, of which the first sheet is read, or a csv

    Raises
    ------
    ReadError
        If the file is neither of these or is damaged, has no row below the heading, has a filled
        cell to the right of the heading, or has cells that cannot be read.
    """
    cells = read_workbook_cells(path) if is_workbook(path) else read_csv_cells(path)
    return split_table(cells, path, rows_of="one row per test")


def list_sheets(path: Path) -> dict[str, bool]:
    """List the sheets of a workbook.

    Parameters
    ----------
    path : the workbook

    Returns
    -------
    Whether the sheet is visible, keyed by its name.

    Raises
    ------
    ReadError
        If the workbook is damaged.
    """
    from python_calamine import CalamineWorkbook, SheetVisibleEnum

    open_sheets(path)  # raises an error if the workbook cannot be opened safely
    with map_read_errors(path, "a whole workbook"), CalamineWorkbook.from_path(path) as book:
        return {
            sheet.name: sheet.visible == SheetVisibleEnum.Visible for sheet in book.sheets_metadata
        }


def read_workbook_cells(path: Path, sheet: str = "", where: str = "") -> list[list[Cell]]:
    """Read the filled rows of a sheet, and a further row with the cells that cannot be read.

    Parameters
    ----------
    path : the workbook, xlsx
    sheet : name of the sheet; empty for the first one
    where : text before the places of cells in messages

    Raises
    ------
    ReadError
        If the workbook is damaged or an xls.
    """
    sheets = open_sheets(path)
    if not zipfile.is_zipfile(path):
        raise ReadError.about("readers.old_workbook", path)
    name = sheet or next(iter(sheets))
    place_prefix = f"{where}, cell " if where else "cell "
    with map_read_errors(path, "a whole workbook"):
        faults = _find_cell_faults(path, name)
    faulty_cells = [Cell("", f"{place_prefix}{place}", fault) for place, fault in faults.items()]
    filled_rows = [
        [
            Cell(_format_cell(value), f"{place_prefix}{format_column(column)}{line}")
            for column, value in enumerate(row, start=1)
        ]
        for line, row in enumerate(sheets[name], start=1)
        if any(value != "" for value in row)
    ]
    return [*filled_rows, faulty_cells] if faulty_cells else filled_rows


def _find_cell_faults(path: Path, name: str) -> dict[str, str]:
    """Find the faults of cells that calamine reads as blank, keyed by place of the cell."""
    from openpyxl import load_workbook

    with zipfile.ZipFile(path) as parts:
        texts = [parts.read(part) for part in parts.namelist() if "xl/worksheets/" in part]
    if not any(b"<f" in text or b't="e"' in text for text in texts):
        return {}  # most sheets have neither formulas nor errors, and openpyxl is slow
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # openpyxl warns about styles and extensions
        formulas = load_workbook(path, data_only=False)[name]
        values = load_workbook(path, data_only=True)[name]
    cells = (cell for row in formulas.iter_rows() for cell in row)
    faults = {x.coordinate: _describe_fault(x, values[x.coordinate]) for x in cells}
    return {place: fault for place, fault in faults.items() if fault}


def _describe_fault(formula: Any, value: Any) -> str:
    """Describe why a cell cannot be read, from its formula and its stored value; empty if it can.

    Both are cells of openpyxl.
    """
    if value.data_type == "e" and value.value is not None:
        return f"the error {value.value}"
    # A formula that returns an empty text is stored as text ("str"), and is an intended blank.
    if formula.data_type == "f" and value.value is None and value.data_type != "str":
        return "a formula without a stored value"
    return ""


def _format_cell(value: object) -> str:
    """Format the value of a cell as text, a whole number without a decimal point."""
    if isinstance(value, float) and value.is_integer():
        return str(int(value))
    return str(value).strip()


def read_csv_cells(path: Path) -> list[list[Cell]]:
    """Read all cells of a csv.

    The first non-blank line states the separator (``sep=;``), or the separator is the most frequent
    one in that line.

    Parameters
    ----------
    path : the csv

    Raises
    ------
    ReadError
        If the file is not UTF-8 text, or quotes are wrong.
    """
    with map_read_errors(path, "a table as UTF-8 text", remedy="Save it as 'CSV UTF-8'."):
        with path.open(encoding="utf-8-sig", newline="") as stream:
            text = stream.read()
        # The csv module splits lines, since str.splitlines also splits at U+0085 and U+2028.
        first_line = next((line for line in io.StringIO(text, newline="") if line.strip()), "")
        separator = max(_CSV_SEPARATORS, key=first_line.count)
        if match := _SEPARATOR_LINE.fullmatch(first_line.rstrip("\r\n")):
            separator = match[1]
            text = text.replace(first_line, "\n", 1)  # a blank line keeps the line numbers
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
    cells : rows of cells of the whole sheet
    path : path of the file, for errors
    rows_of : meaning of a row, such as ``one row per test``
    place : place of the table in the file, for messages; empty for the whole file

    Raises
    ------
    ReadError
        If there is no row below the heading, a cell to the right of the heading is filled, or cells
        cannot be read. One message lists all cells that cannot be read.
    """
    faults = [
        str(ReadError.about("readers.cell_without_value", path, cell.place, why=cell.fault))
        for row in cells
        for cell in row
        if cell.fault
    ]
    if faults:
        raise ReadError("\n".join(faults))
    filled_rows = [row for row in cells if any(cell.text for cell in row)]
    if (count := len(filled_rows)) < 2:
        raise ReadError.about("readers.no_rows", path, place, rows_of=rows_of, count=count)
    heading, *rows = filled_rows
    width = max(i for i, cell in enumerate(heading, start=1) if cell.text)
    if extra_cell := next((cell for row in rows for cell in row[width:] if cell.text), None):
        raise ReadError.about("readers.no_heading", path, extra_cell.place, text=extra_cell.text)
    padded_rows = (row + [Cell("", row[0].place)] * (width - len(row)) for row in rows)
    return Table(tuple(heading[:width]), tuple(tuple(row[:width]) for row in padded_rows))
