"""Steps of a protocol: what is done to the recordings, in order."""

from __future__ import annotations

from typing import Annotated, Literal, Self, TypeAlias

from pydantic import Field, PrivateAttr

from labpipe.protocol.block import Block
from labpipe.protocol.quantities import (
    Duration,
    Frequency,
    Length,
    Ratio,
    SpanOf,
    Whole,
)
from labpipe.protocol.words import Snake


class _Step(Block):
    """One step, and where it stands in the list."""

    _number: int = PrivateAttr(0)

    @property
    def key(self) -> str:
        """Dotted key of the step, as an override begins: ``steps.2``."""
        return f"steps.{self._number}"

    def numbered(self, number: int) -> Self:
        """Give back the same step, knowing its number in the list as written, from 0."""
        step = self.model_copy()
        step._number = number
        return step


class RepairMarkers(_Step):
    """Undo label switches, fill short gaps, flag what was touched."""

    step: Literal["repair-markers"]
    max_gap: Duration = Field(description="Longer gaps stay gaps")
    max_jump: Length = Field(description="Farther than a marker moves between two frames")
    frozen: Duration = Field(description="A track that stands still for longer is lost")


class SpecimenFrame(_Step):
    """Turn the markers into the frame of the specimen; with a clamp, this makes `travel`."""

    step: Literal["specimen-frame"]
    over: Duration = Field(description="Stretch at the start that defines the straight specimen")
    max_out_of_plane: Length = Field(
        0.001, description="Doubtful when the markers leave a plane by more, rms"
    )


class FitShape(_Step):
    """Fit a smooth curve through the markers of every frame; this makes `deflection`."""

    step: Literal["fit-shape"]
    terms: Annotated[int, Whole(2, 12)]
    tip: Literal["free", "loaded"] = Field(description="free: no bending moment at the tip")


class ThreePointShape(_Step):
    """Fit the bent axis between two supports through sections of markers; makes `mid_span`."""

    step: Literal["three-point-shape"]
    over: Duration = Field(description="Stretch at the start in which the specimen is straight")
    section: Length = Field(
        0.004, description="Markers nearer to each other than this, along the axis, share a section"
    )
    facing: Literal["side", "load", "away"] = Field(
        "side",
        description="Where on the specimen the markers are: across the load, where the load goes "
        "to, or where it comes from",
    )


class TravelFromSpeed(_Step):
    """Make a displacement from crosshead speed and stroke; a measured one goes before it."""

    step: Literal["travel-from-speed"]
    channel: Snake = Field(description="Displacement that it makes where no source gives one")
    force: Snake = Field(description="Channel in which the turn is looked for")
    window: Duration = Field(1.0, description="On each side of the force's corner at the turn")
    rate: Frequency = Field(50.0, description="How often the displacement is made")
    speed_uncertainty: Ratio = Field(0.005, description="Standard uncertainty of rig's speed")


class Zero(_Step):
    """Subtract the mean of a stretch without load."""

    step: Literal["zero"]
    channel: Snake
    over: Duration
    at: Literal["start", "end"] = "start"
    by: Literal["mean", "line"] = Field(
        "mean",
        description="line: what a straight line through the stretch says of its outer end, for "
        "machines that move from the first sample on",
    )


class Smooth(_Step):
    """Smooth by a centred moving average."""

    step: Literal["smooth"]
    channel: Snake
    method: Literal["moving-average"]
    span: SpanOf


class LowPass(_Step):
    """Smooth by a zero-phase Butterworth filter."""

    step: Literal["low-pass"]
    channel: Snake
    cutoff: Frequency
    order: Annotated[int, Whole(1, 8)]


class Decimate(_Step):
    """Keep every so many samples."""

    step: Literal["decimate"]
    channel: Snake
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
    Field(discriminator="step"),
]
