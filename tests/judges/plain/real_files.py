"""The real exports, opened with pandas and h5py alone: which columns of which rows are a test."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from tests.judges.plain.definitions import (
    USUAL,
    Asked,
    Plain,
    Record,
    Samples,
    either,
    excused,
    filtered,
    plain_numbers,
)
from tests.judges.plain.judge import Expected

NEWTON = {"N": 1.0, "kN": 1e3, "mN": 1e-3, "lbf": 4.4482216152605}
METRE = {"mm": 1e-3, "um": 1e-6, "in": 0.0254}


@dataclass(frozen=True)
class Columns:
    """Where time, travel and force stand in a table of text, counted from 0."""

    travel: int
    force: int
    time: int | None = None
    skip: int = 1
    """Lines before the first sample."""
    last: int | None = None
    """Number of samples, if lines follow that are none."""
    separator: str = "\t"
    decimal: str = "."
    encoding: str = "utf-8-sig"
    sheet: str = ""
    """Of a workbook."""


@dataclass(frozen=True)
class Real:
    """One test: its files, where its numbers stand, and what labpipe is asked by YAML."""

    files: tuple[str, ...]
    columns: Columns
    force: str
    """Name of the channel in the export."""
    travel: str
    units: tuple[str, str] = ("N", "mm")
    minutes: bool = False
    asked: Asked = USUAL
    hurt: Mapping[str, str] = field(default_factory=dict)
    sign_free: bool = False
    refusal: str = ""
    part: str = ""
    since: float = 0.0
    """s, from which on the file holds the test; before that its operator set zeros."""


def read(real: Real, root: Path) -> Record:
    """Rows of all files in the order of their times; NaN where a cell is blank."""
    tables = [_table(root / name, real.columns) for name in real.files if _filled(root / name)]
    table = np.concatenate(sorted(tables, key=lambda table: float(table[0, -1])))
    time = None if real.columns.time is None else table[:, 2] * (60.0 if real.minutes else 1.0)
    newton, metre = NEWTON[real.units[0]], METRE[real.units[1]]
    late = slice(0 if time is None else int(np.searchsorted(time, real.since)), None)
    kept = None if time is None else time[late]
    return Record(kept, metre * table[late, 0], newton * table[late, 1])


def _filled(path: Path) -> bool:
    """TestSuite leaves a file with three bytes for a step that took no samples."""
    return path.stat().st_size > 3


@cache
def _table(path: Path, columns: Columns) -> Samples:
    """Travel, force and, if there is one, time."""
    wanted = [columns.travel, columns.force, *([] if columns.time is None else [columns.time])]
    if columns.sheet:
        frame = pd.read_excel(
            path, sheet_name=columns.sheet, header=None, skiprows=columns.skip, engine="calamine"
        )
    else:
        frame = pd.read_csv(
            path,
            sep=columns.separator,
            header=None,
            skiprows=columns.skip,
            nrows=columns.last,
            decimal=columns.decimal,
            encoding=columns.encoding,
            usecols=wanted,
        )
    return frame[wanted].to_numpy(dtype=float)


def controldesk(path: Path) -> dict[str, Samples]:
    """Time ("") and channels by full path of a MAT file of ControlDesk, v5 or v7.3."""
    import h5py
    import scipy.io

    if not h5py.is_hdf5(path):
        content = scipy.io.loadmat(path, squeeze_me=True, struct_as_record=False)
        (data,) = (each for name, each in content.items() if not name.startswith("_"))
        found = {f"{datum.Path}/{datum.Name}": datum.Data for datum in data.Y}
        return {"": data.X.Data, **found}
    with h5py.File(path) as file:
        (group,) = (file[name] for name in file if not name.startswith("#"))

        def text(reference: Any) -> str:
            return "".join(map(chr, file[reference][:].ravel())).replace(r"\n", "")

        rows = zip(*(group["Y"][key][:, 0] for key in ("Path", "Name", "Data")), strict=True)
        found = {f"{text(a)}/{text(b)}": file[data][:].ravel() for a, b, data in rows}
        return {"": group["X"]["Data"][:].ravel(), **found}


def _real(table: dict[str, Any]) -> Real:
    asked = dict(table.pop("asked"))
    if "window" in asked:
        asked["window"] = tuple(asked["window"]) or None
    for name in ("files", "units"):
        if name in table:
            table[name] = tuple(table[name])
    return Real(columns=Columns(**table.pop("columns")), asked=Asked(**asked), **table)


FRAMES = {
    name: _real(table)
    for name, table in tomllib.loads(
        Path(__file__).with_suffix(".toml").read_text(encoding="utf-8")
    ).items()
}
PROTOCOL = """\
version: 1
name: plain
about: Plain numbers of one recorder
sources:
  force:
    reader: READER
    channels:
      force: {channel: "FORCE", calibration: {gain: 1 N/V}, unit: V}
      displacement: {channel: "TRAVEL", unit: mm}
align: {method: none}
STEPScurve: {force: force, displacement: displacement}
branches: {channel: displacement, min_stroke: STROKE mm}
results:
  - {result: peak-displacement}
"""
WORK = "  - {result: peak-force}\n  - {result: energy}\n"
SMOOTH = "  - {step: smooth, channel: %s, method: moving-average, span: %s s}\n"


@dataclass(frozen=True)
class Recorder:
    """Two channels of one recording, taken as N and mm; `span` is of a moving average, s."""

    file: str
    reader: str
    force: str
    travel: str
    stroke: float
    """mm"""
    span: float = 0.0
    same_as: str = ""
    """A file that holds the same samples and is easier to open."""
    position_only: bool = False
    """What stands for the force is none, so that only the motion has a number."""
    hurt: Mapping[str, str] = field(default_factory=dict)

    def sheet(self) -> str:
        return (
            "test: T\nprotocol: ./plain.yaml\n"
            'specimen: {type: real, spool: "1", sample: "1"}\n'
            f"files: {{force: recording{Path(self.file).suffix}}}\n"
        )

    def files(self, root: Path) -> dict[str, bytes]:
        text = PROTOCOL.replace("READER", self.reader).replace("STROKE", str(self.stroke))
        text = text.replace("FORCE", self.force).replace("TRAVEL", self.travel)
        both = "".join(SMOOTH % (channel, self.span) for channel in ("force", "displacement"))
        text = text.replace("STEPS", f"steps:\n{both}" if self.span else "")
        text += "" if self.position_only else WORK
        recording = (root / self.file).read_bytes()
        return {"plain.yaml": text.encode(), f"recording{Path(self.file).suffix}": recording}

    def expected(self, root: Path) -> Expected:
        record, asked = self.record(root), Asked(None, self.stroke, failure=False)
        samples = self.samples(record)
        ways = filtered(record, samples, 1e-3 * self.stroke)
        numbers = either(plain_numbers(way, asked) for way in ways)
        if self.position_only:
            numbers = {name: number for name, number in numbers.items() if "displacement" in name}
        return Expected(numbers, causes=excused(record, asked) | dict(self.hurt))

    def record(self, root: Path) -> Record:
        source = root / (self.same_as or self.file)
        signals = exported(source) if source.suffix == ".csv" else controldesk(source)
        return Record(signals[""], 1e-3 * signals[self.travel], signals[self.force])

    def samples(self, record: Record) -> int:
        """An odd number of samples that the span of the filter holds, with a middle one."""
        assert record.time is not None
        count = round(self.span / float(np.median(np.diff(record.time))))
        return count - (1 - count % 2) if count else 0


def exported(path: Path) -> dict[str, Samples]:
    """Time ("") and channels of a CSV of ControlDesk, whose first samples follow their label."""
    text = path.read_text(encoding="utf-8-sig")
    head, _, body = text.partition("\ntrace_values,")
    (line,) = (line for line in head.splitlines() if line.startswith("trace_names,"))
    rows = pd.read_csv(StringIO(body.replace("\n,", "\n")), header=None).to_numpy(dtype=float)
    return dict(zip(["", *line.split(",")[2:]], rows.T, strict=True))


@dataclass(frozen=True)
class Take:
    """A soft arm in a Motive take: how far the centre of its last ring goes."""

    file: str
    ring: str

    def sheet(self) -> str:
        return (
            "test: T\nprotocol: markers-only\n"
            'specimen: {type: soft-arm, spool: "1", sample: "1"}\nfiles: {markers: take.csv}\n'
        )

    def files(self, root: Path) -> dict[str, bytes]:
        return {"take.csv": (root / self.file).read_bytes()}

    def expected(self, root: Path) -> Expected:
        lines = (root / self.file).read_text(encoding="utf-8-sig").splitlines()
        top = next(i for i, line in enumerate(lines) if line.startswith("Frame,"))
        names, words = lines[top - 3].split(","), lines[top - 1].split(",")
        places = [
            i
            for i, (name, word) in enumerate(zip(names, words, strict=False))
            if name.startswith(self.ring) and word == "Position"
        ]
        table = pd.read_csv(StringIO("\n".join(lines[top + 1 :])), header=None).to_numpy(float)
        centre = 1e-3 * table[:, places].reshape(len(table), -1, 3).mean(axis=1)
        away = np.linalg.norm(centre - centre[:5].mean(axis=0), axis=1)
        return Expected({"tip_travel": Plain.of(float(np.nanmax(away)))})


ROOT = "Model Root/"
LOAD = f"{ROOT}Harware/Subsystem1/load raw1/In1"
LASER = f"{ROOT}Laser Sensor/laser_-x1/In1"
STEP = (f"{ROOT}Volt/In1", f"{ROOT}Position1/In1", 1.0)
ADC = (f"{ROOT}DS1104ADC_C5/ADC", f"{ROOT}DS1104ADC_C6/ADC", 0.2)
RECORDERS: dict[str, Recorder | Take] = {
    "damper": Recorder("dspace/0103_3_3.mat", "dspace-mat", LOAD, LASER, 1.0, 0.02),
    "damper-unfiltered": Recorder("dspace/0103_3_3.mat", "dspace-mat", LOAD, LASER, 1.0),
    "motor-mat": Recorder("dspace/exp1_003.mat", "dspace-mat", *STEP, position_only=True),
    "motor-mf4": Recorder(
        *("dspace/rec1_003.mf4", "dspace-mf4", *STEP),
        same_as="dspace/exp1_003.mat",
        position_only=True,
    ),
    "motor-csv": Recorder(
        *("dspace/rec1_001.csv", "dspace-csv", "Qs", "Theta_e", 1.0),
        position_only=True,
        hurt={"peak_displacement.*": "zero_jump"},  # an angle that starts again at each full turn
    ),
    "lvdt-waves": Recorder("dspace/exp1_030.mat", "dspace-mat", *ADC, position_only=True),
    "lvdt-steps": Recorder("dspace/exp1_033.mat", "dspace-mat", *ADC, position_only=True),
    "soft-arm": Take("motive/softarm_sim-fk-400-2_1.23.csv", "SA-up"),
}
