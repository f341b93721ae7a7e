"""The outline of a protocol, readable even where details are wrong; the checks of its sources.

The checks of one part of a protocol against another look at this outline and not at the finished
models, so that a misspelt key in one place hides nothing that is wrong in another.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, TypeAlias

from labpipe.errors import Fault, KeyPath, nearest
from labpipe.protocol.faults import did_you_mean, one_of
from labpipe.protocol.plausible import range_faults
from labpipe.protocol.source import MARKER_READERS, READERS, ROLES
from labpipe.protocol.uncertainties import certificate_faults
from labpipe.protocol.values import SI_UNITS, quantity_remedy, si_unit_like, unit_remedy
from labpipe.records.declarations import STEPS
from labpipe.results import KINDS
from labpipe.units import parse_quantity, si_factor

Values: TypeAlias = Mapping[str, object]
RESULTS: Final[Mapping[str, Any]] = {kind.result: kind for kind in KINDS}
"""The kinds of results by their word in YAML."""

CHANNEL_KEYS = (
    *("channel", "unit", "wrong_unit_in_file", "calibration"),
    *("quantity", "plausible_peak", "scale_uncertainty", "zero_drift", "certificate"),
)
_OF_CAMERAS = frozenset({"scale_uncertainty", "certificate"})
"""Keys of a channel that marker tracks have, too."""


@dataclass(frozen=True, slots=True)
class ChannelOutline:
    """One channel of a source.

    Parameters
    ----------
    name : as labpipe calls it
    role : of its source
    path : way to its block
    values : what the block says
    quantity : what it measures; None if that is missing
    unit : SI unit of what it measures; None if that is not known
    """

    name: str
    role: str
    path: KeyPath
    values: Values
    quantity: str | None
    unit: str | None


@dataclass(frozen=True, slots=True)
class Entry:
    """One block of a list, as its tag calls it.

    Parameters
    ----------
    number : in the list, from 0
    tag : such as ``zero``; perhaps an unknown one
    values : what the block says
    makes : channels that a step adds to those of the sources
    """

    number: int
    tag: str
    values: Values
    makes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Outline:
    """Names and tags of a protocol as written.

    Parameters
    ----------
    data : the protocol as plain values
    sources : by role
    readers : known readers that each source names, by role
    channels : of all sources
    steps, results : those that have a tag
    has_markers : whether any source gives marker tracks
    has_clamp : whether a rigid body marks the clamp
    """

    data: Values
    sources: Mapping[str, Values]
    readers: Mapping[str, Sequence[str]]
    channels: Sequence[ChannelOutline]
    steps: Sequence[Entry]
    results: Sequence[Entry]
    has_markers: bool
    has_clamp: bool

    def block(self, *path: str) -> Values:
        """Find the block under a path; empty if there is none."""
        return _block(self.data, *path)

    @property
    def names(self) -> list[str]:
        """Return all channels: those of the sources, then those that the steps add."""
        return [channel.name for channel in self.channels] + self.made

    @property
    def made(self) -> list[str]:
        """Return the channels that the steps add, in order."""
        return [name for step in self.steps for name in step.makes]

    @property
    def from_speed(self) -> dict[str, str]:
        """Return the channels that are made from crosshead speed, each with its force."""
        return {
            str(step.values.get("channel")): str(step.values.get("force"))
            for step in self.steps
            if step.tag == "travel-from-speed"
        }

    @property
    def joins_clocks(self) -> bool:
        """Return whether two clocks are joined."""
        return self.block("align").get("method") in ("turning-points", "common-start", "stated")

    def is_optional(self, role: str) -> bool:
        """Return whether a source is optional in a test."""
        return str(self.block("sources", role).get("optional")).lower() == "true"

    def clock_of(self, channel: str) -> str | None:
        """Return the role whose clock a channel is on; None for an unknown channel."""
        clocks = {channel.name: channel.role for channel in reversed(self.channels)}
        if channel in clocks:
            return clocks[channel]
        if channel in self.from_speed:
            return clocks.get(self.from_speed[channel])
        return "markers" if channel in self.made else None

    def unit_of(self, channel: str) -> str | None:
        """Return the SI unit of a channel; None where it is not known."""
        if channel in self.made:
            return "m"
        return next((outline.unit for outline in self.channels if outline.name == channel), None)


def outline_of(data: Values) -> Outline:
    """Read the outline of a protocol.

    Parameters
    ----------
    data : the protocol as plain values, whether or not its details are valid
    """
    sources = {role: _block(data, "sources", role) for role in _block(data, "sources")}
    readers: dict[str, list[str]] = {}
    channels: list[ChannelOutline] = []
    for role, source in sources.items():
        reader = source.get("reader")
        reader_names = reader if isinstance(reader, list) else [reader]
        readers[role] = [word for word in reader_names if word in READERS]
        if channel_keys(role, source):
            name = role if role in ROLES else nearest(role, list(ROLES), limit=1)[0]
            channels.append(_channel(name, role, ("sources", role), source))
        for name in _block(source, "channels"):
            path = ("sources", role, "channels", name)
            channels.append(_channel(name, role, path, _block(source, "channels", name)))
    has_clamp = _block(data, "markers").get("clamp") is not None
    return Outline(
        data,
        sources,
        readers,
        channels,
        [_with_channels(step, has_clamp=has_clamp) for step in _entries(data, "steps", "step")],
        _entries(data, "results", "result"),
        "markers" in sources
        or any(MARKER_READERS & {*known_readers} for known_readers in readers.values()),
        has_clamp,
    )


def channel_keys(role: str, source: Values) -> list[str]:
    """List the keys of a source that are those of a channel.

    Parameters
    ----------
    role : name of the source; cameras have other keys in the role ``markers``
    source : the block as written
    """
    others = _OF_CAMERAS if role == "markers" else frozenset[str]()
    return [key for key in CHANNEL_KEYS if key in source and key not in others]


def _block(data: Values, *path: str) -> Values:
    node: object = data
    for key in path:
        node = node.get(key) if isinstance(node, Mapping) else None
    return node if isinstance(node, Mapping) else {}


def _entries(data: Values, key: str, tag: str) -> list[Entry]:
    """List the blocks of a list that have a tag."""
    items = data.get(key)
    return [
        Entry(number, item[tag], item)
        for number, item in enumerate(items if isinstance(items, list) else [])
        if isinstance(item, Mapping) and isinstance(item.get(tag), str)
    ]


def _with_channels(step: Entry, *, has_clamp: bool) -> Entry:
    """Return a step with the channels that it makes; a frame without a clamp makes none."""
    if step.tag not in STEPS or (step.tag == "specimen-frame" and not has_clamp):
        return step
    names = {"channel": None, **step.values}
    return replace(step, makes=tuple(name.format_map(names) for name in STEPS[step.tag].makes))


def _channel(name: str, role: str, path: KeyPath, values: Values) -> ChannelOutline:
    stated = values.get("quantity")
    quantity = stated if isinstance(stated, str) else name if name in SI_UNITS else None
    return ChannelOutline(name, role, path, values, quantity, SI_UNITS.get(quantity or ""))


def result_names(tag: str, entry: Values) -> tuple[str, ...]:
    """List what an entry is called in the summary; of several cycles or slips, the first.

    Parameters
    ----------
    tag : such as ``two-segments``
    entry : the block as written, which may give a name of its own
    """
    kind = RESULTS.get(tag)
    return () if kind is None else tuple(output.name_in(kind, entry) for output in kind.outputs)


def source_faults(outline: Outline) -> Iterator[Fault]:
    """Find what is wrong with the sources of a protocol.

    Parameters
    ----------
    outline : names and tags of the protocol
    """
    for role in set(outline.sources) & set(ROLES):
        yield from _content_faults(outline, role)
    yield from _name_faults(outline)
    for channel in outline.channels:
        yield from _unit_faults(channel)
        yield from certificate_faults(channel.values, channel.path)
    yield from certificate_faults(outline.block("sources", "markers"), ("sources", "markers"))


def _content_faults(outline: Outline, role: str) -> Iterator[Fault]:
    """Find a source that gives neither channels nor marker tracks, or both."""
    source, path = outline.sources[role], ("sources", role)
    readers = set(outline.readers[role])
    has_markers, has_channels = bool(readers & MARKER_READERS), bool(readers - MARKER_READERS)
    if (role == "markers" and has_channels) or (role != "markers" and has_markers):
        valid = MARKER_READERS if role == "markers" else set(READERS) - MARKER_READERS
        expected = f"a reader of {'marker tracks' if role == 'markers' else 'channels'}"
        actual = ", ".join(repr(word) for word in outline.readers[role])
        remedy = f"Use one of {one_of('', valid)}."
        yield Fault((*path, "reader"), expected, actual, remedy)
        return
    short = channel_keys(role, source)
    if role == "markers" and (short or "channels" in source):
        key = "channels" if "channels" in source else short[0]
        yield Fault((*path, key), "no channels beside marker tracks", f"the key {key!r}", _OUT)
    elif role != "markers" and has_channels:
        yield from _form_faults(source, path, short)
    if "load-frame" not in readers:
        for key in ("dialect", "part"):
            if key in source:
                remedy = "Remove it, or name the reader 'load-frame'."
                expected = "this key for the reader 'load-frame' alone"
                yield Fault((*path, key), expected, f"the key {key!r}", remedy, "key")


_OUT = "Remove it."


def _form_faults(source: Values, path: KeyPath, short: list[str]) -> Iterator[Fault]:
    """Find a source that names no channel, or writes channels in two ways."""
    if "channels" in source and short:
        remedy = "Move it into 'channels'."
        yield Fault((*path, short[0]), "'channels' alone", f"{short[0]!r} beside it", remedy)
    elif not source.get("channels") and "channel" not in source:
        remedy = "Add the key 'channel', or 'channels' for several."
        yield Fault(path, "the name of a channel", "none", remedy)


def _name_faults(outline: Outline) -> Iterator[Fault]:
    """Find a channel name that two things share."""
    taken = dict.fromkeys(outline.made, "a step")
    for channel in outline.channels:
        if channel.name in outline.from_speed and outline.is_optional(channel.role):
            continue  # the step makes it where a test lacks the source
        if channel.name in taken:
            expected = f"a name that {taken[channel.name]} has not taken"
            yield Fault(channel.path, expected, repr(channel.name), "Rename it.", "key")
        taken[channel.name] = f"the source {channel.role!r}"


def _unit_faults(channel: ChannelOutline) -> Iterator[Fault]:
    target = channel.unit
    if target is None:
        yield _unknown_quantity(channel)
        return
    peak = channel.values.get("plausible_peak")
    yield from range_faults(peak, (*channel.path, "plausible_peak"), target)
    yield from _drift_faults(channel)
    calibration, unit = channel.values.get("calibration"), channel.values.get("unit")
    if unit is None and channel.values.get("wrong_unit_in_file") is not None:
        remedy = "Add the key 'unit', such as N."
        yield Fault(
            (*channel.path, "wrong_unit_in_file"), "the right unit beside it", "none", remedy
        )
    if unit is None:
        if calibration is not None:
            remedy = "Add the key 'unit', such as V."
            yield Fault(channel.path, "the unit that the calibration starts from", "none", remedy)
        return
    before = si_unit_like(str(unit)) if calibration is not None else target
    path = (*channel.path, "unit")
    if before is None:
        yield Fault(path, "a unit such as V", repr(unit), "Write the unit alone.")
        return
    try:
        si_factor(str(unit), before)
    except ValueError:
        expected = f"a unit of {channel.quantity} such as {before}"
        remedy = f"{unit_remedy(str(unit), before)} Correct it, or add a 'calibration'.".lstrip()
        yield Fault(path, expected, repr(unit), remedy)
        return
    if isinstance(calibration, dict):
        yield from _calibration_faults(channel, calibration, f"{target}/({before})")


def _drift_faults(channel: ChannelOutline) -> Iterator[Fault]:
    """Find a drift of a zero that no interval would hold: only that of the force is an input."""
    if channel.quantity != "force" and "zero_drift" in channel.values:
        actual = f"the key 'zero_drift' of a {channel.quantity}"
        yield Fault(
            (*channel.path, "zero_drift"), "this key for a force alone", actual, _OUT, "key"
        )


def _unknown_quantity(channel: ChannelOutline) -> Fault:
    quantity = channel.quantity
    if quantity is None:
        remedy = f"Add 'quantity', one of {one_of(channel.name, SI_UNITS)}."
        return Fault(channel.path, "to know what the channel measures", "no 'quantity'", remedy)
    expected = f"one of the quantities {one_of(quantity, SI_UNITS)}"
    return Fault(
        (*channel.path, "quantity"), expected, repr(quantity), did_you_mean(quantity, SI_UNITS)
    )


def _calibration_faults(
    channel: ChannelOutline, calibration: Values, gain_unit: str
) -> Iterator[Fault]:
    """Find a gain or an offset in the wrong unit, or a gain that loses the signal."""
    path = (*channel.path, "calibration")
    unit_text = gain_unit.replace("(", "").replace(")", "")
    for key, unit, such in (
        ("gain", gain_unit, unit_text),
        ("offset", channel.unit or "", channel.unit),
    ):
        text = calibration.get(key)
        if not isinstance(text, str):
            continue
        try:
            value = parse_quantity(text, unit)
        except ValueError:
            remedy = quantity_remedy(text, unit, f"0.5 {such}")
            yield Fault((*path, key), f"a quantity with a unit such as {such}", repr(text), remedy)
            continue
        if key == "gain" and value == 0.0:
            yield Fault((*path, key), "a gain other than zero", repr(text), "Correct it.")
