from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from labpipe.records.curve import Bending
from labpipe.records.quality import Reason
from labpipe.records.result import TestResult
from labpipe.report.bending_figure import draw_moment_curvature, plot_cloud, plot_stiffness
from labpipe.report.figure_page import style
from tests.builders.measured_bending import some_bending, some_cloud, some_law
from tests.store.builders_result import build_result


@pytest.fixture(scope="module")
def result() -> TestResult:
    known = build_result(cycles=1, half_cycle=4.0, force_rate=50.0)
    display = {**known.display, "moment": "N*mm", "bending_stiffness": "N*mm^2"}
    return replace(known, bending=some_bending(), display=display)


def test_points_begin_where_the_law_was_at_rest(result: TestResult) -> None:
    axes = Figure().subplots()
    plot_cloud(result, axes)
    unloading, loading, law = axes.lines
    cloud = some_cloud()
    rows = cloud.branch == 0
    y = 1e3 * (cloud.moment[rows] + cloud.moment_at_rest).ravel()
    np.testing.assert_allclose(np.asarray(loading.get_ydata()), y)
    at_rest = np.interp(2e-3, some_law().moment, some_law().curvature)
    x = cloud.curvature[rows] - at_rest * np.array([1.0, 0.5, 0.0])
    assert np.asarray(loading.get_xdata())[0] == pytest.approx(x[0, 0])
    assert unloading.get_markerfacecolor() == "none"
    assert loading.get_markerfacecolor() == loading.get_color()
    np.testing.assert_allclose(np.asarray(law.get_ydata()), 1e3 * some_law().moment)
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("Curvature (1/m)", "Bending moment (N·mm)")


def test_noise_is_shaded(result: TestResult) -> None:
    axes = Figure().subplots()
    plot_cloud(result, axes)
    (stripe,) = axes.patches
    assert stripe.get_extents().width > 0.0
    box = stripe.get_path().get_extents().transformed(stripe.get_patch_transform())
    assert (box.x0, box.x1) == pytest.approx((-0.12, 0.12))


def test_stiffnesses_begin_above_the_noise(result: TestResult) -> None:
    axes = Figure().subplots()
    plot_stiffness(result, axes)
    secant = axes.lines[0]
    np.testing.assert_allclose(np.asarray(secant.get_ydata()), 1e6 * some_law().secant[1:])
    assert axes.get_xscale() == "log"
    assert axes.get_xlim() == pytest.approx((0.06, 10.0))
    assert axes.get_ylabel() == "Bending stiffness (N·mm²)"


def test_tangents_stand_at_the_knots_of_the_law_with_their_intervals(result: TestResult) -> None:
    axes = Figure().subplots()
    plot_stiffness(result, axes)
    bars: Any = axes.containers[0]
    drawn = np.asarray(bars.lines[0].get_ydata(), dtype=np.float64)
    law = some_law()
    assert 1 <= len(drawn) <= len(law.knots)
    assert set(drawn.round(9)) <= set((1e6 * law.tangent).round(9))
    assert bars.lines[0].get_linestyle() == "None"


def test_the_band_lets_the_points_show_through(result: TestResult) -> None:
    axes = Figure().subplots()
    plot_cloud(result, axes)
    (band,) = axes.collections
    assert (band.get_alpha() or 1.0) < 0.5


def test_without_a_law_the_points_stay_and_a_sentence_says_why(result: TestResult) -> None:
    bare = replace(
        result, bending=Bending(some_cloud(), None, Reason("no_law", "expected at least 24"))
    )
    with style():
        page = draw_moment_curvature(bare)
    points, empty = page.axes
    assert len(points.lines) == 2
    assert [text.get_text() for text in empty.texts] == ["no_law: expected at least 24"]


def test_without_a_measurement_the_page_says_so(result: TestResult) -> None:
    with style():
        page = draw_moment_curvature(replace(result, bending=None))
    (axes,) = page.axes
    assert axes.texts[0].get_text().startswith("There is no measured moment-curvature to draw.")


def test_the_key_names_what_is_drawn(result: TestResult) -> None:
    with style():
        page = draw_moment_curvature(result)
    named = [text.get_text() for text in page.legends[0].get_texts()]
    assert named == [
        *("cycle 1", "loading", "unloading"),
        *("law, secant", "tangent, 95 %", "95 % of the law", "below noise"),
    ]
