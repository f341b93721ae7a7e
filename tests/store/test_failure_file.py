from __future__ import annotations

import json
from pathlib import Path

import pytest

from labpipe.errors import StoreError
from labpipe.records.result import InputFile
from labpipe.store.failure_file import FAILURE_FILE, FailedTest, write_failure
from labpipe.store.replace import locked

FAILED = FailedTest("T\udce9", "time_limit", "a \u20ac", "0a", (InputFile("force", "f", "1b", 7),))


def test_what_is_known_of_a_failure(tmp_path: Path) -> None:
    write_failure(FAILED, tmp_path / "p" / "T")
    (file,) = (tmp_path / "p" / "T").iterdir()
    assert file.name == FAILURE_FILE
    said = json.loads(file.read_text("utf-8"))
    assert list(said) == [
        "schema", "labpipe", "test", "code", "reason", "run", "inputs", "made_of",
    ]  # fmt: skip
    assert said["test"] == "T\udce9"  # a name that no UTF-8 can say
    assert said["reason"] == "a \u20ac"
    assert said["inputs"] == [{"role": "force", "file": "f", "sha256": "1b"}]
    assert said["made_of"] == {}


def test_the_last_failure_counts(tmp_path: Path) -> None:
    write_failure(FAILED, tmp_path)
    write_failure(FailedTest("T", "in_time", ""), tmp_path)
    assert json.loads((tmp_path / FAILURE_FILE).read_text("utf-8"))["code"] == "in_time"


def test_none_while_another_process_writes(tmp_path: Path) -> None:
    with locked(tmp_path), pytest.raises(StoreError, match="another labpipe process"):
        write_failure(FAILED, tmp_path)
    assert not list(tmp_path.iterdir())
