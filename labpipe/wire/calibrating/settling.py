"""Parameters and levels together: search, estimate the levels, search again."""

from __future__ import annotations

import numpy as np

from labpipe.records.arrays import Flags, Floats
from labpipe.records.calibration import COPPER_SCALE, INSULATION_MODULUS, PARAMETERS
from labpipe.wire.calibrating.model import model_forces
from labpipe.wire.calibrating.search import Fit, Levels, Point, Problem, products, search
from labpipe.wire.calibrating.variances import correlation_of, estimate_levels

_FIRST_SCATTER = 0.05
_ROUNDS, _SETTLED = 6, 0.01
_SHARES = (0.3, 0.8)
"""Of the load that the insulation takes, in the starts besides the given one."""


def settle(
    problem: Problem, logs: Floats, free: Flags, *, scatter: float | None
) -> tuple[Fit, Levels]:
    """Fit parameters and levels.

    Parameters
    ----------
    problem : what is fitted
    logs : shape (3,), where the search starts
    free : shape (3,)
    scatter : of the samples, in logarithms, where it is given

    Returns
    -------
    The fit and the levels that it was made with.

    Raises
    ------
    ValueError
        If the model cannot follow the curves at any start.

    Notes
    -----
    A wire of hard copper without insulation can look like one of soft copper with it, so there may
    be two valleys. Besides the given start two more are tried, in which the insulation takes three
    and eight tenths of the load; the least objective wins, whatever the start.
    """
    levels = Levels(1.0, 0.0, _FIRST_SCATTER if scatter is None else scatter)
    found = [_from(problem, levels, start, free) for start in _starts(problem, logs, free)]
    fits = [fit for fit in found if fit is not None]
    if not fits:
        message = "the model cannot follow the curves at any of the starts"
        raise ValueError(message)
    return refine(problem, min(fits, key=lambda fit: fit.objective), levels, free, scatter=scatter)


def refine(
    problem: Problem, fit: Fit, levels: Levels, free: Flags, *, scatter: float | None
) -> tuple[Fit, Levels]:
    """Estimate the levels and search again until they rest.

    Parameters
    ----------
    problem, free, scatter : as for `settle`
    fit, levels : a fit, and the levels it was made with
    """
    for _ in range(_ROUNDS):
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


def _from(problem: Problem, levels: Levels, logs: Floats, free: Flags) -> Fit | None:
    start = Point(logs, 0.0, np.zeros(problem.n_samples))
    try:
        return search(problem, levels, start, free)
    except ValueError:
        return None


def _within(point: Point, levels: Levels) -> Point:
    """The point without offsets where samples do not scatter."""
    offsets = point.offsets if levels.scatter > 0.0 else np.zeros_like(point.offsets)
    return Point(point.logs, point.gain, offsets)


def _are_close(one: Levels, other: Levels) -> bool:
    if abs(one.correlation - other.correlation) > _SETTLED:
        return False
    close = abs(one.noise / other.noise - 1.0) <= _SETTLED
    return close and abs(one.scatter - other.scatter) <= _SETTLED * max(other.scatter, 1e-9)


def _starts(problem: Problem, logs: Floats, free: Flags) -> list[Floats]:
    tube, copper = PARAMETERS.index(INSULATION_MODULUS), PARAMETERS.index(COPPER_SCALE)
    if not (free[tube] and free[copper]):
        return [logs]
    given = problem.parts.given
    nominal = np.where(free & (given > 0.0), np.log(np.where(given > 0.0, given, 1.0)), logs)
    models = model_forces(problem.parts, np.exp(nominal), problem.curves)
    total = sum(float(np.abs(model.force).sum()) for model in models)
    of_tube = sum(float(np.abs(model.change[tube]).sum()) for model in models)
    measured = sum(float(np.abs(curve.force).sum()) for curve in problem.curves)
    starts = [logs]
    for share in _SHARES:
        start = nominal.copy()
        start[tube] += np.log(share * measured / of_tube)
        start[copper] += np.log((1.0 - share) * measured / max(total - of_tube, 0.01 * total))
        starts.append(np.clip(start, problem.lower, problem.upper))
    return starts
