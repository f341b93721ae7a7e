"""The search for the minimum of the objective, by damped Gauss-Newton steps within the bounds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from labpipe.mechanics.wire.calibration import objective
from labpipe.mechanics.wire.calibration.objective import Fit, Levels, P, Point, Problem
from labpipe.records.arrays import Flags, Floats

_MAX_SEARCH_STEPS = 60
_OBJECTIVE_TOLERANCE = 1e-5
"""Change of the objective predicted by a full step; intervals depend on changes of 1."""


def search(
    problem: Problem,
    levels: Levels,
    start: Point,
    *,
    enough: float = _OBJECTIVE_TOLERANCE,
    lowest: float = np.inf,
) -> Fit:
    """Search the minimum of the objective from a start.

    Parameters
    ----------
    problem, levels : what is fitted
    start : first guess; parameters that are not free stay there
    enough : tolerance of the objective
    lowest : objective of a better fit: the tolerance grows with the rise above it

    Raises
    ------
    ValueError
        If the model cannot follow at the start.
    """
    idle_gain = 1e-3  # of the objective
    max_idle_steps = 3  # in a row, which end a search along a flat valley
    rise_share = 1e-3  # of the distance above another fit
    jitter = 1e-2  # gain below which a failed step is due to the tabulated curves
    damping_range = (1e-6, 10.0, 1e8)  # first, growth, last
    fit = objective.evaluate(problem, levels, start)
    damping, steps, idle = damping_range[0], 0, 0
    while (
        steps < _find_max_steps(fit, lowest)
        and damping <= damping_range[2]
        and idle < max_idle_steps
    ):
        step, pull = _step_inside(fit, damping)
        gain = float(step @ pull)
        if gain <= max(enough, rise_share * (fit.objective - lowest)):
            return replace(fit, steps=steps, settled=True)
        steps += 1
        next_fit = _advance(fit, step, gain)
        if next_fit is not None and next_fit.objective <= fit.objective:
            slow = max(idle_gain, (fit.objective - lowest) / _MAX_SEARCH_STEPS)
            idle = idle + 1 if fit.objective - next_fit.objective <= slow else 0
            fit, damping = next_fit, max(damping / damping_range[1] ** 2, damping_range[0])
        elif gain <= jitter:
            return replace(fit, steps=steps, settled=True)
        else:
            damping *= damping_range[1]
    return replace(fit, steps=steps, settled=steps < _MAX_SEARCH_STEPS)


def _find_max_steps(fit: Fit, lowest: float) -> int:
    """Return the number of steps allowed: few while far above a better fit."""
    max_far_steps = 8
    far_rise = 200.0  # above another fit: no quantile of so few samples is as large
    return max_far_steps if fit.objective - lowest > far_rise else _MAX_SEARCH_STEPS


def _advance(fit: Fit, step: Floats, gain: float) -> Fit | None:
    """Evaluate a step, or part of it if a parabola has its minimum well before.

    In a narrow curved valley whole steps oscillate between its sides.
    """
    whole_share = 0.75  # of a step, from which the whole step is taken
    shortest_share = 0.1
    full_step = _try(fit, step)
    if full_step is None:
        return None
    share = gain / max(full_step.objective - fit.objective + 2.0 * gain, gain)
    if share > whole_share:
        return full_step
    part = _try(fit, max(share, shortest_share) * step)
    return part if part is not None and part.objective < full_step.objective else full_step


def _try(fit: Fit, step: Floats) -> Fit | None:
    """Take a step; None where the model cannot follow, so that the step is shortened."""
    try:
        return objective.evaluate(fit.problem, fit.levels, move(fit, step))
    except ValueError:
        return None


def move(fit: Fit, step: Floats) -> Point:
    """Return the point after a step of all unknowns, within the bounds."""
    point, problem = fit.point, fit.problem
    logs = np.clip(point.logs + step[:P], problem.lower, problem.upper)
    offsets = point.offsets + step[P + 1 :]
    return replace(point, logs=logs, gain=point.gain + float(step[P]), offsets=offsets)


def _step_inside(fit: Fit, damping: float) -> tuple[Floats, Floats]:
    """Return a step within the bounds, and the pull; parameters that cross a bound stop there.

    The others are solved again, because a clipped step need not lead downhill.
    """
    problem = fit.problem
    matrix, pull, moves = objective.make_normal_equations(fit)
    fixed = np.zeros(len(pull))
    while True:  # each round fixes at least one of the parameters
        step = fixed + _step(matrix, pull - matrix @ fixed, moves, damping)
        ahead = fit.point.logs + step[:P]
        beyond = moves[:P] & ((ahead < problem.lower) | (ahead > problem.upper))
        if not beyond.any():
            return step, pull
        inside = np.clip(ahead, problem.lower, problem.upper) - fit.point.logs
        fixed[:P] = np.where(beyond, inside, fixed[:P])
        moves = moves & ~np.concatenate([beyond, np.zeros(len(pull) - P, dtype=np.bool_)])


def _step(matrix: Floats, pull: Floats, moves: Flags, damping: float) -> Floats:
    longest_step = 1.5
    step = np.zeros(len(pull))
    if not moves.any():
        return step
    unit, scale = objective.scale_matrix(matrix[np.ix_(moves, moves)], damping)
    step[moves] = np.linalg.solve(unit, pull[moves] / scale) / scale
    longest = float(np.max(np.abs(step)))
    return step * min(1.0, longest_step / longest) if longest > 0.0 else step
