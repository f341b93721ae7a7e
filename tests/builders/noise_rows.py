"""Rows of noise of a known kind, by plain numpy; and the spread of a number over them."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from labpipe.records.arrays import Floats

Number: TypeAlias = Callable[[Floats, Floats], Floats]
"""Of displacements and forces, shape (..., n): shape (...)."""
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


def spreads(
    decide: Callable[[Floats, Floats], Number], displacement: Floats, force: Floats
) -> tuple[float, float]:
    """Standard deviations of a number over tests, and over replicates of one that was decided on.

    Parameters
    ----------
    decide : on a displacement and a force, what the number of others is
    displacement, force : shape (tests, n)
    """
    tests = [float(decide(d, f)(d, f)) for d, f in zip(displacement, force, strict=True)]
    replicates = decide(displacement[-1], force[-1])(displacement, force)
    return float(np.std(tests)), float(np.std(replicates))
