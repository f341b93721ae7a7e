"""Process tests on the workers of a dask.distributed cluster.

A test is one task of the cluster, and has a process of its own there: a crash in C does not end the
worker, which stays connected to its scheduler. The scheduler moves tests of lost workers to others,
and drops outcomes once they are fetched, so that its memory does not grow with the campaign.
"""

from __future__ import annotations

import json
import logging
import os
import queue
import threading
import time
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, suppress
from functools import partial
from itertools import chain, count, islice
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, TypeAlias
from uuid import uuid4

from labpipe import __version__
from labpipe.campaign.executors import Outcome, failed_outcome, outcome_of, outcome_of_call
from labpipe.campaign.workers import CallRaised, ProcessDied, WorkerProcess
from labpipe.errors import ProcessingError, UsageError, error_text
from labpipe.process.run import PROCESSING_VERSION, SUMMARY_FILE, Task, refuse

if TYPE_CHECKING:
    from distributed import Client, Future

Versions: TypeAlias = tuple[str, int]
"""Version of labpipe, and processing version."""
_METADATA = "labpipe"
"""Key of the scheduler metadata that counts unfinished starts of tests."""
_CONNECT_TIMEOUT = 10.0
"""s to wait for the scheduler, and for a first worker."""
_UPDATE_INTERVAL = 5.0
"""s between updates of the list of workers."""


def versions() -> Versions:
    """Return the versions of a worker."""
    return __version__, PROCESSING_VERSION


class Answer(NamedTuple):
    """Answer of a worker.

    Parameters
    ----------
    worker : its address
    ended : outcome of the test; None if it was not started, because its files are not visible to
        the worker, or because it lost workers before
    lost_workers : number of workers that were lost with the test
    """

    worker: str
    ended: Outcome | ProcessDied | CallRaised | None
    lost_workers: int = 0


def process_on_worker(run: str, task: Task, home: Path, limit: float | None) -> Answer:
    """Process a test on a worker.

    Parameters
    ----------
    run : identifies the run
    task : the test
    home : working folder of the client; relative paths start there
    limit : s, time limit; None for no limit
    """
    max_lost_workers = 2  # workers that a test may lose before it is refused
    from distributed import get_client, get_worker

    worker = str(get_worker().address)
    if not (home / task.sheet).exists():
        return Answer(worker, None)
    client, counter = get_client(), [_METADATA, run, str(task.sheet)]
    lost_workers = int(client.get_metadata(counter, 0))
    if lost_workers >= max_lost_workers:
        return Answer(worker, None, lost_workers)
    client.set_metadata(counter, lost_workers + 1)
    with _worker_process() as process:
        ended = process.call(partial(_outcome_at, home, task), limit=limit)
    # If the worker is lost before its result is fetched, the test is repeated without a penalty.
    client.set_metadata(counter, 0)
    return Answer(worker, ended)


def _outcome_at(home: Path, task: Task) -> Outcome:
    """Process a test in the working folder of the client."""
    with suppress(OSError):  # missing only if all paths are absolute
        os.chdir(home)
    return outcome_of(task)


_IDLE_PROCESSES: dict[WorkerProcess, threading.Timer] = {}
"""Processes that are kept for the next test for a while, until a timer closes them."""


@contextmanager
def _worker_process() -> Iterator[WorkerProcess]:
    # s without a test, after which a process is closed
    idle_limit = 60.0
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
        scheduler = _ClusterRun(client, chain(first, remaining), address, limit)
        try:
            yield from scheduler.outcomes()
        finally:
            scheduler.close()


@contextmanager
def _connect(address: str) -> Iterator[Client]:
    try:
        from distributed import Client
    except ImportError as error:
        raise _cluster_error(
            _NO_PACKAGE, "none", "Install labpipe with it: labpipe[dask]."
        ) from error
    try:
        where = address if "://" in address else f"tcp://{address}"
        client = Client(where, timeout=_CONNECT_TIMEOUT, set_as_default=False)
    except (OSError, ValueError) as error:  # a TimeoutError is an OSError
        expected = f"a dask scheduler at {address}"
        remedy = "Start one with `dask scheduler`; check the address and firewalls."
        raise _cluster_error(expected, "no answer", remedy) from error
    try:
        yield client
    finally:
        with suppress(Exception):  # already lost
            client.close(timeout=_CONNECT_TIMEOUT)


_NO_PACKAGE = "the package distributed"


def _cluster_error(expected: str, state: str, remedy: str) -> UsageError:
    message = error_text("--executor", "", expected=expected, found=state, remedy=remedy)
    return UsageError(message, code="no_cluster")


@contextmanager
def _without_logging() -> Iterator[None]:
    """Suppress the log messages of the library on lost connections: one error reports them."""
    before = logging.root.manager.disable
    logging.disable(logging.CRITICAL)
    try:
        yield
    finally:
        logging.disable(before)


class _Waiting(NamedTuple):
    """A test to submit, and the workers that do not see its files."""

    task: Task
    unseen_by: frozenset[str] = frozenset()


class _Submitted(NamedTuple):
    """A test on the cluster.

    Parameters
    ----------
    test : with its history
    future : of the cluster
    workers : allowed ones, which have this labpipe and see its files
    """

    test: _Waiting
    future: Future
    workers: frozenset[str]


class _ClusterRun:
    """Submits tests, collects outcomes, and resubmits tests that others must process."""

    def __init__(
        self, client: Client, tasks: Iterator[Task], address: str, limit: float | None
    ) -> None:
        self._client, self._tasks, self._address, self._limit = client, tasks, address, limit
        self._home, self._run = Path.cwd(), uuid4().hex
        self._numbers = count()
        self._ended: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._submitted: dict[str, _Submitted] = {}
        self._resubmitted: deque[_Waiting] = deque()
        self._workers = _ClusterWorkers(client, self._lost_scheduler)
        self._was_seen = self._is_lost = False

    def outcomes(self) -> Generator[Outcome, None, None]:
        """Yield outcomes until all tests are done."""
        self._workers.wait_for_workers()
        while True:
            yield from self._submit_tests()
            if self._workers.fit and not self._submitted:
                return
            with suppress(queue.Empty):
                ended = self._submitted.pop(self._ended.get(timeout=_UPDATE_INTERVAL), None)
                outcome = None if ended is None else self._collect(ended)
                if outcome is not None:
                    yield outcome
            if self._workers.refresh_workers():
                self._resubmit_orphans()

    def close(self) -> None:
        """Cancel tests that are not started, and delete their counters."""
        if self._is_lost:
            return
        with suppress(Exception):  # the scheduler may be lost meanwhile
            if self._submitted:
                self._client.cancel([submitted.future for submitted in self._submitted.values()])
            self._client.set_metadata([_METADATA, self._run], {})

    def _submit_tests(self) -> Iterator[Outcome]:
        """Keep twice as many tests submitted as workers have threads; yield refused tests."""
        while len(self._submitted) < 2 * self._workers.threads:
            following = (_Waiting(task) for task in islice(self._tasks, 1))
            test = self._resubmitted.popleft() if self._resubmitted else next(following, None)
            if test is None:
                return
            able = self._workers.fit - test.unseen_by
            if able:
                self._submit(test, able)
            else:
                yield self._refuse_unseen(test.task)

    def _submit(self, test: _Waiting, workers: frozenset[str]) -> None:
        key = f"labpipe-{self._run}-{next(self._numbers)}"
        call = (process_on_worker, self._run, test.task, self._home, self._limit)
        with self._lost_scheduler():
            future = self._client.submit(*call, key=key, pure=False, workers=sorted(workers))
        self._submitted[key] = _Submitted(test, future, workers)
        future.add_done_callback(lambda done: self._ended.put(done.key))

    def _collect(self, submitted: _Submitted) -> Outcome | None:
        """Return the outcome of a test, or resubmit it."""
        from distributed import KilledWorker

        # s in which new files must become visible here; network drives are slow
        visibility_timeout = 5.0
        future, task = submitted.future, submitted.test.task
        if future.status == "error":
            error = future.exception()
            if isinstance(error, KilledWorker):
                return self._refuse_killer(task, error.allowed_failures + 1)
            raise self._worker_error(error) from error
        with self._lost_scheduler():
            answer: Answer = future.result()
        if answer.lost_workers:
            return self._refuse_killer(task, answer.lost_workers)
        if answer.ended is not None:
            outcome = outcome_of_call(task, answer.ended)
            if _is_seen(outcome, time.monotonic() + visibility_timeout):
                self._was_seen = True
                return outcome
        elif not task.sheet.exists():
            return outcome_of(task)
        unseen_by = submitted.test.unseen_by | {answer.worker}
        self._resubmitted.append(_Waiting(task, unseen_by))
        return None

    def _worker_error(self, error: BaseException) -> ProcessingError:
        """Make the error for a cluster that cannot run tests."""
        self._is_lost = True
        first_line = (str(error).splitlines() or [""])[0]
        expected = "a scheduler and workers that can process tests"
        state = f"that this failed ({type(error).__name__}: {first_line})"
        remedy = "Install the same labpipe on all machines, including the scheduler."
        message = error_text("--executor", "", expected=expected, found=state, remedy=remedy)
        return ProcessingError(message, code="no_cluster")

    def _refuse_killer(self, task: Task, times: int) -> Outcome:
        """Refuse a test that lost its workers."""
        reason = error_text(
            task.sheet,
            "",
            expected="a worker that completes this test",
            found=f"that {times} workers were lost with it",
            remedy="Check their logs and memory, or process the test on this machine.",
        )
        return failed_outcome(refuse(task, "worker_died", reason, is_read=False))

    def _refuse_unseen(self, task: Task) -> Outcome:
        """Refuse a test whose files no worker sees; raise if no worker has seen any file yet."""
        state = f"none (workers: {len(self._workers.fit)})"
        remedy = (
            "Mount the folders of exports and results at the same path on all workers, on a shared"
            " drive."
        )
        expected = "a worker that sees the files of this machine"
        reason = error_text(task.sheet, "", expected=expected, found=state, remedy=remedy)
        if not self._was_seen:
            raise UsageError(reason, code="no_cluster")
        return failed_outcome(refuse(task, "worker_without_data", reason, is_read=False))

    def _resubmit_orphans(self) -> None:
        """Resubmit tests that wait for lost workers."""
        for key, submitted in list(self._submitted.items()):
            if not submitted.workers & self._workers.fit:
                self._submitted.pop(key)
                self._client.cancel([submitted.future])
                self._resubmitted.append(submitted.test)

    @contextmanager
    def _lost_scheduler(self) -> Iterator[None]:
        """Raise one error if the scheduler is lost."""
        try:
            yield
        except Exception as error:
            self._is_lost = True
            message = error_text(
                "--executor",
                "",
                expected=f"the scheduler at {self._address} until the end of the run",
                found="that it, or every worker, was lost",
                remedy="Start it again; the next run processes the remaining tests.",
            )
            raise ProcessingError(message, code="no_cluster") from error


def _is_seen(outcome: Outcome, until: float) -> bool:
    """Return whether the results of a worker are visible here; waits for a slow drive."""
    if outcome.folder is None or outcome.state == "failed":
        return True
    wanted = json.dumps(outcome.run)
    while True:
        with suppress(OSError):
            if wanted in (outcome.folder / SUMMARY_FILE).read_text(encoding="utf-8"):
                return True
        if time.monotonic() > until:
            return False
        time.sleep(0.1)


class _ClusterWorkers:
    """The workers of a cluster, and which of them have this labpipe."""

    def __init__(self, client: Client, lost: Callable[[], AbstractContextManager[None]]) -> None:
        self._client, self._lost_scheduler = client, lost
        self._threads: Mapping[str, int] = {}
        self._known = set[str]()
        self._last_update = self._last_fit = 0.0
        self.unfit: dict[str, str] = {}

    @property
    def fit(self) -> frozenset[str]:
        """Return the addresses of the usable workers."""
        return frozenset(self._threads.keys() - self.unfit.keys())

    @property
    def threads(self) -> int:
        """Return the number of tests that they run at the same time."""
        return sum(self._threads[worker] for worker in self.fit)

    def wait_for_workers(self) -> None:
        """Wait for the first usable worker."""
        until = time.monotonic() + _CONNECT_TIMEOUT
        self._update()
        while not self.fit and time.monotonic() < until:
            time.sleep(0.2)
            self._update()
        if not self.fit:
            reasons = "; ".join(sorted(set(self.unfit.values()))) or "none"
            remedy = "Start workers with `dask worker HOST:PORT` and the same labpipe."
            expected = f"workers with labpipe {versions()[0]}"
            raise _cluster_error(expected, reasons, remedy)

    def refresh_workers(self) -> bool:
        """Update the list of workers unless it is recent; return whether it was updated."""
        if time.monotonic() < self._last_update + _UPDATE_INTERVAL:
            return False
        self._update()
        return True

    def _update(self) -> None:
        # s without any worker, after which a run ends: a machine may be starting
        no_worker_limit = 120.0
        with self._lost_scheduler():
            self._threads = self._client.nthreads()
            new = sorted(self._threads.keys() - self._known)
            if new:
                answers = self._client.run(versions, workers=new, on_error="return")
                for worker, answer in answers.items():
                    self._record_versions(worker, answer)
            self._last_update = time.monotonic()
            if self.fit or not self._last_fit:
                self._last_fit = self._last_update
            elif self._last_update > self._last_fit + no_worker_limit:
                raise TimeoutError

    def _record_versions(self, worker: str, answer: object) -> None:
        """Record the `versions` of a worker, or why it has none."""
        if isinstance(answer, OSError):  # lost meanwhile: asked again if it returns
            return
        self._known.add(worker)
        if isinstance(answer, BaseException):
            self.unfit[worker] = "workers without labpipe"
        elif answer != versions():
            self.unfit[worker] = f"workers with another version, {answer}"
