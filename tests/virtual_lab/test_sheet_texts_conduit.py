"""The sheet: what it says of the bundle, and where it overrides the shipped protocol."""

from __future__ import annotations

from dataclasses import replace

import yaml

from labpipe.virtual_lab.conduit_scenarios import CylinderMarkers, ThreePointTest, conduit_scenario
from labpipe.virtual_lab.sheet_texts import write_sheet

FILES = {"force": ["force.mat"], "frame": ["DAQ- Crosshead, … - (Timed).txt"]}


def test_sheet_of_a_case() -> None:
    sheet = yaml.safe_load(write_sheet(conduit_scenario("CWB-2b"), FILES))
    assert sheet["protocol"] == "conduit-bundle"
    assert sheet["specimen"]["span"] == "152.4 mm"
    assert sheet["specimen"]["bundle"]["taping"] == "coarse"
    assert sheet["files"] == {role: name for role, (name,) in FILES.items()}
    values = {key: entry["value"] for key, entry in sheet["overrides"].items()}
    assert values == {
        "specimen.section.outer_diameter": "10.2 mm",
        "markers.centre_offset": "6.6 mm",
    }


def test_no_overrides_where_the_protocol_says_it() -> None:
    usual = conduit_scenario("CWB-1")
    test = ThreePointTest(usual.test.bundle, outer_radius=7.05e-3)
    scenario = replace(usual, test=test, markers=CylinderMarkers(centre_offset=8.55e-3))
    assert "overrides" not in yaml.safe_load(write_sheet(scenario, FILES))


def test_says_that_it_is_synthetic() -> None:
    assert "synthetic" in write_sheet(conduit_scenario("CWB-1"), FILES).splitlines()[0]
