"""Number of tests that this machine can process at the same time."""

from __future__ import annotations

import os
import re
from contextlib import suppress
from pathlib import Path

BYTES_PER_TEST = 750_000_000
"""Memory for the process of one test: a cantilever test of full size (70 MB of exports, figures as
SVG and PNG) takes 540 MB, a tensile test 175 MB, of which 85 MB are the libraries."""
_MEMINFO = Path("/proc/meminfo")
_CONTAINER = Path("/sys/fs/cgroup")


def default_jobs() -> int:
    """Return the default number of parallel tests: the cores, fewer if memory is short.

    Returns
    -------
    At least 1. The number of cores if the free memory is not known.
    """
    free = _free_memory()
    cores = _cores()
    return cores if free is None else max(1, min(cores, free // BYTES_PER_TEST))


def _cores() -> int:
    """Return the number of cores available to this process."""
    with suppress(AttributeError):  # neither on Windows nor on macOS
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _free_memory() -> int | None:
    """Return the available bytes on this machine and in this container."""
    limits = [free for free in (_free_on_machine(), _free_in_container()) if free is not None]
    return min(limits, default=None)


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
    with suppress(OSError, ValueError):  # "max" means no limit
        limit = int((_CONTAINER / "memory.max").read_text("ascii"))
        return max(limit - int((_CONTAINER / "memory.current").read_text("ascii")), 0)
    return None
