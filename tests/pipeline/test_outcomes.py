"""From numbers, or reasons why there are none, to results with a status."""

from __future__ import annotations

import pytest

from labpipe.pipeline.bench import Bench
from labpipe.pipeline.outcomes import Asked, blocked_or, to_result
from labpipe.records.curve import Interval
from labpipe.records.estimates import Estimate, Failure
from labpipe.records.quality import Reason
from labpipe.records.result import Status

ASKED = Asked("stiffness", "N/m", ("force", "displacement"), "by a line")


def test_a_number() -> None:
    found = to_result(Bench(), ASKED, Estimate(10.0, 1.0, 50))
    assert (found.name, found.value, found.unit, found.n) == ("stiffness", 10.0, "N/m", 50)
    assert (found.status, found.why, found.method) == (Status.OK, "", "by a line")
    assert found.interval is not None
    assert found.interval.lower == pytest.approx(10.0 - 1.959964, abs=1e-6)


def test_an_interval_of_its_own() -> None:
    lopsided = Interval(9.0, 14.0)
    found = to_result(Bench(), ASKED, Estimate(10.0, 1.0, 50, lopsided), part=".2")
    assert found.name == "stiffness.2"
    assert found.interval is lopsided


def test_no_number() -> None:
    found = to_result(
        Bench(), ASKED, Failure("gap", "4 samples are missing"), doubts=[Reason("x", "y")]
    )
    assert (found.value, found.interval, found.status) == (None, None, Status.FAILED)
    assert found.why == "gap: 4 samples are missing"
    assert found.method == "by a line"


@pytest.mark.parametrize(
    "outcome", [Estimate(float("nan"), 1.0, 3), Estimate(1.0, float("inf"), 3)]
)
def test_a_number_that_is_none(outcome: Estimate) -> None:
    found = to_result(Bench(), ASKED, outcome)
    assert found.status is Status.FAILED
    assert found.why == f"not_finite: value {outcome.value}, standard error {outcome.error}"


def test_doubts_of_its_quantities() -> None:
    bench = Bench()
    bench.doubt("force", "drift", "the zero drifts", where="force")
    bench.doubt("clock", "drift", "the clock drifts", where="clock")
    found = to_result(
        bench, ASKED, Estimate(10.0, 1.0, 50), doubts=[None, Reason("slip_in_window", "at 6 mm")]
    )
    assert found.status is Status.DOUBTFUL
    assert found.why == "drift: the zero drifts; slip_in_window: at 6 mm"


def test_one_doubt_is_told_once() -> None:
    bench = Bench()
    for quantity in ("force", "displacement"):
        bench.doubt(quantity, "turn", "not seen", where="travel")
    assert to_result(bench, ASKED, Estimate(1.0, 0.1, 5)).why == "turn: not seen"


def test_what_stopped_the_test_comes_first() -> None:
    bench, otherwise = Bench(), Failure("no_cycle", "no branch")
    assert blocked_or(bench, otherwise) is otherwise
    bench.block("no_motion", "it spans 0.1 mm: too little", where="travel")
    assert blocked_or(bench, otherwise) == Failure("no_motion", "it spans 0.1 mm: too little")
