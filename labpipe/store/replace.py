"""Write-verify-rename in the folder of a test, by one process at a time."""

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

from labpipe.errors import StoreError, error_text

_CAUSES = {
    errno.ENOSPC: ("room on the disk", "a full disk", "Make room and process the test again."),
    errno.EDQUOT: ("room on the disk", "a used-up quota", "Make room and process the test again."),
    errno.EACCES: ("a folder to write in", "no permission", "Change the folder's permissions."),
    errno.EPERM: ("a folder to write in", "no permission", "Change the folder's permissions."),
    errno.EROFS: ("a folder to write in", "a read-only disk", "Choose another folder with --out."),
    errno.ENOENT: ("a folder to write in", "no such folder", "Make the folder first."),
    errno.ENOTDIR: ("a folder to write in", "a file in its place", "Choose another folder."),
    errno.ELOOP: ("a folder of its own", "a link to another place", "Take the link away."),
    errno.EISDIR: ("a file to replace", "a folder in its place", "Move the folder away."),
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
_COMMIT = ".labpipe.commit"
_DONE = ".labpipe.old"
STAGES = (_STAGE, _COMMIT, _DONE)
"""Folders in which labpipe writes; what a killed process left there is no result."""
_FILES, _ASIDE, _GONE = "files", "aside", "gone"


@contextmanager
def replacing_together(folder: Path, *, owned: Iterable[str] = ()) -> Iterator[Path]:
    """Hand out an empty folder, and move its files into `folder` once all went well.

    Parameters
    ----------
    folder : holds files that belong together, such as a result and its figures; files of other
        names stay. No other process may write in it meanwhile (`store.lock.locked`)
    owned : files below it, with slashes, that are taken away where there is no new one: they would
        speak for other numbers

    Yields
    ------
    A folder inside it, on the same disk, for the new files and folders of files.

    Raises
    ------
    StoreError
        If the system refuses. As with any other way out of the block, what stood in `folder`
        before still stands there, and nothing else does.

    Notes
    -----
    All new files are brought to the disk. Then one rename of the folder that holds them makes them
    those that count: a process killed before leaves all that was; after one killed later
    `is_cut_off` says so, and `finish_cut_off` moves the rest, as does whoever writes here next.
    """
    stage = folder / _STAGE
    with storing(folder):
        finish_cut_off(folder)
        for left in (stage, folder / _DONE):
            if left.exists():  # by a process that was killed
                shutil.rmtree(left)
        stage.mkdir()
        (stage / _FILES).mkdir()
    try:
        yield stage / _FILES
        with storing(folder):
            _commit(folder, owned)
    finally:
        shutil.rmtree(stage, ignore_errors=True)


def is_cut_off(folder: Path) -> bool:
    """Whether files of a folder are being replaced, or a process was killed when it did so."""
    return (folder / _COMMIT).is_dir() and not (folder / _COMMIT).is_symlink()


def is_there(path: Path) -> bool:
    """Whether there is such a file, or will be once `finish_cut_off` was called."""
    return path.is_file() or (path.parent / _COMMIT / _FILES / path.name).is_file()


def finish_cut_off(folder: Path) -> bool:
    """Bring to its end what a killed process began.

    Parameters
    ----------
    folder : no other process may write in it meanwhile

    Returns
    -------
    Whether there was anything to do.

    Raises
    ------
    OSError
        If the system refuses; it can be done later then.
    """
    if not is_cut_off(folder):
        return False
    moves = _moves(folder)
    for move in moves:
        move.make()
    _end(folder, moves)
    return True


def _commit(folder: Path, owned: Iterable[str]) -> None:
    stage = folder / _STAGE
    files = _files(stage / _FILES)
    gone = [name for name in owned if name not in files and (folder / name).is_file()]
    (stage / _GONE).write_text("\n".join(gone), encoding="utf-8")
    _require_places(folder, files)
    every = list(stage.rglob("*"))
    with ThreadPoolExecutor(max_workers=8) as pool:  # a disk takes several in one go
        list(pool.map(_flush_to_disk, (path for path in every if path.is_file())))
    for place in (*(path for path in every if path.is_dir()), stage):
        _flush_folder(place)
    moves: list[_Move] = []
    try:
        stage.rename(folder / _COMMIT)
        _flush_folder(folder)
        moves = _moves(folder)
        for move in moves:
            move.make()
        _end(folder, moves)
    except BaseException:
        if is_cut_off(folder):
            for move in reversed(moves):
                move.take_back()
            (folder / _COMMIT).rename(stage)
        raise


class _Move(NamedTuple):
    """What stands at `goal` goes aside, and the new file, if there is one, takes its place."""

    new: Path
    goal: Path
    aside: Path

    def make(self) -> None:
        if self.goal.exists():
            self.aside.parent.mkdir(parents=True, exist_ok=True)
            self.goal.replace(self.aside)
        if self.new.exists():
            self.goal.parent.mkdir(parents=True, exist_ok=True)
            self.new.replace(self.goal)

    def take_back(self) -> None:
        if not self.new.exists() and self.goal.exists():
            self.goal.replace(self.new)
        if self.aside.exists():
            self.aside.replace(self.goal)
        else:
            with suppress(OSError):  # where others have files, too
                self.goal.parent.rmdir()


def _moves(folder: Path) -> list[_Move]:
    """What is still to be done: files that go, then the new ones, and last the result."""
    commit = folder / _COMMIT
    gone = (commit / _GONE).read_text(encoding="utf-8").splitlines()
    names = [*gone, *sorted(_files(commit / _FILES), key=lambda name: name.endswith(".h5"))]
    _require_places(folder, names)
    return [_Move(commit / _FILES / name, folder / name, commit / _ASIDE / name) for name in names]


def _end(folder: Path, moves: Iterable[_Move]) -> None:
    """Bring the moves to the disk; then the earlier files are not needed any more."""
    for place in {move.goal.parent for move in moves} | {folder}:
        if place.is_dir():
            _flush_folder(place)
    shutil.rmtree(folder / _DONE, ignore_errors=True)
    (folder / _COMMIT).rename(folder / _DONE)
    shutil.rmtree(folder / _DONE, ignore_errors=True)


def _files(folder: Path) -> list[str]:
    """Files below a folder, with slashes."""
    found = (path for path in sorted(folder.rglob("*")) if path.is_file())
    return [path.relative_to(folder).as_posix() for path in found]


def _require_places(folder: Path, names: Iterable[str]) -> None:
    """Refuse what would not go, or would go elsewhere, before anything is moved."""
    goals = [folder / name for name in names]
    for place in {goal.parent for goal in goals}:
        if place.exists() and not place.is_dir():
            raise OSError(errno.ENOTDIR, os.strerror(errno.ENOTDIR))
        if not place.resolve().is_relative_to(folder.resolve()):
            raise OSError(errno.ELOOP, os.strerror(errno.ELOOP))
    if any(goal.is_dir() for goal in goals):
        raise OSError(errno.EISDIR, os.strerror(errno.EISDIR))


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
        message = error_text(path, "", expected=expected, found=found, remedy=remedy)
        is_full = error.errno in (errno.ENOSPC, errno.EDQUOT)
        raise StoreError(message, code="disk_full" if is_full else "") from error


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


LOCK_FILE = ".labpipe.lock"
_PAUSE = 0.05
_NOT_BY_LINK = getattr(os, "O_NOFOLLOW", 0)  # Windows has none


@contextmanager
def locked(folder: Path, *, patience: float = 0.0) -> Iterator[None]:
    """Keep other labpipe processes out of `folder` while the block runs.

    Parameters
    ----------
    folder : made if it is not there
    patience : s, how long to wait for another labpipe process

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
        handle = _own(path, time.monotonic() + patience)
    try:
        yield
    finally:
        _give_back(handle, path)


def _own(path: Path, end: float) -> int:
    """Open the lock file and lock it; anew if its last owner removed it in between."""
    while True:
        handle = os.open(path, os.O_RDWR | os.O_CREAT | _NOT_BY_LINK, 0o666)
        if not _try_lock(handle):
            os.close(handle)
            if time.monotonic() < end:
                time.sleep(_PAUSE)
                continue
            message = error_text(
                path.parent,
                "",
                expected="a folder that no other process is writing",
                found="another labpipe process at work in it",
                remedy="Wait until it is done, or end it, and try again.",
            )
            raise StoreError(message, code="in_use")
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
