"""Means over blocks of samples."""

from __future__ import annotations

import numpy as np

from labpipe.records.arrays import Floats


def block_means(values: Floats, points: int) -> Floats:
    """Means over consecutive samples, of equal number.

    Parameters
    ----------
    values : shape (n,); a NaN makes its mean NaN
    points : how many means there should be at least, where there are as many samples

    Returns
    -------
    Between `points` and twice as many; what does not fill the last block joins it.
    """
    size = max(1, len(values) // points)
    starts = np.arange(0, max(len(values) - size + 1, 1), size)
    if not len(values):
        return values
    means: Floats = np.add.reduceat(values, starts) / np.diff(np.append(starts, len(values)))
    return means
