from __future__ import annotations

from pathlib import Path

import pytest

from labpipe.door.given_paths import fields_of, path_of, paths_of
from labpipe.errors import UsageError


def test_paths_of_any_kind(tmp_path: Path) -> None:
    assert path_of(str(tmp_path)) == path_of(tmp_path) == tmp_path
    assert path_of(tmp_path / "none") == tmp_path / "none"
    assert paths_of(tmp_path) == [tmp_path]
    assert paths_of([str(tmp_path), tmp_path / "a"]) == [tmp_path, tmp_path / "a"]
    assert paths_of(each for each in [tmp_path]) == [tmp_path]


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ("x" * 5000, "expected a file that can be used, found file name too long"),
        ("a\0b", r"'a\\x00b': expected a path, found embedded null"),
    ],
)
def test_paths_that_cannot_be(given: str, said: str) -> None:
    with pytest.raises(UsageError, match=said):
        path_of(given)
    with pytest.raises(UsageError, match=said):
        paths_of([given])


def test_no_path_at_all() -> None:
    with pytest.raises(UsageError, match="expected a folder with processed tests, found an empty"):
        paths_of([])


def test_one_field_or_several() -> None:
    assert fields_of("type") == ("type",)
    assert fields_of(["type", "length"]) == ("type", "length")
    assert fields_of(()) == ()
