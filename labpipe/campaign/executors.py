"""Process tests in parallel: in processes of this machine, or on a dask.distributed cluster.

On a cluster, a test is one task, and a worker processes it in a child process: a crash in C does
not end the worker. The scheduler moves the tests of a lost worker to others, as often as its
``allowed-failures`` permits. It drops outcomes once they are fetched, so that its memory does not
grow with the campaign.
"""

from __future__ import annotations

import json
import logging
import os
import threading
import time
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import Future
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
    Processed,
    Refused,
    Task,
    attempt,
    find_results_folder,
    read_test_name,
    refuse,
)
from labpipe.store.summaries import SUMMARY_FILE

if TYPE_CHECKING:
    from distributed import Client

BYTES_PER_TEST = 750_000_000
"""Memory for the process of one test, bytes. A cantilever test of full size (70 MB of exports,
figures as SVG and PNG) takes 540 MB, a tensile test 175 MB, of which 85 MB are the libraries."""
_CONTROL_GROUP = Path("/sys/fs/cgroup")
"""Folder in which Linux states the memory limit of a container."""


def default_jobs() -> int:
    """Return the default number of parallel tests: the number of cores, less if memory is short.

    Returns
    -------
    At least 1.
    """
    free, cores = int(psutil.virtual_memory().available), os.cpu_count() or 1
    with suppress(AttributeError):  # neither on Windows nor on macOS
        cores = len(os.sched_getaffinity(0))
    with suppress(OSError, ValueError):  # "max" means no limit
        limit = int((_CONTROL_GROUP / "memory.max").read_text("ascii"))
        free = min(free, limit - int((_CONTROL_GROUP / "memory.current").read_text("ascii")))
    return max(1, min(cores, free // BYTES_PER_TEST))


Attempt: TypeAlias = Processed | Refused
"""A processed test, or why it could not be processed."""
Attempts: TypeAlias = Generator[tuple[Task, Attempt], None, None]
"""Tests with their outcomes, in the order of completion."""
Executor: TypeAlias = Callable[[Iterable[Task]], Attempts]
"""Processes tasks: takes the next one whenever it can be started."""


def await_attempt(task: Task, future: Future[Attempt]) -> Attempt:
    """Wait for a test in another process; record a failure if it died or took too long.

    Parameters
    ----------
    task : the test
    future : of `attempt` in that process; any other error is raised, as a fault of labpipe
    """
    try:
        return future.result()
    except ProcessingError as error:
        return _record_failure(task, error)


def _record_failure(task: Task, error: LabpipeError) -> Refused:
    """Record why a test failed without reading its exports, since these may crash a process."""
    return refuse(task, error.code, str(error), is_read=False)


def process_locally(tasks: Iterable[Task], *, jobs: int, limit: float | None = None) -> Attempts:
    """Process tests in child processes of this machine; a partial is an `Executor`.

    Parameters
    ----------
    tasks : the tests
    jobs : number of tests at the same time
    limit : s, time limit of a test; None for no limit
    """
    futures = run_as_completed(
        attempt, tasks, jobs=jobs, limit=limit, subject=lambda task: task.sheet
    )
    with closing(futures) as completed:
        for task, future in completed:
            yield task, await_attempt(task, future)


_CLUSTERS = {"dask": "", "dask+tls": "tls://"}
"""Prefix of the address of a dask scheduler, by scheme of the URL."""


def parse_executor(text: str, *, jobs: int | None = None, limit: float | None = None) -> Executor:
    """Make the executor named on the command line.

    Parameters
    ----------
    text : ``local``, ``dask://HOST:PORT`` or ``dask+tls://HOST:PORT``
    jobs : number of tests at the same time on this machine; None for `default_jobs`
    limit : s, time limit of a test; None for no limit

    Raises
    ------
    UsageError
        If the text is none of these.
    """
    if text == "local":
        return partial(process_locally, jobs=jobs or default_jobs(), limit=limit)
    scheme, _, address = text.partition("://")
    host, _, port = address.rpartition(":")
    if scheme not in _CLUSTERS or not host or not port.isdecimal():
        raise UsageError.about("campaign.bad_executor", "--executor", text=text)
    return partial(process_on_cluster, address=f"{_CLUSTERS[scheme]}{address}", limit=limit)


def process_tests(
    tests: Sequence[Path],
    *,
    out: Path | None = None,
    figures: bool = True,
    png: bool = False,
    follow_links: bool = False,
    jobs: int = 1,
    limit: float | None = None,
    on_outcome: Callable[[Path], None] = lambda _: None,
) -> list[Attempt]:
    """Process tests; if one fails, the others are still processed.

    Parameters
    ----------
    tests : test.yaml or result.h5 files
    out : gets a folder per test; None for the folder beside ``raw``
    figures, png, follow_links : see `labpipe.process.run.Task`
    jobs : number of child processes; a single test is processed in this process
    limit : s, time limit of each of several tests; None for no limit
    on_outcome : called with each test at the end of its processing in a child process

    Returns
    -------
    The tests in order, without recordings and stages, which are in their result.h5.

    Raises
    ------
    UsageError
        If two tests have the same folder of results; nothing is processed then.
    """
    outcomes: dict[Path, Attempt] = {}
    tasks: list[Task] = []
    for test in tests:
        try:
            folder = find_results_folder(test, out, partial(read_test_name, test))
            tasks.append(Task(test, folder, figures, png, follow_links))
        except LabpipeError as error:
            outcomes[test] = Refused(test, error.code, str(error))
    folders_and_sheets = [
        (str(task.results_folder and task.results_folder.absolute()), task.sheet) for task in tasks
    ]
    refuse_duplicates(folders_and_sheets, "folder of results")
    if len(tests) == 1:
        return [*outcomes.values(), *(attempt(task, is_alone=True) for task in tasks)]
    with closing(process_locally(tasks, jobs=jobs, limit=limit)) as completed:
        for task, outcome in completed:
            on_outcome(task.sheet)
            outcomes[task.sheet] = outcome
    return [outcomes[test] for test in tests]


Versions: TypeAlias = tuple[str, int]
_VERSIONS: Versions = (__version__, PROCESSING_VERSION)
"""Version of labpipe, and processing version."""
_CONNECT_TIMEOUT = 10.0
"""Time to wait for the scheduler, and then for a first worker, s."""
_THREAD_DATA = threading.local()
"""The `WorkerProcess` of each thread of a worker; it is kept, since its modules are imported."""


def check_worker(sheet: Path) -> tuple[Versions, bool]:
    """Return the versions of a worker, and whether it can read a test sheet.

    Parameters
    ----------
    sheet : absolute path of the test sheet
    """
    return _VERSIONS, sheet.exists()


def process_on_worker(
    task: Task, working_folder: Path, limit: float | None, versions: Versions
) -> Attempt | None:
    """Process a test on a worker.

    Parameters
    ----------
    task : the test
    working_folder : of the client, in which relative paths start
    limit : s, time limit; None for no limit
    versions : of the client

    Returns
    -------
    The outcome; None if the worker has other versions, or cannot read the test sheet.

    Raises
    ------
    ProcessingError
        If the process of the test died or took too long.
    """
    if check_worker(working_folder / task.sheet) != (versions, True):
        return None
    process = vars(_THREAD_DATA).setdefault("process", WorkerProcess())
    call = partial(_attempt_at, working_folder, task)
    return cast("Attempt", process.call(call, subject=task.sheet, limit=limit))


def _attempt_at(working_folder: Path, task: Task) -> Attempt:
    """Process a test in the working folder of the client."""
    with suppress(OSError):  # a missing folder does no harm if all paths are absolute
        os.chdir(working_folder)
    return attempt(task)


def process_on_cluster(
    tasks: Iterable[Task], address: str, *, limit: float | None = None
) -> Attempts:
    """Process tests on a cluster.

    Parameters
    ----------
    tasks : the next one is taken whenever a worker becomes free
    address : of the scheduler, ``HOST:PORT`` or ``tls://HOST:PORT``
    limit : s, time limit of a test; None for no limit

    Raises
    ------
    UsageError
        If `distributed` is not installed, there is no scheduler at the address, or no worker; or if
        a worker has another version of labpipe or cannot read the first test.
    ProcessingError
        If the scheduler or all workers are lost during the run, or a worker cannot run labpipe.
    """
    remaining = iter(tasks)
    for first in islice(remaining, 1):
        with _connect(address) as client:
            try:
                if first.sheet.exists():
                    _check_workers(client, first)
                with closing(_process_all(client, chain([first], remaining), limit)) as outcomes:
                    yield from outcomes
            except LabpipeError:
                raise
            except Exception as error:  # a client that has lost its scheduler raises various errors
                raise ProcessingError.about(
                    "campaign.lost_scheduler", "--executor", address=address
                ) from error


@contextmanager
def _connect(address: str) -> Iterator[Client]:
    """Connect to a scheduler; log messages, such as on lost connections, are suppressed."""
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
        with suppress(Exception):  # already lost
            if client is not None:
                client.close(timeout=_CONNECT_TIMEOUT)  # cancels what is submitted
        logging.disable(log_level)


def _check_workers(client: Client, task: Task) -> None:
    """Refuse workers with another version of labpipe, and workers that cannot read a test."""
    answers = client.run(check_worker, Path.cwd() / task.sheet, on_error="return")
    for answer in answers.values():
        if isinstance(answer, Exception):
            raise _describe_fault(answer) from answer
        versions, is_visible = answer
        if versions != _VERSIONS:
            raise UsageError.about(
                "campaign.other_versions", "--executor", version=__version__, found=versions[0]
            )
        if not is_visible:
            error = UsageError.about("campaign.without_data", task.sheet)
            raise UsageError(str(error), code="no_cluster")


def _process_all(client: Client, tasks: Iterator[Task], limit: float | None) -> Attempts:
    """Submit tests as workers become free, and yield their outcomes.

    Raises TimeoutError if there is no worker for two minutes.
    """
    from distributed import wait

    check_interval = 5.0  # s between checks for workers
    max_checks_without_worker = 24
    checks_without_worker = 0
    submitted: dict[Any, Task] = {}
    while checks_without_worker < max_checks_without_worker:
        n_threads = sum(client.nthreads().values())
        checks_without_worker = 0 if n_threads else checks_without_worker + 1
        # tests in the queue of a worker would be counted as failed when the worker dies
        for task in islice(tasks, max(not submitted, n_threads - len(submitted))):
            future = client.submit(
                process_on_worker, task, Path.cwd(), limit, _VERSIONS, pure=False
            )
            submitted[future] = task
        if not submitted:
            return
        if not n_threads:
            time.sleep(check_interval)
            continue
        completed: Iterable[Any] = ()
        with suppress(TimeoutError), client.as_current():
            completed = wait([*submitted], check_interval, "FIRST_COMPLETED").done
        for future in completed:
            task = submitted.pop(future)
            yield task, _fetch_attempt(task, future)
    raise TimeoutError


def _fetch_attempt(task: Task, future: Any) -> Attempt:
    """Return the outcome of a completed test."""
    from distributed import KilledWorker

    error = future.exception() if future.status == "error" else None
    if isinstance(error, KilledWorker):
        times = error.allowed_failures + 1
        error = ProcessingError.about("campaign.worker_died", task.sheet, times=times)
    if isinstance(error, ProcessingError):
        return _record_failure(task, error)
    if error is not None:
        raise _describe_fault(error) from error
    outcome = cast("Attempt | None", future.result())
    if isinstance(outcome, Refused) or (outcome is not None and _can_see_results(outcome)):
        return outcome
    if not task.sheet.exists():
        return attempt(task)
    return _record_failure(task, UsageError.about("campaign.without_data", task.sheet))


def _describe_fault(error: BaseException) -> ProcessingError:
    """Make an error from that of a worker that cannot run labpipe."""
    message = (str(error).splitlines() or [""])[0]
    return ProcessingError.about(
        "campaign.bad_cluster", "--executor", kind=type(error).__name__, message=message
    )


def _can_see_results(processed: Processed) -> bool:
    """Return whether the results of a worker can be read here; wait up to 5 s for the drive."""
    end, key = time.monotonic() + 5.0, json.dumps(processed.result.run)
    while time.monotonic() < end:
        with suppress(OSError):
            if key in (processed.folder / SUMMARY_FILE).read_text(encoding="utf-8"):
                return True
        time.sleep(0.1)
    return False
