"""The foreign tests through the command line, and those that the study of coverage draws."""

from __future__ import annotations

import contextlib
import io
import json
import shutil
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from labpipe.cli import main
from tests.builders.reasons import why
from tests.judges.foreign.cameras import CAMERAS
from tests.judges.foreign.frames import FRAMES
from tests.judges.foreign.rig import (
    CAMERA_FAULTS,
    FRAME_FAULTS,
    PULL_FAULTS,
    RECORDER_FAULTS,
    Chance,
    Made,
)
from tests.judges.foreign.rig import KINDS as NOISES
from tests.judges.foreign.tension import TENSION

MAKERS: dict[str, Callable[[Chance, Path], Made]] = {**FRAMES, **TENSION, **CAMERAS}
KINDS = tuple(MAKERS)
SEEDS = tuple(range(26000, 26200))
"""Of the study; never changed."""
FAULTS = {
    **dict.fromkeys(FRAMES, PULL_FAULTS),
    **dict.fromkeys(TENSION, PULL_FAULTS),
    **dict.fromkeys(CAMERAS, CAMERA_FAULTS),
    "force-displacement": RECORDER_FAULTS,
    "conduit-bundle": RECORDER_FAULTS,
    "three-point-bend": FRAME_FAULTS,
    "stiff-bar": FRAME_FAULTS[:2],
    "iso-6892": FRAME_FAULTS,
    "iso-527-tape": FRAME_FAULTS,
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
            estimate = row.get("estimate")
            yield {**kept, "estimate": estimate, "truth": truth, "why": why(row)}
