"""A virtual tensile test on disk: export, sheet, whole truth, the same again."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import openpyxl
import pytest

from labpipe.errors import StoreError
from labpipe.virtual_lab.observations import observe, simulate_test
from labpipe.virtual_lab.tensile_scenarios import (
    ExportLayout,
    GripSlip,
    TensileScenario,
    corrugated_tube,
    twist_tube,
)

TUBE = replace(corrugated_tube("CT-10-slit-2"), slips=(GripSlip(18.75e-3, 0.47),))
PARTED = replace(twist_tube("2b"), export=ExportLayout(in_parts=True, part_at=2.6))


@pytest.fixture(scope="module")
def tube_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return simulate_test(TUBE, tmp_path_factory.mktemp("raw") / TUBE.name, 21)


def test_files(tube_folder: Path, tmp_path: Path) -> None:
    names = {path.name for path in tube_folder.iterdir()}
    assert names == {"CT-10-slit-2.xlsx", "test.yaml", "truth.json"}
    folder = simulate_test(PARTED, tmp_path / "parts", 21)
    stem = "DAQ- Crosshead, … - (Timed)"
    exports = {f"{stem}.txt", f"{stem}1.txt", f"{stem}2.txt"}
    assert {path.name for path in folder.iterdir()} == exports | {"test.yaml", "truth.json"}
    sheet = (folder / "test.yaml").read_text(encoding="utf-8")
    assert all(f'"{name}"' in sheet for name in exports)


def test_truth_beside_the_exports(tube_folder: Path) -> None:
    told = json.loads((tube_folder / "truth.json").read_text(encoding="utf-8"))
    truth = observe(TUBE, 21).truth
    assert told["synthetic"] is True
    assert told["seed"] == 21
    for name in ("time", "displacement", "force"):
        np.testing.assert_allclose(told[name], getattr(truth, name), rtol=0, atol=1e-11)
    for name in ("foot", "stiffness_first", "break_point", "peak_force", "failure_displacement"):
        assert told[name] == getattr(truth, name)
    assert told["slips"] == [{"position": 18.75e-3, "drop": 0.47}]
    assert told["scenario"]["instruments"]["tare"] == TUBE.instruments.tare
    assert told["scenario"]["export"]["program"] == "TestResources R-Controller"


def test_export_is_the_truth_with_small_errors(tube_folder: Path) -> None:
    sheet = openpyxl.load_workbook(tube_folder / "CT-10-slit-2.xlsx")["Test Data"]
    rows = list(sheet.iter_rows(min_row=6, values_only=True))
    time, force, displacement = np.array(rows, dtype=np.float64).T
    truth = observe(TUBE, 21).truth
    np.testing.assert_allclose(time, truth.time, atol=1e-6)
    off = 4.4482216152605 * force - truth.force - TUBE.instruments.tare
    assert np.std(off) == pytest.approx(np.hypot(0.02, 0.03), rel=0.2)
    assert abs(np.mean(off)) < 0.01
    moved = 25.4e-3 * displacement - TUBE.instruments.displacement_tare
    np.testing.assert_allclose(moved, truth.displacement, atol=7e-6)


@pytest.mark.parametrize("scenario", [TUBE, PARTED], ids=lambda scenario: scenario.name)
def test_again_is_the_same_to_the_byte(tmp_path: Path, scenario: TensileScenario) -> None:
    first = simulate_test(scenario, tmp_path / "first", 21)
    again = simulate_test(scenario, tmp_path / "again", 21)
    for path in first.iterdir():
        assert (again / path.name).read_bytes() == path.read_bytes()


def test_seed_changes_noise_and_nothing_else() -> None:
    one, two = observe(TUBE, 1), observe(TUBE, 2)
    assert not np.array_equal(one.record.force, two.record.force)
    np.testing.assert_array_equal(one.truth.force, two.truth.force)


def test_a_file_in_place_of_the_folder(tmp_path: Path) -> None:
    (tmp_path / "raw").write_text("mine")
    with pytest.raises(StoreError, match=r"a folder to write in, found a file in its place"):
        simulate_test(PARTED, tmp_path / "raw" / "parts", 21)
