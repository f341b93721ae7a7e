from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from labpipe.errors import StoreError
from labpipe.store.replace import replacing, replacing_together, storing


def test_new_file_takes_the_place_of_the_old_one(tmp_path: Path) -> None:
    path = tmp_path / "x"
    path.write_text("old")
    with replacing(path) as temporary:
        assert temporary.parent == tmp_path
        temporary.write_text("new")
        assert path.read_text() == "old"
    assert path.read_text() == "new"
    assert list(tmp_path.iterdir()) == [path]


def test_any_way_out_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "x"
    path.write_text("old")
    with pytest.raises(ZeroDivisionError), replacing(path) as temporary:
        temporary.write_text(f"new {1 / 0}")
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_no_folder(tmp_path: Path) -> None:
    with (
        pytest.raises(StoreError, match=r"x: expected a folder to write in, found no such folder"),
        replacing(tmp_path / "none" / "x") as temporary,
    ):
        temporary.write_text("new")


@pytest.mark.parametrize(
    ("number", "text"),
    [
        (errno.ENOSPC, "expected room on the disk, found a full disk. Make room and process"),
        (errno.EDQUOT, "expected room on the disk, found a used-up quota. Make room"),
        (errno.EACCES, "expected a folder to write in, found no permission. Change"),
        (errno.EPERM, "expected a folder to write in, found no permission. Change"),
        (errno.EROFS, "expected a folder to write in, found a read-only disk. Choose"),
        (errno.ENOTDIR, "expected a folder to write in, found a file in its place. Choose"),
        (errno.EEXIST, "expected a folder to write in, found a file in its place. Choose"),
        (errno.EIO, "expected a file that can be written, found .*Input/output error.*Look at"),
    ],
)
def test_refusals_of_the_system(number: int, text: str) -> None:
    with pytest.raises(StoreError, match=f"result.h5: {text}"), storing(Path("result.h5")):
        raise OSError(number, os.strerror(number))


def contents(folder: Path) -> dict[str, str]:
    files = (path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): path.read_text() for path in files}


@pytest.fixture
def earlier(tmp_path: Path) -> Path:
    (tmp_path / "figures").mkdir()
    for name in ("a", "figures/b", "figures/c"):
        (tmp_path / name).write_text("old")
    return tmp_path


def test_files_are_replaced_together(earlier: Path) -> None:
    with replacing_together(earlier) as stage:
        (stage / "a").write_text("new")
        (stage / "figures").mkdir()
        (stage / "figures" / "b").write_text("new")
        assert contents(earlier)["a"] == "old"
    assert contents(earlier) == {"a": "new", "figures/b": "new", "figures/c": "old"}
    assert {path.name for path in earlier.iterdir()} == {"a", "figures"}


def write_and_leave(path: Path, way_out: type[BaseException]) -> None:
    path.write_text("new")
    raise way_out


@pytest.mark.parametrize("way_out", [KeyboardInterrupt, StoreError, OSError])
def test_all_files_stay_on_any_way_out(earlier: Path, way_out: type[BaseException]) -> None:
    before = contents(earlier)
    with pytest.raises(way_out), replacing_together(earlier) as stage:
        write_and_leave(stage / "a", way_out)
    assert contents(earlier) == before
    assert {path.name for path in earlier.iterdir()} == {"a", "figures"}


def test_what_a_killed_process_left_is_cleared_away(earlier: Path) -> None:
    left = earlier / ".labpipe.new" / "figures"
    left.mkdir(parents=True)
    (left / "b").write_text("half")
    with replacing_together(earlier):
        pass
    assert contents(earlier) == {"a": "old", "figures/b": "old", "figures/c": "old"}


def test_no_folder_for_files_together(tmp_path: Path) -> None:
    with (
        pytest.raises(StoreError, match=r"none: expected a folder to write in, found no such"),
        replacing_together(tmp_path / "none"),
    ):
        pass
