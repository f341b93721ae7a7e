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
    time, steps = clock.time, np.diff(clock.time)
    if len(time) == 0:
        return [_note(clock, "clock_empty", "it has no samples", Severity.WARNING)]
    notes = []
    if not (len(steps) == 0 or (steps.min() >= 0.0 and np.isfinite(steps.max()))):
        bad, back = np.flatnonzero(~np.isfinite(time)), np.flatnonzero(steps < 0.0)
        if len(bad):
            message = f"{len(bad)} time stamps are not numbers, the first at sample {bad[0] + 1}"
            return [_note(clock, "time_not_finite", message, Severity.ERROR)]
        if len(back):
            i = int(back[0])
            message = f"time runs backwards {len(back)} times, first at sample {i + 2}:"
            message += f" {time[i + 1]:.9g} s after {time[i]:.9g} s"
            return [_note(clock, "time_not_increasing", message, Severity.ERROR)]
    same = np.flatnonzero(steps == 0.0)
    if len(same):
        message = f"{len(same)} time stamps repeat the one before, first at sample {same[0] + 2}"
        message += f" ({time[same[0]]:.9g} s)"
        notes.append(_note(clock, "time_repeats", message, Severity.WARNING))
    if clock.name not in SAMPLED_ON_EVENT and len(steps) > 1:
        notes += _step_notes(clock, steps, is_variable=is_variable)
    if time[0] != 0.0:
        message = f"time starts at {time[0]:.7g} s, not at 0"
        notes.append(_note(clock, "time_start_not_zero", message))
    return notes


def _note(clock: Clock, code: str, message: str, severity: Severity = Severity.INFO) -> QualityNote:
    return QualityNote(code, severity, f"clock {clock.name}", message)


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
    padded = np.concatenate(([np.inf], steps, [np.inf]))
    with_neighbour = steps[long] + np.minimum(padded[long], padded[long + 2])
    lost = long[with_neighbour > (1.0 + _LONG_STEP_FACTOR) * median]
    return tuple(Hole(int(i), float(time[i]), float(steps[i])) for i in lost)


def _step_notes(clock: Clock, steps: Floats, *, is_variable: bool) -> list[QualityNote]:
    # Above this count and share of all steps, long steps are normal for the program.
    min_long_steps, min_long_share = 10, 0.05
    if _are_even(steps):
        return _nominal_note(clock, steps, len(steps))
    typical = median(steps)
    if not typical > 0.0:
        return []
    holes = _holes(clock.time, steps, typical)
    if is_variable and steps.max() > _LONG_STEP_FACTOR * steps.min():
        message = f"{_range_text(steps, typical)}; the program samples at a variable rate"
        return [_note(clock, TIME_VARIABLE, message)]
    if len(holes) > max(min_long_steps, min_long_share * len(steps)):
        message = f"{_range_text(steps, typical)}; {len(holes)} of {len(steps)} are long: the rate"
        message += " varies, or samples were lost"
        return [_note(clock, TIME_VARIABLE, message, Severity.WARNING)]
    notes = []
    if holes:
        lengths = [hole.length for hole in holes]
        lost = sum(round(length / typical) - 1 for length in lengths)
        message = f"{len(holes)} holes of {_duration(min(lengths))} to {_duration(max(lengths))},"
        message += f" about {lost} samples lost, first at "
        message += ", ".join(f"{hole.at:.6g} s" for hole in holes[:3])
        notes.append(_note(clock, "time_holes", message, Severity.WARNING))
    regular = np.delete(steps, [hole.after for hole in holes])
    if max(regular.max() - typical, typical - regular.min()) > _MIN_JITTER * typical:
        message = f"{_range_text(regular, typical)} without loss"
        notes.append(_note(clock, "time_jitter", message))
    return notes + _nominal_note(clock, regular, len(steps))


def _range_text(steps: Floats, typical: float) -> str:
    ends = f"{_duration(float(steps.min()))} to {_duration(float(steps.max()))}"
    return f"steps from {ends} around {_duration(typical)}"


def _duration(seconds: float) -> str:
    return f"{seconds:.4g} s" if seconds >= 1.0 else f"{1e3 * seconds:.4g} ms"


def _nominal_note(clock: Clock, steps: Floats, count: int) -> list[QualityNote]:
    """Compare the mean step with the nearest round step, or step of a round rate."""
    # Relative deviation up to which the mean step has a round nominal value.
    max_deviation = 0.002
    step = float(steps.mean())
    round_steps = (float(f"{step:.1e}"), 1.0 / float(f"{1.0 / step:.1e}"))
    nominal = min(round_steps, key=lambda round_step: abs(step - round_step))
    drift = (step - nominal) * count
    if abs(drift) <= 0.5 * nominal or abs(step - nominal) > max_deviation * nominal:
        return []
    message = f"mean step {1e3 * step:.6g} ms where {1e3 * nominal:.3g} ms is nominal:"
    message += f" sample number / rate would be wrong by {abs(drift):.3g} s at the end"
    return [_note(clock, "step_not_nominal", message)]
