"""Decide which parameters a calibration identifies, and describe the verdicts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TypeAlias

import numpy as np
from scipy.special import stdtrit

from labpipe.messages import format_sentence
from labpipe.records.arrays import Floats
from labpipe.records.curve import NORMAL_95
from labpipe.records.wire import (
    COPPER_SCALE,
    DISPLAY_UNITS,
    INSULATION_MODULUS,
    PARAMETERS,
    RADIAL_FRICTION,
    CalibratedParameter,
    Identifiability,
    PriorConflict,
    Separability,
    Solution,
)

PHRASES: Mapping[str, str] = {
    RADIAL_FRICTION: "phi = F_rad (mu_s + mu_p)",
    INSULATION_MODULUS: "the modulus of the insulation",
    COPPER_SCALE: "the strength of the copper",
}
"""Phrase for each parameter in a sentence, keyed by the names of `PARAMETERS`."""

Alternatives: TypeAlias = Sequence[tuple[float, float]]
"""Value of a parameter in each solution outside the 95 % set, and likelihood of that solution.

The likelihood is relative to that of the best solution.
"""

MAX_IDENTIFIED_RATIO = 2.0
"""Ratio of the ends of an interval below which a parameter is identified."""


def find_verdict(
    parameter: CalibratedParameter,
    alternatives: Alternatives = (),
    interval_99: tuple[float, float] | None = None,
) -> Identifiability:
    """Decide how well the tests identify a fitted parameter.

    Parameters
    ----------
    parameter, alternatives, interval_99 : fitted parameter, its values in other solutions, and its
        99 % interval, as for `describe_parameter`
    """
    min_open_ratio = 100.0  # ratio of the ends of an interval of a parameter that is not identified
    min_prior_ratio = 0.9  # error relative to that of the prior, above which the prior decides
    low, high = parameter.intervals[0].lower, parameter.intervals[-1].upper
    possible_values = [low, high, *(interval_99 or ()), *(value for value, _ in alternatives)]
    conflict = parameter.conflict
    if parameter.at_bound:
        return Identifiability.AT_BOUND
    if conflict is not None and conflict.contradicts:
        return Identifiability.AGAINST_PRIOR
    if conflict is not None:
        prior_error = np.log(conflict.factor) / NORMAL_95
        if parameter.log_error > min_prior_ratio * prior_error:
            return Identifiability.BY_PRIOR
    if parameter.is_open_below or parameter.is_open_above or high > min_open_ratio * low:
        return Identifiability.NOT_IDENTIFIED
    if max(possible_values) < MAX_IDENTIFIED_RATIO * min(possible_values):
        return Identifiability.IDENTIFIED
    is_split = len(parameter.intervals) > 1 or _has_distinct_alternative(parameter, alternatives)
    return Identifiability.TWO_SOLUTIONS if is_split else Identifiability.WEAKLY_IDENTIFIED


def format_value(name: str, *values: float) -> str:
    """Format values of a parameter with four digits, without exponents, and the unit.

    Parameters
    ----------
    name : one of `PARAMETERS`
    values : values in SI units

    Examples
    --------
    >>> format_value("insulation_modulus", 9.341e8, 1.0318e9)
    '934.1 and 1032 MPa'
    """
    factor, unit = DISPLAY_UNITS[name]
    rounded = (float(f"{factor * value:.4g}") for value in values)
    numbers = " and ".join(np.format_float_positional(value, trim="-") for value in rounded)
    return f"{numbers} {unit}".rstrip()


def _has_distinct_alternative(parameter: CalibratedParameter, alternatives: Alternatives) -> bool:
    """Return whether another solution has a value outside all intervals."""
    return any(
        not any(interval.lower <= value <= interval.upper for interval in parameter.intervals)
        for value, _ in alternatives
    )


def describe_parameter(
    parameter: CalibratedParameter,
    alternatives: Alternatives = (),
    interval_99: tuple[float, float] | None = None,
) -> str:
    """Describe the result for a parameter in a sentence.

    Parameters
    ----------
    parameter : parameter without an explanation
    alternatives : values of the parameter in other solutions
    interval_99 : ends of the 99 % interval; None without such an interval
    """
    key, interval, verdict = parameter.name, parameter.interval, parameter.verdict
    name, value = PHRASES[key], format_value(key, parameter.value)
    if interval is None:
        source = _format_source(parameter.source)
        return format_sentence("mechanics.wire.held", name=name, value=value, source=source)
    low, high = (format_value(key, value) for value in (interval.lower, interval.upper))
    if parameter.at_bound:
        side, end = ("below", high) if parameter.at_bound == "lower" else ("above", low)
        facts = {"name": name, "bound": parameter.at_bound, "value": value}
        return format_sentence("mechanics.wire.ends_at_bound", side=side, end=end, **facts)
    text = f"it {_describe_range(parameter)} (95 %)"
    if verdict is Identifiability.AGAINST_PRIOR:
        return f"{name} is doubtful because prior and tests contradict each other: {text}"
    statement, ending = f"is {verdict.value}", ""
    if verdict is Identifiability.TWO_SOLUTIONS:
        statement = "has two solutions"
        if _has_distinct_alternative(parameter, alternatives):
            ending = "".join(
                f", or near {format_value(key, value)}, by a solution {ratio:.2g} times as likely"
                for value, ratio in alternatives
            )
    is_short = interval.upper < MAX_IDENTIFIED_RATIO * interval.lower
    if interval_99 is not None and verdict is Identifiability.WEAKLY_IDENTIFIED and is_short:
        ending = f", and at 99 % between {format_value(key, *interval_99)}"
    return f"{name} {statement}: {text}{ending}"


def _format_source(source: str) -> str:
    """Format a source in parentheses; empty without a source."""
    return f" ({source.strip().rstrip('.')})" if source.strip() else ""


def _describe_range(parameter: CalibratedParameter) -> str:
    """Describe the intervals of a parameter."""
    key, intervals = parameter.name, parameter.intervals
    is_open = {"below": parameter.is_open_below, "above": parameter.is_open_above}
    if all(is_open.values()) and len(intervals) == 1:
        bounds = format_value(key, intervals[0].lower, intervals[0].upper)
        return f"may lie anywhere between the bounds, {bounds}"
    texts = [f"between {format_value(key, span.lower, span.upper)}" for span in intervals]
    if is_open["below"]:
        texts[0] = f"below {format_value(key, intervals[0].upper)}"
    if is_open["above"]:
        texts[-1] = f"above {format_value(key, intervals[-1].lower)}"
    open_sides = " or from ".join(side for side in is_open if is_open[side])
    ending = f"; the tests do not bound it from {open_sides}" if open_sides else ""
    return f"lies {' or '.join(texts)}{ending}"


def describe_solutions(solutions: Sequence[Solution]) -> str:
    """Describe the solutions that fit the tests, with their values.

    Parameters
    ----------
    solutions : two or more solutions, the best first
    """
    texts = []
    for index, solution in enumerate(solutions):
        pairs = zip(PARAMETERS, solution.values.tolist(), strict=True)
        values = (f"{PHRASES[name]} {format_value(name, v)}" for name, v in pairs if v > 0.0)
        likelihood = f", {solution.likelihood:.2g} times as likely as (1)" if index else ""
        outside = "" if solution.is_allowed else ", outside of the 95 % set"
        rmse = f"{1e3 * solution.rmse:.3g} mN"
        texts.append(f"({index + 1}) {', '.join(values)}: RMSE {rmse}{likelihood}{outside}")
    count = "two" if len(solutions) == 2 else str(len(solutions))
    return format_sentence("mechanics.wire.solutions", count=count, solutions="; ".join(texts))


def find_separability(names: tuple[str, ...], jacobian: Floats, subject: str) -> Separability:
    """Find the parameters that data determine, by singular values of a Jacobian matrix.

    Parameters
    ----------
    names : names of the n parameters
    jacobian : shape (points, n), derivatives with respect to the logarithms of the parameters,
        relative to the noise
    subject : name of the group of parameters in the text
    """
    min_singular_value = 1.0  # with a smaller value, a combination has an error of a factor of e
    max_unknown_weight = 0.05  # largest squared weight of a known parameter in unknown directions
    _, values, directions = np.linalg.svd(jacobian, full_matrices=False)
    # The sign of a singular vector is arbitrary, and differs between processors.
    directions *= np.sign(
        directions[np.arange(len(directions)), np.abs(directions).argmax(axis=1), None]
    )
    is_unknown = values < min_singular_value
    weights = np.sum(directions[is_unknown] ** 2, axis=0)
    is_known = {
        name: bool(weight < max_unknown_weight) for name, weight in zip(names, weights, strict=True)
    }
    value_texts = [f"{value:.0f}" if value >= 100.0 else f"{value:.2g}" for value in values]
    unknown_names = [PHRASES.get(name, name) for name in names if not is_known[name]]
    n_known = len(names) - int(is_unknown.sum())
    verdict = f"{subject} can be distinguished"
    if len(unknown_names) == 1:
        verdict = f"{unknown_names[0]} is not identified"
    elif unknown_names:
        group = f"{', '.join(unknown_names[:-1])} and {unknown_names[-1]}"
        verdict = f"{group} are not identified, they cannot be distinguished"
    text = format_sentence(
        "mechanics.wire.combinations",
        verdict=verdict,
        known=f"{n_known} of {len(names)} combinations {'is' if n_known == 1 else 'are'} known",
        subject=subject,
        values=", ".join(value_texts),
    )
    return Separability(names, values, directions, is_known, text)


def compute_t_quantile(freedom: float) -> float:
    """Compute the two-sided 95 % quantile of Student's t, for at least one degree of freedom."""
    min_freedom = 1.0  # Satterthwaite's formula can give less for a few samples
    return float(stdtrit(min(max(freedom, min_freedom), 1e9), 0.975))


def compare_with_prior(name: str, conflict: PriorConflict) -> PriorConflict:
    """Compare a prior with the value that the tests determine without the prior.

    Parameters
    ----------
    name : name of the parameter
    conflict : values of prior and tests, without verdict and message

    Returns
    -------
    The same values, with verdict and message.
    """
    limit = compute_t_quantile(conflict.freedom)
    contradicts = conflict.size > limit
    message = format_sentence(
        "mechanics.wire.prior_contradicts" if contradicts else "mechanics.wire.prior_agrees",
        name=PHRASES[name],
        centre=format_value(name, conflict.centre),
        factor=conflict.factor,
        source=_format_source(conflict.source),
        estimate=format_value(name, conflict.estimate),
        size=conflict.size,
        side="above" if conflict.estimate > conflict.centre else "below",
        limit=limit,
    )
    return replace(conflict, contradicts=contradicts, message=message)
