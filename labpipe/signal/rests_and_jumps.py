"""Detect rests before a motion, motion at the end of a record, and jumps of a signal's level."""

from __future__ import annotations

from math import sqrt

import numpy as np

from labpipe.records.arrays import Floats, median
from labpipe.signal.turning_points import estimate_noise_level


def moves_at_end(time: Floats, values: Floats) -> bool:
    """Return whether a motion continues at the last sample of a stretch.

    Parameters
    ----------
    time, values : shape (n,), s and any unit, of the stretch, without NaN

    Returns
    -------
    Whether a straight line through the last samples has the direction of the whole stretch and at
    least half its mean speed. It uses as few samples as noise and resolution allow, but at least
    three and at most a third. False without motion.
    """
    # Shares of the mean speed.
    min_end_speed, max_error = 0.5, 0.15
    travel = float(values[-1] - values[0])
    duration = float(time[-1] - time[0])
    if len(values) < 3 or travel == 0.0 or not duration > 0.0:
        return False
    speed, steps = abs(travel) / duration, np.abs(np.diff(values))
    resolution = float(steps[steps > 1e-9 * abs(travel)].min())
    noise = max(estimate_noise_level(values), resolution / sqrt(12.0))
    time_step, size = median(np.diff(time)), 3
    while size < len(values) // 3 and noise * sqrt(12.0 / size**3) / time_step > max_error * speed:
        size += max(1, size // 4)
    centred_time = time[-size:] - time[-size:].mean()
    slope = float(centred_time @ values[-size:]) / float(centred_time @ centred_time)
    return slope * float(np.sign(travel)) >= min_end_speed * speed


def count_rest_samples(values: Floats) -> int:
    """Count the samples of a stretch before its motion begins.

    Parameters
    ----------
    values : shape (n,), evenly sampled, without NaN, beginning at the end that may be at rest

    Returns
    -------
    Samples before the corner between a level and a straight line; 0 if one straight line fits as
    well, as for a stretch of only rest or only motion.

    Notes
    -----
    Least squares over up to 200 corners. The corner counts if it reduces the sum of squares about
    one line by more than 25 variances of the residuals and by more than half, since noise may be
    autocorrelated.
    """
    max_corners = 200
    min_variances, min_share = 25.0, 0.5
    count = len(values)
    if count < 5:
        return 0
    number = np.arange(count, dtype=np.float64)
    centred = values - values.mean()
    ramp = number - number.mean()
    line = float(centred @ centred) - float(ramp @ centred) ** 2 / float(ramp @ ramp)
    corners = np.unique(np.linspace(1, count - 2, min(count - 2, max_corners)).astype(np.int64))
    ramps = np.clip(number - corners[:, None], 0.0, None)
    ramps -= ramps.mean(axis=1, keepdims=True)
    along = ramps @ centred
    residual_squares = float(centred @ centred) - along**2 / np.sum(ramps**2, axis=1)
    best = int(np.argmin(residual_squares))
    variance = max(float(residual_squares[best]), 0.0) / (count - 3)
    gain = line - float(residual_squares[best])
    return int(corners[best]) if gain > max(min_variances * variance, min_share * line) else 0


def find_level_jumps(time: Floats, values: Floats) -> tuple[tuple[int, float], ...]:
    """Find steps that are far larger than the steps before and after them.

    Parameters
    ----------
    time, values : shape (n,), s (or row numbers) and any unit; NaN are ignored, and a change across
        a gap at the usual speed is no jump

    Returns
    -------
    First sample after each jump, and its size in the unit of `values`, in order. None within three
    samples of the ends, nor if the signal returns within three samples.

    Notes
    -----
    A corner also changes the later steps, so it is no jump. The loss of force at a failure is a
    jump; the caller has to exclude it.
    """
    # Multiple of the fastest neighbouring step; share of the range; multiple of the noise.
    jump_speed_factor, min_jump_share, jump_noise_factor = 5.0, 0.02, 8.0
    neighbours = 3  # steps on each side that a jump is compared with
    valid = np.flatnonzero(~np.isnan(values))
    v = values[valid]
    if len(v) < 2 * neighbours + 2:
        return ()
    steps = np.diff(v)
    speeds = np.abs(steps) / np.diff(time[valid])
    min_step = max(min_jump_share * float(np.ptp(v)), jump_noise_factor * estimate_noise_level(v))
    jumps = []
    for sample in np.flatnonzero(np.abs(steps) > min_step).tolist():
        speeds_before = speeds[max(sample - neighbours, 0) : sample]
        speeds_after = speeds[sample + 1 : sample + 1 + neighbours]
        if min(len(speeds_before), len(speeds_after)) < neighbours:
            continue
        if speeds[sample] > jump_speed_factor * float(
            np.concatenate([speeds_before, speeds_after]).max()
        ):
            jumps.append((int(valid[sample + 1]), float(steps[sample])))
    return tuple(jumps)
