"""Least-squares lines and polynomials of many curves at once."""

from __future__ import annotations

import numpy as np

from labpipe.records.arrays import Flags, Floats, ratio


def slope_of_line(x: Floats, y: Floats) -> Floats:
    """Return the slope of the least-squares line of each row.

    Parameters
    ----------
    x, y : shape (..., n), without NaN; either may be shape (n,), the same for all rows

    Returns
    -------
    Shape (...): sum (x - mean x) y / sum (x - mean x)^2; NaN if `x` is constant.

    Examples
    --------
    >>> slope_of_line(np.array([0.0, 1.0, 2.0]), np.array([[1.0, 2.0, 6.0], [5.0, 5.0, 5.0]]))
    array([2.5, 0. ])
    """
    lever = x - x.mean(axis=-1, keepdims=True)
    return ratio(np.vecdot(lever, y), np.vecdot(lever, lever))


def zero_of_line(x: Floats, y: Floats) -> Floats:
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
    >>> zero_of_line(np.array([5.0, 6.0, 7.0]), rows)
    array([ 4., nan])
    """
    slope = slope_of_line(x, y)
    slope = np.where(slope > 0.0, slope, np.nan)
    zero: Floats = x.mean(axis=-1) - y.mean(axis=-1) / slope
    return zero


def line_in(chosen: Flags, x: Floats, y: Floats) -> tuple[Floats, Floats, Floats]:
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
    middle, level = (ratio(values.sum(axis=1), count) for values in (x, y))
    lever = np.where(chosen, x - middle[:, np.newaxis], 0.0)
    return middle, level, ratio(np.vecdot(lever, y), np.vecdot(lever, x))


def polynomial_weights(x: Floats, *, degree: int) -> Floats:
    """Return the weights of values in their least-squares polynomial.

    Parameters
    ----------
    x : shape (n,), places of the values; near zero, for its powers
    degree : of the polynomial

    Returns
    -------
    Shape (degree + 1, n): their products with the values, shape (..., n), are the coefficients, the
    constant first.

    Examples
    --------
    >>> weights = polynomial_weights(np.arange(4.0), degree=2)
    >>> (weights @ np.array([5.0, 6.0, 9.0, 14.0])).round(12).tolist()
    [5.0, 0.0, 1.0]
    """
    scale = float(np.abs(x).max()) or 1.0
    powers = np.arange(degree + 1.0)[:, np.newaxis]
    weights: Floats = np.linalg.pinv((x / scale) ** powers).T / scale**powers
    return weights
