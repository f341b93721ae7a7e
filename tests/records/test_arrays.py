from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from labpipe.records.arrays import (
    ArrayRecord,
    Floats,
    Ints,
    Vector,
    frozen,
    median,
    part_of,
    ratio,
    samples_of,
    stretches_of,
    times_of,
)


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


@dataclass(frozen=True, slots=True, eq=False)
class Track(ArrayRecord):
    """A record with arrays of every kind."""

    time: Vector
    places: Annotated[Floats, "n", "names", 3]
    names: tuple[str, ...]
    count: Annotated[Ints, "n"]
    terms: Annotated[Floats, "k", "k"]


def _track(**other: object) -> Track:
    given = {
        "time": [0, 1],
        "places": np.zeros((2, 1, 3)),
        "names": ("a",),
        "count": [1.0, 2.0],
        "terms": np.eye(4),
    }
    return Track(**{**given, **other})  # type: ignore[arg-type]


def test_arrays_of_a_record_are_read_only_and_of_their_type() -> None:
    track = _track()

    assert track.time.dtype == np.float64
    assert track.count.dtype == np.int64
    with pytest.raises(ValueError, match="read-only"):
        track.places[0, 0, 0] = 1.0


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("time", [[0.0]], r"expected time of shape \(None,\), found \(1, 1\)"),
        ("places", np.zeros((2, 2, 3)), r"expected places of shape \(2, 1, 3\), found \(2, 2, 3\)"),
        ("count", [1], r"expected count of shape \(2,\), found \(1,\)"),
        ("terms", np.zeros((2, 3)), r"expected terms of shape \(None, None\), found \(2, 3\)"),
    ],
)
def test_an_array_of_another_shape_is_refused(name: str, value: object, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        _track(**{name: value})


def test_samples_that_follow_one_another_are_a_stretch() -> None:
    assert samples_of(np.array([3, 4, 5])) == slice(3, 6)
    assert samples_of(np.array([], dtype=np.int64)) == slice(0, 0)
    scattered = samples_of(np.array([3, 5]))
    assert isinstance(scattered, np.ndarray)
    assert scattered.tolist() == [3, 5]


def test_some_of_the_samples() -> None:
    assert part_of(slice(10, 20), slice(2, 5)) == slice(12, 15)
    some = part_of(np.array([1, 4, 6, 9]), slice(1, 3))
    assert isinstance(some, np.ndarray)
    assert some.tolist() == [4, 6]


def test_nothing_to_divide_by_is_nan() -> None:
    found = ratio(np.array([1.0, 3.0]), np.array([[2.0], [0.0]]))
    np.testing.assert_array_equal(found, [[0.5, 1.5], [np.nan, np.nan]])
    assert ratio(np.array(6.0), np.array(4.0)) == 1.5
