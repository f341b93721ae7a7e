"""The test sheets of virtual tensile tests are sheets that the protocol side accepts."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from labpipe.protocol.load import load_test_sheet, resolve
from labpipe.virtual_lab.campaigns import TensileCampaign
from labpipe.virtual_lab.sheet_texts import write_sheet
from labpipe.virtual_lab.tensile_scenarios import TensileScenario, corrugated_tube, twist_tube

PARTS = ("DAQ- Crosshead, … - (Timed).txt", "DAQ- Crosshead, … - (Timed)1.txt")


def test_says_what_was_tested() -> None:
    text = write_sheet(twist_tube("2b"), {"frame": PARTS})
    assert text.startswith("# A synthetic test, made by labpipe's virtual lab.")
    sheet = yaml.safe_load(text)
    assert sheet["test"] == "twist-tube-2b"
    assert sheet["protocol"] == "twist-tube"
    wanted = {"type": "twist-tube-10", "spool": "twist-tube-s2", "sample": "2b", "length": "75 mm"}
    assert sheet["specimen"] == wanted
    assert sheet["files"] == {"frame": list(PARTS)}


def test_what_the_protocol_cannot_know_is_overridden() -> None:
    tube = replace(corrugated_tube("CT-7-1"), section=(("outer_diameter", 10.2e-3),))
    tube = replace(tube, instruments=replace(tube.instruments, gain_uncertainty=0.01))
    sheet = yaml.safe_load(write_sheet(tube, {"frame": ["CT-7-1.xlsx"]}))
    assert sheet["files"] == {"frame": "CT-7-1.xlsx"}
    overrides = {key: override["value"] for key, override in sheet["overrides"].items()}
    assert overrides == {
        "sources.frame.channels.force.scale_uncertainty": "1 %",
        "specimen.section.outer_diameter": "10.2 mm",
    }


def test_nothing_is_overridden_without_need() -> None:
    text = write_sheet(corrugated_tube("CT-10-1"), {"frame": ["CT-10-1.xlsx"]})
    assert "overrides" not in yaml.safe_load(text)


SCENARIOS = [scenario for scenario, _ in TensileCampaign().scenarios()]


@pytest.mark.parametrize("scenario", SCENARIOS, ids=lambda scenario: scenario.name)
def test_sheets_of_the_campaign_are_accepted(
    tmp_path: Path, repository: Path, scenario: TensileScenario
) -> None:
    path = tmp_path / "test.yaml"
    path.write_text(write_sheet(scenario, {"frame": PARTS}), encoding="utf-8")
    sheet = load_test_sheet(path)
    assert sheet.files == {"frame": PARTS}
    protocol = resolve(sheet, path, repository / "protocols")
    force = protocol.sources["frame"].all_channels["force"]
    assert (force.gain, force.gain_uncertainty) == (1.0, 0.0025)
    assert protocol.specimen is not None
    assert protocol.specimen.length == pytest.approx(scenario.length)
