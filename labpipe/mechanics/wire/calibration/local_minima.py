"""All solutions of a calibration: the local minima of the objective, and profiles from each.

A wire of hard copper with little insulation can look like one of soft copper with much of it, so
that the objective has two or more local minima, between which noise decides. All of them lie along
one line, on which the copper's strength is fixed and all else fitted. It is followed from bound to
bound, and a search starts from each of its low points.

The profile likelihood gives the interval of a parameter: the values with a small enough rise of
the fit. The limit is q^2, instead of 1.96^2 for chi^2: q is the 97.5 % quantile, over the standard
error, of the parameter's distribution in the linear model, averaged over the possible scatter of
samples (`variances`); below and above it may differ. With many samples q is 1.96; for a parameter
that depends on the mean of n samples it is that of Student's t with n - 1 degrees of freedom. In
the linear case this is the t interval; where the objective is asymmetric the interval is too, and
it stays open where the objective levels out. Where the objective has several minima, each is
followed separately, its height above the lowest counts, and the interval is the union.

For a nonlinear family of curves q is larger. A profile ends where the objective has risen by q^2,
with q = 1.96 if the curves of the model lie on a straight line in the space of the data, seen from
the truth. Where insulation and copper trade off, they lie on a curved line, which returns if there
are two valleys, and among its many directions noise finds one that fits too well. By Hotelling's
tube (Am. J. Math. 61 (1939) 440; Knowles and Siegmund, Int. Stat. Rev. 57 (1989) 205), the
probability that the objective rises by more than q^2 from its minimum to the truth is

    2 (1 - Phi(q)) + angle / (2 pi) exp(-q^2 / 2),

with the angle that the direction from the truth to the curves sweeps on both sides of it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtr

from labpipe.mechanics.wire.calibration import objective, variances
from labpipe.mechanics.wire.calibration.objective import Fit, Levels, P, Problem, move, search
from labpipe.records.arrays import Floats
from labpipe.records.curve import NORMAL_95
from labpipe.records.wire import (
    COPPER_SCALE,
    INSULATION_MODULUS,
    PARAMETERS,
    ScatterMixture,
)

_TUBE, _COPPER = PARAMETERS.index(INSULATION_MODULUS), PARAMETERS.index(COPPER_SCALE)
_STRIDE = 0.3
"""Spacing of points on the line, in logarithms of the copper's strength."""
_SAME_PLACE = 0.1 * _STRIDE
"""Distance below which points are one."""
_MAX_RISE = 200.0
"""Of the objective over the lowest minimum: no quantile of so few samples is as large."""


@dataclass(frozen=True, slots=True, eq=False)
class LocalMinimum:
    """A local minimum of the objective.

    Parameters
    ----------
    fit : at the minimum
    rise : of the objective over that of the lowest minimum
    spread : covariance, with its degrees of freedom
    mixture : covariance for each possible scatter
    """

    fit: Fit
    rise: float
    spread: variances.Uncertainty
    mixture: ScatterMixture


@dataclass(frozen=True, slots=True, eq=False)
class Minima:
    """All local minima of a calibration, and the line on which they lie.

    Parameters
    ----------
    all : the lowest first
    place : shape (n, 4), logarithms of the parameters and of the gain on the line through all
        minima, from bound to bound of the copper's strength
    rise : shape (n,), of the objective over its minimum, on the line
    widening : of quantiles, for that curved line
    """

    all: tuple[LocalMinimum, ...]
    place: Floats
    rise: Floats
    widening: float

    @property
    def lowest(self) -> LocalMinimum:
        """Return the best solution."""
        return self.all[0]

    @property
    def fit(self) -> Fit:
        """Return the fit at the best solution."""
        return self.all[0].fit


def find_minima(problem: Problem, logs: Floats) -> Minima:
    """Find all local minima, with the levels of the lowest.

    Parameters
    ----------
    problem : what is fitted
    logs : shape (3,), where the search starts

    Raises
    ------
    ValueError
        If the model cannot follow the curves at any start.
    """
    first_scatter = 0.05
    levels = Levels(1.0, 0.0, first_scatter if problem.scatter is None else problem.scatter)
    fit = refine(_search_first_fit(problem, levels, _yield_starts(problem, logs)))
    line = follow_line(fit)
    local_minima = find_local_minima(line, fit)
    lowest = min(local_minima, key=lambda minimum: minimum.objective)
    others = [minimum for minimum in local_minima if minimum is not lowest]
    fit = lowest if lowest is fit else refine(lowest)
    fits = [fit]
    for other in others:
        if other.objective - lowest.objective <= _MAX_RISE:
            fits += _search_again(fit, other)
    fits = _select_distinct(fits)
    best = fits[0]
    beside = [fit for fit in line if abs(_get_strength(fit) - _get_strength(best)) > _SAME_PLACE]
    line = sorted([*beside, best], key=_get_strength)
    rises = [0.0 if fit is best else max(fit.objective - lowest.objective, 0.0) for fit in line]
    estimated = []
    for fit in fits:
        rise = max(fit.objective - best.objective, 0.0)
        if rise <= _MAX_RISE:
            spread, mixture = variances.estimate_uncertainty(fit), variances.make_mixture(fit)
            estimated.append(LocalMinimum(fit, rise, spread, mixture))
    place = np.array([fit.unknowns[: P + 1] for fit in line])
    return Minima(tuple(estimated), place, np.array(rises), compute_widening(line, best))


def _select_distinct(fits: list[Fit]) -> list[Fit]:
    """Return distinct minima, the lowest first: two searches may end in one."""
    distinct: list[Fit] = []
    for fit in sorted(fits, key=lambda fit: fit.objective):
        if all(abs(_get_strength(fit) - _get_strength(other)) > _SAME_PLACE for other in distinct):
            distinct.append(fit)
    return distinct


def _search_again(fit: Fit, start: Fit) -> list[Fit]:
    """Search in the problem of a fit from another fit; nothing where the model cannot follow."""
    unknowns = _drop_offsets(start.unknowns, fit.levels)
    try:
        return [search(fit.problem, fit.levels, unknowns, near=start.models, lowest=fit.objective)]
    except ValueError:
        return []


def refine(fit: Fit) -> Fit:
    """Estimate the levels of a fit and search again until they converge."""
    max_rounds = 6
    level_tolerance = 0.01
    for _ in range(max_rounds):
        correlation = variances.estimate_correlation(fit)
        grams = objective.compute_products(fit, correlation)
        levels = variances.estimate_levels(replace(fit, grams=grams), correlation)
        changes = (
            fit.levels.correlation - levels.correlation,
            fit.levels.noise / levels.noise - 1.0,
            (fit.levels.scatter - levels.scatter) / max(levels.scatter, 1e-9),
        )
        start = _drop_offsets(fit.unknowns, levels)
        fit = search(fit.problem, levels, start, near=fit.models)
        if np.max(np.abs(changes)) <= level_tolerance:
            break
    return fit


def _search_first_fit(problem: Problem, levels: Levels, starts: Iterable[Floats]) -> Fit:
    """Return the fit from the first start that the model can follow."""
    reason = ""
    for logs in starts:
        try:
            return search(problem, levels, np.append(logs, np.zeros(1 + problem.n_samples)))
        except ValueError as error:
            reason = reason or str(error)
    message = f"the model cannot follow the curves at any of the starts; at the first: {reason}"
    raise ValueError(message)


def _drop_offsets(unknowns: Floats, levels: Levels) -> Floats:
    """Return the unknowns, without offsets where samples do not scatter."""
    is_offset = np.arange(len(unknowns)) > P
    return np.where(is_offset & (levels.scatter == 0.0), 0.0, unknowns)


def _has_trade_off(problem: Problem) -> bool:
    """Return whether insulation and copper are both free, so that one can replace the other."""
    return bool(problem.free[_TUBE] and problem.free[_COPPER])


def _yield_starts(problem: Problem, logs: Floats) -> Iterator[Floats]:
    """Yield the given start, then others in case the model cannot follow from there."""
    insulation_shares = (0.3, 0.8)  # of the load
    yield logs
    if not _has_trade_off(problem):
        return
    given = problem.law.nominal
    is_given = problem.free & (given > 0.0)
    nominal = np.where(is_given, np.log(np.where(given > 0.0, given, 1.0)), logs)
    models = objective.compute_model_forces(problem.law, np.exp(nominal), problem.curves)
    total = sum(float(np.abs(model.force).sum()) for model in models)
    of_tube = sum(float(np.abs(model.change[_TUBE]).sum()) for model in models)
    measured = sum(float(np.abs(curve.force).sum()) for curve in problem.curves)
    for share in insulation_shares:
        start = nominal.copy()
        start[_TUBE] += np.log(share * measured / of_tube)
        start[_COPPER] += np.log((1.0 - share) * measured / max(total - of_tube, 0.01 * total))
        yield np.clip(start, problem.lower, problem.upper)


def find_local_minima(line: list[Fit], fit: Fit) -> list[Fit]:
    """Find every local minimum of the objective.

    Parameters
    ----------
    line : fits with the copper's strength held
    fit : one minimum, on the line

    Returns
    -------
    In order of the copper's strength; of two without a hill between them, the lower.
    """
    min_hill = 1.0  # rise of the objective above the higher of two separate minima
    heights = np.pad([point.objective for point in line], 1, constant_values=np.inf)
    minima = [fit]
    for number, point in enumerate(line, start=1):
        if point is not fit and heights[number] <= min(heights[number - 1], heights[number + 1]):
            minima += _search_again(fit, point)
    distinct: list[Fit] = []
    for minimum in sorted(minima, key=_get_strength):
        if distinct and _compute_hill_height(line, distinct[-1], minimum) < min_hill:
            distinct[-1] = min(distinct[-1], minimum, key=lambda one: one.objective)
        else:
            distinct.append(minimum)
    return distinct


def _get_strength(fit: Fit) -> float:
    return float(fit.logs[_COPPER])


def _compute_hill_height(line: list[Fit], one: Fit, other: Fit) -> float:
    """Return how far the line rises above two minima between them."""
    heights = [
        fit.objective
        for fit in line
        if _get_strength(one) < _get_strength(fit) < _get_strength(other)
    ]
    return max(heights, default=-np.inf) - max(one.objective, other.objective)


def follow_line(fit: Fit) -> list[Fit]:
    """Follow the line on which insulation and copper trade off.

    Parameters
    ----------
    fit : a minimum of the objective

    Returns
    -------
    Fits with the copper's strength fixed at even steps, from bound to bound, with the minimum among
    them; the minimum alone unless insulation and copper are both free.
    """
    problem, strength = fit.problem, _get_strength(fit)
    if not _has_trade_off(problem):
        return [fit]
    sides = []
    for bound in (float(problem.lower[_COPPER]), float(problem.upper[_COPPER])):
        count = int(np.ceil(abs(bound - strength) / _STRIDE))
        sides.append(_follow_side(fit, np.linspace(strength, bound, count + 1)[1:]))
    return [*sides[0][::-1], fit, *sides[1]]


def _follow_side(fit: Fit, stops: Floats) -> list[Fit]:
    """Fit with the copper's strength at one stop after the other, started by extrapolation."""
    tolerance = 0.01
    fits, held = [fit, fit], fit.problem.hold(_COPPER)
    for stop in stops:
        before, last = fits[-2:]
        change = np.clip(last.logs - before.logs, -1.0, 1.0)
        start = move(last, np.pad(change, (0, len(last.unknowns) - P)))
        start[_COPPER] = stop
        near, lowest = last.models, fit.objective
        try:
            fits.append(search(held, fit.levels, start, near=near, enough=tolerance, lowest=lowest))
        except ValueError:
            break  # the model cannot follow the curves with such copper
    return fits[2:]


_ALARM_RATE = 0.05


def compute_widening(line: list[Fit], base: Fit) -> float:
    """Return the quantile of a curved family over that of a straight one, at least 1.

    Parameters
    ----------
    line : fits along the family, in order, the base among them
    base : the fit from which angles are measured
    """
    start = next(number for number, fit in enumerate(line) if fit is base)
    products = compute_differences(line, base)
    sides = range(start - 1, -1, -1), range(start + 1, len(line))
    angle = sum(_sum_angles(products, side) for side in sides)
    return compute_tube_quantile(angle) / NORMAL_95


def compute_tube_quantile(angle: float) -> float:
    """Return the root of the rise of the objective that is exceeded by chance in 5 % of all cases.

    Parameters
    ----------
    angle : rad, swept by the direction to the curves

    Examples
    --------
    >>> round(compute_tube_quantile(0.0), 2), round(compute_tube_quantile(np.pi), 2)
    (1.96, 2.35)
    """

    def excess(q: float) -> float:
        return float(2.0 * ndtr(-q) + angle / (2.0 * np.pi) * np.exp(-0.5 * q * q)) - _ALARM_RATE

    return float(brentq(excess, 1.9, 10.0))


def _sum_angles(products: Floats, side: range) -> float:
    """Return the angle, rad, swept by the direction to points, up to the first that is too far.

    The products are those of the points' differences from the base.
    """
    max_distance = 6.0  # standard deviations of noise: no curve fits better by chance beyond
    distance = np.sqrt(np.maximum(np.diag(products), 0.0))
    total = 0.0
    for near, far in pairwise(side):
        if distance[far] > max_distance or distance[near] == 0.0:
            break
        cosine = products[near, far] / (distance[near] * distance[far])
        total += float(np.arccos(np.clip(cosine, -1.0, 1.0)))
    return total


def compute_differences(line: list[Fit], base: Fit) -> Floats:
    """Return the Gram matrix of differences of all fits from one, in units of the noise."""
    problem, levels = base.problem, base.levels
    total = np.zeros((len(line), len(line)))
    for number, curve in enumerate(problem.curves):
        forces = [fit.factors[number] * fit.models[number].force for fit in line]
        columns = np.stack(forces, axis=1)
        columns -= (base.factors[number] * base.models[number].force)[:, None]
        total += objective.compute_whitened_products(
            curve, columns, base.models[number].slope, levels.correlation
        )
    precision = problem.find_precision(levels.scatter)
    weights = np.sqrt(np.where(np.isfinite(precision), precision, 0.0))
    rests = np.stack([weights * (fit.unknowns - base.unknowns) for fit in line], axis=1)
    return np.asarray(total / levels.noise + rests.T @ rests)


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


def follow_profiles(minima: Minima, number: int, *, unlikely: float = 1.0) -> tuple[Trace, ...]:
    """Follow the objective from each of its minima within the interval of a parameter.

    Parameters
    ----------
    minima : of a calibration
    number : of the parameter
    unlikely : height up to which the objective is followed, over that of the 95 % set
    """
    return tuple(
        _follow_profile(minima, number, minimum, unlikely)
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
    difference = minimum.fit.unknowns[: P + 1] - minima.fit.unknowns[: P + 1]
    return float(_compute_limits(minima, difference[None, :])[0])


def find_reach(minima: Minima, number: int, unlikely: float) -> tuple[float, float]:
    """Return the range of a parameter on the line of minima, in logarithms.

    Parameters
    ----------
    minima : of a calibration
    number : of the parameter
    unlikely : height up to which the line is followed, over that of the 95 % set
    """
    ways = minima.place - minima.fit.unknowns[: P + 1]
    height = np.sqrt(minima.rise / np.maximum(_compute_limits(minima, ways), 1e-30) / unlikely)
    values, inside = minima.place[:, number], height <= 1.0
    ends = [values[inside]]
    for low, high in ((slice(None, -1), slice(1, None)), (slice(1, None), slice(None, -1))):
        leaves = inside[low] & ~inside[high]
        near, far = height[low][leaves], height[high][leaves]
        share = (1.0 - near) / (far - near)
        ends.append(values[low][leaves] + share * (values[high] - values[low])[leaves])
    reached = np.concatenate(ends)
    return float(reached.min()), float(reached.max())


def _compute_limits(minima: Minima, ways: Floats) -> Floats:
    """Return the squared quantiles of combinations of parameters and gain, in standard errors."""
    error = np.sqrt(np.einsum("ni,ij,nj->n", ways, minima.lowest.spread.covariance, ways))
    below, above = variances.compute_quantiles(minima.lowest.mixture, ways)
    return np.asarray((minima.widening * _find_roots(np.maximum(-below, above), error)) ** 2)


def _find_roots(quantile: Floats, error: Floats) -> Floats:
    """Return quantiles in standard errors, at least the normal one.

    Unknown levels widen them. Where a parameter has no effect, as an insulation without stiffness,
    the linear model fails, and its quantile is arbitrary.
    """
    min_quantile = 1.96
    ratio = np.divide(quantile, error, out=np.zeros_like(quantile), where=error > 0.0)
    return np.asarray(np.maximum(ratio, min_quantile))


def _follow_profile(minima: Minima, number: int, minimum: LocalMinimum, unlikely: float) -> Trace:
    """Follow the objective to both sides of a minimum, with all other unknowns fitted."""
    fit, place = minimum.fit, float(minimum.fit.logs[number])
    error = float(np.sqrt(minimum.spread.covariance[number, number]))
    below, above = variances.compute_quantiles(minimum.mixture, np.eye(P + 1)[[number]])
    rise_share = minimum.rise / compute_limit(minima, minimum) if minimum.rise > 0.0 else 0.0
    wide = minima.widening * float(np.sqrt(unlikely - rise_share))
    roots = wide * _find_roots(np.append(-below, above), np.full(2, error))
    walk = _Walk(fit, number, _find_direction(fit, number))
    low, high = (
        _find_end(walk, sign, float(root), error)
        for sign, root in zip((-1.0, 1.0), roots, strict=True)
    )
    points = {(place, 0.0)}
    for side in (low, high):
        points |= set(side.points if len(minima.all) == 1 else _select_uphill(place, side))
    logs, heights = np.array(sorted(points)).T
    return Trace(
        *(logs, heights**2 + minimum.rise, low.end, high.end, low.is_open, high.is_open),
        *(float(root) ** 2 + minimum.rise for root in roots),
    )


@dataclass(frozen=True, slots=True)
class _Side:
    """One side of a profile: its end, and all places and roots of the deviance on the way."""

    end: float
    is_open: bool
    points: list[tuple[float, float]]


def _select_uphill(start: float, side: _Side) -> list[tuple[float, float]]:
    """Return the points up to the first hill; another minimum behind it is followed separately."""
    points: list[tuple[float, float]] = []
    for place, height in sorted(side.points, key=lambda point: abs(point[0] - start)):
        if points and height < points[-1][1]:
            break
        points.append((place, height))
    return points


def _find_direction(fit: Fit, number: int) -> Floats:
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
    """A walk from a minimum along one parameter; the direction is that of all unknowns."""

    fit: Fit
    number: int
    direction: Floats

    def evaluate(self, start: Fit, target: float, root: float) -> tuple[float, Fit]:
        """Return the root of the deviance at a value of the parameter, from a near fit."""
        max_threshold_factor = 3.0  # above it the straight way may have led into a dead end
        objective_tolerance = 1e-3
        held = self.fit.problem.hold(self.number)
        shift = (target - float(start.logs[self.number])) * self.direction
        fits: list[Fit] = []
        for step in (shift, 0.0 * shift):
            unknowns = move(start, step)
            unknowns[self.number] = target
            near, enough = start.models, objective_tolerance
            fits.append(search(held, self.fit.levels, unknowns, near=near, enough=enough))
            best = min(fits, key=lambda fit: fit.objective)
            rise = best.objective - self.fit.objective
            if rise <= max_threshold_factor * root**2:
                break
        return float(np.sqrt(max(rise, 0.0))), best


def _find_end(walk: _Walk, sign: float, root: float, error: float) -> _Side:
    """Find where the root of the deviance passes another, outwards first, then between."""
    root_tolerance = 0.01  # of the root of the threshold
    max_evaluations = 24
    problem, start = walk.fit.problem, float(walk.fit.logs[walk.number])
    bound = float((problem.lower if sign < 0.0 else problem.upper)[walk.number])
    room = sign * (bound - start)
    if room <= 0.0:
        return _Side(bound, is_open=True, points=[])
    low, start_fit, stays = (0.0, 0.0), walk.fit, 0
    high: tuple[float, float] | None = None
    points: list[tuple[float, float]] = []
    distance = min(root * error, room) if error > 0.0 else room
    for _ in range(max_evaluations):
        height, fit = walk.evaluate(start_fit, start + sign * distance, root)
        points.append((start + sign * distance, height))
        if abs(height - root) <= root_tolerance * root:
            break
        if height >= root:
            high, stays = (distance, height), min(stays, 0) - 1
        elif distance >= room:
            return _Side(bound, is_open=True, points=points)
        else:
            start_fit, low, stays = fit, (distance, height), max(stays, 0) + 1
        distance = _find_distance(low, high, stays, root, room)
    else:  # conservative
        distance = high[0] if high else room
    return _Side(start + sign * distance, high is None and distance >= room, points)


def _find_distance(
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
        aim = low_distance * root / height if height > 0.0 else np.inf
        return min(max(aim, 1.1 * low_distance), max_growth * low_distance, room)
    if abs(stays) > 2:
        return 0.5 * (low_distance + high[0])
    share = (root - height) / (high[1] - height)
    return low_distance + min(max(share, 0.02), 0.98) * (high[0] - low_distance)
