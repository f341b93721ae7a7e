"""The cantilever on any path, with and without its own weight: textbooks and separate solvers."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from labpipe.law.play_fits import polygon_law
from labpipe.law.plays import LinearLaw, MomentLaw, unbent_plays
from labpipe.records.arrays import Floats
from labpipe.wire.bending_law import play_law
from labpipe.wire.cantilever import (
    CantileverShape,
    StringRig,
    bend_to_deflection,
    bend_to_travel,
    bend_under_force,
    held_level,
    straight,
)
from labpipe.wire.newton import (
    Condition,
    DeadLoad,
    EndLoad,
    Pull,
    Unknowns,
    _linearise,
    _Problem,
    chebyshev_stations,
    interpolation_matrix,
    solve,
)
from tests.builders.cantilevers import LENGTH, WIRE
from tests.builders.stranded_wires import contacts_of, wire
from tests.judges.reference_wires import HeavyWire, Law, yielding

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


def test_one_step_or_many_reach_the_same_place_on_a_branch() -> None:
    one = bend_to_travel(WIRE, straight(WIRE), LENGTH, RIG, 0.03)
    many = travel_through(WIRE, RIG, ramp(0.0, 0.03, steps=40))[-1]
    assert one.tension == pytest.approx(many.tension, rel=1e-8)
    np.testing.assert_allclose(one.y, many.y, atol=1e-9)


def test_a_long_step_does_not_end_in_a_curl() -> None:
    section = wire("C4")
    law = play_law(section, contacts_of(section), largest_curvature=95.0)
    whole = bend_to_deflection(law, straight(law), LENGTH, 0.08 * LENGTH)
    halves = bend_to_deflection(law, straight(law), LENGTH, 0.04 * LENGTH)
    halves = bend_to_deflection(law, halves.state, LENGTH, 0.08 * LENGTH)
    assert whole.force[1] == pytest.approx(halves.force[1], rel=1e-4)
    assert np.all(np.diff(whole.angle) > 0.0)


LONG = 0.12

KNOTS: Floats = np.geomspace(1e-7, 2e-2, 300)

STRANDED = polygon_law(yielding(KNOTS), KNOTS)


def test_with_the_string_a_separate_solver_finds_the_same() -> None:
    weight, rig = 0.097, StringRig(0.76, 0.0265, LONG, 0.76)
    other = HeavyWire(yielding, LONG, weight, 0.76, 0.0265)
    resting = other.rest()
    rest = bend_to_travel(STRANDED, straight(STRANDED, self_weight=weight), LONG, rig, 0.0)
    assert rest.tension == pytest.approx(other.pull(resting), rel=1e-4)
    state, found = rest.state, resting
    for travel in (0.002, 0.01, 0.03, 0.053):
        shape = bend_to_travel(STRANDED, state, LONG, rig, travel)
        found = other.loaded(resting, float(shape.y[-1]), found)
        state = shape.state
        force = other.pull(found) - other.pull(resting)
        assert shape.tension - rest.tension == pytest.approx(force, rel=1e-4)


@pytest.mark.parametrize(
    "condition",
    [DeadLoad(np.array([0.3, 1.7])), EndLoad(0.4), Pull(np.array([1.0, 8.0]), 7.6, 0.2)],
    ids=lambda condition: type(condition).__name__,
)
def test_jacobian_against_central_differences(condition: Condition) -> None:
    n, law, h = 12, LinearLaw(1.0), 1e-6
    stations = chebyshev_stations(n)
    beyond = 0.8 * (1.0 - stations.position)
    problem = _Problem(law, unbent_plays(law, n), condition, stations, beyond)
    moment, load = 1.2 * (1.0 - stations.position), 0.9
    exact = _linearise(problem, moment, load).jacobian
    for column in range(n + 1):
        step = h * (np.arange(n + 1) == column)
        ahead = _linearise(problem, moment + step[:n], load + step[n]).residual
        behind = _linearise(problem, moment - step[:n], load - step[n]).residual
        np.testing.assert_allclose(exact[:, column], (ahead - behind) / (2 * h), atol=1e-7)


def test_cycles_leave_a_bend_that_slackens_the_string_and_repeat() -> None:
    shapes = travel_through(WIRE, RIG, ramp(*[0.0, 0.053] * 3, 0.0, steps=20))
    tension = np.array([shape.tension for shape in shapes])
    assert tension[0] == pytest.approx(RIG.weight, rel=1e-9)
    assert np.max(np.abs(shapes[0].y)) < 1e-12
    assert tension[40] == 0.0
    assert 0.010 < shapes[40].y[-1] < 0.020
    assert tension[60] == pytest.approx(tension[20], rel=1e-3)
    assert np.all(tension >= 0.0)
    assert tension[80:121] == pytest.approx(tension[40:81], abs=1e-9)


def test_slack_and_level_wires_are_as_the_textbook_says() -> None:
    law, weight = LinearLaw(2e-3), 1e-4
    hanging = bend_under_force(law, straight(law, self_weight=weight), LONG, np.zeros(2))
    assert hanging.y[-1] == pytest.approx(-weight * LONG**4 / 8.0 / 2e-3, rel=1e-6)
    assert hanging.moment[0] == pytest.approx(-weight * LONG**2 / 2.0, rel=1e-6)
    rig = StringRig(0.76, 0.0265, LENGTH, 0.75)
    slack = bend_to_travel(LinearLaw(4e-3), straight(LinearLaw(4e-3)), LENGTH, rig, 0.0)
    assert slack.tension == 0.0
    assert slack.force == pytest.approx([0.0, -0.0265])
    assert slack.y[-1] == pytest.approx(-0.0265 * LENGTH**3 / (3 * 4e-3), rel=1e-3)
    rest = held_level(law, LONG, weight)
    assert rest.force[1] == pytest.approx(3.0 * weight * LONG / 8.0, rel=1e-6)
    assert rest.moment[0] == pytest.approx(-weight * LONG**2 / 8.0, rel=1e-6)
    assert rest.y.min() == pytest.approx(-weight * LONG**4 / 184.6 / 2e-3, rel=1e-3)


@pytest.mark.parametrize(("moment", "deflection"), [(0.0, 1.5), (np.nan, 0.1)])
def test_no_equilibrium_is_none(moment: float, deflection: float) -> None:
    law, start = LinearLaw(1.0), Unknowns(np.full(12, moment), 0.0)
    assert solve(law, unbent_plays(law, 12), 1.0, EndLoad(deflection), start) is None


@pytest.mark.parametrize(
    ("law", "first"), [(LinearLaw(2e-4), lambda moment: moment / 2e-4), (STRANDED, yielding)]
)
def test_a_separate_solver_finds_the_same_rest_and_loads(law: MomentLaw, first: Law) -> None:
    other, rest = HeavyWire(first, LONG, 0.097), held_level(law, LONG, 0.097)
    found = resting = other.rest()
    assert rest.force[1] == pytest.approx(other.pull(resting), rel=1e-4)
    shape = rest
    for deflection in (0.001, 0.004, 0.02, 0.06):
        shape = bend_to_deflection(law, shape.state, LONG, deflection)
        found = other.loaded(resting, deflection, found)
        assert shape.force[1] == pytest.approx(other.pull(found), rel=1e-4)
    load = np.array([0.0, shape.force[1]])
    again = bend_under_force(law, straight(law, self_weight=0.097), LONG, load)
    assert again.y[-1] == pytest.approx(0.06, rel=1e-3)


def test_integrals_of_polynomials_are_exact_and_a_smooth_function_is_interpolated() -> None:
    stations = chebyshev_stations(9)
    s = stations.position
    for power in range(8):
        integral = s ** (power + 1) / (power + 1)
        np.testing.assert_allclose(stations.from_clamp @ s**power, integral, atol=1e-14)
        rest = 1 / (power + 1) - integral
        np.testing.assert_allclose(stations.to_tip @ s**power, rest, atol=1e-14)
        assert stations.weights @ s**power == pytest.approx(1 / (power + 1))
    wanted, known = np.linspace(0.0, 1.0, 33), np.sin(3 * chebyshev_stations(24).position)
    np.testing.assert_allclose(interpolation_matrix(24, wanted) @ known, np.sin(3 * wanted))
