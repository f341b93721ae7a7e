from __future__ import annotations

import json
from pathlib import Path

import pytest

from labpipe.virtual_lab import CantileverScenario
from tests.builders.small_tests import Run


def test_writes_exports_sheet_and_truth(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The scenario that the options ask for reaches the virtual lab."""
    asked: list[tuple[CantileverScenario, Path, int]] = []

    def simulate(scenario: CantileverScenario, folder: Path, seed: int) -> Path:
        asked.append((scenario, folder, seed))
        return folder

    monkeypatch.setattr("labpipe.cli.simulate.simulate_test", simulate)
    ran = run(
        *("simulate", "--out", tmp_path, "--name", "S7", "--rate", "1 kHz"),
        *("--fps", "120 Hz", "--cycles", "2", "--seed", "9"),
    )
    assert ran.status == 0
    (scenario, folder, seed), *_ = asked
    assert (folder, seed, scenario.name) == (tmp_path / "S7", 9, "S7")
    assert (scenario.clocks.rate, scenario.clocks.fps) == (1000.0, 120.0)
    assert scenario.mechanics.cycles == 2
    assert ran.out == (
        f"wrote {tmp_path / 'S7'}: exports, test.yaml, truth.json (synthetic, seed 9)\n"
    )


def test_no_name_leaves_the_folder(run: Run, tmp_path: Path) -> None:
    ran = run("simulate", "--out", tmp_path / "raw", "--name", "../x", "--cycles", "1")
    assert ran.status == 2
    assert not (tmp_path / "x").exists()


def test_truth_says_that_it_is_synthetic(pristine_truth: Path) -> None:
    assert json.loads(pristine_truth.read_text(encoding="utf-8"))["synthetic"] is True


@pytest.fixture
def pristine_truth(pristine: object) -> Path:
    from tests.builders.small_tests import Lab

    assert isinstance(pristine, Lab)
    return pristine.raw / "truth.json"
