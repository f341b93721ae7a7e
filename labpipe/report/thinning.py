"""Fewer points to draw, without hiding what the samples do."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from labpipe.records.arrays import Floats, Ints


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
