"""The grammar of a harness YAML: one line between its clips, and what moves it.

A line has a length, a section and a rest shape. Boundaries hold it (clips, pins, grips on paths,
rings, strings), loads pull it, a plane carries it. Time is counted in steps: a row of equilibria
that begins with the shape at rest. One line is all there is as yet; the key of another would stand
beside ``line``, and a boundary would say which one it holds.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Annotated, Literal, TypeAlias

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
Scatter: TypeAlias = Annotated[float, Quantity("1/m", "1/m", "0.5 1/m", least=0.0)]

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
        """What the law comes from: ``wire``, ``sliders`` or ``bending_stiffness``."""
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
