"""Variance of the mean of residuals that know their neighbours."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.uncertainty.noise import fast_noise, limits_by_noise, long_run_variance


def test_white_noise_has_its_plain_variance() -> None:
    found = [
        long_run_variance(np.random.default_rng(seed).normal(0, 2.0, 800), parameters=1)
        for seed in range(200)
    ]
    assert np.mean(found) == pytest.approx(4.0, rel=0.08)


def test_autoregressive_noise() -> None:
    rng, factor, found = np.random.default_rng(1), 0.5, []
    for _ in range(100):
        values = np.zeros(2000)
        for i, kick in enumerate(rng.normal(size=1999), start=1):
            values[i] = factor * values[i - 1] + kick
        found.append(long_run_variance(values, parameters=1))
    # Long-run variance of AR(1): s^2 / (1 - a)^2 = 4.
    assert np.mean(found) == pytest.approx(4.0, rel=0.1)


def test_too_few_residuals_are_nan() -> None:
    assert np.isnan(long_run_variance(np.zeros(4), parameters=2))


def test_nan_count_as_absent() -> None:
    values = np.random.default_rng(2).normal(size=100)
    with_gap = np.insert(values, 50, np.nan)
    assert long_run_variance(with_gap, parameters=1) == pytest.approx(
        long_run_variance(values, parameters=1)
    )


def test_fast_noise_does_not_see_the_curve() -> None:
    x = np.linspace(0.0, 1.0, 5000)
    noise = np.random.default_rng(2).normal(0.0, 0.02, len(x))
    assert fast_noise(10.0 * x**3 + noise) == pytest.approx(0.02, rel=0.03)
    assert fast_noise(x) == pytest.approx(0.0, abs=1e-12)


def test_fast_noise_of_many_records() -> None:
    rows = np.random.default_rng(5).normal(0.0, [[[0.1]], [[3.0]]], (2, 4, 330)).cumsum(axis=0)
    alone = [[float(fast_noise(row)) for row in plane] for plane in rows]
    np.testing.assert_allclose(fast_noise(rows), alone, rtol=1e-12)


def test_limits_follow_the_noise_of_each_record() -> None:
    """One record of twice the noise among three: 3/4, 3/4 and 3/2 of what was set by them all."""
    row = np.random.default_rng(6).normal(0.0, 0.1, 400)
    rows = np.array([row, -row, 2.0 * row])
    rows[1, 7] = np.nan
    np.testing.assert_allclose(limits_by_noise(0.4, rows), [0.3, 0.3, 0.6], rtol=1e-9)
    np.testing.assert_array_equal(limits_by_noise(0.4, np.ones((2, 40))), [0.4, 0.4])
