"""Define the objective of a calibration, and search for its minimum.

The objective is

    sum |W (F - exp(g + b_s) f(p))|^2 / v + sum b_s^2 / tau^2 + g^2 / u_g^2
    + sum (ln p - ln p_0)^2 / u_p^2.

The unknowns are the logarithms of the parameters p, the logarithm g of the gain of the load cell,
and the logarithms b_s of the factors of the samples. F are measured forces, f forces of the model.
The matrix W whitens the residuals, v is the variance of the noise relative to the stated variance,
and tau is the scatter of the samples. u_g and u_p are standard uncertainties of the gain and of the
priors p_0. The factors multiply the forces of the model, because a covariance computed from
measured forces would bias the model to small forces if the scatter is large (Peelle's puzzle). For
fixed levels v and tau, the objective is -2 times the logarithm of the likelihood and the priors, up
to a constant. It is minimised by damped Gauss-Newton steps within the bounds.

The unknowns are in one vector: the logarithms of P parameters, then that of the gain, then those of
the factors of the samples.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
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
"""Number of parameters.

It is also the index of the gain among the unknowns, and of the force of the model in `Fit.grams`.
"""


@dataclass(frozen=True, eq=False)
class Wire:
    """Wire with the nominal values of its sheet.

    Parameters
    ----------
    section : cross-section with nominal materials
    contacts : nominal radial force, and friction coefficients, whose ratios are not changed
    orientation : rad, rotation of the section relative to the neutral axis
    self_weight : N/m, weight per length of the wire
    linear_range : 1/m, largest curvature at which the insulation is linear
    """

    section: CrossSection
    contacts: Contacts
    orientation: float = 0.0
    self_weight: float = 0.0
    linear_range: float = np.inf

    @cached_property
    def law(self) -> WireLaw:
        """Law of the wire, split into its components."""
        return split_law(self.section, self.contacts, orientation=self.orientation)


@dataclass(frozen=True, slots=True, eq=False)
class Settings:
    """Settings of a calibration.

    Parameters
    ----------
    choices : treatment of parameters, keyed by the name of the parameter; other parameters are
        fitted if they have an effect on the wire
    gain : relative standard uncertainty of the gain of the load cell, common to all curves
    scatter : relative standard deviation of the factors of the samples; None to estimate it from
        the samples
    """

    choices: Mapping[str, ParameterChoice] = field(default_factory=dict)
    gain: float = 0.0
    scatter: float | None = None


SEARCH_RANGES: Mapping[str, tuple[float, float, float]] = {
    RADIAL_FRICTION: (1e-5, 0.05, 1e2),
    INSULATION_MODULUS: (1e5, 1e9, 1e11),
    COPPER_SCALE: (0.05, 1.0, 20.0),
}
"""Lower bound, first value and upper bound of each parameter, in N, Pa and 1.

The first value is used if the nominal value of the wire is zero.
"""


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """Input of a search.

    Parameters
    ----------
    law : law of the wire, split into its components
    curves : measured curves with usable points only
    sample_index : shape (curves,), index of the sample of each curve
    prior_centre : shape (3,), centres of the priors on the logarithms of the parameters
    prior_precision : shape (3,), inverse variances of the priors; 0 without a prior
    lower, upper : shape (3,), lower and upper bounds of the logarithms of the parameters
    gain_uncertainty : standard uncertainty of the logarithm of the gain of the load cell
    is_free : shape (3,), whether each parameter is fitted
    scatter : standard deviation of the logarithms of the factors of the samples; None to estimate
        it
    """

    law: WireLaw
    curves: tuple[MeasuredCurve, ...]
    sample_index: Ints
    prior_centre: Floats
    prior_precision: Floats
    lower: Floats
    upper: Floats
    gain_uncertainty: float
    is_free: Flags
    scatter: float | None = None

    def hold(self, index: int) -> Problem:
        """Return the problem in which the parameter with this index is not fitted."""
        return replace(self, is_free=self.is_free & (np.arange(P) != index))

    @property
    def n_samples(self) -> int:
        """Number of samples."""
        return int(self.sample_index.max()) + 1

    @property
    def n_points(self) -> int:
        """Number of points of all curves."""
        return sum(len(curve.force) for curve in self.curves)

    def compute_precision(self, scatter: float) -> Floats:
        """Compute the inverse prior variances of all unknowns; infinite for an unknown fixed at 0.

        Parameters
        ----------
        scatter : standard deviation of the logarithms of the factors of the samples
        """
        deviations = np.append(self.gain_uncertainty, np.full(self.n_samples, scatter))
        with np.errstate(divide="ignore"):
            return np.append(self.prior_precision, deviations**-2.0)

    def compute_offsets(self, unknowns: Floats) -> Floats:
        """Compute the differences of all unknowns from the centres of their priors."""
        return np.append(unknowns[:P] - self.prior_centre, unknowns[P:])


def set_up_problem(
    law: WireLaw, curves: tuple[MeasuredCurve, ...], settings: Settings
) -> tuple[Problem, Floats] | CalibrationFailure:
    """Set up the problem of a calibration.

    Parameters
    ----------
    law : law of the wire, split into its components
    curves : measured curves with usable points only
    settings : settings of the calibration

    Returns
    -------
    The problem and the logarithms from which the search starts, shape (3,); or a failure:
    ``parameter_without_effect``, ``value_out_of_bounds`` or ``too_few_points``.
    """
    logs, centre, precision, lower, upper = np.zeros((5, P))
    is_free = np.zeros(P, dtype=np.bool_)
    for index, name in enumerate(PARAMETERS):
        is_active, choice = law.is_active[index], settings.choices.get(name, ParameterChoice())
        if not is_active and name in settings.choices and not choice.is_fixed:
            return CalibrationFailure.of("mechanics.wire.parameter_without_effect", name=name)
        if not is_active:
            continue
        nominal, (lowest, first_value, highest) = float(law.nominal[index]), SEARCH_RANGES[name]
        value = choice.value or (nominal if nominal > 0.0 else first_value)
        low, high = choice.lower or lowest, choice.upper or highest
        if choice.is_fixed:
            low = high = value
        elif not low <= value <= high or low == high:
            text, bounds = format_value(name, value), format_value(name, low, high)
            return CalibrationFailure.of(
                "mechanics.wire.value_out_of_bounds", name=name, value=text, bounds=bounds
            )
        is_free[index] = not choice.is_fixed
        logs[index], lower[index], upper[index] = np.log([value, low, high])
        if choice.factor is not None and not choice.is_fixed:
            centre[index] = logs[index]
            precision[index] = (NORMAL_95 / np.log(choice.factor)) ** 2
    samples = list(dict.fromkeys(curve.sample for curve in curves))
    sample_index = np.array([samples.index(curve.sample) for curve in curves], dtype=np.int64)
    bounds_and_gain = lower, upper, settings.gain, is_free, settings.scatter
    problem = Problem(law, curves, sample_index, centre, precision, *bounds_and_gain)
    min_points = int(is_free.sum()) + problem.n_samples + 1
    if problem.n_points < min_points:
        return CalibrationFailure.of(
            "mechanics.wire.too_few_points",
            points=problem.n_points,
            parameters=int(is_free.sum()),
            samples=problem.n_samples,
            needed=min_points,
        )
    return problem, logs


@dataclass(frozen=True, slots=True, eq=False)
class ModelForce:
    """Forces of the model at the points of one curve.

    Parameters
    ----------
    force : shape (n,), N, force without the factor of the sample
    sensitivity : shape (3, n), N, derivatives of the force with respect to the logarithms of the
        parameters
    slope : shape (n,), N/m, derivative of the force with respect to deflection
    loading_curve : loading curve of the model, the first guess for similar parameters
    """

    force: Floats
    sensitivity: Floats
    slope: Floats
    loading_curve: LoadingCurve | None = None


def compute_model_forces(
    law: WireLaw,
    values: Floats,
    curves: tuple[MeasuredCurve, ...],
    guess: list[ModelForce] | None = None,
) -> list[ModelForce]:
    """Compute the force of the model at each point of the curves, without factors of samples.

    Parameters
    ----------
    law, values : law of the wire and values of its parameters, as for `compute_loading_curve`
    curves : measured curves
    guess : forces at similar values of the parameters; None if there are none

    Returns
    -------
    Forces for each curve.

    Raises
    ------
    ValueError
        If a curve goes beyond first loading, or no equilibrium is found.
    """
    forces: dict[int, ModelForce] = {}
    order = sorted(range(len(curves)), key=lambda i: curves[i].setup)
    for _, members in groupby(order, key=lambda i: curves[i].setup):
        indices = list(members)
        deflections = np.concatenate([curves[i].deflection for i in indices])
        curve = curves[indices[0]]  # all curves of a setup have the same length, rig and weight
        loading = compute_loading_curve(
            *(law, values, curve.length, curve.rig, float(np.max(deflections))),
            self_weight=curve.self_weight,
            guess=guess[indices[0]].loading_curve if guess else None,
        )
        force, sensitivity = interpolate_force(loading, deflections)
        slope = np.interp(deflections, loading.deflection, loading.stiffness)
        cuts = np.cumsum([len(curves[i].deflection) for i in indices])[:-1]
        split_arrays = (np.split(array, cuts, axis=-1) for array in (force, sensitivity, slope))
        for index, *arrays in zip(indices, *split_arrays, strict=True):
            forces[index] = ModelForce(arrays[0], arrays[1], arrays[2], loading)
    return [forces[index] for index in range(len(curves))]


def compute_whitened_products(
    curve: MeasuredCurve, columns: Floats, slope: Floats, correlation: float
) -> Floats:
    """Compute the Gram matrix of whitened columns of forces, relative to the stated noise.

    Parameters
    ----------
    curve : measured curve
    columns : shape (points, n), N, columns of forces
    slope : shape (points,), N/m, derivative of the force with respect to deflection
    correlation : correlation of the noise of neighbouring points

    Returns
    -------
    Shape (n, n).

    Notes
    -----
    With errors N that all points share, the covariance is R + N N', where R is that of the noise.
    For whitened columns W and whitened errors N the products are W'W - W'N (1 + N'N)^-1 N'W
    (Woodbury). The result is the same as if each error were fitted with its standard error as
    prior. If the residuals have more noise than stated, the shared errors are increased by the same
    factor.
    """
    noise = np.asarray(curve.noise)[:, None]
    white_columns = whiten(columns / noise, correlation)
    white_errors = whiten(compute_shared_errors(curve, slope).T / noise, correlation)
    products = white_errors.T @ white_columns
    capacitance = np.eye(white_errors.shape[1]) + white_errors.T @ white_errors
    correction = products.T @ np.linalg.solve(capacitance, products)
    return np.asarray(white_columns.T @ white_columns - correction)


@dataclass(frozen=True, slots=True)
class Levels:
    """Levels of noise and scatter.

    Parameters
    ----------
    noise : v, variance of the noise relative to the stated variance
    correlation : correlation of the noise of neighbouring points
    scatter : tau, standard deviation of the logarithms of the factors of the samples
    """

    noise: float
    correlation: float
    scatter: float


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """Objective and model for a set of unknowns, such as the result of a search.

    Parameters
    ----------
    problem : input of the search
    levels : levels of noise and scatter
    unknowns : shape (4 + samples,), logarithms of parameters, gain and factors of samples
    objective : value of the objective
    grams : shape (samples, 5, 5), Gram matrix of each sample. Its columns are the derivatives with
        respect to the three parameters, the force of the model and the residual
        (`compute_whitened_products`)
    model_forces : forces of the model for each curve
    n_steps : number of steps of the search
    has_converged : whether the search ended at a minimum; false if the largest number of steps was
        reached, or the model cannot follow the curves after a further step
    """

    problem: Problem
    levels: Levels
    unknowns: Floats
    objective: float
    grams: Floats
    model_forces: list[ModelForce]
    n_steps: int = 0
    has_converged: bool = False

    @property
    def logs(self) -> Floats:
        """Logarithms of the parameters, shape (3,)."""
        return self.unknowns[:P]

    @property
    def factors(self) -> Floats:
        """Factors on the forces of the model due to sample and load cell, shape (curves,)."""
        offsets = self.unknowns[P + 1 :][self.problem.sample_index]
        return np.asarray(np.exp(self.unknowns[P] + offsets))


def evaluate_objective(
    problem: Problem, levels: Levels, unknowns: Floats, guess: list[ModelForce] | None = None
) -> Fit:
    """Evaluate the objective; `guess` contains the forces of the model for similar unknowns."""
    forces = compute_model_forces(problem.law, np.exp(unknowns[:P]), problem.curves, guess)
    fit = Fit(problem, levels, unknowns, np.nan, np.zeros(0), forces)
    grams = compute_sample_grams(fit, levels.correlation)
    offsets = problem.compute_offsets(unknowns)
    precision = problem.compute_precision(levels.scatter)
    has_prior = np.isfinite(precision)
    prior_term = float(precision[has_prior] @ offsets[has_prior] ** 2)
    data_term = float(grams[:, -1, -1].sum()) / levels.noise
    return replace(fit, objective=data_term + prior_term, grams=grams)


def compute_sample_grams(fit: Fit, correlation: float) -> Floats:
    """Compute the Gram matrix of each sample, shape (samples, 5, 5), as in `Fit`."""
    problem = fit.problem
    grams = np.zeros((problem.n_samples, P + 2, P + 2))
    for curve, model, sample, factor in zip(
        problem.curves, fit.model_forces, problem.sample_index, fit.factors, strict=True
    ):
        force = factor * model.force
        columns = np.column_stack([factor * model.sensitivity.T, force, curve.force - force])
        grams[sample] += compute_whitened_products(curve, columns, model.slope, correlation)
    return grams


def make_normal_equations(fit: Fit) -> tuple[Floats, Floats, Flags]:
    """Make matrix and right side of the normal equations, and find the unknowns that may change.

    The matrix is half the Hessian of the objective, and the right side is minus half the gradient.
    """
    problem = fit.problem
    total, grams = fit.grams.sum(axis=0) / fit.levels.noise, fit.grams / fit.levels.noise
    cross_block, sample_block = grams[:, P, : P + 1], np.diag(grams[:, P, P])
    matrix = np.block([[total[: P + 1, : P + 1], cross_block.T], [cross_block, sample_block]])
    right_side = np.append(total[-1, : P + 1], grams[:, P, -1])
    precision = problem.compute_precision(fit.levels.scatter)
    may_change = np.isfinite(precision)
    precision = np.where(may_change, precision, 0.0)
    matrix[np.diag_indices_from(matrix)] += precision
    right_side -= precision * problem.compute_offsets(fit.unknowns)
    may_change[:P] = problem.is_free
    may_change[:P] &= ~((fit.logs <= problem.lower) & (right_side[:P] < 0.0))
    may_change[:P] &= ~((fit.logs >= problem.upper) & (right_side[:P] > 0.0))
    return matrix, right_side, may_change


def scale_matrix(matrix: Floats, ridge: float = 1e-12) -> tuple[Floats, Floats]:
    """Scale a symmetric matrix to a unit diagonal, and add a ridge.

    Parameters
    ----------
    matrix : shape (n, n), symmetric
    ridge : value added to the unit diagonal

    Returns
    -------
    The scaled matrix, and the scale of its rows and columns, shape (n,).
    """
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-30))
    return matrix / np.outer(scale, scale) + ridge * np.eye(len(scale)), scale


MAX_SOLUTION_RISE = 200.0
"""Rise of the objective above which a fit cannot be a solution.

The squared quantile of Student's t for two samples, 161, is smaller.
"""
_MAX_SEARCH_STEPS = 60
"""Largest number of steps of a search."""


def search(
    problem: Problem,
    levels: Levels,
    start: Floats,
    *,
    guess: list[ModelForce] | None = None,
    tolerance: float = 1e-5,
    best_objective: float = np.inf,
) -> Fit:
    """Search for a minimum of the objective.

    Parameters
    ----------
    problem : input of the search
    levels : levels of noise and scatter
    start : first guess of the unknowns; parameters that are not fitted keep these values
    guess : forces of the model near the start for each curve; None if there are none
    tolerance : predicted decrease of the objective below which the search ends; intervals depend on
        changes of 1
    best_objective : objective of a better fit; the tolerance increases with the rise above it

    Raises
    ------
    ValueError
        If the model cannot follow the curves at the start.
    """
    idle_decrease = 1e-3  # largest decrease of the objective in an idle step
    max_idle_steps = 3  # successive idle steps after which a search in a flat valley ends
    relative_tolerance = 1e-3  # decrease relative to the rise above the better fit
    table_error = 1e-2  # error of the objective because curves are tabulated
    min_damping, damping_factor = 1e-6, 10.0
    max_far_steps = 8  # largest number of steps with a rise above `MAX_SOLUTION_RISE`
    fit = evaluate_objective(problem, levels, start, guess)
    damping, n_steps, n_idle_steps = min_damping, 0, 0
    is_blocked = False  # whether the model cannot follow the curves after the last step
    while True:
        rise = fit.objective - best_objective
        max_steps = max_far_steps if rise > MAX_SOLUTION_RISE else _MAX_SEARCH_STEPS
        step, decrease = _compute_step(fit, damping)
        is_small = decrease <= max(tolerance, relative_tolerance * rise)
        has_ended = is_small or n_idle_steps >= max_idle_steps
        if has_ended or n_steps >= max_steps:
            return replace(fit, n_steps=n_steps, has_converged=has_ended and not is_blocked)
        n_steps += 1
        next_fit = _take_step(fit, step, decrease)
        is_blocked = next_fit is None
        if next_fit is not None and next_fit.objective <= fit.objective:
            max_idle_decrease = max(idle_decrease, rise / _MAX_SEARCH_STEPS)
            is_idle = fit.objective - next_fit.objective <= max_idle_decrease
            n_idle_steps = n_idle_steps + 1 if is_idle else 0
            fit, damping = next_fit, max(damping / damping_factor**2, min_damping)
        elif decrease <= table_error:
            return replace(fit, n_steps=n_steps, has_converged=not is_blocked)
        else:
            damping *= damping_factor


def _take_step(fit: Fit, step: Floats, decrease: float) -> Fit | None:
    """Evaluate a step, or a fraction of it if a parabola has its minimum well before the full step.

    `decrease` is the predicted decrease of the objective. In a narrow curved valley, full steps
    would oscillate between the sides of the valley.
    """
    min_full_fraction = 0.75  # the full step is taken if the minimum is beyond this fraction of it
    min_fraction = 0.1
    full_step = _evaluate_step(fit, step)
    if full_step is None:
        return None
    fraction = decrease / max(full_step.objective - fit.objective + 2.0 * decrease, decrease)
    if fraction > min_full_fraction:
        return full_step
    short_step = _evaluate_step(fit, max(fraction, min_fraction) * step)
    return short_step if short_step and short_step.objective < full_step.objective else full_step


def _evaluate_step(fit: Fit, step: Floats) -> Fit | None:
    """Evaluate a step; None if the model cannot follow the curves after the step."""
    try:
        return evaluate_objective(fit.problem, fit.levels, apply_step(fit, step), fit.model_forces)
    except ValueError:
        return None


def apply_step(fit: Fit, step: Floats) -> Floats:
    """Return the unknowns after a step, within the bounds."""
    unknowns = fit.unknowns + step
    unknowns[:P] = np.clip(unknowns[:P], fit.problem.lower, fit.problem.upper)
    return unknowns


def _compute_step(fit: Fit, damping: float) -> tuple[Floats, float]:
    """Compute a step within the bounds, and the decrease of the objective that it predicts.

    Parameters that would cross a bound stop at the bound. The step of the others is then solved
    again, because a clipped step may increase the objective.
    """
    longest_step = 1.5  # largest change of a logarithm
    problem = fit.problem
    matrix, right_side, may_change = make_normal_equations(fit)
    fixed_step = np.zeros(len(right_side))
    while True:  # each round fixes at least one of the parameters
        step = np.zeros(len(right_side))
        if may_change.any():
            unit, scale = scale_matrix(matrix[np.ix_(may_change, may_change)], damping)
            remainder = (right_side - matrix @ fixed_step)[may_change]
            step[may_change] = np.linalg.solve(unit, remainder / scale) / scale
            step *= min(1.0, longest_step / max(float(np.max(np.abs(step))), 1e-300))
        step += fixed_step
        target = fit.logs + step[:P]
        is_outside = may_change[:P] & ((target < problem.lower) | (target > problem.upper))
        if not is_outside.any():
            return step, float(step @ right_side)
        bounded_step = np.clip(target, problem.lower, problem.upper) - fit.logs
        fixed_step[:P][is_outside] = bounded_step[is_outside]
        may_change[:P] &= ~is_outside
