"""Intervals of a calibration checked by simulation: tests drawn from the fit, and fitted again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter

from labpipe.records.arrays import Floats
from labpipe.records.calibration import (
    PARAMETERS,
    BootstrapCheck,
    CalibrationFailure,
)
from labpipe.records.curve import Interval
from labpipe.wire.calibrating.data import MeasuredCurve, shared_errors
from labpipe.wire.calibrating.finding import Found, Settings, Wire, find
from labpipe.wire.calibrating.mixture import mix, quantiles
from labpipe.wire.calibrating.search import Fit, P, Point, Problem, search
from labpipe.wire.calibrating.settling import refine
from labpipe.wire.calibrating.variances import uncertainty

_ENOUGH = 0.9  # share of draws that must be fitted


@dataclass(frozen=True, slots=True, eq=False)
class _Draw:
    """One draw fitted: shape (3,) each, NaN for what is not free."""

    distance: Floats
    covered: Floats


def check_by_bootstrap(
    wire: Wire,
    curves: Sequence[MeasuredCurve],
    settings: Settings | None = None,
    *,
    draws: int = 200,
    seed: int = 0,
) -> tuple[BootstrapCheck, ...] | CalibrationFailure:
    """Check the intervals of a calibration by a parametric bootstrap.

    Parameters
    ----------
    wire, curves, settings : as for `calibrate`
    draws : how many campaigns are drawn
    seed : of the draws

    Returns
    -------
    For each free parameter its studentised interval, and how often the profile interval of a draw
    holds the value that the draw was made with; or the failure of the calibration.

    Notes
    -----
    Each draw has new noise with the fitted variance and correlation, new factors of the samples
    and a new gain of the load cell; priors are drawn anew about the fitted values, as data would
    be. Levels are estimated anew in each. Efron and Tibshirani, An Introduction to the Bootstrap
    (1993), chapter 12.
    """
    found = find(wire, curves, settings or Settings())
    if isinstance(found, CalibrationFailure):
        return found
    generator = np.random.default_rng(seed)
    fitted = [_fit_draw(found, _draw(found, generator)) for _ in range(draws)]
    kept = [draw for draw in fitted if draw is not None]
    free = np.flatnonzero(found.free).tolist()
    return tuple(_check(found, number, kept, draws) for number in free)


def _check(found: Found, number: int, kept: list[_Draw], draws: int) -> BootstrapCheck:
    failed = draws - len(kept)
    name = PARAMETERS[number]
    if len(kept) < _ENOUGH * draws:
        return BootstrapCheck(name, None, np.nan, draws, failed)
    low, high = np.quantile([draw.distance[number] for draw in kept], [0.025, 0.975])
    best = float(found.fit.point.logs[number])
    error = float(np.sqrt(found.spread.covariance[number, number]))
    interval = Interval(float(np.exp(best - high * error)), float(np.exp(best - low * error)))
    covered = float(np.mean([draw.covered[number] for draw in kept]))
    return BootstrapCheck(name, interval, covered, draws, failed)


def _draw(found: Found, generator: np.random.Generator) -> Problem:
    """The problem with forces, and centres of priors, drawn from the fit."""
    problem, levels = found.problem, found.levels
    gain = problem.gain * generator.normal()
    offsets = levels.scatter * generator.normal(size=problem.n_samples)
    curves = tuple(
        replace(
            curve,
            force=np.exp(gain + offsets[sample]) * model.force
            + _noise(found, curve, model.slope, generator),
        )
        for curve, model, sample in zip(
            problem.curves, found.fit.models, problem.sample, strict=True
        )
    )
    errors = np.where(problem.precision > 0.0, problem.precision, np.inf) ** -0.5
    centre = found.fit.point.logs + errors * generator.normal(size=P)
    return replace(problem, curves=curves, centre=centre)


def _noise(
    found: Found, curve: MeasuredCurve, slope: Floats, generator: np.random.Generator
) -> Floats:
    """Noise of the points, and errors that they share, N."""
    factor = found.levels.correlation
    kicks = generator.normal(size=len(curve.force)) * np.sqrt(1.0 - factor**2)
    kicks[0] /= np.sqrt(1.0 - factor**2)
    white: Floats = np.asarray(lfilter([1.0], [1.0, -factor], kicks), dtype=np.float64)
    errors = shared_errors(curve, slope)
    shared = generator.normal(size=len(errors)) @ errors
    return np.asarray(np.sqrt(found.levels.noise) * (white * np.asarray(curve.noise) + shared))


def _fit_draw(found: Found, problem: Problem) -> _Draw | None:
    """Fit a draw from where the truth is; None where the model cannot follow it."""
    truth, known = found.fit.point, found.settings.scatter
    start = replace(truth, gain=0.0, offsets=np.zeros_like(truth.offsets))
    try:
        first = search(problem, found.levels, start, found.free)
        fit, levels = refine(problem, first, found.levels, found.free, scatter=known)
    except ValueError:
        return None
    spread = uncertainty(problem, fit, found.free, levels, is_scatter_known=found.is_scatter_known)
    mixture = mix(problem, fit, found.free, levels, is_scatter_known=_is_given(found))
    low, high = quantiles(mixture, np.eye(P + 1)[:P])
    distance, covered = np.full((2, P), np.nan)
    for number in np.flatnonzero(found.free).tolist():
        error = np.sqrt(spread.covariance[number, number])
        away = truth.logs[number] - fit.point.logs[number]
        distance[number] = -away / error
        limit = (low[number] if away < 0.0 else high[number]) / error
        others = found.free.copy()
        others[number] = False
        held = search(problem, levels, _at(fit, truth.logs, number), others)
        covered[number] = held.objective - fit.objective <= limit**2
    return _Draw(distance, covered)


def _is_given(found: Found) -> bool:
    return found.is_scatter_known or found.problem.n_samples == 1


def _at(fit: Fit, truth: Floats, number: int) -> Point:
    logs = fit.point.logs.copy()
    logs[number] = truth[number]
    return replace(fit.point, logs=logs)
