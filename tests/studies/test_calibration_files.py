from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from labpipe.errors import ProcessingError, UsageError
from labpipe.protocol.load import load_calibration_plan
from labpipe.records.wire import WireSpec
from labpipe.records.wire_calibration import (
    PARAMETERS,
    Calibration,
    ExternalCurve,
    ExternalCurveComparison,
    ParameterChoice,
)
from labpipe.studies.calibration_file import read_calibrated
from labpipe.studies.calibration_study import (
    Calibrated,
    as_json,
    calibrated_spec,
    comparison_json,
)
from labpipe.studies.external_curves import compare_external_curves, read_external_curves
from labpipe.studies.first_loadings import FirstLoading
from labpipe.studies.validation import compare
from labpipe.wire.calibration.calibrate_wire import Settings, calibrate
from tests.builders.loading_tests import exact_curve, measured, wire_of
from tests.builders.wire_tables import wire_table


@pytest.fixture(scope="module")
def made() -> Calibration:
    found = calibrate(wire_of("A3"), measured("A3", (0.12,), seed=1), Settings(gain=0.005))
    assert isinstance(found, Calibration)
    return found


@pytest.fixture
def file(made: Calibration, tmp_path: Path) -> Path:
    done = Calibrated(Path("out"), made, (), {}, (), tested_curvature=21.5)
    path = tmp_path / "calibration.json"
    path.write_text(json.dumps(as_json(done), allow_nan=False), encoding="utf-8")
    return path


def test_what_was_written_is_read(made: Calibration, file: Path) -> None:
    found = read_calibrated(file)
    assert (found.wire, found.widening, found.tested_curvature) == ("A3", made.widening, 21.5)
    assert len(found.solutions) == len(made.solutions)
    for read, had in zip(found.solutions, made.solutions, strict=True):
        assert np.array_equal(read.values, had.values)
        assert np.array_equal(read.covariance, had.covariance)
        assert (read.rise, read.limit, read.is_allowed) == (had.rise, had.limit, had.is_allowed)
        for name in ("chance", "scatter", "shift", "covariance"):
            assert np.array_equal(getattr(read.mixture, name), getattr(had.mixture, name))
        assert read.mixture.freedom == had.mixture.freedom
    assert found.values() == dict(zip(PARAMETERS, made.solutions[0].values, strict=True))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{", "JSONDecodeError"),
        ('{"solutions": []}', "no solution"),
        ('{"wire": "A2", "solutions": [{"rise": 0.0}]}', "mixture"),
    ],
)
def test_another_file_is_refused(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "calibration.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ProcessingError, match=said):
        read_calibrated(path)


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ProcessingError, match="No such file"):
        read_calibrated(tmp_path / "calibration.json")


CURVES = measured("A2")


TWO_VALLEYS = measured("A3", (0.12,), seed=1)


@pytest.fixture(scope="module")
def calibration() -> Calibration:
    found = calibrate(wire_of("A2"), CURVES, Settings())
    assert isinstance(found, Calibration)
    return found


def loadings(*names: str) -> list[FirstLoading]:
    return [FirstLoading(curve, 0.0, ()) for name in names for curve in measured(name)]


def test_a_calibrated_wire_has_the_found_numbers(calibration: Calibration) -> None:
    spec = wire_table("A2").spec
    made = calibrated_spec(spec, calibration)
    friction = made.radial_force * (made.friction_strand + made.friction_insulation)
    assert friction == pytest.approx(calibration.parameter("radial_friction").value)
    assert made.insulation_modulus == calibration.parameter("insulation_modulus").value
    assert made.copper_k == spec.copper_k * calibration.parameter("copper_scale").value
    assert (
        replace(
            made,
            radial_force=spec.radial_force,
            insulation_modulus=spec.insulation_modulus,
            copper_k=spec.copper_k,
        ).name
        == spec.name
    )


def test_json_is_plain_and_says_what_is_not_identified(calibration: Calibration) -> None:
    groups = compare(calibration, {"A2": wire_of("A2")}, loadings("A2"))
    done = Calibrated(Path("out"), calibration, groups, {"T9": "why"}, ())
    found = json.loads(json.dumps(as_json(done), allow_nan=False))
    assert found["wire"] == "A2"
    assert [finding["name"] for finding in found["parameters"]] == [
        *("radial_friction", "insulation_modulus", "copper_scale"),
    ]
    assert not any(found["friction_separability"]["identified"].values())
    assert len(found["friction_separability"]["singular_values"]) == 3
    assert found["groups"][0]["prediction"]["force"][0] == pytest.approx(0.0)
    assert found["left_out"] == {"T9": "why"}


def test_json_has_solutions_and_parts() -> None:
    made = calibrate(wire_of("A3"), TWO_VALLEYS, Settings(gain=0.005))
    assert isinstance(made, Calibration)
    found = json.loads(json.dumps(as_json(Calibrated(Path("out"), made, (), {}, ()))))
    assert len(found["solutions"]) == 2
    assert all(finding["in_95_percent_set"] for finding in found["solutions"])
    assert found["widening"] == made.widening > 1.0
    copper = found["parameters"][2]
    assert len(copper["intervals"]) == len(copper["profiles"]) == 2
    ends = copper["intervals"][0][0], copper["intervals"][1][1]
    assert (copper["lower"], copper["upper"]) == ends


def test_json_names_priors_and_what_was_held() -> None:
    prior = ParameterChoice(1e9, factor=4.0, source="data sheet")
    held = ParameterChoice(0.0465, is_fixed=True, source="a calibration of A2")
    choices = {"insulation_modulus": prior, "radial_friction": held}
    made = calibrate(wire_of("A3"), TWO_VALLEYS, Settings(choices, gain=0.005))
    assert isinstance(made, Calibration)
    found = json.loads(json.dumps(as_json(Calibrated(Path("out"), made, (), {}, ()))))
    friction, modulus, _ = found["parameters"]
    assert (friction["source"], friction["intervals"]) == ("a calibration of A2", [])
    said = modulus["prior"]
    assert said["value"] == pytest.approx(1e9)
    assert (said["factor"], said["source"]) == (4.0, "data sheet")


WIRES = {"A2": wire_of("A2"), "A1": wire_of("A1")}


def specs() -> Mapping[str, WireSpec]:
    return {"A2": wire_table("A2").spec}


def third(
    wire: str = "A2",
    length: float = 0.085,
    *,
    is_normal: bool = False,
    deepest: float = 0.045,
) -> ExternalCurve:
    """What the station-by-station path makes of the wire as the tests are made of it."""
    at = np.linspace(0.001, deepest, 16)
    force = exact_curve(wire, length, has_string=not is_normal)(np.minimum(at, 0.045))
    return ExternalCurve("fe", "fe.csv", wire, length, at, force, is_normal, "synthetic")


def held(calibration: Calibration, curve: ExternalCurve) -> ExternalCurveComparison:
    loadings = [FirstLoading(curve, 0.0, ()) for curve in CURVES]
    groups = compare(calibration, WIRES, loadings)
    (found,) = compare_external_curves([curve], calibration, WIRES, groups, loadings)
    return found


def test_held_against_tests_and_model(calibration: Calibration) -> None:
    found = held(calibration, third())
    assert found.tests is not None
    for test in (found.tests, found.model):
        assert test.errors is not None
        assert test.errors.n == 16
        assert test.errors.rmse_share < 0.03  # scatter of three samples of 3 %
    assert found.model.errors is not None
    assert found.model.errors.inside == 1.0
    assert found.prediction is not None
    assert found.prediction.deflection[-1] == pytest.approx(0.05, abs=1e-3)  # as far as the tests
    assert not found.notes


def test_a_normal_load_is_held_against_a_model_of_such_a_load(calibration: Calibration) -> None:
    normal = held(calibration, third(is_normal=True))
    pulled = held(calibration, replace(third(is_normal=True), is_normal=False))
    assert normal.tests is not None
    assert normal.model.errors is not None
    assert pulled.model.errors is not None
    (note,) = normal.notes
    assert note.code == "external_curve_load"
    assert not pulled.notes
    assert "normal to the axis, the tests' does not: at 45 mm the model's force is" in note.message
    exact = (exact_curve("A2", 0.085)(0.045), exact_curve("A2", 0.085, has_string=False)(0.045))
    ratio = normal.model.reference[-1] / pulled.model.reference[-1]
    assert ratio == pytest.approx(exact[1] / exact[0], abs=1e-3)
    assert ratio < 0.985


def test_tests_without_a_string_are_loaded_alike(calibration: Calibration) -> None:
    loadings = [FirstLoading(replace(curve, rig=None), 0.0, ()) for curve in CURVES]
    groups = compare(calibration, WIRES, loadings)
    curve = third(is_normal=True)
    (found,) = compare_external_curves([curve], calibration, WIRES, groups, loadings)
    assert not found.notes


@pytest.mark.parametrize(("wire", "length"), [("A1", 0.085), ("A2", 0.12)])
def test_without_tests_the_model_alone(calibration: Calibration, wire: str, length: float) -> None:
    found = held(calibration, third(wire, length))
    assert found.tests is None
    assert found.model.errors is not None
    assert found.model.errors.rmse_share < 0.03
    (note,) = found.notes
    assert note.code == "external_curve_untested"
    said = f"no test of {wire} at {1e3 * length:.4g} mm: compared with the model alone"
    assert note.message == said


def test_what_lies_beyond_is_left_out_and_told(calibration: Calibration) -> None:
    found = held(calibration, third(deepest=0.08))
    assert found.tests is not None
    assert (found.tests.left_out, found.model.left_out) == (6, 5)
    assert [note.code for note in found.notes] == ["external_curve_cut", "external_curve_cut"]
    tests, model = (note.message for note in found.notes)
    assert tests.startswith("6 of 16 points left out, outside of 0.")
    assert tests.endswith(" mm, the range of the tests")
    assert model == "5 of 16 points left out, outside of 0 to 55.25 mm, the range of the model"


def test_units_mistaken_leave_nothing_to_compare(calibration: Calibration) -> None:
    wrong = replace(third(), deflection=1e3 * third().deflection + 1.0)
    found = held(calibration, wrong)
    assert found.model.errors is None
    assert {note.code for note in found.notes} == {"external_curve_not_compared"}
    assert "0 of 16 points, from 2000 to 4.6e+04 mm, lie within" in found.notes[0].message


@pytest.mark.slow
def test_as_plain_numbers(calibration: Calibration) -> None:
    found = json.loads(json.dumps(comparison_json(held(calibration, third())), allow_nan=False))
    assert (found["name"], found["load"], found["source"]) == ("fe", "as tested", "synthetic")
    assert len(found["deflection"]) == len(found["tests"]["force"]) == 16
    assert found["model"]["n"] == 16
    assert found["model"]["left_out"] == 0
    alone = comparison_json(held(calibration, third("A1")))
    assert alone["tests"] is None
    lost = replace(held(calibration, third()), tests=None)
    assert comparison_json(lost)["tests"] is None


PLAN = (
    "version: 1\ncomparisons:\n"
    "  - {name: fe, file: fe.csv, wire: A2, length: 85 mm, load: normal, because: synthetic}\n"
)


def plan_of(folder: Path, text: str = PLAN) -> Path:
    path = folder / "plan.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def read(plan: Path) -> tuple[ExternalCurve, ...]:
    return read_external_curves(load_calibration_plan(plan), plan, specs(), Path("wires.xlsx"))


def test_curves_are_read_beside_the_plan(tmp_path: Path) -> None:
    curve = "deflection / m,force / N\n0,0\n0.01,0.02\n0.02,0.04\n"
    (tmp_path / "fe.csv").write_text(curve, encoding="utf-8")
    (found,) = read(plan_of(tmp_path))
    assert (found.name, found.file, found.wire, found.is_normal) == ("fe", "fe.csv", "A2", True)
    assert found.length == pytest.approx(0.085)
    assert found.deflection.tolist() == [0.0, 0.01, 0.02]
    assert found.force.tolist() == [0.0, 0.02, 0.04]


def test_all_that_is_wrong_is_told_at_once(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, PLAN + PLAN.splitlines()[2].replace("fe,", "b,").replace("A2", "A22"))
    with pytest.raises(UsageError) as caught:
        read(plan)
    missing, unknown, again = str(caught.value).splitlines()
    assert missing == again
    file = tmp_path / "fe.csv"
    assert missing == (
        f"{file}: expected a file, found none of that name. Check the name and the folder."
    )
    assert unknown == (
        f"{plan}, comparison 'b', wire: expected a wire of wires.xlsx (A2), found 'A22'. Name the "
        "wire that the curve is of, or add it to the sheet."
    )


def test_a_link_out_of_the_folder(tmp_path: Path) -> None:
    inner = tmp_path / "plan"
    inner.mkdir()
    (tmp_path / "fe.csv").write_text("1,2\n", encoding="utf-8")
    (inner / "fe.csv").symlink_to(tmp_path / "fe.csv")
    with pytest.raises(UsageError, match="expected a file inside the folder of the plan, found a"):
        read(plan_of(inner))
