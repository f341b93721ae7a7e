"""Peaks of a frame that stops or turns in a corner: no parabola goes round a corner."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labpipe.fitting.corners import fit_corner
from labpipe.fitting.estimates import Estimate, Failure, widened
from labpipe.fitting.failure import FailurePoint, peak_before_failure
from labpipe.pipeline.bench import Bench
from labpipe.pipeline.corrections import repair_error
from labpipe.pipeline.cycle_numbers import curve_of, peak_displacement_of, unscaled_peak
from labpipe.processing.strokes import noise_level
from labpipe.records.arrays import Floats, median
from labpipe.records.curve import Branch, Interval

_LEAST = 24
_AS_FAST = 0.6
"""Speed of the last hundredth of a branch over that of the three before: 1 at a corner, 0.2 where a
parabola turns."""
_PLATEAU = 3
"""Samples at the top from which on the frame has stood there; at the first it may still arrive."""


@dataclass(frozen=True, slots=True)
class SharpEnd:
    """End of a loading branch at which the frame stopped or turned at full speed.

    Parameters
    ----------
    sample : number of the last sample of loading, from the start of the branch
    top : displacement there, in the sense of loading
    step : m, beyond the sample within which the frame turned; 0 where it was seen to stand
    """

    sample: int
    top: Estimate
    step: float


def find_sharp_end(displacement: Floats, *, length: int) -> SharpEnd | None:
    """Find where a displacement stops growing, if it does so from one sample to the next.

    Parameters
    ----------
    displacement : shape (n,), m, growing; from the start of a loading branch on
    length : samples of the branch up to the turn; what comes behind shows whether the frame stood

    Returns
    -------
    The end, or None where the frame slows down before it turns, or where the noise (five standard
    deviations) is more than it moves in a sample. NaN: None.

    Notes
    -----
    Where the frame stood, the top is the mean of the samples behind the first one there. Where it
    went straight back, parabolas on both sides of the corner meet there (`fit_corner`). Where the
    record ends too soon for that, the frame is taken to have turned up to half a step beyond the
    largest sample: a quarter of a step is added, with the standard deviation of that rectangle.
    """
    branch = displacement[:length]
    if length < _LEAST or np.isnan(displacement).any():
        return None
    size = max(3, length // 100)
    step = median(np.diff(branch))
    noise = noise_level(branch)
    near = max(5.0 * noise, 0.25 * step)
    first = int(np.argmax(branch >= branch.max() - near))
    if first < 4 * size or near > step or not _as_fast(branch, first, size):
        return None
    if (displacement[length : length + 2] > branch.max() + near).any():  # cut off, it went on
        last = int(np.argmax(branch))
        return SharpEnd(last, Estimate(float(branch[last]), noise, 1), 0.0)
    there = displacement[first : first + _stays(displacement[first:], branch.max() - near)]
    if len(there) >= _PLATEAU:
        stood = there[1:]
        top = Estimate(float(stood.mean()), noise / float(np.sqrt(len(stood))), len(stood))
        return SharpEnd(first, top, 0.0)
    last = int(np.argmax(branch))
    return SharpEnd(last, _corner(displacement, last, step, noise), 0.5 * step)


def _corner(displacement: Floats, last: int, step: float, noise: float) -> Estimate:
    """Height of the corner at the largest sample, times counted in samples."""
    number = np.arange(len(displacement), dtype=np.float64)
    if len(displacement) - last > _LEAST:
        found = fit_corner(number, displacement, near=float(last), window=float(_LEAST), degree=2)
        if found is not None and abs(found.time - last) <= 1.0:
            return Estimate(found.value, found.value_error, found.n)
    error = np.hypot(noise, 0.25 * step / np.sqrt(3.0))
    return Estimate(float(displacement[last]) + 0.25 * step, float(error), 1)


def unscaled_peak_force(bench: Bench, branches: list[Branch]) -> Estimate | Failure:
    """Largest force of a cycle, N, without the uncertainty of zero and scale."""
    branch, failure = branches[0], bench.failure
    broke = isinstance(failure, FailurePoint) and branch.start <= failure.sample < branch.stop
    curve = curve_of(bench)
    found = None if broke else _sharp_end(bench, branch, curve.displacement)
    if found is None:
        return unscaled_peak(bench, branches)
    end, sense = found
    upto = slice(branch.start, branch.start + end.sample + 1)
    pulls = _sign(curve.force[upto])
    nowhere = Estimate(float("nan"), 0.0, 0)
    point = FailurePoint(displacement=end.top, force=nowhere, sample=end.sample, step=end.step)
    peak = peak_before_failure(sense * curve.displacement[upto], pulls * curve.force[upto], point)
    return peak if isinstance(peak, Failure) or pulls > 0.0 else _turned_over(peak)


def repaired_peak_force(bench: Bench, branches: list[Branch]) -> Estimate | Failure:
    """As `unscaled_peak_force`, with the uncertainty of the drops that were added back."""
    peak = unscaled_peak_force(bench, branches)
    if isinstance(peak, Failure):
        return peak
    return widened(peak, repair_error(bench, before=branches[0].stop))


def peak_force_of_cycle(
    bench: Bench, branches: list[Branch], displacement: Floats
) -> Estimate | Failure:
    """Largest force of a cycle, N."""
    del displacement
    peak, signal = repaired_peak_force(bench, branches), bench.raw[bench.force]
    if isinstance(peak, Failure):
        return peak
    return widened(peak, signal.zero_error, signal.relative_error * peak.value)


def peak_displacement_of_cycle(
    bench: Bench, branches: list[Branch], displacement: Floats
) -> Estimate | Failure:
    """Displacement where the motion turns from loading to unloading, or stops, m."""
    found = _sharp_end(bench, branches[0], displacement)
    if found is None:
        return peak_displacement_of(bench, branches, displacement)
    (end, sense), signal = found, bench.signals[bench.displacement]
    top = Estimate(sense * end.top.value, end.top.error, end.top.n)
    return widened(top, signal.zero_error, signal.relative_error * top.value)


def _sharp_end(bench: Bench, branch: Branch, displacement: Floats) -> tuple[SharpEnd, float] | None:
    """The end of a branch and the sense in which it loads; clocks that were joined know better."""
    if bench.clock_fit is not None:
        return None
    onwards = displacement[branch.start :]
    if np.isnan(onwards).any():
        return None
    length = min(branch.stop - branch.start + 1, len(onwards))  # the sample of the turn is shared
    sense = _sign(onwards[:length] - onwards[0])
    end = find_sharp_end(sense * onwards, length=length)
    return None if end is None else (end, sense)


def _turned_over(estimate: Estimate) -> Estimate:
    interval = estimate.interval and Interval(-estimate.interval.upper, -estimate.interval.lower)
    return Estimate(-estimate.value, estimate.error, estimate.n, interval)


def _as_fast(branch: Floats, end: int, size: int) -> bool:
    last = branch[end] - branch[end - size]
    before = (branch[end - size] - branch[end - 4 * size]) / 3.0
    return bool(last >= _AS_FAST * before)


def _stays(displacement: Floats, level: float) -> int:
    """Samples in a row that are not below a level."""
    below = np.flatnonzero(displacement < level)
    return int(below[0]) if len(below) else len(displacement)


def _sign(values: Floats) -> float:
    """-1.0 where values go further below zero than above it, else 1.0."""
    return -1.0 if -np.nanmin(values) > np.nanmax(values) else 1.0
