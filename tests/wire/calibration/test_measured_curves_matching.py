from __future__ import annotations

import numpy as np
import pytest

from labpipe.records.arrays import Floats
from labpipe.records.wire_calibration import ExternalCurve
from labpipe.wire.calibration.measured_curves import match

OTHER = np.linspace(0.001, 0.05, 50)
LINE = 2.0 * OTHER
BAND = (LINE - 0.004, LINE + 0.004)


def third(deflection: Floats, force: Floats) -> ExternalCurve:
    return ExternalCurve("fe", "fe.csv", "A2", 0.085, deflection, force)


def test_errors_over_the_largest_force_of_the_other_curve() -> None:
    at = np.array([0.01, 0.02, 0.03, 0.04])
    found = match(third(at, 2.0 * at + [0.003, -0.003, 0.005, 0.0]), OTHER, LINE, BAND, "the tests")
    assert found.errors is not None
    rmse = np.sqrt((2 * 0.003**2 + 0.005**2) / 4)
    assert found.errors.rmse == pytest.approx(rmse, rel=1e-12)
    assert found.errors.rmse_share == pytest.approx(rmse / 0.08, rel=1e-12)
    assert found.errors.inside == 0.75
    assert (found.errors.n, found.left_out, found.words) == (4, 0, "")
    np.testing.assert_allclose(found.reference, 2.0 * at, rtol=1e-12)


def test_nothing_is_extrapolated() -> None:
    at = np.array([0.0, 0.01, 0.02, 0.03, 0.0501, 0.09])
    found = match(third(at, 2.0 * at), OTHER, LINE, BAND, "the tests")
    assert found.errors is not None
    assert (found.errors.n, found.left_out) == (3, 3)
    assert found.errors.rmse == pytest.approx(0.0, abs=1e-15)
    assert np.isnan(found.reference[[0, 4, 5]]).all()
    assert found.words == "3 of 6 points left out, outside of 1 to 50 mm, the range of the tests"


def test_fewer_than_three_points_are_not_compared() -> None:
    at = np.array([0.04, 0.05, 0.06])
    found = match(third(at, at), OTHER, LINE, BAND, "the model")
    assert found.errors is None
    assert found.left_out == 3
    assert found.words == (
        "2 of 3 points, from 40 to 60 mm, lie within 1 to 50 mm, the range of the model; 3 at least"
        " are needed"
    )


def test_no_band_no_share() -> None:
    at = np.array([0.01, 0.02, 0.03])
    unknown = np.full(len(OTHER), np.nan)
    for band in (None, (unknown, unknown)):
        found = match(third(at, 2.0 * at), OTHER, LINE, band, "the tests")
        assert found.errors is not None
        assert np.isnan(found.errors.inside)


def test_no_other_curve() -> None:
    nothing = np.zeros(0)
    found = match(third(OTHER, LINE), nothing, nothing, (nothing, nothing), "the tests")
    assert found.errors is None
    assert found.words == "no point was compared: there is no curve of the tests"
