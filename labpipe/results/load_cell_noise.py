"""Compute the noise of a peak force at the sample rate of the force signal.

A curve whose displacement comes from cameras has one sample per frame. The force signal has
several, and its filter acts on these. The maximum of more samples is higher, so the noise of a peak
is computed from the samples of the force signal. Its slow part, one value per frame, comes from the
replicates. Its fast part, the deviations of single samples from the mean of their frame, comes from
a randomly chosen part of the record.
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
    """Return the indices of the samples of a signal at which a new piece begins.

    Parameters
    ----------
    clocks : of the test
    ends : s on the clock of the curve, ends of branches and time of failure
    signal : the signal
    """
    end_times = [clocks.from_curve(end, signal.clock) for end in ends]
    cuts: list[int] = np.searchsorted(signal.time, end_times, side="right").tolist()
    return cuts


@dataclass(frozen=True, slots=True, eq=False)
class ForceSamples:
    """The force of a curve without noise on its own clock, and deviations of single samples.

    Parameters
    ----------
    time : shape (n,), s on the clock of the curve, increasing
    smooth : shape (n,), N, without noise
    deviations : shape (n,), N, deviations of single samples from the mean of their frame
    frames : shape (n,), index of the curve sample (frame) nearest to each force sample
    filters : of the force
    cuts : at which a new piece begins
    reach : samples on either side that the filters need
    seed : of draws
    """

    time: Floats
    smooth: Floats
    deviations: Floats
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
        None if the force has less than twice the samples of the curve, or if it has no filter, a
        filter that decimates, or one that reaches too far.
        """
        signal, filters = test.unfiltered, test.signals.filters.get(test.signals.force, ())
        if signal is None or not filters or any(stride != 1 for _, stride in filters):
            return None
        reach = _filter_reach(filters)
        if reach is None or len(signal.time) < 2.0 * len(trace.time):
            return None
        time = test.clocks.times_on_curve(signal)
        frames = _frames_of(time, trace.time)
        ends = [end for branch in trace.branches for end in (branch.start_time, branch.stop_time)]
        cuts = cuts_of(test.clocks, ends, signal)
        smooth = _between_frames(trace, time, cuts, reach)
        deviations = _less_frame_means(signal.values - smooth, frames)
        np.nan_to_num(deviations, copy=False)
        return cls(time, smooth, deviations, frames, filters, tuple(cuts), reach, test.seed)

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
        signed_force = sense * self.smooth[low:high]
        is_finite = ~np.isnan(signed_force)
        if not is_finite.any():
            return None
        spread = float(self.deviations[low:high][is_finite].std())
        peak = float(signed_force[is_finite].max())
        return PeakSamples(self, sense, int(low), signed_force, peak, spread)


@dataclass(frozen=True, slots=True, eq=False)
class PeakSamples:
    """Force samples of one cycle, from which the noise of its peak is computed.

    Parameters
    ----------
    samples : of the whole test
    sense : sign of loading
    start : the first one of the cycle
    signed_force : shape (n,), N in that sense, without noise; NaN where unknown
    peak : N, the largest of them
    spread : N, standard deviation of single samples
    """

    samples: ForceSamples
    sense: float
    start: int
    signed_force: Floats
    peak: float
    spread: float

    def peak_increase(self, noise: Floats | Singles) -> Floats | None:
        """Return the increase of the filtered peak by noise, per replicate.

        Parameters
        ----------
        noise : shape (replicates, frames), N, of the curve before all filters

        Returns
        -------
        N in the direction of loading, shape (replicates,). None if too many samples may be the
        largest.
        """
        # A sample may become the peak if it lies at most this many noise standard deviations
        # below it.
        max_deviations = 8.0
        max_samples = 20_000  # the curve has enough samples of a longer plateau
        size = float(np.hypot(noise.std(), self.spread))
        lowest = self.peak - max_deviations * size
        candidates = np.flatnonzero(self.signed_force >= lowest) + self.start
        if len(candidates) > max_samples:
            return None
        # The parts of the record are reproducible draws.
        random = random_stream(self.samples.seed, "samples of the force")
        largest, min_gap = np.full(len(noise), -np.inf), 2 * self.samples.reach
        for run in np.split(candidates, np.flatnonzero(np.diff(candidates) > min_gap) + 1):
            filtered = self._filtered(noise, int(run[0]), int(run[-1]) + 1, random)
            filtered *= self.sense
            largest = np.maximum(largest, filtered.max(axis=1))
        return largest - self.peak

    def _filtered(
        self, noise: Floats | Singles, first: int, stop: int, random: np.random.Generator
    ) -> Floats:
        """Return a range of the force with noise, filtered, shape (replicates, samples)."""
        samples = self.samples
        part = slice(max(first - samples.reach, 0), min(stop + samples.reach, len(samples.smooth)))
        count = part.stop - part.start
        deviation_windows = np.lib.stride_tricks.sliding_window_view(samples.deviations, count)
        force = samples.smooth[part] + noise.take(samples.frames[part], axis=1)
        force += deviation_windows[random.integers(0, len(deviation_windows), len(noise))]
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
    frames = [frame for branch in trace.branches for frame in (branch.start, branch.stop)]
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


def _join_at_cut(values: Floats, cut: int, join_samples: int) -> None:
    """Reduce the jump between two pieces to the larger of the steps next to the cut.

    A force does not jump at a turn of the motion, but a spline may be inaccurate at its end.
    """
    if not 1 < cut < len(values) - 1 or join_samples < 2:
        return
    step = max(abs(values[cut - 1] - values[cut - 2]), abs(values[cut + 1] - values[cut]))
    gap = values[cut - 1] - values[cut]
    ramp = 1.0 - np.arange(join_samples) / join_samples
    values[cut : cut + join_samples] += (gap - np.clip(gap, -step, step)) * ramp


def _extrapolated(wanted: Floats, time: Floats, values: Floats) -> Floats:
    """Interpolate values, with linear extrapolation at both ends."""
    interpolated = np.interp(wanted, time, values)
    for pair, outside in ((slice(2), wanted < time[0]), (slice(-2, None), wanted > time[-1])):
        (before, after), (low, high) = time[pair], values[pair]
        interpolated[outside] = low + (high - low) / (after - before) * (wanted[outside] - before)
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
