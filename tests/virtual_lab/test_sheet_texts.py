"""The test sheet overrides the shipped protocol exactly where the rig differs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml

from labpipe.virtual_lab.cantilever_scenarios import CantileverScenario, LoadCell, MarkerLayout
from labpipe.virtual_lab.sheet_texts import PROTOCOL_VALUES, write_sheet


def test_default_scenario_needs_no_overrides() -> None:
    sheet = yaml.safe_load(write_sheet(CantileverScenario()))
    assert sheet["test"] == "A2-085-1"
    assert sheet["protocol"] == "wire-cantilever"
    assert sheet["specimen"] == {"type": "A2", "spool": "A2-s1", "sample": 1, "length": "85 mm"}
    assert sheet["files"] == {"force": "force.mat", "markers": "take.csv"}
    assert "overrides" not in sheet


@pytest.mark.parametrize("name", PROTOCOL_VALUES)
def test_values_are_those_of_the_shipped_protocol(repository: Path, name: str) -> None:
    text = (repository / "protocols" / f"{name}.yaml").read_text(encoding="utf-8")
    protocol, wanted = yaml.safe_load(text), PROTOCOL_VALUES[name]
    assert {key: str(_look(protocol, key)) for key in wanted} == wanted


def test_what_differs_is_overridden_with_a_reason() -> None:
    usual = CantileverScenario()
    scenario = replace(
        usual,
        speed=2e-3,
        mechanics=replace(usual.mechanics, length=0.1, cycles=1, stroke=0.04),
        load_cell=LoadCell(gain=0.0411),
        markers=MarkerLayout(pull_offset=0.005),
    )
    sheet = yaml.safe_load(write_sheet(scenario))
    assert sheet["specimen"]["length"] == "100 mm"
    values = {key: entry["value"] for key, entry in sheet["overrides"].items()}
    assert values == {
        "sources.force.calibration.gain": "0.0411 N/V",
        "rig.crosshead_speed": "2 mm/s",
        "rig.stroke": "40 mm",
        "rig.cycles": 1,
        "markers.pull_offset": "5 mm",
    }
    assert all(entry["because"] for entry in sheet["overrides"].values())


def test_says_that_it_is_synthetic() -> None:
    assert "synthetic" in write_sheet(CantileverScenario()).splitlines()[0]


def _look(document: Any, key: str) -> Any:
    for part in key.split("."):
        document = document[part]
    return document
