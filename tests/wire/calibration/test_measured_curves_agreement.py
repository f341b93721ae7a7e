from __future__ import annotations

import numpy as np
import pytest

from labpipe.wire.calibration.measured_curves import (
    MeasuredCurve,
    agreement,
    curve_errors,
    lag_one,
    runs_p,
)


def test_errors_of_the_source_s_table() -> None:
    errors = curve_errors(np.array([1.0, 2.0, np.nan, 4.0]), np.array([1.0, 1.0, 5.0, 2.0]))
    assert (errors.n, errors.sse) == (3, 5.0)
    assert errors.rmse == pytest.approx(np.sqrt(5.0 / 3.0))
    assert errors.rmse_share == pytest.approx(np.sqrt(5.0 / 3.0) / 4.0)
    assert np.isnan(errors.inside)


def test_share_inside_a_band() -> None:
    force = np.array([1.0, 2.0, 3.0, 4.0])
    errors = curve_errors(force, force, force - 1.0, np.array([2.0, 3.0, 4.0, 3.9]))
    assert errors.inside == 0.75


def test_nothing_to_compare() -> None:
    with pytest.raises(ValueError, match="no point has both a measured and a modelled force"):
        curve_errors(np.array([np.nan]), np.array([1.0]))


def test_runs_against_counting() -> None:
    """The p-value of the runs test is that of all arrangements of signs, nearly."""
    generator = np.random.default_rng(5)
    ps = np.array([runs_p(generator.normal(size=100)) for _ in range(2000)])
    assert np.mean(ps < 0.05) == pytest.approx(0.05, abs=0.015)
    assert runs_p(np.ones(9)) == 0.0
    assert runs_p(np.array([1.0, -1.0])) == 1.0
    assert runs_p(np.repeat([1.0, -1.0], 50)) < 1e-10


def test_lag_one() -> None:
    assert lag_one(np.array([1.0, -1.0, 1.0, -1.0])) == -0.75
    assert lag_one(np.zeros(5)) == 0.0


def test_agreement_takes_the_sample_s_factor_out_of_residuals_only() -> None:
    model = np.linspace(0.0, 1.0, 50)
    force = 1.1 * model + 0.01 * (-1.0) ** np.arange(50)
    curve = MeasuredCurve("A2", "t", "s", 0.085, 0.05 * model, force, 0.01)
    found = agreement(curve, model, 1.1)
    assert found.sse == pytest.approx(float((force - model) @ (force - model)))
    assert found.lag_one == pytest.approx(-0.98)
    assert found.sample_factor == 1.1
    assert found.runs_p < 1e-6
