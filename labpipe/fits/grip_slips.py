"""Slips in the grips: sudden losses of force at constant speed, found, added back or cut off."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import stdtrit

from labpipe.fits.load_drops import MAD, MAD_SHARE, LoadDrop, PullCurve, fit_load_drop
from labpipe.records.arrays import Flags, Floats, Ints, median
from labpipe.records.curve import Interval, Slip, SlipDecision
from labpipe.records.estimates import Failure

_LEAST = 64
_SIDE = 8
"""Samples on each side of a slip at least."""
"""Degrees of freedom of a median absolute deviation, as a share of those of a standard one."""


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
    lost_share : a drop after which the force stays below this share of the peak before it is a
        failure, not a slip
    largest_share : a drop by more than this share of the force carried is none either: grips that
        slide let go of little at a time, while a strand that tears takes its share of the section
        with it, and adding that back would invent strength
    longest : m, over which a slip may take place; a slower drop is a yield. By default 2 % of the
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
    to 48, less their running median, follow a drop that is over at once but not slopes, kinks and
    yields. Each scale is measured by its own robust deviation (1.4826 MAD), so that noise of any
    correlation is its own yardstick, and a wide window, which is seldom measured, needs more of it
    (Student's t). Samples that stand alone are set aside first. The clearest drop is measured
    (`fit_load_drop`) and added back before the next one is looked for, so that it neither echoes
    nor hides its neighbours; in the end each is measured with all others added back, and one that
    is then no longer clear is left out. A slip must lose `min_drop`, and the force
    must go on rising: its slope behind must not be below 0.3 of that before by more than two
    errors.

    The interval of the loss agrees with 95 %, in noise that is white, slow or both. That of the
    position is the middle 95 % of the displacements between start and stop, over all drops that the
    data allow: it holds in more than 95 % where the drop takes time, since it is no narrower than
    the samples around it.
    """
    finite: Ints = np.flatnonzero(~np.isnan(displacement) & ~np.isnan(force)).astype(np.int64)
    finite = finite[~_stands_alone(force[finite])]
    if len(finite) < _LEAST:
        return Failure(
            "too_few_samples", f"{len(finite)} samples in the branch, {_LEAST} are needed"
        )
    size, most = _fineness(displacement[finite], longest)
    d, f = (_blocks(values[finite], size) for values in (displacement, force))
    drops = _confirmed(PullCurve(d, f, most, int(size > 1)), min_drop)
    kept_drops = [
        finding
        for finding in drops
        if finding.drop >= min_drop
        and _goes_on(f, finding, lost_share)
        and finding.drop <= largest_share * median(f[max(finding.start - 4, 0) : finding.start + 1])
    ]
    return tuple(_entry(d, finite, drop, size, decision) for drop in kept_drops)


def _fineness(d: Floats, longest: float | None) -> tuple[int, int]:
    """Samples that are averaged, and how many such means the longest slip takes."""
    # Samples are averaged in blocks; the longest slip takes at least this many.
    min_slip_blocks = 8
    # Default of the longest slip, as a share of the travel
    max_slip_share = 0.02
    # and in m.
    max_slip_length = 1e-3
    travel = float(np.ptp(d))
    reach = min(max_slip_share * travel, max_slip_length) if longest is None else longest
    samples = reach / (travel / (len(d) - 1)) if travel > 0.0 else 0.0
    size = int(np.clip(samples // min_slip_blocks, 1, len(d) // _LEAST))
    return size, int(np.clip(np.ceil(samples / size), 2, 2 * min_slip_blocks))


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
    drop, between `start` and `stop`, lie on the straight line over the samples between the two.
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


def _stands_alone(f: Floats) -> Flags:
    """Samples far off the median of five, whose neighbours agree with each other."""
    if len(f) < _LEAST:
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
    """Drops in order, each measured with all others added back, by which all still stand."""
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
        # The last one found is the least distinct: it may have been an echo of another.
        lost = max(number for number, fit in enumerate(again) if fit is None)
        drops = [*drops[:lost], *drops[lost + 1 :]]
    return sorted(drops, key=lambda drop: drop.start)


def _drops(pull: PullCurve, min_drop: float) -> list[LoadDrop]:
    """Sudden drops, the most distinct first; each is added back before the next is looked for."""
    drops: list[LoadDrop] = []
    is_open = np.ones(len(pull.f), dtype=np.bool_)
    while True:
        seen = np.where(is_open, _seen(pull.f, min_drop), 0.0)
        at = int(np.argmax(seen))
        if seen[at] <= 1.0:
            return drops
        drop = fit_load_drop(pull, at)
        if drop is None or not is_open[drop.start : drop.stop].any():
            is_open[max(at - _SIDE, 0) : at + _SIDE + 1] = False
            continue
        drops.append(drop)
        pull = pull.without([drop])
        is_open[max(min(at, drop.start) - 1, 0) : max(at, drop.stop) + 1] = False


def _seen(f: Floats, min_drop: float) -> Floats:
    """How distinct a drop behind each sample is: more than 1 is worth a look."""
    window_lengths = (3, 6, 12, 24, 48)
    # Probability of such a drop in noise at a given place.
    false_alarm_rate = 1e-5
    best = np.zeros(len(f))
    if not np.ptp(f) > 0.0:
        return best
    for window in (scale for scale in window_lengths if 8 * scale <= len(f)):
        size = _sizes(f, window)
        spread = max(MAD * median(np.abs(size)), 1e-9 * float(np.ptp(f)))
        # Neighbouring places share their samples: so many of them speak for themselves.
        freedom = int(MAD_SHARE * len(f) / window)
        seen = size / (spread * stdtrit(freedom, 1.0 - false_alarm_rate))
        best = np.maximum(best, np.where(size >= 0.5 * min_drop, seen, 0.0))
    best[:_SIDE], best[len(f) - _SIDE :] = 0.0, 0.0
    return best


def _sizes(f: Floats, window: int) -> Floats:
    """How much lower the window behind a sample lies than the one up to it, trend taken off."""
    sums = np.concatenate([[0.0], np.cumsum(f - f.mean())])
    ends = np.arange(window, len(f) - window + 1)
    inner = (2.0 * sums[ends] - sums[ends - window] - sums[ends + window]) / window
    from scipy.ndimage import median_filter

    inner = inner - median_filter(inner, 8 * window + 1, mode="nearest")
    sizes = np.zeros(len(f))
    sizes[ends - 1] = inner
    return sizes


def _goes_on(f: Floats, drop: LoadDrop, lost_share: float) -> bool:
    """Whether the force comes back above the share and rises at about the same slope."""
    rises = drop.slope_behind + 2.0 * drop.slope_error >= 0.3 * drop.slope_before
    is_held = bool(f[drop.stop :].max() >= lost_share * f[: drop.start + 1].max())
    return rises and is_held


def _entry(d: Floats, samples: Ints, drop: LoadDrop, size: int, decision: SlipDecision) -> Slip:
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
