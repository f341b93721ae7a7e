"""The objective of a calibration: least squares of the force, with levels of noise and samples.

    objective = sum |W (F - exp(g + b_s) f(p))|^2 / v + sum b_s^2 / tau^2 + g^2 / gain^2
                + sum (ln p - ln prior)^2 / prior^2

over the logarithms of the parameters p, the load cell's gain g and the samples' factors b_s; W
whitens, v is the noise's variance over the stated one. The factors multiply, so that a large
scatter does not bias the model to small forces, as a covariance made from measured forces does
(Peelle's puzzle). Given the levels this is the Laplace form of the marginal likelihood.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import groupby

import numpy as np

from labpipe.mechanics.wire.calibration.law_components import WireParts, compute_loading_curve
from labpipe.mechanics.wire.calibration.measured_curves import (
    MeasuredCurve,
    compute_shared_errors,
    whiten,
)
from labpipe.mechanics.wire.first_loading import LoadingCurve, interpolate_force
from labpipe.records.arrays import Flags, Floats, Ints
from labpipe.records.wire_calibration import PARAMETERS

P = len(PARAMETERS)
COLUMNS = len(PARAMETERS) + 2
"""Of a Gram matrix: the derivatives by the parameters, the model's force, the residual."""


@dataclass(frozen=True, slots=True, eq=False)
class ModelForce:
    """Forces of one curve, shape (n,), N, their derivatives, shape (3, n), N, and slope, N/m.

    `states` are those of the wire, from which other parameters are solved faster.
    """

    force: Floats
    change: Floats
    slope: Floats
    states: LoadingCurve | None = None


def compute_model_forces(
    parts: WireParts,
    values: Floats,
    curves: tuple[MeasuredCurve, ...],
    near: list[ModelForce] | None = None,
) -> list[ModelForce]:
    """Compute the force of the model at every point of the curves, without the samples' factors.

    Parameters
    ----------
    parts, values : as for `compute_loading_curve`
    curves : measured
    near : forces at similar values, to start from

    Raises
    ------
    ValueError
        If a curve goes beyond first loading.
    """
    forces: list[ModelForce | None] = [None] * len(curves)
    order = sorted(range(len(curves)), key=lambda i: _setup_key(curves[i]))
    for _, members in groupby(order, key=lambda i: _setup_key(curves[i])):
        numbers = list(members)
        deflections = np.concatenate([curves[i].deflection for i in numbers])
        first = curves[numbers[0]]
        deepest = float(np.max(np.abs(deflections)))
        curve = compute_loading_curve(
            *(parts, values, first.length, first.rig, deepest),
            self_weight=first.self_weight,
            near=near[numbers[0]].states if near else None,
        )
        force, change = interpolate_force(curve, deflections)
        ends = np.cumsum([len(curves[i].deflection) for i in numbers])[:-1]
        rise = np.interp(np.abs(deflections), curve.deflection, curve.stiffness)
        parts_of = (np.split(values, ends, axis=-1) for values in (force, change, rise))
        for number, *part in zip(numbers, *parts_of, strict=True):
            forces[number] = ModelForce(part[0], part[1], part[2], curve)
    return [force for force in forces if force is not None]


def _setup_key(curve: MeasuredCurve) -> tuple[float, ...]:
    rig, place = curve.rig, (curve.length, curve.self_weight)
    if rig is None:
        return place
    return (*place, rig.string_length, rig.weight, rig.anchor_x, rig.anchor_height)


def compute_gram(
    curve: MeasuredCurve, model: ModelForce, factor: float, correlation: float
) -> Floats:
    """Return the whitened Gram matrix of derivatives, model and residual, shape (5, 5).

    Parameters
    ----------
    curve, model : measured and modelled
    factor : of the sample and the load cell on the model's force
    correlation : of neighbouring points

    Notes
    -----
    Errors N that the points share make the covariance R + N N', R being that of the noise. With
    whitened columns W, N the products are W'W - W'N (1 + N'N)^-1 N'W (Woodbury), as if each error
    were fitted with its standard deviation as prior. They are in units of the stated noise: where
    residuals show more noise, the shared errors grow alike.
    """
    force = factor * model.force
    columns = np.column_stack([factor * model.change.T, force, curve.force - force])
    return compute_whitened_products(curve, columns, model.slope, correlation)


def compute_whitened_products(
    curve: MeasuredCurve, columns: Floats, slope: Floats, correlation: float
) -> Floats:
    """Return the Gram matrix of columns of forces in units of the stated noise, see `compute_gram`.

    Parameters
    ----------
    curve : measured
    columns : shape (points, n), N
    slope : shape (points,), N/m, of the curve
    correlation : of neighbouring points
    """
    noise = np.asarray(curve.noise)[:, None]
    white = whiten(columns / noise, correlation)
    shared = whiten(compute_shared_errors(curve, slope).T / noise, correlation)
    shared_products = shared.T @ white
    capacitance = np.eye(shared.shape[1]) + shared.T @ shared
    return np.asarray(
        white.T @ white - shared_products.T @ np.linalg.solve(capacitance, shared_products)
    )


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """Input of a search.

    Parameters
    ----------
    parts : the wire
    curves : of usable points
    sample : shape (curves,), number of the sample of each
    centre, precision : shape (3,), of priors on the logarithms; precision 0 without one
    lower, upper : shape (3,), bounds of the logarithms
    gain : standard uncertainty of the load cell's gain, in logarithms
    free : shape (3,), which parameters are fitted
    scatter : of the samples, in logarithms, where it is given; None to estimate it
    """

    parts: WireParts
    curves: tuple[MeasuredCurve, ...]
    sample: Ints
    centre: Floats
    precision: Floats
    lower: Floats
    upper: Floats
    gain: float
    free: Flags
    scatter: float | None = None

    def hold(self, number: int) -> Problem:
        """Return the problem in which one parameter is held."""
        return replace(self, free=self.free & (np.arange(P) != number))

    @property
    def n_samples(self) -> int:
        """Return the number of samples."""
        return int(self.sample.max()) + 1

    @property
    def n_points(self) -> int:
        """Return the number of points of all curves."""
        return sum(len(curve.force) for curve in self.curves)


@dataclass(frozen=True, slots=True)
class Levels:
    """Variance of the noise over the stated one, correlation of neighbours, scatter of samples."""

    noise: float
    correlation: float
    scatter: float


@dataclass(frozen=True, slots=True, eq=False)
class Point:
    """Unknowns of the search.

    Parameters
    ----------
    logs : shape (3,), of the parameters
    gain : of the load cell, in logarithms
    offsets : shape (samples,), of the samples, in logarithms
    near : forces of the model nearby, from which it is solved faster
    """

    logs: Floats
    gain: float
    offsets: Floats
    near: list[ModelForce] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """The model at a point of a problem, such as the minimum that a search finds.

    Parameters
    ----------
    problem, levels : what is fitted
    point : the unknowns
    objective : at the point
    grams : shape (samples, 5, 5), whitened products, not over the noise's variance
    models : forces of the curves
    steps : taken by the search
    settled : whether the search converged
    """

    problem: Problem
    levels: Levels
    point: Point
    objective: float
    grams: Floats
    models: list[ModelForce]
    steps: int = 0
    settled: bool = False


def evaluate(problem: Problem, levels: Levels, point: Point) -> Fit:
    """Evaluate the objective at a point."""
    models = compute_model_forces(problem.parts, np.exp(point.logs), problem.curves, point.near)
    point = replace(point, near=models)
    grams = compute_products(problem, levels.correlation, point, models)
    data = float(grams[:, -1, -1].sum()) / levels.noise
    prior = float(problem.precision @ (point.logs - problem.centre) ** 2)
    gain = (point.gain / problem.gain) ** 2 if problem.gain > 0.0 else 0.0
    scatter = float(point.offsets @ point.offsets)
    scatter = scatter / levels.scatter**2 if levels.scatter > 0.0 else 0.0
    return Fit(problem, levels, point, data + prior + gain + scatter, grams, models)


def compute_products(
    problem: Problem, correlation: float, point: Point, models: list[ModelForce]
) -> Floats:
    """Return the Gram matrix of each sample, shape (samples, 5, 5)."""
    grams = np.zeros((problem.n_samples, COLUMNS, COLUMNS))
    for curve, model, sample in zip(problem.curves, models, problem.sample, strict=True):
        factor = float(np.exp(point.gain + point.offsets[sample]))
        grams[sample] += compute_gram(curve, model, factor, correlation)
    return grams


def make_normal_equations(fit: Fit) -> tuple[Floats, Floats, Flags]:
    """Return matrix and right side of the normal equations, and which unknowns may move.

    Unknowns are the parameters, the gain and the offsets of the samples. The matrix is half the
    Hessian, the right side minus half the gradient.
    """
    problem, levels, point = fit.problem, fit.levels, fit.point
    total = fit.grams.sum(axis=0) / levels.noise
    sample_grams = fit.grams / levels.noise
    size = P + 1 + problem.n_samples
    matrix, pull = np.zeros((size, size)), np.empty(size)
    matrix[: P + 1, : P + 1] = total[: P + 1, : P + 1]
    matrix[P + 1 :, : P + 1] = sample_grams[:, P, : P + 1]
    matrix[: P + 1, P + 1 :] = sample_grams[:, P, : P + 1].T
    matrix[range(P + 1, size), range(P + 1, size)] = sample_grams[:, P, P]
    pull[: P + 1], pull[P + 1 :] = total[-1, : P + 1], sample_grams[:, P, -1]
    precision = np.zeros(size)
    precision[:P] = problem.precision
    precision[P] = _precision(problem.gain)
    precision[P + 1 :] = _precision(levels.scatter)
    deviation = np.concatenate([point.logs - problem.centre, [point.gain], point.offsets])
    is_free = np.isfinite(precision)
    precision = np.where(is_free, precision, 0.0)
    matrix[range(size), range(size)] += precision
    pull -= precision * deviation
    is_free[:P] = problem.free
    is_free[:P] &= ~((point.logs <= problem.lower) & (pull[:P] < 0.0))
    is_free[:P] &= ~((point.logs >= problem.upper) & (pull[:P] > 0.0))
    return matrix, pull, is_free


def _precision(deviation: float) -> float:
    return 1.0 / deviation**2 if deviation > 0.0 else np.inf


def scale_matrix(matrix: Floats, ridge: float = 1e-12) -> tuple[Floats, Floats]:
    """Scale a symmetric matrix to a diagonal of one plus a ridge; return it with the scale.

    Parameters
    ----------
    matrix : shape (n, n)
    ridge : added to the diagonal
    """
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-30))
    return matrix / np.outer(scale, scale) + ridge * np.eye(len(scale)), scale
