"""What the tests can tell apart, in singular values and in words."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.records.calibration import (
    COPPER_SCALE,
    DISPLAYED,
    INSULATION_MODULUS,
    RADIAL_FRICTION,
    CalibratedParameter,
    Identified,
    PriorConflict,
    Separability,
)
from labpipe.wire.calibrating.data import MeasuredCurve, whiten
from labpipe.wire.calibrating.model import model_forces
from labpipe.wire.calibrating.parts import WireParts, take_apart
from labpipe.wire.calibrating.variances import quantile
from labpipe.wire.cross_section import CrossSection
from labpipe.wire.friction import Contacts

NAMES: Mapping[str, str] = {
    RADIAL_FRICTION: "phi = F_rad (mu_s + mu_p)",
    INSULATION_MODULUS: "the modulus of the insulation",
    COPPER_SCALE: "the strength of the copper",
}
FRICTION_NAMES = ("strand_friction", "insulation_friction", "radial_force")
"""mu_s, mu_p, F_rad."""
_CALLED: Mapping[str, str] = {
    **NAMES,
    **dict(zip(FRICTION_NAMES, ("mu_s", "mu_p", "F_rad"), strict=True)),
}

WELL, HOPELESS = 2.0, 100.0
"""Spans of an interval, upper over lower: well identified below, not identified above."""
_MOSTLY_PRIOR = 0.9  # error over that of the prior
_LEAST = 1.0  # singular value: below, a combination is not known to within a factor of e
_IN_IT = 0.05  # squared weight of a number in what is not known that makes it unknown
_STEP = 1e-3


def verdict_of(
    span: float,
    *,
    at_bound: bool,
    is_open: bool,
    log_error: float,
    prior_error: float,
    contradicts: bool = False,
) -> Identified:
    """Judge an interval.

    Parameters
    ----------
    span : upper end over lower end
    at_bound : whether the search ended at a bound
    is_open : on any side
    log_error : standard error of the logarithm
    prior_error : that of its prior; infinite without one
    contradicts : whether prior and tests contradict each other
    """
    if at_bound:
        return Identified.AT_BOUND
    if contradicts:
        return Identified.AGAINST_PRIOR
    if log_error > _MOSTLY_PRIOR * prior_error:
        return Identified.BY_PRIOR
    if is_open or span > HOPELESS:
        return Identified.NOT
    return Identified.WELL if span < WELL else Identified.WEAKLY


def in_display_unit(name: str, *values: float) -> str:
    """Write values of a parameter with four digits, without powers of ten, the unit at the end.

    Parameters
    ----------
    name : one of `PARAMETERS`
    values : SI

    Examples
    --------
    >>> in_display_unit("insulation_modulus", 9.341e8, 1.0318e9)
    '934.1 and 1032 MPa'
    """
    factor, unit = DISPLAYED[name]
    rounded = (float(f"{factor * value:.4g}") for value in values)
    written = " and ".join(np.format_float_positional(value, trim="-") for value in rounded)
    return f"{written} {unit}".rstrip()


def words_of(parameter: CalibratedParameter) -> str:
    """Say what is known of a parameter in a sentence."""
    key, interval = parameter.name, parameter.interval
    name, value = NAMES[key], in_display_unit(key, parameter.value)
    if interval is None:
        return f"{name} was held at {value}"
    low, high, ends = (
        in_display_unit(key, *values)
        for values in ((interval.lower,), (interval.upper,), (interval.lower, interval.upper))
    )
    if parameter.at_bound:
        side, other = ("below", high) if parameter.at_bound == "lower" else ("above", low)
        return (
            f"{name} is doubtful: it ended at the {parameter.at_bound} bound of its search, "
            f"{value}; the tests ask for a value {side} it, or do not determine it; inside the "
            f"bounds it reaches to {other} (95 %)"
        )
    sides = {
        (False, False): f"lies between {ends}",
        (True, False): f"lies below {high}; the tests do not bound it from below",
        (False, True): f"lies above {low}; the tests do not bound it from above",
        (True, True): f"may lie anywhere between the bounds, {ends}",
    }
    place = sides[parameter.is_open_below, parameter.is_open_above]
    if parameter.verdict is Identified.AGAINST_PRIOR:
        return f"{name} is doubtful, for prior and tests contradict each other: it {place} (95 %)"
    return f"{name} is {parameter.verdict.value}: it {place} (95 %)"


def separability(names: tuple[str, ...], jacobian: Floats, what: str) -> Separability:
    """Singular values of whitened derivatives by logarithms, and what they say.

    Parameters
    ----------
    names : of the columns
    jacobian : shape (points, n), over the noise
    what : of the numbers, for the words
    """
    _, values, rows = np.linalg.svd(jacobian, full_matrices=False)
    lost = values < _LEAST
    weights = np.sum(rows[lost] ** 2, axis=0)
    known = {name: bool(weight < _IN_IT) for name, weight in zip(names, weights, strict=True)}
    listed = ", ".join(f"{value:.0f}" if value >= 100.0 else f"{value:.2g}" for value in values)
    ending = f"singular values of {what}: {listed}; below 1 is unknown to within a factor of e"
    unknown = [_CALLED.get(name, name) for name in names if not known[name]]
    left = len(names) - int(lost.sum())
    share = f"{left} of {len(names)} combinations {'is' if left == 1 else 'are'} known ({ending})"
    if not unknown:
        words = f"{what} can be told apart: {share}"
    elif len(unknown) == 1:
        words = f"{unknown[0]} is not identified: {share}"
    else:
        together = f"{', '.join(unknown[:-1])} and {unknown[-1]}"
        words = f"{together} are not identified, they cannot be told apart: {share}"
    return Separability(names, values, rows, known, words)


def friction_jacobian(
    section: CrossSection,
    contacts: Contacts,
    values: Floats,
    curves: tuple[MeasuredCurve, ...],
    *,
    orientation: float,
    correlation: float,
) -> Floats:
    """Whitened derivatives of all forces by the logarithms of mu_s, mu_p and F_rad.

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
    total = contacts.inner[-1] + contacts.outer[-1]
    force = values[0] / total
    columns = []
    for number in range(3):
        forces = []
        for sign in (1.0, -1.0):
            grown = np.ones(3)
            grown[number] += sign * _STEP
            changed = _scaled(contacts, grown[0], grown[1])
            parts = take_apart(section, changed, orientation=orientation)
            phi = force * grown[2] * (changed.inner[-1] + changed.outer[-1])
            forces.append(_whitened(parts, np.array([phi, *values[1:]]), curves, correlation))
        columns.append((forces[0] - forces[1]) / (2.0 * _STEP))
    return np.column_stack(columns)


def _scaled(contacts: Contacts, strand: float, insulation: float) -> Contacts:
    """Contacts with friction between strands, and with the insulation, times factors."""
    inner = tuple(strand * value for value in contacts.inner)
    outer = (*(strand * value for value in contacts.outer[:-1]), insulation * contacts.outer[-1])
    return replace(contacts, inner=inner, outer=outer, radial_force=1.0)


def _whitened(
    parts: WireParts, values: Floats, curves: tuple[MeasuredCurve, ...], correlation: float
) -> Floats:
    models = model_forces(parts, values, curves)
    pieces = [
        whiten(model.force / np.asarray(curve.noise), correlation)
        for model, curve in zip(models, curves, strict=True)
    ]
    return np.concatenate(pieces)


def weigh_prior(name: str, conflict: PriorConflict) -> PriorConflict:
    """Say how far a prior lies from what the tests say by themselves.

    Parameters
    ----------
    name : of the parameter
    conflict : the numbers; whether they contradict and the message are filled in
    """
    limit = quantile(conflict.freedom)
    contradicts = conflict.size > limit
    relation = "contradicts" if contradicts else "agrees with"
    side = "above" if conflict.alone > conflict.centre else "below"
    others = "; the other values are drawn along with it" if contradicts else ""
    message = (
        f"the prior of {NAMES[name]}, {in_display_unit(name, conflict.centre)} within a factor of "
        f"{conflict.factor:.4g}, {relation} the tests, which by themselves say "
        f"{in_display_unit(name, conflict.alone)}: {conflict.size:.2f} standard errors of both "
        f"together {side} the prior, {limit:.2f} would be a contradiction at 95 %{others}"
    )
    return replace(conflict, contradicts=contradicts, message=message)
