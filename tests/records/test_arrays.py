"""Arrays of records: read-only, of their type and shape."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
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
    convert_to_slice,
    divide,
    find_run_times,
    find_runs,
    median,
)
from labpipe.records.curve import ClockFit, Curve, FigureLaw, FigureShapes, Interval, Series, Shape
from labpipe.records.group import SampleCurve
from labpipe.records.recording import Clock, MarkerTracks, RigidBody
from labpipe.records.wire import Prediction, Profile, WireLayout
from tests.approved import Approve


@given(arrays(np.float64, st.integers(1, 40), elements=st.floats(-9, 9) | st.just(np.nan)))
def test_median_is_numpys(values: Floats) -> None:
    original = values.copy()
    np.testing.assert_array_equal(median(values), np.median(values))
    np.testing.assert_array_equal(values, original)


def test_stretches() -> None:
    flags = np.array([True, False, True, True, False, True])
    assert find_runs(flags) == [(0, 1), (2, 4), (5, 6)]
    assert find_run_times(flags, np.arange(6.0)) == ((0.0, 0.0), (2.0, 3.0), (5.0, 5.0))
    assert find_runs(np.zeros(3, dtype=np.bool_)) == []


@dataclass(frozen=True, slots=True, eq=False)
class Track(ArrayRecord):
    """A record with arrays of every kind."""

    time: Vector
    places: Annotated[Floats, "n", "names", 3]
    names: tuple[str, ...]
    count: Annotated[Ints, "n"]
    terms: Annotated[Floats, "k", "k"]


def _track(**changes: object) -> Track:
    fields = {"time": [0, 1], "places": np.zeros((2, 1, 3)), "names": ("a",), "count": [1.0, 2.0]}
    return Track(**{**fields, "terms": np.eye(4), **changes})  # type: ignore[arg-type]


def test_arrays_of_a_record_are_read_only_and_of_their_type() -> None:
    track = _track()
    assert track.time.dtype == np.float64
    assert track.count.dtype == np.int64
    with pytest.raises(ValueError, match="read-only"):
        track.places[0, 0, 0] = 1.0


def test_samples_that_follow_one_another_are_a_stretch() -> None:
    assert convert_to_slice(np.array([3, 4, 5])) == slice(3, 6)
    assert convert_to_slice(np.array([], dtype=np.int64)) == slice(0, 0)
    scattered = convert_to_slice(np.array([3, 5]))
    assert isinstance(scattered, np.ndarray)
    assert scattered.tolist() == [3, 5]


def test_nothing_to_divide_by_is_nan() -> None:
    quotient = divide(np.array([1.0, 3.0]), np.array([[2.0], [0.0]]))
    np.testing.assert_array_equal(quotient, [[0.5, 1.5], [np.nan, np.nan]])
    assert divide(np.array(6.0), np.array(4.0)) == 1.5


NUMBERS = st.floats(-1e6, 1e6)


@given(NUMBERS, st.floats(1e-9, 1e6))
def test_interval_and_standard_error(value: float, error: float) -> None:
    interval = Interval.make_normal(value, error)
    assert interval.level == 0.95
    assert interval.upper - value == pytest.approx(1.959964 * error, rel=1e-6, abs=1e-9)
    assert interval.standard_error == pytest.approx(error, rel=1e-6, abs=1e-9)


@given(st.floats(-10, 10), st.floats(-1e-3, 1e-3), st.floats(0, 1000))
def test_clocks_there_and_back(offset: float, drift: float, time: float) -> None:
    events, interval = np.array([1.0, 2.0]), Interval(0.0, 1.0)
    fit = ClockFit(offset, drift, interval, interval, 0.0, events, events, events, "made up")
    force_time = fit.to_force_time(np.array([time]))
    assert force_time[0] == fit.to_force_time(time) == offset + (1 + drift) * time
    assert fit.to_marker_time(force_time)[0] == pytest.approx(time, abs=1e-9)


TWO, THREE, FOUR, FIVE = (np.zeros(count) for count in (2, 3, 4, 5))
POINTS, EYE, FLAGS = np.zeros((3, 2, 3)), np.eye(3), np.zeros((3, 2))
UNEVEN: list[tuple[Callable[..., object], tuple[object, ...]]] = [
    (Clock, ("time", np.zeros((3, 1)))),
    (Series, (np.zeros((2, 2)), "N")),
    (RigidBody, ("Clamp", np.zeros((5, 3)), np.zeros((4, 4)), FIVE)),
    (MarkerTracks, (FIVE, FIVE, 1.0, ("a", "b", "c"), np.zeros((5, 2, 3)))),
    (FigureShapes, (THREE, np.zeros((2, 5, 2)))),
    (FigureLaw, (FOUR, FOUR, FOUR, THREE)),
    (SampleCurve, (FIVE, FOUR, FIVE)),
    (WireLayout, ("packed", THREE, TWO, np.zeros(2, int), TWO, 1e-3, 2e-3)),
    (Prediction, (TWO, TWO, TWO, TWO, TWO, THREE)),
    (Profile, (THREE, TWO, 3.84, 20.0)),
    (Curve, (FOUR, FOUR, FIVE, ())),
    (Shape, (THREE, POINTS[:, :1], ("a", "b"), FLAGS, TWO, np.zeros((3, 3, 0)), 1.0, EYE)),
    (Shape, (THREE, POINTS, ("a", "b"), FLAGS, TWO, np.zeros((3, 3, 0)), 1.0, np.eye(4))),
]


def test_arrays_of_another_shape_are_refused(approved: Approve) -> None:
    messages = []
    wrong_arrays: dict[str, object] = {"time": [[0.0]], "places": np.zeros((2, 2, 3)), "count": [1]}
    wrong_arrays["terms"] = np.zeros((2, 3))
    makers: list[Callable[[], object]] = [
        partial(_track, **{name: value}) for name, value in wrong_arrays.items()
    ]
    makers += [partial(kind, *values) for kind, values in UNEVEN]
    for make in makers:
        with pytest.raises(ValueError) as refused:  # noqa: PT011  the text is approved
            make()
        messages.append(refused.value)
    approved(messages)
