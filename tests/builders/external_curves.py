"""External curves compared with tests and model, of straight lines: numbers known by head."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from labpipe.mechanics.wire.calibration.measured_curves import compare_curves
from labpipe.records.group import Band
from labpipe.records.quality import QualityNote, Severity
from labpipe.records.wire import (
    CurveMatch,
    ExternalCurve,
    ExternalCurveComparison,
    Prediction,
)
from labpipe.report.calibration_report import ValidationGroup

GRID = np.linspace(0.0, 0.05, 51)
FORCE = 2.0 * GRID
"""Of the mean of the tests; the model lies 2 mN below."""
UNTESTED = QualityNote("external_curve_untested", Severity.INFO, "paper", "no test of B2 at 100 mm")


def third_group() -> ValidationGroup:
    band = Band(GRID, FORCE, FORCE - 0.004, FORCE + 0.004, FORCE - 0.01, FORCE + 0.01, 3, "samples")
    return ValidationGroup("A2", 0.085, is_calibrated=True, samples={}, band=band)


def third_model() -> Prediction:
    force = FORCE - 0.002
    ends = (force - 0.01, force + 0.01, force - 0.005, force + 0.005)
    return Prediction(GRID, force, *ends)


def external_comparison(
    name: str = "finite elements", *, is_normal: bool = False
) -> ExternalCurveComparison:
    """A curve above the mean of the tests by 1 mN, one of its points out of range."""
    at = np.linspace(0.01, 0.06, 6)
    curve = ExternalCurve(
        name, "fe.csv", "A2", 0.085, at, 2.0 * at + 0.001, is_normal, "synthetic elements"
    )
    band, model = third_group().band, third_model()
    ends = (model.lower_mean, model.upper_mean)
    tests = compare_curves(
        curve, band.displacement, band.mean, (band.lower, band.upper), "the tests"
    )
    note = QualityNote("external_curve_cut", Severity.INFO, name, tests.explanation)
    return ExternalCurveComparison(
        curve, tests, compare_curves(curve, GRID, model.force, ends, "the model"), model, (note,)
    )


def untested() -> ExternalCurveComparison:
    """A curve without tests."""
    whole = external_comparison("paper")
    curve = replace(whole.curve, wire="B2", length=0.1)
    return replace(whole, curve=curve, tests=None, notes=(UNTESTED,))


def unmodelled() -> ExternalCurveComparison:
    """A curve that the model does not reach."""
    lost = CurveMatch(np.full(6, np.nan), None, 6, "the model has no such curve: it ends earlier")
    return replace(external_comparison(), model=lost, prediction=None)
