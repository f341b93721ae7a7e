"""Lag of repeated cycles: exact where they repeat, honest where they do not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.records.arrays import Floats
from labpipe.records.estimates import Estimate, Failure
from labpipe.signal.clock_alignment import Repeat, fit_clocks, fit_lag

LAG, START, TURN, STOP = 100.0, 1.0, 50.0, 99.0


def cycle(time: Floats) -> Floats:
    """A loop that loads along one curve and unloads along another, again every 100 s."""
    phase = time % LAG
    loading = 1.0 - np.exp(-phase / 30.0)
    top = 1.0 - np.exp(-TURN / 30.0)
    return np.where(phase < TURN, loading, top * (1.0 - (phase - TURN) / TURN) ** 1.5)


TIME = np.arange(0.0, 210.0, 0.02)


def lag(
    values: Floats, *, guess: float = LAG, hysteresis: bool = True, time: Floats = TIME
) -> Estimate:
    found = fit_lag(
        time, values, start=START, turn=TURN, stop=STOP, guess=guess, hysteresis=hysteresis
    )
    assert isinstance(found, Estimate), found
    return found


@pytest.mark.parametrize("guess", [LAG, LAG + 0.5, LAG - 0.9])
@pytest.mark.parametrize("hysteresis", [True, False])
def test_exact_on_a_loop_that_repeats(guess: float, hysteresis: bool) -> None:
    found = lag(cycle(TIME), guess=guess, hysteresis=hysteresis)
    assert found.value == pytest.approx(LAG, abs=1e-4)
    assert found.n > 1900


def test_lag_of_a_stretched_clock() -> None:
    """A clock that runs 200 ppm fast sees the cycle come again 20 ms later."""
    found = lag(cycle(TIME / (1.0 + 200e-6)))
    assert found.value == pytest.approx(LAG * (1.0 + 200e-6), abs=5e-4)


def test_scale_and_shift_of_the_later_cycle_do_not_matter() -> None:
    values = cycle(TIME)
    later = np.where(TIME > 100.0, 0.97 * values + 0.01, values)
    assert lag(later).value == pytest.approx(LAG, abs=2e-3)


def test_a_loop_that_moves_along_the_displacement_is_no_lag() -> None:
    """Loading 0.1 s late and unloading 0.1 s early, as after plastic bending."""
    moved = np.where(TIME % LAG < TURN, cycle(TIME - 0.1), cycle(TIME + 0.1))
    later = np.where(TIME > 100.0, moved, cycle(TIME))
    with_hysteresis, without = lag(later), lag(later, hysteresis=False)
    assert abs(with_hysteresis.value - LAG) < 0.2 * abs(without.value - LAG) + 2e-3
    assert with_hysteresis.value == pytest.approx(LAG, abs=5e-3)


@pytest.mark.parametrize("noise", [3e-4, 5e-3])
def test_error_holds(noise: float) -> None:
    """Also where the noise of the slope is larger than the slope."""
    pulls = []
    for seed in range(80):
        noisy = cycle(TIME) + np.random.default_rng(seed).normal(0.0, noise, len(TIME))
        found = lag(noisy)
        pulls.append((found.value - LAG) / found.error)
    assert abs(np.mean(pulls)) < 0.4
    assert np.std(pulls) == pytest.approx(1.0, abs=0.25)


def test_gaps_are_left_out() -> None:
    values = cycle(TIME)
    values[1000:1500] = np.nan
    assert lag(values).value == pytest.approx(LAG, abs=1e-3)


def test_nothing_to_compare() -> None:
    found = fit_lag(
        TIME, cycle(TIME), start=1.0, turn=50.0, stop=99.0, guess=300.0, hysteresis=True
    )
    assert isinstance(found, Failure)
    assert found.code == "too_few_samples"
    assert found.message == "0 bins in common, 50 are needed"
    empty = np.empty(0)
    none = fit_lag(empty, empty, start=1.0, turn=2.0, stop=3.0, guess=4.0, hysteresis=False)
    assert none == Failure("too_few_samples", "0 bins in the cycle, 50 are needed")


def test_a_cycle_that_ends_before_it_begins() -> None:
    found = fit_lag(TIME, cycle(TIME), start=5.0, turn=4.5, stop=4.0, guess=LAG, hysteresis=False)
    assert found == Failure("too_few_samples", "0 bins in the cycle, 50 are needed")


def test_what_a_wandering_zero_does_to_the_lag_is_in_intervals_alone() -> None:
    """Of events that say nothing on the drift: the wander over the lag, and the offset with it."""
    events = np.array([10.0, 20.0]), np.array([11.0, 21.0]), np.full(2, 10.0)
    sure = Repeat(100.0, 100.02, 1e-4)
    still, moved = (
        fit_clocks(*events, method="by hand", repeat=each)
        for each in (sure, replace(sure, wander=0.05))
    )
    assert (moved.drift, moved.offset) == (still.drift, still.offset)
    more = [
        np.sqrt(getattr(moved, x).standard_error ** 2 - getattr(still, x).standard_error ** 2)
        for x in ("drift_interval", "offset_interval")
    ]
    assert more == pytest.approx([0.05 / 100.0, 15.0 * 0.05 / 100.0], rel=1e-3)
