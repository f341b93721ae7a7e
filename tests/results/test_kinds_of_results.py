from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from labpipe.records.arrays import Floats
from labpipe.records.curve import Branch, ClockFit, Curve, Direction, Interval
from labpipe.records.declarations import Output
from labpipe.records.estimates import Estimate, Failure, return_failure
from labpipe.records.quality import Doubt, Finding, Findings, QualityNote, Reason, Severity
from labpipe.records.result import Contribution, Result, Status
from labpipe.records.signals import Clocks, Signal, Signals
from labpipe.results.curves import make_trace, select_first_loading
from labpipe.results.kinds import (
    ClockResult,
    FailurePoint,
    Kind,
    MeasuredItem,
    Outcome,
    ReducedTest,
    find_pause_doubts,
)
from tests.builders.reduced import recorded


class ByLine(Kind):
    result = "stiffness"
    outputs = (Output("stiffness", "N/m", depends_on=("force", "displacement")),)
    method = "by a line"

    def measure(self, test: ReducedTest) -> Iterator[MeasuredItem]:
        yield from test.require(None, Failure("none", ""))


def finding(
    code: str,
    message: str,
    *quantities: str,
    period: tuple[float, float] | None = None,
    is_blocking: bool = False,
) -> Finding:
    note, reason = QualityNote(code, Severity.WARNING, "force", message), Reason(code, message)
    return Finding(note, tuple(Doubt(x, reason, period, "force") for x in quantities), is_blocking)


def evidence(*found: Finding) -> ReducedTest:
    return ReducedTest(Signals(), findings=Findings(found))


def number(test: ReducedTest, outcome: Outcome, *doubts: Reason, suffix: str = "") -> Result:
    return ByLine().make_result(test, outcome, doubts=doubts, suffix=suffix)


def test_a_number() -> None:
    result = number(evidence(), Estimate(10.0, 1.0, 50))
    assert (result.name, result.value, result.unit, result.n) == ("stiffness", 10.0, "N/m", 50)
    assert (result.status, result.reason_text, result.method) == (Status.OK, "", "by a line")
    assert result.interval is not None
    assert result.interval.lower == pytest.approx(10.0 - 1.959964, abs=1e-6)


def test_errors_from_outside_the_fit_come_on_top() -> None:
    """The part of the fit in an interval of its own is half its width, as a normal one has it."""
    errors = {"scale of the force": 3.0, "length": 4.0}
    result = ByLine().make_result(evidence(), Estimate(10.0, 0.0, 50), errors)
    assert result.interval is not None
    assert result.interval.standard_error == pytest.approx(5.0)
    scale = Contribution("scale of the force", 3.0, is_common=True)
    assert result.budget == (scale, Contribution("length", 4.0))
    asymmetric = Interval(9.0, 14.0)
    result = number(evidence(), Estimate(10.0, 1.0, 50, asymmetric), suffix=".2")
    assert (result.name, result.interval) == ("stiffness.2", asymmetric)
    assert [row.cause for row in result.budget] == ["fit"]
    assert result.budget[0].change == pytest.approx(2.5 / 1.959964)


def test_no_number() -> None:
    failure = Failure("gap", "4 samples are missing")
    result = number(evidence(), failure, Reason("x", "y"))
    assert (result.value, result.interval, result.status) == (None, None, Status.FAILED)
    assert (result.reason_text, result.method) == ("gap: 4 samples are missing", "by a line")
    for value, error in ((float("nan"), 1.0), (1.0, float("inf"))):
        result = number(evidence(), Estimate(value, error, 3))
        assert result.status is Status.FAILED
        assert result.reason_text.endswith(f"finite: value {value}, standard error {error}")


def test_doubts_of_its_quantities() -> None:
    test = evidence(
        finding("drift", "the zero drifts", "force"), finding("drift", "the clock drifts", "clock")
    )
    result = number(test, Estimate(10.0, 1.0, 50), Reason("slip_in_window", "at 6 mm"))
    assert result.status is Status.DOUBTFUL
    assert result.reason_text == "drift: the zero drifts; slip_in_window: at 6 mm"
    twice = evidence(finding("turn", "not seen", "force", "displacement"))
    assert number(twice, Estimate(1.0, 0.1, 5)).reason_text == "turn: not seen"


def test_what_stopped_the_test_comes_first() -> None:
    otherwise = Failure("no_cycle", "no branch")
    assert return_failure(evidence().require)(None, otherwise) is otherwise
    stopped = evidence(finding("no_motion", "it spans 0.1 mm: too little", is_blocking=True))
    assert return_failure(stopped.require)(None, otherwise) == Failure(
        "no_motion", "it spans 0.1 mm: too little"
    )


AT = np.array([20.0])


OFFSET = Interval(9.9, 10.1)


def of_clocks(*drift: float) -> list[Result]:
    joined = ClockFit(
        10.0, 2e-5, OFFSET, Interval(*drift), 0.0, AT, AT + 10.0, 0.1 * AT, "by turns"
    )
    test = ReducedTest(Signals(), Clocks("markers", joined))
    return ClockResult().compute_results(test)


def test_offset_and_drift_of_clocks() -> None:
    offset, drift = of_clocks(1e-5, 3e-5)
    assert (offset.name, offset.value, offset.method) == ("clock_offset", 10.0, "by turns")
    assert offset.interval is not None
    assert offset.interval.lower == pytest.approx(9.9)
    assert (drift.name, drift.value, drift.status) == ("clock_drift", 2e-5, Status.OK)
    offset, drift = of_clocks(float("nan"), float("nan"))
    assert offset.status is Status.OK
    assert drift.reason_text.startswith("one_event: ")
    test = ReducedTest(Signals())
    for result, unit in zip(ClockResult().compute_results(test), ("s", "1"), strict=True):
        assert (result.reason_text, result.unit) == ("one_clock: there is only one clock", unit)


UP, DOWN = Direction.LOADING, Direction.UNLOADING


APART = Clocks("markers")


"""Not joined."""


FROZEN = (Reason("frozen", "stands"),)


def located(clocks: Clocks = APART) -> ReducedTest:
    """A force in doubt from 40 s to 42 s of its own clock."""
    time = np.arange(0.0, 100.0)
    signals = Signals()
    for name, clock in (("force", "force"), ("displacement", "markers")):
        signals = signals.add_signal(name, Signal(time, time, "N", clock))
    frozen = finding("frozen", "stands", "force", period=(40.0, 42.0))
    return ReducedTest(signals, clocks, findings=Findings((frozen,)))


def test_an_event_touches_what_lies_over_it_and_nothing_else() -> None:
    """Looked for on the clock of the curve, of which that of the force may be 10 s ahead."""
    joined = ClockFit(10.0, 0.0, OFFSET, OFFSET, 0.0, AT, AT + 10.0, 0.0 * AT + 0.1, "")
    for test, ahead in ((located(), 0.0), (located(Clocks("markers", joined)), 10.0)):
        for period, reasons in (((41.0, 60.0), FROZEN), ((38.0, 41.0), FROZEN), ((0.0, 39.0), ())):
            stretch = (period[0] - ahead, period[1] - ahead)
            assert test.collect_doubts(["force"], stretch) == list(reasons)
            assert test.collect_doubts(["displacement"], stretch) == []
        assert test.collect_doubts(["force"], None) == list(FROZEN)


def test_an_event_in_the_stretch_of_the_zero_touches_all() -> None:
    test, zero = located(), {"force": (39.0, 41.0)}
    for signals in (
        replace(test.signals, zero_stretches=zero),
        replace(test.signals, moving_zero_stretches=zero),
    ):
        assert replace(test, signals=signals).collect_doubts(["force"], (60.0, 70.0)) == list(
            FROZEN
        )


def test_of_each_code_the_first_reason_counts() -> None:
    more = finding("frozen", "again", "force")
    repeated = finding("drift", "the zero drifts", "force")
    test = located()
    test = replace(test, findings=test.findings + iter((more, repeated)))
    assert test.collect_doubts(["force"], None) == [*FROZEN, Reason("drift", "the zero drifts")]


BRANCHES = (
    Branch(0, 2, 1, UP, 0.0, 2.0),
    Branch(2, 4, 1, DOWN, 2.0, 4.0),
    Branch(4, 6, 2, UP, 4.0, 6.0),
)


def evidence_of(*branches: Branch, failure: FailurePoint | None = None) -> ReducedTest:
    path = np.array([0.0, 1.0, 2.0, 1.0, 0.0, 1.0])
    curve = Curve(np.arange(6.0), path, path, branches)
    return ReducedTest(Signals(), curve=curve, failure=failure)


def test_branches_by_cycle() -> None:
    """The first loading ends with the sample of the failure."""
    test = evidence_of(*BRANCHES)
    assert test.cycles == [list(BRANCHES[:2]), [BRANCHES[2]]]
    assert test.first_loading is BRANCHES[0]
    assert select_first_loading(make_trace(test)) == slice(0, 2)
    for sample, stop in ((0, 1), (1, 2), (2, 2)):
        failed = evidence_of(*BRANCHES, failure=FailurePoint(sample))
        assert select_first_loading(make_trace(failed)) == slice(0, stop)
    assert evidence_of(BRANCHES[1]).first_loading is None


def test_without_a_curve() -> None:
    test = ReducedTest(Signals())
    assert test.cycles == []
    assert test.first_loading is None
    assert test.find_loading_period() is None
    with pytest.raises(ValueError, match="found none"):
        _ = test.required_curve


def test_when_the_first_loading_went_between_two_displacements() -> None:
    test = evidence_of(Branch(0, 3, 1, UP, 0.0, 2.5))
    assert test.find_loading_period() == (0.0, 2.5)
    assert test.find_loading_period(0.5, 1.5) == (1.0, 2.0)
    assert test.find_loading_period(0.5, 9.0) == (1.0, 2.5)


@pytest.mark.parametrize(
    ("lost", "window", "is_doubted"),
    [
        (0.05, (1e-3, 9e-3), True),
        (0.05, (6e-3, 9e-3), False),
        (0.0, (1e-3, 9e-3), False),
        (-0.05, (1e-3, 9e-3), False),
    ],
)
def test_a_pause_in_which_the_force_falls(
    lost: float, window: tuple[float, float], is_doubted: bool
) -> None:
    """A motion of 1 mm/s that pauses for ten seconds at 5 mm."""
    time: Floats = np.arange(0.0, 20.0, 0.02)
    pause = np.clip(time - 5.0, 0.0, 10.0)
    path = 1e-3 * (time - pause)
    test = recorded(time, path, 1e3 * path - 0.1 * 5.0 * lost * pause)
    codes = [reason.code for reason in find_pause_doubts(test, window)]
    assert codes == ["pause_in_window"] * is_doubted
