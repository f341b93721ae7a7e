from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from labpipe.report.calibration_card import plot_loadings, plot_residuals
from labpipe.report.figure_page import style
from tests.report.builders_calibrations import predicted, usual


@pytest.fixture(autouse=True)
def _in_style() -> Iterator[None]:
    with style():
        yield


def panel() -> Axes:
    return Figure().subplots()


def test_samples_and_the_model_once_for_each_length() -> None:
    calibration, axes = usual(), panel()
    plot_loadings(calibration, axes, predictions={0.085: predicted()})
    assert len(axes.lines) == 4 + 2
    first = calibration.curves[0]
    np.testing.assert_allclose(np.asarray(axes.lines[0].get_ydata()), first.force)
    np.testing.assert_allclose(
        np.asarray(axes.lines[4].get_data()), [1e3 * first.deflection, first.model]
    )
    assert [text.get_text() for text in axes.texts] == ["85 mm", "120 mm"]
    (band,) = axes.collections
    assert band.get_paths()[0].get_extents().y1 == pytest.approx(predicted().upper_mean.max())


def test_residuals_with_and_without_the_factors_of_samples() -> None:
    calibration = usual()
    plain, own = panel(), panel()
    plot_residuals(calibration, plain)
    plot_residuals(calibration, own, has_own_factor=True)
    curve = calibration.curves[0]
    left = 1e3 * (curve.force - curve.model)
    np.testing.assert_allclose(np.asarray(plain.lines[1].get_ydata()), left)
    np.testing.assert_allclose(
        np.asarray(plain.lines[2].get_ydata()), left.reshape(30, 3).mean(axis=1)
    )
    scaled = 1e3 * (curve.force - curve.sample_factor * curve.model)
    np.testing.assert_allclose(np.asarray(own.lines[1].get_ydata()), scaled)
    assert plain.get_ylabel() == "Measured \u2212 model (mN)"
