from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure

from labpipe.records.quality import QualityNote, Severity
from labpipe.records.wire_calibration import ExternalCurveComparison
from labpipe.report.calibration_agreement import (
    ExternalPanel,
    external_figure,
    external_pages,
    match_words,
    plot_external,
)
from labpipe.report.calibration_shown import CalibrationReport
from labpipe.report.figure_page import style
from tests.builders.external_curves import (
    FORCE,
    GRID,
    external_comparison,
    third_group,
    third_model,
    unmodelled,
    untested,
)
from tests.report.builders_calibrations import usual


@pytest.fixture(autouse=True)
def _in_style() -> Iterator[None]:
    with style({"text.parse_math": False}):
        yield


def report(*comparisons: ExternalCurveComparison) -> CalibrationReport:
    return CalibrationReport(usual(), (third_group(),), comparisons=comparisons)


def page_of(*comparisons: ExternalCurveComparison) -> Figure:
    (panels,) = external_pages(report(*comparisons))
    return external_figure(panels)


def note(page: Figure) -> str:
    return page.texts[1].get_text().replace("\n", " ")


def test_a_panel_for_each_wire_length_and_load() -> None:
    normal = external_comparison("normal", is_normal=True)
    page = page_of(external_comparison(), untested(), normal, external_comparison("other"))
    titles = [axes.get_title(loc="left") for axes in page.axes if axes.axison]
    assert titles == [
        "(a) A2, 85 mm",
        "(b) B2, 100 mm",
        "(c) A2, 85 mm, load normal to the axis",
    ]
    assert [len(axes.get_legend_handles_labels()[1]) for axes in page.axes] == [2, 1, 1, 0]


def test_curves_bands_and_model_are_drawn() -> None:
    axes, one = Figure().subplots(), external_comparison()
    plot_external(ExternalPanel("A2", 0.085, False, third_group(), (one,)), axes)
    mean, model, curve = axes.lines
    np.testing.assert_allclose(np.asarray(mean.get_data()), [1e3 * GRID, FORCE])
    np.testing.assert_allclose(np.asarray(model.get_ydata()), third_model().force)
    np.testing.assert_allclose(
        np.asarray(curve.get_data()), [1e3 * one.curve.deflection, one.curve.force]
    )
    tops = [
        float(np.asarray(each.get_paths()[0].vertices)[:, 1].max()) for each in axes.collections
    ]
    np.testing.assert_allclose(tops, [0.104, 0.103])  # the model's band is of the mean sample
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("Tip deflection (mm)", "Force (N)")


def test_how_far_it_is_stands_in_the_key() -> None:
    assert match_words(external_comparison()).splitlines() == [
        "finite elements",
        "tests: RMSE 1 mN, 1 % of peak",
        "model: RMSE 3 mN, 3.1 % of peak",
    ]
    assert match_words(untested()).splitlines()[1] == "no tests to compare"
    assert match_words(external_comparison("_fe")).startswith(" _fe\n")
    assert match_words(unmodelled()).splitlines()[2] == "model: not compared"


def test_footnote_says_what_was_left_out() -> None:
    said = note(page_of(external_comparison(), untested()))
    assert "'finite elements': 1 of 6 points left out, outside of 0 to 50 mm, the range" in said
    assert "'paper': no test of B2 at 100 mm." in said
    assert "Grey band: the mean of the tests" in said


def test_a_load_that_is_not_that_of_the_tests_is_said_once() -> None:
    load = QualityNote("external_curve_load", Severity.INFO, "a", "the model's force is larger")
    normal = replace(external_comparison("a", is_normal=True), notes=(load,))
    said = note(page_of(normal, normal))
    assert said.count("Where the load is normal to the axis, that of the tests is not.") == 1
    assert "Where the load" not in note(page_of(external_comparison()))


def test_a_long_key_has_room_above_the_curves() -> None:
    tops = [
        page_of(*(external_comparison(f"curve {i}") for i in range(n))).axes[0].get_ylim()[1]
        for n in (1, 3)
    ]
    assert tops[1] > 1.2 * tops[0]


def test_without_a_model() -> None:
    page = page_of(unmodelled())
    assert [text.get_text() for text in page.legends[0].get_texts()] == [
        "mean of samples",
        "95 % band of the mean",
    ]
    assert "Blue band" not in note(page)


def test_pages_of_six() -> None:
    many = [
        replace(each, curve=replace(each.curve, length=0.08 + 0.01 * number))
        for number, each in enumerate([untested()] * 8)
    ]
    assert [len(page) for page in external_pages(report(*many))] == [6, 2]
    assert external_pages(report()) == []


@pytest.mark.parametrize("count", [0, 7])
def test_number_of_panels(count: int) -> None:
    panel = ExternalPanel("A2", 0.085, False, None, (untested(),))
    with pytest.raises(ValueError, match=rf"{count} panels: allowed are 1 to 6 on a page"):
        external_figure([panel] * count)
