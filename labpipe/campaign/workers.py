"""Processes that do one call after the other; one that dies costs its call alone."""

from __future__ import annotations

import multiprocessing
import pickle
import signal
from collections.abc import Callable, Generator, Iterable, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass
from itertools import islice
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Generic, TypeVar

A = TypeVar("A")
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
class Raised:
    """What became of a call that raised.

    Parameters
    ----------
    error : the exception
    """

    error: Exception


def as_they_end(
    work: Callable[[A], T], given: Iterable[A], *, jobs: int
) -> Generator[tuple[A, T | Died | Raised], None, None]:
    """Call a function on many things, several at a time, each in a process for many calls.

    Parameters
    ----------
    work : what can be pickled, such as a function at the top of a module
    given : what can be pickled; taken one by one as processes become free
    jobs : processes at the most

    Yields
    ------
    What was given and what the call gave, in the order in which calls end; `Died` where the process
    was killed, crashed or ran out of memory. Another process takes its place then.

    Notes
    -----
    When the caller goes away, as with an interrupt, calls that were begun are waited for.
    """
    left = iter(given)
    crew: list[_Worker[A, T]] = []
    try:
        for each in islice(left, jobs):
            crew.append(_Worker(work))
            crew[-1].begin(each)
        while busy := [worker for worker in crew if worker.is_at_work]:
            for worker in _ready(busy):
                ended = worker.finish()
                for each in islice(left, 1):
                    worker.begin(each)
                yield ended
    finally:
        for worker in crew:
            worker.leave()


def in_processes(calls: Sequence[Callable[[], T]], *, jobs: int) -> Generator[T | Died, None, None]:
    """Call functions, several at a time, as `as_they_end` does.

    Parameters
    ----------
    calls : what can be pickled, such as partials of functions at the top of a module
    jobs : processes at the most

    Yields
    ------
    What they gave, in their order; `Died` where the process ended first.

    Raises
    ------
    Exception
        What a call raised.
    """
    done: dict[int, T | Died | Raised] = {}
    with closing(as_they_end(_call, enumerate(calls), jobs=jobs)) as ended:
        for number in range(len(calls)):
            while number not in done:
                (which, _), outcome = next(ended)
                done[which] = outcome
            yield _given(done.pop(number))


def _call(numbered: tuple[int, Callable[[], T]]) -> T:
    return numbered[1]()


class _Worker(Generic[A, T]):
    """A process, started when it is first needed and whenever the last one died."""

    def __init__(self, work: Callable[[A], T]) -> None:
        self._work = work
        self._given: list[A] = []
        self._process: BaseProcess | None = None

    def begin(self, given: A) -> None:
        """Hand it something to do."""
        self._given.append(given)
        if self._process is not None and not self._process.is_alive():
            self._bury(self._process)  # between two calls: none of them is to blame
        if self._process is None:
            self._pipe, theirs = _SPAWN.Pipe()
            process = _SPAWN.Process(target=_serve, args=(theirs,))
            process.start()
            self._process = process
            theirs.close()  # or its end would not be seen here
        with suppress(OSError):  # it died meanwhile: `finish` will tell
            self._pipe.send_bytes(pickle.dumps((self._work, given)))

    @property
    def is_at_work(self) -> bool:
        """Whether it has something to do."""
        return bool(self._given)

    @property
    def pipe(self) -> Connection:
        """Where an outcome comes from, or the end of the process shows."""
        return self._pipe

    def finish(self) -> tuple[A, T | Died | Raised]:
        """Take what it was given and the outcome, once there is one."""
        return self._given.pop(), self._outcome()

    def _outcome(self) -> T | Died | Raised:
        with suppress(EOFError, OSError):
            outcome: T | Raised = pickle.loads(self._pipe.recv_bytes())
            return outcome
        return Died(0) if self._process is None else self._bury(self._process)

    def _bury(self, process: BaseProcess) -> Died:
        self._process = None
        self._pipe.close()
        process.join()
        return Died(process.exitcode or 0)

    def leave(self) -> None:
        """Wait until it has done what it was handed."""
        if self._process is not None:
            self._pipe.close()
            self._process.join()


def _ready(busy: Sequence[_Worker[A, T]]) -> list[_Worker[A, T]]:
    """Workers with an outcome, once there is one at least."""
    pipes = {id(worker.pipe): worker for worker in busy}
    return [pipes[id(pipe)] for pipe in wait([worker.pipe for worker in busy])]


def _given(outcome: T | Died | Raised) -> T | Died:
    if isinstance(outcome, Raised):
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
        work, given = pickle.loads(call)
        return pickle.dumps(work(given))
    except Exception as error:  # noqa: BLE001  it is handed to the process that asked
        return pickle.dumps(Raised(error))
