"""Integration along a wire: Chebyshev-Lobatto stations and the matrices that integrate on them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.polynomial import chebyshev

from labpipe.records.arrays import Floats


@dataclass(frozen=True, slots=True, eq=False)
class Stations:
    """Stations on the unit interval, the clamp at 0 and the tip at 1, and integrals between them.

    Parameters
    ----------
    position : shape (n,), increasing, ends included
    from_clamp : shape (n, n), values at the stations -> integral from 0 to each station
    to_tip : shape (n, n), values at the stations -> integral from each station to 1
    """

    position: Floats
    from_clamp: Floats
    to_tip: Floats

    @property
    def weights(self) -> Floats:
        """Quadrature weights over the whole interval, shape (n,)."""
        weights: Floats = self.from_clamp[-1]
        return weights


@lru_cache(maxsize=16)
def chebyshev_stations(count: int) -> Stations:
    """Build `count` Chebyshev-Lobatto stations; exact for polynomials of degree count - 1.

    Raises
    ------
    ValueError
        If there are fewer than four.
    """
    if count < 4:
        message = f"count={count!r}: allowed are numbers >= 4"
        raise ValueError(message)
    nodes = -np.cos(np.pi * np.arange(count) / (count - 1))
    basis = chebyshev.chebvander(nodes, count - 1)
    integrals = np.column_stack(
        [chebyshev.chebval(nodes, chebyshev.chebint(unit, lbnd=-1)) for unit in np.eye(count)]
    )
    from_clamp: Floats = 0.5 * np.linalg.solve(basis.T, integrals.T).T.astype(np.float64)
    to_tip: Floats = from_clamp[-1] - from_clamp
    for matrix in (nodes, from_clamp, to_tip):
        matrix.flags.writeable = False
    return Stations(0.5 * (nodes + 1.0), from_clamp, to_tip)


def interpolation_matrix(count: int, positions: Floats) -> Floats:
    """Matrix that takes values at the stations to values at `positions` on the unit interval.

    Parameters
    ----------
    count : number of stations
    positions : shape (m,), within [0, 1]

    Returns
    -------
    Shape (m, count).

    Raises
    ------
    ValueError
        If a position lies outside.
    """
    if np.any((positions < 0.0) | (positions > 1.0)):
        message = f"positions={positions}: allowed are numbers between 0 and 1"
        raise ValueError(message)
    nodes = 2.0 * chebyshev_stations(count).position - 1.0
    basis = chebyshev.chebvander(nodes, count - 1)
    wanted = chebyshev.chebvander(2.0 * positions - 1.0, count - 1)
    matrix: Floats = np.linalg.solve(basis.T, wanted.T).T.astype(np.float64)
    return matrix
