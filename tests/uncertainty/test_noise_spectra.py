"""What stretches of a signal say of its noise."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.fft import dct
from scipy.linalg import toeplitz
from scipy.signal import lfilter
from scipy.stats import binomtest

from labpipe.records.arrays import Floats
from labpipe.uncertainty.linear_fits import fit_linear
from labpipe.uncertainty.noise import (
    Evidence,
    Grid,
    Noise,
    cubic_basis,
    exact_covariance,
    slowest_cosines,
    smooth_stretches,
)


def noise(seed: int, count: int, memory: float) -> Floats:
    factor = np.exp(-1.0 / memory)
    kicks = np.random.default_rng(seed).normal(size=count + 200) * np.sqrt(1.0 - factor**2)
    return np.asarray(lfilter([1.0], [1.0, -factor], kicks)[200:], dtype=np.float64)


def test_cubics_are_orthonormal() -> None:
    basis = cubic_basis(40)
    assert basis.shape == (4, 40)
    assert basis @ basis.T == pytest.approx(np.eye(4), abs=1e-12)


@pytest.mark.parametrize("count", [5, 2001, 52_000, 76_001, 79_979])
def test_slowest_cosines(count: int) -> None:
    random = np.random.default_rng(1)
    rows = np.stack([random.normal(size=count), np.full(count, count**-0.5), np.arange(count)])
    rows[2, -4:] = 1e3
    terms = min(count, 128)
    expected = dct(rows, norm="ortho")[:, :terms]
    scale = np.abs(expected).max()
    np.testing.assert_allclose(slowest_cosines(rows, terms), expected, rtol=0, atol=1e-13 * scale)


def test_stretches_with_a_step_or_a_corner_are_left_out() -> None:
    values = 0.1 * noise(0, 820, 3.0) + 0.01 * np.arange(820.0)
    assert len(smooth_stretches(values)) == 8
    values[500:] += 3.0
    values[650:] += 1.0 * np.arange(170.0)
    values[100] = np.nan
    found = smooth_stretches(values)
    assert len(found) == 6
    assert all(len(each) == 100 for each in found)
    assert smooth_stretches(values[:99]) == ()


def test_covariance_of_short_windows_is_exact() -> None:
    """White noise keeps its variance 1; the last spectra are autoregressive with a white floor."""
    grid, basis = Grid(100, 100), cubic_basis(12)
    covariance = exact_covariance(basis, grid)
    count = len(grid.times)
    assert covariance[count] == pytest.approx(np.eye(4), abs=1e-12)
    factor = np.exp(-1.0 / grid.times[-1])
    slow = (1.0 - factor) / (1.0 + factor) * toeplitz(factor ** np.arange(12))
    assert covariance[2 * count] == pytest.approx(basis @ slow @ basis.T, rel=1e-9, abs=1e-12)
    mixed = 0.3 * np.eye(12) + 0.7 * slow
    assert covariance[-1] == pytest.approx(basis @ mixed @ basis.T, rel=1e-9, abs=1e-12)


def test_more_stretches_know_the_correlation_better() -> None:
    grid = Grid(100, 100)
    evidence = [Evidence.of(cubic_basis(100), noise(k, 100, 5.0), grid, 128) for k in range(8)]
    one, all_of_them = (Noise.of(evidence[:count], grid) for count in (1, 8))
    entropies = [
        -float(np.sum(each.chances * np.log(each.chances + 1e-300))) for each in (one, all_of_them)
    ]
    assert entropies[1] < entropies[0]
    assert all_of_them.freedom == 8 * one.freedom
    assert all_of_them.chances.sum() == pytest.approx(1.0)


@pytest.mark.parametrize("memory", [0.2, 5.0])
def test_ten_samples_with_the_record_beside_them(memory: float) -> None:
    """The level at the beginning of ten samples, whose noise remembers half of them."""
    design = np.column_stack([np.ones(10), np.arange(10.0)])
    hits = 0
    for seed in range(200):
        record = noise(seed, 410, memory)
        fit = fit_linear(design, record[:10], beside=smooth_stretches(record[10:]))
        hits += bool(abs(fit.coefficients[0]) <= fit.half_widths[0])
    assert binomtest(hits, 200, 0.95).pvalue > 0.01, hits
