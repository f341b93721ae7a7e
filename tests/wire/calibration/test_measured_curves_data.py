from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.records.wire_calibration import CalibrationFailure
from labpipe.wire.calibration.measured_curves import MeasuredCurve, shared_errors, usable, whiten
from tests.builders.loading_tests import memory_noise

CURVE = MeasuredCurve("A2", "t", "s", 0.085, np.linspace(0, 0.05, 5), np.arange(5.0), 0.002)


def failure(*curves: MeasuredCurve) -> CalibrationFailure:
    found = usable(curves)
    assert isinstance(found, CalibrationFailure)
    return found


def test_a_curve_is_frozen_and_its_noise_spread() -> None:
    assert CURVE.noise == pytest.approx(np.full(5, 0.002))
    assert CURVE.peak == 4.0
    with pytest.raises(ValueError, match="read-only"):
        CURVE.force[0] = 1.0
    with pytest.raises(ValueError, match=r"expected an array of shape \(5,\), found \(4,\)"):
        replace(CURVE, force=np.zeros(4), noise=np.ones(5))


def test_points_without_a_number_are_left_out() -> None:
    force = CURVE.force.copy()
    force[2] = np.nan
    found = usable((replace(CURVE, force=force), replace(CURVE, force=np.full(5, np.nan))))
    assert isinstance(found, tuple)
    assert [len(curve.force) for curve in found] == [4]


def test_what_is_refused() -> None:
    empty = replace(CURVE, force=np.full(5, np.nan))
    assert failure(empty, empty) == CalibrationFailure(
        "no_sample_usable", "none of 2 curves has a point with deflection and force"
    )
    assert failure(CURVE, replace(CURVE, wire="A3")) == CalibrationFailure(
        "wires_mixed", "curves of 2 wires: A2, A3; one wire is calibrated"
    )
    assert failure(replace(CURVE, noise=0.0)) == CalibrationFailure(
        "noise_not_positive", "t: a noise of 0 mN; it must be positive"
    )
    assert failure(replace(CURVE, noise=np.array([1.0, 1.0, np.nan, 1.0, 1.0]))).code == (
        "noise_not_positive"
    )
    deep = failure(replace(CURVE, length=0.07))
    assert deep.code == "deflection_too_large"
    assert deep.message == (
        "t: a deflection of 50 mm on 70 mm; the first loading is followed to 0.65 of the length"
    )


def test_whitening_undoes_memory() -> None:
    noise = memory_noise(np.random.default_rng(1), 40_000, 0.8)
    white = whiten(noise, 0.8)
    assert float(white[1:] @ white[:-1]) / float(white @ white) == pytest.approx(0.0, abs=0.015)
    assert white.std() == pytest.approx(1.0, abs=0.015)
    assert whiten(noise, 0.0) is noise


def test_errors_that_all_points_share() -> None:
    curve = replace(CURVE, zero_error=0.1, place_error=2e-3, scale_error=0.01)
    slope = np.array([1.0, 2.0, 3.0, 4.0, 5.0])
    zero, place, scale = shared_errors(curve, slope)
    assert zero == pytest.approx(np.full(5, 0.1))
    assert place == pytest.approx(2e-3 * slope)
    assert scale == pytest.approx(0.01 * curve.deflection * slope)
    assert not shared_errors(CURVE, slope).any()


def test_what_one_point_is_off_by() -> None:
    assert CURVE.read_error == pytest.approx(0.002)
    assert replace(CURVE, zero_error=0.1).read_error == pytest.approx(np.hypot(0.1, 0.002))
    moved = replace(CURVE, place_error=1e-3).read_error
    assert moved == pytest.approx(np.hypot(1e-3 * 4.0 / 0.05, 0.002))


def test_a_scale_that_all_curves_share_does_not_average_out() -> None:
    one = replace(CURVE, scale_error=0.01)
    found = usable((one, one, one, one))
    assert isinstance(found, tuple)
    assert [curve.scale_error for curve in found] == pytest.approx([0.02] * 4)
    own = usable((replace(one, own_scale_error=0.015),) * 4)
    assert not isinstance(own, CalibrationFailure)
    slope = np.full(len(one.force), 2.0)
    scale = shared_errors(own[0], slope)[2]  # four alike count twice each, what is its own once
    np.testing.assert_allclose(scale, 0.025 * own[0].deflection * 2.0)
