"""Parts of a test as xarray Datasets, with dimensions and units of `store.layout`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from labpipe.errors import UsageError, error_text
from labpipe.records.arrays import AXIS_LABELS
from labpipe.records.curve import Series
from labpipe.store.layout import NO_UNIT, Field, fields_of, link_name, scales_of

if TYPE_CHECKING:
    from xarray import Dataset as Dataset  # noqa: PLC0414 - for `Test`

    from labpipe.records.curve import Aligned
    from labpipe.records.recording import Recording
    from labpipe.records.result import TestResult

PARTS: Final = ("curve", "aligned", "shape", "bending", "law")


def dataset_of(result: TestResult, part: str) -> Dataset | None:
    """Make a Dataset of a part of a test.

    Parameters
    ----------
    result : with everything
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
        return _of_recording(result.recordings[part])
    if part == "aligned":
        return None if result.aligned is None else _of_aligned(result.aligned)
    record = _record(result, part)
    return None if record is None else _of_record(record)


def _record(result: TestResult, part: str) -> object:
    """Return a part, None if missing."""
    if part in ("curve", "shape"):
        return getattr(result, part)
    bending = result.bending
    return None if bending is None else bending.cloud if part == "bending" else bending.law


def _of_record(record: object) -> Dataset:
    fields = {
        name: replace(field, unit=getattr(record, field.stated_in, field.unit))
        for name, field in fields_of(type(record)).items()
    }
    return _dataset({name: np.asarray(getattr(record, name)) for name in fields}, fields)


def _dataset(arrays: Mapping[str, np.ndarray], fields: Mapping[str, Field]) -> Dataset:
    """Make a Dataset whose dimensions have the names of the scales in a result file."""
    variables: dict[str, Any] = {}
    coordinates: dict[str, Any] = {}
    scales = scales_of(fields)
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
    dataset: Dataset = _xarray().Dataset(variables, coords=coordinates)
    return dataset


def _of_aligned(aligned: Aligned) -> Dataset:
    series = {"time": Series(aligned.time, aligned.time_unit), **aligned.series}
    fields = {name: Field(("sample",), one.unit) for name, one in series.items()}
    return _dataset({name: one.values for name, one in series.items()}, fields)


def _of_recording(recording: Recording) -> Dataset:
    """Make a Dataset: channels by the time of their clock, markers by the time of frames."""
    variables: dict[str, Any] = {}
    of_clock = {
        clock.name: "time" if len(recording.clocks) == 1 else f"time_{clock.name}"
        for clock in recording.clocks
    }
    for clock in recording.clocks:
        dimension = of_clock[clock.name]
        variables[dimension] = ([dimension], clock.time, {"units": clock.unit})
    for channel in recording.channels:
        name = link_name(channel.name, variables)
        about = {"units": channel.unit or NO_UNIT, "name_in_file": channel.path}
        variables[name] = ([of_clock[channel.clock]], channel.values, about)
    tracks = recording.markers
    if tracks is not None:
        frame = "time_markers" if recording.clocks else "time"
        variables[frame] = ([frame], tracks.time, {"units": "s"})
        variables["marker"] = (["marker"], list(tracks.names))
        variables["xyz"] = (["xyz"], list(AXIS_LABELS["xyz"]))
        variables["positions"] = ([frame, "marker", "xyz"], tracks.positions, {"units": "m"})
    dataset: Dataset = _xarray().Dataset(variables)
    return dataset


def _xarray() -> Any:
    try:
        import xarray
    except ImportError as error:
        message = error_text(
            "xarray",
            "",
            expected="the package",
            found="none",
            remedy='Install it: pip install "labpipe[xarray]". pandas tables need no xarray.',
        )
        raise UsageError(message) from error
    return xarray
