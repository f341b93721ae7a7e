"""All solutions of a calibration: every least of the objective that the tests allow.

A wire of hard copper with little insulation can look like one of soft copper with much of it, so
that the objective has two valleys, and at times more, between which noise decides. All of them lie
along one line: the copper's strength held, and all else fitted anew. It is followed from bound to
bound, and a search goes down from each of its dips.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from labpipe.records.arrays import Flags, Floats
from labpipe.records.wire_calibration import (
    COPPER_SCALE,
    INSULATION_MODULUS,
    PARAMETERS,
    ScatterMixture,
)
from labpipe.wire.calibration.law_components import model_forces
from labpipe.wire.calibration.nonlinearity import widening
from labpipe.wire.calibration.parameter_search import (
    Fit,
    Levels,
    Point,
    Problem,
    products,
    search,
)
from labpipe.wire.calibration.scatter_mixture import mix
from labpipe.wire.calibration.variances import (
    Uncertainty,
    correlation_of,
    estimate_levels,
    uncertainty,
)

_TUBE, _COPPER = PARAMETERS.index(INSULATION_MODULUS), PARAMETERS.index(COPPER_SCALE)
_STRIDE = 0.3
"""Between points of the line, in logarithms of the copper's strength."""
_SAME_PLACE_STRIDES = 0.1
"""Of a stride: what is closer is one place."""


@dataclass(frozen=True, slots=True, eq=False)
class LocalMinimum:
    """A least of the objective.

    Parameters
    ----------
    fit : there
    rise : of the objective over that of the lowest valley
    spread : covariance, and what degrees of freedom need
    mixture : covariance for each scatter that the tests allow
    """

    fit: Fit
    rise: float
    spread: Uncertainty
    mixture: ScatterMixture


@dataclass(frozen=True, slots=True, eq=False)
class Line:
    """The line that all leasts lie on, from bound to bound of the copper's strength.

    Parameters
    ----------
    place : shape (n, 4), logarithms of the parameters and of the gain
    rise : shape (n,), of the objective over its least
    """

    place: Floats
    rise: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Settled:
    """Parameters and levels that were fitted.

    Parameters
    ----------
    fits : every least of the objective, the lowest first
    levels : those of the lowest
    line : on which they lie
    widening : of intervals, since that line is bent (`bent_family`)
    """

    fits: list[Fit]
    levels: Levels
    line: Line
    widening: float


def settle(problem: Problem, logs: Floats, free: Flags, *, scatter: float | None) -> Settled:
    """Fit parameters and levels.

    Parameters
    ----------
    problem : what is fitted
    logs : shape (3,), where the search starts
    free : shape (3,)
    scatter : of the samples, in logarithms, where it is given

    Raises
    ------
    ValueError
        If the model cannot follow the curves at any start.
    """
    first_scatter = 0.05
    max_rise = 200.0  # of the objective: no quantile of so few samples is as large
    levels = Levels(1.0, 0.0, first_scatter if scatter is None else scatter)
    first = _first(problem, levels, _starts(problem, logs, free), free)
    fit, levels = refine(problem, first, levels, free, scatter=scatter)
    line = line_of(problem, levels, fit, free)
    valleys = find_local_minima(problem, levels, line, fit, free)
    lowest = min(valleys, key=lambda valley: valley.objective)
    others = [valley for valley in valleys if valley is not lowest]
    others = [other for other in others if other.objective - lowest.objective <= max_rise]
    least = lowest.objective
    if lowest is not fit:
        fit, levels = refine(problem, lowest, levels, free, scatter=scatter)
    low = fit.objective
    found = (_again(problem, levels, other, free, lowest=low) for other in others)
    fits = _different([fit, *(finding for finding in found if finding is not None)])
    fits = [fit for fit in fits if fit.objective - fits[0].objective <= max_rise]
    apart = [
        element
        for element in line
        if abs(_place(element) - _place(fits[0])) > _SAME_PLACE_STRIDES * _STRIDE
    ]
    line = sorted([*apart, fits[0]], key=_place)
    rises = [0.0 if element is fits[0] else max(element.objective - least, 0.0) for element in line]
    place = np.array([[*element.point.logs, element.point.gain] for element in line])
    wider = widening(problem, levels, line, fits[0])
    return Settled(fits, levels, Line(place, np.array(rises)), wider)


def _different(fits: list[Fit]) -> list[Fit]:
    """Each least once, the lowest first: with other levels two searches may end in one."""
    kept: list[Fit] = []
    for fit in sorted(fits, key=lambda fit: fit.objective):
        if all(abs(_place(fit) - _place(other)) > _SAME_PLACE_STRIDES * _STRIDE for other in kept):
            kept.append(fit)
    return kept


def _again(problem: Problem, levels: Levels, fit: Fit, free: Flags, *, lowest: float) -> Fit | None:
    """Go down from a fit, to a least."""
    try:
        return search(problem, levels, _within(fit.point, levels), free, lowest=lowest)
    except ValueError:
        return None


def refine(
    problem: Problem, fit: Fit, levels: Levels, free: Flags, *, scatter: float | None
) -> tuple[Fit, Levels]:
    """Estimate the levels and search again until they rest.

    Parameters
    ----------
    problem, free, scatter : as for `settle`
    fit, levels : a fit, and the levels it was made with
    """
    max_rounds = 6
    for _ in range(max_rounds):
        factors = np.exp(fit.point.gain + fit.point.offsets[problem.sample])
        correlation = correlation_of(problem.curves, fit.models, factors)
        grams = products(problem, correlation, fit.point, fit.models)
        white = Fit(fit.point, fit.objective, grams, fit.models, fit.steps, fit.settled)
        new = estimate_levels(problem, white, free, correlation, scatter)
        rests = _are_close(levels, new)
        levels = new
        fit = search(problem, levels, _within(fit.point, levels), free)
        if rests:
            break
    return fit, levels


def _first(problem: Problem, levels: Levels, starts: Iterable[Floats], free: Flags) -> Fit:
    """Fit from the first start that the model can follow."""
    why = ""
    for logs in starts:
        try:
            return search(problem, levels, Point(logs, 0.0, np.zeros(problem.n_samples)), free)
        except ValueError as error:
            why = why or str(error)
    message = f"the model cannot follow the curves at any of the starts; at the first: {why}"
    raise ValueError(message)


def _within(point: Point, levels: Levels) -> Point:
    """The point without offsets where samples do not scatter."""
    offsets = point.offsets if levels.scatter > 0.0 else np.zeros_like(point.offsets)
    return Point(point.logs, point.gain, offsets)


def _are_close(one: Levels, other: Levels) -> bool:
    level_tolerance = 0.01
    if abs(one.correlation - other.correlation) > level_tolerance:
        return False
    close = abs(one.noise / other.noise - 1.0) <= level_tolerance
    return close and abs(one.scatter - other.scatter) <= level_tolerance * max(other.scatter, 1e-9)


def _starts(problem: Problem, logs: Floats, free: Flags) -> Iterator[Floats]:
    """The given start, then others, should the model not follow the curves from there."""
    # of the load, where the model cannot follow from the given start
    insulation_shares = (0.3, 0.8)
    yield logs
    if not (free[_TUBE] and free[_COPPER]):
        return
    given = problem.parts.given
    nominal = np.where(free & (given > 0.0), np.log(np.where(given > 0.0, given, 1.0)), logs)
    models = model_forces(problem.parts, np.exp(nominal), problem.curves)
    total = sum(float(np.abs(model.force).sum()) for model in models)
    of_tube = sum(float(np.abs(model.change[_TUBE]).sum()) for model in models)
    measured = sum(float(np.abs(curve.force).sum()) for curve in problem.curves)
    for share in insulation_shares:
        start = nominal.copy()
        start[_TUBE] += np.log(share * measured / of_tube)
        start[_COPPER] += np.log((1.0 - share) * measured / max(total - of_tube, 0.01 * total))
        yield np.clip(start, problem.lower, problem.upper)


def find_local_minima(
    problem: Problem, levels: Levels, line: list[Fit], fit: Fit, free: Flags
) -> list[Fit]:
    """Find every least of the objective.

    Parameters
    ----------
    problem, levels, free : what is fitted
    line : fits with the copper's strength held
    fit : one least, on the line

    Returns
    -------
    In order of the copper's strength; of two without a hill of `_HILL` between them, the lower.
    """
    min_hill = 1.0  # rise of the objective above the higher of two separate minima
    found = [fit]
    for dip in _dips(line):
        if dip is not fit:
            least = _again(problem, levels, dip, free, lowest=fit.objective)
            found += [] if least is None else [least]
    found.sort(key=_place)
    kept: list[Fit] = []
    for finding in found:
        if kept and _hill(line, kept[-1], finding) < min_hill:
            kept[-1] = min(kept[-1], finding, key=lambda one: one.objective)
        else:
            kept.append(finding)
    return kept


def _place(fit: Fit) -> float:
    return float(fit.point.logs[_COPPER])


def line_of(problem: Problem, levels: Levels, fit: Fit, free: Flags) -> list[Fit]:
    """Follow the line on which insulation and copper trade places.

    Parameters
    ----------
    problem, levels, free : what is fitted
    fit : a least of the objective

    Returns
    -------
    Fits with the copper's strength held at even steps, from bound to bound, and the least in its
    place; that alone where insulation and copper are not both free.
    """
    if not (free[_TUBE] and free[_COPPER]):
        return [fit]
    others = free.copy()
    others[_COPPER] = False
    at, low, high = _place(fit), float(problem.lower[_COPPER]), float(problem.upper[_COPPER])
    down = _stretch(problem, levels, fit, others, _stops(at, low))
    up = _stretch(problem, levels, fit, others, _stops(at, high))
    return [*down[::-1], fit, *up]


def _stops(at: float, bound: float) -> Floats:
    count = int(np.ceil(abs(bound - at) / _STRIDE))
    return np.linspace(at, bound, count + 1)[1:]


def _stretch(problem: Problem, levels: Levels, fit: Fit, others: Flags, stops: Floats) -> list[Fit]:
    """Fits at one stop after the other, each begun where the last two point to."""
    objective_tolerance = 0.01
    found = [fit]
    for stop in stops:
        last = found[-1].point
        before = found[-2].point if len(found) > 1 else last
        logs = np.clip(2.0 * last.logs - before.logs, last.logs - 1.0, last.logs + 1.0)
        logs = np.clip(logs, problem.lower, problem.upper)
        logs[_COPPER] = stop
        try:
            start, low = replace(last, logs=logs), fit.objective
            found.append(
                search(problem, levels, start, others, enough=objective_tolerance, lowest=low)
            )
        except ValueError:
            break  # the model cannot follow the curves with such copper
    return found[1:]


def _dips(line: list[Fit]) -> Iterator[Fit]:
    """Points of a line that are not above their neighbours."""
    heights = [np.inf, *(fit.objective for fit in line), np.inf]
    for number, fit in enumerate(line, start=1):
        if heights[number] <= min(heights[number - 1], heights[number + 1]):
            yield fit


def _hill(line: list[Fit], one: Fit, other: Fit) -> float:
    """How far the line rises above both of two leasts between them."""
    between = [fit.objective for fit in line if _place(one) < _place(fit) < _place(other)]
    return max(between, default=-np.inf) - max(one.objective, other.objective)


def local_minimum_of(
    problem: Problem, levels: Levels, fit: Fit, free: Flags, *, lowest: Fit, scatter: float | None
) -> LocalMinimum:
    """Say what is known at a least of the objective.

    Parameters
    ----------
    problem, levels, free, scatter : what was fitted, as for `settle`
    fit : the least
    lowest : of all leasts
    """
    is_known = scatter is not None
    spread = uncertainty(problem, fit, free, levels, is_scatter_known=is_known)
    is_given = is_known or problem.n_samples == 1
    mixture = mix(problem, fit, free, levels, is_scatter_known=is_given)
    return LocalMinimum(fit, max(fit.objective - lowest.objective, 0.0), spread, mixture)
