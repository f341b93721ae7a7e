"""Find time and height of a corner of a signal from straight lines fitted on both sides."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labpipe.records.arrays import Floats, Ints
from labpipe.uncertainty.autocorrelation import estimate_long_run_variance


@dataclass(frozen=True, slots=True)
class Corner:
    """A corner of a signal.

    Parameters
    ----------
    time : s
    time_error : s, standard error; infinite if the two sides meet smoothly
    value : in the unit of the signal
    value_error : standard error of `value`
    n : number of samples used
    """

    time: float
    time_error: float
    value: float
    value_error: float
    n: int


def fit_corner(time: Floats, values: Floats, *, guess: float, window: float) -> Corner | None:
    """Fit two straight lines that meet at a corner of unknown time.

    Parameters
    ----------
    time, values : shape (n,), s and any unit; increasing time
    guess : s, first guess of the corner
    window : s on each side of the guess; the first search covers its inner half

    Returns
    -------
    The corner; None if there are fewer than four samples on one side, or if the fitted corner is
    farther than 3/4 of the window from the guess.

    Notes
    -----
    y = v + a min(t - c, 0) + b max(t - c, 0): v, a, b by linear least squares for every c on a
    grid, then all four by Gauss-Newton. Long records are first averaged in 600 to 1200 bins per
    side. Standard errors use the long-run variance of the residuals
    (`estimate_long_run_variance`). NaN are ignored.
    """
    min_bins_per_side, min_side_samples = 600, 4
    is_used = (np.abs(time - guess) <= window) & ~np.isnan(values)
    size = int(is_used.sum()) // (2 * min_bins_per_side)
    t, y = average_pairs(time[is_used] - guess, values[is_used], size)
    if min((t < 0).sum(), (t > 0).sum()) < min_side_samples:
        return None
    grid = np.linspace(-0.5 * window, 0.5 * window, 41)
    coarse = average_pairs(t, y, len(t) // 200)
    costs = [_fit_joined_lines(*coarse, corner_time)[1] for corner_time in grid]
    corner_time = float(grid[int(np.argmin(costs))])
    parameters = np.append(_fit_joined_lines(t, y, corner_time)[0], corner_time)
    for _ in range(6):
        jacobian, misfit = _linearise(t, y, parameters)
        step = np.linalg.lstsq(jacobian, misfit, rcond=None)[0]
        step[-1] = np.clip(step[-1], -0.05 * window, 0.05 * window)
        parameters = parameters + step
    if not abs(parameters[-1]) < 0.75 * window:
        return None
    jacobian, misfit = _linearise(t, y, parameters)
    return _make_corner(jacobian, misfit, parameters, guess, int(is_used.sum()))


def fit_stop(
    time: Floats, values: Floats, *, guesses: tuple[float, float], window: float
) -> tuple[Corner, Corner] | None:
    """Fit a line, a level and a line: the stop and the restart of a motion.

    Parameters
    ----------
    time, values : shape (n,), s and any unit; increasing time
    guesses : s, first guesses of stop and restart
    window : s before the stop and after the restart

    Returns
    -------
    Both corners; None if a line or the level has too few samples, or if the lines do not meet the
    level between the first and the last sample.

    Notes
    -----
    Every sample is assigned to the line before, the level or the line after. Each is fitted by
    least squares, and the corners are the intersections; the assignment is repeated until it does
    not change. The excess of a level that is too long at first is about halved each time.
    Standard errors use the long-run variance of the residuals. NaN are ignored.
    """
    min_line_samples, min_level_samples = 5, 3  # two samples may lie on both sides of a corner
    is_used = (time >= guesses[0] - window) & (time <= guesses[1] + window) & ~np.isnan(values)
    middle = 0.5 * (guesses[0] + guesses[1])
    t, y = time[is_used] - middle, values[is_used]
    ends = [guess - middle for guess in guesses]
    assigned: Ints = np.zeros(0, dtype=np.int64)
    slopes, level = [0.0, 0.0], 0.0
    for _ in range(30):
        sections = np.searchsorted(ends, t)
        if np.array_equal(sections, assigned):
            break
        assigned = sections
        is_before, is_level, is_after = (sections == number for number in range(3))
        n_line, n_level = min(is_before.sum(), is_after.sum()), is_level.sum()
        if n_line < min_line_samples or n_level < min_level_samples:
            return None
        lines = [np.polyfit(t[section], y[section], 1) for section in (is_before, is_after)]
        slopes, level = [float(line[0]) for line in lines], float(y[is_level].mean())
        if 0.0 in slopes:
            return None
        ends = [(level - float(line[1])) / line[0] for line in lines]
        if not t[0] < ends[0] < ends[1] < t[-1]:
            return None
    sides = np.minimum(t - ends[0], 0.0), np.maximum(t - ends[1], 0.0)
    misfit = y - level - slopes[0] * sides[0] - slopes[1] * sides[1]
    time_columns = [-slope * (side != 0.0) for slope, side in zip(slopes, sides, strict=True)]
    columns = [np.ones_like(t), *sides]
    stop, start = (
        _make_corner(
            np.column_stack([*columns, *pair]), misfit, np.array([level, end]), middle, len(t)
        )
        for pair, end in zip((time_columns[::-1], time_columns), ends, strict=True)
    )
    return stop, start


def _make_corner(
    jacobian: Floats, misfit: Floats, parameters: Floats, time_origin: float, count: int
) -> Corner:
    """Return the corner of parameters (value first, time last), with errors from the Jacobian."""
    variance = estimate_long_run_variance(misfit, parameters=jacobian.shape[1])
    scale = np.linalg.norm(jacobian, axis=0)
    scale[scale == 0.0] = 1.0
    information = (jacobian / scale).T @ (jacobian / scale)
    is_determined = np.linalg.cond(information) < 1e12
    inverse = np.linalg.pinv(information) / np.outer(scale, scale)
    errors = np.sqrt(np.maximum(variance * np.diag(inverse), 0.0))
    return Corner(
        time=time_origin + float(parameters[-1]),
        time_error=float(errors[-1]) if is_determined else float("inf"),
        value=float(parameters[0]),
        value_error=float(errors[0]),
        n=count,
    )


def average_pairs(time: Floats, values: Floats, size: int) -> tuple[Floats, Floats]:
    """Average blocks of consecutive samples; unlike decimation, this does not alias hum.

    Parameters
    ----------
    time, values : shape (n,)
    size : samples per block; below 2 the samples are returned unchanged

    Returns
    -------
    Means of both, shape (n // size,); NaN where a block contains one.
    """
    if size < 2:
        return time, values
    count = len(time) // size * size
    time, values = time[:count].reshape(-1, size), values[:count].reshape(-1, size)
    return time.mean(axis=1), values.mean(axis=1)


def _build_design(time: Floats, corner: float) -> Floats:
    return np.column_stack(
        [np.ones_like(time), np.minimum(time - corner, 0.0), np.maximum(time - corner, 0.0)]
    )


def _fit_joined_lines(time: Floats, values: Floats, corner: float) -> tuple[Floats, float]:
    design = _build_design(time, corner)
    coefficients = np.asarray(np.linalg.lstsq(design, values, rcond=None)[0], dtype=np.float64)
    misfit = values - design @ coefficients
    return coefficients, float(misfit @ misfit)


def _linearise(time: Floats, values: Floats, parameters: Floats) -> tuple[Floats, Floats]:
    """Return Jacobian and misfit of the model; the last parameter is the time of the corner."""
    coefficients, corner_time = parameters[:-1], float(parameters[-1])
    design = _build_design(time, corner_time)
    slope = -np.where(time < corner_time, coefficients[1], coefficients[2])
    return np.column_stack([design, slope]), values - design @ coefficients
