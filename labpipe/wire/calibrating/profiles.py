"""Profile likelihood: the interval is where holding a parameter makes the fit too much worse.

Too much is t^2 at 97.5 %, with the degrees of freedom of the parameter's variance, in place of
chi^2: the scatter of a few samples is itself an estimate. In the linear case this is the t
interval; where the objective is lopsided the interval is too, and it stays open where the
objective levels out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labpipe.records.arrays import Flags, Floats
from labpipe.wire.calibrating.finding import Found
from labpipe.wire.calibrating.search import Fit, Levels, P, Point, Problem, normal_matrix, search
from labpipe.wire.calibrating.variances import quantile

_CLOSE = 0.01  # of the root of the threshold
_MOST_LOOKS = 10
_FARTHER = 2.5  # at most, times the last distance


@dataclass(frozen=True, slots=True, eq=False)
class Trace:
    """A profile in logarithms: points in order, and its ends.

    Parameters
    ----------
    logs, deviance : shape (n,), increasing logs, rise of the objective
    lower, upper : logs, ends of the interval
    is_open_below, is_open_above : whether the objective stays below the threshold to the bound
    threshold : of the deviance, the square of the t quantile
    freedom : degrees of freedom
    """

    logs: Floats
    deviance: Floats
    lower: float
    upper: float
    is_open_below: bool
    is_open_above: bool
    threshold: float
    freedom: float


@dataclass(frozen=True, slots=True)
class _Side:
    end: float
    is_open: bool
    seen: tuple[tuple[float, float], ...]


def trace(found: Found, number: int) -> Trace:
    """Follow the objective to both sides of its least, all other unknowns fitted anew.

    Parameters
    ----------
    found : the fit of a calibration
    number : of the parameter
    """
    problem, levels, fit, free = found.problem, found.levels, found.fit, found.free
    error = float(np.sqrt(found.spread.covariance[number, number]))
    freedom = found.spread.freedom(np.eye(P + 1)[number])
    root = quantile(freedom)
    others = free.copy()
    others[number] = False
    direction = _direction(problem, levels, fit, free, number)
    sides = []
    for sign, bound in ((-1.0, problem.lower[number]), (1.0, problem.upper[number])):
        walk = _Walk(problem, levels, fit, others, number, direction, float(bound), sign)
        sides.append(_walk(walk, root, error))
    middle = (float(fit.point.logs[number]), 0.0)
    seen = sorted({*sides[0].seen, middle, *sides[1].seen})
    logs, roots = np.array(seen).T
    return Trace(
        logs,
        roots**2,
        sides[0].end,
        sides[1].end,
        sides[0].is_open,
        sides[1].is_open,
        root**2,
        freedom,
    )


def _direction(problem: Problem, levels: Levels, fit: Fit, free: Flags, number: int) -> Floats:
    """How all unknowns move with one parameter as long as the objective is a parabola."""
    matrix, moves = normal_matrix(problem, levels, fit, free)
    moves = moves.copy()
    moves[number] = False
    direction = np.zeros(len(matrix))
    direction[number] = 1.0
    if moves.any():
        inner = matrix[np.ix_(moves, moves)]
        scale = np.sqrt(np.maximum(np.diag(inner), 1e-30))
        unit = inner / np.outer(scale, scale) + 1e-12 * np.eye(len(scale))
        direction[moves] = -np.linalg.solve(unit, matrix[moves, number] / scale) / scale
    return direction


@dataclass(frozen=True, slots=True, eq=False)
class _Walk:
    problem: Problem
    levels: Levels
    fit: Fit
    others: Flags
    number: int
    direction: Floats
    bound: float
    sign: float

    def look(self, start: Fit, distance: float) -> tuple[float, Fit]:
        """Root of the deviance at a distance from the least, from a fit near by."""
        best = float(self.fit.point.logs[self.number])
        target = best + self.sign * distance
        shift = (target - float(start.point.logs[self.number])) * self.direction
        found = search(self.problem, self.levels, _shifted(self, start, shift, target), self.others)
        return float(np.sqrt(max(found.objective - self.fit.objective, 0.0))), found


def _shifted(walk: _Walk, start: Fit, shift: Floats, target: float) -> Point:
    size = len(start.point.logs)
    logs = np.clip(start.point.logs + shift[:size], walk.problem.lower, walk.problem.upper)
    logs[walk.number] = target
    offsets = start.point.offsets + shift[size + 1 :]
    return Point(logs, start.point.gain + float(shift[size]), offsets)


def _walk(walk: _Walk, root: float, error: float) -> _Side:
    """Find where the root of the deviance passes a value, going outwards and then in between."""
    room = walk.sign * (walk.bound - float(walk.fit.point.logs[walk.number]))
    if room <= 0.0:
        return _Side(walk.bound, is_open=True, seen=())
    low, high = (0.0, 0.0), None
    seen, near = [], walk.fit
    distance = min(root * error, room) if error > 0.0 else room
    for _ in range(_MOST_LOOKS):
        height, found = walk.look(near, distance)
        seen.append((distance, height))
        if abs(height - root) <= _CLOSE * root:
            break
        if height < root:
            low, near = (distance, height), found
            if distance >= room:
                return _Side(walk.bound, is_open=True, seen=_places(walk, seen))
        else:
            high = (distance, height)
        distance = _next(low, high, root, room)
    return _Side(_places(walk, [(distance, 0.0)])[0][0], is_open=False, seen=_places(walk, seen))


def _places(walk: _Walk, seen: list[tuple[float, float]]) -> tuple[tuple[float, float], ...]:
    best = float(walk.fit.point.logs[walk.number])
    return tuple((best + walk.sign * distance, height) for distance, height in seen)


def _next(
    low: tuple[float, float], high: tuple[float, float] | None, root: float, room: float
) -> float:
    """A straight line between the points on both sides; outwards at most a few times as far."""
    if high is None:
        ahead = low[0] * root / low[1] if low[1] > 0.0 else np.inf
        return min(max(ahead, 1.1 * low[0]), _FARTHER * low[0], room)
    share = (root - low[1]) / (high[1] - low[1])
    return low[0] + min(max(share, 0.05), 0.95) * (high[0] - low[0])
