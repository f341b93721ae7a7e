from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from labpipe.errors import LabpipeError, UsageError
from labpipe.protocol.plans import CalibrationPlan
from labpipe.records.group import Band
from labpipe.records.wire_calibration import Calibration
from labpipe.report.calibration_summary import ValidationGroup
from labpipe.statistics.mean_curves import common_curves, mean_band
from labpipe.studies.first_loadings import FirstLoading
from labpipe.studies.validation import (
    built_wire,
    compare,
    default_sheet,
    drop_copies,
    insulation_notes,
    mark_doubtful_parts,
    misfit_notes,
    require_wires,
    wire_to_calibrate,
)
from labpipe.studies.wire_specs import read_wire_sheet
from labpipe.wire.calibration.calibrate_wire import Settings, calibrate
from labpipe.wire.tested_curvature import tested_curvature as reached
from labpipe.wire.wire_table import straight_range
from tests.approved import Approve
from tests.builders.harness_files import SHEET
from tests.builders.loading_tests import exact_curve, measured, wire_of
from tests.builders.wire_tables import spec_of

CURVES = measured("A2")


@pytest.fixture(scope="module")
def calibration() -> Calibration:
    outcome = calibrate(wire_of("A2"), CURVES, Settings())
    assert isinstance(outcome, Calibration)
    return outcome


@cache
def loadings(*names: str) -> list[FirstLoading]:
    return [FirstLoading(curve, 0.0, ()) for name in names for curve in measured(name)]


WIRES = {"A2": wire_of("A2"), "A1": wire_of("A1")}
KNOWN = {spec.name: spec for spec in read_wire_sheet(SHEET)}
WEAK = {name: replace(spec, insulation_strain=0.01) for name, spec in KNOWN.items()}


@pytest.fixture(scope="module")
def groups(calibration: Calibration) -> tuple[ValidationGroup, ...]:
    return tuple(compare(calibration, WIRES, loadings("A1", "A2")))


def test_groups_are_by_wire_and_length_the_own_first(groups: tuple[ValidationGroup, ...]) -> None:
    assert [(group.wire, group.is_calibrated) for group in groups] == [("A2", True), ("A1", False)]
    assert [len(group.samples) for group in groups] == [3, 3]
    for group in groups:
        assert group.errors is not None
        assert group.errors.rmse_share < 0.05
        assert group.errors.inside > 0.9
        assert group.band.n == 3
    group = groups[0]
    assert group.errors is not None
    assert group.prediction is not None
    deflection, force = group.prediction.deflection, group.prediction.force
    off = [curve.force - np.interp(curve.deflection, deflection, force) for curve in CURVES]
    assert group.errors.n == sum(map(len, off))
    assert group.errors.sse == pytest.approx(sum(float(part @ part) for part in off))


@pytest.mark.slow
def test_tests_that_the_model_does_not_follow_are_said(calibration: Calibration) -> None:
    """A wave of 10 mN in the force, as no wire has, beside what the wire does."""
    (right,) = compare(calibration, WIRES, loadings("A2"))
    assert not misfit_notes([right])
    waves = [replace(c, force=c.force + 0.01 * np.sin(c.deflection / 0.008)) for c in CURVES]
    outcome = calibrate(wire_of("A2"), waves, Settings())
    assert isinstance(outcome, Calibration)
    tests = [FirstLoading(curve, 0.0, ()) for curve in waves]
    (wrong,) = compare(outcome, WIRES, tests)
    [note] = misfit_notes([wrong])
    assert (note.code, note.where) == ("model_misses_tests", "A2, 85 mm")
    assert note.message.startswith("70 % of the points of the calibrating tests lie in their 95 %")
    assert not misfit_notes([replace(wrong, is_calibrated=False)])


def test_what_cannot_be_predicted_says_why(calibration: Calibration) -> None:
    deep = replace(
        CURVES[0],
        deflection=np.linspace(1e-3, 0.95 * CURVES[0].length, 50),
        force=np.linspace(0.0, 0.2, 50),
        noise=1e-3,
    )
    (group,) = compare(calibration, WIRES, [FirstLoading(deep, 0.0, ())])
    assert group.prediction is None
    assert group.errors is None
    assert group.reason is not None
    assert group.reason.code == "no_prediction"


def test_predictions_beyond_the_line_of_the_insulation_are_said(calibration: Calibration) -> None:
    """The tests bend both wires to nearly 30 1/m: 1 % of strain at 12.5 and at 14.3 1/m."""
    both = loadings("A1", "A2")
    assert not insulation_notes(calibration, WIRES, KNOWN, both)
    predicted, calibrating = insulation_notes(calibration, WIRES, WEAK, both)
    assert {predicted.code, calibrating.code} == {"insulation_doubtful"}
    assert (predicted.where, calibrating.where) == ("A1", "A2")
    assert "from 14.3 1/m on" in predicted.message
    assert "predictions by the calibration of A2 are doubtful" in predicted.message
    assert "the parameters compensate for the softer insulation" in calibrating.message


def test_from_where_on_a_prediction_is_doubtful(
    calibration: Calibration, groups: tuple[ValidationGroup, ...]
) -> None:
    """A wire that is bent to there and no farther has just the curvature of the limit."""
    both = loadings("A1", "A2")
    sure = mark_doubtful_parts(groups, calibration, WIRES, KNOWN, both)
    assert [group.doubtful_deflection for group in sure] == [np.inf, np.inf]
    for group in mark_doubtful_parts(groups, calibration, WIRES, WEAK, both):
        assert group.prediction is not None
        assert 0.0 < group.doubtful_deflection < group.prediction.deflection[-1]
        curve = next(side.curve for side in both if side.curve.wire == group.wire)
        ends = np.linspace(0.0, group.doubtful_deflection, 9)
        bent = replace(curve, deflection=ends, force=ends, noise=ends)
        curvature = reached(WIRES[group.wire], calibration.solutions[0].values, [bent])
        assert curvature == pytest.approx(straight_range(WEAK[group.wire]), rel=2e-3)


def test_the_band_is_one_of_means_and_not_of_noise(groups: tuple[ValidationGroup, ...]) -> None:
    def roughness(band: Band) -> float:
        return float(np.std(np.diff(band.upper - band.lower, 2)))

    band = groups[0].band
    points = mean_band(common_curves([(curve.deflection, curve.force) for curve in CURVES]))
    assert roughness(band) < 0.2 * roughness(points)
    deep = band.displacement > 0.01
    share = band.mean[deep] / exact_curve("A2", 0.085)(band.displacement[deep])
    noise = 0.002 / np.sqrt(3 * 272 / 50) / band.mean[deep]
    factor = np.mean(share / noise**2) / np.mean(1.0 / noise**2)
    assert np.max(np.abs(share - factor) / noise) < 4.0


def test_the_mean_lies_among_its_samples_where_they_are_bent(calibration: Calibration) -> None:
    curve = exact_curve("A2", 0.085)
    deflection = np.linspace(1.5e-4, 0.05, 272)
    exact = [
        replace(
            curve_of_sample, deflection=deflection, force=factor * curve(deflection), noise=1e-4
        )
        for curve_of_sample, factor in zip(CURVES, (0.98, 1.0, 1.02), strict=True)
    ]
    tests = [FirstLoading(curve_of_sample, 0.0, ()) for curve_of_sample in exact]
    (group,) = compare(calibration, WIRES, tests)
    share = group.band.mean / curve(group.band.displacement)
    assert np.all((share > 0.98) & (share < 1.02))


SHEET_PATH = Path("wires.xlsx")


def plan_of(wire: str | None = None) -> CalibrationPlan:
    return CalibrationPlan(version=1, wire=wire)


def test_the_sheet_of_the_working_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UsageError, match=r"expected a wire sheet, or wires.xlsx or wires.csv in"):
        default_sheet()
    (tmp_path / "wires.csv").touch()
    assert default_sheet() == Path("wires.csv")


def test_the_only_wire_or_the_one_of_the_plan(approved: Approve) -> None:
    """Wires of tests are in the sheet, and can be built."""
    spec, curve = spec_of("A2", "A2"), CURVES[0]
    a2 = [FirstLoading(curve, 0.0, ())]
    both = [*a2, FirstLoading(replace(curve, wire="A1", test="A1-1"), 0.0, ())]
    assert wire_to_calibrate(a2, plan_of(), None) == "A2"
    assert wire_to_calibrate(both, plan_of("A1"), None) == "A1"
    require_wires(a2, {"A2": spec}, SHEET_PATH)
    assert len(built_wire(spec, SHEET_PATH).section.layers) == 2
    thin = replace(spec, wire_diameter=0.5 * spec.wire_diameter)
    calls: list[Callable[[], object]] = [
        lambda: wire_to_calibrate(both, plan_of(), None),
        lambda: wire_to_calibrate(a2, plan_of("A3"), None),
        lambda: require_wires(both, {"A2": spec}, SHEET_PATH),
        lambda: built_wire(thin, SHEET_PATH),
    ]
    messages = []
    for call in calls:
        with pytest.raises(LabpipeError) as refused:
            call()
        messages.append(str(refused.value))
    approved(messages)


def test_a_copy_of_a_test_does_not_count() -> None:
    first, other = (FirstLoading(curve, 0.0, ()) for curve in CURVES[:2])
    one, two = (
        replace(first, file=Path("x/T1/result.h5")),
        replace(first, file=Path("y/T1/result.h5")),
    )
    originals, left_out = drop_copies([one, other, two])
    assert originals == [one, other]
    assert left_out == {
        str(two.file): f"{two.file}: expected each test once, found the same first loading as in "
        f"{one.file}. Remove the copy."
    }
