"""The search for the parameters: least squares with levels, by damped Gauss-Newton steps.

    objective = sum |W (F - exp(g + b_s) f(p))|^2 / v + sum b_s^2 / tau^2 + g^2 / gain^2
                + sum (ln p - ln prior)^2 / prior^2

over the logarithms of the parameters p, the load cell's gain g and the samples' factors b_s; W
whitens, v is the noise's variance over the stated one. The factors multiply, so that a large
scatter does not bias the model to small forces, as a covariance made from measured forces does
(Peelle's puzzle). Given the levels this is the Laplace form of the marginal likelihood.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from labpipe.mechanics.wire.calibration.law_components import (
    COLUMNS,
    ModelForce,
    WireParts,
    gram,
    model_forces,
)
from labpipe.mechanics.wire.calibration.measured_curves import MeasuredCurve
from labpipe.records.arrays import Flags, Floats, Ints
from labpipe.records.wire_calibration import PARAMETERS

P = len(PARAMETERS)
_MAX_STEPS = 60
_OBJECTIVE_TOLERANCE = 1e-5
"""Change of the objective predicted by a full step; intervals depend on changes of 1."""


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
    """

    parts: WireParts
    curves: tuple[MeasuredCurve, ...]
    sample: Ints
    centre: Floats
    precision: Floats
    lower: Floats
    upper: Floats
    gain: float

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
    """Result of a search.

    Parameters
    ----------
    point : the minimum
    objective : at the minimum
    grams : shape (samples, 5, 5), whitened products, not over the noise's variance
    models : forces of the curves
    steps : taken
    settled : whether the search converged
    """

    point: Point
    objective: float
    grams: Floats
    models: list[ModelForce]
    steps: int
    settled: bool


def search(
    problem: Problem,
    levels: Levels,
    start: Point,
    free: Flags,
    *,
    enough: float = _OBJECTIVE_TOLERANCE,
    lowest: float = np.inf,
) -> Fit:
    """Search the minimum of the objective from a start.

    Parameters
    ----------
    problem, levels : what is fitted
    start : first guess; parameters that are not free stay there
    free : shape (3,)
    enough : tolerance of the objective
    lowest : objective of a better fit: the tolerance grows with the rise above it

    Raises
    ------
    ValueError
        If the model cannot follow at the start.
    """
    idle_gain = 1e-3  # of the objective
    max_idle_steps = 3  # in a row, which end a search along a flat valley
    rise_share = 1e-3  # of the distance above another fit
    jitter = 1e-2  # gain below which a failed step is due to the tabulated curves
    damping_range = (1e-6, 10.0, 1e8)  # first, growth, last
    fit = _evaluate(problem, levels, start)
    damping, steps, idle = damping_range[0], 0, 0
    while steps < _max_steps(fit, lowest) and damping <= damping_range[2] and idle < max_idle_steps:
        step, pull = _step_inside(problem, levels, fit, free, damping)
        if float(step @ pull) <= max(enough, rise_share * (fit.objective - lowest)):
            return replace(fit, steps=steps, settled=True)
        steps += 1
        next_fit = _advance(problem, levels, fit, step, float(step @ pull))
        if next_fit is not None and next_fit.objective <= fit.objective:
            slow = max(idle_gain, (fit.objective - lowest) / _MAX_STEPS)
            idle = idle + 1 if fit.objective - next_fit.objective <= slow else 0
            fit, damping = next_fit, max(damping / damping_range[1] ** 2, damping_range[0])
        elif float(step @ pull) <= jitter:
            return replace(fit, steps=steps, settled=True)
        else:
            damping *= damping_range[1]
    return replace(fit, steps=steps, settled=steps < _MAX_STEPS)


def _max_steps(fit: Fit, lowest: float) -> int:
    """Return the number of steps allowed: few while far above a better fit."""
    max_far_steps = 8
    far_rise = 200.0  # above another fit: no quantile of so few samples is as large
    return max_far_steps if fit.objective - lowest > far_rise else _MAX_STEPS


def _evaluate(problem: Problem, levels: Levels, point: Point) -> Fit:
    models = model_forces(problem.parts, np.exp(point.logs), problem.curves, point.near)
    point = replace(point, near=models)
    grams = products(problem, levels.correlation, point, models)
    data = float(grams[:, -1, -1].sum()) / levels.noise
    prior = float(problem.precision @ (point.logs - problem.centre) ** 2)
    gain = (point.gain / problem.gain) ** 2 if problem.gain > 0.0 else 0.0
    scatter = float(point.offsets @ point.offsets)
    scatter = scatter / levels.scatter**2 if levels.scatter > 0.0 else 0.0
    return Fit(point, data + prior + gain + scatter, grams, models, 0, settled=False)


def products(
    problem: Problem, correlation: float, point: Point, models: list[ModelForce]
) -> Floats:
    """Return the Gram matrix of each sample, shape (samples, 5, 5)."""
    grams = np.zeros((problem.n_samples, COLUMNS, COLUMNS))
    for curve, model, sample in zip(problem.curves, models, problem.sample, strict=True):
        factor = float(np.exp(point.gain + point.offsets[sample]))
        grams[sample] += gram(curve, model, factor, correlation)
    return grams


def _advance(problem: Problem, levels: Levels, fit: Fit, step: Floats, gain: float) -> Fit | None:
    """Evaluate a step, or part of it if a parabola has its minimum well before.

    In a narrow curved valley whole steps oscillate between its sides.
    """
    whole_share = 0.75  # of a step, from which the whole step is taken
    shortest_share = 0.1
    full_step = _try(problem, levels, _move(problem, fit.point, step))
    if full_step is None:
        return None
    share = gain / max(full_step.objective - fit.objective + 2.0 * gain, gain)
    if share > whole_share:
        return full_step
    part = _try(problem, levels, _move(problem, fit.point, max(share, shortest_share) * step))
    return part if part is not None and part.objective < full_step.objective else full_step


def _try(problem: Problem, levels: Levels, point: Point) -> Fit | None:
    """Evaluate a point; None where the model cannot follow, so that the step is shortened."""
    try:
        return _evaluate(problem, levels, point)
    except ValueError:
        return None


def _move(problem: Problem, point: Point, step: Floats) -> Point:
    logs = np.clip(point.logs + step[:P], problem.lower, problem.upper)
    offsets = point.offsets + step[P + 1 :]
    return replace(point, logs=logs, gain=point.gain + float(step[P]), offsets=offsets)


def _normal_equations(
    problem: Problem, levels: Levels, fit: Fit, free: Flags
) -> tuple[Floats, Floats, Flags]:
    """Return matrix and right side of the normal equations, and which unknowns may move."""
    total = fit.grams.sum(axis=0) / levels.noise
    sample_grams = fit.grams / levels.noise
    size = P + 1 + problem.n_samples
    matrix, pull = np.zeros((size, size)), np.empty(size)
    matrix[: P + 1, : P + 1] = total[: P + 1, : P + 1]
    matrix[P + 1 :, : P + 1] = sample_grams[:, P, : P + 1]
    matrix[: P + 1, P + 1 :] = sample_grams[:, P, : P + 1].T
    matrix[range(P + 1, size), range(P + 1, size)] = sample_grams[:, P, P]
    pull[: P + 1], pull[P + 1 :] = total[-1, : P + 1], sample_grams[:, P, -1]
    point = fit.point
    precision = np.zeros(size)
    precision[:P] = problem.precision
    precision[P] = _precision(problem.gain)
    precision[P + 1 :] = _precision(levels.scatter)
    deviation = np.concatenate([point.logs - problem.centre, [point.gain], point.offsets])
    is_free = np.isfinite(precision)
    precision = np.where(is_free, precision, 0.0)
    matrix[range(size), range(size)] += precision
    pull -= precision * deviation
    is_free[:P] = free
    is_free[:P] &= ~((point.logs <= problem.lower) & (pull[:P] < 0.0))
    is_free[:P] &= ~((point.logs >= problem.upper) & (pull[:P] > 0.0))
    return matrix, pull, is_free


def normal_matrix(problem: Problem, levels: Levels, fit: Fit, free: Flags) -> tuple[Floats, Flags]:
    """Return half the Hessian by parameters, gain and samples, and which of them may move."""
    matrix, _, moves = _normal_equations(problem, levels, fit, free)
    return matrix, moves


def pull_of(problem: Problem, levels: Levels, fit: Fit) -> Floats:
    """Return minus half the gradient by the logarithms of the parameters, shape (3,)."""
    _, pull, _ = _normal_equations(problem, levels, fit, np.zeros(P, dtype=np.bool_))
    return pull[:P]


def _precision(deviation: float) -> float:
    return 1.0 / deviation**2 if deviation > 0.0 else np.inf


def _step_inside(
    problem: Problem, levels: Levels, fit: Fit, free: Flags, damping: float
) -> tuple[Floats, Floats]:
    """Return a step within the bounds, and the pull; parameters that cross a bound stop there.

    The others are solved again, because a clipped step need not lead downhill.
    """
    matrix, pull, moves = _normal_equations(problem, levels, fit, free)
    fixed = np.zeros(len(pull))
    while True:  # each round fixes at least one of the parameters
        step = fixed + _step(matrix, pull - matrix @ fixed, moves, damping)
        ahead = fit.point.logs + step[:P]
        beyond = moves[:P] & ((ahead < problem.lower) | (ahead > problem.upper))
        if not beyond.any():
            return step, pull
        inside = np.clip(ahead, problem.lower, problem.upper) - fit.point.logs
        fixed[:P] = np.where(beyond, inside, fixed[:P])
        moves = moves & ~np.concatenate([beyond, np.zeros(len(pull) - P, dtype=np.bool_)])


def _step(matrix: Floats, pull: Floats, moves: Flags, damping: float) -> Floats:
    longest_step = 1.5
    step = np.zeros(len(pull))
    if not moves.any():
        return step
    unit, scale = scaled(matrix[np.ix_(moves, moves)], damping)
    step[moves] = np.linalg.solve(unit, pull[moves] / scale) / scale
    longest = float(np.max(np.abs(step)))
    return step * min(1.0, longest_step / longest) if longest > 0.0 else step


def scaled(matrix: Floats, ridge: float = 1e-12) -> tuple[Floats, Floats]:
    """Scale a symmetric matrix to a diagonal of one plus a ridge; return it with the scale.

    Parameters
    ----------
    matrix : shape (n, n)
    ridge : added to the diagonal
    """
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-30))
    return matrix / np.outer(scale, scale) + ridge * np.eye(len(scale)), scale
