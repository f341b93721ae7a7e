from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from labpipe.errors import LabpipeError, ProcessingError, UsageError
from labpipe.mechanics.studies.calibration_file import (
    CalibrationStudy,
    build_comparison_json,
    build_json,
    read_calibration,
)
from labpipe.mechanics.studies.calibration_study import (
    apply_calibration,
    build_sheet_wire,
    choose_wire,
    drop_copies,
    find_wire_sheet,
)
from labpipe.mechanics.studies.first_loadings import FirstLoading
from labpipe.mechanics.studies.model_comparisons import (
    compare_external_curves,
    compare_tests,
    make_misfit_notes,
    read_external_curves,
)
from labpipe.mechanics.studies.wire_sheets import WireSheet, read_wire_sheet
from labpipe.mechanics.wire.calibration.calibrate_wire import Settings, calibrate
from labpipe.mechanics.wire.calibration.calibrate_wire import find_tested_curvature as reached
from labpipe.mechanics.wire.wire_table import compute_insulation_limit
from labpipe.protocol.load import load_calibration_plan
from labpipe.protocol.model_files import CalibrationPlan
from labpipe.records.wire import (
    Calibration,
    ExternalCurve,
    ExternalCurveComparison,
)
from labpipe.report.calibration_report import ValidationGroup
from tests.approved import Approve
from tests.builders.harness_files import SHEET
from tests.builders.loading_tests import exact_curve, measured, wire_of
from tests.builders.wire_tables import spec_of


@pytest.fixture(scope="module")
def calibration_a3() -> Calibration:
    outcome = calibrate(wire_of("A3"), measured("A3", (0.12,), seed=1), Settings(gain=0.005))
    assert isinstance(outcome, Calibration)
    return outcome


@pytest.fixture
def file(calibration_a3: Calibration, tmp_path: Path) -> Path:
    calibrated = CalibrationStudy(Path("out"), calibration_a3, (), {}, (), tested_curvature=21.5)
    path = tmp_path / "calibration.json"
    path.write_text(json.dumps(build_json(calibrated), allow_nan=False), encoding="utf-8")
    return path


def test_what_was_written_is_read(calibration_a3: Calibration, file: Path) -> None:
    stored = read_calibration(file)
    assert (stored.wire, stored.widening, stored.tested_curvature) == (
        "A3",
        calibration_a3.widening,
        21.5,
    )
    assert len(stored.solutions) == len(calibration_a3.solutions)
    for read, had in zip(stored.solutions, calibration_a3.solutions, strict=True):
        assert np.array_equal(read.values, had.values)
        assert np.array_equal(read.covariance, had.covariance)
        assert (read.rise, read.limit, read.is_allowed) == (had.rise, had.limit, had.is_allowed)
        for name in ("chance", "scatter", "shift", "covariance"):
            assert np.array_equal(getattr(read.mixture, name), getattr(had.mixture, name))
        assert read.mixture.freedom == had.mixture.freedom


def test_another_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "calibration.json"
    with pytest.raises(ProcessingError, match="No such file"):
        read_calibration(path)
    for text, message in (
        ("{", "JSONDecodeError"),
        ('{"solutions": []}', "no solution"),
        ('{"wire": "A2", "solutions": [{"rise": 0.0}]}', "mixture"),
    ):
        path.write_text(text, encoding="utf-8")
        with pytest.raises(ProcessingError, match=message):
            read_calibration(path)


CURVES = measured("A2")


@pytest.fixture(scope="module")
def calibration() -> Calibration:
    outcome = calibrate(wire_of("A2"), CURVES, Settings())
    assert isinstance(outcome, Calibration)
    return outcome


WIRES = {"A2": wire_of("A2"), "A1": wire_of("A1")}


@cache
def groups_of(calibration: Calibration) -> tuple[ValidationGroup, ...]:
    return tuple(compare_tests(calibration, WIRES, loadings("A2")))


def test_a_calibrated_wire_has_the_found_numbers(calibration: Calibration) -> None:
    spec = spec_of("A2", "A2")
    calibrated = apply_calibration(spec, calibration)
    friction = calibrated.radial_force * (
        calibrated.friction_strand + calibrated.friction_insulation
    )
    assert friction == pytest.approx(calibration.get_parameter("radial_friction").value)
    assert calibrated.insulation_modulus == calibration.get_parameter("insulation_modulus").value
    assert calibrated.copper_k == spec.copper_k * calibration.get_parameter("copper_scale").value
    assert calibrated.name == spec.name


def test_json_is_plain_and_whole(calibration_a3: Calibration, calibration: Calibration) -> None:
    study_a3 = CalibrationStudy(Path("out"), calibration_a3, (), {}, ())
    pair = json.loads(json.dumps(build_json(study_a3)))
    assert len(pair["solutions"]) == 2
    assert all(solution["in_95_percent_set"] for solution in pair["solutions"])
    assert pair["widening"] == calibration_a3.widening > 1.0
    copper = pair["parameters"][2]
    assert len(copper["intervals"]) == len(copper["profiles"]) == 2
    ends = copper["intervals"][0][0], copper["intervals"][1][1]
    assert (copper["lower"], copper["upper"]) == ends
    study = CalibrationStudy(Path("out"), calibration, groups_of(calibration), {"T9": "why"}, ())
    content = json.loads(json.dumps(build_json(study), allow_nan=False))
    names = [parameter["name"] for parameter in content["parameters"]]
    assert names == ["radial_friction", "insulation_modulus", "copper_scale"]
    assert content["groups"][0]["prediction"]["force"][0] == pytest.approx(0.0)
    assert (content["wire"], content["left_out"]) == ("A2", {"T9": "why"})


def third(
    wire: str = "A2",
    length: float = 0.085,
    *,
    is_normal: bool = False,
    deepest: float = 0.045,
) -> ExternalCurve:
    """What the station-by-station path makes of the wire as the tests are made of it."""
    deflection = np.linspace(0.001, deepest, 16)
    force = exact_curve(wire, length, has_string=not is_normal)(np.minimum(deflection, 0.045))
    return ExternalCurve("fe", "fe.csv", wire, length, deflection, force, is_normal, "synthetic")


def held(calibration: Calibration, curve: ExternalCurve) -> ExternalCurveComparison:
    groups = groups_of(calibration)
    (compared,) = compare_external_curves([curve], calibration, WIRES, groups, loadings("A2"))
    return compared


def test_held_against_tests_and_model(calibration: Calibration) -> None:
    compared = held(calibration, third())
    assert compared.tests is not None
    for test in (compared.tests, compared.model):
        assert test.errors is not None
        assert test.errors.n == 16
        assert test.errors.rmse_share < 0.03  # scatter of three samples of 3 %
    assert compared.model.errors is not None
    assert compared.model.errors.coverage == 1.0
    assert compared.prediction is not None
    assert compared.prediction.deflection[-1] == pytest.approx(0.05, abs=1e-3)  # as far as tests
    assert not compared.notes
    content = json.loads(json.dumps(build_comparison_json(compared), allow_nan=False))
    assert (content["name"], content["load"], content["source"]) == ("fe", "as tested", "synthetic")
    assert len(content["deflection"]) == len(content["tests"]["force"]) == 16
    assert (content["model"]["n"], content["model"]["left_out"]) == (16, 0)
    assert build_comparison_json(replace(compared, tests=None))["tests"] is None


def test_a_normal_load_is_held_against_a_model_of_such_a_load(calibration: Calibration) -> None:
    normal = held(calibration, third(is_normal=True))
    pulled = held(calibration, replace(third(is_normal=True), is_normal=False))
    assert normal.tests is not None
    assert not pulled.notes
    (note,) = normal.notes
    assert note.code == "external_curve_load"
    assert "unlike that of the tests: at 45 mm the force of the model is" in note.message
    exact = (exact_curve("A2", 0.085)(0.045), exact_curve("A2", 0.085, has_string=False)(0.045))
    ratio = normal.model.reference[-1] / pulled.model.reference[-1]
    assert ratio == pytest.approx(exact[1] / exact[0], abs=1e-3)
    assert ratio < 0.985


def test_what_lies_beyond_is_left_out_and_told(calibration: Calibration) -> None:
    """Units mistaken leave nothing to compare_tests."""
    comparison = held(calibration, third(deepest=0.08))
    assert comparison.tests is not None
    assert (comparison.tests.n_excluded, comparison.model.n_excluded) == (6, 5)
    assert [note.code for note in comparison.notes] == ["external_curve_cut", "external_curve_cut"]
    tests, model = (note.message for note in comparison.notes)
    assert tests.startswith("6 of 16 points left out, outside of 0.")
    assert tests.endswith(" mm, the range of the tests")
    assert model == "5 of 16 points left out, outside of 0 to 55.25 mm, the range of the model"
    wrong = held(calibration, replace(third(), deflection=1e3 * third().deflection + 1.0))
    assert wrong.model.errors is None
    assert {note.code for note in wrong.notes} == {"external_curve_not_compared"}
    assert "0 of 16 points, from 2000 to 4.6e+04 mm, lie within" in wrong.notes[0].message


PLAN = (
    "version: 1\ncomparisons:\n"
    "  - {name: fe, file: fe.csv, wire: A2, length: 85 mm, load: normal, because: synthetic}\n"
)


def plan_of(folder: Path, text: str = PLAN) -> Path:
    path = folder / "plan.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def read(plan: Path) -> tuple[ExternalCurve, ...]:
    sheet = WireSheet(Path("wires.xlsx"), (spec_of("A2", "A2"),), {})
    return read_external_curves(load_calibration_plan(plan), plan, sheet)


def test_curves_are_read_beside_the_plan(tmp_path: Path) -> None:
    curve = "deflection / m,force / N\n0,0\n0.01,0.02\n0.02,0.04\n"
    (tmp_path / "fe.csv").write_text(curve, encoding="utf-8")
    (external,) = read(plan_of(tmp_path))
    assert (external.name, external.file, external.wire, external.is_normal) == (
        "fe",
        "fe.csv",
        "A2",
        True,
    )
    assert external.length == pytest.approx(0.085)
    assert external.deflection.tolist() == [0.0, 0.01, 0.02]
    assert external.force.tolist() == [0.0, 0.02, 0.04]


def test_all_that_is_wrong_is_told_at_once(tmp_path: Path, approved: Approve) -> None:
    """A curve is missing, in two places, and a wire; then a link leads out of the folder."""
    plan = plan_of(tmp_path, PLAN + PLAN.splitlines()[2].replace("fe,", "b,").replace("A2", "A22"))
    inner = tmp_path / "plan"
    inner.mkdir()
    with pytest.raises(UsageError) as wrong:
        read(plan)
    (tmp_path / "fe.csv").write_text("1,2\n", encoding="utf-8")
    (inner / "fe.csv").symlink_to(tmp_path / "fe.csv")
    with pytest.raises(UsageError) as misplaced:
        read(plan_of(inner))
    approved([wrong.value, misplaced.value])


@cache
def loadings(*names: str) -> list[FirstLoading]:
    return [FirstLoading(curve, 0.0, ()) for name in names for curve in measured(name)]


KNOWN = {spec.name: spec for spec in read_wire_sheet(SHEET).specs}
WEAK = {name: replace(spec, insulation_strain=0.01) for name, spec in KNOWN.items()}


@pytest.fixture(scope="module")
def groups(calibration: Calibration) -> tuple[ValidationGroup, ...]:
    return tuple(compare_tests(calibration, WIRES, loadings("A1", "A2")))


def test_groups_are_by_wire_and_length_the_own_first(groups: tuple[ValidationGroup, ...]) -> None:
    assert [(group.wire, group.is_calibrated) for group in groups] == [("A2", True), ("A1", False)]
    assert [len(group.samples) for group in groups] == [3, 3]
    for group in groups:
        assert group.errors is not None
        assert group.errors.rmse_share < 0.05
        assert group.errors.coverage > 0.9
        assert group.band.n == 3
    group = groups[0]
    assert group.errors is not None
    assert group.prediction is not None
    deflection, force = group.prediction.deflection, group.prediction.force
    residuals = [curve.force - np.interp(curve.deflection, deflection, force) for curve in CURVES]
    assert group.errors.n == sum(map(len, residuals))
    assert group.errors.sse == pytest.approx(sum(float(part @ part) for part in residuals))


@pytest.mark.slow
def test_tests_that_the_model_does_not_follow_are_said(calibration: Calibration) -> None:
    """A wave of 10 mN in the force, as no wire has, beside what the wire does."""
    (right,) = compare_tests(calibration, WIRES, loadings("A2"))
    assert not make_misfit_notes([right])
    waves = [replace(c, force=c.force + 0.01 * np.sin(c.deflection / 0.008)) for c in CURVES]
    outcome = calibrate(wire_of("A2"), waves, Settings())
    assert isinstance(outcome, Calibration)
    tests = [FirstLoading(curve, 0.0, ()) for curve in waves]
    (wrong,) = compare_tests(outcome, WIRES, tests)
    [note] = make_misfit_notes([wrong])
    assert (note.code, note.where) == ("model_misses_tests", "A2, 85 mm")
    assert 65 <= int(note.message.partition(" % of the points of the calibrating tests")[0]) <= 75
    assert not make_misfit_notes([replace(wrong, is_calibrated=False)])


def test_what_cannot_be_predicted_says_why(calibration: Calibration) -> None:
    deep = replace(
        CURVES[0],
        deflection=np.linspace(1e-3, 0.95 * CURVES[0].length, 50),
        force=np.linspace(0.0, 0.2, 50),
        noise=1e-3,
    )
    (group,) = compare_tests(calibration, WIRES, [FirstLoading(deep, 0.0, ())])
    assert group.prediction is None
    assert group.errors is None
    assert group.reason is not None
    assert group.reason.code == "no_prediction"


def test_from_where_on_a_prediction_is_doubtful(
    calibration: Calibration, groups: tuple[ValidationGroup, ...]
) -> None:
    """A wire that is bent to there and no farther has just the curvature of the limit."""
    measured = loadings("A1", "A2")
    assert [group.doubtful_deflection for group in groups] == [np.inf, np.inf]
    ranges = {name: compute_insulation_limit(WEAK[name]) for name in WIRES}
    weak = {name: replace(WIRES[name], linear_range=end) for name, end in ranges.items()}
    for group in compare_tests(calibration, weak, measured):
        assert group.prediction is not None
        assert 0.0 < group.doubtful_deflection < group.prediction.deflection[-1]
        curve = next(side.curve for side in measured if side.curve.wire == group.wire)
        ends = np.linspace(0.0, group.doubtful_deflection, 9)
        bent = replace(curve, deflection=ends, force=ends, noise=ends)
        curvature = reached(WIRES[group.wire], calibration.solutions[0].values, [bent])
        assert curvature == pytest.approx(ranges[group.wire], rel=2e-3)


SHEET_PATH = Path("wires.xlsx")


def wire_plan(wire: str | None = None) -> CalibrationPlan:
    return CalibrationPlan(version=1, wire=wire)


def test_the_sheet_of_the_working_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UsageError, match=r"expected a wire sheet, or wires.xlsx or wires.csv in"):
        find_wire_sheet()
    (tmp_path / "wires.csv").touch()
    assert find_wire_sheet() == Path("wires.csv")


def test_the_only_wire_or_the_one_of_the_plan(approved: Approve) -> None:
    """Wires of tests are in the sheet, and can be built."""
    spec, curve = spec_of("A2", "A2"), CURVES[0]
    a2 = [FirstLoading(curve, 0.0, ())]
    measured = [*a2, FirstLoading(replace(curve, wire="A1", test="A1-1"), 0.0, ())]
    assert choose_wire(a2, wire_plan(), None) == "A2"
    assert choose_wire(measured, wire_plan("A1"), None) == "A1"
    assert len(build_sheet_wire(spec, SHEET_PATH).section.layers) == 2
    thin = replace(spec, wire_diameter=0.5 * spec.wire_diameter)
    calls: list[Callable[[], object]] = [
        lambda: choose_wire(measured, wire_plan(), None),
        lambda: choose_wire(a2, wire_plan("A3"), None),
        lambda: build_sheet_wire(thin, SHEET_PATH),
    ]
    messages = []
    for call in calls:
        with pytest.raises(LabpipeError) as refused:
            call()
        messages.append(str(refused.value))
    approved(messages)


def test_a_copy_of_a_test_does_not_count() -> None:
    loading, second = (FirstLoading(curve, 0.0, ()) for curve in CURVES[:2])
    original, copy = (
        replace(loading, file=Path("x/T1/result.h5")),
        replace(loading, file=Path("y/T1/result.h5")),
    )
    originals, left_out = drop_copies([original, second, copy])
    assert originals == [original, second]
    assert left_out == {
        str(copy.file): f"{copy.file}: expected each test once, found the same first loading as in "
        f"{original.file}. Remove the copy."
    }
