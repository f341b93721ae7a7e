"""Profile likelihood: the interval is where holding a parameter makes the fit too much worse.

Too much is q^2, where chi^2 would have 1.96^2: q is the 97.5 % quantile, over the standard error,
of the parameter's distribution in the linear model, averaged over what the scatter of samples may
be (`scatter_mixture`); below and above it may differ. With many samples q is 1.96, for one
that leans on the mean of n samples it is that of Student's t with n - 1 degrees of freedom. In the
linear case this is the t interval; where the objective is asymmetric the interval is too, and it
stays open where the objective levels out. Where the family of curves is bent, q is larger
(`bent_family`). Where the objective has several leasts, each is followed
by itself, its height above the lowest counts, and the interval is the union of what they allow.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labpipe.records.arrays import Flags, Floats
from labpipe.wire.calibration.fit import CalibrationFit
from labpipe.wire.calibration.local_minima import LocalMinimum
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


@dataclass(frozen=True, slots=True, eq=False)
class Trace:
    """A profile in logarithms: points in order, and its ends.

    Parameters
    ----------
    logs, deviance : shape (n,), increasing logs, rise of the objective over its least of all
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
    start: float
    end: float
    is_open: bool
    seen: tuple[tuple[float, float], ...]


def traces(found: CalibrationFit, number: int, *, unlikely: float = 1.0) -> tuple[Trace, ...]:
    """Follow the objective from each of its leasts that the interval of a parameter takes in.

    Parameters
    ----------
    found : the fit of a calibration
    number : of the parameter
    unlikely : how high the objective is followed, over the height of the 95 % set
    """
    known = ((valley, unlikely * limit_of(found, valley)) for valley in found.valleys)
    allowed = (valley for valley, limit in known if valley.rise < limit)
    return tuple(trace(found, number, valley, unlikely=unlikely) for valley in allowed)


def union(parts: tuple[Trace, ...]) -> tuple[tuple[float, float], ...]:
    """Ends of the parts that several traces make together, in logarithms, rising."""
    joined: list[tuple[float, float]] = []
    for lower, upper in sorted((part.lower, part.upper) for part in parts):
        if joined and lower <= joined[-1][1]:
            joined[-1] = (joined[-1][0], max(joined[-1][1], upper))
        else:
            joined.append((lower, upper))
    return tuple(joined)


def limit_of(found: CalibrationFit, valley: LocalMinimum) -> float:
    """Rise of the objective below which a least is in the 95 % set.

    Parameters
    ----------
    found : the fit of a calibration
    valley : one of its leasts

    Notes
    -----
    Square of the quantile, in standard errors, of the combination of parameters that leads there
    from the lowest least. Which valley it is the shape of the curves says, so that this is that of
    many points even where the level rests on few samples.
    """
    here, there = found.fit.point, valley.fit.point
    way = np.append(there.logs - here.logs, there.gain - here.gain)
    return float(_limits(found, way[None, :])[0])


def reach(found: CalibrationFit, number: int, unlikely: float) -> tuple[float, float]:
    """Least and greatest value of a parameter on the line of the leasts, in logarithms.

    Parameters
    ----------
    found : the fit of a calibration
    number : of the parameter
    unlikely : up to which height the line is looked at, over that of the 95 % set
    """
    here = found.fit.point
    ways = found.line.place - np.append(here.logs, here.gain)
    height = np.sqrt(found.line.rise / np.maximum(_limits(found, ways), 1e-30) / unlikely)
    values, inside = found.line.place[:, number], height <= 1.0
    ends = [values[inside]]
    for low, high in ((slice(None, -1), slice(1, None)), (slice(1, None), slice(None, -1))):
        leaves = inside[low] & ~inside[high]
        near, far = height[low][leaves], height[high][leaves]
        share = (1.0 - near) / (far - near)
        ends.append(values[low][leaves] + share * (values[high] - values[low])[leaves])
    reached = np.concatenate(ends)
    return float(reached.min()), float(reached.max())


def _limits(found: CalibrationFit, ways: Floats) -> Floats:
    """Squares of the quantiles of combinations of parameters and gain, in standard errors."""
    lowest = found.valleys[0]
    error = np.sqrt(np.einsum("ni,ij,nj->n", ways, lowest.spread.covariance, ways))
    below, above = quantiles(lowest.mixture, ways)
    roots = [
        _root(float(end), float(one))
        for end, one in zip(np.maximum(-below, above), error, strict=True)
    ]
    return np.asarray((found.widening * np.array(roots)) ** 2)


def trace(
    found: CalibrationFit, number: int, valley: LocalMinimum, *, unlikely: float = 1.0
) -> Trace:
    """Follow the objective to both sides of a least, all other unknowns fitted anew.

    Parameters
    ----------
    found : the fit of a calibration
    number : of the parameter
    valley : from where; it is followed as much less high as its rise is of what is allowed
    unlikely : as for `traces`
    """
    problem, levels, fit, free = found.problem, found.levels, valley.fit, found.free
    error = float(np.sqrt(valley.spread.covariance[number, number]))
    below, above = quantiles(valley.mixture, np.eye(P + 1)[[number]])
    taken = valley.rise / limit_of(found, valley) if valley.rise > 0.0 else 0.0
    wide = found.widening * float(np.sqrt(unlikely - taken))
    roots = [wide * _root(end, error) for end in (-below[0], above[0])]
    others = free.copy()
    others[number] = False
    direction = _direction(problem, levels, fit, free, number)
    sides = []
    bounds = (-1.0, problem.lower[number]), (1.0, problem.upper[number])
    for root, (sign, bound) in zip(roots, bounds, strict=True):
        walk = _Walk(
            problem, levels, fit, others, number, direction, float(bound), sign, root * root
        )
        sides.append(_walk(walk, root, error))
    middle = (float(fit.point.logs[number]), 0.0)
    one = len(found.valleys) == 1
    seen = sorted({middle, *(p for side in sides for p in (side.seen if one else _uphill(side)))})
    logs, heights = np.array(seen).T
    return Trace(
        logs,
        heights**2 + valley.rise,
        sides[0].end,
        sides[1].end,
        sides[0].is_open,
        sides[1].is_open,
        roots[0] ** 2 + valley.rise,
        roots[1] ** 2 + valley.rise,
    )


def _uphill(side: _Side) -> list[tuple[float, float]]:
    """Points up to the first hill: behind it lies another valley, which is followed by itself."""
    kept: list[tuple[float, float]] = []
    for place, height in sorted(side.seen, key=lambda point: abs(point[0] - side.start)):
        if kept and height < kept[-1][1]:
            break
        kept.append((place, height))
    return kept


def _root(quantile: float, error: float) -> float:
    """Quantile in standard errors, at least the normal one.

    Not to know the levels widens. Where a parameter has lost its effect, as an insulation without
    stiffness, the linear model is none, and its quantile may be anything on either side.
    """
    min_quantile = 1.96
    return max(float(quantile) / error, min_quantile) if error > 0.0 else min_quantile


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
    limit: float

    def look(self, start: Fit, distance: float) -> tuple[float, Fit]:
        """Root of the deviance at a distance from the least, from a fit near by."""
        max_threshold_factor = 3.0  # above it the straight way may have led into a dead end
        best = float(self.fit.point.logs[self.number])
        target = best + self.sign * distance
        shift = (target - float(start.point.logs[self.number])) * self.direction
        found = self._search(_shifted(self, start, shift, target))
        if found.objective - self.fit.objective > max_threshold_factor * self.limit:
            plain = self._search(_shifted(self, start, 0.0 * shift, target))
            found = min(found, plain, key=lambda fit: fit.objective)
        return float(np.sqrt(max(found.objective - self.fit.objective, 0.0))), found

    def _search(self, there: Point) -> Fit:
        objective_tolerance = 1e-3
        return search(self.problem, self.levels, there, self.others, enough=objective_tolerance)


def _shifted(walk: _Walk, start: Fit, shift: Floats, target: float) -> Point:
    size = len(start.point.logs)
    logs = np.clip(start.point.logs + shift[:size], walk.problem.lower, walk.problem.upper)
    logs[walk.number] = target
    offsets = start.point.offsets + shift[size + 1 :]
    return Point(logs, start.point.gain + float(shift[size]), offsets)


def _walk(walk: _Walk, root: float, error: float) -> _Side:
    """Find where the root of the deviance passes a value, going outwards and then in between."""
    root_tolerance = 0.01  # of the root of the threshold
    max_evaluations = 24
    room = walk.sign * (walk.bound - float(walk.fit.point.logs[walk.number]))
    if room <= 0.0:
        return _Side(walk.bound, walk.bound, is_open=True, seen=())
    start = float(walk.fit.point.logs[walk.number])
    bracket, near = _Bracket((0.0, 0.0), None, 0), walk.fit
    seen: list[tuple[float, float]] = []
    distance = min(root * error, room) if error > 0.0 else room
    for _ in range(max_evaluations):
        height, found = walk.look(near, distance)
        seen.append((distance, height))
        if abs(height - root) <= root_tolerance * root:
            break
        if height < root:
            near = found
            if distance >= room:
                return _Side(start, walk.bound, is_open=True, seen=_places(walk, seen))
        bracket = bracket.narrowed(distance, height, root)
        distance = bracket.next_look(root, room)
    else:  # rather too far out than too near
        distance = bracket.high[0] if bracket.high else room
    end, is_open = start + walk.sign * distance, bracket.high is None and distance >= room
    return _Side(start, end, is_open=is_open, seen=_places(walk, seen))


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
        max_growth = 2.5  # of the distance, per step
        near, height = self.low
        if self.high is None:
            ahead = near * root / height if height > 0.0 else np.inf
            return min(max(ahead, 1.1 * near), max_growth * near, room)
        if abs(self.stays) > 2:
            return 0.5 * (near + self.high[0])
        share = (root - height) / (self.high[1] - height)
        return near + min(max(share, 0.02), 0.98) * (self.high[0] - near)


def _places(walk: _Walk, seen: list[tuple[float, float]]) -> tuple[tuple[float, float], ...]:
    best = float(walk.fit.point.logs[walk.number])
    return tuple((best + walk.sign * distance, height) for distance, height in seen)
