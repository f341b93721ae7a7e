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
from labpipe.records.group import BoundedStiffness, Campaign
from labpipe.records.quality import Reason
from labpipe.records.result import Contribution, Result
from labpipe.report.page_tables import compute_report_id
from labpipe.report.report_workbook import save_workbook
from labpipe.report.table_records import (
    Cell,
    Chart,
    NumberCell,
    Table,
    make_unique_headings,
    save_tables,
)
from labpipe.report.wording import choose_unit
from labpipe.statistics.groups import build_group as grouped
from tests.approved import Approve
from tests.builders.bundle_campaigns import bundle_campaign, conduit_cases
from tests.builders.campaigns import build_campaign, build_group, six_samples


def saved(campaign: Campaign, folder: Path) -> Workbook:
    """The workbook of a campaign, written to a folder and read."""
    save_workbook(campaign, folder / "tables.xlsx")
    return load_workbook(folder / "tables.xlsx")


def table(book: Workbook, name: str) -> list[dict[str, Any]]:
    """Rows of a sheet by its heads."""
    heads, *rows = book[name].iter_rows(values_only=True)
    return [dict(zip(map(str, heads), row, strict=True)) for row in rows]


def test_day_operator_and_decision_of_tests_and_rejected_ones_last(tmp_path: Path) -> None:
    first, second, *_ = six_samples()
    first = replace(first, date=date(2026, 3, 2), operator="A. Lab", run="k1")
    second = replace(second, decision="rejected: grip slid (by A. Lab, 2026-03-03)")
    campaign = Campaign("S", (build_group("A", [first]),), rejected={"f": "grip slid"})
    campaign = replace(campaign, rejected_samples=(second,))
    book = saved(campaign, tmp_path)
    row, last_row = table(book, "tests")
    assert (row["day"], row["operator"], row["key of the run"]) == ("2026-03-02", "A. Lab", "k1")
    assert (last_row["state"], last_row["group"], last_row["day"]) == ("rejected", None, None)
    assert last_row["decision"] == second.decision
    lines = [cell.value for cell in book["read me"]["A"]]
    assert lines[1:3] == ["1 test in 1 group, 1 test rejected.", "Tested 2026-03-02 by A. Lab."]
    page: Any = book["tests"]
    assert f"report {compute_report_id(campaign)}" in page.oddFooter.left.text


def with_budget(result: Result) -> Result:
    """Noise and scale alike."""
    size = 0.003 * (result.value or 0.0)
    scale = Contribution("scale of the force", size, is_common=True)
    return replace(result, budget=(Contribution("noise", size), scale))


def test_budgets_of_tests_and_of_groups(tmp_path: Path) -> None:
    """Half each for a test; three tests on one rig are all too strong by 0.3 %."""
    samples = [
        replace(sample, results=tuple(map(with_budget, sample.results)))
        for sample in six_samples()[:3]
    ]
    group = grouped("tube", "twist-tube", samples)
    rows = table(saved(Campaign("Synthetic", (group,)), tmp_path), "budgets")
    number = group.numbers[0]
    assert number.mean is not None
    assert number.mean.chosen.interval is not None
    scale = choose_unit(number.name, number.unit, samples[0].display)
    half = 0.5 * (number.mean.chosen.interval.upper - number.mean.chosen.interval.lower)
    mean, median = [row for row in rows if row["number"] == rows[0]["number"]]
    assert (mean["of"], median["of"]) == ("mean of the group", "median of the tests")
    assert mean["half of the 95 % interval"] == pytest.approx(scale.factor * half)
    assert mean["noise (%)"] is None
    parts = mean["scatter of the tests (%)"], mean["scale of the force* (%)"]
    assert sum(parts) == pytest.approx(1.0)
    assert 0.0 < parts[1] < parts[0]
    assert median["scale of the force* (%)"] == median["noise (%)"] == pytest.approx(0.5)


def save(path: Path, *tables: Table) -> None:
    title = "Synthetic & odd"
    save_tables(tables, path, book="report", title=title, footer=f"{title}  ·  report 7")


def saved_tables(folder: Path, *tables: Table) -> Workbook:
    save(folder / "book.xlsx", *tables)
    return load_workbook(folder / "book.xlsx")


def part(folder: Path, name: str) -> str:
    with zipfile.ZipFile(folder / "book.xlsx") as parts:
        return parts.read(name).decode()


def test_a_sheet_is_a_table_with_filters_and_heads_that_stay(tmp_path: Path) -> None:
    rows: list[Any] = [(NumberCell(52.2841, "0.0"), 12.3456789), ("b", math.nan), (None, 0.1)]
    sheet = Table("tests", ("name", "force (N)"), rows)
    book = saved_tables(tmp_path, sheet, Table("bare", ("a", "A"), []))
    page, bare = book["tests"], book["bare"]
    (filtered,) = page.tables.values()
    assert (filtered.ref, filtered.autoFilter.ref) == ("A1:B4", "A1:B4")
    assert (page.freeze_panes, page["A1"].font.bold) == ("B2", True)
    assert [cell.value for cell in page["B"]] == ["force (N)", 12.3456789, None, 0.1]
    assert (page["A2"].value, page["A2"].number_format) == (52.2841, "0.0")
    assert page["B2"].number_format == page["B4"].number_format == "0.000"
    assert book.active is page
    assert [cell.value for cell in bare[1]] == ["a", "A 2"]
    assert not bare.tables
    heads = make_unique_headings(["a", "A", "", "a", "x" * 300])
    assert heads == ["a", "A 2", "column", "a 3", "x" * 250]


def test_charts_take_their_numbers_from_cells(tmp_path: Path) -> None:
    """Words of a chart are no formulas."""
    rows = [("A", 1.0, 2.0), ("B", 3.0, 4.0)]
    chart = Chart("=1+1", "=A1", "=B1", {"=1+1": (0, 1)}, is_log=True)
    saved_tables(tmp_path, Table("one", ("name", "=A1", "=B1"), rows, charts=[chart, chart]))
    first = part(tmp_path, "xl/charts/chart1.xml")
    assert set(re.findall("<c:f>(.*?)</c:f>", first)) == {"one!$B$2:$B$3", "one!$C$2:$C$3"}
    assert first.count("=1+1") == 2
    assert "<c:logBase" in first
    assert part(tmp_path, "xl/drawings/drawing1.xml").count("<xdr:row>4</xdr:row>") == 2


@pytest.mark.parametrize("name", ["=1+1", "#N/A", "+2", "@SUM(A1)", "a\x07b"])
def test_text_stays_text_also_in_a_link(name: str, tmp_path: Path) -> None:
    rows: list[Any] = [(name, name), (Cell("plain", link="'one'!A1"), "x" * 40_000)]
    page = saved_tables(tmp_path, Table("one", ("to", "b"), rows))["one"]
    assert (page["A2"].value, page["A2"].data_type) == (name.replace("\x07", "\ufffd"), "s")
    assert page["A2"].hyperlink is None
    assert page["A3"].hyperlink.location == "'one'!A1"
    assert len(page["B3"].value) == 32_767
    assert "<f>" not in part(tmp_path, "xl/worksheets/sheet2.xml")


def test_the_same_sheets_give_the_same_bytes_or_a_refusal(tmp_path: Path) -> None:
    for name in ("1", "2"):
        save(tmp_path / name, Table("one", ("a",), [(1.0,)]))
    assert (tmp_path / "1").read_bytes() == (tmp_path / "2").read_bytes()
    with pytest.raises(StoreError, match="free space and permission to write a workbook, found"):
        save(tmp_path)


def sheet_words(book: Workbook, name: str, max_row: int = 12) -> Iterator[str]:
    """The first rows of a sheet, numbers to four digits."""
    yield f"[{name}]"
    for row in book[name].iter_rows(values_only=True, max_row=max_row):
        values = (f"{cell:.4g}" if isinstance(cell, float) else cell for cell in row)
        yield " | ".join("" if value is None else str(value) for value in values)


def test_rows_of_sheets(tmp_path: Path, approved: Approve) -> None:
    book, bundles = saved(build_campaign(), tmp_path), bundle_campaign(conduit_cases())
    for sheet in book.worksheets[1:]:
        assert sheet.freeze_panes in {"B2", "C2"}
        assert (len(sheet.tables), sheet.page_setup.orientation) == (1, "landscape")
    names = ["key numbers", "means", "tests", "results", "comparisons", "needs a look", "curves"]
    name, ends = bundles.groups[0].name, Interval(0.0058, 0.0062)
    bounded = BoundedStiffness(name, "", 0.006, ends, 0.0015, 0.0045, 0.15, (0.15, 0.16), 0.03)
    reasons = (Reason("no_model", "no bounds: why"),)
    unbounded = BoundedStiffness(name, "t-1", None, None, reasons=reasons)
    bundle_book = saved(replace(bundles, bounded_stiffnesses=(bounded, unbounded)), tmp_path)
    approved([
        *(line for name in names for line in sheet_words(book, name)),
        *sheet_words(bundle_book, "answers"), *sheet_words(bundle_book, "comparisons"),
        *sheet_words(bundle_book, "slipping and sticking"),
        *(str(cell.value) for cell in book["read me"]["A"][-9:]),
    ])  # fmt: skip
    rows = table(bundle_book, "comparisons")
    assert len(rows) == 28 * 2
    assert sum(row["question"] is None for row in rows) == 18 * 2
    group = build_campaign().groups[0]
    result, number = group.samples[0].results[1], group.numbers[1].mean
    assert result.value is not None
    assert number is not None
    head = "Stiffness, first region (N/mm)"
    assert table(book, "tests")[0][head] == pytest.approx(1e-3 * result.value)
    means = [row for row in table(book, "means") if row["result"] == group.numbers[1].name]
    assert means[0]["mean"] == pytest.approx(1e-3 * number.chosen.mean)
    curve = [row for row in table(book, "curves") if row["group"] == "twist-tube-10"]
    np.testing.assert_allclose([row["mean (N)"] for row in curve], group.band.mean)
    charts: Any = book["curves"]
    assert charts._charts
