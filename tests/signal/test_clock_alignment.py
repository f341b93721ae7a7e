"""Two clocks joined at events and at repeated cycles: exact where they repeat, honest elsewhere."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.records.arrays import Floats
from labpipe.records.estimates import Estimate, Failure
from labpipe.signal.clock_alignment import (
    CycleLag,
    find_rough_peaks,
    fit_clocks,
    fit_lag,
    match_peaks,
)

PEAKS = np.array([58.0, 164.0, 270.0])


def test_exact_events_give_the_clocks_back() -> None:
    force = 1.37 + (1.0 + 40e-6) * PEAKS
    fit = fit_clocks(PEAKS, force, np.full(3, 1e-3), method="test")
    assert fit.offset == pytest.approx(1.37, abs=1e-10)
    assert fit.drift == pytest.approx(40e-6, abs=1e-12)
    assert fit.residual == pytest.approx(0.0, abs=1e-10)
    assert fit.to_marker_time(fit.to_force_time(PEAKS)) == pytest.approx(PEAKS)
    assert fit.to_force_time(58.0) == pytest.approx(float(force[0]))


def test_intervals_cover() -> None:
    rng, runs = np.random.default_rng(3), 1000
    errors = np.array([1e-3, 2e-3, 1e-3])
    inside = np.zeros(2)
    for _ in range(runs):
        force = 1.37 + (1.0 + 40e-6) * PEAKS + rng.normal(0, errors)
        fit = fit_clocks(PEAKS, force, errors, method="test")
        inside += [
            fit.offset_interval.lower <= 1.37 <= fit.offset_interval.upper,
            fit.drift_interval.lower <= 40e-6 <= fit.drift_interval.upper,
        ]
    # Widening by the scatter (1 % of the runs) may only add to the 95 %.
    assert (inside / runs) == pytest.approx([0.952, 0.952], abs=0.015)


def test_one_event_gives_an_offset_and_no_drift() -> None:
    fit = fit_clocks(np.array([50.0]), np.array([51.0]), np.array([1e-3]), method="test")
    assert fit.offset == pytest.approx(1.0)
    assert fit.drift == 0.0
    assert np.isnan(fit.drift_interval.lower)
    with pytest.raises(ValueError, match="events=0: expected at least one event"):
        fit_clocks(np.empty(0), np.empty(0), np.empty(0), method="test")


@pytest.mark.parametrize(
    ("force", "expected", "is_odd"),
    [
        (PEAKS + 1.4, [[0, 0], [1, 1], [2, 2]], False),
        (PEAKS[1:] + 1.4, [[1, 0], [2, 1]], True),
        (np.empty(0), [], False),
    ],
    ids=["all", "began late", "none"],
)
def test_peaks_are_paired_in_order(force: Floats, expected: list[list[int]], is_odd: bool) -> None:
    """Where the record began late that is ambiguous, when the peaks are even."""
    pairs, is_ambiguous = match_peaks(PEAKS, force)
    assert (pairs.tolist(), pairs.shape[1], is_ambiguous) == (expected, 2, is_odd)


def test_rough_peaks_of_a_noisy_force() -> None:
    time = np.arange(0.0, 330.0, 1e-3)
    force = np.interp(time, [5, 58, 90, 111, 164, 217, 270, 323], [0, 1.2, 0, 0, 1.3, 0, 1.3, 0])
    force += np.random.default_rng(4).normal(0, 0.02, len(time))
    assert find_rough_peaks(time, force, smoothing=0.5, fall=0.3) == pytest.approx(PEAKS, abs=0.3)
    assert len(find_rough_peaks(np.arange(10.0), np.ones(10), smoothing=0.5, fall=0.3)) == 0


@pytest.mark.parametrize(("square", "widened"), [(6.4, 1.0), (6.8, 6.8), (9.0, 9.0)])
def test_the_quantile_above_which_scatter_widens(square: float, widened: float) -> None:
    """One degree of freedom: 99 % of chi-square lie below 6.63. (1, -2, 1) lies across all lines.

    Three events 100 s apart with errors of 1 ms know the drift to 1 ms / (100 s sqrt 2).
    """
    off = 1e-3 * np.sqrt(square / 6.0) * np.array([1.0, -2.0, 1.0])
    motion = np.array([100.0, 200.0, 300.0])
    fit = fit_clocks(motion, motion + off, np.full(3, 1e-3), method="test")
    assert fit.drift == pytest.approx(0.0, abs=1e-15)
    error = 1e-5 / np.sqrt(2.0)
    assert fit.drift_interval.standard_error == pytest.approx(error * np.sqrt(widened), rel=1e-9)


LAG, START, TURN, STOP = 100.0, 1.0, 50.0, 99.0


def cycle(time: Floats) -> Floats:
    """A loop that loads along one curve and unloads along another, again every 100 s."""
    phase = time % LAG
    loading = 1.0 - np.exp(-phase / 30.0)
    top = 1.0 - np.exp(-TURN / 30.0)
    return np.where(phase < TURN, loading, top * (1.0 - (phase - TURN) / TURN) ** 1.5)


TIME = np.arange(0.0, 210.0, 0.02)


@pytest.mark.parametrize("guess", [LAG, LAG + 0.5, LAG - 0.9])
@pytest.mark.parametrize("hysteresis", [True, False])
def test_exact_on_a_loop_that_repeats(guess: float, hysteresis: bool) -> None:
    lag = fit_lag(TIME, cycle(TIME), (START, TURN, STOP), guess=guess, hysteresis=hysteresis)
    assert isinstance(lag, Estimate)
    assert lag.value == pytest.approx(LAG, abs=1e-4)
    assert lag.n > 1900


def test_nothing_to_compare() -> None:
    empty = np.empty(0)
    for time, guess in ((TIME, 300.0), (empty, LAG)):
        none = fit_lag(time, cycle(time), (START, TURN, STOP), guess=guess, hysteresis=True)
        assert isinstance(none, Failure)
        assert none.code == "too_few_samples"


def test_what_a_wandering_zero_does_to_the_lag_is_in_intervals_alone() -> None:
    """Of events that say nothing on the drift: the wander over the lag, and the offset with it."""
    events = np.array([10.0, 20.0]), np.array([11.0, 21.0]), np.full(2, 10.0)
    sure = CycleLag(100.0, 100.02, 1e-4)
    still, moved = (
        fit_clocks(*events, method="by hand", cycle_lag=repeat)
        for repeat in (sure, replace(sure, zero_drift_error=0.05))
    )
    assert (moved.drift, moved.offset) == (still.drift, still.offset)
    more = [
        np.sqrt(getattr(moved, x).standard_error ** 2 - getattr(still, x).standard_error ** 2)
        for x in ("drift_interval", "offset_interval")
    ]
    assert more == pytest.approx([0.05 / 100.0, 15.0 * 0.05 / 100.0], rel=1e-3)
