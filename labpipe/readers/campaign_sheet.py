"""Reads the table of a campaign: one row per test, as people keep it in a spreadsheet.

Writes this file: a person, with a spreadsheet program (xlsx, its first sheet) or a text editor (csv
parted by comma, semicolon or tab). Every cell is text here, with its place for messages; what the
columns mean is not known here.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from labpipe.errors import ReadError, complaint
from labpipe.readers.files import read_head, reading

_SEPARATORS = ",;\t"


@dataclass(frozen=True, slots=True)
class Cell:
    """One cell.

    Parameters
    ----------
    text : as shown, without blanks around it; dates as 2026-03-04
    place : such as ``cell C4``, or ``line 4, column 3`` in a csv
    """

    text: str
    place: str


@dataclass(frozen=True, slots=True)
class CampaignSheet:
    """A table with a heading.

    Parameters
    ----------
    heading : the cells of the first row that is not blank
    rows : those below it, blank ones left out, each as long as the heading
    """

    heading: tuple[Cell, ...]
    rows: tuple[tuple[Cell, ...], ...]


def read_campaign_sheet(path: Path) -> CampaignSheet:
    """Read the table of a campaign.

    Parameters
    ----------
    path : an xlsx workbook, or a csv

    Returns
    -------
    The table.

    Raises
    ------
    ReadError
        If the file is neither, is damaged, holds no row below a heading, or has cells beyond it.
    """
    is_workbook = read_head(path).startswith(b"PK\x03\x04")
    cells = _workbook_cells(path) if is_workbook else _csv_cells(path)
    filled = [row for row in cells if any(cell.text for cell in row)]
    if len(filled) < 2:
        expected, remedy = "a heading and one row per test", "Fill in the table."
        found = f"{len(filled)} rows"
        raise ReadError(complaint(path, "", expected=expected, found=found, remedy=remedy))
    heading = _without_tail(filled[0])
    return CampaignSheet(heading, tuple(_fitted(row, len(heading), path) for row in filled[1:]))


def _workbook_cells(path: Path) -> list[list[Cell]]:
    from openpyxl.utils import get_column_letter
    from python_calamine import CalamineError, CalamineWorkbook

    with reading(path, "an xlsx workbook", also=(CalamineError,)):
        rows = (
            CalamineWorkbook.from_path(str(path))
            .get_sheet_by_index(0)
            .to_python(skip_empty_area=False)
        )
    return [
        [
            Cell(_shown(value), f"cell {get_column_letter(column)}{line}")
            for column, value in enumerate(row, start=1)
        ]
        for line, row in enumerate(rows, start=1)
    ]


def _csv_cells(path: Path) -> list[list[Cell]]:
    with reading(path, "a table as UTF-8 text", remedy="Save it as 'CSV UTF-8'."):
        text = path.read_text(encoding="utf-8-sig")
        first = next((line for line in text.splitlines() if line.strip()), "")
        separator = max(_SEPARATORS, key=first.count)
        reader = csv.reader(text.splitlines(keepends=True), delimiter=separator, strict=True)
        return [_csv_row(row, reader.line_num) for row in reader]


def _csv_row(row: Iterable[str], line: int) -> list[Cell]:
    return [
        Cell(text.strip(), f"line {line}, column {column}")
        for column, text in enumerate(row, start=1)
    ]


def _shown(value: object) -> str:
    """Write the value of a cell as a person sees it: 1 for 1.0."""
    if isinstance(value, float) and value.is_integer():
        return str(int(value))
    return str(value).strip()


def _without_tail(row: list[Cell]) -> tuple[Cell, ...]:
    filled = [number for number, cell in enumerate(row) if cell.text]
    return tuple(row[: filled[-1] + 1])


def _fitted(row: list[Cell], width: int, path: Path) -> tuple[Cell, ...]:
    """Bring a row to the length of the heading."""
    for cell in row[width:]:
        if cell.text:
            expected, found = "a cell below a heading", f"'{cell.text}'"
            remedy = "Give its column a name in the first row, or empty the cell."
            text = complaint(path, cell.place, expected=expected, found=found, remedy=remedy)
            raise ReadError(text)
    return (*row[:width], *(Cell("", row[0].place) for _ in range(width - len(row))))
