"""Intervals of both bundle protocols cover the truth of the virtual lab as often as they say.

Taped bundles of all eleven types, and conduit bundles of all eight with and without the frame's
export, in memory. Hits are held against 95 % for each result by an exact binomial test at 1 % over
the number of results: two-sided, but for results of which the interval is mostly a bound of what
the model leaves open (the elbow of a curve without a corner, curvature between markers): these
cover more often than they say, and must only not do so too seldom.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
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
BOUNDED = (
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
)
"""Where a model, not noise, makes the interval: a line through a bend, a curve through markers."""
MISSES = 4.5
"""Standard errors beyond which chance is no explanation in some hundred intervals."""

Study = Iterator[tuple[tuple[Result, ...], list[Checked]]]
Make = Callable[[int, int, Path], Study]


@pytest.fixture(params=["taped-bundle", "conduit-bundle"])
def make(request: pytest.FixtureRequest, repository: Path) -> Make:
    protocols = repository / "protocols"

    def taped(runs: int, seed: int, folder: Path) -> Study:
        for test, own in taped_tests(runs, seed):
            yield check_taped(test, own, folder, protocols)

    def conduit(runs: int, seed: int, folder: Path) -> Study:
        for test, own in conduit_tests(runs, seed):
            yield check_conduit(test, own, folder, protocols)

    return taped if request.param == "taped-bundle" else conduit


def test_a_few_of_each(make: Make, tmp_path: Path) -> None:
    """Nothing is doubtful without cause, and nothing is off by more than chance can do."""
    for results, checked in make(3, 5, tmp_path):
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
def test_intervals_cover(make: Make, tmp_path: Path) -> None:
    hits: dict[str, list[bool]] = {}
    for results, checked in make(RUNS, 6, tmp_path):
        assert {each.status for each in results} == {Status.OK}, results
        for each in checked:
            hits.setdefault(each.result.name, []).append(each.is_covered)
    unsound = {
        name: (sum(found), len(found))
        for name, found in hits.items()
        if _chance(name, found) < 0.01 / len(hits)
    }
    assert not unsound, {name: (sum(found), len(found)) for name, found in hits.items()}


def _chance(name: str, found: list[bool]) -> float:
    """Of as few hits, or as far from 95 %, by the exact binomial distribution."""
    if name.partition(".")[0] in BOUNDED:
        return float(binomtest(sum(found), len(found), 0.95, alternative="less").pvalue)
    return float(binomtest(sum(found), len(found), 0.95).pvalue)
