"""Declare the settings of steps and results (types with units and ranges), and the steps.

A setting is a field of a frozen dataclass. The annotations of its type state how YAML writes it:
``over: Annotated[Length, "Stretch to which a tangent is fitted"]``. An annotation that is a text
is the description that editors show. `labpipe.protocol.grammar` derives the validator, the JSON
schema and the error messages from these types.

**Units**: coherent SI; the annotation states the unit that resolved protocols show.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, field, fields, replace
from functools import cache
from typing import (
    Annotated,
    Any,
    ClassVar,
    Final,
    Literal,
    Self,
    TypeAlias,
    get_args,
    get_type_hints,
)


@dataclass(frozen=True, slots=True)
class Quantity:
    """Annotation of a float that YAML states with its unit.

    Parameters
    ----------
    unit : SI unit of the float, ``1`` for a pure number
    display_unit : unit of the float in a resolved protocol
    example : correct text in YAML, for messages
    lower_bound : bound in `unit` that a valid value exceeds; None if there is none
    minimum, maximum : smallest and largest valid value, in `unit`
    """

    unit: str
    display_unit: str
    example: str
    lower_bound: float | None = None
    minimum: float = -math.inf
    maximum: float = math.inf


@dataclass(frozen=True, slots=True)
class WholeNumber:
    """Annotation of a whole number within a range.

    Parameters
    ----------
    minimum, maximum : smallest and largest valid value
    """

    minimum: int
    maximum: int


@dataclass(frozen=True, slots=True)
class PatternText:
    """Annotation of a text that matches a pattern.

    Parameters
    ----------
    pattern : regular expression that the whole text must match
    meaning : description of a valid text, for messages
    """

    pattern: str
    meaning: str


@dataclass(frozen=True, slots=True)
class Key:
    """Annotation of a field whose key in YAML is not a valid Python name, such as ``from``.

    Parameters
    ----------
    name : key of the field in YAML
    """

    name: str


@dataclass(frozen=True, slots=True)
class LargerThan:
    """Annotation of a quantity that must be larger than another one of the same block and type.

    Parameters
    ----------
    field : name of the other field, which must be declared before this one
    key : key of the other field in YAML
    """

    field: str
    key: str


@dataclass(frozen=True, slots=True)
class Reference:
    """Annotation of a name that must refer to an existing channel or stiffness.

    Parameters
    ----------
    kind : ``channel`` of a source or an earlier step, or ``stiffness`` of an earlier result
    """

    kind: Literal["channel", "stiffness"]


@dataclass(frozen=True, slots=True)
class ShippedCard:
    """Annotation of a block for which YAML may also state the name of a shipped card."""


@dataclass(frozen=True, slots=True)
class TaggedChoice:
    """Annotation of a union of dataclasses of settings that a key distinguishes.

    Parameters
    ----------
    key : key in YAML; each dataclass has its value of the key in a class variable of that name
    """

    key: str


@dataclass(frozen=True, slots=True)
class Span:
    """Length of the window of a filter.

    Parameters
    ----------
    kind : quantity in which the length is measured
    value : length: in s for ``time``, in m for ``travel``, as a fraction of a branch for
        ``branch``, as a number of samples for ``samples``
    """

    kind: Literal["time", "travel", "branch", "samples"]
    value: float


# Types of settings; each value is in SI.
Length: TypeAlias = Annotated[float, Quantity("m", "mm", "53 mm", lower_bound=0.0)]
Offset: TypeAlias = Annotated[float, Quantity("m", "mm", "0.8 mm")]
"""A length that may also be zero or negative."""
Distance: TypeAlias = Annotated[float, Quantity("m", "mm", "4 mm", minimum=0.0)]
Area: TypeAlias = Annotated[float, Quantity("m^2", "mm^2", "5.26 mm^2", lower_bound=0.0)]
TimeOffset: TypeAlias = Annotated[float, Quantity("s", "s", "1.234 s")]
"""A time that may also be zero or negative."""
Drift: TypeAlias = Annotated[float, Quantity("1", "ppm", "40 ppm", minimum=-0.01, maximum=0.01)]
"""Relative excess of the rate of one clock over another."""
Duration: TypeAlias = Annotated[float, Quantity("s", "s", "0.5 s", lower_bound=0.0)]
Force: TypeAlias = Annotated[float, Quantity("N", "N", "5 mN", minimum=0.0)]
Compliance: TypeAlias = Annotated[float, Quantity("m/N", "um/N", "0.2 um/N", minimum=0.0)]
Mass: TypeAlias = Annotated[float, Quantity("kg", "g", "2.7 g", minimum=0.0)]
LinearMass: TypeAlias = Annotated[
    float, Quantity("kg/m", "g/m", "6.1 g/m", lower_bound=0.0, maximum=100.0)
]
"""Mass per length."""
Speed: TypeAlias = Annotated[float, Quantity("m/s", "mm/s", "1 mm/s", lower_bound=0.0)]
Curvature: TypeAlias = Annotated[float, Quantity("1/m", "1/m", "20 1/m", lower_bound=0.0)]
Frequency: TypeAlias = Annotated[float, Quantity("Hz", "Hz", "10 Hz", lower_bound=0.0)]
Ratio: TypeAlias = Annotated[float, Quantity("1", "%", "0.2 %", minimum=0.0)]
Uncertainty: TypeAlias = Annotated[float, Quantity("1", "%", "0.2 %", minimum=0.0, maximum=1.0)]
"""A relative standard uncertainty."""
Fraction: TypeAlias = Annotated[float, Quantity("1", "%", "10 %", lower_bound=0.0, maximum=1.0)]
"""A fraction of a whole."""
SnakeName: TypeAlias = Annotated[
    str, PatternText(r"[a-z][a-z0-9_]*", "a name of small letters, digits and '_', a letter first")
]
"""A name in snake case."""
ChannelName: TypeAlias = Annotated[SnakeName, Reference("channel")]
StiffnessName: TypeAlias = Annotated[SnakeName, Reference("stiffness")]


CURVE_QUANTITIES = ("force", "displacement", "clock")
"""Quantities on which a result of the curve depends."""


@dataclass(frozen=True, slots=True)
class Output:
    """Result that a kind of result computes, as the summary contains it.

    Parameters
    ----------
    name : name in the summary; ``{name}`` and ``{of}`` are replaced by the settings of that name
    unit : SI unit
    label : name in reports; empty if a protocol chooses the name
    depends_on : quantities that make the result doubtful if one of them is doubtful
    first : number of the first of several results, one per cycle or slip; None for a single result
    is_raised_by_slips : whether the force that is added back for repaired slips raises the result
    can_be_negative : whether the result can be negative; for all others, intervals of means are on
        a log scale
    is_slope : whether the result is a slope of the force, which does not depend on the zero
    is_set_by_stroke : whether the rig sets the result if the protocol states the stroke; it is then
        no property of the specimen, and its scatter is that of the rig
    """

    name: str
    unit: str
    label: str = ""
    depends_on: tuple[str, ...] = CURVE_QUANTITIES
    first: int | None = None
    is_raised_by_slips: bool = False
    can_be_negative: bool = False
    is_slope: bool = False
    is_set_by_stroke: bool = False

    def format_name(self, kind: Any, settings: Mapping[str, object]) -> str:
        """Format the name of the result in the summary, or that of the first of several results.

        Parameters
        ----------
        kind : dataclass of the kind of result, which has the defaults of its settings
        settings : settings as written, valid or not
        """
        stem = self.name.format_map({"of": None, **get_defaults(kind), **settings})
        return stem if self.first is None else f"{stem}.{self.first}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Needs:
    """Parts of a protocol that a kind of result requires.

    Parameters
    ----------
    branches : whether the kind requires a curve with loading and unloading branches
    correction : required block of ``curve``; empty for none
    clocks : whether the kind requires two clocks that are aligned
    shape : required step that computes the shape of the specimen; empty for none
    clamp : whether the kind requires a clamped end, and a curve on the clock of the markers
    """

    branches: bool = False
    correction: str = ""
    clocks: bool = False
    shape: str = ""
    clamp: bool = False


@cache
def get_defaults(kind: Any) -> dict[str, Any]:
    """Return the default of each optional setting, keyed by name.

    Parameters
    ----------
    kind : dataclass of settings
    """
    return {field.name: field.default for field in fields(kind) if field.default is not MISSING}


@cache
def list_references(kind: Any, reference_kind: Literal["channel", "stiffness"]) -> tuple[str, ...]:
    """List the names of the settings that must refer to an existing channel or stiffness.

    Parameters
    ----------
    kind : dataclass of settings
    reference_kind : ``channel`` or ``stiffness``
    """
    hints = get_type_hints(kind, include_extras=True).items()
    return tuple(name for name, hint in hints if Reference(reference_kind) in get_args(hint))


@dataclass(frozen=True, slots=True, kw_only=True)
class _Step:
    """Base class of steps.

    The class variables state whether the step processes markers, the step that must come before it,
    and the channels that it adds.

    Parameters
    ----------
    index : index of the step in the list of the protocol; it is not a setting
    """

    uses_markers: ClassVar = False
    required_step: ClassVar = ""
    added_channels: ClassVar[tuple[str, ...]] = ()
    index: int = field(default=0, compare=False)

    @property
    def key(self) -> str:
        """Dotted key of the step, such as ``steps.2``."""
        return f"steps.{self.index}"

    def with_index(self, index: int) -> Self:
        """Return a copy of the step with another index."""
        return replace(self, index=index)


@dataclass(frozen=True, slots=True, kw_only=True)
class RepairMarkers(_Step):
    """Undo label switches, fill short gaps, and flag changed positions."""

    step: ClassVar = "repair-markers"
    uses_markers: ClassVar = True
    max_gap: Annotated[Duration, "Longer gaps are not filled"]
    max_jump: Annotated[Length, "A larger change between two frames is no motion of a marker"]
    frozen: Annotated[Duration, "A longer run of equal positions is a lost track"]


@dataclass(frozen=True, slots=True, kw_only=True)
class SpecimenFrame(_Step):
    """Transform the markers into the frame of the specimen; with a clamp, make `travel`."""

    step: ClassVar = "specimen-frame"
    uses_markers: ClassVar = True
    required_step: ClassVar = "repair-markers"
    added_channels: ClassVar = ("travel",)
    over: Annotated[Duration, "Stretch at the start in which the specimen is at rest"]
    max_out_of_plane: Annotated[
        Length, "The shape is doubtful if the markers leave a plane by more, rms"
    ] = 0.001


@dataclass(frozen=True, slots=True, kw_only=True)
class FitShape(_Step):
    """Fit a smooth curve to the markers of each frame; with a clamp, make `deflection`."""

    step: ClassVar = "fit-shape"
    uses_markers: ClassVar = True
    required_step: ClassVar = "specimen-frame"
    added_channels: ClassVar = ("deflection",)
    terms: Annotated[int, WholeNumber(2, 12)]
    tip: Annotated[Literal["free", "loaded"], "free: no bending moment at the tip"]


@dataclass(frozen=True, slots=True, kw_only=True)
class ThreePointShape(_Step):
    """Fit the bent axis between two supports through sections of markers; make `mid_span`."""

    step: ClassVar = "three-point-shape"
    uses_markers: ClassVar = True
    required_step: ClassVar = "repair-markers"
    added_channels: ClassVar = ("mid_span",)
    over: Annotated[Duration, "Stretch at the start in which the specimen is straight"]
    section: Annotated[
        Length, "Markers nearer to each other than this, along the axis, share a section"
    ] = 0.004
    facing: Annotated[
        Literal["side", "load", "away"],
        "Side of the markers: across the load, on the side that the load moves to, or on the "
        "side that it comes from",
    ] = "side"


@dataclass(frozen=True, slots=True, kw_only=True)
class TravelFromSpeed(_Step):
    """Make a displacement from crosshead speed and stroke; a measured one takes precedence."""

    step: ClassVar = "travel-from-speed"
    added_channels: ClassVar = ("{channel}",)
    channel: Annotated[SnakeName, "Displacement that the step makes if no source has it"]
    force: Annotated[ChannelName, "Channel in which the turn is detected"]
    window: Annotated[Duration, "Window on each side of the corner of the force at the turn"] = 1.0
    rate: Annotated[Frequency, "Sampling rate of the displacement"] = 50.0
    speed_uncertainty: Annotated[
        Uncertainty, "Relative standard uncertainty of the speed of the rig"
    ] = 0.005


@dataclass(frozen=True, slots=True, kw_only=True)
class Zero(_Step):
    """Subtract the mean of a stretch without load."""

    step: ClassVar = "zero"
    channel: ChannelName
    over: Duration
    at: Literal["start", "end"] = "start"
    by: Annotated[
        Literal["mean", "line"],
        "line: value of a straight line through the stretch at its outer end, for machines that "
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
    order: Annotated[int, WholeNumber(1, 8)]


@dataclass(frozen=True, slots=True, kw_only=True)
class Decimate(_Step):
    """Keep every n-th sample, n being the factor."""

    step: ClassVar = "decimate"
    channel: ChannelName
    factor: Annotated[int, WholeNumber(2, 100_000)]
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
    TaggedChoice("step"),
]

STEPS: Final[dict[str, Any]] = {kind.step: kind for kind in get_args(get_args(Step)[0])}
"""Dataclass of each kind of step, keyed by its name in YAML."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """Differences beyond which a record or a number is doubtful."""

    speed_deviation: Annotated[
        Fraction, "Deviation of the first branch's mean speed from `rig.crosshead_speed`"
    ] = 0.2
    mid_span_deviation: Annotated[
        Fraction, "Deviation of the cameras' mid-span deflection from the displacement"
    ] = 0.2
    zero_overlap: Annotated[Duration, "Overlap of the stretch of a zero with the motion"] = 0.25
    rest_force: Annotated[
        Ratio, "Force before the motion if no step zeroes it, relative to the largest force"
    ] = 0.005
    rest_force_drift: Annotated[
        Ratio, "Change of the force at rest, relative to the largest force"
    ] = 0.03
    pulling_force: Annotated[
        Ratio, "Negative force of a load that can only press, relative to the largest force"
    ] = 0.02
    hold_time: Annotated[Duration, "Duration of a stop of the motion within a test"] = 0.25
    loading_shortfall: Annotated[
        Ratio, "Distance from the end of a record to the earlier turns, relative to the stroke"
    ] = 0.005
    unloading_shortfall: Annotated[
        Ratio, "Distance from the end of a record to its start, relative to the stroke"
    ] = 0.02
    force_shortfall: Annotated[
        Ratio, "Fraction of the last branch that is missing in the record of the force"
    ] = 0.02
    cycle_change: Annotated[
        Ratio, "Relative change of the force between two cycles, in scale or in level"
    ] = 0.008
    force_lag: Annotated[
        Ratio, "Median increase of force after turns, relative to the largest force"
    ] = 0.007
    turn_jump: Annotated[Ratio, "Increase of force after a turn, relative to the largest"] = 0.03
    energy_gain: Annotated[Ratio, "Energy returned by a cycle beyond the energy of its loading"] = (
        0.05
    )
    broken_force: Annotated[
        Fraction, "Force of a broken specimen in unloading, relative to first loading"
    ] = 0.05
    second_loading: Annotated[
        Fraction, "Force in a loading after the break, relative to first loading"
    ] = 0.5
    machine_compliance: Annotated[
        Compliance, "Compliance of frame and grips that is assumed if none is stated"
    ] = 1e-7
    machine_share: Annotated[
        Fraction,
        "Fraction of a displacement from this compliance above which a modulus is doubtful",
    ] = 0.02
    unstated_mass: Annotated[LinearMass, "Mass per length that is assumed if none is stated"] = 1e-3
    weight_share: Annotated[
        Fraction, "Fraction of a moment from this mass above which a bending stiffness is doubtful"
    ] = 0.01


LIMITS = Limits()
"""Limits that apply if a protocol states no others."""
