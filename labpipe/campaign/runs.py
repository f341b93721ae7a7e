"""Run tests or other calls in parallel processes, with results in order."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import TypeVar

from labpipe.campaign.workers import ProcessDied, describe_death, in_processes
from labpipe.errors import LabpipeError, ProcessingError
from labpipe.process.output_paths import refuse_repeated
from labpipe.process.run import Processed, name_of, results_folder_of
from labpipe.process.test_runner import Refused, Say, Task, attempt, refuse

T = TypeVar("T")


def process_tests(
    tests: Sequence[Path],
    *,
    out: Path | None = None,
    figures: Callable[[Path], bool] = lambda _: True,
    png: bool = False,
    follow_links: bool = False,
    jobs: int = 1,
    limit: float | None = None,
    begin: Callable[[Path], Say] = lambda _: _say_nothing,
) -> Iterator[Processed | Refused]:
    """Process tests in order; a faulty one does not stop the others.

    Parameters
    ----------
    tests : test.yaml or result.h5 files
    out, png, follow_links : see `labpipe.process.run.process_test`
    figures : whether figures of a test are drawn
    jobs : number of tests at the same time; each of several has its own process
    limit : s, time limit of each of several tests; None for no limit
    begin : called with each test at its start; returns a function that is called with each stage
        (of several tests, only with ``wait``)

    Yields
    ------
    Each test without recordings and stages, which are in its result.h5.

    Raises
    ------
    UsageError
        If two tests have the same folder of results; nothing is processed then.
    """
    goals = _goals(tests, out)
    folders = {test: goal for test, goal in goals.items() if isinstance(goal, Path)}
    refuse_repeated([(str(goal.absolute()), test) for test, goal in folders.items()], _GOAL)
    tasks = {
        test: Task(test, goal, figures(test), png=png, follow_links=follow_links)
        for test, goal in folders.items()
    }
    if len(tests) == 1:
        for test in tests:
            say = begin(test)
            if test in tasks:
                yield attempt(tasks[test], say, is_alone=True)
            else:
                yield _refused(test, goals[test])
        return
    calls = [partial(attempt, task) for task in tasks.values()]
    with closing(in_processes(calls, jobs=jobs, limit=limit)) as outcomes:
        for test in tests:
            begin(test)("wait")
            yield _next(tasks[test], outcomes) if test in tasks else _refused(test, goals[test])


_GOAL = "folder of results"


def _goals(tests: Sequence[Path], out: Path | None) -> dict[Path, Path | LabpipeError]:
    """Return the folder of the results of each test, or an error."""
    goals: dict[Path, Path | LabpipeError] = {}
    for test in tests:
        try:
            goals[test] = results_folder_of(test, out, partial(name_of, test))
        except LabpipeError as error:
            goals[test] = error
    return goals


def _next(task: Task, outcomes: Iterator[Processed | Refused | ProcessDied]) -> Processed | Refused:
    done = next(outcomes)
    if isinstance(done, ProcessDied):
        return refuse(task, *describe_death(task.sheet, done), is_read=False)
    return done


def _refused(test: Path, error: object) -> Refused:
    assert isinstance(error, LabpipeError)
    return Refused(test, error.code, str(error))


def run_jobs(calls: Sequence[Callable[[], T]], *, jobs: int) -> list[T]:
    """Call functions in parallel, each in its own process.

    Parameters
    ----------
    calls : partials of module-level functions with their arguments
    jobs : number of calls at the same time

    Returns
    -------
    Their results, in order.

    Raises
    ------
    ProcessingError
        If a process ended before its call.
    """
    if jobs == 1:
        return [call() for call in calls]
    results: list[T] = []
    for outcome in in_processes(calls, jobs=jobs):
        if isinstance(outcome, ProcessDied):
            code, reason = describe_death("labpipe", outcome)
            raise ProcessingError(reason, code=code)
        results.append(outcome)
    return results


def _say_nothing(_: str) -> None:
    pass
