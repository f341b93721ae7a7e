"""From numbers, or reasons why there are none, to results with a status."""

from __future__ import annotations

import pytest

from labpipe.records.curve import Interval
from labpipe.records.declarations import Output
from labpipe.records.estimates import Estimate, Failure
from labpipe.records.quality import Finding, Findings, Reason, blocking, doubtful
from labpipe.records.result import Contribution, Status
from labpipe.records.signals import Signals
from labpipe.results.evidence import Evidence
from labpipe.results.kinds import Number, Outcome, blocked_or, to_result

STIFFNESS = Output("stiffness", "N/m", rests_on=("force", "displacement"))


def evidence(*found: Finding) -> Evidence:
    return Evidence(Signals(), findings=Findings(found))


def asked(outcome: Outcome, *doubts: Reason, part: str = "") -> Number:
    return Number(STIFFNESS, outcome, "by a line", doubts=doubts, part=part)


def test_a_number() -> None:
    found = to_result(evidence(), asked(Estimate(10.0, 1.0, 50)))
    assert (found.name, found.value, found.unit, found.n) == ("stiffness", 10.0, "N/m", 50)
    assert (found.status, found.why, found.method) == (Status.OK, "", "by a line")
    assert found.interval is not None
    assert found.interval.lower == pytest.approx(10.0 - 1.959964, abs=1e-6)


def test_errors_from_outside_the_fit_come_on_top() -> None:
    errors = {"scale of the force": 3.0, "length": 4.0}
    found = to_result(evidence(), Number(STIFFNESS, Estimate(10.0, 0.0, 50), "", errors))
    assert found.interval is not None
    assert found.interval.standard_error == pytest.approx(5.0)
    assert found.budget == (
        Contribution("scale of the force", 3.0, is_common=True),
        Contribution("length", 4.0),
    )


def test_an_interval_of_its_own() -> None:
    asymmetric = Interval(9.0, 14.0)
    found = to_result(evidence(), asked(Estimate(10.0, 1.0, 50, asymmetric), part=".2"))
    assert found.name == "stiffness.2"
    assert found.interval is asymmetric
    (fit,) = found.budget
    assert fit.cause == "fit"
    assert fit.change == pytest.approx(2.5 / 1.959964)


def test_no_number() -> None:
    failure = Failure("gap", "4 samples are missing")
    found = to_result(evidence(), asked(failure, Reason("x", "y")))
    assert (found.value, found.interval, found.status) == (None, None, Status.FAILED)
    assert found.why == "gap: 4 samples are missing"
    assert found.method == "by a line"


@pytest.mark.parametrize(
    "outcome", [Estimate(float("nan"), 1.0, 3), Estimate(1.0, float("inf"), 3)]
)
def test_a_number_that_is_none(outcome: Estimate) -> None:
    found = to_result(evidence(), asked(outcome))
    assert found.status is Status.FAILED
    assert found.why == f"not_finite: value {outcome.value}, standard error {outcome.error}"


def test_doubts_of_its_quantities() -> None:
    test = evidence(
        doubtful("drift", "force", "the zero drifts", "force"),
        doubtful("drift", "clock", "the clock drifts", "clock"),
    )
    found = to_result(test, asked(Estimate(10.0, 1.0, 50), Reason("slip_in_window", "at 6 mm")))
    assert found.status is Status.DOUBTFUL
    assert found.why == "drift: the zero drifts; slip_in_window: at 6 mm"


def test_one_doubt_is_reported_once() -> None:
    test = evidence(doubtful("turn", "travel", "not seen", "force", "displacement"))
    assert to_result(test, asked(Estimate(1.0, 0.1, 5))).why == "turn: not seen"


def test_what_stopped_the_test_comes_first() -> None:
    otherwise = Failure("no_cycle", "no branch")
    assert blocked_or(evidence(), otherwise) is otherwise
    stopped = evidence(blocking("no_motion", "travel", "it spans 0.1 mm: too little"))
    assert blocked_or(stopped, otherwise) == Failure("no_motion", "it spans 0.1 mm: too little")
