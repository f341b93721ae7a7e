"""The end of a loading curve: how steep it still is, and from where on it is flat."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.records.curve import Interval
from labpipe.records.estimates import Estimate, Failure, scaled, widened
from labpipe.uncertainty.linear_fits import fit_linear

_STEPS = 8
"""Tangents per length of the line that each of them is."""
_LEAST = 8


@dataclass(frozen=True, slots=True, eq=False)
class EndSlope:
    """How steep a curve is over its last stretch.

    Parameters
    ----------
    share : 1, slope over that at the start of the curve
    slope, level : N/m, N, of the line and at its start
    start, stop : m, ends of the stretch
    """

    share: Estimate
    slope: float
    level: float
    start: float
    stop: float


@dataclass(frozen=True, slots=True, eq=False)
class Onset:
    """Where a plateau begins.

    Parameters
    ----------
    displacement, force : m, N; the interval of the place may be asymmetric
    """

    displacement: Estimate
    force: Estimate


def fit_end_slope(
    displacement: Floats, force: Floats, *, initial: Estimate, over: float
) -> EndSlope | Failure:
    """Slope over the last stretch of a loading curve, as a share of that at its start.

    Parameters
    ----------
    displacement, force : shape (n,), m, N; one loading branch in order of time, evenly sampled; NaN
        in either are left out
    initial : N/m, slope at the start, without the uncertainty of the scale of the force, which
        cancels
    over : m, length of the stretch

    Returns
    -------
    The share with its interval, or a failure: ``no_stiffness`` (the initial slope is not above
    zero), ``not_reached`` (the curve is shorter than two stretches), ``too_few_samples``,
    ``no_travel``.

    Notes
    -----
    Slope in the middle of the stretch of a parabola through it (on evenly spaced samples that of
    the straight line), by `fit_linear`: the bend of the curve is then no noise. Both slopes are
    taken for independent: they are read from different stretches.

    Examples
    --------
    >>> d = np.linspace(0.0, 0.05, 501)
    >>> end = fit_end_slope(
    ...     d, np.minimum(800.0 * d, 16.0 + 40.0 * d), initial=Estimate(800.0, 4.0, 50), over=5e-3
    ... )
    >>> round(end.share.value, 9)
    0.05
    """
    d, f = _known(displacement, force)
    if initial.value <= 0.0:
        return Failure("no_stiffness", f"the slope at the start is {initial.value:.4g} N/m")
    if not len(d) or np.ptp(d) < 2.0 * over:
        reached = 1e3 * float(np.ptp(d)) if len(d) else 0.0
        found = f"the branch is {reached:.4g} mm long, twice {1e3 * over:.4g} mm is needed"
        return Failure("not_reached", found)
    middle = float(d.max()) - 0.5 * over
    end = _tangent_at(d, f, middle, over)
    if isinstance(end, Failure):
        return end
    level = end.level.value + end.slope.value * (end.start - middle)
    return EndSlope(_share(end.slope, initial), end.slope.value, level, end.start, end.stop)


def find_onset(
    displacement: Floats, force: Floats, *, initial: Estimate, over: float, slope_below: float
) -> Onset | Failure:
    """Place from which on the tangent of a loading curve stays below a share of the initial slope.

    Parameters
    ----------
    displacement, force, initial, over : as `fit_end_slope` takes them
    slope_below : share of `initial`

    Returns
    -------
    The onset, or a failure: ``no_plateau`` (the interval of the slope at the end is not wholly
    below the share, or no place before is above it), and those of `fit_end_slope`.

    Notes
    -----
    The tangent at a place is the slope over `over` around it, as that of `fit_end_slope`. From the
    end of the curve backwards, the onset is where the tangent first reaches the share. The ends of
    the interval are where the upper and the lower end of the tangent's own interval first do: the
    test of "the tangent is as steep as that here", inverted. A kink is smeared over the length of
    the line, which moves the onset by about twice what half that length changes: the interval is
    stretched that far, to the side to which it changes.
    The force at the onset is that of the parabola over half of `over`. A parabola cuts a corner by
    as much as it is long; what the other half would change is in the interval as the half width of
    a rectangle.

    Examples
    --------
    >>> d = np.linspace(0.0, 0.05, 501)
    >>> f = np.where(d < 0.03, 400.0 * d - 6500.0 * d**2, 6.15)
    >>> onset = find_onset(d, f, initial=Estimate(400.0, 2.0, 50), over=2e-3, slope_below=0.1)
    >>> round(1e3 * onset.displacement.value, 1)
    27.7
    """
    end = fit_end_slope(displacement, force, initial=initial, over=over)
    if isinstance(end, Failure):
        return end
    if end.share.interval is None or end.share.interval.upper >= slope_below:
        return Failure("no_plateau", f"{1e2 * end.share.value:.3g} % of the initial slope")
    d, f = _known(displacement, force)
    tangents = _tangents(d, f, initial, over, slope_below)
    place, lower, upper = (_crossing(tangents[0], each, slope_below) for each in tangents[1:])
    if place is None or upper is None:
        return Failure("no_plateau", "the curve is nowhere steeper than at its end")
    lower = float(d.min()) if lower is None else lower
    moved = 2.0 * (_finer(d, f, place, over, slope_below * initial.value) - place)
    interval = Interval(lower + min(moved, 0.0), upper + max(moved, 0.0))
    at = Estimate(place, interval.standard_error, len(d), interval)
    level = _force_at(d, f, at, over)
    return level if isinstance(level, Failure) else Onset(at, level)


@dataclass(frozen=True, slots=True, eq=False)
class _Tangent:
    """Slope (N/m) and level (N) at the middle of a stretch, and the ends of that (m)."""

    slope: Estimate
    level: Estimate
    start: float
    stop: float


def _known(displacement: Floats, force: Floats) -> tuple[Floats, Floats]:
    known = ~np.isnan(displacement) & ~np.isnan(force)
    return displacement[known], force[known]


def _around(d: Floats, place: float, over: float) -> slice:
    """Samples, in order of time, while the curve passes a stretch around a place."""
    reached = np.maximum.accumulate(d)
    ends = (place - 0.5 * over, place + 0.5 * over)
    first, last = np.searchsorted(reached, ends, side="left")
    return slice(int(first), int(last) + 1)


def _tangent_at(d: Floats, f: Floats, place: float, over: float) -> _Tangent | Failure:
    part = _around(d, place, over)
    x, y = (d[part] - place) / over, f[part]
    if len(x) < _LEAST:
        return Failure("too_few_samples", f"{len(x)} samples in the stretch, {_LEAST} are needed")
    if np.ptp(x) < 0.5:
        return Failure("no_travel", "the displacement jumps over the stretch")
    fit = fit_linear(np.vander(x, 3, increasing=True), y)
    slope = scaled(fit.estimate(1), 1.0 / over)
    return _Tangent(slope, fit.estimate(0), float(d[part].min()), float(d[part].max()))


def _share(slope: Estimate, initial: Estimate) -> Estimate:
    more = abs(slope.value) * initial.error / initial.value
    return scaled(slope, 1.0 / initial.value, more=more)


def _tangents(
    d: Floats, f: Floats, initial: Estimate, over: float, slope_below: float
) -> tuple[list[float], list[float], list[float], list[float]]:
    """Places from the end backwards, and tangents there: share, lower and upper end of it."""
    rows: list[tuple[float, float, float, float]] = []
    places = np.arange(float(d.max()) - 0.5 * over, float(d.min()) + 0.5 * over, -over / _STEPS)
    for place in places.tolist():
        tangent = _tangent_at(d, f, place, over)
        if isinstance(tangent, Failure):
            break
        share = _share(tangent.slope, initial)
        interval = share.interval or Interval.normal_95(share.value, share.error)
        rows.append((place, share.value, interval.lower, interval.upper))
        if interval.lower >= slope_below:
            break
    columns = [list(each) for each in zip(*rows, strict=True)]
    return columns[0], columns[1], columns[2], columns[3]


def _crossing(places: list[float], values: list[float], height: float) -> float | None:
    """First place at which values reach a height, straight between neighbours; None for none."""
    for number, value in enumerate(values):
        if value < height:
            continue
        if number == 0:
            return places[0]
        share = (height - values[number - 1]) / (value - values[number - 1])
        return places[number - 1] + share * (places[number] - places[number - 1])
    return None


def _finer(d: Floats, f: Floats, place: float, over: float, slope: float) -> float:
    """The onset next to a place by lines of half the length."""
    places = [place + over * share for share in np.linspace(0.5, -0.5, 2 * _STEPS + 1).tolist()]
    places = [each for each in places if each <= float(d.max()) - 0.25 * over]
    slopes = []
    for each in places:
        part = _around(d, each, 0.5 * over)
        slopes.append(float(np.polynomial.polynomial.polyfit(d[part] - each, f[part], 1)[1]))
    found = _crossing(places, slopes, slope)
    return place if found is None else found


def _force_at(d: Floats, f: Floats, at: Estimate, over: float) -> Estimate | Failure:
    """Force at a place that is itself uncertain, by half the line: a parabola cuts corners."""
    whole, tangent = (_tangent_at(d, f, at.value, each) for each in (over, 0.5 * over))
    if isinstance(whole, Failure):
        return whole
    if isinstance(tangent, Failure):
        return tangent
    # What half the line cuts off a corner is half of what the whole one does: their difference.
    cut = abs(tangent.level.value - whole.level.value) / np.sqrt(3.0)
    return widened(tangent.level, whole.slope.value * at.error, cut)
