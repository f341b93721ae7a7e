from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.records.curve import Interval
from labpipe.records.group import BundlePlace, Campaign
from labpipe.records.quality import Reason
from labpipe.report.bundle_figures import MOST_ROWS, draw_places, place_figures
from labpipe.report.figure_page import style
from labpipe.report.wording import Scale
from tests.builders.bundle_campaigns import bundle_of, grouped, three_of

SCALE = Scale(1e6, "N*mm^2")
PLACE = BundlePlace(
    "g", "t-1", 0.0060, Interval(-0.001, 0.0130), 0.0015, 0.0045, 0.15, (0.15, 0.16), 0.03
)


def test_rows_bars_and_dots() -> None:
    mean = replace(PLACE, test="", interval=None)
    with style():
        (axes,) = draw_places([PLACE, mean], SCALE).axes
    assert axes.get_xscale() == "log"
    assert [label.get_text() for label in axes.get_yticklabels()] == ["t-1", "mean of g"]
    bar, tick, ends, dot = axes.lines[:4]
    assert np.asarray(bar.get_xdata()) == pytest.approx([1500.0, 150000.0])
    assert np.asarray(tick.get_xdata()) == pytest.approx([4500.0])
    assert np.asarray(ends.get_xdata()) == pytest.approx([axes.get_xlim()[0], 13000.0])
    assert np.asarray(dot.get_xdata()) == pytest.approx([6000.0])
    assert axes.get_xlabel() == "Bending stiffness (N\u00b7mm\u00b2)"


def test_a_row_without_bounds_says_why() -> None:
    reasons = (Reason("not_in_sheet", "no bounds: the sheet has no B3"),)
    lacking = BundlePlace("g", "t-2", None, None, reasons=reasons)
    with style():
        (axes,) = draw_places([lacking], SCALE).axes
    assert not axes.lines
    assert axes.texts[0].get_text() == "No bounds: the sheet has no B3."
    long = replace(lacking, reasons=(Reason("x", "y" * 200),))
    with style():
        (axes,) = draw_places([long], SCALE).axes
    assert axes.texts[0].get_text().endswith("\u2026")


def test_many_rows_are_several_figures_with_whole_groups() -> None:
    groups = grouped([*three_of(bundle_of("7 B1")), *three_of(bundle_of("7 B2"))])
    names = [group.name for group in groups]
    places = [replace(PLACE, group=name) for name in names for _ in range(MOST_ROWS - 4)]
    campaign = Campaign("Synthetic", tuple(groups), places=tuple(places))
    assert [each.name for each in place_figures(campaign)] == [
        "between-slipping-and-sticking-1",
        "between-slipping-and-sticking-2",
    ]
    (one,) = place_figures(replace(campaign, places=tuple(places[:4])))
    assert one.name == "between-slipping-and-sticking"
    assert one.alt == f"Bending stiffness between all slipping and nothing slipping: {names[0]}."
    assert list(place_figures(replace(campaign, places=()))) == []
