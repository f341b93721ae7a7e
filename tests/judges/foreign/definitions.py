"""What is true of a test: the field's definitions on curves without noise, sampled densely.

Peak: the largest force. Stiffness: the least-squares line over its window. Energy: trapezoids.
Two segments: the best pair of joined lines of all. Failure: the last point before the loss.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def slope(d: Array, f: Array) -> float:
    """Least-squares slope of f over d."""
    lever = d - d.mean()
    return float(lever @ f / (lever @ lever))


def window_slope(d: Array, f: Array, start: float, end: float) -> float:
    """Slope over a window of d."""
    inside = (d >= start) & (d <= end)
    return slope(d[inside], f[inside])


def work(d: Array, f: Array) -> float:
    """Integral of f over d."""
    return float(np.trapezoid(f, d))


def crossing(d: Array, f: Array, level: float) -> float:
    """The d at which f first goes through a level."""
    above = f >= level
    i = int(np.flatnonzero(above[1:] != above[:-1])[0])
    share = (level - f[i]) / (f[i + 1] - f[i])
    return float(d[i] + share * (d[i + 1] - d[i]))


def slack(d: Array, f: Array, low: float = 0.1, high: float = 0.3) -> float:
    """Where the line between two shares of the largest force meets zero."""
    top = int(np.argmax(f))
    peak = float(f[top])
    start, end = crossing(d[: top + 1], f[: top + 1], low * peak), 0.0
    end = crossing(d[: top + 1], f[: top + 1], high * peak)
    inside = (d >= start) & (d <= end)
    steep = slope(d[inside], f[inside])
    return float(d[inside].mean() - f[inside].mean() / steep)


def two_segments(d: Array, f: Array, start: float, end: float) -> tuple[float, float, float, float]:
    """First slope, second slope, break point and the force there, over a window."""
    inside = (d >= start) & (d <= end)
    x, y = d[inside], f[inside]
    keep = np.linspace(0, len(x) - 1, min(len(x), 4000)).astype(int)
    x, y = x[keep], y[keep]

    def fit(place: float) -> tuple[float, Array]:
        design = np.column_stack([np.ones_like(x), x, np.clip(x - place, 0.0, None)])
        found, *_ = np.linalg.lstsq(design, y, rcond=None)
        return float(np.sum((y - design @ found) ** 2)), found

    low, high = start + 0.05 * (end - start), end - 0.05 * (end - start)
    for _ in range(4):
        places = np.linspace(low, high, 25)
        best = int(np.argmin([fit(place)[0] for place in places]))
        low, high = places[max(best - 1, 0)], places[min(best + 1, 24)]
    place = float(places[best])
    level, first, more = fit(place)[1]
    return float(first), float(first + more), place, float(level + first * place)


def onset(d: Array, f: Array, level: float) -> tuple[float, float] | None:
    """Place and force from which on the tangent stays below a level, to the end; None if never."""
    tangent = np.gradient(f, d)
    steep = np.flatnonzero(tangent >= level)
    if not len(steep) or steep[-1] >= len(d) - 2:
        return None
    return float(d[steep[-1]]), float(f[steep[-1]])
