from __future__ import annotations

import hashlib
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from labpipe.campaign.campaign_files import (
    HashedInputs,
    InputReader,
    SourceHashes,
    describe_changes,
    parse_inputs,
    take_stamp,
)
from labpipe.process.run import Task, process
from tests.builders.lab_campaigns import LabCampaign
from tests.builders.pulls import broken, pull
from tests.builders.tensile_tests import TensileLab, write_pull


@pytest.fixture
def files_read(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of files whose hash is taken."""
    names: list[str] = []
    usual = hashlib.file_digest

    def digest(file: Any, kind: str) -> object:
        names.append(Path(file.name).name)
        return usual(file, kind)

    monkeypatch.setattr(hashlib, "file_digest", digest)
    return names


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return LabCampaign(tmp_path).add("T1")


def sure(inputs: HashedInputs) -> HashedInputs:
    """As if all hashes had been taken long after the files were written."""
    stamps = {
        name: stamp._replace(hashed_ns=stamp.hashed_ns + 10**10)
        for name, stamp in inputs.stamps.items()
    }
    return replace(inputs, stamps=stamps)


@pytest.mark.parametrize("ends", ["\n", "\r\n"])
def test_key_of_inputs_equals_result_key(tmp_path: Path, ends: str) -> None:
    lab = TensileLab(tmp_path, "P-1")
    travel, force = pull(slack=0.001, seed=1)
    write_pull(lab, "tensile", broken(travel, force, at=0.018), travel)
    lab.override("rig.crosshead_speed", "1 mm/s")
    text = lab.sheet.read_text("utf-8")
    lab.sheet.write_bytes(text.replace("\n", ends).encode())
    result = process(Task(lab.sheet, figures=False)).result
    inputs = InputReader().read_inputs(lab.sheet)
    assert inputs.key == result.run
    assert inputs.source_hashes.files == tuple((i.role, i.file, i.sha256) for i in result.inputs)
    assert {
        "sheet": inputs.source_hashes.sheet,
        "protocol": inputs.source_hashes.protocol,
    } == lab.summary["made_of"]
    assert inputs.facts["test"] == "P-1"


@pytest.mark.parametrize("kind", ["dialects/own.toml", "protocols/corrugated-tube.yaml"])
def test_key_depends_on_cards_and_protocols_of_the_lab(
    folder: Path, tmp_path: Path, repository: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    monkeypatch.chdir(tmp_path)
    text = (repository / "protocols" / "corrugated-tube.yaml").read_text("utf-8")
    texts = {".toml": "about = 'a frame'", ".yaml": text.replace("0.423 mm/s", "0.5 mm/s")}
    previous = sure(InputReader().read_inputs(folder / "test.yaml"))
    lab_file = tmp_path / kind
    lab_file.parent.mkdir()
    lab_file.write_text(texts[lab_file.suffix], "utf-8")
    current = InputReader().read_inputs(folder / "test.yaml", previous)
    assert current.key != previous.key
    assert ("dialect" in [role for role, _, _ in current.source_hashes.files]) == (
        lab_file.suffix == ".toml"
    )


def test_unchanged_file_is_read_again_only_if_its_hash_is_unreliable(
    folder: Path, files_read: list[str]
) -> None:
    reader, sheet = InputReader(), folder / "test.yaml"
    inputs = reader.read_inputs(sheet)
    files_read.clear()
    assert reader.read_inputs(sheet, inputs).key == inputs.key
    assert sorted(files_read) == ["frame.csv", "test.yaml"]
    files_read.clear()
    assert reader.read_inputs(sheet, sure(inputs)).key == inputs.key
    assert files_read == []


def test_change_with_equal_size_and_time_is_detected(folder: Path) -> None:
    """As a copy with its times, or a clock that was set back: the file's own record tells."""
    reader, sheet, export = InputReader(), folder / "test.yaml", folder / "frame.csv"
    inputs = sure(reader.read_inputs(sheet))
    status = export.stat()
    while export.stat().st_ctime_ns == status.st_ctime_ns:  # until the file system's clock ticks
        export.write_text("26.5", "utf-8")
    os.utime(export, ns=(status.st_atime_ns, status.st_mtime_ns))
    assert export.stat().st_size == status.st_size
    assert reader.read_inputs(sheet, inputs).key != inputs.key


@pytest.mark.parametrize(
    "text",
    ["", "test: [", "test: T1\n", "\x00", "{name}: x", "overrides: {a.b: {value: 1, because: x}}"],
)
def test_faulty_sheet_has_its_own_key(folder: Path, text: str) -> None:
    sheet = folder / "test.yaml"
    good = InputReader().read_inputs(sheet)
    sheet.write_text(text, "utf-8")
    first, repeated = (InputReader().read_inputs(sheet) for _ in range(2))
    assert first.key == repeated.key != good.key
    assert first.source_hashes.files == ()


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no pipes here")
def test_pipe_has_an_empty_stamp(folder: Path) -> None:
    (folder / "frame.csv").unlink()
    os.mkfifo(folder / "frame.csv")
    assert take_stamp(folder / "frame.csv").sha256 == ""
    assert take_stamp(folder / "nothing").sha256 == ""
    assert take_stamp(Path("a\x00b")).sha256 == ""


def test_inputs_round_trip(folder: Path) -> None:
    inputs = InputReader().read_inputs(folder / "test.yaml")
    assert parse_inputs(inputs.to_json()) == inputs
    for text in ("", "{}", "[]", "null", '{"source_hashes": 1}'):
        assert parse_inputs(text) is None


NOW = SourceHashes((("force", "a.mat", "1"), ("markers", "b.csv", "2")), "s", "p")
EXTRA = (*NOW.files, ("frame", "c.csv", "3"))


@pytest.mark.parametrize(
    ("files", "texts", "message"),
    [
        (NOW.files, "sp", "labpipe changed"),
        (NOW.files, "tp", "sheet changed"),
        (NOW.files, "sq", "protocol changed"),
        ((("force", "a.mat", "0"), NOW.files[1]), "sp", "file changed (a.mat)"),
        (EXTRA, "tq", "file changed (c.csv), sheet changed, protocol changed"),
        ((), "", "unknown change"),
        (NOW.files, "", "unknown change"),
    ],
)
def test_describe_changes(
    files: tuple[tuple[str, str, str], ...], texts: str, message: str
) -> None:
    assert describe_changes(SourceHashes(files, texts[:1], texts[1:]), NOW) == message
