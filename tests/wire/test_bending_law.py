"""Moment-curvature laws of strands, friction between them, and the plays of a wire."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from labpipe.law.plays import respond, unbent_plays
from labpipe.wire.bending_law import (
    moment_curvature,
    orientation_range,
    play_law,
    slip_stiffness,
    stick_stiffness,
)
from labpipe.wire.cantilever import (
    StringRig,
    bend_to_deflection,
    bend_to_travel,
    bend_under_force,
    straight,
)
from labpipe.wire.cross_section import CrossSection, Layer, concentric
from labpipe.wire.friction import (
    Contacts,
    arrange,
    axial_forces,
    axial_strain,
    friction_angle,
    insulated,
    sines,
    slip_onsets,
)
from labpipe.wire.materials import (
    Elastic,
    ElasticPerfectlyPlastic,
    RambergOsgood,
    StressTable,
)
from labpipe.wire.packing import packed
from tests.builders.stranded_wires import cardinal, contacts_of, layers_of, tube, wire
from tests.judges.reference_wires import bend_along


def test_slip_limit_solves_the_equilibrium_of_a_strand() -> None:
    """dF / d(theta) = (mu_o + mu_i) H + mu_i |sin alpha| F from the neutral axis (3.13)."""
    k, c = 0.21 * np.sin(0.2), 0.31 * 0.15
    exact = solve_ivp(lambda _, f: c + k * f, (0.0, 1.2), [0.0], rtol=1e-10, atol=1e-12).y[0, -1]
    assert c * friction_angle(k, np.array([1.2]))[0] == pytest.approx(exact, rel=1e-8)
    assert friction_angle(0.0, np.array([1.2]))[0] == 1.2
    assert friction_angle(1e-12, np.array([1.2]))[0] == pytest.approx(1.2)


def test_one_ring_slips_where_demand_meets_the_limit() -> None:
    section, contacts = wire("A2"), contacts_of(wire("A2"))
    ring = section.layers[1]
    k = 0.21 * np.sin(ring.lay_angle)
    theta = np.pi / 3.0
    hold = 0.31 * 0.15 * np.expm1(k * theta) / k
    demand = 110e9 * ring.area * 0.32e-3 * np.sin(theta) * np.cos(ring.lay_angle) ** 2
    onset = slip_onsets(section, contacts)
    assert onset[1] == pytest.approx(hold / demand, rel=1e-12)
    # The limit next to the neutral axis, where slip begins.
    first = 0.31 * 0.15 / (demand / np.sin(theta))
    assert onset[0] == pytest.approx(first, rel=1e-8)
    assert onset[0] == onset.min()


def test_pressure_from_outer_rings_is_never_negative() -> None:
    """With little radial force the outer ring lifts off on the side in compression."""
    section = wire("A3")
    weak = Contacts((0.9, 0.9), (0.9, 0.9), 1e-6)
    bundle = arrange(section, weak, sines(section, 0.0))
    force = axial_forces(bundle, np.linspace(0.0, 30.0, 400)[:, None]).force
    assert np.all(force * bundle.sign >= 0.0)
    assert abs(force[-1, 4]) < force[-1, 1]


def test_lay_lengths_weigh_the_pressure() -> None:
    section = cardinal()
    plain = Contacts((0.7,) * 4, (0.35,) * 4)
    weighed = Contacts((0.7,) * 4, (0.35,) * 4, lay_lengths=True)
    sine = sines(section, 0.0)
    of = [
        arrange(section, each, sine, tension=40e3).rings[2].shares[3] for each in (plain, weighed)
    ]
    radius = np.unique(section.radius.round(7))
    lay = radius[3:] / np.tan(np.radians([11.708, 13.103]))
    assert of[0] == pytest.approx(np.sin(np.radians(13.103)) * 24 / 18)
    assert of[1] / of[0] == pytest.approx(lay[0] / lay[1], rel=1e-6)


KAPPA = np.linspace(0.0, 35.0, 700)

ELASTIC = Elastic(110e9)


@pytest.mark.parametrize("turn", [0.0, 0.4, np.pi / 2.0])
def test_stick_stiffness_is_the_slope_at_zero_for_any_layout(turn: float) -> None:
    two = concentric((Layer(2, 0.3e-3, 0.2),), tube(1.8e-3))
    packing = packed(layers_of("C1"), tube(1.5e-3), seed=2)
    for section in (two, packing, wire("A3")):
        rings = len(section.layers) - int(section.has_core)
        contacts = insulated(rings, strand=0.21, insulation=0.1, radial_force=0.15)
        curve = moment_curvature(section, contacts, np.zeros(1), orientation=turn)
        assert curve.stick_stiffness == pytest.approx(curve.tangent_stiffness[0], rel=1e-9)
        assert curve.stick_stiffness == stick_stiffness(section, orientation=turn)
    assert stick_stiffness(two, orientation=np.pi / 2.0) > 1.2 * stick_stiffness(two)


@pytest.mark.parametrize("name", ["A2", "C4"])
def test_parts_and_stiffnesses(name: str) -> None:
    section = wire(name)
    curve = moment_curvature(section, contacts_of(section), KAPPA)
    parts = curve.stick + curve.slip + curve.bending + curve.plastic + curve.insulation
    assert curve.moment == pytest.approx(parts)
    assert np.all(curve.plastic <= 1e-18)
    assert curve.stick[0] == curve.slip[0] == 0.0
    assert curve.stick[-1] == pytest.approx(0.0)
    assert curve.secant_stiffness[1:] == pytest.approx(curve.moment[1:] / KAPPA[1:])
    assert curve.secant_stiffness[0] == curve.tangent_stiffness[0]
    fine = np.linspace(2.0, 35.0, 20001)
    smooth = moment_curvature(section, contacts_of(section), fine)
    slope = np.gradient(smooth.moment, fine)
    assert smooth.tangent_stiffness[5:-5] == pytest.approx(slope[5:-5], rel=1e-4)
    mirrored = wire(name, mirrored=True)
    mixed = moment_curvature(mirrored, contacts_of(section), np.array([np.nan, 9.0, 2.0]))
    assert np.isnan([mixed.moment[0], mixed.tangent_stiffness[0], mixed.slip[0]]).all()
    assert mixed.moment[2] == pytest.approx(smooth.moment[0], rel=1e-12)


@pytest.mark.parametrize("name", ["A2", "A3", "C4"])
def test_limits_of_the_radial_force(name: str) -> None:
    section = wire(name, ELASTIC)
    loose = insulated(len(section.layers) - 1, strand=0.0, insulation=0.0, radial_force=0.0)
    for contacts, stiffness in (
        (contacts_of(section, 1e9), stick_stiffness(section)),
        (contacts_of(section, 0.0), slip_stiffness(section)),
        (loose, slip_stiffness(section)),
    ):
        curve = moment_curvature(section, contacts, KAPPA, orientation=0.3)
        assert curve.moment == pytest.approx(stiffness * KAPPA, abs=1e-15)


@pytest.mark.parametrize(("name", "is_shaken"), [("A2", False), ("C4", False), ("A2", True)])
def test_the_range_over_orientations_leaves_out_no_turn(name: str, is_shaken: bool) -> None:
    """Strands without order have no symmetry; friction of seven varies by 15 % (PHYSICS 4)."""
    section, turns = wire(name), 24
    if is_shaken:
        turns = 7
        away = np.random.default_rng(3).normal(scale=1e-5, size=(2, 7)) * (section.radius > 0.0)
        section = replace(section, x=section.x + away[0], y=section.y + away[1])
    contacts, kappa = contacts_of(section), np.array([-5.0, 0.05, 5.0, 40.0])
    curve = moment_curvature(section, contacts, kappa)
    low, high = orientation_range(section, contacts, curve, n_orientations=turns)
    angles = 2.0 * np.pi * np.arange(turns) / turns
    moments = [moment_curvature(section, contacts, kappa, orientation=a).moment for a in angles]
    assert low == pytest.approx(np.min(moments, axis=0), rel=1e-9)
    assert high == pytest.approx(np.max(moments, axis=0), rel=1e-9)
    if name == "A2" and not is_shaken:
        assert 0.12 < float((high - low)[2] / curve.slip[2]) < 0.18


@pytest.mark.parametrize(("name", "largest"), [("A2", 20.0), ("A3", 60.0), ("C4", 150.0)])
def test_a_sharp_yield_does_not_stiffen(name: str, largest: float) -> None:
    sharp = ElasticPerfectlyPlastic(110e9, 60e6)
    table = StressTable((5e-4, 1e-3, 2e-3, 0.02, 0.3), (55e6, 70e6, 80e6, 100e6, 150e6))
    for material in (sharp, table, RambergOsgood(110e9, 300e6, 0.02)):
        section = wire(name, material)
        law = play_law(section, contacts_of(section), largest_curvature=largest)
        assert (law.compliances >= 0.0).all()


def test_no_wire_is_bent_beyond_its_law() -> None:
    section, contacts = wire("A2"), contacts_of(wire("A2"))
    law = play_law(section, contacts, largest_curvature=20.0)
    last = moment_curvature(section, contacts, np.array([20.0])).moment[0]
    assert law.largest_moment == pytest.approx(last, rel=1e-12)
    rig, rest = StringRig(0.76, 0.02, 0.085, 0.76), straight(law)
    message = r"expected curvatures up to 20 1/m, the end of the law, found [2-9]\d(\.\d+)? 1/m"
    with pytest.raises(ValueError, match=message):
        bend_to_deflection(law, rest, 0.085, 0.05)
    with pytest.raises(ValueError, match=message):
        bend_to_travel(law, rest, 0.085, rig, 0.05)
    with pytest.raises(ValueError, match=message):
        bend_under_force(law, rest, 0.085, np.array([0.0, 0.5]))


def test_tension_is_shared_by_stiffness_and_holds_the_strands() -> None:
    section, contacts = cardinal(), insulated(4, strand=0.5, insulation=0.0, radial_force=0.0)
    strain, kappa = axial_strain(section, 40e3), np.array([0.1])
    pull = sum(
        lay.count * lay.material.modulus * lay.area * strain * np.cos(lay.lay_angle) ** 3
        for lay in section.layers
    )
    assert pull == pytest.approx(40e3)
    slack, taut = (
        moment_curvature(section, contacts, kappa, tension=pull).moment[0] for pull in (0.0, 40e3)
    )
    assert slack == pytest.approx(slip_stiffness(section) * 0.1, rel=1e-6)
    assert taut > 1.5 * slack


@pytest.mark.parametrize("name", ["A2", "A3", "C4"])
def test_plays_follow_first_loading_and_unload_as_strands_do(name: str) -> None:
    section, contacts = wire(name), contacts_of(wire(name))
    law = play_law(section, contacts, largest_curvature=40.0)
    curvature = np.geomspace(1e-4, 39.9, 500)
    moment = moment_curvature(section, contacts, curvature).moment
    bent = respond(law, moment, unbent_plays(law, 500)).curvature
    assert bent == pytest.approx(curvature, rel=3e-3)
    path = np.concatenate([np.linspace(0.1, 20.0, 80), np.linspace(20.0, -20.0, 81)])
    moment = bend_along(section, contacts, path)
    peak = respond(law, moment[79:80], unbent_plays(law, 1))
    back = respond(law, moment[120:121], peak.plays)
    # Friction differs by 7 % between the sides: a small part of a small part of the moment.
    assert back.curvature[0] == pytest.approx(path[120], abs=0.01 * 20.0)


@given(st.floats(0.1, 10.0), st.floats(0.05, 30.0))
def test_lengths_by_c_make_moments_by_its_cube(factor: float, curvature: float) -> None:
    """Radial force by c^2, curvature by 1 / c."""
    section = replace(wire("A3", ELASTIC), insulation=None)
    layers = tuple(replace(layer, diameter=factor * layer.diameter) for layer in section.layers)
    large = CrossSection("own", layers, factor * section.x, factor * section.y, section.layer)
    assert stick_stiffness(large) == pytest.approx(factor**4 * stick_stiffness(section))
    kappa, forces = np.array([curvature]), contacts_of(section, 0.15 * factor**2)
    moment = moment_curvature(section, contacts_of(section), kappa).moment
    scaled = moment_curvature(large, forces, kappa / factor).moment
    assert scaled == pytest.approx(factor**3 * moment)
