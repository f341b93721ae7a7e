from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.io import savemat

from labpipe.errors import ReadError
from labpipe.readers import dspace_mat
from labpipe.records.recording import Recording
from tests.builders.controldesk import Axis, Signal, write_mat_v5, write_mat_v73

TIME = np.arange(200) * 0.001
FORCE = Signal("Model Root/Load Cell", "In1", np.sin(TIME), unit="V")
LASER = Signal("Model Root/Laser Sensor\\n", "In1", np.cos(TIME))
WRITERS = [write_mat_v5, write_mat_v73]


def by_path(recording: Recording) -> dict[str, Any]:
    return {channel.path: channel for channel in recording.channels}


@pytest.mark.slow
@pytest.mark.parametrize("write", WRITERS)
@given(
    data=hnp.arrays(
        np.float64,
        st.tuples(st.integers(2, 40), st.integers(1, 4)),
        elements=st.floats(-1e9, 1e9),
    )
)
def test_what_was_written_is_read(tmp_path_factory: Any, write: Any, data: np.ndarray) -> None:
    file = tmp_path_factory.mktemp("mat") / "recording.mat"
    time = np.arange(len(data)) * 0.5
    signals = [Signal(f"Root/{i}", "In1", column) for i, column in enumerate(data.T)]
    write(file, [Axis(time)], signals)
    recording = dspace_mat.read(file)
    np.testing.assert_array_equal(recording.clock("HostService").time, time)
    np.testing.assert_array_equal([c.values for c in recording.channels], data.T)
    assert [c.path for c in recording.channels] == [f"Root/{i}/In1" for i in range(data.shape[1])]


@pytest.mark.parametrize("write", WRITERS)
def test_what_it_says_of_itself(tmp_path: Path, write: Any) -> None:
    recording = dspace_mat.read(write(tmp_path / "other.mat", [Axis(TIME)], [FORCE, LASER]))
    assert (recording.reader, recording.program) == ("dspace-mat", "ControlDesk")
    assert recording.program_version == "7.4"
    assert recording.metadata["variable"] == "recording"
    assert recording.metadata["revision"] == "2.1"
    force = by_path(recording)["Model Root/Load Cell/In1"]
    assert (force.name, force.unit, force.unit_in_file) == ("In1", None, "V")
    about: Any = recording.metadata["channels"]
    assert about["Model Root/Laser Sensor\\n/In1"]["Min"] == "-inf"
    assert {note.code for note in recording.notes} == {
        *("variable_name_differs", "names_not_unique", "line_break_in_path", "units_not_stated"),
    }


def test_the_header_settles_the_date(tmp_path: Path) -> None:
    recording = dspace_mat.read(write_mat_v73(tmp_path / "r.mat", [Axis(TIME)], [FORCE]))
    assert recording.metadata["date"] == "2026-03-04"


@pytest.mark.parametrize("write", WRITERS)
def test_the_order_of_channels_does_not_matter(tmp_path: Path, write: Any) -> None:
    one = dspace_mat.read(write(tmp_path / "a.mat", [Axis(TIME)], [FORCE, LASER]))
    other = dspace_mat.read(write(tmp_path / "b.mat", [Axis(TIME)], [LASER, FORCE]))
    for path, channel in by_path(one).items():
        np.testing.assert_array_equal(channel.values, by_path(other)[path].values)


@pytest.mark.parametrize("write", WRITERS)
def test_several_rasters_are_several_clocks(tmp_path: Path, write: Any) -> None:
    slow = Axis(np.array([0.5, 2.0, 9.0]), "OnChange")
    gain = Signal("Tunable Parameters", "gain", np.array([1.0, 2.0, 3.0]), axis=2)
    file = write(tmp_path / "recording.mat", [Axis(TIME), slow], [FORCE, gain])
    recording = dspace_mat.read(file)
    assert by_path(recording)["Tunable Parameters/gain"].clock == "OnChange"
    np.testing.assert_array_equal(recording.clock("OnChange").time, slow.time)
    alone = dspace_mat.read(file, channels=["gain"])
    assert [clock.name for clock in alone.clocks] == ["OnChange"]


def test_revision_2_0_keeps_quoted_paths_and_small_integers(tmp_path: Path) -> None:
    pulse = Signal("", '"Model Root"/"u1"/"Out1"', np.array([0, 5, 0], dtype=np.uint8))
    axis = Axis(np.array([-1.0, -0.5, 0.0]))
    recording = dspace_mat.read(
        write_mat_v5(tmp_path / "recording.mat", [axis], [pulse], revision="2.0")
    )
    (channel,) = recording.channels
    assert (channel.name, channel.path) == ("Out1", '"Model Root"/"u1"/"Out1"')
    assert channel.values.dtype == np.float64
    assert channel.values[0] - 1 == -1.0
    assert recording.clocks[0].name == "time"
    assert recording.metadata["revision"] == "2.0"


def test_data_may_stand_in_columns(tmp_path: Path) -> None:
    recording = dspace_mat.read(
        write_mat_v5(tmp_path / "recording.mat", [Axis(TIME)], [FORCE], columns=True)
    )
    np.testing.assert_array_equal(recording.channels[0].values, FORCE.values)


def test_a_start_that_contradicts_the_axis_is_noted(tmp_path: Path) -> None:
    file = write_mat_v5(tmp_path / "recording.mat", [Axis(TIME)], [FORCE], start=-0.0025)
    assert "start_differs" in {note.code for note in dspace_mat.read(file).notes}


def test_an_unseen_revision_is_noted_or_refused(tmp_path: Path) -> None:
    file = write_mat_v5(tmp_path / "recording.mat", [Axis(TIME)], [FORCE], revision="2.7")
    messages = [n.message for n in dspace_mat.read(file).notes if n.code == "revision_unseen"]
    assert messages == ["file format revision 2.7: only 2.0 and 2.1 are known"]
    file = write_mat_v5(tmp_path / "new.mat", [Axis(TIME)], [FORCE], revision="3.0")
    with pytest.raises(ReadError, match=r"Info: expected a file format revision 2\.x, found 3\.0"):
        dspace_mat.read(file)


def test_a_mat_file_of_something_else(tmp_path: Path) -> None:
    file = tmp_path / "other.mat"
    savemat(file, {"a": np.zeros(3), "b": "text"})
    expected = r"other\.mat: expected one variable with the fields X and Y.*found only a, b\."
    with pytest.raises(ReadError, match=expected):
        dspace_mat.read(file)


def test_two_recordings_in_one_file(tmp_path: Path) -> None:
    file = tmp_path / "two.mat"
    one = {"X": {"Data": TIME}, "Y": {"Data": TIME}}
    savemat(file, {"a": one, "b": one})
    with pytest.raises(ReadError, match=r"found 2 among the variables a, b\."):
        dspace_mat.read(file)


def test_structs_without_samples(tmp_path: Path) -> None:
    file = tmp_path / "odd.mat"
    savemat(file, {"a": {"X": {"Data": TIME}, "Y": {"Name": "F"}}})
    with pytest.raises(ReadError, match=r"field Y: expected a struct with the field Data, found"):
        dspace_mat.read(file)


def test_a_channel_on_an_axis_that_does_not_exist(tmp_path: Path) -> None:
    lost = Signal("Root", "F", TIME, axis=3)
    file = write_mat_v5(tmp_path / "recording.mat", [Axis(TIME)], [lost])
    expected = r"channel 'Root/F', XIndex: expected the number of a time axis, 1 to 1, found 3\."
    with pytest.raises(ReadError, match=expected):
        dspace_mat.read(file)


def test_text_in_the_place_of_numbers(tmp_path: Path) -> None:
    file = write_mat_v5(
        tmp_path / "recording.mat", [Axis(TIME)], [Signal("Root", "F", np.array(["a"]))]
    )
    with pytest.raises(ReadError, match=r"expected the samples of Root/F, found a damaged one"):
        dspace_mat.read(file)


def test_a_wanted_channel_that_is_missing(tmp_path: Path) -> None:
    file = write_mat_v73(tmp_path / "recording.mat", [Axis(TIME)], [FORCE, LASER])
    with pytest.raises(ReadError, match=r"Nearest: 'Model Root/Load Cell/In1'"):
        dspace_mat.read(file, channels=["Model Root/Lod Cell/In1"])


def test_a_data_set_that_claims_more_than_the_file_can_hold(tmp_path: Path) -> None:
    file = write_mat_v73(tmp_path / "recording.mat", [Axis(TIME)], [FORCE, LASER])
    with h5py.File(file, "r+") as stored:
        del stored["recording/X/Data"]
        stored["recording/X"].create_dataset("Data", (10**12, 1), chunks=(100, 1), dtype="f8")
    with pytest.raises(ReadError, match=r"v7\.3 file, found a damaged one \(.*claims 8000000"):
        dspace_mat.read(file)


def in_another_way(group: h5py.Group, name: str, how: str) -> None:
    """In place of a data set one that other files hold, or none, for the most part."""
    old = group[name]
    labels, shape, kind = dict(old.attrs), old.shape, old.dtype
    other = Path(group.file.filename).with_name("other.h5")
    del group[name]
    if how == "link":
        group[name] = h5py.ExternalLink(str(other), "secret")
        return
    if how == "virtual":
        layout = h5py.VirtualLayout(shape=shape, dtype=kind)
        layout[:] = h5py.VirtualSource(str(other), "secret", shape=shape)
        made = group.create_virtual_dataset(name, layout)
    elif how == "external":
        made = group.create_dataset(name, shape=shape, dtype=kind, external=[(other, 0, 10**6)])
    else:
        made = group.create_dataset(name, shape=(1, 10**6), dtype=kind, chunks=(1, 1000))
        made[0, :10] = 1.0
    made.attrs.update(labels)


@pytest.mark.parametrize(
    ("how", "said"),
    [
        ("link", "is a link into another file"),
        ("virtual", "keeps its samples in another file"),
        ("external", "keeps its samples in another file"),
        ("sparse", "claims 8000000 bytes in a file of"),
    ],
)
def test_samples_that_the_file_does_not_hold(tmp_path: Path, how: str, said: str) -> None:
    file = write_mat_v73(tmp_path / "recording.mat", [Axis(TIME)], [FORCE, LASER])
    with h5py.File(tmp_path / "other.h5", "w") as other:
        other["secret"] = np.zeros((1, len(TIME)))
    with h5py.File(file, "r+") as opened:
        in_another_way(opened["recording/X"], "Data", how)
    with pytest.raises(ReadError, match=rf"a whole MAT v7\.3 file, found a damaged one \(.*{said}"):
        dspace_mat.read(file)


@pytest.mark.parametrize("write", WRITERS)
@pytest.mark.parametrize("part", [0.05, 0.3, 0.6, 0.95])
def test_a_truncated_file(tmp_path: Path, write: Any, part: float) -> None:
    file = write(tmp_path / "recording.mat", [Axis(TIME)], [FORCE, LASER])
    content = file.read_bytes()
    file.write_bytes(content[: int(part * len(content))])
    with pytest.raises(ReadError, match=r"Export the recording"):
        dspace_mat.read(file)
