"""Where a signal turns most sharply from rising to falling: a first guess of a turning point."""

from __future__ import annotations

import numpy as np

from labpipe.processing.strokes import noise_level
from labpipe.records.arrays import Floats

_BLOCKS = 20
"""Averages per width: fine enough for a first guess, and noise is averaged."""
_LEAST = 0.3
"""Share of the way from its lowest to its highest level that a signal has at least where it turns:
what falls at the bottom is noise, or the head of a load frame that touches."""
_MORE_THAN_NOISE = 10.0
"""Standard deviations; the extremes of a thousand values of noise are seven apart."""


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
    The largest difference of the mean slopes over `width` before and after, above 0.3 of the way
    from the lowest level to the highest: a record that ends under load has no turn. The largest
    value would not do: a bundle in large deflection can have its largest force before the motion
    turns. Where that way is less than ten standard deviations of the noise of the averages, there
    is no turn but noise.
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
    if np.ptp(level) < _MORE_THAN_NOISE * noise_level(level):
        return None
    before = level[_BLOCKS:-_BLOCKS] - level[: -2 * _BLOCKS]
    after = level[2 * _BLOCKS :] - level[_BLOCKS:-_BLOCKS]
    here = level[_BLOCKS:-_BLOCKS] - level.min()
    drop = np.where((after < 0.0) & (here > _LEAST * np.ptp(level)), before - after, 0.0)
    best = int(np.argmax(drop))
    return float(middles[best + _BLOCKS]) if drop[best] > 0.0 else None
