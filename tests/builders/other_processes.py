"""Tests and functions that end the processes of workers, and not that of pytest."""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from labpipe.process.run import Task


def _segfault() -> None:
    ctypes.string_at(0)


def _kill() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def _kill_worker() -> None:
    """Kill the worker of a cluster whose child this process is."""
    os.kill(os.getppid(), signal.SIGKILL)
    time.sleep(60.0)


def _kill_machine() -> None:
    """Kill the worker and what would start it again."""
    os.killpg(os.getpgid(os.getppid()), signal.SIGKILL)
    time.sleep(60.0)


ENDS: dict[str, Callable[[], Any]] = {
    "kill": _kill,
    "abort": os.abort,
    "segfault": _segfault,
    "exit": lambda: sys.exit(3),
    "hang": lambda: time.sleep(600.0),
    "kill the worker": _kill_worker,
    "kill the machine": _kill_machine,
}
"""Ways in which a process does not come to the end of its test, by the first line of a file
``end`` beside the test sheet; where the second line is ``once``, it happens once."""


class Spoiled(Task):
    """A test that does not come to its end in the process that processes it."""

    __slots__ = ()

    def __getattribute__(self, name: str) -> Any:
        """End where `process` asks for a field, and not where a task is handed on."""
        if name == "figures" and sys._getframe(1).f_code.co_name == "process":
            _end_as_said(self.source.parent / "end")
        return super().__getattribute__(name)


def _end_as_said(file: Path) -> None:
    if file.exists():
        end, _, times = file.read_text("utf-8").partition("\n")
        if times == "once":
            file.unlink()
        ENDS[end]()


def spoil(sheet: Path, end: str, *, once: bool = False) -> None:
    """Say how a test is to end."""
    (sheet.parent / "end").write_text(f"{end}\nonce" if once else end, "utf-8")
