"""Process tests in parallel: in processes of this machine, or on a dask.distributed cluster.

On a cluster, each test is one task. A worker processes it in a child process, so that a crash in C
does not end the worker. The scheduler moves the tests of a lost worker to other workers, as often
as its ``allowed-failures`` permits. It drops outcomes once they are fetched, so that its memory
does not grow with the campaign.
"""

from __future__ import annotations

import json
import logging
import os
import threading
import time
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import CancelledError, Future
from contextlib import closing, contextmanager, suppress
from functools import partial
from itertools import chain, islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias, cast

import psutil

from labpipe import __version__
from labpipe.campaign.workers import WorkerProcess, run_as_completed
from labpipe.errors import LabpipeError, ProcessingError, UsageError
from labpipe.process.output_paths import refuse_duplicates
from labpipe.process.run import (
    PROCESSING_VERSION,
    ProcessedTest,
    RefusedTest,
    Task,
    choose_results_folder,
    read_test_name,
    record_refusal,
    try_to_process,
)
from labpipe.store.summaries import SUMMARY_FILE

if TYPE_CHECKING:
    from distributed import Client

BYTES_PER_TEST = 750_000_000
"""Memory for the process of one test, bytes.

A cantilever test of full size (70 MB of exports, figures as SVG and PNG) takes 540 MB, and a
tensile test 175 MB, of which the libraries take 85 MB.
"""
_CONTROL_GROUP = Path("/sys/fs/cgroup")
"""Folder in which Linux states the memory limit of a container."""


def choose_default_jobs() -> int:
    """Choose the default number of parallel tests.

    Returns
    -------
    Number of cores, or fewer if memory is short; at least 1.
    """
    free_memory, n_cores = int(psutil.virtual_memory().available), os.cpu_count() or 1
    with suppress(AttributeError):  # Windows and macOS do not have the function
        n_cores = len(os.sched_getaffinity(0))
    with suppress(OSError, ValueError):  # there is no such file, or it reads "max" for no limit
        memory_limit = int((_CONTROL_GROUP / "memory.max").read_text("ascii"))
        used_memory = int((_CONTROL_GROUP / "memory.current").read_text("ascii"))
        free_memory = min(free_memory, memory_limit - used_memory)
    return max(1, min(n_cores, free_memory // BYTES_PER_TEST))


Outcome: TypeAlias = ProcessedTest | RefusedTest
"""A processed test, or the reason why it could not be processed."""
Outcomes: TypeAlias = Generator[tuple[Task, Outcome], None, None]
"""Tasks of tests with their outcomes, in the order of completion."""
Executor: TypeAlias = Callable[[Iterable[Task]], Outcomes]
"""Function that processes tasks; it takes a task only when the task can be started."""


def await_outcome(task: Task, future: Future[Outcome]) -> Outcome:
    """Wait for a test in another process, and record a failure if it died or took too long.

    Parameters
    ----------
    task : task of the test
    future : future of the call of `try_to_process` in the other process

    Raises
    ------
    Exception
        If the call raised any other error; this is a fault of labpipe.
    """
    try:
        return future.result()
    except ProcessingError as error:
        return _record_failure(task, error)


def _record_failure(task: Task, error: LabpipeError) -> RefusedTest:
    """Record why a test failed; do not read its exports, which may crash a process."""
    return record_refusal(task, error.code, str(error), reads_inputs=False)


def process_locally(tasks: Iterable[Task], *, jobs: int, timeout: float | None = None) -> Outcomes:
    """Process tests in child processes of this machine.

    `functools.partial` of this function and `jobs` is an `Executor`.

    Parameters
    ----------
    tasks : tests to process
    jobs : number of tests processed at the same time
    timeout : time limit of a test, s; None for no limit
    """
    futures = run_as_completed(
        try_to_process, tasks, jobs=jobs, timeout=timeout, subject=lambda task: task.source
    )
    with closing(futures) as completed_calls:
        for task, future in completed_calls:
            yield task, await_outcome(task, future)


_ADDRESS_PREFIXES = {"dask": "", "dask+tls": "tls://"}
"""Prefix of the address of a dask scheduler, keyed by scheme of the URL."""


def parse_executor(text: str, *, jobs: int | None = None, timeout: float | None = None) -> Executor:
    """Make the executor that is named on the command line.

    Parameters
    ----------
    text : ``local``, ``dask://HOST:PORT`` or ``dask+tls://HOST:PORT``
    jobs : number of tests processed at the same time on this machine; None for the number from
        `choose_default_jobs`
    timeout : time limit of a test, s; None for no limit

    Raises
    ------
    UsageError
        If the text has another form.
    """
    if text == "local":
        return partial(process_locally, jobs=jobs or choose_default_jobs(), timeout=timeout)
    scheme, _, address = text.partition("://")
    host, _, port = address.rpartition(":")
    if scheme not in _ADDRESS_PREFIXES or not host or not port.isdecimal():
        raise UsageError.about("campaign.bad_executor", "--executor", text=text)
    address = f"{_ADDRESS_PREFIXES[scheme]}{address}"
    return partial(process_on_cluster, address=address, timeout=timeout)


def process_tests(
    tests: Sequence[Path],
    *,
    out: Path | None = None,
    figures: bool = True,
    png: bool = False,
    follow_links: bool = False,
    jobs: int = 1,
    timeout: float | None = None,
    on_outcome: Callable[[Path], None] = lambda _: None,
) -> list[Outcome]:
    """Process tests; if one fails, the others are still processed.

    Parameters
    ----------
    tests : test.yaml or result.h5 files
    out : folder in which each test gets a folder of results; None for the folder beside ``raw``
    figures, png, follow_links : options of each `labpipe.process.run.Task`
    jobs : number of child processes; a single test is processed in this process
    timeout : time limit of each of several tests, s; None for no limit
    on_outcome : function that is called with the file of each test that was processed in a child
        process

    Returns
    -------
    Outcomes in the order of the tests, without recordings and stages, which are in their result.h5.

    Raises
    ------
    UsageError
        If two tests have the same folder of results; nothing is processed then.
    """
    outcomes: dict[Path, Outcome] = {}
    tasks: list[Task] = []
    for test in tests:
        try:
            folder = choose_results_folder(test, out, partial(read_test_name, test))
            tasks.append(Task(test, folder, figures, png, follow_links))
        except LabpipeError as error:
            outcomes[test] = RefusedTest(test, error.code, str(error))
    folders_and_sheets = [
        (str(task.results_folder and task.results_folder.absolute()), task.source) for task in tasks
    ]
    refuse_duplicates(folders_and_sheets, "folder of results")
    if len(tests) == 1:
        return [*outcomes.values(), *(try_to_process(task, is_alone=True) for task in tasks)]
    with closing(process_locally(tasks, jobs=jobs, timeout=timeout)) as completed_tests:
        for task, outcome in completed_tests:
            on_outcome(task.source)
            outcomes[task.source] = outcome
    return [outcomes[test] for test in tests]


_VERSIONS = (__version__, PROCESSING_VERSION)
"""Version of labpipe, and version of the processing."""
_CONNECT_TIMEOUT = 10.0
"""Time to wait for the scheduler, and then for a first worker, s."""
_THREAD_DATA = threading.local()
"""Holder of the `WorkerProcess` of each thread of a worker.

The process is kept between tests, because its modules are then already imported.
"""


def check_worker(sheet: Path, versions: tuple[str, int]) -> None:
    """Raise UsageError on a worker that has other versions, or cannot read a test sheet.

    Parameters
    ----------
    sheet : absolute path of the test sheet
    versions : versions of the client
    """
    if versions != _VERSIONS:
        raise UsageError.about(
            "campaign.other_versions", "--executor", version=versions[0], found=__version__
        )
    if not sheet.exists():
        raise UsageError.about("campaign.without_data", sheet)


def process_on_worker(
    task: Task, working_folder: Path, timeout: float | None, versions: tuple[str, int]
) -> Outcome:
    """Process a test on a worker.

    Parameters
    ----------
    task : task of the test
    working_folder : working folder of the client, to which paths are relative
    timeout : time limit of the test, s; None for no limit
    versions : versions of the client

    Returns
    -------
    Outcome of the test.

    Raises
    ------
    UsageError
        If the worker has other versions, or cannot read the test sheet.
    ProcessingError
        If the process of the test died or took too long.
    """
    check_worker(working_folder / task.source, versions)
    process = vars(_THREAD_DATA).setdefault("process", WorkerProcess())
    call = partial(_process_in_folder, working_folder, task)
    return cast("Outcome", process.call(call, subject=task.source, timeout=timeout))


def _process_in_folder(working_folder: Path, task: Task) -> Outcome:
    """Process a test in the working folder of the client."""
    with suppress(OSError):  # the folder is not needed if all paths are absolute
        os.chdir(working_folder)
    return try_to_process(task)


def process_on_cluster(
    tasks: Iterable[Task], address: str, *, timeout: float | None = None
) -> Outcomes:
    """Process tests on a cluster.

    Parameters
    ----------
    tasks : tests to process; the next one is taken whenever a worker becomes free
    address : address of the scheduler, ``HOST:PORT`` or ``tls://HOST:PORT``
    timeout : time limit of a test, s; None for no limit

    Raises
    ------
    UsageError
        If `distributed` is not installed, there is no scheduler at the address, or no worker; or if
        a worker has another version of labpipe or cannot read the first test.
    ProcessingError
        If the scheduler or all workers are lost during the run, or a worker cannot run labpipe.
    """
    remaining_tasks = iter(tasks)
    for first_task in islice(remaining_tasks, 1):
        all_tasks = chain([first_task], remaining_tasks)
        with _connect(address) as client:
            try:
                if first_task.source.exists():
                    arguments = Path.cwd() / first_task.source, _VERSIONS
                    worker_errors = client.run(check_worker, *arguments, on_error="return")
                    for error in filter(None, worker_errors.values()):
                        raise _convert_worker_error(error)
                yield from _process_all(client, all_tasks, timeout)
            except LabpipeError:
                raise
            except (OSError, CancelledError) as error:  # a timeout or a lost connection
                raise ProcessingError.about(
                    "campaign.lost_scheduler", "--executor", address=address
                ) from error
            except Exception as error:
                raise _convert_worker_error(error) from error


def _convert_worker_error(error: Exception) -> LabpipeError:
    """Convert an error of a worker that cannot run labpipe; keep an error of labpipe."""
    if isinstance(error, LabpipeError):
        return error
    kind, message = type(error).__name__, (str(error).splitlines() or [""])[0]
    return ProcessingError.about("campaign.bad_cluster", "--executor", kind=kind, message=message)


@contextmanager
def _connect(address: str) -> Iterator[Client]:
    """Connect to a scheduler, and suppress log messages, such as on lost connections."""
    try:
        from distributed import Client
    except ImportError as error:
        raise UsageError.about("campaign.no_distributed", "--executor") from error
    log_level = logging.root.manager.disable
    logging.disable(logging.CRITICAL)
    client = None
    try:
        url = address if "://" in address else f"tcp://{address}"
        client = Client(url, timeout=_CONNECT_TIMEOUT, set_as_default=False)
        with suppress(TimeoutError):
            client.wait_for_workers(1, timeout=_CONNECT_TIMEOUT)
        if not client.nthreads():
            raise UsageError.about("campaign.no_worker", "--executor", version=__version__)
        yield client
    except (OSError, ValueError) as error:  # a TimeoutError is an OSError
        raise UsageError.about("campaign.no_scheduler", "--executor", address=address) from error
    finally:
        with suppress(Exception):  # the connection is already lost
            if client is not None:
                client.close(timeout=_CONNECT_TIMEOUT)  # cancels the submitted tests
        logging.disable(log_level)


def _process_all(client: Client, tasks: Iterator[Task], timeout: float | None) -> Outcomes:
    """Submit tests as workers become free, and yield their outcomes.

    Raises TimeoutError if there is no worker for two minutes.
    """
    from distributed import wait

    check_interval, worker_timeout = 5.0, 120.0  # s
    last_time_with_worker = time.monotonic()
    submitted_tasks: dict[Any, Task] = {}
    while True:
        n_threads = sum(client.nthreads().values())
        if n_threads:
            last_time_with_worker = time.monotonic()
        elif time.monotonic() - last_time_with_worker >= worker_timeout:
            raise TimeoutError
        # At most one test per thread is submitted: when a worker dies, dask counts the tests in
        # its queue as failed.
        for task in islice(tasks, max(not submitted_tasks, n_threads - len(submitted_tasks))):
            arguments = (task, Path.cwd(), timeout, _VERSIONS)
            submitted_tasks[client.submit(process_on_worker, *arguments, pure=False)] = task
        if not submitted_tasks:
            return
        completed_futures: Iterable[Any] = ()
        with suppress(TimeoutError), client.as_current():
            completed_futures = wait([*submitted_tasks], check_interval, "FIRST_COMPLETED").done
        for future in completed_futures:
            task = submitted_tasks.pop(future)
            yield task, _fetch_outcome(task, future)


def _fetch_outcome(task: Task, future: Any) -> Outcome:
    """Return the outcome of a completed test, and record a failure if a worker failed."""
    from distributed import KilledWorker

    error = future.exception() if future.status == "error" else None
    if isinstance(error, KilledWorker):
        times = error.allowed_failures + 1
        error = ProcessingError.about("campaign.worker_died", task.source, times=times)
    if isinstance(error, ProcessingError):
        return _record_failure(task, error)
    if error is None:
        outcome = cast("Outcome", future.result())
        if isinstance(outcome, RefusedTest) or _can_read_results(outcome):
            return outcome
    elif not isinstance(error, UsageError) or error.code != "worker_without_data":
        raise _convert_worker_error(error) from error
    if not task.source.exists():
        return try_to_process(task)
    return _record_failure(task, UsageError.about("campaign.without_data", task.source))


def _can_read_results(processed: ProcessedTest) -> bool:
    """Return whether the results of a worker can be read here; wait for a slow shared drive."""
    max_delay, check_interval = 5.0, 0.1  # s
    deadline, key = time.monotonic() + max_delay, json.dumps(processed.result.run)
    while time.monotonic() < deadline:
        with suppress(OSError):
            if key in (processed.folder / SUMMARY_FILE).read_text(encoding="utf-8"):
                return True
        time.sleep(check_interval)
    return False
