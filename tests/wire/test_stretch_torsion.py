"""Stretch, torsion and their coupling: limits, and the strain energy of helices by differences."""

from __future__ import annotations

from dataclasses import astuple

import numpy as np
import pytest

from labpipe.mechanics.wire.cross_section import (
    CrossSection,
    Insulation,
    Layer,
    compute_stretch_torsion,
    place_rings,
)
from tests.builders.stranded_wires import elastic

MODULUS, DIAMETER = 1e11, 1e-3

AREA, SECOND = np.pi * DIAMETER**2 / 4.0, np.pi * DIAMETER**4 / 64.0


def rope(angle: float, tube: Insulation | None = None) -> CrossSection:
    copper = elastic(MODULUS)
    return place_rings((Layer(1, DIAMETER, 0.0, copper), Layer(6, DIAMETER, angle, copper)), tube)


def test_a_solid_rod_in_a_tube() -> None:
    tube, core = Insulation(0.5e-3, 0.3e-3, 1e9, 0.45), Layer(1, DIAMETER, 0.0, elastic(MODULUS))
    found = compute_stretch_torsion(place_rings((core,), tube))
    rod = MODULUS / 2.68 * np.pi * DIAMETER**4 / 32.0
    wall = 1e9 / 2.9 * np.pi / 2.0 * (0.8e-3**4 - 0.5e-3**4)
    axial = MODULUS * AREA + 1e9 * np.pi * (0.8e-3**2 - 0.5e-3**2)
    assert astuple(found) == pytest.approx((axial, 0.0, rod + wall))
    straight = compute_stretch_torsion(rope(0.0))
    stiffnesses = (7.0 * MODULUS * AREA, 0.0, 7.0 * MODULUS * SECOND / 1.34)
    assert astuple(straight) == pytest.approx(stiffnesses)
    assert straight.free_torsional_stiffness == straight.torsional_stiffness


def stored(angle: float, strain: float, twist: float) -> float:
    """Energy per length of six helices that are stretched as a whole, by their true lengths."""
    before = np.hypot(1.0, np.tan(angle))
    after = np.hypot(1.0 + strain, np.tan(angle) + DIAMETER * twist)  # at the radius of a diameter
    return float(6.0 * 0.5 * MODULUS * AREA * (after / before - 1.0) ** 2 * before)


@pytest.mark.parametrize("angle", [0.3, -0.2])
def test_helices_by_their_strain_energy(angle: float) -> None:
    e, t = 1e-5, 1e-2

    def mixed(strain: float, twist: float) -> float:
        return sum(a * b * stored(angle, a * strain, b * twist) for a in (1, -1) for b in (1, -1))

    found, straight = compute_stretch_torsion(rope(angle)), MODULUS * AREA
    pull = (stored(angle, e, 0.0) + stored(angle, -e, 0.0)) / e**2
    assert found.axial_stiffness == pytest.approx(straight + pull, rel=1e-5)
    assert found.coupling == pytest.approx(mixed(e, t) / (4.0 * e * t), rel=1e-4)
    torque = (stored(angle, 0.0, t) + stored(angle, 0.0, -t)) / t**2
    assert found.torsional_stiffness == pytest.approx(torque + own(angle), rel=1e-5)
    released = found.torsional_stiffness - found.coupling**2 / found.axial_stiffness
    assert found.free_torsional_stiffness == pytest.approx(released)
    assert np.sign(found.coupling) == np.sign(angle)


def own(angle: float) -> float:
    """What strands store by their own twist and bending, for 1 rad/m of the wire, times two."""
    along = 1.0 / np.cos(angle)  # length of strand per length of wire
    tangent = np.array([0.0, np.sin(angle), np.cos(angle)])
    turn = np.array([0.0, 0.0, 1.0]) / along  # of the section per length of strand
    twist = float(turn @ tangent)
    bend = float(np.linalg.norm(turn - twist * tangent))
    helix = MODULUS * SECOND * (twist**2 / 1.34 + bend**2) * along
    return float(MODULUS * SECOND / 1.34 + 6.0 * helix)
