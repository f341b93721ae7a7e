"""Numbers of one cycle: from the bench to an estimate that knows calibration and zero.

Each takes the bench, the branches of the cycle, and the displacement on the clock of the curve,
which may be that of another shape of the specimen; what cannot be had is a failure with a reason.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from labpipe.fitting.corners import value_at_turn
from labpipe.fitting.estimates import Estimate, Failure, widened
from labpipe.fitting.failure import FailurePoint, peak_before_failure
from labpipe.fitting.loops import (
    loop_energy,
    secant_stiffness,
    smooth_peak,
)
from labpipe.fitting.reversals import fit_reversal
from labpipe.fitting.unloading import residual_after_unloading
from labpipe.pipeline.bench import Bench, Signal
from labpipe.processing.filtering import moving_average
from labpipe.records.arrays import Floats
from labpipe.records.curve import Branch, Curve

_PEAK_WINDOW = 2.0
"""s on each side of a turning point that a peak is read from."""
_FORCE_WINDOW = 1.0
"""As much for a force, which bends more than a displacement does."""
_SURELY = 4.0
"""Standard errors by which a top before the turn is larger than the force at the turn."""


def unscaled_peak(bench: Bench, branches: list[Branch]) -> Estimate | Failure:
    """Largest force of a cycle, N, without the uncertainty of zero and scale."""
    force, failure = bench.raw[bench.force], bench.failure
    if isinstance(failure, FailurePoint) and branches[0].start <= failure.sample < branches[0].stop:
        curve, loading = curve_of(bench), bench.within(branches[0])
        point = replace(failure, sample=failure.sample - loading.start)
        return peak_before_failure(curve.displacement[loading], curve.force[loading], point)
    if _is_sharp(bench, branches):
        at = branches[0].stop_time
        at = bench.clock_fit.to_force_seconds(at) if bench.clock_fit else at
        window = min(_FORCE_WINDOW, _window(branches))
        found = fit_reversal(*_around(force, at), near=at, window=window)
        if found is None:
            return Failure("no_corner", f"the force has no corner near {at:.3f} s of its clock")
        corner = Estimate(found.corner.value, found.corner.value_error, found.corner.n)
        return _or_larger_before(bench, branches, corner)
    curve, stretch = curve_of(bench), _cycle(branches)
    # One sense for all cycles: the force may run ahead of the motion by a quarter of a cycle.
    sense = _sense(curve.force, slice(curve.branches[0].start, None))
    top = smooth_peak(curve.time[stretch], sense * curve.force[stretch], share=0.05)
    if isinstance(top, Failure):
        return top
    return Estimate(sense * top.value, top.error, top.n)


def _around(signal: Signal, at: float) -> tuple[Floats, Floats]:
    """Times and values of a signal that a peak at a time can be read from."""
    reach = 2.0 * _PEAK_WINDOW
    near = slice(*np.searchsorted(signal.time, [at - reach, at + reach]))
    return signal.time[near], signal.values[near]


def _or_larger_before(bench: Bench, branches: list[Branch], corner: Estimate) -> Estimate:
    """The force at the turn, or the top that it had surely passed on the way there."""
    curve, first = curve_of(bench), bench.within(branches[0]).start
    last = int(np.searchsorted(curve.time, branches[0].stop_time - 2.0 * _FORCE_WINDOW))
    sense = -1.0 if corner.value < 0.0 else 1.0
    early = sense * curve.force[first : max(first, last)]
    if not np.isfinite(early).any():
        return corner
    at = float(curve.time[first + int(np.nanargmax(early))])
    at = bench.clock_fit.to_force_seconds(at) if bench.clock_fit else at
    time, values = _around(bench.raw[bench.force], at)
    # A tape that lets go leaves a corner, which a parabola would cut.
    top = value_at_turn(time, sense * values, at=at, window=_FORCE_WINDOW, degree=2)
    if isinstance(top, Failure):
        return corner
    if not top.value - sense * corner.value > _SURELY * np.hypot(top.error, corner.error):
        return corner
    return replace(top, value=sense * top.value)


def peak_displacement_of(
    bench: Bench, branches: list[Branch], displacement: Floats
) -> Estimate | Failure:
    """Displacement where the motion turns from loading to unloading, m."""
    signal = bench.signals[bench.displacement]
    if _is_sharp(bench, branches):
        found = value_at_turn(
            signal.time,
            displacement,
            at=branches[0].stop_time,
            window=_window(branches),
            degree=2,
        )
    else:
        stretch, sense = _cycle(branches), _sense(displacement, bench.within(branches[0]))
        found = smooth_peak(signal.time[stretch], sense * displacement[stretch], share=0.05)
        if isinstance(found, Estimate):
            found = Estimate(sense * found.value, found.error, found.n)
    return found if isinstance(found, Failure) else _scaled(found, signal)


def energy_of(bench: Bench, branches: list[Branch], displacement: Floats) -> Estimate | Failure:
    """Work dissipated over the cycle, J."""
    if len(branches) < 2:
        return Failure("partial_cycle", "the cycle has no unloading branch")
    curve, stretch = curve_of(bench), _cycle(branches)
    found = loop_energy(
        curve.time[stretch],
        displacement[stretch],
        curve.force[stretch],
        clock_error=_clock_error(bench),
    )
    if isinstance(found, Failure):
        return found
    opened = displacement[stretch][-1] - displacement[stretch][0]
    zero = bench.raw[bench.force].zero_error * opened
    scale = bench.raw[bench.force].relative_error * found.value
    return widened(found, zero, scale)


def residual_of(
    bench: Bench, branches: list[Branch], displacement: Floats, force_below: float
) -> Estimate | Failure:
    """Displacement left at zero force after unloading, m."""
    if len(branches) < 2:
        return Failure("partial_cycle", "the cycle has no unloading branch")
    curve, unloading = curve_of(bench), bench.within(branches[1])
    found = residual_after_unloading(
        curve.time[unloading],
        displacement[unloading],
        curve.force[unloading],
        force_below=force_below,
        zero_error=bench.raw[bench.force].zero_error,
        clock_error=_clock_error(bench),
    )
    zero = bench.signals[bench.displacement].zero_error
    if isinstance(found, Failure):
        return found
    return widened(found, zero)


def loading_stiffness_of(
    bench: Bench, branches: list[Branch], displacement: Floats, low: float, high: float
) -> Estimate | Failure:
    """Stiffness of the loading branch between two displacements, N/m; scale taken as exact."""
    return stiffness_over(bench, branches[0], displacement, low, high)


def unloading_stiffness_of(
    bench: Bench, branches: list[Branch], displacement: Floats, low: float, high: float
) -> Estimate | Failure:
    """Stiffness of the unloading branch from one distance off its beginning to another, N/m."""
    if len(branches) < 2:
        return Failure("partial_cycle", "the cycle has no unloading branch")
    turn = _value_at_start(curve_of(bench).time, displacement, branches[1])
    found = stiffness_over(bench, branches[1], turn - displacement, low, high)
    if isinstance(found, Failure):
        return found
    return _scaled_by_force(bench, Estimate(-found.value, found.error, found.n))


def _value_at_start(time: Floats, values: Floats, part: Branch) -> float:
    """Value at the turning point a branch starts from, by a parabola through its beginning."""
    begin = slice(part.start, min(part.stop, part.start + 50))
    known = ~np.isnan(values[begin])
    t, y = time[begin][known] - part.start_time, values[begin][known]
    if len(y) < 8:
        return float(values[part.start])
    return float(np.polynomial.Polynomial.fit(t, y, 2)(0.0))


def stiffness_over(
    bench: Bench, part: Branch, path_of_all: Floats, low: float, high: float
) -> Estimate | Failure:
    """Stiffness over the part of a branch whose path lies between two lengths.

    Parameters
    ----------
    bench : with a curve
    part : the branch, or a stretch of it
    path_of_all : shape (n,), m, on the clock of the curve, growing along the branch
    low, high : m

    Returns
    -------
    N/m, without the uncertainty of the scale of the force; a failure ``not_reached``,
    ``too_few_samples`` or ``no_travel``.
    """
    curve = curve_of(bench)
    branch = bench.within(part)
    time, force, path = curve.time[branch], curve.force[branch], path_of_all[branch]
    travelled = moving_average(path, window=min(11, len(path) - 1 + len(path) % 2))
    inside = (travelled >= low) & (travelled <= high)
    if not (travelled > high).any():
        reached = float(np.nanmax(travelled))
        return Failure("not_reached", f"the branch reaches {reached:.4g} m, {high:.4g} m is asked")
    inside[int(np.argmax(travelled > high)) :] = False
    found = secant_stiffness(time, path, force, inside)
    # Where the force bends over the window, a shift of the clocks changes its slope.
    shifted = np.interp(time + _clock_error(bench), time, force)
    moved = secant_stiffness(time, path, shifted, inside)
    if isinstance(found, Failure) or isinstance(moved, Failure):
        return found
    return widened(found, moved.value - found.value)


def _scaled_by_force(bench: Bench, estimate: Estimate) -> Estimate:
    return widened(estimate, bench.raw[bench.force].relative_error * estimate.value)


def curve_of(bench: Bench) -> Curve:
    """The curve, of which there is one when there are cycles."""
    if bench.curve is None:  # cycles() is empty then, so no number of a cycle is asked for
        message = "a number of a cycle was asked for before there is a curve"
        raise ValueError(message)
    return bench.curve


def _is_sharp(bench: Bench, branches: list[Branch]) -> bool:
    """Whether loading ends in a corner, as it does where clocks are joined at corners."""
    return len(branches) > 1 and bench.clock_fit is not None


def _sense(values: Floats, stretch: slice) -> float:
    """-1.0 where a quantity goes further down than up from where it begins, else 1.0."""
    known = values[stretch][~np.isnan(values[stretch])]
    if not len(known):
        return 1.0
    start = known[: max(1, len(known) // 100)].mean()
    return -1.0 if known.max() - start < start - known.min() else 1.0


def _cycle(branches: list[Branch]) -> slice:
    return slice(branches[0].start, branches[-1].stop)


def _window(branches: list[Branch]) -> float:
    """Seconds on each side of the end of loading that hold no other corner."""
    shortest = min(branch.stop_time - branch.start_time for branch in branches)
    window = min(_PEAK_WINDOW, 0.4 * shortest)
    dwell = branches[1].start_time - branches[0].stop_time if len(branches) > 1 else 0.0
    return min(window, 0.9 * dwell) if dwell > 0 else window


def _clock_error(bench: Bench) -> float:
    fit = bench.clock_fit
    if fit is None:
        return 0.0
    return float(np.sqrt(1.0 / np.sum(fit.event_errors**-2.0)))


def _scaled(estimate: Estimate, signal: Signal) -> Estimate:
    """Add the uncertainty of scale and zero."""
    return widened(estimate, signal.zero_error, signal.relative_error * estimate.value)
