"""What a worker of a cluster does: a batch of tests, each in a process of its own.

A crash in C does not take the worker down then, and the worker goes on telling its scheduler that
it is there.
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
"""Of labpipe, and of its way of processing."""


@dataclass(frozen=True, slots=True)
class Batch:
    """Tests that a worker does one after the other.

    Parameters
    ----------
    counter : where the cluster counts how often it was begun
    tasks : the tests
    home : working folder of whoever asks; relative paths of tasks mean that one
    limit : s, after which a test is given up; None for no limit
    versions : of whoever asks
    """

    counter: tuple[str, str]
    tasks: tuple[Task, ...]
    home: Path
    limit: float | None
    versions: Versions


@dataclass(frozen=True, slots=True)
class FilesNotVisible:
    """A test of which a worker does not see the files."""


@dataclass(frozen=True, slots=True)
class LostBatch:
    """A batch that was begun before, by a worker that is gone; this one left it alone.

    Parameters
    ----------
    times : that it was begun
    """

    times: int


Ended: TypeAlias = Outcome | ProcessDied | CallRaised | FilesNotVisible
METADATA = "labpipe"
"""Where the scheduler keeps how often batches were begun and not ended."""
_IDLE = 60.0
"""s without a batch, after which the process for tests is ended."""


def versions() -> Versions:
    """Tell which labpipe a worker has."""
    return __version__, PROCESSING_VERSION


def do_batch(batch: Batch) -> tuple[str, Versions | LostBatch | list[Ended]]:
    """Do the tests of a batch, on a worker.

    Parameters
    ----------
    batch : the tests

    Returns
    -------
    address : of the worker
    ended : what came of each test, in their order; the versions of this labpipe if they are others
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
    ended = do_here(batch)
    # If the worker is lost before its results are fetched, they are made again: no death of theirs.
    client.set_metadata(counter, 0)
    return address, ended


def do_here(batch: Batch) -> list[Ended]:
    """Do the tests of a batch in a process for tests of this one.

    Parameters
    ----------
    batch : the tests

    Returns
    -------
    What came of each, in their order.
    """
    seen = [task for task in batch.tasks if (batch.home / task.sheet).exists()]
    ended: dict[Path, Ended] = {}
    with _crew(batch.limit) as crew:
        for (_, task), outcome in crew.as_they_end([(batch.home, task) for task in seen]):
            ended[task.sheet] = outcome
    return [ended.get(task.sheet, FilesNotVisible()) for task in batch.tasks]


def _outcome_at(given: tuple[Path, Task]) -> Outcome:
    """Process a test where relative paths mean what they meant to whoever asked."""
    home, task = given
    with suppress(OSError):  # not there: then paths are absolute, or the sheet would not be seen
        os.chdir(home)
    return outcome_of(task)


class _Kept(threading.local):
    """The process for tests of each thread of this worker, kept for the next batch for a while."""

    def __init__(self) -> None:
        self.crews: dict[float | None, WorkerPool[tuple[Path, Task], Outcome]] = {}
        self.end = threading.Timer(0.0, lambda: None)


_KEPT = _Kept()


@contextmanager
def _crew(limit: float | None) -> Iterator[WorkerPool[tuple[Path, Task], Outcome]]:
    _KEPT.end.cancel()
    crew = _KEPT.crews.pop(limit, None) or WorkerPool(_outcome_at, jobs=1, limit=limit)
    try:
        yield crew
    except BaseException:
        crew.leave()
        raise
    _KEPT.crews[limit] = crew
    _KEPT.end = threading.Timer(_IDLE, partial(_let_go, _KEPT.crews))
    _KEPT.end.daemon = True
    _KEPT.end.start()


def _let_go(crews: dict[float | None, WorkerPool[tuple[Path, Task], Outcome]]) -> None:
    while crews:
        with suppress(KeyError):  # taken meanwhile
            crews.popitem()[1].leave()
