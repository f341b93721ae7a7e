"""Running medians against scipy's."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.ndimage import median_filter

from labpipe.fitting.medians import running_median
from labpipe.records.arrays import Floats

some = arrays(np.float64, st.integers(1, 60), elements=st.floats(-9, 9, width=16))


@given(some, st.integers(1, 40))
def test_the_same_numbers_as_scipy(values: Floats, window: int) -> None:
    expected = median_filter(values, window, mode="nearest")
    np.testing.assert_array_equal(running_median(values, window), expected)


@pytest.mark.parametrize("window", [1, 3, 5, 7, 9, 11, 385])
def test_the_same_numbers_as_scipy_over_several_pieces(window: int) -> None:
    values = np.random.default_rng(1).normal(size=40_000).cumsum()
    expected = median_filter(values, window, mode="nearest")
    np.testing.assert_array_equal(running_median(values, window), expected)


def test_the_values_stay_as_they_are() -> None:
    values = np.array([3.0, 1.0, 2.0])
    values.flags.writeable = False
    running_median(values, 3)
    assert values.tolist() == [3.0, 1.0, 2.0]


def test_no_window_without_a_sample() -> None:
    with pytest.raises(ValueError, match="expected a window of at least one sample, found 0"):
        running_median(np.ones(3), 0)
