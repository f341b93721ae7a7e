"""Recordings of ControlDesk and takes of cameras: what is asked by YAML, and the plain numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from io import StringIO
from pathlib import Path

import numpy as np
import pandas as pd

from tests.judges.plain.definitions import Plain, Record, Samples, filtered
from tests.judges.plain.judge import Expected
from tests.judges.plain.numbers import Asked, either, excused, plain_numbers
from tests.judges.plain.real_files import controldesk

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
        both = "".join(SMOOTH % (each, self.span) for each in ("force", "displacement"))
        text = text.replace("STEPS", f"steps:\n{both}" if self.span else "")
        text += "" if self.position_only else WORK
        recording = (root / self.file).read_bytes()
        return {"plain.yaml": text.encode(), f"recording{Path(self.file).suffix}": recording}

    def expected(self, root: Path) -> Expected:
        record, asked = self.record(root), Asked(None, self.stroke, failure=False)
        samples = self.samples(record)
        ways = filtered(record, samples, 1e-3 * self.stroke)
        numbers = either(plain_numbers(each, asked) for each in ways)
        if self.position_only:
            numbers = {name: each for name, each in numbers.items() if "displacement" in name}
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
    (line,) = (each for each in head.splitlines() if each.startswith("trace_names,"))
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
        "dspace/rec1_001.csv", "dspace-csv", "Qs", "Theta_e", 1.0, position_only=True
    ),
    "lvdt-waves": Recorder("dspace/exp1_030.mat", "dspace-mat", *ADC, position_only=True),
    "lvdt-steps": Recorder("dspace/exp1_033.mat", "dspace-mat", *ADC, position_only=True),
    "soft-arm": Take("motive/softarm_sim-fk-400-2_1.23.csv", "SA-up"),
}
