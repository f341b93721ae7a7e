"""The report's workbook: its sheets, and the file as spreadsheet programs want it."""

from __future__ import annotations

import math
import re
import zipfile
from collections.abc import Iterator
from dataclasses import replace
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from openpyxl import load_workbook
from openpyxl.workbook import Workbook

from labpipe.errors import StoreError
from labpipe.records.curve import Interval
from labpipe.records.group import BundlePlace, Campaign
from labpipe.records.quality import Reason
from labpipe.records.result import Contribution
from labpipe.report.page_facts import report_id
from labpipe.report.wording import shown_in
from labpipe.report.workbook_cells import Shown
from labpipe.report.workbook_file import About, Chart, Line, Sheet, save_book, unique_heads
from labpipe.statistics.groups import build_group as grouped
from tests.approved import Approve
from tests.builders.bundle_campaigns import bundle_campaign, conduit_cases
from tests.builders.campaigns import build_campaign, build_group, six_samples
from tests.builders.report_pages import saved, table


@pytest.fixture(scope="module")
def book(tmp_path_factory: pytest.TempPathFactory) -> Workbook:
    return saved(build_campaign(), tmp_path_factory.mktemp("book"))


def test_one_sheet_for_each_question(book: Workbook) -> None:
    assert book.sheetnames == [
        "read me", "key numbers", "means", "tests", "results", "curves", "scaled curves",
        "comparisons", "needs a look",
    ]  # fmt: skip
    for sheet in book.worksheets[1:]:
        assert sheet.freeze_panes in {"B2", "C2"}
        assert len(sheet.tables) == 1
        assert sheet.page_setup.orientation == "landscape"
    listed = [cell.value for cell in book["read me"]["A"]]
    assert listed[-8:] == book.sheetnames[1:]


def test_day_operator_and_decision_of_tests_and_rejected_ones_last(tmp_path: Path) -> None:
    first, second, *_ = six_samples()
    known = replace(first, date=date(2026, 3, 2), operator="A. Lab", run="k1")
    rejected = replace(second, decided="rejected: grip slid (by A. Lab, 2026-03-03)")
    campaign = Campaign(
        "Synthetic",
        (build_group("A", [known]),),
        rejected={"f": "grip slid"},
        rejected_samples=(rejected,),
    )
    book = saved(campaign, tmp_path)
    one, other = table(book, "tests")
    assert (one["day"], one["operator"], one["key of the run"]) == ("2026-03-02", "A. Lab", "k1")
    assert (other["state"], other["group"], other["day"]) == ("rejected", None, None)
    assert other["decision"] == "rejected: grip slid (by A. Lab, 2026-03-03)"
    said = [cell.value for cell in book["read me"]["A"][:4]]
    assert said[1] == "1 test in 1 group, 1 test rejected."
    assert said[2] == "Tested 2026-03-02; A. Lab."
    page: Any = book["tests"]
    assert f"report {report_id(campaign)}" in page.oddFooter.left.text


def test_budgets_of_tests_and_of_groups(tmp_path: Path) -> None:
    """Noise and scale alike: half each; three tests on one rig are all too strong by 0.3 %."""
    samples = [
        replace(
            sample,
            results=tuple(
                replace(result, budget=_budget(result.value))
                for result in sample.results
                if result.value
            ),
        )
        for sample in six_samples()[:3]
    ]
    group = grouped("tube", "twist-tube", samples)
    campaign = Campaign("Synthetic", (group,))
    book = saved(campaign, tmp_path)
    rows = table(book, "budgets")
    name = group.numbers[0].name
    mean, *_ = rows
    number = group.numbers[0].mean
    assert number is not None
    assert number.chosen.interval is not None
    scale = shown_in(name, group.numbers[0].unit, samples[0].display)
    half = 0.5 * (number.chosen.interval.upper - number.chosen.interval.lower)
    assert mean["of"] == "mean of the group"
    assert mean["half of the 95 % interval"] == pytest.approx(scale.factor * half)
    assert mean["noise (%)"] is None
    parts = mean["scatter of the tests (%)"], mean["scale of the force* (%)"]
    assert sum(parts) == pytest.approx(1.0)
    assert 0.0 < parts[1] < parts[0]
    median, test = [row for row in rows if row["number"] == mean["number"]][1:3]
    assert (median["of"], test["of"]) == ("median of the tests", samples[0].test)
    assert test["scale of the force* (%)"] == pytest.approx(0.5)
    assert median["noise (%)"] == pytest.approx(0.5)


def _budget(value: float) -> tuple[Contribution, ...]:
    size = 0.003 * value
    scale = Contribution("scale of the force", size, is_common=True)
    return Contribution("noise", size), scale


ABOUT = About("Synthetic & odd", ("How to read it.",), "Synthetic & odd  ·  report 7")


def saved_sheets(folder: Path, *sheets: Sheet) -> Workbook:
    save_book(ABOUT, sheets, folder / "book.xlsx", again="do it")
    return load_workbook(folder / "book.xlsx")


def part(folder: Path, name: str) -> str:
    with zipfile.ZipFile(folder / "book.xlsx") as parts:
        return parts.read(name).decode()


def test_a_sheet_is_a_table_with_filters_and_heads_that_stay(tmp_path: Path) -> None:
    sheet = Sheet("one", ("name", "force (N)"), [("a", 1.0), ("b", math.nan)], 1, asks="How hard?")
    book = saved_sheets(tmp_path, sheet)
    page = book["one"]
    (table,) = page.tables.values()
    assert (table.ref, table.autoFilter.ref) == ("A1:B3", "A1:B3")
    assert (page.freeze_panes, page["A1"].font.bold) == ("B2", True)
    assert [cell.value for cell in page["B"]] == ["force (N)", 1, None]
    assert book.active is page


def test_digits_that_are_seen(tmp_path: Path) -> None:
    rows = [(Shown(52.2841, "0.0"), 12.3456789), (None, 0.1)]
    page = saved_sheets(tmp_path, Sheet("one", ("a", "b"), rows))["one"]
    assert (page["A2"].value, page["A2"].number_format) == (52.2841, "0.0")
    assert (page["B2"].value, page["B2"].number_format) == (12.3456789, "0.000")
    assert page["B3"].number_format == "0.000"


def test_charts_take_their_numbers_from_cells(tmp_path: Path) -> None:
    rows = [("A", 1.0, 2.0, 0.1, 0.2), ("B", 3.0, 4.0, 0.3, 0.4)]
    lines = Chart("lines", "x (mm)", "y (N)", [Line("A & B", (0, 1), 1, 2)], is_log=True)
    bars = Chart("bars", "", "y (N)", [Line("y", (0, 1), 0, 2, 3, 4)], "bars")
    heads = ("name", "x", "y", "down", "up")
    page: Any = saved_sheets(tmp_path, Sheet("one", heads, rows, charts=[lines, bars]))["one"]
    assert len(page._charts) == 2
    first, second = (part(tmp_path, f"xl/charts/chart{n}.xml") for n in (1, 2))
    assert "one!$B$2:$B$3" in first
    assert "<c:logBase" in first
    assert "one!$D$2:$D$3" in second.replace("&apos;", "").replace("'", "")
    assert part(tmp_path, "xl/drawings/drawing1.xml").count("<xdr:row>4</xdr:row>") == 2


def test_words_of_a_chart_are_no_formulas(tmp_path: Path) -> None:
    rows = [(1.0, 2.0), (2.0, 3.0)]
    chart = Chart("=1+1", "=A1", "=B1", [Line("=1+1", (0, 1), 0, 1)])
    saved_sheets(tmp_path, Sheet("one", ("x", "y"), rows, charts=[chart]))
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
    page = saved_sheets(tmp_path, sheet)["one"]
    assert (page["A2"].value, page["A2"].data_type) == (name.replace("\x07", "\ufffd"), "s")
    assert page["A2"].hyperlink is None
    assert page["A3"].hyperlink.location == "'one'!A1"
    assert len(page["B3"].value) == 32_767
    assert "<f>" not in part(tmp_path, "xl/worksheets/sheet2.xml")


def test_a_table_without_rows_has_its_heads(tmp_path: Path) -> None:
    page = saved_sheets(tmp_path, Sheet("one", ("a", "b"), []))["one"]
    assert [cell.value for cell in page[1]] == ["a", "b"]
    assert not page.tables


def test_the_same_sheets_give_the_same_bytes(tmp_path: Path) -> None:
    sheet = Sheet("one", ("a",), [(1.0,)])
    for name in ("1", "2"):
        save_book(ABOUT, [sheet], tmp_path / name, again="")
    assert (tmp_path / "1").read_bytes() == (tmp_path / "2").read_bytes()


def test_file_that_cannot_be_written(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match=r"workbook that can be written, found .*and do it again"):
        save_book(ABOUT, [], tmp_path, again="do it")


def sheet_words(book: Workbook, name: str, most: int = 12) -> Iterator[str]:
    """The first rows of a sheet, numbers to four digits."""
    yield f"[{name}]"
    for row in book[name].iter_rows(values_only=True, max_row=most):
        values = (f"{cell:.4g}" if isinstance(cell, float) else cell for cell in row)
        yield " | ".join("" if value is None else str(value) for value in values)


def test_rows_of_sheets(book: Workbook, tmp_path: Path, approved: Approve) -> None:
    names = ["key numbers", "means", "tests", "results", "comparisons", "needs a look", "curves"]
    bundles = bundle_campaign(conduit_cases())
    name, ends = bundles.groups[0].name, Interval(0.0058, 0.0062)
    place = BundlePlace(name, "", 0.006, ends, 0.0015, 0.0045, 0.15, (0.15, 0.16), 0.03)
    lacking = BundlePlace(name, "t-1", None, None, reasons=(Reason("no_model", "no bounds: why"),))
    other = saved(replace(bundles, places=(place, lacking)), tmp_path)
    approved([
        *(line for name in names for line in sheet_words(book, name)),
        *sheet_words(other, "comparisons"), *sheet_words(other, "slipping and sticking"),
    ])  # fmt: skip
    rows = table(other, "comparisons")
    assert len(rows) == 28 * 2
    assert sum(row["question"] is None for row in rows) == 18 * 2
    first = build_campaign().groups[0]
    result, number = first.samples[0].results[1], first.numbers[1].mean
    assert result.value is not None
    assert number is not None
    head = "Stiffness, first region (N/mm)"
    assert table(book, "tests")[0][head] == pytest.approx(1e-3 * result.value)
    assert table(book, "key numbers")[0][head] == pytest.approx(1e-3 * number.chosen.mean)
    curve = [row for row in table(book, "curves") if row["group"] == "twist-tube-10"]
    np.testing.assert_allclose([row["mean (N)"] for row in curve], first.band.mean)
    charts: Any = book["key numbers"]
    assert charts._charts
