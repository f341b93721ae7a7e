"""Noise of the largest force on the clock of the force, which has more samples than the curve.

A curve with a displacement from cameras has one sample per frame; the force has several, and its
filter acts on those. The largest of more samples is higher, so the noise of a peak is that of the
samples of the force. Its slow part is that of the replicates, one level per frame; deviations of
single samples from the level of their frame are taken from a random part of the record itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from labpipe.records.arrays import Floats, Ints, Singles
from labpipe.records.signals import Clocks, Filter, Signal
from labpipe.results.reduced_test import ReducedTest
from labpipe.signal.filters import in_pieces
from labpipe.uncertainty.extractors import Trace
from labpipe.uncertainty.replicates import random_stream


def cuts_of(clocks: Clocks, ends: Sequence[float], signal: Signal) -> list[int]:
    """Return the samples of a signal at which a new piece begins.

    Parameters
    ----------
    clocks : of the test
    ends : s on the clock of the curve, of branches, and of the failure
    signal : the signal
    """
    at = [clocks.from_curve(end, signal.clock) for end in ends]
    cuts: list[int] = np.searchsorted(signal.time, at, side="right").tolist()
    return cuts


@dataclass(frozen=True, slots=True, eq=False)
class ForceSamples:
    """The force of a curve without noise on its own clock, and deviations of single samples.

    Parameters
    ----------
    time : shape (n,), s on the clock of the curve, increasing
    smooth : shape (n,), N, without noise
    left : shape (n,), N, deviations of single samples from the mean of their frame
    frames : shape (n,), sample of the curve of each
    filters : of the force
    cuts : at which a new piece begins
    reach : samples on either side that the filters need
    seed : of draws
    """

    time: Floats
    smooth: Floats
    left: Floats
    frames: Ints
    filters: tuple[Filter, ...]
    cuts: tuple[int, ...]
    reach: int
    seed: bytes

    @classmethod
    def of(cls, test: ReducedTest, trace: Trace) -> ForceSamples | None:
        """Prepare the samples of a test.

        Parameters
        ----------
        test : with a curve
        trace : the curve without noise

        Returns
        -------
        None if the force has hardly more samples than the curve, or no filter.
        """
        signal, filters = test.unfiltered, test.signals.filters.get(test.signals.force, ())
        if signal is None or not filters or any(stride != 1 for _, stride in filters):
            return None
        reach = _filter_reach(filters)
        if reach is None or len(signal.time) < 2.0 * len(trace.time):
            return None
        time = test.clocks.times_on_curve(signal)
        frames = _frames_of(time, trace.time)
        ends = [at for branch in trace.branches for at in (branch.start_time, branch.stop_time)]
        cuts = cuts_of(test.clocks, ends, signal)
        smooth = _between_frames(trace, time, cuts, reach)
        left = _less_frame_means(signal.values - smooth, frames)
        np.nan_to_num(left, copy=False)
        return cls(time, smooth, left, frames, filters, tuple(cuts), reach, test.seed)

    def of_cycle(self, trace: Trace, stretch: slice, sense: float) -> PeakSamples | None:
        """Select the samples of a cycle.

        Parameters
        ----------
        trace : the curve without noise
        stretch : its samples of the cycle
        sense : sign of loading

        Returns
        -------
        None if the cycle has none, or the curve has gaps there.
        """
        if np.isnan(trace.force[stretch]).any():
            return None
        first, last = trace.time[stretch][[0, -1]]
        low, high = np.searchsorted(self.time, first), np.searchsorted(self.time, last, "right")
        over = sense * self.smooth[low:high]
        is_finite = ~np.isnan(over)
        if not is_finite.any():
            return None
        spread = float(self.left[low:high][is_finite].std())
        return PeakSamples(self, sense, int(low), over, float(over[is_finite].max()), spread)


@dataclass(frozen=True, slots=True, eq=False)
class PeakSamples:
    """Samples of a cycle, for their largest one.

    Parameters
    ----------
    samples : of the whole test
    sense : sign of loading
    start : the first one of the cycle
    over : shape (n,), N in that sense, without noise; NaN where unknown
    top : N, the largest of them
    spread : N, standard deviation of single samples
    """

    samples: ForceSamples
    sense: float
    start: int
    over: Floats
    top: float
    spread: float

    def raised(self, noise: Floats | Singles) -> Floats | None:
        """Return the effect of noise on the largest sample of the cycle.

        Parameters
        ----------
        noise : shape (replicates, frames), N, of the curve before all filters

        Returns
        -------
        N in the direction of loading, shape (replicates,). None if too many samples may be the
        largest.
        """
        # Standard deviations of noise below the peak up to which a sample may be the largest.
        max_deviations = 8.0
        max_samples = 20_000  # the curve has enough samples of a longer plateau
        size = float(np.hypot(noise.std(), self.spread))
        near = np.flatnonzero(self.over >= self.top - max_deviations * size) + self.start
        if len(near) > max_samples:
            return None
        # The parts of the record are reproducible draws.
        chance = random_stream(self.samples.seed, "samples of the force")
        largest, apart = np.full(len(noise), -np.inf), 2 * self.samples.reach
        for run in np.split(near, np.flatnonzero(np.diff(near) > apart) + 1):
            filtered = self._filtered(noise, int(run[0]), int(run[-1]) + 1, chance)
            filtered *= self.sense
            largest = np.maximum(largest, filtered.max(axis=1))
        return largest - self.top

    def _filtered(
        self, noise: Floats | Singles, first: int, stop: int, chance: np.random.Generator
    ) -> Floats:
        """Return a range of the force with noise, filtered, shape (replicates, samples)."""
        samples = self.samples
        part = slice(max(first - samples.reach, 0), min(stop + samples.reach, len(samples.smooth)))
        count = part.stop - part.start
        stretches = np.lib.stride_tricks.sliding_window_view(samples.left, count)
        force = samples.smooth[part] + noise.take(samples.frames[part], axis=1)
        force += stretches[chance.integers(0, len(stretches), len(noise))]
        filtered = in_pieces(force, [cut - part.start for cut in samples.cuts], samples.filters)
        return filtered[:, first - part.start : stop - part.start]


def _frames_of(time: Floats, frames: Floats) -> Ints:
    """Return the nearest frame of each time, both increasing: shape (n,)."""
    ends = np.searchsorted(time, 0.5 * (frames[1:] + frames[:-1]), side="right")
    return np.repeat(np.arange(len(frames)), np.diff(ends, prepend=0, append=len(time)))


def _between_frames(trace: Trace, time: Floats, cuts: Sequence[int], reach: int) -> Floats:
    """Interpolate the force of a curve, with extrapolation to the start of the next piece.

    Parameters
    ----------
    trace : the curve
    time : shape (n,), s on its clock
    cuts : samples of `time` at which branches begin and end
    reach : samples within the reach of the filter, over which a piece joins the one before
    """
    frames = [at for branch in trace.branches for at in (branch.start, branch.stop)]
    between_frames = np.empty(len(time))
    ends = sorted({(0, 0), *zip(cuts, frames, strict=True), (len(time), len(trace.time))})
    for (low, begin), (high, end) in pairwise(ends):
        if end - begin > 1:
            between_frames[low:high] = _extrapolated(
                time[low:high], trace.time[begin:end], trace.force[begin:end]
            )
            _join_at_cut(between_frames, low, min(reach, high - low))
        else:
            between_frames[low:high] = np.interp(time[low:high], trace.time, trace.force)
    return between_frames


def _join_at_cut(values: Floats, cut: int, over: int) -> None:
    """Remove a jump between two pieces beyond a step of either.

    A force does not jump at a turn of the motion, but a spline may be inaccurate at its end.
    """
    if not 1 < cut < len(values) - 1 or over < 2:
        return
    step = max(abs(values[cut - 1] - values[cut - 2]), abs(values[cut + 1] - values[cut]))
    gap = values[cut - 1] - values[cut]
    ramp = 1.0 - np.arange(over) / over
    values[cut : cut + over] += (gap - np.clip(gap, -step, step)) * ramp


def _extrapolated(at: Floats, time: Floats, values: Floats) -> Floats:
    """Interpolate values, with linear extrapolation at both ends."""
    interpolated = np.interp(at, time, values)
    for pair, there in ((slice(2), at < time[0]), (slice(-2, None), at > time[-1])):
        (before, after), (low, high) = time[pair], values[pair]
        interpolated[there] = low + (high - low) / (after - before) * (at[there] - before)
    return interpolated


def _less_frame_means(values: Floats, frames: Ints) -> Floats:
    """Subtract the mean of each frame."""
    count = np.bincount(frames)
    mean = np.bincount(frames, values) / np.maximum(count, 1)
    return values - mean[frames]


def _filter_reach(filters: Sequence[Filter]) -> int | None:
    """Return twice the samples on each side that a filter reaches, or None for too many."""
    pulse_samples = 4001
    pulse = np.zeros(pulse_samples)
    pulse[pulse_samples // 2] = 1.0
    response = in_pieces(pulse, (), filters)
    far = np.flatnonzero(np.abs(response) > 1e-3 * np.abs(response).max())
    reach = int(np.abs(far - pulse_samples // 2).max()) + 1
    return 2 * reach if 4 * reach < pulse_samples else None
