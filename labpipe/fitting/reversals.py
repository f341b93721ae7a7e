"""Reversals: where and how high a force turns when what follows the turn bends at once.

Strands that stick let a force fall steeply for a tenth of a second before they slide. A parabola
does not follow that, and a window short enough for one holds hardly a sample.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from labpipe.fitting.corners import Corner, block_means, fit_corner
from labpipe.fitting.noise import long_run_variance
from labpipe.fitting.normal import log_share_below
from labpipe.records.arrays import Floats

_BINS = 600
"""Samples on both sides together, at most twice that; longer records are averaged."""
_FIXED, _FALL = 5, 2
"""Height, slopes before and after, curvatures before and after; the slope after."""
_KNOTS = 2.0 ** (-0.5 * np.arange(1, 13))
"""Times since the corner, as shares of the window, at which the slope after it may change."""
_ROUGHNESS = 2.0 ** np.arange(-1.0, 10.0, 1.5)
"""Standard deviations of such a change that are averaged over, in standard errors of a slope."""
_PLACES = 25
_REACH = 0.5
"""Share of the window in which the corner is looked for."""
_FIRST = 0.15
"""Share of the window on each side of the parabolas' corner that is looked at first."""
_UNLIKELY = 8.0
"""Places are left out of the grid where the logarithm of the likelihood is less by this."""


@dataclass(frozen=True, slots=True, eq=False)
class _Grid:
    """Likelihood of every place and roughness; arrays of shape (places, roughness, ...).

    Parameters
    ----------
    places : shape (places,), of the corner, in windows from the first guess
    precision : shape (roughness,), noise variance over the variance of a change of slope
    likelihood : its logarithm
    gram, moments : shape (places, columns, columns) and (places, columns), of the design
    inverse : of the gram with the precision added, shape (places, roughness, columns, columns)
    curves : shape (places, roughness, columns), what the columns are weighted with
    """

    places: Floats
    precision: Floats
    likelihood: Floats
    gram: Floats
    moments: Floats
    inverse: Floats
    curves: Floats


@dataclass(frozen=True, slots=True)
class Reversal:
    """A corner, and how much of its error is no noise.

    Parameters
    ----------
    corner : as the likelihood has it
    shape_error : s, the part of the corner's error in time that comes from what the fall may hide
        below its noise; it is alike wherever the same specimen turns in the same way, and does not
        average out
    """

    corner: Corner
    shape_error: float


def fit_reversal(time: Floats, values: Floats, *, near: float, window: float) -> Reversal | None:
    """Find the corner between a smooth rise and a fall that may bend anywhere.

    Parameters
    ----------
    time, values : shape (n,), s and any unit; increasing time
    near : s, first guess of the corner
    window : s on each side of the guess; the corner is looked for in its inner half

    Returns
    -------
    The corner, or None where there are too few samples on one side, or where the corner cannot be
    told from one at the edge of the inner half.

    Notes
    -----
    y = v + a_1 min(u, 0) + a_2 min(u, 0)^2 + b_1 max(u, 0) + b_2 max(u, 0)^2
    + sum_k z_k max(u - s_k, 0) with u = t - c and s_k = window 2^(-k/2): a parabola before the
    corner, and after it one whose slope may change, as much in each halving of the time since the
    corner as in the next. z_k are normal with a common standard deviation, the roughness, which is
    averaged over with its marginal likelihood: a fall that is a parabola is fitted as one over the
    whole window, a fall that bends is fitted as closely as the noise allows, and what cannot be
    decided is in the errors. That is the smoothing spline as a Bayesian sees it, whose intervals
    cover also for fixed curves (Wahba, J. R. Stat. Soc. B 45 (1983) 133; Nychka, J. Am. Stat.
    Assoc. 83 (1988) 1134). The force falls from the corner on: likelihoods are weighted with the
    probability of b_1 < 0, since a corner too early with a rise behind it would do as well.
    The noise is the long-run variance of what the likeliest curve leaves.
    The corner of two parabolas (`fit_corner`) is where the search begins. NaN are left out.
    """
    chosen = (np.abs(time - near) <= window) & ~np.isnan(values)
    count = int(chosen.sum())
    t, y = block_means((time[chosen] - near) / window, values[chosen], count // _BINS)
    if min((t < -_REACH).sum(), (t > _REACH).sum()) < _FIXED or np.ptp(y) == 0.0:
        return None
    first = fit_corner(t, y, near=0.0, window=1.0, degree=2)
    start = 0.0 if first is None else float(np.clip(first.time, _FIRST - _REACH, _REACH - _FIRST))
    variance = _first_noise(y)
    grid = _searched(t, y, variance, start - _FIRST, start + _FIRST)
    for _ in range(2):
        last, variance = variance, _noise(t, y, grid, variance)
        if abs(variance - last) > 0.05 * last:
            grid = _searched(t, y, variance, float(grid.places[0]), float(grid.places[-1]))
    found = _corner(grid, variance)
    if found is None:
        return None
    shape_error = window * found.time_error * float(np.sqrt(_shape_share(t, grid)))
    at, error = near + window * found.time, window * found.time_error
    return Reversal(replace(found, time=at, time_error=error, n=count), shape_error)


def _first_noise(y: Floats) -> float:
    """Variance of white noise on a smooth signal, by the median of second differences."""
    level = float(np.median(np.abs(np.diff(y, 2)))) / (0.6745 * np.sqrt(6.0))
    return float(max(level, 1e-9 * float(np.ptp(y))) ** 2)


def _searched(t: Floats, y: Floats, variance: float, low: float, high: float) -> _Grid:
    """A grid of places that is as wide as the likelihood is; it begins from a first guess of it."""
    grid = _evaluated(t, y, np.linspace(low, high, _PLACES), variance)
    for _ in range(8):
        of_place = np.logaddexp.reduce(grid.likelihood, axis=1)
        likely = np.flatnonzero(of_place > of_place.max() - _UNLIKELY)
        first, last, width = int(likely[0]), int(likely[-1]), high - low
        is_open = (first == 0 and low > -_REACH) or (last == _PLACES - 1 and high < _REACH)
        if not is_open and last - first >= _PLACES // 3:
            break
        places = [low - 0.5 * width, *grid.places.tolist(), high + 0.5 * width]
        low, high = max(-_REACH, places[first]), min(_REACH, places[last + 2])
        grid = _evaluated(t, y, np.linspace(low, high, _PLACES), variance)
    return grid


def _design(t: Floats, places: Floats) -> Floats:
    """Columns of the curve for every place, shape (places, n, columns)."""
    since = t - places[:, None]
    before, after = np.minimum(since, 0.0), np.maximum(since, 0.0)
    smooth = [np.ones_like(since), before, after, before**2, after**2]
    return np.stack([*smooth, *(np.maximum(since - knot, 0.0) for knot in _KNOTS)], axis=-1)


def _evaluated(t: Floats, y: Floats, places: Floats, variance: float) -> _Grid:
    """Likelihood on the grid; what is fixed is fitted, what is random is integrated out."""
    design = _design(t, places)
    turned = design.transpose(0, 2, 1)
    gram, moments = turned @ design, turned @ y
    mixed = gram[:, :_FIXED, _FIXED:]
    right = np.concatenate([mixed, moments[:, :_FIXED, None]], axis=2)
    solved = np.linalg.solve(gram[:, :_FIXED, :_FIXED], right)
    bends = gram[:, _FIXED:, _FIXED:] - mixed.transpose(0, 2, 1) @ solved[..., :-1]
    pulls = moments[:, _FIXED:, None] - mixed.transpose(0, 2, 1) @ solved[..., -1:]
    left = float(y @ y) - np.sum(moments[:, :_FIXED] * solved[..., -1], axis=1)
    sizes, axes = np.linalg.eigh(bends)
    along = (axes.transpose(0, 2, 1) @ pulls)[..., 0] ** 2
    ratios = (_ROUGHNESS**2 * 24.0 / len(t))[:, None]
    spread = 1.0 + ratios * np.maximum(sizes, 0.0)[:, None, :]
    squares = left[:, None] - np.sum(ratios * along[:, None, :] / spread, axis=2)
    likelihood = -0.5 * (np.sum(np.log(spread), axis=2) + squares / variance)
    precision = 1.0 / ratios[:, 0]
    penalties = np.stack([_penalty(each) for each in precision.tolist()])
    inverse: Floats = np.asarray(np.linalg.inv(gram[:, None] + penalties), dtype=np.float64)
    curves = (inverse @ moments[:, None, :, None])[..., 0]
    errors = np.sqrt(variance * inverse[..., _FALL, _FALL])
    falls = log_share_below(-curves[..., _FALL] / errors)
    return _Grid(places, precision, likelihood + falls, gram, moments, inverse, curves)


def _noise(t: Floats, y: Floats, grid: _Grid, variance: float) -> float:
    """Long-run variance of what the likeliest curve leaves."""
    place, rough = np.unravel_index(int(np.argmax(grid.likelihood)), grid.likelihood.shape)
    left = y - _design(t, grid.places[[place]])[0] @ grid.curves[place, rough]
    spent = int(np.ceil(np.trace(grid.inverse[place, rough] @ grid.gram[place])))
    found = long_run_variance(left, parameters=spent)
    return max(found, 1e-18 * float(np.ptp(y)) ** 2) if np.isfinite(found) else variance


def _penalty(precision: float) -> Floats:
    return np.diag(np.append(np.zeros(_FIXED), np.full(len(_KNOTS), precision)))


def _corner(grid: _Grid, variance: float) -> Corner | None:
    """Mean and standard deviation over all places and roughnesses."""
    weights = np.exp(grid.likelihood - grid.likelihood.max())
    weights /= weights.sum()
    of_place = weights.sum(axis=1)
    at_edge = np.abs(grid.places) > 0.99 * _REACH
    if of_place[at_edge].sum() > 0.05:
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


def _shape_share(t: Floats, grid: _Grid) -> float:
    """Share of the variance of the corner's time that is left when there is no noise.

    The curve is taken for linear in the time at its likeliest place; the variance of a smoother is
    that of the noise that it lets through, and that of what it smooths away.
    """
    place = int(np.argmax(np.logaddexp.reduce(grid.likelihood, axis=1)))
    weights = np.exp(grid.likelihood[place] - grid.likelihood[place].max())
    design = _design(t, grid.places[[place]])[0]
    total = noise = 0.0
    for number, weight in enumerate(weights.tolist()):
        slopes = _slopes(t - grid.places[place], grid.curves[place, number])
        shifted = np.column_stack([design, slopes])
        gram = shifted.T @ shifted
        penalty = _penalty(float(grid.precision[number]))
        inverse = np.linalg.inv(gram + np.pad(penalty, (0, 1)))
        total += weight * float(inverse[-1, -1])
        noise += weight * float(inverse[-1] @ gram @ inverse[-1])
    return float(np.clip(1.0 - noise / total, 0.0, 1.0))


def _slopes(since: Floats, curve: Floats) -> Floats:
    """Slope of the curve at times since the corner."""
    before, after = curve[1] + 2.0 * curve[3] * since, curve[2] + 2.0 * curve[4] * since
    bent = (since[:, None] > _KNOTS) @ curve[_FIXED:]
    slopes: Floats = np.where(since < 0.0, before, after + bent)
    return slopes
