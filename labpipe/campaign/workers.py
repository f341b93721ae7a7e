"""Run calls in child processes, so that the death of a process fails only its call."""

from __future__ import annotations

import json
import operator
import os
import pickle
import queue
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Generator, Iterable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import suppress
from functools import partial
from itertools import islice
from pathlib import Path
from typing import IO, NoReturn, Self, TypeVar, cast

from labpipe.errors import ProcessingError

A = TypeVar("A")
T = TypeVar("T")


class WorkerProcess:
    """A child process that runs calls one after another and is replaced if it dies.

    Notes
    -----
    It is started by the first call. It is not forked, since a fork of a process with threads may
    deadlock, and not made by `multiprocessing`, which workers of a cluster must not use. It ends at
    once if its parent is killed.
    """

    def __init__(self) -> None:
        self.process: subprocess.Popen[bytes] | None = None

    def call(self, work: Callable[[], T], *, subject: object, limit: float | None = None) -> T:
        """Run a call in the process and wait for it.

        Parameters
        ----------
        work : call to run; it and its result must be picklable, such as a partial of a module-level
            function
        subject : what the call works on, for messages, such as the file of a test
        limit : s, time limit, after which the process is killed; None or 0 for no limit

        Raises
        ------
        ProcessingError
            If the process took too long, or died: by a signal, such as for lack of memory, or by
            an exit.
        Exception
            If the call raises it.
        """
        call = pickle.dumps(work)
        if self.process is None or self.process.poll() is not None:
            self.close()
            self.process = _start_process()
        begin = time.monotonic()
        kill_delay = min(limit or threading.TIMEOUT_MAX, threading.TIMEOUT_MAX)
        timer = threading.Timer(kill_delay, _kill, [self.process])
        timer.daemon = True
        timer.start()
        reply: bytes | None = None
        try:
            with suppress(OSError, EOFError, pickle.UnpicklingError, ValueError):  # it died
                _send(call, cast("IO[bytes]", self.process.stdin))
                reply = pickle.load(cast("IO[bytes]", self.process.stdout))
        finally:
            timer.cancel()
            timer.join()
            exit_code = self.close() if reply is None else 0
        if reply is None and time.monotonic() - begin >= kill_delay:
            raise ProcessingError.about("campaign.time_limit", subject, minutes=kill_delay / 60.0)
        if reply is None:
            ending = _describe_exit(exit_code)
            raise ProcessingError.about("campaign.process_died", subject, ending=ending)
        result, error = pickle.loads(reply)
        if error is not None:
            raise error
        return cast("T", result)

    def close(self) -> int:
        """End the process, and return its exit code; 0 if there is none."""
        process, self.process = self.process, None
        if process is None:
            return 0
        if process.returncode is None:
            _kill(process)  # a process that has died keeps its own exit code
        for pipe in (process.stdin, process.stdout):
            with suppress(OSError):
                cast("IO[bytes]", pipe).close()
        return process.wait()


def _describe_exit(code: int) -> str:
    with suppress(ValueError):
        return f"by the signal {signal.Signals(-code).name}"
    return f"by the signal {-code}" if code < 0 else f"with exit code {code}"


class Pool:
    """Worker processes that run calls in parallel; a thread waits for each process.

    Parameters
    ----------
    jobs : maximum number of processes, which are started on first use
    limit : s, time limit of a call, after which its process is killed; None for no limit
    """

    def __init__(self, jobs: int, *, limit: float | None = None) -> None:
        self._limit, self._threads = limit, ThreadPoolExecutor(jobs)
        self._workers = [WorkerProcess() for _ in range(jobs)]
        self._idle_workers = [*self._workers]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Wait for all submitted calls, and end the processes."""
        try:
            self._threads.shutdown()
        finally:
            for worker in self._workers:
                worker.close()

    def submit(self, work: Callable[[], T], *, subject: object) -> Future[T]:
        """Start a call without waiting for it; its future raises as `WorkerProcess.call`.

        Parameters
        ----------
        work, subject : see `WorkerProcess.call`
        """
        return self._threads.submit(self._call, work, subject)

    def _call(self, work: Callable[[], T], subject: object) -> T:
        worker = self._idle_workers.pop()  # there are as many as threads
        try:
            return worker.call(work, subject=subject, limit=self._limit)
        finally:
            self._idle_workers.append(worker)


def run_as_completed(
    work: Callable[[A], T],
    arguments: Iterable[A],
    *,
    jobs: int,
    limit: float | None = None,
    subject: Callable[[A], object] = str,
) -> Generator[tuple[A, Future[T]], None, None]:
    """Call a function on many arguments in parallel processes.

    Parameters
    ----------
    work : function to call; must be picklable, such as a module-level function
    arguments : must be picklable; the next one is taken whenever a process becomes free
    jobs, limit : see `Pool`
    subject : returns the subject of a call for messages

    Yields
    ------
    Argument and completed future, in the order of completion. Its result raises as
    `WorkerProcess.call`.

    Notes
    -----
    If the generator is closed, as on an interrupt, started calls are completed.
    """
    remaining = iter(arguments)
    running: dict[Future[T], A] = {}
    with Pool(jobs, limit=limit) as pool:

        def start(count: int) -> None:
            for argument in islice(remaining, count):
                running[pool.submit(partial(work, argument), subject=subject(argument))] = argument

        start(jobs)
        while running:
            future = wait(running, return_when=FIRST_COMPLETED).done.pop()
            completed = running.pop(future)
            start(1)
            yield completed, future


def run_calls(calls: Sequence[Callable[[], T]], *, jobs: int) -> list[T]:
    """Run calls in parallel processes, or in this process if `jobs` is 1.

    Parameters
    ----------
    calls : partials of module-level functions
    jobs : number of calls at the same time

    Returns
    -------
    Their results, in order.

    Raises
    ------
    ProcessingError
        If a process died during its call.
    Exception
        If a call raises it.
    """
    if jobs == 1:
        return [call() for call in calls]
    completed = run_as_completed(operator.call, calls, jobs=jobs, subject=lambda _: "labpipe")
    results = {call: future.result() for call, future in completed}
    return [results[call] for call in calls]


_START = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1]);"
    " from labpipe.campaign.workers import run_worker; run_worker()"
)


def _start_process() -> subprocess.Popen[bytes]:
    # The matrices of a test are too small for more than one BLAS thread.
    return subprocess.Popen(
        [sys.executable, "-c", _START, json.dumps(sys.path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env={"OPENBLAS_NUM_THREADS": "1", **os.environ},
        start_new_session=True,  # the worker is killed together with its own child processes
    )


def _kill(process: subprocess.Popen[bytes]) -> None:
    with suppress(OSError):
        if sys.platform == "win32":
            process.kill()
        else:
            os.killpg(process.pid, signal.SIGKILL)


def _send(message: bytes, stream: IO[bytes]) -> None:
    pickle.dump(message, stream)
    stream.flush()


def run_worker() -> NoReturn:
    """Run the calls that arrive on standard input, in the process of a `WorkerProcess`.

    Only the parent handles interrupts, so that started calls are completed. The process ends with
    its parent. Output of libraries goes to standard error; their standard input is empty.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with suppress(OSError):  # if memory runs out, Linux kills this process first
        Path("/proc/self/oom_score_adj").write_text("500", encoding="ascii")
    requests, replies = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.dup2(2, 1)
    calls: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    threading.Thread(target=_read_calls, args=(requests, calls), daemon=True).start()
    try:
        while True:
            _send(_run_call(calls.get()), replies)
    except SystemExit as error:
        os._exit(error.code if isinstance(error.code, int) else 1)


def _read_calls(requests: IO[bytes], calls: queue.SimpleQueue[bytes]) -> None:
    with suppress(OSError, EOFError, pickle.UnpicklingError):
        while True:
            calls.put(pickle.load(requests))
    os._exit(1)  # the parent has died; each file is complete, either the old or the new one


def _run_call(call: bytes) -> bytes:
    try:
        return pickle.dumps((pickle.loads(call)(), None))
    except Exception as error:  # noqa: BLE001  raised again in the parent
        return pickle.dumps((None, error))
