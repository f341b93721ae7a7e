from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from labpipe.errors import ReadError
from labpipe.readers import dspace_mf4
from tests.builders.controldesk import Axis, Signal, write_mf4

TIME = 1.25 + np.arange(300) * 0.001
FORCE = Signal("Model Root/Load Cell", "In1", np.sin(TIME))
MOTION = Signal("Model Root/Laser", "In1", np.cos(TIME), unit="mm")


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return write_mf4(tmp_path / "r.mf4", Axis(TIME), [FORCE, MOTION])


def test_what_was_written_is_read(file: Path) -> None:
    recording = dspace_mf4.read(file)
    assert [c.path for c in recording.channels] == [
        "Model Root/Load Cell/In1",
        "Model Root/Laser/In1",
    ]
    assert [c.name for c in recording.channels] == ["In1", "In1"]
    assert [c.unit_in_file for c in recording.channels] == ["", "mm"]
    np.testing.assert_array_equal(recording.clocks[0].time, TIME)
    np.testing.assert_array_equal(recording.channels[0].values, FORCE.values)
    np.testing.assert_array_equal(recording.channels[1].values, MOTION.values)
    assert (recording.program, recording.program_version) == ("ControlDesk", "7.4")
    assert recording.metadata["mdf"] == "4.10"


def test_channels_are_chosen_by_path(file: Path) -> None:
    (channel,) = dspace_mf4.read(file, channels=["Model Root/Laser/In1"]).channels
    np.testing.assert_array_equal(channel.values, MOTION.values)
    with pytest.raises(ReadError, match=r"found 2 channels of that name"):
        dspace_mf4.read(file, channels=["In1"])


@pytest.mark.parametrize("part", [0.05, 0.5])
def test_a_truncated_file(file: Path, part: float) -> None:
    content = file.read_bytes()
    file.write_bytes(content[: int(part * len(content))])
    with pytest.raises(ReadError, match=r"expected a whole MDF 4 file, found a damaged one"):
        dspace_mf4.read(file)


def damage(file: Path, old: bytes, new: bytes, *, behind: bytes) -> None:
    """Put other bytes in the first place behind a mark where the old ones stand."""
    content = file.read_bytes()
    at = content.index(old, content.index(behind))
    file.write_bytes(content[:at] + new + content[at + len(old) :])


@pytest.mark.parametrize(
    ("old", "new", "behind"),
    [
        (b"\x18\0\0\0", b"\x18\0\0\x7f", b"##CG"),  # a record of 24 bytes, or of 2 GB
        (b"\x08\0\0\0\x40\0\0\0", b"\x08\0\0\x0f\x40\0\0\0", b"##CN"),  # a byte offset
        (b"Model Root/Laser", 16 * b"\0", b"MDF"),  # a channel without a name
    ],
)
def test_what_no_file_says(
    file: Path, capfd: pytest.CaptureFixture[str], old: bytes, new: bytes, behind: bytes
) -> None:
    damage(file, old, new, behind=behind)
    with pytest.raises(ReadError, match="found a damaged one"):
        dspace_mf4.read(file)
    assert capfd.readouterr() == ("", "")


def test_without_the_library_the_error_says_what_to_install(
    file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "asammdf", None)
    expected = (
        r"r\.mf4: expected the package asammdf to read MF4, found it is not installed\."
        r' Run: pip install "labpipe\[mf4\]", or export the recording as MAT\.'
    )
    with pytest.raises(ReadError, match=expected):
        dspace_mf4.read(file)
