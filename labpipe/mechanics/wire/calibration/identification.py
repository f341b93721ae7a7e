"""Judge which parameters a calibration identifies, and describe the verdicts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.special import stdtrit

from labpipe.records.arrays import Floats
from labpipe.records.curve import NORMAL_95
from labpipe.records.wire import (
    COPPER_SCALE,
    DISPLAYED,
    INSULATION_MODULUS,
    PARAMETERS,
    RADIAL_FRICTION,
    CalibratedParameter,
    Identifiability,
    PriorConflict,
    Separability,
    Solution,
)

NAMES: Mapping[str, str] = {
    RADIAL_FRICTION: "phi = F_rad (mu_s + mu_p)",
    INSULATION_MODULUS: "the modulus of the insulation",
    COPPER_SCALE: "the strength of the copper",
}

MAX_WELL_SPAN = 2.0
"""Span of an interval, upper over lower, below which a parameter is well identified."""


def find_verdict(
    parameter: CalibratedParameter,
    others: Sequence[tuple[float, float]] = (),
    ends: tuple[float, float] | None = None,
) -> Identifiability:
    """Return the verdict on a fitted parameter.

    Parameters
    ----------
    parameter, others, ends : as for `describe_parameter`
    """
    max_span = 100.0  # upper over lower end of an interval, above which it is not identified
    prior_share = 0.9  # error over that of the prior
    low, high = parameter.intervals[0].lower, parameter.intervals[-1].upper
    widest = [low, high, *(ends or ()), *(value for value, _ in others)]
    conflict = parameter.conflict
    if parameter.at_bound:
        return Identifiability.AT_BOUND
    if conflict is not None and conflict.contradicts:
        return Identifiability.AGAINST_PRIOR
    if conflict is not None:
        prior_error = np.log(conflict.factor) / NORMAL_95
        if parameter.log_error > prior_share * prior_error:
            return Identifiability.BY_PRIOR
    if parameter.is_open_below or parameter.is_open_above or high > max_span * low:
        return Identifiability.NOT
    if max(widest) < MAX_WELL_SPAN * min(widest):
        return Identifiability.WELL
    is_split = len(parameter.intervals) > 1 or _has_other_value(parameter, others)
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


def _has_other_value(parameter: CalibratedParameter, others: Sequence[tuple[float, float]]) -> bool:
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
    """Describe the result for a parameter in a sentence.

    Parameters
    ----------
    parameter : parameter without explanation
    others : other solutions just outside of the 95 % set: value, and likelihood over that of the
        best
    ends : ends of the interval at 99 %; None without
    """
    key, interval, verdict = parameter.name, parameter.interval, parameter.verdict
    name, value = NAMES[key], format_value(key, parameter.value)
    if interval is None:
        return f"{name} was held at {value}{_format_source(parameter.source)}"
    low, high = (format_value(key, value) for value in (interval.lower, interval.upper))
    if parameter.at_bound:
        is_lower = parameter.at_bound == "lower"
        return (
            f"{name} is doubtful: it ended at the {parameter.at_bound} bound of its search, "
            f"{value}; the tests suggest a value {'below' if is_lower else 'above'} it, or do not "
            f"determine it; inside the bounds it extends to {high if is_lower else low} (95 %)"
        )
    place = _describe_range(parameter)
    if verdict is Identifiability.AGAINST_PRIOR:
        return (
            f"{name} is doubtful because prior and tests contradict each other: it {place} (95 %)"
        )
    statement, ending = f"is {verdict.value}", ""
    if verdict is Identifiability.TWO:
        statement = "has two solutions"
        if _has_other_value(parameter, others):
            ending = "".join(
                f", or near {format_value(key, value)}, by a solution {chance:.2g} times as likely"
                for value, chance in others
            )
    is_short = interval.upper < MAX_WELL_SPAN * interval.lower
    if ends is not None and verdict is Identifiability.WEAKLY and is_short:
        ending = f", and at 99 % between {format_value(key, *ends)}"
    return f"{name} {statement}: it {place} (95 %){ending}"


def _format_source(source: str) -> str:
    return f" ({source.strip().rstrip('.')})" if source.strip() else ""


def _describe_range(parameter: CalibratedParameter) -> str:
    """State the parts of a parameter's interval."""
    key, parts = parameter.name, parameter.intervals
    is_open = {"below": parameter.is_open_below, "above": parameter.is_open_above}
    if all(is_open.values()) and len(parts) == 1:
        ends = format_value(key, parts[0].lower, parts[0].upper)
        return f"may lie anywhere between the bounds, {ends}"
    ranges = [f"between {format_value(key, part.lower, part.upper)}" for part in parts]
    if is_open["below"]:
        ranges[0] = f"below {format_value(key, parts[0].upper)}"
    if is_open["above"]:
        ranges[-1] = f"above {format_value(key, parts[-1].lower)}"
    sides = " or from ".join(side for side, opens in is_open.items() if opens)
    ending = f"; the tests do not bound it from {sides}" if sides else ""
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


def find_separability(names: tuple[str, ...], jacobian: Floats, subject: str) -> Separability:
    """Return the singular values of whitened derivatives by logarithms, and the known parameters.

    Parameters
    ----------
    names : names of the columns
    jacobian : shape (points, n), derivatives over the noise
    subject : name of the parameters, for the text
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
        f"singular values of {subject}: {values_text}; below 1, a combination is unknown by a "
        f"factor of e"
    )
    unknown = [NAMES.get(name, name) for name in names if not is_known[name]]
    n_known = len(names) - int(is_unknown.sum())
    share = (
        f"{n_known} of {len(names)} combinations {'is' if n_known == 1 else 'are'} known ({ending})"
    )
    if not unknown:
        text = f"{subject} can be distinguished: {share}"
    elif len(unknown) == 1:
        text = f"{unknown[0]} is not identified: {share}"
    else:
        together = f"{', '.join(unknown[:-1])} and {unknown[-1]}"
        text = f"{together} are not identified, they cannot be distinguished: {share}"
    return Separability(names, values, rows, is_known, text)


def compute_quantile(freedom: float) -> float:
    """Return the two-sided 95 % quantile of t, of at least one degree of freedom."""
    min_freedom = 1.0  # Satterthwaite's formula can give less for a few samples
    return float(stdtrit(min(max(freedom, min_freedom), 1e9), 0.975))


def weigh_prior(name: str, conflict: PriorConflict) -> PriorConflict:
    """Compare a prior with what the tests alone determine.

    Parameters
    ----------
    name : name of the parameter
    conflict : numbers of prior and tests; `contradicts` and `message` are filled in
    """
    limit = compute_quantile(conflict.freedom)
    contradicts = conflict.size > limit
    relation = "contradicts" if contradicts else "agrees with"
    side = "above" if conflict.alone > conflict.centre else "below"
    effect = " (the other values are affected, too)" if contradicts else ""
    message = (
        f"the prior of {NAMES[name]}, {format_value(name, conflict.centre)} within a factor of "
        f"{conflict.factor:.4g}{_format_source(conflict.source)}, {relation} the "
        f"tests, which alone give {format_value(name, conflict.alone)}: {conflict.size:.2f} "
        f"combined standard errors {side} the prior; the limit at 95 % is {limit:.2f}{effect}"
    )
    return replace(conflict, contradicts=contradicts, message=message)
