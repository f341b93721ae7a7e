"""The curve of a test, and those that it may have been by the noise and the inputs of the test."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np

from labpipe.fits.failure_point import FailurePoint
from labpipe.records.arrays import Floats
from labpipe.records.causes import (
    LENGTH,
    REPAIRED_SLIPS,
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
from labpipe.records.signals import Act, Signal
from labpipe.results.evidence import Evidence
from labpipe.uncertainty.readings import Trace
from labpipe.uncertainty.replicates import Input, Law, Replicates, replicated

_MOST = 20_000
"""Samples of a replicate at most; those of a longer curve are averaged in blocks."""


def likely_curves(test: Evidence) -> Replicates | None:
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
    block = -(-len(curve.time) // _MOST)
    force = _repaired(test, _on_curve(test, unfiltered, curve.time))
    machine = _unfiltered_displacement(test, curve) + test.compliance * curve.force
    plain = replace(measured, displacement=machine, force=force)
    grid = _blocked(plain, block)
    cuts = _cuts(test, grid, block)
    both = test.signals.displacement, test.signals.force
    first, second = (
        partial(_filtered, acts=_acts(test, name, grid.time), cuts=cuts) for name in both
    )
    inputs = tuple(_inputs(test, block))
    return replicated(
        measured, grid, cuts, (first, second), inputs, seed=test.seed, compliance=test.compliance
    )


def traced(test: Evidence) -> Trace:
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
    branch = next((each for each in trace.branches if each.direction is Direction.LOADING), None)
    if branch is None:
        return slice(0, 0)
    if trace.failed_at is not None and trace.failed_at < branch.stop:
        return slice(branch.start, max(trace.failed_at + 1, branch.start))
    return slice(branch.start, branch.stop)


def _on_curve(test: Evidence, signal: Signal, time: Floats) -> Floats:
    """A signal at times of the curve: of a faster one the mean around each of them."""
    if len(signal.time) < 2 * len(time):
        return test.clocks.sampled(signal, time)
    known = ~np.isnan(signal.values)
    step = float(np.median(np.diff(signal.time)))
    total = np.append(0.0, np.cumsum(np.where(known, signal.values, 0.0)))
    ends = np.append(signal.time[0] - 0.5 * step, signal.time + 0.5 * step)
    half = 0.5 * float(np.median(np.diff(time)))
    sums = [
        test.clocks.sampled(replace(signal, time=ends, values=total), time + side * half)
        for side in (-1.0, 1.0)
    ]
    counts = 2.0 * half / step
    mean: Floats = (sums[1] - sums[0]) / counts
    return np.where(np.isnan(mean), test.clocks.sampled(signal, time), mean)


def _unfiltered_displacement(test: Evidence, curve: Curve) -> Floats:
    """The displacement of the curve with what its filters took off."""
    name = test.signals.displacement
    raw = test.signals.raw[name].values
    if name not in test.signals.filters or len(raw) != len(curve.displacement):
        return curve.displacement
    level = float(np.nanmean(curve.displacement - raw))
    return raw + level


def _repaired(test: Evidence, force: Floats) -> Floats:
    """Unfiltered force with what was added back at slips, and without what was cut off there."""
    from labpipe.fits.grip_slips import add_back

    repaired = [each for each in test.slips if each.decision is SlipDecision.REPAIRED]
    found = add_back(force, repaired) if repaired else force
    return np.where(np.isnan(test.known_curve.force), np.nan, found)


def _blocked(trace: Trace, block: int) -> Trace:
    """A trace by means of so many neighbouring samples."""
    if block == 1:
        return trace
    time, displacement, force = (
        _means(each, block) for each in (trace.time, trace.displacement, trace.force)
    )
    last = len(time)
    branches = tuple(
        replace(each, start=each.start // block, stop=min(-(-each.stop // block), last))
        for each in trace.branches
    )
    failed = None if trace.failed_at is None else min(trace.failed_at // block, last - 1)
    return replace(
        trace,
        time=time,
        displacement=displacement,
        force=force,
        branches=branches,
        failed_at=failed,
    )


def _cuts(test: Evidence, grid: Trace, block: int) -> list[int]:
    """Samples at which a new piece of the record begins: turns, the failure, slips."""
    cuts = [end for each in grid.branches for end in (each.start, each.stop)]
    if grid.failed_at is not None:
        cuts.append(grid.failed_at + 1)
    for slip in test.slips:
        cuts += [(slip.start + 1) // block, slip.stop // block]
    return sorted({each for each in cuts if 0 < each < len(grid.time)})


def _acts(test: Evidence, name: str, time: Floats) -> list[Act]:
    """The filters of a signal for samples of the grid."""
    raw = test.signals.raw[name].time
    step = float(np.median(np.diff(time)))
    found = list[Act]()
    for act, stride in test.signals.filters.get(name, ()):
        apart = float(np.median(np.diff(raw)))
        found.append(act.coarser(step / apart))
        raw = raw[::stride]
    return found


def _filtered(values: Floats, *, acts: Sequence[Act], cuts: Sequence[int]) -> Floats:
    """Records (..., n) after all filters, piece by piece."""
    for act in acts:
        ends = [0, *cuts, values.shape[-1]]
        pieces = [act(values[..., low:high]) for low, high in pairwise(ends)]
        values = np.concatenate(pieces, axis=-1)
    return values


def _inputs(test: Evidence, block: int) -> Iterator[Input]:
    """What is the same for the whole record, and known with an uncertainty."""
    force, displacement = test.raw_force, test.displacement
    gain, raised = (partial(each, compliance=test.compliance) for each in (_gain, _raised))
    for cause, by, moved in (
        (SCALE_OF_FORCE, force.relative_error, gain),
        (ZERO_OF_FORCE, force.zero_error, raised),
        (SCALE_OF_DISPLACEMENT, displacement.relative_error, _scaled),
        (ZERO_OF_DISPLACEMENT, displacement.zero_error, displaced),
    ):
        if by:
            yield Input(cause, partial(moved, by=by))
    for cause, signal in displacement.moved.items():
        change = _means(signal - displacement.values, block)
        law: Law = "uniform" if cause == SHAPE else "normal"
        yield Input(cause, partial(_bent, by=change), law=law)
    for cause, clocks in test.clocks.moved.items():
        time = test.known_curve.time
        later = clocks.sampled_at(time) - test.clocks.sampled_at(time)
        yield Input(cause, partial(_later, by=_means(later, block)))
    for name, by in test.setup.uncertainties.items():
        cause = name if name in (LENGTH, SPAN) else SECTION
        yield Input(cause, partial(_sized, name=name, by=by), moves_curve=False, stream=name)
    yield Input(STEP, _beyond, law="step", moves_curve=False)
    repaired = [slip for slip in test.slips if slip.decision is SlipDecision.REPAIRED]
    for number, slip in enumerate(repaired, start=1):
        error = slip.drop_interval.standard_error
        back = partial(_added_back, by=error, sample=slip.stop // block)
        yield Input(REPAIRED_SLIPS, back, stream=f"{REPAIRED_SLIPS} {number}")


def _means(values: Floats, block: int) -> Floats:
    """Means of so many neighbouring samples; what is left over at the end joins the last one."""
    if block == 1:
        return values
    starts = np.arange(0, len(values) - block + 1, block)
    found: Floats = np.add.reduceat(values, starts) / np.diff(np.append(starts, len(values)))
    return found


def _gain(trace: Trace, x: float, *, by: float, compliance: float) -> Trace:
    return _more_force(trace, x * by * trace.force, compliance)


def _raised(trace: Trace, x: float, *, by: float, compliance: float) -> Trace:
    return _more_force(trace, np.full(len(trace.time), x * by), compliance)


def _more_force(trace: Trace, more: Floats, compliance: float) -> Trace:
    """A trace with more force, and so with less displacement where the frame gives way."""
    displacement = trace.displacement - compliance * more
    return replace(trace, force=trace.force + more, displacement=displacement)


def _scaled(trace: Trace, x: float, *, by: float) -> Trace:
    return replace(trace, displacement=trace.displacement * (1.0 + x * by))


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


def _beyond(trace: Trace, x: float) -> Trace:
    return replace(trace, beyond=x)


def _added_back(trace: Trace, x: float, *, by: float, sample: int) -> Trace:
    behind = np.arange(len(trace.time)) >= sample
    return replace(trace, force=trace.force + x * by * behind)
