"""Numbers of a force-displacement loop: stiffness, energy, peaks."""

from __future__ import annotations

import numpy as np

from labpipe.fitting.estimates import Estimate, Failure
from labpipe.fitting.noise import long_run_variance
from labpipe.records.arrays import Flags, Floats

_LEAST = 8
"""Samples on each side of a smooth peak that are fitted at least."""


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
    if len(time) < 16:
        return Failure("too_few_samples", f"{len(time)} samples in the cycle, 16 are needed")
    work = _work(displacement, force)
    steps, rises = np.gradient(displacement), np.gradient(force)
    force_noise, displacement_noise = _noise_power(force), _noise_power(displacement)
    # Noise makes the steps look longer; the noise of both is counted once, with the rises.
    squares = float(steps @ steps) - 0.5 * len(time) * displacement_noise
    squares = max(squares, float(np.ptp(displacement)) ** 2 / len(time))
    later, earlier = _work(displacement[:-2], force[2:]), _work(displacement[2:], force[:-2])
    per_second = (later - earlier) / (4.0 * float(np.median(np.diff(time))))
    variance = (
        force_noise * squares
        + displacement_noise * float(rises @ rises)
        + (per_second * clock_error) ** 2
    )
    return Estimate(work, float(np.sqrt(variance)), len(time))


def _work(displacement: Floats, force: Floats) -> float:
    return float(np.sum(0.5 * (force[1:] + force[:-1]) * np.diff(displacement)))


def _noise_power(values: Floats) -> float:
    """Long-run variance of the fast noise on a slow signal.

    Cubics are taken out of pieces of 100 samples, or of a twentieth of a short signal; pieces with
    a corner are left out; correlation is followed over a twelfth of a piece, which it still holds.
    """
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


def smooth_peak(time: Floats, values: Floats, *, share: float) -> Estimate | Failure:
    """Largest value of a signal that turns smoothly.

    Parameters
    ----------
    time, values : shape (n,), s and any unit
    share : the top of the signal that is fitted: samples above (1 - share) of the peak, next to it

    Returns
    -------
    The vertex of a parabola through the top, or a failure ``too_few_samples``.
    """
    known = ~np.isnan(values)
    time, values = time[known], values[known]
    if len(values) < 2 * _LEAST:
        return Failure("too_few_samples", f"{len(values)} samples, {2 * _LEAST} are needed")
    top = int(np.argmax(values))
    low = np.flatnonzero(values < values[top] - share * float(np.ptp(values)))
    first = int(low[low < top][-1]) + 1 if (low < top).any() else 0
    last = int(low[low > top][0]) if (low > top).any() else len(values)
    first, last = max(0, min(first, top - _LEAST)), min(len(values), max(last, top + _LEAST + 1))
    t, y = time[first:last] - time[top], values[first:last]
    design = np.vander(t, 3)
    curvature, slope, level = np.linalg.lstsq(design, y, rcond=None)[0]
    vertex = float(np.clip(-slope / (2 * curvature), t[0], t[-1])) if curvature < 0 else 0.0
    at = np.array([vertex**2, vertex, 1.0])
    variance = long_run_variance(y - design @ [curvature, slope, level], parameters=3)
    error = float(np.sqrt(variance * (at @ np.linalg.pinv(design.T @ design) @ at)))
    return Estimate(float(at @ [curvature, slope, level]), error, len(y))
