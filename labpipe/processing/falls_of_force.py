"""Where a signal turns most sharply from rising to falling: a first guess of a turning point."""

from __future__ import annotations

import numpy as np

from labpipe.records.arrays import Floats

_BLOCKS = 20
"""Averages per width: fine enough for a first guess, and noise is averaged."""


def sharpest_turn(time: Floats, values: Floats, *, width: float) -> float | None:
    """Find where the slope of a signal drops most.

    Parameters
    ----------
    time, values : shape (n,), s and any unit; NaN are left out
    width : s, on each side, over which the slopes before and after are taken

    Returns
    -------
    s; None where the record is shorter than two widths, or nowhere rises and then falls.

    Notes
    -----
    The largest difference of the mean slopes over `width` before and after. The largest value would
    not do: a bundle in large deflection can have its largest force before the motion turns.
    """
    known = ~np.isnan(values)
    edges = np.arange(time[0], time[-1], width / _BLOCKS)
    if len(edges) < 2 * _BLOCKS + 2:
        return None
    place = np.searchsorted(edges, time[known], side="right") - 1
    count = np.bincount(place, minlength=len(edges)).astype(np.float64)
    filled = count > 0
    total = np.bincount(place, values[known], minlength=len(edges))
    middles = edges + 0.5 * width / _BLOCKS
    level = np.interp(middles, middles[filled], total[filled] / count[filled])
    before = level[_BLOCKS:-_BLOCKS] - level[: -2 * _BLOCKS]
    after = level[2 * _BLOCKS :] - level[_BLOCKS:-_BLOCKS]
    drop = np.where(after < 0.0, before - after, 0.0)
    best = int(np.argmax(drop))
    return float(middles[best + _BLOCKS]) if drop[best] > 0.0 else None
