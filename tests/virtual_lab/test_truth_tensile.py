"""The truth agrees with the path it is told of, by differences and integrals made here."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.virtual_lab.observations import observe
from labpipe.virtual_lab.tensile_path import TensilePath
from labpipe.virtual_lab.tensile_scenarios import (
    GIVE,
    TABLE_2_3,
    GripSlip,
    TensileScenario,
    corrugated_tube,
    pet_tape,
    stiff_bar,
    twist_tube,
)
from labpipe.virtual_lab.truth import SlipTruth, TensileTruth, in_series


def truth_of(scenario: TensileScenario) -> TensileTruth:
    return observe(scenario, 1).truth


def line(truth: TensileTruth, start: float, stop: float) -> np.polynomial.Polynomial:
    """Through the true curve between two displacements, as seen at the crosshead."""
    chosen = (truth.displacement > start) & (truth.displacement < stop)
    return np.polynomial.Polynomial.fit(
        truth.displacement[chosen], truth.force[chosen], 1
    ).convert()


@pytest.mark.parametrize(
    ("scenario", "first", "second"),
    [
        (twist_tube("1a"), (2e-3, 8e-3), (10e-3, 20e-3)),
        (pet_tape("1"), (2e-3, 5.5e-3), (12e-3, 50e-3)),
        (corrugated_tube("CT-10-1"), (1e-3, 10e-3), (30e-3, 49e-3)),
    ],
    ids=lambda case: getattr(case, "name", ""),
)
def test_stiffness_and_break_point(
    scenario: TensileScenario, first: tuple[float, float], second: tuple[float, float]
) -> None:
    truth = truth_of(scenario)
    one, two = line(truth, *first), line(truth, *second)
    assert one.deriv()(0.0) == pytest.approx(truth.stiffness_first, rel=1e-6)
    assert two.deriv()(0.0) == pytest.approx(truth.stiffness_second, rel=1e-6)
    assert one.roots()[0] == pytest.approx(truth.foot, abs=1e-9)
    assert truth.break_point is not None
    assert (one - two).roots()[0] == pytest.approx(truth.break_point, abs=1e-8)
    assert truth.break_point_from_foot is not None
    assert truth.break_point == pytest.approx(truth.foot + truth.break_point_from_foot)
    assert one(truth.break_point) == pytest.approx(truth.break_force, rel=1e-6)


@pytest.mark.parametrize("sample", TABLE_2_3)
def test_twist_tubes_are_those_of_table_2_3(sample: str) -> None:
    truth = truth_of(twist_tube(sample))
    assert truth.stiffness_first / truth.peak_force == pytest.approx(TABLE_2_3[sample][0], rel=1e-6)
    assert truth.stiffness_second / truth.peak_force == pytest.approx(
        TABLE_2_3[sample][1], rel=1e-6
    )
    assert truth.peak_force == pytest.approx(420.0, rel=1e-6)
    assert truth.failure_force == pytest.approx(420.0, rel=1e-6)
    assert truth.peak_displacement == pytest.approx(truth.failure_displacement)


def test_machine_gives_way() -> None:
    truth = truth_of(pet_tape("1"))
    assert truth.specimen_stiffness_first == 12e3
    assert 1.0 / truth.stiffness_first == pytest.approx(1.0 / 12e3 + GIVE)
    assert in_series(12e3, 0.0) == 12e3


def test_energy_is_the_integral_up_to_failure() -> None:
    truth = truth_of(twist_tube("2a"))
    assert truth.failure_displacement is not None
    assert truth.failure_force is not None
    before = truth.displacement < truth.failure_displacement
    moved = np.append(truth.displacement[before], truth.failure_displacement)
    pulled = np.append(truth.force[before], truth.failure_force)
    assert truth.energy_to_break == pytest.approx(np.trapezoid(pulled, moved), rel=1e-5)


def test_no_failure_is_said() -> None:
    truth = truth_of(corrugated_tube("CT-10-1"))
    assert truth.failure_displacement is truth.failure_force is truth.energy_to_break is None
    assert truth.peak_displacement == pytest.approx(50e-3)


def test_stiff_bar_tells_the_give_of_the_frame() -> None:
    truth = truth_of(stiff_bar())
    assert truth.break_point is truth.break_point_from_foot is truth.break_force is None
    slope = line(truth, 0.05e-3, 0.34e-3).deriv()(0.0)
    assert 1.0 / slope == pytest.approx(GIVE + 1.0 / 1.55e8, rel=1e-4)


def test_peak_before_a_slip() -> None:
    slips = (GripSlip(49.9e-3, 2.0),)
    scenario = replace(corrugated_tube("CT-10-1"), slips=slips)
    truth = truth_of(scenario)
    assert truth.slips == (SlipTruth(49.9e-3, 2.0),)
    assert truth.peak_displacement == pytest.approx(49.9e-3, abs=1e-6)
    whole = TensilePath(replace(scenario, slips=()))
    time = np.array([49.9e-3 / scenario.frame.speed])
    assert truth.peak_force == pytest.approx(whole.force(time)[0], rel=1e-6)
