"""Turning points of a signal: strokes of a motion, and first guesses of where a force turns."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from math import sqrt

import numpy as np

from labpipe.records.arrays import Floats, Ints, median
from labpipe.records.curve import AT_REST, Branch, Direction

_MOST_POINTS = 50_000
_FIRST_LOOK = 1024
_BLOCKS = 20
"""Averages per width: fine enough for a first guess, and noise is averaged."""
_LEAST = 0.3
"""Share of the way from its lowest to its highest level that a signal has at least where it turns:
what falls at the bottom is noise, or the head of a load frame that touches."""
_SHORTEST = 0.3
"""Share of the width that slopes are taken over at least, however short the dwell."""
_MORE_THAN_NOISE = 10.0
"""Standard deviations; the extremes of a thousand values of noise are seven apart."""


@dataclass(frozen=True, slots=True)
class Stroke:
    """One stretch of motion in one direction.

    Parameters
    ----------
    start, stop : first and last sample of the stretch
    sign : +1 where the motion grows, -1 where it falls
    """

    start: int
    stop: int
    sign: int


def goes_down(values: Floats) -> bool:
    """Tell whether a signal that leaves its level and comes back does so downwards.

    Parameters
    ----------
    values : shape (n,), any unit; NaN are left out

    Returns
    -------
    Whether it lies further below the lower one of its two ends (a hundredth of it each) than above
    the higher one, by five standard deviations of its noise or more. So a record that begins
    halfway up is none that goes down, nor is one that ends there. False without any value.
    """
    known = values[~np.isnan(values)]
    if not len(known):
        return False
    size = max(1, len(known) // 100)
    ends = float(known[:size].mean()), float(known[-size:].mean())
    up, down = float(known.max()) - max(ends), min(ends) - float(known.min())
    return down > up and down - up > 5.0 * noise_level(known)  # noise takes longer to find


def noise_level(values: Floats) -> float:
    """Estimate the standard deviation of white noise on a smooth signal.

    Parameters
    ----------
    values : shape (n,)

    Returns
    -------
    In the unit of `values`; 0 for fewer than five samples.

    Notes
    -----
    Median absolute second difference / (0.6745 sqrt 6): blind to slopes, hardly touched by
    corners and jumps. NaN are left out.
    """
    second = np.diff(values, n=2)
    second = second[~np.isnan(second)]
    return noise_of_differences(median(np.abs(second))) if len(second) > 2 else 0.0


def noise_of_differences(second: float) -> float:
    """Standard deviation of white noise by the median of its second differences' absolute values.

    Parameters
    ----------
    second : the median, in any unit
    """
    return second / (0.6745 * sqrt(6.0))


def find_strokes(time: Floats, motion: Floats, *, min_stroke: float) -> tuple[Stroke, ...]:
    """Split a motion at its turning points.

    Parameters
    ----------
    time : shape (n,), s, increasing
    motion : shape (n,), m
    min_stroke : m; what moves less than this is noise or part of a longer stroke

    Returns
    -------
    The strokes in order. Neighbours share their turning sample, unless the motion dwells there:
    then the dwell belongs to neither. Empty when nothing moves by `min_stroke`.

    Raises
    ------
    ValueError
        If `min_stroke` is not positive.

    Notes
    -----
    Extremes are found with hysteresis: a new one counts once the motion has come back from it by
    `min_stroke`. A dwell differs from a smooth reversal by the time t1 spent within a tolerance of
    the extreme, on both sides together, and t4 within four times that: a corner has t4 = 4 t1, a
    parabola t4 = 2 t1, a dwell t4 < 1.5 t1. NaN are bridged by straight lines.
    """
    if not min_stroke > 0:
        message = f"min_stroke={min_stroke}: expected a positive length"
        raise ValueError(message)
    known = ~np.isnan(motion)
    if known.sum() < 3:
        return ()
    if not known.all():
        motion = np.interp(time, time[known], motion[known])
    extremes = _extremes(motion, min_stroke)
    if not extremes:
        return ()
    tolerance = 5.0 * noise_level(motion)
    stays = [
        (_stay(time, motion, (at, before), tolerance), _stay(time, motion, (at, after), tolerance))
        for before, at, after in zip(
            [None, *extremes[:-1]], extremes, [*extremes[1:], None], strict=True
        )
    ]
    dwells = [_dwell(*stay) for stay in stays]
    return tuple(
        _trimmed(time, motion, pair, (leaving[1], arriving[0]))
        for pair, (leaving, arriving) in zip(pairwise(extremes), pairwise(dwells), strict=True)
    )


def _extremes(motion: Floats, min_stroke: float) -> list[int]:
    """Sample numbers of the alternating extremes, the two ends of the movement included."""
    stride = max(1, len(motion) // _MOST_POINTS)
    values = motion[::stride]
    spread = np.maximum.accumulate(values) - np.minimum.accumulate(values)
    if spread[-1] < min_stroke:
        return []
    begin = int(np.argmax(spread >= min_stroke))
    rising = bool(values[begin] == values[: begin + 1].max())
    sign = 1 if rising else -1
    found = [int(np.argmin(sign * values[: begin + 1]))]
    turned: int | None = begin
    while turned is not None:
        extreme, turned = _next_turn(sign * values, turned, min_stroke)
        found.append(extreme)
        sign = -sign
    return [index * stride for index in found]


def _next_turn(values: Floats, start: int, min_stroke: float) -> tuple[int, int | None]:
    """The highest sample from one on, and where the values have come back from it, if they do.

    Looked for in stretches that double, so that many strokes do not make many passes to the end.
    """
    length = _FIRST_LOOK
    while True:
        ahead = values[start : start + length]
        back = np.maximum.accumulate(ahead) - ahead >= min_stroke
        at = int(np.argmax(back))
        if back[at]:
            return start + int(np.argmax(ahead[: at + 1])), start + at
        if start + length >= len(values):
            return start + int(np.argmax(ahead)), None
        length *= 2


def _trimmed(
    time: Floats, motion: Floats, extremes: tuple[int, int], dwells: tuple[float, float]
) -> Stroke:
    """Cut the dwell from both ends of the stretch between two extremes."""
    first, last = extremes
    sign = 1 if motion[last] > motion[first] else -1
    hair = 1e-6 * float(time[last] - time[first]) / (last - first)  # sums of times are not exact
    begin = int(np.searchsorted(time, time[first] + dwells[0] - hair))
    end = int(np.searchsorted(time, time[last] - dwells[1] - hair))
    if begin >= end:  # it moves no further than its noise: nobody can tell a dwell from that
        begin, end = first, last
    return Stroke(begin, end, sign)


@dataclass(frozen=True, slots=True)
class _Dwell:
    """How long a motion is near an extreme, on one side of it.

    Parameters
    ----------
    near, wide : s, within a tolerance of it, and within four times that
    shortest : s, of a dwell that is not taken for a corner
    """

    near: float
    wide: float
    shortest: float

    @property
    def dwell(self) -> float:
        """Time at the extreme itself, s."""
        return max(0.0, (4.0 * self.near - self.wide) / 3.0)


def _stay(
    time: Floats, motion: Floats, ends: tuple[int, int | None], tolerance: float
) -> _Dwell | None:
    """How long a motion is near an extreme, looking from there to the next; None at an end."""
    at, other = ends
    if other is None:
        return None
    part = slice(at, other + 1) if other > at else slice(at, other - 1 if other else None, -1)
    since, travel = np.abs(time[part] - time[at]), np.abs(motion[part] - motion[at])
    tolerance = max(tolerance, 1e-4 * float(travel[-1]))
    near, wide = (
        float(since[np.flatnonzero(travel <= factor * tolerance)[-1]]) for factor in (1.0, 4.0)
    )
    return _Dwell(near, wide, float(since[-1]) * max(0.005, 5.0 / abs(other - at)))


def _dwell(before: _Dwell | None, after: _Dwell | None) -> tuple[float, float]:
    """Seconds that a motion dwells before and after an extreme, whose place in a dwell is chance.

    At the ends of the movement there is one side alone, and any rest is none of the stroke's.
    """
    sides = [side for side in (before, after) if side is not None]
    near, wide = sum(side.near for side in sides), sum(side.wide for side in sides)
    shortest = min(side.shortest for side in sides)
    dwells = 2.0 * near - wide > (shortest if len(sides) > 1 else 0.0)
    if not dwells or (len(sides) > 1 and not wide < 1.5 * near):
        return 0.0, 0.0
    return 0.0 if before is None else before.dwell, 0.0 if after is None else after.dwell


def split_branches(
    time: Floats,
    strokes: tuple[Stroke, ...],
    *,
    turning_times: Floats | None = None,
) -> tuple[Branch, ...]:
    """Turn strokes into the loading and unloading branches of cycles.

    Parameters
    ----------
    time : shape (n,), s
    strokes : in order of travel
    turning_times : shape (strokes, 2), s, start and stop of each stroke where they are known
        better than to the sample; NaN where they are not

    Returns
    -------
    One branch per stroke. The direction of the first stroke is loading; a cycle is a loading
    branch with the unloading branch after it.
    """
    branches = []
    for number, stroke in enumerate(strokes):
        ends = [float(time[stroke.start]), float(time[stroke.stop])]
        if turning_times is not None:
            finer = np.where(np.isnan(turning_times[number]), ends, turning_times[number])
            ends = [float(end) for end in finer]
        loading = stroke.sign == strokes[0].sign
        branches.append(
            Branch(
                start=stroke.start,
                stop=stroke.stop + (number == len(strokes) - 1),
                cycle=number // 2 + 1,
                direction=Direction.LOADING if loading else Direction.UNLOADING,
                start_time=ends[0],
                stop_time=ends[1],
            )
        )
    return tuple(branches)


def branch_numbers(count: int, branches: tuple[Branch, ...]) -> tuple[Ints, Ints]:
    """Branch and cycle number of every sample.

    Parameters
    ----------
    count : number of samples
    branches : as from `split_branches`

    Returns
    -------
    branch : shape (count,), `AT_REST` outside every branch
    cycle : shape (count,), 0 outside every branch
    """
    branch = np.full(count, AT_REST, dtype=np.int64)
    cycle = np.zeros(count, dtype=np.int64)
    for number, part in enumerate(branches):
        branch[part.start : part.stop] = number
        cycle[part.start : part.stop] = part.cycle
    return branch, cycle


def sharpest_turn(time: Floats, values: Floats, *, width: float) -> float | None:
    """Find where the slope of a signal drops most.

    Parameters
    ----------
    time, values : shape (n,), s and any unit; NaN are left out
    width : s, on each side, over which the slopes before and after are taken

    Returns
    -------
    s; None where the record is shorter than two widths, or nowhere rises and then falls.

    Notes
    -----
    The largest difference of the mean slopes over `width` before and after, above 0.3 of the way
    from the lowest level to the highest: a record that ends under load has no turn. The largest
    value would not do: a bundle in large deflection can have its largest force before the motion
    turns. Where that way is less than ten standard deviations of the noise of the averages, there
    is no turn but noise.
    """
    found = _levels(time, values, width)
    if found is None:
        return None
    middles, level = found
    if np.ptp(level) < _MORE_THAN_NOISE * noise_level(level):
        return None
    bend, after = _bends(level)
    here = level[_BLOCKS:-_BLOCKS] - level.min()
    drop = np.where((after < 0.0) & (here > _LEAST * np.ptp(level)), bend, 0.0)
    best = int(np.argmax(drop))
    return float(middles[best + _BLOCKS]) if drop[best] > 0.0 else None


def turn_near(
    time: Floats, values: Floats, *, near: float, reach: float, width: float, dwell: float
) -> float | None:
    """Find roughly where a signal stops rising, and where it begins to fall a known while later.

    Parameters
    ----------
    time, values : shape (n,), s and any unit; NaN are left out
    near : s, middle of what is looked at
    reach : s on each side of it in which both corners are
    width : s, on each side of a corner, over which the slopes before and after are taken
    dwell : s, from the one corner to the other; 0 for a signal that turns at once

    Returns
    -------
    s, of the first corner; None where the record does not reach as far.

    Notes
    -----
    Where the slope drops by most at both places together. Either corner alone could be the other: a
    steep fall drops the slope more than the end of a rise does. A fall that grows less steep drops
    it nowhere. With a dwell, slopes are taken over no more than that, or 0.3 of the width.
    """
    width = width * min(1.0, max(_SHORTEST, dwell / width)) if dwell > 0.0 else width
    inside = slice(*np.searchsorted(time, [near - reach - width, near + reach + width]))
    found = _levels(time[inside], values[inside], width)
    if found is None:
        return None
    middles, level = found
    places, (bend, _) = middles[_BLOCKS:-_BLOCKS], _bends(level)
    both = bend + np.interp(places + dwell, places, bend, right=-np.inf)
    return float(places[int(np.argmax(both))]) if np.isfinite(both).any() else None


def _levels(time: Floats, values: Floats, width: float) -> tuple[Floats, Floats] | None:
    """Means over twentieths of a width, and the middles of these; None for less than two widths."""
    known = ~np.isnan(values)
    edges = np.arange(time[0], time[-1], width / _BLOCKS) if known.any() else np.zeros(0)
    if len(edges) < 2 * _BLOCKS + 2:
        return None
    place = np.searchsorted(edges, time[known], side="right") - 1
    count = np.bincount(place, minlength=len(edges)).astype(np.float64)
    filled = count > 0
    total = np.bincount(place, values[known], minlength=len(edges))
    middles = edges + 0.5 * width / _BLOCKS
    return middles, np.interp(middles, middles[filled], total[filled] / count[filled])


def _bends(level: Floats) -> tuple[Floats, Floats]:
    """By how much the mean slope drops at each level, and the rise behind it; without the ends."""
    before = level[_BLOCKS:-_BLOCKS] - level[: -2 * _BLOCKS]
    after = level[2 * _BLOCKS :] - level[_BLOCKS:-_BLOCKS]
    return before - after, after
