"""Calibration end to end, in memory: what it says, and what it says of bad input."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.records.wire_calibration import (
    Calibration,
    CalibrationFailure,
    Identified,
    ParameterChoice,
)
from labpipe.wire.calibration.calibrate_wire import MeasuredCurve, Settings, Wire, calibrate
from tests.builders.loading_tests import TRUTH, measured, wire_of

WIRE = wire_of("A2")
THREE = measured(lengths=(0.085, 0.12), samples=2, n=120, seed=8)
FIXED = ParameterChoice(is_fixed=True)


def calibrated(
    curves: tuple[MeasuredCurve, ...], settings: Settings | None = None, wire: Wire = WIRE
) -> Calibration:
    found = calibrate(wire, curves, settings)
    assert isinstance(found, Calibration), found
    return found


def codes(calibration: Calibration) -> list[str]:
    return [note.code for note in calibration.notes]


@pytest.fixture(scope="module")
def usual() -> Calibration:
    return calibrated(THREE, Settings(gain=0.005))


def test_values_lie_in_intervals_near_the_truth(usual: Calibration) -> None:
    for parameter, truth in zip(usual.parameters, TRUTH, strict=True):
        assert parameter.interval is not None
        assert parameter.interval.lower < parameter.value < parameter.interval.upper
        assert abs(np.log(parameter.value / truth)) < 4.0 * parameter.log_error
        assert parameter.profiles[0].deviance.min() == 0.0
    assert usual.parameter("insulation_modulus").verdict is Identified.WELL
    assert usual.parameter("radial_friction").verdict in {Identified.WEAKLY, Identified.NOT}


def test_the_three_friction_numbers_are_not_told_apart(usual: Calibration) -> None:
    friction = usual.friction_separability
    assert friction is not None
    assert not any(friction.are_identified.values())
    assert friction.singular_values[1] < 1e-3 * friction.singular_values[0]
    assert "cannot be told apart" in friction.words
    assert all(usual.separability.are_identified.values())


def test_numbers_of_the_fit(usual: Calibration) -> None:
    assert usual.wire == "A2"
    assert (usual.n_points, usual.n_samples, len(usual.curves)) == (480, 4, 4)
    assert usual.sse == pytest.approx(sum(curve.sse for curve in usual.curves))
    assert usual.rmse == pytest.approx(np.sqrt(usual.sse / 480))
    assert usual.rmse_share == pytest.approx(usual.rmse / max(curve.peak for curve in THREE))
    assert np.diag(usual.correlations) == pytest.approx(np.ones(3))
    assert usual.levels.noise_factor == pytest.approx(1.0, abs=0.1)
    assert usual.levels.gain == 0.005
    assert usual.levels.scatter_freedom < 10.0
    assert usual.levels.noise_freedom > 400.0
    assert set(codes(usual)) <= {"not_identified"}


def test_fixed_parameters() -> None:
    found = calibrated(THREE, Settings({"copper_scale": FIXED, "insulation_modulus": FIXED}))
    copper = found.parameter("copper_scale")
    assert copper.interval is None
    assert copper.verdict is Identified.FIXED
    assert copper.words == "the strength of the copper was held at 1"
    assert np.isnan(found.correlations[2]).all()
    assert found.solutions[0].covariance[1, 1] == 0.0


def test_a_prior_that_says_most() -> None:
    choice = ParameterChoice(1.0, factor=1.02)
    found = calibrated(THREE, Settings({"copper_scale": choice}, gain=0.005))
    copper = found.parameter("copper_scale")
    assert copper.verdict is Identified.BY_PRIOR
    assert copper.conflict is not None
    assert not copper.conflict.contradicts


def test_a_prior_that_contradicts() -> None:
    choice = ParameterChoice(1.6, factor=1.05)
    found = calibrated(THREE, Settings({"copper_scale": choice}, gain=0.005))
    conflict = found.parameter("copper_scale").conflict
    assert conflict is not None
    assert conflict.contradicts
    assert conflict.size > 3.0
    assert conflict.alone == pytest.approx(1.0, abs=0.25)
    note = next(note for note in found.notes if note.code == "prior_contradicts_data")
    assert "the prior of the strength of the copper, 1.6 within a factor of 1.05" in note.message
    assert f"{conflict.size:.2f} standard errors of both together" in note.message


def test_bad_input() -> None:
    other = replace(THREE[0], wire="A3")
    mixed = calibrate(WIRE, (THREE[1], other))
    assert mixed == CalibrationFailure(
        "wires_mixed", "curves of 2 wires: A2, A3; one wire is calibrated"
    )
    none = calibrate(WIRE, ())
    assert none == CalibrationFailure(
        "no_sample_usable", "none of 0 curves has a point with deflection and force"
    )


def test_a_model_that_cannot_follow(monkeypatch: pytest.MonkeyPatch) -> None:
    from labpipe.wire.calibration import measured_curves as data

    monkeypatch.setattr(data, "DEEPEST", 0.95)
    deep = replace(THREE[0], length=0.055, rig=None)
    found = calibrate(WIRE, (deep,), Settings({"copper_scale": FIXED}))
    assert isinstance(found, CalibrationFailure)
    assert found.code == "model_cannot_follow"
    assert found.message.startswith(
        "the model cannot follow the curves at any of the starts; at the first: "
        "deflection=0.05 m: the curve ends at 0.0379"
    )


def test_everything_fixed_is_a_comparison() -> None:
    names = ("radial_friction", "insulation_modulus", "copper_scale")
    found = calibrated(THREE, Settings(dict.fromkeys(names, FIXED)))
    assert [parameter.interval for parameter in found.parameters] == [None] * 3
    assert not found.solutions[0].covariance.any()
    assert found.rmse < 0.02
