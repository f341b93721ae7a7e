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
from labpipe.campaign.workers import CallRaised, ProcessDied, WorkerProcess
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
    with _worker_process() as process:
        for task in seen:
            call = partial(_outcome_at, batch.home, task)
            ended[task.sheet] = process.call(call, limit=batch.limit)
    return [ended.get(task.sheet, FilesNotVisible()) for task in batch.tasks]


def _outcome_at(home: Path, task: Task) -> Outcome:
    """Process a test in the working folder of the client."""
    with suppress(OSError):  # missing only if all paths are absolute
        os.chdir(home)
    return outcome_of(task)


_IDLE_PROCESSES: dict[WorkerProcess, threading.Timer] = {}
"""Processes that are kept for the next batch for a while, until a timer closes them."""


@contextmanager
def _worker_process() -> Iterator[WorkerProcess]:
    # s without a batch, after which a process is closed
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
