"""Whether steps and elements of a harness are fine enough: the same line in half as many.

Sliders and friction remember the way, and a step is a straight piece of it. The error of that falls
at least as fast as the steps, so that what half as many steps change is what they may still be off.
Steps that the corners of a path need are kept; where that is most of them, each is halved instead.
The error of elements falls with the square of their length: a third of what half as many change.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from labpipe.records.arrays import Floats, Ints
from labpipe.records.curve import Interval
from labpipe.records.quality import Reason
from labpipe.rod import boundaries as rod
from labpipe.rod.path import RodPath
from labpipe.rod.rotations import conjugate, multiply, rotation_vectors, unit
from labpipe.rod.statics import follow
from labpipe.studies.harness_line import PreparedLine
from labpipe.studies.harness_numbers import Doubt, Number, numbers_of, size_of

ALLOWED = 0.02
"""Of a number, by which half as many steps may change it."""
OF_BAND = 0.1
"""Of the width of its band, by which they may, where that is more."""
_OF_HALF = 1.0 / 3.0
"""Of what half as many elements change: what an error of second order still is."""
_HEIGHT = 0.05
"""Of the line's length: a coordinate is off by a share of this at least."""
_NOTHING = 1e-3
"""Of the largest number of its unit, and of `size_of` it: a smaller one is nothing."""
_CORNER = 0.05
"""Of the largest move of a step, by which the next one differs where a path has a corner."""
_MOST_KEPT = 0.75
"""Of the steps: where corners need more of them there is no walk in half as many."""
_PATHS = ("position", "frame", "anchor", "force", "moment", "vector")


@dataclass(frozen=True, slots=True, eq=False)
class ConvergenceWalk:
    """A line in other steps.

    Parameters
    ----------
    times : in steps of the first walk, of each of its steps
    laid : the line with paths at these times
    path : as followed
    """

    times: Floats
    laid: PreparedLine
    path: RodPath

    @property
    def words(self) -> str:
        """How many steps it has."""
        return "twice as many" if np.any(self.times % 1.0 > 0.0) else "half as many"


def depends_on_history(laid: PreparedLine) -> bool:
    """Whether anything of a line hangs on its way: sliders, or friction of a plane.

    Parameters
    ----------
    laid : line and boundaries
    """
    rough = (
        isinstance(boundary, rod.Plane) and boundary.friction > 0.0 for boundary in laid.boundaries
    )
    return len(laid.line.section.law.stiffnesses) > 0 or any(rough)


def kept_rows(boundaries: Sequence[rod.Boundary], steps: int) -> Ints:
    """Every other step, and those in which a path has a corner or something lets go.

    Parameters
    ----------
    boundaries : of the walk
    steps : of it
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
    if path is None or path.ndim != 2 or len(path) < 3:
        return
    moves = np.diff(path, axis=0)
    if is_frame:
        moves = rotation_vectors(multiply(conjugate(path[:-1]), path[1:]))
    most = _CORNER * float(np.max(np.linalg.norm(moves, axis=1)))
    yield from (np.flatnonzero(np.linalg.norm(np.diff(moves, axis=0), axis=1) > most) + 1).tolist()


def walk_with_other_steps(laid: PreparedLine, steps: int) -> ConvergenceWalk:
    """Follow a line in about half as many steps, or in twice as many where corners need them.

    Parameters
    ----------
    laid : line and boundaries
    steps : of its walk
    """
    times = np.asarray(kept_rows(laid.boundaries, steps), dtype=np.float64)
    if len(times) - 1 > _MOST_KEPT * steps:
        times = np.linspace(0.0, steps, 2 * steps + 1, dtype=np.float64)
    other = replace(
        laid, boundaries=tuple(_at_times(boundary, times) for boundary in laid.boundaries)
    )
    return ConvergenceWalk(times, other, follow(other.line, other.boundaries, steps=len(times) - 1))


def _at_times(boundary: rod.Boundary, times: Floats) -> rod.Boundary:
    changes: dict[str, object] = {}
    low, high = np.floor(times).astype(int), np.ceil(times).astype(int)
    for name in _PATHS:
        path = getattr(boundary, name, None)
        if path is not None and path.ndim == 2 and len(path) > 1:
            between = 0.5 * (path[low] + path[high])
            changes[name] = unit(between) if name == "frame" else between
    release = getattr(boundary, "release", None)
    if release is not None:
        changes["release"] = int(np.searchsorted(times, release - 1, side="right"))
    return replace(boundary, **changes)  # type: ignore[arg-type]


def coarse_doubt(
    path: RodPath, laid: PreparedLine, other: ConvergenceWalk, intervals: Mapping[str, Interval]
) -> Doubt | None:
    """Why numbers are doubtful that other steps would change; None where there are none.

    Parameters
    ----------
    path, laid : of the walk
    other : the same line in other steps
    intervals : by name, of those numbers that have one
    """
    numbers, steps = numbers_of(path, laid), len(path.states) - 1
    if other.path.status == "failed":
        return _unknown("too_coarse", numbers, other.path, f"{other.words} steps", steps)
    too_far = _too_far(numbers, numbers_of(other.path, other.laid), laid, intervals)
    if not too_far:
        return None
    wanted = steps * math.ceil(max(too_far.values()))
    message = (
        f"{_changed(f'{other.words} steps', 'it', 1.0)}, most at {_worst(path, laid, other)}: "
        f"{steps} steps are too few; {wanted} should do"
    )
    return Doubt(Reason("too_coarse", message), tuple(too_far))


def few_elements_doubt(
    path: RodPath, laid: PreparedLine, half: PreparedLine, intervals: Mapping[str, Interval]
) -> Doubt | None:
    """Why numbers are doubtful that more elements would change; None where there are none.

    Parameters
    ----------
    path, laid : of the walk
    half : the same line, of half as many elements
    intervals : by name, of those numbers that have one
    """
    numbers, steps = numbers_of(path, laid), len(path.states) - 1
    count, other = len(laid.line.lengths), follow(half.line, half.boundaries, steps=steps)
    if other.status == "failed":
        return _unknown("coarse_elements", numbers, other, "half as many elements", count)
    too_far = _too_far(numbers, numbers_of(other, half), laid, intervals, share=_OF_HALF)
    if not too_far:
        return None
    wanted = max(2 * count, math.ceil(count * math.sqrt(max(too_far.values()))))
    changed = _changed("half as many elements", "a number", 1.0 / _OF_HALF)
    most = max(too_far, key=lambda each: too_far[each])
    message = f"{changed}, most {most}: {count} elements are too few; {wanted} should do"
    # where so few are not enough for one number, another may be the same by chance
    return Doubt(Reason("coarse_elements", message), tuple(number.name for number in numbers))


def _unknown(code: str, numbers: Sequence[Number], other: RodPath, words: str, count: int) -> Doubt:
    message = (
        f"in {words} the line cannot be followed ({other.reasons[0].code}), so that nothing says "
        f"whether {count} are enough: take {2 * count}"
    )
    return Doubt(Reason(code, message), tuple(number.name for number in numbers))


def _changed(words: str, what: str, times: float) -> str:
    return (
        f"{words} change {what} by more than {100.0 * ALLOWED * times:g} % (or "
        f"{100.0 * OF_BAND * times:g} % of its band)"
    )


def _too_far(
    numbers: Sequence[Number],
    others: Sequence[Number],
    laid: PreparedLine,
    intervals: Mapping[str, Interval],
    share: float = 1.0,
) -> dict[str, float]:
    """Numbers that are off by more than is allowed, and by how many times that.

    They are off by a share of the change.
    """
    known = {other.name: other.value for other in others}
    off = {
        number.name: share
        * abs(known[number.name] - number.value)
        / _allowed(number, numbers, laid, intervals)
        for number in numbers
        if math.isfinite(number.value) and math.isfinite(known[number.name])
    }
    return {name: times for name, times in off.items() if times > 1.0}


def _allowed(
    number: Number, numbers: Sequence[Number], laid: PreparedLine, intervals: Mapping[str, Interval]
) -> float:
    """By how much a number may change; one that is nothing beside its like counts as that.

    So does one that is nothing beside what the line gives its unit: the rounding of all that is 0.
    """
    like = [abs(each.value) for each in numbers if each.unit == number.unit]
    like.append(size_of(number.unit, laid.line))
    size = max(abs(number.value), _NOTHING * max(value for value in like if math.isfinite(value)))
    if number.is_signed:
        size = max(size, _HEIGHT * laid.line.length)
    band = intervals.get(number.name)
    width = 0.0 if band is None else OF_BAND * (band.upper - band.lower)
    return max(ALLOWED * size, width) or math.inf


def _worst(path: RodPath, laid: PreparedLine, other: ConvergenceWalk) -> str:
    """Step and place where the bending moments of both walks part most."""
    at = np.flatnonzero(other.times % 1.0 == 0.0)
    steps = other.times[at].astype(int)
    first = np.array([path.states[step].moments for step in steps])
    second = np.array([other.path.states[row].moments for row in at])
    apart = np.linalg.norm(second - first, axis=3).max(axis=2)
    row, node = divmod(int(np.argmax(np.diff(apart, axis=0, prepend=0.0))), apart.shape[1])
    place = 1e3 * laid.line.stations[node]
    return f"step {steps[row]}, {place:.4g} mm from the start"
