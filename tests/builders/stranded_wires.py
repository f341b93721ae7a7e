"""Wires of the source's Tables 2.1 and 3.4, and a conductor of steel and aluminium."""

from __future__ import annotations

import numpy as np

from labpipe.mechanics.wire.bending_law import Contacts, make_contacts
from labpipe.mechanics.wire.cross_section import (
    CrossSection,
    Insulation,
    Layer,
    lay_up,
    place_hexagon,
    place_rings,
)
from labpipe.mechanics.wire.materials import ANNEALED_COPPER, Material, StressTable

LAYS = {7: (12.0,), 19: (12.0, -15.0), 37: (12.0, -15.0, 12.0)}
WIRES = {
    "A1": (1.4e-3, 7, 0.26e-3),
    "A2": (1.6e-3, 7, 0.32e-3),
    "A3": (1.8e-3, 19, 0.24e-3),
    "C1": (1.4e-3, 19, 0.16e-3),
    "C2": (1.6e-3, 19, 0.19e-3),
    "C3": (1.8e-3, 19, 0.23e-3),
    "C4": (2.1e-3, 37, 0.21e-3),
    "C5": (2.6e-3, 37, 0.26e-3),
}
"""Diameter of the wire, number and diameter of its strands."""


def tube(wire_diameter: float, thickness: float = 0.3e-3, modulus: float = 1e9) -> Insulation:
    return Insulation(wire_diameter / 2.0 - thickness, thickness, modulus)


def layers_of(
    name: str, material: Material = ANNEALED_COPPER, *, mirrored: bool = False
) -> tuple[Layer, ...]:
    _, strands, diameter = WIRES[name]
    sign = -1.0 if mirrored else 1.0
    return lay_up(strands, diameter, [sign * np.radians(a) for a in LAYS[strands]], material)


def wire(
    name: str, material: Material = ANNEALED_COPPER, *, mirrored: bool = False
) -> CrossSection:
    return place_hexagon(layers_of(name, material, mirrored=mirrored), tube(WIRES[name][0]))


def contacts_of(section: CrossSection, radial_force: float = 0.15) -> Contacts:
    rings = len(section.layers) - 1
    return make_contacts(rings, strand=0.21, insulation=0.10, radial_force=radial_force)


def cardinal() -> CrossSection:
    """ACSR Cardinal: steel 1 + 6, aluminium 12 + 18 + 24."""
    steel, aluminium = elastic(207e9), elastic(68e9)
    rings = [
        (1, 3.34e-3, 0.0, steel),
        (6, 3.34e-3, 5.695, steel),
        (12, 3.32e-3, 10.952, aluminium),
        (18, 3.32e-3, -11.708, aluminium),
        (24, 3.32e-3, 13.103, aluminium),
    ]
    return place_rings(
        tuple(
            Layer(count, diameter, float(np.radians(angle)), material, 0.3)
            for count, diameter, angle, material in rings
        )
    )


def elastic(modulus: float) -> StressTable:
    return StressTable((1e3,), (1e3 * modulus,))


def perfectly_plastic(modulus: float, yield_stress: float) -> StressTable:
    return StressTable((yield_stress / modulus, 1e3), (yield_stress, yield_stress))
