"""Rows of noise of a known kind, by plain numpy."""

from __future__ import annotations

import numpy as np

from labpipe.records.arrays import Floats

KINDS = ("white", "remembering")
_MEMORY = 0.9
"""Of a sample in the next one."""


def noise_rows(kind: str, deviation: float, shape: tuple[int, int], seed: int) -> Floats:
    """Make rows of noise of one standard deviation: white, or autoregressive of first order."""
    rng = np.random.default_rng(seed)
    rows = rng.normal(0.0, deviation, shape)
    if kind == "remembering":
        fresh = np.sqrt(1.0 - _MEMORY**2) * rows
        for at in range(1, shape[1]):
            rows[:, at] = _MEMORY * rows[:, at - 1] + fresh[:, at]
    return rows


def flicker(shape: tuple[int, int], seed: int) -> Floats:
    """Make rows of noise whose power falls as 1 over the frequency, of variance 1 in all."""
    rows, count = shape
    waves = np.fft.rfft(np.random.default_rng(seed).normal(size=(rows, 4 * count)))
    waves[:, 1:] /= np.sqrt(np.arange(1.0, waves.shape[1]))
    waves[:, 0] = 0.0
    noise = np.fft.irfft(waves, 4 * count)[:, :count]
    return np.asarray(noise / noise.std(), dtype=np.float64)
