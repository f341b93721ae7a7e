from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure

from labpipe.records.curve import PointFlag
from labpipe.records.result import TestResult
from labpipe.report.marker_figures import choose_frames, draw_wire_shapes, plot_shapes
from tests.store.builders_result import LENGTH, build_result


@pytest.fixture(scope="module")
def result() -> TestResult:
    return build_result(half_cycle=4.0)


def test_steps_are_equal_round_and_of_the_first_loading(result: TestResult) -> None:
    assert result.shape is not None
    assert result.curve is not None
    steps = choose_frames(result, result.shape)
    np.testing.assert_allclose(steps.levels, np.arange(6) * 0.01, atol=1e-12)
    reached = result.curve.displacement[steps.frames]
    # the first frame at or beyond the level: within one frame of travel, 0.05 m / 4 s / 50 Hz
    assert (reached >= steps.levels - 1e-12).all()
    assert (reached - steps.levels < 2.6e-4).all()
    assert result.shape.time[steps.frames].max() <= result.curve.branches[0].stop_time
    assert steps.word == "tip deflection"


def test_between_two_supports_nothing_is_a_tip(result: TestResult) -> None:
    assert result.shape is not None
    flags = result.shape.flags.copy()
    flags[:, 0] = PointFlag.MEASURED
    assert choose_frames(result, replace(result.shape, flags=flags)).word == "deflection"


def test_curves_and_signs(result: TestResult) -> None:
    assert result.shape is not None
    shape = result.shape
    flags = shape.flags.copy()
    steps = choose_frames(result, shape)
    flags[steps.frames[2], 4] = PointFlag.MISSING
    flags[steps.frames[2], 6] = PointFlag.RELABELLED
    axes = Figure().subplots()
    plot_shapes(replace(result, shape=replace(shape, flags=flags)), axes)
    curves = [line for line in axes.lines if line.get_marker() == "None"]
    assert len(curves) == 6
    x, y = (np.asarray(data) for data in (curves[-1].get_xdata(), curves[-1].get_ydata()))
    end = shape.coefficients[steps.frames[-1]].sum(axis=1) * 1e3
    np.testing.assert_allclose([x[0], y[0], x[-1], y[-1]], [0, 0, end[0], end[1]], atol=1e-3)
    signs = {
        str(line.get_label()): (line.get_marker(), line.get_markerfacecolor() == "white")
        for line in axes.lines
        if line.get_marker() != "None"
    }
    assert signs["measured"] == ("o", False)
    assert signs["relabelled"] == ("s", False)
    assert signs["filled"] == ("o", True)
    assert signs["constructed"] == ("D", True)
    third = [line for line in axes.lines if line.get_color() == curves[2].get_color()]
    assert sum(len(np.asarray(line.get_xdata())) for line in third) == 81 + len(shape.names) - 1
    assert axes.get_aspect() == 1.0
    assert axes.get_xlim()[1] > LENGTH * 1e3
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("x (mm)", "y (mm)")


def test_cantilever_is_drawn_in_one_plane_a_free_take_in_two(result: TestResult) -> None:
    assert [axes.get_ylabel() for axes in draw_wire_shapes(result).axes] == ["y (mm)"]
    page = draw_wire_shapes(replace(result, curve=None))
    assert [axes.get_ylabel() for axes in page.axes] == ["y (mm)", "z (mm)"]
    legend = page.axes[0].get_legend()
    assert legend is not None
    assert legend.get_title().get_text() == "tip excursion"
    assert legend.get_texts()[1].get_text() == "10 mm"


def test_excursion_is_measured_from_the_first_position(result: TestResult) -> None:
    assert result.shape is not None
    steps = choose_frames(replace(result, curve=None), result.shape)
    tip = result.shape.positions[:, -1]
    way = np.linalg.norm(tip[steps.frames] - tip[0], axis=1)
    assert (way >= steps.levels - 1e-12).all()
    assert (way - steps.levels < 4e-4).all()


def test_shape_without_a_curve_or_a_tip(result: TestResult) -> None:
    assert result.shape is not None
    frames = len(result.shape.time)
    nowhere = np.full_like(result.shape.positions, np.nan)
    bare = replace(
        result.shape,
        positions=nowhere,
        flags=np.zeros_like(result.shape.flags),
        coefficients=np.empty((frames, 3, 0)),
    )
    page = draw_wire_shapes(replace(result, shape=bare, curve=None))
    assert len(page.axes) == 2


def test_missing_shape_is_said(result: TestResult) -> None:
    for axes in (draw_wire_shapes(replace(result, shape=None)).axes[0], Figure().subplots()):
        if not axes.texts:
            plot_shapes(replace(result, shape=None), axes)
        assert axes.texts[0].get_text() == "There is no shape to draw."
