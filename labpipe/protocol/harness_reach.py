"""Whether a line can come to its clips, rings and strings, and above its planes, at every step.

Between waypoints everything that holds the line moves on a straight path, so that two such places
are farthest from each other at a waypoint of one of them: only these steps are checked.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, product
from operator import add, sub
from pathlib import Path
from typing import TypeVar

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
    beside = path.parent / name
    return beside if beside.exists() else Path(name)


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
    """Where the line begins at the start, m, and in which direction it lies.

    Parameters
    ----------
    harness : whose line may leave both to the clip at its start
    """
    line = harness.line
    held = (boundary for _, boundary in _numbered(harness, *HELD))
    first = next((boundary for boundary in held if boundary.at == START), None)
    position, direction = line.start, line.direction
    if position is None:
        position = (0.0, 0.0, 0.0) if first is None or isinstance(first, Grip) else first.position
    if direction is None:
        direction = first.direction if isinstance(first, Clip) else None
    return position, direction or (1.0, 0.0, 0.0)


def legs_of(boundary: Held, start: Vector3, steps: int) -> tuple[Leg, ...]:
    """Path of what holds the line: where it is at the start, and the ends of its straight legs.

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
    """Where the anchor of a string is at the start, m: no farther than the string is long.

    Parameters
    ----------
    string : of the harness
    place : m, where the line is tied to it at the start
    """
    distance = math.dist(string.anchor, place)
    return _between(place, string.anchor, min(1.0, string.length / distance if distance else 1.0))


def _between(start: Vector3, stop: Vector3, share: float) -> Vector3:
    """Return the place at a share of the way between two places; the second one itself at 1."""
    if share == 1.0:
        return stop
    x, y, z = (a + share * (b - a) for a, b in zip(start, stop, strict=True))
    return x, y, z


_B = TypeVar("_B")


def _numbered(harness: HarnessFile, *kinds: type[_B]) -> list[tuple[int, _B]]:
    """List the boundaries of some kinds with their numbers."""
    numbered = enumerate(harness.boundaries)
    return [(number, boundary) for number, boundary in numbered if isinstance(boundary, kinds)]


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
    tolerance = 1e-9 * harness.line.length
    radius = 0.5 * (harness.line.section.diameter or 0.0)
    first = 0 if harness.line.spool is None else 1  # where a curled line begins is not known here
    places = _held_places(harness, harness.line.length)
    for (_, plane), place in product(_numbered(harness, Plane), places):
        heights = {
            leg.step: _height(plane, leg.position)
            for leg in place.legs[first:]
            if leg.step <= place.last
        }
        step = min(heights, key=lambda step: heights[step], default=0)
        if heights and heights[step] < radius - tolerance:
            expected = f"the axis of the line {_mm(radius)} above {plane.name!r}, its radius"
            remedy = "Hold it higher, or begin higher ('line.start')."
            found = f"{_mm(heights[step])} at step {step}"
            yield Fault(("boundaries", place.number), expected, found, remedy)


def _released_too_early(harness: HarnessFile) -> Iterator[Fault]:
    """Find what lets go before it is there; a grip may go on without the line."""
    for number, held in _numbered(harness, *HELD):
        there = getattr(held, "by", None)
        if isinstance(held, Grip) and held.path:
            there = held.path[0].step
        if held.release is not None and there is not None and held.release <= there:
            expected = f"a step after {there}, at which {held.name!r} is where it brings the line"
            remedy = "Let it go later, or bring it there earlier."
            yield Fault(("boundaries", number, "release"), expected, str(held.release), remedy)


def _turned_too_far(harness: HarnessFile) -> Iterator[Fault]:
    # deg per step. A path is a row of frames, in which a turn and one 360 deg less are the same.
    max_turn = 180.0
    for number, boundary in enumerate(harness.boundaries):
        for key, start, end, turn in _turns_of(boundary, harness.steps):
            per_step = math.degrees(abs(turn)) / (end - start)
            if per_step >= max_turn:
                expected = f"less than {max_turn:g} deg of turn in a step, which has one meaning"
                found = f"{per_step:.6g} deg in each from step {start} to {end}"
                remedy = "Take more steps for it: raise 'steps', and 'by' or 'step'."
                yield Fault(("boundaries", number, *key), expected, found, remedy)


def _turns_of(boundary: Boundary, steps: int) -> Iterator[tuple[KeyPath, int, int, float]]:
    """Where each turn is written, the steps from and to which it goes, and by how much, rad."""
    if isinstance(boundary, Clip):
        yield ("turn",), 0, boundary.by or steps, boundary.turn
    elif isinstance(boundary, Grip):
        at, before = 0, 0.0
        for number, point in enumerate(boundary.path):
            turn = before if point.turn is None else point.turn
            yield ("path", number, "turn"), at, point.step, turn - before
            at, before = point.step, turn


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
    releases = {number: held.release for number, held in _numbered(harness, *HELD)}
    section = harness.line.section
    has_weight = section.kind != "bending_stiffness" or section.mass_per_length is not None
    others = len(_numbered(harness, *HELD, Load)) < len(harness.boundaries)
    if others or not has_weight or not any(harness.gravity) or None in releases.values():
        return
    number = max(releases, key=lambda release: releases[release] or 0)
    expected = f"something that holds the line from step {releases[number]} on"
    remedy = "Let one of them hold on, add a plane that it falls on, or take gravity away."
    yield Fault(("boundaries", number, "release"), expected, "nothing: it falls", remedy)


def _height(plane: Plane, position: Vector3) -> float:
    rows = zip(plane.normal, position, plane.point, strict=True)
    return sum((n * (a - b) for n, a, b in rows), 0.0) / math.hypot(*plane.normal)


def _too_far(harness: HarnessFile, length: float, path: KeyPath) -> Iterator[Fault]:
    places = sorted(_held_places(harness, length), key=lambda place: place.along)
    for one, other in combinations(places, 2):
        yield from _apart(one, other, other.along - one.along, path)
    for number, string in _numbered(harness, String):
        end = _place_of(harness, number, string, length)
        for place in places:
            yield from _apart(place, end, abs(end.along - place.along) + string.length, path)
    for number, ring in _numbered(harness, Ring):
        yield from _out_of_reach(ring, places, length, path or ("boundaries", number))


@dataclass(frozen=True, slots=True)
class _HeldPlace:
    """A place of the line and where a boundary holds it, or is tied to it, up to a last step."""

    number: int
    name: str
    along: float
    legs: tuple[Leg, ...]
    last: int

    def position(self, step: int) -> Vector3:
        """Where it is, m; before the first leg and after the last it stays."""
        before = [leg for leg in self.legs if leg.step <= step][-1]
        after = next((leg for leg in self.legs if leg.step > step), before)
        share = (step - before.step) / max(after.step - before.step, 1)
        return _between(before.position, after.position, share)


def _held_places(harness: HarnessFile, length: float) -> list[_HeldPlace]:
    return [_place_of(harness, number, x, length) for number, x in _numbered(harness, *HELD)]


def _place_of(
    harness: HarnessFile, number: int, boundary: Held | String, length: float
) -> _HeldPlace:
    along, name = min(boundary.at, length), boundary.name
    start, direction = start_of(harness)
    x, y, z = (begin + along * component for begin, component in zip(start, direction, strict=True))
    if isinstance(boundary, String):
        first, by = Leg(0, first_anchor(boundary, (x, y, z))), boundary.by or harness.steps
        return _HeldPlace(number, name, along, (first, Leg(by, boundary.anchor)), harness.steps)
    legs = legs_of(boundary, (x, y, z), harness.steps)
    last = harness.steps if boundary.release is None else boundary.release - 1
    return _HeldPlace(number, name, along, legs, last)


def _apart(one: _HeldPlace, other: _HeldPlace, reach: float, path: KeyPath) -> Iterator[Fault]:
    last = min(one.last, other.last)
    steps = sorted({leg.step for place in (one, other) for leg in place.legs} | {last})
    for step in (step for step in steps if step <= last):
        distance = math.dist(one.position(step), other.position(step))
        if distance > reach * REACH_FACTOR:
            expected = f"at most the {_mm(reach)} that lie between {one.name!r} and {other.name!r}"
            found, remedy = f"{_mm(distance)} between them at step {step}", _NEARER
            yield Fault(path or ("boundaries", other.number), expected, found, remedy)
            return


_NEARER = "Bring them nearer, or make the line longer."


def _out_of_reach(
    ring: Ring, places: Sequence[_HeldPlace], length: float, path: KeyPath
) -> Iterator[Fault]:
    """Find a ring that no place of the line comes to, once all that holds the line is there."""
    alongs = [place.along for place in places]
    far = [math.dist(ring.position, place.position(place.last)) for place in places]
    rooms = [(length - alongs[-1], far[-1]), (alongs[0], far[0])] if places else []
    rooms += zip(map(sub, alongs[1:], alongs), map(add, far, far[1:]), strict=True)
    if rooms and not any(needed <= reach * REACH_FACTOR for reach, needed in rooms):
        reach, needed = min(rooms, key=lambda room: room[1] - room[0])
        expected = f"a ring that the line comes to: {_mm(reach)} of it are there"
        found = f"a way of {_mm(needed)} by {ring.name!r}"
        yield Fault(path, expected, found, "Bring it nearer, or make the line longer.")


def _mm(length: float) -> str:
    return f"{1e3 * length:.6g} mm"
