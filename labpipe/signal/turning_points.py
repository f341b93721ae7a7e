"""Turning points of a signal: strokes of a motion, and first guesses of where a force turns."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from math import sqrt

import numpy as np

from labpipe.records.arrays import Floats, Ints, median
from labpipe.records.curve import AT_REST, Branch, Direction

_BLOCKS = 20
"""Averages per width: fine enough for a first guess, coarse enough to reduce noise."""


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
    """Return whether a signal that leaves its level and returns does so downwards.

    Parameters
    ----------
    values : shape (n,), any unit; NaN are ignored

    Returns
    -------
    Whether it lies further below the lower one of its two ends (a hundredth of it each) than above
    the higher one, by at least five standard deviations of its noise. So a record that begins or
    ends halfway up does not go down. False without any value.
    """
    valid = values[~np.isnan(values)]
    if not len(valid):
        return False
    size = max(1, len(valid) // 100)
    ends = float(valid[:size].mean()), float(valid[-size:].mean())
    up, down = float(valid.max()) - max(ends), min(ends) - float(valid.min())
    return down > up and down - up > 5.0 * estimate_noise_level(valid)  # slow, so computed last


def estimate_noise_level(values: Floats) -> float:
    """Estimate the standard deviation of white noise on a smooth signal.

    Parameters
    ----------
    values : shape (n,)

    Returns
    -------
    In the unit of `values`; 0 for fewer than five samples.

    Notes
    -----
    Median absolute second difference / (0.6745 sqrt 6): independent of slopes, hardly affected by
    corners and jumps. NaN are ignored.
    """
    second = np.diff(values, n=2)
    second = second[~np.isnan(second)]
    return convert_to_noise(median(np.abs(second))) if len(second) > 2 else 0.0


def convert_to_noise(second: float) -> float:
    """Return the standard deviation of white noise from its median absolute second difference.

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
    min_stroke : m; smaller motions are noise or part of a longer stroke

    Returns
    -------
    The strokes in order. Neighbours share their turning sample, unless the motion dwells there:
    then the dwell belongs to neither. Empty if the motion is smaller than `min_stroke`.

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
    valid = ~np.isnan(motion)
    if valid.sum() < 3:
        return ()
    if not valid.all():
        motion = np.interp(time, time[valid], motion[valid])
    extremes = _extremes(motion, min_stroke)
    if not extremes:
        return ()
    tolerance = 5.0 * estimate_noise_level(motion)
    stays = [
        (
            _stay(time, motion, (turn, before), tolerance),
            _stay(time, motion, (turn, after), tolerance),
        )
        for before, turn, after in zip(
            [None, *extremes[:-1]], extremes, [*extremes[1:], None], strict=True
        )
    ]
    dwells = [_dwell(*stay) for stay in stays]
    return tuple(
        _trim_dwells(time, motion, pair, (leaving[1], arriving[0]))
        for pair, (leaving, arriving) in zip(pairwise(extremes), pairwise(dwells), strict=True)
    )


def _extremes(motion: Floats, min_stroke: float) -> list[int]:
    """Return the samples of the alternating extremes, both ends of the movement included."""
    max_points = 50_000
    stride = max(1, len(motion) // max_points)
    values = motion[::stride]
    spread = np.maximum.accumulate(values) - np.minimum.accumulate(values)
    if spread[-1] < min_stroke:
        return []
    begin = int(np.argmax(spread >= min_stroke))
    rising = bool(values[begin] == values[: begin + 1].max())
    sign = 1 if rising else -1
    extremes = [int(np.argmin(sign * values[: begin + 1]))]
    turned: int | None = begin
    while turned is not None:
        extreme, turned = _next_turn(sign * values, turned, min_stroke)
        extremes.append(extreme)
        sign = -sign
    return [index * stride for index in extremes]


def _next_turn(values: Floats, start: int, min_stroke: float) -> tuple[int, int | None]:
    """Return the next maximum, and the sample at which the values have returned from it, if any.

    Searched in stretches of doubling length, so that the time grows linearly with the record.
    """
    first_length = 1024
    length = first_length
    while True:
        ahead = values[start : start + length]
        back = np.maximum.accumulate(ahead) - ahead >= min_stroke
        turn = int(np.argmax(back))
        if back[turn]:
            return start + int(np.argmax(ahead[: turn + 1])), start + turn
        if start + length >= len(values):
            return start + int(np.argmax(ahead)), None
        length *= 2


def _trim_dwells(
    time: Floats, motion: Floats, extremes: tuple[int, int], dwells: tuple[float, float]
) -> Stroke:
    """Cut the dwell from both ends of the stretch between two extremes."""
    first, last = extremes
    sign = 1 if motion[last] > motion[first] else -1
    hair = 1e-6 * float(time[last] - time[first]) / (last - first)  # rounding of times
    begin = int(np.searchsorted(time, time[first] + dwells[0] - hair))
    end = int(np.searchsorted(time, time[last] - dwells[1] - hair))
    if begin >= end:  # a stroke within noise: its dwells are unknown
        begin, end = first, last
    return Stroke(begin, end, sign)


@dataclass(frozen=True, slots=True)
class _Dwell:
    """Time that a motion spends near an extreme, on one side of it.

    Parameters
    ----------
    near, wide : s, within a tolerance of it, and within four times that
    shortest : s, shortest dwell that differs from a corner
    """

    near: float
    wide: float
    shortest: float

    @property
    def dwell(self) -> float:
        """Return the time at the extreme itself, s."""
        return max(0.0, (4.0 * self.near - self.wide) / 3.0)


def _stay(
    time: Floats, motion: Floats, ends: tuple[int, int | None], tolerance: float
) -> _Dwell | None:
    """Return the time near an extreme, on the side of the next one; None at an end."""
    turn, other = ends
    if other is None:
        return None
    part = slice(turn, other + 1) if other > turn else slice(turn, other - 1 if other else None, -1)
    since, travel = np.abs(time[part] - time[turn]), np.abs(motion[part] - motion[turn])
    tolerance = max(tolerance, 1e-4 * float(travel[-1]))
    near, wide = (
        float(since[np.flatnonzero(travel <= factor * tolerance)[-1]]) for factor in (1.0, 4.0)
    )
    return _Dwell(near, wide, float(since[-1]) * max(0.005, 5.0 / abs(other - turn)))


def _dwell(before: _Dwell | None, after: _Dwell | None) -> tuple[float, float]:
    """Return the dwell in s before and after an extreme, whose place within a dwell is random.

    The ends of the movement have one side only, and a rest there is not part of the stroke.
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
        to better than one sample; NaN elsewhere

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


def number_branches(count: int, branches: tuple[Branch, ...]) -> tuple[Ints, Ints]:
    """Return branch and cycle number of every sample.

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


def find_sharpest_turn(time: Floats, values: Floats, *, width: float) -> float | None:
    """Find where the slope of a signal drops most.

    Parameters
    ----------
    time, values : shape (n,), s and any unit; NaN are left out
    width : s, on each side, over which the slopes before and after are taken

    Returns
    -------
    s; None where the record is shorter than two widths, or never rises and then falls.

    Notes
    -----
    The largest difference of the mean slopes over `width` before and after, above 0.3 of the range
    of levels: a record that ends under load has no turn. The largest value is not used: a bundle in
    large deflection can have its largest force before the motion turns. A range below ten standard
    deviations of the noise of the averages contains no turn.
    """
    # The extremes of a thousand values of white noise are seven standard deviations apart.
    range_noise_factor = 10.0
    # Share of the range of the levels: falls below are noise, or first contact of the load frame.
    min_height_share = 0.3
    levels = _block_levels(time, values, width)
    if levels is None:
        return None
    middles, level = levels
    if np.ptp(level) < range_noise_factor * estimate_noise_level(level):
        return None
    bend, after = _slope_drops(level)
    inner = level[_BLOCKS:-_BLOCKS] - level.min()
    drop = np.where((after < 0.0) & (inner > min_height_share * np.ptp(level)), bend, 0.0)
    best = int(np.argmax(drop))
    return float(middles[best + _BLOCKS]) if drop[best] > 0.0 else None


def find_turn_near(
    time: Floats, values: Floats, *, near: float, reach: float, width: float, dwell: float
) -> float | None:
    """Find roughly where a signal stops rising, before it falls after a known dwell.

    Parameters
    ----------
    time, values : shape (n,), s and any unit; NaN are left out
    near : s, middle of the searched range
    reach : s on each side of it; both corners are within
    width : s, on each side of a corner, over which the slopes before and after are taken
    dwell : s, between the corners; 0 for a signal without dwell

    Returns
    -------
    s, of the first corner; None where the record does not reach as far.

    Notes
    -----
    The place with the largest sum of the drops of slope at both corners. One corner alone could be
    mistaken for the other: the slope drops more at a steep fall than at the end of a rise. With a
    dwell, slopes are taken over no more than that, or 0.3 of the width.
    """
    # Share of the width.
    min_width_share = 0.3
    width = width * min(1.0, max(min_width_share, dwell / width)) if dwell > 0.0 else width
    inside = slice(*np.searchsorted(time, [near - reach - width, near + reach + width]))
    levels = _block_levels(time[inside], values[inside], width)
    if levels is None:
        return None
    middles, level = levels
    places, (bend, _) = middles[_BLOCKS:-_BLOCKS], _slope_drops(level)
    both = bend + np.interp(places + dwell, places, bend, right=-np.inf)
    return float(places[int(np.argmax(both))]) if np.isfinite(both).any() else None


def _block_levels(time: Floats, values: Floats, width: float) -> tuple[Floats, Floats] | None:
    """Return means over twentieths of a width and their times; None for less than two widths."""
    valid = ~np.isnan(values)
    edges = np.arange(time[0], time[-1], width / _BLOCKS) if valid.any() else np.zeros(0)
    if len(edges) < 2 * _BLOCKS + 2:
        return None
    place = np.searchsorted(edges, time[valid], side="right") - 1
    count = np.bincount(place, minlength=len(edges)).astype(np.float64)
    filled = count > 0
    total = np.bincount(place, values[valid], minlength=len(edges))
    middles = edges + 0.5 * width / _BLOCKS
    return middles, np.interp(middles, middles[filled], total[filled] / count[filled])


def _slope_drops(level: Floats) -> tuple[Floats, Floats]:
    """Return the drop of the mean slope at each inner level, and the rise after it."""
    before = level[_BLOCKS:-_BLOCKS] - level[: -2 * _BLOCKS]
    after = level[2 * _BLOCKS :] - level[_BLOCKS:-_BLOCKS]
    return before - after, after
