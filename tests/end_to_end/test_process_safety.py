"""Trouble while a test is processed: a full disk, an interrupt, another process at work.

Earlier results are as they were then, all of them, and raw files are never touched.
"""

from __future__ import annotations

import errno
import os
import random
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from labpipe.store.replace import finish_moves, is_unfinished, lock
from tests.builders.bad_input import refused
from tests.builders.reasons import runs
from tests.builders.small_pulls import small_pulls
from tests.builders.small_tests import Lab, Run, state
from tests.builders.tensile_tests import TensileLab


@pytest.fixture
def lab(processed: Lab, tmp_path: Path) -> Lab:
    """A test with earlier results."""
    return processed.copy(tmp_path)


def test_second_process_on_the_same_test(lab: Lab, run: Run) -> None:
    earlier = state(lab.processed)
    with lock(lab.processed):
        ran = run("process", lab.raw, "--no-figures")
    assert ran.status == 2
    assert "found another labpipe process at work in it. Wait until it is done" in ran.err
    assert state(lab.processed) == earlier


STAGES = (
    "labpipe.process.run.read_inputs",
    "labpipe.process.run.reduce_recordings",
    "labpipe.process.run.write_result",
    "labpipe.process.run.write_summary",
    "labpipe.report.figures.save_figures",
)
FILES = {"result.h5", "summary.json", "figures"}
PLACES = ("result.h5", "summary.json", "wire-shapes.svg", "timeline.svg")


@pytest.mark.slow
@pytest.mark.parametrize("place", PLACES)
def test_full_disk(lab: Lab, run: Run, monkeypatch: pytest.MonkeyPatch, place: str) -> None:
    """Wherever room runs out, no file of the earlier results is replaced."""
    import labpipe.store.replace as store

    flush = store._flush_file

    def full_flush(path: Path) -> None:
        if place in path.name:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        flush(path)

    def full_figures(*arguments: object, **more: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(store, "_flush_file", full_flush)
    if place == "wire-shapes.svg":
        monkeypatch.setattr("labpipe.report.figure_page._save_page", full_figures)
    _, message = refused(lab, run, lambda _: None)
    assert "full disk" in message or "No space left" in message
    assert not list(lab.home.rglob("*.tmp"))
    assert {path.name for path in lab.processed.iterdir()} == FILES | {"failure.json"}


@pytest.mark.slow
@pytest.mark.parametrize("stage", STAGES)
def test_interrupt(lab: Lab, run: Run, monkeypatch: pytest.MonkeyPatch, stage: str) -> None:
    def interrupted(*arguments: object, **more: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(stage, interrupted)
    raw, earlier = state(lab.home / "raw"), state(lab.processed)
    ran = run("process", lab.raw)
    assert ran.status == 130
    assert "labpipe: interrupted; earlier results are unchanged" in ran.err
    assert state(lab.home / "raw") == raw
    assert state(lab.processed) == earlier


KILLED = """
import os, sys
import labpipe.store.replace as store
left, apply = int(sys.argv.pop(1)), store._Move.apply
def killed(move):
    global left
    left -= 1
    if left == 0:
        os._exit(9)
    apply(move)
store._Move.apply = killed
from labpipe.cli import main
sys.exit(main(sys.argv[1:]))
"""


def killed_after(moves: int, *arguments: object) -> None:
    """Run a command in a process that ends when some files were replaced, as by a signal."""
    command = [sys.executable, "-c", KILLED, str(moves + 1), *map(str, arguments)]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    assert done.returncode == 9, done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("moves", [1, 4, 6])
def test_killed_while_files_are_replaced(lab: Lab, run: Run, moves: int) -> None:
    (first,) = runs(lab.processed)
    lab.override("branches.min_stroke", "3 mm")
    killed_after(moves, "process", lab.raw)
    message = (
        f"{lab.result}: expected a result with all its files, found one whose files are being"
        f" replaced, or were when a process was killed. Wait until it is done, or finish it:"
        f" `labpipe process {lab.result}`."
    )
    earlier = state(lab.home)
    report = run("report", lab.processed, "--out", lab.home / "report")
    assert (report.status, report.err) == (2, f"labpipe report: {message}\n")
    elsewhere = run("process", lab.result, "--out", lab.home / "out")
    assert (elsewhere.status, message in elsewhere.err) == (2, True)
    assert state(lab.home) == earlier
    again = run("process", lab.result)
    assert again.status == 0
    assert (
        f"labpipe process: {lab.processed}: completed a replacement of files that a killed process"
        " had left unfinished\n" in again.err
    )
    (second,) = runs(lab.processed)
    assert second != first
    assert {path.name for path in lab.processed.iterdir()} == FILES


@pytest.mark.slow
def test_killed_while_the_first_result_is_put_in_place(
    pristine: Lab, tmp_path: Path, run: Run
) -> None:
    lab = pristine.copy(tmp_path)
    killed_after(0, "process", lab.raw, "--no-figures")
    assert not lab.result.exists()
    assert "files are being replaced" in run("report", lab.home / "processed").err
    assert run("process", lab.home / "processed").status == 2  # no test.yaml there
    assert run("process", lab.result, "--no-figures").status == 0
    assert run("report", lab.home / "processed").status == 0


RUN = """
import sys
from pathlib import Path
from labpipe.campaign.executors import process_locally
from labpipe.process.run import Task
sheets = sorted(Path(sys.argv[1]).glob("raw/c/*/test.yaml"))
for task, attempted in process_locally((Task(sheet, png=True) for sheet in sheets), jobs=2):
    print(task.source.parent.name, type(attempted).__name__, flush=True)
"""
CHANGED = "overrides:\n  branches.min_stroke: {value: 3 mm, because: a test of the software}\n"


def started(home: Path) -> subprocess.Popen[str]:
    command = [sys.executable, "-c", RUN, str(home)]
    return subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, cwd=home
    )


def whole_run(labs: list[TensileLab], change: str = "") -> tuple[float, list[str]]:
    """Process all tests to the end; seconds, and the key of each, all of whose files are of it."""
    for lab in labs:
        text = lab.sheet.read_text("utf-8").replace(CHANGED, "")
        lab.sheet.write_text(text + change, "utf-8")
    start = time.monotonic()
    with started(labs[0].home) as process:
        printed = process.communicate()[0]
    assert process.returncode == 0
    assert len(printed.splitlines()) == len(labs)
    assert "Refused" not in printed
    keys = [runs(lab.processed) for lab in labs]
    assert {len(key) for key in keys} == {1}
    return time.monotonic() - start, [key for (key,) in keys]


def kill(home: Path, after: float, chance: random.Random) -> None:
    """Start a run, kill it or one process of a test after a time, and wait for all its processes.

    The run is stopped while its processes are listed, so that it starts no other one.
    """
    with started(home) as process:
        time.sleep(after)
        run = psutil.Process(process.pid)
        run.suspend()
        workers = run.children(recursive=True)
        alone = bool(workers) and chance.random() < 0.3
        (chance.choice(workers) if alone else run).kill()
        if alone:
            run.resume()
        process.communicate()
    _, alive = psutil.wait_procs(workers, timeout=60.0)
    assert not alive


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="where Linux tells of children")
@pytest.mark.parametrize(("tests", "kills"), [(3, 4), (6, 50)])
def test_killed_at_random_moments(tmp_path: Path, tests: int, kills: int) -> None:
    """Files of a test are those of one of two runs, never of both and of no third."""
    chance, labs = random.Random(20261122), small_pulls(tmp_path, tests)
    seen: set[int] = set()
    _, first = whole_run(labs)
    whole, second = whole_run(labs, CHANGED)
    assert not set(first) & set(second)
    for number in range(4 * kills):
        if number >= kills:
            if seen == {0, 1}:
                break
            whole *= 1.5  # the machine has become slower since it was timed: nothing was finished
        for lab in labs:
            text = lab.sheet.read_text("utf-8").replace(CHANGED, "")
            lab.sheet.write_text(text + CHANGED * (number % 2), "utf-8")
        kill(tmp_path, chance.uniform(0.1, 1.2) * whole, chance)
        for lab, keys in zip(labs, zip(first, second, strict=True), strict=True):
            if is_unfinished(lab.processed):
                with lock(lab.processed):
                    finish_moves(lab.processed)
            (key,) = runs(lab.processed)
            seen.add(keys.index(key))
    assert seen == {0, 1}
    assert whole_run(labs)[1] == first
    for lab in labs:
        assert {path.name for path in lab.processed.iterdir()} == FILES
