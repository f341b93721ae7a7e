from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from labpipe.errors import StoreError
from labpipe.store.replace import replacing, storing


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
        (errno.EIO, "expected a file that can be written, found .*Input/output error.*Look at"),
    ],
)
def test_refusals_of_the_system(number: int, text: str) -> None:
    with pytest.raises(StoreError, match=f"result.h5: {text}"), storing(Path("result.h5")):
        raise OSError(number, os.strerror(number))
