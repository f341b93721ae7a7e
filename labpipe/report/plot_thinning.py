"""Thinning of curves for drawing that keeps extremes and corners; lighter doubtful parts."""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from labpipe.records.arrays import Flags, Floats, Ints

_Segment: TypeAlias = tuple[float, int, int, int]
"""Negative distance of the furthest sample; first, furthest and last sample."""


def extremes(values: Floats, *, bins: int) -> Ints:
    """Return the samples of a thinned line that keeps its extremes.

    Parameters
    ----------
    values : shape (n,), in order of drawing
    bins : of equal length, at least 1

    Returns
    -------
    Sorted sample numbers: the lowest and the highest sample of each bin, which keeps the width of
    noise, its first NaN, which keeps gaps, and the two ends. All samples if there are at most
    four per bin.

    Raises
    ------
    ValueError
        If `bins` is less than 1.
    """
    if bins < 1:
        message = f"bins: expected at least 1, found {bins}"
        raise ValueError(message)
    count = len(values)
    if count <= 4 * bins:
        return np.arange(count, dtype=np.int64)
    starts = np.linspace(0, count, bins + 1).astype(np.int64)
    bin_number = np.repeat(np.arange(bins), np.diff(starts))
    # sorted by bin, then by value: NaN is last within each bin
    order = np.lexsort((values, bin_number))
    blank = np.isnan(values)
    n_finite = np.add.reduceat(~blank, starts[:-1])
    highest = order[starts[:-1] + np.maximum(n_finite - 1, 0)]
    gaps = np.flatnonzero(blank)
    first_gaps = gaps[np.unique(bin_number[gaps], return_index=True)[1]]
    ends = [0, count - 1]
    return np.unique(np.concatenate([order[starts[:-1]], highest, first_gaps, ends]))


def simplify_line(across: Floats, values: Floats, *, points: int, tolerance: float = 0.002) -> Ints:
    """Return the samples of a simplified line that keeps its shape.

    Parameters
    ----------
    across, values : shape (n,), in order of drawing
    points : at most, besides the ends of gaps, which are always kept
    tolerance : invisible distance from the line, as a share of the range of the values

    Returns
    -------
    Sorted sample numbers: the two ends, then repeatedly the sample furthest, along the values, from
    the line through those kept so far, until none is further than the tolerance. Corners, steps
    and the largest excursions of noise are kept; of a gap, its ends and its first NaN.

    Notes
    -----
    Douglas and Peucker, Cartographica 10 (1973) 112, the furthest of all segments first.
    """
    finite = np.flatnonzero(np.isfinite(across) & np.isfinite(values))
    if not len(finite):
        return np.arange(min(len(values), 1), dtype=np.int64)
    broken = np.flatnonzero(np.diff(finite) > 1)
    starts = np.concatenate([finite[:1], finite[broken + 1]])
    stops = np.concatenate([finite[broken], finite[-1:]])
    rows = {*starts.tolist(), *stops.tolist(), *(finite[broken] + 1).tolist()}
    max_distance = tolerance * float(np.ptp(values[finite]))
    segments = [
        _furthest_sample(across, values, int(start), int(stop))
        for start, stop in zip(starts, stops, strict=True)
    ]
    heapq.heapify(segments)
    while segments and len(rows) < points:
        distance, start, furthest, stop = heapq.heappop(segments)
        if -distance <= max_distance:
            break
        rows.add(furthest)
        heapq.heappush(segments, _furthest_sample(across, values, start, furthest))
        heapq.heappush(segments, _furthest_sample(across, values, furthest, stop))
    return np.array(sorted(rows), dtype=np.int64)


def _furthest_sample(across: Floats, values: Floats, start: int, stop: int) -> _Segment:
    """Return the sample between two that is furthest from the line through them."""
    if stop - start < 2:
        return (0.0, start, start, stop)
    x, y = across[start : stop + 1], values[start : stop + 1]
    width = x[-1] - x[0]
    # a vertical part is drawn sample by sample
    share = (x - x[0]) / width if width != 0.0 else np.linspace(0.0, 1.0, len(x))
    # two ufuncs take half as long as np.clip, and this runs 100 times a curve
    share = np.minimum(np.maximum(share, 0.0), 1.0)
    distance = np.abs(y - y[0] - (y[-1] - y[0]) * share)
    furthest = int(np.argmax(distance))
    return (-float(distance[furthest]), start, start + furthest, stop)


def worst(flags: NDArray[np.uint8], rank: NDArray[np.uint8], *, bins: int) -> NDArray[np.uint8]:
    """Thin flags along time, keeping the worst.

    Parameters
    ----------
    flags : shape (frames, points)
    rank : badness of each flag, by its number
    bins : columns, at most

    Returns
    -------
    Shape (columns, points): the flag of highest rank within each bin of frames.
    """
    frames = len(flags)
    starts = np.unique(np.linspace(0, frames, min(bins, frames), endpoint=False).astype(np.int64))
    badness = np.maximum.reduceat(rank[flags], starts, axis=0) if frames else rank[flags]
    by_rank = np.argsort(rank).astype(np.uint8)
    columns: NDArray[np.uint8] = by_rank[badness]
    return columns


def split_doubtful(sure: Flags) -> Iterator[tuple[Flags, float]]:
    """Split a line into its sure part and its doubtful part, which is drawn lighter.

    Parameters
    ----------
    sure : shape (n,), true up to some point, and at the first

    Yields
    ------
    The points of a part, shape (n,), and its opacity.
    """
    yield sure, 1.0
    if not sure.all():
        doubtful = ~sure
        doubtful[int(sure.sum()) - 1] = True
        yield doubtful, 0.35
