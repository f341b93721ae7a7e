from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from labpipe.errors import ReadError
from labpipe.readers import motive_takes
from labpipe.readers.motive_table import derived_rate, unique_names
from labpipe.records.quality import Severity
from labpipe.records.recording import MarkerTracks
from tests.builders.motive import Column, Layout, marker, rigid_body, write_table

FRAMES = 40
TIP = np.random.default_rng(5).normal(size=(FRAMES, 3)).round(6)
LAYOUT = Layout()


def read(
    folder: Path, columns: list[Column], layout: Layout = LAYOUT
) -> tuple[MarkerTracks, dict[str, str]]:
    file = write_table(folder / "synthetic.csv", columns, FRAMES, layout)
    recording = motive_takes.read(file)
    assert recording.markers is not None
    return recording.markers, {note.code: note.message for note in recording.notes}


def test_time_is_frame_by_rate_where_the_column_was_rounded(tmp_path: Path) -> None:
    take, notes = read(tmp_path, marker("Tip", TIP), replace(LAYOUT, milliseconds=True))
    np.testing.assert_array_equal(take.time, np.arange(FRAMES) / 120.0)
    assert notes["time_rounded"].startswith("the column of times is rounded to milliseconds (up")


def test_a_column_of_times_that_contradicts_is_kept(tmp_path: Path) -> None:
    take, notes = read(tmp_path, marker("Tip", TIP), replace(LAYOUT, time_shift=0.5))
    assert take.time[0] == 0.5
    assert notes["time_column_differs"] == (
        "the column of times is up to 500 ms off frame / rate: kept"
    )


def test_a_cut_file_starts_elsewhere(tmp_path: Path) -> None:
    take, notes = read(tmp_path, marker("Tip", TIP), replace(LAYOUT, first_frame=600))
    assert (take.frames[0], take.time[0]) == (600.0, 5.0)
    assert set(notes) == {"time_start_not_zero"}


def test_frames_that_jump_are_holes(tmp_path: Path) -> None:
    file = write_table(tmp_path / "synthetic.csv", marker("Tip", TIP), FRAMES, LAYOUT)
    lines = file.read_text().splitlines()
    file.write_text("\n".join(lines[:15] + lines[25:]) + "\n")
    recording = motive_takes.read(file)
    (note,) = (n for n in recording.notes if n.code == "time_holes")
    assert "about 10 samples lost" in note.message


def test_a_missing_rate_is_derived_and_noted(tmp_path: Path) -> None:
    layout = replace(LAYOUT, about={"Export Frame Rate": "", "Capture Frame Rate": ""})
    take, notes = read(tmp_path, marker("Tip", TIP), layout)
    assert take.rate == pytest.approx(120.0, rel=1e-4)
    assert "rate_not_stated" in notes


def test_an_unseen_version_is_read_with_a_warning(tmp_path: Path) -> None:
    _, notes = read(tmp_path, marker("Tip", TIP), replace(LAYOUT, version="1.22"))
    assert notes["version_unseen"] == (
        "Format Version 1.22 has not been seen in a real file: read by the rules of"
        " 1.21, 1.23, 1.24, 1.25"
    )


def test_oddities_of_line_1(tmp_path: Path) -> None:
    layout = replace(LAYOUT, take="other", start="2023-11-28 10.27.58.765 DU.")
    _, notes = read(tmp_path, marker("Tip", TIP), layout)
    assert notes["take_name_differs"] == "the take is called 'other', the file 'synthetic.csv'"
    assert notes["start_time_unclear"].startswith("Capture Start Time '2023-11-28 10.27.58.765 DU")


def test_names_become_unique(tmp_path: Path) -> None:
    columns = [*marker("Tip", TIP, id_="1"), *marker("Tip", TIP + 1.0, id_="2")]
    take, notes = read(tmp_path, columns)
    assert take.names == ("Tip 1", "Tip 2")
    assert notes["names_not_unique"] == "names that several objects share carry their id: Tip"
    assert unique_names([("a", "1"), ("a", "1"), ("b", "")]) == ("a 1 #1", "a 1 #2", "b")
    assert unique_names([("a", ""), ("a", "")]) == ("a #1", "a #2")


def test_bones_are_left_out_and_said(tmp_path: Path) -> None:
    columns = [*marker("Tip", TIP), *marker("Hip", TIP, kind="Bone Marker")]
    take, notes = read(tmp_path, columns)
    assert take.names == ("Tip",)
    assert notes["columns_left_out"] == "left out: 1 of type Bone Marker"


def test_euler_angles_become_quaternions(tmp_path: Path) -> None:
    degrees = np.random.default_rng(2).uniform(-80, 80, (FRAMES, 3)).round(6)
    degrees[3] = np.nan
    take, notes = read(tmp_path, rigid_body("Clamp", TIP, degrees), replace(LAYOUT, rotation="XYZ"))
    known = np.arange(FRAMES) != 3
    turns = [
        Rotation.from_euler("X", x, degrees=True)
        * Rotation.from_euler("Y", y, degrees=True)
        * Rotation.from_euler("Z", z, degrees=True)
        for x, y, z in degrees[known]
    ]
    found = Rotation.from_quat(take.bodies[0].rotation[known])
    wanted = Rotation.from_quat([turn.as_quat() for turn in turns])
    np.testing.assert_allclose((found.inv() * wanted).magnitude(), 0.0, atol=1e-12)
    assert np.isnan(take.bodies[0].rotation[3]).all()
    assert notes["rotation_from_euler"].startswith("Euler angles of type 'XYZ' in degrees")


def test_a_body_without_rotation_or_error(tmp_path: Path) -> None:
    take, _ = read(tmp_path, rigid_body("Clamp", TIP, np.empty((FRAMES, 0))))
    assert np.isnan(take.bodies[0].rotation).all()
    assert np.isnan(take.bodies[0].error).all()


def test_the_error_column_of_1_21(tmp_path: Path) -> None:
    columns = rigid_body(
        "Clamp",
        TIP,
        np.ones((FRAMES, 4)),
        error=np.full(FRAMES, 0.5),
        error_word="Error Per Marker",
    )
    take, _ = read(tmp_path, columns, replace(LAYOUT, version="1.21"))
    np.testing.assert_array_equal(take.bodies[0].error, np.full(FRAMES, 0.5))


def test_a_marker_without_all_its_axes_is_refused(tmp_path: Path) -> None:
    expected = (
        r"line 7, Marker 'Tip': expected the columns X, Y and Z of Position,"
        r" found Position X, Position Y\. Export the take with positions"
    )
    with pytest.raises(ReadError, match=expected):
        read(tmp_path, marker("Tip", TIP)[:2])


def test_a_line_without_frame_number_is_refused(tmp_path: Path) -> None:
    file = write_table(tmp_path / "synthetic.csv", marker("Tip", TIP), FRAMES, LAYOUT)
    lines = file.read_text().splitlines()
    lines[10] = lines[10][lines[10].index(",") :]
    file.write_text("\n".join(lines) + "\n")
    with pytest.raises(ReadError, match=r"line 11, cell 1: expected a frame number, found none"):
        motive_takes.read(file)


def test_frames_that_run_backwards_are_an_error_note(tmp_path: Path) -> None:
    file = write_table(tmp_path / "synthetic.csv", marker("Tip", TIP), FRAMES, LAYOUT)
    lines = file.read_text().splitlines()
    file.write_text("\n".join([*lines[:20], lines[12], *lines[20:]]) + "\n")
    (note,) = (n for n in motive_takes.read(file).notes if n.severity is Severity.ERROR)
    assert note.message.startswith("time runs backwards 1 times, first at sample 14")


def test_the_derived_rate_leaves_holes_out() -> None:
    time = np.delete(np.arange(100) / 50.0, np.arange(40, 60))
    assert derived_rate(time) == pytest.approx(50.0)
    assert np.isnan(derived_rate(np.zeros(1)))
    assert np.isnan(derived_rate(np.zeros(5)))
