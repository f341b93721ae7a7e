"""The slowest cosines of a record.

scipy has the whole transform, but importing it takes longer than all fits of a test, and of a long
record only the first few of its numbers are wanted here.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil, factorial, pi

import numpy as np

from labpipe.records.arrays import Floats

_ORDER = 16
"""Powers of a phase of half a radian, beyond which its sine and cosine are exact."""
_LONG = 32
"""How many times as many samples as blocks make a record long."""


def slowest_cosines(rows: Sequence[Floats], terms: int) -> Floats:
    """Coefficients of the slowest cosines of a discrete cosine transform.

    Parameters
    ----------
    rows : p records of shape (n,), without NaN
    terms : number of cosines, at most n; the first one is constant

    Returns
    -------
    shape (p, terms), the first columns of the orthonormal transform of type 2: those of
    ``scipy.fft.dct(rows, norm="ortho")`` but for rounding.

    Notes
    -----
    From a real Fourier transform of the same length (Makhoul, IEEE Trans. Acoust. Speech Signal
    Process. 28 (1980) 27). Long records are cut into blocks so short that the phase of the quickest
    cosine stays within half a radian of that in the middle; there each cosine is its power series,
    and of each block only its first moments are needed: O(n) for any n, where the Fourier transform
    takes some times as long, and many times where n is a large prime.

    Examples
    --------
    >>> slowest_cosines(np.full((1, 4), 3.0), 2).round(12)
    array([[6., 0.]])
    """
    count = len(rows[0])
    blocks = ceil(pi * terms)
    is_long = count > _LONG * blocks
    waves = _by_blocks(rows, terms, blocks) if is_long else _by_fourier(rows, terms)
    waves *= np.sqrt(2.0 / count)
    waves[:, 0] *= np.sqrt(0.5)
    return waves


def _by_fourier(rows: Sequence[Floats], terms: int) -> Floats:
    count = len(rows[0])
    folded = [np.concatenate([row[::2], row[1::2][::-1]]) for row in rows]
    spectrum = np.fft.rfft(folded, axis=1)[:, :terms]
    known = spectrum.shape[1]
    turned = spectrum * np.exp(-0.5j * np.pi / count * np.arange(known))
    waves = np.empty((len(rows), terms))
    waves[:, :known] = turned.real
    if terms > known:  # the spectrum of real numbers ends half-way: the rest is its mirror image
        waves[:, known:] = -turned.imag[:, count - known : count - terms : -1]
    return waves


def _by_blocks(rows: Sequence[Floats], terms: int, blocks: int) -> Floats:
    count = len(rows[0])
    size = ceil(count / blocks)
    blocks = ceil(count / size)
    moments = np.stack([_moments(row, size) for row in rows])
    # Whole numbers of a quarter turn over n, so that no phase loses digits to its many turns.
    turns = np.outer(size * (2 * np.arange(blocks) + 1), np.arange(terms)) % (4 * count)
    phases = (0.5 * np.pi / count) * turns
    powers = _signed_powers(np.pi / count * size * np.arange(terms, dtype=np.float64))
    even = np.tensordot(moments[:, :, ::2], np.cos(phases), axes=(1, 0))
    odd = np.tensordot(moments[:, :, 1::2], np.sin(phases), axes=(1, 0))
    waves: Floats = np.einsum("wmk,km->wk", even, powers[:, ::2])
    waves -= np.einsum("wmk,km->wk", odd, powers[:, 1::2])
    return waves


def _moments(row: Floats, size: int) -> Floats:
    """Moments of each block about its middle, in its lengths; the last block ends in zeros."""
    powers = np.vander((np.arange(size) - 0.5 * (size - 1)) / size, _ORDER, increasing=True)
    whole = len(row) // size * size
    moments: Floats = row[:whole].reshape(-1, size) @ powers
    rest = row[whole:]
    return moments if len(rest) == 0 else np.vstack([moments, rest @ powers[: len(rest)]])


def _signed_powers(phase: Floats) -> Floats:
    """Coefficients of cosine and sine in turn: 1, x, -x^2/2, -x^3/6, ... of each phase x."""
    orders = np.arange(_ORDER)
    signs = np.where(orders % 4 < 2, 1.0, -1.0)
    factorials = np.array([factorial(each) for each in range(_ORDER)], dtype=np.float64)
    powers: Floats = signs * phase[:, None] ** orders / factorials
    return powers
