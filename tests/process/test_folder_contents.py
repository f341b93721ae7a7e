from __future__ import annotations

from pathlib import Path

import pytest

from labpipe.process.folder_contents import folders_of_tests, look_into
from tests.builders.load_frames import mts_suite
from tests.builders.small_tests import Lab


def test_exports_are_known_by_their_content(lab: Lab) -> None:
    (lab.raw / "force.mat").rename(lab.raw / "take 7.txt")
    (lab.raw / "notes.md").write_text("of the test", encoding="utf-8")
    (lab.raw / ".hidden").write_text("x", encoding="utf-8")

    found = look_into(lab.raw)

    assert {each.name: each.reader for each in found.exports} == {
        "take 7.txt": "dspace-mat",
        "take.csv": "motive-csv",
    }
    assert found.others == {"truth.json": "JSON"}


@pytest.mark.parametrize(
    ("name", "content", "why"),
    [
        ("cut.mat", b"MATLAB 5.0 MAT-file" + bytes(200), "expected a whole MAT v5 file"),
        ("empty.csv", b"", "expected a file with content"),
        ("a\nb.csv", mts_suite(), "its name has control characters; rename it"),
    ],
)
def test_what_is_no_export_is_said(tmp_path: Path, name: str, content: bytes, why: str) -> None:
    (tmp_path / name).write_bytes(content)

    found = look_into(tmp_path)

    assert found.exports == ()
    said = {**found.unread, **found.others}
    assert list(said) == [name]
    assert said[name].startswith(why)
    assert bool(found.unread) == name.endswith((".mat", "empty.csv"))  # these may still be written


def test_a_folder_that_is_not_there_holds_nothing(tmp_path: Path) -> None:
    found = look_into(tmp_path / "none")
    assert (found.exports, found.others) == ((), {})


def test_folders_of_a_campaign(tmp_path: Path) -> None:
    for name in ("B", "A", ".git", "empty"):
        (tmp_path / name).mkdir()
    for name in ("B", "A", ".git"):
        (tmp_path / name / "x.csv").write_text("x", encoding="utf-8")
    assert folders_of_tests(tmp_path) == [tmp_path / "A", tmp_path / "B"]
    (tmp_path / "test.yaml").write_text("test: x", encoding="utf-8")
    assert folders_of_tests(tmp_path) == []
    assert folders_of_tests(tmp_path / "A") == []
