"""The grammar of a harness YAML: one line between its clips, and what moves it.

A line has a length, a section and a rest shape. Boundaries hold it (clips, pins, grips on paths,
rings, strings), loads pull it, a plane carries it. Time is counted in steps: a row of equilibria
that begins with the shape at rest. One line is all there is as yet; the key of another would stand
beside ``line``, and a boundary would say which one it holds.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from itertools import pairwise
from typing import Annotated, Literal, TypeAlias

from pydantic import BeforeValidator, Field, PlainSerializer, PlainValidator, WithJsonSchema

from labpipe.errors import Fault, KeyPath
from labpipe.protocol.faults import error_of
from labpipe.protocol.grammar import Block
from labpipe.protocol.plausible import Plausible, plausible_faults
from labpipe.protocol.schema import known_version
from labpipe.protocol.values import Line as TextLine
from labpipe.protocol.values import QuantityText, Remark, Text, quantity_remedy
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
_COORDINATE = QuantityText(Quantity("m", "mm", "120 mm"))
_NUMBER = QuantityText(Quantity("1", "1", "0.5"))
_FORCE = QuantityText(Quantity("N", "N", "-2 N"))
_ACCELERATION = QuantityText(Quantity("m/s^2", "m/s^2", "-9.81 m/s^2"))


def _vector(text: QuantityText) -> Callable[[object], Vector3]:
    """Return what reads three quantities of one kind, along x, y and z."""
    example = f"[{text.of.example}, {text.of.example}, {text.of.example}]"

    def parse(value: object) -> Vector3:
        if not isinstance(value, list | tuple) or len(value) != 3:
            actual = f"a list of {len(value)}" if isinstance(value, list | tuple) else value
            remedy = f"Write x, y and z, such as {example}."
            raise error_of(expected="a list of three quantities", found=actual, remedy=remedy)
        x, y, z = (text.parse(component) for component in value)
        return x, y, z

    return parse


def _written(text: QuantityText) -> PlainSerializer:
    return PlainSerializer(lambda vector: [text.written(component) for component in vector])


def _three_of(text: QuantityText) -> WithJsonSchema:
    return WithJsonSchema({"type": "array", "minItems": 3, "maxItems": 3, "items": text.schema})


def _direction(value: object) -> Vector3:
    x, y, z = _vector(_NUMBER)(value)
    size = math.hypot(x, y, z)
    if size == 0.0:
        remedy = "Write x, y and z, such as [1, 0, 0]."
        raise error_of(expected="a direction", found="one without length", remedy=remedy)
    return x / size, y / size, z / size


Position: TypeAlias = Annotated[
    Vector3, PlainValidator(_vector(_COORDINATE)), _written(_COORDINATE), _three_of(_COORDINATE)
]
Direction: TypeAlias = Annotated[
    Vector3, PlainValidator(_direction), _written(_NUMBER), _three_of(_NUMBER)
]
ForceVector: TypeAlias = Annotated[
    Vector3, PlainValidator(_vector(_FORCE)), _written(_FORCE), _three_of(_FORCE)
]
Acceleration: TypeAlias = Annotated[
    Vector3, PlainValidator(_vector(_ACCELERATION)), _written(_ACCELERATION),
    _three_of(_ACCELERATION),
]  # fmt: skip

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
    WithJsonSchema(
        {"anyOf": [{"enum": list(_WORDS)}, _ALONG.schema], "description": "Where on the line"}
    ),
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
_NEEDED = {
    "wire": (),
    "sliders": ("diameter",),
    "bending_stiffness": ("largest_curvature", "torsional_stiffness", "diameter"),
}


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
    def between(cls, data: object) -> list[Fault]:
        """Ask for one source of the law, all that it needs, and nothing that it does not take."""
        if not isinstance(data, Mapping):
            return []
        kinds = [name for name in _KINDS if data.get(name) is not None]
        if len(kinds) != 1:
            actual = " and ".join(map(repr, kinds)) or "none of them"
            expected = "one of the keys 'wire', 'sliders' and 'bending_stiffness'"
            return [Fault((), expected, actual, "Say once what the line is made of.")]
        kind = kinds[0]
        faults = [
            Fault((), f"the key {key!r} beside {kind!r}", "no such key", _why(key), missing=key)
            for key in _NEEDED[kind]
            if data.get(key) is None
        ]
        others = {key for keys in _OWN_KEYS.values() for key in keys} - {*_OWN_KEYS[kind]}
        for key in sorted(others & {*data}):
            expected = f"only keys that go with {kind!r}: {', '.join(map(repr, _OWN_KEYS[kind]))}"
            faults.append(Fault((key,), expected, repr(key), "Take it away.", "key"))
        return faults


def _why(key: str) -> str:
    """Return why a section needs a key."""
    reasons = {
        "diameter": "Add it: the allowed bend radius goes by it.",
        "largest_curvature": "A law needs a range: add the largest curvature that was tested.",
        "torsional_stiffness": "Add it; about 0.8 times the bending stiffness for a round bar.",
    }
    return reasons[key]


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
    def between(cls, data: object) -> list[Fault]:
        """Ask for waypoints in order, and for none of a direction that is not held."""
        if not isinstance(data, Mapping) or not isinstance(data.get("path"), list):
            return []
        points = [datum if isinstance(datum, Mapping) else {} for datum in data["path"]]
        faults = []
        for number, (one, other) in enumerate(pairwise(points), start=1):
            steps = [str(part.get("step")) for part in (one, other)]
            if all(step.isdecimal() for step in steps) and int(steps[1]) <= int(steps[0]):
                path = ("path", number, "step")
                faults.append(Fault(path, f"a step after {steps[0]}", steps[1], "Order them."))
        if data.get("holds") == "position":
            turned = [(i, key) for i, point in enumerate(points) for key in _OF_POSES & {*point}]
            for number, key in sorted(turned):
                actual, remedy = f"the key {key!r}", "Take it away, or write 'holds: pose'."
                expected = "positions alone, of a grip that the line may turn in"
                faults.append(Fault(("path", number, key), expected, actual, remedy, "key"))
        return faults


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
    def between(cls, data: object) -> list[Fault]:
        """Ask for more than one length."""
        lengths = data.get("length") if isinstance(data, Mapping) else None
        if not isinstance(lengths, list) or len(lengths) > 1:
            return []
        remedy = "Add one, or take 'sweep' away."
        return [Fault(("length",), "two lengths or more", str(len(lengths)), remedy)]


class HarnessFile(Block):
    """One line between its boundaries."""

    version: Annotated[Literal[1], BeforeValidator(known_version), WithJsonSchema({"const": 1})]
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
    def between(cls, data: object) -> list[Fault]:
        """Check steps, names and places against the whole, and that something holds the line."""
        if not isinstance(data, Mapping):
            return []
        faults = [*plausible_faults(data, ("line", "boundaries", "sweep"), in_file=True)]
        if not isinstance(data.get("boundaries"), list):
            return faults
        boundaries = [datum if isinstance(datum, Mapping) else {} for datum in data["boundaries"]]
        kinds = [boundary.get("kind") for boundary in boundaries]
        faults += [
            *_late_steps(data, boundaries),
            *_same_names(boundaries),
            *_same_places(boundaries),
        ]
        if not any(kind in (*_HOLDING, None) for kind in kinds):
            expected = "a boundary that holds the line: clip, pin, grip or string"
            faults.append(Fault(("boundaries",), expected, "none", "Add one."))
        return faults


def _late_steps(data: Mapping[str, object], boundaries: list[Mapping[str, object]]) -> list[Fault]:
    """Find steps after the last one."""
    last = str(data.get("steps", HarnessFile.model_fields["steps"].default))
    show = data.get("show")
    steps: list[tuple[KeyPath, object]] = [
        (("show", i), boundary) for i, boundary in enumerate(show if isinstance(show, list) else [])
    ]
    for number, boundary in enumerate(boundaries):
        steps += [(("boundaries", number, key), boundary.get(key)) for key in ("by", "release")]
        points = boundary.get("path")
        for i, point in enumerate(points if isinstance(points, list) else []):
            step = point.get("step") if isinstance(point, Mapping) else None
            steps.append((("boundaries", number, "path", i, "step"), step))
    return [
        Fault(path, f"a step from 1 to {last}, the last", repr(str(step)), "Or raise 'steps'.")
        for path, step in steps
        if last.isdecimal() and str(step).isdecimal() and int(str(step)) > int(last)
    ]


def _same_names(boundaries: list[Mapping[str, object]]) -> list[Fault]:
    """Find boundaries that are called as an earlier one."""
    first: dict[str, int] = {}
    faults = []
    for number, boundary in enumerate(boundaries):
        name = str(boundary.get("name", f"- {number}"))
        if name in first:
            path = ("boundaries", number, "name")
            actual = f"{name!r}, as boundary {first[name] + 1}"
            faults.append(Fault(path, "a name of its own", actual, "Call it something else."))
        first.setdefault(name, number)
    return faults


def _same_places(boundaries: list[Mapping[str, object]]) -> list[Fault]:
    """Find two boundaries that hold one place of the line."""
    first: dict[float, object] = {}
    faults = []
    for number, boundary in enumerate(boundaries):
        if boundary.get("kind") not in _HELD_KINDS or boundary.get("at") is None:
            continue
        try:
            place = round(_place(boundary["at"]), 12)
        except ValueError:  # which is a fault of its own
            continue
        if place in first:
            path = ("boundaries", number, "at")
            actual = f"{boundary['at']!r}, which {first[place]!r} holds"
            expected, remedy = "a place that nothing else holds", "Take one of them away."
            faults.append(Fault(path, expected, actual, remedy))
        first.setdefault(place, boundary.get("name"))
    return faults
