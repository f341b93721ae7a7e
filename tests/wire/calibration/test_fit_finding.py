from __future__ import annotations

from dataclasses import replace

import numpy as np

from labpipe.records.wire_calibration import CalibrationFailure
from labpipe.wire.calibration.fit import Found, Settings, find
from tests.builders.loading_tests import TRUTH, measured, wire_of

WIRE = wire_of("A2")


def test_the_truth_is_found() -> None:
    found = find(WIRE, measured(noise=1e-5, scatter=0.0, gain=0.0, n=60), Settings(scatter=0.0))
    assert isinstance(found, Found)
    assert np.abs(found.fit.point.logs - np.log(TRUTH)).max() < 0.02
    assert found.is_scatter_known


def test_failures_are_handed_on() -> None:
    curve = measured(samples=1, n=20)[0]
    mixed = find(WIRE, [curve, replace(curve, wire="A3")], Settings())
    assert isinstance(mixed, CalibrationFailure)
    assert mixed.code == "wires_mixed"
    few = find(
        WIRE, [replace(curve, deflection=np.zeros(1), force=np.zeros(1), noise=1.0)], Settings()
    )
    assert isinstance(few, CalibrationFailure)
    assert few.code == "too_few_points"
