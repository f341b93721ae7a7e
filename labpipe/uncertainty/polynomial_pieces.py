"""Fit a few polynomials to a short record, to estimate its noise.

A record of fewer than about 150 samples does not show the correlation time of its noise, and a
corner in it is as large as its noise. Up to three polynomials follow the corners.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import product
from typing import NamedTuple

import numpy as np

from labpipe.records.arrays import Floats


class Piece(NamedTuple):
    """Samples of a record that one polynomial follows, and its degree."""

    start: int
    stop: int
    degree: int


def polynomial_pieces(values: Floats) -> tuple[Piece, ...]:
    """Cut a short record into at most three pieces for polynomials.

    Parameters
    ----------
    values : shape (n,), evenly sampled, without NaN; n at least 4

    Returns
    -------
    Pieces in order, each of degree 1 to 3. Their number, ends and degrees have the lowest corrected
    information criterion of Schwarz, ln(RSS / n) + k ln(n) / (n - k - 2), with k coefficients and
    cuts (McQuarrie, Stat. Probab. Lett. 44 (1999) 79).

    Examples
    --------
    >>> knee = np.minimum(np.arange(40.0), 20.0)
    >>> noise = np.random.default_rng(1).normal(0.0, 0.1, 40)
    >>> [piece.degree for piece in polynomial_pieces(knee + noise)]
    [1, 1]
    """
    allowed_degrees = (1, 2, 3)
    max_pieces = 3
    count = len(values)
    squares = {degree: _sums_of_squares(values, degree) for degree in allowed_degrees}
    rounding = count * (1e-9 * float(np.ptp(values))) ** 2
    best: tuple[Piece, ...] = (Piece(0, count, 1),)
    lowest = np.inf
    for number in range(1, max_pieces + 1):
        for degrees in product(allowed_degrees, repeat=number):
            spent = sum(degrees) + 2 * number - 1
            if count - spent - 2 <= 0:
                continue
            squares_sum, ends = _best_cuts([squares[degree] for degree in degrees], count)
            penalty = spent * np.log(count) / (count - spent - 2)
            criterion = np.log(max(squares_sum, rounding, np.finfo(float).tiny) / count) + penalty
            if criterion < lowest:
                lowest = criterion
                best = tuple(map(Piece, (0, *ends), (*ends, count), degrees))
    return best


def _best_cuts(squares: list[Floats], count: int) -> tuple[float, tuple[int, ...]]:
    """Return the smallest sum of squares for given degrees, and the cuts."""
    until = squares[0][0]
    cuts = list[Floats]()
    for piece in squares[1:]:
        total = until[:, None] + piece
        cuts.append(np.argmin(total, axis=0))
        until = np.min(total, axis=0)
    end, ends = count, list[int]()
    for cut in reversed(cuts):
        end = int(cut[end])
        ends.insert(0, end)
    return float(until[count]), tuple(ends)


def _sums_of_squares(values: Floats, degree: int) -> Floats:
    """Return residual sums of squares of samples [i, j), shape (n + 1, n + 1); inf if too few."""
    count = len(values)
    sums = np.full((count + 1, count + 1), np.inf)
    for length in range(degree + 1, count + 1):
        windows = np.lib.stride_tricks.sliding_window_view(values, length)
        windows = windows - windows.mean(axis=1, keepdims=True)
        explained = windows @ _slopes(length, degree)
        first = np.arange(count - length + 1)
        residual_squares = np.sum(windows**2, axis=1) - np.sum(explained**2, axis=1)
        sums[first, first + length] = np.maximum(residual_squares, 0.0)
    return sums


@lru_cache(maxsize=512)
def _slopes(count: int, degree: int) -> Floats:
    """Return orthonormal polynomials without the constant, shape (count, degree)."""
    places = np.linspace(-1.0, 1.0, count)
    return np.linalg.qr(np.vander(places, degree + 1, increasing=True))[0][:, 1:]
