"""Failure point, peak before a cliff, energy to break."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.fitting.estimates import Estimate, Failure
from labpipe.fitting.failure import (
    FailurePoint,
    energy_to_break,
    find_failure,
    peak_before_failure,
)
from labpipe.records.arrays import Floats

D = np.linspace(0.0, 0.03, 301)
F = np.where(D <= 0.02, 5000.0 * D, 3.0)


def point(force: Floats) -> FailurePoint:
    found = find_failure(D, force, force_below=0.5)
    assert isinstance(found, FailurePoint)
    return found


def test_last_sample_before_the_loss() -> None:
    found = point(F)
    assert found.sample == 200
    assert found.displacement.value == pytest.approx(0.02)
    assert found.step == pytest.approx(1e-4)
    assert found.force.value == pytest.approx(100.25)


def test_samples_on_the_way_down_and_missing_ones() -> None:
    force = F + np.random.default_rng(0).normal(0, 0.2, len(D))
    force[201], force[202], force[50] = 80.0, 60.0, np.nan
    assert point(force).sample == 200


def test_energy_and_peak() -> None:
    force = F + np.random.default_rng(1).normal(0, 0.2, len(D))
    found = point(force)
    energy, peak = energy_to_break(D, force, found), peak_before_failure(D, force, found)
    assert isinstance(energy, Estimate)
    assert isinstance(peak, Estimate)
    assert energy.value == pytest.approx(1.005, abs=4 * energy.error)
    assert peak.value == pytest.approx(100.25, abs=4 * peak.error)
    assert peak.error < 0.4


def test_peak_inside() -> None:
    force = np.where(D <= 0.02, 100.0 - 2e5 * (D - 0.016) ** 2, 3.0)
    peak = peak_before_failure(D, force, point(force))
    assert isinstance(peak, Estimate)
    assert peak.value == pytest.approx(100.0, rel=1e-9)


def test_says_why_not() -> None:
    held = find_failure(D[:200], F[:200], force_below=0.5)
    assert held == Failure(
        "no_failure", "the force ends at 99.5 N, 100% of its peak 99.5 N; below 50% counts as lost"
    )
    back = np.concatenate([D[:200], D[:200][::-1]])
    unloaded = find_failure(back, 5000.0 * back, force_below=0.5)
    assert isinstance(unloaded, Failure)
    assert unloaded.code == "no_failure"
    assert "the displacement goes back" in unloaded.message
    assert find_failure(D[:9], F[:9], force_below=0.5) == Failure(
        "too_few_samples", "9 samples, 16 are needed"
    )
    early = find_failure(D[:40], np.where(D[:40] < 1e-3, 50.0, 1.0), force_below=0.5)
    assert early == Failure("too_few_samples", "10 samples before the loss of force")


def test_a_gap_leaves_no_energy() -> None:
    force = F.copy()
    force[50] = np.nan
    found = energy_to_break(D, force, point(force))
    assert isinstance(found, Failure)
    assert found.code == "gap"


def test_too_few_before_the_loss_for_a_peak() -> None:
    force = F.copy()
    force[:190] = np.nan
    found = peak_before_failure(D, force, point(F))
    assert found == Failure("too_few_samples", "11 samples before the loss, 12 are needed")


@pytest.mark.parametrize("bad", [{150: 1200.0}, {150: 0.0, 151: 0.0, 152: 0.0}, {198: 1e4}])
def test_a_few_bad_samples_are_no_peak_and_no_loss(bad: dict[int, float]) -> None:
    force = F + np.random.default_rng(0).normal(0, 0.2, len(D))
    clean = energy_to_break(D, force, point(force))
    force[list(bad)] = list(bad.values())
    found = point(force)
    peak, energy = peak_before_failure(D, force, found), energy_to_break(D, force, found)
    assert found.sample == 200
    assert found.force.value == pytest.approx(100.25, abs=0.5)
    assert isinstance(peak, Estimate)
    assert peak.value == pytest.approx(100.25, abs=0.5)
    assert isinstance(energy, Estimate)
    assert isinstance(clean, Estimate)
    assert energy.value == pytest.approx(clean.value, abs=1e-3)


@pytest.mark.parametrize(("force", "most"), [(-F, "0"), (-1.0 - F, "-1"), (0.0 * F, "0")])
def test_no_tension(force: Floats, most: str) -> None:
    assert find_failure(D, force, force_below=0.5) == Failure(
        "no_tension", f"the force is nowhere above zero, at most {most} N"
    )


def test_what_was_lost_before() -> None:
    torn = np.where(D <= 0.012, 5000.0 * D, 5000.0 * D - 30.0)
    noise = np.random.default_rng(3).normal(0, 0.2, len(D))
    twice = np.where(D <= 0.014, torn, torn - 20.0)  # carried 40 N at 14 mm, comes back to 50 N
    for force, share in ((torn, 0.0), (np.where(D <= 0.014, torn, 35.0), 0.5), (twice, 1.0 / 6.0)):
        found = point(np.where(D <= 0.02, force, 3.0) + noise)
        assert found.lost_before == pytest.approx(share, abs=0.5) or share == 0.0
    assert point(F + noise).lost_before == 0.0
