from __future__ import annotations

import datetime
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from openpyxl import Workbook

from labpipe.errors import ReadError
from labpipe.readers.campaign_sheet import CampaignSheet, Cell, read_campaign_sheet


def _texts(sheet: CampaignSheet) -> list[list[str]]:
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
    import csv

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
