"""Draw replicates of the curve of a test, and fit lines to many curves at once."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from itertools import pairwise
from typing import TYPE_CHECKING, Literal, TypeAlias

import numpy as np

from labpipe.records import causes
from labpipe.records.arrays import (
    Flags,
    Floats,
    Ints,
    Samples,
    average_between,
    compute_median_step,
    divide,
    drop_missing,
)
from labpipe.records.curve import Curve, Direction, Slip, SlipDecision
from labpipe.records.estimates import UnavailableError
from labpipe.records.signals import Clocks, Filter, Signal
from labpipe.results.kinds import FailurePoint, ReducedTest
from labpipe.signal.filters import filter_pieces
from labpipe.uncertainty.noise_model import compute_drift_modes
from labpipe.uncertainty.replicates import (
    Distribution,
    Input,
    Replicates,
    Trace,
    draw_replicates,
    fit_smooth_trace,
    make_generator,
)

if TYPE_CHECKING:
    from labpipe.results.slack_and_slips import LoadDrop


def require_samples(n_samples: int, n_needed: int, location: str = " in the stretch") -> None:
    """Raise ``too_few_samples`` for fewer samples than needed; `location` begins with a space."""
    if n_samples < n_needed:
        facts = {"count": n_samples, "where": location, "needed": n_needed}
        raise UnavailableError.of("results.too_few_samples", **facts)


def require_travel(values: Floats, quantity: str = "displacement") -> None:
    """Raise ``no_travel`` if a quantity is constant."""
    if np.ptp(values) == 0.0:
        raise UnavailableError.of("results.no_travel", quantity=quantity)


def compute_slope(x: Floats, y: Floats) -> Floats:
    """Compute the slope of the least-squares line of each row.

    Parameters
    ----------
    x, y : shape (..., n), without NaN; either may be shape (n,), the same for all rows

    Returns
    -------
    Shape (...), the slopes sum (x - mean x) y / sum (x - mean x)^2; NaN if `x` is constant.

    Examples
    --------
    >>> compute_slope(np.array([0.0, 1.0, 2.0]), np.array([[1.0, 2.0, 6.0], [5.0, 5.0, 5.0]]))
    array([2.5, 0. ])
    """
    centred_x = x - x.mean(axis=-1, keepdims=True)
    return divide(np.vecdot(centred_x, y), np.vecdot(centred_x, centred_x))


def compute_zero_crossing(x: Floats, y: Floats) -> Floats:
    """Compute the position at which the rising least-squares line of each row is zero.

    Parameters
    ----------
    x, y : shape (..., n), without NaN

    Returns
    -------
    Shape (...), positions in the unit of `x`; NaN if the line does not rise.

    Examples
    --------
    >>> rows = np.array([[1.0, 2.0, 3.0], [3.0, 2.0, 1.0]])
    >>> compute_zero_crossing(np.array([5.0, 6.0, 7.0]), rows)
    array([ 4., nan])
    """
    slope = compute_slope(x, y)
    slope = np.where(slope > 0.0, slope, np.nan)
    return np.asarray(x.mean(axis=-1) - y.mean(axis=-1) / slope)


def fit_chosen_lines(is_chosen: Flags, x: Floats, y: Floats) -> tuple[Floats, Floats, Floats]:
    """Fit the least-squares line through chosen samples of each row.

    Parameters
    ----------
    is_chosen : shape (rows, n), whether the sample belongs to the line of its row
    x, y : shape (rows, n) or (n,); NaN only where not chosen

    Returns
    -------
    mean_x, mean_y : shape (rows,), a point of each line; NaN without chosen samples
    slope : shape (rows,); NaN without chosen samples, or if their `x` are equal
    """
    n_chosen = is_chosen.sum(axis=1)
    x, y = (np.where(is_chosen, values, 0.0) for values in (x, y))
    mean_x, mean_y = (divide(values.sum(axis=1), n_chosen) for values in (x, y))
    centred_x = np.where(is_chosen, x - mean_x[:, np.newaxis], 0.0)
    spread, rounding = np.vecdot(centred_x, x), 4.0 * np.finfo(float).eps * n_chosen * mean_x**2
    spread = np.where(spread > rounding, spread, 0.0)
    return mean_x, mean_y, divide(np.vecdot(centred_x, y), spread)


def compute_polynomial_weights(x: Floats, *, degree: int) -> Floats:
    """Compute the weights of values in the coefficients of their least-squares polynomial.

    Parameters
    ----------
    x : shape (n,), positions of the values, preferably near zero
    degree : degree of the polynomial

    Returns
    -------
    Shape (degree + 1, n). The weighted sums of the values are the coefficients, constant first.

    Examples
    --------
    >>> weights = compute_polynomial_weights(np.arange(4.0), degree=2)
    >>> (weights @ np.array([5.0, 6.0, 9.0, 14.0])).round(12).tolist()
    [5.0, 0.0, 1.0]
    """
    scale = float(np.abs(x).max()) or 1.0
    powers = np.arange(degree + 1.0)[:, np.newaxis]
    return np.asarray(np.linalg.pinv((x / scale) ** powers).T / scale**powers)


@dataclass(frozen=True, slots=True, eq=False)
class CommonPath:
    """Displacements of a reference curve, to which the forces of other curves are moved.

    Parameters
    ----------
    samples : shape (k,), indices of the samples; a slice if they are all samples in order
    displacement : shape (k,), m, displacements of the reference curve
    slope : shape (k,), N/m, slopes of the reference curve
    """

    samples: Samples
    displacement: Floats
    slope: Floats

    @classmethod
    def of(cls, displacement: Floats, force: Floats, samples: Ints) -> CommonPath:
        """Make the path of a reference curve; slopes are over a fiftieth of it on each side.

        Parameters
        ----------
        displacement, force : shape (n,), m, N; a stretch of a loading branch in order of time
        samples : shape (k,), indices of samples with both quantities, in any order

        Notes
        -----
        If the displacement does not increase over the two fiftieths, the slope is that from the
        first to the last sample. If it does not increase between these either, the slope is zero.
        """
        time_order = np.argsort(samples)
        d, f = displacement[samples[time_order]], force[samples[time_order]]
        last = len(d) - 1
        rows, half_width = np.arange(last + 1), max(1, last // 50)
        start, stop = np.maximum(rows - half_width, 0), np.minimum(rows + half_width, last)
        run, rise, stroke = d[stop] - d[start], f[stop] - f[start], d[-1] - d[0]
        mean_slope = (f[-1] - f[0]) / stroke if stroke > 0.0 else 0.0
        slope = np.empty(last + 1)
        slope[time_order] = np.where(run > 0.0, rise / np.where(run > 0.0, run, 1.0), mean_slope)
        is_all = np.array_equal(samples, np.arange(len(force)))
        return cls(slice(None) if is_all else samples, displacement[samples], slope)

    def move_force(self, force: Floats, displacement: Floats | None = None) -> Floats:
        """Move forces of curves to the displacements of the reference curve.

        Parameters
        ----------
        force : shape (..., n), N, of curves with the samples of the reference curve
        displacement : shape (..., n), m; None for that of the reference curve

        Returns
        -------
        Shape (..., k), N: f - (df/dd) (d - d_0), to first order the force at the displacements d_0
        of the reference curve.

        Notes
        -----
        With a displacement from cameras, each replicate has its own noise of the displacement. The
        moved forces of all replicates belong to the same displacements, so that one linear function
        of the forces applies to all of them. The second order is neglected: noise of the
        displacement reduces a least-squares slope by the ratio of its variance to that of the
        displacements.
        """
        path_force: Floats = force[..., self.samples]
        if displacement is None:
            return path_force
        change = displacement[..., self.samples] - self.displacement
        return path_force - self.slope * change if change.any() else path_force


def find_finite_samples(displacement: Floats, force: Floats) -> Ints:
    """Find the indices of the samples that have both quantities, in order of time.

    Parameters
    ----------
    displacement, force : shape (n,), m, N; NaN where unknown
    """
    return np.flatnonzero(~np.isnan(displacement) & ~np.isnan(force))


Quantity: TypeAlias = Literal["force", "displacement"]


@dataclass(frozen=True, slots=True, eq=False)
class SampleNoise:
    """Noise of single samples of a quantity around a sample of the curve.

    Parameters
    ----------
    smooth_values : shape (n,), m or N, the curve without noise
    deviations : shape (n,), m or N, deviations of single samples from the mean of their block
    unfiltered_deviations : shape (n,), m or N, the same deviations before `filters`
    filters : filters of the quantity, applied to each piece; empty if its unfiltered record has
        another number of samples
    cuts : indices of the single samples at which a new piece begins
    blocks : shape (n,), index of the block of each single sample, which is a sample of the
        replicates. None if the noise of the replicates is that of single samples; deviations are
        then those from the smooth curve, less their mean
    rng : random generator with a fixed seed
    """

    smooth_values: Floats
    deviations: Floats
    unfiltered_deviations: Floats
    filters: tuple[Filter, ...]
    cuts: tuple[int, ...]
    blocks: Ints | None
    rng: np.random.Generator

    @classmethod
    def select(
        cls, test: ReducedTest, trace: Trace, quantity: Quantity, allowed: slice, centre: int
    ) -> SampleNoise | None:
        """Select the single samples of a quantity around a sample of the curve.

        Parameters
        ----------
        test : reduced test with a curve
        trace : the curve without noise, with the samples of the replicates
        quantity : quantity whose samples are needed
        allowed : samples of `trace` that may be used
        centre : index of the central sample, such as the peak

        Returns
        -------
        The noise; None if the replicates have all samples, or if fewer than 20 samples have a
        value.
        """
        # The scatter ratio is that of the deviation of a sample to the usual deviation.
        max_samples, min_samples, min_block_samples, max_scatter_ratio = 20_000, 20, 1.5, 30.0
        name, signal = getattr(test.signals, quantity), test.force
        has_other_clock = quantity == "force" and test.force.clock != test.clocks.curve_clock
        if not has_other_clock:
            time, values = test.required_curve.time, getattr(test.required_curve, quantity)
            signal = replace(test.displacement, time=time, values=values)
        unfiltered = test.unfiltered_force if quantity == "force" else test.signals.raw[name]
        filters = test.signals.filters.get(name, ())
        has_single_samples = has_other_clock and have_no_effect(filters)
        if unfiltered is None or len(unfiltered.time) != len(signal.time):
            unfiltered, filters = signal, ()
        rng = make_generator(test.seed, f"single {quantity}")
        block_samples = compute_mean_step(trace.time) / compute_mean_step(signal.time)
        if block_samples < min_block_samples:
            return None
        max_blocks = max(1, int(max_samples / block_samples))  # on each side of the centre
        first_block = max(allowed.start, centre - max_blocks)
        block_range = slice(first_block, min(allowed.stop, centre + max_blocks + 1))
        block_time = trace.time[block_range]
        ends = [test.clocks.from_curve(float(end), signal.clock) for end in block_time[[0, -1]]]
        samples = slice(*np.searchsorted(signal.time, ends).tolist())
        time = test.clocks.to_curve(signal.time[samples], signal.clock)
        smooth = _interpolate_branches(trace, getattr(trace, quantity), time, block_range)
        deviations = np.stack([x.values[samples] - smooth for x in (signal, unfiltered)])
        is_valid = ~np.isnan(deviations).any(axis=0)
        if quantity == "force" and trace.failed_at is not None and is_valid.any():
            # In a block that contains a break, samples are far from the mean of the block.
            usual_deviation = np.quantile(np.abs(deviations[0, is_valid]), 0.9)
            is_valid &= np.abs(deviations[0]) <= (max_scatter_ratio * usual_deviation or np.inf)
        if is_valid.sum() < min_samples:
            return None
        time, smooth, deviations = time[is_valid], smooth[is_valid], deviations[:, is_valid]
        cut_times = [cut for _, cut in _list_cuts(trace) if time[0] < cut < time[-1]]
        cuts = tuple(np.searchsorted(time, cut_times, side="right").tolist())
        if has_single_samples:
            deviations -= deviations.mean(axis=1, keepdims=True)
            return cls(smooth, deviations[0], deviations[1], filters, cuts, None, rng)
        blocks = np.searchsorted(0.5 * (block_time[1:] + block_time[:-1]), time)
        counts = np.maximum(np.bincount(blocks), 1)
        deviations -= np.stack([(np.bincount(blocks, row) / counts)[blocks] for row in deviations])
        return cls(smooth, deviations[0], deviations[1], filters, cuts, blocks + first_block, rng)

    def draw_peak_effect(self, noise: Floats, sense: float) -> Floats:
        """Draw the effect of noise on the peak of the quantity in the direction of loading.

        Parameters
        ----------
        noise : shape (replicates, samples of the curve), m or N, noise of the quantity
        sense : sign of the change of the quantity in loading

        Returns
        -------
        Shape (replicates,), m or N, peak with noise less the peak of the smooth curve.
        """
        # With noise, a sample this many standard deviations below the peak may become the largest.
        max_deviations = 8.0
        smooth = sense * self.smooth_values
        variance = self.deviations.var()
        if self.blocks is not None:
            variance += np.nanvar(noise[:, self.blocks[0] : self.blocks[-1] + 1])
        high_samples = np.flatnonzero(smooth >= smooth.max() - max_deviations * np.sqrt(variance))
        # Any two windows longer than half of the samples would share some deviations.
        high_samples = high_samples[high_samples < high_samples[0] + (len(smooth) + 1) // 2]
        filter_reach = min(_measure_filter_reach(self.filters), (len(smooth) - 1) // 4)
        start = max(int(high_samples[0]) - filter_reach, 0)
        stop = min(int(high_samples[-1]) + filter_reach + 1, len(smooth))
        deviations = self.unfiltered_deviations
        windows = np.lib.stride_tricks.sliding_window_view(deviations, stop - start)
        rows = self.rng.integers(0, len(windows), len(noise))
        cuts = [cut - start for cut in self.cuts]
        drawn_noise = filter_pieces(windows[rows], cuts, self.filters)[:, high_samples - start]
        if self.blocks is not None:
            drawn_noise += noise[:, self.blocks[high_samples]]
        peaks = (smooth[high_samples] + sense * drawn_noise).max(axis=1)
        return np.asarray(sense * (peaks - smooth.max()))

    def draw_deviations(self, shape: tuple[int, ...]) -> Floats:
        """Draw deviations of single samples from the mean of their block; zero without blocks."""
        if self.blocks is None:
            return np.zeros(shape)
        return self.rng.choice(self.deviations, size=shape)


@lru_cache(maxsize=16)
def _measure_filter_reach(filters: tuple[Filter, ...]) -> int:
    """Measure over how many samples on each side filters spread a pulse, down to 0.1 %."""
    middle = 2000
    pulse = np.eye(1, 2 * middle + 1, middle)[0]
    response = np.abs(filter_pieces(pulse, (), filters))
    return int(np.abs(np.flatnonzero(response > 1e-3 * response.max()) - middle).max())


def have_no_effect(filters: Sequence[Filter]) -> bool:
    """Return whether filters leave a pulse of a single sample unchanged."""
    pulse = np.eye(1, 101, 50)[0]
    return all(np.array_equal(filter_function(pulse), pulse) for filter_function, _ in filters)


def _interpolate_branches(trace: Trace, values: Floats, time: Floats, samples: slice) -> Floats:
    """Interpolate a part of a curve branch by branch, with linear extrapolation to the turns.

    Parameters
    ----------
    trace : the curve
    values : shape (samples of the curve,), force or displacement of the curve
    time : shape (n,), s on the clock of the curve, times of the interpolated values
    samples : samples of the curve around these times
    """
    interpolated = np.empty(len(time))
    cuts = [cut for cut in _list_cuts(trace) if samples.start < cut[0] < samples.stop]
    ends = [(samples.start, -np.inf), *cuts, (samples.stop, np.inf)]
    for (first, start_time), (last, stop_time) in pairwise(ends):
        piece = slice(*np.searchsorted(time, [start_time, stop_time], side="right"))
        line = trace.time[first:last], values[first:last]
        interpolated[piece] = _interpolate_linearly(time[piece], *line)
    return interpolated


def _list_cuts(trace: Trace) -> list[tuple[int, float]]:
    """List the samples at which a piece of a curve begins, with the times of turn or failure."""
    cuts = {branch.start: branch.start_time for branch in trace.branches}
    cuts |= {branch.stop: branch.stop_time for branch in trace.branches}
    if trace.failed_at is not None:
        cuts[trace.failed_at + 1] = float(trace.time[trace.failed_at : trace.failed_at + 2].mean())
    return sorted(cuts.items())


def compute_mean_step(time: Floats) -> float:
    """Compute the mean step between times, s."""
    return float(time[-1] - time[0]) / max(len(time) - 1, 1)


def _interpolate_linearly(x: Floats, time: Floats, values: Floats) -> Floats:
    """Interpolate values at other times `x`, with linear extrapolation at both ends."""
    interpolated = np.interp(x, time, values)
    if len(time) < 2:
        return interpolated
    for pair, is_outside in ((slice(2), x < time[0]), (slice(-2, None), x > time[-1])):
        (start, stop), (first, last) = time[pair], values[pair]
        slope = (last - first) / (stop - start)
        interpolated[is_outside] = first + slope * (x[is_outside] - start)
    return interpolated


_CAUSES_BY_FRAME = (causes.SHAPE, causes.GRIP, causes.PULL, causes.CENTRE)
"""Causes whose effect is computed frame by frame, from markers with noise."""


def replicate_curves(test: ReducedTest) -> Replicates | None:
    """Draw replicates of the curve of a test.

    Parameters
    ----------
    test : reduced test with a curve, its failure and its slips

    Returns
    -------
    The replicates; None without a curve, without branches, or without an unfiltered force.
    """
    curve, unfiltered = test.curve, test.unfiltered_force
    if curve is None or unfiltered is None or not curve.branches:
        return None
    measured_trace = make_trace(test)
    corners = [end for branch in curve.branches for end in (branch.start, branch.stop)]
    corners += [end for slip in test.slips for end in (slip.start + 1, slip.stop)]
    corners += [] if measured_trace.failed_at is None else [measured_trace.failed_at + 1]
    corners = sorted({corner for corner in corners if 0 < corner < len(curve.time)})
    starts = _find_block_starts(corners, curve)
    averaged_trace = _average_on_grid(measured_trace, starts)
    cuts: list[int] = np.searchsorted(starts, corners).tolist()
    records, filters = [], []
    for name, (filtered, raw) in (
        (test.signals.displacement, _read_displacements(test, curve)),
        (test.signals.force, _read_forces(test, unfiltered, curve)),
    ):
        grid_filters = _make_grid_filters(test, name, averaged_trace.time)
        record = filtered if have_no_effect(grid_filters) else raw
        records.append(average_between(record, starts))
        filters.append(partial(_filter_records, filters=grid_filters, cuts=cuts))
    grid = replace(averaged_trace, displacement=records[0], force=records[1])
    inputs = tuple(_list_inputs(test, starts, partial(fit_smooth_trace, grid, cuts=cuts)))
    return draw_replicates(
        measured_trace,
        grid,
        cuts,
        (filters[0], filters[1]),
        inputs,
        seed=test.seed,
        compliance=test.compliance,
        averaged_trace=averaged_trace,
    )


def make_trace(test: ReducedTest) -> Trace:
    """Make the trace of the curve of a test.

    Parameters
    ----------
    test : reduced test with a curve
    """
    curve, failure = test.required_curve, test.failure
    return Trace(
        time=curve.time,
        displacement=curve.displacement,
        force=curve.force,
        branches=curve.branches,
        failed_at=failure.sample if isinstance(failure, FailurePoint) else None,
        sizes=test.setup.sizes,
    )


def select_first_loading(trace: Trace) -> slice:
    """Select the samples of the first loading up to a failure; none if there is no loading.

    Parameters
    ----------
    trace : one or many curves
    """
    loadings = [branch for branch in trace.branches if branch.direction is Direction.LOADING]
    if not loadings:
        return slice(0, 0)
    start, stop = loadings[0].start, loadings[0].stop
    if trace.failed_at is not None:
        stop = min(stop, trace.failed_at + 1)
    return slice(start, max(start, stop))


def _find_block_starts(corners: Sequence[int], curve: Curve) -> Ints:
    """Find the first sample of each block of a grid; no block crosses a corner.

    The last block before a corner includes the remainder.
    """
    # The shortest branch has fewer than `min_branch_blocks` blocks if `max_blocks` requires longer
    # blocks. A record of fewer than `min_blocks` samples is not averaged.
    min_blocks, max_blocks, min_branch_blocks = 6_000, 20_000, 500
    n_samples = len(curve.time)
    shortest = min(branch.stop - branch.start for branch in curve.branches)
    width = min(n_samples // min_blocks, shortest // min_branch_blocks)
    width = max(width, -(-n_samples // max_blocks))  # rounded up
    pieces = pairwise([0, *corners, n_samples])
    starts = [np.arange(start, max(stop - width, start) + 1, width) for start, stop in pieces]
    return np.concatenate(starts)


def find_piece_starts(clocks: Clocks, ends: Sequence[float], signal: Signal) -> list[int]:
    """Find the samples of a signal at which a new piece begins.

    Parameters
    ----------
    clocks : clocks of the test
    ends : s on the clock of the curve, times of the ends of branches and of the failure
    signal : the signal, with its clock
    """
    signal_ends = [clocks.from_curve(end, signal.clock) for end in ends]
    starts: list[int] = np.searchsorted(signal.time, signal_ends, side="right").tolist()
    return starts


def _average_on_grid(trace: Trace, starts: Ints) -> Trace:
    """Average a trace over the blocks of a grid."""
    failed_at, branches = trace.failed_at, []
    for branch in trace.branches:
        start, stop = np.searchsorted(starts, [branch.start, branch.stop]).tolist()
        branches.append(replace(branch, start=start, stop=stop))
    return replace(
        trace,
        time=average_between(trace.time, starts),
        displacement=average_between(trace.displacement, starts),
        force=average_between(trace.force, starts),
        branches=tuple(branches),
        failed_at=failed_at and int(np.searchsorted(starts, failed_at, side="right")) - 1,
    )


def _read_displacements(test: ReducedTest, curve: Curve) -> tuple[Floats, Floats]:
    """Return the displacement including that of the load frame, filtered and unfiltered.

    For a thinned displacement, both are the filtered one.
    """
    filtered = curve.displacement + test.compliance * np.nan_to_num(curve.force)
    raw = test.signals.raw[test.signals.displacement].values
    if len(raw) != len(filtered):
        return filtered, filtered
    return filtered, raw + float(np.nanmean(filtered - raw))


def _read_forces(test: ReducedTest, unfiltered: Signal, curve: Curve) -> tuple[Floats, Floats]:
    """Return the force of the curve, and the unfiltered force at its times, slips added back."""
    force = _sample_on_curve(test, unfiltered, curve.time)
    force = add_slips_back(force, _list_repaired_slips(test))
    # The filter bridges missing samples.
    force = np.where(np.isnan(force), curve.force, force)
    return curve.force, np.where(np.isnan(curve.force), np.nan, force)


def _sample_on_curve(test: ReducedTest, signal: Signal, time: Floats) -> Floats:
    """Interpolate a signal at the times of the curve, or average a faster one around them."""
    if len(signal.time) < 2 * len(time):
        return test.clocks.interpolate(signal, time)
    step, half_step = compute_median_step(signal.time), 0.5 * compute_median_step(time)
    # Each sample is the mean over a step around it, so the ends are half a step earlier.
    curve_ends = np.array([time - half_step, time + half_step])
    ends = test.clocks.from_curve(curve_ends, signal.clock) - 0.5 * step
    end_samples = np.searchsorted(signal.time[:-1], ends, side="right")
    starts = np.where(end_samples > 0, signal.time[end_samples - 1], signal.time[0] - step)
    fractions = (ends - starts) / (signal.time[end_samples] - starts)
    is_inside = ((fractions >= 0.0) & (fractions < 1.0)).all(axis=0)

    blanks, values = np.flatnonzero(np.isnan(signal.values)), signal.values
    values = np.where(np.isnan(values), 0.0, values) if len(blanks) else values
    interval_sums = np.add.reduceat(values, end_samples.T.ravel())[::2]  # reduceat has no empty sum
    head, tail = fractions * values[end_samples]
    sums = np.where(end_samples[1] > end_samples[0], interval_sums, 0.0) + tail - head
    head, tail = fractions * ~np.isnan(signal.values[end_samples])
    counts = np.diff(end_samples - np.searchsorted(blanks, end_samples), axis=0)[0] + tail - head
    counts = np.where(is_inside, counts, 0.0)
    mean: Floats = sums / np.where(counts > 0.5, counts, np.nan)
    is_missing = np.isnan(mean)
    mean[is_missing] = test.clocks.interpolate(signal, time[is_missing])
    return mean


def _make_grid_filters(test: ReducedTest, name: str, time: Floats) -> list[Filter]:
    """Scale the filters of a signal to the step of the grid; none for a thinned displacement."""
    signals = test.signals
    raw, step = signals.raw[name].time, compute_median_step(time)
    if name == signals.displacement and len(raw) != len(test.required_curve.time):
        return []
    grid_filters = list[Filter]()
    for filter_function, stride in signals.filters.get(name, ()):
        grid_filters.append((filter_function.scale_step(step / compute_median_step(raw)), 1))
        raw = raw[::stride]
    return grid_filters


def _filter_records(values: Floats, *, filters: Sequence[Filter], cuts: Sequence[int]) -> Floats:
    """Filter records (..., n) piece by piece, except for the missing values at both ends."""
    finite = np.flatnonzero(~np.isnan(values.reshape(-1, values.shape[-1])[0]))
    if not filters or not len(finite):
        return values
    filtered, first, samples = values.copy(), int(finite[0]), slice(finite[0], finite[-1] + 1)
    piece_starts = [cut - first for cut in cuts]
    filtered[..., samples] = filter_pieces(values[..., samples], piece_starts, filters)
    return filtered


def _list_inputs(
    test: ReducedTest, starts: Ints, smooth: Callable[[Floats], Floats]
) -> Iterator[Input]:
    """Yield the uncertain inputs of a record; the function `smooth` smooths values on the grid."""
    yield from _list_scales(test)
    displacement, curve, time = test.displacement, test.required_curve, test.required_curve.time
    drift = test.raw_force.zero_drift * float(np.nanmax(np.abs(curve.force)))
    time_from_zero = np.abs(average_between(time, starts) - _find_zero_time(test))
    for index, mode in enumerate(compute_drift_modes(time_from_zero, drift), start=1):
        add_drift = partial(_add_force, change=mode, compliance=test.compliance)
        yield Input(causes.DRIFT_OF_ZERO, add_drift, stream=f"{causes.DRIFT_OF_ZERO} {index}")
    for cause, signal in displacement.variants.items():
        change = average_between(signal - displacement.values, starts)
        # Noise of the change would raise the largest of many samples.
        change = smooth(change) if cause in _CAUSES_BY_FRAME else change
        distribution: Distribution = "uniform" if cause == causes.SHAPE else "normal"
        yield Input(cause, partial(shift_displacement_by, change=change), distribution=distribution)
    for cause, clocks in test.clocks.variants.items():
        delay = clocks.to_force_times(time) - test.clocks.to_force_times(time)
        yield Input(cause, partial(_delay_force, delay=average_between(delay, starts)))
    for name, uncertainty in test.setup.uncertainties.items():
        cause = name if name in (causes.LENGTH, causes.SPAN) else causes.SECTION
        change_size = partial(_change_size, name=name, change=uncertainty)
        yield Input(cause, change_size, moves_curve=False, stream=name)
    curve_step = len(starts) / len(time)  # in steps of the grid

    def delay_event(trace: Trace, n_units: float) -> Trace:
        return replace(trace, steps_to_event=n_units * curve_step)

    yield Input(causes.STEP, delay_event, distribution="step", moves_curve=False)
    for index, slip in enumerate(_list_repaired_slips(test), start=1):
        is_after_slip = np.arange(len(starts)) >= np.searchsorted(starts, slip.stop)
        error = np.where(is_after_slip, slip.drop_interval.standard_error, 0.0)
        add_drop = partial(_add_force, change=error, compliance=0.0)
        yield Input(causes.REPAIRED_SLIPS, add_drop, stream=f"{causes.REPAIRED_SLIPS} {index}")


def _list_scales(test: ReducedTest) -> Iterator[Input]:
    """Yield the uncertain scales, zeros and resolutions of force and displacement."""
    force, displacement, compliance = test.raw_force, test.displacement, test.compliance
    add_force = partial(_add_force, compliance=compliance)

    def scale_force(trace: Trace, n_units: float, change: float) -> Trace:
        return add_force(trace, n_units, change=change * trace.force)

    def scale_displacement(trace: Trace, n_units: float, change: float) -> Trace:
        machine_displacement = trace.displacement + compliance * np.nan_to_num(trace.force)
        return shift_displacement_by(trace, n_units, change * machine_displacement)

    for cause, error, perturb in (
        (causes.SCALE_OF_FORCE, force.relative_error, scale_force),
        (causes.ZERO_OF_FORCE, force.zero_error, add_force),
        (causes.SCALE_OF_DISPLACEMENT, displacement.relative_error, scale_displacement),
        (causes.ZERO_OF_DISPLACEMENT, displacement.zero_error, shift_displacement_by),
    ):
        if error:
            yield Input(cause, partial(perturb, change=error))
    raw_displacement = test.signals.raw.get(test.signals.displacement)
    for cause, signal, add in (
        (causes.RESOLUTION_OF_FORCE, test.unfiltered_force, add_force),
        (causes.RESOLUTION_OF_DISPLACEMENT, raw_displacement, shift_displacement_by),
    ):
        if signal is not None and (step := _estimate_converter_step(signal.values)):
            yield Input(cause, partial(add, change=step / np.sqrt(12.0)), distribution="uniform")


def _list_repaired_slips(test: ReducedTest) -> list[Slip]:
    """List the slips whose losses are added back to the force."""
    return [slip for slip in test.slips if slip.decision is SlipDecision.REPAIRED]


def add_slips_back(force: Floats, slips: Sequence[Slip | LoadDrop]) -> Floats:
    """Add the losses of slips back to a force.

    Parameters
    ----------
    force : shape (n,), N
    slips : slips with indices of samples of `force`

    Returns
    -------
    Shape (n,), N. The loss of each slip is added from its sample `stop` on. Samples between `start`
    and `stop` are interpolated. NaN stay NaN.
    """
    repaired = np.array(force, dtype=np.float64)
    for slip in slips:
        repaired[slip.stop :] += slip.drop
    for slip in slips:
        inner = np.arange(slip.start + 1, slip.stop)
        ends = repaired[[slip.start, slip.stop]]
        line = np.interp(inner, [slip.start, slip.stop], ends)
        repaired[inner] = np.where(np.isnan(repaired[inner]), np.nan, line)
    return repaired


def _estimate_converter_step(values: Floats) -> float:
    """Estimate the step of a converter, or return 0 if the step is not coarser than the noise.

    A record with coarse steps is constant in more than half of its sampling steps, and becomes
    constant at least ten times. With noise, it would have values between two levels. The step is
    the median change.
    """
    min_constant_fraction, min_levels = 0.5, 10
    finite_values = drop_missing(values)
    is_constant = finite_values[1:] == finite_values[:-1]
    if not min_constant_fraction * len(is_constant) < is_constant.sum() < len(is_constant):
        return 0.0
    if np.sum(is_constant[1:] & ~is_constant[:-1]) < min_levels:
        return 0.0
    return float(np.median(np.abs(np.diff(finite_values))[~is_constant]))


def _find_zero_time(test: ReducedTest) -> float:
    """Return the time at which the force was zeroed, s on the clock of the curve.

    For a zero by a mean, it is the middle of the stretch. For a zero by a line, it is the outer end
    of the stretch. Without a zero, it is the time of the first sample.
    """
    signals, time = test.signals, test.required_curve.time
    name, clock = signals.force, signals.raw[signals.force].clock
    if name in signals.zero_stretches:
        return test.clocks.to_curve(0.5 * sum(signals.zero_stretches[name]), clock)
    if name not in signals.moving_zero_stretches:
        return float(time[0])
    first, last = (test.clocks.to_curve(end, clock) for end in signals.moving_zero_stretches[name])
    return first if first - time[0] < time[-1] - last else last


def _add_force(trace: Trace, n_units: float, *, change: float | Floats, compliance: float) -> Trace:
    """Add a multiple of a force to a trace, and subtract the displacement of the load frame."""
    shift = n_units * compliance * np.nan_to_num(change)
    force, displacement = trace.force + n_units * change, trace.displacement - shift
    return replace(trace, force=force, displacement=displacement)


def shift_displacement_by(trace: Trace, n_units: float, change: float | Floats) -> Trace:
    """Shift the displacement of a trace by a multiple of a length.

    Parameters
    ----------
    trace : one or many curves
    n_units : factor of the length
    change : m, one length, or one for each sample
    """
    return replace(trace, displacement=trace.displacement + n_units * change)


def _change_size(trace: Trace, n_units: float, *, name: str, change: float) -> Trace:
    """Add a multiple of a length to a size of a trace, if it has this size."""
    if name not in trace.sizes:
        return trace
    return replace(trace, sizes={**trace.sizes, name: trace.sizes[name] + n_units * change})


def _delay_force(trace: Trace, n_units: float, *, delay: Floats) -> Trace:
    """Delay the force of a trace by a multiple of a time for each sample."""
    return replace(trace, force=np.interp(trace.time + n_units * delay, trace.time, trace.force))
