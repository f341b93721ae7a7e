"""Where a signal rests, whether it still moves at its end, and where its level jumps."""

from __future__ import annotations

from math import sqrt

import numpy as np

from labpipe.records.arrays import Floats, median, stretches_of
from labpipe.signal.turning_points import noise_level

_AS_FAST = 0.5
"""Share of its mean speed above which a motion still moves."""
_SURE_OF_SPEED = 0.15
"""Share of the mean speed to which a speed is to be known."""
_LAST = 0.02
"""Share of a stretch whose speed is that at its end; more where noise asks for it."""
_STANDS = 0.05
"""Share of its usual speed below which a motion stands."""
_IN_A_ROW = 3
"""Steps between means in a row that are as slow."""
_AT_A_TURN = 5
"""As many at a turn: a round one has fewer."""
_SURE_OF_REST = 3.0
"""Standard errors by which the means of a motion that stands may move."""
_CORNERS = 200
"""Places at which a corner is tried."""
_SURELY, _MOSTLY = 25.0, 0.5
"""Variances, and share of the sum of squares about a line, that a corner takes off."""
_NEAR = 3
"""Steps on each side that a jump is compared with."""
_LARGER = 5.0
"""Times the fastest of these steps that it is faster."""
_SHARE = 0.02
"""Share of the range of the signal below which a jump does no harm."""
_SURE_JUMP = 8.0
"""Standard deviations of the noise below which nobody can tell."""


def moves_at_end(time: Floats, values: Floats) -> bool:
    """Tell whether a motion is still under way in the last sample of a stretch.

    Parameters
    ----------
    time, values : shape (n,), from the begin of the stretch to its last sample; without NaN

    Returns
    -------
    Whether a straight line through the last fiftieth of the stretch (as much more as its noise
    asks for, up to a third; three samples at least) runs in the direction of the whole stretch, at
    half its mean speed or more. False where nothing moves.
    """
    way = float(values[-1] - values[0])
    lasts = float(time[-1] - time[0])
    if len(values) < 3 or way == 0.0 or not lasts > 0.0:
        return False
    speed, noise = abs(way) / lasts, noise_level(values)
    apart = median(np.diff(time))
    size = max(3, int(_LAST * len(values)))
    while size < len(values) // 3 and noise * sqrt(12.0 / size**3) / apart > _SURE_OF_SPEED * speed:
        size += max(1, size // 4)
    late, high = time[-size:] - time[-size:].mean(), values[-size:]
    slope = float(late @ high) / float(late @ late)
    return slope * float(np.sign(way)) >= _AS_FAST * speed


def standing_stretches(
    time: Floats, values: Floats, *, size: int, speed: float
) -> list[tuple[int, int]]:
    """Find where a motion that goes one way stands still, on its way or at its ends.

    Parameters
    ----------
    time, values : shape (n,), s and m, of one stroke and maybe what follows it, without NaN
    size : samples that are averaged, a small part of a stroke
    speed : that is usual, m/s

    Returns
    -------
    First sample of each stretch, and the first one behind it. Empty where the noise of the means
    hides a motion at full speed.

    Notes
    -----
    The motion stands where its means move, three times in a row or more, at less than a twentieth
    of the usual speed, or no more than their noise; five times at the ends, where a round turn is
    slow as well.
    """
    count = len(values) // size
    if count <= _AT_A_TURN:
        return []
    at = time[: count * size].reshape(count, size).mean(axis=1)
    means = values[: count * size].reshape(count, size).mean(axis=1)
    speeds = np.abs(np.diff(means)) / np.diff(at)
    noise = _SURE_OF_REST * sqrt(2.0 / size) * noise_level(values) / (size * median(np.diff(time)))
    if not speed > 3.0 * noise:
        return []
    standing_stretches = []
    for start, stop in stretches_of(speeds <= max(_STANDS * speed, noise)):
        inner = start > 0 and stop < len(speeds)
        if stop - start >= (_IN_A_ROW if inner else _AT_A_TURN):
            standing_stretches.append((start * size, (stop + 1) * size))
    return standing_stretches


def samples_at_rest(values: Floats) -> int:
    """Count the samples of a stretch before it begins to move.

    Parameters
    ----------
    values : shape (n,), evenly sampled, without NaN, from the end where nothing may move yet

    Returns
    -------
    Samples before the corner of a level that a straight line follows on; 0 where one straight line
    says it as well, as for a stretch that is all rest or all motion.

    Notes
    -----
    Least squares over all corners. The corner counts if it takes off more than 25 variances of the
    residuals from their sum of squares, and half of it: noise remembers.
    """
    count = len(values)
    if count < 5:
        return 0
    number = np.arange(count, dtype=np.float64)
    centred = values - values.mean()
    line = float(centred @ centred) - _explained(number - number.mean(), centred)
    corners = np.unique(np.linspace(1, count - 2, min(count - 2, _CORNERS)).astype(np.int64))
    ramps = np.clip(number - corners[:, None], 0.0, None)
    ramps -= ramps.mean(axis=1, keepdims=True)
    along = ramps @ centred
    left = float(centred @ centred) - along**2 / np.sum(ramps**2, axis=1)
    best = int(np.argmin(left))
    variance = max(float(left[best]), 0.0) / (count - 3)
    gain = line - float(left[best])
    return int(corners[best]) if gain > max(_SURELY * variance, _MOSTLY * line) else 0


def _explained(direction: Floats, values: Floats) -> float:
    return float(direction @ values) ** 2 / float(direction @ direction)


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
    level_jumps = []
    for at in np.flatnonzero(np.abs(steps) > least).tolist():
        before, after = speeds[max(at - _NEAR, 0) : at], speeds[at + 1 : at + 1 + _NEAR]
        if min(len(before), len(after)) < _NEAR:
            continue
        if speeds[at] > _LARGER * float(np.concatenate([before, after]).max()):
            level_jumps.append((int(known[at + 1]), float(steps[at])))
    return tuple(level_jumps)
