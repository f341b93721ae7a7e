"""Every real export that is a test: each number against a plain one on the file's own samples."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.plain.bench import process
from tests.plain.definitions import Plain
from tests.plain.judge import Expected, complaints
from tests.plain.numbers import excused, plain_numbers
from tests.plain.real_files import FRAMES, Real, read
from tests.plain.still_wrong import marked

pytestmark = pytest.mark.realdata

CASES = {f"real-{name}": real for name, real in FRAMES.items()}
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
curve: {force: force, displacement: displacement, failure: {force_below: 50 %}}
branches: {channel: displacement, min_stroke: STROKE mm}
results:
  - {result: peak-force}
  - {result: peak-displacement}
  - {result: energy}
  - {result: failure}
  - {result: energy-to-break}
"""
WINDOW = "  - {result: stiffness, from: LOW mm, to: HIGH mm}\n"


def protocol(real: Real) -> bytes:
    text = PROTOCOL.replace("FORCE", real.force).replace("TRAVEL", real.travel)
    text = text.replace("PART", f"part: {real.part}\n    " if real.part else "")
    text = text.replace("STROKE", str(real.asked.min_stroke))
    if real.asked.window is not None:
        low, high = real.asked.window
        text += WINDOW.replace("LOW", str(low)).replace("HIGH", str(high))
    return text.encode()


def names(real: Real) -> list[str]:
    """Files in the folder of the test."""
    return [f"part{i}{Path(name).suffix}" for i, name in enumerate(real.files)]


def sheet(real: Real) -> str:
    return (
        "test: T\nprotocol: ./plain.yaml\n"
        'specimen: {type: real, spool: "1", sample: "1"}\n'
        f"files: {{frame: [{', '.join(names(real))}]}}\n"
    )


def expected(real: Real, root: Path) -> Expected:
    record = read(real, root)
    whole = record.seen()
    numbers = plain_numbers(whole, real.asked)
    # A row with a travel and a blank force counts for the largest travel, and the other way round.
    single = {"peak_force.1": record.force, "peak_displacement.1": record.travel}
    for name, values in single.items():
        plain = numbers.get(name)
        if plain is not None and len(whole.force) < len(record.force):
            ends = np.nanmin(values), np.nanmax(values)
            nearest = min(ends, key=lambda end: abs(end - plain.high))
            numbers[name] = Plain.of(plain.low, plain.high, nearest)
    causes = excused(whole, real.asked) | dict(real.hurt)
    return Expected(numbers, causes=causes, refusal=real.refusal, sign_free=real.sign_free)


def judged(name: str, root: Path, home: Path) -> list[str]:
    real = CASES[name]
    files = {
        inside: (root / outside).read_bytes()
        for inside, outside in zip(names(real), real.files, strict=True)
    }
    files["plain.yaml"] = protocol(real)
    return complaints(process(home, sheet(real), files), expected(real, root))


@pytest.mark.parametrize("name", [pytest.param(name, marks=marked(name)) for name in CASES])
def test_real_export(name: str, realdata: Path, tmp_path: Path) -> None:
    found = judged(name, realdata, tmp_path)
    assert not found, "\n".join(found)
