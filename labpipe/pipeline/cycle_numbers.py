"""Numbers of one cycle: from the bench to an estimate that knows calibration and zero.

Each takes the bench, the branches of the cycle, and the displacement on the clock of the curve,
which may be that of another shape of the specimen; what cannot be had is a failure with a reason.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from labpipe.fits.loops import (
    largest_sample,
    loop_energy,
    noise_power,
    residual_after_unloading,
    secant_stiffness,
    sense_of_loading,
)
from labpipe.pipeline.bench import Bench
from labpipe.pipeline.corrections import repair_error
from labpipe.records.arrays import Floats
from labpipe.records.curve import Branch, Curve, Direction
from labpipe.records.estimates import Estimate, Failure, widened
from labpipe.signal.filters import moving_average, power_passed
from labpipe.signal.turning_points import noise_level

_FEW = 16
"""Samples below which nobody can tell how far the noise remembers."""
_NOISE = 100_000
"""Samples before a turn that say what the noise of the force is like."""


def peak_force_of(bench: Bench, branches: list[Branch], displacement: Floats) -> Estimate | Failure:
    """Largest force of a cycle in the sense of loading, N."""
    del displacement
    peak, signal = unscaled_peak(bench, branches), bench.raw[bench.force]
    if isinstance(peak, Failure):
        return peak
    return widened(peak, signal.zero_error, signal.relative_error * peak.value)


def unscaled_peak(bench: Bench, branches: list[Branch]) -> Estimate | Failure:
    """Largest force of a cycle, N, without the uncertainty of zero and scale."""
    sense = sense_over(bench, curve_of(bench).force)
    values = sense * _force_of_cycle(bench, branches)
    peak = largest_sample(values, noise=_force_noise(bench, branches[0]))
    if isinstance(peak, Failure):
        return peak
    peak = widened(peak, repair_error(bench, before=branches[0].stop))
    return replace(peak, value=sense * peak.value)


def _force_of_cycle(bench: Bench, branches: list[Branch]) -> Floats:
    """All samples of the force over a cycle: on its own clock where that is another one."""
    curve, signal = curve_of(bench), bench.signals[bench.force]
    if signal.clock == bench.signals[bench.displacement].clock:
        return curve.force[stretch_of_cycle(bench, branches)]
    stretch = stretch_of_cycle(bench, branches)
    ends = curve.time[[stretch.start, min(stretch.stop, len(curve.time)) - 1]]
    first, last = (bench.from_curve_clock(float(at), signal.clock) for at in ends)
    return signal.values[slice(*np.searchsorted(signal.time, [first, last]))]


def _force_noise(bench: Bench, loading: Branch) -> float:
    """Standard deviation that the noise of the force has left after its filters, N."""
    raw = bench.unfiltered or bench.raw[bench.force]
    ends = (loading.start_time, loading.stop_time)
    first, last = (bench.from_curve_clock(at, raw.clock) for at in ends)
    start, stop = np.searchsorted(raw.time, [first, last])
    values = raw.values[max(int(start), int(stop) - _NOISE) : int(stop)]
    values = values[~np.isnan(values)]
    filters = bench.filters.get(bench.force, ())
    if not filters or len(values) < _FEW:
        return noise_level(values)
    passed = min(power_passed(act, len(values)) for act, _ in filters)
    return float(min(np.sqrt(passed * noise_power(values)), noise_level(values)))


def sense_over(bench: Bench, values: Floats) -> float:
    """Which way a quantity of the curve goes when the specimen is loaded for the first time."""
    branch = curve_of(bench).branches[0]
    return sense_of_loading(values[branch.start : branch.stop])


def peak_displacement_of(
    bench: Bench, branches: list[Branch], displacement: Floats
) -> Estimate | Failure:
    """Largest displacement of a cycle in the sense of loading, m."""
    signal = bench.signals[bench.displacement]
    sense = sense_over(bench, displacement)
    values = sense * displacement[stretch_of_cycle(bench, branches)]
    found = largest_sample(values, noise=noise_level(values))
    if isinstance(found, Failure):
        return found
    found = replace(found, value=sense * found.value)
    return widened(found, signal.zero_error, signal.relative_error * found.value)


def gap_at_top(values: Floats) -> bool:
    """Whether samples beside the largest one are missing, so that it may not be the largest.

    Parameters
    ----------
    values : shape (n,), in the sense of loading
    """
    if np.isnan(values).all():
        return False
    top = int(np.nanargmax(values))
    return bool(np.isnan(values[max(top - 1, 0) : top + 2]).any())


def energy_of(bench: Bench, branches: list[Branch], displacement: Floats) -> Estimate | Failure:
    """Work dissipated over the cycle, J."""
    if len(branches) < 2:
        return Failure("partial_cycle", "the cycle has no unloading branch")
    curve, stretch = curve_of(bench), stretch_of_cycle(bench, branches)
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
    sense = sense_over(bench, displacement)
    turn = _value_at_start(curve_of(bench).time, sense * displacement, branches[1])
    found = stiffness_over(bench, branches[1], turn - sense * displacement, low, high)
    if isinstance(found, Failure):
        return found
    return _scaled_by_force(bench, Estimate(-sense * found.value, found.error, found.n))


def _value_at_start(time: Floats, values: Floats, part: Branch) -> float:
    """Value at the turning point a branch starts from, by a parabola through its beginning.

    The samples from that moment on: a branch may hold some of the wait before it.
    """
    first = max(part.start, int(np.searchsorted(time, part.start_time)))
    begin = slice(first, first + min(50, (part.stop - first) // 10))
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


def stretch_of_cycle(bench: Bench, branches: list[Branch]) -> slice:
    """Samples of the curve from the turn where a cycle begins to that where it ends, both included.

    Where the motion rests between two cycles, they part at its extreme. A last loading without an
    unloading lasts as long as force is known: what is held belongs to it.
    """
    curve, last = curve_of(bench), branches[-1]
    first, behind = (curve.branches.index(each) for each in (branches[0], last))
    start = _turn_before(bench, first) if first else branches[0].start
    if behind + 1 < len(curve.branches):
        return slice(start, _turn_before(bench, behind + 1) + 1)
    if last.direction is Direction.UNLOADING:
        return slice(start, last.stop)
    known = int(np.flatnonzero(~np.isnan(curve.force)).max(initial=0)) + 1
    return slice(start, max(known, last.stop))


def _turn_before(bench: Bench, number: int) -> int:
    """Sample at which the motion turns before a branch that is not the first one."""
    curve = curve_of(bench)
    rest = slice(curve.branches[number - 1].stop, curve.branches[number].start + 1)
    seen = sense_over(bench, curve.displacement) * curve.displacement[rest]
    if np.isnan(seen).all():
        return rest.stop - 1
    is_top = curve.branches[number - 1].direction is Direction.LOADING
    return rest.start + int(np.nanargmax(seen) if is_top else np.nanargmin(seen))


def _clock_error(bench: Bench) -> float:
    fit = bench.clock_fit
    if fit is None:
        return 0.0
    return float(np.sqrt(1.0 / np.sum(fit.event_errors**-2.0)))
