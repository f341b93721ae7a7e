"""Write a force record as ControlDesk writes a .mat file (MAT v5, file format revision 2.1).

The layout is that of real exports: one struct with Info, X, Y and Description; channels told apart
by Path and Name; units empty; whole numbers stored as small integers; data as rows; the text header
names the time of saving. Origin says that the file is synthetic.
"""

from __future__ import annotations

from datetime import datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.io import savemat

from labpipe.records.arrays import Floats
from labpipe.virtual_lab.load_cell import PORT, ForceRecord, TriggeredRecord

VERSION = "7.4"
_RASTER = "HostService"
_HEADER_BYTES = 116
_NO_LIMIT = np.finfo(np.float64).max


def write_control_desk(
    path: Path, record: ForceRecord | TriggeredRecord, *, saved: datetime, seed: int
) -> None:
    """Write a force record.

    Parameters
    ----------
    path : the file; its stem becomes the name of the struct
    record : what the recorder measured
    saved : time for the header and the description
    seed : for the note that the file is synthetic
    """
    signals = record.signals
    axis = {
        "Name": "",
        "Type": np.int32(4),
        "Data": record.clock[None, :],
        "Unit": "",
        "Raster": _RASTER,
    }
    info = {
        "RevisionMajor": np.int32(2),
        "RevisionMinor": np.int32(1),
        "MeasurementID": np.int32(1),
    }
    rows = [_channel(where, signals[where]) for where in sorted(signals)]
    content = {
        "Info": info,
        "X": axis,
        "Y": _struct_array(rows),
        "Description": _description(record, saved, seed),
    }
    savemat(path, {path.stem: content}, oned_as="row", long_field_names=True)
    _stamp(path, saved)


def _channel(where: str, values: Floats) -> dict[str, object]:
    return {
        "Name": PORT,
        "Type": np.int32(4),
        "Data": _compact(values)[None, :],
        "Unit": "",
        "Raster": _RASTER,
        "Device": "Platform",
        "XIndex": np.int32(1),
        "DownSampling": np.int32(1),
        "Description": "",
        "DisplayIdentifier": "",
        "Path": where,
        "Flags": np.int32(2),
        "Min": -_NO_LIMIT,
        "Max": _NO_LIMIT,
        "MinWeak": -_NO_LIMIT,
        "MaxWeak": _NO_LIMIT,
    }


def _compact(values: Floats) -> NDArray[np.generic]:
    """Whole numbers as the smallest unsigned integers that hold them, as ControlDesk does."""
    whole = bool(np.all(values == np.floor(values)) and np.all(values >= 0.0))
    if not whole or np.max(values) > np.iinfo(np.uint16).max:
        return values
    small = np.max(values) <= np.iinfo(np.uint8).max
    return values.astype(np.uint8 if small else np.uint16)


def _struct_array(rows: list[dict[str, object]]) -> NDArray[np.void]:
    array = np.empty((1, len(rows)), dtype=[(name, object) for name in rows[0]])
    for number, row in enumerate(rows):
        for name, value in row.items():
            array[name][0, number] = value
    return array


def _description(
    record: ForceRecord | TriggeredRecord, saved: datetime, seed: int
) -> dict[str, object]:
    origin = (
        f"Software revision: virtual_lab.sdf\r\n"
        f"Variable description: virtual_lab.sdf\r\n"
        f"    Platform / Device: Platform [SYNTHETIC: made by labpipe's virtual lab, seed {seed}, "
        f"not a measurement]\r\n"
        f"ControlDesk version: {VERSION}"
    )
    return {
        "General": {
            "User": "labpipe virtual lab",
            "DateTime": f"{saved:%Y/%m/%d %H:%M:%S}",
            "Origin": origin,
            "Description": "synthetic",
        },
        "Recording": {"StartCondition": "None (Immediate Recording)", "StopCondition": "None"},
        "Measurement": {
            "XAxisOffset": np.uint8(0),
            "Length": float(record.clock[-1]),
            "StartTimestamp": float(record.clock[0]),
            "StopTimestamp": float(record.clock[-1]),
        },
    }


def _stamp(path: Path, saved: datetime) -> None:
    """Put the scenario's date into the text header, so that equal tests are equal files."""
    text = f"MATLAB 5.0 MAT-file, Platform: PCWIN, Created on: {saved:%a %b %d %H:%M:%S %Y}"
    with path.open("r+b") as file:
        file.write(text.encode("ascii").ljust(_HEADER_BYTES))
