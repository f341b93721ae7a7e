"""Linear fits in correlated noise."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from labpipe.records.arrays import Floats
from labpipe.uncertainty.linear_fits import _half_widths, fit_linear, orthonormal
from labpipe.uncertainty.noise import Noise


def columns(count: int) -> Floats:
    x = np.linspace(-1.0, 1.0, count)
    return np.column_stack([np.ones(count), 1e-3 * x, 40.0 * np.maximum(x - 0.2, 0.0)])


@pytest.mark.parametrize("count", [30, 9_999, 10_001, 60_000])
def test_basis_is_orthonormal_and_spans_the_columns(count: int) -> None:
    design = columns(count)
    basis, to_coefficients = orthonormal(design)
    np.testing.assert_allclose(basis @ basis.T, np.eye(3), rtol=0, atol=1e-14)
    wanted = np.array([2.0, -5e3, 0.3])
    found = to_coefficients @ (basis @ (design @ wanted))
    np.testing.assert_allclose(found, wanted, rtol=1e-12)


def test_basis_of_columns_that_nearly_depend_on_each_other() -> None:
    design = np.column_stack([columns(20_000), columns(20_000)[:, 1] + 1e-9])
    basis, _ = orthonormal(design)
    np.testing.assert_allclose(basis @ basis.T, np.eye(4), rtol=0, atol=1e-14)


def test_exact_model_has_no_error() -> None:
    x = np.linspace(-1.0, 1.0, 50)
    fit = fit_linear(np.column_stack([np.ones(50), x]), 2.0 + 3.0 * x)
    assert fit.coefficients == pytest.approx([2.0, 3.0], rel=1e-12)
    assert np.all(fit.half_widths < 1e-12)


def test_scale_of_values_and_columns_carries_over() -> None:
    x, noise = np.linspace(0.0, 1.0, 80), np.random.default_rng(1).normal(size=80)
    one = fit_linear(np.column_stack([np.ones(80), x]), x + noise)
    other = fit_linear(np.column_stack([np.ones(80), 1e-3 * x]), 5.0 * (x + noise))
    assert other.half_widths == pytest.approx(one.half_widths * [5.0, 5e3], rel=1e-6)


def test_slow_noise_widens_more_than_the_textbook_says() -> None:
    x = np.linspace(-1.0, 1.0, 400)
    slow = np.cumsum(np.random.default_rng(2).normal(size=400)) * 0.1
    fit = fit_linear(np.column_stack([np.ones(400), x]), slow)
    assert fit.half_widths[1] > 4.0 * fit.classical_errors[1]


def test_weighted_finds_a_jump_in_slow_noise_more_closely() -> None:
    kicks = np.random.default_rng(3).normal(size=120)
    noise = np.zeros(120)
    for i in range(1, 120):
        noise[i] = 0.95 * noise[i - 1] + kicks[i]
    jump = (np.arange(120) >= 60).astype(np.float64)
    design = np.column_stack([np.ones(120), np.linspace(-1, 1, 120), jump])
    plain, weighted = (fit_linear(design, 5.0 * jump + noise, weighted=w) for w in (False, True))
    assert weighted.half_widths[2] < 0.7 * plain.half_widths[2]


def test_too_few_samples() -> None:
    with pytest.raises(ValueError, match="expected at least 6 samples for 2 coefficients, found 5"):
        fit_linear(np.ones((5, 2)), np.ones(5))
    with pytest.raises(ValueError, match="expected at least 3 samples for 2 coefficients, found 2"):
        fit_linear(np.eye(2), np.ones(2), beside=[np.arange(100.0)])


@pytest.mark.parametrize("freedom", [2, 5, 40])
@pytest.mark.parametrize("offset", [0.0, 2.0])
def test_half_widths_hold_95_percent_of_a_mixture(freedom: int, offset: float) -> None:
    """Of t-distributions of the deviations 1 and 3, the second perhaps moved aside."""
    noise = Noise(np.array([0.6, 0.4]), np.ones(2), freedom)
    deviations, offsets = np.array([1.0, 3.0]), np.array([0.0, offset])
    (half,) = _half_widths(noise, deviations[:, None] ** 2, offsets[:, None])
    between = [stats.t.cdf((end * half - offsets) / deviations, freedom) for end in (-1.0, 1.0)]
    assert noise.chances @ (between[1] - between[0]) == pytest.approx(0.95, abs=1e-6)


def test_the_residual_deviation_is_that_of_the_textbook() -> None:
    """Of 40 samples and a line, 38 degrees of freedom are left."""
    x, noise = np.linspace(0.0, 1.0, 40), np.random.default_rng(4).normal(size=40)
    fit = fit_linear(np.column_stack([np.ones(40), x]), x + noise)
    line = stats.linregress(x, x + noise)
    left = x + noise - line.intercept - line.slope * x
    assert fit.residual_deviation == pytest.approx(np.sqrt(np.sum(left**2) / 38.0))
    assert fit.classical_errors == pytest.approx([line.intercept_stderr, line.stderr])
