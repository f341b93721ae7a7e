"""Results of tensile tests from pulls whose numbers are known."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.records.result import Status
from tests.builders.pulls import (
    BREAK,
    LINE,
    MARKED,
    STEP,
    broken,
    holds,
    pull,
    pulled,
    slipped,
)


def test_failure_and_energy() -> None:
    travel, force = pull()
    torn = broken(travel, force, at=0.01601)
    _, results = pulled(travel, torn, curve=BREAK, results=["failure", "energy-to-break"])
    found = results["failure_displacement"]
    assert found.interval is not None
    assert found.interval.lower <= 0.01601 <= found.interval.upper
    assert found.interval.upper - found.interval.lower < 1.1 * STEP
    holds(results["failure_force"], 80.05, "N")
    holds(results["energy_to_break"], 0.5 * 5e3 * 0.01601**2, "J")


def test_a_loss_that_began_a_sample_earlier_is_in_the_interval() -> None:
    """The last sample before the force is gone lies 5 N below the one before it."""
    travel, force = pull()
    torn = broken(travel, force, at=0.01601)
    last = int(np.flatnonzero(travel <= 0.01601)[-1])
    torn[last] -= 5.0
    _, results = pulled(travel, torn, curve=BREAK, results=["failure"])
    found = results["failure_force"]
    assert found.value == torn[last]
    assert found.interval is not None
    assert 0.95 * 5.0 < found.interval.upper - torn[last] < 1.05 * 5.0
    # It failed between the two; the value is inside, as of all intervals.
    assert found.interval.lower == found.value
    assert found.estimate == pytest.approx(torn[last - 1], abs=0.25)


def test_energy_of_the_last_cycle_of_several() -> None:
    """Half way up, back to zero, and up until it tears: the work of the second way up."""
    travel, _ = pull(length=0.01)
    path = np.concatenate([travel, travel[-2:0:-1], pull()[0]])
    load = broken(path, 5e3 * path + np.random.default_rng(1).normal(0, 0.02, len(path)), at=0.016)
    _, results = pulled(path, load, curve=BREAK, results=["failure", "energy-to-break", LINE])
    holds(results["energy_to_break"], 0.5 * 5e3 * 0.016**2, "J")
    assert results["failure_displacement"].value == pytest.approx(0.016, abs=STEP)
    assert results["stiffness"].why.startswith("not_reached: the branch reaches 9.9")


def test_slips() -> None:
    travel, force = pull()
    lower = slipped(travel, force, (0.006, 3.0), (0.0141, 1.0))
    test, results = pulled(travel, lower, curve=MARKED, results=[LINE, "slips"])
    assert len(test.slips) == 2
    for number, place, drop in ((1, 0.006, 3.0), (2, 0.0141, 1.0)):
        position = results[f"slip_position.{number}"]
        assert position.value == pytest.approx(place, abs=2 * STEP)
        lost = results[f"slip_drop.{number}"]
        assert lost.value == pytest.approx(drop, abs=0.1)
        assert lost.unit == "N"
        assert lost.method.endswith("; marked")


def test_slack() -> None:
    curve = "slack: {from: 10 %, to: 30 %}"
    _, results = pulled(*pull(slack=0.003), curve=curve, results=["slack", LINE])
    found = results["slack"]
    assert found.value == pytest.approx(0.003, abs=1e-5)
    assert found.method == "toe compensation, ASTM D638 annex A1"
    holds(results["stiffness"], 5000.0, "N/m")


def test_nothing_moves() -> None:
    travel, force = pull()
    curve = f"{BREAK}, {MARKED}, slack: {{from: 10 %, to: 30 %}}"
    asked = [
        *(LINE, "two-segments, from: 1 mm, to: 18 mm", "normalised-stiffness, of: stiffness"),
        *("modulus, of: stiffness, area: stated", "failure", "energy-to-break", "slack", "slips"),
        "compliance, from: 10 N, to: 80 N",
    ]
    _, results = pulled(0.01 * travel, force, curve=curve, results=asked)
    assert {result.value for result in results.values()} == {None}
    assert len(results) == 11
    for result in results.values():
        assert result.why.startswith("no_motion: the motion spans 0.2 mm, less"), result


def test_rows_without_times() -> None:
    curve = f"{BREAK}, {MARKED}, slack: {{from: 10 %, to: 30 %}}"
    travel, force = pull(slack=0.001)
    torn = broken(travel, force, at=0.016)
    asked = [LINE, "failure", "energy-to-break", "slack", "peak-force"]
    _, timed = pulled(travel, torn, curve=curve, results=asked)
    _, rows = pulled(travel, torn, curve=curve, results=asked, time=False)
    for name, found in rows.items():
        assert found.value == pytest.approx(timed[name].value, rel=1e-9), name
        assert found.status is Status.OK, name


def test_a_record_that_ends_while_loading() -> None:
    """Not where the rig's stroke ends; without times its rows are named."""
    _, results = pulled(*pull(), results=["peak-force"], time=False)
    why = "partial_cycle: the record ends at sample 1000, while still loading"
    assert results["peak_force.1"].why == why
    specimen = "{length: 100 mm}\nrig: {stroke: 20 mm}"
    _, results = pulled(*pull(), results=["peak-force"], specimen=specimen)
    assert results["peak_force.1"].status is Status.OK
    _, results = pulled(*pull(), curve=BREAK, results=["failure", "energy-to-break"])
    for result in results.values():
        assert result.why.startswith("no_break: the force ends at 99.9")
