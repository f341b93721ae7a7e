"""Protocols: the blocks of a protocol file (specimen, rig, clocks, curve, report) and the file."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias, Union

from pydantic import (
    BeforeValidator,
    Field,
    ValidationInfo,
    field_validator,
)

from labpipe.errors import Fault
from labpipe.protocol.cross_checks import find_cross_faults
from labpipe.protocol.grammar import Block
from labpipe.protocol.source import (
    ChannelSource,
    Plausible,
    Role,
    Section,
    SizeUncertainties,
    Source,
)
from labpipe.protocol.values import FileStem, Remark, ShortForm, Text
from labpipe.protocol.yaml_text import FaultsError, Values, refused
from labpipe.records.declarations import (
    LIMITS,
    Compliance,
    Distance,
    Drift,
    Duration,
    Force,
    Key,
    LargerThan,
    Length,
    Limits,
    LinearMass,
    Mass,
    Moment,
    Offset,
    Quantity,
    Ratio,
    Share,
    Snake,
    Speed,
    Step,
    TaggedChoice,
    Uncertainty,
    WholeNumber,
)
from labpipe.records.group import LotRule
from labpipe.results import KINDS
from labpipe.results.kinds import Kind

if TYPE_CHECKING:
    ResultEntry: TypeAlias = Kind
else:
    ResultEntry = Annotated[Union[KINDS], TaggedChoice("result")]  # noqa: UP007 - of a list


class SpecimenBlock(Block):
    """Dimensions that all specimens of the protocol share."""

    length: Length | None = Field(None, description="Free length; a test sheet overrides it")
    gauge_length: Length | None = Field(
        None, description="Of the extensometer whose channel is the displacement of the curve"
    )
    span: Length | None = Field(None, description="Distance between the supports")
    mass_per_length: LinearMass | None = Field(
        None, description="For the deflection of a cantilever by its weight, which is else ignored"
    )
    section: Section | None = None
    uncertainty: SizeUncertainties | None = Field(
        None, description="Standard uncertainties of these dimensions; a test sheet overrides them"
    )

    @field_validator("uncertainty")
    @classmethod
    def _check_uncertainties(cls, sizes: Any, info: ValidationInfo) -> Any:
        """Refuse uncertainties that are not below the dimension."""
        dimensions = {**vars(info.data.get("section") or Section()), **info.data}
        faults = [
            Fault.of("protocol.size_unknown", (key,), key=key)
            for key, uncertainty in (sizes.by_key if sizes else {}).items()
            if uncertainty >= (dimensions.get(key) or math.inf)
        ]
        if faults:
            raise FaultsError(*faults)
        return sizes


class LoadString(Block):
    """The string between specimen and load cell."""

    length: Length
    counterweight: Mass = Field(0.0, description="Mass that hangs at the tip")
    at_rest: Literal["by-data", "taut", "slack"] = Field(
        "by-data", description="Whether the string carried the counterweight before the test"
    )


class Rig(Block):
    """Settings of the machine. They check the recordings and replace no measurement."""

    crosshead_speed: Speed | None = None
    stroke: Length | None = None
    cycles: Annotated[int, WholeNumber(1, 1_000_000)] | None = None
    string: LoadString | None = None


def _parse_marker_names(value: object) -> object:
    if value == "all":
        return value
    names = value if isinstance(value, list | tuple) else [value]
    if not names or not all(isinstance(name, str) and name for name in names):
        raise refused("protocol.no_markers", found=value)
    return tuple(names)


MarkerNames: TypeAlias = Annotated[
    Literal["all"] | tuple[str, ...],
    ShortForm(_parse_marker_names, {"type": "string"}),
]


class Markers(Block):
    """Where the markers of a take are on the specimen."""

    clamp: Text | None = Field(description="Rigid body at the clamped end; null if there is none")
    along: MarkerNames = Field(
        "all", description="Markers along the specimen: all, or a list of names and patterns"
    )
    rings: Literal["none", "by-body"] = Field(
        "none", description="by-body: the markers of one body give the centre of their ring"
    )
    grip_offset: Offset = Field(0.0, description="From the pivot of the clamp to the clamped end")
    pull_offset: Distance = Field(
        0.0, description="From the last marker to the string, along the specimen"
    )
    centre_offset: Offset = Field(
        0.0, description="From the axis to the centre of a marker, towards the pull"
    )
    offset_uncertainty: Distance = Field(
        0.0, description="Standard uncertainty of each of grip_offset and pull_offset"
    )
    centre_uncertainty: Distance = Field(0.0, description="Standard uncertainty of centre_offset")


class AlignNone(Block):
    """All channels have one clock."""

    method: Literal["none"] = "none"


class AlignTurningPoints(Block):
    """Two clocks, aligned by turning points that both recordings show."""

    method: Literal["turning-points"]
    channel: Snake = Field(description="Channel whose corners mark the turning points")
    motion_window: Duration = Field(description="On each side of a turning point of the clamp")
    force_window: Duration = Field(description="On each side of a corner of the channel")
    max_residual: Duration = Field(description="Larger residuals are doubtful")
    max_drift: Ratio = Field(description="A larger drift is doubtful")


class AlignCommonStart(Block):
    """Two recorders that started together; a corner of the force at a turning point checks it."""

    method: Literal["common-start"]
    channel: Snake = Field(description="Channel whose corner marks the turning point")
    max_offset: Duration = Field(description="Largest delay of the later recorder")
    max_drift: Ratio = Field(1e-4, description="Largest relative difference of the clock rates")
    motion_window: Duration = Field(
        10.0, description="On each side of a turning point of the motion"
    )
    force_window: Duration = Field(1.0, description="On each side of a corner of the channel")


class AlignStated(Block):
    """A stated relation of the clocks: force time = offset + (1 + drift) x motion time."""

    method: Literal["stated"]
    channel: Snake | None = Field(
        None, description="A channel on the clock of the force; else the force of the curve"
    )
    offset: Moment = Field(description="Force time at motion time zero")
    drift: Drift = Field(0.0, description="Relative excess of the rate of the force clock")
    uncertainty: Duration | None = Field(
        None, description="Standard uncertainty of the offset; else one sample"
    )
    because: Text = Field(description="Source of the offset")
    motion_window: Duration = Field(
        10.0, description="On each side of a turning point of the motion"
    )


Align: TypeAlias = Annotated[
    AlignNone | AlignTurningPoints | AlignCommonStart | AlignStated, Field(discriminator="method")
]


class MachineCompliance(Block):
    """Compliance of frame and grips; times the force, it is subtracted from the displacement."""

    value: Compliance = Field(description="From a test of a stiff bar, protocol stiff-bar")
    uncertainty: Uncertainty = Field(
        0.0, description="Standard uncertainty, as a share of the value"
    )


class Failure(Block):
    """Criterion of failure: the force drops suddenly and does not recover."""

    force_below: Share = Field(description="Share of the largest force, such as 50 %")
    loss: Share = Field(0.1, description="Smallest drop, as a share of the largest force")
    within: Duration = Field(
        0.05, description="Longest duration of the drop; one sample step if that is longer"
    )
    at_end_below: Share | None = Field(
        None,
        description="A record whose force ends below this share of the largest ends with the break",
    )


class Slips(Block):
    """What labpipe does where the specimen slips in its grips."""

    decision: Literal["marked", "repaired", "cut"] = Field(
        description="marked: noted; repaired: the lost force is added; cut: the curve ends there"
    )
    min_drop: Force = Field(description="Smaller drops of force are ignored")


class Slack(Block):
    """Toe compensation: displacement starts where a line through the steep part has zero force."""

    start: Annotated[Share, Key("from"), "Of the largest force, such as 10 %"]
    stop: Annotated[
        Share, Key("to"), LargerThan("start", "from"), "Of the largest force, such as 30 %"
    ]


def _parse_reverse(value: object) -> object:
    names = value if isinstance(value, list | tuple) else [None]
    if any(names.count(name) > 1 or name not in ("force", "displacement") for name in names):
        raise refused("protocol.no_reverse", found=value)
    return tuple(names)


Reverse: TypeAlias = Annotated[
    tuple[Literal["force", "displacement"], ...], BeforeValidator(_parse_reverse)
]


class ElasticLine(Block):
    """The straight part of a tension test in stress and strain: the longest one, or a window."""

    start: Annotated[Ratio | None, Key("from"), "Start of a window, such as 0.05 % strain"] = None
    stop: Annotated[Ratio | None, Key("to"), "End of the window, such as 0.25 % strain"] = None
    of: Literal["strain", "strength"] = Field(
        "strain", description="What from and to are counted in: strain, or the largest stress"
    )
    straight: Share = Field(0.9998, description="Least r^2 of the line, where no window is stated")

    @classmethod
    def find_contradictions(cls, data: Values) -> Iterator[Fault]:
        """Find a window with one end."""
        if ("from" in data) != ("to" in data):
            given_key, missing_key = ("from", "to") if "from" in data else ("to", "from")
            yield Fault.of(
                "protocol.half_window", (given_key,), given=given_key, missing=missing_key
            )


class CurveBlock(Block):
    """Channels of the curve, and its corrections in the order of the keys."""

    force: Snake
    displacement: Snake
    reverse: Reverse | None = Field(
        None,
        description="force, displacement: channels that decrease as the specimen is loaded; an "
        "empty list confirms their signs",
    )
    compliance: MachineCompliance | None = None
    failure: Failure | None = None
    slips: Slips | None = None
    slack: Slack | None = None
    elastic_line: ElasticLine | None = None


class Branches(Block):
    """How the curve is split into loading and unloading branches."""

    channel: Snake = Field(description="Channel whose turning points separate the branches")
    min_stroke: Length = Field(description="Smaller reversals are noise")


FigureName: TypeAlias = Literal[
    "force-displacement",
    "stiffness-lines",
    "stress-strain",
    "wire-shapes",
    "moment-curvature",
    "timeline",
    "marker-quality",
    "uncertainty-budget",
]


class Report(Block):
    """Units and figures of the report."""

    display: dict[str, Text] = Field({}, description="Unit of each quantity, such as force: mN")
    figures: tuple[FigureName, ...] = ()
    style: Literal["page", "journal"] = Field(
        "page", description="Style of figures: as on the page, or with a serif font for a journal"
    )


LotShare: TypeAlias = Annotated[float, Quantity("1", "%", "99 %", minimum=0.5, maximum=0.9999)]


class Groups(Block):
    """How `labpipe report` groups the samples of one type."""

    main: tuple[Text, ...] = Field(
        (),
        description="Results that are shown first; groups are compared by the first of them",
    )
    scaled: bool = Field(False, description="Also plot force / peak force of each sample")
    min_p: Share = Field(
        0.05, description="Spools that differ with a smaller p-value are never pooled"
    )
    max_spool_share: Share = Field(
        0.1,
        description="Spools are pooled only if their share of the variance is significantly below",
    )
    coverage: LotShare = Field(
        LotRule().coverage, description="Share of a lot that must reach its force-limit"
    )
    confidence: LotShare = Field(LotRule().confidence, description="With which it must do so")
    margin: Share | None = Field(
        None, description="Irrelevant difference of two groups, as a share of the first"
    )


def _parse_version(value: object) -> int:
    """Accept the only known version of the file format."""
    if str(value) != "1":
        raise refused("protocol.unknown_version", found=value)
    return 1


Version: TypeAlias = Annotated[Literal[1], BeforeValidator(_parse_version)]


class Protocol(Block):
    """How one kind of test is processed, from its exports to its results."""

    version: Version
    name: FileStem = Field(description="Name of the file without .yaml")
    about: Remark = Field("", description="Purpose, in one line")
    follow_links: bool = Field(
        False, description="Whether exports may be links to files outside the folder of the test"
    )
    sources: dict[Role, Source] = Field(min_length=1)
    specimen: SpecimenBlock = SpecimenBlock()
    rig: Rig = Rig()
    questions: dict[Snake, tuple[Text, ...]] = Field(
        {},
        description="What the test sheet answers in specimen.observed: the valid answers by name",
    )
    markers: Markers | None = None
    align: Align = AlignNone()
    steps: tuple[Step, ...] = ()
    curve: CurveBlock | None = None
    branches: Branches | None = None
    results: tuple[ResultEntry, ...] = Field((), description="In the order of the summary")
    report: Report = Report()
    groups: Groups = Groups()
    plausible: Plausible = Field(
        {}, description="Ranges by kind of dimension; else the shipped ones"
    )
    limits: Limits = Field(LIMITS, description="Differences beyond which a result is doubtful")

    @property
    def channels(self) -> dict[str, ChannelSource]:
        """Return the channels of all sources by name."""
        sources = self.sources.values()
        return {
            name: channel for source in sources for name, channel in source.all_channels.items()
        }

    @field_validator("sources")
    @classmethod
    def _set_roles(cls, sources: dict[Role, Source]) -> dict[Role, Source]:
        return {role: source.with_role(role) for role, source in sources.items()}

    @field_validator("steps")
    @classmethod
    def _set_numbers(cls, steps: tuple[Step, ...]) -> tuple[Step, ...]:
        return tuple(step.numbered(number) for number, step in enumerate(steps))

    @classmethod
    def find_contradictions(cls, data: Values) -> Iterator[Fault]:
        """Find contradictions between the blocks of the protocol."""
        return find_cross_faults(data)
