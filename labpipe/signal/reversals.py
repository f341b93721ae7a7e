"""Reversals: where and how high a force turns when what follows the turn bends at once.

Strands that stick let a force fall steeply for a tenth of a second before they slide. A parabola
does not follow that, and a window short enough for one holds hardly a sample.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import log_ndtr, ndtr

from labpipe.records.arrays import Floats
from labpipe.signal.corners import Corner, block_means
from labpipe.uncertainty.autocorrelation import long_run_variance

_BINS = 600
"""Samples on both sides together, at most twice that; longer records are averaged."""
_FIXED, _RISE, _FALL = 5, 1, 2
"""Height, slopes before and after, curvatures before and after; where the slopes are."""
_KNOTS = np.append(0.014 * np.arange(1, 9), 0.126 * 2.0 ** (np.arange(21) / 8.0))
"""Times since the corner, as shares of the window, at which the slope after it may change: so near
to each other that a sudden bend between two of them is followed as well."""
_ON_THE_WAY = (0.12, 0.25)
"""Windows after the corner up to which the beginning of a fall is compared with the whole."""
_EARLY, _STEEP = 0.25, 0.5
"""Share of the way that is the beginning, and how steep that is at least against the whole."""
_BACK = 0.06
"""Windows after a wait over which the beginning of the fall is compared with the wait."""
_SLIGHTLY = 2.0
"""Standard errors by which the beginning of a fall may be less steep than that without harm."""
_SURE = 0.01
"""Probability that the force falls behind its corner, below which there is none."""
_ODD = 0.001
"""Share of waits in which a force loses as fast as in going back."""
_WAITING_KNOTS = 2.0 ** -np.arange(1.0, 7.0)
"""Times since the beginning of a wait, as shares of it, at which the slope may change."""
_ROUGHNESS = 2.0 ** np.arange(-1.0, 10.0, 1.5)
"""Standard deviations of such a change that are averaged over, in standard errors of a slope."""
_PLACES = 25
_REACH = 0.5
"""Share of the window in which the corner is looked for."""
_FIRST = 0.15
"""Share of the window on each side of the guess that is looked at first."""
_UNLIKELY = 8.0
"""Places are left out of the grid where the logarithm of the likelihood is less by this."""


@dataclass(frozen=True, slots=True, eq=False)
class _Grid:
    """Likelihood of every place and roughness; arrays of shape (places, roughness, ...).

    Parameters
    ----------
    places : shape (places,), of the corner, in windows from the first guess
    fixed : number of columns that are fixed
    precision : shape (roughness,), noise variance over the variance of a change of slope
    likelihood : its logarithm
    falls : shape (places, roughness), logarithm of the probability that the force falls there
    gram, moments : shape (places, columns, columns) and (places, columns), of the design
    inverse : of the gram with the precision added, shape (places, roughness, columns, columns)
    curves : shape (places, roughness, columns), what the columns are weighted with
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


def fit_reversal(
    time: Floats, values: Floats, *, near: float, window: float, dwell: float = 0.0
) -> Reversal | None:
    """Find the corner between a smooth rise and a fall that may bend anywhere.

    Parameters
    ----------
    time, values : shape (n,), s and any unit; increasing time
    near : s, first guess of the corner
    window : s on each side of the guess; the corner is looked for in its inner half
    dwell : s, known, that the machine waits between the end of the rise and the beginning of the
        fall; the window after the corner begins behind it

    Returns
    -------
    The corner, that at the end of the rise, or None where there are too few samples on one side, or
    where the corner cannot be told from one at the edge of the inner half, or the force does not
    fall.

    Notes
    -----
    y = v + a_1 min(u, 0) + a_2 min(u, 0)^2 + b_1 max(u, 0) + b_2 max(u, 0)^2
    + sum_k z_k max(u - s_k, 0) with u = t - c: a parabola before the corner, and after it one
    whose slope may change at times s_k, as much in each halving of the time since the corner as in
    the next, evenly next to it. z_k are normal with a common standard deviation, the roughness,
    which is averaged over with its marginal likelihood: a fall that is a parabola is fitted as one
    over the whole window, a fall that bends is fitted as closely as the noise allows, and what
    cannot be decided is in the errors. That is the smoothing spline as a Bayesian sees it, whose
    intervals cover also for fixed curves (Wahba, J. R. Stat. Soc. B 45 (1983) 133; Nychka, J. Am.
    Stat. Assoc. 83 (1988) 1134). The force falls from the corner on, and begins at least half as
    steeply as it goes on: likelihoods are weighted with the probability of that, since a corner too
    early with a rise behind it, or with a flat top, would do as well.
    The noise is the long-run variance of what the likeliest curve leaves.
    With a dwell D the fall begins at c + D, and w = max(u - D, 0) takes the place of max(u, 0). In
    between, q = min(max(u, 0), D), the force may relax, fast at first: c_1 q
    + sum_k x_k max(q - 2^-k D, 0), x_k as random as z_k. So both corners have one time, and none
    can be taken for the other.
    NaN are left out.
    """
    chosen = (time >= near - window) & (time <= near + window + dwell) & ~np.isnan(values)
    count, wait = int(chosen.sum()), dwell / window
    t, y = block_means((time[chosen] - near) / window, values[chosen], count // _BINS)
    if min((t < -_REACH).sum(), (t > wait + _REACH).sum()) < _FIXED or np.ptp(y) == 0.0:
        return None
    variance = _first_noise(y)
    grid = _searched(t, y, variance, (-_FIRST, _FIRST), wait)
    for _ in range(2):
        last, variance = variance, _noise(t, y, grid, variance, wait)
        if abs(variance - last) > 0.05 * last:
            ends = float(grid.places[0]), float(grid.places[-1])
            grid = _searched(t, y, variance, ends, wait)
    found = _corner(grid, variance)
    if found is None:
        return None
    shape_error = window * found.time_error * float(np.sqrt(_shape_share(t, grid, wait)))
    at, error = near + window * found.time, window * found.time_error
    return Reversal(replace(found, time=at, time_error=error, n=count), shape_error)


def _first_noise(y: Floats) -> float:
    """Variance of white noise on a smooth signal, by the median of second differences.

    Of a signal that hardly ever leaves a step of its converter by their mean square.
    """
    bends = np.diff(y, 2)
    level = float(np.median(np.abs(bends))) / (0.6745 * np.sqrt(6.0))
    if level <= 1e-9 * float(np.ptp(y)):
        level = float(np.sqrt(np.mean(bends**2) / 6.0))
    return float(max(level, 1e-9 * float(np.ptp(y))) ** 2)


def _searched(
    t: Floats, y: Floats, variance: float, ends: tuple[float, float], wait: float
) -> _Grid:
    """A grid of places that is as wide as the likelihood is; it begins from a first guess of it."""
    low, high = ends
    grid = _evaluated(t, y, np.linspace(low, high, _PLACES), variance, wait)
    for _ in range(8):
        of_place = np.logaddexp.reduce(grid.likelihood, axis=1)
        likely = np.flatnonzero(of_place > of_place.max() - _UNLIKELY)
        first, last, width = int(likely[0]), int(likely[-1]), high - low
        is_open = (first == 0 and low > -_REACH) or (last == _PLACES - 1 and high < _REACH)
        if not is_open and last - first >= _PLACES // 3:
            break
        places = [low - 0.5 * width, *grid.places.tolist(), high + 0.5 * width]
        low, high = max(-_REACH, places[first]), min(_REACH, places[last + 2])
        grid = _evaluated(t, y, np.linspace(low, high, _PLACES), variance, wait)
    return grid


def _design(t: Floats, places: Floats, wait: float) -> Floats:
    """Columns of the curve for every place, shape (places, columns, n); first the fixed ones."""
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


def _evaluated(t: Floats, y: Floats, places: Floats, variance: float, wait: float) -> _Grid:
    """Likelihood on the grid; what is fixed is fitted, what is random is integrated out."""
    design = _design(t, places, wait)
    fixed = _FIXED + (wait > 0.0)  # the slope while it waits
    gram, moments = design @ design.transpose(0, 2, 1), design @ y
    mixed = gram[:, :fixed, fixed:]
    right = np.concatenate([mixed, moments[:, :fixed, None]], axis=2)
    solved = np.linalg.solve(gram[:, :fixed, :fixed], right)
    bends = gram[:, fixed:, fixed:] - mixed.transpose(0, 2, 1) @ solved[..., :-1]
    pulls = moments[:, fixed:, None] - mixed.transpose(0, 2, 1) @ solved[..., -1:]
    left = float(y @ y) - np.sum(moments[:, :fixed] * solved[..., -1], axis=1)
    sizes, axes = np.linalg.eigh(bends)
    along = (axes.transpose(0, 2, 1) @ pulls)[..., 0] ** 2
    ratios = (_ROUGHNESS**2 * 24.0 / len(t))[:, None]
    spread = 1.0 + ratios * np.maximum(sizes, 0.0)[:, None, :]
    squares = left[:, None] - np.sum(ratios * along[:, None, :] / spread, axis=2)
    likelihood = -0.5 * (np.sum(np.log(spread), axis=2) + squares / variance)
    precision = 1.0 / ratios[:, 0]
    penalties = np.stack([_penalty(each, fixed, design.shape[1]) for each in precision.tolist()])
    inverse: Floats = np.asarray(np.linalg.inv(gram[:, None] + penalties), dtype=np.float64)
    curves = (inverse @ moments[:, None, :, None])[..., 0]
    falls, odd = _falls(inverse, curves, variance, wait)
    likelihood += falls + odd
    return _Grid(places, fixed, precision, likelihood, falls, gram, moments, inverse, curves)


def _falls(inverse: Floats, curves: Floats, variance: float, wait: float) -> tuple[Floats, Floats]:
    """Logarithm of the probability that the force falls after the corner, steeply at first.

    Of a machine that waits as well that the slope drops where it stops, and where it goes on. The
    second is that of falling twice as fast there as while the machine waits, which is usual.
    """
    columns = curves.shape[-1]

    def sure(that_falls: Floats) -> Floats:
        error = np.sqrt(variance * ((inverse @ that_falls) @ that_falls))
        return np.asarray(-(curves @ that_falls) / error, dtype=np.float64)

    rises, falls = np.eye(columns)[[_RISE, _FALL]]
    tried = []
    for place in _ON_THE_WAY:
        early, late = (_fallen(share * place, columns, wait) for share in (_EARLY, 1.0))
        tried.append(early - _STEEP * _EARLY * late)
    usual = np.zeros(curves.shape[:-1])
    if wait > 0.0:
        first, half, whole = (_waited(share * wait, columns, wait) for share in (0.25, 0.5, 1.0))
        back = _fallen(_BACK, columns, wait) / _BACK
        waiting = (whole - half) / (0.5 * wait)
        tried += [back - waiting, first / (0.25 * wait) - rises]
        likely = ndtr(sure(back - 2.0 * waiting))
        usual = np.log(_ODD + (1.0 - _ODD) * likely)
    least = np.minimum(sure(falls), np.min([sure(each) for each in tried], axis=0) + _SLIGHTLY)
    return log_ndtr(least), usual


def _fallen(since: float, columns: int, wait: float) -> Floats:
    """What the columns change by until a time after the beginning of the fall."""
    change = np.zeros(columns)
    change[_FALL], change[_FALL + 2] = since, since**2
    bends = _FIXED + (wait > 0.0)
    change[bends : bends + len(_KNOTS)] = np.maximum(since - _KNOTS, 0.0)
    return change


def _waited(since: float, columns: int, wait: float) -> Floats:
    """What the columns change by until a time after the beginning of a wait."""
    change = np.zeros(columns)
    change[_FIXED] = since
    change[-len(_WAITING_KNOTS) :] = np.maximum(since - _WAITING_KNOTS * wait, 0.0)
    return change


def _noise(t: Floats, y: Floats, grid: _Grid, variance: float, wait: float) -> float:
    """Long-run variance of what the likeliest curve leaves."""
    place, rough = np.unravel_index(int(np.argmax(grid.likelihood)), grid.likelihood.shape)
    left = y - grid.curves[place, rough] @ _design(t, grid.places[[place]], wait)[0]
    spent = int(np.ceil(np.trace(grid.inverse[place, rough] @ grid.gram[place])))
    found = long_run_variance(left, parameters=spent)
    return max(found, 1e-18 * float(np.ptp(y)) ** 2) if np.isfinite(found) else variance


def _penalty(precision: float, fixed: int, columns: int) -> Floats:
    return np.diag(np.where(np.arange(columns) < fixed, 0.0, precision))


def _corner(grid: _Grid, variance: float) -> Corner | None:
    """Mean and standard deviation over all places and roughnesses."""
    weights = np.exp(grid.likelihood - grid.likelihood.max())
    weights /= weights.sum()
    of_place = weights.sum(axis=1)
    at_edge = np.abs(grid.places) > 0.99 * _REACH
    if of_place[at_edge].sum() > 0.05 or np.sum(weights * np.exp(grid.falls)) < _SURE:
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
    """Share of the variance of the corner's time that is left when there is no noise.

    The curve is taken for linear in the time at its likeliest place; the variance of a smoother is
    that of the noise that it lets through, and that of what it smooths away.
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
    """Slope of the curve at times since the corner."""
    fallen = since - wait
    before, after = curve[1] + 2.0 * curve[3] * since, curve[2] + 2.0 * curve[4] * fallen
    bends = curve[_FIXED + (wait > 0.0) :]
    after = after + (fallen[:, None] > _KNOTS) @ bends[: len(_KNOTS)]
    slopes: Floats = np.where(since < 0.0, before, after)
    if wait > 0.0:
        waiting = curve[_FIXED] + (since[:, None] > _WAITING_KNOTS * wait) @ bends[len(_KNOTS) :]
        slopes = np.where((since >= 0.0) & (fallen < 0.0), waiting, slopes)
    return slopes
