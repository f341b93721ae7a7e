"""A hung loop of which one clamp is turned: a rod of directions, and its stability.

It shares no code with `labpipe.rod`: there are no nodes and no frames. The unknowns are the
directions of the pieces, points of the unit sphere. The wire is straight and round where it is
free, so that its twist is the same all along and is one number: the turn of the clamp, less what
the directions turn a frame that is carried along them without twist, the area that they sweep.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh, null_space

from labpipe.records.arrays import Floats
from tests.judges.hung_wires import HungElastica

_TOLERANCE = 1e-8
_MOST = 25
_FINEST = 0.02
"""rad, of the turn."""
_LONGEST = 1.0
"""rad, that a piece may turn in one step of Newton's method."""
_STEP = 0.7
"""rad, of the turn."""
_POLE = np.array([0.0, 1.0, 0.0])
"""Areas are counted from here; no piece may point the other way."""


@dataclass(frozen=True, slots=True, eq=False)
class TwistedLoop:
    """A hung loop with the torsional stiffness of its wire.

    Parameters
    ----------
    hung : the loop before it is turned; free curvature and tilts are left out
    torsion : stiffness, N m^2
    """

    hung: HungElastica
    torsion: float

    def snap(self, most: float = 40.0) -> tuple[float, Floats]:
        """Turn of a clamp at which the loop is no longer stable, rad, and its last stable shape.

        The turn grows by small steps; where the least eigenvalue of the energy within the clamps is
        no longer positive, or no shape is found nearby, the step is halved.

        Returns
        -------
        The turn, and points, shape (pieces + 1, 3)

        Raises
        ------
        ArithmeticError
            If the loop is stable up to the most of turn.
        """
        ways, pull = self.flat(), np.zeros(3)
        at, step = 0.0, _STEP
        while at < most:
            found = self.equilibrium(ways, pull, at + step)
            if found is None or self.least_eigenvalues(*found, at + step)[0] <= 0:
                step /= 2
                if step < _FINEST:
                    return at + step, self.points(ways)
                continue
            ways, pull = found
            at += step
        raise ArithmeticError("stable all along")

    def flat(self) -> Floats:
        """Directions of the pieces before the clamp is turned, shape (pieces, 3)."""
        angle = self.hung.angles()
        return np.column_stack([np.cos(angle), np.zeros(len(angle)), np.sin(angle)])

    def equilibrium(self, ways: Floats, pull: Floats, turn: float) -> tuple[Floats, Floats] | None:
        """Directions and pull of the clamp where energy is stationary; None where Newton ends."""
        for _ in range(_MOST):
            slope, bend, across = self._tangent(ways, pull, turn)
            base = _bases(ways)
            m = base.shape[1]
            system = np.zeros((m + 3, m + 3))
            system[:m, :m], system[m:, :m] = base.T @ bend @ base, across @ base
            system[:m, m:] = system[m:, :m].T
            step = np.linalg.solve(system, -np.concatenate([base.T @ slope, self._gap(ways)]))
            moved = (base @ step[:m]).reshape(-1, 3)
            size = float(np.linalg.norm(moved, axis=1).max())
            if size > _LONGEST:
                return None
            ways = ways + moved
            ways = ways / np.linalg.norm(ways, axis=1)[:, None]
            pull = pull + step[m:]
            if size < _TOLERANCE:
                return ways, pull
        return None

    def least_eigenvalues(self, ways: Floats, pull: Floats, turn: float, count: int = 1) -> Floats:
        """Least eigenvalues of the energy's curvature, over changes that the clamps allow.

        Without weight one of them is zero: a round wire spins in its own line at no cost, and the
        loop swings around the clamps.
        """
        _, bend, across = self._tangent(ways, pull, turn)
        base = _bases(ways)
        free = base @ null_space(across @ base)
        least = [0, count - 1]
        return np.asarray(eigh(free.T @ bend @ free, eigvals_only=True, subset_by_index=least))

    def points(self, ways: Floats) -> Floats:
        """Points where pieces meet, shape (pieces + 1, 3), m."""
        return np.vstack([np.zeros(3), np.cumsum(self.hung.piece * ways, axis=0)])

    def energy(self, ways: Floats, pull: Floats, turn: float) -> float:
        """Energy, and work of the pull, J."""
        h, joined = self.hung.piece, _joined(ways)
        cosine = np.sum(joined[:-1] * joined[1:], axis=1)
        bending = np.sum(2 * self._springs() * (1 - cosine) / (1 + cosine))
        twisting = self.torsion / self.hung.length * (turn + _swept(joined)[0]) ** 2 / 2
        return float(bending + twisting + h * np.sum((self._lift() + pull) * ways))

    def _gap(self, ways: Floats) -> Floats:
        x, z = self.hung.chord
        return np.asarray(self.hung.piece * ways.sum(axis=0) - [x, 0.0, z])

    def _springs(self) -> Floats:
        springs = np.full(self.hung.pieces + 1, self.hung.stiffness / self.hung.piece)
        springs[[0, -1]] *= 2
        return springs

    def _lift(self) -> Floats:
        """Weight that hangs on each piece, shape (pieces, 3), N."""
        n = self.hung.pieces
        lift = np.zeros((n, 3))
        lift[:, 2] = self.hung.weight * self.hung.piece * (n - 0.5 - np.arange(n))
        return lift

    def _tangent(self, ways: Floats, pull: Floats, turn: float) -> tuple[Floats, Floats, Floats]:
        """Slope and curvature of the energy on the spheres, and of the end by each direction."""
        joined = _joined(ways)
        swept, s1, s2 = _swept(joined)
        moment = self.torsion / self.hung.length * (turn + swept)
        b1, b2 = _bending(joined, self._springs())
        load = (self.hung.piece * (self._lift() + pull)).ravel()
        g1, g2 = _gathered(b1 + moment * s1, b2 + moment * s2)
        sweep, _ = _gathered(s1, s2)
        slope = g1 + load
        bend = g2 + self.torsion / self.hung.length * np.outer(sweep, sweep)
        along = np.sum(slope.reshape(-1, 3) * ways, axis=1)
        bend -= np.diag(np.repeat(along, 3))
        return slope, bend, self.hung.piece * np.tile(np.eye(3), len(ways))


def _joined(ways: Floats) -> Floats:
    """Directions with those of the clamps, both to the right."""
    return np.vstack([[1.0, 0.0, 0.0], ways, [1.0, 0.0, 0.0]])


def _bending(joined: Floats, springs: Floats) -> tuple[Floats, Floats]:
    """Slope (joints, 6) and curvature (joints, 6, 6) of bending by both directions of a joint."""
    a, b = joined[:-1], joined[1:]
    c = np.sum(a * b, axis=1)
    k1, k2 = -4 * springs / (1 + c) ** 2, 8 * springs / (1 + c) ** 3
    other = np.hstack([b, a])
    cross = np.kron(np.array([[0.0, 1.0], [1.0, 0.0]]), np.eye(3))
    return k1[:, None] * other, k2[:, None, None] * _outer(other, other) + k1[:, None, None] * cross


def _swept(joined: Floats) -> tuple[float, Floats, Floats]:
    """Sum of sin(height over the plane) d(angle in it), with slope and curvature of each joint.

    Areas of triangles from the pole, 2 atan2(N, D) (Van Oosterom and Strackee 1983).
    """
    a, b = joined[:-1], joined[1:]
    n = np.cross(a, b) @ _POLE
    d = 1 + a @ _POLE + b @ _POLE + np.sum(a * b, axis=1)
    n1 = np.hstack([np.cross(b, _POLE), np.cross(_POLE, a)])
    d1 = np.hstack([_POLE + b, _POLE + a])
    spin = np.array([np.cross(_POLE, each) for each in np.eye(3)])
    n2, d2 = np.zeros((6, 6)), np.kron(np.array([[0.0, 1.0], [1.0, 0.0]]), np.eye(3))
    n2[:3, 3:], n2[3:, :3] = spin, spin.T
    r = (n**2 + d**2)[:, None]
    slope = 2 * (d[:, None] * n1 - n[:, None] * d1) / r
    bend = d[:, None, None] * n2 - n[:, None, None] * d2 + _outer(n1, d1) - _outer(d1, n1)
    bend = 2 * bend / r[:, :, None]
    bend -= _outer(slope, 2 * (n[:, None] * n1 + d[:, None] * d1)) / r[:, :, None]
    return float(np.sum(2 * np.arctan2(n, d))) - 2 * np.pi, slope, bend


def _gathered(slope: Floats, bend: Floats) -> tuple[Floats, Floats]:
    """Slope and curvature by all directions, of those of the joints."""
    joints = len(slope)
    size = 3 * (joints + 1)
    full, square = np.zeros(size), np.zeros((size, size))
    for joint in range(joints):
        at = slice(3 * joint, 3 * joint + 6)
        full[at] += slope[joint]
        square[at, at] += bend[joint]
    return full[3:-3], square[3:-3, 3:-3]


def _bases(ways: Floats) -> Floats:
    """Two directions across each piece, shape (3 pieces, 2 pieces)."""
    n = len(ways)
    other = np.where(np.abs(ways) < 0.7, ways + 1, ways - 1)
    one = np.cross(ways, np.roll(other, 1, axis=1))
    one /= np.linalg.norm(one, axis=1)[:, None]
    two = np.cross(ways, one)
    base = np.zeros((n, 3, n, 2))
    at = np.arange(n)
    base[at, :, at, 0], base[at, :, at, 1] = one, two
    return base.reshape(3 * n, 2 * n)


def _outer(a: Floats, b: Floats) -> Floats:
    return np.asarray(a[:, :, None] * b[:, None, :])
