"""Calibrations of synthetic tests that figures and workbooks are tested with."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

import numpy as np

from labpipe.mechanics.wire.calibration.calibrate_wire import (
    MeasuredCurve,
    Settings,
    calibrate,
    predict,
)
from labpipe.mechanics.wire.calibration.measured_curves import compute_curve_errors
from labpipe.records.group import SampleCurve
from labpipe.records.wire import (
    Calibration,
    ParameterChoice,
    Prediction,
)
from labpipe.report.calibration_report import BentShape, CalibrationReport, ValidationGroup
from labpipe.statistics.groups import compute_band, interpolate_curves
from tests.builders.loading_tests import measured, rig_of, wire_of

LENGTHS = (0.085, 0.12)
GRID = np.linspace(0.0, 0.05, 21)
TESTS = measured(lengths=LENGTHS, samples=2, n=90, seed=11)
_FIXED = ParameterChoice(is_fixed=True)


def _calibrated(
    curves: tuple[MeasuredCurve, ...], settings: Settings, wire: str = "A2"
) -> Calibration:
    calibration = calibrate(wire_of(wire), curves, settings)
    assert isinstance(calibration, Calibration)
    return calibration


@cache
def usual() -> Calibration:
    """Two samples at each of two lengths; nothing is fixed."""
    return _calibrated(TESTS, Settings(gain=0.005))


@cache
def troubled() -> Calibration:
    """Insulation fixed, a prior that contradicts, friction open below."""
    prior = ParameterChoice(1.6, factor=1.05)
    choices = {"copper_scale": prior, "insulation_modulus": _FIXED}
    return _calibrated(TESTS[:2], Settings(choices, gain=0.005))


@cache
def predicted(name: str = "A2", length: float = 0.085) -> Prediction:
    return predict(usual(), wire_of(name), length, GRID, rig=rig_of(length), noise=0.002)


@cache
def group(name: str = "A2", length: float = 0.085, *, samples: int = 2) -> ValidationGroup:
    tests = measured(name, (length,), samples=samples, n=90, seed=3)
    band = compute_band(interpolate_curves([(test.deflection, test.force) for test in tests]))
    model = predicted(name, length)
    force, lower, upper = (
        np.interp(band.displacement, GRID, curve)
        for curve in (model.force, model.lower, model.upper)
    )
    return ValidationGroup(
        wire=name,
        length=length,
        is_calibrated=name == "A2",
        samples={test.test: SampleCurve(test.deflection, test.force, test.force) for test in tests},
        band=band,
        prediction=model,
        errors=compute_curve_errors(band.mean, force, lower, upper),
    )


def shape(deflection: float) -> BentShape:
    """A parabola, with one marker that was not seen."""
    x = np.linspace(0.0, 0.08, 9)
    points = np.column_stack([x, deflection * (x / x[-1]) ** 2])
    markers, up = points.copy(), np.array([0.0, 1e-4])
    markers[3] = np.nan
    return BentShape(deflection, markers, points + up, points + 2.0 * up)


def shapes() -> Mapping[str, tuple[BentShape, ...]]:
    return {"A2, 85 mm": tuple(shape(float(tip)) for tip in np.linspace(0.005, 0.05, 6))}


@cache
def report() -> CalibrationReport:
    """All of it: two lengths of the wire itself, and two other wires."""
    other_wires = (group("A1"), group("A3", 0.12, samples=1))
    return CalibrationReport(usual(), (group(), group("A2", 0.12), *other_wires), shapes())


@cache
def two_solutions() -> Calibration:
    """Two valleys: hard copper with half the insulation fits as well as the truth."""
    return _calibrated(measured("A3", (0.12,), seed=1), Settings(gain=0.005), "A3")
