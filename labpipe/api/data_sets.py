"""Parts of a test as xarray Datasets, with dimensions and units of `store.layout`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from labpipe.errors import UsageError, error_text
from labpipe.store import layout
from labpipe.store.layout import Field

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
    record, fields, scales = _record(result, part)
    return None if record is None else _of_record(record, fields, scales)


def _record(result: TestResult, part: str) -> tuple[object, Mapping[str, Field], Mapping[str, str]]:
    """Return a part (None if missing), its arrays and their dimensions."""
    bending, curve = result.bending, result.curve
    if part == "curve":
        time = Field(("sample",), "s" if curve is None else curve.time_unit)
        return curve, {"time": time, **layout.CURVE_FIELDS}, layout.SAMPLE_SCALES
    if part == "shape":
        names = Field(("point",), layout.TEXT)
        return result.shape, {"names": names, **layout.SHAPE_FIELDS}, layout.SHAPE_SCALES
    if part == "bending":
        cloud = None if bending is None else bending.cloud
        return cloud, layout.CLOUD_FIELDS, layout.CLOUD_SCALES
    law = None if bending is None else bending.law
    return law, layout.LAW_FIELDS, layout.LAW_SCALES


def _of_record(record: object, fields: Mapping[str, Field], scales: Mapping[str, str]) -> Dataset:
    arrays = {name: np.asarray(getattr(record, name)) for name in fields}
    return _dataset(arrays, fields, scales)


def _dataset(
    arrays: Mapping[str, np.ndarray], fields: Mapping[str, Field], scales: Mapping[str, str]
) -> Dataset:
    """Make a Dataset whose dimensions have the names of the scales in a result file."""
    variables: dict[str, Any] = {}
    coordinates: dict[str, Any] = {}
    for name, values in arrays.items():
        axes = [
            scales.get(axis, axis) + ("_2" if axis in fields[name].axes[:place] else "")
            for place, axis in enumerate(fields[name].axes)
        ]
        variables[name] = (axes, values, {"units": fields[name].unit})
        for axis, dimension in zip(fields[name].axes, axes, strict=True):
            if axis in layout.COORDINATES:
                coordinates[dimension] = list(layout.COORDINATES[axis])
            if dimension.endswith("_2"):
                coordinates[dimension] = arrays[scales[axis]]
    dataset: Dataset = _xarray().Dataset(variables, coords=coordinates)
    return dataset


def _of_aligned(aligned: Aligned) -> Dataset:
    arrays = {
        "time": aligned.time,
        **{name: series.values for name, series in aligned.series.items()},
    }
    fields = {"time": Field(("sample",), aligned.time_unit)}
    fields |= {name: Field(("sample",), series.unit) for name, series in aligned.series.items()}
    return _dataset(arrays, fields, layout.SAMPLE_SCALES)


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
        name = layout.link_name(channel.name, variables)
        about = {"units": channel.unit or layout.NO_UNIT, "name_in_file": channel.path}
        variables[name] = ([of_clock[channel.clock]], channel.values, about)
    tracks = recording.markers
    if tracks is not None:
        frame = "time_markers" if recording.clocks else "time"
        variables[frame] = ([frame], tracks.time, {"units": "s"})
        variables["marker"] = (["marker"], list(tracks.names))
        variables["xyz"] = (["xyz"], list(layout.COORDINATES["xyz"]))
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
