from __future__ import annotations

import filecmp
import re
import sys
import time
from pathlib import Path

import pytest

from labpipe.campaign.executors import Executor, Task, dask, local
from tests.builders.clusters import start_cluster
from tests.builders.small_pulls import small_pulls
from tests.builders.tensile_tests import TensileLab

MANY, AT_HALF = 2000, 1000


def done(executor: Executor, labs: list[TensileLab], out: Path, watched: int = 0) -> list[float]:
    """Process tests; memory of a process, MB, after each outcome."""
    tasks = [Task(lab.sheet, out / lab.name, figures=False) for lab in labs]
    states, memory = [], []
    for outcome in executor(tasks):
        states.append(outcome.state)
        memory.append(resident(watched) if watched else 0.0)
    assert len(states) == len(labs)
    assert "failed" not in states
    return memory


def resident(process: int) -> float:
    said = Path(f"/proc/{process}/status").read_text("ascii")
    found = re.search(r"VmRSS:\s+(\d+) kB", said)
    assert found
    return int(found[1]) / 1024.0


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="where Linux tells of memory")
def test_two_thousand_tests_and_the_scheduler_does_not_grow(tmp_path: Path) -> None:
    labs = small_pulls(tmp_path, MANY)
    (tmp_path / "cluster").mkdir()
    cluster = start_cluster(tmp_path / "cluster", workers=3)
    try:
        start = time.monotonic()
        executor = dask(cluster.address)
        memory = done(executor, labs, tmp_path / "dask", cluster.scheduler.pid)
        between = time.monotonic()
    finally:
        cluster.close()
    done(local(2), labs, tmp_path / "local")
    end = time.monotonic()
    said = f"{between - start:.0f} s on the cluster, {end - between:.0f} s here; MB after 1, 1000,"
    sys.stdout.write(f"{said} 2000: {memory[0]:.1f}, {memory[AT_HALF]:.1f}, {memory[-1]:.1f}\n")
    for lab in labs:
        names = sorted(path.name for path in (tmp_path / "local" / lab.name).iterdir())
        folders = tmp_path / "local" / lab.name, tmp_path / "dask" / lab.name
        same, other, wrong = filecmp.cmpfiles(*folders, names, shallow=False)
        assert (sorted(same), other, wrong) == (["result.h5", "summary.json"], [], []), lab.name
        assert sorted(path.name for path in folders[1].iterdir()) == names
    assert memory[-1] - memory[AT_HALF] < 3.0
    assert memory[-1] - memory[0] < 10.0
