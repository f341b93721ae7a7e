"""Arrays of records: read-only, of their type and shape."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
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
    median,
    ratio,
    samples_of,
    stretches_of,
    times_of,
)
from labpipe.records.curve import AT_REST, ClockFit, Curve, Interval, Series, Shape
from labpipe.records.figure_data import DrawnLaw, DrawnShapes
from labpipe.records.group import SampleCurve
from labpipe.records.recording import Clock, MarkerTracks, RigidBody
from labpipe.records.wire import WireLayout
from labpipe.records.wire_calibration import (
    Prediction,
    Profile,
)


@given(arrays(np.float64, st.integers(1, 40), elements=st.floats(-9, 9) | st.just(np.nan)))
def test_median_is_numpys(values: Floats) -> None:
    before = values.copy()
    np.testing.assert_array_equal(median(values), np.median(values))
    np.testing.assert_array_equal(values, before)


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
    given = {"time": [0, 1], "places": np.zeros((2, 1, 3)), "names": ("a",), "count": [1.0, 2.0]}
    return Track(**{**given, "terms": np.eye(4), **other})  # type: ignore[arg-type]


def test_arrays_of_a_record_are_read_only_and_of_their_type() -> None:
    assert not some_shape().flags.flags.writeable
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


def test_nothing_to_divide_by_is_nan() -> None:
    found = ratio(np.array([1.0, 3.0]), np.array([[2.0], [0.0]]))
    np.testing.assert_array_equal(found, [[0.5, 1.5], [np.nan, np.nan]])
    assert ratio(np.array(6.0), np.array(4.0)) == 1.5


NUMBERS = st.floats(-1e6, 1e6)


@given(NUMBERS, st.floats(1e-9, 1e6))
def test_interval_and_standard_error(value: float, error: float) -> None:
    interval = Interval.normal_95(value, error)
    assert interval.level == 0.95
    assert interval.upper - value == pytest.approx(1.959964 * error, rel=1e-6, abs=1e-9)
    assert interval.standard_error == pytest.approx(error, rel=1e-6, abs=1e-9)


def clock_fit(offset: float, drift: float) -> ClockFit:
    events, about = np.array([1.0, 2.0]), Interval(0.0, 1.0)
    return ClockFit(offset, drift, about, about, 0.0, events, events, events, "made up")


@given(st.floats(-10, 10), st.floats(-1e-3, 1e-3), st.floats(0, 1000))
def test_clocks_there_and_back(offset: float, drift: float, time: float) -> None:
    fit = clock_fit(offset, drift)
    there = fit.to_force_time(np.array([time]))
    assert there[0] == fit.to_force_seconds(time) == offset + (1 + drift) * time
    assert fit.to_marker_time(there)[0] == pytest.approx(time, abs=1e-9)


def some_curve() -> Curve:
    zeros, ints = np.zeros(4), np.full(4, AT_REST)
    return Curve(np.arange(4.0), zeros, zeros, ints, ints + 1, ())


TIME = np.zeros(3)


def some_shape() -> Shape:
    flags, turned = np.zeros((3, 2), dtype=np.uint8), np.eye(3)
    positions, coefficients = np.zeros((3, 2, 3)), np.zeros((3, 3, 0))
    return Shape(TIME, positions, ("a", "b"), flags, np.zeros(2), coefficients, 1.0, turned)


TWO, FIVE = np.zeros(2), np.zeros(5)


TWO, FIVE = np.zeros(2), np.zeros(5)
UNEVEN: dict[str, Callable[[], object]] = {
    "clock": lambda: Clock("time", np.zeros((3, 1))),
    "series": lambda: Series(np.zeros((2, 2)), "N"),
    "body": lambda: RigidBody("Clamp", np.zeros((5, 3)), np.zeros((4, 4)), FIVE),
    "tracks": lambda: MarkerTracks(FIVE, FIVE, 1.0, ("a", "b", "c"), np.zeros((5, 2, 3))),
    "drawn shapes": lambda: DrawnShapes(np.zeros(3), np.zeros((2, 5, 2))),
    "drawn law": lambda: DrawnLaw(np.zeros(4), np.zeros(4), np.zeros(4), np.zeros(3)),
    "sample": lambda: SampleCurve(FIVE, np.zeros(6), FIVE),
    "layout": lambda: WireLayout("packed", np.zeros(3), TWO, np.zeros(2, int), TWO, 1e-3, 2e-3),
    "prediction": lambda: Prediction(TWO, TWO, TWO, TWO, TWO, np.zeros(3)),
    "profile": lambda: Profile(np.zeros(3), TWO, 3.84, 20.0),
    "curve": lambda: replace(some_curve(), force=FIVE),
    "shape": lambda: replace(some_shape(), positions=np.zeros((3, 3, 3))),
    "turned shape": lambda: replace(some_shape(), rotation_lab_to_specimen=np.eye(4)),
}


@pytest.mark.parametrize("make", UNEVEN.values(), ids=UNEVEN)
def test_arrays_of_uneven_lengths_are_refused(make: Callable[[], object]) -> None:
    with pytest.raises(ValueError, match=r"expected \w+ of shape .*, found"):
        make()
