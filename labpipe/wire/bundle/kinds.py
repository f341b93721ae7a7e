"""Which kind of wire lies on which site of a bundle: spread evenly, one side, or by chance."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations, islice

import numpy as np

from labpipe.records.arrays import Floats, Ints

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
