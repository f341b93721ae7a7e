"""Protocols: the blocks of a protocol file, and their checks against each other.

Most checks between blocks use the protocol as written, not the validated models: a misspelt key in
one block must not hide a fault of another.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, Self, TypeAlias, Union

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    ValidationInfo,
    field_validator,
    model_validator,
)

from labpipe.errors import Fault, KeyPath, format_overrides, sort_by_likeness
from labpipe.protocol.grammar import (
    SI_UNITS,
    Block,
    FileStem,
    Remark,
    Text,
    try_parse_quantity,
)
from labpipe.protocol.source import (
    MARKER_READERS,
    ROLES,
    ChannelSource,
    Plausible,
    Role,
    Section,
    SizeUncertainties,
    Source,
    assign_roles,
    find_implausible_sizes,
)
from labpipe.protocol.yaml_text import (
    Values,
    build_choice_fault,
    build_refusal,
    get_block,
    get_list,
    raise_faults,
)
from labpipe.records.declarations import (
    LIMITS,
    STEPS,
    Compliance,
    Distance,
    Drift,
    Duration,
    Force,
    Fraction,
    Key,
    LargerThan,
    Length,
    Limits,
    LinearMass,
    Mass,
    Moment,
    Needs,
    Offset,
    Quantity,
    Ratio,
    Snake,
    Speed,
    Step,
    TaggedChoice,
    Uncertainty,
    WholeNumber,
    list_defaults,
    list_references,
)
from labpipe.results import KINDS
from labpipe.results.bending import BendingStiffness
from labpipe.results.kinds import Kind

_CURVE, _MARKER_SOURCE = "a block 'curve'", "a source of marker tracks"
_SHAPE_STEP = "a step that computes shapes"
FIGURES: Final = MappingProxyType(
    {
        "force-displacement": (_CURVE,),
        "stiffness-lines": (_CURVE,),
        "stress-strain": (_CURVE,),
        "wire-shapes": (_SHAPE_STEP,),
        "moment-curvature": ("a result 'moment-curvature'",),
        "timeline": (_CURVE,),
        "marker-quality": (_MARKER_SOURCE,),
        "uncertainty-budget": (),
    }
)
"""Figures that a protocol can name, and what they need."""
MARKER_FIGURES: Final = frozenset(name for name in FIGURES if {*FIGURES[name]} - {_CURVE})
"""Figures that need a source of marker tracks."""

if TYPE_CHECKING:
    ResultEntry: TypeAlias = Kind
    _FigureName = str
else:
    ResultEntry = Annotated[Union[KINDS], TaggedChoice("result")]  # noqa: UP007 - of a list
    _FigureName = Literal[tuple(FIGURES)]

KINDS_BY_NAME: Final[Mapping[str, Any]] = {kind.result: kind for kind in KINDS}
"""Kinds of results by their name in YAML."""
Faults: TypeAlias = Iterator[Fault]


class SpecimenBlock(Block):
    """Dimensions that all specimens of the protocol share."""

    length: Length | None = None
    """Free length; a test sheet overrides it."""
    gauge_length: Length | None = None
    """Gauge length of the extensometer whose channel is the displacement of the curve."""
    span: Length | None = None
    """Distance between the supports."""
    mass_per_length: LinearMass | None = None
    """Mass per length of a cantilever; without it, its deflection by its weight is ignored."""
    section: Section | None = None
    """Sizes of the cross-section, or its area."""
    uncertainty: SizeUncertainties | None = None
    """Standard uncertainties of these dimensions; a test sheet overrides them."""

    @field_validator("uncertainty")
    @classmethod
    def _check_uncertainties(cls, sizes: Any, info: ValidationInfo) -> Any:
        """Refuse a standard uncertainty that is not below the dimension itself."""
        dimensions = {**vars(info.data.get("section") or Section()), **info.data}
        raise_faults(
            Fault.of("protocol.size_unknown", (key,), key=key)
            for key, uncertainty in (sizes.by_key if sizes else {}).items()
            if uncertainty >= (dimensions.get(key) or math.inf)
        )
        return sizes


class LoadString(Block):
    """String between specimen and load cell."""

    length: Length
    """Length from the specimen to the load cell."""
    counterweight: Mass = 0.0
    """Mass that hangs at the tip."""
    at_rest: Literal["by-data", "taut", "slack"] = "by-data"
    """Whether the string carried the counterweight before the test."""


class Rig(Block):
    """Settings of the machine, for checks, the string, and `travel-from-speed`."""

    crosshead_speed: Speed | None = None
    """Speed of the crosshead during the motion."""
    stroke: Length | None = None
    """Displacement of the crosshead from the start to the turn of a cycle."""
    cycles: Annotated[int, WholeNumber(1, 1_000_000)] | None = None
    """Number of cycles of loading and unloading."""
    string: LoadString | None = None
    """String that pulls the specimen, if there is one."""


def _parse_marker_names(value: object) -> object:
    if value == "all":
        return value
    names = value if isinstance(value, list | tuple) else [value]
    if not names or not all(isinstance(name, str) and name for name in names):
        raise build_refusal("protocol.no_markers", found=value)
    return tuple(names)


MarkerNames: TypeAlias = Annotated[
    Literal["all"] | tuple[str, ...],
    BeforeValidator(_parse_marker_names, json_schema_input_type=str | tuple[str, ...]),
]


class Markers(Block):
    """Positions of the markers of a take on the specimen."""

    clamp: Text | None
    """Rigid body at the clamped end; null if there is none."""
    along: MarkerNames = "all"
    """Markers along the specimen: all, or a list of names and patterns."""
    rings: Literal["none", "by-body"] = "none"
    """Rings of markers around the specimen; by-body: the centre of the markers of a rigid body is
    that of their ring."""
    grip_offset: Offset = 0.0
    """Distance from the pivot of the clamp to the clamped end."""
    pull_offset: Distance = 0.0
    """Distance from the last marker to the string, along the specimen."""
    centre_offset: Offset = 0.0
    """Distance from the axis to the centre of a marker, towards the pull."""
    offset_uncertainty: Distance = 0.0
    """Standard uncertainty of grip_offset, and of pull_offset."""
    centre_uncertainty: Distance = 0.0
    """Standard uncertainty of centre_offset."""


class AlignNone(Block):
    """No alignment, because all channels have one clock."""

    method: Literal["none"] = "none"


class AlignTurningPoints(Block):
    """Alignment of two clocks by turning points that both recordings show."""

    method: Literal["turning-points"]
    channel: Snake
    """Channel whose corners mark the turning points."""
    motion_window: Duration
    """Window of the fit on each side of a turning point of the clamp."""
    force_window: Duration
    """Window of the fit on each side of a corner of the channel."""
    max_residual: Duration
    """Residual of a turning point beyond which the alignment is doubtful."""
    max_drift: Ratio
    """Relative difference of the clock rates beyond which the alignment is doubtful."""


class AlignCommonStart(Block):
    """Alignment of recorders that started together, checked by a corner at a turning point."""

    method: Literal["common-start"]
    channel: Snake
    """Channel whose corner marks the turning point."""
    max_offset: Duration
    """Largest delay of the later recorder."""
    max_drift: Ratio = 1e-4
    """Largest relative difference of the clock rates."""
    motion_window: Duration = 10.0
    """Window of the fit on each side of a turning point of the motion."""
    force_window: Duration = 1.0
    """Window of the fit on each side of a corner of the channel."""


class AlignStated(Block):
    """Stated relation of two clocks: force time = offset + (1 + drift) x motion time."""

    method: Literal["stated"]
    channel: Snake | None = None
    """Channel on the clock of the force; by default the force of the curve."""
    offset: Moment
    """Force time at motion time zero."""
    drift: Drift = 0.0
    """Relative excess of the rate of the force clock."""
    uncertainty: Duration | None = None
    """Standard uncertainty of the offset; by default one sample step."""
    because: Text
    """Origin of the offset."""
    motion_window: Duration = 10.0
    """Window of the fit on each side of a turning point of the motion."""


Align: TypeAlias = Annotated[
    AlignNone | AlignTurningPoints | AlignCommonStart | AlignStated, Field(discriminator="method")
]


class MachineCompliance(Block):
    """Compliance of frame and grips; times the force, it is subtracted from the displacement."""

    value: Compliance
    """Compliance from a test of a stiff bar with the protocol stiff-bar."""
    uncertainty: Uncertainty = 0.0
    """Relative standard uncertainty of the value."""


class Failure(Block):
    """Criterion of failure: the force drops suddenly and does not recover."""

    force_below: Fraction
    """Fraction of the largest force below which the force stays after the drop, such as 50 %."""
    loss: Fraction = 0.1
    """Smallest drop, as a fraction of the largest force."""
    within: Duration = 0.05
    """Longest duration of the drop; one sample step if that is longer."""
    at_end_below: Fraction | None = None
    """Fraction of the largest force; a record whose force ends below it ends with the break."""


class Slips(Block):
    """Treatment of slips of the specimen in its grips."""

    decision: Literal["marked", "repaired", "cut"]
    """marked: noted; repaired: the lost force is added; cut: the curve ends there."""
    min_drop: Force
    """Smaller drops of force are ignored."""


class Slack(Block):
    """Toe compensation: displacement starts where a line through the steep part has zero force."""

    start: Annotated[Fraction, Key("from"), "Start, such as 10 % of the largest force"]
    stop: Annotated[
        Fraction, Key("to"), LargerThan("start", "from"), "End, such as 30 % of the largest force"
    ]


class ElasticLine(Block):
    """Straight part of a tension test in stress and strain: the longest one, or a stated window."""

    start: Annotated[Ratio | None, Key("from"), "Start of a window, such as 0.05 % strain"] = None
    stop: Annotated[Ratio | None, Key("to"), "End of the window, such as 0.25 % strain"] = None
    of: Literal["strain", "strength"] = "strain"
    """Quantity of from and to: the strain, or the stress as a fraction of the largest stress."""
    straight: Fraction = 0.9998
    """Smallest r^2 of the line if no window is stated."""

    @classmethod
    def find_contradictions(cls, data: Values) -> Iterator[Fault]:
        """Find a window with one end."""
        if ("from" in data) != ("to" in data):
            stated_key, missing_key = ("from", "to") if "from" in data else ("to", "from")
            yield Fault.of(
                "protocol.half_window", (stated_key,), given=stated_key, missing=missing_key
            )


class CurveBlock(Block):
    """Channels of the curve, and its corrections in the order of the keys."""

    force: Snake
    """Channel of the force."""
    displacement: Snake
    """Channel of the displacement."""
    reverse: tuple[Literal["force", "displacement"], ...] | None = None
    """Channels, force or displacement, that decrease as the specimen is loaded; an empty list
    confirms their signs."""
    compliance: MachineCompliance | None = None
    failure: Failure | None = None
    slips: Slips | None = None
    slack: Slack | None = None
    elastic_line: ElasticLine | None = None


class Branches(Block):
    """Loading and unloading branches, into which the curve is split."""

    channel: Snake
    """Channel whose turning points separate the branches."""
    min_stroke: Length
    """Smallest motion between two turning points; a smaller one is noise."""


def _check_display(units: dict[str, str]) -> dict[str, str]:
    """Refuse units of unknown quantities, and units of another dimension."""
    faults = []
    for quantity, unit in units.items():
        path, si_unit = (quantity,), SI_UNITS.get(quantity)
        if si_unit is None:
            expected = "one of the quantities"
            faults.append(build_choice_fault(path, quantity, SI_UNITS, expected, at="key"))
        elif try_parse_quantity(f"1 {unit}", si_unit) is None:
            example, found = f"{quantity} such as {si_unit}", repr(unit)
            faults.append(Fault.of("protocol.no_unit", path, quantity=example, found=found))
    raise_faults(faults)
    return units


class Report(Block):
    """Units and figures of the report."""

    display: Annotated[dict[str, Text], AfterValidator(_check_display)] = Field({})
    """Unit of each quantity, such as force: mN."""
    figures: tuple[_FigureName, ...] = ()
    """Figures of each test, in this order."""
    style: Literal["page", "journal"] = "page"
    """Style of figures: as on the page, or with a serif font for a journal."""


LotFraction: TypeAlias = Annotated[float, Quantity("1", "%", "99 %", minimum=0.5, maximum=0.9999)]


class Groups(Block):
    """Settings with which `labpipe report` groups and compares the samples of one type."""

    main: tuple[Text, ...] = ()
    """Results that are shown first; groups are compared by the first of them."""
    scaled: bool = False
    """Whether curves of force / peak force are plotted, too."""
    min_p: Fraction = 0.05
    """Smallest p-value of a difference between spools with which they may be pooled."""
    max_spool_share: Fraction = 0.1
    """Fraction of the variance that is due to spools; if it is significantly smaller, spools are
    pooled."""
    coverage: LotFraction = 0.99
    """Fraction of a lot that must reach its force-limit."""
    confidence: LotFraction = 0.95
    """Confidence that this fraction of the lot reaches it."""
    margin: Fraction | None = None
    """Irrelevant difference of two groups, as a fraction of the first."""


def _parse_version(value: object) -> int:
    """Accept the only known version of the file format."""
    if str(value) != "1":
        raise build_refusal("protocol.unknown_version", found=value)
    return 1


Version: TypeAlias = Annotated[Literal[1], BeforeValidator(_parse_version)]


def _number_steps(steps: tuple[Step, ...]) -> tuple[Step, ...]:
    return tuple(step.with_number(index) for index, step in enumerate(steps))


class Protocol(Block):
    """Settings that process one kind of test, from its exports to its results."""

    version: Version
    name: FileStem
    """Name of the file without .yaml."""
    about: Remark = ""
    """Purpose, in one line."""
    follow_links: bool = False
    """Whether exports may be links to files outside the folder of the test."""
    sources: Annotated[dict[Role, Source], Field(min_length=1), AfterValidator(assign_roles)]
    """Export of each role."""
    specimen: SpecimenBlock = SpecimenBlock.model_construct()
    rig: Rig = Rig.model_construct()
    questions: dict[Snake, tuple[Text, ...]] = Field({})
    """Valid answers to each question; a test sheet answers in specimen.observed."""
    markers: Markers | None = None
    align: Align = AlignNone.model_construct()
    steps: Annotated[tuple[Step, ...], AfterValidator(_number_steps)] = ()
    curve: CurveBlock | None = None
    branches: Branches | None = None
    results: tuple[ResultEntry, ...] = ()
    """Results, in the order of the summary."""
    report: Report = Report.model_construct()
    groups: Groups = Groups.model_construct()
    plausible: Plausible = Field({})
    """Plausible range of each kind of dimension; by default the shipped one."""
    limits: Limits = LIMITS
    """Differences beyond which a result is doubtful."""

    @property
    def channels(self) -> dict[str, ChannelSource]:
        """Return the channels of all sources by name."""
        sources = self.sources.values()
        return {
            name: channel for source in sources for name, channel in source.all_channels.items()
        }

    @classmethod
    def find_contradictions(cls, data: Values) -> Faults:
        """Find contradictions between the blocks of the protocol."""
        outline = Outline(data)
        yield from _find_repeated_channels(outline)
        yield from _find_unmet_needs(outline)
        yield from _find_step_faults(outline)
        yield from _find_curve_faults(outline)
        yield from _find_result_faults(outline)
        yield from _find_unknown_main_results(outline)

    @model_validator(mode="after")
    def _check_sizes(self) -> Self:
        """Refuse implausible dimensions, and two different uncertainties of one length."""
        blocks = {"specimen": self.specimen, "rig": self.rig, "markers": self.markers}
        faults = [*find_implausible_sizes(blocks, (), self.plausible)]
        uncertainties = self.specimen.uncertainty or SizeUncertainties()
        for index, result in enumerate(self.results):
            if not isinstance(result, BendingStiffness):
                continue
            key = "length" if result.support == "cantilever" else "span"
            result_value, specimen_value = result.length_uncertainty, getattr(uncertainties, key)
            if result_value is not None and specimen_value not in (None, result_value):
                fault = Fault.of(
                    "protocol.length_twice",
                    ("results", index, "length_uncertainty"),
                    key=key,
                    result_value=f"{1e3 * result_value:.6g} mm",
                    specimen_value=f"{1e3 * specimen_value:.6g} mm",
                )
                faults.append(fault)
        raise_faults(faults)
        return self


_CLAMP = "a clamped end"
_BRANCHES, _MARKERS = "a block 'branches'", "a block 'markers'"
_ALIGNMENT = "a method that aligns two clocks"
_REMEDIES = {
    _MARKER_SOURCE: "Add the source 'markers'.",
    _CLAMP: "Name the rigid body at the clamp in 'markers.clamp'.",
    _ALIGNMENT: "Set 'align.method' to 'turning-points'.",
    _SHAPE_STEP: "Add the step 'fit-shape'.",
}
_FROM_SPEED = "travel-from-speed"
_ALIGNMENTS = ("turning-points", "common-start", "stated")
_CYCLE_SUFFIX = re.compile(r"\.\d+$")
"""Number of the cycle or slip at the end of the name of a result."""


class Outline:
    """Channels, steps and results of a protocol as written, valid or not.

    Parameters
    ----------
    data : the protocol as plain values

    Attributes
    ----------
    has_clamp : whether ``markers.clamp`` names a rigid body
    channels : name, role, path and block of each channel of a source
    steps, results : path, name in YAML and block of each entry
    source_channels, step_channels : names of the channels that sources give and that steps add
    clocks : role of the export whose clock a channel has, keyed by channel; None if unknown
    units : SI unit of a channel, keyed by channel; None if unknown
    """

    def __init__(self, data: Values) -> None:
        self.data = data
        self.has_clamp = self.get_block("markers").get("clamp") is not None
        self.channels = [*_list_channels(self.get_block("sources"))]
        self.steps = _list_entries(data, "steps", "step")
        self.results = _list_entries(data, "results", "result")
        self.source_channels = [name for name, *_ in self.channels]
        self.step_channels = list[str]()
        self.clocks: dict[str, str | None] = {}
        self.units: dict[str, str | None] = {}
        for name, role, _, block in reversed(self.channels):
            self.clocks[name] = role
            self.units[name] = SI_UNITS.get(str(block.get("quantity", name)))
        for _, kind, step in self.steps:
            clock = self.clocks.get(str(step.get("force"))) if kind == _FROM_SPEED else "markers"
            for name in self.list_added_channels(kind, step):
                self.clocks.setdefault(name, clock)
                self.units[name] = "m"
                self.step_channels.append(name)

    def get_block(self, *path: str) -> Values:
        """Return the block at a path; an empty one if there is none."""
        return get_block(self.data, *path)

    def list_added_channels(self, kind: str, step: Values) -> tuple[str, ...]:
        """List the channels that a step adds; those of a cantilever are added only with a clamp."""
        if kind not in STEPS or (kind in ("specimen-frame", "fit-shape") and not self.has_clamp):
            return ()
        values = {"channel": None, **step}
        return tuple(name.format_map(values) for name in STEPS[kind].added_channels)

    def list_met_needs(self) -> Iterator[str]:
        """Yield the needs of steps, results and figures that the protocol meets."""
        sources, curve = self.get_block("sources"), self.get_block("curve")
        readers = [str(get_block(sources, role).get("reader")) for role in sources]
        kinds = {kind for _, kind, _ in self.steps}
        conditions = {
            _MARKER_SOURCE: "markers" in sources or MARKER_READERS & {*readers},
            _CLAMP: self.has_clamp,
            _ALIGNMENT: self.get_block("align").get("method") in _ALIGNMENTS,
            _SHAPE_STEP: kinds & {"fit-shape", "three-point-shape"},
        }
        yield from (need for need, is_met in conditions.items() if is_met)
        yield from (f"a block {key!r}" for key in self.data if self.get_block(key))
        yield from (f"a block 'curve.{key}'" for key in curve if get_block(curve, key))
        yield from (f"the step {kind!r}" for kind in kinds)
        yield from (f"a result {kind!r}" for _, kind, _ in self.results)


def _list_channels(sources: Values) -> Iterator[tuple[str, str, KeyPath, Values]]:
    """Yield name, role, path and block of channels; a misspelt role is read as the nearest one."""
    for role in sources:
        source, path = get_block(sources, role), ("sources", role)
        camera_keys = {"scale_uncertainty", "certificate"} if role == "markers" else set()
        if source.keys() & ChannelSource.model_fields.keys() - camera_keys:
            name = role if role in ROLES else sort_by_likeness(role, list(ROLES), limit=1)[0]
            yield name, role, path, source
        for name in get_block(source, "channels"):
            yield name, role, (*path, "channels", name), get_block(source, "channels", name)


def _list_entries(data: Values, key: str, kind_key: str) -> list[tuple[KeyPath, str, Values]]:
    """List path, kind and block of the entries of a list that have a kind."""
    return [
        ((key, index), item[kind_key], item)
        for index, item in enumerate(get_list(data, key))
        if isinstance(item, Mapping) and isinstance(item.get(kind_key), str)
    ]


def list_result_names(name: str, entry: Values) -> tuple[str, ...]:
    """List the names that an entry of ``results`` has in the summary.

    Parameters
    ----------
    name : name of the kind of result in YAML, such as ``two-segments``
    entry : the block as written, which may state its own name

    Returns
    -------
    The name of each number of the kind; for one number per cycle or slip, the name of the first.
    Empty for an unknown kind.
    """
    kind = KINDS_BY_NAME.get(name)
    return () if kind is None else tuple(output.name_in(kind, entry) for output in kind.outputs)


def _find_repeated_channels(outline: Outline) -> Faults:
    """Find channels with one name; a step may replace the channel of an optional source."""
    owners = dict.fromkeys(outline.step_channels, "a step")
    from_speed = {
        str(step.get("channel")) for _, kind, step in outline.steps if kind == _FROM_SPEED
    }
    for name, role, path, _ in outline.channels:
        is_optional = str(outline.get_block("sources", role).get("optional")).lower() == "true"
        if not (name in from_speed and is_optional):
            if name in owners:
                yield Fault.of(
                    "protocol.channel_taken", path, at="key", name=name, owner=owners[name]
                )
            owners[name] = f"the source {role!r}"


def _find_unmet_needs(outline: Outline) -> Faults:
    """Find needs of steps, results and figures that the protocol does not meet."""
    provided = {*outline.list_met_needs()}
    for path, user, need in _list_needs(outline):
        if need not in provided:
            remedy = _REMEDIES.get(need, f"Add {need}.").replace("Add a ", "Add the ")
            if user in KINDS_BY_NAME and need.startswith("a block 'curve."):
                override = format_overrides(f"results.{user}", "null")
                remedy = f"{remedy[:-1]}, or remove the result: {override}."
            yield Fault.of("protocol.lacking", path, need=need, user=user, remedy=remedy)


def _list_needs(outline: Outline) -> Iterator[tuple[KeyPath, str, str]]:
    """Yield path, name and need of each step, result, figure and block that needs another one."""
    curve, align = outline.get_block("curve"), outline.get_block("align")
    users: list[tuple[KeyPath, str, Iterable[str]]] = []
    for path, name, _ in outline.steps:
        uses_markers = name in STEPS and STEPS[name].uses_markers
        needs = (_MARKER_SOURCE, _MARKERS) if uses_markers else ()
        users.append(((*path, "step"), name, needs))
    for path, name, _ in outline.results:
        users.append(((*path, "result"), name, _list_result_needs(name, curve)))
    for index, name in enumerate(get_list(outline.data, "report", "figures")):
        users.append((("report", "figures", index), name, FIGURES.get(str(name), ())))
    if align.get("method") == "turning-points":
        users.append((("align", "method"), "turning-points", (_MARKER_SOURCE, _CLAMP)))
    if outline.get_block("branches"):
        users.append((("branches",), "branches", [_CURVE]))
    clocks = {outline.clocks.get(str(curve.get(key))) for key in ("force", "displacement")}
    if len(clocks - {None}) > 1:
        users.append((("align", "method") if align else ("curve",), "curve", [_ALIGNMENT]))
    return ((path, name, need) for path, name, needs in users for need in needs)


def _list_result_needs(name: str, curve: Values) -> list[str]:
    """List the needs of a kind of result; a correction is needed only where there is a curve."""
    needs = KINDS_BY_NAME[name].needs if name in KINDS_BY_NAME else Needs()
    conditions = {
        **dict.fromkeys((_CURVE, _BRANCHES), needs.branches),
        _ALIGNMENT: needs.clocks,
        f"the step {needs.shape!r}": needs.shape,
        _CLAMP: needs.clamp,
        f"a block 'curve.{needs.correction}'": needs.correction and curve,
    }
    return [need for need, is_needed in conditions.items() if is_needed]


def _find_step_faults(outline: Outline) -> Faults:
    """Find steps in the wrong order, and steps on channels that do not exist."""
    channels, earlier_steps = list(outline.source_channels), list[str]()
    for path, name, step in outline.steps:
        kind, kind_path = STEPS.get(name), (*path, "step")
        if kind is not None and kind.uses_markers:
            if name in earlier_steps:
                yield Fault.of("protocol.step_again", kind_path, step=name)
            needed = kind.required_step
            if needed and needed not in earlier_steps:
                yield Fault.of("protocol.step_before", kind_path, step=name, needed=needed)
        for key in list_references(kind, "channel") if kind is not None else ("channel",):
            yield from _find_channel_faults(step, (*path, key), channels, outline.step_channels)
        if name == _FROM_SPEED:
            yield from _find_speed_faults(outline, step, kind_path)
        span = str(step.get("span")).strip()
        if span.endswith("%") and not outline.get_block("branches"):
            yield Fault.of("protocol.span_of_no_branch", (*path, "span"), found=repr(span))
        channels += outline.list_added_channels(name, step)
        earlier_steps.append(name)


def _find_speed_faults(outline: Outline, step: Values, path: KeyPath) -> Faults:
    """Find several cycles, and a missing speed or stroke if no source measures the travel."""
    rig = outline.get_block("rig")
    if rig.get("cycles") not in (None, "1", 1):
        yield Fault.of("protocol.many_cycles", ("rig", "cycles"), found=rig["cycles"])
    if step.get("channel") not in outline.source_channels:
        for key in {"crosshead_speed", "stroke"} - {*rig}:
            yield Fault.of("protocol.no_speed", path, key=key)


def _find_channel_faults(
    block: Values, path: KeyPath, channels: Sequence[str], later_channels: Collection[str] = ()
) -> Faults:
    """Find a channel that does not exist, or not yet; its name is at the last key of the path."""
    name = block.get(str(path[-1]))
    if not isinstance(name, str) or name in channels:
        return
    if name in later_channels:
        yield Fault.of("protocol.channel_later", path, name=name)
    elif channels:
        yield build_choice_fault(path, name, channels, "one of the channels")
    else:
        yield Fault.of("protocol.no_channel_at_all", path, name=name)


def _find_curve_faults(outline: Outline) -> Faults:
    """Find channels of the curve, its branches and its clocks that do not exist or do not fit."""
    curve, align = outline.get_block("curve"), outline.get_block("align")
    channels = outline.source_channels + outline.step_channels
    if align.get("method") in _ALIGNMENTS:
        yield from _find_channel_faults(align, ("align", "channel"), outline.source_channels)
    uses = (("curve", "force", "N"), ("curve", "displacement", "m"), ("branches", "channel", "m"))
    for block, key, si_unit in uses:
        name, path = outline.get_block(block).get(key), (block, key)
        yield from _find_channel_faults(outline.get_block(block), path, channels)
        channel_unit = outline.units.get(str(name))
        if channel_unit not in (None, si_unit):
            yield Fault.of(
                "protocol.channel_unit", path, unit=si_unit, name=name, channel_unit=channel_unit
            )
    for quantity in get_list(curve, "reverse"):
        name = curve.get(quantity) if isinstance(quantity, str) else None
        if name in outline.step_channels and name not in outline.source_channels:
            yield Fault.of("protocol.reverse_of_made", ("curve", "reverse"), name=name)


def _find_result_faults(outline: Outline) -> Faults:
    """Find repeated results, stiffnesses that do not exist, and a displacement on another clock."""
    earlier_names, stiffnesses = set[str](), list[str]()
    displacement = str(outline.get_block("curve").get("displacement"))
    for path, kind_name, entry in outline.results:
        kind = KINDS_BY_NAME.get(kind_name)
        if kind is None:
            continue
        settings, kind_path = {**list_defaults(kind), **entry}, (*path, "result")
        if kind.needs.clamp and outline.clocks.get(displacement) not in (None, "markers"):
            found = displacement
            yield Fault.of("protocol.clock_of_force", kind_path, result=kind_name, found=found)
        for key in list_references(kind, "stiffness"):
            name = settings.get(key)
            if isinstance(name, str) and not stiffnesses:
                yield Fault.of("protocol.no_stiffness", (*path, key), name=name)
            elif isinstance(name, str) and name not in stiffnesses:
                valid = "one of the stiffnesses above,"
                yield build_choice_fault((*path, key), name, stiffnesses, valid)
        names = list_result_names(kind_name, entry)
        repeated_names = [name for name in names if name in earlier_names]
        if repeated_names:
            yield Fault.of("protocol.result_again", kind_path, name=repeated_names[0])
        earlier_names |= {*names}
        stiffnesses += [
            name
            for name, output in zip(names, kind.outputs, strict=True)
            if output.unit == "N/m" and output.first is None
        ]


def _find_unknown_main_results(outline: Outline) -> Faults:
    """Find main results of groups that no entry of ``results`` gives."""
    names = [name for _, kind, entry in outline.results for name in list_result_names(kind, entry)]
    names_per_cycle = {_CYCLE_SUFFIX.sub("", name) for name in names if _CYCLE_SUFFIX.search(name)}
    for index, name in enumerate(get_list(outline.data, "groups", "main")):
        path: KeyPath = ("groups", "main", index)
        base_name = _CYCLE_SUFFIX.sub("", str(name))
        if name in names or (base_name != name and base_name in names_per_cycle):
            continue
        if names:
            yield build_choice_fault(path, name, names, "one of the results")
        else:
            yield Fault.of("protocol.no_results", path, name=name)
