"""Many tests, one after the other or several at a time, each call safe from the others."""

from __future__ import annotations

import multiprocessing
import pickle
import signal
import traceback
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Generic, TypeVar

from labpipe.errors import LabpipeError, ProcessingError, complaint, refusal
from labpipe.process.run import Processed, goal_of, name_of, process_test
from labpipe.process.targets import refuse_repeated

T = TypeVar("T")

# Spawned: a copy of a process that has threads may wait for locks that nobody holds.
_SPAWN = multiprocessing.get_context("spawn")


@dataclass(frozen=True, slots=True)
class Died:
    """What became of a call whose process ended before the call did.

    Parameters
    ----------
    exit_code : of the process; of one that a signal ended, minus its number
    """

    exit_code: int

    @property
    def how(self) -> str:
        """The signal, or the exit code, in words."""
        if self.exit_code >= 0:
            return f"with exit code {self.exit_code}"
        with suppress(ValueError):
            return f"by the signal {signal.Signals(-self.exit_code).name}"
        return f"by the signal {-self.exit_code}"


@dataclass(frozen=True, slots=True)
class _Raised:
    error: Exception


def in_processes(calls: Sequence[Callable[[], T]], *, jobs: int) -> Generator[T | Died, None, None]:
    """Call functions, several at a time, each in a process that does one after the other.

    Parameters
    ----------
    calls : what can be pickled, such as partials of functions at the top of a module
    jobs : processes at the most

    Yields
    ------
    What they gave, in their order; `Died` where the process was killed, crashed or ran out of
    memory. Another process takes its place then.

    Raises
    ------
    Exception
        What a call raised.

    Notes
    -----
    When the caller goes away, as with an interrupt, calls that were begun are waited for.
    """
    crew: list[_Worker[T]] = [_Worker() for _ in range(min(jobs, len(calls)))]
    left = iter(enumerate(calls))
    done: dict[int, T | Died | _Raised] = {}
    try:
        for worker in crew:
            worker.begin(*next(left))
        for number in range(len(calls)):
            while number not in done:
                for worker in _ready(crew):
                    done[worker.number] = worker.finish()
                    worker.begin(*next(left, (-1, None)))
            yield _given(done.pop(number))
    finally:
        for worker in crew:
            worker.leave()


class _Worker(Generic[T]):
    """A process, started when it is first needed and whenever the last one died."""

    def __init__(self) -> None:
        self.number = -1
        self._process: BaseProcess | None = None

    def begin(self, number: int, call: Callable[[], T] | None) -> None:
        """Hand it a call and the number of the call; none, and it has nothing to do."""
        self.number = number
        if call is None:
            return
        if self._process is None:
            self._pipe, theirs = _SPAWN.Pipe()
            process = _SPAWN.Process(target=_serve, args=(theirs,))
            process.start()
            self._process = process
            theirs.close()  # or its end would not be seen here
        with suppress(OSError):  # it died between two calls: `finish` will tell
            self._pipe.send_bytes(pickle.dumps(call))

    @property
    def is_at_work(self) -> bool:
        """Whether it has a call."""
        return self.number >= 0

    @property
    def pipe(self) -> Connection:
        """Where an outcome comes from, or the end of the process shows."""
        return self._pipe

    def finish(self) -> T | Died | _Raised:
        """Take the outcome, once there is one."""
        with suppress(EOFError, OSError):
            outcome: T | _Raised = pickle.loads(self._pipe.recv_bytes())
            return outcome
        process, self._process = self._process, None
        self._pipe.close()
        if process is None:
            return Died(0)
        process.join()
        return Died(process.exitcode or 0)

    def leave(self) -> None:
        """Wait until it has done what it was handed."""
        if self._process is not None:
            self._pipe.close()
            self._process.join()


def _ready(crew: Sequence[_Worker[T]]) -> list[_Worker[T]]:
    """Workers with an outcome, once there is one at least."""
    pipes = {id(worker.pipe): worker for worker in crew if worker.is_at_work}
    return [pipes[id(pipe)] for pipe in wait([worker.pipe for worker in pipes.values()])]


def _given(outcome: T | Died | _Raised) -> T | Died:
    if isinstance(outcome, _Raised):
        raise outcome.error
    return outcome


def _serve(pipe: Connection) -> None:
    """Do what comes through a pipe until the other end is closed.

    Interrupts are left to the process that a person started: it says so, and what was begun is
    brought to its end.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with suppress(EOFError, OSError):
        while True:
            pipe.send_bytes(_outcome(pipe.recv_bytes()))


def _outcome(call: bytes) -> bytes:
    try:
        return pickle.dumps(pickle.loads(call)())
    except Exception as error:  # noqa: BLE001  it is raised again in the process that asked
        return pickle.dumps(_Raised(error))


Say = Callable[[str], None]


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
    chosen = _process if len(tests) == 1 else _process_one_of_many
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
            yield Refused(test, _ended(test, done)) if isinstance(done, Died) else done


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
            raise ProcessingError(_ended("labpipe", outcome))
        given.append(outcome)
    return given


def _say_nothing(_: str) -> None:
    pass


def _process(
    test: Path,
    is_drawn: bool,
    say: Say = _say_nothing,
    *,
    out: Path | None,
    png: bool,
    follow_links: bool,
) -> Processed | Refused:
    try:
        done = process_test(
            test, out=out, figures=is_drawn, png=png, follow_links=follow_links, say=say
        )
    except LabpipeError as error:
        return Refused(test, str(error))
    except MemoryError:
        return Refused(test, _too_large(test))
    except OSError as error:
        return Refused(test, f"{test}: {refusal(error)}")
    result = replace(done.result, recordings={}, aligned=None, curve=None, shape=None, bending=None)
    return replace(done, result=result)


def _process_one_of_many(
    test: Path,
    is_drawn: bool,
    say: Say = _say_nothing,
    *,
    out: Path | None,
    png: bool,
    follow_links: bool,
) -> Processed | Refused:
    """Process a test; a fault of labpipe does not stop the others, but shows where it is alone."""
    try:
        return _process(test, is_drawn, say, out=out, png=png, follow_links=follow_links)
    except Exception as error:  # noqa: BLE001
        return Refused(test, _own_fault(test, error))


def _ended(test: object, died: Died) -> str:
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
