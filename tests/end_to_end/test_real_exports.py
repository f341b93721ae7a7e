"""Every real export is inspected right: rows, columns, units, ends, extremes, gaps.

The numbers are those of ``real_load_frames.txt``, of the README of the real exports, and of the
files themselves. None of them was taken from the output of a reader.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from functools import cache
from itertools import chain, pairwise
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from labpipe.process.inspection import as_json, as_text, inspect_export
from labpipe.process.reading import read_inputs
from labpipe.protocol.load import load_test_sheet, resolve

pytestmark = pytest.mark.realdata
FOLDERS = (
    *("mts", "lloyd_nexygen", "instron", "zwick", "walter_bai"),
    *("shimadzu", "hbm_catman", "deben", "ta_dma"),
)
# What the unit in a file is worth in SI. Inspection may leave a unit of no mechanical quantity as
# it is written (unit None, numbers as in the file), but never one of those that a test is about.
SI = {
    "mm": ("m", 1e-3),
    "µm": ("m", 1e-6),
    "in": ("m", 0.0254),
    "N": ("N", 1.0),
    "kN": ("N", 1e3),
    "mN": ("N", 1e-3),
    "lbf": ("N", 4.4482216152605),
    "MPa": ("Pa", 1e6),
    "kN·mm": ("N m", 1.0),
    "Nm": ("N m", 1.0),
    "Nmm": ("N m", 1e-3),
    "V": ("V", 1.0),
    "sec": ("s", 1.0),
    "ms": ("s", 1e-3),
}
UNIT_OF_THE_PROGRAM = {"Elongation", "Force", "Position", "Samplerate"}
"""Channels of a Microtest export: it has no row of units, the program's are known."""
PARTED = """\
test: T1
protocol: tensile
specimen: {{type: doubly-compressed, spool: "1", sample: "1"}}
files: {{frame: {0}}}
"""
TIMED = "DAQ- Crosshead, … - (Timed)"
PARTS = f"mts/MTS_data/I0-0.9-dc/Test Run 4 10-23-2023 6 43 09 PM/{TIMED}"
BOM_ONLY = f"{PARTS}2.txt"
MICROTEST = "deben/NANOCEL_KW.CHAL_450PPM_15.MTR"


class Signal(NamedTuple):
    """One channel as the file has it; None for a blank."""

    name: str
    unit: str
    first: float | None
    last: float | None
    least: float | None
    most: float | None
    missing: int


class Stream(NamedTuple):
    """One table of samples."""

    samples: int
    start: float | None
    end: float | None
    signals: list[Signal]


def _cell(text: str) -> float | None:
    return None if text == "-" else float(text)


def _table() -> dict[str, list[Stream]]:
    table: dict[str, list[Stream]] = {}
    streams: list[Stream] = []
    text = Path(__file__).with_name("real_load_frames.txt").read_text(encoding="utf-8")
    for line in text.splitlines():
        if line.startswith("== "):
            streams = table[line[3:]] = []
        elif line.startswith("-- "):
            samples, start, end = line[3:].split(" | ")
            streams.append(Stream(int(samples), _cell(start), _cell(end), []))
        elif line and not line.startswith("#"):
            name, unit, *numbers, missing = line.split(" | ")
            first, last, least, most = map(_cell, numbers)
            signal = Signal(name, unit.strip("-"), first, last, least, most, int(missing))
            streams[-1].signals.append(signal)
    return table


FACTS = _table()


@cache
def inspected(path: Path) -> dict[str, Any]:
    inspection = inspect_export(path)
    assert as_text(inspection)
    facts: dict[str, Any] = json.loads(json.dumps(as_json(inspection), allow_nan=False))
    return facts


Inspect = Callable[[str], dict[str, Any]]


@pytest.fixture
def inspect(realdata: Path) -> Inspect:
    return lambda name: inspected(realdata / name)


def notes(facts: dict[str, Any]) -> dict[str, str]:
    return {note["code"]: note["message"] for note in facts["notes"]}


def shown(stream: dict[str, Any], signal: Signal) -> dict[str, Any]:
    found = [channel for channel in stream["channels"] if channel["name"] == signal.name]
    names = [channel["name"] for channel in stream["channels"]]
    assert len(found) == 1, f"{signal.name} not once in {names}"
    return dict(found[0])


def close(found: float | None, expected: float | None, factor: float) -> None:
    """Ten digits are in the table; a smallest value near zero is no exception."""
    if expected is None:
        assert found is None
    else:
        assert found == pytest.approx(expected * factor, rel=1e-9, abs=1e-300)


def factor_of(channel: dict[str, Any], signal: Signal) -> float:
    """Factor from the file's number to the shown one; fails where the shown unit is wrong."""
    if signal.unit in SI:
        unit, factor = SI[signal.unit]
        assert channel["unit"] == unit
        return factor
    if signal.unit == "%" and channel["unit"] == "1":
        return 0.01
    if signal.unit == "d" and channel["unit"] == "s":
        return 86400.0
    assert channel["unit"] in {None, {"mm/mm": "1", "N/m": "N/m"}.get(signal.unit)}
    return 1.0


def test_no_real_export_is_forgotten(realdata: Path) -> None:
    files = chain.from_iterable((realdata / folder).rglob("*") for folder in FOLDERS)
    assert {str(p.relative_to(realdata)) for p in files if p.is_file()} == set(FACTS)


def test_parts_of_one_test_sort_by_time(realdata: Path, tmp_path: Path) -> None:
    """In the order 5, 1, 4, 3 and the one without number; part 2 holds a byte order mark only."""
    files = sorted((realdata / PARTS).parent.iterdir())
    assert len(files) == 6
    names = [shutil.copyfile(file, tmp_path / file.name).name for file in files]
    sheet_path = tmp_path / "test.yaml"
    sheet_path.write_text(PARTED.format(json.dumps(names, ensure_ascii=False)), encoding="utf-8")
    sheet = load_test_sheet(sheet_path)
    recordings, inputs = read_inputs(tmp_path, sheet, resolve(sheet, sheet_path))
    whole = recordings["frame"]
    time = whole.clocks[0].time
    assert len(inputs) == 6
    assert len(time) == 523 + 998 + 669 + 5999 + 699
    assert (time[0], time[-1]) == (pytest.approx(0.019), pytest.approx(88.971, abs=5e-4))
    # From part to part 0.02 s to 0.03 s go by; within a part the step is 0.01 s.
    steps = time[1:] - time[:-1]
    assert steps.min() > 0.0
    assert steps.max() == pytest.approx(0.033, abs=0.001)
    force = next(channel for channel in whole.channels if channel.name == "force")
    assert (force.unit, force.values[523]) == ("N", pytest.approx(6.82898899e-05))
    assert any("without samples" in note.message for note in whole.notes)


@pytest.mark.parametrize(
    ("name", "longest", "usual"),
    [
        ("Allong 1.TRA", 0.63, 0.01),
        ("Zugversuch_eng_ETFE-Ref+Groesseneffekt6.TRA", 0.37, 0.02),
    ],
)
def test_testxpert_leaves_samples_out_and_loses_none(
    inspect: Inspect, name: str, longest: float, usual: float
) -> None:
    found = inspect(f"zwick/{name}")
    (stream,) = found["streams"]
    assert stream["holes"] == []
    assert stream["step_max"] == pytest.approx(longest, abs=0.011)
    assert stream["step_median"] == pytest.approx(usual)
    assert "the program samples at a variable rate" in notes(found)["time_variable"]


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
# file: version, frames, rate (1/s), unit of length, frames without each rigid body, markers
TAKES: dict[str, tuple[str, int, float, str, list[int] | int, int]] = {
    DECAR: ("1.23", 712, 120.0, "Meters", [1], 9),
    EMPTY: ("1.23", 1353, 360.0, "Millimeters", [], 0),
    HMV: ("1.21", 250, 120.0, "Meters", 1, 9),
    DRONE: ("1.23", 11539, 120.0, "Meters", [227], 0),
    WALL: ("1.24", 435, 240.0, "Meters", [0, 0], 24),
    ROWS_11: ("1.1", 548, 120.0, "", [20], 11),
    ROWS_10: ("1.0", 1668, 250.0, "", 4, 17),
    BATS: ("1.23", 934, 100.0, "Meters", [1, 2, 186], 0),
    THROW: ("1.23", 826, 100.0, "Meters", [], 5),
    POOL: ("1.23", 3856, 120.0, "Millimeters", [0] * 5, 0),
    ARM: ("1.23", 8708, 120.0, "Millimeters", [], 16),
}
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


@pytest.fixture
def take(realdata: Path) -> Any:
    return lambda name: inspected(realdata / "motive" / name)


@pytest.fixture
def recording(realdata: Path) -> Any:
    return lambda name: inspected(realdata / "dspace" / name)


def test_no_take_is_forgotten(realdata: Path) -> None:
    assert {file.name for file in (realdata / "motive").iterdir()} == {*TAKES, C3D}
    assert {file.name for file in (realdata / "dspace").iterdir()} == {*RECORDINGS}


@pytest.mark.parametrize("name", TAKES)
def test_takes(take: Any, name: str) -> None:
    version, frames, rate, unit, bodies, n_markers = TAKES[name]
    facts = take(name)
    markers = facts["markers"]
    assert (facts["reader"], facts["program"], facts["version"]) == (
        *("motive-csv", "Motive", version),
    )
    assert markers["frames"] == frames
    assert markers["rate"] == pytest.approx(rate, rel=1e-4)
    assert markers["unit_in_file"] == unit
    missing = [body["missing"] for body in markers["rigid_bodies"]]
    assert len(missing) == bodies if isinstance(bodies, int) else missing == bodies
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
    assert all(body["has_error"] for body in markers["rigid_bodies"])
    assert notes(facts)["rows_differ"] == "the header states 190951 rows, the file holds 934"
    assert "time_holes" in notes(facts)


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


def test_the_mf4_holds_the_same_samples_as_the_mat(recording: Any) -> None:
    mat, mf4 = recording("exp1_003.mat")["streams"], recording("rec1_003.mf4")["streams"]
    assert mat == mf4
    assert recording("rec1_003.mf4")["metadata"]["start_time"].endswith("+04:00")


def test_ten_holes_of_50_ms(recording: Any) -> None:
    holes = recording("exp1_033.mat")["streams"][0]["holes"]
    assert len(holes) == 10
    assert all(hole["length"] == pytest.approx(0.05, abs=0.002) for hole in holes)
    assert sum(hole["length"] for hole in holes) == pytest.approx(0.49, abs=0.02)
    between = [b["at"] - a["at"] for a, b in pairwise(holes)]
    assert between == pytest.approx([1.05] * 9, abs=0.005)
    assert "about 490 samples lost" in notes(recording("exp1_033.mat"))["time_holes"]


@pytest.mark.parametrize("name", FACTS)
def test_load_frames(inspect: Inspect, name: str) -> None:
    """Samples, times, names and numbers of all channels: none is lost and none invented."""
    facts = inspect(name)
    assert facts["reader"] == "load-frame"
    streams = facts["streams"]
    assert [stream["samples"] for stream in streams] == [known.samples for known in FACTS[name]]
    for stream, known in zip(streams, FACTS[name], strict=True):
        if known.start is not None:
            close(stream["start"], known.start, 1.0)
            close(stream["end"], known.end, 1.0)
        # The time axis may be listed beside the signals; a Microtest speed is text with a unit.
        extra = {"Motorspeed"} if name == MICROTEST else set()
        names = [channel["name"] for channel in stream["channels"] if channel["name"] not in extra]
        assert names == [signal.name for signal in known.signals]
        for signal in known.signals:
            channel = shown(stream, signal)
            if name != MICROTEST or signal.name not in UNIT_OF_THE_PROGRAM:
                assert channel["unit_in_file"] == signal.unit
            factor = factor_of(channel, signal)
            close(channel["first"], signal.first, factor)
            close(channel["last"], signal.last, factor)
            close(channel["min"], signal.least, factor)
            close(channel["max"], signal.most, factor)
            assert channel["missing"] == signal.missing


NOTES = {
    f"motive/{DECAR}": {"fitted_markers": "6 Rigid Body Marker", "unlabelled_markers": "3 of 9 "},
    f"motive/{EMPTY}": {"take_empty": "the take holds no rigid body and no marker"},
    f"motive/{HMV}": {"fitted_markers": "3 Rigid Body Marker", "marker_blank": ""},
    "dspace/0103_3_3.mat": {"names_not_unique": "", "line_break_in_path": ""},
    "dspace/exp1_030.mat": {"start_differs": "StartTimestamp says -0.0024", "time_holes": ""},
    "dspace/rec1_253.mat": {"several_clocks": "2 time axes: OnChange, Periodic Task 1"},
    "dspace/u1_impulse.mat": {"time_start_not_zero": ""},
    BOM_ONLY: {"no_samples": ""},
    MICROTEST: {"last_row_left_out": ""},
}  # fmt: skip


@pytest.mark.parametrize("name", NOTES)
def test_notes_on_odd_exports(inspect: Inspect, name: str) -> None:
    told = notes(inspect(name))
    for code, start in NOTES[name].items():
        assert told[code].startswith(start), told
