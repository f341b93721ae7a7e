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
    The first call starts the process, which ends immediately if its parent is killed. It is not
    forked, because a fork of a process with threads may deadlock. It is not made by
    `multiprocessing`, because a daemonic process, such as a worker of a cluster, may not use this
    module.
    """

    def __init__(self) -> None:
        self.process: subprocess.Popen[bytes] | None = None

    def call(self, work: Callable[[], T], *, subject: object, timeout: float | None = None) -> T:
        """Run a function in the process and wait for its result.

        Parameters
        ----------
        work : function without arguments, such as a partial of a module-level function; the
            function and its result must be picklable
        subject : file or other object of the call, for messages
        timeout : time limit after which the process is killed, s; None or 0 for no limit

        Raises
        ------
        ProcessingError
            If the process took too long, or died: by a signal, such as for lack of memory, or by
            an exit.
        Exception
            If the function raises it.
        """
        request = pickle.dumps(work)
        if self.process is None or self.process.poll() is not None:
            self.close()
            self.process = _start_process()
        start_time = time.monotonic()
        kill_delay = min(timeout or threading.TIMEOUT_MAX, threading.TIMEOUT_MAX)
        timer = threading.Timer(kill_delay, _kill_process, [self.process])
        timer.daemon = True
        timer.start()
        reply: bytes | None = None
        try:
            # These errors mean that the process has died.
            with suppress(OSError, EOFError, pickle.UnpicklingError, ValueError):
                _send_message(request, cast("IO[bytes]", self.process.stdin))
                reply = pickle.load(cast("IO[bytes]", self.process.stdout))
        finally:
            timer.cancel()
            timer.join()
            exit_code = self.close() if reply is None else 0
        if reply is None and time.monotonic() - start_time >= kill_delay:
            raise ProcessingError.about("campaign.time_limit", subject, minutes=kill_delay / 60.0)
        if reply is None:
            ending = _describe_exit(exit_code)
            raise ProcessingError.about("campaign.process_died", subject, ending=ending)
        result, error = pickle.loads(reply)
        if error is not None:
            raise error
        return cast("T", result)

    def close(self) -> int:
        """End the process, and return its exit code; 0 if there is no process."""
        process, self.process = self.process, None
        if process is None:
            return 0
        if process.returncode is None:
            _kill_process(process)  # this does not change the exit code of a dead process
        for pipe in (process.stdin, process.stdout):
            with suppress(OSError):
                cast("IO[bytes]", pipe).close()
        return process.wait()


def _describe_exit(code: int) -> str:
    """Describe the end of a process by its exit code, which is negative for a signal."""
    with suppress(ValueError):
        return f"by the signal {signal.Signals(-code).name}"
    return f"by the signal {-code}" if code < 0 else f"with exit code {code}"


class Pool:
    """Worker processes that run calls in parallel; a thread waits for each process.

    Parameters
    ----------
    jobs : maximum number of processes; each is started by its first call
    timeout : time limit of a call after which its process is killed, s; None for no limit
    """

    def __init__(self, jobs: int, *, timeout: float | None = None) -> None:
        self._timeout, self._threads = timeout, ThreadPoolExecutor(jobs)
        self._workers = [WorkerProcess() for _ in range(jobs)]
        self._idle_workers = [*self._workers]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Wait for the end of all submitted calls, and end the processes."""
        try:
            self._threads.shutdown()
        finally:
            for worker in self._workers:
                worker.close()

    def submit(self, work: Callable[[], T], *, subject: object) -> Future[T]:
        """Start a call without waiting for its result.

        Parameters
        ----------
        work, subject : function and subject of the call, as for `WorkerProcess.call`

        Returns
        -------
        Future of the result, which raises the errors of `WorkerProcess.call`.
        """
        return self._threads.submit(self._run_call, work, subject)

    def _run_call(self, work: Callable[[], T], subject: object) -> T:
        """Run a call in an idle process; there are as many processes as threads."""
        worker = self._idle_workers.pop()
        try:
            return worker.call(work, subject=subject, timeout=self._timeout)
        finally:
            self._idle_workers.append(worker)


def run_as_completed(
    work: Callable[[A], T],
    arguments: Iterable[A],
    *,
    jobs: int,
    timeout: float | None = None,
    subject: Callable[[A], object] = str,
) -> Generator[tuple[A, Future[T]], None, None]:
    """Call a function on many arguments in parallel processes.

    Parameters
    ----------
    work : picklable function to call, such as a module-level function
    arguments : picklable arguments; the next one is taken whenever a process becomes free
    jobs : maximum number of processes
    timeout : time limit of a call after which its process is killed, s; None for no limit
    subject : function that returns the subject of a call from its argument, for messages

    Yields
    ------
    argument : argument of a completed call, in the order of completion
    future : completed future of the call, which raises the errors of `WorkerProcess.call`

    Notes
    -----
    If the generator is closed, for example by an interrupt, started calls are completed.
    """
    remaining_arguments = iter(arguments)
    arguments_by_future: dict[Future[T], A] = {}
    with Pool(jobs, timeout=timeout) as pool:

        def start_calls(count: int) -> None:
            for argument in islice(remaining_arguments, count):
                future = pool.submit(partial(work, argument), subject=subject(argument))
                arguments_by_future[future] = argument

        start_calls(jobs)
        while arguments_by_future:
            future = wait(arguments_by_future, return_when=FIRST_COMPLETED).done.pop()
            argument = arguments_by_future.pop(future)
            start_calls(1)
            yield argument, future


def run_calls(calls: Sequence[Callable[[], T]], *, jobs: int) -> list[T]:
    """Run calls in parallel processes, or in this process if `jobs` is 1.

    Parameters
    ----------
    calls : functions without arguments, such as partials of module-level functions
    jobs : number of calls that run at the same time

    Returns
    -------
    Results in the order of the calls.

    Raises
    ------
    ProcessingError
        If a process died during its call.
    Exception
        If a call raises it.
    """
    if jobs == 1:
        return [call() for call in calls]
    completed_calls = run_as_completed(operator.call, calls, jobs=jobs, subject=lambda _: "labpipe")
    results = {call: future.result() for call, future in completed_calls}
    return [results[call] for call in calls]


_WORKER_CODE = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1]);"
    " from labpipe.campaign.workers import run_worker; run_worker()"
)
"""Python code of a worker process; its argument is the module search path as JSON."""


def _start_process() -> subprocess.Popen[bytes]:
    """Start a worker process with one BLAS thread, since the matrices of a test are small."""
    return subprocess.Popen(
        [sys.executable, "-c", _WORKER_CODE, json.dumps(sys.path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env={"OPENBLAS_NUM_THREADS": "1", **os.environ},
        start_new_session=True,  # so that `_kill_process` also ends child processes
    )


def _kill_process(process: subprocess.Popen[bytes]) -> None:
    """Kill a process, and its child processes except on Windows."""
    with suppress(OSError):
        if sys.platform == "win32":
            process.kill()
        else:
            os.killpg(process.pid, signal.SIGKILL)


def _send_message(message: bytes, stream: IO[bytes]) -> None:
    """Send a message to another process as a pickle."""
    pickle.dump(message, stream)
    stream.flush()


def run_worker() -> NoReturn:
    """Run the calls that arrive on standard input, in the process of a `WorkerProcess`.

    Only the parent handles interrupts, so that started calls are completed. The process ends when
    its parent ends. Output of libraries goes to standard error, and their standard input is empty.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with suppress(OSError):  # if memory runs out, Linux kills this process rather than its parent
        Path("/proc/self/oom_score_adj").write_text("500", encoding="ascii")
    requests, replies = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.dup2(2, 1)
    call_queue: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    threading.Thread(target=_read_calls, args=(requests, call_queue), daemon=True).start()
    try:
        while True:
            call = call_queue.get()
            try:
                reply = pickle.dumps((pickle.loads(call)(), None))
            except Exception as error:  # noqa: BLE001  the parent raises it again
                reply = pickle.dumps((None, error))
            _send_message(reply, replies)
    except SystemExit as error:
        os._exit(error.code if isinstance(error.code, int) else 1)


def _read_calls(requests: IO[bytes], call_queue: queue.SimpleQueue[bytes]) -> None:
    """Put calls from the parent into a queue, and end this process when the parent has died.

    An exit at any time leaves each result file complete, because files are replaced as a whole.
    """
    with suppress(OSError, EOFError, pickle.UnpicklingError):
        while True:
            call_queue.put(pickle.load(requests))
    os._exit(1)
