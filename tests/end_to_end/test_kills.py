"""Runs over many tests that are killed at any moment: files of a test are all old or all new."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import pytest

from labpipe.store.replace import finish_cut_off, is_cut_off, locked
from tests.builders.reasons import runs
from tests.builders.small_pulls import small_pulls
from tests.builders.tensile_tests import TensileLab

pytestmark = pytest.mark.skipif(os.name == "nt", reason="signals are another matter on Windows")

RUN = """
import sys
from pathlib import Path
from labpipe.campaign.executors import Task, local
sheets = sorted(Path(sys.argv[1]).glob("raw/c/*/test.yaml"))
for outcome in local(2)(Task(sheet, png=True) for sheet in sheets):
    print(outcome.sheet.parent.name, outcome.state, outcome.code, flush=True)
"""
CHANGED = "overrides:\n  branches.min_stroke: {value: 3 mm, because: a test of the software}\n"


def started(home: Path) -> subprocess.Popen[str]:
    command = [sys.executable, "-c", RUN, str(home)]
    return subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, cwd=home
    )


def children(process: int) -> list[int]:
    found = Path(f"/proc/{process}/task/{process}/children")
    return [int(each) for each in found.read_text("ascii").split()] if found.exists() else []


def seconds(labs: list[TensileLab]) -> float:
    """Process all to the end."""
    start = time.monotonic()
    with started(labs[0].home) as process:
        said = process.communicate()[0]
    assert process.returncode == 0
    assert len(said.splitlines()) == len(labs)
    assert "failed" not in said
    return time.monotonic() - start


def keys(labs: list[TensileLab]) -> list[str]:
    """Key of each test, all of whose files are there and of one run."""
    found = [runs(lab.processed) for lab in labs]
    assert {len(each) for each in found} == {1}
    return [key for (key,) in found]


def kill(home: Path, after: float, chance: random.Random) -> str:
    """Start a run and kill it, or one process of a test, after a time."""
    with started(home) as process:
        time.sleep(after)
        victims = children(process.pid)
        alone = bool(victims) and chance.random() < 0.3
        os.kill(chance.choice(victims) if alone else process.pid, signal.SIGKILL)
        process.communicate()
    until = time.monotonic() + 30.0  # what belonged to it goes, too
    while any(Path(f"/proc/{each}").exists() for each in victims):
        assert time.monotonic() < until
        time.sleep(0.02)
    return "a test" if alone else "the run"


def seen(lab: TensileLab, known: tuple[str, str]) -> str:
    """Which run the files of a test are of, the first or the second; no other, and no two."""
    word = ""
    if is_cut_off(lab.processed):
        with locked(lab.processed):
            finish_cut_off(lab.processed)
        word = "cut off, "
    (key,) = runs(lab.processed)
    assert key in known
    return word + ("first" if key == known[0] else "second")


def killed_and_looked_at(home: Path, *, tests: int, kills: int) -> None:
    chance = random.Random(20261122)
    labs = small_pulls(home, tests)
    texts = [lab.sheet.read_text("utf-8") for lab in labs]
    seconds(labs)
    first = keys(labs)
    for lab, text in zip(labs, texts, strict=True):
        lab.sheet.write_text(text + CHANGED, "utf-8")
    whole = seconds(labs)
    second = keys(labs)
    assert not set(first) & set(second)
    found, killed = Counter[str](), Counter[str]()
    for number in range(4 * kills):
        if number >= kills:
            if found["first"] and found["second"]:
                break
            whole *= 1.5  # the machine has become slower since it was timed: nothing was finished
        for lab, text in zip(labs, texts, strict=True):
            lab.sheet.write_text(text + CHANGED * (number % 2), "utf-8")
        killed[kill(home, chance.uniform(0.1, 1.2) * whole, chance)] += 1
        found.update(
            seen(*each) for each in zip(labs, zip(first, second, strict=True), strict=True)
        )
    sys.stdout.write(
        f"{sum(killed.values())} kills: {dict(killed)}; {whole:.1f} s a run; {dict(found)}\n"
    )
    assert found["first"]
    assert found["second"]
    for lab, text in zip(labs, texts, strict=True):
        lab.sheet.write_text(text, "utf-8")
    seconds(labs)
    assert keys(labs) == first
    for lab in labs:
        names = {path.name for path in lab.processed.iterdir()}
        assert names == {"result.h5", "summary.json", "figures"}


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="where Linux tells of children")
def test_killed_at_random_moments(tmp_path: Path) -> None:
    killed_and_looked_at(tmp_path, tests=3, kills=4)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="where Linux tells of children")
def test_killed_fifty_times(tmp_path: Path) -> None:
    killed_and_looked_at(tmp_path, tests=6, kills=50)
