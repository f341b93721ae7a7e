from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from labpipe.records.result import TestResult
from labpipe.report.curve_figures import (
    cycle_colours,
    draw_force_displacement,
    plot_filtered,
    plot_raw,
)
from labpipe.report.figure_page import style
from tests.store.builders_result import build_result


@pytest.fixture(scope="module")
def result() -> TestResult:
    return build_result(half_cycle=4.0)


def _sentences(axes: Axes) -> list[str]:
    return [text.get_text() for text in axes.texts]


def test_filtered_branches_peaks_and_labels(result: TestResult) -> None:
    axes = Figure().subplots()
    plot_filtered(result, axes)
    assert result.curve is not None
    lines = [line for line in axes.lines if line.get_marker() == "None"]
    assert len(lines) == 6
    assert len({line.get_color() for line in lines}) == 3
    assert [line.get_linestyle() for line in lines] == ["-", "--"] * 3
    branch = result.curve.branches[0]
    part = slice(branch.start, branch.stop + 1)
    across = np.asarray(lines[0].get_xdata(), dtype=np.float64)
    np.testing.assert_allclose(across, result.curve.displacement[part] * 1e3, atol=1e-12)
    np.testing.assert_array_equal(lines[0].get_ydata(), result.curve.force[part])
    peaks = [line for line in axes.lines if line.get_marker() == "v"]
    tops = [float(np.asarray(peak.get_ydata())[0]) for peak in peaks]
    assert tops == [result.curve.force[result.curve.cycle == n].max() for n in (1, 2, 3)]
    assert axes.get_xlabel() == "Displacement (mm)"
    assert axes.get_ylabel() == "Force (N)"


def test_raw_shows_all_of_the_noise(result: TestResult) -> None:
    axes = Figure().subplots()
    long = build_result(half_cycle=53.0, cycles=1, force_rate=10.0)
    plot_raw(long, axes)
    assert long.aligned is not None
    assert long.curve is not None
    branch = long.curve.branches[0]
    force = long.aligned.series["force"].values[branch.start : branch.stop + 1]
    drawn = np.asarray(axes.lines[0].get_ydata())
    assert drawn.max() == force.max()
    assert drawn.min() == force.min()
    assert len(drawn) < len(force) / 3


def test_curve_without_branches_is_one_line(result: TestResult) -> None:
    assert result.curve is not None
    still = replace(result, curve=replace(result.curve, branches=()))
    for plot in (plot_raw, plot_filtered):
        axes = Figure().subplots()
        plot(still, axes)
        assert sum(line.get_marker() == "None" for line in axes.lines) == 1
    draw_force_displacement(still)


def test_missing_stages_are_said(result: TestResult) -> None:
    bare = replace(result, curve=None, aligned=None)
    raw, filtered = Figure().subplots(1, 2)
    plot_raw(bare, raw)
    plot_filtered(bare, filtered)
    assert _sentences(raw) == ["There is no unfiltered force and displacement to draw."]
    assert _sentences(filtered) == ["There is no curve to draw."]
    assert len(draw_force_displacement(bare).axes) == 2


def test_few_cycles_get_a_key_many_a_colour_bar(result: TestResult) -> None:
    with style():
        few, many = (
            draw_force_displacement(result),
            draw_force_displacement(build_result(half_cycle=1.0, cycles=35)),
        )
    names = [text.get_text() for text in few.legends[0].get_texts()]
    assert names == ["cycle 1", "cycle 2", "cycle 3", "loading", "unloading", "peak"]
    assert len(few.axes) == 2
    names = [text.get_text() for text in many.legends[0].get_texts()]
    assert names == ["loading", "unloading", "peak"]
    bar = many.axes[2]
    assert bar.get_ylabel() == "Cycle"
    assert [bar.get_yticks()[0], bar.get_yticks()[-1]] == [1, 35]


def test_key_names_no_unloading_where_there_is_none(result: TestResult) -> None:
    assert result.curve is not None
    pulled = replace(result, curve=replace(result.curve, branches=result.curve.branches[:1]))
    names = [text.get_text() for text in draw_force_displacement(pulled).legends[0].get_texts()]
    assert names == ["peak"]
    once = replace(result, curve=replace(result.curve, branches=result.curve.branches[:2]))
    page = draw_force_displacement(once)
    names = [text.get_text() for text in page.legends[0].get_texts()]
    assert names == ["loading", "unloading", "peak"]


def test_unloading_is_dashed_in_both_panels(result: TestResult) -> None:
    with style():
        page = draw_force_displacement(result)
    for axes in page.axes:
        lines = [line for line in axes.lines if line.get_marker() == "None"]
        assert [line.get_linestyle() for line in lines] == ["-", "--"] * 3


def test_panel_b_says_whether_anything_was_filtered(result: TestResult) -> None:
    assert result.curve is not None
    assert result.aligned is not None
    series = result.aligned.series
    plain = replace(
        result.curve, force=series["force"].values, displacement=series["displacement"].values
    )
    slack = replace(plain, displacement=plain.displacement - 1e-3)
    titles = [
        [
            axes.get_title(loc="left")
            for axes in draw_force_displacement(replace(result, curve=curve)).axes
        ]
        for curve in (result.curve, plain, slack)
    ]
    assert titles == [
        ["(a) As recorded", "(b) Filtered"],
        ["As recorded, not filtered"],  # one panel: a second would be the same
        ["(a) As recorded", "(b) Corrected, not filtered"],
    ]


@pytest.mark.parametrize("count", [0, 1, 6, 7, 40])
def test_cycle_colours_differ(count: int) -> None:
    with style():
        colours = cycle_colours(count)
    assert len(set(colours)) == count
