"""Stray samples and channels that repeat a number, and what is neither."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.records.arrays import Floats
from labpipe.signal.bad_samples import Stuck, bridge_spikes, find_spikes, stuck_runs
from tests.builders.plain_records import PlainRecord, up_and_down

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


def seen(record: PlainRecord) -> list[Stuck]:
    return stuck_runs(record.time, record.force, record.displacement)


def full(record: PlainRecord, level: float) -> PlainRecord:
    np.minimum(record.force, level, out=record.force)
    return record


NOISE = [0.0, 1e-3]


@pytest.mark.parametrize("noise", NOISE)
@pytest.mark.parametrize("is_round", [False, True])
@pytest.mark.parametrize("level", [0.2, 0.5, 0.9])
@pytest.mark.parametrize("rate", [50.0, 1000.0])
def test_a_full_channel(noise: float, is_round: bool, level: float, rate: float) -> None:
    record = full(up_and_down(rate=rate, is_round=is_round, noise=noise), level)
    found = seen(record)
    assert {run.is_end for run in found} == {True}
    assert {float(record.force[run.start]) for run in found} == {level}
    long = [run for run in found if run.stop - run.start > 0.2 * rate]
    assert len(long) == 2


def test_nothing_is_wrong() -> None:
    for rate in (10.0, 50.0, 500.0):
        for noise in (0.0, 1e-4, 1e-2):
            record = up_and_down(rate=rate, noise=noise)
            assert not seen(record)
            assert not stuck_runs(record.time, record.displacement, record.force)


def held(rate: float, step: float, noise: float) -> PlainRecord:
    """Up in 5 s, standing for 5 s, and down; force in steps of a resolution."""
    time: Floats = np.arange(0.0, 17.0, 1.0 / rate)
    share = np.interp(time, [1.0, 6.0, 11.0, 16.0], [0.0, 1.0, 1.0, 0.0])
    share += noise * np.random.default_rng(2).normal(size=len(time))
    force = np.round(share / step) * step if step else share
    return PlainRecord(time, 0.01 * share, np.asarray(force, dtype=np.float64))


@pytest.mark.parametrize("rate", [10.0, 100.0])
@pytest.mark.parametrize("step", [0.0, 1e-3, 0.02])
@pytest.mark.parametrize("noise", [0.0, 2e-4])
def test_a_machine_that_stands(rate: float, step: float, noise: float) -> None:
    record = held(rate, step, noise)
    assert not seen(record)
    assert not stuck_runs(record.time, record.displacement, record.force)


@pytest.mark.parametrize("noise", NOISE)
@pytest.mark.parametrize("since", [3.0, 5.5, 7.5, 9.0])
def test_a_frozen_force(noise: float, since: float) -> None:
    record = up_and_down(noise=noise)
    still = (record.time > since) & (record.time < since + 2.5)
    record.force[still] = record.force[still][0]
    (run,) = seen(record)
    first, last = np.flatnonzero(still)[[0, -1]]
    assert abs(run.start - first) <= 1
    assert run.stop == last + 1
    if noise:  # which needs no other channel
        assert stuck_runs(record.time, record.force) == [run]


def test_a_channel_that_is_blank_or_constant() -> None:
    time: Floats = np.arange(50.0)
    assert not stuck_runs(time, np.full(50, np.nan))
    assert not stuck_runs(time, np.ones(50), time)
    assert not stuck_runs(time[:0], time[:0])
    every_other = np.where(np.arange(50) % 2 == 0, time, np.nan)
    assert not stuck_runs(time, every_other, time)
    gaps = np.sin(time)
    gaps[10:20] = np.nan
    assert not stuck_runs(time, gaps, time)


def test_a_channel_that_is_full_soon_after_it_begins_and_blank_at_its_end() -> None:
    """Six samples up, twenty full, twelve down, and then the logger wrote nothing."""
    rise, fall = 0.1 * np.arange(6.0), 0.05 * np.arange(12.0)[::-1]
    force = np.concatenate([rise, np.full(20, 0.6), fall, np.full(5, np.nan)])
    time = np.arange(float(len(force)))
    assert stuck_runs(time, force, 1e-3 * time) == [Stuck(6, 26, is_end=True)]


@pytest.mark.parametrize(("samples", "is_found"), [(5, False), (6, True)])
def test_a_frozen_channel_jumps_faster_than_five_times_its_speed(
    samples: int, *, is_found: bool
) -> None:
    """A newton a sample; after so many equal samples it jumps by as many newtons."""
    force = np.arange(100.0)
    force[50 : 50 + samples] = 50.0
    found = stuck_runs(np.arange(100.0), force, 1e-3 * np.arange(100.0))
    assert found == ([Stuck(50, 50 + samples, is_end=False)] if is_found else [])


@pytest.mark.parametrize("since", [3.0, 9.0, 14.0])
def test_a_few_equal_samples_in_noise_are_chance(since: float) -> None:
    """Nine in a row; ten are the fewest that no logger repeats."""
    record = up_and_down(rate=1000.0, noise=1e-2)
    at = int(np.searchsorted(record.time, since))
    record.force[at : at + 9] = record.force[at]
    assert not seen(record)


@pytest.mark.parametrize("step", [0.005, 0.02, 0.05])
def test_coarse_steps_and_a_plateau(step: float) -> None:
    """A round top and a yield plateau stand on one step of the resolution for long."""
    time: Floats = np.arange(0.0, 20.0, 0.02)
    top = 1.0 - ((time - 10.0) / 10.0) ** 2
    plateau = 1.0 - np.exp(-time)
    for force in (top, plateau):
        assert not stuck_runs(time, np.round(force / step) * step, 1e-3 * time)
