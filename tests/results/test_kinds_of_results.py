from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.fits.failure_point import FailurePoint
from labpipe.records.curve import Branch, ClockFit, Curve, Direction, Interval
from labpipe.records.declarations import Output
from labpipe.records.estimates import Estimate, Failure
from labpipe.records.quality import Finding, Findings, Reason, blocking, doubtful
from labpipe.records.result import Contribution, Status
from labpipe.records.signals import Clocks, Signal, Signals
from labpipe.results.kinds import ClockResult, Number, Outcome, blocked_or, to_result
from labpipe.results.reduced_test import ReducedTest
from labpipe.uncertainty.intervals import Measured
from tests.builders.reduced import loop, reduced

STIFFNESS = Output("stiffness", "N/m", rests_on=("force", "displacement"))


def evidence(*found: Finding) -> ReducedTest:
    return ReducedTest(Signals(), findings=Findings(found))


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


AT = np.array([20.0])


OFFSET = Interval(9.9, 10.1)


def fit(drift: Interval) -> ClockFit:
    return ClockFit(10.0, 2e-5, OFFSET, drift, 0.0, AT, AT + 10.0, 0.1 * AT, "by turns")


def test_one_clock() -> None:
    test, _ = reduced(*loop())
    assert test.clocks.force is None
    found = [to_result(test, number) for number in ClockResult().compute(test).numbers]
    assert [finding.why for finding in found] == ["one_clock: there is only one clock"] * 2
    assert [finding.unit for finding in found] == ["s", "1"]


def test_offset_and_drift_as_the_clocks_were_joined() -> None:
    test = ReducedTest(Signals(), Clocks("markers", fit(Interval(1e-5, 3e-5))))
    offset, drift = (to_result(test, number) for number in ClockResult().compute(test).numbers)
    assert (offset.name, offset.value, offset.method) == ("clock_offset", 10.0, "by turns")
    assert offset.interval is not None
    assert offset.interval.lower == pytest.approx(9.9)
    assert (drift.name, drift.value, drift.status) == ("clock_drift", 2e-5, Status.OK)


def test_one_turn_gives_no_drift() -> None:
    nothing = Interval(float("nan"), float("nan"))
    test = ReducedTest(Signals(), Clocks("markers", fit(nothing)))
    offset, drift = (to_result(test, number) for number in ClockResult().compute(test).numbers)
    assert offset.status is Status.OK
    assert drift.why.startswith("one_event: ")


UP, DOWN = Direction.LOADING, Direction.UNLOADING


APART = Clocks("markers")


"""Not joined."""


FROZEN = (Reason("frozen", "stands"),)


def located(clocks: Clocks = APART) -> ReducedTest:
    """A force in doubt from 40 s to 42 s of its own clock."""
    time = np.arange(0.0, 100.0)
    signals = Signals()
    for name, clock in (("force", "force"), ("displacement", "markers")):
        signals = signals.with_new(name, Signal(time, time, "N", clock))
    found = doubtful("frozen", "force", "stands", "force", during=(40.0, 42.0), clock="force")
    return ReducedTest(signals, clocks, findings=Findings((found,)))


def test_an_event_touches_what_lies_over_it_and_nothing_else() -> None:
    test = located()
    assert test.why_doubtful("force", (41.0, 60.0)) == FROZEN
    assert test.why_doubtful("force", (0.0, 39.0)) == ()
    assert test.why_doubtful("displacement", (41.0, 60.0)) == ()
    assert test.why_doubtful("force") == FROZEN


def test_an_event_is_looked_for_on_the_clock_of_the_curve() -> None:
    """That of the force is 10 s ahead of it."""
    at, known = np.array([20.0]), Interval(9.9, 10.1)
    fit = ClockFit(10.0, 0.0, known, known, 0.0, at, at + 10.0, at * 0.0 + 0.1, "")
    test = located(Clocks("markers", fit))
    assert test.why_doubtful("force", (29.0, 31.0)) == FROZEN
    assert test.why_doubtful("force", (41.0, 60.0)) == ()


@pytest.mark.parametrize("taken", ["zeroed", "lined"])
def test_an_event_in_the_stretch_of_the_zero_touches_all(taken: str) -> None:
    test = located()
    zero = {"force": (39.0, 41.0)}
    signals = replace(
        test.signals,
        **{taken: zero},  # type: ignore[arg-type]
    )
    assert replace(test, signals=signals).why_doubtful("force", (60.0, 70.0)) == FROZEN


def test_of_each_code_the_first_reason_counts() -> None:
    more = doubtful("frozen", "force", "again", "force")
    other = doubtful("drift", "force", "the zero drifts", "force")
    test = located()
    test = replace(test, findings=test.findings + iter((more, other)))
    assert test.why_doubtful("force") == (*FROZEN, Reason("drift", "the zero drifts"))


BRANCHES = (
    Branch(0, 2, 1, UP, 0.0, 2.0),
    Branch(2, 4, 1, DOWN, 2.0, 4.0),
    Branch(4, 6, 2, UP, 4.0, 6.0),
)


def curve(branches: tuple[Branch, ...] = BRANCHES) -> Curve:
    path = np.array([0.0, 1.0, 2.0, 1.0, 0.0, 1.0])
    return Curve(np.arange(6.0), path, path, np.zeros(6, int), np.ones(6, int), branches)


def test_branches_by_cycle() -> None:
    test = ReducedTest(Signals(), curve=curve())
    assert test.cycles == [list(BRANCHES[:2]), [BRANCHES[2]]]
    assert test.first_loading is BRANCHES[0]
    assert test.loading_stretch == slice(0, 2)


def test_the_first_loading_ends_with_the_sample_of_the_failure() -> None:
    def until(sample: int) -> slice:
        failure = FailurePoint(sample)
        return ReducedTest(Signals(), curve=curve(), failure=failure).loading_stretch

    assert until(0) == slice(0, 1)
    assert until(1) == slice(0, 2)
    assert until(2) == slice(0, 2), "it failed later"


def test_without_a_curve() -> None:
    test = ReducedTest(Signals())
    assert test.cycles == []
    assert test.first_loading is None
    assert test.loading_stretch == slice(0, 0)
    assert test.while_loading() is None
    with pytest.raises(ValueError, match="before there is a curve"):
        _ = test.known_curve


def test_a_record_that_begins_with_an_unloading() -> None:
    assert ReducedTest(Signals(), curve=curve(BRANCHES[1:2])).first_loading is None


def test_when_the_first_loading_went_between_two_displacements() -> None:
    test = ReducedTest(Signals(), curve=curve((Branch(0, 3, 1, UP, 0.0, 2.5),)))
    assert test.while_loading() == (0.0, 2.5)
    assert test.while_loading(0.5, 1.5) == (1.0, 2.0)
    assert test.while_loading(0.5, 9.0) == (1.0, 2.5)


def test_error_of_the_slack() -> None:
    assert ReducedTest(Signals()).slack_error == 0.0
    assert (
        ReducedTest(Signals(), slack=Measured(1e-3, np.array([-2e-5, 2e-5]), (), 50)).slack_error
        == 2e-5
    )
