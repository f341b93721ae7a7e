from __future__ import annotations

import math
import re
import zipfile
from pathlib import Path
from typing import Any

import pytest
from openpyxl import load_workbook
from openpyxl.workbook import Workbook

from labpipe.errors import StoreError
from labpipe.report.figure_page import style, style_colours
from labpipe.report.workbook_cells import Shown
from labpipe.report.workbook_file import (
    COLOURS,
    About,
    Chart,
    Line,
    Sheet,
    save_book,
    unique_heads,
)

ABOUT = About("Synthetic & odd", ("How to read it.",), "Synthetic & odd  ·  report 7")


def saved(folder: Path, *sheets: Sheet) -> Workbook:
    save_book(ABOUT, sheets, folder / "book.xlsx", again="do it")
    return load_workbook(folder / "book.xlsx")


def part(folder: Path, name: str) -> str:
    with zipfile.ZipFile(folder / "book.xlsx") as parts:
        return parts.read(name).decode()


def test_a_sheet_is_a_table_with_filters_and_heads_that_stay(tmp_path: Path) -> None:
    sheet = Sheet("one", ("name", "force (N)"), [("a", 1.0), ("b", math.nan)], 1, asks="How hard?")
    book = saved(tmp_path, sheet)
    page = book["one"]
    (table,) = page.tables.values()
    assert (table.ref, table.autoFilter.ref) == ("A1:B3", "A1:B3")
    assert (page.freeze_panes, page["A1"].font.bold) == ("B2", True)
    assert [cell.value for cell in page["B"]] == ["force (N)", 1, None]
    assert book.active is page


def test_the_first_sheet_leads_to_the_others(tmp_path: Path) -> None:
    book = saved(tmp_path, Sheet("a-b", ("x",), [(1,)], asks="What is x?"))
    page = book["read me"]
    assert [page["A1"].value, page["A2"].value] == ["Synthetic & odd", "How to read it."]
    assert (page["A5"].value, page["B5"].value) == ("a-b", "What is x?")
    assert page["A5"].hyperlink.location == "'a-b'!A1"


def test_digits_that_are_seen(tmp_path: Path) -> None:
    rows = [(Shown(52.2841, "0.0"), 12.3456789), (None, 0.1)]
    page = saved(tmp_path, Sheet("one", ("a", "b"), rows))["one"]
    assert (page["A2"].value, page["A2"].number_format) == (52.2841, "0.0")
    assert (page["B2"].value, page["B2"].number_format) == (12.3456789, "0.000")
    assert page["B3"].number_format == "0.000"


def test_printed_landscape_with_heads_and_the_report_at_the_foot(tmp_path: Path) -> None:
    rows = [("x", "y" * 90, 1.0)] * 3
    sheet = Sheet("one", ("a", "b", "c"), rows, wrapped=("b",), printed="b", printed_rows=2)
    page: Any = saved(tmp_path, sheet)["one"]
    assert (page.page_setup.orientation, page.page_setup.fitToHeight) == ("landscape", 0)
    assert page.sheet_properties.pageSetUpPr.fitToPage
    assert page.print_title_rows == "$1:$1"
    assert page.print_area == "'one'!$A$1:$B$3"
    footer = page.oddFooter
    assert footer.left.text.endswith("Synthetic && odd  ·  report 7")
    assert "page" in footer.right.text
    assert page["B2"].alignment.wrap_text
    assert page.row_dimensions[2].height == pytest.approx(45.0)


def test_charts_take_their_numbers_from_cells(tmp_path: Path) -> None:
    rows = [("A", 1.0, 2.0, 0.1, 0.2), ("B", 3.0, 4.0, 0.3, 0.4)]
    lines = Chart("lines", "x (mm)", "y (N)", [Line("A & B", (0, 1), 1, 2)], is_log=True)
    bars = Chart("bars", "", "y (N)", [Line("y", (0, 1), 0, 2, 3, 4)], "bars")
    heads = ("name", "x", "y", "down", "up")
    page: Any = saved(tmp_path, Sheet("one", heads, rows, charts=[lines, bars]))["one"]
    assert len(page._charts) == 2
    first, second = (part(tmp_path, f"xl/charts/chart{n}.xml") for n in (1, 2))
    assert "one!$B$2:$B$3" in first
    assert "<c:logBase" in first
    assert "one!$D$2:$D$3" in second.replace("&apos;", "").replace("'", "")
    assert part(tmp_path, "xl/drawings/drawing1.xml").count("<xdr:row>4</xdr:row>") == 2


def test_charts_of_a_long_table_stand_beside_it_and_are_printed(tmp_path: Path) -> None:
    rows = [(float(number), 2.0) for number in range(200)]
    chart = Chart("lines", "x", "y", [Line("A", (0, 199), 0, 1)])
    page = saved(tmp_path, Sheet("one", ("x", "y"), rows, charts=[chart]))["one"]
    assert page.print_area == "'one'!$D$2:$O$23"


def test_words_of_a_chart_are_no_formulas(tmp_path: Path) -> None:
    rows = [(1.0, 2.0), (2.0, 3.0)]
    chart = Chart("=1+1", "=A1", "=B1", [Line("=1+1", (0, 1), 0, 1)])
    saved(tmp_path, Sheet("one", ("x", "y"), rows, charts=[chart]))
    drawn = part(tmp_path, "xl/charts/chart1.xml")
    assert set(re.findall("<c:f>(.*?)</c:f>", drawn)) == {"one!$A$2:$A$3", "one!$B$2:$B$3"}
    assert drawn.count("=1+1") == 2


def test_heads_are_unique_as_a_table_wants_them() -> None:
    assert unique_heads(["a", "A", "", "a", "x" * 300]) == [
        "a", "A 2", "column", "a 3", "x" * 250,
    ]  # fmt: skip


@pytest.mark.parametrize("name", ["=1+1", "#N/A", "+2", "@SUM(A1)", "a\x07b"])
def test_text_stays_text_also_in_a_link(name: str, tmp_path: Path) -> None:
    rows: list[Any] = [(name, name), ("plain", "x" * 40_000)]
    sheet = Sheet("one", ("to", "b"), rows, links={"plain": "'one'!A1", "none": "'one'!B1"})
    page = saved(tmp_path, sheet)["one"]
    assert (page["A2"].value, page["A2"].data_type) == (name.replace("\x07", "\ufffd"), "s")
    assert page["A2"].hyperlink is None
    assert page["A3"].hyperlink.location == "'one'!A1"
    assert len(page["B3"].value) == 32_767
    assert "<f>" not in part(tmp_path, "xl/worksheets/sheet2.xml")


def test_a_table_without_rows_has_its_heads(tmp_path: Path) -> None:
    page = saved(tmp_path, Sheet("one", ("a", "b"), []))["one"]
    assert [cell.value for cell in page[1]] == ["a", "b"]
    assert not page.tables


def test_the_same_sheets_give_the_same_bytes(tmp_path: Path) -> None:
    sheet = Sheet("one", ("a",), [(1.0,)])
    for name in ("1", "2"):
        save_book(ABOUT, [sheet], tmp_path / name, again="")
    assert (tmp_path / "1").read_bytes() == (tmp_path / "2").read_bytes()


def test_colours_are_those_of_the_figures() -> None:
    with style():
        assert [colour.lstrip("#") for colour in style_colours()] == [
            colour.lstrip("#") for colour in COLOURS
        ]


def test_file_that_cannot_be_written(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match=r"workbook that can be written, found .*and do it again"):
        save_book(ABOUT, [], tmp_path, again="do it")
