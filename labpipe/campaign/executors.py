"""Where the tests of a campaign are processed, and what became of each."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeAlias

from labpipe.campaign.runs import Refused, ended, process_safely
from labpipe.campaign.workers import Died, Raised, as_they_end
from labpipe.records.result import Result, Status, TestResult

State: TypeAlias = Literal["ok", "doubtful", "failed"]


@dataclass(frozen=True, slots=True)
class Task:
    """One test to be processed.

    Parameters
    ----------
    sheet : its test.yaml, or a result.h5 whose raw group is processed again
    goal : folder of its results; None where `labpipe process` puts them
    figures : whether to draw, as SVG
    png : whether figures are drawn as PNG, too
    follow_links : whether exports may be links out of the folder of the test
    """

    sheet: Path
    goal: Path | None = None
    figures: bool = True
    png: bool = False
    follow_links: bool = False


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of one test; small, so that a million of them can be handed on.

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


Executor: TypeAlias = Callable[[Iterable[Task]], Iterator[Outcome]]
"""Takes tasks one by one as it can begin them; gives outcomes in the order in which they end."""


def local(jobs: int) -> Executor:
    """Process tests on this machine, each in a process that it cannot take others down with.

    Parameters
    ----------
    jobs : how many at a time

    Returns
    -------
    The executor.
    """

    def executor(tasks: Iterable[Task]) -> Iterator[Outcome]:
        with closing(as_they_end(attempt, tasks, jobs=jobs)) as outcomes:
            for task, outcome in outcomes:
                if isinstance(outcome, Raised):
                    raise outcome.error
                yield _died(task, outcome) if isinstance(outcome, Died) else outcome

    return executor


def attempt(task: Task) -> Outcome:
    """Process one test, whatever becomes of it.

    Parameters
    ----------
    task : the test

    Returns
    -------
    The outcome; a test that could not be processed is one, too.
    """
    start = time.perf_counter()
    done = process_safely(
        task.sheet,
        task.figures,
        goal=task.goal,
        png=task.png,
        follow_links=task.follow_links,
    )
    seconds = time.perf_counter() - start
    if isinstance(done, Refused):
        return Outcome(task.sheet, task.goal, "failed", done.code, done.reason, "", seconds)
    state, code, reason = verdict_of(done.result)
    return Outcome(task.sheet, done.folder, state, code, reason, done.result.run, seconds)


def verdict_of(result: TestResult) -> tuple[State, str, str]:
    """Sum up the results of a test in one state.

    Parameters
    ----------
    result : the test

    Returns
    -------
    state, code, reason : as in `Outcome`.
    """
    doubted = next((each for each in result.results if each.status is not Status.OK), None)
    return ("ok", "", "") if doubted is None else ("doubtful", *_first_reason(doubted))


def _first_reason(result: Result) -> tuple[str, str]:
    first = result.reasons[0]
    return first.code, f"{result.name}: {first.message}"


def _died(task: Task, died: Died) -> Outcome:
    return Outcome(task.sheet, task.goal, "failed", "process_died", ended(task.sheet, died))
