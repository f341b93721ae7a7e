"""The end of a loading curve: its slope, and the onset of its plateau."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labpipe.fits.common_path import CommonPath, finite_samples
from labpipe.records.arrays import Flags, Floats, Ints
from labpipe.records.estimates import Failure

_TANGENTS_PER_LENGTH = 8
"""Tangents per length of a tangent."""
_MIN_TANGENT_SAMPLES = 8


@dataclass(frozen=True, slots=True, eq=False)
class Tangents:
    """Tangents of a loading curve from its end backwards, with samples chosen on one curve.

    Parameters
    ----------
    path : of the samples with both quantities, in order of time
    over : m, length of a tangent
    places : shape (p,), m, middles of the tangents, an eighth of `over` apart, from the end
        backwards
    rows : shape (p, k), 1/m, weights of the forces in each slope
    first : shape (k,), weights of the forces in the level of the first tangent in its middle
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
        """Choose the samples of the tangents of a curve.

        Parameters
        ----------
        displacement, force : shape (n,), m, N; one loading branch in order of time, evenly sampled;
            NaN are ignored
        over : m, length of a tangent

        Returns
        -------
        Tangents up to the first place without one, or a failure of the one at the end:
        ``not_reached`` (the curve is shorter than two of them), ``too_few_samples`` (8),
        ``no_travel``.

        Notes
        -----
        The slope of a tangent is that of a least-squares parabola in the middle of its stretch, so
        that the bend of the curve is not noise. A stretch contains the samples from when the curve
        first reached its start to when it first reached its end.
        """
        samples = finite_samples(displacement, force)
        d = displacement[samples]
        if not len(d) or np.ptp(d) < 2.0 * over:
            reached = 1e3 * float(np.ptp(d)) if len(d) else 0.0
            message = f"the branch is {reached:.4g} mm long, twice {1e3 * over:.4g} mm is needed"
            return Failure("not_reached", message)
        low, high = float(d.min()) + 0.5 * over, float(d.max()) - 0.5 * over
        stretches = _Stretches.of(d, np.arange(high, low, -over / _TANGENTS_PER_LENGTH), over)
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
        """Return the slope over the last stretch of each curve.

        Parameters
        ----------
        force : shape (..., n), N, with the samples of the reference curve
        displacement : shape (..., n), m; None for that of the reference curve

        Returns
        -------
        N/m, shape (...).
        """
        slope: Floats = self.path.force(force, displacement) @ self.rows[0]
        return slope

    def level_at(self, place: float, force: Floats) -> float:
        """Return the force of the tangent over the last stretch at a place, N.

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
        """Find the place beyond which tangents stay below a share of the initial slope.

        Parameters
        ----------
        force, displacement : as `slope_at_end` takes them
        initial : shape (...), N/m, slope at the start of each curve
        slope_below : share of `initial`

        Returns
        -------
        m, N, each of shape (...): from the end backwards, where the tangent first reaches the
        share, interpolated. NaN for a curve that is never so steep. The force is that of the
        parabola over half of `over` around the place: a parabola cuts a corner in proportion to its
        length.

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
        place = _first_place_with(self.places, f @ self.rows.T, share)
        levels = _levels(self.path.displacement, f, place, 0.5 * self.over)
        return place.reshape(shape), levels.reshape(shape)

    def corners(
        self,
        force: Floats,
        at: Floats | float,
        slope: Floats | float,
        displacement: Floats | None = None,
    ) -> tuple[Floats, Floats, Floats]:
        """Return the changes of an onset with tangents of half the length, for each curve.

        Parameters
        ----------
        force, displacement : as `slope_at_end` takes them
        at : shape (...), m, the onset
        slope : shape (...), N/m, of the tangent there

        Returns
        -------
        Each of shape (...): change of the place, m, and of the force there, N; and the slope half a
        tangent beyond the place, N/m. A tangent smears a corner over its length, which moves the
        onset; the parabola for the force cuts it.
        """
        f = self.path.force(force, displacement)
        shape, f = f.shape[:-1], f.reshape(-1, f.shape[-1])
        at, slope = (np.broadcast_to(values, shape).reshape(-1) for values in (at, slope))
        # One place for all curves: noise moves it by a small part of a tangent.
        d, half, middle = self.path.displacement, 0.5 * self.over, float(np.nanmean(at))
        near = middle + self.over * np.linspace(0.5, -0.5, 2 * _TANGENTS_PER_LENGTH + 1)
        is_inside = (near <= d.max() - 0.5 * half) & (near >= d.min() + 0.5 * half)
        stretches = _Stretches.of(d, near[is_inside], half)
        there = stretches.is_enough
        rows = stretches.spread(stretches.weights()[1])[there]
        reached = _first_place_with(stretches.at[there], f @ rows.T, slope)
        whole, short = (_levels_at(d, f, middle, over) for over in (self.over, half))
        places, slopes = self.places[::-1], (f @ self.rows.T)[:, ::-1]
        beyond = np.array([np.interp(middle + half, places, slope) for slope in slopes])
        moved = np.where(np.isnan(reached), 0.0, reached - at)
        return moved.reshape(shape), (short - whole).reshape(shape), beyond.reshape(shape)


def _first_place_with(places: Floats, slopes: Floats, wanted: Floats) -> Floats:
    """Return the first place (p,) at which slopes (R, p) reach wanted ones (R,), or NaN."""
    is_steep = slopes >= wanted[:, None]
    number, rows = np.argmax(is_steep, axis=1), np.arange(len(slopes))
    ahead = np.maximum(number - 1, 0)
    rise = slopes[rows, number] - slopes[rows, ahead]
    share = (wanted - slopes[rows, ahead]) / np.where(number > 0, rise, np.inf)
    place = places[ahead] + share * (places[number] - places[ahead])
    reached: Floats = np.where(is_steep[rows, number], place, np.nan)
    return reached


def _levels(d: Floats, f: Floats, places: Floats, over: float) -> Floats:
    """Return forces of curves (R, k) at places (R,), from parabolas around them."""
    is_finite = np.isfinite(places)
    levels = np.full(len(places), np.nan)
    if is_finite.any():
        stretches = _Stretches.of(d, places[is_finite], over)
        inside = np.minimum(stretches.samples, len(d) - 1)  # padding has zero weight
        weights, _ = stretches.weights()
        taken = np.take_along_axis(f[is_finite], inside, axis=1)
        level = np.einsum("rm,rm->r", weights, taken)
        levels[is_finite] = np.where(stretches.is_enough, level, np.nan)
    return levels


def _levels_at(d: Floats, f: Floats, place: float, over: float) -> Floats:
    """Return forces of curves (R, k) at one place, from a parabola around it."""
    stretch = _Stretches.of(d, np.array([place]), over)
    level, _ = stretch.weights()
    levels: Floats = f @ stretch.spread(level)[0]
    return levels


@dataclass(frozen=True, slots=True, eq=False)
class _Stretches:
    """Samples of a path around places, with powers of their distances.

    Parameters
    ----------
    at : shape (p,), m
    over : m
    samples : shape (p, m), padded with the number of all samples
    count : of all samples
    powers : shape (p, 3, m), of the distance from the place over `over`; 0 where padded
    products : shape (p, 3, 3), of the powers with one another
    is_enough : shape (p,), whether they determine a parabola
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
        edge_share = 1e-9  # a sample this close to an end counts as on it, despite rounding
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
        is_wide = (travel >= 0.5) & (np.linalg.det(products) > min_determinant * count**3)
        return cls(
            at, over, samples, len(d), powers, products, (count >= _MIN_TANGENT_SAMPLES) & is_wide
        )

    @property
    def failure(self) -> Failure | None:
        """Why the first of them have no parabola, or None."""
        if self.is_enough[0]:
            return None
        count = int(self.products[0, 0, 0])
        if count < _MIN_TANGENT_SAMPLES:
            return Failure(
                "too_few_samples",
                f"{count} samples in the stretch, {_MIN_TANGENT_SAMPLES} are needed",
            )
        return Failure("no_travel", "the displacement jumps over the stretch")

    def spread(self, weights: Floats) -> Floats:
        """Expand weights (p, m) of the samples of each stretch to all samples (p, k)."""
        columns = np.zeros((len(self.at), self.count + 1))
        np.put_along_axis(columns, self.samples, weights, axis=1)
        return columns[:, :-1]

    def weights(self) -> tuple[Floats, Floats]:
        """Return the weights of forces in level and slope of the parabolas, shapes (p, m)."""
        products = np.where(self.is_enough[:, None, None], self.products, np.eye(3))
        level, slope, _ = np.moveaxis(np.linalg.solve(products, self.powers), 1, 0)
        return level, slope / self.over
