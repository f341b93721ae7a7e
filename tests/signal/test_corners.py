"""Corners: time and height of a turn, with errors that hold."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.records.arrays import Floats
from labpipe.signal.corners import fit_corner, fit_stop

TURN, HEIGHT = 4.0013, 1.2


def bent(seed: int, *, noise: float, correlated: int = 1) -> tuple[Floats, Floats]:
    """A force that turns at 4.0013 s and 1.2 N, curved on both sides, 1 kHz."""
    time = np.arange(0.0, 8.0, 1e-3)
    past = time - TURN
    force = HEIGHT + np.where(
        past < 0, 0.05 * past + 0.004 * past**2, -0.12 * past + 0.01 * past**2
    )
    white = np.random.default_rng(seed).normal(0.0, noise, len(time) + correlated)
    kernel = np.ones(correlated) / np.sqrt(correlated)
    return time, force + np.convolve(white, kernel, mode="same")[: len(time)]


def test_exact_without_noise() -> None:
    time, force = bent(0, noise=0.0)
    corner = fit_corner(time, force, near=4.2, window=2.0, degree=2)
    assert corner is not None
    assert corner.time == pytest.approx(TURN, abs=1e-5)
    assert corner.value == pytest.approx(HEIGHT, abs=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("correlated", [1, 20])
def test_errors_hold_for_white_and_for_correlated_noise(correlated: int) -> None:
    pulls = []
    for seed in range(150):
        time, force = bent(seed, noise=4e-3, correlated=correlated)
        corner = fit_corner(time, force, near=4.1, window=2.0, degree=2)
        assert corner is not None
        pulls.append(
            [
                (corner.time - TURN) / corner.time_error,
                (corner.value - HEIGHT) / corner.value_error,
            ]
        )
    # The spread of 150 normal pulls is known to 6 %; correlated noise is estimated from fewer.
    assert np.std(pulls, axis=0) == pytest.approx([1.0, 1.0], abs=0.17 if correlated == 1 else 0.3)
    assert np.mean(pulls, axis=0) == pytest.approx([0.0, 0.0], abs=0.25)


def test_a_straight_signal_has_no_corner() -> None:
    time = np.arange(0.0, 8.0, 1e-2)
    noise = np.random.default_rng(5).normal(0, 1e-3, len(time))
    corner = fit_corner(time, 0.1 * time + noise, near=4.0, window=2.0, degree=1)
    assert corner is None or corner.time_error > 0.05


def test_too_few_samples() -> None:
    time = np.arange(0.0, 0.1, 0.02)
    assert fit_corner(time, time, near=0.04, window=0.05, degree=2) is None


def test_nan_are_left_out() -> None:
    time, force = bent(0, noise=0.0)
    force[::7] = np.nan
    corner = fit_corner(time, force, near=4.1, window=2.0, degree=2)
    assert corner is not None
    assert corner.time == pytest.approx(TURN, abs=1e-4)


def stopped(seed: int, dwell: float, noise: float) -> tuple[Floats, Floats]:
    """A motion of 1 mm/s that stands still for a while at 20 mm, 50 frames per second."""
    time = np.arange(0.0, 40.0, 0.02)
    motion = 1e-3 * np.minimum(time, 20.0) - 1e-3 * np.maximum(time - 20.0 - dwell, 0.0)
    return time, motion + np.random.default_rng(seed).normal(0.0, noise, len(time))


def test_a_stop_without_noise_is_exact() -> None:
    time, motion = stopped(0, 3.0, 0.0)
    found = fit_stop(time, motion, near=(20.1, 22.9), window=2.0)
    assert found is not None
    assert [each.time for each in found] == pytest.approx([20.0, 23.0], abs=1e-9)
    assert [each.value for each in found] == pytest.approx([20e-3, 20e-3], abs=1e-12)
    assert max(each.time_error for each in found) < 1e-9


@pytest.mark.parametrize("dwell", [0.1, 0.4, 3.0])
def test_a_stop_and_a_start_hold_in_their_errors(dwell: float) -> None:
    pulls = []
    for seed in range(60):
        found = fit_stop(*stopped(seed, dwell, 1e-5), near=(19.9, 20.1), window=15.0)
        assert found is not None
        for corner, true in zip(found, (20.0, 20.0 + dwell), strict=True):
            pulls.append((corner.time - true) / corner.time_error)
            assert corner.value == pytest.approx(0.02, abs=5.0 * corner.value_error)
    assert np.mean(np.abs(pulls) < 1.96) > 0.85


def test_a_stop_is_exact_without_noise() -> None:
    found = fit_stop(*stopped(0, 0.6, 0.0), near=(19.0, 21.0), window=10.0)
    assert found is not None
    assert [corner.time for corner in found] == pytest.approx([20.0, 20.6], abs=1e-9)


def test_no_stop() -> None:
    """A corner has no level; a line has no corner; a few samples have neither."""
    assert fit_stop(*stopped(0, 0.0, 0.0), near=(19.9, 20.1), window=15.0) is None
    for apart in (0.02, 0.1):
        time = np.arange(0.0, 40.0, apart) + 0.5 * apart  # two samples stand level at the corner
        corner = -1e-3 * np.abs(time - 20.0)
        assert fit_stop(time, corner, near=(19.9, 20.1), window=15.0) is None
    time = np.arange(0.0, 40.0, 0.02)
    assert fit_stop(time, 1e-3 * time, near=(19.9, 20.1), window=15.0) is None
    assert fit_stop(time, np.zeros_like(time), near=(19.9, 20.1), window=15.0) is None
    assert fit_stop(time[:8], 1e-3 * time[:8], near=(0.05, 0.1), window=1.0) is None


@pytest.mark.parametrize(("near", "is_enough"), [(0.035, False), (0.045, True)])
def test_five_samples_before_a_corner_are_enough_for_two_parabolas(
    near: float, *, is_enough: bool
) -> None:
    time = np.arange(0.0, 2.0, 0.01)
    found = fit_corner(time, -np.abs(time - 0.03), near=near, window=1.0, degree=2)
    assert (found is not None) is is_enough
