"""What a test knows of itself: its branches, and which numbers an event touches."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.fits.failure_point import FailurePoint
from labpipe.records.curve import Branch, ClockFit, Curve, Direction, Interval
from labpipe.records.quality import Findings, Reason, doubtful
from labpipe.records.signals import Clocks, Signal, Signals
from labpipe.results.evidence import Evidence
from labpipe.uncertainty.intervals import Measured

UP, DOWN = Direction.LOADING, Direction.UNLOADING
APART = Clocks("markers")
"""Not joined."""
FROZEN = (Reason("frozen", "stands"),)


def located(clocks: Clocks = APART) -> Evidence:
    """A force in doubt from 40 s to 42 s of its own clock."""
    time = np.arange(0.0, 100.0)
    signals = Signals()
    for name, clock in (("force", "force"), ("displacement", "markers")):
        signals = signals.with_new(name, Signal(time, time, "N", clock))
    found = doubtful("frozen", "force", "stands", "force", during=(40.0, 42.0), clock="force")
    return Evidence(signals, clocks, findings=Findings((found,)))


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
    test = Evidence(Signals(), curve=curve())
    assert test.cycles == [list(BRANCHES[:2]), [BRANCHES[2]]]
    assert test.first_loading is BRANCHES[0]
    assert test.loading_stretch == slice(0, 2)


def test_the_first_loading_ends_with_the_sample_of_the_failure() -> None:
    def until(sample: int) -> slice:
        failure = FailurePoint(sample)
        return Evidence(Signals(), curve=curve(), failure=failure).loading_stretch

    assert until(0) == slice(0, 1)
    assert until(1) == slice(0, 2)
    assert until(2) == slice(0, 2), "it failed later"


def test_without_a_curve() -> None:
    test = Evidence(Signals())
    assert test.cycles == []
    assert test.first_loading is None
    assert test.loading_stretch == slice(0, 0)
    assert test.while_loading() is None
    with pytest.raises(ValueError, match="before there is a curve"):
        _ = test.known_curve


def test_a_record_that_begins_with_an_unloading() -> None:
    assert Evidence(Signals(), curve=curve(BRANCHES[1:2])).first_loading is None


def test_when_the_first_loading_went_between_two_displacements() -> None:
    test = Evidence(Signals(), curve=curve((Branch(0, 3, 1, UP, 0.0, 2.5),)))
    assert test.while_loading() == (0.0, 2.5)
    assert test.while_loading(0.5, 1.5) == (1.0, 2.0)
    assert test.while_loading(0.5, 9.0) == (1.0, 2.5)


def test_error_of_the_slack() -> None:
    assert Evidence(Signals()).slack_error == 0.0
    assert (
        Evidence(Signals(), slack=Measured(1e-3, np.array([-2e-5, 2e-5]), (), 50)).slack_error
        == 2e-5
    )
