"""Intervals of stranded wires, which stick and slide, cover the truth as often as they say.

Samples of the five wires of the virtual campaign, at 200 Hz, in memory, one wire and length after
the other, each with a load cell off by another amount. Hits are compared with 95 % for each result
by an exact two-sided binomial test at 1 % over the number of results.
"""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import replace
from itertools import cycle, islice
from pathlib import Path

import pytest
from scipy.stats import binomtest

from labpipe.process.reading import name_channels
from labpipe.process.story import reduce_recordings
from labpipe.protocol.load import parse_protocol
from labpipe.protocol.schema import Protocol
from labpipe.records.result import Result
from labpipe.virtual_lab import CantileverScenario, Observation, observe
from labpipe.virtual_lab.campaigns import GROUPS, WireCampaign
from labpipe.virtual_lab.truth import CantileverTruth
from tests.foreign.below import BELOW_IN_THE_VIRTUAL_LAB

RUNS = 63
"""Nine of each wire and length."""


def samples_of_wires() -> list[tuple[CantileverScenario, int]]:
    """Quiet tests of plain samples, so that those of one wire and length share their mechanics."""
    picked: list[tuple[CantileverScenario, int]] = []
    for seed, group in enumerate(islice(cycle(GROUPS), RUNS)):
        plain = WireCampaign(groups=(group,), samples=1, scatter=0.0, has_mishaps=False)
        picked.extend(plain.scenarios(seed))
    return sorted(picked, key=lambda each: each[0].name)


def protocol(repository: Path, scenario: CantileverScenario) -> Protocol:
    """The shipped protocol with what the campaign's sheets override, without the bending law."""
    text = (repository / "protocols" / "wire-cantilever.yaml").read_text(encoding="utf-8")
    text = re.sub(r"  - \{result: moment-curvature.*\n", "", text)
    text = text.replace("wire-shapes, moment-curvature, timeline", "wire-shapes, timeline")
    for said, own in (
        ("gain: 0.5 N/V", f"gain: {scenario.load_cell.gain:g} N/V"),
        ("centre_offset: 0.8 mm", f"centre_offset: {1e3 * scenario.markers.centre_offset:.6g} mm"),
        ("length: 85 mm", f"length: {1e3 * scenario.mechanics.length:g} mm"),
    ):
        assert said in text
        text = text.replace(said, own)
    return parse_protocol(text, "wire-cantilever.yaml")


def results(test: Observation, plan: Protocol) -> tuple[Result, ...]:
    force = name_channels(test.force, plan.sources["force"], Path("force.mat"))
    return reduce_recordings({"force": force, "markers": test.markers}, plan).results


def true_values(truth: CantileverTruth, scenario: CantileverScenario) -> dict[str, float]:
    values = {"clock_offset": scenario.clocks.offset, "clock_drift": scenario.clocks.drift}
    for number, each in enumerate(truth.cycles, start=1):
        assert each.residual_deflection is not None
        values |= {
            f"peak_force.{number}": each.peak_force,
            f"peak_displacement.{number}": each.peak_deflection,
            f"energy.{number}": each.energy,
            f"residual_displacement.{number}": each.residual_deflection,
        }
    return values


@pytest.mark.slow
def test_intervals_of_stranded_wires_cover(repository: Path) -> None:
    hits: Counter[str] = Counter()
    for scenario, seed in samples_of_wires():
        test = observe(replace(scenario, name=f"{scenario.name}-{seed}"), seed)
        truth = true_values(test.truth, scenario)
        for result in results(test, protocol(repository, scenario)):
            if result.name not in truth:
                continue
            assert result.interval is not None, f"{scenario.name} {seed}: {result.why}"
            hits[result.name] += (
                result.interval.lower <= truth[result.name] <= result.interval.upper
            )
    chances = {name: binomtest(count, RUNS, 0.95).pvalue for name, count in hits.items()}
    unsound = {
        name: hits[name]
        for name, chance in chances.items()
        if chance < 0.01 / len(hits) and name.partition(".")[0] not in BELOW_IN_THE_VIRTUAL_LAB
    }
    assert not unsound, f"covered of {RUNS}: {unsound}; all: {dict(hits)}"
