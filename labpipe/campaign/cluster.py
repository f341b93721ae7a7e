"""Tests dealt out to the workers of a dask.distributed cluster, in batches.

A batch is one task of the cluster. Its scheduler keeps no outcome that was taken, and so does not
grow with the campaign.
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
    do_batch,
    versions,
)
from labpipe.campaign.outcomes import Outcome, given_up, outcome_of, settled
from labpipe.errors import ProcessingError, UsageError, error_text
from labpipe.process.run import SUMMARY_FILE
from labpipe.process.test_runner import Task, refuse

if TYPE_CHECKING:
    from distributed import Client, Future

_CONNECT = 10.0
"""s that a scheduler and a first worker are waited for."""
_LOOK = 5.0
"""s between looks at which workers there are."""
_NOBODY = 120.0
"""s without any worker after which a run ends: a machine may be starting."""
_BATCH = 2.0
"""s that a batch should last: much against the 10 ms of a task of a cluster, little to lose."""
_FIRST, _MOST = 4, 100
"""Tests in a batch before it is known how long one takes, and at the most."""
_SEEN_WITHIN = 5.0
"""s in which new files must be seen from here; a network drive may take some."""
_DEATHS = 2
"""Workers that one test may cost."""


def dealt(
    tasks: Iterable[Task], address: str, *, limit: float | None = None
) -> Generator[Outcome, None, None]:
    """Process tests on a cluster.

    Parameters
    ----------
    tasks : taken one by one, as workers become free
    address : of the scheduler, ``HOST:PORT``
    limit : s, after which a test is given up; None for no limit

    Yields
    ------
    The outcomes, as they come.

    Raises
    ------
    UsageError
        If `distributed` is not installed, there is no scheduler at that address, or no worker that
        has this labpipe.
    ProcessingError
        If the scheduler or all workers are gone before all is done; batches that were begun go on.
    """
    left = iter(tasks)
    first = list(islice(left, 1))
    if not first:
        return
    with _quiet(), _connected(address) as client:
        dealer = _BatchScheduler(client, chain(first, left), address, limit)
        try:
            yield from dealer.outcomes()
        finally:
            dealer.leave()


@contextmanager
def _connected(address: str) -> Iterator[Client]:
    try:
        from distributed import Client
    except ImportError as error:
        raise _no_cluster(_NO_PACKAGE, "none", "Install labpipe with it: labpipe[dask].") from error
    try:
        client = Client(f"tcp://{address}", timeout=_CONNECT, set_as_default=False)
    except (OSError, ValueError) as error:  # a TimeoutError is an OSError
        expected = f"a dask scheduler at {address}"
        remedy = "Start one with `dask scheduler`, and look at its address and at firewalls."
        raise _no_cluster(expected, "none that answers", remedy) from error
    try:
        yield client
    finally:
        with suppress(Exception):  # it went away before
            client.close(timeout=_CONNECT)


_NO_PACKAGE = "the package distributed"


def _no_cluster(expected: str, found: str, remedy: str) -> UsageError:
    message = error_text("--executor", "", expected=expected, found=found, remedy=remedy)
    return UsageError(message, code="no_cluster")


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep to ourselves what the library says of lost connections: one message tells it."""
    before = logging.root.manager.disable
    logging.disable(logging.CRITICAL)
    try:
        yield
    finally:
        logging.disable(before)


@dataclass(frozen=True, slots=True)
class _TestBatch:
    """Tests to be dealt together, and what is known of them.

    Parameters
    ----------
    tasks : the tests
    deaths : workers that were lost with them
    unseen_by : workers that do not see their files
    """

    tasks: tuple[Task, ...]
    deaths: int = 0
    unseen_by: frozenset[str] = frozenset()


@dataclass(frozen=True, slots=True)
class _RunningBatch:
    """A hand that is out.

    Parameters
    ----------
    hand : the tests
    future : of the cluster
    workers : that may do it; empty for all
    """

    hand: _TestBatch
    future: Future
    workers: frozenset[str]


class _BatchScheduler:
    """Deals tests out, takes outcomes, and deals again what was not done."""

    def __init__(
        self, client: Client, tasks: Iterator[Task], address: str, limit: float | None
    ) -> None:
        self._client, self._tasks, self._address, self._limit = client, tasks, address, limit
        self._home, self._run = Path.cwd(), uuid4().hex
        self._numbers = count()
        self._ended: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._out: dict[str, _RunningBatch] = {}
        self._again: deque[_TestBatch] = deque()
        self._crew = _ClusterWorkers(client, self._lost)
        self._seconds = _BATCH / _FIRST
        self._was_seen = self._is_lost = False

    def outcomes(self) -> Generator[Outcome, None, None]:
        """Give outcomes until all is done."""
        self._crew.gather()
        while True:
            yield from self._deal()
            if self._crew.fit and not self._out:
                return
            with suppress(queue.Empty):
                dealt = self._out.pop(self._ended.get(timeout=_LOOK), None)
                if dealt is not None:
                    yield from self._taken(dealt)
            if self._crew.refresh_workers():
                self._take_back()

    def leave(self) -> None:
        """Take back what is not begun, and what was counted."""
        if self._is_lost:
            return
        with suppress(Exception):  # the scheduler may go away just now
            if self._out:
                self._client.cancel([dealt.future for dealt in self._out.values()])
            self._client.set_metadata([METADATA, self._run], {})

    def _deal(self) -> Iterator[Outcome]:
        """Keep twice as many hands out as workers have threads; some may be refused."""
        while len(self._out) < 2 * self._crew.threads:
            hand = self._again.popleft() if self._again else self._next()
            if hand is None:
                return
            able = self._crew.fit - hand.unseen_by
            if not able:
                yield from self._without_data(hand)
                continue
            self._submit(hand, able if hand.unseen_by or self._crew.unfit else frozenset())

    def _next(self) -> _TestBatch | None:
        size = min(max(round(_BATCH / max(self._seconds, 1e-3)), 1), _MOST)
        tasks = tuple(islice(self._tasks, size))
        return _TestBatch(tasks) if tasks else None

    def _submit(self, hand: _TestBatch, workers: frozenset[str]) -> None:
        key = f"labpipe-{self._run}-{next(self._numbers)}"
        batch = Batch((self._run, key), hand.tasks, self._home, self._limit, versions())
        with self._lost():
            future = self._client.submit(
                do_batch, batch, key=key, pure=False, workers=sorted(workers) or None
            )
        self._out[key] = _RunningBatch(hand, future, workers)
        future.add_done_callback(lambda done: self._ended.put(done.key))

    def _taken(self, dealt: _RunningBatch) -> Iterator[Outcome]:
        future, hand = dealt.future, dealt.hand
        if future.status == "error":
            return self._after_error(hand, future.exception())
        with self._lost():
            worker, ended = future.result()
        if isinstance(ended, tuple):  # of a worker that came just now
            self._crew.judge(worker, ended)
            self._again.append(hand)
            return iter(())
        if isinstance(ended, LostBatch):
            return self._after_death(hand, ended.times)
        return self._settled(hand, worker, ended)

    def _settled(self, hand: _TestBatch, worker: str, ended: list[Ended]) -> Iterator[Outcome]:
        unseen, until = list[Task](), time.monotonic() + _SEEN_WITHIN
        for task, each in zip(hand.tasks, ended, strict=True):
            if isinstance(each, FilesNotVisible):
                if task.sheet.exists():
                    unseen.append(task)
                else:
                    yield outcome_of(task)
                continue
            outcome = settled(task, each)
            if _is_seen(outcome, until):
                self._was_seen = True
                self._seconds += 0.2 * (outcome.seconds - self._seconds)
                yield outcome
            else:
                unseen.append(task)
        if unseen:
            by = hand.unseen_by | {worker}
            self._again.append(replace(hand, tasks=tuple(unseen), unseen_by=by))

    def _after_error(self, hand: _TestBatch, error: BaseException) -> Iterator[Outcome]:
        """Deal again what lost its workers; end where the cluster cannot do a batch at all."""
        from distributed import KilledWorker

        if isinstance(error, KilledWorker):
            return self._after_death(hand, 1)
        self._is_lost = True
        expected = "a scheduler and workers that can do tests"
        found = f"that one cannot ({type(error).__name__}: {_first_line(error)})"
        remedy = "Install the same labpipe on all machines, that of the scheduler too."
        message = error_text("--executor", "", expected=expected, found=found, remedy=remedy)
        raise ProcessingError(message, code="no_cluster") from error

    def _after_death(self, hand: _TestBatch, times: int) -> Iterator[Outcome]:
        """Deal tests that lost a worker again, each alone; refuse the one that loses another."""
        deaths = hand.deaths + times
        for task in hand.tasks:
            if len(hand.tasks) == 1 and deaths >= _DEATHS:
                reason = error_text(
                    task.sheet,
                    "",
                    expected="a worker that comes to the end of this test",
                    found=f"that {deaths} were lost with it",
                    remedy="Look at their logs and their memory, or process it on this machine.",
                )
                yield given_up(refuse(task, "worker_died", reason, is_read=False))
            else:
                self._again.append(replace(hand, tasks=(task,), deaths=deaths))

    def _without_data(self, hand: _TestBatch) -> Iterator[Outcome]:
        """Refuse what no worker sees; all of it where none has seen anything yet."""
        found = f"none (workers: {len(self._crew.fit)})"
        remedy = (
            "Have the folders of exports and results at the same place on all workers, on a drive"
            " that they share."
        )
        for task in hand.tasks:
            expected = "a worker that sees the files that are seen here"
            reason = error_text(task.sheet, "", expected=expected, found=found, remedy=remedy)
            if not self._was_seen:
                raise UsageError(reason, code="no_cluster")
            yield given_up(refuse(task, "worker_without_data", reason, is_read=False))

    def _take_back(self) -> None:
        """Deal again what waits for workers that are gone."""
        for key, dealt in list(self._out.items()):
            if dealt.workers and not dealt.workers & self._crew.fit:
                self._out.pop(key)
                self._client.cancel([dealt.future])
                self._again.append(dealt.hand)

    @contextmanager
    def _lost(self) -> Iterator[None]:
        """Say in one message that the scheduler is gone."""
        try:
            yield
        except Exception as error:
            self._is_lost = True
            message = error_text(
                "--executor",
                "",
                expected=f"the scheduler at {self._address} until all is done",
                found="that it, or every worker, is gone",
                remedy="Start it again; the next run does what is left.",
            )
            raise ProcessingError(message, code="no_cluster") from error


def _first_line(error: BaseException) -> str:
    return (str(error).splitlines() or [""])[0]


def _is_seen(outcome: Outcome, until: float) -> bool:
    """Whether the results that a worker wrote are seen from here; waits for a slow drive."""
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
    """The workers of a cluster that have this labpipe."""

    def __init__(self, client: Client, lost: Callable[[], AbstractContextManager[None]]) -> None:
        self._client, self._lost = client, lost
        self._threads: Mapping[str, int] = {}
        self._known = set[str]()
        self._looked = self._there = 0.0
        self.unfit: dict[str, str] = {}

    @property
    def fit(self) -> frozenset[str]:
        """Addresses of those that are there."""
        return frozenset(self._threads.keys() - self.unfit.keys())

    @property
    def threads(self) -> int:
        """Batches that they do at a time."""
        return sum(self._threads[each] for each in self.fit)

    def gather(self) -> None:
        """Wait for the first one."""
        until = time.monotonic() + _CONNECT
        self._look()
        while not self.fit and time.monotonic() < until:
            time.sleep(0.2)
            self._look()
        if not self.fit:
            found = "; ".join(sorted(set(self.unfit.values()))) or "none"
            remedy = "Start some with `dask worker HOST:PORT`, with the same labpipe installed."
            expected = f"workers with labpipe {versions()[0]}"
            raise _no_cluster(expected, found, remedy)

    def refresh_workers(self) -> bool:
        """See who came and who went, if that was not done just now; tell whether it was done."""
        if time.monotonic() < self._looked + _LOOK:
            return False
        self._look()
        return True

    def _look(self) -> None:
        with self._lost():
            self._threads = self._client.nthreads()
            new = sorted(self._threads.keys() - self._known)
            if new:
                said = self._client.run(versions, workers=new, on_error="return")
                for worker, version in said.items():
                    self.judge(worker, version)
            self._looked = time.monotonic()
            if self.fit or not self._there:
                self._there = self._looked
            elif self._looked > self._there + _NOBODY:
                raise TimeoutError

    def judge(self, worker: str, said: object) -> None:
        """Take note of what a worker says of its `versions`, or why it cannot.

        Parameters
        ----------
        worker : its address
        said : what it says
        """
        if isinstance(said, OSError):  # it went away meanwhile: asked again if it is back
            return
        self._known.add(worker)
        if isinstance(said, BaseException):
            self.unfit[worker] = "workers without it"
        elif said != versions():
            self.unfit[worker] = f"workers with another one, {said}"
