"""Means with t-based intervals."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binomtest

from labpipe.statistics.means import mean_interval

VALUES = st.lists(st.floats(-1e3, 1e3).map(lambda value: round(value, 6)), min_size=2, max_size=8)


def test_no_samples_and_one_sample_say_so() -> None:
    none, one = mean_interval([], "sample"), mean_interval([3.0], "spool")
    assert np.isnan(none.mean)
    assert none.interval is None
    assert str(none.reason) == "no_samples: there is no sample to average"
    assert (one.mean, one.interval, one.n) == (3.0, None, 1)
    assert (
        str(one.reason)
        == "one_sample: an interval needs the scatter of two values, there is one spool"
    )


def test_nan_is_absent() -> None:
    assert mean_interval([1.0, np.nan, 3.0]) == mean_interval([1.0, 3.0])
    assert str(mean_interval([np.nan]).reason).startswith("no_samples: ")


def test_equal_values_have_an_interval_without_width() -> None:
    found = mean_interval([2.0, 2.0, 2.0]).interval
    assert found is not None
    assert (found.lower, found.upper) == (2.0, 2.0)


@given(VALUES, st.floats(-1e3, 1e3), st.floats(0.1, 10.0))
def test_moves_and_scales_with_its_values(values: list[float], shift: float, scale: float) -> None:
    first = mean_interval(values)
    second = mean_interval([scale * value + shift for value in reversed(values)])
    assert first.interval is not None
    assert second.interval is not None
    assert second.n == first.n == len(values)
    assert second.mean == pytest.approx(scale * first.mean + shift, rel=1e-9, abs=1e-6)
    assert second.interval.lower == pytest.approx(
        scale * first.interval.lower + shift, rel=1e-9, abs=1e-6
    )
    assert second.interval.upper == pytest.approx(
        scale * first.interval.upper + shift, rel=1e-9, abs=1e-6
    )


@pytest.mark.parametrize("n", [2, 3, 5, 6])
def test_interval_covers(n: int) -> None:
    hits, runs, rng = 0, 2000, np.random.default_rng(n)
    for _ in range(runs):
        found = mean_interval(rng.normal(7.0, 2.0, n)).interval
        assert found is not None
        hits += found.lower <= 7.0 <= found.upper
    assert binomtest(hits, runs, 0.95).pvalue > 0.01, hits
