"""Define the files for models of wires: harnesses, and plans of calibrations.

A harness is one line (a wire, a bundle or a chain) with its boundaries and its motion. A line has a
length, a section and a shape without load. A place on the line is a length from its start. Clips,
pins, grips, rings and strings hold the line, loads pull it, and planes support it. Time is counted
in steps. Each step is an equilibrium, and step 0 is the start.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import partial
from itertools import combinations, pairwise
from pathlib import Path
from typing import Annotated, Literal, TypeAlias

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field, PlainSerializer, PlainValidator

from labpipe.errors import Fault, KeyPath
from labpipe.protocol.grammar import (
    Block,
    QuantityText,
    Remark,
    SingleLine,
    Text,
    build_count_validator,
    build_path_validator,
    try_parse_quantity,
)
from labpipe.protocol.schema import Version
from labpipe.protocol.source import Plausible, find_implausible_sizes
from labpipe.protocol.yaml_text import FaultsError, build_refusal
from labpipe.records.arrays import Floats
from labpipe.records.declarations import (
    Curvature,
    Length,
    LinearMass,
    Offset,
    Quantity,
    Ratio,
    Uncertainty,
    WholeNumber,
)
from labpipe.units import GRAVITY

START, END = 0.0, math.inf
"""Lengths from the start of a line, m, that YAML writes as ``start`` and ``end``."""
ROUNDING_FACTOR = 1.0 + 1e-9
"""Factor by which rounding may increase a length or distance above its limit."""

Vector3: TypeAlias = tuple[float, float, float]
Component: TypeAlias = Annotated[float, Quantity("1", "1", "0.5")]
LoadComponent: TypeAlias = Annotated[float, Quantity("N", "N", "-2 N")]
AccelerationComponent: TypeAlias = Annotated[float, Quantity("m/s^2", "m/s^2", "-9.81 m/s^2")]


def _normalise(vector: Vector3) -> Vector3:
    """Scale a direction to the length 1."""
    norm = math.hypot(*vector)
    if norm == 0.0:
        raise build_refusal("protocol.no_direction", found=list(vector))
    x, y, z = vector
    return x / norm, y / norm, z / norm


Position: TypeAlias = Annotated[
    tuple[Offset, Offset, Offset], build_count_validator(3, "[120 mm, 0 mm, 0 mm]")
]
Direction: TypeAlias = Annotated[
    tuple[Component, Component, Component],
    build_count_validator(3, "[1, 0, 0]"),
    AfterValidator(_normalise),
]
ForceVector: TypeAlias = Annotated[
    tuple[LoadComponent, LoadComponent, LoadComponent], build_count_validator(3, "[0 N, 0 N, -2 N]")
]
Acceleration: TypeAlias = Annotated[
    tuple[AccelerationComponent, AccelerationComponent, AccelerationComponent],
    build_count_validator(3, "[0 m/s^2, 0 m/s^2, -9.81 m/s^2]"),
]

_LENGTH_FROM_START = QuantityText(Quantity("m", "mm", "120 mm", lower_bound=0.0))
_NAMED_PLACES = {"start": START, "end": END}


def _parse_place(value: object) -> float:
    """Parse a place on the line, m from its start."""
    if str(value) in _NAMED_PLACES:
        return _NAMED_PLACES[str(value)]
    try:
        return _LENGTH_FROM_START.parse(value)
    except FaultsError as error:
        remedy = error.faults[0].remedy
        raise build_refusal("protocol.no_place", found=value, remedy=remedy) from error


def _format_place(place: float) -> str:
    """Format a place on the line, m from its start, for YAML."""
    return {START: "start", END: "end"}.get(place) or _LENGTH_FROM_START.format(place)


Place: TypeAlias = Annotated[float, PlainValidator(_parse_place), PlainSerializer(_format_place)]
Step: TypeAlias = Annotated[int, WholeNumber(1, 2000)]
Arrival: TypeAlias = Annotated[
    Step | None, "Step at which the boundary arrives with the line; by default the last"
]
Release: TypeAlias = Annotated[Step | None, "Step from which the boundary is released"]
Angle: TypeAlias = Annotated[float, Quantity("rad", "deg", "90 deg")]
SectionStiffness: TypeAlias = Annotated[
    float, Quantity("N*m^2", "N*mm^2", "150 N*mm^2", lower_bound=0.0)
]
AxialStiffness: TypeAlias = Annotated[float, Quantity("N", "N", "40000 N", lower_bound=0.0)]
Scatter: TypeAlias = Annotated[float, Quantity("1/m", "1/m", "0.5 1/m", minimum=0.0)]

_SECTION_KEYS = {
    "wire": ("sheet", "calibration"),
    "sliders": ("diameter", "axial_stiffness"),
    "bending_stiffness": (
        *("largest_curvature", "torsional_stiffness", "axial_stiffness"),
        *("mass_per_length", "diameter"),
    ),
}
"""Keys that belong to each key for the source of the bending law."""
_REQUIRED_KEYS = {
    "diameter": "Add it: the allowed bend radius depends on it.",
    "largest_curvature": "Add the largest tested curvature: the law is valid up to it.",
    "torsional_stiffness": "Add it; about 0.8 times the bending stiffness for a round bar.",
}
"""Remedies for missing keys; a key is required with each source that lists it above."""


class SectionBlock(Block):
    """Section of the line: a wire of a wire sheet, a deck of sliders, or constant stiffnesses."""

    wire: Text | None = None
    """Name of a wire of the sheet."""
    sheet: Text | None = None
    """Wire sheet; by default wires.xlsx beside this file, or the sheet of --wire."""
    calibration: Text | None = None
    """calibration.json that replaces parameters of the sheet and gives bands."""
    sliders: Text | None = None
    """Deck <wire>.sliders.json that `labpipe model` wrote."""
    bending_stiffness: SectionStiffness | None = None
    """EI, constant; for a chain nearly zero, such as 0.01 N*mm^2."""
    torsional_stiffness: SectionStiffness | None = None
    """GJ."""
    axial_stiffness: AxialStiffness | None = None
    """EA; by default that of the wire, or infinite."""
    mass_per_length: LinearMass | None = None
    """Mass per length; by default that of the wire, or zero."""
    diameter: Length | None = None
    """Diameter over the insulation or the tape."""
    largest_curvature: Curvature | None = None
    """Largest curvature with this bending stiffness; results beyond it are doubtful."""
    stiffness_uncertainty: Uncertainty | None = None
    """Standard uncertainty of the bending stiffness, used for bands."""

    @property
    def kind(self) -> str:
        """Return the source of the bending law: ``wire``, ``sliders`` or ``bending_stiffness``."""
        return next(name for name in _SECTION_KEYS if getattr(self, name) is not None)

    def find_value_faults(self) -> Iterator[Fault]:
        """Find no source or several, missing keys, and keys of other sources."""
        stated_keys = {key for key, value in self if value is not None}
        kinds = [name for name in _SECTION_KEYS if name in stated_keys]
        if len(kinds) != 1:
            kind_names = " and ".join(map(repr, kinds)) or "none of them"
            yield Fault.of("protocol.no_one_section", found=kind_names)
            return
        kind, own_keys = kinds[0], _SECTION_KEYS[kinds[0]]
        for key in sorted(_REQUIRED_KEYS.keys() & {*own_keys} - stated_keys):
            remedy = _REQUIRED_KEYS[key]
            yield Fault.of(
                "protocol.no_section_key", missing=key, key=key, kind=kind, remedy=remedy
            )
        all_keys = {key for keys in _SECTION_KEYS.values() for key in keys}
        for key in sorted(all_keys & stated_keys - {*own_keys}):
            keys = ", ".join(map(repr, own_keys))
            yield Fault.of(
                "protocol.other_section", (key,), is_key=True, key=key, kind=kind, keys=keys
            )


class Spool(Block):
    """Curl left by a spool: the curvature of the line without load."""

    curvature: Curvature
    """1 / radius of the curl."""
    towards: Direction = (0.0, 0.0, -1.0)
    """Direction of the curl at the start."""
    spread: Scatter = 0.0
    """Standard deviation of the curvature between pieces, used for bands."""


class LineBlock(Block):
    """The line: length, section, shape without load, and initial position."""

    length: Length
    """Length from end to end, unstretched."""
    elements: Annotated[int, WholeNumber(4, 2000)] = 40
    """Number of finite elements."""
    section: SectionBlock
    spool: Spool | None = None
    """Curl of the line; straight without load if absent."""
    start: Position | None = None
    """Initial position of the start; by default that of the clip or pin there."""
    direction: Direction | None = None
    """Initial direction; by default that of the clip at the start, or x."""


class _Boundary(Block):
    """Boundary of the line, with its kind and a unique name."""

    kind: str
    name: SingleLine


class Holder(_Boundary):
    """A boundary that holds the position of one place of the line."""

    at: Place
    release: Release = None


class Pin(Holder):
    """A pin moves a place of the line to a position and holds it there."""

    kind: Literal["pin"]
    position: Position
    by: Arrival = None


class Clip(Holder):
    """A clip moves a place of the line to a position and a direction, and holds both."""

    kind: Literal["clip"]
    position: Position
    direction: Direction | None = None
    """Direction of the line in the clip; by default its initial direction."""
    turn: Angle = 0.0
    """Rotation about that direction, which twists the line."""
    by: Arrival = None


class Waypoint(Block):
    """A pose on the path of a grip; the path from the previous pose is straight."""

    step: Step
    position: Position | None = None
    """By default that of the previous pose."""
    direction: Direction | None = None
    """By default that of the previous pose."""
    turn: Angle | None = None
    """Rotation about the direction; by default that of the previous pose."""


class Grip(Holder):
    """A grip holds a place of the line and moves it along a path."""

    kind: Literal["grip"]
    path: tuple[Waypoint, ...] = ()
    """Poses after the initial one."""
    holds: Literal["pose", "position"] = "pose"
    """pose: position and direction; position: the line may rotate."""

    def find_value_faults(self) -> Iterator[Fault]:
        """Find waypoints out of order, and directions of a grip that holds positions only."""
        for index, (previous, point) in enumerate(pairwise(self.path), start=1):
            if point.step <= previous.step:
                path = ("path", index, "step")
                yield Fault.of("protocol.step_not_after", path, previous=previous, point=point)
        for i, point in enumerate(self.path if self.holds == "position" else ()):
            for key in sorted({"direction", "turn"} & point.model_fields_set):
                yield Fault.of("protocol.turn_of_no_pose", ("path", i, key), is_key=True, key=key)


class Ring(_Boundary):
    """A ring without friction: it moves the line to a position, and the line slides in it."""

    kind: Literal["ring"]
    position: Position
    direction: Direction
    """Direction of the opening in figures; the line may rotate in the ring."""
    by: Arrival = None


class String(_Boundary):
    """A string between a place of the line and an anchor; it carries tension only."""

    kind: Literal["string"]
    at: Place
    anchor: Position
    length: Length
    by: Annotated[Step | None, "Step at which an anchor out of reach arrives"] = None


class Load(_Boundary):
    """A force of constant direction that increases from zero."""

    kind: Literal["load"]
    at: Place
    force: ForceVector
    by: Annotated[Step | None, "Step of the full force; by default the last"] = None


class Plane(_Boundary):
    """A table or wall; the axis of the line stays at least half a diameter away."""

    kind: Literal["plane"]
    point: Position
    normal: Direction = (0.0, 0.0, 1.0)
    friction: Ratio = 0.0
    """Coefficient of Coulomb friction."""


Boundary: TypeAlias = Clip | Pin | Grip | Ring | String | Load | Plane


class Sweep(Block):
    """Further lengths of the line for the same harness, to choose its slack."""

    length: tuple[Length, ...] = Field(min_length=2, max_length=50)


class HarnessFile(Block):
    """One line between its boundaries."""

    version: Version
    about: Remark = ""
    """Purpose, in one line."""
    line: LineBlock
    boundaries: tuple[Annotated[Boundary, Field(discriminator="kind")], ...] = Field(
        json_schema_extra={"minItems": 1}
    )
    steps: Step = 40
    """Number of equilibria after the start; more if the solver does not converge."""
    gravity: Acceleration = (0.0, 0.0, -GRAVITY)
    """Three zeros for no gravity."""
    allowed_bend_radius: Length | None = None
    """By default 5 times the outer diameter, which the results report as assumed."""
    show: tuple[Step, ...] = ()
    """Steps in shape.csv and in the figure, in addition to the last."""
    sweep: Sweep | None = None
    """Lengths to compute in addition to that of the line."""
    plausible: Plausible = Field({})
    """Ranges by kind of dimension; by default the shipped ones."""

    @property
    def lengths(self) -> tuple[float, ...]:
        """Return the lengths to compute, m: the stated length, then those of the sweep."""
        return (self.line.length, *(self.sweep.length if self.sweep else ()))

    def find_value_faults(self) -> list[Fault]:
        """Find implausible sizes, and boundaries that contradict each other.

        A group of checks runs only if the previous groups found no faults. Rings out of reach are
        found when the line is solved.
        """
        groups = (
            (_find_general_faults, _find_late_steps),
            (_find_places_off_the_line, _find_release_faults, _find_large_turns, _find_large_curl),
            (_find_distant_places,),
        )
        for group in groups:
            if faults := [fault for check in group for fault in check(self)]:
                return faults
        return []


def _find_general_faults(harness: HarnessFile) -> Iterator[Fault]:
    """Find implausible sizes, repeated names, and a line that nothing holds."""
    yield from find_implausible_sizes(harness, (), harness.plausible, has_ranges=True)
    yield from _find_repeated_names("boundaries", "boundary", harness.boundaries)
    if not any(isinstance(boundary, Holder | String) for boundary in harness.boundaries):
        yield Fault.of("protocol.nothing_holds", ("boundaries",))


def _find_repeated_names(
    key: str, noun: str, items: Sequence[Boundary | Comparison]
) -> Iterator[Fault]:
    """Find names that an earlier item of a list at a key has; `noun` stands for it in messages."""
    names = [item.name for item in items]
    for index, name in enumerate(names):
        if (first_index := names.index(name)) < index:
            other, path = f"{noun} {first_index + 1}", (key, index, "name")
            yield Fault.of("protocol.name_taken", path, name=name, other=other)


def _find_places_off_the_line(harness: HarnessFile) -> Iterator[Fault]:
    """Find places beyond the end of the line, also with the lengths of a sweep."""
    for index, boundary in enumerate(harness.boundaries):
        place = getattr(boundary, "at", START)
        for i, length in enumerate(harness.lengths):
            if place != END and place > length * ROUNDING_FACTOR:
                path = ("sweep", "length", i - 1) if i else ("boundaries", index, "at")
                yield Fault.of(
                    "protocol.off_the_line", path, length=1e3 * length, found=1e3 * place
                )


def _find_late_steps(harness: HarnessFile) -> Iterator[Fault]:
    """Find stated steps after the last step of the harness."""
    steps: dict[KeyPath, int | None] = {("show", i): step for i, step in enumerate(harness.show)}
    for index, boundary in enumerate(harness.boundaries):
        path: KeyPath = ("boundaries", index)
        steps |= {(*path, key): getattr(boundary, key, None) for key in ("by", "release")}
        for i, point in enumerate(getattr(boundary, "path", ())):
            steps[*path, "path", i, "step"] = point.step
    for path, step in steps.items():
        if step is not None and step > harness.steps:
            yield Fault.of("protocol.late_step", path, last=harness.steps, found=step)


def _find_release_faults(harness: HarnessFile) -> Iterator[Fault]:
    """Find holders released before they arrive, and a heavy line that nothing supports."""
    boundaries, section = enumerate(harness.boundaries), harness.line.section
    holders = {index: holder for index, holder in boundaries if isinstance(holder, Holder)}
    for index, holder in holders.items():
        arrival_step = _compute_arrival_step(harness, holder)
        if arrival_step and holder.release and holder.release <= arrival_step:
            path = ("boundaries", index, "release")
            yield Fault.of("protocol.early_release", path, arrival=arrival_step, holder=holder)
    release_steps = {index: holder.release or 0 for index, holder in holders.items()}
    has_weight = section.bending_stiffness is None or section.mass_per_length
    has_support = any(not isinstance(x, (Holder, Load)) for x in harness.boundaries)
    if has_weight and any(harness.gravity) and not has_support and all(release_steps.values()):
        last_index = max(release_steps, key=lambda index: release_steps[index])
        path = ("boundaries", last_index, "release")
        yield Fault.of("protocol.falls", path, step=release_steps[last_index])


def _compute_arrival_step(harness: HarnessFile, holder: Holder) -> int:
    """Compute the step at which a holder reaches its first pose; 0 if it starts there."""
    if not isinstance(holder, (Pin, Clip)):
        return holder.path[0].step if isinstance(holder, Grip) and holder.path else 0
    start, direction = map(np.array, get_line_start(harness))
    initial_position = start + min(holder.at, harness.line.length) * direction
    is_turned = isinstance(holder, Clip) and (
        holder.turn != 0.0 or not np.allclose(holder.direction or direction, direction)
    )
    starts_there = np.allclose(holder.position, initial_position) and not is_turned
    return holder.by or (0 if starts_there else harness.steps)


def _find_large_turns(harness: HarnessFile) -> Iterator[Fault]:
    """Find turns of 180 deg or more per step, which are ambiguous."""
    for index, boundary in enumerate(harness.boundaries):
        turns: list[tuple[KeyPath, int, float | None]] = []
        if isinstance(boundary, Clip):
            turns = [(("turn",), boundary.by or harness.steps, boundary.turn)]
        elif isinstance(boundary, Grip):
            points = enumerate(boundary.path)
            turns = [(("path", i, "turn"), point.step, point.turn) for i, point in points]
        start_step, start_angle = 0, 0.0
        for turn_path, end_step, stated_angle in turns:
            angle = start_angle if stated_angle is None else stated_angle
            rate = math.degrees(abs(angle - start_angle)) / (end_step - start_step)
            if rate >= 180.0:  # deg per step
                path = ("boundaries", index, *turn_path)
                yield Fault.of("protocol.turn", path, found=rate, start=start_step, end=end_step)
            start_step, start_angle = end_step, angle


def _find_large_curl(harness: HarnessFile) -> Iterator[Fault]:
    """Find a curl of more than 90 deg per element, because elements are straight."""
    spool, path, max_angle = harness.line.spool, ("line", "spool", "curvature"), 90.0
    element_mm = 1e3 * max(harness.lengths) / harness.line.elements
    angle = 0.0 if spool is None else math.degrees(1e-3 * spool.curvature * element_mm)
    if angle > max_angle:
        yield Fault.of("protocol.curl", path, limit=max_angle, element=element_mm, found=angle)


def _find_distant_places(harness: HarnessFile) -> Iterator[Fault]:
    """Find held places farther apart than line and strings allow, at the first such length."""
    for i, length in enumerate(harness.lengths):
        path: KeyPath = ("sweep", "length", i - 1) if i else ()
        if faults := [*_find_distances_beyond(harness, length, path)]:
            yield from faults
            return


def _find_distances_beyond(
    harness: HarnessFile, length: float, length_path: KeyPath
) -> Iterator[Fault]:
    """Find held places too far apart for a length; `length_path` is empty outside a sweep."""
    start, direction = map(np.array, get_line_start(harness))
    places = []
    for index, holder in enumerate(harness.boundaries):
        if isinstance(holder, Holder | String):
            place = min(holder.at, length)
            path = compute_path(holder, start + place * direction, harness.steps)
            last_step = getattr(holder, "release", None) or harness.steps + 1
            string_length = holder.length if isinstance(holder, String) else 0.0
            places.append((index, place, path[:last_step], string_length))
    for first, second in combinations(places, 2):
        first_index, first_place, first_path, first_string_length = first
        second_index, second_place, second_path, second_string_length = second
        reach = abs(second_place - first_place) + first_string_length + second_string_length
        n_steps = min(len(first_path), len(second_path))
        distances = np.linalg.norm(first_path[:n_steps] - second_path[:n_steps], axis=1)
        if distances.max() > reach * ROUNDING_FACTOR:
            yield Fault.of(
                "protocol.too_far",
                length_path or ("boundaries", second_index),
                reach=1e3 * reach,
                first=harness.boundaries[first_index],
                second=harness.boundaries[second_index],
                found=1e3 * distances.max(),
                step=distances.argmax(),
            )


def get_line_start(harness: HarnessFile) -> tuple[Vector3, Vector3]:
    """Return the initial position (m) and the initial direction of the start of the line.

    Parameters
    ----------
    harness : harness; position and direction that it does not state are those of the clip or pin
        at the start of the line, or else the origin and the x axis
    """
    line = harness.line
    holders = (boundary for boundary in harness.boundaries if isinstance(boundary, Holder))
    holder = next((boundary for boundary in holders if boundary.at == START), None)
    position = line.start or getattr(holder, "position", None)
    direction = line.direction or (holder.direction if isinstance(holder, Clip) else None)
    return position or (0.0, 0.0, 0.0), direction or (1.0, 0.0, 0.0)


def compute_path(
    boundary: Clip | Pin | Grip | Ring | String, start: Sequence[float] | Floats, steps: int
) -> Floats:
    """Compute the position of a boundary in each step; it moves in straight lines.

    Parameters
    ----------
    boundary : boundary; for a string, the path is that of its anchor. The path of an anchor starts
        within the length of the string from the line
    start : initial position of the place on the line, m
    steps : number of steps of the harness

    Returns
    -------
    shape (steps + 1, 3), m
    """
    corner_steps, corners = [0], [np.array(start, dtype=float)]
    if isinstance(boundary, Grip):
        for point in boundary.path:
            corner_steps.append(point.step)
            corners.append(corners[-1] if point.position is None else np.array(point.position))
    else:
        end_point = np.array(boundary.anchor if isinstance(boundary, String) else boundary.position)
        if isinstance(boundary, String):
            distance = float(np.linalg.norm(end_point - corners[0]))
            fraction = min(1.0, boundary.length / distance) if distance else 1.0
            corners = [corners[0] + fraction * (end_point - corners[0])]
        corner_steps.append(boundary.by or steps)
        corners.append(end_point)
    all_steps = np.arange(steps + 1)
    return np.column_stack([np.interp(all_steps, corner_steps, x) for x in np.array(corners).T])


def resolve_file_name(name: str, path: Path) -> Path:
    """Return the path of a file that a harness names: beside it, or else in the working folder.

    Parameters
    ----------
    name : name of the file as written in the harness
    path : path of the harness file
    """
    file_beside = path.parent / name
    return file_beside if file_beside.exists() else Path(name)


def find_missing_files(harness: HarnessFile, path: Path) -> Iterator[Fault]:
    """Find missing files that a harness names.

    Parameters
    ----------
    harness : validated harness
    path : path of the harness file
    """
    for key in ("sheet", "calibration", "sliders"):
        name = getattr(harness.line.section, key)
        if name is not None and not resolve_file_name(name, path).is_file():
            yield Fault.of(
                "protocol.no_harness_file",
                ("line", "section", key),
                name=name,
                paths=[path.parent / name, Path(name)],
            )


def _parse_unit(si_unit: str, value: object) -> str:
    """Parse a unit that must have the dimension of an SI unit."""
    if try_parse_quantity(f"1 {value}", si_unit) is None:
        raise build_refusal("protocol.no_unit_like", found=value, si_unit=si_unit)
    return str(value)


def _parse_sign(value: object) -> int:
    """Parse the factor 1 or -1."""
    if str(value) not in ("1", "+1", "-1"):
        raise build_refusal("protocol.no_sign", found=value)
    return int(str(value))


LengthUnit = Annotated[str, BeforeValidator(partial(_parse_unit, "m")), Field(examples=["mm"])]
ForceUnit = Annotated[str, BeforeValidator(partial(_parse_unit, "N")), Field(examples=["N"])]
Sign = Annotated[Literal[1, -1], BeforeValidator(_parse_sign)]


class _Column(Block):
    """Column of an external curve."""

    column: Text | None = None
    """Name of the column, or its number, counted from 1; by default 'deflection' or 'force'."""
    sign: Sign = 1
    """-1 if the values decrease in the direction of bending."""


class DeflectionColumn(_Column):
    """Column of the deflection of the tip."""

    unit: LengthUnit | None = None
    """Unit of the values, if the heading states none."""


class ForceColumn(_Column):
    """Column of the force at the tip."""

    unit: ForceUnit | None = None
    """Unit of the values, if the heading states none."""


class Comparison(Block):
    """External curve: from finite elements, a digitised figure or another lab."""

    name: Text
    file: Annotated[str, build_path_validator("the folder of the plan", "curve")]
    """File (csv or xlsx) in the folder of the plan, or below it."""
    wire: Text
    """Name of the wire in the wire sheet."""
    length: Length
    """Free length."""
    load: Literal["as tested", "normal"] = "as tested"
    """Direction of the force; as tested: that of the string of the tests; normal: normal to the
    undeformed axis, as in most finite-element models."""
    deflection: DeflectionColumn = DeflectionColumn.model_construct()
    force: ForceColumn = ForceColumn.model_construct()
    because: Text
    """Origin of the curve."""


Friction = Annotated[float, Quantity("N", "N", "0.05 N", lower_bound=0.0)]
Modulus = Annotated[float, Quantity("Pa", "MPa", "1000 MPa", lower_bound=0.0)]
Scale = Annotated[float, Quantity("1", "1", "1", lower_bound=0.0)]
RelativeScatter = Annotated[float, Quantity("1", "%", "3 %", minimum=0.0, maximum=0.5)]
Factor = Annotated[float, Quantity("1", "1", "1.5", lower_bound=1.0)]


class _Parameter(Block):
    """Treatment of one parameter in a calibration."""

    enters: Literal["free", "fixed", "prior"] = "free"
    """free: fitted; fixed: constant; prior: fitted with a log-normal prior."""
    factor: Factor | None = None
    """Factor of a prior, whose 95 % interval is value / factor to value x factor."""
    because: Remark = ""
    """Origin of a prior or a fixed value."""

    def find_value_faults(self) -> Iterator[Fault]:
        """Find missing keys of a prior or fixed value, and a factor without a prior."""
        needed_keys = {"fixed": ("value", "because"), "prior": ("value", "because", "factor")}
        for key in needed_keys.get(self.enters, ()):
            if not getattr(self, key):
                yield Fault.of("protocol.no_key_of_parameter", key=key, enters=self.enters)
        if self.enters != "prior" and self.factor is not None:
            yield Fault.of("protocol.factor_of_no_prior", ("factor",), is_key=True)


class RadialFriction(_Parameter):
    """Radial friction phi = F_rad (mu_s + mu_p)."""

    value: Friction | None = None


class InsulationModulus(_Parameter):
    """Young's modulus of the insulation."""

    value: Modulus | None = None


class CopperScale(_Parameter):
    """Factor on the strength of the copper."""

    value: Scale | None = None


class Parameters(Block):
    """Parameters of a calibration."""

    radial_friction: RadialFriction = RadialFriction.model_construct()
    insulation_modulus: InsulationModulus = InsulationModulus.model_construct()
    copper_scale: CopperScale = CopperScale.model_construct()


class CalibrationPlan(Block):
    """Plan of a calibration: its parameters, tests and external curves."""

    version: Version
    wire: Text | None = None
    """Specimen type whose tests are fitted; other types are predicted."""
    parameters: Parameters = Parameters.model_construct()
    scatter: RelativeScatter | None = None
    """Relative standard deviation between samples, if it is known."""
    points: Annotated[int, WholeNumber(20, 5000)] = 272
    """Number of points of each curve."""
    up_to: Length | None = None
    """Largest deflection that the fit uses."""
    comparisons: tuple[Comparison, ...] = ()
    """External curves to compare with tests and model."""

    def find_value_faults(self) -> Iterator[Fault]:
        """Find repeated names of external curves."""
        return _find_repeated_names("comparisons", "comparison", self.comparisons)
