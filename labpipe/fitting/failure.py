"""Failure of a specimen: where the force is lost, the peak before it, the energy up to it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labpipe.fitting.correlated import fit_linear
from labpipe.fitting.estimates import Estimate, Failure
from labpipe.fitting.loops import loop_energy
from labpipe.fitting.strays import bridged, stray_samples
from labpipe.fitting.summits import LEAST, height_at_end, height_of_top, short_median
from labpipe.records.arrays import Floats, Ints, median
from labpipe.records.curve import Interval

_LEAST = 16
_FALL = 5.0
"""A step down of more than this many deviations of the steps before belongs to the loss."""
_SUDDEN = 0.005
"""Share of the samples before the failure within which an earlier loss is sudden (4 at least)."""
_NOTABLE = 0.02
"""Share of the force carried below which an earlier loss is not told."""


@dataclass(frozen=True, slots=True)
class FailurePoint:
    """The last point before the force is lost.

    Parameters
    ----------
    displacement : m, of that sample; the specimen broke between it and the next one, which is what
        its lopsided interval says
    force : N, carried half a step beyond the sample by a parabola through the smooth stretch before
    sample : number of the sample in the arrays given
    step : m, to the next sample
    lost_before : largest share of the force that was suddenly lost earlier and after which the
        force never came back to where it had been: the specimen failed in steps, and this point is
        the last of them above the share; 0 where there was none of at least 2 %
    """

    displacement: Estimate
    force: Estimate
    sample: int
    step: float
    lost_before: float = 0.0


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
    frame goes back; ``no_tension`` when the force is nowhere above zero; ``too_few_samples`` (fewer
    than 16 before the loss).

    Notes
    -----
    Stray samples (`labpipe.fitting.strays.stray_samples`) are left out, and the shares are those of
    the median of five neighbours: neither a spike nor a dropout is a peak or a loss. From the last
    sample above the share the search goes back over steps down that are steeper than five robust
    deviations of the steps before: the samples on the way down. Where the force decays without a
    cliff, the point is the last sample above the share.
    """
    known = _sound(displacement, force)
    d, f = displacement[known], force[known]
    if len(d) < _LEAST:
        return Failure("too_few_samples", f"{len(d)} samples, {_LEAST} are needed")
    level = short_median(f)
    top = int(np.argmax(level))
    if level[top] <= 0.0:
        return Failure(
            "no_tension", f"the force is nowhere above zero, at most {level[top] + 0.0:.4g} N"
        )
    last = int(np.flatnonzero(level >= force_below * level[top])[-1])
    missing = _not_lost(d, level, top, last, force_below)
    if missing is not None:
        return missing
    last = _before_cliff(f, last)
    if last + 1 < _LEAST:
        return Failure("too_few_samples", f"{last + 1} samples before the loss of force")
    return _point(d, f, last, int(known[last]))


def _sound(displacement: Floats, force: Floats) -> Ints:
    """Numbers of the samples that are neither missing nor stray."""
    is_sound = ~np.isnan(displacement) & ~np.isnan(force)
    is_sound[stray_samples(force)] = False
    return np.flatnonzero(is_sound).astype(np.int64)


def _not_lost(d: Floats, level: Floats, top: int, last: int, share: float) -> Failure | None:
    if last == len(level) - 1:
        end, peak = float(level[-1]), float(level[top])
        found = f"the force ends at {end:.4g} N, {end / peak:.0%} of its peak {peak:.4g} N"
        return Failure("no_failure", f"{found}; below {share:.0%} counts as lost")
    if d[last + 1] < d[top]:
        found = f"from {1e3 * d[top]:.4g} mm to {1e3 * d[last + 1]:.4g} mm"
        return Failure(
            "no_failure", f"the force goes down while the displacement goes back, {found}"
        )
    return None


def _before_cliff(f: Floats, last: int) -> int:
    steps = np.diff(f[: last + 1])
    usual = median(steps)
    spread = 1.4826 * median(np.abs(steps - usual))
    while last > 0 and f[last] - f[last - 1] < usual - _FALL * spread - 1e-12 * abs(f[last]):
        last -= 1
    return last


def _point(d: Floats, f: Floats, last: int, sample: int) -> FailurePoint:
    step = max(float(d[last + 1] - d[last]), 0.0)
    at = float(d[last])
    place = Estimate(at, step / np.sqrt(12.0), 1, Interval(at, at + 0.95 * step))
    upto = slice(0, last + 1)
    height = height_at_end(d[upto], f[upto], step=step)
    return FailurePoint(place, height, sample, step, _lost_before(f[upto]))


def _lost_before(f: Floats) -> float:
    """Largest share lost suddenly for good, of the highest force before that moment."""
    width = max(4, int(_SUDDEN * len(f)))
    if len(f) <= 2 * width:
        return 0.0
    level = short_median(f)
    before = np.maximum.accumulate(level)[:-width]
    later = np.maximum.accumulate(level[::-1])[::-1][width:]
    falls = level[:-width] - level[width:]
    spread = 1.4826 * median(np.abs(falls - median(falls)))
    is_sudden = falls > np.maximum(6.0 * spread, _NOTABLE * before)
    shares = np.where(is_sudden, (before - later) / np.where(before > 0.0, before, np.inf), 0.0)
    largest = float(shares.max())
    return largest if largest >= _NOTABLE else 0.0


def peak_before_failure(
    displacement: Floats, force: Floats, point: FailurePoint, *, share: float = 0.1
) -> Estimate | Failure:
    """Largest force of a curve that ends in a cliff.

    Parameters
    ----------
    displacement, force : shape (n,), m, N; as given to `find_failure`; NaN and stray samples are
        left out
    point : the failure
    share : the top that is looked at: the stretch around the largest median of five in which this
        median stays above (1 - share) of it

    Returns
    -------
    N, or a failure ``too_few_samples`` (fewer than 12 before the loss).

    Notes
    -----
    A polynomial through the smooth stretch around the top: its turning point when that lies inside,
    else its value at the higher end, half a step further where a cliff or the failure ends it. The
    stretch ends at cliffs (steps of more than six robust deviations) and at kinks: as long as a
    change of slope somewhere adds more than four standard errors to a polynomial of degree six, in
    noise that knows its neighbours, the stretch is cut there. Where the force rises up to the kink
    and falls behind it, and the kink does better than that polynomial, the peak is the corner in
    which both sides meet. The degree of the polynomial is two, or as many as the data ask for, up
    to eight: while one of the next two terms is beyond its 95 % interval. A turning point is read
    from a polynomial of two degrees more, so that terms too small to be seen do not bias it beyond
    its interval (undersmoothing; Calonico, Cattaneo and Titiunik, Econometrica 82 (2014) 2295),
    less what noise lifts it by. Where fewer than 12 samples are smooth, it is the largest median of
    five neighbours, with their range and the noise in its interval. The largest sample would be too
    large by the noise: what is meant is the largest force on the specimen, free of noise.
    """
    known = _sound(displacement, force)
    known = known[known <= point.sample]
    if len(known) < LEAST:
        return Failure(
            "too_few_samples", f"{len(known)} samples before the loss, {LEAST} are needed"
        )
    return height_of_top(displacement[known], force[known], share=share, step=point.step)


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
    specimen broke somewhere in that step. Stray samples lie on the straight line over them. Its
    error has the step and the noise: of both channels (`labpipe.fitting.loops.loop_energy`), or
    that of the force with a correlation over up to a twenty-fifth of the curve, whichever is
    greater.
    """
    count = point.sample + 1
    displacement, force = displacement[:count], bridged(force, stray_samples(force))[:count]
    work = loop_energy(np.arange(count, dtype=np.float64), displacement, force, clock_error=0.0)
    if isinstance(work, Failure):
        return work
    more = point.force.value * point.step
    noise = np.sqrt(_slow_noise(force) * float(np.sum(np.gradient(displacement) ** 2)))
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
