"""A wire hung as a loop between two level clamps, as an elastica in its plane.

It shares no code with `labpipe.rod`: it knows no nodes in space and no frames, but the
angle of each piece to the level, and closes the loop by two multipliers, the pull of a clamp.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_banded

from labpipe.records.arrays import Floats

GRAVITY = 9.81


_TOLERANCE = 1e-10


_MOST = 30


_WEIGHTS = (0.01, 1.0, 6)
"""From a circle that weighs nearly nothing to the wire."""


@dataclass(frozen=True, slots=True, eq=False)
class HungElastica:
    """A wire in a vertical plane between two clamps, from one level direction round to the other.

    Parameters
    ----------
    length : between the clamps, m
    weight : per length, N/m
    stiffness : of bending, N m^2
    chord : (2,), the second clamp from the first, to the right and up, m
    natural : what the free wire's curvature is made of, 1/m: Legendre polynomials of degree 1, 2,
        ... over the length, positive as the loop turns. Degree 0 does nothing between clamps: its
        moment times the turn of the loop, which the clamps hold, is the same for every shape.
    tilts : angles to the level at the two clamps, rad
    pieces : all alike; the error falls with their square
    """

    length: float
    weight: float
    stiffness: float
    chord: tuple[float, float]
    natural: tuple[float, ...] = ()
    tilts: tuple[float, float] = (0.0, 0.0)
    pieces: int = 300

    @property
    def piece(self) -> float:
        """Length of a piece, m."""
        return self.length / self.pieces

    def angles(self) -> Floats:
        """Angle of each piece to the level, rad, from 0 to -2 pi.

        Raises
        ------
        ArithmeticError
            If Newton's method does not find a shape.
        """
        angle, pull = -2 * np.pi * (np.arange(self.pieces) + 0.5) / self.pieces, np.zeros(2)
        shares = np.geomspace(*_WEIGHTS)
        for share, growth in zip(shares, [1.0, *shares[1:] / shares[:-1]], strict=True):
            angle, pull = self._solved(angle, growth * pull, float(share))
        return angle

    def _solved(self, angle: Floats, pull: Floats, share: float) -> tuple[Floats, Floats]:
        """Newton's method, under a share of the weight."""
        for _ in range(_MOST):
            force, bands, ways = self._tangent(angle, pull, share)
            gap = ways.sum(axis=1) - self.chord
            moved = solve_banded((1, 1), bands, np.column_stack([-force, *_turned(ways)]))
            free, across = moved[:, 0], moved[:, 1:]
            change = np.linalg.solve(_turned(ways) @ across, gap + _turned(ways) @ free)
            step = free - across @ change
            scale = min(1.0, 0.5 / float(np.abs(step).max()))
            angle, pull = angle + scale * step, pull + scale * change
            if np.abs(step).max() < _TOLERANCE:
                return angle, pull
        raise ArithmeticError("no shape of the hung wire")

    def _tangent(self, angle: Floats, pull: Floats, share: float) -> tuple[Floats, Floats, Floats]:
        """Slope of energy less work of the pull, its bands, and the way of each piece."""
        n, h, stiffness = self.pieces, self.piece, self.stiffness
        ends = np.array([self.tilts[0], self.tilts[1] - 2 * np.pi])
        springs = np.full(n + 1, stiffness / h)
        springs[[0, -1]] *= 2
        turns = np.diff(angle, prepend=ends[0], append=ends[1])
        moments = springs * turns + stiffness * self._set(n)
        ways = h * np.array([np.cos(angle), np.sin(angle)])
        lift = share * self.weight * h * (n - 0.5 - np.arange(n))
        force = -np.diff(moments) + lift * ways[0] + pull @ _turned(ways)
        bands = np.zeros((3, n))
        bands[0, 1:] = bands[2, :-1] = -springs[1:-1]
        bands[1] = springs[:-1] + springs[1:] - lift * ways[1] - pull @ ways
        return force, bands, ways

    def _set(self, n: int) -> Floats:
        """Curvature of the free wire, where pieces meet, 1/m."""
        place = np.linspace(-1, 1, n + 1)
        return np.asarray(np.polynomial.legendre.legval(place, (0.0, *self.natural)))

    def shape(self) -> Floats:
        """Points where pieces meet, shape (pieces + 1, 2), to the right and up, m."""
        angle = self.angles()
        ways = self.piece * np.column_stack([np.cos(angle), np.sin(angle)])
        return np.vstack([np.zeros(2), np.cumsum(ways, axis=0)])

    def at(self, shares: Floats) -> Floats:
        """Points at shares of the length, shape (shares, 2), m."""
        shape = self.shape()
        place = np.linspace(0, 1, self.pieces + 1)
        return np.column_stack([np.interp(shares, place, each) for each in shape.T])


def _turned(ways: Floats) -> Floats:
    """Change of each way with its angle."""
    return np.array([-ways[1], ways[0]])
