"""Certificates whose next calibration was due before a test, and what they make doubtful."""

from __future__ import annotations

from datetime import date

import pytest

from labpipe.process.certificates import (
    check_due,
    day_of_test,
    instruments_of,
    operator_of_test,
)
from labpipe.protocol.load import parse_protocol
from labpipe.protocol.schema import Protocol
from labpipe.records.recording import Recording
from labpipe.records.result import Instrument
from tests.builders.pulls import pull, pulled
from tests.builders.three_point import BendingRecord, reduced

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


def protocol(text: str) -> Protocol:
    return parse_protocol(text, "p.yaml")


def test_a_test_after_the_day_is_doubted() -> None:
    (found,) = check_due(protocol(CHANNELS), AFTER)
    assert (found.code, found.note.where) == ("calibration_overdue", "force")
    assert found.note.message == (
        "calibration LC-7 of 2025-01-10 was due again on 2026-01-10, the test was made on "
        "2026-01-11: have the instrument calibrated"
    )
    assert [doubt.quantity for doubt in found.doubts] == ["force"]


@pytest.mark.parametrize("tested", [None, DUE, date(2025, 6, 1)])
def test_a_test_up_to_the_day_or_of_an_unknown_day_is_not(tested: date | None) -> None:
    assert not list(check_due(protocol(CHANNELS), tested))


def test_cameras_stand_for_the_displacement_that_nothing_else_measures() -> None:
    (found,) = check_due(protocol(CAMERAS), AFTER)
    assert found.note.where == "markers"
    assert {doubt.quantity for doubt in found.doubts} == {"displacement", "mid_span"}
    beside = CAMERAS.replace("displacement: deflection", "displacement: d").replace(
        "  markers:",
        "  frame: {reader: dspace-mat, channels: {d: {channel: b, unit: mm, "
        "quantity: length}}}\n  markers:",
    )
    (found,) = check_due(protocol(beside), AFTER)
    assert [doubt.quantity for doubt in found.doubts] == ["mid_span"]


def test_a_displacement_by_speed_is_not_that_of_the_cameras() -> None:
    driven = CAMERAS.replace("displacement: deflection", "displacement: way").replace(
        "  - {step: repair",
        "  - {step: travel-from-speed, channel: way, force: force}\n  - {step: repair",
    )
    rig = "rig: {crosshead_speed: 1 mm/s, stroke: 10 mm, cycles: 1}\n"
    (found,) = check_due(protocol(driven + rig), AFTER)
    assert [doubt.quantity for doubt in found.doubts] == ["mid_span"]


def test_what_has_no_day_has_no_due() -> None:
    undated = CHANNELS.replace(f", due: {DUE}", "")
    assert not list(check_due(protocol(undated), AFTER))


def test_forces_of_a_late_test_are_doubtful_and_displacements_are_not() -> None:
    for tested, late in ((AFTER, True), (DUE, False)):
        asked = ["peak-force", "peak-displacement"]
        _, found = pulled(*pull(), more=CERTIFICATE, results=asked, tested=tested)
        assert ("calibration_overdue: " in found["peak_force.1"].why) is late
        assert "calibration_overdue" not in found["peak_displacement.1"].why


@pytest.mark.slow
def test_bends_that_cameras_saw_too_late_are_doubtful() -> None:
    change = (("reader: [motive-csv", f"{CERTIFICATE}\n    reader: [motive-csv"),)
    _, found = reduced(BendingRecord(), change=change, tested=AFTER)
    doubtful = {each.name for each in found.values() if "calibration_overdue" in each.why}
    assert doubtful == {"mid_span_bending_stiffness", "mid_span_curvature"}


@pytest.mark.parametrize(
    ("sheet", "metadata", "day"),
    [
        ("date: 2026-03-04", {"date": "2026-05-06"}, date(2026, 3, 4)),
        ("date: '2026-03-04'", {}, date(2026, 3, 4)),
        ("test: a", {"date": "2026-05-06"}, date(2026, 5, 6)),
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
    (found,) = instruments_of(protocol(CHANNELS.replace(CERTIFICATE, certificate)))
    assert found == Instrument("force", ("force",), "LC-7", date(2025, 1, 10), DUE, 0.005, 3.0)
    (cameras,) = instruments_of(protocol(CAMERAS))
    assert (cameras.channel, cameras.measures) == ("markers", ("mid_span", "displacement"))
    assert (cameras.uncertainty, cameras.k) == (None, 2.0)


@pytest.mark.parametrize(
    ("sheet", "operator"),
    [("operator: Zoë", "Zoë"), ("operator:", ""), ("operator: [a]", ""), ("test: a", ""), ("", "")],
)
def test_operator_is_who_the_sheet_says(sheet: str, operator: str) -> None:
    assert operator_of_test(sheet) == operator
