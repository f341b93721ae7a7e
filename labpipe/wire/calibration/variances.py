"""Variances of noise and samples with their uncertainty, and the covariance of the parameters.

At the minimum of the objective the model is linear in parameters and factors, and every sum over
points is in the samples' Gram matrices. Scatter of samples and noise are estimated by restricted
maximum likelihood (Patterson and Thompson, Biometrika 58 (1971) 545) with the mean factor left
free, so that it is the spread between samples, independent of the load cell's gain and of
priors. The degrees of freedom of a parameter's variance, which is made of both, are Satterthwaite's
(Biometrics Bull. 2 (1946) 110): 2 C^2 / var(C), as in Kenward and Roger (Biometrics 53 (1997) 983).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.special import stdtrit

from labpipe.records.arrays import Flags, Floats
from labpipe.wire.calibration.law_components import ModelForce
from labpipe.wire.calibration.measured_curves import MeasuredCurve, shared_errors
from labpipe.wire.calibration.parameter_search import Fit, Levels, P, Problem

_LOG_VARIANCE_STEP = 0.02  # of logarithms of variances, for their derivatives
_MATRIX_RIDGE = 1e-12


def quantile(freedom: float) -> float:
    """Return the two-sided 95 % quantile of t; the normal one for infinite degrees of freedom."""
    min_freedom = 1.0  # Satterthwaite's formula can give less for a few samples
    return float(stdtrit(min(max(freedom, min_freedom), 1e9), 0.975))


@dataclass(frozen=True, slots=True, eq=False)
class Uncertainty:
    """Covariance of the logarithms and the gain, and how it depends on the levels.

    Parameters
    ----------
    covariance : shape (4, 4); 0 for what is not free
    by_level : shape (2, 4, 4), derivatives by the logarithms of the variances of noise and samples
    level_covariance : shape (2, 2), of the estimates of those
    """

    covariance: Floats
    by_level: Floats
    level_covariance: Floats

    def freedom(self, direction: Floats) -> float:
        """Return the degrees of freedom of the variance of a linear combination, shape (4,)."""
        variance = float(direction @ self.covariance @ direction)
        slopes = self.by_level @ direction @ direction
        spread = float(slopes @ self.level_covariance @ slopes)
        return 2.0 * variance**2 / spread if spread > 0.0 else np.inf


def correlation_of(
    curves: tuple[MeasuredCurve, ...], models: list[ModelForce], factors: Floats
) -> float:
    """Estimate the correlation of neighbouring residuals over all curves, at least 0.

    Errors shared by all points of a curve are estimated and removed first.

    Parameters
    ----------
    curves, models : measured and modelled
    factors : shape (curves,), of each sample on the model
    """
    max_correlation = 0.98
    above = below = 0.0
    for curve, model, factor in zip(curves, models, factors, strict=True):
        noise = np.asarray(curve.noise)
        residuals = (curve.force - factor * model.force) / noise
        shared = shared_errors(curve, model.slope) / noise
        held = np.eye(len(shared)) + shared @ shared.T
        residuals -= np.linalg.solve(held, shared @ residuals) @ shared
        above += float(residuals[1:] @ residuals[:-1])
        below += float(residuals @ residuals)
    return float(np.clip(above / below, 0.0, max_correlation)) if below > 0.0 else 0.0


@dataclass(frozen=True, slots=True, eq=False)
class LinearModel:
    """The linear model at the fit, as whitened products of each sample.

    Parameters
    ----------
    grams : shape (samples, 5, 5), of derivatives, model and residual, the residual with the
        sample's own offset in it
    columns : unknowns: free parameters and the mean factor
    n : points
    """

    grams: Floats
    columns: list[int]
    n: int

    def shrunk(self, ratio: float) -> Floats:
        """Return the products for a scatter of `ratio` times the noise, both as variances."""
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
        scale = np.sqrt(np.diag(inner))
        unit = inner / np.outer(scale, scale) + _MATRIX_RIDGE * np.eye(len(scale))
        pull = total[self.columns, -1] / scale
        residual = float(total[-1, -1] - pull @ np.linalg.solve(unit, pull))
        freedom = self.n - len(self.columns)
        noise = max(residual, 1e-300) / freedom
        logs = np.log1p(ratio * self.grams[:, P, P]).sum()
        logs += np.linalg.slogdet(unit)[1] + 2.0 * np.log(scale).sum()
        return noise, float(freedom * np.log(noise) + logs)


def estimate_levels(
    problem: Problem, fit: Fit, free: Flags, correlation: float, scatter: float | None
) -> Levels:
    """Estimate noise and scatter at the minimum of the objective.

    Parameters
    ----------
    problem, fit, free : what was fitted
    correlation : of neighbours, with which the fit's products are whitened
    scatter : if given; else it is estimated, and 0 for one sample
    """
    log_ratios = (-6.0, 14.0, 41)  # of scatter^2 times information over noise: first, last, number
    linear = linear_model(problem, fit, free)
    if scatter is None and problem.n_samples == 1:
        scatter = 0.0
    if scatter is not None:
        noise = linear.estimate(0.0)[0]
        for _ in range(3):
            noise = linear.estimate(scatter**2 / noise)[0]
        return Levels(noise, correlation, scatter)
    information = float(np.median(linear.grams[:, P, P]))
    grid = np.linspace(*log_ratios)
    heights = [linear.estimate(float(np.exp(log_level)) / information)[1] for log_level in grid]
    best = int(np.argmin(heights))
    bracket = grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)]
    optimum = minimize_scalar(
        lambda log_level: linear.estimate(float(np.exp(log_level)) / information)[1],
        bounds=bracket,
        method="bounded",
        options={"xatol": 1e-3},
    )
    ratio = float(np.exp(optimum.x)) / information
    noise = linear.estimate(ratio)[0]
    return Levels(noise, correlation, float(np.sqrt(ratio * noise)))


def linear_model(problem: Problem, fit: Fit, free: Flags) -> LinearModel:
    """Return the linear model of a fit, with each sample's offset added back to its residual."""
    grams = fit.grams.copy()
    shift = fit.point.offsets[:, None] * fit.grams[:, P, :]
    grams[:, :, -1] += shift
    grams[:, -1, :] += shift
    grams[:, -1, -1] += fit.point.offsets**2 * fit.grams[:, P, P]
    columns = [*np.flatnonzero(free).tolist(), P]
    return LinearModel(grams, columns, problem.n_points)


def uncertainty(
    problem: Problem, fit: Fit, free: Flags, levels: Levels, *, is_scatter_known: bool
) -> Uncertainty:
    """Return the covariance of the fit, with what Satterthwaite's degrees of freedom need.

    Parameters
    ----------
    problem, fit, free, levels : what was fitted, and the levels it was fitted with
    is_scatter_known : given rather than estimated
    """
    linear = linear_model(problem, fit, free)

    def covariance(noise: float, samples: float) -> Floats:
        return _covariance(problem, linear, free, noise, samples)

    noise, samples = levels.noise, levels.scatter**2
    up, down = np.exp(_LOG_VARIANCE_STEP), np.exp(-_LOG_VARIANCE_STEP)
    by_noise = covariance(noise * up, samples) - covariance(noise * down, samples)
    by_samples = covariance(noise, samples * up) - covariance(noise, samples * down)
    by_level = np.stack([by_noise, by_samples]) / (2.0 * _LOG_VARIANCE_STEP)
    is_known = is_scatter_known or levels.scatter == 0.0
    spread = _level_covariance(linear, noise, samples, is_scatter_known=is_known)
    return Uncertainty(covariance(noise, samples), by_level, spread)


def _covariance(
    problem: Problem, linear: LinearModel, free: Flags, noise: float, samples: float
) -> Floats:
    total = linear.shrunk(samples / noise).sum(axis=0) / noise
    moves = np.append(free, problem.gain > 0.0)
    matrix = total[: P + 1, : P + 1].copy()
    tight = np.append(problem.precision, 1.0 / problem.gain**2 if problem.gain > 0.0 else 0.0)
    matrix[range(P + 1), range(P + 1)] += tight
    out = np.zeros((P + 1, P + 1))
    if moves.any():
        inner = matrix[np.ix_(moves, moves)]
        scale = np.sqrt(np.maximum(np.diag(inner), 1e-30))
        unit = inner / np.outer(scale, scale) + _MATRIX_RIDGE * np.eye(len(scale))
        out[np.ix_(moves, moves)] = np.linalg.inv(unit) / np.outer(scale, scale)
    return out


def _level_covariance(
    linear: LinearModel, noise: float, samples: float, *, is_scatter_known: bool
) -> Floats:
    """Return the covariance of the log variances from the expected restricted information."""
    freedom = linear.n - len(linear.columns)
    if is_scatter_known:
        return np.diag([2.0 / freedom, 0.0])
    here = _projected(linear, noise, samples)
    up, down = np.exp(_LOG_VARIANCE_STEP), np.exp(-_LOG_VARIANCE_STEP)
    slope = (
        np.trace(_projected(linear, noise * up, samples * up))
        - np.trace(_projected(linear, noise * down, samples * down))
    ) / (2.0 * _LOG_VARIANCE_STEP)
    # P scales as the inverse of both variances: trace(Z'PZ) falls by itself, in part by each.
    alone = (
        np.trace(_projected(linear, noise, samples * up))
        - np.trace(_projected(linear, noise, samples * down))
    ) / (2.0 * _LOG_VARIANCE_STEP)
    both = float(np.sum(here**2)) * samples**2
    cross = -float(slope - alone) * samples
    white = freedom - both - 2.0 * cross
    information = 0.5 * np.array([[white, cross], [cross, both]])
    return np.asarray(np.linalg.inv(information))


def _projected(linear: LinearModel, noise: float, samples: float) -> Floats:
    """Return Z' P Z, shape (samples, samples); P projects for the restricted likelihood."""
    shrunk = linear.shrunk(samples / noise) / noise
    total = shrunk.sum(axis=0)
    inner = total[np.ix_(linear.columns, linear.columns)]
    scale = np.sqrt(np.diag(inner))
    unit = inner / np.outer(scale, scale) + _MATRIX_RIDGE * np.eye(len(scale))
    arms = shrunk[:, P, linear.columns] / scale
    return np.asarray(np.diag(shrunk[:, P, P]) - arms @ np.linalg.solve(unit, arms.T))
