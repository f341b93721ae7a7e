"""Steps of a protocol on channels and on a travel made from crosshead speed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from labpipe.errors import ProcessingError
from labpipe.process.steps import PreparedTest, run_step
from labpipe.protocol.load import parse_protocol
from labpipe.protocol.schema import Protocol
from labpipe.records.arrays import Floats
from labpipe.records.causes import SPEED as SPEED_CAUSE
from labpipe.records.causes import TURN
from labpipe.records.quality import QualityNote, Severity
from labpipe.records.result import Status
from labpipe.records.signals import Signal, Signals
from labpipe.signal.filters import Butterworth, Smoothing, filter_pieces
from tests.builders.reasons import doubted
from tests.builders.three_point import STROKE, BendingRecord, reduced

TIME: Floats = np.arange(2000, dtype=np.float64) * 0.01


VALUES: Floats = 0.3 + np.sin(TIME) + np.random.default_rng(1).normal(0, 0.01, len(TIME))


def protocol(step: str, rig: str = "{crosshead_speed: 2 mm/s, stroke: 10 mm}") -> Protocol:
    return parse_protocol(
        "version: 1\nname: p\n"
        "sources: {force: {reader: dspace-mat, channels: "
        "{force: {channel: A, unit: N}, displacement: {channel: B, unit: mm}}}}\n"
        f"rig: {rig}\nsteps:\n  - {step}\n"
        "curve: {force: force, displacement: displacement}\n"
        "branches: {channel: displacement, min_stroke: 1 mm}\n",
        "p.yaml",
    )


@dataclass(frozen=True)
class Stepped:
    """Signals after a step, and what was noted."""

    signals: Signals
    notes: tuple[QualityNote, ...]


def stepped(step: str, signal: Signal, **more: Any) -> Stepped:
    plan = protocol(step, **more)
    prepared = PreparedTest(Signals().add_signal("force", signal))
    prepared, findings = run_step(prepared, plan.steps[0], plan)
    return Stepped(prepared.signals, tuple(finding.note for finding in findings))


def after(step: str, values: Floats = VALUES, **more: Any) -> Stepped:
    return stepped(step, Signal(TIME, values, "N", "force"), **more)


RAMP: Floats = 0.3 + 2.0 * TIME
"""A machine that moves from the first sample on."""


@pytest.mark.parametrize(
    ("more", "values", "level", "message"),
    [
        ("1.995 s", VALUES, VALUES[TIME < 1.995].mean(), "the mean over 1.995 s at the start"),
        ("0.5 s, by: line", RAMP, 0.3, "the outer end of a line over 0.5 s at the start"),
    ],
)
def test_zero_at_the_start(more: str, values: Floats, level: float, message: str) -> None:
    test = after(f"{{step: zero, channel: force, over: {more}}}", values)
    np.testing.assert_allclose(test.signals.filtered["force"].values, values - level, atol=1e-9)
    np.testing.assert_allclose(test.signals.raw["force"].values, values - level, atol=1e-9)
    assert test.notes[0].message.startswith(f"zero at {level:.6g} N, {message}, ")
    assert ("line" in more) == (test.signals.zero_stretches == {})  # that it moves is no fault


@pytest.mark.parametrize("more", ["", ", by: line", ", by: line, at: end"])
def test_error_of_the_zero_holds(more: str) -> None:
    pulls = []
    speed = 2.0 if more else 0.0
    truth = speed * TIME[-1] if "end" in more else 0.0
    for seed in range(100):
        values = speed * TIME + np.random.default_rng(seed).normal(0, 0.01, len(TIME))
        step = f"{{step: zero, channel: force, over: 2 s{more}}}"
        signal = after(step, values).signals.raw["force"]
        pulls.append(((values - signal.values)[0] - truth) / signal.zero_error)
    assert np.std(pulls) == pytest.approx(1.0, abs=0.21)  # 3 standard errors
    assert np.mean(pulls) == pytest.approx(0.0, abs=0.35)  # 3.5 standard errors


AVERAGE = "step: smooth, channel: force, method: moving-average"


@pytest.mark.parametrize(
    ("step", "message"),
    [
        ("step: zero, channel: force, over: 2 s", "): force: a stretch in s"),
        ("step: zero, channel: force, over: 2 s, by: line", "): force: a stretch in s"),
        ("step: low-pass, channel: force, cutoff: 5 Hz, order: 2", "): force: a cutoff in Hz"),
        (f"{AVERAGE}, span: 1 s", "a span of time"),
        (f"{AVERAGE}, span: 2 mm", "a span of travel"),
        (f"{AVERAGE}, span: 10 %", "a span of branch"),
    ],
)
def test_seconds_where_there_are_only_rows(step: str, message: str) -> None:
    rows = Signal(np.arange(2000.0), VALUES, "N", "frame", time_unit="1")
    with pytest.raises(ProcessingError) as refused:
        stepped(f"{{{step}}}", rows)
    assert f"{message} needs times, but the export has none. " in str(refused.value)


@pytest.mark.parametrize(("by", "error"), [("mean", 5**-0.5), ("line", 0.6**0.5)])
def test_few_samples_are_enough_beside_a_record(by: str, error: float) -> None:
    """At 10 Hz half a second holds five or six samples; the noise is that of the record."""
    noise = np.random.default_rng(3).normal(0.0, 1.0, len(TIME))
    test = after(f"{{step: zero, channel: force, over: 45 ms, by: {by}}}", noise)
    (note,) = (note for note in test.notes if note.code == "zeroed")
    assert ", 5 samples" in note.message
    assert test.signals.raw["force"].zero_error == pytest.approx(error, rel=0.1)


@pytest.mark.parametrize(
    ("span", "window"),
    [("1 s", 99), ("2 mm", 99), ("10 %", 49), ("21 samples", 21), ("20 samples", 19)],
)
def test_smooth(span: str, window: int) -> None:
    """Of a motion at 2 mm/s over 10 mm: 2 mm are a second, a branch is five.

    A signal of the curve is smoothed later, branch by branch.
    """
    test = after(f"{{step: smooth, channel: force, method: moving-average, span: {span}}}")
    assert test.signals.filters["force"] == ((Smoothing(window), 1),)
    np.testing.assert_array_equal(test.signals.filtered["force"].values, VALUES)
    assert f"moving average over {window} samples" in test.notes[0].message


@pytest.mark.parametrize("method", ["filtered", "stride"])
def test_low_pass_and_decimate(method: str) -> None:
    test = after("{step: low-pass, channel: force, cutoff: 5 Hz, order: 2}")
    low = Butterworth(5.0, 100.0, 2)(VALUES)
    np.testing.assert_allclose(test.signals.filtered["force"].values, low, atol=1e-9)

    test = after(f"{{step: decimate, channel: force, factor: 4, method: {method}}}")
    signal = test.signals.filtered["force"]
    window = 5 if method == "filtered" else 1
    expected = filter_pieces(VALUES, (), [(Smoothing(window), 4)])
    np.testing.assert_allclose(signal.values, expected)
    np.testing.assert_array_equal(signal.time, TIME[::4])
    assert test.notes[0].message == f"every 4th sample kept ({method})"


ALONE = ("frame", "markers")


def test_a_travel_made_from_the_speed_of_the_rig() -> None:
    """It ends where the force turns; the drive may be 0.5 % faster, and the turn later."""
    test, results = reduced(BendingRecord(force_late=-3.0), without=ALONE)

    peak = results["peak_displacement.1"]
    assert peak.value == pytest.approx(STROKE, abs=1e-5)
    assert peak.interval is not None
    assert peak.interval.upper / STROKE - 1.0 == pytest.approx(0.01, abs=0.005)  # speed, 0.5 %
    assert {result.status for result in results.values()} == {Status.OK}
    assert test.clocks.force_fit is None
    (note,) = (note for note in test.findings.notes if note.code == "displacement_from_speed")
    assert note.severity is Severity.INFO
    assert "0.5 mm/s over 58.8 s up to the corner of the force at 61.8" in note.message
    way = test.displacement
    np.testing.assert_allclose(way.variants[SPEED_CAUSE], 1.005 * way.values)
    later = way.variants[TURN] - way.values
    top = int(np.argmax(way.values))
    assert np.median(later[100 : top - 100]) < 0.0 < np.median(later[top + 100 :])
    assert np.ptp(later) < 1e-4


@pytest.mark.slow
def test_a_zero_that_was_taken_under_load() -> None:
    test, results = reduced(BendingRecord(force_late=2.0), without=ALONE)

    assert doubted(test)["force"].startswith(
        "start_missed: the record of the force begins 2.02 s (within 0.59 s) after the motion: "
    )
    assert results["peak_force.1"].status is Status.DOUBTFUL
    assert results["peak_displacement.1"].status is Status.OK


def test_a_force_that_never_turns() -> None:
    with pytest.raises(Exception, match="expected a corner") as info:
        reduced(BendingRecord(rigidity=0.0, noise=(1e-12, 0.0, 0.0)), without=ALONE)
    assert str(info.value).startswith("steps.4 (travel-from-speed): force: ")
