from __future__ import annotations

import numpy as np
import pytest

from labpipe.records.result import Status
from tests.builders.doubts import doubted
from tests.builders.reduced import loop, reduced

PULLED = "results:\n  - {result: peak-force}\n  - {result: peak-displacement}\n"
FAILURE = (
    "displacement: displacement}",
    "displacement: displacement, failure: {force_below: 50 %}}",
)

NOISE = 0.005


@pytest.mark.parametrize("noise", [0.0, NOISE])
def test_a_test_whose_zero_stays(noise: float) -> None:
    assert not doubted(reduced(*loop(noise=noise))[0])


@pytest.mark.parametrize("size", [0.1, -0.1])
def test_a_force_that_jumps_is_doubted_from_there_on(size: float) -> None:
    """A tenth of the peak, in the second unloading."""
    time, path, force = loop(noise=NOISE)
    test, results = reduced(time, path, force + np.where(time > 35.0, size, 0.0))
    assert doubted(test)["force"].startswith("zero_jump: the force jumps by ")
    assert results["peak_force.1"].status is Status.OK
    assert results["energy.1"].status is Status.OK
    assert results["energy.2"].status is Status.DOUBTFUL


def test_a_specimen_that_loses_force_while_it_is_loaded_may_slip() -> None:
    time, path, force = loop(cycles=1)
    test, _ = reduced(time, path, force - np.where((time > 8.0) & (time < 12.0), 0.05, 0.0))
    assert "zero_jump" not in str(test.findings.doubts)


@pytest.mark.parametrize(("drift", "is_seen"), [(0.1, True), (-0.1, True), (0.01, False)])
def test_a_zero_that_drifts(drift: float, is_seen: bool) -> None:
    time, path, force = loop(noise=NOISE)
    test, results = reduced(time, path, force + drift * time / time[-1])
    assert ("zero_drift" in str(test.findings.doubts)) is is_seen
    assert (results["energy.2"].status is Status.DOUBTFUL) is is_seen
    assert results["peak_displacement.1"].status is Status.OK


def test_a_crosshead_zeroed_in_mid_record() -> None:
    time, path, force = loop(noise=NOISE)
    test, results = reduced(time, path + np.where(time < 1.0, 0.05, 0.0), force)
    assert "zeroed in mid-record" in doubted(test)["displacement"]
    assert results["peak_force.1"].status is Status.DOUBTFUL


@pytest.mark.parametrize(
    ("left", "is_seen"), [(-0.06, True), (-0.02, False), (0.0, False), (0.06, False)]
)
def test_the_force_once_the_specimen_is_broken(left: float, is_seen: bool) -> None:
    time = np.arange(0.0, 12.0, 0.02)
    force = np.where(time < 10.0, 0.1 * time, left)
    force += np.random.default_rng(0).normal(0.0, 1e-3, len(time))
    test, results = reduced(time, 1e-3 * time, force, more=PULLED, replaced=FAILURE)
    assert ("zero_drift" in str(test.findings.doubts)) is is_seen
    assert (results["peak_force.1"].status is Status.DOUBTFUL) is is_seen
    if is_seen:
        assert "once the specimen is broken, 6% of its peak below zero" in doubted(test)["force"]


def test_a_rebound_is_no_zero() -> None:
    time = np.arange(0.0, 10.1, 0.02)
    force = np.where(time < 10.0, 0.1 * time, -0.2)
    test, _ = reduced(time, 1e-3 * time, force, more=PULLED, replaced=FAILURE)
    assert "zero_drift" not in str(test.findings.doubts)
