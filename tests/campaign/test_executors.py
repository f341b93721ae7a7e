"""Processes that do tests: crashes, time limits, order, and what comes of each test."""

from __future__ import annotations

import operator
import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from labpipe.campaign import workers
from labpipe.campaign.executors import (
    Outcome,
    await_outcome,
    parse_executor,
    process_tests,
)
from labpipe.campaign.watching import process_in_pool
from labpipe.campaign.workers import Pool, WorkerProcess, run_as_completed
from labpipe.errors import CODES, ProcessingError, UsageError
from labpipe.process.run import ProcessedTest, RefusedTest, Task, draw_figures, process
from tests.builders.small_pulls import small_pulls
from tests.builders.small_tests import Lab


@pytest.mark.parametrize("text", ["dask", "dask://", "dask://host", "dask://:8786", "slurm", ""])
def test_unknown_executor_is_refused(text: str) -> None:
    message = rf"--executor: expected local, or dask://HOST:PORT, found '{text}'. `dask scheduler`"
    with pytest.raises(UsageError, match=message):
        parse_executor(text)


@pytest.mark.parametrize(
    ("text", "address"), [("dask://a:1", "a:1"), ("dask+tls://a:1", "tls://a:1")]
)
def test_address_of_a_scheduler(text: str, address: str) -> None:
    executor = parse_executor(text)
    assert isinstance(executor, partial)
    assert executor.keywords["address"] == address


@pytest.fixture
def tests(tmp_path: Path) -> list[Path]:
    """Three pulls, of which the second lacks its export."""
    labs = small_pulls(tmp_path, 3)
    labs[1].export.unlink()
    return [lab.sheet for lab in labs]


@pytest.mark.slow
def test_two_tests_with_one_results_folder_are_refused(tests: list[Path], tmp_path: Path) -> None:
    text = tests[2].read_text("utf-8")
    tests[2].write_text(text.replace("test: S-0002", "test: s-0000"), "utf-8")
    message = "expected one test for each folder of results, found a second for .*out.s-0000"
    with pytest.raises(UsageError, match=message):
        process_tests(tests, out=tmp_path / "out", jobs=2)
    assert not (tmp_path / "out").exists()
    attempts = process_tests(tests[::2], figures=False, jobs=2)
    assert [type(x) for x in attempts] == [ProcessedTest, ProcessedTest]  # each beside its exports
    assert isinstance(attempts[0], ProcessedTest)
    with pytest.raises(UsageError, match=r"result\.h5: expected one test for each folder"):
        process_tests([tests[0], attempts[0].folder / "result.h5"])


def run_all(calls: Sequence[Callable[[], Any]], **options: Any) -> list[Future[Any]]:
    """Futures of calls in their order."""
    futures = dict(run_as_completed(operator.call, calls, **options))
    return [futures[call] for call in calls]


@pytest.mark.skipif(os.name == "nt", reason="signals are another matter on Windows")
def test_death_of_a_process_fails_its_call_only() -> None:
    calls: list[Callable[[], Any]] = [
        partial(signal.raise_signal, signal.SIGTERM),
        partial(os._exit, 3),
        *(partial(max, number, 0) for number in range(4)),
    ]
    killed, exited, *completed = run_all(calls, jobs=2)
    assert [future.result() for future in completed] == [*range(4)]
    assert run_all([], jobs=3) == []
    for future, ending in ((killed, "by the signal SIGTERM"), (exited, "with exit code 3")):
        error = future.exception()
        assert isinstance(error, ProcessingError)
        assert error.code == "process_died"
        assert f"found one that was ended {ending}. " in str(error)
    assert workers._describe_exit(-63) == "by the signal 63"


def test_closing_waits_for_started_calls_only(tmp_path: Path) -> None:
    work = [f"cd '{tmp_path}'; mkdir {n}; sleep 0.2; echo > {n}/done" for n in range(3)]
    calls: list[Callable[[], Any]] = [
        partial(int, "1"),
        *(partial(os.system, text) for text in work),
    ]
    completed = run_as_completed(operator.call, calls, jobs=1)
    assert next(completed)[1].result() == 1
    while not (tmp_path / "0").exists():
        time.sleep(0.01)
    completed.close()
    assert [str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*")] == ["0", "0/done"]


def test_time_limit_fails_its_call_only() -> None:
    calls: list[Callable[[], Any]] = [partial(time.sleep, 60.0), partial(int, "2")]
    late, second = run_all(calls, jobs=2, timeout=5.0)
    with pytest.raises(ProcessingError, match=r"expected an end within 0\.08333") as died:
        late.result()
    assert died.value.code == "time_limit"
    assert second.result() == 2


def test_process_that_dies_between_calls_is_replaced() -> None:
    worker = WorkerProcess()
    try:
        assert worker.call(partial(int, "1"), subject="x") == 1
        assert worker.process is not None
        worker.process.kill()
        worker.process.wait()
        assert [worker.call(partial(int, text), subject="x") for text in ("2", "3")] == [2, 3]
    finally:
        worker.close()


@pytest.mark.skipif(sys.platform != "linux", reason="where Linux chooses whom it kills")
def test_linux_kills_the_worker_before_its_parent() -> None:
    file = Path("/proc/self/oom_score_adj")
    (future,) = run_all([file.read_text], jobs=1)
    assert future.result() == "500\n"
    assert int(file.read_text()) < 500


ORPHANS = """
import os, time
from functools import partial
from pathlib import Path
from labpipe.campaign.workers import run_as_completed
calls = ["__import__('os').getpid()", "__import__('time').sleep(60)"]
ended = run_as_completed(eval, calls, jobs=1)
print(next(ended)[1].result(), flush=True)
time.sleep(60)
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="where Linux tells of processes")
def test_worker_ends_with_its_parent() -> None:
    command = [sys.executable, "-c", ORPHANS]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        child = os.pidfd_open(int(process.stdout.readline()))
        process.kill()
    select.select([child], [], [])  # until it has ended
    os.close(child)


def test_outcome_of_a_dead_or_late_process(tmp_path: Path) -> None:
    task = Task(small_pulls(tmp_path, 1)[0].sheet, run="0a")
    error = ProcessingError.about(
        "campaign.process_died", task.source, ending="by the signal SIGTERM"
    )
    died = await_outcome(task, failed(error))
    assert isinstance(died, RefusedTest)
    assert (died.code, died.run) == ("process_died", "0a")
    late_error = ProcessingError.about("campaign.time_limit", task.source, minutes=2.0)
    late = await_outcome(task, failed(late_error))
    assert isinstance(late, RefusedTest)
    assert late.code == "time_limit"
    assert "expected an end within 2 minutes, found no end" in late.reason
    assert {died.code, late.code} <= CODES.keys()
    with pytest.raises(ZeroDivisionError):
        await_outcome(task, failed(ZeroDivisionError()))


def failed(error: Exception) -> Future[Outcome]:
    future: Future[Outcome] = Future()
    future.set_exception(error)
    return future


@pytest.fixture(scope="module")
def pool() -> Iterator[Pool]:
    """The one process of a watch."""
    with Pool(1, timeout=600.0) as pool:
        yield pool


def call(pool: Pool, work: Callable[[], object]) -> object:
    return pool.submit(work, subject="x").result()


def refuse() -> None:
    message = "no"
    raise UsageError(message)


@pytest.mark.slow
def test_warm_worker_draws_figures_after_processing(pool: Pool, lab: Lab) -> None:
    ((_, attempted),) = process_in_pool(pool, [Task(lab.sheet, lab.processed)])
    assert attempted.folder == lab.processed
    assert not (lab.processed / "figures").exists()
    content = lab.result.read_bytes()

    pool.submit(partial(draw_figures, lab.processed), subject="x")
    call(pool, os.getpid)  # waits for them

    drawn = {path.name: path.read_bytes() for path in (lab.processed / "figures").iterdir()}
    assert lab.result.read_bytes() == content
    processed = process(Task(lab.sheet, lab.home / "out"))
    assert drawn == {path.name: path.read_bytes() for path in processed.figures}


def test_warm_worker_survives_failed_calls(pool: Pool) -> None:
    process_id = call(pool, os.getpid)
    with pytest.raises(UsageError, match="no"):
        call(pool, refuse)
    assert process_id == call(pool, os.getpid) != os.getpid()
    with pytest.raises(ProcessingError, match=r"x: .* ended with exit code 3"):
        call(pool, partial(os._exit, 3))
    assert call(pool, os.getpid) not in {process_id, os.getpid()}


def test_death_of_the_warm_worker_is_an_outcome(
    pool: Pool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("labpipe.campaign.watching.try_to_process", die)
    task = Task(small_pulls(tmp_path, 1)[0].sheet, tmp_path / "out")
    ((_, attempted),) = process_in_pool(pool, [task])
    assert isinstance(attempted, RefusedTest)
    assert attempted.code == "process_died"


def die(_: Task) -> Outcome:
    os._exit(3)
