"""Two instruments, two clocks: their offset and drift, from events or a motion that repeats."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from labpipe.records.arrays import Floats, Ints
from labpipe.records.curve import ClockFit, Interval
from labpipe.records.estimates import Estimate, Failure
from labpipe.signal.filters import moving_average, seconds_to_window
from labpipe.signal.turning_points import Stroke, find_strokes
from labpipe.uncertainty.autocorrelation import long_run_variance

_BINS, _LEAST = 2000, 50


def rough_peaks(time: Floats, values: Floats, *, smoothing: float, share: float) -> Floats:
    """Times of the upper turning points of a signal, good to about `smoothing`.

    Parameters
    ----------
    time, values : shape (n,), s and any unit
    smoothing : s, span of the moving average that is applied first
    share : of the range of the signal that a turn must come back by

    Returns
    -------
    Shape (peaks,), s; empty for a constant signal.

    Notes
    -----
    Of a plateau that ends in a fall, its largest sample may lie anywhere; the turn is where the
    slope changes most: where 2 y(t) - y(t - h) - y(t + h) is largest, with h four times
    `smoothing`, or a quarter of the shorter stroke.
    """
    thin = max(1, seconds_to_window(smoothing, time) // 10)
    window = max(1, 2 * (seconds_to_window(smoothing, time) // thin // 2) + 1)
    count = len(values) // thin * thin
    coarse = np.nanmean(values[:count].reshape(-1, thin), axis=1) if count else values
    smooth = moving_average(coarse, window=min(window, len(coarse) - 1 + len(coarse) % 2))
    span = float(np.nanmax(smooth) - np.nanmin(smooth)) if len(smooth) else 0.0
    if not span > 0:
        return np.empty(0)
    clock = time[:count].reshape(-1, thin).mean(axis=1)
    strokes = find_strokes(clock, smooth, min_stroke=share * span)
    turns = [
        clock[_sharpest(smooth, first, second, 2 * window)]
        for first, second in pairwise(strokes)
        if first.sign > 0 > second.sign
    ]
    return np.array(turns, dtype=np.float64)


def _sharpest(values: Floats, rise: Stroke, fall: Stroke, reach: int) -> int:
    """Sample at which a rise turns into a fall."""
    reach = min(reach, (rise.stop - rise.start) // 4, (fall.stop - fall.start) // 4)
    first, last = rise.start + reach, fall.stop - reach
    if reach < 1 or last <= first:
        return rise.stop
    middle = values[first:last]
    bend = 2.0 * middle - values[first - reach : last - reach]
    bend -= values[first + reach : last + reach]
    return first + int(np.nanargmax(bend)) if np.isfinite(bend).any() else rise.stop


def match_peaks(motion: Floats, force: Floats) -> tuple[Ints, bool]:
    """Pair the peaks of two records of the same test.

    Parameters
    ----------
    motion, force : shape (p,) and (q,), s, in order, each on its own clock

    Returns
    -------
    pairs : shape (k, 2), positions in `motion` and in `force`; empty if one has no peak
    is_ambiguous : True when another pairing fits as well

    Notes
    -----
    The records see the same peaks in the same order, some perhaps before one of them began. Of all
    shifts, the one with the most pairs wins, then the one whose pairs lie at the most
    constant difference; among equals the smallest difference, since both records are started
    together. Then the choice is ambiguous.
    """
    candidates = []
    for shift in range(-len(motion) + 1, len(force)):
        first = np.arange(max(0, -shift), min(len(motion), len(force) - shift))
        if len(first) == 0:
            continue
        lag = force[first + shift] - motion[first]
        spread = float(np.ptp(lag))
        candidates.append((-len(first), round(spread, 1), abs(float(np.median(lag))), shift))
    if not candidates:
        return np.empty((0, 2), dtype=np.int64), False
    candidates.sort()
    best = candidates[0]
    rivals = [other for other in candidates[1:] if other[:2] == best[:2]]
    first = np.arange(max(0, -best[3]), min(len(motion), len(force) - best[3]))
    return np.column_stack([first, first + best[3]]), bool(rivals)


@dataclass(frozen=True, slots=True)
class Repeat:
    """The time after which the test repeats itself, on both clocks.

    Parameters
    ----------
    motion, force : s, the same lag on the marker clock and on the force clock
    error : s, standard error of their difference
    wander : s, what a zero of the force that wanders may add to its lag; in intervals alone, as it
        weighs no event
    """

    motion: float
    force: float
    error: float
    wander: float = 0.0


def fit_clocks(
    motion: Floats, force: Floats, errors: Floats, *, method: str, repeat: Repeat | None = None
) -> ClockFit:
    """Fit force time = offset + (1 + drift) x marker time to what was seen on both clocks.

    Parameters
    ----------
    motion, force : shape (events,), s, at least one event
    errors : shape (events,), s, standard error of the difference at each event, positive
    method : in words, how the events were found
    repeat : a lag seen on both clocks, which says nothing on the offset and much on the drift

    Returns
    -------
    The fit. With one event and no repeat the drift is taken as zero and its interval is NaN.

    Raises
    ------
    ValueError
        If there is no event, or an error is not positive.

    Notes
    -----
    Weighted least squares with known errors; 95 % intervals are normal ones. When the events
    scatter more than their errors allow (chi-square over its degrees of freedom above its 99 %
    quantile), the intervals are widened by the square root of that ratio.
    """
    if len(motion) == 0 or not (errors > 0).all():
        message = f"events={len(motion)}: expected at least one event and positive errors"
        raise ValueError(message)
    centre = float(np.average(motion, weights=errors**-2.0))
    design = np.column_stack([np.ones_like(motion), motion - centre])
    seen, weights = force - motion, 1.0 / errors
    if repeat is not None:
        design = np.vstack([design, [0.0, repeat.motion]])
        seen = np.append(seen, repeat.force - repeat.motion)
        weights = np.append(weights, 1.0 / repeat.error)
    is_single = len(seen) == 1
    design = design[:, : 1 if is_single else 2]
    weighted = design * weights[:, None]
    covariance = np.linalg.inv(weighted.T @ weighted)
    solution = covariance @ weighted.T @ (seen * weights)
    misfit = seen - design @ solution
    covariance = covariance * _excess(misfit * weights, freedom=len(seen) - design.shape[1])
    if repeat is not None:
        moved = np.linalg.lstsq(weighted, np.eye(len(seen))[-1] * weights, rcond=None)[0]
        covariance = covariance + repeat.wander**2 * np.outer(moved, moved)
    drift = 0.0 if is_single else float(solution[1])
    to_zero = np.array([1.0, -centre])[: len(solution)]
    offset = float(to_zero @ solution)
    offset_error = float(np.sqrt(to_zero @ covariance @ to_zero))
    drift_error = float("nan") if is_single else float(np.sqrt(covariance[1, 1]))
    return ClockFit(
        offset=offset,
        drift=drift,
        offset_interval=Interval.normal_95(offset, offset_error),
        drift_interval=Interval.normal_95(drift, drift_error),
        residual=float(np.sqrt(np.mean(misfit[: len(motion)] ** 2))),
        event_times_motion=motion,
        event_times_force=force,
        event_errors=errors,
        method=method,
    )


def _excess(pulls: Floats, *, freedom: int) -> float:
    """Factor on the variance when events scatter more than their errors allow, else 1.

    The 99 % quantile of chi-square is that of Wilson and Hilferty (PNAS 17 (1931) 684), good to
    2 % for one degree of freedom and better for more.
    """
    if freedom < 1:
        return 1.0
    spread = 2.0 / (9.0 * freedom)
    limit = freedom * (1.0 - spread + 2.3263 * np.sqrt(spread)) ** 3
    square = float(pulls @ pulls)
    return square / freedom if square > limit else 1.0


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
