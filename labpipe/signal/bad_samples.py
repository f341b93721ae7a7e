"""Samples that measure nothing: full or frozen channels, spikes and dropouts."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import log, pi, sqrt

import numpy as np

from labpipe.records.arrays import Flags, Floats, Ints, median, stretches_of
from labpipe.signal.turning_points import noise_level, noise_of_differences

_FEWEST = 3
"""Equal samples in a row: two stand on both sides of any corner."""
_UNUSUAL = 4.0
"""Times as long as the runs that are usual in the channel."""
_ALONE = 50.0
"""Times as long as the usual runs that no plateau of a measured force is flat."""
_MUCH = 0.3
"""Share of its range by which the other quantity moves during a run that is full by all means."""
_STEPS = 5.0
"""Steps of the resolution by which a channel comes to a run within half of it; a round top: 3."""
_DUST = 1e-7
"""Share of the range below which numbers differ by their rounding."""
_FEW = 5000
"""Samples of a record of which all values are compared, not just those of neighbours."""
_ABRUPT = 0.3
"""Share of its slope before that a channel has just before a run; at a round top it falls off."""
_SPEED = (0.4, 2.5)
"""Speed behind an end of the run over that before it, of what goes on meanwhile."""
_FAST = 5.0
"""Times the usual speed with which a frozen channel jumps to where it should have been."""
_FAR = 0.02
"""Share of the range: nearer to zero or to the first value is rest; a smaller jump does no harm."""
_CHANCE = 1e-6
"""With which noise would make such a run somewhere in the record."""
_LEAST = 10.0
"""Equal samples of a noisy channel that no logger makes by repeating a number."""
_MOVING = 0.8
"""Share of its samples at which a channel changes that is not slow for its resolution."""
_LOST = 0.005
"""Share of the range that has to be missing to matter."""
_SURE = 5.0
"""Standard deviations of its noise by which the other quantity moves."""
_AT_REST = 100
"""Equal samples of a noisy channel at its end that are no rest."""
_WHITE = 1.2
"""Third differences over second ones, medians: 1.8 for white noise, far below 1 if smooth."""
_WINDOW = 7
_LONGEST = _WINDOW // 2
_FAR_OFF = 8.0
"""Robust deviations from the short median that a spike is away at least."""
_FLOOR = 0.01
"""Share of the signal's range that it is away at least: less does no harm."""
_SOME = 200
"""Medians that are looked at to see how far the signal goes at least."""
_FAR_IN_STEPS = 4.0
"""Largest steps of the neighbours that it is away at least, so that a sharp turn is none."""


@dataclass(frozen=True, slots=True)
class Stuck:
    """A run of equal samples.

    Parameters
    ----------
    start, stop : first sample of the run, and the first one behind it
    is_end : whether the channel has no value beyond: it is full; else it is frozen
    """

    start: int
    stop: int
    is_end: bool


def stuck_runs(time: Floats, values: Floats, beside: Floats | None = None) -> list[Stuck]:
    """Find where a channel repeats a number though what it measures goes on.

    Parameters
    ----------
    time : shape (n,), s
    values : shape (n,), the channel; NaN end a run
    beside : shape (n,), what goes on meanwhile (the displacement of a force, the force of a
        displacement); None where nothing is known of it

    Returns
    -------
    The runs, in order.

    Notes
    -----
    There are two ways to tell. Noise never repeats a number for long: in a noisy channel a run
    counts if chance would make one like it in one of 10^6 records. In a quiet one the values have
    to come to the run and leave it steeply (by more than ten steps of the resolution within half
    its length, at no less than 0.3 of the slope before), while `beside` goes on: at about its old
    speed through both ends, for a channel without a value beyond; or by some way, for one that then
    jumps to where it should have been. So a machine that stands, a round top, a plateau, a creep
    under constant force, slack, and a coarse resolution are left alone.
    """
    lengths, starts = _runs(values)
    channel = _Channel(time, values, beside, lengths)
    if not len(starts) or not channel.high > channel.low:
        return []
    long = np.flatnonzero(lengths >= max(_FEWEST, _UNUSUAL * channel.usual))
    several = np.flatnonzero(lengths >= _FEWEST)
    ends = several[channel.is_extreme(starts[several])]
    stuck_runs = []
    for run in np.union1d(long, ends).tolist():
        start, stop = int(starts[run]), int(starts[run] + lengths[run])
        is_end = bool(channel.is_extreme(np.array([start]))[0])
        if channel.is_stuck(start, stop, is_end=is_end):
            stuck_runs.append(Stuck(start, stop, is_end))
    return stuck_runs


def _runs(values: Floats) -> tuple[Ints, Ints]:
    """Lengths and first samples of all runs of equal values, those of one sample, too."""
    if not len(values):
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    starts = np.r_[0, np.flatnonzero(np.diff(values) != 0.0) + 1]
    lengths = np.diff(np.r_[starts, len(values)])
    known = ~np.isnan(values[starts])
    return lengths[known], starts[known]


@dataclass(frozen=True, eq=False)
class _Channel:
    """A channel, and what is usual in it, computed where a run needs it.

    Parameters
    ----------
    time, values, beside : as for `stuck_runs`
    lengths : samples of its runs
    """

    time: Floats
    values: Floats
    beside: Floats | None
    lengths: Ints

    @cached_property
    def usual(self) -> float:
        """Samples that 95 % of the runs do not exceed."""
        return float(np.quantile(self.lengths, 0.95))

    @cached_property
    def low(self) -> float:
        """Smallest value."""
        return float(np.nanmin(self.values))

    @cached_property
    def high(self) -> float:
        """Largest value."""
        return float(np.nanmax(self.values))

    @cached_property
    def dust(self) -> float:
        """Step below which the channel rests."""
        return min(_DUST, 0.1 / len(self.values)) * (self.high - self.low)

    @cached_property
    def steps(self) -> tuple[Floats, Floats]:
        """Sizes of the steps of the channel, and how long each lasts, s."""
        steps = np.abs(np.diff(self.values))
        moving = steps > self.dust  # False for NaN
        sizes = steps[moving]
        if not len(sizes):  # blanks stand between all that differ
            sizes, moving = np.array([self.high - self.low]), np.r_[True, moving[1:]]
        return sizes, np.maximum(np.diff(self.time)[moving], 1e-12)

    @cached_property
    def resolution(self) -> float:
        """Step that all values are multiples of."""
        return _resolution(self.values, self.steps[0], self.dust)

    @cached_property
    def speed(self) -> float:
        """Speed that 95 % of the steps do not exceed."""
        sizes, durations = self.steps
        return float(np.quantile(sizes / durations, 0.95))

    @cached_property
    def noise_beside(self) -> float:
        """Noise of the other quantity."""
        return 0.0 if self.beside is None else noise_level(self.beside)

    @cached_property
    def longest_by_chance(self) -> float:
        """Samples of a run that noise makes; inf in a quiet channel."""
        return _longest_by_chance(self.values, self.lengths, self.usual, self.resolution)

    def is_extreme(self, at: Ints) -> Flags:
        return np.asarray((self.values[at] == self.low) | (self.values[at] == self.high))

    def is_stuck(self, start: int, stop: int, *, is_end: bool) -> bool:
        if self._jumps(start, stop):
            return True
        rests = self._rests(start)
        if stop - start > _LEAST and stop - start > self.longest_by_chance:
            return not rests or (is_end and stop - start >= _AT_REST)
        if rests or (start > 0 and self._is_jump(start)):
            return False
        return (is_end or stop == len(self.values)) and self._goes_on(start, stop)

    def _rests(self, at: int) -> bool:
        level, far = float(self.values[at]), _FAR * (self.high - self.low)
        first = self.values[~np.isnan(self.values)][0]
        return abs(level) <= far or abs(level - float(first)) <= far

    def _jumps(self, start: int, stop: int) -> bool:
        """Whether a jump follows while the other quantity is as smooth as ever, and has moved."""
        if stop >= len(self.values):
            return False
        if not self._is_jump(stop) or (start > 0 and self._is_jump(start)):
            return False  # what falls, stands and falls again is a specimen that tears
        if self.beside is None:  # a specimen that breaks while the machine stands goes to zero
            return stop - start >= _LEAST and not self._rests(stop)
        steps = np.abs(np.diff(self.beside))
        smooth = steps[stop - 1] <= _FAST * float(np.nanquantile(steps, 0.95))
        return bool(smooth) and self._moved(start, stop) > _FAR

    def _is_jump(self, at: int) -> bool:
        """Whether the channel steps from the sample before to this one as it never does else."""
        jump = abs(float(self.values[at] - self.values[at - 1]))
        lasts = max(float(self.time[at] - self.time[at - 1]), 1e-12)
        return jump > _FAR * (self.high - self.low) and jump > _FAST * self.speed * lasts

    def _moved(self, start: int, stop: int) -> float:
        """How far the other quantity went meanwhile, as a share of its range."""
        if self.beside is None:
            return 0.0
        part = self.beside[start:stop]
        if np.isnan(part).all():
            return 0.0
        whole = float(np.nanmax(self.beside) - np.nanmin(self.beside))
        return float(np.nanmax(part) - np.nanmin(part)) / whole if whole > 0.0 else 0.0

    def _goes_on(self, start: int, stop: int) -> bool:
        """Whether the channel comes steeply to the run, and the other quantity does not mind."""
        sides = [(start, -1)] if start >= 2 else []
        sides += [(stop - 1, 1)] if stop + 1 < len(self.values) else []
        if self.beside is None or not sides:
            return False
        going = [self._is_passed(at, stop - start) for at, _ in sides]
        enough = any(going) if stop - start < 2 * 4 else all(going)
        is_long = stop - start >= _ALONE * max(self.usual, self._before(start))
        if is_long and self._moved(start, stop) > _MUCH and self._keeps_its_way(start, stop):
            return True
        steep = (self._is_steep(at, away, stop - start) for at, away in sides)
        return enough and (is_long or all(steep))

    def _before(self, start: int) -> int:
        """Samples of the run before: a plateau is approached in ever longer ones."""
        level = self.values[start - 1] if start else np.nan
        other = np.flatnonzero(self.values[:start] != level)
        return start - 1 - int(other[-1]) if len(other) else start

    def _keeps_its_way(self, start: int, stop: int) -> bool:
        """Whether the other quantity does not turn back where the run begins, as in a hold."""
        other = self.beside
        if other is None:
            return False
        before = float(other[start] - other[max(0, start - (stop - start))])
        return before * float(other[start + (stop - start) // 4] - other[start]) > 0.0

    def _is_steep(self, at: int, away: int, length: int) -> bool:
        """Whether the channel leaves a sample, forwards (1) or backwards (-1), at full slope."""
        room = at if away < 0 else len(self.values) - 1 - at
        reach = min(max(2, length // 2), room)
        off = np.abs(self.values[at + away * np.arange(reach + 1)] - self.values[at])
        off = off[: int(np.argmax(off)) + 1] if np.isfinite(off).all() else off[:0]
        if not len(off) > 2:
            return False
        reach = len(off) - 1
        steps = np.abs(np.diff(off))
        moving = steps[steps > 0.0]
        # A slow channel goes in steps of its resolution, and stands on each of them for a while.
        step = self.resolution if len(moving) > _MOVING * len(steps) else moving.min(initial=np.inf)
        half = reach // 2
        slope = float(off[-1] - off[half]) / (reach - half)
        near = max(float(off[half]) / half, float(off[2] - off[1]))  # the first may be part of one
        is_abrupt = near >= _ABRUPT * slope
        far = max(_STEPS * float(step), _LOST * (self.high - self.low))
        return bool(off[-1] > far) and is_abrupt

    def _is_passed(self, at: int, length: int) -> bool:
        """Whether the other quantity goes through a sample at about the same speed."""
        other = self.beside
        if other is None:
            return False
        least, size = _SURE * self.noise_beside, max(1, min(length // 4, max(8, len(other) // 50)))
        low, high = max(0, at - size), min(len(other) - 1, at + size)
        before, after = float(other[at] - other[low]), float(other[high] - other[at])
        if not (abs(before) > least and abs(after) > least):  # NaN, too
            return False
        lasts = max(float(self.time[at] - self.time[low]), 1e-12)
        behind = max(float(self.time[high] - self.time[at]), 1e-12)
        return _SPEED[0] <= (after / behind) / (before / lasts) <= _SPEED[1]


def _resolution(values: Floats, steps: Floats, dust: float) -> float:
    """Step that all values are multiples of; among few, that of their rounding if there is none."""
    if len(values) > _FEW:
        return float(steps.min())
    steps = np.diff(np.sort(values[~np.isnan(values)]))
    steps = steps[steps > dust]
    times = steps / steps.min()
    on_grid = bool((np.abs(times - np.round(times)) < 0.1).all())
    return float(steps.min()) if on_grid else dust


def _longest_by_chance(values: Floats, lengths: Ints, usual: float, resolution: float) -> float:
    """Length of a run that noise makes by chance in one of 10^6 records; inf without noise."""
    is_usual = np.repeat(lengths <= _UNUSUAL * max(1.0, usual), lengths)
    second = np.diff(values[~np.isnan(values)][is_usual], n=2)
    third = np.diff(second)
    if len(third) < 20:
        return float("inf")
    size = median(np.abs(second, out=second))
    noise = noise_of_differences(size)
    if not noise > resolution or median(np.abs(third, out=third)) < _WHITE * size:
        return float("inf")  # no noise, or a smooth curve
    alike = resolution / (2.0 * sqrt(pi) * noise)  # chance that two neighbours are equal
    return max(_LEAST, 1.0 + log(_CHANCE / len(values)) / log(alike))


def find_spikes(force: Floats) -> Ints:
    """Samples far off their neighbours, which agree with each other.

    Parameters
    ----------
    force : shape (n,), N; NaN are left out

    Returns
    -------
    Sample numbers in order; spikes and dropouts of at most three samples in a row.

    Notes
    -----
    The departure from the median of seven must exceed eight of its robust deviations (1.4826 MAD),
    1 % of the range of that median and four of the largest steps between the three neighbours on
    each side; the medians of these two threes must differ by less than half of it. A loss of force
    does not come back and is therefore none, nor is a sample at the very beginning or end, which
    has neighbours on one side only.
    """
    known = np.flatnonzero(~np.isnan(force)).astype(np.int64)
    f = force[known]
    if len(f) < 2 * _WINDOW or _is_smooth(f):
        return np.zeros(0, dtype=np.int64)
    from scipy.ndimage import median_filter

    level = median_filter(f, _WINDOW, mode="nearest")
    off = f - level
    away = np.abs(off)
    # Few numbers again and again, in which `records.arrays.median` is slow.
    far = max(_FAR_OFF * 1.4826 * float(np.median(away)), _FLOOR * float(np.ptp(level)))
    runs = [_core(np.arange(*run), off) for run in stretches_of(away > far)]
    spikes = [run for run in runs if _returns(f, run, float(np.abs(off[run]).min()))]
    numbers: Ints = known[np.concatenate(spikes).astype(np.int64)] if spikes else known[:0]
    return numbers


def bridge_spikes(force: Floats, spikes: Ints) -> Floats:
    """Put spikes on the line between their neighbours.

    Parameters
    ----------
    force : shape (n,), N; NaN stay and are no neighbours
    spikes : numbers of samples, as `find_spikes` gives them

    Returns
    -------
    shape (n,), a new array
    """
    sound = np.setdiff1d(np.flatnonzero(~np.isnan(force)), spikes)
    mended = force.copy()
    mended[spikes] = np.interp(spikes, sound, force[sound])
    return mended


def _is_smooth(f: Floats) -> bool:
    """Whether no sample can be far off, as the steps are too small: most long records are done.

    A sample is at most three steps away from any median of seven that it is in; the range of some
    of these medians is at most that of all.
    """
    steps = np.diff(f)
    largest = max(float(steps.max()), -float(steps.min()))
    windows = np.lib.stride_tricks.sliding_window_view(f, _WINDOW)
    some = np.median(windows[:: max(1, len(windows) // _SOME)], axis=1)
    return _LONGEST * largest <= _FLOOR * float(np.ptp(some))


def _core(run: Ints, off: Floats) -> Ints:
    """The samples of a run without its neighbours, whose median it has pulled away."""
    away = np.abs(off[run])
    core: Ints = run[away > 0.3 * away.max()]
    return core


def _returns(f: Floats, run: Ints, off: float) -> bool:
    first, last = int(run[0]), int(run[-1])
    before, after = f[max(first - _LONGEST, 0) : first], f[last + 1 : last + 1 + _LONGEST]
    if last - first >= _LONGEST or min(len(before), len(after)) < _LONGEST:
        return False
    step = max(float(np.abs(np.diff(side)).max()) for side in (before, after))
    apart = abs(median(after) - median(before))
    return off > _FAR_IN_STEPS * step and apart < 0.5 * off
