"""The force at every instant, checked by differences and by what must hold whatever the law."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.virtual_lab.tensile_path import (
    TensilePath,
    loading_force,
    rounded_ramp,
    specimen_force,
)
from labpipe.virtual_lab.tensile_scenarios import (
    GIVE,
    BilinearLaw,
    GripSlip,
    corrugated_tube,
    pet_tape,
    twist_tube,
)

LAW = BilinearLaw(2e3, 0.5e3, 10e-3, knee=4e-3, slack=1e-3, toe=0.6e-3)


def test_ramp_is_the_integral_of_its_slope() -> None:
    distance = np.linspace(-3.0, 3.0, 6001)
    slope = np.clip((distance + 1.0) / 2.0, 0.0, 1.0)
    steps = 0.5 * (slope[1:] + slope[:-1]) * np.diff(distance)
    integral = np.concatenate([[0.0], np.cumsum(steps)])
    np.testing.assert_allclose(rounded_ramp(distance, 2.0), integral, atol=1e-12)


def test_sharp_ramp() -> None:
    np.testing.assert_array_equal(rounded_ramp(np.array([-1.0, 0.0, 2.0]), 0.0), [0.0, 0.0, 2.0])


def test_law_is_slack_then_two_straight_lines() -> None:
    distance = np.linspace(0.0, 30e-3, 30_001)
    force = specimen_force(LAW, distance)
    slope = np.gradient(force, distance)
    np.testing.assert_allclose(force[distance <= 1e-3], 0.0, atol=1e-20)
    first = (distance > 1.61e-3) & (distance < 9.29e-3)
    second = distance > 13.31e-3
    np.testing.assert_allclose(slope[first], 2e3, rtol=1e-9)
    np.testing.assert_allclose(slope[second], 0.5e3, rtol=1e-9)
    assert np.all(np.diff(slope[distance > 2e-3]) < 1e-6)  # softens, nowhere stiffens again


def test_lines_cross_at_foot_and_break_point() -> None:
    on_first, on_second = np.array([3e-3, 8e-3]), np.array([15e-3, 25e-3])
    first = np.polynomial.Polynomial.fit(on_first, specimen_force(LAW, on_first), 1).convert()
    second = np.polynomial.Polynomial.fit(on_second, specimen_force(LAW, on_second), 1).convert()
    assert first.roots()[0] == pytest.approx(1.3e-3)
    assert (first - second).roots()[0] == pytest.approx(1.3e-3 + 10e-3)


def test_series_with_the_machine() -> None:
    displacement = np.linspace(0.0, 30e-3, 301)
    compliance = 5e-5  # a machine as soft as a tenth of the specimen
    force = loading_force(LAW, compliance, displacement)
    alone = specimen_force(LAW, displacement - compliance * force)
    np.testing.assert_allclose(force, alone, atol=1e-7)


def test_slip_goes_on_parallel_and_lower() -> None:
    usual = corrugated_tube("CT-10-slit-1")
    slips = (GripSlip(18.75e-3, 0.47, 0.05), GripSlip(30.85e-3, 0.81, 0.1))
    whole, slipped = TensilePath(usual), TensilePath(replace(usual, slips=slips))
    time = np.linspace(0.0, whole.last_time, 100_001)
    lost = whole.force(time) - slipped.force(time)
    moved = whole.displacement(time)
    np.testing.assert_allclose(lost[moved < 18.75e-3], 0.0, atol=1e-12)
    between = (moved > 18.75e-3 + 0.051 * 0.423e-3) & (moved < 30.85e-3)
    np.testing.assert_allclose(lost[between], 0.47, atol=1e-12)
    np.testing.assert_allclose(lost[moved > 30.85e-3 + 0.101 * 0.423e-3], 1.28, atol=1e-12)


def test_failure_takes_its_time_and_leaves_fibres() -> None:
    path = TensilePath(pet_tape("1", fails_at=60e-3))
    before, after, late = path.force(path.last_time + np.array([-1e-9, 0.15, 2.3]))
    at_failure = path.force(np.array([path.last_time]))[0]
    assert before == pytest.approx(at_failure, rel=1e-6)
    assert after == pytest.approx(0.06 * at_failure * np.exp(-0.15 / 1.2))
    assert 0.0 < late < 0.01 * at_failure
    during = path.force(path.last_time + np.linspace(0.0, 2.3, 500))
    assert np.all(np.diff(during) < 0.0)


def test_crosshead_runs_on_after_failure() -> None:
    path = TensilePath(twist_tube("1a"))
    end = path.displacement(np.array([path.end, path.end + 1.0]))
    np.testing.assert_allclose(end, path.scenario.last_displacement + 0.31 * 5e-3)


def test_without_failure_it_stands_at_full_stroke() -> None:
    path = TensilePath(corrugated_tube("CT-10-1"))
    held = np.array([path.last_time, path.end])
    np.testing.assert_allclose(path.displacement(held), 50e-3)
    assert path.force(held)[0] == path.force(held)[1] > 45.0


def test_unloading_starts_at_the_peak_with_the_first_stiffness_and_ends_slack() -> None:
    usual = corrugated_tube("CT-10-3")
    path = TensilePath(replace(usual, frame=replace(usual.frame, unloads=True)))
    turn = path.last_time + usual.frame.overrun
    time = np.linspace(turn, path.end, 20_001)
    force, displacement = path.force(time), path.displacement(time)
    assert force[0] == pytest.approx(path.force(np.array([path.last_time]))[0])
    assert displacement[-1] == pytest.approx(0.0, abs=1e-12)
    assert np.all(np.diff(force) <= 1e-12)
    slope = (force[0] - force[100]) / (displacement[0] - displacement[100])
    assert slope == pytest.approx(usual.law.stiffness_first, rel=1e-6)
    assert 5e-3 < displacement[np.argmax(force == 0.0)] < 30e-3
    assert force[-1] == 0.0


def test_unloading_gives_back_the_machines_give() -> None:
    usual = corrugated_tube("CT-10-3")
    frame = replace(usual.frame, unloads=True, compliance=100 * GIVE)
    path = TensilePath(replace(usual, frame=frame))
    turn = path.last_time + frame.overrun
    time = np.array([turn, turn + 1.0])
    slope = np.diff(path.force(time))[0] / np.diff(path.displacement(time))[0]
    k = usual.law.stiffness_first
    assert slope == pytest.approx(k / (1.0 + k * 100 * GIVE), rel=1e-4)
