"""Processes for calls; if a process dies, only its call fails."""

from __future__ import annotations

import json
import os
import pickle
import queue
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager, suppress
from functools import partial
from itertools import islice
from pathlib import Path
from typing import IO, Any, NoReturn, TypeVar, cast

from labpipe.errors import ProcessingError

A = TypeVar("A")
T = TypeVar("T")


class ProcessDied(Exception):  # noqa: N818  an outcome
    """The process of a call ended before the call.

    Parameters
    ----------
    exit_code : of the process; minus the number of a signal
    limit : s, time limit if it was exceeded; else None
    """

    def __init__(self, exit_code: int, limit: float | None = None) -> None:
        super().__init__(exit_code, limit)
        self.exit_code, self.limit = exit_code, limit

    @property
    def how(self) -> str:
        """Return the text on the signal or exit code."""
        if self.exit_code >= 0:
            return f"with exit code {self.exit_code}"
        with suppress(ValueError):
            return f"by the signal {signal.Signals(-self.exit_code).name}"
        return f"by the signal {-self.exit_code}"

    def error(self, about: object) -> ProcessingError:
        """Make the error for the user.

        Parameters
        ----------
        about : subject of the call, such as the file of a test
        """
        if self.limit is not None:
            return ProcessingError.about("campaign.time_limit", about, minutes=self.limit / 60.0)
        return ProcessingError.about("campaign.process_died", about, how=self.how)


class WorkerProcess:
    """A process for calls in sequence, started on first use and restarted after its death.

    Notes
    -----
    The process is not forked, since forks of processes with threads may deadlock, and does not use
    `multiprocessing`, which workers of a cluster must not use. If this process is killed, it ends
    at once.
    """

    def __init__(self) -> None:
        self.process: subprocess.Popen[bytes] | None = None

    def call(self, work: Callable[[], T], *, limit: float | None = None) -> T:
        """Run a call in the process and wait for it.

        Parameters
        ----------
        work : can be pickled, such as a partial of a module-level function
        limit : s, time limit, after which the process is ended; None for no limit

        Raises
        ------
        ProcessDied
            If the process was killed, crashed, ran out of memory or took too long.
        Exception
            If the call raises it.
        """
        call = pickle.dumps(work)
        if self.process is None or self.process.poll() is not None:
            self.close()
            self.process = _start_process()
        is_late = threading.Event()
        timer = threading.Timer(
            min(threading.TIMEOUT_MAX, limit or threading.TIMEOUT_MAX),
            _end_late,
            (self.process, is_late),
        )
        timer.daemon = True
        timer.start()
        answer: bytes | None = None
        with suppress(OSError, EOFError, pickle.UnpicklingError, ValueError):  # it died
            _send(call, cast("IO[bytes]", self.process.stdin))
            answer = pickle.load(cast("IO[bytes]", self.process.stdout))
        timer.cancel()
        timer.join()
        if answer is None:
            raise ProcessDied(self.close(), limit if is_late.is_set() else None)
        result, error = pickle.loads(answer)
        if error is not None:
            raise error
        return cast("T", result)

    def close(self) -> int:
        """End the process, also during a call, and return its exit code; 0 without a process."""
        process, self.process = self.process, None
        if process is None:
            return 0
        if process.returncode is None:
            _kill(process)  # has no effect on the exit code of a process that died
        for pipe in (process.stdin, process.stdout):
            with suppress(OSError):
                cast("IO[bytes]", pipe).close()
        return process.wait()


@contextmanager
def _submitting(
    jobs: int, limit: float | None
) -> Iterator[Callable[[Callable[[], Any]], Future[Any]]]:
    """Yield a function that starts a call in one of several processes.

    At the end, calls that run are completed, and no others are started.
    """
    workers = [WorkerProcess() for _ in range(jobs)]
    idle: queue.SimpleQueue[WorkerProcess] = queue.SimpleQueue()
    for worker in workers:
        idle.put(worker)

    def run(work: Callable[[], Any]) -> Any:
        worker = idle.get()
        try:
            return worker.call(work, limit=limit)
        finally:
            idle.put(worker)

    threads = ThreadPoolExecutor(jobs)
    try:
        yield lambda work: threads.submit(run, work)
    finally:
        try:
            threads.shutdown(cancel_futures=True)
        finally:
            for worker in workers:
                worker.close()


def run_as_completed(
    work: Callable[[A], T], arguments: Iterable[A], *, jobs: int, limit: float | None = None
) -> Generator[tuple[A, Future[T]], None, None]:
    """Call a function on many arguments in parallel processes.

    Parameters
    ----------
    work : can be pickled, such as a module-level function
    arguments : can be pickled; taken when processes become free
    jobs : maximum number of processes, which are started on first use
    limit : s, time limit of a call, after which its process is ended; None for no limit

    Yields
    ------
    Argument and completed future, in the order of completion. Its result raises as
    `WorkerProcess.call`.

    Notes
    -----
    On an interrupt, started calls are completed.
    """
    remaining = iter(arguments)
    running: dict[Future[T], A] = {}
    with _submitting(jobs, limit) as submit:
        for argument in islice(remaining, jobs):
            running[submit(partial(work, argument))] = argument
        while running:
            future = wait(running, return_when=FIRST_COMPLETED).done.pop()
            argument = running.pop(future)
            for following in islice(remaining, 1):
                running[submit(partial(work, following))] = following
            yield argument, future


def run_in_processes(
    calls: Sequence[Callable[[], T]], *, jobs: int, limit: float | None = None
) -> Generator[Future[T], None, None]:
    """Call functions in parallel processes, with results in order.

    Parameters
    ----------
    calls : can be pickled, such as partials of module-level functions
    jobs, limit : see `run_as_completed`

    Yields
    ------
    Their completed futures in order; a result raises as `WorkerProcess.call`.
    """
    with _submitting(jobs, limit) as submit:
        for future in [submit(call) for call in calls]:
            wait([future])
            yield future


def run_calls(calls: Sequence[Callable[[], T]], *, jobs: int) -> list[T]:
    """Call functions in parallel, each in its own process.

    Parameters
    ----------
    calls : partials of module-level functions with their arguments
    jobs : number of calls at the same time

    Returns
    -------
    Their results, in order.

    Raises
    ------
    ProcessingError
        If a process ended before its call.
    """
    if jobs == 1:
        return [call() for call in calls]
    try:
        return [future.result() for future in run_in_processes(calls, jobs=jobs)]
    except ProcessDied as died:
        raise died.error("labpipe") from died


_START = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1]);"
    " from labpipe.campaign.workers import serve; serve()"
)


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


def _end_late(process: subprocess.Popen[bytes], is_late: threading.Event) -> None:
    is_late.set()
    _kill(process)


def _send(message: bytes, stream: IO[bytes]) -> None:
    pickle.dump(message, stream)
    stream.flush()


def serve() -> NoReturn:
    """Run the calls from standard input, in a `WorkerProcess`.

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
    try:
        while True:
            _send(_answer(calls.get()), out)
    except SystemExit as error:
        os._exit(error.code if isinstance(error.code, int) else 1)


def _read_calls(requests: IO[bytes], calls: queue.SimpleQueue[bytes]) -> None:
    with suppress(OSError, EOFError, pickle.UnpicklingError):
        while True:
            calls.put(pickle.load(requests))
    os._exit(1)  # no receiver for the outcome; files are complete, old or new


def _answer(call: bytes) -> bytes:
    try:
        return pickle.dumps((pickle.loads(call)(), None))
    except Exception as error:  # noqa: BLE001  raised again in the parent
        return pickle.dumps((None, error))
