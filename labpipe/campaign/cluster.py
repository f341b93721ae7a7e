"""Process tests on the workers of a dask.distributed cluster.

A test is one task of the cluster, and a worker processes it in a child process: a crash in C does
not end the worker. The scheduler moves the tests of a lost worker to others, as often as its
``allowed-failures`` permits. It drops outcomes once they are fetched, so that its memory does not
grow with the campaign.
"""

from __future__ import annotations

import json
import logging
import os
import time
from collections.abc import Generator, Iterable, Iterator
from contextlib import closing, contextmanager, suppress
from functools import partial
from itertools import chain, islice
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias, cast

from labpipe import __version__
from labpipe.campaign.executors import Outcome, process_task, record_failure
from labpipe.campaign.workers import ProcessDied, WorkerProcess
from labpipe.errors import LabpipeError, ProcessingError, UsageError
from labpipe.process.run import PROCESSING_VERSION, SUMMARY_FILE, Task

if TYPE_CHECKING:
    from distributed import Client, Future

Versions: TypeAlias = tuple[str, int]
VERSIONS: Versions = (__version__, PROCESSING_VERSION)
"""Version of labpipe, and processing version."""
_CONNECT_TIMEOUT = 10.0
"""s to wait for the scheduler, and for a first worker."""


def check_worker(sheet: Path) -> tuple[Versions, bool]:
    """Return the versions of a worker, and whether it sees a test sheet.

    Parameters
    ----------
    sheet : absolute path of the test sheet
    """
    return VERSIONS, sheet.exists()


def process_on_worker(
    task: Task, home: Path, limit: float | None, versions: Versions
) -> Outcome | None:
    """Process a test on a worker.

    Parameters
    ----------
    task : the test
    home : working folder of the client; relative paths start there
    limit : s, time limit; None for no limit
    versions : of the client

    Returns
    -------
    The outcome; None if the worker has other versions, or does not see the test sheet.

    Raises
    ------
    ProcessDied
        If the process of the test died.
    """
    if check_worker(home / task.sheet) != (versions, True):
        return None
    with _worker_process() as process:
        return process.call(partial(_process_at, home, task), limit=limit)


def _process_at(home: Path, task: Task) -> Outcome:
    """Process a test in the working folder of the client."""
    with suppress(OSError):  # it may be missing if all paths are absolute
        os.chdir(home)
    return process_task(task)


_IDLE_PROCESSES: list[WorkerProcess] = []
"""Processes of this worker that wait for a test, with all modules imported."""


@contextmanager
def _worker_process() -> Iterator[WorkerProcess]:
    """Lend a process for one test; kill it if the test is interrupted."""
    try:
        process = _IDLE_PROCESSES.pop()
    except IndexError:
        process = WorkerProcess()
    try:
        yield process
    except BaseException:
        process.close()
        raise
    _IDLE_PROCESSES.append(process)


def process_on_cluster(
    tasks: Iterable[Task], address: str, *, limit: float | None = None
) -> Generator[Outcome, None, None]:
    """Process tests on a cluster.

    Parameters
    ----------
    tasks : the next one is taken whenever a worker becomes free
    address : of the scheduler, ``HOST:PORT`` or ``tls://HOST:PORT``
    limit : s, time limit of a test; None for no limit

    Yields
    ------
    The outcomes, as tests are completed.

    Raises
    ------
    UsageError
        If `distributed` is not installed, there is no scheduler at the address, or no worker; or if
        a worker has another labpipe or does not see the first test.
    ProcessingError
        If the scheduler or all workers are lost during the run, or a worker cannot run labpipe.
    """
    remaining = iter(tasks)
    first = next(remaining, None)
    if first is None:
        return
    with _without_logging(), _connect(address) as client:
        try:
            if first.sheet.exists():
                _check_workers(client, first)
            with closing(_process_all(client, chain([first], remaining), limit)) as outcomes:
                yield from outcomes
        except LabpipeError:
            raise
        except Exception as error:  # whatever a client raises that has lost its scheduler
            raise ProcessingError.about(
                "campaign.lost_scheduler", "--executor", address=address
            ) from error


@contextmanager
def _connect(address: str) -> Iterator[Client]:
    try:
        from distributed import Client
    except ImportError as error:
        raise UsageError.about("campaign.no_distributed", "--executor") from error
    try:
        where = address if "://" in address else f"tcp://{address}"
        client = Client(where, timeout=_CONNECT_TIMEOUT, set_as_default=False)
    except (OSError, ValueError) as error:  # a TimeoutError is an OSError
        raise UsageError.about("campaign.no_scheduler", "--executor", address=address) from error
    try:
        with suppress(TimeoutError):
            client.wait_for_workers(1, timeout=_CONNECT_TIMEOUT)
        if not client.nthreads():
            raise UsageError.about("campaign.no_worker", "--executor", version=__version__)
        yield client
    finally:
        with suppress(Exception):  # already lost
            client.close(timeout=_CONNECT_TIMEOUT)  # cancels what is submitted


@contextmanager
def _without_logging() -> Iterator[None]:
    """Suppress the log messages of the library on lost connections: one error reports them."""
    before = logging.root.manager.disable
    logging.disable(logging.CRITICAL)
    try:
        yield
    finally:
        logging.disable(before)


def _check_workers(client: Client, task: Task) -> None:
    """Refuse workers with another labpipe, and workers that do not see a test."""
    answers = client.run(check_worker, Path.cwd() / task.sheet, on_error="return")
    for answer in answers.values():
        if isinstance(answer, Exception):
            raise _describe_fault(answer) from answer
        (version, _), is_visible = answer
        if answer[0] != VERSIONS:
            raise UsageError.about(
                "campaign.other_versions", "--executor", version=__version__, found=version
            )
        if not is_visible:
            error = UsageError.about("campaign.without_data", task.sheet)
            raise UsageError(str(error), code="no_cluster")


def _process_all(
    client: Client, tasks: Iterator[Task], limit: float | None
) -> Generator[Outcome, None, None]:
    """Yield outcomes until all tests are done."""
    from distributed import wait

    look_interval = 5.0  # s between looks at the workers
    max_looks_without_worker = 24
    looks_without_worker = 0
    submitted: dict[Future, Task] = {}
    while looks_without_worker < max_looks_without_worker:
        n_threads = sum(client.nthreads().values())
        if not n_threads:
            looks_without_worker += 1
            time.sleep(look_interval)
            continue
        looks_without_worker = 0
        for task in islice(tasks, max(0, 2 * n_threads - len(submitted))):
            future = client.submit(process_on_worker, task, Path.cwd(), limit, VERSIONS, pure=False)
            submitted[future] = task
        if not submitted:
            return
        done: Iterable[Future] = ()
        with suppress(TimeoutError), client.as_current():
            done = wait([*submitted], look_interval, "FIRST_COMPLETED").done
        for future in done:
            yield _collect(submitted.pop(future), future)
    raise TimeoutError


def _collect(task: Task, future: Future) -> Outcome:
    """Return the outcome of a completed test."""
    from distributed import KilledWorker

    visibility_timeout = 5.0  # s until new files are visible here; network drives are slow
    error = future.exception() if future.status == "error" else None
    if isinstance(error, ProcessDied):
        return record_failure(task, error.error(task.sheet))
    if isinstance(error, KilledWorker):
        times = error.allowed_failures + 1
        died = ProcessingError.about("campaign.worker_died", task.sheet, times=times)
        return record_failure(task, died)
    if error is not None:
        raise _describe_fault(error) from error
    outcome = cast("Outcome | None", future.result())
    if outcome is not None and _is_visible(outcome, time.monotonic() + visibility_timeout):
        return outcome
    if not task.sheet.exists():
        return process_task(task)
    return record_failure(task, UsageError.about("campaign.without_data", task.sheet))


def _describe_fault(error: BaseException) -> ProcessingError:
    """Describe the error of a worker that cannot run labpipe."""
    message = (str(error).splitlines() or [""])[0]
    return ProcessingError.about(
        "campaign.bad_cluster", "--executor", kind=type(error).__name__, message=message
    )


def _is_visible(outcome: Outcome, until: float) -> bool:
    """Return whether the results of a worker are visible here; wait for a slow drive."""
    if outcome.folder is None or outcome.state == "failed":
        return True
    key = json.dumps(outcome.run)
    while time.monotonic() < until:
        with suppress(OSError):
            if key in (outcome.folder / SUMMARY_FILE).read_text(encoding="utf-8"):
                return True
        time.sleep(0.1)
    return False
