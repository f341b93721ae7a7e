"""Write-verify-rename: an earlier file stays untouched until the new one is whole on disk."""

from __future__ import annotations

import errno
import os
import shutil
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
    errno.EEXIST: ("a folder to write in", "a file in its place", "Choose another folder."),
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


_STAGE = ".labpipe.new"
STAGES = (_STAGE,)
"""Folders in which labpipe writes; what a killed process left there is no result."""


@contextmanager
def replacing_together(folder: Path) -> Iterator[Path]:
    """Hand out an empty folder, and move its files into `folder` once all went well.

    Parameters
    ----------
    folder : holds files that belong together, such as a result and its figures; files of other
        names stay. Nobody else may write in it meanwhile (`store.lock.locked`)

    Yields
    ------
    A folder inside it, on the same disk, for the new files and folders of files.

    Raises
    ------
    StoreError
        If the system refuses. As with any other way out of the block, what stood in `folder`
        before still stands there, and nothing else does.
    """
    stage = folder / _STAGE
    with storing(folder):
        if stage.exists():  # left by a process that was killed
            shutil.rmtree(stage)
        stage.mkdir()
    try:
        yield stage
        with storing(folder):
            _move_in(stage, folder)
    finally:
        shutil.rmtree(stage, ignore_errors=True)


def _move_in(stage: Path, folder: Path) -> None:
    files = [path for path in sorted(stage.rglob("*")) if path.is_file()]
    goals = [folder / path.relative_to(stage) for path in files]
    for goal in goals:
        goal.parent.mkdir(exist_ok=True)
    for path, goal in zip(files, goals, strict=True):
        path.replace(goal)
    _flush_folder(folder)


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
