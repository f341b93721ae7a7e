"""Pack strands into a bore by minimising their overlaps, and choose a layout (PHYSICS 4).

Eqs. (3.1)-(3.4) of the dissertation: the overlap energy is the sum of squared overlaps of strands
with each other (each pair counts twice) and with the bore. The packing depends on the start of the
minimisation: seven strands nearly always end in the hexagon, 19 or 37 strands never do, and in a
loose bore many packings have no overlap. `pack_strands` therefore keeps the best result of several
seeded starts, and `make_cross_section` prefers the hexagon.
"""

from __future__ import annotations

from contextlib import suppress
from typing import Literal, TypeAlias

import numpy as np
from scipy.optimize import minimize
from scipy.spatial import KDTree

from labpipe.mechanics.wire.cross_section import (
    CrossSection,
    Insulation,
    Layer,
    place_hexagon,
    place_rings,
    place_sectors,
    place_strands,
)
from labpipe.records.arrays import Floats

LayoutKind: TypeAlias = Literal["hexagonal", "concentric", "packed", "compressed"]


def compute_overlap_energy(
    coordinates: Floats, strand_radius: float, bore_radius: float
) -> tuple[float, Floats]:
    """Compute the overlap energy of equal strands in a bore, and its gradient.

    Parameters
    ----------
    coordinates : shape (2 n,), m, x and y of the first strand, then of the second, and so on
    strand_radius, bore_radius : m

    Returns
    -------
    Sum of the squared overlaps, m^2, eq. (3.4), and its gradient, shape (2 n,), m. The overlap of a
    strand on the axis with the bore contributes no gradient.
    """
    centres = coordinates.reshape(-1, 2)
    pair_energy, pair_gradient = compute_squared_overlaps(centres, 2.0 * strand_radius)
    axis_distance = np.hypot(*centres.T)
    bore_overlap = np.maximum(axis_distance + strand_radius - bore_radius, 0.0)
    slope = 2.0 * bore_overlap / np.where(axis_distance == 0.0, 1.0, axis_distance)
    gradient = slope[:, None] * centres + 2.0 * pair_gradient
    return float(2.0 * pair_energy + np.sum(bore_overlap**2)), gradient.ravel()


def compute_squared_overlaps(
    centres: Floats, contact_distance: Floats | float
) -> tuple[float, Floats]:
    """Compute the sum of squared overlaps of circles, each pair once, and its gradient.

    Parameters
    ----------
    centres : shape (n, 2), m
    contact_distance : m, distance of the centres at which two circles touch: one number for all
        pairs, or shape (n, n)

    Returns
    -------
    Sum, m^2, and gradient, shape (n, 2), m. Two circles with the same centre contribute no
    gradient.
    """
    offsets = centres[:, None] - centres[None]
    distance = np.hypot(offsets[..., 0], offsets[..., 1])
    np.fill_diagonal(distance, np.inf)
    overlap = np.maximum(contact_distance - distance, 0.0)
    slope = overlap / np.where(distance == 0.0, 1.0, distance)
    return float(0.5 * np.sum(overlap**2)), -2.0 * np.einsum("ij,ijk->ik", slope, offsets)


def pack_strands(
    layers: tuple[Layer, ...], insulation: Insulation, *, seed: int = 0, n_starts: int = 12
) -> CrossSection:
    """Pack equal strands by minimising their overlap energy from several seeded starts.

    Parameters
    ----------
    layers : layers of strands of one diameter. The packed strands are assigned to the layers by
        their distance from the axis. A first layer of one strand stays on the axis
    insulation : tube around the strands
    seed : seed of the starts; the same seed gives the same packing
    n_starts : largest number of starts, at least 1, alternately random and on perturbed rings; the
        search ends with the first packing without overlap

    Returns
    -------
    The packing with the lowest energy, turned so that the first strand of the first ring has the
    angle zero. A single strand lies on the axis.

    Raises
    ------
    ValueError
        If the diameters differ, or if the strands of the best packing overlap each other or the
        bore too much; the message states the overlap.
    """
    energy_tolerance = 1e-16  # in strand radii squared: overlaps of 1e-8 strand radii
    diameters = {layer.diameter for layer in layers}
    if len(diameters) > 1:
        message = f"diameters={sorted(diameters)}: only equal strands are packed"
        raise ValueError(message)
    if sum(layer.count for layer in layers) == 1:
        return place_strands("packed", layers, np.zeros((1, 2)), insulation)
    strand_radius, bore_radius = layers[0].diameter / 2.0, insulation.bore_radius
    rng = np.random.default_rng(seed)
    best_centres, lowest_energy = np.zeros(0), np.inf
    for start_number in range(n_starts):
        start = (
            _perturb_rings(layers, rng)
            if start_number % 2
            else _draw_random_centres(layers, bore_radius, rng)
        )
        # lengths in strand radii: the tolerances of the optimiser are absolute
        centres, energy = _minimise_overlap(
            start / strand_radius, bore_radius / strand_radius, has_core=layers[0].count == 1
        )
        if energy < lowest_energy:
            best_centres, lowest_energy = centres * strand_radius, energy
        if lowest_energy < energy_tolerance:
            break
    return place_strands("packed", layers, _sort_strands(best_centres, layers), insulation)


def _minimise_overlap(start: Floats, bore_radius: float, *, has_core: bool) -> tuple[Floats, float]:
    """Minimise the overlap energy; return centres and energy. All lengths are in strand radii."""
    core = np.zeros(2 * int(has_core))

    def compute_energy(coordinates: Floats) -> tuple[float, Floats]:
        all_coordinates = np.concatenate([core, coordinates])
        energy, gradient = compute_overlap_energy(all_coordinates, 1.0, bore_radius)
        return energy, gradient[len(core) :]

    optimum = minimize(
        compute_energy,
        start.ravel()[len(core) :],
        jac=True,
        method="L-BFGS-B",
        options={"ftol": 1e-16, "gtol": 1e-10, "maxiter": 1000},
    )
    return np.concatenate([core, optimum.x]).reshape(-1, 2), float(optimum.fun)


def _draw_random_centres(
    layers: tuple[Layer, ...], bore_radius: float, rng: np.random.Generator
) -> Floats:
    """Draw strand centres that are uniformly distributed within the bore."""
    n_strands = sum(layer.count for layer in layers)
    radius = (bore_radius - layers[0].diameter / 2.0) * np.sqrt(rng.uniform(size=n_strands))
    angle = rng.uniform(0.0, 2.0 * np.pi, n_strands)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])


def _perturb_rings(layers: tuple[Layer, ...], rng: np.random.Generator) -> Floats:
    """Return strand centres on concentric rings at random angles, with random offsets."""
    rings = []
    first_ring_number = 0 if layers[0].count == 1 else 1
    for ring_number, layer in enumerate(layers, start=first_ring_number):
        angle = 2.0 * np.pi * (np.arange(layer.count) / layer.count + rng.uniform())
        rings.append(ring_number * np.column_stack([np.cos(angle), np.sin(angle)]))
    centres = np.concatenate(rings) * layers[0].diameter
    return centres + rng.normal(scale=0.05 * layers[0].diameter, size=centres.shape)


def _sort_strands(centres: Floats, layers: tuple[Layer, ...]) -> Floats:
    """Sort strands by layer, then by angle; turn all so that the first ring starts at angle 0."""
    by_radius = centres[np.argsort(np.hypot(*centres.T), kind="stable")]
    layer_starts = np.cumsum([layer.count for layer in layers])[:-1]
    rings = [
        ring[np.argsort(np.arctan2(*ring.T[::-1]))] for ring in np.split(by_radius, layer_starts)
    ]
    first_strand = rings[1 if layers[0].count == 1 and len(rings) > 1 else 0][0]
    cosine, sine = first_strand / np.hypot(*first_strand)
    return np.asarray(np.concatenate(rings) @ np.array([[cosine, -sine], [sine, cosine]]))


def make_cross_section(
    layers: tuple[Layer, ...],
    insulation: Insulation,
    *,
    kind: LayoutKind | None = None,
    seed: int = 0,
) -> CrossSection:
    """Make the cross-section of a wire in one of four layouts.

    Parameters
    ----------
    layers : layers of strands, from the axis outwards
    insulation : tube around the strands
    kind : the layout. If None, the first of these that fits: the hexagon, concentric rings, or, for
        strands of one diameter, a packing
    seed : seed of the packing

    Raises
    ------
    ValueError
        If the layout does not fit the bore, or if it does not allow the numbers of strands or their
        diameters.
    """
    match kind:
        case "hexagonal":
            return place_hexagon(layers, insulation)
        case "concentric":
            return place_rings(layers, insulation)
        case "packed":
            return pack_strands(layers, insulation, seed=seed)
        case "compressed":
            return place_sectors(layers, insulation)
    for place_layers in (place_hexagon, place_rings):
        with suppress(ValueError):  # it does not fit: try the next layout
            return place_layers(layers, insulation)
    have_one_diameter = len({layer.diameter for layer in layers}) == 1
    # strands of several diameters: place_rings raises the error that states the overlap
    return (
        pack_strands(layers, insulation, seed=seed)
        if have_one_diameter
        else place_rings(layers, insulation)
    )


def find_helix_overlap(section: CrossSection) -> float:
    """Find the largest overlap of helical strands of one layer, as a share of their diameter.

    Strands that touch in the cross-section overlap as helices: measured across a strand, the
    distance of its neighbour is smaller by the factor cos(lay angle).

    Parameters
    ----------
    section : round strands in place; layers without a lay angle are ignored

    Returns
    -------
    The overlap over the diameter; 0 if no strands overlap.

    Notes
    -----
    The distance of two helices at the radii a and b, with the angle p between them and the pitch
    2 pi / k, is the minimum of sqrt(a^2 + b^2 - 2 a b cos(p - k z) + z^2) over z.
    """
    max_neighbour_distance = 1.5  # in strand diameters
    largest_overlap = 0.0
    for number, layer in enumerate(section.layers):
        is_in_layer = section.layer == number
        centres = np.column_stack([section.x[is_in_layer], section.y[is_in_layer]])
        first, second = (
            KDTree(centres)
            .query_pairs(max_neighbour_distance * layer.diameter, output_type="ndarray")
            .T
        )
        if first.size and layer.lay_angle:
            distances = _compute_helix_distances(centres[first], centres[second], layer.lay_angle)
            largest_overlap = max(largest_overlap, 1.0 - float(distances.min()) / layer.diameter)
    return largest_overlap


def _compute_helix_distances(first: Floats, second: Floats, lay_angle: float) -> Floats:
    """Compute the smallest distance of the centre lines of each pair of strands, shape (pairs,).

    The distance is computed from a point of the first strand to 401 points of the second one, from
    its point in the same cross-section to its point at the same angle.
    """
    a, b = np.hypot(*first.T), np.hypot(*second.T)
    signed_angle = np.arctan2(
        first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0], (first * second).sum(1)
    )
    pair_angle = np.abs(signed_angle)[:, None]
    angle = pair_angle * np.linspace(0.0, 1.0, 401)  # p - k z
    z = (pair_angle - angle) * np.sqrt(a * b)[:, None] / np.tan(abs(lay_angle))
    squared = (a**2 + b**2)[:, None] - 2.0 * (a * b)[:, None] * np.cos(angle) + z**2
    return np.asarray(np.sqrt(squared.min(axis=1)))
