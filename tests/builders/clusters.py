"""A cluster of processes on this machine: one scheduler, some workers."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

_ROOT = Path(__file__).parents[2]
_START = 60.0
_SETTINGS = {"DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "1"}


@dataclass
class Cluster:
    """A scheduler and its workers, each with its own process.

    Parameters
    ----------
    home : folder for what they write
    scheduler : its process
    workers : processes that keep a worker each, and start it again when it dies
    """

    home: Path
    scheduler: subprocess.Popen[bytes]
    workers: list[subprocess.Popen[bytes]] = field(default_factory=list)

    @property
    def address(self) -> str:
        """HOST:PORT of the scheduler."""
        scheduler_file = json.loads((self.home / "scheduler.json").read_text("utf-8"))
        return str(scheduler_file["address"]).removeprefix("tcp://")

    def add_worker(self, *more: str, folder: Path | None = None) -> None:
        """Start one with one thread, in a working folder."""
        arguments = ["--scheduler-file", str(self.home / "scheduler.json"), "--nthreads", "1"]
        arguments += ["--nworkers", "1", "--no-dashboard", "--memory-limit", "0", *more]
        arguments += ["--local-directory", str(self.home / f"worker-{len(self.workers)}")]
        self.workers.append(_started("dask_worker", self.home, *arguments, folder=folder))

    def close(self) -> None:
        """End all processes."""
        for process in (*self.workers, self.scheduler):
            _kill(process)


def start_cluster(home: Path, workers: int) -> Cluster:
    """Start a scheduler and some workers, and wait until the scheduler is there."""
    file = home / "scheduler.json"
    arguments = ["--host", "127.0.0.1", "--port", "0", "--no-dashboard"]
    cluster = Cluster(
        home, _started("dask_scheduler", home, *arguments, "--scheduler-file", str(file))
    )
    until = time.monotonic() + _START
    while not file.exists() and time.monotonic() < until:
        time.sleep(0.05)
    for _ in range(workers):
        cluster.add_worker()
    return cluster


def _started(
    program: str, home: Path, *arguments: str, folder: Path | None = None
) -> subprocess.Popen[bytes]:
    log = (home / "log").open("ab")
    with log:
        return subprocess.Popen(
            [sys.executable, "-m", f"distributed.cli.{program}", *arguments],
            cwd=folder or home,
            env={**os.environ, "PYTHONPATH": str(_ROOT), **_SETTINGS},
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=log,
            start_new_session=True,
        )


def _kill(process: subprocess.Popen[bytes]) -> None:
    if process.poll() is None:
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()
