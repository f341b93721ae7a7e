"""Results of a protocol: the numbers that are taken from the curve and the shape."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, ClassVar, Final, Literal, TypeAlias

from labpipe.errors import Fault
from labpipe.records.declarations import (
    Above,
    Curvature,
    Distance,
    Force,
    Key,
    Length,
    Needs,
    Output,
    Ratio,
    Share,
    Snake,
    StiffnessName,
    Tagged,
    kinds_of,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class ClockResult:
    """``clock_offset`` (s) and ``clock_drift`` (1) of the two clocks."""

    result: ClassVar = "clock"
    outputs: ClassVar = (Output("clock_offset", "s"), Output("clock_drift", "1"))
    needs: ClassVar = Needs(clocks=True)


@dataclass(frozen=True, slots=True, kw_only=True)
class PeakForce:
    """``peak_force.<cycle>`` (N)."""

    result: ClassVar = "peak-force"
    outputs: ClassVar = (Output("peak_force", "N", first=1),)
    needs: ClassVar = Needs(branches=True)


@dataclass(frozen=True, slots=True, kw_only=True)
class PeakDisplacement:
    """``peak_displacement.<cycle>`` (m)."""

    result: ClassVar = "peak-displacement"
    outputs: ClassVar = (Output("peak_displacement", "m", first=1),)
    needs: ClassVar = Needs(branches=True)


@dataclass(frozen=True, slots=True, kw_only=True)
class Window:
    """A stretch of displacement."""

    start: Annotated[Distance, Key("from")]
    stop: Annotated[Distance, Key("to"), Above("start")]


@dataclass(frozen=True, slots=True, kw_only=True)
class InitialStiffness(Window):
    """``initial_stiffness`` (N/m): slope at the start of the first loading."""

    result: ClassVar = "initial-stiffness"
    outputs: ClassVar = (Output("initial_stiffness", "N/m"),)
    needs: ClassVar = Needs(branches=True)


@dataclass(frozen=True, slots=True, kw_only=True)
class Stiffness(Window):
    """A straight line (N/m) over a window of the first loading, under a name of its own."""

    result: ClassVar = "stiffness"
    outputs: ClassVar = (Output("{name}", "N/m"),)
    needs: ClassVar = Needs(branches=True)
    name: Annotated[Snake, "Such as stiffness_first"] = "stiffness"


@dataclass(frozen=True, slots=True, kw_only=True)
class UnloadingStiffness:
    """``unloading_stiffness.<cycle>`` (N/m): slope just after each turn."""

    result: ClassVar = "unloading-stiffness"
    outputs: ClassVar = (Output("unloading_stiffness", "N/m", first=1),)
    needs: ClassVar = Needs(branches=True)
    over: Length


@dataclass(frozen=True, slots=True, kw_only=True)
class Energy:
    """``energy.<cycle>`` (J): dissipated over one cycle."""

    result: ClassVar = "energy"
    outputs: ClassVar = (Output("energy", "J", first=1),)
    needs: ClassVar = Needs(branches=True)


@dataclass(frozen=True, slots=True, kw_only=True)
class ResidualDisplacement:
    """``residual_displacement.<cycle>`` (m): what is left when the force is gone."""

    result: ClassVar = "residual-displacement"
    outputs: ClassVar = (Output("residual_displacement", "m", first=1),)
    needs: ClassVar = Needs(branches=True)
    force_below: Force


@dataclass(frozen=True, slots=True, kw_only=True)
class TipTravel:
    """``tip_travel`` (m): how far the tip moves from where it began."""

    result: ClassVar = "tip-travel"
    outputs: ClassVar = (Output("tip_travel", "m"),)
    needs: ClassVar = Needs(shape="fit-shape")


@dataclass(frozen=True, slots=True, kw_only=True)
class MomentCurvature:
    """``<name>`` (N m^2): bending stiffness by the measured moment-curvature law."""

    result: ClassVar = "moment-curvature"
    outputs: ClassVar = (Output("{name}", "N*m^2"),)
    needs: ClassVar = Needs(branches=True, shape="fit-shape", clamp=True)
    at: Annotated[Curvature, "Curvature of the first loading"]
    kind: Annotated[
        Literal["secant", "tangent"], "secant: moment / curvature; tangent: slope of the law"
    ] = "secant"
    name: Annotated[Snake, "Such as bending_stiffness_at_20"] = "bending_stiffness"


@dataclass(frozen=True, slots=True, kw_only=True)
class MidSpan(Window):
    """``mid_span_bending_stiffness`` (N m^2) and ``mid_span_curvature`` (1/m) of a bent span."""

    result: ClassVar = "mid-span"
    outputs: ClassVar = (
        Output("mid_span_bending_stiffness", "N*m^2"),
        Output("mid_span_curvature", "1/m"),
    )
    needs: ClassVar = Needs(branches=True, shape="three-point-shape")
    corrections: Annotated[
        tuple[Literal["large-deflection"], ...],
        "large-deflection: the supports push along the specimen as well",
    ] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Twist:
    """``twist`` (rad): how far the section at mid-span has turned about the axis."""

    result: ClassVar = "twist"
    outputs: ClassVar = (Output("twist", "rad"),)
    needs: ClassVar = Needs(branches=True, shape="three-point-shape")


@dataclass(frozen=True, slots=True, kw_only=True)
class Kink(Window):
    """``kink_displacement`` (m) and ``kink_force`` (N): where first loading gets less steep."""

    result: ClassVar = "kink"
    outputs: ClassVar = (Output("kink_displacement", "m"), Output("kink_force", "N"))
    needs: ClassVar = Needs(branches=True)


@dataclass(frozen=True, slots=True, kw_only=True)
class Plateau:
    """``end_slope`` (1); where it is small also ``plateau_displacement`` (m), ``plateau_force``."""

    result: ClassVar = "plateau"
    outputs: ClassVar = (
        Output("end_slope", "1"),
        Output("plateau_displacement", "m"),
        Output("plateau_force", "N"),
    )
    needs: ClassVar = Needs(branches=True)
    slope_below: Annotated[Share, "Share of the initial slope, such as 10 %"]
    of: Annotated[StiffnessName, "Name of the stiffness above that is the initial slope"] = (
        "initial_stiffness"
    )
    over: Annotated[Length, "Stretch that a tangent is read from"] = 0.005


@dataclass(frozen=True, slots=True, kw_only=True)
class LoadingStiffness:
    """``loading_stiffness.<cycle>`` (N/m): slope just after the force takes up."""

    result: ClassVar = "loading-stiffness"
    outputs: ClassVar = (Output("loading_stiffness", "N/m", first=1),)
    needs: ClassVar = Needs(branches=True)
    over: Length


@dataclass(frozen=True, slots=True, kw_only=True)
class Hardening:
    """``hardening.<cycle>`` (1) of later cycles: ``loading_stiffness`` over that of the first."""

    result: ClassVar = "hardening"
    outputs: ClassVar = (Output("hardening", "1", first=2),)
    needs: ClassVar = Needs(branches=True)
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
    outputs: ClassVar = (Output("{name}", "N*m^2"),)
    needs: ClassVar = Needs(branches=True)
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
    outputs: ClassVar = (
        Output("segment_stiffness_first", "N/m"),
        Output("segment_stiffness_second", "N/m"),
        Output("break_point", "m"),
    )
    needs: ClassVar = Needs(branches=True)


@dataclass(frozen=True, slots=True, kw_only=True)
class NormalisedStiffness:
    """``<of>_per_peak_force`` (1/m): a stiffness over the largest force of the same sample."""

    result: ClassVar = "normalised-stiffness"
    outputs: ClassVar = (Output("{of}_per_peak_force", "1/m"),)
    needs: ClassVar = Needs()
    of: Annotated[StiffnessName, "Name of a stiffness above, such as stiffness_first"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Modulus:
    """``<name>`` (Pa): stiffness x gauge length / area."""

    result: ClassVar = "modulus"
    outputs: ClassVar = (Output("{name}", "Pa"),)
    needs: ClassVar = Needs()
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
    outputs: ClassVar = (Output("failure_displacement", "m"), Output("failure_force", "N"))
    needs: ClassVar = Needs(branches=True, correction="failure")


@dataclass(frozen=True, slots=True, kw_only=True)
class EnergyToBreak:
    """``energy_to_break`` (J): work done up to the failure."""

    result: ClassVar = "energy-to-break"
    outputs: ClassVar = (Output("energy_to_break", "J"),)
    needs: ClassVar = Needs(branches=True, correction="failure")


@dataclass(frozen=True, slots=True, kw_only=True)
class SlipResults:
    """``slip_position.<n>`` (m) and ``slip_drop.<n>`` (N); no result where nothing slipped."""

    result: ClassVar = "slips"
    outputs: ClassVar = (Output("slip_position", "m", first=1), Output("slip_drop", "N", first=1))
    needs: ClassVar = Needs(branches=True, correction="slips")


@dataclass(frozen=True, slots=True, kw_only=True)
class SlackResult:
    """``slack`` (m): displacement before the specimen is taut."""

    result: ClassVar = "slack"
    outputs: ClassVar = (Output("slack", "m"),)
    needs: ClassVar = Needs(branches=True, correction="slack")


@dataclass(frozen=True, slots=True, kw_only=True)
class ComplianceResult:
    """``compliance`` (m/N) of frame and grips, from a test of a stiff bar."""

    result: ClassVar = "compliance"
    outputs: ClassVar = (Output("compliance", "m/N"),)
    needs: ClassVar = Needs(branches=True)
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

RESULTS: Final = kinds_of(ResultEntry)
"""The kinds of results by their word in YAML."""


def result_names(tag: str, entry: Mapping[str, object]) -> tuple[str, ...]:
    """List what an entry is called in the summary; of several cycles or slips, the first.

    Parameters
    ----------
    tag : such as ``two-segments``
    entry : the block as written, which may give a name of its own
    """
    kind = RESULTS.get(tag)
    return () if kind is None else tuple(each.name_in(kind, entry) for each in kind.outputs)
