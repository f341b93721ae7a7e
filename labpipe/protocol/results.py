"""Results of a protocol: the numbers that are taken from the curve and the shape."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import Annotated, Final, Literal, TypeAlias

from pydantic import Field, field_validator

from labpipe.protocol.block import Block
from labpipe.protocol.faults import Fault
from labpipe.protocol.quantities import (
    Curvature,
    Distance,
    Force,
    Length,
    Ratio,
    Share,
    behind_start,
)
from labpipe.protocol.words import Snake


class ClockResult(Block):
    """``clock_offset`` (s) and ``clock_drift`` (1) of the two clocks."""

    result: Literal["clock"]


class PeakForce(Block):
    """``peak_force.<cycle>`` (N)."""

    result: Literal["peak-force"]


class PeakDisplacement(Block):
    """``peak_displacement.<cycle>`` (m)."""

    result: Literal["peak-displacement"]


class _Window(Block):
    """A stretch of displacement."""

    result: str
    start: Distance = Field(alias="from")
    stop: Distance = Field(alias="to")

    _behind_start = field_validator("stop")(behind_start(Distance))


class InitialStiffness(_Window):
    """``initial_stiffness`` (N/m): slope at the start of the first loading."""

    result: Literal["initial-stiffness"]


class Stiffness(_Window):
    """A straight line (N/m) over a window of the first loading, under a name of its own."""

    result: Literal["stiffness"]
    name: Snake = Field("stiffness", description="Such as stiffness_first")


class UnloadingStiffness(Block):
    """``unloading_stiffness.<cycle>`` (N/m): slope just after each turn."""

    result: Literal["unloading-stiffness"]
    over: Length


class Energy(Block):
    """``energy.<cycle>`` (J): dissipated over one cycle."""

    result: Literal["energy"]


class ResidualDisplacement(Block):
    """``residual_displacement.<cycle>`` (m): what is left when the force is gone."""

    result: Literal["residual-displacement"]
    force_below: Force


class TipTravel(Block):
    """``tip_travel`` (m): how far the tip moves from where it began."""

    result: Literal["tip-travel"]


class MomentCurvature(Block):
    """``<name>`` (N m^2): bending stiffness by the measured moment-curvature law."""

    result: Literal["moment-curvature"]
    at: Curvature = Field(description="Curvature of the first loading")
    kind: Literal["secant", "tangent"] = Field(
        "secant", description="secant: moment / curvature; tangent: slope of the law"
    )
    name: Snake = Field("bending_stiffness", description="Such as bending_stiffness_at_20")


class MidSpan(_Window):
    """``mid_span_bending_stiffness`` (N m^2) and ``mid_span_curvature`` (1/m) of a bent span."""

    result: Literal["mid-span"]
    corrections: tuple[Literal["large-deflection"], ...] = Field(
        (), description="large-deflection: the supports push along the specimen as well"
    )


class Twist(Block):
    """``twist`` (rad): how far the section at mid-span has turned about the axis."""

    result: Literal["twist"]


class Kink(_Window):
    """``kink_displacement`` (m) and ``kink_force`` (N): where first loading gets less steep."""

    result: Literal["kink"]


class Plateau(Block):
    """``end_slope`` (1); where it is small also ``plateau_displacement`` (m), ``plateau_force``."""

    result: Literal["plateau"]
    slope_below: Share = Field(description="Share of the initial slope, such as 10 %")
    of: Snake = Field(
        "initial_stiffness", description="Name of the stiffness above that is the initial slope"
    )
    over: Length = Field(0.005, description="Stretch that a tangent is read from")


class LoadingStiffness(Block):
    """``loading_stiffness.<cycle>`` (N/m): slope just after the force takes up."""

    result: Literal["loading-stiffness"]
    over: Length


class Hardening(Block):
    """``hardening.<cycle>`` (1) of later cycles: ``loading_stiffness`` over that of the first."""

    result: Literal["hardening"]
    over: Length


class Roller(Block):
    """The rollers of two supports."""

    diameter: Length | None = None
    friction: Ratio | None = Field(None, description="Coefficient, of rollers that do not turn")


class BendingStiffness(Block):
    """``<name>`` (N m^2): bending stiffness EI of a beam, from a stiffness and its length."""

    result: Literal["bending-stiffness"]
    of: Snake = Field(description="Name of a stiffness above, such as initial_stiffness")
    support: Literal["cantilever", "three-point"] = Field(
        description="cantilever: K L^3 / 3, L specimen.length; three-point: K L^3 / 48, L the span"
    )
    length_uncertainty: Distance = Field(0.0, description="Standard uncertainty of L")
    name: Snake = Field("bending_stiffness", description="Such as bending_stiffness_at_start")
    corrections: tuple[Literal["large-deflection", "roller-radius", "roller-friction"], ...] = (
        Field((), description="Of three-point: what an exactly bent elastic beam does otherwise")
    )
    roller: Roller | None = None

    @classmethod
    def between(cls, data: object) -> list[Fault]:
        """Refuse a correction without what it is made of."""
        return list(_correction_faults(data)) if isinstance(data, Mapping) else []


def _correction_faults(entry: Mapping[str, object]) -> Iterator[Fault]:
    said = entry.get("corrections")
    names = said if isinstance(said, list | tuple) else []
    if names and entry.get("support") == "cantilever":
        expected = "corrections for 'three-point' alone"
        yield Fault(("corrections",), expected, "'cantilever'", "Remove them.")
        return
    roller = entry.get("roller")
    for name, key in (("roller-radius", "diameter"), ("roller-friction", "friction")):
        if name not in names:
            continue
        if "large-deflection" not in names:
            remedy = "Add 'large-deflection' to the corrections."
            expected = f"'large-deflection' beside {name!r}"
            yield Fault(("corrections",), expected, "none", remedy)
        if not isinstance(roller, Mapping) or roller.get(key) is None:
            remedy = f"Add 'roller: {{{key}: ...}}'."
            yield Fault(("corrections",), f"'roller.{key}' for {name!r}", "none", remedy)


class TwoSegments(_Window):
    """``segment_stiffness_first``, ``segment_stiffness_second`` (N/m) and ``break_point`` (m)."""

    result: Literal["two-segments"]


class NormalisedStiffness(Block):
    """``<of>_per_peak_force`` (1/m): a stiffness over the largest force of the same sample."""

    result: Literal["normalised-stiffness"]
    of: Snake = Field(description="Name of a stiffness above, such as stiffness_first")


class Modulus(Block):
    """``<name>`` (Pa): stiffness x gauge length / area."""

    result: Literal["modulus"]
    of: Snake = Field(description="Name of a stiffness above, such as stiffness")
    area: Literal["stated", "rectangle", "annulus", "thin-wall"] = Field(
        description="Which area of specimen.section it refers to"
    )
    name: Snake = Field("modulus", description="Such as modulus_annulus")


class FailureResult(Block):
    """``failure_displacement`` (m) and ``failure_force`` (N)."""

    result: Literal["failure"]


class EnergyToBreak(Block):
    """``energy_to_break`` (J): work done up to the failure."""

    result: Literal["energy-to-break"]


class SlipResults(Block):
    """``slip_position.<n>`` (m) and ``slip_drop.<n>`` (N); no result where nothing slipped."""

    result: Literal["slips"]


class SlackResult(Block):
    """``slack`` (m): displacement before the specimen is taut."""

    result: Literal["slack"]


class ComplianceResult(Block):
    """``compliance`` (m/N) of frame and grips, from a test of a stiff bar."""

    result: Literal["compliance"]
    start: Force = Field(alias="from")
    stop: Force = Field(alias="to")

    _behind_start = field_validator("stop")(behind_start(Force))


ResultEntry: TypeAlias = Annotated[
    ClockResult
    | PeakForce
    | PeakDisplacement
    | InitialStiffness
    | UnloadingStiffness
    | Energy
    | ResidualDisplacement
    | Stiffness
    | TwoSegments
    | NormalisedStiffness
    | Modulus
    | FailureResult
    | EnergyToBreak
    | SlipResults
    | SlackResult
    | ComplianceResult
    | TipTravel
    | Kink
    | Plateau
    | LoadingStiffness
    | Hardening
    | BendingStiffness
    | MomentCurvature
    | MidSpan
    | Twist,
    Field(discriminator="result"),
]

_FIXED_NAMES: Final = MappingProxyType(
    {
        "clock": ("clock_offset", "clock_drift"),
        "peak-force": ("peak_force.1",),
        "peak-displacement": ("peak_displacement.1",),
        "initial-stiffness": ("initial_stiffness",),
        "unloading-stiffness": ("unloading_stiffness.1",),
        "energy": ("energy.1",),
        "residual-displacement": ("residual_displacement.1",),
        "two-segments": ("segment_stiffness_first", "segment_stiffness_second", "break_point"),
        "failure": ("failure_displacement", "failure_force"),
        "energy-to-break": ("energy_to_break",),
        "slips": ("slip_position.1", "slip_drop.1"),
        "slack": ("slack",),
        "compliance": ("compliance",),
        "tip-travel": ("tip_travel",),
        "kink": ("kink_displacement", "kink_force"),
        "plateau": ("end_slope", "plateau_displacement", "plateau_force"),
        "loading-stiffness": ("loading_stiffness.1",),
        "hardening": ("hardening.2",),
        "mid-span": ("mid_span_bending_stiffness", "mid_span_curvature"),
        "twist": ("twist",),
    }
)


def result_names(tag: str, entry: Mapping[str, object]) -> tuple[str, ...]:
    """List what an entry is called in the summary; of several cycles or slips, the first.

    Parameters
    ----------
    tag : such as ``two-segments``
    entry : the block as written, which may give a name of its own
    """
    if tag == "normalised-stiffness":
        return (f"{entry.get('of')}_per_peak_force",)
    if tag in ("moment-curvature", "bending-stiffness"):
        return (str(entry.get("name", "bending_stiffness")),)
    if tag in ("stiffness", "modulus"):
        return (str(entry.get("name", tag)),)
    return _FIXED_NAMES.get(tag, ())
