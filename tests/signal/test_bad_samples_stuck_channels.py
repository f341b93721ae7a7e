"""Channels that repeat a number: told from machines that stand and from coarse steps."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.records.arrays import Floats
from labpipe.signal.bad_samples import Stuck, stuck_runs
from tests.builders.plain_records import PlainRecord, up_and_down


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


@pytest.mark.parametrize("samples", [8, 12, 20])
@pytest.mark.parametrize("level", [0.4, 0.7])
def test_a_full_channel_of_few_samples(samples: int, level: float) -> None:
    record = full(up_and_down(rate=10.0, rest=0.37, branch=samples / 10.0, noise=0.0), level)
    assert len(seen(record)) == 2


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_at_either_end(sense: float) -> None:
    record = full(up_and_down(noise=0.0), 0.6)
    assert len(stuck_runs(record.time, sense * record.force, record.displacement)) == 2
    assert len(stuck_runs(record.time, record.force, -record.displacement)) == 2


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


def test_a_displacement_held_while_the_force_relaxes() -> None:
    record = held(10.0, 0.0, 0.0)
    late = np.clip(record.time - 6.0, 0.0, 5.0)
    record.force[:] *= 0.5 + 0.5 * np.exp(-late)
    assert not stuck_runs(record.time, record.displacement, record.force)


@pytest.mark.parametrize("step", [0.005, 0.02, 0.05])
def test_coarse_steps_and_a_plateau(step: float) -> None:
    """A round top and a yield plateau stand on one step of the resolution for long."""
    time: Floats = np.arange(0.0, 20.0, 0.02)
    top = 1.0 - ((time - 10.0) / 10.0) ** 2
    plateau = 1.0 - np.exp(-time)
    for force in (top, plateau):
        assert not stuck_runs(time, np.round(force / step) * step, 1e-3 * time)


def test_slack_and_what_is_left_of_a_break() -> None:
    time: Floats = np.arange(0.0, 20.0, 0.02)
    force = np.where(time < 12.0, np.clip(time - 5.0, 0.0, None), 0.0)
    assert not stuck_runs(time, force, 1e-3 * time)


def test_a_yarn_that_tears_in_steps() -> None:
    time: Floats = np.arange(0.0, 20.0, 0.02)
    force = np.where(time < 10.0, time, 10.0 - 1.5 * np.floor(np.clip(time - 9.0, 0.0, 6.0)))
    assert not stuck_runs(time, force, 1e-3 * time)


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


@pytest.mark.parametrize("since", [3.0, 5.5, 9.0])
def test_a_frozen_displacement(since: float) -> None:
    record = up_and_down(noise=0.0)
    still = (record.time > since) & (record.time < since + 2.5)
    record.displacement[still] = record.displacement[still][0]
    assert len(stuck_runs(record.time, record.displacement, record.force)) == 1


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
