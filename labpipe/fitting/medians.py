"""Running medians. scipy has them too, but importing its filters takes longer than all fits."""

from __future__ import annotations

from bisect import bisect_left, insort

import numpy as np

from labpipe.records.arrays import Floats

_SHORT = 9
"""Windows up to this long are sorted by comparing whole arrays: passes grow with their square."""
_PIECE = 1 << 14
"""Samples at a time, so that the arrays that are compared stay in the cache."""


def running_median(values: Floats, window: int) -> Floats:
    """Median of each sample and its neighbours.

    Parameters
    ----------
    values : shape (n,), without NaN, n at least 1
    window : samples that each median is of, itself in the middle; of an even number the upper one
        of the two in the middle, and one neighbour more before than behind

    Returns
    -------
    shape (n,). Beyond the ends the first and the last sample are repeated.

    Raises
    ------
    ValueError
        If the window is shorter than one sample.

    Notes
    -----
    The same numbers, to the last bit, as `scipy.ndimage.median_filter` with ``mode="nearest"``.
    Short odd windows: of (w + 3) / 2 samples neither the least nor the greatest can be the median
    of w, so they are dropped and the next sample taken in, until one is left (forgetful
    selection; Paeth, Graphics Gems, 1990, p. 171). Long ones: a sorted list that goes along.

    Examples
    --------
    >>> running_median(np.array([1.0, 9.0, 2.0, 3.0, 3.0]), 3)
    array([1., 2., 3., 3., 3.])
    """
    if window < 1:
        message = f"expected a window of at least one sample, found {window}"
        raise ValueError(message)
    before = window // 2
    padded = np.pad(values, (before, window - 1 - before), mode="edge")
    if window > _SHORT or window % 2 == 0:
        return _along(padded, window)
    medians = np.empty(len(values))
    for start in range(0, len(values), _PIECE):
        piece = padded[start : start + _PIECE + window - 1]
        medians[start : start + _PIECE] = _forgetful(piece, window)
    return medians


def _forgetful(padded: Floats, window: int) -> Floats:
    count = len(padded) - window + 1
    shifted = [padded[shift : shift + count] for shift in range(window)]
    kept, later = shifted[: window // 2 + 2], shifted[window // 2 + 2 :]
    while len(kept) > 2:
        kept = _without_extremes(kept) + later[:1]
        later = later[1:]
    return kept[0]


def _without_extremes(several: list[Floats]) -> list[Floats]:
    """Arrays that hold, sample by sample, the same numbers but the least and the greatest."""
    least, middle = several[0], []
    for each in several[1:]:
        middle.append(np.maximum(least, each))
        least = np.minimum(least, each)
    greatest, rest = middle[0], []
    for each in middle[1:]:
        rest.append(np.minimum(greatest, each))
        greatest = np.maximum(greatest, each)
    return rest


def _along(padded: Floats, window: int) -> Floats:
    numbers = padded.tolist()
    ordered = sorted(numbers[:window])
    medians = [ordered[window // 2]]
    for gone, new in zip(numbers, numbers[window:], strict=False):
        del ordered[bisect_left(ordered, gone)]
        insort(ordered, new)
        medians.append(ordered[window // 2])
    return np.array(medians)
