"""Plain shapes: every `ok` number is the plain one, and everything else says the true cause."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.judges.plain.bench import process
from tests.judges.plain.definitions import filtered
from tests.judges.plain.judge import Expected, complaints
from tests.judges.plain.numbers import either, excused, plain_numbers
from tests.judges.plain.shape_cases import Case, all_cases
from tests.judges.plain.still_wrong import marked

CASES = {f"shape-{case.name}": case for case in all_cases()}
SHEET = """\
test: T
protocol: ./plain.yaml
specimen: {type: shape, spool: "1", sample: "1"}
files: {frame: plain.csv}
"""
PROTOCOL = """\
version: 1
name: plain
about: Plain numbers of plain shapes
sources:
  frame:
    reader: load-frame
    channels:
      force: {channel: LoadSTATED}
      displacement: {channel: Crosshead}
STEPScurve: {force: force, displacement: displacement, failure: {force_below: 50 %}SLACK}
branches: {channel: displacement, min_stroke: 1 mm}
results:
  - {result: peak-force}
  - {result: peak-displacement}
  - {result: stiffness, from: LOW mm, to: HIGH mm}
  - {result: energy}
  - {result: failure}
  - {result: energy-to-break}
"""


def protocol(case: Case) -> bytes:
    assert case.asked.window is not None
    low, high = case.asked.window
    text = PROTOCOL.replace("LOW", str(low)).replace("HIGH", str(high))
    text = text.replace("STEPS", f"steps:\n{case.steps}" if case.steps else "")
    taken = ", slack: {from: 10 %, to: 30 %}" if case.asked.slack else ""
    text = text.replace("SLACK", taken)
    text = text.replace("STATED", case.stated)
    return (text + ("  - {result: slack}\n" if taken else "")).encode()


def expected(case: Case) -> Expected:
    true = (case.true or case.table).record()
    stroke = 1e-3 * case.asked.min_stroke
    numbers = either(
        plain_numbers(each, case.asked) for each in filtered(true, case.smooth, stroke)
    )
    causes = excused(case.table.record().seen(), case.asked) | dict(case.hurt)
    return Expected(
        numbers,
        causes=causes,
        refusal=case.refusal,
        own=case.true is None,
        sign_free=case.sign_free,
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", [pytest.param(name, marks=marked(name)) for name in CASES])
def test_shape(name: str, tmp_path: Path) -> None:
    case = CASES[name]
    export = case.table.csv()
    files = {"plain.csv": export[: int(case.kept * len(export))], "plain.yaml": protocol(case)}
    found = complaints(process(tmp_path, SHEET, files), expected(case))
    assert not found, "\n".join(found)
