"""Curvature and moment at places along the specimen in all branches, each with its errors."""

from __future__ import annotations

import numpy as np

from labpipe.processing.bending_moments import Bent, bent, curvature_gain
from labpipe.processing.bending_test import BendingTest, FittedFrames
from labpipe.records.arrays import Floats
from labpipe.records.bending import BendingCloud

ROWS = 50
"""Rows of the cloud in the first loading."""
STATIONS = 17
"""Places along the specimen."""


def bending_cloud(test: BendingTest) -> BendingCloud:
    """Tell curvature and moment, less those at rest.

    Parameters
    ----------
    test : shapes and force

    Returns
    -------
    One row per mean over consecutive frames of a branch: about `ROWS` in the first loading, over as
    many frames in the other branches. A mean without shape or force is left out.

    Raises
    ------
    ValueError
        If fewer than two frames at rest show all markers, or no mean has shape and force.

    Notes
    -----
    M(s) = Py (x_L - x(s)) - Px (y_L - y(s)), the force of `TipPull` at the tip (x_L, y_L). Errors
    of the curvature from the noise of the markers take it to be independent from frame to frame.
    """
    count = int((test.branch == test.first).sum())
    frames = test.frames(test.branch, per_mean=max(1, count // ROWS))
    length, rest, means = test.layout.length, test.standing, frames.means
    places = np.linspace(0.0, length, STATIONS)
    now = bent(frames.coefficients, length, places)
    curvature = now.curvature - bent(rest.coefficients, length, places).curvature
    moment = test.moments(frames.coefficients, means.force, places)
    at_rest = test.moments(rest.coefficients, np.zeros(1), places)[0]
    share = np.sqrt(1.0 / means.per_mean + 1.0 / rest.frames)
    gain = curvature_gain(test.layout, means.markers, now, places)
    return BendingCloud(
        time=means.time,
        branch=means.branch,
        cycle=test.cycle[np.searchsorted(test.shape.time, means.time)],
        force=means.force,
        arc_length=places,
        curvature=curvature,
        curvature_error=rest.noise * share * gain,
        curvature_systematic=_systematic(test, frames, places, curvature),
        moment=moment - at_rest,
        moment_error=_moment_errors(test, frames, now, moment - at_rest),
        moment_at_rest=at_rest,
        frames_per_mean=means.per_mean,
    )


def _systematic(
    test: BendingTest, frames: FittedFrames, places: Floats, curvature: Floats
) -> Floats:
    """What one coefficient more makes of the curvatures, in absolute value."""
    if frames.finer is None:
        return np.full(curvature.shape, np.nan)
    finer = bent(frames.finer, test.layout.length, places).curvature
    still = bent(test.standing.finer, test.layout.length, places).curvature
    return np.asarray(np.abs(finer - still - curvature), dtype=np.float64)


def _moment_errors(test: BendingTest, frames: FittedFrames, now: Bent, moment: Floats) -> Floats:
    """Standard errors of moments, shape (n, stations), N m: force, zero, scale, places."""
    errors, means = test.errors, frames.means
    lever = now.x[:, -1:] - now.x
    push = np.hypot(errors.force_zero, errors.force_noise / np.sqrt(means.per_mean))
    noise = test.standing.noise * frames.tip_gain / np.sqrt(means.per_mean)
    place = np.hypot(errors.offset, noise) * means.force
    squares = (push * lever) ** 2 + (errors.force_scale * moment) ** 2 + place[:, None] ** 2
    return np.asarray(np.sqrt(squares), dtype=np.float64)
