from __future__ import annotations

from pathlib import Path

import pytest
from openpyxl import Workbook

from labpipe.errors import ReadError
from labpipe.readers.sheet_cells import (
    Cell,
    as_table,
    csv_cells,
    is_workbook,
    sheet_names,
    workbook_cells,
)


@pytest.fixture
def book(tmp_path: Path) -> Path:
    pages = Workbook()
    first = pages.active
    assert first is not None
    first.title = "notes"
    first.append(["a note"])
    second = pages.create_sheet("wires")
    second.append(["wire", "strands"])
    second.append(["A1", 7])
    pages.save(tmp_path / "a.xlsx")
    return tmp_path / "a.xlsx"


def test_sheets_by_number_and_by_name(book: Path) -> None:
    assert is_workbook(book)
    assert sheet_names(book) == ["notes", "wires"]
    assert workbook_cells(book) == [[Cell("a note", "cell A1")]]
    assert workbook_cells(book, "wires")[1] == [Cell("A1", "cell A2"), Cell("7", "cell B2")]


def test_a_damaged_workbook_is_told_by_each_question(book: Path) -> None:
    book.write_bytes(book.read_bytes()[:900])
    with pytest.raises(ReadError, match=r"expected an xlsx workbook, found a damaged one"):
        sheet_names(book)
    with pytest.raises(ReadError, match=r"expected an xlsx workbook, found a damaged one"):
        workbook_cells(book)


def test_a_short_row_is_filled_up_and_a_long_one_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("a,b,\n1\n", encoding="utf-8")
    assert not is_workbook(path)
    table = as_table(csv_cells(path), path, rows_of="one row per wire")
    assert [cell.text for cell in table.rows[0]] == ["1", ""]
    path.write_text("a,b\n1,2,3\n", encoding="utf-8")
    with pytest.raises(ReadError, match=r"line 2, column 3: expected a cell below a heading"):
        as_table(csv_cells(path), path, rows_of="one row per wire")


def test_a_table_without_rows_is_told_with_its_place(tmp_path: Path) -> None:
    with pytest.raises(ReadError) as info:
        as_table([], tmp_path / "a", rows_of="one row per wire", place="sheet 'wires'")
    assert str(info.value) == (
        f"{tmp_path / 'a'}, sheet 'wires': expected a heading and one row per wire, found 0 rows."
        " Fill in the table."
    )
