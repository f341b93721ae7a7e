"""``labpipe calibrate``: from processed tests to a calibrated wire, predictions, and refusals."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from labpipe.cli import main
from labpipe.mechanics.studies.model_comparisons import N_SHAPES, compare_shapes
from labpipe.mechanics.studies.wire_sheets import read_wire_sheet
from labpipe.mechanics.wire.calibration.calibrate_wire import Wire
from labpipe.mechanics.wire.cantilever import StringRig
from labpipe.mechanics.wire.wire_table import build_wire, tabulate_wire
from labpipe.records.result import TestResult
from labpipe.store.result_files import read_result, write_result
from labpipe.virtual_lab import WireCampaign, simulate_campaigns, simulate_test
from labpipe.virtual_lab.campaigns import WireGroup
from labpipe.virtual_lab.specimens import WIRES as SPECIMENS
from labpipe.virtual_lab.tensile import build_corrugated_tube
from tests.approved import Approve
from tests.builders.small_tests import Run, RunSummary, state
from tests.builders.tensile_tests import make_tensile

pytestmark = pytest.mark.slow
HEADING = "wire,wire_diameter_mm,strands,strand_diameter_mm,lay_angles_deg,insulation_thickness_mm"
WIRES = WireCampaign(
    groups=(WireGroup(SPECIMENS["A2"], 0.085), WireGroup(SPECIMENS["B1"], 0.1)),
    samples=2,
    fps=25.0,
    cycles=2,
    has_mishaps=False,
)
TRUTH = {"radial_friction": 0.0465, "insulation_modulus": 1e9, "copper_scale": 1.0}


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Processed tests: two samples of A2 and of B1; not to be changed."""
    home = tmp_path_factory.mktemp("wires")
    for test in simulate_campaigns([WIRES], home / "raw" / "wires", seed=3):
        main(["process", str(test), "--out", str(home / "processed"), "--no-figures"])
    return home / "processed"


def hung(home: Path, slack: float) -> Path:
    """A processed test of A2 that hung under the counterweight until the clamp went by a slack."""
    one = replace(WIRES, groups=WIRES.groups[:1], samples=1)
    ((scenario, seed),) = one.list_scenarios(3)
    mechanics = replace(scenario.mechanics, slack=slack)
    named = replace(scenario, name="A2-085-hung", mechanics=mechanics)
    test = simulate_test(named, home / "raw" / named.name, seed)
    main(["process", str(test), "--out", str(home / "processed"), "--no-figures"])
    return home / "processed" / named.name


@pytest.fixture
def sheet(repository: Path) -> str:
    return str(repository / "examples" / "wires.xlsx")


def plan(folder: Path, text: str) -> str:
    path = folder / "plan.yaml"
    path.write_text(f"version: 1\n{text}", encoding="utf-8")
    return str(path)


def test_truth_is_found_and_other_wires_and_curves_compared(
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
    found: dict[str, Any] = json.loads((out / "calibration.json").read_text("utf-8"))
    assert found["wire"] == "A2"
    for finding in found["parameters"]:
        low, high = finding["lower"], finding["upper"]
        assert low is None or low < TRUTH[finding["name"]]
        assert high is None or TRUTH[finding["name"]] < high
    first, second = found["groups"]
    assert (first["wire"], first["calibrating"]) == ("A2", True)
    assert (second["wire"], second["calibrating"]) == ("B1", False)
    assert second["rmse_share"] < 0.08
    assert second["inside_band"] > 0.9
    (curve,) = found["comparisons"]
    assert (curve["name"], curve["load"]) == ("elements", "normal")
    for point in (curve["tests"], curve["model"]):
        pairs = zip(curve["force"], point["force"], strict=True)
        left = [force - other for force, other in pairs if other is not None]
        assert point["n"] == len(left) > 20
        assert point["n"] + point["left_out"] == 26
        assert point["rmse"] == pytest.approx(np.sqrt(np.mean(np.square(left))))
    printed = " ".join(done.out.split())
    for part in (
        *("not identified separately", "predicted", "elements; tests: RMSE"),
        "its load is normal to the axis, unlike that of the tests",
    ):
        assert part in printed
    assert (out / "calibration.xlsx").is_file()
    assert (out / "figures" / "external-curves.svg").is_file()
    values = {parameter["name"]: parameter["value"] for parameter in found["parameters"]}
    deck = json.loads((out / "decks" / "B1.json").read_text("utf-8"))
    nominal = next(spec for spec in read_wire_sheet(Path(sheet)).specs if spec.name == "B1")
    calibrated = replace(
        nominal,
        radial_force=values["radial_friction"] / (0.21 + 0.10),
        insulation_modulus=values["insulation_modulus"],
        copper_k=530e6 * values["copper_scale"],
    )
    assert deck["moment"] == pytest.approx(tabulate_wire(calibrated).moment.tolist(), rel=1e-9)
    assert deck["moment"] != pytest.approx(tabulate_wire(nominal).moment.tolist(), rel=1e-6)


def test_tests_beyond_the_range_of_the_insulation_are_told(
    campaign: Path, tmp_path: Path, run: Run
) -> None:
    sheet = tmp_path / "wires.csv"
    arguments = ("calibrate", campaign, "--wire", sheet, "--plan", plan(tmp_path, "wire: A2\n"))

    def calibrated(cells: str) -> tuple[dict[str, Any], list[str]]:
        sheet.write_text(
            f"{HEADING},insulation_strain,insulation_table\n"
            f"A2,1.6,7,0.32,12,0.3,{cells}\nB1,1.1,7,0.25,12,0.15,,\n"
        )
        done = run(*arguments, "--no-figures", "--out", tmp_path)
        assert done.status == 0, done.err
        found = json.loads((tmp_path / "calibration.json").read_text("utf-8"))
        notes = [note for note in found["quality"] if note["code"] == "insulation_doubtful"]
        return found, [note["message"] for note in notes]

    found, [message] = calibrated("0.01,")
    for part in (f"A2 to {found['tested_curvature']:.3g} 1/m", "12.5 1/m", "more than 1 %"):
        assert part in message
    assert found["stress_tables"] == {}
    # a table need not go on beyond the tests
    (tmp_path / "pvc.csv").write_text("strain,stress_mpa,temperature_c\n0.028,28,23\n")
    found, notes = calibrated(",pvc.csv")
    assert not notes
    assert found["stress_tables"]["insulation_table"]["temperature"] == pytest.approx(296.15)
    assert 29.0 < found["tested_curvature"] < 0.028 / 0.8e-3


def test_the_model_is_bent_as_far_as_the_sample(campaign: Path, repository: Path) -> None:
    sheet = read_wire_sheet(repository / "examples" / "wires.xlsx").specs
    made = build_wire(next(spec for spec in sheet if spec.name == "A2"))
    wire = Wire(made.section, made.contacts)
    for rig in (StringRig(0.76, 0.0265, 0.085, 0.76), None):
        shapes = compare_shapes(campaign / "A2-085-1" / "result.h5", wire, 0.085, rig, 0.045)
        assert len(shapes) == N_SHAPES
        for number, shape in enumerate(shapes, start=1):
            assert shape.deflection == pytest.approx(0.045 * number / N_SHAPES, abs=2e-4)
            assert shape.model[-1, 1] == pytest.approx(shape.deflection, abs=2e-6)
            # Scatter of the sample and of its markers; a wrong frame or sign is many times that.
            assert np.abs(shape.fit[-1] - shape.model[-1]).max() < 0.5e-3
            assert len(shape.markers) == 8


@pytest.fixture
def calibrate(sheet: str, tmp_path: Path, run: Run) -> Callable[..., RunSummary]:
    """Calibrate tests, by a plan where one is given; without one, earlier results stay."""

    def calibrated(*tests: Path, text: str = "") -> RunSummary:
        asked = ("--plan", plan(tmp_path, text)) if text else ()
        out = tmp_path / "out"
        out.mkdir(exist_ok=True)
        (out / "calibration.json").write_text("{}", encoding="utf-8")
        before = state(out)
        done = run("calibrate", *tests, "--wire", sheet, "--no-figures", "--out", out, *asked)
        assert "Traceback" not in done.err
        assert (state(out) == before) == (done.out == "")
        return done

    return calibrated


def changed(test: Path, folder: Path, change: Callable[[TestResult], TestResult]) -> Path:
    """Write another result file, of a processed test to which something was done."""
    file = folder / test.name / "result.h5"
    file.parent.mkdir(parents=True)
    write_result(change(read_result(test / "result.h5")), file)
    return file.parent


def blocked(result: TestResult) -> TestResult:
    return replace(result, curve=None, aligned=None, shape=None, bending=None)


def without_length(result: TestResult) -> TestResult:
    bare = re.sub(r"specimen:\n(  .*\n)+", "specimen: {}\n", result.protocol_yaml)
    assert bare != result.protocol_yaml
    return replace(result, specimen=replace(result.specimen, dimensions={}), protocol_yaml=bare)


PLANS = {
    "a wire without tests": "wire: A3\n",
    "two wires": "",
    "fewer points than parameters": "wire: A2\nup_to: 0.5 mm\npoints: 20\n",
    "a value outside the bounds": "wire: A2\nparameters:\n"
    "  copper_scale: {enters: prior, value: 100, factor: 2, because: a slip}\n",
    "a curve that cannot be read": "wire: A2\ncomparisons:\n"
    "  - {name: fe, file: fe.csv, wire: A2, length: 85 mm, because: made}\n",
}


def test_plans_that_cannot_be_followed(
    campaign: Path, tmp_path: Path, calibrate: Callable[..., RunSummary], approved: Approve
) -> None:
    (tmp_path / "fe.csv").write_text("deflection_mm,force\n0,0\n1,1\n2,2\n", encoding="utf-8")
    told = []
    for name, text in PLANS.items():
        done = calibrate(campaign, text=text)
        assert (done.status, done.out) == (2, "")
        told.append(f"{name}: {done.err.strip()}".replace(str(campaign), "CAMPAIGN"))
    approved(told)


def test_wire_sheets_that_are_missing(
    campaign: Path, tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch, approved: Approve
) -> None:
    monkeypatch.chdir(tmp_path)
    alone = run("calibrate", campaign)
    (tmp_path / "wires.csv").write_text(f"{HEADING}\nA22,1.6,7,0.32,12,0.3\n", encoding="utf-8")
    other = run("calibrate", campaign / "A2-085-1")
    assert (alone.status, other.status) == (2, 2)
    approved([alone.err, other.err])


def test_tests_that_cannot_be_taken(
    campaign: Path, tmp_path: Path, calibrate: Callable[..., RunSummary], approved: Approve
) -> None:
    """Alone they end a calibration; beside another test they are left out and named."""
    lab = make_tensile(tmp_path / "pulled", build_corrugated_tube("CT-10-3"), 1)
    assert main(["process", str(lab.raw), "--no-figures"]) == 0
    first = campaign / "A2-085-1"
    broken = tmp_path / "broken" / "A2-085-2"
    shutil.copytree(campaign / "A2-085-2", broken)
    (broken / "result.h5").write_bytes(b"no HDF5")
    tests = {
        "blocked": changed(campaign / "A2-085-2", tmp_path / "blocked", blocked),
        "no cantilever": lab.processed,
        "no free length": changed(campaign / "A2-085-2", tmp_path / "bare", without_length),
        "slack string": hung(tmp_path / "slack", 1.5e-3),
        "hanging wire": hung(tmp_path / "hanging", 0.0),
        "broken file": broken,
    }
    told = []
    for name, test in tests.items():
        alone, beside = calibrate(test), calibrate(first, test)
        assert (alone.status, alone.out) == (2, ""), name
        assert (beside.status, beside.out[:3]) == (2, "A2\n"), name
        assert "points of 1 curve of 1 sample" in beside.out
        found = json.loads((tmp_path / "out" / "calibration.json").read_text("utf-8"))
        assert [Path(file).parent for file in found["left_out"]] == [test], name
        told += [f"{name}: {alone.err.strip()}", f"  {beside.err.strip()}"]
    approved(re.sub(r"\d+\.\d+ ", "# ", line) for line in told)


def test_two_tests_of_one_name_and_half_of_a_third(
    campaign: Path, tmp_path: Path, calibrate: Callable[..., RunSummary]
) -> None:
    again = changed(campaign / "A2-085-1", tmp_path, lambda result: result)
    done = calibrate(campaign / "A2-085-1", campaign / "A2-085-2", again)
    assert (done.status, done.out) == (2, "")
    assert "expected one test for each name, found a second for 'A2-085-1'" in done.err
    half = again / ".labpipe.new" / "result.h5"
    half.parent.mkdir()
    half.write_bytes((again / "result.h5").read_bytes()[:1000])
    done = calibrate(again)
    assert (done.status, done.err) == (0, "")
    assert "One sample: the scatter of samples is unknown" in done.out
