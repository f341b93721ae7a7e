"""Specimens of the virtual rigs: wires defined by their law or by their strands, and bars.

The law of a stranded wire is that of first loading of `wire.bending_law`, as plays (`play_law`
there): after a reversal strands slip and copper yields in the other direction at twice the size
(Masing). Calibrations use the same physics, but another solution: `virtual_lab.cantilever_path`
bends the wire station by station with a history, calibrations use the first integral. Bundles of
wires are in `virtual_lab.bundles`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace

import numpy as np

from labpipe.law.plays import LinearLaw, PlayLaw, stick_slip_law
from labpipe.records.wire_calibration import COPPER_SCALE, INSULATION_MODULUS, RADIAL_FRICTION
from labpipe.wire.bending_law import play_law
from labpipe.wire.cross_section import (
    CrossSection,
    Insulation,
    compressed,
    hexagonal,
    lay_up,
    strand_diameter,
)
from labpipe.wire.friction import Contacts, insulated
from labpipe.wire.materials import ANNEALED_COPPER


def scaled_law(law: PlayLaw, factor: float, later_slip: float = 1.0) -> PlayLaw:
    """Return the law with moments `factor` times as large at given curvatures.

    Parameters
    ----------
    law : of the plain specimen
    factor : of a sample
    later_slip : factor on moments and curvatures of slip
    """
    return PlayLaw(
        law.stiffness * factor,
        law.half_widths * factor * later_slip,
        law.compliances / factor,
        law.largest_moment * factor * later_slip,
    )


@dataclass(frozen=True, slots=True)
class ElasticModel:
    """An elastic bar, to compare the rig with textbooks.

    Parameters
    ----------
    stiffness : N m^2
    mass_per_length : kg/m
    """

    stiffness: float
    mass_per_length: float = 0.0

    def law(self) -> LinearLaw:
        """Return the law."""
        return LinearLaw(self.stiffness)


@dataclass(frozen=True, slots=True)
class WireModel:
    """A wire defined by the parameters of its law (`law.plays.stick_slip_law`).

    Parameters
    ----------
    stick_stiffness : N m^2, of the first response and of unloading
    stick_moment : N m, up to which everything sticks
    slip_stiffness : N m^2, secant stiffness of the power law at `reference_moment` beyond that
    reference_moment : N m
    hardening : exponent, 0 to 1
    last_moment : N m, up to which the law is followed
    n_plays : number of plays
    mass_per_length : kg/m
    """

    stick_stiffness: float = 5.0e-3
    stick_moment: float = 0.002
    slip_stiffness: float = 5.0e-3
    reference_moment: float = 0.05
    hardening: float = 0.5
    last_moment: float = 0.3
    n_plays: int = 40
    mass_per_length: float = 0.0

    def law(self) -> PlayLaw:
        """Return the law."""
        numbers = asdict(self)
        del numbers["mass_per_length"]
        return stick_slip_law(**numbers)

    def scaled(self, factor: float) -> WireModel:
        """Return the wire with all moments at a given curvature multiplied by `factor`."""
        return replace(
            self,
            stick_stiffness=self.stick_stiffness * factor,
            stick_moment=self.stick_moment * factor,
            slip_stiffness=self.slip_stiffness * factor,
            reference_moment=self.reference_moment * factor,
            last_moment=self.last_moment * factor,
        )


@dataclass(frozen=True, slots=True)
class StrandedWire:
    """A wire of 7, 19 or 37 equal copper strands in a tube of insulation.

    Parameters
    ----------
    name : of the type
    n_strands : with the core
    strand : m, diameter of a strand; of a compressed one, that of the circle with its area
    lay_angles : rad, signed, one for each ring
    diameter : m, over the insulation
    wall : m, of the insulation
    is_compressed : the strands are compressed without gaps; else they form a hexagon
    friction_strand, friction_insulation : coefficients mu_s and mu_p
    radial_force : F_rad of the insulation, N per radian of lay and strand of the outermost ring
    insulation_modulus : Pa
    copper_scale : factor on the strength of annealed copper
    factor : of this sample on all moments at given curvatures
    largest_curvature : 1/m, end of the law; it is extrapolated linearly
    n_plays : corners of the law, besides the onsets of slip
    """

    name: str
    n_strands: int
    strand: float
    lay_angles: tuple[float, ...]
    diameter: float
    wall: float
    is_compressed: bool = False
    friction_strand: float = 0.21
    friction_insulation: float = 0.10
    radial_force: float = 0.15
    insulation_modulus: float = 1e9
    copper_scale: float = 1.0
    factor: float = 1.0
    largest_curvature: float = 80.0
    n_plays: int = 60

    def section(self) -> CrossSection:
        """Return the section with its strands.

        Raises
        ------
        ValueError
            If they do not fit, or a number is out of range.
        """
        copper = replace(ANNEALED_COPPER, strength=ANNEALED_COPPER.strength * self.copper_scale)
        layers = lay_up(self.n_strands, self.strand, self.lay_angles, copper)
        tube = Insulation(self.diameter / 2.0 - self.wall, self.wall, self.insulation_modulus)
        return compressed(layers, tube) if self.is_compressed else hexagonal(layers, tube)

    def contacts(self) -> Contacts:
        """Return friction and pressure between the layers."""
        return insulated(
            len(self.lay_angles),
            strand=self.friction_strand,
            insulation=self.friction_insulation,
            radial_force=self.radial_force,
        )

    def law(self) -> PlayLaw:
        """Return the law of moment against curvature, with hysteresis.

        Raises
        ------
        ValueError
            As for `section`, and if the law softens or stiffens.
        """
        law = play_law(
            self.section(),
            self.contacts(),
            largest_curvature=self.largest_curvature,
            n_plays=self.n_plays,
        )
        return scaled_law(law, self.factor)

    def scaled(self, factor: float) -> StrandedWire:
        """Return the wire with all moments at a given curvature multiplied by `factor`."""
        return replace(self, factor=self.factor * factor)

    @property
    def mass_per_length(self) -> float:
        """Return the mass per length, kg/m: copper over the strands' length, and PVC."""
        return self.section().mass_per_length()

    @property
    def parameters(self) -> Mapping[str, float]:
        """Return the calibration parameters by their names in `records.calibration`, SI."""
        coefficients = self.friction_strand + self.friction_insulation
        return {
            RADIAL_FRICTION: self.radial_force * coefficients,
            INSULATION_MODULUS: self.insulation_modulus,
            COPPER_SCALE: self.copper_scale,
        }


_ONE_RING = (float(np.radians(12.0)),)
_TWO_RINGS = (*_ONE_RING, float(np.radians(-15.0)))


WIRES = {
    wire.name: wire
    for wire in (
        StrandedWire("A1", 7, 0.26e-3, _ONE_RING, 1.4e-3, 0.3e-3),
        StrandedWire("A2", 7, 0.32e-3, _ONE_RING, 1.6e-3, 0.3e-3),
        StrandedWire("A3", 19, 0.24e-3, _TWO_RINGS, 1.8e-3, 0.3e-3),
        StrandedWire(
            "B1", 7, strand_diameter(0.35e-6, 7), _ONE_RING, 1.1e-3, 0.2e-3, is_compressed=True
        ),
        StrandedWire(
            "B2", 7, strand_diameter(0.49e-6, 7), _ONE_RING, 1.25e-3, 0.2e-3, is_compressed=True
        ),
    )
}
"""Wires of the dissertation's Table 2.1. The copper of B1 and B2 does not fit into its wall of
0.3 mm; here it is 0.2 mm."""
