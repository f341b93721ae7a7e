"""The figure of a bundle's cycles: what is drawn, not how."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.figure import Figure

from labpipe.records.harness_bundle import BundleLoop, FrictionFit
from labpipe.report.bundle_loop_figure import loop_figure, plot_loop

DEFLECTION = np.array([0.0, 0.02, 0.01, 0.02, 0.01])
FORCE = np.array([0.0, 1.0, 0.1, 1.0, 0.1])
LOOP = BundleLoop(0.1, DEFLECTION, FORCE, np.array([0, 0, 1, 2, 3]), (1e-3, 0.2), 0.015)
FIT = FrictionFit(
    composite_share=0.13,
    slip_curvature=0.3,
    slide_curvature=4.5,
    held=0.2,
    held_lower=0.15,
    held_upper=0.26,
    loop=LOOP,
    predicted=1.1 * FORCE,
    is_held_out=np.array([False, False, False, True, True]),
    error_fitted=0.04,
    error_held_out=0.07,
    loss=2e-3,
    predicted_loss=2.2e-3,
)


def test_measured_and_predicted_in_mm_and_n() -> None:
    axes = Figure().subplots()
    plot_loop(FIT, FIT.is_held_out, {"color": "red"}, axes)
    measured, predicted = axes.lines[:2]
    assert np.asarray(measured.get_xdata()).tolist() == [20.0, 10.0]
    assert np.asarray(measured.get_ydata()).tolist() == [1.0, 0.1]
    assert np.asarray(predicted.get_ydata()) == pytest.approx([1.1, 0.11])
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("Deflection (mm)", "Force at the tip (N)")


def test_the_errors_are_said() -> None:
    page = loop_figure("TWB-1", FIT)
    said = " ".join(str(text.get_text()) for axes in page.axes for text in axes.texts)
    titles = " ".join(str(axes.get_title(loc)) for axes in page.axes for loc in ("left", "center"))
    assert "Fitted, error 4 % of the peak" in said + titles
    assert "Left out, error 7 % of the peak" in said + titles
    words = " ".join(str(text.get_text()).replace("\n", " ") for text in page.texts)
    assert "the tape slides from 15 mm on" in words
    assert "20.0 % of that is still held after the kink (95 %: 15.0 % to 26.0 %)" in words
    assert "2 mJ measured, 2.2 mJ predicted" in words
