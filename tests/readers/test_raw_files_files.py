from __future__ import annotations

import os
from pathlib import Path

import pytest

from labpipe.errors import ReadError
from labpipe.readers.raw_files import BROKEN, read_head, reading


@pytest.mark.parametrize("kind", BROKEN)
def test_every_library_error_names_the_file(tmp_path: Path, kind: type[Exception]) -> None:
    with (
        pytest.raises(ReadError, match=r"take\.csv: expected a table, found a damaged one \(tail"),
        reading(tmp_path / "take.csv", "a table"),
    ):
        raise kind("tail missing")


def test_an_error_without_words_is_told_by_its_type(tmp_path: Path) -> None:
    with (
        pytest.raises(ReadError, match=r"\(MemoryError\)\. Export the recording again"),
        reading(tmp_path / "take.csv", "a table"),
    ):
        raise MemoryError


def test_an_error_of_our_own_passes(tmp_path: Path) -> None:
    with pytest.raises(ReadError, match=r"^mine$"), reading(tmp_path / "take.csv", "a table"):
        raise ReadError("mine")


def test_an_interrupt_passes(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt), reading(tmp_path / "take.csv", "a table"):
        raise KeyboardInterrupt


def test_what_cannot_be_opened_is_named(tmp_path: Path) -> None:
    with pytest.raises(ReadError, match=r"expected a file, found none of that name\. Check"):
        read_head(tmp_path / "absent.csv")
    with pytest.raises(ReadError, match=r"expected a file, found a folder\. Name one"):
        read_head(tmp_path)
    empty = tmp_path / "empty.csv"
    empty.touch()
    with pytest.raises(
        ReadError, match=r"expected a file with content, found an empty file \(0 bytes\)"
    ):
        read_head(empty)


@pytest.mark.parametrize(
    ("name", "why"),
    [("a" * 300, "File name too long"), ("loop", "Too many levels of symbolic links")],
)
def test_a_name_that_leads_nowhere(tmp_path: Path, name: str, why: str) -> None:
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    with pytest.raises(ReadError) as refused:
        read_head(tmp_path / name)
    assert str(refused.value) == (
        f"{tmp_path / name}: expected a file, found one that cannot be opened ({why}). Check the"
        " name and the folder."
    )


def test_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(ReadError, match=r"expected a file, found a pipe or a device\. Name a pl"):
        read_head(tmp_path / "pipe")


def test_a_forbidden_file_is_named(tmp_path: Path) -> None:
    with (
        pytest.raises(ReadError, match=r"found one that may not be read\. Check its permissions"),
        reading(tmp_path / "take.csv", "a file"),
    ):
        raise PermissionError
