"""Failure of a specimen: where the force is lost, the peak before it, the energy up to it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labpipe.fitting.correlated import fit_linear
from labpipe.fitting.estimates import Estimate, Failure
from labpipe.fitting.loops import loop_energy
from labpipe.records.arrays import Floats
from labpipe.records.curve import Interval

_LEAST = 16
_FALL = 5.0
"""A step down of more than this many deviations of the steps before belongs to the loss."""


@dataclass(frozen=True, slots=True)
class FailurePoint:
    """The last point before the force is lost.

    Parameters
    ----------
    displacement : m, of that sample; the specimen broke between it and the next one, which is what
        its lopsided interval says
    force : N, carried half a step beyond the sample by a parabola through those before
    sample : number of the sample in the arrays given
    step : m, to the next sample
    """

    displacement: Estimate
    force: Estimate
    sample: int
    step: float


def find_failure(
    displacement: Floats, force: Floats, *, force_below: float
) -> FailurePoint | Failure:
    """Last point before the force falls below a share of its maximum and does not come back.

    Parameters
    ----------
    displacement, force : shape (n,), m, N; loading branch and what follows; NaN are left out
    force_below : share of the largest force, such as 0.5

    Returns
    -------
    The point, or a failure: ``no_failure`` when the force is not lost, or goes down because the
    frame goes back; ``too_few_samples`` (fewer than 16 before the loss).

    Notes
    -----
    From the last sample above the share the search goes back over steps down that are steeper than
    five robust deviations of the steps before: the samples on the way down. Where the force decays
    without a cliff, the point is the last sample above the share.
    """
    known = np.flatnonzero(~np.isnan(displacement) & ~np.isnan(force))
    d, f = displacement[known], force[known]
    if len(d) < _LEAST:
        return Failure("too_few_samples", f"{len(d)} samples, {_LEAST} are needed")
    top = int(np.argmax(f))
    last = int(np.flatnonzero(f >= force_below * f[top])[-1])
    if last == len(f) - 1:
        found = f"the force ends at {f[-1]:.4g} N, {f[-1] / f[top]:.0%} of its peak {f[top]:.4g} N"
        return Failure("no_failure", f"{found}; below {force_below:.0%} counts as lost")
    if d[last + 1] < d[top]:
        found = f"from {1e3 * d[top]:.4g} mm to {1e3 * d[last + 1]:.4g} mm"
        return Failure(
            "no_failure", f"the force goes down while the displacement goes back, {found}"
        )
    last = _before_cliff(f, last)
    if last + 1 < _LEAST:
        return Failure("too_few_samples", f"{last + 1} samples before the loss of force")
    return _point(d, f, last, int(known[last]))


def _before_cliff(f: Floats, last: int) -> int:
    steps = np.diff(f[: last + 1])
    usual = float(np.median(steps))
    spread = 1.4826 * float(np.median(np.abs(steps - usual)))
    while last > 0 and f[last] - f[last - 1] < usual - _FALL * spread - 1e-12 * abs(f[last]):
        last -= 1
    return last


def _point(d: Floats, f: Floats, last: int, sample: int) -> FailurePoint:
    step = max(float(d[last + 1] - d[last]), 0.0)
    at = float(d[last])
    place = Estimate(at, step / np.sqrt(12.0), 1, Interval(at, at + 0.95 * step))
    count = int(np.clip((last + 1) // 5, 12, 200))
    before = slice(last + 1 - count, last + 1)
    height, slope = _carried(d[before], f[before], at + 0.5 * step)
    return FailurePoint(place, _blurred(height, slope * step), sample, step)


def _carried(d: Floats, f: Floats, at: float) -> tuple[Estimate, float]:
    """Height and slope of a parabola at a place."""
    scale = float(np.ptp(d)) or 1.0
    x = (d - at) / scale
    fit = fit_linear(np.column_stack([np.ones_like(x), x, x * x]), f)
    return fit.estimate(0), float(fit.coefficients[1]) / scale


def _blurred(estimate: Estimate, width: float) -> Estimate:
    """The estimate of a number that may lie anywhere in a range of a width around it."""
    error = float(np.hypot(estimate.error, width / np.sqrt(12.0)))
    if estimate.interval is None or estimate.error == 0.0:
        return Estimate(estimate.value, error, estimate.n)
    half = (estimate.interval.upper - estimate.value) * error / estimate.error
    interval = Interval(estimate.value - half, estimate.value + half)
    return Estimate(estimate.value, error, estimate.n, interval)


def peak_before_failure(
    displacement: Floats, force: Floats, point: FailurePoint, *, share: float = 0.1
) -> Estimate | Failure:
    """Largest force of a curve that ends in a cliff.

    Parameters
    ----------
    displacement, force : shape (n,), m, N; as given to `find_failure`; NaN are left out
    point : the failure
    share : the top that is fitted: the last stretch with forces above (1 - share) of the largest

    Returns
    -------
    N, or a failure ``too_few_samples`` (fewer than 12 before the loss).

    Notes
    -----
    A parabola through the top, one-sided: its vertex when that lies inside, else its value half a
    step beyond the last sample before the loss. The largest sample would be too large by the noise.
    """
    upto = slice(0, point.sample + 1)
    known = ~np.isnan(displacement[upto]) & ~np.isnan(force[upto])
    d, f = displacement[upto][known], force[upto][known]
    if len(d) < 12:
        return Failure("too_few_samples", f"{len(d)} samples before the loss, 12 are needed")
    low = np.flatnonzero(f < (1.0 - share) * f.max())
    first = min(
        int(low[low < np.argmax(f)][-1]) + 1 if (low < np.argmax(f)).any() else 0, len(f) - 12
    )
    d, f = d[first:], f[first:]
    end = float(d[-1]) + 0.5 * point.step
    scale = float(np.ptp(d)) or 1.0
    curvature, slope, _ = np.polyfit((d - end) / scale, f, 2)
    vertex = end - scale * slope / (2.0 * curvature) if curvature < 0.0 else end
    if d[0] < vertex < end:
        return _carried(d, f, float(vertex))[0]
    height, slope = _carried(d, f, end)
    return _blurred(height, slope * point.step)


def energy_to_break(displacement: Floats, force: Floats, point: FailurePoint) -> Estimate | Failure:
    """Work done on the specimen up to its failure.

    Parameters
    ----------
    displacement, force : shape (n,), m, N; from the start of loading, as given to `find_failure`
    point : the failure

    Returns
    -------
    J, or a failure: ``gap`` when samples before the failure are missing, ``too_few_samples``.

    Notes
    -----
    Trapezoids to the last sample before the loss, plus half a step at the force there, since the
    specimen broke somewhere in that step. Its error has the step and the noise: of both channels
    (`labpipe.fitting.loops.loop_energy`), or that of the force with a correlation over up to a
    twenty-fifth of the curve, whichever is greater.
    """
    upto = slice(0, point.sample + 1)
    count = point.sample + 1
    work = loop_energy(
        np.arange(count, dtype=np.float64), displacement[upto], force[upto], clock_error=0.0
    )
    if isinstance(work, Failure):
        return work
    more = point.force.value * point.step
    noise = np.sqrt(_slow_noise(force[upto]) * float(np.sum(np.gradient(displacement[upto]) ** 2)))
    error = float(np.hypot(max(work.error, float(noise)), more / np.sqrt(12.0)))
    return Estimate(work.value + 0.5 * more, error, work.n)


def _slow_noise(f: Floats) -> float:
    """Long-run variance of the force about cubics through fifths of the curve, N^2.

    The median of the fifths: one of them may hold a kink.
    """
    pieces = [piece for piece in np.array_split(f, 5) if len(piece) >= _LEAST]
    powers = []
    for piece in pieces:
        x = np.linspace(-1.0, 1.0, len(piece))
        basis = np.linalg.qr(np.vander(x, 4, increasing=True))[0]
        powers.append(float(fit_linear(basis, piece).covariance[0, 0]))
    return float(np.median(powers)) if powers else 0.0
