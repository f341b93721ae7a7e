"""Which nodes are held at a time, and the cells and end elements that follow from it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from labpipe.records.arrays import Floats, Ints
from labpipe.rod.line import Line

Grip: TypeAlias = tuple[int, bool]
"""Node that is held, and whether its frame is as well."""

_Cell: TypeAlias = tuple[int, int, int, tuple[float, float], float]

END_SHARE = 1.0 / 6.0
"""Of the direction of an element beside a clamp, which is the clamp's; the rest is its frame's.

The half cell at a clamp feels the moment of the node and not that of its middle, which makes the
line too soft by an angle; with a direction of the element that is in part the clamp's, the moment
is the one a little further along. A sixth takes the error of second order at the clamp out of both
the angle and the deflection of a line that bends a little, and leaves less than a third of it where
it bends far.
"""


@dataclass(frozen=True, slots=True, eq=False)
class Supports:
    """Cells and held nodes of a line.

    Parameters
    ----------
    n_nodes : of the line
    held : shape (grips,), nodes with a position
    clamps : shape (clamps,), index in `held` of those with a frame
    before, behind : shape (cells,), element on that side; -1 - k for clamp k
    nodes : shape (cells,), node of each cell
    sides : shape (cells, 2), weight of the node's two sides in it: (1, 0), (0, 1), or both
    lengths : shape (cells,), m
    natural : shape (cells, 3), 1/m
    shares : shape (clamped elements, clamps), of their direction, that is a clamp's
    ends : shape (clamped elements,), those elements
    own : shape (clamped elements,), share of the direction that is their frame's
    """

    n_nodes: int
    held: Ints
    clamps: Ints
    before: Ints
    behind: Ints
    nodes: Ints
    sides: Floats
    lengths: Floats
    natural: Floats
    shares: Floats
    ends: Ints
    own: Floats


def supports_of(line: Line, grips: tuple[Grip, ...]) -> Supports:
    """Part the cells of a line by its clamps.

    Parameters
    ----------
    line : the line
    grips : nodes held, each at most once, counted from 0
    """
    held = np.array([node for node, _ in grips], dtype=np.int64)
    clamps = np.array([k for k, (_, is_clamp) in enumerate(grips) if is_clamp], dtype=np.int64)
    clamp_at = {int(held[k]): number for number, k in enumerate(clamps)}
    rows = [row for node in range(len(line.positions)) for row in _cells_at(line, node, clamp_at)]
    before, behind, nodes, sides, lengths = zip(*rows, strict=True) if rows else ((),) * 5
    at = np.array(nodes, dtype=np.int64)
    shares = np.zeros((len(line.lengths), len(clamps)))
    for node, number in clamp_at.items():
        shares[max(node - 1, 0) : node + 1, number] += END_SHARE
    ends = np.flatnonzero(shares.sum(axis=1))
    return Supports(
        n_nodes=len(line.positions),
        held=held,
        clamps=clamps,
        before=np.array(before, dtype=np.int64),
        behind=np.array(behind, dtype=np.int64),
        nodes=at,
        sides=np.array(sides, dtype=np.float64).reshape(-1, 2),
        lengths=np.array(lengths, dtype=np.float64),
        natural=_at_nodes(line)[at],
        shares=shares[ends],
        ends=ends,
        own=1.0 - shares[ends].sum(axis=1),
    )


def _cells_at(line: Line, node: int, clamp_at: dict[int, int]) -> list[_Cell]:
    """Cells of a node: elements or clamps before and behind, node, weights of its sides, length."""
    n = len(line.lengths)
    lower = 0.5 * float(line.lengths[node - 1]) if node > 0 else 0.0
    upper = 0.5 * float(line.lengths[node]) if node < n else 0.0
    if node in clamp_at:
        mark = -1 - clamp_at[node]
        parted: list[_Cell] = [
            (node - 1, mark, node, (1.0, 0.0), lower),
            (mark, node, node, (0.0, 1.0), upper),
        ]
        return [cell for cell in parted if cell[4] > 0.0]
    if not 0 < node < n:
        return []
    both = lower + upper
    return [(node - 1, node, node, (lower / both, upper / both), both)]


def _at_nodes(line: Line) -> Floats:
    """Curvature at rest of all nodes, 1/m: at the ends that of the neighbours."""
    if not len(line.natural):
        return np.zeros((len(line.positions), 3))
    return np.concatenate([line.natural[:1], line.natural, line.natural[-1:]])
