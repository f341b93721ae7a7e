"""Virtual tension tests through the pipeline: intervals hold the truth."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from labpipe.virtual_lab import simulate_test
from labpipe.virtual_lab.tensile import MetalTension
from tests.builders.small_tests import Run


@pytest.mark.parametrize(
    "scenario",
    [
        MetalTension(),
        MetalTension(proof_stress=1100e6, hardening=40.0, rate=20.0),
        MetalTension(modulus=70e9, proof_stress=150e6, hardening=15.0, diameter=8e-3),
    ],
    ids=["mild-steel", "hard-steel", "aluminium"],
)
def test_intervals_hold_the_truth(scenario: MetalTension, tmp_path: Path, run: Run) -> None:
    covers = []
    for seed in range(3):
        name = f"tension-{seed}"
        test = simulate_test(replace(scenario, name=name), tmp_path / "raw" / name, seed)
        outcome = run("process", test, "--no-figures", "--out", tmp_path / "out")
        assert outcome.status == 1, outcome.err
        summary = json.loads((tmp_path / "out" / name / "summary.json").read_text("utf-8"))
        numbers = {number["name"]: number for number in summary["results"]}
        truth = json.loads((test / "truth.json").read_text("utf-8"))
        assert truth["synthetic"] is True
        for key in ("upper_yield_stress", "lower_yield_stress"):
            assert numbers[key]["code"] == "no_yield_point"
        for key, value in scenario.compute_truth().items():
            assert truth[key] == value
            assert numbers[key]["value"] == pytest.approx(value, rel=0.02)
            covers.append(numbers[key]["lower"] <= value <= numbers[key]["upper"])
    assert np.mean(covers) >= 0.93


def test_an_extensometer_that_is_taken_off(tmp_path: Path, run: Run) -> None:
    scenario = MetalTension(extensometer_off=0.02)
    test = simulate_test(scenario, tmp_path / "tension-1", 1)
    run("process", test, "--no-figures", "--out", tmp_path / "out")
    summary = json.loads((tmp_path / "out" / "tension-1" / "summary.json").read_text("utf-8"))
    numbers = {number["name"]: number for number in summary["results"]}
    assert numbers["proof_stress_1"]["status"] == "ok"
    assert numbers["tensile_strength"]["status"] == "ok"
    for name in ("elongation_at_maximum_force", "elongation_at_break"):
        assert numbers[name]["code"] == "extensometer_off"
