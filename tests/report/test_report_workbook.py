from __future__ import annotations

import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from openpyxl import load_workbook
from openpyxl.workbook import Workbook

from labpipe.records.curve import Interval
from labpipe.records.group import BundlePlace, Campaign
from labpipe.records.quality import Reason
from labpipe.records.result import Contribution
from labpipe.report.report_workbook import save_workbook
from labpipe.report.wording import shown_in
from labpipe.statistics.groups import build_group as grouped
from tests.builders.bundle_campaigns import bundle_campaign, bundle_of, conduit_cases, three_of
from tests.builders.campaigns import build_campaign, build_group, build_sample, six_samples


def saved(campaign: Campaign, folder: Path) -> Workbook:
    save_workbook(campaign, folder / "tables.xlsx")
    return load_workbook(folder / "tables.xlsx")


def table(book: Workbook, name: str) -> list[dict[str, Any]]:
    heads, *rows = book[name].iter_rows(values_only=True)
    return [dict(zip(map(str, heads), row, strict=True)) for row in rows]


@pytest.fixture(scope="module")
def book(tmp_path_factory: pytest.TempPathFactory) -> Workbook:
    return saved(build_campaign(), tmp_path_factory.mktemp("book"))


def test_sheets_with_headings_that_stay_in_view(book: Workbook) -> None:
    assert book.sheetnames == [
        "read me", "needs a look", "groups", "spools", "samples", "comparisons",
        "curve twist-tube-10", "scaled twist-tube-10", "curve twist-tube-7", "curve twist-tube-5",
    ]  # fmt: skip
    for sheet in book.worksheets:
        assert sheet.freeze_panes == "A2"
        assert sheet["A1"].font.bold
    assert 20 < book["samples"].column_dimensions["G"].width <= 60


def test_numbers_are_numbers_in_display_units(book: Workbook) -> None:
    first = build_campaign().groups[0]
    rows = table(book, "samples")
    assert len(rows) == 7 * 7
    row = next(row for row in rows if row["result"] == "stiffness_first")
    result = first.samples[0].results[1]
    assert result.value is not None
    assert row["value"] == pytest.approx(1e-3 * result.value)
    assert (row["unit"], row["status"], row["test"]) == ("N/mm", "doubtful", "tt-s1a")
    failed = next(row for row in rows if row["status"] == "failed")
    assert (failed["value"], failed["lower"]) == (None, None)
    assert failed["reason"].startswith("too_few_samples: ")


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
    first = table(book, "budgets")[1]
    assert (first["cause"], first["all tests share"]) == ("scale of the force", "yes")
    assert first["share"] == pytest.approx(0.5)
    value = samples[0].results[0].value or 0.0
    scale = shown_in(first["result"], samples[0].results[0].unit, samples[0].display)
    assert (first["unit"], first["change"]) == (scale.unit, pytest.approx(0.003 * value * scale[0]))
    rows = {
        row["cause"]: row
        for row in table(book, "budgets of groups")
        if row["result"] == first["result"]
    }
    assert list(rows) == ["noise", "scale of the force", "scatter of the tests"]
    mean = group.numbers[0].mean
    assert mean is not None
    assert rows["scale of the force"]["change of the mean"] == pytest.approx(
        0.003 * mean.chosen.mean * scale.factor
    )
    assert rows["noise"]["median share of tests"] == pytest.approx(0.5)
    shares = [row["share of its interval"] for row in rows.values()]
    assert shares[0] is None
    assert sum(shares[1:]) == pytest.approx(1.0)


def _budget(value: float) -> tuple[Contribution, ...]:
    size = 0.003 * value
    scale = Contribution("scale of the force", size, is_common=True)
    return Contribution("noise", size), scale


def test_means_and_spools(book: Workbook) -> None:
    row = next(row for row in table(book, "groups") if row["result"] == "stiffness_first")
    number = build_campaign().groups[0].numbers[1]
    assert number.mean is not None
    assert row["mean"] == pytest.approx(1e-3 * number.mean.chosen.mean)
    assert (row["n"], row["mean over"], row["n samples"]) == (2, "spool means", 5)
    assert len(table(book, "spools")) == 7 * 3


def test_a_number_that_no_sample_has(tmp_path: Path) -> None:
    failed = build_campaign().groups[0].samples[4]
    book = saved(Campaign("Synthetic", (build_group("A", [failed]),)), tmp_path)
    row = table(book, "groups")[0]
    assert (row["mean"], row["n"], row["decision"]) == (None, None, None)
    assert row["reason"] == "too_few_samples: 3 samples where 8 are needed."


def test_curves_comparisons_and_concerns(book: Workbook) -> None:
    band = build_campaign().groups[0].band
    rows = table(book, "curve twist-tube-10")
    assert list(rows[0]) == [
        "displacement (mm)", "mean (N)", "lower (N)", "upper (N)", "lower_all (N)",
        "upper_all (N)", "n", "over",
    ]  # fmt: skip
    assert len(rows) == len(band.displacement)
    assert rows[-1]["mean (N)"] == pytest.approx(band.mean[-1])
    assert rows[-1]["displacement (mm)"] == pytest.approx(40.0)
    lone = table(book, "curve twist-tube-7")
    assert (lone[0]["lower (N)"], lone[0]["n"]) == (None, 1)
    empty = table(book, "curve twist-tube-5")
    assert empty[0]["displacement (m)"].startswith("no_sample: ")
    compared = table(book, "comparisons")[0]
    assert compared["second minus first"] == pytest.approx(-1.4234)
    assert compared["does not matter below"] == pytest.approx(0.5)
    assert len(table(book, "needs a look")) == 7


@pytest.mark.parametrize("name", ["=1+1", "#N/A", "+2", "@SUM(A1)", "a\x07b"])
def test_text_stays_text(name: str, tmp_path: Path) -> None:
    sample = replace(build_sample(name, name), test=name)
    book = saved(Campaign(name, (build_group(name, [sample], scaled=False),)), tmp_path)
    cell = book["samples"]["B2"]
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


def test_types_that_differ_have_no_column_for_it(book: Workbook) -> None:
    assert "question" not in table(book, "comparisons")[0]


def test_places_of_bundles(tmp_path: Path) -> None:
    campaign = bundle_campaign(three_of(bundle_of("7 B1")))
    name = campaign.groups[0].name
    ends = Interval(0.0058, 0.0062)
    place = BundlePlace(name, "", 0.006, ends, 0.0015, 0.0045, 0.15, (0.15, 0.16), 0.03)
    lacking = BundlePlace(name, "t-1", None, None, reasons=(Reason("no_model", "no bounds: why"),))
    book = saved(replace(campaign, places=(place, lacking)), tmp_path)
    first, second = table(book, "slipping and sticking")
    assert (first["test"], first["unit"], first["reason"]) == ("mean", "N*mm^2", None)
    assert first["bending stiffness"] == pytest.approx(6000.0)
    assert first["wires slip"] == pytest.approx(4500.0)
    assert first["largest of all directions"] == pytest.approx(160000.0)
    assert (first["share"], first["share lower"]) == (0.03, None)
    assert (second["all slips"], second["reason"]) == (None, "no_model: no bounds: why")
