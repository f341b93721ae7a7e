"""From what was asked for to what is searched: starts, bounds, priors."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from labpipe.records.arrays import Flags, Floats, Ints
from labpipe.records.calibration import (
    COPPER_SCALE,
    INSULATION_MODULUS,
    PARAMETERS,
    RADIAL_FRICTION,
    CalibrationFailure,
    ParameterChoice,
)
from labpipe.wire.calibrating.data import MeasuredCurve
from labpipe.wire.calibrating.identify import in_display_unit
from labpipe.wire.calibrating.parts import WireParts
from labpipe.wire.calibrating.search import Problem
from labpipe.wire.calibrating.variances import quantile

BOUNDS: Mapping[str, tuple[float, float]] = {
    RADIAL_FRICTION: (1e-5, 1e2),
    INSULATION_MODULUS: (1e5, 1e11),
    COPPER_SCALE: (0.05, 20.0),
}
"""Of the search, where nothing else is said: N, Pa, 1."""
_STARTS: Mapping[str, float] = {RADIAL_FRICTION: 0.05, INSULATION_MODULUS: 1e9, COPPER_SCALE: 1.0}
"""Where the wire itself says nothing, or zero."""


def pose(
    parts: WireParts,
    curves: tuple[MeasuredCurve, ...],
    choices: Mapping[str, ParameterChoice],
    gain: float,
) -> tuple[Problem, Floats, Flags] | CalibrationFailure:
    """Make the problem of a calibration.

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
    _require_sound(choices, gain)
    logs, centre, precision, lower, upper = np.zeros((5, len(PARAMETERS)))
    free = np.zeros(len(PARAMETERS), dtype=np.bool_)
    for number, name in enumerate(PARAMETERS):
        acts, choice = parts.has[number], choices.get(name, ParameterChoice())
        if not acts and name in choices and not choice.is_fixed:
            return _without_effect(name)
        if not acts:
            continue
        value = _value(name, choice, float(parts.given[number]))
        low, high = choice.lower or BOUNDS[name][0], choice.upper or BOUNDS[name][1]
        if choice.is_fixed:
            low = high = value
        elif not low <= value <= high or low == high:
            return _out_of_bounds(name, value, low, high)
        free[number] = not choice.is_fixed
        logs[number], lower[number], upper[number] = np.log([value, low, high])
        if choice.factor is not None and not choice.is_fixed:
            centre[number] = logs[number]
            precision[number] = 1.0 / log_error_of(choice.factor) ** 2
    problem = Problem(parts, curves, _samples(curves), centre, precision, lower, upper, gain)
    needed = int(free.sum()) + problem.n_samples
    if problem.n_points <= needed:
        message = (
            f"{problem.n_points} points for {int(free.sum())} parameters and {problem.n_samples} "
            f"samples; at least {needed + 1} are needed: take more points, or hold a parameter"
        )
        return CalibrationFailure("too_few_points", message)
    return problem, logs, free


def log_error_of(factor: float) -> float:
    """Standard deviation, in logarithms, of a prior that is within a factor at 95 %."""
    return float(np.log(factor)) / quantile(np.inf)


def _require_sound(choices: Mapping[str, ParameterChoice], gain: float) -> None:
    unknown = sorted(set(choices) - set(PARAMETERS))
    if unknown:
        message = f"{unknown[0]!r}: allowed are {', '.join(PARAMETERS)}"
        raise ValueError(message)
    if not (np.isfinite(gain) and 0.0 <= gain < 1.0):
        message = f"gain={gain!r}: allowed are numbers from 0 to below 1"
        raise ValueError(message)
    for name, choice in choices.items():
        for what in ("value", "lower", "upper"):
            number = getattr(choice, what)
            if number is not None and not (np.isfinite(number) and number > 0.0):
                message = f"{name}: {what}={number!r}: allowed are finite numbers > 0"
                raise ValueError(message)
        if choice.factor is not None and not (np.isfinite(choice.factor) and choice.factor > 1.0):
            message = f"{name}: factor={choice.factor!r}: allowed are finite numbers > 1"
            raise ValueError(message)


def _value(name: str, choice: ParameterChoice, given: float) -> float:
    if choice.value is not None:
        return choice.value
    return given if given > 0.0 else _STARTS[name]


def _without_effect(name: str) -> CalibrationFailure:
    message = f"{name} does not act on this wire: there is nothing in the tests to fit it by"
    return CalibrationFailure("parameter_without_effect", message)


def _out_of_bounds(name: str, value: float, low: float, high: float) -> CalibrationFailure:
    message = (
        f"{name} starts at {in_display_unit(name, value)}, outside its bounds, "
        f"{in_display_unit(name, low, high)}: give a value between them"
    )
    return CalibrationFailure("value_out_of_bounds", message)


def _samples(curves: tuple[MeasuredCurve, ...]) -> Ints:
    names = list(dict.fromkeys(curve.sample for curve in curves))
    return np.array([names.index(curve.sample) for curve in curves], dtype=np.int64)
