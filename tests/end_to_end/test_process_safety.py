"""Trouble while a test is processed: a full disk, an interrupt, another process at work.

Earlier results are as they were then, all of them, and raw files are never touched.
"""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from labpipe.store.lock import locked
from tests.builders import bad_input
from tests.builders.small_tests import Lab, Run, state


@pytest.fixture
def lab(processed: Lab, tmp_path: Path) -> Lab:
    """A test with earlier results."""
    return processed.copy(tmp_path)


def test_second_process_on_the_same_test(lab: Lab, run: Run) -> None:
    earlier = state(lab.processed)
    with locked(lab.processed):
        ran = run("process", lab.raw, "--no-figures")
    assert ran.status == 2
    assert "found another labpipe process at work in it. Wait until it is done" in ran.err
    assert state(lab.processed) == earlier


STAGES = (
    "labpipe.pipeline.process.read_inputs",
    "labpipe.pipeline.process.reduce_recordings",
    "labpipe.pipeline.process.write_result",
    "labpipe.pipeline.process.write_summary",
    "labpipe.report.figures.save_figures",
)


@pytest.mark.parametrize("place", ["result.h5", "summary.json", "wire-shapes.svg"])
def test_full_disk(lab: Lab, run: Run, monkeypatch: pytest.MonkeyPatch, place: str) -> None:
    """Wherever room runs out, no file of the earlier results is replaced."""
    import labpipe.store.replace as store

    flush = store._flush_to_disk

    def full_flush(path: Path) -> None:
        if place in path.name:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        flush(path)

    def full_figures(*arguments: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(store, "_flush_to_disk", full_flush)
    if place == "wire-shapes.svg":
        monkeypatch.setattr("labpipe.report.saving.save_page", full_figures)
    message = bad_input.Refused(lab, run)(lambda _: None)
    assert "full disk" in message or "No space left" in message
    assert not list(lab.home.rglob("*.tmp"))
    assert {path.name for path in lab.processed.iterdir()} == {
        "result.h5",
        "summary.json",
        "figures",
    }


@pytest.mark.parametrize("stage", STAGES)
def test_interrupt(lab: Lab, run: Run, monkeypatch: pytest.MonkeyPatch, stage: str) -> None:
    def interrupted(*arguments: object, **more: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(stage, interrupted)
    raw, earlier = state(lab.home / "raw"), state(lab.processed)
    ran = run("process", lab.raw)
    assert ran.status == 130
    assert "labpipe: interrupted; earlier results are as they were" in ran.err
    assert state(lab.home / "raw") == raw
    assert state(lab.processed) == earlier


@pytest.mark.skipif(os.name == "nt", reason="signals are another matter on Windows")
def test_real_interrupt(lab: Lab) -> None:
    raw, earlier = state(lab.home / "raw"), state(lab.processed)
    stopped = (
        "import signal, sys, time\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"  # a job in the background
        "import labpipe.pipeline.process as process\n"
        "def wait(*arguments):\n"
        "    print('here', flush=True)\n"
        "    for _ in range(600):\n"  # a signal that another thread is given ends no long sleep
        "        time.sleep(0.1)\n"
        "process.write_summary = wait\n"
        "from labpipe.cli import main\n"
        "sys.exit(main(sys.argv[1:]))\n"
    )
    command = [sys.executable, "-c", stopped, "process", str(lab.raw)]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "here\n"
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=30)
    assert process.returncode == 130
    assert "interrupted; earlier results are as they were" in said
    assert "Traceback" not in said
    assert state(lab.home / "raw") == raw
    assert state(lab.processed) == earlier
