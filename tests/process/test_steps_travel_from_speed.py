"""A displacement made from crosshead speed: what it is, what contradicts it."""

from __future__ import annotations

import numpy as np
import pytest

from labpipe.records.causes import SPEED as SPEED_CAUSE
from labpipe.records.causes import TURN
from labpipe.records.quality import Severity
from labpipe.records.result import Status
from tests.builders.doubts import doubted
from tests.builders.three_point import STROKE, BendingRecord, load_at, reduced

ALONE = ("frame", "markers")
SPEED = "crosshead_speed: 0.5 mm/s"


def test_it_ends_at_the_stroke_where_the_force_turns() -> None:
    test, results = reduced(BendingRecord(force_late=-3.0), without=ALONE)

    peak = results["peak_displacement.1"]
    assert peak.value == pytest.approx(STROKE, abs=1e-5)
    assert peak.interval is not None
    assert peak.interval.upper / STROKE - 1.0 == pytest.approx(0.01, abs=0.005)  # speed, 0.5 %
    assert {each.status for each in results.values()} == {Status.OK}
    assert test.clocks.force is None
    (note,) = (note for note in test.findings.notes if note.code == "displacement_from_speed")
    assert note.severity is Severity.INFO
    assert note.message.startswith(
        "no export measured it: 0.5 mm/s over 58.8 s up to the force's corner at 61.8"
    )


def test_what_is_not_known_of_the_drive_moves_it() -> None:
    """0.5 % faster, and later by what is not known of the turn: less on the way up, more down."""
    test, _ = reduced(BendingRecord(force_late=-3.0), without=ALONE)

    way = test.displacement
    np.testing.assert_allclose(way.moved[SPEED_CAUSE], 1.005 * way.values)
    later = way.moved[TURN] - way.values
    top = int(np.argmax(way.values))
    assert np.median(later[100 : top - 100]) < 0.0 < np.median(later[top + 100 :])
    assert np.ptp(later) < 1e-4


def test_stiffness_and_peak_force_hold_the_truth() -> None:
    record = BendingRecord(force_late=-3.0)
    _, results = reduced(record, without=ALONE)

    peak = results["peak_force.1"].interval
    assert peak is not None
    assert peak.lower < float(load_at(record, [STROKE])[0]) < peak.upper  # type: ignore[arg-type]


def test_a_measured_displacement_goes_before_it() -> None:
    test, _ = reduced(BendingRecord(), without=("markers",))

    assert "displacement_from_speed" not in {note.code for note in test.findings.notes}
    assert test.signals.raw["displacement"].clock == "frame"


@pytest.mark.slow
@pytest.mark.parametrize("without", [("markers",), ALONE])
def test_a_speed_that_contradicts(without: tuple[str, ...]) -> None:
    record = BendingRecord(force_late=0.0 if "frame" not in without else -3.0)
    slower = "0.45 mm/s" if "frame" in without else "0.38 mm/s"
    change = ((SPEED, f"crosshead_speed: {slower}"),)
    _, results = reduced(record, without=without, change=change)

    reason = results["initial_stiffness"].why
    assert results["initial_stiffness"].status is Status.DOUBTFUL
    expected = (
        "speed_unexpected: 0.4996 mm/s measured over the first branch, 0.38 mm/s expected: look at "
        "rig.crosshead_speed, and at unit and name of the displacement"
    )
    if "frame" in without:
        expected = (
            "speed_unexpected: the force rises for 58.83 s before it turns, speed and stroke of "
            "the rig say 65.33 s: look at rig.crosshead_speed and rig.stroke"
        )
    assert expected in reason


def test_a_start_that_nobody_saw_is_said() -> None:
    test, _ = reduced(BendingRecord(), without=ALONE)

    (note,) = (note for note in test.findings.notes if note.code == "start_not_seen")
    assert note.message == (
        "the force was not seen to rise from rest, so that nothing checks the start"
    )


def test_a_zero_that_was_taken_under_load() -> None:
    test, results = reduced(BendingRecord(force_late=2.0), without=ALONE)

    assert doubted(test)["force"] == (
        "start_missed: the record of the force begins 2.02 s after the motion, known to 0.59 s: "
        "its zero was taken under load, so that forces are too small"
    )
    assert results["peak_force.1"].status is Status.DOUBTFUL
    assert results["peak_displacement.1"].status is Status.OK


def test_a_reversed_bridge() -> None:
    change = (("gain: -0.21082 N/V", "gain: 0.21082 N/V"),)
    test, results = reduced(BendingRecord(force_late=-3.0), without=ALONE, change=change)

    assert results["peak_displacement.1"].value == pytest.approx(STROKE, abs=1e-5)
    assert set(doubted(test)) == {"force"}
    assert doubted(test)["force"].startswith("force_reversed: the force goes to -")


def test_a_force_that_never_turns() -> None:
    with pytest.raises(Exception, match="expected a corner where it turns from rising") as info:
        reduced(BendingRecord(rigidity=0.0, noise=(1e-12, 0.0, 0.0)), without=ALONE)
    assert str(info.value).startswith(
        "steps.4 (travel-from-speed): force: expected a corner where it turns from rising to "
        "falling, which says when the frame turned, found none: look whether it is the right "
        "channel, and whether the unloading was recorded. Look at the exports with"
    )
