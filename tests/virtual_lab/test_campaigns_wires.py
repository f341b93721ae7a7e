"""The campaign to calibrate by: names, scatter, one load cell, the truth on disk."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from labpipe.virtual_lab.campaigns import GROUPS, WireCampaign, WireGroup, simulate_campaigns
from labpipe.virtual_lab.cantilever_scenarios import NO_MISHAPS, CantileverScenario
from labpipe.virtual_lab.observations import observe
from labpipe.virtual_lab.specimens import WIRES, StrandedWire


def scenarios(campaign: WireCampaign, seed: int = 1) -> list[CantileverScenario]:
    return [scenario for scenario, _ in campaign.scenarios(seed)]


def factors(found: list[CantileverScenario]) -> np.ndarray:
    wires = [scenario.mechanics.wire for scenario in found]
    return np.array([wire.factor for wire in wires if isinstance(wire, StrandedWire)])


def test_tests_of_the_campaign() -> None:
    found = scenarios(WireCampaign())
    names = [scenario.name for scenario in found]
    assert len(set(names)) == 21
    assert names[:4] == ["A1-085-1", "A1-085-2", "A1-085-3", "A2-085-1"]
    assert names[9:15] == [*(f"B1-085-{n}" for n in (1, 2, 3)), *(f"B1-100-{n}" for n in (4, 5, 6))]
    assert [scenario.sample for scenario in found[9:15]] == [1, 2, 3, 4, 5, 6]
    assert {s.spool for s in found} == {f"{name}-s1" for name in WIRES}
    assert found[0].markers.centre_offset == 0.7e-3
    assert {scenario.mechanics.slack for scenario in found} == {None}


def test_samples_scatter_as_stated_and_share_the_load_cell() -> None:
    found = scenarios(WireCampaign(samples=60))
    assert np.std(np.log(factors(found))) == pytest.approx(0.03, rel=0.15)
    assert len({scenario.load_cell.gain_error for scenario in found}) == 1
    errors = [scenarios(WireCampaign(samples=1), seed)[0].load_cell for seed in range(200)]
    drawn = np.array([cell.gain_error for cell in errors], dtype=np.float64)
    assert np.std(drawn) == pytest.approx(0.002, rel=0.2)


def test_seeds_repeat() -> None:
    campaign = WireCampaign(samples=2)
    assert scenarios(campaign) == scenarios(campaign) != scenarios(campaign, 2)
    seeds = [own for seed in (1, 2) for _, own in campaign.scenarios(seed)]
    assert len(set(seeds)) == 28


def test_other_wires_and_no_mishaps() -> None:
    wire = replace(WIRES["A3"], insulation_modulus=5e8, copper_scale=1.1)
    campaign = WireCampaign((WireGroup(wire, 0.12),), samples=1, scatter=0.0, has_mishaps=False)
    (scenario,) = scenarios(campaign)
    assert scenario.name == "A3-120-1"
    assert scenario.mechanics.wire == wire
    assert scenario.mishaps == NO_MISHAPS
    assert GROUPS[2] == WireGroup(WIRES["A3"], 0.085)


@pytest.mark.slow
def test_on_disk_and_in_memory(tmp_path: Path) -> None:
    campaign = WireCampaign(samples=1, rate=50.0, fps=10.0, cycles=1)
    folders = simulate_campaigns([campaign], tmp_path, seed=4)
    assert [folder.name for folder in folders[-2:]] == ["B2-085-1", "B2-100-2"]
    truth = json.loads((folders[-1] / "truth.json").read_text("utf-8"))
    *_, last = campaign.scenarios(4)
    seen = observe(*last)
    wire = seen.scenario.mechanics.wire
    assert isinstance(wire, StrandedWire)
    assert truth["wire"] == {**wire.parameters, "sample_factor": wire.factor}
    assert truth["true_gain"] == seen.force_record.true_gain
    assert truth["cycles"][0]["peak_force"] == seen.truth.cycles[0].peak_force
    assert 0.015 < truth["cycles"][0]["peak_force"] < 0.05
    sheet = yaml.safe_load((folders[-1] / "test.yaml").read_text("utf-8"))
    named = {"type": "B2", "spool": "B2-s1", "sample": 2}
    assert sheet["specimen"] == {**named, "length": "100 mm", "mass_per_length": "5.3981 g/m"}
    values = {key: entry["value"] for key, entry in sheet["overrides"].items()}
    assert values == {
        "sources.force.calibration.gain": "0.05 N/V",
        "rig.cycles": 1,
        "markers.centre_offset": "0.625 mm",
    }
