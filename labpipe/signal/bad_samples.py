"""Find invalid samples, which are runs of clipped or frozen values, spikes and dropouts."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import log, pi, sqrt

import numpy as np

from labpipe.records.arrays import Floats, Ints, median
from labpipe.signal.turning_points import compute_step_quantile, estimate_noise_level

_UNUSUAL_RUN_FACTOR = 4.0
"""Multiple of the usual run length above which a run is unusual."""
_JUMP_SPEED_FACTOR = 5.0
"""Multiple of the usual speed above which a step is a jump."""
_MIN_JUMP_FRACTION = 0.02
"""Smallest jump as a fraction of the range, and largest distance of a level at rest from zero."""
_MIN_NOISY_RUN = 10.0
"""Number of equal samples that a logger which repeats values does not reach in a noisy channel."""
_SPIKE_WINDOW = 7
"""Number of samples of the window in which a spike is compared with its neighbours."""
_MAX_SPIKE_SAMPLES = _SPIKE_WINDOW // 2
"""Largest number of consecutive samples of a spike."""
_MIN_SPIKE_FRACTION = 0.01
"""Smallest spike as a fraction of the range of the signal."""


@dataclass(frozen=True, slots=True)
class StuckRun:
    """Run of equal samples.

    Parameters
    ----------
    start, stop : indices of the first sample, and of the first sample after the run
    is_clipped : whether the channel has no value beyond the repeated value; otherwise the channel
        is frozen
    """

    start: int
    stop: int
    is_clipped: bool


def find_stuck_runs(
    time: Floats, values: Floats, paired_values: Floats | None = None
) -> list[StuckRun]:
    """Find runs in which a channel repeats a value although its quantity changes.

    Parameters
    ----------
    time : shape (n,), s, times of the samples
    values : shape (n,), values of the channel; a NaN ends a run
    paired_values : shape (n,), values of the other quantity of the test (the displacement for a
        force, the force for a displacement); None if it was not recorded

    Returns
    -------
    The runs, in order.

    Notes
    -----
    There are two criteria. In a noisy channel, a run is stuck if noise produces a run of this
    length in fewer than one of 10^6 records. In a quiet channel, the values must approach and leave
    the run steeply, by more than five steps of the resolution within half the length of the run,
    with at least 0.3 of the slope farther away. The other quantity must continue during the run. If
    the channel is clipped, or frozen up to the last sample, the other quantity must continue at
    about the same speed through both ends of the run. If the channel is frozen and then jumps, the
    other quantity must change by a fraction of the full range of that quantity. A machine at rest,
    a rounded peak, a plateau, creep under constant force, slack, and a coarse resolution are not
    reported.
    """
    min_run = 3  # samples; two equal samples occur at any corner
    is_equal = np.zeros(len(values) + 1, dtype=np.bool_)  # whether equal to the previous sample
    np.equal(values[1:], values[:-1], out=is_equal[1:-1])
    starts, stops = np.flatnonzero(is_equal[1:] != is_equal[:-1]).reshape(-1, 2).T
    lengths = stops - starts + 1
    candidates = np.flatnonzero(lengths >= min_run)
    if not len(candidates):
        return []
    extremes = float(np.nanmin(values)), float(np.nanmax(values))
    if not extremes[1] > extremes[0]:
        return []
    channel = _Channel(time, values, paired_values, starts, lengths, extremes)
    min_long_run = max(min_run, _UNUSUAL_RUN_FACTOR * channel.usual_run_length)
    long_runs = np.flatnonzero(lengths >= min_long_run)
    extreme_runs = candidates[np.isin(values[starts[candidates]], extremes)]
    stuck_runs = []
    for run in np.union1d(long_runs, extreme_runs).tolist():
        start, stop = int(starts[run]), int(starts[run] + lengths[run])
        is_clipped = float(values[start]) in extremes
        if channel.is_stuck(start, stop, is_clipped=is_clipped):
            stuck_runs.append(StuckRun(start, stop, is_clipped))
    return stuck_runs


@dataclass(frozen=True, eq=False)
class _Channel:
    """Channel, with the usual run length, speed and noise, which are computed on demand.

    Parameters
    ----------
    time, values, paired_values : arguments of `find_stuck_runs`
    starts, lengths : shape (runs,), first samples and lengths of the runs of two or more samples
    extremes : minimum and maximum of the values
    """

    time: Floats
    values: Floats
    paired_values: Floats | None
    starts: Ints
    lengths: Ints
    extremes: tuple[float, float]

    @property
    def full_range(self) -> float:
        """Difference of the extremes, in the unit of the channel."""
        return self.extremes[1] - self.extremes[0]

    @cached_property
    def usual_run_length(self) -> float:
        """95 % quantile of the run lengths, in samples; single samples are runs of length 1."""
        n_single = len(self.values) - np.count_nonzero(np.isnan(self.values)) - self.lengths.sum()
        rank = 0.95 * (n_single + len(self.lengths) - 1) - n_single
        ranks = np.arange(-1, len(self.lengths))
        return float(np.interp(rank, ranks, np.append(1, np.sort(self.lengths))))

    @cached_property
    def rounding_error(self) -> float:
        """Size up to which a step is a rounding error, in the unit of the channel."""
        max_rounding_fraction = 1e-7
        return min(max_rounding_fraction, 0.1 / len(self.values)) * self.full_range

    @cached_property
    def steps(self) -> tuple[Floats, Floats]:
        """Sizes of the steps above the rounding error, and durations of these steps, s."""
        steps = np.abs(np.diff(self.values))
        is_moving = steps > self.rounding_error  # False for NaN
        sizes = steps[is_moving]
        if not len(sizes):  # all changes are across gaps
            sizes, is_moving = np.array([self.full_range]), np.r_[True, is_moving[1:]]
        return sizes, np.maximum(np.diff(self.time)[is_moving], 1e-12)

    @cached_property
    def resolution(self) -> float:
        """Quantisation step of the channel, in the unit of the channel.

        If all values of a short record are on a grid, this is the step of the grid, and otherwise
        the rounding error. For a long record, it is the smallest step between neighbours.
        """
        max_grid_check_samples = 5000
        if len(self.values) > max_grid_check_samples:
            return float(self.steps[0].min())
        steps = np.diff(np.sort(self.values[~np.isnan(self.values)]))
        steps = steps[steps > self.rounding_error]
        multiples = steps / steps.min()
        is_on_grid = (np.abs(multiples - np.round(multiples)) < 0.1).all()
        return float(steps.min()) if is_on_grid else self.rounding_error

    @cached_property
    def usual_speed(self) -> float:
        """95 % quantile of the speeds of the steps, in the unit of the channel per second."""
        sizes, durations = self.steps
        return float(np.quantile(sizes / durations, 0.95))

    @cached_property
    def longest_noise_run(self) -> float:
        """Longest run that noise produces, in samples; infinite for a quiet channel."""
        is_unusual = self.lengths > _UNUSUAL_RUN_FACTOR * max(1.0, self.usual_run_length)
        is_used = ~np.isnan(self.values)
        for start, length in zip(self.starts[is_unusual], self.lengths[is_unusual], strict=True):
            is_used[start : start + length] = False
        return _compute_longest_noise_run(self.values[is_used], len(self.values), self.resolution)

    def is_stuck(self, start: int, stop: int, *, is_clipped: bool) -> bool:
        """Return whether a run repeats a value although its quantity changes."""
        min_clipped_at_rest = 100  # samples of a clipped run at rest
        if self._is_followed_by_jump(start, stop):
            return True
        is_at_rest = self._is_at_rest(start)
        if stop - start > _MIN_NOISY_RUN and stop - start > self.longest_noise_run:
            return not is_at_rest or (is_clipped and stop - start >= min_clipped_at_rest)
        if is_at_rest or (start > 0 and self._is_jump(start)):
            return False
        return (is_clipped or stop == len(self.values)) and self._interrupts_motion(start, stop)

    def _is_at_rest(self, sample: int) -> bool:
        """Return whether a sample is near zero or near the first value."""
        level, tolerance = float(self.values[sample]), _MIN_JUMP_FRACTION * self.full_range
        first_value = float(self.values[np.argmin(np.isnan(self.values))])
        return abs(level) <= tolerance or abs(level - first_value) <= tolerance

    def _is_followed_by_jump(self, start: int, stop: int) -> bool:
        """Return whether a jump follows the run while the other quantity moves smoothly."""
        if stop >= len(self.values):
            return False
        # When the specimen tears, the force drops in stages, so that a jump also precedes the run.
        if not self._is_jump(stop) or (start > 0 and self._is_jump(start)):
            return False
        # A coarse converter has long runs between its steps.
        usual_run_length = max(self.usual_run_length, self._count_previous_run(start))
        if stop - start <= _UNUSUAL_RUN_FACTOR * usual_run_length:
            return False
        if self.paired_values is None:  # at a failure of the specimen, the force drops to zero
            return stop - start >= _MIN_NOISY_RUN and not self._is_at_rest(stop)
        steps = np.abs(np.diff(self.paired_values))
        is_smooth = steps[stop - 1] <= _JUMP_SPEED_FACTOR * float(np.nanquantile(steps, 0.95))
        pair_travel = _compute_relative_travel(self.paired_values, start, stop)
        return bool(is_smooth) and pair_travel > _MIN_JUMP_FRACTION

    def _is_jump(self, sample: int) -> bool:
        """Return whether the step to a sample is much faster than the usual steps."""
        jump = abs(float(self.values[sample] - self.values[sample - 1]))
        duration = max(float(self.time[sample] - self.time[sample - 1]), 1e-12)
        min_jump = _MIN_JUMP_FRACTION * self.full_range
        return jump > min_jump and jump > _JUMP_SPEED_FACTOR * self.usual_speed * duration

    def _interrupts_motion(self, start: int, stop: int) -> bool:
        """Return whether the run has steep sides while the other quantity continues."""
        # Plateaus of measured forces have runs of at most this multiple of the usual run length.
        plateau_factor = 50.0
        min_travel, min_certain_run = 0.3, 8  # fraction of the full range; samples
        sides = [(start, -1)] if start >= 2 else []
        sides += [(stop - 1, 1)] if stop + 1 < len(self.values) else []
        paired_values, run_length = self.paired_values, stop - start
        if paired_values is None or not sides:
            return False
        keeps_speed = [_keeps_speed(self.time, paired_values, i, run_length) for i, _ in sides]
        # In a shorter run, the speed at one of the ends is uncertain.
        is_certain = run_length >= min_certain_run
        pair_continues = all(keeps_speed) if is_certain else any(keeps_speed)
        usual_run_length = max(self.usual_run_length, self._count_previous_run(start))
        is_long = run_length >= plateau_factor * usual_run_length
        has_travel = _compute_relative_travel(paired_values, start, stop) > min_travel
        # In a hold, the other quantity does not continue in the same direction.
        travel_before = float(paired_values[start] - paired_values[max(0, start - run_length)])
        travel_after = float(paired_values[start + run_length // 4] - paired_values[start])
        if is_long and has_travel and travel_before * travel_after > 0.0:
            return True
        is_steep = (self._leaves_steeply(sample, sign, run_length) for sample, sign in sides)
        return pair_continues and (is_long or all(is_steep))

    def _count_previous_run(self, start: int) -> int:
        """Count the samples of the run that ends before a sample.

        Runs become longer towards a plateau.
        """
        level = self.values[start - 1] if start else np.nan
        other_samples = np.flatnonzero(self.values[:start] != level)
        return start - 1 - int(other_samples[-1]) if len(other_samples) else start

    def _leaves_steeply(self, sample: int, direction: int, run_length: int) -> bool:
        """Return whether the channel leaves a sample steeply, forwards (1) or backwards (-1)."""
        # The rise within half the run length must exceed a number of steps of the resolution (a
        # rounded peak has 3) and a fraction of the range, below which missing values have no
        # effect. A rounded peak has a smaller ratio of the slope next to the run to the slope
        # farther away.
        min_rise_in_steps, min_rise_fraction, min_slope_ratio = 5.0, 0.005, 0.3
        max_reach = sample if direction < 0 else len(self.values) - 1 - sample
        reach = min(max(2, run_length // 2), max_reach)
        rise = np.abs(self.values[sample + direction * np.arange(reach + 1)] - self.values[sample])
        if reach < 2 or not np.isfinite(rise).all():
            return False
        half_reach = reach // 2
        far_slope = float(rise[-1] - rise[half_reach]) / (reach - half_reach)
        # The first step may be smaller, because a part of the change may be within the run.
        near_slope = max(float(rise[half_reach]) / half_reach, float(rise[2] - rise[1]))
        min_rise = min_rise_fraction * self.full_range
        is_far = rise[-1] > max(min_rise_in_steps * self.resolution, min_rise)
        return bool(is_far) and near_slope >= min_slope_ratio * far_slope


def _compute_relative_travel(values: Floats, start: int, stop: int) -> float:
    """Compute the range of a quantity in a run, as a fraction of its full range; 0 if unknown."""
    if np.isnan(values[start:stop]).all():
        return 0.0
    travel = float(np.nanmax(values[start:stop]) - np.nanmin(values[start:stop]))
    full_range = float(np.nanmax(values) - np.nanmin(values))
    return travel / full_range if full_range > 0.0 else 0.0


def _keeps_speed(time: Floats, values: Floats, sample: int, run_length: int) -> bool:
    """Return whether a quantity passes the end of a run at about constant speed."""
    min_speed_ratio, max_speed_ratio = 0.4, 2.5  # speed after over speed before the sample
    noise_factor = 5.0  # smallest travel, in standard deviations of the noise
    min_travel = noise_factor * estimate_noise_level(values)
    reach = max(1, min(run_length // 4, max(8, len(values) // 50)))
    samples = [max(0, sample - reach), sample, min(len(values) - 1, sample + reach)]
    travel, duration = np.diff(values[samples]), np.diff(time[samples])
    if not (np.abs(travel) > min_travel).all():  # also if a value is NaN
        return False
    speed_before, speed_after = travel / np.maximum(duration, 1e-12)
    return bool(min_speed_ratio <= speed_after / speed_before <= max_speed_ratio)


def _compute_longest_noise_run(values: Floats, n_samples: int, resolution: float) -> float:
    """Compute the run length that noise exceeds in one of 10^6 records; infinite without noise.

    Parameters
    ----------
    values : values of the channel without gaps and unusual runs
    n_samples : number of samples of the record
    resolution : quantisation step of the channel

    Returns
    -------
    The run length in samples.
    """
    false_alarm_rate, min_differences = 1e-6, 20  # for each record; number of third differences
    # Smallest ratio of the median third difference to the noise. For white noise, the ratio is
    # 0.6745 sqrt(20) = 3.0, and for a smooth curve far below 1.
    min_white_ratio = 2.0
    third_differences, noise = np.abs(np.diff(values, n=3)), estimate_noise_level(values)
    if len(third_differences) < min_differences:
        return float("inf")
    if not noise > resolution or median(third_differences) < min_white_ratio * noise:
        return float("inf")  # the channel has no noise, or is a smooth curve
    # Two neighbours have the same value with this probability, in spite of noise.
    equal_probability = resolution / (2.0 * sqrt(pi) * noise)
    return max(_MIN_NOISY_RUN, 1.0 + log(false_alarm_rate / n_samples) / log(equal_probability))


def find_spikes(force: Floats) -> Ints:
    """Find spikes and dropouts, which deviate from neighbours of about equal level.

    Parameters
    ----------
    force : shape (n,), N; NaN are ignored

    Returns
    -------
    The indices of the samples of spikes, in order. A spike has at most three consecutive samples.

    Notes
    -----
    The deviation from the median of seven samples must exceed eight robust standard deviations
    (1.4826 MAD), 1 % of the range of that median, 2.5 steps of a coarse resolution, and four times
    the largest step between the three neighbours on each side. The medians of the neighbours on
    both sides must differ by less than half the deviation, so that a permanent loss of force is not
    a spike. The first and last three samples have neighbours on one side only. There, the distance
    of a spike from the range of all medians must exceed this range.
    """
    mad_factor, resolution_factor = 8.0, 2.5
    max_medians = 20_000  # number of evenly spaced medians for range and deviation
    block_size = 8  # samples, more than half a window
    is_valid = ~np.isnan(force)
    f = force if is_valid.all() else force[is_valid]
    if len(f) < 2 * _SPIKE_WINDOW:
        return np.zeros(0, dtype=np.int64)
    half_window = _SPIKE_WINDOW // 2
    windows = np.lib.stride_tricks.sliding_window_view(f, _SPIKE_WINDOW)
    windows = windows[:: max(1, len(windows) // max_medians)]
    levels = np.median(windows, axis=1)
    # `records.arrays.median` is slow for few distinct values.
    mad = float(np.median(np.abs(windows[:, half_window] - levels)))
    min_deviation = max(
        mad_factor * 1.4826 * mad,
        _MIN_SPIKE_FRACTION * float(np.ptp(levels)),
        resolution_factor * compute_step_quantile(f, 0.1),  # steps of a coarse signal
    )
    # Only samples in a block whose range, with both neighbouring blocks, is large may be spikes.
    starts = np.arange(0, len(f), block_size)
    maxima = np.pad(np.maximum.reduceat(f, starts), 1, mode="edge")
    minima = np.pad(np.minimum.reduceat(f, starts), 1, mode="edge")
    highest = np.maximum(np.maximum(maxima[:-2], maxima[1:-1]), maxima[2:])
    lowest = np.minimum(np.minimum(minima[:-2], minima[1:-1]), minima[2:])
    is_candidate = np.repeat(highest - lowest > min_deviation, block_size)[: len(f)]
    candidates = np.flatnonzero(is_candidate)
    neighbours = candidates[:, None] + np.arange(-half_window, half_window + 1)
    candidate_windows = np.partition(f[np.clip(neighbours, 0, len(f) - 1)], half_window, axis=1)
    deviation = f[candidates] - candidate_windows[:, half_window]
    is_far = np.abs(deviation) > min_deviation
    indices, sizes = candidates[is_far], np.abs(deviation[is_far])
    spikes = [indices[:0]]
    for run in np.split(np.arange(len(indices)), np.flatnonzero(np.diff(indices) > 1) + 1):
        # A spike shifts the medians of the neighbours, which deviate less and are excluded.
        core = run[sizes[run] > 0.3 * sizes[run].max(initial=0.0)]
        if len(core) and _is_spike(f, indices[core], float(sizes[core].min())):
            spikes.append(indices[core])
    end_samples = np.r_[:half_window, len(f) - half_window : len(f)]
    distance = np.maximum(f[end_samples] - levels.max(), levels.min() - f[end_samples])
    spikes.append(end_samples[distance > max(float(np.ptp(levels)), min_deviation)])
    samples = np.sort(np.concatenate(spikes))
    return samples if is_valid.all() else np.flatnonzero(is_valid)[samples]


def bridge_spikes(force: Floats, spikes: Ints) -> Floats:
    """Replace spikes by linear interpolation between their neighbours.

    Parameters
    ----------
    force : shape (n,), N; NaN remain NaN and are not used as neighbours
    spikes : indices of the samples of spikes, from `find_spikes`

    Returns
    -------
    Shape (n,), N, force without spikes, in a new array.
    """
    other_samples = np.setdiff1d(np.flatnonzero(~np.isnan(force)), spikes, assume_unique=True)
    bridged_force = force.copy()
    bridged_force[spikes] = np.interp(spikes, other_samples, force[other_samples])
    return bridged_force


def _is_spike(force: Floats, run: Ints, deviation: float) -> bool:
    """Return whether a run of deviating samples is short, with similar levels on both sides."""
    # The deviation must exceed this multiple of the largest step of the neighbours, so that a sharp
    # turn is not a spike.
    spike_step_factor = 4.0
    first_sample, last_sample = int(run[0]), int(run[-1])
    values_before = force[max(first_sample - _MAX_SPIKE_SAMPLES, 0) : first_sample]
    values_after = force[last_sample + 1 : last_sample + 1 + _MAX_SPIKE_SAMPLES]
    n_neighbours = min(len(values_before), len(values_after))
    if last_sample - first_sample >= _MAX_SPIKE_SAMPLES or n_neighbours < _MAX_SPIKE_SAMPLES:
        return False
    step = max(float(np.abs(np.diff(side)).max()) for side in (values_before, values_after))
    level_change = abs(median(values_after) - median(values_before))
    return deviation > spike_step_factor * step and level_change < 0.5 * deviation
