"""Displacement left at zero force: after slack, beyond zero, and where zero is not reached."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.fits.loops import residual_after_unloading
from labpipe.records.arrays import Floats
from labpipe.records.estimates import Estimate, Failure

LEFT = 0.01


def value(found: Estimate | Failure) -> Estimate:
    assert isinstance(found, Estimate), found
    return found


def unloading(*, slack: bool, noise: float, seed: int = 0) -> tuple[Floats, Floats, Floats]:
    """Force falls to zero at 12 mm; then the string is slack, or the force goes negative."""
    time = np.arange(0.0, 53.0, 0.02)
    path = 0.053 - 1e-3 * time
    force = (path - 0.012) / 0.041
    if slack:
        path, force = np.maximum(path, 0.012), np.maximum(force, 0.0)
    rng = np.random.default_rng(seed)
    return time, path + rng.normal(0, 5 * noise, len(time)), force + rng.normal(0, noise, len(time))


@pytest.mark.parametrize("slack", [True, False])
def test_residual_is_where_the_force_is_back_at_zero(slack: bool) -> None:
    pulls = []
    for seed in range(150):
        parts = unloading(slack=slack, noise=2e-4, seed=seed)
        parts = (parts[0], 0.012 + (parts[1] - 0.012) / 10.0 if slack else parts[1], parts[2])
        found = value(residual_after_unloading(*parts, force_below=5e-3))
        assert found.value == pytest.approx(0.012, abs=1e-3)
        pulls.append((found.value - 0.012) / found.error)
    assert np.std(pulls) < 1.3


def test_residual_holds_when_the_string_is_slack_only_for_a_moment() -> None:
    """A quick test: half a second of slack after a fall at 4 mm/s."""
    time = np.arange(0.0, 3.0, 0.02)
    path = np.maximum(0.0107 - 4e-3 * time, 0.0007)
    force = 20.0 * (path - 0.0007)
    found = value(residual_after_unloading(time, path, force, force_below=5e-3))
    assert found.value == pytest.approx(0.0007, abs=1e-5)
    brief = time < 2.7
    found = value(
        residual_after_unloading(time[brief], path[brief], force[brief], force_below=5e-3)
    )
    assert found.value == pytest.approx(0.0007, abs=5e-5)


def test_residual_is_not_extrapolated() -> None:
    time, path, force = unloading(slack=False, noise=0.0)
    found = residual_after_unloading(time[:1500], path[:1500], force[:1500], force_below=5e-3)
    assert isinstance(found, Failure)
    assert found.code == "force_not_zero"
    assert "above the limit of 0.005 N" in found.message


def weak(seed: int, *, zero: float = 0.0, late: float = 0.0) -> tuple[Floats, Floats, Floats]:
    """A curved foot of 22 mN at the most that goes through zero at 10 mm, 1 mm/s."""
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, 53.0, 0.02)
    path = 0.053 - 1e-3 * time
    beyond = path + 1e-3 * late - LEFT
    force = 0.27 * beyond + 5.5 * beyond**2 + zero
    noise = np.convolve(rng.normal(0, 2e-4, len(time) + 4), np.full(5, 0.2), mode="valid")
    return time, path + rng.normal(0, 1e-5, len(time)), force + noise


def test_a_weak_force_is_not_followed_from_far_off() -> None:
    """A straight line from 25 mN to 5 mN would end at 20 mm."""
    pulls = []
    for seed in range(150):
        found = value(residual_after_unloading(*weak(seed), force_below=5e-3))
        assert found.value == pytest.approx(LEFT, abs=4e-4)
        pulls.append((found.value - LEFT) / found.error)
    assert np.mean(np.abs(pulls) < 1.96) > 0.9
    assert abs(np.mean(pulls)) < 0.3


def test_zero_and_clock_are_in_the_error() -> None:
    """0.05 mN over 0.27 N/m, and 0.2 s at 1 mm/s."""
    alone = value(residual_after_unloading(*weak(1), force_below=5e-3))
    zeroed = value(residual_after_unloading(*weak(1), force_below=5e-3, zero_error=5e-5))
    timed = value(residual_after_unloading(*weak(1), force_below=5e-3, clock_error=0.2))
    moved = value(residual_after_unloading(*weak(1, zero=5e-5), force_below=5e-3))
    late = value(residual_after_unloading(*weak(1, late=0.2), force_below=5e-3))
    added = [np.sqrt(each.error**2 - alone.error**2) for each in (zeroed, timed)]
    changed = [abs(each.value - alone.value) for each in (moved, late)]
    assert added == pytest.approx([5e-5 / 0.27, 2e-4], rel=0.05)
    assert changed == pytest.approx(added, rel=0.1)


def test_a_curved_foot_is_in_the_error() -> None:
    """A string that gets slack at once, and a displacement that goes on."""
    time = np.arange(0.0, 53.0, 0.02)
    path = 0.053 - 1e-3 * time
    beyond = np.maximum(path - LEFT, 0.0)
    force = 5.0 * beyond + 400.0 * beyond**2
    straight = value(
        residual_after_unloading(time, path, 24.0 * (path - LEFT).clip(0.0), force_below=5e-3)
    )
    bent = value(residual_after_unloading(time, path, force, force_below=5e-3))
    assert straight.error < 1e-6
    assert abs(bent.value - LEFT) < 1.96 * bent.error < 1e-3


def test_a_weak_force_that_does_not_come_back_is_no_zero() -> None:
    """4 mN are below the limit of the protocol, but a fifth of what the specimen bore."""
    time, path, force = weak(1)
    kept = path > LEFT + 0.012
    found = residual_after_unloading(time[kept], path[kept], force[kept], force_below=5e-3)
    assert isinstance(found, Failure)
    assert found.code == "force_not_zero"
    assert found.message.startswith("the force ends at 0.004")


def test_too_few() -> None:
    few = np.linspace(0.0, 1.0, 10)
    found = residual_after_unloading(few, few, 1.0 - few, force_below=5e-3)
    assert found == Failure("too_few_samples", "10 samples, 16 are needed")
    many = np.linspace(0.0, 1.0, 40)
    noise = np.tile([0.01, -0.01], 20)
    found = residual_after_unloading(many, many, noise, force_below=5e-3)
    assert found == Failure("too_few_samples", "40 samples, none above 0.04322 N")
