from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from labpipe.errors import ReadError
from labpipe.readers.motive_rows import RowExport, parse_rows
from tests.builders.motive import RowBody, write_row_style

FRAMES = 12
RANDOM = np.random.default_rng(11)
TIMES = np.arange(FRAMES) / 120.0


def body(name: str = "Clamp", number: int = 1, lost: tuple[int, ...] = ()) -> RowBody:
    tracked = np.ones(FRAMES, dtype=np.bool_)
    tracked[list(lost)] = False
    return RowBody(
        name,
        number,
        RANDOM.normal(size=(FRAMES, 3)).round(8),
        RANDOM.normal(size=(FRAMES, 4)).round(8),
        RANDOM.normal(size=(FRAMES, 3, 3)).round(8),
        tracked,
    )


def parse(file: Path) -> RowExport:
    return parse_rows(file.read_text(), file)


def notes(export: RowExport) -> dict[str, str]:
    return {note.code: note.message for note in export.notes}


@pytest.mark.parametrize("version", ["1.0", "1.1"])
@given(lost=st.sets(st.integers(0, FRAMES - 1)), hidden=st.integers(0, FRAMES - 1))
def test_what_was_written_is_read(
    tmp_path_factory: Any, version: str, lost: set[int], hidden: int
) -> None:
    clamp, grip = body(lost=tuple(lost)), body("Grip", 2)
    clamp.measured[hidden, 1] = np.nan
    file = tmp_path_factory.mktemp("rows") / "take.csv"
    export = parse(write_row_style(file, TIMES, [clamp, grip], version=version))
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
    export = parse(write_row_style(tmp_path / "take.csv", TIMES, [clamp]))
    assert np.flatnonzero(np.isnan(export.tracks.bodies[0].position[:, 0])).tolist() == [5, 6]
    assert export.about["frames_without_body"] == 0


def test_a_point_of_another_name_is_a_marker_in_1_1(tmp_path: Path) -> None:
    stray = RANDOM.normal(size=(FRAMES, 3)).round(8)
    stray[2] = np.nan
    export = parse(write_row_style(tmp_path / "take.csv", TIMES, [body()], stray=stray))
    assert export.tracks.names[-1] == "Marker-99"
    np.testing.assert_array_equal(export.tracks.positions[:, -1], stray)


def test_a_point_without_identity_is_counted_in_1_0(tmp_path: Path) -> None:
    stray = RANDOM.normal(size=(FRAMES, 3)).round(8)
    stray[2] = np.nan
    file = write_row_style(tmp_path / "take.csv", TIMES, [body()], version="1.0", stray=stray)
    assert notes(parse(file))["anonymous_markers"] == (
        "11 points in 11 frames belong to no body and have no identity: left out"
    )


def test_what_it_says_of_itself(tmp_path: Path) -> None:
    export = parse(write_row_style(tmp_path / "take.csv", TIMES, [body(lost=(3, 4))], stated=99))
    assert export.about["title"] == "Synthetic Export Data"
    assert export.about["frames_without_body"] == 2
    assert export.about["visible_markers"] == {"least": 0, "most": 3}
    found = notes(export)
    assert found["rows_differ"] == "the header states 99 rows, the file holds 12 frames"
    assert found["frames_without_body"] == "2 of 12 frames hold no rigid body"
    assert found["visible_markers"] == "0 to 3 markers are seen in a frame"
    assert found["unit_assumed"].startswith("no unit is stated: positions are taken as metres")


def test_a_cut_last_line_is_left_out(tmp_path: Path) -> None:
    file = write_row_style(tmp_path / "take.csv", TIMES, [body()])
    file.write_bytes(file.read_bytes()[:-40])
    export = parse(file)
    assert notes(export)["truncated"] == "the last line (31) is incomplete and was left out"
    assert len(export.tracks.time) == FRAMES


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


def test_a_take_without_frames_is_refused(tmp_path: Path) -> None:
    file = write_row_style(tmp_path / "take.csv", TIMES[:0], [body()])
    with pytest.raises(ReadError, match=r"lines 1 to 7: expected lines that begin with frame, fou"):
        parse(file)
