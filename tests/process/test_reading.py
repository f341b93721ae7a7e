"""Exports read, their units, calibrations and the page of `labpipe inspect`."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from labpipe.errors import ProcessingError, ReadError
from labpipe.process.reading import convert_channels, join_exports, read_inputs, read_role_export
from labpipe.process.steps import calibrate
from labpipe.protocol.load import (
    load_test_sheet,
    parse_protocol,
    resolve_protocol,
)
from labpipe.protocol.schema import Protocol
from labpipe.protocol.source import Source
from labpipe.records.quality import Finding, Findings, QualityNote, Severity
from labpipe.records.recording import Channel, Clock, MarkerTracks, Recording, RigidBody
from tests.approved import Approve
from tests.builders.controldesk import Axis, Signal, write_mat_v5
from tests.builders.load_frames import trapezium
from tests.builders.reasons import doubted
from tests.builders.small_tests import Lab

ReadParts = Callable[..., Recording]


STEADY = np.arange(20) * 0.01


RISING = np.linspace(1.0, 2.5, 20)


def protocol(source: str) -> Protocol:
    return parse_protocol(f"version: 1\nname: p\nsources:\n  force: {source}\n", "p.yaml")


def export(tmp_path: Path, unit: str = "") -> Path:
    signals = [Signal("Model", "Out1", RISING, unit=unit), Signal("Model", "Out2", RISING)]
    return write_mat_v5(tmp_path / "a.mat", [Axis(STEADY)], signals)


def test_fingerprints(pristine: Lab) -> None:
    sheet_path = pristine.raw / "test.yaml"
    sheet = load_test_sheet(sheet_path)
    recordings, inputs = read_inputs(pristine.raw, sheet, resolve_protocol(sheet, sheet_path))
    assert list(recordings) == ["force", "markers"]
    assert [(input_file.role, input_file.file) for input_file in inputs] == [
        ("force", "force.mat"),
        ("markers", "take.csv"),
    ]
    for input_file in inputs:
        content = (pristine.raw / input_file.file).read_bytes()
        assert input_file.sha256 == hashlib.sha256(content).hexdigest()
        assert input_file.bytes == len(content)


def part(start: float, *, name: str = "time") -> Recording:
    time = start + np.arange(5.0)
    channel = Channel("force", "Model/Out1", time, name, "N")
    return Recording("dspace-mat", clocks=(Clock(name, time),), channels=(channel,))


def test_parts_are_joined_in_time() -> None:
    parts = [part(10.0, name="b"), part(0.0, name="a")]
    whole = join_exports(parts, ["b.mat", "a.mat"], Path())
    expected = np.concatenate([np.arange(5.0), 10.0 + np.arange(5.0)])
    np.testing.assert_array_equal(whole.clocks[0].time, expected)
    np.testing.assert_array_equal(whole.channels[0].values, expected)
    assert whole.channels[0].clock == whole.clocks[0].name


EMPTY = Recording(
    "load-frame",
    notes=(QualityNote("no_samples", Severity.WARNING, "table", "a header, and no rows"),),
)


HEADED = replace(EMPTY, clocks=(Clock("time", np.empty(0)),))


@pytest.fixture
def read_parts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ReadParts:
    """Read a test whose exports, a.mat and so on, hold what is given."""

    def read_parts(*parts: Recording) -> Recording:
        files = dict(zip(("a.mat", "b.mat", "c.mat"), parts, strict=False))
        for name in files:
            (tmp_path / name).write_bytes(b"synthetic")
        monkeypatch.setattr(
            "labpipe.process.reading.read_export", lambda path, *_, **__: files[path.name]
        )
        sheet_path = tmp_path / "test.yaml"
        sheet_path.write_text(
            "test: T\nprotocol: p\nspecimen: {type: A, spool: s, sample: 1}\n"
            f"files: {{force: [{', '.join(files)}]}}\n"
        )
        sheet = load_test_sheet(sheet_path)
        asked = protocol("{reader: dspace-mat, channel: Model/Out1, unit: N}")
        recordings, inputs = read_inputs(tmp_path, sheet, asked)
        assert [input_file.file for input_file in inputs] == list(files)
        return recordings["force"]

    return read_parts


@pytest.mark.parametrize("nothing", [EMPTY, HEADED], ids=["bare", "header"])
def test_an_empty_part_leaves_its_note_alone(read_parts: ReadParts, nothing: Recording) -> None:
    alone = read_parts(part(3.0), nothing)
    assert alone.notes == EMPTY.notes
    np.testing.assert_array_equal(alone.channels[0].values, 3.0 + np.arange(5.0))
    np.testing.assert_array_equal(alone.clocks[0].time, 3.0 + np.arange(5.0))

    between = read_parts(part(10.0), nothing, part(0.0))
    gap, *empty = between.notes  # the gap between the parts is one of the recording
    assert (gap.code, gap.where, tuple(empty)) == ("time_holes", "clock time", EMPTY.notes)
    expected = np.concatenate([np.arange(5.0), 10.0 + np.arange(5.0)])
    np.testing.assert_array_equal(between.clocks[0].time, expected)


@pytest.mark.parametrize(
    ("parts", "found"),
    [((EMPTY,), "none in this file"), ((HEADED, EMPTY), "none in any of the parts")],
)
def test_a_test_without_any_sample(
    read_parts: ReadParts, parts: tuple[Recording, ...], found: str
) -> None:
    message = (
        rf"a\.mat: expected samples, found {found}\. The test was aborted before its first "
        r"sample; leave it out\.$"
    )
    with pytest.raises(ReadError, match=message):
        read_parts(*parts)


def test_a_channel_that_is_spelt_otherwise_is_told(tmp_path: Path) -> None:
    source = protocol("{reader: dspace-mat, channel: [Load, Force, Kraft, out2], unit: N}")
    recording = read_role_export(export(tmp_path), source.sources["force"])
    assert recording.channels[0].path == "Model/Out2"
    facts = {"names": "'Load' or 'Force' or 'Kraft' ...", "path": "Model/Out2"}
    expected = QualityNote.of("process.channel_spelt_otherwise", "force", **facts)
    assert expected in recording.notes


SPECIMENS = """\
version: 1
name: p
sources: {frame: {reader: load-frame, channels: {force: {channel: [Load, Force]}}}}
"""


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (
            replace(part(0.0), clocks=(Clock("time", np.arange(20.0), "1"),)),
            r"b\.txt: expected a part of a recording with times, by which the parts are sorted",
        ),
        (
            replace(part(0.0), clocks=2 * part(0.0).clocks),
            r"b\.txt: expected a part .* on one clock, found 2 clocks",
        ),
    ],
    ids=["no times", "two clocks"],
)
def test_parts_that_have_no_order(wrong: Recording, message: str) -> None:
    with pytest.raises(ReadError, match=message):
        join_exports([part(0.0), wrong], ["a.txt", "b.txt"], Path())


def test_one_of_several_specimens_is_to_be_chosen(tmp_path: Path) -> None:
    path = tmp_path / "pulls.csv"
    path.write_bytes(trapezium((40, 25, 3)))
    source = parse_protocol(SPECIMENS, "p.yaml").sources["frame"]
    with pytest.raises(ReadError) as refused:
        read_role_export(path, source)
    assert str(refused.value) == (
        f"{path}: expected one specimen, found 3: 'C1', 'C2', 'C3'. Choose one with"
        " 'sources.frame.part: {value: C1, because: ...}' under 'overrides' in test.yaml."
    )
    chosen = source.model_copy(update={"part": "C2"})
    assert len(read_role_export(path, chosen).channels[0].values) == 25


def source(*, unit: str = "", wrong: str = "") -> Source:
    keys = (f", unit: {unit}" if unit else "") + (f", wrong_unit_in_file: {wrong}" if wrong else "")
    text = f"{{reader: dspace-mat, channels: {{force: {{channel: Model/Out1{keys}}}}}}}"
    text = f"version: 1\nname: p\nsources:\n  force: {text}\n"
    return parse_protocol(text, "p.yaml").sources["force"]


def recorded(tmp_path: Path, stated: str, asked: Source) -> Recording:
    """Read an export whose one channel states a unit."""
    axes, signals = [Axis(0.01 * np.arange(20))], [Signal("Model", "Out1", RISING, unit=stated)]
    return read_role_export(write_mat_v5(tmp_path / "a.mat", axes, signals), asked)


@pytest.mark.parametrize(
    ("stated", "asked", "factor", "is_noted"),
    [
        *(("N", source(), 1.0, False), ("kN", source(), 1e3, False)),
        ("lbf", source(), 4.4482216152605, False),
        *((stated, source(unit="N"), 1.0, False) for stated in ("", "N", "newton")),
        *((stated, source(unit="N"), 1.0, True) for stated in ("-", "1", "Einh. 7")),
        ("kN", source(unit="N", wrong="kN"), 1.0, True),
    ],
)
def test_units(tmp_path: Path, stated: str, asked: Source, factor: float, is_noted: bool) -> None:
    """That of the file, unless the protocol states one for a silent or wrong label."""
    recording = recorded(tmp_path, stated, asked)
    np.testing.assert_allclose(recording.channels[0].values, factor * RISING, rtol=1e-14)
    note = QualityNote.of("process.unit_overridden", "force", file_unit=stated, unit="N")
    assert [note for note in recording.notes if note.code == "unit_overridden"] == [note] * is_noted


REFUSED_UNITS = [
    *(("kN", "N"), ("N", "kN"), ("lbf", "N"), ("KN", "N"), ("lbs", "N"), ("mm", "N")),
    *(("", ""), ("KN", ""), ("Einh. 7", ""), ("mm", ""), ("kg", "")),
]


def test_units_that_cannot_be_used(tmp_path: Path, approved: Approve) -> None:
    messages = []
    for stated, unit in REFUSED_UNITS:
        with pytest.raises(ReadError) as refused:
            recorded(tmp_path, stated, source(unit=unit))
        messages.append(str(refused.value).replace(str(tmp_path / "a.mat"), "a.mat"))
    approved(messages)


def test_sizes_that_no_lab_has(tmp_path: Path, approved: Approve) -> None:
    """A wrong prefix is refused; a single damaged sample is not."""
    tracks = take(0, "marker", [0, 0, 0])["markers"].markers
    assert tracks is not None
    far = replace(tracks, positions=tracks.positions + 120.0, unit_in_file="Meters")
    asked = PROTOCOL.sources["markers"]
    with pytest.raises(ReadError) as force_refused:
        recorded(tmp_path, "MN", source())
    with pytest.raises(ReadError) as take_refused:
        convert_channels(Recording("motive-csv", markers=far), asked, tmp_path / "a.mat")
    messages = [str(refused.value) for refused in (force_refused, take_refused)]
    approved(message.replace(str(tmp_path / "a.mat"), "a.mat") for message in messages)
    spike = take(3, "marker", [0, 0, 120.0])["markers"]
    assert convert_channels(spike, asked, Path()).markers is spike.markers


PROTOCOL = parse_protocol(
    "version: 1\nname: p\nsources:\n"
    "  force: {reader: dspace-mat, channel: A, unit: V,"
    " calibration: {gain: 0.5 N/V, offset: 2 N, gain_uncertainty: 1 %}, zero_drift: 0.2 %}\n"
    "  markers: {reader: motive-csv, scale_uncertainty: 0.05 %}\n"
    "markers: {clamp: Clamp, along: all}\n",
    "p.yaml",
)


TIME = np.arange(10) * 0.1


def force_recording(values: np.ndarray, time: np.ndarray = TIME) -> dict[str, Recording]:
    channel = Channel("force", "Model/A", values, unit="V")
    note = QualityNote("x", Severity.INFO, "file", "y")
    clock = (Clock("time", time),)
    return {"force": Recording("dspace-mat", clocks=clock, channels=(channel,), notes=(note,))}


def notes(found: list[Finding]) -> tuple[QualityNote, ...]:
    return Findings(tuple(found)).notes


def test_calibrated_signal_and_notes() -> None:
    prepared, findings = calibrate(force_recording(np.arange(10.0)), PROTOCOL)
    signal = prepared.signals.raw["force"]
    np.testing.assert_allclose(signal.values, 0.5 * np.arange(10.0) + 2.0)
    assert (signal.unit, signal.clock, signal.relative_error) == ("N", "force", 0.01)
    assert signal.zero_drift == 0.002
    assert prepared.signals.filtered["force"] is signal
    assert [finding.note for finding in findings] == [
        QualityNote("x", Severity.INFO, "force: file", "y")
    ]
    assert prepared.take.tracks is None


def test_blanks_are_doubted_unless_they_stand_at_the_ends() -> None:
    _, found = calibrate(force_recording(with_sample(RAMP, 3, np.nan)), PROTOCOL)
    assert doubted(found) == {"force": "missing_samples: 1 of 10 samples are blank or not finite"}
    time = np.arange(100) * 0.1
    values = np.arange(100.0)
    values[0] = values[-1] = np.nan
    _made, found = calibrate(force_recording(values, time), PROTOCOL)
    assert not Findings(tuple(found)).doubts
    assert [note.message for note in notes(found) if note.code == "missing_samples"] == [
        "2 of 100 samples are blank or not finite"
    ]
    values[1:5] = np.nan
    _, found = calibrate(force_recording(values, time), PROTOCOL)
    assert [doubt.period for doubt in Findings(tuple(found)).doubts] == [
        pytest.approx((0.0, 0.4)),
        pytest.approx((9.9, 9.9)),
    ]


def take(frame: int, kind: str, values: list[float]) -> dict[str, Recording]:
    """A take of five frames, one position of its body or its second marker given."""
    body, positions = np.zeros((5, 3)), np.zeros((5, 2, 3))
    (body if kind == "body" else positions[:, 1])[frame] = values
    clamp = RigidBody("Clamp", body, np.zeros((5, 4)), np.zeros(5))
    time = np.arange(5) / 50.0
    tracks = MarkerTracks(time, time, 50.0, ("a", "b"), positions, (clamp,))
    return {"markers": Recording("motive-csv", markers=tracks)}


def with_sample(values: np.ndarray, number: int, value: float) -> np.ndarray:
    changed = values.copy()
    changed[number] = value
    return changed


RAMP = np.arange(10.0)


@pytest.mark.parametrize(
    ("recordings", "message"),
    [
        (force_recording(np.full(10, np.nan)), "force, channel 'Model/A': expected numbers, found"),
        (force_recording(RAMP[:0], TIME[:0]), "force, time: expected at least 8 samples, found 0"),
        (force_recording(RAMP[:7], TIME[:7]), "force, time: expected at least 8 samples, found 7"),
        (
            force_recording(RAMP, with_sample(TIME, 4, 0.05)),
            "force, sample 5: expected an increasing time axis, found 0.050000 s after 0.300000 s",
        ),
        (
            force_recording(with_sample(RAMP, 7, -1e200)),
            "force, channel 'Model/A', sample 8: expected numbers up to 1e+15 in SI units, found",
        ),
        (take(3, "marker", [0, 0, 1e9]), "markers, marker 'b', sample 4: expected numbers up"),
        (take(2, "body", [np.nan, 1e7, 0]), "markers, rigid body 'Clamp', sample 3: "),
    ],
)
def test_recordings_that_are_refused(recordings: dict[str, Recording], message: str) -> None:
    with pytest.raises(ProcessingError, match=f"^{re.escape(message)}"):
        calibrate(recordings, PROTOCOL)
