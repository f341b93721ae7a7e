from __future__ import annotations

from pathlib import Path

import pytest

from labpipe.errors import UsageError
from labpipe.process.targets import (
    files_below,
    find_results,
    find_tests,
    refuse_repeated,
)


def test_tests_below_folders(tmp_path: Path) -> None:
    sheets = [tmp_path / "c" / name / "test.yaml" for name in ("b", "a")]
    for sheet in sheets:
        sheet.parent.mkdir(parents=True)
        sheet.touch()
    again = tmp_path / "result.h5"
    again.touch()
    found = find_tests([again, tmp_path / "c", sheets[0]])
    assert found == [again, sheets[1], sheets[0]]


@pytest.mark.parametrize(
    ("name", "found"), [("none", "found nothing of that name"), ("empty", "found neither")]
)
def test_no_test_there(tmp_path: Path, name: str, found: str) -> None:
    (tmp_path / "empty").mkdir()
    said = f"expected a test.yaml, a folder that holds one, or a result.h5, {found}"
    with pytest.raises(UsageError, match=said):
        find_tests([tmp_path / name])


def test_an_export_is_no_test(tmp_path: Path) -> None:
    export = tmp_path / "force.mat"
    export.write_bytes(b"MATLAB")
    with pytest.raises(
        UsageError, match=r"found a \.mat file\. An export belongs to a test: `labpipe new` writes"
    ):
        find_tests([export])


def test_results_are_found_once_and_in_order(tmp_path: Path) -> None:
    for name in ("T-2", "T-1", "H-1"):
        (tmp_path / "c" / name).mkdir(parents=True)
        (tmp_path / "c" / name / "result.h5").touch()
    one = tmp_path / "c" / "T-1" / "result.h5"
    assert find_results([one]) == [one]
    names = [file.parent.name for file in find_results([tmp_path, one, tmp_path / "c"])]
    assert names == ["H-1", "T-1", "T-2"]


def test_no_results(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"expected a result.h5, or a folder with .*, found none"):
        find_results([tmp_path])
    with pytest.raises(UsageError, match=r"found nothing of that name\. `labpipe process` makes"):
        find_results([tmp_path / "nowhere"])


@pytest.mark.parametrize("hidden", [".labpipe.new", ".trash", "T-1/.labpipe.new"])
def test_what_is_hidden_is_no_input(tmp_path: Path, hidden: str) -> None:
    """A process that was killed leaves its half of a result in a hidden folder."""
    for folder in ("T-1", hidden):
        (tmp_path / folder).mkdir(parents=True, exist_ok=True)
        (tmp_path / folder / "result.h5").touch()
        (tmp_path / folder / "test.yaml").touch()
    assert find_results([tmp_path]) == [tmp_path / "T-1" / "result.h5"]
    assert find_tests([tmp_path]) == [tmp_path / "T-1" / "test.yaml"]
    (tmp_path / "T-1" / ".hidden.yaml").touch()
    names = [path.name for path in files_below(tmp_path)]
    assert names == ["result.h5", "test.yaml"]


def test_a_folder_that_is_hidden_itself_may_be_named(tmp_path: Path) -> None:
    (tmp_path / ".lab" / "T-1").mkdir(parents=True)
    result = tmp_path / ".lab" / "T-1" / "result.h5"
    result.touch()
    assert find_results([tmp_path / ".lab"]) == [result]


def test_what_labpipe_was_writing_is_refused(tmp_path: Path) -> None:
    stage = tmp_path / "T-1" / ".labpipe.new"
    stage.mkdir(parents=True)
    (stage / "result.h5").touch()
    said = "found one that labpipe was writing when it was stopped. Process the test again."
    for target in (stage, stage / "result.h5"):
        with pytest.raises(UsageError, match=said):
            find_results([target])


def test_one_file_by_two_ways_is_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "T-1").mkdir()
    (tmp_path / "T-1" / "result.h5").touch()
    (tmp_path / "again").symlink_to(tmp_path / "T-1")
    monkeypatch.chdir(tmp_path)
    found = find_results([Path("T-1"), tmp_path / "T-1", Path("again/result.h5")])
    assert found == [Path("T-1/result.h5")]


def test_two_tests_that_share_a_name(tmp_path: Path) -> None:
    files = [tmp_path / name / "result.h5" for name in "abc"]
    refuse_repeated(zip(("T-1", "T-2", "T-3"), files, strict=True), "name")
    with pytest.raises(UsageError) as told:
        refuse_repeated(zip(("T-1", "T-2", "t-1"), files, strict=True), "name")
    assert str(told.value) == (
        f"{files[2]}: expected one test for each name, found a second for 't-1'. {files[0]} is the"
        " first: rename one of them in its test.yaml, or leave it out."
    )
