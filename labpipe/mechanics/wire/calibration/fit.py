"""The fit of a calibration: problem, solutions, identifiability and its description."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from labpipe.mechanics.law.plays import require, require_positive
from labpipe.mechanics.wire.calibration.law_components import WireParts, split_wire
from labpipe.mechanics.wire.calibration.local_minima import (
    Line,
    LocalMinimum,
    estimate_local_minimum,
    find_minima,
)
from labpipe.mechanics.wire.calibration.measured_curves import MeasuredCurve, select_usable, whiten
from labpipe.mechanics.wire.calibration.objective import (
    Fit,
    Levels,
    Problem,
    compute_model_forces,
)
from labpipe.mechanics.wire.calibration.variances import Uncertainty, compute_quantile
from labpipe.mechanics.wire.cross_section import CrossSection
from labpipe.mechanics.wire.friction import Contacts
from labpipe.records.arrays import Flags, Floats
from labpipe.records.wire_calibration import (
    COPPER_SCALE,
    DISPLAYED,
    INSULATION_MODULUS,
    PARAMETERS,
    RADIAL_FRICTION,
    CalibratedParameter,
    CalibrationFailure,
    Identifiability,
    ParameterChoice,
    PriorConflict,
    ScatterMixture,
    Separability,
    Solution,
)


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
    def parts(self) -> WireParts:
        """Tabulate the parts of the wire."""
        return split_wire(self.section, self.contacts, orientation=self.orientation)


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


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationFit:
    """The fit of a calibration.

    Parameters
    ----------
    wire, settings : input
    problem, free : what was fitted
    levels : of noise and samples
    local_minima : local minima of the objective, the lowest first
    line : on which they lie
    widening : of quantiles, for the nonlinear family of curves (`local_minima`)
    """

    wire: Wire
    settings: Settings
    problem: Problem
    free: Flags
    levels: Levels
    local_minima: tuple[LocalMinimum, ...]
    line: Line
    widening: float = 1.0

    @property
    def fit(self) -> Fit:
        """Return the fit at the minimum of the objective."""
        return self.local_minima[0].fit

    @property
    def spread(self) -> Uncertainty:
        """Return the covariance at the minimum, with its degrees of freedom."""
        return self.local_minima[0].spread

    @property
    def mixture(self) -> ScatterMixture:
        """Return the covariance at the minimum for each possible scatter."""
        return self.local_minima[0].mixture

    @property
    def is_scatter_known(self) -> bool:
        """Return whether the scatter of the samples is given."""
        return self.settings.scatter is not None


def fit_wire(
    wire: Wire, curves: Sequence[MeasuredCurve], settings: Settings
) -> CalibrationFit | CalibrationFailure:
    """Fit a wire to its tests.

    Parameters
    ----------
    wire, settings : input
    curves : first loadings

    Raises
    ------
    ValueError
        If a choice has an unknown name, or a number is out of its range.
    """
    usable_curves = select_usable(tuple(curves))
    if isinstance(usable_curves, CalibrationFailure):
        return usable_curves
    setup = set_up_problem(wire.parts, usable_curves, settings.choices, settings.gain)
    if isinstance(setup, CalibrationFailure):
        return setup
    problem, logs, free = setup
    try:
        minima = find_minima(problem, logs, free, scatter=settings.scatter)
    except ValueError as error:
        return CalibrationFailure.of("mechanics.wire.model_cannot_follow", error=error)
    fits, levels = minima.fits, minima.levels
    local_minima = tuple(
        estimate_local_minimum(problem, levels, fit, free, lowest=fits[0], scatter=settings.scatter)
        for fit in fits
    )
    return CalibrationFit(
        wire, settings, problem, free, levels, local_minima, minima.line, widening=minima.widening
    )


BOUNDS: Mapping[str, tuple[float, float]] = {
    RADIAL_FRICTION: (1e-5, 1e2),
    INSULATION_MODULUS: (1e5, 1e11),
    COPPER_SCALE: (0.05, 20.0),
}
"""Default bounds of the search: N, Pa, 1."""
_DEFAULT_STARTS: Mapping[str, float] = {
    RADIAL_FRICTION: 0.05,
    INSULATION_MODULUS: 1e9,
    COPPER_SCALE: 1.0,
}
"""Starts where the wire has no value, or zero."""


def set_up_problem(
    parts: WireParts,
    curves: tuple[MeasuredCurve, ...],
    choices: Mapping[str, ParameterChoice],
    gain: float,
) -> tuple[Problem, Floats, Flags] | CalibrationFailure:
    """Set up the problem of a calibration.

    Parameters
    ----------
    parts : the wire
    curves : usable ones
    choices : by name; a parameter that is not named is free if it acts on the wire
    gain : standard uncertainty of the load cell's gain, relative

    Returns
    -------
    The problem, the logarithms to start from and which parameters are free; or a failure
    ``parameter_without_effect``, ``value_out_of_bounds`` or ``too_few_points``.

    Raises
    ------
    ValueError
        If a choice has an unknown name or a number out of its range.
    """
    _check_choices(choices, gain)
    logs, centre, precision, lower, upper = np.zeros((5, len(PARAMETERS)))
    free = np.zeros(len(PARAMETERS), dtype=np.bool_)
    for number, name in enumerate(PARAMETERS):
        acts, choice = parts.has[number], choices.get(name, ParameterChoice())
        if not acts and name in choices and not choice.is_fixed:
            return CalibrationFailure.of("mechanics.wire.parameter_without_effect", name=name)
        if not acts:
            continue
        nominal = float(parts.given[number])
        value = choice.value or (nominal if nominal > 0.0 else _DEFAULT_STARTS[name])
        low, high = choice.lower or BOUNDS[name][0], choice.upper or BOUNDS[name][1]
        if choice.is_fixed:
            low = high = value
        elif not low <= value <= high or low == high:
            start, bounds = format_value(name, value), format_value(name, low, high)
            return CalibrationFailure.of(
                "mechanics.wire.value_out_of_bounds", name=name, value=start, bounds=bounds
            )
        free[number] = not choice.is_fixed
        logs[number], lower[number], upper[number] = np.log([value, low, high])
        if choice.factor is not None and not choice.is_fixed:
            centre[number] = logs[number]
            precision[number] = (compute_quantile(np.inf) / np.log(choice.factor)) ** 2
    names = list(dict.fromkeys(curve.sample for curve in curves))
    samples = np.array([names.index(curve.sample) for curve in curves], dtype=np.int64)
    problem = Problem(parts, curves, samples, centre, precision, lower, upper, gain)
    needed = int(free.sum()) + problem.n_samples + 1
    if problem.n_points < needed:
        return CalibrationFailure.of(
            "mechanics.wire.too_few_points",
            points=problem.n_points,
            parameters=int(free.sum()),
            samples=problem.n_samples,
            needed=needed,
        )
    return problem, logs, free


def _check_choices(choices: Mapping[str, ParameterChoice], gain: float) -> None:
    unknown = sorted(set(choices) - set(PARAMETERS))
    if unknown:
        message = f"{unknown[0]!r}: expected one of {', '.join(PARAMETERS)}"
        raise ValueError(message)
    require("gain", gain, ">= 0 and < 1", holds=0.0 <= gain < 1.0)
    for name, choice in choices.items():
        for bound_name in ("value", "lower", "upper"):
            number = getattr(choice, bound_name)
            require_positive(f"{name}: {bound_name}", 1.0 if number is None else number)
        factor = 2.0 if choice.factor is None else choice.factor
        require(f"{name}: factor", factor, "finite and > 1", holds=1.0 < factor < np.inf)


NAMES: Mapping[str, str] = {
    RADIAL_FRICTION: "phi = F_rad (mu_s + mu_p)",
    INSULATION_MODULUS: "the modulus of the insulation",
    COPPER_SCALE: "the strength of the copper",
}
FRICTION_NAMES = ("strand_friction", "insulation_friction", "radial_force")
"""mu_s, mu_p, F_rad."""
_LABELS: Mapping[str, str] = {
    **NAMES,
    **dict(zip(FRICTION_NAMES, ("mu_s", "mu_p", "F_rad"), strict=True)),
}

WELL = 2.0
"""Span of an interval, upper over lower, below which a parameter is well identified."""


def find_verdict(
    span: float,
    *,
    at_bound: bool,
    is_open: bool,
    log_error: float,
    prior_error: float,
    contradicts: bool = False,
    is_split: bool = False,
    span_with_others: float = 1.0,
) -> Identifiability:
    """Return the verdict on an interval.

    Parameters
    ----------
    span : upper end over lower end
    at_bound : whether the search ended at a bound
    is_open : on any side
    log_error : standard error of the logarithm
    prior_error : that of its prior; infinite without one
    contradicts : whether prior and tests contradict each other
    is_split : whether it has several parts, or another solution lies outside of it
    span_with_others : span that includes solutions just outside of the 95 % set, and the line on
        which insulation and copper trade off
    """
    # Span of an interval, upper over lower, above which a parameter is not identified.
    max_span = 100.0
    prior_share = 0.9  # error over that of the prior
    if at_bound:
        return Identifiability.AT_BOUND
    if contradicts:
        return Identifiability.AGAINST_PRIOR
    if log_error > prior_share * prior_error:
        return Identifiability.BY_PRIOR
    if is_open or span > max_span:
        return Identifiability.NOT
    if max(span, span_with_others) < WELL:
        return Identifiability.WELL
    return Identifiability.TWO if is_split else Identifiability.WEAKLY


def format_value(name: str, *values: float) -> str:
    """Format values of a parameter with four digits, without exponents, and the unit.

    Parameters
    ----------
    name : one of `PARAMETERS`
    values : SI

    Examples
    --------
    >>> format_value("insulation_modulus", 9.341e8, 1.0318e9)
    '934.1 and 1032 MPa'
    """
    factor, unit = DISPLAYED[name]
    rounded = (float(f"{factor * value:.4g}") for value in values)
    written = " and ".join(np.format_float_positional(value, trim="-") for value in rounded)
    return f"{written} {unit}".rstrip()


def has_other_value(parameter: CalibratedParameter, others: Sequence[tuple[float, float]]) -> bool:
    """Return whether another solution lies outside of all intervals."""
    return any(
        not any(part.lower <= value <= part.upper for part in parameter.intervals)
        for value, _ in others
    )


def describe_parameter(
    parameter: CalibratedParameter,
    others: Sequence[tuple[float, float]] = (),
    ends: tuple[float, float] | None = None,
) -> str:
    """Describe what is known of a parameter in a sentence.

    Parameters
    ----------
    parameter : without explanation
    others : value and likelihood, over that of the best, of solutions just outside of the 95 % set
    ends : of what the tests allow at 99 %
    """
    key, interval = parameter.name, parameter.interval
    name, value = NAMES[key], format_value(key, parameter.value)
    if interval is None:
        return f"{name} was held at {value}{_source_text(parameter.source)}"
    low, high = (format_value(key, value) for value in (interval.lower, interval.upper))
    if parameter.at_bound:
        side, other = ("below", high) if parameter.at_bound == "lower" else ("above", low)
        return (
            f"{name} is doubtful: it ended at the {parameter.at_bound} bound of its search, "
            f"{value}; the tests suggest a value {side} it, or do not determine it; inside the "
            f"bounds it extends to {other} (95 %)"
        )
    place = _range_text(parameter)
    if parameter.verdict is Identifiability.AGAINST_PRIOR:
        return (
            f"{name} is doubtful because prior and tests contradict each other: it {place} (95 %)"
        )
    verdict = (
        "has two solutions" if parameter.verdict is Identifiability.TWO else parameter.verdict.value
    )
    statement = verdict if parameter.verdict is Identifiability.TWO else f"is {verdict}"
    ending = f"{_other_values(parameter, others)}{_text_at_99(parameter, ends)}"
    return f"{name} {statement}: it {place} (95 %){ending}"


def _text_at_99(parameter: CalibratedParameter, ends: tuple[float, float] | None) -> str:
    """State what the tests allow at 99 %, if that makes a short interval weakly identified."""
    low, high = parameter.intervals[0].lower, parameter.intervals[-1].upper
    if ends is None or parameter.verdict is not Identifiability.WEAKLY or high >= WELL * low:
        return ""
    return f", and at 99 % between {format_value(parameter.name, *ends)}"


def _other_values(parameter: CalibratedParameter, others: Sequence[tuple[float, float]]) -> str:
    """State the values of other solutions, if these make the verdict `TWO`."""
    if parameter.verdict is not Identifiability.TWO or not has_other_value(parameter, others):
        return ""
    solution_texts = (
        f"near {format_value(parameter.name, value)}, by a solution {chance:.2g} times as likely"
        for value, chance in others
    )
    return f", or {', or '.join(solution_texts)}"


def _source_text(source: str) -> str:
    return f" ({source.strip().rstrip('.')})" if source.strip() else ""


def _range_text(parameter: CalibratedParameter) -> str:
    """State the parts of a parameter's interval."""
    key, parts = parameter.name, parameter.intervals
    is_open = parameter.is_open_below, parameter.is_open_above
    if all(is_open) and len(parts) == 1:
        ends = format_value(key, parts[0].lower, parts[0].upper)
        return f"may lie anywhere between the bounds, {ends}"
    ranges = [f"between {format_value(key, part.lower, part.upper)}" for part in parts]
    if is_open[0]:
        ranges[0] = f"below {format_value(key, parts[0].upper)}"
    if is_open[1]:
        ranges[-1] = f"above {format_value(key, parts[-1].lower)}"
    sides = [side for side, here in zip(("below", "above"), is_open, strict=True) if here]
    ending = f"; the tests do not bound it from {' or from '.join(sides)}" if sides else ""
    return f"lies {' or '.join(ranges)}{ending}"


def describe_solutions(solutions: Sequence[Solution]) -> str:
    """Describe the solutions that fit the tests, with their values.

    Parameters
    ----------
    solutions : two or more, the best first
    """
    solution_texts = []
    for number, solution in enumerate(solutions):
        acting = zip(PARAMETERS, solution.values.tolist(), strict=True)
        values = (f"{NAMES[name]} {format_value(name, v)}" for name, v in acting if v > 0.0)
        chance = f", {solution.likelihood:.2g} times as likely as (1)" if number else ""
        outside = "" if solution.is_allowed else ", outside of the 95 % set"
        rmse = f"{1e3 * solution.rmse:.3g} mN"
        solution_texts.append(f"({number + 1}) {', '.join(values)}: RMSE {rmse}{chance}{outside}")
    count = "two" if len(solutions) == 2 else str(len(solutions))
    return (
        f"{count} solutions fit the tests: {'; '.join(solution_texts)}. Values are of (1), "
        "intervals and bands of all in the 95 % set. A prior on the strength of the copper, or "
        "tests of another length, can distinguish them"
    )


def find_separability(names: tuple[str, ...], jacobian: Floats, what: str) -> Separability:
    """Return the singular values of whitened derivatives by logarithms, and the known parameters.

    Parameters
    ----------
    names : of the columns
    jacobian : shape (points, n), over the noise
    what : name of the parameters, for the text
    """
    min_singular_value = 1.0  # below it, a combination is unknown by a factor of e
    max_unknown_weight = 0.05  # squared weight of a parameter in the unknown directions
    _, values, rows = np.linalg.svd(jacobian, full_matrices=False)
    is_unknown = values < min_singular_value
    weights = np.sum(rows[is_unknown] ** 2, axis=0)
    is_known = {
        name: bool(weight < max_unknown_weight) for name, weight in zip(names, weights, strict=True)
    }
    values_text = ", ".join(
        f"{value:.0f}" if value >= 100.0 else f"{value:.2g}" for value in values
    )
    ending = (
        f"singular values of {what}: {values_text}; below 1, a combination is unknown by a "
        f"factor of e"
    )
    unknown = [_LABELS.get(name, name) for name in names if not is_known[name]]
    n_known = len(names) - int(is_unknown.sum())
    share = (
        f"{n_known} of {len(names)} combinations {'is' if n_known == 1 else 'are'} known ({ending})"
    )
    if not unknown:
        text = f"{what} can be distinguished: {share}"
    elif len(unknown) == 1:
        text = f"{unknown[0]} is not identified: {share}"
    else:
        together = f"{', '.join(unknown[:-1])} and {unknown[-1]}"
        text = f"{together} are not identified, they cannot be distinguished: {share}"
    return Separability(names, values, rows, is_known, text)


def compute_friction_jacobian(
    section: CrossSection,
    contacts: Contacts,
    values: Floats,
    curves: tuple[MeasuredCurve, ...],
    *,
    orientation: float,
    correlation: float,
) -> Floats:
    """Return whitened derivatives of all forces by the logarithms of mu_s, mu_p and F_rad.

    Parameters
    ----------
    section, contacts, orientation : the wire; the coefficients are those of `contacts`, the radial
        force is that of phi
    values : shape (3,), of the parameters
    curves : measured, for their deflections and noise
    correlation : of neighbouring points

    Returns
    -------
    Shape (points, 3), by central differences.
    """
    difference_step = 1e-3
    total = contacts.inner[-1] + contacts.outer[-1]
    force = values[0] / total
    columns = []
    for number, part in enumerate((contacts.inner[-1], contacts.outer[-1], total)):
        # Equal changes of phi: forces have corners where strands begin to slip, and columns
        # of numbers that act through phi alone stay proportional only if they cross the same ones.
        step = difference_step * total / max(part, 2.0 * difference_step * total)
        forces = []
        for sign in (1.0, -1.0):
            factors = np.ones(3)
            factors[number] += sign * step
            changed = _scale_friction(contacts, factors[0], factors[1])
            parts = split_wire(section, changed, orientation=orientation)
            phi = force * factors[2] * (changed.inner[-1] + changed.outer[-1])
            forces.append(_whitened(parts, np.array([phi, *values[1:]]), curves, correlation))
        columns.append((forces[0] - forces[1]) / (2.0 * step))
    return np.column_stack(columns)


def _scale_friction(contacts: Contacts, strand: float, insulation: float) -> Contacts:
    """Scale the friction between strands and with the insulation."""
    inner = tuple(strand * value for value in contacts.inner)
    outer = (*(strand * value for value in contacts.outer[:-1]), insulation * contacts.outer[-1])
    return replace(contacts, inner=inner, outer=outer, radial_force=1.0)


def _whitened(
    parts: WireParts, values: Floats, curves: tuple[MeasuredCurve, ...], correlation: float
) -> Floats:
    models = compute_model_forces(parts, values, curves)
    pieces = [
        whiten(model.force / np.asarray(curve.noise), correlation)
        for model, curve in zip(models, curves, strict=True)
    ]
    return np.concatenate(pieces)


def weigh_prior(name: str, conflict: PriorConflict) -> PriorConflict:
    """Compare a prior with what the tests alone determine.

    Parameters
    ----------
    name : of the parameter
    conflict : the numbers; `contradicts` and `message` are filled in
    """
    limit = compute_quantile(conflict.freedom)
    contradicts = conflict.size > limit
    relation = "contradicts" if contradicts else "agrees with"
    side = "above" if conflict.alone > conflict.centre else "below"
    effect = " (the other values are affected, too)" if contradicts else ""
    message = (
        f"the prior of {NAMES[name]}, {format_value(name, conflict.centre)} within a factor of "
        f"{conflict.factor:.4g}{_source_text(conflict.source)}, {relation} the "
        f"tests, which alone give {format_value(name, conflict.alone)}: {conflict.size:.2f} "
        f"combined standard errors {side} the prior; the limit at 95 % is {limit:.2f}{effect}"
    )
    return replace(conflict, contradicts=contradicts, message=message)
