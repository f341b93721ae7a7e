"""Write synthetic ControlDesk exports: MAT v5 and v7.3, CSV, MF4. No instrument made them."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

ORIGIN = "Software revision: synthetic.sdf\r\nControlDesk version: 7.4"
HEADER_V73 = "MATLAB 7.3 MAT-file, Platform: PCWIN64, Created on: Wed Mar 04 10:00:00 2026 HDF5"
DATE_TIME = "4/3/2026 9:58:00"
Array = NDArray[Any]


@dataclass(frozen=True, slots=True, eq=False)
class Axis:
    time: Array
    raster: str = "HostService"
    unit: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Signal:
    path: str
    name: str
    values: Array
    axis: int = 1
    unit: str = ""
    invalid: Array | None = None
    """Flags of invalid samples (MF4 only)."""


def write_mat_v5(
    path: Path, axes: Sequence[Axis], signals: Sequence[Signal], *, revision: str = "2.1"
) -> Path:
    from scipy.io import savemat

    x = [_axis_fields(axis, revision, (1, -1)) for axis in axes]
    y = [_signal_fields(signal, axes, revision, (1, -1)) for signal in signals]
    content = {"X": _struct_array(x), "Y": _struct_array(y), **_about(revision)}
    savemat(path, {"recording": content}, appendmat=False)
    return path


def write_mat_v73(path: Path, axes: Sequence[Axis], signals: Sequence[Signal]) -> Path:
    import h5py

    with h5py.File(path, "w", userblock_size=512) as file:
        group = _group(file, "recording")
        x = [_axis_fields(axis, "2.1", (-1, 1)) for axis in axes]
        y = [_signal_fields(signal, axes, "2.1", (-1, 1)) for signal in signals]
        _write_structs(file, _group(group, "X"), x)
        _write_structs(file, _group(group, "Y"), y)
        for key, fields in _about("2.1").items():
            _write_fields(_group(group, key), fields)
    with path.open("r+b") as stream:
        stream.write(HEADER_V73.encode().ljust(124) + b"\x00\x02IM")
    return path


def write_csv(
    path: Path,
    axis: Axis,
    signals: Sequence[Signal],
    *,
    stated: int | None = None,
    line_end: str = "\r\n",
) -> Path:
    quoted = ORIGIN.replace("\r\n", "\\n")
    lines = [
        "descriptions,General,User,synthetic",
        ",General,DateTime,03/04/2026 9:58:00 a. m.",
        f',General,Origin,"{quoted}"',
        ",Measurement,StartTimestamp,0",
        ",Measurement,ReferenceTime,1775210280000000000",
        "",
        f"trace_size,{len(axis.time) if stated is None else stated}",
        ",".join(["trace_names", "", *(s.name for s in signals)]),
        ",".join(["trace_units", axis.unit, *(s.unit for s in signals)]),
        ",".join(["raster", *[axis.raster] * (len(signals) + 1)]),
        ",".join(["path", "", *(s.path for s in signals)]),
        ",".join(["min", "", *["-Infinity"] * len(signals)]),
    ]
    table = np.column_stack([axis.time, *(s.values for s in signals)])
    rows = [",".join(["", *(_cell(value) for value in row)]) for row in table]
    body = "trace_values" + line_end.join(rows)
    path.write_bytes((line_end.join([*lines, body]) + line_end).encode())
    return path


def write_mf4(path: Path, axis: Axis, signals: Sequence[Signal]) -> Path:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import asammdf

        file = asammdf.MDF(version="4.10")
        file.append(
            [
                asammdf.Signal(
                    samples=np.asarray(s.values, dtype=np.float64),
                    timestamps=axis.time,
                    name=f"{s.path}/{s.name}",
                    unit=s.unit,
                    invalidation_bits=s.invalid,
                )
                for s in signals
            ]
        )
        file.header.comment = (
            "<HDcomment><TX/><common_properties>"
            f'<e name="Origin">{ORIGIN}</e><e name="StartTimestamp">{axis.time[0]}</e>'
            "</common_properties></HDcomment>"
        )
        file.save(path, overwrite=True)
        file.close()
    return path


def _cell(value: float) -> str:
    if np.isnan(value):
        return ""
    return ("-" if value < 0 else "") + "Infinity" if np.isinf(value) else repr(float(value))


def _about(revision: str) -> dict[str, Any]:
    if revision == "2.0":
        version = "ControlDesk MATLAB File Format Revision 2.0"
        return {
            "Description": {"GeneratorVersion": version, "Author": ""},
            "Capture": {"DateTime": DATE_TIME, "SamplingPeriod": 0.025, "TriggerDelay": -1},
        }
    major, minor = (np.int32(part) for part in revision.split("."))
    return {
        "Info": {"RevisionMajor": major, "RevisionMinor": minor},
        "Description": {
            "General": {"User": "synthetic", "DateTime": DATE_TIME, "Origin": ORIGIN},
            "Measurement": {"XAxisOffset": 0.0},
        },
    }


def _axis_fields(axis: Axis, revision: str, shape: tuple[int, int]) -> dict[str, Any]:
    fields = {"Name": "", "Type": np.int32(4), "Data": axis.time.reshape(shape), "Unit": axis.unit}
    return fields if revision == "2.0" else {**fields, "Raster": axis.raster}


def _signal_fields(
    signal: Signal, axes: Sequence[Axis], revision: str, shape: tuple[int, int]
) -> dict[str, Any]:
    fields = {
        "Name": signal.name,
        "Type": np.int32(5),
        "Data": np.asarray(signal.values).reshape(shape),
        "Unit": signal.unit,
        "XIndex": np.int32(signal.axis),
    }
    if revision == "2.0":
        return fields
    raster = axes[min(max(signal.axis, 1), len(axes)) - 1].raster
    more = {"Raster": raster, "Path": signal.path, "DownSampling": np.int32(1), "Min": -np.inf}
    return {**fields, **more}


def _struct_array(items: Sequence[dict[str, Any]]) -> Array:
    array = np.empty((1, len(items)), dtype=[(key, object) for key in items[0]])
    for i, item in enumerate(items):
        for key, value in item.items():
            array[0, i][key] = value
    return array


def _group(parent: Any, name: str) -> Any:
    group = parent.create_group(name)
    group.attrs["MATLAB_class"] = np.bytes_("struct")
    return group


def _write_structs(file: Any, group: Any, items: Sequence[dict[str, Any]]) -> None:
    """One struct: plain data sets. Several: data sets of object references."""
    import h5py

    if len(items) == 1:
        _write_fields(group, items[0])
        return
    references = file.require_group("#refs#")
    for key in items[0]:
        table = group.create_dataset(key, (len(items), 1), dtype=h5py.ref_dtype)
        for i, item in enumerate(items):
            data = _write_value(references, f"r{len(references)}", item[key])
            table[i, 0] = data.ref


def _write_fields(group: Any, fields: dict[str, Any]) -> None:
    for key, value in fields.items():
        if isinstance(value, dict):
            _write_fields(_group(group, key), value)
        else:
            _write_value(group, key, value)


def _write_value(group: Any, key: str, value: Any) -> Any:
    if not isinstance(value, str):
        data = np.atleast_2d(value)
        packed = {"compression": "gzip"} if data.size > 1 else {}
        item = group.create_dataset(key, data=data, **packed)
        item.attrs["MATLAB_class"] = np.bytes_("double")
        return item
    if value:
        units = np.frombuffer(value.encode("utf-16-le"), dtype="<u2")
        item = group.create_dataset(key, data=units.reshape(-1, 1))
    else:
        item = group.create_dataset(key, data=np.zeros(2, dtype=np.uint64))
        item.attrs["MATLAB_empty"] = np.uint8(1)
    item.attrs["MATLAB_class"] = np.bytes_("char")
    return item
