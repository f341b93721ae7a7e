"""Process tests on the workers of a dask.distributed cluster.

A test is one task of the cluster, and has a process of its own there: a crash in C does not end the
worker, which stays connected to its scheduler. The scheduler moves tests of lost workers to others,
as often as its ``allowed-failures`` permits, and drops outcomes once they are fetched, so that its
memory does not grow with the campaign.
"""

from __future__ import annotations

import json
import logging
import os
import threading
import time
from collections import deque
from collections.abc import Generator, Iterable, Iterator, Mapping
from contextlib import closing, contextmanager, suppress
from functools import partial
from itertools import chain, islice
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, TypeAlias, cast

from labpipe import __version__
from labpipe.campaign.executors import (
    Outcome,
    process_task,
    record_failure,
)
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


def process_on_worker(
    task: Task, home: Path, limit: float | None, wanted: Versions
) -> tuple[str, Outcome | Versions | None]:
    """Process a test on a worker.

    Parameters
    ----------
    task : the test
    home : working folder of the client; relative paths start there
    limit : s, time limit; None for no limit
    wanted : versions of the client

    Returns
    -------
    worker : its address
    answer : outcome of the test; versions of the worker if they are others; None if the files of
        the test are not visible to it

    Raises
    ------
    ProcessDied
        If the process of the test died.
    """
    from distributed import get_worker

    worker = str(get_worker().address)
    if wanted != VERSIONS:
        return worker, VERSIONS
    if not (home / task.sheet).exists():
        return worker, None
    with _worker_process() as process:
        return worker, process.call(partial(_outcome_at, home, task), limit=limit)


def _outcome_at(home: Path, task: Task) -> Outcome:
    """Process a test in the working folder of the client."""
    with suppress(OSError):  # missing only if all paths are absolute
        os.chdir(home)
    return process_task(task)


_IDLE_PROCESSES: dict[WorkerProcess, threading.Timer] = {}
"""Processes that are kept for the next test for a while, until a timer closes them."""


@contextmanager
def _worker_process() -> Iterator[WorkerProcess]:
    idle_limit = 60.0  # s without a test, after which a process is closed
    try:
        process, timer = _IDLE_PROCESSES.popitem()
        timer.cancel()
    except KeyError:
        process = WorkerProcess()
    try:
        yield process
    except BaseException:
        process.close()
        raise
    timer = threading.Timer(idle_limit, _close_idle, (process,))
    timer.daemon = True
    _IDLE_PROCESSES[process] = timer
    timer.start()


def _close_idle(process: WorkerProcess) -> None:
    if _IDLE_PROCESSES.pop(process, None) is not None:
        process.close()


def process_on_cluster(
    tasks: Iterable[Task], address: str, *, limit: float | None = None
) -> Generator[Outcome, None, None]:
    """Process tests on a cluster.

    Parameters
    ----------
    tasks : taken when workers become free
    address : of the scheduler, ``HOST:PORT`` or ``tls://HOST:PORT``
    limit : s, time limit of a test; None for no limit

    Yields
    ------
    The outcomes, as tests are completed.

    Raises
    ------
    UsageError
        If `distributed` is not installed, there is no scheduler at the address, or no worker with
        this labpipe.
    ProcessingError
        If the scheduler or all workers are lost during the run; started tests continue.
    """
    remaining = iter(tasks)
    first = list(islice(remaining, 1))
    if not first:
        return
    with _without_logging(), _connect(address) as client:
        try:
            run = _ClusterRun(client, chain(first, remaining), limit)
            with closing(run.outcomes()) as outcomes:
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


class _Submission(NamedTuple):
    """A test to submit or submitted.

    Parameters
    ----------
    task : the test
    unseen_by : workers that do not see its files
    workers : allowed ones; any if empty
    orphaned : how often all allowed workers were lost
    """

    task: Task
    unseen_by: frozenset[str] = frozenset()
    workers: frozenset[str] = frozenset()
    orphaned: int = 0


class _ClusterRun:
    """Submits tests, collects outcomes, and resubmits tests that other workers must process."""

    def __init__(self, client: Client, tasks: Iterator[Task], limit: float | None) -> None:
        self._client, self._limit, self._home = client, limit, Path.cwd()
        self._new = map(_Submission, tasks)
        self._again: deque[_Submission] = deque()
        self._submitted: dict[Future, _Submission] = {}
        self._unfit: dict[str, Versions] = {}
        self._was_seen = False

    def outcomes(self) -> Generator[Outcome, None, None]:
        """Yield outcomes until all tests are done."""
        from distributed import wait

        # s between looks at the workers; without any for a while, a run ends
        look_interval, max_looks_without_worker = 5.0, 24
        looks_without_worker = 0
        while looks_without_worker < max_looks_without_worker:
            threads = self._client.nthreads()
            looks_without_worker = 0 if threads else looks_without_worker + 1
            self._resubmit_orphans(threads.keys())
            yield from self._submit_tests(threads)
            done: Iterable[Future] = ()
            if not threads:
                time.sleep(look_interval)
            elif not self._submitted:
                return
            else:
                with suppress(TimeoutError), self._client.as_current():
                    done = wait([*self._submitted], look_interval, "FIRST_COMPLETED").done
            for future in done:
                outcome = self._collect(self._submitted.pop(future), future)
                if outcome is not None:
                    yield outcome
        raise TimeoutError

    def _submit_tests(self, threads: Mapping[str, int]) -> Iterator[Outcome]:
        """Keep twice as many tests submitted as workers have threads; yield refused tests."""
        max_orphaned = 3
        while len(self._submitted) < 2 * sum(threads.values()):
            test = self._again.popleft() if self._again else next(self._new, None)
            if test is None:
                return
            if test.orphaned > max_orphaned:
                yield _refuse_killer(test.task, test.orphaned)
                continue
            able = frozenset(threads.keys() - self._unfit.keys() - test.unseen_by)
            if not able:
                yield self._refuse_unseen(test.task, len(threads))
                continue
            workers = able if len(able) < len(threads) else frozenset[str]()
            future = self._client.submit(
                process_on_worker, test.task, self._home, self._limit, VERSIONS, pure=False,
                workers=sorted(workers) or None,
            )  # fmt: skip
            self._submitted[future] = test._replace(workers=workers)

    def _collect(self, test: _Submission, future: Future) -> Outcome | None:
        """Return the outcome of a test, or resubmit it."""
        from distributed import KilledWorker

        visibility_timeout = 5.0  # s until new files are visible here; network drives are slow
        task = test.task
        try:
            worker, answer = _answer_of(future)
        except ProcessDied as died:
            return record_failure(task, died.error(task.sheet))
        except KilledWorker as killed:
            return _refuse_killer(task, killed.allowed_failures + 1)
        if isinstance(answer, Outcome):
            if _is_seen(answer, time.monotonic() + visibility_timeout):
                self._was_seen = True
                return answer
        elif answer is not None:
            self._unfit[worker] = answer
        elif not task.sheet.exists():
            return process_task(task)
        self._again.append(test._replace(unseen_by=test.unseen_by | {worker}))
        return None

    def _refuse_unseen(self, task: Task, count: int) -> Outcome:
        """Refuse a test whose files no worker sees; raise if no worker has seen any file yet."""
        if self._unfit and not self._was_seen:
            raise UsageError.about(
                "campaign.other_versions", "--executor", version=__version__,
                found=", ".join(sorted({version for version, _ in self._unfit.values()})),
            )  # fmt: skip
        error = UsageError.about("campaign.without_data", task.sheet, count=count)
        if not self._was_seen:
            raise UsageError(str(error), code="no_cluster")
        return record_failure(task, error)

    def _resubmit_orphans(self, workers: Iterable[str]) -> None:
        """Resubmit tests that wait for lost workers."""
        for future, test in [*self._submitted.items()]:
            if test.workers and test.workers.isdisjoint(workers):
                del self._submitted[future]
                self._client.cancel([future])
                self._again.append(test._replace(orphaned=test.orphaned + 1))


def _answer_of(future: Future) -> tuple[str, Outcome | Versions | None]:
    """Return the answer of `process_on_worker`; raise one error if a worker cannot run that."""
    from distributed import KilledWorker

    error = future.exception() if future.status == "error" else None
    if error is not None and not isinstance(error, (ProcessDied, KilledWorker)):
        message = (str(error).splitlines() or [""])[0]
        raise ProcessingError.about(
            "campaign.bad_cluster", "--executor", kind=type(error).__name__, message=message
        ) from error
    return cast("tuple[str, Outcome | Versions | None]", future.result())


def _refuse_killer(task: Task, times: int) -> Outcome:
    """Refuse a test that lost its workers."""
    error = ProcessingError.about("campaign.worker_died", task.sheet, times=times)
    return record_failure(task, error)


def _is_seen(outcome: Outcome, until: float) -> bool:
    """Return whether the results of a worker are visible here; waits for a slow drive."""
    if outcome.folder is None or outcome.state == "failed":
        return True
    wanted = json.dumps(outcome.run)
    while time.monotonic() < until:
        with suppress(OSError):
            if wanted in (outcome.folder / SUMMARY_FILE).read_text(encoding="utf-8"):
                return True
        time.sleep(0.1)
    return False
