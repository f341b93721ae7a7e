"""Profile likelihood: the interval is where holding a parameter makes the fit too much worse.

Too much is q^2, where chi^2 would have 1.96^2: q is the 97.5 % quantile, over the standard error,
of the parameter's distribution in the linear model, averaged over what the scatter of samples may
be (`scatter_mixture`); below and above it may differ. With many samples q is 1.96, for one
that leans on the mean of n samples it is that of Student's t with n - 1 degrees of freedom. In the
linear case this is the t interval; where the objective is asymmetric the interval is too, and it
stays open where the objective levels out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labpipe.records.arrays import Flags, Floats
from labpipe.wire.calibration.fit import Found
from labpipe.wire.calibration.parameter_search import (
    Fit,
    Levels,
    P,
    Point,
    Problem,
    normal_matrix,
    search,
)
from labpipe.wire.calibration.scatter_mixture import quantiles

_NORMAL, _LEAST_ROOT = 1.96, 0.5
_CLOSE = 0.01  # of the root of the threshold
_MOST_LOOKS = 24
_FARTHER = 2.5  # at most, times the last distance


@dataclass(frozen=True, slots=True, eq=False)
class Trace:
    """A profile in logarithms: points in order, and its ends.

    Parameters
    ----------
    logs, deviance : shape (n,), increasing logs, rise of the objective
    lower, upper : logs, ends of the interval
    is_open_below, is_open_above : whether the objective stays below the threshold to the bound
    threshold_below, threshold_above : of the deviance
    """

    logs: Floats
    deviance: Floats
    lower: float
    upper: float
    is_open_below: bool
    is_open_above: bool
    threshold_below: float
    threshold_above: float


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
    below, above = quantiles(found.mixture, np.eye(P + 1)[[number]])
    roots = _root(-below[0], error), _root(above[0], error)
    others = free.copy()
    others[number] = False
    direction = _direction(problem, levels, fit, free, number)
    sides = []
    bounds = (-1.0, problem.lower[number]), (1.0, problem.upper[number])
    for root, (sign, bound) in zip(roots, bounds, strict=True):
        walk = _Walk(problem, levels, fit, others, number, direction, float(bound), sign)
        sides.append(_walk(walk, root, error))
    middle = (float(fit.point.logs[number]), 0.0)
    seen = sorted({*sides[0].seen, middle, *sides[1].seen})
    logs, heights = np.array(seen).T
    return Trace(
        logs,
        heights**2,
        sides[0].end,
        sides[1].end,
        sides[0].is_open,
        sides[1].is_open,
        roots[0] ** 2,
        roots[1] ** 2,
    )


def _root(quantile: float, error: float) -> float:
    """Quantile in standard errors; a parameter that nothing bounds is held at a normal one."""
    return max(float(quantile) / error, _LEAST_ROOT) if error > 0.0 else _NORMAL


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
    bracket, near = _Bracket((0.0, 0.0), None, 0), walk.fit
    seen: list[tuple[float, float]] = []
    distance = min(root * error, room) if error > 0.0 else room
    for _ in range(_MOST_LOOKS):
        height, found = walk.look(near, distance)
        seen.append((distance, height))
        if abs(height - root) <= _CLOSE * root:
            break
        if height < root:
            near = found
            if distance >= room:
                return _Side(walk.bound, is_open=True, seen=_places(walk, seen))
        bracket = bracket.narrowed(distance, height, root)
        distance = bracket.next_look(root, room)
    else:  # rather too far out than too near
        distance = bracket.high[0] if bracket.high else room
    end = float(walk.fit.point.logs[walk.number]) + walk.sign * distance
    return _Side(end, is_open=bracket.high is None and distance >= room, seen=_places(walk, seen))


@dataclass(frozen=True, slots=True)
class _Bracket:
    """Distances and heights inside and outside the end, and how often one side stayed."""

    low: tuple[float, float]
    high: tuple[float, float] | None
    stays: int

    def narrowed(self, distance: float, height: float, root: float) -> _Bracket:
        if height < root:
            return _Bracket((distance, height), self.high, max(self.stays, 0) + 1)
        return _Bracket(self.low, (distance, height), min(self.stays, 0) - 1)

    def next_look(self, root: float, room: float) -> float:
        """Outwards at most a few times as far; inside by a straight line, or by halves.

        Halves where the line has come to the same side twice: the deviance is then no parabola.
        """
        near, height = self.low
        if self.high is None:
            ahead = near * root / height if height > 0.0 else np.inf
            return min(max(ahead, 1.1 * near), _FARTHER * near, room)
        if abs(self.stays) > 2:
            return 0.5 * (near + self.high[0])
        share = (root - height) / (self.high[1] - height)
        return near + min(max(share, 0.02), 0.98) * (self.high[0] - near)


def _places(walk: _Walk, seen: list[tuple[float, float]]) -> tuple[tuple[float, float], ...]:
    best = float(walk.fit.point.logs[walk.number])
    return tuple((best + walk.sign * distance, height) for distance, height in seen)
