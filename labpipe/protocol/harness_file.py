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
from pathlib import Path
from typing import Annotated, Literal, TypeAlias

import numpy as np
from pydantic import AfterValidator, Field, PlainSerializer, PlainValidator

from labpipe.errors import Fault, KeyPath
from labpipe.protocol.cross_checks import find_implausible_sizes
from labpipe.protocol.grammar import Block
from labpipe.protocol.schema import Version
from labpipe.protocol.source import Plausible
from labpipe.protocol.values import (
    QuantityText,
    Remark,
    SingleLine,
    Text,
    build_row_validator,
    parse_or_none,
    suggest_quantity,
)
from labpipe.protocol.yaml_text import Values, find_repeated_names, get_block, get_list, refused
from labpipe.records.arrays import Floats
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

MAX_EQUILIBRIA = 2000
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
        raise refused("protocol.no_direction", found=list(vector))
    return x / size, y / size, z / size


Position: TypeAlias = Annotated[
    tuple[Coordinate, Coordinate, Coordinate], build_row_validator(3, "[120 mm, 0 mm, 0 mm]")
]
Direction: TypeAlias = Annotated[
    tuple[Component, Component, Component],
    build_row_validator(3, "[1, 0, 0]"),
    AfterValidator(_of_unit_length),
]
ForceVector: TypeAlias = Annotated[
    tuple[LoadComponent, LoadComponent, LoadComponent], build_row_validator(3, "[0 N, 0 N, -2 N]")
]
Acceleration: TypeAlias = Annotated[
    tuple[AccelerationComponent, AccelerationComponent, AccelerationComponent],
    build_row_validator(3, "[0 m/s^2, 0 m/s^2, -9.81 m/s^2]"),
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
        remedy = suggest_quantity(value, "m", "120 mm")
        raise refused("protocol.no_place", found=value, remedy=remedy) from error


def _written_place(place: float) -> str:
    """Name a place on the line, m from its start, as YAML does."""
    return {at: word for word, at in _WORDS.items()}.get(place) or _ALONG.format(place)


Place: TypeAlias = Annotated[float, PlainValidator(_place), PlainSerializer(_written_place)]
Step: TypeAlias = Annotated[int, WholeNumber(1, MAX_EQUILIBRIA)]
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
    def find_contradictions(cls, data: Values) -> Iterator[Fault]:
        """Ask for one source of the law, all that it needs, and nothing that it does not take."""
        kinds = [name for name in _KINDS if data.get(name) is not None]
        if len(kinds) != 1:
            found = " and ".join(map(repr, kinds)) or "none of them"
            yield Fault.of("protocol.no_one_section", found=found)
            return
        kind, own = kinds[0], _OWN_KEYS[kinds[0]]
        for key, why in _NEEDED[kind].items():
            if data.get(key) is None:
                yield Fault.of("protocol.no_section_key", missing=key, key=key, kind=kind, why=why)
        for key in sorted({key for keys in _OWN_KEYS.values() for key in keys} & {*data} - {*own}):
            valid = ", ".join(map(repr, own))
            yield Fault.of(
                "protocol.other_section", (key,), at="key", key=key, kind=kind, own=valid
            )


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
    name: SingleLine
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
    name: SingleLine
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
    name: SingleLine
    at: Place
    path: tuple[Waypoint, ...] = Field((), description="From where the line lies at the start")
    holds: Literal["pose", "position"] = Field(
        "pose", description="position: the line may turn in it"
    )
    release: Step | None = Field(None, description="Step from which it lets go")

    @classmethod
    def find_contradictions(cls, data: Values) -> Iterator[Fault]:
        """Ask for waypoints in order, and for none of a direction that is not held."""
        points = [get_block(point) for point in get_list(data, "path")]
        steps = [str(point.get("step")) for point in points]
        for number, (one, other) in enumerate(pairwise(steps), start=1):
            if one.isdecimal() and other.isdecimal() and int(other) <= int(one):
                path = ("path", number, "step")
                yield Fault.of("protocol.step_not_after", path, before=one, found=other)
        for number, point in enumerate(points if data.get("holds") == "position" else []):
            for key in sorted(_OF_POSES & {*point}):
                yield Fault.of("protocol.turn_of_no_pose", ("path", number, key), at="key", key=key)


_OF_POSES = {"direction", "turn"}


class Ring(Block):
    """A clip that the line slides through without friction; it is brought there with the line."""

    kind: Literal["ring"]
    name: SingleLine
    position: Position
    direction: Direction = Field(description="Of its opening in the picture; the line turns in it")
    by: Step | None = Field(None, description="Step at which it is there; else the last")


class String(Block):
    """A thread that ties a place of the line to an anchor; it pulls and never pushes."""

    kind: Literal["string"]
    name: SingleLine
    at: Place
    anchor: Position
    length: Length
    by: Step | None = Field(
        None, description="Step at which the anchor is there, if it is too far at the start"
    )


class Load(Block):
    """A force that keeps its direction; it grows from nothing."""

    kind: Literal["load"]
    name: SingleLine
    at: Place
    force: ForceVector
    by: Step | None = Field(None, description="Step at which it is whole; else the last")


class Plane(Block):
    """A table or a wall: the line lies on it, its axis half its diameter above."""

    kind: Literal["plane"]
    name: SingleLine
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
    def find_contradictions(cls, data: Values) -> Iterator[Fault]:
        """Ask for more than one length."""
        lengths = data.get("length")
        if isinstance(lengths, list) and len(lengths) < 2:
            yield Fault.of("protocol.one_length", ("length",), found=len(lengths))


class HarnessFile(Block):
    """One line between its boundaries."""

    version: Version
    about: Remark = Field("", description="What it is, in one line")
    line: LineBlock
    boundaries: tuple[Annotated[Boundary, Field(discriminator="kind")], ...] = Field(
        json_schema_extra={"minItems": 1}
    )
    steps: Annotated[int, WholeNumber(1, MAX_EQUILIBRIA)] = Field(
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
    def find_contradictions(cls, data: Values) -> Iterator[Fault]:
        """Check steps, names and places against the whole, and that something holds the line."""
        yield from find_implausible_sizes(data, ("line", "boundaries", "sweep"), in_file=True)
        boundaries = [get_block(boundary) for boundary in get_list(data, "boundaries")]
        yield from _late_steps(data, boundaries)
        yield from find_repeated_names(boundaries, "boundaries", "boundary")
        yield from _same_places(boundaries)
        kinds = {boundary.get("kind") for boundary in boundaries}
        if isinstance(data.get("boundaries"), list) and not kinds & {*_HOLDING, None}:
            yield Fault.of("protocol.nothing_holds", ("boundaries",))


def _late_steps(data: Values, boundaries: Sequence[Values]) -> Iterator[Fault]:
    """Find steps after the last one."""
    last = str(data.get("steps", HarnessFile.model_fields["steps"].default))
    steps: dict[KeyPath, object] = {
        ("show", i): step for i, step in enumerate(get_list(data, "show"))
    }
    for number, boundary in enumerate(boundaries):
        steps |= {("boundaries", number, key): boundary.get(key) for key in ("by", "release")}
        for i, point in enumerate(get_list(boundary, "path")):
            steps["boundaries", number, "path", i, "step"] = get_block(point).get("step")
    for path, step in steps.items():
        if last.isdecimal() and str(step).isdecimal() and int(str(step)) > int(last):
            yield Fault.of("protocol.late_step", path, last=last, found=step)


def _same_places(boundaries: Sequence[Values]) -> Iterator[Fault]:
    """Find two boundaries that hold one place of the line."""
    first: dict[object, object] = {}
    for number, boundary in enumerate(boundaries):
        at = str(boundary.get("at"))
        place = at if at in _WORDS else parse_or_none(at, "m")
        if boundary.get("kind") not in _HELD_KINDS or place is None:
            continue
        if place in first:
            path = ("boundaries", number, "at")
            yield Fault.of("protocol.place_taken", path, found=at, other=first[place])
        first.setdefault(place, boundary.get("name"))


REACH_FACTOR = 1.0 + 1e-9
"""On the length, so that a line may be straight between two clips."""


def find_named_file(name: str, path: Path) -> Path:
    """Find a file that a harness names: beside it, or else from the working folder.

    Parameters
    ----------
    name : as written
    path : of the harness YAML
    """
    beside = path.parent / name
    return beside if beside.exists() else Path(name)


def find_missing_files(harness: HarnessFile, path: Path) -> Iterator[Fault]:
    """Find files that a harness names and that are not there.

    Parameters
    ----------
    harness : whose parts are valid
    path : of its YAML
    """
    for key in ("sheet", "calibration", "sliders"):
        name = getattr(harness.line.section, key)
        if name is not None and not find_named_file(name, path).is_file():
            here, place = path.parent / name, ("line", "section", key)
            yield Fault.of(
                "protocol.no_harness_file", place, name=name, here=here, there=Path(name)
            )


def find_line_start(harness: HarnessFile) -> tuple[Vector3, Vector3]:
    """Where the line begins at the start, m, and in which direction it lies.

    Parameters
    ----------
    harness : whose line may leave both to the clip at its start
    """
    line = harness.line
    held = (boundary for boundary in harness.boundaries if isinstance(boundary, HELD))
    first = next((boundary for boundary in held if boundary.at == START), None)
    position, direction = line.start, line.direction
    if position is None:
        position = (0.0, 0.0, 0.0) if first is None or isinstance(first, Grip) else first.position
    if direction is None:
        direction = first.direction if isinstance(first, Clip) else None
    return position, direction or (1.0, 0.0, 0.0)


def compute_path(boundary: Held | String, start: Sequence[float] | Floats, steps: int) -> Floats:
    """Find where something that holds the line is in each step, straight from pose to pose.

    Parameters
    ----------
    boundary : clip, pin, grip, or a string, whose anchor goes from as far as the string is long
    start : m, where the line lies at the start
    steps : of the harness

    Returns
    -------
    shape (steps + 1, 3), m
    """
    at, corners = [0], [np.array(start, dtype=float)]
    if isinstance(boundary, Grip):
        for point in boundary.path:
            at.append(point.step)
            corners.append(corners[-1] if point.position is None else np.array(point.position))
    else:
        end = np.array(boundary.anchor if isinstance(boundary, String) else boundary.position)
        if isinstance(boundary, String):
            distance = float(np.linalg.norm(end - corners[0]))
            share = min(1.0, boundary.length / distance) if distance else 1.0
            corners = [corners[0] + share * (end - corners[0])]
        at.append(boundary.by or steps)
        corners.append(end)
    rows = np.arange(steps + 1)
    return np.column_stack([np.interp(rows, at, axis) for axis in np.array(corners).T])


def find_unreachable_places(harness: HarnessFile) -> Iterator[Fault]:
    """Find what the line is too short for, and what else cannot be.

    Parameters
    ----------
    harness : whose parts are valid

    Yields
    ------
    A fault for each two boundaries that are too far apart, with the step and the distance; those
    of a sweep for the shortest line of it that is too short. One for each that holds the line
    nearer to a plane than half the diameter that the file states; that of a wire sheet is not
    known here. One for each turn of half a turn or more in a step, which is one the other way, too,
    and for a curl that elements are too long for. One for each ring that the line cannot reach, for
    each release before the line arrives, and for a line that falls because nothing holds it.
    """
    yield from _find_release_faults(harness)
    yield from _in_planes(harness)
    yield from _turned_too_far(harness)
    yield from _curled_too_far(harness)
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
            here = path or ("boundaries", number, "at")
            yield Fault.of("protocol.off_the_line", here, length=1e3 * length, found=1e3 * place)


def _find_release_faults(harness: HarnessFile) -> Iterator[Fault]:
    """Find releases before the line arrives, and the step from which nothing holds the line."""
    releases: dict[int, int | None] = {}
    for number, held in enumerate(harness.boundaries):
        if isinstance(held, HELD):
            releases[number] = held.release
            arrival = (
                min((point.step for point in held.path), default=None)
                if isinstance(held, Grip)
                else held.by
            )
            if held.release is not None and arrival is not None and held.release <= arrival:
                path = ("boundaries", number, "release")
                yield Fault.of(
                    "protocol.early_release",
                    path,
                    arrival=arrival,
                    name=held.name,
                    found=held.release,
                )
    section = harness.line.section
    has_weight = section.bending_stiffness is None or section.mass_per_length
    has_support = any(not isinstance(part, (*HELD, Load)) for part in harness.boundaries)
    steps = {number: step for number, step in releases.items() if step is not None}
    if has_weight and any(harness.gravity) and not has_support and len(steps) == len(releases):
        last = max(steps, key=lambda number: steps[number])
        yield Fault.of("protocol.falls", ("boundaries", last, "release"), step=steps[last])


def _in_planes(harness: HarnessFile) -> Iterator[Fault]:
    radius = 0.5 * (harness.line.section.diameter or 0.0)
    first = 0 if harness.line.spool is None else 1  # where a curled line begins is not known here
    places = _places(harness, harness.line.length, Clip, Pin, Grip)
    planes = [boundary for boundary in harness.boundaries if isinstance(boundary, Plane)]
    for plane, place in product(planes, places):
        heights = (place.path[first:] - np.array(plane.point)) @ np.array(plane.normal)
        if heights.size and heights.min() < radius - 1e-9 * harness.line.length:
            yield Fault.of(
                "protocol.in_plane",
                ("boundaries", place.number),
                radius=1e3 * radius,
                plane=plane.name,
                found=1e3 * heights.min(),
                step=int(heights.argmin()) + first,
            )


def _turned_too_far(harness: HarnessFile) -> Iterator[Fault]:
    # A path is a row of frames, in which a turn and one 360 deg less are the same.
    for number, boundary in enumerate(harness.boundaries):
        for key, start, end, turn in _turns_of(boundary, harness.steps):
            per_step = math.degrees(abs(turn)) / (end - start)
            if per_step >= 180.0:
                path = ("boundaries", number, *key)
                yield Fault.of("protocol.turn", path, found=per_step, start=start, end=end)


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
    most = 90.0
    line, swept = harness.line, harness.sweep.length if harness.sweep else ()
    element = max([line.length, *swept]) / line.elements
    curl = 0.0 if line.spool is None else math.degrees(line.spool.curvature * element)
    if curl > most:
        path = ("line", "spool", "curvature")
        yield Fault.of("protocol.curl", path, most=most, element=1e3 * element, found=curl)


@dataclass(frozen=True, slots=True)
class _Place:
    """A place of the line and where a boundary holds it.

    Parameters
    ----------
    number, name : of the boundary
    along : m, from the start of the line
    path : m, where it is in each step up to the last in which it holds
    thread : m, length of the string that ties the line to it; 0 for what holds it
    """

    number: int
    name: str
    along: float
    path: Floats
    thread: float


def _places(harness: HarnessFile, length: float, *kinds: type[Held | String]) -> list[_Place]:
    start, direction = map(np.array, find_line_start(harness))
    places = []
    for number, boundary in enumerate(harness.boundaries):
        if isinstance(boundary, kinds):
            along = min(boundary.at, length)
            path = compute_path(boundary, start + along * direction, harness.steps)
            path = path[: getattr(boundary, "release", None) or harness.steps + 1]
            thread = boundary.length if isinstance(boundary, String) else 0.0
            places.append(_Place(number, boundary.name, along, path, thread))
    return sorted(places, key=lambda place: place.along)


def _too_far(harness: HarnessFile, length: float, path: KeyPath) -> Iterator[Fault]:
    places = _places(harness, length, Clip, Pin, Grip, String)
    for one, other in combinations(places, 2):
        reach = other.along - one.along + one.thread + other.thread
        rows = min(len(one.path), len(other.path))
        distances = np.linalg.norm(one.path[:rows] - other.path[:rows], axis=1)
        if distances.max() > reach * REACH_FACTOR:
            yield Fault.of(
                "protocol.too_far",
                path or ("boundaries", max(one.number, other.number)),
                reach=1e3 * reach,
                one=one.name,
                other=other.name,
                found=1e3 * distances.max(),
                step=distances.argmax(),
            )
    fixed = [place for place in places if not place.thread]
    for number, ring in enumerate(harness.boundaries):
        if isinstance(ring, Ring) and fixed:
            far = [math.dist(ring.position, place.path[-1]) for place in fixed]
            spans = [(far[0], fixed[0].along), (far[-1], length - fixed[-1].along)]
            between = zip(pairwise(far), pairwise(fixed), strict=True)
            spans += [(sum(ways), other.along - one.along) for ways, (one, other) in between]
            needed, reach = min(spans, key=lambda span: span[0] - span[1])
            if needed > reach * REACH_FACTOR:
                here, needed, reach = path or ("boundaries", number), 1e3 * needed, 1e3 * reach
                name = ring.name
                yield Fault.of("protocol.ring_too_far", here, reach=reach, found=needed, ring=name)
