"""Takes of Motive: tables, rows, headers, and what is noted of tracks."""

from __future__ import annotations

from collections.abc import Callable
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
from tests.approved import Approve
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


def test_a_workbook_of_something_else(tmp_path: Path) -> None:
    file = tmp_path / "other.xlsx"
    book = Workbook()
    book.active.append(["time", "force"])  # type: ignore[union-attr]
    book.save(file)
    assert not motive_takes.recognise(file)
    with pytest.raises(ReadError, match=r"expected a sheet whose first cell is Format Version"):
        motive_takes.read(file)


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


TRACKED = marker("Tip", TRACK)
NOTED: dict[str, tuple[list[Column], Layout, str]] = {
    "time_column_differs": (
        *(TRACKED, replace(LAYOUT, time_shift=0.5)),
        "the column of times is up to 500 ms off frame / rate: kept",
    ),
    "rate_not_stated": (
        TRACKED,
        replace(LAYOUT, about={"Export Frame Rate": "", "Capture Frame Rate": ""}),
        "",
    ),
    "version_unseen": (
        *(TRACKED, replace(LAYOUT, version="1.22")),
        "Format Version 1.22 has not been seen in a real file: read by the rules of 1.21, 1.23, ",
    ),
    "take_name_differs": (
        *(TRACKED, replace(LAYOUT, take="other")),
        "the take is called 'other', the file 'synthetic.csv'",
    ),
    "start_time_unclear": (
        *(TRACKED, replace(LAYOUT, start="2023-11-28 10.27.58.765 DU.")),
        "Capture Start Time '2023-11-28 10.27.58.765 DU",
    ),
    "names_not_unique": (
        *([*TRACKED, *marker("Tip", TRACK + 1.0, id_="2")], LAYOUT),
        "objects with the same name have their id added: Tip",
    ),
    "columns_left_out": (
        *([*TRACKED, *marker("Hip", TRACK, kind="Bone Marker")], LAYOUT),
        "left out: 1 of type Bone Marker",
    ),
}


@pytest.mark.parametrize("code", NOTED)
def test_what_is_odd_is_noted(tmp_path: Path, code: str) -> None:
    columns, layout, message = NOTED[code]
    take, notes = read(tmp_path, columns, layout)
    assert notes[code].startswith(message)
    assert len(take.names) == (2 if code == "names_not_unique" else 1)
    assert take.rate == pytest.approx(120.0, rel=1e-4)
    assert take.time[0] == (0.5 if code == "time_column_differs" else 0.0)


def test_names_become_unique() -> None:
    assert unique_names([("a", "1"), ("a", "1"), ("b", "")]) == ("a 1 #1", "a 1 #2", "b")
    assert unique_names([("a", ""), ("a", "")]) == ("a #1", "a #2")
    assert unique_names([("a", "1"), ("a", "2")]) == ("a 1", "a 2")


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


def test_headers_that_are_odd_but_whole() -> None:
    """Without words, with time codes, with a name and id twice, with a comma in a value."""
    wordless = [line.replace("Type", "").replace("Name", "").replace("ID", "") for line in LABELS]
    header = parse(LINE_1, "", *wordless, QUANTITY, "Frame,Time,X,Y,Z")
    assert header.groups == parse(*WHOLE).groups
    labels = ["," + line for line in [*LABELS, QUANTITY]]
    header = parse(LINE_1, "", *labels, "Frame,Time (Seconds),TimeCode,X,Y,Z")
    assert header.groups[0].axes("Position", "XYZ") == [3, 4, 5]
    assert header.time_column == 1
    twice = [
        line + line.replace(",Type", "").replace(",Name", "").replace(",ID", "") for line in LABELS
    ]
    header = parse(LINE_1, "", *twice, QUANTITY + ",Position" * 3, AXES + ",X,Y,Z")
    assert [group.axes("Position", "XYZ") for group in header.groups] == [[2, 3, 4], [5, 6, 7]]
    header = parse(LINE_1.replace("Export", "Take Notes,wet, cold,Export"), *WHOLE[1:])
    assert header.about["Take Notes"] == "wet, cold"
    assert header.rate == 120.0


HEADERS = [
    ("1.23", "3.00"),
    ("1.23", ""),
    ("Meters", "Furlongs"),
    ("Frame,Time", "Image,Time"),
    (",ID,1,1,1", ",Mass,1,1,1"),
    ("Type,Marker", "Type,"),
]
LINES = [
    ("frame,3,", "image,3,"),
    ("frame,3,", "frame,x,"),
    ("frame,3,", "frame,3,9,"),
    ("rigidbody,3,", "rigidbody,7,"),
    ("1.1", "2.0"),
]


def refusal(read: Callable[[], object]) -> str:
    with pytest.raises(ReadError) as refused:
        read()
    return str(refused.value)


def test_takes_that_are_refused(tmp_path: Path, approved: Approve) -> None:
    """For their headers, their columns, a line without number, their rows, and for no frame."""
    messages = []
    for old, new in HEADERS:
        lines = [line.replace(old, new) for line in WHOLE]
        messages.append(refusal(lambda lines=lines: parse(*lines)))  # type: ignore[misc]
    messages.append(refusal(lambda: read(tmp_path, TRACKED[:2])))
    file = write_table(tmp_path / "synthetic.csv", TRACKED, TABLE_FRAMES, LAYOUT)
    lines = file.read_text().splitlines()
    lines[10] = lines[10][lines[10].index(",") :]
    file.write_text("\n".join(lines) + "\n")
    messages.append(refusal(lambda: motive_takes.read(file)))
    rows = write_row_style(tmp_path / "rows.csv", TIMES, [body()])
    for old, new in LINES:
        text = rows.read_text().replace(old, new, 1)
        messages.append(refusal(lambda text=text: parse_rows(text, rows)))  # type: ignore[misc]
    empty = write_row_style(tmp_path / "empty.csv", TIMES[:0], [body()])
    messages.append(refusal(lambda: parse_file(empty)))
    approved(messages)


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


def test_what_rows_say_of_themselves(tmp_path: Path) -> None:
    """A lost body may keep its last pose; the last line is cut off."""
    clamp = replace(body(lost=(5, 6)), keeps_pose=True)
    file = write_row_style(tmp_path / "take.csv", TIMES, [clamp], stated=99)
    export = parse_file(file)
    assert np.flatnonzero(np.isnan(export.tracks.bodies[0].position[:, 0])).tolist() == [5, 6]
    assert export.about["frames_without_body"] == 0
    export = parse_file(write_row_style(file, TIMES, [body(lost=(3, 4))], stated=99))
    file.write_bytes(file.read_bytes()[:-40])
    assert export.about["title"] == "Synthetic Export Data"
    assert export.about["frames_without_body"] == 2
    assert export.about["visible_markers"] == {"least": 0, "most": 3}
    messages = notes_of_rows(export)
    assert messages["rows_differ"] == "the header states 99 rows, the file holds 12 frames"
    assert messages["frames_without_body"] == "2 of 12 frames hold no rigid body"
    assert messages["visible_markers"] == "0 to 3 markers are seen in a frame"
    assert messages["unit_assumed"].startswith("no unit is stated: positions are taken as metres")
    cut = parse_file(file)
    assert len(cut.tracks.time) == ROWS
    assert notes_of_rows(cut)["truncated"].endswith("is incomplete and was left out")


def test_a_point_of_no_body(tmp_path: Path) -> None:
    """It is a marker in version 1.1; in 1.0 it has no identity and is counted."""
    stray = DRAWN.normal(size=(ROWS, 3)).round(8)
    stray[2] = np.nan
    export = parse_file(write_row_style(tmp_path / "take.csv", TIMES, [body()], stray=stray))
    assert export.tracks.names[-1] == "Marker-99"
    np.testing.assert_array_equal(export.tracks.positions[:, -1], stray)
    file = write_row_style(tmp_path / "take.csv", TIMES, [body()], version="1.0", stray=stray)
    assert notes_of_rows(parse_file(file))["anonymous_markers"] == (
        "11 points in 11 frames belong to no body and have no identity: left out"
    )


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
        " up to 19 in a row: lost, with its last pose repeated?"
    }


def test_a_label_switch() -> None:
    labelled, spare, passing = moving(), moving(), moving()
    labelled[:12] = np.nan
    spare[12:] = np.nan
    passing[5:] = np.nan
    notes = track_codes(take(tip=labelled, Unlabeled_7=spare, Unlabeled_8=passing))
    assert notes["label_switch tip"] == (
        "missing in rows 0-11, exactly where Unlabeled 7 is seen: label switch?"
    )
    assert notes["unlabelled_markers markers"] == "2 of 3 markers have no label"
    assert sum(key.startswith("label_switch") for key in notes) == 1
