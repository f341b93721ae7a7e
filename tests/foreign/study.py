"""The foreign tests through the command line; the study of coverage and its table.

The study draws 200 tests of each kind by seeds that were fixed before it ran first. It writes one
JSON line per test and goes on where it stopped.
"""

from __future__ import annotations

import contextlib
import io
import json
import shutil
import time
import traceback
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from labpipe.cli import main
from tests.foreign.cameras import CAMERAS
from tests.foreign.frames import FRAMES
from tests.foreign.noise import KINDS as NOISES
from tests.foreign.rig import (
    CAMERA_FAULTS,
    FRAME_FAULTS,
    PULL_FAULTS,
    RECORDER_FAULTS,
    Chance,
    Made,
)

MAKERS: dict[str, Callable[[Chance, Path], Made]] = {**FRAMES, **CAMERAS}
KINDS = tuple(MAKERS)
SEEDS = tuple(range(26000, 26200))
"""Of the study; never changed."""
FAULTS = {
    **dict.fromkeys(FRAMES, PULL_FAULTS),
    **dict.fromkeys(CAMERAS, CAMERA_FAULTS),
    "force-displacement": RECORDER_FAULTS,
    "conduit-bundle": RECORDER_FAULTS,
    "three-point-bend": FRAME_FAULTS,
    "stiff-bar": FRAME_FAULTS[:2],
}
"""What can go wrong with each kind. A bar that is pulled less far is no fault."""
Row = dict[str, Any]


@dataclass(frozen=True)
class Said:
    """What labpipe said of one test.

    Parameters
    ----------
    rows : of each result name, truth, value, lower, upper (None where there is none), status, why
    notes : code and message of the quality notes
    printed : what the command wrote
    """

    rows: tuple[Row, ...]
    notes: tuple[str, ...]
    printed: str

    @property
    def told(self) -> str:
        """All that a user can read, on one line each."""
        return "\n".join([*self.notes, *(row["why"] for row in self.rows), self.printed])


def chance_of(kind: str, seed: int) -> Chance:
    """The test that the study draws by a seed: noise in turn, a fault in each eleventh."""
    place = seed - SEEDS[0]
    faults = FAULTS[kind]
    fault = faults[place // 11 % len(faults)] if place % 11 == 10 else ""
    return Chance(kind, seed, NOISES[seed % len(NOISES)], fault)


def process(chance: Chance, home: Path) -> Said:
    """Make a test below a folder, process it by the command line, and take the folder away."""
    raw, out = home / "raw" / f"{chance.kind}-{chance.seed}", home / "out"
    raw.mkdir(parents=True)
    printed = io.StringIO()
    try:
        made = MAKERS[chance.kind](chance, raw)
        with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(printed):
            try:
                main(["process", str(raw), "--out", str(out), "--no-figures"])
            except Exception:  # noqa: BLE001 - counted: a user would see a traceback
                traceback.print_exc()
        found = list(out.glob("*/summary.json"))
        summary = json.loads(found[0].read_text()) if found else {"results": [], "quality": []}
    finally:
        shutil.rmtree(home, ignore_errors=True)
    notes = tuple(f"{note['code']}: {note['message']}" for note in summary["quality"])
    told = printed.getvalue()
    return Said(tuple(_rows(made, summary["results"], told if not found else "")), notes, told)


def _rows(made: Made, results: list[Row], refused: str) -> Iterator[Row]:
    by_name = {row["name"]: row for row in results}
    for name, truth in made.truth.items():
        row = by_name.get(name)
        if row is None:
            yield {"name": name, "truth": truth, "value": None, "status": "absent", "why": refused}
        else:
            kept = {key: row[key] for key in ("name", "value", "lower", "upper", "status")}
            yield {**kept, "truth": truth, "why": row["reason"]}


def carry_on(file: Path, home: Path, *, kinds: Iterable[str] = KINDS, minutes: float = 55.0) -> int:
    """Go on with the study for some minutes; how many tests are still missing."""
    done = {(line["kind"], line["seed"]) for line in read(file)}
    wanted = [(kind, seed) for seed in SEEDS for kind in kinds if (kind, seed) not in done]
    until = time.monotonic() + 60.0 * minutes
    with file.open("a") as stream:
        for number, (kind, seed) in enumerate(wanted):
            if time.monotonic() > until:
                return len(wanted) - number
            chance = chance_of(kind, seed)
            said = process(chance, home / f"{kind}-{seed}")
            about = {"kind": kind, "seed": seed, "noise": chance.noise, "fault": chance.fault}
            stream.write(json.dumps({**about, "rows": said.rows, "notes": said.notes}) + "\n")
            stream.flush()
    return 0


def read(file: Path) -> list[Row]:
    """The lines of a study; a last line that was cut short is left out."""
    lines = file.read_text().split("\n")[:-1] if file.is_file() else []
    return [json.loads(line) for line in lines]


@dataclass(frozen=True)
class Count:
    """How one result fared in the tests without a fault.

    Parameters
    ----------
    kind, name : of which test, which result
    ok, doubtful, failed : how many
    held : of the `ok` ones, those whose interval holds the truth
    width : median half width over 1.96 standard deviations of value - truth; 1 is ideal
    bias : mean of value - truth over the median half width
    """

    kind: str
    name: str
    ok: int
    doubtful: int
    failed: int
    held: int
    width: float
    bias: float

    @property
    def share(self) -> float:
        """Of the `ok` ones that hold."""
        return self.held / self.ok if self.ok else float("nan")


def counted(lines: list[Row]) -> list[Count]:
    """Counts by kind and result, in the order of the kinds."""
    rows: dict[tuple[str, str], list[Row]] = {}
    for line in lines:
        if not line["fault"]:
            for row in line["rows"]:
                rows.setdefault((line["kind"], row["name"]), []).append(row)
    order = sorted(rows, key=lambda key: KINDS.index(key[0]))
    return [_count(kind, name, rows[kind, name]) for kind, name in order]


def _count(kind: str, name: str, rows: list[Row]) -> Count:
    ok = [row for row in rows if row["status"] == "ok"]
    doubtful = sum(row["status"] == "doubtful" for row in rows)
    failed = len(rows) - len(ok) - doubtful
    off = np.array([row["value"] - row["truth"] for row in ok])
    half = np.array([0.5 * (row["upper"] - row["lower"]) for row in ok])
    held = sum(row["lower"] <= row["truth"] <= row["upper"] for row in ok)
    if len(ok) < 3:
        return Count(kind, name, len(ok), doubtful, failed, held, float("nan"), float("nan"))
    middle, scatter = float(np.median(half)), 1.96 * float(off.std(ddof=1))
    width = middle / scatter if scatter > 0.0 else float("inf")
    bias = float(off.mean()) / middle if middle > 0.0 else float("inf")
    return Count(kind, name, len(ok), doubtful, failed, held, width, bias)


def held_by_noise(lines: list[Row]) -> dict[tuple[str, str], tuple[int, int]]:
    """By kind of test and kind of noise: intervals that hold, of how many that are `ok`."""
    found: dict[tuple[str, str], tuple[int, int]] = {}
    for line in lines:
        for row in line["rows"] if not line["fault"] else ():
            if row["status"] == "ok":
                key = line["kind"], line["noise"]
                held, n = found.get(key, (0, 0))
                inside = row["lower"] <= row["truth"] <= row["upper"]
                found[key] = held + int(inside), n + 1
    return found
