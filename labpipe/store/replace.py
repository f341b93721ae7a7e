"""Replace files in the folder of a test atomically, by one process at a time."""

from __future__ import annotations

import errno
import os
import shutil
import sys
import time
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import NamedTuple

from labpipe.errors import StoreError

_ERROR_TEXTS = {
    errno.EACCES: ("a folder to write in", "no permission", "Change the folder's permissions."),
    errno.EPERM: ("a folder to write in", "no permission", "Change the folder's permissions."),
    errno.EROFS: ("a folder to write in", "a read-only disk", "Choose another folder with --out."),
    errno.ENOENT: ("a folder to write in", "no such folder", "Make the folder first."),
    errno.ENOTDIR: ("a folder to write in", "a file in its place", "Choose another folder."),
    errno.ELOOP: ("a folder of its own", "a link to another place", "Remove the link."),
    errno.EISDIR: ("a file to replace", "a folder in its place", "Move the folder away."),
    errno.EEXIST: ("a folder to write in", "a file in its place", "Choose another folder."),
}


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a temporary file beside `path`, and rename it to `path` on success.

    Parameters
    ----------
    path : file to be written or replaced

    Yields
    ------
    The temporary file to write; it is flushed to the disk (fsync) before the rename.

    Raises
    ------
    StoreError
        On an error of the system: full disk, no permission, no folder. As after any other error,
        the temporary file is removed and the earlier file at `path` is unchanged.
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
_COMMIT = ".labpipe.commit"
_DONE = ".labpipe.old"
STAGES = (_STAGE, _COMMIT, _DONE)
"""Temporary folders of labpipe; files of a killed process in them are not results."""
_FILES, _REPLACED, _REMOVED = "files", "aside", "gone"


@contextmanager
def replacing_together(folder: Path, *, owned: Iterable[str] = ()) -> Iterator[Path]:
    """Yield an empty folder, and move its files into `folder` on success.

    Parameters
    ----------
    folder : contains files that belong together, such as a result and its figures; files with other
        names are kept. No other process may write in it meanwhile (`locked`)
    owned : files below it, with slashes, that are removed if there is no new one, because they
        belong to earlier numbers

    Yields
    ------
    A folder inside it, on the same disk, for the new files and folders of files.

    Raises
    ------
    StoreError
        On an error of the system. As after any other error, the content of `folder` is unchanged.

    Notes
    -----
    All new files are flushed to the disk. Then one rename of their folder makes them valid: a
    process killed before that leaves the earlier files; if it is killed later, `is_cut_off` is
    true, and `finish_cut_off` or the next writer moves the remaining files.
    """
    stage = folder / _STAGE
    with storing(folder):
        finish_cut_off(folder)
        for leftover in (stage, folder / _DONE):
            if leftover.exists():  # from a killed process
                shutil.rmtree(leftover)
        stage.mkdir()
        (stage / _FILES).mkdir()
    try:
        yield stage / _FILES
        with storing(folder):
            _commit(folder, owned)
    finally:
        shutil.rmtree(stage, ignore_errors=True)


def is_cut_off(folder: Path) -> bool:
    """Return whether files are being replaced, or a process was killed while replacing them."""
    return (folder / _COMMIT).is_dir() and not (folder / _COMMIT).is_symlink()


def exists_or_is_staged(path: Path) -> bool:
    """Return whether a file exists, or will exist after `finish_cut_off`."""
    return path.is_file() or (path.parent / _COMMIT / _FILES / path.name).is_file()


def finish_cut_off(folder: Path) -> bool:
    """Finish the replacement that a killed process began.

    Parameters
    ----------
    folder : no other process may write in it meanwhile

    Returns
    -------
    Whether there was a replacement to finish.

    Raises
    ------
    OSError
        On an error of the system; it can be repeated later.
    """
    if not is_cut_off(folder):
        return False
    moves = _list_moves(folder)
    for move in moves:
        move.apply()
    _finish(folder, moves)
    return True


def _commit(folder: Path, owned: Iterable[str]) -> None:
    stage = folder / _STAGE
    files = _list_files(stage / _FILES)
    removed = [name for name in owned if name not in files and (folder / name).is_file()]
    (stage / _REMOVED).write_text("\n".join(removed), encoding="utf-8")
    _require_places(folder, files)
    paths = list(stage.rglob("*"))
    with ThreadPoolExecutor(max_workers=8) as pool:  # disks flush several files faster in parallel
        list(pool.map(_flush_to_disk, (path for path in paths if path.is_file())))
    for subfolder in (*(path for path in paths if path.is_dir()), stage):
        _flush_folder(subfolder)
    moves: list[_Move] = []
    try:
        stage.rename(folder / _COMMIT)
        _flush_folder(folder)
        moves = _list_moves(folder)
        for move in moves:
            move.apply()
        _finish(folder, moves)
    except BaseException:
        if is_cut_off(folder):
            for move in reversed(moves):
                move.undo()
            (folder / _COMMIT).rename(stage)
        raise


class _Move(NamedTuple):
    """Move of the file at `destination` to `aside`, and of `new`, if any, in its place."""

    new: Path
    destination: Path
    aside: Path

    def apply(self) -> None:
        if self.destination.exists():
            self.aside.parent.mkdir(parents=True, exist_ok=True)
            self.destination.replace(self.aside)
        if self.new.exists():
            self.destination.parent.mkdir(parents=True, exist_ok=True)
            self.new.replace(self.destination)

    def undo(self) -> None:
        if not self.new.exists() and self.destination.exists():
            self.destination.replace(self.new)
        if self.aside.exists():
            self.aside.replace(self.destination)
        else:
            with suppress(OSError):  # if it contains other files
                self.destination.parent.rmdir()


def _list_moves(folder: Path) -> list[_Move]:
    """Return the remaining moves: removed files, then new ones, the result last."""
    commit = folder / _COMMIT
    removed = (commit / _REMOVED).read_text(encoding="utf-8").splitlines()
    names = [*removed, *sorted(_list_files(commit / _FILES), key=lambda name: name.endswith(".h5"))]
    _require_places(folder, names)
    return [
        _Move(commit / _FILES / name, folder / name, commit / _REPLACED / name) for name in names
    ]


def _finish(folder: Path, moves: Iterable[_Move]) -> None:
    """Flush the moves to the disk, then delete the earlier files."""
    for parent in {move.destination.parent for move in moves} | {folder}:
        if parent.is_dir():
            _flush_folder(parent)
    shutil.rmtree(folder / _DONE, ignore_errors=True)
    (folder / _COMMIT).rename(folder / _DONE)
    shutil.rmtree(folder / _DONE, ignore_errors=True)


def _list_files(folder: Path) -> list[str]:
    """Return the files below a folder, with slashes."""
    paths = (path for path in sorted(folder.rglob("*")) if path.is_file())
    return [path.relative_to(folder).as_posix() for path in paths]


def _require_places(folder: Path, names: Iterable[str]) -> None:
    """Raise an OSError for impossible moves, or moves out of the folder, before any move."""
    destinations = [folder / name for name in names]
    for parent in {destination.parent for destination in destinations}:
        if parent.exists() and not parent.is_dir():
            raise OSError(errno.ENOTDIR, os.strerror(errno.ENOTDIR))
        if not parent.resolve().is_relative_to(folder.resolve()):
            raise OSError(errno.ELOOP, os.strerror(errno.ELOOP))
    if any(destination.is_dir() for destination in destinations):
        raise OSError(errno.EISDIR, os.strerror(errno.EISDIR))


@contextmanager
def storing(path: Path) -> Iterator[None]:
    """Turn errors of the system while writing `path` into a `StoreError`."""
    try:
        yield
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            raise StoreError.about("store.disk_full", path) from error
        unknown = ("a file that can be written", str(error), "Check the disk and try again.")
        expected, found, remedy = _ERROR_TEXTS.get(error.errno or 0, unknown)
        raise StoreError.about(
            "store.cannot_write", path, expected=expected, found=found, remedy=remedy
        ) from error


def _flush_to_disk(path: Path) -> None:
    with path.open("rb+") as file:
        os.fsync(file.fileno())


def _flush_folder(folder: Path) -> None:
    if os.name == "nt":  # Windows cannot flush folders
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


LOCK_FILE = ".labpipe.lock"
_NO_FOLLOW = getattr(os, "O_NOFOLLOW", 0)  # Windows has none


@contextmanager
def locked(folder: Path, *, patience: float = 0.0) -> Iterator[None]:
    """Lock a folder against other labpipe processes while the block runs.

    Parameters
    ----------
    folder : created if it does not exist
    patience : s, time to wait for another labpipe process

    Raises
    ------
    StoreError
        If another labpipe process works there, or the folder cannot be written.

    Notes
    -----
    The lock is that of the operating system on an open file: it ends with its process, so that
    there are no stale locks.
    """
    path = folder / LOCK_FILE
    with storing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        handle = _acquire(path, time.monotonic() + patience)
    try:
        yield
    finally:
        _release(handle, path)


def _acquire(path: Path, end: float) -> int:
    """Open the lock file and lock it; repeat if its previous owner removed it meanwhile."""
    while True:
        handle = os.open(path, os.O_RDWR | os.O_CREAT | _NO_FOLLOW, 0o666)
        if not _try_lock(handle):
            os.close(handle)
            if time.monotonic() < end:
                time.sleep(0.05)
                continue
            raise StoreError.about("store.in_use", path.parent)
        with suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(handle), path.stat()):
                return handle
        os.close(handle)


if sys.platform == "win32":
    import msvcrt

    def _try_lock(handle: int) -> bool:
        try:
            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
        except OSError:
            return False
        return True

    def _release(handle: int, path: Path) -> None:
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

    def _release(handle: int, path: Path) -> None:
        with suppress(OSError):
            path.unlink()  # before the lock ends, so that others notice the removal
        os.close(handle)
