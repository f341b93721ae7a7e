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
_SHORTEST = 0.3
"""Share of the width that slopes are taken over at least, however short the dwell."""
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
    found = _levels(time, values, width)
    if found is None:
        return None
    middles, level = found
    if np.ptp(level) < _MORE_THAN_NOISE * noise_level(level):
        return None
    bend, after = _bends(level)
    here = level[_BLOCKS:-_BLOCKS] - level.min()
    drop = np.where((after < 0.0) & (here > _LEAST * np.ptp(level)), bend, 0.0)
    best = int(np.argmax(drop))
    return float(middles[best + _BLOCKS]) if drop[best] > 0.0 else None


def turn_near(
    time: Floats, values: Floats, *, near: float, reach: float, width: float, dwell: float
) -> float | None:
    """Find roughly where a signal stops rising, and where it begins to fall a known while later.

    Parameters
    ----------
    time, values : shape (n,), s and any unit; NaN are left out
    near : s, middle of what is looked at
    reach : s on each side of it in which both corners are
    width : s, on each side of a corner, over which the slopes before and after are taken
    dwell : s, from the one corner to the other; 0 for a signal that turns at once

    Returns
    -------
    s, of the first corner; None where the record does not reach as far.

    Notes
    -----
    Where the slope drops by most at both places together. Either corner alone could be the other: a
    steep fall drops the slope more than the end of a rise does. A fall that grows less steep drops
    it nowhere. With a dwell, slopes are taken over no more than that, or 0.3 of the width.
    """
    width = width * min(1.0, max(_SHORTEST, dwell / width)) if dwell > 0.0 else width
    inside = slice(*np.searchsorted(time, [near - reach - width, near + reach + width]))
    found = _levels(time[inside], values[inside], width)
    if found is None:
        return None
    middles, level = found
    places, (bend, _) = middles[_BLOCKS:-_BLOCKS], _bends(level)
    both = bend + np.interp(places + dwell, places, bend, right=-np.inf)
    return float(places[int(np.argmax(both))]) if np.isfinite(both).any() else None


def _levels(time: Floats, values: Floats, width: float) -> tuple[Floats, Floats] | None:
    """Means over twentieths of a width, and the middles of these; None for less than two widths."""
    known = ~np.isnan(values)
    edges = np.arange(time[0], time[-1], width / _BLOCKS) if known.any() else np.zeros(0)
    if len(edges) < 2 * _BLOCKS + 2:
        return None
    place = np.searchsorted(edges, time[known], side="right") - 1
    count = np.bincount(place, minlength=len(edges)).astype(np.float64)
    filled = count > 0
    total = np.bincount(place, values[known], minlength=len(edges))
    middles = edges + 0.5 * width / _BLOCKS
    return middles, np.interp(middles, middles[filled], total[filled] / count[filled])


def _bends(level: Floats) -> tuple[Floats, Floats]:
    """By how much the mean slope drops at each level, and the rise behind it; without the ends."""
    before = level[_BLOCKS:-_BLOCKS] - level[: -2 * _BLOCKS]
    after = level[2 * _BLOCKS :] - level[_BLOCKS:-_BLOCKS]
    return before - after, after
