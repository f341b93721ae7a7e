"""What a careful person would see in a recording, noted or doubted before numbers are read."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from labpipe.protocol.schema import Protocol
from labpipe.records.arrays import Floats
from labpipe.records.curve import Branch, Direction
from labpipe.records.quality import (
    Finding,
    Findings,
    QualityNote,
    Severity,
    doubtful,
    doubtful_stretches,
    worth_knowing,
)
from labpipe.records.signals import Clocks, Signal, Signals
from labpipe.signal.bad_samples import Stuck, stuck_runs
from labpipe.signal.rests_and_jumps import moves_at_end, standing_stretches
from labpipe.signal.turning_points import noise_level

_CUT_FILES = {"truncated", "rows_differ"}
"""Notes of readers after which rows may be missing at the end."""
_ARRIVED = {Direction.LOADING: 0.005, Direction.UNLOADING: 0.02}
"""Share of the stroke within which a branch has come to where those before it ended: near the peak
the force is steep, at the end of unloading it is small."""
_PARTS = 40
"""Parts of a branch that a motion is averaged over, to see where it stands."""
_BACK = 0.1
"""Share of the stroke within which a motion is back where it began; of a hold between two."""
_AT_HOME = 0.02
"""Share of the stroke within which a motion has not left yet, or has come home."""
_SHORTEST, _ROWS = 0.25, 5.0
"""s, or rows without times, that a motion stands at least to be told of."""
_MISSED = 0.02
"""Share of a branch that the record of the force may lack at its end."""


def check_channels(signals: Signals, protocol: Protocol) -> Iterator[Finding]:
    """Doubt channels that are full or frozen, there and then.

    Parameters
    ----------
    signals : the raw ones are looked at
    protocol : says which channel splits the branches, and which one joins the clocks
    """
    words = {} if protocol.curve is None else signals.quantities
    others = dict(zip(words, reversed(words), strict=True))
    for name, signal in signals.raw.items():
        other = signals.raw.get(others.get(name, ""))
        beside = other.values if other is not None and other.clock == signal.clock else None
        runs = stuck_runs(signal.time, signal.values, beside)
        quantity = words.get(name, name)
        full = [run for run in runs if run.is_end]
        if full:
            yield _full(name, signal, full, quantity)
            if getattr(protocol.align, "channel", "") == name:  # its peaks are not where they seem
                yield _full(name, signal, full, "clock", anywhere=True)
        for run in (each for each in runs if not each.is_end):
            yield _frozen(name, signal, run, quantity)
            if protocol.branches is not None and protocol.branches.channel == name:
                yield _frozen(name, signal, run, "force")  # its branches are not where they were


def _full(
    name: str, signal: Signal, runs: list[Stuck], quantity: str, *, anywhere: bool = False
) -> Finding:
    count = sum(run.stop - run.start for run in runs)
    at = " and ".join(
        f"{level:.6g} {signal.unit}"
        for level in sorted({float(signal.values[run.start]) for run in runs})
    )
    message = (
        f"{count} samples stand at {at} to the last digit, in {len(runs)} stretches, and none lies "
        "beyond: saturated? Look at the range of the amplifier"
    )
    if anywhere:
        return doubtful(quantity, code="saturation", message=message, where=name)
    when = tuple(_times(signal, run) for run in runs)
    note = QualityNote("saturation", Severity.WARNING, name, message, when)
    return doubtful_stretches(quantity, note, signal.clock)


def _frozen(name: str, signal: Signal, run: Stuck, quantity: str) -> Finding:
    when = _times(signal, run)
    unit = "s" if signal.has_time else "of the samples"
    message = (
        f"stands at {float(signal.values[run.start]):.6g} {signal.unit} to the last digit from "
        f"{when[0]:.3f} to {when[1]:.3f} {unit} while the test goes on: frozen"
    )
    note = QualityNote("frozen_channel", Severity.WARNING, name, message, (when,))
    return doubtful_stretches(quantity, note, signal.clock)


def _times(signal: Signal, run: Stuck) -> tuple[float, float]:
    """From the last sample before a run to the first one behind it."""
    first, last = max(run.start - 1, 0), min(run.stop, len(signal.time) - 1)
    return float(signal.time[first]), float(signal.time[last])


def cut_at(
    signals: Signals,
    clocks: Clocks,
    motion: Signal,
    branches: tuple[Branch, ...],
    *,
    is_full_stroke: bool,
    is_cut_file: bool,
) -> dict[str, float]:
    """Find where the record ends in the middle of a branch.

    Parameters
    ----------
    signals, clocks : of the test
    motion : that the branches were split by
    branches : of the motion
    is_full_stroke : whether the motion went as far as the rig was told to
    is_cut_file : whether a reader saw that the end of an export may be missing

    Returns
    -------
    By quantity, s on the clock of the curve; nothing where the record goes on to its end.
    """
    if not branches:
        return {}
    last, ends = branches[-1], dict[str, float]()
    if _is_unfinished(motion, branches, is_full_stroke=is_full_stroke, is_cut_file=is_cut_file):
        end = float(motion.time[~np.isnan(motion.values)][-1])
        ends = {"force": end, "displacement": end}
    force = signals.raw[signals.force]
    known = force.time[~np.isnan(force.values)]
    until = clocks.to_curve(float(known[-1]), force.clock)
    missing = max(_MISSED * (last.stop_time - last.start_time), 2.0 * _apart(motion.time))
    return ends | {"force": until} if until < last.stop_time - missing else ends


def file_is_cut(findings: Findings) -> bool:
    """Whether a reader saw that rows may be missing at the end of an export."""
    return any(each.code in _CUT_FILES for each in findings.found)


def holds(where: str, motion: Signal, branches: tuple[Branch, ...]) -> Iterator[Finding]:
    """Say where the motion stands in the middle of the test, and for how long.

    Parameters
    ----------
    where : name of the displacement
    motion : that the branches were split by
    branches : of the motion; the rests before the first and where it began are no part of it
    """
    unit, least = ("s", _SHORTEST) if motion.has_time else ("rows", _ROWS)
    seen = _holds(motion, branches) if branches else []
    held = [each for each in seen if each[1] - each[0] >= least]
    if not held:
        return
    lasts = sorted({f"{stop - start:.4g}" for start, stop in held}, key=float)
    how_long = lasts[0] if len(lasts) == 1 else f"{lasts[0]} to {lasts[-1]}"
    often = "once" if len(held) == 1 else f"{len(held)} times"
    place = float(np.interp(sum(held[0]) / 2.0, motion.time, motion.values))
    message = (
        f"the motion stands {often} in the middle of the test, for {how_long} {unit}; first at "
        f"{1e3 * place:.4g} mm, from {held[0][0]:.4g} {unit} on"
    )
    yield worth_knowing("hold", where, message)


def _holds(motion: Signal, branches: tuple[Branch, ...]) -> list[tuple[float, float]]:
    """Begin and end, s, of what stands between branches, on their way, and behind the last one."""
    found = [(before.stop_time, after.start_time) for before, after in pairwise(branches)]
    size = max(1, int(np.median([each.stop - each.start for each in branches])) // _PARTS)
    speed = float(np.median([_speed(motion, each) for each in branches]))
    stroke, began = np.ptp(motion.values[~np.isnan(motion.values)]), branches[0].start
    for branch in branches:
        goes_on = branch is branches[-1] and not _is_back(motion, branches[0])
        part = slice(branch.start, None if goes_on else branch.stop)
        outer = branch in (branches[0], branches[-1])
        known = ~np.isnan(motion.values[part])
        time, values = motion.time[part][known], motion.values[part][known]
        for start, stop in standing_stretches(time, values, size=size, speed=speed):
            away = abs(float(np.median(values[start:stop]) - motion.values[began]))
            if not outer or away > _AT_HOME * stroke:  # a rest before or behind the test is none
                found.append((float(time[start]), float(time[stop - 1])))
    return _merged(found)


def _speed(motion: Signal, branch: Branch) -> float:
    """Speed over the faster half of a branch, m/s."""
    part = motion.values[branch.start : branch.stop : max(1, (branch.stop - branch.start) // 10)]
    lasts = (branch.stop_time - branch.start_time) / max(1, len(part) - 1)
    steps = np.abs(np.diff(part))
    steps = np.sort(steps[~np.isnan(steps)])
    return float(np.median(steps[len(steps) // 2 :])) / lasts if len(steps) and lasts else 0.0


def _merged(found: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Stretches in order; those that nearly touch are one."""
    merged: list[tuple[float, float]] = []
    for start, stop in sorted(found):
        if merged and start - merged[-1][1] <= _BACK * (stop - start):
            merged[-1] = (merged[-1][0], max(stop, merged[-1][1]))
        else:
            merged.append((start, stop))
    return merged


def _is_back(motion: Signal, first: Branch) -> bool:
    """Whether the motion ends about where it began, so that it rests there."""
    known = motion.values[~np.isnan(motion.values)]
    away = abs(float(known[-1] - motion.values[first.start]))
    return away <= _BACK * float(np.ptp(known))


def _is_unfinished(
    motion: Signal, branches: tuple[Branch, ...], *, is_full_stroke: bool, is_cut_file: bool
) -> bool:
    """Whether the motion goes on at the last sample, and is not where it was to go."""
    last = branches[-1]
    known = ~np.isnan(motion.values[last.start :])
    time, values = motion.time[last.start :][known], motion.values[last.start :][known]
    if not moves_at_end(time, values):
        return False
    if is_cut_file:
        return True
    if len(branches) == 1:
        return not is_full_stroke
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
