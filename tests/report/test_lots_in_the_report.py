"""Lots against their smallest force: on the page, in the workbook, in plots."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from openpyxl import load_workbook

from labpipe.records.curve import Interval
from labpipe.records.group import Campaign, Group
from labpipe.records.result import Result
from labpipe.report.group_plots import make_file_plots
from labpipe.report.lab_report import render_page
from labpipe.report.page_tables import make_figure_view, make_lot_table, make_verdict_table
from labpipe.report.report_workbook import save_workbook
from labpipe.report.wording import is_main
from labpipe.statistics.lots import FORCE_LIMIT, PEAK_OVER_LIMIT, judge_lot
from tests.builders.campaigns import build_group, six_samples
from tests.report.figure_words import cell_text

LIMIT = 100.0
SEPARATIONS = ("slip", "slip", "contact broken outside", "slip", "", "slip")


@pytest.fixture(scope="module")
def lot() -> Group:
    samples = []
    for sample, separation in zip(six_samples(slips=0), SEPARATIONS, strict=True):
        peak = sample.results[0].value
        assert peak is not None
        ends = Interval(0.99 * peak / LIMIT, 1.01 * peak / LIMIT)
        share = Result(PEAK_OVER_LIMIT, peak / LIMIT, "1", ends)
        results = (Result(FORCE_LIMIT, LIMIT, "N"), share, *sample.results)
        observed = {"separation": separation} if separation else {}
        specimen = replace(sample.specimen, observed=observed)
        samples.append(replace(sample, results=results, specimen=specimen))
    shown = [
        replace(sample, results=tuple(x for x in sample.results if is_main(x.name)))
        for sample in samples
    ]
    lot = judge_lot(samples, coverage=0.99, confidence=0.95)
    return replace(build_group("crimps", shown, scaled=False), samples=tuple(samples), lot=lot)


def test_the_first_screen_has_the_answer_of_the_lot(lot: Group) -> None:
    campaign = Campaign("S", (lot,))
    table = make_lot_table([make_figure_view(lot)])
    assert table is not None
    cells = list(map(cell_text, table.rows[0]))
    assert cells[:2] == ["crimps", "PASS"]
    assert cells[3] == "100.0 N"
    assert cells[-2:] == ["6", "slip 4, contact broken outside 1, not stated 1"]
    page = render_page(campaign)
    assert page.index('<section id="lots">') < page.index('<section id="key-numbers">')
    verdicts = make_verdict_table(lot)
    assert verdicts is not None
    assert list(map(cell_text, verdicts.rows[0][1:3])) == ["pass", "pass"]
    assert verdicts.rows[4][-1] == "not stated"
    assert make_lot_table([make_figure_view(replace(lot, lot=None))]) is None


def test_the_workbook_has_lots_and_verdicts(lot: Group, tmp_path: Path) -> None:
    save_workbook(Campaign("S", (lot,)), tmp_path / "tables.xlsx")
    book = load_workbook(tmp_path / "tables.xlsx")
    heads, row = book["lots"].iter_rows(values_only=True)
    cells = dict(zip(heads, row, strict=True))
    assert (cells["answer"], cells["limit"], cells["n"]) == ("pass", 100.0, 6)
    assert lot.lot is not None
    assert cells["tolerance bound"] == pytest.approx(LIMIT * lot.lot.tolerance_bound)
    heads, first, *_ = book["tests"].iter_rows(values_only=True)
    cells = dict(zip(heads, first, strict=True))
    assert (cells["verdict"], cells["separation"]) == ("pass", "slip")


def test_limits_are_drawn_in_curves_and_dots(lot: Group) -> None:
    plots = make_file_plots(lot)
    (line,) = (line for line in plots["curves"][0].lines if line.look == "limit")
    np.testing.assert_allclose(line.y, LIMIT)
    places = [line.x[0] for plot in plots["numbers"] for line in plot.lines if line.look == "limit"]
    assert sorted(places) == [1.0, LIMIT]
