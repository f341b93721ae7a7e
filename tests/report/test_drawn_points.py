from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from labpipe.records.arrays import Floats
from labpipe.report.drawn_points import bends, extremes, worst


@given(
    hnp.arrays(np.float64, st.integers(0, 400), elements=st.floats(-5, 5) | st.just(np.nan)),
    st.integers(1, 20),
)
def test_thinned_line_is_as_wide_and_as_broken_as_the_samples(values: Floats, bins: int) -> None:
    kept = extremes(values, bins=bins)
    assert (np.diff(kept) > 0).all()
    if len(values):
        assert kept[0] == 0
        assert kept[-1] == len(values) - 1
    if np.isfinite(values).any():
        assert np.nanmin(values[kept]) == np.nanmin(values)
        assert np.nanmax(values[kept]) == np.nanmax(values)
    assert np.isnan(values[kept]).any() == np.isnan(values).any()
    assert len(kept) <= max(4 * bins, 3 * bins + 2)


def test_every_stretch_keeps_its_extremes() -> None:
    values = np.random.default_rng(0).normal(size=1000)
    kept = values[extremes(values, bins=10)]
    for start in range(0, 1000, 100):
        assert values[start : start + 100].min() in kept
        assert values[start : start + 100].max() in kept
    assert len(kept) <= 22


def test_bins_out_of_range() -> None:
    with pytest.raises(ValueError, match="bins=0: expected at least 1"):
        extremes(np.zeros(3), bins=0)


def test_worst_flag_of_a_stretch_wins() -> None:
    flags = np.ones((1000, 2), dtype=np.uint8)
    flags[503, 1] = 0
    flags[504, 1] = 2
    rank = np.array([2, 0, 1], dtype=np.uint8)
    thin = worst(flags, rank, bins=10)
    assert thin[:, 0].tolist() == [1] * 10
    assert thin[:, 1].tolist() == [1] * 5 + [0] + [1] * 4
    np.testing.assert_array_equal(worst(flags[:7], rank, bins=10), flags[:7])
    assert worst(flags[:0], rank, bins=10).shape == (0, 2)


def test_a_corner_stays_a_corner_and_a_step_a_step() -> None:
    x = np.linspace(0.0, 50.0, 2001)
    force = np.minimum(5.0 * x, 30.0 + 2.0 * x) - np.where(x > 30.0, 4.0, 0.0)
    kept = bends(x, force, points=60)
    assert len(kept) < 10
    assert 10.0 in x[kept]
    assert {30.0, 30.025} <= set(x[kept].round(3).tolist())
    drawn = np.interp(x, x[kept], force[kept])
    assert np.abs(drawn - force).max() <= 0.002 * np.ptp(force)


def test_noise_keeps_its_largest_excursions_and_no_more_points_than_allowed() -> None:
    force = np.random.default_rng(1).normal(size=3000)
    kept = bends(np.arange(3000.0), force, points=50)
    assert len(kept) == 50
    assert {int(force.argmax()), int(force.argmin()), 0, 2999} <= set(kept.tolist())


def test_gaps_and_standstill_in_bends() -> None:
    force = np.arange(100.0)
    force[40:45] = np.nan
    assert bends(np.arange(100.0), force, points=10).tolist() == [0, 39, 40, 45, 99]
    up = np.concatenate([np.zeros(50), np.linspace(0.0, 1.0, 50), np.zeros(50)])
    assert {50, 99, 100} <= set(bends(np.zeros(150), up, points=20).tolist())
    assert bends(np.zeros(3), np.full(3, np.nan), points=5).tolist() == [0]
    assert bends(np.zeros(0), np.zeros(0), points=5).tolist() == []
