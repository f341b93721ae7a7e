"""Non-negative least squares of a few unknowns.

scipy has it too, but importing its optimisers takes longer than processing a whole test.
"""

from __future__ import annotations

import numpy as np

from labpipe.records.arrays import Flags, Floats

_NOTHING = 1e-12
"""Share of the largest right-hand side below which a gradient is none."""


def solve_nonnegative(normal: Floats, right: Floats) -> Floats:
    """Find the best solution of normal equations that has no negative unknown.

    Parameters
    ----------
    normal : shape (k, k), A^T A, positive definite, its diagonal about 1
    right : shape (k,), A^T b

    Returns
    -------
    shape (k,), the x that makes the norm of A x - b least among those without negative elements.

    Raises
    ------
    ValueError
        If the search does not end, as with a matrix that is not positive definite.

    Notes
    -----
    The active-set method of Lawson and Hanson, Solving Least Squares Problems, 1974, chapter 23, on
    normal equations (Bro and De Jong, J. Chemometrics 11 (1997) 393).

    Examples
    --------
    >>> solve_nonnegative(np.eye(2), np.array([3.0, -1.0]))
    array([3., 0.])
    """
    x, is_free = np.zeros(len(right)), np.zeros(len(right), dtype=np.bool_)
    least = _NOTHING * float(np.abs(right).max(initial=0.0))
    for _ in range(10 * len(right) + 1):
        downhill = np.where(is_free, -np.inf, right - normal @ x)
        if is_free.all() or downhill.max() <= least:
            return x
        is_free[int(np.argmax(downhill))] = True
        x = _with_free(normal, right, x, is_free)
    message = f"normal: expected a positive definite matrix of {len(right)} rows, found no end"
    raise ValueError(message)


def _with_free(normal: Floats, right: Floats, x: Floats, is_free: Flags) -> Floats:
    """The best with some unknowns free; those that would go below zero are held at it, in place."""
    while True:
        best = np.zeros_like(x)
        best[is_free] = np.linalg.solve(normal[np.ix_(is_free, is_free)], right[is_free])
        below = is_free & (best <= 0.0)
        if not below.any():
            return best
        steps = x[below] / (x[below] - best[below])
        x = x + float(steps.min()) * (best - x)
        is_free[np.flatnonzero(below)[steps == steps.min()]] = False
        x[~is_free] = 0.0
