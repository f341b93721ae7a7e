"""Quality of time axes: holes, jitter, starts other than zero."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labpipe.records.arrays import Floats, median
from labpipe.records.quality import QualityNote, Severity
from labpipe.records.recording import Clock

_LONG_STEP_FACTOR = 1.5
"""Steps above this multiple of the median are holes, or jitter."""

_MIN_JITTER = 0.05
"""Relative deviation of regular steps from their median that is reported as jitter."""


TIME_VARIABLE = "time_variable"
"""Code of the note on a time axis whose long steps may be intended."""


SAMPLED_ON_EVENT = frozenset({"OnChange"})
"""Rasters that write a sample on each change: long steps are normal there."""


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
    The holes in order of time; none if the axis has fewer than three samples or a NaN.

    Notes
    -----
    A hole is a step above 1.5 medians that no neighbouring step compensates: after a late sample
    follows a short step (``rec1_253.mat``: 1.51 ms, then 0.49 ms at 1 kHz), and no sample is lost.
    """
    steps = np.diff(time)
    if len(steps) < 2 or _are_even(steps):
        return ()
    return _holes(time, steps, median(steps))


def clock_notes(clock: Clock, *, is_variable: bool = False) -> list[QualityNote]:
    """Return notes on a time axis.

    Parameters
    ----------
    clock : the time axis as exported
    is_variable : whether the program samples at a variable rate, or omits unchanged samples: long
        steps are no losses then

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
    notes = _repeat_note(steps, clock.time, where)
    if clock.name not in SAMPLED_ON_EVENT:
        notes += _step_notes(clock.time, steps, where, is_variable=is_variable)
    if clock.time[0] != 0.0:
        message = f"time starts at {clock.time[0]:.7g} s, not at 0"
        notes.append(QualityNote("time_start_not_zero", Severity.INFO, where, message))
    return notes


def _are_even(steps: Floats) -> bool:
    """Return whether the steps are so even that there are neither holes nor jitter.

    This avoids the median of millions of steps in most recordings.
    """
    shortest, longest = float(steps.min()), float(steps.max())
    return shortest > 0.0 and longest - shortest <= _MIN_JITTER * shortest


def _holes(time: Floats, steps: Floats, median: float) -> tuple[Hole, ...]:
    if not median > 0.0:
        return ()
    long = np.flatnonzero(steps > _LONG_STEP_FACTOR * median)
    lost = long[_with_shorter_neighbour(steps, long) > (1.0 + _LONG_STEP_FACTOR) * median]
    return tuple(Hole(int(i), float(time[i]), float(steps[i])) for i in lost)


def _with_shorter_neighbour(
    steps: Floats, chosen: np.ndarray[tuple[int], np.dtype[np.intp]]
) -> Floats:
    """Return each chosen step plus the shorter one of its neighbours."""
    padded = np.concatenate(([np.inf], steps, [np.inf]))
    together: Floats = steps[chosen] + np.minimum(padded[chosen], padded[chosen + 2])
    return together


def _broken_axis(time: Floats, steps: Floats, where: str) -> list[QualityNote]:
    if len(steps) and steps.min() >= 0.0 and np.isfinite(steps.max()):
        return []
    bad = np.flatnonzero(~np.isfinite(time))
    if len(bad):
        message = f"{len(bad)} time stamps are not numbers, the first at sample {bad[0] + 1}"
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


def _repeat_note(steps: Floats, time: Floats, where: str) -> list[QualityNote]:
    if not len(steps) or steps.min() > 0.0:
        return []
    same = np.flatnonzero(steps == 0.0)
    i = int(same[0])
    message = f"{len(same)} time stamps repeat the one before, first at sample {i + 2}"
    message += f" ({time[i]:.9g} s)"
    return [QualityNote("time_repeats", Severity.WARNING, where, message)]


def _step_notes(time: Floats, steps: Floats, where: str, *, is_variable: bool) -> list[QualityNote]:
    # Above this count and share of all steps, long steps are normal for the program.
    min_long_steps, min_long_share = 10, 0.05
    if len(steps) < 2:
        return []
    if _are_even(steps):
        return _nominal_note(float(steps.mean()), len(steps), where)
    typical = median(steps)
    if not typical > 0.0:
        return []
    holes = _holes(time, steps, typical)
    if is_variable and steps.max() > _LONG_STEP_FACTOR * steps.min():
        return [_variable_note(steps, typical, where, "the program samples at a variable rate")]
    if len(holes) > max(min_long_steps, min_long_share * len(steps)):
        why = f"{len(holes)} of {len(steps)} are long: the rate varies, or samples were lost"
        return [_variable_note(steps, typical, where, why, Severity.WARNING)]
    regular = np.delete(steps, [hole.after for hole in holes])
    return [
        *_hole_note(holes, typical, where),
        *_jitter_note(regular, typical, where),
        *_nominal_note(float(regular.mean()), len(steps), where),
    ]


def _variable_note(
    steps: Floats, typical: float, where: str, why: str, severity: Severity = Severity.INFO
) -> QualityNote:
    ends = f"{_duration(float(steps.min()))} to {_duration(float(steps.max()))}"
    message = f"steps from {ends} around {_duration(typical)}; {why}"
    return QualityNote(TIME_VARIABLE, severity, where, message)


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
    if max(longest - median, median - shortest) <= _MIN_JITTER * median:
        return []
    message = (
        f"steps from {_duration(shortest)} to {_duration(longest)}"
        f" around {_duration(median)} without loss"
    )
    return [QualityNote("time_jitter", Severity.INFO, where, message)]


def _nominal_note(step: float, count: int, where: str) -> list[QualityNote]:
    """Compare the mean step with the nearest round step, or step of a round rate."""
    # Relative deviation up to which the mean step has a round nominal value.
    max_nominal_deviation = 0.002
    round_steps = (float(f"{step:.1e}"), 1.0 / float(f"{1.0 / step:.1e}"))
    nominal = min(round_steps, key=lambda round_step: abs(step - round_step))
    drift = (step - nominal) * count
    if abs(drift) <= 0.5 * nominal or abs(step - nominal) > max_nominal_deviation * nominal:
        return []
    message = (
        f"mean step {1e3 * step:.6g} ms where {1e3 * nominal:.3g} ms is nominal:"
        f" sample number / rate would be wrong by {abs(drift):.3g} s at the end"
    )
    return [QualityNote("step_not_nominal", Severity.INFO, where, message)]
