"""Where the tests of a campaign are processed: on this machine, or on a cluster."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable
from contextlib import closing
from typing import TypeAlias

from labpipe.campaign.machine import default_jobs
from labpipe.campaign.outcomes import Outcome, outcome_of, settled
from labpipe.campaign.workers import as_they_end
from labpipe.errors import UsageError, error_text
from labpipe.process.test_runner import Task

__all__ = ["Executor", "Outcome", "Task", "dask", "executor_of", "local"]

Executor: TypeAlias = Callable[[Iterable[Task]], Generator[Outcome, None, None]]
"""Takes tasks one by one as it can begin them; gives outcomes in the order in which they end."""


def local(jobs: int, *, limit: float | None = None) -> Executor:
    """Process tests on this machine, each in a process that it cannot take others down with.

    Parameters
    ----------
    jobs : how many at a time
    limit : s, after which a test is given up; None for no limit

    Returns
    -------
    The executor.
    """

    def executor(tasks: Iterable[Task]) -> Generator[Outcome, None, None]:
        with closing(as_they_end(outcome_of, tasks, jobs=jobs, limit=limit)) as ended:
            for task, outcome in ended:
                yield settled(task, outcome)

    return executor


def dask(address: str, *, limit: float | None = None) -> Executor:
    """Process tests on the workers of a dask.distributed cluster.

    Parameters
    ----------
    address : of its scheduler, ``HOST:PORT``
    limit : s, after which a test is given up; None for no limit

    Returns
    -------
    The executor. It connects when there is something to do, and raises `UsageError` where there is
    no scheduler, no worker, or none with this labpipe; `ProcessingError` where the scheduler goes
    away before all is done.
    """

    def executor(tasks: Iterable[Task]) -> Generator[Outcome, None, None]:
        from labpipe.campaign.cluster import dealt  # distributed is an extra, and takes its time

        yield from dealt(tasks, address, limit=limit)

    return executor


_CLUSTER = "dask://"


def executor_of(text: str, *, jobs: int | None = None, limit: float | None = None) -> Executor:
    """Give the executor that a command line names.

    Parameters
    ----------
    text : ``local`` or ``dask://HOST:PORT``
    jobs : how many at a time on this machine; None for `default_jobs`
    limit : s, after which a test is given up; None for no limit

    Raises
    ------
    UsageError
        If it names none.
    """
    if text == "local":
        return local(jobs or default_jobs(), limit=limit)
    host, _, port = text.removeprefix(_CLUSTER).rpartition(":")
    if text.startswith(_CLUSTER) and host and port.isdecimal():
        return dask(f"{host}:{port}", limit=limit)
    expected, remedy = f"local, or {_CLUSTER}HOST:PORT", "`dask scheduler` prints its address."
    message = error_text("--executor", "", expected=expected, found=repr(text), remedy=remedy)
    raise UsageError(message)
