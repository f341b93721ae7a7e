"""Find invalid samples: clipped or frozen channels, spikes and dropouts."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import log, pi, sqrt

import numpy as np

from labpipe.records.arrays import Flags, Floats, Ints, median
from labpipe.signal.turning_points import convert_to_noise, estimate_noise_level

_UNUSUAL_RUN_FACTOR = 4.0
"""Multiple of the usual run length above which a run is unusual."""
_JUMP_SPEED_FACTOR = 5.0
"""Multiple of the usual speed above which a step is a jump."""
_MIN_JUMP_SHARE = 0.02
"""Share of the range: smaller jumps are harmless, and levels closer to zero are at rest."""
_MIN_NOISY_RUN = 10.0
"""Number of equal samples; a logger that repeats values produces fewer in a noisy channel."""
_SPIKE_WINDOW = 7
_MAX_SPIKE_SAMPLES = _SPIKE_WINDOW // 2
_MIN_SPIKE_SHARE = 0.01
"""Share of the range of the signal: smaller spikes are harmless."""


@dataclass(frozen=True, slots=True)
class StuckRun:
    """A run of equal samples.

    Parameters
    ----------
    start, stop : samples, `stop` excluded
    is_clipped : whether the channel has no value beyond the repeated one; else it is frozen
    """

    start: int
    stop: int
    is_clipped: bool


def find_stuck_runs(time: Floats, values: Floats, paired: Floats | None = None) -> list[StuckRun]:
    """Find runs in which a channel repeats a value although its quantity changes.

    Parameters
    ----------
    time : shape (n,), s
    values : shape (n,), of the channel; a NaN ends a run
    paired : shape (n,), other quantity of the test (the displacement for a force, the force for a
        displacement); None if it was not recorded

    Returns
    -------
    The runs, in order.

    Notes
    -----
    There are two criteria. In a noisy channel a run counts if noise produces one of its length in
    fewer than one of 10^6 records. In a quiet channel the values must approach and leave the run
    steeply: by more than five steps of the resolution within half its length, with at least 0.3 of
    the slope farther away. Meanwhile `paired` must continue: at about its previous speed through
    both ends, for a channel that is clipped or frozen up to the last sample; by a part of its
    range, for a frozen channel that then jumps. A machine at rest, a rounded peak, a plateau, creep
    under constant force, slack, and a coarse resolution are not reported.
    """
    min_run = 3  # two equal samples occur at any corner
    starts, lengths = _find_equal_runs(values)
    channel = _Channel(time, values, paired, starts, lengths)
    if not (lengths >= min_run).any() or not channel.high > channel.low:
        return []
    long = np.flatnonzero(lengths >= max(min_run, _UNUSUAL_RUN_FACTOR * channel.usual))
    candidates = np.flatnonzero(lengths >= min_run)
    extreme = candidates[channel.is_extreme(starts[candidates])]
    stuck_runs = []
    for run in np.union1d(long, extreme).tolist():
        start, stop = int(starts[run]), int(starts[run] + lengths[run])
        is_clipped = bool(channel.is_extreme(np.array([start]))[0])
        if channel.is_stuck(start, stop, is_clipped=is_clipped):
            stuck_runs.append(StuckRun(start, stop, is_clipped))
    return stuck_runs


def _find_equal_runs(values: Floats) -> tuple[Ints, Ints]:
    """Return first samples and lengths of the runs of two or more equal values."""
    is_equal = np.zeros(len(values) + 1, dtype=np.bool_)  # to the previous sample
    np.equal(values[1:], values[:-1], out=is_equal[1:-1])
    starts, stops = np.flatnonzero(is_equal[1:] != is_equal[:-1]).reshape(-1, 2).T
    return starts, stops - starts + 1


@dataclass(frozen=True, eq=False)
class _Channel:
    """A channel with its usual run length, speed and noise, computed on demand.

    Parameters
    ----------
    time, values, paired : as for `find_stuck_runs`
    starts, lengths : shape (runs,), first samples and lengths of the runs of two or more samples
    """

    time: Floats
    values: Floats
    paired: Floats | None
    starts: Ints
    lengths: Ints

    @cached_property
    def usual(self) -> float:
        """Return the 95 % quantile of the run lengths, single samples included, in samples."""
        n_single = len(self.values) - np.count_nonzero(np.isnan(self.values)) - self.lengths.sum()
        rank = 0.95 * (n_single + len(self.lengths) - 1) - n_single
        return float(
            np.interp(rank, np.arange(-1, len(self.lengths)), np.append(1, np.sort(self.lengths)))
        )

    @cached_property
    def low(self) -> float:
        """Return the minimum."""
        return float(np.nanmin(self.values))

    @cached_property
    def high(self) -> float:
        """Return the maximum."""
        return float(np.nanmax(self.values))

    @cached_property
    def rounding(self) -> float:
        """Return the largest size of a step that is only rounding."""
        rounding_share = 1e-7
        return min(rounding_share, 0.1 / len(self.values)) * (self.high - self.low)

    @cached_property
    def steps(self) -> tuple[Floats, Floats]:
        """Return the sizes of the steps above the rounding, and their durations in s."""
        steps = np.abs(np.diff(self.values))
        moving = steps > self.rounding  # False for NaN
        sizes = steps[moving]
        if not len(sizes):  # all changes lie across gaps
            sizes, moving = np.array([self.high - self.low]), np.r_[True, moving[1:]]
        return sizes, np.maximum(np.diff(self.time)[moving], 1e-12)

    @cached_property
    def resolution(self) -> float:
        """Return the quantisation step."""
        return _find_resolution(self.values, self.steps[0], self.rounding)

    @cached_property
    def speed(self) -> float:
        """Return the 95 % quantile of the speeds of the steps."""
        sizes, durations = self.steps
        return float(np.quantile(sizes / durations, 0.95))

    @cached_property
    def longest_by_chance(self) -> float:
        """Return the longest run that noise produces, in samples; infinite for a quiet channel."""
        is_unusual = self.lengths > _UNUSUAL_RUN_FACTOR * max(1.0, self.usual)
        is_used = ~np.isnan(self.values)
        for start, length in zip(self.starts[is_unusual], self.lengths[is_unusual], strict=True):
            is_used[start : start + length] = False
        return _compute_longest_noise_run(self.values[is_used], len(self.values), self.resolution)

    def is_extreme(self, samples: Ints) -> Flags:
        """Return whether samples have the minimum or the maximum value."""
        return np.asarray((self.values[samples] == self.low) | (self.values[samples] == self.high))

    def is_stuck(self, start: int, stop: int, *, is_clipped: bool) -> bool:
        """Return whether a run repeats a value although its quantity changes."""
        min_clipped_at_rest = 100  # samples
        if self._jumps_after(start, stop):
            return True
        is_at_rest = self._is_at_rest(start)
        if stop - start > _MIN_NOISY_RUN and stop - start > self.longest_by_chance:
            return not is_at_rest or (is_clipped and stop - start >= min_clipped_at_rest)
        if is_at_rest or (start > 0 and self._is_jump(start)):
            return False
        return (is_clipped or stop == len(self.values)) and self._interrupts_motion(start, stop)

    @cached_property
    def first(self) -> float:
        """Return the first valid value."""
        return float(self.values[np.argmin(np.isnan(self.values))])

    def _is_at_rest(self, sample: int) -> bool:
        level, tolerance = float(self.values[sample]), _MIN_JUMP_SHARE * (self.high - self.low)
        return abs(level) <= tolerance or abs(level - self.first) <= tolerance

    def _jumps_after(self, start: int, stop: int) -> bool:
        """Return whether a jump follows the run while the other quantity moves smoothly."""
        if stop >= len(self.values):
            return False
        if not self._is_jump(stop) or (start > 0 and self._is_jump(start)):
            return False  # a force that drops in stages at a tear of the specimen
        if stop - start <= _UNUSUAL_RUN_FACTOR * max(self.usual, self._previous_run(start)):
            return False  # a step of a coarse converter
        if self.paired is None:  # at a failure of the specimen, the force drops to zero
            return stop - start >= _MIN_NOISY_RUN and not self._is_at_rest(stop)
        steps = np.abs(np.diff(self.paired))
        is_smooth = steps[stop - 1] <= _JUMP_SPEED_FACTOR * float(np.nanquantile(steps, 0.95))
        return bool(is_smooth) and self._paired_travel(start, stop) > _MIN_JUMP_SHARE

    def _is_jump(self, sample: int) -> bool:
        """Return whether the step to a sample is far faster than the usual ones."""
        jump = abs(float(self.values[sample] - self.values[sample - 1]))
        duration = max(float(self.time[sample] - self.time[sample - 1]), 1e-12)
        min_jump = _MIN_JUMP_SHARE * (self.high - self.low)
        return jump > min_jump and jump > _JUMP_SPEED_FACTOR * self.speed * duration

    def _paired_travel(self, start: int, stop: int) -> float:
        """Return the travel of the other quantity during the run, as a share of its range."""
        if self.paired is None or np.isnan(self.paired[start:stop]).all():
            return 0.0
        travel, full_range = (
            float(np.nanmax(x) - np.nanmin(x)) for x in (self.paired[start:stop], self.paired)
        )
        return travel / full_range if full_range > 0.0 else 0.0

    def _interrupts_motion(self, start: int, stop: int) -> bool:
        """Return whether the run has steep sides while the other quantity continues."""
        # Multiple of the usual run length; no plateau of a measured force has longer equal runs.
        plateau_factor = 50.0
        min_travel = 0.3  # share of its range
        sides = [(start, -1)] if start >= 2 else []
        sides += [(stop - 1, 1)] if stop + 1 < len(self.values) else []
        if self.paired is None or not sides:
            return False
        continues = [self._paired_keeps_speed(sample, stop - start) for sample, _ in sides]
        paired_continues = any(continues) if stop - start < 2 * 4 else all(continues)
        is_long = stop - start >= plateau_factor * max(self.usual, self._previous_run(start))
        travels = self._paired_travel(start, stop) > min_travel
        if is_long and travels and self._paired_keeps_direction(start, stop):
            return True
        steep = (
            self._leaves_steeply(sample, direction, stop - start) for sample, direction in sides
        )
        return paired_continues and (is_long or all(steep))

    def _previous_run(self, start: int) -> int:
        """Return the length of the previous run: runs grow longer towards a plateau."""
        level = self.values[start - 1] if start else np.nan
        different = np.flatnonzero(self.values[:start] != level)
        return start - 1 - int(different[-1]) if len(different) else start

    def _paired_keeps_direction(self, start: int, stop: int) -> bool:
        """Return whether the other quantity does not reverse at the start; in a hold it does."""
        paired = self.paired
        if paired is None:
            return False
        travel_before = float(paired[start] - paired[max(0, start - (stop - start))])
        return travel_before * float(paired[start + (stop - start) // 4] - paired[start]) > 0.0

    def _leaves_steeply(self, sample: int, direction: int, length: int) -> bool:
        """Return whether the channel leaves a sample steeply, forwards (1) or backwards (-1)."""
        # Resolution steps within half the run length; a rounded peak has 3. Slope next to the run
        # over the slope farther away; it decreases towards a rounded peak. Share of the range below
        # which missing values are irrelevant.
        min_rise_in_steps, min_slope_ratio, min_lost_share = 5.0, 0.3, 0.005
        reach = min(max(2, length // 2), sample if direction < 0 else len(self.values) - 1 - sample)
        rise = np.abs(self.values[sample + direction * np.arange(reach + 1)] - self.values[sample])
        if reach < 2 or not np.isfinite(rise).all():
            return False
        half_reach = reach // 2
        far_slope = float(rise[-1] - rise[half_reach]) / (reach - half_reach)
        # The first step may be partly in the run.
        near_slope = max(float(rise[half_reach]) / half_reach, float(rise[2] - rise[1]))
        min_loss = min_lost_share * (self.high - self.low)
        is_far = rise[-1] > max(min_rise_in_steps * self.resolution, min_loss)
        return bool(is_far) and near_slope >= min_slope_ratio * far_slope

    def _paired_keeps_speed(self, sample: int, length: int) -> bool:
        """Return whether the other quantity passes a sample at about constant speed."""
        # Of the speed after the sample over the speed before it.
        min_speed_ratio, max_speed_ratio = 0.4, 2.5
        noise_factor = 5.0
        paired = self.paired
        if paired is None:
            return False
        min_travel = noise_factor * estimate_noise_level(paired)
        size = max(1, min(length // 4, max(8, len(paired) // 50)))
        low, high = max(0, sample - size), min(len(paired) - 1, sample + size)
        travel, duration = (np.diff(values[[low, sample, high]]) for values in (paired, self.time))
        if not (np.abs(travel) > min_travel).all():  # or NaN
            return False
        speed_before, speed_after = travel / np.maximum(duration, 1e-12)
        return bool(min_speed_ratio <= speed_after / speed_before <= max_speed_ratio)


def _find_resolution(values: Floats, steps: Floats, rounding: float) -> float:
    """Return the quantisation step; the rounding error if a short record has none.

    For a long record it is the smallest step between neighbours.
    """
    max_grid_check_samples = 5000
    if len(values) > max_grid_check_samples:
        return float(steps.min())
    steps = np.diff(np.sort(values[~np.isnan(values)]))
    steps = steps[steps > rounding]
    multiples = steps / steps.min()
    on_grid = bool((np.abs(multiples - np.round(multiples)) < 0.1).all())
    return float(steps.min()) if on_grid else rounding


def _compute_longest_noise_run(values: Floats, count: int, resolution: float) -> float:
    """Return the run length that noise exceeds in one of 10^6 records; infinite without noise.

    values : without gaps and unusual runs; count : samples of the record
    """
    false_alarm_rate = 1e-6  # per record
    # Median third over median second difference: 1.8 for white noise, far below 1 if smooth.
    min_white_ratio = 1.2
    second = np.diff(values, n=2)
    third = np.diff(second)
    if len(third) < 20:
        return float("inf")
    size = median(np.abs(second, out=second))
    noise = convert_to_noise(size)
    if not noise > resolution or median(np.abs(third, out=third)) < min_white_ratio * size:
        return float("inf")  # no noise, or a smooth curve
    equal_chance = resolution / (2.0 * sqrt(pi) * noise)  # of two neighbours
    return max(_MIN_NOISY_RUN, 1.0 + log(false_alarm_rate / count) / log(equal_chance))


def find_spikes(force: Floats) -> Ints:
    """Find spikes: samples that deviate from neighbours of about equal level.

    Parameters
    ----------
    force : shape (n,), N; NaN are ignored

    Returns
    -------
    Indices of the samples, in order; spikes and dropouts of at most three samples in a row.

    Notes
    -----
    The deviation from the median of seven samples must exceed eight robust standard deviations
    (1.4826 MAD), 1 % of the range of that median and four times the largest step between the three
    neighbours on each side; the medians of the neighbours on both sides must differ by less than
    half the deviation. A lasting loss of force is therefore no spike. The first and last three
    samples have neighbours on one side only: a spike is farther beyond the range of all other
    levels than this range is wide.
    """
    mad_factor = 8.0
    max_medians = 20_000  # evenly spaced, for range and deviation
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
    min_deviation = max(mad_factor * 1.4826 * mad, _MIN_SPIKE_SHARE * float(np.ptp(levels)))
    uneven = np.flatnonzero(_is_uneven(f, min_deviation))
    window_rows = np.clip(uneven[:, None] + np.arange(-half_window, half_window + 1), 0, len(f) - 1)
    deviation = f[uneven] - np.partition(f[window_rows], half_window, axis=1)[:, half_window]
    is_far = np.abs(deviation) > min_deviation
    numbers, size = uneven[is_far], np.abs(deviation[is_far])
    spikes = [numbers[:0]]
    for run in np.split(np.arange(len(numbers)), np.flatnonzero(np.diff(numbers) > 1) + 1):
        # Excludes neighbours with a median that the spike has shifted.
        core = run[size[run] > 0.3 * size[run].max(initial=0.0)]
        if len(core) and _is_spike(f, numbers[core], float(size[core].min())):
            spikes.append(numbers[core])
    ends = np.r_[:half_window, len(f) - half_window : len(f)]
    beyond = np.maximum(f[ends] - levels.max(), levels.min() - f[ends])
    spikes.append(ends[beyond > max(float(np.ptp(levels)), min_deviation)])
    samples = np.sort(np.concatenate(spikes))
    return samples if is_valid.all() else np.flatnonzero(is_valid)[samples]


def _is_uneven(f: Floats, min_deviation: float) -> Flags:
    """Return flags of samples that may deviate by more than `min_deviation` from neighbours."""
    block = 8  # more than half a window
    starts = np.arange(0, len(f), block)
    high = np.pad(np.maximum.reduceat(f, starts), 1, mode="edge")
    low = np.pad(np.minimum.reduceat(f, starts), 1, mode="edge")
    highest = np.maximum(np.maximum(high[:-2], high[1:-1]), high[2:])
    lowest = np.minimum(np.minimum(low[:-2], low[1:-1]), low[2:])
    return np.repeat(highest - lowest > min_deviation, block)[: len(f)]


def bridge_spikes(force: Floats, spikes: Ints) -> Floats:
    """Replace spikes by linear interpolation between their neighbours.

    Parameters
    ----------
    force : shape (n,), N; NaN are kept and do not count as neighbours
    spikes : indices from `find_spikes`

    Returns
    -------
    shape (n,), a new array
    """
    valid = np.setdiff1d(np.flatnonzero(~np.isnan(force)), spikes, assume_unique=True)
    bridged = force.copy()
    bridged[spikes] = np.interp(spikes, valid, force[valid])
    return bridged


def _is_spike(f: Floats, run: Ints, deviation: float) -> bool:
    """Return whether a run of deviating samples is short, with similar levels on both sides."""
    # Multiple of the largest step of the neighbours, so that a sharp turn is not a spike.
    spike_step_factor = 4.0
    first_sample, last_sample = int(run[0]), int(run[-1])
    values_before = f[max(first_sample - _MAX_SPIKE_SAMPLES, 0) : first_sample]
    values_after = f[last_sample + 1 : last_sample + 1 + _MAX_SPIKE_SAMPLES]
    if (
        last_sample - first_sample >= _MAX_SPIKE_SAMPLES
        or min(len(values_before), len(values_after)) < _MAX_SPIKE_SAMPLES
    ):
        return False
    step = max(float(np.abs(np.diff(side)).max()) for side in (values_before, values_after))
    level_change = abs(median(values_after) - median(values_before))
    return deviation > spike_step_factor * step and level_change < 0.5 * deviation
