"""What goes down while the specimen is loaded: said, and turned by one line."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from labpipe.cli import main
from labpipe.process.motion import Motion
from labpipe.process.plausibility import check_signs
from labpipe.protocol.load import parse_protocol
from labpipe.records.curve import ClockFit, Interval
from labpipe.records.quality import Finding
from labpipe.records.result import Status
from labpipe.records.signals import Clocks, Signal, Signals
from labpipe.signal.turning_points import find_strokes, split_branches
from tests.builders.doubts import doubted
from tests.builders.plain_records import PlainRecord, up_and_down
from tests.builders.reduced import reduced
from tests.builders.tensile_tests import TensileLab, write_pull

RESULTS = """\
results:
  - {result: peak-force}
  - {result: peak-displacement}
  - {result: stiffness, from: 2 mm, to: 8 mm}
  - {result: energy}
"""
PROTOCOL = """\
version: 1
name: p
sources:
  frame:
    reader: load-frame
    channels: {force: {channel: A, unit: N}, displacement: {channel: B, unit: mm}}
curve: {force: force, displacement: displacement%s}
branches: {channel: displacement, min_stroke: 1 mm}
"""
ONE_CLOCK = Clocks("frame")
DOWN, AS_MEANT = ", reverse: [force, displacement]", ", reverse: []"


def turned(record: PlainRecord, *, force: float = -1.0, path: float = -1.0) -> PlainRecord:
    return replace(record, force=force * record.force, displacement=path * record.displacement)


def checked(record: PlainRecord, reverse: str = "", clocks: Clocks = ONE_CLOCK) -> list[Finding]:
    """What is found in that record as it was measured."""
    time, displacement, force = record.arrays()
    signals = Signals().with_new("force", Signal(time, force, "N", "frame"))
    signals = signals.with_new("displacement", Signal(time, displacement, "m", "frame"))
    branches = split_branches(time, find_strokes(time, displacement, min_stroke=1e-3))
    motion = Motion(signals.raw["displacement"], branches, clocks)
    return check_signs(signals, motion, parse_protocol(PROTOCOL % reverse, "p.yaml"))


def test_compression_that_counts_as_negative() -> None:
    found = checked(turned(up_and_down()))
    assert set(doubted(found)) == {"force_sign", "displacement_sign"}
    (first, second) = (each.note for each in found)
    assert (first.code, second.code) == ("force_reversed", "displacement_reversed")
    assert first.message == (
        "the force goes to -0.994 N and the displacement goes to -10 mm while the specimen is "
        "loaded: write 'curve.reverse: {value: [force, displacement], because: ...}' under "
        "'overrides' in test.yaml to turn it, or [] there if the sign is meant"
    )


def test_a_crosshead_that_counts_down() -> None:
    found = checked(turned(up_and_down(), force=1.0))
    assert set(doubted(found)) == {"displacement"}
    assert "'curve.reverse: {value: [displacement], " in doubted(found)["displacement"]
    off = turned(up_and_down(), force=1.0)
    assert set(doubted(checked(replace(off, displacement=off.displacement + 0.8)))) == {
        "displacement"
    }


def test_a_reversed_bridge() -> None:
    """The clocks were joined at its peaks."""
    record = turned(up_and_down(), path=1.0)
    found = checked(record)
    assert set(doubted(found)) == {"force"}
    assert doubted(found)["force"].startswith("force_reversed: the force goes to -0.99")
    nothing, known = np.array([0.0]), Interval(-1.0, 1.0)
    fit = ClockFit(0.0, 0.0, known, known, 0.0, nothing, nothing, nothing, "")
    joined = checked(record, clocks=Clocks("frame", fit))
    assert {each.code for each in joined} == {"force_reversed"}
    assert doubted(joined)["clock"] == doubted(joined)["force"]


def both_ways(record: PlainRecord) -> PlainRecord:
    return replace(record, displacement=record.displacement - 5e-3, force=record.force - 0.5)


def test_what_has_no_wrong_sign() -> None:
    for record in (
        up_and_down(),
        turned(both_ways(up_and_down(cycles=3))),
        replace(up_and_down(), force=np.random.default_rng(0).normal(0.0, 0.1, 1200)),
        replace(up_and_down(), force=np.full(1200, np.nan)),
        replace(up_and_down(), force=up_and_down().force - 0.1),  # zero off
        replace(up_and_down(), displacement=up_and_down().displacement - 0.8),
    ):
        assert not checked(record)


def test_nothing_moved() -> None:
    protocol = parse_protocol(PROTOCOL % "", "p.yaml")
    still = Signal(np.arange(9.0), np.zeros(9), "m", "frame")
    assert not check_signs(Signals(), Motion(still, (), Clocks()), protocol)


def test_signs_that_are_meant() -> None:
    assert not checked(turned(up_and_down()), AS_MEANT)


def test_a_sign_turned_by_mistake() -> None:
    """The signals are turned already."""
    assert doubted(checked(turned(up_and_down()), DOWN))["force_sign"].endswith(
        "while the specimen is loaded: 'curve.reverse' turns force and displacement, which counts "
        "the right way without"
    )


def test_results_that_have_no_sign_stay_ok() -> None:
    record = turned(up_and_down())
    _, results = reduced(*record.arrays(), more=RESULTS)
    assert results["energy.1"].status is Status.OK
    for name in ("peak_force.1", "peak_displacement.2"):
        assert results[name].status is Status.DOUBTFUL
        assert "_reversed: " in results[name].why
    assert results["stiffness"].why.startswith("force_reversed: ")
    assert "; not_reached: " in results["stiffness"].why


def test_one_line_turns_a_frame_that_counts_down(tmp_path: Path) -> None:
    numbers = {}
    for name, sign in (("up", 1.0), ("down", -1.0)):
        lab, record = TensileLab(tmp_path, name), up_and_down(rate=20.0, cycles=1)
        write_pull(lab, "tensile", sign * 100.0 * record.force, sign * record.displacement)
        if sign < 0.0:
            lab.override("curve.reverse", "[force, displacement]")
        assert main(["process", str(lab.raw), "--no-figures"]) == 1  # it does not break
        found = lab.results
        assert "force_reversed" not in lab.notes
        numbers[name] = {each: (found[each]["value"], found[each]["status"]) for each in found}
    assert numbers["up"] == numbers["down"]
    assert numbers["down"]["peak_force.1"][0] == pytest.approx(100.0, rel=0.01)


@pytest.mark.parametrize("value", ["displacement", "[force, force]", "[travel]", "3"])
def test_words_of_the_override(
    tmp_path: Path, value: str, capsys: pytest.CaptureFixture[str]
) -> None:
    lab, record = TensileLab(tmp_path, "T"), up_and_down(rate=20.0, cycles=1)
    write_pull(lab, "tensile", record.force, record.displacement)
    lab.override("curve.reverse", value)
    assert main(["process", str(lab.raw), "--no-figures"]) == 2
    said = capsys.readouterr().err
    assert "expected a list of 'force' and 'displacement', or of neither" in said


@pytest.mark.realdata
def test_a_bone_in_compression(realdata: Path, tmp_path: Path) -> None:
    (source,) = (realdata / "mts" / "FDA").glob("*/*.txt")
    lab = TensileLab(tmp_path, "bone")
    lab.raw.mkdir(parents=True)
    shutil.copy(source, lab.raw / "bone.txt")
    lab.sheet.write_text(
        "test: bone\nprotocol: three-point-bend\n"
        'specimen: {type: bone, spool: "1", sample: "1", span: 8 mm}\nfiles: {frame: bone.txt}\n',
        encoding="utf-8",
    )
    lab.override("curve.reverse", "[force, displacement]")
    lab.override("results.two-segments.from", "0.05 mm")
    lab.override("results.two-segments.to", "0.3 mm")
    main(["process", str(lab.raw), "--no-figures"])
    peak = lab.results["peak_force.1"]
    assert peak["status"] == "ok"
    rows = [line.split("\t") for line in source.read_text("utf-8-sig").splitlines()[8:] if line]
    largest = max(-1e3 * float(row[1]) for row in rows)
    assert peak["value"] == pytest.approx(largest, rel=1e-6)
    assert lab.results["segment_stiffness_first"]["value"] > 0.0
