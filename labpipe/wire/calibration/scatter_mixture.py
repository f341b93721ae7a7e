"""Intervals averaged over the possible scatter of a few samples.

Two or three samples hardly determine the scatter of samples, which decides how much a parameter
depends on their mean rather than on the shape of the curves. So the scatter is not treated as
known: in the linear model at the minimum of the objective every scatter has its restricted
likelihood, its estimate of the parameters and its covariance, and a parameter's distribution is the
mixture of Student's t over them (as in `uncertainty.linear_fits`). Where the interval depends on
the mean of n samples alone this is Student's t with n - 1 degrees of freedom.
"""

from __future__ import annotations

import numpy as np
from scipy.special import stdtr, stdtrit

from labpipe.records.arrays import Flags, Floats
from labpipe.records.wire_calibration import ScatterMixture
from labpipe.wire.calibration.parameter_search import Fit, Levels, P, Problem
from labpipe.wire.calibration.variances import LinearModel, linear_model

TAIL = 0.025
"""Probability outside the interval, on each side."""


def quantiles(
    mixture: ScatterMixture, directions: Floats, one_more: Floats | float = 0.0
) -> tuple[Floats, Floats]:
    """Return 2.5 and 97.5 % quantiles of linear combinations, relative to the fit.

    Parameters
    ----------
    mixture : of the fit
    directions : shape (n, 4), of the logarithms of parameters and gain
    one_more : shape (n,), derivative by the factor of one more sample; 0 for none

    Returns
    -------
    Lower and upper, shape (n,) each.

    Notes
    -----
    By bisection: the distribution is a sum of Student's t, each with its own location and width.
    """
    halvings = 40
    centre = directions @ mixture.shift.T
    variance = np.einsum("ni,sij,nj->ns", directions, mixture.covariance, directions)
    sample_error = np.broadcast_to(one_more, len(directions))[:, None] * mixture.scatter
    error = np.sqrt(np.maximum(variance, 0.0) + sample_error**2)
    error = np.maximum(error, 1e-9 * error.max(axis=1, keepdims=True) + 1e-300)
    reach = stdtrit(mixture.freedom, 1.0 - 1e-4 * mixture.chance.min()) * error
    lowest, highest = (centre - reach).min(axis=1), (centre + reach).max(axis=1)

    def quantile_at(share: float) -> Floats:
        low, high = lowest, highest
        for _ in range(halvings):
            middle = 0.5 * (low + high)
            below = stdtr(mixture.freedom, (middle[:, None] - centre) / error) @ mixture.chance
            low, high = np.where(below < share, middle, low), np.where(below < share, high, middle)
        return np.asarray(0.5 * (low + high))

    return quantile_at(TAIL), quantile_at(1.0 - TAIL)


def mix(
    problem: Problem, fit: Fit, free: Flags, levels: Levels, *, is_scatter_known: bool
) -> ScatterMixture:
    """Weight every scatter by its restricted likelihood.

    Parameters
    ----------
    problem, fit, free, levels : what was fitted
    is_scatter_known : given rather than estimated, or not available from one sample

    Notes
    -----
    The prior is uniform in the logarithm of the scatter, from three tenths of the scatter of one
    sample's factor by noise; below, scatter has no effect.
    """
    min_probability = 1e-6  # of a scatter
    linear = linear_model(problem, fit, free)
    freedom = float(linear.n - len(linear.columns))
    ratios = (
        _variance_ratios(linear, levels)
        if not is_scatter_known
        else np.array([levels.scatter**2 / levels.noise])
    )
    estimates = [linear.estimate(float(ratio)) for ratio in ratios]
    heights = np.array([height for _, height in estimates])
    chance = np.exp(-0.5 * (heights - heights.min()))
    solved = [
        _solve(problem, fit, free, linear.shrunk(float(ratio)).sum(axis=0) / noise)
        for (noise, _), ratio in zip(estimates, ratios, strict=True)
    ]
    likely = chance / chance.sum()
    is_likely = likely > min_probability
    return ScatterMixture(
        likely[is_likely] / likely[is_likely].sum(),
        np.sqrt(ratios * [noise for noise, _ in estimates])[is_likely],
        np.array([shift for shift, _ in solved])[is_likely],
        np.array([covariance for _, covariance in solved])[is_likely],
        freedom,
    )


def _variance_ratios(linear: LinearModel, levels: Levels) -> Floats:
    """Return the grid of scatter over noise, as variances."""
    least_noise_share = 0.3  # of the scatter that noise makes of the factor of one sample
    max_scatter_factor = 1000.0  # times the estimated scatter
    n_scatters = 64
    least_scatter = float(np.median(linear.grams[:, P, P])) ** -0.5
    max_ratio = max(levels.scatter / np.sqrt(levels.noise), least_scatter) * max_scatter_factor
    return np.geomspace(least_noise_share * least_scatter, max_ratio, n_scatters) ** 2


def _solve(problem: Problem, fit: Fit, free: Flags, total: Floats) -> tuple[Floats, Floats]:
    """Return shift from the fit and covariance from whitened products, with priors and gain."""
    moves = np.append(free, problem.gain > 0.0)
    tight = np.append(problem.precision, problem.gain**-2.0 if problem.gain > 0.0 else 0.0)
    deviations = np.append(fit.point.logs - problem.centre, fit.point.gain)
    matrix, pull = total[: P + 1, : P + 1].copy(), total[: P + 1, -1] - tight * deviations
    matrix[range(P + 1), range(P + 1)] += tight
    shift, covariance = np.zeros(P + 1), np.zeros((P + 1, P + 1))
    if moves.any():
        inner = matrix[np.ix_(moves, moves)]
        scale = np.sqrt(np.maximum(np.diag(inner), 1e-30))
        unit = inner / np.outer(scale, scale) + 1e-12 * np.eye(len(scale))
        inverse = np.linalg.inv(unit) / np.outer(scale, scale)
        covariance[np.ix_(moves, moves)] = inverse
        shift[moves] = inverse @ pull[moves]
    return shift, covariance
