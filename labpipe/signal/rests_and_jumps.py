"""Detect motion at the end of a record, rest before a motion and jumps in the level of a signal."""

from __future__ import annotations

from math import sqrt

import numpy as np

from labpipe.records.arrays import Floats, compute_median_step
from labpipe.signal.turning_points import estimate_noise_level


def moves_at_end(time: Floats, positions: Floats) -> bool:
    """Return whether a motion continues at its last sample.

    Parameters
    ----------
    time, positions : shape (n,), s and any unit; of one motion, without NaN

    Returns
    -------
    Whether a straight line through the last samples has the direction of the motion and at least
    half its mean speed; False for fewer than three samples, or equal first and last positions.

    Notes
    -----
    The line is fitted to as few samples as noise and resolution allow, but to at least three and to
    about a third of all samples at most.
    """
    # Speed at the end and its standard error, as shares of the mean speed.
    min_end_speed, max_error = 0.5, 0.15
    travel = float(positions[-1] - positions[0])
    duration = float(time[-1] - time[0])
    if len(positions) < 3 or travel == 0.0 or not duration > 0.0:
        return False
    mean_speed, steps = abs(travel) / duration, np.abs(np.diff(positions))
    resolution = float(steps[steps > 1e-9 * abs(travel)].min())
    noise_level = max(estimate_noise_level(positions), resolution / sqrt(12.0))
    time_step = compute_median_step(time)
    fit_samples, max_fit_samples = 3, len(positions) // 3
    while (
        fit_samples < max_fit_samples
        and noise_level * sqrt(12.0 / fit_samples**3) / time_step > max_error * mean_speed
    ):
        fit_samples += max(1, fit_samples // 4)
    centred_time = time[-fit_samples:] - time[-fit_samples:].mean()
    end_speed = float(centred_time @ positions[-fit_samples:]) / float(centred_time @ centred_time)
    return end_speed * float(np.sign(travel)) >= min_end_speed * mean_speed


def count_rest_samples(values: Floats) -> int:
    """Count the samples of a signal before its motion begins.

    Parameters
    ----------
    values : shape (n,), evenly sampled, without NaN; if there is a rest, it comes first

    Returns
    -------
    Number of samples before the corner between a constant level and a straight line; 0 if one
    straight line fits as well, because the signal has only rest or only motion.

    Notes
    -----
    The corner is the least-squares choice among up to 200 samples. It is accepted if it reduces the
    sum of squares about one straight line by more than 25 variances of the residuals. Since noise
    may be autocorrelated, it must also reduce this sum by more than half.
    """
    max_corners = 200
    min_gain_in_variances, min_gain_share = 25.0, 0.5
    count = len(values)
    if count < 5:
        return 0
    indices = np.arange(count, dtype=np.float64)
    centred = values - values.mean()
    line = indices - indices.mean()
    line_squares = float(centred @ centred) - float(line @ centred) ** 2 / float(line @ line)
    corners = np.unique(np.linspace(1, count - 2, min(count - 2, max_corners)).astype(np.int64))
    ramps = np.clip(indices - corners[:, None], 0.0, None)
    ramps -= ramps.mean(axis=1, keepdims=True)
    corner_squares = float(centred @ centred) - (ramps @ centred) ** 2 / np.sum(ramps**2, axis=1)
    best = int(np.argmin(corner_squares))
    best_squares = float(corner_squares[best])
    variance = max(best_squares, 0.0) / (count - 3)
    min_gain = max(min_gain_in_variances * variance, min_gain_share * line_squares)
    return int(corners[best]) if line_squares - best_squares > min_gain else 0


def find_level_jumps(time: Floats, values: Floats) -> tuple[tuple[int, float], ...]:
    """Find changes between two samples that are much faster than the three before and after.

    Parameters
    ----------
    time, values : shape (n,), s (or row numbers) and any unit; NaN are ignored, and a change across
        a gap at the usual speed is not a jump

    Returns
    -------
    Index of the first sample after each jump and size of the jump (unit of `values`), in order of
    time. A jump is not found if it is one of the first or last three changes, or if the signal
    returns within the next three.

    Notes
    -----
    A corner is not a jump, because the changes after it are as fast. The loss of force at a failure
    is a jump; the caller has to exclude it.
    """
    # Multiple of the fastest change nearby; share of the range; multiple of the noise.
    jump_speed_factor, min_jump_share, jump_noise_factor = 5.0, 0.02, 8.0
    compared_steps = 3  # on each side of a jump
    finite_samples = np.flatnonzero(~np.isnan(values))
    finite_values = values[finite_samples]
    if len(finite_values) < 2 * compared_steps + 2:
        return ()
    steps = np.diff(finite_values)
    speeds = np.abs(steps) / np.diff(time[finite_samples])
    min_jump = min_jump_share * float(np.ptp(finite_values))
    min_jump = max(min_jump, jump_noise_factor * estimate_noise_level(finite_values))
    jumps = []
    for step in np.flatnonzero(np.abs(steps) > min_jump).tolist():
        if not compared_steps <= step < len(steps) - compared_steps:
            continue
        nearby = speeds[step - compared_steps : step + compared_steps + 1]
        nearby = np.delete(nearby, compared_steps)
        if speeds[step] > jump_speed_factor * nearby.max():
            jumps.append((int(finite_samples[step + 1]), float(steps[step])))
    return tuple(jumps)
