"""The problem of a calibration, its objective, and the search for the minimum.

    objective = sum |W (F - exp(g + b_s) f(p))|^2 / v + sum b_s^2 / tau^2 + g^2 / gain^2
                + sum (ln p - ln prior)^2 / prior^2

over the logarithms of the parameters p, the load cell's gain g and the samples' factors b_s; W
whitens, v is the noise's variance over the stated one. The factors multiply, so that a large
scatter does not bias the model to small forces, as a covariance made from measured forces does
(Peelle's puzzle). Given the levels this is the Laplace form of the marginal likelihood. It is
minimised by damped Gauss-Newton steps within the bounds.

The unknowns are one vector: P logarithms of parameters, the gain, the samples' factors.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import groupby

import numpy as np

from labpipe.mechanics.wire.bending_law import Contacts
from labpipe.mechanics.wire.calibration.identification import format_value
from labpipe.mechanics.wire.calibration.law_components import (
    WireLaw,
    compute_loading_curve,
    split_law,
)
from labpipe.mechanics.wire.calibration.measured_curves import (
    MeasuredCurve,
    compute_shared_errors,
    whiten,
)
from labpipe.mechanics.wire.cross_section import CrossSection
from labpipe.mechanics.wire.first_loading import LoadingCurve, interpolate_force
from labpipe.records.arrays import Flags, Floats, Ints
from labpipe.records.curve import NORMAL_95
from labpipe.records.wire import (
    COPPER_SCALE,
    INSULATION_MODULUS,
    PARAMETERS,
    RADIAL_FRICTION,
    CalibrationFailure,
    ParameterChoice,
)

P = len(PARAMETERS)


@dataclass(frozen=True, slots=True, eq=False)
class Wire:
    """A wire as in its sheet.

    Parameters
    ----------
    section : strands in place, with copper and insulation: nominal values
    contacts : friction coefficients, whose ratios are kept, and nominal radial force
    orientation : rad, of the section against the neutral axis
    self_weight : N/m
    linear_range : 1/m, curvature up to which the insulation is linear
    """

    section: CrossSection
    contacts: Contacts
    orientation: float = 0.0
    self_weight: float = 0.0
    linear_range: float = np.inf

    @property
    def law(self) -> WireLaw:
        """Split the law of the wire into its components, and tabulate them."""
        return split_law(self.section, self.contacts, orientation=self.orientation)


@dataclass(frozen=True, slots=True, eq=False)
class Settings:
    """Settings of a calibration.

    Parameters
    ----------
    choices : by name of the parameter; others are free if they act on the wire
    gain : standard uncertainty of the load cell's gain, as a ratio, common to all curves
    scatter : standard deviation of the samples' factors on the force, as a ratio, where it is
        known; else None: it is estimated from the samples
    """

    choices: Mapping[str, ParameterChoice] = field(default_factory=dict)
    gain: float = 0.0
    scatter: float | None = None


SEARCH_RANGES: Mapping[str, tuple[float, float, float]] = {
    RADIAL_FRICTION: (1e-5, 0.05, 1e2),
    INSULATION_MODULUS: (1e5, 1e9, 1e11),
    COPPER_SCALE: (0.05, 1.0, 20.0),
}
"""Lower bound, start where the wire has no value or zero, and upper bound: N, Pa, 1."""


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """Input of a search.

    Parameters
    ----------
    law : of the wire, split into its components
    curves : of usable points
    sample : shape (curves,), number of the sample of each
    centre, precision : shape (3,), of priors on the logarithms; precision 0 without one
    lower, upper : shape (3,), bounds of the logarithms
    gain : standard uncertainty of the load cell's gain, in logarithms
    free : shape (3,), which parameters are fitted
    scatter : of the samples, in logarithms, where it is given; None to estimate it
    """

    law: WireLaw
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

    def find_precision(self, scatter: float) -> Floats:
        """Return the precisions of all unknowns about their centres; infinite for those held at 0.

        Parameters
        ----------
        scatter : of the samples
        """
        deviations = np.append(self.gain, np.full(self.n_samples, scatter))
        with np.errstate(divide="ignore"):
            return np.append(self.precision, deviations**-2.0)

    def find_offsets(self, unknowns: Floats) -> Floats:
        """Return the distances of all unknowns from their centres."""
        return np.append(unknowns[:P] - self.centre, unknowns[P:])

    def find_factors(self, unknowns: Floats) -> Floats:
        """Return the factor of sample and load cell on the model's force of each curve."""
        return np.asarray(np.exp(unknowns[P] + unknowns[P + 1 :][self.sample]))


def set_up_problem(
    law: WireLaw, curves: tuple[MeasuredCurve, ...], settings: Settings
) -> tuple[Problem, Floats] | CalibrationFailure:
    """Set up the problem of a calibration.

    Parameters
    ----------
    law : of the wire, split into its components
    curves : usable ones
    settings : of the calibration

    Returns
    -------
    The problem and the logarithms to start from; or a failure
    ``parameter_without_effect``, ``value_out_of_bounds`` or ``too_few_points``.
    """
    logs, centre, precision, lower, upper = np.zeros((5, P))
    free = np.zeros(P, dtype=np.bool_)
    for number, name in enumerate(PARAMETERS):
        acts, choice = law.is_active[number], settings.choices.get(name, ParameterChoice())
        if not acts and name in settings.choices and not choice.is_fixed:
            return CalibrationFailure.of("mechanics.wire.parameter_without_effect", name=name)
        if not acts:
            continue
        nominal, (lowest, start, highest) = float(law.nominal[number]), SEARCH_RANGES[name]
        value = choice.value or (nominal if nominal > 0.0 else start)
        low, high = choice.lower or lowest, choice.upper or highest
        if choice.is_fixed:
            low = high = value
        elif not low <= value <= high or low == high:
            text, bounds = format_value(name, value), format_value(name, low, high)
            return CalibrationFailure.of(
                "mechanics.wire.value_out_of_bounds", name=name, value=text, bounds=bounds
            )
        free[number] = not choice.is_fixed
        logs[number], lower[number], upper[number] = np.log([value, low, high])
        if choice.factor is not None and not choice.is_fixed:
            centre[number] = logs[number]
            precision[number] = (NORMAL_95 / np.log(choice.factor)) ** 2
    names = list(dict.fromkeys(curve.sample for curve in curves))
    samples = np.array([names.index(curve.sample) for curve in curves], dtype=np.int64)
    priors = centre, precision, lower, upper, settings.gain, free, settings.scatter
    problem = Problem(law, curves, samples, *priors)
    needed = int(free.sum()) + problem.n_samples + 1
    if problem.n_points < needed:
        return CalibrationFailure.of(
            "mechanics.wire.too_few_points",
            points=problem.n_points,
            parameters=int(free.sum()),
            samples=problem.n_samples,
            needed=needed,
        )
    return problem, logs


@dataclass(frozen=True, slots=True, eq=False)
class ModelForce:
    """Forces of one curve.

    Parameters
    ----------
    force : shape (n,), N, without the sample's factor
    change : shape (3, n), N, derivatives by the logarithms of the parameters
    slope : shape (n,), N/m
    loading : of the wire, from which other parameters are solved faster
    """

    force: Floats
    change: Floats
    slope: Floats
    loading: LoadingCurve | None = None


def compute_model_forces(
    law: WireLaw,
    values: Floats,
    curves: tuple[MeasuredCurve, ...],
    near: list[ModelForce] | None = None,
) -> list[ModelForce]:
    """Compute the force of the model at every point of the curves, without the samples' factors.

    Parameters
    ----------
    law, values : as for `compute_loading_curve`
    curves : measured
    near : forces at similar values, to start from

    Raises
    ------
    ValueError
        If a curve goes beyond first loading.
    """
    forces: dict[int, ModelForce] = {}
    order = sorted(range(len(curves)), key=lambda i: curves[i].setup)
    for _, members in groupby(order, key=lambda i: curves[i].setup):
        numbers = list(members)
        deflections = np.concatenate([curves[i].deflection for i in numbers])
        first = curves[numbers[0]]
        deepest = float(np.max(np.abs(deflections)))
        loading = compute_loading_curve(
            *(law, values, first.length, first.rig, deepest),
            self_weight=first.self_weight,
            similar=near[numbers[0]].loading if near else None,
        )
        force, change = interpolate_force(loading, deflections)
        rise = np.interp(np.abs(deflections), loading.deflection, loading.stiffness)
        ends = np.cumsum([len(curves[i].deflection) for i in numbers])[:-1]
        parts_of = (np.split(values, ends, axis=-1) for values in (force, change, rise))
        for number, *part in zip(numbers, *parts_of, strict=True):
            forces[number] = ModelForce(part[0], part[1], part[2], loading)
    return [forces[number] for number in range(len(curves))]


def compute_whitened_products(
    curve: MeasuredCurve, columns: Floats, slope: Floats, correlation: float
) -> Floats:
    """Return the Gram matrix of columns of forces in units of the stated noise.

    Parameters
    ----------
    curve : measured
    columns : shape (points, n), N
    slope : shape (points,), N/m, of the curve
    correlation : of neighbouring points

    Notes
    -----
    Errors N that the points share make the covariance R + N N', R being that of the noise. With
    whitened columns W, N the products are W'W - W'N (1 + N'N)^-1 N'W (Woodbury), as if each error
    were fitted with its standard deviation as prior. They are in units of the stated noise: where
    residuals show more noise, the shared errors grow alike.
    """
    noise = np.asarray(curve.noise)[:, None]
    white = whiten(columns / noise, correlation)
    shared = whiten(compute_shared_errors(curve, slope).T / noise, correlation)
    shared_products = shared.T @ white
    capacitance = np.eye(shared.shape[1]) + shared.T @ shared
    return np.asarray(
        white.T @ white - shared_products.T @ np.linalg.solve(capacitance, shared_products)
    )


@dataclass(frozen=True, slots=True)
class Levels:
    """Variance of the noise over the stated one, correlation of neighbours, scatter of samples."""

    noise: float
    correlation: float
    scatter: float


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """The model at a point of a problem, such as the minimum that a search finds.

    Parameters
    ----------
    problem, levels : what is fitted
    unknowns : shape (4 + samples,)
    objective : at the point
    grams : shape (samples, 5, 5), whitened products of the derivatives by the parameters, the
        model's force and the residual, not over the noise's variance
    models : forces of the curves
    steps : taken by the search
    settled : whether the search converged
    """

    problem: Problem
    levels: Levels
    unknowns: Floats
    objective: float
    grams: Floats
    models: list[ModelForce]
    steps: int = 0
    settled: bool = False

    @property
    def logs(self) -> Floats:
        """Return the logarithms of the parameters, shape (3,)."""
        return self.unknowns[:P]

    @property
    def factors(self) -> Floats:
        """Return the factor of sample and load cell on the model's force of each curve."""
        return self.problem.find_factors(self.unknowns)


def evaluate(
    problem: Problem, levels: Levels, unknowns: Floats, near: list[ModelForce] | None = None
) -> Fit:
    """Evaluate the objective at a point, from forces of the model nearby."""
    models = compute_model_forces(problem.law, np.exp(unknowns[:P]), problem.curves, near)
    fit = Fit(problem, levels, unknowns, np.nan, np.zeros(0), models)
    grams = compute_products(fit, levels.correlation)
    offsets, precision = problem.find_offsets(unknowns), problem.find_precision(levels.scatter)
    has_prior = np.isfinite(precision)
    prior = float(precision[has_prior] @ offsets[has_prior] ** 2)
    data = float(grams[:, -1, -1].sum()) / levels.noise
    return replace(fit, objective=data + prior, grams=grams)


def compute_products(fit: Fit, correlation: float) -> Floats:
    """Return the Gram matrix of each sample, shape (samples, 5, 5), see `Fit`."""
    problem = fit.problem
    grams = np.zeros((problem.n_samples, P + 2, P + 2))
    for curve, model, sample, factor in zip(
        problem.curves, fit.models, problem.sample, fit.factors, strict=True
    ):
        force = factor * model.force
        columns = np.column_stack([factor * model.change.T, force, curve.force - force])
        grams[sample] += compute_whitened_products(curve, columns, model.slope, correlation)
    return grams


def make_normal_equations(fit: Fit) -> tuple[Floats, Floats, Flags]:
    """Return matrix and right side of the normal equations, and which unknowns may move.

    The matrix is half the Hessian, the right side minus half the gradient.
    """
    problem = fit.problem
    total, grams = fit.grams.sum(axis=0) / fit.levels.noise, fit.grams / fit.levels.noise
    cross, own = grams[:, P, : P + 1], np.diag(grams[:, P, P])
    matrix = np.block([[total[: P + 1, : P + 1], cross.T], [cross, own]])
    pull = np.append(total[-1, : P + 1], grams[:, P, -1])
    precision = problem.find_precision(fit.levels.scatter)
    is_free = np.isfinite(precision)
    precision = np.where(is_free, precision, 0.0)
    matrix[np.diag_indices_from(matrix)] += precision
    pull -= precision * problem.find_offsets(fit.unknowns)
    is_free[:P] = problem.free
    is_free[:P] &= ~((fit.logs <= problem.lower) & (pull[:P] < 0.0))
    is_free[:P] &= ~((fit.logs >= problem.upper) & (pull[:P] > 0.0))
    return matrix, pull, is_free


def scale_matrix(matrix: Floats, ridge: float = 1e-12) -> tuple[Floats, Floats]:
    """Scale a symmetric matrix to a diagonal of one plus a ridge; return it with the scale.

    Parameters
    ----------
    matrix : shape (n, n)
    ridge : added to the diagonal
    """
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-30))
    return matrix / np.outer(scale, scale) + ridge * np.eye(len(scale)), scale


_MAX_SEARCH_STEPS = 60


def search(
    problem: Problem,
    levels: Levels,
    start: Floats,
    *,
    near: list[ModelForce] | None = None,
    enough: float = 1e-5,
    lowest: float = np.inf,
) -> Fit:
    """Search the minimum of the objective from a start.

    Parameters
    ----------
    problem, levels : what is fitted
    start : first guess; parameters that are not free stay there
    near : forces of the model near the start
    enough : change of the objective predicted by a full step; intervals depend on changes of 1
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
    max_far_steps, far_rise = 8, 200.0  # no quantile of so few samples is as large as the rise
    fit = evaluate(problem, levels, start, near)
    damping, steps, idle = damping_range[0], 0, 0
    while damping <= damping_range[2] and idle < max_idle_steps:
        is_far = fit.objective - lowest > far_rise
        if steps >= (max_far_steps if is_far else _MAX_SEARCH_STEPS):
            break
        step, gain = _find_step(fit, damping)
        if gain <= max(enough, rise_share * (fit.objective - lowest)):
            return replace(fit, steps=steps, settled=True)
        steps += 1
        next_fit = _advance(fit, step, gain)
        if next_fit is not None and next_fit.objective <= fit.objective:
            slow = max(idle_gain, (fit.objective - lowest) / _MAX_SEARCH_STEPS)
            idle = idle + 1 if fit.objective - next_fit.objective <= slow else 0
            fit, damping = next_fit, max(damping / damping_range[1] ** 2, damping_range[0])
        elif gain <= jitter:
            return replace(fit, steps=steps, settled=True)
        else:
            damping *= damping_range[1]
    return replace(fit, steps=steps, settled=steps < _MAX_SEARCH_STEPS)


def _advance(fit: Fit, step: Floats, gain: float) -> Fit | None:
    """Evaluate a step, or part of it if a parabola has its minimum well before.

    In a narrow curved valley whole steps oscillate between its sides.
    """
    whole_share = 0.75  # of a step, from which the whole step is taken
    shortest_share = 0.1
    full_step = _try(fit, step)
    if full_step is None:
        return None
    share = gain / max(full_step.objective - fit.objective + 2.0 * gain, gain)
    if share > whole_share:
        return full_step
    part = _try(fit, max(share, shortest_share) * step)
    return part if part is not None and part.objective < full_step.objective else full_step


def _try(fit: Fit, step: Floats) -> Fit | None:
    """Take a step; None where the model cannot follow, so that the step is shortened."""
    try:
        return evaluate(fit.problem, fit.levels, move(fit, step), fit.models)
    except ValueError:
        return None


def move(fit: Fit, step: Floats) -> Floats:
    """Return the unknowns after a step, within the bounds."""
    unknowns = fit.unknowns + step
    unknowns[:P] = np.clip(unknowns[:P], fit.problem.lower, fit.problem.upper)
    return unknowns


def _find_step(fit: Fit, damping: float) -> tuple[Floats, float]:
    """Return a step within the bounds, and the gain that a parabola predicts.

    Parameters that cross a bound stop there, and the others are solved again, because a clipped
    step need not lead downhill.
    """
    longest_step = 1.5
    problem = fit.problem
    matrix, pull, moves = make_normal_equations(fit)
    fixed = np.zeros(len(pull))
    while True:  # each round fixes at least one of the parameters
        step = np.zeros(len(pull))
        if moves.any():
            unit, scale = scale_matrix(matrix[np.ix_(moves, moves)], damping)
            remaining = (pull - matrix @ fixed)[moves]
            step[moves] = np.linalg.solve(unit, remaining / scale) / scale
            step *= min(1.0, longest_step / max(float(np.max(np.abs(step))), 1e-300))
        step += fixed
        target = fit.logs + step[:P]
        beyond = moves[:P] & ((target < problem.lower) | (target > problem.upper))
        if not beyond.any():
            return step, float(step @ pull)
        fixed[:P][beyond] = (np.clip(target, problem.lower, problem.upper) - fit.logs)[beyond]
        moves[:P] &= ~beyond
