"""Test sheets (``test.yaml``): their keys, the bundle in them, and writing a commented sheet."""

from __future__ import annotations

import difflib
import json
import re
from collections.abc import Iterator, Mapping
from datetime import date
from math import dist, pi, sqrt
from typing import Annotated, Any, Literal, Self

import yaml
from pydantic import BeforeValidator, ConfigDict, Field, model_validator

from labpipe.errors import Fault, UsageError, format_error
from labpipe.protocol import grammar as values
from labpipe.protocol.grammar import Block
from labpipe.protocol.source import Role, Section, SizeUncertainties
from labpipe.protocol.yaml_text import (
    FaultsError,
    Values,
    describe_value,
    get_block,
    refused,
    suggest_word,
)
from labpipe.records.declarations import Length, LinearMass, Offset, Snake, WholeNumber
from labpipe.records.harness_bundle import NONE, PACKED, Bundle, BundleWire
from labpipe.records.result import Specimen

DENSEST_PACKING = pi / sqrt(12)
"""Area fraction of the densest packing of equal circles (Thue 1910)."""
OVERLAP_TOLERANCE = 0.01
"""Share of the thinner diameter by which two wires may overlap, because insulation is soft."""
_WIRE_COUNT = re.compile(r"([0-9]+)\s+([^\s,;&+()]+)(?:\s*\(([^()]*)\))?")
"""Number, type and diameter, such as ``9 B2 (1.6 mm)``."""


class SheetWires(Block):
    """Wires of one type in a bundle."""

    number: Annotated[int, WholeNumber(1, 1000)]
    diameter: Length | None = None
    """Over the insulation."""


def _expand_number(value: object) -> object:
    return value if isinstance(value, Mapping | SheetWires) else {"number": value}


def parse_wires(value: object) -> object:
    """Parse a text such as ``10 B1 + 9 B2 (1.6 mm)`` into a block by type of wire.

    Parameters
    ----------
    value : the text; any other value is returned unchanged

    Returns
    -------
    Blocks with the key ``number``, and ``diameter`` where it is given; numbers remain text.

    Raises
    ------
    FaultsError
        If the text has another form, or names a type twice.
    """
    if not isinstance(value, str):
        return value
    wires: dict[str, object] = {}
    for part in re.split(r"(?<!\s)\s+\+\s+", value.strip()):
        match = _WIRE_COUNT.fullmatch(part)
        if match is None:
            raise refused("protocol.no_wires", found=value)
        number, wire_type, diameter = match.groups()
        if wire_type in wires:
            raise refused("protocol.type_again", found=value, type=wire_type)
        wires[wire_type] = {"number": number} | ({"diameter": diameter} if diameter else {})
    return wires


WiresByType = Annotated[
    dict[
        values.SingleLine,
        Annotated[SheetWires, values.ShortForm(_expand_number, {"type": "integer", "minimum": 1})],
    ],
    Field(min_length=1),
    values.ShortForm(parse_wires, {"type": "string", "examples": ["10 B1 + 9 B2"]}),
]
WirePosition = Annotated[tuple[Offset, Offset], values.build_row_validator(2, "[0 mm, 1.2 mm]")]


class SheetBundle(Block):
    """Composition of a harness bundle."""

    wires: WiresByType
    """By type: the number, or number and diameter."""
    number: Annotated[int, WholeNumber(1, 100_000)] | None = None
    """Of all wires together, as a check."""
    arrangement: Literal["packed", "symmetric", "asymmetric"] = "packed"
    positions: tuple[WirePosition, ...] | None = None
    """[x, y] of every wire in the order of 'wires'; y is the direction of bending."""
    tape: values.SingleLine = "none"
    taping: Literal["none", "coarse", "half-lap"] = "none"
    conduit: values.SingleLine = "none"
    conduit_bore: Length | None = None
    """Inner diameter of the conduit."""

    @property
    def record(self) -> Bundle:
        """Return the bundle as the other rooms use it; lengths in m."""
        return Bundle(
            wires=tuple(
                BundleWire(wire_type, wires.number, wires.diameter)
                for wire_type, wires in self.wires.items()
            ),
            arrangement=self.arrangement,
            positions=self.positions or (),
            tape=self.tape,
            taping=self.taping,
            conduit=self.conduit,
            conduit_bore=self.conduit_bore,
        )

    @classmethod
    def find_contradictions(cls, data: Values) -> Iterator[Fault]:
        """Find taping without tape, tape without taping, and a bore without a conduit."""
        tape, taping, conduit = (data.get(key) or NONE for key in ("tape", "taping", "conduit"))
        if tape == NONE and taping != NONE:
            yield Fault.of("protocol.no_tape", ("taping",), found=describe_value(taping))
        if tape != NONE and taping == NONE:
            yield Fault.of("protocol.no_taping", ("tape",), found=describe_value(tape))
        bore = data.get("conduit_bore")
        if conduit == NONE and bore is not None:
            yield Fault.of("protocol.no_conduit", ("conduit_bore",), found=describe_value(bore))

    @model_validator(mode="after")
    def _check_wires(self) -> Self:
        """Refuse a number, an arrangement, positions and a bore that do not fit the wires."""
        if faults := [*_find_number_faults(self), *_find_position_faults(self)]:
            raise FaultsError(*faults)
        return self


def _list_diameters(bundle: SheetBundle) -> list[tuple[str, float | None]]:
    """List type and diameter (m) of every wire."""
    wires = bundle.wires.items()
    return [
        (wire_type, of_type.diameter) for wire_type, of_type in wires for _ in range(of_type.number)
    ]


def _find_number_faults(bundle: SheetBundle) -> Iterator[Fault]:
    wires = _list_diameters(bundle)
    total, diameters = len(wires), [diameter for _, diameter in wires if diameter is not None]
    if bundle.number not in (None, total):
        parts = " + ".join(f"{of_type.number} {key}" for key, of_type in bundle.wires.items())
        yield Fault.of(
            "protocol.number_of_wires", ("number",), total=total, parts=parts, found=bundle.number
        )
    if len(bundle.wires) == 1 and bundle.arrangement != PACKED:
        yield Fault.of("protocol.one_type", ("arrangement",), found=bundle.arrangement)
    if bundle.conduit_bore is not None and len(diameters) == total:
        densest = 1.0 if total == 1 else DENSEST_PACKING
        smallest = sqrt(sum(diameter**2 for diameter in diameters) / densest)
        if bundle.conduit_bore < smallest:
            yield Fault.of(
                "protocol.bore_too_small",
                ("conduit_bore",),
                least=1e3 * smallest,
                found=1e3 * bundle.conduit_bore,
            )


def _find_position_faults(bundle: SheetBundle) -> Iterator[Fault]:
    """Find why the positions do not match the wires; of each wire, the first overlap."""
    if bundle.positions is None:
        return
    wires, path = _list_diameters(bundle), ("positions",)
    unknown = [repr(key) for key, of_type in bundle.wires.items() if of_type.diameter is None]
    if len(bundle.positions) != len(wires):
        yield Fault.of(
            "protocol.number_of_places", path, total=len(wires), found=len(bundle.positions)
        )
        return
    if unknown:
        yield Fault.of("protocol.no_diameter", path, found=", ".join(unknown))
        return
    circles = [
        (f"wire {number} ({wire_type})", diameter or 0.0, position)
        for number, ((wire_type, diameter), position) in enumerate(
            zip(wires, bundle.positions, strict=True), start=1
        )
    ]
    for index, (wire, diameter, position) in enumerate(circles):
        for other, other_diameter, other_position in circles[:index]:
            depth = (diameter + other_diameter) / 2 - dist(position, other_position)
            if depth > OVERLAP_TOLERANCE * min(diameter, other_diameter):
                yield Fault.of(
                    "protocol.overlap", (*path, index), wire=wire, depth=1e3 * depth, other=other
                )
                break


def parse_bundle(text: str, *, arrangement: str = PACKED) -> Bundle:
    """Parse a bundle such as ``10 B1 + 9 B2``.

    Parameters
    ----------
    text : numbers and types of the wires, with a diameter in brackets where it is known
    arrangement : one of `labpipe.records.harness_bundle.ARRANGEMENTS`

    Returns
    -------
    The bundle, without tape and conduit.

    Raises
    ------
    UsageError
        If the text has another form, or its wires do not allow the arrangement.
    """
    bundle = SheetBundle.read({"wires": text, "arrangement": arrangement})
    if isinstance(bundle, list):
        raise UsageError("\n".join(_format_fault(fault, text) for fault in bundle))
    return bundle.record


def _format_fault(fault: Fault, text: str) -> str:
    place = "" if fault.path == ("wires",) else ".".join(map(str, fault.path))
    remedy = fault.remedy or 'Write it like "10 B1 + 9 B2 (1.25 mm)", or give a test.yaml.'
    return format_error(text, place, expected=fault.expected, found=fault.found, remedy=remedy)


SHEET_NAME = "test.yaml"
"""File name of a test sheet."""
_DIMENSION_NAME = r"[a-z][a-z0-9_]*"
_NUMBER_WITHOUT_UNIT = r"\s*[-+]?[0-9.]+([eE][-+]?[0-9]+)?\s*"


def _read_null_as_empty(value: object) -> object:
    return {} if value is None else value


class SheetSpecimen(Block):
    """The tested specimen: a sample from a spool, which belongs to a type of wire or tube."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, Length]

    type: values.SingleLine
    spool: values.SingleLine
    sample: values.SingleLine
    length: Length | None = None
    """Free length; overrides the protocol's."""
    mass_per_length: LinearMass | None = None
    """Mass per length; overrides the protocol's."""
    section: Section | None = None
    """Sizes of the cross-section, or its area."""
    uncertainty: SizeUncertainties | None = None
    """Standard uncertainties of sizes; override the protocol's."""
    bundle: SheetBundle | None = None
    """Composition of a harness bundle."""
    labels: Annotated[dict[Snake, values.SingleLine], BeforeValidator(_read_null_as_empty)] = Field(
        {}
    )
    """Other properties of the specimen as text, by name."""
    observed: Annotated[dict[Snake, values.SingleLine], BeforeValidator(_read_null_as_empty)] = (
        Field({})
    )
    """Answers to the questions of the protocol, by question."""

    @property
    def dimensions(self) -> dict[str, float]:
        """Return the free length, if it is given, and the other dimensions by name, m."""
        length = {} if self.length is None else {"length": self.length}
        return length | dict(self.__pydantic_extra__)

    @property
    def record(self) -> Specimen:
        """Return the specimen as the other rooms use it; lengths in m."""
        bundle = None if self.bundle is None else self.bundle.record
        names = (self.type, self.spool, self.sample)
        return Specimen(*names, self.dimensions, bundle, self.labels, self.observed)

    @classmethod
    def find_contradictions(cls, data: Values) -> Iterator[Fault]:
        """Find dimensions that look like a misspelt key, and labels named like a key."""
        keys = [*cls.list_keys(), "span"]
        for key, value in data.items():
            if key in keys:
                continue
            snake_key = re.sub(r"\W+", "_", key.casefold())
            is_number = not isinstance(value, str) or re.fullmatch(_NUMBER_WITHOUT_UNIT, value)
            is_misspelt = difflib.get_close_matches(key, keys, 1, 0.8)
            if is_misspelt or re.fullmatch(_DIMENSION_NAME, key) is None:
                remedy = (
                    suggest_word(key, keys) if snake_key == key else f"Write it as {snake_key!r}."
                )
                yield Fault.of("protocol.no_dimension", (key,), at="key", key=key, remedy=remedy)
            elif values.parse_or_none(value, "m") is None and not is_number:
                yield Fault.of(
                    "protocol.label_as_size",
                    (key,),
                    at="key",
                    key=key,
                    value=value,
                    found=describe_value(value),
                )
        for key in {*get_block(data, "labels")} & {*keys}:
            yield Fault.of("protocol.label_as_key", ("labels", key), at="key", key=key)


COPY_REMEDY = "Copy the export into the folder of the test and name it from there."


def _wrap_file_name(value: object) -> object:
    if value is None:
        raise refused("protocol.no_export", found=value)
    return [value] if isinstance(value, str) else value


FileNames = Annotated[
    tuple[Annotated[str, values.build_path_validator("the folder of the test", COPY_REMEDY)], ...],
    values.ShortForm(_wrap_file_name, {"type": "string"}),
    Field(min_length=1),
]


class Override(Block):
    """A value that replaces one of the protocol in this test, and the reason."""

    value: Any
    because: values.Text


class TestSheet(Block):
    """One test: its specimen, its protocol and its exports."""

    __test__ = False  # pytest would collect a class of this name

    test: values.FileStem
    protocol: values.Text
    """Name of a protocol, or a path to one."""
    specimen: SheetSpecimen
    date: values.Day | None = None
    operator: values.Remark = ""
    files: dict[Role, FileNames] = Field(min_length=1)
    """By role: a file, or the parts of one recording in order."""
    overrides: Annotated[dict[str, Override], BeforeValidator(_read_null_as_empty)] = Field({})
    """By dotted key of the protocol."""


_HEAD = "# One test: what was tested, and which exports belong to it.\n"
_COMMENTS = {
    "protocol": "name of a protocol, or a path beside this file",
    "specimen": "samples are cut from a spool, spools belong to a type",
    "files": "role: file in this folder, or a list of the parts of one recording",
    "overrides": "values of the protocol that this test changes, and why",
}
_NULL_VALUE = re.compile(r"^( *\w+:) null$", re.MULTILINE)
_OVERRIDES_HINT = (
    "# overrides:                # values of the protocol that this test changes, and why\n"
)
_OVERRIDE_EXAMPLES = {
    "force": "sources.force.channel: {value: Model Root/Load Cell/Out1, because: other cabling}",
    "frame": "sources.frame.channels.force.unit: {value: N, because: the export says none}",
}
"""An override in a comment, by the role of an export."""


def find_sheet_faults(data: Mapping[str, object]) -> list[Fault]:
    """Validate the values of a test sheet before it is written.

    Parameters
    ----------
    data : with the keys of ``test.yaml``

    Returns
    -------
    The faults, with their paths in `data`.
    """
    sheet = TestSheet.read(data)
    return sheet if isinstance(sheet, list) else []


def write_test_sheet(data: Mapping[str, object]) -> str:
    """Write a test sheet as commented YAML.

    Parameters
    ----------
    data : with the keys of ``test.yaml``; every value is a text, a list or a block, or None where a
        person fills it in

    Returns
    -------
    The text. `parse_yaml` reads the same values from it; `labpipe check` reports those to fill in.
    """
    text = _HEAD + "".join(_format_entry(key, value) for key, value in data.items())
    if "overrides" in data:
        return text
    roles = get_block(data, "files")
    role = next((role for role in _OVERRIDE_EXAMPLES if role in roles), "force")
    return f"{text}{_OVERRIDES_HINT}#   {_OVERRIDE_EXAMPLES[role]}\n"


def _format_entry(key: str, value: object) -> str:
    """Format one key of the sheet with its comment."""
    if key == "date" and isinstance(value, str):
        value = date.fromisoformat(value)  # YAML would quote a text
    # PyYAML writes the rarer line breaks unescaped, and reads them back as blanks.
    plain = json.dumps(value, ensure_ascii=False, default=str)
    has_rare_breaks = any(mark in plain for mark in "\x85\u2028\u2029")
    text = yaml.safe_dump(
        {key: value}, sort_keys=False, allow_unicode=not has_rare_breaks, width=float("inf")
    )
    text = _NULL_VALUE.sub(r"\1   # to be filled in", text)
    first_line, _, other_lines = text.partition("\n")
    is_text_block = (
        isinstance(value, str) and other_lines
    )  # a comment would become part of the text
    if value is None or key not in _COMMENTS or is_text_block:
        return text
    return f"{first_line:<27} # {_COMMENTS[key]}\n{other_lines}"
