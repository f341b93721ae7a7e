"""The search for the parameters: least squares with levels, by damped Gauss-Newton steps.

    objective = sum |W (F - exp(g + b_s) f(p))|^2 / v + sum b_s^2 / tau^2 + g^2 / gain^2
                + sum (ln p - ln prior)^2 / prior^2

over the logarithms of the parameters p, the load cell's gain g and the samples' factors b_s; W
whitens, v is the noise's variance over the stated one. The factors multiply, so that a large
scatter does not draw the model to small forces, as a covariance made from measured forces does
(Peelle's puzzle). Given the levels this is the Laplace form of the marginal likelihood.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from labpipe.records.arrays import Flags, Floats, Ints
from labpipe.records.wire_calibration import PARAMETERS
from labpipe.wire.calibration.law_components import (
    COLUMNS,
    ModelForce,
    WireParts,
    gram,
    model_forces,
)
from labpipe.wire.calibration.measured_curves import MeasuredCurve

P = len(PARAMETERS)
_MAX_STEPS = 60
_OBJECTIVE_TOLERANCE = (
    1e-5  # of the objective, predicted by a full step; intervals look at changes of 1
)


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """What is fitted to what.

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
        """Samples."""
        return int(self.sample.max()) + 1

    @property
    def n_points(self) -> int:
        """Points of all curves."""
        return sum(len(curve.force) for curve in self.curves)


@dataclass(frozen=True, slots=True)
class Levels:
    """Variance of the noise over the stated one, correlation of neighbours, scatter of samples."""

    noise: float
    correlation: float
    scatter: float


@dataclass(frozen=True, slots=True, eq=False)
class Point:
    """Where the search stands.

    Parameters
    ----------
    logs : shape (3,), of the parameters
    gain : of the load cell, in logarithms
    offsets : shape (samples,), of the samples, in logarithms
    """

    logs: Floats
    gain: float
    offsets: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """Where the search ended.

    Parameters
    ----------
    point : the least found
    objective : there
    grams : shape (samples, 5, 5), whitened products, not over the noise's variance
    models : forces of the curves
    steps : taken
    settled : whether a further step would not have mattered
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
    """Go from a start to the least of the objective.

    Parameters
    ----------
    problem, levels : what is fitted
    start : first guess; parameters that are not free stay there
    free : shape (3,)
    enough : of the objective, below which a further step would not matter
    lowest : objective of a better fit: the higher above it, the rougher is enough

    Raises
    ------
    ValueError
        If the start is beyond what the model can do.
    """
    idle_gain = 1e-3  # of the objective
    max_idle_steps = 3  # in a row, which end a search along a flat valley
    rise_share = 1e-3  # of the distance above another fit
    jitter = 1e-2  # gain below which a failed step is due to the tabulated curves
    damping_range = (1e-6, 10.0, 1e8)  # first, growth, last
    here = _look(problem, levels, start)
    damping, steps, idle = damping_range[0], 0, 0
    while steps < _most(here, lowest) and damping <= damping_range[2] and idle < max_idle_steps:
        step, pull = _step_inside(problem, levels, here, free, damping)
        if float(step @ pull) <= max(enough, rise_share * (here.objective - lowest)):
            return replace(here, steps=steps, settled=True)
        steps += 1
        ahead = _ahead(problem, levels, here, step, float(step @ pull))
        if ahead is not None and ahead.objective <= here.objective:
            slow = max(
                idle_gain, (here.objective - lowest) / _MAX_STEPS
            )  # would not come down to it
            idle = idle + 1 if here.objective - ahead.objective <= slow else 0
            here, damping = ahead, max(damping / damping_range[1] ** 2, damping_range[0])
        elif float(step @ pull) <= jitter:
            return replace(here, steps=steps, settled=True)
        else:
            damping *= damping_range[1]
    return replace(here, steps=steps, settled=steps < _MAX_STEPS)


def _most(here: Fit, lowest: float) -> int:
    """Steps that a search may take: few, as long as it is far above a better fit."""
    max_far_steps = 8
    far_rise = 200.0  # above another fit: no quantile of so few samples is as large
    return max_far_steps if here.objective - lowest > far_rise else _MAX_STEPS


def _look(problem: Problem, levels: Levels, point: Point) -> Fit:
    models = model_forces(problem.parts, np.exp(point.logs), problem.curves)
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
    """Whitened products of each sample, shape (samples, 5, 5)."""
    grams = np.zeros((problem.n_samples, COLUMNS, COLUMNS))
    for curve, model, sample in zip(problem.curves, models, problem.sample, strict=True):
        factor = float(np.exp(point.gain + point.offsets[sample]))
        grams[sample] += gram(curve, model, factor, correlation)
    return grams


def _ahead(problem: Problem, levels: Levels, here: Fit, step: Floats, gain: float) -> Fit | None:
    """Look where a step leads, or on the way there, if a parabola has its least well before.

    In a narrow bent valley whole steps go to and fro between its sides.
    """
    whole_share = 0.75  # of a step, from which the whole step is taken
    shortest_share = 0.1
    whole = _try(problem, levels, _move(problem, here.point, step))
    if whole is None:
        return None
    share = gain / max(whole.objective - here.objective + 2.0 * gain, gain)
    if share > whole_share:
        return whole
    part = _try(problem, levels, _move(problem, here.point, max(share, shortest_share) * step))
    return part if part is not None and part.objective < whole.objective else whole


def _try(problem: Problem, levels: Levels, point: Point) -> Fit | None:
    """Look at a point; None where the model cannot go, so that the step is shortened."""
    try:
        return _look(problem, levels, point)
    except ValueError:
        return None


def _move(problem: Problem, point: Point, step: Floats) -> Point:
    logs = np.clip(point.logs + step[:P], problem.lower, problem.upper)
    return Point(logs, point.gain + float(step[P]), point.offsets + step[P + 1 :])


def _normal(
    problem: Problem, levels: Levels, fit: Fit, free: Flags
) -> tuple[Floats, Floats, Flags]:
    """Matrix and right side of the normal equations, and which unknowns may move."""
    total = fit.grams.sum(axis=0) / levels.noise
    own = fit.grams / levels.noise
    size = P + 1 + problem.n_samples
    matrix, pull = np.zeros((size, size)), np.empty(size)
    matrix[: P + 1, : P + 1] = total[: P + 1, : P + 1]
    matrix[P + 1 :, : P + 1] = own[:, P, : P + 1]
    matrix[: P + 1, P + 1 :] = own[:, P, : P + 1].T
    matrix[range(P + 1, size), range(P + 1, size)] = own[:, P, P]
    pull[: P + 1], pull[P + 1 :] = total[-1, : P + 1], own[:, P, -1]
    point = fit.point
    tight = np.zeros(size)
    tight[:P] = problem.precision
    tight[P] = _precision(problem.gain)
    tight[P + 1 :] = _precision(levels.scatter)
    away = np.concatenate([point.logs - problem.centre, [point.gain], point.offsets])
    moves = np.isfinite(tight)
    tight = np.where(moves, tight, 0.0)
    matrix[range(size), range(size)] += tight
    pull -= tight * away
    moves[:P] = free
    moves[:P] &= ~((point.logs <= problem.lower) & (pull[:P] < 0.0))
    moves[:P] &= ~((point.logs >= problem.upper) & (pull[:P] > 0.0))
    return matrix, pull, moves


def normal_matrix(problem: Problem, levels: Levels, fit: Fit, free: Flags) -> tuple[Floats, Flags]:
    """Half the curvature of the objective by parameters, gain and samples, and which may move."""
    matrix, _, moves = _normal(problem, levels, fit, free)
    return matrix, moves


def pull_of(problem: Problem, levels: Levels, fit: Fit) -> Floats:
    """Minus half the slope of the objective by the logarithms of the parameters, shape (3,)."""
    _, pull, _ = _normal(problem, levels, fit, np.zeros(P, dtype=np.bool_))
    return pull[:P]


def _precision(deviation: float) -> float:
    return 1.0 / deviation**2 if deviation > 0.0 else np.inf


def _step_inside(
    problem: Problem, levels: Levels, fit: Fit, free: Flags, damping: float
) -> tuple[Floats, Floats]:
    """Step within the bounds, and the pull: what would go beyond goes to its bound, others along.

    A step that is only clipped need not lead downhill.
    """
    matrix, pull, moves = _normal(problem, levels, fit, free)
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
    inner = matrix[np.ix_(moves, moves)]
    scale = np.sqrt(np.maximum(np.diag(inner), 1e-30))
    scaled = inner / np.outer(scale, scale) + damping * np.eye(len(scale))
    step[moves] = np.linalg.solve(scaled, pull[moves] / scale) / scale
    longest = float(np.max(np.abs(step)))
    return step * min(1.0, longest_step / longest) if longest > 0.0 else step
