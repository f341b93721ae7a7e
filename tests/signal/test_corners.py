"""Corners and reversals: time and height of a turn, with errors that hold."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.records.arrays import Floats
from labpipe.signal.corners import (
    Corner,
    _build_design,
    _compute_slopes,
    fit_corner,
    fit_reversal,
    fit_stop,
)
from tests.approved import Approve

TURN, HEIGHT = 4.0013, 1.2


def test_exact_without_noise() -> None:
    """A motion that turns at 4.0013 s and 1.2, 1 kHz."""
    time = np.arange(0.0, 8.0, 1e-3)
    since = time - TURN
    up, down = 0.05 * since, -0.12 * since
    corner = fit_corner(time, HEIGHT + np.where(since < 0, up, down), guess=4.2, window=2.0)
    assert corner is not None
    assert corner.time == pytest.approx(TURN, abs=1e-5)
    assert corner.value == pytest.approx(HEIGHT, abs=1e-6)
    assert fit_corner(time[:5], time[:5], guess=2e-3, window=2.5e-3) is None
    assert fit_corner(time, np.full_like(time, 0.3), guess=4.2, window=2.0) is None


def stopped(seed: int, dwell: float, noise: float) -> tuple[Floats, Floats]:
    """A motion of 1 mm/s that stands still for a while at 20 mm, 50 frames per second."""
    time = np.arange(0.0, 40.0, 0.02)
    motion = 1e-3 * np.minimum(time, 20.0) - 1e-3 * np.maximum(time - 20.0 - dwell, 0.0)
    return time, motion + np.random.default_rng(seed).normal(0.0, noise, len(time))


@pytest.mark.parametrize("dwell", [3.0, 15.0])
def test_a_stop_without_noise_is_exact(dwell: float) -> None:
    """The dwell may be longer than both windows together."""
    time, motion = stopped(0, dwell, 0.0)
    corners = fit_stop(time, motion, guesses=(20.1, 19.9 + dwell), window=2.0)
    assert corners is not None
    assert [corner.time for corner in corners] == pytest.approx([20.0, 20.0 + dwell], abs=1e-9)
    assert [corner.value for corner in corners] == pytest.approx([20e-3, 20e-3], abs=1e-12)
    assert max(corner.time_error for corner in corners) < 1e-9


@pytest.mark.parametrize("dwell", [0.1, 3.0])
def test_a_stop_and_a_start_hold_in_their_errors(dwell: float) -> None:
    pulls = []
    for seed in range(30):
        ends = fit_stop(*stopped(seed, dwell, 1e-5), guesses=(19.9, 20.1), window=15.0)
        assert ends is not None
        for corner, true in zip(ends, (20.0, 20.0 + dwell), strict=True):
            pulls.append((corner.time - true) / corner.time_error)
            assert corner.value == pytest.approx(0.02, abs=5.0 * corner.value_error)
    assert np.mean(np.abs(pulls) < 1.96) > 0.85


def test_no_stop() -> None:
    """A corner has no level; a line has no corner; a few samples have neither."""
    time = np.arange(0.0, 40.0, 0.02)
    records = [stopped(0, 0.0, 0.0), (time, 1e-3 * time), (time, np.zeros_like(time))]
    for apart in (0.02, 0.1):
        even = np.arange(0.0, 40.0, apart) + 0.5 * apart  # two samples stand level at the corner
        records.append((even, -1e-3 * np.abs(even - 20.0)))
    for record in records:
        assert fit_stop(*record, guesses=(19.9, 20.1), window=15.0) is None
    for count in (1, 8):
        assert fit_stop(time[:count], time[:count], guesses=(0.05, 0.1), window=1.0) is None


@pytest.mark.parametrize(("near", "is_enough"), [(0.025, False), (0.035, True)])
def test_four_samples_before_a_corner_are_enough_for_two_lines(
    near: float, *, is_enough: bool
) -> None:
    time = np.arange(0.0, 2.0, 0.01)
    corner = fit_corner(time, -np.abs(time - 0.03), guess=near, window=1.0)
    assert (corner is not None) is is_enough


REVERSAL, TOP = 4.0013, 0.095


def turned(
    seed: int, *, sticks: float, noise: float = 5e-4, dwell: float = 0.0, relaxes: float = 0.0
) -> tuple[Floats, Floats]:
    """A force that falls at 20 mN/s while it sticks for so many seconds, then at 7 mN/s, 200 Hz.

    Before, it may wait, and relaxes at so many N/s.
    """
    time = np.arange(2.0, 6.0, 5e-3)
    waited = np.clip(time - REVERSAL, 0.0, dwell)
    since = time - REVERSAL - waited
    stuck = np.clip(since, 0.0, sticks)
    slid = np.maximum(since - sticks, 0.0)
    rise = np.minimum(since, 0.0)
    force = TOP + 4.9e-3 * rise - 1e-4 * rise**2 - 0.020 * stuck - 0.007 * slid - relaxes * waited
    return time, force + np.random.default_rng(seed).normal(0.0, noise, len(time))


def reversal_of(seed: int, *, sticks: float, noise: float = 5e-4) -> Corner:
    reversal = fit_reversal(*turned(seed, sticks=sticks, noise=noise), guess=3.97, window=1.0)
    assert reversal is not None
    return reversal


def test_reversals_are_near_the_truth_and_as_they_were_approved(approved: Approve) -> None:
    lines = []
    for sticks, dwell, relaxes in (
        *((0.1, 0.0, 0.0), (0.3, 0.0, 0.0), (9.0, 0.0, 0.0)),
        *((0.1, 0.5, 4e-3), (0.3, 0.5, 0.015), (9.0, 0.5, 2e-3), (0.1, 1.0, 0.02)),
    ):
        time, force = turned(5, sticks=sticks, dwell=dwell, relaxes=relaxes)
        corner = fit_reversal(time, force, guess=3.97, window=1.0, dwell=dwell)
        assert corner is not None
        assert corner.time == pytest.approx(REVERSAL, abs=3.0 * corner.time_error)
        assert corner.value == pytest.approx(TOP, abs=3.0 * corner.value_error)
        ends = f"{corner.time:.8g} +- {corner.time_error:.6g}, {corner.value:.8g}"
        lines.append(f"{sticks} {dwell} {relaxes}: {ends} +- {corner.value_error:.6g}")
    approved(lines)


@pytest.mark.slow
@pytest.mark.parametrize("sticks", [0.1, 0.3, 9.0])
def test_errors_hold_wherever_the_fall_bends(sticks: float) -> None:
    pulls = []
    for seed in range(60):
        corner = reversal_of(seed, sticks=sticks)
        pulls.append([(corner.time - REVERSAL) / corner.time_error, 0.0])
        pulls[-1][1] = (corner.value - TOP) / corner.value_error
    # Of 60 intervals of 95 %, 52 at least hold their truth in 99 studies of 100.
    assert (np.sum(np.abs(pulls) < 1.96, axis=0) >= 52).all()
    assert (np.std(pulls, axis=0) > 0.7).all(), "nor are they too large"


@pytest.mark.parametrize("wait", [0.0, 0.4])
def test_slopes_are_those_of_the_curve(wait: float) -> None:
    """By central differences, between the knots; a dwell has slopes of its own."""
    times, apart = np.linspace(-0.9, 1.3, 400), 1e-6
    before, after = (_build_design(times + by, np.zeros(1), wait)[0] for by in (-apart, apart))
    curve = np.random.default_rng(6).normal(size=len(before))
    expected = curve @ (after - before) / (2.0 * apart)
    np.testing.assert_allclose(_compute_slopes(times, curve, wait), expected, rtol=1e-6, atol=1e-6)


def test_reversal_is_exact_without_noise() -> None:
    reversal = reversal_of(0, sticks=9.0, noise=0.0)
    assert reversal.time == pytest.approx(REVERSAL, abs=2e-4)
    assert reversal.value == pytest.approx(TOP, abs=2e-6)


def test_no_corner() -> None:
    time = np.arange(2.0, 6.0, 5e-3)
    assert fit_reversal(time, np.ones_like(time), guess=4.0, window=1.0) is None
    assert fit_reversal(time[:20], 1.0 - time[:20], guess=2.05, window=0.02) is None
    rising = time + np.random.default_rng(3).normal(0.0, 1e-3, len(time))
    reversal = fit_reversal(time, rising, guess=4.0, window=1.0)
    assert reversal is None or reversal.time_error > 0.05


def test_the_ends_of_the_window_belong_to_it() -> None:
    """A second on each side at 256 samples a second, and half a second of waiting."""
    time = np.arange(2.0, 6.0, 2.0**-8)
    force = TOP - 0.02 * np.abs(time - 4.0)
    force += np.random.default_rng(2).normal(0.0, 5e-4, len(time))
    for dwell, samples in ((0.0, 513), (0.5, 641)):
        reversal = fit_reversal(time, force, guess=4.0, window=1.0, dwell=dwell)
        assert reversal is not None
        assert reversal.n == samples


def test_the_unit_of_the_force_does_not_matter() -> None:
    time, force = turned(3, sticks=0.3)
    corners = []
    for factor in (1.0, 1e-6):
        reversal = fit_reversal(time, factor * force, guess=3.97, window=1.0)
        assert reversal is not None
        corners.append(reversal)
    plain, scaled = corners
    assert (scaled.time, scaled.value) == pytest.approx((plain.time, 1e-6 * plain.value), rel=1e-6)
    errors = plain.time_error, 1e-6 * plain.value_error
    assert (scaled.time_error, scaled.value_error) == pytest.approx(errors, rel=1e-3)
