"""One process that stays: what it needs is imported before a recording ends."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TypeVar

from labpipe.campaign.executors import Outcome, Task, attempt
from labpipe.campaign.runs import ended
from labpipe.campaign.workers import Died, Raised, Worker
from labpipe.errors import ProcessingError
from labpipe.process.run import draw_figures

T = TypeVar("T")

_NEEDED = (
    "labpipe.campaign.pairing",
    "labpipe.process.run",
    "labpipe.process.story",
    "labpipe.process.span_steps",
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


class StandingWorker:
    """A process that does one call after the other; one that dies costs its call alone."""

    def __init__(self) -> None:
        self._worker: Worker[Callable[[], object], object] = Worker(_do)

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
            If the process dies; another takes its place.
        LabpipeError
            What the call raises.
        """
        self._begin(work)
        _, outcome = self._worker.finish()
        if isinstance(outcome, Raised):
            raise outcome.error
        if isinstance(outcome, Died):
            raise ProcessingError(ended(about, outcome))
        return outcome  # type: ignore[return-value]  # what `work` gave

    def draw(self, folder: Path) -> None:
        """Begin to draw the figures of a processed test; this call does not wait for it.

        Parameters
        ----------
        folder : of its results
        """
        self._begin(partial(draw_figures, folder))

    def executor(self, tasks: Iterable[Task]) -> Iterator[Outcome]:
        """Process tests, numbers only; see `labpipe.campaign.executors.Executor`."""
        for task in tasks:
            only_numbers = replace(task, figures=False)
            try:
                yield self.call(partial(attempt, only_numbers), about=task.sheet)
            except ProcessingError as error:
                yield Outcome(task.sheet, task.goal, "failed", "process_died", str(error))

    def leave(self) -> None:
        """Wait until it has done what was begun, and end it."""
        self._worker.leave()

    def _begin(self, work: Callable[[], object]) -> None:
        if self._worker.is_at_work:
            self._worker.finish()  # figures, or imports: what became of them shows elsewhere
        self._worker.begin(work)


def _do(work: Callable[[], object]) -> object:
    return work()


def _import_all() -> None:
    for name in _NEEDED:
        import_module(name)
