"""``labpipe calibrate``: from processed tests to a calibrated wire and what it predicts."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from labpipe.studies.validation import STEPS, bent_shapes
from labpipe.studies.wire_specs import read_wire_sheet
from labpipe.wire.calibration.calibrate_wire import Wire
from labpipe.wire.cantilever import StringRig
from labpipe.wire.wire_table import build, wire_table
from tests.builders.small_tests import Run, state
from tests.builders.wire_lab import processed_wires

pytestmark = pytest.mark.slow

TRUTH = {"radial_friction": 0.0465, "insulation_modulus": 1e9, "copper_scale": 1.0}


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Processed tests; not to be changed."""
    return processed_wires(tmp_path_factory.mktemp("wires"))


@pytest.fixture
def sheet(repository: Path) -> str:
    return str(repository / "examples" / "wires.xlsx")


def plan(folder: Path, text: str) -> str:
    path = folder / "plan.yaml"
    path.write_text(f"version: 1\n{text}", encoding="utf-8")
    return str(path)


def test_truth_is_found_and_another_wire_predicted(
    campaign: Path, sheet: str, tmp_path: Path, run: Run
) -> None:
    out = tmp_path / "out"
    asked = ("--plan", plan(tmp_path, "wire: A2\n"), "--out", str(out))
    done = run("calibrate", str(campaign), "--wire", sheet, *asked, "--no-figures")
    assert done.status == 0, done.err
    found: dict[str, Any] = json.loads((out / "calibration.json").read_text("utf-8"))
    assert found["wire"] == "A2"
    for each in found["parameters"]:
        low, high = each["lower"], each["upper"]
        assert low is None or low < TRUTH[each["name"]]
        assert high is None or TRUTH[each["name"]] < high
    assert not any(found["friction_separability"]["identified"].values())
    first, second = found["groups"]
    assert (first["wire"], first["calibrating"]) == ("A2", True)
    assert (second["wire"], second["calibrating"]) == ("B1", False)
    assert second["rmse_share"] < 0.08
    assert second["inside_band"] > 0.9
    assert "cannot be told apart" in done.out
    assert "predicted" in done.out
    assert (out / "calibration.xlsx").is_file()


def test_decks_are_those_of_the_calibrated_wires(
    campaign: Path, sheet: str, tmp_path: Path, run: Run
) -> None:
    out = tmp_path / "out"
    asked = ("--plan", plan(tmp_path, "wire: A2\n"), "--out", str(out), "--json", "--no-figures")
    done = run("calibrate", str(campaign), "--wire", sheet, *asked)
    assert done.status == 0
    values = {each["name"]: each["value"] for each in json.loads(done.out)["parameters"]}
    deck = json.loads((out / "decks" / "B1.json").read_text("utf-8"))
    nominal = next(spec for spec in read_wire_sheet(Path(sheet)) if spec.name == "B1")
    calibrated = replace(
        nominal,
        radial_force=values["radial_friction"] / (0.21 + 0.10),
        insulation_modulus=values["insulation_modulus"],
        copper_k=530e6 * values["copper_scale"],
    )
    assert deck["moment"] == pytest.approx(wire_table(calibrated).moment.tolist(), rel=1e-9)
    assert deck["moment"] != pytest.approx(wire_table(nominal).moment.tolist(), rel=1e-6)


def test_tests_beyond_the_range_of_the_insulation_are_told(
    campaign: Path, tmp_path: Path, run: Run
) -> None:
    heading = "wire,wire_diameter_mm,strands,strand_diameter_mm,lay_angles_deg"
    heading += ",insulation_thickness_mm,insulation_strain,insulation_table"
    row = "A2,1.6,7,0.32,12,0.3"
    sheet, asked = tmp_path / "wires.csv", ("--plan", plan(tmp_path, "wire: A2\n"), "--no-figures")
    others = "B1,1.1,7,0.25,12,0.15,,"
    arguments = ("calibrate", str(campaign), "--wire", str(sheet), *asked, "--out", str(tmp_path))

    def told(cells: str) -> tuple[dict[str, Any], list[dict[str, Any]]]:
        sheet.write_text(f"{heading}\n{row},{cells}\n{others}\n")
        done = run(*arguments)
        assert done.status == 0, done.err
        found = json.loads((tmp_path / "calibration.json").read_text("utf-8"))
        return found, [each for each in found["quality"] if each["code"] == "insulation_doubtful"]

    found, [note] = told("0.01,")
    assert note["message"].startswith(
        f"the tests bend A2 to {found['tested_curvature']:.3g} 1/m; from 12.5 1/m on its insulation"
        " is strained by more than 1 %, where its straight line is not taken to hold"
    )
    assert found["stress_tables"] == {}
    (tmp_path / "pvc.csv").write_text("strain,stress_mpa,temperature_c\n0.2,200,23\n")
    found, notes = told(",pvc.csv")
    assert not notes
    assert found["stress_tables"]["insulation_table"]["temperature"] == pytest.approx(296.15)
    # a table need not go on beyond the tests
    (tmp_path / "pvc.csv").write_text("strain,stress_mpa\n0.028,28\n")
    short, notes = told(",pvc.csv")
    assert not notes
    assert 29.0 < short["tested_curvature"] < 0.028 / 0.8e-3
    values = [[each["value"] for each in this["parameters"]] for this in (found, short)]
    assert values[1] == pytest.approx(values[0], rel=0.01)


def test_figures_are_drawn(campaign: Path, sheet: str, tmp_path: Path, run: Run) -> None:
    asked = ("--plan", plan(tmp_path, "wire: A2\n"), "--out", str(tmp_path / "out"))
    assert run("calibrate", str(campaign), "--wire", sheet, *asked).status == 0
    drawn = {path.suffix for path in (tmp_path / "out" / "figures").iterdir()}
    assert drawn == {".svg"}
    names = {path.stem for path in (tmp_path / "out" / "figures").iterdir()}
    assert names == {"calibration", "validation-1", "shapes-1"}


def test_the_model_is_bent_as_far_as_the_sample(campaign: Path, repository: Path) -> None:
    sheet = read_wire_sheet(repository / "examples" / "wires.xlsx")
    made = build(next(spec for spec in sheet if spec.name == "A2"))
    wire = Wire(made.section, made.contacts)
    for rig in (StringRig(0.76, 0.0265, 0.085, 0.76), None):
        shapes = bent_shapes(campaign / "A2-085-1" / "result.h5", wire, 0.085, rig, 0.045)
        assert len(shapes) == STEPS
        for number, shape in enumerate(shapes, start=1):
            assert shape.deflection == pytest.approx(0.045 * number / STEPS, abs=2e-4)
            assert shape.model[-1, 1] == pytest.approx(shape.deflection, abs=2e-6)
            # Scatter of the sample and of its markers; a wrong frame or sign is many times that.
            assert np.abs(shape.fit[-1] - shape.model[-1]).max() < 0.5e-3
            assert len(shape.markers) == 8


def test_one_wire_needs_no_plan(campaign: Path, sheet: str, tmp_path: Path, run: Run) -> None:
    out = tmp_path / "out"
    alone = [str(campaign / f"A2-085-{number}") for number in (1, 2)]
    done = run("calibrate", *alone, "--wire", sheet, "--out", str(out), "--no-figures")
    assert done.status == 0, done.err
    assert done.out.startswith("A2: ")


def refused(run: Run, folder: Path, *arguments: str) -> str:
    """A calibration that ends with one message and leaves earlier results alone."""
    out = folder / "earlier"
    out.mkdir()
    (out / "calibration.json").write_text("{}", encoding="utf-8")
    before = state(out)
    done = run("calibrate", *arguments, "--out", str(out))
    assert done.status == 2
    assert "Traceback" not in done.err
    assert state(out) == before
    return done.err


def test_mixed_wires_ask_for_one(campaign: Path, sheet: str, tmp_path: Path, run: Run) -> None:
    said = refused(run, tmp_path, str(campaign), "--wire", sheet)
    assert "expected tests of one wire, found tests of 2 wires: A2, B1. Name the one to" in said


def test_a_plan_for_a_wire_without_tests(
    campaign: Path, sheet: str, tmp_path: Path, run: Run
) -> None:
    asked = plan(tmp_path, "wire: A3\n")
    said = refused(run, tmp_path, str(campaign), "--wire", sheet, "--plan", asked)
    assert "plan.yaml, wire: expected tests of 'A3', found usable tests of A2, B1 alone" in said


def test_a_sheet_without_the_wire(campaign: Path, tmp_path: Path, run: Run) -> None:
    other = tmp_path / "wires.csv"
    other.write_text(
        "wire,wire_diameter_mm,strands,strand_diameter_mm,lay_angles_deg,insulation_thickness_mm\n"
        "A22,1.6,7,0.32,12,0.3\n",
        encoding="utf-8",
    )
    tests = str(campaign / "A2-085-1")
    said = refused(run, tmp_path, tests, "--wire", str(other))
    assert "expected a row for 'A2', the specimen type of test A2-085-1, found rows for A22" in said


def test_no_sheet_at_all(
    campaign: Path, tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    said = refused(run, tmp_path, str(campaign))
    assert "expected a wire sheet, or wires.xlsx or wires.csv in the working folder" in said


def test_fewer_points_than_parameters(campaign: Path, sheet: str, tmp_path: Path, run: Run) -> None:
    asked = plan(tmp_path, "wire: A2\nup_to: 0.5 mm\npoints: 20\n")
    said = refused(run, tmp_path, str(campaign), "--wire", sheet, "--plan", asked)
    assert "points of the first loading lie between 0 and 0.5 mm: 20 at least are needed" in said


def test_a_broken_result_is_left_out_and_told(
    campaign: Path, sheet: str, tmp_path: Path, run: Run
) -> None:
    tests = tmp_path / "tests"
    shutil.copytree(campaign, tests)
    (tests / "A2-085-2" / "result.h5").write_bytes(b"no HDF5")
    asked = ("--plan", plan(tmp_path, "wire: A2\n"), "--out", str(tmp_path / "out"))
    done = run("calibrate", str(tests), "--wire", sheet, *asked, "--no-figures")
    assert done.status == 2
    assert "left out: " in done.err
    assert "A2-085-2" in done.err
    assert (tmp_path / "out" / "calibration.json").is_file()


def test_a_prior_that_contradicts_the_tests(
    campaign: Path, sheet: str, tmp_path: Path, run: Run
) -> None:
    text = (
        "wire: A2\nparameters:\n"
        "  insulation_modulus: {enters: prior, value: 3 GPa, factor: 1.2, because: a data sheet}\n"
    )
    asked = ("--plan", plan(tmp_path, text), "--out", str(tmp_path / "out"), "--no-figures")
    done = run("calibrate", str(campaign), "--wire", sheet, *asked)
    assert done.status == 0
    assert "standard errors of both together below the prior" in done.out


def test_a_curve_from_elsewhere_is_compared_with_tests_and_model(
    campaign: Path, sheet: str, tmp_path: Path, run: Run
) -> None:
    rows = [f"{i},{-2.0 * i},{-0.004 * i}" for i in range(26)]
    (tmp_path / "fe.csv").write_text("\n".join(["step,U2,RF2", *rows, ""]), encoding="utf-8")
    text = (
        "wire: A2\ncomparisons:\n"
        "  - {name: elements, file: fe.csv, wire: A2, length: 85 mm, load: normal, because: made,\n"
        "     deflection: {column: U2, unit: mm, sign: -1},\n"
        "     force: {column: RF2, unit: N, sign: -1}}\n"
    )
    out = tmp_path / "out"
    asked = ("--plan", plan(tmp_path, text), "--out", str(out))
    done = run("calibrate", str(campaign), "--wire", sheet, *asked)
    assert done.status == 0, done.err
    found = json.loads((out / "calibration.json").read_text("utf-8"))
    (curve,) = found["comparisons"]
    assert (curve["name"], curve["load"]) == ("elements", "normal")
    for each in (curve["tests"], curve["model"]):
        pairs = zip(curve["force"], each["force"], strict=True)
        left = [force - other for force, other in pairs if other is not None]
        assert each["n"] == len(left) > 20
        assert each["n"] + each["left_out"] == 26
        assert each["rmse"] == pytest.approx(np.sqrt(np.mean(np.square(left))))
    assert "elements tests of A2, 85 mm" in " ".join(done.out.split())
    assert "its load stays normal to the axis, the tests' does not" in done.out
    assert (out / "figures" / "external-curves.svg").is_file()


def test_a_curve_that_cannot_be_read_ends_a_calibration_before_it_begins(
    campaign: Path, sheet: str, tmp_path: Path, run: Run
) -> None:
    (tmp_path / "fe.csv").write_text("deflection_mm,force\n0,0\n1,1\n2,2\n", encoding="utf-8")
    asked = plan(
        tmp_path,
        "wire: A2\ncomparisons:\n"
        "  - {name: fe, file: fe.csv, wire: A2, length: 85 mm, because: made}\n",
    )
    said = refused(run, tmp_path, str(campaign), "--wire", sheet, "--plan", asked)
    assert "fe.csv, line 1, column 2: expected a unit of the force, found none in 'force'. " in said
