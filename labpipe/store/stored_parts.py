"""Parts of a result file that are more than one record: specimen with bundle, recording."""

from __future__ import annotations

import json
from collections.abc import Mapping
from math import isnan, nan
from typing import Any, Final

import numpy as np

from labpipe.records.harness_bundle import ARRANGEMENTS, TAPINGS, Bundle, BundleWire
from labpipe.records.quality import QualityNote
from labpipe.records.recording import Channel, Clock, MarkerTracks, Recording, RigidBody
from labpipe.records.result import Specimen
from labpipe.store import layout
from labpipe.store.datasets import Target, read_array, read_text, read_texts
from labpipe.store.hdf5_objects import set_text
from labpipe.store.layout import DatasetSpec, list_datasets, make_link_name
from labpipe.store.stored_records import (
    read_attributes,
    read_record,
    read_table,
    write_attributes,
    write_record,
    write_table,
)

_SPECIMEN_TEXTS: Final = {"type": "specimen_type", "spool": "spool", "sample": "sample"}
"""Attributes of the root."""
_WIRE_TYPE: Final = DatasetSpec(("type",), layout.TEXT, layout.TEXT)
_WIRE_NUMBER: Final = DatasetSpec(("type",), "1", "int64")
_WIRE_DIAMETER: Final = DatasetSpec(("type",), "m")
_WIRE_POSITION: Final = DatasetSpec(("wire", "xy"), "m")
_CHANNEL: Final = DatasetSpec(("sample",), None)
_CHANNEL_TEXTS: Final = {
    "name": "name",
    "path": "name_in_file",
    "clock": "clock",
    "unit_in_file": "unit_in_file",
    "calibration": "calibration",
}
_SPECIMEN_WORDS = {"labels": ("labels", "label_words"), "observed": ("observed", "observed_words")}
"""Attributes of the names and words of each mapping of a specimen."""
_MARKERS, _BODIES, _NOTES = "markers", "rigid_bodies", "notes"


def write_specimen(target: Target, specimen: Specimen) -> None:
    """Write dimensions, labels, observations and bundle.

    Parameters
    ----------
    target : the root
    specimen : the specimen
    """
    for name, attribute in _SPECIMEN_TEXTS.items():
        set_text(target.group, attribute, getattr(specimen, name))
    target = target.open_group(layout.SPECIMEN)
    target.write_texts("dimensions", tuple(specimen.dimensions))
    target.group.attrs["values"] = np.array(list(specimen.dimensions.values()), dtype=float)
    target.group.attrs["unit"] = "m"
    for name, (keys, words) in _SPECIMEN_WORDS.items():
        if named := getattr(specimen, name):
            target.write_texts(keys, tuple(named))
            target.write_texts(words, tuple(named.values()))
    if specimen.bundle is not None:
        _write_bundle(target.open_group("bundle"), specimen.bundle)


def _write_bundle(target: Target, bundle: Bundle) -> None:
    write_attributes(target, bundle, skip=("conduit_bore",))
    target.group.attrs["conduit_bore"] = _number(bundle.conduit_bore)
    target.group.attrs["conduit_bore_unit"] = "m"
    numbers = np.array([wire.number for wire in bundle.wires], dtype=np.int64)
    diameters = np.array([_number(wire.diameter) for wire in bundle.wires])
    target.write_array("wire_types", tuple(wire.type for wire in bundle.wires), _WIRE_TYPE)
    target.write_array("wire_numbers", numbers, _WIRE_NUMBER)
    target.write_array("wire_diameters", diameters, _WIRE_DIAMETER)
    if bundle.positions:
        target.write_array("positions", np.array(bundle.positions), _WIRE_POSITION)
    target.attach_scales()


def read_specimen(root: Any) -> Specimen:
    """Read the specimen.

    Parameters
    ----------
    root : open result file
    """
    named: dict[str, Any] = {
        name: read_text(root, where) for name, where in _SPECIMEN_TEXTS.items()
    }
    group = root[layout.SPECIMEN]
    values = (float(value) for value in group.attrs["values"])
    dimensions = dict(zip(read_texts(group, "dimensions"), values, strict=True))
    bundle = _bundle(group["bundle"]) if "bundle" in group else None
    words: dict[str, Any] = {
        name: dict(zip(read_texts(group, keys), read_texts(group, texts), strict=True))
        for name, (keys, texts) in _SPECIMEN_WORDS.items()
        if keys in group.attrs
    }
    return Specimen(**named, **words, dimensions=dimensions, bundle=bundle)


def _bundle(group: Any) -> Bundle:
    wires = zip(
        read_array(group, "wire_types", _WIRE_TYPE),
        read_array(group, "wire_numbers", _WIRE_NUMBER),
        read_array(group, "wire_diameters", _WIRE_DIAMETER),
        strict=True,
    )
    positions = read_array(group, "positions", _WIRE_POSITION) if "positions" in group else ()
    bundle = Bundle(
        wires=tuple(
            BundleWire(wire_type, int(number), _optional(wide)) for wire_type, number, wide in wires
        ),
        positions=tuple((float(x), float(y)) for x, y in positions),
        conduit_bore=_optional(group.attrs["conduit_bore"]),
        **read_attributes(group, Bundle, skip=("conduit_bore",)),
    )
    if bundle.arrangement not in ARRANGEMENTS or bundle.taping not in TAPINGS:
        message = f"{bundle.arrangement!r} or {bundle.taping!r} is unknown"
        raise ValueError(message)
    return bundle


def _number(value: float | None) -> float:
    return nan if value is None else value


def _optional(value: float) -> float | None:
    return None if isnan(value) else float(value)


def write_recording(target: Target, recording: Recording) -> None:
    """Write a recording.

    Parameters
    ----------
    target : its group, with the fingerprints of the exports only
    recording : markers, clocks, channels, notes and metadata
    """
    write_attributes(target, recording)
    set_text(target.group, "metadata", json.dumps(dict(recording.metadata), ensure_ascii=False))
    write_table(target, _NOTES, QualityNote, recording.notes)
    if recording.markers is not None:
        _write_markers(target, recording.markers)
    scales = _write_clocks(target, recording.clocks)
    if recording.markers is not None and layout.TIME not in target.group:
        target.group[layout.TIME] = target.group[_MARKERS][layout.TIME]
    _write_channels(target, recording.channels, scales)


def _write_clocks(target: Target, clocks: tuple[Clock, ...]) -> dict[str, Any]:
    """Write one clock as ``time``, several as ``time_<clock>``; return their datasets by clock."""
    names: list[str] = []
    scales: dict[str, Any] = {}
    for clock in clocks:
        link_name = layout.TIME if len(clocks) == 1 else f"{layout.TIME}_{clock.name}"
        names.append(make_link_name(link_name, target.group))
        dataset = target.write_array(
            names[-1], clock.time, list_datasets(Clock)["time"], clock.unit
        )
        set_text(dataset, "clock", clock.name)
        scales[clock.name] = dataset
    target.write_texts("clocks", tuple(names))
    return scales


def _write_channels(
    target: Target, channels: tuple[Channel, ...], scales: Mapping[str, Any]
) -> None:
    reserved = (layout.TIME, _MARKERS, _BODIES, _NOTES)
    names: list[str] = []
    for channel in channels:
        names.append(make_link_name(channel.name, [*target.group, *reserved]))
        unit = layout.UNSTATED_UNIT if channel.unit is None else channel.unit
        dataset = target.write_array(names[-1], channel.values, _CHANNEL, unit)
        for field_name, attribute in _CHANNEL_TEXTS.items():
            set_text(dataset, attribute, getattr(channel, field_name))
        target.attach_scale(dataset, 0, scales[channel.clock])
    target.write_texts("channels", tuple(names))


def _write_markers(target: Target, tracks: MarkerTracks) -> None:
    markers, bodies = target.open_group(_MARKERS), target.open_group(_BODIES)
    write_record(markers, tracks)
    names: list[str] = []
    for body in tracks.bodies:
        names.append(make_link_name(body.name, names))
        inside = bodies.open_group(names[-1])
        inside.link_dataset(
            layout.TIME, markers.group[layout.TIME], list_datasets(MarkerTracks)["time"]
        )
        write_record(inside, body)
    bodies.write_texts("bodies", tuple(names))


def read_recording(group: Any) -> Recording:
    """Read a recording that `write_recording` wrote.

    Parameters
    ----------
    group : of the recording

    Raises
    ------
    StoreError
        If a dataset has another unit, axis or number type than in the layout.
    KeyError, ValueError
        If a channel has no clock, or the length of a channel or body differs from its times.
    """
    recording = read_record(
        group,
        Recording,
        clocks=tuple(_clock(group, name) for name in read_texts(group, "clocks")),
        channels=tuple(_channel(group, name) for name in read_texts(group, "channels")),
        markers=_markers(group) if _MARKERS in group else None,
        metadata=dict(json.loads(read_text(group, "metadata")).items()),
        notes=read_table(group, _NOTES, QualityNote),
    )
    _require_equal_lengths(recording)
    return recording


def _require_equal_lengths(recording: Recording) -> None:
    """Raise a ValueError if a length differs from that of the times."""
    pairs = [
        (channel.name, channel.values, recording.clock(channel.clock).time)
        for channel in recording.channels
    ]
    if recording.markers is not None:
        time = recording.markers.time
        pairs += [(body.name, body.position, time) for body in recording.markers.bodies]
    for name, values, time in pairs:
        if len(values) != len(time):
            message = f"{name} has {len(values)} values at {len(time)} times"
            raise ValueError(message)


def _clock(group: Any, name: str) -> Clock:
    time = read_array(group, name, list_datasets(Clock)["time"])
    return Clock(read_text(group[name], "clock"), time, read_text(group[name], "unit"))


def _channel(group: Any, name: str) -> Channel:
    fields = {key: read_text(group[name], where) for key, where in _CHANNEL_TEXTS.items()}
    unit = read_text(group[name], "unit")
    values = read_array(group, name, _CHANNEL)
    return Channel(**fields, values=values, unit=None if unit == layout.UNSTATED_UNIT else unit)


def _markers(group: Any) -> MarkerTracks:
    bodies = group[_BODIES]
    all_bodies = tuple(
        read_record(bodies[name], RigidBody) for name in read_texts(bodies, "bodies")
    )
    return read_record(group[_MARKERS], MarkerTracks, bodies=all_bodies)
