"""Steps of a protocol: what is done to the recordings, in order."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Annotated, ClassVar, Final, Literal, Self, TypeAlias

from labpipe.records.declarations import (
    ChannelName,
    Duration,
    Frequency,
    Length,
    Ratio,
    Snake,
    Span,
    Tagged,
    Whole,
    kinds_of,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Step:
    """One step, and where it stands in the list, which is no setting.

    It may work on markers, come after another step, and make channels.
    """

    on_markers: ClassVar = False
    after: ClassVar = ""
    makes: ClassVar[tuple[str, ...]] = ()
    number: int = field(default=0, compare=False)

    @property
    def key(self) -> str:
        """Dotted key of the step, as an override begins: ``steps.2``."""
        return f"steps.{self.number}"

    def numbered(self, number: int) -> Self:
        """Give back the same step, knowing its number in the list as written, from 0."""
        return replace(self, number=number)


@dataclass(frozen=True, slots=True, kw_only=True)
class RepairMarkers(_Step):
    """Undo label switches, fill short gaps, flag what was touched."""

    step: ClassVar = "repair-markers"
    on_markers: ClassVar = True
    max_gap: Annotated[Duration, "Longer gaps stay gaps"]
    max_jump: Annotated[Length, "Farther than a marker moves between two frames"]
    frozen: Annotated[Duration, "A track that stands still for longer is lost"]


@dataclass(frozen=True, slots=True, kw_only=True)
class SpecimenFrame(_Step):
    """Turn the markers into the frame of the specimen; with a clamp, this makes `travel`."""

    step: ClassVar = "specimen-frame"
    on_markers: ClassVar = True
    makes: ClassVar = ("travel",)
    over: Annotated[Duration, "Stretch at the start that defines the straight specimen"]
    max_out_of_plane: Annotated[Length, "Doubtful when the markers leave a plane by more, rms"] = (
        0.001
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class FitShape(_Step):
    """Fit a smooth curve through the markers of every frame; this makes `deflection`."""

    step: ClassVar = "fit-shape"
    on_markers: ClassVar = True
    after: ClassVar = "specimen-frame"
    makes: ClassVar = ("deflection",)
    terms: Annotated[int, Whole(2, 12)]
    tip: Annotated[Literal["free", "loaded"], "free: no bending moment at the tip"]


@dataclass(frozen=True, slots=True, kw_only=True)
class ThreePointShape(_Step):
    """Fit the bent axis between two supports through sections of markers; makes `mid_span`."""

    step: ClassVar = "three-point-shape"
    on_markers: ClassVar = True
    after: ClassVar = "repair-markers"
    makes: ClassVar = ("mid_span",)
    over: Annotated[Duration, "Stretch at the start in which the specimen is straight"]
    section: Annotated[
        Length, "Markers nearer to each other than this, along the axis, share a section"
    ] = 0.004
    facing: Annotated[
        Literal["side", "load", "away"],
        "Where on the specimen the markers are: across the load, where the load goes to, or where "
        "it comes from",
    ] = "side"


@dataclass(frozen=True, slots=True, kw_only=True)
class TravelFromSpeed(_Step):
    """Make a displacement from crosshead speed and stroke; a measured one overrides it."""

    step: ClassVar = "travel-from-speed"
    makes: ClassVar = ("{channel}",)
    channel: Annotated[Snake, "Displacement that it makes where no source gives one"]
    force: Annotated[ChannelName, "Channel in which the turn is looked for"]
    window: Annotated[Duration, "On each side of the force's corner at the turn"] = 1.0
    rate: Annotated[Frequency, "How often the displacement is made"] = 50.0
    speed_uncertainty: Annotated[Ratio, "Standard uncertainty of rig's speed"] = 0.005


@dataclass(frozen=True, slots=True, kw_only=True)
class Zero(_Step):
    """Subtract the mean of a stretch without load."""

    step: ClassVar = "zero"
    channel: ChannelName
    over: Duration
    at: Literal["start", "end"] = "start"
    by: Annotated[
        Literal["mean", "line"],
        "line: what a straight line through the stretch says of its outer end, for machines that "
        "move from the first sample on",
    ] = "mean"


@dataclass(frozen=True, slots=True, kw_only=True)
class Smooth(_Step):
    """Smooth by a centred moving average."""

    step: ClassVar = "smooth"
    channel: ChannelName
    method: Literal["moving-average"]
    span: Span


@dataclass(frozen=True, slots=True, kw_only=True)
class LowPass(_Step):
    """Smooth by a zero-phase Butterworth filter."""

    step: ClassVar = "low-pass"
    channel: ChannelName
    cutoff: Frequency
    order: Annotated[int, Whole(1, 8)]


@dataclass(frozen=True, slots=True, kw_only=True)
class Decimate(_Step):
    """Keep every so many samples."""

    step: ClassVar = "decimate"
    channel: ChannelName
    factor: Annotated[int, Whole(2, 100_000)]
    method: Literal["filtered", "stride"] = "filtered"


Step: TypeAlias = Annotated[
    RepairMarkers
    | SpecimenFrame
    | FitShape
    | ThreePointShape
    | TravelFromSpeed
    | Zero
    | Smooth
    | LowPass
    | Decimate,
    Tagged("step"),
]

STEPS: Final = kinds_of(Step)
"""The kinds of steps by their word in YAML."""
