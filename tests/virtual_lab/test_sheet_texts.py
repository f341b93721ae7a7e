"""Test sheets override the shipped protocol exactly where the rig differs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml

from labpipe.mechanics.studies.wire_sheets import read_wire_sheet
from labpipe.mechanics.wire.wire_table import build_wire
from labpipe.virtual_lab import write_wire_sheet
from labpipe.virtual_lab.cantilever_scenarios import CantileverScenario, MarkerLayout
from labpipe.virtual_lab.instruments import LoadCell
from labpipe.virtual_lab.lab_files import format_sheet
from labpipe.virtual_lab.specimens import WIRES
from labpipe.virtual_lab.three_point import build_conduit_scenario


def read_overrides(sheet: dict[str, Any]) -> dict[str, Any]:
    assert all(entry["because"] for entry in sheet["overrides"].values())
    return {key: entry["value"] for key, entry in sheet["overrides"].items()}


def test_what_differs_is_overridden_with_a_reason() -> None:
    default = CantileverScenario()
    scenario = replace(
        default,
        speed=2e-3,
        mechanics=replace(default.mechanics, length=0.1, cycles=1, stroke=0.04),
        load_cell=LoadCell(gain=0.0411),
        markers=MarkerLayout(pull_offset=0.005),
    )
    sheet = yaml.safe_load(format_sheet(scenario, {}))
    assert sheet["specimen"]["length"] == "100 mm"
    assert read_overrides(sheet) == {
        "sources.force.calibration.gain": "0.0411 N/V",
        "rig.crosshead_speed": "2 mm/s",
        "rig.stroke": "40 mm",
        "rig.cycles": 1,
        "markers.pull_offset": "5 mm",
    }
    files = {"force": ["force.mat"], "frame": ["DAQ- Crosshead, … - (Timed).txt"]}
    sheet = yaml.safe_load(format_sheet(build_conduit_scenario("CWB-2b"), files))
    assert sheet["protocol"] == "conduit-bundle"
    assert sheet["specimen"]["span"] == "152.4 mm"
    assert sheet["specimen"]["bundle"]["taping"] == "coarse"
    assert sheet["files"] == {role: name for role, (name,) in files.items()}
    assert read_overrides(sheet) == {
        "specimen.section.outer_diameter": "10.2 mm",
        "markers.centre_offset": "6.6 mm",
    }


def test_the_sheet_says_what_the_virtual_wires_are(tmp_path: Path) -> None:
    sheet = write_wire_sheet(tmp_path / "wires")
    specs = {spec.name: spec for spec in read_wire_sheet(sheet).specs}
    assert list(specs) == list(WIRES)
    for name, wire in WIRES.items():
        section, virtual = build_wire(specs[name]).section, wire.build_section()
        assert section.kind == virtual.kind
        assert specs[name].wire_diameter == pytest.approx(wire.diameter, rel=1e-6)
        assert section.x == pytest.approx(virtual.x, abs=1e-9)
        assert [layer.area for layer in section.layers] == pytest.approx(
            [layer.area for layer in virtual.layers], rel=1e-6
        )
        assert [layer.lay_angle for layer in section.layers] == pytest.approx(
            [layer.lay_angle for layer in virtual.layers], abs=1e-6
        )
