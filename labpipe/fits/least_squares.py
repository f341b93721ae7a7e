"""Straight lines and polynomials by least squares, of as many curves as there are at once."""

from __future__ import annotations

import numpy as np

from labpipe.records.arrays import Flags, Floats, ratio


def slope_of_line(x: Floats, y: Floats) -> Floats:
    """Slope of a straight line by least squares, or of as many as there are rows.

    Parameters
    ----------
    x, y : shape (..., n), without NaN; either may be shape (n,), the same for all rows

    Returns
    -------
    Shape (...): sum (x - mean x) y / sum (x - mean x)^2; NaN where `x` does not change.

    Examples
    --------
    >>> slope_of_line(np.array([0.0, 1.0, 2.0]), np.array([[1.0, 2.0, 6.0], [5.0, 5.0, 5.0]]))
    array([2.5, 0. ])
    """
    lever = x - x.mean(axis=-1, keepdims=True)
    return ratio(np.vecdot(lever, y), np.vecdot(lever, lever))


def zero_of_line(x: Floats, y: Floats) -> Floats:
    """Where a straight line by least squares that rises is zero, or as many as there are rows.

    Parameters
    ----------
    x, y : shape (..., n), without NaN

    Returns
    -------
    Shape (...), in the unit of `x`; NaN where the line does not rise.

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
    """Straight line by least squares through chosen samples of each row.

    Parameters
    ----------
    chosen : shape (rows, n)
    x, y : shape (rows, n) or (n,); NaN where nothing is chosen

    Returns
    -------
    Shapes (rows,): mean of `x`, value of the line there, its slope; NaN where there is none.
    """
    count = chosen.sum(axis=1)
    x, y = (np.where(chosen, values, 0.0) for values in (x, y))
    middle, level = (ratio(values.sum(axis=1), count) for values in (x, y))
    lever = np.where(chosen, x - middle[:, np.newaxis], 0.0)
    return middle, level, ratio(np.vecdot(lever, y), np.vecdot(lever, x))


def polynomial_weights(x: Floats, *, degree: int) -> Floats:
    """Weights with which values enter the polynomial through them by least squares.

    Parameters
    ----------
    x : shape (n,), where the values are; near zero, as powers of it are taken
    degree : of the polynomial

    Returns
    -------
    Shape (degree + 1, n): times the values, shape (..., n), they make the coefficient of each
    power of `x`, the constant first.

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
