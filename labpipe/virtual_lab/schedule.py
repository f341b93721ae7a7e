"""When the clamp moves: progress along the path as a function of marker time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labpipe.records.arrays import Floats
from labpipe.virtual_lab.scenario import CantileverScenario


@dataclass(frozen=True, slots=True, eq=False)
class Schedule:
    """The motion of the clamp and the two recordings around it, in marker time.

    Parameters
    ----------
    corners : shape (n,), s, where the motion starts or stops
    progress : shape (n,), m, at those times
    turning_times : shape (2 cycles + 1,), s: start, first top, first return, ... last return; with
        a dwell, the beginning of the dwell
    frame_times : shape (frames,), s, of the cameras
    force_clock : shape (samples,), s, the recorder's own time axis
    force_times : shape (samples,), s, the same instants in marker time
    """

    corners: Floats
    progress: Floats
    turning_times: Floats
    frame_times: Floats
    force_clock: Floats
    force_times: Floats

    def progress_at(self, times: Floats) -> Floats:
        """Progress, m, at marker times, s; before the motion zero, after it all of it."""
        return np.interp(times, self.corners, self.progress)


def plan(scenario: CantileverScenario) -> Schedule:
    """Lay out motion and recordings so that both records rest long enough at both ends.

    Parameters
    ----------
    scenario : speed, dwell, rest, clocks and stroke are used

    Returns
    -------
    The schedule. Both records begin at zero on their own clock.
    """
    clocks, stroke = scenario.clocks, scenario.mechanics.stroke
    force_begins = -clocks.offset / (1.0 + clocks.drift)
    start = max(0.0, force_begins) + scenario.rest
    strokes = np.arange(2 * scenario.mechanics.cycles + 1)
    travelling = stroke / scenario.speed
    arrivals = start + strokes * travelling + np.maximum(strokes - 1, 0) * scenario.dwell
    departures = arrivals + scenario.dwell * ((strokes > 0) & (strokes < strokes[-1]))
    end = arrivals[-1] + scenario.rest
    frames = int(np.ceil(end * clocks.fps)) + 1
    step = clocks.step_ratio / clocks.rate
    samples = int(np.ceil((end - force_begins) * (1.0 + clocks.drift) / step)) + 1
    force_clock: Floats = step * np.arange(samples, dtype=np.float64)
    force_times: Floats = (force_clock - clocks.offset) / (1.0 + clocks.drift)
    return Schedule(
        corners=np.ravel(np.column_stack([arrivals, departures])),
        progress=np.repeat(strokes * stroke, 2),
        turning_times=arrivals,
        frame_times=np.arange(frames) / clocks.fps,
        force_clock=force_clock,
        force_times=force_times,
    )
