from __future__ import annotations

import csv
import datetime
import re
import zipfile
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from openpyxl import Workbook

from labpipe.errors import ReadError
from labpipe.readers.sheet_cells import (
    Cell,
    Table,
    as_table,
    csv_cells,
    read_campaign_sheet,
    sheets_of,
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
    assert sheets_of(book) == {"notes": True, "wires": True}
    assert workbook_cells(book) == [[Cell("a note", "cell A1")]]
    first, second = workbook_cells(book, "wires", "sheet 'wires'")[1]
    assert (first, second.text) == (Cell("A1", "sheet 'wires', cell A2"), "7")


def test_a_damaged_workbook_is_told_by_each_question(book: Path) -> None:
    book.write_bytes(book.read_bytes()[:900])
    with pytest.raises(ReadError, match=r"expected an xlsx workbook, found a damaged one"):
        sheets_of(book)
    with pytest.raises(ReadError, match=r"expected an xlsx workbook, found a damaged one"):
        workbook_cells(book)


def test_a_short_row_is_filled_up_and_a_long_one_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("a,b,\n1\n", encoding="utf-8")
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


def _table_of(path: Path) -> None:
    as_table(workbook_cells(path), path, rows_of="one row per wire")


def test_errors_and_formulas_without_a_value_are_no_blanks(tmp_path: Path) -> None:
    pages, path = Workbook(), tmp_path / "a.xlsx"
    page = pages.active
    assert page is not None
    page.append(["wire", "length_mm", "poisson"])
    page.append(["A1", "=80+5", None])
    page.append(["A2", 85, "#DIV/0!"])
    page["C3"].data_type = "e"
    pages.save(path)
    with pytest.raises(ReadError) as info:
        _table_of(path)
    assert str(info.value).split("\n") == [
        f"{path}, cell B2: expected a value, found a formula without a stored value."
        " Open the workbook in the spreadsheet program and save it.",
        f"{path}, cell C3: expected a value, found the error #DIV/0!. Correct the cell.",
    ]


@pytest.mark.parametrize(
    ("stored", "found"),
    [
        (b't="str"><f>80+5</f><v></v>', ""),  # an empty text on purpose
        (b"><f>80+5</f><v>85</v>", ""),
        (b't="e"><f>80+5</f><v>#N/A</v>', "the error #N/A"),
    ],
)
def test_formulas_with_a_stored_value(tmp_path: Path, stored: bytes, found: str) -> None:
    pages, path = Workbook(), tmp_path / "a.xlsx"
    page = pages.active
    assert page is not None
    page.append(["wire", "=80+5"])
    pages.save(path)
    _store(path, stored)
    unread = [cell.unread for row in workbook_cells(path) for cell in row if cell.unread]
    assert unread == ([found] if found else [])


def _store(path: Path, stored: bytes) -> None:
    """Write a stored value into the cell B1 of a workbook."""
    with zipfile.ZipFile(path) as parts:
        texts = {name: parts.read(name) for name in parts.namelist()}
    sheet = "xl/worksheets/sheet1.xml"
    texts[sheet], count = re.subn(
        rb'(<c r="B1")[^>]*><f>80\+5</f><v\s*(?:/>|></v>)', rb"\1 " + stored, texts[sheet]
    )
    assert count == 1
    with zipfile.ZipFile(path, "w") as parts:
        for name, text in texts.items():
            parts.writestr(name, text)


def test_a_csv_may_name_its_separator(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("sep=;\na;b\n1;2,3,4\n", encoding="utf-8")
    rows = csv_cells(path)
    assert rows[1:] == [
        [Cell("a", "line 2, column 1"), Cell("b", "line 2, column 2")],
        [Cell("1", "line 3, column 1"), Cell("2,3,4", "line 3, column 2")],
    ]
    assert not rows[0]


@pytest.mark.parametrize("odd", ["\x85", "\u2028", "\x0b"])
def test_a_csv_is_parted_at_line_ends_only(tmp_path: Path, odd: str) -> None:
    path = tmp_path / "a.csv"
    path.write_text(f"a,b\r\n1,x{odd}y\r\n", encoding="utf-8", newline="")
    assert csv_cells(path)[1][1] == Cell(f"x{odd}y", "line 2, column 2")


def test_a_list_that_was_not_quoted(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("a;b\n1;12;-15\n", encoding="utf-8")
    with pytest.raises(ReadError) as info:
        as_table(csv_cells(path), path, rows_of="one row per wire")
    assert str(info.value) == (
        f"{path}, line 2, column 3: expected a cell below a heading, found '-15'."
        " Give its column a name in the first row, or empty the cell."
        ' Put a list in quotes, "12;-15", and write a decimal point, no comma.'
    )


def _texts(sheet: Table) -> list[list[str]]:
    return [[cell.text for cell in row] for row in (sheet.heading, *sheet.rows)]


def _workbook(path: Path, rows: list[list[object]]) -> Path:
    book = Workbook()
    page = book.active
    assert page is not None
    for row in rows:
        page.append(row)
    book.save(path)
    return path


def test_a_workbook_as_a_person_sees_it(tmp_path: Path) -> None:
    path = _workbook(
        tmp_path / "a.xlsx",
        [
            [],
            ["test", "sample", "date", "length (mm)", None],
            ["A 1 ", 1, datetime.datetime(2026, 3, 4), 85.5, None],
            [],
            ["A2", "01", datetime.datetime(2026, 3, 4, 9, 58), None, None],
        ],
    )

    sheet = read_campaign_sheet(path)

    assert _texts(sheet) == [
        ["test", "sample", "date", "length (mm)"],
        ["A 1", "1", "2026-03-04", "85.5"],
        ["A2", "01", "2026-03-04 09:58:00", ""],
    ]
    assert sheet.heading[1] == Cell("sample", "cell B2")
    assert sheet.rows[1][1].place == "cell B5"


@pytest.mark.parametrize("separator", [",", ";", "\t"])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig"])
def test_a_csv_however_it_is_parted(tmp_path: Path, separator: str, encoding: str) -> None:
    path = tmp_path / "a.csv"
    text = '\ntest|sample|because\nÄ1|01|"two\nlines"\n||\nA2|1||\n'.replace("|", separator)
    path.write_text(text, encoding=encoding)

    sheet = read_campaign_sheet(path)

    assert _texts(sheet) == [
        ["test", "sample", "because"],
        ["Ä1", "01", "two\nlines"],
        ["A2", "1", ""],
    ]
    assert sheet.rows[1][0] == Cell("A2", "line 6, column 1")


@given(st.lists(st.text(alphabet="ab;, \"'1", min_size=1, max_size=8), min_size=2, max_size=4))
def test_a_csv_of_any_text_reads_back(
    tmp_path_factory: pytest.TempPathFactory, words: list[str]
) -> None:
    words = [f"x{word}" for word in words]
    path = tmp_path_factory.mktemp("csv") / "a.csv"
    with path.open("w", encoding="utf-8", newline="") as stream:
        csv.writer(stream).writerows([["h"] * len(words), words])

    assert _texts(read_campaign_sheet(path))[1] == [word.strip() for word in words]


def _refused(path: Path) -> str:
    with pytest.raises(ReadError) as info:
        read_campaign_sheet(path)
    return str(info.value)


def test_a_cell_beyond_the_heading(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("test,sample\nA1,1,stray\n", encoding="utf-8")

    assert _refused(path) == (
        f"{path}, line 2, column 3: expected a cell below a heading, found 'stray'."
        " Give its column a name in the first row, or empty the cell."
    )


@pytest.mark.parametrize(("text", "rows"), [("test,sample\n", 1), (",\n\n", 0)])
def test_a_table_without_tests(tmp_path: Path, text: str, rows: int) -> None:
    path = tmp_path / "a.csv"
    path.write_text(text, encoding="utf-8")

    assert _refused(path) == (
        f"{path}: expected a heading and one row per test, found {rows} rows. Fill in the table."
    )


def test_a_damaged_workbook(tmp_path: Path) -> None:
    path = _workbook(tmp_path / "a.xlsx", [["test"], ["A1"]])
    path.write_bytes(path.read_bytes()[:2000])

    assert _refused(path).startswith(f"{path}: expected an xlsx workbook, found a damaged one (")


def test_a_csv_in_another_encoding(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_bytes("test;type\nÄ;A\n".encode("cp1252"))

    message = _refused(path)
    assert message.startswith(f"{path}: expected a table as UTF-8 text, found a damaged one (")
    assert message.endswith("Save it as 'CSV UTF-8'.")


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    assert "found none of that name" in _refused(tmp_path / "a.csv")
