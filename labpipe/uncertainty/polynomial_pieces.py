"""Fit a few polynomials to a short record, to estimate its noise.

A record of fewer than about 150 samples does not show the correlation time of its noise, and a
corner in it is as large as its noise. Up to three polynomials follow the corners.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from itertools import product
from typing import NamedTuple

import numpy as np

from labpipe.records.arrays import Floats, Ints


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
    cuts (McQuarrie, Stat. Probab. Lett. 44 (1999) 79), in white noise or from 40 samples on in
    noise of one of four correlations, which counts as a coefficient: else pieces follow slow noise.

    Examples
    --------
    >>> knee = np.minimum(np.arange(40.0), 20.0)
    >>> noise = np.random.default_rng(1).normal(0.0, 0.1, 40)
    >>> [piece.degree for piece in polynomial_pieces(knee + noise)]
    [1, 1]
    """
    return _cached_pieces(np.ascontiguousarray(values, dtype=np.float64).tobytes())


@lru_cache(maxsize=64)
def _cached_pieces(record: bytes) -> tuple[Piece, ...]:
    """Return the pieces of a record, which its noise and its smooth curve both ask for."""
    # Correlations of neighbouring samples of the noise, up to a correlation time of six samples.
    correlations: tuple[float, ...] = (0.0, 0.3, 0.5, 0.7, 0.85)
    # Fewer samples do not distinguish correlated noise from a bend of the curve.
    min_correlation_samples = 40
    values = np.frombuffer(record)
    count = len(values)
    if count < min_correlation_samples:
        correlations = correlations[:1]
    rounding = count * (1e-9 * float(np.ptp(values))) ** 2
    best: tuple[Piece, ...] = (Piece(0, count, 1),)
    lowest = np.inf
    for correlation in correlations:
        # What is left of a polynomial is one of the same degree.
        rest = values[1:] - correlation * values[:-1] if correlation else values
        skipped = count - len(rest)
        for degrees, left, ends in _best_cuts(_sums_of_squares(rest)):
            spent = sum(degrees) + 2 * len(degrees) - 1 + skipped
            if count - spent - 2 <= 0:
                continue
            penalty = spent * np.log(count) / (count - spent - 2)
            least = max(left, rounding, np.finfo(float).tiny)
            criterion = np.log(least / len(rest)) + penalty
            if criterion < lowest:
                lowest = criterion
                cuts = [skipped + end for end in ends]
                best = tuple(map(Piece, (0, *cuts), (*cuts, count), degrees))
    return best


def _best_cuts(squares: Floats) -> Iterator[tuple[tuple[int, ...], float, tuple[int, ...]]]:
    """Yield degrees of up to three pieces, the smallest sum of squares for them, and their cuts.

    squares : shape (degrees, n + 1, n + 1), of samples [i, j)
    """
    max_pieces = 3
    allowed = range(len(squares))
    until, cuts = squares[:, 0], list[Ints]()
    for number in range(1, max_pieces + 1):
        for places in product(allowed, repeat=number):
            ends = list[int]()
            end = squares.shape[-1] - 1
            for depth in range(number - 1, 0, -1):
                end = int(cuts[depth - 1][places[: depth + 1]][end])
                ends.insert(0, end)
            yield tuple(place + 1 for place in places), float(until[places][-1]), tuple(ends)
        if number < max_pieces:
            total = until[..., None, :, None] + squares
            cuts.append(np.argmin(total, axis=-2))
            until = np.min(total, axis=-2)


def _sums_of_squares(values: Floats) -> Floats:
    """Return residual sums of squares of samples [i, j) about polynomials of degree 1 to 3.

    Shape (3, n + 1, n + 1); inf for too few samples.
    """
    max_degree = 3
    count = len(values)
    sums = np.full((max_degree, count + 1, count + 1), np.inf)
    for length in range(2, count + 1):
        windows = np.lib.stride_tricks.sliding_window_view(values, length)
        windows = windows - windows.mean(axis=1, keepdims=True)
        degree = min(length - 1, max_degree)
        explained = np.cumsum((windows @ _slopes(length, degree)) ** 2, axis=1)
        first = np.arange(count - length + 1)
        left = np.sum(windows**2, axis=1)[:, None] - explained
        sums[:degree, first, first + length] = np.maximum(left, 0.0).T
    return sums


@lru_cache(maxsize=512)
def _slopes(count: int, degree: int) -> Floats:
    """Return orthonormal polynomials without the constant, shape (count, degree)."""
    places = np.linspace(-1.0, 1.0, count)
    return np.linalg.qr(np.vander(places, degree + 1, increasing=True))[0][:, 1:]
