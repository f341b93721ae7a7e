"""A force-displacement loop: stiffness, energy, and direction of loading."""

from __future__ import annotations

import numpy as np

from labpipe.records.arrays import Flags, Floats, median
from labpipe.records.estimates import Estimate, Failure
from labpipe.uncertainty.autocorrelation import long_run_variance

MIN_LOOP_SAMPLES = 3


def secant_stiffness(
    time: Floats, displacement: Floats, force: Floats, chosen: Flags
) -> Estimate | Failure:
    """Return the slope of force against displacement over chosen samples.

    Parameters
    ----------
    time, displacement, force : shape (n,), s, m, N
    chosen : shape (n,); NaN are ignored

    Returns
    -------
    N/m, or a failure ``too_few_samples`` or ``no_travel``.

    Notes
    -----
    k = sum (t - mean t) F / sum (t - mean t) d: time is the instrument, because ordinary least
    squares of F on a noisy displacement is too small (by the ratio of noise variance to variance;
    Fuller, Measurement Error Models, 1987, sec. 1.4). The standard error is from the long-run
    variance of F - k d less a cubic in time, the shape of the curve.
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
    """Integrate force over displacement by trapezoids, J, shape (...).

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


def sense_of_loading(values: Floats) -> float:
    """Return the sign of a quantity during loading.

    Parameters
    ----------
    values : shape (n,), over the first loading branch; NaN are ignored

    Returns
    -------
    -1.0 if it goes further down than up from its first value, else 1.0. If it goes both ways alike,
    as a force that begins high and is lost, the sign of the larger absolute value.
    """
    finite = values[~np.isnan(values)]
    if not len(finite):
        return 1.0
    first = median(finite[: max(1, len(finite) // 100)])
    up, down = float(finite.max()) - first, first - float(finite.min())
    if max(up, down) > 2.0 * min(up, down):
        return 1.0 if up > down else -1.0
    return 1.0 if finite.max() >= -finite.min() else -1.0
