"""Campaigns: how many tests, what they share, what differs, what the source says of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from labpipe.virtual_lab import ChosenTests
from labpipe.virtual_lab.campaigns import (
    ConduitCampaign,
    TapedCampaign,
    TensileCampaign,
    WireCampaign,
    simulate_campaigns,
)
from labpipe.virtual_lab.cantilever_scenarios import NO_MISHAPS, CantileverScenario
from labpipe.virtual_lab.conduit_scenarios import (
    ConduitScenario,
)
from labpipe.virtual_lab.observations import observe
from labpipe.virtual_lab.specimens import WIRES, StrandedWire
from labpipe.virtual_lab.tensile_scenarios import (
    TensileScenario,
    corrugated_tube,
    twist_tube,
)

CAMPAIGNS = (WireCampaign(), TensileCampaign())


def test_chosen_tests_are_as_in_their_campaigns() -> None:
    names = ("twist-tube-2b", "pet-tape-3", "B1-100-5")
    chosen = list(ChosenTests(CAMPAIGNS, names).scenarios(seed=3))
    all_of_them = [scenario for campaign in CAMPAIGNS for scenario in campaign.scenarios(seed=3)]
    assert [scenario.name for scenario, _ in chosen] == ["B1-100-5", "twist-tube-2b", "pet-tape-3"]
    assert chosen == [each for each in all_of_them if each[0].name in names]


def test_names_the_tests_that_no_campaign_has() -> None:
    chosen = ChosenTests(CAMPAIGNS, ("A9-085-1", "pet-tape-3"))
    with pytest.raises(KeyError, match="A9-085-1"):
        list(chosen.scenarios())


def scenarios(campaign: ConduitCampaign, seed: int = 1) -> list[ConduitScenario]:
    return [scenario for scenario, _ in campaign.scenarios(seed)]


QUICK = TapedCampaign(types=("TWB-B1-7-PVC",), samples=1, rate=50.0, fps=10.0, cycles=1)


def taped_scenarios(campaign: TapedCampaign, seed: int = 1) -> list[CantileverScenario]:
    return [scenario for scenario, _ in campaign.scenarios(seed)]


def test_tests_of_the_taped_campaign() -> None:
    found = taped_scenarios(TapedCampaign())
    assert len({scenario.name for scenario in found}) == 33
    assert found[0].name == "TWB-B1-7-PVC-1"
    assert found[1].mishaps != NO_MISHAPS
    assert {scenario.load_cell.gain_error for scenario in found} == {found[0].load_cell.gain_error}
    factors = [s.mechanics.wire.factor for s in taped_scenarios(TapedCampaign(samples=30))]  # type: ignore[union-attr]
    assert np.std(np.log(factors)) == pytest.approx(0.04, rel=0.15)
    seeds = [own for seed in (1, 2) for _, own in TapedCampaign().scenarios(seed)]
    assert len(set(seeds)) == 66
    assert taped_scenarios(QUICK) == taped_scenarios(QUICK) != taped_scenarios(QUICK, 2)


def tensile_scenarios(seed: int = 1) -> list[TensileScenario]:
    return [scenario for scenario, _ in TensileCampaign().scenarios(seed)]


SCENARIOS = {scenario.name: scenario for scenario in tensile_scenarios()}


@pytest.mark.parametrize("seed", [1, 2])
def test_twist_tubes_bend_and_tear_where_the_source_says(seed: int) -> None:
    tubes = [
        tensile_scenario
        for tensile_scenario in tensile_scenarios(seed)
        if tensile_scenario.protocol == "twist-tube"
    ]
    for tube in tubes:
        truth = observe(tube, seed).truth
        assert truth.break_point is not None
        assert truth.failure_displacement is not None
        assert truth.foot + 0.5 * tube.law.toe < 2e-3  # straight from 2 mm to 8 mm
        assert truth.break_point - 0.5 * tube.law.knee > 8e-3
        assert truth.break_point + 0.5 * tube.law.knee < 10.05e-3  # and again from 10 mm
        assert 25e-3 < truth.failure_displacement < 40e-3
        assert 300.0 < truth.peak_force < 550.0


def test_on_disk(tmp_path: Path) -> None:
    folders = simulate_campaigns([TensileCampaign()], tmp_path, seed=1)
    assert [folder.name for folder in folders] == list(SCENARIOS)
    assert all((folder / "test.yaml").is_file() for folder in folders)
    assert all((folder / "truth.json").is_file() for folder in folders)
    assert len(list((tmp_path / "twist-tube-2b").glob("*.txt"))) == 3
    assert len(list(tmp_path.glob("CT-*/*.xlsx"))) == 9


def wires_scenarios(campaign: WireCampaign, seed: int = 1) -> list[CantileverScenario]:
    return [scenario for scenario, _ in campaign.scenarios(seed)]


def factors(found: list[CantileverScenario]) -> np.ndarray:
    wires = [scenario.mechanics.wire for scenario in found]
    return np.array([wire.factor for wire in wires if isinstance(wire, StrandedWire)])


def test_tests_of_the_wire_campaign() -> None:
    found = wires_scenarios(WireCampaign())
    names = [scenario.name for scenario in found]
    assert len(set(names)) == 21
    assert names[:4] == ["A1-085-1", "A1-085-2", "A1-085-3", "A2-085-1"]
    assert names[9:15] == [*(f"B1-085-{n}" for n in (1, 2, 3)), *(f"B1-100-{n}" for n in (4, 5, 6))]
    assert [scenario.sample for scenario in found[9:15]] == [1, 2, 3, 4, 5, 6]
    assert {s.spool for s in found} == {f"{name}-s1" for name in WIRES}
    assert found[0].markers.centre_offset == 0.7e-3
    assert {scenario.mechanics.slack for scenario in found} == {None}


def test_samples_scatter_as_stated_and_share_the_load_cell() -> None:
    found = wires_scenarios(WireCampaign(samples=60))
    assert np.std(np.log(factors(found))) == pytest.approx(0.03, rel=0.15)
    assert len({scenario.load_cell.gain_error for scenario in found}) == 1
    errors = [wires_scenarios(WireCampaign(samples=1), seed)[0].load_cell for seed in range(200)]
    drawn = np.array([cell.gain_error for cell in errors], dtype=np.float64)
    assert np.std(drawn) == pytest.approx(0.002, rel=0.2)


TUBE, TWIST = corrugated_tube("CT-10-1"), twist_tube("1a")
