"""Half a round bar of twenty-node bricks, cut along its plane of bending.

x runs along the bar, y in the plane of bending. Across it a rectangle of two bricks lies around the
axis, and a ring of four between it and the circle; the outer nodes, those at mid-sides included,
are on the circle. Numbering of a brick: four corners, the four above them, mid-sides below, above
and between (CalculiX CrunchiX User's Manual, "Twenty-node brick element").
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labpipe.records.arrays import Flags, Floats, Ints

_INNER = 0.55  # half-width of the rectangle, as a share of the radius
_AROUND = np.array([(0, 0), (2, 0), (2, 2), (0, 2), (1, 0), (2, 1), (1, 2), (0, 1)])
_TURNED = [0, 3, 2, 1, 7, 6, 5, 4]  # the same cell, turning the other way
_SMALL = 1e-6  # of the radius: nodes as near as that to a plane are in it


@dataclass(frozen=True, slots=True, eq=False)
class BarMesh:
    """Nodes and bricks of half a bar; the half with z >= 0.

    Parameters
    ----------
    nodes : shape (nodes, 3), m; the first has the number 1
    bricks : shape (bricks, 20), numbers of nodes
    length, radius : m
    """

    nodes: Floats
    bricks: Ints
    length: float
    radius: float

    @property
    def clamp(self) -> Flags:
        """Nodes of the clamped face, x = 0."""
        return self.nodes[:, 0] < _SMALL * self.radius

    @property
    def middle(self) -> Flags:
        """Nodes half-way up, y = 0: those that bending does not strain."""
        return np.abs(self.nodes[:, 1]) < _SMALL * self.radius

    @property
    def tip(self) -> Flags:
        """Nodes of the free face, x = length."""
        return self.nodes[:, 0] > self.length - _SMALL * self.radius

    @property
    def cut(self) -> Flags:
        """Nodes of the plane that cuts the bar in halves, z = 0."""
        return self.nodes[:, 2] < _SMALL * self.radius


def half_bar(radius: float, length: float, *, n_along: int) -> BarMesh:
    """Mesh half a round bar.

    Parameters
    ----------
    radius, length : m
    n_along : bricks along the bar

    Raises
    ------
    ValueError
        If there is not one brick.
    """
    if n_along < 1:
        message = f"n_along={n_along}: allowed are whole numbers >= 1"
        raise ValueError(message)
    points, quads = _half_disc()
    corners = np.unique(quads[:, :4])
    stations = [np.arange(len(points)) if i % 2 == 0 else corners for i in range(2 * n_along + 1)]
    first = np.cumsum([1, *map(len, stations)])
    numbers = np.zeros((len(stations), len(points)), dtype=np.int64)
    for i, members in enumerate(stations):
        numbers[i, members] = first[i] + np.arange(len(members))
    along = np.linspace(0.0, length, len(stations))
    nodes = [
        np.column_stack([np.full(len(members), x), radius * points[members]])
        for x, members in zip(along, stations, strict=True)
    ]
    bricks = [_bricks(numbers[2 * i : 2 * i + 3], quads) for i in range(n_along)]
    return BarMesh(np.concatenate(nodes), np.concatenate(bricks), length, radius)


def _bricks(numbers: Ints, quads: Ints) -> Ints:
    """One layer of bricks on the quadrangles, from the nodes of its three stations."""
    below, between, above = (number[quads] for number in numbers)
    corners, sides = slice(0, 4), slice(4, 8)
    parts = (below[:, corners], above[:, corners], below[:, sides], above[:, sides])
    return np.concatenate([*parts, between[:, corners]], axis=1)


def _half_disc() -> tuple[Floats, Ints]:
    """Nodes (y, z) of a unit half-disc, and its eight-node quadrangles, turning from y to z."""
    y, z = np.meshgrid(np.linspace(-_INNER, _INNER, 5), np.linspace(0.0, _INNER, 3), indexing="ij")
    lattices = [np.stack([y, z], axis=-1), _ring()]
    corners = np.concatenate([_quadrangles(lattice) for lattice in lattices]).reshape(-1, 2)
    # rounding makes one of nodes that two bricks share, and zeros of what is nearly zero
    points, which = np.unique(corners.round(12) + 0.0, axis=0, return_inverse=True)
    return points, which.reshape(-1, 8).astype(np.int64)


def _ring() -> Floats:
    """Lattice from the circle inwards to the rectangle, shape (9, 3, 2)."""
    side = np.linspace(0.0, _INNER, 3)
    left = np.column_stack([np.full(3, -_INNER), side])
    top = np.column_stack([np.linspace(-_INNER, _INNER, 5), np.full(5, _INNER)])
    inner = np.concatenate([left, top[1:-1], left[::-1] * [-1.0, 1.0]])
    angle = np.linspace(np.pi, 0.0, len(inner))
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    share = np.array([0.0, 0.5, 1.0])[:, np.newaxis]
    lattice: Floats = circle[:, np.newaxis] + share * (inner - circle)[:, np.newaxis]
    return lattice


def _quadrangles(lattice: Floats) -> Floats:
    """Nodes of every second cell of a lattice, shape (cells, 8, 2), each turning from y to z."""
    cells = [
        np.array([lattice[i + u, j + v] for u, v in _AROUND])
        for i in range(0, lattice.shape[0] - 1, 2)
        for j in range(0, lattice.shape[1] - 1, 2)
    ]
    return np.array([cell if _area(cell) > 0.0 else cell[_TURNED] for cell in cells])


def _area(cell: Floats) -> float:
    """Area of the corners' polygon, positive if it turns from y to z."""
    y, z = cell[:4].T
    return float(0.5 * np.sum(y * np.roll(z, -1) - np.roll(y, -1) * z))
