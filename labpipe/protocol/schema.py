"""The grammar of a protocol: pydantic models with the keys of the YAML."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import (
    BeforeValidator,
    Field,
    WithJsonSchema,
    field_validator,
)

from labpipe.errors import Fault
from labpipe.protocol.block import Block
from labpipe.protocol.cross_checks import cross_faults
from labpipe.protocol.faults import error_of
from labpipe.protocol.results import ResultEntry
from labpipe.protocol.rig import (
    Align,
    AlignNone,
    Branches,
    CurveBlock,
    Groups,
    Markers,
    Report,
    Rig,
    SpecimenBlock,
)
from labpipe.protocol.source import ChannelSource, Role, Source
from labpipe.protocol.steps import Step
from labpipe.protocol.words import FileStem, Remark


def known_version(value: object) -> int:
    """Take the version of a file, if this labpipe knows it.

    Parameters
    ----------
    value : as written

    Raises
    ------
    PydanticCustomError
        If it is another one.
    """
    if str(value) != "1":
        remedy = "A newer labpipe may know this version."
        raise error_of(
            expected="version 1, the only one that this labpipe knows", found=value, remedy=remedy
        )
    return 1


class Protocol(Block):
    """How one kind of test is processed, from its exports to its results."""

    version: Annotated[Literal[1], BeforeValidator(known_version), WithJsonSchema({"const": 1})]
    name: FileStem = Field(description="As the file is called, without .yaml")
    about: Remark = Field("", description="What it is for, in one line")
    follow_links: bool = Field(
        False, description="Whether exports may be links out of the folder of the test"
    )
    sources: dict[Role, Source] = Field(min_length=1)
    specimen: SpecimenBlock = SpecimenBlock()
    rig: Rig = Rig()
    markers: Markers | None = None
    align: Align = AlignNone()
    steps: tuple[Step, ...] = ()
    curve: CurveBlock | None = None
    branches: Branches | None = None
    results: tuple[ResultEntry, ...] = Field((), description="In the order of the summary")
    report: Report = Report()
    groups: Groups = Groups()

    @property
    def channels(self) -> dict[str, ChannelSource]:
        """The channels of all sources by name."""
        named = (source.all_channels for source in self.sources.values())
        return {name: channel for channels in named for name, channel in channels.items()}

    @field_validator("sources")
    @classmethod
    def _know_their_roles(cls, sources: dict[Role, Source]) -> dict[Role, Source]:
        return {role: source.in_role(role) for role, source in sources.items()}

    @field_validator("steps")
    @classmethod
    def _know_their_numbers(cls, steps: tuple[Step, ...]) -> tuple[Step, ...]:
        return tuple(step.numbered(number) for number, step in enumerate(steps))

    @classmethod
    def between(cls, data: object) -> list[Fault]:
        """Check one part of the protocol against another."""
        return cross_faults(data) if isinstance(data, Mapping) else []
