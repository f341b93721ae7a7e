"""Write and read the parts of a result file.

The annotations of most records define how they are stored, see `layout`.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import isnan, nan
from typing import Any, Final, TypeVar

import numpy as np

from labpipe.records.arrays import Floats, Ints
from labpipe.records.curve import (
    Aligned,
    Bending,
    BendingCloud,
    Branch,
    ClockFit,
    Curve,
    FigureLaw,
    FigureShapes,
    FittedLine,
    Interval,
    MeasuredLaw,
    Series,
    Shape,
    Slip,
    SlipDecision,
)
from labpipe.records.harness_bundle import ARRANGEMENTS, TAPINGS, Bundle, BundleWire
from labpipe.records.quality import QualityNote
from labpipe.records.recording import Channel, Clock, MarkerTracks, Recording, RigidBody
from labpipe.records.result import (
    Contribution,
    InputFile,
    Instrument,
    Result,
    Specimen,
    Status,
    TestResult,
)
from labpipe.store.datasets import (
    GroupWriter,
    read_array,
    read_array_rows,
    read_arrays,
    read_attributes,
    read_columns,
    read_number,
    read_record,
    read_table,
    read_text,
    read_texts,
    write_arrays,
    write_attributes,
    write_record,
    write_table,
)
from labpipe.store.layout import (
    SCHEMA_ATTRIBUTE,
    SCHEMA_VERSION,
    TEXT,
    UNSTATED_UNIT,
    BudgetRow,
    DatasetSpec,
    ResultRow,
    list_attributes,
    list_datasets,
    make_link_name,
)

_R = TypeVar("_R")
_SPECIMEN_TEXTS: Final = {"type": "specimen_type", "spool": "spool", "sample": "sample"}
"""Names of the attributes of the root that contain fields of the specimen, keyed by field."""
_WIRE_COLUMNS: Final = {
    "wire_types": DatasetSpec(("type",), TEXT, TEXT),
    "wire_numbers": DatasetSpec(("type",), "1", "int64"),
    "wire_diameters": DatasetSpec(("type",), "m"),
}
"""Definitions of the datasets with the type, number and diameter of the wires of each type."""
_WIRE_POSITION: Final = DatasetSpec(("wire", "xy"), "m")
_SAMPLE_NUMBER: Final = DatasetSpec(("sample",), "1", "int64")
"""Definition of the datasets with the branch and the cycle of each sample.

They are written for other programs; labpipe derives them from the branches.
"""
_SERIES_TEXTS: Final[Mapping[type, Mapping[str, str]]] = {
    Clock: {"clock": "name"},
    Series: {},
    Channel: {
        "name": "name",
        "name_in_file": "path",
        "clock": "clock",
        "unit_in_file": "unit_in_file",
        "calibration": "calibration",
    },
}
"""Names of the text fields of a record, keyed by type of record and by name of the attribute."""
_SPECIMEN_MAPS = {"labels": ("labels", "label_words"), "observed": ("observed", "observed_words")}
"""Names of the attributes for the keys and texts of each mapping of a specimen."""


def _write_specimen(target: GroupWriter, specimen: Specimen) -> None:
    """Write a specimen, with type, spool and sample in the root, and other fields in a group."""
    for name, attribute in _SPECIMEN_TEXTS.items():
        target.group.attrs[attribute] = getattr(specimen, name)
    target = target.open_group("specimen")
    target.write_texts("dimensions", tuple(specimen.dimensions))
    target.group.attrs["values"] = np.array(list(specimen.dimensions.values()), dtype=float)
    target.group.attrs["unit"] = "m"
    for name, (keys, texts) in _SPECIMEN_MAPS.items():
        if mapping := getattr(specimen, name):
            target.write_texts(keys, tuple(mapping))
            target.write_texts(texts, tuple(mapping.values()))
    if specimen.bundle is not None:
        _write_bundle(target.open_group("bundle"), specimen.bundle)


def _write_bundle(target: GroupWriter, bundle: Bundle) -> None:
    """Write a bundle of wires, with NaN for a diameter or bore that is not stated."""
    write_attributes(target, bundle, skip=("conduit_bore",))
    target.group.attrs["conduit_bore"] = _none_to_nan(bundle.conduit_bore)
    target.group.attrs["conduit_bore_unit"] = "m"
    columns: Sequence[Any] = (
        tuple(wire.type for wire in bundle.wires),
        np.array([wire.number for wire in bundle.wires], dtype=np.int64),
        np.array([_none_to_nan(wire.diameter) for wire in bundle.wires]),
    )
    for values, (name, spec) in zip(columns, _WIRE_COLUMNS.items(), strict=True):
        target.write_array(name, values, spec)
    if bundle.positions:
        target.write_array("positions", np.array(bundle.positions), _WIRE_POSITION)
    target.attach_scales()


def _read_specimen(root: Any) -> Specimen:
    """Read the specimen."""
    root_texts: dict[str, Any] = {
        name: read_text(root, attribute) for name, attribute in _SPECIMEN_TEXTS.items()
    }
    group = root["specimen"]
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
    columns = (read_array(group, *column) for column in _WIRE_COLUMNS.items())
    positions = read_array(group, "positions", _WIRE_POSITION) if "positions" in group else ()
    bundle = Bundle(
        wires=tuple(
            BundleWire(wire_type, int(number), _nan_to_none(diameter))
            for wire_type, number, diameter in zip(*columns, strict=True)
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


def _write_recording(target: GroupWriter, recording: Recording) -> None:
    """Write a recording.

    Parameters
    ----------
    target : group of the recording, in which no dataset exists yet
    recording : recording with markers, clocks, channels, notes and metadata
    """
    write_attributes(target, recording)
    target.group.attrs["metadata"] = json.dumps(dict(recording.metadata), ensure_ascii=False)
    write_table(target, "notes", QualityNote, recording.notes)
    if recording.markers is not None:
        _write_markers(target, recording.markers)
    has_one_clock = len(recording.clocks) == 1
    clocks = [("time" if has_one_clock else f"time_{c.name}", c) for c in recording.clocks]
    time_scales = _write_series(target, "clocks", clocks)
    if recording.markers is not None and "time" not in target.group:
        target.group["time"] = target.group["markers"]["time"]
    reserved_names = ("time", "markers", "rigid_bodies", "notes")
    channels = [(channel.name, channel) for channel in recording.channels]
    datasets = _write_series(target, "channels", channels, reserved_names)
    scales = {clock.name: scale for (_, clock), scale in zip(clocks, time_scales, strict=True)}
    for channel, dataset in zip(recording.channels, datasets, strict=True):
        target.attach_scale(dataset, 0, scales[channel.clock])


def _write_series(
    target: GroupWriter,
    list_name: str,
    series: Iterable[tuple[str, Clock | Channel | Series]],
    reserved_names: Sequence[str] = (),
) -> list[Any]:
    """Write records with one array and texts as datasets, and return the datasets.

    Parameters
    ----------
    target : group of the datasets
    list_name : name of the attribute that lists the names of the datasets
    series : name and record of each dataset; the name is changed if it is not valid or in use
    reserved_names : names that no dataset may have
    """
    datasets = []
    for name, record in series:
        ((field, spec),) = list_datasets(type(record)).items()
        link_name = make_link_name(name, [*target.group, *reserved_names])
        unit = UNSTATED_UNIT if record.unit is None else record.unit
        dataset = target.write_array(link_name, getattr(record, field), spec, unit)
        for attribute, text_field in _SERIES_TEXTS[type(record)].items():
            dataset.attrs[attribute] = getattr(record, text_field)
        datasets.append(dataset)
    target.write_texts(list_name, [dataset.name.rpartition("/")[2] for dataset in datasets])
    return datasets


def _read_series(group: Any, name: str, kind: Any) -> Any:
    """Read a record that `_write_series` wrote as the dataset `name`."""
    ((field, spec),) = list_datasets(kind).items()
    texts = {key: read_text(group[name], label) for label, key in _SERIES_TEXTS[kind].items()}
    unit: str | None = read_text(group[name], "unit")
    if kind is Channel and unit == UNSTATED_UNIT:
        unit = None
    return kind(**{field: read_array(group, name, spec)}, **texts, unit=unit)


def _write_markers(target: GroupWriter, tracks: MarkerTracks) -> None:
    """Write marker tracks, and a group for each rigid body with the same times."""
    markers, bodies = target.open_group("markers"), target.open_group("rigid_bodies")
    write_record(markers, tracks)
    names: list[str] = []
    for body in tracks.bodies:
        names.append(make_link_name(body.name, names))
        body_group = bodies.open_group(names[-1])
        body_group.link_dataset("time", markers.group["time"], list_datasets(MarkerTracks)["time"])
        write_record(body_group, body)
    bodies.write_texts("bodies", tuple(names))


def _read_recording(group: Any) -> Recording:
    """Read a recording that `_write_recording` wrote.

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
        clocks=tuple(_read_series(group, name, Clock) for name in read_texts(group, "clocks")),
        channels=tuple(
            _read_series(group, name, Channel) for name in read_texts(group, "channels")
        ),
        markers=_read_markers(group) if "markers" in group else None,
        metadata=dict(json.loads(read_text(group, "metadata")).items()),
        notes=read_table(group, "notes", QualityNote),
    )
    for channel in recording.channels:
        time = recording.get_clock(channel.clock).time
        _require_equal_lengths(time, {channel.name: channel.values})
    if recording.markers is not None:
        positions = {body.name: body.position for body in recording.markers.bodies}
        _require_equal_lengths(recording.markers.time, positions)
    return recording


def _require_equal_lengths(time: Floats, arrays: Mapping[str, Floats]) -> None:
    """Raise ValueError if one of the arrays, keyed by name, has another length than its times."""
    for name, values in arrays.items():
        if len(values) != len(time):
            message = f"{name} has {len(values)} values at {len(time)} times"
            raise ValueError(message)


def _read_markers(group: Any) -> MarkerTracks:
    """Read the marker tracks and rigid bodies of a recording."""
    body_groups = group["rigid_bodies"]
    names = read_texts(body_groups, "bodies")
    bodies = tuple(read_record(body_groups[name], RigidBody) for name in names)
    return read_record(group["markers"], MarkerTracks, bodies=bodies)


def _write_raw(target: GroupWriter, result: TestResult) -> None:
    """Write the recording of each role, with names, SHA-256, sizes and order of the exports."""
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
            _write_recording(role_group, result.recordings[role])


def _read_inputs(raw_group: Any) -> tuple[InputFile, ...]:
    """Read the names, SHA-256 and sizes of the exports, in the order of the protocol."""
    inputs: dict[int, InputFile] = {}
    for role, group in raw_group.items():
        rows = zip(
            group.attrs["input_order"],
            read_texts(group, "file"),
            read_texts(group, "sha256"),
            group.attrs["bytes"],
            strict=True,
        )
        inputs |= {int(i): InputFile(role, file, sha, int(size)) for i, file, sha, size in rows}
    return tuple(inputs[i] for i in sorted(inputs))


def _write_aligned(target: GroupWriter, aligned: Aligned) -> None:
    """Write aligned signals, with the events of their clocks."""
    write_arrays(target, aligned)
    datasets = _write_series(target, "series", aligned.series.items(), ("events",))
    for name, dataset in zip(aligned.series, datasets, strict=True):
        dataset.attrs["name"] = name
    target.attach_scales()
    if aligned.clock_fit is not None:
        write_attributes(target, aligned.clock_fit)
        write_arrays(target.open_group("events"), aligned.clock_fit)


def _read_aligned(root: Any) -> Aligned | None:
    """Read the aligned signals; None without a group of them."""
    if "aligned" not in root:
        return None
    group = root["aligned"]
    series = {
        read_text(group[name], "name"): _read_series(group, name, Series)
        for name in read_texts(group, "series")
    }
    fit = None
    if "events" in group:
        events = read_arrays(group["events"], ClockFit)
        fit = ClockFit(**events, **read_attributes(group, ClockFit))
    aligned = read_record(group, Aligned, series=series, clock_fit=fit)
    values = {name: channel.values for name, channel in series.items()}
    _require_equal_lengths(aligned.time, values)
    return aligned


def _write_curve(target: GroupWriter, result: TestResult, curve: Curve) -> None:
    """Write the curve of a test, with its branches, and the slips and fitted lines of the test."""
    write_arrays(target, curve)
    for name, sample_numbers in zip(("branch", "cycle"), curve.assign_samples(), strict=True):
        target.write_array(name, sample_numbers, _SAMPLE_NUMBER)
    target.attach_scales()
    write_table(target, "branches", Branch, curve.branches, curve.time_unit)
    _write_optional_table(target, "slips", Slip, result.slips)
    _write_optional_table(target, "lines", FittedLine, result.lines)


def _read_curve(root: Any) -> dict[str, Any]:
    """Read the curve, slips and fitted lines of a test.

    Parameters
    ----------
    root : open result file

    Returns
    -------
    Values of the fields `curve`, `slips` and `lines` of `TestResult`; without a curve, only `curve`
    with None.
    """
    if "curve" not in root:
        return {"curve": None}
    group = root["curve"]
    time_unit = read_text(group["time"], "unit")
    branches = read_table(group, "branches", Branch, time_unit)
    curve = read_record(group, Curve, branches=branches)
    for branch in branches:
        if branch.cycle < 1 or not 0 <= branch.start <= branch.stop <= len(curve.time):
            message = f"a branch of cycle {branch.cycle}: {branch.start} to {branch.stop}"
            raise ValueError(message)
    return {
        "curve": curve,
        "slips": _read_optional_table(group, "slips", Slip),
        "lines": _read_optional_table(group, "lines", FittedLine),
    }


def _write_optional_table(target: GroupWriter, name: str, kind: Any, rows: Sequence[Any]) -> None:
    """Write a table as `write_table` does, unless it is empty."""
    if rows:
        write_table(target, name, kind, rows)


def _read_optional_table(parent: Any, name: str, kind: type[_R]) -> tuple[_R, ...]:
    """Read a table that `_write_optional_table` wrote; empty if there is none."""
    return read_table(parent, name, kind) if name in parent else ()


def _write_bending(target: GroupWriter, bending: Bending) -> None:
    """Write the measured moments and curvatures, with their law."""
    write_record(target, bending.cloud)
    write_attributes(target, bending)
    if bending.law is not None:
        write_record(target.open_group("law"), bending.law)


def _read_bending(root: Any) -> Bending | None:
    """Read measured moments and curvatures; None without a group of them."""
    if "bending" not in root:
        return None
    group = root["bending"]
    law = read_record(group["law"], MeasuredLaw) if "law" in group else None
    return read_record(group, Bending, cloud=read_record(group, BendingCloud), law=law)


def _write_results(target: GroupWriter, results: Sequence[Result]) -> None:
    """Write the results, a table of them, and a table of their budgets."""
    group = target.open_group("results")
    group.write_texts("order", tuple(result.name for result in results))
    rows, budget_rows = [], []
    for result in results:
        result_group = group.open_group(result.name)
        result_group.group.attrs["value"] = _none_to_nan(result.value)
        result_group.group.attrs["seal"] = result.seal
        write_attributes(result_group, result, skip=("name", "value"))
        interval = result.interval or Interval(nan, nan, nan)
        numbers = result.value, result.best_estimate, interval.lower, interval.upper
        status = result.status, ", ".join(result.codes), result.reason_text
        rows.append(ResultRow(result.name, *numbers, result.unit, interval.level, *status))
        for row, share in zip(result.budget, result.fractions, strict=True):
            cells = (result.name, row.cause, row.change, result.unit, share, row.is_common)
            budget_rows.append(BudgetRow(*cells))
    write_table(group, "table", ResultRow, rows)
    _write_optional_table(target, "budgets", BudgetRow, budget_rows)


def _read_results(root: Any) -> tuple[Result, ...]:
    """Read the results of a test, with their budgets.

    Parameters
    ----------
    root : open result file

    Raises
    ------
    ValueError
        If the numbers of a result do not match its seal.
    """
    group, budgets = root["results"], dict[str, list[Contribution]]()
    if "budgets" in root:
        names = ("result", "cause", "change", "is_common")
        columns = read_columns(root["budgets"], BudgetRow, names)
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


def write_test(target: GroupWriter, result: TestResult) -> None:
    """Write all parts of a test.

    Parameters
    ----------
    target : root of the result file
    result : processed test
    """
    target.group.attrs[SCHEMA_ATTRIBUTE] = SCHEMA_VERSION
    write_attributes(target, result)
    target.group.attrs["display"] = json.dumps(dict(result.display), ensure_ascii=False)
    _write_specimen(target, result.specimen)
    _write_raw(target.open_group("raw"), result)
    if result.aligned is not None:
        _write_aligned(target.open_group("aligned"), result.aligned)
    if result.curve is not None:
        _write_curve(target.open_group("curve"), result, result.curve)
    if result.shape is not None:
        write_record(target.open_group("shape"), result.shape)
    if result.bending is not None:
        _write_bending(target.open_group("bending"), result.bending)
    _write_optional_table(target, "instruments", Instrument, result.instruments)
    _write_results(target, result.results)
    write_table(target, "quality", QualityNote, result.quality)


@dataclass(frozen=True, slots=True, eq=False)
class RawTest:
    """Parts of a result file that are sufficient to process the test again.

    Parameters
    ----------
    test : name of the test
    specimen : specimen that was tested
    protocol : name of the protocol
    protocol_yaml : YAML text of the resolved protocol
    test_yaml : YAML text of the test sheet
    labpipe_version : version of labpipe that wrote the file
    inputs : exports with their SHA-256
    recordings : recordings, keyed by role
    """

    test: str
    specimen: Specimen
    protocol: str
    protocol_yaml: str
    test_yaml: str
    labpipe_version: str
    inputs: tuple[InputFile, ...]
    recordings: Mapping[str, Recording]


FrameChoice = Callable[[TestResult, Floats], tuple[Ints, Floats]]
"""Function that chooses frames, given the test and the times of all frames, s.

It returns the indices of the chosen frames, in increasing order, and their deflections, m.
"""


def _read_common_fields(root: Any, *, reads_recordings: bool = True) -> dict[str, Any]:
    """Read the fields that `TestResult` and `RawTest` share, with or without recordings."""
    group = root["raw"]
    roles = read_texts(group, "roles") if reads_recordings else ()
    return {
        **read_attributes(root, RawTest),
        "specimen": _read_specimen(root),
        "inputs": _read_inputs(group),
        "recordings": {role: _read_recording(group[role]) for role in roles},
    }


def read_test(root: Any, stages: Collection[str] = ()) -> TestResult:
    """Read curve and results of a test, and the requested stages.

    Parameters
    ----------
    root : open result file
    stages : names of further parts to be read: ``raw``, ``aligned``, ``shape``, ``bending``.
        Aligned signals are also read if slips were repaired
    """
    display = json.loads(read_text(root, "display"))
    fields = _read_curve(root)  # fields `curve`, `slips` and `lines`
    is_repaired = any(slip.decision is SlipDecision.REPAIRED for slip in fields.get("slips", ()))
    has_shape = "shape" in stages and "shape" in root
    return TestResult(
        **_read_common_fields(root, reads_recordings="raw" in stages),
        **read_attributes(root, TestResult, skip=list_attributes(RawTest)),
        **fields,
        results=_read_results(root),
        quality=read_table(root, "quality", QualityNote),
        display={str(key): str(unit) for key, unit in display.items()},
        instruments=_read_optional_table(root, "instruments", Instrument),
        aligned=_read_aligned(root) if "aligned" in stages or is_repaired else None,
        shape=read_record(root["shape"], Shape) if has_shape else None,
        bending=_read_bending(root) if "bending" in stages else None,
    )


def read_reported_test(
    root: Any, choose_frames: FrameChoice
) -> tuple[TestResult, FigureShapes | None, FigureLaw | None]:
    """Read the parts of a test that a report shows.

    Parameters
    ----------
    root : open result file
    choose_frames : function that chooses the frames whose shapes are read

    Returns
    -------
    result : curve and results of the test
    shapes : shapes at the chosen frames; None without shapes
    law : moment-curvature law of the first loading; None without a measured law
    """
    result, shapes, law = read_test(root), None, None
    if "shape" in root:
        group, specs = root["shape"], list_datasets(Shape)
        frames, deflection = choose_frames(result, read_array(group, "time", specs["time"]))
        positions = read_array_rows(group, "positions", specs["positions"], frames)
        shapes = FigureShapes(deflection, positions[:, :, :2])
    if (group := root.get("bending/law")) is not None:
        law = FigureLaw(**read_arrays(group, MeasuredLaw, list_datasets(FigureLaw)))
    return result, shapes, law


def read_raw_test(root: Any) -> RawTest:
    """Read the parts of a test that are sufficient to process it again.

    Parameters
    ----------
    root : open result file
    """
    return RawTest(**_read_common_fields(root))
