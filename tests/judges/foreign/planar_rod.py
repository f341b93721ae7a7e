"""A second rod, in one plane: angles of rigid links, not nodes and frames; dense Newton.

It knows nothing of the package. Links of equal length carry springs with Coulomb stops between
them, and half a link away from each clamp another one; the shape is the least of the work of a step
(augmented Lagrangian for the place of the far end), so that a line that jumps is followed to where
it comes to rest. What holds the far end may let go little by little.

Lengths in m, angles in rad from the x axis, gravity along -z, moments in N m.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Numbers = NDArray[np.float64]
_ROUNDS, _PULLS, _DEEPEST = 200, 30, 9
_DOWN, _BLUR = 1e-4, 1e-13
_CLOSE, _NEAR = 1e-8, 1e-8
_MOST, _SHORTEST = 0.5, 1e-6
_STIFF = 1e5
"""Of the spring that draws the far end to its place, over EI / L^3."""


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

    `force` is what holds the far end, N, x and z; `start_force` what holds the near one, and
    `start_moment`, N m, about the y axis.
    """

    places: Numbers
    curvature: Numbers
    along: Numbers
    force: Numbers
    start_force: Numbers
    start_moment: float


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
        begin = np.append(self._tip(self.angles), self.far or 0.0)
        if np.ptp(self.angles) == 0.0:  # nothing gives way along a straight line
            self.angles = self._arc(goal[:2])
        self._halve(begin, goal, 0)

    def load(self, force: Numbers, moment: float = 0.0) -> None:
        """Free the far end but for a dead force, N, x and z, and a moment, N m."""
        load = np.array([*force, moment])
        before = np.append(self.force, self.far_moment)
        for share in (1.0, 0.5, 0.75, 0.875, 1.0):  # the last ones only where one step is too far
            part = before + share * (load - before)
            if self._settle(None, part, np.zeros(2), 0.0):
                _, _, self.rests, _ = self._balance(self.angles, None, part)
                self.force, self.far_moment, self.has_far_clamp = part[:2], moment, False
                if share == 1.0:
                    return
        message = f"no equilibrium under {load}"
        raise RuntimeError(message)

    def curvature_after_release(self, steps: int = 20) -> None:
        """Take away what holds the far end, force and moment in proportion."""
        force, moment = self.force, self.far_moment
        for share in np.linspace(1.0, 0.0, steps + 1)[1:]:
            self.load(share * force, float(share * moment))

    def shape(self) -> Shape:
        """As it is now."""
        places = np.zeros((self.links + 1, 2))
        places[1:, 0] = self.step * np.cumsum(np.cos(self.angles))
        places[1:, 1] = self.step * np.cumsum(np.sin(self.angles))
        bent = self._bent(self.angles, self.far if self.has_far_clamp else None) + self.natural
        start = np.array([0.0, self.weight * self.length]) - self.force
        held = np.clip(bent[0] - self.natural - self.rests[0], -self.law.width, self.law.width)
        moment = self.law.spring * (bent[0] - self.natural) + held @ self.law.stiffness
        return Shape(places, bent, self.along, self.force.copy(), start, float(moment))

    def _halve(self, begin: Numbers, goal: Numbers, depth: int) -> None:
        if self._hold_once(goal):
            return
        if depth == _DEEPEST:
            message = f"no equilibrium at {goal}"
            raise RuntimeError(message)
        middle = 0.5 * (begin + goal)
        self._halve(begin, middle, depth + 1)
        self._halve(middle, goal, depth + 1)

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

    def _energy(self, angles: Numbers, far: float | None, load: Numbers) -> float:
        """What a step from the present rests to these angles takes, J, with a dead load."""
        law, bent = self.law, self._bent(angles, far)
        away = np.abs(bent[:, None] - self.rests)
        stuck = np.minimum(away, law.width)
        springs = 0.5 * law.spring * bent**2 + (stuck * (away - 0.5 * stuck)) @ law.stiffness
        if far is None:
            springs[-1] = -load[2] * angles[-1] / self.cells[-1]
        sine, cosine = np.sin(angles), np.cos(angles)
        falls = self._hangs() @ sine - load[1] * sine.sum() - load[0] * cosine.sum()
        return float(springs @ self.cells + self.step * falls)

    def _hangs(self) -> Numbers:
        """Weight behind each link and half of its own, N."""
        return np.asarray(self.weight * self.step * (self.links - np.arange(self.links) - 0.5))

    def _balance(
        self, angles: Numbers, far: float | None, load: Numbers
    ) -> tuple[Numbers, Numbers, Numbers, float]:
        """Slope of the energy by the angles, its slope, rests, and the moment at the far end."""
        carried, tangent, rests = self._answer(self._bent(angles, far))
        if far is None:
            carried[-1], tangent[-1], rests[-1] = load[2], 0.0, self.rests[-1]
        stiff = tangent / self.cells
        sine, cosine = np.sin(angles), np.cos(angles)
        up = self._hangs() - load[1]
        slope = carried[:-1] - carried[1:] + self.step * (up * cosine + load[0] * sine)
        own = stiff[:-1] + stiff[1:] + self.step * (load[0] * cosine - up * sine)
        matrix = np.diag(own) - np.diag(stiff[1:-1], 1) - np.diag(stiff[1:-1], -1)
        return slope, matrix, rests, float(carried[-1])

    def _settle(self, far: float | None, load: Numbers, goal: Numbers, stiff: float) -> bool:
        """Go downhill from the present angles, towards a place by a spring to it."""
        angles = self.angles

        def height(at: Numbers) -> float:
            off = self._tip(at) - goal
            return self._energy(at, far, load) + 0.5 * stiff * float(off @ off)

        now = height(angles)
        for _ in range(_ROUNDS):
            slope, matrix, _, _ = self._balance(angles, far, load)
            pull = stiff * (self._tip(angles) - goal)
            ways = self.step * np.stack([-np.sin(angles), np.cos(angles)])
            slope = slope + pull @ ways
            bow = self.step * (-pull[0] * np.cos(angles) - pull[1] * np.sin(angles))
            matrix = matrix + stiff * ways.T @ ways + np.diag(bow)
            if np.abs(slope).max() < _CLOSE * self.law.spring / self.length:
                self.angles = angles
                return True
            move = _downhill(matrix, slope)
            share = min(1.0, _MOST / float(np.abs(move).max()))
            blur = _BLUR * abs(now)
            while (then := height(angles + share * move)) > now + _DOWN * share * (
                slope @ move
            ) + blur:
                share *= 0.5
                if share < _SHORTEST:
                    break
            angles, now = angles + share * move, then
        return False

    def _hold_once(self, goal: Numbers) -> bool:
        before = self.angles, self.force
        far = float(goal[2]) if self.has_far_clamp else None
        stiff = _STIFF * self.law.spring / self.length**3
        for _ in range(_PULLS):
            load = np.append(self.force, 0.0)
            if not self._settle(far, load, goal[:2], stiff):
                break
            off = self._tip(self.angles) - goal[:2]
            self.force = self.force - stiff * off
            if np.abs(off).max() < _NEAR * self.length:
                load = np.append(self.force, 0.0)
                _, _, self.rests, self.far_moment = self._balance(self.angles, far, load)
                self.far = float(goal[2])
                return True
        self.angles, self.force = before
        return False

    def _tip(self, angles: Numbers) -> Numbers:
        return self.step * np.array([np.cos(angles).sum(), np.sin(angles).sum()])


def _downhill(matrix: Numbers, slope: Numbers) -> Numbers:
    """Newton's step, made one that goes down where the energy bends the other way."""
    lift = 0.0
    while True:
        try:
            root = np.linalg.cholesky(matrix + lift * np.eye(len(slope)))
            break
        except np.linalg.LinAlgError:
            lift = max(4.0 * lift, 1e-3 * float(np.diag(matrix).max()))
    return np.asarray(np.linalg.solve(root.T, np.linalg.solve(root, -slope)), dtype=np.float64)
