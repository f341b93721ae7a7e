"""Split a motion into strokes, and find turns, rests and jumps of signals."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from math import sqrt

import numpy as np

from labpipe.messages import format_sentence
from labpipe.records.arrays import Floats, compute_median_step, drop_missing, median
from labpipe.records.curve import Branch, Direction

_BLOCKS_PER_WIDTH = 20
"""Number of averaged blocks per width.

It is large enough for a first guess of a turn, and small enough to reduce noise.
"""


@dataclass(frozen=True, slots=True)
class Stroke:
    """Stretch of a motion in one direction.

    Parameters
    ----------
    start, stop : indices of the first and the last sample of the stretch
    sign : +1 for increasing positions, -1 for decreasing positions
    """

    start: int
    stop: int
    sign: int


def goes_down(values: Floats) -> bool:
    """Return whether a signal departs from its level downwards and returns.

    Parameters
    ----------
    values : shape (n,), any unit; NaN are ignored

    Returns
    -------
    Whether the minimum is farther below the lower end than the maximum is above the higher end, by
    more than five standard deviations of the noise. An end is the mean of the first or last
    hundredth of the samples. False without any value.
    """
    valid = drop_missing(values)
    if not len(valid):
        return False
    n_end = max(1, len(valid) // 100)
    ends = float(valid[:n_end].mean()), float(valid[-n_end:].mean())
    rise, fall = float(valid.max()) - max(ends), min(ends) - float(valid.min())
    return fall > rise and fall - rise > 5.0 * estimate_noise_level(valid)  # last, because slow


def estimate_noise_level(values: Floats) -> float:
    """Estimate the standard deviation of white noise on a smooth signal.

    Parameters
    ----------
    values : shape (n,), evenly spaced samples in any unit

    Returns
    -------
    The standard deviation, in the unit of `values`; 0 for fewer than five samples.

    Notes
    -----
    It is the median absolute second difference divided by 0.6745 sqrt(6), which is independent of
    slopes and hardly affected by corners and jumps. NaN are ignored.
    """
    differences = drop_missing(np.diff(values, n=2))
    if len(differences) < 3:
        return 0.0
    return median(np.abs(differences)) / (0.6745 * sqrt(6.0))


def compute_step_quantile(values: Floats, quantile: float) -> float:
    """Compute a quantile of the absolute changes from sample to sample, without zeros.

    Parameters
    ----------
    values : shape (n,), samples in any unit; NaN and changes by rounding errors are ignored
    quantile : fraction of the changes below the result, from 0 to 1

    Returns
    -------
    The quantile in the unit of `values`; 0 for fewer than 20 changes. Of more than 100 000 changes,
    an evenly spaced part is used.
    """
    min_steps, max_steps, rounding = 20, 100_000, 1e-7  # rounding as a fraction of the range
    finite_values = drop_missing(values)
    steps = np.abs(np.diff(finite_values))
    if len(steps) < min_steps:
        return 0.0
    steps = steps[steps > rounding * np.ptp(finite_values)]
    stride = len(steps) // max_steps + 1
    return float(np.quantile(steps[::stride], quantile)) if len(steps) >= min_steps else 0.0


def find_strokes(time: Floats, motion: Floats, *, min_stroke: float) -> tuple[Stroke, ...]:
    """Split a motion at its turning points.

    Parameters
    ----------
    time : shape (n,), s, increasing
    motion : shape (n,), m
    min_stroke : smallest stroke, m; a smaller reversal is noise, or part of a stroke

    Returns
    -------
    The strokes in order. Successive strokes share their turning sample, but a dwell at the turn
    belongs to neither. Empty for a motion smaller than `min_stroke`, or for fewer than three
    samples.

    Raises
    ------
    ValueError
        If `min_stroke` is not positive.

    Notes
    -----
    Extremes are found with hysteresis: an extreme counts if the motion returns from it by
    `min_stroke`. Let t1 and t4 be the times for which the motion is within a tolerance of an
    extreme, and within four times that tolerance, on both sides together. A corner has t4 = 4 t1, a
    parabola t4 = 2 t1, and a dwell t4 < 1.5 t1. NaN are replaced by linear interpolation.
    """
    if not min_stroke > 0:
        raise ValueError(format_sentence("signal.bad_stroke", min_stroke=min_stroke))
    valid = ~np.isnan(motion)
    if valid.sum() < 3:
        return ()
    if not valid.all():
        motion = np.interp(time, time[valid], motion[valid])
    extremes = _find_extremes(motion, min_stroke)
    if not extremes:
        return ()
    tolerance = 5.0 * estimate_noise_level(motion)
    dwells = []
    for turn, *neighbours in zip(extremes, [None, *extremes], [*extremes[1:], None], strict=False):
        sides = [_measure_extreme(time, motion, (turn, other), tolerance) for other in neighbours]
        dwells.append(_compute_dwell_times(*sides))
    return tuple(
        _trim_dwells(time, motion, pair, (leaving[1], arriving[0]))
        for pair, (leaving, arriving) in zip(pairwise(extremes), pairwise(dwells), strict=True)
    )


def _find_extremes(motion: Floats, min_stroke: float) -> list[int]:
    """Find the samples of the alternating extremes, including both ends of the motion.

    In a long record, 50 000 to 100 000 evenly spaced samples are searched.
    """
    min_searched_samples = 50_000
    stride = max(1, len(motion) // min_searched_samples)
    values = motion[::stride]
    spread = np.maximum.accumulate(values) - np.minimum.accumulate(values)
    if spread[-1] < min_stroke:
        return []
    begin = int(np.argmax(spread >= min_stroke))
    sign = 1 if values[begin] == values[: begin + 1].max() else -1
    extremes = [int(np.argmin(sign * values[: begin + 1]))]
    return_sample: int | None = begin
    while return_sample is not None:
        extreme, return_sample = _find_next_turn(sign * values, return_sample, min_stroke)
        extremes.append(extreme)
        sign = -sign
    return [index * stride for index in extremes]


def _find_next_turn(values: Floats, start: int, min_stroke: float) -> tuple[int, int | None]:
    """Find the next maximum, and the sample at which the values have returned from it, or None.

    Stretches of doubling length make the search time proportional to the length of the record.
    """
    length = 1024
    while True:
        stretch = values[start : start + length]
        has_returned = np.maximum.accumulate(stretch) - stretch >= min_stroke
        turn = int(np.argmax(has_returned))
        if has_returned[turn]:
            return start + int(np.argmax(stretch[: turn + 1])), start + turn
        if start + length >= len(values):
            return start + int(np.argmax(stretch)), None
        length *= 2


def _trim_dwells(
    time: Floats, motion: Floats, extremes: tuple[int, int], dwells: tuple[float, float]
) -> Stroke:
    """Remove the dwells from both ends of the stretch between two extremes."""
    start_extreme, stop_extreme = extremes
    sign = 1 if motion[stop_extreme] > motion[start_extreme] else -1
    step = float(time[stop_extreme] - time[start_extreme]) / (stop_extreme - start_extreme)
    rounding = 1e-6 * step
    begin = int(np.searchsorted(time, time[start_extreme] + dwells[0] - rounding))
    end = int(np.searchsorted(time, time[stop_extreme] - dwells[1] - rounding))
    if begin >= end:  # the dwells of a stroke within noise are unknown
        begin, end = start_extreme, stop_extreme
    return Stroke(begin, end, sign)


@dataclass(frozen=True, slots=True)
class _ExtremeSide:
    """Times of a motion near an extreme, on one side of it.

    Parameters
    ----------
    near_time, wide_time : time within a tolerance of the extreme, and within four times that
        tolerance, s
    shortest_dwell : shortest dwell that differs from a corner, s
    """

    near_time: float
    wide_time: float
    shortest_dwell: float

    @property
    def dwell(self) -> float:
        """Duration of the dwell on this side of the extreme, s."""
        return max(0.0, (4.0 * self.near_time - self.wide_time) / 3.0)


def _measure_extreme(
    time: Floats, motion: Floats, ends: tuple[int, int | None], tolerance: float
) -> _ExtremeSide | None:
    """Measure the times near an extreme on the side of its neighbour; None without a neighbour."""
    # The tolerance is at least the first fraction of the travel to the neighbour. A dwell is at
    # least the second fraction of the time to the neighbour, and at least a number of samples.
    min_tolerance_fraction, min_dwell_fraction, min_dwell_samples = 1e-4, 0.005, 5.0
    turn, neighbour = ends
    if neighbour is None:
        return None
    samples = np.arange(turn, neighbour, 1 if neighbour > turn else -1)
    samples = np.append(samples, neighbour)
    duration, travel = (np.abs(values[samples] - values[turn]) for values in (time, motion))
    tolerance = max(tolerance, min_tolerance_fraction * float(travel[-1]))
    near_time, wide_time = (float(duration[travel <= k * tolerance][-1]) for k in (1.0, 4.0))
    dwell_fraction = max(min_dwell_fraction, min_dwell_samples / abs(neighbour - turn))
    return _ExtremeSide(near_time, wide_time, float(duration[-1]) * dwell_fraction)


def _compute_dwell_times(
    side_before: _ExtremeSide | None, side_after: _ExtremeSide | None
) -> tuple[float, float]:
    """Compute the durations, s, of the dwell before and after an extreme.

    The extreme may be anywhere in the dwell. At an end of the motion, which has one side only, any
    rest is a dwell.
    """
    sides = [side for side in (side_before, side_after) if side is not None]
    near_time, wide_time = sum(s.near_time for s in sides), sum(s.wide_time for s in sides)
    shortest_dwell = min(side.shortest_dwell for side in sides) if len(sides) > 1 else 0.0
    is_dwell = 2.0 * near_time - wide_time > shortest_dwell
    if not is_dwell or (len(sides) > 1 and not wide_time < 1.5 * near_time):
        return 0.0, 0.0
    dwell_before = 0.0 if side_before is None else side_before.dwell
    return dwell_before, 0.0 if side_after is None else side_after.dwell


def split_branches(
    time: Floats, strokes: tuple[Stroke, ...], *, turning_times: Floats | None = None
) -> tuple[Branch, ...]:
    """Convert strokes to the loading and unloading branches of cycles.

    Parameters
    ----------
    time : shape (n,), s, times of the samples
    strokes : strokes in order of time
    turning_times : shape (strokes, 2), s, start and stop of each stroke, which may lie between
        samples; NaN where they are not known

    Returns
    -------
    One branch per stroke. The direction of the first stroke is loading; a cycle is a loading branch
    and the next unloading branch.
    """
    branches = []
    for index, stroke in enumerate(strokes):
        ends = time[[stroke.start, stroke.stop]]
        if turning_times is not None:
            ends = np.where(np.isnan(turning_times[index]), ends, turning_times[index])
        direction = Direction.LOADING if stroke.sign == strokes[0].sign else Direction.UNLOADING
        stop = stroke.stop + (index == len(strokes) - 1)  # the last branch has its last sample
        branches.append(Branch(stroke.start, stop, index // 2 + 1, direction, *ends.tolist()))
    return tuple(branches)


def find_sharpest_turn(time: Floats, values: Floats, *, width: float) -> float | None:
    """Find the time at which the slope of a signal drops most.

    Parameters
    ----------
    time, values : shape (n,), times (s) and values (any unit) of the signal; NaN are ignored
    width : time over which the slopes before and after are computed, s

    Returns
    -------
    The time, s; None if the record is shorter than two widths, or if it does not rise above the
    noise and then fall.

    Notes
    -----
    At this time the mean slopes over `width` before and after differ most, at a level above 0.3 of
    the range. The time of the largest value is not used, since the largest force of a bundle in
    large deflection can be before the turn of the motion. A range below ten standard deviations of
    the noise of the averages contains no turn.
    """
    # The range of a thousand values of white noise is only seven standard deviations.
    range_noise_factor = 10.0
    # Turns below this fraction of the range are noise, or the first contact of the load frame.
    min_height_fraction = 0.3
    levels = _average_blocks_of_width(time, values, width)
    if levels is None:
        return None
    middles, level = levels
    if np.ptp(level) < range_noise_factor * estimate_noise_level(level):
        return None
    drops, rise_after = _compute_slope_drops(level)
    inner = level[_BLOCKS_PER_WIDTH:-_BLOCKS_PER_WIDTH] - level.min()
    drop = np.where((rise_after < 0.0) & (inner > min_height_fraction * np.ptp(level)), drops, 0.0)
    sharpest = int(np.argmax(drop))
    return float(middles[sharpest + _BLOCKS_PER_WIDTH]) if drop[sharpest] > 0.0 else None


def find_turn_near(
    time: Floats, values: Floats, *, middle: float, reach: float, width: float, dwell: float
) -> float | None:
    """Find the approximate time at which a signal stops rising before a known dwell.

    Parameters
    ----------
    time, values : shape (n,), times (s) and values (any unit) of the signal; NaN are ignored
    middle : middle of the searched range, s
    reach : half width of the searched range, s
    width : time over which the slopes before and after a corner are computed, s
    dwell : time between the corners, s; 0 for a signal without dwell

    Returns
    -------
    The time of the first corner, s; None if the record in the range is too short.

    Notes
    -----
    At this time, the sum of the drops of slope at both corners is largest. One corner alone could
    be mistaken for the other, since the slope drops more at the beginning of a steep fall than at
    the end of a rise. Slopes are computed over at most the dwell, but at least 0.3 of the width.
    """
    min_width_fraction = 0.3
    width = width * min(1.0, max(min_width_fraction, dwell / width)) if dwell > 0.0 else width
    in_reach = slice(*np.searchsorted(time, [middle - reach - width, middle + reach + width]))
    levels = _average_blocks_of_width(time[in_reach], values[in_reach], width)
    if levels is None:
        return None
    middles, level = levels
    times, (drops, _) = middles[_BLOCKS_PER_WIDTH:-_BLOCKS_PER_WIDTH], _compute_slope_drops(level)
    sums = drops + np.interp(times + dwell, times, drops, right=-np.inf)
    return float(times[int(np.argmax(sums))]) if np.isfinite(sums).any() else None


def _average_blocks_of_width(
    time: Floats, values: Floats, width: float
) -> tuple[Floats, Floats] | None:
    """Average blocks of a twentieth of a width; return their middle times, s, and their means.

    Return None for a record shorter than two widths.
    """
    valid = ~np.isnan(values)
    edges = np.arange(time[0], time[-1], width / _BLOCKS_PER_WIDTH) if valid.any() else np.zeros(0)
    if len(edges) < 2 * _BLOCKS_PER_WIDTH + 2:
        return None
    blocks = np.searchsorted(edges, time[valid], side="right") - 1
    counts = np.bincount(blocks, minlength=len(edges)).astype(np.float64)
    is_filled = counts > 0
    sums = np.bincount(blocks, values[valid], minlength=len(edges))
    middles = edges + 0.5 * width / _BLOCKS_PER_WIDTH
    return middles, np.interp(middles, middles[is_filled], sums[is_filled] / counts[is_filled])


def _compute_slope_drops(level: Floats) -> tuple[Floats, Floats]:
    """Compute the rise over a width before each inner level minus that after it, and the latter."""
    rise_before = level[_BLOCKS_PER_WIDTH:-_BLOCKS_PER_WIDTH] - level[: -2 * _BLOCKS_PER_WIDTH]
    rise_after = level[2 * _BLOCKS_PER_WIDTH :] - level[_BLOCKS_PER_WIDTH:-_BLOCKS_PER_WIDTH]
    return rise_before - rise_after, rise_after


def moves_at_end(time: Floats, positions: Floats) -> bool:
    """Return whether a motion continues at its last sample.

    Parameters
    ----------
    time, positions : shape (n,), times (s) and positions (any unit) of the motion, without NaN

    Returns
    -------
    Whether a straight line through the last samples has the direction of the motion, and at least
    half of its mean speed. False for fewer than three samples, or equal first and last positions.

    Notes
    -----
    The line is fitted to as few samples as noise and resolution allow, but to at least three, and
    at most to about a third of all samples.
    """
    min_end_speed, max_error = 0.5, 0.15  # of the speed at the end; fractions of the mean speed
    travel = float(positions[-1] - positions[0])
    duration = float(time[-1] - time[0])
    if len(positions) < 3 or travel == 0.0 or not duration > 0.0:
        return False
    mean_speed, steps = abs(travel) / duration, np.abs(np.diff(positions))
    resolution = float(steps[steps > 1e-9 * abs(travel)].min())
    noise_level = max(estimate_noise_level(positions), resolution / sqrt(12.0))
    time_step = compute_median_step(time)
    fit_samples, max_fit_samples = 3, len(positions) // 3
    while (
        fit_samples < max_fit_samples
        and noise_level * sqrt(12.0 / fit_samples**3) / time_step > max_error * mean_speed
    ):
        fit_samples += max(1, fit_samples // 4)
    centred_time = time[-fit_samples:] - time[-fit_samples:].mean()
    end_speed = float(centred_time @ positions[-fit_samples:]) / float(centred_time @ centred_time)
    return end_speed * float(np.sign(travel)) >= min_end_speed * mean_speed


def count_rest_samples(values: Floats) -> int:
    """Count the samples of a signal before its motion begins.

    Parameters
    ----------
    values : shape (n,), evenly sampled, without NaN; a rest can only be at the beginning

    Returns
    -------
    Number of samples before the corner between a constant level and a straight line; 0 if one
    straight line fits as well, because the signal has only rest or only motion.

    Notes
    -----
    The corner is that with the smallest sum of squares of up to 200 candidates. It is accepted if
    it reduces the sum of squares of one straight line by more than 25 variances of the residuals.
    Since noise may be autocorrelated, it must also reduce this sum by more than half.
    """
    max_corners = 200
    min_gain_in_variances, min_gain_fraction = 25.0, 0.5
    count = len(values)
    if count < 5:
        return 0
    indices = np.arange(count, dtype=np.float64)
    centred = values - values.mean()
    line = indices - indices.mean()
    line_squares = float(centred @ centred) - float(line @ centred) ** 2 / float(line @ line)
    corners = np.unique(np.linspace(1, count - 2, min(count - 2, max_corners)).astype(np.int64))
    ramps = np.clip(indices - corners[:, None], 0.0, None)
    ramps -= ramps.mean(axis=1, keepdims=True)
    corner_squares = float(centred @ centred) - (ramps @ centred) ** 2 / np.sum(ramps**2, axis=1)
    corner = int(np.argmin(corner_squares))
    best_squares = float(corner_squares[corner])
    variance = max(best_squares, 0.0) / (count - 3)
    min_gain = max(min_gain_in_variances * variance, min_gain_fraction * line_squares)
    return int(corners[corner]) if line_squares - best_squares > min_gain else 0


def find_level_jumps(
    time: Floats, values: Floats, *, min_fraction: float = 0.02
) -> tuple[tuple[int, float], ...]:
    """Find the jumps of a signal, which are changes unlike the four changes on each side.

    Parameters
    ----------
    time, values : shape (n,), times (s, or row numbers) and values (any unit) of the signal; NaN
        are ignored, and a change across a gap at the usual speed is not a jump
    min_fraction : smallest jump as a fraction of the range of the values

    Returns
    -------
    The index of the first sample after each jump and the size of the jump (unit of `values`), in
    order of time. Jumps among the first or last four changes are not found, nor are jumps after
    which the signal returns within four changes.

    Notes
    -----
    The size of a jump is the change without the usual change, which is the median of the changes
    nearby. A corner is not a jump, because the changes after it are as fast. The loss of force at a
    failure is a jump, which the caller has to exclude.
    """
    # Multiples of the usual speed, of the largest deviation from it, and of the noise.
    speed_factor, deviation_factor, noise_factor = 2.0, 5.0, 8.0
    compared_steps = 4  # on each side of a jump
    finite_samples = np.flatnonzero(~np.isnan(values))
    finite_values = values[finite_samples]
    if len(finite_values) < 2 * compared_steps + 2:
        return ()
    durations = np.diff(time[finite_samples])
    speeds = np.diff(finite_values) / durations
    min_jump = min_fraction * float(np.ptp(finite_values))
    min_jump = max(min_jump, noise_factor * estimate_noise_level(finite_values))
    # The neighbours deviate from the usual speed by at most a fifth of a jump, so that they differ
    # from the jump by at least 0.8 of its size.
    differences = np.abs(np.diff(speeds))
    least_differences = np.minimum(differences[:-1], differences[1:])
    steps = np.flatnonzero(least_differences * durations[1:-1] > 0.8 * min_jump) + 1
    steps = steps[(steps >= compared_steps) & (steps < len(speeds) - compared_steps)]
    offsets = [offset for offset in range(-compared_steps, compared_steps + 1) if offset]
    nearby_speeds = speeds[steps[:, None] + offsets]
    usual_speed = np.median(nearby_speeds, axis=1)
    excess = speeds[steps] - usual_speed
    deviation = np.max(np.abs(nearby_speeds - usual_speed[:, None]), axis=1)
    limit = np.maximum(speed_factor * np.abs(usual_speed), deviation_factor * deviation)
    sizes = excess * durations[steps]
    is_jump = (np.abs(excess) > limit) & (np.abs(sizes) > min_jump)
    samples = finite_samples[steps[is_jump] + 1]
    return tuple(zip(samples.tolist(), sizes[is_jump].tolist(), strict=True))
