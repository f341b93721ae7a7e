"""Define test sheets (``test.yaml``), bundles of wires in them, and plans of campaigns.

A campaign pairs exports by name patterns such as ``{type}-{length mm}-{sample}_force.mat``. In a
pattern, ``{type}`` matches text, ``{length mm}`` a number in that unit, ``{date}`` a date with the
year first, and ``*`` anything. Other characters match themselves in upper or lower case. From the
left, each field matches as much as possible; a repeated field matches the same text. Slashes
separate folders.
"""

from __future__ import annotations

import difflib
import json
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from datetime import date
from typing import Annotated, Any, Literal, NamedTuple

import yaml
from pydantic import (
    BeforeValidator,
    ConfigDict,
    Field,
    PlainSerializer,
    PlainValidator,
    WithJsonSchema,
)

from labpipe.errors import Fault, UsageError, format_error
from labpipe.protocol.grammar import (
    Block,
    Day,
    FileStem,
    Remark,
    SingleLine,
    Text,
    build_count_validator,
    build_path_validator,
    try_parse_quantity,
    wrap_in_list,
)
from labpipe.protocol.schema import Version
from labpipe.protocol.source import Role, Section, SizeUncertainties
from labpipe.protocol.yaml_text import build_refusal, get_block, prefix_paths, suggest_word
from labpipe.records.declarations import (
    Duration,
    Length,
    LinearMass,
    Offset,
    SnakeName,
    WholeNumber,
)
from labpipe.records.harness_bundle import NONE, PACKED, Bundle, BundleWire
from labpipe.records.result import Specimen

_WIRE_COUNT = re.compile(r"([0-9]+)\s+([^\s,;&+()]+)(?:\s*\(([^()]*)\))?")
"""Number, type and diameter of wires, such as ``9 B2 (1.6 mm)``."""


class SheetWires(Block):
    """Wires of one type in a bundle."""

    number: Annotated[int, WholeNumber(1, 1000)]
    diameter: Length | None = None
    """Diameter over the insulation."""


def _expand_number(value: object) -> object:
    """Expand a number of wires to a block; a block is returned unchanged."""
    return value if isinstance(value, Mapping | SheetWires) else {"number": value}


def parse_wires(value: object) -> object:
    """Parse a text such as ``10 B1 + 9 B2 (1.6 mm)`` into a block for each type of wire.

    Parameters
    ----------
    value : the text; any other value is returned unchanged

    Returns
    -------
    Block of each type, with the key ``number``, and ``diameter`` if it is stated; both remain text.

    Raises
    ------
    FaultsError
        If the text has another form, or names a type twice.
    """
    if not isinstance(value, str):
        return value
    wires: dict[str, object] = {}
    for text in re.split(r"(?<!\s)\s+\+\s+", value.strip()):
        match = _WIRE_COUNT.fullmatch(text)
        if match is None:
            raise build_refusal("protocol.no_wires", found=value)
        number, wire_type, diameter = match.groups()
        if wire_type in wires:
            raise build_refusal("protocol.type_again", found=value, type=wire_type)
        wires[wire_type] = {"number": number} | ({"diameter": diameter} if diameter else {})
    return wires


_Wires = Annotated[
    SheetWires, BeforeValidator(_expand_number, json_schema_input_type=int | SheetWires)
]
WiresByType = Annotated[
    dict[SingleLine, _Wires],
    Field(min_length=1),
    BeforeValidator(parse_wires, json_schema_input_type=str | dict[SingleLine, _Wires]),
]
WirePosition = Annotated[tuple[Offset, Offset], build_count_validator(2, "[0 mm, 1.2 mm]")]


class SheetBundle(Block):
    """Composition of a harness bundle."""

    wires: WiresByType
    """Number of the wires of each type, or a block of number and diameter."""
    number: Annotated[int, WholeNumber(1, 100_000)] | None = None
    """Number of all wires, as a check."""
    arrangement: Literal["packed", "symmetric", "asymmetric"] = "packed"
    positions: tuple[WirePosition, ...] | None = None
    """Centre [x, y] of each wire in the order of 'wires'; y is the direction of bending."""
    tape: SingleLine = "none"
    taping: Literal["none", "coarse", "half-lap"] = "none"
    conduit: SingleLine = "none"
    conduit_bore: Length | None = None
    """Inner diameter of the conduit."""

    @property
    def record(self) -> Bundle:
        """Return the record of the bundle for other subpackages; lengths in m."""
        items = self.wires.items()
        wires = tuple(BundleWire(name, entry.number, entry.diameter) for name, entry in items)
        settings = {key: value for key, value in self if key not in ("wires", "number")}
        return Bundle(wires, **settings | {"positions": self.positions or ()})

    def find_key_faults(self) -> Iterator[Fault]:
        """Find taping without tape, tape without taping, and a bore without a conduit."""
        if self.tape == NONE and self.taping != NONE:
            yield Fault.of("protocol.no_tape", ("taping",), found=repr(self.taping))
        if self.tape != NONE and self.taping == NONE:
            yield Fault.of("protocol.no_taping", ("tape",), found=repr(self.tape))
        if self.conduit == NONE and self.conduit_bore is not None:
            bore_text = f"{1e3 * self.conduit_bore:.12g} mm"
            yield Fault.of("protocol.no_conduit", ("conduit_bore",), found=repr(bore_text))

    def find_value_faults(self) -> Iterator[Fault]:
        """Find a stated number, an arrangement or positions that do not fit the wires."""
        bundle = self.record
        if self.number not in (None, bundle.number):
            yield Fault.of(
                "protocol.number_of_wires", ("number",), bundle=bundle, found=self.number
            )
        if len(bundle.wires) == 1 and bundle.arrangement != PACKED:
            yield Fault.of("protocol.one_type", ("arrangement",), found=bundle.arrangement)
        n_positions, path = len(bundle.positions), ("positions",)
        if n_positions not in (0, bundle.number):
            yield Fault.of("protocol.number_of_places", path, bundle=bundle, found=n_positions)


def parse_bundle(text: str, *, arrangement: str = PACKED) -> Bundle:
    """Parse a bundle such as ``10 B1 + 9 B2``.

    Parameters
    ----------
    text : numbers and types of the wires, with a diameter in brackets if it is known
    arrangement : one of `labpipe.records.harness_bundle.ARRANGEMENTS`

    Returns
    -------
    The bundle, without tape and conduit.

    Raises
    ------
    UsageError
        If the text has another form, or its wires do not allow the arrangement.
    """
    bundle, faults = SheetBundle.read({"wires": text, "arrangement": arrangement})
    if bundle is None or faults:
        raise UsageError("\n".join(_format_fault(fault, text) for fault in faults))
    return bundle.record


def _format_fault(fault: Fault, text: str) -> str:
    """Format a fault of a bundle that is stated by a text instead of a file."""
    place = "" if fault.path == ("wires",) else ".".join(map(str, fault.path))
    remedy = fault.remedy or 'Write it like "10 B1 + 9 B2 (1.25 mm)", or give a test.yaml.'
    return format_error(text, place, expected=fault.expected, found=fault.found, remedy=remedy)


SHEET_NAME = "test.yaml"
"""File name of a test sheet."""
_DIMENSION_NAME = r"[a-z][a-z0-9_]*"
"""Regular expression of the name of an additional dimension."""
_NUMBER_WITHOUT_UNIT = r"\s*[-+]?[0-9.]+([eE][-+]?[0-9]+)?\s*"


def _read_null_as_empty(value: object) -> object:
    """Replace null by an empty block."""
    return {} if value is None else value


TextsByName = Annotated[dict[SnakeName, SingleLine], BeforeValidator(_read_null_as_empty)]


class SheetSpecimen(Block):
    """Tested specimen: a sample from a spool, which belongs to a type of wire or tube."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, Length]

    type: SingleLine
    spool: SingleLine
    sample: SingleLine
    length: Length | None = None
    """Free length; it overrides that of the protocol."""
    mass_per_length: LinearMass | None = None
    """Mass per length; it overrides that of the protocol."""
    section: Section | None = None
    """Sizes of the cross-section, or its area."""
    uncertainty: SizeUncertainties | None = None
    """Standard uncertainties of sizes; they override those of the protocol."""
    bundle: SheetBundle | None = None
    """Composition of a harness bundle."""
    labels: TextsByName = Field({})
    """Text of each other property of the specimen."""
    observed: TextsByName = Field({})
    """Answer to each question of the protocol."""

    @property
    def dimensions(self) -> dict[str, float]:
        """Return the free length, if it is stated, and additional lengths, m, keyed by name."""
        length = {} if self.length is None else {"length": self.length}
        return length | dict(self.__pydantic_extra__)

    @property
    def record(self) -> Specimen:
        """Return the record of the specimen for other subpackages; lengths in m."""
        bundle = None if self.bundle is None else self.bundle.record
        specimen = Specimen(self.type, self.spool, self.sample, self.dimensions)
        return replace(specimen, bundle=bundle, labels=self.labels, observed=self.observed)

    def find_key_faults(self) -> Iterator[Fault]:
        """Find additional keys that name no dimension, and labels with the name of a key."""
        keys = [*self.list_keys(), "span"]
        # In a draft, the values of additional keys are those of the file.
        values: dict[str, Any] = {**self.__pydantic_extra__}
        for key, value in values.items():
            if key == "span":
                continue
            snake_key, path = re.sub(r"\W+", "_", key.casefold()), (key,)
            is_number = not isinstance(value, str) or re.fullmatch(_NUMBER_WITHOUT_UNIT, value)
            is_misspelt = difflib.get_close_matches(key, keys, n=1, cutoff=0.8)
            if is_misspelt or re.fullmatch(_DIMENSION_NAME, key) is None:
                remedy = f"Write it as {snake_key!r}." if snake_key != key else ""
                remedy = remedy or suggest_word(key, keys)
                yield Fault.of("protocol.no_dimension", path, is_key=True, key=key, remedy=remedy)
            elif try_parse_quantity(value, "m") is None and not is_number:
                yield Fault.of("protocol.label_as_size", path, is_key=True, key=key, value=value)
        for key in {*(self.labels or {})} & {*keys}:
            yield Fault.of("protocol.label_as_key", ("labels", key), is_key=True, key=key)


FileNames = Annotated[
    tuple[Annotated[str, build_path_validator("the folder of the test", "export")], ...],
    BeforeValidator(wrap_in_list, json_schema_input_type=str | tuple[str, ...]),
    Field(min_length=1),
]


def _refuse_null_files(value: object) -> object:
    """Return the files of a test; refuse null."""
    if value is None:
        raise build_refusal("protocol.no_exports", found=value)
    return value


class Override(Block):
    """Value that replaces a value of the protocol in a test, and the reason."""

    value: Any
    because: Text


class TestSheet(Block):
    """One test: its specimen, its protocol and its exports."""

    __test__ = False  # otherwise pytest would collect a class of this name

    test: FileStem
    protocol: Text
    """Name of a protocol, or path of its file."""
    specimen: SheetSpecimen
    date: Day | None = None
    operator: Remark = ""
    files: Annotated[dict[Role, FileNames], BeforeValidator(_refuse_null_files)] = Field(
        min_length=1
    )
    """File of each role, or a list of the parts of one recording in order."""
    overrides: Annotated[dict[str, Override], BeforeValidator(_read_null_as_empty)] = Field({})
    """Override of each dotted key of the protocol."""


_COMMENTS = {
    "protocol": "name of a protocol, or a path beside this file",
    "specimen": "samples are cut from a spool, spools belong to a type",
    "files": "role: file in this folder, or a list of the parts of one recording",
    "overrides": "values of the protocol that this test changes, and why",
}
"""Comment after some keys of a formatted test sheet."""
_NULL_VALUE = re.compile(r"^( *\w+:) null$", re.MULTILINE)
"""Line of YAML with the value null."""
_OVERRIDE_EXAMPLES = {
    "force": "sources.force.channel: {value: Model Root/Load Cell/Out1, because: other cabling}",
    "frame": "sources.frame.channels.force.unit: {value: N, because: the export says none}",
}
"""Override that a comment shows as an example, keyed by role of an export of the test."""


def format_test_sheet(data: Mapping[str, object]) -> str:
    """Format a test sheet as commented YAML.

    Parameters
    ----------
    data : values with the keys of ``test.yaml``: texts, lists and blocks, or None for a value that
        a person has to fill in

    Returns
    -------
    The text, from which `parse_yaml` reads the same values.
    """
    header = "# One test: what was tested, and which exports belong to it.\n"
    text = header + "".join(_format_entry(key, value) for key, value in data.items())
    if "overrides" in data:
        return text
    roles = get_block(data, "files")
    role = next((role for role in _OVERRIDE_EXAMPLES if role in roles), "force")
    comment = f"{'# overrides:':<27} # {_COMMENTS['overrides']}\n"
    return f"{text}{comment}#   {_OVERRIDE_EXAMPLES[role]}\n"


def _format_entry(key: str, value: object) -> str:
    """Format one key of the sheet with its comment."""
    # PyYAML would write these line breaks unescaped, and read them back as blanks.
    json_text = json.dumps(value, ensure_ascii=False, default=str)
    has_rare_breaks = any(mark in json_text for mark in "\x85\u2028\u2029")
    # PyYAML would quote a date that is a text.
    data = date.fromisoformat(value) if key == "date" and isinstance(value, str) else value
    text = yaml.safe_dump(
        {key: json.loads(json_text) if data is value else data},
        sort_keys=False,
        allow_unicode=not has_rare_breaks,
        width=float("inf"),
    )
    text = _NULL_VALUE.sub(r"\1   # to be filled in", text)
    first_line, _, other_lines = text.partition("\n")
    # A comment would become part of a text of several lines.
    if value is None or key not in _COMMENTS or (isinstance(value, str) and other_lines):
        return text
    return f"{first_line:<27} # {_COMMENTS[key]}\n{other_lines}"


_TEXT_FIELDS = ("test", "type", "spool", "sample", "operator", "date")
"""Fields of a name pattern without a unit; others are dimensions, and ``labels.NAME``."""
_PATTERN_PART = re.compile(r"\{(?P<field>[^{}]*)\}|(?P<any>\*)|(?P<literal>[^{}*]+)|[{}]")
_DIMENSION_FIELD = re.compile(r"([a-z][a-z0-9_]*)\s+(\S+)")
_LABEL_FIELD = re.compile(r"labels\.[a-z][a-z0-9_]*")
_TEXT_REGEX, _NUMBER_REGEX, _DAY_REGEX = r"[^/\\]+", r"\d+(?:[.,]\d+)?", r"\d{4}-\d{2}-\d{2}|\d{8}"
"""Regular expressions for the content of a field."""
MAX_PATTERN_LENGTH = 300
"""Largest number of characters of a pattern, and of a name to match."""


class NamePattern(NamedTuple):
    """Parsed name pattern.

    Parameters
    ----------
    text : pattern as written
    units : unit of each field, in their order; empty for a text or a date
    regex : regular expression with a group per field
    """

    text: str
    units: dict[str, str]
    regex: re.Pattern[str]

    def match(self, name: str) -> dict[str, str] | None:
        """Match a name with the pattern.

        Parameters
        ----------
        name : name of a file or folder, with slashes between folders

        Returns
        -------
        Text of each field, keyed by field; numbers have their units, and dates are in ISO 8601.
        None if the name does not match, or is too long.

        Examples
        --------
        >>> parse_name_pattern("{type}-{length mm}-{sample}_force.mat").match("A2-085-1_Force.MAT")
        {'type': 'A2', 'length': '85 mm', 'sample': '1'}
        """
        match = self.regex.fullmatch(name) if len(name) <= MAX_PATTERN_LENGTH else None
        if match is None:
            return None
        values = dict(zip(self.units, match.groups(), strict=True))
        for field, unit in self.units.items():
            if unit:
                values[field] = f"{float(values[field].replace(',', '.')):.12g} {unit}"
        day = values.get("date", "")
        if re.fullmatch(r"\d{8}", day):
            values["date"] = f"{day[:4]}-{day[4:6]}-{day[6:]}"
        return values

    def get_stem(self, name: str) -> str:
        """Return the part of a file name up to the last field of the pattern.

        Parameters
        ----------
        name : name of a file or folder, with slashes between folders

        Returns
        -------
        The part without folders; the complete file name if `name` does not match the pattern.

        Examples
        --------
        >>> parse_name_pattern("in/{type}-{sample}_force.mat").get_stem("in/A2-1_force.mat")
        'A2-1'
        """
        match = self.regex.fullmatch(name)
        return name[: match.end(len(self.units)) if match else None].rpartition("/")[2]


def parse_name_pattern(text: str) -> NamePattern:
    """Parse a name pattern.

    Parameters
    ----------
    text : pattern as written in a campaign plan

    Raises
    ------
    FaultsError
        If the pattern is too long, or has an invalid field.
    """
    if len(text) > MAX_PATTERN_LENGTH:
        raise build_refusal("protocol.long_pattern", found=text, limit=MAX_PATTERN_LENGTH)
    units: dict[str, str] = {}

    def convert_to_regex(part: re.Match[str]) -> str:
        if part["literal"]:
            return re.escape(part["literal"])
        if part["any"]:
            return r"[^/\\]*"
        name, unit = _parse_field("{" if part["field"] is None else part["field"])
        if name in units:
            return f"(?:\\{[*units].index(name) + 1})"
        units[name] = unit
        text_regex = _DAY_REGEX if name == "date" else _TEXT_REGEX
        return f"({_NUMBER_REGEX if unit else text_regex})"

    regex = _PATTERN_PART.sub(convert_to_regex, text)
    return NamePattern(text, units, re.compile(regex, re.IGNORECASE))


def _parse_field(text: str) -> tuple[str, str]:
    """Parse the name and the unit of a field from the text between its braces."""
    name = text.strip()
    if name in _TEXT_FIELDS or _LABEL_FIELD.fullmatch(name):
        return name, ""
    match = _DIMENSION_FIELD.fullmatch(name)
    if match is None or match[1] in _TEXT_FIELDS:
        fields = ", ".join(f"{{{field}}}" for field in _TEXT_FIELDS)
        raise build_refusal("protocol.no_field", found=f"{{{text}}}", fields=fields)
    if try_parse_quantity(f"1 {match[2]}", "m") is None:
        raise build_refusal("protocol.no_length_unit", found=f"{{{text}}}", dimension=match[1])
    return match[1], match[2]


PLAN_NAME = "campaign.yaml"
"""File name of the plan of a campaign."""
_EXAMPLE_PATTERN = "{type}-{length mm}-{sample}_force.mat"

Pattern = Annotated[
    NamePattern,
    PlainValidator(lambda value: parse_name_pattern(str(value))),
    PlainSerializer(lambda pattern: pattern.text),
    WithJsonSchema({"type": ["string", "number"], "examples": [_EXAMPLE_PATTERN]}),
]


class FolderPair(Block):
    """Pairs of exports by folder: a folder is a test, and labpipe infers the roles in it."""

    by: Literal["folder"] = "folder"
    name: Pattern | None = None
    """Pattern of the name of a test's folder; by default type-length-sample, such as A2-085-1."""


class NamePair(Block):
    """Pairs of exports by file name: labpipe copies each export into the folder of its test."""

    by: Literal["name"]
    source: Text = Field(".", alias="from")
    """Folder of the exports, relative to that of the plan."""
    exports: dict[Role, Pattern] = Field(min_length=1)
    """Pattern of the name of each role's export."""

    def find_value_faults(self) -> Iterator[Fault]:
        """Find patterns with different fields, because exports are paired by their fields."""
        fields = {role: ", ".join(sorted(pattern.units)) for role, pattern in self.exports.items()}
        first_role, first_text = next(iter(fields.items()))
        for role, text in fields.items():
            path = ("exports", role)
            if not text:
                yield Fault.of("protocol.no_fields", path)
            elif text != first_text:
                yield Fault.of(
                    "protocol.other_fields", path, other=first_role, expected=first_text, found=text
                )


def _fill_in_pairing(value: object) -> object:
    """Add the default ``by: folder`` to a block of pairs."""
    return {"by": "folder"} | dict(value) if isinstance(value, Mapping) else value


class CampaignPlan(Block):
    """Plan of a campaign: which exports form a test, and when a watch starts a test."""

    version: Version
    about: Remark = ""
    """Purpose of the campaign, in one line."""
    protocol: Text | None = None
    """Protocol of every test; by default the one that fits the exports of a test best."""
    pair: Annotated[
        Annotated[FolderPair | NamePair, Field(discriminator="by")],
        BeforeValidator(_fill_in_pairing),
    ] = FolderPair.model_construct()
    specimen: dict[str, Any] = Field({})
    """Shared properties of all specimens, as in a test.yaml."""
    operator: Remark = ""
    """Operator of every test."""
    overrides: dict[str, Override] = Field({})
    """Overrides of every test, as in a test.yaml."""
    wait_for: tuple[Role, ...] | None = None
    """Roles that a test needs before it starts; by default those of the protocol."""
    patience: Duration = 60.0
    """Longest wait for an optional export."""
    still_for: Duration = 1.0
    """Time without changes after which a file is complete."""
    look_every: Duration = 0.25
    """Shortest interval between checks of a watch."""

    def find_key_faults(self) -> Iterable[Fault]:
        """Find faults of the shared specimen, with placeholders for the names of a test."""
        placeholders = dict.fromkeys(("type", "spool", "sample"), "x")
        _, faults = SheetSpecimen.read(placeholders | (self.specimen or {}))
        return prefix_paths(("specimen",), faults)
