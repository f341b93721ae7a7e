"""The cantilever on any path: loading, unloading, cycles, slack string."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from labpipe.law.plays import LinearLaw, MomentLaw
from labpipe.records.arrays import Floats
from labpipe.wire.bending_law import play_law
from labpipe.wire.cantilever import (
    CantileverShape,
    StringRig,
    bend_to_deflection,
    bend_to_travel,
    bend_under_force,
    straight,
)
from tests.builders.bilinear_laws import bilinear_law
from tests.builders.cantilevers import LENGTH, WIRE, by_stations
from tests.builders.stranded_wires import contacts_of, wire

RIG = StringRig(string_length=0.76, weight=0.0265, anchor_x=LENGTH, anchor_height=0.76)


def travel_through(law: MomentLaw, rig: StringRig, travels: Floats) -> list[CantileverShape]:
    state, shapes = straight(law), []
    for travel in travels:
        shapes.append(bend_to_travel(law, state, LENGTH, rig, float(travel)))
        state = shapes[-1].state
    return shapes


def ramp(*corners: float, steps: int = 24) -> Floats:
    legs = [np.linspace(a, b, steps + 1)[1:] for a, b in pairwise(corners)]
    return np.concatenate([[corners[0]], *legs])


def test_straight_wire_hangs_on_the_string() -> None:
    shape = bend_to_travel(WIRE, straight(WIRE), LENGTH, RIG, 0.0)
    assert shape.tension == pytest.approx(RIG.weight, rel=1e-9)
    assert np.max(np.abs(shape.y)) < 1e-12


def test_string_keeps_its_length_and_wire_its_arc() -> None:
    for shape in travel_through(WIRE, RIG, ramp(0.0, 0.053, 0.0)):
        anchor = np.array([RIG.anchor_x, RIG.anchor_height + shape.state.travel])
        span = np.hypot(*(anchor - [shape.x[-1], shape.y[-1]]))
        if shape.tension > 0.0:
            assert span == pytest.approx(RIG.string_length, abs=1e-11)
        else:
            assert span <= RIG.string_length + 1e-11
        chords = np.hypot(np.diff(shape.x), np.diff(shape.y))
        assert np.sum(chords) == pytest.approx(LENGTH, rel=1e-3)


def test_slack_string_leaves_the_wire_to_its_counterweight() -> None:
    rig = StringRig(0.76, 0.0265, LENGTH, 0.75)
    shape = bend_to_travel(LinearLaw(4e-3), straight(LinearLaw(4e-3)), LENGTH, rig, 0.0)
    assert shape.tension == 0.0
    assert shape.force == pytest.approx([0.0, -0.0265])
    sag = 0.0265 * LENGTH**3 / (3 * 4e-3)
    assert shape.y[-1] == pytest.approx(-sag, rel=1e-3)


def test_residual_bend_slackens_the_string_and_travel_takes_it_up_again() -> None:
    shapes = travel_through(WIRE, RIG, ramp(0.0, 0.053, 0.0, 0.053, steps=30))
    tension = np.array([shape.tension for shape in shapes])
    assert tension[60] == 0.0
    assert 0.010 < shapes[60].y[-1] < 0.020
    assert tension[90] == pytest.approx(tension[30], rel=1e-3)
    assert np.all(tension >= 0.0)


def test_linear_law_comes_back_to_zero() -> None:
    shapes = travel_through(LinearLaw(3e-3), RIG, ramp(0.0, 0.053, 0.0))
    assert shapes[-1].tension == pytest.approx(RIG.weight, rel=1e-8)
    assert np.max(np.abs(shapes[-1].y)) < 1e-10


def test_later_cycles_repeat_the_second() -> None:
    shapes = travel_through(WIRE, RIG, ramp(*[0.0, 0.053] * 3, 0.0, steps=20))
    second = [shape.tension for shape in shapes[40:81]]
    third = [shape.tension for shape in shapes[80:121]]
    assert third == pytest.approx(second, abs=1e-9)


def test_one_step_or_many_reach_the_same_place_on_a_branch() -> None:
    one = bend_to_travel(WIRE, straight(WIRE), LENGTH, RIG, 0.03)
    many = travel_through(WIRE, RIG, ramp(0.0, 0.03, steps=40))[-1]
    assert one.tension == pytest.approx(many.tension, rel=1e-8)
    np.testing.assert_allclose(one.y, many.y, atol=1e-9)


@pytest.mark.parametrize("law", [LinearLaw(3e-3), bilinear_law(5e-3, 1.5e-3, 0.02), WIRE])
def test_deflection_of_four_fifths_of_the_length(law: MomentLaw) -> None:
    rig = StringRig(0.76, 0.0265, LENGTH, 0.76)
    shapes = travel_through(law, rig, ramp(0.0, 0.067, 0.0))
    assert max(shape.y[-1] for shape in shapes) / LENGTH > 0.8


def test_end_load_and_deflection_are_inverse() -> None:
    there = bend_to_deflection(WIRE, straight(WIRE), LENGTH, 0.02).state
    load = bend_to_deflection(WIRE, there, LENGTH, 0.05).force[1]
    shape = bend_under_force(WIRE, straight(WIRE), LENGTH, np.array([0.0, load]))
    assert shape.y[-1] == pytest.approx(0.05, abs=1e-9)


def test_doubling_the_stations_changes_nothing_for_a_smooth_law() -> None:
    law = LinearLaw(3e-3)
    loads = [by_stations(law, np.array([0.053]), n_stations=n)[0] for n in (16, 32, 64)]
    assert loads[0] == pytest.approx(loads[2], rel=1e-9)
    assert loads[1] == pytest.approx(loads[2], rel=1e-12)


def test_doubling_the_stations_converges_for_plays() -> None:
    deflections = np.array([0.02, 0.04, 0.053, 0.03, 0.02])
    coarse, fine, finest = (by_stations(WIRE, deflections, n_stations=n) for n in (24, 48, 96))
    errors = [np.max(np.abs(loads - finest)) for loads in (coarse, fine)]
    assert errors[1] < 5e-5 * np.max(finest)
    assert errors[0] > 2 * errors[1]


def test_a_long_step_does_not_end_in_a_curl() -> None:
    section = wire("C4")
    law = play_law(section, contacts_of(section), largest_curvature=95.0)
    whole = bend_to_deflection(law, straight(law), LENGTH, 0.08 * LENGTH)
    halves = bend_to_deflection(law, straight(law), LENGTH, 0.04 * LENGTH)
    halves = bend_to_deflection(law, halves.state, LENGTH, 0.08 * LENGTH)
    assert whole.force[1] == pytest.approx(halves.force[1], rel=1e-4)
    assert np.all(np.diff(whole.angle) > 0.0)


def test_a_deflection_beyond_the_length_is_refused() -> None:
    law = LinearLaw(3e-3)
    with pytest.raises(ValueError, match=r"deflection=0.09: no equilibrium beyond 0.08"):
        bend_to_deflection(law, straight(law), LENGTH, 0.09)


@pytest.mark.parametrize("number", [np.nan, np.inf])
def test_numbers_that_are_not_finite_are_refused(number: float) -> None:
    law = LinearLaw(3e-3)
    state = straight(law)
    said = rf"=\[?(0.0, )?{number}\]?: allowed are finite numbers$"
    with pytest.raises(ValueError, match="^force" + said):
        bend_under_force(law, state, LENGTH, np.array([0.0, number]))
    with pytest.raises(ValueError, match="^deflection" + said):
        bend_to_deflection(law, state, LENGTH, number)
    with pytest.raises(ValueError, match="^travel" + said):
        bend_to_travel(law, state, LENGTH, RIG, number)


@pytest.mark.parametrize("length", [0.0, -0.085, np.nan, np.inf])
def test_lengths_are_positive(length: float) -> None:
    law = LinearLaw(3e-3)
    state = straight(law)
    said = rf"^length={length}: allowed are finite numbers > 0$"
    with pytest.raises(ValueError, match=said):
        bend_under_force(law, state, length, np.array([0.0, 0.1]))
    with pytest.raises(ValueError, match=said):
        bend_to_deflection(law, state, length, 0.01)
    with pytest.raises(ValueError, match=said):
        bend_to_travel(law, state, length, RIG, 0.01)
