"""How many tests this machine can take at a time."""

from __future__ import annotations

import os
import re
from contextlib import suppress
from pathlib import Path

BYTES_PER_TEST = 750_000_000
"""What the process of one test takes: a cantilever test of full size (70 MB of exports, figures as
SVG and PNG) was measured at 540 MB, a tensile test at 175 MB, of which 85 MB are the libraries."""
_MEMINFO = Path("/proc/meminfo")
_CONTAINER = Path("/sys/fs/cgroup")


def default_jobs() -> int:
    """Number of tests at a time by default: the cores, fewer where memory is short.

    Returns
    -------
    At least 1. Where nobody knows the free memory (neither the system nor `psutil`), the cores.
    """
    free = _free_memory()
    cores = _cores()
    return cores if free is None else max(1, min(cores, free // BYTES_PER_TEST))


def _cores() -> int:
    """Cores that this process may use."""
    with suppress(AttributeError):  # neither on Windows nor on macOS
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _free_memory() -> int | None:
    """Bytes that are free, or can be made free, on this machine and in this container."""
    known = [free for free in (_free_on_machine(), _free_in_container()) if free is not None]
    return min(known, default=None)


def _free_on_machine() -> int | None:
    with suppress(OSError, ValueError):
        match = re.search(r"^MemAvailable:\s+(\d+) kB$", _MEMINFO.read_text("ascii"), re.MULTILINE)
        if match:
            return 1024 * int(match[1])
    with suppress(ImportError):
        import psutil

        return int(psutil.virtual_memory().available)
    return None


def _free_in_container() -> int | None:
    with suppress(OSError, ValueError):  # "max" is no number: no limit
        most = int((_CONTAINER / "memory.max").read_text("ascii"))
        return max(most - int((_CONTAINER / "memory.current").read_text("ascii")), 0)
    return None
