"""Checks of one part of a protocol against another, none of which needs data.

They look at the protocol as written, not at the finished models, so that a misspelt key in one
place hides nothing that is wrong in another.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, TypeAlias

from labpipe.errors import Fault, KeyPath, format_overrides, sort_by_likeness
from labpipe.protocol.source import (
    DIMENSION_KINDS,
    MARKER_READERS,
    PLAUSIBLE_RANGES,
    READERS,
    ROLES,
    complete_ranges,
)
from labpipe.protocol.values import (
    SI_UNITS,
    find_si_unit,
    parse_or_none,
    suggest_quantity,
    suggest_unit,
)
from labpipe.protocol.yaml_text import Values, build_choice_fault, get_block, get_list, list_nearest
from labpipe.records.declarations import STEPS, list_defaults, list_references
from labpipe.results import KINDS
from labpipe.results.kinds import Kind

Faults: TypeAlias = Iterator[Fault]
RESULTS: Final[Mapping[str, Any]] = {kind.result: kind for kind in KINDS}
"""The kinds of results by their word in YAML."""
_CAMERA_KEYS = ("scale_uncertainty", "certificate")
_CHANNEL_KEYS = (
    *("channel", "unit", "wrong_unit_in_file", "calibration"),
    *("quantity", "plausible_peak", "zero_drift", *_CAMERA_KEYS),
)
_TRACKS, _CLAMP = "a source of marker tracks", "a clamped end"
_CURVE, _BRANCHES, _MARKERS = "a block 'curve'", "a block 'branches'", "a block 'markers'"
_CLOCKS = "a method that joins two clocks"
_SHAPES = "a step that makes shapes"
_REMEDIES = {
    _TRACKS: "Add the source 'markers'.",
    _CLAMP: "Name the rigid body at the clamp in 'markers.clamp'.",
    _CLOCKS: "Set 'align.method' to 'turning-points'.",
    _SHAPES: "Add the step 'fit-shape'.",
}
_FIGURE_NEEDS = {
    **dict.fromkeys(("force-displacement", "stiffness-lines", "timeline"), _CURVE),
    "wire-shapes": _SHAPES,
    "moment-curvature": "a result 'moment-curvature'",
    "marker-quality": _TRACKS,
}
"""What each figure requires."""


@dataclass(frozen=True, slots=True)
class Channel:
    """One channel of a source, as written.

    Parameters
    ----------
    name : as labpipe calls it
    role : of its source
    path : way to its block
    values : what the block says
    """

    name: str
    role: str
    path: KeyPath
    values: Values

    @property
    def quantity(self) -> str | None:
        """What it measures; None if that is missing."""
        stated = self.values.get("quantity")
        return stated if isinstance(stated, str) else self.name if self.name in SI_UNITS else None


class Outline:
    """Names and tags of a protocol as written, whether or not its details are valid.

    Parameters
    ----------
    data : the protocol as plain values
    """

    def __init__(self, data: Values) -> None:
        self.data = data
        self.sources = {
            role: get_block(data, "sources", role) for role in get_block(data, "sources")
        }
        self.channels = [
            channel for role, source in self.sources.items() for channel in _channels(role, source)
        ]
        self.steps = _tagged(data, "steps", "step")
        self.results = _tagged(data, "results", "result")
        self.has_clamp = self.block("markers").get("clamp") is not None
        self.made = [name for _, tag, step in self.steps for name in self.made_by(tag, step)]
        """Channels that the steps add, in order."""
        self.measured = [channel.name for channel in self.channels]
        self.names = self.measured + self.made
        self.from_speed = {
            str(step.get("channel")): str(step.get("force"))
            for _, tag, step in self.steps
            if tag == "travel-from-speed"
        }
        """Channels that are made from crosshead speed, and the force that each is made with."""
        self.has = {*self._things()}
        """What others may need."""

    def _things(self) -> Iterator[str]:
        readers = {word for source in self.sources.values() for word in readers_in(source)}
        if "markers" in self.sources or MARKER_READERS & readers:
            yield _TRACKS
        if self.has_clamp:
            yield _CLAMP
        if self.block("align").get("method") in ("turning-points", "common-start", "stated"):
            yield _CLOCKS
        yield from (f"a block {key!r}" for key in self.data if self.block(key))
        yield from (
            f"a block 'curve.{key}'" for key in self.block("curve") if self.block("curve", key)
        )
        yield from (f"the step {tag!r}" for _, tag, _ in self.steps)
        yield from (
            _SHAPES for _, tag, _ in self.steps if tag in ("fit-shape", "three-point-shape")
        )
        yield from (f"a result {tag!r}" for _, tag, _ in self.results)

    def block(self, *path: str) -> Values:
        """Return the block under a path; empty if there is none."""
        return get_block(self.data, *path)

    def made_by(self, tag: str, step: Values) -> tuple[str, ...]:
        """List the channels that a step makes; a frame without a clamp makes none."""
        if tag not in STEPS or (tag == "specimen-frame" and not self.has_clamp):
            return ()
        return tuple(name.format_map({"channel": None, **step}) for name in STEPS[tag].makes)

    def is_optional(self, role: str) -> bool:
        """Return whether a test may lack a source."""
        return str(self.block("sources", role).get("optional")).lower() == "true"

    def clock_of(self, channel: str) -> str | None:
        """Return the role whose clock a channel is on; None for an unknown channel."""
        clocks = {source.name: source.role for source in reversed(self.channels)}
        if channel not in clocks:
            channel = self.from_speed.get(channel, channel)
        return clocks.get(channel) or ("markers" if channel in self.made else None)

    def unit_of(self, channel: object) -> str | None:
        """Return the SI unit of a channel; None where it is not known."""
        quantities = {source.name: source.quantity for source in reversed(self.channels)}
        quantities |= dict.fromkeys(self.made, "travel")
        return SI_UNITS.get(quantities.get(str(channel)) or "")


def readers_in(source: Values) -> list[str]:
    """List the known readers that a source names."""
    reader = source.get("reader")
    return [word for word in (reader if isinstance(reader, list) else [reader]) if word in READERS]


def _channels(role: str, source: Values) -> Iterator[Channel]:
    if _channel_keys(role, source):
        name = role if role in ROLES else sort_by_likeness(role, list(ROLES), limit=1)[0]
        yield Channel(name, role, ("sources", role), source)
    for name in get_block(source, "channels"):
        path = ("sources", role, "channels", name)
        yield Channel(name, role, path, get_block(source, "channels", name))


def _channel_keys(role: str, source: Values) -> list[str]:
    """List the keys of a source that are those of a channel."""
    others = _CAMERA_KEYS if role == "markers" else ()
    return [key for key in _CHANNEL_KEYS if key in source and key not in others]


def _tagged(data: Values, key: str, tag: str) -> list[tuple[int, str, Values]]:
    """List number, tag and content of the blocks of a list that have a tag."""
    return [
        (number, item[tag], item)
        for number, item in enumerate(get_list(data, key))
        if isinstance(item, Mapping) and isinstance(item.get(tag), str)
    ]


def list_result_names(tag: str, entry: Values) -> tuple[str, ...]:
    """List what an entry is called in the summary; of several cycles or slips, the first.

    Parameters
    ----------
    tag : such as ``two-segments``
    entry : the block as written, which may give a name of its own
    """
    kind = RESULTS.get(tag)
    return () if kind is None else tuple(output.name_in(kind, entry) for output in kind.outputs)


def find_cross_faults(data: Values) -> Faults:
    """Find contradictions between the parts of a protocol.

    Parameters
    ----------
    data : the protocol as plain values, whether or not its details are valid

    Yields
    ------
    The faults, with their paths in `data`.
    """
    outline = Outline(data)
    yield from find_implausible_sizes(data, ("specimen", "rig", "markers", "results"))
    for check in (
        *(_source_faults, _step_faults, _align_faults, _curve_faults),
        *(_result_faults, _figure_faults, _display_faults, _group_faults),
    ):
        yield from check(outline)


def _missing_needs(outline: Outline, path: KeyPath, user: str, *needs: str) -> Faults:
    """Find needs of a step, result or figure that the protocol does not provide."""
    for need in needs:
        if need not in outline.has:
            remedy = _REMEDIES.get(need, f"Add {need}.").replace("Add a ", "Add the ")
            yield Fault.of("protocol.lacking", path, need=need, user=user, remedy=remedy)


def _source_faults(outline: Outline) -> Faults:
    for role in set(outline.sources) & set(ROLES):
        yield from _content_faults(role, outline.sources[role])
    taken = dict.fromkeys(outline.made, "a step")
    for channel in outline.channels:
        if not (channel.name in outline.from_speed and outline.is_optional(channel.role)):
            name, path = channel.name, channel.path
            if name in taken:
                by = taken[name]
                yield Fault.of("protocol.channel_taken", path, at="key", name=name, by=by)
            taken[name] = f"the source {channel.role!r}"
        yield from _channel_faults(channel)


def _content_faults(role: str, source: Values) -> Faults:
    """Find a source that gives neither channels nor marker tracks, or both."""
    path: KeyPath = ("sources", role)
    readers, short = readers_in(source), _channel_keys(role, source)
    for key in {"dialect", "part"} & {*source} if "load-frame" not in readers else ():
        yield Fault.of("protocol.load_frame_key", (*path, key), at="key", key=key)
    valid = MARKER_READERS if role == "markers" else {*READERS} - MARKER_READERS
    if not {*readers} <= valid:
        what = "marker tracks" if role == "markers" else "channels"
        found, words = ", ".join(map(repr, readers)), list_nearest("", valid)
        here = (*path, "reader")
        yield Fault.of("protocol.wrong_reader", here, what=what, found=found, valid=words)
    elif role == "markers":
        for key in [key for key in ("channels", *short) if key in source][:1]:
            yield Fault.of("protocol.channel_of_markers", (*path, key), key=key)
    elif "channels" in source and short:
        yield Fault.of("protocol.channels_twice", (*path, short[0]), key=short[0])
    elif readers and not source.get("channels") and "channel" not in source:
        yield Fault.of("protocol.no_channels", path)


def _channel_faults(channel: Channel) -> Faults:
    path, values, quantity = channel.path, channel.values, channel.quantity
    if quantity is None:
        yield Fault.of("protocol.no_measurand", path, valid=list_nearest(channel.name, SI_UNITS))
    elif quantity not in SI_UNITS:
        yield build_choice_fault((*path, "quantity"), quantity, SI_UNITS, "one of the quantities")
    else:
        peak = (*path, "plausible_peak")
        yield from _range_faults(values.get("plausible_peak"), peak, SI_UNITS[quantity])
        if quantity != "force" and "zero_drift" in values:  # only that of a force is in an interval
            key = (*path, "zero_drift")
            yield Fault.of("protocol.drift_of_no_force", key, at="key", quantity=quantity)
        yield from _unit_faults(path, values, quantity)


def _unit_faults(path: KeyPath, values: Values, quantity: str) -> Faults:
    """Find a unit or a calibration that does not lead to the unit of the quantity."""
    calibration, unit, target = values.get("calibration"), values.get("unit"), SI_UNITS[quantity]
    if unit is None:
        if values.get("wrong_unit_in_file") is not None:
            yield Fault.of("protocol.no_right_unit", (*path, "wrong_unit_in_file"))
        if calibration is not None:
            yield Fault.of("protocol.no_unit_before", path)
        return
    before = find_si_unit(str(unit)) if calibration is not None else target
    if before is None:
        yield Fault.of("protocol.no_unit", (*path, "unit"), quantity="V", found=repr(unit))
    elif remedy := suggest_unit(str(unit), before):
        yield Fault.of(
            "protocol.wrong_unit",
            (*path, "unit"),
            quantity=quantity,
            unit=before,
            found=repr(unit),
            remedy=remedy,
        )
    else:
        block, path = get_block(calibration), (*path, "calibration")
        yield from _no_quantity(block.get("offset"), target, (*path, "offset"), "0.5")
        gain, key = block.get("gain"), (*path, "gain")
        yield from _no_quantity(gain, f"{target}/({before})", key, "0.5")
        if parse_or_none(gain, f"{target}/({before})") == 0.0:
            yield Fault.of("protocol.no_gain", key, found=repr(gain))


def _step_faults(outline: Outline) -> Faults:
    names, earlier = list(outline.measured), list[str]()
    for number, tag, step in outline.steps:
        kind, path = STEPS.get(tag), ("steps", number)
        here: KeyPath = (*path, "step")
        if kind is not None and kind.on_markers:
            yield from _missing_needs(outline, here, tag, _TRACKS, _MARKERS)
            if tag in earlier:
                yield Fault.of("protocol.step_again", here, step=tag)
            if kind.after and kind.after not in earlier:
                yield Fault.of("protocol.step_before", here, step=tag, needed=kind.after)
        for key in list_references(kind, "channel") if kind is not None else ("channel",):
            yield from _no_channel(step.get(key), (*path, key), names, outline.made)
        if tag == "travel-from-speed":
            yield from _from_speed_faults(outline, step, here)
        span = str(step.get("span")).strip()
        if span.endswith("%") and _BRANCHES not in outline.has:
            yield Fault.of("protocol.span_of_no_branch", (*path, "span"), found=repr(span))
        names += outline.made_by(tag, step)
        earlier.append(tag)


def _from_speed_faults(outline: Outline, step: Values, here: KeyPath) -> Faults:
    """Find a travel that nothing can be made of, where no source can take its place."""
    rig = outline.block("rig")
    if rig.get("cycles") not in (None, "1", 1):
        yield Fault.of("protocol.many_cycles", ("rig", "cycles"), found=rig["cycles"])
    is_measured = step.get("channel") in outline.measured
    for key in {"crosshead_speed", "stroke"} - {*rig} if not is_measured else ():
        yield Fault.of("protocol.no_speed", here, key=key)


def _no_channel(
    name: object, path: KeyPath, names: Sequence[str], later: Collection[str] = ()
) -> Faults:
    """Find a channel that does not exist, or not yet."""
    if not isinstance(name, str) or name in names:
        return
    if name in later:
        yield Fault.of("protocol.channel_later", path, name=name)
    elif names:
        yield build_choice_fault(path, name, names, "one of the channels")
    else:
        yield Fault.of("protocol.no_channel_at_all", path, name=name)


def _align_faults(outline: Outline) -> Faults:
    align = outline.block("align")
    if _CLOCKS in outline.has:
        yield from _no_channel(align.get("channel"), ("align", "channel"), outline.measured)
    if align.get("method") == "turning-points":
        yield from _missing_needs(outline, ("align", "method"), "turning-points", _TRACKS, _CLAMP)


def _curve_faults(outline: Outline) -> Faults:
    curve, branches = outline.block("curve"), outline.block("branches")
    for key, unit in (("force", "N"), ("displacement", "m")):
        name, path = curve.get(key), ("curve", key)
        yield from _no_channel(name, path, outline.names)
        other = outline.unit_of(name)
        if other not in (None, unit):
            yield Fault.of("protocol.channel_unit", path, unit=unit, name=name, other=other)
    for quantity in get_list(curve, "reverse"):
        name = curve.get(quantity) if isinstance(quantity, str) else None
        if name in outline.made and name not in outline.measured:
            yield Fault.of("protocol.reverse_of_made", ("curve", "reverse"), name=name)
    clocks = {outline.clock_of(str(curve.get(key))) for key in ("force", "displacement")} - {None}
    if len(clocks) > 1:
        place: KeyPath = ("align", "method") if outline.block("align") else ("curve",)
        yield from _missing_needs(outline, place, "curve", _CLOCKS)
    yield from _no_channel(branches.get("channel"), ("branches", "channel"), outline.names)
    if branches:
        yield from _missing_needs(outline, ("branches",), "branches", _CURVE)


def _result_faults(outline: Outline) -> Faults:
    seen: dict[str, str] = {}
    stiffnesses: list[str] = []
    for number, tag, entry in outline.results:
        kind, path = RESULTS.get(tag), ("results", number)
        if tag == "bending-stiffness":
            yield from _length_faults(outline.block("specimen"), entry, path)
        if kind is None:
            continue
        yield from _need_faults(outline, kind, (*path, "result"))
        settings = {**list_defaults(kind), **entry}
        for key in list_references(kind, "stiffness"):
            yield from _no_stiffness(settings.get(key), (*path, key), stiffnesses)
        names = list_result_names(tag, entry)
        yield from _duplicate_name_faults(names, tag, seen, (*path, "result"))
        seen |= dict.fromkeys(names, tag)
        stiffnesses += [
            name
            for name, output in zip(names, kind.outputs, strict=True)
            if output.unit == "N/m" and output.first is None
        ]


def _no_stiffness(name: object, path: KeyPath, earlier: Sequence[str]) -> Faults:
    """Find a result that refers to a stiffness not listed above it."""
    if isinstance(name, str) and earlier and name not in earlier:
        yield build_choice_fault(path, name, earlier, "one of the stiffnesses above,")
    elif isinstance(name, str) and not earlier:
        yield Fault.of("protocol.no_stiffness", path, name=name)


def _duplicate_name_faults(
    names: Iterable[str], tag: str, seen: Mapping[str, str], path: KeyPath
) -> Faults:
    """Find a result whose name in the summary is used before."""
    name = next((name for name in names if name in seen), None)
    if name is None:
        return
    remedy = "Remove one of them."
    if "name" in list_defaults(RESULTS[tag]):
        remedy = "Give it another 'name'."
    elif "name" in list_defaults(RESULTS[seen[name]]):
        remedy = f"Give the {seen[name]} of that name another 'name'."
    yield Fault.of("protocol.result_again", path, name=name, remedy=remedy)


def _need_faults(outline: Outline, kind: type[Kind], path: KeyPath) -> Faults:
    needs, tag = kind.needs, kind.result
    words = [*(_CURVE, _BRANCHES) * needs.branches, *[_CLOCKS] * needs.clocks]
    words += [f"the step {needs.shape!r}"] * bool(needs.shape) + [_CLAMP] * needs.clamp
    yield from _missing_needs(outline, path, tag, *words)
    if needs.correction and outline.block("curve"):
        for fault in _missing_needs(outline, path, tag, f"a block 'curve.{needs.correction}'"):
            out = format_overrides(f"results.{tag}", "null")
            yield replace(fault, remedy=f"{fault.remedy[:-1]}, or take the result out: {out}.")
    displacement = str(outline.block("curve").get("displacement"))
    if needs.clamp and outline.clock_of(displacement) not in (None, "markers"):
        yield Fault.of("protocol.clock_of_force", path, result=tag, found=displacement)


def _figure_faults(outline: Outline) -> Faults:
    figures = get_list(outline.data, "report", "figures")
    for number, figure in enumerate(figures):
        path: KeyPath = ("report", "figures", number)
        if isinstance(figure, str) and figure in _FIGURE_NEEDS:
            yield from _missing_needs(outline, path, figure, _FIGURE_NEEDS[figure])
        if figure in figures[:number]:
            yield Fault.of("protocol.figure_again", path, figure=figure)


def _display_faults(outline: Outline) -> Faults:
    for quantity, unit in outline.block("report", "display").items():
        path: KeyPath = ("report", "display", quantity)
        si_unit = SI_UNITS.get(quantity)
        if si_unit is None:
            fault = build_choice_fault(path, quantity, SI_UNITS, "one of the quantities")
            yield replace(fault, at="key")
        elif parse_or_none(f"1 {unit}", si_unit) is None:
            such = f"{quantity} such as {si_unit}"
            yield Fault.of("protocol.no_unit", path, quantity=such, found=repr(unit))


def _group_faults(outline: Outline) -> Faults:
    """Find a number that the report is to show first and that no result gives."""
    names = [name for _, tag, entry in outline.results for name in list_result_names(tag, entry)]
    cycle = re.compile(r"\.\d+$")
    of_any_cycle = {cycle.sub("", name) for name in names if cycle.search(name)}
    for number, name in enumerate(get_list(outline.data, "groups", "main")):
        path: KeyPath = ("groups", "main", number)
        stem = cycle.sub("", str(name))
        if name in names or (stem != name and stem in of_any_cycle):
            continue
        if names:
            yield build_choice_fault(path, name, names, "one of the results")
        else:
            yield Fault.of("protocol.no_results", path, name=name)


def _length_faults(specimen: Values, entry: Values, path: KeyPath) -> Faults:
    """Find an uncertainty of a length that a result states otherwise than the specimen."""
    key = "length" if entry.get("support") == "cantilever" else "span"
    here, there = entry.get("length_uncertainty"), get_block(specimen, "uncertainty").get(key)
    values = parse_or_none(here, "m"), parse_or_none(there, "m")
    if None not in values and values[0] != values[1]:
        path = (*path, "length_uncertainty")
        yield Fault.of("protocol.length_twice", path, key=key, here=here, there=there)


def _no_quantity(text: object, unit: str, path: KeyPath, number: str) -> Faults:
    """Find a text that is no quantity of a unit."""
    if isinstance(text, str) and parse_or_none(text, unit) is None:
        such = unit.replace("(", "").replace(")", "")
        remedy = suggest_quantity(text, unit, f"{number} {such}")
        kind = f"quantity with a unit such as {such}"
        yield Fault.of("protocol.no_quantity", path, kind=kind, found=repr(text), remedy=remedy)


def _range_faults(stated: object, path: KeyPath, unit: str) -> Faults:
    """Find a plausible range without a unit, or with its ends the wrong way round."""
    texts = [get_block(stated).get(key) for key in ("from", "to")]
    for key, text in zip(("from", "to"), texts, strict=True):
        yield from _no_quantity(text, unit, (*path, key), "20")
    low, high = (parse_or_none(text, unit) for text in texts)
    if low is not None and high is not None and not 0.0 <= low < high:
        yield Fault.of("protocol.range_reversed", path, low=low, high=high, unit=unit)


def find_implausible_sizes(
    data: Values,
    blocks: Collection[str],
    *,
    others: Collection[str] = (),
    ranges: object = None,
    in_file: bool = False,
) -> Faults:
    """Find wrong ranges in a file, and dimensions in some of its blocks that are outside theirs.

    Parameters
    ----------
    data : the file as written; what is no quantity is a fault of its own
    blocks : keys of the blocks
    others : keys of further lengths, whose names say no kind
    ranges : of another file, by kind of dimension; those of the file itself if None
    in_file : whether a range is widened in the file itself, which no test sheet can override
    """
    for kind, ends in get_block(data, "plausible").items():
        if kind in PLAUSIBLE_RANGES:
            yield from _range_faults(ends, ("plausible", kind), PLAUSIBLE_RANGES[kind][0])
    valid = complete_ranges(data.get("plausible") or {} if ranges is None else ranges)
    for block in blocks:
        for path, text in _sizes(data.get(block), (block,)):
            key = next(str(part) for part in reversed(path) if isinstance(part, str))
            kind = (
                DIMENSION_KINDS.get(key)
                or DIMENSION_KINDS.get(key.rpartition("_")[2])
                or ("other" * (key in others))
            )
            ends = get_block(valid, kind)
            yield from _outside(kind, text, path, ends, in_file=in_file) if ends else ()


def _sizes(node: object, path: KeyPath) -> Iterator[tuple[KeyPath, str]]:
    """List the texts in a block or a list, where a key may be that of a dimension."""
    if isinstance(node, Mapping):
        for key in node.keys() - {"uncertainty", "labels", "positions"}:
            yield from _sizes(node[key], (*path, key))
    elif isinstance(node, list):
        for number, item in enumerate(node):
            yield from _sizes(item, (*path, number))
    elif isinstance(node, str):
        yield path, node


def _outside(kind: str, text: str, path: KeyPath, ends: Values, *, in_file: bool) -> Faults:
    size, low, high = (
        parse_or_none(x, PLAUSIBLE_RANGES[kind][0]) for x in (text, ends["from"], ends["to"])
    )
    if size is None or low is None or high is None or low <= abs(size) <= high or low >= high:
        return
    end = "from" if abs(size) < low else "to"
    override = format_overrides(f"plausible.{kind}.{end}", text)
    yield Fault.of(
        "protocol.implausible",
        path,
        kind=kind.replace("_", " ") if kind != "other" else "dimension",
        low=ends["from"],
        high=ends["to"],
        found=repr(text),
        override=f"'plausible: {{{kind}: {{{end}: {text}}}}}'" if in_file else override,
    )
