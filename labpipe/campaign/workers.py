"""Pools of processes for calls; if a process dies, only its call fails."""

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
    """Outcome of a call whose process ended before the call.

    Parameters
    ----------
    exit_code : of the process; minus the number of a signal
    limit : s, time limit if it was exceeded; else None
    """

    exit_code: int
    limit: float | None = None

    @property
    def how(self) -> str:
        """Text on the signal or exit code."""
        if self.exit_code >= 0:
            return f"with exit code {self.exit_code}"
        with suppress(ValueError):
            return f"by the signal {signal.Signals(-self.exit_code).name}"
        return f"by the signal {-self.exit_code}"


def describe_death(what: object, died: ProcessDied) -> tuple[str, str]:
    """Describe the death of a process.

    Parameters
    ----------
    what : subject of the call, such as the file of a test
    died : the outcome

    Returns
    -------
    code : see `labpipe.errors.CODES`
    reason : the message for the user
    """
    if died.limit is not None:
        expected = f"an end within {died.limit / 60.0:g} minutes"
        state = "no end; the process was ended"
        remedy = "Check the export for damage, or choose a longer --limit."
        return "time_limit", error_text(what, "", expected=expected, found=state, remedy=remedy)
    reason = error_text(
        what,
        "",
        expected="a process that completes",
        found=f"that it was ended {died.how}",
        remedy="Often memory runs out: close other programs, or choose fewer --jobs.",
    )
    return "process_died", reason


@dataclass(frozen=True, slots=True)
class CallRaised:
    """Outcome of a call that raised an exception.

    Parameters
    ----------
    error : the exception
    """

    error: Exception


class WorkerPool(Generic[A, T]):
    """Pool of processes for calls of one function.

    Parameters
    ----------
    work : can be pickled, such as a module-level function
    jobs : maximum number of processes, which are started on first use
    limit : s, time limit of a call, after which its process is ended; None for no limit

    Notes
    -----
    Processes are not forked, since forks of processes with threads may deadlock, and do not use
    `multiprocessing`, which workers of a cluster must not use. If this process is killed, they end
    at once.
    """

    def __init__(self, work: Callable[[A], T], *, jobs: int, limit: float | None = None) -> None:
        self._events: queue.SimpleQueue[_Event] = queue.SimpleQueue()
        start = partial(_Worker[A], work, self._events, limit)
        self._workers = [start() for _ in range(jobs)]

    def as_completed(
        self, arguments: Iterable[A]
    ) -> Generator[tuple[A, T | ProcessDied | CallRaised], None, None]:
        """Call the function on many arguments in parallel.

        Parameters
        ----------
        arguments : can be pickled; taken when processes become free

        Yields
        ------
        Argument and result in the order of completion; `ProcessDied` if the process was killed,
        crashed, ran out of memory or took too long, and is replaced.
        """
        left = iter(arguments)
        for worker, argument in zip(self._workers, left, strict=False):
            worker.begin(argument)
        while busy := [worker for worker in self._workers if worker.is_busy]:
            for worker, outcome in self._ended(busy):
                ended = worker.arguments.pop(), outcome
                for argument in islice(left, 1):
                    worker.begin(argument)
                yield ended

    def _ended(
        self, busy: Sequence[_Worker[A]]
    ) -> list[tuple[_Worker[A], T | ProcessDied | CallRaised]]:
        """Return the next completed worker, or none if a time limit was exceeded."""
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
                return [
                    (
                        worker,
                        worker.died() if event.message is None else pickle.loads(event.message),
                    )
                ]
        return []  # an idle worker died

    def close(self) -> None:
        """Wait for started calls, and end the processes."""
        for worker in self._workers:
            worker.finish()
        for worker in self._workers:
            worker.close()


def as_completed(
    work: Callable[[A], T], arguments: Iterable[A], *, jobs: int, limit: float | None = None
) -> Generator[tuple[A, T | ProcessDied | CallRaised], None, None]:
    """Call a function on many arguments in a temporary `WorkerPool`.

    Parameters
    ----------
    work, jobs, limit : see `WorkerPool`
    arguments : see `WorkerPool.as_completed`

    Yields
    ------
    As `WorkerPool.as_completed`.

    Notes
    -----
    On an interrupt, started calls are completed.
    """
    pool = WorkerPool(work, jobs=jobs, limit=limit)
    try:
        yield from pool.as_completed(arguments)
    finally:
        pool.close()


def in_processes(
    calls: Sequence[Callable[[], T]], *, jobs: int, limit: float | None = None
) -> Generator[T | ProcessDied, None, None]:
    """Call functions in parallel processes, with results in order.

    Parameters
    ----------
    calls : can be pickled, such as partials of module-level functions
    jobs, limit : see `WorkerPool`

    Yields
    ------
    Their results in order; `ProcessDied` if the process ended first.

    Raises
    ------
    Exception
        If a call raises it.
    """
    done: dict[int, T | ProcessDied | CallRaised] = {}
    with closing(as_completed(_call, enumerate(calls), jobs=jobs, limit=limit)) as ended:
        for number in range(len(calls)):
            while number not in done:
                (which, _), outcome = next(ended)
                done[which] = outcome
            outcome = done.pop(number)
            if isinstance(outcome, CallRaised):
                raise outcome.error
            yield outcome


def _call(numbered: tuple[int, Callable[[], T]]) -> T:
    return numbered[1]()


class _Event(NamedTuple):
    """A message from a process; None at its end."""

    process: subprocess.Popen[bytes]
    message: bytes | None


_START = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1]);"
    " from labpipe.campaign.workers import serve; serve()"
)


class _Worker(Generic[A]):
    """A process, started on first use and restarted after its death."""

    def __init__(
        self, work: Callable[[A], Any], events: queue.SimpleQueue[_Event], limit: float | None
    ) -> None:
        self._work, self._events, self._limit = work, events, limit
        self._until = float("inf")
        self._is_late = False
        self.arguments: list[A] = []
        self.process: subprocess.Popen[bytes] | None = None

    @property
    def is_busy(self) -> bool:
        """Whether it has a call."""
        return bool(self.arguments)

    @property
    def left(self) -> float:
        """Remaining time for its call, s; infinite once it is being ended."""
        return self._until - time.monotonic()

    def begin(self, argument: A) -> None:
        """Send it a call."""
        call = pickle.dumps((self._work, argument))
        self.arguments.append(argument)
        self._is_late = False
        self._until = float("inf") if self._limit is None else time.monotonic() + self._limit
        if self.process is not None and self.process.poll() is not None:
            self.died()  # between calls, so that none of them failed
        if self.process is None:
            self.process = _start_process()
            listen = partial(_read_answers, self.process, self._events)
            threading.Thread(target=listen, daemon=True).start()
        _send(self.process, call)

    def end(self) -> None:
        """Kill the process after its time limit."""
        self._until, self._is_late = float("inf"), True
        if self.process is not None:
            _kill(self.process)

    def died(self) -> ProcessDied:
        """Collect its exit code."""
        process, self.process = self.process, None
        if process is None:
            return ProcessDied(0)
        for pipe in (process.stdin, process.stdout):
            if pipe is not None:
                with suppress(OSError):
                    pipe.close()
        return ProcessDied(process.wait(), self._limit if self._is_late else None)

    def finish(self) -> None:
        """Tell the process to end after its call."""
        if self.process is not None:
            _send(self.process, b"")

    def close(self) -> None:
        """Wait for its end."""
        if self.process is not None:
            try:
                self.process.wait(None if self._limit is None else max(self.left, 0.1))
            except subprocess.TimeoutExpired:
                _kill(self.process)
            self.died()
        self.arguments.clear()


def _start_process() -> subprocess.Popen[bytes]:
    # The matrices of a test are too small for more than one BLAS thread.
    return subprocess.Popen(
        [sys.executable, "-c", _START, json.dumps(sys.path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env={"OPENBLAS_NUM_THREADS": "1", **os.environ},
        start_new_session=True,  # its own child processes end with it
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
        with suppress(OSError, ValueError):  # it died: the reading thread reports it
            process.stdin.write(_LENGTH.pack(len(message)) + message)
            process.stdin.flush()


def _read_message(stream: IO[bytes]) -> bytes | None:
    """Read the next message; return None if the other end is closed."""
    with suppress(OSError, ValueError):
        head = stream.read(_LENGTH.size)
        if len(head) == _LENGTH.size:
            (length,) = _LENGTH.unpack(head)
            message = stream.read(length)
            return message if len(message) == length else None
    return None


def _read_answers(process: subprocess.Popen[bytes], events: queue.SimpleQueue[_Event]) -> None:
    while process.stdout is not None:
        message = _read_message(process.stdout)
        events.put(_Event(process, message))
        if message is None:
            return


def serve() -> NoReturn:
    """Run the calls from standard input, in a process of a `WorkerPool`.

    Interrupts are handled by the parent, so that started calls are completed. This process ends
    with its parent. Output of libraries goes to standard error; their input is empty.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with suppress(OSError):  # out of memory, Linux then kills this process first
        Path("/proc/self/oom_score_adj").write_text("500", encoding="ascii")
    requests, out = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.dup2(2, 1)
    calls: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    threading.Thread(target=_read_calls, args=(requests, calls), daemon=True).start()
    status = 0
    try:
        while call := calls.get():
            answer = _outcome(call)
            out.write(_LENGTH.pack(len(answer)) + answer)
            out.flush()
    except SystemExit as error:
        status = error.code if isinstance(error.code, int) else 1
    os._exit(status)


def _read_calls(requests: IO[bytes], calls: queue.SimpleQueue[bytes]) -> None:
    while (call := _read_message(requests)) is not None:
        calls.put(call)
    os._exit(1)  # no receiver for the outcome; files are complete, old or new


def _outcome(call: bytes) -> bytes:
    try:
        work, argument = pickle.loads(call)
        return pickle.dumps(work(argument))
    except Exception as error:  # noqa: BLE001  returned to the caller
        return pickle.dumps(CallRaised(error))
