"""The grammar of a test sheet (test.yaml) and of the bundle in it; a new one with comments."""

from __future__ import annotations

import difflib
import json
import re
from collections.abc import Callable, Iterator, Mapping
from datetime import date
from math import dist, pi, sqrt
from typing import Annotated, Any, Literal

import yaml
from pydantic import BeforeValidator, ConfigDict, Field, ValidationInfo, field_validator

from labpipe.errors import Fault, UsageError, format_error
from labpipe.protocol.grammar import Block
from labpipe.protocol.source import Role, Section, SizeUncertainties
from labpipe.protocol.values import (
    Day,
    FileStem,
    Line,
    OrShort,
    Remark,
    Text,
    file_inside,
    in_si,
    row_of,
)
from labpipe.protocol.yaml_text import (
    FaultsError,
    Values,
    block_in,
    did_you_mean,
    refused,
    shown,
)
from labpipe.records.declarations import Length, LinearMass, Offset, Snake, WholeNumber
from labpipe.records.harness_bundle import NONE, PACKED, Bundle, BundleWire
from labpipe.records.result import Specimen

DENSEST_PACKING = pi / sqrt(12)
"""Area fraction of the densest packing of equal circles (Thue 1910)."""
OVERLAP_TOLERANCE = 0.01
"""Share of the thinner diameter by which wires may overlap, because insulation is soft."""
Places = tuple[tuple[float, float], ...]
_WORDS = re.compile(r"([0-9]+)\s+([^\s,;&+()]+)(?:\s*\(([^()]*)\))?")


class SheetWires(Block):
    """Wires of one type in a bundle."""

    number: Annotated[int, WholeNumber(1, 1000)]
    diameter: Length | None = Field(None, description="Over the insulation")


def _number_alone(value: object) -> object:
    return value if isinstance(value, Mapping | SheetWires) else {"number": value}


def wires_in_words(value: object) -> object:
    """Read ``10 B1 + 9 B2 (1.6 mm)`` as a block.

    Parameters
    ----------
    value : the words; anything else is given back as it is

    Raises
    ------
    FaultsError
        If the words are not those of a bundle.
    """
    if not isinstance(value, str):
        return value
    wires: dict[str, object] = {}
    for part in re.split(r"(?<!\s)\s+\+\s+", value.strip()):
        match = _WORDS.fullmatch(part)
        if match is None:
            raise refused("protocol.no_wires", found=value)
        number, kind, diameter = match.groups()
        if kind in wires:
            raise refused("protocol.type_again", found=value, type=kind)
        wires[kind] = {"number": number} | ({"diameter": diameter} if diameter else {})
    return wires


StatedWires = Annotated[
    dict[Line, Annotated[SheetWires, OrShort(_number_alone, {"type": "integer", "minimum": 1})]],
    Field(min_length=1),
    OrShort(wires_in_words, {"type": "string", "examples": ["10 B1 + 9 B2"]}),
]


Place = Annotated[tuple[Offset, Offset], row_of(2, "[0 mm, 1.2 mm]")]


class SheetBundle(Block):
    """Composition of a harness bundle."""

    wires: StatedWires = Field(description="By type: how many, or number and diameter")
    number: Annotated[int, WholeNumber(1, 100_000)] | None = Field(
        None, description="Of all wires together, as a check"
    )
    arrangement: Literal["packed", "symmetric", "asymmetric"] = "packed"
    positions: tuple[Place, ...] | None = Field(
        None,
        description="[x, y] of every wire in the order of 'wires'; y is the direction of bending",
    )
    tape: Line = "none"
    taping: Literal["none", "coarse", "half-lap"] = "none"
    conduit: Line = "none"
    conduit_bore: Length | None = Field(None, description="Inner diameter of the conduit")

    @property
    def record(self) -> Bundle:
        """Return the bundle in the words of the rest of labpipe; lengths in m."""
        wires = (BundleWire(kind, of.number, of.diameter) for kind, of in self.wires.items())
        return Bundle(
            wires=tuple(wires),
            arrangement=self.arrangement,
            positions=self.positions or (),
            tape=self.tape,
            taping=self.taping,
            conduit=self.conduit,
            conduit_bore=self.conduit_bore,
        )

    @classmethod
    def between(cls, data: Values) -> Iterator[Fault]:
        """Find taping without tape, tape without taping, and a bore without a conduit."""
        tape, taping, conduit = (data.get(key) or NONE for key in ("tape", "taping", "conduit"))
        if tape == NONE and taping != NONE:
            yield Fault.of("protocol.no_tape", ("taping",), found=shown(taping))
        if tape != NONE and taping == NONE:
            yield Fault.of("protocol.no_taping", ("tape",), found=shown(tape))
        bore = data.get("conduit_bore")
        if conduit == NONE and bore is not None:
            yield Fault.of("protocol.no_conduit", ("conduit_bore",), found=shown(bore))

    @field_validator("number", "arrangement", "positions", "conduit_bore")
    @classmethod
    def _fits_the_wires(cls, value: Any, info: ValidationInfo) -> Any:
        wires, check = info.data.get("wires"), _BUNDLE_CHECKS[str(info.field_name)]
        if wires is None or value is None:
            return value
        if faults := list(check(value, wires)):
            raise FaultsError(*faults)
        return value


Wires = Mapping[str, SheetWires]


def _number_faults(number: int, wires: Wires) -> Iterator[Fault]:
    total = len(_each(wires))
    if number != total:
        parts = " + ".join(f"{of.number} {kind}" for kind, of in wires.items())
        yield Fault.of("protocol.number_of_wires", total=total, parts=parts, found=number)


def _arrangement_faults(arrangement: str, wires: Wires) -> Iterator[Fault]:
    if len(wires) == 1 and arrangement != PACKED:
        yield Fault.of("protocol.one_type", found=arrangement)


def _bore_faults(bore: float, wires: Wires) -> Iterator[Fault]:
    diameters = [diameter for _, diameter in _each(wires) if diameter is not None]
    densest = 1.0 if len(diameters) == 1 else DENSEST_PACKING
    least = sqrt(sum(diameter**2 for diameter in diameters) / densest)
    if bore < least and len(diameters) == len(_each(wires)):
        yield Fault.of("protocol.bore_too_small", least=least * 1e3, found=bore * 1e3)


def _each(wires: Wires) -> list[tuple[str, float | None]]:
    """List type and diameter of every wire."""
    return [(kind, of.diameter) for kind, of in wires.items() for _ in range(of.number)]


def _position_faults(positions: Places, wires: Wires) -> Iterator[Fault]:
    """Find why the positions do not match the wires."""
    total = len(_each(wires))
    unknown = [kind for kind, of in wires.items() if of.diameter is None]
    if len(positions) != total:
        yield Fault.of("protocol.number_of_places", total=total, found=len(positions))
    elif unknown:
        yield Fault.of("protocol.no_diameter", found=", ".join(map(repr, unknown)))
    else:
        yield from _overlaps(positions, wires)


def _overlaps(positions: Places, wires: Wires) -> Iterator[Fault]:
    """Find wires that lie inside an earlier one; the first such pair of each wire."""
    circles = [
        (f"wire {i} ({kind})", size or 0.0, place)
        for i, ((kind, size), place) in enumerate(zip(_each(wires), positions, strict=True), 1)
    ]
    for later, (name, size, place) in enumerate(circles):
        for other, other_size, other_place in circles[:later]:
            depth = (size + other_size) / 2 - dist(place, other_place)
            if depth > OVERLAP_TOLERANCE * min(size, other_size):
                path, depth_mm = (later,), depth * 1e3
                yield Fault.of("protocol.overlap", path, wire=name, depth=depth_mm, other=other)
                break


_BUNDLE_CHECKS: Mapping[str, Callable[[Any, Wires], Iterator[Fault]]] = {
    "number": _number_faults,
    "arrangement": _arrangement_faults,
    "positions": _position_faults,
    "conduit_bore": _bore_faults,
}
"""Checks of the fields of a bundle against its wires."""


def bundle_in_words(text: str, *, arrangement: str = PACKED) -> Bundle:
    """Read a bundle such as ``10 B1 + 9 B2``.

    Parameters
    ----------
    text : numbers and types of the wires, with a diameter in brackets where one is known
    arrangement : one of `labpipe.records.harness_bundle.ARRANGEMENTS`

    Returns
    -------
    The bundle, without tape and conduit.

    Raises
    ------
    UsageError
        If the words are not those of a bundle, or have no such arrangement.
    """
    bundle = SheetBundle.read({"wires": text, "arrangement": arrangement})
    if isinstance(bundle, list):
        raise UsageError("\n".join(_fault_text(fault, text) for fault in bundle))
    return bundle.record


def _fault_text(fault: Fault, text: str) -> str:
    place = "" if fault.path == ("wires",) else ".".join(map(str, fault.path))
    remedy = fault.remedy or 'Write it like "10 B1 + 9 B2 (1.25 mm)", or give a test.yaml.'
    return format_error(text, place, expected=fault.expected, found=fault.found, remedy=remedy)


SHEET_NAME = "test.yaml"
_NAME = r"[a-z][a-z0-9_]*"
_BARE = r"\s*[-+]?[0-9.]+([eE][-+]?[0-9]+)?\s*"
"""A number without a unit."""


def _nothing_is_empty(value: object) -> object:
    return {} if value is None else value


class SheetSpecimen(Block):
    """What was tested: samples are cut from a spool, spools belong to a type."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, Length]

    type: Line
    spool: Line
    sample: Line
    length: Length | None = Field(None, description="Free length; overrides the protocol's")
    mass_per_length: LinearMass | None = Field(
        None, description="Mass per length; overrides the protocol's"
    )
    section: Section | None = Field(None, description="Sizes of the cross-section, or its area")
    uncertainty: SizeUncertainties | None = Field(
        None, description="Standard uncertainties of sizes; override the protocol's"
    )
    bundle: SheetBundle | None = Field(None, description="What a harness bundle is made of")
    labels: Annotated[dict[Snake, Line], BeforeValidator(_nothing_is_empty)] = Field(
        {}, description="Any other words on the specimen, by name"
    )
    observed: Annotated[dict[Snake, Line], BeforeValidator(_nothing_is_empty)] = Field(
        {}, description="Answers to the questions of the protocol, by question"
    )

    @property
    def dimensions(self) -> dict[str, float]:
        """Return the lengths by name, m."""
        length = {} if self.length is None else {"length": self.length}
        return length | dict(self.__pydantic_extra__)

    @property
    def record(self) -> Specimen:
        """Return the specimen in the words of the rest of labpipe; lengths in m."""
        bundle = None if self.bundle is None else self.bundle.record
        named = (self.type, self.spool, self.sample)
        return Specimen(*named, self.dimensions, bundle, self.labels, self.observed)

    @classmethod
    def between(cls, data: Values) -> Iterator[Fault]:
        """Refuse dimensions that look like a misspelt key, and labels that are called like keys."""
        keys = [*cls.keys(), "span"]
        for key in [key for key in data if key not in keys]:
            small, value = re.sub(r"\W+", "_", key.casefold()), data[key]
            remedy = f"Write it as {small!r}." if small != key else did_you_mean(key, keys)
            is_bare = not isinstance(value, str) or re.fullmatch(_BARE, value) is not None
            if re.fullmatch(_NAME, key) is None or difflib.get_close_matches(key, keys, 1, 0.8):
                yield Fault.of("protocol.no_dimension", (key,), at="key", key=key, remedy=remedy)
            elif in_si(value, "m") is None and not is_bare:
                yield Fault.of(
                    "protocol.label_as_size",
                    (key,),
                    at="key",
                    key=key,
                    value=value,
                    found=shown(value),
                )
        for key in {*block_in(data, "labels")} & {*keys}:
            yield Fault.of("protocol.label_as_key", ("labels", key), at="key", key=key)


COPY_IT = "Copy the export into the folder of the test and name it from there."


def _listed(value: object) -> object:
    if value is None:
        raise refused("protocol.no_export", found=value)
    return [value] if isinstance(value, str) else value


FileNames = Annotated[
    tuple[Annotated[str, file_inside("the folder of the test", COPY_IT)], ...],
    OrShort(_listed, {"type": "string"}),
    Field(min_length=1),
]


class Override(Block):
    """A value of the protocol that this test changes, and why."""

    value: Any
    because: Text


class TestSheet(Block):
    """One test: a specimen, a protocol and the exports."""

    __test__ = False  # not a test of this project, whatever its name suggests to pytest

    test: FileStem
    protocol: Text = Field(description="Name of a protocol, or a path to one")
    specimen: SheetSpecimen
    date: Day | None = None
    operator: Remark = ""
    files: dict[Role, FileNames] = Field(
        min_length=1, description="By role: a file, or the parts of one recording in order"
    )
    overrides: Annotated[dict[str, Override], BeforeValidator(_nothing_is_empty)] = Field(
        {}, description="By dotted key of the protocol"
    )


_HEAD = "# One test: what was tested, and which exports belong to it.\n"
_COMMENTS = {
    "protocol": "name of a protocol, or a path beside this file",
    "specimen": "samples are cut from a spool, spools belong to a type",
    "files": "role: file in this folder, or a list of the parts of one recording",
    "overrides": "values of the protocol that this test changes, and why",
}
_TO_FILL_IN = re.compile(r"^( *\w+:) null$", re.MULTILINE)
_EXAMPLE = "# overrides:                # values of the protocol that this test changes, and why\n"
_EXAMPLES = {
    "force": "sources.force.channel: {value: Model Root/Load Cell/Out1, because: other cabling}",
    "frame": "sources.frame.channels.force.unit: {value: N, because: the export says none}",
}
"""An override that makes sense, by the role of an export."""


def test_sheet_faults(data: Mapping[str, object]) -> list[Fault]:
    """Find what is wrong with the values of a test sheet before it is written.

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
    data : with the keys of ``test.yaml``, every value as text, list or block; None for what is
        to be filled in

    Returns
    -------
    The text; reading it gives the same values. `labpipe check` finds what is to be filled in.
    """
    parts = [_HEAD, *(_entry(key, value) for key, value in data.items())]
    return "".join(parts if "overrides" in data else [*parts, _example(data)])


def _example(data: Mapping[str, object]) -> str:
    files = data.get("files")
    roles = [role for role in _EXAMPLES if isinstance(files, Mapping) and role in files]
    return f"{_EXAMPLE}#   {_EXAMPLES[roles[0] if roles else 'force']}\n"


def _entry(key: str, value: object) -> str:
    """Write one key of the sheet with its comment."""
    if key == "date" and isinstance(value, str):
        value = date.fromisoformat(value)  # else YAML would put it in quotes
    # PyYAML writes the rarer line breaks as they are, and reads them back as blanks.
    plain = json.dumps(value, ensure_ascii=False, default=str)
    escaped = any(mark in plain for mark in "\x85\u2028\u2029")
    text = yaml.safe_dump(
        {key: value}, sort_keys=False, allow_unicode=not escaped, width=float("inf"), indent=2
    )
    text = _TO_FILL_IN.sub(r"\1   # to be filled in", text)
    first, _, rest = text.partition("\n")
    if value is None:
        return text
    if key not in _COMMENTS or (isinstance(value, str) and rest):
        return text  # a comment in the middle of a text would become part of it
    return f"{first:<27} # {_COMMENTS[key]}\n{rest}"
