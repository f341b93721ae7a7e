"""A second rod, in one plane: angles of rigid links, not nodes and frames; dense Newton.

It knows nothing of the package. Links of equal length carry springs with Coulomb stops between
them, and half a link away from each clamp another one; the shape is the stationary point of the
work of a step, with the place of the far end as two constraints. What holds the far end may let go
little by little: its force and moment then fall to zero in proportion.

Lengths in m, angles in rad from the x axis, gravity along -z, moments in N m.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Numbers = NDArray[np.float64]
_ROUNDS, _CLOSE, _DEEPEST = 40, 1e-10, 9
_MOST, _FARTHEST = 0.3, 30.0


@dataclass(frozen=True)
class Stops:
    """A spring, N m^2, and stops beside it that give way at curvatures, 1/m."""

    spring: float
    stiffness: Numbers
    width: Numbers

    def times(self, factor: float) -> Stops:
        """All moments multiplied."""
        return Stops(factor * self.spring, factor * self.stiffness, self.width)


def stops_through(curvature: Numbers, moment: Numbers) -> Stops:
    """Stops whose first loading goes through points of a law that never stiffens, from zero."""
    slopes = np.minimum.accumulate(np.diff(moment) / np.diff(curvature))
    return Stops(float(slopes[-1]), -np.diff(slopes), curvature[1:-1])


@dataclass(frozen=True)
class Shape:
    """Places of the nodes, m, x and z; curvature of the springs, 1/m, and where along the line, m.

    `force` is what holds the far end, N, x and z; `start_force` what holds the near one.
    """

    places: Numbers
    curvature: Numbers
    along: Numbers
    force: Numbers
    start_force: Numbers


class PlanarRod:
    """A line clamped at the origin, straight along x but for its free curvature.

    Parameters
    ----------
    length : m
    links : number
    law : of its springs
    weight : N/m
    natural : 1/m, free curvature, towards z
    has_far_clamp : the far end is turned as well as moved
    """

    def __init__(
        self,
        length: float,
        links: int,
        law: Stops,
        *,
        weight: float = 0.0,
        natural: float = 0.0,
        has_far_clamp: bool = True,
    ) -> None:
        self.length, self.links, self.law = length, links, law
        self.weight, self.natural, self.has_far_clamp = weight, natural, has_far_clamp
        self.step = length / links
        self.cells = np.full(links + 1, self.step)
        self.cells[[0, -1]] = 0.5 * self.step
        self.along = np.concatenate([[0.25], np.arange(1.0, links), [links - 0.25]]) * self.step
        self.angles = np.zeros(links)
        self.force = np.zeros(2)
        self.far: float | None = 0.0
        self.far_moment = 0.0
        self.rests = np.zeros((links + 1, len(law.width)))

    def hold(self, place: Numbers, angle: float = 0.0) -> None:
        """Go on to a place and an angle of the far end, from those before, halving the way."""
        goal = np.append(np.asarray(place, dtype=np.float64), angle)
        begin = np.append(self._ways()[1], self.far or 0.0)
        if np.ptp(self.angles) == 0.0:  # nothing gives way along a straight line
            self.angles = self._arc(goal[:2])
        self._halve(self._hold_once, begin, goal, 0)

    def let_go(self, steps: int = 20) -> None:
        """Take away what holds the far end."""
        held = np.append(self.force, self.far_moment)
        shares = np.linspace(1.0, 0.0, steps + 1)
        for last, share in pairwise(shares):
            self._halve(self._load_once, last * held, share * held, 0)

    def shape(self) -> Shape:
        """As it is now."""
        places = np.zeros((self.links + 1, 2))
        places[1:, 0] = self.step * np.cumsum(np.cos(self.angles))
        places[1:, 1] = self.step * np.cumsum(np.sin(self.angles))
        bent = self._bent(self.angles, self.far if self.has_far_clamp else None) + self.natural
        start = np.array([0.0, self.weight * self.length]) - self.force
        return Shape(places, bent, self.along, self.force.copy(), start)

    def _halve(
        self, way: Callable[[Numbers], bool], begin: Numbers, goal: Numbers, depth: int
    ) -> None:
        if way(goal):
            return
        if depth == _DEEPEST:
            message = f"no equilibrium at {goal}"
            raise RuntimeError(message)
        middle = 0.5 * (begin + goal)
        self._halve(way, begin, middle, depth + 1)
        self._halve(way, middle, goal, depth + 1)

    def _arc(self, place: Numbers) -> Numbers:
        """Angles of a bow between both ends: a first guess."""
        chord = float(np.hypot(*place)) / self.length
        half = float(np.sqrt(6.0 * max(1.0 - chord, 1e-9)))
        side = np.sign(place[1]) or 1.0
        middle = float(np.arctan2(place[1], place[0]))
        return np.asarray(middle + side * half * np.linspace(-1.0, 1.0, self.links))

    def _bent(self, angles: Numbers, far: float | None) -> Numbers:
        """Curvature less that at rest; of a far end that turns freely none."""
        turned = np.diff(angles, prepend=0.0, append=angles[-1] if far is None else far)
        bent = turned / self.cells - self.natural
        if far is None:
            bent[-1] = 0.0
        return np.asarray(bent)

    def _answer(self, bent: Numbers) -> tuple[Numbers, Numbers, Numbers]:
        """Moment, tangent, and rests afterwards."""
        law = self.law
        away = bent[:, None] - self.rests
        held = np.clip(away, -law.width, law.width)
        tangent = law.spring + (held == away) @ law.stiffness
        return law.spring * bent + held @ law.stiffness, tangent, bent[:, None] - held

    def _ways(self) -> tuple[Numbers, Numbers]:
        """What the far end's force does to each angle, and where that end is."""
        sine, cosine = np.sin(self.angles), np.cos(self.angles)
        return self.step * np.stack([sine, -cosine]), self.step * np.array(
            [cosine.sum(), sine.sum()]
        )

    def _balance(
        self, far: float | None, force: Numbers, moment: float
    ) -> tuple[Numbers, Numbers, Numbers, float]:
        """What each angle lacks, its slope, rests, and the moment at the far end."""
        carried, tangent, rests = self._answer(self._bent(self.angles, far))
        if far is None:
            carried[-1], tangent[-1], rests[-1] = moment, 0.0, self.rests[-1]
        stiff = tangent / self.cells
        hangs = self.weight * self.step * (self.links - np.arange(self.links) - 0.5)
        sine, cosine = np.sin(self.angles), np.cos(self.angles)
        up = hangs - force[1]
        lack = carried[:-1] - carried[1:] + self.step * (up * cosine + force[0] * sine)
        slope = stiff[:-1] + stiff[1:] + self.step * (force[0] * cosine - up * sine)
        matrix = np.diag(slope) - np.diag(stiff[1:-1], 1) - np.diag(stiff[1:-1], -1)
        return lack, matrix, rests, float(carried[-1])

    def _is_small(self, lack: Numbers) -> bool:
        return bool(np.abs(lack).max() < _CLOSE * self.law.spring / self.length)

    def _turn(self, move: Numbers) -> float:
        """Share of a step that is safe; 0 where the step is none."""
        size = float(np.abs(move).max())
        return min(1.0, _MOST / size) if 0.0 < size < _FARTHEST else float(size == 0.0)

    def _hold_once(self, goal: Numbers) -> bool:
        before = self.angles, self.force
        far = float(goal[2]) if self.has_far_clamp else None
        for _ in range(_ROUNDS):
            lack, matrix, rests, moment = self._balance(far, self.force, 0.0)
            ways, tip = self._ways()
            off = tip - goal[:2]
            if self._is_small(lack) and np.abs(off).max() < _CLOSE * self.length:
                self.rests, self.far, self.far_moment = rests, float(goal[2]), moment
                return True
            whole = np.block([[matrix, ways.T], [ways, np.zeros((2, 2))]])
            move = np.linalg.solve(whole, np.concatenate([-lack, off]))
            share = self._turn(move[:-2])
            if share == 0.0:
                break
            self.angles = self.angles + share * move[:-2]
            self.force = self.force + share * move[-2:]
        self.angles, self.force = before
        return False

    def _load_once(self, goal: Numbers) -> bool:
        before = self.angles
        for _ in range(_ROUNDS):
            lack, matrix, rests, _ = self._balance(None, goal[:2], float(goal[2]))
            if self._is_small(lack):
                self.rests, self.force, self.has_far_clamp = rests, goal[:2], False
                return True
            move = np.asarray(np.linalg.solve(matrix, -lack), dtype=np.float64)
            share = self._turn(move)
            if share == 0.0:
                break
            self.angles = self.angles + share * move
        self.angles = before
        return False
