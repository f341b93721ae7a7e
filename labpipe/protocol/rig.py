"""Blocks of a protocol that describe the rig, the specimen, the markers and the report."""

from __future__ import annotations

from typing import Annotated, Literal, TypeAlias

from pydantic import (
    Field,
    PlainSerializer,
    PlainValidator,
    WithJsonSchema,
)

from labpipe.protocol.block import Block
from labpipe.protocol.faults import error_of
from labpipe.protocol.words import Text
from labpipe.records.setting_types import (
    Above,
    Area,
    Compliance,
    Distance,
    Drift,
    Duration,
    Force,
    Key,
    Length,
    Mass,
    Moment,
    Offset,
    Ratio,
    Share,
    Snake,
    Speed,
    Whole,
)


class Section(Block):
    """Cross-section of the specimen; give what is known."""

    outer_diameter: Length | None = None
    inner_diameter: Length | None = None
    wall: Length | None = None
    width: Length | None = None
    thickness: Length | None = None
    area: Area | None = None


class SpecimenBlock(Block):
    """Dimensions that all specimens of the protocol share."""

    length: Length | None = Field(None, description="Free length; a test sheet can give its own")
    span: Length | None = Field(None, description="Distance of the supports")
    section: Section | None = None


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
    cycles: Annotated[int, Whole(1, 1_000_000)] | None = None
    string: LoadString | None = None


def _all_or_names(value: object) -> object:
    if value == "all":
        return value
    names = value if isinstance(value, list | tuple) else [value]
    if not names or not all(isinstance(name, str) and name for name in names):
        raise error_of(expected="the word 'all', or a list of marker names", found=value)
    return tuple(names)


Along: TypeAlias = Annotated[
    Literal["all"] | tuple[str, ...],
    PlainValidator(_all_or_names),
    PlainSerializer(lambda names: names if isinstance(names, str) else list(names)),
    WithJsonSchema({"anyOf": [{"type": "string"}, {"type": "array", "items": {"type": "string"}}]}),
]


class Markers(Block):
    """What the markers of a take stand for."""

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
    uncertainty: Ratio = Field(0.0, description="Standard uncertainty, as a share of the value")


class Failure(Block):
    """When a specimen counts as broken: the force is lost at once and does not come back."""

    force_below: Share = Field(description="Share of the largest force, such as 50 %")
    loss: Share = Field(0.1, description="Share of the largest force that the loss takes at least")
    within: Duration = Field(
        0.05, description="In this time, or in one step between samples where that is longer"
    )


class Slips(Block):
    """What is done where the specimen slides in its grips."""

    decision: Literal["marked", "repaired", "cut"] = Field(
        description="marked: noted; repaired: the lost force is added back; cut: the curve ends"
    )
    min_drop: Force = Field(description="Smaller losses of force are not looked at")


class Slack(Block):
    """Toe compensation: where a line through the steep part meets zero force, travel begins."""

    start: Annotated[Share, Key("from"), "Of the largest force, such as 10 %"]
    stop: Annotated[Share, Key("to"), Above("start"), "Of the largest force, such as 30 %"]


def _words_once(value: object) -> object:
    words = value if isinstance(value, list | tuple) else None
    if words is None or set(words) - {"force", "displacement"} or len(set(words)) < len(words):
        raise error_of(expected="a list of 'force' and 'displacement', or of neither", found=value)
    return tuple(words)


Reverse: TypeAlias = Annotated[
    tuple[Literal["force", "displacement"], ...],
    PlainValidator(_words_once),
    PlainSerializer(list),
    WithJsonSchema(
        {
            "type": "array",
            "items": {"enum": ["force", "displacement"]},
            "uniqueItems": True,
        }
    ),
]


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
]


class Report(Block):
    """What people get to see."""

    display: dict[str, Text] = Field({}, description="Unit of each quantity, such as force: mN")
    figures: tuple[FigureName, ...] = ()


class Groups(Block):
    """How `labpipe report` puts the samples of one type together."""

    main: tuple[Text, ...] = Field((), description="Names of the results that are shown first")
    scaled: bool = Field(False, description="Also draw force / peak force of each sample")
    min_p: Share = Field(0.05, description="Spools that differ with a smaller p are never pooled")
    max_spool_share: Share = Field(
        0.1,
        description="Pool spools only when their share of the variance is surely below",
    )
    margin: Share | None = Field(
        None, description="Difference of two groups that does not matter, as a share of the first"
    )
