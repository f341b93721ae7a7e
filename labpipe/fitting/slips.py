"""Slips in the grips: sudden losses of force at constant speed, found, added back or cut off."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from labpipe.fitting.correlated import fit_linear
from labpipe.fitting.estimates import Failure
from labpipe.records.arrays import Flags, Floats, Ints
from labpipe.records.curve import Interval
from labpipe.records.slips import Slip, SlipDecision

_LEAST = 64
_SCALES = (3, 6, 12, 24, 48)
_SEEN = 6.0
"""Robust deviations of its own kind that a fall must exceed."""
_LONGEST = 6
"""Samples that a slip may take; a slower fall is a yield."""
_SIDE = 8
"""Samples on each side of a slip at least."""


def find_slips(
    displacement: Floats,
    force: Floats,
    *,
    min_drop: float,
    decision: SlipDecision,
    lost_share: float = 0.5,
) -> tuple[Slip, ...] | Failure:
    """Sudden losses of force after which the force goes on lower at about the same slope.

    Parameters
    ----------
    displacement, force : shape (n,), m, N; one loading branch at constant speed, up to the failure;
        evenly sampled; NaN are left out
    min_drop : N; smaller losses are not looked at
    decision : written into the ledger
    lost_share : a fall after which the force stays below this share of the peak before it is a
        failure, not a slip

    Returns
    -------
    The slips in order, with sample numbers of the arrays given; or a failure ``too_few_samples``
    (fewer than 64).

    Notes
    -----
    Differences of the means of neighbouring windows of 3 to 48 samples, less their running median,
    which follows slopes, kinks and yields but not a fall that is over at once. Each scale is
    measured by its own robust deviation (1.4826 MAD), so that noise of any correlation is its own
    yardstick. Samples that stand alone are set aside first. At a fall, start and stop are the
    likeliest under first-order autoregressive noise with two parallel lines; the drop is the
    distance of these lines, by generalised least squares. The interval of the position is the
    middle 95 % of the displacements between start and stop, over all pairs that the data allow. A
    slip must lose `min_drop`, more than its uncertainty, and go on rising: its slope behind must
    not be below 0.3 of that before by more than two errors.
    """
    known: Ints = np.flatnonzero(~np.isnan(displacement) & ~np.isnan(force)).astype(np.int64)
    known = known[~_stands_alone(force[known])]
    if len(known) < _LEAST:
        return Failure(
            "too_few_samples", f"{len(known)} samples in the branch, {_LEAST} are needed"
        )
    d, f = displacement[known], force[known]
    falls = _falls(f, min_drop)
    slips = []
    for number, fall in enumerate(falls):
        low = falls[number - 1] + 1 + _LONGEST if number else 0
        high = falls[number + 1] - _LONGEST if number + 1 < len(falls) else len(f)
        found = _look(d, f, fall, (max(low, fall - 60), min(high, fall + 61)))
        if found is not None and found.drop >= min_drop and _goes_on(f, found, lost_share):
            slips.append(_entry(d, known, found, decision))
    return tuple(slips)


def add_back(force: Floats, slips: Sequence[Slip]) -> Floats:
    """Force with the losses of slips added back.

    Parameters
    ----------
    force : shape (n,), N
    slips : with the sample numbers of `force`

    Returns
    -------
    shape (n,), N. From `stop` of each slip on, its drop is added; drops add up. Samples inside a
    fall, between `start` and `stop`, lie on the straight line over the samples between the two.
    NaN stay NaN.
    """
    repaired = np.array(force, dtype=np.float64)
    for slip in slips:
        repaired[slip.stop :] += slip.drop
    for slip in slips:
        inside = np.arange(slip.start + 1, slip.stop)
        ends = repaired[[slip.start, slip.stop]]
        line = np.interp(inside, [slip.start, slip.stop], ends)
        repaired[inside] = np.where(np.isnan(repaired[inside]), np.nan, line)
    return repaired


def samples_before(slips: Sequence[Slip], count: int) -> int:
    """Samples that a curve of `count` samples keeps when it ends before its first slip."""
    return min((slip.start + 1 for slip in slips), default=count)


@dataclass(frozen=True, slots=True)
class _Found:
    """A fall: last sample before and first after, drop with interval, allowed starts and stops."""

    start: int
    stop: int
    drop: float
    drop_interval: Interval
    earliest: int
    latest: int
    slope_before: float
    slope_behind: float
    slope_error: float


def _stands_alone(f: Floats) -> Flags:
    """Samples far off the median of five, whose neighbours agree with it."""
    from scipy.ndimage import median_filter

    off = f - median_filter(f, 5, mode="nearest")
    spread = 1.4826 * np.median(np.abs(np.diff(f) - np.median(np.diff(f)))) if len(f) > 2 else 0.0
    alone: Flags = np.abs(off) > 6.0 * max(float(spread), 1e-9 * float(np.ptp(f)))
    return alone


def _falls(f: Floats, min_drop: float) -> list[int]:
    """Last samples before sudden falls, most distinct first, then in order."""
    best, reach = np.zeros(len(f)), np.zeros(len(f), dtype=np.int64)
    for window in (scale for scale in _SCALES if 8 * scale <= len(f)):
        size = _sizes(f, window)
        spread = max(1.4826 * float(np.median(np.abs(size))), 1e-9 * float(np.ptp(f)))
        seen = np.where(size >= 0.5 * min_drop, size / spread, 0.0)
        reach = np.where(seen > best, window, reach)
        best = np.maximum(best, seen)
    falls: list[int] = []
    while best.max() > _SEEN:
        at = int(np.argmax(best))
        if _SIDE <= at < len(f) - _SIDE:
            falls.append(at)
        apart = int(reach[at]) + _LONGEST
        best[max(0, at - apart) : at + apart + 1] = 0.0
    return sorted(falls)


def _sizes(f: Floats, window: int) -> Floats:
    """How much lower the window behind a sample lies than the one up to it, trend taken off."""
    from scipy.ndimage import median_filter

    sums = np.concatenate([[0.0], np.cumsum(f - f.mean())])
    ends = np.arange(window, len(f) - window + 1)
    inner = (2.0 * sums[ends] - sums[ends - window] - sums[ends + window]) / window
    inner = inner - median_filter(inner, 8 * window + 1, mode="nearest")
    sizes = np.zeros(len(f))
    sizes[ends - 1] = inner
    return sizes


def _look(d: Floats, f: Floats, fall: int, bounds: tuple[int, int]) -> _Found | None:
    """Fit two parallel lines around a fall with every pair of start and stop near it."""
    low, high = bounds
    if fall - low < _SIDE or high - fall < _SIDE + 1:
        return None
    factor = _correlation(d, f, fall, bounds)
    pairs = [
        (start, start + 1 + gap)
        for start in range(max(low + 4, fall - _LONGEST), min(high - 5, fall + _LONGEST))
        for gap in range(_LONGEST)
        if start + 1 + gap < high - 4
    ]
    costs, variance = _costs(d, f, bounds, pairs, factor)
    best = int(np.argmin(costs))
    allowed = [
        pair
        for pair, cost in zip(pairs, costs, strict=True)
        if cost - costs[best] <= 3.84 * variance
    ]
    return _measured(d, f, bounds, pairs[best], allowed)


def _correlation(d: Floats, f: Floats, fall: int, bounds: tuple[int, int]) -> float:
    """Lag-one correlation of the residuals of two parallel lines, the fall itself left out."""
    rows = np.r_[
        bounds[0] : max(fall - _LONGEST, bounds[0] + 4),
        min(fall + 1 + _LONGEST, bounds[1] - 4) : bounds[1],
    ]
    design = np.column_stack([np.ones(len(rows)), d[rows], rows > fall]).astype(np.float64)
    left = f[rows] - design @ np.linalg.lstsq(design, f[rows], rcond=None)[0]
    power = float(left @ left)
    return float(np.clip(left[1:] @ left[:-1] / power, 0.0, 0.95)) if power > 0.0 else 0.0


def _costs(
    d: Floats, f: Floats, bounds: tuple[int, int], pairs: list[tuple[int, int]], factor: float
) -> tuple[Floats, float]:
    """Whitened sum of squares of each pair, and the variance of one term.

    A sample between start and stop has a level of its own, at the price of ten variances:
    a sample half-way down is far off both lines, one that is merely noisy is not.
    """
    rows = np.arange(*bounds)
    d, f = d[rows] - d[rows[0]], f[rows]
    squares = []
    for start, stop in pairs:
        inside = [rows == row for row in range(start + 1, stop)]
        design = np.column_stack([np.ones(len(rows)), d, rows >= stop, *inside]).astype(np.float64)
        white = design[1:] - factor * design[:-1]
        target = f[1:] - factor * f[:-1]
        left = target - white @ np.linalg.lstsq(white, target, rcond=None)[0]
        squares.append(float(left @ left))
    variance = min(squares) / max(len(rows) - 5, 1)
    prices = np.array([10.0 * variance * (stop - start - 1) for start, stop in pairs])
    return np.array(squares) + prices, variance


def _measured(
    d: Floats,
    f: Floats,
    bounds: tuple[int, int],
    pair: tuple[int, int],
    allowed: list[tuple[int, int]],
) -> _Found | None:
    start, stop = pair
    rows = np.r_[bounds[0] : start + 1, stop : bounds[1]]
    after = (rows >= stop).astype(np.float64)
    x = d[rows] - 0.5 * (d[start] + d[stop])
    fit = fit_linear(np.column_stack([np.ones(len(rows)), x, after]), f[rows], weighted=True)
    drop = fit.estimate(2)
    if drop.interval is None or drop.interval.upper >= 0.0:
        return None
    both = fit_linear(np.column_stack([np.ones(len(rows)), x, after, x * after]), f[rows])
    before, change = float(both.coefficients[1]), float(both.coefficients[3])
    return _Found(
        start=start,
        stop=stop,
        drop=-drop.value,
        drop_interval=Interval(-drop.interval.upper, -drop.interval.lower),
        earliest=min(one for one, _ in allowed),
        latest=max(other for _, other in allowed),
        slope_before=before,
        slope_behind=before + change,
        slope_error=float(np.sqrt(both.covariance[3, 3])),
    )


def _goes_on(f: Floats, found: _Found, lost_share: float) -> bool:
    """Whether the force comes back above the share and rises at about the same slope."""
    rises = found.slope_behind + 2.0 * found.slope_error >= 0.3 * found.slope_before
    is_held = bool(f[found.stop :].max() >= lost_share * f[: found.start + 1].max())
    return rises and is_held


def _entry(d: Floats, known: Ints, found: _Found, decision: SlipDecision) -> Slip:
    low, high = float(d[found.earliest]), float(d[found.latest])
    middle, half = 0.5 * (low + high), 0.475 * (high - low)
    position = 0.5 * float(d[found.start] + d[found.stop])
    return Slip(
        position=position,
        drop=found.drop,
        position_interval=Interval(min(middle - half, position), max(middle + half, position)),
        drop_interval=found.drop_interval,
        decision=decision,
        start=int(known[found.start]),
        stop=int(known[found.stop]),
    )
