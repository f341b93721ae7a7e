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
from pydantic import (
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    ValidationInfo,
    field_validator,
)

from labpipe.errors import Fault, UsageError, error_text
from labpipe.protocol.faults import (
    Values,
    block_in,
    did_you_mean,
    error_of,
    faults_of,
    raised,
    shown,
)
from labpipe.protocol.grammar import Block
from labpipe.protocol.plausible import SizeUncertainties
from labpipe.protocol.source import Role
from labpipe.protocol.values import (
    Day,
    FileStem,
    Line,
    OrShort,
    Remark,
    Text,
    file_inside,
    row_of,
)
from labpipe.records.declarations import Length, LinearMass, Offset, Snake, WholeNumber
from labpipe.records.harness_bundle import NONE, PACKED, Bundle, BundleWire
from labpipe.records.result import Specimen
from labpipe.units import parse_quantity

DENSEST_PACKING = pi / sqrt(12)
"""Area fraction of the densest packing of equal circles (Thue 1910)."""
OVERLAP_TOLERANCE = 0.01
"""Share of the thinner diameter by which wires may overlap, because insulation is soft."""
Places = tuple[tuple[float, float], ...]
_WORDS = re.compile(r"([0-9]+)\s+([^\s,;&+()]+)(?:\s*\(([^()]*)\))?")
_EXPECTED_WIRES = "wires by type, such as {B1: 10, B2: 9} or '10 B1 + 9 B2'"


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
    PydanticCustomError
        If the words are not those of a bundle.
    """
    if not isinstance(value, str):
        return value
    wires: dict[str, object] = {}
    for part in re.split(r"(?<!\s)\s+\+\s+", value.strip()):
        match = _WORDS.fullmatch(part)
        if match is None:
            raise error_of(expected=_EXPECTED_WIRES, found=value)
        if match[2] in wires:
            remedy = f"Add the numbers of {match[2]!r}."
            raise error_of(expected="each type once", found=value, remedy=remedy)
        parts = {"number": match[1], "diameter": match[3]}
        wires[match[2]] = {
            key: value_text for key, value_text in parts.items() if value_text is not None
        }
    return wires


StatedWires = Annotated[
    dict[Line, Annotated[SheetWires, OrShort(_number_alone, {"type": "integer", "minimum": 1})]],
    Field(min_length=1),
    OrShort(wires_in_words, {"type": "string", "examples": ["10 B1 + 9 B2"]}),
]


Place = Annotated[tuple[Offset, Offset], row_of(2, "[0 mm, 1.2 mm]")]


class SheetBundle(Block):
    """What a harness bundle is made of."""

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
        """Refuse a taping of no tape, a tape that is not wound, a bore of no conduit."""
        tape, taping, conduit = (data.get(key) or NONE for key in ("tape", "taping", "conduit"))
        if tape == NONE and taping != NONE:
            remedy = "Write what tape it is, such as 'tape: PVC', or 'tape: unknown'."
            yield Fault(("taping",), "'none' where there is no tape", shown(taping), remedy)
        if tape != NONE and taping == NONE:
            remedy = "Write how it is wound: 'taping: half-lap' or 'taping: coarse'."
            yield Fault(("tape",), "'none' where 'taping' is 'none'", shown(tape), remedy)
        if conduit == NONE and data.get("conduit_bore") is not None:
            remedy, found = "Write what conduit it is, or leave the bore out.", data["conduit_bore"]
            yield Fault(
                ("conduit_bore",), "no bore where there is no conduit", shown(found), remedy
            )

    @field_validator("number", "arrangement", "positions", "conduit_bore")
    @classmethod
    def _fits_the_wires(cls, value: Any, info: ValidationInfo) -> Any:
        wires, check = info.data.get("wires"), _BUNDLE_CHECKS[str(info.field_name)]
        if wires is None or value is None:
            return value
        if faults := list(check(value, wires)):
            raise raised(faults, value)
        return value


Wires = Mapping[str, SheetWires]


def _number_faults(number: int, wires: Wires) -> Iterator[Fault]:
    total = _number_of(wires)
    if number != total:
        numbers = " + ".join(f"{of.number} {kind}" for kind, of in wires.items())
        expected = f"{total}, the number of the wires ({numbers})"
        yield Fault((), expected, repr(str(number)), "Correct one of the two.")


def _arrangement_faults(arrangement: str, wires: Wires) -> Iterator[Fault]:
    if len(wires) == 1 and arrangement != PACKED:
        remedy = "Only wires of different types can be spread one way or another: leave it out."
        yield Fault((), "'packed' for wires of one type", repr(arrangement), remedy)


def _bore_faults(bore: float, wires: Wires) -> Iterator[Fault]:
    diameters = _diameters(wires)
    densest = 1.0 if len(diameters) == 1 else DENSEST_PACKING
    least = sqrt(sum(diameter**2 for diameter in diameters) / densest)
    if bore < least:
        expected = f"at least {least * 1e3:.4g} mm, so that the wires find room"
        remedy = "Check the bore, the diameters and the number of wires."
        yield Fault((), expected, f"{bore * 1e3:.4g} mm", remedy)


def _number_of(wires: Wires) -> int:
    return sum(of.number for of in wires.values())


def _diameters(wires: Wires) -> list[float]:
    """Diameter of every wire, m; nothing where one is not known."""
    stated = [(of.number, of.diameter) for of in wires.values()]
    complete = [(number, diameter) for number, diameter in stated if diameter is not None]
    diameters = [diameter for number, diameter in complete for _ in range(number)]
    return diameters if len(complete) == len(stated) else []


def _position_faults(positions: Places, wires: Wires) -> Iterator[Fault]:
    """Find what keeps positions from being those of the wires."""
    number, diameters = _number_of(wires), _diameters(wires)
    if len(positions) != number:
        remedy = "List one [x, y] for every wire, in the order of 'wires'."
        yield Fault((), f"{number} positions, one per wire", str(len(positions)), remedy)
    elif not diameters:
        missing = ", ".join(repr(kind) for kind, of in wires.items() if of.diameter is None)
        remedy = "Write it like {B1: {number: 10, diameter: 1.1 mm}}."
        expected = "positions of wires whose diameters are given"
        yield Fault((), expected, f"none for {missing}", remedy)
    else:
        kinds = [kind for kind, of in wires.items() for _ in range(of.number)]
        names = [f"wire {i} ({kind})" for i, kind in enumerate(kinds, start=1)]
        yield from _overlaps(list(zip(names, positions, diameters, strict=True)))


def _overlaps(circles: list[tuple[str, tuple[float, float], float]]) -> Iterator[Fault]:
    """Find wires that lie inside an earlier one; the first such pair of each wire."""
    for later, (name, place, size) in enumerate(circles):
        for other_name, other_place, other_size in circles[:later]:
            depth = (size + other_size) / 2 - dist(place, other_place)
            if depth > OVERLAP_TOLERANCE * min(size, other_size):
                found = f"{name} {depth * 1e3:.3g} mm inside {other_name}"
                remedy = "Check both positions and the diameters."
                yield Fault((later,), "wires beside each other", found, remedy)
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
    data = {"wires": text, "arrangement": arrangement}
    try:
        return SheetBundle.model_validate(data).record
    except ValidationError as error:
        faults = faults_of(error, data=data, keys=())
        raise UsageError("\n".join(_fault_text(fault, text) for fault in faults)) from None


def _fault_text(fault: Fault, text: str) -> str:
    place = "" if fault.path == ("wires",) else ".".join(map(str, fault.path))
    remedy = fault.remedy or 'Write it like "10 B1 + 9 B2 (1.25 mm)", or give a test.yaml.'
    return error_text(text, place, expected=fault.expected, found=fault.found, remedy=remedy)


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
    uncertainty: SizeUncertainties | None = Field(
        None, description="Standard uncertainties of sizes; override the protocol's"
    )
    bundle: SheetBundle | None = Field(None, description="What a harness bundle is made of")
    labels: Annotated[dict[Snake, Line], BeforeValidator(_nothing_is_empty)] = Field(
        {}, description="Any other words on the specimen, by name"
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
        return Specimen(*named, self.dimensions, bundle, self.labels)

    @classmethod
    def between(cls, data: Values) -> Iterator[Fault]:
        """Refuse dimensions that look like a misspelt key, and labels that are called like keys."""
        keys = [*cls.keys(), "span"]
        for key, value in data.items():
            if key in keys:
                continue
            small = re.sub(r"\W+", "_", key.casefold())
            remedy = f"Write it as {small!r}." if small != key else did_you_mean(key, keys)
            if re.fullmatch(_NAME, key) is None or difflib.get_close_matches(key, keys, 1, 0.8):
                expected = "a known key, or the name of a dimension in small letters"
                yield Fault((key,), expected, repr(key), remedy, "key")
            elif not _may_be_length(value):
                expected = "a dimension, which is a length with its unit such as '2 mm'"
                remedy = f"Write other words on the specimen as 'labels: {{{key}: {value}}}'."
                yield Fault((key,), expected, shown(value), remedy, "key")
        for key in {*block_in(data, "labels")} & {*keys}:
            expected = "a label that is not called like a key of 'specimen'"
            remedy = "Write it one level up, or rename it."
            yield Fault(("labels", key), expected, repr(key), remedy, "key")


def _may_be_length(value: object) -> bool:
    """Return whether a value is a length, or one without its unit; else it is a label."""
    try:
        parse_quantity(value, "m")
    except ValueError:
        return not isinstance(value, str) or re.fullmatch(_BARE, value) is not None
    return True


COPY_IT = "Copy the export into the folder of the test and name it from there."


def _listed(value: object) -> object:
    if value is None:
        expected = "the name of an export, or a list of the parts of one recording"
        raise error_of(expected=expected, found=value, remedy="Fill it in.")
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
    try:
        TestSheet.model_validate(data)
    except ValidationError as error:
        return faults_of(error, data=data, keys=())
    return []


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
