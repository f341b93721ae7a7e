"""Many tests, one after the other or several at a time, each call safe from the others."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TypeVar

from labpipe.campaign.workers import Died, in_processes
from labpipe.errors import (
    OUT_OF_MEMORY,
    OWN_FAULT,
    PROCESS_DIED,
    SYSTEM_REFUSED,
    LabpipeError,
    ProcessingError,
    complaint,
    refusal,
)
from labpipe.process.run import Processed, goal_of, name_of, process_test
from labpipe.process.targets import refuse_repeated

T = TypeVar("T")
Say = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Refused:
    """A test that could not be processed.

    Parameters
    ----------
    test : its test.yaml or result.h5
    reason : the message for the user
    code : the same in one word, see `labpipe.errors`
    """

    test: Path
    reason: str
    code: str


def process_tests(
    tests: Sequence[Path],
    *,
    out: Path | None = None,
    figures: Callable[[Path], bool] = lambda _: True,
    png: bool = False,
    follow_links: bool = False,
    jobs: int = 1,
    begin: Callable[[Path], Say] = lambda _: _say_nothing,
) -> Iterator[Processed | Refused]:
    """Process tests in order; a bad one does not stop the others.

    Parameters
    ----------
    tests : test.yaml or result.h5 files
    out, png, follow_links : see `process_test`
    figures : whether to draw those of a test
    jobs : how many at a time, each in a process of its own
    begin : called with each test as it begins, gives what is called with its stages; of several at
        a time, with the stage that they are waited for alone

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
    chosen = _process if len(tests) == 1 else process_safely
    process = partial(chosen, out=out, png=png, follow_links=follow_links)
    if jobs == 1:
        for test in tests:
            yield process(test, figures(test), begin(test))
        return
    calls = [partial(process, test, figures(test)) for test in tests]
    with closing(in_processes(calls, jobs=jobs)) as outcomes:
        for test in tests:
            begin(test)("wait")
            done = next(outcomes)
            yield Refused(test, ended(test, done), PROCESS_DIED) if isinstance(done, Died) else done


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

    Raises
    ------
    ProcessingError
        If a process ended before its call did.
    """
    if jobs == 1:
        return [call() for call in calls]
    given: list[T] = []
    for outcome in in_processes(calls, jobs=jobs):
        if isinstance(outcome, Died):
            raise ProcessingError(ended("labpipe", outcome))
        given.append(outcome)
    return given


def _say_nothing(_: str) -> None:
    pass


def _process(
    test: Path,
    is_drawn: bool,
    say: Say = _say_nothing,
    *,
    out: Path | None = None,
    goal: Path | None = None,
    png: bool,
    follow_links: bool,
) -> Processed | Refused:
    try:
        done = process_test(
            test,
            out=out,
            goal=goal,
            figures=is_drawn,
            png=png,
            follow_links=follow_links,
            say=say,
        )
    except LabpipeError as error:
        return Refused(test, str(error), error.code)
    except MemoryError:
        return Refused(test, _too_large(test), OUT_OF_MEMORY)
    except OSError as error:
        return Refused(test, f"{test}: {refusal(error)}", SYSTEM_REFUSED)
    result = replace(done.result, recordings={}, aligned=None, curve=None, shape=None, bending=None)
    return replace(done, result=result)


def process_safely(
    test: Path,
    is_drawn: bool,
    say: Say = _say_nothing,
    *,
    out: Path | None = None,
    goal: Path | None = None,
    png: bool,
    follow_links: bool,
) -> Processed | Refused:
    """Process a test; a fault of labpipe does not stop the others, but shows where it is alone."""
    try:
        return _process(test, is_drawn, say, out=out, goal=goal, png=png, follow_links=follow_links)
    except Exception as error:  # noqa: BLE001
        return Refused(test, _own_fault(test, error), OWN_FAULT)


def ended(test: object, died: Died) -> str:
    """Word that the process of a test died.

    Parameters
    ----------
    test : its file
    died : how
    """
    return complaint(
        test,
        "",
        expected="a process that comes to its end",
        found=f"that it was ended {died.how}",
        remedy="Often the memory was used up: close other programs, or choose fewer --jobs.",
    )


def _too_large(test: Path) -> str:
    return complaint(
        test,
        "",
        expected="a test that goes into the memory",
        found="that the memory was used up",
        remedy="Close other programs, choose fewer --jobs, or leave the test out.",
    )


def _own_fault(test: Path, error: Exception) -> str:
    """Word an error that is none of the user's, with the line of labpipe that it came from."""
    frames = traceback.extract_tb(error.__traceback__)
    own = [frame for frame in frames if "labpipe" in Path(frame.filename).parts]
    at = own[-1] if own else frames[-1]
    said = " ".join(str(error).split())
    found = f"a fault of labpipe itself ({type(error).__name__}: {said})"
    place = f"{Path(at.filename).name}, line {at.lineno}"
    remedy = f"Report it ({place}) with the exports of the test; processed alone, it says more."
    return complaint(test, "", expected="to get through", found=found, remedy=remedy)
