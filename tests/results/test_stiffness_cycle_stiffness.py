"""Stiffnesses of every cycle on loops whose numbers are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.records.arrays import Floats
from labpipe.records.causes import SCALE_OF_FORCE
from labpipe.records.curve import Branch, Curve, Direction
from labpipe.records.result import Result, Status
from labpipe.records.signals import Signal, Signals
from labpipe.results.evidence import Evidence
from labpipe.results.likely_curves import likely_curves
from labpipe.results.stiffness import LoadingStiffness, UnloadingStiffness
from labpipe.uncertainty.intervals import Measured
from tests.builders.bundle_loops import LATER, NOISE, cycles, first_loading, holds, width
from tests.builders.reduced import reduced

ASKED = """\
results:
  - {result: loading-stiffness, over: 5 mm}
  - {result: hardening, over: 5 mm}
"""


def asked(loop: tuple[Floats, Floats, Floats]) -> dict[str, Result]:
    return reduced(*loop, more=ASKED)[1]


@pytest.fixture(scope="module")
def usual() -> dict[str, Result]:
    return asked(cycles(noise=NOISE))


def shares(found: Result) -> dict[str, float]:
    return {each.cause: each.change for each in found.budget}


def test_unloading_begins_where_the_wait_ends_and_not_where_its_samples_do() -> None:
    """The branch holds 3 s of the wait; noise of cameras must not be carried over them."""
    time: Floats = np.arange(0.0, 26.0, 0.02)
    path = 1e-3 * np.clip(np.minimum(time, 23.0 - time), 0.0, 10.0)
    off = 0.010 - path
    force = 1.0 - 200.0 * off + 2e4 * off**2
    waits, turns, ends = (int(np.searchsorted(time, at)) for at in (10.0, 13.0, 23.0))
    up = Branch(0, waits, 1, Direction.LOADING, 0.0, 10.0)
    down = Branch(waits, ends, 1, Direction.UNLOADING, 13.0, 23.0)
    numbers = np.zeros(len(time), dtype=np.int64)
    seen = path + np.random.default_rng(1).normal(0.0, 15e-6, len(time))
    signals = Signals()
    for name, values, unit in (("force", force, "N"), ("displacement", seen, "m")):
        signals = signals.with_new(name, Signal(time, values, unit, "force"))
    curve = Curve(time, seen, force, numbers, numbers + 1, (up, down))
    test = Evidence(signals, curve=curve, unfiltered=signals.raw["force"])
    test = replace(test, replicates=likely_curves(test))
    (number,) = UnloadingStiffness(over=0.003).compute(test).numbers
    found = number.outcome
    assert isinstance(found, Measured)
    inside = slice(turns, ends)
    window = (off[inside] >= 0.0003) & (off[inside] <= 0.003)
    slope = np.polyfit(path[inside][window], force[inside][window], 1)[0]
    assert found.value == pytest.approx(slope, rel=0.01)


def test_stiffness_of_each_cycle_and_hardening(usual: dict[str, Result]) -> None:
    path = np.linspace(0.0, 0.005, 251)
    lever = path - path.mean()
    first = float(lever @ first_loading(path) / (lever @ path))
    for number, true in ((1, first), (2, LATER), (3, LATER)):
        holds(usual[f"loading_stiffness.{number}"], true, "N/m")
    for number in (2, 3):
        holds(usual[f"hardening.{number}"], LATER / first, "1")
    value = usual["loading_stiffness.2"].value
    assert value is not None
    assert shares(usual["loading_stiffness.2"])[SCALE_OF_FORCE] == pytest.approx(0.01 * value)
    assert "hardening.1" not in usual


def test_a_gain_cancels_in_hardening(usual: dict[str, Result]) -> None:
    time, path, force = cycles(noise=NOISE)
    stronger = asked((time, path, 1.05 * force))
    for name, factor in (("loading_stiffness.2", 1.05), ("hardening.2", 1.0)):
        value = usual[name].value
        assert value is not None
        assert stronger[name].value == pytest.approx(factor * value, rel=1e-9)
        # Other forces, other draws: a width between quantiles of 400 has a standard deviation of
        # 4.8 %, so two differ by less than 20 % (three of 6.8 %).
        assert width(stronger[name]) == pytest.approx(factor * width(usual[name]), rel=0.2)
    assert SCALE_OF_FORCE in shares(stronger["loading_stiffness.2"])
    assert SCALE_OF_FORCE not in shares(stronger["hardening.2"])


def test_one_cycle_has_no_hardening() -> None:
    results = asked(cycles(1, noise=NOISE))
    assert "loading_stiffness.1" in results
    assert not [name for name in results if name.startswith("hardening")]


def test_force_that_is_not_taken_off_between_cycles() -> None:
    time, path, force = cycles(noise=NOISE)
    results = asked((time, path, np.where(time > 60.0, force + 2.0, force)))
    assert results["loading_stiffness.2"].why.startswith("not_unloaded: the branch begins at 1.99")
    assert results["hardening.2"].why.startswith("not_unloaded: ")
    assert results["loading_stiffness.1"].status is Status.OK


def test_no_hardening_without_a_first_cycle() -> None:
    time, path, force = cycles(noise=NOISE)
    force = np.where(time < 50.0, np.random.default_rng(1).normal(0.0, NOISE, len(time)), force)
    results = asked((time, path, force))
    assert results["hardening.2"].why.startswith("no_stiffness: ")


@pytest.mark.slow
def test_the_estimate_knows_what_noise_hides_of_the_foot() -> None:
    """The first samples lie within the noise; 800 N/m up to 2 mm miss them, 300 N/m do not."""
    path = np.linspace(0.0, 0.005, 251)
    lever = path - path.mean()
    true = float(lever @ first_loading(path) / (lever @ path))
    values, estimates = [], []
    for seed in range(12):
        found = asked(cycles(1, noise=NOISE, seed=seed))["loading_stiffness.1"]
        assert found.value is not None
        assert found.estimate is not None
        values.append(found.value)
        estimates.append(found.estimate)
    assert np.mean(values) < true - 3.0
    assert np.mean(estimates) == pytest.approx(true, abs=1.5)


def test_a_force_that_drifts_at_rest_is_told() -> None:
    """A branch that holds 5 s at rest, in which the force goes off by 20 times its noise."""
    time: Floats = np.arange(0.0, 25.0, 0.02)
    path = 1e-3 * np.maximum(time - 5.0, 0.0)
    random = np.random.default_rng(1)
    drift = 2e-3 * np.minimum(time, 5.0)
    for off, doubted in ((0.0, False), (1.0, True)):
        force = 100.0 * path + off * drift + random.normal(0.0, 5e-4, len(time))
        seen = path + random.normal(0.0, 1e-5, len(time))
        signals = Signals()
        for name, values, unit in (("force", force, "N"), ("displacement", seen, "m")):
            signals = signals.with_new(name, Signal(time, values, unit, "force"))
        numbers = np.zeros(len(time), dtype=np.int64)
        up = Branch(0, len(time), 1, Direction.LOADING, 0.0, 25.0)
        curve = Curve(time, seen, force, numbers, numbers + 1, (up,))
        test = Evidence(signals, curve=curve, unfiltered=signals.raw["force"])
        test = replace(test, replicates=likely_curves(test))
        (number,) = LoadingStiffness(over=0.005).compute(test).numbers
        assert ("rest_in_window" in {each.code for each in number.doubts}) is doubted
