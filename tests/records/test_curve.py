from __future__ import annotations

from dataclasses import FrozenInstanceError, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from labpipe.records.curve import AT_REST, Aligned, ClockFit, Curve, Interval, Series, Shape

NUMBERS = st.floats(-1e6, 1e6)


@given(NUMBERS, st.floats(1e-9, 1e6))
def test_interval_and_standard_error(value: float, error: float) -> None:
    interval = Interval.normal_95(value, error)
    assert interval.level == 0.95
    assert interval.upper - value == pytest.approx(1.959964 * error, rel=1e-6, abs=1e-9)
    assert interval.standard_error == pytest.approx(error, rel=1e-6, abs=1e-9)


def clock_fit(offset: float, drift: float) -> ClockFit:
    events = np.array([1.0, 2.0])
    about = Interval(0.0, 1.0)
    return ClockFit(offset, drift, about, about, 0.0, events, events, events, "made up")


@given(st.floats(-10, 10), st.floats(-1e-3, 1e-3), st.floats(0, 1000))
def test_clocks_there_and_back(offset: float, drift: float, time: float) -> None:
    fit = clock_fit(offset, drift)
    there = fit.to_force_time(np.array([time]))
    assert there[0] == fit.to_force_seconds(time) == offset + (1 + drift) * time
    assert fit.to_marker_time(there)[0] == pytest.approx(time, abs=1e-9)


def curve() -> Curve:
    n = 4
    zeros, ints = np.zeros(n), np.full(n, AT_REST)
    return Curve(np.arange(n, dtype=float), zeros, zeros, ints, ints + 1, ())


def test_curve_is_frozen() -> None:
    made = curve()
    with pytest.raises(FrozenInstanceError):
        made.time = np.zeros(4)  # type: ignore[misc]
    for name in ("time", "force", "displacement", "branch", "cycle"):
        assert not getattr(made, name).flags.writeable


@pytest.mark.parametrize("name", ["force", "displacement", "branch", "cycle"])
def test_curve_of_uneven_lengths(name: str) -> None:
    wrong: dict[str, Any] = {name: np.zeros(5)}
    with pytest.raises(ValueError, match=r"expected .*shape"):
        replace(curve(), **wrong)


def test_clocks_are_in_seconds_unless_rows_are_counted() -> None:
    assert curve().time_unit == Aligned(np.arange(3.0), {}).time_unit == "s"
    rows = replace(curve(), time_unit="1")
    assert rows.time_unit == "1"
    assert not rows.time.flags.writeable


def shape() -> Shape:
    return Shape(
        time=np.zeros(3),
        positions=np.zeros((3, 2, 3)),
        names=("a", "b"),
        flags=np.zeros((3, 2), dtype=np.uint8),
        arc_length=np.zeros(2),
        coefficients=np.zeros((3, 3, 0)),
        length=1.0,
        rotation_lab_to_specimen=np.eye(3),
    )


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        ("positions", np.zeros((3, 3, 3))),
        ("flags", np.zeros((2, 2), dtype=np.uint8)),
        ("arc_length", np.zeros(3)),
        ("coefficients", np.zeros((3, 2, 4))),
        ("rotation_lab_to_specimen", np.eye(4)),
    ],
)
def test_shape_of_the_wrong_shape(name: str, wrong: Any) -> None:
    assert not shape().flags.flags.writeable
    with pytest.raises(ValueError, match=r"expected .* of shape .*, found"):
        replace(shape(), **{name: wrong})


def test_series_is_one_dimensional() -> None:
    with pytest.raises(ValueError, match=r"expected \w+ of shape"):
        Series(np.zeros((2, 2)), "N")
