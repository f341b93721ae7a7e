"""Claims of processes on tests, and whether these processes are alive."""

from __future__ import annotations

import os
import socket
import sys
import time
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path

MAX_CLAIM_AGE = 24 * 3600.0
"""s after which a claim of another host is taken for dead; no test takes as long."""


@dataclass(frozen=True, slots=True)
class Claim:
    """A process that works on a test.

    Parameters
    ----------
    host : name of its machine and container
    pid : process id
    process : start of the process, which distinguishes it from later ones with the same id; empty
        if not known
    since : time, s since 1970
    """

    host: str
    pid: int
    process: str
    since: float


def new_claim() -> Claim:
    """Make a claim of this process."""
    return Claim(_host(), os.getpid(), _start_time(os.getpid()), time.time())


def is_alive(claim: Claim) -> bool:
    """Return whether a claim is valid.

    Parameters
    ----------
    claim : of any process

    Returns
    -------
    For a process of this host, whether it is alive; for another host, whether the claim is recent.
    """
    if claim.host != _host():
        return abs(time.time() - claim.since) < MAX_CLAIM_AGE
    return _is_running(claim.pid) and _start_time(claim.pid) == claim.process


@cache
def _host() -> str:
    """Return the name of the machine with its namespace of process ids."""
    space = ""
    with suppress(OSError):
        space = str(Path("/proc/self/ns/pid").readlink())
    return f"{socket.gethostname()} {space}".strip()


def _start_time(pid: int) -> str:
    """Return the start of a process, in ticks since boot; empty if not known."""
    with suppress(OSError, IndexError):
        about = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace")
        boot = Path("/proc/sys/kernel/random/boot_id").read_text(encoding="utf-8").strip()
        return f"{boot} {about.rpartition(')')[2].split()[19]}"
    return ""


if sys.platform == "win32":
    import ctypes

    _QUERY, _STILL_ACTIVE = 0x1000, 259

    def _is_running(pid: int) -> bool:
        kernel = ctypes.windll.kernel32
        handle = kernel.OpenProcess(_QUERY, False, pid)
        if not handle:
            return False
        code = ctypes.c_ulong()
        kernel.GetExitCodeProcess(handle, ctypes.byref(code))
        kernel.CloseHandle(handle)
        return code.value == _STILL_ACTIVE

else:

    def _is_running(pid: int) -> bool:
        try:
            os.kill(pid, 0)
        except ProcessLookupError:
            return False
        except (PermissionError, OverflowError):
            return True
        return not _is_zombie(pid)

    def _is_zombie(pid: int) -> bool:
        """Return whether a process has ended but is not reaped."""
        with suppress(OSError, IndexError):
            about = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace")
            return about.rpartition(")")[2].split()[0] in {"Z", "X"}
        return False
