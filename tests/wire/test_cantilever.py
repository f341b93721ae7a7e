"""The cantilever on any path, with and without its own weight: textbooks and separate solvers."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from labpipe.mechanics.law.plays import LoadingTable, PlayLaw, make_elastic_law
from labpipe.mechanics.wire.bending_law import fit_play_law
from labpipe.mechanics.wire.cantilever import (
    Cantilever,
    CantileverShape,
    StringRig,
    TipCondition,
    bend_to_deflection,
    bend_to_travel,
    bend_under_force,
    make_interpolation_matrix,
    make_stations,
    make_straight,
    make_transfer_matrix,
)
from labpipe.mechanics.wire.first_loading import compute_end_load_path
from labpipe.records.arrays import Floats
from tests.builders.cantilevers import LENGTH, WIRE, hold_level
from tests.builders.stranded_wires import contacts_of, wire

RIG = StringRig(string_length=0.76, weight=0.0027 * 9.80665, anchor_x=LENGTH, anchor_height=0.76)


def travel_through(law: PlayLaw, rig: StringRig, travels: Floats) -> list[CantileverShape]:
    state, shapes = make_straight(law), []
    for travel in travels:
        shapes.append(bend_to_travel(law, state, LENGTH, rig, float(travel)))
        state = shapes[-1].state
    return shapes


def ramp(*corners: float, steps: int = 24) -> Floats:
    legs = [np.linspace(a, b, steps + 1)[1:] for a, b in pairwise(corners)]
    return np.concatenate([[corners[0]], *legs])


def test_cycles_leave_a_bend_repeat_and_lose_the_area_of_their_loop() -> None:
    """The string keeps its length, the wire its arc; work of the lift is that of moments."""
    shapes = travel_through(WIRE, RIG, ramp(*[0.0, 0.053] * 3, 0.0, steps=120))
    tension = np.array([shape.tension for shape in shapes])
    assert tension[0] == pytest.approx(RIG.weight, rel=1e-9)
    assert np.max(np.abs(shapes[0].y)) < 1e-12
    assert tension[240] == 0.0
    assert 0.010 < shapes[240].y[-1] < 0.020
    assert tension[360] == pytest.approx(tension[120], rel=1e-3)
    assert np.all(tension >= 0.0)
    assert tension[480:721] == pytest.approx(tension[240:481], abs=1e-9)
    for shape in shapes[:241]:
        anchor = np.array([RIG.anchor_x, RIG.anchor_height + shape.state.travel])
        span = np.hypot(*(anchor - [shape.x[-1], shape.y[-1]]))
        is_taut = shape.tension > 0.0
        assert span <= RIG.string_length + 1e-11
        assert span == pytest.approx(RIG.string_length, abs=1e-11) or not is_taut
        chords = np.hypot(np.diff(shape.x), np.diff(shape.y))
        assert np.sum(chords) == pytest.approx(LENGTH, rel=1e-3)
    loop = shapes[120:361]  # from the top down and up to it again
    moment = np.array([shape.moment for shape in loop])
    curvature = np.array([shape.curvature for shape in loop])
    per_length = np.sum(0.5 * (moment[1:] + moment[:-1]) * np.diff(curvature, axis=0), axis=0)
    lost = np.trapezoid(per_length, loop[0].arc_length)
    lift = np.array([shape.force[1] + RIG.weight for shape in loop])
    assert lost > 1e-3
    work = np.trapezoid(lift, [shape.state.travel for shape in loop])
    assert work == pytest.approx(lost, rel=5e-3)


@pytest.mark.parametrize(
    ("law", "lean"), [(make_elastic_law(3e-3), (2.79, 4.12)), (WIRE, (2.55, 3.47))]
)
def test_lean_of_the_string(law: PlayLaw, lean: tuple[float, float]) -> None:
    """What it adds to the force at 50 mm of travel, per cent, less the counterweight.

    Against a vertical load at the same deflection, and at a deflection equal to the travel.
    """
    shape = bend_to_travel(law, make_straight(law), LENGTH, RIG, 0.05)
    ends = np.array([shape.y[-1], 0.05])[:, None]
    loads = [compute_end_load_path(law, LENGTH, end).load[0] for end in ends]
    share = 100.0 * ((shape.tension - RIG.weight) / np.array(loads) - 1.0)
    assert share == pytest.approx(lean, abs=0.02)


def test_one_step_or_many_reach_the_same_place_on_a_branch() -> None:
    one = bend_to_travel(WIRE, make_straight(WIRE), LENGTH, RIG, 0.03)
    many = travel_through(WIRE, RIG, ramp(0.0, 0.03, steps=40))[-1]
    assert one.tension == pytest.approx(many.tension, rel=1e-8)
    np.testing.assert_allclose(one.y, many.y, atol=1e-9)


def test_a_long_step_does_not_end_in_a_curl() -> None:
    section = wire("C4")
    law = fit_play_law(section, contacts_of(section), largest_curvature=95.0)
    whole = bend_to_deflection(law, make_straight(law), LENGTH, 0.08 * LENGTH)
    halves = bend_to_deflection(law, make_straight(law), LENGTH, 0.04 * LENGTH)
    halves = bend_to_deflection(law, halves.state, LENGTH, 0.08 * LENGTH)
    assert whole.force[1] == pytest.approx(halves.force[1], rel=1e-4)
    assert np.all(np.diff(whole.angle) > 0.0)


@pytest.mark.parametrize(
    "condition",
    [
        TipCondition(dead_force=np.array([0.3, 1.7])),
        TipCondition(deflection=np.array([0.4])),
        TipCondition(StringRig(7.6, 0.2, 1.0, 8.0), deflection=np.array([0.4])),
        TipCondition(StringRig(7.6, 0.2, 1.0, 8.0), travel=0.1),
    ],
)
def test_jacobian_against_central_differences(condition: TipCondition) -> None:
    n, law, h = 12, make_elastic_law(1.0), 1e-6
    stations = make_stations(n)
    table = LoadingTable.of_plays(law)
    wire = Cantilever(lambda moment, rows: table.bend(moment[rows]), stations, 0.8, condition)
    state = np.append(1.2 * (1.0 - stations.position), 0.9)

    def missing(values: Floats) -> Floats:
        return np.ravel(wire.bend(values[None, :n], values[n:]).compute_residual())

    exact = wire.bend(state[None, :n], state[n:]).compute_jacobian()[0]
    for column in range(n + 1):
        step = h * (np.arange(n + 1) == column)
        slope = (missing(state + step) - missing(state - step)) / (2 * h)
        np.testing.assert_allclose(exact[:, column], slope, atol=1e-7)


def test_slack_and_level_wires_are_as_the_textbook_says() -> None:
    law, weight, long = make_elastic_law(2e-3), 1e-4, 0.12
    hanging = bend_under_force(law, make_straight(law, self_weight=weight), long, np.zeros(2))
    assert hanging.y[-1] == pytest.approx(-weight * long**4 / 8.0 / 2e-3, rel=1e-6)
    assert hanging.moment[0] == pytest.approx(-weight * long**2 / 2.0, rel=1e-6)
    rig = StringRig(0.76, 0.0265, LENGTH, 0.75)
    linear = make_elastic_law(4e-3)
    slack = bend_to_travel(linear, make_straight(linear), LENGTH, rig, 0.0)
    assert slack.tension == 0.0
    assert slack.force == pytest.approx([0.0, -0.0265])
    assert slack.y[-1] == pytest.approx(-0.0265 * LENGTH**3 / (3 * 4e-3), rel=1e-3)
    rest = hold_level(law, long, weight)
    assert rest.force[1] == pytest.approx(3.0 * weight * long / 8.0, rel=1e-6)
    assert rest.moment[0] == pytest.approx(-weight * long**2 / 8.0, rel=1e-6)
    assert rest.y.min() == pytest.approx(-weight * long**4 / 184.6 / 2e-3, rel=1e-3)


def test_integrals_of_polynomials_are_exact_and_a_smooth_function_is_interpolated() -> None:
    stations = make_stations(9)
    cached = stations.position, make_stations(9, 0.12).position, make_transfer_matrix(9, 5)
    assert not any(array.flags.writeable for array in (*cached, stations.clamp_integral))
    s = stations.position
    for power in range(8):
        integral = s ** (power + 1) / (power + 1)
        np.testing.assert_allclose(stations.clamp_integral @ s**power, integral, atol=1e-14)
        rest = 1 / (power + 1) - integral
        np.testing.assert_allclose(stations.tip_integral @ s**power, rest, atol=1e-14)
        assert stations.weights @ s**power == pytest.approx(1 / (power + 1))
    wanted, known = np.linspace(0.0, 1.0, 33), np.sin(3 * make_stations(24).position)
    np.testing.assert_allclose(make_interpolation_matrix(24, wanted) @ known, np.sin(3 * wanted))
