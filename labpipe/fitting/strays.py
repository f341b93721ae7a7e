"""Stray samples: a few bad ones in a row, after which the signal is back where it was."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import median_filter

from labpipe.records.arrays import Floats, Ints, median, stretches_of

_WINDOW = 7
_LONGEST = _WINDOW // 2
_FAR_OFF = 8.0
"""Robust deviations from the short median that a stray sample is away at least."""
_FLOOR = 0.01
"""Share of the signal's range that it is away at least: less does no harm."""
_SOME = 200
"""Medians that are looked at to see how far the signal goes at least."""
_FAR_IN_STEPS = 4.0
"""Largest steps of the neighbours that it is away at least, so that a sharp turn is none."""


def stray_samples(force: Floats) -> Ints:
    """Samples far off their neighbours, which agree with each other.

    Parameters
    ----------
    force : shape (n,), N; NaN are left out

    Returns
    -------
    Sample numbers in order; spikes and dropouts of at most three samples in a row.

    Notes
    -----
    The departure from the median of seven must exceed eight of its robust deviations (1.4826 MAD),
    1 % of the range of that median and four of the largest steps between the three neighbours on
    each side; the medians of these two threes must differ by less than half of it. A loss of force
    does not come back and is therefore none, nor is a sample at the very beginning or end, which
    has neighbours on one side only.
    """
    known = np.flatnonzero(~np.isnan(force)).astype(np.int64)
    f = force[known]
    if len(f) < 2 * _WINDOW or _is_smooth(f):
        return np.zeros(0, dtype=np.int64)
    level = median_filter(f, _WINDOW, mode="nearest")
    off = f - level
    far = max(_FAR_OFF * 1.4826 * median(np.abs(off)), _FLOOR * float(np.ptp(level)))
    runs = [_core(np.arange(*run), off) for run in stretches_of(np.abs(off) > far)]
    strays = [run for run in runs if _returns(f, run, float(np.abs(off[run]).min()))]
    numbers: Ints = known[np.concatenate(strays).astype(np.int64)] if strays else known[:0]
    return numbers


def bridged(force: Floats, strays: Ints) -> Floats:
    """Put stray samples on the line between their neighbours.

    Parameters
    ----------
    force : shape (n,), N; NaN stay and are no neighbours
    strays : numbers of samples, as `stray_samples` gives them

    Returns
    -------
    shape (n,), a new array
    """
    sound = np.setdiff1d(np.flatnonzero(~np.isnan(force)), strays)
    mended = force.copy()
    mended[strays] = np.interp(strays, sound, force[sound])
    return mended


def _is_smooth(f: Floats) -> bool:
    """Whether no sample can be far off, as the steps are too small: most long records are done.

    A sample is at most three steps away from any median of seven that it is in; the range of some
    of these medians is at most that of all.
    """
    steps = np.diff(f)
    largest = max(float(steps.max()), -float(steps.min()))
    windows = np.lib.stride_tricks.sliding_window_view(f, _WINDOW)
    some = np.median(windows[:: max(1, len(windows) // _SOME)], axis=1)
    return _LONGEST * largest <= _FLOOR * float(np.ptp(some))


def _core(run: Ints, off: Floats) -> Ints:
    """The samples of a run without its neighbours, whose median it has pulled away."""
    away = np.abs(off[run])
    core: Ints = run[away > 0.3 * away.max()]
    return core


def _returns(f: Floats, run: Ints, off: float) -> bool:
    first, last = int(run[0]), int(run[-1])
    before, after = f[max(first - _LONGEST, 0) : first], f[last + 1 : last + 1 + _LONGEST]
    if last - first >= _LONGEST or min(len(before), len(after)) < _LONGEST:
        return False
    step = max(float(np.abs(np.diff(side)).max()) for side in (before, after))
    apart = abs(median(after) - median(before))
    return off > _FAR_IN_STEPS * step and apart < 0.5 * off
