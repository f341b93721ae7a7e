"""Executors: process tests on this machine or on a cluster."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable
from contextlib import closing
from typing import TypeAlias

from labpipe.campaign.machine import default_jobs
from labpipe.campaign.outcomes import Outcome, outcome_of, outcome_of_call
from labpipe.campaign.workers import as_completed
from labpipe.errors import UsageError, error_text
from labpipe.process.test_runner import Task

__all__ = ["Executor", "Outcome", "Task", "dask", "executor_of", "local"]

Executor: TypeAlias = Callable[[Iterable[Task]], Generator[Outcome, None, None]]
"""Takes tasks as it can start them; yields outcomes in the order of completion."""


def local(jobs: int, *, limit: float | None = None) -> Executor:
    """Process tests on this machine, each isolated in its own process.

    Parameters
    ----------
    jobs : number of tests at the same time
    limit : s, time limit of a test; None for no limit

    Returns
    -------
    The executor.
    """

    def executor(tasks: Iterable[Task]) -> Generator[Outcome, None, None]:
        with closing(as_completed(outcome_of, tasks, jobs=jobs, limit=limit)) as ended:
            for task, outcome in ended:
                yield outcome_of_call(task, outcome)

    return executor


def dask(address: str, *, limit: float | None = None) -> Executor:
    """Process tests on the workers of a dask.distributed cluster.

    Parameters
    ----------
    address : of its scheduler, ``HOST:PORT``
    limit : s, time limit of a test; None for no limit

    Returns
    -------
    The executor. It connects on the first task, and raises `UsageError` if there is no scheduler
    or no worker with this labpipe, `ProcessingError` if the scheduler is lost during the run.
    """

    def executor(tasks: Iterable[Task]) -> Generator[Outcome, None, None]:
        from labpipe.campaign.cluster import process_on_cluster  # distributed is an extra

        yield from process_on_cluster(tasks, address, limit=limit)

    return executor


_CLUSTER = "dask://"


def executor_of(text: str, *, jobs: int | None = None, limit: float | None = None) -> Executor:
    """Return the executor named on the command line.

    Parameters
    ----------
    text : ``local`` or ``dask://HOST:PORT``
    jobs : number of tests at the same time on this machine; None for `default_jobs`
    limit : s, time limit of a test; None for no limit

    Raises
    ------
    UsageError
        If the text is neither.
    """
    if text == "local":
        return local(jobs or default_jobs(), limit=limit)
    host, _, port = text.removeprefix(_CLUSTER).rpartition(":")
    if text.startswith(_CLUSTER) and host and port.isdecimal():
        return dask(f"{host}:{port}", limit=limit)
    expected, remedy = f"local, or {_CLUSTER}HOST:PORT", "`dask scheduler` prints its address."
    message = error_text("--executor", "", expected=expected, found=repr(text), remedy=remedy)
    raise UsageError(message)
