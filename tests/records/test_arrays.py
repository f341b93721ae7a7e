from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from labpipe.records.arrays import Floats, frozen, median, stretches_of, times_of


def test_read_only_without_a_copy() -> None:
    values = np.zeros((4, 3))
    view = frozen(values, shape=(None, 3))
    assert np.shares_memory(view, values)
    assert values.flags.writeable
    with pytest.raises(ValueError, match="read-only"):
        view[0, 0] = 1.0


def test_becomes_float64() -> None:
    assert frozen([1, 2], shape=(2,)).dtype == np.float64


@pytest.mark.parametrize("shape", [(None, 4), (5, None), (None,)])
def test_other_shapes_are_refused(shape: tuple[int | None, ...]) -> None:
    with pytest.raises(ValueError, match=r"expected an array of shape .*, found \(4, 3\)"):
        frozen(np.zeros((4, 3)), shape=shape)


@given(arrays(np.float64, st.integers(1, 40), elements=st.floats(-9, 9) | st.just(np.nan)))
def test_median_is_numpys(values: Floats) -> None:
    before = values.copy()
    np.testing.assert_array_equal(median(values), np.median(values))
    np.testing.assert_array_equal(values, before)


def test_no_median_of_nothing() -> None:
    assert np.isnan(median(np.empty(0)))


def test_stretches() -> None:
    flags = np.array([True, False, True, True, False, True])
    assert stretches_of(flags) == [(0, 1), (2, 4), (5, 6)]
    assert times_of(flags, np.arange(6.0)) == ((0.0, 0.0), (2.0, 3.0), (5.0, 5.0))
    assert stretches_of(np.zeros(3, dtype=np.bool_)) == []
