"""Widening of intervals for a nonlinear family of curves.

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

from itertools import pairwise

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtr, ndtri

from labpipe.records.arrays import Floats
from labpipe.wire.calibration.law_components import whitened_products
from labpipe.wire.calibration.parameter_search import Fit, Levels, Problem

_ALARM_RATE = 0.05


def widening(problem: Problem, levels: Levels, line: list[Fit], base: Fit) -> float:
    """Return the quantile of a curved family over that of a straight one, at least 1.

    Parameters
    ----------
    problem, levels : what was fitted
    line : fits along the family, in order, the base among them
    base : the fit from which angles are measured
    """
    start = next(number for number, fit in enumerate(line) if fit is base)
    products = _differences(problem, levels, line, base)
    angle = swept(products, range(start - 1, -1, -1)) + swept(products, range(start + 1, len(line)))
    return tube_quantile(angle) / float(ndtri(1.0 - 0.5 * _ALARM_RATE))


def tube_quantile(angle: float) -> float:
    """Return the root of the rise of the objective that is exceeded by chance in 5 % of all cases.

    Parameters
    ----------
    angle : rad, swept by the direction to the curves

    Examples
    --------
    >>> round(tube_quantile(0.0), 2), round(tube_quantile(np.pi), 2)
    (1.96, 2.35)
    """

    def excess(q: float) -> float:
        return float(2.0 * ndtr(-q) + angle / (2.0 * np.pi) * np.exp(-0.5 * q * q)) - _ALARM_RATE

    return float(brentq(excess, 1.9, 10.0))


def swept(products: Floats, stretch: range) -> float:
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
        total += whitened_products(curve, columns, slope, levels.correlation) / levels.noise
    rests = np.stack([_weighed(problem, levels, fit, base) for fit in line], axis=1)
    return np.asarray(total + rests.T @ rests)


def _weighed(problem: Problem, levels: Levels, fit: Fit, base: Fit) -> Floats:
    """Return the differences of priors, gain and offsets, over their standard deviations."""
    base_point, fit_point = base.point, fit.point
    rests = [np.sqrt(problem.precision) * (fit_point.logs - base_point.logs)]
    if problem.gain > 0.0:
        rests.append(np.array([(fit_point.gain - base_point.gain) / problem.gain]))
    if levels.scatter > 0.0:
        rests.append((fit_point.offsets - base_point.offsets) / levels.scatter)
    return np.concatenate(rests)
