"""Largest force and displacement of a cycle: which sample, and how far it is known."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.records.result import Result, Status
from labpipe.results.cycles import PeakForce
from labpipe.results.kinds import to_result
from tests.builders.reduced import loop, reduced

PEAKS = "results:\n  - {result: peak-force}\n  - {result: peak-displacement}\n"


def peaks(time: np.ndarray, path: np.ndarray, force: np.ndarray) -> dict[str, Result]:
    return reduced(time, path, force, more=PEAKS)[1]


def test_the_largest_sample_of_each_cycle_in_the_sense_of_loading() -> None:
    time, path, force = loop(noise=1e-3)
    for sense in (1.0, -1.0):
        found = peaks(time, sense * path, sense * force)
        for name, values in (("peak_force", force), ("peak_displacement", path)):
            first = values[time < 22.0].max()
            assert found[f"{name}.1"].value == pytest.approx(sense * first, abs=1e-12)


@pytest.mark.slow
def test_the_largest_of_many_noisy_samples_is_held_by_its_interval() -> None:
    held = 0
    for seed in range(40):
        interval = peaks(*loop(cycles=1, noise=5e-3, seed=seed))["peak_force.1"].interval
        assert interval is not None
        held += interval.lower <= 1.0 <= interval.upper
    assert held >= 34


def test_zero_and_scale_come_on_top() -> None:
    """1 % of scale, of 1 N."""
    test, found = reduced(*loop(noise=1e-4))
    budget = {each.cause: each.change for each in found["peak_force.1"].budget}
    assert budget["scale of the force"] == pytest.approx(0.01, rel=0.01)
    zero = budget.get("zero of the force", 0.0)
    assert zero == pytest.approx(test.raw_force.zero_error, rel=1e-6)
    assert budget["noise"] < 0.001


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
