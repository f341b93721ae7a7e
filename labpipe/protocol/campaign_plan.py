"""The grammar of a campaign YAML: how exports become tests, and what a watch waits for."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, ValidationError, WithJsonSchema

from labpipe.errors import Fault
from labpipe.protocol.faults import error_of, faults_of
from labpipe.protocol.grammar import Block
from labpipe.protocol.name_patterns import NamePattern, parse_name_pattern
from labpipe.protocol.schema import known_version
from labpipe.protocol.sheet_grammar import Override, TestSheet
from labpipe.protocol.source import Role
from labpipe.protocol.values import Remark, Text
from labpipe.records.declarations import Duration

PLAN_NAME = "campaign.yaml"
_PATTERN_SCHEMA = {
    "type": "string",
    "examples": ["{type}-{length mm}-{sample}_force.mat"],
    "description": "{name} is a word, {length mm} a number without its unit, * anything",
}


def _pattern(value: object) -> str:
    try:
        return parse_name_pattern(str(value)).text
    except ValueError as error:
        raise error_of(expected=str(error), found=value) from error


Pattern = Annotated[str, BeforeValidator(_pattern), WithJsonSchema(_PATTERN_SCHEMA)]


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

    @classmethod
    def between(cls, data: object) -> list[Fault]:
        """Ask the patterns of all roles for the same fields: by these, exports are paired."""
        exports = data.get("exports") if isinstance(data, Mapping) else None
        if not isinstance(exports, Mapping):
            return []
        fields: dict[str, tuple[str, ...]] = {}
        for role, text in exports.items():
            try:
                fields[str(role)] = tuple(sorted(parse_name_pattern(str(text)).fields))
            except ValueError:
                return []  # reported where the pattern stands
        faults = []
        first = next(iter(fields.items()), ("", ()))
        for role, role_fields in fields.items():
            if not role_fields:
                remedy = "Name what tells the tests apart, such as {test}."
                faults.append(Fault(("exports", role), "a field at least", "none", remedy))
            elif role_fields != first[1]:
                expected = f"the fields of {first[0]!r}: {', '.join(first[1])}"
                faults.append(Fault(("exports", role), expected, ", ".join(role_fields)))
        return faults


def _by(value: object) -> object:
    """Take `by: folder` where it is left out."""
    return {"by": "folder"} | dict(value) if isinstance(value, Mapping) else value


def _each_once(roles: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(roles))


class CampaignPlan(Block):
    """How exports become the tests of a campaign, and what a watch waits for."""

    version: Annotated[Literal[1], BeforeValidator(known_version), WithJsonSchema({"const": 1})]
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
    def between(cls, data: object) -> list[Fault]:
        """Check what goes into every test sheet as the sheet would be checked."""
        if not isinstance(data, Mapping):
            return []
        shared = data.get("specimen")
        specimen = dict(shared) if isinstance(shared, Mapping) else {}
        sheet = {
            "test": "x",
            "protocol": "x",
            "specimen": {"type": "x", "spool": "x", "sample": "x"} | specimen,
            "files": {"force": "x"},
            "overrides": data.get("overrides") or {},
        }
        try:
            TestSheet.model_validate(sheet)
        except ValidationError as error:
            faults = faults_of(error, data=sheet, keys=())
            return [fault for fault in faults if fault.path[:1] in {("specimen",), ("overrides",)}]
        return []
