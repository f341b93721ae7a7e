"""Grip slips: sudden losses of force at constant speed, to be found and repaired or cut."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import stdtrit

from labpipe.fits.load_drops import (
    MAD_FACTOR,
    MAD_FREEDOM_SHARE,
    LoadDrop,
    PullCurve,
    fit_load_drop,
)
from labpipe.records.arrays import Flags, Floats, Ints, median
from labpipe.records.curve import Interval, Slip, SlipDecision
from labpipe.records.estimates import Failure

_MIN_BRANCH_SAMPLES = 64
_MIN_SIDE_SAMPLES = 8


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
    """Find sudden losses of force after which the force continues at about the same slope.

    Parameters
    ----------
    displacement, force : shape (n,), m, N; one loading branch at constant speed, up to the failure;
        evenly sampled; NaN are ignored
    min_drop : N; smaller losses are ignored
    decision : written into the ledger
    lost_share : a drop after which the force stays below this share of the previous peak is a
        failure, not a slip
    largest_share : nor is a drop by more than this share of the force a slip: grips slide in small
        steps, while a torn strand loses its share of the section, and adding that back would
        invent strength
    longest : m, longest slip; a slower drop is a yield. By default 2 % of the travel, but at most
        1 mm. At least two samples

    Returns
    -------
    The slips in order, with sample numbers of the arguments; or a failure ``too_few_samples``
    (fewer than 64).

    Notes
    -----
    If `longest` takes 16 samples or more, samples are averaged in blocks, 8 to 15 per longest slip,
    so that the result does not depend on the sampling rate; `start` and `stop` are the samples
    around these means. Differences of the means of adjacent windows of 3 to 48, less their running
    median, show sudden drops but not slopes, kinks and yields. Each window length is scaled by its
    own robust deviation (1.4826 MAD), valid for noise of any correlation, with Student's t for its
    degrees of freedom. Isolated outliers are removed first. The most distinct drop is measured
    (`fit_load_drop`) and added back before the next search, so that it neither repeats nor hides
    its neighbours; finally each is measured with all others added back, and those no longer
    distinct are discarded. A slip must lose `min_drop`, and the force must continue to rise: its
    slope after the slip must not be below 0.3 of that before by more than two errors.

    The interval of the loss covers 95 %, in noise that is white, slow or both. That of the position
    is the middle 95 % of the displacements between start and stop, over all drops consistent with
    the data: it covers more than 95 % if the drop takes time, as it is at least as wide as the
    samples around it.
    """
    finite: Ints = np.flatnonzero(~np.isnan(displacement) & ~np.isnan(force)).astype(np.int64)
    finite = finite[~_is_outlier(force[finite])]
    if len(finite) < _MIN_BRANCH_SAMPLES:
        message = f"{len(finite)} samples in the branch, {_MIN_BRANCH_SAMPLES} are needed"
        return Failure("too_few_samples", message)
    size, most = _block_size(displacement[finite], longest)
    d, f = (_blocks(values[finite], size) for values in (displacement, force))
    drops = _confirmed(PullCurve(d, f, most, int(size > 1)), min_drop)
    kept_drops = [
        drop
        for drop in drops
        if drop.drop >= min_drop
        and _force_continues(f, drop, lost_share)
        and drop.drop <= largest_share * median(f[max(drop.start - 4, 0) : drop.start + 1])
    ]
    return tuple(_ledger_entry(d, finite, drop, size, decision) for drop in kept_drops)


def _block_size(d: Floats, longest: float | None) -> tuple[int, int]:
    """Return the samples per block, and the blocks of the longest slip."""
    min_slip_blocks = 8
    travel = float(np.ptp(d))
    reach = min(0.02 * travel, 1e-3) if longest is None else longest
    samples = reach / (travel / (len(d) - 1)) if travel > 0.0 else 0.0
    size = int(np.clip(samples // min_slip_blocks, 1, len(d) // _MIN_BRANCH_SAMPLES))
    return size, int(np.clip(np.ceil(samples / size), 2, 2 * min_slip_blocks))


def _blocks(values: Floats, size: int) -> Floats:
    """Average samples in blocks; the last one includes the remainder."""
    starts = np.arange(0, len(values) - size + 1, size)
    means: Floats = np.add.reduceat(values, starts) / np.diff(np.append(starts, len(values)))
    return means


def add_back(force: Floats, slips: Sequence[Slip]) -> Floats:
    """Add the losses of slips back to a force.

    Parameters
    ----------
    force : shape (n,), N
    slips : with the sample numbers of `force`

    Returns
    -------
    shape (n,), N. The drop of each slip is added from its `stop` on. Samples between `start` and
    `stop` are interpolated. NaN stay NaN.
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
    """Return how many of `count` samples a curve keeps if it ends before its first slip."""
    return min((slip.start + 1 for slip in slips), default=count)


def _is_outlier(f: Floats) -> Flags:
    """Flag samples far from the median of five, whose neighbours agree with each other."""
    if len(f) < _MIN_BRANCH_SAMPLES:
        return np.zeros(len(f), dtype=np.bool_)
    steps = np.diff(f)
    usual = median(steps)
    from scipy.ndimage import median_filter

    off = np.abs(f - median_filter(f, 5, mode="nearest"))
    spread = 1.4826 * median(np.abs(steps - usual))
    is_off: Flags = off > 6.0 * max(spread, 1e-9 * float(np.ptp(f)))
    if not is_off.any():
        return is_off
    pairs = 0.5 * (f[1:] + f[:-1])
    apart = np.full(len(f), np.inf)
    apart[2:-2] = np.abs(pairs[3:] - pairs[:-3] - 3.0 * usual)
    return is_off & (apart < 0.5 * off)


def _confirmed(pull: PullCurve, min_drop: float) -> list[LoadDrop]:
    """Return the drops in order that remain distinct with all others added back."""
    drops = _drops(pull, min_drop)
    while len(drops) > 1:
        again = [
            fit_load_drop(pull.without([other for other in drops if other is not drop]), drop.start)
            for drop in drops
        ]
        confirmed = [fit for fit in again if fit is not None]
        if len(confirmed) == len(drops):
            drops = confirmed
            break
        # The last one is the least distinct: it may have been an artefact of another.
        lost = max(number for number, fit in enumerate(again) if fit is None)
        drops = [*drops[:lost], *drops[lost + 1 :]]
    return sorted(drops, key=lambda drop: drop.start)


def _drops(pull: PullCurve, min_drop: float) -> list[LoadDrop]:
    """Find sudden drops, the most distinct first, each with the previous ones added back."""
    drops: list[LoadDrop] = []
    is_open = np.ones(len(pull.f), dtype=np.bool_)
    while True:
        distinct = np.where(is_open, _distinctness(pull.f, min_drop), 0.0)
        at = int(np.argmax(distinct))
        if distinct[at] <= 1.0:
            return drops
        drop = fit_load_drop(pull, at)
        if drop is None or not is_open[drop.start : drop.stop].any():
            is_open[max(at - _MIN_SIDE_SAMPLES, 0) : at + _MIN_SIDE_SAMPLES + 1] = False
            continue
        drops.append(drop)
        pull = pull.without([drop])
        is_open[max(min(at, drop.start) - 1, 0) : max(at, drop.stop) + 1] = False


def _distinctness(f: Floats, min_drop: float) -> Floats:
    """Return how distinct a drop after each sample is: candidates are above 1."""
    window_lengths = (3, 6, 12, 24, 48)
    # Probability of such a drop in noise at a given place.
    false_alarm_rate = 1e-5
    best = np.zeros(len(f))
    if not np.ptp(f) > 0.0:
        return best
    for window in (scale for scale in window_lengths if 8 * scale <= len(f)):
        size = _drop_sizes(f, window)
        spread = max(MAD_FACTOR * median(np.abs(size)), 1e-9 * float(np.ptp(f)))
        # Adjacent windows share samples, which reduces the degrees of freedom.
        freedom = int(MAD_FREEDOM_SHARE * len(f) / window)
        distinct = size / (spread * stdtrit(freedom, 1.0 - false_alarm_rate))
        best = np.maximum(best, np.where(size >= 0.5 * min_drop, distinct, 0.0))
    best[:_MIN_SIDE_SAMPLES], best[len(f) - _MIN_SIDE_SAMPLES :] = 0.0, 0.0
    return best


def _drop_sizes(f: Floats, window: int) -> Floats:
    """Return the drop from the window up to a sample to the one after it, without trend."""
    sums = np.concatenate([[0.0], np.cumsum(f - f.mean())])
    ends = np.arange(window, len(f) - window + 1)
    inner = (2.0 * sums[ends] - sums[ends - window] - sums[ends + window]) / window
    from scipy.ndimage import median_filter

    inner = inner - median_filter(inner, 8 * window + 1, mode="nearest")
    sizes = np.zeros(len(f))
    sizes[ends - 1] = inner
    return sizes


def _force_continues(f: Floats, drop: LoadDrop, lost_share: float) -> bool:
    """Return whether the force recovers the share and rises at about the same slope."""
    rises = drop.slope_behind + 2.0 * drop.slope_error >= 0.3 * drop.slope_before
    is_held = bool(f[drop.stop :].max() >= lost_share * f[: drop.start + 1].max())
    return rises and is_held


def _ledger_entry(
    d: Floats, samples: Ints, drop: LoadDrop, size: int, decision: SlipDecision
) -> Slip:
    low, high = float(d[drop.earliest]), float(d[drop.latest])
    middle, half = 0.5 * (low + high), 0.475 * (high - low)
    position = float(np.interp(drop.middle, np.arange(len(d)), d))
    return Slip(
        position=position,
        drop=drop.drop,
        position_interval=Interval(min(middle - half, position), max(middle + half, position)),
        drop_interval=drop.drop_interval,
        decision=decision,
        start=int(samples[drop.start * size + size - 1]),
        stop=int(samples[drop.stop * size]),
    )
