"""Place the strands of a wire in its cross-section, and compute its axial and torsional stiffness.

A layout (hexagon, concentric rings, compressed sectors, packing) determines the positions of the
strands. An error is raised if the strands do not fit. Layers are defined by their numbers of
strands, not by their radii. The first strand of the first ring is at angle 0, on the neutral axis
of [1]_. `wire.bending_law` rotates the section for other orientations. Lengths are in m, angles in
rad.

A packing minimises the overlap energy, equations (3.1) to (3.4) of [1]_: the sum of squared
overlaps of strands with each other (each pair counts twice) and with the bore. The result depends
on the start. Seven strands nearly always form a hexagon, 19 or 37 strands never do. In a loose bore
many packings have no overlap. The best result of several starts is therefore used, and
`make_cross_section` prefers the hexagon.

Stretch and torsion are coupled. A strand at radius r with the lay angle a is strained along its
axis by eps cos^2 a if the wire has the axial strain eps. It is strained by r tau sin a cos a if the
wire has the twist tau (rad/m, positive in the sense of a positive lay). The axial force N and the
torque T of the wire are

    [N; T] = [EA, C; C, GJ] [eps; tau],
    EA = sum E A cos^3 a + E_ins A_ins,      C = sum E A r sin a cos^2 a,
    GJ = sum E A r^2 sin^2 a cos a + GJ_s + G_ins pi/2 (R_o^4 - R_i^4),

where GJ_s is the torsional stiffness of the strands about their own axes. Slip does not reduce
these stiffnesses, because each strand stays at its radius and is strained uniformly [2]_. A real
wire, in which strands flatten at their contacts, is softer.

References
----------
.. [1] *Modeling and characterization of wire harnesses for digital manufacturing applications*,
       dissertation.
.. [2] G. A. Costello, *Theory of Wire Rope*, 1997.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Annotated, Literal, TypeAlias

import numpy as np
from scipy.optimize import minimize
from scipy.spatial import KDTree

from labpipe.mechanics.law.plays import require, require_positive
from labpipe.mechanics.wire.materials import (
    ANNEALED_COPPER,
    BendingMoment,
    Material,
    StressTable,
    compute_helix_factor,
    compute_strand_moment,
)
from labpipe.records.arrays import ArrayRecord, Floats, Ints

LayoutKind: TypeAlias = Literal["hexagonal", "concentric", "packed", "compressed"]

COPPER_DENSITY = 8960.0
"""Default density of the strands, kg/m^3: pure copper at 20 deg C (CRC Handbook)."""
PVC_DENSITY = 1400.0
"""Default density of the insulation, kg/m^3: filled PVC."""
MAX_RELATIVE_OVERLAP = 1e-3
"""Largest tolerated overlap of strands, relative to the radius of the bore."""


@dataclass(frozen=True, slots=True)
class Layer:
    """Strands of one ring, or the core, which is a single strand on the axis.

    Parameters
    ----------
    count : number of strands
    diameter : m, diameter of a strand; for a compressed strand, diameter of the circle with the
        same area
    lay_angle : rad, angle between the strands and the axis of the wire, signed; 0 for the core
    material : stress-strain curve of the strands
    poisson : Poisson's ratio of the strands
    """

    count: int
    diameter: float
    lay_angle: float = 0.0
    material: Material = ANNEALED_COPPER
    poisson: float = 0.34

    def __post_init__(self) -> None:
        require_positive("diameter", self.diameter)
        require("count", self.count, "a whole number >= 1", holds=self.count >= 1)
        holds, degrees = abs(self.lay_angle) < np.pi / 2.0, float(np.degrees(self.lay_angle))
        require("lay_angle", degrees, "between -90 and 90 deg", holds=holds)
        _require_poisson(self.poisson)

    @property
    def area(self) -> float:
        """Cross-sectional area of one strand, normal to its own axis, m^2."""
        return float(np.pi * self.diameter**2 / 4.0)

    @property
    def section_area(self) -> float:
        """Area of all strands of the layer in the cross-section of the wire, m^2."""
        return float(self.count * self.area / np.cos(self.lay_angle))

    @property
    def strand_stiffness(self) -> float:
        """Bending stiffness of one straight strand about its own axis, E pi d^4 / 64, N m^2."""
        return float(self.material.modulus * np.pi * self.diameter**4 / 64.0)

    @property
    def straight_count(self) -> float:
        """Number of straight strands that are as stiff in bending as the layer."""
        return self.count * compute_helix_factor(self.lay_angle, self.poisson)


def _require_poisson(poisson: float) -> None:
    """Raise ValueError for a Poisson's ratio outside its physical range."""
    require("poisson", poisson, "> -1 and <= 0.5", holds=-1.0 < poisson <= 0.5)


@dataclass(frozen=True, slots=True)
class Insulation:
    """Insulation of a wire, a tube around the strands.

    Parameters
    ----------
    bore_radius : R_i, m, inner radius
    thickness : t, m, thickness of the wall
    modulus : E, Pa, modulus of elasticity at small strains
    poisson : nu, Poisson's ratio
    curve : stress-strain curve with the modulus as first slope; None for a linear material
    """

    bore_radius: float
    thickness: float
    modulus: float
    poisson: float = 0.4
    curve: StressTable | None = None

    def __post_init__(self) -> None:
        for name in ("bore_radius", "thickness", "modulus"):
            require_positive(name, getattr(self, name))
        _require_poisson(self.poisson)

    @property
    def outer_radius(self) -> float:
        """Outer radius R_o, m, which is the radius of the wire."""
        return self.bore_radius + self.thickness

    @property
    def bending_stiffness(self) -> float:
        """Bending stiffness at small strains, E pi / 4 (R_o^4 - R_i^4), N m^2."""
        return float(self.modulus * np.pi / 4.0 * (self.outer_radius**4 - self.bore_radius**4))

    @property
    def area(self) -> float:
        """Cross-sectional area of the tube, m^2."""
        return float(np.pi * (self.outer_radius**2 - self.bore_radius**2))

    @property
    def axial_stiffness(self) -> float:
        """Axial stiffness, E times the area, N."""
        return self.modulus * self.area

    @property
    def torsional_stiffness(self) -> float:
        """Torsional stiffness, G pi / 2 (R_o^4 - R_i^4) with G = E / (2 (1 + nu)), N m^2."""
        return self.bending_stiffness / (1.0 + self.poisson)


def compute_tube_moment(tube: Insulation, curvature: Floats) -> BendingMoment:
    """Compute moment and tangent stiffness of the insulation on first loading.

    Parameters
    ----------
    tube : insulation
    curvature : any shape, 1/m, any sign

    Returns
    -------
    Moment and tangent stiffness; NaN where the curvature is NaN.

    Raises
    ------
    ValueError
        If the strain at the outer radius exceeds the range of the stress-strain curve. The message
        states the curvature.

    Notes
    -----
    The moment is that of a bar of the outer radius minus that of a bar of the inner radius. Without
    a stress-strain curve the tube is linear at any strain, and no range is checked.
    """
    if tube.curve is None:
        stiffness = tube.bending_stiffness
        return BendingMoment(stiffness * curvature, np.full(np.shape(curvature), stiffness))
    diameters = 2.0 * tube.outer_radius, 2.0 * tube.bore_radius
    outer, inner = (compute_strand_moment(tube.curve, d, curvature) for d in diameters)
    tangent_stiffness = outer.tangent_stiffness - inner.tangent_stiffness
    return BendingMoment(outer.moment - inner.moment, tangent_stiffness)


@dataclass(frozen=True, slots=True, eq=False)
class CrossSection(ArrayRecord):
    """Cross-section of a wire: strands with their positions, and the insulation.

    Parameters
    ----------
    kind : name of the layout
    layers : layers of strands from the axis outwards
    x, y : shape (strands,), m, centres of the strands, in the order of the layers
    overlap : m, largest overlap of strands with each other or with the bore; 0 without overlap
    insulation : tube around the strands; None for bare strands
    """

    kind: str
    layers: tuple[Layer, ...]
    x: Annotated[Floats, "strands"] = field(repr=False)
    y: Annotated[Floats, "strands"] = field(repr=False)
    overlap: float = 0.0
    insulation: Insulation | None = None

    @property
    def layer(self) -> Ints:
        """Index in `layers` of the layer of each strand, shape (strands,)."""
        return np.repeat(np.arange(len(self.layers)), [layer.count for layer in self.layers])

    def repeat_per_strand(self, values: Iterable[float]) -> Floats:
        """Repeat the value of each layer for each of its strands, shape (strands,)."""
        return np.array(list(values))[self.layer]

    @property
    def has_core(self) -> bool:
        """Whether the innermost layer has a single strand, at any position."""
        return self.layers[0].count == 1

    @property
    def radius(self) -> Floats:
        """Distance of the strands from the axis, shape (strands,), m."""
        return np.hypot(self.x, self.y)

    @property
    def angle(self) -> Floats:
        """Angle of the strands from the x axis, shape (strands,), rad."""
        return np.arctan2(self.y, self.x)

    def compute_mass_per_length(
        self, conductor_density: float = COPPER_DENSITY, insulation_density: float = PVC_DENSITY
    ) -> float:
        """Compute the mass per length of the wire, kg/m.

        Parameters
        ----------
        conductor_density : kg/m^3, density of the strands
        insulation_density : kg/m^3

        Notes
        -----
        A helical strand is longer than the wire by the factor 1 / cos(lay angle). The density of
        PVC for cables is 1300 to 1500 kg/m^3, depending on its fillers.
        """
        strand_area = sum(layer.section_area for layer in self.layers)
        insulation_area = self.insulation.area if self.insulation else 0.0
        return float(conductor_density * strand_area + insulation_density * insulation_area)


def compute_strand_diameter(conductor_area: float, n_strands: int) -> float:
    """Compute the diameter of equal round strands with a total area, sqrt(4 A / (pi N)), m.

    Parameters
    ----------
    conductor_area : A, total area of the strands, m^2
    n_strands : N, number of strands
    """
    require_positive("conductor_area", conductor_area)
    return float(np.sqrt(4.0 * conductor_area / (np.pi * n_strands)))


def lay_up(
    n_strands: int, diameter: float, lay_angles: Sequence[float], material: Material
) -> tuple[Layer, ...]:
    """Make layers of 1, 6, 12, 18 ... equal strands.

    Parameters
    ----------
    n_strands : number of strands in all layers
    diameter : m, diameter of a strand
    lay_angles : rad, lay angle of each ring, from the innermost
    material : stress-strain curve of the strands

    Raises
    ------
    ValueError
        If the number of strands is not that of a core and one ring for each lay angle.
    """
    counts = [1, *(6 * ring for ring in range(1, len(lay_angles) + 1))]
    expected = f"the sum of {' + '.join(map(str, counts))}, one layer for each lay angle"
    require("n_strands", n_strands, expected, holds=n_strands == sum(counts))
    layers = zip(counts, [0.0, *lay_angles], strict=True)
    return tuple(Layer(count, diameter, angle, material) for count, angle in layers)


def place_hexagon(layers: tuple[Layer, ...], insulation: Insulation | None = None) -> CrossSection:
    """Place layers of 1, 6, 12, 18 ... equal strands on a triangular lattice.

    Parameters
    ----------
    layers : layers of strands from the axis outwards
    insulation : tube around the strands; None for bare strands

    Raises
    ------
    ValueError
        If the counts or diameters are not those of a hexagon, or the hexagon does not fit the bore.
    """
    counts = [layer.count for layer in layers]
    is_hexagon = counts == [1, *(6 * ring for ring in range(1, len(layers)))]
    require("counts", counts, "1, 6, 12, 18 ... for a hexagon", holds=is_hexagon)
    _require_equal_strands(layers)
    rings = [_place_hexagon_ring(ring) for ring in range(len(layers))]
    centres = np.concatenate(rings) * layers[0].diameter
    return place_strands("hexagonal", layers, centres, insulation)


def _require_equal_strands(layers: tuple[Layer, ...]) -> None:
    """Raise ValueError if the strands of layers have different diameters."""
    diameters = sorted({layer.diameter for layer in layers})
    require("diameters", diameters, "equal in a hexagon or a packing", holds=len(diameters) == 1)


def _place_hexagon_ring(ring: int) -> Floats:
    """Return the centres of one ring of the lattice, strand diameters, the first on the x axis."""
    if ring == 0:
        return np.zeros((1, 2))
    corners = ring * np.exp(1j * np.pi / 3.0 * np.arange(7))
    steps = np.arange(ring) / ring
    points = (corners[:-1, None] + steps * np.diff(corners)[:, None]).ravel()
    return np.column_stack([points.real, points.imag])


def place_rings(layers: tuple[Layer, ...], insulation: Insulation | None = None) -> CrossSection:
    """Place concentric rings, each in contact with the next inner layer.

    Parameters
    ----------
    layers : layers of strands from the axis outwards
    insulation : tube around the strands; None for bare strands

    Raises
    ------
    ValueError
        If the strands of a ring overlap each other, or the outermost ring overlaps the bore.

    Notes
    -----
    With equal strands of diameter d and a core, ring q has the radius q d. Without a core the n
    strands of the first ring touch each other, and the ring has the radius d / (2 sin(pi / n)).
    """
    innermost = layers[0]
    touching_radius = innermost.diameter / (2.0 * np.sin(np.pi / innermost.count))
    radii = [0.0 if innermost.count == 1 else float(touching_radius)]
    for inner, outer in pairwise(layers):
        radii.append(radii[-1] + (inner.diameter + outer.diameter) / 2.0)
    return place_strands("concentric", layers, _spread_rings(layers, radii), insulation)


def _spread_rings(
    layers: tuple[Layer, ...], radii: Sequence[float], first_turns: Floats | float = 0.0
) -> Floats:
    """Return centres of strands that are evenly spaced in each ring, shape (strands, 2).

    `first_turns` is the angle of the first strand of each ring, in turns.
    """
    counts = [layer.count for layer in layers]
    turns = np.concatenate([np.arange(count) / count for count in counts])
    turns += np.repeat(np.broadcast_to(first_turns, len(counts)), counts)
    radius, angle = np.repeat(radii, counts), 2.0 * np.pi * turns
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])


def place_sectors(
    layers: tuple[Layer, ...],
    insulation: Insulation | None = None,
    *,
    radii: Sequence[float] | None = None,
) -> CrossSection:
    """Place strands that are compressed into sectors without gaps.

    Parameters
    ----------
    layers : layers of strands from the axis outwards; the diameter of a layer is that of the circle
        with the area of one strand
    insulation : tube around the strands; the bore must be as large as the area of all strands
    radii : m, radius of the centroids of the strands in each layer, which is 0 for a core; None to
        compute the centroids of sectors

    Raises
    ------
    ValueError
        If the area of the strands exceeds that of the bore, or the number of `radii` is not that of
        the layers.

    Notes
    -----
    The areas of the strands determine the radii at the edges of the rings. The centroid of a sector
    of half-angle b between the radii a and c has the radius 2/3 (c^3 - a^3) / (c^2 - a^2) sin(b) /
    b. The bending stiffness of a sector about its own axis is taken as that of the round strand.
    """
    edge_radii = np.sqrt(np.cumsum([0.0, *(layer.count * layer.area for layer in layers)]) / np.pi)
    if insulation is not None:
        bore, min_radius = insulation.bore_radius, float(edge_radii[-1])
        expected = f"at least the {min_radius:.6g} m that the strands need without any gap"
        holds = min_radius <= bore * (1.0 + MAX_RELATIVE_OVERLAP)
        require("bore_radius", float(f"{bore:.6g}"), expected, holds=holds)
    if radii is None:
        half_angles = np.pi / np.array([layer.count for layer in layers])
        mean_radii = 2.0 / 3.0 * np.diff(edge_radii**3) / np.diff(edge_radii**2)
        centroids = mean_radii * np.sin(half_angles) / half_angles
        radii = np.where(half_angles < np.pi, centroids, 0.0).tolist()
    expected = f"one for each of {len(layers)} layers"
    require("radii", list(radii), expected, holds=len(radii) == len(layers))
    x, y = _spread_rings(layers, radii).T
    return CrossSection("compressed", layers, x, y, 0.0, insulation)


def place_strands(
    kind: str, layers: tuple[Layer, ...], centres: Floats, insulation: Insulation | None
) -> CrossSection:
    """Make the cross-section with round strands at given centres.

    Parameters
    ----------
    kind : name of the layout
    layers : layers of strands from the axis outwards
    centres : shape (strands, 2), m, centres of the strands, in the order of the layers
    insulation : tube around the strands; None for bare strands

    Raises
    ------
    ValueError
        If strands overlap each other or the bore by more than `MAX_RELATIVE_OVERLAP`. The message
        states the overlap.
    """
    radii = np.repeat([layer.diameter / 2.0 for layer in layers], [layer.count for layer in layers])
    outer_radius = float((np.hypot(*centres.T) + radii).max())
    bore = insulation.bore_radius if insulation else outer_radius
    overlap, obstacle = max(
        (compute_largest_overlap(centres, radii), "each other"),
        (outer_radius - bore, f"the bore of radius {bore:.6g} m"),
    )
    if overlap > MAX_RELATIVE_OVERLAP * bore:
        message = (
            f"the {kind} layout does not fit: strands overlap {obstacle} by {overlap:.3g} m; "
            f"expected at most {MAX_RELATIVE_OVERLAP * bore:.3g} m"
        )
        raise ValueError(message)
    x, y = centres.T
    return CrossSection(kind, layers, x, y, overlap, insulation)


def compute_largest_overlap(centres: Floats, radii: Floats) -> float:
    """Compute the largest overlap of circles with each other, m; 0 without overlap.

    Parameters
    ----------
    centres : shape (n, 2), m, centres of the circles
    radii : shape (n,), m, radii of the circles
    """
    first, second = np.triu_indices(len(radii), 1)
    if not len(first):
        return 0.0
    gaps = np.hypot(*(centres[first] - centres[second]).T) - radii[first] - radii[second]
    return max(float(-gaps.min()), 0.0)


def compute_overlap_energy(
    coordinates: Floats, strand_radius: float, bore_radius: float
) -> tuple[float, Floats]:
    """Compute the overlap energy of equal strands in a bore, and its gradient.

    Parameters
    ----------
    coordinates : shape (2 n,), m, x and y of each strand in turn
    strand_radius, bore_radius : m, radii of the strands and of the bore

    Returns
    -------
    Sum of the squared overlaps, m^2, equation (3.4) of [1]_, and its gradient, shape (2 n,), m. The
    gradient is taken as zero for strands with the same centre, and for the overlap of a strand on
    the axis with the bore.
    """
    centres = coordinates.reshape(-1, 2)
    offsets = centres[:, None] - centres[None]
    distance = np.hypot(offsets[..., 0], offsets[..., 1])
    np.fill_diagonal(distance, np.inf)
    overlap = np.maximum(2.0 * strand_radius - distance, 0.0)
    ratio = overlap / np.where(distance == 0.0, 1.0, distance)
    gradient = -4.0 * np.einsum("ij,ijk->ik", ratio, offsets)
    axis_distance = np.hypot(*centres.T)
    bore_overlap = np.maximum(axis_distance + strand_radius - bore_radius, 0.0)
    bore_ratio = bore_overlap / np.where(axis_distance == 0.0, 1.0, axis_distance)
    gradient += 2.0 * bore_ratio[:, None] * centres
    return float(np.sum(overlap**2) + np.sum(bore_overlap**2)), gradient.ravel()


def pack_strands(
    layers: tuple[Layer, ...], insulation: Insulation, *, seed: int = 0
) -> CrossSection:
    """Pack equal strands by minimising their overlap energy from several random starts.

    In alternate starts, the strands are at random positions in the bore and near rings.

    Parameters
    ----------
    layers : layers of strands of one diameter. The packed strands are assigned to the layers by
        their distance from the axis. A first layer of one strand stays on the axis
    insulation : tube around the strands
    seed : seed of the starts; the same seed gives the same packing

    Returns
    -------
    The packing with the lowest energy, rotated so that the first strand of the first ring is at
    angle 0. A single strand is on the axis.

    Raises
    ------
    ValueError
        If the diameters differ, or the strands of the best packing overlap each other or the bore
        by more than `MAX_RELATIVE_OVERLAP`. The message states the overlap.
    """
    max_starts = 12  # the search ends with the first packing without overlap
    energy_tolerance = 1e-16  # squared strand radii; allows overlaps of 1e-8 strand radii
    offset_deviation = 0.1  # standard deviation of the starts near rings, strand radii
    _require_equal_strands(layers)
    n_strands, strand_radius = sum(layer.count for layer in layers), layers[0].diameter / 2.0
    # Lengths are in strand radii, because the tolerances of the optimiser are absolute.
    bore_radius = insulation.bore_radius / strand_radius
    core = np.zeros(2 if layers[0].count == 1 else 0)  # coordinates of the core
    rng = np.random.default_rng(seed)
    best_centres, lowest_energy = np.zeros((n_strands, 2)), np.inf

    def compute_energy(coordinates: Floats) -> tuple[float, Floats]:
        all_coordinates = np.concatenate([core, coordinates])
        energy, gradient = compute_overlap_energy(all_coordinates, 1.0, bore_radius)
        return energy, gradient[len(core) :]

    for start_index in range(max_starts if n_strands > 1 else 0):
        if start_index % 2:
            turns, offsets = rng.uniform(size=len(layers)), rng.normal(size=best_centres.shape)
            ring_indices = np.arange(len(layers)) + int(layers[0].count > 1)
            rings = _spread_rings(layers, (2.0 * ring_indices).tolist(), turns)
            start = rings + offset_deviation * offsets
        else:
            radius = (bore_radius - 1.0) * np.sqrt(rng.uniform(size=n_strands))
            angle = rng.uniform(0.0, 2.0 * np.pi, n_strands)
            start = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
        optimum = minimize(
            compute_energy,
            start.ravel()[len(core) :],
            jac=True,
            method="L-BFGS-B",
            options={"ftol": 1e-16, "gtol": 1e-10, "maxiter": 1000},
        )
        if optimum.fun < lowest_energy:
            best_centres = np.concatenate([core, optimum.x]).reshape(-1, 2) * strand_radius
            lowest_energy = float(optimum.fun)
        if lowest_energy < energy_tolerance:
            break
    return place_strands("packed", layers, _sort_strands(best_centres, layers), insulation)


def _sort_strands(centres: Floats, layers: tuple[Layer, ...]) -> Floats:
    """Sort strands by layer and angle, and rotate them so that the first ring starts at angle 0."""
    sorted_centres = centres[np.argsort(np.hypot(*centres.T), kind="stable")]
    layer_starts = np.cumsum([layer.count for layer in layers])[:-1]
    rings = np.split(sorted_centres, layer_starts)
    rings = [ring[np.argsort(np.arctan2(*ring.T[::-1]))] for ring in rings]
    first_strand = rings[1 if layers[0].count == 1 and len(rings) > 1 else 0][0]
    distance = np.hypot(*first_strand)
    cosine, sine = first_strand / distance if distance > 0.0 else (1.0, 0.0)
    return np.asarray(np.concatenate(rings) @ np.array([[cosine, -sine], [sine, cosine]]))


LAYOUT_FUNCTIONS: Mapping[LayoutKind, Callable[[tuple[Layer, ...], Insulation], CrossSection]] = {
    "hexagonal": place_hexagon,
    "concentric": place_rings,
    "packed": pack_strands,
    "compressed": place_sectors,
}


def make_cross_section(
    layers: tuple[Layer, ...], insulation: Insulation, *, kind: LayoutKind | None = None
) -> CrossSection:
    """Make the cross-section of a wire in one of four layouts.

    Parameters
    ----------
    layers : layers of strands, from the axis outwards
    insulation : tube around the strands
    kind : name of the layout; None for the first that fits of the hexagon, concentric rings and,
        for strands of one diameter, a packing

    Raises
    ------
    ValueError
        If the layout does not fit the bore, or is not possible with the numbers of strands or their
        diameters.
    """
    if kind is not None:
        return LAYOUT_FUNCTIONS[kind](layers, insulation)
    for place_layers in (place_hexagon, place_rings):
        with suppress(ValueError):  # the layout does not fit; the next one is tried
            return place_layers(layers, insulation)
    # For strands of several diameters, place_rings raises the error that states the overlap.
    is_one_diameter = len({layer.diameter for layer in layers}) == 1
    return (pack_strands if is_one_diameter else place_rings)(layers, insulation)


def compute_helix_overlap(section: CrossSection) -> float:
    """Compute the largest overlap of helical strands of one layer, relative to their diameter.

    Strands that touch as circles in the cross-section overlap as helices: normal to a strand, the
    distance to its neighbour is smaller by about the factor cos(lay angle).

    Parameters
    ----------
    section : cross-section with round strands; layers without a lay angle are ignored

    Returns
    -------
    Ratio of the overlap to the diameter; 0 if no strands overlap.

    Notes
    -----
    The distance of two helices is the minimum of sqrt(a^2 + b^2 - 2 a b cos(p - k z) + z^2) over z,
    with k = tan(lay angle) / sqrt(a b). a and b are their radii, p is the angle between them in the
    cross-section, and their pitch is 2 pi / k.
    """
    max_neighbour_distance = 1.5  # distance of the centres of neighbours, strand diameters
    largest_overlap = 0.0
    for index, layer in enumerate(section.layers):
        is_in_layer = section.layer == index
        centres = np.column_stack([section.x[is_in_layer], section.y[is_in_layer]])
        max_distance = max_neighbour_distance * layer.diameter
        first, second = KDTree(centres).query_pairs(max_distance, output_type="ndarray").T
        if first.size and layer.lay_angle:
            distances = _compute_helix_distances(centres[first], centres[second], layer.lay_angle)
            largest_overlap = max(largest_overlap, 1.0 - float(distances.min()) / layer.diameter)
    return largest_overlap


def _compute_helix_distances(first: Floats, second: Floats, lay_angle: float) -> Floats:
    """Compute the smallest distance of the centre lines of each pair of strands, shape (pairs,).

    The distance is the smallest from a point of the first strand to 401 points of the second. These
    are between the point in the same cross-section and the point at the same angle.
    """
    a, b = np.hypot(*first.T), np.hypot(*second.T)
    cross_product = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    pair_angle = np.abs(np.arctan2(cross_product, (first * second).sum(1)))[:, None]
    angle = pair_angle * np.linspace(0.0, 1.0, 401)  # p - k z
    z = (pair_angle - angle) * np.sqrt(a * b)[:, None] / np.tan(abs(lay_angle))
    squared = (a**2 + b**2)[:, None] - 2.0 * (a * b)[:, None] * np.cos(angle) + z**2
    return np.asarray(np.sqrt(squared.min(axis=1)))


@dataclass(frozen=True, slots=True)
class StretchTorsion:
    """Stiffnesses of a wire in stretch and torsion, which form a symmetric matrix.

    Parameters
    ----------
    axial_stiffness : EA, N, at constant twist
    coupling : C, N m, torque per axial strain, with the sign of the lay
    torsional_stiffness : GJ, N m^2, at constant length
    """

    axial_stiffness: float
    coupling: float
    torsional_stiffness: float

    @property
    def free_torsional_stiffness(self) -> float:
        """Torsional stiffness of a wire that is free to lengthen, GJ - C^2 / EA, N m^2."""
        return self.torsional_stiffness - self.coupling**2 / self.axial_stiffness


def compute_stretch_torsion(section: CrossSection) -> StretchTorsion:
    """Compute the stiffness in stretch and torsion of elastic strands and their insulation.

    Parameters
    ----------
    section : cross-section of the wire; each strand is taken at its own radius

    Notes
    -----
    The torsional stiffness of the strands about their own axes is GJ_s = sum E I cos(a) (cos^2 a /
    (1 + nu) + sin^2 a), with I = pi d^4 / 64. A twist of the wire has a component along the strand,
    which twists the strand (G J = E I / (1 + nu)), and a component normal to the strand, which
    bends it (Love's thin rod). The energy argument is that of the helix factor, equation (3.18) of
    [1]_. The shear modulus of the insulation is G = E / (2 (1 + nu)).
    """
    axial = coupling = torsional = 0.0
    for index, layer in enumerate(section.layers):
        sine, cosine = np.sin(layer.lay_angle), np.cos(layer.lay_angle)
        radius = section.radius[section.layer == index]
        rigidity = layer.material.modulus * layer.area
        axial += layer.count * rigidity * cosine**3
        coupling += rigidity * float(radius.sum()) * sine * cosine**2
        torsional += rigidity * float(np.sum(radius**2)) * sine**2 * cosine
        twist_factor = cosine**2 / (1.0 + layer.poisson) + sine**2
        torsional += layer.count * layer.strand_stiffness * cosine * twist_factor
    tube = section.insulation
    if tube is not None:
        axial += tube.axial_stiffness
        torsional += tube.torsional_stiffness
    return StretchTorsion(float(axial), float(coupling), float(torsional))
