"""Fewer points to draw, without hiding what the samples do; and which of them are drawn lighter."""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from labpipe.records.arrays import Flags, Floats, Ints

_Stretch: TypeAlias = tuple[float, int, int, int]
"""Less the distance of the furthest sample, first sample, the furthest, last sample."""
_FADED = 0.35


def extremes(values: Floats, *, bins: int) -> Ints:
    """Number the samples that a thinned line must pass through.

    Parameters
    ----------
    values : shape (n,), in order of drawing
    bins : stretches of equal length that the samples are cut into, at least 1

    Returns
    -------
    Sorted sample numbers: of each stretch the lowest and the highest sample, so that noise is drawn
    as wide as it is; its first NaN, so that a gap stays a gap; and the two ends. All samples
    if there are fewer than four per stretch.

    Raises
    ------
    ValueError
        If `bins` is less than 1.
    """
    if bins < 1:
        message = f"bins={bins}: expected at least 1"
        raise ValueError(message)
    count = len(values)
    if count <= 4 * bins:
        return np.arange(count, dtype=np.int64)
    starts = np.linspace(0, count, bins + 1).astype(np.int64)
    stretch = np.repeat(np.arange(bins), np.diff(starts))
    # sorted by stretch, then by value: NaN comes last within each stretch
    order = np.lexsort((values, stretch))
    blank = np.isnan(values)
    seen = np.add.reduceat(~blank, starts[:-1])
    highest = order[starts[:-1] + np.maximum(seen - 1, 0)]
    gaps = np.flatnonzero(blank)
    first_gaps = gaps[np.unique(stretch[gaps], return_index=True)[1]]
    ends = [0, count - 1]
    return np.unique(np.concatenate([order[starts[:-1]], highest, first_gaps, ends]))


def bends(across: Floats, values: Floats, *, points: int, tolerance: float = 0.002) -> Ints:
    """Number the samples that a line must pass through to keep its shape.

    Parameters
    ----------
    across, values : shape (n,), in order of drawing
    points : how many at the most, without the ends of gaps, which are always kept
    tolerance : distance from the line that nobody sees, as a share of the range of the values

    Returns
    -------
    Sorted sample numbers: the two ends, then again and again the sample that lies furthest, along
    the values, from the line through those kept so far, until none lies further than the tolerance.
    A corner stays a corner and a step a step; noise keeps its largest excursions. Of a gap, its
    ends and its first NaN, so that it stays a gap.

    Notes
    -----
    Douglas and Peucker, Cartographica 10 (1973) 112, the furthest of all stretches first.
    """
    known = np.flatnonzero(np.isfinite(across) & np.isfinite(values))
    if not len(known):
        return np.arange(min(len(values), 1), dtype=np.int64)
    broken = np.flatnonzero(np.diff(known) > 1)
    starts = np.concatenate([known[:1], known[broken + 1]])
    stops = np.concatenate([known[broken], known[-1:]])
    kept = {*starts.tolist(), *stops.tolist(), *(known[broken] + 1).tolist()}
    unseen = tolerance * float(np.ptp(values[known]))
    stretches = [
        _furthest(across, values, int(start), int(stop))
        for start, stop in zip(starts, stops, strict=True)
    ]
    heapq.heapify(stretches)
    while stretches and len(kept) < points:
        distance, start, at, stop = heapq.heappop(stretches)
        if -distance <= unseen:
            break
        kept.add(at)
        heapq.heappush(stretches, _furthest(across, values, start, at))
        heapq.heappush(stretches, _furthest(across, values, at, stop))
    return np.array(sorted(kept), dtype=np.int64)


def _furthest(across: Floats, values: Floats, start: int, stop: int) -> _Stretch:
    """The sample between two that lies furthest from the line through them."""
    if stop - start < 2:
        return (0.0, start, start, stop)
    x, y = across[start : stop + 1], values[start : stop + 1]
    width = x[-1] - x[0]
    # Where nothing moves across, the line is drawn sample by sample.
    share = (x - x[0]) / width if width != 0.0 else np.linspace(0.0, 1.0, len(x))
    distance = np.abs(y - y[0] - (y[-1] - y[0]) * np.clip(share, 0.0, 1.0))
    at = int(np.argmax(distance))
    return (-float(distance[at]), start, start + at, stop)


def worst(flags: NDArray[np.uint8], rank: NDArray[np.uint8], *, bins: int) -> NDArray[np.uint8]:
    """Thin flags along time so that the shortest trouble stays visible.

    Parameters
    ----------
    flags : shape (frames, points)
    rank : how bad each flag is, by its number
    bins : columns wanted at the most

    Returns
    -------
    Shape (columns, points): the flag of highest rank within each stretch of frames.
    """
    frames = len(flags)
    starts = np.unique(np.linspace(0, frames, min(bins, frames), endpoint=False).astype(np.int64))
    badness = np.maximum.reduceat(rank[flags], starts, axis=0) if frames else rank[flags]
    by_rank = np.argsort(rank).astype(np.uint8)
    found: NDArray[np.uint8] = by_rank[badness]
    return found


def sure_and_doubtful(sure: Flags) -> Iterator[tuple[Flags, float]]:
    """Cut a line in what is sure, and what is doubtful, from its last sure point on, lighter.

    Parameters
    ----------
    sure : shape (n,), true up to some point, and at the first

    Yields
    ------
    The points of a part, shape (n,), and how opaque it is drawn.
    """
    yield sure, 1.0
    if not sure.all():
        doubtful = ~sure
        doubtful[int(sure.sum()) - 1] = True
        yield doubtful, _FADED
