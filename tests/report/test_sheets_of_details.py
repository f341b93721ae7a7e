from __future__ import annotations

import zipfile
from dataclasses import replace
from datetime import date
from pathlib import Path
from typing import Any

import pytest
from openpyxl.workbook import Workbook

from labpipe.records.curve import Interval
from labpipe.records.group import BundlePlace, Campaign
from labpipe.records.quality import Reason
from labpipe.records.result import Contribution
from labpipe.report.page_facts import report_id
from labpipe.report.wording import shown_in
from labpipe.statistics.groups import build_group as grouped
from tests.builders.bundle_campaigns import bundle_campaign, bundle_of, conduit_cases, three_of
from tests.builders.campaigns import build_campaign, build_group, build_sample, six_samples
from tests.builders.report_books import saved, table


@pytest.fixture(scope="module")
def book(tmp_path_factory: pytest.TempPathFactory) -> Workbook:
    return saved(build_campaign(), tmp_path_factory.mktemp("book"))


def test_numbers_are_numbers_in_display_units(book: Workbook) -> None:
    first = build_campaign().groups[0]
    rows = table(book, "results")
    assert len(rows) == 7 * 7
    row = next(row for row in rows if row["result"] == "stiffness_first")
    result = first.samples[0].results[1]
    assert result.value is not None
    assert row["value"] == pytest.approx(1e-3 * result.value)
    assert (row["unit"], row["status"], row["test"]) == ("N/mm", "doubtful", "tt-s1a")
    failed = next(row for row in rows if row["status"] == "failed")
    assert (failed["value"], failed["lower"]) == (None, None)
    assert failed["reason"].startswith("too_few_samples: ")


def test_a_row_for_each_test_with_units_in_the_heads(book: Workbook) -> None:
    first = build_campaign().groups[0]
    rows = table(book, "tests")
    assert len(rows) == 7
    result = first.samples[0].results[1]
    assert result.value is not None
    row = rows[0]
    assert row["Stiffness, first region (N/mm)"] == pytest.approx(1e-3 * result.value)
    assert (row["test"], row["doubtful numbers"], row["state"]) == ("tt-s1a", 1, "doubtful")
    assert [row["failed numbers"] for row in rows].count(0) < 7


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
                replace(each, budget=_budget(each.value)) for each in sample.results if each.value
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


@pytest.mark.parametrize("name", ["=1+1", "#N/A", "+2", "@SUM(A1)", "a\x07b"])
def test_text_stays_text(name: str, tmp_path: Path) -> None:
    sample = replace(build_sample(name, name), test=name)
    book = saved(Campaign(name, (build_group(name, [sample], scaled=False),)), tmp_path)
    cell = book["results"]["B2"]
    assert (cell.data_type, cell.value) == ("s", name.replace("\x07", "\ufffd"))
    with zipfile.ZipFile(tmp_path / "tables.xlsx") as parts:
        for part in parts.namelist():
            assert b"<f>" not in parts.read(part)


def test_what_groups_differ_in_stands_behind_the_comparison(tmp_path: Path) -> None:
    rows = table(saved(bundle_campaign(conduit_cases()), tmp_path), "comparisons")
    assert len(rows) == 28 * 2
    taping = next(row for row in rows if row["question"] == "taping")
    assert taping["differ in"] in {
        "taping: coarse against none", "taping: half-lap against none",
        "taping: half-lap against coarse",
    }  # fmt: skip
    several = [row for row in rows if row["question"] is None]
    assert len(several) == 18 * 2
    assert all("; " in row["differ in"] for row in several)


def test_places_of_bundles(tmp_path: Path) -> None:
    campaign = bundle_campaign(three_of(bundle_of("7 B1")))
    name = campaign.groups[0].name
    ends = Interval(0.0058, 0.0062)
    place = BundlePlace(name, "", 0.006, ends, 0.0015, 0.0045, 0.15, (0.15, 0.16), 0.03)
    lacking = BundlePlace(name, "t-1", None, None, reasons=(Reason("no_model", "no bounds: why"),))
    book = saved(replace(campaign, places=(place, lacking)), tmp_path)
    first, second = table(book, "slipping and sticking")
    assert (first["test"], first["unit"], first["reason"]) == ("mean", "N·mm²", None)
    assert first["bending stiffness"] == pytest.approx(6000.0)
    assert first["wires slip"] == pytest.approx(4500.0)
    assert first["largest of all directions"] == pytest.approx(160000.0)
    assert (first["share (%)"], first["share lower (%)"]) == (0.03, None)
    assert (second["all slips"], second["reason"]) == (None, "no_model: no bounds: why")
