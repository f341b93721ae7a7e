"""Layout of the wires of a bundle: positions, types, the heap they make, and its conduit.

One, seven, nineteen ... equal wires make a hexagon around one of them; three, twelve, twenty-seven
a hexagon with long and short sides around a core of three (figure 4.2 of the dissertation), up to
37 wires. Any other number makes the heap in the smallest circle, of lattices and, up to 100 wires,
of wires drawn together from several starts. Unequal wires are drawn together from such sites.

The heap sought has the least sum of diameter^2 x squared distance from the middle without any
overlap: a bore leaves loose wires in the gaps, a pull to the middle does not. Wires first relax in
a soft energy, eqs. (3.1)-(3.4) of the dissertation with the pull in place of the bore; then
contacts harden until the overlaps that the pull left are gone (method of multipliers: Hestenes and
Powell, 1969), and Newton's method brings the heap to rest. The relaxation evaluates only pairs of
near wires, so that the cost of a step grows linearly; Newton's method solves a full matrix. The
heap is the same on every processor, to 1e-12 of a diameter.
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
from labpipe.records.harness_bundle import STATED, Bundle, BundleLayout

_MAX_SEARCHED_WIRES = 100
"""Most wires for which all starts are tried; more equal wires make a lattice, and more unequal ones
are drawn together from fewer starts."""


def arrange_wires(
    bundle: Bundle, diameters: Sequence[float], stiffness: Sequence[float], *, seed: int = 0
) -> BundleLayout:
    """Lay out the wires of a bundle.

    Parameters
    ----------
    bundle : stated positions override its arrangement
    diameters : m, over the insulation, of each type of wire
    stiffness : N, axial stiffness of each type; decides which lies on top of an asymmetric bundle
    seed : of the random choices; same seed, same layout

    Returns
    -------
    Wires in the order of `bundle.wires`, about the centroid of their areas.

    Raises
    ------
    ValueError
        If stated positions are not one for each wire, or wires at them overlap by more than 1 % of
        the smaller diameter; without stated positions, if wires of unequal diameters do not come
        together (`find_densest_heap`).

    Notes
    -----
    The types are spread over sites of equal wires, see `place_sites`. Wires of unequal
    diameters are then drawn together from there until they touch, see `find_densest_heap`.
    """
    wire_type = np.repeat(np.arange(len(bundle.wires)), [wire.number for wire in bundle.wires])
    diameter = np.asarray(diameters, dtype=np.float64)[wire_type]
    if bundle.positions:
        centres = _check_stated_centres(bundle, diameter)
        return _make_layout(STATED, centres, wire_type, diameter)
    centres = _find_centres(bundle, np.asarray(diameters, dtype=np.float64), stiffness, seed)
    return _make_layout(bundle.arrangement, centres, wire_type, diameter)


def _check_stated_centres(bundle: Bundle, diameter: Floats) -> Floats:
    # Tolerated overlap of stated positions, of the smaller wire's diameter, as in the test sheet.
    max_stated_overlap = 0.01
    centres = np.asarray(bundle.positions, dtype=np.float64)
    number, wanted = len(centres), f"{len(diameter)}, one for each wire"
    require("number of positions", number, wanted, holds=number == len(diameter))
    first, second = np.triu_indices(len(diameter), 1)
    distance = np.hypot(*(centres[first] - centres[second]).T)
    depth = 0.5 * (diameter[first] + diameter[second]) - distance
    allowed = max_stated_overlap * np.minimum(diameter[first], diameter[second])
    if np.any(depth > allowed):
        worst = int(np.argmax(depth - allowed))
        message = (
            f"wires {first[worst] + 1} and {second[worst] + 1} overlap by {1e3 * depth[worst]:.3g} "
            f"mm, expected at most {1e3 * allowed[worst]:.2g} mm"
        )
        raise ValueError(message)
    return centres


def _find_centres(
    bundle: Bundle, diameters: Floats, stiffness: Sequence[float], seed: int
) -> Floats:
    """Return the centres of the wires, type by type, m."""
    equal_diameter_share = 1e-9
    places = place_sites(bundle.number, seed=seed)
    counts = [wire.number for wire in bundle.wires]
    if len(counts) == 1 or np.ptp(diameters) <= equal_diameter_share * diameters.max():
        wire_type = _assign_types(bundle.arrangement, places, counts, stiffness, seed)[0]
        return _sort_by_type(diameters.max() * places, wire_type)
    wire_diameters = np.repeat(diameters, counts)
    assignments = _assign_types(bundle.arrangement, places, counts, stiffness, seed)
    starts = [
        _sort_by_type(width * places, wire_type)
        for wire_type in assignments
        for width in _choose_start_pitches(wire_diameters, assignments)
    ]
    return find_densest_heap(starts, wire_diameters)


def _assign_types(
    arrangement: str, places: Floats, counts: Sequence[int], stiffness: Sequence[float], seed: int
) -> list[Ints]:
    """Assign types to the sites: once if asymmetric or symmetric, several times if packed."""
    n_shuffles = 8  # of a packed bundle of up to 100 wires, half as many of a larger one
    match arrangement:
        case "asymmetric":
            return [stack_types(places, counts, stiffness)]
        case "symmetric":
            return [spread_evenly(places, counts, seed=seed)]
        case _:
            rng = np.random.default_rng(seed)
            shuffles = n_shuffles if len(places) <= _MAX_SEARCHED_WIRES else n_shuffles // 2
            return [_shuffle_types(counts, rng) for _ in range(shuffles)]


def _choose_start_pitches(wire_diameters: Floats, assignments: Sequence[Ints]) -> list[float]:
    """Return the distances of the sites from which wires are drawn together, m."""
    pitch_shares = (0.6, 0.8, 1.0)  # initial distances of the sites, per pitch of equal wires
    equal_pitch = float(np.sqrt(np.mean(wire_diameters**2)))  # for equal wires of the same area
    if len(assignments) > 1:
        return [equal_pitch]
    shares = pitch_shares if len(wire_diameters) <= _MAX_SEARCHED_WIRES else pitch_shares[1:]
    return [float(wire_diameters.max()), *(share * equal_pitch for share in shares)]


def _sort_by_type(centres: Floats, wire_types: Ints) -> Floats:
    return np.asarray(centres[np.argsort(wire_types, kind="stable")])


def _make_layout(name: str, centres: Floats, wire_types: Ints, diameter: Floats) -> BundleLayout:
    about = centres - np.average(centres, axis=0, weights=diameter**2)
    radius = float(np.max(np.hypot(*about.T) + diameter / 2.0))
    return BundleLayout(name, about[:, 0], about[:, 1], wire_types, diameter, radius)


_MERIT_DIGITS = 9


def _shuffle_types(counts: Sequence[int], rng: np.random.Generator) -> Ints:
    """Shuffle wire types; return the type of the wire on each site."""
    return rng.permutation(np.repeat(np.arange(len(counts)), counts)).astype(np.int64)


def stack_types(sites: Floats, counts: Sequence[int], stiffness: Sequence[float]) -> Ints:
    """Lay the types one above the other, the stiffest on top.

    Parameters
    ----------
    sites : shape (wires, 2), wire diameters; y is the direction of bending, upwards
    counts : wires of each type
    stiffness : axial stiffness of each type, in any unit; of equally stiff types the first lies
        higher

    Returns
    -------
    Shape (wires,), the type of the wire on each site. Of a row that two types share, the upper one
    has the sites that are best balanced about x = 0, of those the ones nearest to it. Of a row with
    more than 5000 choices, only the first 5000 are compared.
    """
    wire_types = np.full(len(sites), -1, dtype=np.int64)
    for key in sorted(range(len(counts)), key=lambda index: -stiffness[index]):
        wire_types[_choose_topmost(sites, np.flatnonzero(wire_types < 0), counts[key])] = key
    return wire_types


def _choose_topmost(sites: Floats, free: Ints, count: int) -> Ints:
    """Return the highest free sites, balanced about x = 0 within the lowest row taken."""
    row_height = 1e-6  # wire diameters: sites in one row differ by less in height
    max_choices = 5000
    if not count:
        return free[:0]
    height = sites[free, 1]
    edge = np.sort(height)[-count]
    above, row = free[height > edge + row_height], free[np.abs(height - edge) <= row_height]

    def unbalance(chosen: tuple[int, ...]) -> tuple[float, float]:
        across = sites[list(chosen), 0]
        return round(float(abs(across.sum())), _MERIT_DIGITS), float(np.abs(across).sum())

    choices = islice(combinations(row.tolist(), count - len(above)), max_choices)
    return np.concatenate([above, np.array(min(choices, key=unbalance), dtype=np.int64)])


def spread_evenly(sites: Floats, counts: Sequence[int], *, seed: int = 0) -> Ints:
    """Spread every type evenly over the bundle.

    Parameters
    ----------
    sites : shape (wires, 2), wire diameters
    counts : wires of each type
    seed : of the starts; same seed, same spread

    Returns
    -------
    Shape (wires,), the type of the wire on each site: the best that exchanges of two wires find
    from several starts.

    Notes
    -----
    The exchanges reduce the unevenness: the sum over types and traits of (sum of the trait over the
    wires of the type)^2 / wires, where the traits x, y, x^2 - y^2, 2 x y, x^2 + y^2 are centred
    over all wires and normalised. Among equal ones, neighbours of one type are fewest. A bundle in
    which each type has the centroid and the second moments of the whole is as stiff, in every
    direction, as one of wires of the mean axial stiffness, whatever the stiffnesses of the types:
    if the sites have no preferred direction, the bundle has none either.
    """
    n_spread_starts = 12  # seeded starts of the search for an even spread
    traits, neighbours = _compute_traits(sites), _find_neighbours(sites)
    rng = np.random.default_rng(seed)
    starts = (_shuffle_types(counts, rng) for _ in range(n_spread_starts))
    spreads = [_exchange_wires(start, traits, neighbours) for start in starts]
    return min(spreads, key=lambda wire_types: _rate_unevenness(wire_types, traits, neighbours))


def _compute_traits(sites: Floats) -> Floats:
    x, y = (sites - sites.mean(axis=0)).T
    traits = np.column_stack([x, y, x**2 - y**2, 2.0 * x * y, x**2 + y**2])
    size = max(float(np.mean(x**2 + y**2)), np.finfo(float).tiny)
    return np.asarray((traits - traits.mean(axis=0)) / np.array([size**0.5] * 2 + [size] * 3))


def _find_neighbours(sites: Floats) -> Floats:
    """Return 1 for sites that nearly touch, else 0, shape (sites, sites)."""
    distance = np.hypot(*(sites[:, None] - sites).transpose(2, 0, 1))
    np.fill_diagonal(distance, np.inf)
    return np.asarray(distance < 1.2 * distance.min(initial=np.inf), dtype=np.float64)


def _rate_unevenness(wire_types: Ints, traits: Floats, touches: Floats) -> tuple[float, int]:
    """Return the unevenness and the number of neighbouring pairs of one type."""
    member = (wire_types[:, None] == np.arange(wire_types.max() + 1)).astype(np.float64)
    count = np.maximum(member.sum(axis=0), 1.0)
    unevenness = float(np.sum((member.T @ traits) ** 2 / count[:, None]))
    return round(unevenness, _MERIT_DIGITS), round(0.5 * float((member * (touches @ member)).sum()))


def _exchange_wires(wire_types: Ints, traits: Floats, touches: Floats) -> Ints:
    """Exchange the best pair of wires until no exchange helps."""
    best, lowest = wire_types, _rate_unevenness(wire_types, traits, touches)
    while True:
        first, second = _find_exchange(best, traits, touches)
        exchanged = best.copy()
        exchanged[[first, second]] = best[[second, first]]
        merit = _rate_unevenness(exchanged, traits, touches)
        if merit >= lowest:
            return best
        best, lowest = exchanged, merit


def _find_exchange(wire_types: Ints, traits: Floats, touches: Floats) -> tuple[int, int]:
    """Return the two wires whose exchange is best: least unevenness, then fewest equal neighbours.

    With S_k the sum of the traits t over n_k wires of type k, and d = t_j - t_i: S_a grows by d and
    S_b falls by it, where a and b are the types of i and j.
    """
    member = (wire_types[:, None] == np.arange(wire_types.max() + 1)).astype(np.float64)
    count = np.maximum(member.sum(axis=0), 1.0)
    pull = traits @ ((member.T @ traits) / count[:, None]).T  # t_i . S_k / n_k
    pulls, among = pull[np.arange(len(wire_types)), wire_types], pull[:, wire_types]
    size = np.sum(traits**2, axis=1)
    distances = size[:, None] + size - 2.0 * traits @ traits.T
    share = 1.0 / count[wire_types]
    change = (share[:, None] + share) * distances + 2.0 * (among + among.T - pulls[:, None] - pulls)
    neighbours = (touches @ member)[:, wire_types]
    own_beside = np.diag(neighbours)
    alike = neighbours + neighbours.T - own_beside[:, None] - own_beside - 2.0 * touches
    change = np.where(wire_types[:, None] == wire_types, np.inf, np.round(change, _MERIT_DIGITS))
    change[np.tri(len(wire_types), dtype=bool)] = np.inf  # each pair once
    candidates = np.argwhere(change == change.min())
    first = candidates[np.argmin(alike[candidates[:, 0], candidates[:, 1]])]
    return int(first[0]), int(first[1])


_HEAP_CENTRES = np.array([[0.0, 0.0], [0.5, np.sqrt(3.0) / 6.0], [0.5, 0.0]])
"""Centre of a heap: a wire, three wires around a gap, two wires side by side."""
_WIDTH_ROUND = 1e-9


def place_sites(number: int, *, seed: int = 0) -> Floats:
    """Find positions of equal wires that touch.

    Parameters
    ----------
    number : of wires, at least 1
    seed : of random starts; same seed, same positions. Hexagons of up to 37 wires and heaps of more
        than 100 wires do not depend on it

    Returns
    -------
    Shape (number, 2), wire diameters, from the middle outwards, with their centroid at the origin.
    Positions at one distance are ordered by their angle from the x axis. Rows of a hexagon lie
    along x.

    Raises
    ------
    ValueError
        If there is no wire.
    """
    max_hexagon_wires = 37  # the corners of a larger hexagon stick out of the heap
    require("number", number, "a whole number >= 1", holds=number >= 1)
    core = _find_hexagon_centre(number) if number <= max_hexagon_wires else None
    if core is None:
        places = _search_densest_heap(number, seed)
    else:
        places = _make_lattice_heap(number, core, is_hexagonal=True)
    points = places - places.mean(axis=0)
    angle = np.round(np.arctan2(points[:, 1], points[:, 0]), 9) % np.round(2.0 * np.pi, 9)
    return np.asarray(points[np.lexsort([angle, np.round(np.hypot(*points.T), 9)])])


def _find_hexagon_centre(number: int) -> Floats | None:
    """Return the centre of the hexagon of so many wires, if there is one."""
    rings = (math.isqrt(12 * number - 3) - 3) // 6
    if number == 1 + 3 * rings * (rings + 1):
        return np.asarray(_HEAP_CENTRES[0])
    return np.asarray(_HEAP_CENTRES[1]) if number == 3 * math.isqrt(number // 3) ** 2 else None


def _make_lattice_heap(number: int, core: Floats, *, is_hexagonal: bool = False) -> Floats:
    """Return the points of a triangular lattice nearest to `core`, relative to it.

    For a hexagon, distance is the largest of those along the normals of the three pairs of sides:
    then its rings are complete, whatever their number.
    """
    half_size = 2 + math.isqrt(2 * number)  # more points than a heap needs
    along, up = np.mgrid[-half_size : half_size + 1, -half_size : half_size + 1].reshape(2, -1)
    points = np.column_stack([along + 0.5 * up, np.sqrt(0.75) * up]) - core
    distance = np.hypot(*points.T)
    if is_hexagonal:
        sides = np.deg2rad([30.0, 90.0, 150.0])
        distance = np.abs(points @ np.array([np.cos(sides), np.sin(sides)])).max(axis=1)
    return np.asarray(points[np.argsort(np.round(distance, 9), kind="stable")[:number]])


def _search_densest_heap(number: int, seed: int) -> Floats:
    """Return the heap in the smallest circle, of lattices and, up to 100 wires, of drawn heaps."""
    n_heap_starts = 8  # random starts of a heap, besides those from a triangular lattice
    n_edge_points = 8  # steps along a side of the triangle of centres of lattices
    rng = np.random.default_rng(seed)
    diameters = np.ones(number)
    # centres in the triangle of `_HEAP_CENTRES`; others give the same heaps by symmetry
    share = np.linspace(0.0, 1.0, n_edge_points + 1)
    one, other = (side.ravel() for side in np.meshgrid(share, share))
    inside = one + other <= 1.0 + _WIDTH_ROUND
    edges = _HEAP_CENTRES[1:] - _HEAP_CENTRES[0]
    centres = np.column_stack([one, other])[inside] @ edges
    heaps = [_make_lattice_heap(number, centre) for centre in (*_HEAP_CENTRES, *centres)]
    if number <= _MAX_SEARCHED_WIRES:
        radius = 0.55 * math.sqrt(number) * np.sqrt(rng.uniform(size=(n_heap_starts, number)))
        angle = rng.uniform(0.0, 2.0 * np.pi, size=(n_heap_starts, number))
        starts = [_make_lattice_heap(number, core) for core in _HEAP_CENTRES]
        starts += list(np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1))
        heaps = [*heaps, find_densest_heap(starts, diameters)]
    widths = np.array([find_holding_circle(heap, diameters)[1] for heap in heaps])
    return heaps[int(np.argmax(widths < widths.min() + _WIDTH_ROUND))]  # of equal ones, the first


_CONTACT_STIFFNESSES = (10.0, 100.0)
"""Successive stiffnesses of a contact for a pull of 1; low enough for a gradient method."""


@dataclass(frozen=True, slots=True, eq=False)
class Contacts:
    """Wires near each other; arrays of shape (pairs,).

    Parameters
    ----------
    first, second : indices
    touching : distance at which they touch
    force : of the contact at zero overlap
    """

    first: Ints
    second: Ints
    touching: Floats
    force: Floats


def find_densest_heap(starts: Sequence[Floats], diameters: Floats) -> Floats:
    """Draw wires together from several starts, and harden the heap in the smallest circle.

    Of soft heaps within 1 % of the narrowest, the first is hardened. A heap of three or more wires
    that fills at most 55 % of its circle is shaken and drawn together again, up to six times.

    Parameters
    ----------
    starts : at least one, each of shape (wires, 2), m; wires may overlap
    diameters : shape (wires,), m

    Returns
    -------
    Shape (wires, 2), m: no two overlap; centroid of their areas at the origin.

    Raises
    ------
    ValueError
        If a position is not finite, a diameter is not positive, or the wires did not come
        together: they fill less than half of the smallest circle around them.
    """
    # mean diameters; unequal wires can come to rest in a row or around a corner
    shakes = (0.1, 0.3, 1.0, 1.0, 1.0, 1.0)
    max_shaken_share = 0.55  # heaps that fill less are shaken
    require_finite("starts", np.asarray(starts))
    require("diameters", diameters.tolist(), "> 0", holds=bool(np.all(diameters > 0.0)))
    if len(diameters) == 1:
        return np.zeros((1, 2))
    scale = float(np.mean(diameters))
    scaled_diameters = diameters / scale
    heap = _pick_heap([(start - start.mean(axis=0)) / scale for start in starts], scaled_diameters)
    for number, shake in enumerate(shakes if len(diameters) > 2 else ()):
        if _compute_filled_share(heap, scaled_diameters) > max_shaken_share:
            break
        moves = shake * np.random.default_rng(number).normal(size=heap.shape)
        heap = _pick_heap([heap, heap + moves], scaled_diameters)
    require_dense(heap, scaled_diameters)
    return np.asarray(scale * (heap - np.average(heap, axis=0, weights=scaled_diameters**2)))


def _pick_heap(starts: Sequence[Floats], diameters: Floats) -> Floats:
    """Harden the first soft heap within 1 % of the narrowest one of some starts."""
    width_tolerance = 1e-2  # relative, while wires are soft
    heaps = [_relax_soft(start, diameters) for start in starts]
    apart = (heap * _find_clearance(heap, diameters) for heap, _ in heaps)
    widths = np.array([find_holding_circle(heap, diameters)[1] for heap in apart])
    heap, contacts = heaps[int(np.argmax(widths <= (1.0 + width_tolerance) * widths.min()))]
    heap = _harden(heap, diameters, contacts)
    return np.asarray(heap * _find_clearance(heap, diameters))


def _compute_filled_share(centres: Floats, diameters: Floats) -> float:
    """Return the filled share of the smallest circle around all wires; 0 if not all are finite."""
    radius = find_holding_circle(centres, diameters)[1] if np.all(np.isfinite(centres)) else np.nan
    return compute_packing_fraction(diameters, 2.0 * radius) if np.isfinite(radius) else 0.0


def require_dense(centres: Floats, diameters: Floats) -> None:
    """Refuse a heap whose wires did not come together.

    Parameters
    ----------
    centres : shape (wires, 2)
    diameters : shape (wires,), in the same unit

    Raises
    ------
    ValueError
        If the wires fill less than half of the smallest circle around them; the
        message states the filled share.
    """
    # Of the smallest circle around a heap; two equal wires, the emptiest heap, fill as much.
    min_filled_share = 0.5
    filled = _compute_filled_share(centres, diameters)
    if not filled > min_filled_share * (1.0 - 1e-6):
        message = (
            f"the {len(diameters)} wires did not come together: they fill {filled:.2g} of the "
            f"smallest circle around them, expected at least {min_filled_share:g}"
        )
        raise ValueError(message)


def _list_contacts(centres: Floats, diameters: Floats, earlier: Contacts | None = None) -> Contacts:
    """List pairs that touch, or could before the next list; keep the forces of an earlier list."""
    neighbour_factor = 1.5  # distance of listed pairs, in touching distances
    max_distance = neighbour_factor * float(diameters.max())
    pairs = cKDTree(centres).query_pairs(max_distance, output_type="ndarray").astype(np.int64)
    first, second = pairs[np.lexsort(pairs.T[::-1])].T
    touching = 0.5 * (diameters[first] + diameters[second])
    is_near = np.hypot(*(centres[first] - centres[second]).T) < neighbour_factor * touching
    first, second, touching = first[is_near], second[is_near], touching[is_near]
    force = np.zeros(len(first))
    if earlier is not None:
        number = len(diameters)
        old, new = number * earlier.first + earlier.second, number * first + second
        _, at_old, at_new = np.intersect1d(old, new, assume_unique=True, return_indices=True)
        force[at_new] = earlier.force[at_old]
    return Contacts(first, second, touching, force)


def _relax_soft(begin: Floats, diameters: Floats) -> tuple[Floats, Contacts]:
    """Return centres of wires that overlap a little, and their contacts."""
    force_tolerance = 1e-3  # of the pull at a mean diameter
    max_start_spread = 1.5  # per spread of wires without gaps
    gap_diameters = 1e-3  # mean diameters that every wire is moved if some coincide
    centres = begin
    if len(np.unique(centres, axis=0)) < len(centres):  # give coincident wires a direction
        turn = np.arange(len(centres), dtype=np.float64)
        centres = centres + gap_diameters * np.column_stack([np.cos(turn), np.sin(turn)])
    spread = np.sqrt(np.sum(centres**2) / len(centres))
    spread /= 0.25 * np.sqrt(2.0 * np.sum(diameters**2))
    centres = centres / max(1.0, spread / max_start_spread)
    contacts = _list_contacts(centres, diameters)
    for stiffness in _CONTACT_STIFFNESSES:
        centres, contacts = _relax(centres, diameters, contacts, stiffness, force_tolerance)
    return centres, contacts


def _relax(
    begin: Floats, diameters: Floats, contacts: Contacts, stiffness: float, tolerance: float
) -> tuple[Floats, Contacts]:
    """Move wires until the force on each is small; return centres and contacts.

    Fast inertial relaxation (Bitzek et al., 2006, doi:10.1103/PhysRevLett.97.170201): wires move by
    the force on them and stop when they move against it. Only sums, products and roots are used,
    so that every processor takes the same path: rounding decides which of many heaps results.
    """
    list_travel = 0.17  # in least diameters, along x or y: beyond it, unlisted wires could touch
    max_steps = 20000
    steering_start = 0.1  # share of the force in the direction
    patience = 5  # downhill steps before the step grows
    centres, listed, max_travel = begin, begin, list_travel * float(diameters.min())
    longest = 1.0 / np.sqrt(6.0 * stiffness)
    step, steering, downhill, speed = longest, steering_start, 0, np.zeros_like(begin)
    for _ in range(max_steps):
        force = -compute_heap_gradient(centres, diameters, contacts, stiffness)
        if np.max(np.abs(force)) < tolerance / len(diameters):
            break
        if np.sum(force * speed) > 0.0:
            downhill += 1
            if downhill > patience:
                step, steering = min(1.1 * step, longest), 0.99 * steering
        else:
            downhill, step, steering = 0, max(0.5 * step, 0.02 * longest), steering_start
            speed = np.zeros_like(speed)
        speed = speed + step * force
        along = np.sqrt(np.sum(speed * speed) / np.sum(force * force))
        speed = (1.0 - steering) * speed + steering * along * force
        centres = centres + step * speed
        if np.max(np.abs(centres - listed)) > max_travel:
            listed, contacts = centres, _list_contacts(centres, diameters, contacts)
    return centres, _list_contacts(centres, diameters, contacts)


def _harden(begin: Floats, diameters: Floats, contacts: Contacts) -> Floats:
    """Return the nearest local minimum of the pull in which neighbours do not overlap."""
    force_tolerance = 1e-5  # of the pull at a mean diameter
    stiffness_growth = 10.0
    max_stiffness = 1e3
    hardening_limits = (4, 8, 1500)  # rounds: least, most, a number shared by the wires
    tolerance = 1e-6  # mean diameters, of wires that push each other
    centres, stiffness = begin, _CONTACT_STIFFNESSES[-1]
    lowest, highest, shared = hardening_limits
    for _ in range(max(lowest, min(highest, shared // len(diameters)))):
        force = np.maximum(contacts.force + stiffness * _find_overlaps(centres, contacts)[0], 0.0)
        is_hard = np.max(np.abs(force - contacts.force), initial=0.0) < stiffness * tolerance
        contacts = replace(contacts, force=force)
        if is_hard:
            break
        stiffness = min(stiffness_growth * stiffness, max_stiffness)
        centres, contacts = _relax(centres, diameters, contacts, stiffness, force_tolerance)
    centres = _solve_rest(centres, diameters, contacts)
    # turned as a whole back to the start: the energy does not depend on the turn
    weight, (x, y), start = diameters**2, centres.T, begin.T
    angle = np.arctan2(
        weight @ (x * start[1] - y * start[0]), weight @ (x * start[0] + y * start[1])
    )
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    return np.asarray(centres @ turn)


def _solve_rest(begin: Floats, diameters: Floats, contacts: Contacts) -> Floats:
    """Solve for the equilibrium of hard wires by Newton's method on forces and positions.

    Wires that push each other touch; pull and pushes balance. Redundant contacts (of equal wires)
    and the turn of the whole heap leave the system singular: the smallest step is taken. The
    start is returned if a step is longer than 0.01 mean diameters or than half the last one, or if
    20 steps do not suffice.
    """
    rest_tolerance = 1e-13  # mean diameters
    max_step = 1e-2  # mean diameters
    rank_tolerance = 1e-11  # of the largest singular value
    newton_steps = 20
    centres, force, pull = begin, contacts.force, np.repeat(diameters**2 / len(diameters), 2)
    step, number = np.inf, len(diameters)
    for _ in range(newton_steps):
        depth, along = _find_overlaps(centres, contacts)
        on = (force > 0.0) | (depth > rest_tolerance)
        first, second, u, f = (contacts.first[on], contacts.second[on], along[on], force[on])
        pushes, row = np.zeros((len(f), number, 2)), np.arange(len(f))
        pushes[row, first], pushes[row, second] = -u, u
        push = pushes.reshape(len(f), -1)
        across = np.eye(2) - u[:, :, None] * u[:, None, :]
        turn = -(f / (contacts.touching - depth)[on])[:, None, None] * across
        bend = np.zeros((number, number, 2, 2))
        for wire, other, sign in ((first, first, 1), (second, second, 1), (first, second, -1)):
            np.add.at(bend, (wire, other), sign * turn)
        np.add.at(bend, (second, first), -turn)
        stiff = bend.transpose(0, 2, 1, 3).reshape(2 * number, -1) + np.diag(pull)
        system = np.block([[stiff, push.T], [push, np.zeros((len(f), len(f)))]])
        unbalanced = np.concatenate([pull * centres.ravel() + push.T @ f, depth[on]])
        solution = lstsq(system, -unbalanced, cond=rank_tolerance, lapack_driver="gelsy")[0]
        last, step = step, float(np.max(np.abs(solution[: 2 * number])))
        if step > max(0.5 * last, rest_tolerance) or step > max_step:
            return begin
        centres = centres + solution[: 2 * number].reshape(-1, 2)
        force = force.copy()
        force[on] = np.maximum(f + solution[2 * number :], 0.0)
        if step < rest_tolerance:
            return np.asarray(centres)
    return begin


def compute_heap_gradient(
    centres: Floats, diameters: Floats, contacts: Contacts, stiffness: float
) -> Floats:
    """Return the energy gradient of wires that repel each other and are pulled to the origin.

    Parameters
    ----------
    centres : shape (n, 2)
    diameters : shape (n,), in the same unit
    contacts : pairs, and their forces f
    stiffness : k of a contact

    Returns
    -------
    Shape (n, 2), of (sum of diameter^2 x squared distance from the origin) / 2 n + sum over pairs
    of max(f + k overlap, 0)^2 / 2 k.
    """
    depth, along = _find_overlaps(centres, contacts)
    force = np.maximum(contacts.force + stiffness * depth, 0.0)
    gradient: Floats = diameters[:, None] ** 2 / len(centres) * centres
    for axis in range(2):
        push = force * along[:, axis]
        gradient[:, axis] += np.bincount(contacts.second, push, len(centres))
        gradient[:, axis] -= np.bincount(contacts.first, push, len(centres))
    return gradient


def _find_overlaps(centres: Floats, contacts: Contacts) -> tuple[Floats, Floats]:
    """Return the overlap of each pair (negative for a gap) and its direction, second to first."""
    offsets = centres[contacts.first] - centres[contacts.second]
    distance = np.sqrt(offsets[:, 0] ** 2 + offsets[:, 1] ** 2)
    return contacts.touching - distance, offsets / np.where(distance == 0.0, 1.0, distance)[:, None]


def _find_clearance(centres: Floats, diameters: Floats) -> float:
    """Return the factor on all distances that removes overlaps, at least 1."""
    contacts = _list_contacts(centres, diameters)
    distance = contacts.touching - _find_overlaps(centres, contacts)[0]
    return float(np.max(contacts.touching / distance, initial=1.0))


def find_holding_circle(centres: Floats, diameters: Floats) -> tuple[Floats, float]:
    """Find the smallest circle that holds all wires.

    Parameters
    ----------
    centres : shape (wires, 2), m
    diameters : shape (wires,), m

    Returns
    -------
    Its centre, shape (2,), m, and its radius, m.

    Notes
    -----
    The distance to the farthest wire is convex in the centre; it is minimised under one cone
    constraint per wire (sequential least squares).
    """
    scale = float(diameters.max()) / 2.0
    points, reach = centres / scale, diameters / 2.0 / scale

    def extent(middle: Floats) -> Floats:
        return np.asarray(np.hypot(*(points - middle).T) + reach)

    def slack(circle: Floats) -> Floats:
        return np.asarray(circle[2] - extent(circle[:2]))

    def radius_of(circle: Floats) -> tuple[float, Floats]:
        return float(circle[2]), np.array([0.0, 0.0, 1.0])

    middle = points.mean(axis=0)
    constraint: Any = {"type": "ineq", "fun": slack}
    solution = minimize(
        radius_of,
        np.append(middle, extent(middle).max()),
        jac=True,
        method="SLSQP",
        constraints=constraint,
        options={"ftol": 1e-12, "maxiter": 200},
    ).x
    return np.asarray(scale * solution[:2]), float(scale * extent(solution[:2]).max())


WANTED_FRACTION = 0.7
"""Packing fraction for which the dissertation chooses conduits."""


def compute_packing_fraction(diameters: Floats, bore: float) -> float:
    """Return the area of the wires over that of the bore.

    Parameters
    ----------
    diameters : shape (wires,), m, over the insulation
    bore : m, inner diameter of the conduit

    Raises
    ------
    ValueError
        If the bore is not finite and positive.
    """
    require_positive("bore", bore)
    return float(np.sum(diameters**2) / bore**2)


def compute_bore(diameters: Floats, fraction: float = WANTED_FRACTION) -> float:
    """Return the bore that the wires fill by a wanted share, m.

    Parameters
    ----------
    diameters : shape (wires,), m
    fraction : wanted packing fraction

    Raises
    ------
    ValueError
        If the fraction is not finite and positive.
    """
    require_positive("fraction", fraction)
    return float(np.sqrt(np.sum(diameters**2) / fraction))


def choose_bore(
    diameters: Floats, bores: Sequence[float], *, smallest: float, fraction: float = WANTED_FRACTION
) -> float:
    """Choose among conduits the one whose packing fraction is nearest to the wanted one.

    Parameters
    ----------
    diameters : shape (wires,), m
    bores : m, inner diameters of the available conduits
    smallest : m, diameter of the circle that holds the wires; narrower conduits are left out
    fraction : wanted packing fraction

    Returns
    -------
    m, one of `bores`; of two that are equally near, the wider.

    Raises
    ------
    ValueError
        If the wires fit none of them.
    """
    fitting = [bore for bore in bores if fits_bore(smallest, bore)]
    if not fitting:
        offered = ", ".join(f"{1e3 * bore:.4g}" for bore in bores)
        message = (
            f"the narrowest arrangement found needs a bore of {1e3 * smallest:.4g} mm, "
            f"and the conduits have {offered or 'none'} mm"
        )
        raise ValueError(message)
    return min(
        fitting, key=lambda bore: (abs(compute_packing_fraction(diameters, bore) - fraction), -bore)
    )


def fits_bore(smallest: float, bore: float) -> bool:
    """Return whether a circle of wires fits a bore, both m, within a tolerance of one millionth."""
    return smallest <= bore * (1.0 + 1e-6)
