"""One process at a time in the folder of a test."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from labpipe.errors import StoreError, complaint
from labpipe.store.replace import storing

LOCK_FILE = ".labpipe.lock"
_NOT_BY_LINK = getattr(os, "O_NOFOLLOW", 0)  # Windows has none


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Keep other labpipe processes out of `folder` while the block runs.

    Parameters
    ----------
    folder : made if it is not there

    Raises
    ------
    StoreError
        If another labpipe process works there, or the folder cannot be written.

    Notes
    -----
    The lock is the operating system's, on an open file: it ends with its process, however that
    ends, so that no stale lock can be left behind.
    """
    path = folder / LOCK_FILE
    with storing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        handle = _own(path)
    try:
        yield
    finally:
        _give_back(handle, path)


def _own(path: Path) -> int:
    """Open the lock file and lock it; anew if its last owner removed it in between."""
    while True:
        handle = os.open(path, os.O_RDWR | os.O_CREAT | _NOT_BY_LINK, 0o666)
        if not _try_lock(handle):
            os.close(handle)
            message = complaint(
                path.parent,
                "",
                expected="a folder that no other process is writing",
                found="another labpipe process at work in it",
                remedy="Wait until it is done, or end it, and try again.",
            )
            raise StoreError(message)
        if _is_still(handle, path):
            return handle
        os.close(handle)


def _is_still(handle: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(handle), path.stat())
    except FileNotFoundError:
        return False


if sys.platform == "win32":
    import msvcrt

    def _try_lock(handle: int) -> bool:
        try:
            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
        except OSError:
            return False
        return True

    def _give_back(handle: int, path: Path) -> None:
        os.close(handle)  # an open file cannot be removed on Windows
        with suppress(OSError):
            path.unlink()

else:
    import fcntl

    def _try_lock(handle: int) -> bool:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        return True

    def _give_back(handle: int, path: Path) -> None:
        with suppress(OSError):
            path.unlink()  # before the lock ends: who opens it now sees that it has gone
        os.close(handle)
