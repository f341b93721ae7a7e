"""Estimate the variances of noise and samples, and the covariance of calibrated parameters.

At the minimum of the objective the model is linearised in parameters and factors. The Gram matrices
of the samples then contain all required sums over points. Noise and scatter of samples are
estimated by restricted maximum likelihood [1]_, with the mean factor of the samples as an unknown.
The estimated scatter is therefore that between samples, independent of priors and of the gain of
the load cell. The variance C of a parameter depends on noise and scatter. The degrees of freedom of
C are those of Satterthwaite, 2 C^2 / var(C) [2]_ [3]_.

Two or three samples hardly determine the scatter of samples. The scatter determines whether a
parameter depends more on the mean of the samples or on the shape of the curves. Intervals are
therefore averages over the possible scatters. In the linear model, each scatter has a restricted
likelihood, an estimate of the parameters and a covariance. The distribution of a parameter is the
mixture of the corresponding Student's t distributions. If a parameter depends only on the mean of n
samples, the mixture is Student's t with n - 1 degrees of freedom.

References
----------
.. [1] H. D. Patterson and R. Thompson, Biometrika 58 (1971) 545.
.. [2] F. E. Satterthwaite, Biometrics Bull. 2 (1946) 110.
.. [3] M. G. Kenward and J. H. Roger, Biometrics 53 (1997) 983.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import elementwise, minimize_scalar
from scipy.special import stdtr, stdtrit

from labpipe.mechanics.wire.calibration.measured_curves import compute_shared_errors
from labpipe.mechanics.wire.calibration.objective import Fit, Levels, P, scale_matrix
from labpipe.records.arrays import Floats
from labpipe.records.wire import ScatterMixture

_LOG_VARIANCE_STEP = 0.02
"""Step of the logarithms of variances for numerical derivatives."""


@dataclass(frozen=True, slots=True, eq=False)
class Uncertainty:
    """Covariance of the logarithms of parameters and gain, and its dependence on the levels.

    Parameters
    ----------
    covariance : shape (4, 4), covariance; 0 for unknowns that are fixed
    covariance_by_level : shape (2, 4, 4), derivatives of the covariance with respect to the
        logarithms of the variances of noise and samples
    level_covariance : shape (2, 2), covariance of the estimates of these logarithms
    """

    covariance: Floats
    covariance_by_level: Floats
    level_covariance: Floats

    def compute_freedom(self, direction: Floats) -> float:
        """Compute the degrees of freedom of the variance of a linear combination.

        `direction` has the coefficients of the combination, shape (4,).
        """
        variance = float(direction @ self.covariance @ direction)
        slopes = self.covariance_by_level @ direction @ direction
        variance_of_variance = float(slopes @ self.level_covariance @ slopes)
        return 2.0 * variance**2 / variance_of_variance if variance_of_variance > 0.0 else np.inf


def estimate_correlation(fit: Fit) -> float:
    """Estimate the correlation of neighbouring residuals over all curves, from 0 to 0.98.

    Errors that all points of a curve share are first estimated and removed.
    """
    max_correlation = 0.98
    products = squares = 0.0
    for curve, model, factor in zip(fit.problem.curves, fit.model_forces, fit.factors, strict=True):
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
    """Model that is linearised at a fit, as whitened products of each sample.

    Parameters
    ----------
    grams : shape (samples, 5, 5), products of derivatives, model and residual, as in `Fit`; the
        residual includes the offset of the sample
    columns : indices of the unknowns: fitted parameters and the mean factor
    n_points : number of points of all curves
    """

    grams: Floats
    columns: list[int]
    n_points: int

    @property
    def freedom(self) -> int:
        """Number of points minus the number of unknowns."""
        return self.n_points - len(self.columns)

    def compute_products(self, ratio: float) -> Floats:
        """Compute the products for a variance of samples of `ratio` times that of noise.

        The shape is (samples, 5, 5).
        """
        by_factor = self.grams[:, P, :]
        weights = ratio / (1.0 + ratio * self.grams[:, P, P])
        return self.grams - weights[:, None, None] * by_factor[:, :, None] * by_factor[:, None, :]

    def estimate_noise(self, ratio: float) -> tuple[float, float]:
        """Estimate the variance of noise, and compute -2 times the log restricted likelihood.

        `ratio` is the variance of samples relative to that of noise.
        """
        total = self.compute_products(ratio).sum(axis=0)
        unit, scale = scale_matrix(total[np.ix_(self.columns, self.columns)])
        right_side = total[self.columns, -1] / scale
        squares = float(total[-1, -1] - right_side @ np.linalg.solve(unit, right_side))
        noise = max(squares, 1e-300) / self.freedom
        log_determinant = np.log1p(ratio * self.grams[:, P, P]).sum()
        log_determinant += np.linalg.slogdet(unit)[1] + 2.0 * np.log(scale).sum()
        return noise, float(self.freedom * np.log(noise) + log_determinant)


def estimate_levels(fit: Fit, correlation: float) -> Levels:
    """Estimate noise and scatter at the minimum of the objective; a scatter of 0 for one sample.

    Parameters
    ----------
    fit : fit at the minimum
    correlation : correlation of neighbouring points with which the Gram matrices of the fit were
        whitened
    """
    # Logarithms of the ratio of scatter^2 to the variance of a factor due to noise.
    log_ratios = np.linspace(-6.0, 14.0, 41)
    linear, scatter = make_linear_model(fit), fit.problem.scatter
    if scatter is None and fit.problem.n_samples == 1:
        scatter = 0.0
    if scatter is not None:
        noise = linear.estimate_noise(0.0)[0]
        for _ in range(3):
            noise = linear.estimate_noise(scatter**2 / noise)[0]
        return Levels(noise, correlation, scatter)
    information = float(np.median(linear.grams[:, P, P]))

    def compute_deviance(log_ratio: float) -> float:
        return linear.estimate_noise(float(np.exp(log_ratio)) / information)[1]

    best = int(np.argmin([compute_deviance(log_ratio) for log_ratio in log_ratios]))
    bracket = log_ratios[max(best - 1, 0)], log_ratios[min(best + 1, len(log_ratios) - 1)]
    optimum = minimize_scalar(
        compute_deviance, bounds=bracket, method="bounded", options={"xatol": 1e-3}
    )
    ratio = float(np.exp(optimum.x)) / information
    noise = linear.estimate_noise(ratio)[0]
    return Levels(noise, correlation, float(np.sqrt(ratio * noise)))


def make_linear_model(fit: Fit) -> LinearModel:
    """Build the linear model of a fit, with the offset of each sample added to the residual."""
    grams, offsets = fit.grams.copy(), fit.unknowns[P + 1 :]
    shift = offsets[:, None] * fit.grams[:, P, :]
    grams[:, :, -1] += shift
    grams[:, -1, :] += shift
    grams[:, -1, -1] += offsets**2 * fit.grams[:, P, P]
    columns = [*np.flatnonzero(fit.problem.is_free).tolist(), P]
    return LinearModel(grams, columns, fit.problem.n_points)


def estimate_uncertainty(fit: Fit) -> Uncertainty:
    """Estimate the covariance of a fit, and its derivatives for the degrees of freedom."""
    linear = make_linear_model(fit)

    def compute_covariance(noise_factor: float, sample_factor: float) -> Floats:
        noise, samples = noise_factor * fit.levels.noise, sample_factor * fit.levels.scatter**2
        total = linear.compute_products(samples / noise).sum(axis=0) / noise
        return _compute_posterior(fit, total)[1]

    by_level = [_differentiate(compute_covariance, *level) for level in ((1.0, 0.0), (0.0, 1.0))]
    covariance_by_level = np.stack(by_level)
    is_known = fit.problem.scatter is not None or fit.levels.scatter == 0.0
    level_covariance = _compute_level_covariance(linear, fit.levels, is_scatter_known=is_known)
    return Uncertainty(compute_covariance(1.0, 1.0), covariance_by_level, level_covariance)


def _differentiate(
    compute: Callable[[float, float], Floats], noise_weight: float, sample_weight: float
) -> Floats:
    """Differentiate a function of factors on both variances, with respect to their logarithms."""
    log_changes = _LOG_VARIANCE_STEP * np.array([noise_weight, sample_weight])
    difference = compute(*np.exp(log_changes).tolist()) - compute(*np.exp(-log_changes).tolist())
    return np.asarray(difference / (2.0 * _LOG_VARIANCE_STEP))


def _compute_posterior(fit: Fit, total: Floats) -> tuple[Floats, Floats]:
    """Compute the shift of parameters and gain from the fit, shape (4,), and their covariance.

    Both follow from the priors and from the sum of the whitened products, shape (5, 5). The
    covariance has the shape (4, 4).
    """
    problem = fit.problem
    is_free = np.append(problem.is_free, problem.gain_uncertainty > 0.0)
    precision = np.where(is_free, problem.compute_precision(0.0)[: P + 1], 0.0)
    offsets = problem.compute_offsets(fit.unknowns)[: P + 1]
    matrix, right_side = total[: P + 1, : P + 1].copy(), total[: P + 1, -1] - precision * offsets
    matrix[range(P + 1), range(P + 1)] += precision
    shift, covariance = np.zeros(P + 1), np.zeros((P + 1, P + 1))
    if is_free.any():
        unit, scale = scale_matrix(matrix[np.ix_(is_free, is_free)])
        inverse = np.linalg.inv(unit) / np.outer(scale, scale)
        covariance[np.ix_(is_free, is_free)] = inverse
        shift[is_free] = inverse @ right_side[is_free]
    return shift, covariance


def _compute_level_covariance(
    linear: LinearModel, levels: Levels, *, is_scatter_known: bool
) -> Floats:
    """Compute the covariance of the log variances of noise and samples, shape (2, 2).

    It is the inverse of the expected information of the restricted likelihood.
    """
    if is_scatter_known:
        return np.diag([2.0 / linear.freedom, 0.0])
    noise, samples = levels.noise, levels.scatter**2

    def compute_trace(noise_factor: float, sample_factor: float) -> Floats:
        return np.asarray(np.trace(_project(linear, noise * noise_factor, samples * sample_factor)))

    # The projection is inversely proportional to a common factor of both variances. The derivative
    # of the trace with respect to noise is the derivative with respect to both minus that with
    # respect to the samples.
    by_both = float(_differentiate(compute_trace, 1.0, 1.0))
    by_samples = float(_differentiate(compute_trace, 0.0, 1.0))
    samples_term = float(np.sum(_project(linear, noise, samples) ** 2)) * samples**2
    cross_term = -(by_both - by_samples) * samples
    noise_term = linear.freedom - samples_term - 2.0 * cross_term
    information = 0.5 * np.array([[noise_term, cross_term], [cross_term, samples_term]])
    return np.asarray(np.linalg.inv(information))


def _project(linear: LinearModel, noise: float, samples: float) -> Floats:
    """Return Z' P Z, shape (samples, samples), with the projection P of restricted likelihood."""
    products = linear.compute_products(samples / noise) / noise
    total = products.sum(axis=0)
    unit, scale = scale_matrix(total[np.ix_(linear.columns, linear.columns)])
    cross = products[:, P, linear.columns] / scale
    return np.asarray(np.diag(products[:, P, P]) - cross @ np.linalg.solve(unit, cross.T))


def compute_quantiles(
    mixture: ScatterMixture, directions: Floats, sample_slope: Floats | float = 0.0
) -> tuple[Floats, Floats]:
    """Compute 2.5 % and 97.5 % quantiles of linear combinations, relative to the fit.

    Parameters
    ----------
    mixture : mixture of the fit
    directions : shape (n, 4), coefficients of the logarithms of parameters and of the gain
    sample_slope : shape (n,), derivative of the combinations with respect to the logarithm of the
        factor of a further sample; 0 without a further sample

    Returns
    -------
    Lower and upper quantiles, shape (n,) each.

    Notes
    -----
    The distribution is a mixture of Student's t with different locations and widths.
    """
    tail = 0.025  # probability outside the interval, on each side
    centre = directions @ mixture.shift.T
    variance = np.einsum("ni,sij,nj->ns", directions, mixture.covariance, directions)
    sample_error = np.broadcast_to(sample_slope, len(directions))[:, None] * mixture.scatter
    error = np.sqrt(np.maximum(variance, 0.0) + sample_error**2)
    error = np.maximum(error, 1e-9 * error.max(axis=1, keepdims=True) + 1e-300)
    half_range = stdtrit(mixture.freedom, 1.0 - 1e-4 * mixture.chance.min()) * error
    lower, upper = (centre - half_range).min(axis=1), (centre + half_range).max(axis=1)
    rows = np.tile(np.arange(len(lower), dtype=np.float64), 2)
    probabilities = np.repeat([tail, 1.0 - tail], len(lower))

    def compute_excess(value: Floats, row: Floats, probability: Floats) -> Floats:
        indices = row.astype(np.int64)
        t = (value[:, None] - centre[indices]) / error[indices]
        return np.asarray(stdtr(mixture.freedom, t) @ mixture.chance - probability)

    ends, inputs = (np.tile(lower, 2), np.tile(upper, 2)), (rows, probabilities)
    quantiles = elementwise.find_root(compute_excess, ends, args=inputs).x
    return quantiles[: len(lower)], quantiles[len(lower) :]


def make_mixture(fit: Fit) -> ScatterMixture:
    """Make the mixture of possible scatters of samples, weighted by restricted likelihood.

    The mixture has one scatter if the scatter is stated, or for one sample.

    Notes
    -----
    The prior is uniform in the logarithm of the scatter. The smallest scatter is three tenths of
    the standard error due to noise of the factor of a sample. Smaller scatters have no effect.
    """
    min_probability = 1e-6  # smallest probability of a scatter that is included
    min_factor = 0.3  # smallest scatter relative to the noise error of the factor of a sample
    max_factor = 1000.0  # largest scatter relative to that error or to the estimated scatter
    n_scatters = 64
    linear, levels = make_linear_model(fit), fit.levels
    ratios = np.array([levels.scatter**2 / levels.noise])
    if fit.problem.scatter is None and fit.problem.n_samples > 1:
        noise_error = float(np.median(linear.grams[:, P, P])) ** -0.5
        largest = max_factor * max(levels.scatter / np.sqrt(levels.noise), noise_error)
        ratios = np.geomspace(min_factor * noise_error, largest, n_scatters) ** 2
    estimates = [linear.estimate_noise(float(ratio)) for ratio in ratios]
    deviances = np.array([deviance for _, deviance in estimates])
    likelihood = np.exp(-0.5 * (deviances - deviances.min()))
    posteriors = [
        _compute_posterior(fit, linear.compute_products(float(ratio)).sum(axis=0) / noise)
        for (noise, _), ratio in zip(estimates, ratios, strict=True)
    ]
    chance = likelihood / likelihood.sum()
    is_likely = chance > min_probability
    return ScatterMixture(
        chance[is_likely] / chance[is_likely].sum(),
        np.sqrt(ratios * [noise for noise, _ in estimates])[is_likely],
        np.array([shift for shift, _ in posteriors])[is_likely],
        np.array([covariance for _, covariance in posteriors])[is_likely],
        float(linear.freedom),
    )
