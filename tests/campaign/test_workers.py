from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from labpipe.campaign.workers import Crew, Died, in_processes


def test_outcomes_come_in_the_order_of_the_calls() -> None:
    calls = [partial(max, number, 0) for number in range(7)]
    assert list(in_processes(calls, jobs=3)) == list(range(7))
    assert list(in_processes(calls[:1], jobs=3)) == [0]
    assert list(in_processes([], jobs=3)) == []


@pytest.mark.skipif(os.name == "nt", reason="signals are another matter on Windows")
@pytest.mark.parametrize("jobs", [1, 2])
def test_a_process_that_dies_costs_its_call_alone(jobs: int) -> None:
    calls: list[Callable[[], Any]] = [
        partial(int, "1"),
        partial(signal.raise_signal, signal.SIGTERM),
        partial(signal.raise_signal, signal.SIGKILL),
        partial(int, "4"),
        partial(os._exit, 3),
        partial(int, "6"),
    ]
    found = list(in_processes(calls, jobs=jobs))
    died = Died(-signal.SIGTERM), Died(-signal.SIGKILL), Died(3)
    assert found == [1, died[0], died[1], 4, died[2], 6]
    assert [each.how for each in died] == [
        "by the signal SIGTERM",
        "by the signal SIGKILL",
        "with exit code 3",
    ]
    assert Died(-63).how == "by the signal 63"


def test_what_a_call_raises_is_raised() -> None:
    found = in_processes([partial(int, "1"), partial(int, "x"), partial(int, "3")], jobs=2)
    assert next(found) == 1
    with pytest.raises(ValueError, match="invalid literal"):
        next(found)


def test_calls_that_were_begun_are_waited_for_and_no_others(tmp_path: Path) -> None:
    work = [f"sleep 0.2; echo > '{tmp_path}/{number}'" for number in range(3)]
    found = in_processes([partial(int, "1"), *(partial(os.system, each) for each in work)], jobs=1)
    assert next(found) == 1
    found.close()
    assert [path.name for path in tmp_path.iterdir()] == ["0"]


def test_a_call_that_takes_too_long_costs_itself_alone() -> None:
    calls: list[Callable[[], Any]] = [partial(time.sleep, 60.0), partial(int, "2")]
    late, second = in_processes(calls, jobs=2, limit=1.0)
    assert isinstance(late, Died)
    assert late.limit == 1.0
    assert second == 2


def test_what_is_printed_and_read_there_is_no_message_of_ours() -> None:
    calls: list[Callable[[], Any]] = [
        partial(print, "x" * 100_000),
        partial(os.system, "echo y"),
        partial(os.read, 0, 5),
        partial(int, "4"),
    ]
    assert list(in_processes(calls, jobs=1)) == [None, 0, b"", 4]


def test_a_process_that_dies_between_two_calls_costs_none() -> None:
    crew: Crew[str, int] = Crew(int, jobs=1)
    try:
        assert list(crew.as_they_end(["1"])) == [("1", 1)]
        (worker,) = crew._workers
        assert worker.process is not None
        worker.process.kill()
        worker.process.wait()
        assert list(crew.as_they_end(["2", "3"])) == [("2", 2), ("3", 3)]
    finally:
        crew.leave()


@pytest.mark.skipif(sys.platform != "linux", reason="where Linux chooses whom it kills")
def test_where_memory_is_short_a_test_goes_and_not_the_run() -> None:
    file = Path("/proc/self/oom_score_adj")
    assert list(in_processes([file.read_text], jobs=1)) == ["500\n"]
    assert int(file.read_text()) < 500


ORPHANS = """
import os, time
from functools import partial
from pathlib import Path
from labpipe.campaign.workers import as_they_end
ended = as_they_end(eval, ["__import__('os').getpid()", "__import__('time').sleep(60)"], jobs=1)
print(next(ended)[1], flush=True)
time.sleep(60)
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="where Linux tells of processes")
def test_processes_go_with_the_one_that_started_them() -> None:
    command = [sys.executable, "-c", ORPHANS]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        child = os.pidfd_open(int(process.stdout.readline()))
        process.kill()
    select.select([child], [], [])  # until it has ended
    os.close(child)
