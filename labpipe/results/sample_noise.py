"""Compute the noise of single samples, which a peak and the last sample before a break have.

Replicates have one value per block of samples: a frame of the cameras, or a part of a long record.
The largest of more samples is higher, and a single sample has more noise than a mean. A replicate
of single samples is the sum of the smooth curve, the noise of each block in the replicate, and
deviations of single samples from the mean of their block in a random part of the record itself.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal, TypeAlias

import numpy as np

from labpipe.records.arrays import Floats, Ints
from labpipe.records.signals import FilterFunction, Signal
from labpipe.results.reduced_test import ReducedTest
from labpipe.uncertainty.extractors import Trace
from labpipe.uncertainty.replicates import random_stream

Quantity: TypeAlias = Literal["force", "displacement"]


@dataclass(frozen=True, slots=True, eq=False)
class SampleNoise:
    """Single samples of a quantity around a sample of the curve.

    Parameters
    ----------
    smooth : shape (n,), m or N, the curve without noise
    deviations : shape (n,), m or N, of single samples from the mean of their block
    blocks : shape (n,), sample of the replicates that contains each; None if the replicates have
        the noise of single samples, and deviations are those from the smooth curve
    chance : of the random parts, which are reproducible
    """

    smooth: Floats
    deviations: Floats
    blocks: Ints | None
    chance: np.random.Generator

    @classmethod
    def around(
        cls, test: ReducedTest, trace: Trace, quantity: Quantity, stretch: slice, at: int
    ) -> SampleNoise | None:
        """Select the samples of a quantity around a sample of the curve.

        Parameters
        ----------
        test : with a curve
        trace : the curve without noise, as the replicates have it
        quantity : whose samples are needed
        stretch : samples of `trace` that may be used
        at : one of them, such as the peak

        Returns
        -------
        None if the replicates have all samples, or too few of them are known.
        """
        max_samples, min_samples, min_block_samples = 20_000, 20, 1.5
        signal, chance = _signal_of(test, quantity), random_stream(test.seed, f"single {quantity}")
        block_samples = _step(trace.time) / _step(signal.time)
        if block_samples < min_block_samples:
            return None
        reach = max(1, int(max_samples / block_samples))
        part = slice(max(stretch.start, at - reach), min(stretch.stop, at + reach + 1))
        block_time = trace.time[part]
        ends = [test.clocks.from_curve(float(end), signal.clock) for end in block_time[[0, -1]]]
        low, high = np.searchsorted(signal.time, ends).tolist()
        values = signal.values[low:high]
        time = test.clocks.to_curve(signal.time[low:high], signal.clock)
        smooth = _interpolated(trace, getattr(trace, quantity), time, part)
        is_valid = ~np.isnan(values - smooth)
        if is_valid.sum() < min_samples:
            return None
        smooth, deviations = smooth[is_valid], (values - smooth)[is_valid]
        blocks = np.searchsorted(0.5 * (block_time[1:] + block_time[:-1]), time[is_valid])
        if _has_single_samples(test, quantity):
            return cls(smooth, deviations - deviations.mean(), None, chance)
        counts = np.maximum(np.bincount(blocks), 1)
        deviations -= (np.bincount(blocks, deviations) / counts)[blocks]
        return cls(smooth, deviations, blocks + part.start, chance)

    def raised(self, noise: Floats, sense: float) -> Floats:
        """Return the effect of noise on the largest sample, shape (replicates,).

        Parameters
        ----------
        noise : shape (replicates, samples of the curve), of the quantity
        sense : sign of loading
        """
        # Standard deviations of noise below the peak up to which a sample may be the largest.
        max_deviations = 8.0
        smooth = sense * self.smooth
        variance = self.deviations.var()
        if self.blocks is not None:
            variance += noise[:, self.blocks[0] : self.blocks[-1] + 1].var()
        near = np.flatnonzero(smooth >= smooth.max() - max_deviations * np.sqrt(variance))
        # Of more than half of the samples, every position would have the same deviations.
        near = near[near < near[0] + (len(smooth) + 1) // 2]
        windows = np.lib.stride_tricks.sliding_window_view(
            self.deviations, int(near[-1] - near[0]) + 1
        )
        rows = self.chance.integers(0, len(windows), len(noise))
        samples = windows[rows][:, near - near[0]]
        if self.blocks is not None:
            samples += noise[:, self.blocks[near]]
        raised: Floats = (smooth[near] + sense * samples).max(axis=1) - smooth.max()
        return sense * raised

    def drawn(self, shape: tuple[int, ...]) -> Floats:
        """Return deviations of random single samples from their block."""
        if self.blocks is None:
            return np.zeros(shape)
        return self.chance.choice(self.deviations, size=shape)


def have_no_effect(filters: list[FilterFunction]) -> bool:
    """Return whether filters do not change a pulse of a single sample."""
    pulse = np.eye(1, 101, 50)[0]
    return all(np.array_equal(act(pulse), pulse) for act in filters)


def _signal_of(test: ReducedTest, quantity: Quantity) -> Signal:
    """Return all samples that a quantity is read from."""
    if quantity == "force" and test.force.clock != test.clocks.curve:
        return test.force
    curve = test.known_curve
    values = curve.force if quantity == "force" else curve.displacement
    return replace(test.displacement, time=curve.time, values=values, moved={})


def _has_single_samples(test: ReducedTest, quantity: Quantity) -> bool:
    """Return whether the curve has single samples of a faster signal."""
    filters = test.signals.filters.get(test.signals.force, ())
    is_fast = quantity == "force" and test.force.clock != test.clocks.curve
    return is_fast and have_no_effect([act for act, _ in filters])


def _interpolated(trace: Trace, values: Floats, time: Floats, part: slice) -> Floats:
    """Interpolate a part of a curve branch by branch, with linear extrapolation to the turns.

    Parameters
    ----------
    trace, values : the curve, and its quantity
    time : shape (n,), s on its clock
    part : samples of the curve around those times
    """
    interpolated = np.empty(len(time))
    turns = {branch.start: branch.start_time for branch in trace.branches}
    turns |= {branch.stop: branch.stop_time for branch in trace.branches}
    if trace.failed_at is not None:
        turns[trace.failed_at + 1] = float(trace.time[trace.failed_at : trace.failed_at + 2].mean())
    inner = sorted((x, turns[x]) for x in turns if part.start < x < part.stop)
    for (start, begin), (stop, end) in pairwise(
        [(part.start, -np.inf), *inner, (part.stop, np.inf)]
    ):
        low, high = np.searchsorted(time, [begin, end], side="right")
        interpolated[low:high] = _extrapolated(
            time[low:high], trace.time[start:stop], values[start:stop]
        )
    return interpolated


def _step(time: Floats) -> float:
    return float(time[-1] - time[0]) / max(len(time) - 1, 1)


def _extrapolated(at: Floats, time: Floats, values: Floats) -> Floats:
    """Interpolate values, with linear extrapolation at both ends."""
    interpolated = np.interp(at, time, values)
    if len(time) < 2:
        return interpolated
    for pair, there in ((slice(2), at < time[0]), (slice(-2, None), at > time[-1])):
        (before, after), (low, high) = time[pair], values[pair]
        interpolated[there] = low + (high - low) / (after - before) * (at[there] - before)
    return interpolated
