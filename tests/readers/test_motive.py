"""Takes of Motive: tables, rows, headers, and what is noted of tracks."""

from __future__ import annotations

import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from openpyxl import Workbook
from scipy.spatial.transform import Rotation

from labpipe.errors import ReadError
from labpipe.readers import motive_takes
from labpipe.readers.motive_rows import RowExport, parse_rows
from labpipe.readers.motive_table import Header, derived_rate, parse_header, unique_names
from labpipe.readers.tracking import longest, runs, track_notes
from labpipe.records.quality import Severity
from labpipe.records.recording import MarkerTracks, Recording, RigidBody
from tests.builders.motive import (
    Column,
    Layout,
    RowBody,
    fitted_marker,
    marker,
    rigid_body,
    write_row_style,
    write_table,
    write_xlsx,
)

FRAMES = 30


RANDOM = np.random.default_rng(7)


TIP, BASE, CLAMP = (RANDOM.normal(size=(FRAMES, 3)).round(6) for _ in range(3))


TURN = RANDOM.normal(size=(FRAMES, 4)).round(6)


ERROR = np.full(FRAMES, 0.000105)


LAYOUT = Layout()


COLUMNS = [
    *rigid_body("Clamp", CLAMP, TURN, error=ERROR),
    *fitted_marker("Clamp:Marker1", TIP + 5.0),
    *marker("Clamp:Marker1", TIP),
    *marker("Unlabeled 12", BASE, id_="C3500"),
]


def tracks(recording: Recording) -> MarkerTracks:
    assert recording.markers is not None
    return recording.markers


def notes(recording: Recording) -> dict[str, str]:
    return {note.code: note.message for note in recording.notes}


positions = hnp.arrays(
    np.float64,
    st.tuples(st.integers(1, 12), st.integers(0, 3), st.just(3)),
    elements=st.integers(-(10**9), 10**9).map(lambda n: n / 1e6),
)


@given(
    data=positions,
    gap=st.integers(0, 20),
    version=st.sampled_from(["1.21", "1.23", "1.24", "1.25"]),
    line_end=st.sampled_from(["\n", "\r\n"]),
    flags=st.tuples(*[st.booleans()] * 4),
)
def test_what_was_written_is_read(
    tmp_path_factory: Any,
    data: np.ndarray,
    gap: int,
    version: str,
    line_end: str,
    flags: tuple[bool, bool, bool, bool],
) -> None:
    data = data.copy()
    data[gap : gap + 2, :1] = np.nan
    bom, time_code, milliseconds, padded = flags
    layout = Layout(
        version=version,
        line_end=line_end,
        bom=bom,
        time_code=time_code,
        milliseconds=milliseconds,
        padding=3 * padded,
    )
    names = [f"Wire:Marker {i}" for i in range(data.shape[1])]
    columns = [c for i, name in enumerate(names) for c in marker(name, data[:, i])]
    file = tmp_path_factory.mktemp("motive") / "take.csv"
    take = tracks(motive_takes.read(write_table(file, columns, len(data), layout)))
    assert take.names == tuple(names)
    np.testing.assert_allclose(take.positions, data, rtol=1e-15)
    np.testing.assert_array_equal(take.time, np.arange(len(data)) / 120.0)


@pytest.mark.parametrize("version", ["1.21", "1.23", "1.24", "1.25"])
def test_bodies_and_measured_markers(tmp_path: Path, version: str) -> None:
    layout = replace(LAYOUT, version=version, lower_w=version == "1.25")
    recording = motive_takes.read(write_table(tmp_path / "synthetic.csv", COLUMNS, FRAMES, layout))
    take = tracks(recording)
    assert take.names == ("Clamp:Marker1", "Unlabeled 12")
    np.testing.assert_allclose(take.positions[:, 0], TIP, rtol=1e-15)
    body = take.body("Clamp")
    assert body is not None
    np.testing.assert_allclose(body.position, CLAMP, rtol=1e-15)
    np.testing.assert_allclose(body.rotation, TURN, rtol=1e-15)
    np.testing.assert_allclose(body.error, ERROR, rtol=1e-15)
    assert (recording.program, recording.program_version) == ("Motive", version)
    assert set(notes(recording)) == {"fitted_markers", "unlabelled_markers"}


@pytest.mark.parametrize(
    ("unit", "factor"), [("Meters", 1.0), ("Centimeters", 0.01), ("Millimeters", 0.001)]
)
def test_lengths_become_metres(tmp_path: Path, unit: str, factor: float) -> None:
    layout = replace(LAYOUT, unit=unit)
    take = tracks(motive_takes.read(write_table(tmp_path / "take.csv", COLUMNS, FRAMES, layout)))
    np.testing.assert_allclose(take.positions[:, 0], TIP * factor, rtol=1e-14)
    np.testing.assert_allclose(take.bodies[0].position, CLAMP * factor, rtol=1e-14)
    np.testing.assert_allclose(take.bodies[0].error, ERROR * factor, rtol=1e-14)
    assert take.unit_in_file == unit


def test_the_same_sheet_saved_as_xlsx(tmp_path: Path) -> None:
    gap = TIP.copy()
    gap[4:7] = np.nan
    columns = [*COLUMNS, *marker("Tip", gap)]
    one = motive_takes.read(write_table(tmp_path / "synthetic.csv", columns, FRAMES, LAYOUT))
    file = write_xlsx(tmp_path / "synthetic.xlsx", columns, FRAMES, LAYOUT)
    assert motive_takes.recognise(file)
    other = motive_takes.read(file)
    np.testing.assert_allclose(tracks(one).positions, tracks(other).positions, rtol=1e-15)
    assert tracks(one).names == tracks(other).names
    assert tracks(one).rate == tracks(other).rate
    assert notes(one) == notes(other)
    assert (other.reader, other.program_version) == ("motive-xlsx", "1.23")


def test_a_cell_of_a_workbook_that_is_no_number(tmp_path: Path) -> None:
    from openpyxl import load_workbook

    file = write_xlsx(tmp_path / "take.xlsx", COLUMNS, FRAMES, LAYOUT)
    book = load_workbook(file)
    book.active["F12"] = "lost"  # type: ignore[index]
    book.save(file)
    with pytest.raises(
        ReadError, match=r"row 12, column 'Clamp Rotation W': expected .*, found 'lost'"
    ):
        motive_takes.read(file)


def test_an_empty_take_is_legal(tmp_path: Path) -> None:
    recording = motive_takes.read(write_table(tmp_path / "synthetic.csv", [], 9, LAYOUT))
    take = tracks(recording)
    assert (take.positions.shape, take.names, take.bodies) == ((9, 0, 3), (), ())
    assert set(notes(recording)) == {"take_empty"}


def test_a_cut_in_mid_line_loses_that_line_only(tmp_path: Path) -> None:
    file = write_table(tmp_path / "synthetic.csv", COLUMNS, FRAMES, LAYOUT)
    file.write_bytes(file.read_bytes()[:-20])
    recording = motive_takes.read(file)
    assert len(tracks(recording).time) == FRAMES - 1
    found = notes(recording)
    assert found["truncated"] == "the last line (37) is incomplete and was left out"
    assert found["rows_differ"] == "the header states 30 rows, the file holds 29"


def test_stated_rows_that_are_wrong(tmp_path: Path) -> None:
    layout = replace(LAYOUT, stated=190951)
    for file in (
        write_table(tmp_path / "take.csv", COLUMNS, FRAMES, layout),
        write_xlsx(tmp_path / "take.xlsx", COLUMNS, FRAMES, layout),
    ):
        assert notes(motive_takes.read(file))["rows_differ"] == (
            "the header states 190951 rows, the file holds 30"
        )


def test_infinite_numbers_count_as_blank(tmp_path: Path) -> None:
    file = write_table(tmp_path / "take.csv", COLUMNS, FRAMES, LAYOUT)
    lines = file.read_text().splitlines()
    cells = lines[12].split(",")
    cells[-1] = "inf"
    lines[12] = ",".join(cells)
    file.write_text("\n".join(lines) + "\n")
    recording = motive_takes.read(file)
    assert tracks(recording).missing["Unlabeled 12"] == 1
    assert notes(recording)["not_finite"] == (
        "1 infinite numbers count as blank, the first in data row 6"
    )


def test_row_style_is_read_through_the_same_door(tmp_path: Path) -> None:
    file = write_row_style(tmp_path / "rows.csv", np.arange(4) / 120.0, [])
    assert motive_takes.recognise(file)
    recording = motive_takes.read(file)
    assert (recording.reader, recording.program_version) == ("motive-csv", "1.1")
    assert len(tracks(recording).time) == 4


def test_a_workbook_of_something_else(tmp_path: Path) -> None:
    file = tmp_path / "other.xlsx"
    book = Workbook()
    book.active.append(["time", "force"])  # type: ignore[union-attr]
    book.save(file)
    assert not motive_takes.recognise(file)
    with pytest.raises(ReadError, match=r"expected a sheet whose first cell is Format Version"):
        motive_takes.read(file)
    archive = tmp_path / "files.zip"
    with zipfile.ZipFile(archive, "w") as parts:
        parts.writestr("readme.txt", "Format Version")
    assert not motive_takes.recognise(archive)
    archive.write_bytes(archive.read_bytes()[:-30])
    assert not motive_takes.recognise(archive)


TABLE_FRAMES = 40


TRACK = np.random.default_rng(5).normal(size=(TABLE_FRAMES, 3)).round(6)


def read(
    folder: Path, columns: list[Column], layout: Layout = LAYOUT
) -> tuple[MarkerTracks, dict[str, str]]:
    file = write_table(folder / "synthetic.csv", columns, TABLE_FRAMES, layout)
    recording = motive_takes.read(file)
    assert recording.markers is not None
    return recording.markers, {note.code: note.message for note in recording.notes}


def test_time_is_frame_by_rate_where_the_column_was_rounded(tmp_path: Path) -> None:
    take, notes = read(tmp_path, marker("Tip", TRACK), replace(LAYOUT, milliseconds=True))
    np.testing.assert_array_equal(take.time, np.arange(TABLE_FRAMES) / 120.0)
    assert notes["time_rounded"].startswith("the column of times is rounded to milliseconds (up")


def test_a_column_of_times_that_contradicts_is_kept(tmp_path: Path) -> None:
    take, notes = read(tmp_path, marker("Tip", TRACK), replace(LAYOUT, time_shift=0.5))
    assert take.time[0] == 0.5
    assert notes["time_column_differs"] == (
        "the column of times is up to 500 ms off frame / rate: kept"
    )


def test_a_missing_rate_is_derived_and_noted(tmp_path: Path) -> None:
    layout = replace(LAYOUT, about={"Export Frame Rate": "", "Capture Frame Rate": ""})
    take, notes = read(tmp_path, marker("Tip", TRACK), layout)
    assert take.rate == pytest.approx(120.0, rel=1e-4)
    assert "rate_not_stated" in notes


def test_an_unseen_version_is_read_with_a_warning(tmp_path: Path) -> None:
    _, notes = read(tmp_path, marker("Tip", TRACK), replace(LAYOUT, version="1.22"))
    assert notes["version_unseen"] == (
        "Format Version 1.22 has not been seen in a real file: read by the rules of"
        " 1.21, 1.23, 1.24, 1.25"
    )


def test_oddities_of_line_1(tmp_path: Path) -> None:
    layout = replace(LAYOUT, take="other", start="2023-11-28 10.27.58.765 DU.")
    _, notes = read(tmp_path, marker("Tip", TRACK), layout)
    assert notes["take_name_differs"] == "the take is called 'other', the file 'synthetic.csv'"
    assert notes["start_time_unclear"].startswith("Capture Start Time '2023-11-28 10.27.58.765 DU")


def test_names_become_unique(tmp_path: Path) -> None:
    columns = [*marker("Tip", TRACK, id_="1"), *marker("Tip", TRACK + 1.0, id_="2")]
    take, notes = read(tmp_path, columns)
    assert take.names == ("Tip 1", "Tip 2")
    assert notes["names_not_unique"] == "names that several objects share carry their id: Tip"
    assert unique_names([("a", "1"), ("a", "1"), ("b", "")]) == ("a 1 #1", "a 1 #2", "b")
    assert unique_names([("a", ""), ("a", "")]) == ("a #1", "a #2")


def test_bones_are_left_out_and_said(tmp_path: Path) -> None:
    columns = [*marker("Tip", TRACK), *marker("Hip", TRACK, kind="Bone Marker")]
    take, notes = read(tmp_path, columns)
    assert take.names == ("Tip",)
    assert notes["columns_left_out"] == "left out: 1 of type Bone Marker"


def test_euler_angles_become_quaternions(tmp_path: Path) -> None:
    degrees = np.random.default_rng(2).uniform(-80, 80, (TABLE_FRAMES, 3)).round(6)
    degrees[3] = np.nan
    take, notes = read(
        tmp_path, rigid_body("Clamp", TRACK, degrees), replace(LAYOUT, rotation="XYZ")
    )
    known = np.arange(TABLE_FRAMES) != 3
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


def test_a_marker_without_all_its_axes_is_refused(tmp_path: Path) -> None:
    expected = (
        r"line 7, Marker 'Tip': expected the columns X, Y and Z of Position,"
        r" found Position X, Position Y\. Export the take with positions"
    )
    with pytest.raises(ReadError, match=expected):
        read(tmp_path, marker("Tip", TRACK)[:2])


def test_a_line_without_frame_number_is_refused(tmp_path: Path) -> None:
    file = write_table(tmp_path / "synthetic.csv", marker("Tip", TRACK), TABLE_FRAMES, LAYOUT)
    lines = file.read_text().splitlines()
    lines[10] = lines[10][lines[10].index(",") :]
    file.write_text("\n".join(lines) + "\n")
    with pytest.raises(ReadError, match=r"line 11, cell 1: expected a frame number, found none"):
        motive_takes.read(file)


def test_frames_that_run_backwards_are_an_error_note(tmp_path: Path) -> None:
    file = write_table(tmp_path / "synthetic.csv", marker("Tip", TRACK), TABLE_FRAMES, LAYOUT)
    lines = file.read_text().splitlines()
    file.write_text("\n".join([*lines[:20], lines[12], *lines[20:]]) + "\n")
    (note,) = (n for n in motive_takes.read(file).notes if n.severity is Severity.ERROR)
    assert note.message.startswith("time runs backwards 1 times, first at sample 14")


def test_the_derived_rate_leaves_holes_out() -> None:
    time = np.delete(np.arange(100) / 50.0, np.arange(40, 60))
    assert derived_rate(time) == pytest.approx(50.0)
    assert np.isnan(derived_rate(np.zeros(1)))
    assert np.isnan(derived_rate(np.zeros(5)))


FILE = Path("take.csv")


LINE_1 = "Format Version,1.23,Export Frame Rate,120.000000,Length Units,Meters"


LABELS = [",Type,Marker,Marker,Marker", ",Name,A,A,A", ",ID,1,1,1"]


QUANTITY, AXES = ",,Position,Position,Position", "Frame,Time (Seconds),X,Y,Z"


WHOLE = [LINE_1, "", *LABELS, QUANTITY, AXES]


def parse(*lines: str) -> Header:
    return parse_header([line.split(",") if line else [] for line in lines], FILE)


def test_rows_without_words_are_taken_in_order() -> None:
    wordless = [line.replace("Type", "").replace("Name", "").replace("ID", "") for line in LABELS]
    header = parse(LINE_1, "", *wordless, QUANTITY, "Frame,Time,X,Y,Z")
    assert header.groups == parse(*WHOLE).groups


def test_a_column_of_time_codes_is_stepped_over() -> None:
    labels = ["," + line for line in [*LABELS, QUANTITY]]
    header = parse(LINE_1, "", *labels, "Frame,Time (Seconds),TimeCode,X,Y,Z")
    assert header.groups[0].axes("Position", "XYZ") == [3, 4, 5]
    assert header.time_column == 1


def test_the_same_name_and_id_twice_are_two_objects() -> None:
    rows = [
        line + line.replace(",Type", "").replace(",Name", "").replace(",ID", "") for line in LABELS
    ]
    header = parse(LINE_1, "", *rows, QUANTITY + ",Position" * 3, AXES + ",X,Y,Z")
    assert [group.axes("Position", "XYZ") for group in header.groups] == [[2, 3, 4], [5, 6, 7]]


def test_a_comma_inside_a_value_of_line_1() -> None:
    line = LINE_1.replace("Export", "Take Notes,wet, cold,Export")
    header = parse(line, *WHOLE[1:])
    assert header.about["Take Notes"] == "wet, cold"
    assert header.rate == 120.0


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        (
            "1.23",
            "3.00",
            r"line 1: expected Format Version 1\.x after the first comma, found '3",
        ),
        ("1.23", "", r"found no version\. Export the take with Format Version 1\.2x"),
        (
            "Meters",
            "Furlongs",
            r"line 1: expected Length Units, one of Meters, .*found 'Fur",
        ),
        ("Frame,Time", "Image,Time", r"lines 1 to 7: expected a header row that begins with Frame"),
        (
            ",ID,1,1,1",
            ",Mass,1,1,1",
            r"lines 2 to 6: expected header rows Type, Name, ID, fo",
        ),
        ("Type,Marker", "Type,", r"line 7, cell 3: expected a column with a type, found none"),
    ],
)
def test_headers_that_are_refused(old: str, new: str, expected: str) -> None:
    lines = [line.replace(old, new) for line in WHOLE]
    with pytest.raises(
        ReadError, match=r"^take\.csv, " if "no version" not in expected else "^take"
    ):
        parse(*lines)
    with pytest.raises(ReadError, match=expected):
        parse(*lines)


ROWS = 12


DRAWN = np.random.default_rng(11)


TIMES = np.arange(ROWS) / 120.0


def body(name: str = "Clamp", number: int = 1, lost: tuple[int, ...] = ()) -> RowBody:
    tracked = np.ones(ROWS, dtype=np.bool_)
    tracked[list(lost)] = False
    return RowBody(
        name,
        number,
        DRAWN.normal(size=(ROWS, 3)).round(8),
        DRAWN.normal(size=(ROWS, 4)).round(8),
        DRAWN.normal(size=(ROWS, 3, 3)).round(8),
        tracked,
    )


def parse_file(file: Path) -> RowExport:
    return parse_rows(file.read_text(), file)


def notes_of_rows(export: RowExport) -> dict[str, str]:
    return {note.code: note.message for note in export.notes}


@pytest.mark.parametrize("version", ["1.0", "1.1"])
@given(lost=st.sets(st.integers(0, ROWS - 1)), hidden=st.integers(0, ROWS - 1))
def test_rows_that_were_written_are_read(
    tmp_path_factory: Any, version: str, lost: set[int], hidden: int
) -> None:
    clamp, grip = body(lost=tuple(lost)), body("Grip", 2)
    clamp.measured[hidden, 1] = np.nan
    file = tmp_path_factory.mktemp("rows") / "take.csv"
    export = parse_file(write_row_style(file, TIMES, [clamp, grip], version=version))
    assert export.version == version
    assert export.tracks.names == tuple(
        f"{b}-Marker {i}" for b in ("Clamp", "Grip") for i in (1, 2, 3)
    )
    for one, other in zip((clamp, grip), export.tracks.bodies, strict=True):
        seen = one.tracked
        np.testing.assert_array_equal(other.position[seen], one.position[seen])
        np.testing.assert_array_equal(other.rotation[seen], one.rotation[seen])
        np.testing.assert_array_equal(other.error[seen], np.full(seen.sum(), 0.00025))
        assert np.isnan(other.position[~seen]).all()
    measured = np.where(clamp.tracked[:, None, None], clamp.measured, np.nan)
    np.testing.assert_array_equal(export.tracks.positions[:, :3], measured)
    np.testing.assert_array_equal(export.tracks.time, TIMES.round(8))


def test_a_lost_body_that_keeps_its_last_pose_has_none(tmp_path: Path) -> None:
    clamp = replace(body(lost=(5, 6)), keeps_pose=True)
    export = parse_file(write_row_style(tmp_path / "take.csv", TIMES, [clamp]))
    assert np.flatnonzero(np.isnan(export.tracks.bodies[0].position[:, 0])).tolist() == [5, 6]
    assert export.about["frames_without_body"] == 0


def test_a_point_of_another_name_is_a_marker_in_1_1(tmp_path: Path) -> None:
    stray = DRAWN.normal(size=(ROWS, 3)).round(8)
    stray[2] = np.nan
    export = parse_file(write_row_style(tmp_path / "take.csv", TIMES, [body()], stray=stray))
    assert export.tracks.names[-1] == "Marker-99"
    np.testing.assert_array_equal(export.tracks.positions[:, -1], stray)


def test_a_point_without_identity_is_counted_in_1_0(tmp_path: Path) -> None:
    stray = DRAWN.normal(size=(ROWS, 3)).round(8)
    stray[2] = np.nan
    file = write_row_style(tmp_path / "take.csv", TIMES, [body()], version="1.0", stray=stray)
    assert notes_of_rows(parse_file(file))["anonymous_markers"] == (
        "11 points in 11 frames belong to no body and have no identity: left out"
    )


def test_what_it_says_of_itself(tmp_path: Path) -> None:
    export = parse_file(
        write_row_style(tmp_path / "take.csv", TIMES, [body(lost=(3, 4))], stated=99)
    )
    assert export.about["title"] == "Synthetic Export Data"
    assert export.about["frames_without_body"] == 2
    assert export.about["visible_markers"] == {"least": 0, "most": 3}
    found = notes_of_rows(export)
    assert found["rows_differ"] == "the header states 99 rows, the file holds 12 frames"
    assert found["frames_without_body"] == "2 of 12 frames hold no rigid body"
    assert found["visible_markers"] == "0 to 3 markers are seen in a frame"
    assert found["unit_assumed"].startswith("no unit is stated: positions are taken as metres")


def test_a_cut_last_line_is_left_out(tmp_path: Path) -> None:
    file = write_row_style(tmp_path / "take.csv", TIMES, [body()])
    file.write_bytes(file.read_bytes()[:-40])
    export = parse_file(file)
    assert notes_of_rows(export)["truncated"] == "the last line (31) is incomplete and was left out"
    assert len(export.tracks.time) == ROWS


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("frame,3,", "image,3,", r"line 14: expected one of the row types of a Motive export with"),
        ("frame,3,", "frame,x,", r"line 14: .*found 'frame' with \d+ cells \(could not convert"),
        ("frame,3,", "frame,3,9,", r"line 14: .*found 'frame' with \d+ cells"),
        ("rigidbody,3,", "rigidbody,7,", r"line 15: .*\(frame 7 has no frame line before it\)"),
        ("1.1", "2.0", r"info: expected info,version,1\.0 or 1\.1, found '2\.0'\. Export"),
    ],
)
def test_lines_that_are_refused(tmp_path: Path, old: str, new: str, expected: str) -> None:
    file = write_row_style(tmp_path / "take.csv", TIMES, [body()])
    text = file.read_text().replace(old, new, 1)
    with pytest.raises(ReadError, match=expected):
        parse_rows(text, file)


def take(**positions: np.ndarray) -> MarkerTracks:
    frames = len(next(iter(positions.values()))) if positions else 5
    stack = np.stack(list(positions.values()), axis=1) if positions else np.empty((5, 0, 3))
    numbers = np.arange(float(frames))
    names = tuple(name.replace("_", " ") for name in positions)
    return MarkerTracks(numbers / 50.0, numbers, 50.0, names, stack)


def moving(frames: int = 40) -> np.ndarray:
    return np.arange(frames * 3.0).reshape(frames, 3)


def track_codes(tracks: MarkerTracks) -> dict[str, str]:
    return {f"{note.code} {note.where}": note.message for note in track_notes(tracks)}


@given(st.lists(st.booleans()))
def test_runs_are_the_flags(flags: list[bool]) -> None:
    array = np.array(flags, dtype=np.bool_)
    rebuilt = np.zeros(len(flags), dtype=np.bool_)
    stretches = runs(array)
    for run in stretches:
        assert not rebuilt[max(run.first - 1, 0) : run.last + 1].any()
        rebuilt[run.first : run.last + 1] = True
    np.testing.assert_array_equal(rebuilt, array)
    assert sum(run.length for run in stretches) == sum(flags)
    assert longest(stretches) == max(len(s) for s in "".join("01"[f] for f in flags).split("0"))


def test_gaps_and_markers_never_seen() -> None:
    track = moving()
    track[[3, 4, 9]] = np.nan
    notes = track_codes(take(tip=track, base=np.full((40, 3), np.nan)))
    assert notes == {
        "marker_gaps tip": "missing in 3 of 40 frames, gaps: 2, the longest 2 frames",
        "marker_blank markers": "never seen: base",
    }


def test_a_frozen_body() -> None:
    track = moving()
    track[10:30] = track[10]
    body = RigidBody("Clamp", track, np.full((40, 4), np.nan), np.full(40, np.nan))
    tracks = take(tip=moving())
    tracks = MarkerTracks(tracks.time, tracks.frames, 50.0, ("tip",), tracks.positions, (body,))
    assert track_codes(tracks) == {
        "frozen_pose Clamp": "position unchanged to the last digit in 19 of 39 steps,"
        " up to 19 in a row: lost and kept at its last pose?"
    }


def test_a_label_switch() -> None:
    labelled, spare, passing = moving(), moving(), moving()
    labelled[:12] = np.nan
    spare[12:] = np.nan
    passing[5:] = np.nan
    notes = track_codes(take(tip=labelled, Unlabeled_7=spare, Unlabeled_8=passing))
    assert notes["label_switch tip"] == (
        "missing in rows 0-11, just where Unlabeled 7 is seen: label switch?"
    )
    assert notes["unlabelled_markers markers"] == "2 of 3 markers have no label of their own"
    assert sum(key.startswith("label_switch") for key in notes) == 1


def test_a_take_without_frames_is_refused(tmp_path: Path) -> None:
    file = write_row_style(tmp_path / "take.csv", TIMES[:0], [body()])
    with pytest.raises(ReadError, match=r"lines 1 to 7: expected lines that begin with frame, fou"):
        parse_file(file)
