"""Calibration of the wire model by first loadings of cantilevers (PHYSICS 6, dissertation 3.4).

Several samples and lengths of one wire determine phi = F_rad (mu_s + mu_p), the modulus of the
insulation and the strength of the copper. Intervals come from the profile likelihood with t
quantiles; notes state what the tests do not determine. The objective is that of `objective`,
the law that of `law_components`, the loading curve that of `first_loading`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from labpipe.mechanics.wire.calibration.fit import (
    FRICTION_NAMES,
    NAMES,
    WELL,
    CalibrationFit,
    Settings,
    Wire,
    compute_friction_jacobian,
    describe_parameter,
    describe_solutions,
    find_separability,
    find_verdict,
    fit_wire,
    has_other_value,
    weigh_prior,
)
from labpipe.mechanics.wire.calibration.local_minima import LocalMinimum
from labpipe.mechanics.wire.calibration.measured_curves import (
    MeasuredCurve,
    compare_with_model,
    whiten,
)
from labpipe.mechanics.wire.calibration.objective import P, compute_pull
from labpipe.mechanics.wire.calibration.profile_likelihood import (
    Trace,
    compute_limit,
    find_reach,
    follow_profiles,
    unite_intervals,
)
from labpipe.mechanics.wire.calibration.search import search
from labpipe.mechanics.wire.calibration.variances import estimate_uncertainty
from labpipe.records.arrays import Flags, Floats
from labpipe.records.curve import Interval
from labpipe.records.quality import QualityNote
from labpipe.records.wire_calibration import (
    PARAMETERS,
    UNITS,
    CalibratedParameter,
    Calibration,
    CalibrationFailure,
    CurveAgreement,
    Identifiability,
    NoiseLevels,
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
    wire : nominal, from its sheet
    curves : first loadings, all of one wire
    settings : which parameters are free, fixed or have a prior; gain of the load cell

    Returns
    -------
    The calibration; or a failure ``no_sample_usable``, ``wires_mixed``, ``noise_not_positive``,
    ``deflection_too_large``, ``too_few_points``, ``parameter_without_effect``,
    ``value_out_of_bounds`` or ``model_cannot_follow``.

    Raises
    ------
    ValueError
        If a choice has an unknown name, or a number is out of its range.
    """
    result = fit_wire(wire, curves, settings or Settings())
    return result if isinstance(result, CalibrationFailure) else make_calibration(result)


METHOD = (
    "generalised least squares on the force over logarithms of the parameters; levels of noise, "
    "samples and load cell; scatter of samples by restricted likelihood; profile likelihood from "
    "every local minimum of the objective, with quantiles of t averaged over the possible scatter"
)
_UNLIKELY_RISE = 1.727
"""Rise of the objective at 99 %, over that at 95 %: up to it other solutions are reported."""


def make_calibration(result: CalibrationFit) -> Calibration:
    """Make the record of a calibration.

    Parameters
    ----------
    result : the fit and all that it rests on
    """
    problem = result.problem
    solutions = tuple(_solution(result, minimum) for minimum in result.local_minima)
    solutions = tuple(
        solution for solution in solutions if solution.rise <= _UNLIKELY_RISE * solution.limit
    )
    parameters = tuple(_parameter(result, solutions, number) for number in range(P))
    compared = tuple(_agreements(result))
    sse = sum(curve.sse for curve in compared)
    rmse = float(np.sqrt(sse / problem.n_points))
    levels = _noise_levels(result)
    return Calibration(
        wire=problem.curves[0].wire,
        parameters=parameters,
        solutions=solutions,
        widening=result.widening,
        correlations=_correlations(result.spread.covariance[:P, :P], result.free),
        levels=levels,
        separability=_separability(result),
        friction_separability=_friction_separability(result),
        curves=compared,
        n_points=problem.n_points,
        n_samples=problem.n_samples,
        sse=sse,
        rmse=rmse,
        rmse_share=rmse / max(curve.peak for curve in problem.curves),
        method=METHOD,
        notes=tuple(_notes(result, parameters, solutions, compared)),
    )


def _solution(result: CalibrationFit, minimum: LocalMinimum) -> Solution:
    residuals = [
        curve.force - model.force
        for curve, model in zip(result.problem.curves, minimum.fit.models, strict=True)
    ]
    acts = np.array(result.problem.parts.has)
    return Solution(
        values=np.where(acts, np.exp(minimum.fit.point.logs), np.nan),
        rise=minimum.rise,
        rmse=float(np.sqrt(np.mean(np.concatenate(residuals) ** 2))),
        covariance=minimum.spread.covariance,
        mixture=minimum.mixture,
        limit=compute_limit(result, minimum),
    )


def _parameter(
    result: CalibrationFit, solutions: tuple[Solution, ...], number: int
) -> CalibratedParameter:
    """Return one parameter, with profile, verdict and comparison with its prior."""
    name, problem = PARAMETERS[number], result.problem
    value = float(np.exp(result.fit.point.logs[number]))
    if not problem.parts.has[number]:
        text = f"{NAMES[name]} does not act on this wire"
        return CalibratedParameter(name, UNITS[name], np.nan, explanation=text)
    if not result.free[number]:
        source = result.settings.choices[name].source if name in result.settings.choices else ""
        fixed = CalibratedParameter(name, UNITS[name], value, source=source)
        return replace(fixed, explanation=describe_parameter(fixed))
    traced = follow_profiles(result, number)
    intervals = tuple(Interval(*np.exp(ends).tolist()) for ends in unite_intervals(traced))
    parameter = CalibratedParameter(
        name=name,
        unit=UNITS[name],
        value=value,
        intervals=intervals,
        log_error=float(np.sqrt(result.spread.covariance[number, number])),
        freedom=result.spread.freedom(np.eye(P + 1)[number]),
        is_open_below=any(trace.is_open_below for trace in traced),
        is_open_above=any(trace.is_open_above for trace in traced),
        at_bound=_reached_bound(result, number),
        profiles=tuple(map(_profile, traced)),
        conflict=_prior_conflict(result, number) if problem.precision[number] > 0.0 else None,
    )
    other_parameters = tuple(
        (float(solution.values[number]), solution.likelihood)
        for solution in solutions
        if not solution.is_allowed
    )
    ends = _interval_at_99(result, number, parameter)
    parameter = replace(
        parameter, verdict=_verdict(result, number, parameter, other_parameters, ends)
    )
    return replace(parameter, explanation=describe_parameter(parameter, other_parameters, ends))


def _interval_at_99(
    result: CalibrationFit, number: int, parameter: CalibratedParameter
) -> tuple[float, float]:
    """Return the ends of what the tests allow at 99 %, including the line of minima.

    An identified parameter must be so at 99 %, too: noise may happen to shorten an interval.
    """
    min_span = 1.5  # with a narrower interval the one at 99 % spans less than `WELL`, too
    low, high = parameter.intervals[0].lower, parameter.intervals[-1].upper
    ends = [low, high, *np.exp(find_reach(result, number, _UNLIKELY_RISE)).tolist()]
    if min_span < high / low < WELL:
        for trace in follow_profiles(result, number, unlikely=_UNLIKELY_RISE):
            ends += np.exp([trace.lower, trace.upper]).tolist()
    return min(ends), max(ends)


def _verdict(
    result: CalibrationFit,
    number: int,
    parameter: CalibratedParameter,
    others: Sequence[tuple[float, float]],
    ends: tuple[float, float],
) -> Identifiability:
    low, high = parameter.intervals[0].lower, parameter.intervals[-1].upper
    wide = [*ends, *(value for value, _ in others)]
    conflict = parameter.conflict
    return find_verdict(
        high / low,
        span_with_others=max(wide) / min(wide),
        at_bound=bool(parameter.at_bound),
        is_open=parameter.is_open_below or parameter.is_open_above,
        log_error=parameter.log_error,
        prior_error=float(result.problem.precision[number]) ** -0.5 if conflict else np.inf,
        contradicts=conflict is not None and conflict.contradicts,
        is_split=len(parameter.intervals) > 1 or has_other_value(parameter, others),
    )


def _reached_bound(result: CalibrationFit, number: int) -> str:
    """Return the bound that the search presses on; none on a flat objective."""
    min_bound_slope = 0.05  # of half the objective: a flatter one does not press on the bound
    value, problem = result.fit.point.logs[number], result.problem
    pull = float(compute_pull(problem, result.levels, result.fit)[number])
    if value <= problem.lower[number] and pull < -min_bound_slope:
        return "lower"
    return "upper" if value >= problem.upper[number] and pull > min_bound_slope else ""


def _profile(trace: Trace) -> Profile:
    return Profile(np.exp(trace.logs), trace.deviance, trace.threshold_below, trace.threshold_above)


def _prior_conflict(result: CalibrationFit, number: int) -> PriorConflict:
    """Fit without one prior; the loss of the objective is the square of the conflict."""
    name = PARAMETERS[number]
    precision = result.problem.precision.copy()
    precision[number] = 0.0
    problem = replace(result.problem, precision=precision)
    fits = [
        search(problem, result.levels, minimum.fit.point, result.free)
        for minimum in result.local_minima
    ]
    fit = min(fits, key=lambda fit: fit.objective)
    spread = estimate_uncertainty(
        problem, fit, result.free, result.levels, is_scatter_known=result.is_scatter_known
    )
    variance = float(spread.covariance[number, number])
    prior_variance = 1.0 / result.problem.precision[number]
    freedom = spread.freedom(np.eye(P + 1)[number]) * ((variance + prior_variance) / variance) ** 2
    numbers = PriorConflict(
        centre=float(np.exp(result.problem.centre[number])),
        factor=float(result.settings.choices[name].factor or np.nan),
        alone=float(np.exp(fit.point.logs[number])),
        size=float(np.sqrt(max(result.fit.objective - fit.objective, 0.0))),
        freedom=float(freedom),
        contradicts=False,
        message="",
        source=result.settings.choices[name].source,
    )
    return weigh_prior(name, numbers)


def _correlations(covariance: Floats, free: Flags) -> Floats:
    errors = np.sqrt(np.diag(covariance))
    out = np.full((P, P), np.nan)
    free_pairs = np.ix_(free, free)
    out[free_pairs] = covariance[free_pairs] / np.outer(errors[free], errors[free])
    return out


def _agreements(result: CalibrationFit) -> Iterator[CurveAgreement]:
    point = result.fit.point
    for curve, model, sample in zip(
        result.problem.curves, result.fit.models, result.problem.sample, strict=True
    ):
        yield compare_with_model(
            curve, model.force, float(np.exp(point.gain + point.offsets[sample]))
        )


def _noise_levels(result: CalibrationFit) -> NoiseLevels:
    spread, levels = result.spread.level_covariance, result.levels
    scatter_freedom = np.inf if result.is_scatter_known else 0.0
    if spread[1, 1] > 0.0:
        scatter_freedom = 2.0 / float(spread[1, 1])
    return NoiseLevels(
        noise_factor=float(np.sqrt(levels.noise)),
        correlation=levels.correlation,
        scatter=levels.scatter,
        gain=result.problem.gain,
        scatter_freedom=scatter_freedom,
        noise_freedom=2.0 / float(spread[0, 0]),
    )


def _separability(result: CalibrationFit) -> Separability:
    """Return the separability of the acting parameters, by noise without scatter of samples."""
    acting = np.flatnonzero(result.problem.parts.has).tolist()
    columns = [
        whiten(model.change[acting].T / np.asarray(curve.noise)[:, None], result.levels.correlation)
        for curve, model in zip(result.problem.curves, result.fit.models, strict=True)
    ]
    jacobian = np.concatenate(columns) / np.sqrt(result.levels.noise)
    names = tuple(PARAMETERS[number] for number in acting)
    return find_separability(names, jacobian, "the parameters that act")


def _friction_separability(result: CalibrationFit) -> Separability | None:
    """Return the separability of mu_s, mu_p and F_rad."""
    if not result.problem.parts.has[0]:
        return None
    wire, values = result.wire, np.exp(result.fit.point.logs)
    jacobian = compute_friction_jacobian(
        *(wire.section, wire.contacts, values, result.problem.curves),
        orientation=wire.orientation,
        correlation=result.levels.correlation,
    )
    jacobian /= np.sqrt(result.levels.noise)
    return find_separability(FRICTION_NAMES, jacobian, "mu_s, mu_p and F_rad")


def _notes(
    result: CalibrationFit,
    parameters: tuple[CalibratedParameter, ...],
    solutions: tuple[Solution, ...],
    compared: tuple[CurveAgreement, ...],
) -> Iterator[QualityNote]:
    for parameter in parameters:
        yield from _parameter_notes(parameter)
    if len(solutions) > 1:
        where, description = result.problem.curves[0].wire, describe_solutions(solutions)
        yield QualityNote.of("mechanics.wire.two_solutions", where, description=description)
    yield from _level_notes(result, compared)


def _level_notes(
    result: CalibrationFit, compared: tuple[CurveAgreement, ...]
) -> Iterator[QualityNote]:
    noise_ratio_range = (0.8, 1.25)  # estimated noise over stated noise
    max_correlation = 0.3  # of neighbouring residuals, without a note
    levels, where = result.levels, result.problem.curves[0].wire
    if result.problem.n_samples == 1 and not result.is_scatter_known:
        yield QualityNote.of("mechanics.wire.one_sample", where)
    factor = float(np.sqrt(levels.noise))
    if not noise_ratio_range[0] <= factor <= noise_ratio_range[1]:
        yield QualityNote.of("mechanics.wire.noise_misstated", where, factor=factor)
    if levels.correlation > max_correlation:
        worst_curve = max(compared, key=lambda curve: curve.lag_one_correlation)
        yield QualityNote.of(
            "mechanics.wire.residuals_correlated",
            where,
            correlation=levels.correlation,
            test=worst_curve.test,
            largest=worst_curve.lag_one_correlation,
        )
    if not result.fit.settled:
        yield QualityNote.of("mechanics.wire.search_unsettled", where, steps=result.fit.steps)


def _parameter_notes(parameter: CalibratedParameter) -> Iterator[QualityNote]:
    name, text, conflict = parameter.name, parameter.explanation, parameter.conflict
    if parameter.at_bound:
        yield QualityNote.of("mechanics.wire.at_bound", name, explanation=text)
    if parameter.verdict is Identifiability.NOT:
        yield QualityNote.of("mechanics.wire.not_identified", name, explanation=text)
    if conflict is not None and conflict.contradicts:
        text = conflict.message
        yield QualityNote.of("mechanics.wire.prior_contradicts_data", name, explanation=text)
