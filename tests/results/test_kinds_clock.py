"""How two clocks lie to each other, as results."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.records.curve import ClockFit, Interval
from labpipe.records.result import Status
from labpipe.records.signals import Clocks, Signals
from labpipe.results.evidence import Evidence
from labpipe.results.kinds import ClockResult, to_result
from tests.builders.reduced import loop, reduced

AT = np.array([20.0])
OFFSET = Interval(9.9, 10.1)


def fit(drift: Interval) -> ClockFit:
    return ClockFit(10.0, 2e-5, OFFSET, drift, 0.0, AT, AT + 10.0, 0.1 * AT, "by turns")


def test_one_clock() -> None:
    test, _ = reduced(*loop())
    assert test.clocks.force is None
    found = [to_result(test, each) for each in ClockResult().compute(test).numbers]
    assert [each.why for each in found] == ["one_clock: there is only one clock"] * 2
    assert [each.unit for each in found] == ["s", "1"]


def test_offset_and_drift_as_the_clocks_were_joined() -> None:
    test = Evidence(Signals(), Clocks("markers", fit(Interval(1e-5, 3e-5))))
    offset, drift = (to_result(test, each) for each in ClockResult().compute(test).numbers)
    assert (offset.name, offset.value, offset.method) == ("clock_offset", 10.0, "by turns")
    assert offset.interval is not None
    assert offset.interval.lower == pytest.approx(9.9)
    assert (drift.name, drift.value, drift.status) == ("clock_drift", 2e-5, Status.OK)


def test_one_turn_gives_no_drift() -> None:
    nothing = Interval(float("nan"), float("nan"))
    test = Evidence(Signals(), Clocks("markers", fit(nothing)))
    offset, drift = (to_result(test, each) for each in ClockResult().compute(test).numbers)
    assert offset.status is Status.OK
    assert drift.why.startswith("one_event: ")
