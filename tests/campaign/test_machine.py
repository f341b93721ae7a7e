from __future__ import annotations

import os
from pathlib import Path

import pytest

from labpipe.campaign import machine
from labpipe.campaign.machine import BYTES_PER_TEST, default_jobs


@pytest.fixture
def system(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A machine of eight cores, whose memory files state."""
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(8)), raising=False)
    monkeypatch.setattr(machine, "_MEMINFO", tmp_path / "meminfo")
    monkeypatch.setattr(machine, "_CONTAINER", tmp_path)
    return tmp_path


def free(system: Path, tests: float) -> None:
    kilobytes = int(tests * BYTES_PER_TEST / 1024)
    (system / "meminfo").write_text(f"MemTotal: 99 kB\nMemAvailable: {kilobytes} kB\n")


@pytest.mark.parametrize(("tests", "jobs"), [(0.2, 1), (1.5, 1), (3.5, 3), (100.0, 8)])
def test_the_cores_but_no_more_than_the_memory_takes(system: Path, tests: float, jobs: int) -> None:
    free(system, tests)
    assert default_jobs() == jobs


@pytest.mark.parametrize(("most", "used", "jobs"), [("max", 0, 8), ("3000000000", 1e9, 2)])
def test_a_container_may_have_less(system: Path, most: str, used: float, jobs: int) -> None:
    free(system, 100.0)
    (system / "memory.max").write_text(f"{most}\n")
    (system / "memory.current").write_text(f"{used:.0f}\n")
    assert default_jobs() == jobs


def test_cores_where_the_system_does_not_say(system: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(os, "sched_getaffinity", raising=False)
    monkeypatch.setattr(os, "cpu_count", lambda: 5)
    free(system, 100.0)
    assert default_jobs() == 5
