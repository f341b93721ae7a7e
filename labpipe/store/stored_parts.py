"""Parts of a result file: reasons, specimen, recordings with notes, measured bending."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from math import isnan, nan
from typing import Any

import numpy as np

from labpipe.records.curve import Bending, BendingCloud, MeasuredLaw
from labpipe.records.harness_bundle import ARRANGEMENTS, TAPINGS, Bundle, BundleWire
from labpipe.records.quality import QualityNote, Reason, Severity
from labpipe.records.recording import Channel, Clock, MarkerTracks, Recording, RigidBody
from labpipe.records.result import Specimen
from labpipe.store import layout
from labpipe.store.datasets import Target, array, arrays, strings, text, texts
from labpipe.store.hdf5_objects import set_text
from labpipe.store.layout import link_name


def write_reasons(target: Target, reasons: Iterable[Reason]) -> None:
    """Write reasons.

    Parameters
    ----------
    target : group of the result
    reasons : any number
    """
    reasons = tuple(reasons)
    target.texts(layout.REASON_CODES, tuple(reason.code for reason in reasons))
    target.texts(layout.REASON_MESSAGES, tuple(reason.message for reason in reasons))


def read_reasons(group: Any) -> tuple[Reason, ...]:
    """Read reasons.

    Parameters
    ----------
    group : open HDF5 group that `write_reasons` wrote to
    """
    codes, messages = (texts(group, name) for name in (layout.REASON_CODES, layout.REASON_MESSAGES))
    return tuple(Reason(*code) for code in zip(codes, messages, strict=True))


def write_specimen(target: Target, specimen: Specimen) -> None:
    """Write dimensions, labels and bundle.

    Parameters
    ----------
    target : their group, empty
    specimen : the specimen; type, spool and sample are attributes of the root
    """
    target.texts("dimensions", tuple(specimen.dimensions))
    target.group.attrs["values"] = np.array(list(specimen.dimensions.values()), dtype=float)
    target.group.attrs["unit"] = "m"
    if specimen.labels:
        target.texts(layout.LABELS, tuple(specimen.labels))
        target.texts(layout.LABEL_WORDS, tuple(specimen.labels.values()))
    if specimen.bundle is not None:
        _write_bundle(target.inside(layout.BUNDLE), specimen.bundle)


def _write_bundle(target: Target, bundle: Bundle) -> None:
    for name in layout.BUNDLE_TEXTS:
        target.group.attrs[name] = getattr(bundle, name)
    target.group.attrs[layout.BORE] = _number(bundle.conduit_bore)
    target.group.attrs[f"{layout.BORE}_unit"] = "m"
    numbers = np.array([wire.number for wire in bundle.wires], dtype=np.int64)
    diameters = np.array([_number(wire.diameter) for wire in bundle.wires])
    target.strings(layout.WIRE_TYPES, tuple(wire.type for wire in bundle.wires), "type")
    target.array(layout.WIRE_NUMBERS, numbers, layout.WIRE_NUMBER)
    target.array(layout.WIRE_DIAMETERS, diameters, layout.WIRE_DIAMETER)
    if bundle.positions:
        target.array(layout.POSITIONS, np.array(bundle.positions), layout.WIRE_POSITION)
    target.scaled(layout.BUNDLE_SCALES)


def read_specimen(root: Any) -> Specimen:
    """Read the specimen.

    Parameters
    ----------
    root : open result file

    Returns
    -------
    The specimen.
    """
    named = {name: text(root, where) for name, where in layout.SPECIMEN_TEXTS.items()}
    group = root[layout.SPECIMEN]
    values = (float(value) for value in group.attrs["values"])
    dimensions = dict(zip(texts(group, "dimensions"), values, strict=True))
    bundle = _bundle(group[layout.BUNDLE]) if layout.BUNDLE in group else None
    kinds, values_of_labels = (
        texts(group, name) if layout.LABELS in group.attrs else ()
        for name in (layout.LABELS, layout.LABEL_WORDS)
    )
    labels = dict(zip(kinds, values_of_labels, strict=True))
    return Specimen(**named, dimensions=dimensions, bundle=bundle, labels=labels)


def _bundle(group: Any) -> Bundle:
    wires = zip(
        strings(group, layout.WIRE_TYPES, "type"),
        array(group, layout.WIRE_NUMBERS, layout.WIRE_NUMBER),
        array(group, layout.WIRE_DIAMETERS, layout.WIRE_DIAMETER),
        strict=True,
    )
    has_positions = layout.POSITIONS in group
    positions = array(group, layout.POSITIONS, layout.WIRE_POSITION) if has_positions else ()
    return Bundle(
        wires=tuple(
            BundleWire(wire_type, int(number), _optional(wide)) for wire_type, number, wide in wires
        ),
        arrangement=_one_of(ARRANGEMENTS, text(group, "arrangement")),
        positions=tuple((float(x), float(y)) for x, y in positions),
        tape=text(group, "tape"),
        taping=_one_of(TAPINGS, text(group, "taping")),
        conduit=text(group, "conduit"),
        conduit_bore=_optional(group.attrs[layout.BORE]),
    )


def _one_of(choices: tuple[str, ...], choice: str) -> str:
    if choice not in choices:
        message = f"{choice!r} is none of {', '.join(choices)}"
        raise ValueError(message)
    return choice


def _number(value: float | None) -> float:
    return nan if value is None else value


def _optional(value: float) -> float | None:
    return None if isnan(value) else float(value)


_RESERVED = (layout.TIME, layout.MARKERS, layout.BODIES, layout.NOTES)


def write_recording(target: Target, recording: Recording) -> None:
    """Write a recording.

    Parameters
    ----------
    target : its group, with the fingerprints of the exports only
    recording : markers, clocks, channels, notes and metadata
    """
    attributes = target.group.attrs
    for name in layout.RECORDING_TEXTS:
        attributes[name] = getattr(recording, name)
    attributes[layout.METADATA] = json.dumps(dict(recording.metadata), ensure_ascii=False)
    write_notes(target.inside(layout.NOTES), recording.notes)
    if recording.markers is not None:
        _write_markers(target, recording.markers)
    scales = _write_clocks(target, recording.clocks)
    if recording.markers is not None and layout.TIME not in target.group:
        target.group[layout.TIME] = target.group[layout.MARKERS][layout.TIME]
    _write_channels(target, recording.channels, scales)


def _write_clocks(target: Target, clocks: tuple[Clock, ...]) -> dict[str, Any]:
    """Write one clock as ``time``, several as ``time_<clock>``; return their datasets by clock."""
    names: list[str] = []
    scales: dict[str, Any] = {}
    for clock in clocks:
        wanted = layout.TIME if len(clocks) == 1 else f"{layout.TIME}_{clock.name}"
        names.append(link_name(wanted, target.group))
        dataset = target.array(names[-1], clock.time, layout.CLOCK_TIME, clock.unit)
        dataset.attrs["clock"] = clock.name
        scales[clock.name] = dataset
    target.texts("clocks", tuple(names))
    return scales


def _write_channels(
    target: Target, channels: tuple[Channel, ...], scales: Mapping[str, Any]
) -> None:
    names: list[str] = []
    for channel in channels:
        names.append(link_name(channel.name, [*target.group, *_RESERVED]))
        unit = layout.NO_UNIT if channel.unit is None else channel.unit
        dataset = target.array(names[-1], channel.values, layout.CHANNEL, unit)
        for field_name, attribute in layout.CHANNEL_TEXTS.items():
            set_text(dataset, attribute, getattr(channel, field_name))
        target.attach(dataset, 0, scales[channel.clock])
    target.texts("channels", tuple(names))


def _write_markers(target: Target, tracks: MarkerTracks) -> None:
    markers = target.inside(layout.MARKERS)
    markers.fields(tracks, layout.MARKER_FIELDS)
    markers.strings(layout.NAMES, tracks.names, "marker")
    markers.scaled(layout.MARKER_SCALES)
    markers.group.attrs["rate"] = float(tracks.rate)
    markers.group.attrs["unit_in_file"] = tracks.unit_in_file
    bodies = target.inside(layout.BODIES)
    names: list[str] = []
    for body in tracks.bodies:
        names.append(link_name(body.name, names))
        inside = bodies.inside(names[-1])
        inside.group.attrs["name"] = body.name
        inside.fields(body, layout.BODY_FIELDS)
        inside.group[layout.TIME] = markers.group[layout.TIME]
        inside.scaled(layout.BODY_SCALES)
    bodies.texts("bodies", tuple(names))


def write_notes(target: Target, notes: tuple[QualityNote, ...]) -> None:
    """Write notes as columns of text.

    Parameters
    ----------
    target : an empty group
    notes : in this order
    """
    rows = [tuple(str(getattr(note, name)) for name in layout.NOTE_COLUMNS) for note in notes]
    target.columns(layout.NOTE_TABLE, rows)


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
    has_markers = layout.MARKERS in group
    recording = Recording(
        **{name: text(group, name) for name in layout.RECORDING_TEXTS},
        clocks=tuple(_clock(group, name) for name in texts(group, "clocks")),
        channels=tuple(_channel(group, name) for name in texts(group, "channels")),
        markers=_markers(group) if has_markers else None,
        metadata=dict(json.loads(text(group, layout.METADATA)).items()),
        notes=read_notes(group[layout.NOTES]),
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
    time = array(group, name, layout.CLOCK_TIME)
    return Clock(text(group[name], "clock"), time, text(group[name], "unit"))


def _channel(group: Any, name: str) -> Channel:
    fields = {key: text(group[name], where) for key, where in layout.CHANNEL_TEXTS.items()}
    unit = text(group[name], "unit")
    values = array(group, name, layout.CHANNEL)
    return Channel(**fields, values=values, unit=None if unit == layout.NO_UNIT else unit)


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
        If a column differs from the layout.
    """
    columns = [strings(group, name, "note") for name in layout.NOTE_COLUMNS]
    return tuple(
        QualityNote(code, Severity(severity), where, message)
        for code, severity, where, message in zip(*columns, strict=True)
    )


def write_bending(target: Target, bending: Bending) -> None:
    """Write cloud and law.

    Parameters
    ----------
    target : their group, empty
    bending : measured bending
    """
    target.fields(bending.cloud, layout.CLOUD_FIELDS)
    target.scaled(layout.CLOUD_SCALES)
    target.group.attrs["frames_per_mean"] = int(bending.cloud.frames_per_mean)
    write_reasons(target, [bending.reason] if bending.reason else [])
    if bending.law is not None:
        _write_law(target.inside(layout.LAW), bending.law)


def _write_law(target: Target, law: MeasuredLaw) -> None:
    target.fields(law, layout.LAW_FIELDS)
    target.array(layout.IS_KNOWN, law.is_known.astype(np.uint8), layout.KNOWN)
    target.scaled(layout.LAW_SCALES)
    for name, unit in layout.LAW_UNITS.items():
        target.group.attrs[name] = float(getattr(law, name))
        target.group.attrs[f"{name}_unit"] = unit
    target.group.attrs["n_frames"] = int(law.n_frames)
    write_reasons(target, [law.reason] if law.reason else [])


def read_bending(group: Any) -> Bending:
    """Read cloud and law.

    Parameters
    ----------
    group : open HDF5 group that `write_bending` made

    Returns
    -------
    The measured bending.
    """
    return Bending(
        cloud=BendingCloud(
            **arrays(group, layout.CLOUD_FIELDS),
            frames_per_mean=int(group.attrs["frames_per_mean"]),
        ),
        law=_law(group[layout.LAW]) if layout.LAW in group else None,
        reason=next(iter(read_reasons(group)), None),
    )


def _law(group: Any) -> MeasuredLaw:
    fields: dict[str, Any] = {
        **arrays(group, layout.LAW_FIELDS),
        **{name: float(group.attrs[name]) for name in layout.LAW_UNITS},
    }
    return MeasuredLaw(
        **fields,
        is_known=array(group, layout.IS_KNOWN, layout.KNOWN).astype(np.bool_),
        n_frames=int(group.attrs["n_frames"]),
        reason=next(iter(read_reasons(group)), None),
    )
