from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from openpyxl.workbook import Workbook

from labpipe.records.group import BundlePlace, Campaign
from tests.builders.bundle_campaigns import bundle_campaign, conduit_cases
from tests.builders.campaigns import build_campaign, build_group
from tests.builders.report_books import saved, table


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


def test_twelve_sheets_at_the_most_however_many_groups(tmp_path: Path) -> None:
    campaign = bundle_campaign(conduit_cases())
    place = BundlePlace(campaign.groups[0].name, "", 0.006, None, 0.0015, 0.0045, 0.15)
    book = saved(replace(campaign, places=(place,)), tmp_path)
    assert len(campaign.groups) == 8
    assert len(book.sheetnames) <= 12
    assert book.sheetnames[1] == "answers"


def test_key_numbers_with_bars_from_cells(book: Workbook) -> None:
    rows = table(book, "key numbers")
    assert [row["group"] for row in rows] == [each.name for each in build_campaign().groups]
    number = build_campaign().groups[0].numbers[1]
    assert number.mean is not None
    interval = number.mean.chosen.interval
    assert interval is not None
    head = "Stiffness, first region{} (N/mm)"
    up = rows[0][head.format(", up")]
    assert up == pytest.approx(1e-3 * (interval.upper - number.mean.chosen.mean))
    assert rows[2][head.format("")] is None
    page: Any = book["key numbers"]
    assert page._charts


def test_means_and_spools(book: Workbook) -> None:
    rows = [row for row in table(book, "means") if row["result"] == "stiffness_first"]
    row, *spools = rows[:3]
    number = build_campaign().groups[0].numbers[1]
    assert number.mean is not None
    assert row["mean"] == pytest.approx(1e-3 * number.mean.chosen.mean)
    assert (row["over"], row["n"], row["mean over"], row["n samples"]) == (
        "all", 2, "spool means", 5,
    )  # fmt: skip
    means = number.mean.spool_means
    assert [each["over"] for each in spools] == [f"spool {name}" for name in means]
    assert spools[0]["mean"] == pytest.approx(1e-3 * next(iter(means.values())).mean)


def test_a_number_that_no_sample_has(tmp_path: Path) -> None:
    failed = build_campaign().groups[0].samples[4]
    book = saved(Campaign("Synthetic", (build_group("A", [failed]),)), tmp_path)
    row = table(book, "means")[0]
    assert (row["mean"], row["n"], row["decision"]) == (None, None, None)
    assert row["reason"] == "too_few_samples: 3 samples where 8 are needed."


def test_curves_comparisons_and_concerns(book: Workbook) -> None:
    band = build_campaign().groups[0].band
    every = table(book, "curves")
    assert list(every[0]) == [
        "group", "displacement (mm)", "mean (N)", "lower (N)", "upper (N)",
        "lower, whole curve (N)", "upper, whole curve (N)", "n", "mean over", "reason",
    ]  # fmt: skip
    rows = [row for row in every if row["group"] == "twist-tube-10"]
    assert len(rows) == len(band.displacement)
    assert rows[-1]["mean (N)"] == pytest.approx(band.mean[-1])
    assert rows[-1]["displacement (mm)"] == pytest.approx(40.0)
    lone = next(row for row in every if row["group"] == "twist-tube-7")
    assert (lone["lower (N)"], lone["n"]) == (None, 1)
    (empty,) = [row for row in every if row["group"] == "twist-tube-5"]
    assert empty["reason"].startswith("no_sample: ")
    compared = table(book, "comparisons")[0]
    assert compared["second minus first"] == pytest.approx(-1.4234)
    assert compared["does not matter below"] == pytest.approx(0.5)
    assert len(table(book, "needs a look")) == 7
