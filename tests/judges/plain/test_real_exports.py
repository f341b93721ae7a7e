"""Each number of real exports and of plain shapes against a plain one on the same samples."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from tests.judges.plain.definitions import Plain, excused, plain_numbers
from tests.judges.plain.judge import Expected, complaints, marked, process
from tests.judges.plain.real_files import FRAMES, RECORDERS, Real, Recorder, Take, read

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


def judged(name: str, root: Path, home: Path) -> list[str]:
    case = CASES[name]
    return complaints(process(home, case.sheet(), case.files(root)), case.expected(root))


@pytest.mark.slow
@pytest.mark.parametrize("name", [pytest.param(name, marks=marked(name)) for name in CASES])
def test_real_export(name: str, realdata: Path, tmp_path: Path) -> None:
    found = judged(name, realdata, tmp_path)
    assert not found, "\n".join(found)
