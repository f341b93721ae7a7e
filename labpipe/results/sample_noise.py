"""Compute the noise of single samples, for peaks and for the last sample before a break.

Replicates have one value per block of samples: a frame of the cameras, or a part of a long record.
A single sample has more noise than the mean of a block, and the largest of many samples is higher.
A replicate of single samples is therefore the sum of three parts: the smooth curve; the noise of
each block in the replicate; and deviations of single samples from the mean of their block, taken
from a random part of the record itself.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal, TypeAlias

import numpy as np

from labpipe.records.arrays import Floats, Ints
from labpipe.records.signals import Filter, FilterFunction, Signal
from labpipe.results.reduced_test import ReducedTest
from labpipe.signal.filters import filter_pieces
from labpipe.uncertainty.extractors import Trace
from labpipe.uncertainty.replicates import make_generator

Quantity: TypeAlias = Literal["force", "displacement"]


@dataclass(frozen=True, slots=True, eq=False)
class SampleNoise:
    """Single samples of a quantity around a sample of the curve.

    Parameters
    ----------
    smooth : shape (n,), m or N, the curve without noise
    deviations : shape (n,), m or N, of single samples from the mean of their block
    unfiltered : the same before all filters
    filters : of the quantity; they act piece by piece
    cuts : samples at which a new piece begins
    blocks : shape (n,), sample of the replicates that contains each; None if the replicates have
        the noise of single samples, and deviations are those from the smooth curve
    chance : generator that draws the random parts, with a fixed seed
    """

    smooth: Floats
    deviations: Floats
    unfiltered: Floats
    filters: tuple[Filter, ...]
    cuts: tuple[int, ...]
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
        signal, chance = (
            _select_signal(test, quantity),
            make_generator(test.seed, f"single {quantity}"),
        )
        block_samples = _mean_step(trace.time) / _mean_step(signal.time)
        if block_samples < min_block_samples:
            return None
        n_blocks = max(1, int(max_samples / block_samples))
        part = slice(max(stretch.start, at - n_blocks), min(stretch.stop, at + n_blocks + 1))
        block_time = trace.time[part]
        ends = [test.clocks.from_curve(float(end), signal.clock) for end in block_time[[0, -1]]]
        low, high = np.searchsorted(signal.time, ends).tolist()
        time = test.clocks.to_curve(signal.time[low:high], signal.clock)
        smooth = _interpolate_branches(trace, getattr(trace, quantity), time, part)
        raw, filters = _read_unfiltered(test, quantity, signal)
        rows = np.stack([signal.values[low:high] - smooth, raw[low:high] - smooth])
        is_valid = ~np.isnan(rows).any(axis=0)
        if is_valid.sum() < min_samples:
            return None
        time, smooth, rows = time[is_valid], smooth[is_valid], rows[:, is_valid]
        turns = [at for _, at in _list_turns(trace) if time[0] < at < time[-1]]
        cuts = tuple(np.searchsorted(time, turns, side="right").tolist())
        if _has_single_samples(test, quantity):
            rows -= rows.mean(axis=1, keepdims=True)
            return cls(smooth, rows[0], rows[1], filters, cuts, None, chance)
        blocks = np.searchsorted(0.5 * (block_time[1:] + block_time[:-1]), time)
        counts = np.maximum(np.bincount(blocks), 1)
        rows -= np.stack([(np.bincount(blocks, row) / counts)[blocks] for row in rows])
        return cls(smooth, rows[0], rows[1], filters, cuts, blocks + part.start, chance)

    def compute_peak_effect(self, noise: Floats, sense: float) -> Floats:
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
        near_peak = np.flatnonzero(smooth >= smooth.max() - max_deviations * np.sqrt(variance))
        # Of more than half of the samples, every position would have the same deviations.
        near_peak = near_peak[near_peak < near_peak[0] + (len(smooth) + 1) // 2]
        filter_reach = min(_measure_filter_reach(self.filters), (len(smooth) - 1) // 4)
        part = slice(
            max(int(near_peak[0]) - filter_reach, 0),
            min(int(near_peak[-1]) + filter_reach + 1, len(smooth)),
        )
        windows = np.lib.stride_tricks.sliding_window_view(self.unfiltered, part.stop - part.start)
        rows = self.chance.integers(0, len(windows), len(noise))
        cuts = [cut - part.start for cut in self.cuts]
        samples = filter_pieces(windows[rows], cuts, self.filters)[:, near_peak - part.start]
        if self.blocks is not None:
            samples += noise[:, self.blocks[near_peak]]
        raised: Floats = (smooth[near_peak] + sense * samples).max(axis=1) - smooth.max()
        return sense * raised

    def draw_deviations(self, shape: tuple[int, ...]) -> Floats:
        """Return deviations of random single samples from their block."""
        if self.blocks is None:
            return np.zeros(shape)
        return self.chance.choice(self.deviations, size=shape)


def _read_unfiltered(
    test: ReducedTest, quantity: Quantity, signal: Signal
) -> tuple[Floats, tuple[Filter, ...]]:
    """Return the samples of a quantity before its filters, and those filters."""
    signals = test.signals
    name = signals.force if quantity == "force" else signals.displacement
    filters = signals.filters.get(name, ())
    raw = test.unfiltered if quantity == "force" else signals.raw[name]
    if raw is None or len(raw.time) != len(signal.time):
        return signal.values, ()
    return raw.values, filters


def _measure_filter_reach(filters: tuple[Filter, ...]) -> int:
    """Measure how many samples on each side of a pulse filters reach."""
    middle = 2000
    pulse = np.eye(1, 2 * middle + 1, middle)[0]
    response = np.abs(filter_pieces(pulse, (), filters))
    return int(np.abs(np.flatnonzero(response > 1e-3 * response.max()) - middle).max())


def have_no_filter_effect(filters: list[FilterFunction]) -> bool:
    """Check whether filters leave a pulse of a single sample unchanged."""
    pulse = np.eye(1, 101, 50)[0]
    return all(np.array_equal(filter_function(pulse), pulse) for filter_function in filters)


def _select_signal(test: ReducedTest, quantity: Quantity) -> Signal:
    """Select the signal with all samples of a quantity."""
    if quantity == "force" and test.force.clock != test.clocks.curve:
        return test.force
    curve = test.required_curve
    values = curve.force if quantity == "force" else curve.displacement
    return replace(test.displacement, time=curve.time, values=values, perturbed={})


def _has_single_samples(test: ReducedTest, quantity: Quantity) -> bool:
    """Check whether the curve has single samples of a faster signal."""
    filters = test.signals.filters.get(test.signals.force, ())
    is_fast = quantity == "force" and test.force.clock != test.clocks.curve
    return is_fast and have_no_filter_effect([filter_function for filter_function, _ in filters])


def _interpolate_branches(trace: Trace, values: Floats, time: Floats, part: slice) -> Floats:
    """Interpolate a part of a curve branch by branch, with linear extrapolation to the turns.

    Parameters
    ----------
    trace, values : the curve, and its quantity
    time : shape (n,), s on its clock
    part : samples of the curve around those times
    """
    interpolated = np.empty(len(time))
    inner = [(x, at) for x, at in _list_turns(trace) if part.start < x < part.stop]
    for (start, begin), (stop, end) in pairwise(
        [(part.start, -np.inf), *inner, (part.stop, np.inf)]
    ):
        low, high = np.searchsorted(time, [begin, end], side="right")
        interpolated[low:high] = _interpolate_linearly(
            time[low:high], trace.time[start:stop], values[start:stop]
        )
    return interpolated


def _list_turns(trace: Trace) -> list[tuple[int, float]]:
    """Return the samples of a curve at which a piece begins, and their times."""
    turns = {branch.start: branch.start_time for branch in trace.branches}
    turns |= {branch.stop: branch.stop_time for branch in trace.branches}
    if trace.failed_at is not None:
        turns[trace.failed_at + 1] = float(trace.time[trace.failed_at : trace.failed_at + 2].mean())
    return sorted(turns.items())


def _mean_step(time: Floats) -> float:
    return float(time[-1] - time[0]) / max(len(time) - 1, 1)


def _interpolate_linearly(at: Floats, time: Floats, values: Floats) -> Floats:
    """Interpolate values, with linear extrapolation at both ends."""
    interpolated = np.interp(at, time, values)
    if len(time) < 2:
        return interpolated
    for pair, there in ((slice(2), at < time[0]), (slice(-2, None), at > time[-1])):
        (before, after), (low, high) = time[pair], values[pair]
        interpolated[there] = low + (high - low) / (after - before) * (at[there] - before)
    return interpolated
