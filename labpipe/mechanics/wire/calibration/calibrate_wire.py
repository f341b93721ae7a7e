"""Calibrate the wire model by first loading of cantilevers, and predict loading curves.

Tests of several samples and lengths of one wire determine phi = F_rad (mu_s + mu_p), the modulus of
the insulation and the strength of the copper, as in section 3.4 of [1]_. F_rad is the radial force
of the insulation, and mu_s + mu_p is the sum of the friction coefficients of the outermost ring.
Intervals are those of the profile likelihood with quantiles of Student's t. Notes state which
parameters the tests do not determine. The loading curves of other lengths and wires are predicted
from a calibration. `objective` defines the objective, `law_components` the law, and
`wire.first_loading` the loading curve.

References
----------
.. [1] *Modeling and characterization of wire harnesses for digital manufacturing applications*,
       dissertation.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from labpipe.mechanics.law.plays import require
from labpipe.mechanics.wire.calibration import identification, local_minima, objective
from labpipe.mechanics.wire.calibration.law_components import compute_loading_curve
from labpipe.mechanics.wire.calibration.local_minima import LocalMinimum, Minima, find_minima
from labpipe.mechanics.wire.calibration.measured_curves import (
    MeasuredCurve,
    compare_with_model,
    select_usable_curves,
    whiten,
)
from labpipe.mechanics.wire.calibration.objective import P, Settings, Wire, search, set_up_problem
from labpipe.mechanics.wire.calibration.variances import compute_quantiles, estimate_uncertainty
from labpipe.mechanics.wire.cantilever import StringRig
from labpipe.mechanics.wire.first_loading import LoadingCurve, interpolate_force
from labpipe.messages import format_sentence
from labpipe.records.arrays import Floats
from labpipe.records.curve import NORMAL_95, Interval
from labpipe.records.quality import QualityNote
from labpipe.records.wire import (
    PARAMETER_UNITS,
    PARAMETERS,
    CalibratedParameter,
    Calibration,
    CalibrationFailure,
    CurveAgreement,
    Identifiability,
    NoiseLevels,
    ParameterChoice,
    Prediction,
    PriorConflict,
    Profile,
    Separability,
    Solution,
)

__all__ = ["MeasuredCurve", "Settings", "Wire", "calibrate"]


def calibrate(
    wire: Wire, curves: Sequence[MeasuredCurve], settings: Settings | None = None
) -> Calibration | CalibrationFailure:
    """Calibrate a wire by tests of several samples and lengths.

    Parameters
    ----------
    wire : wire with the nominal values of its sheet
    curves : measured curves of first loading, all of this wire
    settings : treatment of parameters, gain uncertainty of the load cell, and scatter of samples;
        None for the default

    Returns
    -------
    The calibration, or a failure: ``model_cannot_follow``, or one of `select_usable_curves` and
    `set_up_problem`.
    """
    settings = settings or Settings()
    usable = select_usable_curves(tuple(curves))
    if isinstance(usable, CalibrationFailure):
        return usable
    setup = set_up_problem(wire.law, usable, settings)
    if isinstance(setup, CalibrationFailure):
        return setup
    try:
        minima = find_minima(*setup)
    except ValueError as error:
        return CalibrationFailure.of("mechanics.wire.model_cannot_follow", error=error)
    return make_calibration(minima, settings)


_RISE_RATIO_99 = 1.727
"""Rise of the objective at the ends of a 99 % interval, relative to that at the ends of a 95 % one.

Solutions outside the 95 % set are reported up to this multiple of their limit.
"""


def make_calibration(minima: Minima, settings: Settings) -> Calibration:
    """Build the record of a calibration.

    Parameters
    ----------
    minima : local minima of the objective
    settings : settings of the calibration
    """
    fit, problem = minima.fit, minima.fit.problem
    candidates = [_make_solution(minima, minimum) for minimum in minima.local_minima]
    solutions = tuple(item for item in candidates if item.rise <= _RISE_RATIO_99 * item.limit)
    parameters = tuple(
        _make_parameter(minima, solutions, index, settings.choices.get(name, ParameterChoice()))
        for index, name in enumerate(PARAMETERS)
    )
    models_and_factors = zip(problem.curves, fit.model_forces, fit.factors, strict=True)
    agreements = tuple(
        compare_with_model(curve, model.force, float(factor))
        for curve, model, factor in models_and_factors
    )
    sse = sum(curve.sse for curve in agreements)
    rmse = float(np.sqrt(sse / problem.n_points))
    return Calibration(
        wire=problem.curves[0].wire,
        parameters=parameters,
        solutions=solutions,
        widening=minima.widening,
        correlations=_compute_correlations(minima),
        levels=_make_noise_levels(minima),
        separability=_compute_separability(minima),
        curves=agreements,
        n_points=problem.n_points,
        n_samples=problem.n_samples,
        sse=sse,
        rmse=rmse,
        rmse_share=rmse / max(curve.peak for curve in problem.curves),
        method=format_sentence("mechanics.wire.method"),
        notes=tuple(_find_notes(minima, parameters, solutions, agreements)),
    )


def _make_solution(minima: Minima, minimum: LocalMinimum) -> Solution:
    """Build the record of a solution from a local minimum."""
    fit, problem = minimum.fit, minimum.fit.problem
    pairs = zip(problem.curves, fit.model_forces, strict=True)
    residuals = np.concatenate([curve.force - model.force for curve, model in pairs])
    return Solution(
        values=np.where(problem.law.is_active, np.exp(fit.logs), np.nan),
        rise=minimum.rise,
        rmse=float(np.sqrt(np.mean(residuals**2))),
        covariance=minimum.uncertainty.covariance,
        mixture=minimum.mixture,
        limit=local_minima.compute_limit(minima, minimum),
    )


def _make_parameter(
    minima: Minima, solutions: tuple[Solution, ...], index: int, choice: ParameterChoice
) -> CalibratedParameter:
    """Build the record of a parameter, with profiles, verdict and comparison with its prior."""
    name, problem, uncertainty = PARAMETERS[index], minima.fit.problem, minima.lowest.uncertainty
    value = float(np.exp(minima.fit.logs[index]))
    if not problem.law.is_active[index]:
        text = f"{identification.PHRASES[name]} does not act on this wire"
        return CalibratedParameter(name, PARAMETER_UNITS[name], np.nan, explanation=text)
    if not problem.is_free[index]:
        fixed = CalibratedParameter(name, PARAMETER_UNITS[name], value, source=choice.source)
        return replace(fixed, explanation=identification.describe_parameter(fixed))
    profiles = local_minima.follow_profiles(minima, index)
    parameter = CalibratedParameter(
        name=name,
        unit=PARAMETER_UNITS[name],
        value=value,
        intervals=tuple(
            Interval(*np.exp(ends).tolist()) for ends in local_minima.unite_intervals(profiles)
        ),
        log_error=float(np.sqrt(uncertainty.covariance[index, index])),
        freedom=uncertainty.compute_freedom(np.eye(P + 1)[index]),
        is_open_below=any(profile.is_open_below for profile in profiles),
        is_open_above=any(profile.is_open_above for profile in profiles),
        at_bound=_find_active_bound(minima, index),
        profiles=tuple(
            Profile(np.exp(item.logs), item.deviance, item.threshold_below, item.threshold_above)
            for item in profiles
        ),
        conflict=_fit_without_prior(minima, index, choice) if choice.factor is not None else None,
    )
    alternatives = tuple(
        (float(solution.values[index]), solution.likelihood)
        for solution in solutions
        if not solution.is_allowed
    )
    interval_99 = _find_interval_at_99(minima, index, parameter)
    verdict = identification.find_verdict(parameter, alternatives, interval_99)
    parameter = replace(parameter, verdict=verdict)
    text = identification.describe_parameter(parameter, alternatives, interval_99)
    return replace(parameter, explanation=text)


def _find_interval_at_99(
    minima: Minima, index: int, parameter: CalibratedParameter
) -> tuple[float, float]:
    """Find the ends of the 99 % interval, including values on the line of minima.

    An identified parameter must also be identified at 99 %, because noise may shorten an interval.
    The profiles are followed to 99 % only if this can change the verdict.
    """
    # With a smaller ratio of the ends at 95 %, the ratio at 99 % is below `MAX_IDENTIFIED_RATIO`.
    min_ratio = 1.5
    lower, upper = parameter.intervals[0].lower, parameter.intervals[-1].upper
    line_range = local_minima.find_line_range(minima, index, _RISE_RATIO_99)
    interval_ends = [lower, upper, *np.exp(line_range).tolist()]
    is_wide = max(interval_ends) > min_ratio * min(interval_ends)
    if is_wide and upper < identification.MAX_IDENTIFIED_RATIO * lower:
        for profile in local_minima.follow_profiles(minima, index, factor=_RISE_RATIO_99):
            interval_ends += np.exp([profile.lower, profile.upper]).tolist()
    return min(interval_ends), max(interval_ends)


def _find_active_bound(minima: Minima, index: int) -> str:
    """Return the bound at which the search ended; empty without a bound or a slope beyond it."""
    min_slope = 0.05  # slope of half the objective over the logarithm of the parameter
    log_value, problem = minima.fit.logs[index], minima.fit.problem
    slope = -float(objective.make_normal_equations(minima.fit)[1][index])
    if log_value <= problem.lower[index] and slope > min_slope:
        return "lower"
    return "upper" if log_value >= problem.upper[index] and slope < -min_slope else ""


def _fit_without_prior(minima: Minima, index: int, choice: ParameterChoice) -> PriorConflict:
    """Fit without the prior of a parameter, and compare the fit with the prior.

    The size of a conflict is the square root of the decrease of the objective without the prior.
    """
    prior_fit, problem = minima.fit, minima.fit.problem
    precision = np.where(np.arange(P) == index, 0.0, problem.prior_precision)
    free_problem = replace(problem, prior_precision=precision)
    fits = [
        search(free_problem, prior_fit.levels, minimum.fit.unknowns, guess=minimum.fit.model_forces)
        for minimum in minima.local_minima
    ]
    fit = min(fits, key=lambda fit: fit.objective)
    uncertainty = estimate_uncertainty(fit)
    variance = float(uncertainty.covariance[index, index])
    # The variance of the prior is known; the degrees of freedom of the sum are Satterthwaite's.
    variance_ratio = (variance + 1.0 / problem.prior_precision[index]) / variance
    freedom = uncertainty.compute_freedom(np.eye(P + 1)[index]) * variance_ratio**2
    conflict = PriorConflict(
        centre=float(np.exp(problem.prior_centre[index])),
        factor=float(choice.factor or np.nan),
        estimate=float(np.exp(fit.logs[index])),
        size=float(np.sqrt(max(prior_fit.objective - fit.objective, 0.0))),
        freedom=float(freedom),
        source=choice.source,
    )
    return identification.compare_with_prior(PARAMETERS[index], conflict)


def _compute_correlations(minima: Minima) -> Floats:
    """Compute the correlations of fitted parameters, shape (3, 3); NaN for the other parameters."""
    covariance, is_free = minima.lowest.uncertainty.covariance[:P, :P], minima.fit.problem.is_free
    errors = np.sqrt(np.diag(covariance))[is_free]
    correlations = np.full((P, P), np.nan)
    free_entries = np.ix_(is_free, is_free)
    correlations[free_entries] = covariance[free_entries] / np.outer(errors, errors)
    return correlations


def _make_noise_levels(minima: Minima) -> NoiseLevels:
    """Build the record of noise and scatter, with the degrees of freedom of their variances."""
    level_covariance, levels = minima.lowest.uncertainty.level_covariance, minima.fit.levels
    scatter_freedom = 0.0 if minima.fit.problem.scatter is None else np.inf
    if level_covariance[1, 1] > 0.0:
        scatter_freedom = 2.0 / float(level_covariance[1, 1])
    return NoiseLevels(
        noise_factor=float(np.sqrt(levels.noise)),
        correlation=levels.correlation,
        scatter=levels.scatter,
        gain=minima.fit.problem.gain_uncertainty,
        scatter_freedom=scatter_freedom,
        noise_freedom=2.0 / float(level_covariance[0, 0]),
    )


def _compute_separability(minima: Minima) -> Separability:
    """Compute the separability of the active parameters, without the scatter of samples."""
    fit = minima.fit
    active = np.flatnonzero(fit.problem.law.is_active).tolist()
    whitened_derivatives = [
        whiten((model.sensitivity[active] / np.asarray(curve.noise)).T, fit.levels.correlation)
        for model, curve in zip(fit.model_forces, fit.problem.curves, strict=True)
    ]
    jacobian = np.concatenate(whitened_derivatives) / np.sqrt(fit.levels.noise)
    names = tuple(PARAMETERS[index] for index in active)
    return identification.find_separability(names, jacobian, "the parameters that act")


def _find_notes(
    minima: Minima,
    parameters: tuple[CalibratedParameter, ...],
    solutions: tuple[Solution, ...],
    agreements: tuple[CurveAgreement, ...],
) -> Iterator[QualityNote]:
    """Yield notes on parameters, several solutions, noise and scatter."""
    for parameter in parameters:
        name, text, conflict = parameter.name, parameter.explanation, parameter.conflict
        if parameter.at_bound:
            yield QualityNote.of("mechanics.wire.at_bound", name, explanation=text)
        if parameter.verdict is Identifiability.NOT_IDENTIFIED:
            yield QualityNote.of("mechanics.wire.not_identified", name, explanation=text)
        if conflict is not None and conflict.contradicts:
            text = conflict.message
            yield QualityNote.of("mechanics.wire.prior_contradicts_data", name, explanation=text)
    if len(solutions) > 1:
        wire = minima.fit.problem.curves[0].wire
        description = identification.describe_solutions(solutions)
        yield QualityNote.of("mechanics.wire.two_solutions", wire, description=description)
    yield from _find_level_notes(minima, agreements)


def _find_level_notes(
    minima: Minima, agreements: tuple[CurveAgreement, ...]
) -> Iterator[QualityNote]:
    """Yield notes on noise, scatter of samples, correlation and convergence."""
    noise_ratio_range = (0.8, 1.25)  # estimated noise relative to stated noise
    max_correlation = 0.3  # correlation of neighbouring residuals
    fit, problem, levels = minima.fit, minima.fit.problem, minima.fit.levels
    wire = problem.curves[0].wire
    if problem.n_samples == 1 and problem.scatter is None:
        yield QualityNote.of("mechanics.wire.one_sample", wire)
    factor = float(np.sqrt(levels.noise))
    if not noise_ratio_range[0] <= factor <= noise_ratio_range[1]:
        yield QualityNote.of("mechanics.wire.noise_misstated", wire, factor=factor)
    if levels.correlation > max_correlation:
        worst_curve = max(agreements, key=lambda curve: curve.lag_one_correlation)
        yield QualityNote.of(
            "mechanics.wire.residuals_correlated",
            wire,
            correlation=levels.correlation,
            test=worst_curve.test,
            largest=worst_curve.lag_one_correlation,
        )
    if not fit.has_converged:
        yield QualityNote.of("mechanics.wire.search_unsettled", wire, steps=fit.n_steps)


def predict(
    calibration: Calibration,
    wire: Wire,
    length: float,
    deflection: Floats,
    *,
    rig: StringRig | None = None,
    noise: float = 0.0,
) -> Prediction:
    """Predict the loading curve of a wire, with 95 % bands.

    Parameters
    ----------
    calibration : calibration of this wire or of another wire
    wire : wire with the nominal values of its sheet. Calibrated values replace phi, the modulus of
        the insulation and the copper scale
    length : m, length of the wire
    deflection : shape (n,), m, deflections of the tip
    rig : string and counterweight; None for an end load normal to the undeformed axis
    noise : N, standard deviation of a measured force

    Returns
    -------
    The curve of the best solution with two bands. Both contain the uncertainty of the parameters
    (linear in their logarithms) and of the gain. The band of a measured curve also contains the
    scatter of samples and the noise. With several solutions, a band extends from the lowest lower
    limit to the highest upper limit of all solutions. A solution with a higher objective has a
    narrower band. Bands do not include differences between the calibrated wire and this wire
    (dimensions, lots of copper and insulation).

    Raises
    ------
    ValueError
        If a deflection is negative, or first loading or the stress-strain curve of a material ends
        before the largest.

    Notes
    -----
    The bands are pointwise, with quantiles of t averaged over the possible scatters of samples.
    The noise, with the standard deviation s, is added as 1.96 s in quadrature.
    """
    max_deflection = float(np.nanmax(deflection))
    forces, lower_limits, upper_limits = [], [], []
    for solution in (solution for solution in calibration.solutions if solution.is_allowed):
        curve = compute_calibrated_curve(wire, solution.values, length, rig, max_deflection)
        force, sensitivity = interpolate_force(curve, deflection)
        gradients = np.vstack([sensitivity, force]).T
        quantiles = (
            compute_quantiles(solution.mixture, gradients, slope) for slope in (0.0, force)
        )
        # A band contains its curve, also if both quantiles have the same sign.
        mean_error, error = (np.maximum([-below, above], 0.0) for below, above in quantiles)
        scatter = np.sqrt(np.maximum(error**2 - mean_error**2, 0.0))
        # A nonlinear model has wider bands, a solution with a rise has narrower bands.
        mean_error *= calibration.widening * np.sqrt(1.0 - solution.rise / solution.limit)
        error = np.hypot(np.hypot(mean_error, scatter), NORMAL_95 * noise)
        forces.append(force)
        lower_limits.append((force - error[0], force - mean_error[0]))
        upper_limits.append((force + error[1], force + mean_error[1]))
    lower, lower_mean = np.min(lower_limits, axis=0)
    upper, upper_mean = np.max(upper_limits, axis=0)
    notes = tuple(_find_prediction_notes(calibration))
    return Prediction(deflection, forces[0], lower, upper, lower_mean, upper_mean, notes)


def _find_prediction_notes(calibration: Calibration) -> Iterator[QualityNote]:
    """Yield notes on unknown scatter, several solutions and parameters with open intervals."""
    if calibration.levels.scatter_freedom == 0.0:
        yield QualityNote.of("mechanics.wire.predicted_sample", calibration.wire)
    count = sum(solution.is_allowed for solution in calibration.solutions)
    if count > 1:
        yield QualityNote.of("mechanics.wire.predicted_solutions", calibration.wire, count=count)
    for name in PARAMETERS:
        parameter = calibration.get_parameter(name)
        if parameter.is_open_below or parameter.is_open_above:
            text = parameter.explanation
            yield QualityNote.of("mechanics.wire.predicted_open", name, explanation=text)


def find_tested_curvature(wire: Wire, values: Floats, curves: Sequence[MeasuredCurve]) -> float:
    """Find the largest curvature at the clamp that the curves reach, 1/m.

    Parameters
    ----------
    wire : calibrated wire
    values : shape (3,), calibrated values of `PARAMETERS`; NaN for parameters without effect
    curves : measured curves of this wire. Its `self_weight` is used, not that of the curves

    Raises
    ------
    ValueError
        If there is no curve, or first loading or the stress-strain curve of a material ends before
        the end of a measured curve.
    """
    require("curves", list(curves), "at least one", holds=bool(curves))
    curvatures = []
    for curve in curves:
        peak = float(np.nanmax(curve.deflection))
        loading = compute_calibrated_curve(wire, values, curve.length, curve.rig, peak)
        loading.require_reached(np.array([peak]))
        curvatures.append(float(loading.clamp_curvature[-1]))
    return max(curvatures)


def compute_calibrated_curve(
    wire: Wire, values: Floats, length: float, rig: StringRig | None, deflection: float
) -> LoadingCurve:
    """Compute the loading curve of a wire with calibrated values, up to a deflection.

    Parameters
    ----------
    wire : calibrated wire, or another wire of the same type
    values : shape (3,), calibrated values of `PARAMETERS`; NaN for the nominal value
    length, rig, deflection : length and rig of the wire, and largest deflection of its tip, as for
        `compute_loading_curve`

    Raises
    ------
    ValueError
        If the stress-strain curve of a material ends before the deflection is reached, or no
        equilibrium is found.
    """
    law = wire.law
    values = np.where(np.isnan(values), law.nominal, values)
    return compute_loading_curve(law, values, length, rig, deflection, self_weight=wire.self_weight)
