"""What a run asks its machine: free memory, kinds of drives, and living processes."""

from __future__ import annotations

import os
import socket
import sys
import time
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import psutil

BYTES_PER_TEST = 750_000_000
"""Memory for the process of one test: a cantilever test of full size (70 MB of exports, figures as
SVG and PNG) takes 540 MB, a tensile test 175 MB, of which 85 MB are the libraries."""
_CONTAINER = Path("/sys/fs/cgroup")


def default_jobs() -> int:
    """Return the default number of parallel tests: the cores, fewer if memory is short.

    Returns
    -------
    At least 1.
    """
    free = int(psutil.virtual_memory().available)
    with suppress(OSError, ValueError):  # "max" means no limit
        limit = int((_CONTAINER / "memory.max").read_text("ascii"))
        free = min(free, limit - int((_CONTAINER / "memory.current").read_text("ascii")))
    return max(1, min(_cores(), free // BYTES_PER_TEST))


def _cores() -> int:
    """Return the number of cores available to this process."""
    with suppress(AttributeError):  # neither on Windows nor on macOS
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


_SHARED = frozenset(
    {"nfs", "nfs4", "cifs", "smb3", "smbfs", "afs", "ceph", "lustre", "gpfs", "9p", "ncpfs"}
    | {"beegfs", "glusterfs", "virtiofs", "vboxsf", "vmhgfs", "davfs", "afpfs", "webdav"}
)
"""File systems that are shared, or whose memory maps may be outdated."""


def is_on_this_machine(path: Path) -> bool:
    """Return whether a file is on a local disk.

    Parameters
    ----------
    path : of a file, which may be missing

    Returns
    -------
    False also if it is not known.
    """
    place, file_system, depth = path.resolve(), "", 0
    # On Windows, a list of all drives has those of the network, which may take seconds to answer.
    for mount in psutil.disk_partitions(all=sys.platform != "win32"):
        if place.is_relative_to(mount.mountpoint) and len(mount.mountpoint) >= depth:
            file_system, depth = mount.fstype.lower(), len(mount.mountpoint)
    return bool(file_system) and file_system not in _SHARED and not file_system.startswith("fuse")


MAX_CLAIM_AGE = 24 * 3600.0
"""s after which a claim of another host is taken for dead; no test takes as long."""


@dataclass(frozen=True, slots=True)
class Claim:
    """A process that works on a test.

    Parameters
    ----------
    host : name of its machine and container
    pid : process id
    process : start of the process, s since 1970, which distinguishes it from later ones with the
        same id
    since : time, s since 1970
    """

    host: str
    pid: int
    process: str
    since: float


def new_claim() -> Claim:
    """Make a claim of this process."""
    return Claim(_host(), os.getpid(), str(psutil.Process().create_time()), time.time())


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
    # s by which the start of a process moves when the clock of the machine is set
    max_clock_step = 2.0
    try:
        process = psutil.Process(claim.pid)
        is_dead = process.status() in {psutil.STATUS_ZOMBIE, psutil.STATUS_DEAD}
        return not is_dead and abs(process.create_time() - float(claim.process)) < max_clock_step
    except psutil.AccessDenied:
        return True
    except (psutil.NoSuchProcess, ValueError):  # or a claim of an earlier labpipe
        return False


@cache
def _host() -> str:
    """Return the name of the machine with its namespace of process ids."""
    space = ""
    with suppress(OSError):
        space = str(Path("/proc/self/ns/pid").readlink())
    return f"{socket.gethostname()} {space}".strip()
