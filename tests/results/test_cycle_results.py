from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.records.arrays import Floats
from labpipe.records.causes import SCALE_OF_FORCE
from labpipe.records.curve import Branch, Curve, Direction
from labpipe.records.result import Result, Status
from labpipe.records.signals import Signal, Signals
from labpipe.results.curve_replicates import replicate_curves
from labpipe.results.cycles import PeakForce, _time_of_part, stretch_of_cycle
from labpipe.results.kinds import to_result
from labpipe.results.reduced_test import ReducedTest
from labpipe.results.stiffness import LoadingStiffness, UnloadingStiffness
from labpipe.uncertainty.intervals import Measured
from tests.builders.bundle_loops import LATER, NOISE, cycles, first_loading, holds, width
from tests.builders.reduced import loop, reduced

TRUTH = {
    "peak_force": 1.0,
    "peak_displacement": 0.010,
    "unloading_stiffness": 125.0,
    "energy": 0.5 * 1.0 * 0.010 - 0.5 * 1.0 * 0.008,
    "residual_displacement": 0.002,
}


def test_numbers() -> None:
    _, results = reduced(*loop(noise=1e-3))
    names = {f"{name}.{cycle}": truth for name, truth in TRUTH.items() for cycle in (1, 2)}
    for name, truth in {**names, "initial_stiffness": 100.0}.items():
        result = results[name]
        assert result.status is Status.OK, name
        assert result.value == pytest.approx(truth, rel=0.02), name
        assert result.interval is not None
        assert result.interval.lower < result.interval.upper
        assert result.n > 8
        assert result.method
    assert results["initial_stiffness"].unit == "N/m"


def test_scale_and_zero_are_in_the_interval() -> None:
    """The force is known to 1 %."""
    test, results = reduced(*loop(noise=1e-4))
    for name in ("peak_force.1", "unloading_stiffness.1", "energy.1"):
        interval, value = results[name].interval, results[name].value
        assert interval is not None
        assert value is not None
        scale = shares(results[name])[SCALE_OF_FORCE]
        assert scale == pytest.approx(0.01 * value, rel=1e-3)
        # Widths of 400 draws repeat within 5 %.
        assert interval.standard_error >= 0.95 * scale
    zero = shares(results["peak_force.1"]).get("zero of the force", 0.0)
    assert zero == pytest.approx(test.raw_force.zero_error, rel=1e-6)
    assert shares(results["peak_force.1"])["noise"] < 0.001


def test_loading_alone_has_no_loop() -> None:
    time, path, force = loop(cycles=1, noise=1e-3)
    kept = time < 11.9
    _, results = reduced(time[kept], path[kept], force[kept])
    for name in ("energy.1", "residual_displacement.1", "unloading_stiffness.1"):
        assert results[name].why == "partial_cycle: the cycle has no unloading branch"
    found = results["peak_force.1"]
    assert found.status is Status.DOUBTFUL
    assert found.why.startswith("partial_cycle: the record ends at 11.8")
    assert found.why.endswith("while still loading")
    assert results["initial_stiffness"].status is Status.OK


def test_records_that_end_in_a_rest_or_while_unloading() -> None:
    time, path, force = loop(cycles=1, noise=1e-3)
    held, noise = time > 12.0, np.random.default_rng(1).normal(0.0, 1e-3, len(time))
    still = np.where(held, 0.010 + 1e-3 * noise, path), np.where(held, 1.0 + noise, force)
    _, results = reduced(time, *still)
    assert results["peak_force.1"].status is Status.OK
    assert results["peak_displacement.1"].value == pytest.approx(0.010, rel=5e-3)
    time, path, force = loop(cycles=2, noise=1e-3)
    kept = time < 38.0
    _, results = reduced(time[kept], path[kept], force[kept])
    assert results["energy.2"].status is Status.DOUBTFUL
    assert results["energy.2"].why.endswith("while still unloading")
    assert results["peak_force.2"].status is Status.OK


def test_a_gap_costs_only_its_cycle() -> None:
    time, path, force = loop(noise=1e-3)
    force[(time > 15.0) & (time < 15.1)] = np.nan
    _, results = reduced(time, path, force)
    assert results["energy.1"].why.startswith("gap: 4 samples of the cycle have no force")
    assert results["energy.2"].value == pytest.approx(TRUTH["energy"], rel=0.02)
    assert results["energy.2"].status is Status.OK
    assert results["initial_stiffness"].status is Status.OK
    assert results["peak_displacement.1"].status is Status.OK


def test_cycles_part_where_a_waiting_motion_is_farthest() -> None:
    """Between the cycles the motion waits for samples 5 to 8, and is lowest at 6."""
    way = np.array([0.0, 1.0, 2.0, 1.0, 0.2, 0.1, -0.1, 0.1, 0.2, 1.0, 2.0, 1.0, 0.0])
    branches = (
        Branch(0, 2, 1, Direction.LOADING, 0.0, 2.0),
        Branch(2, 5, 1, Direction.UNLOADING, 2.0, 4.0),
        Branch(8, 10, 2, Direction.LOADING, 8.0, 10.0),
        Branch(10, 13, 2, Direction.UNLOADING, 10.0, 12.0),
    )
    flags = np.zeros(13, int)
    for sense in (1.0, -1.0):
        curve = Curve(np.arange(13.0), sense * way, way, flags, flags, branches)
        assert stretch_of_cycle(curve, [*branches[:2]]) == slice(0, 7)
        assert stretch_of_cycle(curve, [*branches[2:]]) == slice(6, 13)


def test_parts_of_a_cycle_counted_in_branches() -> None:
    """Loaded for 2 s, unloaded for 3 s."""
    up = Branch(0, 2, 1, Direction.LOADING, 0.0, 2.0)
    down = Branch(2, 5, 1, Direction.UNLOADING, 2.0, 5.0)
    stretches = {
        **{(0.0, 1.0): (0.0, 2.0), (1.0, 2.0): (2.0, 5.0), (0.5, 1.5): (1.0, 3.5)},
        **{(0.0, 2.0): (0.0, 5.0), (0.0, 3.0): (0.0, 5.0), (2.0, 3.0): None},
    }
    assert {reads: _time_of_part([up, down], reads) for reads in stretches} == stretches


PEAKS = "results:\n  - {result: peak-force}\n  - {result: peak-displacement}\n"


def peaks(time: np.ndarray, path: np.ndarray, force: np.ndarray) -> dict[str, Result]:
    return reduced(time, path, force, more=PEAKS)[1]


def test_downwards_is_a_way_to_load() -> None:
    """Peaks are the largest samples in the sense of loading; the energy is the same."""
    time, path, force = loop(noise=1e-3)
    up, down = reduced(time, path, force)[1], reduced(time, -path, -force)[1]
    for name, values in (("peak_force", force), ("peak_displacement", path)):
        first = values[time < 22.0].max()
        assert up[f"{name}.1"].value == pytest.approx(first, abs=1e-12)
        assert down[f"{name}.1"].value == pytest.approx(-first, abs=1e-12)
    assert down["energy.2"].value == pytest.approx(up["energy.2"].value, rel=1e-9)


def test_a_gap_beside_the_peak() -> None:
    time, path, force = loop(noise=1e-3)
    top = int(np.argmax(np.where(time < 22.0, force, -1.0)))
    force[top - 4 : top] = np.nan
    found = peaks(time, path, force)
    assert found["peak_force.1"].status is Status.DOUBTFUL
    assert "gap_at_peak" in [reason.code for reason in found["peak_force.1"].reasons]
    assert found["peak_force.2"].status is Status.OK
    assert found["peak_displacement.1"].status is Status.OK


def test_a_cycle_without_any_force() -> None:
    time, path, force = loop(noise=1e-3)
    force[time > 21.5] = np.nan
    test, _ = reduced(time, path, force)
    second = to_result(test, PeakForce().compute(test).numbers[1])
    assert second.name == "peak_force.2"
    assert second.status is Status.FAILED


ASKED = """\
results:
  - {result: loading-stiffness, over: 5 mm}
  - {result: hardening, over: 5 mm}
"""


def asked(loop: tuple[Floats, Floats, Floats]) -> dict[str, Result]:
    return reduced(*loop, more=ASKED)[1]


def shares(found: Result) -> dict[str, float]:
    return {contribution.cause: contribution.change for contribution in found.budget}


def evidence(time: Floats, path: Floats, force: Floats, *branches: Branch) -> ReducedTest:
    signals = Signals()
    for name, values, unit in (("force", force, "N"), ("displacement", path, "m")):
        signals = signals.with_new(name, Signal(time, values, unit, "force"))
    numbers = np.zeros(len(time), dtype=np.int64)
    curve = Curve(time, path, force, numbers, numbers + 1, branches)
    test = ReducedTest(signals, curve=curve, unfiltered=signals.raw["force"])
    return replace(test, replicates=replicate_curves(test))


def test_unloading_begins_where_the_wait_ends_and_not_where_its_samples_do() -> None:
    """The branch holds 3 s of the wait; noise of cameras must not be carried over them."""
    time: Floats = np.arange(0.0, 26.0, 0.02)
    path = 1e-3 * np.clip(np.minimum(time, 23.0 - time), 0.0, 10.0)
    off = 0.010 - path
    force = 1.0 - 200.0 * off + 2e4 * off**2
    waits, turns, ends = (int(np.searchsorted(time, at)) for at in (10.0, 13.0, 23.0))
    up = Branch(0, waits, 1, Direction.LOADING, 0.0, 10.0)
    down = Branch(waits, ends, 1, Direction.UNLOADING, 13.0, 23.0)
    seen = path + np.random.default_rng(1).normal(0.0, 15e-6, len(time))
    test = evidence(time, seen, force, up, down)
    (number,) = UnloadingStiffness(over=0.003).compute(test).numbers
    found = number.outcome
    assert isinstance(found, Measured)
    inside = slice(turns, ends)
    window = (off[inside] >= 0.0003) & (off[inside] <= 0.003)
    slope = np.polyfit(path[inside][window], force[inside][window], 1)[0]
    assert found.value == pytest.approx(slope, rel=0.01)


def test_stiffness_of_each_cycle_and_hardening() -> None:
    """A gain of the force cancels in the hardening."""
    time, loaded, force = cycles(noise=NOISE)
    results, stronger = asked((time, loaded, force)), asked((time, loaded, 1.05 * force))
    path = np.linspace(0.0, 0.005, 251)
    lever = path - path.mean()
    first = float(lever @ first_loading(path) / (lever @ path))
    for number, true in ((1, first), (2, LATER), (3, LATER)):
        holds(results[f"loading_stiffness.{number}"], true, "N/m")
    for number in (2, 3):
        holds(results[f"hardening.{number}"], LATER / first, "1")
    assert "hardening.1" not in results
    assert list(asked(cycles(1, noise=NOISE))) == ["loading_stiffness.1"]
    for name, factor in (("loading_stiffness.2", 1.05), ("hardening.2", 1.0)):
        value = results[name].value
        assert value is not None
        assert stronger[name].value == pytest.approx(factor * value, rel=1e-9)
        # Other forces, other draws: a width between quantiles of 400 has a standard deviation of
        # 4.8 %, so two differ by less than 20 % (three of 6.8 %).
        assert width(stronger[name]) == pytest.approx(factor * width(results[name]), rel=0.2)
    value = results["loading_stiffness.2"].value
    assert value is not None
    assert shares(results["loading_stiffness.2"])[SCALE_OF_FORCE] == pytest.approx(0.01 * value)
    assert SCALE_OF_FORCE not in shares(stronger["hardening.2"])


def test_no_hardening_where_the_force_stays_or_there_is_no_first_cycle() -> None:
    time, path, force = cycles(noise=NOISE)
    results = asked((time, path, np.where(time > 60.0, force + 2.0, force)))
    assert results["loading_stiffness.2"].why.startswith("not_unloaded: the branch begins at 1.99")
    assert results["hardening.2"].why.startswith("not_unloaded: ")
    assert results["loading_stiffness.1"].status is Status.OK
    force = np.where(time < 50.0, np.random.default_rng(1).normal(0.0, NOISE, len(time)), force)
    assert asked((time, path, force))["hardening.2"].why.startswith("no_stiffness: ")


def test_a_force_that_drifts_at_rest_is_told() -> None:
    """A branch that holds 5 s at rest, in which the force goes off by 20 times its noise."""
    time: Floats = np.arange(0.0, 25.0, 0.02)
    path = 1e-3 * np.maximum(time - 5.0, 0.0)
    random = np.random.default_rng(1)
    drift = 2e-3 * np.minimum(time, 5.0)
    for off, doubted in ((0.0, False), (1.0, True)):
        force = 100.0 * path + off * drift + random.normal(0.0, 5e-4, len(time))
        seen = path + random.normal(0.0, 1e-5, len(time))
        up = Branch(0, len(time), 1, Direction.LOADING, 0.0, 25.0)
        test = evidence(time, seen, force, up)
        (number,) = LoadingStiffness(over=0.005).compute(test).numbers
        assert ("rest_in_window" in {doubt.code for doubt in number.doubts}) is doubted
