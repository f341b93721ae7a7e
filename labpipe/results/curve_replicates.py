"""The curve of a test, and its replicates from noise and uncertain inputs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np

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
from labpipe.records.signals import Clocks, FilterFunction, Signal
from labpipe.results.reduced_test import FailurePoint, ReducedTest
from labpipe.results.sample_noise import have_no_effect
from labpipe.results.slips import add_back
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

_BY_FRAMES = (SHAPE, GRIP, PULL, CENTRE)
"""Causes whose effect is computed frame by frame, from markers with noise."""


def replicate_curves(test: ReducedTest) -> Replicates | None:
    """Draw replicates of the curve of a test.

    Parameters
    ----------
    test : with a curve, its failure and its slips

    Returns
    -------
    The replicates, or None without a curve.
    """
    curve, unfiltered = test.curve, test.unfiltered
    if curve is None or unfiltered is None or not curve.branches:
        return None
    measured = traced(test)
    both = test.signals.displacement, test.signals.force
    starts = _starts(_corners(test), curve)
    grid_time = _means(curve.time, starts)
    acts = [_filters_on_grid(test, name, grid_time) for name in both]
    signals = _displacements(test, curve), _forces(test, unfiltered, curve)
    cuts = [int(np.searchsorted(starts, corner)) for corner in _corners(test)]
    records = [
        _means(filtered if have_no_effect(act) else raw, starts)
        for (filtered, raw), act in zip(signals, acts, strict=True)
    ]
    blocks = replace(
        _on_grid(measured, starts),
        time=grid_time,
        displacement=_means(curve.displacement, starts),
        force=_means(curve.force, starts),
    )
    grid = replace(blocks, displacement=records[0], force=records[1])
    first, second = (partial(_filtered, acts=act, cuts=cuts) for act in acts)
    inputs = tuple(_inputs(test, starts, partial(_without_noise, grid=grid, cuts=cuts)))
    return draw_replicates(
        measured,
        grid,
        cuts,
        (first, second),
        inputs,
        seed=test.seed,
        compliance=test.compliance,
        blocks=blocks,
    )


def traced(test: ReducedTest) -> Trace:
    """Return the trace of the curve of a test.

    Parameters
    ----------
    test : with a curve
    """
    curve, failure = test.known_curve, test.failure
    return Trace(
        time=curve.time,
        displacement=curve.displacement,
        force=curve.force,
        branches=curve.branches,
        failed_at=failure.sample if isinstance(failure, FailurePoint) else None,
        sizes=test.setup.sizes,
    )


def loading_of(trace: Trace) -> slice:
    """Return the samples of the first loading, up to a failure in it; may be empty.

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
    """Return the samples at which a new piece of the record begins: turns, failure, slips."""
    curve, failure = test.known_curve, test.failure
    cuts = [end for branch in curve.branches for end in (branch.start, branch.stop)]
    if isinstance(failure, FailurePoint):
        cuts.append(failure.sample + 1)
    cuts += [end for slip in test.slips for end in (slip.start + 1, slip.stop)]
    return sorted({cut for cut in cuts if 0 < cut < len(curve.time)})


def _starts(corners: Sequence[int], curve: Curve) -> Ints:
    """Return the first samples of the blocks of a grid, which do not cross corners.

    The last block of a piece includes the remainder.
    """
    # The record may have fewer blocks if the shortest branch still has enough.
    min_blocks, max_blocks, min_branch_blocks = 6_000, 20_000, 500
    count = len(curve.time)
    shortest = min(branch.stop - branch.start for branch in curve.branches)
    block = min(count // min_blocks, shortest // min_branch_blocks)
    block = max(block, -(-count // max_blocks))
    pieces = pairwise([0, *corners, count])
    starts = [np.arange(low, max(high - block, low) + 1, block) for low, high in pieces]
    return np.concatenate(starts)


def _means(values: Floats, starts: Ints) -> Floats:
    """Return the means of the blocks of a grid."""
    if len(starts) == len(values):
        return values
    means: Floats = np.add.reduceat(values, starts) / np.diff(np.append(starts, len(values)))
    return means


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


def _on_grid(trace: Trace, starts: Ints) -> Trace:
    """Convert the sample numbers of a trace to a grid."""
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


def _displacements(test: ReducedTest, curve: Curve) -> tuple[Floats, Floats]:
    """Return the displacement including that of the frame, filtered and unfiltered."""
    filtered = curve.displacement + test.compliance * np.nan_to_num(curve.force)
    raw = test.signals.raw[test.signals.displacement].values
    if len(raw) != len(filtered):
        return filtered, filtered
    return filtered, raw + float(np.nanmean(filtered - raw))


def _forces(test: ReducedTest, unfiltered: Signal, curve: Curve) -> tuple[Floats, Floats]:
    """Return the force of the curve, and the unfiltered one with slips added back."""
    force = _on_curve(test, unfiltered, curve.time)
    repaired = [slip for slip in test.slips if slip.decision is SlipDecision.REPAIRED]
    if repaired:
        force = add_back(force, repaired)
    # The filter bridges missing samples.
    force = np.where(np.isnan(force), curve.force, force)
    return curve.force, np.where(np.isnan(curve.force), np.nan, force)


def _on_curve(test: ReducedTest, signal: Signal, time: Floats) -> Floats:
    """Sample a signal at the times of the curve, a faster one by means around them."""
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


def _filters_on_grid(test: ReducedTest, name: str, time: Floats) -> list[FilterFunction]:
    """Return the filters of a signal for the grid; none if it was thinned."""
    signals = test.signals
    filters, raw = signals.filters.get(name, ()), signals.raw[name].time
    if name == signals.displacement and len(raw) != len(test.known_curve.time):
        return []
    acts = list[FilterFunction]()
    for act, stride in filters:
        acts.append(act.coarser(float(np.median(np.diff(time)) / np.median(np.diff(raw)))))
        raw = raw[::stride]
    return acts


def _filtered(values: Floats, *, acts: Sequence[FilterFunction], cuts: Sequence[int]) -> Floats:
    """Apply all filters to records (..., n), piece by piece."""
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
    """Smooth the effect of an input on a record.

    Its noise would raise the largest of many samples, for either sign of the input.
    """
    parts = spline_intervals_of(grid)
    return smooth_curve(grid.time, change, cuts, parts, branches=grid.branches)


def _inputs(test: ReducedTest, starts: Ints, smooth: Filter) -> Iterator[Input]:
    """Yield the uncertain inputs of the whole record."""
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
    yield from _drift_inputs(test, _means(test.known_curve.time, starts))
    for cause, signal in displacement.moved.items():
        change = _means(signal - displacement.values, starts)
        change = smooth(change) if cause in _BY_FRAMES else change
        law: Law = "uniform" if cause == SHAPE else "normal"
        yield Input(cause, partial(displaced, by=change), law=law)
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
    """Return the step of a converter that is coarser than the noise, or else 0.

    Such a record is constant for most samples, on at least ten levels, and noise does not show the
    values between two levels.
    """
    min_constant_share = 0.5
    min_levels = 10
    moves = np.abs(np.diff(values[~np.isnan(values)]))
    constant = moves == 0.0
    if not min_constant_share * len(constant) < constant.sum() < len(constant):
        return 0.0
    times = int(np.sum(constant[1:] & ~constant[:-1]))
    return float(np.median(moves[~constant])) if times >= min_levels else 0.0


def _drift_inputs(test: ReducedTest, time: Floats) -> Iterator[Input]:
    """Yield the modes of the drift of the zero of the force."""
    by = test.raw_force.zero_drift * float(np.nanmax(np.abs(test.known_curve.force)))
    for number, wave in enumerate(drift_modes(np.abs(time - _zeroed_at(test)), by), start=1):
        drifted = partial(_raised, by=wave, compliance=test.compliance)
        yield Input(DRIFT_OF_ZERO, drifted, stream=f"{DRIFT_OF_ZERO} {number}")


def _zeroed_at(test: ReducedTest) -> float:
    """Return when the zero of the force was taken last, s on the clock of the curve.

    The middle of a mean, or the outer end of a line; else the first sample.
    """
    signals, time = test.signals, test.known_curve.time
    name, clock = signals.force, signals.raw[signals.force].clock
    if name in signals.zeroed:
        return test.clocks.to_curve(0.5 * sum(signals.zeroed[name]), clock)
    if name not in signals.lined:
        return float(time[0])
    first, last = (test.clocks.to_curve(end, clock) for end in signals.lined[name])
    return first if first - time[0] < time[-1] - last else last


def _gain(trace: Trace, x: float, *, by: float, compliance: float) -> Trace:
    return _more_force(trace, x * by * trace.force, compliance)


def _raised(trace: Trace, x: float, *, by: float | Floats, compliance: float) -> Trace:
    return _more_force(trace, x * by, compliance)


def _more_force(trace: Trace, more: float | Floats, compliance: float) -> Trace:
    """Add force to a trace, and subtract the displacement of the frame."""
    displacement = trace.displacement - compliance * np.nan_to_num(more)
    return replace(trace, force=trace.force + more, displacement=displacement)


def _scaled(trace: Trace, x: float, *, by: float, compliance: float) -> Trace:
    """Scale the measured displacement of a trace, including that of the frame."""
    measured = trace.displacement + compliance * np.nan_to_num(trace.force)
    return replace(trace, displacement=trace.displacement + x * by * measured)


def displaced(trace: Trace, x: float, *, by: float | Floats) -> Trace:
    """Shift the displacement of a trace by a multiple of a length.

    Parameters
    ----------
    trace : the trace
    x : the multiple
    by : m, a number or one per sample
    """
    return replace(trace, displacement=trace.displacement + x * by)


def _sized(trace: Trace, x: float, *, name: str, by: float) -> Trace:
    if name not in trace.sizes:
        return trace
    return replace(trace, sizes={**trace.sizes, name: trace.sizes[name] + x * by})


def _later(trace: Trace, x: float, *, by: Floats) -> Trace:
    return replace(trace, force=np.interp(trace.time + x * by, trace.time, trace.force))


def _beyond(trace: Trace, x: float, *, step: float) -> Trace:
    """End a trace a step of the curve later, a share of a step of the grid."""
    return replace(trace, beyond=x * step)


def _added_back(trace: Trace, x: float, *, by: float, sample: int) -> Trace:
    behind = np.arange(len(trace.time)) >= sample
    return replace(trace, force=trace.force + x * by * behind)
