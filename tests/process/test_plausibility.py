"""What a careful person would see in a recording: seen, and doubted where it matters."""

from __future__ import annotations

from dataclasses import replace
from datetime import date
from pathlib import Path

import numpy as np
import pytest

from labpipe.process.calibrated_signals import check_channels
from labpipe.process.certificates import (
    check_due,
    day_of_test,
    instruments_of,
)
from labpipe.process.motion import Motion
from labpipe.process.sanity_checks import (
    check_rest,
    check_rig,
    check_signs,
    file_is_cut,
    find_cut_ends,
)
from labpipe.protocol.load import parse_protocol
from labpipe.protocol.schema import Protocol
from labpipe.records.arrays import Floats
from labpipe.records.curve import Branch, ClockFit, Interval, Shape
from labpipe.records.quality import Finding, Findings, warning
from labpipe.records.recording import Recording
from labpipe.records.result import Instrument
from labpipe.records.signals import Clocks, Signal, Signals
from labpipe.signal.turning_points import find_strokes, split_branches
from tests.builders.plain_records import PlainRecord, up_and_down
from tests.builders.pulls import LINE, pull, pulled
from tests.builders.reasons import doubted
from tests.builders.reduced import reduced

TIME = np.arange(0.0, 50.0, 0.02)


@pytest.fixture(scope="module")
def protocol(repository: Path) -> Protocol:
    path = repository / "protocols" / "wire-cantilever.yaml"
    text = path.read_text(encoding="utf-8")
    text = text.replace("stroke: 53 mm", "stroke: 20 mm").replace("cycles: 3", "cycles: 1")
    return parse_protocol(text, "wire-cantilever.yaml")


def travel(*corners: tuple[float, float]) -> Floats:
    """A motion through (time s, position mm) corners."""
    times, places = zip(*corners, strict=True)
    noise = np.random.default_rng(1).normal(0, 1e-5, len(TIME))
    motion: Floats = 1e-3 * np.interp(TIME, times, places) + noise
    return motion


def seen(motion: Floats, force: Floats | None = None) -> Signals:
    made = Signals(displacement="deflection")
    pull = 20.0 * motion if force is None else force
    for name, values, unit in (
        ("travel", motion, "m"),
        ("deflection", motion, "m"),
        ("force", pull, "N"),
    ):
        made = made.with_new(name, Signal(TIME, values, unit, "markers"))
    return made


def looked_at(
    signals: Signals, protocol: Protocol, motion: Floats, shape: Shape | None = None
) -> list[Finding]:
    return list(check_rig(signals, shape, protocol, branches(motion), is_blocked=False))


def rest_looked_at(signals: Signals, stretches: dict[str, tuple[float, float]]) -> list[Finding]:
    zeroed = replace(signals, zeroed=stretches)
    motion = Motion(signals.raw["travel"], branches(SHARP), Clocks("markers"))
    return list(check_rest(zeroed, motion))


SHARP = travel((0, 0), (5, 0), (25, 20), (45, 0), (50, 0))


def branches(motion: Floats) -> tuple[Branch, ...]:
    return split_branches(TIME, find_strokes(TIME, motion, min_stroke=5e-3))


def test_stroke_and_cycles(protocol: Protocol) -> None:
    motion = travel((0, 0), (5, 0), (15, 10), (25, 0), (35, 10), (45, 0), (50, 0))
    found = looked_at(seen(motion), protocol, motion)
    cycles, stroke = (finding.note.message for finding in found)
    assert cycles == "2 cycles measured, the protocol expects 1"
    assert stroke.startswith("a stroke of 10.0")
    assert stroke.endswith("mm measured, 20 mm expected")
    assert not doubted(found)


@pytest.mark.parametrize(
    ("since", "lost", "is_doubted"), [(30.0, 0.25, True), (46.0, 0.026, False), (30.0, 0.0, False)]
)
def test_a_string_cannot_push(
    protocol: Protocol, since: float, lost: float, is_doubted: bool
) -> None:
    """A slack one may lose the counterweight."""
    pull = 20.0 * SHARP - np.where(since < TIME, lost, 0.0)
    why = doubted(looked_at(seen(SHARP, pull), protocol, SHARP)).get("force", "")
    assert why.startswith("force_negative: the force falls to -0.2" if is_doubted else "")
    assert ("a string cannot push: the zero is wrong or drifts" in why) is is_doubted


def shape(length: float) -> Shape:
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


@pytest.mark.parametrize(("length", "off"), [(0.0851, False), (0.1, True), (0.075, True)])
def test_length_of_the_specimen(protocol: Protocol, length: float, off: bool) -> None:
    why = doubted(looked_at(seen(SHARP), protocol, SHARP, shape(length)))
    assert ("displacement" in why) == off
    if off:
        assert why["displacement"].startswith("length_unexpected: ")
        assert "the sheet says 85 mm" in why["displacement"]


def driven(speed: str, *, scale: float = 1.0) -> list[Finding]:
    """A motion of 20 mm in 20 s, the rig set to a speed, the numbers off by a factor."""
    text = (
        "version: 1\nname: p\nsources: {frame: {reader: dspace-csv, channels:"
        " {displacement: {channel: a}, force: {channel: b}}}}\n"
        f"rig: {{crosshead_speed: {speed}}}\n"
        "curve: {force: force, displacement: displacement}\n"
        "branches: {channel: displacement, min_stroke: 1 um}\n"
    )
    made = Signals().with_new("displacement", Signal(TIME, scale * SHARP, "m", "frame"))
    made = made.with_new("force", Signal(TIME, SHARP, "N", "frame"))
    parts = split_branches(TIME, find_strokes(TIME, scale * SHARP, min_stroke=5e-3 * scale))
    return list(check_rig(made, None, parse_protocol(text, "p.yaml"), parts, is_blocked=False))


@pytest.mark.parametrize(
    ("speed", "scale", "is_doubted"),
    [
        *((f"{speed} mm/s", 1.0, False) for speed in (1.0, 0.9, 1.15)),
        ("1.3 mm/s", 1.0, True),
        *(("1 mm/s", scale, True) for scale in (1e-3, 1 / 25.4, 25.4)),
    ],
)
def test_the_speed_of_the_rig(speed: str, scale: float, is_doubted: bool) -> None:
    """Another one is doubted, and so is another unit of the export."""
    findings = driven(speed, scale=scale)
    assert [(finding.code, finding.note.where) for finding in findings] == (
        [("speed_unexpected", "rig.crosshead_speed")] if is_doubted else []
    )
    assert set(doubted(findings)) == ({"displacement", "force"} if is_doubted else set())


def test_kilonewtons_taken_for_newtons() -> None:
    travel, force = pull()
    peak = "plausible_peak: {from: 20 N, to: 2 kN}"
    for scale, is_doubted in ((1.0, False), (1e-3, True)):
        asked = ["peak-force", "peak-displacement", LINE]
        _, results = pulled(travel, scale * force, more=peak, results=asked)
        for name, has_force in (
            ("peak_force.1", True),
            ("stiffness", True),
            ("peak_displacement.1", False),
        ):
            assert ("implausible_peak: " in results[name].why) is (is_doubted and has_force)


@pytest.mark.parametrize(("name", "quantity"), [("force", "force"), ("deflection", "displacement")])
def test_a_zero_taken_in_motion(name: str, quantity: str) -> None:
    assert doubted(rest_looked_at(seen(SHARP), {name: (4.0, 6.0)}))[quantity].startswith(
        "zero_not_at_rest: zeroed from 4.00 s to 6.00 s of the motion's clock, but the clamp moves"
    )


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


@pytest.mark.parametrize("start", [0.0, 0.8])
def test_a_crosshead_that_counts_down(start: float) -> None:
    record = turned(up_and_down(), force=1.0)
    findings = checked(replace(record, displacement=record.displacement + start))
    assert set(doubted(findings)) == {"displacement"}
    assert "'curve.reverse: {value: [displacement], " in doubted(findings)["displacement"]


def test_a_reversed_bridge() -> None:
    """The clocks were joined at its peaks."""
    record = turned(up_and_down(), path=1.0)
    assert set(doubted(checked(record))) == {"force"}
    nothing, known = np.array([0.0]), Interval(-1.0, 1.0)
    fit = ClockFit(0.0, 0.0, known, known, 0.0, nothing, nothing, nothing, "")
    joined = checked(record, clocks=Clocks("frame", fit))
    assert {finding.code for finding in joined} == {"force_reversed"}
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


def test_a_sign_turned_by_mistake() -> None:
    """The signals are turned already."""
    assert doubted(checked(turned(up_and_down()), DOWN))["force_sign"].endswith(
        "while the specimen is loaded: 'curve.reverse' turns force and displacement, which have "
        "the right sign without it"
    )


def test_one_line_turns_a_frame_that_counts_down() -> None:
    turn = (
        "displacement: displacement}",
        "displacement: displacement, reverse: [force, displacement]}",
    )
    record = up_and_down(cycles=1)
    _, up = reduced(*record.arrays())
    test, down = reduced(*turned(record).arrays(), replaced=turn)
    assert "force_reversed" not in str(test.findings.notes)
    assert {name: (result.value, result.status) for name, result in down.items()} == {
        name: (result.value, result.status) for name, result in up.items()
    }


def ended(record: PlainRecord, *codes: str, full: bool = False) -> float:
    """Return the ends that `find_cut_ends` finds."""
    time, displacement, force = record.arrays()
    motion = Signal(time, displacement, "m", "frame")
    signals = Signals(raw={"displacement": motion, "force": Signal(time, force, "N", "frame")})
    read = Findings(tuple(warning(code, "frame: file", "rows are missing") for code in codes))
    branches = split_branches(time, find_strokes(time, displacement, min_stroke=1e-3))
    ends = find_cut_ends(
        signals,
        Motion(motion, branches, Clocks("frame")),
        is_full_stroke=full,
        is_cut_file=file_is_cut(read),
    )
    return ends.get("force", np.inf)


@pytest.mark.parametrize("code", ["truncated", "rows_differ"])
def test_a_file_with_fewer_rows_than_it_promised(code: str) -> None:
    """It may have come back by chance: nobody knows what the lost rows held."""
    record = up_and_down()
    assert ended(record.up_to(21.96)) == np.inf
    assert ended(record.up_to(21.96), code) == pytest.approx(21.96)
    assert ended(record, code) == np.inf  # what is lost is rest
    assert ended(record.up_to(6.8)) == pytest.approx(6.8)
    assert ended(record.up_to(6.8), full=True) == np.inf  # the rig was told that stroke


def test_a_full_force_touches_the_clocks_that_it_joins() -> None:
    protocol = parse_protocol(
        "version: 1\nname: p\nsources:\n"
        "  force: {reader: dspace-mat, channel: A, unit: V, calibration: {gain: 0.5 N/V}}\n"
        "align: {method: common-start, channel: force, max_offset: 1 s}\n",
        "p.yaml",
    )
    time: Floats = np.arange(0.0, 2.0, 1e-3)
    noise = np.random.default_rng(1).normal(0.0, 0.01, 2000)
    for volts, seen in (
        (np.minimum(2.0 * np.sin(np.pi * time / 2.0) + noise, 1.9), {"force", "clock"}),
        (2.0 * np.sin(np.pi * time / 2.0) + noise, set()),
        (np.zeros(2000), set()),
    ):
        signals = Signals(raw={"force": Signal(time, 0.5 * volts, "N", "force")})
        assert set(doubted(check_channels(signals, protocol))) == seen


DUE, AFTER = date(2026, 1, 10), date(2026, 1, 11)


CERTIFICATE = f"certificate: {{number: LC-7, date: 2025-01-10, due: {DUE}}}"


CHANNELS = f"""\
version: 1
name: p
sources:
  frame:
    reader: load-frame
    channels:
      force: {{channel: F, {CERTIFICATE}}}
      displacement: {{channel: D}}
curve: {{force: force, displacement: displacement}}
"""


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


@pytest.mark.parametrize(
    ("text", "where", "quantities"),
    [
        (CHANNELS, "force", {"force"}),
        (CAMERAS, "markers", {"displacement", "mid_span"}),
        (BESIDE, "markers", {"mid_span"}),
        (BY_SPEED, "markers", {"mid_span"}),
    ],
    ids=["channel", "cameras", "cameras beside a frame", "cameras beside a speed"],
)
def test_a_test_after_the_day_is_doubted(text: str, where: str, quantities: set[str]) -> None:
    """Cameras stand for the displacement only where nothing else measures it."""
    protocol = parse_protocol(text, "p.yaml")
    (finding,) = check_due(protocol, AFTER)
    assert (finding.code, finding.note.where) == ("calibration_overdue", where)
    assert finding.note.message == (
        "calibration LC-7 of 2025-01-10 expired on 2026-01-10, before the test on "
        "2026-01-11: have the instrument calibrated"
    )
    assert {doubt.quantity for doubt in finding.doubts} == quantities
    for tested in (None, DUE, date(2025, 6, 1)):
        assert not list(check_due(protocol, tested))


def test_forces_of_a_late_test_are_doubtful_and_displacements_are_not() -> None:
    for tested, late in ((AFTER, True), (DUE, False)):
        asked = ["peak-force", "peak-displacement"]
        _, found = pulled(*pull(), more=CERTIFICATE, results=asked, tested=tested)
        assert ("calibration_overdue: " in found["peak_force.1"].why) is late
        assert "calibration_overdue" not in found["peak_displacement.1"].why


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
    assert day_of_test(sheet, exports) == day


def test_instruments_are_those_with_a_certificate() -> None:
    certificate = CERTIFICATE.replace("}", ", uncertainty: 0.5 %, k: 3}")
    (found,) = instruments_of(parse_protocol(CHANNELS.replace(CERTIFICATE, certificate), "p.yaml"))
    assert found == Instrument("force", ("force",), "LC-7", date(2025, 1, 10), DUE, 0.005, 3.0)
    (cameras,) = instruments_of(parse_protocol(CAMERAS, "p.yaml"))
    assert (cameras.channel, cameras.measures) == ("markers", ("mid_span", "displacement"))
    assert (cameras.uncertainty, cameras.k) == (None, 2.0)
