"""Write the files of a virtual test: exports in the vendors' formats, test sheet, true values.

**ControlDesk** (force recorder): a .mat file, MAT v5, file format revision 2.1, with one struct of
Info, X, Y and Description. Channels are identified by Path and Name, units are empty, data are row
vectors, and whole numbers are stored as small integers. The text header states the time of saving.

**Motive** (cameras): a table CSV, Format Version 1.23, with CRLF line ends. A line of keys and
values and a blank line are followed by rows of types, names, ids, quantities and axes, and by the
data with six decimals; cells of untracked markers are blank. The fitted markers of the body (Rigid
Body Marker, names in quotes) are in addition to the measured markers of the same names (Marker, no
quotes).

**MTS TestSuite** (load frame): ``(Timed)`` text, UTF-8 with byte order mark, CRLF line ends. Four
lines of preamble and two blank lines are followed by names with a trailing blank. Numbers are
32-bit SI numbers, converted to the unit of the column. Several acquisition steps give several
files, not numbered in the order of time; the file of a step without samples has only a byte order
mark.

**TestResources R-Controller** (load frame): a workbook with time (s), force (lbf) and travel (in).
No real export was available. The quantities and their units are from [1]_, and the name of the
sheet, the names of the columns and the rows above them are assumed.

Every file states that it is synthetic. The test sheet states the nominal gain of the load cell, not
the true one. It overrides the shipped protocol only where the virtual rig differs from it.

``truth.json`` has the true values in SI units, with frames, signs and clocks as in the modules of
the rigs. The processing never reads ``truth.json``.

References
----------
.. [1] *Modeling and characterization of wire harnesses for digital manufacturing applications*,
       dissertation.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import date, datetime, timedelta
from functools import cache
from math import degrees
from pathlib import Path
from typing import Any, Generic, TypeAlias, TypeVar

import numpy as np
import yaml
from numpy.typing import NDArray
from scipy.io import savemat
from xlsxwriter import Workbook

from labpipe.protocol.load import find_shipped_folder
from labpipe.records.arrays import Floats
from labpipe.store.replace import map_errors
from labpipe.virtual_lab.cantilever_scenarios import CantileverScenario, Truth
from labpipe.virtual_lab.instruments import (
    BODY_MARKERS,
    PORT,
    ForceRecord,
    FrameRecord,
    Take,
    TensionRecord,
    round_to_single,
)
from labpipe.virtual_lab.specimens import WIRES
from labpipe.virtual_lab.tensile import MetalTension, TensileScenario
from labpipe.virtual_lab.three_point import ConduitScenario

Scenario: TypeAlias = CantileverScenario | ConduitScenario | TensileScenario | MetalTension
"""Scenario of a virtual test of any kind."""
S = TypeVar("S", bound=Scenario)

SHEET_FILE, TRUTH_FILE, WIRE_SHEET_FILE = "test.yaml", "truth.json", "wires.csv"
_SHEET_COMMENT = (
    "# A synthetic test, made by labpipe's virtual lab. Its true values are in truth.json.\n"
)
_NEWTONS = {"N": 1.0, "kN": 1e3, "lbf": 4.4482216152605}
"""Factor from each force unit of exports to N."""
_METRES_PER_INCH = 0.0254


@dataclass(frozen=True, slots=True, eq=False)
class Observation(Generic[S]):
    """Records of the instruments in a virtual test, and true values.

    Parameters
    ----------
    scenario : scenario of the test
    seed : seed of noise, gain and mishaps
    records : record of each role in the test sheet: ``force`` (`ForceRecord`), ``markers``
        (`Take`) and ``frame`` (`FrameRecord` or `TensionRecord`)
    truth : true values, as in ``truth.json``
    """

    scenario: S
    seed: int
    records: Mapping[str, Any]
    truth: Truth


def observe(scenario: S, seed: int) -> Observation[S]:
    """Run a virtual test without writing files.

    Parameters
    ----------
    scenario : scenario of the test
    seed : seed of noise, gain and mishaps; the mechanics do not depend on it

    Returns
    -------
    Records and true values. Bending tests with equal mechanics share one solution, so that only the
    first one takes seconds.

    Raises
    ------
    ValueError
        If the mechanics have no solution, or a tensile test has fewer than three samples.
    IndexError
        If a mishap names a marker that does not exist.
    """
    return Observation(scenario, seed, *scenario.record(seed))


def simulate_test(scenario: Scenario, folder: Path, seed: int) -> Path:
    """Run a virtual test and write its exports, test sheet and true values.

    Parameters
    ----------
    scenario : scenario of the test
    folder : folder of this test; created if it does not exist; files of the same names are replaced
    seed : seed of noise, gain and mishaps; equal seeds give equal files

    Returns
    -------
    The folder.

    Raises
    ------
    ValueError
        If the mechanics have no solution, or a tensile test has fewer than three samples.
    StoreError
        If the files cannot be written.
    """
    observation = observe(scenario, seed)
    run = Run(scenario.name, datetime.fromisoformat(f"{scenario.date}T10:05:00"), seed)
    truth = {"synthetic": True, "seed": seed, "scenario": asdict(scenario), **observation.truth}
    with map_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
        files = {}
        for role, record in observation.records.items():
            files[role] = _WRITERS[type(record)](folder, record, run)
        (folder / SHEET_FILE).write_text(format_sheet(scenario, files), encoding="utf-8")
        truth_text = json.dumps(truth, default=lambda array: np.round(array, 12).tolist())
        (folder / TRUTH_FILE).write_text(f"{truth_text}\n", encoding="utf-8")
    return folder


def format_sheet(scenario: Scenario, files: Mapping[str, Sequence[str]]) -> str:
    """Format the test sheet.

    Parameters
    ----------
    scenario : scenario of the test
    files : names of the exports, keyed by role

    Returns
    -------
    The text of ``test.yaml``.
    """
    specimen = {
        "type": scenario.specimen_type,
        "spool": scenario.spool,
        "sample": scenario.sample,
        **scenario.describe_specimen(),
    }
    overrides = {}
    for key, value, reason in scenario.list_settings():
        sheet_value = _format_lengths(value)
        if sheet_value != _find_protocol_value(scenario.protocol, key):
            overrides[key] = {"value": sheet_value, "because": reason}
    sheet = {
        "test": scenario.name,
        "protocol": scenario.protocol,
        "specimen": _format_lengths(specimen),
        "date": date.fromisoformat(scenario.date),
        "operator": "virtual lab",
        "files": {role: names[0] if len(names) == 1 else [*names] for role, names in files.items()},
        **({"overrides": overrides} if overrides else {}),
    }
    return _SHEET_COMMENT + yaml.safe_dump(
        sheet, sort_keys=False, allow_unicode=True, default_flow_style=None, width=200
    )


def _format_lengths(value: object) -> object:
    """Format floats, which are lengths in m, as texts in mm, in a value or in a block of values."""
    if isinstance(value, dict):
        return {key: _format_lengths(entry) for key, entry in value.items()}
    return f"{1e3 * value:.10g} mm" if isinstance(value, float) else value


@cache
def _read_protocol(name: str) -> Any:
    """Read a shipped protocol as plain values."""
    path = find_shipped_folder("protocols") / f"{name}.yaml"
    return yaml.safe_load(path.read_text(encoding="utf-8"))


def _find_protocol_value(protocol: str, dotted_key: str) -> object:
    """Find the value of a dotted key in a shipped protocol; None if the key is absent."""
    value = _read_protocol(protocol)
    for key in dotted_key.split("."):
        value = value.get(key) if isinstance(value, dict) else None
    return value


def write_wire_sheet(folder: Path) -> Path:
    """Write the sheet of the virtual wires for `labpipe model` and `labpipe calibrate`.

    The sheet states dimensions and layout of the strands, but no friction, which a calibration
    identifies.

    Parameters
    ----------
    folder : folder of the sheet; created if it does not exist

    Returns
    -------
    Path of the sheet, which has a row for each of `virtual_lab.specimens.WIRES`.
    """
    rows = [
        {
            "wire": wire.name,
            "wire_diameter_mm": f"{1e3 * wire.diameter:.6g}",
            "strands": wire.n_strands,
            "strand_diameter_mm": f"{1e3 * wire.strand:.9g}",
            "lay_angles_deg": ";".join(f"{degrees(angle):.6g}" for angle in wire.lay_angles),
            "insulation_thickness_mm": f"{1e3 * wire.wall:.6g}",
            "layout": "compressed" if wire.is_compressed else "hexagonal",
        }
        for wire in WIRES.values()
    ]
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / WIRE_SHEET_FILE
    with path.open("w", encoding="utf-8", newline="") as file:
        sheet = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        sheet.writeheader()
        sheet.writerows(rows)
    return path


@dataclass(frozen=True, slots=True)
class Run:
    """Virtual test, as the headers of its exports describe it.

    Parameters
    ----------
    name : name of the test
    start_time : date and time of the start of the test
    seed : seed of the test
    """

    name: str
    start_time: datetime
    seed: int

    @property
    def note(self) -> str:
        """Return a note that the test is synthetic."""
        return f"SYNTHETIC: made by labpipe's virtual lab, seed {self.seed}, not a measurement"


def write_control_desk(folder: Path, record: ForceRecord, run: Run) -> tuple[str, ...]:
    """Write a force record as ControlDesk does.

    Parameters
    ----------
    folder : folder of the file
    record : samples of the force recorder
    run : test for the header and the description; the stated time of saving is that of the last
        sample

    Returns
    -------
    Name of the file; its stem is the name of the struct.
    """
    times = record.clock_times
    saving_time = run.start_time + timedelta(seconds=round(float(times[-1])))
    max_value = np.finfo(np.float64).max
    int1, int2, data_type = np.int32(1), np.int32(2), np.int32(4)
    raster = "HostService"
    fields = "Name Type Data Unit Raster Device XIndex DownSampling Description DisplayIdentifier"
    fields += " Path Flags Min Max MinWeak MaxWeak"
    channels = []
    for path, values in sorted(record.signals.items()):
        data = _compact_integers(values)[None, :]
        cells = (PORT, data_type, data, "", raster, "Platform", int1, int1, "", "", path, int2)
        channels.append((*cells, -max_value, max_value, -max_value, max_value))
    origin = (
        "Software revision: virtual_lab.sdf\r\nVariable description: virtual_lab.sdf\r\n"
        f"    Platform / Device: Platform [{run.note}]\r\nControlDesk version: 7.4"
    )
    content = {
        "Info": {"RevisionMajor": int2, "RevisionMinor": int1, "MeasurementID": int1},
        "X": {"Name": "", "Type": data_type, "Data": times[None, :], "Unit": "", "Raster": raster},
        "Y": np.array([channels], dtype=[(field, object) for field in fields.split()]),
        "Description": {
            "General": {
                "User": "labpipe virtual lab",
                "DateTime": f"{saving_time:%Y/%m/%d %H:%M:%S}",
                "Origin": origin,
                "Description": "synthetic",
            },
            "Recording": {"StartCondition": "None (Immediate Recording)", "StopCondition": "None"},
            "Measurement": {
                "XAxisOffset": np.uint8(0),
                "Length": float(times[-1]),
                "StartTimestamp": float(times[0]),
                "StopTimestamp": float(times[-1]),
            },
        },
    }
    file_path = folder / "force.mat"
    savemat(file_path, {file_path.stem: content}, oned_as="row", long_field_names=True)
    # The header of SciPy states the present time. It is replaced, so that equal tests give equal
    # files.
    header = f"MATLAB 5.0 MAT-file, Platform: PCWIN, Created on: {saving_time:%a %b %d %H:%M:%S %Y}"
    with file_path.open("r+b") as file:
        file.write(header.encode("ascii").ljust(116))
    return (file_path.name,)


def _compact_integers(values: Floats) -> NDArray[np.generic]:
    """Convert values to the smallest unsigned integers of up to 16 bits, if that is exact."""
    is_whole = bool(np.all(values == np.floor(values)) and np.all(values >= 0.0))
    if not is_whole or np.max(values) > np.iinfo(np.uint16).max:
        return values
    return values.astype(np.min_scalar_type(int(np.max(values))))


def write_motive(folder: Path, take: Take, run: Run) -> tuple[str, ...]:
    """Write a take as Motive does.

    Parameters
    ----------
    folder : folder of the file
    take : take of the cameras
    run : test for the header; the seed also determines the ids

    Returns
    -------
    Name of the file.
    """
    n_block_rows = 2000  # number of rows that are formatted at a time
    units = {"m": ("Meters", 1.0), "cm": ("Centimeters", 100.0), "mm": ("Millimeters", 1000.0)}
    unit, factor = units[take.length_unit]
    n_frames = str(len(take.time))
    header = {
        "Format Version": "1.23",
        "Take Name": run.name,
        "Take Notes": f"synthetic: made by labpipe's virtual lab with seed {run.seed}",
        "Capture Frame Rate": f"{take.rate:.6f}",
        "Export Frame Rate": f"{take.rate:.6f}",
        "Capture Start Time": f"{run.start_time:%Y-%m-%d %I.%M.%S}.000 {run.start_time:%p}",
        "Total Frames in Take": n_frames,
        "Total Exported Frames": n_frames,
        "Rotation Type": "Quaternion",
        "Length Units": unit,
        "Coordinate Space": "Global",
    }
    headings, table = _build_motive_columns(take, factor, np.random.default_rng([run.seed, 77]))
    header_lines = [",".join(f"{key},{value}" for key, value in header.items()), ""]
    header_lines += [",".join(row) for row in zip(*headings, strict=True)]
    row_format = "%d" + ",%.6f" * table.shape[1] + "\r\n"
    with (folder / "take.csv").open("w", encoding="ascii", newline="") as file:
        file.write("".join(line + "\r\n" for line in header_lines))
        for start in range(0, len(table), n_block_rows):
            block = table[start : start + n_block_rows].tolist()
            rows = (row_format % (frame, *values) for frame, values in enumerate(block, start))
            file.write("".join(rows).replace("nan", ""))
    return ("take.csv",)


def _build_motive_columns(
    take: Take, factor: float, random: np.random.Generator
) -> tuple[list[tuple[str, ...]], Floats]:
    """Build the headings (type, name, id, quantity, axis) of all columns, and the table of values.

    The frame number has a heading, but no column in the table.
    """
    position_columns = [("Position", axis) for axis in "XYZ"]
    rotation_columns = [("Rotation", axis) for axis in "XYZW"]
    blocks: list[tuple[str, str, str, list[tuple[str, str]]]] = []
    data = [take.time[:, None]]
    for body in take.bodies:
        body_id = f'"{random.bytes(16).hex().upper()}"'
        body_columns = [*rotation_columns, *position_columns, ("Mean Marker Error", "")]
        blocks.append(("Rigid Body", body.name, body_id, body_columns))
        data += [body.rotation, body.position * factor, body.error[:, None] * factor]
        marker_columns = [*position_columns, ("Marker Quality", "")]
        for marker_number in range(1, len(BODY_MARKERS) + 1):
            label = f'"{body.name}:Marker{marker_number}"'
            blocks.append(("Rigid Body Marker", label, body_id, marker_columns))
    for label in take.labels:
        blocks.append(("Marker", label, f'"{random.bytes(3).hex().upper()}"', position_columns))
    fitted = np.dstack([take.fitted_positions * factor, take.marker_quality])
    data += [values.reshape(len(take.time), -1) for values in (fitted, take.positions * factor)]
    first_headings = [("", "", "", "", "Frame"), ("Type", "Name", "ID", "", "Time (Seconds)")]
    headings = [(*block, *column) for *block, columns in blocks for column in columns]
    return [*first_headings, *headings], np.hstack(data)


def write_frame(folder: Path, record: FrameRecord, run: Run) -> tuple[str, ...]:
    """Write a record of a load frame in the format of its controller.

    Parameters
    ----------
    folder : folder of the files
    record : record of the controller
    run : test for the headers

    Returns
    -------
    Names of the files; those of TestSuite are in the order of their numbers.
    """
    if record.layout.force_unit == "lbf":
        return _write_r_controller(folder, record, run)
    steps: list[slice | None] = [slice(None)]
    if record.layout.part_at is not None:
        n_missing_rows = 2
        n_first_step = int(np.searchsorted(record.time, record.layout.part_at))
        # The second step comes first; the last step has no samples.
        steps = [slice(n_first_step + n_missing_rows, None), slice(n_first_step), None]
    file_names = []
    for file_number, step in enumerate(steps):
        file_name = f"DAQ- Crosshead, … - (Timed){file_number or ''}.txt"
        file_names.append(file_name)
        text = "" if step is None else _format_test_suite(file_name, record, step, run)
        (folder / file_name).write_bytes(text.encode("utf-8-sig"))
    return tuple(file_names)


def _format_test_suite(file_name: str, record: FrameRecord, step: slice, run: Run) -> str:
    """Format the preamble and the rows of an acquisition step."""
    start, force_unit = run.start_time, record.layout.force_unit
    time_of_day = f"{(start.hour - 1) % 12 + 1}:{start:%M:%S %p}"
    columns = (
        1e3 * round_to_single(record.displacement[step]),
        round_to_single(record.force[step]) / _NEWTONS[force_unit],
        round_to_single(record.time[step]),
    )
    lines = [
        f"File Path: C:\\MTS Data\\SYNTHETIC labpipe virtual lab\\{run.name}\\{file_name}   ",
        f"Test: SYNTHETIC {record.test_type}, labpipe virtual lab, seed {run.seed}",
        f"Test Run: {run.name}",
        f"Date: {start.month}/{start.day}/{start.year} {time_of_day}",
        "",
        "",
        "Crosshead \tLoad \tTime ",
        f"mm\t{force_unit}\tsec",
        *("\t".join(f"{value:.15G}" for value in row) for row in np.transpose(columns).tolist()),
    ]
    return "".join(line + "\r\n" for line in lines)


def _write_r_controller(folder: Path, record: FrameRecord, run: Run) -> tuple[str, ...]:
    """Write a record as a workbook of TestResources; equal records give equal bytes."""
    force = record.force / _NEWTONS["lbf"]
    rows = np.column_stack([record.time, force, record.displacement / _METRES_PER_INCH])
    header_rows = [
        (run.note,),
        ("Test", run.name),
        ("Date", f"{run.start_time:%m/%d/%Y %H:%M:%S}"),
        (),
        ("Time (s)", "Force (lbf)", "Displacement (in)"),
    ]
    properties = {"title": run.name, "comments": run.note, "author": "labpipe virtual lab"}
    with Workbook(folder / f"{run.name}.xlsx", {"in_memory": True}) as book:
        book.set_properties({**properties, "created": run.start_time})
        sheet = book.add_worksheet("Test Data")
        for row, cells in enumerate([*header_rows, *(rows.round(6) + 0.0).tolist()]):
            sheet.write_row(row, 0, cells)
    return (f"{run.name}.xlsx",)


def write_tension(folder: Path, record: TensionRecord, run: Run) -> tuple[str, ...]:
    """Write the record of a tension test as CSV with a row of units; NaN is an empty cell."""
    columns = (record.time, 1e-3 * record.force, 1e3 * record.travel, 1e3 * record.extension)
    rows = np.column_stack(columns).tolist()
    lines = [
        run.note,
        "Time,Force,Crosshead,Extensometer",
        "s,kN,mm,mm",
        *(",".join("" if np.isnan(value) else f"{value:.7g}" for value in row) for row in rows),
    ]
    (folder / "tension.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return ("tension.csv",)


_WRITERS: Mapping[type, Callable[[Path, Any, Run], tuple[str, ...]]] = {
    ForceRecord: write_control_desk,
    Take: write_motive,
    FrameRecord: write_frame,
    TensionRecord: write_tension,
}
"""Function that writes an export, keyed by the type of the record."""
