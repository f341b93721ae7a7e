"""Checks of one part of a protocol against another, none of which needs data.

They look at the protocol as written, not at the finished models, so that a misspelt key in one
place hides nothing that is wrong in another.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, TypeAlias

from labpipe.errors import Fault, KeyPath, in_test_sheet, nearest
from labpipe.protocol.faults import Values, block_in, list_in, not_among, one_of, shown
from labpipe.protocol.plausible import plausible_faults, quantity_in, range_faults
from labpipe.protocol.source import MARKER_READERS, READERS, ROLES
from labpipe.protocol.values import SI_UNITS, si_unit_like, unit_remedy
from labpipe.records.declarations import STEPS, defaults_of, existing_in
from labpipe.results import KINDS
from labpipe.results.kinds import Kind
from labpipe.units import parse_quantity, si_factor

Faults: TypeAlias = Iterator[Fault]
RESULTS: Final[Mapping[str, Any]] = {kind.result: kind for kind in KINDS}
"""The kinds of results by their word in YAML."""
CHANNEL_KEYS = (
    *("channel", "unit", "wrong_unit_in_file", "calibration"),
    *("quantity", "plausible_peak", "scale_uncertainty", "zero_drift", "certificate"),
)
_CAMERA_KEYS = frozenset({"scale_uncertainty", "certificate"})
"""Keys of a channel that marker tracks have, too."""
_SHAPE_STEPS = ("fit-shape", "three-point-shape")
"""Steps of which one makes the shapes that `wire-shapes` shows."""
_ADD_MARKERS = "Add the source 'markers'."
_NAME_CLAMP = "Name the rigid body at the clamp in 'markers.clamp'."
_TURNING_POINTS = "Set 'align.method' to 'turning-points'."


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

    @property
    def unit(self) -> str | None:
        """SI unit of what it measures; None if that is not known."""
        return SI_UNITS.get(self.quantity or "")


class Outline:
    """Names and tags of a protocol as written, whether or not its details are valid.

    Parameters
    ----------
    data : the protocol as plain values
    """

    def __init__(self, data: Values) -> None:
        self.data = data
        self.sources = {role: block_in(data, "sources", role) for role in block_in(data, "sources")}
        self.channels = [
            x for role, source in self.sources.items() for x in _channels(role, source)
        ]
        self.steps = _tagged(data, "steps", "step")
        self.results = _tagged(data, "results", "result")
        self.has_markers = "markers" in self.sources or any(
            MARKER_READERS & {*readers_in(source)} for source in self.sources.values()
        )
        self.has_clamp = self.block("markers").get("clamp") is not None
        self.made = [name for _, tag, step in self.steps for name in self.made_by(tag, step)]
        """Channels that the steps add, in order."""
        self.names = [channel.name for channel in self.channels] + self.made
        methods = ("turning-points", "common-start", "stated")
        self.joins_clocks = self.block("align").get("method") in methods

    def block(self, *path: str) -> Values:
        """Return the block under a path; empty if there is none."""
        return block_in(self.data, *path)

    def made_by(self, tag: str, step: Values) -> tuple[str, ...]:
        """List the channels that a step makes; a frame without a clamp makes none."""
        if tag not in STEPS or (tag == "specimen-frame" and not self.has_clamp):
            return ()
        return tuple(name.format_map({"channel": None, **step}) for name in STEPS[tag].makes)

    @property
    def from_speed(self) -> dict[str, str]:
        """Channels that are made from crosshead speed, and the force that each is made with."""
        steps = (step for _, tag, step in self.steps if tag == "travel-from-speed")
        return {str(step.get("channel")): str(step.get("force")) for step in steps}

    def is_optional(self, role: str) -> bool:
        """Return whether a test may lack a source."""
        return str(self.block("sources", role).get("optional")).lower() == "true"

    def clock_of(self, channel: str) -> str | None:
        """Return the role whose clock a channel is on; None for an unknown channel."""
        clocks = {source.name: source.role for source in reversed(self.channels)}
        if channel not in clocks and channel in self.from_speed:
            channel = self.from_speed[channel]
        if channel in clocks:
            return clocks[channel]
        return "markers" if channel in self.made else None

    def unit_of(self, channel: object) -> str | None:
        """Return the SI unit of a channel; None where it is not known."""
        if channel in self.made:
            return "m"
        return next((source.unit for source in self.channels if source.name == channel), None)


def readers_in(source: Values) -> list[str]:
    """List the known readers that a source names."""
    reader = source.get("reader")
    return [word for word in (reader if isinstance(reader, list) else [reader]) if word in READERS]


def _channels(role: str, source: Values) -> Iterator[Channel]:
    if _channel_keys(role, source):
        name = role if role in ROLES else nearest(role, list(ROLES), limit=1)[0]
        yield Channel(name, role, ("sources", role), source)
    for name in block_in(source, "channels"):
        path = ("sources", role, "channels", name)
        yield Channel(name, role, path, block_in(source, "channels", name))


def _channel_keys(role: str, source: Values) -> list[str]:
    """List the keys of a source that are those of a channel."""
    others = _CAMERA_KEYS if role == "markers" else frozenset[str]()
    return [key for key in CHANNEL_KEYS if key in source and key not in others]


def _tagged(data: Values, key: str, tag: str) -> list[tuple[int, str, Values]]:
    """List number, tag and content of the blocks of a list that have a tag."""
    return [
        (number, item[tag], item)
        for number, item in enumerate(list_in(data, key))
        if isinstance(item, Mapping) and isinstance(item.get(tag), str)
    ]


def result_names(tag: str, entry: Values) -> tuple[str, ...]:
    """List what an entry is called in the summary; of several cycles or slips, the first.

    Parameters
    ----------
    tag : such as ``two-segments``
    entry : the block as written, which may give a name of its own
    """
    kind = RESULTS.get(tag)
    return () if kind is None else tuple(output.name_in(kind, entry) for output in kind.outputs)


def cross_faults(data: Values) -> list[Fault]:
    """Find what is wrong between the parts of a protocol.

    Parameters
    ----------
    data : the protocol as plain values, whether or not its details are valid

    Returns
    -------
    The faults, with their paths in `data`.
    """
    outline = Outline(data)
    return [
        *_source_faults(outline),
        *size_faults(outline.block("specimen")),
        *plausible_faults(data, ("specimen", "rig", "markers", "results")),
        *_step_faults(outline),
        *_align_faults(outline),
        *_curve_faults(outline),
        *_result_faults(outline),
        *_figure_faults(outline),
        *_display_faults(outline),
        *_group_faults(outline),
    ]


def _lacking(path: KeyPath, block: str, needed_for: str) -> Fault:
    return Fault(path, f"a block {block!r} for {needed_for}", "none", f"Add the block {block!r}.")


def _source_faults(outline: Outline) -> Faults:
    for role in set(outline.sources) & set(ROLES):
        yield from _content_faults(role, outline.sources[role])
    taken = dict.fromkeys(outline.made, "a step")
    for channel in outline.channels:
        if not (channel.name in outline.from_speed and outline.is_optional(channel.role)):
            if channel.name in taken:
                expected = f"a name that {taken[channel.name]} has not taken"
                yield Fault(channel.path, expected, repr(channel.name), "Rename it.", "key")
            taken[channel.name] = f"the source {channel.role!r}"
        yield from _channel_faults(channel)
        yield from certificate_faults(channel.values, channel.path)
    yield from certificate_faults(outline.block("sources", "markers"), ("sources", "markers"))


def _content_faults(role: str, source: Values) -> Faults:
    """Find a source that gives neither channels nor marker tracks, or both."""
    path, readers, short = ("sources", role), readers_in(source), _channel_keys(role, source)
    for key in {"dialect", "part"} & {*source} if "load-frame" not in readers else ():
        expected = "this key for the reader 'load-frame' alone"
        remedy = "Remove it, or name the reader 'load-frame'."
        yield Fault((*path, key), expected, f"the key {key!r}", remedy, "key")
    valid = MARKER_READERS if role == "markers" else {*READERS} - MARKER_READERS
    if not {*readers} <= valid:
        expected = f"a reader of {'marker tracks' if role == 'markers' else 'channels'}"
        remedy = f"Use one of {one_of('', valid)}."
        yield Fault((*path, "reader"), expected, ", ".join(map(repr, readers)), remedy)
    elif role == "markers":
        for key in [key for key in ("channels", *short) if key in source][:1]:
            expected = "no channels beside marker tracks"
            yield Fault((*path, key), expected, f"the key {key!r}", "Remove it.")
    elif readers:
        yield from _form_faults(source, path, short)


def _form_faults(source: Values, path: KeyPath, short: Sequence[str]) -> Faults:
    """Find a source that names no channel, or writes channels in two ways."""
    if "channels" in source and short:
        found, remedy = f"{short[0]!r} beside it", "Move it into 'channels'."
        yield Fault((*path, short[0]), "'channels' alone", found, remedy)
    elif not source.get("channels") and "channel" not in source:
        remedy = "Add the key 'channel', or 'channels' for several."
        yield Fault(path, "the name of a channel", "none", remedy)


def _channel_faults(channel: Channel) -> Faults:
    path, values, quantity, target = channel.path, channel.values, channel.quantity, channel.unit
    if quantity is None:
        remedy = f"Add 'quantity', one of {one_of(channel.name, SI_UNITS)}."
        yield Fault(path, "to know what the channel measures", "no 'quantity'", remedy)
        return
    if target is None:
        yield not_among((*path, "quantity"), quantity, SI_UNITS, "one of the quantities")
        return
    yield from range_faults(values.get("plausible_peak"), (*path, "plausible_peak"), target)
    if quantity != "force" and "zero_drift" in values:  # only that of the force is in an interval
        expected, found = "this key for a force alone", f"the key 'zero_drift' of a {quantity}"
        yield Fault((*path, "zero_drift"), expected, found, "Remove it.", "key")
    yield from _unit_faults(path, values, quantity, target)


def _unit_faults(path: KeyPath, values: Values, quantity: str, target: str) -> Faults:
    """Find a unit or a calibration that does not lead to the unit of the quantity."""
    calibration, unit = values.get("calibration"), values.get("unit")
    if unit is None and values.get("wrong_unit_in_file") is not None:
        remedy = "Add the key 'unit', such as N."
        yield Fault((*path, "wrong_unit_in_file"), "the right unit beside it", "none", remedy)
    if unit is None and calibration is not None:
        remedy = "Add the key 'unit', such as V."
        yield Fault(path, "the unit that the calibration starts from", "none", remedy)
    if unit is None:
        return
    before = si_unit_like(str(unit)) if calibration is not None else target
    if before is None:
        yield Fault((*path, "unit"), "a unit such as V", repr(unit), "Write the unit alone.")
    elif remedy := unit_remedy(str(unit), before):
        expected = f"a unit of {quantity} such as {before}"
        remedy = f"{remedy} Correct it, or add a 'calibration'."
        yield Fault((*path, "unit"), expected, repr(unit), remedy)
    else:
        units = {"gain": f"{target}/({before})", "offset": target}
        yield from _calibration_faults(block_in(calibration), units, (*path, "calibration"))


def _calibration_faults(calibration: Values, units: Mapping[str, str], path: KeyPath) -> Faults:
    """Find a gain or an offset in the wrong unit, or a gain that loses the signal."""
    for key, unit in units.items():
        text = calibration.get(key)
        value = quantity_in(text, unit, (*path, key), "0.5") if isinstance(text, str) else None
        if isinstance(value, Fault):
            yield value
        elif key == "gain" and value == 0.0:
            yield Fault((*path, key), "a gain other than zero", repr(text), "Correct it.")


def _step_faults(outline: Outline) -> Faults:
    names = [channel.name for channel in outline.channels]
    earlier: list[str] = []
    for number, tag, step in outline.steps:
        kind, path = STEPS.get(tag), ("steps", number)
        here: KeyPath = (*path, "step")
        if kind is not None and kind.on_markers:
            yield from _marker_step_faults(outline, tag, earlier, here)
        for key in existing_in(kind, "channel") if kind is not None else ("channel",):
            yield from _no_channel(step, (*path, key), names, outline.made)
        if tag == "travel-from-speed":
            yield from _from_speed_faults(outline, step, here)
        span = step.get("span")
        if isinstance(span, str) and span.strip().endswith("%") and not outline.block("branches"):
            expected = "a span of time or samples where there are no branches"
            remedy = "Add the block 'branches', or give the span in s."
            yield Fault((*path, "span"), expected, repr(span), remedy)
        names += outline.made_by(tag, step)
        earlier.append(tag)


def _marker_step_faults(
    outline: Outline, tag: str, earlier: Sequence[str], here: KeyPath
) -> Faults:
    if not outline.has_markers:
        yield Fault(here, f"a source of marker tracks for {tag!r}", "none", _ADD_MARKERS)
    elif not outline.block("markers"):
        yield _lacking(here, "markers", repr(tag))
    if tag in earlier:
        yield Fault(here, f"{tag!r} once", "a second one", "Remove one of them.")
    needed = STEPS[tag].after
    if needed and needed not in earlier:
        remedy = f"Put the step {needed!r} before it."
        yield Fault(here, f"{needed!r} before {tag!r}", "no such step before", remedy)


def _from_speed_faults(outline: Outline, step: Values, here: KeyPath) -> Faults:
    """Find a travel that nothing can be made of, where no source can take its place."""
    rig = outline.block("rig")
    if rig.get("cycles") not in (None, "1", 1):
        remedy = "Remove the step, or set 'rig.cycles' to 1."
        expected = "one cycle for 'travel-from-speed'"
        yield Fault(("rig", "cycles"), expected, f"{rig.get('cycles')}", remedy)
    is_measured = any(channel.name == step.get("channel") for channel in outline.channels)
    for key in {"crosshead_speed", "stroke"} - {*rig} if not is_measured else ():
        remedy = f"Add 'rig.{key}', or a source that measures the displacement."
        yield Fault(here, f"'rig.{key}' for 'travel-from-speed'", "none", remedy)


def _no_channel(
    block: Values, path: KeyPath, names: Sequence[str], later: Iterable[str] = ()
) -> Faults:
    """Find a channel that does not exist, or not yet."""
    name = block.get(str(path[-1]))
    if not isinstance(name, str) or name in names:
        return
    if name in later:
        remedy = "Move it behind the step that makes this channel."
        yield Fault(path, "a channel that exists at this step", repr(name), remedy)
    elif names:
        yield not_among(path, name, names, "one of the channels")
    else:
        yield Fault(path, "a channel", repr(name), "No source gives a channel.")


def _align_faults(outline: Outline) -> Faults:
    align, here = outline.block("align"), ("align", "method")
    if outline.joins_clocks:
        yield from _no_channel(align, ("align", "channel"), [x.name for x in outline.channels])
    if align.get("method") != "turning-points":
        return
    if not outline.has_markers:
        yield Fault(here, "a source of marker tracks for 'turning-points'", "none", _ADD_MARKERS)
    elif not outline.has_clamp:
        yield Fault(here, "a clamp whose motion has the turning points", "none", _NAME_CLAMP)


def _curve_faults(outline: Outline) -> Faults:
    curve, branches = outline.block("curve"), outline.block("branches")
    for key, unit in (("force", "N"), ("displacement", "m")):
        yield from _no_channel(curve, ("curve", key), outline.names)
        other = outline.unit_of(curve.get(key))
        if other not in (None, unit):
            found = f"{curve[key]!r} in {other}"
            yield Fault(("curve", key), f"a channel in {unit}", found, "Name another channel.")
    measured = [channel.name for channel in outline.channels]
    for quantity in list_in(curve, "reverse"):
        name = curve.get(quantity) if isinstance(quantity, str) else None
        if name in outline.made and name not in measured:
            remedy = "Its sign is that of the specimen frame: take it out of 'curve.reverse'."
            found = f"{name!r}, which a step makes"
            yield Fault(("curve", "reverse"), "a channel that a source gives", found, remedy)
    names = (curve.get("force"), curve.get("displacement"))
    clocks = {outline.clock_of(str(name)) for name in names} - {None}
    if len(clocks) > 1 and not outline.joins_clocks:
        path: KeyPath = ("align", "method") if outline.block("align") else ("curve",)
        expected = "a method that joins the two clocks of the curve"
        yield Fault(path, expected, "none", _TURNING_POINTS)
    yield from _no_channel(branches, ("branches", "channel"), outline.names)
    if branches and not curve:
        yield _lacking(("branches",), "curve", "'branches'")


def _result_faults(outline: Outline) -> Faults:
    seen: dict[str, str] = {}
    stiffnesses: list[str] = []
    for number, tag, entry in outline.results:
        kind, path = RESULTS.get(tag), ("results", number)
        if tag == "bending-stiffness":
            yield from length_faults(outline.block("specimen"), entry, path)
        if kind is None:
            continue
        yield from _need_faults(outline, kind, (*path, "result"))
        settings = {**defaults_of(kind), **entry}
        for key in existing_in(kind, "stiffness"):
            yield from _no_stiffness(settings.get(key), (*path, key), stiffnesses)
        names = result_names(tag, entry)
        yield from _repeated_faults(names, tag, seen, (*path, "result"))
        seen |= dict.fromkeys(names, tag)
        named_outputs = zip(names, kind.outputs, strict=True)
        stiffnesses += [
            name for name, output in named_outputs if output.unit == "N/m" and output.first is None
        ]


def _no_stiffness(name: object, path: KeyPath, earlier: Sequence[str]) -> Faults:
    """Find a result of a stiffness that is not above it in the list."""
    remedy = "Add a result 'stiffness' before it."
    if not isinstance(name, str) or name in earlier:
        return
    if earlier:
        yield not_among(path, name, earlier, "one of the stiffnesses above,", remedy=remedy)
    else:
        yield Fault(path, "a stiffness above it in the list", repr(name), remedy)


def _repeated_faults(
    names: Iterable[str], tag: str, seen: Mapping[str, str], path: KeyPath
) -> Faults:
    """Find a result whose name in the summary another one has."""
    repeated = next((name for name in names if name in seen), None)
    if repeated is None:
        return
    remedy, found = "Remove one of them.", repeated
    if "name" in defaults_of(RESULTS[tag]):
        remedy = "Give it another 'name'."
    elif "name" in defaults_of(RESULTS[seen[repeated]]):
        remedy = f"Give the {seen[repeated]} of that name another 'name'."
    elif tag != "normalised-stiffness":
        found = tag
    yield Fault(path, "each result once", f"a second {found!r}", remedy)


def _need_faults(outline: Outline, kind: type[Kind], path: KeyPath) -> Faults:
    needs, tag = kind.needs, kind.result
    for block in ("curve", "branches") if needs.branches else ():
        if not outline.block(block):
            yield _lacking(path, block, repr(tag))
    needed = needs.correction
    if needed and outline.block("curve") and not outline.block("curve", needed):
        out = in_test_sheet(f"results.{tag}", "null")
        remedy = f"Add the block {needed!r} to 'curve', or take the result out: {out}."
        yield Fault(path, f"a block 'curve.{needed}' for {tag!r}", "none", remedy)
    if needs.clocks and not outline.joins_clocks:
        expected = f"'align.method' to be 'turning-points' for {tag!r}"
        yield Fault(path, expected, "another", _TURNING_POINTS)
    if needs.shape:
        yield from _shape_faults(outline, tag, (needs.shape,), path)
    if needs.clamp:
        yield from _clamp_faults(outline, tag, path)


def _clamp_faults(outline: Outline, tag: str, path: KeyPath) -> Faults:
    """Find a moment without a clamped end, or with a force on another clock than the shape."""
    if not outline.has_clamp:
        yield Fault(path, f"a clamped end for {tag!r}", "none", _NAME_CLAMP)
    displacement = outline.block("curve").get("displacement")
    if isinstance(displacement, str) and outline.clock_of(displacement) not in (None, "markers"):
        expected = f"a curve on the clock of the markers for {tag!r}"
        remedy = "Set 'curve.displacement' to 'deflection'."
        yield Fault(path, expected, f"displacement {displacement!r}", remedy)


def _shape_faults(outline: Outline, tag: str, steps: tuple[str, ...], path: KeyPath) -> Faults:
    """Find a result or a figure of a shape that none of some steps makes."""
    if not {step for _, step, _ in outline.steps} & {*steps}:
        expected, remedy = f"the step {steps[0]!r} for {tag!r}", f"Add the step {steps[0]!r}."
        yield Fault(path, expected, "no such step", remedy)


def _figure_faults(outline: Outline) -> Faults:
    figures = list_in(outline.data, "report", "figures")
    for number, figure in enumerate(figures):
        path: KeyPath = ("report", "figures", number)
        needs_curve = figure in ("force-displacement", "stiffness-lines", "timeline")
        if needs_curve and not outline.block("curve"):
            yield _lacking(path, "curve", repr(figure))
        if figure == "wire-shapes":
            yield from _shape_faults(outline, figure, _SHAPE_STEPS, path)
        if figure == "moment-curvature" and not any(figure == tag for _, tag, _ in outline.results):
            expected = f"a result {figure!r} for {figure!r}"
            yield Fault(path, expected, "none", f"Add a result {figure!r}.")
        if figure == "marker-quality" and not outline.has_markers:
            yield Fault(path, f"a source of marker tracks for {figure!r}", "none", _ADD_MARKERS)
        if figure in figures[:number]:
            yield Fault(path, "each figure once", f"{figure!r} again", "Remove one of them.")


def _display_faults(outline: Outline) -> Faults:
    for quantity, unit in outline.block("report", "display").items():
        path: KeyPath = ("report", "display", quantity)
        if quantity not in SI_UNITS:
            yield not_among(path, quantity, SI_UNITS, "one of the quantities", at="key")
            continue
        try:
            si_factor(str(unit), SI_UNITS[quantity])
        except ValueError:
            expected = f"a unit of {quantity} such as {SI_UNITS[quantity]}"
            yield Fault(path, expected, repr(unit), "Write the unit alone, without a number.")


def _group_faults(outline: Outline) -> Faults:
    """Find a number that the report is to show first and that no result gives."""
    names = [name for _, tag, entry in outline.results for name in result_names(tag, entry)]
    cycle = re.compile(r"\.\d+$")
    of_any_cycle = [cycle.sub(".1", name) for name in names]
    for number, name in enumerate(list_in(outline.data, "groups", "main")):
        path: KeyPath = ("groups", "main", number)
        if not isinstance(name, str) or cycle.sub(".1", name) in of_any_cycle:
            continue
        if names:
            yield not_among(path, name, names, "one of the results")
        else:
            yield Fault(path, "a result", repr(name), "The protocol asks for none.")


def certificate_faults(values: Mapping[str, object], path: KeyPath) -> Iterator[Fault]:
    """Find an uncertainty of a scale that its certificate contradicts.

    Parameters
    ----------
    values : block of a channel or source as written
    path : way to it
    """
    certificate = values.get("certificate")
    calibration = values.get("calibration")
    if not isinstance(certificate, Mapping) or certificate.get("uncertainty") is None:
        return
    gain = calibration if isinstance(calibration, Mapping) else {}
    stated = {
        (*path, "calibration", "gain_uncertainty"): gain.get("gain_uncertainty"),
        (*path, "scale_uncertainty"): values.get("scale_uncertainty"),
    }
    uncertainties = {place: _ratio(text) for place, text in stated.items() if text is not None}
    expanded, k = _ratio(certificate["uncertainty"]), _ratio(certificate.get("k", 2))
    if expanded is None or not k or None in uncertainties.values():
        return  # each is a fault of its own
    standard = expanded / k
    together = sum(value**2 for value in uncertainties.values() if value is not None) ** 0.5
    if not together or abs(together - standard) <= 1e-9 * standard:
        return
    place = next(place for place, value in uncertainties.items() if value)
    expected = f"{100.0 * standard:.4g} %, as 'certificate' has it"
    actual = f"{100.0 * together:.4g} %"
    remedy = f"Take {place[-1]!r} out, or 'uncertainty' out of the certificate."
    yield Fault(place, expected, actual, remedy)


def size_faults(specimen: Mapping[str, object]) -> Iterator[Fault]:
    """Find a size of the specimen that is known no better than it is large.

    Parameters
    ----------
    specimen : block as written
    """
    uncertainties, section = specimen.get("uncertainty"), specimen.get("section")
    sizes = {**(section if isinstance(section, Mapping) else {}), **specimen}
    for key, text in uncertainties.items() if isinstance(uncertainties, Mapping) else ():
        unit = "m^2" if key == "area" else "m"
        size, uncertainty = (_quantity(value, unit) for value in (sizes.get(key), text))
        if size is not None and uncertainty is not None and uncertainty >= size > 0.0:
            expected = f"less than the {key} itself, {sizes[key]}"
            yield Fault(
                ("specimen", "uncertainty", key), expected, shown(text), "Look at its unit."
            )


def length_faults(
    specimen: Mapping[str, object], entry: Mapping[str, object], path: KeyPath
) -> Iterator[Fault]:
    """Find an uncertainty of a length that a result states otherwise than the specimen.

    Parameters
    ----------
    specimen : block as written
    entry : of a bending stiffness
    path : way to it
    """
    key = "length" if entry.get("support") == "cantilever" else "span"
    block = specimen.get("uncertainty")
    there = block.get(key) if isinstance(block, Mapping) else None
    here = entry.get("length_uncertainty")
    values = _quantity(here, "m"), _quantity(there, "m")
    if None in values or values[0] == values[1]:
        return
    expected = f"the uncertainty of the {key} once"
    actual = f"{here!r} beside {there!r} in 'specimen.uncertainty.{key}'"
    remedy = f"Write it as 'specimen.uncertainty.{key}' alone."
    yield Fault((*path, "length_uncertainty"), expected, actual, remedy)


def _ratio(text: object) -> float | None:
    return _quantity(text, "1")


def _quantity(text: object, unit: str) -> float | None:
    """Value in a unit; None for what is none, which is a fault of its own."""
    try:
        return parse_quantity(text, unit)
    except ValueError:
        return None
