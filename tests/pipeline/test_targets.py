from __future__ import annotations

from pathlib import Path

import pytest

from labpipe.errors import UsageError
from labpipe.pipeline.targets import find_results, find_tests


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
