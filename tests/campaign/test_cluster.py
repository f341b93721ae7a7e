from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from distributed import Client

from labpipe.campaign import executors
from labpipe.campaign.executors import Outcome, process_locally, process_on_cluster
from labpipe.errors import ProcessingError, UsageError
from labpipe.process.run import ProcessedTest, RefusedTest, Task
from tests.builders.clusters import Cluster, start_cluster
from tests.builders.other_processes import Spoiled, spoil
from tests.builders.small_pulls import small_pulls
from tests.builders.tensile_tests import TensileLab

pytestmark = pytest.mark.skipif(os.name == "nt", reason="processes are killed by signals")


@pytest.fixture(scope="module")
def machines(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    """Three workers; tests of this module may lose one."""
    cluster = start_cluster(tmp_path_factory.mktemp("cluster"), workers=3)
    yield cluster
    cluster.close()


@pytest.fixture
def alone(tmp_path: Path) -> Iterator[Cluster]:
    """A scheduler without a worker."""
    (tmp_path / "cluster").mkdir()
    cluster = start_cluster(tmp_path / "cluster", workers=0)
    yield cluster
    cluster.close()


def tasks_of(labs: list[TensileLab], out: Path) -> list[Task]:
    return [Spoiled(lab.sheet, out / lab.name, figures=False, run="0a") for lab in labs]


def by_name(attempts: Iterator[tuple[Task, Outcome]]) -> dict[str, Outcome]:
    return {task.source.parent.name: attempted for task, attempted in attempts}


def refusals(attempts: dict[str, Outcome]) -> dict[str, RefusedTest]:
    """Refused tests by name."""
    return {name: test for name, test in attempts.items() if isinstance(test, RefusedTest)}


def _count_tasks(dask_scheduler: Any) -> int:
    """Return the number of tasks in the memory of a scheduler."""
    return len(dask_scheduler.tasks)


def contents(folder: Path) -> dict[str, bytes]:
    files = (path for path in sorted(folder.rglob("*")) if path.is_file())
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


@pytest.mark.slow
def test_cluster_with_lost_machine_writes_the_files_of_a_local_run(
    machines: Cluster, tmp_path: Path
) -> None:
    labs = small_pulls(tmp_path, 12)
    tasks = tasks_of(labs, tmp_path / "local")
    drawn = Task(labs[0].sheet, tmp_path / "local" / "drawn", png=True)
    local_attempts = by_name(process_locally([*tasks, drawn], jobs=2))
    spoil(labs[5].sheet, "kill the machine", once=True)
    tasks = tasks_of(labs, tmp_path / "dask")
    drawn = Task(labs[0].sheet, tmp_path / "dask" / "drawn", png=True)
    cluster_attempts = by_name(process_on_cluster([*tasks, drawn], machines.address))
    assert not (labs[5].raw / "end").exists()  # one did go down
    assert sum(process.poll() is None for process in machines.workers) == 2
    assert cluster_attempts.keys() == local_attempts.keys()
    assert not refusals(cluster_attempts)
    with Client(f"tcp://{machines.address}", set_as_default=False) as client:
        assert client.run_on_scheduler(_count_tasks) == 0
    files = contents(tmp_path / "local")
    assert len(files) > 2 * 12 + 4  # with figures, as SVG and PNG
    assert contents(tmp_path / "dask") == files


@pytest.mark.slow
def test_only_the_test_that_kills_workers_fails(machines: Cluster, tmp_path: Path) -> None:
    labs = small_pulls(tmp_path, 6)
    spoil(labs[2].sheet, "kill the worker")
    spoil(labs[4].sheet, "abort")
    outcomes = by_name(process_on_cluster(tasks_of(labs, tmp_path / "out"), machines.address))
    refused = refusals(outcomes)
    codes = {name: test.code for name, test in refused.items()}
    assert codes == {"S-0002": "worker_died", "S-0004": "process_died"}
    assert len(outcomes) == 6
    message = f"{labs[2].sheet}: expected a worker that completes this test, found that 2"
    assert refused["S-0002"].reason.startswith(message)
    stored = json.loads((tmp_path / "out" / "S-0002" / "failure.json").read_text("utf-8"))
    assert (stored["code"], stored["run"]) == ("worker_died", "0a")


def test_cluster_reports_the_failures_of_a_local_run(
    alone: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(executors, "_CONNECT_TIMEOUT", 60.0)  # a busy machine starts workers slowly
    alone.add_worker()
    labs = small_pulls(tmp_path, 3)
    labs[1].export.unlink()
    labs[2].sheet.unlink()
    outcomes = by_name(process_on_cluster(tasks_of(labs, tmp_path / "out"), alone.address))
    refused = refusals(outcomes)
    codes = {name: test.code for name, test in refused.items()}
    assert codes == {"S-0001": "missing_export", "S-0002": "bad_sheet"}


@pytest.fixture
def hidden_labs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[TensileLab]:
    """Tests by paths that only a process with this working folder sees."""
    labs = small_pulls(tmp_path / "data", 6)
    monkeypatch.chdir(tmp_path / "data")
    return labs


def own_tasks(labs: list[TensileLab]) -> list[Task]:
    folder = Path("/proc/self/cwd")
    sheets = [folder / lab.sheet.relative_to(lab.home) for lab in labs]
    return [Task(sheet, folder / "out" / sheet.parent.name, figures=False) for sheet in sheets]


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="paths that are others for each process")
def test_workers_must_see_the_files(alone: Cluster, hidden_labs: list[TensileLab]) -> None:
    """A worker that sees all tests but the last; then one that sees none."""
    alone.add_worker(folder=hidden_labs[0].home)
    tasks = own_tasks(hidden_labs)
    with Client(f"tcp://{alone.address}", set_as_default=False) as client:
        client.wait_for_workers(1, timeout=60)
    handle = os.open(hidden_labs[5].raw, os.O_RDONLY)
    try:
        sheet = Path(f"/proc/self/fd/{handle}/test.yaml")
        hidden = replace(tasks.pop(), source=sheet, run="0a")
        outcomes = list(process_on_cluster([*tasks, hidden], alone.address))
    finally:
        os.close(handle)
    (failed,) = (test for _, test in outcomes if isinstance(test, RefusedTest))
    assert (failed.source, failed.code, failed.run) == (sheet, "worker_without_data", "0a")
    assert failed.reason.startswith(f"{sheet}: expected workers with this labpipe that can")
    assert len(list((hidden_labs[0].home / "out").glob("*/result.h5"))) == 5
    alone.add_worker()
    with Client(f"tcp://{alone.address}", set_as_default=False) as client:
        client.wait_for_workers(2, timeout=60)
    with pytest.raises(UsageError, match="the files of this machine") as raised:
        list(process_on_cluster(tasks, alone.address))
    assert raised.value.code == "worker_without_data"


def test_missing_scheduler_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(executors, "_CONNECT_TIMEOUT", 1.0)
    message = "--executor: expected a dask scheduler at 127.0.0.1:1, found no answer. Start"
    with pytest.raises(UsageError, match=message) as raised:
        list(process_on_cluster([Task(tmp_path)], "127.0.0.1:1"))
    assert raised.value.code == "no_cluster"


@pytest.mark.slow
def test_lost_scheduler_ends_the_run(alone: Cluster, tmp_path: Path) -> None:
    alone.add_worker()
    with Client(f"tcp://{alone.address}", set_as_default=False) as client:
        client.wait_for_workers(1, timeout=60)
    labs = small_pulls(tmp_path, 12)
    spoil(labs[11].sheet, "hang")
    outcomes = process_on_cluster(tasks_of(labs, tmp_path / "out"), alone.address)
    assert isinstance(next(iter(outcomes))[1], ProcessedTest)
    alone.scheduler.kill()
    start = time.monotonic()
    message = r"--executor: expected the scheduler at .* until the end of the run, found that it or"
    with pytest.raises(ProcessingError, match=message) as raised:
        list(outcomes)
    assert raised.value.code == "no_cluster"
    assert time.monotonic() - start < 40.0


def test_missing_distributed_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    message = r"--executor: expected the package distributed, found none\. Install labpipe with it"
    with pytest.raises(UsageError, match=message):
        list(process_on_cluster([Task(tmp_path)], "127.0.0.1:1"))
