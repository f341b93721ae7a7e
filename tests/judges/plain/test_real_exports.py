"""The plain judge on tables of a few rows, then on each number of the real exports."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.judges.plain.definitions import (
    Break,
    Cycle,
    Plain,
    Record,
    cycles,
    excused,
    failure,
    peak_force,
    plain_numbers,
    slack,
    stiffness,
    trapezoid,
)
from tests.judges.plain.judge import Expected, RunSummary, complaints, process
from tests.judges.plain.real_files import FRAMES, RECORDERS, Real, Recorder, Take, read

TRAVEL = np.array([0.0, 1.0, 2.0, 3.0, 3.0, 2.0, 1.0, 0.0, 0.0, 1.0, 2.0])


FORCE = np.array([0.0, 10.0, 20.0, 30.0, 31.0, 15.0, 5.0, 0.0, 0.0, 9.0, 18.0])


RECORD = Record(None, TRAVEL, FORCE)


def test_numbers_of_eleven_rows() -> None:
    first, _ = cycles(TRAVEL, 1.0)
    assert peak_force(RECORD, first, 1.0) == Plain(30.0, 31.0)  # it stands for two rows
    assert stiffness(RECORD, first, 0.5, 2.5) == Plain(10.0, 10.0)
    assert trapezoid(TRAVEL[:5], FORCE[:5]) == pytest.approx(45.0)
    late = Record(None, TRAVEL[:4] + 0.5, FORCE[:4])
    assert slack(late, Cycle(0, 3, 3, None), 0.3, 0.8) == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("force", "found"),
    [
        ([0, 50, 100, 0, 0], Break(2, 2)),
        ([0, 50, 100, 95, 90, 86, 2], Break(5, 5)),  # what goes before is necking
        ([0, 50, 100, 85, 55, 20, 0], Break(2, 2)),
        ([0, 50, 100, 92, 84, 76, 68, 60, 52, 44, 36], Break(8, 8, sure=False)),
        ([0, 50, 100, 92, 84, 76, 68, 60, 52], None),
        ([0, 50, 100, 92, 84, 76, 68, 60, 52, 44, 30], Break(8, 9, sure=False)),
    ],
)
def test_breaks(force: list[int], found: Break | None) -> None:
    travel = np.arange(float(len(force)))
    record = Record(0.1 * travel, travel, np.array(force, dtype=float))
    assert failure(record, Cycle(0, len(force) - 1, len(force) - 1, None)) == found


def ran(status: str = "ok", value: float = 100.0, reason: str = "", **more: Any) -> RunSummary:
    told = [part.split(": ") for part in reason.split("; ") if part]
    reasons = [{"code": code, "message": message} for code, message in told]
    result = {"name": "peak_force.1", "value": value, "status": status, "reasons": reasons}
    return RunSummary(0, "", "", {"results": [{**result, "method": ""}], "quality": [], **more})


FINE = Expected({"peak_force.1": Plain(100.0, 100.0)})


CUT = replace(FINE, causes={"peak_*": "partial_cycle"}, own=False)


@pytest.mark.parametrize(
    ("outcome", "rule", "said"),
    [
        (ran(value=100.31), FINE, "peak_force.1: 100.31 is ok, plainly 100 (+0.31 %)"),
        (ran("doubtful", 50.0, "saturation: full"), FINE, "must be ok"),
        (ran("doubtful", 50.0, "saturation: full"), CUT, "not the cause (partial_cycle)"),
        (ran("doubtful", 50.0), CUT, "no reason"),
        (ran("failed", 0.0, "partial_cycle: nan s"), CUT, "no sentence"),
        (ran(value=50.0), CUT, "is ok, plainly"),
        (ran("doubtful", 50.0, "partial_cycle: x"), replace(CUT, own=True), "is doubtful, plainly"),
        (ran(value=-100.0), replace(FINE, sign_free=True), "negative, and no reason is given"),
        (ran(), Expected({"peak_force.1": None}), "there is no such number"),
        (ran(), Expected({}), "there is no such number"),
        (ran(), Expected({"energy.1": Plain(1.0, 1.0)}), "energy.1: not in the summary"),
        (replace(ran(), err="RuntimeWarning: x"), FINE, "terminal: "),
        (replace(ran(), status=1), FINE, "exit status 1, with no failed result"),
        (RunSummary(2, "", "no"), FINE, "refused: no"),
        (RunSummary(-1, "", "Traceback"), FINE, "exit status -1"),
    ],
)
def test_what_is_wrong_is_found(outcome: RunSummary, rule: Expected, said: str) -> None:
    assert any(said in error_text for error_text in complaints(outcome, rule))


pytestmark = pytest.mark.realdata


PROTOCOL = """\
version: 1
name: plain
about: Plain numbers of a real export
sources:
  frame:
    reader: load-frame
    PARTchannels:
      force: {channel: "FORCE"}
      displacement: {channel: "TRAVEL"}
curve: {force: force, displacement: displacement, failure: {force_below: 50 %}SLACK}
branches: {channel: displacement, min_stroke: STROKE mm}
results:
  - {result: peak-force}
  - {result: peak-displacement}
  - {result: energy}
  - {result: failure}
  - {result: energy-to-break}
"""


SEGMENTS = "  - {result: two-segments, from: LOW mm, to: HIGH mm}\n"


WINDOW = "  - {result: stiffness, from: LOW mm, to: HIGH mm}\n"


@dataclass(frozen=True)
class Frame:
    """A test of a load frame."""

    real: Real

    def sheet(self) -> str:
        return (
            "test: T\nprotocol: ./plain.yaml\n"
            'specimen: {type: real, spool: "1", sample: "1"}\n'
            f"files: {{frame: [{', '.join(self._names())}]}}\n"
        )

    def _names(self) -> list[str]:
        return [f"part{i}{Path(name).suffix}" for i, name in enumerate(self.real.files)]

    def files(self, root: Path) -> dict[str, bytes]:
        pairs = zip(self._names(), self.real.files, strict=True)
        found = {inside: (root / outside).read_bytes() for inside, outside in pairs}
        return {"plain.yaml": protocol(self.real), **found}

    def expected(self, root: Path) -> Expected:
        real, record = self.real, read(self.real, root)
        whole = record.seen()
        numbers = plain_numbers(whole, real.asked)
        # A row with a travel and a blank force counts for the largest travel, and the reverse.
        for name, values in (
            ("peak_force.1", record.force),
            ("peak_displacement.1", record.travel),
        ):
            plain = numbers.get(name)
            if plain is not None and len(whole.force) < len(record.force):
                ends = np.nanmin(values), np.nanmax(values)
                nearest = min(ends, key=lambda end: abs(end - plain.high))
                numbers[name] = Plain.of(plain.low, plain.high, nearest)
        causes = excused(whole, real.asked) | dict(real.hurt)
        return Expected(
            numbers,
            causes,
            refusal=real.refusal,
            own=not real.since,
            sign_free=real.sign_free,
        )


def protocol(real: Real) -> bytes:
    text = PROTOCOL.replace("FORCE", real.force).replace("TRAVEL", real.travel)
    text = text.replace("PART", f"part: {real.part}\n    " if real.part else "")
    text = text.replace("STROKE", str(real.asked.min_stroke))
    slack = ", slack: {from: 10 %, to: 30 %}" if real.asked.slack else ""
    text = text.replace("SLACK", slack) + ("  - {result: slack}\n" if slack else "")
    if real.asked.window is not None:
        low, high = real.asked.window
        window = WINDOW + (SEGMENTS if real.asked.segments else "")
        text += window.replace("LOW", str(low)).replace("HIGH", str(high))
    return text.encode()


CASES: dict[str, Frame | Recorder | Take] = {
    **{f"real-{name}": Frame(real) for name, real in FRAMES.items()},
    **{f"real-{name}": recorder for name, recorder in RECORDERS.items()},
}


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_real_export(name: str, realdata: Path, tmp_path: Path) -> None:
    case = CASES[name]
    ran = process(tmp_path, case.sheet(), case.files(realdata))
    found = complaints(ran, case.expected(realdata))
    assert not found, "\n".join(found)
