"""Units that an export states, against those that protocol and test sheet say."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from labpipe.errors import ReadError
from labpipe.process.reading import read_role
from labpipe.protocol.load import parse_protocol
from labpipe.protocol.source import Source
from labpipe.records.quality import QualityNote, Severity
from labpipe.records.recording import Recording
from tests.builders.controldesk import Axis, Signal, write_mat_v5

VALUES = np.linspace(1.0, 2.0, 20)
KEY = "sources.force.channels.force"


def source(*, unit: str = "", wrong: str = "") -> Source:
    said = (f", unit: {unit}" if unit else "") + (f", wrong_unit_in_file: {wrong}" if wrong else "")
    text = f"{{reader: dspace-mat, channels: {{force: {{channel: Model/Out1{said}}}}}}}"
    text = f"version: 1\nname: p\nsources:\n  force: {text}\n"
    return parse_protocol(text, "p.yaml").sources["force"]


def recorded(tmp_path: Path, stated: str, asked: Source) -> Recording:
    """Read an export whose one channel states a unit."""
    signals = [Signal("Model", "Out1", VALUES, unit=stated)]
    return read_role(write_mat_v5(tmp_path / "a.mat", [Axis(0.01 * np.arange(20))], signals), asked)


def overridden(recording: Recording) -> list[QualityNote]:
    return [note for note in recording.notes if note.code == "unit_overridden"]


@pytest.mark.parametrize(("stated", "factor"), [("N", 1.0), ("kN", 1e3), ("lbf", 4.4482216152605)])
def test_the_unit_of_the_file_is_taken_where_nobody_says_another(
    tmp_path: Path, stated: str, factor: float
) -> None:
    recording = recorded(tmp_path, stated, source())
    np.testing.assert_allclose(recording.channels[0].values, factor * VALUES, rtol=1e-14)
    assert overridden(recording) == []


@pytest.mark.parametrize("stated", ["", "N", "newton", "-", "1"])
def test_a_unit_beside_a_silent_file_or_one_that_means_the_same(
    tmp_path: Path, stated: str
) -> None:
    recording = recorded(tmp_path, stated, source(unit="N"))
    np.testing.assert_allclose(recording.channels[0].values, VALUES)
    assert len(overridden(recording)) == (stated in ("-", "1"))


@pytest.mark.parametrize(
    ("stated", "said", "write"),
    [
        ("kN", "N", "kN"),
        ("N", "kN", "N"),
        ("lbf", "N", "lbf"),
        ("KN", "N", "kN"),
        ("lbs", "N", "lbf"),
    ],
)
def test_a_unit_that_contradicts_the_file_is_refused(
    tmp_path: Path, stated: str, said: str, write: str
) -> None:
    with pytest.raises(ReadError) as refused:
        recorded(tmp_path, stated, source(unit=said))
    assert str(refused.value) == (
        f"{tmp_path / 'a.mat'}, channel 'Model/Out1': expected the unit that the export states,"
        f" '{stated}', found '{KEY}.unit: {said}'. Write {write} there. Only if the export's own"
        f" unit is wrong, add '{KEY}.wrong_unit_in_file: {{value: {stated}, because: ...}}' under"
        " 'overrides' in test.yaml."
    )


def test_a_unit_of_another_quantity_is_another_channel(tmp_path: Path) -> None:
    with pytest.raises(ReadError) as refused:
        recorded(tmp_path, "mm", source(unit="N"))
    assert str(refused.value) == (
        f"{tmp_path / 'a.mat'}, channel 'Model/Out1': expected the unit that the export states,"
        f" 'mm', found '{KEY}.unit: N'. Name another channel with '{KEY}.channel: {{value: ...,"
        " because: ...}' under 'overrides' in test.yaml. Only if the export's own unit is wrong,"
        f" add '{KEY}.wrong_unit_in_file: {{value: mm, because: ...}}' under 'overrides' in"
        " test.yaml."
    )


def test_a_label_in_the_file_that_is_said_to_be_wrong(tmp_path: Path) -> None:
    recording = recorded(tmp_path, "kN", source(unit="N", wrong="kN"))
    np.testing.assert_allclose(recording.channels[0].values, VALUES)
    message = "the export says 'kN', the protocol 'N': the protocol was followed"
    expected = QualityNote("unit_overridden", Severity.WARNING, "force", message)
    assert overridden(recording) == [expected]


def test_another_label_than_the_one_that_is_said_to_be_wrong(tmp_path: Path) -> None:
    """What was true of one export is not taken for the next one."""
    with pytest.raises(ReadError, match=r"unit that the export states, 'mN', found '.*unit: N'"):
        recorded(tmp_path, "mN", source(unit="N", wrong="kN"))


def test_a_label_that_nobody_can_make_out_is_told(tmp_path: Path) -> None:
    recording = recorded(tmp_path, "Einh. 7", source(unit="N"))
    np.testing.assert_allclose(recording.channels[0].values, VALUES)
    assert "the export says 'Einh. 7'" in overridden(recording)[0].message


UNSAID = {
    "": (
        "a unit, found none in the file and none in the protocol. Write the unit of its numbers,"
        f" such as '{KEY}.unit: {{value: N, because: ...}}' under 'overrides' in test.yaml."
    ),
    "KN": (
        f"a unit of the dimension of N, found 'KN'. Write '{KEY}.unit: {{value: kN, because: ...}}'"
        " under 'overrides' in test.yaml."
    ),
    "Einh. 7": (
        f"a unit of the dimension of N, found 'Einh. 7'. Write '{KEY}.unit: {{value: ..., because:"
        " ...}' under 'overrides' in test.yaml."
    ),
    "mm": (
        f"a unit of the dimension of N, found 'mm'. Name another channel with '{KEY}.channel:"
        " {value: ..., because: ...}' under 'overrides' in test.yaml, or give"
        f" '{KEY}.calibration'."
    ),
    "kg": (
        "a unit of the dimension of N, found 'kg'. kg is a unit of mass. To take its weight, write"
        f" '{KEY}.unit: {{value: kg, because: ...}}' under 'overrides' in test.yaml and"
        f" '{KEY}.calibration: {{value: {{gain: 9.80665 N/kg}}, because: ...}}' under 'overrides'"
        " in test.yaml."
    ),
}


@pytest.mark.parametrize("stated", UNSAID)
def test_no_unit_that_can_be_used(tmp_path: Path, stated: str) -> None:
    with pytest.raises(ReadError) as refused:
        recorded(tmp_path, stated, source())
    place = f"{tmp_path / 'a.mat'}, channel 'Model/Out1': expected "
    assert str(refused.value) == place + UNSAID[stated]
