from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure

from labpipe.records.curve import SlipDecision
from labpipe.report.figure_page import style
from labpipe.report.group_figures import MOST_PANELS, draw_slips, plot_slips, with_slips
from tests.builders.campaigns import build_group, build_sample, six_samples


def test_as_measured_lies_below_repaired_and_slips_are_marked() -> None:
    sample = build_sample("s1", "b", slips=2)
    group = build_group("A", [sample])
    axes = Figure().subplots()
    plot_slips(group, sample, axes)
    measured, repaired = (np.asarray(line.get_ydata()) for line in axes.lines[:2])
    assert repaired[-1] - measured[-1] == pytest.approx(12.0)
    marks = [line for line in axes.lines if line.get_marker() == "v"]
    places = [float(np.asarray(line.get_xdata())[0]) for line in marks]
    assert places == pytest.approx([12.0, 21.0])


def test_marked_slips_have_no_second_curve() -> None:
    sample = build_sample("s1", "b", slips=1)
    slips = tuple(replace(slip, decision=SlipDecision.MARKED) for slip in sample.slips)
    sample = replace(sample, slips=slips)
    axes = Figure().subplots()
    plot_slips(build_group("A", [sample]), sample, axes)
    assert sum(len(np.asarray(line.get_xdata())) > 2 for line in axes.lines) == 1


def test_a_panel_for_each_sample_that_slipped() -> None:
    group = build_group("A", six_samples())
    assert [sample.test for sample in with_slips(group)] == ["tt-s1b", "tt-s2b"]
    with style():
        page = draw_slips(group)
    assert [axes.get_title(loc="left") for axes in page.axes] == ["tt-s1b", "tt-s2b"]


def test_samples_that_are_not_drawn_are_named() -> None:
    samples = [build_sample("s1", str(number), slips=1) for number in range(MOST_PANELS + 1)]
    with style():
        page = draw_slips(build_group("A", samples))
    assert page.texts[1].get_text() == "Not drawn, but in the list of slips: tt-s18."
