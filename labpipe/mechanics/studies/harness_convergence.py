"""Convergence checks of a harness: solutions with half as many steps and half as many elements.

The state of sliders and friction depends on the path, which is straight within a step. The error
decreases at least linearly with the size of the steps; therefore it is at most the change between
the solution and one with half as many steps. Steps at corners of a path are kept; if most steps are
at corners, twice as many steps are taken instead. The error of the elements decreases with the
square of their length; it is a third of the change between the solution and one with half as many.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from labpipe.mechanics.rod import boundaries as rod
from labpipe.mechanics.rod.path import RodPath
from labpipe.mechanics.rod.rotations import conjugate, multiply, to_rotation_vectors, unit
from labpipe.mechanics.rod.statics import follow
from labpipe.mechanics.studies.harness_line import PreparedLine
from labpipe.mechanics.studies.harness_numbers import Doubt, Number, compute_numbers, estimate_size
from labpipe.records.arrays import Floats, Ints
from labpipe.records.curve import Interval
from labpipe.records.quality import Reason

MAX_CHANGE = 0.02
"""Largest relative change of a number between both solutions."""
MAX_CHANGE_OF_BAND = 0.1
"""Largest change over the width of the number's band; the larger of both limits is allowed."""
_PATHS = ("position", "frame", "anchor", "force", "moment", "vector")


@dataclass(frozen=True, slots=True, eq=False)
class ResampledSolution:
    """A solution of the same line in another number of steps.

    Parameters
    ----------
    times : of its steps; step k of the first solution is at time k
    prepared : line, and boundaries with their paths at these times
    path : of the line
    """

    times: Floats
    prepared: PreparedLine
    path: RodPath

    @property
    def steps_text(self) -> str:
        """Return the number of steps, as text."""
        return "twice as many" if np.any(self.times % 1.0 > 0.0) else "half as many"


def check_convergence(
    path: RodPath, prepared: PreparedLine, half: PreparedLine, intervals: Mapping[str, Interval]
) -> Iterator[Doubt | None]:
    """Yield the doubts about numbers that depend on the numbers of steps and elements.

    For a line with a history, half as many of both are tried at once. Steps and elements are
    checked separately only if numbers change then.

    Parameters
    ----------
    path, prepared : of the solution
    half : the same line, of half as many elements
    intervals : by name, of those numbers that have one
    """
    steps, has_history = len(path.states) - 1, depends_on_history(prepared)
    if has_history:
        other = solve_in_other_steps(half, steps)
        numbers = compute_numbers(path, prepared)
        if other.path.status != "failed" and not _find_excess_changes(
            numbers, compute_numbers(other.path, other.prepared), prepared, intervals
        ):
            return
    yield check_element_count(path, prepared, half, intervals)
    if has_history:
        other = solve_in_other_steps(prepared, steps)
        yield check_steps(path, prepared, other, intervals)


def depends_on_history(prepared: PreparedLine) -> bool:
    """Return whether a line depends on its history, through sliders or friction on a plane.

    Parameters
    ----------
    prepared : line and boundaries
    """
    rough = (
        isinstance(boundary, rod.Plane) and boundary.friction > 0.0
        for boundary in prepared.boundaries
    )
    return len(prepared.line.section.law.stiffnesses) > 0 or any(rough)


def select_coarse_steps(boundaries: Sequence[rod.Boundary], steps: int) -> Ints:
    """Select every other step, and the steps with a corner of a path or a release.

    Parameters
    ----------
    boundaries : of the line
    steps : their number
    """
    kept_steps = {0, steps}
    for boundary in boundaries:
        release = getattr(boundary, "release", None)
        kept_steps |= set() if release is None else {release - 1, release}
        for name in _PATHS:
            kept_steps |= set(
                _find_corners(getattr(boundary, name, None), is_frame=name == "frame")
            )
    rows = [0]
    for step in range(1, steps + 1):
        if step in kept_steps or step - rows[-1] == 2:
            rows.append(step)
    return np.array(rows)


def _find_corners(path: Floats | None, *, is_frame: bool) -> Iterator[int]:
    min_corner_share = 0.05  # change of the displacement per step at a corner, over the largest one
    if path is None or path.ndim != 2 or len(path) < 3:
        return
    moves = np.diff(path, axis=0)
    if is_frame:
        moves = to_rotation_vectors(multiply(conjugate(path[:-1]), path[1:]))
    max_move = min_corner_share * float(np.max(np.linalg.norm(moves, axis=1)))
    yield from (
        np.flatnonzero(np.linalg.norm(np.diff(moves, axis=0), axis=1) > max_move) + 1
    ).tolist()


def solve_in_other_steps(prepared: PreparedLine, steps: int) -> ResampledSolution:
    """Solve a line in about half as many steps, or in twice as many if it has many corners.

    Parameters
    ----------
    prepared : line and boundaries
    steps : of its first solution
    """
    times = np.asarray(select_coarse_steps(prepared.boundaries, steps), dtype=np.float64)
    if len(times) - 1 > 0.75 * steps:  # hardly coarser
        times = np.linspace(0.0, steps, 2 * steps + 1, dtype=np.float64)
    other = replace(
        prepared, boundaries=tuple(_resample(boundary, times) for boundary in prepared.boundaries)
    )
    return ResampledSolution(
        times, other, follow(other.line, other.boundaries, steps=len(times) - 1)
    )


def _resample(boundary: rod.Boundary, times: Floats) -> rod.Boundary:
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


def check_steps(
    path: RodPath,
    prepared: PreparedLine,
    other: ResampledSolution,
    intervals: Mapping[str, Interval],
) -> Doubt | None:
    """Return the doubt about numbers that depend on the number of steps, if any.

    Parameters
    ----------
    path, prepared : of the solution
    other : the same line in other steps
    intervals : by name, of those numbers that have one
    """
    numbers, steps = compute_numbers(path, prepared), len(path.states) - 1
    if other.path.status == "failed":
        reason = Reason.of(
            "mechanics.studies.unsolved_steps",
            steps=other.steps_text,
            failure=other.path.reasons[0].code,
            count=steps,
            wanted=2 * steps,
        )
        return _doubt_all(reason, numbers)
    too_far = _find_excess_changes(
        numbers, compute_numbers(other.path, other.prepared), prepared, intervals
    )
    if not too_far:
        return None
    needed_steps = steps * math.ceil(max(too_far.values()))
    reason = Reason.of(
        "mechanics.studies.too_coarse",
        steps=other.steps_text,
        change=100.0 * MAX_CHANGE,
        of_band=100.0 * MAX_CHANGE_OF_BAND,
        place=_find_worst_place(path, prepared, other),
        count=steps,
        wanted=needed_steps,
    )
    return Doubt(reason, tuple(too_far))


def check_element_count(
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
    numbers, steps = compute_numbers(path, prepared), len(path.states) - 1
    count, other = len(prepared.line.lengths), follow(half.line, half.boundaries, steps=steps)
    if other.status == "failed":
        reason = Reason.of(
            "mechanics.studies.unsolved_elements",
            failure=other.reasons[0].code,
            count=count,
            wanted=2 * count,
        )
        return _doubt_all(reason, numbers)
    too_far = _find_excess_changes(
        numbers, compute_numbers(other, half), prepared, intervals, share=error_share
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
    return _doubt_all(reason, numbers)  # another number may be unchanged by chance


def _doubt_all(reason: Reason, numbers: Sequence[Number]) -> Doubt:
    return Doubt(reason, tuple(number.name for number in numbers))


def _find_excess_changes(
    numbers: Sequence[Number],
    others: Sequence[Number],
    prepared: PreparedLine,
    intervals: Mapping[str, Interval],
    share: float = 1.0,
) -> dict[str, float]:
    """Return the ratio of error to allowed error of numbers where it exceeds 1.

    The error is a share of the change between both solutions.
    """
    other_values = {other.name: other.value for other in others}
    ratios = {
        number.name: share
        * abs(other_values[number.name] - number.value)
        / _compute_allowed_change(number, numbers, prepared, intervals)
        for number in numbers
        if math.isfinite(number.value) and math.isfinite(other_values[number.name])
    }
    return {name: ratio for name, ratio in ratios.items() if ratio > 1.0}


def _compute_allowed_change(
    number: Number,
    numbers: Sequence[Number],
    prepared: PreparedLine,
    intervals: Mapping[str, Interval],
) -> float:
    """Return the allowed error of a number, relative to its size or to the width of its band.

    The size has a minimum, which follows from the numbers of the same unit.
    """
    min_coordinate_share = 0.05  # of the length of the line
    min_size_share = 1e-3  # of the largest number of the same unit
    like = [abs(other.value) for other in numbers if other.unit == number.unit]
    like.append(estimate_size(number.unit, prepared.line))
    largest = max(value for value in like if math.isfinite(value))
    size = max(abs(number.value), min_size_share * largest)
    if number.is_signed:
        size = max(size, min_coordinate_share * prepared.line.length)
    band = intervals.get(number.name)
    width = 0.0 if band is None else MAX_CHANGE_OF_BAND * (band.upper - band.lower)
    return max(MAX_CHANGE * size, width) or math.inf


def _find_worst_place(path: RodPath, prepared: PreparedLine, other: ResampledSolution) -> str:
    """Describe the step and the place in which the difference of the moments increases most."""
    whole_steps = np.flatnonzero(other.times % 1.0 == 0.0)
    steps = other.times[whole_steps].astype(int)
    first = np.array([path.states[step].moments for step in steps])
    second = np.array([other.path.states[row].moments for row in whole_steps])
    distance = np.linalg.norm(second - first, axis=3).max(axis=2)
    row, node = divmod(int(np.argmax(np.diff(distance, axis=0, prepend=0.0))), distance.shape[1])
    place = 1e3 * prepared.line.stations[node]
    return f"step {steps[row]}, {place:.4g} mm from the start"
