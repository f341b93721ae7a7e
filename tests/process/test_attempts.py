from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from labpipe import __version__
from labpipe.errors import CODES
from labpipe.process.attempts import Refused, Task, attempt, refuse
from labpipe.process.run import Processed
from labpipe.store.replace import locked
from tests.builders.pulls import broken, pull
from tests.builders.small_tests import state
from tests.builders.tensile_tests import TensileLab, write_pull


@pytest.fixture
def lab(tmp_path: Path) -> TensileLab:
    """One pull."""
    lab = TensileLab(tmp_path, "P-1")
    travel, force = pull(slack=0.001, seed=1)
    write_pull(lab, "tensile", broken(travel, force, at=0.018), travel)
    return lab


def tried(lab: TensileLab, **more: Any) -> Processed | Refused:
    return attempt(Task(lab.sheet, figures=False, **more))


def failure(lab: TensileLab) -> dict[str, Any]:
    said: dict[str, Any] = json.loads((lab.processed / "failure.json").read_text("utf-8"))
    return said


def test_a_failure_stands_beside_untouched_results_until_a_success(lab: TensileLab) -> None:
    assert isinstance(tried(lab), Processed)
    before, summary = state(lab.processed), lab.summary
    assert sorted(before) == ["result.h5", "summary.json"]
    export = lab.export.read_bytes()
    lab.export.write_bytes(export[:80])
    refused = tried(lab)
    assert isinstance(refused, Refused)
    after = state(lab.processed)
    assert after.pop("failure.json")
    assert after == before
    said = failure(lab)
    assert said.pop("run") == refused.run != summary["run"]
    assert said.pop("inputs")[0]["sha256"] != summary["inputs"][0]["sha256"]
    assert said == {
        "schema": 1,
        "labpipe": __version__,
        "test": "P-1",
        "code": "unreadable_export",
        "reason": refused.reason,
        "made_of": summary["made_of"],
    }
    lab.export.write_bytes(export)
    assert isinstance(tried(lab), Processed)
    assert sorted(state(lab.processed)) == ["result.h5", "summary.json"]


def test_the_key_is_that_of_the_results_that_were_to_come(
    lab: TensileLab, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patched:
        patched.setattr("labpipe.process.run.reduce_recordings", spoil(MemoryError()))
        refused = tried(lab)
    assert isinstance(refused, Refused)
    said, done = failure(lab), tried(lab)
    assert isinstance(done, Processed)
    assert said["run"] == refused.run == done.result.run
    assert said["inputs"] == lab.summary["inputs"]


def spoil(error: Exception) -> Callable[..., Any]:
    def spoiled(*_: object, **__: object) -> Any:
        raise error

    return spoiled


FAULT = (
    r"expected to get through, found a fault of labpipe itself \(ZeroDivisionError: of all\)\."
    r" Report it \(run.py, line \d+\) with the exports of the test; processed alone, it says more"
)


@pytest.mark.parametrize(
    ("error", "code", "said"),
    [
        (MemoryError(), "out_of_memory", "expected a test that goes into the memory"),
        (OSError(5, "Input/output error"), "system_refused", "a file that can be used"),
        (ZeroDivisionError("of\nall"), "fault_of_labpipe", FAULT),
    ],
)
def test_what_is_no_error_of_labpipe_has_a_code_too(
    lab: TensileLab, monkeypatch: pytest.MonkeyPatch, error: Exception, code: str, said: str
) -> None:
    monkeypatch.setattr("labpipe.process.run.reduce_recordings", spoil(error))
    refused = tried(lab)
    assert isinstance(refused, Refused)
    assert (refused.code, failure(lab)["code"]) == (code, code)
    assert re.search(said, refused.reason)


def test_a_fault_of_labpipe_shows_where_it_is_alone(
    lab: TensileLab, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("labpipe.process.run.reduce_recordings", spoil(ZeroDivisionError()))
    with pytest.raises(ZeroDivisionError):
        attempt(Task(lab.sheet, figures=False), is_alone=True)
    assert failure(lab)["code"] == "fault_of_labpipe"


def without_export(lab: TensileLab) -> None:
    lab.export.unlink()


def without_channel(lab: TensileLab) -> None:
    lab.override("sources.frame.channels.force.channel", "Nothing")


def without_protocol(lab: TensileLab) -> None:
    lab.edit("test.yaml", "protocol: tensile", "protocol: none-such")


def without_sheet(lab: TensileLab) -> None:
    lab.sheet.unlink()


def a_file_for_a_folder(lab: TensileLab) -> None:
    (lab.processed / "result.h5").mkdir(parents=True)


@pytest.mark.parametrize(
    ("change", "code"),
    [
        (without_export, "missing_export"),
        (without_channel, "missing_channel"),
        (without_protocol, "bad_sheet"),
        (without_sheet, "bad_sheet"),
        (a_file_for_a_folder, "cannot_store"),
    ],
)
def test_codes(lab: TensileLab, change: Callable[[TensileLab], None], code: str) -> None:
    change(lab)
    refused = tried(lab)
    assert isinstance(refused, Refused)
    assert (refused.code, failure(lab)["code"]) == (code, code)
    assert code in CODES
    assert failure(lab)["run"] == refused.run


def test_a_result_that_cannot_be_processed_again(lab: TensileLab) -> None:
    assert isinstance(tried(lab), Processed)
    lab.result.write_bytes(lab.result.read_bytes()[:1000])
    refused = attempt(Task(lab.result, figures=False))
    assert isinstance(refused, Refused)
    assert (refused.code, failure(lab)["code"]) == ("bad_result", "bad_result")


def test_another_process_in_the_folder_is_no_failure(lab: TensileLab) -> None:
    with locked(lab.processed):
        refused = tried(lab)
    assert isinstance(refused, Refused)
    assert refused.code == "in_use"
    assert not (lab.processed / "failure.json").exists()


def test_a_key_that_is_known_before_counts(lab: TensileLab, tmp_path: Path) -> None:
    task = Task(lab.sheet, tmp_path / "there" / "P", run="0a")
    assert refuse(task, "process_died", "words", is_read=False).run == "0a"
    said = json.loads((tmp_path / "there" / "P" / "failure.json").read_text("utf-8"))
    assert (said["run"], said["test"], said["inputs"]) == ("0a", "", [])


def test_no_folder_to_write_in(lab: TensileLab, tmp_path: Path) -> None:
    shutil.rmtree(lab.raw)
    (tmp_path / "file").write_text("")
    refused = tried(lab, goal=tmp_path / "file" / "P")
    assert isinstance(refused, Refused)
    assert refused.folder == tmp_path / "file" / "P"
