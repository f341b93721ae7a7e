"""Write and read the parts of a result file.

The annotations of most records define how they are stored, see `layout`.
"""

from __future__ import annotations

import json
from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import replace
from datetime import date
from math import isnan, nan
from typing import Any, Final, TypeVar

import numpy as np

from labpipe.records.curve import (
    Aligned,
    Bending,
    BendingCloud,
    Branch,
    ClockFit,
    Curve,
    FittedLine,
    Interval,
    MeasuredLaw,
    Series,
    Slip,
)
from labpipe.records.harness_bundle import ARRANGEMENTS, TAPINGS, Bundle, BundleWire
from labpipe.records.quality import QualityNote, Reason
from labpipe.records.recording import Channel, Clock, MarkerTracks, Recording, RigidBody
from labpipe.records.result import Contribution, InputFile, Result, Specimen, Status, TestResult
from labpipe.store import layout
from labpipe.store.datasets import (
    Target,
    has_attribute,
    read_array,
    read_number,
    read_text,
    read_texts,
    set_number,
    set_text,
    set_texts,
)
from labpipe.store.layout import (
    TEXT,
    AttributeSpec,
    BudgetRow,
    DatasetSpec,
    ResultRow,
    list_attributes,
    list_columns,
    list_datasets,
    make_bound_prefix,
    make_link_name,
)

_R = TypeVar("_R")
_INTERVAL_FIELDS = ("lower", "upper", "level")
_REASONS = Reason, tuple[Reason, ...]
"""Types of fields that contain reasons."""
_CODES, _MESSAGES = "reason_codes", "reason_messages"
"""Names of the attributes that contain the codes and the messages of reasons."""


def write_record(target: Target, record: object) -> None:
    """Write the arrays and attributes of a record.

    Parameters
    ----------
    target : group of the record
    record : record of a type whose annotations define the layout
    """
    write_arrays(target, record)
    write_attributes(target, record)


def read_record(group: Any, kind: type[_R], **extra: object) -> _R:
    """Read a record that `write_record` wrote.

    Parameters
    ----------
    group : group of the record
    kind : type of the record
    extra : values of fields that are stored elsewhere, keyed by name of the field
    """
    return kind(**read_arrays(group, kind), **read_attributes(group, kind, skip=extra), **extra)


def write_arrays(target: Target, record: Any) -> None:
    """Write the arrays of a record as datasets with dimension scales.

    Parameters
    ----------
    target : group of the record
    record : record of a type whose annotations define the layout
    """
    for name, spec in list_datasets(type(record)).items():
        values = getattr(record, name)
        if spec.dtype == "uint8":
            values = values.astype(np.uint8)
        target.write_array(name, values, spec, getattr(record, spec.stated_in, ""))
    target.attach_scales()


def read_arrays(group: Any, kind: Any, names: Iterable[str] = ()) -> dict[str, Any]:
    """Read the arrays of a record, and the texts that state their units.

    Parameters
    ----------
    group : group of the record
    kind : type of the record
    names : names of the arrays to be read; all if empty

    Returns
    -------
    Arrays and texts, keyed by name of the field.
    """
    arrays: dict[str, Any] = {}
    for name, spec in list_datasets(kind).items():
        if not names or name in names:
            arrays[name] = read_array(group, name, spec)
            if spec.stated_in:
                arrays[spec.stated_in] = read_text(group[name], "unit")
    return arrays


def write_attributes(target: Target, record: Any, *, skip: Container[str] = ()) -> None:
    """Write the numbers, texts, intervals and reasons of a record.

    A number or interval that is None is not written. A text or reason that is None is written
    empty.

    Parameters
    ----------
    target : group of the record
    record : record of a type whose annotations define the layout
    skip : names of fields that are stored elsewhere
    """
    for name, attribute in list_attributes(type(record)).items():
        if name not in skip:
            _write_attribute(target.group, name, attribute, getattr(record, name))


def _write_attribute(group: Any, name: str, attribute: AttributeSpec, value: Any) -> None:
    """Write the value of one field of a record as attributes of a group."""
    kind, unit, _ = attribute
    if kind in _REASONS:
        reasons = value if isinstance(value, tuple) else (value,) if value else ()
        set_texts(group, _CODES, [reason.code for reason in reasons])
        set_texts(group, _MESSAGES, [reason.message for reason in reasons])
    elif isinstance(value, Interval):
        for bound in _INTERVAL_FIELDS:
            set_number(group, make_bound_prefix(name) + bound, float(getattr(value, bound)))
    elif isinstance(value, tuple):
        set_texts(group, name, value)
    elif kind not in (int, float, Interval):
        set_text(group, name, _format_cell(value))
    elif value is not None:
        set_number(group, name, kind(value))
        if unit is not None:
            set_text(group, f"{name}_unit", unit.symbol)


def read_attributes(group: Any, kind: Any, *, skip: Container[str] = ()) -> dict[str, Any]:
    """Read the attributes that `write_attributes` wrote.

    Parameters
    ----------
    group : group of the record
    kind : type of the record
    skip : names of fields that are stored elsewhere

    Returns
    -------
    Values, keyed by name of the field.
    """
    attributes = {name: spec for name, spec in list_attributes(kind).items() if name not in skip}
    return {name: _read_attribute(group, name, spec) for name, spec in attributes.items()}


def _read_attribute(group: Any, name: str, attribute: AttributeSpec) -> Any:
    """Read the value of one field of a record from attributes of a group."""
    kind, _, is_optional = attribute
    if kind in _REASONS:
        pairs = zip(read_texts(group, _CODES), read_texts(group, _MESSAGES), strict=True)
        reasons = tuple(Reason(*pair) for pair in pairs)
        return next(iter(reasons), None) if kind is Reason else reasons
    if kind == tuple[str, ...]:
        return read_texts(group, name)
    if kind not in (int, float, Interval):
        return _parse_cell({name: read_text(group, name)}, name, attribute)
    names = [name]
    if kind is Interval:
        names = [make_bound_prefix(name) + bound for bound in _INTERVAL_FIELDS]
    if is_optional and not has_attribute(group, names[0]):
        return None
    return kind(*(read_number(group, name) for name in names))


def write_table(
    target: Target, name: str, kind: type[_R], rows: Sequence[_R], unit: str = ""
) -> None:
    """Write records as a table, which is a group of columns.

    Parameters
    ----------
    target : group in which the table is created
    name : name of the table
    kind : type of the records, a key of `layout.ROW_AXES`
    rows : records, one for each row
    unit : unit of the columns without a unit in the layout
    """
    table = target.open_group(name)
    for column, (field, bound, spec) in list_columns(kind).items():
        cells = [getattr(row, field) for row in rows]
        if bound:
            cells = [getattr(interval, bound) for interval in cells]
        values: Any = tuple(map(_format_cell, cells))
        if spec.dtype != TEXT:
            values = np.array([nan if cell is None else cell for cell in cells], spec.dtype)
        table.write_array(column, values, spec, unit)
    table.attach_scales()


def _format_cell(value: Any) -> str:
    """Format a value of a record as text; None gives an empty text."""
    return ", ".join(value) if isinstance(value, tuple) else "" if value is None else str(value)


def read_table(parent: Any, name: str, kind: type[_R], unit: str | None = None) -> tuple[_R, ...]:
    """Read a table that `write_table` wrote.

    Parameters
    ----------
    parent : group that contains the table
    name : name of the table
    kind : type of the records
    unit : unit that columns without a unit in the layout must have; None for any unit

    Returns
    -------
    The records. Their intervals have the level 0.95, which is not stored.
    """
    names = list_columns(kind)
    columns = read_columns(parent[name], kind, names, unit)
    rows = (dict(zip(names, row, strict=True)) for row in zip(*columns, strict=True))
    fields = list_attributes(kind).items()
    return tuple(
        kind(**{field: _parse_cell(row, field, attribute) for field, attribute in fields})
        for row in rows
    )


def read_columns(
    table: Any, kind: type, names: Iterable[str], unit: str | None = None
) -> list[Sequence[Any]]:
    """Read columns of a table that `write_table` wrote.

    Parameters
    ----------
    table : group of the columns
    kind : type of the records
    names : names of the columns to be read
    unit : unit that columns without a unit in the layout must have; None for any unit

    Returns
    -------
    The cells of each column, in the order of `names`.
    """
    columns: list[Sequence[Any]] = []
    for name in names:
        spec = list_columns(kind)[name].dataset
        cells = read_array(table, name, spec if spec.unit else replace(spec, unit=unit))
        columns.append(cells if isinstance(cells, tuple) else cells.tolist())
    return columns


def _parse_cell(row: Mapping[str, Any], name: str, attribute: AttributeSpec) -> Any:
    """Parse one field of a record from the cells of a row."""
    if attribute.kind is Interval:
        return Interval(*(row[make_bound_prefix(name) + bound] for bound in ("lower", "upper")))
    cell = row[name]
    if attribute.is_optional and (cell == "" or (attribute.kind is float and isnan(cell))):
        return None
    if attribute.kind is date:
        return date.fromisoformat(cell)
    return tuple(cell.split(", ")) if attribute.kind == tuple[str, ...] else attribute.kind(cell)


_SPECIMEN_TEXTS: Final = {"type": "specimen_type", "spool": "spool", "sample": "sample"}
"""Names of the attributes of the root for fields of the specimen, keyed by field."""
_WIRE_TYPE: Final = DatasetSpec(("type",), layout.TEXT, layout.TEXT)
_WIRE_NUMBER: Final = DatasetSpec(("type",), "1", "int64")
_WIRE_DIAMETER: Final = DatasetSpec(("type",), "m")
_WIRE_POSITION: Final = DatasetSpec(("wire", "xy"), "m")
_SAMPLE_NUMBER: Final = DatasetSpec(("sample",), "1", "int64")
"""Definition of the datasets with the branch and the cycle of each sample.

They are written for other programs; labpipe derives them from the branches.
"""
_CHANNEL: Final = DatasetSpec(("sample",), None)
_CHANNEL_TEXTS: Final = {
    "name": "name",
    "path": "name_in_file",
    "clock": "clock",
    "unit_in_file": "unit_in_file",
    "calibration": "calibration",
}
"""Names of the attributes for texts of a channel, keyed by field."""
_SPECIMEN_MAPS = {"labels": ("labels", "label_words"), "observed": ("observed", "observed_words")}
"""Names of the attributes for the keys and texts of each mapping of a specimen."""
_MARKERS, _BODIES, _NOTES = "markers", "rigid_bodies", "notes"
"""Names of groups of a recording."""


def write_specimen(target: Target, specimen: Specimen) -> None:
    """Write a specimen, with type, spool and sample in the root, and other fields in a group.

    Parameters
    ----------
    target : root of the result file
    specimen : specimen of the test
    """
    for name, attribute in _SPECIMEN_TEXTS.items():
        set_text(target.group, attribute, getattr(specimen, name))
    target = target.open_group(layout.SPECIMEN)
    target.write_texts("dimensions", tuple(specimen.dimensions))
    target.group.attrs["values"] = np.array(list(specimen.dimensions.values()), dtype=float)
    target.group.attrs["unit"] = "m"
    for name, (keys, texts) in _SPECIMEN_MAPS.items():
        if mapping := getattr(specimen, name):
            target.write_texts(keys, tuple(mapping))
            target.write_texts(texts, tuple(mapping.values()))
    if specimen.bundle is not None:
        _write_bundle(target.open_group("bundle"), specimen.bundle)


def _write_bundle(target: Target, bundle: Bundle) -> None:
    """Write a bundle of wires, with NaN for sizes that are not stated."""
    write_attributes(target, bundle, skip=("conduit_bore",))
    target.group.attrs["conduit_bore"] = _none_to_nan(bundle.conduit_bore)
    target.group.attrs["conduit_bore_unit"] = "m"
    numbers = np.array([wire.number for wire in bundle.wires], dtype=np.int64)
    diameters = np.array([_none_to_nan(wire.diameter) for wire in bundle.wires])
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
    root_texts: dict[str, Any] = {
        name: read_text(root, attribute) for name, attribute in _SPECIMEN_TEXTS.items()
    }
    group = root[layout.SPECIMEN]
    values = (float(value) for value in group.attrs["values"])
    dimensions = dict(zip(read_texts(group, "dimensions"), values, strict=True))
    bundle = _read_bundle(group["bundle"]) if "bundle" in group else None
    mappings: dict[str, Any] = {
        name: dict(zip(read_texts(group, keys), read_texts(group, texts), strict=True))
        for name, (keys, texts) in _SPECIMEN_MAPS.items()
        if keys in group.attrs
    }
    return Specimen(**root_texts, **mappings, dimensions=dimensions, bundle=bundle)


def _read_bundle(group: Any) -> Bundle:
    """Read a bundle of wires; raise ValueError if its arrangement or taping is unknown."""
    wires = zip(
        read_array(group, "wire_types", _WIRE_TYPE),
        read_array(group, "wire_numbers", _WIRE_NUMBER),
        read_array(group, "wire_diameters", _WIRE_DIAMETER),
        strict=True,
    )
    positions = read_array(group, "positions", _WIRE_POSITION) if "positions" in group else ()
    bundle = Bundle(
        wires=tuple(
            BundleWire(wire_type, int(number), _nan_to_none(diameter))
            for wire_type, number, diameter in wires
        ),
        positions=tuple((float(x), float(y)) for x, y in positions),
        conduit_bore=_nan_to_none(group.attrs["conduit_bore"]),
        **read_attributes(group, Bundle, skip=("conduit_bore",)),
    )
    if bundle.arrangement not in ARRANGEMENTS or bundle.taping not in TAPINGS:
        message = f"{bundle.arrangement!r} or {bundle.taping!r} is unknown"
        raise ValueError(message)
    return bundle


def _none_to_nan(value: float | None) -> float:
    """Convert None to NaN."""
    return nan if value is None else float(value)


def _nan_to_none(value: float) -> float | None:
    """Convert NaN to None."""
    return None if isnan(value) else float(value)


def write_recording(target: Target, recording: Recording) -> None:
    """Write a recording.

    Parameters
    ----------
    target : group of the recording, which so far contains only the attributes of the exports
    recording : recording with markers, clocks, channels, notes and metadata
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
    """Write one clock as ``time``, or several as ``time_<clock>``; return datasets by clock."""
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
    """Write channels as datasets whose dimension scale is the dataset of their clock."""
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
    """Write marker tracks, and a group for each rigid body with the same times."""
    markers, bodies = target.open_group(_MARKERS), target.open_group(_BODIES)
    write_record(markers, tracks)
    names: list[str] = []
    for body in tracks.bodies:
        names.append(make_link_name(body.name, names))
        body_group = bodies.open_group(names[-1])
        body_group.link_dataset(
            layout.TIME, markers.group[layout.TIME], list_datasets(MarkerTracks)["time"]
        )
        write_record(body_group, body)
    bodies.write_texts("bodies", tuple(names))


def read_recording(group: Any) -> Recording:
    """Read a recording that `write_recording` wrote.

    Parameters
    ----------
    group : group of the recording

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
        clocks=tuple(_read_clock(group, name) for name in read_texts(group, "clocks")),
        channels=tuple(_read_channel(group, name) for name in read_texts(group, "channels")),
        markers=_read_markers(group) if _MARKERS in group else None,
        metadata=dict(json.loads(read_text(group, "metadata")).items()),
        notes=read_table(group, _NOTES, QualityNote),
    )
    _require_equal_lengths(recording)
    return recording


def _require_equal_lengths(recording: Recording) -> None:
    """Raise ValueError if the length of a channel or body differs from that of its times."""
    pairs = [
        (channel.name, channel.values, recording.get_clock(channel.clock).time)
        for channel in recording.channels
    ]
    if recording.markers is not None:
        time = recording.markers.time
        pairs += [(body.name, body.position, time) for body in recording.markers.bodies]
    for name, values, time in pairs:
        if len(values) != len(time):
            message = f"{name} has {len(values)} values at {len(time)} times"
            raise ValueError(message)


def _read_clock(group: Any, name: str) -> Clock:
    """Read the clock in a dataset."""
    time = read_array(group, name, list_datasets(Clock)["time"])
    return Clock(read_text(group[name], "clock"), time, read_text(group[name], "unit"))


def _read_channel(group: Any, name: str) -> Channel:
    """Read the channel in a dataset."""
    fields = {key: read_text(group[name], attribute) for key, attribute in _CHANNEL_TEXTS.items()}
    unit = read_text(group[name], "unit")
    values = read_array(group, name, _CHANNEL)
    return Channel(**fields, values=values, unit=None if unit == layout.UNSTATED_UNIT else unit)


def _read_markers(group: Any) -> MarkerTracks:
    """Read the marker tracks and rigid bodies of a recording."""
    bodies = group[_BODIES]
    all_bodies = tuple(
        read_record(bodies[name], RigidBody) for name in read_texts(bodies, "bodies")
    )
    return read_record(group[_MARKERS], MarkerTracks, bodies=all_bodies)


def write_raw(target: Target, result: TestResult) -> None:
    """Write the recording of each role, with the names, SHA-256 and order of the exports.

    Parameters
    ----------
    target : group of the raw data
    result : processed test
    """
    roles = dict.fromkeys([*result.recordings, *(export.role for export in result.inputs)])
    target.write_texts("roles", tuple(result.recordings))
    for role in roles:
        role_group = target.open_group(role)
        indices = [i for i, export in enumerate(result.inputs) if export.role == role]
        inputs = [result.inputs[i] for i in indices]
        role_group.write_texts("file", tuple(export.file for export in inputs))
        role_group.write_texts("sha256", tuple(export.sha256 for export in inputs))
        sizes = np.array([export.bytes for export in inputs], dtype=np.int64)
        role_group.group.attrs["bytes"] = sizes
        role_group.group.attrs["input_order"] = np.array(indices, dtype=np.int64)
        if role in result.recordings:
            write_recording(role_group, result.recordings[role])


def read_inputs(raw: Any) -> tuple[InputFile, ...]:
    """Read the names and SHA-256 of the exports, in the order of the protocol.

    Parameters
    ----------
    raw : group of the raw data
    """
    inputs: dict[int, InputFile] = {}
    for role, group in raw.items():
        rows = zip(
            group.attrs["input_order"],
            read_texts(group, "file"),
            read_texts(group, "sha256"),
            group.attrs["bytes"],
            strict=True,
        )
        inputs |= {int(i): InputFile(role, file, sha, int(size)) for i, file, sha, size in rows}
    return tuple(inputs[i] for i in sorted(inputs))


def write_aligned(target: Target, aligned: Aligned) -> None:
    """Write aligned signals, with the events of their clocks.

    Parameters
    ----------
    target : group of the record
    aligned : signals of the test on one clock
    """
    write_arrays(target, aligned)
    names: list[str] = []
    for name, series in aligned.series.items():
        names.append(make_link_name(name, [*target.group, layout.EVENTS]))
        dataset = target.write_array(
            names[-1], series.values, list_datasets(Series)["values"], series.unit
        )
        set_text(dataset, "name", name)
    target.write_texts("series", tuple(names))
    target.attach_scales()
    if aligned.clock_fit is not None:
        write_attributes(target, aligned.clock_fit)
        write_arrays(target.open_group(layout.EVENTS), aligned.clock_fit)


def read_aligned(root: Any) -> Aligned | None:
    """Read the aligned signals; None without a group of them.

    Parameters
    ----------
    root : open result file
    """
    if layout.ALIGNED not in root:
        return None
    group, values = root[layout.ALIGNED], list_datasets(Series)["values"]
    series = {
        read_text(group[name], "name"): Series(
            read_array(group, name, values), read_text(group[name], "unit")
        )
        for name in read_texts(group, "series")
    }
    fit = None
    if layout.EVENTS in group:
        events = read_arrays(group[layout.EVENTS], ClockFit)
        fit = ClockFit(**events, **read_attributes(group, ClockFit))
    return read_record(group, Aligned, series=series, clock_fit=fit)


def write_curve(target: Target, result: TestResult, curve: Curve) -> None:
    """Write the curve of a test, with its branches, slips and fitted lines.

    Parameters
    ----------
    target : group of the record
    result : processed test, whose slips and lines are written
    curve : curve of the test
    """
    write_arrays(target, curve)
    for name, numbers in zip(("branch", "cycle"), curve.assign_samples(), strict=True):
        target.write_array(name, numbers, _SAMPLE_NUMBER)
    target.attach_scales()
    write_table(target, layout.BRANCHES, Branch, curve.branches, curve.time_unit)
    write_optional_table(target, layout.SLIPS, Slip, result.slips)
    write_optional_table(target, layout.LINES, FittedLine, result.lines)


def read_curve(root: Any) -> dict[str, Any]:
    """Read the curve, slips and fitted lines of a test.

    Parameters
    ----------
    root : open result file

    Returns
    -------
    Values of the fields `curve`, `slips` and `lines` of `TestResult`; without a curve, only `curve`
    with None.
    """
    if layout.CURVE not in root:
        return {"curve": None}
    group = root[layout.CURVE]
    time_unit = read_text(group[layout.TIME], "unit")
    branches = read_table(group, layout.BRANCHES, Branch, time_unit)
    return {
        "curve": read_record(group, Curve, branches=branches),
        "slips": read_optional_table(group, layout.SLIPS, Slip),
        "lines": read_optional_table(group, layout.LINES, FittedLine),
    }


def write_optional_table(target: Target, name: str, kind: type[_R], rows: Sequence[_R]) -> None:
    """Write a table as `write_table` does, unless it is empty."""
    if rows:
        write_table(target, name, kind, rows)


def read_optional_table(parent: Any, name: str, kind: type[_R]) -> tuple[_R, ...]:
    """Read a table that `write_optional_table` wrote; empty if there is none."""
    return read_table(parent, name, kind) if name in parent else ()


def write_bending(target: Target, bending: Bending) -> None:
    """Write the measured moments and curvatures, with their law.

    Parameters
    ----------
    target : group of the record
    bending : measured moments and curvatures of the test
    """
    write_record(target, bending.cloud)
    write_attributes(target, bending)
    if bending.law is not None:
        write_record(target.open_group(layout.LAW), bending.law)


def read_bending(root: Any) -> Bending | None:
    """Read measured moments and curvatures; None without a group of them.

    Parameters
    ----------
    root : open result file
    """
    if layout.BENDING not in root:
        return None
    group = root[layout.BENDING]
    law = read_record(group[layout.LAW], MeasuredLaw) if layout.LAW in group else None
    return read_record(group, Bending, cloud=read_record(group, BendingCloud), law=law)


def write_results(target: Target, results: Sequence[Result]) -> None:
    """Write the results, a table of them, and a table of their budgets.

    Parameters
    ----------
    target : root of the result file
    results : results of the test
    """
    group = target.open_group(layout.RESULTS)
    group.write_texts("order", tuple(result.name for result in results))
    rows, budget_rows = [], []
    for result in results:
        result_group = group.open_group(result.name)
        set_number(result_group.group, "value", _none_to_nan(result.value))
        set_text(result_group.group, "seal", result.seal)
        write_attributes(result_group, result, skip=("name", "value"))
        interval = result.interval or Interval(nan, nan, nan)
        numbers = result.value, result.best_estimate, interval.lower, interval.upper
        status = result.status, ", ".join(result.codes), result.reason_text
        rows.append(ResultRow(result.name, *numbers, result.unit, interval.level, *status))
        for row, share in zip(result.budget, result.shares, strict=True):
            cells = (result.name, row.cause, row.change, result.unit, share, row.is_common)
            budget_rows.append(BudgetRow(*cells))
    write_table(group, "table", ResultRow, rows)
    write_optional_table(target, layout.BUDGETS, BudgetRow, budget_rows)


def read_results(root: Any) -> tuple[Result, ...]:
    """Read the results of a test, with their budgets.

    Parameters
    ----------
    root : open result file

    Raises
    ------
    ValueError
        If the numbers of a result do not match its seal.
    """
    group, budgets = root[layout.RESULTS], dict[str, list[Contribution]]()
    if layout.BUDGETS in root:
        names = ("result", "cause", "change", "is_common")
        columns = read_columns(root[layout.BUDGETS], BudgetRow, names)
        for result_name, cause, change, is_common in zip(*columns, strict=True):
            contribution = Contribution(cause, change, bool(is_common))
            budgets.setdefault(result_name, []).append(contribution)
    results = []
    for name in read_texts(group, "order"):
        result_group = group[name]
        fields = read_attributes(result_group, Result, skip=("name", "value"))
        value = None if fields["status"] is Status.FAILED else read_number(result_group, "value")
        result = Result(name=name, value=value, budget=tuple(budgets.get(name, ())), **fields)
        if read_text(result_group, "seal") != result.seal:
            message = f"results/{name}: its numbers were changed after they were written"
            raise ValueError(message)
        results.append(result)
    return tuple(results)
