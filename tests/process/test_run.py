"""Tests that are found, processed and refused."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from labpipe import __version__
from labpipe.errors import CODES, ProcessingError, StoreError, UsageError
from labpipe.process.output_paths import (
    RecordingIdentity,
    find_copies,
    find_results,
    find_tests,
    identify_recording,
    list_files_below,
    refuse_duplicates,
)
from labpipe.process.run import ProcessedTest, RefusedTest, Task, process, try_to_process
from labpipe.process.sheet_inference import list_test_folders, read_folder
from labpipe.protocol.load import parse_protocol
from labpipe.protocol.schema import Protocol
from labpipe.records.arrays import Floats
from labpipe.records.curve import Curve
from labpipe.records.result import InputFile, Specimen, TestResult
from labpipe.store.replace import lock
from labpipe.store.result_files import read_result
from tests.builders.load_frames import mts_suite
from tests.builders.pulls import broken, pull
from tests.builders.small_tests import Lab, state
from tests.builders.tensile_tests import TensileLab, write_pull


@pytest.fixture
def pull_lab(tmp_path: Path) -> TensileLab:
    """One pull."""
    pull_lab = TensileLab(tmp_path, "P-1")
    travel, force = pull(slack=0.001, seed=1)
    write_pull(pull_lab, "tensile", broken(travel, force, at=0.018), travel)
    return pull_lab


def tried(pull_lab: TensileLab, **more: Any) -> ProcessedTest | RefusedTest:
    return try_to_process(Task(pull_lab.sheet, figures=False, **more))


def failure(pull_lab: TensileLab) -> dict[str, Any]:
    document: dict[str, Any] = json.loads((pull_lab.processed / "failure.json").read_text("utf-8"))
    return document


def test_a_failure_stands_beside_untouched_results_until_a_success(pull_lab: TensileLab) -> None:
    assert isinstance(tried(pull_lab), ProcessedTest)
    old_files, summary = state(pull_lab.processed), pull_lab.summary
    assert sorted(old_files) == ["result.h5", "summary.json"]
    export = pull_lab.export.read_bytes()
    pull_lab.export.write_bytes(export[:80])
    refused = tried(pull_lab)
    assert isinstance(refused, RefusedTest)
    new_files = state(pull_lab.processed)
    assert new_files.pop("failure.json")
    assert new_files == old_files
    document = failure(pull_lab)
    assert document.pop("run") == refused.run != summary["run"]
    assert document.pop("inputs")[0]["sha256"] != summary["inputs"][0]["sha256"]
    assert document == {
        "schema": 1,
        "labpipe": __version__,
        "test": "P-1",
        "code": "unreadable_export",
        "reason": refused.reason,
        "made_of": summary["made_of"],
    }
    pull_lab.export.write_bytes(export)
    assert isinstance(tried(pull_lab), ProcessedTest)
    assert sorted(state(pull_lab.processed)) == ["result.h5", "summary.json"]


def spoil(error: Exception) -> Callable[..., Any]:
    def spoiled(*_: object, **__: object) -> Any:
        raise error

    return spoiled


FAULT = (
    r"expected no error, found a fault of labpipe itself \(ZeroDivisionError: of all\)\."
    r" Report it \(run.py, line \d+\) with the exports of the test; process the test alone"
)


@pytest.mark.parametrize(
    ("error", "code", "said"),
    [
        (MemoryError(), "out_of_memory", "expected a test that fits into memory"),
        (OSError(5, "Input/output error"), "system_refused", "a file that can be used"),
        (ZeroDivisionError("of\nall"), "fault_of_labpipe", FAULT),
    ],
)
def test_what_is_no_error_of_labpipe_has_a_code_too(
    pull_lab: TensileLab, monkeypatch: pytest.MonkeyPatch, error: Exception, code: str, said: str
) -> None:
    monkeypatch.setattr("labpipe.process.run.reduce_recordings", spoil(error))
    refused = tried(pull_lab)
    assert isinstance(refused, RefusedTest)
    assert (refused.code, failure(pull_lab)["code"]) == (code, code)
    assert re.search(said, refused.reason)


CHANGES: dict[str, tuple[Callable[[TensileLab], object], str]] = {
    "no export": (lambda lab: lab.export.unlink(), "missing_export"),
    "no channel": (
        lambda lab: lab.override("sources.frame.channels.force.channel", "Nothing"),
        "missing_channel",
    ),
    "no protocol": (
        lambda lab: lab.edit("test.yaml", "protocol: tensile", "protocol: none-such"),
        "bad_sheet",
    ),
    "no sheet": (lambda lab: lab.sheet.unlink(), "bad_sheet"),
    "a folder for a file": (lambda lab: lab.result.mkdir(parents=True), "cannot_store"),
}


@pytest.mark.parametrize("name", CHANGES)
def test_codes(pull_lab: TensileLab, name: str) -> None:
    change, code = CHANGES[name]
    change(pull_lab)
    refused = tried(pull_lab)
    assert isinstance(refused, RefusedTest)
    assert (refused.code, failure(pull_lab)["code"]) == (code, code)
    assert code in CODES
    assert failure(pull_lab)["run"] == refused.run


def test_another_process_in_the_folder_is_no_failure(pull_lab: TensileLab) -> None:
    with lock(pull_lab.processed):
        refused = tried(pull_lab)
    assert isinstance(refused, RefusedTest)
    assert refused.code == "in_use"
    assert not (pull_lab.processed / "failure.json").exists()


def test_stages_are_told_and_the_result_is_what_is_stored(pull_lab: TensileLab) -> None:
    lab, stages = pull_lab, list[str]()
    outcome = process(Task(lab.sheet, figures=False), stages.append)
    assert stages == ["read", "process", "write"]
    assert outcome.folder == lab.processed
    assert (outcome.figures, outcome.n_failed) == ((), 0)
    stored = read_result(lab.result)
    assert stored.results == outcome.result.results
    assert stored.quality == outcome.result.quality
    assert stored.test_yaml == lab.sheet.read_text(encoding="utf-8")
    assert "name: tensile" in stored.protocol_yaml


def test_folder_beside_raw(
    pull_lab: TensileLab, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    elsewhere = tmp_path / "bench"
    shutil.copytree(pull_lab.raw, elsewhere)
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    outcome = process(Task(elsewhere / "test.yaml", figures=False))
    assert outcome.folder == Path("processed") / "P-1"
    outcome = process(Task(pull_lab.sheet, Path("x") / "P-1", figures=False))
    assert outcome.folder == Path("x") / "P-1"


@pytest.mark.slow
@pytest.mark.parametrize("name", ["../../x", "/tmp/x", "..", "a/b", "", "nul"])
def test_a_name_that_leads_elsewhere(lab: Lab, tmp_path: Path, name: str) -> None:
    import h5py

    process(Task(lab.sheet, figures=False))
    with h5py.File(lab.result, "r+") as opened:
        opened.attrs["test"] = name
    files = state(tmp_path)
    message = r"result\.h5, test: expected the name of a test, such as A2-085-1, found '"
    for folder in (tmp_path / "deep" / "out", None):
        with pytest.raises(StoreError, match=message):
            process(Task(lab.result, folder, figures=False))
    assert state(tmp_path) == files


@pytest.mark.slow
def test_a_raw_group_that_is_not_that_of_the_protocol(lab: Lab) -> None:
    import h5py

    process(Task(lab.sheet, figures=False))
    with h5py.File(lab.result, "r+") as opened:
        opened["raw/force/force"].attrs["name"] = "farce"
    message = r"raw/force: expected the channels of its protocol, force, found 'farce'\. Process"
    with pytest.raises(StoreError, match=message):
        process(Task(lab.result, figures=False))
    with h5py.File(lab.result, "r+") as opened:
        opened["raw/force/force"].attrs["name"] = "force"
        opened["raw/markers/markers/time"][3] = np.inf
    with pytest.raises(ProcessingError, match=r"markers, sample 5: expected an increasing"):
        process(Task(lab.result, figures=False))
    with h5py.File(lab.result, "r+") as opened:
        opened["raw"].attrs.create("roles", ["markers"], dtype=h5py.string_dtype())
    with pytest.raises(StoreError, match=r"raw/force: expected the channels .*, found none"):
        process(Task(lab.result, figures=False))


def test_results_are_found_once_and_in_order(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("T-2", "T-1", "H-1"):
        (tmp_path / "c" / name).mkdir(parents=True)
        (tmp_path / "c" / name / "result.h5").touch()
    one = tmp_path / "c" / "T-1" / "result.h5"
    assert find_results([one]) == [one]
    names = [file.parent.name for file in find_results([tmp_path, one, tmp_path / "c"])]
    assert names == ["H-1", "T-1", "T-2"]
    (tmp_path / "again").symlink_to(one.parent)
    monkeypatch.chdir(tmp_path / "c")
    assert find_results([Path("T-1"), one.parent, tmp_path / "again/result.h5"]) == [
        Path("T-1/result.h5")
    ]


STOPPED = "found a folder that labpipe was writing when it was stopped. Process the test again."


@pytest.mark.parametrize(
    ("find", "name", "message"),
    [
        (
            find_tests,
            "force.mat",
            r"found a \.mat file\. An export belongs to a test: `labpipe new` ",
        ),
        (find_results, "empty", r"expected a result.h5, or a folder with .*, found none"),
        (find_results, "nowhere", r"found nothing of that name\. `labpipe process` writes"),
        (find_results, "T-1/.labpipe.new", STOPPED),
        (find_results, "T-1/.labpipe.new/result.h5", STOPPED),
    ],
)
def test_what_is_no_test_and_no_result(
    tmp_path: Path, find: Callable[[list[Path]], object], name: str, message: str
) -> None:
    (tmp_path / "force.mat").write_bytes(b"MATLAB")
    (tmp_path / "empty").mkdir()
    (tmp_path / "T-1" / ".labpipe.new").mkdir(parents=True)
    (tmp_path / "T-1" / ".labpipe.new" / "result.h5").touch()
    with pytest.raises(UsageError, match=message):
        find([tmp_path / name])


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
    names = [path.name for path in list_files_below(tmp_path)]
    assert names == ["result.h5", "test.yaml"]


def test_two_tests_that_share_a_name(tmp_path: Path) -> None:
    files = [tmp_path / name / "result.h5" for name in "abc"]
    refuse_duplicates(zip(("T-1", "T-2", "T-3"), files, strict=True), "name")
    with pytest.raises(UsageError) as refusal:
        refuse_duplicates(zip(("T-1", "T-2", "t-1"), files, strict=True), "name")
    assert str(refusal.value) == (
        f"{files[2]}: expected one test for each name, found a second for 't-1'. {files[0]} is the"
        " first: rename one of them in its test.yaml, or leave it out."
    )


RESULT = TestResult(
    test="T-1",
    specimen=Specimen("tube", "1", "1"),
    protocol="p",
    protocol_yaml="",
    test_yaml="",
    labpipe_version="",
    inputs=(InputFile("frame", "a.csv", "12", 1), InputFile("markers", "b.csv", "34", 1)),
    recordings={},
    aligned=None,
    curve=None,
    shape=None,
    results=(),
    quality=(),
)


SOURCES = """
version: 1
name: p
sources:
  frame:
    reader: load-frame
    part: Specimen 1
    channels: {force: {channel: F}, displacement: {channel: D}}
  markers: {reader: motive-csv}
markers: {clamp: Base, along: [wire 1]}
"""


def protocol(old: str = "", new: str = "") -> Protocol:
    return parse_protocol(SOURCES.replace(old, new), "p.yaml")


def test_what_makes_one_recording_of_two_results() -> None:
    """Not the names of test and files: their bytes, and what the protocol takes of them."""
    own = identify_recording(RESULT, protocol()).export_key
    first, second = RESULT.inputs
    renamed = tuple(replace(file, file="c.csv") for file in (second, first))
    renamed_test = replace(RESULT, test="T-2", specimen=Specimen("hose", "2", "2"), inputs=renamed)
    assert identify_recording(renamed_test, protocol()).export_key == own
    changed = replace(RESULT, inputs=(first, replace(second, sha256="56")))
    assert identify_recording(changed, protocol()).export_key != own
    for old, new in (("Specimen 1", "Specimen 2"), ("F}", "F2}"), ("wire 1", "w"), ("Base", "B2")):
        assert identify_recording(RESULT, protocol(old, new)).export_key != own, new


def test_all_but_the_first_are_copies() -> None:
    files = [Path(name) / "result.h5" for name in "abcd"]
    identities = [RecordingIdentity(key, key) for key in (1, 2, 1, 1)]
    copies = find_copies(list(zip(files, identities, strict=True)))
    assert list(copies) == [str(files[2]), str(files[3])]
    assert f"found the same exports or samples as in {files[0]}." in copies[str(files[3])]


def test_a_recording_saved_with_fewer_digits_is_a_copy_and_another_specimen_is_none() -> None:
    way, rng = np.linspace(0.0, 1e-3, 500), np.random.default_rng(0)

    def identify(number: int, force: Floats) -> RecordingIdentity:
        inputs = (InputFile("frame", "a.csv", str(number), 1),)
        curve = Curve(way, way, force, ())
        return identify_recording(replace(RESULT, inputs=inputs, curve=curve), protocol())

    force = 50.0 * way / way[-1] + rng.normal(0.0, 0.02, 500)
    again = 50.0 * way / way[-1] + rng.normal(0.0, 0.02, 500)
    recordings = [identify(i, x) for i, x in enumerate((force, force.round(2), again))]
    files = [Path(name) / "result.h5" for name in "abc"]
    assert list(find_copies(list(zip(files, recordings, strict=True)))) == [str(files[1])]


@pytest.mark.parametrize(
    ("name", "content", "why"),
    [
        ("cut.mat", b"MATLAB 5.0 MAT-file" + bytes(200), "expected a complete MAT v5 file"),
        ("empty.csv", b"", "expected a file with content"),
        ("a\nb.csv", mts_suite(), "its name has control characters; rename it"),
    ],
)
def test_what_is_no_export_is_said(tmp_path: Path, name: str, content: bytes, why: str) -> None:
    (tmp_path / name).write_bytes(content)

    exports, kinds, unread = read_folder(tmp_path)

    assert exports == {}
    assert [*kinds] == [name]
    assert kinds[name].startswith(why)
    assert bool(unread) == name.endswith((".mat", "empty.csv"))  # these may still be written


def test_folders_of_a_campaign(tmp_path: Path) -> None:
    for name in ("B", "A", ".git", "empty"):
        (tmp_path / name).mkdir()
    for name in ("B", "A", ".git"):
        (tmp_path / name / "x.csv").write_text("x", encoding="utf-8")
    assert list_test_folders(tmp_path) == [tmp_path / "A", tmp_path / "B"]
    (tmp_path / "test.yaml").write_text("test: x", encoding="utf-8")
    assert list_test_folders(tmp_path) == []
    assert list_test_folders(tmp_path / "A") == []
