"""Results of a protocol: the numbers that are taken from the curve and the shape."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Annotated, ClassVar, Final, Literal, TypeAlias

from labpipe.errors import Fault
from labpipe.records.setting_types import (
    Above,
    Curvature,
    Distance,
    Force,
    Key,
    Length,
    Ratio,
    Share,
    Snake,
    StiffnessName,
    Tagged,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class ClockResult:
    """``clock_offset`` (s) and ``clock_drift`` (1) of the two clocks."""

    result: ClassVar = "clock"


@dataclass(frozen=True, slots=True, kw_only=True)
class PeakForce:
    """``peak_force.<cycle>`` (N)."""

    result: ClassVar = "peak-force"


@dataclass(frozen=True, slots=True, kw_only=True)
class PeakDisplacement:
    """``peak_displacement.<cycle>`` (m)."""

    result: ClassVar = "peak-displacement"


@dataclass(frozen=True, slots=True, kw_only=True)
class Window:
    """A stretch of displacement."""

    start: Annotated[Distance, Key("from")]
    stop: Annotated[Distance, Key("to"), Above("start")]


@dataclass(frozen=True, slots=True, kw_only=True)
class InitialStiffness(Window):
    """``initial_stiffness`` (N/m): slope at the start of the first loading."""

    result: ClassVar = "initial-stiffness"


@dataclass(frozen=True, slots=True, kw_only=True)
class Stiffness(Window):
    """A straight line (N/m) over a window of the first loading, under a name of its own."""

    result: ClassVar = "stiffness"
    name: Annotated[Snake, "Such as stiffness_first"] = "stiffness"


@dataclass(frozen=True, slots=True, kw_only=True)
class UnloadingStiffness:
    """``unloading_stiffness.<cycle>`` (N/m): slope just after each turn."""

    result: ClassVar = "unloading-stiffness"
    over: Length


@dataclass(frozen=True, slots=True, kw_only=True)
class Energy:
    """``energy.<cycle>`` (J): dissipated over one cycle."""

    result: ClassVar = "energy"


@dataclass(frozen=True, slots=True, kw_only=True)
class ResidualDisplacement:
    """``residual_displacement.<cycle>`` (m): what is left when the force is gone."""

    result: ClassVar = "residual-displacement"
    force_below: Force


@dataclass(frozen=True, slots=True, kw_only=True)
class TipTravel:
    """``tip_travel`` (m): how far the tip moves from where it began."""

    result: ClassVar = "tip-travel"


@dataclass(frozen=True, slots=True, kw_only=True)
class MomentCurvature:
    """``<name>`` (N m^2): bending stiffness by the measured moment-curvature law."""

    result: ClassVar = "moment-curvature"
    at: Annotated[Curvature, "Curvature of the first loading"]
    kind: Annotated[
        Literal["secant", "tangent"], "secant: moment / curvature; tangent: slope of the law"
    ] = "secant"
    name: Annotated[Snake, "Such as bending_stiffness_at_20"] = "bending_stiffness"


@dataclass(frozen=True, slots=True, kw_only=True)
class MidSpan(Window):
    """``mid_span_bending_stiffness`` (N m^2) and ``mid_span_curvature`` (1/m) of a bent span."""

    result: ClassVar = "mid-span"
    corrections: Annotated[
        tuple[Literal["large-deflection"], ...],
        "large-deflection: the supports push along the specimen as well",
    ] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Twist:
    """``twist`` (rad): how far the section at mid-span has turned about the axis."""

    result: ClassVar = "twist"


@dataclass(frozen=True, slots=True, kw_only=True)
class Kink(Window):
    """``kink_displacement`` (m) and ``kink_force`` (N): where first loading gets less steep."""

    result: ClassVar = "kink"


@dataclass(frozen=True, slots=True, kw_only=True)
class Plateau:
    """``end_slope`` (1); where it is small also ``plateau_displacement`` (m), ``plateau_force``."""

    result: ClassVar = "plateau"
    slope_below: Annotated[Share, "Share of the initial slope, such as 10 %"]
    of: Annotated[StiffnessName, "Name of the stiffness above that is the initial slope"] = (
        "initial_stiffness"
    )
    over: Annotated[Length, "Stretch that a tangent is read from"] = 0.005


@dataclass(frozen=True, slots=True, kw_only=True)
class LoadingStiffness:
    """``loading_stiffness.<cycle>`` (N/m): slope just after the force takes up."""

    result: ClassVar = "loading-stiffness"
    over: Length


@dataclass(frozen=True, slots=True, kw_only=True)
class Hardening:
    """``hardening.<cycle>`` (1) of later cycles: ``loading_stiffness`` over that of the first."""

    result: ClassVar = "hardening"
    over: Length


@dataclass(frozen=True, slots=True, kw_only=True)
class Roller:
    """The rollers of two supports."""

    diameter: Length | None = None
    friction: Annotated[Ratio | None, "Coefficient, of rollers that do not turn"] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class BendingStiffness:
    """``<name>`` (N m^2): bending stiffness EI of a beam, from a stiffness and its length."""

    result: ClassVar = "bending-stiffness"
    of: Annotated[StiffnessName, "Name of a stiffness above, such as initial_stiffness"]
    support: Annotated[
        Literal["cantilever", "three-point"],
        "cantilever: K L^3 / 3, L specimen.length; three-point: K L^3 / 48, L the span",
    ]
    length_uncertainty: Annotated[Distance, "Standard uncertainty of L"] = 0.0
    name: Annotated[Snake, "Such as bending_stiffness_at_start"] = "bending_stiffness"
    corrections: Annotated[
        tuple[Literal["large-deflection", "roller-radius", "roller-friction"], ...],
        "Of three-point: what an exactly bent elastic beam does otherwise",
    ] = ()
    roller: Roller | None = None

    @staticmethod
    def between(entry: Mapping[str, object]) -> Iterator[Fault]:
        """Refuse a correction without what it is made of."""
        yield from _correction_faults(entry)


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


@dataclass(frozen=True, slots=True, kw_only=True)
class TwoSegments(Window):
    """``segment_stiffness_first``, ``segment_stiffness_second`` (N/m) and ``break_point`` (m)."""

    result: ClassVar = "two-segments"


@dataclass(frozen=True, slots=True, kw_only=True)
class NormalisedStiffness:
    """``<of>_per_peak_force`` (1/m): a stiffness over the largest force of the same sample."""

    result: ClassVar = "normalised-stiffness"
    of: Annotated[StiffnessName, "Name of a stiffness above, such as stiffness_first"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Modulus:
    """``<name>`` (Pa): stiffness x gauge length / area."""

    result: ClassVar = "modulus"
    of: Annotated[StiffnessName, "Name of a stiffness above, such as stiffness"]
    area: Annotated[
        Literal["stated", "rectangle", "annulus", "thin-wall"],
        "Which area of specimen.section it refers to",
    ]
    name: Annotated[Snake, "Such as modulus_annulus"] = "modulus"


@dataclass(frozen=True, slots=True, kw_only=True)
class FailureResult:
    """``failure_displacement`` (m) and ``failure_force`` (N)."""

    result: ClassVar = "failure"


@dataclass(frozen=True, slots=True, kw_only=True)
class EnergyToBreak:
    """``energy_to_break`` (J): work done up to the failure."""

    result: ClassVar = "energy-to-break"


@dataclass(frozen=True, slots=True, kw_only=True)
class SlipResults:
    """``slip_position.<n>`` (m) and ``slip_drop.<n>`` (N); no result where nothing slipped."""

    result: ClassVar = "slips"


@dataclass(frozen=True, slots=True, kw_only=True)
class SlackResult:
    """``slack`` (m): displacement before the specimen is taut."""

    result: ClassVar = "slack"


@dataclass(frozen=True, slots=True, kw_only=True)
class ComplianceResult:
    """``compliance`` (m/N) of frame and grips, from a test of a stiff bar."""

    result: ClassVar = "compliance"
    start: Annotated[Force, Key("from")]
    stop: Annotated[Force, Key("to"), Above("start")]


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
    Tagged("result"),
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
