from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from labpipe.records.arrays import Floats
from labpipe.report.thinning import extremes, worst


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
