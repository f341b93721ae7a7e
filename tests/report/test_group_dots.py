from __future__ import annotations

import math
from dataclasses import replace

import pytest
from matplotlib.figure import Figure

from labpipe.records.curve import Interval
from labpipe.records.group import Outlier
from labpipe.report.figure_page import style
from labpipe.report.group_dots import (
    MOST_NUMBERS,
    MOST_ROWS,
    draw_dots,
    numbers_to_draw,
    plot_dots,
    rows_of,
)
from tests.builders.campaigns import build_group, build_sample, six_samples, troubled_samples


def test_rows_are_samples_spool_means_and_the_mean() -> None:
    group = build_group("A", troubled_samples())
    number = group.numbers[1]
    rows = rows_of(group, number)
    assert [row.label for row in rows] == [
        "tt-s1a", "tt-s1b", "tt-s1c", "mean of s1",
        "tt-s2a", "tt-s2b", "tt-s2c", "mean of s2", "mean",
    ]  # fmt: skip
    assert [row.height for row in rows] == list(range(9))
    assert rows[0].is_open
    assert rows[5].note == "no number"
    assert math.isnan(rows[5].value)
    assert number.mean is not None
    assert rows[-1].value == number.mean.chosen.mean


def test_panels_in_display_units_with_the_rest_named() -> None:
    group = build_group("A", six_samples())
    assert len(numbers_to_draw(group)) == MOST_NUMBERS
    with style():
        page = draw_dots(group)
    assert [axes.get_xlabel() for axes in page.axes] == ["N", "N/mm", "N/mm", "1/m", "mm", "mm"]
    assert page.texts[1].get_text() == "In the tables only: Force at failure."


def test_one_spool_has_no_mean_of_its_own() -> None:
    group = build_group("A", six_samples()[:3])
    assert [row.label for row in rows_of(group, group.numbers[0])][-2:] == ["tt-s1c", "mean"]


def test_doubtful_is_in_the_key_where_a_sample_is() -> None:
    for samples, words in ((six_samples(), 2), (troubled_samples(), 3)):
        with style():
            page = draw_dots(build_group("A", samples))
        assert len(page.legends[0].get_texts()) == words


def test_dots_that_differ_by_less_than_their_intervals_stay_close() -> None:
    group = build_group("A", six_samples())
    ends = Interval(4999.0, 5001.0)
    values = {
        test: replace(result, value=5000.0 + 1e-3 * at, interval=ends)
        for at, (test, result) in enumerate(group.numbers[1].values.items())
    }
    number = replace(group.numbers[1], values=values, mean=None)
    axes = Figure().subplots()
    plot_dots(group, number, axes)
    low, high = axes.get_xlim()
    assert high - low >= 2e-3
    assert not axes.xaxis.get_offset_text().get_text()


def test_outliers_have_a_ring() -> None:
    group = build_group("A", six_samples())
    outlier = Outlier("tt-s1c", 5400.0, "Grubbs' test", 0.01)
    number = replace(group.numbers[1], outliers=(outlier,))
    axes = Figure().subplots()
    plot_dots(group, number, axes)
    rings = [line for line in axes.lines if line.get_markerfacecolor() == "none"]
    assert len(rings) == 1
    with style():
        page = draw_dots(replace(group, numbers=(number,)))
    assert page.legends[0].get_texts()[-1].get_text() == "marked as outlier"


def test_an_interval_far_wider_than_the_values_is_cut_by_the_axis() -> None:
    group = build_group("A", six_samples())
    number = group.numbers[1]
    assert number.mean is not None
    assert number.mean.chosen.interval is not None
    axes = Figure().subplots()
    plot_dots(group, number, axes)
    assert axes.get_xlim()[0] > 1e-3 * number.mean.chosen.interval.lower


def test_samples_of_large_groups_share_a_row() -> None:
    samples = [build_sample(f"s{n % 2}", str(n), seed=n) for n in range(MOST_ROWS + 2)]
    group = build_group("A", samples)
    rows = rows_of(group, group.numbers[0])
    half = len(samples) // 2
    assert {row.label for row in rows[:half]} == {f"{half} samples"}
    assert all(abs(row.height) < 0.5 and row.interval is None for row in rows[:half])
    assert rows[half].height == 1.0
    assert rows[-1].height == 4.0


def test_single_samples_are_not_drawn() -> None:
    assert numbers_to_draw(build_group("A", [build_sample("s1", "a")])) == []


@pytest.mark.parametrize("count", [2, 3])
def test_spools_of_one_sample(count: int) -> None:
    group = build_group("A", [build_sample(f"s{n}", "a", seed=n) for n in range(count)])
    with style():
        assert len(draw_dots(group).axes) == MOST_NUMBERS


def test_later_cycles_are_left_to_the_tables() -> None:
    group = build_group("A", six_samples())
    later = replace(group.numbers[0], name="peak_force.2")
    names = [each.name for each in numbers_to_draw(replace(group, numbers=(later, *group.numbers)))]
    assert names[0] == "peak_force.1"
