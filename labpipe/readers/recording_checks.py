"""Make quality notes on time axes (holes, jitter) and on marker tracks (gaps, frozen poses)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from labpipe.readers.raw_files import ContentError
from labpipe.records.arrays import Flags, Floats, find_runs, median
from labpipe.records.quality import QualityNote
from labpipe.records.recording import Clock, MarkerTracks
from labpipe.units import get_conversion_factor

_LONG_STEP_FACTOR = 1.5
"""Multiple of the median step above which a step is a hole or jitter."""
_MIN_JITTER = 0.05
"""Relative deviation of regular steps from their median above which it is reported as jitter."""
TIME_VARIABLE = "time_variable"
"""Code of the note on a time axis whose long steps may be intended."""
SAMPLED_ON_EVENT = frozenset({"OnChange"})
"""Names of the rasters that write a sample on each change, so that long steps are normal."""


def get_time_factor(unit: str, place: str) -> float:
    """Return the factor to seconds of the unit of a time axis.

    Parameters
    ----------
    unit : unit in the export, in small or capital letters
    place : place of the unit, for the error

    Raises
    ------
    ContentError
        If the unit is empty, or is not a unit of time.
    """
    try:
        return get_conversion_factor(unit.casefold() or "none", "s")
    except ValueError:
        raise ContentError.of(
            "readers.no_unit_of_time" if unit else "readers.time_without_unit", place, unit=unit
        ) from None


@dataclass(frozen=True, slots=True)
class Hole:
    """A stretch of a time axis in which samples were lost.

    Parameters
    ----------
    last_sample : index of the last sample before the hole
    time : time of that sample, s
    duration : time from that sample to the next one, s
    """

    last_sample: int
    time: float
    duration: float


def find_holes(time: Floats) -> tuple[Hole, ...]:
    """Find the holes of a time axis.

    Parameters
    ----------
    time : shape (n,), s

    Returns
    -------
    The holes in order of time; none if the axis has fewer than three samples or a NaN.

    Notes
    -----
    A hole is a step of more than 1.5 median steps that no short neighbouring step compensates. A
    late sample causes a long and a short step (1.51 ms and 0.49 ms at 1 kHz), although no sample is
    lost.
    """
    steps = np.diff(time)
    if len(steps) < 2 or _are_even(steps) or not (median_step := median(steps)) > 0.0:
        return ()
    long_steps = np.flatnonzero(steps > _LONG_STEP_FACTOR * median_step)
    padded = np.concatenate(([np.inf], steps, [np.inf]))
    pair_duration = steps[long_steps] + np.minimum(padded[long_steps], padded[long_steps + 2])
    hole_steps = long_steps[pair_duration > (1.0 + _LONG_STEP_FACTOR) * median_step]
    return tuple(Hole(int(i), float(time[i]), float(steps[i])) for i in hole_steps)


def make_clock_notes(clock: Clock, *, is_variable: bool = False) -> Iterator[QualityNote]:
    """Make notes on a time axis.

    Parameters
    ----------
    clock : the time axis as exported
    is_variable : whether the program samples at a variable rate, or omits unchanged samples, so
        that no samples are lost in long steps

    Yields
    ------
    Notes ``clock_empty``, ``time_not_finite``, ``time_not_increasing``, ``time_repeats``,
    ``time_holes``, ``time_variable``, ``time_jitter``, ``time_start_not_zero``. The notes
    ``time_not_finite`` and ``time_not_increasing`` are errors: the axis cannot be used.
    """
    time, steps, where = clock.time, np.diff(clock.time), f"clock {clock.name}"
    if len(time) == 0:
        yield QualityNote.of("readers.clock_empty", where)
        return
    if len(invalid_samples := np.flatnonzero(~np.isfinite(time))):
        count, first = len(invalid_samples), invalid_samples[0] + 1
        yield QualityNote.of("readers.time_not_finite", where, count=count, first=first)
        return
    if len(reversed_steps := np.flatnonzero(steps < 0.0)):
        count, first = len(reversed_steps), reversed_steps[0] + 2
        yield QualityNote.of("readers.time_not_increasing", where, count=count, first=first)
        return
    if len(repeated_steps := np.flatnonzero(steps == 0.0)):
        count, first = len(repeated_steps), repeated_steps[0] + 2
        yield QualityNote.of("readers.time_repeats", where, count=count, first=first)
    if clock.name not in SAMPLED_ON_EVENT and len(steps) > 1:
        yield from _make_step_notes(time, steps, where, is_variable=is_variable)
    if time[0] != 0.0:
        yield QualityNote.of("readers.time_start_not_zero", where, start=time[0])


def _are_even(steps: Floats) -> bool:
    """Return whether the steps differ too little for jitter or holes, without a slow median."""
    shortest, longest = float(steps.min()), float(steps.max())
    return shortest > 0.0 and longest - shortest <= _MIN_JITTER * shortest


def _make_step_notes(
    time: Floats, steps: Floats, where: str, *, is_variable: bool
) -> Iterator[QualityNote]:
    """Make notes on holes, variable rates and jitter."""
    # If more steps than both limits are long, the rate varies, and long steps are not holes.
    max_holes, max_hole_fraction = 10, 0.05
    if _are_even(steps) or not (median_step := median(steps)) > 0.0:
        return
    holes, n_steps = find_holes(time), len(steps)
    steps_text, n_holes = _format_steps(steps, median_step), len(holes)
    if is_variable and steps.max() > _LONG_STEP_FACTOR * steps.min():
        yield QualityNote.of("readers.time_variable", where, steps=steps_text)
        return
    if n_holes > max(max_holes, max_hole_fraction * n_steps):
        facts = {"steps": steps_text, "long": n_holes, "total": n_steps}
        yield QualityNote.of("readers.many_long_steps", where, **facts)
        return
    if holes:
        durations = [hole.duration for hole in holes]
        n_lost = sum(round(duration / median_step) - 1 for duration in durations)
        first_times = ", ".join(f"{hole.time:.6g} s" for hole in holes[:3])
        facts = {"count": n_holes, "span": _format_range(durations), "lost": n_lost}
        yield QualityNote.of("readers.time_holes", where, **facts, first=first_times)
    regular_steps = np.delete(steps, [hole.last_sample for hole in holes])
    if np.abs(regular_steps - median_step).max() > _MIN_JITTER * median_step:
        steps_text = _format_steps(regular_steps, median_step)
        yield QualityNote.of("readers.time_jitter", where, steps=steps_text)


def _format_steps(steps: Floats, median_step: float) -> str:
    """Format the range and the median of steps, s, for a note."""
    return f"steps from {_format_range(steps)} around {_format_duration(median_step)}"


def _format_range(durations: Sequence[float] | Floats) -> str:
    """Format the shortest and the longest of some durations, s, for a note."""
    ends = _format_duration(float(np.min(durations))), _format_duration(float(np.max(durations)))
    return " to ".join(dict.fromkeys(ends))  # one duration if both are equal


def _format_duration(seconds: float) -> str:
    """Format a duration in s or ms, for a note."""
    return f"{seconds:.4g} s" if seconds >= 1.0 else f"{1e3 * seconds:.4g} ms"


def find_blank_frames(positions: Floats) -> Flags:
    """Find the frames in which an object has no position.

    Parameters
    ----------
    positions : shape (frames, 3), m

    Returns
    -------
    shape (frames,).
    """
    return np.asarray(np.isnan(positions).any(axis=1))


def find_unchanged_steps(positions: Floats) -> Flags:
    """Find the steps over which a position stays the same to the last digit.

    Parameters
    ----------
    positions : shape (frames, 3), m; NaN differs from every value

    Returns
    -------
    shape (frames - 1,).
    """
    return np.asarray((np.diff(positions, axis=0) == 0.0).all(axis=1))


def count_longest_run(flags: Flags) -> int:
    """Count the samples of the longest run of flagged samples; 0 without a flagged sample."""
    return max((stop - start for start, stop in find_runs(flags)), default=0)


def make_track_notes(tracks: MarkerTracks) -> Iterator[QualityNote]:
    """Make notes on marker tracks.

    Parameters
    ----------
    tracks : marker tracks and rigid bodies of a take

    Yields
    ------
    Notes ``take_empty``, ``marker_blank``, ``marker_gaps``, ``body_gaps``, ``frozen_pose``,
    ``unlabelled_markers``.
    """
    from labpipe.markers.tracklets import is_unlabelled  # not needed by tensile tests

    min_frozen_steps = 10  # after fewer successive unchanged steps, the body may be at rest
    if not tracks.names and not tracks.bodies:
        yield QualityNote.of("readers.take_empty", "take")
    markers = {name: tracks.positions[:, i] for i, name in enumerate(tracks.names)}
    bodies = {body.name: body.position for body in tracks.bodies}
    blank_names = [name for name, track in markers.items() if find_blank_frames(track).all()]
    if blank_names and len(tracks.time):
        yield QualityNote.of("readers.marker_blank", "markers", names=", ".join(blank_names))
    for name, track in (markers | bodies).items():
        is_blank, is_unchanged = find_blank_frames(track), find_unchanged_steps(track)
        if is_blank.any() and not is_blank.all():
            ratio = f"{is_blank.sum()} of {len(is_blank)} frames"
            gap_facts = {"share": ratio, "longest": count_longest_run(is_blank)}
            yield QualityNote.of(
                "readers.marker_gaps" if name in markers else "readers.body_gaps", name, **gap_facts
            )
        if (n_frozen := count_longest_run(is_unchanged)) >= min_frozen_steps:
            n_unchanged, n_steps = int(is_unchanged.sum()), len(is_unchanged)
            facts = {"count": n_unchanged, "total": n_steps, "most": n_frozen}
            yield QualityNote.of("readers.frozen_pose", name, **facts)
    if count := sum(map(is_unlabelled, tracks.names)):
        total = len(tracks.names)
        yield QualityNote.of("readers.unlabelled_markers", "markers", count=count, total=total)
