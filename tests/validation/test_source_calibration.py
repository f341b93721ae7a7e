"""What the source's calibration makes of tests, and what a loading curve can tell (PHYSICS 6)."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.records.wire_calibration import Calibration, ParameterChoice
from labpipe.wire.calibration.calibrate_wire import Settings, calibrate
from tests.builders.loading_tests import PHI, measured, wire_of
from tests.judges.source_method import SourceCalibration, calibrate_as_source

WIRE = wire_of("A2")
FIXED = ParameterChoice(is_fixed=True)


def by_source(*, has_string: bool, shape: str = "series") -> SourceCalibration:
    # Hardly any noise: what is left of the truth is bias. At 2 mN one curve gives phi to 4 %.
    curves = measured(samples=1, scatter=0.0, gain=0.0, noise=1e-5, has_string=has_string)
    return calibrate_as_source(WIRE, curves, shape=shape)


def test_one_stiffness_for_the_whole_wire_asks_for_four_times_the_friction() -> None:
    """Made with phi = 0.15 x 0.31 = 0.0465 N; told 0.17 to 0.20."""
    found = by_source(has_string=False)
    assert pytest.approx(0.15 * 0.31) == PHI
    assert 0.17 < found.radial_friction < 0.20
    assert found.rmse < 0.001  # half the noise of a load cell: the fit looks good all the same


def test_the_string_that_the_source_leaves_out_asks_for_more() -> None:
    series = by_source(has_string=True)
    assert 0.20 < series.radial_friction < 0.26
    exact = by_source(has_string=True, shape="elastica")
    assert exact.radial_friction > series.radial_friction


def test_three_numbers_that_act_as_one() -> None:
    found = by_source(has_string=False)
    assert found.singular_values[0] > 10.0
    assert found.singular_values[1] < 1e-4
    # Over 2 mN in place of the misfit: about 10, as told in PHYSICS.
    assert 5.0 < found.singular_values[0] * found.rmse / 0.002 < 40.0


@pytest.mark.parametrize(
    ("fixed", "told"),
    [
        (("insulation_modulus", "copper_scale"), 0.12),
        (("copper_scale",), 0.25),
        ((), 0.50),
    ],
)
def test_error_of_phi_at_the_noise_of_the_lab(fixed: tuple[str, ...], told: float) -> None:
    """272 points, 2 mN white; PHYSICS says about 12, 25 and 50 %."""
    curves = measured(samples=1, scatter=0.0, gain=0.0, seed=2)
    found = calibrate(WIRE, curves, Settings(dict.fromkeys(fixed, FIXED), scatter=0.0))
    assert isinstance(found, Calibration)
    error = found.parameter("radial_friction").log_error
    phi = found.parameter("radial_friction").value
    assert error * phi / PHI == pytest.approx(told, rel=0.25)


def test_the_exact_model_finds_what_the_tests_were_made_with() -> None:
    curves = measured(samples=1, scatter=0.0, gain=0.0, noise=2e-5, seed=3)
    found = calibrate(WIRE, curves, Settings(scatter=0.0))
    assert isinstance(found, Calibration)
    values = [parameter.value for parameter in found.parameters]
    assert values == pytest.approx([PHI, 1e9, 1.0], rel=0.03)
    assert np.isfinite(found.sse)
