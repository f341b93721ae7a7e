"""The end of a loading curve: how steep it still is, and from where on it is flat."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labpipe.fits.one_path import OnePath, known_samples
from labpipe.records.arrays import Flags, Floats, Ints
from labpipe.records.curve import Interval
from labpipe.records.estimates import Estimate, Failure, scaled, widened
from labpipe.uncertainty.linear_fits import fit_linear

_STEPS = 8
"""Tangents per length of the line that each of them is."""
_LEAST = 8
_TRAVEL = 0.5
"""Of a stretch, how much its samples must cover."""
_FLAT = 1e-9
"""Determinant of the products of 1, x, x^2 per sample, that of samples at two places but rounding;
that of evenly spaced ones is 5e-4."""


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
class Tangents:
    """Tangents of a loading curve from its end backwards, decided once on one curve.

    Parameters
    ----------
    path : of the samples that both quantities are known of, in order of time
    over : m, length of a tangent
    places : shape (p,), m, middles of the tangents, an eighth of `over` apart, the one over the
        last stretch first
    rows : shape (p, k), 1/m, each slope as a sum over the forces of the samples
    first : level of the first tangent in its middle as a sum over the forces, shape (k,)
    """

    path: OnePath
    over: float
    places: Floats
    rows: Floats
    first: Floats

    @classmethod
    def of(cls, displacement: Floats, force: Floats, *, over: float) -> Tangents | Failure:
        """Decide on the stretches of a curve that its tangents are read from.

        Parameters
        ----------
        displacement, force : shape (n,), m, N; one loading branch in order of time, evenly sampled;
            NaN in either are left out
        over : m, length of a tangent

        Returns
        -------
        Tangents up to the first place where there is none, or a failure of the one at the end:
        ``not_reached`` (the curve is shorter than two of them), ``too_few_samples`` (8),
        ``no_travel``.

        Notes
        -----
        The slope of a tangent is that of a least-squares parabola in the middle of its stretch, so
        that the bend of the curve is no noise. The samples of a stretch are those that were
        recorded from when the curve first reached its beginning to when it first was at its end.
        """
        samples = known_samples(displacement, force)
        d = displacement[samples]
        if not len(d) or np.ptp(d) < 2.0 * over:
            reached = 1e3 * float(np.ptp(d)) if len(d) else 0.0
            found = f"the branch is {reached:.4g} mm long, twice {1e3 * over:.4g} mm is needed"
            return Failure("not_reached", found)
        low, high = float(d.min()) + 0.5 * over, float(d.max()) - 0.5 * over
        stretches = _Stretches.of(d, np.arange(high, low, -over / _STEPS), over)
        if stretches.failure is not None:
            return stretches.failure
        there = slice(int(np.argmin([*stretches.is_enough, False])))
        columns = np.zeros((2, len(stretches.at[there]), len(d) + 1))
        for column, weights in zip(columns, stretches.weights(), strict=True):
            np.put_along_axis(column, stretches.samples[there], weights[there], axis=1)
        levels, slopes = columns[..., :-1]
        path = OnePath.of(displacement, force, samples)
        return cls(path, over, stretches.at[there], slopes, levels[0])

    def slope_at_end(self, force: Floats, displacement: Floats | None = None) -> Floats:
        """Slope over the last stretch, of each of many curves.

        Parameters
        ----------
        force : shape (..., n), N, with the samples that were decided on
        displacement : shape (..., n), m; None for the one that was decided on

        Returns
        -------
        N/m, shape (...).
        """
        slope: Floats = self.path.force(force, displacement) @ self.rows[0]
        return slope

    def level_at(self, place: float, force: Floats) -> float:
        """Force that the tangent over the last stretch has at a place, N.

        Parameters
        ----------
        place : m
        force : shape (n,), N
        """
        known = self.path.force(force)
        return float(known @ self.first + known @ self.rows[0] * (place - self.places[0]))

    def onset(
        self,
        force: Floats,
        initial: Floats,
        displacement: Floats | None = None,
        *,
        slope_below: float,
    ) -> tuple[Floats, Floats]:
        """Place from which on tangents stay below a share of the initial slope, and force there.

        Parameters
        ----------
        force, displacement : as `slope_at_end` takes them
        initial : shape (...), N/m, slope at the start of each curve
        slope_below : share of `initial`

        Returns
        -------
        m, N, each of shape (...): from the end backwards, where the tangent first reaches the
        share, straight between neighbours. NaN for a curve that is nowhere so steep. The force is
        that of the parabola over half of `over` around the place: a parabola cuts a corner by as
        much as it is long.
        """
        f = self.path.force(force, displacement)
        shape, f = f.shape[:-1], f.reshape(-1, f.shape[-1])
        place = self._reached(f, slope_below * np.broadcast_to(initial, shape).reshape(-1))
        levels = _levels(self.path.displacement, f, place, 0.5 * self.over)
        return place.reshape(shape), levels.reshape(shape)

    def _reached(self, f: Floats, slope: Floats) -> Floats:
        """Where the tangents of curves (R, k) reach slopes (R,), from the end backwards."""
        slopes = f @ self.rows.T
        is_steep = slopes >= slope[:, None]
        number = np.argmax(is_steep, axis=1)
        ahead, each = np.maximum(number - 1, 0), np.arange(len(f))
        rise = slopes[each, number] - slopes[each, ahead]
        share = (slope - slopes[each, ahead]) / np.where(number > 0, rise, np.inf)
        place = self.places[ahead] + share * (self.places[number] - self.places[ahead])
        found: Floats = np.where(is_steep[each, number], place, np.nan)
        return found


def cut_corners(
    displacement: Floats, force: Floats, at: float, slope: float, *, over: float
) -> tuple[float, float]:
    """What half the length of the tangents changes about an onset.

    Parameters
    ----------
    displacement, force : shape (n,), m, N, of the loading branch
    at : m, the onset
    slope : N/m, that the tangent has there
    over : m

    Returns
    -------
    Change of the place, m, and of the force, N. A tangent smears a corner over its length, which
    moves the onset; the parabola that the force is read from cuts it.
    """
    samples = known_samples(displacement, force)
    d, f = displacement[samples], force[samples]
    place = np.array([at])
    levels = [float(_levels(d, f[None], place, each)[0]) for each in (0.5 * over, over)]
    return _finer(d, f, at, over, slope) - at, levels[0] - levels[1]


def _levels(d: Floats, f: Floats, places: Floats, over: float) -> Floats:
    """Forces of curves (R, k) at a place of each (R,) by the parabola over a stretch around it."""
    known = np.isfinite(places)
    levels = np.full(len(places), np.nan)
    if known.any():
        stretches = _Stretches.of(d, places[known], over)
        inside = np.minimum(stretches.samples, len(d) - 1)  # the weight of what is padded is zero
        weights, _ = stretches.weights()
        taken = np.take_along_axis(f[known], inside, axis=1)
        found = np.einsum("rm,rm->r", weights, taken)
        levels[known] = np.where(stretches.is_enough, found, np.nan)
    return levels


@dataclass(frozen=True, slots=True, eq=False)
class _Stretches:
    """Samples of a path around places, and the powers of their distances from these.

    Parameters
    ----------
    at : shape (p,), m
    over : m
    samples : shape (p, m), padded with the number of all samples
    powers : shape (p, 3, m), of the distance from the place over `over`; 0 where padded
    products : shape (p, 3, 3), of the powers with one another
    is_enough : shape (p,), whether a parabola can be laid through them
    """

    at: Floats
    over: float
    samples: Ints
    powers: Floats
    products: Floats
    is_enough: Flags

    @classmethod
    def of(cls, d: Floats, at: Floats, over: float) -> _Stretches:
        reached = np.maximum.accumulate(d)
        start = np.searchsorted(reached, at - 0.5 * over)
        stop = np.minimum(np.searchsorted(reached, at + 0.5 * over) + 1, len(d))
        samples = start[:, None] + np.arange(int((stop - start).max()))
        is_inside = samples < stop[:, None]
        samples = np.where(is_inside, samples, len(d))
        x = np.where(is_inside, (np.append(d, 0.0)[samples] - at[:, None]) / over, 0.0)
        travel = np.ptp(np.where(is_inside, x, x[:, :1]), axis=1)
        powers = np.stack([is_inside * x**power for power in range(3)], axis=1)
        products = powers @ powers.transpose(0, 2, 1)
        count = products[:, 0, 0]
        is_wide = (travel >= _TRAVEL) & (np.linalg.det(products) > _FLAT * count**3)
        return cls(at, over, samples, powers, products, (count >= _LEAST) & is_wide)

    @property
    def failure(self) -> Failure | None:
        """Why no parabola can be laid through the first of them."""
        if self.is_enough[0]:
            return None
        count = int(self.products[0, 0, 0])
        if count < _LEAST:
            return Failure(
                "too_few_samples", f"{count} samples in the stretch, {_LEAST} are needed"
            )
        return Failure("no_travel", "the displacement jumps over the stretch")

    def weights(self) -> tuple[Floats, Floats]:
        """Level and slope of the parabola at each place as sums over forces, shapes (p, m)."""
        products = np.where(self.is_enough[:, None, None], self.products, np.eye(3))
        level, slope, _ = np.moveaxis(np.linalg.solve(products, self.powers), 1, 0)
        return level, slope / self.over


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
