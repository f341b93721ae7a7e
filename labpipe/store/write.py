"""TestResult to HDF5: made in memory, written beside the old file, verified, renamed."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from labpipe.errors import StoreError, complaint
from labpipe.records.curve import Aligned, ClockFit, Curve, Shape
from labpipe.records.quality import QualityNote
from labpipe.records.recording import Channel, Clock, MarkerTracks, Recording
from labpipe.records.result import InputFile, Result, Specimen, TestResult
from labpipe.store import layout
from labpipe.store.chunks import same_content, string_array, write_array
from labpipe.store.layout import Field, link_name
from labpipe.store.replace import replacing

_BLOCK = 1 << 20


def write_result(result: TestResult, path: Path) -> None:
    """Write everything known of a test; an earlier file stays until the new one is verified.

    Parameters
    ----------
    result : a processed test
    path : the file, by custom ``result.h5``

    Raises
    ------
    StoreError
        If it cannot be written, or does not read back as it was written. What stood at `path`
        before still stands there then.

    Notes
    -----
    The same result gives the same bytes: no times, no names of machines. The file is put together
    in memory (about as large as on disk), because an HDF5 library that meets a full disk half-way
    cannot close its file in good order.
    """
    image, written = _image(result)
    with replacing(path) as temporary:
        temporary.write_bytes(image)
        _verify(temporary, path, image, written)


@dataclass(frozen=True, slots=True)
class _Target:
    """An open group, the threads that deflate, and what has been written so far."""

    group: Any
    pool: Executor
    written: dict[str, NDArray[Any]] = field(default_factory=dict)

    def inside(self, name: str) -> _Target:
        return _Target(self.group.create_group(name), self.pool, self.written)

    def array(self, name: str, values: NDArray[Any], kind: Field, unit: str = "") -> Any:
        stated = kind.unit or unit
        dataset = write_array(self.group, name, values, unit=stated, axes=kind.axes, pool=self.pool)
        self.written[dataset.name] = values
        return dataset

    def strings(self, name: str, texts: tuple[str, ...], axis: str) -> None:
        self.array(name, string_array(texts), Field((axis,), layout.TEXT))

    def fields(self, record: object, kinds: Any) -> None:
        for name, kind in kinds.items():
            self.array(name, getattr(record, name), kind)

    def texts(self, name: str, values: tuple[str, ...]) -> None:
        data = np.array(values, dtype=object)
        self.group.attrs.create(name, data, dtype=h5py.string_dtype())


def _image(result: TestResult) -> tuple[bytes, dict[str, NDArray[Any]]]:
    """Put the whole file together in memory; with the arrays by dataset, to verify it."""
    with (
        ThreadPoolExecutor(max(os.cpu_count() or 1, 2)) as pool,
        h5py.File("result", "w", driver="core", backing_store=False, block_size=_BLOCK) as root,
    ):
        target = _Target(root, pool)
        _write_root(target, result)
        root.flush()
        return root.id.get_file_image(), target.written


def _verify(temporary: Path, path: Path, image: bytes, written: dict[str, NDArray[Any]]) -> None:
    """Read the file again from its disk: every byte, and every array through its checksums."""
    if temporary.read_bytes() != image or not _holds(temporary, written):
        message = complaint(
            path,
            "",
            expected="to read back what was written",
            found="something else",
            remedy="Check the disk; the earlier result, if any, is untouched.",
        )
        raise StoreError(message)


def _holds(path: Path, written: dict[str, NDArray[Any]]) -> bool:
    try:
        with h5py.File(path, "r") as root:
            return all(same_content(root[name], array) for name, array in written.items())
    except OSError:  # a checksum that does not fit
        return False


def _write_root(target: _Target, result: TestResult) -> None:
    attributes = target.group.attrs
    attributes[layout.SCHEMA_ATTRIBUTE] = layout.SCHEMA
    for name in layout.ROOT_TEXTS:
        attributes[name] = getattr(result, name)
    attributes[layout.DISPLAY] = json.dumps(dict(result.display), ensure_ascii=False)
    target.texts(layout.FIGURES, result.figures)
    _write_specimen(target, result.specimen)
    _write_raw(target.inside(layout.RAW), result)
    if result.aligned is not None:
        _write_aligned(target.inside(layout.ALIGNED), result.aligned)
    if result.curve is not None:
        _write_curve(target.inside(layout.CURVE), result, result.curve)
    if result.shape is not None:
        _write_shape(target.inside(layout.SHAPE), result.shape)
    _write_results(target.inside(layout.RESULTS), result.results)
    _write_notes(target.inside(layout.QUALITY), result.quality)


def _write_specimen(target: _Target, specimen: Specimen) -> None:
    for name, attribute in layout.SPECIMEN_TEXTS.items():
        target.group.attrs[attribute] = getattr(specimen, name)
    dimensions = target.inside(layout.SPECIMEN)
    dimensions.texts("dimensions", tuple(specimen.dimensions))
    dimensions.group.attrs["values"] = np.array(list(specimen.dimensions.values()), dtype=float)
    dimensions.group.attrs["unit"] = "m"


def _write_raw(target: _Target, result: TestResult) -> None:
    roles = dict.fromkeys([*result.recordings, *(given.role for given in result.inputs)])
    target.texts("roles", tuple(result.recordings))
    for role in roles:
        inside = target.inside(role)
        _write_inputs(inside, role, result.inputs)
        if role in result.recordings:
            _write_recording(inside, result.recordings[role])


def _write_inputs(target: _Target, role: str, inputs: tuple[InputFile, ...]) -> None:
    """Fingerprints of the exports of one role, each with its place among all of them."""
    mine = [(number, given) for number, given in enumerate(inputs) if given.role == role]
    target.texts("file", tuple(given.file for _, given in mine))
    target.texts("sha256", tuple(given.sha256 for _, given in mine))
    target.group.attrs["bytes"] = np.array([given.bytes for _, given in mine], dtype=np.int64)
    target.group.attrs[layout.INPUT_ORDER] = np.array(
        [number for number, _ in mine], dtype=np.int64
    )


def _write_recording(target: _Target, recording: Recording) -> None:
    attributes = target.group.attrs
    for name in layout.RECORDING_TEXTS:
        attributes[name] = getattr(recording, name)
    attributes[layout.METADATA] = json.dumps(dict(recording.metadata), ensure_ascii=False)
    _write_notes(target.inside(layout.NOTES), recording.notes)
    if recording.markers is not None:
        _write_markers(target, recording.markers)
    _write_clocks(target, recording.clocks)
    if recording.markers is not None and layout.TIME not in target.group:
        target.group[layout.TIME] = target.group[layout.MARKERS][layout.TIME]
    _write_channels(target, recording.channels)


def _write_clocks(target: _Target, clocks: tuple[Clock, ...]) -> None:
    """One clock is ``time``, several are ``time_<clock>``."""
    names: list[str] = []
    for clock in clocks:
        wanted = layout.TIME if len(clocks) == 1 else f"{layout.TIME}_{clock.name}"
        names.append(link_name(wanted, target.group))
        dataset = target.array(names[-1], clock.time, layout.CLOCK_TIME, clock.unit)
        dataset.attrs["clock"] = clock.name
    target.texts("clocks", tuple(names))


def _write_channels(target: _Target, channels: tuple[Channel, ...]) -> None:
    names: list[str] = []
    for channel in channels:
        names.append(link_name(channel.name, [*target.group, *_RESERVED]))
        unit = layout.NO_UNIT if channel.unit is None else channel.unit
        dataset = target.array(names[-1], channel.values, layout.CHANNEL, unit)
        for field_name, attribute in layout.CHANNEL_TEXTS.items():
            dataset.attrs[attribute] = getattr(channel, field_name)
    target.texts("channels", tuple(names))


_RESERVED = (layout.TIME, layout.MARKERS, layout.BODIES, layout.NOTES)


def _write_markers(target: _Target, tracks: MarkerTracks) -> None:
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


def _write_aligned(target: _Target, aligned: Aligned) -> None:
    target.array(layout.TIME, aligned.time, layout.CLOCK_TIME, aligned.time_unit)
    names: list[str] = []
    for name, series in aligned.series.items():
        names.append(link_name(name, [*target.group, layout.EVENTS]))
        dataset = target.array(names[-1], series.values, layout.SERIES, series.unit)
        dataset.attrs["name"] = name
    target.texts("series", tuple(names))
    if aligned.clock_fit is not None:
        _write_clock_fit(target, aligned.clock_fit)


def _write_clock_fit(target: _Target, fit: ClockFit) -> None:
    attributes = target.group.attrs
    attributes["method"] = fit.method
    for name, unit in layout.CLOCK_FIT_UNITS.items():
        attributes[name] = float(getattr(fit, name))
        attributes[f"{name}_unit"] = unit
    for name in layout.CLOCK_FIT_INTERVALS:
        interval = getattr(fit, f"{name}_interval")
        for end in layout.INTERVAL_NUMBERS:
            attributes[f"{name}_{end}"] = float(getattr(interval, end))
    target.inside(layout.EVENTS).fields(fit, layout.EVENT_FIELDS)


def _write_curve(target: _Target, result: TestResult, curve: Curve) -> None:
    target.array(layout.TIME, curve.time, layout.CLOCK_TIME, curve.time_unit)
    target.fields(curve, layout.CURVE_FIELDS)
    branches = _table(curve.branches, layout.BRANCH_COLUMNS)
    target.array(layout.BRANCHES, branches, layout.branch_table(curve.time_unit))
    if result.slips:
        slips = _table(result.slips, layout.SLIP_COLUMNS)
        target.array(layout.SLIPS, slips, layout.SLIP_TABLE)
    if result.lines:
        lines = _table(result.lines, layout.LINE_COLUMNS)
        target.array(layout.LINES, lines, layout.LINE_TABLE)


def _table(records: Iterable[object], columns: tuple[tuple[str, str], ...]) -> NDArray[Any]:
    """Rows of a table; ``drop_lower`` is the lower end of a record's ``drop_interval``."""
    rows = [tuple(_cell(record, *column) for column in columns) for record in records]
    kinds = [
        (name, _wide_enough(kind, [row[place] for row in rows]))
        for place, (name, kind) in enumerate(columns)
    ]
    return np.array(rows, dtype=kinds)


def _wide_enough(kind: str, cells: list[Any]) -> str:
    """The type of a column; numpy would cut words short that are longer than the layout says."""
    return f"S{max([int(kind[1:]), *map(len, cells)])}" if kind.startswith("S") else kind


def _cell(record: object, column: str, kind: str) -> object:
    name, _, end = column.rpartition("_")
    if name and end in layout.INTERVAL_NUMBERS:
        return getattr(getattr(record, f"{name}_interval"), end)
    value = getattr(record, column)
    return str(value).encode() if kind.startswith("S") else value


def _write_shape(target: _Target, shape: Shape) -> None:
    target.fields(shape, layout.SHAPE_FIELDS)
    target.strings(layout.NAMES, shape.names, "point")
    target.group.attrs["length"] = float(shape.length)
    target.group.attrs["length_unit"] = "m"


def _write_results(target: _Target, results: tuple[Result, ...]) -> None:
    target.texts("order", tuple(result.name for result in results))
    for result in results:
        attributes = target.inside(result.name).group.attrs
        attributes["value"] = np.nan if result.value is None else float(result.value)
        attributes["n"] = int(result.n)
        for name in layout.RESULT_TEXTS:
            attributes[name] = str(getattr(result, name))
        if result.interval is not None:
            for end in layout.INTERVAL_NUMBERS:
                attributes[end] = float(getattr(result.interval, end))


def _write_notes(target: _Target, notes: tuple[QualityNote, ...]) -> None:
    for name in layout.NOTE_COLUMNS:
        target.strings(name, tuple(str(getattr(note, name)) for note in notes), "note")
