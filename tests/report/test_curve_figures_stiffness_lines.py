from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure

from labpipe.records.curve import FittedLine, Interval, Slip, SlipDecision
from labpipe.records.result import Result, TestResult
from labpipe.report.curve_figures import (
    draw_stiffness_lines,
    mark_points,
    plot_branch,
    plot_lines,
)
from labpipe.report.figure_page import style
from tests.store.builders_result import build_result

LINE = FittedLine("stiffness_first", slope=2000.0, level=1.0, start=0.002, stop=0.008)
SLIP = Slip(
    position=0.004,
    drop=0.5,
    position_interval=Interval(0.0039, 0.0041),
    drop_interval=Interval(0.4, 0.6),
    decision=SlipDecision.REPAIRED,
    start=10,
    stop=11,
)


@pytest.fixture(scope="module")
def result() -> TestResult:
    known = build_result(half_cycle=4.0)
    found = (
        Result("break_point", 0.006, "m", Interval(0.005, 0.007)),
        Result("failure_displacement", 0.009, "m", Interval(0.0089, 0.0091)),
        Result("failure_force", 12.0, "N", Interval(11.0, 13.0)),
    )
    display = {**known.display, "stiffness": "N/mm"}
    return replace(known, lines=(LINE,), slips=(SLIP,), results=found, display=display)


def test_a_line_lies_where_it_was_fitted(result: TestResult) -> None:
    axes = Figure().subplots()
    plot_lines(result, axes)
    (line,) = axes.lines
    np.testing.assert_allclose(np.asarray(line.get_xdata()), [2.0, 8.0])
    np.testing.assert_allclose(np.asarray(line.get_ydata()), [1.0, 13.0])


def test_repaired_slips_show_the_force_as_measured_beneath(result: TestResult) -> None:
    axes = Figure().subplots()
    plot_branch(result, axes)
    assert [line.get_linestyle() for line in axes.lines] == ["--", "-"]
    marked = replace(result, slips=(replace(SLIP, decision=SlipDecision.MARKED),))
    axes = Figure().subplots()
    plot_branch(marked, axes)
    assert [line.get_linestyle() for line in axes.lines] == ["-"]


def test_break_point_slips_and_failure_are_marked(result: TestResult) -> None:
    axes = Figure().subplots()
    mark_points(replace(result, slips=(SLIP, replace(SLIP, position=0.005))), axes)
    places = [float(np.asarray(line.get_xdata())[0]) for line in axes.lines]
    np.testing.assert_allclose(places, [6.0, 4.0, 5.0, 9.0])
    assert float(np.asarray(axes.lines[-1].get_ydata())[0]) == 12.0


def test_kink_and_onset_of_a_plateau_are_marked(result: TestResult) -> None:
    found = (
        Result("kink_displacement", 0.002, "m", Interval(0.0019, 0.0021)),
        Result("plateau_displacement", 0.007, "m", Interval(0.006, 0.008)),
    )
    axes = Figure().subplots()
    mark_points(replace(result, results=found, slips=()), axes)
    places = [float(np.asarray(line.get_xdata())[0]) for line in axes.lines]
    np.testing.assert_allclose(places, [2.0, 7.0])


def test_key_has_every_entry(result: TestResult) -> None:
    with style():
        page = draw_stiffness_lines(result)
    told = [text.get_text() for text in page.legends[0].get_texts()]
    assert told == [
        "loading",
        "as measured",
        "Stiffness, first region: 2.000 N/mm",
        "break point",
        "slip, repaired",
        "failure",
    ]


def test_a_slope_has_the_digits_of_its_result(result: TestResult) -> None:
    known = Result("stiffness_first", 2000.0, "N/m", Interval(1950.0, 2060.0))
    with style():
        page = draw_stiffness_lines(replace(result, results=(*result.results, known)))
    told = [text.get_text() for text in page.legends[0].get_texts()]
    assert "Stiffness, first region: 2.000 (1.950 to 2.060) N/mm" in told


def test_a_kink_is_named_in_the_key(result: TestResult) -> None:
    found = (Result("kink_displacement", 0.002, "m", Interval(0.0019, 0.0021)),)
    with style():
        page = draw_stiffness_lines(replace(result, results=found, slips=(), lines=()))
    assert [text.get_text() for text in page.legends[0].get_texts()] == ["loading", "kink"]


def test_without_a_curve_a_sentence_says_why(result: TestResult) -> None:
    with style():
        page = draw_stiffness_lines(replace(result, curve=None))
    (axes,) = page.axes
    assert "There is no loading branch to draw." in axes.texts[0].get_text()
