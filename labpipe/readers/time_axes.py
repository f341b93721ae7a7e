"""Time axes of exports: holes, jitter, odd starts; what a careful person would want to know."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labpipe.records.arrays import Floats, median
from labpipe.records.quality import QualityNote, Severity
from labpipe.records.recording import Clock

LONG_STEP = 1.5
"""A step above this many medians is a hole, or jitter."""

JITTER = 0.05
"""Regular steps further than this from their median (relative) are called jitter."""

ROUND = 0.002
"""A mean step this close (relative) to a round one was meant to be that one."""

VARIABLE = "time_variable"
"""Note on a time axis whose long steps need not be losses."""

_SOME, _MANY = 10, 0.05
"""Long steps, and their share of all, beyond which they are how the program samples."""

SAMPLED_ON_EVENT = frozenset({"OnChange"})
"""Rasters that write a sample when something changes: long steps mean nothing there."""


@dataclass(frozen=True, slots=True)
class Hole:
    """A stretch of a time axis in which samples were lost.

    Parameters
    ----------
    after : number of the last sample before it, counted from 0
    at : s, time of that sample
    length : s, from that sample to the next one
    """

    after: int
    at: float
    length: float


def find_holes(time: Floats) -> tuple[Hole, ...]:
    """Find where samples were lost.

    Parameters
    ----------
    time : shape (n,), s

    Returns
    -------
    The holes in order of time; none if the axis holds fewer than three samples or a NaN.

    Notes
    -----
    A hole is a step above 1.5 medians that no neighbouring step makes up for: a sample that came
    late is followed by a short step (``rec1_253.mat``: 1.51 ms, then 0.49 ms at 1 kHz), and
    nothing was lost there.
    """
    steps = np.diff(time)
    if len(steps) < 2 or _is_even(steps):
        return ()
    return _holes(time, steps, median(steps))


def clock_notes(clock: Clock, *, is_variable: bool = False) -> list[QualityNote]:
    """Say what is odd about a time axis.

    Parameters
    ----------
    clock : the time axis as the export holds it
    is_variable : whether the program that wrote it samples at a rate that varies, or leaves out
        what says nothing new: a long step is no loss then

    Returns
    -------
    Notes ``clock_empty``, ``time_not_finite``, ``time_not_increasing`` (both errors: the axis
    cannot be used), ``time_repeats``, ``time_holes``, ``time_variable``, ``time_jitter``,
    ``step_not_nominal``, ``time_start_not_zero``.
    """
    where = f"clock {clock.name}"
    if len(clock.time) == 0:
        return [QualityNote("clock_empty", Severity.WARNING, where, "it has no samples")]
    steps = np.diff(clock.time)
    broken = _broken_axis(clock.time, steps, where)
    if broken:
        return broken
    notes = _repeats(steps, clock.time, where)
    if clock.name not in SAMPLED_ON_EVENT:
        notes += _step_notes(clock.time, steps, where, is_variable=is_variable)
    if clock.time[0] != 0.0:
        message = f"time starts at {clock.time[0]:.7g} s, not at 0"
        notes.append(QualityNote("time_start_not_zero", Severity.INFO, where, message))
    return notes


def _is_even(steps: Floats) -> bool:
    """Check whether all steps are so alike that neither holes nor jitter can be among them.

    This spares the median of millions of steps on the axes of most recordings.
    """
    shortest, longest = float(steps.min()), float(steps.max())
    return shortest > 0.0 and longest - shortest <= JITTER * shortest


def _holes(time: Floats, steps: Floats, median: float) -> tuple[Hole, ...]:
    if not median > 0.0:
        return ()
    long = np.flatnonzero(steps > LONG_STEP * median)
    lost = long[_with_shorter_neighbour(steps, long) > (1.0 + LONG_STEP) * median]
    return tuple(Hole(int(i), float(time[i]), float(steps[i])) for i in lost)


def _with_shorter_neighbour(
    steps: Floats, chosen: np.ndarray[tuple[int], np.dtype[np.intp]]
) -> Floats:
    """Each chosen step plus the shorter of the steps beside it."""
    padded = np.concatenate(([np.inf], steps, [np.inf]))
    together: Floats = steps[chosen] + np.minimum(padded[chosen], padded[chosen + 2])
    return together


def _broken_axis(time: Floats, steps: Floats, where: str) -> list[QualityNote]:
    if len(steps) and steps.min() >= 0.0 and np.isfinite(steps.max()):
        return []
    bad = np.flatnonzero(~np.isfinite(time))
    if len(bad):
        message = f"{len(bad)} time stamps are no numbers, the first at sample {bad[0] + 1}"
        return [QualityNote("time_not_finite", Severity.ERROR, where, message)]
    back = np.flatnonzero(steps < 0.0)
    if len(back):
        i = int(back[0])
        message = (
            f"time runs backwards {len(back)} times, first at sample {i + 2}:"
            f" {time[i + 1]:.9g} s after {time[i]:.9g} s"
        )
        return [QualityNote("time_not_increasing", Severity.ERROR, where, message)]
    return []


def _repeats(steps: Floats, time: Floats, where: str) -> list[QualityNote]:
    if not len(steps) or steps.min() > 0.0:
        return []
    same = np.flatnonzero(steps == 0.0)
    i = int(same[0])
    message = f"{len(same)} time stamps repeat the one before, first at sample {i + 2}"
    message += f" ({time[i]:.9g} s)"
    return [QualityNote("time_repeats", Severity.WARNING, where, message)]


def _step_notes(time: Floats, steps: Floats, where: str, *, is_variable: bool) -> list[QualityNote]:
    if len(steps) < 2:
        return []
    if _is_even(steps):
        return _nominal_note(float(steps.mean()), len(steps), where)
    usual = median(steps)
    if not usual > 0.0:
        return []
    holes = _holes(time, steps, usual)
    if is_variable and steps.max() > LONG_STEP * steps.min():
        return [_varying(steps, usual, where, "the program samples at a rate that varies")]
    if len(holes) > max(_SOME, _MANY * len(steps)):
        why = (
            f"{len(holes)} of {len(steps)} are longer than usual: the rate varies, or samples were"
        )
        why += " lost"
        return [_varying(steps, usual, where, why, Severity.WARNING)]
    regular = np.delete(steps, [hole.after for hole in holes])
    return [
        *_hole_note(holes, usual, where),
        *_jitter_note(regular, usual, where),
        *_nominal_note(float(regular.mean()), len(steps), where),
    ]


def _varying(
    steps: Floats, usual: float, where: str, why: str, severity: Severity = Severity.INFO
) -> QualityNote:
    ends = f"{_duration(float(steps.min()))} to {_duration(float(steps.max()))}"
    message = f"steps from {ends} around {_duration(usual)}; {why}"
    return QualityNote(VARIABLE, severity, where, message)


def _hole_note(holes: tuple[Hole, ...], median: float, where: str) -> list[QualityNote]:
    if not holes:
        return []
    lengths = [hole.length for hole in holes]
    lost = sum(round(length / median) - 1 for length in lengths)
    first = ", ".join(f"{hole.at:.6g} s" for hole in holes[:3])
    message = (
        f"{len(holes)} holes of {_duration(min(lengths))} to {_duration(max(lengths))},"
        f" about {lost} samples lost, first at {first}"
    )
    return [QualityNote("time_holes", Severity.WARNING, where, message)]


def _duration(seconds: float) -> str:
    return f"{seconds:.4g} s" if seconds >= 1.0 else f"{1e3 * seconds:.4g} ms"


def _jitter_note(regular: Floats, median: float, where: str) -> list[QualityNote]:
    shortest, longest = float(regular.min()), float(regular.max())
    if max(longest - median, median - shortest) <= JITTER * median:
        return []
    message = (
        f"steps from {_duration(shortest)} to {_duration(longest)}"
        f" around {_duration(median)} without loss"
    )
    return [QualityNote("time_jitter", Severity.INFO, where, message)]


def _nominal_note(step: float, count: int, where: str) -> list[QualityNote]:
    """Compare the mean step with the round step, or step of a round rate, that was meant."""
    round_steps = (float(f"{step:.1e}"), 1.0 / float(f"{1.0 / step:.1e}"))
    nominal = min(round_steps, key=lambda round_step: abs(step - round_step))
    drift = (step - nominal) * count
    if abs(drift) <= 0.5 * nominal or abs(step - nominal) > ROUND * nominal:
        return []
    message = (
        f"mean step {1e3 * step:.6g} ms where {1e3 * nominal:.3g} ms is nominal:"
        f" sample number / rate would be wrong by {abs(drift):.3g} s at the end"
    )
    return [QualityNote("step_not_nominal", Severity.INFO, where, message)]
