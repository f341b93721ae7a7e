"""Errors that all points of a first loading share: zeros, clocks, the scale of the deflection.

They do not average out over the points as noise does. The zero of the force moves a whole curve
up; the zero of the deflection, and a clock that is off, move it sideways; the shape that is put
through the markers is off in proportion to the deflection, and in all tests of a rig alike.
"""

from __future__ import annotations

import numpy as np

from labpipe.fitting.estimates import Failure
from labpipe.fitting.loops import largest_sample
from labpipe.fitting.noise import long_run_variance
from labpipe.processing.strokes import noise_level
from labpipe.protocol.schema import Protocol
from labpipe.protocol.steps import SpecimenFrame, Zero
from labpipe.records.arrays import Floats
from labpipe.records.curve import Branch, Curve
from labpipe.records.result import TestResult

_CYCLE = 2
"""Branches of a cycle."""


def force_zero_error(protocol: Protocol, curve: Curve, first: Branch) -> float:
    """Standard error of the zero of the force, N.

    Parameters
    ----------
    protocol : of the test
    curve, first : of the test, and its first loading branch

    Returns
    -------
    By how the force scatters at rest; 0 where the test has no rest before its loading.
    """
    rest = slice(0, first.start)
    return zero_error(curve.time[rest], curve.force[rest], _zeroed_over(protocol))


def place_error(result: TestResult, protocol: Protocol, curve: Curve, first: Branch) -> float:
    """Standard error of what all deflections are off by, m.

    Parameters
    ----------
    result, protocol : of the test
    curve, first : of the result, and its first loading branch

    Returns
    -------
    Of the zero of the deflection, as `force_zero_error`, and of the force's clock times the speed
    of the deflection; the clock's is 0 where there is but one.
    """
    rest = slice(0, first.start)
    zero = zero_error(curve.time[rest], curve.displacement[rest], _straight_over(protocol))
    return float(np.hypot(zero, _clock_error(result) * _speed(curve, first)))


def scale_error(result: TestResult) -> float:
    """Standard error of the deflection's scale, as a ratio.

    Parameters
    ----------
    result : of the test

    Returns
    -------
    That of the first peak, which holds what another shape through the markers would make of it,
    less what is its own: noise of the largest sample, and how far a corner reaches beyond it. 0
    where the peak has no interval.
    """
    curve = result.curve
    peak = next((each for each in result.results if each.name == "peak_displacement.1"), None)
    if curve is None or peak is None or peak.interval is None or not peak.value:
        return 0.0
    cycle = slice(curve.branches[0].start, curve.branches[:_CYCLE][-1].stop)
    values = np.sign(peak.value) * curve.displacement[cycle]
    own = largest_sample(values, noise=noise_level(values))
    error = 0.0 if isinstance(own, Failure) else own.error
    shared = peak.interval.standard_error**2 - error**2
    return float(np.sqrt(max(shared, 0.0))) / abs(peak.value)


def zero_error(time: Floats, values: Floats, over: float | None) -> float:
    """Standard error of a zero that is the mean over part of a rest, in the unit of the values.

    Parameters
    ----------
    time : shape (n,), s, evenly sampled
    values : shape (n,), at rest; NaN count as absent
    over : s, of the part; None for all of it

    Returns
    -------
    0 for fewer than four values.

    Notes
    -----
    Long-run variance of the whole rest (`fitting.noise`) over the number of values in the part.
    """
    known = values[~np.isnan(values)]
    variance = long_run_variance(known, parameters=1)
    if np.isnan(variance):
        return 0.0
    lasts = float(time[-1] - time[0])
    share = 1.0 if over is None else min(over / lasts, 1.0)
    return float(np.sqrt(variance / (share * len(known))))


def _zeroed_over(protocol: Protocol) -> float | None:
    """Stretch that the zero of the force is the mean of, s; None where it is not zeroed."""
    force = None if protocol.curve is None else protocol.curve.force
    zeroed = (step for step in protocol.steps if isinstance(step, Zero) and step.channel == force)
    return next((step.over for step in zeroed), None)


def _straight_over(protocol: Protocol) -> float | None:
    """Stretch that deflections are counted from, s; None where no step says so."""
    frames = (step for step in protocol.steps if isinstance(step, SpecimenFrame))
    return next((step.over for step in frames), None)


def _clock_error(result: TestResult) -> float:
    """Standard error of the force's clock where the motion begins, s."""
    fit = None if result.aligned is None else result.aligned.clock_fit
    error = 0.0 if fit is None else fit.offset_interval.standard_error
    return error if np.isfinite(error) else 0.0


def _speed(curve: Curve, first: Branch) -> float:
    """Mean speed of the deflection over the branch, m/s."""
    part = slice(first.start, first.stop)
    known = np.flatnonzero(np.isfinite(curve.displacement[part]))
    if len(known) < 2:
        return 0.0
    begin, end = known[0] + first.start, known[-1] + first.start
    moved = curve.displacement[end] - curve.displacement[begin]
    return float(moved / (curve.time[end] - curve.time[begin]))
