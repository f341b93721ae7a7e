"""Reversals: time and height of the turn of a force whose slope changes right after the turn.

Sticking strands let the force fall steeply for a tenth of a second before they slide. A parabola
does not follow that, and a window short enough for a parabola contains hardly any samples.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import log_ndtr, ndtr

from labpipe.records.arrays import Floats
from labpipe.signal.corners import Corner, average_pairs
from labpipe.uncertainty.autocorrelation import estimate_long_run_variance

_FIXED = 5
"""Columns: height, slopes before and after, curvatures before and after."""
_RISE = 1
_FALL = 2
_KNOTS = np.append(0.014 * np.arange(1, 9), 0.126 * 2.0 ** (np.arange(21) / 8.0))
"""Times since the corner, in windows, at which the slope may change: so dense that a sudden bend
between two of them is followed."""
_WAITING_KNOTS = 2.0 ** -np.arange(1.0, 7.0)
"""Times since the beginning of a wait, in waits, at which the slope may change."""
_ROUGHNESS = 2.0 ** np.arange(-1.0, 10.0, 1.5)
"""Standard deviations of a change of slope, in standard errors of a slope."""
_REACH = 0.5
"""Share of the window, on each side, in which the corner is searched."""


@dataclass(frozen=True, slots=True, eq=False)
class _Grid:
    """Likelihoods of all places and roughnesses; arrays of shape (places, roughness, ...).

    Parameters
    ----------
    places : shape (places,), of the corner, in windows from the first guess
    fixed : number of fixed columns
    precision : shape (roughness,), noise variance over the variance of a change of slope
    likelihood : its logarithm
    falls : shape (places, roughness), logarithm of the probability that the force falls there
    gram, moments : shape (places, columns, columns) and (places, columns), of the design
    inverse : of the gram with the precision added, shape (places, roughness, columns, columns)
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


@dataclass(frozen=True, slots=True)
class Reversal:
    """A corner, and the part of its error that is not noise.

    Parameters
    ----------
    corner : mean over the likelihood
    shape_error : s, the part of the corner's error in time from the unknown shape of the fall; it
        is equal at all similar turns of a specimen and does not average out
    """

    corner: Corner
    shape_error: float


def fit_reversal(
    time: Floats, values: Floats, *, near: float, window: float, dwell: float = 0.0
) -> Reversal | None:
    """Find the corner between a smooth rise and a fall that may bend anywhere.

    Parameters
    ----------
    time, values : shape (n,), s and any unit; increasing time
    near : s, first guess of the corner
    window : s on each side of the guess; the corner is searched in its inner half
    dwell : s, known waiting time of the machine between the end of the rise and the beginning of
        the fall; the window after the corner begins after it

    Returns
    -------
    The corner at the end of the rise; None where there are too few samples on one side, the corner
    cannot be distinguished from one at the edge of the inner half, or the force does not fall.

    Notes
    -----
    y = v + a_1 min(u, 0) + a_2 min(u, 0)^2 + b_1 max(u, 0) + b_2 max(u, 0)^2
    + sum_k z_k max(u - s_k, 0) with u = t - c: a parabola before the corner, and after it one
    whose slope may change at times s_k, as much in each halving of the time since the corner as in
    the next, evenly next to it. z_k are normal with a common standard deviation, the roughness,
    which is averaged over with its marginal likelihood: a fall that is a parabola is fitted as one
    over the whole window, a fall that bends is fitted as closely as the noise allows, and what
    cannot be decided is in the errors. This is the Bayesian smoothing spline, whose intervals also
    cover fixed curves (Wahba, J. R. Stat. Soc. B 45 (1983) 133; Nychka, J. Am.
    Stat. Assoc. 83 (1988) 1134). The force falls from the corner on, at first at
    least half as steeply as later: likelihoods are weighted with the probability of that, since an
    earlier corner followed by a rise or a flat top would fit as well.
    The noise is the long-run variance of the residuals of the likeliest curve.
    With a dwell D the fall begins at c + D, and w = max(u - D, 0) takes the place of max(u, 0). In
    between, q = min(max(u, 0), D), the force may relax, fast at first: c_1 q
    + sum_k x_k max(q - 2^-k D, 0), x_k distributed as z_k. Both corners share one time, so that
    they cannot be confused.
    NaN are ignored.
    """
    # On both sides together; at most twice that. Longer records are averaged.
    min_bins = 600
    # Share of the window.
    first_half_width = 0.15
    chosen = (time >= near - window) & (time <= near + window + dwell) & ~np.isnan(values)
    count, wait = int(chosen.sum()), dwell / window
    t, y = average_pairs((time[chosen] - near) / window, values[chosen], count // min_bins)
    if min((t < -_REACH).sum(), (t > wait + _REACH).sum()) < _FIXED or np.ptp(y) == 0.0:
        return None
    variance = _white_noise(y)
    grid = _refine_grid(t, y, variance, (-first_half_width, first_half_width), wait)
    for _ in range(2):
        last, variance = variance, _residual_noise(t, y, grid, variance, wait)
        if abs(variance - last) > 0.05 * last:
            ends = float(grid.places[0]), float(grid.places[-1])
            grid = _refine_grid(t, y, variance, ends, wait)
    corner = _mean_corner(grid, variance)
    if corner is None:
        return None
    shape_error = window * corner.time_error * float(np.sqrt(_shape_share(t, grid, wait)))
    corner_time, error = near + window * corner.time, window * corner.time_error
    return Reversal(replace(corner, time=corner_time, time_error=error, n=count), shape_error)


def _white_noise(y: Floats) -> float:
    """Return the variance of white noise on a smooth signal, from the median second difference.

    If the signal rarely leaves a quantisation step, from the mean square instead.
    """
    bends = np.diff(y, 2)
    level = float(np.median(np.abs(bends))) / (0.6745 * np.sqrt(6.0))
    if level <= 1e-9 * float(np.ptp(y)):
        level = float(np.sqrt(np.mean(bends**2) / 6.0))
    return float(max(level, 1e-9 * float(np.ptp(y))) ** 2)


def _refine_grid(
    t: Floats, y: Floats, variance: float, ends: tuple[float, float], wait: float
) -> _Grid:
    """Return a grid of places as wide as the likelihood, starting from a first guess."""
    n_places = 25
    max_log_likelihood_drop = 8.0
    low, high = ends
    grid = _evaluate_grid(t, y, np.linspace(low, high, n_places), variance, wait)
    for _ in range(8):
        of_place = np.logaddexp.reduce(grid.likelihood, axis=1)
        likely = np.flatnonzero(of_place > of_place.max() - max_log_likelihood_drop)
        first, last, width = int(likely[0]), int(likely[-1]), high - low
        is_open = (first == 0 and low > -_REACH) or (last == n_places - 1 and high < _REACH)
        if not is_open and last - first >= n_places // 3:
            break
        places = [low - 0.5 * width, *grid.places.tolist(), high + 0.5 * width]
        low, high = max(-_REACH, places[first]), min(_REACH, places[last + 2])
        grid = _evaluate_grid(t, y, np.linspace(low, high, n_places), variance, wait)
    return grid


def _design(t: Floats, places: Floats, wait: float) -> Floats:
    """Return the design for every place, shape (places, columns, n); fixed columns first."""
    since = t - places[:, None]
    before, after = np.minimum(since, 0.0), np.maximum(since - wait, 0.0)
    smooth = [np.ones_like(since), before, after, before**2, after**2]
    waited = np.clip(since, 0.0, wait)
    smooth += [waited] if wait > 0.0 else []
    knots, first = np.append(_KNOTS, _WAITING_KNOTS * wait), len(smooth) + len(_KNOTS)
    count = len(knots) if wait > 0.0 else len(_KNOTS)
    design = np.empty((len(places), len(smooth) + count, len(t)))
    for number, column in enumerate(smooth):
        design[:, number] = column
    design[:, len(smooth) : first] = after[:, None]
    design[:, first:] = waited[:, None]
    bends = design[:, len(smooth) :]
    np.maximum(bends - knots[:count, None], 0.0, out=bends)
    return design


def _evaluate_grid(t: Floats, y: Floats, places: Floats, variance: float, wait: float) -> _Grid:
    """Return the likelihoods on the grid; fixed terms are fitted, random ones integrated out."""
    design = _design(t, places, wait)
    fixed = _FIXED + (wait > 0.0)  # the slope during the wait
    gram, moments = design @ design.transpose(0, 2, 1), design @ y
    mixed = gram[:, :fixed, fixed:]
    right = np.concatenate([mixed, moments[:, :fixed, None]], axis=2)
    solved = np.linalg.solve(gram[:, :fixed, :fixed], right)
    bends = gram[:, fixed:, fixed:] - mixed.transpose(0, 2, 1) @ solved[..., :-1]
    pulls = moments[:, fixed:, None] - mixed.transpose(0, 2, 1) @ solved[..., -1:]
    residual_squares = float(y @ y) - np.sum(moments[:, :fixed] * solved[..., -1], axis=1)
    sizes, axes = np.linalg.eigh(bends)
    along = (axes.transpose(0, 2, 1) @ pulls)[..., 0] ** 2
    ratios = (_ROUGHNESS**2 * 24.0 / len(t))[:, None]
    spread = 1.0 + ratios * np.maximum(sizes, 0.0)[:, None, :]
    squares = residual_squares[:, None] - np.sum(ratios * along[:, None, :] / spread, axis=2)
    likelihood = -0.5 * (np.sum(np.log(spread), axis=2) + squares / variance)
    precision = 1.0 / ratios[:, 0]
    penalties = np.stack([_penalty(ratio, fixed, design.shape[1]) for ratio in precision.tolist()])
    inverse: Floats = np.asarray(np.linalg.inv(gram[:, None] + penalties), dtype=np.float64)
    curves = (inverse @ moments[:, None, :, None])[..., 0]
    falls, relaxation = _fall_weights(inverse, curves, variance, wait)
    likelihood += falls + relaxation
    return _Grid(places, fixed, precision, likelihood, falls, gram, moments, inverse, curves)


def _fall_weights(
    inverse: Floats, curves: Floats, variance: float, wait: float
) -> tuple[Floats, Floats]:
    """Return the log probability that the force falls after the corner, steeply at first.

    If the machine waits, the slope must also decrease where it stops and where it restarts. The
    second array is that of falling there twice as fast as during the wait, which is usual.
    """
    # Windows after the corner.
    compared_spans = (0.12, 0.25)
    # Share of the fall that is its beginning, and its least slope relative to the whole.
    early_share, min_early_slope = 0.25, 0.5
    # Windows after a wait.
    after_wait_span = 0.06
    # Standard errors by which the beginning of a fall may be too flat.
    slope_tolerance = 2.0
    # Share of waits in which the force relaxes as fast as it falls in unloading.
    fast_relaxation_share = 0.001
    columns = curves.shape[-1]

    def score(contrast: Floats) -> Floats:
        error = np.sqrt(variance * ((inverse @ contrast) @ contrast))
        return np.asarray(-(curves @ contrast) / error, dtype=np.float64)

    rises, falls = np.eye(columns)[[_RISE, _FALL]]
    contrasts = []
    for place in compared_spans:
        early, late = (_fall_change(share * place, columns, wait) for share in (early_share, 1.0))
        contrasts.append(early - min_early_slope * early_share * late)
    relaxation = np.zeros(curves.shape[:-1])
    if wait > 0.0:
        first, half, full = (_wait_change(part * wait, columns, wait) for part in (0.25, 0.5, 1.0))
        back = _fall_change(after_wait_span, columns, wait) / after_wait_span
        waiting = (full - half) / (0.5 * wait)
        contrasts += [back - waiting, first / (0.25 * wait) - rises]
        is_slower = ndtr(score(back - 2.0 * waiting))
        relaxation = np.log(fast_relaxation_share + (1.0 - fast_relaxation_share) * is_slower)
    lowest = np.min([score(contrast) for contrast in contrasts], axis=0)
    weakest = np.minimum(score(falls), lowest + slope_tolerance)
    return log_ndtr(weakest), relaxation


def _fall_change(since: float, columns: int, wait: float) -> Floats:
    """Return the change of the columns until a time after the beginning of the fall."""
    change = np.zeros(columns)
    change[_FALL], change[_FALL + 2] = since, since**2
    bends = _FIXED + (wait > 0.0)
    change[bends : bends + len(_KNOTS)] = np.maximum(since - _KNOTS, 0.0)
    return change


def _wait_change(since: float, columns: int, wait: float) -> Floats:
    """Return the change of the columns until a time after the beginning of a wait."""
    change = np.zeros(columns)
    change[_FIXED] = since
    change[-len(_WAITING_KNOTS) :] = np.maximum(since - _WAITING_KNOTS * wait, 0.0)
    return change


def _residual_noise(t: Floats, y: Floats, grid: _Grid, variance: float, wait: float) -> float:
    """Return the long-run variance of the residuals of the likeliest curve."""
    place, rough = np.unravel_index(int(np.argmax(grid.likelihood)), grid.likelihood.shape)
    residuals = y - grid.curves[place, rough] @ _design(t, grid.places[[place]], wait)[0]
    spent = int(np.ceil(np.trace(grid.inverse[place, rough] @ grid.gram[place])))
    noise = estimate_long_run_variance(residuals, parameters=spent)
    return max(noise, 1e-18 * float(np.ptp(y)) ** 2) if np.isfinite(noise) else variance


def _penalty(precision: float, fixed: int, columns: int) -> Floats:
    return np.diag(np.where(np.arange(columns) < fixed, 0.0, precision))


def _mean_corner(grid: _Grid, variance: float) -> Corner | None:
    """Return mean and standard deviation over all places and roughnesses."""
    min_probability = 0.01
    weights = np.exp(grid.likelihood - grid.likelihood.max())
    weights /= weights.sum()
    of_place = weights.sum(axis=1)
    at_edge = np.abs(grid.places) > 0.99 * _REACH
    if of_place[at_edge].sum() > 0.05 or np.sum(weights * np.exp(grid.falls)) < min_probability:
        return None
    heights = grid.curves[..., 0]
    time, height = float(of_place @ grid.places), float(np.sum(weights * heights))
    scatter = variance * grid.inverse[..., 0, 0] + (heights - height) ** 2
    return Corner(
        time=time,
        time_error=float(np.sqrt(of_place @ (grid.places - time) ** 2)),
        value=height,
        value_error=float(np.sqrt(np.sum(weights * scatter))),
        n=0,
    )


def _shape_share(t: Floats, grid: _Grid, wait: float) -> float:
    """Return the share of the variance of the corner's time that remains without noise.

    The curve is linearised in time at its likeliest place; the variance of a smoother consists of
    the noise it passes and the signal it removes.
    """
    place = int(np.argmax(np.logaddexp.reduce(grid.likelihood, axis=1)))
    weights = np.exp(grid.likelihood[place] - grid.likelihood[place].max())
    design = _design(t, grid.places[[place]], wait)[0]
    total = noise = 0.0
    for number, weight in enumerate(weights.tolist()):
        slopes = _slopes(t - grid.places[place], grid.curves[place, number], wait)
        shifted = np.vstack([design, slopes])
        gram = shifted @ shifted.T
        penalty = _penalty(float(grid.precision[number]), grid.fixed, len(gram) - 1)
        inverse = np.linalg.inv(gram + np.pad(penalty, (0, 1)))
        total += weight * float(inverse[-1, -1])
        noise += weight * float(inverse[-1] @ gram @ inverse[-1])
    return float(np.clip(1.0 - noise / total, 0.0, 1.0))


def _slopes(since: Floats, curve: Floats, wait: float) -> Floats:
    """Return the slope of the curve at times since the corner."""
    fallen = since - wait
    before, after = curve[1] + 2.0 * curve[3] * since, curve[2] + 2.0 * curve[4] * fallen
    bends = curve[_FIXED + (wait > 0.0) :]
    after = after + (fallen[:, None] > _KNOTS) @ bends[: len(_KNOTS)]
    slopes: Floats = np.where(since < 0.0, before, after)
    if wait > 0.0:
        waiting = curve[_FIXED] + (since[:, None] > _WAITING_KNOTS * wait) @ bends[len(_KNOTS) :]
        slopes = np.where((since >= 0.0) & (fallen < 0.0), waiting, slopes)
    return slopes
