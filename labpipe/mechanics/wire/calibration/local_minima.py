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

from labpipe.mechanics.wire.calibration.objective import (
    Fit,
    Levels,
    Point,
    Problem,
    compute_model_forces,
    compute_products,
    compute_whitened_products,
)
from labpipe.mechanics.wire.calibration.search import search
from labpipe.mechanics.wire.calibration.variances import (
    Uncertainty,
    estimate_correlation,
    estimate_levels,
    estimate_uncertainty,
    make_mixture,
)
from labpipe.records.arrays import Flags, Floats
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
    spread: Uncertainty
    mixture: ScatterMixture


@dataclass(frozen=True, slots=True, eq=False)
class Line:
    """The line through all minima, from bound to bound of the copper's strength.

    Parameters
    ----------
    place : shape (n, 4), logarithms of the parameters and of the gain
    rise : shape (n,), of the objective over its minimum
    """

    place: Floats
    rise: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Minima:
    """Local minima and levels.

    Parameters
    ----------
    fits : at the minima, the lowest first
    levels : those of the lowest
    line : on which they lie
    widening : of intervals, for that curved line (`local_minima`)
    """

    fits: list[Fit]
    levels: Levels
    line: Line
    widening: float


def find_minima(problem: Problem, logs: Floats, free: Flags, *, scatter: float | None) -> Minima:
    """Find all local minima, and the levels at the lowest.

    Parameters
    ----------
    problem : what is fitted
    logs : shape (3,), where the search starts
    free : shape (3,)
    scatter : of the samples, in logarithms, where it is given

    Raises
    ------
    ValueError
        If the model cannot follow the curves at any start.
    """
    first_scatter = 0.05
    max_rise = 200.0  # of the objective: no quantile of so few samples is as large
    levels = Levels(1.0, 0.0, first_scatter if scatter is None else scatter)
    first = _first_fit(problem, levels, _starts(problem, logs, free), free)
    fit, levels = refine(problem, first, levels, free, scatter=scatter)
    line = follow_line(problem, levels, fit, free)
    local_minima = find_local_minima(problem, levels, line, fit, free)
    lowest = min(local_minima, key=lambda minimum: minimum.objective)
    other_minima = [minimum for minimum in local_minima if minimum is not lowest]
    other_minima = [
        other for other in other_minima if other.objective - lowest.objective <= max_rise
    ]
    lowest_objective = lowest.objective
    if lowest is not fit:
        fit, levels = refine(problem, lowest, levels, free, scatter=scatter)
    low = fit.objective
    minima = (_search_again(problem, levels, other, free, lowest=low) for other in other_minima)
    fits = _distinct_minima([fit, *(minimum for minimum in minima if minimum is not None)])
    fits = [fit for fit in fits if fit.objective - fits[0].objective <= max_rise]
    others_on_line = [
        element for element in line if abs(_strength(element) - _strength(fits[0])) > _SAME_PLACE
    ]
    line = sorted([*others_on_line, fits[0]], key=_strength)
    objective_rises = [
        0.0 if element is fits[0] else max(element.objective - lowest_objective, 0.0)
        for element in line
    ]
    place = np.array([[*element.point.logs, element.point.gain] for element in line])
    widening = compute_widening(problem, levels, line, fits[0])
    return Minima(fits, levels, Line(place, np.array(objective_rises)), widening)


def _distinct_minima(fits: list[Fit]) -> list[Fit]:
    """Return distinct minima, the lowest first: two searches may end in one."""
    distinct: list[Fit] = []
    for fit in sorted(fits, key=lambda fit: fit.objective):
        if all(abs(_strength(fit) - _strength(other)) > _SAME_PLACE for other in distinct):
            distinct.append(fit)
    return distinct


def _search_again(
    problem: Problem, levels: Levels, fit: Fit, free: Flags, *, lowest: float
) -> Fit | None:
    """Search from a fit; None where the model cannot follow."""
    try:
        return search(problem, levels, _without_offsets(fit.point, levels), free, lowest=lowest)
    except ValueError:
        return None


def refine(
    problem: Problem, fit: Fit, levels: Levels, free: Flags, *, scatter: float | None
) -> tuple[Fit, Levels]:
    """Estimate the levels and search again until they converge.

    Parameters
    ----------
    problem, free, scatter : as for `find_minima`
    fit, levels : a fit, and the levels it was made with
    """
    max_rounds = 6
    for _ in range(max_rounds):
        factors = np.exp(fit.point.gain + fit.point.offsets[problem.sample])
        correlation = estimate_correlation(problem.curves, fit.models, factors)
        grams = compute_products(problem, correlation, fit.point, fit.models)
        white = Fit(fit.point, fit.objective, grams, fit.models, fit.steps, fit.settled)
        new = estimate_levels(problem, white, free, correlation, scatter)
        rests = _are_close(levels, new)
        levels = new
        fit = search(problem, levels, _without_offsets(fit.point, levels), free)
        if rests:
            break
    return fit, levels


def _first_fit(problem: Problem, levels: Levels, starts: Iterable[Floats], free: Flags) -> Fit:
    """Return the fit from the first start that the model can follow."""
    reason = ""
    for logs in starts:
        try:
            return search(problem, levels, Point(logs, 0.0, np.zeros(problem.n_samples)), free)
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


def _starts(problem: Problem, logs: Floats, free: Flags) -> Iterator[Floats]:
    """Yield the given start, then others in case the model cannot follow from there."""
    # of the load, where the model cannot follow from the given start
    insulation_shares = (0.3, 0.8)
    yield logs
    if not (free[_TUBE] and free[_COPPER]):
        return
    nominal_values = problem.parts.given
    nominal = np.where(
        free & (nominal_values > 0.0),
        np.log(np.where(nominal_values > 0.0, nominal_values, 1.0)),
        logs,
    )
    models = compute_model_forces(problem.parts, np.exp(nominal), problem.curves)
    total = sum(float(np.abs(model.force).sum()) for model in models)
    of_tube = sum(float(np.abs(model.change[_TUBE]).sum()) for model in models)
    measured = sum(float(np.abs(curve.force).sum()) for curve in problem.curves)
    for share in insulation_shares:
        start = nominal.copy()
        start[_TUBE] += np.log(share * measured / of_tube)
        start[_COPPER] += np.log((1.0 - share) * measured / max(total - of_tube, 0.01 * total))
        yield np.clip(start, problem.lower, problem.upper)


def find_local_minima(
    problem: Problem, levels: Levels, line: list[Fit], fit: Fit, free: Flags
) -> list[Fit]:
    """Find every local minimum of the objective.

    Parameters
    ----------
    problem, levels, free : what is fitted
    line : fits with the copper's strength held
    fit : one minimum, on the line

    Returns
    -------
    In order of the copper's strength; of two without a hill between them, the lower.
    """
    min_hill = 1.0  # rise of the objective above the higher of two separate minima
    minima = [fit]
    for dip in _low_points(line):
        if dip is not fit:
            least = _search_again(problem, levels, dip, free, lowest=fit.objective)
            minima += [] if least is None else [least]
    minima.sort(key=_strength)
    distinct: list[Fit] = []
    for minimum in minima:
        if distinct and _hill_height(line, distinct[-1], minimum) < min_hill:
            distinct[-1] = min(distinct[-1], minimum, key=lambda one: one.objective)
        else:
            distinct.append(minimum)
    return distinct


def _strength(fit: Fit) -> float:
    return float(fit.point.logs[_COPPER])


def follow_line(problem: Problem, levels: Levels, fit: Fit, free: Flags) -> list[Fit]:
    """Follow the line on which insulation and copper trade off.

    Parameters
    ----------
    problem, levels, free : what is fitted
    fit : a minimum of the objective

    Returns
    -------
    Fits with the copper's strength fixed at even steps, from bound to bound, with the minimum among
    them; the minimum alone unless insulation and copper are both free.
    """
    if not (free[_TUBE] and free[_COPPER]):
        return [fit]
    other_parameters = free.copy()
    other_parameters[_COPPER] = False
    low, high = float(problem.lower[_COPPER]), float(problem.upper[_COPPER])
    strength = _strength(fit)
    down = _follow(problem, levels, fit, other_parameters, _steps(strength, low))
    up = _follow(problem, levels, fit, other_parameters, _steps(strength, high))
    return [*down[::-1], fit, *up]


def _steps(strength: float, bound: float) -> Floats:
    count = int(np.ceil(abs(bound - strength) / _STRIDE))
    return np.linspace(strength, bound, count + 1)[1:]


def _follow(problem: Problem, levels: Levels, fit: Fit, others: Flags, stops: Floats) -> list[Fit]:
    """Fit at one stop after the other, each started by extrapolation."""
    tolerance = 0.01
    fits = [fit]
    for stop in stops:
        last = fits[-1].point
        before = fits[-2].point if len(fits) > 1 else last
        logs = np.clip(2.0 * last.logs - before.logs, last.logs - 1.0, last.logs + 1.0)
        logs = np.clip(logs, problem.lower, problem.upper)
        logs[_COPPER] = stop
        try:
            start, low = replace(last, logs=logs), fit.objective
            fits.append(search(problem, levels, start, others, enough=tolerance, lowest=low))
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


def estimate_local_minimum(
    problem: Problem, levels: Levels, fit: Fit, free: Flags, *, lowest: Fit, scatter: float | None
) -> LocalMinimum:
    """Estimate the uncertainty at a minimum of the objective.

    Parameters
    ----------
    problem, levels, free, scatter : what was fitted, as for `find_minima`
    fit : at the minimum
    lowest : of all minima
    """
    is_known = scatter is not None
    spread = estimate_uncertainty(problem, fit, free, levels, is_scatter_known=is_known)
    is_given = is_known or problem.n_samples == 1
    mixture = make_mixture(problem, fit, free, levels, is_scatter_known=is_given)
    return LocalMinimum(fit, max(fit.objective - lowest.objective, 0.0), spread, mixture)


_ALARM_RATE = 0.05


def compute_widening(problem: Problem, levels: Levels, line: list[Fit], base: Fit) -> float:
    """Return the quantile of a curved family over that of a straight one, at least 1.

    Parameters
    ----------
    problem, levels : what was fitted
    line : fits along the family, in order, the base among them
    base : the fit from which angles are measured
    """
    start = next(number for number, fit in enumerate(line) if fit is base)
    products = _differences(problem, levels, line, base)
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


def _differences(problem: Problem, levels: Levels, line: list[Fit], base: Fit) -> Floats:
    """Return the Gram matrix of differences of all fits from one, in units of the noise."""
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
        total += compute_whitened_products(curve, columns, slope, levels.correlation) / levels.noise
    rests = np.stack([_weighed(problem, levels, fit, base) for fit in line], axis=1)
    return np.asarray(total + rests.T @ rests)


def _weighed(problem: Problem, levels: Levels, fit: Fit, base: Fit) -> Floats:
    """Return the differences of priors, gain and offsets, over their standard deviations."""
    here, there = base.point, fit.point
    rests = [np.sqrt(problem.precision) * (there.logs - here.logs)]
    if problem.gain > 0.0:
        rests.append(np.array([(there.gain - here.gain) / problem.gain]))
    if levels.scatter > 0.0:
        rests.append((there.offsets - here.offsets) / levels.scatter)
    return np.concatenate(rests)
