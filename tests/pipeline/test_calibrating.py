"""What is made of a calibration: calibrated wires, groups held against it, and plain numbers."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from labpipe.pipeline.calibrating import (
    Calibrated,
    as_json,
    calibrated_spec,
    compare,
)
from labpipe.pipeline.first_loadings import FirstLoading
from labpipe.records.calibration import Calibration
from labpipe.wire.calibrating.source_method import calibrate_as_source
from labpipe.wire.calibration import Settings, calibrate
from tests.builders.loading_tests import measured, wire_of
from tests.builders.wire_tables import wire_table

CURVES = measured("A2")


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


def test_groups_are_by_wire_and_length_the_own_first(calibration: Calibration) -> None:
    wires = {"A2": wire_of("A2"), "A1": wire_of("A1")}
    groups = compare(calibration, wires, loadings("A1", "A2"))
    assert [(group.wire, group.is_calibrated) for group in groups] == [("A2", True), ("A1", False)]
    assert [len(group.samples) for group in groups] == [3, 3]
    for group in groups:
        assert group.errors is not None
        assert group.errors.rmse_share < 0.05
        assert group.errors.inside > 0.9
        assert group.band.n == 3


def test_errors_are_of_all_points(calibration: Calibration) -> None:
    (group,) = compare(calibration, {"A2": wire_of("A2")}, loadings("A2"))
    assert group.errors is not None
    assert group.prediction is not None
    assert group.errors.n == sum(len(curve.force) for curve in CURVES)
    left = np.concatenate(
        [
            curve.force
            - np.interp(curve.deflection, group.prediction.deflection, group.prediction.force)
            for curve in CURVES
        ]
    )
    assert group.errors.sse == pytest.approx(float(left @ left))


def test_what_cannot_be_foretold_says_why(calibration: Calibration) -> None:
    deep = replace(
        CURVES[0],
        deflection=np.linspace(1e-3, 0.95 * CURVES[0].length, 50),
        force=np.linspace(0.0, 0.2, 50),
        noise=1e-3,
    )
    (group,) = compare(calibration, {"A2": wire_of("A2")}, [FirstLoading(deep, 0.0, ())])
    assert group.prediction is None
    assert group.errors is None
    assert group.reason.startswith("no_prediction: ")


def test_json_is_plain_and_says_what_is_not_identified(calibration: Calibration) -> None:
    groups = compare(calibration, {"A2": wire_of("A2")}, loadings("A2"))
    source = calibrate_as_source(wire_of("A2"), CURVES)
    done = Calibrated(Path("out"), calibration, source, groups, {"T9": "why"}, ())
    found = json.loads(json.dumps(as_json(done), allow_nan=False))
    assert found["wire"] == "A2"
    assert [each["name"] for each in found["parameters"]] == [
        *("radial_friction", "insulation_modulus", "copper_scale"),
    ]
    assert not any(found["friction_separability"]["identified"].values())
    assert len(found["friction_separability"]["singular_values"]) == 3
    assert found["groups"][0]["prediction"]["force"][0] == pytest.approx(0.0)
    assert found["left_out"] == {"T9": "why"}
    assert found["source_method"]["radial_friction"] > 0.0
