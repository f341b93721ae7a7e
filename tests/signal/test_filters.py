"""Smoothing and decimation."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from labpipe.records.arrays import Floats
from labpipe.signal.filters import (
    Butterworth,
    Smoothing,
    compute_moving_average,
    compute_window,
    convert_seconds_to_window,
    filter_pieces,
)

ODD = "expected an odd number of"
signals = arrays(np.float64, st.integers(1, 60), elements=st.floats(-1e3, 1e3))


def by_definition(values: Floats, window: int) -> Floats:
    """Mean over the symmetric window that fits, sample by sample."""
    half, count = window // 2, len(values)
    means = np.full(count, np.nan)
    for i in range(count):
        reach = min(half, i, count - 1 - i)
        valid = values[i - reach : i + reach + 1]
        valid = valid[~np.isnan(valid)]
        if len(valid):
            means[i] = valid.mean()
    return means


@given(signals, st.integers(1, 8), st.sets(st.integers(0, 59)))
def test_nan_a_window_averages_what_is_there(values: Floats, half: int, holes: set[int]) -> None:
    values = values.copy()
    values[[hole for hole in holes if hole < len(values)]] = np.nan
    window = min(2 * half + 1, len(values) - 1 + len(values) % 2)
    assert compute_moving_average(values, window=window) == pytest.approx(
        by_definition(values, window), abs=1e-9, nan_ok=True
    )


def test_lengths_of_windows() -> None:
    lengths = {(0.05, 2650): 133, (5, 100): 5, (6, 100): 5, (6.9, 100): 5, (500, 12): 11}
    lengths[0.001, 9] = 1
    assert {key: compute_window(*key) for key in lengths} == lengths
    assert convert_seconds_to_window(0.1, np.arange(0, 10, 1e-4)) == 999
    assert convert_seconds_to_window(1e-9, np.arange(0, 1, 0.1)) == 1
    assert convert_seconds_to_window(1.0, np.zeros(1)) == 1


@pytest.mark.parametrize(
    ("smooth", "message"),
    [
        *(
            (partial(compute_moving_average, np.zeros(9), window=n), f"window={n}: {ODD}")
            for n in (0, 2, 11)
        ),
        (lambda: compute_window(0, 5), "span=0, count=5: expected a positive span"),
        (
            lambda: Butterworth(600.0, 1e3, 2)(np.zeros(100)),
            "cutoff=600.0: expected a frequency between 0 and 500.0",
        ),
        (
            lambda: Butterworth(1.0, 1e3, 1)(np.array([0.0, np.nan])),
            "expected a signal without gaps, found NaN",
        ),
    ],
)
def test_what_cannot_be_smoothed(smooth: Callable[[], object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        smooth()


def test_low_pass() -> None:
    time = np.arange(0, 10, 1e-3)
    slow, fast = np.sin(2 * np.pi * time), np.sin(2 * np.pi * 100 * time)
    passed = Butterworth(10.0, 1e3, 2)(slow + fast)
    assert np.abs(passed - slow)[1000:-1000].max() < 2e-3
    values = np.zeros(2001)
    values[1000] = 1.0
    passed = Butterworth(5.0, 1e3, 2)(values)
    np.testing.assert_allclose(passed, passed[::-1], rtol=0, atol=1e-12)
    assert int(np.argmax(passed)) == 1000


def test_smoothed_agrees_with_savitzky_and_golay_of_scipy() -> None:
    from scipy.signal import savgol_filter

    values = np.random.default_rng(4).normal(size=300).cumsum()
    expected = savgol_filter(values, 31, 1)
    smoothed = Smoothing(31)(values)
    assert smoothed[15:-15] == pytest.approx(expected[15:-15])
    first, last = values[:31], values[-31:]
    assert smoothed[:15] == pytest.approx(np.clip(expected[:15], first.min(), first.max()))
    assert smoothed[-15:] == pytest.approx(np.clip(expected[-15:], last.min(), last.max()))


def test_one_known_sample_makes_no_line() -> None:
    values = np.array([np.nan, np.nan, 4.0, np.nan, np.nan, 1.0, 2.0, 3.0, 4.0, 5.0])
    smoothed = Smoothing(5)(values)
    assert smoothed[:2] == pytest.approx([np.nan, 4.0], nan_ok=True)
    assert smoothed[8:] == pytest.approx([4.0, 5.0])


def test_pieces_keep_their_corner() -> None:
    tent = np.concatenate([np.arange(50.0), np.arange(50.0)[::-1]])
    act = Smoothing(21)
    assert filter_pieces(tent, [50], [(act, 1)]) == pytest.approx(tent)
    assert filter_pieces(tent, [], [(act, 1)]).max() < 46.0
    thinned = filter_pieces(tent, [50], [(Smoothing(5), 3), (Smoothing(5), 2)])
    assert thinned == pytest.approx(tent[::6])


def test_many_rows_are_smoothed_as_each_alone() -> None:
    """With different gaps in each row, none in the first."""
    rows = np.random.default_rng(5).normal(size=(2, 3, 80)).cumsum(axis=-1)
    for at, row in enumerate(rows.reshape(-1, 80)):
        row[at : 3 * at] = np.nan
        row[80 - at :] = np.nan
    for window in (1, 3, 21, 79, 81):
        alone = [[Smoothing(window)(row) for row in plane] for plane in rows]
        np.testing.assert_allclose(Smoothing(window)(rows), alone, rtol=0, atol=1e-12)


def test_a_coarser_window_is_the_nearest_odd_one() -> None:
    windows = {(101, 1.0): 101, (101, 5.0): 21, (9, 2.0): 5, (5, 2.0): 3, (3, 2.0): 1}
    windows |= {(3, 50.0): 1, (5, 1.0 / 3.0): 15}
    for (window, ratio), coarse in windows.items():
        assert Smoothing(window).scale_step(ratio) == Smoothing(coarse)


def test_a_cutoff_too_fast_for_coarse_samples_does_nothing() -> None:
    values = np.random.default_rng(10).normal(size=30)
    act = Butterworth(10.0, 100.0, 2)
    assert act.scale_step(4) == Butterworth(10.0, 25.0, 2)
    np.testing.assert_array_equal(act.scale_step(5)(values), values)
