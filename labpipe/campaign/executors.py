"""Executors process the tests of a campaign: on this machine, or on a cluster."""

from __future__ import annotations

import os
from collections.abc import Callable, Generator, Iterable, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal, TypeAlias

import psutil

from labpipe.campaign.workers import ProcessDied, run_as_completed
from labpipe.errors import LabpipeError, UsageError
from labpipe.process.output_paths import refuse_duplicates
from labpipe.process.run import (
    Processed,
    Refused,
    Task,
    attempt,
    find_results_folder,
    read_test_name,
    refuse,
)
from labpipe.records.result import Status

BYTES_PER_TEST = 750_000_000
"""Memory for the process of one test: a cantilever test of full size (70 MB of exports, figures as
SVG and PNG) takes 540 MB, a tensile test 175 MB, of which 85 MB are the libraries."""
_CONTROL_GROUP = Path("/sys/fs/cgroup")
"""Folder in which Linux states the memory limit of a container."""


def default_jobs() -> int:
    """Return the default number of parallel tests: the number of cores, less if memory is short.

    Returns
    -------
    At least 1.
    """
    free = int(psutil.virtual_memory().available)
    with suppress(OSError, ValueError):  # "max" means no limit
        limit = int((_CONTROL_GROUP / "memory.max").read_text("ascii"))
        free = min(free, limit - int((_CONTROL_GROUP / "memory.current").read_text("ascii")))
    return max(1, min(_count_cores(), free // BYTES_PER_TEST))


def _count_cores() -> int:
    """Count the cores available to this process."""
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
    code : of the failure, or of the first result that is not ok; else empty
    reason : its message
    run : key of the results, or of the failed attempt; empty if not known
    """

    sheet: Path
    folder: Path | None
    state: State
    code: str = ""
    reason: str = ""
    run: str = ""


def process_task(task: Task) -> Outcome:
    """Process one test.

    Parameters
    ----------
    task : the test

    Returns
    -------
    Its outcome, also if it fails.
    """
    done = attempt(task)
    if isinstance(done, Refused):
        return _make_failed_outcome(done)
    result = done.result
    bad = next((entry for entry in result.results if entry.status is not Status.OK), None)
    if bad is None:
        return Outcome(task.sheet, done.folder, "ok", run=result.run)
    code, reason = bad.reasons[0].code, f"{bad.name}: {bad.reasons[0].message}"
    return Outcome(task.sheet, done.folder, "doubtful", code, reason, result.run)


def await_outcome(task: Task, call: Callable[[], Outcome]) -> Outcome:
    """Wait for the outcome of a test that another process makes.

    Parameters
    ----------
    task : the test
    call : waits for the process and returns the outcome

    Returns
    -------
    The outcome; a failure if the process died.

    Raises
    ------
    Exception
        If the call raises any other error, which is a fault of labpipe.
    """
    try:
        return call()
    except ProcessDied as died:
        return record_failure(task, died.error(task.sheet))


def record_failure(task: Task, error: LabpipeError) -> Outcome:
    """Record why a test failed, without reading its exports, which may have killed a process.

    Parameters
    ----------
    task : the test
    error : the reason
    """
    return _make_failed_outcome(refuse(task, error.code, str(error), is_read=False))


def _make_failed_outcome(refused: Refused) -> Outcome:
    return Outcome(
        refused.test, refused.folder, "failed", refused.code, refused.reason, refused.run
    )


Executor: TypeAlias = Callable[[Iterable[Task]], Generator[Outcome, None, None]]
"""Takes a task whenever it can start one; yields outcomes in the order of completion."""


def local(jobs: int, *, limit: float | None = None) -> Executor:
    """Make an executor that processes tests on this machine, each isolated in its own process.

    Parameters
    ----------
    jobs : number of tests at the same time
    limit : s, time limit of a test; None for no limit
    """

    def executor(tasks: Iterable[Task]) -> Generator[Outcome, None, None]:
        with closing(run_as_completed(process_task, tasks, jobs=jobs, limit=limit)) as completed:
            for task, future in completed:
                yield await_outcome(task, future.result)

    return executor


_CLUSTERS = {"dask": "", "dask+tls": "tls://"}
"""Prefix of the address of a scheduler, by scheme."""


def parse_executor(text: str, *, jobs: int | None = None, limit: float | None = None) -> Executor:
    """Make the executor named on the command line.

    Parameters
    ----------
    text : ``local``, ``dask://HOST:PORT`` or ``dask+tls://HOST:PORT``
    jobs : number of tests at the same time on this machine; None for `default_jobs`
    limit : s, time limit of a test; None for no limit

    Raises
    ------
    UsageError
        If the text is none of these.
    """
    if text == "local":
        return local(jobs or default_jobs(), limit=limit)
    scheme, _, address = text.partition("://")
    host, _, port = address.rpartition(":")
    if scheme not in _CLUSTERS or not host or not port.isdecimal():
        raise UsageError.about("campaign.bad_executor", "--executor", text=text)
    from labpipe.campaign.cluster import process_on_cluster  # imports this module

    return partial(process_on_cluster, address=f"{_CLUSTERS[scheme]}{address}", limit=limit)


def process_tests(
    tests: Sequence[Path],
    *,
    out: Path | None = None,
    figures: Callable[[Path], bool] = lambda _: True,
    png: bool = False,
    follow_links: bool = False,
    jobs: int = 1,
    limit: float | None = None,
    on_outcome: Callable[[Path], None] = lambda _: None,
) -> list[Processed | Refused]:
    """Process tests; a faulty one does not stop the others.

    Parameters
    ----------
    tests : test.yaml or result.h5 files
    out, png, follow_links : see `labpipe.process.run.Task`; `out` gets a folder per test
    figures : whether figures of a test are drawn
    jobs : number of tests at the same time; each of several has its own process
    limit : s, time limit of each of several tests; None for no limit
    on_outcome : called with each test at its end

    Returns
    -------
    The tests in order, without recordings and stages, which are in their result.h5.

    Raises
    ------
    UsageError
        If two tests have the same folder of results; nothing is processed then.
    """
    outcomes: dict[Path, Processed | Refused] = {}
    tasks: list[Task] = []
    for test in tests:
        try:
            results_folder = find_results_folder(test, out, partial(read_test_name, test))
            tasks.append(
                Task(test, results_folder, figures(test), png=png, follow_links=follow_links)
            )
        except LabpipeError as error:
            outcomes[test] = Refused(test, error.code, str(error))
    goals = [
        (str(task.results_folder and task.results_folder.absolute()), task.sheet) for task in tasks
    ]
    refuse_duplicates(goals, "folder of results")
    if len(tests) == 1:
        return [
            *outcomes.values(),
            *(attempt(task, is_alone=True) for task in tasks),
        ]
    with closing(run_as_completed(attempt, tasks, jobs=jobs, limit=limit)) as completed:
        for task, future in completed:
            on_outcome(task.sheet)
            try:
                outcomes[task.sheet] = future.result()
            except ProcessDied as died:
                reason = died.error(task.sheet)
                outcomes[task.sheet] = refuse(task, reason.code, str(reason), is_read=False)
    return [outcomes[test] for test in tests]
