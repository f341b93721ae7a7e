"""The campaign: how many tests, what they share, what differs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from labpipe.virtual_lab.campaigns import (
    SMALL_HARNESS,
    ConduitCampaign,
    TapedCampaign,
    simulate_campaigns,
)
from labpipe.virtual_lab.conduit_scenarios import ConduitScenario
from labpipe.virtual_lab.observations import observe


def scenarios(campaign: ConduitCampaign, seed: int = 1) -> list[ConduitScenario]:
    return [scenario for scenario, _ in campaign.scenarios(seed)]


def test_three_samples_of_every_case() -> None:
    found = scenarios(ConduitCampaign())
    assert len({scenario.name for scenario in found}) == 24
    assert [s.name for s in found[:4]] == ["CWB-1-1", "CWB-1-2", "CWB-1-3", "CWB-2a-1"]
    assert [s.has_frame_export for s in found[:3]] == [True, True, False]
    assert len({scenario.load_cell.gain_error for scenario in found}) == 1
    assert len({scenario.markers.twist for scenario in found}) == 24
    assert all(2e-3 <= s.clocks.trigger_lag <= 12e-3 for s in found)


def test_samples_scatter_as_stated() -> None:
    factors = [s.factor for s in scenarios(ConduitCampaign(samples=30))]
    assert np.std(np.log(factors)) == pytest.approx(0.04, rel=0.15)


def test_samples_of_a_case_share_their_mechanics() -> None:
    found = scenarios(ConduitCampaign())
    assert len({scenario.test for scenario in found}) == 8


def test_seeds_repeat_and_never_meet() -> None:
    campaign = ConduitCampaign()
    assert scenarios(campaign) == scenarios(campaign) != scenarios(campaign, 2)
    taped, conduits = SMALL_HARNESS
    own = [s for seed in (1, 2) for _, s in taped.scenarios(seed)]
    own += [s for seed in (1, 2) for _, s in conduits.scenarios(seed)]
    assert len(set(own)) == 2 * 57


def test_both_campaigns_on_disk(tmp_path: Path) -> None:
    campaigns = (
        TapedCampaign(types=("TWB-B1-7-PVC",), samples=1, rate=50.0, fps=5.0, cycles=1),
        ConduitCampaign(types=("CWB-3",), samples=1, rate=50.0, fps=5.0),
    )
    folders = simulate_campaigns(campaigns, tmp_path)
    assert [folder.name for folder in folders] == ["TWB-B1-7-PVC-1", "CWB-3-1"]
    assert all((folder / "truth.json").is_file() for folder in folders)


def test_campaigns_in_memory() -> None:
    campaign = ConduitCampaign(types=("CWB-3",), samples=2, rate=50.0, fps=5.0)
    first, second = (observe(*each) for each in campaign.scenarios())
    ratio = second.truth.peak_force / first.truth.peak_force
    assert ratio == pytest.approx(second.scenario.factor / first.scenario.factor)
