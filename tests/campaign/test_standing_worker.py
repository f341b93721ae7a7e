"""One process that stays, with a real process."""

from __future__ import annotations

import os
from collections.abc import Iterator
from functools import partial

import pytest

from labpipe.campaign.executors import Outcome, Task
from labpipe.campaign.standing_worker import StandingWorker
from labpipe.errors import ProcessingError, UsageError
from labpipe.process.run import process_test
from tests.builders.small_tests import Lab


@pytest.fixture(scope="module")
def worker() -> Iterator[StandingWorker]:
    made = StandingWorker()
    made.warm()
    yield made
    made.leave()


def refuse() -> None:
    message = "no"
    raise UsageError(message)


@pytest.mark.slow
def test_calls_are_done_in_one_process_that_stays(worker: StandingWorker) -> None:
    first, second = (worker.call(os.getpid, about="x") for _ in range(2))
    assert first == second != os.getpid()
    with pytest.raises(UsageError, match="no"):
        worker.call(refuse, about="x")
    assert worker.call(os.getpid, about="x") == first


def test_a_process_that_dies_costs_one_call(worker: StandingWorker) -> None:
    with pytest.raises(ProcessingError, match=r"x: .* ended with exit code 3"):
        worker.call(partial(os._exit, 3), about="x")
    assert worker.call(os.getpid, about="x") != os.getpid()


@pytest.mark.slow
def test_numbers_first_and_figures_behind(worker: StandingWorker, lab: Lab) -> None:
    (outcome,) = worker.executor([Task(lab.sheet, lab.processed)])
    assert outcome.folder == lab.processed
    assert not (lab.processed / "figures").exists()
    before = lab.result.read_bytes()

    worker.draw(lab.processed)
    worker.call(os.getpid, about="x")  # waits for them

    drawn = {path.name: path.read_bytes() for path in (lab.processed / "figures").iterdir()}
    assert lab.result.read_bytes() == before
    usual = process_test(lab.sheet, out=lab.home / "out")
    assert drawn == {path.name: path.read_bytes() for path in usual.figures}


def test_a_process_that_dies_in_a_test_is_an_outcome(
    worker: StandingWorker, lab: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("labpipe.campaign.standing_worker.outcome_of", die)
    (outcome,) = worker.executor([Task(lab.sheet, lab.processed)])
    assert (outcome.state, outcome.code) == ("failed", "process_died")


def die(_: Task) -> Outcome:
    os._exit(3)
