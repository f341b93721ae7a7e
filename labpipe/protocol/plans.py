"""Plans of calibrations (which parameters are fitted) and campaigns (which exports form a test).

A campaign pairs exports by name patterns such as ``{type}-{length mm}-{sample}_force.mat``. In a
pattern, ``{type}`` matches text, ``{length mm}`` a number in that unit, ``{date}`` a date with the
year first, and ``*`` anything; other characters match themselves, in either case. Fields match as
much as possible, from the left. A slash separates folders.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, field_validator

from labpipe.errors import Fault
from labpipe.protocol.grammar import Block, Remark, Text, build_path_validator, parse_or_none
from labpipe.protocol.schema import Version
from labpipe.protocol.sheet_grammar import Override, TestSheet
from labpipe.protocol.source import Role
from labpipe.protocol.yaml_text import (
    Values,
    find_repeated_names,
    get_block,
    raise_faults,
    refused,
)
from labpipe.records.declarations import Duration, Length, Quantity, WholeNumber


def _parse_unit(si_unit: str, value: object) -> str:
    if parse_or_none(f"1 {value}", si_unit) is None:
        raise refused("protocol.no_unit_like", found=value, si_unit=si_unit)
    return str(value)


def _parse_sign(value: object) -> int:
    if str(value) not in ("1", "+1", "-1"):
        raise refused("protocol.no_sign", found=value)
    return int(str(value))


COPY_REMEDY = "Copy the curve into the folder of the plan and name it from there."

LengthUnit = Annotated[str, BeforeValidator(partial(_parse_unit, "m")), Field(examples=["mm"])]
ForceUnit = Annotated[str, BeforeValidator(partial(_parse_unit, "N")), Field(examples=["N"])]
Sign = Annotated[Literal[1, -1], BeforeValidator(_parse_sign)]


class _Column(Block):
    """One of the two columns of a curve."""

    column: Text | None = None
    """Its name, or its number from 1; else 'deflection' or 'force'."""
    sign: Sign = 1
    """-1 if the values decrease in the direction of bending."""


class DeflectionColumn(_Column):
    """The deflection of the tip."""

    unit: LengthUnit | None = None
    """Needed if the heading has no unit."""


class ForceColumn(_Column):
    """The force at the tip."""

    unit: ForceUnit | None = None
    """Needed if the heading has no unit."""


class Comparison(Block):
    """An external curve: from finite elements, a digitised figure or another lab."""

    name: Text
    file: Annotated[str, build_path_validator("the folder of the plan", COPY_REMEDY)]
    """csv or xlsx in the folder of the plan, or below it."""
    wire: Text
    """Name of the wire in the wire sheet."""
    length: Length
    """Free length."""
    load: Literal["as tested", "normal"] = "as tested"
    """as tested: by the string of the tests; normal: normal to the undeformed axis, as in most
    finite-element models."""
    deflection: DeflectionColumn = DeflectionColumn()
    force: ForceColumn = ForceColumn()
    because: Text
    """Origin of the curve."""


Friction = Annotated[float, Quantity("N", "N", "0.05 N", above=0.0)]
Modulus = Annotated[float, Quantity("Pa", "MPa", "1000 MPa", above=0.0)]
Scale = Annotated[float, Quantity("1", "1", "1", above=0.0)]
Scatter = Annotated[float, Quantity("1", "%", "3 %", minimum=0.0, maximum=0.5)]
Factor = Annotated[float, Quantity("1", "1", "1.5", above=1.0)]


class _Parameter(Block):
    """How a calibration treats one parameter."""

    enters: Literal["free", "fixed", "prior"] = "free"
    """free: fitted; fixed: constant; prior: fitted with a log-normal prior."""
    factor: Factor | None = None
    """Of a prior: its 95 % interval is value / factor to value x factor."""
    because: Remark = ""
    """Origin of a prior or a fixed value."""

    @classmethod
    def find_contradictions(cls, data: Values) -> Iterator[Fault]:
        """Find missing keys of a prior or fixed value, and a factor without a prior."""
        enters, stated = data.get("enters", "free"), {key for key in data if data[key]}
        needed = {"fixed": ("value", "because"), "prior": ("value", "because", "factor")}
        for key in needed.get(str(enters), ()):
            if key not in stated:
                yield Fault.of("protocol.no_key_of_parameter", key=key, enters=enters)
        if enters in ("free", "fixed") and "factor" in stated:
            yield Fault.of("protocol.factor_of_no_prior", ("factor",), at="key")


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

    radial_friction: RadialFriction = RadialFriction()
    insulation_modulus: InsulationModulus = InsulationModulus()
    copper_scale: CopperScale = CopperScale()


class CalibrationPlan(Block):
    """Plan of a calibration: its parameters, tests and external curves."""

    version: Version
    wire: Text | None = None
    """Specimen type whose tests are fitted; other types are predicted."""
    parameters: Parameters = Parameters()
    scatter: Scatter | None = None
    """Standard deviation between samples, where it is known."""
    points: Annotated[int, WholeNumber(20, 5000)] = 272
    """Points of each curve."""
    up_to: Length | None = None
    """Largest deflection that is used."""
    comparisons: tuple[Comparison, ...] = ()
    """External curves to compare with tests and model."""

    @field_validator("comparisons")
    @classmethod
    def _check_names(cls, comparisons: tuple[Comparison, ...]) -> tuple[Comparison, ...]:
        raise_faults(find_repeated_names([item.name for item in comparisons], "comparison"))
        return comparisons


TEXT_FIELDS = ("test", "type", "spool", "sample", "operator", "date")
"""Fields without a unit; others are dimensions with a unit, and ``labels.NAME``."""
_PATTERN_PART = re.compile(r"\{([^{}]*)\}|(\*)|([{}])")
_DIMENSION_FIELD = re.compile(r"([a-z][a-z0-9_]*)\s+(\S+)")
_LABEL_FIELD = re.compile(r"labels\.[a-z][a-z0-9_]*")
_TEXT, _NUMBER, _DAY = r"[^/\\]+", r"\d+(?:[.,]\d+)?", r"\d{4}-\d{2}-\d{2}|\d{8}"
MAX_PATTERN_LENGTH = 300
"""Largest number of characters of a pattern, and of a name to match."""


@dataclass(frozen=True, slots=True)
class NamePattern:
    """A parsed name pattern.

    Parameters
    ----------
    text : as written
    fields : names of its fields in order, without repeats
    units : unit of each field that is a number
    compiled : regular expression with a group ``f<index>`` per field
    """

    text: str
    fields: tuple[str, ...]
    units: Mapping[str, str]
    compiled: re.Pattern[str]

    def match(self, name: str) -> dict[str, str] | None:
        """Match a name with the pattern.

        Parameters
        ----------
        name : of a file or folder, with slashes between folders

        Returns
        -------
        Text by field, for numbers with their unit; None if the name does not match.

        Examples
        --------
        >>> parse_name_pattern("{type}-{length mm}-{sample}_force.mat").match("A2-085-1_Force.MAT")
        {'type': 'A2', 'length': '85 mm', 'sample': '1'}
        """
        match = self.compiled.fullmatch(name) if len(name) <= MAX_PATTERN_LENGTH else None
        if match is None:
            return None
        texts = {field: match[f"f{index}"] for index, field in enumerate(self.fields)}
        return {field: self._format_value(field, text) for field, text in texts.items()}

    def stem(self, name: str) -> str:
        """Return the part of a name up to its last field, without folders.

        Parameters
        ----------
        name : if it does not match the pattern, it is returned without folders

        Examples
        --------
        >>> parse_name_pattern("in/{type}-{sample}_force.mat").stem("in/A2-1_force.mat")
        'A2-1'
        """
        match = self.compiled.fullmatch(name)
        ends = [match.end(f"f{index}") for index in range(len(self.fields))] if match else []
        return name[: max(ends, default=len(name))].rpartition("/")[2]

    def _format_value(self, field: str, text: str) -> str:
        if field in self.units:
            number = float(text.replace(",", "."))
            return f"{number:g} {self.units[field]}"
        if field == "date" and "-" not in text:
            return f"{text[:4]}-{text[4:6]}-{text[6:]}"
        return text


def parse_name_pattern(text: str) -> NamePattern:
    """Parse a name pattern.

    Parameters
    ----------
    text : as written in a campaign YAML

    Raises
    ------
    FaultsError
        If it is invalid.
    """
    if len(text) > MAX_PATTERN_LENGTH:
        raise refused("protocol.long_pattern", found=text, most=MAX_PATTERN_LENGTH)
    units: dict[str, str] = {}
    fields: list[str] = []
    parts, end = [], 0
    for field_match in _PATTERN_PART.finditer(text):
        parts.append(re.escape(text[end : field_match.start()]))
        end = field_match.end()
        if field_match[2]:
            parts.append(r"[^/\\]*")
            continue
        name, unit = _parse_field("{" if field_match[1] is None else field_match[1])
        if name in fields:
            parts.append(f"(?P=f{fields.index(name)})")
            continue
        kind = _NUMBER if unit else _DAY if name == "date" else _TEXT
        parts.append(f"(?P<f{len(fields)}>{kind})")
        fields.append(name)
        units |= {name: unit} if unit else {}
    parts.append(re.escape(text[end:]))
    compiled = re.compile("".join(parts), re.IGNORECASE)
    return NamePattern(text, tuple(fields), MappingProxyType(units), compiled)


def _parse_field(written: str) -> tuple[str, str]:
    """Parse name and unit of the field between braces."""
    name = written.strip()
    if name in TEXT_FIELDS or _LABEL_FIELD.fullmatch(name):
        return name, ""
    match = _DIMENSION_FIELD.fullmatch(name)
    if match is None or match[1] in TEXT_FIELDS:
        fields = ", ".join(f"{{{word}}}" for word in TEXT_FIELDS)
        raise refused("protocol.no_field", found=f"{{{written}}}", fields=fields)
    if parse_or_none(f"1 {match[2]}", "m") is None:
        raise refused("protocol.no_length_unit", found=f"{{{written}}}", dimension=match[1])
    return match[1], match[2]


PLAN_NAME = "campaign.yaml"
_EXAMPLE = "{type}-{length mm}-{sample}_force.mat"


def _parse_pattern(value: object) -> str:
    return parse_name_pattern(str(value)).text


Pattern = Annotated[str, BeforeValidator(_parse_pattern), Field(examples=[_EXAMPLE])]


class ByFolder(Block):
    """Pairing by folder: one folder per test; labpipe infers the roles from the content."""

    by: Literal["folder"] = "folder"
    name: Pattern | None = None
    """Of the folder of a test; else type-length-sample, such as A2-085-1."""

    @property
    def pattern(self) -> NamePattern | None:
        """Return the parsed pattern of the folders; None if the plan has none."""
        return None if self.name is None else parse_name_pattern(self.name)


class ByName(Block):
    """Pairing by file name: labpipe copies each export into the folder of its test."""

    by: Literal["name"]
    source: Text = Field(".", alias="from")
    """Folder of the exports, relative to that of the plan."""
    exports: dict[Role, Pattern] = Field(min_length=1)
    """By role: pattern of its name."""

    @property
    def patterns(self) -> dict[str, NamePattern]:
        """Return the parsed patterns by role."""
        return {role: parse_name_pattern(text) for role, text in self.exports.items()}

    @field_validator("exports")
    @classmethod
    def _check_fields(cls, exports: dict[Role, str]) -> dict[Role, str]:
        """Refuse patterns with different fields, because exports are paired by their fields."""
        fields = {role: sorted(parse_name_pattern(text).fields) for role, text in exports.items()}
        (first, first_fields), *_ = fields.items()
        faults = []
        for role, own_fields in fields.items():
            if not own_fields:
                faults.append(Fault.of("protocol.no_fields", (role,)))
            elif own_fields != first_fields:
                expected, found = ", ".join(first_fields), ", ".join(own_fields)
                faults.append(
                    Fault.of(
                        "protocol.other_fields",
                        (role,),
                        other=first,
                        expected=expected,
                        found=found,
                    )
                )
        raise_faults(faults)
        return exports


def _fill_in_pairing(value: object) -> object:
    """Add the default `by: folder`."""
    return {"by": "folder"} | dict(value) if isinstance(value, Mapping) else value


def _remove_repeats(roles: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(roles))


class CampaignPlan(Block):
    """Plan of a campaign: which exports form a test, and when a watch starts a test."""

    version: Version
    about: Remark = ""
    """Purpose of the campaign, in one line."""
    protocol: Text | None = None
    """Of every test; else the one that fits its exports best."""
    pair: Annotated[
        Annotated[ByFolder | ByName, Field(discriminator="by")], BeforeValidator(_fill_in_pairing)
    ] = ByFolder()
    specimen: dict[str, Any] = Field({})
    """Shared properties of all specimens, as in a test.yaml."""
    operator: Remark = ""
    """Of every test."""
    overrides: dict[str, Override] = Field({})
    """Of every test, as in a test.yaml."""
    wait_for: Annotated[tuple[Role, ...], AfterValidator(_remove_repeats)] | None = None
    """Roles that a test needs before it starts; else those of the protocol."""
    patience: Duration = 60.0
    """Longest wait for an optional export."""
    still_for: Duration = 1.0
    """Time without changes after which a file is complete."""
    look_every: Duration = 0.25
    """Interval between two looks of a watch."""

    @classmethod
    def find_contradictions(cls, data: Values) -> Iterable[Fault]:
        """Find faults of the specimen and the overrides as in a test sheet."""
        specimen = dict(get_block(data, "specimen"))
        sheet = {
            "test": "x",
            "protocol": "x",
            "specimen": {"type": "x", "spool": "x", "sample": "x"} | specimen,
            "files": {"force": "x"},
            "overrides": data.get("overrides") or {},
        }
        validated = TestSheet.read(sheet)
        faults = validated if isinstance(validated, list) else []
        return [fault for fault in faults if fault.path[:1] in {("specimen",), ("overrides",)}]
