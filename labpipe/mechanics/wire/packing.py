"""Strands packed into a bore by least overlap energy, and the choice of a layout (PHYSICS 4).

Eqs. (3.1)-(3.4) of the dissertation: the energy is the sum of squared overlaps of strands with each
other (each pair counted from both sides) and with the bore. From random starts this gives *a*
packing, not *the* layout: seven strands nearly always end in the hexagon, 19 or 37 never do, and
slack leaves a continuum of packings. Hence the best of several seeded starts is kept, some of them
rings with jitter, and the hexagon is the usual choice.
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

Kind: TypeAlias = Literal["hexagonal", "concentric", "packed", "compressed"]


def compute_overlap_energy(
    flat: Floats, strand_radius: float, bore_radius: float
) -> tuple[float, Floats]:
    """Return the energy of equal strands in a bore, and its gradient.

    Parameters
    ----------
    flat : shape (2 n,), m, x and y of one strand after the other
    strand_radius, bore_radius : m

    Returns
    -------
    Sum over strands of squared overlaps, m^2, eq. (3.4); gradient, shape (2 n,), m.
    """
    centres = flat.reshape(-1, 2)
    pairs, push = compute_squared_overlaps(centres, 2.0 * strand_radius)
    radius = np.hypot(*centres.T)
    beyond = np.maximum(radius + strand_radius - bore_radius, 0.0)
    pull = 2.0 * beyond / np.where(radius == 0.0, 1.0, radius)
    gradient = pull[:, None] * centres + 2.0 * push
    return float(2.0 * pairs + np.sum(beyond**2)), gradient.ravel()


def compute_squared_overlaps(centres: Floats, touching: Floats | float) -> tuple[float, Floats]:
    """Return the sum of squared overlaps of circles, each pair once, and its gradient.

    Parameters
    ----------
    centres : shape (n, 2), m
    touching : m, distance at which two circles touch: of all pairs, or shape (n, n)

    Returns
    -------
    Sum, m^2, and gradient, shape (n, 2), m. Coincident circles do
    not push each other.
    """
    offsets = centres[:, None] - centres[None]
    distance = np.hypot(offsets[..., 0], offsets[..., 1])
    np.fill_diagonal(distance, np.inf)
    depth = np.maximum(touching - distance, 0.0)
    push = depth / np.where(distance == 0.0, 1.0, distance)
    return float(0.5 * np.sum(depth**2)), -2.0 * np.einsum("ij,ijk->ik", push, offsets)


def pack_strands(
    layers: tuple[Layer, ...], insulation: Insulation, *, seed: int = 0, n_starts: int = 12
) -> CrossSection:
    """Pack equal strands with the least overlap energy of several seeded starts.

    Parameters
    ----------
    layers : strands are assigned to them by distance from the axis; equal diameters. A core of one
        strand stays on the axis
    insulation : the tube, whose bore bounds the strands
    seed : of the random starts; same seed, same packing. A single strand lies on the axis
    n_starts : largest number of starts, random and from rings with jitter in turns; the first
        without overlap ends the search

    Raises
    ------
    ValueError
        If the diameters differ, or the best packing overlaps too much; the message states the
        overlap.
    """
    min_energy = 1e-16  # of strands of radius 1: overlaps of 1e-8
    diameters = {layer.diameter for layer in layers}
    if len(diameters) > 1:
        message = f"diameters={sorted(diameters)}: only equal strands are packed"
        raise ValueError(message)
    if sum(layer.count for layer in layers) == 1:  # a single strand lies on the axis
        return place_strands("packed", layers, np.zeros((1, 2)), insulation)
    strand, bore = layers[0].diameter / 2.0, insulation.bore_radius
    rng = np.random.default_rng(seed)
    best, least = np.zeros(0), np.inf
    for start in range(n_starts):
        begin = _ring_start(layers, rng) if start % 2 else _random_start(layers, bore, rng)
        # In units of the strand's radius, so that the tolerances mean something.
        centres, energy = _minimise_overlap(begin / strand, bore / strand, layers[0].count == 1)
        if energy < least:
            best, least = centres * strand, energy
        if least < min_energy:
            break
    return place_strands("packed", layers, _ordered_strands(best, layers), insulation)


def _minimise_overlap(begin: Floats, bore: float, has_core: bool) -> tuple[Floats, float]:
    """Minimise the energy from a start; return centres and energy, in strand radii."""
    core = np.zeros(2 * int(has_core))

    def energy(free: Floats) -> tuple[float, Floats]:
        value, gradient = compute_overlap_energy(np.concatenate([core, free]), 1.0, bore)
        return value, gradient[len(core) :]

    optimum = minimize(
        energy,
        begin.ravel()[len(core) :],
        jac=True,
        method="L-BFGS-B",
        options={"ftol": 1e-16, "gtol": 1e-10, "maxiter": 1000},
    )
    return np.concatenate([core, optimum.x]).reshape(-1, 2), float(optimum.fun)


def _random_start(layers: tuple[Layer, ...], bore: float, rng: np.random.Generator) -> Floats:
    n_strands = sum(layer.count for layer in layers)
    radius = (bore - layers[0].diameter / 2.0) * np.sqrt(rng.uniform(size=n_strands))
    angle = rng.uniform(0.0, 2.0 * np.pi, n_strands)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])


def _ring_start(layers: tuple[Layer, ...], rng: np.random.Generator) -> Floats:
    rings = []
    first = 0 if layers[0].count == 1 else 1
    for number, layer in enumerate(layers, start=first):
        turns = np.arange(layer.count) / layer.count + rng.uniform()
        angle = 2.0 * np.pi * turns
        rings.append(number * np.column_stack([np.cos(angle), np.sin(angle)]))
    points = np.concatenate(rings) * layers[0].diameter
    return points + rng.normal(scale=0.05 * layers[0].diameter, size=points.shape)


def _ordered_strands(centres: Floats, layers: tuple[Layer, ...]) -> Floats:
    """Sort strands by layer, then angle, and turn the first of the first ring to angle 0."""
    ordered = centres[np.argsort(np.hypot(*centres.T), kind="stable")]
    ends = np.cumsum([layer.count for layer in layers])[:-1]
    rings = [ring[np.argsort(np.arctan2(*ring.T[::-1]))] for ring in np.split(ordered, ends)]
    first = rings[1 if layers[0].count == 1 and len(rings) > 1 else 0][0]
    cosine, sine = first / np.hypot(*first)
    return np.asarray(np.concatenate(rings) @ np.array([[cosine, -sine], [sine, cosine]]))


def lay_out(
    layers: tuple[Layer, ...], insulation: Insulation, *, kind: Kind | None = None, seed: int = 0
) -> CrossSection:
    """Lay the strands out in one of four layouts.

    Parameters
    ----------
    layers : from the axis outwards
    insulation : the tube
    kind : the layout; without one the hexagon where counts, diameters and bore allow it, else rings
        where they fit, else the packing for equal strands
    seed : of the packing

    Raises
    ------
    ValueError
        If the layout does not fit; the message states the overlap.
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
    for symmetric in (place_hexagon, place_rings):
        with suppress(ValueError):  # does not fit: try the next one
            return symmetric(layers, insulation)
    is_equal = len({layer.diameter for layer in layers}) == 1
    # unequal strands: concentric raises with its reason
    return (
        pack_strands(layers, insulation, seed=seed) if is_equal else place_rings(layers, insulation)
    )


def find_helix_overlap(section: CrossSection) -> float:
    """Return the deepest overlap of helices of one layer, over their diameter.

    Circles that touch in the section are helices that overlap: across its own axis a strand has
    cos(lay angle) of its spacing around the wire.

    Parameters
    ----------
    section : round strands in place

    Notes
    -----
    Two helices at radii a and b, with the angle p between them and the pitch 2 pi / k, are apart by
    the least of sqrt(a^2 + b^2 - 2 a b cos(p - k z) + z^2) over z.
    """
    neighbour_diameters = 1.5
    deepest = 0.0
    for number, layer in enumerate(section.layers):
        in_layer = section.layer == number
        centres = np.column_stack([section.x[in_layer], section.y[in_layer]])
        first, second = (
            KDTree(centres)
            .query_pairs(neighbour_diameters * layer.diameter, output_type="ndarray")
            .T
        )
        if first.size and layer.lay_angle:
            distances = _helix_distances(centres[first], centres[second], layer.lay_angle)
            deepest = max(deepest, 1.0 - float(distances.min()) / layer.diameter)
    return deepest


def _helix_distances(first: Floats, second: Floats, lay_angle: float) -> Floats:
    """Return the least distance of pairs of centre lines, shape (pairs,)."""
    a, b = np.hypot(*first.T), np.hypot(*second.T)
    turn = np.arctan2(
        first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0], (first * second).sum(1)
    )
    ahead = np.abs(turn)[:, None] * np.linspace(0.0, 1.0, 401)
    along = (np.abs(turn)[:, None] - ahead) * np.sqrt(a * b)[:, None] / np.tan(abs(lay_angle))
    squared = (a**2 + b**2)[:, None] - 2.0 * (a * b)[:, None] * np.cos(ahead) + along**2
    return np.asarray(np.sqrt(squared.min(axis=1)))
