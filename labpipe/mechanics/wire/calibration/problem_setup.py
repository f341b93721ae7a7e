"""The problem of a calibration: what is fitted, from where, and within which bounds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from labpipe.mechanics.law.plays import require, require_positive
from labpipe.mechanics.wire.calibration.identification import format_value
from labpipe.mechanics.wire.calibration.law_components import WireParts, split_wire
from labpipe.mechanics.wire.calibration.measured_curves import MeasuredCurve
from labpipe.mechanics.wire.calibration.objective import Problem
from labpipe.mechanics.wire.calibration.variances import compute_quantile
from labpipe.mechanics.wire.cross_section import CrossSection
from labpipe.mechanics.wire.friction import Contacts
from labpipe.records.arrays import Floats
from labpipe.records.wire_calibration import (
    COPPER_SCALE,
    INSULATION_MODULUS,
    PARAMETERS,
    RADIAL_FRICTION,
    CalibrationFailure,
    ParameterChoice,
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
    parts: WireParts, curves: tuple[MeasuredCurve, ...], settings: Settings
) -> tuple[Problem, Floats] | CalibrationFailure:
    """Set up the problem of a calibration.

    Parameters
    ----------
    parts : of the wire
    curves : usable ones
    settings : of the calibration

    Returns
    -------
    The problem and the logarithms to start from; or a failure
    ``parameter_without_effect``, ``value_out_of_bounds`` or ``too_few_points``.

    Raises
    ------
    ValueError
        If a choice has an unknown name or a number out of its range.
    """
    choices = settings.choices
    _check_settings(settings)
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
    problem = Problem(
        *(parts, curves, samples, centre, precision, lower, upper, settings.gain),
        *(free, settings.scatter),
    )
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


def _check_settings(settings: Settings) -> None:
    unknown = sorted(set(settings.choices) - set(PARAMETERS))
    if unknown:
        message = f"{unknown[0]!r}: expected one of {', '.join(PARAMETERS)}"
        raise ValueError(message)
    require("gain", settings.gain, ">= 0 and < 1", holds=0.0 <= settings.gain < 1.0)
    for name, choice in settings.choices.items():
        for bound_name in ("value", "lower", "upper"):
            number = getattr(choice, bound_name)
            require_positive(f"{name}: {bound_name}", 1.0 if number is None else number)
        factor = 2.0 if choice.factor is None else choice.factor
        require(f"{name}: factor", factor, "finite and > 1", holds=1.0 < factor < np.inf)
