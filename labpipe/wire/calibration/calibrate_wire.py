"""Calibration of the wire model by first loadings of cantilevers (PHYSICS 6, source 3.4).

Of one wire, several samples and lengths determine phi = F_rad (mu_s + mu_p), the modulus of the
insulation and the strength of the copper, as far as they do: intervals come from the profile
likelihood with t quantiles, and what the tests do not say is said in words. The objective is that
of `parameter_search`, the law that of `wire_parts`, the loading curve the exact one of
`first_loading`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from labpipe.records.arrays import Flags, Floats
from labpipe.records.curve import Interval
from labpipe.records.quality import QualityNote, Severity
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
from labpipe.wire.calibration.fit import (
    FRICTION_NAMES,
    NAMES,
    WELL,
    CalibrationFit,
    Settings,
    Wire,
    find,
    friction_jacobian,
    is_elsewhere,
    separability,
    two_solutions,
    verdict_of,
    weigh_prior,
    words_of,
)
from labpipe.wire.calibration.local_minima import LocalMinimum
from labpipe.wire.calibration.measured_curves import MeasuredCurve, agreement, whiten
from labpipe.wire.calibration.parameter_search import P, pull_of, search
from labpipe.wire.calibration.profile_likelihood import Trace, limit_of, reach, traces, union
from labpipe.wire.calibration.variances import uncertainty

__all__ = ["MeasuredCurve", "Settings", "Wire", "calibrate"]


def calibrate(
    wire: Wire, curves: Sequence[MeasuredCurve], settings: Settings | None = None
) -> Calibration | CalibrationFailure:
    """Calibrate a wire by tests of several samples and lengths.

    Parameters
    ----------
    wire : as its sheet has it
    curves : first loadings, all of one wire
    settings : which parameters are free, fixed or have a prior, and what is known of the load cell

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
    found = find(wire, curves, settings or Settings())
    return found if isinstance(found, CalibrationFailure) else tell(found)


METHOD = (
    "generalised least squares on the force over logarithms of the parameters; levels of noise, "
    "samples and load cell; scatter of samples by restricted likelihood; profile likelihood from "
    "every least of the objective, with quantiles of t averaged over what that scatter may be"
)
_UNLIKELY_RISE = 1.727
"""Rise of the objective, over that at 95 %, up to which another solution is said, and up to which
what is called identified has its value: 99 %."""


def tell(found: CalibrationFit) -> Calibration:
    """Make the record of a calibration.

    Parameters
    ----------
    found : the fit and all that it rests on
    """
    problem = found.problem
    solutions = tuple(_solution(found, valley) for valley in found.valleys)
    solutions = tuple(
        solution for solution in solutions if solution.rise <= _UNLIKELY_RISE * solution.limit
    )
    parameters = tuple(_parameter(found, solutions, number) for number in range(P))
    compared = tuple(_agreements(found))
    sse = sum(curve.sse for curve in compared)
    rmse = float(np.sqrt(sse / problem.n_points))
    levels = _noise_levels(found)
    return Calibration(
        wire=problem.curves[0].wire,
        parameters=parameters,
        solutions=solutions,
        widening=found.widening,
        correlations=_correlations(found.spread.covariance[:P, :P], found.free),
        levels=levels,
        separability=_separability(found),
        friction_separability=_friction_separability(found),
        curves=compared,
        n_points=problem.n_points,
        n_samples=problem.n_samples,
        sse=sse,
        rmse=rmse,
        rmse_share=rmse / max(curve.peak for curve in problem.curves),
        method=METHOD,
        notes=tuple(_notes(found, parameters, solutions, compared)),
    )


def _solution(found: CalibrationFit, valley: LocalMinimum) -> Solution:
    left = [
        curve.force - model.force
        for curve, model in zip(found.problem.curves, valley.fit.models, strict=True)
    ]
    acts = np.array(found.problem.parts.has)
    return Solution(
        values=np.where(acts, np.exp(valley.fit.point.logs), np.nan),
        rise=valley.rise,
        rmse=float(np.sqrt(np.mean(np.concatenate(left) ** 2))),
        covariance=valley.spread.covariance,
        mixture=valley.mixture,
        limit=limit_of(found, valley),
    )


def _parameter(
    found: CalibrationFit, solutions: tuple[Solution, ...], number: int
) -> CalibratedParameter:
    """One parameter, with profile, verdict and the weighing of its prior."""
    name = PARAMETERS[number]
    value = float(np.exp(found.fit.point.logs[number]))
    if not found.free[number]:
        return _held(found, number, value)
    error = float(np.sqrt(found.spread.covariance[number, number]))
    traced = traces(found, number)
    parts = union(traced)
    conflict = _conflict(found, number) if _has_prior(found, number) else None
    parameter = CalibratedParameter(
        name=name,
        unit=UNITS[name],
        value=value,
        intervals=tuple(Interval(float(np.exp(low)), float(np.exp(high))) for low, high in parts),
        log_error=error,
        freedom=found.spread.freedom(np.eye(P + 1)[number]),
        is_open_below=any(each.is_open_below for each in traced),
        is_open_above=any(each.is_open_above for each in traced),
        at_bound=_bound(found, number),
        verdict=Identifiability.WELL,
        words="",
        profiles=tuple(map(_profile, traced)),
        conflict=conflict,
    )
    others = tuple(
        (float(solution.values[number]), solution.likelihood)
        for solution in solutions
        if not solution.is_allowed
    )
    ends = _widest(found, number, parameter)
    parameter = replace(parameter, verdict=_verdict(found, number, parameter, others, ends))
    return replace(parameter, words=words_of(parameter, others, ends))


def _widest(
    found: CalibrationFit, number: int, parameter: CalibratedParameter
) -> tuple[float, float]:
    """Ends of what the tests allow at 99 %, along the line of the leasts, or at all.

    Noise that happens to end an interval early, so that it just spans too little for a weak
    verdict, would be called knowledge: what is identified must be so at 99 %, too.
    """
    min_span = 1.5  # with a narrower interval the one at 99 % spans less than `WELL`, too
    low, high = parameter.intervals[0].lower, parameter.intervals[-1].upper
    ends = [low, high, *np.exp(reach(found, number, _UNLIKELY_RISE)).tolist()]
    if min_span < high / low < WELL:
        for traced in traces(found, number, unlikely=_UNLIKELY_RISE):
            ends += np.exp([traced.lower, traced.upper]).tolist()
    return min(ends), max(ends)


def _verdict(
    found: CalibrationFit,
    number: int,
    parameter: CalibratedParameter,
    others: Sequence[tuple[float, float]],
    ends: tuple[float, float],
) -> Identifiability:
    low, high = parameter.intervals[0].lower, parameter.intervals[-1].upper
    wide = [*ends, *(value for value, _ in others)]
    conflict = parameter.conflict
    prior = np.inf if conflict is None else float(found.problem.precision[number]) ** -0.5
    return verdict_of(
        high / low,
        span_with_others=max(wide) / min(wide),
        at_bound=bool(parameter.at_bound),
        is_open=parameter.is_open_below or parameter.is_open_above,
        log_error=parameter.log_error,
        prior_error=prior,
        contradicts=conflict is not None and conflict.contradicts,
        is_apart=len(parameter.intervals) > 1 or is_elsewhere(parameter, others),
    )


def _held(found: CalibrationFit, number: int, value: float) -> CalibratedParameter:
    """A parameter that was not fitted; NaN where the wire has no such thing."""
    name = PARAMETERS[number]
    acts = found.problem.parts.has[number]
    held = CalibratedParameter(
        name=name,
        unit=UNITS[name],
        value=value if acts else np.nan,
        intervals=(),
        log_error=0.0,
        freedom=np.inf,
        is_open_below=False,
        is_open_above=False,
        at_bound="",
        verdict=Identifiability.FIXED,
        words="",
        source=found.settings.choices[name].source if name in found.settings.choices else "",
    )
    return replace(
        held, words=words_of(held) if acts else f"{NAMES[name]} does not act on this wire"
    )


def _has_prior(found: CalibrationFit, number: int) -> bool:
    return bool(found.problem.precision[number] > 0.0)


def _bound(found: CalibrationFit, number: int) -> str:
    """The bound that the search ran into; none where it only ran out on a plain."""
    min_bound_slope = 0.05  # of half the objective: a flatter one does not press on the bound
    at, problem = found.fit.point.logs[number], found.problem
    pull = float(pull_of(problem, found.levels, found.fit)[number])
    if at <= problem.lower[number] and pull < -min_bound_slope:
        return "lower"
    return "upper" if at >= problem.upper[number] and pull > min_bound_slope else ""


def _profile(traced: Trace) -> Profile:
    return Profile(
        np.exp(traced.logs), traced.deviance, traced.threshold_below, traced.threshold_above
    )


def _conflict(found: CalibrationFit, number: int) -> PriorConflict:
    """Fit again without one prior: what the objective loses is the square of the conflict."""
    name = PARAMETERS[number]
    precision = found.problem.precision.copy()
    precision[number] = 0.0
    alone = replace(found.problem, precision=precision)
    fits = [search(alone, found.levels, valley.fit.point, found.free) for valley in found.valleys]
    fit = min(fits, key=lambda fit: fit.objective)
    spread = uncertainty(
        alone, fit, found.free, found.levels, is_scatter_known=found.is_scatter_known
    )
    own, prior = float(spread.covariance[number, number]), 1.0 / found.problem.precision[number]
    freedom = spread.freedom(np.eye(P + 1)[number]) * ((own + prior) / own) ** 2
    numbers = PriorConflict(
        centre=float(np.exp(found.problem.centre[number])),
        factor=float(found.settings.choices[name].factor or np.nan),
        alone=float(np.exp(fit.point.logs[number])),
        size=float(np.sqrt(max(found.fit.objective - fit.objective, 0.0))),
        freedom=float(freedom),
        contradicts=False,
        message="",
        source=found.settings.choices[name].source,
    )
    return weigh_prior(name, numbers)


def _correlations(covariance: Floats, free: Flags) -> Floats:
    errors = np.sqrt(np.diag(covariance))
    out = np.full((P, P), np.nan)
    both = np.ix_(free, free)
    out[both] = covariance[both] / np.outer(errors[free], errors[free])
    return out


def _agreements(found: CalibrationFit) -> Iterator[CurveAgreement]:
    point = found.fit.point
    for curve, model, sample in zip(
        found.problem.curves, found.fit.models, found.problem.sample, strict=True
    ):
        yield agreement(curve, model.force, float(np.exp(point.gain + point.offsets[sample])))


def _noise_levels(found: CalibrationFit) -> NoiseLevels:
    spread, levels = found.spread.level_covariance, found.levels
    scatter_freedom = np.inf if found.is_scatter_known else 0.0
    if spread[1, 1] > 0.0:
        scatter_freedom = 2.0 / float(spread[1, 1])
    return NoiseLevels(
        noise_factor=float(np.sqrt(levels.noise)),
        correlation=levels.correlation,
        scatter=levels.scatter,
        gain=found.problem.gain,
        scatter_freedom=scatter_freedom,
        noise_freedom=2.0 / float(spread[0, 0]),
    )


def _separability(found: CalibrationFit) -> Separability:
    """Of the parameters that act on the wire, by noise alone, as if samples did not scatter."""
    acting = [number for number in range(P) if found.problem.parts.has[number]]
    columns = []
    for curve, model in zip(found.problem.curves, found.fit.models, strict=True):
        scaled = model.change[acting].T / np.asarray(curve.noise)[:, None]
        columns.append(whiten(scaled, found.levels.correlation))
    jacobian = np.concatenate(columns) / np.sqrt(found.levels.noise)
    return separability(
        tuple(PARAMETERS[number] for number in acting), jacobian, "the parameters that act"
    )


def _friction_separability(found: CalibrationFit) -> Separability | None:
    """Of mu_s, mu_p and F_rad."""
    if not found.problem.parts.has[0]:
        return None
    jacobian = friction_jacobian(
        found.wire.section,
        found.wire.contacts,
        np.exp(found.fit.point.logs),
        found.problem.curves,
        orientation=found.wire.orientation,
        correlation=found.levels.correlation,
    )
    jacobian /= np.sqrt(found.levels.noise)
    return separability(FRICTION_NAMES, jacobian, "mu_s, mu_p and F_rad")


def _notes(
    found: CalibrationFit,
    parameters: tuple[CalibratedParameter, ...],
    solutions: tuple[Solution, ...],
    compared: tuple[CurveAgreement, ...],
) -> Iterator[QualityNote]:
    for parameter in parameters:
        yield from _parameter_notes(parameter)
    if len(solutions) > 1:
        where = found.problem.curves[0].wire
        message = two_solutions(solutions)
        yield QualityNote("two_solutions", Severity.WARNING, where, message)
    yield from _level_notes(found, compared)


def _level_notes(
    found: CalibrationFit, compared: tuple[CurveAgreement, ...]
) -> Iterator[QualityNote]:
    noise_ratio_range = (0.8, 1.25)  # estimated noise over stated noise
    max_correlation = 0.3  # of neighbouring residuals, without a note
    levels, where = found.levels, found.problem.curves[0].wire
    if found.problem.n_samples == 1 and not found.is_scatter_known:
        message = (
            "one sample: how samples scatter is not known, so the intervals speak of this sample, "
            "not of the wire"
        )
        yield QualityNote("one_sample", Severity.WARNING, where, message)
    factor = float(np.sqrt(levels.noise))
    if not noise_ratio_range[0] <= factor <= noise_ratio_range[1]:
        message = (
            f"the residuals scatter {factor:.3g} times as much as the stated noise; the intervals "
            f"go by the residuals"
        )
        yield QualityNote("noise_misstated", Severity.WARNING, where, message)
    if levels.correlation > max_correlation:
        worst = max(compared, key=lambda curve: curve.lag_one_correlation)
        message = (
            f"neighbouring residuals are alike (correlation {levels.correlation:.2f}, most in "
            f"{worst.test} with {worst.lag_one_correlation:.2f}): slow noise, or a model without "
            f"the shape of the curves; the intervals count correlated points for less"
        )
        yield QualityNote("residuals_correlated", Severity.WARNING, where, message)
    if not found.fit.settled:
        message = f"the search did not come to rest within {found.fit.steps} steps"
        yield QualityNote("search_unsettled", Severity.WARNING, where, message)


def _parameter_notes(parameter: CalibratedParameter) -> Iterator[QualityNote]:
    if parameter.at_bound:
        yield QualityNote("at_bound", Severity.WARNING, parameter.name, parameter.words)
    if parameter.verdict is Identifiability.NOT:
        yield QualityNote("not_identified", Severity.WARNING, parameter.name, parameter.words)
    if parameter.conflict is not None and parameter.conflict.contradicts:
        yield QualityNote(
            "prior_contradicts_data", Severity.WARNING, parameter.name, parameter.conflict.message
        )
