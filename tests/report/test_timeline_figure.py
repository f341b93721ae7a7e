from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from labpipe.records.curve import Aligned
from labpipe.records.result import TestResult
from labpipe.report.timeline_figure import (
    draw_timeline,
    motion,
    plot_force,
    plot_motion,
    plot_residuals,
    turning_points,
)
from tests.store.builders_result import DRIFT, OFFSET, build_result


@pytest.fixture(scope="module")
def result() -> TestResult:
    return build_result(half_cycle=4.0)


def test_panels_and_labels(result: TestResult) -> None:
    labels = [axes.get_ylabel() for axes in draw_timeline(result).axes]
    assert labels == ["Force (N)", "Travel (mm)", "Residual (ms)"]
    assert draw_timeline(result).axes[-1].get_xlabel() == "Time (s)"


def test_without_clock_fit_there_is_no_residual_panel(result: TestResult) -> None:
    assert result.aligned is not None
    page = draw_timeline(replace(result, aligned=replace(result.aligned, clock_fit=None)))
    assert [axes.get_ylabel() for axes in page.axes] == ["Force (N)", "Travel (mm)"]


def test_force_raw_and_filtered(result: TestResult) -> None:
    axes = Figure().subplots()
    plot_force(result, axes)
    assert result.curve is not None
    assert [line.get_label() for line in axes.lines] == ["as recorded", "filtered"]
    np.testing.assert_array_equal(axes.lines[1].get_ydata(), result.curve.force)


def test_a_force_to_which_nothing_was_done_is_one_line(result: TestResult) -> None:
    axes = Figure().subplots()
    assert result.curve is not None
    assert result.aligned is not None
    plain = replace(result.curve, force=result.aligned.series["force"].values)
    plot_force(replace(result, curve=plain), axes)
    assert [line.get_label() for line in axes.lines] == ["as recorded"]
    np.testing.assert_array_equal(axes.lines[0].get_ydata(), plain.force)


def test_turning_points_lie_on_the_motion(result: TestResult) -> None:
    assert turning_points(result).tolist() == [3, 7, 11, 15, 19, 23, 27]
    axes = Figure().subplots()
    plot_motion(result, axes)
    points = next(line for line in axes.lines if line.get_label() == "turning point")
    assert np.asarray(points.get_ydata()).round(6).tolist() == [0, 53, 0, 53, 0, 53, 0]


def test_motion_is_travel_then_displacement_then_curve(result: TestResult) -> None:
    assert result.aligned is not None
    series = {key: one for key, one in result.aligned.series.items() if key != "travel"}
    second = replace(result, aligned=replace(result.aligned, series=series))
    found = [motion(one) for one in (result, second, replace(result, aligned=None))]
    assert [one[0] for one in found if one] == ["Travel", "Displacement", "Displacement"]
    assert motion(replace(result, aligned=None, curve=None)) is None


def test_residuals_are_what_the_line_leaves_over(result: TestResult) -> None:
    axes = Figure().subplots()
    plot_residuals(result, axes)
    assert result.aligned is not None
    fit = result.aligned.clock_fit
    assert fit is not None
    expected = (fit.event_times_force - OFFSET - (1 + DRIFT) * fit.event_times_motion) * 1e3
    bars: Any = axes.containers[0]
    drawn = np.asarray(bars.lines[0].get_ydata(), dtype=np.float64)
    np.testing.assert_allclose(drawn, expected, atol=1e-9)
    lengths = [float(np.ptp(path.vertices[:, 1])) for path in bars.lines[2][0].get_paths()]
    np.testing.assert_allclose(lengths, 2 * 1.96 * fit.event_errors * 1e3)
    words = axes.get_title(loc="right")
    assert words.startswith("offset 3.2170 ± 0.0020 s,  drift 48.0 ± 9.0 ppm")
    assert f"residual 1.2 ms (rms of {len(fit.event_times_motion)})" in words


def test_two_events_leave_nothing_over_and_signs_are_minus(result: TestResult) -> None:
    assert result.aligned is not None
    fit = result.aligned.clock_fit
    assert fit is not None
    two = replace(
        fit,
        drift=-fit.drift,
        event_times_motion=fit.event_times_motion[:2],
        event_times_force=fit.event_times_force[:2],
        event_errors=fit.event_errors[:2],
    )
    axes = Figure().subplots()
    plot_residuals(replace(result, aligned=replace(result.aligned, clock_fit=two)), axes)
    words = axes.get_title(loc="right")
    assert "2 events for two unknowns: nothing is left over" in words
    assert "residual" not in words
    assert "drift \u221248.0 ± 9.0 ppm" in words


def test_missing_stages_are_said(result: TestResult) -> None:
    bare = replace(result, curve=None, aligned=Aligned(np.empty(0), {}))
    texts = []
    for plot in (plot_force, plot_motion, plot_residuals):
        axes = Figure().subplots()
        plot(bare, axes)
        texts.append(axes.texts[0].get_text())
    assert texts == [
        "There is no force to draw.",
        "There is no motion to draw.",
        "There is no clock fit to draw.",
    ]
    draw_timeline(bare)
