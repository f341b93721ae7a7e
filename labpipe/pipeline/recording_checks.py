"""What a careful person would see in a recording, noted or doubted before numbers are read."""

from __future__ import annotations

import numpy as np

from labpipe.pipeline.bench import Bench, Signal
from labpipe.processing.oddities import moves_at_end
from labpipe.processing.strokes import noise_level
from labpipe.processing.stuck_channels import Stuck, stuck_runs
from labpipe.protocol.schema import Protocol
from labpipe.records.arrays import Floats
from labpipe.records.curve import Branch, Direction
from labpipe.records.quality import QualityNote, Severity

_CUT_FILES = {"truncated", "rows_differ"}
"""Notes of readers after which rows may be missing at the end."""
_ARRIVED = {Direction.LOADING: 0.005, Direction.UNLOADING: 0.02}
"""Share of the stroke within which a branch has come to where those before it ended: near the peak
the force is steep, at the end of unloading it is small."""
_MISSED = 0.02
"""Share of a branch that the record of the force may lack at its end."""


def check_channels(bench: Bench, protocol: Protocol) -> None:
    """Doubt channels that are full or frozen, there and then.

    Parameters
    ----------
    bench : its raw signals are looked at; gets the doubts
    protocol : says which channels make the curve, and which one joins the clocks
    """
    curve = protocol.curve
    words = {} if curve is None else {curve.force: "force", curve.displacement: "displacement"}
    others = dict(zip(words, reversed(words), strict=True))
    for name, signal in bench.raw.items():
        other = bench.raw.get(others.get(name, ""))
        beside = other.values if other is not None and other.clock == signal.clock else None
        runs = stuck_runs(signal.time, signal.values, beside)
        joins = getattr(protocol.align, "channel", "") == name
        full = [run for run in runs if run.is_end]
        if full:
            _doubt_full(bench, name, full, words.get(name, name), joins=joins)
        for run in (each for each in runs if not each.is_end):
            _doubt_frozen(bench, name, run, words.get(name, name))
            if protocol.branches is not None and protocol.branches.channel == name:
                _doubt_frozen(bench, name, run, "force")  # its branches are not where they were


def _doubt_full(bench: Bench, name: str, runs: list[Stuck], quantity: str, *, joins: bool) -> None:
    signal = bench.raw[name]
    count = sum(run.stop - run.start for run in runs)
    at = " and ".join(
        f"{level:.6g} {signal.unit}"
        for level in sorted({float(signal.values[run.start]) for run in runs})
    )
    message = (
        f"{count} samples stand at {at} to the last digit, in {len(runs)} stretches, and none lies "
        "beyond: saturated? Look at the range of the amplifier"
    )
    when = tuple(_times(signal, run) for run in runs)
    note = QualityNote("saturation", Severity.WARNING, name, message, when)
    bench.doubt_stretches(quantity, note, signal.clock)
    if joins:  # its peaks are not where they seem to be
        bench.doubt("clock", "saturation", message, where=name)


def _doubt_frozen(bench: Bench, name: str, run: Stuck, quantity: str) -> None:
    signal = bench.raw[name]
    when = _times(signal, run)
    unit = "s" if signal.has_time else "of the samples"
    message = (
        f"stands at {float(signal.values[run.start]):.6g} {signal.unit} to the last digit from "
        f"{when[0]:.3f} to {when[1]:.3f} {unit} while the test goes on: frozen"
    )
    note = QualityNote("frozen_channel", Severity.WARNING, name, message, (when,))
    bench.doubt_stretches(quantity, note, signal.clock)


def _times(signal: Signal, run: Stuck) -> tuple[float, float]:
    """From the last sample before a run to the first one behind it."""
    first, last = max(run.start - 1, 0), min(run.stop, len(signal.time) - 1)
    return float(signal.time[first]), float(signal.time[last])


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
    """Whether the last branch ends where the one before it did, or beyond."""
    last = branches[-1]
    sense = 1.0 if end > motion.values[last.start] else -1.0
    path = sense * motion.values
    turns = [
        float(np.nanmax(path[each.start : each.stop + 1]))
        for each in branches[:-1]
        if each.direction is last.direction
    ]
    if last.direction is Direction.UNLOADING:
        turns.insert(0, float(path[branches[0].start]))
    if not turns:
        return False
    step = abs(end - float(motion.values[last.start])) / max(1, last.stop - last.start)
    stroke = float(np.nanmax(path) - np.nanmin(path))
    near = max(_ARRIVED[last.direction] * stroke, step, 5.0 * noise_level(motion.values))
    return sense * end >= turns[-1] - near


def _apart(time: Floats) -> float:
    """Seconds from sample to sample, on average."""
    return float(time[-1] - time[0]) / max(1, len(time) - 1)
