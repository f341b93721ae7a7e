from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.records.arrays import Floats
from labpipe.records.curve import Branch, Curve, Direction
from labpipe.records.signals import Signal, Signals
from labpipe.results.curves import replicate_curves
from labpipe.results.cycles import _find_period, choose_peak_sample, find_cycle_samples
from labpipe.results.kinds import ReducedTest
from labpipe.results.stiffness import LoadingStiffness, UnloadingStiffness
from labpipe.uncertainty.replicates import Trace
from tests.builders.pulls import BREAK, broken, pull, pulled


def test_cycles_part_where_a_waiting_motion_is_farthest() -> None:
    """Between the cycles the motion waits for samples 5 to 8, and is lowest at 6."""
    way = np.array([0.0, 1.0, 2.0, 1.0, 0.2, 0.1, -0.1, 0.1, 0.2, 1.0, 2.0, 1.0, 0.0])
    branches = (
        Branch(0, 2, 1, Direction.LOADING, 0.0, 2.0),
        Branch(2, 5, 1, Direction.UNLOADING, 2.0, 4.0),
        Branch(8, 10, 2, Direction.LOADING, 8.0, 10.0),
        Branch(10, 13, 2, Direction.UNLOADING, 10.0, 12.0),
    )
    for sense in (1.0, -1.0):
        curve = Curve(np.arange(13.0), sense * way, way, branches)
        assert find_cycle_samples(curve, 1) == slice(0, 7)
        assert find_cycle_samples(curve, 2) == slice(6, 13)


def test_parts_of_a_cycle_counted_in_branches() -> None:
    """Loaded for 2 s, unloaded for 3 s."""
    up = Branch(0, 2, 1, Direction.LOADING, 0.0, 2.0)
    down = Branch(2, 5, 1, Direction.UNLOADING, 2.0, 5.0)
    stretches = {
        **{(0.0, 1.0): (0.0, 2.0), (1.0, 2.0): (2.0, 5.0), (0.5, 1.5): (1.0, 3.5)},
        **{(0.0, 2.0): (0.0, 5.0), (0.0, 3.0): (0.0, 5.0), (2.0, 3.0): None},
    }
    assert {reads: _find_period([up, down], *reads) for reads in stretches} == stretches


def evidence(time: Floats, path: Floats, force: Floats, *branches: Branch) -> ReducedTest:
    signals = Signals()
    for name, values, unit in (("force", force, "N"), ("displacement", path, "m")):
        signals = signals.add_signal(name, Signal(time, values, unit, "force"))
    curve = Curve(time, path, force, branches)
    test = ReducedTest(signals, curve=curve, unfiltered_force=signals.raw["force"])
    return replace(test, replicates=replicate_curves(test))


def test_a_peak_between_samples_is_one_of_the_force_and_not_of_the_coarser_curve() -> None:
    """Up by 3 N and down by 5 N a sample; of four samples of the force to one of the curve."""
    time = np.arange(40.0)
    path = np.minimum(time, 38.4 - time)
    force = np.minimum(3.0 * time, 57.6 - 5.0 * (time - 19.2))
    branches = (
        Branch(0, 20, 1, Direction.LOADING, 0.0, 19.2),
        Branch(20, 40, 1, Direction.UNLOADING, 19.2, 39.0),
    )
    numbers = []
    for step in (1.0, 0.25):
        fine = np.arange(0.0, 39.1, step)
        signal = Signal(fine, np.interp(fine, time, force), "N", "force")
        test = ReducedTest(Signals().add_signal("force", signal), unfiltered_force=signal)
        trace = Trace(time, path, force, branches, steps_to_event=1.0)
        numbers.append(float(choose_peak_sample(test, trace, 1).compute_numbers(trace)[0]))
    assert numbers == pytest.approx([57.0 + 0.6, 57.0 + 0.6 / 4])


def test_unloading_begins_where_the_wait_ends_and_not_where_its_samples_do() -> None:
    """The branch holds 3 s of the wait; noise of cameras must not be carried over them."""
    time: Floats = np.arange(0.0, 26.0, 0.02)
    path = 1e-3 * np.clip(np.minimum(time, 23.0 - time), 0.0, 10.0)
    off = 0.010 - path
    force = 1.0 - 200.0 * off + 2e4 * off**2
    waits, turns, ends = (int(np.searchsorted(time, at)) for at in (10.0, 13.0, 23.0))
    up = Branch(0, waits, 1, Direction.LOADING, 0.0, 10.0)
    down = Branch(waits, ends, 1, Direction.UNLOADING, 13.0, 23.0)
    noisy = path + np.random.default_rng(1).normal(0.0, 15e-6, len(time))
    test = evidence(time, noisy, force, up, down)
    (result,) = UnloadingStiffness(over=0.003).compute_results(test)
    assert result.value is not None
    inside = slice(turns, ends)
    window = (off[inside] >= 0.0003) & (off[inside] <= 0.003)
    slope = np.polyfit(path[inside][window], force[inside][window], 1)[0]
    assert result.value == pytest.approx(slope, rel=0.01)


def test_a_force_that_drifts_at_rest_is_told() -> None:
    """A branch that holds 5 s at rest, in which the force goes off by 20 times its noise."""
    time: Floats = np.arange(0.0, 25.0, 0.02)
    path = 1e-3 * np.maximum(time - 5.0, 0.0)
    random = np.random.default_rng(1)
    drift = 2e-3 * np.minimum(time, 5.0)
    for off, doubted in ((0.0, False), (1.0, True)):
        force = 100.0 * path + off * drift + random.normal(0.0, 5e-4, len(time))
        noisy = path + random.normal(0.0, 1e-5, len(time))
        up = Branch(0, len(time), 1, Direction.LOADING, 0.0, 25.0)
        test = evidence(time, noisy, force, up)
        (result,) = LoadingStiffness(over=0.005).compute_results(test)
        assert ("rest_in_window" in result.codes) is doubted


@pytest.mark.parametrize("sample", [12_000, 12_001, 12_002])
def test_the_peak_of_a_long_record_that_breaks_or_has_a_gap(sample: int) -> None:
    """Its samples are averaged in blocks; no sample of a block lies hundreds of newtons off."""
    travel, force = pull(length=0.26)
    force = broken(travel, force, at=float(travel[sample]))
    for gap in (slice(0), slice(6000, 6100)):
        force[gap] = np.nan
        _, results = pulled(travel, force, curve=BREAK, results=["peak-force"])
        peak = results["peak_force.1"]
        assert peak.interval is not None
        assert peak.value == pytest.approx(5e3 * travel[sample], abs=0.1)
        assert peak.interval.upper - peak.interval.lower < 1.0
