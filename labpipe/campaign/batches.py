"""A batch of tests on a cluster worker, each in its own process.

A crash in C then does not end the worker, which stays connected to its scheduler.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TypeAlias

from labpipe import __version__
from labpipe.campaign.outcomes import Outcome, outcome_of
from labpipe.campaign.workers import CallRaised, ProcessDied, WorkerPool
from labpipe.process.run import PROCESSING_VERSION
from labpipe.process.test_runner import Task

Versions: TypeAlias = tuple[str, int]
"""Version of labpipe, and processing version."""


@dataclass(frozen=True, slots=True)
class Batch:
    """Tests that a worker processes in sequence.

    Parameters
    ----------
    counter : key under which the cluster counts starts of the batch
    tasks : the tests
    home : working folder of the client; relative paths of tasks start there
    limit : s, time limit of a test; None for no limit
    versions : of the client
    """

    counter: tuple[str, str]
    tasks: tuple[Task, ...]
    home: Path
    limit: float | None
    versions: Versions


@dataclass(frozen=True, slots=True)
class FilesNotVisible:
    """A test whose files are not visible to a worker."""


@dataclass(frozen=True, slots=True)
class LostBatch:
    """A batch that was started before on a lost worker, and was not started again.

    Parameters
    ----------
    times : number of earlier starts
    """

    times: int


Ended: TypeAlias = Outcome | ProcessDied | CallRaised | FilesNotVisible
METADATA = "labpipe"
"""Key of the scheduler metadata that counts unfinished starts of batches."""


def versions() -> Versions:
    """Return the versions of a worker."""
    return __version__, PROCESSING_VERSION


def process_batch(batch: Batch) -> tuple[str, Versions | LostBatch | list[Ended]]:
    """Process the tests of a batch on a worker.

    Parameters
    ----------
    batch : the tests

    Returns
    -------
    address : of the worker
    ended : outcome of each test, in order; the versions of this labpipe if they differ
    """
    from distributed import get_client, get_worker

    address = str(get_worker().address)
    if batch.versions != versions():
        return address, versions()
    client, counter = get_client(), [METADATA, *batch.counter]
    times = int(client.get_metadata(counter, 0))
    client.set_metadata(counter, times + 1)
    if times:
        return address, LostBatch(times)
    ended = process_locally(batch)
    # If the worker is lost before its results are fetched, the batch is repeated without a penalty.
    client.set_metadata(counter, 0)
    return address, ended


def process_locally(batch: Batch) -> list[Ended]:
    """Process the tests of a batch in a child process.

    Parameters
    ----------
    batch : the tests

    Returns
    -------
    Outcome of each test, in order.
    """
    seen = [task for task in batch.tasks if (batch.home / task.sheet).exists()]
    ended: dict[Path, Ended] = {}
    with _worker_pool(batch.limit) as pool:
        for (_, task), outcome in pool.as_completed([(batch.home, task) for task in seen]):
            ended[task.sheet] = outcome
    return [ended.get(task.sheet, FilesNotVisible()) for task in batch.tasks]


def _outcome_at(call: tuple[Path, Task]) -> Outcome:
    """Process a test in the working folder of the client."""
    home, task = call
    with suppress(OSError):  # missing only if all paths are absolute
        os.chdir(home)
    return outcome_of(task)


class _IdlePools(threading.local):
    """Process pools of a worker thread, kept for the next batch for a while."""

    def __init__(self) -> None:
        self.pools: dict[float | None, WorkerPool[tuple[Path, Task], Outcome]] = {}
        self.end = threading.Timer(0.0, lambda: None)


_IDLE_POOLS = _IdlePools()


@contextmanager
def _worker_pool(limit: float | None) -> Iterator[WorkerPool[tuple[Path, Task], Outcome]]:
    # s without a batch, after which the process is closed
    idle_limit = 60.0
    _IDLE_POOLS.end.cancel()
    pool = _IDLE_POOLS.pools.pop(limit, None) or WorkerPool(_outcome_at, jobs=1, limit=limit)
    try:
        yield pool
    except BaseException:
        pool.close()
        raise
    _IDLE_POOLS.pools[limit] = pool
    _IDLE_POOLS.end = threading.Timer(idle_limit, partial(_close_pools, _IDLE_POOLS.pools))
    _IDLE_POOLS.end.daemon = True
    _IDLE_POOLS.end.start()


def _close_pools(pools: dict[float | None, WorkerPool[tuple[Path, Task], Outcome]]) -> None:
    while pools:
        with suppress(KeyError):  # taken by the next batch
            pools.popitem()[1].close()
