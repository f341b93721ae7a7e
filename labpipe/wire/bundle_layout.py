"""Where the wires of a bundle lie: places, and which kind of wire lies on which.

One, seven, nineteen ... wires make a hexagon around one of them; three, twelve, twenty-seven ... a
hexagon with long and short sides around a core of three (figure 4.2 of the source). Any other
number is drawn together from several starts, of which the densest heap is kept.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import combinations, islice

import numpy as np

from labpipe.records.arrays import Floats, Ints
from labpipe.records.harness_bundle import STATED, Bundle, BundleLayout
from labpipe.wire.bundle_packing import drawn_together, holding_circle

N_SHUFFLES = 8
"""Shuffles of the kinds of a packed bundle, of which the densest is kept."""
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
    tried = [
        drawn_together(_by_kind(diameters.max() * places, kind), np.repeat(diameters, counts))
        for kind in _spread(bundle.arrangement, places, counts, stiffness, seed)
    ]
    each = np.repeat(diameters, counts)
    return min(tried, key=lambda centres: holding_circle(centres, each)[1])


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
            return [by_chance(counts, rng) for _ in range(N_SHUFFLES)]


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
    for each in sorted(range(len(counts)), key=lambda each: -stiffness[each]):
        kind[_topmost(sites, np.flatnonzero(kind < 0), counts[each])] = each
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


def _unevenness(kind: Ints, traits: Floats) -> float:
    member = (kind == np.arange(kind.max() + 1)[:, None]).astype(float)
    count = np.maximum(member.sum(axis=1), 1.0)
    return float(np.sum((member @ traits) ** 2 / count[:, None]))


def _neighbours(sites: Floats) -> Ints:
    """Pairs of sites that touch, or nearly, shape (pairs, 2)."""
    pairs = np.column_stack(np.triu_indices(len(sites), 1))
    distance = np.hypot(*(sites[pairs[:, 0]] - sites[pairs[:, 1]]).T)
    return np.asarray(pairs[distance < 1.2 * distance.min(initial=np.inf)])


def _merit(kind: Ints, traits: Floats, near: Ints) -> tuple[float, int]:
    alike = int(np.sum(kind[near[:, 0]] == kind[near[:, 1]]))
    return round(_unevenness(kind, traits), _DIGITS), alike


def _exchanged(kind: Ints, traits: Floats, near: Ints) -> Ints:
    """Exchange the two wires that help most, until no two do."""
    best, least = kind, _merit(kind, traits, near)
    while True:
        found = min(_exchanges(best), key=lambda each: _merit(each, traits, near), default=best)
        merit = _merit(found, traits, near)
        if merit >= least:
            return best
        best, least = found, merit


def _exchanges(kind: Ints) -> Iterator[Ints]:
    for one, other in combinations(range(len(kind)), 2):
        if kind[one] != kind[other]:
            changed = kind.copy()
            changed[[one, other]] = kind[[other, one]]
            yield changed


def _in_turn(counts: Sequence[int]) -> Ints:
    return np.repeat(np.arange(len(counts)), counts)


N_HEAP_STARTS = 8
"""Seeded starts of a heap, beside those from a lattice of triangles."""

_CORES = np.array([[0.0, 0.0], [0.5, np.sqrt(3.0) / 6.0], [0.5, 0.0]])
"""What a heap can have in its middle: a wire, three wires around a gap, two wires side by side."""
_ALIKE = 1e-9


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
    core = _core_of_hexagon(number)
    found = _nearest(number, core) if core is not None else _densest(number, seed)
    return _in_order(found - found.mean(axis=0))


def _core_of_hexagon(number: int) -> Floats | None:
    """Middle of the hexagon that so many wires make, if they make one."""
    rings = (math.isqrt(12 * number - 3) - 3) // 6
    if number == 1 + 3 * rings * (rings + 1):
        return np.asarray(_CORES[0])
    return np.asarray(_CORES[1]) if number == 3 * math.isqrt(number // 3) ** 2 else None


def _nearest(number: int, core: Floats) -> Floats:
    """Points of a lattice of triangles nearest to its middle by hexagonal distance, then by circle.

    Hexagonal distance is the largest of the heights above the three pairs of opposite sides: by it
    the rings of a hexagon are complete, whatever their number.
    """
    reach = 2 + math.isqrt(number)
    along, up = np.mgrid[-reach : reach + 1, -reach : reach + 1].reshape(2, -1)
    points = np.column_stack([along + 0.5 * up, np.sqrt(0.75) * up]) - core
    sides = np.deg2rad([30.0, 90.0, 150.0])
    height = np.abs(points @ np.array([np.cos(sides), np.sin(sides)])).max(axis=1)
    round_ = np.hypot(*points.T)
    chosen = np.lexsort([np.round(round_, 9), np.round(height, 9)])[:number]
    return np.asarray(points[chosen])


def _densest(number: int, seed: int) -> Floats:
    """The heap in the smallest circle, of those drawn together from lattices and from chance."""
    rng = np.random.default_rng(seed)
    spread = 0.7 * math.sqrt(number)
    starts = [_nearest(number, core) for core in _CORES]
    starts += [rng.normal(scale=spread, size=(number, 2)) for _ in range(N_HEAP_STARTS)]
    best, least = starts[0], np.inf
    diameters = np.ones(number)
    for start in starts:
        found = drawn_together(start, diameters)
        radius = holding_circle(found, diameters)[1]
        if radius < least - _ALIKE:  # of equal ones, the first
            best, least = found, radius
    return best


def _in_order(points: Floats) -> Floats:
    angle = np.round(np.arctan2(points[:, 1], points[:, 0]), 9) % np.round(2.0 * np.pi, 9)
    return np.asarray(points[np.lexsort([angle, np.round(np.hypot(*points.T), 9)])])
