"""Replace one or several files atomically, and lock folders against other processes."""

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
"""Expected content, problem and remedy for error numbers of the operating system."""


@contextmanager
def replace_file(path: Path) -> Iterator[Path]:
    """Replace a file by the temporary file that the block writes, if the block succeeds.

    Parameters
    ----------
    path : file to be written or replaced

    Yields
    ------
    The path of the temporary file, in the folder of `path`. After the block, the file is flushed to
    the disk (fsync) and renamed.

    Raises
    ------
    StoreError
        If the operating system reports an error, such as a full disk, no permission or no folder.
        After this and any other error, the temporary file is removed and the file at `path` is
        unchanged.
    """
    temporary_path = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        with map_errors(path):
            yield temporary_path
            _flush_file(temporary_path)
            temporary_path.replace(path)
            _flush_folder(path.parent)
    finally:
        with suppress(OSError):
            temporary_path.unlink(missing_ok=True)


_NEW_FOLDER = ".labpipe.new"
_COMMITTED_FOLDER = ".labpipe.commit"
_OBSOLETE_FOLDER = ".labpipe.old"
TEMPORARY_FOLDERS = (_NEW_FOLDER, _COMMITTED_FOLDER, _OBSOLETE_FOLDER)
"""Names of temporary folders, in which a killed process may leave incomplete results."""
_FILES, _BACKUPS, _REMOVED_NAMES = "files", "aside", "gone"


@contextmanager
def replace_files(folder: Path, *, earlier_files: Iterable[str] = ()) -> Iterator[Path]:
    """Replace several files together by those that the block writes, if the block succeeds.

    Parameters
    ----------
    folder : folder of files that belong together, such as a result and its figures; files with
        other names are kept. The caller must lock the folder (`lock`)
    earlier_files : relative paths, with slashes, of files of earlier results, which are removed
        unless a new file replaces them

    Yields
    ------
    A folder inside `folder`, on the same disk, for the new files and their subfolders.

    Raises
    ------
    StoreError
        If the operating system reports an error. After this and any other error, `folder` contains
        the earlier files.

    Notes
    -----
    All new files are flushed to the disk. Then one rename of their folder makes them valid. A
    process that is killed before this rename leaves the earlier files. If it is killed after the
    rename and before the last move, `is_unfinished` is true, and `finish_moves` or the next writer
    moves the other files.
    """
    new_folder = folder / _NEW_FOLDER
    with map_errors(folder):
        finish_moves(folder)
        for leftover_folder in (new_folder, folder / _OBSOLETE_FOLDER):
            if leftover_folder.exists():  # a process was killed
                shutil.rmtree(leftover_folder)
        new_folder.mkdir()
        (new_folder / _FILES).mkdir()
    try:
        yield new_folder / _FILES
        with map_errors(folder):
            _commit_files(folder, earlier_files)
    finally:
        shutil.rmtree(new_folder, ignore_errors=True)


def is_unfinished(folder: Path) -> bool:
    """Return whether files are being replaced, or were when a process was killed."""
    return (folder / _COMMITTED_FOLDER).is_dir() and not (folder / _COMMITTED_FOLDER).is_symlink()


def exists_or_is_staged(path: Path) -> bool:
    """Return whether a file exists, or will exist after `finish_moves`."""
    return path.is_file() or (path.parent / _COMMITTED_FOLDER / _FILES / path.name).is_file()


def finish_moves(folder: Path) -> bool:
    """Finish the moves of a replacement that a killed process began.

    Parameters
    ----------
    folder : folder that the caller has locked (`lock`)

    Returns
    -------
    Whether there was a replacement to finish.

    Raises
    ------
    OSError
        If the operating system reports an error; the call can be repeated later.
    """
    if not is_unfinished(folder):
        return False
    moves = _list_moves(folder)
    for move in moves:
        move.apply()
    _remove_backups(folder, moves)
    return True


def _commit_files(folder: Path, earlier_files: Iterable[str]) -> None:
    """Make the new files valid and move them into the folder, or undo the moves after an error."""
    new_folder = folder / _NEW_FOLDER
    files = _list_files(new_folder / _FILES)
    outdated_names = [p for p in earlier_files if p not in files and (folder / p).is_file()]
    (new_folder / _REMOVED_NAMES).write_text("\n".join(outdated_names), encoding="utf-8")
    _check_destinations(folder, files)
    paths = list(new_folder.rglob("*"))
    with ThreadPoolExecutor(max_workers=8) as pool:  # disks flush several files faster in parallel
        list(pool.map(_flush_file, (path for path in paths if path.is_file())))
    for subfolder in (*(path for path in paths if path.is_dir()), new_folder):
        _flush_folder(subfolder)
    moves: list[_Move] = []
    try:
        new_folder.rename(folder / _COMMITTED_FOLDER)
        _flush_folder(folder)
        moves = _list_moves(folder)
        for move in moves:
            move.apply()
        _remove_backups(folder, moves)
    except BaseException:
        if is_unfinished(folder):
            for move in reversed(moves):
                move.undo()
            (folder / _COMMITTED_FOLDER).rename(new_folder)
        raise


class _Move(NamedTuple):
    """Move of `new_file`, if it exists, to `destination`, whose earlier file becomes `backup`."""

    new_file: Path
    destination: Path
    backup: Path

    def apply(self) -> None:
        """Move the earlier file to its backup, and the new file to the destination."""
        if self.destination.exists():
            self.backup.parent.mkdir(parents=True, exist_ok=True)
            self.destination.replace(self.backup)
        if self.new_file.exists():
            self.destination.parent.mkdir(parents=True, exist_ok=True)
            self.new_file.replace(self.destination)

    def undo(self) -> None:
        """Move both files back."""
        if not self.new_file.exists() and self.destination.exists():
            self.destination.replace(self.new_file)
        if self.backup.exists():
            self.backup.replace(self.destination)
        else:
            with suppress(OSError):  # the folder may contain other files
                self.destination.parent.rmdir()


def _list_moves(folder: Path) -> list[_Move]:
    """List the moves of removed files, then of new files, with result files last."""
    committed_folder = folder / _COMMITTED_FOLDER
    # A damaged list has names of files that do not exist.
    text = (committed_folder / _REMOVED_NAMES).read_text(encoding="utf-8", errors="replace")
    names = text.splitlines()
    names += sorted(_list_files(committed_folder / _FILES), key=lambda name: name.endswith(".h5"))
    _check_destinations(folder, names)
    return [
        _Move(committed_folder / _FILES / name, folder / name, committed_folder / _BACKUPS / name)
        for name in names
    ]


def _remove_backups(folder: Path, moves: Iterable[_Move]) -> None:
    """Flush the moves to the disk, then remove the backups of earlier files."""
    for parent in {move.destination.parent for move in moves} | {folder}:
        if parent.is_dir():
            _flush_folder(parent)
    shutil.rmtree(folder / _OBSOLETE_FOLDER, ignore_errors=True)
    (folder / _COMMITTED_FOLDER).rename(folder / _OBSOLETE_FOLDER)
    shutil.rmtree(folder / _OBSOLETE_FOLDER, ignore_errors=True)


def _list_files(folder: Path) -> list[str]:
    """List the relative paths of the files below a folder, with slashes."""
    paths = (path for path in sorted(folder.rglob("*")) if path.is_file())
    return [path.relative_to(folder).as_posix() for path in paths]


def _check_destinations(folder: Path, names: Iterable[str]) -> None:
    """Raise an OSError if a file cannot be moved to its name, or would leave the folder."""
    destinations = [folder / name for name in names]
    for parent in {destination.parent for destination in destinations}:
        if parent.exists() and not parent.is_dir():
            raise OSError(errno.ENOTDIR, os.strerror(errno.ENOTDIR))
        if not parent.resolve().is_relative_to(folder.resolve()):
            raise OSError(errno.ELOOP, os.strerror(errno.ELOOP))
    if any(destination.is_dir() for destination in destinations):
        raise OSError(errno.EISDIR, os.strerror(errno.EISDIR))


@contextmanager
def map_errors(path: Path) -> Iterator[None]:
    """Convert an `OSError` of the block, which writes `path`, to a `StoreError`."""
    try:
        yield
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            raise StoreError.about("store.disk_full", path) from error
        default_texts = ("a file that can be written", str(error), "Check the disk and try again.")
        expected, problem, remedy = _ERROR_TEXTS.get(error.errno or 0, default_texts)
        raise StoreError.about(
            "store.cannot_write", path, expected=expected, found=problem, remedy=remedy
        ) from error


def _flush_file(path: Path) -> None:
    """Flush a file to the disk."""
    with path.open("rb+") as file:
        os.fsync(file.fileno())


def _flush_folder(folder: Path) -> None:
    """Flush the entries of a folder to the disk."""
    if os.name == "nt":  # Windows cannot flush folders
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


LOCK_FILE = ".labpipe.lock"
"""Name of the file in a folder by which the folder is locked."""
_NO_FOLLOW = getattr(os, "O_NOFOLLOW", 0)  # Windows does not define it


@contextmanager
def lock(folder: Path, *, timeout: float = 0.0) -> Iterator[None]:
    """Lock a folder against other labpipe processes while the block runs.

    Parameters
    ----------
    folder : folder to be locked; created if it does not exist
    timeout : longest time to wait for another labpipe process, s

    Raises
    ------
    StoreError
        If another labpipe process has locked the folder, or the folder cannot be written.

    Notes
    -----
    The operating system locks an open file. The lock ends when its process ends, even if the
    process is killed.
    """
    path = folder / LOCK_FILE
    with map_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
        handle = _acquire_lock(path, time.monotonic() + timeout)
    try:
        yield
    finally:
        _release_lock(handle, path)


def _acquire_lock(path: Path, deadline: float) -> int:
    """Open and lock the lock file; try again if its previous owner has removed the file."""
    while True:
        handle = os.open(path, os.O_RDWR | os.O_CREAT | _NO_FOLLOW, 0o666)
        if not _try_lock(handle):
            os.close(handle)
            if time.monotonic() < deadline:
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
        """Lock an open file; return whether it was free."""
        try:
            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
        except OSError:
            return False
        return True

    def _release_lock(handle: int, path: Path) -> None:
        """Remove a locked file and end its lock."""
        os.close(handle)  # an open file cannot be removed on Windows
        with suppress(OSError):
            path.unlink()

else:
    import fcntl

    def _try_lock(handle: int) -> bool:
        """Lock an open file; return whether it was free."""
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        return True

    def _release_lock(handle: int, path: Path) -> None:
        """Remove a locked file and end its lock."""
        with suppress(OSError):
            path.unlink()  # the file is removed before the lock ends, so that others notice it
        os.close(handle)
