"""Shares of the causes: what the bars show, and what they say where there are none."""

from __future__ import annotations

from dataclasses import replace

import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from labpipe.records.causes import IS_COMMON
from labpipe.records.curve import Interval
from labpipe.records.group import Group
from labpipe.records.result import Contribution, Result, TestResult
from labpipe.report.budget_figures import (
    COLOURS_OF_CAUSES,
    Bar,
    budgets_to_draw,
    draw_budget,
    draw_group_budgets,
    half_width,
    plot_bars,
)
from labpipe.report.figure_page import style
from labpipe.report.wording import Scale
from labpipe.statistics.groups import build_group
from tests.builders.campaigns import six_samples
from tests.store.builders_result import build_result


@pytest.fixture(scope="module")
def result() -> TestResult:
    return build_result(half_cycle=1.0)


def pieces(axes: Axes) -> list[tuple[float, float, bool]]:
    """Where each piece begins, how long it is, and whether it is hatched."""
    found = [each for each in axes.get_children() if isinstance(each, Rectangle)]
    return [
        (round(each.get_x(), 6), round(each.get_width(), 6), bool(each.get_hatch()))
        for each in found
        if each is not axes.patch
    ]


def words(axes: Axes) -> list[str]:
    return [each.get_text() for each in axes.texts]


def test_a_bar_for_each_number_of_the_first_cycle(result: TestResult) -> None:
    """0.003 and 0.004: 36 and 64 %; the interval of 0.02 N is written as half of it."""
    later = replace(result.results[0], name="peak_force.2")
    clock = replace(result.results[0], name="clock_offset", unit="s")
    with style():
        page = draw_budget(replace(result, results=(*result.results, later, clock)))
    (axes,) = page.axes
    assert pieces(axes) == [(0.0, 36.0, False), (36.0, 64.0, True)]
    assert words(axes) == ["36", "64", "\u00b1 0.010 N", "Peak force", "95 %"]
    (legend,) = page.legends
    assert [each.get_text() for each in legend.get_texts()] == [
        "noise",
        "scale of the force",
        "hatched: all tests share it",
    ]


def test_a_test_without_budgets_says_so(result: TestResult) -> None:
    bare = replace(result, results=tuple(replace(each, budget=()) for each in result.results))
    with style():
        (axes,) = draw_budget(bare).axes
    assert "No number of this test says what its interval is made of." in " ".join(
        words(axes)[0].split()
    )


def test_small_causes_stand_together_at_the_end() -> None:
    axes = Figure().subplots()
    bars = [
        Bar("a", {"slack": 0.01, "noise": 0.975, "pull offset": 0.015}),
        Bar("b", {"length": 1}),
    ]
    plot_bars(bars, axes)
    assert pieces(axes) == [(0.0, 97.5, False), (97.5, 2.5, False), (0.0, 100.0, False)]
    assert axes.get_ylim() == (1.5, -0.5)


def test_half_widths_in_the_display_unit() -> None:
    assert half_width(Interval(0.0531, 0.0533), Scale(1e3, "mm")) == "\u00b1 0.10 mm"
    assert half_width(Interval(1.0, 3.0), Scale(1.0, "1")) == "\u00b1 1.0"
    assert half_width(None, Scale(1.0, "N")) == ""


def test_every_cause_has_a_colour() -> None:
    assert set(IS_COMMON) <= set(COLOURS_OF_CAUSES)


def group(count: int = 6) -> Group:
    def with_budget(each: Result) -> Result:
        size = 0.003 * (each.value or 0.0)
        shared = Contribution("scale of the force", size, is_common=True)
        return replace(each, budget=(Contribution("noise", size), shared))

    samples = [
        replace(each, results=tuple(map(with_budget, each.results)))
        for each in six_samples()[:count]
    ]
    return build_group("tube", "twist-tube", samples)


def test_a_group_shows_its_tests_and_its_means() -> None:
    own = group()
    count = len(budgets_to_draw(own))
    assert count >= 3
    with style():
        left, right = draw_group_budgets(own).axes
    assert pieces(left) == [(0.0, 50.0, False), (50.0, 50.0, True)] * count
    assert len(pieces(right)) == 2 * count
    assert sum(width for _, width, _ in pieces(right)) == pytest.approx(100.0 * count)
    assert right.get_xlabel() == "Share of the squared half width (%)"


def test_one_test_has_no_mean_with_an_interval() -> None:
    own = group(1)
    with style():
        (axes,) = draw_group_budgets(own).axes
    assert len(pieces(axes)) == 2 * len(budgets_to_draw(own))


def test_a_group_without_budgets_has_nothing_to_draw() -> None:
    bare = build_group("tube", "twist-tube", six_samples())
    assert budgets_to_draw(bare) == []
