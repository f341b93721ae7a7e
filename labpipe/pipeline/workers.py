"""Calls in processes of their own: one that ends its process costs that call and no other."""

from __future__ import annotations

import multiprocessing
import pickle
import signal
from collections.abc import Callable, Generator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Generic, TypeVar

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
