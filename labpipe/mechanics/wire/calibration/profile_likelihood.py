"""Profile likelihood: the interval of values of a parameter with a small enough rise of the fit.

The limit is q^2, instead of 1.96^2 for chi^2: q is the 97.5 % quantile, over the standard error, of
the parameter's distribution in the linear model, averaged over the possible scatter of samples
(`variances`); below and above it may differ. With many samples q is 1.96; for a parameter
that depends on the mean of n samples it is that of Student's t with n - 1 degrees of freedom. In
the linear case this is the t interval; where the objective is asymmetric the interval is too, and
it stays open where the objective levels out. For a nonlinear family of curves q is larger
(`local_minima`). Where the objective has several minima, each is followed separately, its height
above the lowest counts, and the interval is the union.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from labpipe.mechanics.wire.calibration.fit import CalibrationFit
from labpipe.mechanics.wire.calibration.local_minima import LocalMinimum
from labpipe.mechanics.wire.calibration.objective import (
    Fit,
    Levels,
    P,
    Point,
    Problem,
    make_normal_matrix,
    scale_matrix,
)
from labpipe.mechanics.wire.calibration.search import search
from labpipe.mechanics.wire.calibration.variances import compute_quantiles
from labpipe.records.arrays import Flags, Floats


@dataclass(frozen=True, slots=True, eq=False)
class Trace:
    """A profile in logarithms: points in order, and its ends.

    Parameters
    ----------
    logs, deviance : shape (n,), increasing logs, rise of the objective over its minimum
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


def follow_profiles(
    result: CalibrationFit, number: int, *, unlikely: float = 1.0
) -> tuple[Trace, ...]:
    """Follow the objective from each of its minima within the interval of a parameter.

    Parameters
    ----------
    result : the fit of a calibration
    number : of the parameter
    unlikely : height up to which the objective is followed, over that of the 95 % set
    """
    limits = (
        (minimum, unlikely * compute_limit(result, minimum)) for minimum in result.local_minima
    )
    allowed = (minimum for minimum, limit in limits if minimum.rise < limit)
    return tuple(follow_profile(result, number, minimum, unlikely=unlikely) for minimum in allowed)


def unite_intervals(parts: tuple[Trace, ...]) -> tuple[tuple[float, float], ...]:
    """Return the ends of the union of several traces, in logarithms, rising."""
    joined: list[tuple[float, float]] = []
    for lower, upper in sorted((part.lower, part.upper) for part in parts):
        if joined and lower <= joined[-1][1]:
            joined[-1] = (joined[-1][0], max(joined[-1][1], upper))
        else:
            joined.append((lower, upper))
    return tuple(joined)


def compute_limit(result: CalibrationFit, minimum: LocalMinimum) -> float:
    """Return the rise of the objective below which a minimum is in the 95 % set.

    Parameters
    ----------
    result : the fit of a calibration
    minimum : one of its minima

    Notes
    -----
    Square of the quantile, in standard errors, of the combination of parameters that leads there
    from the lowest minimum. The shape of the curves selects the minimum, so that this is the
    quantile of many points even where the level depends on few samples.
    """
    best_point, other_point = result.fit.point, minimum.fit.point
    difference = np.append(other_point.logs - best_point.logs, other_point.gain - best_point.gain)
    return float(_limits(result, difference[None, :])[0])


def find_reach(result: CalibrationFit, number: int, unlikely: float) -> tuple[float, float]:
    """Return the range of a parameter on the line of minima, in logarithms.

    Parameters
    ----------
    result : the fit of a calibration
    number : of the parameter
    unlikely : height up to which the line is followed, over that of the 95 % set
    """
    best_point = result.fit.point
    ways = result.line.place - np.append(best_point.logs, best_point.gain)
    height = np.sqrt(result.line.rise / np.maximum(_limits(result, ways), 1e-30) / unlikely)
    values, inside = result.line.place[:, number], height <= 1.0
    ends = [values[inside]]
    for low, high in ((slice(None, -1), slice(1, None)), (slice(1, None), slice(None, -1))):
        leaves = inside[low] & ~inside[high]
        near, far = height[low][leaves], height[high][leaves]
        share = (1.0 - near) / (far - near)
        ends.append(values[low][leaves] + share * (values[high] - values[low])[leaves])
    reached = np.concatenate(ends)
    return float(reached.min()), float(reached.max())


def _limits(result: CalibrationFit, ways: Floats) -> Floats:
    """Return the squared quantiles of combinations of parameters and gain, in standard errors."""
    lowest = result.local_minima[0]
    error = np.sqrt(np.einsum("ni,ij,nj->n", ways, lowest.spread.covariance, ways))
    below, above = compute_quantiles(lowest.mixture, ways)
    roots = [
        _min_quantile(float(end), float(one))
        for end, one in zip(np.maximum(-below, above), error, strict=True)
    ]
    return np.asarray((result.widening * np.array(roots)) ** 2)


def follow_profile(
    result: CalibrationFit, number: int, minimum: LocalMinimum, *, unlikely: float = 1.0
) -> Trace:
    """Follow the objective to both sides of a minimum, with all other unknowns fitted.

    Parameters
    ----------
    result : the fit of a calibration
    number : of the parameter
    minimum : start; its rise counts towards the height
    unlikely : as for `follow_profiles`
    """
    problem, levels, fit, free = (result.problem, result.levels, minimum.fit, result.free)
    error = float(np.sqrt(minimum.spread.covariance[number, number]))
    below, above = compute_quantiles(minimum.mixture, np.eye(P + 1)[[number]])
    taken = minimum.rise / compute_limit(result, minimum) if minimum.rise > 0.0 else 0.0
    wide = result.widening * float(np.sqrt(unlikely - taken))
    roots = [wide * _min_quantile(end, error) for end in (-below[0], above[0])]
    other_parameters = free.copy()
    other_parameters[number] = False
    direction = _direction(problem, levels, fit, free, number)
    sides = []
    bounds = (-1.0, problem.lower[number]), (1.0, problem.upper[number])
    for root, (sign, bound) in zip(roots, bounds, strict=True):
        walk = _Profile(
            problem,
            levels,
            fit,
            other_parameters,
            number,
            direction,
            float(bound),
            sign,
            root * root,
        )
        sides.append(_find_end(walk, root, error))
    middle = (float(fit.point.logs[number]), 0.0)
    has_one_minimum = len(result.local_minima) == 1
    profile_points = sorted(
        {middle, *(p for side in sides for p in (side.seen if has_one_minimum else _uphill(side)))}
    )
    logs, heights = np.array(profile_points).T
    return Trace(
        logs,
        heights**2 + minimum.rise,
        sides[0].end,
        sides[1].end,
        sides[0].is_open,
        sides[1].is_open,
        roots[0] ** 2 + minimum.rise,
        roots[1] ** 2 + minimum.rise,
    )


def _uphill(side: _Side) -> list[tuple[float, float]]:
    """Return the points up to the first hill; another minimum behind it is followed separately."""
    points: list[tuple[float, float]] = []
    for place, height in sorted(side.seen, key=lambda point: abs(point[0] - side.start)):
        if points and height < points[-1][1]:
            break
        points.append((place, height))
    return points


def _min_quantile(quantile: float, error: float) -> float:
    """Return the quantile in standard errors, at least the normal one.

    Unknown levels widen it. Where a parameter has no effect, as an insulation without stiffness,
    the linear model fails, and its quantile is arbitrary.
    """
    min_quantile = 1.96
    return max(float(quantile) / error, min_quantile) if error > 0.0 else min_quantile


def _direction(problem: Problem, levels: Levels, fit: Fit, free: Flags, number: int) -> Floats:
    """Return how all unknowns move with one parameter while the objective is a parabola."""
    matrix, moves = make_normal_matrix(problem, levels, fit, free)
    moves = moves.copy()
    moves[number] = False
    direction = np.zeros(len(matrix))
    direction[number] = 1.0
    if moves.any():
        unit, scale = scale_matrix(matrix[np.ix_(moves, moves)])
        direction[moves] = -np.linalg.solve(unit, matrix[moves, number] / scale) / scale
    return direction


@dataclass(frozen=True, slots=True, eq=False)
class _Profile:
    problem: Problem
    levels: Levels
    fit: Fit
    others: Flags
    number: int
    direction: Floats
    bound: float
    sign: float
    limit: float

    def evaluate(self, start: Fit, distance: float) -> tuple[float, Fit]:
        """Return the root of the deviance at a distance from the minimum, from a near fit."""
        max_threshold_factor = 3.0  # above it the straight way may have led into a dead end
        objective_tolerance = 1e-3
        target = float(self.fit.point.logs[self.number]) + self.sign * distance
        shift = (target - float(start.point.logs[self.number])) * self.direction
        fits: list[Fit] = []
        for move in (shift, 0.0 * shift):
            there = self._moved(start, move, target)
            fits.append(
                search(self.problem, self.levels, there, self.others, enough=objective_tolerance)
            )
            best = min(fits, key=lambda fit: fit.objective)
            rise = best.objective - self.fit.objective
            if rise <= max_threshold_factor * self.limit:
                break
        return float(np.sqrt(max(rise, 0.0))), best

    def _moved(self, start: Fit, move: Floats, target: float) -> Point:
        point, size = start.point, len(start.point.logs)
        logs = np.clip(point.logs + move[:size], self.problem.lower, self.problem.upper)
        logs[self.number] = target
        offsets = point.offsets + move[size + 1 :]
        return replace(point, logs=logs, gain=point.gain + float(move[size]), offsets=offsets)


def _find_end(walk: _Profile, root: float, error: float) -> _Side:
    """Find where the root of the deviance passes a value, outwards first, then between."""
    root_tolerance = 0.01  # of the root of the threshold
    max_evaluations = 24
    start = float(walk.fit.point.logs[walk.number])
    room = walk.sign * (walk.bound - start)
    if room <= 0.0:
        return _Side(walk.bound, walk.bound, is_open=True, seen=())
    low, start_fit, stays = (0.0, 0.0), walk.fit, 0
    high: tuple[float, float] | None = None
    profile_points: list[tuple[float, float]] = []
    distance = min(root * error, room) if error > 0.0 else room
    for _ in range(max_evaluations):
        height, fit = walk.evaluate(start_fit, distance)
        profile_points.append((start + walk.sign * distance, height))
        if abs(height - root) <= root_tolerance * root:
            break
        if height >= root:
            high, stays = (distance, height), min(stays, 0) - 1
        elif distance >= room:
            return _Side(start, walk.bound, is_open=True, seen=tuple(profile_points))
        else:
            start_fit, low, stays = fit, (distance, height), max(stays, 0) + 1
        distance = _next_distance(low, high, stays, root, room)
    else:  # conservative
        distance = high[0] if high else room
    end, is_open = start + walk.sign * distance, high is None and distance >= room
    return _Side(start, end, is_open=is_open, seen=tuple(profile_points))


def _next_distance(
    low: tuple[float, float],
    high: tuple[float, float] | None,
    stays: int,
    root: float,
    room: float,
) -> float:
    """Return the next distance: a limited extrapolation, then false position or bisection.

    `low` and `high` are distances and heights inside and outside the end. Bisection where one side
    was kept twice (`stays`): the deviance is then no parabola.
    """
    max_growth = 2.5  # of the distance, per step
    low_distance, height = low
    if high is None:
        ahead = low_distance * root / height if height > 0.0 else np.inf
        return min(max(ahead, 1.1 * low_distance), max_growth * low_distance, room)
    if abs(stays) > 2:
        return 0.5 * (low_distance + high[0])
    share = (root - height) / (high[1] - height)
    return low_distance + min(max(share, 0.02), 0.98) * (high[0] - low_distance)
