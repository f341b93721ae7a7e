"""A persistent process with its modules imported before a recording ends."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TypeVar

from labpipe.campaign.outcomes import Outcome, outcome_of, outcome_of_call
from labpipe.campaign.workers import CallRaised, ProcessDied, WorkerProcess, describe_death
from labpipe.errors import ProcessingError
from labpipe.process.protocol_match import all_protocols
from labpipe.process.run import draw_figures
from labpipe.process.test_runner import Task

T = TypeVar("T")

_MODULES = (
    "labpipe.campaign.pairing",
    "labpipe.process.run",
    "labpipe.process.story",
    "labpipe.process.camera_steps",
    "labpipe.process.span_steps",
    "labpipe.markers.specimen_shape",
    "labpipe.results.moment_curvature",
    "labpipe.store.write",
    "labpipe.report.figures",
    *(f"labpipe.readers.{name}" for name in ("dspace_mat", "motive_takes", "load_frame")),
    "scipy.optimize",
    "scipy.signal",
    "scipy.interpolate",
    "scipy.stats",
)
"""Modules that processing and figures import."""


class WarmWorker:
    """A process that runs calls in sequence; if it dies, only its call fails.

    Parameters
    ----------
    limit : s, time limit of a call, after which its process is ended
    """

    def __init__(self, *, limit: float = 3600.0) -> None:
        self._limit, self._process = limit, WorkerProcess()
        self._thread = ThreadPoolExecutor(max_workers=1)

    def warm(self) -> None:
        """Start importing the modules of tests, without waiting."""
        self._submit(_import_all)

    def call(self, work: Callable[[], T], *, about: object) -> T:
        """Run a call in the process and wait for it.

        Parameters
        ----------
        work : can be pickled, and so can its result
        about : subject for messages, such as a file

        Raises
        ------
        ProcessingError
            If the process dies, or the call takes too long; the process is replaced.
        LabpipeError
            If the call raises it.
        """
        outcome = self._submit(work).result()
        if isinstance(outcome, CallRaised):
            raise outcome.error
        if isinstance(outcome, ProcessDied):
            _, reason = describe_death(about, outcome)
            raise ProcessingError(reason)
        return outcome

    def draw(self, folder: Path) -> None:
        """Start drawing the figures of a processed test, without waiting.

        Parameters
        ----------
        folder : of its results
        """
        self._submit(partial(draw_figures, folder))

    def executor(self, tasks: Iterable[Task]) -> Generator[Outcome, None, None]:
        """Process tests without figures; see `labpipe.campaign.executors.Executor`."""
        for task in tasks:
            call = self._submit(partial(outcome_of, replace(task, figures=False)))
            yield outcome_of_call(task, call.result())

    def close(self) -> None:
        """Wait for the started calls, and end the process."""
        try:
            self._thread.shutdown()
        finally:
            self._process.close()

    def _submit(self, work: Callable[[], T]) -> Future[T | ProcessDied | CallRaised]:
        return self._thread.submit(self._process.call, work, limit=self._limit)


def _import_all() -> None:
    for name in _MODULES:
        import_module(name)
    all_protocols()  # parses protocols and units once
