"""Where the wires of a bundle lie: places, and which kind of wire lies on which.

One, seven, nineteen ... wires make a hexagon around one of them; three, twelve, twenty-seven ... a
hexagon with long and short sides around a core of three (figure 4.2 of the source). Any other
number is drawn together from several starts, of which the densest heap is kept.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations, islice

import numpy as np

from labpipe.records.arrays import Floats, Ints
from labpipe.records.harness_bundle import STATED, Bundle, BundleLayout
from labpipe.wire.bundle_packing import densest_heap, holding_circle

N_SHUFFLES = 8
"""Shuffles of the kinds of a packed bundle, of which the densest is kept."""
_MOST_SOUGHT = 100
"""Wires of which many starts are tried: in a larger heap chance evens out, and lattices of equal
wires are the densest."""
_PITCHES = (0.6, 0.8, 1.0)
"""Starts of an arrangement that leaves nothing to chance, see `_widths`."""
OVERLAP = 0.01
"""Overlap of stated positions that is let pass, as a share of the smaller wire's diameter:
the test sheet lets as much pass."""

_EQUAL = 1e-9


def arrange(
    bundle: Bundle, diameters: Sequence[float], stiffness: Sequence[float], *, seed: int = 0
) -> BundleLayout:
    """Lay out the wires of a bundle.

    Parameters
    ----------
    bundle : its positions, if it states any, go before its arrangement
    diameters : m, over the insulation, of each kind of wire
    stiffness : N, axial stiffness of each kind; says which lies on top of an asymmetric bundle
    seed : of what is left to chance; same seed, same layout

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
    The kinds are spread over sites of equal wires, see `sites`. Wires of unequal
    diameters are then drawn together from there until they touch, see `wire.bundle_packing`.
    """
    kind = np.repeat(np.arange(len(bundle.wires)), [wire.number for wire in bundle.wires])
    diameter = np.asarray(diameters, dtype=np.float64)[kind]
    if bundle.positions:
        centres = _stated(bundle, diameter)
        return _layout(STATED, centres, kind, diameter)
    centres = _arranged(bundle, np.asarray(diameters, dtype=np.float64), stiffness, seed)
    return _layout(bundle.arrangement, centres, kind, diameter)


def _stated(bundle: Bundle, diameter: Floats) -> Floats:
    centres = np.asarray(bundle.positions, dtype=np.float64)
    if len(centres) != len(diameter):
        message = f"{len(centres)} positions for {len(diameter)} wires: allowed is one for each"
        raise ValueError(message)
    first, second = np.triu_indices(len(diameter), 1)
    distance = np.hypot(*(centres[first] - centres[second]).T)
    depth = 0.5 * (diameter[first] + diameter[second]) - distance
    allowed = OVERLAP * np.minimum(diameter[first], diameter[second])
    if np.any(depth > allowed):
        at = int(np.argmax(depth - allowed))
        message = (
            f"wires {first[at] + 1} and {second[at] + 1} overlap by {1e3 * depth[at]:.3g} mm, "
            f"allowed is {1e3 * allowed[at]:.2g} mm"
        )
        raise ValueError(message)
    return centres


def _arranged(bundle: Bundle, diameters: Floats, stiffness: Sequence[float], seed: int) -> Floats:
    """Centres of the wires, kind by kind, m."""
    places = sites(bundle.number, seed=seed)
    counts = [wire.number for wire in bundle.wires]
    if len(counts) == 1 or np.ptp(diameters) <= _EQUAL * diameters.max():
        kind = _spread(bundle.arrangement, places, counts, stiffness, seed)[0]
        return _by_kind(diameters.max() * places, kind)
    each = np.repeat(diameters, counts)
    kinds = _spread(bundle.arrangement, places, counts, stiffness, seed)
    starts = [_by_kind(width * places, kind) for kind in kinds for width in _widths(each, kinds)]
    return densest_heap(starts, each)


def _spread(
    arrangement: str, places: Floats, counts: Sequence[int], stiffness: Sequence[float], seed: int
) -> list[Ints]:
    """Kinds of the wires on the sites: one way of an arrangement, some of chance."""
    match arrangement:
        case "asymmetric":
            return [on_one_side(places, counts, stiffness)]
        case "symmetric":
            return [evenly(places, counts, seed=seed)]
        case _:
            rng = np.random.default_rng(seed)
            shuffles = N_SHUFFLES if len(places) <= _MOST_SOUGHT else N_SHUFFLES // 2
            return [by_chance(counts, rng) for _ in range(shuffles)]


def _widths(each: Floats, kinds: Sequence[Ints]) -> list[float]:
    """Distances of the sites from which wires are drawn together, m."""
    alike = float(np.sqrt(np.mean(each**2)))  # at which equal wires would have as much area
    if len(kinds) > 1:
        return [alike]
    shares = _PITCHES if len(each) <= _MOST_SOUGHT else _PITCHES[1:]
    return [float(each.max()), *(share * alike for share in shares)]


def _by_kind(centres: Floats, kind: Ints) -> Floats:
    return np.asarray(centres[np.argsort(kind, kind="stable")])


def _layout(name: str, centres: Floats, kind: Ints, diameter: Floats) -> BundleLayout:
    about = centres - np.average(centres, axis=0, weights=diameter**2)
    radius = float(np.max(np.hypot(*about.T) + diameter / 2.0))
    return BundleLayout(name, about[:, 0], about[:, 1], kind, diameter, radius)


N_CHANCES = 12
"""Seeded starts of the search for an even spread."""

_ROW = 1e-6
"""Of a wire's diameter: sites nearer in height than this lie in one row."""
_MOST_CHOICES = 5000
"""Of sites in one row, that are compared."""
_DIGITS = 9


def by_chance(counts: Sequence[int], rng: np.random.Generator) -> Ints:
    """Shuffle the kinds.

    Parameters
    ----------
    counts : wires of each kind
    rng : of the shuffle

    Returns
    -------
    Shape (wires,), the kind of the wire on each site.
    """
    return rng.permutation(_in_turn(counts)).astype(np.int64)


def on_one_side(sites: Floats, counts: Sequence[int], stiffness: Sequence[float]) -> Ints:
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
    kind = np.full(len(sites), -1, dtype=np.int64)
    for key in sorted(range(len(counts)), key=lambda index: -stiffness[index]):
        kind[_topmost(sites, np.flatnonzero(kind < 0), counts[key])] = key
    return kind


def _topmost(sites: Floats, free: Ints, count: int) -> Ints:
    """The highest of some free sites, balanced about x = 0 within the lowest row taken."""
    if not count:
        return free[:0]
    height = sites[free, 1]
    edge = np.sort(height)[-count]
    above, row = free[height > edge + _ROW], free[np.abs(height - edge) <= _ROW]

    def unbalance(chosen: tuple[int, ...]) -> tuple[float, float]:
        across = sites[list(chosen), 0]
        return round(float(abs(across.sum())), _DIGITS), float(np.abs(across).sum())

    choices = islice(combinations(row.tolist(), count - len(above)), _MOST_CHOICES)
    return np.concatenate([above, np.array(min(choices, key=unbalance), dtype=np.int64)])


def evenly(sites: Floats, counts: Sequence[int], *, seed: int = 0) -> Ints:
    """Spread every kind as the whole bundle is spread.

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
    Least is the unevenness: the sum over kinds and traits of (sum of the trait over the wires of
    the kind)^2 / wires, where the traits x, y, x^2 - y^2, 2 x y, x^2 + y^2 are without their mean
    over all wires, and of a size of one. Of equal ones, the fewest neighbours of one kind. A bundle
    in which each kind has the centroid and the second moments of the whole is as stiff, in every
    direction, as one of wires of the mean axial stiffness, whatever the stiffnesses of the kinds:
    if the sites have no preferred direction, nor has the bundle.
    """
    traits, near = _traits(sites), _neighbours(sites)
    rng = np.random.default_rng(seed)
    starts = (by_chance(counts, rng) for _ in range(N_CHANCES))
    found = [_exchanged(start, traits, near) for start in starts]
    return min(found, key=lambda kind: _merit(kind, traits, near))


def _traits(sites: Floats) -> Floats:
    x, y = (sites - sites.mean(axis=0)).T
    traits = np.column_stack([x, y, x**2 - y**2, 2.0 * x * y, x**2 + y**2])
    size = max(float(np.mean(x**2 + y**2)), np.finfo(float).tiny)
    return np.asarray((traits - traits.mean(axis=0)) / np.array([size**0.5] * 2 + [size] * 3))


def _neighbours(sites: Floats) -> Floats:
    """Whether two sites touch, or nearly: 1 or 0, shape (sites, sites)."""
    distance = np.hypot(*(sites[:, None] - sites).transpose(2, 0, 1))
    np.fill_diagonal(distance, np.inf)
    return np.asarray(distance < 1.2 * distance.min(initial=np.inf), dtype=np.float64)


def _merit(kind: Ints, traits: Floats, near: Floats) -> tuple[float, int]:
    """Unevenness, and neighbours of one kind."""
    member = (kind[:, None] == np.arange(kind.max() + 1)).astype(np.float64)
    count = np.maximum(member.sum(axis=0), 1.0)
    unevenness = float(np.sum((member.T @ traits) ** 2 / count[:, None]))
    return round(unevenness, _DIGITS), round(0.5 * float(np.sum(member * (near @ member))))


def _exchanged(kind: Ints, traits: Floats, near: Floats) -> Ints:
    """Exchange the two wires that help most, until no two do."""
    best, least = kind, _merit(kind, traits, near)
    while True:
        one, other = _best_exchange(best, traits, near)
        found = best.copy()
        found[[one, other]] = best[[other, one]]
        merit = _merit(found, traits, near)
        if merit >= least:
            return best
        best, least = found, merit


def _best_exchange(kind: Ints, traits: Floats, near: Floats) -> tuple[int, int]:
    """Two wires whose exchange leaves the least unevenness, then the fewest neighbours alike.

    With S_k the sum of the traits t over n_k wires of kind k, and d = t_j - t_i: S_a grows by d and
    S_b falls by it, where a and b are the kinds of i and j.
    """
    member = (kind[:, None] == np.arange(kind.max() + 1)).astype(np.float64)
    count = np.maximum(member.sum(axis=0), 1.0)
    pull = traits @ ((member.T @ traits) / count[:, None]).T  # t_i . S_k / n_k
    own, among = pull[np.arange(len(kind)), kind], pull[:, kind]
    size = np.sum(traits**2, axis=1)
    apart = size[:, None] + size - 2.0 * traits @ traits.T
    share = 1.0 / count[kind]
    change = (share[:, None] + share) * apart + 2.0 * (among + among.T - own[:, None] - own)
    beside = (near @ member)[:, kind]
    own_beside = np.diag(beside)
    alike = beside + beside.T - own_beside[:, None] - own_beside - 2.0 * near
    change = np.where(kind[:, None] == kind, np.inf, np.round(change, _DIGITS))
    change[np.tri(len(kind), dtype=bool)] = np.inf  # each pair once
    candidates = np.argwhere(change == change.min())
    first = candidates[np.argmin(alike[candidates[:, 0], candidates[:, 1]])]
    return int(first[0]), int(first[1])


def _in_turn(counts: Sequence[int]) -> Ints:
    return np.repeat(np.arange(len(counts)), counts)


N_HEAP_STARTS = 8
"""Seeded starts of a heap, beside those from a lattice of triangles."""
_MOST_IN_HEXAGON = 37
"""Wires that are laid as a hexagon because they fill one. The corners of a larger one stick out of
a heap, which then is the narrower."""

_CORES = np.array([[0.0, 0.0], [0.5, np.sqrt(3.0) / 6.0], [0.5, 0.0]])
"""What a heap can have in its middle: a wire, three wires around a gap, two wires side by side."""
_ALIKE = 1e-9
_N_MIDDLES = 8
"""Along the edge of the triangle of places in which the middle of a lattice is sought."""


def sites(number: int, *, seed: int = 0) -> Floats:
    """Find places for some equal wires that touch.

    Parameters
    ----------
    number : of wires, at least 1
    seed : of the starts where the number makes no hexagon; same seed, same places

    Returns
    -------
    Shape (number, 2), wire diameters, from the middle outwards, with their centroid at the origin.
    Places at one distance stand in the order of their angle from the x axis. Rows of a hexagon lie
    along x.

    Raises
    ------
    ValueError
        If there is no wire.
    """
    if number < 1:
        message = f"number={number!r}: allowed are whole numbers >= 1"
        raise ValueError(message)
    core = _core_of_hexagon(number) if number <= _MOST_IN_HEXAGON else None
    found = _hexagon(number, core) if core is not None else _densest(number, seed)
    return _in_order(found - found.mean(axis=0))


def _core_of_hexagon(number: int) -> Floats | None:
    """Middle of the hexagon that so many wires make, if they make one."""
    rings = (math.isqrt(12 * number - 3) - 3) // 6
    if number == 1 + 3 * rings * (rings + 1):
        return np.asarray(_CORES[0])
    return np.asarray(_CORES[1]) if number == 3 * math.isqrt(number // 3) ** 2 else None


def _hexagon(number: int, core: Floats) -> Floats:
    """Points of a lattice of triangles nearest to its middle by hexagonal distance.

    That is the largest of the heights above the three pairs of opposite sides: by it the rings of a
    hexagon are complete, whatever their number.
    """
    points = _lattice(number) - core
    sides = np.deg2rad([30.0, 90.0, 150.0])
    height = np.abs(points @ np.array([np.cos(sides), np.sin(sides)])).max(axis=1)
    return np.asarray(points[np.argsort(np.round(height, 9), kind="stable")[:number]])


def _lattice(number: int) -> Floats:
    """Points of a lattice of triangles about a point of it, more than a heap needs."""
    reach = 2 + math.isqrt(2 * number)
    along, up = np.mgrid[-reach : reach + 1, -reach : reach + 1].reshape(2, -1)
    return np.column_stack([along + 0.5 * up, np.sqrt(0.75) * up])


def _nearest(number: int, core: Floats) -> Floats:
    """Points of a lattice of triangles nearest to its middle."""
    points = _lattice(number) - core
    return np.asarray(points[np.argsort(np.round(np.hypot(*points.T), 9), kind="stable")[:number]])


def _densest(number: int, seed: int) -> Floats:
    """The heap in the smallest circle, of lattices and of those drawn together from starts."""
    rng = np.random.default_rng(seed)
    diameters = np.ones(number)
    found = [_nearest(number, middle) for middle in _middles()]
    if number <= _MOST_SOUGHT:
        radius = 0.55 * math.sqrt(number) * np.sqrt(rng.uniform(size=(N_HEAP_STARTS, number)))
        angle = rng.uniform(0.0, 2.0 * np.pi, size=(N_HEAP_STARTS, number))
        starts = [_nearest(number, core) for core in _CORES]
        starts += list(np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1))
        found = [*found, densest_heap(starts, diameters)]
    widths = np.array([holding_circle(finding, diameters)[1] for finding in found])
    return found[int(np.argmax(widths < widths.min() + _ALIKE))]  # of equal ones, the first


def _middles() -> Floats:
    """Points of the triangle between the cores: every other middle makes one of these heaps."""
    share = np.linspace(0.0, 1.0, _N_MIDDLES + 1)
    one, other = np.meshgrid(share, share)
    inside = one + other <= 1.0 + _ALIKE
    edges = _CORES[1:] - _CORES[0]
    points = np.column_stack([one[inside], other[inside]]) @ edges
    return np.concatenate([_CORES, np.asarray(points)])


def _in_order(points: Floats) -> Floats:
    angle = np.round(np.arctan2(points[:, 1], points[:, 0]), 9) % np.round(2.0 * np.pi, 9)
    return np.asarray(points[np.lexsort([angle, np.round(np.hypot(*points.T), 9)])])
