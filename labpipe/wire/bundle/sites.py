"""Places for the equal wires of a bundle, in wire diameters: hexagons, and other dense heaps.

One, seven, nineteen ... wires make a hexagon around one of them; three, twelve, twenty-seven ... a
hexagon with long and short sides around a core of three (figure 4.2 of the source). Any other
number is drawn together from several starts, of which the densest heap is kept.
"""

from __future__ import annotations

import math

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.wire.bundle.tightening import drawn_together, holding_circle

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
