"""Whether a file is on a local disk or on a shared drive."""

from __future__ import annotations

import sys
from pathlib import Path

_SHARED = frozenset(
    {"nfs", "nfs4", "cifs", "smb3", "smbfs", "afs", "ceph", "lustre", "gpfs", "9p", "ncpfs"}
    | {"beegfs", "glusterfs", "virtiofs", "vboxsf", "vmhgfs", "davfs"}
)
"""File systems that are shared, or whose memory maps may be outdated."""


def shared_kind(mounts: str, path: str) -> str:
    """Return the type of the file system of a path.

    Parameters
    ----------
    mounts : text of ``/proc/self/mountinfo``
    path : absolute

    Returns
    -------
    A name such as ``nfs4``; empty if not known.
    """
    best, kind = "", ""
    for line in mounts.splitlines():
        before, _, after = line.partition(" - ")
        parts = before.split(" ")
        if len(parts) < 5 or not after:
            continue
        place = parts[4].replace("\\040", " ").replace("\\011", "\t").replace("\\134", "\\")
        is_above = path == place or path.startswith(place.rstrip("/") + "/")
        if is_above and len(place) >= len(best):
            best, kind = place, after.split(" ")[0]
    return kind


def is_on_this_machine(path: Path) -> bool:
    """Return whether a file is on a local disk.

    Parameters
    ----------
    path : of a file, which may be missing

    Returns
    -------
    False also if it is not known.
    """
    if sys.platform == "win32":
        import ctypes

        drive = path.resolve().drive
        removable, fixed = 2, 3
        kind = ctypes.windll.kernel32.GetDriveTypeW(f"{drive}\\")
        return not drive.startswith("\\\\") and kind in {removable, fixed}
    try:
        mounts = Path("/proc/self/mountinfo").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return False
    kind = shared_kind(mounts, str(path.resolve()))
    return bool(kind) and kind not in _SHARED and not kind.startswith("fuse")
