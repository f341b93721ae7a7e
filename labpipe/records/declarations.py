"""How steps, results and limits are declared: settings with units and ranges; needs; the steps.

A setting is a field of a frozen dataclass whose type says by `typing.Annotated` how YAML writes it:
``over: Annotated[Length, "Stretch that a tangent is read from"]``. A bare text in the annotation is
the description that people read in an editor. Nothing here reads YAML: `labpipe.protocol.grammar`
makes the validator, the JSON schema and the error messages of these types.

**Units**: coherent SI inside; the marker of a type says in which unit people write it.
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
    """A float that YAML writes with its unit.

    Parameters
    ----------
    unit : SI unit of the float, ``1`` for a pure number
    shown : unit in which a resolved protocol writes it
    example : how a person writes it
    above : in `unit`, the value must be larger; None for no such bound
    minimum, maximum : in `unit`, smallest and largest valid value
    """

    unit: str
    shown: str
    example: str
    above: float | None = None
    minimum: float = -math.inf
    maximum: float = math.inf


@dataclass(frozen=True, slots=True)
class WholeNumber:
    """A whole number within a range.

    Parameters
    ----------
    minimum, maximum : smallest and largest valid value
    """

    minimum: int
    maximum: int


@dataclass(frozen=True, slots=True)
class PatternText:
    """A text of one form.

    Parameters
    ----------
    pattern : regular expression of the whole text
    meaning : the same in words, for messages
    """

    pattern: str
    meaning: str


@dataclass(frozen=True, slots=True)
class Key:
    """How YAML calls a field whose name Python does not take, such as ``from``.

    Parameters
    ----------
    name : the key
    """

    name: str


@dataclass(frozen=True, slots=True)
class LargerThan:
    """A quantity that must be larger than another one of the same block and type.

    Parameters
    ----------
    field : name of the other field, which is declared before
    key : its key in YAML
    """

    field: str
    key: str


@dataclass(frozen=True, slots=True)
class Existing:
    """A word that must name something that exists where it is written.

    Parameters
    ----------
    kind : a channel that a source or an earlier step gives, or a stiffness above in the list
    """

    kind: Literal["channel", "stiffness"]


@dataclass(frozen=True, slots=True)
class FromCard:
    """A block that YAML may also name: the content of a card that comes with labpipe."""


@dataclass(frozen=True, slots=True)
class TaggedChoice:
    """One of several kinds of settings, distinguished by a key.

    Parameters
    ----------
    key : in YAML; every kind has its value as a class variable of that name
    """

    key: str


@dataclass(frozen=True, slots=True)
class Span:
    """Length of a stretch of a channel that a filter looks at.

    Parameters
    ----------
    kind : what the length is measured in
    value : s for ``time``, m for ``travel``, a ratio for ``branch``, a count for ``samples``
    """

    kind: Literal["time", "travel", "branch", "samples"]
    value: float


Length: TypeAlias = Annotated[float, Quantity("m", "mm", "53 mm", above=0.0)]
Offset: TypeAlias = Annotated[float, Quantity("m", "mm", "0.8 mm")]
"""A length that may also be zero or negative."""
Distance: TypeAlias = Annotated[float, Quantity("m", "mm", "4 mm", minimum=0.0)]
Area: TypeAlias = Annotated[float, Quantity("m^2", "mm^2", "5.26 mm^2", above=0.0)]
Moment: TypeAlias = Annotated[float, Quantity("s", "s", "1.234 s")]
"""A time that may also be zero or negative."""
Drift: TypeAlias = Annotated[float, Quantity("1", "ppm", "40 ppm", minimum=-0.01, maximum=0.01)]
"""By how much one clock runs faster than another."""
Duration: TypeAlias = Annotated[float, Quantity("s", "s", "0.5 s", above=0.0)]
Force: TypeAlias = Annotated[float, Quantity("N", "N", "5 mN", minimum=0.0)]
Compliance: TypeAlias = Annotated[float, Quantity("m/N", "um/N", "0.2 um/N", minimum=0.0)]
Mass: TypeAlias = Annotated[float, Quantity("kg", "g", "2.7 g", minimum=0.0)]
LinearMass: TypeAlias = Annotated[
    float, Quantity("kg/m", "g/m", "6.1 g/m", above=0.0, maximum=100.0)
]
"""Mass per length."""
Speed: TypeAlias = Annotated[float, Quantity("m/s", "mm/s", "1 mm/s", above=0.0)]
Curvature: TypeAlias = Annotated[float, Quantity("1/m", "1/m", "20 1/m", above=0.0)]
Frequency: TypeAlias = Annotated[float, Quantity("Hz", "Hz", "10 Hz", above=0.0)]
Ratio: TypeAlias = Annotated[float, Quantity("1", "%", "0.2 %", minimum=0.0)]
Uncertainty: TypeAlias = Annotated[float, Quantity("1", "%", "0.2 %", minimum=0.0, maximum=1.0)]
"""A standard uncertainty as a share of what it belongs to."""
Share: TypeAlias = Annotated[float, Quantity("1", "%", "10 %", above=0.0, maximum=1.0)]
"""A part of a whole."""
Snake: TypeAlias = Annotated[
    str, PatternText(r"[a-z][a-z0-9_]*", "a name of small letters, digits and '_', a letter first")
]
ChannelName: TypeAlias = Annotated[Snake, Existing("channel")]
StiffnessName: TypeAlias = Annotated[Snake, Existing("stiffness")]


CURVE = ("force", "displacement", "clock")
"""What a number rests on that is read from the curve."""


@dataclass(frozen=True, slots=True)
class Output:
    """A number that a kind of result puts into the summary.

    Parameters
    ----------
    name : in the summary; ``{name}`` and ``{of}`` are replaced by the settings of that name
    unit : SI
    label : for people; empty where a protocol chooses the name
    rests_on : quantities; what makes one of them doubtful makes the number doubtful
    first : number of the first of several, one per cycle or slip; None where there is one alone
    is_raised_by_slips : whether a repaired slip anywhere on the way has raised it
    can_be_negative : whether a specimen can have it below zero; means of all others have their
        interval on a log scale
    is_set_by_stroke : whether the rig sets it where a protocol states the stroke: it is then no
        property of the specimen, and its scatter says how the rig stops
    """

    name: str
    unit: str
    label: str = ""
    rests_on: tuple[str, ...] = CURVE
    first: int | None = None
    is_raised_by_slips: bool = False
    can_be_negative: bool = False
    is_set_by_stroke: bool = False

    def name_in(self, kind: Any, entry: Mapping[str, object]) -> str:
        """Return the name in the summary, of several the first.

        Parameters
        ----------
        kind : the kind of result, with the defaults of its settings
        entry : the settings as written, whether or not they are valid
        """
        stem = self.name.format_map({"of": None, **list_defaults(kind), **entry})
        return stem if self.first is None else f"{stem}.{self.first}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Needs:
    """What of a test a kind of result is read from.

    Parameters
    ----------
    branches : a curve that is cut into loading and unloading
    correction : block of ``curve`` that finds what the result gives; empty for none
    clocks : two clocks that are joined
    shape : step that makes the shape of the specimen; empty for none
    clamp : a clamped end, and a curve on the clock of the markers
    """

    branches: bool = False
    correction: str = ""
    clocks: bool = False
    shape: str = ""
    clamp: bool = False


def list_kinds(union: Any) -> dict[str, Any]:
    """List the kinds of a union of settings by their tag.

    Parameters
    ----------
    union : dataclasses, annotated with `TaggedChoice`
    """
    kinds, tagged = get_args(union)
    return {getattr(kind, tagged.key): kind for kind in get_args(kinds)}


@cache
def list_defaults(kind: Any) -> dict[str, Any]:
    """Return the settings that a block may leave out, by name.

    Parameters
    ----------
    kind : dataclass of settings
    """
    return {field.name: field.default for field in fields(kind) if field.default is not MISSING}


@cache
def list_references(kind: Any, what: Literal["channel", "stiffness"]) -> tuple[str, ...]:
    """Return the names of the settings that must name something that exists.

    Parameters
    ----------
    kind : dataclass of settings
    what : that they name
    """
    hints = get_type_hints(kind, include_extras=True).items()
    return tuple(name for name, hint in hints if Existing(what) in get_args(hint))


@dataclass(frozen=True, slots=True, kw_only=True)
class _Step:
    """One step with its number in the list, which is not a setting.

    It may work on markers, come after another step, and make channels.
    """

    on_markers: ClassVar = False
    after: ClassVar = ""
    makes: ClassVar[tuple[str, ...]] = ()
    number: int = field(default=0, compare=False)

    @property
    def key(self) -> str:
        """Return the dotted key of the step, as an override begins: ``steps.2``."""
        return f"steps.{self.number}"

    def numbered(self, number: int) -> Self:
        """Return the step with its number in the list as written, from 0."""
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
    terms: Annotated[int, WholeNumber(2, 12)]
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
    speed_uncertainty: Annotated[Uncertainty, "Standard uncertainty of rig's speed"] = 0.005


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
    order: Annotated[int, WholeNumber(1, 8)]


@dataclass(frozen=True, slots=True, kw_only=True)
class Decimate(_Step):
    """Keep every so many samples."""

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

STEPS: Final = list_kinds(Step)
"""The kinds of steps by their word in YAML."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """Differences beyond which a record or a number is doubtful."""

    speed_deviation: Annotated[
        Share, "Mean speed of the first branch against `rig.crosshead_speed`"
    ] = 0.2
    mid_span_deviation: Annotated[
        Share, "Mid-span deflection seen by cameras against the displacement"
    ] = 0.2
    zero_overlap: Annotated[Duration, "Time by which a zero reaches into the motion"] = 0.25
    rest_force: Annotated[
        Ratio, "Force before the motion that no step zeroes, of the largest force"
    ] = 0.005
    rest_force_drift: Annotated[
        Ratio, "Change of the force at rest over the test, of the largest force"
    ] = 0.03
    pulling_force: Annotated[
        Ratio, "Force below zero of a load that only presses, of the largest force"
    ] = 0.02
    hold_time: Annotated[Duration, "Time that the motion stands within a test"] = 0.25
    loading_shortfall: Annotated[
        Ratio, "Distance to the earlier turns at which a record ends, of the stroke"
    ] = 0.005
    unloading_shortfall: Annotated[
        Ratio, "Distance to the start at which a record ends, of the stroke"
    ] = 0.02
    force_shortfall: Annotated[
        Ratio, "Part of the last branch that the record of the force lacks"
    ] = 0.02
    cycle_change: Annotated[
        Ratio, "Change of scale, or of level (of the largest force), between two cycles"
    ] = 0.008
    force_lag: Annotated[
        Ratio, "Median growth of the force after the turns, of the largest force"
    ] = 0.007
    turn_jump: Annotated[Ratio, "Growth of the force after one turn, of the largest force"] = 0.03
    energy_gain: Annotated[Ratio, "Energy that a cycle gives back beyond that of its loading"] = (
        0.05
    )
    broken_force: Annotated[
        Share, "Force on the way back of a broken specimen, of the first loading"
    ] = 0.05
    second_loading: Annotated[
        Share, "Force in a loading after a break that is another specimen, of the first loading"
    ] = 0.5
    machine_compliance: Annotated[
        Compliance, "Compliance of frame and grips that is assumed where none is stated"
    ] = 1e-7
    machine_share: Annotated[
        Share, "Part of the displacement that this compliance makes before a modulus is doubtful"
    ] = 0.02
    unstated_mass: Annotated[LinearMass, "Mass per length that is assumed where none is stated"] = (
        1e-3
    )
    weight_share: Annotated[
        Share, "Part of a moment that this mass makes before a bending stiffness is doubtful"
    ] = 0.01


LIMITS = Limits()
