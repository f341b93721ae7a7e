"""A sudden fall at a place: its beginning, end and drop, and whether it is noise."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import binomtest

from labpipe.fits.load_drops import LoadDrop, PullCurve, fit_load_drop
from labpipe.records.arrays import Floats

COUNT, STEP = 400, 1e-4
NUMBER = np.arange(COUNT, dtype=np.float64)


def noise(seed: int, memory: float, deviation: float = 0.04) -> Floats:
    factor = np.exp(-1.0 / memory) if memory > 0.0 else 0.0
    kicks = np.random.default_rng(seed).normal(size=COUNT + 100) * np.sqrt(1.0 - factor**2)
    slow = np.asarray(lfilter([1.0], [1.0, -factor], kicks)[100:], dtype=np.float64)
    return deviation * slow


def pull(begin: float, length: float, drop: float, extra: Floats) -> PullCurve:
    lost = drop * np.clip((NUMBER - begin) / length, 0.0, 1.0)
    return PullCurve(STEP * NUMBER, 0.1 * NUMBER - lost + extra, most=10, blurred=0)


@pytest.mark.slow
@pytest.mark.parametrize("length", [0.01, 1.0, 2.5])
@pytest.mark.parametrize("memory", [0.0, 6.0])
def test_the_drop_covers(length: float, memory: float) -> None:
    """Slow and white noise, and falls that begin anywhere between two samples."""
    hits = 0
    for seed in range(120):
        begin = 200.0 + float(np.random.default_rng(seed).uniform())
        both = noise(seed, memory, 0.03) + noise(seed + 1000, 0.0, 0.02)
        found = fit_load_drop(pull(begin, length, 0.65, both), 202)
        assert isinstance(found, LoadDrop)
        hits += found.drop_interval.lower <= 0.65 <= found.drop_interval.upper
    assert binomtest(hits, 120, 0.95).pvalue > 0.01 / 6, hits


def test_start_and_stop_are_the_samples_around_the_fall() -> None:
    found = fit_load_drop(pull(200.25, 2.5, 2.0, noise(3, 0.0, 0.005)), 205)
    assert found is not None
    assert (found.start, found.stop) == (200, 203)
    assert found.earliest <= found.start + 1
    assert found.latest >= found.stop - 1


def test_noise_is_no_fall() -> None:
    """At its deepest place in noise of either kind."""
    for memory in (0.0, 3.0, 10.0):
        for seed in range(8):
            extra = noise(seed, memory)
            place = int(np.argmin(np.diff(extra)[30:-30])) + 30
            assert fit_load_drop(pull(0.0, 1.0, 0.0, extra), place) is None


def test_a_long_fall_is_none() -> None:
    assert fit_load_drop(pull(195.0, 16.0, 1.5, noise(1, 0.0)), 200) is None


def test_no_room_on_a_side() -> None:
    whole = pull(3.0, 0.5, 1.0, noise(1, 0.0))
    assert fit_load_drop(whole, 3) is None
    assert fit_load_drop(whole, COUNT - 3) is None


def test_added_back() -> None:
    curve = pull(200.25, 2.5, 2.0, 0.0 * NUMBER)
    found = fit_load_drop(curve, 201)
    assert found is not None
    mended = curve.without([found])
    assert mended.f == pytest.approx(0.1 * NUMBER, abs=1e-6)
    assert curve.f[300] == pytest.approx(28.0)


def test_a_coarse_converter_is_no_fall() -> None:
    """Around the place nothing moves at all, and elsewhere in steps of twelve samples."""
    force = 1.2 * np.round(0.1 * NUMBER / 1.2)
    force[150:260] = force[150]
    assert fit_load_drop(PullCurve(STEP * NUMBER, force, most=10, blurred=0), 205) is None
