from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from labpipe.errors import StoreError
from labpipe.store import replace as lock
from labpipe.store.replace import LOCK_FILE, locked

_HOLD = """
import sys
from pathlib import Path
from labpipe.store.replace import locked
with locked(Path(sys.argv[1])):
    sys.stdout.write("held\\n"); sys.stdout.flush(); sys.stdin.read()
"""


def test_second_process_is_kept_out_until_the_first_ends(tmp_path: Path) -> None:
    holder = subprocess.Popen(
        [sys.executable, "-c", _HOLD, str(tmp_path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    with holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == b"held\n"
        with (
            pytest.raises(StoreError, match=r"found another labpipe process at work in it\. Wait"),
            locked(tmp_path),
        ):
            pass
        holder.kill()  # a killed process leaves its lock file behind, but not its lock
    with locked(tmp_path):
        assert (tmp_path / LOCK_FILE).exists()
    assert list(tmp_path.iterdir()) == []


def test_folder_is_made_and_error_gives_the_lock_back(tmp_path: Path) -> None:
    folder = tmp_path / "a" / "b"
    with pytest.raises(ZeroDivisionError), locked(folder):
        raise ZeroDivisionError
    with locked(folder):
        pass
    assert list(folder.iterdir()) == []


def test_lock_file_removed_by_its_last_owner_is_made_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    try_lock, tries = lock._try_lock, []

    def removed_in_between(handle: int) -> bool:
        tries.append(handle)
        if len(tries) == 1:
            (tmp_path / LOCK_FILE).unlink()
        return try_lock(handle)

    monkeypatch.setattr(lock, "_try_lock", removed_in_between)
    with locked(tmp_path):
        assert len(tries) == 2
        assert (tmp_path / LOCK_FILE).exists()


@pytest.mark.parametrize("folder", ["x", "x/y"])
def test_file_in_place_of_the_folder(tmp_path: Path, folder: str) -> None:
    (tmp_path / "x").write_text("")
    said = f"{folder}: expected a folder to write in, found a file in its place. Choose another"
    with pytest.raises(StoreError, match=said), locked(tmp_path / folder):
        pass
    assert (tmp_path / "x").read_text() == ""


@pytest.mark.skipif(os.name == "nt", reason="links are another matter on Windows")
def test_a_link_makes_no_file_elsewhere(tmp_path: Path) -> None:
    (tmp_path / "here").mkdir()
    (tmp_path / "here" / LOCK_FILE).symlink_to(tmp_path / "elsewhere")
    with (
        pytest.raises(StoreError, match="found a link to another place"),
        locked(tmp_path / "here"),
    ):
        pass
    assert not (tmp_path / "elsewhere").exists()
