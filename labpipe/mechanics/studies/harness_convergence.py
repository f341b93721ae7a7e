"""Convergence of a harness in steps and elements, by solutions with half as many.

Sliders and friction depend on the path, which is straight in each step. The error of steps falls at
least linearly with their size, so that it is at most the change by half as many steps. Steps at
corners of a path are kept; where these are most of the steps, all are halved instead. The error of
elements falls with the square of their length: it is a third of the change by half as many.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from labpipe.mechanics.rod import boundaries as rod
from labpipe.mechanics.rod.path import RodPath
from labpipe.mechanics.rod.rotations import conjugate, multiply, rotation_vectors, unit
from labpipe.mechanics.rod.statics import follow
from labpipe.mechanics.studies.harness_line import PreparedLine
from labpipe.mechanics.studies.harness_numbers import Doubt, Number, numbers_of, reference_size
from labpipe.records.arrays import Floats, Ints
from labpipe.records.curve import Interval
from labpipe.records.quality import Reason

MAX_CHANGE = 0.02
"""Largest change of a number by half as many steps, relative."""
MAX_CHANGE_OF_BAND = 0.1
"""The same over the width of its band; the larger of both is allowed."""
_PATHS = ("position", "frame", "anchor", "force", "moment", "vector")


@dataclass(frozen=True, slots=True, eq=False)
class ConvergenceWalk:
    """A line solved in another number of steps.

    Parameters
    ----------
    times : of its steps, in steps of the first solution
    prepared : the line with paths at these times
    path : as followed
    """

    times: Floats
    prepared: PreparedLine
    path: RodPath

    @property
    def steps_text(self) -> str:
        """Return the number of steps, as text."""
        return "twice as many" if np.any(self.times % 1.0 > 0.0) else "half as many"


def convergence_doubts(
    path: RodPath, prepared: PreparedLine, half: PreparedLine, intervals: Mapping[str, Interval]
) -> Iterator[Doubt | None]:
    """Yield the doubts about numbers that depend on the numbers of steps and elements.

    Of a line with a history, half as many of both are tried at once, and each alone only if the
    numbers then change.

    Parameters
    ----------
    path, prepared : of the solution
    half : the same line, of half as many elements
    intervals : by name, of those numbers that have one
    """
    steps, has_history = len(path.states) - 1, depends_on_history(prepared)
    if has_history:
        other = walk_with_other_steps(half, steps)
        numbers = numbers_of(path, prepared)
        if other.path.status != "failed" and not _excess_changes(
            numbers, numbers_of(other.path, other.prepared), prepared, intervals
        ):
            return
    yield few_elements_doubt(path, prepared, half, intervals)
    if has_history:
        other = walk_with_other_steps(prepared, steps)
        yield coarse_doubt(path, prepared, other, intervals)


def depends_on_history(prepared: PreparedLine) -> bool:
    """Return whether a line depends on its history: by sliders, or friction of a plane.

    Parameters
    ----------
    prepared : line and boundaries
    """
    rough = (
        isinstance(boundary, rod.Plane) and boundary.friction > 0.0
        for boundary in prepared.boundaries
    )
    return len(prepared.line.section.law.stiffnesses) > 0 or any(rough)


def coarse_steps(boundaries: Sequence[rod.Boundary], steps: int) -> Ints:
    """Return every other step, and steps with a corner of a path or a release.

    Parameters
    ----------
    boundaries : of the line
    steps : their number
    """
    wanted = {0, steps}
    for boundary in boundaries:
        release = getattr(boundary, "release", None)
        wanted |= set() if release is None else {release - 1, release}
        for name in _PATHS:
            wanted |= set(_corners(getattr(boundary, name, None), is_frame=name == "frame"))
    rows = [0]
    for step in range(1, steps + 1):
        if step in wanted or step - rows[-1] == 2:
            rows.append(step)
    return np.array(rows)


def _corners(path: Floats | None, *, is_frame: bool) -> Iterator[int]:
    min_corner_share = 0.05  # change of the move at a corner, over the largest move
    if path is None or path.ndim != 2 or len(path) < 3:
        return
    moves = np.diff(path, axis=0)
    if is_frame:
        moves = rotation_vectors(multiply(conjugate(path[:-1]), path[1:]))
    max_move = min_corner_share * float(np.max(np.linalg.norm(moves, axis=1)))
    yield from (
        np.flatnonzero(np.linalg.norm(np.diff(moves, axis=0), axis=1) > max_move) + 1
    ).tolist()


def walk_with_other_steps(prepared: PreparedLine, steps: int) -> ConvergenceWalk:
    """Solve a line in about half as many steps, or in twice as many if it has many corners.

    Parameters
    ----------
    prepared : line and boundaries
    steps : of its first solution
    """
    times = np.asarray(coarse_steps(prepared.boundaries, steps), dtype=np.float64)
    if len(times) - 1 > 0.75 * steps:  # hardly coarser
        times = np.linspace(0.0, steps, 2 * steps + 1, dtype=np.float64)
    other = replace(
        prepared, boundaries=tuple(_resampled(boundary, times) for boundary in prepared.boundaries)
    )
    return ConvergenceWalk(times, other, follow(other.line, other.boundaries, steps=len(times) - 1))


def _resampled(boundary: rod.Boundary, times: Floats) -> rod.Boundary:
    changes: dict[str, object] = {}
    low, high = np.floor(times).astype(int), np.ceil(times).astype(int)
    for name in _PATHS:
        path = getattr(boundary, name, None)
        if path is not None and path.ndim == 2 and len(path) > 1:
            midpoints = 0.5 * (path[low] + path[high])
            changes[name] = unit(midpoints) if name == "frame" else midpoints
    release = getattr(boundary, "release", None)
    if release is not None:
        changes["release"] = int(np.searchsorted(times, release - 1, side="right"))
    return replace(boundary, **changes)  # type: ignore[arg-type]


def coarse_doubt(
    path: RodPath, prepared: PreparedLine, other: ConvergenceWalk, intervals: Mapping[str, Interval]
) -> Doubt | None:
    """Return the doubt about numbers that depend on the number of steps, if any.

    Parameters
    ----------
    path, prepared : of the solution
    other : the same line in other steps
    intervals : by name, of those numbers that have one
    """
    numbers, steps = numbers_of(path, prepared), len(path.states) - 1
    if other.path.status == "failed":
        reason = Reason.of(
            "mechanics.studies.unsolved_steps",
            steps=other.steps_text,
            failure=other.path.reasons[0].code,
            count=steps,
            wanted=2 * steps,
        )
        return _doubt_about_all(reason, numbers)
    too_far = _excess_changes(numbers, numbers_of(other.path, other.prepared), prepared, intervals)
    if not too_far:
        return None
    wanted = steps * math.ceil(max(too_far.values()))
    reason = Reason.of(
        "mechanics.studies.too_coarse",
        steps=other.steps_text,
        change=100.0 * MAX_CHANGE,
        of_band=100.0 * MAX_CHANGE_OF_BAND,
        place=_worst_place(path, prepared, other),
        count=steps,
        wanted=wanted,
    )
    return Doubt(reason, tuple(too_far))


def few_elements_doubt(
    path: RodPath, prepared: PreparedLine, half: PreparedLine, intervals: Mapping[str, Interval]
) -> Doubt | None:
    """Return the doubt about numbers that depend on the number of elements, if any.

    Parameters
    ----------
    path, prepared : of the solution
    half : the same line, of half as many elements
    intervals : by name, of those numbers that have one
    """
    error_share = 1.0 / 3.0  # of the change by half as many elements: a method of second order
    numbers, steps = numbers_of(path, prepared), len(path.states) - 1
    count, other = len(prepared.line.lengths), follow(half.line, half.boundaries, steps=steps)
    if other.status == "failed":
        reason = Reason.of(
            "mechanics.studies.unsolved_elements",
            failure=other.reasons[0].code,
            count=count,
            wanted=2 * count,
        )
        return _doubt_about_all(reason, numbers)
    too_far = _excess_changes(
        numbers, numbers_of(other, half), prepared, intervals, share=error_share
    )
    if not too_far:
        return None
    reason = Reason.of(
        "mechanics.studies.few_elements",
        change=100.0 * MAX_CHANGE / error_share,
        of_band=100.0 * MAX_CHANGE_OF_BAND / error_share,
        worst=max(too_far, key=lambda name: too_far[name]),
        count=count,
        wanted=max(2 * count, math.ceil(count * math.sqrt(max(too_far.values())))),
    )
    return _doubt_about_all(reason, numbers)  # another number may be unchanged by chance


def _doubt_about_all(reason: Reason, numbers: Sequence[Number]) -> Doubt:
    return Doubt(reason, tuple(number.name for number in numbers))


def _excess_changes(
    numbers: Sequence[Number],
    others: Sequence[Number],
    prepared: PreparedLine,
    intervals: Mapping[str, Interval],
    share: float = 1.0,
) -> dict[str, float]:
    """Return numbers whose error, a share of their change, is too large: error over allowed."""
    other_values = {other.name: other.value for other in others}
    ratios = {
        number.name: share
        * abs(other_values[number.name] - number.value)
        / _allowed_change(number, numbers, prepared, intervals)
        for number in numbers
        if math.isfinite(number.value) and math.isfinite(other_values[number.name])
    }
    return {name: ratio for name, ratio in ratios.items() if ratio > 1.0}


def _allowed_change(
    number: Number,
    numbers: Sequence[Number],
    prepared: PreparedLine,
    intervals: Mapping[str, Interval],
) -> float:
    """Return the allowed change of a number; its size has a minimum, given by similar numbers."""
    min_coordinate_share = 0.05  # of the length of the line
    min_size_share = 1e-3  # of the largest number of the same unit
    like = [abs(other.value) for other in numbers if other.unit == number.unit]
    like.append(reference_size(number.unit, prepared.line))
    largest = max(value for value in like if math.isfinite(value))
    size = max(abs(number.value), min_size_share * largest)
    if number.is_signed:
        size = max(size, min_coordinate_share * prepared.line.length)
    band = intervals.get(number.name)
    width = 0.0 if band is None else MAX_CHANGE_OF_BAND * (band.upper - band.lower)
    return max(MAX_CHANGE * size, width) or math.inf


def _worst_place(path: RodPath, prepared: PreparedLine, other: ConvergenceWalk) -> str:
    """Return step and place where the bending moments of both solutions begin to differ most."""
    whole_steps = np.flatnonzero(other.times % 1.0 == 0.0)
    steps = other.times[whole_steps].astype(int)
    first = np.array([path.states[step].moments for step in steps])
    second = np.array([other.path.states[row].moments for row in whole_steps])
    distance = np.linalg.norm(second - first, axis=3).max(axis=2)
    row, node = divmod(int(np.argmax(np.diff(distance, axis=0, prepend=0.0))), distance.shape[1])
    place = 1e3 * prepared.line.stations[node]
    return f"step {steps[row]}, {place:.4g} mm from the start"
