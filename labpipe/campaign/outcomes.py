"""What became of a test, small enough to be handed on by the million."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeAlias

from labpipe.campaign.workers import CallRaised, ProcessDied, why
from labpipe.process.test_runner import Refused, Task, attempt, refuse
from labpipe.records.result import Status

State: TypeAlias = Literal["ok", "doubtful", "failed"]


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of one test.

    Parameters
    ----------
    sheet : as in its task
    folder : of its results; None where it is not known
    state : ``failed`` exactly when there are no new results; ``doubtful`` when a result is doubtful
        or failed
    code : of the failure, or of the first reason of the first result that is not ok; else empty
    reason : the same in words
    run : key of the results; of a test that failed as far as it could be computed, else empty
    seconds : that it took, by the clock
    """

    sheet: Path
    folder: Path | None
    state: State
    code: str = ""
    reason: str = ""
    run: str = ""
    seconds: float = 0.0


def outcome_of(task: Task) -> Outcome:
    """Process one test, whatever becomes of it.

    Parameters
    ----------
    task : the test
    """
    start = time.perf_counter()
    done = attempt(task)
    seconds = time.perf_counter() - start
    if isinstance(done, Refused):
        return given_up(done, seconds)
    doubted = next(
        (result for result in done.result.results if result.status is not Status.OK), None
    )
    if doubted is None:
        return Outcome(task.sheet, done.folder, "ok", run=done.result.run, seconds=seconds)
    first, run = doubted.reasons[0], done.result.run
    reason = f"{doubted.name}: {first.message}"
    return Outcome(task.sheet, done.folder, "doubtful", first.code, reason, run, seconds)


def settled(task: Task, ended: Outcome | ProcessDied | CallRaised) -> Outcome:
    """Make an outcome of what came from the process of a test.

    Parameters
    ----------
    task : the test
    ended : what came

    Raises
    ------
    Exception
        What cannot be: that the process could not hand over what it had.
    """
    if isinstance(ended, CallRaised):
        raise ended.error
    if isinstance(ended, ProcessDied):
        return given_up(refuse(task, *why(task.sheet, ended), is_read=False))
    return ended


def given_up(refused: Refused, seconds: float = 0.0) -> Outcome:
    """Make an outcome of a test that could not be processed.

    Parameters
    ----------
    refused : why
    seconds : that it took
    """
    return Outcome(
        refused.test, refused.folder, "failed", refused.code, refused.reason, refused.run, seconds
    )
