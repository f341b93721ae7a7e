from __future__ import annotations

import json
from pathlib import Path

import pytest

from labpipe.virtual_lab import CantileverScenario, ConduitScenario
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


def test_bundles_reach_the_virtual_lab(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[CantileverScenario | ConduitScenario] = []

    def simulate(scenario: CantileverScenario | ConduitScenario, folder: Path, seed: int) -> Path:
        asked.append(scenario)
        return folder

    monkeypatch.setattr("labpipe.cli.simulate.simulate_test", simulate)
    taped = ("--kind", "taped-bundle", "--cycles", "1", "--rate", "1 kHz")
    conduit = ("--kind", "conduit-bundle", "--type", "CWB-2c", "--fps", "20 Hz")
    assert run("simulate", "--out", tmp_path, *taped).status == 0
    assert run("simulate", "--out", tmp_path, *conduit).status == 0
    first, second = asked
    assert isinstance(first, CantileverScenario)
    assert (first.specimen_type, first.mechanics.cycles) == ("TWB-B1-19-PVC", 1)
    assert first.clocks.rate == 1000.0
    assert isinstance(second, ConduitScenario)
    assert (second.specimen_type, second.clocks.fps) == ("CWB-2c", 20.0)


@pytest.mark.parametrize(
    ("options", "found"),
    [
        (("--kind", "taped-bundle", "--type", "CWB-1"), "type=CWB-1 of a taped-bundle"),
        (("--kind", "conduit-bundle", "--cycles", "2"), "cycles=2 of a conduit bundle"),
        (("--type", "CWB-1"), "type=CWB-1 of a wire"),
    ],
)
def test_what_a_kind_does_not_have(
    run: Run, tmp_path: Path, options: tuple[str, ...], found: str
) -> None:
    ran = run("simulate", "--out", tmp_path, *options)
    assert ran.status == 2
    assert ran.err == (
        'labpipe simulate: options: expected --rate and --fps such as "10 kHz" and "50 Hz", a '
        f"cycle, a plain name, a type and cycles that the kind has, found {found}. See `labpipe "
        f"simulate --help`.\n"
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
