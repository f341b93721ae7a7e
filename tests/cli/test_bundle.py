"""``labpipe bundle``, as typed."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from labpipe.cli import BAD_INPUT, DONE
from tests.builders.bundles import EXAMPLES
from tests.builders.small_tests import Run, runner


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Run:
    return runner(capsys)


def test_numbers_figure_and_json(run: Run, tmp_path: Path) -> None:
    ran = run("bundle", "7 B1", "--wire", EXAMPLES, "--bore", "3.5 mm", "--out", tmp_path, "--json")
    assert ran.status == DONE, ran
    assert json.loads(ran.out) == json.loads((tmp_path / "bundle.json").read_text())
    assert (tmp_path / "figures" / "bundle.png").is_file()
    ran = run("bundle", "7 B1", "--wire", EXAMPLES, "--out", tmp_path, "--no-figures")
    assert ran.out.startswith("7 B1: 7 B1, packed\n")


@pytest.mark.parametrize("bore", ["10.7", "0 mm", "-3 mm", "2 N"])
def test_a_bore_that_is_none(run: Run, tmp_path: Path, bore: str) -> None:
    ran = run("bundle", "7 B1", "--wire", EXAMPLES, f"--bore={bore}", "--out", tmp_path / "x")
    assert ran.status == BAD_INPUT
    assert ran.err == (
        'labpipe bundle: --bore: expected a length above zero with its unit, such as "10.7 mm", '
        f"found {bore!r}. Write the inner diameter of the conduit.\n"
    )
    assert not (tmp_path / "x").exists()
