"""The grammar of a protocol: rig, specimen, markers, clocks, curve and report, and the whole."""

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
from labpipe.protocol.cross_checks import cross_faults
from labpipe.protocol.grammar import Block
from labpipe.protocol.source import (
    ChannelSource,
    Plausible,
    Role,
    Section,
    SizeUncertainties,
    Source,
)
from labpipe.protocol.values import FileStem, OrShort, Remark, Text
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

    length: Length | None = Field(None, description="Free length; a test sheet can give its own")
    gauge_length: Length | None = Field(
        None, description="Of the extensometer whose channel is the displacement of the curve"
    )
    span: Length | None = Field(None, description="Distance of the supports")
    mass_per_length: LinearMass | None = Field(
        None, description="Bends a cantilever by its weight; left out where it is not given"
    )
    section: Section | None = None
    uncertainty: SizeUncertainties | None = Field(
        None, description="Standard uncertainties of these sizes; a test sheet can give its own"
    )

    @field_validator("uncertainty")
    @classmethod
    def _is_less_than_the_size(cls, sizes: Any, info: ValidationInfo) -> Any:
        known = {**vars(info.data.get("section") or Section()), **info.data}
        faults = [
            Fault.of("protocol.size_unknown", (key,), key=key)
            for key, uncertainty in (sizes.stated if sizes else {}).items()
            if uncertainty >= (known.get(key) or math.inf)
        ]
        if faults:
            raise FaultsError(*faults)
        return sizes


class LoadString(Block):
    """The string between specimen and load cell."""

    length: Length
    counterweight: Mass = Field(0.0, description="Hangs at the tip")
    at_rest: Literal["by-data", "taut", "slack"] = Field(
        "by-data", description="Whether the string carried the counterweight before the test"
    )


class Rig(Block):
    """What the machine was told to do; a check on the recordings, never a measurement."""

    crosshead_speed: Speed | None = None
    stroke: Length | None = None
    cycles: Annotated[int, WholeNumber(1, 1_000_000)] | None = None
    string: LoadString | None = None


def _all_or_names(value: object) -> object:
    if value == "all":
        return value
    names = value if isinstance(value, list | tuple) else [value]
    if not names or not all(isinstance(name, str) and name for name in names):
        raise refused("protocol.no_markers", found=value)
    return tuple(names)


Along: TypeAlias = Annotated[
    Literal["all"] | tuple[str, ...],
    OrShort(_all_or_names, {"type": "string"}),
]


class Markers(Block):
    """Positions of the markers of a take on the specimen."""

    clamp: Text | None = Field(description="Rigid body at the clamped end; null if there is none")
    along: Along = Field(
        "all", description="Markers along the specimen: all, or a list of names and patterns"
    )
    rings: Literal["none", "by-body"] = Field(
        "none", description="by-body: markers of one body stand for the centre of their ring"
    )
    grip_offset: Offset = Field(0.0, description="Pivot of the clamp to the clamped end")
    pull_offset: Distance = Field(0.0, description="Last marker to the string, along the specimen")
    centre_offset: Offset = Field(0.0, description="Axis to marker centre, towards the pull")
    offset_uncertainty: Distance = Field(
        0.0, description="Standard uncertainty of grip_offset, and that of pull_offset"
    )
    centre_uncertainty: Distance = Field(0.0, description="Standard uncertainty of centre_offset")


class AlignNone(Block):
    """One clock: nothing to align."""

    method: Literal["none"] = "none"


class AlignTurningPoints(Block):
    """Two clocks, joined at the turning points that both saw."""

    method: Literal["turning-points"]
    channel: Snake = Field(description="Channel whose corners mark the turning points")
    motion_window: Duration = Field(description="On each side of a turning point of the clamp")
    force_window: Duration = Field(description="On each side of a corner of the channel")
    max_residual: Duration = Field(description="Doubtful above")
    max_drift: Ratio = Field(description="Doubtful above")


class AlignCommonStart(Block):
    """Two recorders that were started together; the force's corner at the turn checks it."""

    method: Literal["common-start"]
    channel: Snake = Field(description="Channel whose corner marks the turn")
    max_offset: Duration = Field(description="The later recorder starts no later than this")
    max_drift: Ratio = Field(1e-4, description="How far the clocks may differ in rate")
    motion_window: Duration = Field(10.0, description="On each side of a turn of the motion")
    force_window: Duration = Field(1.0, description="On each side of a corner of the channel")


class AlignStated(Block):
    """Clocks that somebody has compared: force time = offset + (1 + drift) x motion time."""

    method: Literal["stated"]
    channel: Snake | None = Field(
        None, description="A channel on the clock of the force; that of the curve if left out"
    )
    offset: Moment = Field(description="Time of the force at time zero of the motion")
    drift: Drift = Field(0.0, description="By how much the clock of the force runs faster")
    uncertainty: Duration | None = Field(
        None, description="Standard uncertainty of the offset; one sample if left out"
    )
    because: Text = Field(description="Where the offset comes from")
    motion_window: Duration = Field(10.0, description="On each side of a turn of the motion")


Align: TypeAlias = Annotated[
    AlignNone | AlignTurningPoints | AlignCommonStart | AlignStated, Field(discriminator="method")
]


class MachineCompliance(Block):
    """How far frame and grips give way; times the force, it is taken off the displacement."""

    value: Compliance = Field(description="From a test of a stiff bar, protocol stiff-bar")
    uncertainty: Uncertainty = Field(
        0.0, description="Standard uncertainty, as a share of the value"
    )


class Failure(Block):
    """When a specimen counts as broken: the force is lost at once and does not come back."""

    force_below: Share = Field(description="Share of the largest force, such as 50 %")
    loss: Share = Field(0.1, description="Share of the largest force that the loss takes at least")
    within: Duration = Field(
        0.05, description="In this time, or in one step between samples where that is longer"
    )
    at_end_below: Share | None = Field(
        None,
        description="A record whose force ends below this share of the largest ends with the break",
    )


class Slips(Block):
    """What is done where the specimen slides in its grips."""

    decision: Literal["marked", "repaired", "cut"] = Field(
        description="marked: noted; repaired: the lost force is added back; cut: the curve ends"
    )
    min_drop: Force = Field(description="Smaller losses of force are ignored")


class Slack(Block):
    """Toe compensation: where a line through the steep part meets zero force, travel begins."""

    start: Annotated[Share, Key("from"), "Of the largest force, such as 10 %"]
    stop: Annotated[
        Share, Key("to"), LargerThan("start", "from"), "Of the largest force, such as 30 %"
    ]


def _words_once(value: object) -> object:
    words = value if isinstance(value, list | tuple) else [None]
    if any(words.count(word) > 1 or word not in ("force", "displacement") for word in words):
        raise refused("protocol.no_reverse", found=value)
    return tuple(words)


Reverse: TypeAlias = Annotated[
    tuple[Literal["force", "displacement"], ...], BeforeValidator(_words_once)
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
    def between(cls, data: Values) -> Iterator[Fault]:
        """Find a window with one end."""
        if ("from" in data) != ("to" in data):
            given, missing = ("from", "to") if "from" in data else ("to", "from")
            yield Fault.of("protocol.half_window", (given,), given=given, missing=missing)


class CurveBlock(Block):
    """Which channels make the curve, and how it is corrected: in the order of the keys."""

    force: Snake
    displacement: Snake
    reverse: Reverse | None = Field(
        None,
        description="force, displacement: channels that count down as the specimen is loaded; an "
        "empty list says that their signs are meant",
    )
    compliance: MachineCompliance | None = None
    failure: Failure | None = None
    slips: Slips | None = None
    slack: Slack | None = None
    elastic_line: ElasticLine | None = None


class Branches(Block):
    """How the curve is cut into loading and unloading."""

    channel: Snake = Field(description="Channel whose turning points part the branches")
    min_stroke: Length = Field(description="Smaller movements back and forth are noise")


FigureName: TypeAlias = Literal[
    "force-displacement",
    "stiffness-lines",
    "wire-shapes",
    "moment-curvature",
    "timeline",
    "marker-quality",
    "uncertainty-budget",
]


class Report(Block):
    """What people get to see."""

    display: dict[str, Text] = Field({}, description="Unit of each quantity, such as force: mN")
    figures: tuple[FigureName, ...] = ()
    style: Literal["page", "journal"] = Field(
        "page", description="Look of figures: as the page, or with serif letters for a journal"
    )


LotShare: TypeAlias = Annotated[float, Quantity("1", "%", "99 %", minimum=0.5, maximum=0.9999)]


class Groups(Block):
    """How `labpipe report` puts the samples of one type together."""

    main: tuple[Text, ...] = Field(
        (),
        description="Results that are shown first; the first of them answers how groups differ",
    )
    scaled: bool = Field(False, description="Also draw force / peak force of each sample")
    min_p: Share = Field(0.05, description="Spools that differ with a smaller p are never pooled")
    max_spool_share: Share = Field(
        0.1,
        description="Pool spools only when their share of the variance is surely below",
    )
    coverage: LotShare = Field(
        LotRule().coverage, description="Share of a lot that must reach its force-limit"
    )
    confidence: LotShare = Field(LotRule().confidence, description="With which it must do so")
    margin: Share | None = Field(
        None, description="Difference of two groups that does not matter, as a share of the first"
    )


def _known_version(value: object) -> int:
    """Take the version of a file, if this labpipe knows it."""
    if str(value) != "1":
        raise refused("protocol.unknown_version", found=value)
    return 1


Version: TypeAlias = Annotated[Literal[1], BeforeValidator(_known_version)]


class Protocol(Block):
    """How one kind of test is processed, from its exports to its results."""

    version: Version
    name: FileStem = Field(description="As the file is called, without .yaml")
    about: Remark = Field("", description="What it is for, in one line")
    follow_links: bool = Field(
        False, description="Whether exports may be links out of the folder of the test"
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
    plausible: Plausible = Field({}, description="Range of each kind of dimension; else shipped")
    limits: Limits = Field(LIMITS, description="Differences beyond which a number is doubtful")

    @property
    def channels(self) -> dict[str, ChannelSource]:
        """Return the channels of all sources by name."""
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
    def between(cls, data: Values) -> Iterator[Fault]:
        """Check one part of the protocol against another."""
        return cross_faults(data)
