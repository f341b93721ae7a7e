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
    parse_or_none,
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
    find_implausible_sizes,
    name_sources,
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
    Share,
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
    """Of the extensometer whose channel is the displacement of the curve."""
    span: Length | None = None
    """Distance between the supports."""
    mass_per_length: LinearMass | None = None
    """For the deflection of a cantilever by its weight, which is else ignored."""
    section: Section | None = None
    uncertainty: SizeUncertainties | None = None
    """Standard uncertainties of these dimensions; a test sheet overrides them."""

    @field_validator("uncertainty")
    @classmethod
    def _check_uncertainties(cls, sizes: Any, info: ValidationInfo) -> Any:
        """Refuse uncertainties that are not below the dimension."""
        dimensions = {**vars(info.data.get("section") or Section()), **info.data}
        raise_faults(
            Fault.of("protocol.size_unknown", (key,), key=key)
            for key, uncertainty in (sizes.by_key if sizes else {}).items()
            if uncertainty >= (dimensions.get(key) or math.inf)
        )
        return sizes


class LoadString(Block):
    """The string between specimen and load cell."""

    length: Length
    counterweight: Mass = 0.0
    """Mass that hangs at the tip."""
    at_rest: Literal["by-data", "taut", "slack"] = "by-data"
    """Whether the string carried the counterweight before the test."""


class Rig(Block):
    """Settings of the machine, for checks, the string, and `travel-from-speed`."""

    crosshead_speed: Speed | None = None
    stroke: Length | None = None
    cycles: Annotated[int, WholeNumber(1, 1_000_000)] | None = None
    string: LoadString | None = None


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
    """Where the markers of a take are on the specimen."""

    clamp: Text | None
    """Rigid body at the clamped end; null if there is none."""
    along: MarkerNames = "all"
    """Markers along the specimen: all, or a list of names and patterns."""
    rings: Literal["none", "by-body"] = "none"
    """by-body: the markers of one body give the centre of their ring."""
    grip_offset: Offset = 0.0
    """From the pivot of the clamp to the clamped end."""
    pull_offset: Distance = 0.0
    """From the last marker to the string, along the specimen."""
    centre_offset: Offset = 0.0
    """From the axis to the centre of a marker, towards the pull."""
    offset_uncertainty: Distance = 0.0
    """Standard uncertainty of each of grip_offset and pull_offset."""
    centre_uncertainty: Distance = 0.0
    """Standard uncertainty of centre_offset."""


class AlignNone(Block):
    """All channels have one clock."""

    method: Literal["none"] = "none"


class AlignTurningPoints(Block):
    """Two clocks, aligned by turning points that both recordings show."""

    method: Literal["turning-points"]
    channel: Snake
    """Channel whose corners mark the turning points."""
    motion_window: Duration
    """On each side of a turning point of the clamp."""
    force_window: Duration
    """On each side of a corner of the channel."""
    max_residual: Duration
    """Larger residuals are doubtful."""
    max_drift: Ratio
    """A larger drift is doubtful."""


class AlignCommonStart(Block):
    """Two recorders that started together; a corner of the force at a turning point checks it."""

    method: Literal["common-start"]
    channel: Snake
    """Channel whose corner marks the turning point."""
    max_offset: Duration
    """Largest delay of the later recorder."""
    max_drift: Ratio = 1e-4
    """Largest relative difference of the clock rates."""
    motion_window: Duration = 10.0
    """On each side of a turning point of the motion."""
    force_window: Duration = 1.0
    """On each side of a corner of the channel."""


class AlignStated(Block):
    """A stated relation of the clocks: force time = offset + (1 + drift) x motion time."""

    method: Literal["stated"]
    channel: Snake | None = None
    """A channel on the clock of the force; else the force of the curve."""
    offset: Moment
    """Force time at motion time zero."""
    drift: Drift = 0.0
    """Relative excess of the rate of the force clock."""
    uncertainty: Duration | None = None
    """Standard uncertainty of the offset; else one sample."""
    because: Text
    """Source of the offset."""
    motion_window: Duration = 10.0
    """On each side of a turning point of the motion."""


Align: TypeAlias = Annotated[
    AlignNone | AlignTurningPoints | AlignCommonStart | AlignStated, Field(discriminator="method")
]


class MachineCompliance(Block):
    """Compliance of frame and grips; times the force, it is subtracted from the displacement."""

    value: Compliance
    """From a test of a stiff bar, protocol stiff-bar."""
    uncertainty: Uncertainty = 0.0
    """Standard uncertainty, as a share of the value."""


class Failure(Block):
    """Criterion of failure: the force drops suddenly and does not recover."""

    force_below: Share
    """Share of the largest force, such as 50 %."""
    loss: Share = 0.1
    """Smallest drop, as a share of the largest force."""
    within: Duration = 0.05
    """Longest duration of the drop; one sample step if that is longer."""
    at_end_below: Share | None = None
    """A record whose force ends below this share of the largest ends with the break."""


class Slips(Block):
    """What labpipe does where the specimen slips in its grips."""

    decision: Literal["marked", "repaired", "cut"]
    """marked: noted; repaired: the lost force is added; cut: the curve ends there."""
    min_drop: Force
    """Smaller drops of force are ignored."""


class Slack(Block):
    """Toe compensation: displacement starts where a line through the steep part has zero force."""

    start: Annotated[Share, Key("from"), "Of the largest force, such as 10 %"]
    stop: Annotated[
        Share, Key("to"), LargerThan("start", "from"), "Of the largest force, such as 30 %"
    ]


Reverse: TypeAlias = tuple[Literal["force", "displacement"], ...]


class ElasticLine(Block):
    """The straight part of a tension test in stress and strain: the longest one, or a window."""

    start: Annotated[Ratio | None, Key("from"), "Start of a window, such as 0.05 % strain"] = None
    stop: Annotated[Ratio | None, Key("to"), "End of the window, such as 0.25 % strain"] = None
    of: Literal["strain", "strength"] = "strain"
    """What from and to are counted in: strain, or the largest stress."""
    straight: Share = 0.9998
    """Smallest r^2 of the line, where no window is stated."""

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
    displacement: Snake
    reverse: Reverse | None = None
    """force, displacement: channels that decrease as the specimen is loaded; an empty list confirms
    their signs."""
    compliance: MachineCompliance | None = None
    failure: Failure | None = None
    slips: Slips | None = None
    slack: Slack | None = None
    elastic_line: ElasticLine | None = None


class Branches(Block):
    """How the curve is split into loading and unloading branches."""

    channel: Snake
    """Channel whose turning points separate the branches."""
    min_stroke: Length
    """Smaller reversals are noise."""


def _check_display(units: dict[str, str]) -> dict[str, str]:
    """Refuse units of unknown quantities, and units of another dimension."""
    raise_faults(fault for entry in units.items() for fault in _find_display_faults(*entry))
    return units


def _find_display_faults(quantity: str, unit: str) -> Faults:
    path, si_unit = (quantity,), SI_UNITS.get(quantity)
    if si_unit is None:
        yield build_choice_fault(path, quantity, SI_UNITS, "one of the quantities", at="key")
    elif parse_or_none(f"1 {unit}", si_unit) is None:
        example = f"{quantity} such as {si_unit}"
        yield Fault.of("protocol.no_unit", path, quantity=example, found=repr(unit))


DisplayUnits: TypeAlias = Annotated[dict[str, Text], AfterValidator(_check_display)]


class Report(Block):
    """Units and figures of the report."""

    display: DisplayUnits = Field({})
    """Unit of each quantity, such as force: mN."""
    figures: tuple[_FigureName, ...] = ()
    style: Literal["page", "journal"] = "page"
    """Style of figures: as on the page, or with a serif font for a journal."""


LotShare: TypeAlias = Annotated[float, Quantity("1", "%", "99 %", minimum=0.5, maximum=0.9999)]


class Groups(Block):
    """How `labpipe report` groups the samples of one type."""

    main: tuple[Text, ...] = ()
    """Results that are shown first; groups are compared by the first of them."""
    scaled: bool = False
    """Also plot force / peak force of each sample."""
    min_p: Share = 0.05
    """Spools that differ with a smaller p-value are never pooled."""
    max_spool_share: Share = 0.1
    """Spools are pooled only if their share of the variance is significantly below."""
    coverage: LotShare = 0.99
    """Share of a lot that must reach its force-limit."""
    confidence: LotShare = 0.95
    """Confidence that it does."""
    margin: Share | None = None
    """Irrelevant difference of two groups, as a share of the first."""


def _parse_version(value: object) -> int:
    """Accept the only known version of the file format."""
    if str(value) != "1":
        raise build_refusal("protocol.unknown_version", found=value)
    return 1


Version: TypeAlias = Annotated[Literal[1], BeforeValidator(_parse_version)]


class Protocol(Block):
    """How one kind of test is processed, from its exports to its results."""

    version: Version
    name: FileStem
    """Name of the file without .yaml."""
    about: Remark = ""
    """Purpose, in one line."""
    follow_links: bool = False
    """Whether exports may be links to files outside the folder of the test."""
    sources: dict[Role, Source] = Field(min_length=1)
    specimen: SpecimenBlock = SpecimenBlock.model_construct()
    rig: Rig = Rig.model_construct()
    questions: dict[Snake, tuple[Text, ...]] = Field({})
    """What the test sheet answers in specimen.observed: the valid answers by name."""
    markers: Markers | None = None
    align: Align = AlignNone.model_construct()
    steps: tuple[Step, ...] = ()
    curve: CurveBlock | None = None
    branches: Branches | None = None
    results: tuple[ResultEntry, ...] = ()
    """In the order of the summary."""
    report: Report = Report.model_construct()
    groups: Groups = Groups.model_construct()
    plausible: Plausible = Field({})
    """Ranges by kind of dimension; else the shipped ones."""
    limits: Limits = LIMITS
    """Differences beyond which a result is doubtful."""

    @property
    def channels(self) -> dict[str, ChannelSource]:
        """Return the channels of all sources by name."""
        sources = self.sources.values()
        return {
            name: channel for source in sources for name, channel in source.all_channels.items()
        }

    @field_validator("sources")
    @classmethod
    def _name_sources(cls, sources: dict[Role, Source]) -> dict[Role, Source]:
        return name_sources(sources)

    @field_validator("steps")
    @classmethod
    def _set_numbers(cls, steps: tuple[Step, ...]) -> tuple[Step, ...]:
        return tuple(step.numbered(number) for number, step in enumerate(steps))

    @classmethod
    def find_contradictions(cls, data: Values) -> Faults:
        """Find contradictions between the blocks of the protocol."""
        outline = Outline(data)
        for check in (
            *(_check_channels, _check_needs, _check_steps, _check_curve),
            *(_check_results, _check_main_results),
        ):
            yield from check(outline)

    @model_validator(mode="after")
    def _check_sizes(self) -> Self:
        """Refuse implausible dimensions, and two different uncertainties of one length."""
        blocks = {"specimen": self.specimen, "rig": self.rig, "markers": self.markers}
        faults = [*find_implausible_sizes(blocks, (), self.plausible)]
        uncertainties = self.specimen.uncertainty or SizeUncertainties()
        for number, result in enumerate(self.results):
            if not isinstance(result, BendingStiffness):
                continue
            key = "length" if result.support == "cantilever" else "span"
            in_result, in_specimen = result.length_uncertainty, getattr(uncertainties, key)
            if in_result is not None and in_specimen is not None and in_result != in_specimen:
                fault = Fault.of(
                    "protocol.length_twice",
                    ("results", number, "length_uncertainty"),
                    key=key,
                    result_value=f"{1e3 * in_result:.6g} mm",
                    specimen_value=f"{1e3 * in_specimen:.6g} mm",
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


class Outline:
    """Channels, steps and results of a protocol as written, valid or not.

    Parameters
    ----------
    data : the protocol as plain values

    Attributes
    ----------
    has_clamp : whether ``markers.clamp`` names a rigid body
    channels : name, role, path and block of the channels of sources
    steps, results : path, name in YAML and block of each entry
    source_channels, step_channels : names of the channels that sources give and that steps add
    clocks, units : role of the export with the clock, and SI unit, by channel; None if unknown
    """

    def __init__(self, data: Values) -> None:
        self.data = data
        self.has_clamp = self.block("markers").get("clamp") is not None
        self.channels = [*_list_channels(self.block("sources"))]
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
            for name in self.list_added(kind, step):
                self.clocks.setdefault(name, clock)
                self.units[name] = "m"
                self.step_channels.append(name)

    def block(self, *path: str) -> Values:
        """Return the block at a path; an empty one if there is none."""
        return get_block(self.data, *path)

    def list_added(self, kind: str, step: Values) -> tuple[str, ...]:
        """List the channels that a step adds; those of a cantilever are added only with a clamp."""
        if kind not in STEPS or (kind in ("specimen-frame", "fit-shape") and not self.has_clamp):
            return ()
        return tuple(form.format_map({"channel": None, **step}) for form in STEPS[kind].makes)

    def list_provided(self) -> Iterator[str]:
        """Yield what the protocol provides for steps, results and figures, named as their needs."""
        sources, curve = self.block("sources"), self.block("curve")
        readers = [str(get_block(sources, role).get("reader")) for role in sources]
        kinds = {kind for _, kind, _ in self.steps}
        conditions = {
            _MARKER_SOURCE: "markers" in sources or MARKER_READERS & {*readers},
            _CLAMP: self.has_clamp,
            _ALIGNMENT: self.block("align").get("method") in _ALIGNMENTS,
            _SHAPE_STEP: kinds & {"fit-shape", "three-point-shape"},
        }
        yield from (need for need, is_met in conditions.items() if is_met)
        yield from (f"a block {key!r}" for key in self.data if self.block(key))
        yield from (f"a block 'curve.{key}'" for key in curve if get_block(curve, key))
        yield from (f"the step {kind!r}" for kind in kinds)
        yield from (f"a result {kind!r}" for _, kind, _ in self.results)


def _list_channels(sources: Values) -> Iterator[tuple[str, str, KeyPath, Values]]:
    """Yield name, role, path and block of channels; a misspelt role counts as the most similar."""
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
        ((key, number), item[kind_key], item)
        for number, item in enumerate(get_list(data, key))
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
    A name per number; of numbers for several cycles or slips, the first. Empty for an unknown kind.
    """
    kind = KINDS_BY_NAME.get(name)
    return () if kind is None else tuple(output.name_in(kind, entry) for output in kind.outputs)


def _check_channels(outline: Outline) -> Faults:
    """Find two channels of one name; a step may replace the channel of an optional source."""
    owners = dict.fromkeys(outline.step_channels, "a step")
    from_speed = {
        str(step.get("channel")) for _, kind, step in outline.steps if kind == _FROM_SPEED
    }
    for name, role, path, _ in outline.channels:
        is_optional = str(outline.block("sources", role).get("optional")).lower() == "true"
        if not (name in from_speed and is_optional):
            if name in owners:
                yield Fault.of(
                    "protocol.channel_taken", path, at="key", name=name, owner=owners[name]
                )
            owners[name] = f"the source {role!r}"


def _check_needs(outline: Outline) -> Faults:
    """Find needs of steps, results and figures that the protocol does not meet."""
    provided = {*outline.list_provided()}
    for path, user, need in _list_needs(outline):
        if need not in provided:
            remedy = _REMEDIES.get(need, f"Add {need}.").replace("Add a ", "Add the ")
            if user in KINDS_BY_NAME and need.startswith("a block 'curve."):
                override = format_overrides(f"results.{user}", "null")
                remedy = f"{remedy[:-1]}, or remove the result: {override}."
            yield Fault.of("protocol.lacking", path, need=need, user=user, remedy=remedy)


def _list_needs(outline: Outline) -> Iterator[tuple[KeyPath, str, str]]:
    """Yield path, name and need of each step, result, figure and block that needs another one."""
    curve, align = outline.block("curve"), outline.block("align")
    users: list[tuple[KeyPath, str, Iterable[str]]] = []
    for path, name, _ in outline.steps:
        is_on_markers = name in STEPS and STEPS[name].on_markers
        needs = (_MARKER_SOURCE, _MARKERS) if is_on_markers else ()
        users.append(((*path, "step"), name, needs))
    for path, name, _ in outline.results:
        users.append(((*path, "result"), name, _list_result_needs(name, curve)))
    for number, name in enumerate(get_list(outline.data, "report", "figures")):
        users.append((("report", "figures", number), name, FIGURES.get(str(name), ())))
    if align.get("method") == "turning-points":
        users.append((("align", "method"), "turning-points", (_MARKER_SOURCE, _CLAMP)))
    if outline.block("branches"):
        users.append((("branches",), "branches", [_CURVE]))
    clocks = {outline.clocks.get(str(curve.get(key))) for key in ("force", "displacement")}
    if len(clocks - {None}) > 1:
        users.append((("align", "method") if align else ("curve",), "curve", [_ALIGNMENT]))
    return ((path, name, need) for path, name, needs in users for need in needs)


def _list_result_needs(name: str, curve: Values) -> list[str]:
    needs = KINDS_BY_NAME[name].needs if name in KINDS_BY_NAME else Needs()
    conditions = {
        **dict.fromkeys((_CURVE, _BRANCHES), needs.branches),
        _ALIGNMENT: needs.clocks,
        f"the step {needs.shape!r}": needs.shape,
        _CLAMP: needs.clamp,
        f"a block 'curve.{needs.correction}'": needs.correction and curve,
    }
    return [need for need, is_needed in conditions.items() if is_needed]


def _check_steps(outline: Outline) -> Faults:
    channels, earlier_steps = list(outline.source_channels), list[str]()
    for path, name, step in outline.steps:
        kind, place = STEPS.get(name), (*path, "step")
        if kind is not None and kind.on_markers:
            if name in earlier_steps:
                yield Fault.of("protocol.step_again", place, step=name)
            if kind.after and kind.after not in earlier_steps:
                yield Fault.of("protocol.step_before", place, step=name, needed=kind.after)
        for key in list_references(kind, "channel") if kind is not None else ("channel",):
            yield from _check_name(step, (*path, key), channels, outline.step_channels)
        if name == _FROM_SPEED:
            yield from _check_travel_from_speed(outline, step, place)
        span = str(step.get("span")).strip()
        if span.endswith("%") and not outline.block("branches"):
            yield Fault.of("protocol.span_of_no_branch", (*path, "span"), found=repr(span))
        channels += outline.list_added(name, step)
        earlier_steps.append(name)


def _check_travel_from_speed(outline: Outline, step: Values, path: KeyPath) -> Faults:
    """Find several cycles, and a missing speed or stroke if no source measures the travel."""
    rig = outline.block("rig")
    if rig.get("cycles") not in (None, "1", 1):
        yield Fault.of("protocol.many_cycles", ("rig", "cycles"), found=rig["cycles"])
    if step.get("channel") not in outline.source_channels:
        for key in {"crosshead_speed", "stroke"} - {*rig}:
            yield Fault.of("protocol.no_speed", path, key=key)


def _check_name(
    block: Values, path: KeyPath, channels: Sequence[str], later_channels: Collection[str] = ()
) -> Faults:
    """Find a channel that does not exist, or not yet; the last key of the path states its name."""
    name = block.get(str(path[-1]))
    if not isinstance(name, str) or name in channels:
        return
    if name in later_channels:
        yield Fault.of("protocol.channel_later", path, name=name)
    elif channels:
        yield build_choice_fault(path, name, channels, "one of the channels")
    else:
        yield Fault.of("protocol.no_channel_at_all", path, name=name)


def _check_curve(outline: Outline) -> Faults:
    curve, align = outline.block("curve"), outline.block("align")
    channels = outline.source_channels + outline.step_channels
    if align.get("method") in _ALIGNMENTS:
        yield from _check_name(align, ("align", "channel"), outline.source_channels)
    uses = (("curve", "force", "N"), ("curve", "displacement", "m"), ("branches", "channel", "m"))
    for block, key, si_unit in uses:
        name, path = outline.block(block).get(key), (block, key)
        yield from _check_name(outline.block(block), path, channels)
        channel_unit = outline.units.get(str(name))
        if channel_unit not in (None, si_unit):
            yield Fault.of(
                "protocol.channel_unit", path, unit=si_unit, name=name, channel_unit=channel_unit
            )
    for quantity in get_list(curve, "reverse"):
        name = curve.get(quantity) if isinstance(quantity, str) else None
        if name in outline.step_channels and name not in outline.source_channels:
            yield Fault.of("protocol.reverse_of_made", ("curve", "reverse"), name=name)


def _check_results(outline: Outline) -> Faults:
    earlier_names, stiffnesses = set[str](), list[str]()
    displacement = str(outline.block("curve").get("displacement"))
    for path, kind_name, entry in outline.results:
        kind = KINDS_BY_NAME.get(kind_name)
        if kind is None:
            continue
        settings, place = {**list_defaults(kind), **entry}, (*path, "result")
        if kind.needs.clamp and outline.clocks.get(displacement) not in (None, "markers"):
            yield Fault.of("protocol.clock_of_force", place, result=kind_name, found=displacement)
        for key in list_references(kind, "stiffness"):
            name = settings.get(key)
            if isinstance(name, str) and not stiffnesses:
                yield Fault.of("protocol.no_stiffness", (*path, key), name=name)
            elif isinstance(name, str) and name not in stiffnesses:
                valid = "one of the stiffnesses above,"
                yield build_choice_fault((*path, key), name, stiffnesses, valid)
        names = list_result_names(kind_name, entry)
        for name in [name for name in names if name in earlier_names][:1]:
            yield Fault.of("protocol.result_again", place, name=name)
        earlier_names |= {*names}
        stiffnesses += [
            name
            for name, output in zip(names, kind.outputs, strict=True)
            if output.unit == "N/m" and output.first is None
        ]


def _check_main_results(outline: Outline) -> Faults:
    """Find main results of groups that no entry of ``results`` gives."""
    names = [name for _, kind, entry in outline.results for name in list_result_names(kind, entry)]
    per_cycle = {_CYCLE_SUFFIX.sub("", name) for name in names if _CYCLE_SUFFIX.search(name)}
    for number, name in enumerate(get_list(outline.data, "groups", "main")):
        path: KeyPath = ("groups", "main", number)
        base_name = _CYCLE_SUFFIX.sub("", str(name))
        if name in names or (base_name != name and base_name in per_cycle):
            continue
        if names:
            yield build_choice_fault(path, name, names, "one of the results")
        else:
            yield Fault.of("protocol.no_results", path, name=name)
