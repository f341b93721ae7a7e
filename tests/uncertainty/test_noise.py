"""Noise of residuals and stretches, and linear fits in correlated noise."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats
from scipy.fft import dct
from scipy.linalg import toeplitz
from scipy.signal import lfilter

from labpipe.records.arrays import Floats
from labpipe.uncertainty.autocorrelation import (
    SpectrumLikelihood,
    SpectrumPosterior,
    _compute_half_widths,
    build_polynomial_basis,
    choose_processes,
    compute_covariance,
    cut_smooth_stretches,
    estimate_fast_noise,
    estimate_long_run_variance,
    fit_linear,
    orthonormalise,
    scale_limit_by_noise,
)


def test_long_run_variance() -> None:
    """White noise has its plain one; that of AR(1) is s^2 / (1 - a)^2 = 4 as well."""
    kicks = np.random.default_rng(1).normal(size=(100, 2000))
    for rows in (2.0 * kicks, lfilter([1.0], [1.0, -0.5], kicks)):
        variances = [estimate_long_run_variance(row, n_parameters=1) for row in rows]
        assert np.mean(variances) == pytest.approx(4.0, rel=0.08)
    # Residuals that alternate have next to none: half of the plain one is kept.
    alternating = np.append(np.tile([1.0, -1.0], 50), np.nan)
    variance = estimate_long_run_variance(alternating, n_parameters=2)
    assert variance == pytest.approx(0.5 * 100.0 / 98.0)
    assert np.isnan(estimate_long_run_variance(alternating[:4], n_parameters=2))


def test_fast_noise_does_not_see_the_curve() -> None:
    x = np.linspace(0.0, 1.0, 5000)
    noise = np.random.default_rng(2).normal(0.0, 0.02, len(x))
    assert estimate_fast_noise(10.0 * x**3 + noise) == pytest.approx(0.02, rel=0.03)
    assert estimate_fast_noise(x) == pytest.approx(0.0, abs=1e-12)


def test_limits_follow_the_noise_of_each_record() -> None:
    """One record of twice the noise among three: 3/4, 3/4 and 3/2 of what was set by them all."""
    row = np.random.default_rng(6).normal(0.0, 0.1, 400)
    rows = np.array([row, -row, 2.0 * row])
    rows[1, 7] = np.nan
    np.testing.assert_allclose(scale_limit_by_noise(0.4, rows), [0.3, 0.3, 0.6], rtol=1e-9)
    np.testing.assert_array_equal(scale_limit_by_noise(0.4, np.ones((2, 40))), [0.4, 0.4])


def noise(seed: int, count: int, memory: float) -> Floats:
    factor = np.exp(-1.0 / memory)
    kicks = np.random.default_rng(seed).normal(size=count + 200) * np.sqrt(1.0 - factor**2)
    return np.asarray(lfilter([1.0], [1.0, -factor], kicks)[200:], dtype=np.float64)


def test_probable_spectra_and_their_covariances() -> None:
    """White, mirrored, remembering, and these on white floors; a window of twelve samples."""
    processes, angle, lags = choose_processes(100, 60), np.pi * np.arange(60) / 100.0, np.arange(12)
    times = np.geomspace(100.0 / 240.0, 20.0, 23)
    a = np.exp(-1.0 / times)[:, None]
    slow = (1.0 - a) ** 2 / (1.0 - 2.0 * a * np.cos(angle) + a**2)
    white = (lags == 0).astype(float)
    mirrored = ((1.0 + a**2) * white - a * (lags == 1)) / (1.0 - a) ** 2
    remembering = (1.0 - a) / (1.0 + a) * a**lags
    floors = (0.003, 0.01, 0.03, 0.1, 0.3)
    spectra = [np.ones((1, 60)), 1.0 / slow, slow, *(f + (1.0 - f) * slow for f in floors)]
    on_floors = [f * white + (1.0 - f) * remembering for f in floors]
    covariances = np.vstack([white, mirrored, remembering, *on_floors])
    prior = (times / times[0]) ** -0.4
    assert processes.correlation_time[24:47] == pytest.approx(times)
    assert processes.prior == pytest.approx(
        np.concatenate([[1.0], prior, prior / 2.0, np.tile(prior / 10.0, 5)])
    )
    values, cubics, short = noise(3, 100, 5.0), *(build_polynomial_basis(n, 4).T for n in (100, 12))
    stretch = SpectrumLikelihood.from_values(cubics, values, processes, 60)
    np.testing.assert_allclose(stretch.spectra, np.vstack(spectra), rtol=1e-9)
    found = compute_covariance(short, processes)
    expected = [short @ toeplitz(row) @ short.T for row in covariances]
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12)
    # Generalised least squares by dense matrices, of the cosines that are used.
    waves = dct(np.vstack([cubics, values]), norm="ortho")[:, :60]
    for number, spectrum in enumerate(stretch.spectra):
        weighted = waves / spectrum
        products = weighted @ waves.T
        unit = np.linalg.inv(products[:4, :4])
        shifts = unit @ products[:4, 4]
        logs = np.log(spectrum).sum() + np.linalg.slogdet(products[:4, :4])[1]
        beyond = spectrum[-1] * (np.eye(4) - waves[:4] @ waves[:4].T)
        plain = (waves[:4] * spectrum) @ waves[:4].T + beyond
        assert stretch.unit_covariance[number] == pytest.approx(unit)
        assert stretch.shifts[number, 0] == pytest.approx(shifts)
        assert stretch.squares[number] == pytest.approx(products[4, 4] - products[4, :4] @ shifts)
        assert stretch.log_determinant_term[number] == pytest.approx(-0.5 * logs)
        assert stretch.compute_least_squares_covariance()[number] == pytest.approx(plain)
    # Two stretches of one noise, the second twice as large.
    other = SpectrumLikelihood.from_values(cubics, 2.0 * noise(4, 100, 5.0), processes, 60)
    posterior, squares = (
        SpectrumPosterior.combine([stretch, other], processes.prior),
        stretch.squares + other.squares,
    )
    logs = stretch.log_determinant_term + other.log_determinant_term - 56.0 * np.log(squares)
    chances = processes.prior * np.exp(logs - logs.max())
    np.testing.assert_allclose(posterior.probabilities, chances / chances.sum(), rtol=1e-9)
    np.testing.assert_allclose(posterior.variances, squares / 112.0)
    assert posterior.dof == 112


@pytest.mark.parametrize("count", [30, 9_999, 10_001])
def test_basis_is_orthonormal_and_spans_the_columns(count: int) -> None:
    x = np.linspace(-1.0, 1.0, count)
    design = np.column_stack([np.ones(count), 1e-3 * x, 40.0 * np.maximum(x - 0.2, 0.0)])
    basis, to_coefficients = orthonormalise(design)
    np.testing.assert_allclose(basis @ basis.T, np.eye(3), rtol=0, atol=1e-14)
    truth = np.array([2.0, -5e3, 0.3])
    np.testing.assert_allclose(to_coefficients @ (basis @ (design @ truth)), truth, rtol=1e-12)


def test_too_few_samples() -> None:
    with pytest.raises(ValueError, match="expected at least 6 samples for 2 coefficients, found 5"):
        fit_linear(np.ones((5, 2)), np.ones(5))
    with pytest.raises(ValueError, match="expected at least 3 samples for 2 coefficients, found 2"):
        fit_linear(np.eye(2), np.ones(2), other_stretches=[np.arange(100.0)])


def test_the_covariance_of_a_mixture_is_that_within_and_between() -> None:
    """Generalised least squares in each noise by dense matrices, weighted by its probability."""
    design = np.column_stack([np.ones(40), np.arange(40.0), np.arange(40) >= 25]).astype(float)
    values = noise(8, 40, 6.0)
    fit, processes = fit_linear(design, values, is_weighted=True), choose_processes(40, 40)
    basis = orthonormalise(design)[0]
    likelihood = SpectrumLikelihood.from_values(basis, values, processes, 40)
    posterior = SpectrumPosterior.combine([likelihood], processes.prior)
    columns, wave = dct(design.T, norm="ortho"), dct(values, norm="ortho")
    within, estimates = np.zeros((3, 3)), []
    for number, spectrum in enumerate(likelihood.spectra):
        inverse = np.linalg.inv((columns / spectrum) @ columns.T)
        estimates.append(inverse @ (columns / spectrum) @ wave)
        within += posterior.probabilities[number] * posterior.variances[number] * inverse
    between = np.cov(np.transpose(estimates), aweights=posterior.probabilities, ddof=0)
    assert np.trace(between) > 0.01 * np.trace(within)
    np.testing.assert_allclose(fit.coefficients, posterior.probabilities @ estimates, rtol=1e-7)
    np.testing.assert_allclose(fit.covariance, within + between, rtol=1e-6)


@pytest.mark.parametrize(("freedom", "offset"), [(2, 2.0), (40, 0.0)])
def test_half_widths_hold_95_percent_of_a_mixture(freedom: int, offset: float) -> None:
    """Of t-distributions of the deviations 1 and 3, the second perhaps moved aside."""
    noise = SpectrumPosterior(np.array([0.6, 0.4]), np.ones(2), freedom)
    deviations, offsets = np.array([1.0, 3.0]), np.array([0.0, offset])
    (half,) = _compute_half_widths(noise, deviations[:, None] ** 2, offsets[:, None])
    between = [stats.t.cdf((end * half - offsets) / deviations, freedom) for end in (-1.0, 1.0)]
    assert noise.probabilities @ (between[1] - between[0]) == pytest.approx(0.95, abs=1e-6)


def test_stretches_with_a_step_or_a_corner_are_left_out() -> None:
    values = 0.1 * noise(0, 820, 3.0) + 0.01 * np.arange(820.0)
    assert len(cut_smooth_stretches(values)) == 8
    values[500:] += 3.0
    values[650:] += 1.0 * np.arange(170.0)
    values[100] = np.nan
    stretches = cut_smooth_stretches(values)
    assert len(stretches) == 6
    assert all(len(stretch) == 100 for stretch in stretches)
    assert cut_smooth_stretches(values[:99]) == ()
