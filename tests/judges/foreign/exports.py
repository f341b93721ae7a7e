"""Files as labs have them: MTS TestSuite, testXpert TRA, ControlDesk MAT v5, Motive 1.23.

Written from the layouts of public exports. Every file says in its head that it is synthetic.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Columns = Sequence[tuple[str, str, Array]]
"""Name, unit, values in that unit."""


def _single(value: float) -> str:
    """A float32 written as a double, as MTS does."""
    return format(float(np.float32(value)), ".15g")


def write_mts(path: Path, columns: Columns, *, quoted: bool = False) -> None:
    """TestSuite, `DAQ- Crosshead, ... - (Timed)`: csv with every cell quoted, or txt with tabs."""
    head = [
        r"File Path: C:\Synthetic\Test Run 7\DAQ- Crosshead, … - (Timed).txt   ",
        "Test: Synthetic",
        "Test Run: Test Run 7",
        "Date: 3/14/2026 2:05:11 PM",
        "",
        "",
    ]
    rows = [[f"{name} " for name, _, _ in columns], [unit for _, unit, _ in columns]]
    rows += [[_single(v) for v in row] for row in zip(*(c for *_, c in columns), strict=True)]
    if quoted:
        lines = [f'"{line}"' for line in head]
        lines += [",".join(f'"{cell}"' for cell in row) for row in rows]
    else:
        lines = head + ["\t".join(row) for row in rows]
    path.write_bytes(("\r\n".join(lines) + "\r\n").encode("utf-8-sig"))


def write_tra(path: Path, columns: Columns) -> None:
    """German testXpert text: parameters, quoted names, quoted units, samples parted by tabs."""
    head = [
        '"aktuelle Probe"\t"synthetisch"',
        '"Prüfgeschwindigkeit"\t12\t"mm/min"',
        '"Kraftmaximum"\t"nicht bekannt"',
        '"Datum"\t"14.03.2026"',
    ]
    names = ["\t".join(f'"{cell[i]}"' for cell in columns) for i in (0, 1)]
    table = np.column_stack([values for *_, values in columns])
    body = ["\t".join(f"{value:.6g}" for value in row) for row in table]
    path.write_bytes(("\n".join([*head, *names, *body]) + "\n").encode("latin-1"))


def write_mat(path: Path, time: Array, signals: Mapping[str, Array]) -> None:
    """ControlDesk MAT v5, revision 2.1; signals of 32 bits by `path/name`, units empty."""
    from scipy.io import savemat

    y = [_struct(full, values) for full, values in signals.items()]
    names = list(y[0])
    table = np.empty((1, len(y)), dtype=[(name, object) for name in names])
    for column, fields in enumerate(y):
        table[0, column] = tuple(fields[name] for name in names)
    axis = {
        "Name": "",
        "Type": np.int32(4),
        "Data": time[None, :],
        "Unit": "",
        "Raster": "HostService",
    }
    said = {"User": "synthetic", "DateTime": "14-3-2026 14:05:11", "Origin": "synthetic model"}
    measured = {"XAxisOffset": 0.0, "Length": float(time[-1]), "StartTimestamp": 0.0}
    content = {
        "Info": {"RevisionMajor": np.int32(2), "RevisionMinor": np.int32(1), "MeasurementID": "1"},
        "X": axis,
        "Y": table,
        "Description": {"General": said, "Measurement": measured},
    }
    savemat(path, {path.stem: content}, appendmat=False)


def _struct(full: str, values: Array) -> dict[str, Any]:
    where, name = full.rsplit("/", 1)
    most = np.finfo(np.float64).max
    limits = {"Min": -most, "Max": most, "MinWeak": -most, "MaxWeak": most}
    return {
        "Name": name,
        "Type": np.int32(4),
        "Data": values.astype(np.float32).astype(np.float64)[None, :],
        "Unit": "",
        "Raster": "HostService",
        "Device": "Platform",
        "XIndex": np.int32(1),
        "DownSampling": np.int32(1),
        "Description": "",
        "DisplayIdentifier": "",
        "Path": where,
        "Flags": np.int32(2),
        **limits,
    }


def write_motive(
    path: Path, rate: float, body: Array | None, markers: Mapping[str, Array], turn: Array
) -> None:
    """Motive table 1.23 in metres.

    Parameters
    ----------
    body : shape (frames, 3), m, pivot of the rigid body `Clamp`; None without one
    markers : by name, shape (frames, 3), m
    turn : quaternion x, y, z, w of the body
    """
    frames = len(next(iter(markers.values())))
    keys = {
        "Format Version": "1.23",
        "Take Name": "synthetic take",
        "Take Notes": "",
        "Capture Frame Rate": f"{rate:.6f}",
        "Export Frame Rate": f"{rate:.6f}",
        "Capture Start Time": "2026-03-14 02.05.09.118 PM",
        "Total Frames in Take": str(frames),
        "Total Exported Frames": str(frames),
        "Rotation Type": "Quaternion",
        "Length Units": "Meters",
        "Coordinate Space": "Global",
    }
    types, names, ids, kinds, axes, parts = [], [], [], [], [], []
    if body is not None:
        types += ["Rigid Body"] * 7
        names += ["Clamp"] * 7
        ids += ['"22A75B1D441211EF92AE9699928D7189"'] * 7
        kinds += ["Rotation"] * 4 + ["Position"] * 3
        axes += list("XYZWXYZ")
        parts += [np.tile(turn, (frames, 1)), body]
    for number, (name, positions) in enumerate(markers.items()):
        types += ["Marker"] * 3
        names += [name] * 3
        ids += [f'"{number + 0xC3500:X}"'] * 3
        kinds += ["Position"] * 3
        axes += list("XYZ")
        parts.append(positions)
    table = np.column_stack(parts)
    lines = [",".join(f"{key},{value}" for key, value in keys.items()), ""]
    lines += [",".join(["", *row]) for row in (["Type", *types], ["Name", *names], ["ID", *ids])]
    lines += [",".join(["", "", *kinds]), ",".join(["Frame", "Time (Seconds)", *axes])]
    form = ",".join(["%d", "%.6f", *["%.6f"] * table.shape[1]])
    index = np.arange(frames)
    lines += [form % tuple(row) for row in np.column_stack([index, index / rate, table])]
    path.write_text("\r\n".join(lines) + "\r\n", encoding="utf-8", newline="")


def write_sheet(folder: Path, sheet: Mapping[str, Any]) -> None:
    """The test.yaml that a lab writes beside its exports."""
    import json

    text = "".join(f"{key}: {json.dumps(value)}\n" for key, value in sheet.items())
    (folder / "test.yaml").write_text("# synthetic, no machine made it\n" + text, encoding="utf-8")
