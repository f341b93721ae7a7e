"""Files are replaced together or not at all, by one process at a time."""

from __future__ import annotations

import errno
import itertools
import subprocess
import sys
from collections import Counter
from contextlib import suppress
from pathlib import Path

import pytest

from labpipe.errors import StoreError
from labpipe.store import replace
from labpipe.store.replace import (
    LOCK_FILE,
    exists_or_is_staged,
    finish_moves,
    is_unfinished,
    lock,
    map_errors,
    replace_files,
)
from tests.approved import Approve

NUMBERS = (
    *(errno.ENOSPC, errno.EDQUOT, errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOTDIR),
    *(errno.EEXIST, errno.ELOOP, errno.EISDIR, errno.EIO),
)


def test_refusals_of_the_system(approved: Approve) -> None:
    messages = []
    for number in NUMBERS:
        with pytest.raises(StoreError) as refused, map_errors(Path("result.h5")):
            raise OSError(number, errno.errorcode[number])
        messages.append(refused.value)
    approved(messages)


def contents(folder: Path) -> dict[str, str]:
    files = (path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): path.read_text() for path in files}


@pytest.fixture
def earlier(tmp_path: Path) -> Path:
    (tmp_path / "figures").mkdir()
    for name in ("a", "figures/b", "figures/c"):
        (tmp_path / name).write_text("old")
    return tmp_path


@pytest.mark.parametrize(
    ("owned", "kept"), [((), "c"), (("a", "figures/b", "figures/c", "figures/d"), "")]
)
def test_files_are_replaced_together(earlier: Path, owned: tuple[str, ...], kept: str) -> None:
    """What a killed process left goes, and what is owned and would show other numbers."""
    leftovers = earlier / ".labpipe.new" / "figures"
    leftovers.mkdir(parents=True)
    (leftovers / "x").write_text("half")
    with replace_files(earlier, earlier_files=owned) as stage:
        (stage / "a").write_text("new")
        (stage / "figures").mkdir()
        (stage / "figures" / "b").write_text("new")
        assert contents(earlier)["a"] == contents(earlier)["figures/b"] == "old"
    kept_files = {f"figures/{name}": "old" for name in kept}
    assert contents(earlier) == {"a": "new", "figures/b": "new"} | kept_files
    assert {path.name for path in earlier.iterdir()} == {"a", "figures"}


def write_and_leave(path: Path, way_out: type[BaseException]) -> None:
    path.write_text("new")
    raise way_out("stopped")


@pytest.mark.parametrize("way_out", [KeyboardInterrupt, StoreError, OSError])
def test_all_files_stay_on_any_way_out(earlier: Path, way_out: type[BaseException]) -> None:
    earlier_contents = contents(earlier)
    with pytest.raises(way_out), replace_files(earlier) as stage:
        write_and_leave(stage / "a", way_out)
    assert contents(earlier) == earlier_contents
    assert {path.name for path in earlier.iterdir()} == {"a", "figures"}


NEW = {"a": "new", "figures/b": "new", "figures/n": "new", "r.h5": "new"}


def write_new(stage: Path) -> None:
    for name in NEW:
        (stage / name).parent.mkdir(exist_ok=True)
        (stage / name).write_text("new")


@pytest.mark.parametrize("way_out", [KeyboardInterrupt, PermissionError])
@pytest.mark.parametrize("number", range(1, 10))
def test_moves_that_fail_half_way_are_taken_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int, way_out: type[BaseException]
) -> None:
    """As on a system that does not replace a file that somebody has open."""
    old_files = {"a": "old", "r.h5": "old"}
    for name, text in old_files.items():
        (tmp_path / name).write_text(text)
    countdown, move = [number], Path.replace

    def refused(path: Path, goal: Path) -> Path:
        countdown[0] -= 1
        if countdown[0] == 0:
            raise way_out
        return move(path, goal)

    monkeypatch.setattr(Path, "replace", refused)
    with suppress(KeyboardInterrupt, StoreError), replace_files(tmp_path) as stage:
        write_new(stage)
    is_over = number > 6  # two go aside, four come
    assert contents(tmp_path) == (NEW if is_over else old_files)
    assert is_over or {path.name for path in tmp_path.iterdir()} == set(old_files)


KILLED = """
import os, sys
from pathlib import Path
from labpipe.store.replace import finish_moves, replace_files
folder, left = Path(sys.argv[1]), int(sys.argv[2])
def end(event, _):
    global left
    if event in ("os.rename", "os.remove", "os.rmdir", "os.mkdir", "open"):
        left -= 1
        if left == 0:
            os._exit(9)  # as from a signal: nothing is put in order
sys.addaudithook(end)
if "finish" in sys.argv:
    finish_moves(folder)
else:
    with replace_files(folder, earlier_files=["figures/c"]) as stage:
        (stage / "figures").mkdir()
        for name in ("a", "figures/b", "figures/n", "r.h5"):
            (stage / name).write_text("new")
"""


def killed(folder: Path, number: int, *arguments: str) -> bool:
    """Replace files in a process that ends at a step; whether it came so far."""
    command = [sys.executable, "-c", KILLED, str(folder), str(number), *arguments]
    return subprocess.run(command, check=False).returncode == 9


def seen(folder: Path) -> dict[str, str]:
    """Contents but for what is hidden."""
    return {name: text for name, text in contents(folder).items() if not name.startswith(".")}


@pytest.mark.slow
def test_a_process_killed_at_any_step_leaves_all_old_or_all_new(tmp_path: Path) -> None:
    old = {"a": "old", "figures/b": "old", "figures/c": "old", "figures/own": "old", "r.h5": "old"}
    new = NEW | {"figures/own": "old"}
    outcomes = Counter[str]()
    for number in itertools.count(1):
        folder = tmp_path / str(number)
        for name, text in old.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_text(text)
        if not killed(folder, number):
            break
        if not is_unfinished(folder):
            assert seen(folder) in (old, new), number
            outcomes["old" if seen(folder) == old else "new"] += 1
            continue
        outcomes["cut off"] += 1
        assert exists_or_is_staged(folder / "r.h5")
        step = number % 7 + 1
        while killed(folder, step, "finish"):  # and who finishes it may be killed, too
            step += 3
        assert not is_unfinished(folder)
        assert seen(folder) == new, number
    assert contents(folder) == new
    assert min(outcomes["old"], outcomes["new"]) >= 2
    assert outcomes["cut off"] >= 10  # seven moves, and what lies between


def test_who_writes_next_finishes_it(tmp_path: Path) -> None:
    commit = tmp_path / ".labpipe.commit"
    (commit / "files").mkdir(parents=True)
    (commit / "files" / "r.h5").write_text("new")
    (commit / "gone").write_bytes(b"a\n\xff\0")
    (tmp_path / "a").write_text("old")
    assert exists_or_is_staged(tmp_path / "r.h5")
    assert not exists_or_is_staged(tmp_path / "s.h5")
    with pytest.raises(ZeroDivisionError), replace_files(tmp_path) as stage:
        write_and_leave(stage / "r.h5", ZeroDivisionError)
    assert contents(tmp_path) == {"r.h5": "new"}


@pytest.fixture
def elsewhere(tmp_path: Path) -> Path:
    """A folder beside the one that is written; nothing in it may change."""
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "b").write_text("own")
    (tmp_path / "here").mkdir()
    return tmp_path / "elsewhere"


def test_nothing_goes_through_a_link_or_into_the_place_of_a_folder(elsewhere: Path) -> None:
    folder = elsewhere.with_name("here")
    (folder / "figures").symlink_to(elsewhere)
    message = "expected a folder of its own, found a link to another place. Remove the link"
    with pytest.raises(StoreError, match=message), replace_files(folder) as stage:
        write_new(stage)
    assert contents(elsewhere) == {"b": "own"}
    assert [path.name for path in folder.iterdir()] == ["figures"]
    (folder / "figures").unlink()
    for place in ("a", "figures/b"):
        (folder / place / "inside").mkdir(parents=True)
        paths = sorted(folder.rglob("*"))
        message = "expected a file to replace, found a folder in its place. Move the folder away"
        with pytest.raises(StoreError, match=message), replace_files(folder) as stage:
            write_new(stage)
        assert sorted(folder.rglob("*")) == paths


@pytest.mark.parametrize("gone", ["../elsewhere/b", "{0}/b"])
def test_what_somebody_else_prepared_moves_nothing_elsewhere(elsewhere: Path, gone: str) -> None:
    commit = elsewhere.with_name("here") / ".labpipe.commit"
    (commit / "files").mkdir(parents=True)
    (commit / "gone").write_text(gone.format(elsewhere))
    with pytest.raises(OSError, match="symbolic links"):
        finish_moves(commit.parent)
    assert contents(elsewhere) == {"b": "own"}


_HOLD = """
import sys
from pathlib import Path
from labpipe.store.replace import lock
with lock(Path(sys.argv[1])):
    sys.stdout.write("held\\n"); sys.stdout.flush(); sys.stdin.read()
"""


def test_second_process_is_kept_out_until_the_first_ends(tmp_path: Path) -> None:
    holder = subprocess.Popen(
        [sys.executable, "-c", _HOLD, str(tmp_path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    with holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == b"held\n"
        with (
            pytest.raises(StoreError, match=r"found another labpipe process at work in it\. Wait"),
            lock(tmp_path),
        ):
            pass
        holder.kill()  # a killed process leaves its lock file behind, but not its lock
    with lock(tmp_path):
        assert (tmp_path / LOCK_FILE).exists()
    assert list(tmp_path.iterdir()) == []


LOCKS = [
    ("x", "expected a folder to write in, found a file in its place. Choose"),
    ("x/y", "expected a folder to write in, found a file in its place. Choose"),
    ("linked", "found a link to another place"),
]


@pytest.mark.parametrize(("place", "message"), LOCKS)
def test_what_stands_in_the_way_of_a_lock(tmp_path: Path, place: str, message: str) -> None:
    (tmp_path / "x").touch()
    (tmp_path / "linked").mkdir()
    (tmp_path / "linked" / LOCK_FILE).symlink_to(tmp_path / "elsewhere")
    with pytest.raises(StoreError, match=f"{place}.*: .*{message}"), lock(tmp_path / place):
        pass
    assert {path.name for path in tmp_path.iterdir()} == {"x", "linked"}


def test_lock_file_removed_by_its_last_owner_is_made_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "a" / "b"
    with pytest.raises(ZeroDivisionError), lock(folder):
        raise ZeroDivisionError
    try_lock, tries = replace._try_lock, []

    def removed_in_between(handle: int) -> bool:
        tries.append(handle)
        if len(tries) == 1:
            (folder / LOCK_FILE).unlink()
        return try_lock(handle)

    monkeypatch.setattr(replace, "_try_lock", removed_in_between)
    with lock(folder):
        assert len(tries) == 2
        assert (folder / LOCK_FILE).exists()
    assert list(folder.iterdir()) == []
