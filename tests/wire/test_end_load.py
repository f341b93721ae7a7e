"""End loads: the row of all deflections at once, and the path that turns back."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.optimize import brentq
from scipy.special import ellipe, ellipeinc, ellipk, ellipkinc

from labpipe.mechanics.law.plays import LinearLaw, MomentLaw, PlayLaw, respond, unbent_plays
from labpipe.mechanics.wire.bending_law import play_law
from labpipe.mechanics.wire.cantilever import bend_to_deflection, bend_under_force, straight
from labpipe.mechanics.wire.end_load import deflection_at, end_loads, polygon_of
from labpipe.mechanics.wire.end_load_path import end_load_path
from tests.builders.bilinear_laws import bilinear_law, complementary_energy
from tests.builders.cantilevers import LENGTH, WIRE, by_stations
from tests.builders.stranded_wires import contacts_of, wire


def stranded(name: str, largest: float) -> PlayLaw:
    return play_law(wire(name), contacts_of(wire(name)), largest_curvature=largest)


STRANDED, C4 = stranded("A2", 125.0), stranded("C4", 95.0)


def closed_form(tip_angle: float) -> tuple[float, float, float]:
    """P L^2 / EI, deflection / L and shortening / L by elliptic integrals.

    Bisshopp and Drucker (1945), with m = (1 + sin(tip angle)) / 2.
    """
    m = (1.0 + np.sin(tip_angle)) / 2.0
    phi = np.arcsin(np.sqrt(0.5 / m))
    root = float(ellipk(m) - ellipkinc(phi, m))
    deflection = 1.0 - 2.0 * float(ellipe(m) - ellipeinc(phi, m)) / root
    return root**2, deflection, 1.0 - float(np.sqrt(2.0 * np.sin(tip_angle))) / root


@given(st.floats(1e-3, 1.5))
@example(1e-3)
@example(1.43029)
@example(1.5)
def test_the_elastica(tip_angle: float) -> None:
    """The second example is P L^2 / EI = 10 in the table of Mattiasson (1981)."""
    load, rise, shortening = closed_form(tip_angle)
    if tip_angle == 1.43029:
        assert (load, rise, shortening) == pytest.approx((10.0, 0.81061, 0.555), rel=1e-4)
    law = LinearLaw(2e-3)
    force = np.array([0.0, load * law.stiffness / LENGTH**2])
    shape = bend_under_force(law, straight(law), LENGTH, force)
    numbers = (shape.y[-1] / LENGTH, 1.0 - shape.x[-1] / LENGTH, shape.angle[-1])
    assert numbers == pytest.approx((rise, shortening, tip_angle), abs=1e-9)
    clamp = np.sqrt(2.0 * load * np.sin(tip_angle)) * law.stiffness / LENGTH
    assert deflection_at(law, LENGTH, clamp) == pytest.approx(rise * LENGTH, rel=1e-9)
    row = end_loads(law, LENGTH, np.array([rise * LENGTH]))
    assert row.load[0] == pytest.approx(force[1], rel=1e-8)
    assert row.deflection[0] == pytest.approx(rise * LENGTH, rel=1e-10)


def by_first_integral(law: MomentLaw, load: float) -> tuple[float, float, float]:
    """Deflection, tip angle and clamp's moment of the wire.

    While nothing unloads, W*(M) + P sin(psi) is the same everywhere, W* the integral of the
    curvature over the moment; Gauss's rule between the corners of the law.
    """
    roots, weights = np.polynomial.legendre.leggauss(20)

    def energy(moment: float) -> float:
        return float(complementary_energy(law, np.array(moment)))

    def integrals(clamp: float) -> tuple[float, float]:
        corners = np.append(0.0, law.half_widths[law.half_widths < clamp])
        edges = np.union1d(np.append(corners, clamp), clamp * np.linspace(0.0, 1.0, 40))
        half = np.diff(edges)[:, None] / 2.0
        moment = edges[:-1, None] + half * (roots + 1.0)
        sine = (energy(clamp) - complementary_energy(law, moment)) / load
        share = half * weights / (load * np.sqrt(1.0 - sine**2))
        return float(share.sum()), float((share * sine).sum())

    lever = load * LENGTH
    upright = brentq(lambda m: energy(m) - load, 0.0, lever) if energy(lever) > load else lever
    most = upright * (1.0 - 1e-9)
    clamp = brentq(lambda m: integrals(m)[0] - LENGTH, 1e-3 * most, most, xtol=1e-16)
    return integrals(clamp)[1], float(np.arcsin(energy(clamp) / load)), float(clamp)


# At 64 stations a single corner costs 7e-5 (2e-6 at 128), the many small ones of a wire 4e-6.
@pytest.mark.parametrize(
    ("law", "load", "within"),
    [
        (LinearLaw(3e-3), 1.2, 1e-11),
        (bilinear_law(5e-3, 1.5e-3, 0.02), 0.9, 1e-4),
        (STRANDED, 0.13, 1e-5),
        (C4, 0.3, 1e-5),
    ],
    ids=["linear", "bilinear", "A2", "C4"],
)
def test_the_first_integral(law: MomentLaw, load: float, within: float) -> None:
    deflection, tip, clamp = by_first_integral(law, load)
    shape = bend_under_force(law, straight(law), LENGTH, np.array([0.0, load]))
    numbers = (shape.y[-1], shape.angle[-1], shape.moment[0])
    assert numbers == pytest.approx((deflection, tip, clamp), rel=within)
    row = end_loads(law, LENGTH, np.array([deflection]))
    assert (row.load[0], row.clamp_moment[0]) == pytest.approx((load, clamp), rel=1e-7)
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
    deflections = np.array([0.0, 0.02, 0.04, 0.03, 0.02, -0.01, 0.0])
    loads = end_load_path(WIRE, LENGTH, deflections).load
    wanted = by_stations(WIRE, deflections[1:])
    assert loads == pytest.approx(np.append(0.0, wanted), abs=5e-5 * loads.max())
    assert loads[4] < 0.7 * loads[1]
    down = end_load_path(WIRE, LENGTH, -deflections[1:3]).load
    assert down == pytest.approx(-loads[1:3], rel=1e-4)
    assert end_load_path(WIRE, LENGTH, np.zeros(0)).load.shape == (0,)


def test_the_curve_is_that_of_the_stations_also_where_the_tip_unloads() -> None:
    law, deflections = C4, np.linspace(0.0, 0.8 * LENGTH, 41)[1:]
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
    short, long = stranded("A2", 20.0), stranded("A2", 60.0)
    deflections = np.linspace(0.0, 0.05, 26)[1:]
    path = end_load_path(short, LENGTH, deflections)
    assert 5 < len(path.load) < 25
    beyond = end_load_path(long, LENGTH, deflections).clamp_moment
    assert beyond[len(path.load) - 1] < short.largest_moment < beyond[len(path.load)]
    back = end_load_path(short, LENGTH, np.array([0.01, 0.005, 0.012, 0.05, 0.01]))
    assert len(back.load) == 3
