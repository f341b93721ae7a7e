"""Checks of the sources of a protocol: readers against channels, units against quantities."""

from __future__ import annotations

from collections.abc import Iterator

from labpipe.errors import Fault, KeyPath
from labpipe.protocol.faults import did_you_mean, one_of
from labpipe.protocol.outline import CHANNEL_KEYS, ChannelOutline, Outline, Values
from labpipe.protocol.quantities import SI_UNITS
from labpipe.protocol.source import MARKER_READERS, READERS, ROLES, si_unit_like
from labpipe.units import parse_quantity, si_factor


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


def _content_faults(outline: Outline, role: str) -> Iterator[Fault]:
    """Find a source that gives neither channels nor marker tracks, or both."""
    source, path = outline.sources[role], ("sources", role)
    readers = set(outline.readers(role))
    has_markers, has_channels = bool(readers & MARKER_READERS), bool(readers - MARKER_READERS)
    if (role == "markers" and has_channels) or (role != "markers" and has_markers):
        valid = MARKER_READERS if role == "markers" else set(READERS) - MARKER_READERS
        expected = f"a reader of {'marker tracks' if role == 'markers' else 'channels'}"
        found = ", ".join(repr(word) for word in outline.readers(role))
        remedy = f"Use one of {one_of('', valid)}."
        yield Fault((*path, "reader"), expected, found, remedy)
        return
    short = [key for key in CHANNEL_KEYS if key in source]
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
    yield from _peak_faults(channel, target)
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
        yield Fault(path, expected, repr(unit), "Correct it, or add a 'calibration'.")
        return
    if isinstance(calibration, dict):
        yield from _calibration_faults(channel, calibration, f"{target}/({before})")


def _peak_faults(channel: ChannelOutline, target: str) -> Iterator[Fault]:
    """Find a plausible peak without unit, or with its ends the wrong way round."""
    said = channel.values.get("plausible_peak")
    path = (*channel.path, "plausible_peak")
    ends: list[float] = []
    for key in ("from", "to"):
        text = said.get(key) if isinstance(said, dict) else None
        if not isinstance(text, str):
            continue
        try:
            ends.append(parse_quantity(text, target))
        except ValueError:
            remedy = f"Write it with its unit, such as '20 {target}'."
            yield Fault(
                (*path, key), f"a quantity with a unit such as {target}", repr(text), remedy
            )
    if len(ends) == 2 and not 0.0 <= ends[0] < ends[1]:
        expected = "'from' of at least zero, and 'to' above it"
        yield Fault(path, expected, f"{ends[0]:g} to {ends[1]:g} {target}", "Correct them.")


def _unknown_quantity(channel: ChannelOutline) -> Fault:
    said = channel.quantity
    if said is None:
        remedy = f"Add 'quantity', one of {one_of(channel.name, SI_UNITS)}."
        return Fault(channel.path, "to know what the channel measures", "no 'quantity'", remedy)
    expected = f"one of the quantities {one_of(said, SI_UNITS)}"
    return Fault((*channel.path, "quantity"), expected, repr(said), did_you_mean(said, SI_UNITS))


def _calibration_faults(
    channel: ChannelOutline, calibration: Values, gain_unit: str
) -> Iterator[Fault]:
    """Find a gain or an offset in the wrong unit, or a gain that loses the signal."""
    path = (*channel.path, "calibration")
    shown = gain_unit.replace("(", "").replace(")", "")
    for key, unit, such in (
        ("gain", gain_unit, shown),
        ("offset", channel.unit or "", channel.unit),
    ):
        text = calibration.get(key)
        if not isinstance(text, str):
            continue
        try:
            value = parse_quantity(text, unit)
        except ValueError:
            remedy = f"Write it with its unit, such as '0.5 {such}'."
            yield Fault((*path, key), f"a quantity with a unit such as {such}", repr(text), remedy)
            continue
        if key == "gain" and value == 0.0:
            yield Fault((*path, key), "a gain other than zero", repr(text), "Correct it.")
