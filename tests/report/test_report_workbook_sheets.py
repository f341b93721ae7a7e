from __future__ import annotations

import math
from pathlib import Path

import pytest
from openpyxl import load_workbook

from labpipe.errors import StoreError
from labpipe.report.report_workbook import Sheet, save_sheets, sheet_name


def test_names_of_sheets() -> None:
    assert sheet_name("curve " + "x" * 40, []) == "curve " + "x" * 25
    long = sheet_name("curve " + "x" * 40, ["curve " + "X" * 25])
    assert (len(long), long[-2:]) == (31, " 2")
    assert sheet_name("a[b]:c*d?e'f", []) == "a-b--c-d-e-f"
    assert sheet_name("   ", []) == "sheet"
    assert sheet_name("a\x07\ufffe", []) == "a\ufffd\ufffd"
    assert sheet_name(20 * "\U0001f600", []) == 15 * "\U0001f600"  # two units of UTF-16 each


@pytest.mark.parametrize("name", ["History", "history"])
def test_a_name_that_excel_keeps_for_itself(name: str) -> None:
    assert sheet_name(name, []) == f"{name} 2"
    assert sheet_name("History of A2", []) == "History of A2"


def test_links_widths_and_empty_cells(tmp_path: Path) -> None:
    path = tmp_path / "book.xlsx"
    first = Sheet("one", ("to", "a long heading"), [("=1+1", math.nan), ("x", 2)], "B2", {"x": "b"})
    save_sheets([first, Sheet("b", ("c",), [("d" * 90,)])], path, again="do it", active=1)
    book = load_workbook(path)
    one, other = book.worksheets
    assert book.active is other
    assert [cell.value for cell in one["B"]] == ["a long heading", None, 2]
    assert (one["A2"].data_type, one["A2"].hyperlink) == ("s", None)
    assert one["A3"].hyperlink.location == "'b'!A1"
    assert one.freeze_panes == "B2"
    assert [one.column_dimensions[each].width for each in "AB"] == [13, 13]
    assert other.column_dimensions["A"].width == 60


def test_file_that_cannot_be_written(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match=r"workbook that can be written, found .*and do it again"):
        save_sheets([], tmp_path, again="do it")
