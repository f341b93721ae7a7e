"""``labpipe bundle``, as typed."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from labpipe.cli import BAD_INPUT, DONE
from labpipe.store.write import write_result
from tests.builders.bent_bundles import bent_bundle
from tests.builders.bundles import EXAMPLES
from tests.builders.small_tests import Run, runner


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Run:
    return runner(capsys)


@pytest.mark.slow
def test_numbers_figure_and_json(run: Run, tmp_path: Path) -> None:
    ran = run("bundle", "7 B1", "--wire", EXAMPLES, "--bore", "3.5 mm", "--out", tmp_path, "--json")
    assert ran.status == DONE, ran
    assert json.loads(ran.out) == json.loads((tmp_path / "bundle.json").read_text())
    assert [file.name for file in (tmp_path / "figures").iterdir()] == ["bundle.svg"]
    assert run("bundle", "7 B1", "--wire", EXAMPLES, "--out", tmp_path, "--png").status == DONE
    assert (tmp_path / "figures" / "bundle.png").is_file()
    ran = run("bundle", "7 B1", "--wire", EXAMPLES, "--out", tmp_path, "--no-figures")
    assert ran.out.startswith("7 B1: 7 B1, packed\n")


def test_a_processed_bundle_predicts_its_cycles(run: Run, tmp_path: Path) -> None:
    write_result(bent_bundle(), tmp_path / "result.h5")
    out = ("--wire", EXAMPLES, "--out", tmp_path / "out", "--no-figures")
    ran = run("bundle", tmp_path, *out)
    assert ran.status == DONE, ran
    lines = ran.out.splitlines()
    assert lines[0] == "TWB-1: 7 B1, packed"
    assert any(line.startswith("  error of what was left out, of the peak force") for line in lines)
    assert any(line.startswith("  work lost over the cycles left out") for line in lines)
    write_result(replace(bent_bundle(), results=()), tmp_path / "result.h5")
    ran = run("bundle", tmp_path, *out)
    assert "  no loop is predicted: the test has no kink (kink_displacement" in ran.out


@pytest.mark.parametrize("bore", ["10.7", "0 mm", "-3 mm", "2 N"])
def test_a_bore_that_is_none(run: Run, tmp_path: Path, bore: str) -> None:
    ran = run("bundle", "7 B1", "--wire", EXAMPLES, f"--bore={bore}", "--out", tmp_path / "x")
    assert ran.status == BAD_INPUT
    assert ran.err == (
        'labpipe bundle: --bore: expected a length above zero with its unit, such as "10.7 mm", '
        f"found {bore!r}. Write the inner diameter of the conduit.\n"
    )
    assert not (tmp_path / "x").exists()
