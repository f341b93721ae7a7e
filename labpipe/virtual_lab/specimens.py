"""Define the specimens of the virtual rigs and their laws: stranded wires and bundles.

On first loading, a stranded wire follows the law of `wire.bending_law`, represented by plays
(`fit_play_law`). After a reversal, a strand slips or yields in the other direction when the moment
has changed by twice the moment of its first slip or yield (Masing's rule), unless a fraction of the
copper's hardening is isotropic. Calibrations use the same law with the solver `wire.first_loading`,
which solves for all deflections at once; `cantilever_scenarios` solves one position after the other
and keeps the history of the wire.

All wires of a bundle have the same curvature. The moment of the bundle is the sum of the moments of
its wires, each bent about its own axis, of the moments of their axial forces, which are limited by
friction between neighbours and by the tape, and of the moment of an elastic conduit:

    M(kappa) = sum M_i(kappa) + sum |y_i| min(h EA_i |y_i| kappa, T_i)
                              + g min(kappa, e / R) sum over the outer wires EA_i y_i^2
                              + EI_conduit kappa

Here y_i is the distance of a wire from the neutral axis and EA_i the axial stiffness of its copper.
The fractions h and g are effective values, because friction and glue are compliant. Friction
between neighbours carries up to T_i = h EA_i c kappa_s. Here c is the root mean square of y of the
wires off the axis, and kappa_s is the curvature at which a wire at this distance slips. A wire at
twice the distance slips at half of this curvature. Slip causes the kink. The glue of the tape holds
the outer wires until the strain kappa R at the radius R of the bundle is e; then the tape slides on
all of them at once. Sliding causes the plateau, where only single wires and the conduit are stiff.
With these terms alone the force of a cantilever would still increase by 1 % per millimetre, because
the lever arm of a strongly bent bundle becomes shorter. However, a sliding tape holds the bundle
less firmly: moments and curvatures of all corners of the law are multiplied by the larger of
1 - q (kappa_max R / e - 1) and 0.5, where kappa_max is the largest curvature so far. Before the
tape slides, this factor is 1.

Parallel Coulomb sliders are equivalent to plays in series, and their loops follow Masing's rule.
Therefore the law of a bundle is one `PlayLaw`. Wires that have slipped resist the next slip more:
from the second cycle on, moments and curvatures of all corners are multiplied by `locking`.

References
----------
.. [1] *Modeling and characterization of wire harnesses for digital manufacturing applications*,
       dissertation.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from functools import cache, lru_cache
from importlib.resources import files
from typing import Any

import numpy as np

from labpipe.mechanics.law.plays import PlayLaw, find_corners, make_polygon_law, make_stick_slip_law
from labpipe.mechanics.wire.bending_law import Contacts, fit_play_law, harden_plays, make_contacts
from labpipe.mechanics.wire.cross_section import (
    CrossSection,
    Insulation,
    compute_strand_diameter,
    lay_up,
    place_hexagon,
    place_sectors,
)
from labpipe.mechanics.wire.materials import ANNEALED_COPPER
from labpipe.messages import format_sentence
from labpipe.records.arrays import Flags, Floats, Ints
from labpipe.records.harness_bundle import ARRANGEMENTS, NONE
from labpipe.records.wire import COPPER_SCALE, INSULATION_MODULUS, RADIAL_FRICTION


@cache
def read_catalog() -> dict[str, Any]:
    """Read ``catalog.toml``, the tables of specimens and tensile tests."""
    text = (files("labpipe.virtual_lab") / "catalog.toml").read_text(encoding="utf-8")
    return tomllib.loads(text)


def scale_law(law: PlayLaw, factor: float, slip_factor: float = 1.0) -> PlayLaw:
    """Multiply the moments of a law at given curvatures by a factor.

    Parameters
    ----------
    law : law of moment against curvature
    factor : factor on all moments at given curvatures
    slip_factor : further factor on moments and curvatures of the corners and the end of the law
    """
    return PlayLaw(
        law.stiffness * factor,
        law.half_widths * factor * slip_factor,
        law.compliances / factor,
        law.largest_moment * factor * slip_factor,
    )


@dataclass(frozen=True, slots=True)
class WireModel:
    """Wire that is defined by the parameters of its law (`law.plays.make_stick_slip_law`).

    Parameters
    ----------
    stick_stiffness : bending stiffness before any slip and at the start of unloading, N m^2
    stick_moment : moment below which nothing slips, N m
    slip_stiffness : secant stiffness of the power law at `reference_moment` above `stick_moment`,
        N m^2
    reference_moment : moment above `stick_moment` at which `slip_stiffness` is stated, N m
    hardening : exponent of the power law, larger than 0 and smaller than 1
    last_moment : moment of the last point of the law, which continues as a line beyond it, N m
    n_plays : number of plays
    mass_per_length : mass per length, kg/m
    """

    stick_stiffness: float = 5.0e-3
    stick_moment: float = 0.002
    slip_stiffness: float = 5.0e-3
    reference_moment: float = 0.05
    hardening: float = 0.5
    last_moment: float = 0.3
    n_plays: int = 40
    mass_per_length: float = 0.0

    def build_law(self) -> PlayLaw:
        """Build the law of moment against curvature."""
        parameters = asdict(self)
        del parameters["mass_per_length"]
        return make_stick_slip_law(**parameters)


@dataclass(frozen=True, slots=True)
class StrandedWire:
    """Wire of 7, 19 or 37 equal copper strands in a tube of insulation.

    Parameters
    ----------
    name : name of the type
    n_strands : number of strands, including the core
    strand : diameter of a strand, m; for a compressed strand, that of a circle of equal area
    lay_angles : signed lay angle of each ring of strands, rad
    diameter : diameter over the insulation, m
    wall : thickness of the insulation, m
    is_compressed : whether the strands are compressed without gaps; otherwise they form a hexagon
    friction_strand : coefficient of friction mu_s between strands
    friction_insulation : coefficient of friction mu_p between strands and insulation
    radial_force : F_rad of the insulation on a strand of the outer ring, N per radian of lay angle
    insulation_modulus : Young's modulus of the insulation, Pa
    copper_scale : factor on the strength of annealed copper
    isotropic_share : fraction of the copper's hardening that is isotropic; 0 gives Masing's rule
    factor : factor of this sample on all moments at given curvatures
    largest_curvature : curvature at the end of the law, beyond which no equilibrium is solved, 1/m
    n_plays : number of corners of the law, in addition to the onsets of slip
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
    isotropic_share: float = 0.0
    factor: float = 1.0
    largest_curvature: float = 80.0
    n_plays: int = 60

    def build_section(self) -> CrossSection:
        """Build the section with its strands.

        Raises
        ------
        ValueError
            If the strands do not fit into the insulation, or a number is out of range.
        """
        copper = replace(ANNEALED_COPPER, strength=ANNEALED_COPPER.strength * self.copper_scale)
        layers = lay_up(self.n_strands, self.strand, self.lay_angles, copper)
        tube = Insulation(self.diameter / 2.0 - self.wall, self.wall, self.insulation_modulus)
        return place_sectors(layers, tube) if self.is_compressed else place_hexagon(layers, tube)

    def build_contacts(self) -> Contacts:
        """Build the contacts between the layers, with friction and radial force."""
        return make_contacts(
            len(self.lay_angles),
            strand=self.friction_strand,
            insulation=self.friction_insulation,
            radial_force=self.radial_force,
        )

    def build_loading_law(self) -> PlayLaw:
        """Build the law of first loading, whose unloading follows Masing's rule.

        Raises
        ------
        ValueError
            As for `build_section`, and if the moment decreases or the tangent stiffness increases
            with curvature.
        """
        law = fit_play_law(
            self.build_section(),
            self.build_contacts(),
            largest_curvature=self.largest_curvature,
            n_plays=self.n_plays,
        )
        return scale_law(law, self.factor)

    def build_law(self) -> PlayLaw:
        """Build the law of moment against curvature, with hysteresis; see `build_loading_law`."""
        law, layers = self.build_loading_law(), self.build_section().layers
        return harden_plays(law, layers, self.isotropic_share, factor=self.factor)

    @property
    def mass_per_length(self) -> float:
        """Return the mass per length of laid strands and insulation, kg/m."""
        return self.build_section().compute_mass_per_length()

    @property
    def parameters(self) -> Mapping[str, float]:
        """Return the calibration parameters in SI units, keyed by their names in `records.wire`."""
        coefficients = self.friction_strand + self.friction_insulation
        return {
            RADIAL_FRICTION: self.radial_force * coefficients,
            INSULATION_MODULUS: self.insulation_modulus,
            COPPER_SCALE: self.copper_scale,
        }


def _build_wire(
    name: str, lay_angles_deg: list[float], copper_area: float | None = None, **fields: Any
) -> StrandedWire:
    """Build a wire from its entry in the catalog.

    Parameters
    ----------
    name : name of the wire
    lay_angles_deg : lay angle of each ring of strands, deg
    copper_area : area of all strands, m^2; None if `fields` contains the diameter of a strand
    fields : further fields of the wire
    """
    if copper_area is not None:
        fields["strand"] = compute_strand_diameter(copper_area, fields["n_strands"])
    return StrandedWire(name=name, lay_angles=tuple(np.radians(lay_angles_deg).tolist()), **fields)


WIRES = {name: _build_wire(name, **entry) for name, entry in read_catalog()["wires"].items()}
"""Wires of Table 2.1 of [1]_. The copper of B1 and B2 does not fit into insulation with the stated
thickness of 0.3 mm; here the thickness is 0.2 mm."""


_PACKED, _, _ASYMMETRIC = ARRANGEMENTS
_DISTANCE_TOLERANCE = 1e-6
"""Largest difference of two distances that count as equal, in pitches of the lattice."""


@dataclass(frozen=True, slots=True)
class BundleModel:
    """Bundle of wires, with friction, tape and conduit.

    Parameters
    ----------
    wires : name in `WIRES` and number of wires, for each type
    arrangement : one of `records.harness_bundle.ARRANGEMENTS`. With two types, ``asymmetric`` has
        the second type on the side of the pull; the other arrangements distribute it over the
        section
    friction_share : fraction h of the axial stiffness of a wire that is effective before it slips
    slip_curvature : curvature kappa_s at which a wire at the root-mean-square distance c slips, 1/m
    glue_share : fraction g of the axial stiffness of the outer wires that is effective before the
        tape slides
    glue_strain : strain e at which the tape slides on the wires; None if the tape never slides
    slide_loss : fraction q of the slip moments that is lost between the curvature at which the tape
        slides and twice this curvature; at least half of the moments remains
    locking : factor on moments and curvatures of all corners from the second cycle on, at least 1
    conduit_stiffness : bending stiffness of an elastic conduit around the bundle, N m^2
    tape, taping, conduit : fields of `records.harness_bundle.Bundle` for the test sheet
    conduit_bore : inner diameter of the conduit for the test sheet, m; None without a conduit
    factor : factor of this sample on all moments at given curvatures
    """

    wires: tuple[tuple[str, int], ...] = (("B1", 19),)
    arrangement: str = _PACKED
    friction_share: float = 0.14
    slip_curvature: float = 0.42
    glue_share: float = 0.018
    glue_strain: float | None = 0.028
    slide_loss: float = 0.08
    locking: float = 1.05
    conduit_stiffness: float = 0.0
    tape: str = "PVC"
    taping: str = "half-lap"
    conduit: str = NONE
    conduit_bore: float | None = None
    factor: float = 1.0

    @property
    def radius(self) -> float:
        """Return the radius of the circle around all wires about the centre of stiffness, m."""
        layout = lay_wires(self)
        return float(np.max(np.hypot(layout.x, layout.y) + 0.5 * layout.diameter))

    def build_law(self, cycle: int = 1, max_curvature: float = 0.0) -> PlayLaw:
        """Build the law of moment against curvature, with hysteresis.

        Parameters
        ----------
        cycle : number of the cycle, from 1. The plays at the end of a cycle are the history for the
            law of the next cycle
        max_curvature : largest absolute curvature so far, 1/m

        Raises
        ------
        ValueError
            If the number of wires does not fill complete shells.
        """
        locking = 1.0 if cycle == 1 else self.locking
        law = _build_law(replace(self, factor=1.0))
        return scale_law(law, self.factor, self.compute_slip_factor(max_curvature) * locking)

    def compute_slip_factor(self, max_curvature: float) -> float:
        """Compute the fraction of slip moments that remains after a largest curvature, 1/m."""
        min_factor = 0.5
        if self.glue_strain is None:
            return 1.0
        relative_excess = max(0.0, max_curvature * self.radius / self.glue_strain - 1.0)
        return max(min_factor, 1.0 - self.slide_loss * relative_excess)

    @property
    def mass_per_length(self) -> float:
        """Return the mass per length of the wires, kg/m, without tape and conduit."""
        return sum(count * WIRES[name].mass_per_length for name, count in self.wires)

    @property
    def stiffnesses(self) -> Mapping[str, float]:
        """Return the contributions to the bending stiffness at first loading, N m^2.

        ``wires`` is that of the wires about their own axes. ``friction``, ``glue`` and ``conduit``
        are those of friction, glue and conduit. ``initial`` is the sum of these four. ``rigid`` is
        the stiffness of wires whose common section stays plane.
        """
        single_stiffness = float(sum(count * law.stiffness for count, law in _list_laws(self)))
        layout = lay_wires(self)
        coupling_stiffness = float(np.sum(layout.bending_stiffness))
        outer_coupling_stiffness = float(np.sum(layout.bending_stiffness * layout.is_outer))
        stiffnesses = {
            "wires": single_stiffness,
            "friction": self.friction_share * coupling_stiffness,
            "glue": self.glue_share * outer_coupling_stiffness,
            "conduit": self.conduit_stiffness,
        }
        stiffnesses |= {
            "initial": sum(stiffnesses.values()),
            "rigid": single_stiffness + coupling_stiffness,
        }
        return {name: self.factor * stiffness for name, stiffness in stiffnesses.items()}

    def describe(self) -> dict[str, object]:
        """Describe the bundle as the block ``bundle`` of a test sheet.

        Positions are stated only if the wires are of several types.
        """
        types = {name: {"number": n, "diameter": WIRES[name].diameter} for name, n in self.wires}
        n_wires = sum(count for _, count in self.wires)
        block = {"wires": types, "number": n_wires, "arrangement": self.arrangement}
        if len(self.wires) > 1:
            layout = lay_wires(self)
            positions = zip(layout.x, layout.y, strict=True)
            block["positions"] = [[f"{1e3 * x:.4f} mm", f"{1e3 * y:.4f} mm"] for x, y in positions]
        covers: dict[str, object] = {"tape": self.tape, "taping": self.taping}
        covers |= {"conduit": self.conduit, "conduit_bore": self.conduit_bore}
        return block | {key: value for key, value in covers.items() if value not in (NONE, None)}


@dataclass(frozen=True, slots=True, eq=False)
class WirePositions:
    """Positions of the wires of a bundle; arrays have shape (wires,), in the order of the types.

    Parameters
    ----------
    x, y : centre of each wire relative to the centre of stiffness of the bundle, m; y is the
        direction of bending
    diameter : diameter of each wire, m
    axial_stiffness : axial stiffness EA of the copper of each wire, N
    is_outer : whether the wire has fewer than six neighbours, so that a tape touches it
    """

    x: Floats
    y: Floats
    diameter: Floats
    axial_stiffness: Floats
    is_outer: Flags

    @property
    def bending_stiffness(self) -> Floats:
        """Return the bending stiffness EA y^2 of each wire about the neutral axis, N m^2."""
        return self.axial_stiffness * self.y**2


def lay_wires(bundle: BundleModel) -> WirePositions:
    """Lay the wires in shells of a hexagonal lattice, around a wire or around a gap.

    Parameters
    ----------
    bundle : bundle; the pitch of the lattice is the diameter of its thickest wire

    Raises
    ------
    ValueError
        If the number of wires does not fill complete shells.
    """
    wires = [WIRES[name] for name, count in bundle.wires for _ in range(count)]
    diameter = np.array([wire.diameter for wire in wires])
    copper_area = np.array([wire.n_strands * 0.25 * np.pi * wire.strand**2 for wire in wires])
    axial_stiffness = ANNEALED_COPPER.modulus * copper_area
    lattice_positions, is_outer = _fill_shells(len(wires))
    order = _order_by_type(lattice_positions, bundle)
    total_stiffness = np.sum(axial_stiffness)
    x, y = np.max(diameter) * lattice_positions[order].T
    x -= axial_stiffness @ x / total_stiffness
    y -= axial_stiffness @ y / total_stiffness
    return WirePositions(x, y, diameter, axial_stiffness, is_outer=is_outer[order])


def _fill_shells(n_wires: int) -> tuple[Floats, Flags]:
    """Compute positions in full shells, shape (wires, 2), in pitches, and whether each is outer."""
    for centre in (np.zeros(2), np.array([0.5, 0.5 / np.sqrt(3.0)])):  # on a wire, in a gap
        i, j = np.meshgrid(np.arange(-9, 10), np.arange(-9, 10))
        lattice = np.column_stack([(i + 0.5 * j).ravel(), (0.5 * np.sqrt(3.0) * j).ravel()])
        positions = lattice - centre
        distance = np.hypot(*positions.T)
        order = np.lexsort((np.arctan2(positions[:, 1], positions[:, 0]), np.round(distance, 6)))
        last_inside, first_outside = distance[order[n_wires - 1 : n_wires + 1]]
        if first_outside - last_inside > _DISTANCE_TOLERANCE:
            positions = positions[order[:n_wires]]
            distances = np.hypot(*(positions[:, None, :] - positions).transpose(2, 0, 1))
            n_neighbours = np.sum(np.abs(distances - 1.0) < _DISTANCE_TOLERANCE, axis=1)
            return positions, n_neighbours < 6
    raise ValueError(format_sentence("virtual_lab.open_shell", count=n_wires))


def _order_by_type(positions: Floats, bundle: BundleModel) -> Ints:
    """Return the indices of the positions of the first type of wire, then of the second type."""
    n_first = bundle.wires[0][1]
    order = np.argsort(positions[:, 1] + 1e-3 * positions[:, 0], kind="stable")
    if len(bundle.wires) == 1 or bundle.arrangement == _ASYMMETRIC:
        return order
    # The second type is distributed evenly over the shells.
    fraction = (len(positions) - n_first) / len(positions)
    is_second = np.diff(np.floor(fraction * np.arange(len(positions) + 1) + 0.5)) > 0.0
    return np.concatenate([np.flatnonzero(~is_second), np.flatnonzero(is_second)])


def _list_laws(bundle: BundleModel) -> list[tuple[int, PlayLaw]]:
    """List the number of wires, and the law of first loading of a wire, for each type."""
    return [(n, replace(WIRES[name], n_plays=24).build_loading_law()) for name, n in bundle.wires]


@lru_cache(maxsize=64)
def _build_law(bundle: BundleModel) -> PlayLaw:
    """Build the law of the first cycle, a polygon with the corners of all wires and sliders."""
    slip_curvatures, stiffnesses = _compute_sliders(bundle)
    laws = [(count, *find_corners(law)) for count, law in _list_laws(bundle)]
    max_curvature = min(WIRES[name].largest_curvature for name, _ in bundle.wires)
    min_relative_distance = 1e-6  # between two corners
    wire_corners = [curvature for _, _, curvature, _ in laws]
    corners = np.concatenate([*wire_corners, slip_curvatures, [max_curvature]])
    corners = np.unique(corners[(corners > 0.0) & (corners <= max_curvature)])
    knots = corners[np.diff(corners, prepend=0.0) > min_relative_distance * corners]
    moment_sum = bundle.conduit_stiffness * knots
    for count, moment, curvature, compliances in laws:
        extrapolated_moment = np.maximum(knots - curvature[-1], 0.0) / compliances[-1]
        moment_sum += count * (np.interp(knots, curvature, moment) + extrapolated_moment)
    moment_sum += np.minimum(knots[:, None], slip_curvatures) @ stiffnesses
    return make_polygon_law(knots, moment_sum)


def _compute_sliders(bundle: BundleModel) -> tuple[Floats, Floats]:
    """Compute the slip curvatures, 1/m, and the stiffnesses, N m^2, of friction and glue."""
    layout = lay_wires(bundle)
    is_off_axis = np.abs(layout.y) > _DISTANCE_TOLERANCE * np.max(layout.diameter)
    distance = np.abs(layout.y[is_off_axis])
    friction_limits = bundle.slip_curvature * float(np.sqrt(np.mean(distance**2))) / distance
    glue_limit = np.inf if bundle.glue_strain is None else bundle.glue_strain / bundle.radius
    stiffnesses = bundle.friction_share * layout.bending_stiffness[is_off_axis]
    glue_stiffness = bundle.glue_share * float(np.sum(layout.bending_stiffness * layout.is_outer))
    return np.append(friction_limits, glue_limit), np.append(stiffnesses, glue_stiffness)


def _build_bundles(catalog_key: str) -> dict[str, BundleModel]:
    """Build the bundles of a table of the catalog; ``all`` has values of a whole group."""
    bundles = {}
    for group in read_catalog()[catalog_key]:
        for name, values in group["types"].items():
            bundle = BundleModel(**(group["all"] | values))
            wires = tuple((wire, count) for wire, count in values["wires"])
            glue_strain = None if bundle.tape == "PET" else bundle.glue_strain
            bundles[name] = replace(bundle, wires=wires, glue_strain=glue_strain)
    return bundles


TAPED_TYPES = _build_bundles("taped")
"""Taped bundle of each type of Table 4.1 of [1]_; PET tape never slides."""
CONDUIT_TYPES = _build_bundles("conduits")
"""Bundle in a conduit of each type of Table 4.2 of [1]_. Wires in a tube are taped only at their
ends, so that friction and glue hold them less; tape on the conduit increases moments by 1 to 2
%."""
