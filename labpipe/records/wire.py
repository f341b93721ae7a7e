"""Define the records of wires: specification, layout of strands, table of the wire model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np

from labpipe.records.arrays import ArrayRecord, Flags, Floats, Ints, Vector
from labpipe.records.quality import QualityNote

AUTO = "auto"
"""Choice of the layout: a hexagon if it fits, else rings if they fit, else a packing."""

LAYOUTS = (AUTO, "hexagonal", "concentric", "packed", "compressed")
"""Layouts in a wire sheet."""


@dataclass(frozen=True, slots=True)
class WireSpec:
    """One row of a wire sheet, in SI units; defaults apply to missing columns.

    Parameters
    ----------
    name : of the wire
    wire_diameter : over the insulation, m
    layer_counts : strands of each layer from the axis outwards, 1 for a core
    strand_diameters : m, of the strands of each layer; for compressed strands the diameter of a
        circle of equal area
    lay_angles : rad, signed, one per ring (the core has none)
    insulation_thickness : wall, m
    insulation_modulus, conductor_modulus : Pa
    poisson, insulation_poisson : of the strands, and of the insulation
    copper_k : strength of the Ramberg-Osgood curve, Pa
    copper_n : its exponent
    isotropic_share : share of the strands' hardening that is isotropic, from 0 to 1; None if it is
        not known
    stress_table : strains and stresses (Pa) that replace the Ramberg-Osgood curve
    insulation_table : strains and stresses (Pa) that replace the modulus of the insulation
    insulation_strain : strain at the rim of the wire up to which the insulation is linear
    friction_strand : between strands
    friction_insulation : between the outermost ring and the insulation
    radial_force : of the insulation on a strand of the outermost ring, N per radian of its lay
    layout : one of `LAYOUTS`
    layer_radii : m, of the centroids of the strands in compressed layers; None if unknown
    mass_per_length : kg/m; None to compute it from section and densities
    conductor_density, insulation_density : kg/m^3
    length : free length of the cantilever, m
    tension : of the wire, N
    orientation : of the section against the neutral axis, rad
    largest_curvature : 1/m, end of the tables; None for a bending radius of five wire diameters
    defaults : description of each default that was used, by field
    place : of the row, for messages, such as ``sheet 'wires', row 4``
    """

    name: str
    wire_diameter: float
    layer_counts: tuple[int, ...]
    strand_diameters: tuple[float, ...]
    lay_angles: tuple[float, ...]
    insulation_thickness: float
    insulation_modulus: float = 1.0e9
    conductor_modulus: float = 110.0e9
    poisson: float = 0.34
    insulation_poisson: float = 0.4
    copper_k: float = 530.0e6
    copper_n: float = 0.44
    isotropic_share: float | None = None
    stress_table: tuple[tuple[float, ...], tuple[float, ...]] | None = None
    insulation_table: tuple[tuple[float, ...], tuple[float, ...]] | None = None
    insulation_strain: float = 0.03
    friction_strand: float = 0.21
    friction_insulation: float = 0.10
    radial_force: float = 0.15
    layout: str = AUTO
    layer_radii: tuple[float, ...] | None = None
    mass_per_length: float | None = None
    conductor_density: float = 8960.0
    insulation_density: float = 1400.0
    length: float = 85.0e-3
    tension: float = 0.0
    orientation: float = 0.0
    largest_curvature: float | None = None
    defaults: Mapping[str, str] = field(default_factory=dict)
    place: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class WireLayout(ArrayRecord):
    """Positions of the strands; arrays of shape (strands,).

    Parameters
    ----------
    kind : name of the layout
    x, y : m, strand centres
    layer : index of the layer, 0 for the innermost
    diameter : m, of each strand
    bore_radius, wire_radius : m, inner and outer radius of the insulation
    """

    kind: str
    x: Vector
    y: Vector
    layer: Annotated[Ints, "n"]
    diameter: Vector
    bore_radius: float
    wire_radius: float


@dataclass(frozen=True, slots=True)
class WireAtRest:
    """State of a cantilever under its own weight with its tip held level.

    Parameters
    ----------
    force : N, at the tip; removed by the zero of a load cell
    moment : N m, at the clamp; negative: it bends the wire away from the pull
    curvature : 1/m, at the clamp
    sag : m, lowest point below the axis
    """

    force: float
    moment: float
    curvature: float
    sag: float


@dataclass(frozen=True, slots=True, eq=False)
class WireTable(ArrayRecord):
    """The law of a wire on first loading, and its stiffnesses; arrays of shape (n,).

    Parameters
    ----------
    name : of the wire
    spec : specification
    layout : positions of the strands
    curvature : 1/m, from 0, increasing, to the end of the range
    moment : N m, sum of the five parts
    stick, slip, bending, plastic, insulation : N m, parts of the moment
    tangent_stiffness, secant_stiffness : N m^2
    stick_stiffness, slip_stiffness : N m^2
    axial_stiffness : EA, N, at zero twist
    torsional_stiffness : GJ, N m^2, at zero axial strain
    free_torsional_stiffness : N m^2, at zero axial force: GJ - C^2 / EA
    stretch_twist_coupling : C, N m: torque per strain, and axial force per twist in rad/m
    slip_onsets : 1/m, curvatures at which strands begin to slip, increasing; the first is 0 if
        strands slip as soon as the wire bends
    lowest_moment, highest_moment : N m, over all orientations of the section
    tip_deflection, tip_force : shape (m,), m and N, of the cantilever of `spec.length` under an
        end load normal to the clamped axis, both from rest
    mass_per_length : kg/m
    rest : state of that cantilever at rest; None if its weight is neglected
    doubtful_curvature, doubtful_deflection : 1/m and m, beyond which the strain at the rim exceeds
        `spec.insulation_strain`; infinite for a stress table
    notes : on defaults and limits
    """

    name: str
    spec: WireSpec
    layout: WireLayout
    curvature: Vector
    moment: Vector
    stick: Vector
    slip: Vector
    bending: Vector
    plastic: Vector
    insulation: Vector
    tangent_stiffness: Vector
    secant_stiffness: Vector
    stick_stiffness: float
    slip_stiffness: float
    axial_stiffness: float
    torsional_stiffness: float
    free_torsional_stiffness: float
    stretch_twist_coupling: float
    slip_onsets: Annotated[Floats, "onsets"]
    lowest_moment: Vector
    highest_moment: Vector
    tip_deflection: Annotated[Floats, "points"]
    tip_force: Annotated[Floats, "points"]
    mass_per_length: float
    rest: WireAtRest | None
    doubtful_curvature: float
    doubtful_deflection: float
    notes: tuple[QualityNote, ...] = ()

    @property
    def is_doubtful(self) -> Flags:
        """Return whether each curvature is beyond `doubtful_curvature`, shape (n,)."""
        return np.asarray(self.curvature > self.doubtful_curvature)

    @property
    def insulation_share(self) -> Floats:
        """Return the share of the insulation in the moment, shape (n,).

        At zero moment it is that of the second curvature.
        """
        is_zero = self.moment == 0.0
        share = self.insulation / np.where(is_zero, 1.0, self.moment)
        return np.asarray(np.where(is_zero, share[1], share))

    @property
    def slips_at_once(self) -> bool:
        """Return whether strands slip as soon as the wire bends, without stick stiffness.

        The first secant of the table is then the slope of the law at zero curvature.
        """
        return bool(np.any(self.slip_onsets == 0.0))

    def slip_onset(self, which: int) -> float | str:
        """Return the curvature at which strands begin to slip, or a word if there is none.

        Parameters
        ----------
        which : 0 for the first onset, -1 for the last

        Returns
        -------
        1/m; ``at once`` if strands slip as soon as the wire bends, ``beyond`` if none slips within
        the range, ``none`` for a single strand.
        """
        if len(self.layout.layer) == 1:
            return "none"
        onsets = self.slip_onsets[self.slip_onsets <= self.curvature[-1]]
        if not len(onsets):
            return "beyond"
        return float(onsets[which]) or "at once"
