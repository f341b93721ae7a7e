"""Harness files: one line (a wire, a bundle or a chain), its boundaries, and its motion.

A line has a length, a section and a shape without load. Clips, pins, grips, rings and strings hold
it, loads pull it, and planes support it. Time is counted in steps; each step is an equilibrium, and
step 0 is the start.
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
from labpipe.protocol import values
from labpipe.protocol.cross_checks import find_implausible_sizes
from labpipe.protocol.grammar import Block
from labpipe.protocol.schema import Version
from labpipe.protocol.source import Plausible
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
"""Lengths from the start of a line, m, that YAML writes as ``start`` and ``end``."""

Vector3: TypeAlias = tuple[float, float, float]
Coordinate: TypeAlias = Annotated[float, Quantity("m", "mm", "120 mm")]
Component: TypeAlias = Annotated[float, Quantity("1", "1", "0.5")]
LoadComponent: TypeAlias = Annotated[float, Quantity("N", "N", "-2 N")]
AccelerationComponent: TypeAlias = Annotated[float, Quantity("m/s^2", "m/s^2", "-9.81 m/s^2")]


def _normalise(vector: Vector3) -> Vector3:
    x, y, z = vector
    size = math.hypot(x, y, z)
    if size == 0.0:
        raise refused("protocol.no_direction", found=list(vector))
    return x / size, y / size, z / size


Position: TypeAlias = Annotated[
    tuple[Coordinate, Coordinate, Coordinate], values.build_row_validator(3, "[120 mm, 0 mm, 0 mm]")
]
Direction: TypeAlias = Annotated[
    tuple[Component, Component, Component],
    values.build_row_validator(3, "[1, 0, 0]"),
    AfterValidator(_normalise),
]
ForceVector: TypeAlias = Annotated[
    tuple[LoadComponent, LoadComponent, LoadComponent],
    values.build_row_validator(3, "[0 N, 0 N, -2 N]"),
]
Acceleration: TypeAlias = Annotated[
    tuple[AccelerationComponent, AccelerationComponent, AccelerationComponent],
    values.build_row_validator(3, "[0 m/s^2, 0 m/s^2, -9.81 m/s^2]"),
]

_LENGTH_FROM_START = values.QuantityText(Quantity("m", "mm", "120 mm", above=0.0))
_NAMED_PLACES = {"start": START, "end": END}


def _parse_place(value: object) -> float:
    word = str(value)
    if word in _NAMED_PLACES:
        return _NAMED_PLACES[word]
    try:
        return _LENGTH_FROM_START.parse(value)
    except ValueError as error:
        remedy = values.suggest_quantity(value, "m", "120 mm")
        raise refused("protocol.no_place", found=value, remedy=remedy) from error


def _format_place(place: float) -> str:
    """Format a place on the line, m from its start, for YAML."""
    return {at: word for word, at in _NAMED_PLACES.items()}.get(place) or _LENGTH_FROM_START.format(
        place
    )


Place: TypeAlias = Annotated[float, PlainValidator(_parse_place), PlainSerializer(_format_place)]
Step: TypeAlias = Annotated[int, WholeNumber(1, MAX_EQUILIBRIA)]
Angle: TypeAlias = Annotated[float, Quantity("rad", "deg", "90 deg")]
BendingStiffness: TypeAlias = Annotated[float, Quantity("N*m^2", "N*mm^2", "150 N*mm^2", above=0.0)]
TorsionalStiffness: TypeAlias = Annotated[
    float, Quantity("N*m^2", "N*mm^2", "90 N*mm^2", above=0.0)
]
AxialStiffness: TypeAlias = Annotated[float, Quantity("N", "N", "40000 N", above=0.0)]
Scatter: TypeAlias = Annotated[float, Quantity("1/m", "1/m", "0.5 1/m", minimum=0.0)]

_SECTION_KINDS = ("wire", "sliders", "bending_stiffness")
_SECTION_KEYS = {
    "wire": ("sheet", "calibration"),
    "sliders": ("diameter", "axial_stiffness"),
    "bending_stiffness": (
        *("largest_curvature", "torsional_stiffness", "axial_stiffness"),
        *("mass_per_length", "diameter"),
    ),
}
_DIAMETER = {"diameter": "Add it: the allowed bend radius depends on it."}
_REQUIRED_KEYS: dict[str, dict[str, str]] = {
    "wire": {},
    "sliders": _DIAMETER,
    "bending_stiffness": _DIAMETER
    | {
        "largest_curvature": "Add the largest tested curvature: the law is valid up to it.",
        "torsional_stiffness": "Add it; about 0.8 times the bending stiffness for a round bar.",
    },
}
"""Keys that each source of the bending law needs, with the remedy if one is missing."""


class SectionBlock(Block):
    """Section of the line: a wire of a wire sheet, a deck of sliders, or constant stiffnesses."""

    wire: values.Text | None = Field(None, description="Name of a wire of the sheet")
    sheet: values.Text | None = Field(
        None, description="Wire sheet; else wires.xlsx beside this file, or the sheet of --wire"
    )
    calibration: values.Text | None = Field(
        None, description="calibration.json that replaces parameters of the sheet, with bands"
    )
    sliders: values.Text | None = Field(
        None, description="Deck <wire>.sliders.json that `labpipe model` wrote"
    )
    bending_stiffness: BendingStiffness | None = Field(
        None, description="EI, constant; for a chain nearly zero, such as 0.01 N*mm^2"
    )
    torsional_stiffness: TorsionalStiffness | None = Field(None, description="GJ")
    axial_stiffness: AxialStiffness | None = Field(
        None, description="EA; else that of the wire, or infinite"
    )
    mass_per_length: LinearMass | None = Field(None, description="Else that of the wire, or zero")
    diameter: Length | None = Field(None, description="Over the insulation or the tape")
    largest_curvature: Curvature | None = Field(
        None, description="Largest curvature with this bending stiffness; doubtful beyond"
    )
    stiffness_uncertainty: Uncertainty | None = Field(
        None, description="Standard uncertainty of the bending stiffness, for bands"
    )

    @property
    def kind(self) -> str:
        """Return the source of the bending law: ``wire``, ``sliders`` or ``bending_stiffness``."""
        return next(name for name in _SECTION_KINDS if getattr(self, name) is not None)

    @classmethod
    def find_contradictions(cls, data: Values) -> Iterator[Fault]:
        """Find several sources or none, missing keys, and keys of other sources."""
        kinds = [name for name in _SECTION_KINDS if data.get(name) is not None]
        if len(kinds) != 1:
            found = " and ".join(map(repr, kinds)) or "none of them"
            yield Fault.of("protocol.no_one_section", found=found)
            return
        kind, own_keys = kinds[0], _SECTION_KEYS[kinds[0]]
        for key, remedy in _REQUIRED_KEYS[kind].items():
            if data.get(key) is None:
                yield Fault.of(
                    "protocol.no_section_key", missing=key, key=key, kind=kind, remedy=remedy
                )
        valid = ", ".join(map(repr, own_keys))
        all_keys = {key for keys in _SECTION_KEYS.values() for key in keys}
        for key in sorted(all_keys & {*data} - {*own_keys}):
            path = (key,)
            yield Fault.of("protocol.other_section", path, at="key", key=key, kind=kind, own=valid)


class Spool(Block):
    """Curl of a line from a spool: it is curved without load."""

    curvature: Curvature = Field(description="1 / radius of the curl")
    towards: Direction = Field((0.0, 0.0, -1.0), description="Direction of the curl at the start")
    spread: Scatter = Field(0.0, description="Standard deviation between pieces, for bands")


class LineBlock(Block):
    """The line: length, section, shape without load, and initial position."""

    length: Length = Field(description="From one end to the other, unstretched")
    elements: Annotated[int, WholeNumber(MIN_ELEMENTS, MAX_ELEMENTS)] = Field(
        40, description="Number of finite elements"
    )
    section: SectionBlock
    spool: Spool | None = Field(
        None, description="Curl of the line; straight without load if left out"
    )
    start: Position | None = Field(
        None, description="Initial position of its start; else that of the clip or pin there"
    )
    direction: Direction | None = Field(
        None, description="Initial direction; else that of the clip at the start, or x"
    )


class Clip(Block):
    """Holds the position and direction of a place of the line, after moving the line there."""

    kind: Literal["clip"]
    name: values.SingleLine
    at: Place
    position: Position
    direction: Direction | None = Field(
        None, description="Of the line in the clip; else its initial direction"
    )
    turn: Angle = Field(0.0, description="Rotation about that direction, which twists the line")
    by: Step | None = Field(None, description="Step at which the line arrives; else the last")
    release: Step | None = Field(None, description="Step from which the line is free")


class Pin(Block):
    """Holds the position of a place of the line, after moving the line there."""

    kind: Literal["pin"]
    name: values.SingleLine
    at: Place
    position: Position
    by: Step | None = Field(None, description="Step at which the line arrives; else the last")
    release: Step | None = Field(None, description="Step from which the line is free")


class Waypoint(Block):
    """A pose on the path of a grip, which is straight from the previous one."""

    step: Step
    position: Position | None = Field(None, description="Else that of the previous pose")
    direction: Direction | None = Field(None, description="Else that of the previous pose")
    turn: Angle | None = Field(
        None, description="Rotation about the direction; else that of the previous pose"
    )


class Grip(Block):
    """Holds a place of the line and moves it along a path."""

    kind: Literal["grip"]
    name: values.SingleLine
    at: Place
    path: tuple[Waypoint, ...] = Field((), description="Poses after the initial one")
    holds: Literal["pose", "position"] = Field(
        "pose", description="pose: position and direction; position: the line may rotate"
    )
    release: Step | None = Field(None, description="Step from which the line is free")

    @classmethod
    def find_contradictions(cls, data: Values) -> Iterator[Fault]:
        """Find waypoints out of order, and directions of a grip that holds positions only."""
        points = [get_block(point) for point in get_list(data, "path")]
        steps = [str(point.get("step")) for point in points]
        for number, (before, step) in enumerate(pairwise(steps), start=1):
            if before.isdecimal() and step.isdecimal() and int(step) <= int(before):
                path = ("path", number, "step")
                yield Fault.of("protocol.step_not_after", path, before=before, found=step)
        for number, point in enumerate(points if data.get("holds") == "position" else []):
            for key in sorted(_POSE_KEYS & {*point}):
                yield Fault.of("protocol.turn_of_no_pose", ("path", number, key), at="key", key=key)


_POSE_KEYS = {"direction", "turn"}


class Ring(Block):
    """A clip in which the line slides without friction, after moving there with the line."""

    kind: Literal["ring"]
    name: values.SingleLine
    position: Position
    direction: Direction = Field(description="Of its opening in figures; the line may rotate in it")
    by: Step | None = Field(None, description="Step at which the ring arrives; else the last")


class String(Block):
    """A string between a place of the line and an anchor; it carries tension only."""

    kind: Literal["string"]
    name: values.SingleLine
    at: Place
    anchor: Position
    length: Length
    by: Step | None = Field(
        None,
        description="Step at which an anchor beyond the length of the string arrives",
    )


class Load(Block):
    """A force of constant direction that increases from zero."""

    kind: Literal["load"]
    name: values.SingleLine
    at: Place
    force: ForceVector
    by: Step | None = Field(None, description="Step of the full force; else the last")


class Plane(Block):
    """A table or a wall; the axis of the line stays half its diameter away from it."""

    kind: Literal["plane"]
    name: values.SingleLine
    point: Position
    normal: Direction = (0.0, 0.0, 1.0)
    friction: Ratio = Field(0.0, description="Coefficient of Coulomb friction")


Boundary: TypeAlias = Clip | Pin | Grip | Ring | String | Load | Plane
Holder: TypeAlias = Clip | Pin | Grip
HOLDERS = (Clip, Pin, Grip)
"""Kinds of boundaries that hold the position of one place of the line."""
_HOLDER_KINDS = ("clip", "pin", "grip")
_HOLDING_KINDS = (*_HOLDER_KINDS, "string")


class Sweep(Block):
    """Further lengths of the line for the same harness, to choose its slack."""

    length: tuple[Length, ...] = Field(max_length=50, json_schema_extra={"minItems": 2})

    @classmethod
    def find_contradictions(cls, data: Values) -> Iterator[Fault]:
        """Find a sweep of fewer than two lengths."""
        lengths = data.get("length")
        if isinstance(lengths, list) and len(lengths) < 2:
            yield Fault.of("protocol.one_length", ("length",), found=len(lengths))


class HarnessFile(Block):
    """One line between its boundaries."""

    version: Version
    about: values.Remark = Field("", description="Purpose, in one line")
    line: LineBlock
    boundaries: tuple[Annotated[Boundary, Field(discriminator="kind")], ...] = Field(
        json_schema_extra={"minItems": 1}
    )
    steps: Annotated[int, WholeNumber(1, MAX_EQUILIBRIA)] = Field(
        40, description="Number of equilibria after the start; more if the solver does not converge"
    )
    gravity: Acceleration = Field((0.0, 0.0, -GRAVITY), description="Three zeros for none")
    allowed_bend_radius: Length | None = Field(
        None, description="Else 5 times the outer diameter, which the results report as assumed"
    )
    show: tuple[Step, ...] = Field(
        (), description="Steps in shape.csv and in the figure, with the last one"
    )
    sweep: Sweep | None = Field(
        None, description="Lengths to compute in addition to that of the line"
    )
    plausible: Plausible = Field(
        {}, description="Ranges by kind of dimension; else the shipped ones"
    )

    @classmethod
    def find_contradictions(cls, data: Values) -> Iterator[Fault]:
        """Find late steps, repeated names and places, and a line that nothing holds."""
        yield from find_implausible_sizes(data, ("line", "boundaries", "sweep"), in_file=True)
        boundaries = [get_block(boundary) for boundary in get_list(data, "boundaries")]
        yield from _find_late_steps(data, boundaries)
        yield from find_repeated_names(boundaries, "boundaries", "boundary")
        yield from _find_shared_places(boundaries)
        kinds = {boundary.get("kind") for boundary in boundaries}
        if isinstance(data.get("boundaries"), list) and not kinds & {*_HOLDING_KINDS, None}:
            yield Fault.of("protocol.nothing_holds", ("boundaries",))


def _find_late_steps(data: Values, boundaries: Sequence[Values]) -> Iterator[Fault]:
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


def _find_shared_places(boundaries: Sequence[Values]) -> Iterator[Fault]:
    """Find boundaries that hold the same place of the line."""
    first: dict[object, object] = {}
    for number, boundary in enumerate(boundaries):
        at = str(boundary.get("at"))
        place = at if at in _NAMED_PLACES else values.parse_or_none(at, "m")
        if boundary.get("kind") not in _HOLDER_KINDS or place is None:
            continue
        if place in first:
            path = ("boundaries", number, "at")
            yield Fault.of("protocol.place_taken", path, found=at, other=first[place])
        first.setdefault(place, boundary.get("name"))


REACH_FACTOR = 1.0 + 1e-9
"""Tolerance of lengths: a line may be straight between two clips."""


def find_named_file(name: str, path: Path) -> Path:
    """Resolve a file name of a harness: beside its YAML, or else in the working folder.

    Parameters
    ----------
    name : as written
    path : of the harness YAML
    """
    beside = path.parent / name
    return beside if beside.exists() else Path(name)


def find_missing_files(harness: HarnessFile, path: Path) -> Iterator[Fault]:
    """Find files that a harness names and that do not exist.

    Parameters
    ----------
    harness : validated
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
    """Find the initial position (m) of the start of the line, and its initial direction.

    Parameters
    ----------
    harness : if its line states neither, they are those of the clip or pin at its start, or else
        the origin and x
    """
    line = harness.line
    holders = (boundary for boundary in harness.boundaries if isinstance(boundary, HOLDERS))
    first = next((boundary for boundary in holders if boundary.at == START), None)
    position, direction = line.start, line.direction
    if position is None:
        position = (0.0, 0.0, 0.0) if first is None or isinstance(first, Grip) else first.position
    if direction is None:
        direction = first.direction if isinstance(first, Clip) else None
    return position, direction or (1.0, 0.0, 0.0)


def compute_path(boundary: Holder | String, start: Sequence[float] | Floats, steps: int) -> Floats:
    """Compute the position of a boundary in each step; it moves in straight lines.

    Parameters
    ----------
    boundary : clip, pin, grip, or a string, for which the path is that of its anchor; the anchor
        starts at most the length of the string away from the line
    start : initial position of the place on the line, m
    steps : number of steps of the harness

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
    """Find boundaries that the line cannot reach, and motions that the steps cannot resolve.

    Parameters
    ----------
    harness : validated

    Yields
    ------
    A fault for each place beyond the end of the line and for each two boundaries that are too far
    apart, of a sweep for its shortest such line; for each boundary that holds the axis nearer to a
    plane than half the diameter in the file; for each rotation of 180 deg or more per step, which
    is ambiguous; for a curl of more than 90 deg per element; for each ring that the line cannot
    reach, each release before the line arrives, and a line that falls because nothing holds it.
    """
    yield from _find_release_faults(harness)
    yield from _find_places_in_planes(harness)
    yield from _find_large_turns(harness)
    yield from _find_large_curl(harness)
    lengths: list[tuple[float, KeyPath]] = [(harness.line.length, ())]
    swept = harness.sweep.length if harness.sweep else ()
    lengths += sorted((length, ("sweep", "length", i)) for i, length in enumerate(swept))
    for length, path in lengths:
        faults = [
            *_find_places_off_line(harness, length, path),
            *_find_distant_places(harness, length, path),
        ]
        if faults:
            yield from faults
            return


def _find_places_off_line(harness: HarnessFile, length: float, path: KeyPath) -> Iterator[Fault]:
    for number, boundary in enumerate(harness.boundaries):
        place = getattr(boundary, "at", START)
        if math.isfinite(place) and place > length * REACH_FACTOR:
            here = path or ("boundaries", number, "at")
            yield Fault.of("protocol.off_the_line", here, length=1e3 * length, found=1e3 * place)


def _find_release_faults(harness: HarnessFile) -> Iterator[Fault]:
    """Find releases before the line arrives, and the step from which nothing holds the line."""
    releases: dict[int, int | None] = {}
    for number, holder in enumerate(harness.boundaries):
        if isinstance(holder, HOLDERS):
            releases[number] = holder.release
            arrival = (
                min((point.step for point in holder.path), default=None)
                if isinstance(holder, Grip)
                else holder.by
            )
            if holder.release is not None and arrival is not None and holder.release <= arrival:
                path = ("boundaries", number, "release")
                yield Fault.of(
                    "protocol.early_release",
                    path,
                    arrival=arrival,
                    name=holder.name,
                    found=holder.release,
                )
    section = harness.line.section
    has_weight = section.bending_stiffness is None or section.mass_per_length
    has_support = any(not isinstance(part, (*HOLDERS, Load)) for part in harness.boundaries)
    steps = {number: step for number, step in releases.items() if step is not None}
    if has_weight and any(harness.gravity) and not has_support and len(steps) == len(releases):
        last = max(steps, key=lambda number: steps[number])
        yield Fault.of("protocol.falls", ("boundaries", last, "release"), step=steps[last])


def _find_places_in_planes(harness: HarnessFile) -> Iterator[Fault]:
    radius = 0.5 * (harness.line.section.diameter or 0.0)
    first = 0 if harness.line.spool is None else 1  # the initial shape of a curled line is unknown
    places = _list_places(harness, harness.line.length, Clip, Pin, Grip)
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


def _find_large_turns(harness: HarnessFile) -> Iterator[Fault]:
    for number, boundary in enumerate(harness.boundaries):
        for key, start, end, turn in _list_turns(boundary, harness.steps):
            per_step = math.degrees(abs(turn)) / (end - start)
            if per_step >= 180.0:
                path = ("boundaries", number, *key)
                yield Fault.of("protocol.turn", path, found=per_step, start=start, end=end)


def _list_turns(boundary: Boundary, steps: int) -> Iterator[tuple[KeyPath, int, int, float]]:
    """List the rotations of a boundary: key path, first and last step, angle in rad."""
    if isinstance(boundary, Clip):
        yield ("turn",), 0, boundary.by or steps, boundary.turn
    elif isinstance(boundary, Grip):
        at, before = 0, 0.0
        for number, point in enumerate(boundary.path):
            turn = before if point.turn is None else point.turn
            yield ("path", number, "turn"), at, point.step, turn - before
            at, before = point.step, turn


def _find_large_curl(harness: HarnessFile) -> Iterator[Fault]:
    max_curl = 90.0  # deg per element; elements are straight
    line, swept = harness.line, harness.sweep.length if harness.sweep else ()
    element = max([line.length, *swept]) / line.elements
    curl = 0.0 if line.spool is None else math.degrees(line.spool.curvature * element)
    if curl > max_curl:
        path = ("line", "spool", "curvature")
        yield Fault.of("protocol.curl", path, most=max_curl, element=1e3 * element, found=curl)


@dataclass(frozen=True, slots=True)
class _HeldPlace:
    """A place of the line that a boundary or a string holds.

    Parameters
    ----------
    number, name : of the boundary
    along : length from the start of the line, m
    path : position of the boundary in each step until its release, shape (steps, 3), m
    string_length : length of the string to the boundary, m; 0 for other boundaries
    """

    number: int
    name: str
    along: float
    path: Floats
    string_length: float


def _list_places(
    harness: HarnessFile, length: float, *kinds: type[Holder | String]
) -> list[_HeldPlace]:
    start, direction = map(np.array, find_line_start(harness))
    places = []
    for number, boundary in enumerate(harness.boundaries):
        if isinstance(boundary, kinds):
            along = min(boundary.at, length)
            path = compute_path(boundary, start + along * direction, harness.steps)
            path = path[: getattr(boundary, "release", None) or harness.steps + 1]
            string_length = boundary.length if isinstance(boundary, String) else 0.0
            places.append(_HeldPlace(number, boundary.name, along, path, string_length))
    return sorted(places, key=lambda place: place.along)


def _find_distant_places(harness: HarnessFile, length: float, path: KeyPath) -> Iterator[Fault]:
    places = _list_places(harness, length, Clip, Pin, Grip, String)
    for first, second in combinations(places, 2):
        largest_distance = second.along - first.along + first.string_length + second.string_length
        rows = min(len(first.path), len(second.path))
        distances = np.linalg.norm(first.path[:rows] - second.path[:rows], axis=1)
        if distances.max() > largest_distance * REACH_FACTOR:
            yield Fault.of(
                "protocol.too_far",
                path or ("boundaries", max(first.number, second.number)),
                reach=1e3 * largest_distance,
                one=first.name,
                other=second.name,
                found=1e3 * distances.max(),
                step=distances.argmax(),
            )
    fixed = [place for place in places if not place.string_length]
    for number, ring in enumerate(harness.boundaries):
        if isinstance(ring, Ring) and fixed:
            distances_to = [math.dist(ring.position, place.path[-1]) for place in fixed]
            # length needed and length available: of both ends of the line, and between its holders
            spans = [
                (distances_to[0], fixed[0].along),
                (distances_to[-1], length - fixed[-1].along),
            ]
            between = zip(pairwise(distances_to), pairwise(fixed), strict=True)
            spans += [(sum(pair), second.along - first.along) for pair, (first, second) in between]
            needed, largest_distance = min(spans, key=lambda span: span[0] - span[1])
            if needed > largest_distance * REACH_FACTOR:
                here, needed, largest_distance = (
                    path or ("boundaries", number),
                    1e3 * needed,
                    1e3 * largest_distance,
                )
                name = ring.name
                yield Fault.of(
                    "protocol.ring_too_far", here, reach=largest_distance, found=needed, ring=name
                )
