"""Failure of a specimen: where the force is lost for good, and the energy up to it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labpipe.fits.loops import loop_energy
from labpipe.records.arrays import Flags, Floats
from labpipe.records.curve import Interval
from labpipe.records.estimates import Estimate, Failure
from labpipe.uncertainty.linear_fits import fit_linear

_LEAST = 16


@dataclass(frozen=True, slots=True)
class FailurePoint:
    """The first sample of the final loss of force: the last one before it.

    Parameters
    ----------
    displacement : m, of that sample; the specimen broke between it and the next one, which is what
        its asymmetric interval says
    force : N, of that sample
    sample : number of the sample in the arrays given
    step : m, to the next sample
    lost_before : largest share of the peak that was suddenly lost earlier and after which the
        force never came back to where it had been: the specimen failed in steps; 0 without one
    """

    displacement: Estimate
    force: Estimate
    sample: int
    step: float
    lost_before: float = 0.0


@dataclass(frozen=True, slots=True)
class LossOfForce:
    """What counts as a break.

    Parameters
    ----------
    force_below : share of the largest force below which the specimen no longer carries
    loss : share of the largest force that is lost at once
    within : s; in less than this, or in one step between samples where that is longer
    """

    force_below: float
    loss: float
    within: float


def final_loss(
    time: Floats, force: Floats, rule: LossOfForce, goes_back: Flags | None = None
) -> int | Failure:
    """Sample at which the final loss of force begins.

    Parameters
    ----------
    time, force : shape (n,), s (or numbers of rows), N; unfiltered; NaN are left out
    rule : what counts as a loss
    goes_back : shape (n,), where the displacement goes back, so that a falling force is no loss

    Returns
    -------
    Number of the sample, or a failure: ``no_break`` where the force is not lost, is lost
    slowly, or while the displacement goes back; ``no_tension`` where it is nowhere above zero.

    Notes
    -----
    From the last sample with at least `force_below` of the largest force, which the force does not
    reach again, go back to the first sample of the loss: as long as the force falls by `loss` of
    its largest value, or more, within `within`. So a smooth fall before the loss, such as the
    necking of a wire, belongs to the test. A loss within one step of a slow recording is found as
    well as one that a fast recording has many samples of.
    """
    known = np.flatnonzero(~np.isnan(force))
    t, f = time[known], force[known]
    if not len(f) or not f.max() > 0.0:
        most = float(f.max()) + 0.0 if len(f) else 0.0
        return Failure("no_tension", f"the force is nowhere above zero, at most {most:.4g} N")
    peak = float(f.max())
    last = int(np.flatnonzero(f >= rule.force_below * peak)[-1])
    if last == len(f) - 1:
        found = f"the force ends at {f[-1]:.4g} N, {f[-1] / peak:.0%} of its peak {peak:.4g} N"
        return Failure("no_break", f"{found}; below {rule.force_below:.0%} counts as lost")
    if goes_back is not None and goes_back[known[last]]:
        return Failure("no_break", "the force goes down while the displacement goes back")
    fallen = f[last] - float(f[last + 1 : max(_reach(t, last, rule.within), last + 2)].min())
    first = _back_to_first(t, f, last, rule, peak)
    if first == last and fallen < rule.loss * peak:
        message = (
            f"the force goes below {rule.force_below:.0%} of its peak {peak:.4g} N slowly: it is "
            f"nowhere lost there by {rule.loss:.0%} within {1e3 * rule.within:.4g} ms; if such "
            "specimens break so, state a longer curve.failure.within"
        )
        return Failure("no_break", message)
    return int(known[first])


def _reach(time: Floats, sample: int, within: float) -> int:
    """The first sample later than `within` after one, left out of what follows it at once."""
    return int(np.searchsorted(time, time[sample] + within, side="right"))


def _back_to_first(t: Floats, f: Floats, last: int, rule: LossOfForce, peak: float) -> int:
    """Go back while the force falls by the share within the time, or at that rate."""
    lost = rule.loss * peak
    while last > 0:
        begin = min(int(np.searchsorted(t, t[last] - rule.within)), last - 1)
        higher = np.flatnonzero(f[begin:last] - f[last] >= lost)
        step = float(t[last] - t[last - 1])
        if len(higher):
            last = begin + int(higher[-1])
        elif f[last - 1] - f[last] >= lost * min(1.0, step / rule.within):
            last -= 1
        else:
            break
    return last


def lost_earlier(time: Floats, force: Floats, rule: LossOfForce) -> float:
    """Largest share of the peak that was lost at once before the end, for good.

    Parameters
    ----------
    time, force : shape (n,), s, N; up to the sample at which the final loss begins; without NaN
    rule : what counts as a loss

    Returns
    -------
    Share of the largest force; 0 where none of at least `loss` was lost within `within`.
    """
    peak = float(force.max(initial=0.0))
    later = np.searchsorted(time, time + rule.within, side="right") - 1
    later = np.minimum(np.maximum(later, np.arange(len(force)) + 1), len(force) - 1)
    ahead = np.maximum.accumulate(force[::-1])[::-1][later]
    is_lost = (force - force[later] >= rule.loss * peak) & (later > np.arange(len(force)))
    shares = np.where(is_lost, (force - ahead) / peak if peak > 0.0 else 0.0, 0.0)
    largest = float(shares.max(initial=0.0))
    return largest if largest >= rule.loss else 0.0


def failure_point(
    time: Floats, displacement: Floats, force: Floats, sample: int, rule: LossOfForce
) -> FailurePoint:
    """The numbers of a failure.

    Parameters
    ----------
    time, displacement, force : shape (n,), s, m, N; from the start of loading
    sample : at which the final loss begins
    rule : by which it was found

    Returns
    -------
    The point. The interval of its displacement reaches from the sample to the next one, that of
    its force as far as the force changed in the step before, in which the loss may have begun.
    """
    after = np.flatnonzero(~np.isnan(displacement[sample + 1 :]))
    step = float(displacement[sample + 1 + after[0]] - displacement[sample]) if len(after) else 0.0
    step, at = max(step, 0.0), float(displacement[sample])
    place = Estimate(at, step / np.sqrt(12.0), 1, Interval(at, at + 0.95 * step))
    known = ~np.isnan(force[: sample + 1]) & ~np.isnan(time[: sample + 1])
    t, f = time[: sample + 1][known], force[: sample + 1][known]
    rise = abs(float(f[-1] - f[-2])) if len(f) > 1 else 0.0
    level = Estimate(float(force[sample]), rise / np.sqrt(3.0), 1)
    return FailurePoint(place, level, sample, step, lost_earlier(t, f, rule))


def energy_to_break(displacement: Floats, force: Floats, point: FailurePoint) -> Estimate | Failure:
    """Work done on the specimen up to its failure.

    Parameters
    ----------
    displacement, force : shape (n,), m, N; from the start of loading on
    point : the failure, counted from there

    Returns
    -------
    J, or a failure: ``gap`` when samples before the failure are missing, ``too_few_samples``.

    Notes
    -----
    Trapezoids to the sample of the failure. Its error has the step to the next sample, in which
    the specimen broke, and the noise: of both channels (`labpipe.fits.loops.loop_energy`), or
    that of the force with a correlation over up to a twenty-fifth of the curve, whichever is
    greater.
    """
    count = point.sample + 1
    displacement, force = displacement[:count], force[:count]
    work = loop_energy(np.arange(count, dtype=np.float64), displacement, force, clock_error=0.0)
    if isinstance(work, Failure):
        return work
    more = point.force.value * point.step
    noise = np.sqrt(_slow_noise(force) * float(np.sum(np.gradient(displacement) ** 2)))
    error = float(np.hypot(max(work.error, float(noise)), more / np.sqrt(3.0)))
    return Estimate(work.value, error, work.n)


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
