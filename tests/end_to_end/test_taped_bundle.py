"""Taped bundles: the protocol on virtual cantilever tests of a stick-slip law, against the truth.

The truth is computed here from the noise-free path of the virtual lab, by other means than those
that are tested: ratios of what force and deflection gain in time, and a scan over break points.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import binomtest

from labpipe.process.reading import name_channels
from labpipe.process.story import reduce_recordings
from labpipe.protocol.load import dump_protocol, parse_protocol
from labpipe.protocol.schema import Protocol
from labpipe.records.arrays import Floats
from labpipe.records.result import Result, Status
from labpipe.virtual_lab import NO_MISHAPS, CantileverScenario, Observation, observe
from labpipe.virtual_lab.specimens import WireModel

LENGTH = 0.1143
STICK = 0.20
"""N m^2, about that of seven automotive wires that stick together."""
BUNDLE = WireModel(
    stick_stiffness=STICK,
    stick_moment=0.057,
    slip_stiffness=0.09,
    reference_moment=0.3,
    hardening=0.75,
    last_moment=2.0,
)
STIFF = replace(BUNDLE, stick_moment=1.9)
"""Never slips within the test."""
FIRST = (0.0002, 0.005)
RUNS = 200


def scenario(wire: WireModel, *, rate: float = 200.0, stroke: float = 0.02) -> CantileverScenario:
    usual = CantileverScenario()
    mechanics = replace(
        usual.mechanics,
        wire=wire,
        length=LENGTH,
        stroke=stroke,
        cycles=2,
        steps_per_branch=100,
        n_stations=32,
    )
    return replace(
        usual,
        rest=2.5,
        mechanics=mechanics,
        clocks=replace(usual.clocks, rate=rate),
        load_cell=replace(usual.load_cell, gain=0.89),
        markers=replace(
            usual.markers, first=0.019, pull_offset=0.00635, centre_offset=0.00275, n_markers=8
        ),
        mishaps=NO_MISHAPS,
    )


@lru_cache
def protocol(repository: Path, stroke: float) -> Protocol:
    text = (repository / "protocols" / "taped-bundle.yaml").read_text(encoding="utf-8")
    text = text.replace("stroke: 53 mm", f"stroke: {1e3 * stroke:g} mm")
    return parse_protocol(text.replace("cycles: 3", "cycles: 2"), "taped-bundle.yaml")


def reduced(test: Observation, plan: Protocol) -> dict[str, Result]:
    force = name_channels(test.force, plan.sources["force"], Path("force.mat"))
    found = reduce_recordings({"force": force, "markers": test.markers}, plan).results
    return {each.name: each for each in found}


def gain_in_time(time: Floats, displacement: Floats, force: Floats) -> float:
    lever = time - time.mean()
    return float((lever @ force) / (lever @ displacement))


def loading(test: Observation, cycle: int) -> tuple[Floats, Floats, Floats]:
    """Evenly in time, as it is recorded: the path's own places crowd where the wire turns."""
    truth = test.truth
    of = truth.cycles[cycle - 1]
    time = np.linspace(of.start_time, of.top_time, 4001)
    path = np.array(truth.time)
    return time, np.interp(time, path, truth.deflection), np.interp(time, path, truth.force)


def between(curve: tuple[Floats, Floats, Floats], low: float, high: float) -> list[Floats]:
    chosen = (curve[1] >= low) & (curve[1] <= high) & (curve[2] > 0.0)
    return [each[chosen] for each in curve]


def taken_up(test: Observation, cycle: int) -> float:
    curve = loading(test, cycle)
    first = int(np.argmax(curve[2] > 1e-9))
    start = float(curve[1][max(first - 1, 0)])
    return gain_in_time(*between(curve, start, start + 0.005))


def hinge(d: Floats, f: Floats) -> tuple[float, float]:
    """Break point and level of the best two lines, by trying 400 places."""
    best = (np.inf, 0.0, 0.0)
    for at in np.linspace(d[0], d[-1], 402)[1:-1].tolist():
        design = np.column_stack(
            [np.ones_like(d), np.minimum(d - at, 0.0), np.maximum(d - at, 0.0)]
        )
        found, *_ = np.linalg.lstsq(design, f, rcond=None)
        left = f - design @ found
        best = min(best, (float(left @ left), at, float(found[0])))
    return best[1], best[2]


def true_values(test: Observation) -> dict[str, float]:
    first = loading(test, 1)
    initial = gain_in_time(*between(first, *FIRST))
    _, d, f = between(first, *FIRST)
    place, level = hinge(d, f)
    top = float(first[1].max())
    end = between(first, top - 0.005, top)
    stiffness = [taken_up(test, cycle) for cycle in (1, 2)]
    return {
        "initial_stiffness": initial,
        "kink_displacement": place,
        "kink_force": level,
        "end_slope": gain_in_time(*end) / initial,
        "loading_stiffness.1": stiffness[0],
        "loading_stiffness.2": stiffness[1],
        "hardening.2": stiffness[1] / stiffness[0],
        "bending_stiffness": initial * LENGTH**3 / 3.0,
    }


def width(found: Result) -> float:
    assert found.interval is not None
    return found.interval.upper - found.interval.lower


def test_numbers(repository: Path) -> None:
    test = observe(scenario(BUNDLE), 1)
    results = reduced(test, protocol(repository, 0.02))
    for name, true in true_values(test).items():
        found = results[name]
        assert found.status is Status.OK, found
        # A wide net: coverage at 95 % is counted below, over many seeds.
        assert found.value == pytest.approx(true, abs=width(found)), name
    assert "plateau_displacement" not in results
    assert not [each for each in results.values() if each.status is Status.FAILED]


def test_bending_stiffness_of_a_bundle_that_sticks(repository: Path) -> None:
    """That of its law, known without any test."""
    results = reduced(observe(scenario(STIFF), 2), protocol(repository, 0.02))
    found = results["bending_stiffness"]
    assert found.value == pytest.approx(STICK, rel=0.01)
    assert found.interval is not None
    assert found.interval.lower < STICK < found.interval.upper
    assert results["kink_displacement"].why.startswith("no_kink: ")
    assert results["hardening.2"].value == pytest.approx(1.0, abs=0.05)


def test_reversed_bridge(repository: Path) -> None:
    """Wired the other way round: force and clock are doubted, by their cause."""
    plan = protocol(repository, 0.02)
    text = dump_protocol(plan).replace("gain: 0.89 N/V", "gain: -0.89 N/V")
    results = reduced(observe(scenario(BUNDLE), 1), parse_protocol(text, "taped-bundle.yaml"))
    for name in ("peak_force.1", "initial_stiffness"):
        assert results[name].status is Status.DOUBTFUL
        assert results[name].why.startswith("force_reversed: the force goes to -3.0")
    assert results["clock_offset"].status is Status.DOUBTFUL


@pytest.mark.slow
def test_intervals_cover(repository: Path) -> None:
    """Eight results: each may fail by chance once in eight hundred studies."""
    plan = protocol(repository, 0.02)
    hits: dict[str, int] = {}
    for seed in range(RUNS):
        test = observe(scenario(BUNDLE), seed)
        results = reduced(test, plan)
        for name, true in true_values(test).items():
            interval = results[name].interval
            inside = interval is not None and interval.lower <= true <= interval.upper
            hits[name] = hits.get(name, 0) + inside
    for name, count in hits.items():
        assert binomtest(count, RUNS, 0.95, alternative="less").pvalue > 0.01 / 8, (name, count)
