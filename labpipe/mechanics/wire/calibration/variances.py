"""Variances of noise and samples with their uncertainty, and the covariance of the parameters.

At the minimum of the objective the model is linear in parameters and factors, and every sum over
points is in the samples' Gram matrices. Scatter of samples and noise are estimated by restricted
maximum likelihood (Patterson and Thompson, Biometrika 58 (1971) 545) with a free mean factor, so
that the scatter is that between samples, independent of the load cell's gain and of priors. The
degrees of freedom of a parameter's variance, which consists of both, are Satterthwaite's
(Biometrics Bull. 2 (1946) 110): 2 C^2 / var(C), as in Kenward and Roger (Biometrics 53 (1997) 983).

Two or three samples hardly determine the scatter of samples, which decides how much a parameter
depends on their mean rather than on the shape of the curves. Therefore intervals average over the
possible scatters: in the linear model at the minimum of the objective every scatter has its
restricted likelihood, its estimate of the parameters and its covariance, and the distribution of a
parameter is the mixture of Student's t over them. If the interval depends on the mean of n samples
alone, this is Student's t with n - 1 degrees of freedom.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import elementwise, minimize_scalar
from scipy.special import stdtr, stdtrit

from labpipe.mechanics.wire.calibration.measured_curves import compute_shared_errors
from labpipe.mechanics.wire.calibration.objective import Fit, Levels, P, scale_matrix
from labpipe.records.arrays import Floats
from labpipe.records.wire import ScatterMixture

_LOG_VARIANCE_STEP = 0.02  # of logarithms of variances, for their derivatives


@dataclass(frozen=True, slots=True, eq=False)
class Uncertainty:
    """Covariance of the logarithms of parameters and the gain, and its dependence on the levels.

    Parameters
    ----------
    covariance : shape (4, 4); 0 for parameters that are not free
    by_level : shape (2, 4, 4), derivatives by the logarithms of the variances of noise and samples
    level_covariance : shape (2, 2), covariance of the estimates of these logarithms
    """

    covariance: Floats
    by_level: Floats
    level_covariance: Floats

    def compute_freedom(self, direction: Floats) -> float:
        """Return the degrees of freedom of the variance of a linear combination, shape (4,)."""
        variance = float(direction @ self.covariance @ direction)
        slopes = self.by_level @ direction @ direction
        variance_of_variance = float(slopes @ self.level_covariance @ slopes)
        return 2.0 * variance**2 / variance_of_variance if variance_of_variance > 0.0 else np.inf


def estimate_correlation(fit: Fit) -> float:
    """Estimate the correlation of neighbouring residuals over all curves, from 0 to 0.98.

    Errors shared by all points of a curve are estimated and removed first.
    """
    max_correlation = 0.98
    products = squares = 0.0
    for curve, model, factor in zip(fit.problem.curves, fit.models, fit.factors, strict=True):
        noise = np.asarray(curve.noise)
        residuals = (curve.force - factor * model.force) / noise
        shared = compute_shared_errors(curve, model.slope) / noise
        capacitance = np.eye(len(shared)) + shared @ shared.T
        residuals -= np.linalg.solve(capacitance, shared @ residuals) @ shared
        products += float(residuals[1:] @ residuals[:-1])
        squares += float(residuals @ residuals)
    return float(np.clip(products / squares, 0.0, max_correlation)) if squares > 0.0 else 0.0


@dataclass(frozen=True, slots=True, eq=False)
class LinearModel:
    """The linear model at the fit, as whitened products of each sample.

    Parameters
    ----------
    grams : shape (samples, 5, 5), products of derivatives, model and residual; the residual
        includes the offset of the sample
    columns : numbers of the unknowns: free parameters and the mean factor
    n : number of points
    """

    grams: Floats
    columns: list[int]
    n: int

    def shrunk(self, ratio: float) -> Floats:
        """Return the products for a variance of samples that is `ratio` times that of noise."""
        sample_products = self.grams[:, P, :]
        weights = ratio / (1.0 + ratio * self.grams[:, P, P])
        return np.asarray(
            self.grams
            - weights[:, None, None] * sample_products[:, :, None] * sample_products[:, None, :]
        )

    def estimate(self, ratio: float) -> tuple[float, float]:
        """Return the noise variance at a ratio, and minus twice the log restricted likelihood."""
        total = self.shrunk(ratio).sum(axis=0)
        inner = total[np.ix_(self.columns, self.columns)]
        unit, scale = scale_matrix(inner)
        pull = total[self.columns, -1] / scale
        residual = float(total[-1, -1] - pull @ np.linalg.solve(unit, pull))
        freedom = self.n - len(self.columns)
        noise = max(residual, 1e-300) / freedom
        logs = np.log1p(ratio * self.grams[:, P, P]).sum()
        logs += np.linalg.slogdet(unit)[1] + 2.0 * np.log(scale).sum()
        return noise, float(freedom * np.log(noise) + logs)


def estimate_levels(fit: Fit, correlation: float) -> Levels:
    """Estimate noise and scatter at the minimum of the objective; no scatter for one sample.

    Parameters
    ----------
    fit : fit at the minimum
    correlation : correlation of neighbours for which the products of the fit are whitened
    """
    log_ratios = (-6.0, 14.0, 41)  # of scatter^2 times information over noise: first, last, number
    linear, scatter = make_linear_model(fit), fit.problem.scatter
    if scatter is None and fit.problem.n_samples == 1:
        scatter = 0.0
    if scatter is not None:
        noise = linear.estimate(0.0)[0]
        for _ in range(3):
            noise = linear.estimate(scatter**2 / noise)[0]
        return Levels(noise, correlation, scatter)
    information = float(np.median(linear.grams[:, P, P]))

    def deviance(log_ratio: float) -> float:
        return linear.estimate(float(np.exp(log_ratio)) / information)[1]

    grid = np.linspace(*log_ratios)
    best = int(np.argmin([deviance(log_ratio) for log_ratio in grid]))
    bracket = grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)]
    optimum = minimize_scalar(deviance, bounds=bracket, method="bounded", options={"xatol": 1e-3})
    ratio = float(np.exp(optimum.x)) / information
    noise = linear.estimate(ratio)[0]
    return Levels(noise, correlation, float(np.sqrt(ratio * noise)))


def make_linear_model(fit: Fit) -> LinearModel:
    """Return the linear model of a fit, with the offset of each sample added to its residual."""
    grams, offsets = fit.grams.copy(), fit.unknowns[P + 1 :]
    shift = offsets[:, None] * fit.grams[:, P, :]
    grams[:, :, -1] += shift
    grams[:, -1, :] += shift
    grams[:, -1, -1] += offsets**2 * fit.grams[:, P, P]
    columns = [*np.flatnonzero(fit.problem.free).tolist(), P]
    return LinearModel(grams, columns, fit.problem.n_points)


def estimate_uncertainty(fit: Fit) -> Uncertainty:
    """Estimate the covariance of a fit, and its derivatives for the degrees of freedom."""
    linear = make_linear_model(fit)

    def covariance(noise: float, samples: float) -> Floats:
        total = linear.shrunk(samples / noise).sum(axis=0) / noise
        return _compute_posterior(fit, total)[1]

    noise, samples = fit.levels.noise, fit.levels.scatter**2
    up, down = np.exp(_LOG_VARIANCE_STEP), np.exp(-_LOG_VARIANCE_STEP)
    by_noise = covariance(noise * up, samples) - covariance(noise * down, samples)
    by_samples = covariance(noise, samples * up) - covariance(noise, samples * down)
    by_level = np.stack([by_noise, by_samples]) / (2.0 * _LOG_VARIANCE_STEP)
    is_known = fit.problem.scatter is not None or samples == 0.0
    level_covariance = _compute_level_covariance(linear, noise, samples, is_scatter_known=is_known)
    return Uncertainty(covariance(noise, samples), by_level, level_covariance)


def _compute_posterior(fit: Fit, total: Floats) -> tuple[Floats, Floats]:
    """Return shift from the fit and covariance from whitened products, with priors and gain."""
    problem = fit.problem
    is_free = np.append(problem.free, problem.gain > 0.0)
    precision = np.where(is_free, problem.compute_precision(0.0)[: P + 1], 0.0)
    offsets = problem.compute_offsets(fit.unknowns)[: P + 1]
    matrix, pull = total[: P + 1, : P + 1].copy(), total[: P + 1, -1] - precision * offsets
    matrix[range(P + 1), range(P + 1)] += precision
    shift, covariance = np.zeros(P + 1), np.zeros((P + 1, P + 1))
    if is_free.any():
        unit, scale = scale_matrix(matrix[np.ix_(is_free, is_free)])
        inverse = np.linalg.inv(unit) / np.outer(scale, scale)
        covariance[np.ix_(is_free, is_free)] = inverse
        shift[is_free] = inverse @ pull[is_free]
    return shift, covariance


def _compute_level_covariance(
    linear: LinearModel, noise: float, samples: float, *, is_scatter_known: bool
) -> Floats:
    """Return the covariance of the log variances from the expected restricted information."""
    freedom = linear.n - len(linear.columns)
    if is_scatter_known:
        return np.diag([2.0 / freedom, 0.0])
    up, down = np.exp(_LOG_VARIANCE_STEP), np.exp(-_LOG_VARIANCE_STEP)

    def trace(noise_factor: float, scatter_factor: float) -> float:
        return float(np.trace(_project(linear, noise * noise_factor, samples * scatter_factor)))

    # P scales as the inverse of both variances: trace(Z'PZ) falls by itself, in part by each.
    slope = (trace(up, up) - trace(down, down)) / (2.0 * _LOG_VARIANCE_STEP)
    alone = (trace(1.0, up) - trace(1.0, down)) / (2.0 * _LOG_VARIANCE_STEP)
    scatter_term = float(np.sum(_project(linear, noise, samples) ** 2)) * samples**2
    cross = -(slope - alone) * samples
    white = freedom - scatter_term - 2.0 * cross
    information = 0.5 * np.array([[white, cross], [cross, scatter_term]])
    return np.asarray(np.linalg.inv(information))


def _project(linear: LinearModel, noise: float, samples: float) -> Floats:
    """Return Z' P Z, shape (samples, samples); P projects for the restricted likelihood."""
    shrunk = linear.shrunk(samples / noise) / noise
    total = shrunk.sum(axis=0)
    inner = total[np.ix_(linear.columns, linear.columns)]
    unit, scale = scale_matrix(inner)
    arms = shrunk[:, P, linear.columns] / scale
    return np.asarray(np.diag(shrunk[:, P, P]) - arms @ np.linalg.solve(unit, arms.T))


def compute_quantiles(
    mixture: ScatterMixture, directions: Floats, one_more: Floats | float = 0.0
) -> tuple[Floats, Floats]:
    """Return 2.5 and 97.5 % quantiles of linear combinations, relative to the fit.

    Parameters
    ----------
    mixture : mixture of the fit
    directions : shape (n, 4), coefficients of the logarithms of parameters and of the gain
    one_more : shape (n,), derivative by the factor of one more sample; 0 without

    Returns
    -------
    Lower and upper quantiles, shape (n,) each.

    Notes
    -----
    The distribution is a sum of Student's t, each with its own location and width.
    """
    tail = 0.025  # probability outside the interval, on each side
    centre = directions @ mixture.shift.T
    variance = np.einsum("ni,sij,nj->ns", directions, mixture.covariance, directions)
    sample_error = np.broadcast_to(one_more, len(directions))[:, None] * mixture.scatter
    error = np.sqrt(np.maximum(variance, 0.0) + sample_error**2)
    error = np.maximum(error, 1e-9 * error.max(axis=1, keepdims=True) + 1e-300)
    half_range = stdtrit(mixture.freedom, 1.0 - 1e-4 * mixture.chance.min()) * error
    lower, upper = (centre - half_range).min(axis=1), (centre + half_range).max(axis=1)

    def quantile_at(share: float) -> Floats:
        def excess(value: Floats, row: Floats) -> Floats:
            numbers = row.astype(np.int64)
            t = (value[:, None] - centre[numbers]) / error[numbers]
            return np.asarray(stdtr(mixture.freedom, t) @ mixture.chance - share)

        rows = np.arange(len(lower), dtype=np.float64)
        return np.asarray(elementwise.find_root(excess, (lower, upper), args=(rows,)).x)

    return quantile_at(tail), quantile_at(1.0 - tail)


def make_mixture(fit: Fit) -> ScatterMixture:
    """Weight scatters by their restricted likelihood; one alone if it is stated, or for one sample.

    Notes
    -----
    The prior is uniform in the logarithm of the scatter, from three tenths of the scatter of one
    sample's factor by noise; below, scatter has no effect.
    """
    min_probability = 1e-6  # of a scatter
    linear, levels = make_linear_model(fit), fit.levels
    freedom = float(linear.n - len(linear.columns))
    ratios = np.array([levels.scatter**2 / levels.noise])
    if fit.problem.scatter is None and fit.problem.n_samples > 1:
        ratios = _space_variance_ratios(linear, levels)
    estimates = [linear.estimate(float(ratio)) for ratio in ratios]
    deviances = np.array([deviance for _, deviance in estimates])
    likelihood = np.exp(-0.5 * (deviances - deviances.min()))
    solved = [
        _compute_posterior(fit, linear.shrunk(float(ratio)).sum(axis=0) / noise)
        for (noise, _), ratio in zip(estimates, ratios, strict=True)
    ]
    chance = likelihood / likelihood.sum()
    is_likely = chance > min_probability
    return ScatterMixture(
        chance[is_likely] / chance[is_likely].sum(),
        np.sqrt(ratios * [noise for noise, _ in estimates])[is_likely],
        np.array([shift for shift, _ in solved])[is_likely],
        np.array([covariance for _, covariance in solved])[is_likely],
        freedom,
    )


def _space_variance_ratios(linear: LinearModel, levels: Levels) -> Floats:
    """Return the grid of scatter over noise, as variances."""
    least_noise_share = 0.3  # of the scatter of one sample's factor by noise
    max_scatter_factor = 1000.0  # times the estimated scatter
    n_scatters = 64
    least_scatter = float(np.median(linear.grams[:, P, P])) ** -0.5
    largest = max(levels.scatter / np.sqrt(levels.noise), least_scatter) * max_scatter_factor
    return np.geomspace(least_noise_share * least_scatter, largest, n_scatters) ** 2
