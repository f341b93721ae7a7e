"""What ``labpipe calibrate`` says on a terminal."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from labpipe.cli import DONE, main
from labpipe.cli.calibrate import calibration_table
from labpipe.records.curve import Interval
from labpipe.records.quality import QualityNote, Reason, Severity
from labpipe.records.wire_calibration import (
    Calibration,
    Identified,
    ParameterChoice,
)
from labpipe.studies.calibration_study import Calibrated
from labpipe.studies.first_loadings import FirstLoading
from labpipe.studies.validation import compare
from labpipe.wire.calibration.calibrate_wire import Settings, calibrate
from tests.builders.loading_tests import measured, wire_of


@pytest.fixture(scope="module")
def done() -> Calibrated:
    curves = measured("A2")
    found = calibrate(wire_of("A2"), curves, Settings())
    assert isinstance(found, Calibration)
    loadings = [FirstLoading(curve, 0.0, ()) for curve in curves]
    groups = compare(found, {"A2": wire_of("A2")}, loadings)
    return Calibrated(Path("processed/calibration"), found, groups, {}, ())


def test_parameters_with_intervals_and_units(done: Calibrated) -> None:
    lines = calibration_table(done).splitlines()
    assert lines[0].startswith("A2: 816 points of 3 samples, rms ")
    values = {line.split()[0]: line for line in lines[1:4]}
    assert list(values) == ["radial_friction", "insulation_modulus", "copper_scale"]
    assert " mN " in values["radial_friction"]
    assert " MPa " in values["insulation_modulus"]
    assert all(" 95 %: " in line for line in values.values())


def test_an_open_end_and_a_fixed_value(done: Calibrated) -> None:
    first, second, third = done.calibration.parameters
    odd = replace(
        done.calibration,
        parameters=(replace(first, is_open_below=True), second, replace(third, intervals=())),
    )
    lines = calibration_table(replace(done, calibration=odd)).splitlines()
    assert " 95 %: ? to " in lines[1]
    assert lines[3].endswith(str(third.verdict))


def test_what_is_not_identified_is_said(done: Calibrated) -> None:
    separability = done.calibration.friction_separability
    assert separability is not None
    assert f"  {separability.words}" in calibration_table(done).splitlines()


def test_a_line_per_wire_and_length(done: Calibrated) -> None:
    lines = calibration_table(done).splitlines()
    (line,) = [line for line in lines if line.startswith("  A2, 85 mm")]
    assert line.endswith("calibrating")
    (group,) = done.groups
    missing = replace(
        group, prediction=None, errors=None, reason=Reason("no_prediction", "too deep")
    )
    lines = calibration_table(replace(done, groups=(missing,))).splitlines()
    (line,) = [line for line in lines if line.startswith("  A2, 85 mm")]
    assert line.endswith("calibrating; no_prediction: too deep")


def test_columns_stay_apart_where_errors_are_large(done: Calibrated) -> None:
    (group,) = done.groups
    assert group.errors is not None
    errors = replace(group.errors, rmse=1234.5, rmse_share=35.0, inside=0.125)
    lines = calibration_table(replace(done, groups=(replace(group, errors=errors),))).splitlines()
    (line,) = [line for line in lines if line.startswith("  A2, 85 mm")]
    assert line.split()[3:] == ["3", "1230000", "3500", "%", "12.5", "%", "calibrating"]


def test_a_parameter_that_does_not_act(done: Calibrated) -> None:
    first, *others = done.calibration.parameters
    none = replace(first, value=float("nan"), intervals=(), verdict=Identified.FIXED)
    odd = replace(done.calibration, parameters=(none, *others))
    line = calibration_table(replace(done, calibration=odd)).splitlines()[1]
    assert line.split() == ["radial_friction", "-", "mN", "does", "not", "act"]


def test_notes_and_the_folder(done: Calibrated) -> None:
    note = QualityNote("test_doubtful", Severity.WARNING, "T1", "taken as it is: gap")
    with_note = replace(done, calibration=replace(done.calibration, notes=(note,)))
    lines = calibration_table(with_note).splitlines()
    assert lines[-2] == "  warning: T1: taken as it is: gap"
    assert lines[-1] == f"results: {Path('processed/calibration')}"


def test_what_the_words_of_a_parameter_say_is_not_said_again(done: Calibrated) -> None:
    modulus = done.calibration.parameter("insulation_modulus")
    note = QualityNote("not_identified", Severity.WARNING, modulus.name, modulus.words)
    with_note = replace(done, calibration=replace(done.calibration, notes=(note,)))
    assert calibration_table(with_note).count(modulus.words) == 1


def test_one_sample_and_a_value_at_a_far_bound(done: Calibrated) -> None:
    first, *others = done.calibration.parameters
    far = replace(first, value=100.0, intervals=())
    one = replace(done.calibration, n_samples=1, parameters=(far, *others))
    lines = calibration_table(replace(done, calibration=one)).splitlines()
    assert " points of 1 sample, rms" in lines[0]
    assert " 100000 mN" in lines[1]


def test_rejected_tests_are_not_handed_over(
    done: Calibrated, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    one, two = Path("processed/A2/A2-1/result.h5"), Path("processed/A2/A2-2/result.h5")
    taken: list[object] = []

    def take(targets: object, **_: object) -> Calibrated:
        taken.append(targets)
        return done

    monkeypatch.setattr("labpipe.cli.calibrate.find_results", lambda _: [one, two])
    monkeypatch.setattr("labpipe.cli.calibrate.calibrate_tests", take)
    for rejected, left in (({}, [Path("processed/A2")]), ({one: "slipped (A. Tester)"}, [two])):
        monkeypatch.setattr(
            "labpipe.cli.calibrate.without_rejected", lambda _, r=rejected: ([two], r)
        )
        assert main(["calibrate", "processed/A2"]) == DONE
        assert taken[-1] == left
    said = capsys.readouterr().err
    assert said == "labpipe calibrate: rejected: processed/A2/A2-1: slipped (A. Tester)\n"


def test_a_prior_is_named_with_value_spread_and_source(done: Calibrated) -> None:
    prior = ParameterChoice(1.1, factor=1.2, source="tensile tests of strands")
    found = calibrate(wire_of("A2"), measured("A2"), Settings({"copper_scale": prior}))
    assert isinstance(found, Calibration)
    said = calibration_table(replace(done, calibration=found))
    assert (
        "the prior of the strength of the copper, 1.1 within a factor of 1.2 "
        "(tensile tests of strands), agrees with the tests" in said
    )


def test_parts_of_an_interval(done: Calibrated) -> None:
    first, second, third = done.calibration.parameters
    parts = (Interval(0.6, 1.8), Interval(4.0, 9.0))
    two = replace(third, intervals=parts, verdict=Identified.TWO)
    odd = replace(done.calibration, parameters=(first, second, two))
    line = calibration_table(replace(done, calibration=odd)).splitlines()[3]
    assert line.startswith("?")
    assert line.endswith("95 %: 0.60 to 1.80 or 4.0 to 9.0  two solutions")
