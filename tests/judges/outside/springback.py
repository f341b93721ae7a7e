"""What a bent wire keeps: bars summed up fibre by fibre, released by two rules of hardening.

Shares nothing with the package but the stress-strain curve of first loading. *Kinematic* is
Masing's rule in every fibre, which the package has for whole wires; *isotropic* unloads with the
modulus until a fibre carries as much the other way as it did before, and hardens on from there.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from scipy.optimize import brentq

from labpipe.law.play_fits import polygon_law
from labpipe.records.arrays import Floats
from labpipe.wire.cantilever import bend_to_deflection, bend_under_force, straight
from labpipe.wire.materials import ANNEALED_COPPER, RambergOsgood
from labpipe.wire.strand_bending import helix_factor
from labpipe.wire.wire_table import wire_table
from tests.builders.wire_tables import spec_of

Rule: TypeAlias = Callable[[RambergOsgood, Floats, Floats], Floats]
FIRMER = RambergOsgood(110e9, 455e6, 0.343, "another handbook's curve")
WIRES = {
    0.274: (12.5, 61),
    0.315: (19.0, 62),
    0.508: (25.0, 48),
    0.813: (50.0, 51),
    1.219: (50.0, 39),
}
"""Diameter of annealed copper, mm: of the mandrel, mm, and degrees of a turn that are allowed.

Of winding wires with the thickest enamel (grade 3), IS 13730 and IS 13778, as a maker's page has
them: avanticables.com, *Elongation and springiness for enamelled round copper winding wires*.
"""
CURVATURES = (5.0, 12.0, 23.5, 37.5)


def kinematic(copper: RambergOsgood, before: Floats, now: Floats) -> Floats:
    """Stress at strains below those of a first loading, by Masing's rule."""
    return copper.stress(before) - 2.0 * copper.stress((before - now) / 2.0)


def isotropic(copper: RambergOsgood, before: Floats, now: Floats) -> Floats:
    """The same with the modulus, until the stress is as large the other way."""
    top = copper.stress(before)
    falls = top - copper.modulus * (before - now)
    beyond = np.sign(top) * (np.abs(before - now) - 2.0 * np.abs(top) / copper.modulus)
    # what is left of the way is spent along the curve of first loading, from where it had been
    onward = copper.stress(before + np.where(np.abs(falls) > np.abs(top), beyond, 0.0))
    return np.where(np.abs(falls) > np.abs(top), -onward, falls)


_BARS = 1.0 + 6.0 * helix_factor(float(np.radians(12.0)), 0.34)
"""Strands of A2, each as stiff as a straight one times its helix factor."""
_WALL = np.pi / 64.0 * (1.6e-3**4 - 1.0e-3**4)
"""Second moment of its insulation, m^4."""


def _fibres(diameter: float) -> tuple[Floats, Floats]:
    """Heights and areas of the fibres of a round bar."""
    roots, weights = np.polynomial.legendre.leggauss(200)
    height = roots * diameter / 2.0
    return height, weights * diameter * np.sqrt(diameter**2 / 4.0 - height**2)


def kept(
    rule: Rule,
    copper: RambergOsgood,
    diameter: float,
    curvature: float,
    *,
    wall: float = 0.0,
    bars: float = 1.0,
) -> float:
    """Share of a curvature that some bars keep, with a wall of so much bending stiffness."""
    height, area = _fibres(diameter)

    def moment(share: float) -> float:
        stress = rule(copper, curvature * height, share * curvature * height)
        return wall * share * curvature + bars * float(stress * height @ area)

    return float(brentq(moment, 0.0, 1.0))


def springback(rule: Rule, copper: RambergOsgood, diameter_mm: float) -> float:
    """Degrees by which each turn around its mandrel springs back."""
    mandrel = WIRES[diameter_mm][0]
    curvature = 2e3 / (mandrel + diameter_mm)
    return 360.0 * (1.0 - kept(rule, copper, diameter_mm * 1e-3, curvature))


def kept_of_a2(rule: Rule, modulus: float, curvature: float) -> float:
    """Share of a curvature that A2 keeps, strands that slip without friction in a straight wall."""
    return kept(rule, ANNEALED_COPPER, 0.32e-3, curvature, wall=modulus * _WALL, bars=_BARS)


def left_of_a2() -> float:
    """Deflection that the package leaves of A2 after 50 mm on 85 mm, m."""
    table = wire_table(spec_of("A2", "A2"))
    law = polygon_law(table.curvature[1:], table.moment[1:])
    bent = bend_to_deflection(law, straight(law, 60), 85e-3, 50e-3)
    return float(bend_under_force(law, bent.state, 85e-3, np.zeros(2)).y[-1])
