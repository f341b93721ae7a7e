from __future__ import annotations

import hashlib
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from labpipe.campaign.content_keys import (
    Content,
    ContentKeys,
    describe_changes,
    parse_content,
    take_stamp,
)
from labpipe.process.run import process_test
from tests.builders.kept_campaigns import KeptCampaign
from tests.builders.pulls import broken, pull
from tests.builders.tensile_tests import TensileLab, write_pull


@pytest.fixture
def read(monkeypatch: pytest.MonkeyPatch) -> list[str]:
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
    return KeptCampaign(tmp_path).add("T1")


def sure(content: Content) -> Content:
    """As if all hashes had been taken long after the files were written."""
    stamps = {
        name: stamp._replace(taken=stamp.taken + 10**10) for name, stamp in content.stamps.items()
    }
    return replace(content, stamps=stamps)


@pytest.mark.parametrize("ends", ["\n", "\r\n"])
def test_content_key_equals_result_key(tmp_path: Path, ends: str) -> None:
    lab = TensileLab(tmp_path, "P-1")
    travel, force = pull(slack=0.001, seed=1)
    write_pull(lab, "tensile", broken(travel, force, at=0.018), travel)
    lab.override("rig.crosshead_speed", "1 mm/s")
    text = lab.sheet.read_text("utf-8")
    lab.sheet.write_bytes(text.replace("\n", ends).encode())
    result = process_test(lab.sheet, figures=False).result
    content = ContentKeys().determine_content(lab.sheet)
    assert content.key == result.run
    assert content.inputs == tuple((i.role, i.file, i.sha256) for i in result.inputs)
    assert {"sheet": content.sheet, "protocol": content.protocol} == lab.summary["made_of"]
    assert content.facts["test"] == "P-1"


@pytest.mark.parametrize("kind", ["dialects/own.toml", "protocols/corrugated-tube.yaml"])
def test_key_depends_on_cards_and_protocols_of_the_lab(
    folder: Path, tmp_path: Path, repository: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    monkeypatch.chdir(tmp_path)
    text = (repository / "protocols" / "corrugated-tube.yaml").read_text("utf-8")
    texts = {".toml": "about = 'a frame'", ".yaml": text.replace("0.423 mm/s", "0.5 mm/s")}
    before = sure(ContentKeys().determine_content(folder / "test.yaml"))
    own = tmp_path / kind
    own.parent.mkdir()
    own.write_text(texts[own.suffix], "utf-8")
    after = ContentKeys().determine_content(folder / "test.yaml", before)
    assert after.key != before.key
    assert ("dialect" in [role for role, _, _ in after.inputs]) == (own.suffix == ".toml")


def test_unchanged_file_is_read_again_only_if_its_hash_is_unreliable(
    folder: Path, read: list[str]
) -> None:
    keys, sheet = ContentKeys(), folder / "test.yaml"
    first = keys.determine_content(sheet)
    read.clear()
    assert keys.determine_content(sheet, first).key == first.key
    assert sorted(read) == ["frame.csv", "test.yaml"]
    read.clear()
    assert keys.determine_content(sheet, sure(first)).key == first.key
    assert read == []


def test_change_with_equal_size_and_time_is_detected(folder: Path) -> None:
    """As a copy with its times, or a clock that was set back: the file's own record tells."""
    keys, sheet, export = ContentKeys(), folder / "test.yaml", folder / "frame.csv"
    first = sure(keys.determine_content(sheet))
    about = export.stat()
    while export.stat().st_ctime_ns == about.st_ctime_ns:  # until the file system's clock ticks
        export.write_text("26.5", "utf-8")
    os.utime(export, ns=(about.st_atime_ns, about.st_mtime_ns))
    assert export.stat().st_size == about.st_size
    assert keys.determine_content(sheet, first).key != first.key


@pytest.mark.parametrize(
    "text",
    ["", "test: [", "test: T1\n", "\x00", "{name}: x", "overrides: {a.b: {value: 1, because: x}}"],
)
def test_faulty_sheet_has_its_own_key(folder: Path, text: str) -> None:
    sheet = folder / "test.yaml"
    good = ContentKeys().determine_content(sheet)
    sheet.write_text(text, "utf-8")
    first, again = (ContentKeys().determine_content(sheet) for _ in range(2))
    assert first.key == again.key != good.key
    assert first.inputs == ()


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no pipes here")
def test_pipe_has_an_empty_stamp(folder: Path) -> None:
    (folder / "frame.csv").unlink()
    os.mkfifo(folder / "frame.csv")
    assert take_stamp(folder / "frame.csv").sha256 == ""
    assert take_stamp(folder / "nothing").sha256 == ""
    assert take_stamp(Path("a\x00b")).sha256 == ""


def test_content_round_trip(folder: Path) -> None:
    content = ContentKeys().determine_content(folder / "test.yaml")
    assert parse_content(content.as_text()) == content
    for text in ("", "{}", "[]", "null", '{"inputs": 1}'):
        assert parse_content(text) is None


NOW = Content("new", (("force", "a.mat", "1"), ("markers", "b.csv", "2")), "s", "p")
EXTRA = (*NOW.inputs, ("frame", "c.csv", "3"))


@pytest.mark.parametrize(
    ("inputs", "texts", "message"),
    [
        (NOW.inputs, "sp", "newer labpipe"),
        (NOW.inputs, "tp", "sheet changed"),
        (NOW.inputs, "sq", "protocol changed"),
        ((("force", "a.mat", "0"), NOW.inputs[1]), "sp", "export changed (a.mat)"),
        (EXTRA, "tq", "export changed (c.csv), sheet changed, protocol changed"),
        ((), "", "something changed"),
        (NOW.inputs, "", "something changed"),
    ],
)
def test_describe_changes(
    inputs: tuple[tuple[str, str, str], ...], texts: str, message: str
) -> None:
    assert describe_changes(inputs=inputs, sheet=texts[:1], protocol=texts[1:], now=NOW) == message
