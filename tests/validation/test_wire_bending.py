"""Bending laws against a plain script, a published curve and closed forms.

The plain script is the source's appendix A.4 with its faults put right, and shares no code with
labpipe (`benchmarks/plain_loop.py`); 40 laminae are within 0.07 %, 400 within 0.003 %.
ACSR Cardinal under 40 kN
(friction 0.7, a curve named after Foti) is not insulated: pressure comes from its tension alone.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks import plain_loop
from labpipe.records.arrays import Floats
from labpipe.wire.bending_law import moment_curvature, play_law, slip_stiffness, stick_stiffness
from labpipe.wire.cross_section import CrossSection, Insulation, Layer, concentric
from labpipe.wire.end_load_path import end_load_path
from labpipe.wire.friction import Contacts
from labpipe.wire.materials import Elastic, ElasticPerfectlyPlastic, Material
from labpipe.wire.packing import overlap_energy
from tests.builders.stranded_wires import WIRES, cardinal, contacts_of, layers_of, wire

KAPPA = np.geomspace(1e-3, 60.0, 12)


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
    found = moment_curvature(wire(name), contacts_of(wire(name)), KAPPA).moment
    assert found == pytest.approx(plain_loop.moments(plain_wire(name), KAPPA.tolist()), rel=7e-4)


def test_moment_with_many_laminae() -> None:
    found = moment_curvature(wire("A2"), contacts_of(wire("A2")), KAPPA).moment
    many = plain_loop.moments(plain_wire("A2"), KAPPA.tolist(), laminae=400)
    assert found == pytest.approx(many, rel=3e-5)


@pytest.mark.parametrize("name", ["A2", "C4"])
def test_cantilever_with_the_law_along_the_wire(name: str) -> None:
    """End loads at 10, 30 and 50 mm on 85 mm, taken back to deflections by marching steps."""
    section, contacts = wire(name), contacts_of(wire(name))
    deflections = np.array([0.010, 0.030, 0.050])
    law = play_law(section, contacts, largest_curvature=80.0)
    loads = end_load_path(law, 0.085, deflections).load
    kappa = np.append(0.0, np.geomspace(1e-3, 80.0, 2000))
    moment = moment_curvature(section, contacts, kappa).moment
    marched = [plain_loop.tip_deflection(load, 0.085, kappa, moment) for load in loads]
    assert marched == pytest.approx(deflections, rel=2e-3)


def test_energy_of_overlaps() -> None:
    flat = np.random.default_rng(2).normal(scale=4.0, size=74)
    found, _ = overlap_energy(flat, 1.0, 6.5)
    assert found == pytest.approx(plain_loop.overlap(flat, 1.0, 6.5), rel=1e-12)


TENSION = 40e3

INNER_ONLY = Contacts((0.7,) * 4, (0.0,) * 4)

"""Each layer rubs on what it is pressed against by its own pull and that of the layers outside."""

SHARED = Contacts((0.7,) * 4, (0.35, 0.35, 0.35, 0.0), lay_lengths=True)

"""Sliding against the layer outside is shared between the two; pressure by lay lengths."""


@pytest.fixture(scope="module")
def published(realdata: Path) -> tuple[Floats, Floats]:
    file = realdata / "datasets" / "FLEXION_CARDINAL_H40kN_mu0.7_FOTI.csv"
    curvature, moment = np.loadtxt(file, delimiter=",", skiprows=1).T
    return curvature, moment


def rms(contacts: Contacts, published: tuple[Floats, Floats], orientation: float = 0.0) -> float:
    curvature, moment = published
    found = moment_curvature(
        cardinal(), contacts, curvature, tension=TENSION, orientation=orientation
    )
    return float(np.sqrt(np.mean((found.moment - moment) ** 2)))


def test_stiffness_bounds() -> None:
    """Published 30.2 N m^2 is with cos(alpha) for the helix; the energy average is 0.3 % less."""
    assert slip_stiffness(cardinal()) == pytest.approx(30.2, rel=4e-3)
    assert stick_stiffness(cardinal()) == pytest.approx(1891.0, rel=2e-4)


@pytest.mark.realdata
def test_friction_on_the_inner_side(published: tuple[Floats, Floats]) -> None:
    assert rms(INNER_ONLY, published) <= 3.2


@pytest.mark.realdata
@pytest.mark.parametrize("orientation", [0.0, 0.05, 0.1, 0.2])
def test_lay_lengths_and_shared_sliding_are_closer(
    published: tuple[Floats, Floats], orientation: float
) -> None:
    assert rms(SHARED, published, orientation) <= 1.5


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
        free = concentric(layers)
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
    section = drawn.section(Elastic(MODULUS))
    assert section.insulation is not None
    bore = 2.0 * section.insulation.bore_radius
    tube = 1e9 * np.pi / 64.0 * ((bore + 0.4e-3) ** 4 - bore**4)
    own = own_stiffness(drawn) + tube
    stuck = own + steiner(drawn, section, turn)
    tight = drawn.contacts(0.3, 0.2, 1e12)
    curve = moment_curvature(section, tight, CURVATURES, orientation=turn)
    assert curve.moment == pytest.approx(stuck * CURVATURES, rel=1e-9)
    assert curve.slip == pytest.approx(0.0, abs=1e-12 * stuck)
    for loose in (drawn.contacts(0.3, 0.2, 0.0), drawn.contacts(0.0, 0.0, 5.0)):
        free = moment_curvature(section, loose, CURVATURES, orientation=turn)
        assert free.moment == pytest.approx(own * CURVATURES, rel=1e-9)
    assert slip_stiffness(section) == pytest.approx(own)


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
