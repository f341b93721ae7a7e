"""Measured curves, what they are compared with, and what a calibration predicts."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from labpipe.mechanics.wire.calibration.calibrate_wire import (
    Settings,
    calibrate,
    find_tested_curvature,
    predict,
)
from labpipe.mechanics.wire.calibration.measured_curves import (
    MeasuredCurve,
    compare_curves,
    compare_with_model,
    compute_curve_errors,
    compute_lag_one_correlation,
    compute_runs_p,
    compute_shared_errors,
    select_usable_curves,
    whiten,
)
from labpipe.records.arrays import Floats
from labpipe.records.wire import (
    Calibration,
    CalibrationFailure,
    ExternalCurve,
    NoiseLevels,
    Prediction,
    Solution,
)
from tests.approved import Approve
from tests.builders.loading_tests import (
    TRUTH,
    exact_curve,
    measured,
    memory_noise,
    rig_of,
    wire_of,
)

CURVE = MeasuredCurve("A2", "t", "s", 0.085, np.linspace(0, 0.05, 5), np.arange(5.0), 0.002)


def test_a_curve_is_frozen_and_its_noise_spread() -> None:
    assert CURVE.noise == pytest.approx(np.full(5, 0.002))
    assert CURVE.peak == 4.0
    assert CURVE.point_error == pytest.approx(0.002)
    assert replace(CURVE, zero_error=0.1).point_error == pytest.approx(np.hypot(0.1, 0.002))
    point_error = replace(CURVE, offset_error=1e-3).point_error
    assert point_error == pytest.approx(np.hypot(1e-3 * 4.0 / 0.05, 0.002))
    force = np.array([0.0, 1.0, np.nan, 3.0, 4.0])
    empty = replace(CURVE, force=np.full(5, np.nan))
    usable = select_usable_curves((replace(CURVE, force=force), empty))
    assert isinstance(usable, tuple)
    assert [len(curve.force) for curve in usable] == [4]
    with pytest.raises(ValueError, match="read-only"):
        CURVE.force[0] = 1.0
    with pytest.raises(ValueError, match=r"expected force of shape \(5,\), found \(4,\)"):
        replace(CURVE, force=np.zeros(4), noise=np.ones(5))


def test_whitening_undoes_memory() -> None:
    noise = memory_noise(np.random.default_rng(1), 40_000, 0.8)
    white = whiten(noise, 0.8)
    assert float(white[1:] @ white[:-1]) / float(white @ white) == pytest.approx(0.0, abs=0.015)
    assert white.std() == pytest.approx(1.0, abs=0.015)
    assert whiten(noise, 0.0) is noise


def test_agreement_takes_the_sample_s_factor_out_of_residuals_only() -> None:
    model = np.linspace(0.0, 1.0, 50)
    noise = 0.01 * (1.0 + model)
    force = 1.1 * model + noise * (-1.0) ** np.arange(50)
    curve = MeasuredCurve("A2", "t", "s", 0.085, 0.05 * model, force, noise)
    agreement = compare_with_model(curve, model, 1.1)
    assert agreement.sse == pytest.approx(float((force - model) @ (force - model)))
    assert agreement.lag_one_correlation == pytest.approx(-0.98)
    assert agreement.sample_factor == 1.1
    assert agreement.runs_p < 1e-6


OTHER = np.linspace(0.001, 0.05, 50)

LINE = 2.0 * OTHER

BAND = (LINE - 0.004, LINE + 0.004)

D = np.linspace(0.0, 0.05, 21)


@pytest.fixture(scope="module")
def calibration() -> Calibration:
    outcome = calibrate(wire_of("A2"), measured(n=90, seed=5), Settings(gain=0.005))
    assert isinstance(outcome, Calibration)
    return outcome


def test_another_wire_and_length(calibration: Calibration) -> None:
    curve = predict(calibration, wire_of("A3"), 0.12, D, rig=rig_of(0.12), noise=0.002)
    exact = exact_curve("A3", 0.12)(D)
    assert np.all((curve.lower_mean <= exact) & (exact <= curve.upper_mean))
    assert np.all(curve.lower <= curve.lower_mean)
    assert np.all(curve.upper_mean <= curve.upper)
    assert curve.notes == ()


def test_what_widens_a_band(calibration: Calibration) -> None:
    def half(**more: float) -> float:
        prediction = predict(calibration, wire_of("A2"), 0.085, D, rig=rig_of(0.085), **more)
        return float(prediction.upper[-1] - prediction.force[-1])

    assert half(noise=0.01) > half(noise=0.002) > half()


def test_what_is_refused(approved: Approve) -> None:
    empty, force = replace(CURVE, force=np.full(5, np.nan)), np.array([np.nan])
    refused = [
        (empty, empty),
        (CURVE, replace(CURVE, wire="A3")),
        (replace(CURVE, noise=0.0),),
        (replace(CURVE, noise=np.array([1.0, 1.0, np.nan, 1.0, 1.0])),),
        (replace(CURVE, length=0.07),),
        (replace(CURVE, deflection=-1.0 - CURVE.deflection),),
    ]
    lines = []
    for curves in refused:
        failure = select_usable_curves(curves)
        assert isinstance(failure, CalibrationFailure)
        lines.append(f"{failure.code}: {failure.message}")
    with pytest.raises(ValueError, match="no point has both a measured and a modelled force"):
        compute_curve_errors(force, force)
    approved(lines)


def test_errors_of_the_source_s_table() -> None:
    force, model = np.array([1.0, 2.0, np.nan, 4.0]), np.array([1.0, 1.0, 5.0, 2.0])
    errors = compute_curve_errors(force, model)
    assert (errors.n, errors.sse) == (3, 5.0)
    assert errors.rmse == pytest.approx(np.sqrt(5.0 / 3.0))
    assert errors.rmse_share == pytest.approx(np.sqrt(5.0 / 3.0) / 4.0)
    assert np.isnan(errors.coverage)
    ramp, upper = np.arange(1.0, 5.0), np.array([2.0, 3.0, 4.0, 3.9])
    assert compute_curve_errors(ramp, ramp, ramp - 1.0, upper).coverage == 0.75


def test_signs_and_neighbours_of_residuals() -> None:
    """5 % of random rows have a p-value of the runs test below 0.05."""
    generator = np.random.default_rng(5)
    ps = np.array([compute_runs_p(generator.normal(size=100)) for _ in range(2000)])
    assert np.mean(ps < 0.05) == pytest.approx(0.05, abs=0.015)
    assert [compute_runs_p(np.ones(n)) for n in (1, 9)] == [1.0, 2.0**-8]
    assert compute_runs_p(np.array([1.0, -1.0])) == 1.0
    # two runs, of a mean of 4 and a variance of 1.2
    two_runs = compute_runs_p(np.array([1.0, 1.0, 1.0, -1.0, -1.0, -1.0]))
    assert two_runs == pytest.approx(math.erfc(2.0 / math.sqrt(2.4)))
    assert compute_runs_p(np.repeat([1.0, -1.0], 50)) < 1e-10
    assert compute_lag_one_correlation(np.array([1.0, -1.0, 1.0, -1.0])) == -0.75
    assert compute_lag_one_correlation(np.zeros(5)) == 0.0


def test_external_curves() -> None:
    """Nothing is extrapolated: of six points three are compared, a fourth lies off the band."""
    at = np.array([0.0, 0.01, 0.02, 0.03, 0.04, 0.0501, 0.09])
    off = np.array([9.0, 0.003, -0.003, 0.005, 0.0, 9.0, 9.0])
    for band, share in ((BAND, 0.75), (None, np.nan), ((np.full(50, np.nan),) * 2, np.nan)):
        matched = compare_curves(external(at, 2.0 * at + off), OTHER, LINE, band, "the tests")
        assert matched.n_excluded == 3
        expected = [np.nan, 0.02, 0.04, 0.06, 0.08, np.nan, np.nan]
        np.testing.assert_allclose(matched.reference, expected, rtol=1e-12)
        assert matched.errors is not None
        assert matched.errors.n == 4
        assert matched.errors.coverage == pytest.approx(share, nan_ok=True)
        rmse = np.sqrt((0.003**2 + 0.003**2 + 0.005**2) / 4.0)
        assert matched.errors.rmse == pytest.approx(rmse, rel=1e-12)
        assert matched.errors.rmse_share == pytest.approx(rmse / 0.08, rel=1e-12)
    few = compare_curves(external(at[4:], at[4:]), OTHER, LINE, BAND, "the tests")
    assert (few.errors, few.n_excluded) == (None, 3)


def test_words_of_what_is_not_compared(approved: Approve) -> None:
    rows = [np.array([0.0, 0.01, 0.02, 0.03, 0.09]), np.array([0.04, 0.05, 0.06])]
    lines = [
        compare_curves(external(at, at), OTHER, LINE, BAND, "the tests").explanation for at in rows
    ]
    none = np.zeros(0)
    empty = compare_curves(external(OTHER, LINE), none, none, (none, none), "the tests")
    assert empty.errors is None
    approved([*lines, empty.explanation])


def test_bands_of_two_solutions(calibration: Calibration) -> None:
    """The second as far as its own likelihood allows; the curve is that of the first."""

    def predicted(*solutions: Solution) -> Prediction:
        chosen = replace(calibration, solutions=solutions)
        return predict(chosen, wire_of("A2"), 0.085, D)

    first = calibration.solutions[0]
    stiff = replace(first, values=np.array([1.0, 1.3, 1.0]) * first.values)
    of_first, of_stiff, equal = predicted(first), predicted(stiff), predicted(first, stiff)
    assert equal.force == pytest.approx(of_first.force)
    assert equal.lower_mean == pytest.approx(of_first.lower_mean)
    assert equal.upper_mean == pytest.approx(of_stiff.upper_mean)
    assert equal.upper == pytest.approx(of_stiff.upper)
    assert "two_solutions" in [note.code for note in equal.notes]
    less = predicted(first, replace(stiff, rise=0.75 * first.limit))
    half = 0.5 * (of_stiff.upper_mean + of_stiff.force)
    assert less.upper_mean[1:] == pytest.approx(half[1:])
    beyond_limit = predicted(first, replace(stiff, rise=1.1 * first.limit))
    assert beyond_limit.upper == pytest.approx(of_first.upper)


def test_what_a_prediction_lacks(calibration: Calibration) -> None:
    """Nominal numbers where the calibration has none; levels of one sample; a law that ends."""
    empty = replace(calibration.solutions[0], values=np.full(3, np.nan))
    nominal = predict(replace(calibration, solutions=(empty,)), wire_of("A2"), 0.085, D)
    exact = exact_curve("A2", 0.085, has_string=False)(D)
    assert nominal.force == pytest.approx(exact, abs=1e-5)
    levels = NoiseLevels(1.0, 0.0, 0.0, 0.005, 0.0, 100.0)
    first = replace(calibration.parameters[0], is_open_below=True, explanation="phi is open")
    doubtful = replace(calibration, levels=levels, parameters=(first, *calibration.parameters[1:]))
    notes = predict(doubtful, wire_of("A2"), 0.085, D).notes
    assert [note.code for note in notes] == ["one_sample", "not_identified"]
    assert notes[1].message.startswith("phi is open; ")
    with pytest.raises(ValueError, match=r"deflection=0.05 m: .* ends at 0.04"):
        predict(calibration, wire_of("A2"), 0.06, D)
    with pytest.raises(ValueError, match=r"deflection=0.05 m: .* ends at 0.04"):
        find_tested_curvature(wire_of("A2"), TRUTH, [replace(CURVE, length=0.06)])


def test_a_band_contains_its_curve(calibration: Calibration) -> None:
    """Quantiles of a mixture that lies on one side of the fit have the same sign."""
    first = calibration.solutions[0]
    for shift in (5.0, -5.0):
        shifts = np.sign(shift) * np.abs(first.mixture.shift) + shift
        shifted = replace(first, mixture=replace(first.mixture, shift=shifts))
        band = predict(replace(calibration, solutions=(shifted,)), wire_of("A2"), 0.085, D)
        near, far = (band.lower_mean, band.upper_mean)[:: int(np.sign(shift))]
        assert near == pytest.approx(band.force)
        assert np.all(np.abs(far - band.force)[1:] > band.force[1:])


def external(deflection: Floats, force: Floats) -> ExternalCurve:
    return ExternalCurve("fe", "fe.csv", "A2", 0.085, deflection, force)


def test_errors_that_points_or_curves_share() -> None:
    """Four curves alike count a shared scale twice each, what is their own once."""
    curve = replace(CURVE, zero_error=0.1, offset_error=2e-3, scale_error=0.01)
    slope = np.array([1.0, 2.0, 3.0, 4.0, 5.0])
    zero, place, scale = compute_shared_errors(curve, slope)
    assert zero == pytest.approx(np.full(5, 0.1))
    assert place == pytest.approx(2e-3 * slope)
    assert scale == pytest.approx(0.01 * curve.deflection * slope)
    assert not compute_shared_errors(CURVE, slope).any()
    alike = select_usable_curves((replace(CURVE, scale_error=0.01, curve_scale_error=0.015),) * 4)
    assert not isinstance(alike, CalibrationFailure)
    scale = compute_shared_errors(alike[0], slope)[2]
    np.testing.assert_allclose(scale, 0.025 * alike[0].deflection * slope)
