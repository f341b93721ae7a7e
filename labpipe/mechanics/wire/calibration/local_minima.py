"""Find all solutions of a calibration: local minima of the objective, and profiles from each.

A wire of strong copper with a soft insulation can have nearly the same loading curves as a wire of
weak copper with a stiff insulation. The objective then has two or more local minima, and noise
decides which is the lowest. All minima are on one line, along which the strength of the copper
varies and all other unknowns are fitted. The line is followed from bound to bound, and a search
starts from each local minimum on the line.

The profile likelihood gives the interval of a parameter: the values for which the objective is at
most q^2 above its minimum. q is the 97.5 % quantile, relative to the standard error, of the
distribution of the parameter in the linear model, averaged over the possible scatters of samples
(`variances`). The quantiles below and above may differ. With many samples q is 1.96. For a
parameter that depends on the mean of n samples, q is the quantile of Student's t with n - 1 degrees
of freedom. For a linear model the interval is the t interval. The interval is asymmetric if the
objective is asymmetric, and open if the objective stays below the limit up to a bound. If there are
several minima, each is followed separately with its rise above the lowest minimum. The interval is
then the union of their intervals.

For a nonlinear family of curves q is larger. The value q = 1.96 holds if the curves of the model
are on a straight line in the space of the data. If insulation and copper can replace each other,
the curves are on a curved line, with many directions from the true curve. Noise is then more likely
to have a large component along one of them. The probability that the objective at the true values
is more than q^2 above the minimum is that of Hotelling's tube [1]_ [2]_,

    2 (1 - Phi(q)) + angle / (2 pi) exp(-q^2 / 2),

with the angle through which the direction from the true curve to the others rotates on both sides.

References
----------
.. [1] H. Hotelling, Am. J. Math. 61 (1939) 440.
.. [2] M. Knowles and D. Siegmund, Int. Stat. Rev. 57 (1989) 205.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtr

from labpipe.mechanics.wire.calibration import objective, variances
from labpipe.mechanics.wire.calibration.law_components import COPPER, INSULATION
from labpipe.mechanics.wire.calibration.objective import (
    MAX_SOLUTION_RISE,
    Fit,
    Levels,
    P,
    Problem,
    apply_step,
    search,
)
from labpipe.records.arrays import Floats
from labpipe.records.curve import NORMAL_95
from labpipe.records.wire import ScatterMixture

_LINE_STEP = 0.3
"""Spacing of points on the line, in the logarithm of the strength of the copper."""
_MIN_SEPARATION = 0.1 * _LINE_STEP
"""Difference of the logarithm of the strength of the copper below which minima count as equal."""


@dataclass(frozen=True, slots=True, eq=False)
class LocalMinimum:
    """A local minimum of the objective.

    Parameters
    ----------
    fit : fit at the minimum
    rise : rise of the objective above the lowest minimum
    uncertainty : covariance of parameters and gain, with degrees of freedom
    mixture : covariances of parameters and gain for each possible scatter of the samples
    """

    fit: Fit
    rise: float
    uncertainty: variances.Uncertainty
    mixture: ScatterMixture


@dataclass(frozen=True, slots=True, eq=False)
class Minima:
    """All local minima of a calibration, and the line on which they lie.

    Parameters
    ----------
    local_minima : local minima, the lowest first
    line_unknowns : shape (n, 4), logarithms of the parameters and of the gain on the line through
        all minima, from bound to bound of the strength of the copper
    line_rise : shape (n,), rise of the objective above its minimum, on the line
    widening : factor on quantiles that accounts for the curvature of the line
    """

    local_minima: tuple[LocalMinimum, ...]
    line_unknowns: Floats
    line_rise: Floats
    widening: float

    @property
    def lowest(self) -> LocalMinimum:
        """Lowest minimum."""
        return self.local_minima[0]

    @property
    def fit(self) -> Fit:
        """Fit at the lowest minimum."""
        return self.local_minima[0].fit


def find_minima(problem: Problem, logs: Floats) -> Minima:
    """Find all local minima, with the levels of noise and scatter of the lowest minimum.

    Parameters
    ----------
    problem : input of the search
    logs : shape (3,), logarithms of the parameters from which the search starts

    Raises
    ------
    ValueError
        If the model cannot follow the curves at any start.
    """
    first_scatter = 0.05  # relative scatter of samples in the first search
    levels = Levels(1.0, 0.0, first_scatter if problem.scatter is None else problem.scatter)
    fit = refine_levels(_search_first_fit(problem, levels, _yield_starts(problem, logs)))
    line = follow_line(fit)
    line_minima = find_local_minima(line, fit)
    lowest = min(line_minima, key=lambda minimum: minimum.objective)
    fit = lowest if lowest is fit else refine_levels(lowest)
    fits = [fit]
    for minimum in line_minima:
        if minimum is not lowest and minimum.objective - lowest.objective <= MAX_SOLUTION_RISE:
            fits += _search_from(fit, minimum)
    distinct_fits: list[Fit] = []  # two searches may end in the same minimum
    for fit in sorted(fits, key=lambda fit: fit.objective):
        if all(_is_separate(fit, distinct_fit) for distinct_fit in distinct_fits):
            distinct_fits.append(fit)
    best = distinct_fits[0]
    line = [best, *(point for point in line if _is_separate(point, best))]
    line.sort(key=_get_log_strength)
    rises = [0.0 if fit is best else max(fit.objective - lowest.objective, 0.0) for fit in line]
    local_minima = tuple(
        LocalMinimum(fit, rise, variances.estimate_uncertainty(fit), variances.make_mixture(fit))
        for fit in distinct_fits
        if (rise := max(fit.objective - best.objective, 0.0)) <= MAX_SOLUTION_RISE
    )
    unknowns = np.array([fit.unknowns[: P + 1] for fit in line])
    return Minima(local_minima, unknowns, np.array(rises), compute_widening(line, best))


def _is_separate(first: Fit, second: Fit) -> bool:
    """Return whether two fits differ in the strength of the copper, so that both are minima."""
    return abs(_get_log_strength(first) - _get_log_strength(second)) > _MIN_SEPARATION


def _search_from(fit: Fit, start: Fit) -> list[Fit]:
    """Search from another fit, with the levels of a fit; no fit if the model cannot follow."""
    unknowns = _drop_offsets(start.unknowns, fit.levels)
    try:
        guess, best = start.model_forces, fit.objective
        return [search(fit.problem, fit.levels, unknowns, guess=guess, best_objective=best)]
    except ValueError:
        return []


def refine_levels(fit: Fit) -> Fit:
    """Estimate noise and scatter of a fit, and search again, until the levels converge."""
    max_rounds = 6
    level_tolerance = 0.01  # absolute for the correlation, relative for noise and scatter
    for _ in range(max_rounds):
        correlation = variances.estimate_correlation(fit)
        grams = objective.compute_sample_grams(fit, correlation)
        levels = variances.estimate_levels(replace(fit, grams=grams), correlation)
        changes = (
            fit.levels.correlation - levels.correlation,
            fit.levels.noise / levels.noise - 1.0,
            (fit.levels.scatter - levels.scatter) / max(levels.scatter, 1e-9),
        )
        start = _drop_offsets(fit.unknowns, levels)
        fit = search(fit.problem, levels, start, guess=fit.model_forces)
        if np.max(np.abs(changes)) <= level_tolerance:
            break
    return fit


def _search_first_fit(problem: Problem, levels: Levels, starts: Iterable[Floats]) -> Fit:
    """Return the fit from the first start at which the model can follow the curves."""
    reason = ""
    for logs in starts:
        try:
            return search(problem, levels, np.append(logs, np.zeros(1 + problem.n_samples)))
        except ValueError as error:
            reason = reason or str(error)
    message = f"the model cannot follow the curves at any of the starts; at the first: {reason}"
    raise ValueError(message)


def _drop_offsets(unknowns: Floats, levels: Levels) -> Floats:
    """Return the unknowns, with factors of samples of 1 if the scatter is 0."""
    is_offset = np.arange(len(unknowns)) > P
    return np.where(is_offset & (levels.scatter == 0.0), 0.0, unknowns)


def _has_trade_off(problem: Problem) -> bool:
    """Return whether insulation and copper are both fitted and can replace each other."""
    return bool(problem.is_free[INSULATION] and problem.is_free[COPPER])


def _yield_starts(problem: Problem, logs: Floats) -> Iterator[Floats]:
    """Yield the given start, then starts in which the insulation carries part of the load."""
    insulation_fractions = (0.3, 0.8)  # fractions of the load that the insulation carries
    yield logs
    if not _has_trade_off(problem):
        return
    nominal_values = problem.law.nominal
    is_nominal = problem.is_free & (nominal_values > 0.0)
    nominal = np.where(is_nominal, np.log(np.where(is_nominal, nominal_values, 1.0)), logs)
    models = objective.compute_model_forces(problem.law, np.exp(nominal), problem.curves)
    total = sum(float(np.abs(model.force).sum()) for model in models)
    insulation_total = sum(float(np.abs(model.sensitivity[INSULATION]).sum()) for model in models)
    copper_total = max(total - insulation_total, 0.01 * total)
    measured_total = sum(float(np.abs(curve.force).sum()) for curve in problem.curves)
    for fraction in insulation_fractions:
        start = nominal.copy()
        start[INSULATION] += np.log(fraction * measured_total / insulation_total)
        start[COPPER] += np.log((1.0 - fraction) * measured_total / copper_total)
        yield np.clip(start, problem.lower, problem.upper)


def find_local_minima(line: list[Fit], fit: Fit) -> list[Fit]:
    """Find every local minimum of the objective.

    Parameters
    ----------
    line : fits along the line, in order of the strength of the copper
    fit : a minimum on the line

    Returns
    -------
    Minima in order of the strength of the copper. Of two minima without a barrier between them,
    only the lower minimum is returned.
    """
    min_barrier = 1.0  # smallest rise of the objective between minima, above the higher minimum
    heights = np.pad([point.objective for point in line], 1, constant_values=np.inf)
    minima = [fit]
    for index, point in enumerate(line, start=1):
        if point is not fit and heights[index] <= min(heights[index - 1], heights[index + 1]):
            minima += _search_from(fit, point)
    distinct_minima: list[Fit] = []
    for minimum in sorted(minima, key=_get_log_strength):
        if distinct_minima and _compute_barrier(line, distinct_minima[-1], minimum) < min_barrier:
            pair = distinct_minima.pop(), minimum
            distinct_minima.append(min(pair, key=lambda fit: fit.objective))
        else:
            distinct_minima.append(minimum)
    return distinct_minima


def _get_log_strength(fit: Fit) -> float:
    """Return the logarithm of the strength of the copper of a fit."""
    return float(fit.logs[COPPER])


def _compute_barrier(line: list[Fit], first: Fit, second: Fit) -> float:
    """Compute the height of the objective on the line between two minima, above the higher one."""
    low, high = _get_log_strength(first), _get_log_strength(second)
    heights = [fit.objective for fit in line if low < _get_log_strength(fit) < high]
    return max(heights, default=-np.inf) - max(first.objective, second.objective)


def follow_line(fit: Fit) -> list[Fit]:
    """Follow the line on which insulation and copper replace each other.

    Parameters
    ----------
    fit : a minimum of the objective

    Returns
    -------
    Fits for evenly spaced strengths of the copper from bound to bound, including the minimum. Only
    the minimum is returned unless insulation and copper are both fitted.
    """
    problem, strength = fit.problem, _get_log_strength(fit)
    if not _has_trade_off(problem):
        return [fit]
    sides = []
    for bound in (float(problem.lower[COPPER]), float(problem.upper[COPPER])):
        count = int(np.ceil(abs(bound - strength) / _LINE_STEP))
        sides.append(_follow_to_bound(fit, np.linspace(strength, bound, count + 1)[1:]))
    return [*sides[0][::-1], fit, *sides[1]]


def _follow_to_bound(fit: Fit, strengths: Floats) -> list[Fit]:
    """Fit at successive strengths of the copper; each search starts from an extrapolation."""
    fits, problem = [fit, fit], fit.problem.hold(COPPER)
    search_line = partial(search, problem, fit.levels, tolerance=0.01, best_objective=fit.objective)
    for strength in strengths:
        previous, last = fits[-2:]
        change = np.clip(last.logs - previous.logs, -1.0, 1.0)
        start = apply_step(last, np.pad(change, (0, len(last.unknowns) - P)))
        start[COPPER] = strength
        try:
            fits.append(search_line(start, guess=last.model_forces))
        except ValueError:
            break  # the model cannot follow the curves with such copper
    return fits[2:]


def compute_widening(line: list[Fit], base: Fit) -> float:
    """Compute the ratio of the quantile for a nonlinear family of curves to that for a linear one.

    Parameters
    ----------
    line : fits along the family, in order, including the base
    base : fit from which the directions to the others are measured

    Returns
    -------
    Ratio of the quantiles, at least 1.
    """
    base_index = next(index for index, fit in enumerate(line) if fit is base)
    products = compute_differences(line, base)
    sides = range(base_index - 1, -1, -1), range(base_index + 1, len(line))
    angle = sum(_sum_angles(products, side) for side in sides)
    return compute_tube_quantile(angle) / NORMAL_95


def compute_tube_quantile(angle: float) -> float:
    """Compute the root of the rise of the objective that is exceeded with a probability of 5 %.

    Parameters
    ----------
    angle : rad, angle through which the direction to the curves rotates

    Examples
    --------
    >>> round(compute_tube_quantile(0.0), 2), round(compute_tube_quantile(np.pi), 2)
    (1.96, 2.35)
    """
    probability = 0.05

    def compute_excess(q: float) -> float:
        return float(2.0 * ndtr(-q) + angle / (2.0 * np.pi) * np.exp(-0.5 * q * q)) - probability

    return float(brentq(compute_excess, 1.9, 10.0))


def _sum_angles(products: Floats, side: range) -> float:
    """Sum the angles between the directions to successive points, rad, up to a largest distance.

    `products` is the Gram matrix of the differences of the points from the base.
    """
    max_distance = 6.0  # standard deviations of noise; a farther curve does not fit by chance
    distance = np.sqrt(np.maximum(np.diag(products), 0.0))
    total_angle = 0.0
    for i, j in pairwise(side):
        if distance[j] > max_distance or distance[i] == 0.0:
            break
        cosine = products[i, j] / (distance[i] * distance[j])
        total_angle += float(np.arccos(np.clip(cosine, -1.0, 1.0)))
    return total_angle


def compute_differences(line: list[Fit], base: Fit) -> Floats:
    """Compute the Gram matrix of the differences of fits from a base, relative to the noise.

    The differences are those of the model forces and, with priors, of the unknowns.
    """
    problem, levels = base.problem, base.levels
    total = np.zeros((len(line), len(line)))
    for index, curve in enumerate(problem.curves):
        forces = [fit.factors[index] * fit.model_forces[index].force for fit in line]
        columns = np.stack(forces, axis=1)
        columns -= (base.factors[index] * base.model_forces[index].force)[:, None]
        total += objective.compute_whitened_products(
            curve, columns, base.model_forces[index].slope, levels.correlation
        )
    precision = problem.compute_precision(levels.scatter)
    weights = np.sqrt(np.where(np.isfinite(precision), precision, 0.0))
    changes = np.stack([weights * (fit.unknowns - base.unknowns) for fit in line], axis=1)
    return np.asarray(total / levels.noise + changes.T @ changes)


@dataclass(frozen=True, slots=True, eq=False)
class LocalProfile:
    """Profile of a parameter from one minimum, and the ends of its interval.

    Parameters
    ----------
    logs : shape (n,), logarithms of the parameter, increasing
    deviance : shape (n,), rise of the objective above its minimum
    lower, upper : logarithms of the parameter at the ends of the interval
    is_open_below, is_open_above : whether the deviance is below the threshold even at the bound
    threshold_below, threshold_above : deviance at which the interval ends
    """

    logs: Floats
    deviance: Floats
    lower: float
    upper: float
    is_open_below: bool
    is_open_above: bool
    threshold_below: float
    threshold_above: float


def follow_profiles(minima: Minima, index: int, *, factor: float = 1.0) -> tuple[LocalProfile, ...]:
    """Compute the profiles of a parameter from all minima in the 95 % set.

    Parameters
    ----------
    minima : minima of a calibration
    index : index of the parameter
    factor : factor on the rise of the objective at the ends of the 95 % set; 1 for this set
    """
    return tuple(
        _follow_profile(minima, index, minimum, factor)
        for minimum in minima.local_minima
        if minimum.rise < factor * compute_limit(minima, minimum)
    )


def unite_intervals(profiles: tuple[LocalProfile, ...]) -> tuple[tuple[float, float], ...]:
    """Return the intervals of which the union of several profiles consists, in increasing order."""
    intervals: list[tuple[float, float]] = []
    for lower, upper in sorted((profile.lower, profile.upper) for profile in profiles):
        if intervals and lower <= intervals[-1][1]:
            intervals[-1] = (intervals[-1][0], max(intervals[-1][1], upper))
        else:
            intervals.append((lower, upper))
    return tuple(intervals)


def compute_limit(minima: Minima, minimum: LocalMinimum) -> float:
    """Compute the rise of the objective below which a minimum is in the 95 % set.

    Parameters
    ----------
    minima : minima of a calibration
    minimum : one of the minima

    Notes
    -----
    The limit is the square of a quantile, in standard errors, of the combination of parameters in
    the direction from the lowest minimum to this minimum. The shape of the curves distinguishes the
    minima. The quantile is therefore that of many points, even if the mean force depends on few
    samples.
    """
    difference = minimum.fit.unknowns[: P + 1] - minima.fit.unknowns[: P + 1]
    return float(_compute_limits(minima, difference[None, :])[0])


def find_line_range(minima: Minima, index: int, factor: float) -> tuple[float, float]:
    """Find the range of the logarithm of a parameter on the line of minima.

    Parameters
    ----------
    minima : minima of a calibration
    index : index of the parameter
    factor : factor on the rise of the objective at the ends of the 95 % set
    """
    directions = minima.line_unknowns - minima.fit.unknowns[: P + 1]
    limits = np.maximum(_compute_limits(minima, directions), 1e-30)
    height = np.sqrt(minima.line_rise / limits / factor)
    logs, is_inside = minima.line_unknowns[:, index], height <= 1.0
    crosses = is_inside[:-1] != is_inside[1:]
    fraction = (1.0 - height[:-1][crosses]) / np.diff(height)[crosses]
    crossing_logs = logs[:-1][crosses] + fraction * np.diff(logs)[crosses]
    range_logs = np.append(logs[is_inside], crossing_logs)
    return float(range_logs.min()), float(range_logs.max())


def _compute_limits(minima: Minima, directions: Floats) -> Floats:
    """Compute the squared quantiles of combinations of parameters and gain, in standard errors."""
    lowest = minima.lowest
    variance = np.einsum("ni,ij,nj->n", directions, lowest.uncertainty.covariance, directions)
    below, above = variances.compute_quantiles(lowest.mixture, directions)
    ratio = _compute_quantile_ratio(np.maximum(-below, above), np.sqrt(variance))
    return np.asarray((minima.widening * ratio) ** 2)


def _compute_quantile_ratio(quantile: Floats, error: Floats) -> Floats:
    """Compute quantiles in standard errors, at least that of a normal distribution.

    The uncertainty of noise and scatter increases the quantiles. If a parameter has no effect, such
    as the modulus of an insulation without stiffness, the quantile of the linear model is
    arbitrary.
    """
    min_quantile = 1.96
    ratio = np.divide(quantile, error, out=np.zeros_like(quantile), where=error > 0.0)
    return np.asarray(np.maximum(ratio, min_quantile))


def _follow_profile(
    minima: Minima, index: int, minimum: LocalMinimum, factor: float
) -> LocalProfile:
    """Compute the profile of a parameter on both sides of a minimum; other unknowns are fitted."""
    fit, minimum_log = minimum.fit, float(minimum.fit.logs[index])
    error = float(np.sqrt(minimum.uncertainty.covariance[index, index]))
    below, above = variances.compute_quantiles(minimum.mixture, np.eye(P + 1)[[index]])
    relative_rise = minimum.rise / compute_limit(minima, minimum) if minimum.rise > 0.0 else 0.0
    widening = minima.widening * float(np.sqrt(factor - relative_rise))
    roots = widening * _compute_quantile_ratio(np.append(-below, above), np.full(2, error))
    path = _ProfilePath(fit, index, _compute_direction(fit, index))
    low = _find_end(path, -1.0, float(roots[0]), error)
    high = _find_end(path, 1.0, float(roots[1]), error)
    points = {(minimum_log, 0.0)}
    for side in (low, high):
        is_single = len(minima.local_minima) == 1
        points |= set(side.points if is_single else _select_rising(minimum_log, side))
    logs, heights = np.array(sorted(points)).T
    return LocalProfile(
        *(logs, heights**2 + minimum.rise, low.end, high.end, low.is_open, high.is_open),
        *(float(root) ** 2 + minimum.rise for root in roots),
    )


@dataclass(frozen=True, slots=True)
class _ProfileSide:
    """One side of a profile.

    Parameters
    ----------
    end : logarithm of the parameter at the end of the interval
    is_open : whether the deviance is below the threshold even at the bound
    points : logarithm of the parameter and root of the deviance of each point, in order of
        evaluation
    """

    end: float
    is_open: bool
    points: list[tuple[float, float]]


def _select_rising(minimum_log: float, side: _ProfileSide) -> list[tuple[float, float]]:
    """Select the points before the deviance decreases; farther minima have their own profiles."""
    points: list[tuple[float, float]] = []
    for point in sorted(side.points, key=lambda point: abs(point[0] - minimum_log)):
        if points and point[1] < points[-1][1]:
            break
        points.append(point)
    return points


def _compute_direction(fit: Fit, index: int) -> Floats:
    """Compute the change of all unknowns per change of a parameter, for a quadratic objective."""
    matrix, _, may_change = objective.make_normal_equations(fit)
    may_change[index] = False
    direction = np.zeros(len(matrix))
    direction[index] = 1.0
    if may_change.any():
        unit, scale = objective.scale_matrix(matrix[np.ix_(may_change, may_change)])
        direction[may_change] = -np.linalg.solve(unit, matrix[may_change, index] / scale) / scale
    return direction


@dataclass(frozen=True, slots=True, eq=False)
class _ProfilePath:
    """Profile of a parameter, which is evaluated point by point.

    Parameters
    ----------
    fit : minimum from which the profile starts
    index : index of the parameter
    direction : shape (4 + samples,), change of all unknowns per change of the parameter
    """

    fit: Fit
    index: int
    direction: Floats

    def evaluate(self, start: Fit, log_value: float, root: float) -> tuple[float, Fit]:
        """Return the root of the deviance and the fit at a logarithm of the parameter.

        The search starts from a nearby fit. It is repeated without extrapolation if the deviance is
        far above the threshold, `root` squared.
        """
        max_factor = 3.0  # largest deviance after the first search, relative to the threshold
        problem = self.fit.problem.hold(self.index)
        search_profile = partial(search, problem, self.fit.levels, tolerance=1e-3)
        shift = (log_value - float(start.logs[self.index])) * self.direction
        fits: list[Fit] = []
        for step in (shift, 0.0 * shift):
            unknowns = apply_step(start, step)
            unknowns[self.index] = log_value
            fits.append(search_profile(unknowns, guess=start.model_forces))
            best = min(fits, key=lambda fit: fit.objective)
            rise = best.objective - self.fit.objective
            if rise <= max_factor * root**2:
                break
        return float(np.sqrt(max(rise, 0.0))), best


def _find_end(path: _ProfilePath, sign: float, root: float, error: float) -> _ProfileSide:
    """Find the end of the interval, at which the root of the deviance is `root`."""
    root_tolerance = 0.01  # relative to the root
    max_evaluations = 24
    problem, minimum_log = path.fit.problem, float(path.fit.logs[path.index])
    bound = float((problem.lower if sign < 0.0 else problem.upper)[path.index])
    max_distance = sign * (bound - minimum_log)
    if max_distance <= 0.0:
        return _ProfileSide(bound, is_open=True, points=[])
    inner, start_fit, n_same_side = (0.0, 0.0), path.fit, 0
    outer: tuple[float, float] | None = None
    points: list[tuple[float, float]] = []
    distance = min(root * error, max_distance) if error > 0.0 else max_distance
    for _ in range(max_evaluations):
        height, fit = path.evaluate(start_fit, minimum_log + sign * distance, root)
        points.append((minimum_log + sign * distance, height))
        if abs(height - root) <= root_tolerance * root:
            break
        if height >= root:
            outer, n_same_side = (distance, height), min(n_same_side, 0) - 1
        elif distance >= max_distance:
            return _ProfileSide(bound, is_open=True, points=points)
        else:
            start_fit, inner, n_same_side = fit, (distance, height), max(n_same_side, 0) + 1
        distance = _choose_distance(inner, outer, n_same_side, root, max_distance)
    else:  # without convergence, the wider interval is taken
        distance = outer[0] if outer else max_distance
    is_open = outer is None and height < root and distance >= max_distance
    return _ProfileSide(minimum_log + sign * distance, is_open, points)


def _choose_distance(
    inner: tuple[float, float],
    outer: tuple[float, float] | None,
    n_same_side: int,
    root: float,
    max_distance: float,
) -> float:
    """Choose the next distance: a limited extrapolation, then false position or bisection.

    `inner` and `outer` are the last points inside and outside the interval: distance from the
    minimum and root of the deviance. `n_same_side` counts successive points inside, or outside with
    a negative sign. After three such points the distance between `inner` and `outer` is bisected,
    because the deviance is not quadratic.
    """
    max_growth = 2.5  # ratio of successive distances
    inner_distance, height = inner
    if outer is None:
        target = inner_distance * root / height if height > 0.0 else np.inf
        return min(max(target, 1.1 * inner_distance), max_growth * inner_distance, max_distance)
    if abs(n_same_side) > 2:
        return 0.5 * (inner_distance + outer[0])
    fraction = (root - height) / (outer[1] - height)
    return inner_distance + min(max(fraction, 0.02), 0.98) * (outer[0] - inner_distance)
