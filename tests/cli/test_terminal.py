from __future__ import annotations

import math
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from labpipe.campaign.reporting import Reported
from labpipe.cli.process import table
from labpipe.cli.report import report_table
from labpipe.cli.terminal import counting, progress, reading
from labpipe.process.run import Processed
from labpipe.records.curve import Interval
from labpipe.records.group import Campaign, GroupNumber
from labpipe.records.quality import QualityNote, Reason, Severity
from labpipe.records.result import Contribution, Result, Specimen, Status, TestResult
from tests.builders.campaigns import build_group, build_number, six_samples, troubled_samples

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
    assert line.split() == ["peak_displacement.1", "50.0", "mm", "95", "%:", "49.0", "to", "51.0"]
    assert drift.split() == ["clock_drift", "40", "ppm", "95", "%:", "30", "to", "50"]
    assert plain.split() == ["peak_force.1", "1.5000", "N"]


def test_marks_and_reasons_told_once() -> None:
    lines = told(
        Result("a.1", 1.0, "N", status=Status.DOUBTFUL, reasons=(Reason("x", "y"),)),
        Result("a.2", 1.0, "N", status=Status.DOUBTFUL, reasons=(Reason("x", "y"),)),
        Result("b", None, "N", status=Status.FAILED, reasons=(Reason("gap", "z"),)),
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


def test_the_place_of_a_note_stands_once() -> None:
    of_marker = "W:M2: no position, frames 1 to 3"
    notes = (
        QualityNote("c", Severity.WARNING, "W:M2, frames 1 to 3", of_marker),
        QualityNote("c", Severity.WARNING, "W:M3, frames 1 to 3", "no position"),
    )
    assert told(quality=notes)[1:] == [
        f"  warning: {of_marker}",
        "  warning: W:M3, frames 1 to 3: no position",
    ]


def test_the_largest_share_stands_beside_the_interval() -> None:
    budget = (Contribution("noise", 0.3), Contribution("pull offset", -0.4))
    found = Result("a", 53.43, "mm", Interval(53.32, 53.54), budget=budget)
    apart = replace(found, estimate=53.1, interval=Interval(53.0, 53.2))
    _, near, far, bare = told(found, apart, replace(found, budget=()))
    assert " ".join(near.split()) == "a 53.43 mm 95 %: 53.32 to 53.54 pull offset 64 %"
    said = "a 53.43 mm estimate 53.10, 95 %: 53.00 to 53.20 pull offset 64 %"
    assert " ".join(far.split()) == said
    assert bare.endswith("95 %: 53.32 to 53.54")


@pytest.mark.parametrize(
    ("value", "ends", "shown"),
    [
        (1.0927371, (1.0875435, 1.0968408), "1.0927 N 95 %: 1.0875 to 1.0968"),
        (52.264857, (-34.244437, 138.774152), "52 N 95 %: -34 to 139"),
        (32290.4, (31641.2, 32963.4), "32290 N 95 %: 31640 to 32960"),
        (1234567.8, (1034567.8, 1434567.8), "1230000 N 95 %: 1030000 to 1430000"),
        (-4e-7, (-6.04e-7, -1.96e-7), "-0.00000040 N 95 %: -0.00000060 to -0.00000020"),
        (8.0, (8.0003, 8.0097), "8.0000 N 95 %: 8.0003 to 8.0097"),
        (26.0, (26.0, 26.0), "26.000 N 95 %: 26.000 to 26.000"),
        (0.0, (0.0, 0.0), "0.00000 N 95 %: 0.00000 to 0.00000"),
        (801.25, (757.031, math.inf), "801.25 N 95 %: 757.03 to inf"),
        (53.43, None, "53.430 N"),
    ],
)
def test_digits_are_those_of_the_interval(
    value: float, ends: tuple[float, float] | None, shown: str
) -> None:
    """Two of half its width; a last bit, as processors differ in, changes nothing."""
    for by in (1.0, 1.0 + 2e-16, 1.0 - 1e-9):
        interval = None if ends is None else Interval(by * ends[0], by * ends[1])
        doubts = (Reason("c", "doubted"),)
        line = told(Result("a", by * value, "N", interval, Status.DOUBTFUL, doubts))[1]
        assert " ".join(line.split()) == f"? a {shown}"


def test_many_cycles_are_summed_up() -> None:
    lines = told(*(Result(f"peak_force.{k}", float(k), "N") for k in range(1, 63)))
    assert len(lines) == 6
    assert lines[-1] == "  ... to peak_force.62       5 to 62 N (58 more in summary.json)"


def test_a_line_per_test_in_a_pipe(capsys: pytest.CaptureFixture[str]) -> None:
    with progress(2) as begin:
        for test in TESTS:
            begin(test)("read")
    assert capsys.readouterr().err == "1/2 A\n2/2 B\n"


def test_a_bar_on_a_terminal(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    with progress(2) as begin:
        for test in TESTS:
            say = begin(test)
            for stage in ("read", "process", "write", "draw"):
                say(stage)
    assert "1/2" not in capsys.readouterr().err


def of_group(*numbers: GroupNumber) -> list[str]:
    """What is said of a report with one group of six samples from two spools."""
    group = replace(build_group("tube", six_samples()), numbers=numbers)
    campaign = Campaign("Synthetic", (group,))
    return report_table(Reported(Path("r"), campaign, (Path("r/report.html"),))).splitlines()


def test_what_ended_is_counted_in_a_pipe(capsys: pytest.CaptureFixture[str]) -> None:
    with counting("test") as (begin, say):
        begin(2)
        say("B: ok")
        say("A: failed")
    assert capsys.readouterr().err == "1/2 B: ok\n2/2 A: failed\n"


def test_what_ended_moves_a_bar_on_a_terminal(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    with counting("test") as (begin, say):
        begin(2)
        say("B: ok")
    assert "\n1/2" not in capsys.readouterr().err


def test_means_in_the_display_unit() -> None:
    heading, line, blank, where = of_group(build_number("stiffness_first", six_samples()))
    assert heading == "tube  (twist-tube): 6 samples from 2 spools"
    name, value, unit, *interval = line.split()
    assert (name, unit, interval[:2]) == ("stiffness_first", "N/mm", ["95", "%:"])
    assert 4.0 < float(value) < 6.0
    assert blank == ""
    assert where.startswith("report: ")
    assert where.endswith("report.html")


def test_a_mean_apart_from_its_estimate() -> None:
    number = build_number("stiffness_first", six_samples())
    mean = number.mean
    assert mean is not None
    low = replace(mean.chosen, interval=Interval(4e3, 4.2e3), estimate=4.1e3)
    _, line, *_ = of_group(replace(number, mean=replace(mean, chosen=low)))
    assert " ".join(line.split()[3:]) == "estimate 4.10, 95 %: 4.00 to 4.20"


def test_means_of_some_samples_and_of_none() -> None:
    some = build_number("stiffness_second", troubled_samples())
    none = replace(some, name="slack", mean=None)
    _, line, missing, *_ = of_group(some, none)
    assert line.endswith("  (1 without)")
    assert missing.split()[:3] == ["!", "slack", "-"]


def test_one_of_each_is_singular() -> None:
    group = build_group("tube", six_samples()[:1])
    campaign = Campaign("Synthetic", (group,))
    said = report_table(Reported(Path("r"), campaign, ()))
    assert "tube  (twist-tube): 1 sample from 1 spool\n" in said
    assert said.endswith("report: nothing written")


def test_reading_is_shown_on_a_terminal_only(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    with reading(2) as say:
        say("A")
    assert capsys.readouterr().err == ""
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    with reading(2) as say:
        say("A")
        say("B")
    assert "\n1/2" not in capsys.readouterr().err
