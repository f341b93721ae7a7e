"""Moment-curvature laws of strands, friction between them, and the plays of a wire.

The plain script is the source's appendix A.4 with its faults put right, and shares no code with
labpipe (`benchmarks/plain_loop.py`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from benchmarks import plain_loop
from labpipe.mechanics.wire.bending_law import (
    Contacts,
    compute_axial_forces,
    compute_axial_strain,
    compute_friction_angle,
    compute_moment_curve,
    compute_orientation_range,
    compute_sines,
    compute_slip_stiffness,
    compute_stick_stiffness,
    find_slip_onsets,
    fit_play_law,
    make_contacts,
    make_ring_model,
)
from labpipe.mechanics.wire.cantilever import (
    StringRig,
    bend_to_deflection,
    bend_to_travel,
    bend_under_force,
    make_straight,
)
from labpipe.mechanics.wire.cross_section import CrossSection, Insulation, Layer, place_rings
from labpipe.mechanics.wire.materials import (
    Material,
    RambergOsgood,
    StressTable,
)
from labpipe.records.arrays import Floats
from tests.builders.stranded_wires import (
    WIRES,
    cardinal,
    contacts_of,
    elastic,
    layers_of,
    perfectly_plastic,
    wire,
)
from tests.judges.reference_wires import bend_along


def test_slip_limit_solves_the_equilibrium_of_a_strand() -> None:
    """dF / d(theta) = (mu_o + mu_i) H + mu_i |sin alpha| F from the neutral axis (3.13)."""
    k, c = 0.21 * np.sin(0.2), 0.31 * 0.15
    exact = solve_ivp(lambda _, f: c + k * f, (0.0, 1.2), [0.0], rtol=1e-10, atol=1e-12).y[0, -1]
    assert c * compute_friction_angle(k, np.array([1.2]))[0] == pytest.approx(exact, rel=1e-8)
    assert compute_friction_angle(0.0, np.array([1.2]))[0] == 1.2
    assert compute_friction_angle(1e-12, np.array([1.2]))[0] == pytest.approx(1.2)


def test_one_ring_slips_where_demand_meets_the_limit() -> None:
    section, contacts = wire("A2"), contacts_of(wire("A2"))
    ring = section.layers[1]
    k = 0.21 * np.sin(ring.lay_angle)
    theta = np.pi / 3.0
    hold = 0.31 * 0.15 * np.expm1(k * theta) / k
    demand = 110e9 * ring.area * 0.32e-3 * np.sin(theta) * np.cos(ring.lay_angle) ** 2
    onset = find_slip_onsets(section, contacts)
    assert onset[1] == pytest.approx(hold / demand, rel=1e-12)
    # The limit next to the neutral axis, where slip begins.
    first = 0.31 * 0.15 / (demand / np.sin(theta))
    assert onset[0] == pytest.approx(first, rel=1e-8)
    assert onset[0] == onset.min()


def test_pressure_from_outer_rings_is_never_negative() -> None:
    """With little radial force the outer ring lifts off on the side in compression."""
    section = wire("A3")
    weak = Contacts((0.9, 0.9), (0.9, 0.9), 1e-6)
    bundle = make_ring_model(section, weak, compute_sines(section, 0.0))
    force = compute_axial_forces(bundle, np.linspace(0.0, 30.0, 400)[:, None]).force
    assert np.all(force * bundle.sign >= 0.0)
    assert abs(force[-1, 4]) < force[-1, 1]


def test_lay_lengths_weigh_the_pressure() -> None:
    section = cardinal()
    plain = Contacts((0.7,) * 4, (0.35,) * 4)
    weighed = Contacts((0.7,) * 4, (0.35,) * 4, has_lay_lengths=True)
    sine = compute_sines(section, 0.0)
    of = [
        make_ring_model(section, each, sine, tension=40e3).rings[2].pressure_factors[3]
        for each in (plain, weighed)
    ]
    radius = np.unique(section.radius.round(7))
    lay = radius[3:] / np.tan(np.radians([11.708, 13.103]))
    assert of[0] == pytest.approx(np.sin(np.radians(13.103)) * 24 / 18)
    assert of[1] / of[0] == pytest.approx(lay[0] / lay[1], rel=1e-6)


KAPPA = np.linspace(0.0, 35.0, 700)


@pytest.mark.parametrize("name", ["A2", "C4"])
def test_parts_and_stiffnesses(name: str) -> None:
    section = wire(name)
    curve = compute_moment_curve(section, contacts_of(section), KAPPA)
    parts = curve.stick + curve.slip + curve.bending + curve.plastic + curve.insulation
    assert curve.moment == pytest.approx(parts)
    assert np.all(curve.plastic <= 1e-18)
    assert curve.stick[0] == curve.slip[0] == 0.0
    assert curve.stick[-1] == pytest.approx(0.0)
    assert curve.secant_stiffness[1:] == pytest.approx(curve.moment[1:] / KAPPA[1:])
    assert curve.secant_stiffness[0] == curve.tangent_stiffness[0]
    fine = np.linspace(2.0, 35.0, 20001)
    smooth = compute_moment_curve(section, contacts_of(section), fine)
    slope = np.gradient(smooth.moment, fine)
    assert smooth.tangent_stiffness[5:-5] == pytest.approx(slope[5:-5], rel=1e-4)
    mirrored = wire(name, mirrored=True)
    mixed = compute_moment_curve(mirrored, contacts_of(section), np.array([np.nan, 9.0, 2.0]))
    assert np.isnan([mixed.moment[0], mixed.tangent_stiffness[0], mixed.slip[0]]).all()
    assert mixed.moment[2] == pytest.approx(smooth.moment[0], rel=1e-12)


@pytest.mark.parametrize(("name", "is_shaken"), [("A2", False), ("C4", False), ("A2", True)])
def test_the_range_over_orientations_leaves_out_no_turn(name: str, is_shaken: bool) -> None:
    """Strands without order have no symmetry; friction of seven varies by 15 %."""
    section, turns = wire(name), 24
    if is_shaken:
        turns = 7
        away = np.random.default_rng(3).normal(scale=1e-5, size=(2, 7)) * (section.radius > 0.0)
        x, y = section.x + away[0], section.y + away[1]
        section = replace(section, kind="packed", x=x, y=y)
    contacts, kappa = contacts_of(section), np.array([-5.0, 0.05, 5.0, 40.0])
    curve = compute_moment_curve(section, contacts, kappa)
    low, high = compute_orientation_range(section, contacts, curve, n_orientations=turns)
    angles = 2.0 * np.pi * np.arange(turns) / turns
    moments = [compute_moment_curve(section, contacts, kappa, orientation=a).moment for a in angles]
    assert low == pytest.approx(np.min(moments, axis=0), rel=1e-9)
    assert high == pytest.approx(np.max(moments, axis=0), rel=1e-9)
    if name == "A2" and not is_shaken:
        assert 0.12 < float((high - low)[2] / curve.slip[2]) < 0.18


@pytest.mark.parametrize(("name", "largest"), [("A2", 20.0), ("A3", 60.0), ("C4", 150.0)])
def test_a_sharp_yield_does_not_stiffen(name: str, largest: float) -> None:
    sharp = perfectly_plastic(110e9, 60e6)
    table = StressTable((5e-4, 1e-3, 2e-3, 0.02, 0.3), (55e6, 70e6, 80e6, 100e6, 150e6))
    for material in (sharp, table, RambergOsgood(110e9, 300e6, 0.02)):
        section = wire(name, material)
        law = fit_play_law(section, contacts_of(section), largest_curvature=largest)
        assert (law.compliances >= 0.0).all()


def test_no_wire_is_bent_beyond_its_law() -> None:
    section, contacts = wire("A2"), contacts_of(wire("A2"))
    law = fit_play_law(section, contacts, largest_curvature=20.0)
    last = compute_moment_curve(section, contacts, np.array([20.0])).moment[0]
    assert law.largest_moment == pytest.approx(last, rel=1e-12)
    rig, rest = StringRig(0.76, 0.02, 0.085, 0.76), make_straight(law)
    message = r"expected curvatures up to 20 1/m, the end of the law, found [2-9]\d(\.\d+)? 1/m"
    with pytest.raises(ValueError, match=message):
        bend_to_deflection(law, rest, 0.085, 0.05)
    with pytest.raises(ValueError, match=message):
        bend_to_travel(law, rest, 0.085, rig, 0.05)
    with pytest.raises(ValueError, match=message):
        bend_under_force(law, rest, 0.085, np.array([0.0, 0.5]))


def test_tension_is_shared_by_stiffness_and_holds_the_strands() -> None:
    section, contacts = cardinal(), make_contacts(4, strand=0.5, insulation=0.0, radial_force=0.0)
    strain, kappa = compute_axial_strain(section, 40e3), np.array([0.1])
    pull = sum(
        lay.count * lay.material.modulus * lay.area * strain * np.cos(lay.lay_angle) ** 3
        for lay in section.layers
    )
    assert pull == pytest.approx(40e3)
    slack, taut = (
        compute_moment_curve(section, contacts, kappa, tension=pull).moment[0]
        for pull in (0.0, 40e3)
    )
    assert slack == pytest.approx(compute_slip_stiffness(section) * 0.1, rel=1e-6)
    assert taut > 1.5 * slack


@pytest.mark.parametrize("name", ["A2", "A3", "C4"])
def test_plays_follow_first_loading_and_unload_as_strands_do(name: str) -> None:
    section, contacts = wire(name), contacts_of(wire(name))
    law = fit_play_law(section, contacts, largest_curvature=40.0)
    curvature = np.geomspace(1e-4, 39.9, 500)
    moment = compute_moment_curve(section, contacts, curvature).moment
    bent = law.respond(moment, law.make_unbent_history(500)).curvature
    assert bent == pytest.approx(curvature, rel=3e-3)
    path = np.concatenate([np.linspace(0.1, 20.0, 80), np.linspace(20.0, -20.0, 81)])
    moment = bend_along(section, contacts, path)
    peak = law.respond(moment[79:80], law.make_unbent_history(1))
    back = law.respond(moment[120:121], peak.history)
    # Friction differs by 7 % between the sides: a small part of a small part of the moment.
    assert back.curvature[0] == pytest.approx(path[120], abs=0.01 * 20.0)


BENT = np.geomspace(1e-3, 60.0, 12)


def plain_wire(name: str) -> plain_loop.PlainWire:
    wire_diameter, _, diameter = WIRES[name]
    layers = layers_of(name)
    counts, lays = [layer.count for layer in layers], [layer.lay_angle for layer in layers]
    x, y = plain_loop.hexagon(counts, diameter)
    return plain_loop.PlainWire(
        counts, [diameter] * len(layers), lays, x, y, wire_diameter, wall=0.3e-3
    )


@pytest.mark.parametrize("name", sorted(WIRES))
def test_moment_of_the_sources_wires(name: str) -> None:
    """40 laminae of the script are within 0.07 %, 400 within 0.003 %."""
    found = compute_moment_curve(wire(name), contacts_of(wire(name)), BENT).moment
    coarse = plain_loop.moments(plain_wire(name), BENT.tolist())
    assert found == pytest.approx(coarse, rel=7e-4)
    if name == "A2":
        fine = plain_loop.moments(plain_wire(name), BENT.tolist(), laminae=400)
        assert found == pytest.approx(fine, rel=3e-5)


MODULUS, NU, YIELD = 110e9, 0.34, 60e6

CURVATURES: Floats = np.array([1e-3, 0.05, 0.4, 3.0, 20.0, 60.0])


@dataclass(frozen=True)
class Drawn:
    """A wire without its material and friction."""

    counts: tuple[int, ...]
    diameters: tuple[float, ...]
    lays: tuple[float, ...]

    def section(self, material: Material) -> CrossSection:
        layers = tuple(
            Layer(count, diameter, lay, material, NU)
            for count, diameter, lay in zip(self.counts, self.diameters, self.lays, strict=True)
        )
        free = place_rings(layers)
        bore = float(free.radius.max()) + self.diameters[-1] / 2.0
        return replace(free, insulation=Insulation(bore, 0.2e-3, 1e9))

    def contacts(self, strand: float, insulation: float, force: float) -> Contacts:
        rings = len(self.counts) - (self.counts[0] == 1)
        outer = (*[strand] * (rings - 1), insulation)[:rings]
        return Contacts((strand,) * rings, outer, radial_force=force)


@st.composite
def wires(draw: st.DrawFn) -> Drawn:
    first = draw(st.sampled_from([1, 1, 1, 3, 4]))
    diameters = [draw(st.floats(0.15e-3, 0.4e-3))]
    counts, lays = [first], [0.0 if first == 1 else draw(st.floats(0.05, 0.7))]
    radius = 0.0 if first == 1 else diameters[0] / (2.0 * np.sin(np.pi / first))
    for _ in range(draw(st.integers(int(first == 1), 3))):
        d = draw(st.floats(0.15e-3, 0.4e-3))
        radius += (diameters[-1] + d) / 2.0
        room = int(np.pi / np.arcsin(min(1.0, d / (2.0 * radius))) + 1e-9)
        counts.append(draw(st.integers(min(2, room), room)))
        diameters.append(d)
        lays.append(draw(st.floats(0.05, 0.78)) * draw(st.sampled_from([-1.0, 1.0])))
    return Drawn(tuple(counts), tuple(diameters), tuple(lays))


def factor(lay: float) -> float:
    c = np.cos(lay)
    return float(c / 2.0 * (1.0 + c**2 + np.sin(lay) ** 2 / (1.0 + NU)))


def own_stiffness(drawn: Drawn) -> float:
    return sum(
        n * factor(a) * MODULUS * np.pi * d**4 / 64.0
        for n, d, a in zip(drawn.counts, drawn.diameters, drawn.lays, strict=True)
    )


def steiner(drawn: Drawn, section: CrossSection, orientation: float) -> float:
    """Sum of E A y^2 cos^3(alpha) over strands, y from the neutral axis."""
    total = 0.0
    for x, y, layer in zip(section.x, section.y, section.layer, strict=True):
        height = y * np.cos(orientation) + x * np.sin(orientation)
        area = np.pi * drawn.diameters[layer] ** 2 / 4.0
        total += MODULUS * area * height**2 * np.cos(drawn.lays[layer]) ** 3
    return float(total)


@given(wires(), st.floats(0.0, 6.3))
def test_endless_radial_force_is_stick_and_none_is_slip(drawn: Drawn, turn: float) -> None:
    section = drawn.section(elastic(MODULUS))
    assert section.insulation is not None
    bore = 2.0 * section.insulation.bore_radius
    tube = 1e9 * np.pi / 64.0 * ((bore + 0.4e-3) ** 4 - bore**4)
    own = own_stiffness(drawn) + tube
    stuck = own + steiner(drawn, section, turn)
    tight = drawn.contacts(0.3, 0.2, 1e12)
    curve = compute_moment_curve(section, tight, CURVATURES, orientation=turn)
    assert curve.moment == pytest.approx(stuck * CURVATURES, rel=1e-9)
    assert curve.slip == pytest.approx(0.0, abs=1e-12 * stuck)
    for loose in (drawn.contacts(0.3, 0.2, 0.0), drawn.contacts(0.0, 0.0, 5.0)):
        free = compute_moment_curve(section, loose, CURVATURES, orientation=turn)
        assert free.moment == pytest.approx(own * CURVATURES, rel=1e-9)
    assert compute_slip_stiffness(section) == pytest.approx(own)
    assert compute_stick_stiffness(section, orientation=turn) == pytest.approx(stuck)
    level = own + steiner(drawn, section, 0.0)
    assert compute_stick_stiffness(section) == pytest.approx(level)
    assert curve.tangent_stiffness == pytest.approx(stuck)


@given(wires())
def test_plateau_of_a_wire_that_yields_perfectly(drawn: Drawn) -> None:
    """Without friction and insulation: yield stress d^3 / 6 of each strand, by its factor."""
    section = drawn.section(perfectly_plastic(MODULUS, YIELD))
    plateau = sum(
        n * factor(a) * YIELD * d**3 / 6.0
        for n, d, a in zip(drawn.counts, drawn.diameters, drawn.lays, strict=True)
    )
    loose = drawn.contacts(0.0, 0.0, 0.0)
    bare = replace(section, insulation=None)
    found = compute_moment_curve(bare, loose, np.array([1500.0, 2000.0]))
    assert found.moment == pytest.approx([plateau] * 2, rel=2e-4)
    assert np.all(np.abs(found.tangent_stiffness) < 1e-4 * own_stiffness(drawn))


NAMES = st.sampled_from(["A1", "A2", "A3", "C4"])
FRICTION = st.floats(0.0, 0.8)
PRESS = st.floats(0.0, 3.0)


@given(NAMES, FRICTION, PRESS, st.floats(0.1, 40.0), st.floats(0.0, 6.3))
def test_first_loading_is_the_monotonic_law(
    name: str, friction: float, press: float, peak: float, turn: float
) -> None:
    section = wire(name)
    rings = len(section.layers) - 1
    contacts = make_contacts(rings, strand=friction, insulation=friction / 2.0, radial_force=press)
    for way in (peak * np.linspace(0.05, 1.0, 20), -peak * np.linspace(0.05, 1.0, 20)):
        found = bend_along(section, contacts, way, orientation=turn)
        law = compute_moment_curve(section, contacts, way, orientation=turn).moment
        assert found == pytest.approx(law, rel=1e-9)
