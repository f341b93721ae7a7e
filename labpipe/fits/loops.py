"""Numbers of a force-displacement loop: stiffness, energy, peaks, what unloading leaves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labpipe.records.arrays import Flags, Floats
from labpipe.records.estimates import Estimate, Failure, widened
from labpipe.uncertainty.noise import fast_noise, long_run_variance

LEAST_OF_LOOP = 3
"""Samples that enclose an area."""
_SMALL = 0.02
"""Share of the largest force of a branch that may pass for zero at most."""
_CLEAR = 4.0
"""Standard deviations of noise above which a force is not zero."""
_REACH = 0.1
"""Share of a branch on each side of its zero that a parabola is fitted to."""
_LEAST_NEAR_ZERO = 8


def secant_stiffness(
    time: Floats, displacement: Floats, force: Floats, chosen: Flags
) -> Estimate | Failure:
    """Slope of force against displacement over chosen samples.

    Parameters
    ----------
    time, displacement, force : shape (n,), s, m, N
    chosen : shape (n,), the stretch; NaN in it are left out

    Returns
    -------
    N/m, or a failure ``too_few_samples`` or ``no_travel``.

    Notes
    -----
    k = sum (t - mean t) F / sum (t - mean t) d: time stands in as the instrument, because ordinary
    least squares of F on a displacement that is itself noisy comes out too small (by the ratio
    of noise variance to variance; Fuller, Measurement Error Models, 1987, sec. 1.4). The standard
    error takes the long-run variance of F - k d after a cubic in time, which is the shape of the
    curve and not noise.
    """
    chosen = chosen & ~np.isnan(displacement) & ~np.isnan(force)
    count = int(chosen.sum())
    if count < 8:
        return Failure("too_few_samples", f"{count} samples in the stretch, 8 are needed")
    t, d, f = time[chosen], displacement[chosen], force[chosen]
    weight = t - t.mean()
    travel = float(weight @ (d - d.mean()))
    if travel == 0.0:
        return Failure("no_travel", "the displacement does not change over the stretch")
    slope = float(weight @ (f - f.mean())) / travel
    scaled = weight / np.abs(weight).max()
    left = f - slope * d
    noise = left - np.polynomial.Polynomial.fit(scaled, left, 3)(scaled)
    variance = long_run_variance(noise, parameters=4)
    return Estimate(slope, float(np.sqrt(variance * (weight @ weight)) / abs(travel)), count)


def energy_of(displacement: Floats, force: Floats) -> Floats:
    """Integral of force over displacement by trapezoids, J, shape (...).

    Parameters
    ----------
    displacement, force : shape (..., n), m, N; either may be shape (n,), the same for all rows

    Examples
    --------
    >>> energy_of(np.array([0.0, 1.0, 3.0]), np.array([[0.0, 2.0, 2.0], [1.0, 1.0, 1.0]]))
    array([5., 3.])
    """
    steps = np.empty_like(displacement)
    np.subtract(displacement[..., 2:], displacement[..., :-2], out=steps[..., 1:-1])
    steps[..., 0] = displacement[..., 1] - displacement[..., 0]
    steps[..., -1] = displacement[..., -1] - displacement[..., -2]
    work: Floats = 0.5 * np.vecdot(steps, force)
    return work


def loop_energy(
    time: Floats, displacement: Floats, force: Floats, *, clock_error: float
) -> Estimate | Failure:
    """Work done over a stretch of a curve, the integral of force over displacement.

    Parameters
    ----------
    time, displacement, force : shape (n,), s, m, N; one cycle, evenly sampled
    clock_error : s, standard error of force time against displacement time

    Returns
    -------
    J, or a failure ``gap`` when samples are missing inside.

    Notes
    -----
    Trapezoids. The error adds the noise of the force over the steps of displacement, the noise of
    the displacement over the steps of force, and what a shift of the clocks by `clock_error`
    changes.
    """
    if np.isnan(displacement).any() or np.isnan(force).any():
        missing = int((np.isnan(displacement) | np.isnan(force)).sum())
        return Failure("gap", f"{missing} samples of the cycle have no force or no displacement")
    if len(time) < LEAST_OF_LOOP:
        message = f"{len(time)} samples in the cycle, {LEAST_OF_LOOP} are needed"
        return Failure("too_few_samples", message)
    work = float(np.trapezoid(force, displacement))
    steps, rises = np.gradient(displacement), np.gradient(force)
    force_noise, displacement_noise = noise_power(force), noise_power(displacement)
    # Noise makes the steps look longer; the noise of both is counted once, with the rises.
    squares = float(steps @ steps) - 0.5 * len(time) * displacement_noise
    squares = max(squares, float(np.ptp(displacement)) ** 2 / len(time))
    later = np.trapezoid(force[2:], displacement[:-2])
    earlier = np.trapezoid(force[:-2], displacement[2:])
    per_second = float(later - earlier) / (4.0 * float(np.median(np.diff(time))))
    variance = (
        force_noise * squares
        + displacement_noise * float(rises @ rises)
        + (per_second * clock_error) ** 2
    )
    return Estimate(work, float(np.sqrt(variance)), len(time))


def noise_power(values: Floats) -> float:
    """Long-run variance of the fast noise on a slow signal.

    Parameters
    ----------
    values : shape (n,), evenly sampled, without NaN

    Returns
    -------
    In the unit of `values`, squared: the variance of the mean of many samples times their number.

    Notes
    -----
    Cubics are taken out of pieces of 100 samples, or of a twentieth of a short signal; pieces with
    a corner are left out; correlation is followed over a twelfth of a piece, which it still holds.
    Of fewer than 16 samples all second differences are noise.
    """
    if len(values) < 16:
        return float(np.mean(np.diff(values, n=2) ** 2)) / 6.0 if len(values) > 2 else 0.0
    piece, terms = min(100, max(16, len(values) // 20)), 4
    lags = piece // 12
    rows = values[: len(values) // piece * piece].reshape(-1, piece)
    basis = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, piece), terms))[0]
    left = rows - rows @ basis @ basis.T
    power = np.sum(left**2, axis=1)
    left = left[power <= 4.0 * np.median(power)]
    total = float(np.sum(left**2))
    for lag in range(1, lags + 1):
        weight = 2.0 * (1.0 - lag / (lags + 1.0))
        total += weight * float(np.sum(left[:, lag:] * left[:, :-lag]))
    # Every covariance of the residuals is too small by terms / piece of the variance.
    return float(max(total, 0.0) / left.size / (1.0 - terms * (lags + 1.0) / piece))


def sense_of_loading(values: Floats) -> float:
    """Which way a quantity goes when a specimen is loaded.

    Parameters
    ----------
    values : shape (n,), over the first loading branch; NaN are left out

    Returns
    -------
    -1.0 where it goes further down than up from its first value, else 1.0; where it leaves its
    first value both ways alike, as a force that begins high and is lost does, that of the larger
    absolute value.
    """
    known = values[~np.isnan(values)]
    if not len(known):
        return 1.0
    first = float(np.median(known[: max(1, len(known) // 100)]))
    up, down = float(known.max()) - first, first - float(known.min())
    if max(up, down) > 2.0 * min(up, down):
        return 1.0 if up > down else -1.0
    return 1.0 if known.max() >= -known.min() else -1.0


@dataclass(frozen=True, slots=True)
class _Zero:
    """When a force is zero.

    Parameters
    ----------
    time, error : s
    slope : N/s there, negative
    """

    time: float
    error: float
    slope: float


def residual_after_unloading(
    time: Floats,
    displacement: Floats,
    force: Floats,
    *,
    force_below: float,
    zero_error: float = 0.0,
    clock_error: float = 0.0,
) -> Estimate | Failure:
    """Displacement that is left when an unloading branch has brought the force back to zero.

    Parameters
    ----------
    time, displacement, force : shape (n,), s, m, N; one unloading branch; NaN are left out
    force_below : N; a force is taken for zero when it stays within this. A weak specimen needs
        less: never more than a fiftieth of the largest force, unless its noise (four standard
        deviations) is more
    zero_error : N, standard error of the force's zero
    clock_error : s, standard error of the time of the force against that of the displacement

    Returns
    -------
    m, or a failure: ``force_not_zero`` when the branch ends before the force is back at zero,
    ``too_few_samples``.

    Notes
    -----
    Three ways to end. The force goes on below zero: parabolas through force and displacement, over
    a tenth of the branch on each side, say when it is zero and where the specimen is then; what
    half the reach would change is the half width of a rectangle in the error. The string gets
    slack (the force between five limits and one, followed by a straight line, would have fallen by
    three limits more, and stays within two) and the displacement rests: the mean over that rest.
    Else the line is followed to zero, and the displacement along a line through the second before,
    since it may have a kink there; what a parabola through the foot of the force would change is
    the half width of a rectangle in the error.
    """
    known = ~np.isnan(displacement) & ~np.isnan(force)
    time, displacement, force = time[known], displacement[known], force[known]
    if len(time) < 2 * _LEAST_NEAR_ZERO:
        return Failure("too_few_samples", f"{len(time)} samples, {2 * _LEAST_NEAR_ZERO} are needed")
    limit = max(_CLEAR * fast_noise(force), min(force_below, _SMALL * float(force.max())))
    above = np.flatnonzero(force > limit)
    if len(above) == 0:
        return Failure("too_few_samples", f"{len(time)} samples, none above {limit:.4g} N")
    if above[-1] >= len(force) - 3:
        found = f"the force ends at {force[-3:].mean():.4g} N, above the limit of {limit:.4g} N"
        return Failure("force_not_zero", found)
    if np.median(force[-_LEAST_NEAR_ZERO:]) < -limit:
        return _passed(time, displacement, force, zero_error, clock_error)
    far = np.flatnonzero(force > 5.0 * limit)
    foot = slice(int(far[-1]) if len(far) else 0, int(above[-1]) + 1)
    zero, change = _followed(time[foot], force[foot], zero_error, clock_error)
    rest = time > zero.time + 0.2
    has_stopped = zero.slope * (time[-1] - zero.time) < -3.0 * limit
    is_slack = rest.sum() >= _LEAST_NEAR_ZERO and np.abs(force[rest]).max() <= 2.0 * limit
    if has_stopped and is_slack and _is_still(time[rest], displacement[rest]):
        return _rest_mean(displacement[rest])
    return _line_to(time, displacement, zero, change)


def _passed(
    time: Floats, displacement: Floats, force: Floats, zero_error: float, clock_error: float
) -> Estimate | Failure:
    """Displacement where the force passes through zero."""
    middle = float(time[min(int((force > 0.0).sum()), len(time) - 1)])
    reach = _REACH * float(time[-1] - time[0])
    found = []
    for share in (1.0, 0.5):
        near = np.abs(time - middle) <= share * reach
        if near.sum() < _LEAST_NEAR_ZERO:
            message = f"{int(near.sum())} samples near zero force, {_LEAST_NEAR_ZERO} are needed"
            return Failure("too_few_samples", message)
        at, zero = time[near] - middle, _root(time[near] - middle, force[near], zero_error)
        place, speed = _value_at(at, displacement[near], zero.time, degree=2)
        moved = speed * float(np.hypot(zero.error, clock_error))
        found.append(widened(place, moved))
    return widened(found[0], abs(found[1].value - found[0].value) / np.sqrt(3.0))


def _root(time: Floats, force: Floats, zero_error: float) -> _Zero:
    """When a parabola through a falling force is zero, next to time zero."""
    at = 0.0
    for _ in range(4):
        level, slope = _value_at(time, force, at, degree=2)
        at = float(np.clip(at - level.value / slope, time[0], time[-1]))
    return _Zero(at, float(np.hypot(level.error, zero_error)) / abs(slope), slope)


def _followed(
    time: Floats, force: Floats, zero_error: float, clock_error: float
) -> tuple[_Zero, float]:
    """When a straight line through the foot of a force is zero, and what a parabola says, s."""
    end = float(time[-1])
    if len(time) < 4:
        return _Zero(end, clock_error, 0.0), 0.0
    level, slope = _value_at(time, force, end, degree=1)
    if slope >= 0.0:
        return _Zero(end, clock_error, 0.0), 0.0
    ahead = -level.value / slope
    error = float(np.hypot(level.error, zero_error)) / abs(slope)
    zero = _Zero(end + ahead, float(np.hypot(error, clock_error)), slope)
    bend, fall, height = np.polyfit(time - end, force, 2)
    inside = fall**2 - 4.0 * bend * height
    if inside >= 0.0 and fall < 0.0:
        curved = 2.0 * height / (-fall + np.sqrt(inside))
    else:
        curved = -fall / (2.0 * bend)
    return zero, abs(float(curved) - ahead)


def _value_at(time: Floats, values: Floats, at: float, *, degree: int) -> tuple[Estimate, float]:
    """Value and slope, at a time, of a polynomial through a signal."""
    scale = float(np.ptp(time)) or 1.0
    design = np.vander((time - at) / scale, degree + 1, increasing=True)
    coefficients = np.linalg.lstsq(design, values, rcond=None)[0]
    variance = long_run_variance(values - design @ coefficients, parameters=degree + 1)
    error = float(np.sqrt(variance * np.linalg.pinv(design.T @ design)[0, 0]))
    slope = float(coefficients[1]) / scale
    return Estimate(float(coefficients[0]), error, len(values)), slope


def _is_still(time: Floats, values: Floats) -> bool:
    """Whether a signal does not move by more than its noise."""
    slope, level = np.polynomial.polynomial.polyfit(time - time.mean(), values, 1)[::-1]
    noise = values - level - slope * (time - time.mean())
    return bool(abs(slope) * float(np.ptp(time)) <= 3.0 * float(noise.std()))


def _rest_mean(values: Floats) -> Estimate:
    variance = long_run_variance(values, parameters=1)
    return Estimate(float(values.mean()), float(np.sqrt(variance / len(values))), len(values))


def _line_to(time: Floats, values: Floats, zero: _Zero, change: float) -> Estimate | Failure:
    """Value at a zero of the force, from a straight line through the second before it."""
    near = (time >= zero.time - 1.0) & (time <= zero.time)
    if near.sum() < _LEAST_NEAR_ZERO:
        found = f"{int(near.sum())} samples in the 1 s to {zero.time:.3f} s"
        return Failure("too_few_samples", found)
    place, speed = _value_at(time[near], values[near], zero.time, degree=1)
    return widened(place, speed * zero.error, speed * change / np.sqrt(3.0))
