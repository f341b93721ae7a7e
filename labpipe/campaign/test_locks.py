"""Who is at work on a test: a process on a host, and whether it still lives."""

from __future__ import annotations

import os
import socket
import sys
import time
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path

LONGEST = 24 * 3600.0
"""s: a claim of another host that is older is taken for dead; no test takes as long."""


@dataclass(frozen=True, slots=True)
class Claim:
    """A process that is at work on a test.

    Parameters
    ----------
    host : name of its machine, and of the container on it
    pid : its number there
    process : what tells it from another process that gets the same number later; empty where the
        system does not tell
    since : time, s since 1970
    """

    host: str
    pid: int
    process: str
    since: float


def new_claim() -> Claim:
    """The claim of this process, from now on."""
    return Claim(_host(), os.getpid(), _started(os.getpid()), time.time())


def is_alive(claim: Claim) -> bool:
    """Whether a claim still holds.

    Parameters
    ----------
    claim : of any process

    Returns
    -------
    Of a process of this host, whether it lives. Of another host, whether the claim is young: a
    time that is far ahead is that of a clock that was set back.
    """
    if claim.host != _host():
        return abs(time.time() - claim.since) < LONGEST
    return _lives(claim.pid) and _started(claim.pid) == claim.process


@cache
def _host() -> str:
    """Name of the machine; in a container with that of its numbers of processes."""
    space = ""
    with suppress(OSError):
        space = str(Path("/proc/self/ns/pid").readlink())
    return f"{socket.gethostname()} {space}".strip()


def _started(pid: int) -> str:
    """When a process was started, in ticks since the machine was; empty where nothing says it."""
    with suppress(OSError, IndexError):
        about = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace")
        boot = Path("/proc/sys/kernel/random/boot_id").read_text(encoding="utf-8").strip()
        return f"{boot} {about.rpartition(')')[2].split()[19]}"
    return ""


if sys.platform == "win32":
    import ctypes

    _QUERY, _STILL_ACTIVE = 0x1000, 259

    def _lives(pid: int) -> bool:
        kernel = ctypes.windll.kernel32
        handle = kernel.OpenProcess(_QUERY, False, pid)
        if not handle:
            return False
        code = ctypes.c_ulong()
        kernel.GetExitCodeProcess(handle, ctypes.byref(code))
        kernel.CloseHandle(handle)
        return code.value == _STILL_ACTIVE

else:

    def _lives(pid: int) -> bool:
        try:
            os.kill(pid, 0)
        except ProcessLookupError:
            return False
        except (PermissionError, OverflowError):
            return True
        return not _is_zombie(pid)

    def _is_zombie(pid: int) -> bool:
        """Whether a process has ended and only waits to be looked after."""
        with suppress(OSError, IndexError):
            about = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace")
            return about.rpartition(")")[2].split()[0] in {"Z", "X"}
        return False
