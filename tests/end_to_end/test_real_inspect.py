"""Every real export is inspected right: the numbers stand in the README of the real exports.

What it does not say (names of channels, dates) was read in the files themselves. None of the
numbers was taken from the output of a reader.
"""

from __future__ import annotations

import json
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from labpipe.errors import ReadError
from labpipe.process.inspection import as_json, as_text, inspect_export

pytestmark = pytest.mark.realdata

DECAR = "decar_180_position_calibration_1.23.csv"
EMPTY = "ha5dzs_test_default_1.23_empty.csv"
HMV = "hmv_sample_optitrack_take_1.21.csv"
DRONE = "kronium_20240717_0_1.23.csv"
WALL = "kronium_wall_data_1.24.csv"
C3D = "ktk_sample_OptiTrack_walking.c3d"
ROWS_11 = "olin_v1.1.csv"
ROWS_10 = "olin_v1.csv"
BATS = "pathviewr_motive_example_data_1.23.csv"
THROW = "pathviewr_projectile_vel_test_1.23_xyz.csv"
POOL = "pool_optitrack_1.23_resaved.csv"
ARM = "softarm_sim-fk-400-2_1.23.csv"

# file: version, frames, rate (1/s), unit of length, rigid bodies, markers
TAKES: dict[str, tuple[str, int, float, str, int, int]] = {
    DECAR: ("1.23", 712, 120.0, "Meters", 1, 9),
    EMPTY: ("1.23", 1353, 360.0, "Millimeters", 0, 0),
    HMV: ("1.21", 250, 120.0, "Meters", 1, 9),
    DRONE: ("1.23", 11539, 120.0, "Meters", 1, 0),
    WALL: ("1.24", 435, 240.0, "Meters", 2, 24),
    ROWS_11: ("1.1", 548, 120.0, "", 1, 11),
    ROWS_10: ("1.0", 1668, 250.0, "", 4, 17),
    BATS: ("1.23", 934, 100.0, "Meters", 3, 0),
    THROW: ("1.23", 826, 100.0, "Meters", 0, 5),
    POOL: ("1.23", 3856, 120.0, "Millimeters", 5, 0),
    ARM: ("1.23", 8708, 120.0, "Millimeters", 0, 16),
}

ADC = [f"Model Root/DS1104ADC_C{i}/ADC" for i in (5, 6, 7)]
DC_MOTOR = [f"Model Root/{name}/In1" for name in ("Position1", "Speed Out", "Volt")]
IMPULSE = [f'"Model Root"/"{name}"/"Out1"' for name in ("u1", "u2", "y1", "y2")]

# file: reader, ControlDesk, (clock, samples, start, end, step) of each clock, number of channels
RECORDINGS: dict[str, tuple[str, str, list[tuple[str, int, float, float, float]], int]] = {
    "0103_3_3.mat": (
        *("dspace-mat", "6.3", [("HostService", 10243, 0.0, 20.482472, 1.99984e-3)], 10),
    ),
    "exp1_003.mat": (
        *("dspace-mat", "7.4", [("HostService", 6653, 1.2478037, 7.8987589, 0.99985e-3)], 3),
    ),
    "exp1_030.mat": (*("dspace-mat", "5.2", [("HostService", 29454, 0.0, 29.4491656, 1e-3)], 3),),
    "exp1_033.mat": (*("dspace-mat", "5.2", [("HostService", 10410, 0.0, 10.899228, 1e-3)], 3),),
    "rec1_001.csv": (
        *("dspace-csv", "25.1p1", [("HostService", 5751, 0.0, 5.748641637, 0.99977e-3)], 9),
    ),
    "rec1_003.mf4": (
        *("dspace-mf4", "7.4", [("HostService", 6653, 1.2478037, 7.8987589, 0.99985e-3)], 3),
    ),
    "rec1_253.mat": (
        "dspace-mat",
        "7.5p3",
        [
            ("OnChange", 10, 0.2714, 27.910, 3.066),
            ("Periodic Task 1", 29301, 0.0, 29.299, 1e-3),
        ],
        86,
    ),
    "u1_impulse.mat": ("dspace-mat", "", [("time", 401, -1.0, 9.0, 0.025)], 4),
    "u_rand.mat": ("dspace-mat", "", [("time", 24001, 0.0, 600.0, 0.025)], 4),
}


@cache
def inspected(path: Path) -> dict[str, Any]:
    inspection = inspect_export(path)
    assert as_text(inspection)
    facts: dict[str, Any] = json.loads(json.dumps(as_json(inspection), allow_nan=False))
    return facts


@pytest.fixture
def take(realdata: Path) -> Any:
    return lambda name: inspected(realdata / "motive" / name)


@pytest.fixture
def recording(realdata: Path) -> Any:
    return lambda name: inspected(realdata / "dspace" / name)


def notes(facts: dict[str, Any]) -> dict[str, str]:
    return {note["code"]: note["message"] for note in facts["notes"]}


def test_no_real_export_is_forgotten(realdata: Path) -> None:
    assert {file.name for file in (realdata / "motive").iterdir()} == {*TAKES, C3D}
    assert {file.name for file in (realdata / "dspace").iterdir()} == {*RECORDINGS}


@pytest.mark.parametrize("name", TAKES)
def test_takes(take: Any, name: str) -> None:
    version, frames, rate, unit, n_bodies, n_markers = TAKES[name]
    facts = take(name)
    markers = facts["markers"]
    assert (facts["reader"], facts["program"], facts["version"]) == (
        *("motive-csv", "Motive", version),
    )
    assert markers["frames"] == frames
    assert markers["rate"] == pytest.approx(rate, rel=1e-4)
    assert markers["unit_in_file"] == unit
    assert len(markers["rigid_bodies"]) == n_bodies
    assert len(markers["names"]) == n_markers


@pytest.mark.slow
@pytest.mark.parametrize("name", RECORDINGS)
def test_recordings(recording: Any, name: str) -> None:
    reader, version, clocks, n_channels = RECORDINGS[name]
    facts = recording(name)
    assert (facts["reader"], facts["program"], facts["version"]) == (
        *(reader, "ControlDesk", version),
    )
    for stream, (clock, samples, start, end, step) in zip(facts["streams"], clocks, strict=True):
        assert (stream["clock"], stream["samples"]) == (clock, samples)
        assert stream["start"] == pytest.approx(start, abs=1e-3 if clock == "OnChange" else 1e-7)
        assert stream["end"] == pytest.approx(end, rel=1e-5)
        assert stream["step_median"] == pytest.approx(step, rel=1e-3)
    channels = [channel for stream in facts["streams"] for channel in stream["channels"]]
    assert len(channels) == n_channels
    assert all(channel["unit"] is None for channel in channels)
    assert all(channel["missing"] == 0 for channel in channels)


def test_decar_body_blank_while_its_markers_are_measured(take: Any) -> None:
    facts = take(DECAR)
    (body,) = facts["markers"]["rigid_bodies"]
    assert (body["missing"], body["gaps"]["ranges"], body["has_error"]) == (1, [[4, 4]], True)
    assert set(facts["markers"]["missing"].values()) == {0}
    labelled = [f"RigidBody:Marker{i}" for i in range(1, 7)]
    assert facts["markers"]["names"][:6] == labelled
    assert notes(facts)["fitted_markers"].startswith("6 Rigid Body Marker are fitted places")
    assert notes(facts)["unlabelled_markers"].startswith("3 of 9 markers")


def test_a_take_with_nothing_in_it(take: Any) -> None:
    found = notes(take(EMPTY))
    assert found["take_empty"] == "the take holds no rigid body and no marker"
    assert "time_rounded" in found
    assert "'2023-11-28 10.27.58.765 DU.'" in found["start_time_unclear"]
    markers = take(EMPTY)["markers"]
    assert (markers["start"], markers["end"]) == (0.0, pytest.approx(1352 / 360))


def test_version_1_21_without_header_words(take: Any) -> None:
    facts = take(HMV)
    (body,) = facts["markers"]["rigid_bodies"]
    assert (body["name"], body["has_error"], body["has_rotation"]) == ("Rigid Body 1", True, True)
    blank = [name for name, n in facts["markers"]["missing"].items() if n == 250]
    assert len(blank) == 3
    assert all(name.startswith("Unlabeled:") for name in blank)
    assert "Rigid Body 1:Marker1" in facts["markers"]["names"]
    assert "Unlabeled:108" in facts["markers"]["names"]
    assert "marker_blank" in notes(facts)
    assert notes(facts)["fitted_markers"].startswith("3 Rigid Body Marker are fitted places")


def test_the_drone_and_its_149_gaps(take: Any) -> None:
    (body,) = take(DRONE)["markers"]["rigid_bodies"]
    assert (body["name"], body["missing"], body["has_error"]) == ("drone", 227, False)
    assert (body["gaps"]["count"], body["gaps"]["longest"]) == (149, 5)


def test_the_wall_has_no_gaps(take: Any) -> None:
    markers = take(WALL)["markers"]
    assert [body["name"] for body in markers["rigid_bodies"]] == ["shimonsWall", "wall_2"]
    assert "shimonsWall:Marker 001" in markers["names"]
    assert set(markers["missing"].values()) == {0}
    assert {body["missing"] for body in markers["rigid_bodies"]} == {0}


def test_row_style_1_1(take: Any) -> None:
    facts = take(ROWS_11)
    assert facts["metadata"]["frames_without_body"] == 20
    assert facts["metadata"]["visible_markers"] == {"least": 2, "most": 4}
    assert facts["metadata"]["rigid_bodies"]["Rigid Body 1"]["markers"] == 5
    (body,) = facts["markers"]["rigid_bodies"]
    assert body["missing"] == 20
    assert {f"Rigid Body 1-Marker {i}" for i in range(1, 6)} <= {*facts["markers"]["names"]}
    assert {"unit_assumed", "frames_without_body"} <= {*notes(facts)}


def test_row_style_1_0(take: Any) -> None:
    facts = take(ROWS_10)
    markers = facts["markers"]
    assert [body["name"] for body in markers["rigid_bodies"]] == ["r", "l", "slider", "rbt"]
    assert (markers["start"], markers["end"]) == (0.02110984, 6.68913903)
    assert markers["step_min"] == pytest.approx(3.07e-3, abs=5e-6)
    assert markers["step_max"] == pytest.approx(4.97e-3, abs=5e-6)
    assert facts["metadata"]["visible_markers"] == {"least": 5, "most": 11}
    assert {"time_jitter", "time_start_not_zero", "unit_assumed"} <= {*notes(facts)}


def test_a_cut_take_with_jumps(take: Any) -> None:
    facts = take(BATS)
    markers = facts["markers"]
    assert (markers["first_frame"], markers["start"]) == (72210, pytest.approx(722.1))
    assert max(hole["length"] for hole in markers["holes"]) == pytest.approx(109.47)
    assert [body["missing"] for body in markers["rigid_bodies"]] == [1, 2, 186]
    assert all(body["has_error"] for body in markers["rigid_bodies"])
    assert notes(facts)["rows_differ"] == "the header states 190951 rows, the file holds 934"
    assert "time_holes" in notes(facts)


def test_one_throw_in_five_tracks(take: Any) -> None:
    markers = take(THROW)["markers"]
    assert [*markers["missing"].values()] == [766, 813, 807, 733, 724]
    assert [*markers["missing"]] == [f"Unlabeled {i}" for i in range(2379, 2384)]
    assert all(gaps["ranges"][0][0] == 0 for gaps in markers["gaps"].values())
    assert take(THROW)["metadata"]["Rotation Type"] == "XYZ"


def test_frozen_poses_of_a_resaved_take(take: Any) -> None:
    facts = take(POOL)
    bodies = facts["markers"]["rigid_bodies"]
    assert [body["missing"] for body in bodies] == [0] * 5
    assert [body["frozen_steps"] for body in bodies] == [3278, 2461, 3650, 920, 3371]
    assert [body["longest_frozen_run"] for body in bodies] == [152, 202, 278, 83, 323]
    frozen = [note for note in facts["notes"] if note["code"] == "frozen_pose"]
    assert [note["severity"] for note in frozen] == ["warning"] * 5


def test_the_label_switch_of_the_soft_arm(take: Any) -> None:
    facts = take(ARM)
    markers = facts["markers"]
    for i in (1, 2, 3):
        gaps = markers["gaps"][f"SA-base:Marker{i}"]
        assert (gaps["count"], gaps["ranges"]) == (1, [[0, 3931]])
    for name in ("Unlabeled 1364", "Unlabeled 1365", "Unlabeled 1366"):
        assert markers["gaps"][name]["ranges"] == [[3932, 8707]]
    assert markers["missing"]["SA-low:Marker4"] == 10
    assert markers["gaps"]["SA-low:Marker4"]["count"] == 2
    switched = {n["where"] for n in facts["notes"] if n["code"] == "label_switch"}
    assert switched == {f"SA-base:Marker{i}" for i in (1, 2, 3)}
    assert "'sim-fk-400-5'" in notes(facts)["take_name_differs"]
    assert "time_rounded" in notes(facts)
    assert sum(not name.startswith("Unlabeled") for name in markers["names"]) == 13


def test_a_c3d_file_is_recognised_and_refused(realdata: Path) -> None:
    with pytest.raises(ReadError, match=r"a C3D file \(motion capture\), which is recognised b"):
        inspect_export(realdata / "motive" / C3D)


def test_ten_channels_of_one_name(recording: Any) -> None:
    facts = recording("0103_3_3.mat")
    channels = facts["streams"][0]["channels"]
    assert {channel["name"] for channel in channels} == {"In1"}
    assert "Model Root/Laser Sensor\\n/laser_raw/In1" in [channel["path"] for channel in channels]
    assert facts["metadata"]["variable"] == "rec"
    assert facts["metadata"]["date"].startswith("2021")
    assert {"names_not_unique", "line_break_in_path", "variable_name_differs"} <= {*notes(facts)}
    assert "step_not_nominal" in notes(facts)


@pytest.mark.parametrize(
    ("name", "paths"),
    [
        ("exp1_003.mat", DC_MOTOR),
        ("rec1_003.mf4", DC_MOTOR),
        ("exp1_030.mat", ADC),
        ("exp1_033.mat", ADC),
        ("u1_impulse.mat", IMPULSE),
        ("u_rand.mat", IMPULSE),
    ],
)
def test_paths_of_channels(recording: Any, name: str, paths: list[str]) -> None:
    assert [channel["path"] for channel in recording(name)["streams"][0]["channels"]] == paths


def test_the_mf4_holds_the_same_samples_as_the_mat(recording: Any) -> None:
    mat, mf4 = recording("exp1_003.mat")["streams"], recording("rec1_003.mf4")["streams"]
    assert mat == mf4
    assert recording("rec1_003.mf4")["metadata"]["start_time"].endswith("+04:00")


@pytest.mark.parametrize(
    ("name", "date"),
    [
        ("exp1_003.mat", "2026-05-01"),
        ("exp1_030.mat", "2023-05-04"),
        ("rec1_001.csv", "2026-01-12"),
        ("u1_impulse.mat", "2015-10-31"),
    ],
)
def test_day_and_month_are_told_apart(recording: Any, name: str, date: str) -> None:
    assert recording(name)["metadata"]["date"] == date


def test_two_small_holes(recording: Any) -> None:
    holes = recording("exp1_030.mat")["streams"][0]["holes"]
    assert len(holes) == 2
    assert all(2.5e-3 < hole["length"] < 4.5e-3 for hole in holes)
    assert notes(recording("exp1_030.mat"))["start_differs"].startswith(
        "StartTimestamp says -0.0024"
    )


def test_ten_holes_of_50_ms(recording: Any) -> None:
    holes = recording("exp1_033.mat")["streams"][0]["holes"]
    assert len(holes) == 10
    assert all(hole["length"] == pytest.approx(0.05, abs=0.002) for hole in holes)
    assert sum(hole["length"] for hole in holes) == pytest.approx(0.49, abs=0.02)
    between = [b["at"] - a["at"] for a, b in pairwise(holes)]
    assert between == pytest.approx([1.05] * 9, abs=0.005)
    assert "about 490 samples lost" in notes(recording("exp1_033.mat"))["time_holes"]


def test_two_rasters_and_jitter_without_loss(recording: Any) -> None:
    facts = recording("rec1_253.mat")
    slow, fast = facts["streams"]
    assert (slow["holes"], fast["holes"]) == ([], [])
    assert fast["step_min"] == pytest.approx(0.46e-3, abs=5e-6)
    assert fast["step_max"] == pytest.approx(1.54e-3, abs=5e-6)
    assert notes(facts)["several_clocks"] == "2 time axes: OnChange, Periodic Task 1"
    assert "time_jitter" in notes(facts)
    assert {c["path"].split("/")[0] for c in slow["channels"]} == {"Tunable Parameters"}


def test_the_csv_of_a_spanish_computer(recording: Any) -> None:
    facts = recording("rec1_001.csv")
    names = [channel["name"] for channel in facts["streams"][0]["channels"]]
    assert names[:5] == ["Ds", "Qs", "Out1[0]", "Out1[1]", "Out1[2]"]
    assert names[5:] == ["speed", "Theta_e", "Out1", "Iq_ref"]
    assert facts["metadata"]["General"]["DateTime"] == "12/01/2026 11:00:26 a. m."
    assert "rows_differ" not in notes(facts)


def test_revision_2_0(recording: Any) -> None:
    facts = recording("u1_impulse.mat")
    assert facts["metadata"]["revision"] == "2.0"
    assert "time_start_not_zero" in notes(facts)
    assert facts["metadata"]["Capture"]["TriggerDelay"] == -1
    assert recording("u_rand.mat")["metadata"]["Capture"]["TriggerState"] == "off"
    assert "time_start_not_zero" not in notes(recording("u_rand.mat"))
