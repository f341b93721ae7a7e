"""The grammar of a harness YAML: one line between its clips, and what moves it.

A line has a length, a section and a rest shape. Boundaries hold it (clips, pins, grips on paths,
rings, strings), loads pull it, a plane carries it. Time is counted in steps: a row of equilibria
that begins with the shape at rest. One line is all there is as yet; the key of another would stand
beside ``line``, and a boundary would say which one it holds.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise, product
from operator import add, sub
from pathlib import Path
from typing import Annotated, Literal, TypeAlias, TypeVar

from pydantic import AfterValidator, Field, PlainSerializer, PlainValidator

from labpipe.errors import Fault, KeyPath
from labpipe.protocol.faults import Values, block_in, error_of, list_in, same_names
from labpipe.protocol.grammar import Block
from labpipe.protocol.plausible import Plausible, plausible_faults
from labpipe.protocol.schema import Version
from labpipe.protocol.values import Line as TextLine
from labpipe.protocol.values import QuantityText, Remark, Text, quantity_remedy, row_of
from labpipe.records.declarations import (
    Curvature,
    Length,
    LinearMass,
    Quantity,
    Ratio,
    Uncertainty,
    WholeNumber,
)
from labpipe.units import GRAVITY

MAX_STEPS = 2000
MAX_ELEMENTS = 2000
MIN_ELEMENTS = 4
START, END = 0.0, math.inf
"""Places on a line that have a word; any other is a length from its start, m."""

Vector3: TypeAlias = tuple[float, float, float]
Coordinate: TypeAlias = Annotated[float, Quantity("m", "mm", "120 mm")]
Component: TypeAlias = Annotated[float, Quantity("1", "1", "0.5")]
LoadComponent: TypeAlias = Annotated[float, Quantity("N", "N", "-2 N")]
AccelerationComponent: TypeAlias = Annotated[float, Quantity("m/s^2", "m/s^2", "-9.81 m/s^2")]


def _of_unit_length(vector: Vector3) -> Vector3:
    x, y, z = vector
    size = math.hypot(x, y, z)
    if size == 0.0:
        remedy = "Write x, y and z, such as [1, 0, 0]."
        raise error_of(expected="a direction", found="one without length", remedy=remedy)
    return x / size, y / size, z / size


Position: TypeAlias = Annotated[
    tuple[Coordinate, Coordinate, Coordinate], row_of(3, "[120 mm, 0 mm, 0 mm]")
]
Direction: TypeAlias = Annotated[
    tuple[Component, Component, Component],
    row_of(3, "[1, 0, 0]"),
    AfterValidator(_of_unit_length),
]
ForceVector: TypeAlias = Annotated[
    tuple[LoadComponent, LoadComponent, LoadComponent], row_of(3, "[0 N, 0 N, -2 N]")
]
Acceleration: TypeAlias = Annotated[
    tuple[AccelerationComponent, AccelerationComponent, AccelerationComponent],
    row_of(3, "[0 m/s^2, 0 m/s^2, -9.81 m/s^2]"),
]

_ALONG = QuantityText(Quantity("m", "mm", "120 mm", above=0.0))
_WORDS = {"start": START, "end": END}


def _place(value: object) -> float:
    word = str(value)
    if word in _WORDS:
        return _WORDS[word]
    try:
        return _ALONG.parse(value)
    except ValueError as error:
        expected = "'start', 'end', or a length from the start such as 120 mm"
        remedy = quantity_remedy(value, "m", "120 mm")
        raise error_of(expected=expected, found=value, remedy=remedy) from error


def written_place(place: float) -> str:
    """Name a place on the line as YAML does.

    Parameters
    ----------
    place : m from the start; `START`, or `END`
    """
    return {at: word for word, at in _WORDS.items()}.get(place) or _ALONG.written(place)


Place: TypeAlias = Annotated[
    float,
    PlainValidator(_place),
    PlainSerializer(written_place),
]
Step: TypeAlias = Annotated[int, WholeNumber(1, MAX_STEPS)]
Angle: TypeAlias = Annotated[float, Quantity("rad", "deg", "90 deg")]
BendingStiffness: TypeAlias = Annotated[float, Quantity("N*m^2", "N*mm^2", "150 N*mm^2", above=0.0)]
TorsionalStiffness: TypeAlias = Annotated[
    float, Quantity("N*m^2", "N*mm^2", "90 N*mm^2", above=0.0)
]
AxialStiffness: TypeAlias = Annotated[float, Quantity("N", "N", "40000 N", above=0.0)]
Scatter: TypeAlias = Annotated[float, Quantity("1/m", "1/m", "0.5 1/m", minimum=0.0)]

_KINDS = ("wire", "sliders", "bending_stiffness")
_OWN_KEYS = {
    "wire": ("sheet", "calibration"),
    "sliders": ("diameter", "axial_stiffness"),
    "bending_stiffness": (
        *("largest_curvature", "torsional_stiffness", "axial_stiffness"),
        *("mass_per_length", "diameter"),
    ),
}
_DIAMETER = {"diameter": "Add it: the allowed bend radius goes by it."}
_NEEDED: dict[str, dict[str, str]] = {
    "wire": {},
    "sliders": _DIAMETER,
    "bending_stiffness": _DIAMETER
    | {
        "largest_curvature": "A law needs a range: add the largest curvature that was tested.",
        "torsional_stiffness": "Add it; about 0.8 times the bending stiffness for a round bar.",
    },
}
"""Keys that each source of the law needs, and why."""


class SectionBlock(Block):
    """What the line is made of: a wire of a sheet, a deck of sliders, or two stiffnesses."""

    wire: Text | None = Field(None, description="Name of a wire of the sheet")
    sheet: Text | None = Field(
        None, description="Wire sheet; else wires.xlsx beside this file, or what --wire names"
    )
    calibration: Text | None = Field(
        None, description="calibration.json whose numbers replace those of the sheet, with bands"
    )
    sliders: Text | None = Field(
        None, description="Deck <wire>.sliders.json that `labpipe model` wrote"
    )
    bending_stiffness: BendingStiffness | None = Field(
        None, description="EI, constant; of a chain next to nothing, such as 0.01 N*mm^2"
    )
    torsional_stiffness: TorsionalStiffness | None = Field(None, description="GJ")
    axial_stiffness: AxialStiffness | None = Field(
        None, description="EA; else that of the wire, or a line that does not stretch"
    )
    mass_per_length: LinearMass | None = Field(None, description="Else that of the wire, or none")
    diameter: Length | None = Field(None, description="Over the insulation or the tape")
    largest_curvature: Curvature | None = Field(
        None, description="Up to which the bending stiffness was found; doubtful beyond"
    )
    stiffness_uncertainty: Uncertainty | None = Field(
        None, description="Standard uncertainty of the bending stiffness, for bands"
    )

    @property
    def kind(self) -> str:
        """Return what the law comes from: ``wire``, ``sliders`` or ``bending_stiffness``."""
        return next(name for name in _KINDS if getattr(self, name) is not None)

    @classmethod
    def between(cls, data: Values) -> Iterator[Fault]:
        """Ask for one source of the law, all that it needs, and nothing that it does not take."""
        kinds = [name for name in _KINDS if data.get(name) is not None]
        if len(kinds) != 1:
            actual = " and ".join(map(repr, kinds)) or "none of them"
            expected = "one of the keys 'wire', 'sliders' and 'bending_stiffness'"
            yield Fault((), expected, actual, "Say once what the line is made of.")
            return
        kind = kinds[0]
        for key, why in _NEEDED[kind].items():
            if data.get(key) is None:
                yield Fault((), f"the key {key!r} beside {kind!r}", "no such key", why, missing=key)
        others = {key for keys in _OWN_KEYS.values() for key in keys} - {*_OWN_KEYS[kind]}
        for key in sorted(others & {*data}):
            expected = f"only keys that go with {kind!r}: {', '.join(map(repr, _OWN_KEYS[kind]))}"
            yield Fault((key,), expected, repr(key), "Take it away.", "key")


class Spool(Block):
    """The curl that a spool left: the line is curved where nothing holds it."""

    curvature: Curvature = Field(description="One over the radius of the curl")
    towards: Direction = Field((0.0, 0.0, -1.0), description="Side to which it curls at the start")
    spread: Scatter = Field(0.0, description="Standard deviation from piece to piece, for bands")


class LineBlock(Block):
    """The line: length, section, rest shape, and where it lies at the start."""

    length: Length = Field(description="From one end to the other, unstretched")
    elements: Annotated[int, WholeNumber(MIN_ELEMENTS, MAX_ELEMENTS)] = Field(
        40, description="Pieces that it is divided into"
    )
    section: SectionBlock
    spool: Spool | None = Field(None, description="None for a line that is straight at rest")
    start: Position | None = Field(
        None, description="Of the end that 'start' names; else where the clip or pin there is"
    )
    direction: Direction | None = Field(
        None, description="In which it lies from there; else that of the clip there, or along x"
    )


class Clip(Block):
    """Holds the line in position and direction; the line is brought there first."""

    kind: Literal["clip"]
    name: TextLine
    at: Place
    position: Position
    direction: Direction | None = Field(
        None, description="Of the line in it; as at the start where left out"
    )
    turn: Angle = Field(0.0, description="About that direction, which twists the line")
    by: Step | None = Field(None, description="Step at which the line is there; else the last")
    release: Step | None = Field(None, description="Step from which it lets go")


class Pin(Block):
    """Holds the line in position alone; the line is brought there first."""

    kind: Literal["pin"]
    name: TextLine
    at: Place
    position: Position
    by: Step | None = Field(None, description="Step at which the line is there; else the last")
    release: Step | None = Field(None, description="Step from which it lets go")


class Waypoint(Block):
    """A pose of a grip, reached in a straight line from the one before."""

    step: Step
    position: Position | None = Field(None, description="As before where left out")
    direction: Direction | None = Field(None, description="As before where left out")
    turn: Angle | None = Field(None, description="About the direction; as before where left out")


class Grip(Block):
    """Holds the line and moves it along a path."""

    kind: Literal["grip"]
    name: TextLine
    at: Place
    path: tuple[Waypoint, ...] = Field((), description="From where the line lies at the start")
    holds: Literal["pose", "position"] = Field(
        "pose", description="position: the line may turn in it"
    )
    release: Step | None = Field(None, description="Step from which it lets go")

    @classmethod
    def between(cls, data: Values) -> Iterator[Fault]:
        """Ask for waypoints in order, and for none of a direction that is not held."""
        points = [block_in(point) for point in list_in(data, "path")]
        for number, (one, other) in enumerate(pairwise(points), start=1):
            steps = [str(part.get("step")) for part in (one, other)]
            if all(step.isdecimal() for step in steps) and int(steps[1]) <= int(steps[0]):
                path = ("path", number, "step")
                yield Fault(path, f"a step after {steps[0]}", steps[1], "Order them.")
        if data.get("holds") == "position":
            turned = [(i, key) for i, point in enumerate(points) for key in _OF_POSES & {*point}]
            for number, key in sorted(turned):
                actual, remedy = f"the key {key!r}", "Take it away, or write 'holds: pose'."
                expected = "positions alone, of a grip that the line may turn in"
                yield Fault(("path", number, key), expected, actual, remedy, "key")


_OF_POSES = {"direction", "turn"}


class Ring(Block):
    """A clip that the line slides through without friction; it is brought there with the line."""

    kind: Literal["ring"]
    name: TextLine
    position: Position
    direction: Direction = Field(description="Of its opening in the picture; the line turns in it")
    by: Step | None = Field(None, description="Step at which it is there; else the last")


class String(Block):
    """A thread that ties a place of the line to an anchor; it pulls and never pushes."""

    kind: Literal["string"]
    name: TextLine
    at: Place
    anchor: Position
    length: Length
    by: Step | None = Field(
        None, description="Step at which the anchor is there, if it is too far at the start"
    )


class Load(Block):
    """A force that keeps its direction; it grows from nothing."""

    kind: Literal["load"]
    name: TextLine
    at: Place
    force: ForceVector
    by: Step | None = Field(None, description="Step at which it is whole; else the last")


class Plane(Block):
    """A table or a wall: the line lies on it, its axis half its diameter above."""

    kind: Literal["plane"]
    name: TextLine
    point: Position
    normal: Direction = (0.0, 0.0, 1.0)
    friction: Ratio = Field(0.0, description="Coefficient of Coulomb friction")


Boundary: TypeAlias = Clip | Pin | Grip | Ring | String | Load | Plane
Held: TypeAlias = Clip | Pin | Grip
HELD = (Clip, Pin, Grip)
"""Kinds of boundaries that hold one place of the line."""
_HELD_KINDS = ("clip", "pin", "grip")
_HOLDING = (*_HELD_KINDS, "string")


class Sweep(Block):
    """The same harness for several lengths of the line: slack against bend radius."""

    length: tuple[Length, ...] = Field(max_length=50, json_schema_extra={"minItems": 2})

    @classmethod
    def between(cls, data: Values) -> Iterator[Fault]:
        """Ask for more than one length."""
        lengths = data.get("length")
        if isinstance(lengths, list) and len(lengths) < 2:
            remedy = "Add one, or take 'sweep' away."
            yield Fault(("length",), "two lengths or more", str(len(lengths)), remedy)


class HarnessFile(Block):
    """One line between its boundaries."""

    version: Version
    about: Remark = Field("", description="What it is, in one line")
    line: LineBlock
    boundaries: tuple[Annotated[Boundary, Field(discriminator="kind")], ...] = Field(
        json_schema_extra={"minItems": 1}
    )
    steps: Annotated[int, WholeNumber(1, MAX_STEPS)] = Field(
        40, description="Equilibria after the start; more where a path is hard to follow"
    )
    gravity: Acceleration = Field((0.0, 0.0, -GRAVITY), description="Three zeros for none")
    allowed_bend_radius: Length | None = Field(
        None, description="Else 5 times the outer diameter, an assumption that the results name"
    )
    show: tuple[Step, ...] = Field((), description="Steps in shape.csv and figure beside the last")
    sweep: Sweep | None = Field(None, description="Lengths that are computed beside the line's own")
    plausible: Plausible = Field({}, description="Range of each kind of dimension; else shipped")

    @classmethod
    def between(cls, data: Values) -> Iterator[Fault]:
        """Check steps, names and places against the whole, and that something holds the line."""
        yield from plausible_faults(data, ("line", "boundaries", "sweep"), in_file=True)
        boundaries = [block_in(boundary) for boundary in list_in(data, "boundaries")]
        yield from _late_steps(data, boundaries)
        yield from same_names(boundaries, "boundaries", "boundary")
        yield from _same_places(boundaries)
        kinds = {boundary.get("kind") for boundary in boundaries}
        if isinstance(data.get("boundaries"), list) and not kinds & {*_HOLDING, None}:
            expected = "a boundary that holds the line: clip, pin, grip or string"
            yield Fault(("boundaries",), expected, "none", "Add one.")


def _late_steps(data: Values, boundaries: Sequence[Values]) -> Iterator[Fault]:
    """Find steps after the last one."""
    last = str(data.get("steps", HarnessFile.model_fields["steps"].default))
    steps: dict[KeyPath, object] = {
        ("show", number): step for number, step in enumerate(list_in(data, "show"))
    }
    for number, boundary in enumerate(boundaries):
        steps |= {("boundaries", number, key): boundary.get(key) for key in ("by", "release")}
        for i, point in enumerate(list_in(boundary, "path")):
            steps["boundaries", number, "path", i, "step"] = block_in(point).get("step")
    for path, step in steps.items():
        if last.isdecimal() and str(step).isdecimal() and int(str(step)) > int(last):
            expected = f"a step from 1 to {last}, the last"
            yield Fault(path, expected, repr(str(step)), "Or raise 'steps'.")


def _same_places(boundaries: Sequence[Values]) -> Iterator[Fault]:
    """Find two boundaries that hold one place of the line."""
    first: dict[float, object] = {}
    for number, boundary in enumerate(boundaries):
        if boundary.get("kind") not in _HELD_KINDS or boundary.get("at") is None:
            continue
        try:
            place = round(_place(boundary["at"]), 12)
        except ValueError:  # which is a fault of its own
            continue
        if place in first:
            path = ("boundaries", number, "at")
            found = f"{boundary['at']!r}, which {first[place]!r} holds"
            expected, remedy = "a place that nothing else holds", "Take one of them away."
            yield Fault(path, expected, found, remedy)
        first.setdefault(place, boundary.get("name"))


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
    held = (boundary for _, boundary in _held(harness))
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


def _numbered(harness: HarnessFile, kind: type[_B]) -> list[tuple[int, _B]]:
    """List the boundaries of a kind with their numbers."""
    return [(number, x) for number, x in enumerate(harness.boundaries) if isinstance(x, kind)]


def _held(harness: HarnessFile) -> list[tuple[int, Held]]:
    """List the boundaries that hold the line, with their numbers."""
    return [(number, x) for number, x in enumerate(harness.boundaries) if isinstance(x, HELD)]


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
    for number, held in _held(harness):
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
    releases = {number: held.release for number, held in _held(harness)}
    section = harness.line.section
    has_weight = section.kind != "bending_stiffness" or section.mass_per_length is not None
    others = any(not isinstance(boundary, (*HELD, Load)) for boundary in harness.boundaries)
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
    return [_place_of(harness, number, x, length) for number, x in _held(harness)]


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
