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

from labpipe.errors import ReadError
from labpipe.readers import motive_takes
from labpipe.records.recording import MarkerTracks, Recording
from tests.builders.motive import (
    Layout,
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


def test_the_order_of_columns_does_not_matter(tmp_path: Path) -> None:
    order = np.random.default_rng(3).permutation(len(COLUMNS))
    shuffled = [COLUMNS[i] for i in order]
    one = tracks(motive_takes.read(write_table(tmp_path / "a.csv", COLUMNS, FRAMES, LAYOUT)))
    other = tracks(motive_takes.read(write_table(tmp_path / "b.csv", shuffled, FRAMES, LAYOUT)))
    for name in one.names:
        np.testing.assert_array_equal(
            one.positions[:, one.names.index(name)], other.positions[:, other.names.index(name)]
        )
    np.testing.assert_array_equal(one.bodies[0].rotation, other.bodies[0].rotation)


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


def test_a_cut_workbook(tmp_path: Path) -> None:
    file = write_xlsx(tmp_path / "take.xlsx", COLUMNS, FRAMES, LAYOUT)
    file.write_bytes(file.read_bytes()[:2000])
    with pytest.raises(ReadError, match=r"expected a whole xlsx workbook, found a damaged one"):
        motive_takes.read(file)


def test_an_empty_take_is_legal(tmp_path: Path) -> None:
    recording = motive_takes.read(write_table(tmp_path / "synthetic.csv", [], 9, LAYOUT))
    take = tracks(recording)
    assert (take.positions.shape, take.names, take.bodies) == ((9, 0, 3), (), ())
    assert set(notes(recording)) == {"take_empty"}


def test_a_take_without_frames_is_legal(tmp_path: Path) -> None:
    empty = [replace(column, values=np.empty(0)) for column in COLUMNS]
    take = tracks(motive_takes.read(write_table(tmp_path / "synthetic.csv", empty, 0, LAYOUT)))
    assert take.positions.shape == (0, 2, 3)


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


@pytest.mark.parametrize(
    ("content", "is_motive"),
    [
        (b"Format Version,1.23", True),
        (b'\xef\xbb\xbf"Format Version",1.23', True),
        (b"comment,text", True),
        (b"commentary on a test", False),
        (b"time,force\n", False),
    ],
)
def test_recognised_by_the_first_words(tmp_path: Path, content: bytes, is_motive: bool) -> None:
    file = tmp_path / "take.mat"
    file.write_bytes(content)
    assert motive_takes.recognise(file) is is_motive


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
