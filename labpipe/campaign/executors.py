"""Process tests: in order, or by an executor, on this machine or on a cluster."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal, TypeAlias

import psutil

from labpipe.campaign.workers import ProcessDied, as_completed, in_processes
from labpipe.errors import LabpipeError, UsageError
from labpipe.process.output_paths import refuse_duplicates
from labpipe.process.run import (
    Processed,
    Refused,
    Say,
    Task,
    attempt,
    find_results_folder,
    name_of,
    refuse,
)
from labpipe.records.result import Status

__all__ = ["Executor", "Outcome", "Task", "dask", "executor_of", "local", "process_tests"]

BYTES_PER_TEST = 750_000_000
"""Memory for the process of one test: a cantilever test of full size (70 MB of exports, figures as
SVG and PNG) takes 540 MB, a tensile test 175 MB, of which 85 MB are the libraries."""
_CONTAINER = Path("/sys/fs/cgroup")


def default_jobs() -> int:
    """Return the default number of parallel tests: the cores, fewer if memory is short.

    Returns
    -------
    At least 1.
    """
    free = int(psutil.virtual_memory().available)
    with suppress(OSError, ValueError):  # "max" means no limit
        limit = int((_CONTAINER / "memory.max").read_text("ascii"))
        free = min(free, limit - int((_CONTAINER / "memory.current").read_text("ascii")))
    return max(1, min(_cores(), free // BYTES_PER_TEST))


def _cores() -> int:
    """Return the number of cores available to this process."""
    with suppress(AttributeError):  # neither on Windows nor on macOS
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


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


def outcome_of_call(task: Task, call: Callable[[], Outcome]) -> Outcome:
    """Make the outcome of a test from a call in a process.

    Parameters
    ----------
    task : the test
    call : returns its outcome

    Raises
    ------
    Exception
        If the call raises it, which is a fault of labpipe; the death of its process is an outcome.
    """
    try:
        return call()
    except ProcessDied as died:
        return refused_outcome(task, died.error(task.sheet))


def refused_outcome(task: Task, error: LabpipeError) -> Outcome:
    """Record why a test failed, without reading its exports, which may have killed a process.

    Parameters
    ----------
    task : the test
    error : the reason
    """
    return failed_outcome(refuse(task, error.code, str(error), is_read=False))


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


Executor: TypeAlias = Callable[[Iterable[Task]], Generator[Outcome, None, None]]
"""Takes tasks as it can start them; yields outcomes in the order of completion."""


def local(jobs: int, *, limit: float | None = None) -> Executor:
    """Process tests on this machine, each isolated in its own process.

    Parameters
    ----------
    jobs : number of tests at the same time
    limit : s, time limit of a test; None for no limit

    Returns
    -------
    The executor.
    """

    def executor(tasks: Iterable[Task]) -> Generator[Outcome, None, None]:
        with closing(as_completed(outcome_of, tasks, jobs=jobs, limit=limit)) as ended:
            for task, future in ended:
                yield outcome_of_call(task, future.result)

    return executor


def dask(address: str, *, limit: float | None = None) -> Executor:
    """Process tests on the workers of a dask.distributed cluster.

    Parameters
    ----------
    address : of its scheduler, ``HOST:PORT``, or ``tls://HOST:PORT`` with the certificates of the
        dask configuration
    limit : s, time limit of a test; None for no limit

    Returns
    -------
    The executor. It connects on the first task, and raises `UsageError` if there is no scheduler
    or no worker with this labpipe, `ProcessingError` if the scheduler is lost during the run.
    """

    def executor(tasks: Iterable[Task]) -> Generator[Outcome, None, None]:
        from labpipe.campaign.cluster import process_on_cluster  # distributed is an extra

        yield from process_on_cluster(tasks, address, limit=limit)

    return executor


_CLUSTERS = {"dask": "", "dask+tls": "tls://"}
"""Prefix of the address of a scheduler, by scheme."""


def executor_of(text: str, *, jobs: int | None = None, limit: float | None = None) -> Executor:
    """Return the executor named on the command line.

    Parameters
    ----------
    text : ``local``, ``dask://HOST:PORT`` or ``dask+tls://HOST:PORT``
    jobs : number of tests at the same time on this machine; None for `default_jobs`
    limit : s, time limit of a test; None for no limit

    Raises
    ------
    UsageError
        If the text is neither.
    """
    if text == "local":
        return local(jobs or default_jobs(), limit=limit)
    scheme, _, address = text.partition("://")
    host, _, port = address.rpartition(":")
    if scheme in _CLUSTERS and host and port.isdecimal():
        return dask(f"{_CLUSTERS[scheme]}{address}", limit=limit)
    raise UsageError.about("campaign.bad_executor", "--executor", text=text)


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
    tasks: dict[Path, Task | Refused] = {}
    for test in tests:
        try:
            goal = find_results_folder(test, out, partial(name_of, test))
            tasks[test] = Task(test, goal, figures(test), png=png, follow_links=follow_links)
        except LabpipeError as error:
            tasks[test] = Refused(test, error.code, str(error))
    possible = [task for task in tasks.values() if isinstance(task, Task)]
    goals = [(str(task.goal and task.goal.absolute()), task.sheet) for task in possible]
    refuse_duplicates(goals, "folder of results")
    if len(tests) == 1:
        for test, task in tasks.items():
            say = begin(test)
            yield task if isinstance(task, Refused) else attempt(task, say, is_alone=True)
        return
    calls = [partial(attempt, task) for task in possible]
    with closing(in_processes(calls, jobs=jobs, limit=limit)) as futures:
        for test in tests:
            begin(test)("wait")
            task = tasks[test]
            if isinstance(task, Refused):
                yield task
                continue
            try:
                yield next(futures).result()
            except ProcessDied as died:
                reason = died.error(test)
                yield refuse(task, reason.code, str(reason), is_read=False)


def _say_nothing(_: str) -> None:
    pass
