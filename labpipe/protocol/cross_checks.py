"""Checks of the blocks of a protocol against each other, and of dimensions against ranges.

The checks use the protocol as written, not the validated models: a misspelt key in one block must
not hide a fault of another.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
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
"""Kinds of results by their name in YAML."""
_SCALE_KEYS = ("scale_uncertainty", "certificate")
_CHANNEL_KEYS = (
    *("channel", "unit", "wrong_unit_in_file", "calibration"),
    *("quantity", "plausible_peak", "zero_drift", *_SCALE_KEYS),
)
_MARKER_SOURCE, _CLAMP = "a source of marker tracks", "a clamped end"
_CURVE, _BRANCHES, _MARKERS = "a block 'curve'", "a block 'branches'", "a block 'markers'"
_ALIGNMENT = "a method that aligns two clocks"
_SHAPE_STEP = "a step that computes shapes"
_REMEDIES = {
    _MARKER_SOURCE: "Add the source 'markers'.",
    _CLAMP: "Name the rigid body at the clamp in 'markers.clamp'.",
    _ALIGNMENT: "Set 'align.method' to 'turning-points'.",
    _SHAPE_STEP: "Add the step 'fit-shape'.",
}
_FIGURE_NEEDS = {
    **dict.fromkeys(("force-displacement", "stiffness-lines", "stress-strain", "timeline"), _CURVE),
    "wire-shapes": _SHAPE_STEP,
    "moment-curvature": "a result 'moment-curvature'",
    "marker-quality": _MARKER_SOURCE,
}
_CYCLE_SUFFIX = re.compile(r"\.\d+$")


@dataclass(frozen=True, slots=True)
class Channel:
    """One channel of a source, as written.

    Parameters
    ----------
    name : in labpipe
    role : of its source
    path : of its block in the protocol
    values : content of its block
    """

    name: str
    role: str
    path: KeyPath
    values: Values

    @property
    def quantity(self) -> str | None:
        """Return the measured quantity, stated or by the name; None if neither gives it."""
        stated = self.values.get("quantity")
        return stated if isinstance(stated, str) else self.name if self.name in SI_UNITS else None


class Outline:
    """Channels, steps and results of a protocol as written, valid or not.

    Parameters
    ----------
    data : the protocol as plain values

    Attributes
    ----------
    steps, results : number, name in YAML and block of each entry
    source_channels, step_channels : names of the channels that sources give and that steps add
    channel_names : both together
    forces_of_travel : name of the force channel by channel that ``travel-from-speed`` makes
    provided : needs of steps, results and figures that the protocol meets
    """

    def __init__(self, data: Values) -> None:
        self.data = data
        sources = get_block(data, "sources")
        self.sources = {role: get_block(sources, role) for role in sources}
        self.channels = [
            channel
            for role, source in self.sources.items()
            for channel in _list_channels(role, source)
        ]
        self.steps = _list_entries(data, "steps", "step")
        self.results = _list_entries(data, "results", "result")
        self.has_clamp = self.block("markers").get("clamp") is not None
        self.step_channels = [
            channel for _, name, step in self.steps for channel in self.list_added(name, step)
        ]
        self.source_channels = [channel.name for channel in self.channels]
        self.channel_names = self.source_channels + self.step_channels
        self.forces_of_travel = {
            str(step.get("channel")): str(step.get("force"))
            for _, name, step in self.steps
            if name == "travel-from-speed"
        }
        self.provided = {*self._list_provided()}

    def _list_provided(self) -> Iterator[str]:
        readers = {reader for source in self.sources.values() for reader in _list_readers(source)}
        if "markers" in self.sources or MARKER_READERS & readers:
            yield _MARKER_SOURCE
        if self.has_clamp:
            yield _CLAMP
        if self.block("align").get("method") in ("turning-points", "common-start", "stated"):
            yield _ALIGNMENT
        yield from (f"a block {key!r}" for key in self.data if self.block(key))
        curve = self.block("curve")
        yield from (f"a block 'curve.{key}'" for key in curve if get_block(curve, key))
        for _, name, _ in self.steps:
            yield f"the step {name!r}"
            if name in ("fit-shape", "three-point-shape"):
                yield _SHAPE_STEP
        yield from (f"a result {name!r}" for _, name, _ in self.results)

    def block(self, *path: str) -> Values:
        """Return the block at a path; an empty one if there is none."""
        return get_block(self.data, *path)

    def list_added(self, name: str, step: Values) -> tuple[str, ...]:
        """List the channels that a step adds; ``specimen-frame`` without a clamp adds none."""
        if name not in STEPS or (name == "specimen-frame" and not self.has_clamp):
            return ()
        return tuple(form.format_map({"channel": None, **step}) for form in STEPS[name].makes)

    def is_optional(self, role: str) -> bool:
        """Return whether a test may lack a source."""
        return str(self.block("sources", role).get("optional")).lower() == "true"

    def find_clock(self, channel: str) -> str | None:
        """Return the role whose clock a channel has; None for an unknown channel."""
        roles = {source.name: source.role for source in reversed(self.channels)}
        if channel not in roles:
            channel = self.forces_of_travel.get(channel, channel)
        return roles.get(channel) or ("markers" if channel in self.step_channels else None)

    def find_unit(self, channel: object) -> str | None:
        """Return the SI unit of a channel; None for an unknown channel or quantity."""
        quantities = {source.name: source.quantity for source in reversed(self.channels)}
        quantities |= dict.fromkeys(self.step_channels, "travel")
        return SI_UNITS.get(quantities.get(str(channel)) or "")


def _list_readers(source: Values) -> list[str]:
    """List the known readers of a source."""
    stated = source.get("reader")
    return [name for name in (stated if isinstance(stated, list) else [stated]) if name in READERS]


def _list_channels(role: str, source: Values) -> Iterator[Channel]:
    """List the channels of a source, in its short form named by the most similar role."""
    if _list_channel_keys(role, source):
        name = role if role in ROLES else sort_by_likeness(role, list(ROLES), limit=1)[0]
        yield Channel(name, role, ("sources", role), source)
    for name in get_block(source, "channels"):
        path = ("sources", role, "channels", name)
        yield Channel(name, role, path, get_block(source, "channels", name))


def _list_channel_keys(role: str, source: Values) -> list[str]:
    """List the keys of a source that describe a channel in the short form."""
    camera_keys = _SCALE_KEYS if role == "markers" else ()
    return [key for key in _CHANNEL_KEYS if key in source and key not in camera_keys]


def _list_entries(data: Values, key: str, name_key: str) -> list[tuple[int, str, Values]]:
    """List number, name and block of the entries of a list that have a name."""
    return [
        (number, item[name_key], item)
        for number, item in enumerate(get_list(data, key))
        if isinstance(item, Mapping) and isinstance(item.get(name_key), str)
    ]


def list_result_names(name: str, entry: Values) -> tuple[str, ...]:
    """List the names that an entry of ``results`` has in the summary.

    Parameters
    ----------
    name : of the kind of result in YAML, such as ``two-segments``
    entry : the block as written, which may state its own name

    Returns
    -------
    A name per number; of numbers for several cycles or slips, the first. Empty for an unknown kind.
    """
    kind = RESULTS.get(name)
    return () if kind is None else tuple(output.name_in(kind, entry) for output in kind.outputs)


def find_cross_faults(data: Values) -> Faults:
    """Find contradictions between the blocks of a protocol.

    Parameters
    ----------
    data : the protocol as plain values, valid or not

    Yields
    ------
    The faults, with their paths in `data`.
    """
    outline = Outline(data)
    yield from find_implausible_sizes(data, ("specimen", "rig", "markers", "results"))
    for check in (
        *(_check_sources, _check_steps, _check_alignment, _check_curve),
        *(_check_results, _check_figures, _check_display_units, _check_main_results),
    ):
        yield from check(outline)


def _check_needs(outline: Outline, path: KeyPath, user: str, *needs: str) -> Faults:
    """Find needs of a step, result or figure that the protocol does not meet."""
    for need in needs:
        if need not in outline.provided:
            remedy = _REMEDIES.get(need, f"Add {need}.").replace("Add a ", "Add the ")
            yield Fault.of("protocol.lacking", path, need=need, user=user, remedy=remedy)


def _check_sources(outline: Outline) -> Faults:
    for role in set(outline.sources) & set(ROLES):
        yield from _check_source_content(role, outline.sources[role])
    owners = dict.fromkeys(outline.step_channels, "a step")
    for channel in outline.channels:
        if not (channel.name in outline.forces_of_travel and outline.is_optional(channel.role)):
            name, path = channel.name, channel.path
            if name in owners:
                by = owners[name]
                yield Fault.of("protocol.channel_taken", path, at="key", name=name, by=by)
            owners[name] = f"the source {channel.role!r}"
        yield from _check_channel(channel)


def _check_source_content(role: str, source: Values) -> Faults:
    """Find a source that gives neither channels nor marker tracks, or both."""
    path: KeyPath = ("sources", role)
    readers, channel_keys = _list_readers(source), _list_channel_keys(role, source)
    for key in {"dialect", "part"} & {*source} if "load-frame" not in readers else ():
        yield Fault.of("protocol.load_frame_key", (*path, key), at="key", key=key)
    valid = MARKER_READERS if role == "markers" else {*READERS} - MARKER_READERS
    if not {*readers} <= valid:
        content = "marker tracks" if role == "markers" else "channels"
        found, names = ", ".join(map(repr, readers)), list_nearest("", valid)
        here = (*path, "reader")
        yield Fault.of("protocol.wrong_reader", here, content=content, found=found, valid=names)
    elif role == "markers":
        for key in [key for key in ("channels", *channel_keys) if key in source][:1]:
            yield Fault.of("protocol.channel_of_markers", (*path, key), key=key)
    elif "channels" in source and channel_keys:
        key = channel_keys[0]
        yield Fault.of("protocol.channels_twice", (*path, key), key=key)
    elif readers and not source.get("channels") and "channel" not in source:
        yield Fault.of("protocol.no_channels", path)


def _check_channel(channel: Channel) -> Faults:
    path, values, quantity = channel.path, channel.values, channel.quantity
    if quantity is None:
        yield Fault.of("protocol.no_measurand", path, valid=list_nearest(channel.name, SI_UNITS))
    elif quantity not in SI_UNITS:
        yield build_choice_fault((*path, "quantity"), quantity, SI_UNITS, "one of the quantities")
    else:
        peak = (*path, "plausible_peak")
        yield from _check_range(values.get("plausible_peak"), peak, SI_UNITS[quantity])
        if quantity != "force" and "zero_drift" in values:  # intervals include that of a force only
            key = (*path, "zero_drift")
            yield Fault.of("protocol.drift_of_no_force", key, at="key", quantity=quantity)
        yield from _check_unit(path, values, quantity)


def _check_unit(path: KeyPath, values: Values, quantity: str) -> Faults:
    """Find a unit or a calibration that does not give the SI unit of the quantity."""
    calibration, unit, target = values.get("calibration"), values.get("unit"), SI_UNITS[quantity]
    if unit is None:
        if values.get("wrong_unit_in_file") is not None:
            yield Fault.of("protocol.no_right_unit", (*path, "wrong_unit_in_file"))
        if calibration is not None:
            yield Fault.of("protocol.no_unit_before", path)
        return
    si_unit = find_si_unit(str(unit)) if calibration is not None else target
    here, found = (*path, "unit"), repr(unit)
    if si_unit is None:
        yield Fault.of("protocol.no_unit", here, quantity="V", found=found)
    elif remedy := suggest_unit(str(unit), si_unit):
        yield Fault.of(
            "protocol.wrong_unit",
            here,
            quantity=quantity,
            unit=si_unit,
            found=found,
            remedy=remedy,
        )
    else:
        block, path = get_block(calibration), (*path, "calibration")
        yield from _check_quantity(block.get("offset"), target, (*path, "offset"), "0.5")
        gain, gain_path, gain_unit = block.get("gain"), (*path, "gain"), f"{target}/({si_unit})"
        yield from _check_quantity(gain, gain_unit, gain_path, "0.5")
        if parse_or_none(gain, gain_unit) == 0.0:
            yield Fault.of("protocol.no_gain", gain_path, found=repr(gain))


def _check_steps(outline: Outline) -> Faults:
    channels, earlier = list(outline.source_channels), list[str]()
    for number, name, step in outline.steps:
        kind, path = STEPS.get(name), ("steps", number)
        here: KeyPath = (*path, "step")
        if kind is not None and kind.on_markers:
            yield from _check_needs(outline, here, name, _MARKER_SOURCE, _MARKERS)
            if name in earlier:
                yield Fault.of("protocol.step_again", here, step=name)
            if kind.after and kind.after not in earlier:
                yield Fault.of("protocol.step_before", here, step=name, needed=kind.after)
        for key in list_references(kind, "channel") if kind is not None else ("channel",):
            yield from _check_channel_name(
                step.get(key), (*path, key), channels, outline.step_channels
            )
        if name == "travel-from-speed":
            yield from _check_travel_from_speed(outline, step, here)
        span = str(step.get("span")).strip()
        if span.endswith("%") and _BRANCHES not in outline.provided:
            yield Fault.of("protocol.span_of_no_branch", (*path, "span"), found=repr(span))
        channels += outline.list_added(name, step)
        earlier.append(name)


def _check_travel_from_speed(outline: Outline, step: Values, path: KeyPath) -> Faults:
    """Find several cycles, and a missing speed or stroke if no source measures the travel."""
    rig = outline.block("rig")
    if rig.get("cycles") not in (None, "1", 1):
        yield Fault.of("protocol.many_cycles", ("rig", "cycles"), found=rig["cycles"])
    if step.get("channel") not in outline.source_channels:
        for key in {"crosshead_speed", "stroke"} - {*rig}:
            yield Fault.of("protocol.no_speed", path, key=key)


def _check_channel_name(
    name: object, path: KeyPath, channels: Sequence[str], later: Collection[str] = ()
) -> Faults:
    """Find the name of a channel that does not exist, or not yet."""
    if not isinstance(name, str) or name in channels:
        return
    if name in later:
        yield Fault.of("protocol.channel_later", path, name=name)
    elif channels:
        yield build_choice_fault(path, name, channels, "one of the channels")
    else:
        yield Fault.of("protocol.no_channel_at_all", path, name=name)


def _check_alignment(outline: Outline) -> Faults:
    align = outline.block("align")
    if _ALIGNMENT in outline.provided:
        path = ("align", "channel")
        yield from _check_channel_name(align.get("channel"), path, outline.source_channels)
    if align.get("method") == "turning-points":
        path = ("align", "method")
        yield from _check_needs(outline, path, "turning-points", _MARKER_SOURCE, _CLAMP)


def _check_curve(outline: Outline) -> Faults:
    curve, branches = outline.block("curve"), outline.block("branches")
    for key, si_unit in (("force", "N"), ("displacement", "m")):
        name, path = curve.get(key), ("curve", key)
        yield from _check_channel_name(name, path, outline.channel_names)
        other = outline.find_unit(name)
        if other not in (None, si_unit):
            yield Fault.of("protocol.channel_unit", path, unit=si_unit, name=name, other=other)
    for quantity in get_list(curve, "reverse"):
        name = curve.get(quantity) if isinstance(quantity, str) else None
        if name in outline.step_channels and name not in outline.source_channels:
            yield Fault.of("protocol.reverse_of_made", ("curve", "reverse"), name=name)
    clocks = {outline.find_clock(str(curve.get(key))) for key in ("force", "displacement")} - {None}
    if len(clocks) > 1:
        place: KeyPath = ("align", "method") if outline.block("align") else ("curve",)
        yield from _check_needs(outline, place, "curve", _ALIGNMENT)
    path = ("branches", "channel")
    yield from _check_channel_name(branches.get("channel"), path, outline.channel_names)
    if branches:
        yield from _check_needs(outline, ("branches",), "branches", _CURVE)


def _check_results(outline: Outline) -> Faults:
    known_names = set[str]()
    stiffnesses: list[str] = []
    for number, kind_name, entry in outline.results:
        kind, path = RESULTS.get(kind_name), ("results", number)
        if kind is None:
            continue
        if kind_name == "bending-stiffness":
            yield from _check_length_uncertainty(outline.block("specimen"), entry, path)
        yield from _check_result_needs(outline, kind, (*path, "result"))
        settings = {**list_defaults(kind), **entry}
        for key in list_references(kind, "stiffness"):
            name, here = settings.get(key), (*path, key)
            if isinstance(name, str) and not stiffnesses:
                yield Fault.of("protocol.no_stiffness", here, name=name)
            elif isinstance(name, str) and name not in stiffnesses:
                yield build_choice_fault(here, name, stiffnesses, "one of the stiffnesses above,")
        names = list_result_names(kind_name, entry)
        if repeated := next((name for name in names if name in known_names), None):
            here = (*path, "result")
            yield Fault.of("protocol.result_again", here, name=repeated)
        known_names |= set(names)
        stiffnesses += [
            name
            for name, output in zip(names, kind.outputs, strict=True)
            if output.unit == "N/m" and output.first is None
        ]


def _check_result_needs(outline: Outline, kind: type[Kind], path: KeyPath) -> Faults:
    needs, name = kind.needs, kind.result
    conditions = {
        **dict.fromkeys((_CURVE, _BRANCHES), needs.branches),
        _ALIGNMENT: needs.clocks,
        f"the step {needs.shape!r}": bool(needs.shape),
        _CLAMP: needs.clamp,
    }
    required = [need for need, is_required in conditions.items() if is_required]
    yield from _check_needs(outline, path, name, *required)
    if needs.correction and outline.block("curve"):
        for fault in _check_needs(outline, path, name, f"a block 'curve.{needs.correction}'"):
            override = format_overrides(f"results.{name}", "null")
            remedy = f"{fault.remedy[:-1]}, or remove the result: {override}."
            yield replace(fault, remedy=remedy)
    displacement = str(outline.block("curve").get("displacement"))
    if needs.clamp and outline.find_clock(displacement) not in (None, "markers"):
        yield Fault.of("protocol.clock_of_force", path, result=name, found=displacement)


def _check_figures(outline: Outline) -> Faults:
    figures = get_list(outline.data, "report", "figures")
    for number, figure in enumerate(figures):
        path: KeyPath = ("report", "figures", number)
        if isinstance(figure, str) and figure in _FIGURE_NEEDS:
            yield from _check_needs(outline, path, figure, _FIGURE_NEEDS[figure])
        if figure in figures[:number]:
            yield Fault.of("protocol.figure_again", path, figure=figure)


def _check_display_units(outline: Outline) -> Faults:
    for quantity, unit in outline.block("report", "display").items():
        path: KeyPath = ("report", "display", quantity)
        si_unit = SI_UNITS.get(quantity)
        if si_unit is None:
            fault = build_choice_fault(path, quantity, SI_UNITS, "one of the quantities")
            yield replace(fault, at="key")
        elif parse_or_none(f"1 {unit}", si_unit) is None:
            example = f"{quantity} such as {si_unit}"
            yield Fault.of("protocol.no_unit", path, quantity=example, found=repr(unit))


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


def _check_length_uncertainty(specimen: Values, entry: Values, path: KeyPath) -> Faults:
    """Find a result and a specimen that state different uncertainties of one length."""
    key = "length" if entry.get("support") == "cantilever" else "span"
    here, there = entry.get("length_uncertainty"), get_block(specimen, "uncertainty").get(key)
    values = parse_or_none(here, "m"), parse_or_none(there, "m")
    if None not in values and values[0] != values[1]:
        path = (*path, "length_uncertainty")
        yield Fault.of("protocol.length_twice", path, key=key, here=here, there=there)


def _check_quantity(text: object, unit: str, path: KeyPath, number: str) -> Faults:
    """Find a text that is no quantity of the dimension of a unit."""
    if isinstance(text, str) and parse_or_none(text, unit) is None:
        plain_unit = unit.replace("(", "").replace(")", "")
        remedy = suggest_quantity(text, unit, f"{number} {plain_unit}")
        kind = f"quantity with a unit such as {plain_unit}"
        yield Fault.of("protocol.no_quantity", path, kind=kind, found=repr(text), remedy=remedy)


def _check_range(stated: object, path: KeyPath, unit: str) -> Faults:
    """Find a plausible range without a unit, or with reversed ends."""
    texts = [get_block(stated).get(key) for key in ("from", "to")]
    for key, text in zip(("from", "to"), texts, strict=True):
        yield from _check_quantity(text, unit, (*path, key), "20")
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
    """Find wrong plausible ranges, and dimensions outside their ranges.

    Parameters
    ----------
    data : the file as written; texts that are no quantities are ignored
    blocks : keys of the blocks with dimensions
    others : names of further lengths, whose kind of dimension is ``other``
    ranges : plausible ranges by kind of dimension; those in `data` if None
    in_file : whether the remedy is a wider range in this file; else an override in a test sheet
    """
    for kind, ends in get_block(data, "plausible").items():
        if kind in PLAUSIBLE_RANGES:
            yield from _check_range(ends, ("plausible", kind), PLAUSIBLE_RANGES[kind][0])
    all_ranges = complete_ranges(data.get("plausible") or {} if ranges is None else ranges)
    for block in blocks:
        for path, text in _list_texts(data.get(block), (block,)):
            key = next(str(part) for part in reversed(path) if isinstance(part, str))
            kind = "other" if key in others else ""
            kind = DIMENSION_KINDS.get(key) or DIMENSION_KINDS.get(key.rpartition("_")[2]) or kind
            if ends := get_block(all_ranges, kind):
                yield from _check_size(kind, text, path, ends, in_file=in_file)


def _list_texts(node: object, path: KeyPath) -> Iterator[tuple[KeyPath, str]]:
    """List the texts in a value that may be dimensions, with their paths."""
    if isinstance(node, Mapping):
        for key in node.keys() - {"uncertainty", "labels", "positions"}:
            yield from _list_texts(node[key], (*path, key))
    elif isinstance(node, list):
        for number, item in enumerate(node):
            yield from _list_texts(item, (*path, number))
    elif isinstance(node, str):
        yield path, node


def _check_size(kind: str, text: str, path: KeyPath, ends: Values, *, in_file: bool) -> Faults:
    """Find a dimension outside its plausible range."""
    si_unit, low_text, high_text = PLAUSIBLE_RANGES[kind][0], ends["from"], ends["to"]
    size, low, high = (parse_or_none(value, si_unit) for value in (text, low_text, high_text))
    if size is None or low is None or high is None or low <= abs(size) <= high or low >= high:
        return
    end = "from" if abs(size) < low else "to"
    override = format_overrides(f"plausible.{kind}.{end}", text)
    yield Fault.of(
        "protocol.implausible",
        path,
        kind=kind.replace("_", " ") if kind != "other" else "dimension",
        low=low_text,
        high=high_text,
        found=repr(text),
        override=f"'plausible: {{{kind}: {{{end}: {text}}}}}'" if in_file else override,
    )
