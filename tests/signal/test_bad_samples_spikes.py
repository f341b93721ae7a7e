"""Stray samples: spikes and dropouts that return, and what is none."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.signal.bad_samples import bridge_spikes, find_spikes

D = np.linspace(0.0, 0.04, 401)
RISE = 9000.0 * D + np.random.default_rng(0).normal(0.0, 0.5, len(D))


def test_spike_and_dropouts_are_found() -> None:
    force = RISE.copy()
    force[100] = 1200.0
    force[200:203] = 0.0
    force[50] = np.nan
    assert find_spikes(force).tolist() == [100, 200, 201, 202]


@pytest.mark.parametrize("seed", range(5))
def test_what_is_none(seed: int) -> None:
    noise = np.random.default_rng(seed).normal(0.0, 0.5, len(D))
    broken = np.where(D < 0.03, 9000.0 * D, 3.0)
    turned = 9000.0 * np.where(D < 0.02, D, 0.04 - D)
    stepped = 9000.0 * D - 30.0 * (D > 0.02)
    dropout = np.where((D > 0.02) & (D < 0.0205), 0.0, 9000.0 * D)  # four samples and more
    for force in (9000.0 * D, broken, turned, stepped, dropout, np.round(9000.0 * D / 2.0) * 2.0):
        assert find_spikes(force + noise).tolist() == []
    assert find_spikes(turned).tolist() == []


def test_ends_and_few_samples() -> None:
    force = RISE.copy()
    force[[0, -1]] = 1200.0
    assert find_spikes(force).tolist() == []
    assert find_spikes(RISE[:13]).tolist() == []


def test_strays_are_bridged_over_missing_samples_too() -> None:
    force = np.array([0.0, 1.0, 90.0, np.nan, 4.0, 5.0])
    mended = bridge_spikes(force, np.array([2]))
    np.testing.assert_allclose(mended, [0.0, 1.0, 2.0, np.nan, 4.0, 5.0])
    assert force[2] == 90.0
    np.testing.assert_array_equal(bridge_spikes(force, np.array([], dtype=np.int64)), force)


@pytest.mark.parametrize(("above", "is_spike"), [(4.0, False), (5.0, True), (40.0, True)])
def test_a_spike_is_larger_than_four_steps_of_its_neighbours(
    above: float, *, is_spike: bool
) -> None:
    """There is no force but a step of one newton and back just before it."""
    force = np.zeros(60)
    force[[28, 30]] = 1.0, above
    assert find_spikes(force).tolist() == ([30] if is_spike else [])


@pytest.mark.parametrize(("behind", "is_spike"), [(8.5, True), (7.5, False)])
def test_the_force_comes_back_from_a_spike(behind: float, *, is_spike: bool) -> None:
    """From 10 N over 14 N to less: it may lose half of the 4 N, else it is a loss of force."""
    force = np.where(np.arange(60) < 30, 10.0, behind)
    force[30] = 14.0
    assert find_spikes(force).tolist() == ([30] if is_spike else [])
