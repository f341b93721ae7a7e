"""Plans: which parameters a calibration fits, and how exports become the tests of a campaign.

Patterns of the names of exports and folders, such as ``{type}-{length mm}-{sample}_force.mat``:
``{name}`` stands for a word, ``{length mm}`` for a number whose unit is not in the name, ``{date}``
for a day with the year first, ``*`` for anything; all else for itself, in capitals or not. A word
takes as much as it can, from the left. A slash separates folders.
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
from labpipe.protocol.grammar import Block
from labpipe.protocol.schema import Version
from labpipe.protocol.sheet_grammar import Override, TestSheet
from labpipe.protocol.source import Role
from labpipe.protocol.values import Remark, Text, build_path_validator, parse_or_none
from labpipe.protocol.yaml_text import (
    FaultsError,
    Values,
    find_repeated_names,
    get_block,
    get_list,
    refused,
)
from labpipe.records.declarations import Duration, Length, Quantity, WholeNumber


def _unit_like(si_unit: str, value: object) -> str:
    if parse_or_none(f"1 {value}", si_unit) is None:
        raise refused("protocol.no_unit_like", found=value, si_unit=si_unit)
    return str(value)


def _sign(value: object) -> int:
    if str(value) not in ("1", "+1", "-1"):
        raise refused("protocol.no_sign", found=value)
    return int(str(value))


COPY_REMEDY = "Copy the curve into the folder of the plan and name it from there."

LengthUnit = Annotated[str, BeforeValidator(partial(_unit_like, "m")), Field(examples=["mm"])]
ForceUnit = Annotated[str, BeforeValidator(partial(_unit_like, "N")), Field(examples=["N"])]
Sign = Annotated[Literal[1, -1], BeforeValidator(_sign)]


class _Column(Block):
    """Where one of two quantities stands."""

    column: Text | None = Field(
        None, description="Its name, or its number counted from 1; else 'deflection' or 'force'"
    )
    sign: Sign = Field(1, description="-1 where the file counts against the direction of bending")


class DeflectionColumn(_Column):
    """The deflection of the tip."""

    unit: LengthUnit | None = Field(None, description="Where the heading does not say it")


class ForceColumn(_Column):
    """The force at the tip."""

    unit: ForceUnit | None = Field(None, description="Where the heading does not say it")


class Comparison(Block):
    """A curve from elsewhere: finite elements, a digitised figure, another lab."""

    name: Text
    file: Annotated[str, build_path_validator("the folder of the plan", COPY_REMEDY)] = Field(
        description="csv or xlsx in the folder of the plan, or below it"
    )
    wire: Text = Field(description="Wire of the sheet that it is of")
    length: Length = Field(description="Free length")
    load: Literal["as tested", "normal"] = Field(
        "as tested",
        description="as tested: pulled by the string of the tests; normal: a force that stays "
        "normal to the undeformed axis, as in most finite-element models",
    )
    deflection: DeflectionColumn = DeflectionColumn()
    force: ForceColumn = ForceColumn()
    because: Text = Field(description="Where it comes from")


Friction = Annotated[float, Quantity("N", "N", "0.05 N", above=0.0)]
Modulus = Annotated[float, Quantity("Pa", "MPa", "1000 MPa", above=0.0)]
Scale = Annotated[float, Quantity("1", "1", "1", above=0.0)]
Scatter = Annotated[float, Quantity("1", "%", "3 %", minimum=0.0, maximum=0.5)]
Factor = Annotated[float, Quantity("1", "1", "1.5", above=1.0)]


class _Parameter(Block):
    """How one parameter enters."""

    enters: Literal["free", "fixed", "prior"] = Field(
        "free", description="fitted; held at its value; fitted with a log-normal prior about it"
    )
    factor: Factor | None = Field(
        None, description="Of a prior: 95 % between value / factor and value x factor"
    )
    because: Remark = Field("", description="Where a prior or a fixed value comes from")

    @classmethod
    def find_contradictions(cls, data: Values) -> Iterator[Fault]:
        """Ask of a prior what it needs, and of the others that they do not have it."""
        enters, stated = data.get("enters", "free"), {key for key in data if data[key]}
        needed = {"fixed": ("value", "because"), "prior": ("value", "because", "factor")}
        for key in needed.get(str(enters), ()):
            if key not in stated:
                yield Fault.of("protocol.no_key_of_parameter", key=key, enters=enters)
        if enters in ("free", "fixed") and "factor" in stated:
            yield Fault.of("protocol.factor_of_no_prior", ("factor",), at="key")


class RadialFriction(_Parameter):
    """phi = F_rad (mu_s + mu_p)."""

    value: Friction | None = None


class InsulationModulus(_Parameter):
    """E of the insulation."""

    value: Modulus | None = None


class CopperScale(_Parameter):
    """Factor on the strength of the copper."""

    value: Scale | None = None


class Parameters(Block):
    """All that is calibrated."""

    radial_friction: RadialFriction = RadialFriction()
    insulation_modulus: InsulationModulus = InsulationModulus()
    copper_scale: CopperScale = CopperScale()


class CalibrationPlan(Block):
    """What is asked of a calibration."""

    version: Version
    wire: Text | None = Field(
        None, description="Specimen type whose tests calibrate; the others are predicted"
    )
    parameters: Parameters = Parameters()
    scatter: Scatter | None = Field(
        None, description="Standard deviation between samples, where it is known"
    )
    points: Annotated[int, WholeNumber(20, 5000)] = Field(272, description="Points of each curve")
    up_to: Length | None = Field(None, description="Largest deflection that is used")
    comparisons: tuple[Comparison, ...] = Field(
        (), description="Curves from elsewhere that tests and model are compared with"
    )

    @classmethod
    def find_contradictions(cls, data: Values) -> Iterable[Fault]:
        """Ask each comparison for a name of its own."""
        return find_repeated_names(get_list(data, "comparisons"), "comparisons", "comparison")


WORDS = ("test", "type", "spool", "sample", "operator", "date")
"""Fields without a unit; besides them, every dimension with its unit, and ``labels.NAME``."""
_PART = re.compile(r"\{([^{}]*)\}|(\*)|([{}])")
_DIMENSION = re.compile(r"([a-z][a-z0-9_]*)\s+(\S+)")
_LABEL = re.compile(r"labels\.[a-z][a-z0-9_]*")
_WORD, _NUMBER, _DAY = r"[^/\\]+", r"\d+(?:[.,]\d+)?", r"\d{4}-\d{2}-\d{2}|\d{8}"
MAX_PATTERN_LENGTH = 300
"""Characters of a pattern, and of a name that is compared."""


@dataclass(frozen=True, slots=True)
class NamePattern:
    """A pattern that was read.

    Parameters
    ----------
    text : as written
    fields : names of its fields in their order, each once
    units : unit of each field that is a number
    compiled : what a name is compared with
    """

    text: str
    fields: tuple[str, ...]
    units: Mapping[str, str]
    compiled: re.Pattern[str]

    def match(self, name: str) -> dict[str, str] | None:
        """Split a name into its fields.

        Parameters
        ----------
        name : of a file or folder, with slashes between folders

        Returns
        -------
        Text by field, a number with its unit; None if the name is not of this pattern.

        Examples
        --------
        >>> parse_name_pattern("{type}-{length mm}-{sample}_force.mat").match("A2-085-1_Force.MAT")
        {'type': 'A2', 'length': '85 mm', 'sample': '1'}
        """
        match = self.compiled.fullmatch(name) if len(name) <= MAX_PATTERN_LENGTH else None
        if match is None:
            return None
        texts = {field: match[f"f{place}"] for place, field in enumerate(self.fields)}
        return {field: self._value(field, text) for field, text in texts.items()}

    def stem(self, name: str) -> str:
        """Return the part of a name up to its last field, without its folders.

        Parameters
        ----------
        name : of this pattern

        Examples
        --------
        >>> parse_name_pattern("in/{type}-{sample}_force.mat").stem("in/A2-1_force.mat")
        'A2-1'
        """
        match = self.compiled.fullmatch(name)
        ends = [match.end(f"f{place}") for place in range(len(self.fields))] if match else []
        return name[: max(ends, default=len(name))].rpartition("/")[2]

    def _value(self, field: str, text: str) -> str:
        if field in self.units:
            number = float(text.replace(",", "."))
            return f"{number:g} {self.units[field]}"
        if field == "date" and "-" not in text:
            return f"{text[:4]}-{text[4:6]}-{text[6:]}"
        return text


def parse_name_pattern(text: str) -> NamePattern:
    """Read a pattern.

    Parameters
    ----------
    text : as a campaign YAML has it

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
    for field_match in _PART.finditer(text):
        parts.append(re.escape(text[end : field_match.start()]))
        end = field_match.end()
        if field_match[2]:
            parts.append(r"[^/\\]*")
            continue
        name, unit = _field("{" if field_match[1] is None else field_match[1])
        if name in fields:
            parts.append(f"(?P=f{fields.index(name)})")
            continue
        kind = _NUMBER if unit else _DAY if name == "date" else _WORD
        parts.append(f"(?P<f{len(fields)}>{kind})")
        fields.append(name)
        units |= {name: unit} if unit else {}
    parts.append(re.escape(text[end:]))
    compiled = re.compile("".join(parts), re.IGNORECASE)
    return NamePattern(text, tuple(fields), MappingProxyType(units), compiled)


def _field(written: str) -> tuple[str, str]:
    """Return name and unit of the field between braces."""
    name = written.strip()
    if name in WORDS or _LABEL.fullmatch(name):
        return name, ""
    match = _DIMENSION.fullmatch(name)
    if match is None or match[1] in WORDS:
        fields = ", ".join(f"{{{word}}}" for word in WORDS)
        raise refused("protocol.no_field", found=f"{{{written}}}", fields=fields)
    if parse_or_none(f"1 {match[2]}", "m") is None:
        raise refused("protocol.no_length_unit", found=f"{{{written}}}", dimension=match[1])
    return match[1], match[2]


PLAN_NAME = "campaign.yaml"
_EXAMPLE = "{type}-{length mm}-{sample}_force.mat"


def _pattern(value: object) -> str:
    return parse_name_pattern(str(value)).text


Pattern = Annotated[str, BeforeValidator(_pattern), Field(examples=[_EXAMPLE])]


class ByFolder(Block):
    """One folder per test; what the exports are for is known by their content."""

    by: Literal["folder"] = "folder"
    name: Pattern | None = Field(
        None, description="Of the folder of a test; else as type-length-sample, such as A2-085-1"
    )

    @property
    def pattern(self) -> NamePattern | None:
        """Return the pattern of the folders, read."""
        return None if self.name is None else parse_name_pattern(self.name)


class ByName(Block):
    """The exports of all tests in one place; each gets a copy in the folder of its test."""

    by: Literal["name"]
    source: Text = Field(
        ".", alias="from", description="Where the exports come to: a folder, from that of the plan"
    )
    exports: dict[Role, Pattern] = Field(min_length=1, description="By role: what it is called")

    @property
    def patterns(self) -> dict[str, NamePattern]:
        """Return the patterns by role, read."""
        return {role: parse_name_pattern(text) for role, text in self.exports.items()}

    @field_validator("exports")
    @classmethod
    def _have_the_same_fields(cls, exports: dict[Role, str]) -> dict[Role, str]:
        """Ask the patterns of all roles for the same fields: by these, exports are paired."""
        fields = {role: sorted(parse_name_pattern(text).fields) for role, text in exports.items()}
        (first, first_fields), *_ = fields.items()
        faults = [
            Fault.of("protocol.no_fields", (role,))
            if not own
            else Fault.of(
                "protocol.other_fields",
                (role,),
                other=first,
                expected=", ".join(first_fields),
                found=", ".join(own),
            )
            for role, own in fields.items()
            if own != first_fields or not own
        ]
        if faults:
            raise FaultsError(*faults)
        return exports


def _by(value: object) -> object:
    """Take `by: folder` where it is left out."""
    return {"by": "folder"} | dict(value) if isinstance(value, Mapping) else value


def _each_once(roles: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(roles))


class CampaignPlan(Block):
    """How exports become the tests of a campaign, and what a watch waits for."""

    version: Version
    about: Remark = Field("", description="What the campaign is for, in one line")
    protocol: Text | None = Field(
        None, description="Of every test; else the one that fits its exports best"
    )
    pair: Annotated[
        Annotated[ByFolder | ByName, Field(discriminator="by")], BeforeValidator(_by)
    ] = ByFolder()
    specimen: dict[str, Any] = Field({}, description="What all specimens share, as in a test.yaml")
    operator: Remark = Field("", description="Of every test")
    overrides: dict[str, Override] = Field({}, description="Of every test, as in a test.yaml")
    wait_for: Annotated[tuple[Role, ...], AfterValidator(_each_once)] | None = Field(
        None, description="Roles without which a test is not begun; else those the protocol needs"
    )
    patience: Duration = Field(
        60.0, description="How long an export that the protocol can do without is waited for"
    )
    still_for: Duration = Field(
        1.0, description="How long a file must stand still before it counts as whole"
    )
    look_every: Duration = Field(0.25, description="How often a watch looks")

    @classmethod
    def find_contradictions(cls, data: Values) -> Iterable[Fault]:
        """Check what goes into every test sheet as the sheet would be checked."""
        specimen = dict(get_block(data, "specimen"))
        sheet = {
            "test": "x",
            "protocol": "x",
            "specimen": {"type": "x", "spool": "x", "sample": "x"} | specimen,
            "files": {"force": "x"},
            "overrides": data.get("overrides") or {},
        }
        read = TestSheet.read(sheet)
        faults = read if isinstance(read, list) else []
        return [fault for fault in faults if fault.path[:1] in {("specimen",), ("overrides",)}]
