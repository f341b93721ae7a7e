"""Layout of the wires of a bundle: their positions, and the kind of wire on each.

One, seven, nineteen ... wires make a hexagon around one of them; three, twelve, twenty-seven ... a
hexagon with long and short sides around a core of three (figure 4.2 of the dissertation). Any other
number is drawn together from several starts, and the densest heap is kept.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations, islice

import numpy as np

from labpipe.mechanics.law.plays import require
from labpipe.mechanics.wire.bundle_packing import find_densest_heap, find_holding_circle
from labpipe.records.arrays import Floats, Ints
from labpipe.records.harness_bundle import STATED, Bundle, BundleLayout

_MAX_SEARCHED_WIRES = 100
"""Most wires for which many starts are tried; larger heaps are densest as lattices."""


def arrange_wires(
    bundle: Bundle, diameters: Sequence[float], stiffness: Sequence[float], *, seed: int = 0
) -> BundleLayout:
    """Lay out the wires of a bundle.

    Parameters
    ----------
    bundle : stated positions override its arrangement
    diameters : m, over the insulation, of each kind of wire
    stiffness : N, axial stiffness of each kind; decides which lies on top of an asymmetric bundle
    seed : of the random choices; same seed, same layout

    Returns
    -------
    Wires in the order of `bundle.wires`, about the centroid of their areas.

    Raises
    ------
    ValueError
        If stated positions are not one for each wire, or wires at them overlap by more than 1 % of
        the smaller diameter.

    Notes
    -----
    The kinds are spread over sites of equal wires, see `place_sites`. Wires of unequal
    diameters are then drawn together from there until they touch, see `wire.bundle_packing`.
    """
    wire_type = np.repeat(np.arange(len(bundle.wires)), [wire.number for wire in bundle.wires])
    diameter = np.asarray(diameters, dtype=np.float64)[wire_type]
    if bundle.positions:
        centres = _stated_centres(bundle, diameter)
        return _layout(STATED, centres, wire_type, diameter)
    centres = _lay_out(bundle, np.asarray(diameters, dtype=np.float64), stiffness, seed)
    return _layout(bundle.arrangement, centres, wire_type, diameter)


def _stated_centres(bundle: Bundle, diameter: Floats) -> Floats:
    # Tolerated overlap of stated positions, of the smaller wire's diameter, as in the test sheet.
    max_stated_overlap = 0.01
    centres = np.asarray(bundle.positions, dtype=np.float64)
    if len(centres) != len(diameter):
        message = f"{len(centres)} positions for {len(diameter)} wires: expected one for each"
        raise ValueError(message)
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


def _lay_out(bundle: Bundle, diameters: Floats, stiffness: Sequence[float], seed: int) -> Floats:
    """Return the centres of the wires, kind by kind, m."""
    equal_diameter_share = 1e-9
    places = place_sites(bundle.number, seed=seed)
    counts = [wire.number for wire in bundle.wires]
    if len(counts) == 1 or np.ptp(diameters) <= equal_diameter_share * diameters.max():
        wire_type = _kinds_on_sites(bundle.arrangement, places, counts, stiffness, seed)[0]
        return _by_kind(diameters.max() * places, wire_type)
    wire_diameters = np.repeat(diameters, counts)
    kinds = _kinds_on_sites(bundle.arrangement, places, counts, stiffness, seed)
    starts = [
        _by_kind(width * places, wire_type)
        for wire_type in kinds
        for width in _start_pitches(wire_diameters, kinds)
    ]
    return find_densest_heap(starts, wire_diameters)


def _kinds_on_sites(
    arrangement: str, places: Floats, counts: Sequence[int], stiffness: Sequence[float], seed: int
) -> list[Ints]:
    """Return the kinds on the sites: one assignment for an arrangement, several random ones."""
    n_shuffles = 8  # shuffles of the kinds of a packed bundle, of which the densest is kept
    match arrangement:
        case "asymmetric":
            return [stack_kinds(places, counts, stiffness)]
        case "symmetric":
            return [spread_evenly(places, counts, seed=seed)]
        case _:
            rng = np.random.default_rng(seed)
            shuffles = n_shuffles if len(places) <= _MAX_SEARCHED_WIRES else n_shuffles // 2
            return [shuffle_kinds(counts, rng) for _ in range(shuffles)]


def _start_pitches(wire_diameters: Floats, kinds: Sequence[Ints]) -> list[float]:
    """Return the distances of the sites from which wires are drawn together, m."""
    pitch_shares = (0.6, 0.8, 1.0)  # initial distances of the sites, per pitch of equal wires
    equal_pitch = float(np.sqrt(np.mean(wire_diameters**2)))  # for equal wires of the same area
    if len(kinds) > 1:
        return [equal_pitch]
    shares = pitch_shares if len(wire_diameters) <= _MAX_SEARCHED_WIRES else pitch_shares[1:]
    return [float(wire_diameters.max()), *(share * equal_pitch for share in shares)]


def _by_kind(centres: Floats, wire_types: Ints) -> Floats:
    return np.asarray(centres[np.argsort(wire_types, kind="stable")])


def _layout(name: str, centres: Floats, wire_types: Ints, diameter: Floats) -> BundleLayout:
    about = centres - np.average(centres, axis=0, weights=diameter**2)
    radius = float(np.max(np.hypot(*about.T) + diameter / 2.0))
    return BundleLayout(name, about[:, 0], about[:, 1], wire_types, diameter, radius)


_MERIT_DIGITS = 9


def shuffle_kinds(counts: Sequence[int], rng: np.random.Generator) -> Ints:
    """Shuffle the kinds of wires.

    Parameters
    ----------
    counts : wires of each kind
    rng : of the shuffle

    Returns
    -------
    Shape (wires,), the kind of the wire on each site.
    """
    return rng.permutation(np.repeat(np.arange(len(counts)), counts)).astype(np.int64)


def stack_kinds(sites: Floats, counts: Sequence[int], stiffness: Sequence[float]) -> Ints:
    """Lay the kinds one above the other, the stiffest on top.

    Parameters
    ----------
    sites : shape (wires, 2), wire diameters; y is the direction of bending, upwards
    counts : wires of each kind
    stiffness : axial stiffness of each kind, in any unit; of equally stiff kinds the first lies
        higher

    Returns
    -------
    Shape (wires,), the kind of the wire on each site. Of a row that two kinds share, the upper one
    has the sites that are best balanced about x = 0, of those the ones nearest to it.
    """
    wire_types = np.full(len(sites), -1, dtype=np.int64)
    for key in sorted(range(len(counts)), key=lambda index: -stiffness[index]):
        wire_types[_topmost(sites, np.flatnonzero(wire_types < 0), counts[key])] = key
    return wire_types


def _topmost(sites: Floats, free: Ints, count: int) -> Ints:
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
    """Spread every kind evenly over the bundle.

    Parameters
    ----------
    sites : shape (wires, 2), wire diameters
    counts : wires of each kind
    seed : of the starts; same seed, same spread

    Returns
    -------
    Shape (wires,), the kind of the wire on each site: the best that exchanges of two wires find
    from several starts.

    Notes
    -----
    The unevenness is minimal: the sum over kinds and traits of (sum of the trait over the wires of
    the kind)^2 / wires, where the traits x, y, x^2 - y^2, 2 x y, x^2 + y^2 are centred over
    all wires and normalised. Among equal ones, neighbours of one kind are fewest. A bundle in
    which each kind has the centroid and the second moments of the whole is as stiff, in every
    direction, as one of wires of the mean axial stiffness, whatever the stiffnesses of the kinds:
    if the sites have no preferred direction, the bundle has none either.
    """
    n_spread_starts = 12  # seeded starts of the search for an even spread
    traits, neighbours = _traits(sites), _neighbours(sites)
    rng = np.random.default_rng(seed)
    starts = (shuffle_kinds(counts, rng) for _ in range(n_spread_starts))
    spreads = [_exchange_wires(start, traits, neighbours) for start in starts]
    return min(spreads, key=lambda wire_types: _unevenness(wire_types, traits, neighbours))


def _traits(sites: Floats) -> Floats:
    x, y = (sites - sites.mean(axis=0)).T
    traits = np.column_stack([x, y, x**2 - y**2, 2.0 * x * y, x**2 + y**2])
    size = max(float(np.mean(x**2 + y**2)), np.finfo(float).tiny)
    return np.asarray((traits - traits.mean(axis=0)) / np.array([size**0.5] * 2 + [size] * 3))


def _neighbours(sites: Floats) -> Floats:
    """Return 1 for sites that nearly touch, else 0, shape (sites, sites)."""
    distance = np.hypot(*(sites[:, None] - sites).transpose(2, 0, 1))
    np.fill_diagonal(distance, np.inf)
    return np.asarray(distance < 1.2 * distance.min(initial=np.inf), dtype=np.float64)


def _unevenness(wire_types: Ints, traits: Floats, near: Floats) -> tuple[float, int]:
    """Return the unevenness and the number of neighbours of one kind."""
    member = (wire_types[:, None] == np.arange(wire_types.max() + 1)).astype(np.float64)
    count = np.maximum(member.sum(axis=0), 1.0)
    unevenness = float(np.sum((member.T @ traits) ** 2 / count[:, None]))
    return round(unevenness, _MERIT_DIGITS), round(0.5 * float(np.sum(member * (near @ member))))


def _exchange_wires(wire_types: Ints, traits: Floats, near: Floats) -> Ints:
    """Exchange the best pair of wires until no exchange helps."""
    best, least = wire_types, _unevenness(wire_types, traits, near)
    while True:
        first, second = _find_exchange(best, traits, near)
        exchanged = best.copy()
        exchanged[[first, second]] = best[[second, first]]
        merit = _unevenness(exchanged, traits, near)
        if merit >= least:
            return best
        best, least = exchanged, merit


def _find_exchange(wire_types: Ints, traits: Floats, near: Floats) -> tuple[int, int]:
    """Return the two wires whose exchange is best: least unevenness, then fewest equal neighbours.

    With S_k the sum of the traits t over n_k wires of kind k, and d = t_j - t_i: S_a grows by d and
    S_b falls by it, where a and b are the kinds of i and j.
    """
    member = (wire_types[:, None] == np.arange(wire_types.max() + 1)).astype(np.float64)
    count = np.maximum(member.sum(axis=0), 1.0)
    pull = traits @ ((member.T @ traits) / count[:, None]).T  # t_i . S_k / n_k
    pulls, among = pull[np.arange(len(wire_types)), wire_types], pull[:, wire_types]
    size = np.sum(traits**2, axis=1)
    distances = size[:, None] + size - 2.0 * traits @ traits.T
    share = 1.0 / count[wire_types]
    change = (share[:, None] + share) * distances + 2.0 * (among + among.T - pulls[:, None] - pulls)
    neighbours = (near @ member)[:, wire_types]
    own_beside = np.diag(neighbours)
    alike = neighbours + neighbours.T - own_beside[:, None] - own_beside - 2.0 * near
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
    seed : of the starts where the number makes no hexagon; same seed, same positions

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
    core = _hexagon_centre(number) if number <= max_hexagon_wires else None
    places = _hexagonal_heap(number, core) if core is not None else _densest_heap(number, seed)
    points = places - places.mean(axis=0)
    angle = np.round(np.arctan2(points[:, 1], points[:, 0]), 9) % np.round(2.0 * np.pi, 9)
    return np.asarray(points[np.lexsort([angle, np.round(np.hypot(*points.T), 9)])])


def _hexagon_centre(number: int) -> Floats | None:
    """Return the centre of the hexagon of so many wires, if there is one."""
    rings = (math.isqrt(12 * number - 3) - 3) // 6
    if number == 1 + 3 * rings * (rings + 1):
        return np.asarray(_HEAP_CENTRES[0])
    return np.asarray(_HEAP_CENTRES[1]) if number == 3 * math.isqrt(number // 3) ** 2 else None


def _hexagonal_heap(number: int, core: Floats) -> Floats:
    """Return the points of a triangular lattice nearest to its middle by hexagonal distance.

    That is the largest of the heights above the three pairs of opposite sides: by it the rings of a
    hexagon are complete, whatever their number.
    """
    points = _lattice(number) - core
    sides = np.deg2rad([30.0, 90.0, 150.0])
    height = np.abs(points @ np.array([np.cos(sides), np.sin(sides)])).max(axis=1)
    return np.asarray(points[np.argsort(np.round(height, 9), kind="stable")[:number]])


def _lattice(number: int) -> Floats:
    """Return points of a triangular lattice about one of them, more than a heap needs."""
    half_size = 2 + math.isqrt(2 * number)
    along, up = np.mgrid[-half_size : half_size + 1, -half_size : half_size + 1].reshape(2, -1)
    return np.column_stack([along + 0.5 * up, np.sqrt(0.75) * up])


def _lattice_heap(number: int, core: Floats) -> Floats:
    """Return the points of a triangular lattice nearest to its middle."""
    points = _lattice(number) - core
    return np.asarray(points[np.argsort(np.round(np.hypot(*points.T), 9), kind="stable")[:number]])


def _densest_heap(number: int, seed: int) -> Floats:
    """Return the heap in the smallest circle, from lattices and from random starts."""
    n_heap_starts = 8  # random starts of a heap, besides those from a triangular lattice
    rng = np.random.default_rng(seed)
    diameters = np.ones(number)
    heaps = [_lattice_heap(number, middle) for middle in _lattice_centres()]
    if number <= _MAX_SEARCHED_WIRES:
        radius = 0.55 * math.sqrt(number) * np.sqrt(rng.uniform(size=(n_heap_starts, number)))
        angle = rng.uniform(0.0, 2.0 * np.pi, size=(n_heap_starts, number))
        starts = [_lattice_heap(number, core) for core in _HEAP_CENTRES]
        starts += list(np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1))
        heaps = [*heaps, find_densest_heap(starts, diameters)]
    widths = np.array([find_holding_circle(heap, diameters)[1] for heap in heaps])
    return heaps[int(np.argmax(widths < widths.min() + _WIDTH_ROUND))]  # of equal ones, the first


def _lattice_centres() -> Floats:
    """Return centres in the triangle of `_HEAP_CENTRES`; others give the same heaps by symmetry."""
    n_edge_points = 8
    share = np.linspace(0.0, 1.0, n_edge_points + 1)
    one, other = np.meshgrid(share, share)
    inside = one + other <= 1.0 + _WIDTH_ROUND
    edges = _HEAP_CENTRES[1:] - _HEAP_CENTRES[0]
    points = np.column_stack([one[inside], other[inside]]) @ edges
    return np.concatenate([_HEAP_CENTRES, np.asarray(points)])
