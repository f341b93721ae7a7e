"""Least-squares lines and polynomials of many curves at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labpipe.records.arrays import Flags, Floats, Ints, divide
from labpipe.records.estimates import UnavailableError


def require_samples(count: int, needed: int, where: str = " in the stretch") -> None:
    """Raise ``too_few_samples`` if there are fewer samples than needed."""
    if count < needed:
        raise UnavailableError.of(
            "results.too_few_samples", count=count, where=where, needed=needed
        )


def require_travel(values: Floats, quantity: str = "displacement") -> None:
    """Raise ``no_travel`` if a quantity is constant."""
    if np.ptp(values) == 0.0:
        raise UnavailableError.of("results.no_travel", quantity=quantity)


def compute_slope(x: Floats, y: Floats) -> Floats:
    """Return the slope of the least-squares line of each row.

    Parameters
    ----------
    x, y : shape (..., n), without NaN; either may be shape (n,), the same for all rows

    Returns
    -------
    Shape (...): sum (x - mean x) y / sum (x - mean x)^2; NaN if `x` is constant.

    Examples
    --------
    >>> compute_slope(np.array([0.0, 1.0, 2.0]), np.array([[1.0, 2.0, 6.0], [5.0, 5.0, 5.0]]))
    array([2.5, 0. ])
    """
    lever = x - x.mean(axis=-1, keepdims=True)
    return divide(np.vecdot(lever, y), np.vecdot(lever, lever))


def compute_zero_crossing(x: Floats, y: Floats) -> Floats:
    """Return the zero of the rising least-squares line of each row.

    Parameters
    ----------
    x, y : shape (..., n), without NaN

    Returns
    -------
    Shape (...), in the unit of `x`; NaN if the line does not rise.

    Examples
    --------
    >>> rows = np.array([[1.0, 2.0, 3.0], [3.0, 2.0, 1.0]])
    >>> compute_zero_crossing(np.array([5.0, 6.0, 7.0]), rows)
    array([ 4., nan])
    """
    slope = compute_slope(x, y)
    slope = np.where(slope > 0.0, slope, np.nan)
    zero: Floats = x.mean(axis=-1) - y.mean(axis=-1) / slope
    return zero


def fit_chosen_lines(chosen: Flags, x: Floats, y: Floats) -> tuple[Floats, Floats, Floats]:
    """Fit the least-squares line through chosen samples of each row.

    Parameters
    ----------
    chosen : shape (rows, n)
    x, y : shape (rows, n) or (n,); NaN only where not chosen

    Returns
    -------
    Shapes (rows,): mean of `x`, value of the line there, its slope; NaN without a line.
    """
    count = chosen.sum(axis=1)
    x, y = (np.where(chosen, values, 0.0) for values in (x, y))
    middle, level = (divide(values.sum(axis=1), count) for values in (x, y))
    lever = np.where(chosen, x - middle[:, np.newaxis], 0.0)
    spread, rounding = np.vecdot(lever, x), 4.0 * np.finfo(float).eps * count * middle**2
    return middle, level, divide(np.vecdot(lever, y), np.where(spread > rounding, spread, 0.0))


def compute_polynomial_weights(x: Floats, *, degree: int) -> Floats:
    """Return the weights of values in their least-squares polynomial.

    Parameters
    ----------
    x : shape (n,), positions of the values, best near zero
    degree : of the polynomial

    Returns
    -------
    Shape (degree + 1, n): their products with the values, shape (..., n), are the coefficients, the
    constant first.

    Examples
    --------
    >>> weights = compute_polynomial_weights(np.arange(4.0), degree=2)
    >>> (weights @ np.array([5.0, 6.0, 9.0, 14.0])).round(12).tolist()
    [5.0, 0.0, 1.0]
    """
    scale = float(np.abs(x).max()) or 1.0
    powers = np.arange(degree + 1.0)[:, np.newaxis]
    weights: Floats = np.linalg.pinv((x / scale) ** powers).T / scale**powers
    return weights


@dataclass(frozen=True, slots=True, eq=False)
class CommonPath:
    """Displacements of a reference curve, at which the forces of other curves are compared.

    Parameters
    ----------
    samples : shape (k,), samples of a curve; None for all in order
    displacement : shape (k,), m
    slope : shape (k,), N/m
    """

    samples: Ints | None
    displacement: Floats
    slope: Floats

    @classmethod
    def of(cls, displacement: Floats, force: Floats, samples: Ints) -> CommonPath:
        """Compute slopes of a curve over a fiftieth of its samples on each side.

        Parameters
        ----------
        displacement, force : shape (n,), m, N; a stretch of a loading branch in order of time
        samples : shape (k,), samples with both quantities, in any order

        Notes
        -----
        If the displacement does not increase there, the slope is that from the first to the last
        sample.
        """
        in_time = np.argsort(samples)
        d, f = displacement[samples[in_time]], force[samples[in_time]]
        last = len(d) - 1
        rows, reach = np.arange(last + 1), max(1, last // 50)
        low, high = np.maximum(rows - reach, 0), np.minimum(rows + reach, last)
        run, rise, stroke = d[high] - d[low], f[high] - f[low], d[-1] - d[0]
        overall = (f[-1] - f[0]) / stroke if stroke > 0.0 else 0.0
        slope = np.empty(last + 1)
        slope[in_time] = np.where(run > 0.0, rise / np.where(run > 0.0, run, 1.0), overall)
        is_all = np.array_equal(samples, np.arange(len(force)))
        return cls(None if is_all else samples, displacement[samples], slope)

    def move_force(self, force: Floats, displacement: Floats | None = None) -> Floats:
        """Move forces of curves to the displacements of the reference curve.

        Parameters
        ----------
        force : shape (..., n), N, of curves with the samples of the reference curve
        displacement : shape (..., n), m; None for that of the reference curve

        Returns
        -------
        f - (df/dd) (d - d_0), shape (..., k), N: to first order, the force of a curve sampled at
        other displacements. With a displacement from cameras, noise gives each replicate its own
        displacements; a function that is linear in the force at fixed displacements then applies to
        all of them. Second order is neglected: noise of the displacement makes a least-squares
        slope smaller, by its variance over that of the displacements.
        """
        on_path = self._take_samples(force)
        if displacement is None:
            return on_path
        moved = self._take_samples(displacement) - self.displacement
        return on_path - self.slope * moved if moved.any() else on_path

    def _take_samples(self, values: Floats) -> Floats:
        if self.samples is None:
            return values
        selected: Floats = np.take(values, self.samples, axis=-1)
        return selected


def find_finite_samples(displacement: Floats, force: Floats) -> Ints:
    """Return the samples with both quantities, in order of time.

    Parameters
    ----------
    displacement, force : shape (n,), NaN where unknown
    """
    return np.flatnonzero(~np.isnan(displacement) & ~np.isnan(force))
