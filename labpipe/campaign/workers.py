"""Processes that do one call after the other; one that dies costs its call alone."""

from __future__ import annotations

import json
import os
import pickle
import queue
import signal
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Generator, Iterable, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass
from functools import partial
from itertools import islice
from pathlib import Path
from typing import IO, Any, Generic, NamedTuple, NoReturn, TypeVar

from labpipe.errors import error_text

A = TypeVar("A")
T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class ProcessDied:
    """What became of a call whose process ended before the call did.

    Parameters
    ----------
    exit_code : of the process; of one that a signal ended, minus its number
    limit : s; at which the process was ended because the call had not come to its end; else None
    """

    exit_code: int
    limit: float | None = None

    @property
    def how(self) -> str:
        """The signal, or the exit code, in words."""
        if self.exit_code >= 0:
            return f"with exit code {self.exit_code}"
        with suppress(ValueError):
            return f"by the signal {signal.Signals(-self.exit_code).name}"
        return f"by the signal {-self.exit_code}"


def why(what: object, died: ProcessDied) -> tuple[str, str]:
    """Word that a process died.

    Parameters
    ----------
    what : it was at, such as the file of a test
    died : how

    Returns
    -------
    code : see `labpipe.errors.CODES`
    reason : the message for the user
    """
    if died.limit is not None:
        expected = f"an end within {died.limit / 60.0:g} minutes"
        found = "none, so that it was ended"
        remedy = "Look whether the export is damaged; else choose a longer --limit."
        return "time_limit", error_text(what, "", expected=expected, found=found, remedy=remedy)
    reason = error_text(
        what,
        "",
        expected="a process that comes to its end",
        found=f"that it was ended {died.how}",
        remedy="Often the memory was used up: close other programs, or choose fewer --jobs.",
    )
    return "process_died", reason


@dataclass(frozen=True, slots=True)
class CallRaised:
    """What became of a call that raised.

    Parameters
    ----------
    error : the exception
    """

    error: Exception


class WorkerPool(Generic[A, T]):
    """Processes for many calls of one function.

    Parameters
    ----------
    work : what can be pickled, such as a function at the top of a module
    jobs : processes at the most; each is started when it is first needed
    limit : s, after which a call is given up and its process ended; None for no limit

    Notes
    -----
    They are started anew, and not copied from this process: a copy of one that has threads may wait
    for locks that nobody holds. Nor are they children in the way of `multiprocessing`: a worker of
    a cluster may not have such. Where this process is killed, they end at once.
    """

    def __init__(self, work: Callable[[A], T], *, jobs: int, limit: float | None = None) -> None:
        self._events: queue.SimpleQueue[_Event] = queue.SimpleQueue()
        start = partial(_Worker[A], work, self._events, limit)
        self._workers = [start() for _ in range(jobs)]

    def as_they_end(
        self, given: Iterable[A]
    ) -> Generator[tuple[A, T | ProcessDied | CallRaised], None, None]:
        """Call the function on many things, several at a time.

        Parameters
        ----------
        given : what can be pickled; taken one by one, as processes become free

        Yields
        ------
        What was given and what the call gave, in the order in which calls end; `ProcessDied` where
        the process was killed, crashed, ran out of memory or took too long. Another process takes
        its place then.
        """
        left = iter(given)
        for worker, each in zip(self._workers, left, strict=False):
            worker.begin(each)
        while busy := [worker for worker in self._workers if worker.is_at_work]:
            for worker, outcome in self._ended(busy):
                ended = worker.given.pop(), outcome
                for each in islice(left, 1):
                    worker.begin(each)
                yield ended

    def _ended(
        self, busy: Sequence[_Worker[A]]
    ) -> list[tuple[_Worker[A], T | ProcessDied | CallRaised]]:
        """The next worker that is done, or none where only the time of one was over."""
        wait = min(worker.left for worker in busy)
        try:
            event = self._events.get(timeout=min(max(wait, 0.0), threading.TIMEOUT_MAX))
        except queue.Empty:
            for worker in busy:
                if worker.left <= 0.0:
                    worker.end()
            return []
        for worker in busy:
            if worker.process is event.process:
                return [(worker, worker.died() if event.said is None else _outcome_in(event.said))]
        return []  # one that had nothing to do died

    def leave(self) -> None:
        """Wait until what was begun is done, and end the processes."""
        for worker in self._workers:
            worker.dismiss()
        for worker in self._workers:
            worker.leave()


def as_they_end(
    work: Callable[[A], T], given: Iterable[A], *, jobs: int, limit: float | None = None
) -> Generator[tuple[A, T | ProcessDied | CallRaised], None, None]:
    """Call a function on many things in a `WorkerPool` that is there for them alone.

    Parameters
    ----------
    work, jobs, limit : see `WorkerPool`
    given : see `WorkerPool.as_they_end`

    Yields
    ------
    As `WorkerPool.as_they_end`.

    Notes
    -----
    When the caller goes away, as with an interrupt, calls that were begun are waited for.
    """
    crew = WorkerPool(work, jobs=jobs, limit=limit)
    try:
        yield from crew.as_they_end(given)
    finally:
        crew.leave()


def in_processes(
    calls: Sequence[Callable[[], T]], *, jobs: int, limit: float | None = None
) -> Generator[T | ProcessDied, None, None]:
    """Call functions, several at a time, as `as_they_end` does.

    Parameters
    ----------
    calls : what can be pickled, such as partials of functions at the top of a module
    jobs, limit : see `WorkerPool`

    Yields
    ------
    What they gave, in their order; `ProcessDied` where the process ended first.

    Raises
    ------
    Exception
        What a call raised.
    """
    done: dict[int, T | ProcessDied | CallRaised] = {}
    with closing(as_they_end(_call, enumerate(calls), jobs=jobs, limit=limit)) as ended:
        for number in range(len(calls)):
            while number not in done:
                (which, _), outcome = next(ended)
                done[which] = outcome
            yield _given(done.pop(number))


def _call(numbered: tuple[int, Callable[[], T]]) -> T:
    return numbered[1]()


def _given(outcome: T | ProcessDied | CallRaised) -> T | ProcessDied:
    if isinstance(outcome, CallRaised):
        raise outcome.error
    return outcome


def _outcome_in(said: bytes) -> Any:
    return pickle.loads(said)


class _Event(NamedTuple):
    """What came from a process; None where it ended."""

    process: subprocess.Popen[bytes]
    said: bytes | None


_START = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1]);"
    " from labpipe.campaign.workers import serve; serve()"
)


class _Worker(Generic[A]):
    """A process, started when it is first needed and whenever the last one died."""

    def __init__(
        self, work: Callable[[A], Any], events: queue.SimpleQueue[_Event], limit: float | None
    ) -> None:
        self._work, self._events, self._limit = work, events, limit
        self._until = float("inf")
        self._is_late = False
        self.given: list[A] = []
        self.process: subprocess.Popen[bytes] | None = None

    @property
    def is_at_work(self) -> bool:
        """Whether it has something to do."""
        return bool(self.given)

    @property
    def left(self) -> float:
        """Time that it has for its call, s; no end where it has been told to end."""
        return self._until - time.monotonic()

    def begin(self, given: A) -> None:
        """Hand it something to do."""
        call = pickle.dumps((self._work, given))
        self.given.append(given)
        self._is_late = False
        self._until = float("inf") if self._limit is None else time.monotonic() + self._limit
        if self.process is not None and self.process.poll() is not None:
            self.died()  # between two calls: none of them is to blame
        if self.process is None:
            self.process = _started()
            listen = partial(_listen, self.process, self._events)
            threading.Thread(target=listen, daemon=True).start()
        _send(self.process, call)

    def end(self) -> None:
        """End what takes too long."""
        self._until, self._is_late = float("inf"), True
        if self.process is not None:
            _kill(self.process)

    def died(self) -> ProcessDied:
        """Take its end, once there is one."""
        process, self.process = self.process, None
        if process is None:
            return ProcessDied(0)
        for pipe in (process.stdin, process.stdout):
            if pipe is not None:
                with suppress(OSError):
                    pipe.close()
        return ProcessDied(process.wait(), self._limit if self._is_late else None)

    def dismiss(self) -> None:
        """Say that nothing comes after what it was handed."""
        if self.process is not None:
            _send(self.process, b"")

    def leave(self) -> None:
        """Wait until it has done that."""
        if self.process is not None:
            try:
                self.process.wait(None if self._limit is None else max(self.left, 0.1))
            except subprocess.TimeoutExpired:
                _kill(self.process)
            self.died()
        self.given.clear()


def _started() -> subprocess.Popen[bytes]:
    # The matrices of a test are small: more than one thread of BLAS only waits for the others.
    return subprocess.Popen(
        [sys.executable, "-c", _START, json.dumps(sys.path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env={"OPENBLAS_NUM_THREADS": "1", **os.environ},
        start_new_session=True,  # what it started itself ends with it
    )


def _kill(process: subprocess.Popen[bytes]) -> None:
    with suppress(OSError):
        if sys.platform == "win32":
            process.kill()
        else:
            os.killpg(process.pid, signal.SIGKILL)


_LENGTH = struct.Struct("<Q")


def _send(process: subprocess.Popen[bytes], message: bytes) -> None:
    if process.stdin is not None:
        with suppress(OSError, ValueError):  # it died meanwhile: the listener tells
            process.stdin.write(_LENGTH.pack(len(message)) + message)
            process.stdin.flush()


def _received(stream: IO[bytes]) -> bytes | None:
    """The next message; None where the other end is closed."""
    with suppress(OSError, ValueError):
        head = stream.read(_LENGTH.size)
        if len(head) == _LENGTH.size:
            (length,) = _LENGTH.unpack(head)
            message = stream.read(length)
            return message if len(message) == length else None
    return None


def _listen(process: subprocess.Popen[bytes], events: queue.SimpleQueue[_Event]) -> None:
    while process.stdout is not None:
        said = _received(process.stdout)
        events.put(_Event(process, said))
        if said is None:
            return


_FIRST_TO_GO = "500"  # of -1000 to 1000


def serve() -> NoReturn:
    """Do what comes through standard input, in a process of a `WorkerPool`.

    Interrupts are left to the process that a person started: it says so, and what was begun is
    brought to its end. Where that process is gone, this one goes, too. What libraries print goes to
    standard error, and they have nothing to read.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with suppress(OSError):  # where the memory is used up, Linux takes this process and no other
        Path("/proc/self/oom_score_adj").write_text(_FIRST_TO_GO, encoding="ascii")
    asked, out = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.dup2(2, 1)
    calls: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    threading.Thread(target=_hear, args=(asked, calls), daemon=True).start()
    status = 0
    try:
        while call := calls.get():
            answer = _outcome(call)
            out.write(_LENGTH.pack(len(answer)) + answer)
            out.flush()
    except SystemExit as error:
        status = error.code if isinstance(error.code, int) else 1
    os._exit(status)


def _hear(asked: IO[bytes], calls: queue.SimpleQueue[bytes]) -> None:
    while (call := _received(asked)) is not None:
        calls.put(call)
    os._exit(1)  # nobody waits for the outcome; files are all old or all new


def _outcome(call: bytes) -> bytes:
    try:
        work, given = pickle.loads(call)
        return pickle.dumps(work(given))
    except Exception as error:  # noqa: BLE001  it is handed to the process that asked
        return pickle.dumps(CallRaised(error))
