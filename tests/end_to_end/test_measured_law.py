"""The measured moment-curvature law against the law that the virtual lab bends its wire by.

Exports are written, processed by the command and read back. How often the intervals hold the truth
is counted in memory, with what is uncertain drawn as stated: noise, the gain of the load cell, and
where clamped end and pull point are.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import binomtest

from labpipe.bending.law_table import law_points
from labpipe.law.plays import MomentLaw
from labpipe.process.reading import name_channels
from labpipe.process.story import reduce_recordings
from labpipe.protocol.load import parse_protocol
from labpipe.records.arrays import Floats
from labpipe.records.curve import Bending, MeasuredLaw
from labpipe.records.result import Result
from labpipe.results.evidence import Evidence
from labpipe.store.read import read_result
from labpipe.virtual_lab import CantileverScenario, WireCampaign, observe
from tests.builders.bent_tests import law_moment
from tests.builders.small_tests import Run, make_lab

RUNS, FEW = 120, 5
CURVATURES: Floats = np.array([1.0, 3.0, 6.0, 12.0, 20.0, 26.0])


TESTS = 60
"""For each string at rest."""


def strung(name: str) -> CantileverScenario:
    """A2 of the virtual campaign on 85 mm, whose string is one way or another at rest."""
    usual = next(
        each
        for each, _ in WireCampaign(samples=1, has_mishaps=False).scenarios(1)
        if each.name.startswith("A2-085")
    )
    slack, counterweight = {"taut": (None, 0.0027), "off the wire": (0.0012, 0.0)}[name]
    mechanics = replace(usual.mechanics, slack=slack, counterweight=counterweight)
    load_cell = replace(usual.load_cell, gain_error=None)
    return replace(usual, mechanics=mechanics, load_cell=load_cell)


def scenario(*, cycles: int) -> CantileverScenario:
    usual = CantileverScenario(name="T1")
    return replace(
        usual,
        clocks=replace(usual.clocks, rate=1000.0),
        mechanics=replace(usual.mechanics, cycles=cycles),
    )


@pytest.mark.slow
def test_from_exports_to_the_law(tmp_path: Path, run: Run) -> None:
    virtual = scenario(cycles=3)
    lab = make_lab(tmp_path, virtual)
    assert run("process", lab.raw).status == 0
    bending = read_result(lab.result).bending
    assert bending is not None
    law = bending.law
    assert law is not None
    true = law_moment(virtual.mechanics.wire.law(), law.curvature)
    known = law.is_known
    assert law.floor < 0.15
    assert known.sum() >= 38
    assert law.moment[known] == pytest.approx(true[known], rel=0.03)
    above = law.curvature > 0.5
    assert law.moment[above] == pytest.approx(true[above], rel=0.012)
    assert law.curvature[-1] > 28.0
    assert set(bending.cloud.branch.tolist()) == set(range(6))
    assert (lab.processed / "figures" / "moment-curvature.svg").is_file()


@pytest.mark.slow
def test_the_cloud_lies_on_the_law(repository: Path) -> None:
    """Nine in ten points of the first loading within three of their errors, away from the ends."""
    virtual, bending = scenario(cycles=2), _bending(repository, 7)
    cloud = bending.cloud
    rows = cloud.branch == 0
    at_rest = _curvature(virtual, cloud.moment_at_rest)
    true = _curvature(virtual, cloud.moment[rows] + cloud.moment_at_rest) - at_rest
    off = np.abs(cloud.curvature[rows] - true) / np.hypot(cloud.noise[rows], 0.01 * np.abs(true))
    assert np.mean(off[:, 1:-1] < 3.0) > 0.9


def _curvature(virtual: CantileverScenario, moment: Floats) -> Floats:
    """First loading of the virtual wire, odd: what it is bent to by moments."""
    grid = np.linspace(0.0, 60.0, 6001)
    size = np.interp(np.abs(moment), law_moment(virtual.mechanics.wire.law(), grid), grid)
    return np.asarray(np.sign(moment) * size, dtype=np.float64)


def _bending(repository: Path, seed: int) -> Bending:
    """One virtual test, the offsets of whose protocol are off by as much as it says.

    Now and then (seed 16) the machine waits where it turns for no longer than cameras can tell:
    that doubt is of the clocks, and touches no law.
    """
    rng = np.random.default_rng([seed, 11])
    text = (repository / "protocols" / "wire-cantilever.yaml").read_text(encoding="utf-8")
    for key, nominal in (("grip_offset", 6.0), ("pull_offset", 4.0)):
        assert f"{key}: {nominal:g} mm" in text
        drawn = nominal + 0.1 * rng.standard_normal()
        text = text.replace(f"{key}: {nominal:g} mm", f"{key}: {drawn:.6f} mm")
    plan, seen = parse_protocol(text, "wire-cantilever.yaml"), observe(scenario(cycles=2), seed)
    force = name_channels(seen.force, plan.sources["force"], Path("force.mat"))
    done = reduce_recordings({"force": force, "markers": seen.markers}, plan)
    test, results = done.evidence, done.results
    asked = [each for each in results if each.name.startswith("bending_stiffness")]
    assert {reason.code for each in asked for reason in each.reasons} <= {"turn_rounded"}, asked
    assert isinstance(test.bending, Bending)
    return test.bending


def _covered(law: MeasuredLaw, true: Floats) -> list[bool]:
    at = law_points(
        law.knots,
        law.compliance,
        law.compliance_covariance,
        CURVATURES,
        scale_error=law.scale_error,
    )
    return [bool(hit) for hit in np.abs(at.moment - true) <= 1.96 * at.moment_error]


def _study(repository: Path, runs: int) -> Counter[float]:
    true = law_moment(scenario(cycles=2).mechanics.wire.law(), CURVATURES)
    hits: Counter[float] = Counter()
    for seed in range(runs):
        law = _bending(repository, seed).law
        assert law is not None
        for curvature, hit in zip(CURVATURES.tolist(), _covered(law, true), strict=True):
            hits[curvature] += hit
    return hits


@pytest.mark.slow
def test_intervals_hold_the_law_in_a_few_tests(repository: Path) -> None:
    hits = _study(repository, FEW)
    assert sum(hits.values()) >= 0.7 * FEW * len(CURVATURES), dict(hits)


@pytest.mark.slow
def test_intervals_cover(repository: Path) -> None:
    hits = _study(repository, RUNS)
    level = 0.01 / len(CURVATURES)
    unsound = {at: hits[at] for at in hits if binomtest(hits[at], RUNS, 0.95).pvalue < level}
    assert not unsound, f"covered of {RUNS}: {unsound}; all: {dict(hits)}"


@pytest.mark.slow
@pytest.mark.parametrize("name", ["taut", "off the wire"])
def test_stiffnesses_cover(repository: Path, name: str) -> None:
    """The test itself tells what the string carried at rest, so that nothing else is folded in."""
    virtual = strung(name)
    law = virtual.mechanics.wire.law()
    held, states = Counter[float](), Counter[str]()
    for seed in range(TESTS):
        test, found = _stiffnesses(repository, virtual, seed)
        states[next(n.message[:40] for n in test.findings.notes if n.code == "string_at_rest")] += 1
        for curvature, each in found.items():
            true = _secant(law, curvature)
            assert each.interval is not None
            held[curvature] += each.interval.lower <= true <= each.interval.upper
    assert len(states) == 1, states
    assert min(held.values()) >= 51, held  # of 60 intervals of 95 %, as in 99 studies of 100


@pytest.mark.slow
@pytest.mark.xfail(strict=True, reason="intervals are two to three times as wide as the scatter")
@pytest.mark.parametrize("name", ["taut", "off the wire"])
def test_stiffnesses_are_narrow(repository: Path, name: str) -> None:
    virtual, halves = strung(name), []
    law = virtual.mechanics.wire.law()
    for seed in range(3):
        for curvature, each in _stiffnesses(repository, virtual, seed)[1].items():
            assert each.interval is not None
            half = 0.5 * (each.interval.upper - each.interval.lower)
            halves.append((curvature, half / _secant(law, curvature)))
    for curvature, widest in ((1.0, 0.02), (3.0, 0.01)):
        assert np.median([half for at, half in halves if at == curvature]) < widest


def _secant(law: MomentLaw, curvature: float) -> float:
    return float(law_moment(law, np.array([curvature]))[0]) / curvature


def _stiffnesses(
    repository: Path, virtual: CantileverScenario, seed: int
) -> tuple[Evidence, dict[float, Result]]:
    text = (repository / "protocols" / "wire-cantilever.yaml").read_text(encoding="utf-8")
    text = text.replace("gain: 0.5 N/V", "gain: 0.05 N/V")
    rng = np.random.default_rng([seed, 12])
    for key, nominal in (("grip_offset", 6.0), ("pull_offset", 4.0)):
        drawn = nominal + 0.1 * rng.standard_normal()
        text = text.replace(f"{key}: {nominal:g} mm", f"{key}: {drawn:.6f} mm")
    plan, seen = parse_protocol(text, "wire-cantilever.yaml"), observe(virtual, seed)
    mass = {"mass_per_length": virtual.mechanics.mass_per_length}  # the sheet says it
    plan = plan.model_copy(update={"specimen": plan.specimen.model_copy(update=mass)})
    force = name_channels(seen.force, plan.sources["force"], Path("force.mat"))
    done = reduce_recordings({"force": force, "markers": seen.markers}, plan)
    test, results = done.evidence, done.results
    named = {each.name: each for each in results}
    return test, {at: named[f"bending_stiffness_at_{at:g}"] for at in (1.0, 3.0)}
