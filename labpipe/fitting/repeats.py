"""How long a signal takes to repeat itself: the lag between two cycles of a test."""

from __future__ import annotations

import numpy as np

from labpipe.fitting.estimates import Estimate, Failure
from labpipe.fitting.noise import long_run_variance
from labpipe.records.arrays import Floats

_BINS, _LEAST = 2000, 50


def fit_lag(
    time: Floats,
    values: Floats,
    *,
    start: float,
    turn: float,
    stop: float,
    guess: float,
    hysteresis: bool,
) -> Estimate | Failure:
    """Time after which a cycle of a signal comes again.

    Parameters
    ----------
    time, values : shape (n,), s and any unit; increasing time
    start, turn, stop : s, the earlier cycle: its beginning, its peak, its end
    guess : s, the lag to within a second
    hysteresis : whether the loop may have moved along the displacement between the two cycles; a
        motion, which has no other displacement, may not

    Returns
    -------
    The lag in s, or a failure ``too_few_samples``.

    Notes
    -----
    y(t + lag) - y(t) = tau y'(t) + a + b y(t) + c y'(t) sign(turn - t): what is left of a wrong lag
    (tau), a shift and a scale of the later cycle (a, b), and a loop that has moved along the
    displacement (c), which shifts loading and unloading in opposite senses. Least squares on at
    most 2000 bins, repeated until tau vanishes. y' is taken from the mean of both cycles; the
    standard error from the long-run variance of what is left, so that a cycle that repeats badly
    counts for little. Noise makes y' look larger than it is and tau smaller: tau and its error are
    divided by the share of the sum of squares that is not noise (Fuller, Measurement Error Models,
    1987, sec. 1.2).
    """
    bins = _bin_count(time, start, stop)
    if bins < _LEAST:
        return Failure("too_few_samples", f"{bins} bins in the cycle, {_LEAST} are needed")
    edges = np.linspace(start, stop, bins + 1)
    middle = 0.5 * (edges[1:] + edges[:-1])
    earlier = _binned(time, values, edges)
    lag, found = guess, None
    for _ in range(5):
        later = _binned(time, values, edges + lag)
        found = _compare(middle, earlier, later, turn, hysteresis=hysteresis)
        if isinstance(found, Failure):
            return found
        lag += found.value
        if abs(found.value) < 0.01 * found.error:
            break
    if found is None or isinstance(found, Failure):
        return Failure("too_few_samples", "no bins to compare")
    return Estimate(lag, found.error, found.n)


def _compare(
    time: Floats, earlier: Floats, later: Floats, turn: float, *, hysteresis: bool
) -> Estimate | Failure:
    """What the lag has to grow by for the later cycle to lie on the earlier one."""
    mean = 0.5 * (earlier + later)
    slope = np.gradient(mean, time)
    known = ~np.isnan(slope) & (np.abs(time - turn) > 2.0 * (time[1] - time[0]))
    if known.sum() < _LEAST:
        found = f"{int(known.sum())} bins in common, {_LEAST} are needed"
        return Failure("too_few_samples", found)
    columns = [slope, np.ones_like(mean), mean]
    if hysteresis:
        columns.append(slope * np.sign(turn - time))
    design = np.column_stack(columns)[known]
    difference = (later - earlier)[known]
    solution = np.linalg.lstsq(design, difference, rcond=None)[0]
    left = difference - design @ solution
    variance = long_run_variance(left, parameters=len(columns))
    covariance = np.linalg.pinv(design.T @ design)
    # y(t + lag) runs late by tau' when lag is too great: the lag shrinks where the slope is met.
    reliability = max(0.1, 1.0 - _slope_noise(time, left) * float(covariance[0, 0]))
    error = float(np.sqrt(variance * covariance[0, 0])) / reliability
    return Estimate(-float(solution[0]) / reliability, error, int(known.sum()))


def _slope_noise(time: Floats, left: Floats) -> float:
    """Sum of squares that noise adds to central differences of the mean of both cycles.

    `left` is the noise of a difference, of four times the variance of the mean's; a central
    difference over two steps h has 1 / (2 h^2) of the latter.
    """
    step = float(time[1] - time[0])
    return float(left @ left) / (8.0 * step**2)


def _bin_count(time: Floats, start: float, stop: float) -> int:
    samples = int(np.searchsorted(time, stop) - np.searchsorted(time, start))
    return max(0, min(_BINS, samples // 2))


def _binned(time: Floats, values: Floats, edges: Floats) -> Floats:
    """Means of the samples in each bin; NaN where there is none."""
    ends = np.searchsorted(time, edges)
    low, high = ends[:-1], ends[1:]
    filled = np.flatnonzero(high > low)
    means: Floats = np.full(len(low), np.nan)
    if len(filled) == 0:
        return means
    inside = slice(int(low[filled[0]]), int(high[filled[-1]]))
    sums = np.add.reduceat(values[inside], low[filled] - inside.start)
    means[filled] = sums / (high - low)[filled]
    # The samples of a bin lie a little off its middle: carry the mean there along the slope.
    off = np.zeros(len(low))
    off[filled] = 0.5 * (time[low[filled]] + time[high[filled] - 1])
    off[filled] -= 0.5 * (edges[1:] + edges[:-1])[filled]
    carried: Floats = means - off * np.gradient(means, edges[1] - edges[0])
    return carried
