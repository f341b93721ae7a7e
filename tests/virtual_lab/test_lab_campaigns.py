"""Campaigns: how many tests, what they share, what differs, what the source says of them."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.virtual_lab import ChosenTests, TensileCampaign, WireCampaign
from labpipe.virtual_lab.campaigns import TapedCampaign
from labpipe.virtual_lab.cantilever_scenarios import CantileverScenario
from labpipe.virtual_lab.instruments import NO_MISHAPS
from labpipe.virtual_lab.specimens import WIRES

CAMPAIGNS = (WireCampaign(), TensileCampaign())


def scenarios(campaign: WireCampaign | TapedCampaign, seed: int = 1) -> list[CantileverScenario]:
    return [scenario for scenario, _ in campaign.list_scenarios(seed)]


def scatter(scenarios: list[CantileverScenario]) -> float:
    """Of the logarithms of the factors of wires or bundles."""
    return float(np.std([np.log(s.mechanics.wire.factor) for s in scenarios]))  # type: ignore[union-attr]


def test_chosen_tests_are_as_in_their_campaigns() -> None:
    names = ("twist-tube-2b", "pet-tape-3", "B1-100-5")
    chosen = list(ChosenTests(CAMPAIGNS, names).list_scenarios(seed=3))
    every = [scenario for campaign in CAMPAIGNS for scenario in campaign.list_scenarios(seed=3)]
    assert chosen == [case for case in every if case[0].name in names]
    assert len(chosen) == 3
    with pytest.raises(KeyError, match="A9-085-1"):
        list(ChosenTests(CAMPAIGNS, ("A9-085-1", "pet-tape-3")).list_scenarios())


def test_tests_of_the_taped_campaign() -> None:
    taped = scenarios(TapedCampaign())
    assert len({scenario.name for scenario in taped}) == 33
    assert taped[0].name == "TWB-B1-7-PVC-1"
    assert taped[1].mishaps != NO_MISHAPS
    assert len({scenario.load_cell.gain_error for scenario in taped}) == 1
    assert scatter(scenarios(TapedCampaign(samples=30))) == pytest.approx(0.04, rel=0.15)
    seeds = [test_seed for seed in (1, 2) for _, test_seed in TapedCampaign().list_scenarios(seed)]
    assert len(set(seeds)) == 66
    assert scenarios(TapedCampaign()) == taped != scenarios(TapedCampaign(), 2)


def test_tests_of_the_wire_campaign() -> None:
    wires = scenarios(WireCampaign())
    names = [scenario.name for scenario in wires]
    assert len(set(names)) == 21
    assert names[:4] == ["A1-085-1", "A1-085-2", "A1-085-3", "A2-085-1"]
    assert names[9:15] == [*(f"B1-085-{n}" for n in (1, 2, 3)), *(f"B1-100-{n}" for n in (4, 5, 6))]
    assert [scenario.sample for scenario in wires[9:15]] == [1, 2, 3, 4, 5, 6]
    assert {scenario.spool for scenario in wires} == {f"{name}-s1" for name in WIRES}
    assert wires[0].markers.centre_offset == 0.7e-3
    assert {scenario.mechanics.slack for scenario in wires} == {None}


def test_samples_scatter_as_stated_and_share_the_load_cell() -> None:
    wires = scenarios(WireCampaign(samples=60))
    assert scatter(wires) == pytest.approx(0.03, rel=0.15)
    assert len({scenario.load_cell.gain_error for scenario in wires}) == 1
    cells = [scenarios(WireCampaign(samples=1), seed)[0].load_cell for seed in range(200)]
    errors = np.array([cell.gain_error for cell in cells], dtype=np.float64)
    assert np.std(errors) == pytest.approx(0.002, rel=0.2)
