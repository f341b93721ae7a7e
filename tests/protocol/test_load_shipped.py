from __future__ import annotations

from pathlib import Path

import pytest

from labpipe.errors import Fault
from labpipe.protocol.load import find_protocol, known_protocols, protocol_folders, shipped_folder


def test_the_folder_of_the_lab_comes_first(tmp_path: Path, repository: Path) -> None:
    own = tmp_path / "mine"
    own.mkdir()
    (own / "wire-cantilever.yml").write_text("", encoding="utf-8")
    (own / "notes.txt").write_text("", encoding="utf-8")

    assert protocol_folders(own)[0] == own
    known = known_protocols(own)
    assert known["wire-cantilever"] == own / "wire-cantilever.yml"
    assert known["markers-only"] == repository / "protocols" / "markers-only.yaml"
    assert "notes" not in known


def test_the_working_folder_is_the_lab_if_nobody_says_otherwise(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "protocols").mkdir()
    monkeypatch.chdir(tmp_path)

    assert protocol_folders()[0] == Path("protocols")


def test_an_installed_labpipe_brings_its_protocols(
    tmp_path: Path, repository: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert protocol_folders(tmp_path)[-1] == repository / "protocols"
    installed = tmp_path / "labpipe" / "shipped" / "protocols"
    installed.mkdir(parents=True)
    module = tmp_path / "labpipe" / "protocol" / "load.py"
    monkeypatch.setattr("labpipe.protocol.load.__file__", str(module))

    assert protocol_folders(tmp_path / "lab") == (installed,)
    assert shipped_folder("examples") == tmp_path / "examples", "as in a checkout"


def test_a_path_is_sought_beside_the_sheet_and_then_from_here(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    beside = tmp_path / "raw" / "test"
    beside.mkdir(parents=True)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "raw" / "own.yaml").write_text("", encoding="utf-8")

    assert find_protocol("../own.yaml", beside=beside) == beside / "../own.yaml"
    assert find_protocol("raw/own.yaml", beside=beside) == Path("raw/own.yaml")
    missing = find_protocol("no/own.yaml", beside=beside)
    assert missing == Fault(
        ("protocol",),
        "a protocol",
        "'no/own.yaml'",
        f"There is none at {beside / 'no/own.yaml'} or {Path('no/own.yaml')}.",
    )


def test_a_path_that_is_too_long(tmp_path: Path) -> None:
    name = "a/" * 3000 + "own.yaml"
    found = find_protocol(name, beside=tmp_path)
    assert isinstance(found, Fault)
    assert found.remedy.startswith("There is none at ")


def test_a_lab_without_any_protocol(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("labpipe.protocol.load.known_protocols", lambda _: {})

    assert find_protocol("wire", beside=tmp_path, protocols=tmp_path) == Fault(
        ("protocol",), "a protocol", "'wire'", "There is no folder 'protocols' here."
    )
