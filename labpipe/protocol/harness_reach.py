"""Whether a line can come to its clips, rings and strings, and above its planes, at every step.

Between waypoints everything that holds the line moves on a straight path, so that two such places
are farthest from each other at a waypoint of one of them: only these steps are checked.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise
from pathlib import Path

from labpipe.errors import Fault, KeyPath
from labpipe.protocol.harness_file import (
    HELD,
    START,
    Boundary,
    Clip,
    Grip,
    HarnessFile,
    Held,
    Load,
    Pin,
    Plane,
    Ring,
    String,
    Vector3,
)

REACH_FACTOR = 1.0 + 1e-9
"""On the length, so that a line may be straight between two clips."""


@dataclass(frozen=True, slots=True)
class Leg:
    """The end of a straight stretch of the path of something that holds the line.

    Parameters
    ----------
    step : at which it is there
    position : m
    """

    step: int
    position: Vector3


def file_beside(name: str, path: Path) -> Path:
    """Find a file that a harness names: beside it, or else from the working folder.

    Parameters
    ----------
    name : as written
    path : of the harness YAML
    """
    neighbour = path.parent / name
    return neighbour if neighbour.exists() else Path(name)


def file_faults(harness: HarnessFile, path: Path) -> Iterator[Fault]:
    """Find files that a harness names and that are not there.

    Parameters
    ----------
    harness : whose parts are valid
    path : of its YAML
    """
    for key in ("sheet", "calibration", "sliders"):
        name = getattr(harness.line.section, key)
        if name is not None and not file_beside(name, path).is_file():
            places = f"There is none at {path.parent / name} or {Path(name)}."
            yield Fault(("line", "section", key), "a file", repr(name), places)


def start_of(harness: HarnessFile) -> tuple[Vector3, Vector3]:
    """Return where the line begins at the start, m, and in which direction it lies.

    Parameters
    ----------
    harness : whose line may leave both to the clip at its start
    """
    line = harness.line
    first = next((boundary for boundary in _held(harness) if boundary.at == START), None)
    position, direction = line.start, line.direction
    if position is None:
        position = (0.0, 0.0, 0.0) if first is None or isinstance(first, Grip) else first.position
    if direction is None:
        direction = first.direction if isinstance(first, Clip) else None
    return position, direction or (1.0, 0.0, 0.0)


def legs_of(boundary: Held, start: Vector3, steps: int) -> tuple[Leg, ...]:
    """Return the path of a holder of the line: its start and the ends of its straight legs.

    Parameters
    ----------
    boundary : clip, pin or grip
    start : m, where the line lies at the start
    steps : of the harness
    """
    legs = [Leg(0, start)]
    if isinstance(boundary, Clip | Pin):
        return (*legs, Leg(boundary.by or steps, boundary.position))
    for point in boundary.path:
        legs.append(Leg(point.step, point.position or legs[-1].position))
    return tuple(legs)


def first_anchor(string: String, place: Vector3) -> Vector3:
    """Return where the anchor of a string is at the start, m: no farther than the string is long.

    Parameters
    ----------
    string : of the harness
    place : m, where the line is tied to it at the start
    """
    distance = math.dist(string.anchor, place)
    share = min(1.0, string.length / distance) if distance > 0.0 else 1.0
    if share == 1.0:
        return string.anchor
    x, y, z = (a + share * (b - a) for a, b in zip(place, string.anchor, strict=True))
    return x, y, z


def _held(harness: HarnessFile) -> list[Held]:
    return [boundary for boundary in harness.boundaries if isinstance(boundary, HELD)]


def reach_faults(harness: HarnessFile) -> Iterator[Fault]:
    """Find what the line is too short for, and what would hold it in a plane.

    Parameters
    ----------
    harness : whose parts are valid

    Yields
    ------
    A fault for each two boundaries that are too far apart, with the step and the distance; those
    of a sweep for the shortest line of it that is too short. One for each that holds the line
    nearer to a plane than half the diameter that the file states; that of a wire sheet is not
    known here. One for each turn of half a turn or more in a step, which is one the other way, too,
    for a curl that elements are too long for, for what lets go before it has come anywhere, and for
    a line that falls as all have let it go.
    """
    yield from _in_planes(harness)
    yield from _released_too_early(harness)
    yield from _turned_too_far(harness)
    yield from _curled_too_far(harness)
    yield from _falling(harness)
    lengths: list[tuple[float, KeyPath]] = [(harness.line.length, ())]
    swept = harness.sweep.length if harness.sweep else ()
    lengths += sorted((run, ("sweep", "length", i)) for i, run in enumerate(swept))
    for length, path in lengths:
        faults = [*_off_the_line(harness, length, path), *_too_far(harness, length, path)]
        if faults:
            yield from faults
            return


def _off_the_line(harness: HarnessFile, length: float, path: KeyPath) -> Iterator[Fault]:
    for number, boundary in enumerate(harness.boundaries):
        place = getattr(boundary, "at", START)
        if math.isfinite(place) and place > length * REACH_FACTOR:
            expected = f"a place on the line, which is {_mm(length)} long"
            remedy = "Write 'end', or make the line longer."
            yield Fault(path or ("boundaries", number, "at"), expected, _mm(place), remedy)


def _in_planes(harness: HarnessFile) -> Iterator[Fault]:
    # Share of the length.
    tolerance = 1e-9
    numbers = {boundary.name: number for number, boundary in enumerate(harness.boundaries)}
    radius = 0.5 * (harness.line.section.diameter or 0.0)
    first = 0 if harness.line.spool is None else 1  # where a curled line begins is not known here
    ties = [_tie_of(harness, boundary, harness.line.length) for boundary in _held(harness)]
    for plane in (boundary for boundary in harness.boundaries if isinstance(boundary, Plane)):
        for tie in ties:
            legs = [leg for leg in tie.legs[first:] if leg.step <= tie.last]
            lowest = min(legs, key=lambda leg: _height(plane, leg.position), default=None)
            if (
                lowest
                and _height(plane, lowest.position) < radius - tolerance * harness.line.length
            ):
                expected = f"the axis of the line {_mm(radius)} above {plane.name!r}, its radius"
                actual = f"{_mm(_height(plane, lowest.position))} at step {lowest.step}"
                remedy = "Hold it higher, or begin higher ('line.start')."
                yield Fault(_path(tie, numbers), expected, actual, remedy)


def _released_too_early(harness: HarnessFile) -> Iterator[Fault]:
    """Find what lets go before it is there; a grip may go on without the line."""
    for number, boundary in enumerate(harness.boundaries):
        if not isinstance(boundary, HELD) or boundary.release is None:
            continue
        last_step = boundary.path[0].step if isinstance(boundary, Grip) else boundary.by
        if last_step is not None and boundary.release <= last_step:
            expected = (
                f"a step after {last_step}, at which {boundary.name!r} is where it brings the line"
            )
            remedy = "Let it go later, or bring it there earlier."
            yield Fault(("boundaries", number, "release"), expected, str(boundary.release), remedy)


def _turned_too_far(harness: HarnessFile) -> Iterator[Fault]:
    # deg per step. A path is a row of frames, in which a turn and one 360 deg less are the same.
    max_turn = 180.0
    for number, boundary in enumerate(harness.boundaries):
        for key, start, end, turn in _turns_of(boundary, harness.steps):
            per_step = math.degrees(abs(turn)) / (end - start)
            if per_step >= max_turn:
                expected = f"less than {max_turn:g} deg of turn in a step, which has one meaning"
                actual = f"{per_step:.6g} deg in each from step {start} to {end}"
                remedy = "Take more steps for it: raise 'steps', and 'by' or 'step'."
                yield Fault(("boundaries", number, *key), expected, actual, remedy)


def _curled_too_far(harness: HarnessFile) -> Iterator[Fault]:
    # deg per element. Elements are straight; one that turns by more than half a turn turns the
    # other way.
    max_curl = 90.0
    line, swept = harness.line, harness.sweep.length if harness.sweep else ()
    element = max([line.length, *swept]) / line.elements
    curl = 0.0 if line.spool is None else math.degrees(line.spool.curvature * element)
    if curl > max_curl:
        expected = f"a curl of at most {max_curl:g} deg over an element of {_mm(element)}"
        remedy = "Check the unit of the curvature, or take more elements."
        yield Fault(("line", "spool", "curvature"), expected, f"{curl:.6g} deg", remedy)


def _falling(harness: HarnessFile) -> Iterator[Fault]:
    releases = {
        number: boundary.release
        for number, boundary in enumerate(harness.boundaries)
        if isinstance(boundary, HELD)
    }
    section = harness.line.section
    has_weight = section.kind != "bending_stiffness" or section.mass_per_length is not None
    others = any(not isinstance(boundary, (*HELD, Load)) for boundary in harness.boundaries)
    if others or not has_weight or not any(harness.gravity) or None in releases.values():
        return
    number = max(releases, key=lambda release: releases[release] or 0)
    expected = f"something that holds the line from step {releases[number]} on"
    remedy = "Let one of them hold on, add a plane that it falls on, or take gravity away."
    yield Fault(("boundaries", number, "release"), expected, "nothing: it falls", remedy)


def _turns_of(boundary: Boundary, steps: int) -> Iterator[tuple[KeyPath, int, int, float]]:
    """Return the place in the file, first and last step, and angle, rad, of each turn."""
    if isinstance(boundary, Clip):
        yield ("turn",), 0, boundary.by or steps, boundary.turn
    elif isinstance(boundary, Grip):
        last_step, before = 0, 0.0
        for number, point in enumerate(boundary.path):
            turn = before if point.turn is None else point.turn
            yield ("path", number, "turn"), last_step, point.step, turn - before
            last_step, before = point.step, turn


def _height(plane: Plane, position: Vector3) -> float:
    rows = zip(plane.normal, position, plane.point, strict=True)
    return sum((n * (a - b) for n, a, b in rows), 0.0) / math.hypot(*plane.normal)


def _too_far(harness: HarnessFile, length: float, path: KeyPath) -> Iterator[Fault]:
    numbers = {boundary.name: number for number, boundary in enumerate(harness.boundaries)}
    ties = [_tie_of(harness, boundary, length) for boundary in _held(harness)]
    ties.sort(key=lambda tie: tie.along)
    strings = [boundary for boundary in harness.boundaries if isinstance(boundary, String)]
    for one, other in combinations(ties, 2):
        yield from _apart(one, other, other.along - one.along, path or _path(other, numbers))
    for string in strings:
        end = _tie_of(harness, string, length)
        for tie in ties:
            reach = abs(end.along - tie.along) + string.length
            yield from _apart(tie, end, reach, path or _path(end, numbers))
    for ring in (boundary for boundary in harness.boundaries if isinstance(boundary, Ring)):
        yield from _out_of_reach(ring, ties, length, path or _path(ring, numbers))


def _path(tie: _HeldPlace | Ring, numbers: Mapping[str, int]) -> KeyPath:
    return ("boundaries", numbers[tie.name])


@dataclass(frozen=True, slots=True)
class _HeldPlace:
    """A place of the line and where it is held, or tied to; `last` step at which it is."""

    name: str
    along: float
    legs: tuple[Leg, ...]
    last: int

    def position(self, step: int) -> Vector3:
        """Return the position, m; constant before the first leg and after the last."""
        before = [leg for leg in self.legs if leg.step <= step][-1]
        after = next((leg for leg in self.legs if leg.step > step), before)
        share = (step - before.step) / max(after.step - before.step, 1)
        x, y, z = (
            a + share * (b - a) for a, b in zip(before.position, after.position, strict=True)
        )
        return x, y, z


def _tie_of(harness: HarnessFile, boundary: Held | String, length: float) -> _HeldPlace:
    along = min(boundary.at, length)
    start, direction = start_of(harness)
    x, y, z = (begin + along * component for begin, component in zip(start, direction, strict=True))
    if isinstance(boundary, String):
        first, by = Leg(0, first_anchor(boundary, (x, y, z))), boundary.by or harness.steps
        return _HeldPlace(boundary.name, along, (first, Leg(by, boundary.anchor)), harness.steps)
    legs = legs_of(boundary, (x, y, z), harness.steps)
    last = harness.steps if boundary.release is None else boundary.release - 1
    return _HeldPlace(boundary.name, along, legs, last)


def _apart(one: _HeldPlace, other: _HeldPlace, reach: float, path: KeyPath) -> Iterator[Fault]:
    last = min(one.last, other.last)
    steps = sorted({leg.step for tie in (one, other) for leg in tie.legs} | {last})
    for step in (step for step in steps if step <= last):
        distance = math.dist(one.position(step), other.position(step))
        if distance > reach * REACH_FACTOR:
            expected = f"at most the {_mm(reach)} that lie between {one.name!r} and {other.name!r}"
            actual = f"{_mm(distance)} between them at step {step}"
            yield Fault(path, expected, actual, "Bring them nearer, or make the line longer.")
            return


def _out_of_reach(
    ring: Ring, ties: Sequence[_HeldPlace], length: float, path: KeyPath
) -> Iterator[Fault]:
    """Find a ring that no place of the line comes to, once all that holds the line is there."""
    ends = [(tie.along, tie.position(tie.last)) for tie in ties]
    far = [math.dist(ring.position, position) for _, position in ends]
    rooms = [(length - ends[-1][0], far[-1]), (ends[0][0], far[0])] if ends else []
    rooms += [
        (b[0] - a[0], one + other) for (a, one), (b, other) in pairwise(zip(ends, far, strict=True))
    ]
    if rooms and not any(needed <= reach * REACH_FACTOR for reach, needed in rooms):
        reach, needed = min(rooms, key=lambda room: room[1] - room[0])
        expected = f"a ring that the line comes to: {_mm(reach)} of it are there"
        actual = f"a way of {_mm(needed)} by {ring.name!r}"
        yield Fault(path, expected, actual, "Bring it nearer, or make the line longer.")


def _mm(length: float) -> str:
    return f"{1e3 * length:.6g} mm"
