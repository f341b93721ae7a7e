"""Write-verify-rename: an earlier file stays untouched until the new one is whole on disk."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from labpipe.errors import StoreError, complaint

_CAUSES = {
    errno.ENOSPC: ("room on the disk", "a full disk", "Make room and process the test again."),
    errno.EDQUOT: ("room on the disk", "a used-up quota", "Make room and process the test again."),
    errno.EACCES: ("a folder to write in", "no permission", "Change the folder's permissions."),
    errno.EPERM: ("a folder to write in", "no permission", "Change the folder's permissions."),
    errno.EROFS: ("a folder to write in", "a read-only disk", "Choose another folder with --out."),
    errno.ENOENT: ("a folder to write in", "no such folder", "Make the folder first."),
    errno.ENOTDIR: ("a folder to write in", "a file in its place", "Choose another folder."),
}


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Hand out a temporary file beside `path`, and rename it to `path` once all went well.

    Parameters
    ----------
    path : file to be written or replaced

    Yields
    ------
    The temporary file to write; it is brought to the disk (fsync) before the rename.

    Raises
    ------
    StoreError
        If the system refuses: full disk, no permission, no folder. As with any other way out of
        the block, the temporary file is gone and what stood at `path` before still stands there.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        with storing(path):
            yield temporary
            _flush_to_disk(temporary)
            temporary.replace(path)
            _flush_folder(path.parent)
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


@contextmanager
def storing(path: Path) -> Iterator[None]:
    """Say what the system refuses while `path` is written as a `StoreError`."""
    try:
        yield
    except OSError as error:
        expected, found, remedy = _CAUSES.get(
            error.errno or 0,
            ("a file that can be written", str(error), "Look at the disk and try again."),
        )
        message = complaint(path, "", expected=expected, found=found, remedy=remedy)
        raise StoreError(message) from error


def _flush_to_disk(path: Path) -> None:
    with path.open("rb+") as file:
        os.fsync(file.fileno())


def _flush_folder(folder: Path) -> None:
    if os.name == "nt":  # Windows has no handle of a folder that could be flushed
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
