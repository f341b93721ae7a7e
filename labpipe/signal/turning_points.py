"""Split a motion into strokes, and find turning points, rests and jumps of signals."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from math import sqrt

import numpy as np

from labpipe.messages import format_sentence
from labpipe.records.arrays import Floats, compute_median_step, drop_missing, median
from labpipe.records.curve import Branch, Direction

_BLOCKS_PER_WIDTH = 20
"""Number of blocks in a width, over which a slope is computed.

The number is large enough for a first guess of a turn, and small enough to reduce noise.
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
    """Return whether a signal departs downwards from its level at the ends, and returns.

    Parameters
    ----------
    values : shape (n,), any unit; NaN are ignored

    Returns
    -------
    Whether the minimum is farther below the lower end than the maximum is above the higher end, by
    more than five standard deviations of the noise. An end is the mean of the first or last
    hundredth of the samples. False without any value.
    """
    noise_factor = 5.0
    valid_values = drop_missing(values)
    if not len(valid_values):
        return False
    n_end = max(1, len(valid_values) // 100)
    levels = float(valid_values[:n_end].mean()), float(valid_values[-n_end:].mean())
    rise, fall = float(valid_values.max()) - max(levels), min(levels) - float(valid_values.min())
    # The noise level is computed last, because it is slow.
    return fall > rise and fall - rise > noise_factor * estimate_noise_level(valid_values)


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
    The result is the median absolute second difference divided by 0.6745 sqrt(6). Slopes have no
    effect on it, and corners and jumps hardly any. NaN are ignored.
    """
    differences = drop_missing(np.diff(values, n=2))
    if len(differences) < 3:
        return 0.0
    return median(np.abs(differences)) / (0.6745 * sqrt(6.0))


def compute_step_quantile(values: Floats, quantile: float) -> float:
    """Compute a quantile of the absolute changes from sample to sample that are not zero.

    Parameters
    ----------
    values : shape (n,), samples in any unit; NaN and rounding errors are ignored
    quantile : fraction of the changes below the result, from 0 to 1

    Returns
    -------
    The quantile in the unit of `values`; 0 for fewer than 20 changes. Of more than 100 000 changes,
    every k-th is used.
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
    The strokes in order. Successive strokes share the sample at the turn between them, but a dwell
    at the turn belongs to neither. There are no strokes in a motion smaller than `min_stroke`, or
    of fewer than three samples.

    Raises
    ------
    ValueError
        If `min_stroke` is not positive.

    Notes
    -----
    An extreme is a turning point if the motion returns from it by `min_stroke`. Let t1 and t4 be
    the durations in which the motion is within a tolerance of an extreme, and within four times
    that tolerance, on both sides together. A corner has t4 = 4 t1, a parabola t4 = 2 t1, and a
    dwell t4 < 1.5 t1. NaN are replaced by linear interpolation.
    """
    if not min_stroke > 0:
        raise ValueError(format_sentence("signal.bad_stroke", min_stroke=min_stroke))
    is_valid = ~np.isnan(motion)
    if is_valid.sum() < 3:
        return ()
    if not is_valid.all():
        motion = np.interp(time, time[is_valid], motion[is_valid])
    extremes = _find_extremes(motion, min_stroke)
    if not extremes:
        return ()
    tolerance = 5.0 * estimate_noise_level(motion)
    dwells = []  # durations before and after each extreme
    for turn, *neighbours in zip(extremes, [None, *extremes], [*extremes[1:], None], strict=False):
        sides = [_measure_extreme(time, motion, (turn, other), tolerance) for other in neighbours]
        dwells.append(_compute_dwell_times(*sides))
    return tuple(
        _make_stroke(time, motion, pair, (first[1], second[0]))
        for pair, (first, second) in zip(pairwise(extremes), pairwise(dwells), strict=True)
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
    start = int(np.argmax(spread >= min_stroke))
    sign = 1 if values[start] == values[: start + 1].max() else -1
    extremes = [int(np.argmin(sign * values[: start + 1]))]
    return_sample: int | None = start
    while return_sample is not None:
        extreme, return_sample = _find_next_turn(sign * values, return_sample, min_stroke)
        extremes.append(extreme)
        sign = -sign
    return [index * stride for index in extremes]


def _find_next_turn(values: Floats, start: int, min_stroke: float) -> tuple[int, int | None]:
    """Find the next maximum, and the sample at which the values have returned by `min_stroke`.

    The second result is None if the values do not return. Searching stretches of doubling length
    makes the search time proportional to the length of the record.
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


def _make_stroke(
    time: Floats, motion: Floats, extremes: tuple[int, int], dwells: tuple[float, float]
) -> Stroke:
    """Make the stroke between two extremes, without the dwells, s, at its start and its end."""
    start_extreme, stop_extreme = extremes
    sign = 1 if motion[stop_extreme] > motion[start_extreme] else -1
    step = float(time[stop_extreme] - time[start_extreme]) / (stop_extreme - start_extreme)
    rounding = 1e-6 * step
    start = int(np.searchsorted(time, time[start_extreme] + dwells[0] - rounding))
    stop = int(np.searchsorted(time, time[stop_extreme] - dwells[1] - rounding))
    if start >= stop:  # the dwells of a stroke within noise are unknown
        start, stop = start_extreme, stop_extreme
    return Stroke(start, stop, sign)


@dataclass(frozen=True, slots=True)
class _ExtremeSide:
    """Durations of a motion near an extreme, on one side of the extreme.

    Parameters
    ----------
    near_time : duration within a tolerance of the extreme, s
    wide_time : duration within four times that tolerance, s
    shortest_dwell : shortest dwell that can be distinguished from a corner, s
    """

    near_time: float
    wide_time: float
    shortest_dwell: float

    @property
    def dwell(self) -> float:
        """Duration of the dwell on this side of the extreme, s."""
        return max(0.0, (4.0 * self.near_time - self.wide_time) / 3.0)


def _measure_extreme(
    time: Floats, motion: Floats, extremes: tuple[int, int | None], tolerance: float
) -> _ExtremeSide | None:
    """Measure the durations near an extreme, between this extreme and the neighbouring one.

    `extremes` are the samples of both. Return None without a neighbouring extreme.
    """
    # The tolerance is at least a fraction of the travel to the neighbour. A dwell takes at least a
    # fraction of the time to the neighbour, and at least a number of samples.
    min_tolerance_fraction, min_dwell_fraction, min_dwell_samples = 1e-4, 0.005, 5.0
    turn, neighbour = extremes
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

    The extreme may be anywhere in the dwell. An end of the motion has one side only, and any rest
    there is a dwell.
    """
    sides = [side for side in (side_before, side_after) if side is not None]
    near_time, wide_time = sum(s.near_time for s in sides), sum(s.wide_time for s in sides)
    shortest_dwell = min(side.shortest_dwell for side in sides) if len(sides) > 1 else 0.0
    is_dwell = 2.0 * near_time - wide_time > shortest_dwell
    if not is_dwell or (len(sides) > 1 and not wide_time < 1.5 * near_time):
        return 0.0, 0.0
    dwell_before = 0.0 if side_before is None else side_before.dwell
    return dwell_before, 0.0 if side_after is None else side_after.dwell


def make_branches(
    time: Floats, strokes: tuple[Stroke, ...], *, turning_times: Floats | None = None
) -> tuple[Branch, ...]:
    """Make the loading and unloading branches of cycles from strokes.

    Parameters
    ----------
    time : shape (n,), s, times of the samples
    strokes : strokes in order of time
    turning_times : shape (strokes, 2), s, start and stop of each stroke, which may lie between
        samples; NaN where they are not known

    Returns
    -------
    One branch for each stroke. The first stroke has the direction of loading. A cycle is a loading
    branch and the next unloading branch.
    """
    branches = []
    for index, stroke in enumerate(strokes):
        times = time[[stroke.start, stroke.stop]]
        if turning_times is not None:
            times = np.where(np.isnan(turning_times[index]), times, turning_times[index])
        direction = Direction.LOADING if stroke.sign == strokes[0].sign else Direction.UNLOADING
        stop = stroke.stop + (index == len(strokes) - 1)  # only the last branch ends with its stop
        ends = {"start_time": float(times[0]), "stop_time": float(times[1])}
        branches.append(Branch(stroke.start, stop, index // 2 + 1, direction, **ends))
    return tuple(branches)


def find_sharpest_turn(time: Floats, values: Floats, *, width: float) -> float | None:
    """Find the time at which the slope of a signal drops most, and the signal then falls.

    Parameters
    ----------
    time, values : shape (n,), times (s) and values (any unit) of the signal; NaN are ignored
    width : time over which the slopes before and after a turn are computed, s

    Returns
    -------
    The time, s; None if the record is shorter than two widths, or if the signal does not rise above
    the noise and then fall.

    Notes
    -----
    The mean slopes over `width` before and after this time differ most among all times at which the
    signal is higher than 0.3 of its range. The time of the largest value is not used, since the
    largest force of a bundle in large deflection can be before the turn of the motion. A range
    below ten standard deviations of the noise of the block means contains no turn.
    """
    # The range of a thousand values of white noise is only seven standard deviations.
    range_noise_factor = 10.0
    # A turn below this fraction of the range is noise, or the first contact of the load frame.
    min_height_fraction = 0.3
    blocks = _average_blocks_of_width(time, values, width)
    if blocks is None:
        return None
    middles, levels = blocks
    if np.ptp(levels) < range_noise_factor * estimate_noise_level(levels):
        return None
    slope_drops, rises_after = _compute_slope_drops(levels)
    heights = levels[_BLOCKS_PER_WIDTH:-_BLOCKS_PER_WIDTH] - levels.min()
    is_turn = (rises_after < 0.0) & (heights > min_height_fraction * np.ptp(levels))
    slope_drops = np.where(is_turn, slope_drops, 0.0)
    sharpest = int(np.argmax(slope_drops))
    return float(middles[sharpest + _BLOCKS_PER_WIDTH]) if slope_drops[sharpest] > 0.0 else None


def find_dwell_turn(
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
    At this time, the sum of the drops of slope at both corners is largest. With only one corner,
    the second could be mistaken for the first, since the slope drops more at the beginning of a
    steep fall than at the end of a rise. Slopes are computed over the dwell if it is shorter than
    `width`, but over at least 0.3 of `width`.
    """
    min_width_fraction = 0.3
    width = width * min(1.0, max(min_width_fraction, dwell / width)) if dwell > 0.0 else width
    samples = slice(*np.searchsorted(time, [middle - reach - width, middle + reach + width]))
    blocks = _average_blocks_of_width(time[samples], values[samples], width)
    if blocks is None:
        return None
    times, (slope_drops, _) = blocks[0], _compute_slope_drops(blocks[1])
    times = times[_BLOCKS_PER_WIDTH:-_BLOCKS_PER_WIDTH]
    sums = slope_drops + np.interp(times + dwell, times, slope_drops, right=-np.inf)
    return float(times[int(np.argmax(sums))]) if np.isfinite(sums).any() else None


def _average_blocks_of_width(
    time: Floats, values: Floats, width: float
) -> tuple[Floats, Floats] | None:
    """Average blocks of a twentieth of a width; return their middle times, s, and their means.

    The means of empty blocks are interpolated. Return None for a record shorter than two widths.
    """
    is_valid, block_width = ~np.isnan(values), width / _BLOCKS_PER_WIDTH
    edges = np.arange(time[0], time[-1], block_width) if is_valid.any() else np.zeros(0)
    if len(edges) < 2 * _BLOCKS_PER_WIDTH + 2:
        return None
    blocks = np.searchsorted(edges, time[is_valid], side="right") - 1
    counts = np.bincount(blocks, minlength=len(edges)).astype(np.float64)
    is_filled = counts > 0
    sums = np.bincount(blocks, values[is_valid], minlength=len(edges))
    middles = edges + 0.5 * block_width
    return middles, np.interp(middles, middles[is_filled], sums[is_filled] / counts[is_filled])


def _compute_slope_drops(levels: Floats) -> tuple[Floats, Floats]:
    """Compute the drop of slope at each level that is a width or more from both ends.

    The drop is the rise over the width before the level minus the rise over the width after it.
    Return the drops and the rises after the levels.
    """
    rises = levels[_BLOCKS_PER_WIDTH:] - levels[:-_BLOCKS_PER_WIDTH]
    rises_after = rises[_BLOCKS_PER_WIDTH:]
    return rises[:-_BLOCKS_PER_WIDTH] - rises_after, rises_after


def moves_at_end(time: Floats, positions: Floats) -> bool:
    """Return whether a motion continues at its last sample.

    Parameters
    ----------
    time, positions : shape (n,), times (s) and positions (any unit) of the motion, without NaN

    Returns
    -------
    Whether a straight line through the last samples has the direction of the motion, and at least
    half of the mean speed. False for fewer than three samples, or equal first and last positions.

    Notes
    -----
    The line is fitted to as few samples as noise and resolution allow, but to at least three, and
    at most to about a third of all samples.
    """
    # Limits of the speed at the end, and of its standard error, as fractions of the mean speed.
    min_end_speed, max_error = 0.5, 0.15
    travel = float(positions[-1] - positions[0])
    duration = float(time[-1] - time[0])
    if len(positions) < 3 or travel == 0.0 or not duration > 0.0:
        return False
    mean_speed, steps = abs(travel) / duration, np.abs(np.diff(positions))
    resolution = float(steps[steps > 1e-9 * abs(travel)].min())
    noise = max(estimate_noise_level(positions), resolution / sqrt(12.0))
    time_step = compute_median_step(time)
    n_fit, max_fit = 3, len(positions) // 3  # numbers of samples to which the line is fitted
    while n_fit < max_fit and noise * sqrt(12.0 / n_fit**3) / time_step > max_error * mean_speed:
        n_fit += max(1, n_fit // 4)
    centred_time = time[-n_fit:] - time[-n_fit:].mean()
    end_speed = float(centred_time @ positions[-n_fit:]) / float(centred_time @ centred_time)
    return end_speed * float(np.sign(travel)) >= min_end_speed * mean_speed


def count_rest_samples(values: Floats) -> int:
    """Count the samples of a signal before its motion begins.

    Parameters
    ----------
    values : shape (n,), values in any unit, evenly sampled, without NaN

    Returns
    -------
    Number of samples before the corner between a constant level and a straight line; 0 if one
    straight line fits as well, because the signal has only rest or only motion.

    Notes
    -----
    Of up to 200 candidates, the corner with the smallest sum of squares is chosen. The corner is
    accepted if its sum of squares is below that of one straight line by more than 25 variances of
    the residuals and, since noise may be autocorrelated, by more than half.
    """
    max_corners = 200
    min_gain_in_variances, min_gain_fraction = 25.0, 0.5
    count = len(values)
    if count < 5:
        return 0
    indices = np.arange(count, dtype=np.float64)
    centred = values - values.mean()
    ramp = indices - indices.mean()
    line_squares = float(centred @ centred) - float(ramp @ centred) ** 2 / float(ramp @ ramp)
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
    """Find the jumps of a signal, which are changes unlike the four changes before and after.

    Parameters
    ----------
    time, values : shape (n,), times (s, or row numbers) and values (any unit) of the signal; NaN
        are ignored, and a change across NaN at the usual speed is not a jump
    min_fraction : smallest jump as a fraction of the range of the values

    Returns
    -------
    The index of the first sample after each jump and the size of the jump (unit of `values`), in
    order of time. Jumps among the first or last four changes are not found, nor are jumps after
    which the signal returns within four changes.

    Notes
    -----
    The size of a jump is the difference between the change and the usual change, which is computed
    from the median speed of the changes nearby. A corner is not a jump, because the changes after
    it are as fast. The loss of force at a failure is a jump, which the caller has to exclude.
    """
    # A jump exceeds these multiples of the usual speed, of the largest deviation from the usual
    # speed, and of the noise.
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
    # The changes next to a jump deviate from the usual speed by at most a fifth of the jump. They
    # therefore differ from the jump by at least 0.8 of its size.
    speed_differences = np.abs(np.diff(speeds))
    min_differences = np.minimum(speed_differences[:-1], speed_differences[1:])
    steps = np.flatnonzero(min_differences * durations[1:-1] > 0.8 * min_jump) + 1
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
