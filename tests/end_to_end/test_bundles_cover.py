"""Intervals of both bundle protocols cover the truth of the virtual lab as often as they say.

Taped bundles of all eleven types, and conduit bundles of all eight with and without the frame's
export, in memory. Hits are compared with 95 % for each result by an exact binomial test at 1 % over
the number of results: two-sided, but for results of which the interval is mostly a bound of what
the model leaves open (the elbow of a curve without a corner, curvature between markers): these
cover more often than they say, and must only not do so too seldom.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from scipy.stats import binomtest

from labpipe.records.result import Result, Status
from tests.builders.bundle_studies import (
    Checked,
    check_conduit,
    check_taped,
    conduit_tests,
    taped_tests,
)

RUNS = 200
MODELLED = {
    "bending_stiffness",
    "end_slope",
    "hardening",
    "initial_stiffness",
    "kink_displacement",
    "kink_force",
    "loading_stiffness",
    "mid_span_bending_stiffness",
    "mid_span_curvature",
    "peak_displacement",
    "plateau_displacement",
    "plateau_force",
    "residual_displacement",
}
"""Where a model, not noise, makes the interval: a line through a bend, a curve through markers."""
STARTED = {"clock_offset", "clock_drift"}
"""Of recorders with a common start: mostly the bounds that the protocol states of them."""
DOUBTS = RUNS // 40
"""Reasons of which a study may have that many: labels that change, a bundle too weak to tell."""
MISSES = 4.5
"""Standard errors beyond which chance is no explanation in some hundred intervals."""


Study = Iterator[tuple[tuple[Result, ...], list[Checked]]]


@dataclass(frozen=True, slots=True)
class Bench:
    """A shipped protocol, and the results that may cover more often than they say."""

    protocols: Path
    folder: Path
    is_taped: bool

    def run(self, runs: int, seed: int) -> Study:
        if self.is_taped:
            for cantilever, own in taped_tests(runs, seed):
                yield check_taped(cantilever, own, self.folder, self.protocols)
            return
        for beam, own in conduit_tests(runs, seed):
            yield check_conduit(beam, own, self.folder, self.protocols)

    def chance(self, name: str, found: list[bool]) -> float:
        """Of as few hits, or as far from 95 %, by the exact binomial distribution."""
        bounded = MODELLED if self.is_taped else MODELLED | STARTED
        if name.partition(".")[0] in bounded:
            return float(binomtest(sum(found), len(found), 0.95, alternative="less").pvalue)
        return float(binomtest(sum(found), len(found), 0.95).pvalue)


@pytest.fixture(params=["taped-bundle", "conduit-bundle"])
def bench(request: pytest.FixtureRequest, repository: Path, tmp_path: Path) -> Bench:
    return Bench(repository / "protocols", tmp_path, request.param == "taped-bundle")


def test_a_few_of_each(bench: Bench) -> None:
    """Nothing is doubtful without cause, and nothing is off by more than chance can do."""
    for results, checked in bench.run(3, 5):
        assert {each.status for each in results} == {Status.OK}, results
        assert len(checked) > 10
        far = [each for each in checked if not abs(each.z) < MISSES]
        assert not far


def test_the_largest_force_may_come_before_the_turn(repository: Path, tmp_path: Path) -> None:
    """A tape that lets go: the force at the turn is 1.4 % lower, seven standard errors."""
    *_, (scenario, seed) = taped_tests(7, 1)
    assert scenario.specimen_type == "TWB-MX-sym-PVC"
    _, checked = check_taped(scenario, seed, tmp_path, repository / "protocols")
    (peak,) = [each for each in checked if each.result.name == "peak_force.1"]
    assert abs(peak.z) < MISSES


@pytest.mark.slow
def test_intervals_cover(bench: Bench) -> None:
    hits: dict[str, list[bool]] = {}
    not_sure: list[str] = []
    for results, checked in bench.run(RUNS, 6):
        not_sure += {each.why for each in results if each.status is not Status.OK}
        for each in checked:
            if each.result.status is Status.OK:  # an interval does not cover a doubt
                hits.setdefault(each.result.name, []).append(each.is_covered)
    assert len(not_sure) <= DOUBTS, not_sure
    unsound = {
        name: (sum(found), len(found))
        for name, found in hits.items()
        if bench.chance(name, found) < 0.01 / len(hits)
    }
    assert not unsound, {name: (sum(found), len(found)) for name, found in hits.items()}
