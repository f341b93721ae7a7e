from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from labpipe.errors import ReadError
from labpipe.process.reading import is_empty, join_parts, read_inputs, read_role
from labpipe.protocol.load import (
    checked,
    load_test_sheet,
    parse_protocol,
    resolve,
)
from labpipe.protocol.schema import Protocol
from labpipe.protocol.sheet_grammar import TestSheet
from labpipe.protocol.yaml_text import parse_yaml
from labpipe.records.quality import QualityNote, Severity
from labpipe.records.recording import Channel, Clock, MarkerTracks, Recording
from tests.builders.controldesk import Axis, Signal, write_mat_v5
from tests.builders.load_frames import trapezium
from tests.builders.small_tests import Lab

ReadParts = Callable[..., Recording]

TIME = np.arange(20) * 0.01
VALUES = np.linspace(1.0, 2.0, 20)


def protocol(source: str) -> Protocol:
    return parse_protocol(f"version: 1\nname: p\nsources:\n  force: {source}\n", "p.yaml")


def export(tmp_path: Path, unit: str = "") -> Path:
    signals = [Signal("Model", "Out1", VALUES, unit=unit), Signal("Model", "Out2", VALUES)]
    return write_mat_v5(tmp_path / "a.mat", [Axis(TIME)], signals)


def test_only_named_channels_in_si(tmp_path: Path) -> None:
    source = "{reader: dspace-mat, channels: {displacement: {channel: Model/Out1, unit: mm}}}"
    recording = read_role(export(tmp_path), protocol(source).sources["force"])
    (channel,) = recording.channels
    assert (channel.name, channel.path, channel.unit) == ("displacement", "Model/Out1", "m")
    np.testing.assert_allclose(channel.values, 1e-3 * VALUES, rtol=1e-15)
    assert len(recording.clocks) == 1


def test_missing_channel_names_the_nearest(tmp_path: Path) -> None:
    source = protocol("{reader: dspace-mat, channel: Model/Otu2, unit: N}").sources["force"]
    path = export(tmp_path)
    said = (
        r"Model/Otu2.*'Model/Out2'.* Name the right one with 'sources\.force\.channel: "
        r"\{value: \.\.\., because: \.\.\.\}' under 'overrides' in test\.yaml\.$"
    )
    with pytest.raises(ReadError, match=said):
        read_role(path, source)


def test_fingerprints(pristine: Lab) -> None:
    sheet_path = pristine.raw / "test.yaml"
    sheet = load_test_sheet(sheet_path)
    recordings, inputs = read_inputs(pristine.raw, sheet, resolve(sheet, sheet_path))
    assert list(recordings) == ["force", "markers"]
    assert [(each.role, each.file) for each in inputs] == [
        ("force", "force.mat"),
        ("markers", "take.csv"),
    ]
    for each in inputs:
        content = (pristine.raw / each.file).read_bytes()
        assert each.sha256 == hashlib.sha256(content).hexdigest()
        assert each.bytes == len(content)


def part(start: float, *, name: str = "time") -> Recording:
    time = start + np.arange(5.0)
    channel = Channel("force", "Model/Out1", time, name, "N")
    return Recording("dspace-mat", clocks=(Clock(name, time),), channels=(channel,))


def test_parts_are_joined_in_time() -> None:
    whole = join_parts([part(10.0, name="b"), part(0.0, name="a")], ["b.mat", "a.mat"])
    expected = np.concatenate([np.arange(5.0), 10.0 + np.arange(5.0)])
    np.testing.assert_array_equal(whole.clocks[0].time, expected)
    np.testing.assert_array_equal(whole.channels[0].values, expected)
    assert whole.channels[0].clock == whole.clocks[0].name


def test_parts_that_overlap() -> None:
    said = r"b.mat, time: expected a start after 4.000000 s, where a.mat ends, found 3.0"
    with pytest.raises(ReadError, match=said):
        join_parts([part(0.0), part(3.0)], ["a.mat", "b.mat"])


EMPTY = Recording(
    "load-frame",
    notes=(QualityNote("no_samples", Severity.WARNING, "table", "a header, and no rows"),),
)
HEADED = replace(EMPTY, clocks=(Clock("time", np.empty(0)),))


def test_what_holds_nothing_is_empty() -> None:
    marks = MarkerTracks(np.empty(0), np.empty(0), 50.0, (), np.empty((0, 0, 3)))
    assert is_empty(EMPTY)
    assert is_empty(HEADED)
    assert not is_empty(part(0.0))
    assert not is_empty(replace(HEADED, markers=marks))


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
        sheet = checked(
            TestSheet,
            parse_yaml(
                "test: T\nprotocol: p\nspecimen: {type: A, spool: s, sample: 1}\n"
                f"files: {{force: [{', '.join(files)}]}}\n",
                "test.yaml",
            ),
        )
        asked = protocol("{reader: dspace-mat, channel: Model/Out1, unit: N}")
        recordings, inputs = read_inputs(tmp_path, sheet, asked)
        assert [each.file for each in inputs] == list(files)
        return recordings["force"]

    return read_parts


@pytest.mark.parametrize("nothing", [EMPTY, HEADED], ids=["bare", "header"])
def test_an_empty_part_leaves_its_note_alone(read_parts: ReadParts, nothing: Recording) -> None:
    alone = read_parts(part(3.0), nothing)
    assert alone.notes == EMPTY.notes
    np.testing.assert_array_equal(alone.channels[0].values, 3.0 + np.arange(5.0))
    np.testing.assert_array_equal(alone.clocks[0].time, 3.0 + np.arange(5.0))

    between = read_parts(part(10.0), nothing, part(0.0))
    assert between.notes == EMPTY.notes
    expected = np.concatenate([np.arange(5.0), 10.0 + np.arange(5.0)])
    np.testing.assert_array_equal(between.clocks[0].time, expected)


@pytest.mark.parametrize(
    ("parts", "found"),
    [((EMPTY,), "none in this file"), ((HEADED, EMPTY), "none in any of the parts")],
)
def test_a_test_without_any_sample(
    read_parts: ReadParts, parts: tuple[Recording, ...], found: str
) -> None:
    said = (
        rf"a\.mat: expected samples, found {found}\. The test was aborted before its first "
        r"sample; leave it out\.$"
    )
    with pytest.raises(ReadError, match=said):
        read_parts(*parts)


def test_a_part_that_lacks_the_channel_is_not_taken_for_empty(read_parts: ReadParts) -> None:
    other = replace(part(10.0), channels=(replace(part(10.0).channels[0], path="x", name="x"),))
    with pytest.raises(ReadError, match=r"b\.mat, channel 'Model/Out1': expected one of the 1 cha"):
        read_parts(part(0.0), other)


def test_the_first_of_several_names_that_an_export_has(tmp_path: Path) -> None:
    source = protocol(
        "{reader: dspace-mat, channel: [Model/Load, Model/Out2, Model/Out1], unit: N}"
    )
    recording = read_role(export(tmp_path), source.sources["force"])
    assert recording.channels[0].path == "Model/Out2"


def test_none_of_several_names_is_in_the_export(tmp_path: Path) -> None:
    source = protocol("{reader: dspace-mat, channel: [Model/Load, Model/Otu2], unit: N}")
    path = export(tmp_path)
    with pytest.raises(ReadError, match=r"channel 'Model/Load' or 'Model/Otu2': .*'Model/Out2'"):
        read_role(path, source.sources["force"])


def test_a_channel_that_is_spelt_otherwise_is_told(tmp_path: Path) -> None:
    source = protocol("{reader: dspace-mat, channel: [Load, Force, Kraft, out2], unit: N}")
    recording = read_role(export(tmp_path), source.sources["force"])
    assert recording.channels[0].path == "Model/Out2"
    message = "the export has none called 'Load' or 'Force' or 'Kraft' ...: 'Model/Out2' was taken"
    expected = QualityNote("channel_spelt_otherwise", Severity.INFO, "force", message)
    assert expected in recording.notes


def test_a_part_without_samples() -> None:
    nothing = Recording("dspace-mat")
    said = r"b.mat: expected a part of a recording: channels on one clock, found 0 clocks"
    with pytest.raises(ReadError, match=said):
        join_parts([part(0.0), nothing], ["a.mat", "b.mat"])


def test_parts_without_time_have_no_order() -> None:
    rows = replace(part(0.0), clocks=(Clock("time", np.arange(20.0), "1"),))
    said = (
        r"b\.txt: expected a part of a recording with times, by which parts are put in order, "
        r"found rows without time\. Export the test in one piece, or with its time\."
    )
    with pytest.raises(ReadError, match=said):
        join_parts([part(0.0), rows], ["a.txt", "b.txt"])


SPECIMENS = """\
version: 1
name: p
sources: {frame: {reader: load-frame, channels: {force: {channel: [Load, Force]}}}}
"""


def test_one_of_several_specimens_is_to_be_chosen(tmp_path: Path) -> None:
    path = tmp_path / "pulls.csv"
    path.write_bytes(trapezium((40, 25, 3)))
    source = parse_protocol(SPECIMENS, "p.yaml").sources["frame"]
    with pytest.raises(ReadError) as refused:
        read_role(path, source)
    assert str(refused.value) == (
        f"{path}: expected one specimen, found 3: 'C1', 'C2', 'C3'. Choose one with"
        " 'sources.frame.part: {value: C1, because: ...}' under 'overrides' in test.yaml."
    )
    chosen = source.model_copy(update={"part": "C2"})
    assert len(read_role(path, chosen).channels[0].values) == 25


def test_a_channel_that_no_specimen_has(tmp_path: Path) -> None:
    path = tmp_path / "pulls.csv"
    path.write_bytes(trapezium((40, 25)))
    text = SPECIMENS.replace("[Load, Force]", "Kraft")
    with pytest.raises(
        ReadError, match=r"found no such channel.*sources\.frame\.channels\.force\.c"
    ):
        read_role(path, parse_protocol(text, "p.yaml").sources["frame"])
