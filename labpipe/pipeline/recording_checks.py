"""What a careful person would see in a recording, noted or doubted before numbers are read."""

from __future__ import annotations

import numpy as np

from labpipe.pipeline.bench import Bench, Signal
from labpipe.processing.oddities import moves_at_end
from labpipe.processing.strokes import noise_level
from labpipe.records.arrays import Floats
from labpipe.records.curve import Branch, Direction

_CUT_FILES = {"truncated", "rows_differ"}
"""Notes of readers after which rows may be missing at the end."""
_ARRIVED = {Direction.LOADING: 0.005, Direction.UNLOADING: 0.02}
"""Share of the stroke within which a branch has come to where those before it ended: near the peak
the force is steep, at the end of unloading it is small."""
_MISSED = 0.02
"""Share of a branch that the record of the force may lack at its end."""


def check_end(bench: Bench, motion: Signal, branches: tuple[Branch, ...]) -> None:
    """Find where the record ends in the middle of a branch.

    Parameters
    ----------
    bench : gets `cut_at`
    motion : that the branches were split by
    branches : of the motion
    """
    if not branches:
        return
    last = branches[-1]
    if _is_unfinished(bench, motion, branches):
        ends = float(motion.time[~np.isnan(motion.values)][-1])
        bench.cut_at = {"force": ends, "displacement": ends}
    force = bench.raw[bench.force]
    known = force.time[~np.isnan(force.values)]
    until = bench.on_curve_clock(float(known[-1]), force.clock)
    missing = max(_MISSED * (last.stop_time - last.start_time), 2.0 * _apart(motion.time))
    if until < last.stop_time - missing:
        bench.cut_at["force"] = until


def _is_unfinished(bench: Bench, motion: Signal, branches: tuple[Branch, ...]) -> bool:
    """Whether the motion goes on at the last sample, and is not where it was to go."""
    last = branches[-1]
    known = ~np.isnan(motion.values[last.start :])
    time, values = motion.time[last.start :][known], motion.values[last.start :][known]
    if not moves_at_end(time, values):
        return False
    if any(note.code in _CUT_FILES for note in bench.notes):
        return True
    if len(branches) == 1:
        return not bench.is_full_stroke
    return not _arrived(motion, branches, float(values[-1]))


def _arrived(motion: Signal, branches: tuple[Branch, ...], end: float) -> bool:
    """Whether the last branch ends where those before it did, or beyond."""
    last = branches[-1]
    sense = 1.0 if end > motion.values[last.start] else -1.0
    path = sense * motion.values
    turns = [
        float(np.nanmax(path[each.start : each.stop + 1]))
        for each in branches[:-1]
        if each.direction is last.direction
    ]
    if last.direction is Direction.UNLOADING:
        turns.append(float(path[branches[0].start]))
    if not turns:
        return False
    step = abs(end - float(motion.values[last.start])) / max(1, last.stop - last.start)
    stroke = float(np.nanmax(path) - np.nanmin(path))
    near = max(_ARRIVED[last.direction] * stroke, step, 5.0 * noise_level(motion.values))
    return sense * end >= max(turns) - near


def _apart(time: Floats) -> float:
    """Seconds from sample to sample, on average."""
    return float(time[-1] - time[0]) / max(1, len(time) - 1)
