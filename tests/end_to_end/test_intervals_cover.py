"""Every stated 95 % interval covers the truth of the virtual lab as often as it says.

200 seeded tests, recorded at 1 kHz so that the study takes minutes. Each result's hits are held
against 95 % by an exact two-sided binomial test; with 17 results the level is 1 % / 17 for each,
so that a sound set of intervals fails here once in a hundred studies.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import binomtest

from labpipe.process.reading import name_channels
from labpipe.process.story import reduce_recordings
from labpipe.protocol.load import parse_protocol
from labpipe.protocol.schema import Protocol
from labpipe.records.arrays import Flags, Floats
from labpipe.records.result import Result
from labpipe.virtual_lab import CantileverScenario, Observation, observe
from labpipe.virtual_lab.truth import CantileverTruth
from tests.foreign.below import BELOW_IN_THE_VIRTUAL_LAB

RUNS = 200


def scenario(gain_uncertainty: float) -> CantileverScenario:
    usual = CantileverScenario()
    return replace(
        usual,
        clocks=replace(usual.clocks, rate=1000.0),
        load_cell=replace(usual.load_cell, gain_uncertainty=gain_uncertainty),
    )


def protocol(repository: Path, gain_uncertainty: float) -> Protocol:
    text = (repository / "protocols" / "wire-cantilever.yaml").read_text(encoding="utf-8")
    stated = f"gain_uncertainty: {100 * gain_uncertainty:g} %"
    return parse_protocol(text.replace("gain_uncertainty: 0.2 %", stated), "wire-cantilever.yaml")


def results(test: Observation, plan: Protocol) -> tuple[Result, ...]:
    force = name_channels(test.force, plan.sources["force"], Path("force.mat"))
    return reduce_recordings({"force": force, "markers": test.markers}, plan).results


def slope_in_time(time: Floats, displacement: Floats, force: Floats, chosen: Flags) -> float:
    """Ratio of what force and displacement gain in time: the stiffness that is asked for."""
    lever = time[chosen] - time[chosen].mean()
    return float((lever @ force[chosen]) / (lever @ displacement[chosen]))


def true_values(test: Observation) -> dict[str, float | None]:
    truth, clocks = test.truth, test.scenario.clocks
    values: dict[str, float | None] = {"clock_offset": clocks.offset, "clock_drift": clocks.drift}
    for number, cycle in enumerate(truth.cycles, start=1):
        values |= {
            f"peak_force.{number}": cycle.peak_force,
            f"peak_displacement.{number}": cycle.peak_deflection,
            f"energy.{number}": cycle.energy,
            f"residual_displacement.{number}": cycle.residual_deflection,
        }
    return values | true_stiffness(truth)


def true_stiffness(truth: CantileverTruth) -> dict[str, float | None]:
    curve = (np.array(truth.time), np.array(truth.deflection), np.array(truth.force))
    time, deflection, _ = curve
    first = truth.cycles[0]
    loading = (time >= first.start_time) & (time <= first.top_time)
    window = loading & (deflection >= 0.5e-3) & (deflection <= 4e-3)
    values: dict[str, float | None] = {"initial_stiffness": slope_in_time(*curve, window)}
    for number, cycle in enumerate(truth.cycles, start=1):
        below = cycle.peak_deflection - deflection
        unloading = (time >= cycle.top_time) & (time <= cycle.stop_time)
        window = unloading & (below >= 0.3e-3) & (below <= 3e-3)
        values[f"unloading_stiffness.{number}"] = slope_in_time(*curve, window)
    return values


@pytest.mark.slow
@pytest.mark.parametrize("gain_uncertainty", [0.002, 0.0])
def test_intervals_cover(repository: Path, gain_uncertainty: float) -> None:
    plan, virtual = protocol(repository, gain_uncertainty), scenario(gain_uncertainty)
    hits: Counter[str] = Counter()
    for seed in range(RUNS):
        test = observe(virtual, seed)
        truth = true_values(test)
        for result in results(test, plan):
            if result.name.startswith("bending_stiffness"):
                continue  # in test_measured_law, where the offsets are drawn as stated, too
            true = truth[result.name]
            assert result.interval is not None, f"seed {seed}: {result.name}: {result.why}"
            assert true is not None
            hits[result.name] += result.interval.lower <= true <= result.interval.upper
    chances = {name: binomtest(count, RUNS, 0.95).pvalue for name, count in hits.items()}
    unsound = {
        name: hits[name]
        for name, chance in chances.items()
        if chance < 0.01 / len(hits) and name.partition(".")[0] not in BELOW_IN_THE_VIRTUAL_LAB
    }
    assert not unsound, f"covered of {RUNS}: {unsound}; all: {dict(hits)}"
