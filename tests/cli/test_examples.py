from __future__ import annotations

from pathlib import Path

import pytest

from labpipe.cli import BAD_INPUT, DONE
from tests.builders.small_tests import Run


def contents(folder: Path) -> dict[str, bytes]:
    files = (path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


def test_copies_what_a_lab_starts_from(run: Run, repository: Path, tmp_path: Path) -> None:
    folder = tmp_path / "new" / "lab"
    ran = run("examples", folder)
    assert (ran.status, ran.err) == (DONE, "")
    expected = contents(repository / "examples") | {
        f"protocols/{name}": text for name, text in contents(repository / "protocols").items()
    }
    assert contents(folder) == expected
    assert ran.out.count("wrote ") == len(expected)
    assert run("examples", folder).status == DONE, "the same again does no harm"


def test_a_file_of_ones_own_is_never_replaced(run: Run, tmp_path: Path) -> None:
    own = tmp_path / "protocols" / "tensile.yaml"
    own.parent.mkdir()
    own.write_text("mine", encoding="utf-8")
    ran = run("examples", tmp_path)
    assert ran.status == BAD_INPUT
    assert ran.err == (
        f"labpipe examples: {own}: expected the example as it comes with labpipe, or no such file,"
        " found another one. Move it away, or name another folder; nothing was written.\n"
    )
    assert contents(tmp_path) == {"protocols/tensile.yaml": b"mine"}


def test_a_file_in_place_of_the_folder(run: Run, tmp_path: Path) -> None:
    place = tmp_path / "lab"
    place.write_text("mine", encoding="utf-8")
    ran = run("examples", place)
    assert ran.status == BAD_INPUT
    assert "expected a folder to write in, found a file in its place" in ran.err
    assert place.read_text(encoding="utf-8") == "mine"


def test_examples_are_not_copied_onto_themselves(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("examples/wires.xlsx", "protocols/own.yaml"):
        (tmp_path / name).parent.mkdir()
        (tmp_path / name).write_text(name, encoding="utf-8")
    monkeypatch.setattr("labpipe.cli.examples.shipped_folder", tmp_path.__truediv__)
    ran = run("examples", tmp_path / "examples")
    assert ran.status == DONE
    assert "wires.xlsx" not in ran.out
    assert (tmp_path / "examples" / "protocols" / "own.yaml").read_text() == "protocols/own.yaml"
