"""Slips in the grips: sudden losses of force at constant speed, found, added back or cut off."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from labpipe.fitting.correlated import fit_linear
from labpipe.fitting.estimates import Failure
from labpipe.fitting.medians import running_median
from labpipe.records.arrays import Flags, Floats, Ints
from labpipe.records.curve import Interval
from labpipe.records.slips import Slip, SlipDecision

_LEAST = 64
_SCALES = (3, 6, 12, 24, 48)
_SEEN = 6.0
"""Robust deviations of its own kind that a fall must exceed."""
_SURE = 1e-10
"""Chance that a fall at a given place is noise: the largest of many places is looked at."""
_FINE = 8
"""Blocks that the longest slip takes at least; more samples than that are averaged."""
_LONGEST_SHARE, _LONGEST = 0.02, 1e-3
"""Longest slip that is looked for by default: share of the travel, but at most so many m."""
_SIDE = 8
"""Samples on each side of a slip at least."""
_Span = tuple[int, int]
"""Samples or means that the longest slip takes, and 1 for means, which a fall may lie inside of."""
_SIDES = (50, 20, 10)
"""Samples on each side that its lines are tried with."""


def find_slips(
    displacement: Floats,
    force: Floats,
    *,
    min_drop: float,
    decision: SlipDecision,
    lost_share: float = 0.5,
    largest_share: float = 0.2,
    longest: float | None = None,
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
    largest_share : a fall by more than this share of the force carried is none either: grips that
        slide let go of little at a time, while a strand that tears takes its share of the section
        with it, and adding that back would invent strength
    longest : m, over which a slip may take place; a slower fall is a yield. By default 2 % of the
        travel, but at most 1 mm. Never less than two samples

    Returns
    -------
    The slips in order, with sample numbers of the arrays given; or a failure ``too_few_samples``
    (fewer than 64).

    Notes
    -----
    Where `longest` takes 16 samples or more, means of so many neighbours that it takes 8 to 15 of
    them stand for the samples: what is found does not depend on the sampling rate, and `start` and
    `stop` are the samples around those means. Differences of the means of neighbouring windows of 3
    to 48, less their running median, follow a fall that is over at once but not slopes, kinks and
    yields. Each scale is measured by its own robust deviation (1.4826 MAD), so that noise of any
    correlation is its own yardstick. Samples that stand alone are set aside first. The clearest
    fall is measured and added back before the next one is looked for, so that it neither echoes nor
    hides its neighbours. At a fall, start and stop are the likeliest under first-order
    autoregressive noise with two parallel lines; the drop is the distance of these lines, by
    generalised least squares, with the other falls added back. The interval of the position is the
    middle 95 % of the displacements between start and stop, over all pairs that the data allow. A
    slip must lose `min_drop`; noise must explain it with a chance of no more than 1e-10 at its
    place (F-test of the whitened sums of squares); and the force must go on rising: its slope
    behind must not be below 0.3 of that before by more than two errors.
    """
    known: Ints = np.flatnonzero(~np.isnan(displacement) & ~np.isnan(force)).astype(np.int64)
    known = known[~_stands_alone(force[known])]
    if len(known) < _LEAST:
        return Failure(
            "too_few_samples", f"{len(known)} samples in the branch, {_LEAST} are needed"
        )
    size, most = _fineness(displacement[known], longest)
    span = (most, int(size > 1))
    d, f = (_blocks(each[known], size) for each in (displacement, force))
    found = _measured_again(d, f, _falls(d, f, min_drop, span), span)
    kept = [
        each
        for each in found
        if each.drop >= min_drop
        and _goes_on(f, each, lost_share)
        and each.drop
        <= largest_share * float(np.median(f[max(each.start - 4, 0) : each.start + 1]))
    ]
    return tuple(_entry(d, known, each, size, decision) for each in kept)


def _fineness(d: Floats, longest: float | None) -> tuple[int, int]:
    """Samples that are averaged, and how many such means the longest slip takes."""
    travel = float(np.ptp(d))
    reach = min(_LONGEST_SHARE * travel, _LONGEST) if longest is None else longest
    samples = reach / (travel / (len(d) - 1)) if travel > 0.0 else 0.0
    size = int(np.clip(samples // _FINE, 1, len(d) // _LEAST))
    return size, int(np.clip(np.ceil(samples / size), 2, 2 * _FINE))


def _blocks(values: Floats, size: int) -> Floats:
    """Means of neighbours; what is left over at the end joins the last one."""
    starts = np.arange(0, len(values) - size + 1, size)
    means: Floats = np.add.reduceat(values, starts) / np.diff(np.append(starts, len(values)))
    return means


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
    """Samples far off the median of five, whose neighbours agree with each other."""
    if len(f) < _LEAST:
        return np.zeros(len(f), dtype=np.bool_)
    steps = np.diff(f)
    usual = float(np.median(steps))
    off = np.abs(f - running_median(f, 5))
    pairs = 0.5 * (f[1:] + f[:-1])
    apart = np.full(len(f), np.inf)
    apart[2:-2] = np.abs(pairs[3:] - pairs[:-3] - 3.0 * usual)
    spread = 1.4826 * float(np.median(np.abs(steps - usual)))
    alone: Flags = (off > 6.0 * max(spread, 1e-9 * float(np.ptp(f)))) & (apart < 0.5 * off)
    return alone


def _falls(d: Floats, f: Floats, min_drop: float, span: _Span) -> list[_Found]:
    """Sudden falls, the most distinct first; each is added back before the next is looked for."""
    falls: list[_Found] = []
    mended, is_open = f.copy(), np.ones(len(f), dtype=np.bool_)
    while True:
        seen, reach = _seen(mended, min_drop)
        seen = np.where(is_open, seen, 0.0)
        at = int(np.argmax(seen))
        if seen[at] <= _SEEN:
            return falls
        found = _look(d, mended, at, span)
        if found is None or not is_open[found.start : found.stop].any():
            far = int(reach[at]) + span[0]
            is_open[max(at - far, 0) : at + far + 1] = False
            continue
        falls.append(found)
        mended = _without(mended, found)
        is_open[max(min(at, found.start) - 1, 0) : max(at, found.stop) + 1] = False


def _without(f: Floats, found: _Found) -> Floats:
    """Force with a fall added back; a straight line between its start and stop."""
    mended = f.copy()
    mended[found.stop :] += found.drop
    inside = np.arange(found.start + 1, found.stop)
    ends = [found.start, found.stop]
    mended[inside] = np.interp(inside, ends, mended[ends])
    return mended


def _measured_again(d: Floats, f: Floats, falls: list[_Found], span: _Span) -> list[_Found]:
    """Each fall once more, in order, with all others added back."""
    again = []
    for each in falls:
        mended = f
        for other in falls:
            mended = mended if other is each else _without(mended, other)
        found = _look(d, mended, each.start, span) if len(falls) > 1 else each
        again.append(found or each)
    return sorted(again, key=lambda found: found.start)


def _seen(f: Floats, min_drop: float) -> tuple[Floats, Ints]:
    """How distinct a fall behind each sample is, in robust deviations, and the window it is in."""
    best, reach = np.zeros(len(f)), np.zeros(len(f), dtype=np.int64)
    for window in (scale for scale in _SCALES if 8 * scale <= len(f)):
        size = _sizes(f, window)
        spread = max(1.4826 * float(np.median(np.abs(size))), 1e-9 * float(np.ptp(f)))
        seen = np.where(size >= 0.5 * min_drop, size / spread, 0.0)
        reach = np.where(seen > best, window, reach)
        best = np.maximum(best, seen)
    best[:_SIDE], best[len(f) - _SIDE :] = 0.0, 0.0
    return best, reach


def _sizes(f: Floats, window: int) -> Floats:
    """How much lower the window behind a sample lies than the one up to it, trend taken off."""
    sums = np.concatenate([[0.0], np.cumsum(f - f.mean())])
    ends = np.arange(window, len(f) - window + 1)
    inner = (2.0 * sums[ends] - sums[ends - window] - sums[ends + window]) / window
    inner = inner - running_median(inner, 8 * window + 1)
    sizes = np.zeros(len(f))
    sizes[ends - 1] = inner
    return sizes


def _look(d: Floats, f: Floats, fall: int, span: _Span) -> _Found | None:
    """Two parallel lines around a fall; shorter ones where the curve bends."""
    founds = (_look_within(d, f, fall, (span, side)) for side in _SIDES)
    return next((each for each in founds if each is not None), None)


def _look_within(d: Floats, f: Floats, fall: int, reach: tuple[_Span, int]) -> _Found | None:
    """Fit two parallel lines with every pair of start and stop near a fall."""
    from scipy.special import stdtrit

    (most, blurred), side = reach
    bounds = low, high = max(0, fall - most - side), min(len(f), fall + most + side + 1)
    if fall - low < _SIDE or high - fall < _SIDE + 1:
        return None
    # A short window says little of the correlation: the longest one speaks for all.
    far = most + _SIDES[0]
    factor = _correlation(d, f, (fall, most), (max(0, fall - far), min(len(f), fall + far + 1)))
    starts, gaps = (
        np.arange(max(low + 4, fall - most), min(high - 5, fall + most)),
        np.arange(most + 1),
    )
    pairs = np.array([(start, start + 1 + gap) for start in starts for gap in gaps])
    pairs = pairs[pairs[:, 1] < high - 4]
    costs, variance, without = _costs(d, f, bounds, pairs, factor)
    if without - costs.min() < variance * float(stdtrit(high - low - 6, 1.0 - _SURE)) ** 2:
        return None
    if np.ptp(pairs[np.argmin(costs)]) > most:
        return None  # it would rather take longer than the longest slip
    allowed = pairs[costs - costs.min() <= 3.84 * variance]
    return _measured(d, f, bounds, (pairs[np.argmin(costs)], allowed), blurred)


def _correlation(d: Floats, f: Floats, place: tuple[int, int], bounds: tuple[int, int]) -> float:
    """Lag-one correlation of residuals about two parallel parabolas, the fall itself left out."""
    fall, most = place
    rows = np.r_[
        bounds[0] : max(fall - most, bounds[0] + 4),
        min(fall + 1 + most, bounds[1] - 4) : bounds[1],
    ]
    x = (d[rows] - d[fall]) / (float(np.ptp(d[rows])) or 1.0)
    design = np.column_stack([np.ones_like(x), x, x * x, rows > fall]).astype(np.float64)
    left = f[rows] - design @ np.linalg.lstsq(design, f[rows], rcond=None)[0]
    power = float(left @ left)
    factor = float(left[1:] @ left[:-1]) / power if power > 0.0 else 0.0
    # Residuals of a fit know less of each other than the noise does: Kendall, Biometrika 41 (1954).
    return float(np.clip(factor + (2.0 + 4.0 * factor) / len(rows), 0.0, 0.98))


def _costs(
    d: Floats, f: Floats, bounds: tuple[int, int], pairs: Ints, factor: float
) -> tuple[Floats, float, float]:
    """Whitened sum of squares of each pair, the variance of one term, and the sum with no fall.

    The force falls evenly from start to stop.
    """
    rows = np.arange(*bounds)
    span = pairs[:, 1] - pairs[:, 0]
    ramps = np.clip((rows[:, None] - pairs[:, 0]) / span, 0.0, 1.0)
    x = (d[rows] - d[rows].mean()) / (float(np.ptp(d[rows])) or 1.0)
    lines = np.column_stack([np.ones_like(x), x, x * x])
    base, ramps, target = (
        each[1:] - factor * each[:-1] for each in (lines, ramps, f[rows] - f[rows[0]])
    )
    base = np.linalg.qr(base)[0]
    ramps, target = ramps - base @ (base.T @ ramps), target - base @ (base.T @ target)
    power = np.maximum(np.sum(ramps**2, axis=0), 1e-12)
    without = float(target @ target)
    squares: Floats = without - (target @ ramps) ** 2 / power
    return squares, float(squares.min()) / max(len(rows) - 6, 1), without


def _measured(
    d: Floats,
    f: Floats,
    bounds: tuple[int, int],
    pairs: tuple[Ints, Ints],
    blurred: int,
) -> _Found | None:
    pair, allowed = pairs
    start, stop = int(pair[0]), int(pair[1])
    earliest, latest = int(allowed[:, 0].min()), int(allowed[:, 1].max())
    # No sample that may be inside the fall counts: it would make the drop too small.
    rows = np.r_[bounds[0] : earliest + 1 - blurred, latest + blurred : bounds[1]]
    if min(earliest - blurred - bounds[0], bounds[1] - latest - blurred) < 4:
        return None
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
        earliest=earliest,
        latest=latest,
        slope_before=before,
        slope_behind=before + change,
        slope_error=float(np.sqrt(both.covariance[3, 3])),
    )


def _goes_on(f: Floats, found: _Found, lost_share: float) -> bool:
    """Whether the force comes back above the share and rises at about the same slope."""
    rises = found.slope_behind + 2.0 * found.slope_error >= 0.3 * found.slope_before
    is_held = bool(f[found.stop :].max() >= lost_share * f[: found.start + 1].max())
    return rises and is_held


def _entry(d: Floats, known: Ints, found: _Found, size: int, decision: SlipDecision) -> Slip:
    low, high = float(d[found.earliest]), float(d[found.latest])
    middle, half = 0.5 * (low + high), 0.475 * (high - low)
    position = 0.5 * float(d[found.start] + d[found.stop])
    return Slip(
        position=position,
        drop=found.drop,
        position_interval=Interval(min(middle - half, position), max(middle + half, position)),
        drop_interval=found.drop_interval,
        decision=decision,
        start=int(known[found.start * size + size - 1]),
        stop=int(known[found.stop * size]),
    )
