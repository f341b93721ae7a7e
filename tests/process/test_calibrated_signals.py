from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.errors import ProcessingError
from labpipe.process.calibrated_signals import calibrated
from labpipe.protocol.load import parse_protocol
from labpipe.records.quality import Finding, Findings, QualityNote, Severity
from labpipe.records.recording import Channel, Clock, MarkerTracks, Recording, RigidBody
from tests.builders.doubts import doubted

PROTOCOL = parse_protocol(
    "version: 1\nname: p\nsources:\n"
    "  force: {reader: dspace-mat, channel: A, unit: V,"
    " calibration: {gain: 0.5 N/V, offset: 2 N, gain_uncertainty: 1 %}, zero_drift: 0.2 %}\n"
    "  markers: {reader: motive-csv, scale_uncertainty: 0.05 %}\n"
    "markers: {clamp: Clamp, along: all}\n",
    "p.yaml",
)
TIME = np.arange(10) * 0.1


def force(values: np.ndarray, time: np.ndarray = TIME) -> dict[str, Recording]:
    channel = Channel("force", "Model/A", values, unit="V")
    note = QualityNote("x", Severity.INFO, "file", "y")
    clock = (Clock("time", time),)
    return {"force": Recording("dspace-mat", clocks=clock, channels=(channel,), notes=(note,))}


def notes(found: list[Finding]) -> tuple[QualityNote, ...]:
    return Findings(tuple(found)).notes


def take(positions: np.ndarray, body: np.ndarray) -> dict[str, Recording]:
    frames = len(positions)
    clamp = RigidBody("Clamp", body, np.zeros((frames, 4)), np.zeros(frames))
    time = np.arange(frames) / 50.0
    tracks = MarkerTracks(time, time, 50.0, ("a", "b"), positions, (clamp,))
    return {"markers": Recording("motive-csv", markers=tracks)}


def test_calibrated_signal_and_notes() -> None:
    made, found = calibrated(force(np.arange(10.0)), PROTOCOL)
    signal = made.signals.raw["force"]
    np.testing.assert_allclose(signal.values, 0.5 * np.arange(10.0) + 2.0)
    assert (signal.unit, signal.clock, signal.relative_error) == ("N", "force", 0.01)
    assert signal.zero_drift == 0.002
    assert made.signals.filtered["force"] is signal
    assert [each.note for each in found] == [QualityNote("x", Severity.INFO, "force: file", "y")]
    assert made.take.tracks is None


def test_markers() -> None:
    made, _ = calibrated(take(np.zeros((5, 2, 3)), np.zeros((5, 3))), PROTOCOL)
    assert made.take.tracks is not None
    assert made.take.role == "markers"
    assert made.take.scale_error == 5e-4


def test_missing_samples_are_doubted() -> None:
    values = np.arange(10.0)
    values[3] = np.nan
    _, found = calibrated(force(values), PROTOCOL)
    assert doubted(found) == {
        "force": "missing_samples: 1 of 10 samples are blank or not finite",
    }


def test_blanks_at_the_ends_are_noted_alone() -> None:
    time = np.arange(100) * 0.1
    values = np.arange(100.0)
    values[0] = values[-1] = np.nan
    _made, found = calibrated(force(values, time), PROTOCOL)
    assert not Findings(tuple(found)).doubts
    assert [note.message for note in notes(found) if note.code == "missing_samples"] == [
        "2 of 100 samples are blank or not finite"
    ]
    values[1:5] = np.nan
    _, found = calibrated(force(values, time), PROTOCOL)
    assert [doubt.during for doubt in Findings(tuple(found)).doubts] == [
        pytest.approx((0.0, 0.4)),
        pytest.approx((9.9, 9.9)),
    ]


def test_nothing_but_blanks() -> None:
    recordings = force(np.full(10, np.nan))
    with pytest.raises(ProcessingError, match=r"force, channel 'Model/A': expected numbers, found"):
        calibrated(recordings, PROTOCOL)


@pytest.mark.parametrize("count", [0, 1, 3, 7])
def test_an_aborted_recording(count: int) -> None:
    recordings = force(np.zeros(count), TIME[:count])
    said = (
        rf"^force, time: expected at least 8 samples, found {count}\. The recording was aborted; "
        r"leave this test out\.$"
    )
    with pytest.raises(ProcessingError, match=said):
        calibrated(recordings, PROTOCOL)


def test_the_fewest_samples_that_are_taken() -> None:
    made, _ = calibrated(force(np.zeros(8), TIME[:8]), PROTOCOL)
    assert len(made.signals.filtered["force"].values) == 8


def test_rows_without_time() -> None:
    recordings = force(np.arange(10.0))
    rows = Clock("time", np.arange(10.0), "1")
    counted = {"force": replace(recordings["force"], clocks=(rows,))}
    timed, _ = calibrated(recordings, PROTOCOL)
    made, _ = calibrated(counted, PROTOCOL)
    assert timed.signals.raw["force"].has_time
    assert not made.signals.raw["force"].has_time


PEAK = parse_protocol(
    "version: 1\nname: p\nsources:\n"
    "  force: {reader: dspace-mat, channel: A, unit: N,"
    " plausible_peak: {from: 20 N, to: 2 kN}}\n",
    "p.yaml",
)


@pytest.mark.parametrize("peak", [20.0, -150.0, 2000.0])
def test_a_plausible_peak(peak: float) -> None:
    _, found = calibrated(force(peak * np.arange(10.0) / 9.0), PEAK)
    assert not doubted(found)
    assert len(found) == 1


@pytest.mark.parametrize(
    ("peak", "said"), [(0.15, "0.15 N"), (2.5e3, "2500 N"), (-1.5e5, "1.5e+05 N"), (0.0, "0 N")]
)
def test_an_implausible_peak(peak: float, said: str) -> None:
    _, found = calibrated(force(peak * np.arange(10.0) / 9.0), PEAK)
    message = (
        f"the largest value is {said}, plausible are 20 to 2000 N: is the unit right, and is it "
        "this channel?"
    )
    assert doubted(found) == {"force": f"implausible_peak: {message}"}
    note = QualityNote("implausible_peak", Severity.WARNING, "force", message)
    assert note in notes(found)


def test_a_plausible_peak_beside_blanks() -> None:
    values = np.full(10, np.nan)
    values[5] = 100.0
    _, found = calibrated(force(values), PEAK)
    assert doubted(found)["force"].startswith("missing_samples: 9 of 10")
    assert not [note for note in notes(found) if note.code == "implausible_peak"]


def test_time_that_runs_backwards() -> None:
    time = TIME.copy()
    time[4] = 0.05
    recordings = force(np.arange(10.0), time)
    said = r"force, sample 5: expected a time axis that grows, found 0.050000 s after 0.300000 s"
    with pytest.raises(ProcessingError, match=said):
        calibrated(recordings, PROTOCOL)


def test_impossibly_large_samples() -> None:
    values = np.arange(10.0)
    values[7] = -1e200
    recordings = force(values)
    said = (
        r"force, channel 'Model/A', sample 8: expected numbers up to 1e\+15 in SI units, found 5e"
    )
    with pytest.raises(ProcessingError, match=said):
        calibrated(recordings, PROTOCOL)


def test_impossibly_large_positions() -> None:
    positions, body = np.zeros((5, 2, 3)), np.zeros((5, 3))
    far = positions.copy()
    far[3, 1, 2] = 1e9
    with pytest.raises(
        ProcessingError, match=r"markers, marker 'b', sample 4: expected numbers up"
    ):
        calibrated(take(far, body), PROTOCOL)
    away = body.copy()
    away[2] = [np.nan, 1e7, 0.0]
    with pytest.raises(ProcessingError, match=r"markers, rigid body 'Clamp', sample 3: "):
        calibrated(take(positions, away), PROTOCOL)


def test_raw_arrays_are_not_changed() -> None:
    values = np.arange(10.0)
    recordings = force(values)
    calibrated(recordings, PROTOCOL)
    np.testing.assert_array_equal(values, np.arange(10.0))
    assert replace(recordings["force"]).channels[0].values[3] == 3.0


def test_a_doubt_holds_for_the_curve_whatever_the_channel_is_called() -> None:
    pull = parse_protocol(
        "version: 1\nname: p\nsources:\n  force:\n    reader: dspace-mat\n    channels:\n"
        "      pull: {channel: A, unit: N, quantity: force,"
        " plausible_peak: {from: 20 N, to: 2 kN}}\n"
        "      way: {channel: B, unit: m, quantity: displacement}\n"
        "curve: {force: pull, displacement: way}\n"
        "branches: {channel: way, min_stroke: 1 mm}\n",
        "p.yaml",
    )
    channels = (
        Channel("pull", "A", np.arange(10.0), unit="N"),
        Channel("way", "B", np.arange(10.0), unit="m"),
    )
    clock = Clock("time", np.asarray(TIME, dtype=np.float64))
    recording = Recording("dspace-mat", clocks=(clock,), channels=channels)
    _, found = calibrated({"force": recording}, pull)
    assert set(doubted(found)) == {"force"}
    assert [note.where for note in notes(found) if note.code == "implausible_peak"] == ["pull"]
