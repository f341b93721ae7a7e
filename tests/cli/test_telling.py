from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import pytest

from labpipe.cli.telling import progress, table
from labpipe.pipeline.process import Processed
from labpipe.records.curve import Interval
from labpipe.records.quality import QualityNote, Severity
from labpipe.records.result import Result, Specimen, Status, TestResult

TESTS = [Path("raw/A/test.yaml"), Path("raw/B/test.yaml")]
EMPTY = TestResult(
    test="A2-1",
    specimen=Specimen("A2", "s1", "1"),
    protocol="wire",
    protocol_yaml="",
    test_yaml="",
    labpipe_version="0",
    inputs=(),
    recordings={},
    aligned=None,
    curve=None,
    shape=None,
    results=(),
    quality=(),
    display={"displacement": "mm", "energy": "mJ"},
)


def told(*results: Result, quality: tuple[QualityNote, ...] = ()) -> list[str]:
    result = replace(EMPTY, results=results, quality=quality)
    return table(Processed(Path("out"), result, ())).splitlines()


def test_values_in_the_display_unit() -> None:
    heading, line, drift, plain = told(
        Result("peak_displacement.1", 0.05, "m", Interval(0.049, 0.051)),
        Result("clock_drift", 4e-5, "1", Interval(3e-5, 5e-5)),
        Result("peak_force.1", 1.5, "N"),
    )
    assert heading == "A2-1  (wire): 3 ok  ->  out"
    assert line.split() == ["peak_displacement.1", "50", "mm", "95", "%:", "49", "to", "51"]
    assert drift.split() == ["clock_drift", "40", "ppm", "95", "%:", "30", "to", "50"]
    assert plain.split() == ["peak_force.1", "1.5", "N"]


def test_marks_and_reasons_told_once() -> None:
    lines = told(
        Result("a.1", 1.0, "N", status=Status.DOUBTFUL, reason="x: y"),
        Result("a.2", 1.0, "N", status=Status.DOUBTFUL, reason="x: y"),
        Result("b", None, "N", status=Status.FAILED, reason="gap: z"),
    )
    assert lines[0] == "A2-1  (wire): 2 doubtful, 1 failed  ->  out"
    assert [line[:1] for line in lines[1:4]] == ["?", "?", "!"]
    assert lines[3].split() == ["!", "b", "-"]
    assert lines[4:] == ["  doubtful: x: y  [a.1, a.2]", "  failed: gap: z  [b]"]


def test_notes_that_matter() -> None:
    notes = tuple(QualityNote("c", severity, "force", f"{severity}!") for severity in Severity)
    assert told(quality=notes)[1:] == [
        "  warning: force: warning!",
        "  error: force: error!",
    ]


def test_many_cycles_are_summed_up() -> None:
    lines = told(*(Result(f"peak_force.{k}", float(k), "N") for k in range(1, 63)))
    assert len(lines) == 6
    assert lines[-1] == "  ... to peak_force.62       5 to 62 N (58 more in summary.json)"


def test_a_line_per_test_in_a_pipe(capsys: pytest.CaptureFixture[str]) -> None:
    for test, say in progress(TESTS):
        say("read")
        assert test in TESTS
    assert capsys.readouterr().err == "1/2 A\n2/2 B\n"


def test_a_bar_on_a_terminal(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    seen = []
    for test, say in progress(TESTS):
        for stage in ("read", "process", "write", "draw"):
            say(stage)
        seen.append(test)
    assert seen == TESTS
    assert "1/2" not in capsys.readouterr().err
