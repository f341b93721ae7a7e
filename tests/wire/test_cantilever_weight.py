"""The wire's own weight: textbooks, a separate solver, and what a wire without it was."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.law.play_fits import polygon_law
from labpipe.law.plays import LinearLaw, MomentLaw
from labpipe.records.arrays import Floats
from labpipe.wire.cantilever import (
    StringRig,
    bend_to_deflection,
    bend_to_travel,
    bend_under_force,
    held_level,
    straight,
)
from labpipe.wire.newton import interpolation_matrix
from tests.builders.cantilevers import WIRE
from tests.judges.reference_wires import YIELD, HeavyWire, Law, yielding

LENGTH = 0.12
KNOTS: Floats = np.geomspace(1e-7, 2e-2, 300)
STRANDED = polygon_law(yielding(KNOTS), KNOTS)


def test_a_slack_wire_hangs_as_the_textbook_says() -> None:
    law, weight = LinearLaw(2e-3), 1e-4
    hanging = bend_under_force(law, straight(law, self_weight=weight), LENGTH, np.zeros(2))
    assert hanging.y[-1] == pytest.approx(-weight * LENGTH**4 / 8.0 / 2e-3, rel=1e-6)
    assert hanging.moment[0] == pytest.approx(-weight * LENGTH**2 / 2.0, rel=1e-6)


def test_a_level_wire_rests_as_the_textbook_says() -> None:
    law, weight = LinearLaw(2e-3), 1e-4
    rest = held_level(law, LENGTH, weight)
    assert rest.force[1] == pytest.approx(3.0 * weight * LENGTH / 8.0, rel=1e-6)
    assert rest.moment[0] == pytest.approx(-weight * LENGTH**2 / 8.0, rel=1e-6)
    assert rest.y.min() == pytest.approx(-weight * LENGTH**4 / 184.6 / 2e-3, rel=1e-3)


@pytest.mark.parametrize(
    ("law", "first"), [(LinearLaw(2e-4), lambda moment: moment / 2e-4), (STRANDED, yielding)]
)
def test_a_separate_solver_finds_the_same_rest_and_loads(law: MomentLaw, first: Law) -> None:
    weight, deflections = 0.097, [0.001, 0.004, 0.02, 0.06]
    other = HeavyWire(first, LENGTH, weight)
    resting = other.rest()
    rest = held_level(law, LENGTH, weight)
    assert rest.force[1] == pytest.approx(other.pull(resting), rel=1e-4)
    state, found = rest.state, resting
    for deflection in deflections:
        shape = bend_to_deflection(law, state, LENGTH, deflection)
        found = other.loaded(resting, deflection, found)
        state = shape.state
        assert shape.force[1] == pytest.approx(other.pull(found), rel=1e-4)


def test_with_the_string_a_separate_solver_finds_the_same() -> None:
    weight, rig = 0.097, StringRig(0.76, 0.0265, LENGTH, 0.76)
    other = HeavyWire(yielding, LENGTH, weight, 0.76, 0.0265)
    resting = other.rest()
    rest = bend_to_travel(STRANDED, straight(STRANDED, self_weight=weight), LENGTH, rig, 0.0)
    assert rest.tension == pytest.approx(other.pull(resting), rel=1e-4)
    state, found = rest.state, resting
    for travel in (0.002, 0.01, 0.03, 0.053):
        shape = bend_to_travel(STRANDED, state, LENGTH, rig, travel)
        found = other.loaded(resting, float(shape.y[-1]), found)
        state = shape.state
        force = other.pull(found) - other.pull(resting)
        assert shape.tension - rest.tension == pytest.approx(force, rel=1e-4)


def test_the_law_goes_on_from_rest_and_not_from_a_straight_wire() -> None:
    rest = held_level(STRANDED, LENGTH, 0.097)
    assert abs(rest.moment[0]) > 0.1 * YIELD
    forgetful = straight(STRANDED, self_weight=0.097)
    loads = [
        float(bend_to_deflection(STRANDED, state, LENGTH, 0.001).force[1])
        for state in (rest.state, forgetful)
    ]
    assert loads[0] > 1.005 * loads[1]


def test_a_wire_without_weight_is_as_before() -> None:
    plain = bend_to_deflection(WIRE, straight(WIRE), LENGTH, 0.05)
    weightless = bend_to_deflection(WIRE, held_level(WIRE, LENGTH, 1e-12).state, LENGTH, 0.05)
    assert weightless.force[1] == pytest.approx(plain.force[1], rel=1e-9)


def test_weight_is_in_balance_with_clamp_and_string() -> None:
    rig = StringRig(0.76, 0.0265, LENGTH, 0.76)
    state = straight(STRANDED, self_weight=0.097)
    shape = bend_to_travel(STRANDED, state, LENGTH, rig, 0.03)
    onto = interpolation_matrix(len(shape.x), np.linspace(0.0, 1.0, 2001))
    x: Floats = onto @ shape.x
    lever = np.trapezoid(x, dx=LENGTH / 2000)
    force, tip = shape.force, (shape.x[-1], shape.y[-1])
    clamp = force[1] * tip[0] - force[0] * tip[1] - 0.097 * lever
    assert shape.moment[0] == pytest.approx(clamp, rel=1e-6)


def test_a_weight_below_zero_is_refused() -> None:
    with pytest.raises(ValueError, match=r"self_weight=-0\.1: allowed are finite numbers >= 0"):
        straight(STRANDED, self_weight=-0.1)
