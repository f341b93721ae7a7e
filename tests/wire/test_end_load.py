"""End loads: the row of all deflections at once, and the path that turns back."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq
from scipy.special import ellipe, ellipeinc, ellipk, ellipkinc

from labpipe.law.plays import LinearLaw, MomentLaw, respond, unbent_plays
from labpipe.wire.bending_law import play_law
from labpipe.wire.cantilever import bend_to_deflection, straight
from labpipe.wire.end_load import deflection_at, end_loads, polygon_of
from labpipe.wire.end_load_path import end_load_path
from tests.builders.bilinear_laws import bilinear_law, complementary_energy
from tests.builders.cantilevers import LENGTH, WIRE, by_stations
from tests.builders.stranded_wires import contacts_of, wire

SECTION = wire("A2")

STRANDED = play_law(SECTION, contacts_of(SECTION), largest_curvature=125.0)


def elastica(tip_angle: float) -> tuple[float, float]:
    """P L^2 / EI and deflection / L by elliptic integrals (Bisshopp and Drucker 1945)."""
    k = np.sqrt((1.0 + np.sin(tip_angle)) / 2.0)
    start = np.arcsin(1.0 / (k * np.sqrt(2.0)))
    load = (ellipk(k**2) - ellipkinc(start, k**2)) ** 2
    rise = 1.0 - 2.0 * (ellipe(k**2) - ellipeinc(start, k**2)) / np.sqrt(load)
    return float(load), float(rise)


def by_adaptive_quadrature(law: MomentLaw, clamp: float) -> tuple[float, float]:
    """Load and deflection for a clamp moment, from the first integral by other means."""

    def energy(moment: float) -> float:
        return float(complementary_energy(law, np.array([moment]))[0])

    def over_wire(load: float, of_sine: bool) -> float:
        def part(moment: float) -> float:
            sine = (energy(clamp) - energy(moment)) / load
            return float((sine if of_sine else 1.0) / (load * np.sqrt(1.0 - sine**2)))

        corners = [float(width) for width in law.half_widths if 0.0 < width < clamp]
        parts = pairwise([0.0, *corners, clamp])
        return float(sum(quad(part, a, b, epsabs=1e-14, epsrel=1e-11)[0] for a, b in parts))

    least = energy(clamp)
    load = brentq(lambda p: over_wire(p, False) - LENGTH, least * 1.0001, least * 1e4, rtol=1e-12)
    return float(load), over_wire(load, True)


@pytest.mark.parametrize("clamp", [0.02, 0.06, 0.09])
def test_a_bilinear_law_by_adaptive_quadrature(clamp: float) -> None:
    law = bilinear_law(5e-3, 1e-3, 0.05)
    load, deflection = by_adaptive_quadrature(law, clamp)
    found = end_loads(law, LENGTH, np.array([deflection]))
    assert found.load[0] == pytest.approx(load, rel=1e-7)
    assert found.clamp_moment[0] == pytest.approx(clamp, rel=1e-7)
    assert deflection_at(law, LENGTH, clamp) == pytest.approx(deflection, rel=1e-7)


def test_the_polygon_is_the_first_loading_of_the_plays() -> None:
    polygon = polygon_of(STRANDED, 0.05)
    plays = unbent_plays(STRANDED, len(polygon.moment))
    answer = respond(STRANDED, polygon.moment, plays).curvature
    assert polygon.curvature == pytest.approx(answer, rel=1e-12)
    energy = complementary_energy(STRANDED, polygon.moment)
    assert polygon.energy == pytest.approx(energy, rel=1e-10)
    assert polygon.moment[-1] == 0.05


def test_the_states_are_in_equilibrium_from_tip_to_clamp() -> None:
    deflections = np.linspace(0.0, 0.6 * LENGTH, 13)[1:]
    found = end_loads(STRANDED, LENGTH, deflections)
    assert found.deflection[:-1] == pytest.approx(deflections, rel=1e-10)
    assert found.tail()[:, -1] == pytest.approx(np.full(13, LENGTH), rel=1e-10)
    shape = bend_to_deflection(STRANDED, straight(STRANDED), LENGTH, float(deflections[5]))
    assert found.load[5] == pytest.approx(shape.force[1], rel=1e-4)
    moment = found.moment_at(5, LENGTH - shape.arc_length)
    assert moment == pytest.approx(shape.moment, abs=3e-3 * shape.moment.max())


def test_it_ends_where_parts_near_the_tip_unload() -> None:
    deflections = np.linspace(0.0, 0.8 * LENGTH, 41)[1:]
    found = end_loads(STRANDED, LENGTH, deflections)
    assert 0.6 * LENGTH < found.deflection[-1] < 0.75 * LENGTH
    assert len(found.load) - 1 == np.sum(deflections <= found.deflection[-1])
    linear = end_loads(LinearLaw(2e-3), LENGTH, deflections)  # has nothing to remember
    assert len(linear.load) - 1 == len(deflections)


@pytest.mark.parametrize("length", [0.085, 30.0])
def test_a_far_bent_wire_stands_upright(length: float) -> None:
    """The limit of the elastica: k = 1, E(k) = 1, E(phi, k) = sin(phi) = 1 / sqrt(2)."""
    curvature = 125.0
    deflection = deflection_at(LinearLaw(3e-3), length, 3e-3 * curvature)
    rise = 1.0 - 2.0 * (np.sqrt(2.0) - 1.0) / (curvature * length)
    assert deflection / length == pytest.approx(rise, rel=1e-6)


def test_a_curve_that_turns_back_goes_on_from_its_first_loading() -> None:
    deflections = np.array([0.02, 0.04, 0.03, 0.02, -0.01, 0.0])
    loads = end_load_path(WIRE, LENGTH, deflections).load
    assert loads == pytest.approx(by_stations(WIRE, deflections), abs=5e-5 * loads.max())
    assert loads[3] < 0.7 * loads[0]


def test_a_curve_from_zero_and_one_to_the_other_side() -> None:
    from_zero = end_load_path(WIRE, LENGTH, np.array([0.0, 0.02])).load
    assert from_zero[0] == pytest.approx(0.0, abs=1e-15)
    up = end_load_path(WIRE, LENGTH, np.array([0.02, 0.04])).load
    down = end_load_path(WIRE, LENGTH, np.array([-0.02, -0.04])).load
    assert down == pytest.approx(-up, rel=1e-4)
    assert end_load_path(WIRE, LENGTH, np.zeros(0)).load.shape == (0,)


@pytest.mark.parametrize("tip_angle", [1e-3, 0.8, 1.43, 1.5, 1.57])
def test_the_elastica(tip_angle: float) -> None:
    load, rise = elastica(tip_angle)
    clamp = np.sqrt(2.0 * load * np.sin(tip_angle)) * 2e-3 / LENGTH
    assert deflection_at(LinearLaw(2e-3), LENGTH, clamp) == pytest.approx(rise * LENGTH, rel=1e-9)
    if tip_angle <= 1.5:
        row = end_loads(LinearLaw(2e-3), LENGTH, np.array([rise * LENGTH]))
        assert row.load[0] * LENGTH**2 / 2e-3 == pytest.approx(load, rel=1e-8)
        assert row.deflection[0] == pytest.approx(rise * LENGTH, rel=1e-10)


def test_the_curve_is_that_of_the_stations_also_where_the_tip_unloads() -> None:
    section = wire("C4")
    law = play_law(section, contacts_of(section), largest_curvature=95.0)
    deflections = np.linspace(0.0, 0.8 * LENGTH, 41)[1:]
    state, shapes = straight(law, 64), []
    for deflection in deflections.tolist():
        shapes.append(bend_to_deflection(law, state, LENGTH, deflection))
        state = shapes[-1].state
    loads, moments = zip(*((shape.force[1], shape.moment[0]) for shape in shapes), strict=True)
    for step in (40, 4, 1):
        path = end_load_path(law, LENGTH, deflections[step - 1 :: step])
        assert path.load == pytest.approx(loads[step - 1 :: step], rel=1e-4)
        assert path.clamp_moment == pytest.approx(moments[step - 1 :: step], rel=1e-4)


def test_a_path_ends_where_the_law_does() -> None:
    contacts = contacts_of(SECTION)
    short = play_law(SECTION, contacts, largest_curvature=20.0)
    long = play_law(SECTION, contacts, largest_curvature=60.0)
    deflections = np.linspace(0.0, 0.05, 26)[1:]
    path = end_load_path(short, LENGTH, deflections)
    assert 5 < len(path.load) < 25
    beyond = end_load_path(long, LENGTH, deflections).clamp_moment
    assert beyond[len(path.load) - 1] < short.largest_moment < beyond[len(path.load)]
    back = end_load_path(short, LENGTH, np.array([0.01, 0.005, 0.012, 0.05, 0.01]))
    assert len(back.load) == 3
