"""Fit the time and the height of a corner of a signal, or of the reversal of a force.

A corner has straight lines on both sides. At a reversal, a force first falls steeply, until strands
slide. The steep fall lasts a tenth of a second. A parabola over a longer window does not follow
this fall, and a shorter window contains too few samples. In the model of a reversal, the slope of
the fall may therefore change anywhere.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import log_ndtr, ndtr

from labpipe.records.arrays import Floats, Ints, average_blocks
from labpipe.signal.turning_points import estimate_noise_level
from labpipe.uncertainty.autocorrelation import estimate_long_run_variance


@dataclass(frozen=True, slots=True)
class Corner:
    """Corner of a signal, with standard errors.

    Parameters
    ----------
    time : time of the corner, s
    time_error : standard error of `time`, s; infinite if the two sides meet smoothly
    value : value at the corner, in the unit of the signal
    value_error : standard error of `value`, in the unit of the signal
    n : number of samples to which the corner is fitted
    shape_error : component of `time_error` from the unknown shape of the fall after a reversal, s.
        This component is equal at all similar turns of a specimen and does not average out
    """

    time: float
    time_error: float
    value: float
    value_error: float
    n: int
    shape_error: float = 0.0


def fit_corner(time: Floats, values: Floats, *, guess: float, window: float) -> Corner | None:
    """Fit two straight lines that meet at a corner of unknown time.

    Parameters
    ----------
    time, values : shape (n,), increasing times (s) and values (any unit) of the signal
    guess : first guess of the time of the corner, s
    window : width of the window on each side of the guess, s; the first search covers the half of
        the window that is nearer to the guess

    Returns
    -------
    The corner; None if there are fewer than four samples on one side, if all values are equal, or
    if the fitted corner is 3/4 of the window or more from the guess.

    Notes
    -----
    The model is y = v + a min(t - c, 0) + b max(t - c, 0), with the corner at the time c. First, v,
    a and b are fitted by linear least squares for every c of a grid. Then all four parameters are
    fitted by the Gauss-Newton method. Long records are averaged in 600 to 1200 bins on each side.
    Standard errors use the long-run variance of the residuals (`estimate_long_run_variance`). NaN
    are ignored.
    """
    min_bins_per_side, min_side_samples, n_steps = 600, 4, 6
    is_used = (np.abs(time - guess) <= window) & ~np.isnan(values)
    t, y = _average_pairs(time[is_used] - guess, values[is_used], 2 * min_bins_per_side)
    if min((t < 0).sum(), (t > 0).sum()) < min_side_samples or np.ptp(y) == 0.0:
        return None
    grid = np.linspace(-0.5 * window, 0.5 * window, 41)
    search_bins = _average_pairs(t, y, 200)
    squares = [_fit_joined_lines(*search_bins, corner_time)[1] for corner_time in grid]
    corner_time = float(grid[int(np.argmin(squares))])
    parameters = np.append(_fit_joined_lines(t, y, corner_time)[0], corner_time)
    for _ in range(n_steps):
        jacobian, residuals = _linearise(t, y, parameters)
        step = np.linalg.lstsq(jacobian, residuals, rcond=None)[0]
        step[-1] = np.clip(step[-1], -0.05 * window, 0.05 * window)
        parameters = parameters + step
    if not abs(parameters[-1]) < 0.75 * window:
        return None
    jacobian, residuals = _linearise(t, y, parameters)
    return _make_corner(jacobian, residuals, parameters, guess, int(is_used.sum()))


def fit_stop(
    time: Floats, values: Floats, *, guesses: tuple[float, float], window: float
) -> tuple[Corner, Corner] | None:
    """Fit the stop and the restart of a motion by a line, a constant level and another line.

    Parameters
    ----------
    time, values : shape (n,), increasing times (s) and values (any unit) of the motion
    guesses : first guesses of the times of stop and restart, s
    window : width of the window before the stop and after the restart, s

    Returns
    -------
    The corners at stop and restart; None if a line or the level has too few samples, or if the
    lines do not meet the level between the first and the last sample.

    Notes
    -----
    Every sample is assigned to the line before the stop, to the level, or to the line after the
    restart. Both lines and the level are fitted by least squares, and the corners are the
    intersections of the lines with the level. The assignment is repeated until it does not change.
    If the level is too long at first, each repetition about halves the excess. Standard errors use
    the long-run variance of the residuals. NaN are ignored.
    """
    min_line_samples, min_level_samples, max_assignments = 5, 3, 30
    is_used = (time >= guesses[0] - window) & (time <= guesses[1] + window) & ~np.isnan(values)
    middle = 0.5 * (guesses[0] + guesses[1])
    t, y = time[is_used] - middle, values[is_used]
    corner_times = [guess - middle for guess in guesses]
    previous_sections: Ints = np.zeros(0, dtype=np.int64)
    slopes, level = [0.0, 0.0], 0.0
    for _ in range(max_assignments):
        sections = np.searchsorted(corner_times, t)
        if np.array_equal(sections, previous_sections):
            break
        previous_sections = sections
        is_before, is_level, is_after = (sections == section for section in range(3))
        n_line, n_level = min(is_before.sum(), is_after.sum()), is_level.sum()
        if n_line < min_line_samples or n_level < min_level_samples:
            return None
        lines = [np.polyfit(t[flags], y[flags], 1) for flags in (is_before, is_after)]
        slopes, level = [float(line[0]) for line in lines], float(y[is_level].mean())
        if 0.0 in slopes:
            return None
        corner_times = [(level - float(line[1])) / line[0] for line in lines]
        if not t[0] < corner_times[0] < corner_times[1] < t[-1]:
            return None
    sides = np.minimum(t - corner_times[0], 0.0), np.maximum(t - corner_times[1], 0.0)
    residuals = y - level - slopes[0] * sides[0] - slopes[1] * sides[1]
    columns = [np.ones_like(t), *sides]
    time_columns = [-slope * (side != 0.0) for slope, side in zip(slopes, sides, strict=True)]
    # The last column is the derivative with respect to the time of the corner that is made.
    jacobians = [np.column_stack([*columns, *x]) for x in (time_columns[::-1], time_columns)]
    stop, restart = (
        _make_corner(jacobian, residuals, np.array([level, corner_time]), middle, len(t))
        for jacobian, corner_time in zip(jacobians, corner_times, strict=True)
    )
    return stop, restart


def _make_corner(
    jacobian: Floats, residuals: Floats, parameters: Floats, time_origin: float, count: int
) -> Corner:
    """Make the corner from fitted parameters, with standard errors from the Jacobian.

    The first parameter is the value, and the last one is the time since the time origin, s.
    """
    variance = estimate_long_run_variance(residuals, n_parameters=jacobian.shape[1])
    scale = np.linalg.norm(jacobian, axis=0)
    scale[scale == 0.0] = 1.0
    information = (jacobian / scale).T @ (jacobian / scale)
    is_determined = np.linalg.cond(information) < 1e12  # not if both sides meet smoothly
    inverse = np.linalg.pinv(information) / np.outer(scale, scale)
    errors = np.sqrt(np.maximum(variance * np.diag(inverse), 0.0))
    return Corner(
        time=time_origin + float(parameters[-1]),
        time_error=float(errors[-1]) if is_determined else float("inf"),
        value=float(parameters[0]),
        value_error=float(errors[0]),
        n=count,
    )


def _average_pairs(time: Floats, values: Floats, min_blocks: int) -> tuple[Floats, Floats]:
    """Average times and values over blocks of equal size, at least `min_blocks` of them."""
    t, y = (average_blocks(x, min_blocks, has_remainder=False) for x in (time, values))
    return t, y


def _build_line_design(time: Floats, corner_time: float) -> Floats:
    """Build the design of a value and two slopes, shape (n, 3), for the time of a corner."""
    u = time - corner_time
    return np.column_stack([np.ones_like(u), np.minimum(u, 0.0), np.maximum(u, 0.0)])


def _fit_joined_lines(time: Floats, values: Floats, corner_time: float) -> tuple[Floats, float]:
    """Fit the value and the slopes at a corner; return these and the sum of squares."""
    design = _build_line_design(time, corner_time)
    coefficients = np.asarray(np.linalg.lstsq(design, values, rcond=None)[0], dtype=np.float64)
    residuals = values - design @ coefficients
    return coefficients, float(residuals @ residuals)


def _linearise(time: Floats, values: Floats, parameters: Floats) -> tuple[Floats, Floats]:
    """Compute the Jacobian and the residuals; the last parameter is the time of the corner."""
    coefficients, corner_time = parameters[:-1], float(parameters[-1])
    design = _build_line_design(time, corner_time)
    time_column = -np.where(time < corner_time, coefficients[1], coefficients[2])
    return np.column_stack([design, time_column]), values - design @ coefficients


_N_FIXED = 5
"""Number of fixed columns: value, slopes before and after, curvatures before and after."""
_SLOPE_BEFORE, _SLOPE_AFTER = 1, 2
"""Indices of the columns of the slopes before and after the corner."""
_KNOTS = np.append(0.014 * np.arange(1, 9), 0.126 * 2.0 ** (np.arange(21) / 8.0))
"""Times since the beginning of the fall, in windows, at which the slope may change.

They are dense enough to follow a sudden change of slope at any time.
"""
_DWELL_KNOTS = 2.0 ** -np.arange(1.0, 7.0)
"""Times since the beginning of the dwell, in dwells, at which the slope may change."""
_ROUGHNESSES = 2.0 ** np.arange(-1.0, 10.0, 1.5)
"""Standard deviations of a change of slope, in standard errors of a slope."""
_SEARCH_RANGE = 0.5
"""Half width of the range in which the corner is searched, in windows."""


@dataclass(frozen=True, slots=True, eq=False)
class _Grid:
    """Fits and likelihoods of a corner at each time of a grid, for each roughness.

    Parameters
    ----------
    times : shape (times,), times of the corner since the first guess, in windows
    n_fixed : number of fixed columns of the design
    precision : shape (roughnesses,), variance of the noise over that of a change of slope
    log_likelihood : shape (times, roughnesses), logarithm of the likelihood
    fall_logs : shape (times, roughnesses), logarithm of the probability that the force falls after
        the corner
    gram : shape (times, columns, columns), products of the columns of the design
    moments : shape (times, columns), products of the columns and the signal
    inverse : shape (times, roughnesses, columns, columns), inverse of `gram` plus the precision
    coefficients : shape (times, roughnesses, columns), fitted coefficients of the columns
    """

    times: Floats
    n_fixed: int
    precision: Floats
    log_likelihood: Floats
    fall_logs: Floats
    gram: Floats
    moments: Floats
    inverse: Floats
    coefficients: Floats


def fit_reversal(
    time: Floats, values: Floats, *, guess: float, window: float, dwell: float = 0.0
) -> Corner | None:
    """Fit the corner between a smooth rise and a fall whose slope may change anywhere.

    Parameters
    ----------
    time, values : shape (n,), increasing times (s) and values (any unit) of the force
    guess : first guess of the time of the corner, s
    window : width of the window on each side of the guess, s; the corner is searched within half a
        window of the guess
    dwell : known dwell of the machine between the rise and the fall, s; the window of the fall
        begins after the dwell

    Returns
    -------
    The corner at the end of the rise; None if there are too few samples on one side, if the corner
    may be at the edge of the searched range, or if the force does not fall.

    Notes
    -----
    With the time u = t - c since the corner, the model is a parabola before the corner, and after
    it a parabola whose slope may change at times s_k:

    y = v + a_1 min(u, 0) + a_2 min(u, 0)^2 + b_1 max(u, 0) + b_2 max(u, 0)^2
    + sum_k z_k max(u - s_k, 0).

    The times s_k have equal distances next to the corner and equal ratios farther away. The z_k are
    normal with a common standard deviation, the roughness. The result is averaged over several
    roughnesses, weighted by their marginal likelihood. A parabolic fall is thus fitted as a
    parabola over the whole window, and any other fall as closely as the noise allows. The errors
    include the uncertainty of the roughness. This is the Bayesian smoothing spline, whose intervals
    also cover fixed curves (Wahba, J. R. Stat. Soc. B 45 (1983) 133; Nychka, J. Am. Stat. Assoc. 83
    (1988) 1134).

    The force must fall after the corner, at first at least half as steeply as later. Likelihoods
    are weighted by the probability of such a fall, since an earlier corner followed by a rise or a
    flat top would fit as well. The variance of the noise is the long-run variance of the residuals
    of the most likely curve.

    With a dwell D, the fall begins at c + D, and max(u - D, 0) replaces max(u, 0). During the
    dwell, the force may relax, fast at first. With q = min(max(u, 0), D), the model then also has
    the terms d q + sum_k x_k max(q - 2^-k D, 0), where the x_k are distributed as the z_k. NaN are
    ignored.
    """
    min_bins = 600  # on both sides together; a longer record is averaged in up to 1200 bins
    first_half_width = 0.15  # half width of the first grid, in windows
    is_used = (time >= guess - window) & (time <= guess + window + dwell) & ~np.isnan(values)
    count, relative_dwell = int(is_used.sum()), dwell / window
    t, y = _average_pairs((time[is_used] - guess) / window, values[is_used], min_bins)
    n_before, n_after = (t < -_SEARCH_RANGE).sum(), (t > relative_dwell + _SEARCH_RANGE).sum()
    if min(n_before, n_after) < _N_FIXED or np.ptp(y) == 0.0:
        return None
    variance = _estimate_white_noise(y)
    grid = _refine_grid(t, y, variance, (-first_half_width, first_half_width), relative_dwell)
    for _ in range(2):
        previous_variance = variance
        variance = _estimate_noise(t, y, grid, variance, relative_dwell)
        if abs(variance - previous_variance) > 0.05 * previous_variance:
            bounds = float(grid.times[0]), float(grid.times[-1])
            grid = _refine_grid(t, y, variance, bounds, relative_dwell)
    corner = _average_corners(grid, variance)
    if corner is None:
        return None
    corner_time, error = guess + window * corner.time, window * corner.time_error
    shape_error = error * float(np.sqrt(_compute_shape_fraction(t, grid, relative_dwell)))
    return replace(corner, time=corner_time, time_error=error, n=count, shape_error=shape_error)


def _estimate_white_noise(y: Floats) -> float:
    """Estimate the variance of white noise on a smooth signal from the median second difference.

    If most second differences are zero, as in a coarsely quantised signal, the estimate is made
    from the mean square of the second differences.
    """
    level, min_level = estimate_noise_level(y), 1e-9 * float(np.ptp(y))
    if level <= min_level:
        level = float(np.sqrt(np.mean(np.diff(y, 2) ** 2) / 6.0))
    return float(max(level, min_level) ** 2)


def _refine_grid(
    t: Floats, y: Floats, variance: float, bounds: tuple[float, float], dwell: float
) -> _Grid:
    """Find a grid that covers the likely times of the corner.

    Parameters
    ----------
    t, y : times since the first guess, in windows, and values of the signal
    variance : variance of the noise
    bounds : first guess of the first and the last time of the grid, in windows
    dwell : duration of the dwell, in windows
    """
    n_times, max_refinements = 25, 8
    max_log_likelihood_drop = 8.0  # times with a larger drop are not likely
    first, last = bounds
    grid = _evaluate_grid(t, y, np.linspace(first, last, n_times), variance, dwell)
    for _ in range(max_refinements):
        log_likelihoods = np.logaddexp.reduce(grid.log_likelihood, axis=1)
        drops = log_likelihoods.max() - log_likelihoods
        likely_rows = np.flatnonzero(drops < max_log_likelihood_drop)
        first_row, last_row, width = int(likely_rows[0]), int(likely_rows[-1]), last - first
        is_open_below = first_row == 0 and first > -_SEARCH_RANGE
        is_open_above = last_row == n_times - 1 and last < _SEARCH_RANGE
        if not (is_open_below or is_open_above) and last_row - first_row >= n_times // 3:
            break
        times = [first - 0.5 * width, *grid.times.tolist(), last + 0.5 * width]
        first = max(-_SEARCH_RANGE, times[first_row])
        last = min(_SEARCH_RANGE, times[last_row + 2])
        grid = _evaluate_grid(t, y, np.linspace(first, last, n_times), variance, dwell)
    return grid


def _build_design(t: Floats, corners: Floats, dwell: float) -> Floats:
    """Build the design for every time of the corner, shape (corners, columns, n).

    The first columns are fixed: the `_N_FIXED` columns and, with a dwell, the slope in the dwell.
    Each of the random columns is that of a change of slope at a knot.
    """
    u = t - corners[:, None]
    rise, fall, relaxation = np.minimum(u, 0.0), np.maximum(u - dwell, 0.0), np.clip(u, 0.0, dwell)
    fixed_columns = [np.ones_like(u), rise, fall, rise**2, fall**2]
    fixed_columns += [relaxation] if dwell > 0.0 else []
    knots, n_fixed = np.append(_KNOTS, _DWELL_KNOTS * dwell), len(fixed_columns)
    n_knots = len(knots) if dwell > 0.0 else len(_KNOTS)
    design = np.empty((len(corners), n_fixed + n_knots, len(t)))
    for index, column in enumerate(fixed_columns):
        design[:, index] = column
    design[:, n_fixed : n_fixed + len(_KNOTS)] = fall[:, None]
    design[:, n_fixed + len(_KNOTS) :] = relaxation[:, None]
    random_columns = design[:, n_fixed:]
    np.maximum(random_columns - knots[:n_knots, None], 0.0, out=random_columns)
    return design


def _evaluate_grid(t: Floats, y: Floats, corners: Floats, variance: float, dwell: float) -> _Grid:
    """Fit a corner at each time, and compute the likelihoods.

    The coefficients of the fixed columns are fitted, and those of the random columns are integrated
    out of the likelihood.
    """
    design = _build_design(t, corners, dwell)
    n_fixed = _N_FIXED + (dwell > 0.0)  # a dwell adds the column of the slope in the dwell
    gram, moments = design @ design.transpose(0, 2, 1), design @ y
    fixed_gram, cross_gram = gram[:, :n_fixed, :n_fixed], gram[:, :n_fixed, n_fixed:]
    right_sides = np.concatenate([cross_gram, moments[:, :n_fixed, None]], axis=2)
    solution = np.linalg.solve(fixed_gram, right_sides)
    # Of the random columns and the signal, the parts that fixed columns do not explain remain.
    cross_gram_t = cross_gram.transpose(0, 2, 1)
    random_gram = gram[:, n_fixed:, n_fixed:] - cross_gram_t @ solution[..., :-1]
    random_moments = moments[:, n_fixed:, None] - cross_gram_t @ solution[..., -1:]
    residual_squares = float(y @ y) - np.sum(moments[:, :n_fixed] * solution[..., -1], axis=1)
    eigenvalues, axes = np.linalg.eigh(random_gram)
    axis_squares = (axes.transpose(0, 2, 1) @ random_moments)[..., 0] ** 2
    # The squared standard error of a slope on one side is 24 / n of the variance of the noise.
    ratios = (_ROUGHNESSES**2 * 24.0 / len(t))[:, None]
    scale = 1.0 + ratios * np.maximum(eigenvalues, 0.0)[:, None, :]
    squares = residual_squares[:, None] - np.sum(ratios * axis_squares[:, None, :] / scale, axis=2)
    logs = -0.5 * (np.sum(np.log(scale), axis=2) + squares / variance)
    precision = 1.0 / ratios[:, 0]
    # The inverse of `gram` plus the precision is diagonal along the axes of the random columns.
    identity = np.broadcast_to(np.eye(random_gram.shape[1]), random_gram.shape)
    directions = (np.concatenate([-solution[..., :-1], identity], axis=1) @ axes)[:, None]
    diagonal = np.maximum(eigenvalues, 0.0)[:, None, None, :] + precision[:, None, None]
    inverse: Floats = (directions / diagonal) @ directions.transpose(0, 1, 3, 2)
    inverse[..., :n_fixed, :n_fixed] += np.linalg.inv(fixed_gram[:, None])
    coefficients = (inverse @ moments[:, None, :, None])[..., 0]
    fall_logs, relaxation_logs = _compute_fall_logs(inverse, coefficients, variance, dwell)
    logs += fall_logs + relaxation_logs
    return _Grid(corners, n_fixed, precision, logs, fall_logs, gram, moments, inverse, coefficients)


def _compute_fall_logs(
    inverse: Floats, coefficients: Floats, variance: float, dwell: float
) -> tuple[Floats, Floats]:
    """Compute the log probability that the force falls after the corner, steeply at first.

    With a dwell, the slope must also decrease at the beginning and at the end of the dwell. The
    second array is the log probability that the force falls at least twice as fast after the dwell
    as during it, which is usual. This array is 0 without a dwell.
    """
    compared_spans = (0.12, 0.25)  # in windows, from the beginning of the fall
    # In the first `early_fraction` of a span, the slope must be at least `min_early_slope` times
    # the mean slope over the span.
    early_fraction, min_early_slope = 0.25, 0.5
    unloading_span = 0.06  # in windows, after the dwell
    slope_tolerance = 2.0  # standard errors by which the beginning of a fall may be too flat
    # Fraction of dwells in which the force relaxes as fast as it falls in unloading.
    fast_relaxation_fraction = 0.001

    def score(contrast: Floats) -> Floats:
        """Compute the decrease of a linear combination of coefficients, in standard errors."""
        error = np.sqrt(variance * ((inverse @ contrast) @ contrast))
        return np.asarray(-(coefficients @ contrast) / error, dtype=np.float64)

    slope_before, slope_after = np.eye(coefficients.shape[-1])[[_SLOPE_BEFORE, _SLOPE_AFTER]]
    contrasts = []
    for span in compared_spans:
        early_change = _compute_change(dwell, dwell + early_fraction * span, dwell)
        change = _compute_change(dwell, dwell + span, dwell)
        contrasts.append(early_change - min_early_slope * early_fraction * change)
    relaxation_logs = np.zeros(coefficients.shape[:-1])
    if dwell > 0.0:
        unloading_slope = _compute_change(dwell, dwell + unloading_span, dwell) / unloading_span
        dwell_slope = _compute_change(0.5 * dwell, dwell, dwell) / (0.5 * dwell)
        first_slope = _compute_change(0.0, 0.25 * dwell, dwell) / (0.25 * dwell)
        contrasts += [unloading_slope - dwell_slope, first_slope - slope_before]
        slow = ndtr(score(unloading_slope - 2.0 * dwell_slope))  # probability of slow relaxation
        relaxation_logs = np.log(fast_relaxation_fraction + (1.0 - fast_relaxation_fraction) * slow)
    lowest_score = np.min([score(contrast) for contrast in contrasts], axis=0)
    return log_ndtr(np.minimum(score(slope_after), lowest_score + slope_tolerance)), relaxation_logs


def _compute_change(start: float, stop: float, dwell: float) -> Floats:
    """Compute the changes of the columns of the design between two times since the corner."""
    design = _build_design(np.array([start, stop]), np.zeros(1), dwell)[0]
    return np.asarray(design[:, 1] - design[:, 0], dtype=np.float64)


def _estimate_noise(t: Floats, y: Floats, grid: _Grid, variance: float, dwell: float) -> float:
    """Estimate the long-run variance of the residuals of the most likely curve."""
    row, column = np.unravel_index(int(np.argmax(grid.log_likelihood)), grid.log_likelihood.shape)
    design = _build_design(t, grid.times[[row]], dwell)[0]
    residuals = y - grid.coefficients[row, column] @ design
    n_parameters = int(np.ceil(np.trace(grid.inverse[row, column] @ grid.gram[row])))
    noise = estimate_long_run_variance(residuals, n_parameters=n_parameters)
    return max(noise, 1e-18 * float(np.ptp(y)) ** 2) if np.isfinite(noise) else variance


def _average_corners(grid: _Grid, variance: float) -> Corner | None:
    """Average the corner over all times and roughnesses, weighted by the probability of each.

    Return None if the corner may be at the edge of the searched range, or if the force probably
    does not fall.
    """
    max_edge_probability, min_fall_probability = 0.05, 0.01
    weights = np.exp(grid.log_likelihood - grid.log_likelihood.max())
    weights /= weights.sum()
    probabilities = weights.sum(axis=1)
    fall_probability = np.sum(weights * np.exp(grid.fall_logs))
    edge_probability = probabilities[np.abs(grid.times) > 0.99 * _SEARCH_RANGE].sum()
    if edge_probability > max_edge_probability or fall_probability < min_fall_probability:
        return None
    values = grid.coefficients[..., 0]
    time, value = float(probabilities @ grid.times), float(np.sum(weights * values))
    value_variances = variance * grid.inverse[..., 0, 0] + (values - value) ** 2
    return Corner(
        time=time,
        time_error=float(np.sqrt(probabilities @ (grid.times - time) ** 2)),
        value=value,
        value_error=float(np.sqrt(np.sum(weights * value_variances))),
        n=0,
    )


def _compute_shape_fraction(t: Floats, grid: _Grid, dwell: float) -> float:
    """Compute the fraction of the variance of the corner time that noise does not cause.

    The curve is linearised with respect to the time of the corner at its most likely value. The
    variance of a smoother consists of the noise that it passes and of the signal that it removes.
    """
    row = int(np.argmax(np.logaddexp.reduce(grid.log_likelihood, axis=1)))
    weights = np.exp(grid.log_likelihood[row] - grid.log_likelihood[row].max())
    design = _build_design(t, grid.times[[row]], dwell)[0]
    total_variance = noise_variance = 0.0
    for index, weight in enumerate(weights.tolist()):
        slopes = _compute_slopes(t - grid.times[row], grid.coefficients[row, index], dwell)
        design_with_time = np.vstack([design, slopes])
        gram = design_with_time @ design_with_time.T
        penalty = np.full(len(gram), grid.precision[index])
        penalty[: grid.n_fixed] = penalty[-1] = 0.0
        inverse = np.linalg.inv(gram + np.diag(penalty))
        total_variance += weight * float(inverse[-1, -1])
        noise_variance += weight * float(inverse[-1] @ gram @ inverse[-1])
    return float(np.clip(1.0 - noise_variance / total_variance, 0.0, 1.0))


def _compute_slopes(u: Floats, c: Floats, dwell: float) -> Floats:
    """Compute the slope of the curve with coefficients `c` at the times `u` since the corner."""
    fall_time = u - dwell
    rise, fall = c[1] + 2.0 * c[3] * u, c[2] + 2.0 * c[4] * fall_time
    changes = c[_N_FIXED + (dwell > 0.0) :]  # changes of slope at the knots
    fall = fall + (fall_time[:, None] > _KNOTS) @ changes[: len(_KNOTS)]
    slopes: Floats = np.where(u < 0.0, rise, fall)
    if dwell > 0.0:
        relaxation = c[_N_FIXED] + (u[:, None] > _DWELL_KNOTS * dwell) @ changes[len(_KNOTS) :]
        slopes = np.where((u >= 0.0) & (fall_time < 0.0), relaxation, slopes)
    return slopes
