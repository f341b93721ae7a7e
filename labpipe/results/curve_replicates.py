"""The curve of a test, and those that it may have been by the noise and the inputs of the test."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np

from labpipe.fits.failure_point import FailurePoint
from labpipe.records.arrays import Floats, Ints
from labpipe.records.causes import (
    CENTRE,
    DRIFT_OF_ZERO,
    GRIP,
    LENGTH,
    PULL,
    REPAIRED_SLIPS,
    RESOLUTION,
    SCALE_OF_DISPLACEMENT,
    SCALE_OF_FORCE,
    SECTION,
    SHAPE,
    SPAN,
    STEP,
    ZERO_OF_DISPLACEMENT,
    ZERO_OF_FORCE,
)
from labpipe.records.curve import Curve, Direction, SlipDecision
from labpipe.records.signals import FilterFunction, Signal
from labpipe.results.reduced_test import ReducedTest
from labpipe.uncertainty.extractors import Trace
from labpipe.uncertainty.replicates import (
    Filter,
    Input,
    Law,
    Replicates,
    draw_replicates,
    smooth_curve,
    spline_intervals_of,
)
from labpipe.uncertainty.zero_drift import drift_modes

_STANDS, _LEVELS = 0.5, 10
"""Share of the samples that stand where a converter is too coarse, and times that they do."""
_BY_FRAMES = (SHAPE, GRIP, PULL, CENTRE)
"""Causes whose change is found frame by frame, from markers with noise."""
_PULSE = np.eye(1, 101, 50)[0]
"""A single sample, to see what a filter does to it."""


def replicate_curves(test: ReducedTest) -> Replicates | None:
    """Draw the curves that the curve of a test may have been.

    Parameters
    ----------
    test : with a curve, its failure and its slips

    Returns
    -------
    Numbers are measured from them; None where there is no curve.
    """
    curve, unfiltered = test.curve, test.unfiltered
    if curve is None or unfiltered is None or not curve.branches:
        return None
    measured = traced(test)
    both = test.signals.displacement, test.signals.force
    starts = _starts(_corners(test), len(curve.time))
    grid_time = _means(curve.time, starts)
    acts = [_acts(test, name, grid_time) for name in both]
    signals = _machine(test, curve), _force(test, unfiltered, curve)
    cuts = [int(np.searchsorted(starts, corner)) for corner in _corners(test)]
    records = [
        _singles(curve.time, filtered, _corners(test), starts)
        if _does_nothing(act)
        else _means(raw, starts)
        for (filtered, raw), act in zip(signals, acts, strict=True)
    ]
    grid = replace(
        _on_grid(measured, starts), time=grid_time, displacement=records[0], force=records[1]
    )
    first, second = (partial(_filtered, acts=act, cuts=cuts) for act in acts)
    inputs = tuple(_inputs(test, starts, partial(_without_noise, grid=grid, cuts=cuts)))
    made_so = draw_replicates(
        measured, grid, cuts, (first, second), inputs, seed=test.seed, compliance=test.compliance
    )
    return replace(made_so, before_filters=None) if _does_nothing(acts[1]) else made_so


def traced(test: ReducedTest) -> Trace:
    """The curve of a test as numbers are read from it.

    Parameters
    ----------
    test : with a curve
    """
    curve, failure, setup = test.known_curve, test.failure, test.setup
    sizes = {"length": setup.length, "span": setup.span, **setup.section}
    return Trace(
        time=curve.time,
        displacement=curve.displacement,
        force=curve.force,
        branches=curve.branches,
        failed_at=failure.sample if isinstance(failure, FailurePoint) else None,
        sizes={name: size for name, size in sizes.items() if size is not None},
    )


def loading_of(trace: Trace) -> slice:
    """Samples of the first loading, up to the failure if it lies there; may be empty.

    Parameters
    ----------
    trace : one or many curves
    """
    branch = next(
        (branch for branch in trace.branches if branch.direction is Direction.LOADING), None
    )
    if branch is None:
        return slice(0, 0)
    if trace.failed_at is not None and trace.failed_at < branch.stop:
        return slice(branch.start, max(trace.failed_at + 1, branch.start))
    return slice(branch.start, branch.stop)


def _corners(test: ReducedTest) -> list[int]:
    """Samples of the curve at which a new piece of the record begins: turns, failure, slips."""
    curve, failure = test.known_curve, test.failure
    cuts = [end for branch in curve.branches for end in (branch.start, branch.stop)]
    if isinstance(failure, FailurePoint):
        cuts.append(failure.sample + 1)
    cuts += [end for slip in test.slips for end in (slip.start + 1, slip.stop)]
    return sorted({cut for cut in cuts if 0 < cut < len(curve.time)})


def _starts(corners: Sequence[int], count: int) -> Ints:
    """First samples of the blocks of a grid, none of which lies over a corner.

    What is left over at the end of a piece joins its last block.
    """
    # Samples of longer curves are averaged in blocks.
    max_samples = 20_000
    block = -(-count // max_samples)
    pieces = pairwise([0, *corners, count])
    starts = [np.arange(low, max(high - block, low) + 1, block) for low, high in pieces]
    return np.concatenate(starts)


def _means(values: Floats, starts: Ints) -> Floats:
    """Means of the blocks of a grid."""
    if len(starts) == len(values):
        return values
    means: Floats = np.add.reduceat(values, starts) / np.diff(np.append(starts, len(values)))
    return means


def _singles(time: Floats, values: Floats, corners: Sequence[int], starts: Ints) -> Floats:
    """Values of a grid with the noise of single samples.

    A largest sample is one sample, and a mean of many has far less noise. One of each block lends
    its noise, by chance: evenly taken ones would fold hum. The curve is that of the means.
    """
    # The spline separates the noise of single samples from the curve.
    spline_intervals = 40
    if len(starts) == len(values):
        return values
    smooth = smooth_curve(time, values, corners, spline_intervals)
    lengths = np.diff(np.append(starts, len(values)))
    one = starts + np.random.default_rng(0).integers(0, lengths)
    noise: Floats = (values - smooth)[one]
    return _means(smooth, starts) + noise


def _on_grid(trace: Trace, starts: Ints) -> Trace:
    """A trace that counts its samples on a grid."""
    failed = trace.failed_at
    branches = tuple(
        replace(
            branch,
            start=int(np.searchsorted(starts, branch.start)),
            stop=int(np.searchsorted(starts, branch.stop)),
        )
        for branch in trace.branches
    )
    if failed is not None:
        failed = int(np.searchsorted(starts, failed, side="right")) - 1
    return replace(trace, branches=branches, failed_at=failed)


def _machine(test: ReducedTest, curve: Curve) -> tuple[Floats, Floats]:
    """The displacement of the curve with what its frame gave way, filtered and unfiltered."""
    filtered = curve.displacement + test.compliance * np.nan_to_num(curve.force)
    raw = test.signals.raw[test.signals.displacement].values
    if len(raw) != len(filtered):
        return filtered, filtered
    return filtered, raw + float(np.nanmean(filtered - raw))


def _force(test: ReducedTest, unfiltered: Signal, curve: Curve) -> tuple[Floats, Floats]:
    """The force of the curve, and as it is without filters, what slips lost added back."""
    from labpipe.fits.grip_slips import add_back

    force = _on_curve(test, unfiltered, curve.time)
    repaired = [slip for slip in test.slips if slip.decision is SlipDecision.REPAIRED]
    if repaired:
        force = add_back(force, repaired)
    # Where no sample was recorded the filter reached across, and the curve has a force.
    force = np.where(np.isnan(force), curve.force, force)
    return curve.force, np.where(np.isnan(curve.force), np.nan, force)


def _on_curve(test: ReducedTest, signal: Signal, time: Floats) -> Floats:
    """A signal at times of the curve: of a faster one the mean around each of them."""
    if len(signal.time) < 2 * len(time):
        return test.clocks.sampled(signal, time)
    is_finite = ~np.isnan(signal.values)
    step = float(np.median(np.diff(signal.time)))
    ends = np.append(signal.time[0] - 0.5 * step, signal.time + 0.5 * step)
    half = 0.5 * float(np.median(np.diff(time)))

    def around(values: Floats) -> Floats:
        total = replace(signal, time=ends, values=np.append(0.0, np.cumsum(values)))
        low, high = (test.clocks.sampled(total, time + side * half) for side in (-1.0, 1.0))
        return high - low

    counts = around(is_finite.astype(np.float64))
    mean = np.full(len(time), np.nan)
    np.divide(around(np.where(is_finite, signal.values, 0.0)), counts, out=mean, where=counts > 0.5)
    return np.where(np.isnan(mean), test.clocks.sampled(signal, time), mean)


def _acts(test: ReducedTest, name: str, time: Floats) -> list[FilterFunction]:
    """The filters of a signal for samples of the grid; none where it has been thinned."""
    signals = test.signals
    filters, raw = signals.filters.get(name, ()), signals.raw[name].time
    if name == signals.displacement and len(raw) != len(test.known_curve.time):
        return []
    acts = list[FilterFunction]()
    for act, stride in filters:
        acts.append(act.coarser(float(np.median(np.diff(time)) / np.median(np.diff(raw)))))
        raw = raw[::stride]
    return acts


def _does_nothing(acts: Sequence[FilterFunction]) -> bool:
    """Whether filters leave single samples as they are."""
    return all(np.array_equal(act(_PULSE), _PULSE) for act in acts)


def _filtered(values: Floats, *, acts: Sequence[FilterFunction], cuts: Sequence[int]) -> Floats:
    """Records (..., n) after all filters, piece by piece; nothing is known beyond their ends."""
    finite = np.flatnonzero(~np.isnan(values.reshape(-1, values.shape[-1])[0]))
    if not acts or not len(finite):
        return values
    first, last = int(finite[0]), int(finite[-1]) + 1
    inner = [cut for cut in cuts if first < cut < last]
    parts = [values[..., low:high] for low, high in pairwise([first, *inner, last])]
    for act in acts:
        parts = [act(part) for part in parts]
    return np.concatenate([values[..., :first], *parts, values[..., last:]], axis=-1)


def _without_noise(change: Floats, *, grid: Trace, cuts: Sequence[int]) -> Floats:
    """What an input changes a record by, without the noise of the record in it.

    The largest of many samples would be raised by that noise, whichever way the input is moved.
    """
    parts = spline_intervals_of(grid)
    return smooth_curve(grid.time, change, cuts, parts, branches=grid.branches)


def _inputs(test: ReducedTest, starts: Ints, smooth: Filter) -> Iterator[Input]:
    """What is the same for the whole record, and known with an uncertainty."""
    force, displacement = test.raw_force, test.displacement
    gain, raised, scaled = (
        partial(effect, compliance=test.compliance) for effect in (_gain, _raised, _scaled)
    )
    for cause, by, moved in (
        (SCALE_OF_FORCE, force.relative_error, gain),
        (ZERO_OF_FORCE, force.zero_error, raised),
        (SCALE_OF_DISPLACEMENT, displacement.relative_error, scaled),
        (ZERO_OF_DISPLACEMENT, displacement.zero_error, displaced),
    ):
        if by:
            yield Input(cause, partial(moved, by=by))
    if test.unfiltered is not None and (coarse := _coarse_step(test.unfiltered.values)):
        half = partial(raised, by=coarse / np.sqrt(12.0))
        yield Input(RESOLUTION, half, law="uniform")
    yield from _wanders(test, _means(test.known_curve.time, starts))
    for cause, signal in displacement.moved.items():
        change = _means(signal - displacement.values, starts)
        change = smooth(change) if cause in _BY_FRAMES else change
        law: Law = "uniform" if cause == SHAPE else "normal"
        yield Input(cause, partial(_bent, by=change), law=law)
    for cause, clocks in test.clocks.moved.items():
        time = test.known_curve.time
        later = clocks.sampled_at(time) - test.clocks.sampled_at(time)
        yield Input(cause, partial(_later, by=_means(later, starts)))
    for name, by in test.setup.uncertainties.items():
        cause = name if name in (LENGTH, SPAN) else SECTION
        yield Input(cause, partial(_sized, name=name, by=by), moves_curve=False, stream=name)
    step = len(starts) / len(test.known_curve.time)
    yield Input(STEP, partial(_beyond, step=step), law="step", moves_curve=False)
    repaired = [slip for slip in test.slips if slip.decision is SlipDecision.REPAIRED]
    for number, slip in enumerate(repaired, start=1):
        error = slip.drop_interval.standard_error
        sample = int(np.searchsorted(starts, slip.stop))
        back = partial(_added_back, by=error, sample=sample)
        yield Input(REPAIRED_SLIPS, back, stream=f"{REPAIRED_SLIPS} {number}")


def _coarse_step(values: Floats) -> float:
    """Step of a converter that is coarser than the noise; 0 for any other.

    Such a record stands more often than it moves, on many levels one after the other. Where it
    stands, noise does not tell how far between two levels the truth lies.
    """
    moves = np.abs(np.diff(values[~np.isnan(values)]))
    stands = moves == 0.0
    if not _STANDS * len(stands) < stands.sum() < len(stands):
        return 0.0
    times = int(np.sum(stands[1:] & ~stands[:-1]))
    return float(np.median(moves[~stands])) if times >= _LEVELS else 0.0


def _wanders(test: ReducedTest, time: Floats) -> Iterator[Input]:
    """How the zero of the force wanders from where it was taken."""
    by = test.raw_force.zero_drift * float(np.nanmax(np.abs(test.known_curve.force)))
    for number, wave in enumerate(drift_modes(np.abs(time - _zeroed_at(test)), by), start=1):
        drifted = partial(_drifted, by=wave, compliance=test.compliance)
        yield Input(DRIFT_OF_ZERO, drifted, stream=f"{DRIFT_OF_ZERO} {number}")


def _zeroed_at(test: ReducedTest) -> float:
    """When the zero of the force was taken last, s on the clock of the curve.

    The middle of a mean, the outer end of a line; the first sample where it came as it was.
    """
    signals, time = test.signals, test.known_curve.time
    name, clock = signals.force, signals.raw[signals.force].clock
    if name in signals.zeroed:
        return test.clocks.to_curve(0.5 * sum(signals.zeroed[name]), clock)
    if name not in signals.lined:
        return float(time[0])
    first, last = (test.clocks.to_curve(at, clock) for at in signals.lined[name])
    return first if first - time[0] < time[-1] - last else last


def _gain(trace: Trace, x: float, *, by: float, compliance: float) -> Trace:
    return _more_force(trace, x * by * trace.force, compliance)


def _raised(trace: Trace, x: float, *, by: float, compliance: float) -> Trace:
    return _more_force(trace, np.full(len(trace.time), x * by), compliance)


def _drifted(trace: Trace, x: float, *, by: Floats, compliance: float) -> Trace:
    return _more_force(trace, x * by, compliance)


def _more_force(trace: Trace, more: Floats, compliance: float) -> Trace:
    """A trace with more force, and so with less displacement where the frame gives way."""
    displacement = trace.displacement - compliance * np.nan_to_num(more)
    return replace(trace, force=trace.force + more, displacement=displacement)


def _scaled(trace: Trace, x: float, *, by: float, compliance: float) -> Trace:
    """A trace with more of the displacement that was measured, that of the frame with it."""
    measured = trace.displacement + compliance * np.nan_to_num(trace.force)
    return replace(trace, displacement=trace.displacement + x * by * measured)


def displaced(trace: Trace, x: float, *, by: float) -> Trace:
    """A trace with its displacement higher by a share of a length.

    Parameters
    ----------
    trace : to be moved
    x : share
    by : m
    """
    return replace(trace, displacement=trace.displacement + x * by)


def _bent(trace: Trace, x: float, *, by: Floats) -> Trace:
    return replace(trace, displacement=trace.displacement + x * by)


def _sized(trace: Trace, x: float, *, name: str, by: float) -> Trace:
    if name not in trace.sizes:
        return trace
    return replace(trace, sizes={**trace.sizes, name: trace.sizes[name] + x * by})


def _later(trace: Trace, x: float, *, by: Floats) -> Trace:
    return replace(trace, force=np.interp(trace.time + x * by, trace.time, trace.force))


def _beyond(trace: Trace, x: float, *, step: float) -> Trace:
    """A trace that ends a step of the curve later, which is a share of one of the grid."""
    return replace(trace, beyond=x * step)


def _added_back(trace: Trace, x: float, *, by: float, sample: int) -> Trace:
    behind = np.arange(len(trace.time)) >= sample
    return replace(trace, force=trace.force + x * by * behind)
