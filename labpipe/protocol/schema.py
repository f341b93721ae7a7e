"""Define the blocks of a protocol file, and the checks between them.

The checks between blocks also run on a protocol with faults, see `Block.read`: a misspelt key
in one block does not hide a fault of another.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import asdict
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, TypeAlias, Union

from pydantic import AfterValidator, BeforeValidator, Field

from labpipe.errors import Fault, KeyPath, format_overrides
from labpipe.protocol.grammar import (
    SI_UNITS,
    Block,
    FileStem,
    OneOf,
    QuantityName,
    Remark,
    Text,
    format_span,
    try_parse_quantity,
)
from labpipe.protocol.source import (
    MARKER_READERS,
    ROLES,
    ChannelSource,
    Plausible,
    RoleKey,
    Section,
    SizeUncertainties,
    Source,
    assign_roles,
    find_implausible_sizes,
)
from labpipe.protocol.yaml_text import Values, build_choice_fault, build_refusal
from labpipe.records.declarations import (
    LIMITS,
    STEPS,
    Compliance,
    Distance,
    Drift,
    Duration,
    FitShape,
    Force,
    Fraction,
    Key,
    LargerThan,
    Length,
    Limits,
    LinearMass,
    Mass,
    Needs,
    Offset,
    Quantity,
    Ratio,
    SnakeName,
    SpecimenFrame,
    Speed,
    Step,
    TaggedChoice,
    TimeOffset,
    TravelFromSpeed,
    Uncertainty,
    WholeNumber,
    list_references,
)
from labpipe.results import KINDS
from labpipe.results.bending import BendingStiffness
from labpipe.results.kinds import Kind

_CURVE, _MARKER_SOURCE = "a block 'curve'", "a source of marker tracks"
_SHAPE_STEP = "a step that computes shapes"
"""Needs of steps, results and figures, as messages name them."""
FIGURE_NEEDS: Final = MappingProxyType(
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
"""Needs of each figure that a protocol can name."""

if TYPE_CHECKING:
    ResultEntry: TypeAlias = Kind
else:
    ResultEntry = Annotated[Union[KINDS], TaggedChoice("result")]  # noqa: UP007 - the members are computed

_FigureName: TypeAlias = Annotated[str, OneOf(tuple(FIGURE_NEEDS))]
KINDS_BY_NAME: Final[Mapping[str, Any]] = {kind.result: kind for kind in KINDS}
"""Kind of result, keyed by its name in YAML."""
Faults: TypeAlias = Iterator[Fault]
"""Faults with their paths in the checked block."""


class SpecimenBlock(Block):
    """Dimensions that all specimens of the protocol share."""

    length: Length | None = None
    """Free length; a test sheet overrides it."""
    gauge_length: Length | None = None
    """Gauge length of the extensometer whose channel is the displacement of the curve."""
    span: Length | None = None
    """Distance between the supports."""
    mass_per_length: LinearMass | None = None
    """Mass per length of a cantilever; without it, the deflection by its weight is ignored."""
    section: Section | None = None
    """Sizes of the cross-section, or its area."""
    uncertainty: SizeUncertainties | None = None
    """Standard uncertainties of these dimensions; a test sheet overrides them."""

    def find_value_faults(self) -> Faults:
        """Find standard uncertainties that are not smaller than their dimension."""
        dimensions = {**vars(self.section or Section()), **vars(self)}
        for key, uncertainty in (self.uncertainty or SizeUncertainties()).by_key.items():
            if uncertainty >= (dimensions.get(key) or math.inf):
                yield Fault.of("protocol.size_unknown", ("uncertainty", key), key=key)


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
    channel: SnakeName
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
    channel: SnakeName
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
    channel: SnakeName | None = None
    """Channel on the clock of the force; by default the force of the curve."""
    offset: TimeOffset
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
    """Compliance of frame and grips, whose product with the force reduces the displacement."""

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
    stop: Annotated[
        Annotated[Ratio, LargerThan("start", "from")] | None,
        Key("to"),
        "End of the window, such as 0.25 % strain",
    ] = None
    of: Literal["strain", "strength"] = "strain"
    """Quantity of from and to: the strain, or the stress as a fraction of the largest stress."""
    straight: Fraction = 0.9998
    """Smallest r^2 of the line if no window is stated."""

    def find_value_faults(self) -> Faults:
        """Find a window of which only one end is stated."""
        if (self.start is None) != (self.stop is None):
            key, absent_key = ("from", "to") if self.stop is None else ("to", "from")
            yield Fault.of("protocol.half_window", (key,), given=key, absent=absent_key)


class CurveBlock(Block):
    """Channels of the curve, and its corrections in the order of the keys."""

    force: SnakeName
    """Channel of the force."""
    displacement: SnakeName
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

    channel: SnakeName
    """Channel whose turning points separate the branches."""
    min_stroke: Length
    """Smallest motion between two turning points; a smaller one is noise."""


class Report(Block):
    """Units and figures of the report."""

    display: dict[QuantityName, Text] = Field({})
    """Unit of each quantity, such as force: mN."""
    figures: tuple[_FigureName, ...] = ()
    """Figures of each test, in this order."""
    style: Literal["page", "journal"] = "page"
    """Style of figures: as on the page, or with a serif font for a journal."""

    def find_value_faults(self) -> Faults:
        """Find units of another dimension."""
        for quantity, unit in self.display.items():
            si_unit, path = SI_UNITS[quantity], ("display", quantity)
            if try_parse_quantity(f"1 {unit}", si_unit) is None:
                example, unit_text = f"{quantity} such as {si_unit}", repr(unit)
                yield Fault.of("protocol.no_unit", path, quantity=example, found=unit_text)


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
    """Confidence that this fraction reaches its force-limit."""
    margin: Fraction | None = None
    """Irrelevant difference of two groups, as a fraction of the first."""


def _parse_version(value: object) -> int:
    """Parse the version of the file format, of which there is only one."""
    if str(value) != "1":
        raise build_refusal("protocol.unknown_version", found=value)
    return 1


Version: TypeAlias = Annotated[Literal[1], BeforeValidator(_parse_version)]


class Protocol(Block):
    """Settings that process one kind of test, from its exports to its results."""

    version: Version
    name: FileStem
    """Name of the file without .yaml."""
    about: Remark = ""
    """Purpose, in one line."""
    follow_links: bool = False
    """Whether exports may be links to files outside the folder of the test."""
    sources: Annotated[dict[RoleKey, Source], Field(min_length=1), AfterValidator(assign_roles)]
    """Export of each role."""
    specimen: SpecimenBlock = SpecimenBlock.model_construct()
    rig: Rig = Rig.model_construct()
    questions: dict[SnakeName, Annotated[tuple[Text, ...], Field(min_length=1)]] = Field({})
    """Valid answers to each question; a test sheet answers in specimen.observed."""
    markers: Markers | None = None
    align: Align = AlignNone.model_construct()
    steps: Annotated[
        tuple[Step, ...],
        # In a draft, None stands for a step of an unknown kind.
        AfterValidator(lambda x: tuple(step and step.with_index(i) for i, step in enumerate(x))),
    ] = ()
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
        """Return the channels of all sources, keyed by name."""
        sources = self.sources.values()
        return {name: x for source in sources for name, x in source.all_channels.items()}

    @property
    def has_clamp(self) -> bool:
        """Return whether ``markers.clamp`` names a rigid body."""
        markers = self.markers
        # In a draft, the key may be missing, and is then not known to be null.
        return markers is not None and not (
            markers.clamp is None and "clamp" in markers.model_fields_set
        )

    @property
    def clocks(self) -> dict[str, str | None]:
        """Return the role of the export whose clock a channel has, keyed by channel.

        The role is None for a channel that is computed from an unknown one.
        """
        clocks: dict[str, str | None] = {
            name: role
            for role, source in reversed((self.sources or {}).items())
            for name in source.all_channels
        }
        for step in self.steps:
            clock = clocks.get(step.force) if isinstance(step, TravelFromSpeed) else "markers"
            for name in self.list_added_channels(step):
                clocks.setdefault(name, clock)
        return clocks

    def list_added_channels(self, *steps: Step) -> list[str]:
        """List the channels that steps add; those of a cantilever are added only with a clamp."""
        return [
            name.format(channel=getattr(step, "channel", None))
            for step in filter(None, steps)
            if self.has_clamp or not isinstance(step, SpecimenFrame | FitShape)
            for name in step.added_channels
        ]

    def find_key_faults(self) -> Faults:
        """Find contradictions between the blocks of the protocol."""
        sources = self.sources or {}
        for role in sources.keys() - {*ROLES}:
            yield build_choice_fault(("sources", role), role, ROLES, is_key=True)
        # The channels of a source at fault may be unknown; then it has no reader either. A step of
        # an unknown kind may add any channel.
        if sources and all(source.reader for source in sources.values()) and all(self.steps):
            yield from _find_repeated_channels(self)
            yield from _find_step_faults(self)
            yield from _find_curve_faults(self)
        yield from _find_need_faults(self)
        yield from _find_result_faults(self)
        yield from find_unknown_main_results(self)

    def find_value_faults(self) -> Faults:
        """Find implausible dimensions, and two different uncertainties of one length."""
        blocks = {"specimen": self.specimen, "rig": self.rig, "markers": self.markers}
        yield from find_implausible_sizes(blocks, (), self.plausible)
        uncertainties = self.specimen.uncertainty or SizeUncertainties()
        for index, result in enumerate(self.results):
            if not isinstance(result, BendingStiffness):
                continue
            key, result_value = result.length_key, result.length_uncertainty
            specimen_value = getattr(uncertainties, key)
            if result_value is not None and specimen_value not in (None, result_value):
                yield Fault.of(
                    "protocol.length_twice",
                    ("results", index, "length_uncertainty"),
                    key=key,
                    result_value=f"{1e3 * result_value:.6g} mm",
                    specimen_value=f"{1e3 * specimen_value:.6g} mm",
                )


_CLAMP = "a clamped end"
_BRANCHES, _MARKERS = "a block 'branches'", "a block 'markers'"
_ALIGNMENT = "a method that aligns two clocks"
_REMEDIES = {
    _MARKER_SOURCE: "Add the source 'markers'.",
    _CLAMP: "Name the rigid body at the clamp in 'markers.clamp'.",
    _ALIGNMENT: "Set 'align.method' to 'turning-points'.",
    _SHAPE_STEP: "Add the step 'fit-shape'.",
}
"""Remedy of each need that a protocol does not meet; by default, the need has to be added."""
_CYCLE_SUFFIX = re.compile(r"\.\d+$")
"""Number of the cycle or slip at the end of the name of a result."""


def list_result_names(kind_name: str, entry: Values) -> tuple[str, ...]:
    """List the names that an entry of ``results`` has in the summary.

    Parameters
    ----------
    kind_name : name of the kind of result in YAML, such as ``two-segments``
    entry : the entry as written, which may state a name

    Returns
    -------
    The name of each output of the kind; for results per cycle or slip, that of the first one.
    Empty for an unknown kind.
    """
    kind = KINDS_BY_NAME.get(kind_name)
    return tuple(output.format_name(kind, entry) for output in kind.outputs) if kind else ()


def list_summary_names(result: Kind) -> tuple[str, ...]:
    """List the names that a result has in the summary, see `list_result_names`."""
    return list_result_names(result.result, asdict(result))


def _find_repeated_channels(protocol: Protocol) -> Faults:
    """Find channels with the same name; a step may replace the channel of an optional source."""
    owners = dict.fromkeys(protocol.list_added_channels(*protocol.steps), "a step")
    speed_channels = {step.channel for step in protocol.steps if isinstance(step, TravelFromSpeed)}
    for role, source in protocol.sources.items():
        for name, channel in source.all_channels.items():
            if name in speed_channels and source.optional:
                continue
            if name in owners:
                path: KeyPath = ("sources", role)
                path += () if channel is source else ("channels", name)
                owner = owners[name]
                yield Fault.of("protocol.channel_taken", path, is_key=True, name=name, owner=owner)
            owners[name] = f"the source {role!r}"


def _find_need_faults(protocol: Protocol) -> Faults:
    """Find needs of steps, results and figures that the protocol does not meet."""
    for path, user, need in list_unmet_needs(protocol):
        remedy = _REMEDIES.get(need, f"Add {need}.").replace("Add a ", "Add the ")
        if user in KINDS_BY_NAME and need.startswith("a block 'curve."):
            override = format_overrides(f"results.{user}", "null")
            remedy = f"{remedy[:-1]}, or remove the result: {override}."
        yield Fault.of("protocol.lacking", path, need=need, user=user, remedy=remedy)


def _list_met_needs(protocol: Protocol) -> Iterator[str]:
    """Yield the needs of steps, results and figures that a protocol meets."""
    # In a draft, an entry of an unknown kind may be any step or result.
    steps = {step.step for step in protocol.steps} if all(protocol.steps) else {*STEPS}
    results = [x.result for x in protocol.results] if all(protocol.results) else [*KINDS_BY_NAME]
    sources = protocol.sources or {}
    readers = {reader for source in sources.values() for reader in source.reader or ()}
    conditions = {
        # Sources with a fault are None in a draft; which of them exist is then unknown.
        _MARKER_SOURCE: not protocol.sources or "markers" in sources or MARKER_READERS & readers,
        _CLAMP: protocol.has_clamp,
        _ALIGNMENT: not protocol.align or protocol.align.method != "none",
        _SHAPE_STEP: steps & {"fit-shape", "three-point-shape"},
        _CURVE: protocol.curve,
        _BRANCHES: protocol.branches,
        _MARKERS: protocol.markers,
    }
    yield from (need for need, is_met in conditions.items() if is_met)
    yield from (f"a block 'curve.{key}'" for key, value in protocol.curve or () if value)
    yield from (f"the step {step!r}" for step in steps)
    yield from (f"a result {result!r}" for result in results)


def list_unmet_needs(protocol: Protocol) -> list[tuple[KeyPath, str, str]]:
    """List path, name and unmet need of each step, result, figure and block."""
    curve, align = protocol.curve, protocol.align
    users: list[tuple[KeyPath, str, Iterable[str]]] = []
    for step in (step for step in protocol.steps if step):
        needs = (_MARKER_SOURCE, _MARKERS) if step.uses_markers else ()
        users.append((("steps", step.index, "step"), step.step, needs))
    for path, result in _list_results(protocol):
        users.append(((*path, "result"), result.result, _list_result_needs(result.needs, curve)))
    for index, name in enumerate(protocol.report.figures):
        users.append((("report", "figures", index), name, FIGURE_NEEDS.get(name, ())))
    if align and align.method == "turning-points":
        users.append((("align", "method"), "turning-points", (_MARKER_SOURCE, _CLAMP)))
    if protocol.branches:
        users.append((("branches",), "branches", [_CURVE]))
    channels = (curve.force, curve.displacement) if curve else ()
    if len({*map(protocol.clocks.get, channels)} - {None}) > 1:
        is_stated = "align" in protocol.model_fields_set
        users.append((("align", "method") if is_stated else ("curve",), "curve", [_ALIGNMENT]))
    met_needs = {*_list_met_needs(protocol)}
    user_needs = ((path, name, need) for path, name, needs in users for need in needs)
    return [user_need for user_need in user_needs if user_need[-1] not in met_needs]


def _list_results(protocol: Protocol) -> list[tuple[KeyPath, Kind]]:
    """List path and settings of the results; in a draft, None stands for an unknown kind."""
    return [(("results", index), x) for index, x in enumerate(protocol.results) if x]


def _list_result_needs(needs: Needs, curve: CurveBlock | None) -> list[str]:
    """List the needs of a result; a correction is needed only where there is a curve."""
    conditions = {
        **dict.fromkeys((_CURVE, _BRANCHES), needs.branches),
        _ALIGNMENT: needs.clocks,
        f"the step {needs.shape!r}": needs.shape,
        _CLAMP: needs.clamp,
        f"a block 'curve.{needs.correction}'": needs.correction and curve,
    }
    return [need for need, is_needed in conditions.items() if is_needed]


def _find_step_faults(protocol: Protocol) -> Faults:
    """Find steps in the wrong order, and steps on channels that do not exist."""
    channels, earlier_steps = [*protocol.channels], list[str]()
    later_channels = protocol.list_added_channels(*protocol.steps)
    for step in protocol.steps:
        path: KeyPath = ("steps", step.index)
        kind_path = (*path, "step")
        if step.uses_markers and step.step in earlier_steps:
            yield Fault.of("protocol.step_again", kind_path, step=step.step)
        required_step = step.required_step
        if required_step and required_step not in earlier_steps:
            yield Fault.of("protocol.step_before", kind_path, step=step.step, needed=required_step)
        for key in list_references(STEPS[step.step], "channel"):
            name = getattr(step, key)
            yield from _find_channel_faults(name, (*path, key), channels, later_channels)
        if isinstance(step, TravelFromSpeed):
            yield from _find_speed_faults(protocol, step, kind_path)
        span = getattr(step, "span", None)
        if span is not None and span.kind == "branch" and not protocol.branches:
            span_text = repr(format_span(span))
            yield Fault.of("protocol.span_of_no_branch", (*path, "span"), found=span_text)
        channels += protocol.list_added_channels(step)
        earlier_steps.append(step.step)


def _find_speed_faults(protocol: Protocol, step: TravelFromSpeed, path: KeyPath) -> Faults:
    """Find more than one cycle, and a missing speed or stroke if no source has the travel."""
    rig = protocol.rig
    if rig.cycles not in (None, 1):
        yield Fault.of("protocol.many_cycles", ("rig", "cycles"), found=rig.cycles)
    if step.channel not in protocol.channels:
        for key in {"crosshead_speed", "stroke"} - rig.model_fields_set:
            yield Fault.of("protocol.no_speed", path, key=key)


def _find_channel_faults(
    name: str | None, path: KeyPath, channels: Collection[str], later_channels: Collection[str] = ()
) -> Faults:
    """Find a channel that does not exist, or that only a later step adds."""
    if name is None or name in channels:
        return
    if name in later_channels:
        yield Fault.of("protocol.channel_later", path, name=name)
    elif channels:
        yield build_choice_fault(path, name, channels, "one of the channels")
    else:
        yield Fault.of("protocol.no_channel_at_all", path, name=name)


def _find_curve_faults(protocol: Protocol) -> Faults:
    """Find channels of the curve, the branches and the alignment that do not exist or fit."""
    curve, branches, channels = protocol.curve, protocol.branches, protocol.channels
    added_channels = protocol.list_added_channels(*protocol.steps)
    if protocol.align and not isinstance(protocol.align, AlignNone):
        yield from _find_channel_faults(protocol.align.channel, ("align", "channel"), channels)
    channel_uses = []
    if curve:
        channel_uses += [(("curve", "force"), curve.force, "N")]
        channel_uses += [(("curve", "displacement"), curve.displacement, "m")]
    if branches:
        channel_uses += [(("branches", "channel"), branches.channel, "m")]
    units = {name: SI_UNITS.get(channel.measured_quantity) for name, channel in channels.items()}
    units |= dict.fromkeys(added_channels, "m")
    for path, name, si_unit in channel_uses:
        yield from _find_channel_faults(name, path, units)
        unit = units.get(name)
        if unit not in (None, si_unit):
            yield Fault.of(
                "protocol.channel_unit", path, unit=si_unit, name=name, channel_unit=unit
            )
    for quantity in (curve and curve.reverse) or ():
        name = getattr(curve, quantity)
        if name in added_channels and name not in channels:
            yield Fault.of("protocol.reverse_of_made", ("curve", "reverse"), name=name)


def _find_result_faults(protocol: Protocol) -> Faults:
    """Find repeated results, stiffnesses that do not exist, and a displacement on another clock."""
    earlier_names, stiffnesses = set[str](), list[str]()
    displacement = protocol.curve and protocol.curve.displacement
    for path, result in _list_results(protocol):
        kind, kind_path = type(result), (*path, "result")
        if kind.needs.clamp and protocol.clocks.get(displacement or "") not in (None, "markers"):
            found = displacement
            yield Fault.of("protocol.clock_of_force", kind_path, result=kind.result, found=found)
        for key in list_references(kind, "stiffness"):
            # In a draft, an entry of an unknown kind may be the stiffness.
            name = getattr(result, key) if all(protocol.results) else None
            if name is not None and not stiffnesses:
                yield Fault.of("protocol.no_stiffness", (*path, key), name=name)
            elif name is not None and name not in stiffnesses:
                choice_text = "one of the stiffnesses above,"
                yield build_choice_fault((*path, key), name, stiffnesses, choice_text)
        names = list_summary_names(result)
        repeated_names = [name for name in names if name in earlier_names]
        if repeated_names:
            yield Fault.of("protocol.result_again", kind_path, name=repeated_names[0])
        earlier_names |= {*names}
        stiffnesses += [
            name
            for name, output in zip(names, kind.outputs, strict=True)
            if output.unit == "N/m" and output.first is None
        ]


def find_unknown_main_results(protocol: Protocol) -> Faults:
    """Find main results of groups that no entry of ``results`` computes."""
    names = [name for _, result in _list_results(protocol) for name in list_summary_names(result)]
    cycle_names = {_CYCLE_SUFFIX.sub("", name) for name in names if _CYCLE_SUFFIX.search(name)}
    main_results = protocol.groups.main
    for index, name in enumerate(main_results if all((*main_results, *protocol.results)) else ()):
        path: KeyPath = ("groups", "main", index)
        base_name = _CYCLE_SUFFIX.sub("", name)
        if name in names or (base_name != name and base_name in cycle_names):
            continue
        if names:
            yield build_choice_fault(path, name, names, "one of the results")
        else:
            yield Fault.of("protocol.no_results", path, name=name)
