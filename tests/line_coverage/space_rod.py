"""A second rod in space: Kirchhoff's equations by collocation, with memory that turns.

It knows nothing of the package. Places, turns and moments along the line are the solution of a
boundary value problem (`scipy.integrate.solve_bvp`); where it stands, the curvature is the one that
a spring and stops answer a moment with. What the stops remember is kept at stations and is taken as
straight between them. A line that jumps is not followed, and one where many stops begin to slide
may want more stations than there are: `RuntimeError`.

Inside, lengths are in the line's length and moments in first bending stiffness over it. Frames are
unit quaternions (w, x, y, z); their third axis points along the line.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_bvp

from tests.judges.foreign.planar_rod import Stops

Numbers = NDArray[np.float64]
_STATIONS, _MOST = 121, 20_000
_TOLERANCE = 1e-4
_ROUNDS, _CLOSE = 60, 1e-11
_RELEASE = 20


@dataclass(frozen=True)
class SpaceShape:
    """Places of the stations, m; what holds the near end, N, N m; the largest curvature, 1/m."""

    places: Numbers
    start_force: Numbers
    start_moment: Numbers
    most_bent: float


class SpaceRod:
    """A line clamped at the origin.

    Parameters
    ----------
    length : m
    law : of bending, alike in every direction
    torsion : N m^2
    weight : N/m, shape (3,), in space
    natural : 1/m, shape (2,), free curvature about both axes across
    frame : of the clamp
    """

    def __init__(
        self,
        length: float,
        law: Stops,
        torsion: float,
        *,
        weight: Numbers,
        natural: Numbers,
        frame: Numbers,
    ) -> None:
        self.length, self.frame = length, frame
        self.unit = law.spring + float(law.stiffness.sum())
        self.law = Stops(law.spring / self.unit, law.stiffness / self.unit, law.width * length)
        self.torsion = torsion / self.unit
        self.weight = weight * length**3 / self.unit
        self.natural = natural * length
        self.along = np.linspace(0.0, 1.0, _STATIONS)
        self.rests = np.zeros((_STATIONS, len(law.width), 2))
        self.state = np.zeros((10, _STATIONS))
        self.state[:7] = np.concatenate([np.zeros(3), frame])[:, None]
        self.state[:3] += self.along * turned(frame, np.array([0.0, 0.0, 1.0]))[:, None]
        self.force = np.zeros(3)
        self.far_moment = np.zeros(3)

    def begin(self, places: Numbers, frames: Numbers, curvature: Numbers) -> None:
        """Guess a first shape: places, m, frames and curvature vectors, 1/m in space, along it."""
        share = np.linspace(0.0, 1.0, len(places))
        rows = np.hstack([places / self.length, frames, curvature * self.length])
        self.state = np.array([np.interp(self.along, share, row) for row in rows.T])

    def hold(self, place: Numbers, frame: Numbers) -> None:
        """Clamp the far end at a place, m, in a frame; the step is taken whole."""
        goal = place / self.length
        back = frame * np.array([1.0, -1.0, -1.0, -1.0])

        def ends(a: Numbers, b: Numbers, _: Numbers) -> Numbers:
            return np.concatenate([a[:7] - self._clamp, b[:3] - goal, _product(back, b[3:7])[1:]])

        found = solve_bvp(
            self._slopes,
            ends,
            self.along,
            self.state,
            self.force,
            tol=_TOLERANCE,
            max_nodes=_MOST,
        )
        _require(found.success, found.message)
        self.force = np.asarray(found.p)
        self._keep(np.asarray(found.sol(self.along)))
        self.far_moment = self.state[7:, -1].copy()

    def load(self, force: Numbers, moment: Numbers | None = None) -> None:
        """Free the far end but for a dead force, N, and a moment, N m, both in space."""
        self.force = force * self.length**2 / self.unit
        self.far_moment = np.zeros(3) if moment is None else moment * self.length / self.unit
        self._loaded()

    def let_go(self) -> None:
        """Take away what holds the far end, at once: on its way the line remembers nothing.

        The equilibrium is looked for with ever less of the force and the moment.
        """
        force, moment, rests = self.force, self.far_moment, self.rests
        for share in np.linspace(1.0, 0.0, _RELEASE + 1)[1:]:
            self.rests = rests
            self.force, self.far_moment = share * force, share * moment
            self._loaded()

    def shape(self) -> SpaceShape:
        """As it is now."""
        moment = self.state[7:, 0] * self.unit / self.length
        start = -(self.force + self.weight) * self.unit / self.length**2
        bent, _ = self._bent(self.along, self.state)
        most = np.linalg.norm(bent[:2], axis=0).max() / self.length
        return SpaceShape(self.length * self.state[:3].T, start, -moment, float(most))

    @property
    def _clamp(self) -> Numbers:
        return np.concatenate([np.zeros(3), self.frame])

    def _loaded(self) -> None:
        def ends(a: Numbers, b: Numbers) -> Numbers:
            return np.concatenate([a[:7] - self._clamp, b[7:] - self.far_moment])

        def slopes(at: Numbers, y: Numbers) -> Numbers:
            return self._slopes(at, y, self.force)

        found = solve_bvp(slopes, ends, self.along, self.state, tol=_TOLERANCE, max_nodes=_MOST)
        _require(found.success, found.message)
        self._keep(np.asarray(found.sol(self.along)))

    def _keep(self, state: Numbers) -> None:
        self.state = state
        _, self.rests = self._bent(self.along, state)

    def _slopes(self, at: Numbers, y: Numbers, pull: Numbers) -> Numbers:
        """Of places, quaternions, and moments in space, shape (10, places along the line)."""
        w, v = y[3], y[4:7]
        bent, _ = self._bent(at, y)
        ahead = turned(y[3:7], np.array([0.0, 0.0, 1.0])[:, None])
        spin = 0.5 * np.vstack([-np.sum(v * bent, axis=0), w * bent + np.cross(v.T, bent.T).T])
        carried = pull[:, None] + self.weight[:, None] * (1.0 - at)
        return np.vstack([ahead, spin, -np.cross(ahead.T, carried.T).T])

    def _bent(self, at: Numbers, y: Numbers) -> tuple[Numbers, Numbers]:
        """Curvature in the line's own frames, that at rest included, and rests afterwards."""
        own = turned(y[3:7] * np.array([1.0, -1.0, -1.0, -1.0])[:, None], y[7:])
        across, rests = self._answer(own[:2].T, self._rests_at(at))
        return np.vstack([across.T + self.natural[:, None], own[2] / self.torsion]), rests

    def _rests_at(self, at: Numbers) -> Numbers:
        left = np.minimum((at * (_STATIONS - 1)).astype(int), _STATIONS - 2)
        share = (at * (_STATIONS - 1) - left)[:, None, None]
        return np.asarray((1.0 - share) * self.rests[left] + share * self.rests[left + 1])

    def _answer(self, moment: Numbers, rests: Numbers) -> tuple[Numbers, Numbers]:
        """Curvature vectors that carry moment vectors, shape (stations, 2): the least of a work.

        Newton's way, halved at every station where the work does not fall.
        """
        bent = moment.copy()
        work, slope, tangent, after = self._work(bent, moment, rests)
        for _ in range(_ROUNDS):
            if np.abs(slope).max() < _CLOSE:
                break
            move = -np.linalg.solve(tangent, slope[..., None])[..., 0]
            share = np.ones(len(bent))
            for _ in range(30):
                then = self._work(bent + share[:, None] * move, moment, rests)
                rises = then[0] > work + 1e-14
                if not rises.any():
                    break
                share[rises] *= 0.5
            bent = bent + share[:, None] * move
            work, slope, tangent, after = then
        return bent, after

    def _work(
        self, bent: Numbers, moment: Numbers, rests: Numbers
    ) -> tuple[Numbers, Numbers, Numbers, Numbers]:
        """Of a step to a curvature against a moment; its slope, the slope of that, new rests."""
        law = self.law
        away = bent[:, None, :] - rests
        far = np.linalg.norm(away, axis=2)
        stuck = np.minimum(far, law.width)
        share = np.divide(stuck, far, out=np.ones_like(far), where=far > 0.0)
        held = share[..., None] * away
        work = (
            0.5 * law.spring * np.sum(bent**2, axis=1)
            + (stuck * (far - 0.5 * stuck)) @ law.stiffness
            - np.sum(moment * bent, axis=1)
        )
        slope = law.spring * bent + np.einsum("nsx,s->nx", held, law.stiffness) - moment
        slides = far > law.width
        unit = np.divide(away, far[..., None], out=np.zeros_like(away), where=far[..., None] > 0.0)
        weighted = np.where(slides, share, 0.0) * law.stiffness
        tangent = (law.spring + (share * law.stiffness).sum(axis=1))[:, None, None] * np.eye(2)
        tangent = tangent - np.einsum("ns,nsx,nsy->nxy", weighted, unit, unit)
        return work, slope, tangent, bent[:, None, :] - held


def _require(is_solved: bool, message: str) -> None:
    if not is_solved:
        raise RuntimeError(message)


def turned(q: Numbers, vector: Numbers) -> Numbers:
    """Vectors, shape (3, ...), turned by quaternions, shape (4, ...)."""
    w, v = q[0], q[1:]
    twice = 2.0 * np.cross(v, np.broadcast_to(vector, v.shape), axis=0)
    return np.asarray(vector + w * twice + np.cross(v, twice, axis=0))


def _product(p: Numbers, q: Numbers) -> Numbers:
    """Of two quaternions."""
    return np.append(
        p[0] * q[0] - p[1:] @ q[1:], p[0] * q[1:] + q[0] * p[1:] + np.cross(p[1:], q[1:])
    )
