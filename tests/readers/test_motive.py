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
from openpyxl import Workbook, load_workbook
from scipy.spatial.transform import Rotation

from labpipe.errors import ReadError
from labpipe.readers import motive_takes
from labpipe.readers.motive_takes import Header, derive_rate, make_object_names, parse_header
from labpipe.readers.raw_files import add_file_name
from labpipe.readers.recording_checks import make_track_notes
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
TIP[4:7] = np.nan
TURN = RANDOM.normal(size=(FRAMES, 4)).round(6)
ERROR = np.full(FRAMES, 0.000105)
LAYOUT = Layout()
COLUMNS = [
    *rigid_body("Clamp", CLAMP, TURN, error=ERROR),
    *fitted_marker("Clamp:Marker1", TIP + 5.0),
    *marker("Clamp:Marker1", TIP),
    *marker("Unlabeled 12", BASE, id_="C3500"),
]
TRACKED = marker("Tip", BASE)


def tracks(recording: Recording) -> MarkerTracks:
    assert recording.markers is not None
    return recording.markers


def notes(given: Recording) -> dict[str, str]:
    return {note.code: note.message for note in given.notes}


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


@pytest.mark.parametrize("write", [write_table, write_xlsx])
@pytest.mark.parametrize(
    ("version", "unit", "factor"),
    [
        *(("1.21", "Meters", 1.0), ("1.23", "Centimeters", 0.01)),
        *(("1.24", "Millimeters", 0.001), ("1.25", "Meters", 1.0)),
    ],
)
def test_bodies_and_markers_in_metres(
    tmp_path: Path, write: Callable[..., Path], version: str, unit: str, factor: float
) -> None:
    """Of any version and unit, as text and saved from a spreadsheet."""
    layout = replace(LAYOUT, version=version, unit=unit, lower_w=version == "1.25")
    file = tmp_path / f"synthetic.{'csv' if write is write_table else 'xlsx'}"
    recording = motive_takes.read(write(file, COLUMNS, FRAMES, layout))
    take = tracks(recording)
    assert (take.names, take.rate) == (("Clamp:Marker1", "Unlabeled 12"), 120.0)
    np.testing.assert_allclose(take.positions, factor * np.stack([TIP, BASE], 1), rtol=1e-14)
    body = take.find_body("Clamp")
    assert body is not None
    np.testing.assert_allclose(body.position, factor * CLAMP, rtol=1e-14)
    np.testing.assert_allclose(body.rotation, TURN, rtol=1e-15)
    np.testing.assert_allclose(body.error, factor * ERROR, rtol=1e-14)
    assert take.unit_in_file == unit
    assert (recording.reader, recording.program) == (f"motive-{file.suffix[1:]}", "Motive")
    assert recording.program_version == version
    assert set(notes(recording)) == {"fitted_markers", "unlabelled_markers", "marker_gaps"}


def edited(folder: Path, change: Callable[[list[str]], list[str]]) -> Path:
    """A take of three objects whose lines were changed."""
    file = write_table(folder / "synthetic.csv", COLUMNS, FRAMES, LAYOUT)
    file.write_text("\n".join(change(file.read_text().splitlines())) + "\n")
    return file


def test_lines_that_were_cut_or_changed(tmp_path: Path) -> None:
    file = edited(tmp_path, lambda lines: lines)
    file.write_bytes(file.read_bytes()[:-20])
    recording = motive_takes.read(file)
    assert len(tracks(recording).time) == FRAMES - 1
    assert notes(recording)["truncated"] == "the last line (37) is incomplete and was left out"
    assert notes(recording)["rows_differ"] == "the header states 30 rows, the file has 29"

    def infinite(lines: list[str]) -> list[str]:
        return [*lines[:12], f"{lines[12].rpartition(',')[0]},inf", *lines[13:]]

    recording = motive_takes.read(edited(tmp_path, infinite))
    assert tracks(recording).n_missing["Unlabeled 12"] == 1
    assert notes(recording)["not_finite"] == ("1 infinite numbers became blank")
    file = edited(tmp_path, lambda lines: [*lines[:20], lines[12], *lines[20:]])
    (note,) = (n for n in motive_takes.read(file).notes if n.severity is Severity.ERROR)
    assert note.message.startswith("time runs backwards 1 times, first at sample 14")


def test_times_in_milliseconds_are_refused(tmp_path: Path) -> None:
    def scaled(lines: list[str]) -> list[str]:
        cells = [line.split(",", 2) for line in lines[7:]]
        return lines[:7] + [f"{frame},{1e3 * float(time)},{rest}" for frame, time, rest in cells]

    message = (
        r"expected steps of 0\.008333 s, .* 120 frames per second .*, found steps of 8\.333 s\."
    )
    with pytest.raises(ReadError, match=message):
        motive_takes.read(edited(tmp_path, scaled))


NOTED: dict[str, tuple[list[Column], Layout, str]] = {
    "time_rounded": (
        *(TRACKED, replace(LAYOUT, milliseconds=True)),
        "the column of times is rounded to milliseconds",
    ),
    "time_column_differs": (
        *(TRACKED, replace(LAYOUT, time_shift=0.5)),
        "the column of times differs from frame / rate by up to 500 ms: the column is used",
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
    "names_not_unique": (
        *([*TRACKED, *marker("Tip", BASE + 1.0, id_="2")], LAYOUT),
        "objects with the same name have their id added: Tip",
    ),
    "columns_left_out": (
        *([*TRACKED, *marker("Hip", BASE, kind="Bone Marker")], LAYOUT),
        "left out: 1 of type Bone Marker",
    ),
    "take_empty": ([], LAYOUT, "the take holds no rigid body and no marker"),
}


@pytest.mark.parametrize("code", NOTED)
def test_what_is_odd_is_noted(tmp_path: Path, code: str) -> None:
    columns, layout, message = NOTED[code]
    recording = motive_takes.read(write_table(tmp_path / "synthetic.csv", columns, FRAMES, layout))
    take = tracks(recording)
    assert notes(recording)[code].startswith(message)
    assert len(take.names) == {"names_not_unique": 2, "take_empty": 0}.get(code, 1)
    assert take.rate == pytest.approx(120.0, rel=1e-4)
    start = 0.5 if code == "time_column_differs" else 0.0
    np.testing.assert_allclose(take.time, start + np.arange(FRAMES) / 120.0, rtol=1e-4)


def test_names_become_unique() -> None:
    assert make_object_names([("a", "1"), ("a", "1"), ("b", "")]) == ("a 1 #1", "a 1 #2", "b")
    assert make_object_names([("a", ""), ("a", "")]) == ("a #1", "a #2")
    assert make_object_names([("a", "1"), ("a", "2")]) == ("a 1", "a 2")


def test_euler_angles_become_quaternions(tmp_path: Path) -> None:
    degrees = np.random.default_rng(2).uniform(-80, 80, (FRAMES, 3)).round(6)
    degrees[3] = np.nan
    columns, layout = rigid_body("Clamp", CLAMP, degrees), replace(LAYOUT, rotation="XYZ")
    recording = motive_takes.read(write_table(tmp_path / "synthetic.csv", columns, FRAMES, layout))
    visible = np.arange(FRAMES) != 3
    x, y, z = (
        Rotation.from_euler(axis, angles[:, None], degrees=True)
        for axis, angles in zip("XYZ", degrees[visible].T, strict=True)
    )
    rotation = tracks(recording).bodies[0].rotation
    apart = Rotation.from_quat(rotation[visible]).inv() * (x * y * z)
    np.testing.assert_allclose(apart.magnitude(), 0.0, atol=1e-12)
    assert np.isnan(rotation[3]).all()
    message = notes(recording)["rotation_from_euler"]
    assert message.startswith("Euler angles of type 'XYZ' in degrees")


def test_the_derived_rate_leaves_holes_out() -> None:
    time = np.delete(np.arange(100) / 50.0, np.arange(40, 60))
    assert derive_rate(time) == pytest.approx(50.0)
    assert np.isnan([derive_rate(np.zeros(1)), derive_rate(np.zeros(5))]).all()


FILE = Path("take.csv")
LINE_1 = "Format Version,1.23,Export Frame Rate,120.000000,Length Units,Meters"
LABELS = [",Type,Marker,Marker,Marker", ",Name,A,A,A", ",ID,1,1,1"]
QUANTITY, AXES = ",,Position,Position,Position", "Frame,Time (Seconds),X,Y,Z"
WHOLE = [LINE_1, "", *LABELS, QUANTITY, AXES]


def parse(*lines: str) -> Header:
    with add_file_name(FILE):
        return parse_header([line.split(",") if line else [] for line in lines])


def test_headers_that_are_odd_but_whole() -> None:
    """Without words, with time codes, with a name and id twice, with a comma in a value."""
    wordless = [line.replace("Type", "").replace("Name", "").replace("ID", "") for line in LABELS]
    header = parse(LINE_1, "", *wordless, QUANTITY, "Frame,Time,X,Y,Z")
    assert header.groups == parse(*WHOLE).groups
    labels = ["," + line for line in [*LABELS, QUANTITY]]
    header = parse(LINE_1, "", *labels, "Frame,Time (Seconds),TimeCode,X,Y,Z")
    columns = header.groups[0].find_columns("Position", "XYZ")
    assert (columns, header.time_column) == ([3, 4, 5], 1)
    twice = [line + blank[1:] for line, blank in zip(LABELS, wordless, strict=True)]
    header = parse(LINE_1, "", *twice, QUANTITY + ",Position" * 3, AXES + ",X,Y,Z")
    assert [[*group.columns.values()] for group in header.groups] == [[2, 3, 4], [5, 6, 7]]
    header = parse(LINE_1.replace("Export", "Take Notes,wet, cold,Export"), *WHOLE[1:])
    assert (header.properties["Take Notes"], header.rate) == ("wet, cold", 120.0)


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


def refusal(read: Callable[..., object], *given: object) -> str:
    with pytest.raises(ReadError) as refused:
        read(*given)
    return str(refused.value)


def test_takes_that_are_refused(tmp_path: Path, approved: Approve) -> None:
    """For their headers, their columns, a line without number, their rows, and for no frame."""
    messages = [refusal(parse, *(line.replace(old, new) for line in WHOLE)) for old, new in HEADERS]
    file = write_table(tmp_path / "synthetic.csv", TRACKED[:2], FRAMES, LAYOUT)
    messages.append(refusal(motive_takes.read, file))
    file = edited(
        tmp_path, lambda lines: [*lines[:10], "," + lines[10].partition(",")[2], *lines[11:]]
    )
    messages.append(refusal(motive_takes.read, file))
    text = write_row_style(tmp_path / "rows.csv", TIMES, [body()]).read_text()
    rows = tmp_path / "rows.csv"
    for old, new in LINES:
        rows.write_text(text.replace(old, new, 1))
        messages.append(refusal(motive_takes.read, rows))
    empty = write_row_style(tmp_path / "empty.csv", TIMES[:0], [body()])
    messages.append(refusal(parse_file, empty))
    book = Workbook()
    book.active.append(["time", "force"])  # type: ignore[union-attr]
    book.save(tmp_path / "other.xlsx")
    assert not motive_takes.recognise(tmp_path / "other.xlsx")
    messages.append(refusal(motive_takes.read, tmp_path / "other.xlsx"))
    file = write_xlsx(tmp_path / "words.xlsx", COLUMNS, FRAMES, LAYOUT)
    book = load_workbook(file)
    book.active["F12"] = "lost"  # type: ignore[index]
    book.save(file)
    approved([*messages, refusal(motive_takes.read, file)])


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


def parse_file(file: Path) -> tuple[Recording, MarkerTracks]:
    recording = motive_takes.read(file)
    assert recording.markers is not None
    return recording, recording.markers


@pytest.mark.parametrize("version", ["1.0", "1.1"])
@given(lost=st.sets(st.integers(0, ROWS - 1)), hidden=st.integers(0, ROWS - 1))
def test_rows_that_were_written_are_read(
    tmp_path_factory: Any, version: str, lost: set[int], hidden: int
) -> None:
    clamp, grip = body(lost=tuple(lost)), body("Grip", 2)
    clamp.measured[hidden, 1] = np.nan
    file = tmp_path_factory.mktemp("rows") / "take.csv"
    export, tracks = parse_file(write_row_style(file, TIMES, [clamp, grip], version=version))
    assert export.program_version == version
    assert tracks.names == tuple(f"{b}-Marker {i}" for b in ("Clamp", "Grip") for i in (1, 2, 3))
    for one, other in zip((clamp, grip), tracks.bodies, strict=True):
        seen = one.tracked
        np.testing.assert_array_equal(other.position[seen], one.position[seen])
        np.testing.assert_array_equal(other.rotation[seen], one.rotation[seen])
        np.testing.assert_array_equal(other.error[seen], np.full(seen.sum(), 0.00025))
        assert np.isnan(other.position[~seen]).all()
    measured = np.where(clamp.tracked[:, None, None], clamp.measured, np.nan)
    np.testing.assert_array_equal(tracks.positions[:, :3], measured)
    np.testing.assert_array_equal(tracks.time, TIMES.round(8))


def test_a_body_of_more_markers_than_it_lists_is_refused(tmp_path: Path) -> None:
    """A damaged count of markers made as many empty markers, and the reader took minutes."""
    file = write_row_style(tmp_path / "take.csv", TIMES, [body()])
    n_markers = body().measured.shape[1]
    text = file.read_text(encoding="utf-8")
    file.write_text(text.replace(f",{n_markers},0.01", ",40000000,0.01", 1), encoding="utf-8")
    with pytest.raises(ReadError, match="cells for 40000000 markers"):
        motive_takes.read(file)


def test_what_rows_say_of_themselves(tmp_path: Path) -> None:
    """A lost body may keep its last pose; the last line is cut off."""
    clamp = replace(body(lost=(5, 6)), keeps_pose=True)
    file = write_row_style(tmp_path / "take.csv", TIMES, [clamp], stated=99)
    _, tracks = parse_file(file)
    assert np.flatnonzero(np.isnan(tracks.bodies[0].position[:, 0])).tolist() == [5, 6]
    export, tracks = parse_file(write_row_style(file, TIMES, [body(lost=(3, 4))], stated=99))
    file.write_bytes(file.read_bytes()[:-40])
    assert export.metadata["title"] == "Synthetic Export Data"
    messages = notes(export)
    assert messages["rows_differ"] == "the header states 99 rows, the file has 12"
    assert messages["frames_without_body"] == "2 of 12 frames have no rigid body"
    assert messages["visible_markers"] == "0 to 3 markers are seen in a frame"
    assert messages["unit_assumed"].startswith("no unit is stated: positions are taken as metres")
    cut, tracks = parse_file(file)
    assert len(tracks.time) == ROWS
    assert notes(cut)["truncated"].endswith("is incomplete and was left out")


def test_a_point_of_no_body(tmp_path: Path) -> None:
    """It is a marker in version 1.1; in 1.0 it has no identity and is counted."""
    stray = DRAWN.normal(size=(ROWS, 3)).round(8)
    stray[2] = np.nan
    take = write_row_style(tmp_path / "take.csv", TIMES, [body()], stray=stray)
    _, tracks = parse_file(take)
    assert tracks.names[-1] == "Marker-99"
    np.testing.assert_array_equal(tracks.positions[:, -1], stray)
    file = write_row_style(tmp_path / "take.csv", TIMES, [body()], version="1.0", stray=stray)
    assert notes(parse_file(file)[0])["anonymous_markers"] == (
        "11 points without body and identity were left out"
    )


def test_notes_on_tracks() -> None:
    """On gaps, a marker never seen, a frozen body, and a marker without a label."""
    frames = np.arange(40.0)
    stack = np.tile(np.arange(120.0).reshape(40, 1, 3), (1, 3, 1))
    names = ("tip", "base", "Unlabeled 7")
    stack[[3, 4, 9], 0] = stack[:, 1] = stack[12:, 2] = np.nan
    still = np.arange(120.0).reshape(40, 3)
    still[10:30] = still[10]
    clamp = RigidBody("Clamp", still, np.full((40, 4), np.nan), np.full(40, np.nan))
    take = MarkerTracks(frames / 50.0, frames, 50.0, names, stack, (clamp,))
    assert {f"{note.code} {note.where}": note.message for note in make_track_notes(take)} == {
        "marker_blank markers": "never seen: base",
        "marker_gaps tip": "missing in 3 of 40 frames, the longest gap 2 frames",
        "marker_gaps Unlabeled 7": "missing in 28 of 40 frames, the longest gap 28 frames",
        "frozen_pose Clamp": "position unchanged to the last digit in 19 of 39 steps,"
        " up to 19 in a row: the program may repeat a lost pose",
        "unlabelled_markers markers": "1 of 3 markers have no label",
    }
