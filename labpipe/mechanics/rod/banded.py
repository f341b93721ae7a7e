"""Banded matrix of the unknowns of a line: numbering, assembly and solution.

Every element has ten unknowns: the position of its first node (3), its stretch, the turn of its
frame (3), and its force (3). The position of the last node follows. A matrix is assembled from
small blocks in a fixed order; all their entries are added to the band at once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import lapack

from labpipe.records.arrays import Flags, Floats, Ints

PER_ELEMENT = 10
"""Number of unknowns of an element."""
STRETCH, TURN, FORCE = 3, 4, 7
"""Offsets among the ten unknowns of an element."""


@dataclass(frozen=True, slots=True, eq=False)
class UnknownIndices:
    """First indices of the unknowns of a line of n elements.

    Parameters
    ----------
    positions : shape (n + 1,)
    stretches, turns, forces : shape (n,)
    """

    positions: Ints
    stretches: Ints
    turns: Ints
    forces: Ints

    @property
    def total(self) -> int:
        """Return the number of unknowns."""
        return int(self.positions[-1]) + 3


def number_unknowns(n: int) -> UnknownIndices:
    """Number the unknowns of a line of n elements."""
    first = PER_ELEMENT * np.arange(n + 1)
    return UnknownIndices(first, first[:-1] + STRETCH, first[:-1] + TURN, first[:-1] + FORCE)


def join_unknowns(positions: Floats, stretches: Floats, turns: Floats, forces: Floats) -> Floats:
    """Join values of nodes and elements in the order of the unknowns.

    Parameters
    ----------
    positions : shape (n + 1, 3)
    stretches : shape (n,)
    turns, forces : shape (n, 3)
    """
    out = np.empty(PER_ELEMENT * len(stretches) + 3)
    rows = out[:-3].reshape(-1, PER_ELEMENT)
    rows[:, :STRETCH], out[-3:] = positions[:-1], positions[-1]
    rows[:, STRETCH], rows[:, TURN:FORCE], rows[:, FORCE:] = stretches, turns, forces
    return out


def split_unknowns(values: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Split unknowns into positions, stretches, turns and forces; see `join_unknowns`."""
    rows = values[:-3].reshape(-1, PER_ELEMENT)
    positions = np.concatenate([rows[:, :STRETCH], values[None, -3:]])
    return positions, rows[:, STRETCH], rows[:, TURN:FORCE], rows[:, FORCE:]


def list_block_entries(rows: Ints, height: int, columns: Ints, width: int) -> tuple[Ints, Ints]:
    """Return rows and columns of all entries of equal blocks, block by block."""
    shape = (len(rows), height, width)
    row_numbers = rows[:, None, None] + np.arange(height)[:, None]
    right = columns[:, None, None] + np.arange(width)
    return np.broadcast_to(row_numbers, shape).ravel(), np.broadcast_to(right, shape).ravel()


class Band:
    """A banded matrix that is filled repeatedly with the same blocks.

    Parameters
    ----------
    rows, columns : shape (entries,), of every entry of every block; entries may coincide
    scale : shape (unknowns,), magnitude of each unknown, by which rows and columns are multiplied
    fixed : shape (unknowns,), whether the change of the unknown is prescribed
    """

    def __init__(self, rows: Ints, columns: Ints, scale: Floats, fixed: Flags) -> None:
        self.size = len(scale)
        self.scale = scale
        self.fixed = fixed
        self.lower = int(np.max(rows - columns))
        self.upper = int(np.max(columns - rows))
        self._depth = 2 * self.lower + self.upper + 1
        self._entries = self._depth * columns + (self.lower + self.upper + rows - columns)
        self._weights = scale[rows] * scale[columns] * ~fixed[rows]
        self._ones = self._depth * np.flatnonzero(fixed) + (self.lower + self.upper)

    def solve(self, values: Floats, right: Floats) -> Floats | None:
        """Solve for the unknowns, shape (unknowns,); None if that fails.

        Parameters
        ----------
        values : shape (entries,), of the matrix
        right : shape (unknowns,), right side; of a fixed unknown its change
        """
        flat = np.bincount(self._entries, values * self._weights, minlength=self._depth * self.size)
        flat[self._ones] = 1.0
        band = flat.reshape(self.size, self._depth).T
        factors, pivots, failed = lapack.dgbtrf(band, self.lower, self.upper, overwrite_ab=True)
        if failed:
            return None
        scaled = np.where(self.fixed, right / self.scale, right * self.scale)
        solution, failed = lapack.dgbtrs(
            factors, self.lower, self.upper, scaled, pivots, overwrite_b=True
        )
        if failed or not np.all(np.isfinite(solution)):
            return None
        return np.asarray(solution * self.scale)
