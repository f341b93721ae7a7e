"""Many tests one after the other, or several at a time."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TypeVar

from labpipe.errors import LabpipeError
from labpipe.pipeline.process import Processed, goal_of, name_of, process_test
from labpipe.pipeline.targets import refuse_repeated

Say = Callable[[str], None]
T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Refused:
    """A test that could not be processed.

    Parameters
    ----------
    test : its test.yaml or result.h5
    reason : the message for the user
    """

    test: Path
    reason: str


def process_tests(
    tests: Sequence[Path],
    *,
    out: Path | None = None,
    figures: Callable[[Path], bool] = lambda _: True,
    jobs: int = 1,
    begin: Callable[[Path], Say] = lambda _: _say_nothing,
) -> Iterator[Processed | Refused]:
    """Process tests in order; a bad one does not stop the others.

    Parameters
    ----------
    tests : test.yaml or result.h5 files
    out : see `process_test`
    figures : whether to draw those of a test
    jobs : how many at a time, each in a process of its own
    begin : told each test, and gives what is told its stages; of several at a time, none but that
        it is waited for

    Yields
    ------
    Each test without its recordings and stages, which are in its result.h5: hundreds of tests
    would not go into memory.

    Raises
    ------
    UsageError
        If results of two tests would go to one folder; nothing is processed then.
    """
    _refuse_one_goal(tests, out)
    if jobs == 1:
        for test in tests:
            yield _process(test, out, figures(test), begin(test))
        return
    with _workers(min(jobs, len(tests))) as pool:
        waiting = [pool.submit(_process, test, out, figures(test)) for test in tests]
        try:
            for test, each in zip(tests, waiting, strict=True):
                begin(test)("wait")
                yield each.result()
        finally:
            pool.shutdown(cancel_futures=True)


def _refuse_one_goal(tests: Sequence[Path], out: Path | None) -> None:
    """Refuse tests of which one would overwrite the results of another."""
    goals = []
    for test in tests:
        with suppress(LabpipeError):  # one that cannot be read is refused when its turn comes
            goals.append((str(goal_of(test, out, partial(name_of, test)).absolute()), test))
    refuse_repeated(goals, "folder of results")


def run_jobs(calls: Sequence[Callable[[], T]], *, jobs: int) -> list[T]:
    """Call functions, several at a time in processes of their own.

    Parameters
    ----------
    calls : partials of functions at the top of a module, with their arguments
    jobs : how many at a time

    Returns
    -------
    What they gave, in their order.
    """
    if jobs == 1:
        return [call() for call in calls]
    with _workers(min(jobs, len(calls))) as pool:
        waiting = [pool.submit(call) for call in calls]
        return [each.result() for each in waiting]


def _workers(jobs: int) -> ProcessPoolExecutor:
    # Spawned: a copy of a process that has threads may wait for locks that nobody holds.
    context = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(max(jobs, 1), mp_context=context, initializer=_leave_interrupts)


def _leave_interrupts() -> None:
    """Only the process that was started by hand says so; tests that were begun are ended."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _say_nothing(_: str) -> None:
    pass


def _process(
    test: Path, out: Path | None, is_drawn: bool, say: Say = _say_nothing
) -> Processed | Refused:
    try:
        done = process_test(test, out=out, figures=is_drawn, say=say)
    except LabpipeError as error:
        return Refused(test, str(error))
    result = replace(done.result, recordings={}, aligned=None, curve=None, shape=None, bending=None)
    return replace(done, result=result)
