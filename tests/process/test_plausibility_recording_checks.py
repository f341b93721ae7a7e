"""What a careful person would see in a recording: seen, and doubted where it matters alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.process.calibrated_signals import check_channels
from labpipe.process.motion import Motion
from labpipe.process.plausibility import cut_at, file_is_cut
from labpipe.protocol.load import parse_protocol
from labpipe.records.arrays import Floats
from labpipe.records.quality import Findings, warning
from labpipe.records.result import Status
from labpipe.records.signals import Clocks, Signal, Signals
from labpipe.signal.turning_points import find_strokes, split_branches
from tests.builders.doubts import doubted
from tests.builders.plain_records import PlainRecord, up_and_down
from tests.builders.reduced import reduced

RESULTS = (
    "results:\n  - {result: peak-force}\n  - {result: peak-displacement}\n  - {result: energy}\n"
)


def doubtful(record: PlainRecord, more: str = RESULTS) -> dict[str, str]:
    """Reasons by name of the results that are not ok."""
    _, results = reduced(*record.arrays(), more=more)
    return {name: each.why for name, each in results.items() if each.status is not Status.OK}


@pytest.mark.slow
@pytest.mark.parametrize("rate", [10.0, 50.0, 120.0, 200.0])
@pytest.mark.parametrize("is_round", [False, True])
@pytest.mark.parametrize("noise", [1e-4, 1e-3, 5e-3])
def test_a_record_cut_while_unloading(rate: float, is_round: bool, noise: float) -> None:
    record = up_and_down(rate=rate, is_round=is_round, noise=noise).up_to(19.5)
    found = doubtful(record)
    assert set(found) == {"energy.2"}
    assert found["energy.2"].startswith("partial_cycle: the record ends at 19.")
    assert found["energy.2"].endswith(" s, while still unloading")


@pytest.mark.parametrize("rate", [10.0, 50.0, 120.0, 200.0])
@pytest.mark.parametrize("noise", [1e-4, 5e-3])
def test_a_record_cut_while_loading(rate: float, noise: float) -> None:
    found = doubtful(up_and_down(rate=rate, noise=noise).up_to(15.5))
    assert set(found) == {"peak_force.2", "peak_displacement.2", "energy.2"}
    assert found["peak_force.2"].endswith("while still loading")
    assert found["energy.2"] == "partial_cycle: the cycle has no unloading branch"


@pytest.mark.slow
@pytest.mark.parametrize("rate", [10.0, 50.0, 200.0])
@pytest.mark.parametrize("end", [22.0, 22.5, 30.0])
@pytest.mark.parametrize("noise", [1e-4, 5e-3])
def test_a_record_that_ends_where_the_test_does(rate: float, end: float, noise: float) -> None:
    assert not doubtful(up_and_down(rate=rate, noise=noise).up_to(end))


def test_a_later_peak_ends_the_record() -> None:
    """The second loading came as far as the first."""
    assert set(doubtful(up_and_down().up_to(17.0))) == {"energy.2"}  # it has no unloading


def ended(record: PlainRecord, *codes: str, full: bool = False) -> float:
    """Where `cut_at` finds the record cut."""
    time, displacement, force = record.arrays()
    motion = Signal(time, displacement, "m", "frame")
    signals = Signals(raw={"displacement": motion, "force": Signal(time, force, "N", "frame")})
    read = Findings(tuple(warning(code, "frame: file", "rows are missing") for code in codes))
    branches = split_branches(time, find_strokes(time, displacement, min_stroke=1e-3))
    ends = cut_at(
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


def test_a_stroke_that_the_rig_was_told_is_whole() -> None:
    record = up_and_down().up_to(6.8)
    assert ended(record) == pytest.approx(6.8)
    assert ended(record, full=True) == np.inf


def test_a_force_that_ends_before_the_motion() -> None:
    record = up_and_down()
    record.force[record.time > 15.5] = np.nan
    assert ended(record) == pytest.approx(15.5)
    found = doubtful(record)
    assert found["peak_force.2"].startswith("missing_samples: ")
    assert "partial_cycle: the record ends at 15.5" in found["peak_force.2"]
    assert set(found) == {"peak_force.2", "energy.2"}


def test_a_force_that_is_full_in_each_cycle() -> None:
    record = up_and_down()
    full = replace(record, force=np.minimum(record.force, 0.7))
    test, results = reduced(*full.arrays())
    assert {name for name, each in results.items() if each.status is not Status.OK} == {
        *("peak_force.1", "peak_force.2", "energy.1", "energy.2"),
        *("unloading_stiffness.1", "unloading_stiffness.2"),
        *("residual_displacement.1", "residual_displacement.2"),
    }
    assert results["peak_force.1"].why.startswith("saturation: ")
    (note,) = (note for note in test.findings.notes if note.code == "saturation")
    assert "samples stand at 0.7 N to the last digit, in 2 stretches, and none" in note.message


def test_a_force_that_is_full_for_most_of_the_record() -> None:
    record = up_and_down(rest=0.5)
    found = doubtful(replace(record, force=np.minimum(record.force, 0.3)))
    assert set(found) == {"peak_force.1", "peak_force.2", "energy.1", "energy.2"}


def test_a_frozen_force_is_doubted_then() -> None:
    record = up_and_down(rate=50.0)
    held = (record.time > 13.5) & (record.time < 15.5)  # in the second loading
    record.force[held] = record.force[held][0]
    found = doubtful(record)
    assert set(found) == {"peak_force.2", "energy.2"}
    assert found["energy.2"].startswith("frozen_channel: stands at 0.30")
    assert " from 13.500 to 15.500 s while the test goes on: frozen" in found["energy.2"]


def test_a_frozen_motion_is_doubted_then() -> None:
    """Its branches are not where they were, so that the force of the cycle is doubtful, too."""
    record = up_and_down(noise=1e-4)
    held = (record.time > 13.5) & (record.time < 15.5)
    record.displacement[held] = record.displacement[held][0]
    found = doubtful(record)
    assert set(found) == {"peak_force.2", "energy.2"}
    assert found["energy.2"].startswith("frozen_channel: stands at 0.00")


def test_a_window_that_a_frozen_motion_does_not_reach() -> None:
    record = up_and_down(cycles=1, noise=1e-4)
    held = (record.time > 3.5) & (record.time < 9.0)
    record.displacement[held] = record.displacement[held][0]
    more = "results:\n  - {result: stiffness, from: 2 mm, to: 8 mm}\n"
    found = doubtful(record, more)
    assert found["stiffness"].startswith("frozen_channel: ")
    assert "; not_reached: the branch reaches " in found["stiffness"]


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


def test_nothing_moved() -> None:
    still = Signal(np.arange(9.0), np.zeros(9), "m", "frame")
    ends = cut_at(Signals(), Motion(still, (), Clocks()), is_full_stroke=False, is_cut_file=False)
    assert not ends


def test_a_peak_that_was_passed_when_the_record_ended() -> None:
    record = up_and_down(cycles=1).up_to(6.5)
    assert set(doubtful(record)) == {"peak_force.1", "peak_displacement.1", "energy.1"}
    record.force[record.time > 5.0] *= 0.5  # it gives way at 60 % of the stroke
    assert set(doubtful(record)) == {"peak_displacement.1", "energy.1"}


def test_cycles_that_end_where_the_last_one_did() -> None:
    """The first begins at zero, the others end on a load: the last one is whole."""
    record = up_and_down(cycles=3, rest=0.0)
    kept = (record.displacement > 1.02e-3) | (record.time < 1.0)
    assert ended(record.where(kept)) == np.inf


def held(record: PlainRecord) -> str:
    """What is noted of holds."""
    test, _ = reduced(*record.arrays(), more=RESULTS)
    return next((note.message for note in test.findings.notes if note.code == "hold"), "")


def with_dwells(lasts: float, noise: float = 1e-3, rate: float = 50.0) -> PlainRecord:
    """Two cycles that stand at each turn."""
    record = up_and_down(rate=rate, noise=noise)
    corners = [2.0, 7.0, 12.0, 17.0, 22.0]
    time: Floats = np.arange(0.0, 24.0 + 3.0 * lasts, 1.0 / rate)
    moved = np.interp(
        time,
        [0.0, *(corner + lasts * (i - end) for i, corner in enumerate(corners) for end in (1, 0))],
        [0.0, *(corner for corner in corners for _ in range(2))],
    )
    path, force = (
        np.interp(moved, record.time, each) for each in (record.displacement, record.force)
    )
    return PlainRecord(time, path, force)


@pytest.mark.parametrize("noise", [0.0, 1e-3])
@pytest.mark.parametrize("rate", [10.0, 50.0, 500.0])
def test_dwells_at_the_turns_are_noted(noise: float, rate: float) -> None:
    said = held(with_dwells(1.5, noise, rate))
    assert said.startswith("the motion stands 3 times in the middle of the test, for 1.")
    assert "; first at 10" in said or "; first at 9.9" in said
    test, _ = reduced(*with_dwells(1.5, noise, rate).arrays(), more=RESULTS)
    assert "partial_cycle" not in str(test.findings.doubts)


def test_a_hold_at_the_end_and_one_in_mid_branch() -> None:
    time: Floats = np.arange(0.0, 100.0, 0.05)
    path = 1e-3 * np.minimum(time, 10.0)
    assert held(PlainRecord(time, path, 100.0 * path)).startswith(
        "the motion stands once in the middle of the test, for 8"
    )
    path = 1e-3 * np.interp(
        time, [0.0, 5.0, 25.0, 30.0, 35.0, 45.0], [0.0, 5.0, 5.0, 10.0, 10.0, 0.0]
    )
    said = held(PlainRecord(time, path, 100.0 * path))
    assert said.startswith("the motion stands 2 times in the middle of the test, for 5 to 1")
    assert "; first at 5 mm, from 5" in said


@pytest.mark.slow
@pytest.mark.parametrize("is_round", [False, True])
@pytest.mark.parametrize("rate", [10.0, 50.0, 500.0])
@pytest.mark.parametrize("noise", [0.0, 1e-3, 1e-2])
def test_no_hold_without_one(is_round: bool, rate: float, noise: float) -> None:
    assert not held(up_and_down(rate=rate, is_round=is_round, noise=noise))
