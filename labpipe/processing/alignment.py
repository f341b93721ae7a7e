"""Two instruments, two clocks: their offset and drift from events that both have seen."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from labpipe.processing.filtering import moving_average, seconds_to_window
from labpipe.processing.strokes import Stroke, find_strokes
from labpipe.records.arrays import Floats, Ints
from labpipe.records.curve import ClockFit, Interval


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
    """

    motion: float
    force: float
    error: float


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
