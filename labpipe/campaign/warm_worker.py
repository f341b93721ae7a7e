"""One process that stays: what it needs is imported before a recording ends."""

from __future__ import annotations

import threading
from collections.abc import Callable, Generator, Iterable
from dataclasses import replace
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TypeVar, cast

from labpipe.campaign.outcomes import Outcome, outcome_of, settled
from labpipe.campaign.workers import CallRaised, ProcessDied, WorkerPool, why
from labpipe.errors import ProcessingError
from labpipe.process.protocol_match import all_protocols
from labpipe.process.run import draw_figures
from labpipe.process.test_runner import Task

T = TypeVar("T")

_NEEDED = (
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
"""What a test imports as it is processed and drawn."""


class WarmWorker:
    """A process that does one call after the other; one that dies costs its call alone.

    Parameters
    ----------
    limit : s, after which a call is given up and its process ended
    """

    def __init__(self, *, limit: float = 3600.0) -> None:
        self._crew: WorkerPool[Callable[[], object], object] = WorkerPool(_do, jobs=1, limit=limit)
        self._behind: threading.Thread | None = None

    def warm(self) -> None:
        """Begin to import what tests need; this call does not wait for it."""
        self._begin(_import_all)

    def call(self, work: Callable[[], T], *, about: object) -> T:
        """Do a call in the process and wait for it.

        Parameters
        ----------
        work : what can be pickled, as what it gives
        about : what it is done for, such as a file, for messages

        Raises
        ------
        ProcessingError
            If the process dies, or the call takes too long; another takes its place.
        LabpipeError
            What the call raises.
        """
        outcome = self._ended(work)
        if isinstance(outcome, CallRaised):
            raise outcome.error
        if isinstance(outcome, ProcessDied):
            _, reason = why(about, outcome)
            raise ProcessingError(reason)
        return outcome

    def draw(self, folder: Path) -> None:
        """Begin to draw the figures of a processed test; this call does not wait for it.

        Parameters
        ----------
        folder : of its results
        """
        self._begin(partial(draw_figures, folder))

    def executor(self, tasks: Iterable[Task]) -> Generator[Outcome, None, None]:
        """Process tests, numbers only; see `labpipe.campaign.executors.Executor`."""
        for task in tasks:
            yield settled(task, self._ended(partial(outcome_of, replace(task, figures=False))))

    def leave(self) -> None:
        """Wait until it has done what was begun, and end it."""
        self._wait()
        self._crew.leave()

    def _begin(self, work: Callable[[], object]) -> None:
        """Have a call done behind: figures, or imports; what becomes of them shows elsewhere."""
        self._wait()
        self._behind = threading.Thread(target=self._done, args=(work,))
        self._behind.start()

    def _ended(self, work: Callable[[], T]) -> T | ProcessDied | CallRaised:
        self._wait()
        return self._done(work)

    def _done(self, work: Callable[[], T]) -> T | ProcessDied | CallRaised:
        ((_, outcome),) = self._crew.as_they_end([work])
        return cast("T | ProcessDied | CallRaised", outcome)

    def _wait(self) -> None:
        if self._behind is not None:
            self._behind.join()
            self._behind = None


def _do(work: Callable[[], object]) -> object:
    return work()


def _import_all() -> None:
    for name in _NEEDED:
        import_module(name)
    all_protocols()  # parsed once, and with them the units
