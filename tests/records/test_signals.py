"""Signals and their clocks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.records.arrays import Floats
from labpipe.records.causes import CLOCK_DRIFT, CLOCK_OFFSET, GRIP
from labpipe.records.curve import ClockFit, Interval
from labpipe.records.signals import Clocks, Signal, Signals

TIME: Floats = np.arange(0.0, 10.0)


PULL = Signal(TIME, TIME + 1.0, "N", "force")


WAY = Signal(TIME, 1e-3 * TIME, "m", "frame")


class Halved:
    def __call__(self, values: Floats) -> Floats:
        return 0.5 * values

    def scale_step(self, ratio: float) -> Halved:
        assert ratio > 0.0
        return self


def fit(offset: float, drift: float = 0.0, errors: tuple[float, ...] = (0.1,)) -> ClockFit:
    interval, times = Interval(offset - 0.1, offset + 0.1), np.zeros(len(errors))
    return ClockFit(offset, drift, interval, interval, 0.0, times, times, np.array(errors), "")


def test_what_was_filtered_leaves_the_raw_signal() -> None:
    halved = Halved()
    once = Signals().add_signal("force", PULL).replace_filtered("force", WAY, (halved, 1))
    twice = once.replace_filtered("force", PULL, (halved, 2)).replace_filtered("force", WAY)
    assert twice.raw["force"] is PULL
    assert twice.filtered["force"] is WAY
    assert twice.filters["force"] == ((halved, 1), (halved, 2))


def test_a_level_is_taken_off_raw_and_filtered() -> None:
    smooth = replace(PULL, values=PULL.values + 0.5)
    signals = Signals().add_signal("force", PULL).replace_filtered("force", smooth)
    zeroed = signals.subtract_level("force", 1.0, 0.2)
    np.testing.assert_array_equal(zeroed.raw["force"].values, TIME)
    np.testing.assert_array_equal(zeroed.filtered["force"].values, TIME + 0.5)
    assert zeroed.raw["force"].zero_error == zeroed.filtered["force"].zero_error == 0.2
    assert zeroed.subtracted_levels == {"force": 1.0}
    assert zeroed.subtract_level("force", 0.25, 0.1).subtracted_levels == {"force": 1.25}
    np.testing.assert_array_equal(signals.raw["force"].values, TIME + 1.0)


def test_what_is_done_to_a_signal_is_done_to_all_that_it_may_have_been() -> None:
    signal = replace(WAY, variants={GRIP: WAY.values + 1e-3})
    doubled = signal.map_values(lambda values: 2.0 * values)
    np.testing.assert_allclose(doubled.values, 2e-3 * TIME)
    np.testing.assert_allclose(doubled.variants[GRIP], 2e-3 * TIME + 2e-3)
    zeroed = Signals().add_signal("way", signal).subtract_level("way", 5e-4, 0.0)
    np.testing.assert_allclose(zeroed.raw["way"].variants[GRIP], 1e-3 * TIME + 5e-4)


@pytest.mark.parametrize("event_count", [1, 4])
def test_times_go_from_clock_to_clock_and_back(event_count: int) -> None:
    """One event moves no drift; four know the offset twice as well."""
    joined = fit(2.0, 1e-3, (0.1,) * event_count)
    clocks = Clocks("frame", joined, {"markers": fit(-5.0)})
    for clock, time in (("force", 102.1), ("markers", 95.0), ("", 100.0), ("frame", 100.0)):
        assert clocks.from_curve(100.0, clock) == pytest.approx(time)
        assert clocks.to_curve(time, clock) == pytest.approx(100.0)
    assert clocks.offset_error == pytest.approx(0.1 / np.sqrt(event_count))
    nothing = replace(joined, drift_interval=Interval(np.nan, np.nan))
    assert list(Clocks("frame", nothing).variants) == [CLOCK_OFFSET]


@pytest.mark.parametrize("clocks", [Clocks(), Clocks("frame")])
def test_one_clock_needs_no_joining(clocks: Clocks) -> None:
    for clock in ("frame", "force"):
        assert clocks.to_curve(3.0, clock) == clocks.from_curve(3.0, clock) == 3.0
    assert (clocks.offset_error, clocks.variants) == (0.0, {})
    assert Clocks("frame").interpolate(WAY, TIME) is WAY.values


def test_samples_at_times_of_the_curve() -> None:
    clocks = Clocks("frame", fit(2.5))
    found = clocks.interpolate(PULL, TIME)  # sampled at 2.5 s, 3.5 s, ... of its own clock
    np.testing.assert_allclose(found[:7], TIME[:7] + 3.5)
    assert np.isnan(found[7:]).all()  # nothing is extrapolated
    assert clocks.interpolate(WAY, TIME) is WAY.values
    np.testing.assert_allclose(clocks.interpolate(WAY, np.array([0.5, 11.0])), [5e-4, np.nan])
    assert len(clocks.interpolate(WAY, np.zeros(0))) == 0


def test_clocks_moved_by_what_is_not_known_of_them() -> None:
    """Events at 0, 100, 400 s, the last known half as well: weights 4, 4, 1, middle 800 / 9 s."""
    known = Interval.make_normal(1e-3, 2e-5)
    events, errors = np.array([0.0, 100.0, 400.0]), np.array([0.1, 0.1, 0.2])
    joined = ClockFit(2.0, 1e-3, known, known, 0.0, events, np.zeros(3), errors, "")
    clocks = Clocks("frame", joined)
    assert clocks.mean_event_time == pytest.approx((4.0 * 100.0 + 400.0) / 9.0)
    assert clocks.offset_error == pytest.approx(0.2 / 3.0)
    assert clocks.drift_error == pytest.approx(2e-5)
    assert list(clocks.variants) == [CLOCK_OFFSET, CLOCK_DRIFT]
    for at in (0.0, 100.0, 1000.0):
        usual = clocks.from_curve(at, "force")
        later = clocks.variants[CLOCK_OFFSET].from_curve(at, "force")
        faster = clocks.variants[CLOCK_DRIFT].from_curve(at, "force")
        assert later - usual == pytest.approx(0.2 / 3.0)
        assert faster - usual == pytest.approx(2e-5 * (at - 800.0 / 9.0), abs=1e-12)
