from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from matplotlib.figure import Figure

from labpipe.report.calibration_figures import plot_shapes, shapes_figure
from labpipe.report.calibration_shown import BentShape
from labpipe.report.figure_page import style
from tests.report.builders_calibrations import shape, shapes


@pytest.fixture(autouse=True)
def _in_style() -> Iterator[None]:
    with style({"text.parse_math": False}):
        yield


def test_markers_fit_and_model() -> None:
    bent, axes = shape(0.03), Figure().subplots()
    plot_shapes([bent], axes)
    for line, points in zip(axes.lines, (bent.model, bent.fit, bent.markers), strict=True):
        np.testing.assert_allclose(np.asarray(line.get_data()), 1e3 * points.T)
    assert [line.get_marker() for line in axes.lines] == ["None", "None", "o"]
    assert axes.lines[0].get_linestyle() == "-"
    assert axes.lines[1].get_linestyle() == "--"
    assert axes.texts[0].get_text() == "30 mm"
    assert axes.get_aspect() == 1.0


def test_figure_of_six_deflections() -> None:
    page = shapes_figure("A2, 85 mm", shapes()["A2, 85 mm"])
    assert page.texts[0].get_text() == "A2, 85 mm  \u00b7  shapes at 6 deflections of the tip"
    labels = [text.get_text() for text in page.legends[0].get_texts()]
    assert labels == ["markers", "fitted curve", "model"]
    (axes,) = page.axes
    assert axes.get_xlim()[1] > 80.0
    assert axes.get_ylim()[1] > 50.0


def test_what_is_not_there_is_not_named() -> None:
    nothing = np.zeros((0, 2))
    bare = BentShape(0.01, np.full((3, 2), np.nan), nothing, nothing)
    page = shapes_figure("A2", [bare])
    assert [text.get_text() for text in page.legends[0].get_texts()] == ["markers"]
    assert not page.axes[0].texts


def test_no_shape_is_said() -> None:
    page = shapes_figure("A2", [])
    assert page.axes[0].texts[0].get_text() == "There is no shape to draw."
