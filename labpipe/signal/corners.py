"""Find time and height of a corner of a signal, or of the turn of a force.

A corner has straight lines on both sides. A force turns at first into a steep fall, until strands
slide. The steep fall lasts a tenth of a second. A parabola over a longer window does not follow it,
and a shorter window contains hardly any samples.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import log_ndtr, ndtr

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
    shape_error : s, part of the error in time of a reversal from the unknown shape of the fall; it
        is equal at all similar turns of a specimen and does not average out
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


_N_FIXED = 5
"""Fixed columns: height, slopes before and after, curvatures before and after."""
_SLOPE_BEFORE, _SLOPE_AFTER = 1, 2
"""Indices of the columns of the slopes."""
_KNOTS = np.append(0.014 * np.arange(1, 9), 0.126 * 2.0 ** (np.arange(21) / 8.0))
"""Times since the beginning of the fall, in windows, at which the slope may change; dense enough to
follow a sudden change between two of them."""
_DWELL_KNOTS = 2.0 ** -np.arange(1.0, 7.0)
"""Times since the beginning of the dwell, as shares of it, at which the slope may change."""
_ROUGHNESSES = 2.0 ** np.arange(-1.0, 10.0, 1.5)
"""Standard deviations of a change of slope, in standard errors of a slope."""
_SEARCHED_SHARE = 0.5
"""Share of the window, on each side, in which the corner is searched."""


@dataclass(frozen=True, slots=True, eq=False)
class _Grid:
    """Likelihoods of the corner at each place for each roughness.

    Parameters
    ----------
    places : shape (places,), times of the corner, in windows from the first guess
    fixed : number of fixed columns
    precision : shape (roughness,), variance of the noise over that of a change of slope
    likelihood : shape (places, roughness), log likelihood
    falls : shape (places, roughness), log probability that the force falls after the corner
    gram, moments : shape (places, columns, columns) and (places, columns), of the design
    inverse : shape (places, roughness, columns, columns), of `gram` plus the precision
    curves : shape (places, roughness, columns), coefficients
    """

    places: Floats
    fixed: int
    precision: Floats
    likelihood: Floats
    falls: Floats
    gram: Floats
    moments: Floats
    inverse: Floats
    curves: Floats


def fit_reversal(
    time: Floats, values: Floats, *, guess: float, window: float, dwell: float = 0.0
) -> Corner | None:
    """Find the corner between a smooth rise and a fall with a slope that may change anywhere.

    Parameters
    ----------
    time, values : shape (n,), s and any unit; increasing time
    guess : s, first guess of the corner
    window : s on each side of the guess; the corner is searched in its inner half
    dwell : s, known dwell of the machine between the rise and the fall; the window after the corner
        begins after it

    Returns
    -------
    The corner at the end of the rise; None if there are too few samples on one side, if the corner
    may be at the edge of the inner half, or if the force does not fall.

    Notes
    -----
    y = v + a_1 min(u, 0) + a_2 min(u, 0)^2 + b_1 max(u, 0) + b_2 max(u, 0)^2
    + sum_k z_k max(u - s_k, 0) with u = t - c: a parabola before the corner, and after it a
    parabola whose slope may change at times s_k. These are even next to the corner, then at equal
    ratios. z_k are normal with a common standard deviation, the roughness, which is averaged with
    its marginal likelihood: a parabolic fall is fitted as a parabola over the whole window, any
    other fall as closely as the noise allows, and the errors include the uncertain choice. This is
    the Bayesian smoothing spline, whose intervals also cover fixed curves (Wahba, J. R. Stat. Soc.
    B 45 (1983) 133; Nychka, J. Am. Stat. Assoc. 83 (1988) 1134).

    The force falls after the corner, at first at least half as steeply as later. Likelihoods are
    weighted by the probability of that, since an earlier corner followed by a rise or a flat top
    would fit as well. The noise is the long-run variance of the residuals of the likeliest curve.

    With a dwell D the fall begins at c + D, and w = max(u - D, 0) replaces max(u, 0). During the
    dwell, q = min(max(u, 0), D), the force may relax, fast at first: c_1 q
    + sum_k x_k max(q - 2^-k D, 0), x_k distributed as z_k. NaN are ignored.
    """
    min_bins = 600  # on both sides together; longer records are averaged in up to twice as many
    first_half_width = 0.15  # in windows
    is_used = (time >= guess - window) & (time <= guess + window + dwell) & ~np.isnan(values)
    count, relative_dwell = int(is_used.sum()), dwell / window
    t, y = average_pairs((time[is_used] - guess) / window, values[is_used], count // min_bins)
    n_before, n_after = (t < -_SEARCHED_SHARE).sum(), (t > relative_dwell + _SEARCHED_SHARE).sum()
    if min(n_before, n_after) < _N_FIXED or np.ptp(y) == 0.0:
        return None
    variance = _white_noise(y)
    grid = _refine_grid(t, y, variance, (-first_half_width, first_half_width), relative_dwell)
    for _ in range(2):
        previous_variance = variance
        variance = _residual_noise(t, y, grid, variance, relative_dwell)
        if abs(variance - previous_variance) > 0.05 * previous_variance:
            ends = float(grid.places[0]), float(grid.places[-1])
            grid = _refine_grid(t, y, variance, ends, relative_dwell)
    corner = _mean_corner(grid, variance)
    if corner is None:
        return None
    shape_error = window * corner.time_error * float(np.sqrt(_shape_share(t, grid, relative_dwell)))
    corner_time, error = guess + window * corner.time, window * corner.time_error
    return replace(corner, time=corner_time, time_error=error, n=count, shape_error=shape_error)


def _white_noise(y: Floats) -> float:
    """Return the variance of white noise on a smooth signal, from the median second difference.

    If most second differences are zero, as with coarse quantisation, their mean square is used.
    """
    second = np.diff(y, 2)
    level = float(np.median(np.abs(second))) / (0.6745 * np.sqrt(6.0))
    if level <= 1e-9 * float(np.ptp(y)):
        level = float(np.sqrt(np.mean(second**2) / 6.0))
    return float(max(level, 1e-9 * float(np.ptp(y))) ** 2)


def _refine_grid(
    t: Floats, y: Floats, variance: float, ends: tuple[float, float], wait: float
) -> _Grid:
    """Return a grid that covers the likely places, from a first guess of its ends."""
    n_places = 25
    max_log_likelihood_drop = 8.0
    low, high = ends
    grid = _evaluate_grid(t, y, np.linspace(low, high, n_places), variance, wait)
    for _ in range(8):
        by_place = np.logaddexp.reduce(grid.likelihood, axis=1)
        likely_places = np.flatnonzero(by_place > by_place.max() - max_log_likelihood_drop)
        first_row, last_row, width = int(likely_places[0]), int(likely_places[-1]), high - low
        is_open_below = first_row == 0 and low > -_SEARCHED_SHARE
        is_open_above = last_row == n_places - 1 and high < _SEARCHED_SHARE
        if not (is_open_below or is_open_above) and last_row - first_row >= n_places // 3:
            break
        places = [low - 0.5 * width, *grid.places.tolist(), high + 0.5 * width]
        low = max(-_SEARCHED_SHARE, places[first_row])
        high = min(_SEARCHED_SHARE, places[last_row + 2])
        grid = _evaluate_grid(t, y, np.linspace(low, high, n_places), variance, wait)
    return grid


def _design(t: Floats, places: Floats, wait: float) -> Floats:
    """Return the design for every place, shape (places, columns, n); fixed columns first."""
    since = t - places[:, None]
    rising, falling = np.minimum(since, 0.0), np.maximum(since - wait, 0.0)
    smooth = [np.ones_like(since), rising, falling, rising**2, falling**2]
    waited = np.clip(since, 0.0, wait)
    smooth += [waited] if wait > 0.0 else []
    knots, first = np.append(_KNOTS, _DWELL_KNOTS * wait), len(smooth) + len(_KNOTS)
    count = len(knots) if wait > 0.0 else len(_KNOTS)
    design = np.empty((len(places), len(smooth) + count, len(t)))
    for number, column in enumerate(smooth):
        design[:, number] = column
    design[:, len(smooth) : first] = falling[:, None]
    design[:, first:] = waited[:, None]
    bends = design[:, len(smooth) :]
    np.maximum(bends - knots[:count, None], 0.0, out=bends)
    return design


def _evaluate_grid(t: Floats, y: Floats, places: Floats, variance: float, wait: float) -> _Grid:
    """Compute the likelihoods; fixed columns are fitted, random ones integrated out."""
    design = _design(t, places, wait)
    fixed = _N_FIXED + (wait > 0.0)  # with the slope during the dwell
    gram, moments = design @ design.transpose(0, 2, 1), design @ y
    mixed = gram[:, :fixed, fixed:]
    right = np.concatenate([mixed, moments[:, :fixed, None]], axis=2)
    solved = np.linalg.solve(gram[:, :fixed, :fixed], right)
    bends = gram[:, fixed:, fixed:] - mixed.transpose(0, 2, 1) @ solved[..., :-1]
    pulls = moments[:, fixed:, None] - mixed.transpose(0, 2, 1) @ solved[..., -1:]
    residual_squares = float(y @ y) - np.sum(moments[:, :fixed] * solved[..., -1], axis=1)
    sizes, axes = np.linalg.eigh(bends)
    along = (axes.transpose(0, 2, 1) @ pulls)[..., 0] ** 2
    ratios = (_ROUGHNESSES**2 * 24.0 / len(t))[:, None]
    spread = 1.0 + ratios * np.maximum(sizes, 0.0)[:, None, :]
    squares = residual_squares[:, None] - np.sum(ratios * along[:, None, :] / spread, axis=2)
    likelihood = -0.5 * (np.sum(np.log(spread), axis=2) + squares / variance)
    precision = 1.0 / ratios[:, 0]
    # The inverse of `gram` plus the precision, along the axes of the bends.
    identity = np.broadcast_to(np.eye(bends.shape[1]), bends.shape)
    along_axes = (np.concatenate([-solved[..., :-1], identity], axis=1) @ axes)[:, None]
    stiffness = np.maximum(sizes, 0.0)[:, None, None, :] + precision[:, None, None]
    inverse: Floats = (along_axes / stiffness) @ along_axes.transpose(0, 1, 3, 2)
    inverse[..., :fixed, :fixed] += np.linalg.inv(gram[:, None, :fixed, :fixed])
    curves = (inverse @ moments[:, None, :, None])[..., 0]
    falls, relaxation = _fall_weights(inverse, curves, variance, wait)
    likelihood += falls + relaxation
    return _Grid(places, fixed, precision, likelihood, falls, gram, moments, inverse, curves)


def _fall_weights(
    inverse: Floats, curves: Floats, variance: float, wait: float
) -> tuple[Floats, Floats]:
    """Return the log probability that the force falls after the corner, steeply at first.

    With a dwell, the slope must also decrease at its beginning and at its end. The second array is
    the log probability that the force falls at least twice as fast after the dwell as during it, as
    usual; 0 without a dwell.
    """
    compared_spans = (0.12, 0.25)  # windows after the corner
    # Share of the span that counts as the beginning of the fall, and the minimum ratio of the slope
    # in it to the mean slope.
    early_share, min_early_slope = 0.25, 0.5
    after_wait_span = 0.06  # windows after the dwell
    # Standard errors by which the beginning of a fall may be too flat.
    slope_tolerance = 2.0
    # Share of dwells in which the force relaxes as fast as it falls in unloading.
    fast_relaxation_share = 0.001
    columns = curves.shape[-1]

    def score(contrast: Floats) -> Floats:
        error = np.sqrt(variance * ((inverse @ contrast) @ contrast))
        return np.asarray(-(curves @ contrast) / error, dtype=np.float64)

    rises, falls = np.eye(columns)[[_SLOPE_BEFORE, _SLOPE_AFTER]]
    contrasts = []
    for span in compared_spans:
        early, late = (_change(wait, wait + share * span, wait) for share in (early_share, 1.0))
        contrasts.append(early - min_early_slope * early_share * late)
    relaxation = np.zeros(curves.shape[:-1])
    if wait > 0.0:
        unloading_slope = _change(wait, wait + after_wait_span, wait) / after_wait_span
        waiting = _change(0.5 * wait, wait, wait) / (0.5 * wait)
        first_slope = _change(0.0, 0.25 * wait, wait) / (0.25 * wait)
        contrasts += [unloading_slope - waiting, first_slope - rises]
        is_slower = ndtr(score(unloading_slope - 2.0 * waiting))
        relaxation = np.log(fast_relaxation_share + (1.0 - fast_relaxation_share) * is_slower)
    lowest = np.min([score(contrast) for contrast in contrasts], axis=0)
    weakest = np.minimum(score(falls), lowest + slope_tolerance)
    return log_ndtr(weakest), relaxation


def _change(start: float, stop: float, wait: float) -> Floats:
    """Return the change of the columns between two times since the corner."""
    design = _design(np.array([start, stop]), np.zeros(1), wait)[0]
    return np.asarray(design[:, 1] - design[:, 0], dtype=np.float64)


def _residual_noise(t: Floats, y: Floats, grid: _Grid, variance: float, wait: float) -> float:
    """Return the long-run variance of the residuals of the likeliest curve."""
    place, roughness = np.unravel_index(int(np.argmax(grid.likelihood)), grid.likelihood.shape)
    residuals = y - grid.curves[place, roughness] @ _design(t, grid.places[[place]], wait)[0]
    spent = int(np.ceil(np.trace(grid.inverse[place, roughness] @ grid.gram[place])))
    noise = estimate_long_run_variance(residuals, parameters=spent)
    return max(noise, 1e-18 * float(np.ptp(y)) ** 2) if np.isfinite(noise) else variance


def _mean_corner(grid: _Grid, variance: float) -> Corner | None:
    """Return the mean corner over all places and roughnesses.

    None if it may be at the edge of the searched range, or if the force probably does not fall.
    """
    min_probability = 0.01
    weights = np.exp(grid.likelihood - grid.likelihood.max())
    weights /= weights.sum()
    by_place = weights.sum(axis=1)
    at_edge = np.abs(grid.places) > 0.99 * _SEARCHED_SHARE
    if by_place[at_edge].sum() > 0.05 or np.sum(weights * np.exp(grid.falls)) < min_probability:
        return None
    heights = grid.curves[..., 0]
    time, height = float(by_place @ grid.places), float(np.sum(weights * heights))
    scatter = variance * grid.inverse[..., 0, 0] + (heights - height) ** 2
    return Corner(
        time=time,
        time_error=float(np.sqrt(by_place @ (grid.places - time) ** 2)),
        value=height,
        value_error=float(np.sqrt(np.sum(weights * scatter))),
        n=0,
    )


def _shape_share(t: Floats, grid: _Grid, wait: float) -> float:
    """Return the share of the variance of the time of the corner that is not from noise.

    The curve is linearised in time at its likeliest place. The variance of a smoother consists of
    the noise that it passes and the signal that it removes.
    """
    place = int(np.argmax(np.logaddexp.reduce(grid.likelihood, axis=1)))
    weights = np.exp(grid.likelihood[place] - grid.likelihood[place].max())
    design = _design(t, grid.places[[place]], wait)[0]
    total = noise = 0.0
    for number, weight in enumerate(weights.tolist()):
        slopes = _slopes(t - grid.places[place], grid.curves[place, number], wait)
        shifted = np.vstack([design, slopes])
        gram = shifted @ shifted.T
        penalty = np.full(len(gram), grid.precision[number])
        penalty[: grid.fixed] = penalty[-1] = 0.0
        inverse = np.linalg.inv(gram + np.diag(penalty))
        total += weight * float(inverse[-1, -1])
        noise += weight * float(inverse[-1] @ gram @ inverse[-1])
    return float(np.clip(1.0 - noise / total, 0.0, 1.0))


def _slopes(since: Floats, curve: Floats, wait: float) -> Floats:
    """Return the slope of a curve with the coefficients `curve` at times since the corner."""
    fallen = since - wait
    rise, fall = curve[1] + 2.0 * curve[3] * since, curve[2] + 2.0 * curve[4] * fallen
    bends = curve[_N_FIXED + (wait > 0.0) :]
    fall = fall + (fallen[:, None] > _KNOTS) @ bends[: len(_KNOTS)]
    slopes: Floats = np.where(since < 0.0, rise, fall)
    if wait > 0.0:
        waiting = curve[_N_FIXED] + (since[:, None] > _DWELL_KNOTS * wait) @ bends[len(_KNOTS) :]
        slopes = np.where((since >= 0.0) & (fallen < 0.0), waiting, slopes)
    return slopes
