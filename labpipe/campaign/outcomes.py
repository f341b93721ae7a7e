"""Outcomes of tests, small enough to pass between processes by the million."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeAlias

from labpipe.campaign.workers import CallRaised, ProcessDied, describe_death
from labpipe.process.test_runner import Refused, Task, attempt, refuse
from labpipe.records.result import Status

State: TypeAlias = Literal["ok", "doubtful", "failed"]


@dataclass(frozen=True, slots=True)
class Outcome:
    """Outcome of a test.

    Parameters
    ----------
    sheet : as in its task
    folder : of its results; None if not known
    state : ``failed`` without new results; ``doubtful`` if a result is doubtful or failed
    code : of the failure, or the first reason of the first result that is not ok; else empty
    reason : its message
    run : key of the results, or of the failed attempt; empty if not known
    seconds : duration
    """

    sheet: Path
    folder: Path | None
    state: State
    code: str = ""
    reason: str = ""
    run: str = ""
    seconds: float = 0.0


def outcome_of(task: Task) -> Outcome:
    """Process one test and return its outcome, also if it fails.

    Parameters
    ----------
    task : the test
    """
    start = time.perf_counter()
    done = attempt(task)
    seconds = time.perf_counter() - start
    if isinstance(done, Refused):
        return failed_outcome(done, seconds)
    doubted = next(
        (result for result in done.result.results if result.status is not Status.OK), None
    )
    if doubted is None:
        return Outcome(task.sheet, done.folder, "ok", run=done.result.run, seconds=seconds)
    first, run = doubted.reasons[0], done.result.run
    reason = f"{doubted.name}: {first.message}"
    return Outcome(task.sheet, done.folder, "doubtful", first.code, reason, run, seconds)


def outcome_of_call(task: Task, ended: Outcome | ProcessDied | CallRaised) -> Outcome:
    """Make the outcome of a test from the result of its process.

    Parameters
    ----------
    task : the test
    ended : result of the process

    Raises
    ------
    Exception
        If the call itself raised, which is a fault of labpipe.
    """
    if isinstance(ended, CallRaised):
        raise ended.error
    if isinstance(ended, ProcessDied):
        return failed_outcome(refuse(task, *describe_death(task.sheet, ended), is_read=False))
    return ended


def failed_outcome(refused: Refused, seconds: float = 0.0) -> Outcome:
    """Make the outcome of a test that was refused.

    Parameters
    ----------
    refused : test and reason
    seconds : duration
    """
    return Outcome(
        refused.test, refused.folder, "failed", refused.code, refused.reason, refused.run, seconds
    )
