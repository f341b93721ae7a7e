"""The campaign of taped bundles: names, scatter, mechanics, what the sheets say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import yaml

from labpipe.virtual_lab.bundles import TAPED_TYPES
from labpipe.virtual_lab.campaigns import TapedCampaign
from labpipe.virtual_lab.cantilever_path import solve_path
from labpipe.virtual_lab.cantilever_scenarios import NO_MISHAPS, CantileverScenario, taped_scenario
from labpipe.virtual_lab.observations import observe, truth_as_json
from labpipe.virtual_lab.sheet_texts import write_sheet

QUICK = TapedCampaign(types=("TWB-B1-7-PVC",), samples=1, rate=50.0, fps=10.0, cycles=1)


def scenarios(campaign: TapedCampaign, seed: int = 1) -> list[CantileverScenario]:
    return [scenario for scenario, _ in campaign.scenarios(seed)]


def test_table_4_1() -> None:
    found = {(b.wires, b.tape) for b in TAPED_TYPES.values()}
    for name in ("B1", "B2"):
        assert {(((name, number),), "PVC") for number in (7, 12, 19)} <= found
    assert ((("B1", 9), ("B2", 10)), "PVC") in found
    assert ((("B1", 10), ("B2", 9)), "PVC") in found
    pet = {wires for wires, tape in found if tape == "PET"}
    assert pet == {(("B1", 19),), (("B2", 7),), (("B2", 19),)}
    assert all((b.glue_strain is None) == (b.tape == "PET") for b in TAPED_TYPES.values())


def test_tests_of_the_campaign() -> None:
    found = scenarios(TapedCampaign())
    assert len({scenario.name for scenario in found}) == 33
    assert found[0].name == "TWB-B1-7-PVC-1"
    assert found[1].mishaps != NO_MISHAPS
    assert {scenario.load_cell.gain_error for scenario in found} == {found[0].load_cell.gain_error}
    factors = [s.mechanics.wire.factor for s in scenarios(TapedCampaign(samples=30))]  # type: ignore[union-attr]
    assert np.std(np.log(factors)) == pytest.approx(0.04, rel=0.15)
    seeds = [own for seed in (1, 2) for _, own in TapedCampaign().scenarios(seed)]
    assert len(set(seeds)) == 66
    assert scenarios(QUICK) == scenarios(QUICK) != scenarios(QUICK, 2)


def test_sheet_names_bundle_and_protocol() -> None:
    sheet = yaml.safe_load(write_sheet(taped_scenario("TWB-B1-19-PVC")))
    assert sheet["protocol"] == "taped-bundle"
    assert sheet["specimen"]["length"] == "114.3 mm"
    assert sheet["specimen"]["bundle"]["number"] == 19
    assert "overrides" not in sheet
    other = yaml.safe_load(write_sheet(taped_scenario("TWB-B2-7-PET")))
    assert other["overrides"]["markers.centre_offset"]["value"] == "1.875 mm"


def test_nothing_jumps_where_the_tape_lets_go() -> None:
    path = solve_path(taped_scenario("TWB-B1-19-PVC", cycles=2).mechanics)
    for before, after in zip(path.segments[:-1], path.segments[1:], strict=True):
        assert before.tension[-1] == pytest.approx(after.tension[0], abs=1e-3)
        assert before.y[-1, -1] == pytest.approx(after.y[0, -1], abs=1e-5)


def test_truth_tells_of_the_bundle() -> None:
    ((scenario, own),) = QUICK.scenarios()
    observation = observe(scenario, own)
    truth = truth_as_json(observation)["bundle"]
    assert isinstance(truth, dict)
    assert set(truth) >= {"stiffnesses", "loading", "loading_stiffness", "hardening", "factor"}
    plain = replace(observation.scenario, mishaps=NO_MISHAPS)
    seen = observe(plain, 1)
    assert np.nanmax(np.abs(seen.take.positions)) < 2.0
    volts = seen.force_record.volts - plain.load_cell.offset
    peak = seen.truth.cycles[0].peak_force
    assert seen.force_record.true_gain * np.max(volts) == pytest.approx(peak + 0.026, abs=0.03)
