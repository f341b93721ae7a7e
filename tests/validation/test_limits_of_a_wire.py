"""What must hold for any wire, against closed forms written out here: hypothesis draws the wires.

Sections of one to three rings of different strands around a core, or none, with lay angles of
either hand up to 45 degrees.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from labpipe.records.arrays import Floats
from labpipe.wire.bending_law import moment_curvature, slip_stiffness, stick_stiffness
from labpipe.wire.cross_section import CrossSection, Insulation, Layer, concentric
from labpipe.wire.friction import Contacts
from labpipe.wire.materials import Elastic, ElasticPerfectlyPlastic, Material, RambergOsgood

MODULUS, NU, YIELD = 110e9, 0.34, 60e6
SOFT = RambergOsgood(MODULUS, 530e6, 0.44)
KAPPA: Floats = np.array([1e-3, 0.05, 0.4, 3.0, 20.0, 60.0])


@dataclass(frozen=True)
class Drawn:
    """A wire without its material and friction."""

    counts: tuple[int, ...]
    diameters: tuple[float, ...]
    lays: tuple[float, ...]

    def section(self, material: Material, *, scale: float = 1.0, hand: float = 1.0) -> CrossSection:
        layers = tuple(
            Layer(n, scale * d, hand * a, material, NU)
            for n, d, a in zip(self.counts, self.diameters, self.lays, strict=True)
        )
        free = concentric(layers)
        bore = float(free.radius.max()) + scale * self.diameters[-1] / 2.0
        return replace(free, insulation=Insulation(bore, scale * 0.2e-3, 1e9))

    def contacts(self, strand: float, insulation: float, force: float) -> Contacts:
        rings = len(self.counts) - (self.counts[0] == 1)
        return Contacts(
            (strand,) * rings, (*[strand] * (rings - 1), insulation)[:rings], radial_force=force
        )


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


def tube_of(section: CrossSection) -> Insulation:
    assert section.insulation is not None
    return section.insulation


def tube_stiffness(section: CrossSection) -> float:
    tube = tube_of(section)
    outer, inner = 2.0 * (tube.bore_radius + tube.thickness), 2.0 * tube.bore_radius
    return float(tube.modulus * np.pi / 64.0 * (outer**4 - inner**4))


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
    section = drawn.section(Elastic(MODULUS))
    own = own_stiffness(drawn) + tube_stiffness(section)
    stuck = own + steiner(drawn, section, turn)
    tight = drawn.contacts(0.3, 0.2, 1e12)
    found = moment_curvature(section, tight, KAPPA, orientation=turn)
    assert found.moment == pytest.approx(stuck * KAPPA, rel=1e-9)
    assert found.slip == pytest.approx(0.0, abs=1e-12 * stuck)
    for loose in (drawn.contacts(0.3, 0.2, 0.0), drawn.contacts(0.0, 0.0, 5.0)):
        free = moment_curvature(section, loose, KAPPA, orientation=turn)
        assert free.moment == pytest.approx(own * KAPPA, rel=1e-9)
    assert slip_stiffness(section) == pytest.approx(own)


@given(wires(), st.floats(0.0, 6.3), st.floats(0.01, 1.0), st.floats(0.0, 2.0))
def test_friction_lies_between_slip_and_stick(
    drawn: Drawn, turn: float, friction: float, force: float
) -> None:
    section = drawn.section(Elastic(MODULUS))
    low = own_stiffness(drawn) + tube_stiffness(section)
    high = low + steiner(drawn, section, turn)
    contacts = drawn.contacts(friction, friction / 2.0, force)
    found = moment_curvature(section, contacts, KAPPA, orientation=turn)
    assert np.all(found.secant_stiffness >= low * (1.0 - 1e-12))
    assert np.all(found.secant_stiffness <= high * (1.0 + 1e-12))


@given(wires())
def test_plateau_of_a_wire_that_yields_perfectly(drawn: Drawn) -> None:
    """Without friction and insulation: yield stress d^3 / 6 of each strand, by its factor."""
    section = drawn.section(ElasticPerfectlyPlastic(MODULUS, YIELD))
    plateau = sum(
        n * factor(a) * YIELD * d**3 / 6.0
        for n, d, a in zip(drawn.counts, drawn.diameters, drawn.lays, strict=True)
    )
    loose = drawn.contacts(0.0, 0.0, 0.0)
    bare = replace(section, insulation=None)
    found = moment_curvature(bare, loose, np.array([1500.0, 2000.0]))
    assert found.moment == pytest.approx([plateau] * 2, rel=2e-4)
    assert np.all(np.abs(found.tangent_stiffness) < 1e-4 * own_stiffness(drawn))


@given(wires(), st.floats(0.2, 5.0))
def test_scaling_of_lengths(drawn: Drawn, c: float) -> None:
    """All lengths by c, radial force by c^2, curvature by 1/c: moment c^3, stiffness c^4."""
    once, large = drawn.section(SOFT), drawn.section(SOFT, scale=c)
    small = moment_curvature(once, drawn.contacts(0.21, 0.1, 0.15), KAPPA)
    found = moment_curvature(large, drawn.contacts(0.21, 0.1, 0.15 * c**2), KAPPA / c)
    assert found.moment == pytest.approx(c**3 * small.moment, rel=1e-9)
    assert found.tangent_stiffness == pytest.approx(c**4 * small.tangent_stiffness, rel=1e-7)
    assert stick_stiffness(large) == pytest.approx(c**4 * stick_stiffness(once))


@given(wires(), st.floats(0.2, 5.0))
def test_scaling_of_moduli(drawn: Drawn, c: float) -> None:
    once = drawn.section(RambergOsgood(MODULUS, 530e6, 0.44))
    stiffer = drawn.section(RambergOsgood(c * MODULUS, c * 530e6, 0.44))
    stiffer = replace(stiffer, insulation=replace(tube_of(once), modulus=c * 1e9))
    small = moment_curvature(once, drawn.contacts(0.21, 0.1, 0.15), KAPPA)
    found = moment_curvature(stiffer, drawn.contacts(0.21, 0.1, 0.15 * c), KAPPA)
    assert found.moment == pytest.approx(c * small.moment, rel=1e-9)


@given(wires(), st.floats(0.0, 6.3))
def test_both_hands_of_lay_bend_alike(drawn: Drawn, turn: float) -> None:
    contacts = drawn.contacts(0.4, 0.2, 0.15)
    right, left = (
        moment_curvature(drawn.section(SOFT, hand=hand), contacts, KAPPA, orientation=turn).moment
        for hand in (1.0, -1.0)
    )
    assert right == pytest.approx(left, rel=1e-13)
    mirrored = drawn.section(SOFT)
    mirrored = replace(mirrored, x=-mirrored.x)
    found = moment_curvature(mirrored, contacts, KAPPA, orientation=-turn).moment
    assert found == pytest.approx(right, rel=1e-9)


@given(wires(), st.floats(0.0, 6.3), st.floats(0.0, 6.3))
def test_stick_does_not_know_the_orientation(drawn: Drawn, one: float, other: float) -> None:
    """Of rings of three strands or more; two lie in a plane, and that plane has a direction."""
    assume(2 not in drawn.counts)
    section = drawn.section(Elastic(MODULUS))
    tight = drawn.contacts(0.3, 0.2, 1e12)
    at = [moment_curvature(section, tight, KAPPA, orientation=turn) for turn in (one, other)]
    assert at[0].moment == pytest.approx(at[1].moment, rel=1e-9)
    assert at[0].moment == pytest.approx(stick_stiffness(section) * KAPPA, rel=1e-9)


@given(wires(), st.floats(0.0, 6.3))
def test_half_a_turn_is_the_other_sign(drawn: Drawn, turn: float) -> None:
    contacts = drawn.contacts(0.4, 0.2, 0.15)
    section = drawn.section(SOFT)
    there = moment_curvature(section, contacts, KAPPA, orientation=turn + np.pi).moment
    back = moment_curvature(section, contacts, -KAPPA, orientation=turn).moment
    assert there == pytest.approx(-back, rel=1e-9)
