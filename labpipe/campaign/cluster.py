"""Process tests in batches on the workers of a dask.distributed cluster.

A batch is one task of the cluster. The scheduler drops outcomes once they are fetched, so that its
memory does not grow with the campaign.
"""

from __future__ import annotations

import json
import logging
import queue
import time
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass, replace
from itertools import chain, count, islice
from pathlib import Path
from typing import TYPE_CHECKING
from uuid import uuid4

from labpipe.campaign.batches import (
    METADATA,
    Batch,
    Ended,
    FilesNotVisible,
    LostBatch,
    process_batch,
    versions,
)
from labpipe.campaign.outcomes import Outcome, failed_outcome, outcome_of, outcome_of_call
from labpipe.errors import ProcessingError, UsageError, error_text
from labpipe.process.run import SUMMARY_FILE
from labpipe.process.test_runner import Task, refuse

if TYPE_CHECKING:
    from distributed import Client, Future

_CONNECT_TIMEOUT = 10.0
"""s to wait for the scheduler, and for a first worker."""
_UPDATE_INTERVAL = 5.0
"""s between updates of the list of workers."""
_BATCH_DURATION = 2.0
"""s that a batch should take: long against the 10 ms overhead of a task, short to repeat."""
_FIRST, _MOST = 4, 100
"""Tests in a batch before it is known how long one takes, and at the most."""


def process_on_cluster(
    tasks: Iterable[Task], address: str, *, limit: float | None = None
) -> Generator[Outcome, None, None]:
    """Process tests on a cluster.

    Parameters
    ----------
    tasks : taken when workers become free
    address : of the scheduler, ``HOST:PORT``
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
        If the scheduler or all workers are lost during the run; started batches continue.
    """
    left = iter(tasks)
    first = list(islice(left, 1))
    if not first:
        return
    with _without_logging(), _connect(address) as client:
        scheduler = _BatchScheduler(client, chain(first, left), address, limit)
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
        client = Client(f"tcp://{address}", timeout=_CONNECT_TIMEOUT, set_as_default=False)
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


@dataclass(frozen=True, slots=True)
class _TestBatch:
    """Tests of one batch, and their history.

    Parameters
    ----------
    tasks : the tests
    deaths : number of workers lost with them
    unseen_by : workers that do not see the files
    """

    tasks: tuple[Task, ...]
    deaths: int = 0
    unseen_by: frozenset[str] = frozenset()


@dataclass(frozen=True, slots=True)
class _RunningBatch:
    """A batch on the cluster.

    Parameters
    ----------
    test_batch : the tests
    future : of the cluster
    workers : allowed ones; empty for all
    """

    test_batch: _TestBatch
    future: Future
    workers: frozenset[str]


class _BatchScheduler:
    """Submits tests, collects outcomes, and resubmits what was lost."""

    def __init__(
        self, client: Client, tasks: Iterator[Task], address: str, limit: float | None
    ) -> None:
        self._client, self._tasks, self._address, self._limit = client, tasks, address, limit
        self._home, self._run = Path.cwd(), uuid4().hex
        self._numbers = count()
        self._ended: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._running: dict[str, _RunningBatch] = {}
        self._resubmitted: deque[_TestBatch] = deque()
        self._workers = _ClusterWorkers(client, self._lost_scheduler)
        self._seconds = _BATCH_DURATION / _FIRST
        self._was_seen = self._is_lost = False

    def outcomes(self) -> Generator[Outcome, None, None]:
        """Yield outcomes until all tests are done."""
        self._workers.wait_for_workers()
        while True:
            yield from self._submit_batches()
            if self._workers.fit and not self._running:
                return
            with suppress(queue.Empty):
                running = self._running.pop(self._ended.get(timeout=_UPDATE_INTERVAL), None)
                if running is not None:
                    yield from self._collect(running)
            if self._workers.refresh_workers():
                self._resubmit_orphans()

    def close(self) -> None:
        """Cancel batches that are not started, and delete their counters."""
        if self._is_lost:
            return
        with suppress(Exception):  # the scheduler may be lost meanwhile
            if self._running:
                self._client.cancel([running.future for running in self._running.values()])
            self._client.set_metadata([METADATA, self._run], {})

    def _submit_batches(self) -> Iterator[Outcome]:
        """Keep twice as many batches submitted as workers have threads; yield refused tests."""
        while len(self._running) < 2 * self._workers.threads:
            test_batch = self._resubmitted.popleft() if self._resubmitted else self._next_batch()
            if test_batch is None:
                return
            able = self._workers.fit - test_batch.unseen_by
            if not able:
                yield from self._refuse_unseen(test_batch)
                continue
            self._submit(
                test_batch, able if test_batch.unseen_by or self._workers.unfit else frozenset()
            )

    def _next_batch(self) -> _TestBatch | None:
        size = min(max(round(_BATCH_DURATION / max(self._seconds, 1e-3)), 1), _MOST)
        tasks = tuple(islice(self._tasks, size))
        return _TestBatch(tasks) if tasks else None

    def _submit(self, test_batch: _TestBatch, workers: frozenset[str]) -> None:
        key = f"labpipe-{self._run}-{next(self._numbers)}"
        batch = Batch((self._run, key), test_batch.tasks, self._home, self._limit, versions())
        with self._lost_scheduler():
            future = self._client.submit(
                process_batch, batch, key=key, pure=False, workers=sorted(workers) or None
            )
        self._running[key] = _RunningBatch(test_batch, future, workers)
        future.add_done_callback(lambda done: self._ended.put(done.key))

    def _collect(self, running: _RunningBatch) -> Iterator[Outcome]:
        future, test_batch = running.future, running.test_batch
        if future.status == "error":
            return self._handle_error(test_batch, future.exception())
        with self._lost_scheduler():
            worker, ended = future.result()
        if isinstance(ended, tuple):  # from a new worker
            self._workers.record_versions(worker, ended)
            self._resubmitted.append(test_batch)
            return iter(())
        if isinstance(ended, LostBatch):
            return self._handle_lost_worker(test_batch, ended.times)
        return self._outcomes_of(test_batch, worker, ended)

    def _outcomes_of(
        self, test_batch: _TestBatch, worker: str, ended: list[Ended]
    ) -> Iterator[Outcome]:
        # s in which new files must become visible here; network drives are slow
        visibility_timeout = 5.0
        unseen, until = list[Task](), time.monotonic() + visibility_timeout
        for task, result in zip(test_batch.tasks, ended, strict=True):
            if isinstance(result, FilesNotVisible):
                if task.sheet.exists():
                    unseen.append(task)
                else:
                    yield outcome_of(task)
                continue
            outcome = outcome_of_call(task, result)
            if _is_seen(outcome, until):
                self._was_seen = True
                self._seconds += 0.2 * (outcome.seconds - self._seconds)
                yield outcome
            else:
                unseen.append(task)
        if unseen:
            by = test_batch.unseen_by | {worker}
            self._resubmitted.append(replace(test_batch, tasks=tuple(unseen), unseen_by=by))

    def _handle_error(self, test_batch: _TestBatch, error: BaseException) -> Iterator[Outcome]:
        """Resubmit after a lost worker; raise if the cluster cannot run batches."""
        from distributed import KilledWorker

        if isinstance(error, KilledWorker):
            return self._handle_lost_worker(test_batch, 1)
        self._is_lost = True
        expected = "a scheduler and workers that can process tests"
        state = f"that this failed ({type(error).__name__}: {_first_line(error)})"
        remedy = "Install the same labpipe on all machines, including the scheduler."
        message = error_text("--executor", "", expected=expected, found=state, remedy=remedy)
        raise ProcessingError(message, code="no_cluster") from error

    def _handle_lost_worker(self, test_batch: _TestBatch, times: int) -> Iterator[Outcome]:
        """Resubmit each test of a lost worker alone; refuse a test that loses a second one."""
        max_lost_workers = 2
        deaths = test_batch.deaths + times
        for task in test_batch.tasks:
            if len(test_batch.tasks) == 1 and deaths >= max_lost_workers:
                reason = error_text(
                    task.sheet,
                    "",
                    expected="a worker that completes this test",
                    found=f"that {deaths} workers were lost with it",
                    remedy="Check their logs and memory, or process the test on this machine.",
                )
                yield failed_outcome(refuse(task, "worker_died", reason, is_read=False))
            else:
                self._resubmitted.append(replace(test_batch, tasks=(task,), deaths=deaths))

    def _refuse_unseen(self, test_batch: _TestBatch) -> Iterator[Outcome]:
        """Refuse tests whose files no worker sees; raise if no worker has seen any file yet."""
        state = f"none (workers: {len(self._workers.fit)})"
        remedy = (
            "Mount the folders of exports and results at the same path on all workers, on a shared"
            " drive."
        )
        for task in test_batch.tasks:
            expected = "a worker that sees the files of this machine"
            reason = error_text(task.sheet, "", expected=expected, found=state, remedy=remedy)
            if not self._was_seen:
                raise UsageError(reason, code="no_cluster")
            yield failed_outcome(refuse(task, "worker_without_data", reason, is_read=False))

    def _resubmit_orphans(self) -> None:
        """Resubmit batches that wait for lost workers."""
        for key, running in list(self._running.items()):
            if running.workers and not running.workers & self._workers.fit:
                self._running.pop(key)
                self._client.cancel([running.future])
                self._resubmitted.append(running.test_batch)

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


def _first_line(error: BaseException) -> str:
    return (str(error).splitlines() or [""])[0]


def _is_seen(outcome: Outcome, until: float) -> bool:
    """Whether the results of a worker are visible here; waits for a slow drive."""
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
        """Addresses of the usable workers."""
        return frozenset(self._threads.keys() - self.unfit.keys())

    @property
    def threads(self) -> int:
        """Number of batches that they run at the same time."""
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
                for worker, version in answers.items():
                    self.record_versions(worker, version)
            self._last_update = time.monotonic()
            if self.fit or not self._last_fit:
                self._last_fit = self._last_update
            elif self._last_update > self._last_fit + no_worker_limit:
                raise TimeoutError

    def record_versions(self, worker: str, answer: object) -> None:
        """Record the `versions` of a worker, or why it has none.

        Parameters
        ----------
        worker : its address
        answer : its versions, or an exception
        """
        if isinstance(answer, OSError):  # lost meanwhile: asked again if it returns
            return
        self._known.add(worker)
        if isinstance(answer, BaseException):
            self.unfit[worker] = "workers without labpipe"
        elif answer != versions():
            self.unfit[worker] = f"workers with another version, {answer}"
