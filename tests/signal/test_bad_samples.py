"""Spikes and channels that repeat a value."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.records.arrays import Floats
from labpipe.signal.bad_samples import (
    StuckRun,
    _compute_longest_noise_run,
    bridge_spikes,
    find_spikes,
    find_stuck_runs,
)
from tests.builders.plain_records import PlainRecord, up_and_down

RNG = np.random.default_rng

D = np.linspace(0.0, 0.04, 401)
RISE = 9000.0 * D + np.random.default_rng(0).normal(0.0, 0.5, len(D))


def test_spike_and_dropouts_are_found() -> None:
    force = RISE.copy()
    force[100] = 1200.0
    force[200:203] = 0.0
    force[50] = np.nan
    for unit in (1.0, 1e-6):
        assert find_spikes(unit * force).tolist() == [100, 200, 201, 202]
    force[102] = 1200.0  # each has the other one among its neighbours
    assert find_spikes(force).tolist() == [200, 201, 202]
    ends = RISE.copy()
    ends[[0, -1]] = 600.0
    assert find_spikes(ends).tolist() == find_spikes(RISE[:13]).tolist() == []
    ends[[0, -1]] = 1200.0
    assert find_spikes(ends).tolist() == [0, len(RISE) - 1]


@pytest.mark.parametrize("seed", range(5))
def test_no_spike_in_a_sound_signal(seed: int) -> None:
    noise = np.random.default_rng(seed).normal(0.0, 0.5, len(D))
    broken = np.where(D < 0.03, 9000.0 * D, 3.0)
    turned = 9000.0 * np.where(D < 0.02, D, 0.04 - D)
    stepped = 9000.0 * D - 30.0 * (D > 0.02)
    dropout = np.where((D > 0.02) & (D < 0.0205), 0.0, 9000.0 * D)  # four samples and more
    for force in (9000.0 * D, broken, turned, stepped, dropout, np.round(9000.0 * D / 2.0) * 2.0):
        assert find_spikes(force + noise).tolist() == []
    assert find_spikes(turned).tolist() == []


def test_spikes_are_bridged_across_gaps() -> None:
    force = np.array([0.0, 1.0, 90.0, np.nan, 4.0, 5.0])
    bridged = bridge_spikes(force, np.array([2]))
    np.testing.assert_allclose(bridged, [0.0, 1.0, 2.0, np.nan, 4.0, 5.0])
    assert force[2] == 90.0
    np.testing.assert_array_equal(bridge_spikes(force, np.array([], dtype=np.int64)), force)


def test_size_and_return_of_a_spike() -> None:
    """More than four steps of its neighbours, of one newton; a lasting drop is a loss of force."""
    for force, top, after, is_spike in (
        *((0.0, 4.0, 0.0, False), (0.0, 5.0, 0.0, True), (0.0, 40.0, 0.0, True)),
        *((10.0, 14.0, 8.5, True), (10.0, 14.0, 7.5, False)),
    ):
        values = np.where(np.arange(60) < 30, force, after)
        values[[28, 30]] = force + 1.0 if force == 0.0 else force, top
        assert find_spikes(values).tolist() == ([30] if is_spike else [])


@pytest.mark.parametrize("height", [2.0, 6.0])
def test_a_step_of_a_coarse_converter_is_no_spike(height: float) -> None:
    """Noise of a fifth of a step changes between two levels, each 2 % of the range."""
    force = np.linspace(0.0, 50.0, 5000) + RNG(0).normal(0.0, 0.2, 5000)
    coarse = np.round(force)
    coarse[2520] += height
    assert find_spikes(coarse).tolist() == ([2520] if height > 2.0 else [])


def test_how_long_noise_of_a_converter_stays_on_one_value() -> None:
    """Neighbours of deviation s in steps of r are equal with a chance of r / (2 sqrt(pi) s)."""
    values = np.round(RNG(0).normal(0.0, 1.0, 40_000) / 0.33) * 0.33
    equal = np.mean(np.diff(values) == 0.0)
    assert equal == pytest.approx(0.165 / np.sqrt(np.pi), rel=0.05)
    longest = _compute_longest_noise_run(values, len(values), 0.33)
    assert longest == pytest.approx(1.0 + np.log(1e-6 / 40_000) / np.log(equal), rel=0.02)
    assert _compute_longest_noise_run(values, len(values), 2.0) == np.inf


def runs_of(record: PlainRecord) -> list[StuckRun]:
    """Wherever the other quantity has its zero."""
    runs = find_stuck_runs(record.time, record.force, record.displacement)
    assert find_stuck_runs(record.time, record.force, record.displacement + 0.05) == runs
    return runs


NOISE = [0.0, 1e-3]


@pytest.mark.parametrize("noise", NOISE)
@pytest.mark.parametrize("is_round", [False, True])
@pytest.mark.parametrize(("level", "rate"), [(0.2, 1000.0), (0.5, 50.0), (0.9, 50.0)])
def test_a_clipped_channel(noise: float, is_round: bool, level: float, rate: float) -> None:
    record = up_and_down(rate=rate, is_round=is_round, noise=noise)
    np.minimum(record.force, level, out=record.force)
    runs = runs_of(record)
    assert {run.is_clipped for run in runs} == {True}
    assert {float(record.force[run.start]) for run in runs} == {level}
    assert sum(run.stop - run.start > 0.2 * rate for run in runs) == 2


def held(rate: float, step: float, noise: float) -> PlainRecord:
    """Up in 5 s, at rest for 5 s, and down; force in steps of a resolution."""
    time: Floats = np.arange(0.0, 17.0, 1.0 / rate)
    share = np.interp(time, [1.0, 6.0, 11.0, 16.0], [0.0, 1.0, 1.0, 0.0])
    share += noise * np.random.default_rng(2).normal(size=len(time))
    force = np.round(share / step) * step if step else share
    return PlainRecord(time, 0.01 * share, np.asarray(force, dtype=np.float64))


def test_rests_and_coarse_resolutions_are_not_reported() -> None:
    """A round top and a yield plateau remain on one step of the resolution for long."""
    records = [held(100.0, step, noise) for step in (0.0, 1e-3, 0.02) for noise in (0.0, 2e-4)]
    records += [held(10.0, 0.02, 0.0), held(10.0, 0.0, 2e-4)]
    records += [
        up_and_down(rate=rate, noise=noise) for rate in (10.0, 500.0) for noise in (0, 1e-2)
    ]
    time: Floats = np.arange(0.0, 20.0, 0.02)
    for shape in (1.0 - ((time - 10.0) / 10.0) ** 2, 1.0 - np.exp(-time)):
        for step in (0.005, 0.05):
            records.append(PlainRecord(time, 1e-3 * time, np.round(shape / step) * step))
    broken = np.where(time < 18.0, 394.0 - 19.0 * (18.0 - time), 0.0)  # on a step of 10 N
    records.append(PlainRecord(time, 1e-3 * time, np.round(broken / 10.0) * 10.0))
    for record in records:
        assert not runs_of(record)
        assert not find_stuck_runs(record.time, record.displacement, record.force)


@pytest.mark.parametrize("noise", NOISE)
@pytest.mark.parametrize(("since", "goes_on"), [(3.0, 9.0), (7.5, 9.0), (3.0, 0.2)])
def test_a_frozen_force(noise: float, since: float, goes_on: float) -> None:
    record = up_and_down(noise=noise).up_to(since + 2.5 + goes_on)
    still = (record.time > since) & (record.time < since + 2.5)
    record.force[still] = record.force[still][0]
    (run,) = runs_of(record)
    first, last = np.flatnonzero(still)[[0, -1]]
    assert abs(run.start - first) <= 1
    assert run.stop == last + 1
    if noise:  # which needs no other channel
        assert find_stuck_runs(record.time, record.force) == [run]


def test_an_empty_or_constant_channel() -> None:
    time: Floats = np.arange(50.0)
    assert not find_stuck_runs(time, np.full(50, np.nan))
    assert not find_stuck_runs(time, np.ones(50), time)
    assert not find_stuck_runs(time[:0], time[:0])
    every_other = np.where(np.arange(50) % 2 == 0, time, np.nan)
    assert not find_stuck_runs(time, every_other, time)
    gaps = np.sin(time)
    gaps[10:20] = np.nan
    assert not find_stuck_runs(time, gaps, time)


def test_a_channel_clipped_near_its_start_and_empty_at_its_end() -> None:
    """Six samples up, twenty clipped, twelve down, then missing."""
    rise, fall = 0.1 * np.arange(6.0), 0.05 * np.arange(12.0)[::-1]
    force = np.concatenate([rise, np.full(20, 0.6), fall, np.full(5, np.nan)])
    time = np.arange(float(len(force)))
    assert find_stuck_runs(time, force, 1e-3 * time) == [StuckRun(6, 26, is_clipped=True)]


def test_a_frozen_channel_jumps_faster_than_five_times_its_speed() -> None:
    """A newton a sample; after so many equal samples it jumps by as many newtons."""
    for samples, runs in ((5, []), (6, [StuckRun(50, 56, is_clipped=False)])):
        force = np.arange(100.0)
        force[50 : 50 + samples] = 50.0
        assert find_stuck_runs(np.arange(100.0), force, 1e-3 * np.arange(100.0)) == runs


@pytest.mark.parametrize("since", [3.0, 9.0, 14.0])
def test_nine_equal_samples_in_noise_are_not_reported(since: float) -> None:
    """Ten is the limit."""
    record = up_and_down(rate=1000.0, noise=1e-2)
    at = int(np.searchsorted(record.time, since))
    record.force[at : at + 9] = record.force[at]
    assert not runs_of(record)
