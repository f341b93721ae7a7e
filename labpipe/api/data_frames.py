"""Make pandas tables and xarray Datasets of results, curves, shapes and recordings.

Units are in ``frame.attrs["units"]`` by column, in a column ``unit``, or in ``attrs["units"]`` of
a variable.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import pandas as pd

from labpipe.errors import UsageError, sort_by_likeness
from labpipe.records.arrays import AXIS_LABELS
from labpipe.records.curve import Series
from labpipe.report.wording import Scale, find_display_unit
from labpipe.store.layout import (
    UNSTATED_UNIT,
    DatasetSpec,
    find_scales,
    list_datasets,
    make_link_name,
)
from labpipe.units import find_si_factor

if TYPE_CHECKING:
    from collections.abc import Callable

    from xarray import Dataset

    from labpipe.records.curve import Aligned, Curve, Shape
    from labpipe.records.quality import QualityNote
    from labpipe.records.recording import MarkerTracks, Recording, RigidBody
    from labpipe.records.result import Result, TestResult

_AXES = ("x", "y", "z")


@dataclass(frozen=True, slots=True)
class Units:
    """Units of the numbers in tables.

    Parameters
    ----------
    display : unit by quantity, from a protocol; None for SI
    """

    display: Mapping[str, str] | None = None

    def scale_result(self, name: str, unit: str) -> Scale:
        """Return factor and unit for a result, or for a change of it."""
        return (
            Scale(1.0, unit)
            if self.display is None
            else find_display_unit(name, unit, self.display)
        )

    def scale_quantity(self, quantity: str, unit: str) -> Scale:
        """Return factor and unit for a quantity such as ``force``."""
        target = unit if self.display is None else self.display.get(quantity, unit)
        return Scale(1.0 / find_si_factor(target, unit), target)


def _make_frame(columns: Mapping[str, str], rows: Iterable[Sequence[object]]) -> pd.DataFrame:
    """Make a table of rows; None in a column of numbers becomes NaN.

    Parameters
    ----------
    columns : type by name
    rows : values in the order of the columns
    """
    return pd.DataFrame(list(rows), columns=list(columns)).astype(dict(columns))


_RESULT_TYPES = {
    "name": "str",
    **dict.fromkeys(("value", "estimate", "lower", "upper"), "float64"),
    **dict.fromkeys(("unit", "status", "code", "reason"), "str"),
}
_BUDGET_TYPES = {"cause": "str", "change": "float64", "share": "float64", "is_common": "bool"}
_NOTE_TYPES = dict.fromkeys(("code", "severity", "where", "message"), "str")


def make_results_frame(results: Iterable[Result], units: Units) -> pd.DataFrame:
    """Make a table of results.

    Parameters
    ----------
    results : of one test
    units : of the numbers

    Returns
    -------
    By ``name``: ``value``, ``estimate``, ``lower``, ``upper`` (float64, NaN where not available),
    ``unit``, ``status``, ``code``, ``reason`` (text, the last two empty where there is none).
    """

    def make_row(result: Result) -> list[object]:
        factor, unit = units.scale_result(result.name, result.unit)
        ends = (result.interval.lower, result.interval.upper) if result.interval else (None, None)
        numbers = (result.value, result.best_estimate, *ends)
        scaled = [np.nan if number is None else number * factor for number in numbers]
        return [
            result.name,
            *scaled,
            unit,
            result.status,
            ", ".join(result.codes),
            result.reason_text,
        ]

    return _make_frame(_RESULT_TYPES, map(make_row, results)).set_index("name")


def make_budget_frame(result: Result, units: Units) -> pd.DataFrame:
    """Make a table of the contributions to the interval of a result.

    Parameters
    ----------
    result : with or without a budget
    units : of the numbers

    Returns
    -------
    By ``cause``: ``change`` by one standard uncertainty of the cause, in the unit of the result,
    ``share`` of the variance, ``is_common`` to all tests of a rig. Empty if not known.
    """
    factor, unit = units.scale_result(result.name, result.unit)
    rows = [
        (part.cause, factor * part.change, share, part.is_common)
        for part, share in zip(result.budget, result.shares, strict=True)
    ]
    frame = _make_frame(_BUDGET_TYPES, rows).set_index("cause")
    frame.attrs["units"] = {"change": unit, "share": "1"}
    return frame


def make_curve_frame(curve: Curve, units: Units) -> pd.DataFrame:
    """Make a table of a curve.

    Parameters
    ----------
    curve : of one test
    units : of the numbers

    Returns
    -------
    ``time``, ``displacement``, ``force`` (float64); ``branch`` (from 0 in order of travel, -1
    outside every branch) and ``cycle`` (from 1, 0 outside), int64.
    """
    scales = {
        "time": Scale(1.0, curve.time_unit),
        "displacement": units.scale_quantity("displacement", "m"),
        "force": units.scale_quantity("force", "N"),
    }
    columns = {name: scale.factor * getattr(curve, name) for name, scale in scales.items()}
    frame = pd.DataFrame(columns | {"branch": curve.branch, "cycle": curve.cycle})
    frame.attrs["units"] = {name: scale.unit for name, scale in scales.items()}
    return frame


def make_shape_frame(shape: Shape, units: Units) -> pd.DataFrame:
    """Make a table of positions along the specimen.

    Parameters
    ----------
    shape : of one test
    units : of the numbers

    Returns
    -------
    By ``time`` (s): a column (point, axis) for x, y and z of the clamped end, each marker and the
    pull point, in the frame of the specimen; NaN where a marker was not seen.
    """
    factor, unit = units.scale_quantity("displacement", "m")
    return _make_position_frame(shape.time, shape.names, factor * shape.positions, "point", unit)


def _make_position_frame(
    time: np.ndarray, names: tuple[str, ...], positions: np.ndarray, kind: str, unit: str
) -> pd.DataFrame:
    columns = pd.MultiIndex.from_product([names, _AXES], names=[kind, "axis"])
    index = pd.Index(time, name="time")
    frame = pd.DataFrame(positions.reshape(len(time), -1), index=index, columns=columns)
    frame.attrs["units"] = {"time": "s", "position": unit}
    return frame


def make_quality_frame(notes: Iterable[QualityNote]) -> pd.DataFrame:
    """Make a table of quality notes: ``code``, ``severity``, ``where``, ``message``, all text."""
    return _make_frame(
        _NOTE_TYPES, ([getattr(note, name) for name in _NOTE_TYPES] for note in notes)
    )


class Recordings(Mapping[str, pd.DataFrame]):
    """Recordings of a test as tables by name.

    The name is the role of the export, such as ``force``: the table has its channels by time. An
    export with several clocks has a table for each, ``<role>/<clock>``. Markers are a table with
    columns (marker, axis), named ``<role>/markers`` if the export has clocks, too. Each rigid body
    has a table ``<role>/<body>``: x, y, z, quaternion qx, qy, qz, qw, and error.

    Parameters
    ----------
    recordings : by role
    """

    def __init__(self, recordings: Mapping[str, Recording]) -> None:
        self._tables = {
            name: make_table
            for role, recording in recordings.items()
            for name, make_table in _list_tables(role, recording)
        }

    def __getitem__(self, name: str) -> pd.DataFrame:
        if not self._tables:
            raise UsageError.about("api.no_recordings", "raw")
        if name not in self._tables:
            names = ", ".join(sort_by_likeness(name, list(self._tables)))
            raise UsageError.about("api.no_recording", "raw", name=name, names=names)
        return self._tables[name]()

    def __iter__(self) -> Iterator[str]:
        return iter(self._tables)

    def __len__(self) -> int:
        return len(self._tables)

    def __contains__(self, name: object) -> bool:
        return name in self._tables

    def __repr__(self) -> str:
        return f"<labpipe recordings: {', '.join(self._tables) or 'none'}>"

    def _ipython_key_completions_(self) -> list[str]:
        return list(self._tables)


def _list_tables(
    role: str, recording: Recording
) -> Iterator[tuple[str, Callable[[], pd.DataFrame]]]:
    """Yield the names of the tables of a recording, and functions that make them."""
    tracks = recording.markers
    is_single = len(recording.clocks) == 1 and tracks is None
    for clock in recording.clocks:
        name = role if is_single else f"{role}/{clock.name}"
        yield name, partial(_make_channel_frame, recording, clock.name)
    if tracks is not None:
        yield (
            role if not recording.clocks else f"{role}/markers",
            partial(_make_marker_frame, tracks),
        )
        for body in tracks.bodies:
            yield f"{role}/{body.name}", partial(_make_body_frame, tracks, body)


def _make_channel_frame(recording: Recording, clock_name: str) -> pd.DataFrame:
    clock = recording.clock(clock_name)
    channels = [channel for channel in recording.channels if channel.clock == clock_name]
    counts = Counter(channel.name for channel in channels)
    named = {
        channel.name if counts[channel.name] == 1 else channel.path: channel for channel in channels
    }
    columns = {name: channel.values for name, channel in named.items()}
    frame = pd.DataFrame(columns, index=pd.Index(clock.time, name="time"))
    units = {name: channel.unit or UNSTATED_UNIT for name, channel in named.items()}
    frame.attrs["units"] = {"time": clock.unit} | units
    return frame


def _make_marker_frame(tracks: MarkerTracks) -> pd.DataFrame:
    return _make_position_frame(tracks.time, tracks.names, tracks.positions, "marker", "m")


def _make_body_frame(tracks: MarkerTracks, body: RigidBody) -> pd.DataFrame:
    values = np.column_stack([body.position, body.rotation, body.error])
    names = [*_AXES, "qx", "qy", "qz", "qw", "error"]
    frame = pd.DataFrame(values, index=pd.Index(tracks.time, name="time"), columns=names)
    frame.attrs["units"] = {"time": "s"} | {
        name: "1" if name.startswith("q") else "m" for name in names
    }
    return frame


PARTS: Final = ("curve", "aligned", "shape", "bending", "law")


def make_dataset(result: TestResult, part: str) -> Dataset | None:
    """Make a Dataset of a part of a test.

    Parameters
    ----------
    result : complete, with shapes and recordings
    part : one of `PARTS`, or the role of a recording

    Returns
    -------
    The part; None if the test has none.

    Raises
    ------
    UsageError
        If xarray is not installed.
    """
    if part in result.recordings:
        return _make_recording_dataset(result.recordings[part])
    if part == "aligned":
        return None if result.aligned is None else _make_aligned_dataset(result.aligned)
    record = _find_record(result, part)
    return None if record is None else _make_record_dataset(record)


def _find_record(result: TestResult, part: str) -> object:
    """Find the record of a part of a test; None if missing."""
    if part in ("curve", "shape"):
        return getattr(result, part)
    bending = result.bending
    return None if bending is None else bending.cloud if part == "bending" else bending.law


def _make_record_dataset(record: object) -> Dataset:
    fields = {
        name: replace(field, unit=getattr(record, field.stated_in, field.unit))
        for name, field in list_datasets(type(record)).items()
    }
    return _assemble_dataset({name: np.asarray(getattr(record, name)) for name in fields}, fields)


def _assemble_dataset(
    arrays: Mapping[str, np.ndarray], fields: Mapping[str, DatasetSpec]
) -> Dataset:
    """Make a Dataset whose dimensions have the names of the scales in a result file."""
    variables: dict[str, Any] = {}
    coordinates: dict[str, Any] = {}
    scales = find_scales(fields)
    for name, values in arrays.items():
        axes = [
            scales.get(axis, axis) + ("_2" if axis in fields[name].axes[:place] else "")
            for place, axis in enumerate(fields[name].axes)
        ]
        variables[name] = (axes, values, {"units": fields[name].unit})
        for axis, dimension in zip(fields[name].axes, axes, strict=True):
            if axis in AXIS_LABELS:
                coordinates[dimension] = list(AXIS_LABELS[axis])
            if dimension.endswith("_2"):
                coordinates[dimension] = arrays[scales[axis]]
    dataset: Dataset = _import_xarray().Dataset(variables, coords=coordinates)
    return dataset


def _make_aligned_dataset(aligned: Aligned) -> Dataset:
    series = {"time": Series(aligned.time, aligned.time_unit), **aligned.series}
    fields = {name: DatasetSpec(("sample",), channel.unit) for name, channel in series.items()}
    return _assemble_dataset({name: channel.values for name, channel in series.items()}, fields)


def _make_recording_dataset(recording: Recording) -> Dataset:
    """Make a Dataset: channels by the time of their clock, markers by the time of frames."""
    variables: dict[str, Any] = {}
    dimensions = {
        clock.name: "time" if len(recording.clocks) == 1 else f"time_{clock.name}"
        for clock in recording.clocks
    }
    for clock in recording.clocks:
        dimension = dimensions[clock.name]
        variables[dimension] = ([dimension], clock.time, {"units": clock.unit})
    for channel in recording.channels:
        name = make_link_name(channel.name, variables)
        attributes = {"units": channel.unit or UNSTATED_UNIT, "name_in_file": channel.path}
        variables[name] = ([dimensions[channel.clock]], channel.values, attributes)
    tracks = recording.markers
    if tracks is not None:
        frame = "time_markers" if recording.clocks else "time"
        variables[frame] = ([frame], tracks.time, {"units": "s"})
        variables["marker"] = (["marker"], list(tracks.names))
        variables["xyz"] = (["xyz"], list(AXIS_LABELS["xyz"]))
        variables["positions"] = ([frame, "marker", "xyz"], tracks.positions, {"units": "m"})
    dataset: Dataset = _import_xarray().Dataset(variables)
    return dataset


def _import_xarray() -> Any:
    try:
        import xarray
    except ImportError as error:
        raise UsageError.about("api.no_xarray", "xarray") from error
    return xarray
