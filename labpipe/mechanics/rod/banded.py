"""Number the unknowns of a line, and assemble and solve their banded matrix.

Every element has ten unknowns: the position of its first node (3), its stretch, the turn of its
frame (3), and its force (3). The position of the last node follows. A matrix is assembled from
small blocks in a fixed order. The entries of all blocks are added to the band at once.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import lapack

from labpipe.records.arrays import Flags, Floats, Ints

PER_ELEMENT = 10
"""Number of unknowns of an element."""
STRETCH, TURNS, FORCES = 3, 4, 7
"""Offsets of stretch, turn and force among the ten unknowns of an element."""


class UnknownIndices:
    """First indices of the unknowns of a line.

    Parameters
    ----------
    n : number of elements

    Attributes
    ----------
    positions : shape (n + 1,), index of the first component of each position
    stretches : shape (n,), index of each stretch
    turns, forces : shape (n,), index of the first component of each turn and force
    n_unknowns : number of unknowns
    """

    def __init__(self, n: int) -> None:
        self.positions: Ints = PER_ELEMENT * np.arange(n + 1)
        self.stretches, self.turns, self.forces = (
            self.positions[:-1] + offset for offset in (STRETCH, TURNS, FORCES)
        )
        self.n_unknowns = PER_ELEMENT * n + 3


def join_unknowns(positions: Floats, stretches: Floats, turns: Floats, forces: Floats) -> Floats:
    """Join values of nodes and elements in the order of the unknowns.

    Parameters
    ----------
    positions : shape (n + 1, 3), values for the positions of the nodes
    stretches : shape (n,), values for the stretches of the elements
    turns, forces : shape (n, 3), values for the turns and forces of the elements

    Returns
    -------
    Values of all unknowns, shape (10 n + 3,).
    """
    unknowns = np.empty(PER_ELEMENT * len(stretches) + 3)
    rows = unknowns[:-3].reshape(-1, PER_ELEMENT)
    rows[:, :STRETCH], unknowns[-3:] = positions[:-1], positions[-1]
    rows[:, STRETCH], rows[:, TURNS:FORCES], rows[:, FORCES:] = stretches, turns, forces
    return unknowns


def split_unknowns(values: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Split unknowns into positions, stretches, turns and forces, as in `join_unknowns`.

    Stretches, turns and forces are views of the unknowns.
    """
    rows = values[:-3].reshape(-1, PER_ELEMENT)
    positions = np.concatenate([rows[:, :STRETCH], values[None, -3:]])
    return positions, rows[:, STRETCH], rows[:, TURNS:FORCES], rows[:, FORCES:]


def list_block_entries(rows: Ints, height: int, columns: Ints, width: int) -> tuple[Ints, Ints]:
    """List rows and columns of all entries of blocks of equal size, block by block.

    Parameters
    ----------
    rows, columns : shape (blocks,), first row and first column of each block
    height, width : numbers of rows and columns of a block

    Returns
    -------
    Rows and columns, shape (blocks x height x width,) each.
    """
    shape = (len(rows), height, width)
    all_rows = rows[:, None, None] + np.arange(height)[:, None]
    all_columns = columns[:, None, None] + np.arange(width)
    return np.broadcast_to(all_rows, shape).ravel(), np.broadcast_to(all_columns, shape).ravel()


class BandedMatrix:
    """Banded matrix that is filled repeatedly with the same blocks.

    Parameters
    ----------
    rows, columns : shape (entries,), row and column of every entry of every block; entries at the
        same position are added
    scale : shape (unknowns,), factors by which rows and columns are multiplied
    is_fixed : shape (unknowns,), whether the change of the unknown is prescribed
    """

    def __init__(self, rows: Ints, columns: Ints, scale: Floats, is_fixed: Flags) -> None:
        self.size = len(scale)
        self.scale = scale
        self.is_fixed = is_fixed
        self.n_lower = int(np.max(rows - columns))
        self.n_upper = int(np.max(columns - rows))
        self._depth = 2 * self.n_lower + self.n_upper + 1
        # Indices of all entries, and of the fixed diagonal entries, in the band of LAPACK.
        self._entries = self._depth * columns + (self.n_lower + self.n_upper + rows - columns)
        self._fixed_entries = self._depth * np.flatnonzero(is_fixed) + (self.n_lower + self.n_upper)
        self._weights = scale[rows] * scale[columns] * ~is_fixed[rows]

    def solve(self, values: Floats, right_side: Floats) -> Floats | None:
        """Solve for the unknowns, shape (unknowns,); return None if the matrix is singular.

        Parameters
        ----------
        values : shape (entries,), entries of the matrix
        right_side : shape (unknowns,), right-hand side; for a fixed unknown, its change
        """
        sums = np.bincount(self._entries, values * self._weights, minlength=self._depth * self.size)
        sums[self._fixed_entries] = 1.0
        band, widths = sums.reshape(self.size, self._depth).T, (self.n_lower, self.n_upper)
        factors, pivots, has_failed = lapack.dgbtrf(band, *widths, overwrite_ab=True)
        if has_failed:
            return None
        vector = np.where(self.is_fixed, right_side / self.scale, right_side * self.scale)
        solution, has_failed = lapack.dgbtrs(factors, *widths, vector, pivots, overwrite_b=True)
        if has_failed or not np.all(np.isfinite(solution)):
            return None
        return np.asarray(solution * self.scale)
