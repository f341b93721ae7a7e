"""The campaign is what the source describes: kinds, spools, forces, failures, mishaps."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from labpipe.virtual_lab.campaigns import TensileCampaign, simulate_campaigns
from labpipe.virtual_lab.observations import observe
from labpipe.virtual_lab.tensile_scenarios import TABLE_2_3, Program, TensileScenario


def scenarios(seed: int = 1) -> list[TensileScenario]:
    return [scenario for scenario, _ in TensileCampaign().scenarios(seed)]


SCENARIOS = {scenario.name: scenario for scenario in scenarios()}
TRUTHS = {name: observe(scenario, 1).truth for name, scenario in SCENARIOS.items()}


def test_kinds_and_spools() -> None:
    assert Counter(scenario.protocol for scenario in SCENARIOS.values()) == {
        "corrugated-tube": 9,
        "twist-tube": 6,
        "pet-tape": 5,
        "stiff-bar": 1,
    }
    spools = Counter(scenario.spool for scenario in SCENARIOS.values())
    assert [spools[name] for name in ("twist-tube-s1", "twist-tube-s2")] == [3, 3]
    assert [spools[name] for name in ("pet-tape-s1", "pet-tape-s2")] == [3, 2]
    assert [spools[f"{kind}-s1"] for kind in ("CT-10-slit", "CT-10", "CT-7")] == [3, 3, 3]


def test_slit_tubes_pull_least_and_small_ones_most() -> None:
    peaks = {
        kind: [TRUTHS[f"{kind}-{sample}"].peak_force for sample in (1, 2, 3)]
        for kind in ("CT-10-slit", "CT-10", "CT-7")
    }
    assert min(peaks["CT-10-slit"]) > 45.0
    assert max(peaks["CT-10-slit"]) < min(peaks["CT-10"])
    assert max(peaks["CT-10"]) < min(peaks["CT-7"])
    assert max(peaks["CT-7"]) < 65.0


def test_mishaps_of_the_corrugated_tubes() -> None:
    slips = {name: len(truth.slips) for name, truth in TRUTHS.items() if truth.slips}
    assert slips == {"CT-10-slit-2": 2, "CT-7-3": 1}
    unloaded = [name for name, scenario in SCENARIOS.items() if scenario.frame.unloads]
    assert unloaded == ["CT-10-3"]


def test_twist_tubes_scatter_as_table_2_3() -> None:
    for sample, (first, second) in TABLE_2_3.items():
        truth = TRUTHS[f"twist-tube-{sample}"]
        assert truth.stiffness_first / truth.peak_force == pytest.approx(first, rel=1e-6)
        assert truth.stiffness_second / truth.peak_force == pytest.approx(second, rel=1e-6)


@pytest.mark.parametrize("seed", [1, 2, 3, 4, 5])
def test_twist_tubes_bend_and_tear_where_the_source_says(seed: int) -> None:
    tubes = [each for each in scenarios(seed) if each.protocol == "twist-tube"]
    for tube in tubes:
        truth = observe(tube, seed).truth
        assert truth.break_point is not None
        assert truth.failure_displacement is not None
        assert truth.foot + 0.5 * tube.law.toe < 2e-3  # straight from 2 mm to 8 mm
        assert truth.break_point - 0.5 * tube.law.knee > 8e-3
        assert truth.break_point + 0.5 * tube.law.knee < 10.05e-3  # and again from 10 mm
        assert 25e-3 < truth.failure_displacement < 40e-3
        assert 300.0 < truth.peak_force < 550.0


def test_tapes_break_near_60_mm_and_the_second_one_at_40() -> None:
    at = [TRUTHS[f"pet-tape-{sample}"].failure_displacement for sample in range(1, 6)]
    wanted = [60e-3, 40e-3, 60e-3, 60e-3, 60e-3]
    np.testing.assert_allclose(np.array(at, dtype=np.float64), wanted, rtol=0.07)


def test_half_a_second_of_slack_tells_the_tare() -> None:
    for name, scenario in SCENARIOS.items():
        if scenario.frame.speed < 1e-3:
            truth = TRUTHS[name]
            early = truth.time < truth.time[0] + 0.5
            assert np.all(truth.force[early] == 0.0), name


def test_tests_of_a_frame_share_the_error_of_its_load_cell() -> None:
    errors = {
        program: {
            s.instruments.gain_error for s in SCENARIOS.values() if s.export.program is program
        }
        for program in Program
    }
    assert [len(each) for each in errors.values()] == [1, 1]
    assert all(0.0 < abs(error) < 0.01 for each in errors.values() for error in each)


def test_seeds() -> None:
    assert scenarios(1) == scenarios(1) != scenarios(2)


def test_on_disk(tmp_path: Path) -> None:
    folders = simulate_campaigns([TensileCampaign()], tmp_path, seed=1)
    assert [folder.name for folder in folders] == list(SCENARIOS)
    assert all((folder / "test.yaml").is_file() for folder in folders)
    assert all((folder / "truth.json").is_file() for folder in folders)
    assert len(list((tmp_path / "twist-tube-2b").glob("*.txt"))) == 3
    assert len(list(tmp_path.glob("CT-*/*.xlsx"))) == 9
