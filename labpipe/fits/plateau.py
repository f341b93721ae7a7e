"""The end of a loading curve: how steep it still is, and from where on it is flat."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labpipe.fits.common_path import CommonPath, known_samples
from labpipe.records.arrays import Flags, Floats, Ints
from labpipe.records.estimates import Failure

_STEPS = 8
"""Tangents per length of the line that each of them is."""
_LEAST = 8


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
    first : shape (k,), level of the first tangent in its middle as a sum over the forces
    last : shape (m,), numbers of the samples of the first tangent
    """

    path: CommonPath
    over: float
    places: Floats
    rows: Floats
    first: Floats
    last: Ints

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
            message = f"the branch is {reached:.4g} mm long, twice {1e3 * over:.4g} mm is needed"
            return Failure("not_reached", message)
        low, high = float(d.min()) + 0.5 * over, float(d.max()) - 0.5 * over
        stretches = _Stretches.of(d, np.arange(high, low, -over / _STEPS), over)
        if stretches.failure is not None:
            return stretches.failure
        there = slice(int(np.argmin([*stretches.is_enough, False])))
        levels, slopes = (stretches.spread(weight)[there] for weight in stretches.weights())
        path = CommonPath.of(displacement, force, samples)
        last = stretches.samples[0][stretches.samples[0] < len(d)]
        return cls(path, over, stretches.at[there], slopes, levels[0], last)

    @property
    def ends(self) -> tuple[float, float]:
        """Smallest and largest displacement over the last stretch, m."""
        d = self.path.displacement[self.last]
        return float(d.min()), float(d.max())

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
        path_force = self.path.force(force)
        return float(path_force @ self.first + path_force @ self.rows[0] * (place - self.places[0]))

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

        Examples
        --------
        >>> d = np.linspace(0.0, 0.05, 501)
        >>> f = np.where(d < 0.03, 400.0 * d - 6500.0 * d**2, 6.15)
        >>> tangents = Tangents.of(d, f, over=2e-3)
        >>> place, force = tangents.onset(f, np.array(400.0), slope_below=0.1)
        >>> round(1e3 * float(place), 1), round(float(force), 2)
        (27.7, 6.09)
        """
        f = self.path.force(force, displacement)
        shape, f = f.shape[:-1], f.reshape(-1, f.shape[-1])
        share = slope_below * np.broadcast_to(initial, shape).reshape(-1)
        place = _reached(self.places, f @ self.rows.T, share)
        levels = _levels(self.path.displacement, f, place, 0.5 * self.over)
        return place.reshape(shape), levels.reshape(shape)

    def corners(
        self,
        force: Floats,
        at: Floats | float,
        slope: Floats | float,
        displacement: Floats | None = None,
    ) -> tuple[Floats, Floats, Floats]:
        """What tangents of half the length change about an onset, of each of many curves.

        Parameters
        ----------
        force, displacement : as `slope_at_end` takes them
        at : shape (...), m, the onset
        slope : shape (...), N/m, that the tangent has there

        Returns
        -------
        Each of shape (...): change of the place, m, and of the force there, N; and the slope beyond
        the place, N/m, half a tangent on. A tangent smears a corner over its length, which moves
        the onset; the parabola that the force is read from cuts it.
        """
        f = self.path.force(force, displacement)
        shape, f = f.shape[:-1], f.reshape(-1, f.shape[-1])
        at, slope = (np.broadcast_to(values, shape).reshape(-1) for values in (at, slope))
        # All curves are looked at about one place: noise moves it by little of a tangent.
        d, half, middle = self.path.displacement, 0.5 * self.over, float(np.nanmean(at))
        near = middle + self.over * np.linspace(0.5, -0.5, 2 * _STEPS + 1)
        is_inside = (near <= d.max() - 0.5 * half) & (near >= d.min() + 0.5 * half)
        stretches = _Stretches.of(d, near[is_inside], half)
        there = stretches.is_enough
        rows = stretches.spread(stretches.weights()[1])[there]
        reached = _reached(stretches.at[there], f @ rows.T, slope)
        whole, short = (_levels_at(d, f, middle, over) for over in (self.over, half))
        places, slopes = self.places[::-1], (f @ self.rows.T)[:, ::-1]
        beyond = np.array([np.interp(middle + half, places, slope) for slope in slopes])
        moved = np.where(np.isnan(reached), 0.0, reached - at)
        return moved.reshape(shape), (short - whole).reshape(shape), beyond.reshape(shape)


def _reached(places: Floats, slopes: Floats, wanted: Floats) -> Floats:
    """First of the places (p,) at which slopes (R, p) reach those wanted (R,); NaN for nowhere."""
    is_steep = slopes >= wanted[:, None]
    number, rows = np.argmax(is_steep, axis=1), np.arange(len(slopes))
    ahead = np.maximum(number - 1, 0)
    rise = slopes[rows, number] - slopes[rows, ahead]
    share = (wanted - slopes[rows, ahead]) / np.where(number > 0, rise, np.inf)
    place = places[ahead] + share * (places[number] - places[ahead])
    reached: Floats = np.where(is_steep[rows, number], place, np.nan)
    return reached


def _levels(d: Floats, f: Floats, places: Floats, over: float) -> Floats:
    """Forces of curves (R, k) at a place of each (R,) by the parabola over a stretch around it."""
    is_finite = np.isfinite(places)
    levels = np.full(len(places), np.nan)
    if is_finite.any():
        stretches = _Stretches.of(d, places[is_finite], over)
        inside = np.minimum(stretches.samples, len(d) - 1)  # the weight of what is padded is zero
        weights, _ = stretches.weights()
        taken = np.take_along_axis(f[is_finite], inside, axis=1)
        level = np.einsum("rm,rm->r", weights, taken)
        levels[is_finite] = np.where(stretches.is_enough, level, np.nan)
    return levels


def _levels_at(d: Floats, f: Floats, place: float, over: float) -> Floats:
    """Forces of curves (R, k) at one place by the parabola over a stretch around it."""
    stretch = _Stretches.of(d, np.array([place]), over)
    level, _ = stretch.weights()
    levels: Floats = f @ stretch.spread(level)[0]
    return levels


@dataclass(frozen=True, slots=True, eq=False)
class _Stretches:
    """Samples of a path around places, and the powers of their distances from these.

    Parameters
    ----------
    at : shape (p,), m
    over : m
    samples : shape (p, m), padded with the number of all samples
    count : of all samples
    powers : shape (p, 3, m), of the distance from the place over `over`; 0 where padded
    products : shape (p, 3, 3), of the powers with one another
    is_enough : shape (p,), whether a parabola can be laid through them
    """

    at: Floats
    over: float
    samples: Ints
    count: int
    powers: Floats
    products: Floats
    is_enough: Flags

    @classmethod
    def of(cls, d: Floats, at: Floats, over: float) -> _Stretches:
        # The samples must cover this share of a stretch.
        min_covered_share = 0.5
        # A sample this close to an end counts as on it, whichever way a processor rounds.
        edge_share = 1e-9
        # Of the products of 1, x, x^2 per sample: rounding for samples at two places; 5e-4 for
        # evenly spaced samples.
        min_determinant = 1e-9
        reached = np.maximum.accumulate(d)
        begin, end = at - (0.5 + edge_share) * over, at + (0.5 - edge_share) * over
        start = np.searchsorted(reached, begin)
        stop = np.minimum(np.searchsorted(reached, end) + 1, len(d))
        samples = start[:, None] + np.arange(int((stop - start).max()))
        is_inside = samples < stop[:, None]
        samples = np.where(is_inside, samples, len(d))
        x = np.where(is_inside, (np.append(d, 0.0)[samples] - at[:, None]) / over, 0.0)
        travel = np.ptp(np.where(is_inside, x, x[:, :1]), axis=1)
        powers = np.stack([is_inside * x**power for power in range(3)], axis=1)
        products = powers @ powers.transpose(0, 2, 1)
        count = products[:, 0, 0]
        is_wide = (travel >= min_covered_share) & (
            np.linalg.det(products) > min_determinant * count**3
        )
        return cls(at, over, samples, len(d), powers, products, (count >= _LEAST) & is_wide)

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

    def spread(self, weights: Floats) -> Floats:
        """Weights (p, m) of the samples of each stretch as weights of all samples (p, k)."""
        count = self.count
        columns = np.zeros((len(self.at), count + 1))
        np.put_along_axis(columns, self.samples, weights, axis=1)
        return columns[:, :-1]

    def weights(self) -> tuple[Floats, Floats]:
        """Level and slope of the parabola at each place as sums over forces, shapes (p, m)."""
        products = np.where(self.is_enough[:, None, None], self.products, np.eye(3))
        level, slope, _ = np.moveaxis(np.linalg.solve(products, self.powers), 1, 0)
        return level, slope / self.over
