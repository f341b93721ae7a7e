"""All solutions of a calibration: the local minima of the objective that the tests allow.

A wire of hard copper with little insulation can look like one of soft copper with much of it, so
that the objective has two or more local minima, between which noise decides. All of them lie along
one line, on which the copper's strength is fixed and all else fitted. It is followed from bound to
bound, and a search starts from each of its low points.

Widening of intervals for a nonlinear family of curves.

A profile ends where the objective has risen by q^2, with q = 1.96 if the curves of the model lie on
a straight line in the space of the data, seen from the truth. Where insulation and copper trade
off, they lie on a curved line, which returns if there are two valleys, and among its many
directions noise finds one that fits too well. By Hotelling's tube (Am. J. Math. 61 (1939) 440;
Knowles and Siegmund, Int. Stat. Rev. 57 (1989) 205), the probability that the objective rises by
more than q^2 from its minimum to the truth is

    2 (1 - Phi(q)) + angle / (2 pi) exp(-q^2 / 2),

with the angle that the direction from the truth to the curves sweeps on both sides of it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtr, ndtri

from labpipe.mechanics.wire.calibration import objective, variances
from labpipe.mechanics.wire.calibration.objective import Fit, Levels, Point, Problem
from labpipe.mechanics.wire.calibration.search import search
from labpipe.records.arrays import Floats
from labpipe.records.wire_calibration import (
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
    fit = refine(_first_fit(problem, levels, _starts(problem, logs)))
    line = follow_line(fit)
    local_minima = find_local_minima(line, fit)
    lowest = min(local_minima, key=lambda minimum: minimum.objective)
    others = [
        minimum
        for minimum in local_minima
        if minimum is not lowest and minimum.objective - lowest.objective <= _MAX_RISE
    ]
    fit = lowest if lowest is fit else refine(lowest)
    minima = (_search_again(fit, other.point, lowest=fit.objective) for other in others)
    fits = _distinct_minima([fit, *(minimum for minimum in minima if minimum is not None)])
    best = fits[0]
    fits = [fit for fit in fits if fit.objective - best.objective <= _MAX_RISE]
    beside = [fit for fit in line if abs(_strength(fit) - _strength(best)) > _SAME_PLACE]
    line = sorted([*beside, best], key=_strength)
    rises = [0.0 if fit is best else max(fit.objective - lowest.objective, 0.0) for fit in line]
    place = np.array([[*fit.point.logs, fit.point.gain] for fit in line])
    estimated = tuple(_estimate_local_minimum(fit, best) for fit in fits)
    return Minima(estimated, place, np.array(rises), compute_widening(line, best))


def _distinct_minima(fits: list[Fit]) -> list[Fit]:
    """Return distinct minima, the lowest first: two searches may end in one."""
    distinct: list[Fit] = []
    for fit in sorted(fits, key=lambda fit: fit.objective):
        if all(abs(_strength(fit) - _strength(other)) > _SAME_PLACE for other in distinct):
            distinct.append(fit)
    return distinct


def _search_again(fit: Fit, start: Point, *, lowest: float) -> Fit | None:
    """Search in the problem of a fit from another point; None where the model cannot follow."""
    try:
        start = _without_offsets(start, fit.levels)
        return search(fit.problem, fit.levels, start, lowest=lowest)
    except ValueError:
        return None


def refine(fit: Fit) -> Fit:
    """Estimate the levels of a fit and search again until they converge."""
    max_rounds = 6
    for _ in range(max_rounds):
        correlation = variances.estimate_correlation(fit)
        grams = objective.compute_products(fit.problem, correlation, fit.point, fit.models)
        levels = variances.estimate_levels(replace(fit, grams=grams), correlation)
        rests = _are_close(fit.levels, levels)
        fit = search(fit.problem, levels, _without_offsets(fit.point, levels))
        if rests:
            break
    return fit


def _first_fit(problem: Problem, levels: Levels, starts: Iterable[Floats]) -> Fit:
    """Return the fit from the first start that the model can follow."""
    reason = ""
    for logs in starts:
        try:
            return search(problem, levels, Point(logs, 0.0, np.zeros(problem.n_samples)))
        except ValueError as error:
            reason = reason or str(error)
    message = f"the model cannot follow the curves at any of the starts; at the first: {reason}"
    raise ValueError(message)


def _without_offsets(point: Point, levels: Levels) -> Point:
    """Return the point, without offsets where samples do not scatter."""
    offsets = point.offsets if levels.scatter > 0.0 else np.zeros_like(point.offsets)
    return replace(point, offsets=offsets)


def _are_close(one: Levels, other: Levels) -> bool:
    level_tolerance = 0.01
    if abs(one.correlation - other.correlation) > level_tolerance:
        return False
    close = abs(one.noise / other.noise - 1.0) <= level_tolerance
    return close and abs(one.scatter - other.scatter) <= level_tolerance * max(other.scatter, 1e-9)


def _trades_off(problem: Problem) -> bool:
    """Return whether insulation and copper are both free, so that one can replace the other."""
    return bool(problem.free[_TUBE] and problem.free[_COPPER])


def _starts(problem: Problem, logs: Floats) -> Iterator[Floats]:
    """Yield the given start, then others in case the model cannot follow from there."""
    # of the load, where the model cannot follow from the given start
    insulation_shares = (0.3, 0.8)
    yield logs
    if not _trades_off(problem):
        return
    given = problem.parts.given
    nominal = np.where(
        problem.free & (given > 0.0), np.log(np.where(given > 0.0, given, 1.0)), logs
    )
    models = objective.compute_model_forces(problem.parts, np.exp(nominal), problem.curves)
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
    dips = [dip for dip in _low_points(line) if dip is not fit]
    searched = [_search_again(fit, dip.point, lowest=fit.objective) for dip in dips]
    distinct: list[Fit] = []
    for minimum in sorted([fit, *(found for found in searched if found)], key=_strength):
        if distinct and _hill_height(line, distinct[-1], minimum) < min_hill:
            distinct[-1] = min(distinct[-1], minimum, key=lambda one: one.objective)
        else:
            distinct.append(minimum)
    return distinct


def _strength(fit: Fit) -> float:
    return float(fit.point.logs[_COPPER])


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
    problem, strength = fit.problem, _strength(fit)
    if not _trades_off(problem):
        return [fit]
    sides = []
    for bound in (float(problem.lower[_COPPER]), float(problem.upper[_COPPER])):
        count = int(np.ceil(abs(bound - strength) / _STRIDE))
        sides.append(_follow(fit, np.linspace(strength, bound, count + 1)[1:]))
    return [*sides[0][::-1], fit, *sides[1]]


def _follow(fit: Fit, stops: Floats) -> list[Fit]:
    """Fit with the copper's strength at one stop after the other, started by extrapolation."""
    tolerance = 0.01
    fits, held = [fit], fit.problem.hold(_COPPER)
    for stop in stops:
        last = fits[-1].point
        before = fits[-2].point if len(fits) > 1 else last
        logs = np.clip(2.0 * last.logs - before.logs, last.logs - 1.0, last.logs + 1.0)
        logs = np.clip(logs, held.lower, held.upper)
        logs[_COPPER] = stop
        try:
            start, low = replace(last, logs=logs), fit.objective
            fits.append(search(held, fit.levels, start, enough=tolerance, lowest=low))
        except ValueError:
            break  # the model cannot follow the curves with such copper
    return fits[1:]


def _low_points(line: list[Fit]) -> Iterator[Fit]:
    """Yield the points of a line that are not above their neighbours."""
    heights = [np.inf, *(fit.objective for fit in line), np.inf]
    for number, fit in enumerate(line, start=1):
        if heights[number] <= min(heights[number - 1], heights[number + 1]):
            yield fit


def _hill_height(line: list[Fit], one: Fit, other: Fit) -> float:
    """Return how far the line rises above two minima between them."""
    heights = [fit.objective for fit in line if _strength(one) < _strength(fit) < _strength(other)]
    return max(heights, default=-np.inf) - max(one.objective, other.objective)


def _estimate_local_minimum(fit: Fit, lowest: Fit) -> LocalMinimum:
    rise = max(fit.objective - lowest.objective, 0.0)
    return LocalMinimum(fit, rise, variances.estimate_uncertainty(fit), variances.make_mixture(fit))


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
    angle = compute_swept_angle(products, range(start - 1, -1, -1)) + compute_swept_angle(
        products, range(start + 1, len(line))
    )
    return compute_tube_quantile(angle) / float(ndtri(1.0 - 0.5 * _ALARM_RATE))


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


def compute_swept_angle(products: Floats, stretch: range) -> float:
    """Return the angle, rad, swept by the direction to one point after the other.

    Parameters
    ----------
    products : shape (points, points), of the differences from the base
    stretch : points in order, up to the first that is too far
    """
    max_distance = 6.0  # standard deviations of noise: no curve fits better by chance beyond
    distance = np.sqrt(np.maximum(np.diag(products), 0.0))
    total = 0.0
    for near, far in pairwise(stretch):
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
        sample = problem.sample[number]
        forces = [
            np.exp(fit.point.gain + fit.point.offsets[sample]) * fit.models[number].force
            - np.exp(base.point.gain + base.point.offsets[sample]) * base.models[number].force
            for fit in line
        ]
        slope = base.models[number].slope
        columns = np.stack(forces, axis=1)
        total += (
            objective.compute_whitened_products(curve, columns, slope, levels.correlation)
            / levels.noise
        )
    rests = np.stack([_weighed(fit, base) for fit in line], axis=1)
    return np.asarray(total + rests.T @ rests)


def _weighed(fit: Fit, base: Fit) -> Floats:
    """Return the differences of priors, gain and offsets, over their standard deviations."""
    here, there, problem, levels = base.point, fit.point, base.problem, base.levels
    rests = [np.sqrt(problem.precision) * (there.logs - here.logs)]
    if problem.gain > 0.0:
        rests.append(np.array([(there.gain - here.gain) / problem.gain]))
    if levels.scatter > 0.0:
        rests.append((there.offsets - here.offsets) / levels.scatter)
    return np.concatenate(rests)
