"""What really happened in a virtual test, for whoever checks the processing against it.

Frames and signs are those of `virtual_lab.scenario`; everything is on the marker clock, in SI.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.interpolate import CubicSpline

from labpipe.records.arrays import Floats
from labpipe.virtual_lab.mechanics import MechanicalPath
from labpipe.virtual_lab.schedule import Schedule

_SHAPE_POINTS = 41
_STEPS = 20_001
_NO_FORCE = 1e-9


@dataclass(frozen=True, slots=True)
class CycleTruth:
    """One cycle; lengths in m, times in s on the marker clock.

    Parameters
    ----------
    cycle : counted from 1
    start_time, top_time, stop_time : when the clamp starts down, turns, and is back
    peak_force, peak_deflection : N, m, the largest of the cycle
    residual_deflection : m, where the force has come back to zero on unloading; None if it does not
    energy : J, integral of force over deflection from the start of the cycle to its end
    """

    cycle: int
    start_time: float
    top_time: float
    stop_time: float
    peak_force: float
    peak_deflection: float
    residual_deflection: float | None
    energy: float


@dataclass(frozen=True, slots=True, eq=False)
class ShapeTruth:
    """The wire's axis in the specimen frame in one frame of the take; arrays of shape (points,).

    Parameters
    ----------
    frame : frame of the take
    arc_length, x, y : m
    """

    frame: int
    arc_length: Floats
    x: Floats
    y: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """What really happened; arrays at the camera frames, shape (frames,).

    Parameters
    ----------
    time : s, marker clock
    travel, deflection : m
    force : N
    cycles : one by one
    shapes : at several frames, evenly spread over each branch
    """

    time: Floats
    travel: Floats
    deflection: Floats
    force: Floats
    cycles: tuple[CycleTruth, ...]
    shapes: tuple[ShapeTruth, ...]


def tell_truth(path: MechanicalPath, schedule: Schedule) -> Truth:
    """Look up what really happened at every camera frame and in every cycle.

    Parameters
    ----------
    path : the solved test
    schedule : when what happens

    Returns
    -------
    The truth.
    """
    progress = schedule.progress_at(schedule.frame_times)
    cycles = range(1, path.test.cycles + 1)
    return Truth(
        time=schedule.frame_times,
        travel=path.travel(progress),
        deflection=path.deflection(progress),
        force=path.tension(progress) - path.rest.tension,
        cycles=tuple(_cycle(path, schedule, number) for number in cycles),
        shapes=tuple(_shapes(path, schedule)),
    )


def _cycle(path: MechanicalPath, schedule: Schedule, number: int) -> CycleTruth:
    start, top, stop = schedule.turning_times[2 * number - 2 : 2 * number + 1]
    stroke = path.test.stroke
    progress = 2.0 * stroke * (number - 1) + np.linspace(0.0, 2.0 * stroke, _STEPS)
    force = path.tension(progress) - path.rest.tension
    deflection = path.deflection(progress)
    return CycleTruth(
        cycle=number,
        start_time=float(start),
        top_time=float(top),
        stop_time=float(stop),
        peak_force=float(np.max(force)),
        peak_deflection=float(np.max(deflection)),
        residual_deflection=_residual(path, number),
        energy=float(np.trapezoid(force, deflection)),
    )


def _residual(path: MechanicalPath, number: int) -> float | None:
    """Deflection where the force first comes back to zero on unloading."""
    for segment in path.segments:
        if segment.cycle != number or segment.loading or segment.is_still:
            continue
        if segment.tension[-1] > path.rest.tension + _NO_FORCE:
            return None
        where = float(segment.progress[-1])
        if segment.tension[-1] < path.rest.tension - _NO_FORCE:
            crossing = CubicSpline(segment.progress, segment.tension - path.rest.tension)
            where = float(crossing.roots(extrapolate=False)[0])
        return float(path.deflection(np.array([where]))[0])
    return None


def _shapes(path: MechanicalPath, schedule: Schedule) -> list[ShapeTruth]:
    arc_length = np.linspace(0.0, path.test.length, _SHAPE_POINTS)
    turns = schedule.turning_times
    times = [np.linspace(a, b, 6) for a, b in pairwise(turns)]
    frames = np.unique(np.searchsorted(schedule.frame_times, np.concatenate(times)))
    progress = schedule.progress_at(schedule.frame_times[frames])
    x, y, _ = path.points(progress, arc_length)
    return [ShapeTruth(int(frame), arc_length, x[row], y[row]) for row, frame in enumerate(frames)]
