"""A recording as a group of the file, channels and markers and the notes on them: both ways."""

from __future__ import annotations

import json
from typing import Any

from labpipe.records.quality import QualityNote, Severity
from labpipe.records.recording import Channel, Clock, MarkerTracks, Recording, RigidBody
from labpipe.store import layout
from labpipe.store.checked import array, arrays, strings, text, texts
from labpipe.store.chunks import Target
from labpipe.store.layout import link_name

_RESERVED = (layout.TIME, layout.MARKERS, layout.BODIES, layout.NOTES)


def write_recording(target: Target, recording: Recording) -> None:
    """Write a recording.

    Parameters
    ----------
    target : its group, empty but for the fingerprints of the exports
    recording : markers, clocks, channels, notes and all that the export said
    """
    attributes = target.group.attrs
    for name in layout.RECORDING_TEXTS:
        attributes[name] = getattr(recording, name)
    attributes[layout.METADATA] = json.dumps(dict(recording.metadata), ensure_ascii=False)
    write_notes(target.inside(layout.NOTES), recording.notes)
    if recording.markers is not None:
        _write_markers(target, recording.markers)
    _write_clocks(target, recording.clocks)
    if recording.markers is not None and layout.TIME not in target.group:
        target.group[layout.TIME] = target.group[layout.MARKERS][layout.TIME]
    _write_channels(target, recording.channels)


def _write_clocks(target: Target, clocks: tuple[Clock, ...]) -> None:
    """One clock is ``time``, several are ``time_<clock>``."""
    names: list[str] = []
    for clock in clocks:
        wanted = layout.TIME if len(clocks) == 1 else f"{layout.TIME}_{clock.name}"
        names.append(link_name(wanted, target.group))
        dataset = target.array(names[-1], clock.time, layout.CLOCK_TIME, clock.unit)
        dataset.attrs["clock"] = clock.name
    target.texts("clocks", tuple(names))


def _write_channels(target: Target, channels: tuple[Channel, ...]) -> None:
    names: list[str] = []
    for channel in channels:
        names.append(link_name(channel.name, [*target.group, *_RESERVED]))
        unit = layout.NO_UNIT if channel.unit is None else channel.unit
        dataset = target.array(names[-1], channel.values, layout.CHANNEL, unit)
        for field_name, attribute in layout.CHANNEL_TEXTS.items():
            dataset.attrs[attribute] = getattr(channel, field_name)
    target.texts("channels", tuple(names))


def _write_markers(target: Target, tracks: MarkerTracks) -> None:
    markers = target.inside(layout.MARKERS)
    markers.fields(tracks, layout.MARKER_FIELDS)
    markers.strings(layout.NAMES, tracks.names, "marker")
    markers.group.attrs["rate"] = float(tracks.rate)
    markers.group.attrs["unit_in_file"] = tracks.unit_in_file
    bodies = target.inside(layout.BODIES)
    names: list[str] = []
    for body in tracks.bodies:
        names.append(link_name(body.name, names))
        inside = bodies.inside(names[-1])
        inside.group.attrs["name"] = body.name
        inside.fields(body, layout.BODY_FIELDS)
    bodies.texts("bodies", tuple(names))


def write_notes(target: Target, notes: tuple[QualityNote, ...]) -> None:
    """Write notes as columns of text.

    Parameters
    ----------
    target : an empty group
    notes : in this order
    """
    for name in layout.NOTE_COLUMNS:
        target.strings(name, tuple(str(getattr(note, name)) for note in notes), "note")


def read_recording(group: Any) -> Recording:
    """Read a recording that `write_recording` wrote.

    Parameters
    ----------
    group : of the recording

    Raises
    ------
    StoreError
        If a dataset has another unit, axis or number type than the layout says.
    KeyError, ValueError
        If a channel has no clock, or it or a body is not as long as its times.
    """
    has_markers = layout.MARKERS in group
    recording = Recording(
        **{name: text(group, name) for name in layout.RECORDING_TEXTS},
        clocks=tuple(_clock(group, name) for name in texts(group, "clocks")),
        channels=tuple(_channel(group, name) for name in texts(group, "channels")),
        markers=_markers(group) if has_markers else None,
        metadata=dict(json.loads(text(group, layout.METADATA)).items()),
        notes=read_notes(group[layout.NOTES]),
    )
    _require_alike(recording)
    return recording


def _require_alike(recording: Recording) -> None:
    """Refuse, with a ValueError, what is not as long as its times."""
    pairs = [
        (each.name, each.values, recording.clock(each.clock).time) for each in recording.channels
    ]
    if recording.markers is not None:
        time = recording.markers.time
        pairs += [(body.name, body.position, time) for body in recording.markers.bodies]
    for name, values, time in pairs:
        if len(values) != len(time):
            message = f"{name} has {len(values)} values at {len(time)} times"
            raise ValueError(message)


def _clock(group: Any, name: str) -> Clock:
    time = array(group, name, layout.CLOCK_TIME)
    return Clock(text(group[name], "clock"), time, text(group[name], "unit"))


def _channel(group: Any, name: str) -> Channel:
    said = {key: text(group[name], where) for key, where in layout.CHANNEL_TEXTS.items()}
    unit = text(group[name], "unit")
    values = array(group, name, layout.CHANNEL)
    return Channel(**said, values=values, unit=None if unit == layout.NO_UNIT else unit)


def _markers(group: Any) -> MarkerTracks:
    markers, bodies = group[layout.MARKERS], group[layout.BODIES]
    return MarkerTracks(
        **arrays(markers, layout.MARKER_FIELDS),
        names=strings(markers, layout.NAMES, "marker"),
        rate=float(markers.attrs["rate"]),
        unit_in_file=text(markers, "unit_in_file"),
        bodies=tuple(
            RigidBody(name=text(bodies[name], "name"), **arrays(bodies[name], layout.BODY_FIELDS))
            for name in texts(bodies, "bodies")
        ),
    )


def read_notes(group: Any) -> tuple[QualityNote, ...]:
    """Read notes that `write_notes` wrote.

    Parameters
    ----------
    group : of the notes

    Raises
    ------
    StoreError
        If a column is not the layout's.
    """
    columns = [strings(group, name, "note") for name in layout.NOTE_COLUMNS]
    return tuple(
        QualityNote(code, Severity(severity), where, message)
        for code, severity, where, message in zip(*columns, strict=True)
    )
