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

from dataclasses import dataclass

import numpy as np

from labpipe.mechanics.wire.calibration import objective
from labpipe.mechanics.wire.calibration.local_minima import LocalMinimum, Minima
from labpipe.mechanics.wire.calibration.objective import Fit, P
from labpipe.mechanics.wire.calibration.search import move, search
from labpipe.mechanics.wire.calibration.variances import compute_quantiles
from labpipe.records.arrays import Floats


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
    """One side of a profile: its end, and all places and roots of the deviance on the way."""

    end: float
    is_open: bool
    points: tuple[tuple[float, float], ...] = ()


def follow_profiles(minima: Minima, number: int, *, unlikely: float = 1.0) -> tuple[Trace, ...]:
    """Follow the objective from each of its minima within the interval of a parameter.

    Parameters
    ----------
    minima : of a calibration
    number : of the parameter
    unlikely : height up to which the objective is followed, over that of the 95 % set
    """
    return tuple(
        follow_profile(minima, number, minimum, unlikely=unlikely)
        for minimum in minima.all
        if minimum.rise < unlikely * compute_limit(minima, minimum)
    )


def unite_intervals(parts: tuple[Trace, ...]) -> tuple[tuple[float, float], ...]:
    """Return the ends of the union of several traces, in logarithms, rising."""
    joined: list[tuple[float, float]] = []
    for lower, upper in sorted((part.lower, part.upper) for part in parts):
        if joined and lower <= joined[-1][1]:
            joined[-1] = (joined[-1][0], max(joined[-1][1], upper))
        else:
            joined.append((lower, upper))
    return tuple(joined)


def compute_limit(minima: Minima, minimum: LocalMinimum) -> float:
    """Return the rise of the objective below which a minimum is in the 95 % set.

    Parameters
    ----------
    minima : of a calibration
    minimum : one of them

    Notes
    -----
    Square of the quantile, in standard errors, of the combination of parameters that leads there
    from the lowest minimum. The shape of the curves selects the minimum, so that this is the
    quantile of many points even where the level depends on few samples.
    """
    best_point, other_point = minima.fit.point, minimum.fit.point
    difference = np.append(other_point.logs - best_point.logs, other_point.gain - best_point.gain)
    return float(_limits(minima, difference[None, :])[0])


def find_reach(minima: Minima, number: int, unlikely: float) -> tuple[float, float]:
    """Return the range of a parameter on the line of minima, in logarithms.

    Parameters
    ----------
    minima : of a calibration
    number : of the parameter
    unlikely : height up to which the line is followed, over that of the 95 % set
    """
    best_point = minima.fit.point
    ways = minima.place - np.append(best_point.logs, best_point.gain)
    height = np.sqrt(minima.rise / np.maximum(_limits(minima, ways), 1e-30) / unlikely)
    values, inside = minima.place[:, number], height <= 1.0
    ends = [values[inside]]
    for low, high in ((slice(None, -1), slice(1, None)), (slice(1, None), slice(None, -1))):
        leaves = inside[low] & ~inside[high]
        near, far = height[low][leaves], height[high][leaves]
        share = (1.0 - near) / (far - near)
        ends.append(values[low][leaves] + share * (values[high] - values[low])[leaves])
    reached = np.concatenate(ends)
    return float(reached.min()), float(reached.max())


def _limits(minima: Minima, ways: Floats) -> Floats:
    """Return the squared quantiles of combinations of parameters and gain, in standard errors."""
    error = np.sqrt(np.einsum("ni,ij,nj->n", ways, minima.lowest.spread.covariance, ways))
    below, above = compute_quantiles(minima.lowest.mixture, ways)
    roots = [
        _min_quantile(float(end), float(one))
        for end, one in zip(np.maximum(-below, above), error, strict=True)
    ]
    return np.asarray((minima.widening * np.array(roots)) ** 2)


def follow_profile(
    minima: Minima, number: int, minimum: LocalMinimum, *, unlikely: float = 1.0
) -> Trace:
    """Follow the objective to both sides of a minimum, with all other unknowns fitted.

    Parameters
    ----------
    minima : of a calibration
    number : of the parameter
    minimum : start; its rise counts towards the height
    unlikely : as for `follow_profiles`
    """
    fit, place = minimum.fit, float(minimum.fit.point.logs[number])
    error = float(np.sqrt(minimum.spread.covariance[number, number]))
    below, above = compute_quantiles(minimum.mixture, np.eye(P + 1)[[number]])
    taken = minimum.rise / compute_limit(minima, minimum) if minimum.rise > 0.0 else 0.0
    wide = minima.widening * float(np.sqrt(unlikely - taken))
    roots = [wide * _min_quantile(end, error) for end in (-below[0], above[0])]
    direction = _direction(fit, number)
    low, high = (
        _find_end(_Walk(fit, number, direction, sign, root), error)
        for sign, root in zip((-1.0, 1.0), roots, strict=True)
    )
    points = {(place, 0.0)}
    for side in (low, high):
        points |= set(side.points if len(minima.all) == 1 else _uphill(place, side))
    logs, heights = np.array(sorted(points)).T
    return Trace(
        *(logs, heights**2 + minimum.rise, low.end, high.end, low.is_open, high.is_open),
        *(root**2 + minimum.rise for root in roots),
    )


def _uphill(start: float, side: _Side) -> list[tuple[float, float]]:
    """Return the points up to the first hill; another minimum behind it is followed separately."""
    points: list[tuple[float, float]] = []
    for place, height in sorted(side.points, key=lambda point: abs(point[0] - start)):
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


def _direction(fit: Fit, number: int) -> Floats:
    """Return how all unknowns move with one parameter while the objective is a parabola."""
    matrix, _, moves = objective.make_normal_equations(fit)
    moves[number] = False
    direction = np.zeros(len(matrix))
    direction[number] = 1.0
    if moves.any():
        unit, scale = objective.scale_matrix(matrix[np.ix_(moves, moves)])
        direction[moves] = -np.linalg.solve(unit, matrix[moves, number] / scale) / scale
    return direction


@dataclass(frozen=True, slots=True, eq=False)
class _Walk:
    """A walk from a minimum to one side, up to a root of the deviance."""

    fit: Fit
    number: int
    direction: Floats
    sign: float
    root: float

    def evaluate(self, start: Fit, distance: float) -> tuple[float, Fit]:
        """Return the root of the deviance at a distance from the minimum, from a near fit."""
        max_threshold_factor = 3.0  # above it the straight way may have led into a dead end
        objective_tolerance = 1e-3
        held = self.fit.problem.hold(self.number)
        target = float(self.fit.point.logs[self.number]) + self.sign * distance
        shift = (target - float(start.point.logs[self.number])) * self.direction
        fits: list[Fit] = []
        for step in (shift, 0.0 * shift):
            point = move(start, step)
            point.logs[self.number] = target
            fits.append(search(held, self.fit.levels, point, enough=objective_tolerance))
            best = min(fits, key=lambda fit: fit.objective)
            rise = best.objective - self.fit.objective
            if rise <= max_threshold_factor * self.root**2:
                break
        return float(np.sqrt(max(rise, 0.0))), best


def _find_end(walk: _Walk, error: float) -> _Side:
    """Find where the root of the deviance passes that of the walk, outwards first, then between."""
    root_tolerance = 0.01  # of the root of the threshold
    max_evaluations = 24
    problem, root = walk.fit.problem, walk.root
    start = float(walk.fit.point.logs[walk.number])
    bound = float((problem.lower if walk.sign < 0.0 else problem.upper)[walk.number])
    room = walk.sign * (bound - start)
    if room <= 0.0:
        return _Side(bound, is_open=True)
    low, start_fit, stays = (0.0, 0.0), walk.fit, 0
    high: tuple[float, float] | None = None
    points: list[tuple[float, float]] = []
    distance = min(root * error, room) if error > 0.0 else room
    for _ in range(max_evaluations):
        height, fit = walk.evaluate(start_fit, distance)
        points.append((start + walk.sign * distance, height))
        if abs(height - root) <= root_tolerance * root:
            break
        if height >= root:
            high, stays = (distance, height), min(stays, 0) - 1
        elif distance >= room:
            return _Side(bound, is_open=True, points=tuple(points))
        else:
            start_fit, low, stays = fit, (distance, height), max(stays, 0) + 1
        distance = _next_distance(low, high, stays, root, room)
    else:  # conservative
        distance = high[0] if high else room
    is_open = high is None and distance >= room
    return _Side(start + walk.sign * distance, is_open, tuple(points))


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
