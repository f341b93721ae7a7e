"""Jumps of a level: from one sample to the next a signal goes on elsewhere, as after a tare."""

from __future__ import annotations

import numpy as np

from labpipe.processing.strokes import noise_level
from labpipe.records.arrays import Floats

_NEAR = 3
"""Steps on each side that a jump is compared with."""
_LARGER = 5.0
"""Times the fastest of these steps that it is faster."""
_SHARE = 0.02
"""Share of the range of the signal below which a jump does no harm."""
_SURE_JUMP = 8.0
"""Standard deviations of the noise below which nobody can tell."""


def level_jumps(time: Floats, values: Floats) -> tuple[tuple[int, float], ...]:
    """Find single steps that are far larger than those around them, and after which all goes on.

    Parameters
    ----------
    time, values : shape (n,), s (or numbers of rows) and any unit; NaN are left out, and what goes
        on over a hole in the record at its usual speed is no jump

    Returns
    -------
    Of each jump the first sample behind it, and its size in the unit of `values`, in order. None
    within three samples of the ends, nor where the signal is back after up to three samples.

    Notes
    -----
    A corner changes the steps behind it as well, so that it is no jump; a signal that breaks down
    for good is one, which the caller may know better.
    """
    known = np.flatnonzero(~np.isnan(values))
    v = values[known]
    if len(v) < 2 * _NEAR + 2:
        return ()
    steps = np.diff(v)
    speeds = np.abs(steps) / np.diff(time[known])
    least = max(_SHARE * float(np.ptp(v)), _SURE_JUMP * noise_level(v))
    found = []
    for at in np.flatnonzero(np.abs(steps) > least).tolist():
        before, after = speeds[max(at - _NEAR, 0) : at], speeds[at + 1 : at + 1 + _NEAR]
        if min(len(before), len(after)) < _NEAR:
            continue
        if speeds[at] > _LARGER * float(np.concatenate([before, after]).max()):
            found.append((int(known[at + 1]), float(steps[at])))
    return tuple(found)
