"""What a careful person would see in a recording: seen, and doubted where it matters."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from datetime import date
from pathlib import Path

import numpy as np
import pytest

from labpipe.process.motion import Motion
from labpipe.process.run import find_date_and_operator
from labpipe.process.sanity_checks import (
    check_calibration_due,
    check_lost_samples,
    check_lowest_force,
    check_rig,
    check_signs,
    check_zeros,
    find_cut_ends,
    list_certified_instruments,
)
from labpipe.process.steps import PreparedTest, check_channels
from labpipe.protocol.load import parse_protocol
from labpipe.protocol.schema import Protocol
from labpipe.records.arrays import Floats
from labpipe.records.curve import Branch, ClockFit, Interval, Shape
from labpipe.records.quality import Finding, Findings, QualityNote, Severity
from labpipe.records.recording import Recording
from labpipe.records.result import Instrument
from labpipe.records.signals import Clocks, Signal, Signals
from labpipe.signal.turning_points import find_strokes, make_branches
from tests.approved import Approve
from tests.builders.plain_records import PlainRecord, up_and_down
from tests.builders.pulls import pull, pulled
from tests.builders.reasons import doubted
from tests.builders.reduced import reduced

TIME = np.arange(0.0, 50.0, 0.02)
WIRE = parse_protocol(
    (Path(__file__).parents[2] / "protocols" / "wire-cantilever.yaml")
    .read_text(encoding="utf-8")
    .replace("stroke: 53 mm", "stroke: 20 mm")
    .replace("cycles: 3", "cycles: 1"),
    "wire-cantilever.yaml",
)


def travel(*corners: tuple[float, float]) -> Floats:
    """A motion through (time s, position mm) corners."""
    times, places = zip(*corners, strict=True)
    noise = np.random.default_rng(1).normal(0, 1e-5, len(TIME))
    motion: Floats = 1e-3 * np.interp(TIME, times, places) + noise
    return motion


SHARP = travel((0, 0), (5, 0), (25, 20), (45, 0), (50, 0))
LOST = np.concatenate([SHARP[:600], SHARP[625:], SHARP[-25:]])
"""Half a second of frames was lost, without a gap in the times."""
TWO_SHORT = travel((0, 0), (5, 0), (15, 10), (25, 0), (35, 10), (45, 0), (50, 0))


def signals_of(motion: Floats, force: Floats | None = None) -> Signals:
    signals = Signals(displacement="deflection")
    for name, values, unit in (
        ("travel", motion, "m"),
        ("deflection", motion, "m"),
        ("force", 20.0 * motion if force is None else force, "N"),
    ):
        clock = "force" if name == "force" else "markers"
        signals = signals.add_signal(name, Signal(TIME, values, unit, clock))
    return signals


def branches_of(motion: Floats, shortest: float = 5e-3) -> tuple[Branch, ...]:
    return make_branches(TIME, find_strokes(TIME, motion, min_stroke=shortest))


def of_rig(motion: Floats, force: Floats | None = None, length: float | None = None) -> Findings:
    signals = signals_of(motion, force)
    prepared = PreparedTest(signals, shape=None if length is None else shape_of(length))
    return of_limits(prepared, branches_of(motion), WIRE)


def of_limits(prepared: PreparedTest, branches: tuple[Branch, ...], protocol: Protocol) -> Findings:
    assert protocol.branches is not None
    motion = Motion(prepared.signals.raw[protocol.branches.channel], branches, Clocks("markers"))
    checks = check_rig, check_lost_samples, check_lowest_force
    return Findings(tuple(x for check in checks for x in check(prepared, motion, protocol)))


def of_slack(since: float, lost: float) -> Findings:
    """A slack string may lose the counterweight, and no more."""
    return of_rig(SHARP, 20.0 * SHARP - np.where(since < TIME, lost, 0.0))


def of_rest(name: str) -> Findings:
    zeroed = replace(signals_of(SHARP), zero_stretches={name: (4.0, 6.0)})
    motion = Motion(zeroed.raw["travel"], branches_of(SHARP), Clocks("markers"))
    return Findings() + check_zeros(PreparedTest(zeroed), motion, WIRE)


def shape_of(length: float) -> Shape:
    return Shape(
        time=TIME[:1],
        positions=np.zeros((1, 2, 3)),
        names=("clamped end", "pull point"),
        flags=np.ones((1, 2), dtype=np.uint8),
        arc_length=np.array([0.0, length]),
        coefficients=np.zeros((1, 3, 0)),
        length=length,
        rotation_lab_to_specimen=np.eye(3),
    )


def of_speed(speed: str, scale: float = 1.0, pause: float = 0.0) -> Findings:
    """A motion of 20 mm in 20 s, the rig set to a speed, the numbers off by a factor."""
    text = PROTOCOL % "" + f"rig: {{crosshead_speed: {speed}}}\n"
    time = TIME + np.where(TIME > 10.0, pause, 0.0)
    signals = Signals().add_signal("displacement", Signal(time, scale * SHARP, "m", "frame"))
    signals = signals.add_signal("force", Signal(TIME, SHARP, "N", "frame"))
    parts = [
        replace(part, start_time=time[part.start], stop_time=time[part.stop - 1])
        for part in branches_of(scale * SHARP, 5e-3 * scale)
    ]
    return of_limits(PreparedTest(signals), tuple(parts), parse_protocol(text, "p.yaml"))


PROTOCOL = """\
version: 1
name: p
sources:
  frame:
    reader: load-frame
    channels: {force: {channel: A, unit: N}, displacement: {channel: B, unit: mm}}
curve: {force: force, displacement: displacement%s}
branches: {channel: displacement, min_stroke: 1 um}
"""
NOTHING = np.array([0.0])
JOINED = ClockFit(
    *(0.0, 0.0, Interval(-1.0, 1.0), Interval(-1.0, 1.0), 0.0, NOTHING, NOTHING, NOTHING, "")
)


def turned(record: PlainRecord, *, force: float = -1.0, path: float = -1.0) -> PlainRecord:
    return replace(record, force=force * record.force, displacement=path * record.displacement)


def moved(record: PlainRecord, *, force: float = 0.0, path: float = 0.0) -> PlainRecord:
    return replace(record, force=record.force + force, displacement=record.displacement + path)


def of_signs(record: PlainRecord, reverse: str = "", fit: ClockFit | None = None) -> Findings:
    """What is found in that record as it was measured."""
    time, displacement, force = record.arrays()
    signals = Signals().add_signal("force", Signal(time, force, "N", "frame"))
    signals = signals.add_signal("displacement", Signal(time, displacement, "m", "frame"))
    branches = make_branches(time, find_strokes(time, displacement, min_stroke=1e-3))
    motion = Motion(signals.raw["displacement"], branches, Clocks("frame", fit))
    protocol = parse_protocol(PROTOCOL % reverse, "p.yaml")
    return Findings() + check_signs(PreparedTest(signals), motion, protocol)


RECORD = up_and_down()
NOISE = replace(RECORD, force=np.random.default_rng(0).normal(0.0, 0.1, 1200))
DOWN = ", reverse: [force, displacement]"
SEEN: dict[str, Callable[[], Findings]] = {
    "as it should be": lambda: of_rig(SHARP, length=0.0851),
    "frames lost in loading": lambda: of_rig(LOST),
    "forces lost in loading": lambda: of_rig(SHARP, 20.0 * LOST),
    "a force that slips": lambda: of_rig(SHARP, 20.0 * SHARP - np.where(TIME < 12.0, 0.0, 0.01)),
    "stroke and cycles": lambda: of_rig(TWO_SHORT),
    "a force that pushes": lambda: of_slack(30.0, 0.25),
    "a string that is slack": lambda: of_slack(46.0, 0.026),
    "a longer specimen": lambda: of_rig(SHARP, length=0.1),
    "a shorter specimen": lambda: of_rig(SHARP, length=0.075),
    "the speed, nearly": lambda: of_speed("0.9 mm/s") + of_speed("1.15 mm/s").entries,
    "a pause of a minute": lambda: of_speed("1 mm/s", pause=60.0),
    "another speed": lambda: of_speed("1.3 mm/s"),
    "metres for millimetres": lambda: of_speed("1 mm/s", 1e-3),
    "inches for millimetres": lambda: of_speed("1 mm/s", 1 / 25.4),
    "millimetres for inches": lambda: of_speed("1 mm/s", 25.4),
    "the force zeroed in motion": lambda: of_rest("force"),
    "the deflection zeroed in motion": lambda: of_rest("deflection"),
    "a crosshead that counts down": lambda: of_signs(turned(RECORD, force=1.0)),
    "a crosshead that counts down from 0.8 m": lambda: of_signs(
        moved(turned(RECORD, force=1.0), path=0.8)
    ),
    "a reversed bridge": lambda: of_signs(turned(RECORD, path=1.0)),
    "a reversed bridge whose peaks join clocks": lambda: of_signs(
        turned(RECORD, path=1.0), fit=JOINED
    ),
    "signs that are right": lambda: of_signs(RECORD),
    "loaded both ways": lambda: of_signs(
        turned(moved(up_and_down(cycles=3), force=-0.5, path=-5e-3))
    ),
    "noise": lambda: of_signs(NOISE),
    "no force": lambda: of_signs(replace(RECORD, force=np.full(1200, np.nan))),
    "another zero of the force": lambda: of_signs(moved(RECORD, force=-0.1)),
    "another zero of the displacement": lambda: of_signs(moved(RECORD, path=-0.8)),
    "turned by mistake": lambda: of_signs(turned(RECORD), DOWN),
}


def lines(findings: Iterable[Finding]) -> list[str]:
    return [
        f"{finding.code} of {finding.note.where}, doubts "
        f"{' '.join(sorted(doubt.quantity for doubt in finding.doubts)) or 'nothing'}: "
        f"{finding.note.message}"
        for finding in findings
    ]


@pytest.mark.parametrize("name", SEEN)
def test_what_is_seen_and_doubted(name: str, approved: Approve) -> None:
    approved(lines(SEEN[name]().entries))


def test_kilonewtons_taken_for_newtons() -> None:
    peak, asked = "plausible_peak: {from: 20 N, to: 2 kN}", ["peak-force", "peak-displacement"]
    path, force = pull()
    for scale, is_doubted in ((1.0, False), (1e-3, True)):
        _, results = pulled(path, scale * force, more=peak, results=asked)
        assert ("implausible_peak: " in results["peak_force.1"].reason_text) is is_doubted
        assert "implausible_peak: " not in results["peak_displacement.1"].reason_text


@pytest.mark.parametrize(
    ("first", "last", "breaks", "is_doubted"),
    [(6.6, 7.3, False, True), (4.0, 5.0, False, False), (4.0, 5.0, True, True)],
)
def test_a_hole_in_the_times_hides_a_peak(
    first: float, last: float, *, breaks: bool, is_doubted: bool
) -> None:
    """At the turn after 7 s, or where the force is largest because the specimen breaks."""
    record = up_and_down(cycles=1)
    kept = (record.time < first) | (record.time > last)
    time, path, force = record.where(kept).arrays()
    test, results = reduced(time, path, np.where(breaks & (time > last), 0.01, 1.0) * force)
    assert ("turn_not_seen" in str(doubted(test))) is is_doubted
    assert ("turn_not_seen" in results["peak_force.1"].reason_text) is is_doubted


def test_one_line_turns_a_frame_that_counts_down() -> None:
    turn = ("displacement: displacement}", f"displacement: displacement{DOWN}}}")
    record = up_and_down(cycles=1)
    _, up = reduced(*record.arrays())
    test, down = reduced(*turned(record).arrays(), replaced=turn)
    assert "force_reversed" not in str(test.findings.notes)
    assert {name: (result.value, result.status) for name, result in down.items()} == {
        name: (result.value, result.status) for name, result in up.items()
    }


@pytest.mark.parametrize(
    ("record", "codes", "is_full", "expected"),
    [
        (RECORD.up_to(21.96), (), False, np.inf),
        (RECORD.up_to(21.96), ("truncated",), False, 21.96),
        (RECORD.up_to(21.96), ("rows_differ",), False, 21.96),
        (RECORD, ("truncated",), False, np.inf),  # what is lost is rest
        (RECORD.up_to(6.8), (), False, 6.8),
        (RECORD.up_to(6.8), (), True, np.inf),  # the rig was told that stroke
    ],
)
def test_a_file_with_fewer_rows_than_it_promised(
    record: PlainRecord, codes: tuple[str, ...], is_full: bool, expected: float
) -> None:
    """It may have come back by chance: nobody knows what the lost rows held."""
    time, displacement, force = record.arrays()
    motion = Signal(time, displacement, "m", "frame")
    signals = Signals(raw={"displacement": motion, "force": Signal(time, force, "N", "frame")})
    notes = [QualityNote(code, Severity.WARNING, "frame: file", "") for code in codes]
    branches = make_branches(time, find_strokes(time, displacement, min_stroke=1e-3))
    rig = f"rig: {{stroke: {np.ptp(displacement)} m}}\n" if is_full else ""
    ends = find_cut_ends(
        signals,
        Motion(motion, branches, Clocks("frame")),
        parse_protocol(PROTOCOL % "" + rig, "p.yaml"),
        Findings(tuple(map(Finding, notes))),
    )
    assert ends.get("force", np.inf) == pytest.approx(expected)


def test_a_full_force_touches_the_clocks_that_it_joins() -> None:
    protocol = parse_protocol(
        "version: 1\nname: p\nsources:\n"
        "  force: {reader: dspace-mat, channel: A, unit: V, calibration: {gain: 0.5 N/V}}\n"
        "align: {method: common-start, channel: force, max_offset: 1 s}\n",
        "p.yaml",
    )
    time: Floats = np.arange(0.0, 2.0, 1e-3)
    noise = np.random.default_rng(1).normal(0.0, 0.01, 2000)
    for volts, quantities in (
        (np.minimum(2.0 * np.sin(np.pi * time / 2.0) + noise, 1.9), {"force", "clock"}),
        (2.0 * np.sin(np.pi * time / 2.0) + noise, set()),
        (np.zeros(2000), set()),
    ):
        signals = Signals(raw={"force": Signal(time, 0.5 * volts, "N", "force")})
        assert set(doubted(check_channels(signals, protocol))) == quantities


DUE, AFTER = date(2026, 1, 10), date(2026, 1, 11)
CERTIFICATE = f"certificate: {{number: LC-7, date: 2025-01-10, due: {DUE}}}"
CHANNELS = PROTOCOL.replace("unit: N", f"unit: N, {CERTIFICATE}") % ""
CAMERAS = f"""\
version: 1
name: p
sources:
  force: {{reader: dspace-mat, channel: a, unit: N}}
  markers: {{reader: motive-csv, {CERTIFICATE}}}
markers: {{clamp: Clamp}}
align: {{method: stated, offset: 0 s, because: one lamp}}
steps:
  - {{step: repair-markers, max_gap: 1 s, max_jump: 4 mm, frozen: 1 s}}
  - {{step: specimen-frame, over: 1 s}}
  - {{step: fit-shape, terms: 4, tip: free}}
curve: {{force: force, displacement: deflection}}
"""
BESIDE = CAMERAS.replace("displacement: deflection", "displacement: d").replace(
    "  markers:",
    "  frame: {reader: dspace-mat, channels: {d: {channel: b, unit: mm, quantity: length}}}\n"
    "  markers:",
)
BY_SPEED = CAMERAS.replace("displacement: deflection", "displacement: way").replace(
    "steps:\n",
    "rig: {crosshead_speed: 1 mm/s, stroke: 10 mm, cycles: 1}\nsteps:\n"
    "  - {step: travel-from-speed, channel: way, force: force}\n",
)


def test_a_test_after_the_day_is_doubted(approved: Approve) -> None:
    """Cameras stand for the displacement only where nothing else measures it."""
    protocols: list[Protocol] = [
        parse_protocol(text, "p.yaml") for text in (CHANNELS, CAMERAS, BESIDE, BY_SPEED)
    ]
    approved(
        line for protocol in protocols for line in lines(check_calibration_due(protocol, AFTER))
    )
    for protocol in protocols:
        for tested in (None, DUE, date(2025, 6, 1)):
            assert not list(check_calibration_due(protocol, tested))
    for tested, is_late in ((AFTER, True), (DUE, False)):
        _, results = pulled(*pull(), more=CERTIFICATE, results=["peak-force"], tested=tested)
        assert ("calibration_overdue: " in results["peak_force.1"].reason_text) is is_late


@pytest.mark.parametrize(
    ("sheet", "metadata", "day"),
    [
        ("date: 2026-03-04", {"date": "2026-05-06"}, date(2026, 3, 4)),
        ("date: '2026-03-04'", {}, date(2026, 3, 4)),
        ("date: null", {"start_time": "2026-05-06T23:59:00+00:00"}, date(2026, 5, 6)),
        ("test: a", {"Capture Start Time": "2026-05-06 01.02.03.004 PM"}, date(2026, 5, 6)),
        ("test: a", {"date": "", "Capture Start Time": "6/5/2026"}, None),
        ("test: a", {}, None),
    ],
)
def test_day_of_a_test(sheet: str, metadata: dict[str, object], day: date | None) -> None:
    exports = {"force": Recording("a"), "markers": Recording("b", metadata=metadata)}
    assert find_date_and_operator(sheet, exports)[0] == day


def test_instruments_are_those_with_a_certificate() -> None:
    certificate = CERTIFICATE.replace("}", ", uncertainty: 0.5 %, k: 3}")
    (cell,) = list_certified_instruments(
        parse_protocol(CHANNELS.replace(CERTIFICATE, certificate), "p.yaml")
    )
    assert cell == Instrument("force", ("force",), "LC-7", date(2025, 1, 10), DUE, 0.005, 3.0)
    (cameras,) = list_certified_instruments(parse_protocol(CAMERAS, "p.yaml"))
    assert (cameras.channel, cameras.measures) == ("markers", ("mid_span", "displacement"))
    assert (cameras.uncertainty, cameras.k) == (None, 2.0)
