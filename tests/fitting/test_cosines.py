"""The slowest cosines against scipy's whole transform."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.fft import dct

from labpipe.fitting.cosines import slowest_cosines


@pytest.mark.parametrize("count", [1, 2, 3, 4, 5, 6, 7, 12, 127, 128, 129, 255, 256, 2001])
def test_any_number_of_them(count: int) -> None:
    rows = list(np.random.default_rng(count).normal(size=(3, count)))
    whole = dct(rows, norm="ortho")
    for terms in sorted({1, min(count, 2), count // 2 + 1, min(count, 128), count}):
        found = slowest_cosines(rows, terms)
        # Rounding of numbers of about 1, a few times over.
        np.testing.assert_allclose(found, whole[:, :terms], rtol=0, atol=1e-13)


@pytest.mark.parametrize("count", [12_800, 13_000, 40_000, 76_001, 39_989])
def test_of_long_records(count: int) -> None:
    random = np.random.default_rng(1)
    rows = [random.normal(size=count), np.full(count, count**-0.5), random.normal(size=count)]
    rows[2][-7:] = 1e3
    found = slowest_cosines(rows, 128)
    expected = np.stack([dct(row, norm="ortho")[:128] for row in rows])
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-13 * np.abs(expected).max())
