"""Numbers of a force-displacement loop: stiffness, energy, peaks."""

from __future__ import annotations

import numpy as np

from labpipe.fitting.estimates import Estimate, Failure
from labpipe.fitting.noise import long_run_variance
from labpipe.records.arrays import Flags, Floats

_NEAR = 1000
"""Samples on each side of the largest one that show what the file rounds to."""
_LEAST_OF_LOOP = 3
"""Samples that enclose an area."""


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
    if len(time) < _LEAST_OF_LOOP:
        message = f"{len(time)} samples in the cycle, {_LEAST_OF_LOOP} are needed"
        return Failure("too_few_samples", message)
    work = _work(displacement, force)
    steps, rises = np.gradient(displacement), np.gradient(force)
    force_noise, displacement_noise = noise_power(force), noise_power(displacement)
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


def largest_sample(values: Floats, *, noise: float) -> Estimate | Failure:
    """Largest sample of a stretch.

    Parameters
    ----------
    values : shape (n,), any unit; NaN are left out
    noise : in that unit, standard deviation of a sample

    Returns
    -------
    The sample, or a failure ``no_sample`` where all are NaN. Its error has the noise, half of the
    resolution, and how far a corner may reach beyond its largest sample: half of the difference
    between the steps up to it and down from it.

    Notes
    -----
    In noise the largest of many samples lies above the largest value of the signal; the error does
    not say so.
    """
    known = values[~np.isnan(values)]
    if not len(known):
        return Failure("no_sample", "every sample of the stretch is blank")
    halves = np.array([_reach_of_corner(known), 0.5 * resolution(known)])
    error = np.hypot(noise, np.linalg.norm(halves) / np.sqrt(3.0))
    return Estimate(float(known.max()), float(error), len(known))


def _reach_of_corner(values: Floats) -> float:
    """How far a corner may reach beyond its largest sample; the two steps on each side tell.

    A signal that stands still at its top, or is lost behind it, reaches no further on that side
    than it went before.
    """
    top = int(np.argmax(values))
    up = values[top] - values[max(top - 2, 0) : top][::-1]
    down = values[top] - values[top + 1 : top + 3]
    if not len(up) or not len(down):
        return 0.0
    steps = (np.diff(side, prepend=0.0).max() for side in (up, down))
    return float(min(abs(up[0] - down[0]) / 2.0, *steps))


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


def resolution(values: Floats) -> float:
    """Smallest difference between samples near the largest one that are not the same.

    Parameters
    ----------
    values : shape (n,), any unit, without NaN

    Returns
    -------
    In that unit; 0 where all samples are the same. What a converter, or a file with few digits,
    rounds to; in unrounded noise next to nothing.
    """
    top = int(np.argmax(values))
    steps = np.diff(np.unique(values[max(top - _NEAR, 0) : top + _NEAR]))
    steps = steps[steps > 1e-9 * np.abs(values[top])]  # less is what arithmetic leaves over
    return float(steps.min()) if len(steps) else 0.0
