"""Arrange the wires of a bundle in its cross-section, and choose a conduit for the bundle.

Up to 37 equal wires form a hexagon if their number allows it. The hexagon has a central wire (1, 7,
19 or 37 wires), or long and short sides around a core of three wires (3, 12 or 27 wires), as in
figure 4.2 of [1]_. For any other number, the arrangement with the smallest enclosing circle is
chosen. The candidates are sections of a triangular lattice and, for up to 100 wires, heaps. In a
heap, wires have been drawn together from starting positions until they touch. Unequal wires always
form a heap; their starting positions are those of the same number of equal wires.

In a heap the sum of diameter^2 x squared distance from the centre is a minimum, and no wires
overlap. The corresponding pull to the centre replaces the bore of [1]_, which would leave loose
wires in gaps. The wires are first relaxed with a soft contact energy, equations (3.1) to (3.4) of
[1]_. The contacts then harden until the overlaps are zero (method of multipliers [2]_ [3]_), and
Newton's method solves for the equilibrium. The relaxation evaluates only pairs of near wires, so
that the cost of a step is proportional to the number of wires. Newton's method solves a full
matrix. The heap is the same on every processor, to 1e-12 of a diameter.

References
----------
.. [1] *Modeling and characterization of wire harnesses for digital manufacturing applications*,
       dissertation.
.. [2] M. R. Hestenes, Multiplier and gradient methods, J. Optim. Theory Appl. 4 (1969) 303.
.. [3] M. J. D. Powell, A method for nonlinear constraints in minimization problems, in R. Fletcher
       (ed.), Optimization, 1969.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations, islice
from typing import Any

import numpy as np
from scipy.linalg import lstsq
from scipy.optimize import minimize
from scipy.spatial import cKDTree

from labpipe.mechanics.law.plays import require, require_finite, require_positive
from labpipe.records.arrays import Floats, Ints
from labpipe.records.harness_bundle import STATED_POSITIONS, Bundle, BundleLayout

_MAX_SEARCHED_WIRES = 100
"""Largest number of wires for which all starting positions are tried.

A larger number of equal wires forms a section of a lattice. A larger number of unequal wires is
drawn together from fewer starting positions.
"""
_SEED = 0
"""Seed of random starts and assignments; the same wires therefore have the same layout."""


def arrange_wires(
    bundle: Bundle, diameters: Sequence[float], stiffnesses: Sequence[float]
) -> BundleLayout:
    """Arrange the wires of a bundle in its cross-section.

    Parameters
    ----------
    bundle : composition and arrangement; stated positions override the arrangement
    diameters : m, diameter over the insulation of each wire type
    stiffnesses : N, axial stiffness of each wire type; in an asymmetric bundle, the stiffest type
        is on top

    Returns
    -------
    Layout with the wires in the order of `bundle.wires`. The origin is the centroid of the areas of
    the wires.

    Raises
    ------
    ValueError
        If the number of stated positions is not the number of wires, wires at stated positions
        overlap by more than 1 % of the smaller diameter, or wires of unequal diameters without
        stated positions do not come together (`find_densest_heap`).

    Notes
    -----
    Wire types are assigned to the sites of equal wires (`find_sites`). Wires of unequal diameters
    are then drawn together until they touch (`find_densest_heap`).
    """
    wire_types = np.repeat(np.arange(len(bundle.wires)), [wire.number for wire in bundle.wires])
    type_diameters = np.asarray(diameters, dtype=np.float64)
    wire_diameters = type_diameters[wire_types]
    if bundle.positions:
        arrangement, centres = STATED_POSITIONS, _read_stated_centres(bundle, wire_diameters)
    else:
        arrangement = bundle.arrangement
        centres = _compute_centres(bundle, type_diameters, stiffnesses)
    x, y = (centres - np.average(centres, axis=0, weights=wire_diameters**2)).T
    radius = float(np.max(np.hypot(x, y) + wire_diameters / 2.0))
    return BundleLayout(arrangement, x, y, wire_types, wire_diameters, radius)


def _read_stated_centres(bundle: Bundle, diameters: Floats) -> Floats:
    """Return the stated centres of the wires, m, after checks of their number and of overlaps."""
    max_relative_overlap = 0.01  # relative to the smaller diameter, as in the test sheet
    centres = np.asarray(bundle.positions, dtype=np.float64)
    n_centres, expected = len(centres), f"{len(diameters)}, one for each wire"
    require("number of positions", n_centres, expected, holds=n_centres == len(diameters))
    first, second = np.triu_indices(len(diameters), 1)
    distance = np.hypot(*(centres[first] - centres[second]).T)
    overlap = 0.5 * (diameters[first] + diameters[second]) - distance
    max_overlap = max_relative_overlap * np.minimum(diameters[first], diameters[second])
    if np.any(overlap > max_overlap):
        worst = int(np.argmax(overlap - max_overlap))
        message = (
            f"wires {first[worst] + 1} and {second[worst] + 1} overlap by "
            f"{1e3 * overlap[worst]:.3g} mm, expected at most {1e3 * max_overlap[worst]:.2g} mm"
        )
        raise ValueError(message)
    return centres


def _compute_centres(bundle: Bundle, diameters: Floats, stiffnesses: Sequence[float]) -> Floats:
    """Compute the centres of the wires, m, in the order of their types."""
    diameter_tolerance = 1e-9  # largest relative difference of diameters that count as equal
    sites = find_sites(bundle.number)
    counts = [wire.number for wire in bundle.wires]
    assignments = _assign_types(bundle.arrangement, sites, counts, stiffnesses)
    # The sites of each assignment are sorted by wire type.
    sorted_sites = [sites[np.argsort(wire_types, kind="stable")] for wire_types in assignments]
    if np.ptp(diameters) <= diameter_tolerance * diameters.max():
        return np.asarray(diameters.max() * sorted_sites[0])
    wire_diameters = np.repeat(diameters, counts)
    pitches = _choose_start_pitches(wire_diameters, len(assignments))
    starts = [pitch * sites for sites in sorted_sites for pitch in pitches]
    return find_densest_heap(starts, wire_diameters)


def _assign_types(
    arrangement: str, sites: Floats, counts: Sequence[int], stiffnesses: Sequence[float]
) -> list[Ints]:
    """Assign wire types to the sites.

    Returns
    -------
    Type of the wire on each site: one assignment for an asymmetric or symmetric bundle, several
    random assignments for a packed bundle.
    """
    if arrangement == "asymmetric":
        return [stack_types(sites, counts, stiffnesses)]
    if arrangement == "symmetric":
        return [spread_types(sites, counts)]
    rng = np.random.default_rng(_SEED)
    n_assignments = 8 if len(sites) <= _MAX_SEARCHED_WIRES else 4
    return [_assign_at_random(counts, rng) for _ in range(n_assignments)]


def _choose_start_pitches(wire_diameters: Floats, n_assignments: int) -> list[float]:
    """Choose distances between neighbouring sites in the starting positions of a heap, m."""
    pitch_factors = (0.6, 0.8, 1.0)  # relative to the pitch of equal wires
    equal_pitch = float(np.sqrt(np.mean(wire_diameters**2)))  # equal wires of the same total area
    if n_assignments > 1:
        return [equal_pitch]
    is_large = len(wire_diameters) > _MAX_SEARCHED_WIRES
    factors = pitch_factors[1:] if is_large else pitch_factors
    return [float(wire_diameters.max()), *(factor * equal_pitch for factor in factors)]


_MERIT_DECIMALS = 9
"""Decimal places to which figures of merit are rounded before they are compared.

Choices then do not depend on rounding errors.
"""


def _assign_at_random(counts: Sequence[int], rng: np.random.Generator) -> Ints:
    """Assign wire types to the sites at random."""
    return rng.permutation(np.repeat(np.arange(len(counts)), counts)).astype(np.int64)


def stack_types(sites: Floats, counts: Sequence[int], stiffnesses: Sequence[float]) -> Ints:
    """Assign wire types to the sites in layers, with the stiffest type on top.

    Parameters
    ----------
    sites : shape (wires, 2), wire diameters, positions of the sites; y is upwards, and the bundle
        bends along y
    counts : number of wires of each type
    stiffnesses : axial stiffness of each type, in any unit; of equally stiff types, the first is
        above the others

    Returns
    -------
    Shape (wires,), type of the wire on each site. In a row that two types share, the upper type has
    the sites that are best balanced about x = 0 and, among equally balanced choices, the sites
    nearest to x = 0. If a row allows more than 5000 choices, the first 5000 are compared.
    """
    wire_types = np.full(len(sites), -1, dtype=np.int64)
    for wire_type in sorted(range(len(counts)), key=lambda index: -stiffnesses[index]):
        free_sites = np.flatnonzero(wire_types < 0)
        wire_types[_choose_highest(sites, free_sites, counts[wire_type])] = wire_type
    return wire_types


def _choose_highest(sites: Floats, free_sites: Ints, count: int) -> Ints:
    """Choose the `count` highest free sites; those in the lowest row are balanced about x = 0."""
    row_tolerance = 1e-6  # largest difference of the heights of sites in one row, wire diameters
    max_choices = 5000
    if not count:
        return free_sites[:0]
    height = sites[free_sites, 1]
    row_height = np.sort(height)[-count]
    upper_sites = free_sites[height > row_height + row_tolerance]
    row_sites = free_sites[np.abs(height - row_height) <= row_tolerance]

    def compute_imbalance(chosen_sites: tuple[int, ...]) -> tuple[float, float]:
        x = sites[list(chosen_sites), 0]
        return round(float(abs(x.sum())), _MERIT_DECIMALS), float(np.abs(x).sum())

    choices = islice(combinations(row_sites.tolist(), count - len(upper_sites)), max_choices)
    balanced_sites = np.array(min(choices, key=compute_imbalance), dtype=np.int64)
    return np.concatenate([upper_sites, balanced_sites])


def spread_types(sites: Floats, counts: Sequence[int]) -> Ints:
    """Assign wire types to the sites so that each type is spread evenly over the bundle.

    Parameters
    ----------
    sites : shape (wires, 2), wire diameters, positions of the sites
    counts : number of wires of each type

    Returns
    -------
    Shape (wires,), type of the wire on each site. It is the best assignment found from several
    random assignments by exchanging two wires at a time.

    Notes
    -----
    The exchanges reduce the unevenness: the sum, over types and features, of (sum of the feature
    over the wires of the type)^2 / number of these wires. The features are x, y, x^2 - y^2, 2 x y
    and x^2 + y^2 of a site, centred over all sites and normalised. Of equally even assignments, the
    one with the fewest pairs of neighbours of the same type is preferred.

    If each type has the centroid and the second moments of the whole bundle, the bundle is as stiff
    in every direction as a bundle of equal wires with the mean axial stiffness. If, in addition,
    the second moments of the sites are isotropic, the stiffness is isotropic.
    """
    n_starts = 12
    features, neighbours = _compute_features(sites), _find_neighbours(sites)
    rng = np.random.default_rng(_SEED)
    starts = (_assign_at_random(counts, rng) for _ in range(n_starts))
    assignments = [_exchange_wires(start, features, neighbours) for start in starts]
    return min(assignments, key=lambda types: _compute_merit(types, features, neighbours))


def _compute_features(sites: Floats) -> Floats:
    """Compute x, y, x^2 - y^2, 2 x y and x^2 + y^2, centred and normalised, shape (sites, 5)."""
    x, y = (sites - sites.mean(axis=0)).T
    features = np.column_stack([x, y, x**2 - y**2, 2.0 * x * y, x**2 + y**2])
    mean_square = max(float(np.mean(x**2 + y**2)), np.finfo(float).tiny)
    scales = np.array([mean_square**0.5] * 2 + [mean_square] * 3)
    return np.asarray((features - features.mean(axis=0)) / scales)


def _find_neighbours(sites: Floats) -> Floats:
    """Return a matrix with 1 for each pair of neighbouring sites and 0 for all other pairs."""
    max_ratio = 1.2  # largest distance of neighbours relative to the smallest distance
    distance = np.hypot(*(sites[:, None] - sites).transpose(2, 0, 1))
    np.fill_diagonal(distance, np.inf)
    return np.asarray(distance < max_ratio * distance.min(initial=np.inf), dtype=np.float64)


def _compute_merit(wire_types: Ints, features: Floats, neighbours: Floats) -> tuple[float, int]:
    """Compute the unevenness of an assignment, and the number of its equal neighbour pairs.

    An equal pair consists of two neighbours of the same type.
    """
    membership = (wire_types[:, None] == np.arange(wire_types.max() + 1)).astype(np.float64)
    n_wires = np.maximum(membership.sum(axis=0), 1.0)
    unevenness = float(np.sum((membership.T @ features) ** 2 / n_wires[:, None]))
    n_equal_pairs = round(0.5 * float((membership * (neighbours @ membership)).sum()))
    return round(unevenness, _MERIT_DECIMALS), n_equal_pairs


def _exchange_wires(wire_types: Ints, features: Floats, neighbours: Floats) -> Ints:
    """Exchange the best pair of wires until no exchange improves the assignment."""
    merit = _compute_merit(wire_types, features, neighbours)
    while True:
        first, second = _find_exchange(wire_types, features, neighbours)
        exchanged_types = wire_types.copy()
        exchanged_types[[first, second]] = wire_types[[second, first]]
        new_merit = _compute_merit(exchanged_types, features, neighbours)
        if new_merit >= merit:
            return wire_types
        wire_types, merit = exchanged_types, new_merit


def _find_exchange(wire_types: Ints, features: Floats, neighbours: Floats) -> tuple[int, int]:
    """Find the two wires whose exchange gives the least unevenness, then the fewest equal pairs.

    S_k is the sum of the features t over the n_k wires of type k. If wire i of type a and wire j of
    type b are exchanged, S_a increases by d = t_j - t_i, and S_b decreases by d. The unevenness
    changes by (1/n_a + 1/n_b) d^2 + 2 d (S_a/n_a - S_b/n_b).
    """
    membership = (wire_types[:, None] == np.arange(wire_types.max() + 1)).astype(np.float64)
    n_wires = np.maximum(membership.sum(axis=0), 1.0)
    mean_products = features @ ((membership.T @ features) / n_wires[:, None]).T
    cross_products = mean_products[:, wire_types]  # t_i . S_b / n_b
    own_products = np.diag(cross_products)
    squared_norm = np.sum(features**2, axis=1)
    squared_difference = squared_norm[:, None] + squared_norm - 2.0 * features @ features.T
    inverse_count = 1.0 / n_wires[wire_types]
    change = (inverse_count[:, None] + inverse_count) * squared_difference
    change += 2.0 * (cross_products + cross_products.T - own_products[:, None] - own_products)
    n_of_type = (neighbours @ membership)[:, wire_types]  # neighbours of i that have the type of j
    gained_pairs = n_of_type - np.diag(n_of_type)[:, None]  # further equal pairs of wire i
    pair_change = gained_pairs + gained_pairs.T - 2.0 * neighbours
    change = np.where(wire_types[:, None] == wire_types, np.inf, np.round(change, _MERIT_DECIMALS))
    change[np.tri(len(wire_types), dtype=bool)] = np.inf  # each pair is compared once
    pairs = np.argwhere(change == change.min())
    pair = pairs[np.argmin(pair_change[pairs[:, 0], pairs[:, 1]])]
    return int(pair[0]), int(pair[1])


_LATTICE_CENTRES = np.array([[0.0, 0.0], [0.5, np.sqrt(3.0) / 6.0], [0.5, 0.0]])
"""Symmetric centres of sections of a triangular lattice, wire diameters.

They are the centre of a wire, a gap between three wires, and the contact of two wires.
"""
_RADIUS_TOLERANCE = 1e-9
"""Difference below which radii of arrangements count as equal, wire diameters."""


def find_sites(n_wires: int) -> Floats:
    """Find positions of equal wires that touch.

    Parameters
    ----------
    n_wires : number of wires, at least 1

    Returns
    -------
    Shape (n_wires, 2), wire diameters. The centroid of the positions is the origin. The positions
    are sorted by their distance from the origin, then by their angle from the x axis. Rows of a
    hexagon are along x.

    Raises
    ------
    ValueError
        If `n_wires` is less than 1.
    """
    # Index in `_LATTICE_CENTRES` of the centre of a hexagon, keyed by its number of wires. A larger
    # hexagon is wider than a round section of the lattice.
    hexagon_centres = {1: 0, 7: 0, 19: 0, 37: 0, 3: 1, 12: 1, 27: 1}
    require("number", n_wires, "a whole number >= 1", holds=n_wires >= 1)
    if n_wires in hexagon_centres:
        centre = _LATTICE_CENTRES[hexagon_centres[n_wires]]
        sites = _cut_lattice(n_wires, centre, is_hexagonal=True)
    else:
        sites = _search_densest_heap(n_wires)
    sites = sites - sites.mean(axis=0)
    angle = np.round(np.arctan2(sites[:, 1], sites[:, 0]), 9) % np.round(2.0 * np.pi, 9)
    return np.asarray(sites[np.lexsort([angle, np.round(np.hypot(*sites.T), 9)])])


def _cut_lattice(n_wires: int, centre: Floats, *, is_hexagonal: bool = False) -> Floats:
    """Return the points of a triangular lattice that are nearest to `centre`, relative to it.

    For a hexagon, the distance of a point is the largest of its three distances along the normals
    of the sides; the rings of the hexagon are then complete.
    """
    extent = 2 + math.isqrt(2 * n_wires)  # the lattice has more points than are selected
    column, row = np.mgrid[-extent : extent + 1, -extent : extent + 1].reshape(2, -1)
    points = np.column_stack([column + 0.5 * row, np.sqrt(0.75) * row]) - centre
    distance = np.hypot(*points.T)
    if is_hexagonal:
        normals = np.deg2rad([30.0, 90.0, 150.0])
        distance = np.abs(points @ np.array([np.cos(normals), np.sin(normals)])).max(axis=1)
    return np.asarray(points[np.argsort(np.round(distance, 9), kind="stable")[:n_wires]])


def _search_densest_heap(n_wires: int) -> Floats:
    """Find the arrangement of equal wires with the smallest enclosing circle.

    Sections of a lattice and, for up to 100 wires, a heap are compared.
    """
    n_starts = 8  # random starts of the heap in addition to sections of the lattice
    n_edge_steps = 8  # steps along an edge of the triangle of `_LATTICE_CENTRES`
    start_radius = 0.55  # radius of random starts, wire diameters per root of the number of wires
    rng = np.random.default_rng(_SEED)
    diameters = np.ones(n_wires)
    # By symmetry, centres outside the triangle of `_LATTICE_CENTRES` give the same sections.
    steps = np.linspace(0.0, 1.0, n_edge_steps + 1)
    coordinates = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    is_inside = coordinates.sum(axis=1) <= 1.0 + _RADIUS_TOLERANCE
    edges = _LATTICE_CENTRES[1:] - _LATTICE_CENTRES[0]
    centres = coordinates[is_inside] @ edges
    candidates = [_cut_lattice(n_wires, centre) for centre in (*_LATTICE_CENTRES, *centres)]
    if n_wires <= _MAX_SEARCHED_WIRES:
        radius = start_radius * math.sqrt(n_wires) * np.sqrt(rng.uniform(size=(n_starts, n_wires)))
        angle = rng.uniform(0.0, 2.0 * np.pi, size=(n_starts, n_wires))
        starts = [_cut_lattice(n_wires, centre) for centre in _LATTICE_CENTRES]
        starts += list(np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1))
        candidates.append(find_densest_heap(starts, diameters))
    radii = np.array([find_enclosing_circle(sites, diameters)[1] for sites in candidates])
    return candidates[int(np.argmax(radii < radii.min() + _RADIUS_TOLERANCE))]


_SOFT_STIFFNESSES = (10.0, 100.0)
"""Successive stiffnesses of a soft contact, relative to the stiffness of the pull to the centre.

They are low enough for a gradient method.
"""


@dataclass(frozen=True, slots=True, eq=False)
class WireContacts:
    """Pairs of wires near each other; arrays of shape (pairs,).

    Parameters
    ----------
    first_wires, second_wires : indices of the two wires of each pair
    touching_distance : distance of the centres at which the two wires touch
    force : contact force at zero overlap
    """

    first_wires: Ints
    second_wires: Ints
    touching_distance: Floats
    force: Floats


def find_densest_heap(starts: Sequence[Floats], diameters: Floats) -> Floats:
    """Draw wires together from several starting positions into a heap without overlaps.

    The wires are relaxed with soft contacts from each start. The contacts of the first heap whose
    radius is within 1 % of the smallest radius are hardened. A heap of three or more wires that
    fills at most 55 % of its enclosing circle is perturbed and drawn together again, up to six
    times.

    Parameters
    ----------
    starts : starting positions, at least one array of shape (wires, 2), m; wires may overlap
    diameters : shape (wires,), m, diameters of the wires

    Returns
    -------
    Shape (wires, 2), m, centres of the wires. The origin is the centroid of the areas of the wires.

    Raises
    ------
    ValueError
        If a position is not finite, a diameter is not positive, or the wires fill less than half of
        the smallest circle around them.
    """
    # Unequal wires can come to rest in a row or around a corner. These are the standard deviations
    # of successive perturbations, mean diameters.
    deviations = (0.1, 0.3, 1.0, 1.0, 1.0, 1.0)
    max_perturbed_fraction = 0.55  # a heap that fills a larger fraction is accepted
    require_finite("starts", np.asarray(starts))
    require("diameters", diameters.tolist(), "> 0", holds=bool(np.all(diameters > 0.0)))
    if len(diameters) == 1:
        return np.zeros((1, 2))
    scale = float(np.mean(diameters))
    scaled_diameters = diameters / scale
    heap = _form_heap([(start - start.mean(axis=0)) / scale for start in starts], scaled_diameters)
    for seed, deviation in enumerate(deviations if len(diameters) > 2 else ()):
        if _compute_filled_fraction(heap, scaled_diameters) > max_perturbed_fraction:
            break
        offsets = deviation * np.random.default_rng(seed).normal(size=heap.shape)
        heap = _form_heap([heap, heap + offsets], scaled_diameters)
    require_dense(heap, scaled_diameters)
    return np.asarray(scale * (heap - np.average(heap, axis=0, weights=scaled_diameters**2)))


def _form_heap(starts: Sequence[Floats], diameters: Floats) -> Floats:
    """Relax wires from each start, and harden the first heap of nearly the smallest radius."""
    radius_tolerance = 1e-2  # relative to the smallest radius of the soft heaps
    heaps = [_relax_soft(start, diameters) for start in starts]
    expanded_heaps = [heap * _compute_clearance_factor(heap, diameters) for heap, _ in heaps]
    radii = np.array([find_enclosing_circle(heap, diameters)[1] for heap in expanded_heaps])
    heap, contacts = heaps[int(np.argmax(radii <= (1.0 + radius_tolerance) * radii.min()))]
    heap = _harden_contacts(heap, diameters, contacts)
    return np.asarray(heap * _compute_clearance_factor(heap, diameters))


def _compute_filled_fraction(centres: Floats, diameters: Floats) -> float:
    """Compute the area of the wires relative to that of their enclosing circle.

    The fraction is 0 if a centre is not finite.
    """
    is_finite = bool(np.all(np.isfinite(centres)))
    radius = find_enclosing_circle(centres, diameters)[1] if is_finite else np.nan
    return compute_packing_fraction(diameters, 2.0 * radius) if np.isfinite(radius) else 0.0


def require_dense(centres: Floats, diameters: Floats) -> None:
    """Raise ValueError if the wires of a heap did not come together.

    Parameters
    ----------
    centres : shape (wires, 2), centres of the wires
    diameters : shape (wires,), diameters of the wires, in the same unit

    Raises
    ------
    ValueError
        If the wires fill less than half of the smallest circle around them. The message states the
        filled fraction.
    """
    min_filled_fraction = 0.5  # fraction of two equal wires; any heap of more wires is denser
    filled_fraction = _compute_filled_fraction(centres, diameters)
    if not filled_fraction > min_filled_fraction * (1.0 - 1e-6):  # tolerance for rounding
        message = (
            f"the {len(diameters)} wires did not come together: they fill {filled_fraction:.2g} of "
            f"the smallest circle around them, expected at least {min_filled_fraction:g}"
        )
        raise ValueError(message)


def _list_contacts(
    centres: Floats, diameters: Floats, previous: WireContacts | None = None
) -> WireContacts:
    """List pairs of wires that touch or could touch before the next list is made.

    Pairs that are in the previous list keep their forces. The force of other pairs is 0.
    """
    distance_factor = 1.5  # largest distance of a listed pair, relative to its touching distance
    max_distance = distance_factor * float(diameters.max())
    pairs = cKDTree(centres).query_pairs(max_distance, output_type="ndarray").astype(np.int64)
    first, second = pairs[np.lexsort(pairs.T[::-1])].T
    touching_distance = 0.5 * (diameters[first] + diameters[second])
    is_near = np.hypot(*(centres[first] - centres[second]).T) < distance_factor * touching_distance
    first, second = first[is_near], second[is_near]
    force = np.zeros(len(first))
    if previous is not None:
        old_keys = len(diameters) * previous.first_wires + previous.second_wires
        keys = len(diameters) * first + second
        _, old_rows, rows = np.intersect1d(old_keys, keys, assume_unique=True, return_indices=True)
        force[rows] = previous.force[old_rows]
    return WireContacts(first, second, touching_distance[is_near], force)


def _relax_soft(start: Floats, diameters: Floats) -> tuple[Floats, WireContacts]:
    """Draw wires with soft contacts together; return their centres and contacts."""
    force_tolerance = 1e-3  # relative to the pull at a distance of one mean diameter
    max_start_spread = 1.5  # relative to the spread of wires without gaps
    displacement = 1e-3  # displacement of each wire if some wires coincide, mean diameters
    centres = start
    if len(np.unique(centres, axis=0)) < len(centres):
        # Coincident wires are displaced in different directions.
        angle = np.arange(len(centres), dtype=np.float64)
        centres = centres + displacement * np.column_stack([np.cos(angle), np.sin(angle)])
    spread = np.sqrt(np.sum(centres**2) / len(centres))
    spread /= 0.25 * np.sqrt(2.0 * np.sum(diameters**2))  # spread of a disk of the same area
    centres = centres / max(1.0, spread / max_start_spread)
    contacts = _list_contacts(centres, diameters)
    for stiffness in _SOFT_STIFFNESSES:
        centres, contacts = _relax_wires(centres, diameters, contacts, stiffness, force_tolerance)
    return centres, contacts


def _relax_wires(
    start: Floats, diameters: Floats, contacts: WireContacts, stiffness: float, tolerance: float
) -> tuple[Floats, WireContacts]:
    """Move wires until the force on each wire is small; return their centres and contacts.

    The method is the fast inertial relaxation engine (FIRE; Bitzek et al., 2006,
    doi:10.1103/PhysRevLett.97.170201). Forces accelerate the wires, and the wires are stopped when
    they move against the forces. Rounding errors could decide which of many heaps results. Only
    sums, products and roots are therefore used, which are the same on every processor.
    """
    # After a larger displacement along x or y, wires that are not listed may touch.
    max_displacement = 0.17 * float(diameters.min())
    max_steps = 20000
    start_mixing = 0.1  # fraction of the velocity that is replaced by one along the force
    n_downhill_steps = 5  # number of downhill steps before the time step grows
    centres = listed_centres = start
    max_time_step = 1.0 / np.sqrt(6.0 * stiffness)
    time_step, mixing, velocity, downhill_steps = max_time_step, start_mixing, 0.0 * start, 0
    for _ in range(max_steps):
        force = -compute_heap_gradient(centres, diameters, contacts, stiffness)
        if np.max(np.abs(force)) < tolerance / len(diameters):
            break
        if np.sum(force * velocity) > 0.0:
            downhill_steps += 1
            if downhill_steps > n_downhill_steps:
                time_step, mixing = min(1.1 * time_step, max_time_step), 0.99 * mixing
        else:
            downhill_steps, mixing, velocity = 0, start_mixing, np.zeros_like(velocity)
            time_step = max(0.5 * time_step, 0.02 * max_time_step)
        velocity = velocity + time_step * force
        speed_per_force = np.sqrt(np.sum(velocity * velocity) / np.sum(force * force))
        velocity = (1.0 - mixing) * velocity + mixing * speed_per_force * force
        centres = centres + time_step * velocity
        if np.max(np.abs(centres - listed_centres)) > max_displacement:
            listed_centres, contacts = centres, _list_contacts(centres, diameters, contacts)
    return centres, _list_contacts(centres, diameters, contacts)


def _harden_contacts(start: Floats, diameters: Floats, contacts: WireContacts) -> Floats:
    """Harden the contacts; return the centres of the nearest heap without overlaps."""
    force_tolerance = 1e-5  # relative to the pull at a distance of one mean diameter
    stiffness_growth = 10.0
    max_stiffness = 1e3
    min_rounds, max_rounds = 4, 8
    max_wire_rounds = 1500  # number of rounds times number of wires, if it allows `min_rounds`
    overlap_tolerance = 1e-6  # mean diameters
    centres, stiffness = start, _SOFT_STIFFNESSES[-1]
    for _ in range(max(min_rounds, min(max_rounds, max_wire_rounds // len(diameters)))):
        overlap, _ = _compute_overlaps(centres, contacts)
        force = np.maximum(contacts.force + stiffness * overlap, 0.0)
        max_change = np.max(np.abs(force - contacts.force), initial=0.0)
        contacts = replace(contacts, force=force)
        if max_change < stiffness * overlap_tolerance:
            break
        stiffness = min(stiffness_growth * stiffness, max_stiffness)
        centres, contacts = _relax_wires(centres, diameters, contacts, stiffness, force_tolerance)
    centres = _solve_equilibrium(centres, diameters, contacts)
    # The energy does not depend on the rotation of the heap. The rotation nearest to the start is
    # chosen.
    weight, (x, y), (start_x, start_y) = diameters**2, centres.T, start.T
    angle = np.arctan2(weight @ (x * start_y - y * start_x), weight @ (x * start_x + y * start_y))
    rotation = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    return np.asarray(centres @ rotation)


def _solve_equilibrium(start: Floats, diameters: Floats, contacts: WireContacts) -> Floats:
    """Solve for the equilibrium of hard wires by Newton's method on forces and positions.

    Wires with a contact force touch, and the pull to the centre balances the contact forces.
    Redundant contacts of equal wires and the rotation of the whole heap make the system of
    equations singular. The smallest step that solves the system is therefore taken. The start is
    returned if a step is longer than 0.01 mean diameters or than half the previous step, or if 20
    steps are not sufficient.
    """
    tolerance = 1e-13  # mean diameters
    max_step = 1e-2  # mean diameters
    rank_tolerance = 1e-11  # relative to the largest singular value
    max_iterations = 20
    centres, force, pull = start, contacts.force, np.repeat(diameters**2 / len(diameters), 2)
    step, n_wires = np.inf, len(diameters)
    for _ in range(max_iterations):
        overlap, direction = _compute_overlaps(centres, contacts)
        is_active = (force > 0.0) | (overlap > tolerance)
        first, second = contacts.first_wires[is_active], contacts.second_wires[is_active]
        normal, active_force = direction[is_active], force[is_active]
        n_active, row = len(normal), np.arange(len(normal))
        overlap_gradient = np.zeros((n_active, n_wires, 2))
        overlap_gradient[row, first], overlap_gradient[row, second] = -normal, normal
        jacobian = overlap_gradient.reshape(n_active, -1)
        tangent_projection = np.eye(2) - normal[:, :, None] * normal[:, None, :]
        distance = (contacts.touching_distance - overlap)[is_active]
        rotation_stiffness = -(active_force / distance)[:, None, None] * tangent_projection
        blocks = np.zeros((n_wires, n_wires, 2, 2))
        np.add.at(blocks, (first, first), rotation_stiffness)
        np.add.at(blocks, (second, second), rotation_stiffness)
        np.add.at(blocks, (first, second), -rotation_stiffness)
        np.add.at(blocks, (second, first), -rotation_stiffness)
        stiffness = blocks.transpose(0, 2, 1, 3).reshape(2 * n_wires, -1) + np.diag(pull)
        system = np.block([[stiffness, jacobian.T], [jacobian, np.zeros((n_active, n_active))]])
        wire_residual = pull * centres.ravel() + jacobian.T @ active_force
        residual = np.concatenate([wire_residual, overlap[is_active]])
        solution = lstsq(system, -residual, cond=rank_tolerance, lapack_driver="gelsy")[0]
        previous_step, step = step, float(np.max(np.abs(solution[: 2 * n_wires])))
        if step > max(0.5 * previous_step, tolerance) or step > max_step:
            return start
        centres = centres + solution[: 2 * n_wires].reshape(-1, 2)
        force = force.copy()
        force[is_active] = np.maximum(active_force + solution[2 * n_wires :], 0.0)
        if step < tolerance:
            return np.asarray(centres)
    return start


def compute_heap_gradient(
    centres: Floats, diameters: Floats, contacts: WireContacts, stiffness: float
) -> Floats:
    """Compute the gradient of the energy of wires that touch and are pulled to the origin.

    Parameters
    ----------
    centres : shape (n, 2), centres of the wires
    diameters : shape (n,), diameters of the wires, in the same unit
    contacts : pairs of wires with their contact forces f
    stiffness : stiffness k of a contact

    Returns
    -------
    Shape (n, 2), gradient of the energy with respect to the centres. The energy is (sum over wires
    of diameter^2 x squared distance from the origin) / (2 n) + sum over pairs of
    max(f + k overlap, 0)^2 / (2 k).
    """
    overlap, direction = _compute_overlaps(centres, contacts)
    force = np.maximum(contacts.force + stiffness * overlap, 0.0)
    gradient: Floats = diameters[:, None] ** 2 / len(centres) * centres
    for axis in range(2):
        component = force * direction[:, axis]
        gradient[:, axis] += np.bincount(contacts.second_wires, component, len(centres))
        gradient[:, axis] -= np.bincount(contacts.first_wires, component, len(centres))
    return gradient


def _compute_overlaps(centres: Floats, contacts: WireContacts) -> tuple[Floats, Floats]:
    """Return the overlap of each pair and the unit vector from the second wire to the first.

    The overlap is negative for a gap.
    """
    offsets = centres[contacts.first_wires] - centres[contacts.second_wires]
    distance = np.sqrt(offsets[:, 0] ** 2 + offsets[:, 1] ** 2)
    overlap = contacts.touching_distance - distance
    return overlap, offsets / np.where(distance == 0.0, 1.0, distance)[:, None]


def _compute_clearance_factor(centres: Floats, diameters: Floats) -> float:
    """Return the smallest factor >= 1 on all distances with which no wires overlap."""
    contacts = _list_contacts(centres, diameters)
    distance = contacts.touching_distance - _compute_overlaps(centres, contacts)[0]
    return float(np.max(contacts.touching_distance / distance, initial=1.0))


def find_enclosing_circle(centres: Floats, diameters: Floats) -> tuple[Floats, float]:
    """Find the smallest circle that encloses all wires.

    Parameters
    ----------
    centres : shape (wires, 2), m, centres of the wires
    diameters : shape (wires,), m, diameters of the wires

    Returns
    -------
    Centre of the circle, shape (2,), m, and its radius, m.

    Notes
    -----
    The radius is minimised by sequential least-squares programming, with one convex constraint for
    each wire.
    """
    scale = float(diameters.max()) / 2.0
    points, wire_radii = centres / scale, diameters / 2.0 / scale

    def compute_extents(circle_centre: Floats) -> Floats:
        return np.asarray(np.hypot(*(points - circle_centre).T) + wire_radii)

    def compute_radius(circle: Floats) -> tuple[float, Floats]:
        return float(circle[2]), np.array([0.0, 0.0, 1.0])

    clearance: Any = {"type": "ineq", "fun": lambda circle: circle[2] - compute_extents(circle[:2])}
    start_centre = points.mean(axis=0)
    solution = minimize(
        compute_radius,
        np.append(start_centre, compute_extents(start_centre).max()),
        jac=True,
        method="SLSQP",
        constraints=clearance,
        options={"ftol": 1e-12, "maxiter": 200},
    ).x
    return np.asarray(scale * solution[:2]), float(scale * compute_extents(solution[:2]).max())


TARGET_PACKING_FRACTION = 0.7
"""Packing fraction for which conduits are chosen in [1]_."""


def compute_packing_fraction(diameters: Floats, bore: float) -> float:
    """Compute the ratio of the area of the wires to the area of the bore.

    Parameters
    ----------
    diameters : shape (wires,), m, diameters over the insulation
    bore : m, inner diameter of the conduit

    Raises
    ------
    ValueError
        If the bore is not finite and positive.
    """
    require_positive("bore", bore)
    return float(np.sum(diameters**2) / bore**2)


def compute_bore(diameters: Floats, packing_fraction: float = TARGET_PACKING_FRACTION) -> float:
    """Compute the bore of a conduit in which wires have a given packing fraction, m.

    Parameters
    ----------
    diameters : shape (wires,), m, diameters over the insulation
    packing_fraction : area of the wires relative to the area of the bore

    Raises
    ------
    ValueError
        If the packing fraction is not finite and positive.
    """
    require_positive("packing_fraction", packing_fraction)
    return float(np.sqrt(np.sum(diameters**2) / packing_fraction))


def choose_bore(diameters: Floats, bores: Sequence[float], *, min_bore: float) -> float:
    """Choose the bore whose packing fraction is nearest to `TARGET_PACKING_FRACTION`.

    Parameters
    ----------
    diameters : shape (wires,), m, diameters over the insulation
    bores : m, inner diameters of the available conduits
    min_bore : m, diameter of the circle that encloses the wires; narrower conduits are left out

    Returns
    -------
    One of `bores`, m. If two bores are equally near, the wider bore is returned.

    Raises
    ------
    ValueError
        If the wires fit none of the conduits.
    """
    fitting_bores = [bore for bore in bores if fits_bore(min_bore, bore)]
    if not fitting_bores:
        bore_text = ", ".join(f"{1e3 * bore:.4g}" for bore in bores) or "none"
        message = (
            f"the narrowest arrangement found needs a bore of {1e3 * min_bore:.4g} mm, "
            f"and the conduits have {bore_text} mm"
        )
        raise ValueError(message)

    def compute_deviation(bore: float) -> tuple[float, float]:
        return abs(compute_packing_fraction(diameters, bore) - TARGET_PACKING_FRACTION), -bore

    return min(fitting_bores, key=compute_deviation)


def fits_bore(min_bore: float, bore: float) -> bool:
    """Return whether wires fit a bore, with a relative tolerance of one millionth.

    Parameters
    ----------
    min_bore : m, diameter of the circle that encloses the wires
    bore : m, inner diameter of the conduit
    """
    return min_bore <= bore * (1.0 + 1e-6)
