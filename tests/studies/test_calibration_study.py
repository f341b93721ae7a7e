"""What is made of a calibration: calibrated wires, groups compared with it, and plain numbers."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from labpipe.records.wire_calibration import Calibration, ParameterChoice
from labpipe.studies.calibration_study import (
    Calibrated,
    as_json,
    calibrated_spec,
)
from labpipe.studies.first_loadings import FirstLoading
from labpipe.studies.validation import compare
from labpipe.wire.calibration.calibrate_wire import Settings, calibrate
from tests.builders.loading_tests import measured, wire_of
from tests.builders.wire_tables import wire_table

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
    assert [each["name"] for each in found["parameters"]] == [
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
    assert all(each["in_95_percent_set"] for each in found["solutions"])
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
