"""Reversals: a corner whose far side bends, and errors that hold."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.records.arrays import Floats
from labpipe.signal.reversals import Reversal, fit_reversal

TURN, HEIGHT = 4.0013, 0.095


def turned(seed: int, *, sticks: float, noise: float = 5e-4) -> tuple[Floats, Floats]:
    """A force that falls at 20 mN/s while it sticks for so many seconds, then at 7 mN/s, 200 Hz."""
    time = np.arange(2.0, 6.0, 5e-3)
    past = time - TURN
    stuck = np.clip(past, 0.0, sticks)
    slid = np.maximum(past - sticks, 0.0)
    rise = np.minimum(past, 0.0)
    force = HEIGHT + 4.9e-3 * rise - 1e-4 * rise**2 - 0.020 * stuck - 0.007 * slid
    return time, force + np.random.default_rng(seed).normal(0.0, noise, len(time))


def found(seed: int, *, sticks: float, noise: float = 5e-4) -> Reversal:
    reversal = fit_reversal(*turned(seed, sticks=sticks, noise=noise), near=3.97, window=1.0)
    assert reversal is not None
    return reversal


@pytest.mark.slow
@pytest.mark.parametrize("sticks", [0.1, 0.3, 9.0])
def test_errors_hold_wherever_the_fall_bends(sticks: float) -> None:
    pulls = []
    for seed in range(60):
        corner = found(seed, sticks=sticks).corner
        pulls.append([(corner.time - TURN) / corner.time_error, 0.0])
        pulls[-1][1] = (corner.value - HEIGHT) / corner.value_error
    # Of 60 intervals of 95 %, 52 at least hold their truth in 99 studies of 100.
    assert (np.sum(np.abs(pulls) < 1.96, axis=0) >= 52).all()
    assert (np.std(pulls, axis=0) > 0.7).all(), "nor are they too large"


def test_what_the_fall_may_hide_is_told_from_noise() -> None:
    """A straight fall hides nothing that would matter; one that bends may."""
    bent, straight = found(1, sticks=0.1), found(1, sticks=9.0)
    assert 0.3 < bent.shape_error / bent.corner.time_error < 0.8
    assert straight.shape_error < bent.shape_error


def test_exact_without_noise() -> None:
    reversal = found(0, sticks=9.0, noise=0.0)
    assert reversal.corner.time == pytest.approx(TURN, abs=2e-4)
    assert reversal.corner.value == pytest.approx(HEIGHT, abs=2e-6)


def test_many_samples_are_averaged_and_nan_left_out() -> None:
    time = np.arange(2.0, 6.0, 1e-4)
    force = HEIGHT - 0.02 * np.abs(time - TURN)
    force += np.random.default_rng(2).normal(0.0, 5e-4, len(time))
    force[::7] = np.nan
    reversal = fit_reversal(time, force, near=4.1, window=1.0)
    assert reversal is not None
    assert abs(reversal.corner.time - TURN) < 2.6 * reversal.corner.time_error < 0.01
    assert reversal.corner.n == np.count_nonzero(~np.isnan(force) & (np.abs(time - 4.1) <= 1.0))


def test_no_corner() -> None:
    time = np.arange(2.0, 6.0, 5e-3)
    assert fit_reversal(time, np.ones_like(time), near=4.0, window=1.0) is None
    assert fit_reversal(time[:20], 1.0 - time[:20], near=2.05, window=0.02) is None
    rising = time + np.random.default_rng(3).normal(0.0, 1e-3, len(time))
    reversal = fit_reversal(time, rising, near=4.0, window=1.0)
    assert reversal is None or reversal.corner.time_error > 0.05


def waited(
    seed: int, dwell: float, *, relaxes: float, noise: float = 5e-4
) -> tuple[Floats, Floats]:
    """As `turned` with a wait at the top, in which so many N are lost in the first second."""
    time = np.arange(1.0, 7.0 + dwell, 5e-3)
    past = time - TURN
    since = np.maximum(past - dwell, 0.0)
    lost = relaxes * np.log1p(10.0 * np.clip(past, 0.0, dwell)) / np.log1p(10.0)
    fall = 0.020 * np.clip(since, 0.0, 0.2) + 0.007 * np.maximum(since - 0.2, 0.0)
    force = HEIGHT + 4.9e-3 * np.minimum(past, 0.0) - lost - fall
    return time, force + np.random.default_rng(seed).normal(0.0, noise, len(time))


@pytest.mark.slow
@pytest.mark.parametrize("relaxes", [0.0, 0.004])
@pytest.mark.parametrize("dwell", [0.2, 1.0])
def test_a_wait_between_rise_and_fall(dwell: float, relaxes: float) -> None:
    """Both corners have one time: of 40 intervals of 95 %, 34 hold in 999 studies of 1000."""
    pulls = []
    for seed in range(40):
        time, force = waited(seed, dwell, relaxes=relaxes, noise=2e-4)
        reversal = fit_reversal(time, force, near=TURN + 0.05, window=1.0, dwell=dwell)
        assert reversal is not None
        pulls.append((reversal.corner.time - TURN) / reversal.corner.time_error)
    assert np.sum(np.abs(pulls) < 1.96) >= 34


def test_a_flat_top_is_no_early_corner() -> None:
    """A sharp bend soon after the corner would do for the corner, were the top taken for a fall."""
    time = np.arange(2.0, 6.0, 2e-3)
    past = time - TURN
    steep = 1.0 * np.clip(past, 0.0, 0.2) + 0.25 * np.clip(past - 0.2, 0.0, 0.4)
    force = 1.0 + 0.02 * np.minimum(past, 0.0) - steep - 0.07 * np.maximum(past - 0.6, 0.0)
    for seed in range(8):
        noise = np.random.default_rng(seed).normal(0.0, 2e-3, len(time))
        reversal = fit_reversal(time, force + noise, near=TURN - 0.03, window=1.0)
        assert reversal is not None
        assert reversal.corner.time == pytest.approx(TURN, abs=8e-3)


def test_a_converter_coarser_than_the_noise() -> None:
    """No fault, and no more precise than its steps allow: 3 mN are 0.15 s of the fall."""
    time, force = turned(4, sticks=9.0)
    step = 3e-3
    reversal = fit_reversal(time, step * np.round(force / step), near=3.97, window=1.0)
    assert reversal is None or reversal.corner.time_error > 0.01


def test_the_ends_of_the_window_belong_to_it() -> None:
    """A second on each side at 256 samples a second, and half a second of waiting."""
    time = np.arange(2.0, 6.0, 2.0**-8)
    force = HEIGHT - 0.02 * np.abs(time - 4.0)
    force += np.random.default_rng(2).normal(0.0, 5e-4, len(time))
    for dwell, samples in ((0.0, 513), (0.5, 641)):
        reversal = fit_reversal(time, force, near=4.0, window=1.0, dwell=dwell)
        assert reversal is not None
        assert reversal.corner.n == samples


@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_the_unit_of_the_force_does_not_matter(scale: float) -> None:
    time, force = turned(3, sticks=0.3)
    plain, scaled = (
        fit_reversal(time, factor * force, near=3.97, window=1.0) for factor in (1.0, scale)
    )
    assert plain is not None
    assert scaled is not None
    assert scaled.corner.time == pytest.approx(plain.corner.time, rel=1e-6)
    assert scaled.corner.time_error == pytest.approx(plain.corner.time_error, rel=1e-3)
    assert scaled.corner.value == pytest.approx(scale * plain.corner.value, rel=1e-6)
    assert scaled.corner.value_error == pytest.approx(scale * plain.corner.value_error, rel=1e-3)
